//! The position and velocity loop around a drive: what a cutting force makes of the thrust reference and of
//! the positions that its encoders report.

use super::balance::motor_side_mass_kg;
use super::response::Chain;
use super::signals::{AxisSignals, Signals};
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
        Self {
            position_on_motor: false,
            chain: Chain::of_drive(drive),
            controller,
            masses_kg: [motor_side_mass_kg(drive), drive.movable_mass_kg()],
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
        let [on_motor, on_stage, one_less_loop] = self.gains(frequency_hz);
        let x = self.chain.receptance(frequency_hz);
        -(on_motor * x.motor_per_cutting + on_stage * x.stage_per_cutting) / one_less_loop
    }

    /// Thrust reference per error of the readings of motor and stage, N/m: what rounding to encoder steps
    /// does to it.
    ///
    ///   u = -(A (x_m + e_m) + B (x_t + e_t)) + g/(s + g) u,  so u/e_m = -A / (1 - loop)
    ///
    /// Checked by: force_flags::encoder_steps_reach_the_thrust_through_the_loop.
    #[must_use]
    pub fn thrust_per_reading(&self, frequency_hz: f64) -> [Complex64; 2] {
        let [on_motor, on_stage, one_less_loop] = self.gains(frequency_hz);
        [-on_motor / one_less_loop, -on_stage / one_less_loop]
    }

    /// What the loop makes of the readings of motor and stage, and one less the loop itself.
    fn gains(&self, frequency_hz: f64) -> [Complex64; 3] {
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
        let around = drive * (on_motor * x.motor_per_thrust + on_stage * x.stage_per_thrust);
        [on_motor, on_stage, 1.0 - on_itself + around]
    }

    /// Standard deviation that rounding to encoder steps causes in the thrust reference behind a filter, N.
    ///
    ///   sigma^2 = sum over both encoders of q^2/12 2/f_s integral of |u/e|^2 |H|^2 df to f_s/2
    ///
    /// The error is taken as white, the loop as continuous; midpoints of a 2000th of the rate.
    #[must_use]
    pub fn step_noise_n(&self, steps_m: [f64; 2], rate: SampleRate, filter: impl Fn(f64) -> f64) -> f64 {
        const PARTS: usize = 1000;
        let mut mean = 0.0;
        for k in 1..=PARTS {
            let hz = (k as f64 - 0.5) / PARTS as f64 * rate.hz() / 2.0;
            let through = self.thrust_per_reading(hz).map(|u| u.norm_sqr());
            let power = through[0] * steps_m[0].powi(2) + through[1] * steps_m[1].powi(2);
            mean += power / 12.0 * filter(hz).powi(2) / PARTS as f64;
        }
        mean.sqrt()
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
