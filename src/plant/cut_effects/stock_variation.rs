//! The stock is harder or softer in a sector.

use super::{AtAngle, CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};
use std::f64::consts::{PI, TAU};

/// The stock is harder or softer in a sector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StockVariation {
    /// r.
    pub relative_change: f64,
    /// Width of the sector, rad.
    pub sector_rad: f64,
    /// Middle of the sector, rad.
    pub centre_rad: f64,
}

impl CutLaw for StockVariation {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::StockVariation,
        port: Port::Process,
        parameters: &[
            Parameter {
                name: "relative_change",
                unit: "",
                low: -1.0,
                high: 5.0,
                neutral: 0.0,
                scale: 0.3,
                role: Role::Key,
            },
            Parameter {
                name: "sector_rad",
                unit: "rad",
                low: 0.0,
                high: TAU,
                neutral: f64::NAN,
                scale: 1.0,
                role: Role::Shape,
            },
            Parameter {
                name: "centre_rad",
                unit: "rad",
                low: -12.6,
                high: 12.6,
                neutral: f64::NAN,
                scale: 1.0,
                role: Role::Shape,
            },
        ],
        equivalents: &[],
        statement: "The stock is harder or softer in a sector: both tools meet it half a turn apart.",
        equation: "F_j (1 + r) where the material angle psi_j is within sector/2 of the centre",
        mistaken_for: &[EffectKind::Runout],
        told_apart_by: "a second pass, and three feeds: the step of the force grows with the whole force",
    };

    fn from_values([relative_change, sector_rad, centre_rad]: Values) -> Self {
        Self { relative_change, sector_rad, centre_rad }
    }

    fn values(&self) -> Values {
        [self.relative_change, self.sector_rad, self.centre_rad]
    }

    fn enter(&self, _: &Place, terms: &mut CutTerms) {
        terms.stock_factor *= 1.0 + self.relative_change * self.sector_rad / TAU;
    }

    fn modulate(&self, psi_rad: f64, now: &mut AtAngle) {
        let from_centre = (psi_rad - self.centre_rad + PI).rem_euclid(TAU) - PI;
        if from_centre.abs() <= self.sector_rad / 2.0 {
            now.factor *= 1.0 + self.relative_change;
        }
    }
}
