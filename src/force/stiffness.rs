//! How stiff the axis is while it cuts: a check of the one parameter on which the vibration mode
//! stands.
//!
//! The axial force is known twice: from the motor side, u - M_r a_m - C_r v_m - friction, and from the
//! stretch of the screw, K_r (x_m - x_t) + C_k (v_m - v_t). Far below the first resonance both are
//! right but for K_r; compliance that the model has elsewhere (torsion of the screw, bearings) shows
//! as a smaller K_r here, because it stands in series. Disturbances that return by position are taken
//! off both by the idle runs.

use super::balance::{ForceBalance, MotionFactors, motor_side_mass_kg};
use crate::plant::drive::DriveParams;

/// Axial force from the motor side.
#[must_use]
pub fn motor_side_balance(drive: &DriveParams) -> ForceBalance {
    ForceBalance {
        thrust: 1.0,
        motor: MotionFactors {
            position_n_m: 0.0,
            velocity_n_s_m: -drive.reflected_damping_n_s_m(),
            acceleration_kg: -motor_side_mass_kg(drive),
        },
        motor_friction_n: drive.motor_coulomb_friction_n(),
        ..ForceBalance::default()
    }
}

/// Axial force from the stretch of the screw.
#[must_use]
pub fn stretch_balance(drive: &DriveParams) -> ForceBalance {
    let side = |sign: f64| MotionFactors {
        position_n_m: sign * drive.axial_stiffness_n_m(),
        velocity_n_s_m: sign * drive.structural_damping_n_s_m(),
        acceleration_kg: 0.0,
    };
    ForceBalance { motor: side(1.0), stage: side(-1.0), ..ForceBalance::default() }
}

/// Outcome of the check.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StiffnessCheck {
    /// Stiffness that the recording shows over that of the model.
    pub ratio: f64,
    /// Squared correlation of the two axial forces.
    pub r_squared: f64,
}

impl StiffnessCheck {
    /// True when the two forces are one force but for their scale, and the scale is believable.
    #[must_use]
    pub fn is_conclusive(&self) -> bool {
        self.r_squared > 0.98 && (0.6..=1.6).contains(&self.ratio)
    }
}

/// Slope of the motor side's force over the stretch's, means off. `None` where nothing varies.
///
/// Of two lines through noisy points the geometric mean is taken: neither side is free of error.
#[must_use]
pub fn stiffness_check(motor_side_n: &[f64], stretch_n: &[f64]) -> Option<StiffnessCheck> {
    let n = motor_side_n.len().min(stretch_n.len());
    if n < 100 {
        return None;
    }
    let mean = |v: &[f64]| v[..n].iter().sum::<f64>() / n as f64;
    let (a0, b0) = (mean(motor_side_n), mean(stretch_n));
    let (mut aa, mut ab, mut bb) = (0.0, 0.0, 0.0);
    for (a, b) in motor_side_n.iter().zip(stretch_n) {
        let (a, b) = (a - a0, b - b0);
        aa += a * a;
        ab += a * b;
        bb += b * b;
    }
    if !(ab > 0.0) {
        return None;
    }
    Some(StiffnessCheck { ratio: (aa / bb).sqrt(), r_squared: ab * ab / (aa * bb) })
}
