//! A model's keys and terms as the constants of its equations of motion.

use crate::plant::drive::{DriveParams, RawDriveParams, Structure};
use crate::plant::effects::encoder_interpolation_error::EncoderError;
use crate::plant::effects::law::ForceLaw;
use crate::plant::effects::{
    EffectKind as E, PhysicsTerm, Port, Specification, backlash, encoder_quantization, friction_drift,
    nonlinear_stiffness, position_dependent_stiffness, presliding_friction, torque_constant_saturation,
    torsional_mode,
};
use crate::plant::machine::AxisModel;

/// Largest product of a rate of the equations and the step: Runge-Kutta is stable to 2.8 and exact to some
/// 1e-4 here.
const STEP_RATES: f64 = 0.7;

/// Friction that changes as the machine warms: by how much dry and viscous friction at its port change, time
/// constant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Warming {
    pub(super) change_n: f64,
    pub(super) change_n_s_m: f64,
    pub(super) time_constant_s: f64,
}

/// Constants of one model, on the screw axis, SI.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Constants {
    pub(super) rigid: bool,
    /// Motor side without what hangs behind a torsional spring, kg.
    pub(super) motor_kg: f64,
    /// Behind the torsional spring, kg; `None`: no such spring.
    pub(super) screw_kg: Option<f64>,
    pub(super) torsion_n_m: f64,
    pub(super) torsion_n_s_m: f64,
    pub(super) stage_kg: f64,
    pub(super) thrust_per_unit: f64,
    /// Share that the thrust loses per unit of the reference squared, while that is small.
    pub(super) saturation: f64,
    /// 0: k i / (1 + b i^2), 1: k i (1 - b i^2).
    pub(super) parabolic: f64,
    pub(super) stiffness_n_m: f64,
    pub(super) stiffness_slope_1_m: f64,
    pub(super) half_gap_m: f64,
    pub(super) cubic_n_m3: f64,
    pub(super) structural_n_s_m: f64,
    /// Viscous damping of motor and stage, N s/m.
    pub(super) viscous_n_s_m: [f64; 2],
    /// Coulomb friction of motor and stage, N.
    pub(super) coulomb_n: [f64; 2],
    pub(super) smoothing_m_s: f64,
    /// Dahl stiffness at the stage and the share of its friction that is so; zero: none.
    pub(super) bristle_n_m: f64,
    pub(super) bristle_share: f64,
    /// `None`: the current follows at once.
    pub(super) loop_rad_s: Option<f64>,
    pub(super) dead_time_s: f64,
    /// Of motor and stage encoder.
    pub(super) delay_s: [f64; 2],
    pub(super) step_m: [f64; 2],
    pub(super) errors: [Vec<EncoderError>; 2],
    pub(super) forces: [Vec<ForceLaw>; 2],
    pub(super) warming: [Vec<Warming>; 2],
    pub(super) not_simulated: Vec<E>,
}

impl Constants {
    /// `thrust_per_unit`: as in [`super::Trial`].
    pub(super) fn of(axis: &AxisModel, thrust_per_unit: Option<f64>) -> Self {
        let mut raw = axis.drive.raw().clone();
        let beyond: Vec<&PhysicsTerm> =
            axis.physics.iter().filter(|t| into_keys(t, &mut raw).is_none()).collect();
        let drive = DriveParams::new(raw).unwrap_or_else(|_| axis.drive.clone());
        let mut c = Self::bare(&drive, thrust_per_unit);
        for term in beyond {
            if c.add(term, drive.screw_lead_m()).is_none() {
                c.not_simulated.push(term.effect);
            }
        }
        c
    }

    fn bare(d: &DriveParams, thrust_per_unit: Option<f64>) -> Self {
        let rigid = d.structure() == Structure::Rigid;
        let both = |motor: f64, stage: f64| if rigid { [motor + stage, 0.0] } else { [motor, stage] };
        Self {
            rigid,
            motor_kg: if rigid { d.total_mass_kg() } else { d.reflected_mass_kg() },
            screw_kg: None,
            torsion_n_m: 0.0,
            torsion_n_s_m: 0.0,
            stage_kg: if rigid { 1.0 } else { d.movable_mass_kg() },
            thrust_per_unit: thrust_per_unit.or(d.thrust_constant_n_a()).unwrap_or(1.0),
            saturation: 0.0,
            parabolic: 0.0,
            stiffness_n_m: d.axial_stiffness_n_m(),
            stiffness_slope_1_m: 0.0,
            half_gap_m: 0.0,
            cubic_n_m3: 0.0,
            structural_n_s_m: if rigid { 0.0 } else { d.structural_damping_n_s_m() },
            viscous_n_s_m: both(d.reflected_damping_n_s_m(), d.translational_damping_n_s_m()),
            coulomb_n: both(d.motor_coulomb_friction_n(), d.stage_coulomb_friction_n()),
            smoothing_m_s: d.friction_smoothing_m_s(),
            bristle_n_m: 0.0,
            bristle_share: 0.0,
            loop_rad_s: d.current_loop_bandwidth_rad_s(),
            dead_time_s: d.amplifier_dead_time_s(),
            delay_s: [d.motor_encoder_delay_s(), d.stage_encoder_delay_s()],
            step_m: [d.motor_encoder_resolution_m(), d.stage_encoder_resolution_m()],
            errors: [Vec::new(), Vec::new()],
            forces: [Vec::new(), Vec::new()],
            warming: [Vec::new(), Vec::new()],
            not_simulated: Vec::new(),
        }
    }

    /// Adds one term; `None`: it has no law here or lacks a parameter.
    fn add(&mut self, term: &PhysicsTerm, lead_m: Option<f64>) -> Option<()> {
        let get = |parameter| term.value(parameter);
        let at_stage = !self.rigid && !matches!(term.port, Port::Motor | Port::Current);
        let side = usize::from(at_stage);
        if let Some(law) = ForceLaw::of(term, lead_m) {
            self.forces[side].push(law);
            return Some(());
        }
        let encoder = usize::from(term.port == Port::StageEncoder);
        match term.effect {
            E::EncoderInterpolationError => self.errors[encoder].push(EncoderError::of(term)?),
            E::EncoderQuantization => {
                self.step_m[encoder] = self.step_m[encoder].max(get(&encoder_quantization::STEP)?);
            }
            E::FrictionDrift => {
                let change = get(&friction_drift::CHANGE)?;
                let viscous = term.says(&friction_drift::WITH_VISCOUS);
                self.warming[side].push(Warming {
                    change_n: change * self.coulomb_n[side],
                    change_n_s_m: if viscous { change * self.viscous_n_s_m[side] } else { 0.0 },
                    time_constant_s: get(&friction_drift::TIME)?,
                });
            }
            E::PreslidingFriction if at_stage || self.rigid => {
                self.bristle_n_m = get(&presliding_friction::STIFFNESS)?;
                self.bristle_share = get(&presliding_friction::SHARE).unwrap_or(1.0);
            }
            E::TorqueConstantSaturation => {
                self.saturation += get(&torque_constant_saturation::PER_A2)?;
                self.parabolic = get(&torque_constant_saturation::PARABOLIC).unwrap_or(0.0);
            }
            E::Backlash => self.half_gap_m += 0.5 * get(&backlash::GAP)?,
            E::NonlinearStiffness => self.cubic_n_m3 += get(&nonlinear_stiffness::CUBIC)?,
            E::PositionDependentStiffness => {
                self.stiffness_slope_1_m += get(&position_dependent_stiffness::VARIATION)?
                    / get(&position_dependent_stiffness::LENGTH)?;
            }
            E::TorsionalMode if self.screw_kg.is_none() => {
                let share =
                    get(&torsional_mode::SHARE).unwrap_or(torsional_mode::SHARE.usual).clamp(0.02, 0.98);
                let screw_kg = share * self.motor_kg;
                self.motor_kg -= screw_kg;
                let frequency_hz = get(&torsional_mode::FREQUENCY)?;
                self.torsion_n_m = torsional_mode::stiffness_of(frequency_hz, self.motor_kg, screw_kg);
                let damping = get(&torsional_mode::DAMPING).unwrap_or(torsional_mode::DAMPING.usual);
                self.torsion_n_s_m = 2.0 * damping * (self.torsion_n_m * screw_kg).sqrt();
                self.screw_kg = Some(screw_kg);
            }
            _ => return None,
        }
        Some(())
    }

    /// Step at which the fastest motion of the model is followed, s. `fastest_m_s`: of the command.
    pub(super) fn longest_step_s(&self, fastest_m_s: f64) -> f64 {
        /// A bristle that slides is only to stay stable.
        const SLIDING: f64 = 0.35;
        let stage_kg = if self.rigid { self.motor_kg } else { self.stage_kg };
        let bristled = usize::from(!self.rigid);
        let slope = |n: usize, kg: f64| {
            let smooth = if n == bristled { 1.0 - self.bristle_share } else { 1.0 };
            (smooth.abs() * self.coulomb_n[n] / self.smoothing_m_s + self.viscous_n_s_m[n]) / kg
        };
        let near_kg = self.screw_kg.unwrap_or(self.motor_kg);
        let rates = [
            slope(0, self.motor_kg),
            slope(1, stage_kg),
            ((self.stiffness_n_m + self.torsion_n_m) * (1.0 / near_kg + 1.0 / stage_kg)).sqrt(),
            (self.structural_n_s_m + self.torsion_n_s_m) * (1.0 / near_kg + 1.0 / stage_kg),
            (self.bristle_n_m / stage_kg).sqrt(),
            SLIDING * self.bristle_n_m * fastest_m_s / self.coulomb_n[bristled].max(1.0e-3),
            self.loop_rad_s.unwrap_or(0.0),
        ];
        STEP_RATES / rates.into_iter().fold(1.0, f64::max)
    }
}

/// Terms that are keys of a drive by another name and no forces.
fn into_keys(term: &PhysicsTerm, raw: &mut RawDriveParams) -> Option<()> {
    Specification::of(term.effect).filter(|s| s.force.is_none())?;
    term.into_key(raw)
}

/// A number of each of several models side by side.
pub(super) type Lane<const L: usize> = [f64; L];
