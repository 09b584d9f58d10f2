//! The flank on the wavy surface damps: force in proportion to the slope of the cut.

use super::{CutLaw, Equivalent, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};

/// The flank on the wavy surface damps: force in proportion to the slope of the cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProcessDamping {
    /// C_i: force per unit slope of the cut surface at the scenario's width, N.
    pub process_damping_n: f64,
}

impl CutLaw for ProcessDamping {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::ProcessDamping,
        port: Port::Process,
        parameters: &[Parameter {
            name: "process_damping_n",
            unit: "N",
            low: 0.0,
            high: 100000.0,
            neutral: 0.0,
            scale: 60.0,
            role: Role::Key,
        }],
        equivalents: &[Equivalent {
            name: "n_s_m",
            unit: "N s/m",
            from_key: |force, reference| force / reference.surface_speed_m_s,
            to_key: Some(|damping, reference| damping * reference.surface_speed_m_s),
        }],
        statement: "The flank of the tool presses on the wavy surface and damps the bar, the more the \
                    slower the cut.",
        equation: "F_j += (b/b0) C_i u_j'/v",
        mistaken_for: &[EffectKind::ForceLag, EffectKind::SecondPlane],
        told_apart_by: "the same cut at half the speed: the damping by the flank doubles",
    };

    fn from_values([process_damping_n, ..]: Values) -> Self {
        Self { process_damping_n }
    }

    fn values(&self) -> Values {
        [self.process_damping_n, 0.0, 0.0]
    }

    fn enter(&self, _: &Place, terms: &mut CutTerms) {
        terms.process_damping_n += self.process_damping_n;
    }
}
