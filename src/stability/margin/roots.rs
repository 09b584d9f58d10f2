//! Roots of the cut in the analysis band, and what the posterior says of the rightmost one.

use super::model::{Cut, Parameters};
use crate::keyframe::keep;
use nalgebra::Complex;
use std::f64::consts::PI;

/// Roots that are followed: the lobes that can become the rightmost one.
pub(super) const FOLLOWED: usize = 6;
/// Longest step of Newton's method, 1/s: the exponentials bend over 1/tau.
const LONGEST_STEP_1_S: f64 = 40.0;
const STEPS: usize = 30;
const EXACT_1_S: f64 = 1e-6;

/// Roots in a band, rightmost first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Roots {
    found: [Complex<f64>; FOLLOWED],
    count: usize,
}

impl Default for Roots {
    fn default() -> Self {
        Self { found: [Complex::new(0.0, 0.0); FOLLOWED], count: 0 }
    }
}

keep!(Roots { found, count } if |s| s.count <= FOLLOWED);

impl Roots {
    /// Rightmost first.
    pub(super) fn iter(&self) -> impl Iterator<Item = Complex<f64>> + '_ {
        self.found[..self.count].iter().copied()
    }

    /// The rightmost.
    pub(super) fn first(&self) -> Option<Complex<f64>> {
        self.iter().next()
    }

    /// Takes one in, unless it is there or farther left than all that are followed.
    pub(super) fn insert(&mut self, root: Complex<f64>) {
        if self.iter().any(|known| (known - root).norm() < 1.0) {
            return;
        }
        let place = self.iter().take_while(|known| known.re >= root.re).count();
        if place == FOLLOWED {
            return;
        }
        self.count = (self.count + 1).min(FOLLOWED);
        self.found[place..self.count].rotate_right(1);
        self.found[place] = root;
    }
}

/// Newton's method from `start`; nothing where it does not end.
pub(super) fn descend(cut: &Cut, start: Complex<f64>) -> Option<Complex<f64>> {
    let mut s = start;
    for _ in 0..STEPS {
        let [value, slope] = cut.characteristic(s);
        let mut step = value / slope;
        let length = step.norm();
        if !length.is_finite() {
            return None;
        }
        if length > LONGEST_STEP_1_S {
            step *= LONGEST_STEP_1_S / length;
        }
        s -= step;
        if length < EXACT_1_S {
            return Some(s);
        }
    }
    None
}

/// Where the search begins: a quarter of 1/T apart over the band, where neighbouring lobes are 1/T apart.
pub(super) fn seed(cut: &Cut, band_hz: [f64; 2], number: usize) -> Option<Complex<f64>> {
    const USUAL_DAMPING_1_S: f64 = 12.0;
    let step_hz = 0.25 / cut.turn_s();
    let hz = band_hz[0] - step_hz + number as f64 * step_hz;
    (hz < band_hz[1] + step_hz).then(|| Complex::new(-USUAL_DAMPING_1_S, 2.0 * PI * hz))
}

/// Whether a root lies in the band.
pub(super) fn inside(root: Complex<f64>, band_hz: [f64; 2]) -> bool {
    let hz = root.im / (2.0 * PI);
    (band_hz[0]..=band_hz[1]).contains(&hz)
}

/// Margin of a cut much like the one whose roots are known, and how high the highest line of its roots stands
/// over the noise.
pub(super) fn margin_and_line(cut: &Cut, roots: &Roots) -> Option<[f64; 2]> {
    let of = |root: Complex<f64>| {
        let density = cut.density(root.im / (2.0 * PI));
        [-root.re, density.cut / (density.total - density.cut)]
    };
    let found = roots.iter().filter_map(|root| descend(cut, root)).map(of);
    found.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
}

/// Points by which a Gaussian is represented: spread evenly (a sequence of the generalised golden ratio,
/// Roberts 2018) and turned into normal numbers by pairs (Box and Muller 1958), each with its mirror image.
pub(super) fn normal_points(pairs: usize) -> Vec<Parameters> {
    // Root of x^11 = x + 1, for ten coordinates.
    let mut ratio: f64 = 1.0;
    for _ in 0..60 {
        ratio = (1.0 + ratio).powf(1.0 / 11.0);
    }
    let mut points = Vec::with_capacity(2 * pairs);
    for i in 1..=pairs {
        let uniform = |k: i32| (0.5 + i as f64 * ratio.powi(-k)).fract();
        let mut point = Parameters::zeros();
        for pair in 0..5 {
            let radius = (-2.0 * uniform(2 * pair + 1).max(1e-12).ln()).sqrt();
            let (sine, cosine) = (2.0 * PI * uniform(2 * pair + 2)).sin_cos();
            #[expect(clippy::cast_sign_loss, reason = "0 to 4")]
            let at = 2 * pair as usize;
            point[at] = radius * cosine;
            if let Some(next) = point.get_mut(at + 1) {
                *next = radius * sine;
            }
        }
        points.push(point);
        points.push(-point);
    }
    points
}

/// Value below which a share of the sorted values lies.
pub(super) fn quantile(sorted: &[f64], share: f64) -> f64 {
    let place = share * (sorted.len() - 1) as f64;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside of the list")]
    let below = place.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (place - place.floor()) * (sorted[above] - sorted[below])
}

/// Every root in a band at once.
#[cfg(test)]
pub(super) fn all(cut: &Cut, band_hz: [f64; 2]) -> Roots {
    let mut roots = Roots::default();
    for number in 0..200 {
        let Some(seed) = seed(cut, band_hz, number) else { break };
        if let Some(root) = descend(cut, seed).filter(|r| inside(*r, band_hz)) {
            roots.insert(root);
        }
    }
    roots
}

#[cfg(test)]
mod tests {
    use super::super::model::tests::{example, mapped};
    use super::*;

    /// Against the search of the stability map, which shares neither seeds nor window with this one.
    #[test]
    fn the_rightmost_root_is_that_of_the_map() {
        for pitch_rad in [0.0, 0.03, 0.055, 0.07, 0.085] {
            let (condition, at) = example(pitch_rad);
            let wanted = mapped(pitch_rad);
            let found = all(&Cut::new(&condition, &at), [480.0, 760.0]).first().unwrap();
            assert!((found.re - wanted.growth_1_s).abs() < 1e-4, "{pitch_rad}: {found} {wanted:?}");
        }
    }

    #[test]
    fn the_points_are_normal() {
        let points = normal_points(64);
        for k in 0..9 {
            let mean: f64 = points.iter().map(|p| p[k]).sum::<f64>() / 128.0;
            let square: f64 = points.iter().map(|p| p[k] * p[k]).sum::<f64>() / 128.0;
            assert!(mean.abs() < 1e-12 && (square - 1.0).abs() < 0.15, "{k}: {square}");
        }
    }

    #[test]
    fn roots_stand_in_order() {
        let mut roots = Roots::default();
        for re in [-5.0, -1.0, -9.0, -3.0, -7.0, -2.0, -8.0, 1.0] {
            roots.insert(Complex::new(re, 100.0 * re));
        }
        let got: Vec<f64> = roots.iter().map(|r| r.re).collect();
        assert_eq!(got, [1.0, -1.0, -2.0, -3.0, -5.0, -7.0]);
    }
}
