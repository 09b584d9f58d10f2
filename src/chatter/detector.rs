//! From lines that stand out to a decision: `Learning -> Quiet -> Suspected -> Chatter -> Quiet`.

use super::growth::Growth;
use super::steadiness::Steadiness;
use super::{ChatterEvent, Line, NotChatter, Phase};
use crate::keyframe::{Keep, Words};

/// What the banks say at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Evidence {
    /// Time of the last sample used.
    pub(super) t_s: f64,
    /// For each bank, shortest window first.
    pub(super) banks: [BankEvidence; BANKS],
    /// Whether a turn has passed since the cut changed, so that spindle orders are known.
    pub(super) orders_known: bool,
    /// Whether all of the band became louder at once some turns ago: a hit rings between the orders too.
    pub(super) wide: bool,
    /// Within one turn of that: it must repeat before it means anything.
    pub(super) held_off: bool,
    /// Whether the orders may still be building up: few turns since the cut changed.
    pub(super) orders_young: bool,
    /// Turns per second; 0 where it is not known.
    pub(super) speed_hz: f64,
    /// How fast that changes.
    pub(super) speed_change_hz_s: f64,
    /// Delay of the band before the windows, s.
    pub(super) delay_s: f64,
    /// Whether the noise was learned anew a moment ago.
    pub(super) doubtful: bool,
    /// Whether the vibration is as loud as that of no stable cut.
    pub(super) loud: bool,
    /// The line that has stood, louder than the noise known there, as no noise stands.
    pub(super) stands: Option<BankEvidence>,
}

/// What one bank says.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct BankEvidence {
    /// Length constant of the window.
    pub(super) tau_s: f64,
    /// Best line's power over noise.
    pub(super) contrast: f64,
    /// Contrast at which to look.
    pub(super) suspect: f64,
    /// Contrast at which to declare.
    pub(super) confirm: f64,
    /// Its power.
    pub(super) power_n2: f64,
    /// Noise learned at its place.
    pub(super) noise_n2: f64,
    /// Its frequency.
    pub(super) frequency_hz: f64,
    /// Its growth.
    pub(super) growth_1_s: f64,
}

crate::keyframe::keep!(BankEvidence {
    tau_s,
    contrast,
    suspect,
    confirm,
    power_n2,
    noise_n2,
    frequency_hz,
    growth_1_s
});

pub(super) const BANKS: usize = 4;
/// The bank that places a line: as long as a line needs to tell it from the orders, short enough to fill
/// while chatter grows.
pub(super) const PLACED: usize = 2;

/// Contrast at which a line is looked at.
///
/// Noise is exponential: exp(-12) times some 10^3 independent looks a second is one glance a few minutes.
pub(super) const SUSPECT: f64 = 12.0;
/// Contrast at which a line that has lasted is declared: exp(-18) * 1600 /s is one in eleven hours of noise.
pub(super) const CONFIRM: f64 = 18.0;
/// Contrast under which a declared line is gone.
pub(super) const LEAVE: f64 = 5.0;
/// A line must last this long: longer than the shortest window's answer to a hit (4 tau = 50 ms).
const HOLD_S: f64 = 0.045;
/// And its frequency must have stood for this long.
const STANDS_S: f64 = 0.035;
/// The same while the noise is hardly known: two lengths of the window that places it.
const DOUBTFUL_STANDS_S: f64 = 0.08;
/// A line this far from the orders, in half bandwidths of the filter, is none of them: they are down by 13
/// dB there.
const BETWEEN: f64 = 1.8;
/// Noise that a lightly damped lobe colours swells for some hundredths of a second; a line that has not
/// lasted longer than
/// that must stand out by so much more. Chatter at 20 1/s gains it in 12 ms.
const NOISE_LASTS_S: f64 = 0.12;
const YOUNG: f64 = 1.6;
/// A line that loses amplitude faster is ringing down.
const RING_DOWN_1_S: f64 = -6.0;
/// No window in which the line loses amplitude faster than noise makes it seem declares anything.
const FADING_1_S: f64 = -15.0;
/// Share of its recent peak under which chatter has ended: 20 dB.
const FADED: f64 = 0.01;
/// Of the strongest power of a suspicion, kept from one decision to the next.
const STRONGEST_KEEP: f64 = 0.96;
/// Silence before the end is declared.
const END_AFTER_S: f64 = 0.1;
/// Chatter must stay this far over its threshold on average, or it was noise near the limit of stability:
/// that swells and fades over some tenths of a second, chatter stays.
const LEAST_ASSURANCE: f64 = 1.2;
/// No single look counts as more.
const MOST_ASSURANCE: f64 = 3.0;
/// A line that sits on an order for this share of the last half second belongs to the spindle.
const MOSTLY: f64 = 0.8;
/// Of each decision in the average: 0.5 s.
const ASSURANCE_SHARE: f64 = 0.008;
/// Points of the amplitude's recent history.
const HISTORY: usize = 16;

/// The decision's memory.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Detector {
    phase: State,
    /// Latest powers of the shortest bank, newest last: (t_s, power over noise).
    recent: [(f64, f64); HISTORY],
    steadiness: Steadiness,
    growth: Growth,
}

crate::keyframe::keep!(Detector { phase, recent, steadiness, growth });

#[derive(Debug, Clone, Copy, PartialEq)]
enum State {
    Learning,
    Quiet,
    Suspected { since_s: f64, last_seen_s: f64, strongest_n2: f64 },
    Chatter { since_s: f64, last_loud_s: f64, peak_n2: f64, assurance: f64, on_order: f64 },
}

impl Keep for State {
    fn keep(&self, to: &mut Vec<u64>) {
        match *self {
            Self::Learning => to.push(0),
            Self::Quiet => to.push(1),
            Self::Suspected { since_s, last_seen_s, strongest_n2 } => {
                to.push(2);
                [since_s, last_seen_s, strongest_n2].keep(to);
            }
            Self::Chatter { since_s, last_loud_s, peak_n2, assurance, on_order } => {
                to.push(3);
                [since_s, last_loud_s, peak_n2, assurance, on_order].keep(to);
            }
        }
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        *self = match from.next_word()? {
            0 => Self::Learning,
            1 => Self::Quiet,
            2 => {
                let mut x = [0.0; 3];
                x.restore(from)?;
                Self::Suspected { since_s: x[0], last_seen_s: x[1], strongest_n2: x[2] }
            }
            3 => {
                let mut x = [0.0; 5];
                x.restore(from)?;
                let [since_s, last_loud_s, peak_n2, assurance, on_order] = x;
                Self::Chatter { since_s, last_loud_s, peak_n2, assurance, on_order }
            }
            _ => return None,
        };
        Some(())
    }
}

impl Detector {
    pub(super) fn new() -> Self {
        Self {
            phase: State::Learning,
            recent: [(f64::NEG_INFINITY, 0.0); HISTORY],
            steadiness: Steadiness::NEW,
            growth: Growth::NEW,
        }
    }

    pub(super) fn phase(&self) -> Phase {
        match self.phase {
            State::Learning => Phase::Learning,
            State::Quiet => Phase::Quiet,
            State::Suspected { .. } => Phase::Suspected,
            State::Chatter { .. } => Phase::Chatter,
        }
    }

    /// Seconds since chatter was declared.
    pub(super) fn chatter_age_s(&self, t_s: f64) -> Option<f64> {
        match self.phase {
            State::Chatter { since_s, .. } => Some(t_s - since_s),
            _ => None,
        }
    }

    /// Whether a line stands out that may yet prove steady.
    pub(super) fn watches(&self, t_s: f64) -> bool {
        self.steadiness.watches(t_s)
    }

    /// The noise is known.
    pub(super) fn learned(&mut self) {
        if self.phase == State::Learning {
            self.phase = State::Quiet;
        }
    }

    /// Back to the start of a suspicion: the cut changed.
    pub(super) fn forget_suspicion(&mut self) {
        if matches!(self.phase, State::Suspected { .. }) {
            self.phase = State::Quiet;
        }
    }

    /// What was declared is something else: as if it had not been, with what was learned since.
    pub(super) fn refuse(&mut self, before: &Self) {
        self.phase = before.phase;
    }

    /// What stands out is noise; the end of chatter if it was declared.
    pub(super) fn dismiss(&mut self) -> Option<ChatterEvent> {
        let event = matches!(self.phase, State::Chatter { .. }).then_some(ChatterEvent::End);
        if self.phase != State::Learning {
            self.phase = State::Quiet;
        }
        event
    }

    /// Takes the evidence of one instant; gives what began or ended with it.
    pub(super) fn step(&mut self, evidence: &Evidence) -> Option<ChatterEvent> {
        let short = &evidence.banks[0];
        self.recent.rotate_left(1);
        self.recent[HISTORY - 1] = (evidence.t_s, short.power_n2);
        let seen = evidence.banks.iter().any(|b| b.contrast > b.suspect);
        let [_, grown, ..] = &evidence.banks;
        self.growth.look(evidence.t_s, grown.power_n2, grown.noise_n2);
        self.steadiness.look(evidence.t_s, &evidence.banks, on_an_order(&evidence.banks[2], evidence));
        match self.phase {
            State::Learning => {
                let line = *standing(evidence).filter(|_| evidence.orders_known)?;
                Some(self.declare(&line, evidence.t_s))
            }
            State::Quiet => {
                if let Some(line) = self.steady_line(evidence) {
                    return Some(self.declare(&line, evidence.t_s));
                }
                if seen {
                    let t_s = evidence.t_s;
                    self.phase =
                        State::Suspected { since_s: t_s, last_seen_s: t_s, strongest_n2: short.power_n2 };
                }
                None
            }
            State::Suspected { since_s, last_seen_s, strongest_n2 } => {
                let last_seen_s = if seen { evidence.t_s } else { last_seen_s };
                // A jump of 6 dB between two looks is a hit, no growth: the line must last from there.
                let struck = short.power_n2 > 4.0 * strongest_n2;
                let since_s = if struck { evidence.t_s } else { since_s };
                // Forgotten over 0.1 s: what was struck may go on to chatter.
                let strongest_n2 = (strongest_n2 * STRONGEST_KEEP).max(short.power_n2);
                self.phase = State::Suspected { since_s, last_seen_s, strongest_n2 };
                self.judge(evidence)
            }
            State::Chatter { since_s, last_loud_s, peak_n2, assurance, on_order } => {
                let bank = &evidence.banks[1];
                let steady = self.steadiness.steady(evidence.t_s) || standing(evidence).is_some();
                let there = bank.contrast > LEAVE || steady;
                // An order is no chatter: what is left of a line that died may stand on one.
                let there = there && !on_an_order(&evidence.banks[2], evidence);
                // While it is so loud it goes on, however its lines beat and hop.
                let loud = there && bank.power_n2 > FADED * peak_n2 || evidence.loud;
                let last_loud_s = if loud { evidence.t_s } else { last_loud_s };
                // The peak is forgotten over seconds: chatter that got weaker is still chatter.
                let peak_n2 = (peak_n2 * 0.999).max(bank.power_n2);
                let now = if steady || evidence.loud { MOST_ASSURANCE } else { assurance_of(evidence) };
                let assurance = assurance + (now - assurance) * ASSURANCE_SHARE;
                let order = if on_an_order(&evidence.banks[2], evidence) { 1.0 } else { 0.0 };
                let on_order = on_order + (order - on_order) * ASSURANCE_SHARE;
                self.phase = State::Chatter { since_s, last_loud_s, peak_n2, assurance, on_order };
                if evidence.t_s - last_loud_s > END_AFTER_S
                    || assurance < LEAST_ASSURANCE
                    || on_order > MOSTLY
                {
                    self.phase = State::Quiet;
                    return Some(ChatterEvent::End);
                }
                None
            }
        }
    }

    fn judge(&mut self, evidence: &Evidence) -> Option<ChatterEvent> {
        let State::Suspected { since_s, last_seen_s, strongest_n2 } = self.phase else { return None };
        let age_s = evidence.t_s - since_s;
        if evidence.t_s - last_seen_s > 0.03 {
            self.phase = State::Quiet;
            let rang = evidence.banks[0].power_n2 < 0.5 * strongest_n2;
            return Some(ChatterEvent::Dismissed(if rang {
                NotChatter::RingDown
            } else {
                NotChatter::Burst
            }));
        }
        // The longest window that hears a line places it best.
        let placed = evidence.banks.iter().rev().find(|b| b.contrast > b.suspect);
        if placed.is_some_and(|b| on_an_order(b, evidence)) {
            return None;
        }
        let stands_s = if evidence.doubtful { DOUBTFUL_STANDS_S } else { STANDS_S };
        let declares = |(k, b): &(usize, &BankEvidence)| {
            !evidence.held_off
                && (evidence.orders_known
                    || (!evidence.wide && *k <= PLACED && between_orders(b, evidence.speed_hz)))
                && self.steadiness.held_s(*k, evidence.t_s) > stands_s
                && b.growth_1_s > FADING_1_S
                && b.contrast > b.confirm * if age_s > NOISE_LASTS_S { 1.0 } else { YOUNG }
                && !on_an_order(b, evidence)
                && age_s > HOLD_S
                && self.recent_mean() - evidence.banks[0].noise_n2 > 0.5 * b.power_n2
        };
        if let Some(line) = self.steady_line(evidence) {
            return Some(self.declare(&line, evidence.t_s));
        }
        let (_, bank) = evidence.banks.iter().enumerate().find(declares)?;
        // What has lost 6 dB since it was strongest rings down.
        if self.recent_mean() < 0.25 * strongest_n2 {
            return None;
        }
        let strong = evidence.banks[0].contrast > evidence.banks[0].confirm;
        if strong && self.recent_slope_1_s() < RING_DOWN_1_S {
            return None;
        }
        let bank = *bank;
        Some(self.declare(&bank, evidence.t_s))
    }

    /// The line that has stood for long enough, in power or in the scatter of its logarithm.
    fn steady_line(&self, evidence: &Evidence) -> Option<BankEvidence> {
        let steady = self.steadiness.steady(evidence.t_s).then_some(&evidence.banks[PLACED]);
        steady.or_else(|| standing(evidence)).filter(|_| evidence.orders_known).copied()
    }

    fn declare(&mut self, line: &BankEvidence, t_s: f64) -> ChatterEvent {
        self.phase = State::Chatter {
            since_s: t_s,
            last_loud_s: t_s,
            peak_n2: line.power_n2,
            assurance: MOST_ASSURANCE,
            on_order: 0.0,
        };
        ChatterEvent::Onset(Line {
            frequency_hz: line.frequency_hz,
            power_n2: line.power_n2,
            growth_1_s: self.growth.slope_1_s().unwrap_or(line.growth_1_s),
            contrast: line.contrast,
        })
    }

    /// Mean power in the shortest window over the last half of the history.
    fn recent_mean(&self) -> f64 {
        let late = &self.recent[HISTORY / 2..];
        late.iter().map(|(_, p)| p).sum::<f64>() / late.len() as f64
    }

    /// Growth of the amplitude over the last half of the history: slope of ln(power)/2.
    fn recent_slope_1_s(&self) -> f64 {
        let late = &self.recent[HISTORY / 2..];
        let n = late.len() as f64;
        let mean_t = late.iter().map(|(t, _)| t).sum::<f64>() / n;
        let ln = |p: f64| 0.5 * p.max(f64::MIN_POSITIVE).ln();
        let mean_y = late.iter().map(|(_, p)| ln(*p)).sum::<f64>() / n;
        let cross: f64 = late.iter().map(|(t, p)| (t - mean_t) * (ln(*p) - mean_y)).sum();
        let square: f64 = late.iter().map(|(t, _)| (t - mean_t).powi(2)).sum();
        if square > 0.0 { cross / square } else { 0.0 }
    }
}

/// Whether a line is at a spindle order, where regenerative chatter cannot be: its growth needs sin(pi f/S)
/// away from zero. A short window places a line less well.
pub(super) fn on_an_order(line: &BankEvidence, evidence: &Evidence) -> bool {
    if evidence.speed_hz <= 0.0 {
        return false;
    }
    // The window hears what was 2 tau ago, on average.
    let age_s = evidence.delay_s + 2.0 * line.tau_s;
    let speed_hz = (evidence.speed_hz - evidence.speed_change_hz_s * age_s).max(0.2 * evidence.speed_hz);
    let order = line.frequency_hz / speed_hz;
    let apart = (order - order.round()).abs();
    let blurred = (0.05 / (line.tau_s * evidence.speed_hz)).clamp(0.04, 0.12);
    apart < if evidence.orders_young { 0.12 } else { blurred }
}

/// Whether a window tells a line from the orders on both sides of it: two orders that are not known yet add
/// up to no line
/// that stands between them where the filter's side is down.
pub(super) fn between_orders(line: &BankEvidence, speed_hz: f64) -> bool {
    let order = line.frequency_hz / speed_hz.max(f64::MIN_POSITIVE);
    let apart_hz = (order - order.round()).abs() * speed_hz;
    std::f64::consts::TAU * apart_hz * line.tau_s > BETWEEN
}

/// The line that stands, unless it is an order.
fn standing(evidence: &Evidence) -> Option<&BankEvidence> {
    evidence.stands.as_ref().filter(|line| !on_an_order(line, evidence))
}

/// How far the best bank is over its threshold; power counts by itself too, because loud chatter raises all
/// of the band and its own contrast falls.
fn assurance_of(evidence: &Evidence) -> f64 {
    let over = |b: &BankEvidence| (b.contrast / b.confirm).max(0.1 * b.power_n2 / (b.noise_n2 * b.confirm));
    evidence.banks.iter().map(over).fold(0.0, f64::max).min(MOST_ASSURANCE)
}
