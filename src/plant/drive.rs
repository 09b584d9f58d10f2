//! Parameters of one feed drive: a rigid mass, two inertias on a screw's spring, or three.
//!
//! ```text
//!  torque --> [ J_r ] --(k_tor, c_tor)-- [ J_s ] --R--(K_r, C_k)-- [ M_t ] <-- cutting force
//!             motor         coupling      screw          nut         stage
//! ```
//! Without the torsional pair it is the dual-inertia model of Yamada's thesis, 2.2; without the axial
//! spring, one rigid mass.

use std::f64::consts::TAU;
use thiserror::Error;

/// What was read, before anybody checked it. `None`: not stated.
#[derive(Debug, Clone, PartialEq, Default)]
#[expect(missing_docs, reason = "each field is its own unit-carrying name; meaning in docs/symbols.md")]
pub struct RawDriveParams {
    pub movable_mass_kg: Option<f64>,
    pub screw_lead_m: Option<f64>,
    pub rotary_inertia_kg_m2: Option<f64>,
    pub torque_constant_nm_a: Option<f64>,
    pub axial_stiffness_n_m: Option<f64>,
    pub structural_damping_n_s_m: Option<f64>,
    pub rotary_damping_nm_s_rad: Option<f64>,
    pub translational_damping_n_s_m: Option<f64>,
    pub stage_coulomb_friction_n: Option<f64>,
    pub motor_coulomb_friction_n: Option<f64>,
    pub friction_smoothing_m_s: Option<f64>,
    pub current_loop_bandwidth_rad_s: Option<f64>,
    pub amplifier_dead_time_s: Option<f64>,
    pub motor_encoder_delay_s: Option<f64>,
    pub stage_encoder_delay_s: Option<f64>,
    pub motor_encoder_resolution_m: Option<f64>,
    pub stage_encoder_resolution_m: Option<f64>,
    pub motor_encoder_signals_per_rev: Option<f64>,
    pub stage_encoder_signal_period_m: Option<f64>,
    pub motor_pole_count: Option<f64>,
    pub motor_slot_count: Option<f64>,
    pub screw_inertia_kg_m2: Option<f64>,
    pub torsional_stiffness_nm_rad: Option<f64>,
    pub torsional_damping_nm_s_rad: Option<f64>,
}

impl RawDriveParams {
    /// The number of a key that a fit may change; `None`: not one of them.
    pub fn number_mut(&mut self, key: &str) -> Option<&mut Option<f64>> {
        Some(match key {
            "movable_mass_kg" => &mut self.movable_mass_kg,
            "screw_lead_m" => &mut self.screw_lead_m,
            "rotary_inertia_kg_m2" => &mut self.rotary_inertia_kg_m2,
            "torque_constant_nm_a" => &mut self.torque_constant_nm_a,
            "axial_stiffness_n_m" => &mut self.axial_stiffness_n_m,
            "structural_damping_n_s_m" => &mut self.structural_damping_n_s_m,
            "rotary_damping_nm_s_rad" => &mut self.rotary_damping_nm_s_rad,
            "translational_damping_n_s_m" => &mut self.translational_damping_n_s_m,
            "stage_coulomb_friction_n" => &mut self.stage_coulomb_friction_n,
            "motor_coulomb_friction_n" => &mut self.motor_coulomb_friction_n,
            "current_loop_bandwidth_rad_s" => &mut self.current_loop_bandwidth_rad_s,
            "amplifier_dead_time_s" => &mut self.amplifier_dead_time_s,
            "motor_encoder_delay_s" => &mut self.motor_encoder_delay_s,
            "stage_encoder_delay_s" => &mut self.stage_encoder_delay_s,
            "friction_smoothing_m_s" => &mut self.friction_smoothing_m_s,
            _ => return None,
        })
    }
}

/// Why a set of parameters is not a drive.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ParamError {
    /// Required for this structure.
    #[error("{name} is missing: {why}")]
    Missing {
        /// Key.
        name: &'static str,
        /// What needs it.
        why: &'static str,
    },
    /// Not a physical value.
    #[error("{name} = {value} is not physical: {expected}")]
    NotPhysical {
        /// Key.
        name: &'static str,
        /// Value that was given.
        value: f64,
        /// What would be.
        expected: &'static str,
    },
}

/// How many masses the model has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Structure {
    /// One mass; no axial stiffness is stated.
    Rigid,
    /// Motor and stage on the screw's axial spring.
    DualInertia,
    /// Motor, screw and stage: a torsional spring in front of the axial one.
    TripleInertia,
}

/// Checked parameters of one drive; read-only.
///
/// Fields that a structure does not have are zero (damping, friction, delays, resolution) or `None`.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveParams {
    raw: RawDriveParams,
    structure: Structure,
}

macro_rules! read {
    ($($(#[$doc:meta])* $name:ident),* $(,)?) => {
        $(
            $(#[$doc])*
            #[must_use]
            pub fn $name(&self) -> f64 {
                self.raw.$name.unwrap_or(0.0)
            }
        )*
    };
}

impl DriveParams {
    /// The stated number of a key that a fit may change; see [`RawDriveParams::number_mut`].
    #[must_use]
    pub fn number(&self, key: &str) -> Option<f64> {
        *self.raw.clone().number_mut(key)?
    }

    /// This drive with other numbers; keys that are none of those of [`RawDriveParams::number_mut`] change
    /// nothing.
    /// Errors: numbers that make no drive, as in [`DriveParams::new`].
    pub fn with_numbers<'k>(
        &self,
        numbers: impl IntoIterator<Item = (&'k str, f64)>,
    ) -> Result<Self, ParamError> {
        let mut raw = self.raw.clone();
        for (key, value) in numbers {
            if let Some(number) = raw.number_mut(key) {
                *number = Some(value);
            }
        }
        Self::new(raw)
    }

    /// Checks a set of parameters and finds its structure.
    /// Errors: a key missing for its structure, negative or non-finite values, zero mass, lead or stiffness.
    pub fn new(raw: RawDriveParams) -> Result<Self, ParamError> {
        let positive = [
            ("movable_mass_kg", raw.movable_mass_kg),
            ("screw_lead_m", raw.screw_lead_m),
            ("rotary_inertia_kg_m2", raw.rotary_inertia_kg_m2),
            ("torque_constant_nm_a", raw.torque_constant_nm_a),
            ("axial_stiffness_n_m", raw.axial_stiffness_n_m),
            ("friction_smoothing_m_s", raw.friction_smoothing_m_s),
            ("current_loop_bandwidth_rad_s", raw.current_loop_bandwidth_rad_s),
            ("screw_inertia_kg_m2", raw.screw_inertia_kg_m2),
            ("torsional_stiffness_nm_rad", raw.torsional_stiffness_nm_rad),
            ("motor_encoder_signals_per_rev", raw.motor_encoder_signals_per_rev),
            ("stage_encoder_signal_period_m", raw.stage_encoder_signal_period_m),
            ("motor_pole_count", raw.motor_pole_count),
            ("motor_slot_count", raw.motor_slot_count),
        ];
        for (name, value) in positive {
            if let Some(value) = value
                && !(value.is_finite() && value > 0.0)
            {
                return Err(ParamError::NotPhysical { name, value, expected: "a number above zero" });
            }
        }
        let not_negative = [
            ("structural_damping_n_s_m", raw.structural_damping_n_s_m),
            ("rotary_damping_nm_s_rad", raw.rotary_damping_nm_s_rad),
            ("translational_damping_n_s_m", raw.translational_damping_n_s_m),
            ("stage_coulomb_friction_n", raw.stage_coulomb_friction_n),
            ("motor_coulomb_friction_n", raw.motor_coulomb_friction_n),
            ("amplifier_dead_time_s", raw.amplifier_dead_time_s),
            ("motor_encoder_delay_s", raw.motor_encoder_delay_s),
            ("stage_encoder_delay_s", raw.stage_encoder_delay_s),
            ("motor_encoder_resolution_m", raw.motor_encoder_resolution_m),
            ("stage_encoder_resolution_m", raw.stage_encoder_resolution_m),
            ("torsional_damping_nm_s_rad", raw.torsional_damping_nm_s_rad),
        ];
        for (name, value) in not_negative {
            if let Some(value) = value
                && !(value.is_finite() && value >= 0.0)
            {
                return Err(ParamError::NotPhysical { name, value, expected: "zero or a number above" });
            }
        }
        let missing = |name, why| ParamError::Missing { name, why };
        if raw.movable_mass_kg.is_none() {
            return Err(missing("movable_mass_kg", "every axis moves a mass"));
        }
        let structure = match (raw.axial_stiffness_n_m, raw.torsional_stiffness_nm_rad) {
            (None, None) => Structure::Rigid,
            (None, Some(_)) => {
                return Err(missing(
                    "axial_stiffness_n_m",
                    "a torsional spring needs the axial one behind it",
                ));
            }
            (Some(_), None) => Structure::DualInertia,
            (Some(_), Some(_)) => Structure::TripleInertia,
        };
        if structure != Structure::Rigid {
            if raw.screw_lead_m.is_none() {
                return Err(missing("screw_lead_m", "a flexible axis has a screw"));
            }
            if raw.rotary_inertia_kg_m2.is_none() {
                return Err(missing("rotary_inertia_kg_m2", "a flexible axis has a motor side"));
            }
        }
        if structure == Structure::TripleInertia && raw.screw_inertia_kg_m2.is_none() {
            return Err(missing("screw_inertia_kg_m2", "three inertias need the one between the springs"));
        }
        if raw.rotary_inertia_kg_m2.is_some() && raw.screw_lead_m.is_none() {
            return Err(missing("screw_lead_m", "a rotary inertia acts on the stage through a screw"));
        }
        Ok(Self { raw, structure })
    }

    /// The parameters as they were given.
    #[must_use]
    pub fn raw(&self) -> &RawDriveParams {
        &self.raw
    }

    /// How many masses the model has.
    #[must_use]
    pub fn structure(&self) -> Structure {
        self.structure
    }

    read! {
        /// M_t: mass of the stage (of everything, on a rigid axis without a rotary inertia), kg.
        movable_mass_kg,
        /// J_r: inertia on the motor side, kg m2; zero when not stated.
        rotary_inertia_kg_m2,
        /// K_r: axial stiffness, N/m; zero on a rigid axis.
        axial_stiffness_n_m,
        /// C_k: damping beside the axial spring, N s/m.
        structural_damping_n_s_m,
        /// D_r: viscous damping on the motor side, N m s/rad.
        rotary_damping_nm_s_rad,
        /// C_t: viscous damping of the stage, N s/m.
        translational_damping_n_s_m,
        /// F_fric: Coulomb friction of the stage, N.
        stage_coulomb_friction_n,
        /// T_fric/R: Coulomb friction at the motor as a force on the screw axis, N.
        motor_coulomb_friction_n,
        /// T_s: dead time of the amplifier, s.
        amplifier_dead_time_s,
        /// T_m: delay of the motor encoder, s.
        motor_encoder_delay_s,
        /// T_t: delay of the stage encoder, s.
        stage_encoder_delay_s,
        /// Step of the motor encoder as stage travel, m.
        motor_encoder_resolution_m,
        /// Step of the stage encoder, m.
        stage_encoder_resolution_m,
        /// J_s: inertia behind the torsional spring, kg m2; zero but for three inertias.
        screw_inertia_kg_m2,
        /// Torsional stiffness between motor and screw, N m/rad; zero but for three inertias.
        torsional_stiffness_nm_rad,
        /// Damping beside the torsional spring, N m s/rad.
        torsional_damping_nm_s_rad,
    }

    /// Speed over which Coulomb friction turns its sign, F tanh(v / this), m/s. Default 0.2 mm/s.
    #[must_use]
    pub fn friction_smoothing_m_s(&self) -> f64 {
        self.raw.friction_smoothing_m_s.unwrap_or(2.0e-4)
    }

    /// Ways, m, after which a motor repeats what it does as often in a turn as it has pole pairs, poles or
    /// slots: cogging and commutation. Empty without a screw, or where none of them is stated.
    #[must_use]
    pub fn motor_waves_m(&self) -> Vec<f64> {
        let poles = self.raw.motor_pole_count.into_iter().flat_map(|n| [0.5 * n, n]);
        let orders = poles.chain(self.raw.motor_slot_count);
        self.screw_lead_m().map_or_else(Vec::new, |lead_m| orders.map(|order| lead_m / order).collect())
    }

    /// l: screw lead in m, where there is a screw.
    #[must_use]
    pub fn screw_lead_m(&self) -> Option<f64> {
        self.raw.screw_lead_m
    }

    /// R = l / 2 pi: stage travel per motor angle, m/rad; 1 where there is no screw (a linear motor).
    #[must_use]
    pub fn travel_m_rad(&self) -> f64 {
        self.raw.screw_lead_m.map_or(1.0, |lead| lead / TAU)
    }

    /// K_t: torque constant, N m/A, where stated.
    #[must_use]
    pub fn torque_constant_nm_a(&self) -> Option<f64> {
        self.raw.torque_constant_nm_a
    }

    /// K_t / R: thrust on the screw axis per current, N/A, where a torque constant is stated.
    #[must_use]
    pub fn thrust_constant_n_a(&self) -> Option<f64> {
        self.raw.torque_constant_nm_a.map(|k_t| k_t / self.travel_m_rad())
    }

    /// M_r = J_r / R^2: motor side as a mass on the screw axis, kg.
    #[must_use]
    pub fn reflected_mass_kg(&self) -> f64 {
        self.rotary_inertia_kg_m2() / self.travel_m_rad().powi(2)
    }

    /// C_r = D_r / R^2: damping of the motor side on the screw axis, N s/m.
    #[must_use]
    pub fn reflected_damping_n_s_m(&self) -> f64 {
        self.rotary_damping_nm_s_rad() / self.travel_m_rad().powi(2)
    }

    /// M_a = M_r + M_t (+ screw): all that moves, as a mass on the screw axis, kg.
    #[must_use]
    pub fn total_mass_kg(&self) -> f64 {
        self.movable_mass_kg()
            + self.reflected_mass_kg()
            + self.screw_inertia_kg_m2() / self.travel_m_rad().powi(2)
    }

    /// alpha = M_t / M_r, where there is a motor side.
    #[must_use]
    pub fn inertia_ratio(&self) -> Option<f64> {
        let m_r = self.reflected_mass_kg();
        (m_r > 0.0).then(|| self.movable_mass_kg() / m_r)
    }

    /// omega_cc: bandwidth of the current loop, rad/s; `None`: ideal.
    #[must_use]
    pub fn current_loop_bandwidth_rad_s(&self) -> Option<f64> {
        self.raw.current_loop_bandwidth_rad_s
    }

    /// Time constant of the current loop, s; ideal: zero.
    #[must_use]
    pub fn current_loop_s(&self) -> f64 {
        self.raw.current_loop_bandwidth_rad_s.map_or(0.0, f64::recip)
    }

    /// Period of the motor encoder's signals as travel, m; `None`: not stated.
    #[must_use]
    pub fn motor_encoder_signal_m(&self) -> Option<f64> {
        Some(self.raw.screw_lead_m? / self.raw.motor_encoder_signals_per_rev?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mass_alone_is_a_rigid_axis() {
        let raw = RawDriveParams { movable_mass_kg: Some(95.0), ..Default::default() };
        assert_eq!(DriveParams::new(raw).map(|d| d.structure()), Ok(Structure::Rigid));
    }

    #[test]
    fn a_negative_mass_is_refused_by_name() {
        let raw = RawDriveParams { movable_mass_kg: Some(-1.0), ..Default::default() };
        let error = DriveParams::new(raw).map_err(|e| e.to_string());
        assert_eq!(error, Err("movable_mass_kg = -1 is not physical: a number above zero".to_owned()));
    }
}
