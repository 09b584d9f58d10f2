//! What the monitor watches beside the line itself: whether the noise it is held against is still that
//! of this cut.

use super::super::ChatterEvent;
use super::super::Phase;
use super::super::baseline::Baseline;
use super::super::detector::{BankEvidence, Evidence, PLACED, on_an_order};
use super::super::past::FAR_HZ;
use super::super::scatter::{ENOUGH, Scatter};
use super::trial::MOST_SHARE;
use super::{ChatterMonitor, ChatterState, RELEARN_S, STRIDES, YOUNG_TURNS, doubt};

/// All of the band this much louder than learned, for so many decisions (32 ms), is another cut: what is
/// known of the noise of the old one says little of the shape of the new.
const LOUDER: f64 = 3.0;
const LOUDER_LOOKS: u32 = 8;
/// The same in the short windows alone, for so many decisions (12 ms).
const WIDE_LOOKS: u32 = 3;
/// A line that stands this far above the band that rose with it made it rise.
const CLEAR_LINE: f64 = 150.0;
/// At the start the strongest line is watched for so long, and after noise was told by its scatter.
pub(super) const START_S: f64 = 1.2;
const DOUBTFUL_S: f64 = 10.0;
/// It must be so far above the middle of the band.
const OVER_FLOOR: f64 = 100.0;
/// There it counts after so many looks (48 ms) if it was seen to rise; where it stands less clear, after
/// `LEAST_LOOKS`.
const GREW_LOOKS: u64 = 12;
const GREW_OVER_FLOOR: f64 = 50.0;
/// At the start so many looks (0.2 s, after as long again) are enough, if its amplitude is this share of
/// the mean force.
const LEAST_LOOKS: f64 = 50.0;
const LEAST_SHARE: f64 = 0.15;
/// And so much of all that is in the band, orders included.
const LEAST_OF_ALL: f64 = 0.5;
/// Where the tools cut the mean force stands so far above the noise of the band.
const CUTS: f64 = 10.0;
/// For so long after it was learned anew the noise is not trusted.
pub(super) const DOUBT_S: f64 = 0.5;
/// Two lines this near are one.
const SAME_HZ: f64 = 5.0;
/// Contrast from which a line is followed to tell it from noise.
const LOOKED_AT: f64 = 4.0;
/// The bank whose power tells a line from noise.
const SCATTER: usize = 1;
/// What is declared and gone again within this was a swell of noise: chatter stays.
pub(super) const SWELL_S: f64 = 0.3;
/// What was told to be noise is learned for so long.
const NOISE_S: f64 = 1.5;

impl ChatterMonitor {
    /// All windows agree that the band as a whole is louder than learned: the tools entered, depth or
    /// material changed. Loud chatter raises all of the band too, but stands far above it.
    pub(super) fn watch_level(&self, state: &mut ChatterState, common: f64, clearest: f64) {
        let no_line = state.detector.phase() != Phase::Chatter && clearest < CLEAR_LINE;
        let loud = common > LOUDER && no_line;
        state.louder = if loud { state.louder + 1 } else { 0 };
        if state.louder >= LOUDER_LOOKS {
            doubt(&mut state.baselines);
            state.relearn_until_s = self.now_s(state) + RELEARN_S;
        }
    }

    /// The short windows see all of the band louder at once: tools enter or leave, or something is hit.
    /// Nothing is declared for one turn; where all of the band is still louder then, it is no ring: the
    /// notches start anew.
    pub(super) fn watch_width(&self, state: &mut ChatterState, t_s: f64) {
        let louder = state.bank_common[0].min(state.bank_common[1]) > LOUDER;
        let wide = louder && state.detector.phase() != Phase::Chatter;
        state.wide = if wide { state.wide + 1 } else { 0 };
        if state.speed_hz <= 0.0 {
            return;
        }
        if state.held_off_s > 0.0 && t_s >= state.held_off_s {
            state.held_off_s = 0.0;
            if wide {
                self.restart_orders(state);
                state.detector.forget_suspicion();
            }
        }
        if state.wide >= WIDE_LOOKS && t_s > state.wide_until_s {
            state.held_off_s = t_s + 1.0 / state.speed_hz;
            state.wide_until_s = t_s + YOUNG_TURNS / state.speed_hz;
        }
    }

    /// The strongest line, while what is known of the noise may be chatter itself: at the start, after an
    /// entry, and after noise was told by its scatter. At the start and after an entry, where a foreign tone
    /// stands too, the line must be a share of the mean force that no stable cut has.
    pub(super) fn watch_strongest(
        &self,
        state: &mut ChatterState,
        evidence: &Evidence,
    ) -> Option<BankEvidence> {
        let start = evidence.t_s <= state.start_until_s;
        let doubtful = evidence.t_s <= state.strongest_until_s;
        let entered = evidence.t_s <= state.changed_s + START_S;
        if !(start || doubtful || entered) || state.detector.phase() == Phase::Chatter {
            return None;
        }
        let bank = &self.banks[PLACED];
        let among = state.watched.filters(bank.frequencies_hz().len(), self.reach_hz);
        let floor_n2 = state.baselines[PLACED].median(among.clone()) / std::f64::consts::LN_2;
        let strongest = state.baselines[PLACED].look(bank, &state.banks[PLACED], among);
        let power_n2 = state.baselines[PLACED].power(strongest);
        let frequency_hz = self.mix.centre_hz() + bank.refined_hz(&state.banks[PLACED], strongest);
        let over_floor = if start { GREW_OVER_FLOOR } else { OVER_FLOOR };
        let clear = power_n2 > OVER_FLOOR * floor_n2;
        let line_hz = state.strongest.place(frequency_hz, power_n2 > over_floor * floor_n2)?;
        let power_there_n2 = self.power_near(state, line_hz);
        state.strongest.look(power_there_n2, power_n2, floor_n2);
        let lasts = |looks| state.strongest.line_hz(looks).is_some();
        let rose = || state.past.rose(self.mix.output_rate_hz(), line_hz - self.mix.centre_hz());
        let long = lasts(LEAST_LOOKS);
        let loud = || clear && long && self.loud_in_cut(state, power_n2, floor_n2);
        let grew = || (long || clear && state.strongest.followed() >= GREW_LOOKS) && rose();
        let stands = if start { loud() || grew() } else { entered && loud() || doubtful && lasts(ENOUGH) };
        (stands && (line_hz - frequency_hz).abs() < SAME_HZ).then(|| BankEvidence {
            tau_s: bank.tau_s(),
            contrast: power_n2 / floor_n2,
            power_n2,
            noise_n2: floor_n2,
            frequency_hz,
            growth_1_s: bank.growth_1_s(&state.banks[PLACED], strongest),
            ..evidence.banks[PLACED]
        })
    }

    /// Whether there is a mean force that stands far above the noise of the band, and the line is a
    /// share of it that no stable cut has.
    fn loud_in_cut(&self, state: &ChatterState, power_n2: f64, floor_n2: f64) -> bool {
        let mean_n = state.level.mean_n().abs();
        let share = (2.0 * power_n2).sqrt() / mean_n.max(f64::MIN_POSITIVE);
        let alone = power_n2 > LEAST_OF_ALL * state.whole_variance_n2;
        alone && self.over_noise(mean_n, floor_n2) && (LEAST_SHARE..MOST_SHARE).contains(&share)
    }

    /// Whether a mean force stands as far above the noise of the band as where the tools cut. `floor_n2`: of
    /// the noise in one filter of the bank that places lines.
    pub(super) fn over_noise(&self, mean_n: f64, floor_n2: f64) -> bool {
        // Noise bandwidth of t/tau^2 e^{-t/tau}: 1/(4 tau).
        let noise_n2 = floor_n2 * 2.0 * self.reach_hz * 4.0 * self.banks[PLACED].tau_s();
        mean_n > CUTS * noise_n2.sqrt()
    }

    /// Power of the bank that tells lines from noise, at the filter nearest to a frequency.
    pub(super) fn power_near(&self, state: &ChatterState, frequency_hz: f64) -> f64 {
        state.baselines[SCATTER].power(self.banks[SCATTER].nearest(frequency_hz - self.mix.centre_hz()))
    }

    /// The line that stands out, if it has stood as no noise does.
    pub(super) fn standing(&self, state: &ChatterState) -> Option<BankEvidence> {
        let placed = state.bank_evidence[PLACED];
        let line_hz = state.scatter.line_hz(ENOUGH)?;
        ((line_hz - placed.frequency_hz).abs() < SAME_HZ).then_some(placed)
    }

    /// What stands out fluctuates as noise does: it is noise of a cut that was not known, and is learned.
    /// Not where it is louder than in any stable cut: two lobes that beat fluctuate so, too.
    pub(super) fn watch_scatter(
        &self,
        state: &mut ChatterState,
        evidence: &Evidence,
    ) -> Option<ChatterEvent> {
        let placed = &evidence.banks[PLACED];
        let stands_out = placed.contrast > LOOKED_AT && !on_an_order(placed, evidence);
        let look = |scatter: &mut Scatter, baselines: &[Baseline], bank: usize| {
            let line_hz = scatter.place(placed.frequency_hz, stands_out)?;
            let filter = self.banks[bank].nearest(line_hz - self.mix.centre_hz());
            let (power_n2, noise_n2) = (baselines[bank].power(filter), baselines[bank].expected(filter));
            scatter.look(power_n2, evidence.banks[bank].power_n2, noise_n2);
            Some(())
        };
        if state.decisions.is_multiple_of(STRIDES[PLACED]) {
            look(&mut state.long_scatter, &state.baselines, PLACED);
        }
        look(&mut state.scatter, &state.baselines, SCATTER)?;
        // Where lobes stand closer than the shorter window tells apart they beat in it: the longer one must
        // have seen them scatter for as long.
        let close = state.speed_hz > 0.0 && state.speed_hz < FAR_HZ;
        let longer = || state.long_scatter.fluctuated(ENOUGH / STRIDES[PLACED] as f64);
        if !state.scatter.noise() || close && !longer() {
            return None;
        }
        state.long_scatter.forget();
        state.scatter.forget();
        if state.loudness.is_loud() {
            return None;
        }
        self.doubt_noise(state, evidence.t_s);
        state.detector.dismiss()
    }

    /// What stood out was noise: it is learned as it is heard for a while, whatever stands out.
    pub(super) fn doubt_noise(&self, state: &mut ChatterState, t_s: f64) {
        state.baselines.iter_mut().for_each(|baseline| baseline.doubt(1.0));
        state.noise_until_s = t_s + NOISE_S;
        state.strongest.forget();
        state.strongest_until_s = t_s + DOUBTFUL_S;
    }

    /// What stands out is a spindle order that the notches do not know: the cut that makes it is
    /// another. They start anew.
    pub(super) fn watch_orders(&self, state: &mut ChatterState, evidence: &Evidence) {
        let stands_out = evidence.banks[2].contrast > evidence.banks[2].suspect;
        let order = stands_out
            && state.detector.phase() != Phase::Chatter
            && on_an_order(&evidence.banks[2], evidence);
        state.order_line = if order { state.order_line + 1 } else { 0 };
        if state.order_line >= LOUDER_LOOKS && evidence.t_s > state.orders_new_until_s && state.speed_hz > 0.0
        {
            self.restart_orders(state);
            state.detector.forget_suspicion();
            state.orders_new_until_s = evidence.t_s + YOUNG_TURNS / state.speed_hz;
        }
    }
}
