//! The round corner of the tool turns the force away from the radius as the cut gets wider.

use super::{CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};

/// The round corner of the tool turns the force away from the radius as the cut gets wider.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoseRadius {
    /// r, m.
    pub radius_m: f64,
}

impl CutLaw for NoseRadius {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::NoseRadius,
        port: Port::Process,
        parameters: &[Parameter {
            name: "radius_m",
            unit: "m",
            low: 0.0,
            high: f64::INFINITY,
            neutral: f64::INFINITY,
            scale: 0.0004,
            role: Role::Key,
        }],
        equivalents: &[],
        statement: "The radial share of the cutting force falls with the width of cut: the corner of \
                    the tool is round.",
        equation: "K_r s(b)/s(b0), s = sqrt(1 - b/2r) to b = r, r/sqrt(r^2 + b^2) beyond",
        mistaken_for: &[EffectKind::SecondPlane, EffectKind::ToolWear],
        told_apart_by: "calm cuts at four widths: the force per width falls with the width alone",
    };

    fn from_values([radius_m, ..]: Values) -> Self {
        Self { radius_m }
    }

    fn values(&self) -> Values {
        [self.radius_m, 0.0, 0.0]
    }

    fn enter(&self, place: &Place, terms: &mut CutTerms) {
        terms.pressure_factor *= radial_share(place.at.width_m, self.radius_m)
            / radial_share(place.reference.width_m, self.radius_m);
    }
}

/// s(b): radial share of the force behind a round corner, 1 for a cut of no width.
fn radial_share(width_m: f64, radius_m: f64) -> f64 {
    if radius_m.is_infinite() {
        1.0
    } else if width_m <= radius_m {
        (1.0 - width_m / (2.0 * radius_m)).sqrt()
    } else {
        // 1e-9 m: an edge without a corner has no radial share at all, which no tool is.
        radius_m.max(1e-9) / radius_m.max(1e-9).hypot(width_m)
    }
}

#[cfg(test)]
mod tests {
    use super::radial_share;

    #[test]
    fn the_share_is_continuous_falls_and_starts_at_one() {
        let r = 0.4e-3;
        assert!((radial_share(0.0, r) - 1.0).abs() < 1e-15);
        assert!((radial_share(r, r) - radial_share(r * (1.0 + 1e-9), r)).abs() < 1e-8);
        let shares: Vec<f64> = (0..40).map(|k| radial_share(f64::from(k) * 0.05e-3, r)).collect();
        assert!(shares.windows(2).all(|w| w[1] < w[0]));
        assert!((radial_share(1e-4, f64::INFINITY) - 1.0).abs() < 1e-15);
    }
}
