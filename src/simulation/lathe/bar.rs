//! The bar's bending modes while the tools travel along it and turn it down behind them.

use super::process::ModeAt;
use crate::plant::workpiece::{FIRST_MODE_ROOT, Workpiece};
use std::f64::consts::TAU;

/// Second bending frequency of a cantilever over its first: (4.6941 / 1.8751)^2.
const SECOND_OVER_FIRST: f64 = 6.2669;
/// First zero of the second mode shape's equation, cos x cosh x = -1.
const SECOND_MODE_ROOT: f64 = 4.694_091_132_974_175;
const POINTS: usize = 400;

/// Modes of a bar whose free part has been turned down by `removed_m` of radius.
#[derive(Debug, Clone, PartialEq)]
pub struct Bar {
    workpiece: Workpiece,
    removed_m: f64,
    with_second_mode: bool,
    /// Share of modal mass and of modal stiffness of the first mode between z and the free end.
    beyond: Vec<[f64; 2]>,
}

fn shape(root: f64, share: f64) -> f64 {
    let s = (root.cosh() + root.cos()) / (root.sinh() + root.sin());
    let x = root * share;
    let at = |x: f64| x.cosh() - x.cos() - s * (x.sinh() - x.sin());
    at(x) / at(root)
}

/// Curvature of the first mode, not scaled.
fn curvature(share: f64) -> f64 {
    let r = FIRST_MODE_ROOT;
    let s = (r.cosh() + r.cos()) / (r.sinh() + r.sin());
    let x = r * share;
    x.cosh() + x.cos() - s * (x.sinh() + x.sin())
}

impl Bar {
    /// A bar that the tools turn down by `removed_m` of radius as they pass.
    #[must_use]
    pub fn new(workpiece: Workpiece, removed_m: f64, with_second_mode: bool) -> Self {
        let mut beyond = vec![[0.0; 2]; POINTS + 1];
        for i in (0..POINTS).rev() {
            let share = (i as f64 + 0.5) / POINTS as f64;
            beyond[i] = [
                beyond[i + 1][0] + shape(FIRST_MODE_ROOT, share).powi(2),
                beyond[i + 1][1] + curvature(share).powi(2),
            ];
        }
        let all = beyond[0];
        for pair in &mut beyond {
            *pair = [pair[0] / all[0], pair[1] / all[1]];
        }
        Self { workpiece, removed_m, with_second_mode, beyond }
    }

    /// Modes with the tools at `position_m` from the chuck and everything beyond turned down.
    ///
    /// First mode by Rayleigh's quotient with the unworn shape: area falls with d^2, moment of area with
    /// d^4, weighted by phi^2 and phi''^2 of the turned part. Checked by:
    /// `turning_down_the_end_raises_the_frequency`.
    #[must_use]
    pub fn modes_at(&self, position_m: f64) -> Vec<ModeAt> {
        let share = (position_m / self.workpiece.projection_length_m()).clamp(0.0, 1.0);
        let place = share * POINTS as f64;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 <= place <= POINTS")]
        let index = (place.floor() as usize).min(POINTS - 1);
        let part = place - index as f64;
        let beyond = |k: usize| self.beyond[index][k] * (1.0 - part) + self.beyond[index + 1][k] * part;
        let ratio = 1.0 - 2.0 * self.removed_m / self.workpiece.diameter_m();
        let mass_kg = self.workpiece.modal_mass_kg() * (1.0 - (1.0 - ratio.powi(2)) * beyond(0));
        let stiffness = self.workpiece.modal_stiffness_n_m() * (1.0 - (1.0 - ratio.powi(4)) * beyond(1));
        let frequency_hz = (stiffness / mass_kg).sqrt() / TAU;
        let damping_ratio = self.workpiece.raw().damping_ratio;
        let mut modes =
            vec![ModeAt { mass_kg, frequency_hz, damping_ratio, shape: shape(FIRST_MODE_ROOT, share) }];
        if self.with_second_mode {
            modes.push(ModeAt {
                mass_kg,
                frequency_hz: frequency_hz * SECOND_OVER_FIRST,
                damping_ratio,
                shape: shape(SECOND_MODE_ROOT, share),
            });
        }
        modes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turning_down_the_end_raises_the_frequency() {
        let workpiece = *crate::plant::scenario::Scenario::default().workpiece.raw();
        let workpiece = Workpiece::new(workpiece).unwrap();
        let bar = Bar::new(workpiece, 0.2e-3, true);
        let fresh = bar.modes_at(0.180)[0].frequency_hz;
        assert!((fresh - workpiece.bending_frequency_hz()).abs() < 1e-6);
        let half = bar.modes_at(0.090)[0].frequency_hz;
        assert!(half > fresh * 1.005, "{half} against {fresh}");
        // All of it turned down is a thinner bar: f falls with d.
        let all = bar.modes_at(0.0)[0].frequency_hz;
        let thinner = workpiece.with_diameter_m(0.0249 - 0.4e-3).unwrap().bending_frequency_hz();
        assert!((all / thinner - 1.0).abs() < 1e-9, "{all} against {thinner}");
    }
}
