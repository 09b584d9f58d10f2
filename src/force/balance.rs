//! The force balance of each method: which multiple of thrust, of the motion of motor and stage, and
//! of their friction makes the cutting force.
//!
//! Every method of the thesis is linear in aligned motion, so one row of factors is the method.

use super::guideway::GuidewayTravel;
use super::modal::ModalBalance;
use super::response::Chain;
use crate::plant::drive::{DriveParams, Structure};

/// How the cutting force is had from servo signals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Method {
    /// Thrust of the motor alone, F = K_t I / R.
    Thrust,
    /// Disturbance observer on the motor side, one rigid mass (2-15).
    Dob,
    /// Multi-encoder disturbance observer (2-21).
    Medob,
    /// Rigid-body mode of the modal space (2-43), of the triple-inertia model (2-61).
    RigidMode,
    /// First vibration mode of the modal space (2-44), of the triple-inertia model (2-62).
    VibrationMode,
    /// Second vibration mode of the triple-inertia model (2-63); needs three positions.
    SecondVibrationMode,
    /// Positions fitted by spindle harmonics before the multi-encoder balance (Hayashi et al.).
    Fitted,
    /// Spectral lines of the thrust corrected by the closed loop (Sato et al.).
    Spectral,
}

impl Method {
    /// All of them.
    pub const ALL: [Method; 8] = [
        Method::Thrust,
        Method::Dob,
        Method::Medob,
        Method::RigidMode,
        Method::VibrationMode,
        Method::SecondVibrationMode,
        Method::Fitted,
        Method::Spectral,
    ];

    /// Name in commands and files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Method::Thrust => "thrust",
            Method::Dob => "dob",
            Method::Medob => "medob",
            Method::RigidMode => "rigid_mode",
            Method::VibrationMode => "vibration_mode",
            Method::SecondVibrationMode => "second_vibration_mode",
            Method::Fitted => "fitted",
            Method::Spectral => "spectral",
        }
    }

    /// The method of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|m| m.name() == name)
    }
}

/// Factors of position, velocity and acceleration of one body: N/m, N s/m, kg.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MotionFactors {
    /// N/m.
    pub position_n_m: f64,
    /// N s/m.
    pub velocity_n_s_m: f64,
    /// kg.
    pub acceleration_kg: f64,
}

impl MotionFactors {
    fn mass(mass_kg: f64, damping_n_s_m: f64) -> Self {
        Self { position_n_m: 0.0, velocity_n_s_m: -damping_n_s_m, acceleration_kg: -mass_kg }
    }

    /// As an array over derivatives 0, 1, 2.
    #[must_use]
    pub fn as_array(self) -> [f64; 3] {
        [self.position_n_m, self.velocity_n_s_m, self.acceleration_kg]
    }

    fn is_zero(self) -> bool {
        self == Self::default()
    }
}

/// F_cut = thrust + motor . (x_m, v_m, a_m) + stage . (x_t, v_t, a_t)
///         - motor_friction tanh(v_m/v_s) - stage_friction tanh(v_t/v_s)
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ForceBalance {
    /// Factor of the thrust K_t I / R, dimensionless.
    pub thrust: f64,
    /// Factors of the motor's travel.
    pub motor: MotionFactors,
    /// Factors of the screw at the nut, where a third position is measured.
    pub nut: MotionFactors,
    /// Factors of the stage.
    pub stage: MotionFactors,
    /// Factor of the friction at the motor, as a force, N.
    pub motor_friction_n: f64,
    /// Factor of the friction of the stage, N.
    pub stage_friction_n: f64,
    /// Factor of further disturbances of the stage: 1 where the estimate contains them, 0 where not.
    pub stage_disturbance: f64,
}

impl ForceBalance {
    /// Without the guideway's friction where its travel is learned: that is taken off beyond the balance.
    pub(super) fn before_friction_learned(self, travel: GuidewayTravel) -> Self {
        Self { stage_friction_n: travel.in_balance_n(self.stage_friction_n), ..self }
    }

    /// The balance of a method for a drive. On a rigid axis everything that moves is one mass and the
    /// methods but `thrust` are one.
    ///
    /// Source: Yamada, PhD thesis, Keio Univ. 2017, (2-15), (2-21), (2-43), (2-44).
    /// Checked by: identities::medob_is_rigid_mode, identities::both_modes_return_the_cutting_force.
    #[must_use]
    pub fn new(method: Method, drive: &DriveParams) -> Self {
        if matches!(method, Method::Thrust | Method::Spectral) {
            return Self { thrust: 1.0, ..Self::default() };
        }
        if method == Method::Dob || drive.structure() == Structure::Rigid {
            return Self::rigid(drive);
        }
        match method {
            Method::VibrationMode => Self::vibration_mode(drive),
            _ => Self::medob(drive),
        }
    }

    /// F = u - M_a a_m - C_a v_m - friction   (2-14)
    fn rigid(drive: &DriveParams) -> Self {
        let damping = drive.reflected_damping_n_s_m() + drive.translational_damping_n_s_m();
        Self {
            thrust: 1.0,
            motor: MotionFactors::mass(drive.total_mass_kg(), damping),
            motor_friction_n: drive.motor_coulomb_friction_n() + drive.stage_coulomb_friction_n(),
            stage_disturbance: 1.0,
            ..Self::default()
        }
    }

    /// F = u - M_r a_m - C_r v_m - T_fric/R - M_t a_t - C_t v_t - F_fric   (2-20)
    ///
    /// With three inertias and two encoders the screw moves with the motor, (2-65).
    fn medob(drive: &DriveParams) -> Self {
        Self {
            thrust: 1.0,
            motor: MotionFactors::mass(motor_side_mass_kg(drive), drive.reflected_damping_n_s_m()),
            stage: MotionFactors::mass(drive.movable_mass_kg(), drive.translational_damping_n_s_m()),
            motor_friction_n: drive.motor_coulomb_friction_n(),
            stage_friction_n: drive.stage_coulomb_friction_n(),
            stage_disturbance: 1.0,
            ..Self::default()
        }
    }

    /// F = alpha (M_vib a_vib + C_vib v_vib + K_vib x_vib - u + T_fric/R) - F_fric   (2-44)
    ///
    /// x_vib = alpha/(alpha + 1) (x_m - x_t); alpha_c = (C_r + C_t)/(M_r + M_t), equal to C_r/M_r and
    /// C_t/M_t where damping is proportional (2-30); beta_c = C_k/K_r.
    ///
    /// What is left where it is not proportional: (C_r - alpha_c M_r)(v_m + alpha v_t)/(1 + alpha)
    /// times alpha, taken into the motor and stage factors so that the sum is exact for any damping.
    fn vibration_mode(drive: &DriveParams) -> Self {
        let m_r = motor_side_mass_kg(drive);
        let m_t = drive.movable_mass_kg();
        let alpha = m_t / m_r;
        let share = alpha / (alpha + 1.0);
        // alpha * M_vib * share = M_t, since M_vib = (1 + 1/alpha) M_r.
        let mass = alpha * (1.0 + 1.0 / alpha) * m_r * share;
        let stiffness_factor = alpha * (1.0 + 1.0 / alpha).powi(2) * share; // = 1 + alpha
        let k = stiffness_factor * drive.axial_stiffness_n_m();
        let c_k = stiffness_factor * drive.structural_damping_n_s_m();
        // Exact damping of motor and stage, alpha C_r v_m - C_t v_t, in place of alpha_c.
        Self {
            thrust: -alpha,
            motor: MotionFactors {
                position_n_m: k,
                velocity_n_s_m: c_k + alpha * drive.reflected_damping_n_s_m(),
                acceleration_kg: mass,
            },
            stage: MotionFactors {
                position_n_m: -k,
                velocity_n_s_m: -c_k - drive.translational_damping_n_s_m(),
                acceleration_kg: -mass,
            },
            motor_friction_n: -alpha * drive.motor_coulomb_friction_n(),
            stage_friction_n: drive.stage_coulomb_friction_n(),
            stage_disturbance: 1.0,
            ..Self::default()
        }
    }

    /// One mode of three inertias whose positions are all measured: 0 rigid, (2-49) and (2-61); 1, (2-62);
    /// 2, (2-63).
    /// `None` where the model has no such mode.
    ///
    /// Checked by: force::three_positions_return_the_force_in_every_mode.
    #[must_use]
    pub fn of_three(mode: usize, drive: &DriveParams) -> Option<Self> {
        let modal = ModalBalance::new(&Chain::of_drive(drive), mode)?;
        let &[motor, nut, stage] = modal.motion.as_slice() else { return None };
        let factors = |[position_n_m, velocity_n_s_m, acceleration_kg]: [f64; 3]| MotionFactors {
            position_n_m,
            velocity_n_s_m,
            acceleration_kg,
        };
        Some(Self {
            thrust: modal.thrust,
            motor: factors(motor),
            nut: factors(nut),
            stage: factors(stage),
            motor_friction_n: modal.thrust * drive.motor_coulomb_friction_n(),
            stage_friction_n: drive.stage_coulomb_friction_n(),
            stage_disturbance: 1.0,
        })
    }

    /// True when the screw's own motion enters.
    #[must_use]
    pub fn needs_nut(&self) -> bool {
        !self.nut.is_zero()
    }

    /// True when the motor's motion enters.
    #[must_use]
    pub fn needs_motor(&self) -> bool {
        !self.motor.is_zero()
    }

    /// True when the stage's motion enters.
    #[must_use]
    pub fn needs_stage(&self) -> bool {
        !self.stage.is_zero()
    }
}

/// M_r (+ screw): what turns, as a mass on the screw axis.
pub(super) fn motor_side_mass_kg(drive: &DriveParams) -> f64 {
    drive.total_mass_kg() - drive.movable_mass_kg()
}
