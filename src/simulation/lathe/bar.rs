//! The bar's bending modes while the tools travel along it and turn it down behind them.

use super::mode::ModeAt;
use super::process::ModesAt;
use crate::plant::cut_terms::CutTerms;
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

    /// Modes with the tools where `terms` has them and everything beyond turned down, with what the effects
    /// do to the bar.
    ///
    /// First mode by Rayleigh's quotient with the unworn shape: area falls with d^2, moment of area with
    /// d^4, weighted by phi^2 and phi''^2 of the turned part. Checked by:
    /// `turning_down_the_end_raises_the_frequency`.
    #[must_use]
    pub fn modes_at(&self, terms: &CutTerms) -> ModesAt {
        let share = (terms.at.position_m / self.workpiece.projection_length_m()).clamp(0.0, 1.0);
        let place = share * POINTS as f64;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 <= place <= POINTS")]
        let index = (place.floor() as usize).min(POINTS - 1);
        let part = place - index as f64;
        let beyond = |k: usize| self.beyond[index][k] * (1.0 - part) + self.beyond[index + 1][k] * part;
        let ratio = 1.0 - 2.0 * self.removed_m / self.workpiece.diameter_m();
        let lighter = 1.0 - (1.0 - ratio.powi(2)) * beyond(0);
        let softer = 1.0 - (1.0 - ratio.powi(4)) * beyond(1);
        let bar = terms.bar_at_tools();
        let raised = (softer / lighter).sqrt();
        let plane = |share: f64, frequency_hz: f64| ModeAt {
            mass_kg: bar.mass_kg * lighter,
            frequency_hz: frequency_hz * raised,
            damping_ratio: bar.damping_ratio,
            shape: bar.shape * share.abs().sqrt(),
            output: bar.shape * share.abs().sqrt() * share.signum(),
        };
        let other = terms.other_plane_share();
        let mut modes = vec![plane(1.0 - other, bar.frequency_hz)];
        if let Some(second) = terms.second_plane {
            modes.push(plane(other, second.frequency_hz + terms.frequency_shift_hz));
        }
        let of_stiffness = |stiffness_n_m: f64, hz: f64, damping_ratio: f64, shape: f64| ModeAt {
            mass_kg: stiffness_n_m / (TAU * hz).powi(2),
            frequency_hz: hz,
            damping_ratio,
            shape,
            output: shape,
        };
        if let Some(second) = terms.second_mode {
            let shape = bar.straight_shape;
            modes.push(of_stiffness(second.stiffness_n_m, second.frequency_hz, second.damping_ratio, shape));
        }
        if self.with_second_mode && !self.workpiece.is_tapped() {
            let shape = shape(SECOND_MODE_ROOT, share);
            modes.push(ModeAt {
                mass_kg: bar.mass_kg * lighter,
                frequency_hz: bar.frequency_hz * raised * SECOND_OVER_FIRST,
                damping_ratio: bar.damping_ratio,
                shape,
                output: shape,
            });
        }
        let holder =
            terms.turret.map(|t| of_stiffness(t.stiffness_n_m, t.frequency_hz, t.damping_ratio, 1.0));
        ModesAt { bar: modes, holder }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::cut_terms::CutCondition;
    use crate::plant::scenario::Scenario;

    #[test]
    fn turning_down_the_end_raises_the_frequency() {
        let scenario = Scenario::default();
        let workpiece = scenario.workpiece;
        let bar = Bar::new(workpiece, 0.2e-3, true);
        let first = |position_m| {
            let at = CutCondition { position_m, ..CutCondition::of(&scenario) };
            bar.modes_at(&CutTerms::of(&scenario, &at)).bar[0].frequency_hz
        };
        let fresh = first(0.180);
        assert!((fresh - workpiece.bending_frequency_hz()).abs() < 1e-6);
        let half = first(0.090);
        assert!(half > fresh * 1.005, "{half} against {fresh}");
        // All of it turned down is a thinner bar: f falls with d.
        let all = first(0.0);
        let thinner = workpiece.with_diameter_m(0.0249 - 0.4e-3).unwrap().bending_frequency_hz();
        assert!((all / thinner - 1.0).abs() < 1e-9, "{all} against {thinner}");
    }
}
