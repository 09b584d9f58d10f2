//! The force balance as a linear regression: one row per side and instant, one column per number of the
//! model.
//!
//! ```text
//!   motor:  u = M_r a_m + C_r v_m + F_m tanh(v_m/v_s) + K D + C_k D'          + effects + r_m
//!   stage:  0 = M_t a_s + C_t v_s + F_s tanh(v_s/v_s) - K D - C_k D'          + effects + r_s
//! ```
//! D = x_m - x_s. The sum r_m + r_s does not know the spring.

use super::encoder_noise::EncoderNoise;
use super::kernel::{Action, Grid, Kernel};
use super::motion::{Motion, Side, band_hz};
use super::whitening::Layout;
use crate::plant::drive::DriveParams;
use std::sync::Arc;

/// A series of one side of the balance; `None`: zero.
pub(crate) type Series = Option<Vec<f64>>;

/// One column of the regression in one recording.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Sides {
    pub(crate) motor: Series,
    pub(crate) stage: Series,
}

/// One column in every recording; thinned to the rate of the regression.
pub(crate) type Column = Vec<Sides>;

/// A number of the model as a column.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Number {
    /// Key of the model; `None`: an offset or a timing inside one sample that no key states.
    pub(crate) key: Option<&'static str>,
    /// Nominal coefficient.
    pub(crate) nominal: f64,
    /// Key's value per coefficient.
    pub(crate) key_per_coefficient: f64,
    /// The column.
    pub(crate) column: Column,
}

impl Number {
    /// The stiffness between the sides.
    pub(crate) fn is_spring(&self) -> bool {
        self.key == Some("axial_stiffness_n_m")
    }
}

/// Low-pass and decimation to the rate of the regression, the same for every series.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Thinning {
    pub(crate) kernel: Kernel,
    pub(crate) step: usize,
}

impl Thinning {
    fn new(rate_hz: f64) -> Self {
        let band = band_hz(rate_hz);
        let step = ((rate_hz / (3.1 * band)).floor() as usize).max(1);
        Self { kernel: Kernel::low_pass(band, rate_hz, Action { derivative: 0, advance_s: 0.0 }), step }
    }

    /// Samples of a series that are lost at either end: room for encoder kernels as well.
    pub(crate) fn edge(&self) -> usize {
        3 * self.kernel.half()
    }

    /// Where the thinned samples lie in a series of `len`.
    pub(crate) fn grid(&self, len: usize) -> Grid {
        let edge = self.edge();
        Grid { first: edge, step: self.step, count: (len.saturating_sub(2 * edge)).div_ceil(self.step) }
    }

    /// Low-passes and thins.
    pub(crate) fn thin(&self, x: &[f64]) -> Vec<f64> {
        self.kernel.apply(x, self.grid(x.len()))
    }

    /// Takes every `step`-th sample without filtering.
    pub(crate) fn pick(&self, x: &[f64]) -> Vec<f64> {
        let g = self.grid(x.len());
        (0..g.count).map(|j| x[g.first + j * g.step]).collect()
    }
}

/// Mechanical numbers of the balance, on the screw axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Mechanics {
    pub(crate) motor_mass_kg: f64,
    pub(crate) motor_damping_n_s_m: f64,
    pub(crate) motor_coulomb_n: f64,
    pub(crate) stiffness_n_m: f64,
    pub(crate) structural_damping_n_s_m: f64,
    pub(crate) stage_mass_kg: f64,
    pub(crate) stage_damping_n_s_m: f64,
    pub(crate) stage_coulomb_n: f64,
    /// Zero of D in m.
    pub(crate) smoothing_m_s: f64,
}

impl Mechanics {
    pub(crate) fn nominal(drive: &DriveParams) -> Self {
        Self {
            motor_mass_kg: drive.reflected_mass_kg(),
            motor_damping_n_s_m: drive.reflected_damping_n_s_m(),
            motor_coulomb_n: drive.motor_coulomb_friction_n(),
            stiffness_n_m: drive.axial_stiffness_n_m(),
            structural_damping_n_s_m: drive.structural_damping_n_s_m(),
            stage_mass_kg: drive.movable_mass_kg(),
            stage_damping_n_s_m: drive.translational_damping_n_s_m(),
            stage_coulomb_n: drive.stage_coulomb_friction_n(),
            smoothing_m_s: drive.friction_smoothing_m_s(),
        }
    }
}

/// Everything that stays the same while hypotheses are tried.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Problem {
    pub(crate) drive: DriveParams,
    pub(crate) motions: Vec<Motion>,
    pub(crate) thinning: Thinning,
    /// Measured thrust (motor side), thinned.
    pub(crate) target: Column,
    /// Numbers of the model.
    pub(crate) numbers: Arc<[Number]>,
    /// Column of the timing inside a sample: thrust derivative. Coefficient: delay in s.
    pub(crate) timing: Column,
    /// Timing inside a sample that is already taken into the thrust, s.
    pub(crate) timing_s: f64,
    /// Present estimate of the mechanics, for columns that are not linear in it.
    pub(crate) mechanics: Mechanics,
    /// Stiffness of the last fit, which left what the noise is taken from.
    pub(crate) fitted_stiffness_n_m: f64,
    /// Stretch at which the spring is free, per recording, m.
    pub(crate) free_stretch_m: Vec<f64>,
    /// Difference of lead and scale, m/m: the free stretch grows by this along the screw.
    pub(crate) lead_error: f64,
    /// Steps of motor and stage encoder as they are, stated or read off the recordings, m.
    pub(crate) steps_m: [f64; 2],
    /// Noise of the encoders, which bends what is fitted; `None`: positions are exact.
    pub(crate) encoder_noise: Option<EncoderNoise>,
    /// What a finding needs.
    pub(crate) proof: Proof,
}

/// How much a finding must explain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Proof {
    /// More than the inexactness of any model does.
    Usual,
    /// A step is coarser than the model states: errors follow the motion, and what they imitate needs more.
    Coarse,
    /// More than noise does: the loop is asked afterwards.
    LoopDecides,
}

impl Problem {
    pub(crate) fn new(drive: &DriveParams, motions: Vec<Motion>) -> Self {
        let rate_hz = motions.first().map_or(1.0, |m| m.rate_hz);
        let thinning = Thinning::new(rate_hz);
        let target =
            motions.iter().map(|m| Sides { motor: Some(thinning.thin(&m.thrust_n)), stage: None }).collect();
        let mut problem = Self {
            drive: drive.clone(),
            target,
            numbers: Arc::default(),
            timing: Vec::new(),
            timing_s: 0.0,
            mechanics: Mechanics::nominal(drive),
            fitted_stiffness_n_m: drive.axial_stiffness_n_m(),
            free_stretch_m: vec![0.0; motions.len()],
            lead_error: 0.0,
            steps_m: [drive.motor_encoder_resolution_m(), drive.stage_encoder_resolution_m()],
            encoder_noise: None,
            proof: Proof::Usual,
            motions,
            thinning,
        };
        problem.numbers = problem.all_numbers().into();
        problem.timing =
            problem.column(|m| Sides { motor: Some(derivative(&m.thrust_n, m.rate_hz)), stage: None });
        problem
    }

    /// Delays the thrust by a further part of a sample.
    pub(crate) fn shift_timing(&mut self, later_s: f64) {
        if later_s == 0.0 {
            return;
        }
        for m in &mut self.motions {
            m.thrust_n = super::columns::shifted(&m.thrust_n, -later_s * m.rate_hz);
        }
        self.timing_s += later_s;
        self.target = self
            .motions
            .iter()
            .map(|m| Sides { motor: Some(self.thinning.thin(&m.thrust_n)), stage: None })
            .collect();
        self.timing = self.column(|m| Sides { motor: Some(derivative(&m.thrust_n, m.rate_hz)), stage: None });
    }

    /// The same problem with columns at the full rate, neither filtered again nor cut.
    pub(crate) fn unthinned(&self) -> Self {
        Self {
            thinning: Thinning { kernel: Kernel::unit(), step: 1 },
            numbers: Arc::default(),
            timing: Vec::new(),
            target: Vec::new(),
            ..self.clone()
        }
    }

    /// Rate of the thinned series.
    pub(crate) fn rate_hz(&self) -> f64 {
        self.motions.first().map_or(1.0, |m| m.rate_hz) / self.thinning.step as f64
    }

    /// Steps that would make the noise that the positions of motor and stage have, m: by rounding, or what is
    /// read off the recordings where that is more.
    pub(crate) fn noise_steps_m(&self) -> [f64; 2] {
        let read = self.encoder_noise.as_ref().map_or([0.0; 2], EncoderNoise::steps_m);
        [0, 1].map(|side| self.steps_m[side].max(read[side]))
    }

    /// Length of the thinned series of each recording.
    pub(crate) fn lengths(&self) -> Vec<usize> {
        self.motions.iter().map(|m| self.thinning.grid(m.len()).count).collect()
    }

    pub(crate) fn layout(&self) -> Layout {
        Layout { lengths: self.lengths(), sides: 2 }
    }

    /// Builds a column from full-rate series.
    pub(crate) fn column(&self, build: impl Fn(&Motion) -> Sides) -> Column {
        self.motions
            .iter()
            .map(|m| {
                let sides = build(m);
                Sides {
                    motor: sides.motor.map(|x| self.thinning.thin(&x)),
                    stage: sides.stage.map(|x| self.thinning.thin(&x)),
                }
            })
            .collect()
    }

    fn motor_only(&self, f: impl Fn(&Motion) -> Vec<f64>) -> Column {
        self.column(|m| Sides { motor: Some(f(m)), stage: None })
    }

    fn stage_only(&self, f: impl Fn(&Motion) -> Vec<f64>) -> Column {
        self.column(|m| Sides { motor: None, stage: Some(f(m)) })
    }

    /// A force that acts between the sides: (+, -).
    pub(crate) fn coupling(&self, f: impl Fn(&Motion) -> Vec<f64>) -> Column {
        self.column(|m| {
            let x = f(m);
            Sides { stage: Some(x.iter().map(|v| -v).collect()), motor: Some(x) }
        })
    }

    fn all_numbers(&self) -> Vec<Number> {
        let (d, vs) = (&self.drive, self.mechanics.smoothing_m_s);
        let r2 = d.travel_m_rad().powi(2);
        let mut list = Vec::new();
        let mut add = |key, nominal: f64, key_per_coefficient, column: &dyn Fn() -> Column| {
            if nominal > 0.0 {
                list.push(Number { key: Some(key), nominal, key_per_coefficient, column: column() });
            }
        };
        add("rotary_inertia_kg_m2", d.reflected_mass_kg(), r2, &|| {
            self.motor_only(|m| m.motor.accel_m_s2.clone())
        });
        add("rotary_damping_nm_s_rad", d.reflected_damping_n_s_m(), r2, &|| {
            self.motor_only(|m| m.motor.velocity_m_s.clone())
        });
        add("motor_coulomb_friction_n", d.motor_coulomb_friction_n(), 1.0, &|| {
            self.motor_only(|m| sliding(&m.motor, vs))
        });
        add("axial_stiffness_n_m", d.axial_stiffness_n_m(), 1.0, &|| self.coupling(stretch));
        add("structural_damping_n_s_m", d.structural_damping_n_s_m(), 1.0, &|| self.coupling(stretch_rate));
        add("movable_mass_kg", d.movable_mass_kg(), 1.0, &|| self.stage_only(|m| m.stage.accel_m_s2.clone()));
        add("translational_damping_n_s_m", d.translational_damping_n_s_m(), 1.0, &|| {
            self.stage_only(|m| m.stage.velocity_m_s.clone())
        });
        add("stage_coulomb_friction_n", d.stage_coulomb_friction_n(), 1.0, &|| {
            self.stage_only(|m| sliding(&m.stage, vs))
        });
        // A screw's lead is good to some 10 um/m, and so is a scale: what they differ by stretches the
        // spring.
        list.push(Number {
            key: None,
            nominal: 0.0,
            key_per_coefficient: 1.0,
            column: self.coupling(|m| m.stage.position_m.iter().map(|x| x - m.centre_m).collect()),
        });
        for recording in 0..self.motions.len() {
            let column = self
                .lengths()
                .iter()
                .enumerate()
                .map(|(k, &n)| {
                    if k == recording {
                        Sides { motor: Some(vec![1.0; n]), stage: Some(vec![-1.0; n]) }
                    } else {
                        Sides::default()
                    }
                })
                .collect();
            list.push(Number { key: None, nominal: 0.0, key_per_coefficient: 1.0, column });
        }
        list
    }

    /// Takes the free stretch from the forces between the sides that are constant or grow along the screw,
    /// which stand last among the numbers.
    pub(crate) fn update_free_stretch(&mut self, coefficients: &[f64]) {
        let Some(spring) = self.numbers.iter().position(Number::is_spring) else { return };
        // A fit on its way may have lost the spring.
        let stated = self.numbers[spring].nominal;
        self.fitted_stiffness_n_m = coefficients[spring].clamp(0.2 * stated, 5.0 * stated);
        let first = self.numbers.len() - self.motions.len();
        self.lead_error = -coefficients[first - 1] / self.fitted_stiffness_n_m;
        for (zero, force) in self.free_stretch_m.iter_mut().zip(&coefficients[first..]) {
            *zero = -force / self.fitted_stiffness_n_m;
        }
    }
}

/// tanh(v / v_s): direction of sliding, smooth through zero.
///
/// Of a velocity with noise s the mean is tanh + s^2/2 tanh'': that is taken out, or what is missing at creep
/// would look like a Stribeck bump. Checked by: tests::noise_takes_nothing_off_the_direction.
fn sliding(side: &Side, smoothing_m_s: f64) -> Vec<f64> {
    /// Square of noise over smoothing to which second order is enough.
    const MOST: f64 = 0.25;
    let noise = (side.velocity_noise_m_s / smoothing_m_s).powi(2).min(MOST);
    let direction = |v: &f64| {
        let z = (v / smoothing_m_s).tanh();
        z + noise * z * (1.0 - z * z)
    };
    side.velocity_m_s.iter().map(direction).collect()
}

/// D = x_m - x_s, less its mean over the recording.
pub(crate) fn stretch(m: &Motion) -> Vec<f64> {
    let sides = m.motor.position_m.iter().zip(&m.stage.position_m);
    sides.map(|(a, b)| a - b - m.stretch_zero_m).collect()
}

/// D' = v_m - v_s.
pub(crate) fn stretch_rate(m: &Motion) -> Vec<f64> {
    m.motor.velocity_m_s.iter().zip(&m.stage.velocity_m_s).map(|(a, b)| a - b).collect()
}

/// Derivative of an already low-passed series, five points: exact to (w dt)^4 / 30.
pub(crate) fn derivative(x: &[f64], rate_hz: f64) -> Vec<f64> {
    let n = x.len();
    let at = |i: isize| x[i.clamp(0, n as isize - 1) as usize];
    (0..n as isize)
        .map(|i| (8.0 * (at(i + 1) - at(i - 1)) - (at(i + 2) - at(i - 2))) * rate_hz / 12.0)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_takes_nothing_off_the_direction() {
        // Noise of two values, +-s: its second moment is s^2, and tanh of both averages to what noise leaves.
        let (smoothing_m_s, noise_m_s) = (3.6e-4, 9.0e-5);
        let at = |v: f64, velocity_noise_m_s: f64| {
            let side = Side {
                position_m: vec![0.0],
                velocity_m_s: vec![v],
                accel_m_s2: vec![0.0],
                velocity_noise_m_s,
                raw_m: vec![0.0],
                before_m: Vec::new(),
            };
            sliding(&side, smoothing_m_s)[0]
        };
        for k in 1..30 {
            let v = f64::from(k) * 5e-5;
            let mean = |noise: f64| 0.5 * (at(v - noise_m_s, noise) + at(v + noise_m_s, noise));
            let truth = (v / smoothing_m_s).tanh();
            let [plain, corrected] = [0.0, noise_m_s].map(|noise| (mean(noise) - truth).abs());
            assert!(corrected < 0.004, "{v} m/s: off by {corrected}");
            assert!(corrected < 0.3 * plain + 1e-3, "{v} m/s: {corrected}, without {plain}");
        }
    }
}
