//! A window of the band: what is in it, what is known beside it, and how well a line fits it.

use super::Reason;
use super::criteria::{CRITERIA, Levels};
use super::cut_level::MeanForce;
use super::history::History;
use super::whitening::Whitener;
use crate::keyframe::keep;
use nalgebra::Complex;
use std::f64::consts::TAU;

type C = Complex<f64>;

/// What a window says.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Detection {
    /// Least evidence over its threshold.
    pub(super) evidence: f64,
    /// Evidence against noise alone, over its threshold.
    pub(super) over_noise: f64,
    pub(super) reason: Reason,
    /// Relative to the band's centre.
    pub(super) offset_hz: f64,
    pub(super) growth_1_s: f64,
    /// Power of the line over the noise known at its place.
    pub(super) contrast: f64,
    /// Power of the line, N^2, where it is anything.
    pub(super) power_n2: f64,
    /// Evidence that it grew and was not switched on, where that was asked.
    pub(super) grown_nats: Option<f64>,
    /// Whether it moved here from elsewhere.
    pub(super) moved: bool,
}

keep!(Detection {
    evidence,
    over_noise,
    reason,
    offset_hz,
    growth_1_s,
    contrast,
    power_n2,
    grown_nats,
    moved
});

/// What a sub-band is told with each value.
#[derive(Debug, Clone, Copy)]
pub(super) struct Conditions {
    pub(super) angle_turns: f64,
    pub(super) speed_hz: f64,
    pub(super) speed_change_1_s: f64,
    /// theta_2 - theta_1 of two opposed tools, where it is known.
    pub(super) pitch_rad: Option<f64>,
    pub(super) watched_hz: [f64; 2],
    /// Whether what is heard is noise.
    pub(super) learns: bool,
    /// Whether a line stands declared: it needs no proof but its power.
    pub(super) alarm: bool,
    /// Whether and how the mean force tells of the cut now.
    pub(super) mean: MeanForce,
    /// Whether the series has a mean that tells at other times.
    pub(super) has_mean: bool,
    /// Mean force of the cut, N.
    pub(super) mean_n: f64,
    /// Mean square of the sensor's noise, N^2.
    pub(super) sensor_n2: f64,
}

/// What is known of the noise of this cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Knowledge {
    /// Nothing, nor of that in air.
    Nothing,
    /// Less than its memory holds: what is in it was learned with the line, or in air.
    Young,
    /// As much as its memory holds.
    Known,
}

/// Where the tools are, by the mean force.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Tools {
    /// There is none that tells, nor when another cut begins.
    Untold,
    /// In the cut.
    Cutting,
    /// Of an acceleration, which has no mean: it fell at once, and nothing rose since.
    Left,
    /// None is seen in it: not yet, or they left, and may be back in a cut that is shallow beside the noise.
    Unseen,
}

/// What is known beside the window.
#[derive(Debug, Clone, Copy)]
pub(super) struct Context {
    pub(super) levels: Levels,
    pub(super) centre_hz: f64,
    pub(super) rate_hz: f64,
    /// 0 where it is not known.
    pub(super) speed_hz: f64,
    pub(super) pitch_rad: Option<f64>,
    /// Of a line at the centre that goes with the speed.
    pub(super) sweep_hz_s: f64,
    /// Relative to the centre.
    pub(super) watched_hz: [f64; 2],
    /// Values in which the beginning of a line is looked for.
    pub(super) seen: usize,
    pub(super) noise: Knowledge,
    /// Whether the orders of this cut are known.
    pub(super) orders: bool,
    /// Whether a line stands declared.
    pub(super) alarm: bool,
    pub(super) tools: Tools,
    /// Most power that the noise of a stable cut has at a place, N^2; infinite where it is not known.
    pub(super) stable_n2: f64,
    pub(super) whitener: Whitener,
}

impl Context {
    /// Whether the noise of this cut is not known yet.
    pub(super) fn is_young(&self) -> bool {
        self.noise != Knowledge::Known
    }

    /// Evidence from which on a beginning is told. All else that begins with a cut is there at once, too.
    pub(super) fn beginning_nats(&self) -> f64 {
        if self.is_young() { self.levels.cause_nats } else { self.levels.switched_nats }
    }
}

/// One window and its best line.
pub(super) struct Window<'a> {
    pub(super) e: &'a [C],
    pub(super) chirp: &'a [C],
    pub(super) history: &'a History,
    /// Values, window and past, as far back as what is heard is one thing.
    pub(super) seen: usize,
    pub(super) context: &'a Context,
    pub(super) total: f64,
    pub(super) line: Detection,
    pub(super) which: usize,
}

/// Evidence, nats, that a line of `power_n2` is louder than the noise of a stable cut: the power of a line of
/// noise is exponential about a mean that is known as a gamma distribution is.
pub(super) fn loudness_nats(power_n2: f64, stable_n2: f64) -> f64 {
    let shape = CRITERIA.stable_shape;
    shape * (1.0 + power_n2 / (shape * stable_n2)).ln()
}

/// Evidence, nats, that a line of `power_n2` that grows no more is chatter. Chatter stands where the tool
/// leaves the cut in each cycle: at the size of the mean force, above the noise of a stable cut. It stands at
/// less as seldom as its power is less, until tones are as frequent.
pub(super) fn stands_nats(power_n2: f64, stable_n2: f64) -> f64 {
    let share = if stable_n2.is_finite() { power_n2 / stable_n2 } else { 1.0 };
    share.ln().clamp(-CRITERIA.unseen_nats, 0.0)
}

impl Detection {
    /// No more evidence than this, for that reason.
    pub(super) fn least(&mut self, evidence: f64, reason: Reason) {
        if evidence < self.evidence {
            (self.evidence, self.reason) = (evidence.max(0.0), reason);
        }
    }
}

/// Lines exp((growth + j 2 pi f) t) over the last `e`, each alone: energies of their least-squares fits.
///
/// |sum_q conj(s_q) e_q|^2 / sum_q |s_q|^2 with s_q = exp(-(growth + j 2 pi f) age): the first sum by
/// Horner's rule, the second as a geometric series. Checked by: `energies_are_those_of_the_sums`.
pub(super) fn fits<const K: usize>(e: &[C], turns: [f64; K], growth: f64) -> [f64; K] {
    let shrinks = (-growth).exp();
    let (mut re, mut im) = ([0.0; K], [0.0; K]);
    let (sin, cos): ([f64; K], [f64; K]) =
        (turns.map(|f| shrinks * (TAU * f).sin()), turns.map(|f| shrinks * (TAU * f).cos()));
    for x in e {
        for k in 0..K {
            let was = re[k];
            re[k] = was * cos[k] - im[k] * sin[k] + x.re;
            im[k] = was * sin[k] + im[k] * cos[k] + x.im;
        }
    }
    let n = e.len() as f64;
    let energy =
        if growth.abs() < 1e-9 { n } else { (-2.0 * growth * n).exp_m1() / (-2.0 * growth).exp_m1() };
    std::array::from_fn(|k| (re[k] * re[k] + im[k] * im[k]) / energy)
}

/// The same of one.
pub(super) fn fit(e: &[C], turns: f64, growth: f64) -> f64 {
    fits(e, [turns], growth)[0]
}

/// Energy that two templates explain together.
pub(super) fn fit_two(e: &[C], pair: impl Fn(usize) -> [C; 2]) -> f64 {
    let (mut uu, mut vv, mut uv, mut ue, mut ve) = (0.0, 0.0, C::ZERO, C::ZERO, C::ZERO);
    for (q, x) in e.iter().enumerate() {
        let [u, v] = pair(q);
        uu += u.norm_sqr();
        vv += v.norm_sqr();
        uv += u.conj() * v;
        ue += u.conj() * x;
        ve += v.conj() * x;
    }
    if uu <= 0.0 {
        return 0.0;
    }
    let left = vv - uv.norm_sqr() / uu;
    let one = ue.norm_sqr() / uu;
    if left <= 1e-9 * vv { one } else { one + (ve - uv.conj() * ue / uu).norm_sqr() / left }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stands_is_chatter_the_more_seldom_the_smaller_it_is() {
        let most_nats = -CRITERIA.unseen_nats;
        for (power_n2, stable_n2, nats) in [
            (9.0, 3.0, 0.0),
            (3.0, 3.0, 0.0),
            (1.5, 3.0, 0.5f64.ln()),
            (1e-9, 3.0, most_nats),
            (0.0, 3.0, most_nats),
        ] {
            assert!((stands_nats(power_n2, stable_n2) - nats).abs() < 1e-12, "{power_n2}");
        }
        // Where nothing is known of the force nothing is known of the size.
        assert_eq!(stands_nats(1e-9, f64::INFINITY), 0.0);
    }

    #[test]
    fn energies_are_those_of_the_sums() {
        let e: Vec<C> =
            (0..48).map(|q| C::from_polar(1.0 + 0.1 * f64::from(q % 7), f64::from(q * q))).collect();
        for (turns, growth) in [(0.1, 0.0), (-0.23, 0.08), (0.4, -0.16)] {
            let line = |q: usize| C::from_polar((-growth * q as f64).exp(), -TAU * turns * q as f64);
            let sum: C = e.iter().rev().enumerate().map(|(q, x)| line(q).conj() * x).sum();
            let energy: f64 = (0..e.len()).map(|q| line(q).norm_sqr()).sum();
            assert!((fit(&e, turns, growth) * energy / sum.norm_sqr() - 1.0).abs() < 1e-9);
        }
    }
}
