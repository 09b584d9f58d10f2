//! The hypotheses: every effect of the vocabulary in coordinates that are 0 at nothing and about 1 on a
//! machine that has it, with bounds of sign and size.
//!
//! Where two numbers say size and phase, the coordinates are their cosine and sine parts; a stiffness that
//! vanishes at infinity enters as the compliance over that of the bar. The prior holds each to what exists.

use crate::plant::cut_effects::{
    ContactStiffness, CutEffect, EdgeForce, ForceLag, ForceSensorLag, ModeDrift, NonlinearCuttingForce,
    NoseRadius, PositionDependentMode, ProcessDamping, RegenerativeEffect, Runout, SecondMode, SecondPlane,
    Specification, SpeedDependentDynamics, SpeedDependentForce, SpindleSpeedVariation, StockVariation,
    SupportCompliance, ToolDifference, ToolWear, TurretCompliance,
};
use crate::plant::cut_terms::ChipMemory;
use crate::plant::effects::EffectKind;
use crate::plant::scenario::{Scenario, ToolCount};
use std::f64::consts::{PI, TAU};

/// Sizes of the machine to which effects are referred.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Scales {
    /// f_n.
    pub(crate) frequency_hz: f64,
    /// Modal stiffness of the bar.
    pub(crate) stiffness_n_m: f64,
    /// K_r b0.
    pub(crate) cutting_n_m: f64,
    /// Half the feed.
    pub(crate) chip_m: f64,
    /// b0.
    pub(crate) width_m: f64,
    /// S.
    pub(crate) speed_rpm: f64,
    /// v.
    pub(crate) surface_speed_m_s: f64,
    /// Projection length (or the position of the tools).
    pub(crate) length_m: f64,
    /// Tangential over radial force.
    pub(crate) tangential_ratio: f64,
    /// Stated bandwidth of the force signal.
    pub(crate) bandwidth_hz: f64,
    /// How long edges cut: of a recording, or from the first to the last cut of a table.
    pub(crate) duration_s: f64,
}

impl Scales {
    /// Those of a scenario.
    pub(crate) fn of(scenario: &Scenario) -> Self {
        let cutting = scenario.cutting.raw();
        let bar = &scenario.workpiece;
        Self {
            frequency_hz: bar.bending_frequency_hz(),
            stiffness_n_m: bar.modal_stiffness_n_m(),
            cutting_n_m: scenario.cutting.stiffness_n_m(),
            chip_m: (cutting.feed_m_rev / 2.0).max(1e-6),
            width_m: cutting.width_m.max(1e-6),
            speed_rpm: scenario.spindle.rpm(),
            surface_speed_m_s: PI * bar.diameter_m() * scenario.spindle.rpm() / 60.0,
            length_m: bar.projection_length_m(),
            tangential_ratio: cutting.tangential_ratio,
            bandwidth_hz: f64::INFINITY,
            duration_s: 6.0,
        }
    }
}

/// Split of two planes of size 1.
const PLANE_SPLIT: f64 = 0.05;

/// One coordinate of an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Coordinate {
    /// Least and greatest value.
    pub(crate) bounds: [f64; 2],
    /// Centre and standard deviation of what exists.
    pub(crate) prior: [f64; 2],
    /// A size, 0 at nothing; else a shape.
    pub(crate) is_size: bool,
}

const fn size(low: f64, high: f64) -> Coordinate {
    // A size of 1 is typical; three times that is rare.
    Coordinate { bounds: [low, high], prior: [0.0, 3.0], is_size: true }
}

const fn shape(bounds: [f64; 2], prior: [f64; 2]) -> Coordinate {
    Coordinate { bounds, prior, is_size: false }
}

/// One law that may be missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Law {
    /// The chip remembers the surface.
    Overlap,
    /// Flank damps.
    Damping,
    /// Force without chip.
    Edge,
    /// Power of the chip.
    Exponent,
    /// Round corner.
    Nose,
    /// Pressure falls with speed.
    Speed,
    /// Tool 2 stands ahead.
    Offset,
    /// Eccentric (1) or oval (2).
    Runout(u8),
    /// Second mode.
    Mode,
    /// Second plane.
    Plane,
    /// f_n in time.
    Drift,
    /// f_n along the bar.
    Position,
    /// Chuck rocks.
    Support,
    /// Spring of the contact.
    Contact,
    /// f_n over speed.
    SpeedDynamics,
    /// K_r in time.
    Wear,
    /// Tools differ.
    Difference,
    /// Holder of tool 2.
    Turret,
    /// Speed varies over a turn, that order.
    SpeedVariation(u8),
    /// Hard sector.
    Stock,
    /// Force lags.
    Lag,
    /// Signal lags.
    SensorLag,
    /// The force remembers: no effect of the vocabulary, but a rival to all of them. What is told of it is
    /// that something is left, at the process.
    Memory,
}

const OVERLAP: &[Coordinate] = &[Coordinate { bounds: [0.0, 1.3], prior: [1.0, 1.0], is_size: true }];
const SIGNED: &[Coordinate] = &[size(-8.0, 8.0)];
const POSITIVE: &[Coordinate] = &[size(0.0, 12.0)];
const POWER: &[Coordinate] = &[size(-2.4, 2.4)];
const ROCKING: &[Coordinate] = &[size(0.0, 6.0)];
const RATIO: &[Coordinate] = &[size(-3.3, 3.3)];
const TURNING: &[Coordinate] = &[size(-8.0, 8.0), size(-8.0, 8.0)];
// ln(f/f_n) from 1.1 to 3.2, compliance, ln(zeta/0.02).
const MODE: &[Coordinate] =
    &[size(0.0, 12.0), shape([0.095, 1.16], [0.6, 0.6]), shape([-2.5, 2.5], [0.0, 0.8])];
// ln(f/f_n) from 0.4 to 3.3, compliance, ln(zeta/0.04).
const TURRET: &[Coordinate] =
    &[size(0.0, 12.0), shape([-0.9, 1.2], [0.1, 0.6]), shape([-2.5, 2.5], [0.0, 0.8])];
// r2 and the split over 5 %. Of two planes neither is the likelier one to lie along the tools.
const PLANE: &[Coordinate] =
    &[Coordinate { bounds: [-0.7, 1.8], prior: [0.5, 0.6], is_size: true }, shape([-4.0, 4.0], [0.0, 1.2])];
const STOCK: &[Coordinate] =
    &[size(-3.2, 8.0), shape([0.05, 5.5], [1.2, 1.5]), shape([-12.0, 12.0], [0.0, 20.0])];
const SIGNAL: &[Coordinate] = &[size(0.0, 40.0), size(0.0, 12.0)];

impl Law {
    /// Everything that may be asked of a scenario.
    /// `probe`: on the bar; `recorded`: not a table alone.
    pub(crate) fn open(scenario: &Scenario, [probe, recorded]: [bool; 2]) -> Vec<Law> {
        let cutting = scenario.cutting.raw();
        let two = scenario.tools.count() == ToolCount::Two;
        let mut out = vec![
            Law::Nose,
            Law::Speed,
            Law::Runout(1),
            Law::Runout(2),
            Law::Mode,
            Law::Plane,
            Law::Drift,
            Law::Position,
            Law::Support,
            Law::Contact,
            Law::SpeedDynamics,
            Law::Wear,
            Law::SpeedVariation(1),
            Law::SpeedVariation(2),
            Law::Stock,
            Law::Lag,
        ];
        if two {
            out.extend([Law::Offset, Law::Difference, Law::Turret]);
        }
        let conditional = [
            (!cutting.regeneration, Law::Overlap),
            (cutting.process_damping_n <= 0.0, Law::Damping),
            (cutting.edge_force_n <= 0.0, Law::Edge),
            ((cutting.exponent - 1.0).abs() <= 0.0, Law::Exponent),
            (probe, Law::SensorLag),
            // Spreads from cut to cut are free in a table.
            (recorded, Law::Memory),
        ];
        out.extend(conditional.iter().filter(|c| c.0).map(|c| c.1));
        let has = |law: &Law| {
            let same = |e: CutEffect| match (law, e) {
                (Law::Offset, CutEffect::Runout(r)) => r.order < 0.5,
                (Law::Runout(n), CutEffect::Runout(r)) => (r.order - f64::from(*n)).abs() < 0.5,
                (Law::Offset | Law::Runout(_), _) => false,
                (_, e) => law.kind() == Some(e.kind()),
            };
            scenario.physics.iter().any(same)
        };
        out.retain(|law| !has(law));
        out
    }

    /// Effect of the vocabulary; `None`: it is none of it.
    pub(crate) fn kind(self) -> Option<EffectKind> {
        let kind = match self {
            Law::Memory => return None,
            Law::Overlap => EffectKind::RegenerativeEffect,
            Law::Damping => EffectKind::ProcessDamping,
            Law::Edge => EffectKind::EdgeForce,
            Law::Exponent => EffectKind::NonlinearCuttingForce,
            Law::Nose => EffectKind::NoseRadius,
            Law::Speed => EffectKind::SpeedDependentForce,
            Law::Offset | Law::Runout(_) => EffectKind::Runout,
            Law::Mode => EffectKind::SecondMode,
            Law::Plane => EffectKind::SecondPlane,
            Law::Drift => EffectKind::ModeDrift,
            Law::Position => EffectKind::PositionDependentMode,
            Law::Support => EffectKind::SupportCompliance,
            Law::Contact => EffectKind::ContactStiffness,
            Law::SpeedDynamics => EffectKind::SpeedDependentDynamics,
            Law::Wear => EffectKind::ToolWear,
            Law::Difference => EffectKind::ToolDifference,
            Law::Turret => EffectKind::TurretCompliance,
            Law::SpeedVariation(_) => EffectKind::SpindleSpeedVariation,
            Law::Stock => EffectKind::StockVariation,
            Law::Lag => EffectKind::ForceLag,
            Law::SensorLag => EffectKind::ForceSensorLag,
        };
        Some(kind)
    }

    /// What is particular to it; `None`: it has no name.
    pub(crate) fn specification(self) -> Option<&'static Specification> {
        self.kind().and_then(Specification::of)
    }

    /// For a person.
    pub(crate) fn name(self) -> &'static str {
        self.kind().map_or("a force that remembers", EffectKind::name)
    }

    /// Its coordinates, sizes first.
    pub(crate) fn coordinates(self) -> &'static [Coordinate] {
        match self {
            Law::Overlap => OVERLAP,
            // Pressure falls with speed and grows with wear.
            Law::Damping | Law::Edge | Law::Nose | Law::Contact | Law::Lag | Law::Speed | Law::Wear => {
                POSITIVE
            }
            Law::Exponent => POWER,
            Law::Offset | Law::Drift | Law::Position | Law::SpeedDynamics => SIGNED,
            Law::Support => ROCKING,
            Law::Difference => RATIO,
            Law::Runout(_) | Law::SpeedVariation(_) | Law::Memory => TURNING,
            Law::Mode => MODE,
            Law::Plane => PLANE,
            Law::Turret => TURRET,
            Law::Stock => STOCK,
            Law::SensorLag => SIGNAL,
        }
    }

    /// Shapes from which it is looked for, sizes at nothing.
    pub(crate) fn feet(self) -> Vec<Vec<f64>> {
        match self {
            Law::Mode | Law::Turret => {
                let [low, high] = self.coordinates()[1].bounds;
                // Some widths of a resonance apart.
                let count = ((high - low) / 0.05) as usize;
                (0..=count).map(|k| self.of_shapes(&[low + 0.05 * k as f64, 0.0])).collect()
            }
            Law::Plane => [-2.0, -1.2, -0.6, 0.6, 1.2, 2.0].iter().map(|s| self.of_shapes(&[*s])).collect(),
            Law::Stock => {
                let centres = (0..8).map(|k| TAU * f64::from(k) / 8.0);
                centres.flat_map(|c| [self.of_shapes(&[0.6, c]), self.of_shapes(&[1.6, c])]).collect()
            }
            _ => vec![self.of_shapes(&[])],
        }
    }

    /// A resonance at what stands out of the spectra of a model without it, ln(f/f_n).
    pub(crate) fn peaked(self, peaks: &[f64]) -> Vec<Vec<f64>> {
        let [low, high] = self.coordinates()[1].bounds;
        let seen = peaks.iter().copied().filter(|p| (low..high).contains(p));
        seen.map(|f| self.of_shapes(&[f, 0.0])).collect()
    }

    fn of_shapes(self, shapes: &[f64]) -> Vec<f64> {
        let sizes = self.coordinates().iter().filter(|c| c.is_size).map(|_| 0.0);
        sizes.chain(shapes.iter().copied()).collect()
    }

    /// A mass on a spring with a frequency of its own.
    pub(crate) fn is_resonance(self) -> bool {
        matches!(self, Law::Mode | Law::Turret)
    }

    /// True where what it does at a small size the numbers of the bar do as well: two planes are one of their
    /// mean frequency to first order. No screening tells what it is worth.
    pub(crate) fn is_of_second_order(self) -> bool {
        self == Law::Plane
    }

    /// The same shape with a first size of a typical machine.
    pub(crate) fn typical(self, start: &[f64]) -> Vec<f64> {
        let mut out = start.to_vec();
        let [low, high] = self.coordinates()[0].bounds;
        out[0] = 1.0_f64.copysign(start[0]).clamp(low, high);
        out
    }

    /// Number of coordinates that are sizes.
    pub(crate) fn sizes(self) -> usize {
        self.coordinates().iter().filter(|c| c.is_size).count()
    }
}

/// An effect in the fit.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Term {
    /// Which law.
    pub(crate) law: Law,
    /// Its coordinates.
    pub(crate) values: Vec<f64>,
}

impl Term {
    /// What the force on a vibrating chip is over its law; of size 1: a tenth, and a fifth of a
    /// radian at 650 Hz.
    pub(crate) fn memory(&self) -> Option<ChipMemory> {
        let [gain, late] = self.values[..] else { return None };
        (self.law == Law::Memory).then_some(ChipMemory { gain: 0.1 * gain, late_s: 5e-5 * late })
    }

    /// The effect of these coordinates; `None`: it is not there, or none of the vocabulary.
    pub(crate) fn effect(&self, scales: &Scales) -> Option<CutEffect> {
        let x = self.values[0];
        let y = self.values.get(1).copied().unwrap_or(0.0);
        let z = self.values.get(2).copied().unwrap_or(0.0);
        let there = x.abs() > 0.0 || self.law == Law::Overlap || (self.law.sizes() > 1 && y.abs() > 0.0);
        if there { self.of_sizes([x, y, z], scales) } else { None }
    }

    /// Two planes: share of the compliance and frequency over the stated one of the other.
    pub(crate) fn of_planes(share: f64, other: f64) -> Self {
        let held = |k: usize, x: f64| x.clamp(PLANE[k].bounds[0], PLANE[k].bounds[1]);
        Self { law: Law::Plane, values: vec![held(0, share), held(1, (other - 1.0) / PLANE_SPLIT)] }
    }

    /// The same of a term; `None`: no two planes.
    pub(crate) fn planes(&self) -> Option<[f64; 2]> {
        let [share, split] = self.values[..] else { return None };
        (self.law == Law::Plane).then_some([share, 1.0 + PLANE_SPLIT * split])
    }

    /// True where it is nothing, or where a coordinate ends at the last value that any machine has.
    pub(crate) fn is_at_bound(&self) -> bool {
        let mut with = self.values.iter().zip(self.law.coordinates());
        let nothing = |v: f64, c: &Coordinate| c.is_size && v.abs() < 1e-6;
        let ends = |v: f64, [low, high]: [f64; 2]| v - low < 1e-6 || high - v < 1e-6;
        with.clone().all(|(v, c)| !c.is_size || nothing(*v, c))
            || with.any(|(v, c)| !nothing(*v, c) && ends(*v, c.bounds))
    }

    /// Sizes of 1: an edge of a seventh of the force, damping of 60 N at 2.5 m/s and 0.2 mm; each a
    /// typical machine's.
    fn of_sizes(&self, [x, y, z]: [f64; 3], s: &Scales) -> Option<CutEffect> {
        let polar = |amplitude: f64| (amplitude * x.hypot(y), y.atan2(x));
        let effect = match self.law {
            Law::Memory => return None,
            Law::Overlap => CutEffect::RegenerativeEffect(RegenerativeEffect { overlap: x }),
            Law::Damping => {
                CutEffect::ProcessDamping(ProcessDamping { process_damping_n: x * 60.0 * s.width_m / 0.2e-3 })
            }
            Law::Edge => CutEffect::EdgeForce(EdgeForce { force_n: x * 0.15 * s.cutting_n_m * s.chip_m }),
            Law::Exponent => {
                CutEffect::NonlinearCuttingForce(NonlinearCuttingForce { exponent: 1.0 + 0.25 * x })
            }
            Law::Nose => CutEffect::NoseRadius(NoseRadius { radius_m: s.width_m / (0.5 * x) }),
            Law::Speed => CutEffect::SpeedDependentForce(SpeedDependentForce { exponent: 0.12 * x }),
            Law::Offset => {
                CutEffect::Runout(Runout { amplitude_m: 0.1 * s.chip_m * x, order: 0.0, phase_rad: 0.0 })
            }
            Law::Runout(order) => {
                let (amplitude_m, phase_rad) = polar(0.1 * s.width_m);
                CutEffect::Runout(Runout { amplitude_m, order: f64::from(order), phase_rad })
            }
            Law::Mode => CutEffect::SecondMode(SecondMode {
                frequency_hz: s.frequency_hz * y.exp(),
                damping_ratio: 0.02 * z.exp(),
                n_m: s.stiffness_n_m / (0.1 * x),
            }),
            Law::Plane => CutEffect::SecondPlane(SecondPlane {
                frequency_hz: s.frequency_hz * (1.0 + PLANE_SPLIT * y),
                orientation_rad: orientation_rad(x, s.tangential_ratio),
            }),
            Law::Drift => CutEffect::ModeDrift(ModeDrift { hz_per_s: x * 0.004 * s.frequency_hz }),
            Law::Position => CutEffect::PositionDependentMode(PositionDependentMode {
                hz_per_m: x * 0.05 * s.frequency_hz / s.length_m,
            }),
            Law::Support => {
                let share = 0.15 * x;
                let n_m = s.stiffness_n_m * (1.0 / share - 1.0);
                CutEffect::SupportCompliance(SupportCompliance { n_m })
            }
            Law::Contact => CutEffect::ContactStiffness(ContactStiffness { n_m: 0.1 * s.cutting_n_m * x }),
            Law::SpeedDynamics => CutEffect::SpeedDependentDynamics(SpeedDependentDynamics {
                hz_per_rpm: x * 0.1 * s.frequency_hz / s.speed_rpm,
            }),
            Law::Wear => CutEffect::ToolWear(ToolWear { relative_per_s: 0.09 * x / s.duration_s }),
            Law::Difference => CutEffect::ToolDifference(ToolDifference { ratio: 1.0 + 0.15 * x }),
            Law::Turret => CutEffect::TurretCompliance(TurretCompliance {
                frequency_hz: s.frequency_hz * y.exp(),
                n_m: s.stiffness_n_m / (0.2 * x),
                damping_ratio: 0.04 * z.exp(),
            }),
            Law::SpeedVariation(order) => {
                let (relative, phase_rad) = polar(0.015);
                let order = f64::from(order);
                CutEffect::SpindleSpeedVariation(SpindleSpeedVariation { relative, order, phase_rad })
            }
            Law::Stock => CutEffect::StockVariation(StockVariation {
                relative_change: 0.3 * x,
                sector_rad: y,
                centre_rad: z.rem_euclid(TAU),
            }),
            Law::Lag => CutEffect::ForceLag(ForceLag { time_constant_s: 5e-5 * x }),
            Law::SensorLag => CutEffect::ForceSensorLag(ForceSensorLag {
                extra_delay_s: 2e-4 * x,
                bandwidth_hz: if y > 0.0 { s.bandwidth_hz / (1.0 + 0.3 * y) } else { f64::INFINITY },
            }),
        };
        Some(effect)
    }
}

/// The smaller of the two angles of a plane with the share `r2` of the compliance along the tools.
///
/// r2 = sin a (sin a + mu cos a) = 1/2 + (R/2) sin(2 a - phi), R = sqrt(1 + mu^2), phi = atan(1/mu)
fn orientation_rad(r2: f64, mu: f64) -> f64 {
    let size = 1f64.hypot(mu);
    let phi = 1f64.atan2(mu);
    let angle = ((2.0 * r2 - 1.0) / size).clamp(-1.0, 1.0).asin();
    let candidates = [(angle + phi) / 2.0, (PI - angle + phi) / 2.0, (-PI - angle + phi) / 2.0];
    candidates.iter().copied().fold(f64::MAX, |best, a| if a.abs() < best.abs() { a } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two planes come back as they were made, within what the fit allows.
    #[test]
    fn planes_are_what_they_were_made_of() {
        let [share, other] = Term::of_planes(0.2, 0.96).planes().expect("two planes");
        assert!((share - 0.2).abs() < 1e-12 && (other - 0.96).abs() < 1e-12);
        let [share, _] = Term::of_planes(-3.0, 1.0).planes().expect("two planes");
        assert!((share - PLANE[0].bounds[0]).abs() < 1e-12);
        assert!(Term { law: Law::Lag, values: vec![1.0] }.planes().is_none());
    }

    #[test]
    fn the_orientation_has_the_share_it_was_made_from() {
        for mu in [0.0, 1.0, 2.3] {
            for r2 in [-0.3f64, -0.05, 0.02, 0.2, 0.6] {
                let most = 0.5 + 0.5 * 1f64.hypot(mu);
                let r2 = r2.clamp(1.0 - most, most);
                let a = orientation_rad(r2, mu);
                assert!((a.sin() * (a.sin() + mu * a.cos()) - r2).abs() < 1e-12, "{mu} {r2} {a}");
            }
        }
    }
}
