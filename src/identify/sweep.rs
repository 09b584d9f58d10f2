//! Mechanical parameters and dead times from a swept-sine recording of a moving axis.
//!
//! ```text
//!  current ref --ZOH, T_s, omega_cc--> thrust --chain of masses--> motor, stage --T_m, T_t--> encoders
//! ```
//! The loop is closed, and the sweep stands far above everything that is fed back, so what the drive
//! was told is the input: accelerations of motor and stage are explained line by line of the Fourier
//! transform of each stretch of constant feed. Weights come from the residual itself, band by band, so
//! ripple and other disturbances cost their own lines only. K_t is not identifiable from motion: masses,
//! stiffness and damping are per the stated torque constant. Of the dead times, only T_s + T_m and
//! T_s + T_t are: T_m stays as stated, the rest follows. An interval is the noise of the sweep (measured)
//! and what no sweep shows (stated: `StatedErrors`), each told apart.
//! Where two inertias do not explain the sweep, three are tried: a torsional spring within the inertia.
//!
//! Source: Yamada, thesis 3.3.1 (fit of frequency responses). Deviation: line by line instead of
//! averaged responses; the current loop's bandwidth is fitted too, with the stated value as a loose
//! prior. Checked by: identify::a_sweep_gives_back_mass_stiffness_and_dead_times,
//! identify::the_noise_part_of_an_interval_holds_the_truth_in_95_of_100_repeats.

pub use super::fitted_drive::{FittedMode, FittedParameter, ResponsePoint};
use super::sweep_fit::{Band, Fit};
use super::sweep_lines::{LEAST_STRETCH_S, LOW_HZ, Lines, steady_stretches};
pub use super::sweep_recording::{StatedErrors, Sweep, SweepError};
use super::sweep_result::with_torsion;
use crate::plant::drive::{DriveParams, RawDriveParams, Structure};
use crate::plant::effects::torsional_mode::stiffness_of;
use std::f64::consts::TAU;
use std::ops::Range;

/// Relative misfit beyond which a recording is no sweep of this axis: nothing of the fit is kept.
const NOTHING_LIKE: f64 = 0.5;

/// Outcome of a sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepFit {
    /// The prior with fitted values in place; the prior as it was where the sweep determines none.
    pub drive: DriveParams,
    /// What was fitted.
    pub parameters: Vec<FittedParameter>,
    /// Responses for the picture.
    pub points: Vec<ResponsePoint>,
    /// A torsional mode that the drive's structure lacks and the fit needs.
    pub mode: Option<FittedMode>,
    /// Band that was fitted, Hz.
    pub band_hz: [f64; 2],
    /// What a user must know.
    pub warnings: Vec<String>,
    /// Whether the sweep determines anything: the drive is the prior otherwise.
    pub determined: bool,
}

/// Fits the drive; `stated`: what no sweep shows. Errors: no steady stretch, no excitation, a missing
/// signal, a result that is no drive.
pub fn fit_sweep(prior: &DriveParams, sweep: &Sweep, stated: StatedErrors) -> Result<SweepFit, SweepError> {
    let structure = prior.structure();
    let (has_motor, has_stage) = (!sweep.motor_travel_m.is_empty(), !sweep.stage_position_m.is_empty());
    if structure != Structure::Rigid && !(has_motor && has_stage) {
        let needs = "both a motor angle and a stage position";
        return Err(SweepError::Signal { structure: "flexible", needs });
    }
    if !has_motor && !has_stage {
        return Err(SweepError::Signal { structure: "rigid", needs: "a motor angle or a stage position" });
    }
    let stretches = steady_stretches(sweep);
    if stretches.is_empty() {
        let seconds = sweep.thrust_ref_n.len() as f64 / sweep.rate.hz();
        return Err(SweepError::NoStretch { least_s: LEAST_STRETCH_S, seconds });
    }
    let lines = Lines::new(sweep, &stretches)?;
    let mut fit = Fit::new(prior, &lines, [has_motor, has_stage], stated);
    let band = fit.widen();
    let wider = if fit.explained { None } else { with_torsion(prior, band.mode_hz.unwrap_or(band.high_hz)) };
    let mut warnings = Vec::new();
    if let Some(wider) = wider.filter(|_| structure == Structure::DualInertia) {
        let mut three = Fit::new(&wider, &lines, [has_motor, has_stage], stated);
        three.whole();
        if let Some(mode) = three.mode().filter(|_| three.explained) {
            warnings.push(format!(
                "a mode outside of the model at about {:.0} Hz; fitted as torsion of motor and screw",
                mode.frequency_hz
            ));
            let outcome = Outcome { fit: &three, lumped: Some(prior), mode: Some(mode), determined: true };
            return outcome.finish(sweep, &stretches, (lines.highest_hz(), warnings));
        }
    }
    if !fit.explained {
        warnings.push(not_explained(&band));
    }
    let determined = band.misfit <= NOTHING_LIKE;
    let outcome = Outcome { fit: &fit, lumped: None, mode: None, determined };
    outcome.finish(sweep, &stretches, (band.high_hz, warnings))
}

fn not_explained(band: &Band) -> String {
    let what = match band.mode_hz {
        Some(mode_hz) => format!("a mode outside of the model at about {mode_hz:.0} Hz"),
        None => "the model does not explain the whole response".to_owned(),
    };
    format!(
        "{what}; the model misses the responses below {:.0} Hz by up to {:.0} %: a fit gives the \
         values of a model that is not this machine, not to be trusted",
        band.high_hz,
        100.0 * band.misfit
    )
}

/// A finished fit.
struct Outcome<'a, 'b> {
    fit: &'a Fit<'b>,
    /// The two-inertia drive that a fit of three stands for.
    lumped: Option<&'a DriveParams>,
    mode: Option<FittedMode>,
    determined: bool,
}

impl Outcome<'_, '_> {
    fn finish(
        self,
        sweep: &Sweep,
        stretches: &[Range<usize>],
        (high_hz, warnings): (f64, Vec<String>),
    ) -> Result<SweepFit, SweepError> {
        let points = self.fit.points();
        let (mut raw, mut parameters) = self.fit.result(self.lumped);
        let determined = self.determined;
        let drive = if determined {
            let stiffness_n_m = rest_stiffness_n_m(&raw, self.mode.as_ref());
            let friction = stiffness_n_m.and_then(|k| friction_from_means(&raw, k, sweep, stretches));
            if let Some(friction) = friction {
                friction.apply(&mut raw, &mut parameters);
            }
            DriveParams::new(raw)?
        } else {
            self.fit.prior.clone()
        };
        let band_hz = [LOW_HZ, high_hz];
        Ok(SweepFit { drive, parameters, points, mode: self.mode, band_hz, warnings, determined })
    }
}

/// Coulomb friction of motor and stage, from the mean thrust and the mean stretch of the screw in
/// both directions of travel.
struct Friction {
    motor_n: f64,
    stage_n: f64,
}

impl Friction {
    fn apply(&self, raw: &mut RawDriveParams, fitted: &mut Vec<FittedParameter>) {
        for (name, value, field) in [
            ("motor_coulomb_friction_n", self.motor_n, &mut raw.motor_coulomb_friction_n),
            ("stage_coulomb_friction_n", self.stage_n, &mut raw.stage_coulomb_friction_n),
        ] {
            let prior = field.unwrap_or(0.0);
            *field = Some(value);
            let unknown = f64::NAN;
            fitted.push(FittedParameter {
                name,
                prior,
                value,
                noise: unknown,
                stated: unknown,
                ci95: [unknown; 2],
            });
        }
    }
}

/// Stiffness between motor and stage under a constant force, N/m: 1/K = 1/K_r + r^2/K_theta, the screw's
/// wind-up in series with its stretch where there is a torsional spring. `None` on a rigid axis.
///
/// Source: rest balance of the chain. Checked by: identify::friction_is_right_behind_a_screw_that_winds_up.
fn rest_stiffness_n_m(raw: &RawDriveParams, mode: Option<&FittedMode>) -> Option<f64> {
    let r = raw.screw_lead_m? / TAU;
    let of_mode = |mode: &FittedMode| {
        let inertia = raw.rotary_inertia_kg_m2?;
        let screw = mode.screw_share * inertia;
        Some(stiffness_of(mode.frequency_hz, inertia - screw, screw))
    };
    let torsional = mode.and_then(of_mode).or(raw.torsional_stiffness_nm_rad);
    Some(1.0 / (1.0 / raw.axial_stiffness_n_m? + torsional.map_or(0.0, |k_theta| r * r / k_theta)))
}

/// (mean over forward - mean over backward)/2 of thrust = C_a v + F_motor + F_stage;
/// of K (x_m - x_t) = C_t v + F_stage with the rest stiffness K. `None` without both directions.
fn friction_from_means(
    raw: &RawDriveParams,
    stiffness_n_m: f64,
    sweep: &Sweep,
    stretches: &[Range<usize>],
) -> Option<Friction> {
    let r = raw.screw_lead_m? / TAU;
    let mut sums = [[0.0; 3]; 2];
    let mut counts = [0.0; 2];
    let difference_s = raw.stage_encoder_delay_s.unwrap_or(0.0) - raw.motor_encoder_delay_s.unwrap_or(0.0);
    for range in stretches {
        let n = range.len() as f64;
        let mean = |v: &[f64]| v[range.clone()].iter().sum::<f64>() / n;
        let (first, last) = (sweep.stage_position_m[range.start], sweep.stage_position_m[range.end - 1]);
        let velocity = (last - first) / (n / sweep.rate.hz());
        let side = usize::from(velocity > 0.0);
        // The encoders are read at different instants: the later one shows an earlier place.
        let stretch = mean(&sweep.motor_travel_m) - mean(&sweep.stage_position_m) - velocity * difference_s;
        for (sum, value) in sums[side].iter_mut().zip([mean(&sweep.thrust_ref_n), stretch, velocity]) {
            *sum += value;
        }
        counts[side] += 1.0;
    }
    if counts[0] == 0.0 || counts[1] == 0.0 {
        return None;
    }
    let half = [0, 1, 2].map(|i| 0.5 * (sums[1][i] / counts[1] - sums[0][i] / counts[0]));
    let c_t = raw.translational_damping_n_s_m.unwrap_or(0.0);
    let c_r = raw.rotary_damping_nm_s_rad.unwrap_or(0.0) / (r * r);
    let stage_n = stiffness_n_m * half[1] - c_t * half[2];
    let motor_n = half[0] - (c_t + c_r) * half[2] - stage_n;
    (stage_n >= 0.0 && motor_n >= 0.0).then_some(Friction { motor_n, stage_n })
}
