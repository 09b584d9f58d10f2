//! Which cuts are made: five recordings from calm to just beyond the border, found by cutting, not by a root.

use super::bench::{Run, SUBSTEPS, Shown, steps_in};
use super::machine::{Hidden, Moment, TrueCut};
use super::{RATE_HZ, signal};
use crate::sample::Recording;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::{PI, TAU};

/// Growth aimed at beyond the border and before it, 1/s.
const BEYOND_1_S: f64 = 12.0;
const BEFORE_1_S: f64 = -8.0;
/// Growth of the loud end that is accepted, 1/s.
const LOUD_1_S: [f64; 2] = [15.0, 45.0];
/// Samples between two looks at what the bar is like.
const REFRESH: usize = 45;
/// Corner of the random part of the force, Hz.
const RANDOM_CORNER_HZ: f64 = 2000.0;
/// How long a change of the pitch takes, s.
const PITCH_RAMP_S: f64 = 0.08;

/// Part of the way from the calm cut (0) to the loud one (1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Extremes {
    calm_pitch_rad: f64,
    calm_width: f64,
    before: f64,
    beyond: f64,
}

impl Extremes {
    /// Looks for a loud and a calm cut, and changes the width until the loud one grows as it should.
    pub(super) fn find(cut: &mut TrueCut) -> Self {
        for _ in 0..10 {
            let growth = growth_1_s(cut, &moment(cut, 0.0, 1.0));
            if growth < LOUD_1_S[0] {
                cut.width_m *= 1.2;
            } else if growth > LOUD_1_S[1] {
                cut.width_m *= 0.85;
            } else {
                break;
            }
        }
        let own = Self { calm_pitch_rad: 0.0, calm_width: 0.5, before: 0.4, beyond: 1.0 };
        let mut found = if cut.two_tools { own.calmed_by_pitch(cut) } else { own };
        while found.calm_width > 0.2 && growth_1_s(cut, &found.at(cut, 0.0)) > BEFORE_1_S {
            found.calm_width *= 0.8;
        }
        found.with_border(cut)
    }

    /// The pitch that calms best: the waves of the two tools against each other.
    fn calmed_by_pitch(mut self, cut: &TrueCut) -> Self {
        let line_hz = 1.15 * cut.stiffness_and_hz()[1];
        let per_pi = PI * cut.speed_rpm / 60.0 / line_hz;
        let pitches = [0.7, 0.8, 0.9, 1.0, 1.1].map(|phase| phase * per_pi);
        let calm = pitches.map(|pitch| growth_1_s(cut, &moment(cut, pitch, 1.0)));
        let best = (0..pitches.len()).min_by(|a, b| calm[*a].total_cmp(&calm[*b])).unwrap_or(0);
        (self.calm_pitch_rad, self.calm_width) = (pitches[best], 1.0);
        self
    }

    /// Bisects for the shares at which it grows as aimed.
    fn with_border(mut self, cut: &TrueCut) -> Self {
        let share_of = |aim: f64| {
            let (mut low, mut high) = (0.0, 1.0);
            for _ in 0..6 {
                let middle = (low + high) / 2.0;
                if growth_1_s(cut, &self.at(cut, middle)) < aim { low = middle } else { high = middle }
            }
            (low + high) / 2.0
        };
        (self.before, self.beyond) = (share_of(BEFORE_1_S), share_of(BEYOND_1_S));
        self
    }

    fn at(&self, cut: &TrueCut, share: f64) -> Moment {
        let width = self.calm_width + (1.0 - self.calm_width) * share;
        moment(cut, self.calm_pitch_rad * (1.0 - share), width)
    }
}

fn moment(cut: &TrueCut, pitch_rad: f64, width: f64) -> Moment {
    Moment {
        t_s: 0.0,
        speed_rpm: cut.speed_rpm,
        feed_m_rev: cut.feed_m_rev,
        width_m: width * cut.width_m,
        position_m: cut.position_m,
        pitch_rad,
    }
}

/// Growth of a tap, 1/s: slope of the logarithm of what a tap adds, between 0.14 s and 0.36 s.
///
/// Two runs, one tapped: what is forced (orders, the way to rest) is the same in both and drops out.
pub fn growth_1_s(cut: &TrueCut, at: &Moment) -> f64 {
    let quiet = TrueCut { random_ratio: 0.0, ..*cut };
    let step_s = 1.0 / (RATE_HZ * SUBSTEPS as f64);
    let steps = steps_in(0.36, step_s);
    let [mut tapped, mut left] = [1e-9, 0.0].map(|speed_m_s| {
        let mut run = Run::new(&quiet, at, steps, step_s);
        run.strike(speed_m_s);
        run
    });
    let mut power = [0.0f64; 2];
    for k in 0..steps {
        let t_s = k as f64 * step_s;
        let now = Moment { t_s, ..*at };
        let commanded = TAU * at.speed_rpm / 60.0 * t_s;
        let [a, b] = [&mut tapped, &mut left].map(|run| run.step(&now, commanded, [0.0; 2], 0.0).bar_m);
        for (sum, from_s) in power.iter_mut().zip([0.14, 0.26]) {
            if (from_s..from_s + 0.1).contains(&t_s) {
                *sum += (a - b).powi(2);
            }
        }
    }
    0.5 * (power[1].max(1e-60) / power[0].max(1e-60)).ln() / 0.12
}

/// A stretch of constant condition.
#[derive(Debug, Clone, Copy)]
struct Stretch {
    seconds: f64,
    at: Moment,
}

/// The five recordings.
pub(super) fn recordings(
    cut: &TrueCut,
    extremes: &Extremes,
    probe: bool,
    random: &mut ChaCha8Rng,
) -> Vec<Recording> {
    let plan = plan(cut, extremes);
    plan.iter().map(|(name, stretches)| record(name, cut, stretches, probe, random)).collect()
}

fn plan(cut: &TrueCut, extremes: &Extremes) -> Vec<(&'static str, Vec<Stretch>)> {
    let at = |share: f64| extremes.at(cut, share);
    let stretch = |seconds: f64, at: Moment| Stretch { seconds, at };
    let air = Moment { width_m: 0.0, ..at(1.0) };
    // The calm share of the waves stays where it is: the pitch goes with the speed.
    let turned = |speed: f64, share: f64| {
        let one = at(share);
        Moment { speed_rpm: speed * cut.speed_rpm, pitch_rad: speed * one.pitch_rad, ..one }
    };
    let sized = |feed: f64, width: f64| {
        let calm = at(0.0);
        Moment { feed_m_rev: feed * cut.feed_m_rev, width_m: width * calm.width_m, ..calm }
    };
    let along = |place: f64, share: f64| Moment { position_m: place * cut.position_m, ..at(share) };
    let shares = [extremes.before, extremes.beyond];
    vec![
        ("entry", vec![stretch(0.4, air), stretch(0.7, at(1.0)), stretch(2.4, at(0.0))]),
        (
            "pitch",
            vec![
                stretch(1.0, at(0.0)),
                stretch(0.45, at(1.0)),
                stretch(1.2, at(0.0)),
                stretch(1.2, at(shares[0])),
                stretch(0.8, at(shares[1])),
            ],
        ),
        (
            "speed",
            vec![
                stretch(1.3, turned(1.0, 0.0)),
                stretch(1.3, turned(0.8, 0.0)),
                stretch(1.3, turned(1.25, 0.0)),
                stretch(0.9, turned(0.9, shares[1])),
            ],
        ),
        (
            "feed_width",
            [(1.0, 1.0), (0.6, 1.0), (1.6, 0.8), (1.0, 0.5), (0.75, 0.7)]
                .map(|(feed, width)| stretch(1.1, sized(feed, width)))
                .to_vec(),
        ),
        (
            "travel",
            [1.0, 0.85, 0.72]
                .iter()
                .flat_map(|place| [stretch(1.0, along(*place, 0.0)), stretch(0.6, along(*place, shares[1]))])
                .collect(),
        ),
    ]
}

fn record(
    name: &str,
    cut: &TrueCut,
    stretches: &[Stretch],
    probe: bool,
    random: &mut ChaCha8Rng,
) -> Recording {
    let step_s = 1.0 / (RATE_HZ * SUBSTEPS as f64);
    let steps: usize = stretches.iter().map(|s| steps_in(s.seconds, 1.0 / RATE_HZ) * SUBSTEPS).sum();
    let mut run = Run::new(cut, &stretches[0].at, steps, step_s);
    let (mut moments, mut shows) = (Vec::with_capacity(steps), Vec::with_capacity(steps));
    let keep = (-TAU * RANDOM_CORNER_HZ * step_s).exp();
    let mut noise = [0.0f64; 2];
    let mut wandered = wandering(0.0, &cut.hidden, random);
    let (mut tangle, mut commanded, mut pitch) = (0.0, 0.0, stretches[0].at.pitch_rad);
    for stretch in stretches {
        let mut position_m = stretch.at.position_m;
        for _ in 0..steps_in(stretch.seconds, 1.0 / RATE_HZ) * SUBSTEPS {
            let k = moments.len();
            let normal: [f64; 3] = std::array::from_fn(|_| StandardNormal.sample(random));
            for tool in 0..2 {
                noise[tool] = keep * noise[tool] + (1.0 - keep * keep).sqrt() * normal[tool];
            }
            tangle = tangled(tangle, normal[2], k, step_s, cut.hidden.tangle_n);
            let most = step_s / PITCH_RAMP_S * 0.3;
            pitch += (stretch.at.pitch_rad - pitch).clamp(-most, most);
            position_m -= stretch.at.feed_m_rev * stretch.at.speed_rpm / 60.0 * step_s;
            let now = Moment { t_s: k as f64 * step_s, pitch_rad: pitch, position_m, ..stretch.at };
            if k.is_multiple_of(REFRESH * SUBSTEPS) {
                wandered = wandering(wandered, &cut.hidden, random);
                let shares = [cut.hidden.wandering, cut.hidden.wandering_pressure];
                run.refresh(&now, shares.map(|share| 1.0 + share * wandered));
            }
            shows.push(run.step(&now, commanded, noise, tangle));
            commanded += TAU * now.speed_rpm / 60.0 * step_s;
            moments.push(now);
        }
    }
    let shows: &[Shown] = &shows;
    signal::recording(name, cut, (&moments, shows), probe, random)
}

/// How far frequency or pressure has wandered by the next look at the bar, in deviations: what is left of it
/// after that time, and something new. Nothing is drawn where nothing does.
fn wandering(now: f64, hidden: &Hidden, random: &mut ChaCha8Rng) -> f64 {
    if hidden.wandering.max(hidden.wandering_pressure) <= 0.0 {
        return 0.0;
    }
    let keep = (-(REFRESH as f64) / RATE_HZ / hidden.wandering_s).exp();
    let new: f64 = StandardNormal.sample(random);
    keep * now + (1.0 - keep * keep).sqrt() * new
}

/// Tangled chips pull for 30 ms and let go; a pull begins by chance, every 0.3 s or so.
fn tangled(now_n: f64, normal: f64, step: usize, step_s: f64, size_n: f64) -> f64 {
    let every = steps_in(0.03, step_s);
    if size_n <= 0.0 || !step.is_multiple_of(every) {
        return now_n;
    }
    // 1.28 standard deviations: one chance in ten.
    if normal.abs() > 1.28 { size_n * normal } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use crate::plant::scenario::Scenario;

    #[test]
    fn the_same_seed_gives_the_same_case() {
        let spec = super::super::CutCaseSpec {
            effects: vec!["turret_compliance".into()],
            depth: 1.0,
            seed: 3,
            probe: false,
        };
        let [a, b] = [0, 1].map(|_| super::super::conceal_cut(&Scenario::default(), &spec).unwrap());
        assert_eq!(a.recordings, b.recordings);
        assert_eq!(a.recordings.len(), 5);
        assert!(
            a.recordings.iter().all(|r| r.columns.iter().all(|c| c.values.iter().all(|v| v.is_finite())))
        );
    }
}
