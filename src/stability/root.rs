//! The rightmost root of the two-delay equation.

use super::characteristic::Scaled;
use super::lanes::Descend;
use crate::plant::cutting::TwoDelay;
use crate::signal::dispatch::{Fast, run};
use nalgebra::Complex;
use std::f64::consts::{PI, TAU};

/// A root of the characteristic equation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Root {
    /// Real part: positive grows.
    pub growth_1_s: f64,
    /// Imaginary part over 2 pi, not negative.
    pub frequency_hz: f64,
}

/// The root farthest to the right: growth and frequency of small vibration of the bar.
///
/// Bending vibration only: the slow fading of surface marks below half the natural frequency, which can
/// never grow, is left out.
///
/// Searched from seeds a quarter of 1/tau apart over the window that can hold it; the window follows from
/// the best root found so far. Requires: positive mass and stiffness, delays not negative.
/// Cost: about 4 us. Source: facts of the two-delay equation; window from the triangle inequality.
/// Checked by: `printed_roots`, `no_root_is_missed`, collocation of the delay operator (tests).
#[must_use]
pub fn rightmost_root(equation: &TwoDelay) -> Root {
    search(&Scaled::new(equation).of_bending(), None, Fast::detect_wide())
}

/// The same with a guess, such as the root of an equation much like it. The guess is where the search
/// begins, no more: all of the window is searched.
pub(super) fn rightmost_root_near(equation: &TwoDelay, guess: Option<Root>, fast: Fast) -> Root {
    search(&Scaled::new(equation).of_bending(), guess, fast)
}

/// Seeds that are followed in one go.
const SEEDS: usize = 64;

/// Roots found so far.
struct Search<'a> {
    scaled: &'a Scaled,
    fast: Fast,
    best: Option<Complex<f64>>,
}

impl Search<'_> {
    fn worth(&self) -> f64 {
        self.best.map_or(f64::NEG_INFINITY, |best| best.re)
    }

    /// Follows up to `SEEDS` seeds; what is worth it is polished, the one farthest to the right first: it may
    /// make the others worthless.
    fn follow(&mut self, seeds: &[Complex<f64>]) {
        let (scaled, worth) = (self.scaled, self.worth());
        let mut led = [Complex::new(0.0, 0.0); SEEDS];
        let found = run(self.fast, Descend { scaled, seeds, worth, led: &mut led });
        let led = &mut led[..found];
        led.sort_unstable_by(|a, b| b.re.total_cmp(&a.re));
        for near in led {
            let again =
                |best: Complex<f64>| (near.re - best.re).abs() + (near.im.abs() - best.im).abs() < 1e-3;
            if !self.best.is_some_and(again) {
                self.polish(*near);
            }
        }
    }

    fn polish(&mut self, near: Complex<f64>) {
        if let Some(root) = self.scaled.polish(near, self.worth())
            && root.im >= self.scaled.lowest_rad_s
            && root.re > self.worth()
        {
            self.best = Some(root);
        }
    }
}

fn search(scaled: &Scaled, guess: Option<Root>, fast: Fast) -> Root {
    let in_cut = (scaled.stiffness + 2.0 * scaled.cutting).sqrt();
    let tau = scaled.longest_delay_s().max(1e-6);
    let mut search = Search { scaled, fast, best: None };
    // A first bound: the guess, or the bar's own root and roots near the in-cut frequency.
    let own = Complex::new(-scaled.damping / 2.0, in_cut);
    if let Some(root) = guess {
        search.polish(Complex::new(root.growth_1_s, TAU * root.frequency_hz));
    }
    if search.best.is_none() {
        let near = |offset: f64| {
            let w = in_cut + offset * PI / tau;
            Complex::new(scaled.likely_growth(w.abs()), w)
        };
        search.follow(&[own, near(-1.5), near(-0.5), near(0.5), near(1.5)]);
    }
    let bound = search.best.map_or(-scaled.damping / 2.0 - 3.0 / tau, |b| b.re);
    let (low, high) = scaled.window_rad_s(bound);
    let low = low.max(scaled.lowest_rad_s);
    // One root about every 2 pi/tau; two seeds for each.
    let step = (PI / tau).min((high - low) / 6.0).max((high - low) / 4000.0).max(1e-3);
    let (mut w, mut seeds, mut count) = (low, [own; SEEDS], 0);
    while w <= high + step {
        seeds[count] = Complex::new(scaled.likely_growth(w), w);
        count += 1;
        if count == SEEDS {
            search.follow(&seeds);
            count = 0;
        }
        w += step;
    }
    search.follow(&seeds[..count]);
    let root = search.best.unwrap_or(own);
    Root { growth_1_s: root.re, frequency_hz: root.im / TAU }
}

#[cfg(test)]
mod tests {
    use super::super::roots_right_of;
    use super::*;
    use crate::plant::scenario::{RawScenario, Scenario};

    /// 20 000 have been run; the gate takes fewer.
    const CASES: usize = 1000;

    fn root(pitch_rad: f64, position_share: f64) -> Root {
        let raw = RawScenario {
            pitch_difference_rad: pitch_rad,
            position_m: Some(0.18 * position_share),
            ..RawScenario::default()
        };
        rightmost_root(&TwoDelay::from_scenario(&Scenario::new(&raw).unwrap()))
    }

    /// Answers of an independent program for the default scenario; phase in pi at 652 Hz.
    #[test]
    fn printed_roots() {
        let rows = [
            (0.0, 35.67, Some(649.57)),
            (0.5, 23.61, Some(649.57)),
            (0.7, 8.32, Some(649.52)),
            (0.8, -4.76, Some(649.43)),
            (1.0, -43.01, None),
            (1.2, -5.91, Some(667.00)),
            (3.0, -8.57, Some(557.44)),
            (5.0, 6.89, Some(576.78)),
        ];
        for (phase, growth, frequency) in rows {
            let got = root(phase * PI * 20.0 / 652.0, 1.0);
            assert!((got.growth_1_s - growth).abs() < 0.006, "{phase} pi: {got:?}, expected {growth}");
            if let Some(f) = frequency {
                assert!((got.frequency_hz - f).abs() < 0.006, "{phase} pi: {got:?}, expected {f}");
            }
        }
        for (share, growth, frequency) in [(0.9, 34.81, 610.95), (0.7, 28.38, 569.38), (0.5, 11.97, 532.09)] {
            let got = root(0.0, share);
            assert!(
                (got.growth_1_s - growth).abs() < 0.006 && (got.frequency_hz - frequency).abs() < 0.006,
                "{got:?}"
            );
        }
    }

    #[test]
    fn a_bar_that_is_not_cut_rings_at_its_own() {
        let scenario = Scenario::default();
        let mut equation = TwoDelay::from_scenario(&scenario);
        equation.cutting_stiffness_n_m = 0.0;
        equation.damping_n_s_m = scenario.workpiece.modal_damping_n_s_m();
        let got = rightmost_root(&equation);
        let wanted = 0.01 * TAU * scenario.workpiece.bending_frequency_hz();
        assert!((got.growth_1_s + wanted).abs() < 1e-6, "{got:?}");
    }

    /// Nothing lies right of the root that the search gives, by a count that shares nothing with it.
    #[test]
    fn no_root_is_missed() {
        let mut random = 1u64;
        let mut uniform = move |low: f64, high: f64| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            low + (high - low) * ((random >> 11) as f64 / (1u64 << 53) as f64)
        };
        for case in 0..CASES {
            let natural = TAU * uniform(150.0, 1200.0);
            let (mass_kg, turn_s) = (uniform(0.05, 1.0), 60.0 / uniform(250.0, 4000.0));
            let stiffness_n_m = mass_kg * natural * natural;
            let zeta = 10f64.powf(uniform(-2.7, -0.9));
            let shift = uniform(-0.3, 0.3) * turn_s / 2.0;
            let equation = TwoDelay {
                mass_kg,
                damping_n_s_m: 2.0 * zeta * natural * mass_kg,
                stiffness_n_m,
                cutting_stiffness_n_m: stiffness_n_m * 10f64.powf(uniform(-3.0, 0.0)),
                delay_1_s: turn_s / 2.0 - shift,
                delay_2_s: turn_s / 2.0 + shift,
            };
            let got = search(&Scaled::new(&equation), None, Fast::detect_wide());
            let s = Complex::new(got.growth_1_s, TAU * got.frequency_hz);
            assert!(equation.characteristic(s).norm() < 1e-6 * stiffness_n_m, "case {case}: not a root");
            let right = roots_right_of(&equation, got.growth_1_s + 0.01);
            assert_eq!(right, 0, "case {case}: {right} roots right of {got:?} of {equation:?}");
            assert!(
                roots_right_of(&equation, got.growth_1_s - 0.01) >= 1,
                "case {case}: the count sees none"
            );
            let bending = rightmost_root(&equation).growth_1_s;
            let same = (bending - got.growth_1_s).abs() < 1e-6;
            assert!(
                same || bending < got.growth_1_s && got.growth_1_s < 0.0,
                "case {case}: {bending} {got:?}"
            );
        }
    }
}
