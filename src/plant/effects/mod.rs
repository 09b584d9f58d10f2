//! The vocabulary of physics beyond a drive's structure, and the port where each enters.
//!
//! One file per effect of the drive holds its parameters with their bounds, its law, its words and what it is
//! mistaken for; simulation adds it to a machine, `diagnosis::drive::laws` fits it to a recording. To add
//! one: its file, its line in `effects!`, and the file of the same name there. Effects of the cut stand in
//! `plant::cut_effects`.

pub mod asymmetric_friction;
pub mod backlash;
pub mod coulomb_friction;
pub mod current_loop_lag;
pub mod cutting_force;
pub mod dead_time;
pub mod encoder_interpolation_error;
pub mod encoder_quantization;
pub mod external_disturbance;
pub mod friction_drift;
pub mod gravity_load;
pub mod law;
pub mod nonlinear_stiffness;
pub mod nonlinear_viscosity;
pub mod periodic;
pub mod position_dependent_force;
pub mod position_dependent_stiffness;
pub mod position_periodic_force;
pub mod presliding_friction;
mod specification;
pub mod stribeck_friction;
pub mod torque_constant_saturation;
pub mod torque_ripple;
pub mod torsional_mode;
pub mod viscous_friction;

pub use law::ForceLaw;
pub use specification::{
    AMPLITUDE_N, ForceOf, HARMONICS_N, PHASE, Parameter, Role, Specification, Spoken, WITH_DIRECTION,
};

use super::drive::RawDriveParams;
use std::fmt;

/// Where an effect enters the machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Port {
    /// Between the current reference and the torque.
    Current,
    /// A torque on the motor side, as a force on the screw axis.
    Motor,
    /// Between motor side and stage.
    Coupling,
    /// A force on the stage.
    Stage,
    /// What the motor encoder reports.
    MotorEncoder,
    /// What the linear scale reports.
    StageEncoder,
    /// The cutting process.
    Process,
    /// The bar and its support.
    Workpiece,
    /// The holder of tool 2.
    Turret,
    /// The spindle's rotation.
    Spindle,
    /// What the force signal shows of the force.
    ForceSensor,
}

impl Port {
    const NAMES: [(Port, &'static str); 11] = [
        (Port::Current, "current"),
        (Port::Motor, "motor"),
        (Port::Coupling, "coupling"),
        (Port::Stage, "stage"),
        (Port::MotorEncoder, "motor_encoder"),
        (Port::StageEncoder, "stage_encoder"),
        (Port::Process, "process"),
        (Port::Workpiece, "workpiece"),
        (Port::Turret, "turret"),
        (Port::Spindle, "spindle"),
        (Port::ForceSensor, "force_sensor"),
    ];

    /// Name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(p, _)| *p == self).map_or("", |(_, n)| n)
    }

    /// The port of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::NAMES.iter().find(|(_, n)| *n == name).map(|(p, _)| *p)
    }
}

impl fmt::Display for Port {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

macro_rules! effects {
    (
        drive { $($(#[$drive:meta])* $kind:ident = $file:ident),* $(,)? }
        cut { $($(#[$cut:meta])* $other:ident = $name:literal),* $(,)? }
    ) => {
        /// Specifications of all effects of the drive.
        pub const SPECIFICATIONS: &[Specification] = &[$($file::SPECIFICATION),*];

        /// Every effect of the vocabulary.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum EffectKind { $($(#[$drive])* $kind,)* $($(#[$cut])* $other),* }

        impl EffectKind {
            /// All of them, in the order of the vocabulary.
            pub const ALL: &[EffectKind] = &[$(EffectKind::$kind,)* $(EffectKind::$other),*];

            /// Name in files.
            #[must_use]
            pub fn name(self) -> &'static str {
                match self {
                    $(EffectKind::$kind => stringify!($file),)*
                    $(EffectKind::$other => $name),*
                }
            }

            /// The effect of that name.
            #[must_use]
            pub fn from_name(name: &str) -> Option<Self> {
                Self::ALL.iter().copied().find(|kind| kind.name() == name)
            }
        }
    };
}

effects! {
    drive {
        /// Force of constant size against the motion.
        CoulombFriction = coulomb_friction,
        /// Force proportional to speed.
        ViscousFriction = viscous_friction,
        /// Friction that is higher at very low speed.
        StribeckFriction = stribeck_friction,
        /// Friction that acts as a spring before it slides.
        PreslidingFriction = presliding_friction,
        /// Friction that differs between the directions.
        AsymmetricFriction = asymmetric_friction,
        /// Force proportional to speed squared.
        NonlinearViscosity = nonlinear_viscosity,
        /// Friction that changes as the machine warms.
        FrictionDrift = friction_drift,
        /// Force periodic in position.
        PositionPeriodicForce = position_periodic_force,
        /// Force that is any function of position.
        PositionDependentForce = position_dependent_force,
        /// Torque periodic in the motor angle.
        TorqueRipple = torque_ripple,
        /// Torque constant that falls with current.
        TorqueConstantSaturation = torque_constant_saturation,
        /// Constant force.
        GravityLoad = gravity_load,
        /// Dead zone in the coupling.
        Backlash = backlash,
        /// A third inertia.
        TorsionalMode = torsional_mode,
        /// Stiffness that depends on the position along the screw.
        PositionDependentStiffness = position_dependent_stiffness,
        /// Stiffness that depends on the load.
        NonlinearStiffness = nonlinear_stiffness,
        /// Additional delay.
        DeadTime = dead_time,
        /// Finite bandwidth of the current loop.
        CurrentLoopLag = current_loop_lag,
        /// Error inside each signal period of an encoder.
        EncoderInterpolationError = encoder_interpolation_error,
        /// Steps of an encoder.
        EncoderQuantization = encoder_quantization,
        /// A cut while the recording was taken for idle.
        CuttingForce = cutting_force,
        /// A force with no known law.
        ExternalDisturbance = external_disturbance,
    }
    cut {
        /// Chip thickness that remembers the last pass.
        RegenerativeEffect = "regenerative_effect",
        /// Damping by the flank on the wavy surface.
        ProcessDamping = "process_damping",
        /// Ploughing force of the edge.
        EdgeForce = "edge_force",
        /// Force that does not grow linearly with the chip.
        NonlinearCuttingForce = "nonlinear_cutting_force",
        /// Tool leaves the cut.
        LostContact = "lost_contact",
        /// Eccentric rotation.
        Runout = "runout",
        /// A second mode of the workpiece.
        SecondMode = "second_mode",
        /// Mode that moves during the cut.
        ModeDrift = "mode_drift",
        /// Stiffness of the contact.
        ContactStiffness = "contact_stiffness",
        /// Mode that moves with spindle speed.
        SpeedDependentDynamics = "speed_dependent_dynamics",
        /// Force that grows as the tool wears.
        ToolWear = "tool_wear",
        /// Radial share of the force by the round corner of the tool.
        NoseRadius = "nose_radius",
        /// Cutting pressure that falls with speed.
        SpeedDependentForce = "speed_dependent_force",
        /// Bending in a second plane.
        SecondPlane = "second_plane",
        /// Mode that moves with the tools' position.
        PositionDependentMode = "position_dependent_mode",
        /// Chuck that rocks.
        SupportCompliance = "support_compliance",
        /// Tools that do not cut alike.
        ToolDifference = "tool_difference",
        /// Holder of tool 2 that gives way.
        TurretCompliance = "turret_compliance",
        /// Rotation that is not uniform.
        SpindleSpeedVariation = "spindle_speed_variation",
        /// Stock that is harder or thicker in a sector.
        StockVariation = "stock_variation",
        /// Force that follows its law late.
        ForceLag = "force_lag",
        /// Force signal later and narrower than stated.
        ForceSensorLag = "force_sensor_lag",
    }
}

impl fmt::Display for EffectKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Value of a parameter of an effect.
#[derive(Debug, Clone, PartialEq)]
pub enum ParameterValue {
    /// One number.
    Number(f64),
    /// A table of numbers (maps over position).
    List(Vec<f64>),
}

/// Physics that a model has beyond its structure: one `[[axes.<axis>.physics]]` table.
#[derive(Debug, Clone, PartialEq)]
pub struct PhysicsTerm {
    /// What it is.
    pub effect: EffectKind,
    /// Where it enters.
    pub port: Port,
    /// Named parameters, units in the names.
    pub parameters: Vec<(String, ParameterValue)>,
}

impl PhysicsTerm {
    /// A term of numbers.
    #[must_use]
    pub fn new(effect: EffectKind, port: Port, numbers: &[(&Parameter, f64)]) -> Self {
        let of = |(p, value): &(&Parameter, f64)| (p.name.to_owned(), ParameterValue::Number(*value));
        Self { effect, port, parameters: numbers.iter().map(of).collect() }
    }

    /// A parameter that is one number, if it is there.
    #[must_use]
    pub fn number(&self, name: &str) -> Option<f64> {
        self.parameters.iter().find(|(n, _)| n == name).and_then(|(_, v)| match v {
            ParameterValue::Number(x) => Some(*x),
            ParameterValue::List(_) => None,
        })
    }

    /// Adds a parameter.
    pub fn push(&mut self, parameter: &Parameter, value: ParameterValue) {
        self.parameters.push((parameter.name.to_owned(), value));
    }

    /// That parameter, if it is there.
    #[must_use]
    pub fn value(&self, parameter: &Parameter) -> Option<f64> {
        self.number(parameter.name)
    }

    /// True for a choice that is there and is not zero.
    #[must_use]
    pub fn says(&self, choice: &Parameter) -> bool {
        self.value(choice).is_some_and(|x| x != 0.0)
    }

    /// Puts a term that is a number of a drive by another name into it. `None`: it is no such term.
    pub fn into_key(&self, raw: &mut RawDriveParams) -> Option<()> {
        Specification::of(self.effect)?.key?(self, raw)
    }

    /// A parameter that is a list, if it is there.
    #[must_use]
    pub fn list(&self, name: &str) -> Option<&[f64]> {
        self.parameters.iter().find(|(n, _)| n == name).and_then(|(_, v)| match v {
            ParameterValue::List(x) => Some(x.as_slice()),
            ParameterValue::Number(_) => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_effect_stands_in_one_registry_and_speaks_of_others_of_its_kind() {
        for kind in EffectKind::ALL {
            let of_drive = SPECIFICATIONS.iter().filter(|s| s.kind == *kind).count();
            let of_cut = crate::plant::cut_effects::Specification::of(*kind).is_some();
            // What leaves the cut is part of every cut and has no numbers.
            let of_cut = of_cut || *kind == EffectKind::LostContact;
            assert_eq!((of_drive, of_cut), (usize::from(!of_cut), of_cut), "{kind}");
        }
        for s in SPECIFICATIONS {
            for other in s.mistaken_for.iter().map(|k| Specification::of(*k).unwrap()) {
                assert_eq!(s.told_apart_by, other.told_apart_by, "{} and {}", s.kind, other.kind);
                assert!(other.mistaken_for.contains(&s.kind), "{} and {}", s.kind, other.kind);
            }
            let mut names: Vec<&str> = s.parameters.iter().map(|p| p.name).collect();
            names.sort_unstable();
            names.dedup();
            assert_eq!(names.len(), s.parameters.len(), "{}", s.kind);
            let phrases = [Port::Current, Port::Stage].map(|port| (s.phrase)(port));
            let told = phrases.iter().flat_map(|p| p.split('{').skip(1)).filter_map(|p| p.split('}').next());
            for name in told {
                assert!(["port", "period"].contains(&name) || s.parameter(name).is_some(), "{name}");
            }
        }
    }

    #[test]
    fn names_go_there_and_back() {
        for effect in EffectKind::ALL {
            assert_eq!(EffectKind::from_name(effect.name()), Some(*effect));
        }
        for (port, name) in Port::NAMES {
            assert_eq!(Port::from_name(name), Some(port));
            assert_eq!(port.name(), name);
        }
    }
}
