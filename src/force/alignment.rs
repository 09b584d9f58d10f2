//! The three signals of an axis brought to one instant (phase lag compensation, thesis 2.4.2).
//!
//! ```text
//!  told       I_ref ----T_s, 1/(1+s/omega_cc)----> thrust at tau
//!  reported   x_m  <----T_m----  motion at tau     so that at time t:  I_ref of tau - T_s, x_m of tau + T_m,
//!  reported   x_t  <----T_t----  motion at tau                         x_t of tau + T_t are combined
//! ```
//! Delays are fractional: each signal is read from its line by an interpolating stencil, and the
//! common instant tau lies a whole number of samples ago.

use super::lane_line::LONGEST_AGE;
use crate::plant::drive::DriveParams;
use crate::signal::FilterError;
use crate::signal::finite_difference::STENCIL_NODES;
use crate::units::SampleRate;

/// Ages in samples at which each signal shows the common instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alignment {
    /// Age of the current reference.
    pub current: f64,
    /// Age of the motor encoder's value.
    pub motor: f64,
    /// Age of the stage encoder's value.
    pub stage: f64,
    /// Samples between the common instant and now; a whole number.
    pub lag_samples: usize,
    /// Share that the current keeps of its last value in one sample: exp(-omega_cc T); 0: no lag.
    pub current_memory: f64,
}

impl Alignment {
    /// Ages for a drive whose own signals come `drive_side_late_s` later than they should (a filter before
    /// the estimator). Errors: delays longer than a line holds.
    ///
    /// lag = ceil(max(T_m + T_f, T_t)/T) + 3, so that three samples on the young side of each encoder's
    /// instant are there for its stencil; age_m = lag - (T_m + T_f)/T, age_t = lag - T_t/T,
    /// age_I = lag + (T_s - T_f)/T + d.
    ///
    /// The reference is held over a sample, which its mean effect lags by T/2, and the current loop is a
    /// first-order lag: T/2 + 1/w. The recursion that follows the lag from sample to sample has T/(1 - a),
    /// a = e^(-wT), for slow signals; d = 1/2 + 1/(wT) - 1/(1 - a) makes up for the difference (positions are
    /// integrated twice, so the steps of the held reference do not show in them). Without a lag d = 1/2.
    ///
    /// Source: Yamada, thesis 2.4.2 with (T_1, T_2, T_3) in ms (docs/errata.md); the hold is ours.
    /// Checked by: force::a_force_is_seen_at_the_stated_delay_by_both_modes,
    /// force::a_held_reference_is_seen_where_it_acts.
    pub fn new(drive: &DriveParams, rate: SampleRate, drive_side_late_s: f64) -> Result<Self, FilterError> {
        let samples = |seconds: f64| seconds * rate.hz();
        let late = samples(drive_side_late_s);
        let (t_s, t_m, t_t) = (
            samples(drive.amplifier_dead_time_s()) - late,
            samples(drive.motor_encoder_delay_s()) + late,
            samples(drive.stage_encoder_delay_s()),
        );
        let hold = drive.current_loop_bandwidth_rad_s().map_or(0.5, |bandwidth| {
            let w = bandwidth / rate.hz();
            0.5 + 1.0 / w + 1.0 / (-w).exp_m1()
        });
        let lag = (t_m.max(t_t) - 1e-6).ceil().max(0.0) + 3.0;
        let current = lag + t_s + hold;
        let largest = LONGEST_AGE - STENCIL_NODES;
        if current > largest as f64 {
            return Err(FilterError::DelayTooLong { samples: current, largest });
        }
        let current_memory =
            drive.current_loop_bandwidth_rad_s().map_or(0.0, |bandwidth| (-bandwidth / rate.hz()).exp());
        Ok(Self { current, motor: lag - t_m, stage: lag - t_t, lag_samples: lag as usize, current_memory })
    }
}
