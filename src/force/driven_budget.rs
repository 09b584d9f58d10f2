//! Error budget of an observer on a drive under control: what of its estimate is thrust, elastic, damping
//! and inertia force, and what an incomplete alignment of the three signals costs.
//!
//! The loop answers a cutting force with thrust; the observer delays what it is told by T_1, T_2, T_3:
//!
//!   F_est / F_cut = [ b u c e^{-s T_1} + m(s) x_m e^{-s T_2} + t(s) x_t e^{-s T_3} ] e^{s d}
//!
//! with u, x_m, x_t as reported (dead times in them), c the current loop and the hold where the observer
//! follows them, b, m, t the factors of the method's balance, and d the delay that the observer states.
//! Source: Yamada, thesis 2.4.2, 4.2 and 5.2 (figures 4-1, 4-3, 5-1 to 5-5, 5-7, 5-10).
//! Checked by: force_budget::aligned_signals_leave_no_error_under_control,
//! force_budget::without_delay_compensation_medob_is_worse_than_thrust_near_100_hz.

use super::balance::{ForceBalance, Method};
use super::closed_loop::ClosedLoop;
use crate::plant::drive::{DriveParams, ParamError, RawDriveParams};
use crate::units::SampleRate;
use rustfft::num_complex::Complex64;
use std::f64::consts::TAU;

/// Delays that an observer gives the signals, s: (T_1, T_2, T_3) of the thesis.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PhaseLag {
    /// T_1, of the current.
    pub current_s: f64,
    /// T_2, of the motor angle.
    pub motor_s: f64,
    /// T_3, of the stage position.
    pub stage_s: f64,
    /// The observer follows the current loop's lag and the hold of the reference.
    pub follows_current_loop: bool,
}

impl PhaseLag {
    /// All three at one instant: L = max(T_m, T_t); (L + T_s, L - T_m, L - T_t).
    #[must_use]
    pub fn complete(drive: &DriveParams) -> Self {
        let latest_s = drive.motor_encoder_delay_s().max(drive.stage_encoder_delay_s());
        Self {
            current_s: latest_s + drive.amplifier_dead_time_s(),
            motor_s: latest_s - drive.motor_encoder_delay_s(),
            stage_s: latest_s - drive.stage_encoder_delay_s(),
            follows_current_loop: true,
        }
    }
}

/// Forces whose sum is the estimate, per cutting force.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parts {
    /// Of the thrust.
    pub thrust: Complex64,
    /// Of the stretch.
    pub elastic: Complex64,
    /// Of the velocities.
    pub damping: Complex64,
    /// Of the accelerations.
    pub inertia: Complex64,
    /// Share of the inertia force that comes from the motor angle (figure 5-10).
    pub motor_inertia: Complex64,
}

impl Parts {
    /// The estimate.
    #[must_use]
    pub fn sum(&self) -> Complex64 {
        self.thrust + self.elastic + self.damping + self.inertia
    }
}

/// An observer on a drive under control.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DrivenBudget {
    balance: ForceBalance,
    plant: ClosedLoop,
    lag: PhaseLag,
    stated_delay_s: f64,
    current_loop_bandwidth_rad_s: Option<f64>,
    hold_s: f64,
}

impl DrivenBudget {
    /// An observer that knows the drive and aligns the signals by `lag`. The delay it states is that of the
    /// motor angle after T_2 when it aligns all three, and none when it believes in no delays.
    #[must_use]
    pub fn new(method: Method, drive: &DriveParams, plant: ClosedLoop, lag: PhaseLag) -> Self {
        let believes_in_delays = lag.current_s + lag.motor_s + lag.stage_s > 0.0;
        Self {
            balance: ForceBalance::new(method, drive),
            plant,
            lag,
            stated_delay_s: if believes_in_delays {
                drive.motor_encoder_delay_s().max(drive.stage_encoder_delay_s())
            } else {
                0.0
            },
            current_loop_bandwidth_rad_s: drive.current_loop_bandwidth_rad_s(),
            hold_s: 0.0,
        }
    }

    /// The observer knows that a reference is held over a sample of this rate.
    #[must_use]
    pub fn holding(self, rate: SampleRate) -> Self {
        Self { hold_s: 0.5 * rate.period_s(), ..self }
    }

    /// What the estimate is made of.
    #[must_use]
    pub fn parts(&self, frequency_hz: f64) -> Parts {
        let s = Complex64::new(0.0, TAU * frequency_hz);
        let told = self.plant.response(frequency_hz);
        let later = |t_s: f64| (-s * (t_s - self.stated_delay_s)).exp();
        let mut thrust = told.thrust_ref * later(self.lag.current_s);
        if self.lag.follows_current_loop {
            let lag = self.current_loop_bandwidth_rad_s.map_or(Complex64::new(1.0, 0.0), |w| w / (s + w));
            thrust *= lag * (-s * self.hold_s).exp();
        }
        let motor = told.motor_read_m * later(self.lag.motor_s);
        let stage = told.stage_read_m * later(self.lag.stage_s);
        let (m, t) = (self.balance.motor.as_array(), self.balance.stage.as_array());
        Parts {
            thrust: self.balance.thrust * thrust,
            elastic: m[0] * motor + t[0] * stage,
            damping: s * (m[1] * motor + t[1] * stage),
            inertia: s * s * (m[2] * motor + t[2] * stage),
            motor_inertia: s * s * m[2] * motor,
        }
    }

    /// |F_est / F_cut - 1|, the stated delay taken out.
    #[must_use]
    pub fn relative_error(&self, frequency_hz: f64) -> f64 {
        (self.parts(frequency_hz).sum() - 1.0).norm()
    }

    /// |F_est / F_cut|.
    #[must_use]
    pub fn gain(&self, frequency_hz: f64) -> f64 {
        self.parts(frequency_hz).sum().norm()
    }
}

/// The drive with another inertia ratio alpha = M_t/M_r and the same total mass, resonance and damping
/// ratios of each side (figures 5-2 to 5-5). Errors: a ratio that makes no drive.
pub fn with_inertia_ratio(drive: &DriveParams, alpha: f64) -> Result<DriveParams, ParamError> {
    let r2 = drive.travel_m_rad().powi(2);
    let (m_r, m_t) = (drive.reflected_mass_kg(), drive.movable_mass_kg());
    let total_kg = m_r + m_t;
    let (new_r, new_t) = (total_kg / (1.0 + alpha), total_kg * alpha / (1.0 + alpha));
    // K (1/M_r + 1/M_t) and C_k (1/M_r + 1/M_t) stay.
    let reduced = (new_r * new_t) / (m_r * m_t);
    DriveParams::new(RawDriveParams {
        rotary_inertia_kg_m2: Some(new_r * r2),
        movable_mass_kg: Some(new_t),
        axial_stiffness_n_m: Some(drive.axial_stiffness_n_m() * reduced),
        structural_damping_n_s_m: Some(drive.structural_damping_n_s_m() * reduced),
        rotary_damping_nm_s_rad: Some(drive.rotary_damping_nm_s_rad() * new_r / m_r),
        translational_damping_n_s_m: Some(drive.translational_damping_n_s_m() * new_t / m_t),
        ..drive.raw().clone()
    })
}
