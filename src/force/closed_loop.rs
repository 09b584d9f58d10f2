//! The position and velocity loop around a drive: what a cutting force makes of the thrust reference and of
//! the positions that its encoders report.

use super::estimator::{AxisSignals, Signals};
use super::response::Chain;
use crate::plant::drive::DriveParams;
use crate::plant::machine::Controller;
use crate::units::SampleRate;
use rustfft::num_complex::Complex64;
use std::f64::consts::TAU;

/// Position and velocity loop around a drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosedLoop {
    chain: Chain,
    controller: Controller,
    /// Semi-closed: the position loop is closed on the motor's encoder too.
    position_on_motor: bool,
    masses_kg: [f64; 2],
    dampings_n_s_m: [f64; 2],
    current_loop_bandwidth_rad_s: Option<f64>,
    motor_delay_s: f64,
    stage_delay_s: f64,
    /// Dead time of the amplifier and half a sample of hold.
    drive_delay_s: f64,
    disturbance_cutoff_rad_s: Option<f64>,
}

/// Answers to one newton of cutting force.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopResponse {
    /// Thrust reference, N.
    pub thrust_ref: Complex64,
    /// Motor travel as its encoder reports it, m.
    pub motor_read_m: Complex64,
    /// Stage position as its encoder reports it, m.
    pub stage_read_m: Complex64,
}

impl ClosedLoop {
    pub(super) fn new(axis: &AxisSignals<'_>, controller: Controller) -> Self {
        let position_on_motor = axis.signals == Signals::MotorOnly;
        Self { position_on_motor, ..Self::around(axis.drive, controller, axis.rate) }
    }

    /// A loop that is closed on the stage's encoder.
    #[must_use]
    pub fn around(drive: &DriveParams, controller: Controller, rate: SampleRate) -> Self {
        let motor_kg = drive.total_mass_kg() - drive.movable_mass_kg();
        Self {
            position_on_motor: false,
            chain: Chain::of_drive(drive),
            controller,
            masses_kg: [motor_kg, drive.movable_mass_kg()],
            dampings_n_s_m: [drive.reflected_damping_n_s_m(), drive.translational_damping_n_s_m()],
            current_loop_bandwidth_rad_s: drive.current_loop_bandwidth_rad_s(),
            motor_delay_s: drive.motor_encoder_delay_s(),
            stage_delay_s: drive.stage_encoder_delay_s(),
            drive_delay_s: drive.amplifier_dead_time_s() + 0.5 * rate.period_s(),
            disturbance_cutoff_rad_s: None,
        }
    }

    /// With the disturbance of (2-21) fed back behind a low-pass of g_dis, as the drives of the thesis have.
    #[must_use]
    pub fn cancelling_disturbances(self, disturbance_cutoff_rad_s: f64) -> Self {
        Self { disturbance_cutoff_rad_s: Some(disturbance_cutoff_rad_s), ..self }
    }

    /// Thrust reference per cutting force.
    ///
    ///   u = -M_a K_v (1 + K_i/s) [ K_p x_t e^{-s T_t} + s w_f/(s + w_f) x_m e^{-s T_m} ]
    ///       + g/(s + g) [ u - (M_r s^2 + C_r s) p x_m e^{-s T_m} - (M_t s^2 + C_t s) p x_t e^{-s T_t} ],
    ///   x = G u w_cc/(s + w_cc) e^{-s (T_s + T/2)} + G_F F
    ///
    /// solved for u/F; the second line where disturbances are cancelled (p = w_f/(s + w_f)).
    /// Source: Sato et al. 4.2; Yamada, thesis, figure 3-4.
    /// Checked by: force::spectral_gain_is_that_of_the_recorded_loop.
    #[must_use]
    pub fn thrust_per_cutting(&self, frequency_hz: f64) -> Complex64 {
        let s = Complex64::new(0.0, TAU * frequency_hz);
        let c = &self.controller;
        let mass_kg = self.masses_kg[0] + self.masses_kg[1];
        let velocity_loop = mass_kg * c.velocity_gain_1_s * (1.0 + c.velocity_integral_1_s / s);
        let filter = c.velocity_filter_rad_s / (s + c.velocity_filter_rad_s);
        let position = velocity_loop * c.position_gain_1_s;
        let mut on_motor = velocity_loop * s * filter;
        let mut on_stage = Complex64::default();
        *(if self.position_on_motor { &mut on_motor } else { &mut on_stage }) += position;
        let mut on_itself = Complex64::default();
        if let Some(cutoff) = self.disturbance_cutoff_rad_s {
            on_itself = cutoff / (s + cutoff);
            let inertia = |side: usize| s * (self.masses_kg[side] * s + self.dampings_n_s_m[side]);
            on_motor += on_itself * filter * inertia(0);
            on_stage += on_itself * filter * inertia(1);
        }
        on_motor *= (-s * self.motor_delay_s).exp();
        on_stage *= (-s * self.stage_delay_s).exp();
        let x = self.chain.receptance(frequency_hz);
        let drive = self.thrust_per_reference(frequency_hz);
        -(on_motor * x.motor_per_cutting + on_stage * x.stage_per_cutting)
            / (1.0 - on_itself + drive * (on_motor * x.motor_per_thrust + on_stage * x.stage_per_thrust))
    }

    /// w_cc/(s + w_cc) e^{-s (T_s + T/2)}.
    fn thrust_per_reference(&self, frequency_hz: f64) -> Complex64 {
        let s = Complex64::new(0.0, TAU * frequency_hz);
        let lag = self.current_loop_bandwidth_rad_s.map_or(Complex64::new(1.0, 0.0), |w| w / (s + w));
        lag * (-s * self.drive_delay_s).exp()
    }

    /// All that an observer is told of one newton of cutting force.
    #[must_use]
    pub fn response(&self, frequency_hz: f64) -> LoopResponse {
        let s = Complex64::new(0.0, TAU * frequency_hz);
        let thrust_ref = self.thrust_per_cutting(frequency_hz);
        let thrust = thrust_ref * self.thrust_per_reference(frequency_hz);
        let x = self.chain.receptance(frequency_hz);
        LoopResponse {
            thrust_ref,
            motor_read_m: (x.motor_per_thrust * thrust + x.motor_per_cutting)
                * (-s * self.motor_delay_s).exp(),
            stage_read_m: (x.stage_per_thrust * thrust + x.stage_per_cutting)
                * (-s * self.stage_delay_s).exp(),
        }
    }
}
