//! What the steps of a position make of the balance, were they elsewhere: a null world beside the turned
//! residual.
//!
//! ```text
//! e = round(x + s) - (x + s),     left = -(M e'' + C e' + K e) - F_c (tanh((v + e') / v_s) - tanh(v / v_s))
//! ```
//! Rounding is coloured by its derivatives and repeats with the position. Steps that are shifted by s make an
//! error of the same kind that knows of no law: what a hypothesis or a number takes of it, it may have of the
//! recorded one.

use super::columns::{Ground, TimeColumn};
use super::signals::{Layout, Track};
use crate::plant::effects::coulomb_friction::sliding_direction;

/// What null worlds are turned by: shares of a recording, and of a step.
pub(super) const QUARTERS: [f64; 3] = [0.25, 0.5, 0.75];

/// A column for each shift. None of two positions: what is coarse beside the stretch is taken as one.
pub(super) fn rounding(ground: &Ground<'_>) -> Vec<TimeColumn> {
    let s = ground.signals;
    if s.layout == Layout::TwoPositions {
        return Vec::new();
    }
    let of = |shift: f64| {
        let step_m = s.steps_m[0];
        TimeColumn::at(0, s.each(|track| left(ground, track, (step_m, shift * step_m))))
    };
    QUARTERS.map(of).to_vec()
}

/// What rounding leaves of one recording; nothing where it has no steps.
fn left(ground: &Ground<'_>, track: &Track, (step_m, shift_m): (f64, f64)) -> Vec<f64> {
    let (s, m) = (ground.signals, &ground.mechanics);
    let side = &track.sides[0];
    let error: Vec<f64> =
        side.x_m.iter().map(|x| x + shift_m).map(|x| (x / step_m).round() * step_m - x).collect();
    let direction = |v: f64| sliding_direction(v, ground.smoothing_m_s);
    let turned = side.v_m_s.iter().zip(s.speed_m_s(0, &error)).map(|(v, e)| direction(v + e) - direction(*v));
    let turned = s.filtered(track, &turned.collect::<Vec<f64>>(), 0);
    let [e, speed, accel] = [0, 1, 2].map(|order| s.filtered(track, &error, order));
    let spring = if s.layout == Layout::Locked { m.stiffness_n_m } else { 0.0 };
    let of = |k: usize| {
        let moved = m.stage_mass_kg * accel[k] + m.stage_damping_n_s_m * speed[k] + spring * e[k];
        -(moved + m.stage_coulomb_n * turned[k])
    };
    (0..turned.len()).map(of).collect()
}
