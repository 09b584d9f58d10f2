//! Whether a line that stands out is a vibration that feeds itself or the answer of a lightly damped
//! mode to noise.
//!
//! Chatter grows exponentially and then stands: the logarithm of its power is a straight line in time,
//! with one bend. The power of noise through a filter, coloured by a mode or not, is exponentially
//! distributed and forgotten within the filter's length. With y = ln(power) at three instants a lag
//! apart,
//!
//! d = y(t) - 2 y(t - lag) + y(t - 2 lag)
//!
//! is zero for the one, and has the mean square 6 pi^2/6 = 9.9 for the other (the logarithm of an
//! exponential variable has the variance pi^2/6), whatever its level: no noise needs to be known.

/// Decisions between two of the three instants: 0.1 s, four lengths of the window that the power is
/// taken from.
const LAG: usize = 25;
/// Looks that are kept.
const KEPT: usize = 2 * LAG + 1;
/// No d counts as more: growth at 25 1/s that ends at once bends by this much. Noise has a mean square
/// of 7.4 then (6.4 where a mode of 5 Hz colours it), and over `MEMORY` less than 1.8 in one of 3000
/// looks at the worst.
const MOST: f64 = 5.0;
const NOISE: f64 = 5.5;
const LINE: f64 = 1.8;
/// ln(4): looks count while all three powers are so much over what is known there: known noise is so
/// three times in a row in e^-12 of the cases.
const LOUD: f64 = 1.386;
/// Looks after which the mean says something (0.6 s), and that it is over at most.
pub(super) const ENOUGH: f64 = 150.0;
const MEMORY: f64 = 200.0;
/// A line whose power is less than 1/e of what it was 0.2 s ago fades.
const FADES: f64 = -1.0;
/// Looks without a line that stands out after which it is another line: 0.1 s; and after which noise is
/// another: 1 s.
const GONE: u32 = 25;
const FORGOTTEN: u32 = 250;
/// A line within this is the same line.
const APART_HZ: f64 = 8.0;
/// Where there is less than this share of the strongest line for so many looks (40 ms), the line has
/// jumped.
const LESSER: f64 = 0.02;
const JUMPED: u32 = 10;
/// It may drift with speed and tools: of each look in the place of the line, 0.15 s.
const FOLLOWS: f64 = 0.027;

/// What is remembered of the line.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Scatter {
    line_hz: f64,
    /// ln(power over what is known), newest last, and how many there are.
    log_power: [f64; KEPT],
    filled: u64,
    mean_square: f64,
    looks: f64,
    away: u32,
    absent: u32,
}

crate::keyframe::keep!(Scatter { line_hz, log_power, filled, mean_square, looks, away, absent }
    if |s| s.filled <= KEPT as u64);

impl Scatter {
    pub(super) const NEW: Self = Self {
        line_hz: 0.0,
        log_power: [0.0; KEPT],
        filled: 0,
        mean_square: 0.0,
        looks: 0.0,
        away: 0,
        absent: FORGOTTEN,
    };

    /// Takes where the strongest line is at one decision, and whether it stands out; answers where to
    /// take its power from: where it was, while there is as much of it as of the strongest.
    pub(super) fn place(&mut self, line_hz: f64, stands_out: bool) -> Option<f64> {
        self.absent = if stands_out { 0 } else { (self.absent + 1).min(FORGOTTEN) };
        if self.absent >= GONE {
            self.filled = 0;
            self.forget_line();
            if self.absent == FORGOTTEN {
                self.forget();
            }
            return None;
        }
        if self.filled == 0 || self.away >= JUMPED {
            (self.line_hz, self.filled, self.away) = (line_hz, 0, 0);
        }
        let apart_hz = line_hz - self.line_hz;
        if apart_hz.abs() < APART_HZ {
            self.line_hz += FOLLOWS * apart_hz;
        }
        Some(self.line_hz)
    }

    /// The bank was emptied: what it shows begins anew.
    pub(super) fn start_anew(&mut self) {
        self.filled = 0;
    }

    /// Decisions for which it has been looked at without a break.
    pub(super) fn followed(&self) -> u64 {
        self.filled
    }

    /// Takes the power there, that of the strongest line, and that of the noise known there.
    pub(super) fn look(&mut self, power: f64, strongest: f64, known: f64) {
        self.away = if power < LESSER * strongest { self.away + 1 } else { 0 };
        self.log_power.rotate_left(1);
        self.log_power[KEPT - 1] = (power / known).max(f64::MIN_POSITIVE).ln();
        self.filled = (self.filled + 1).min(KEPT as u64);
        let [first, middle, last] = [0, LAG, 2 * LAG].map(|k| self.log_power[k]);
        let loud = first.min(middle).min(last) > LOUD;
        if self.filled == KEPT as u64 && loud {
            let bend = (first - 2.0 * middle + last).clamp(-MOST, MOST);
            self.looks = (self.looks + 1.0).min(MEMORY);
            self.mean_square += (bend * bend - self.mean_square) / self.looks;
        }
    }

    /// Whether it has fluctuated as noise does for long enough.
    pub(super) fn noise(&self) -> bool {
        self.looks >= ENOUGH && self.mean_square > NOISE
    }

    /// Where the line is that has stood, or grown steadily, for so many looks. What fades steadily rings
    /// down.
    pub(super) fn line_hz(&self, looks: f64) -> Option<f64> {
        let fades = self.log_power[KEPT - 1] - self.log_power[0] < FADES;
        (self.looks >= looks && self.mean_square < LINE && !fades).then_some(self.line_hz)
    }

    /// Whether it has not fluctuated so far, as far as it was looked at.
    pub(super) fn like_a_line(&self) -> bool {
        self.looks > 0.0 && self.mean_square < LINE
    }

    /// Whether it was looked at for so many looks and has fluctuated.
    pub(super) fn fluctuated(&self, looks: f64) -> bool {
        self.looks >= looks && self.mean_square >= LINE
    }

    /// Begins anew unless it fluctuated: a line that ended is not the next one, noise goes on.
    pub(super) fn forget_line(&mut self) {
        if self.mean_square < LINE {
            *self = Self { absent: self.absent, ..Self::NEW };
        }
    }

    /// Begins anew.
    pub(super) fn forget(&mut self) {
        *self = Self::NEW;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Complex;

    /// Verdicts (noise, line) over 8 s of the powers of a place, looked at every 4 ms, 100 times over
    /// what is known.
    fn verdicts(power: impl FnMut(u32) -> f64) -> [bool; 2] {
        let mut scatter = Scatter::NEW;
        (0..2000).map(power).fold([false; 2], |[noise, line], power| {
            if scatter.place(650.0, true).is_some() {
                scatter.look(power, power, 0.01);
            }
            [noise || scatter.noise(), line || scatter.line_hz(ENOUGH).is_some()]
        })
    }

    #[test]
    fn noise_scatters_and_a_line_does_not() {
        // Complex noise through two poles of 25 ms and through a mode whose amplitude fades at 15 1/s.
        let mut seed = 7u64;
        let mut uniform = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        let mut parts = [Complex::new(0.0, 0.0); 3];
        let keeps = [0.06f64, 0.16, 0.16].map(|x| (-x).exp());
        let mut noise = |_| {
            let mut x = Complex::new(uniform() + uniform(), uniform() + uniform());
            for (part, keep) in parts.iter_mut().zip(keeps) {
                *part = *part * keep + x;
                x = *part;
            }
            x.norm_sqr()
        };
        let _settled = (0..100).map(&mut noise).last();
        assert_eq!(verdicts(&mut noise), [true, false]);
        // Growth at 25 1/s from far below what is known, then a limit cycle that breathes by a tenth.
        let grown = |k: u32| (1e-9 * (0.2 * f64::from(k)).exp()).min(1.0 + 0.1 * (0.05 * f64::from(k)).sin());
        assert_eq!(verdicts(grown), [false, true]);
        // What rings down is steady and no line.
        assert_eq!(verdicts(|k| 1e9 * (-0.03 * f64::from(k)).exp()), [false, false]);
    }

    #[test]
    fn a_jump_to_another_lobe_is_no_noise() {
        let mut scatter = Scatter::NEW;
        for k in 0..1000 {
            let hopped = k > 500;
            let place = scatter.place(if hopped { 612.0 } else { 652.0 }, true).unwrap();
            let here = (place > 640.0) != hopped;
            scatter.look(if here { 1.0 } else { 1e-4 }, 1.0, 1e-6);
            assert!(!scatter.noise(), "{k}");
        }
        assert!((scatter.line_hz(ENOUGH).unwrap() - 612.0).abs() < 0.1);
    }
}
