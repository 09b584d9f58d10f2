//! Up to where an axis moves as one mass, read off its two encoders where no stiffness is stated.
//!
//! ```text
//! d = x_m - x_t = (M_t / K) a_t + (C_t / K + t_m - t_t) v_t + (F_ct / K) tanh(v_t / v_s) + scale x_t + zero
//! ```
//! The coefficient of the acceleration is one over the square of the frequency at which the stage swings.

use super::recorded::{motor_position, stage_position};
use crate::diagnosis::criteria::Criteria;
use crate::diagnosis::kernel::{Action, Grid, Kernel};
use crate::plant::effects::coulomb_friction::sliding_direction;
use crate::plant::machine::AxisModel;
use crate::sample::Recording;
use nalgebra::{DMatrix, DMatrixView, DVector, DVectorView, SMatrix, SVector};

/// Samples kept per band.
pub(super) const THINNED_PER_BAND: f64 = 3.125;

/// A row of the columns of the stretch, and sums of their products.
type Row = SVector<f64, 5>;
type Products = SMatrix<f64, 5, 5>;

/// A stage behind a spring.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spring {
    /// Square of the frequency at which the stage swings on the motor, rad2/s2.
    pub(super) swing_rad2_s2: f64,
    /// Way that the spring gives under the stage's friction, m.
    pub(super) wound_m: f64,
}

/// The spring as the stretch has it. `None`: not all recordings have both positions, or the stretch does not
/// follow the acceleration.
///
/// Checked by: tests::the_swing_of_the_stage_is_read_off_the_stretch.
pub(super) fn spring(axis: &AxisModel, recordings: &[Recording]) -> Option<Spring> {
    let mut normal = Products::zeros();
    let mut pull = Row::zeros();
    for recording in recordings {
        let (motor, stage) = (motor_position(axis, recording)?, stage_position(axis, recording)?);
        let form = (axis.drive.friction_smoothing_m_s(), recording.sample_rate.hz());
        add(&mut normal, &mut pull, (&motor, stage), form);
    }
    solved(&normal, &pull)
}

/// Adds the products of one recording; friction turns over `turning_m_s`.
fn add(
    normal: &mut Products,
    pull: &mut Row,
    (motor, stage): (&[f64], &[f64]),
    (turning_m_s, rate_hz): (f64, f64),
) {
    let band_hz = Criteria::STANDARD.band_share[0] * rate_hz;
    let kernel = |derivative| Kernel::low_pass(band_hz, rate_hz, Action { derivative, advance_s: 0.0 });
    let kernels = [kernel(0), kernel(1), kernel(2)];
    let first = kernels.iter().map(Kernel::half).max().unwrap_or(0) + 1;
    let step = (rate_hz / (THINNED_PER_BAND * band_hz)) as usize;
    let grid = Grid { first, step, count: stage.len().saturating_sub(2 * first) / step };
    let origin = stage.first().copied().unwrap_or(0.0);
    let local: Vec<f64> = stage.iter().map(|x| x - origin).collect();
    let stretch: Vec<f64> = motor.iter().zip(stage).map(|(m, s)| m - s).collect();
    let [x, v, a] = [0, 1, 2].map(|k: usize| kernels[k].apply(&local, grid));
    for (j, d) in kernels[0].apply(&stretch, grid).iter().enumerate() {
        let row = Row::from([a[j], v[j], sliding_direction(v[j], turning_m_s), x[j], 1.0]);
        *normal += row * row.transpose();
        *pull += row * *d;
    }
}

/// Coefficients of columns by their products, least squares; metres beside metres per square second are made
/// one in size first, and a column that is nothing is held at zero.
pub(super) fn coefficients(normal: DMatrixView<'_, f64>, pull: DVectorView<'_, f64>) -> Option<DVector<f64>> {
    let scale = normal.diagonal().map(|d| d.max(f64::MIN_POSITIVE).sqrt().recip());
    let unit = DMatrix::from_diagonal(&scale);
    let held = &unit * normal * &unit + 1e-10 * DMatrix::<f64>::identity(scale.len(), scale.len());
    Some(held.lu().solve(&scale.component_mul(&pull))?.component_mul(&scale))
}

/// The coefficients of acceleration and friction.
fn solved(normal: &Products, pull: &Row) -> Option<Spring> {
    let beta = coefficients(normal.as_view(), pull.as_view())?;
    let found = Spring { swing_rad2_s2: beta[0].recip(), wound_m: beta[2].max(0.0) };
    (beta[0] > 0.0).then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A stage of 6 kg on 4e7 N/m under friction of 50 N, scales that differ by 1e-4, encoders 20 us apart.
    #[test]
    fn the_swing_of_the_stage_is_read_off_the_stretch() {
        let (rate, mass, stiffness, dry) = (10_000.0, 6.0, 4e7, 50.0);
        let w: [f64; 2] = [9.0, 400.0];
        let size: [f64; 2] = [5e-3, 1e-5];
        let of = |t: f64, f: fn(f64) -> f64, order: i32| -> f64 {
            w.iter().zip(&size).map(|(w, s)| s * w.powi(order) * f(w * t)).sum()
        };
        let (mut motor, mut stage) = (Vec::new(), Vec::new());
        for k in 0..40_000 {
            let t = f64::from(k) / rate;
            let (x, v, a) = (of(t, f64::sin, 0), of(t, f64::cos, 1), -of(t, f64::sin, 2));
            let friction = dry * sliding_direction(v, 2e-4);
            stage.push(x);
            motor.push(x + (mass * a + friction) / stiffness + 2e-5 * v + 1e-4 * x + 3e-6);
        }
        let (mut normal, mut pull) = (Products::zeros(), Row::zeros());
        add(&mut normal, &mut pull, (&motor, &stage), (2e-4, rate));
        let found = solved(&normal, &pull).expect("a spring");
        let [swing, wound_m] = [stiffness / mass, dry / stiffness];
        assert!((found.swing_rad2_s2 / swing - 1.0).abs() < 0.01, "{found:?} for {swing}");
        assert!((found.wound_m / wound_m - 1.0).abs() < 0.05, "{found:?} for {wound_m}");
    }
}
