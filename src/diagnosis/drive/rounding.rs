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
use super::signals::{Layout, Signals, Track};
use crate::plant::effects::Port;
use crate::plant::effects::coulomb_friction::sliding_direction;

/// What null worlds are turned by: shares of a recording, and of a step.
pub(super) const QUARTERS: [f64; 3] = [0.25, 0.5, 0.75];

/// A column for each shift; of two positions that of both encoders together.
pub(super) fn rounding(ground: &Ground<'_>) -> Vec<TimeColumn> {
    let s = ground.signals;
    let of = |shift: f64| {
        if s.layout == Layout::TwoPositions {
            let encoders = [Port::MotorEncoder, Port::StageEncoder].into_iter();
            let columns: Vec<TimeColumn> =
                encoders.flat_map(|port| of_encoder(ground, port, shift)).collect();
            return TimeColumn::sum(columns.iter().map(|c| (c, 1.0)));
        }
        let step_m = s.steps_m[0];
        TimeColumn::at(0, s.each(|track| left(ground, track, (step_m, shift * step_m))))
    };
    QUARTERS.map(of).to_vec()
}

/// Position, rounded to steps that are shifted, less the position: what rounding makes, elsewhere; nothing
/// without steps.
fn error_m(x_m: &[f64], step_m: f64, shift_m: f64) -> Vec<f64> {
    if step_m <= 0.0 {
        return vec![0.0; x_m.len()];
    }
    x_m.iter().map(|x| x + shift_m).map(|x| (x / step_m).round() * step_m - x).collect()
}

/// What the steps of one of two encoders make of both balances, were they elsewhere; friction's turn, which
/// is not looked at where steps hide it, apart.
fn of_encoder(ground: &Ground<'_>, port: Port, shift: f64) -> Vec<TimeColumn> {
    let side = usize::from(port == Port::StageEncoder);
    let step_m = ground.signals.steps_m[side];
    ground.encoder(port, |track| vec![error_m(&track.sides[side].x_m, step_m, shift * step_m)])
}

/// Acceleration that the steps of two encoders make, were they elsewhere, of motor and stage, m/s2.
pub(super) fn accel_m_s2(s: &Signals) -> TimeColumn {
    let error = |track: &Track, k: usize| error_m(&track.sides[k].x_m, s.steps_m[k], 0.5 * s.steps_m[k]);
    let of = |k: usize| Some(s.each(|track| s.filtered(track, &error(track, k), 2)));
    TimeColumn { sides: [0, 1].map(of), operator: None }
}

/// What rounding leaves of one recording; nothing where it has no steps.
fn left(ground: &Ground<'_>, track: &Track, (step_m, shift_m): (f64, f64)) -> Vec<f64> {
    let (s, m) = (ground.signals, &ground.mechanics);
    let side = &track.sides[0];
    let error = error_m(&side.x_m, step_m, shift_m);
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
