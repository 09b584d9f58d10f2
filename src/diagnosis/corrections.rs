//! Numbers of the model that the recordings contradict.

use super::bench::Bench;
use super::problem::Problem;
use super::result::Correction;
use super::terms;
use crate::plant::effects::PhysicsTerm;
use crate::plant::machine::AxisModel;

/// A law of the stated model whose size the recordings contradict.
pub(super) struct OtherSize {
    /// Its place among the physics of the axis.
    pub(super) index: usize,
    /// The law as the recordings have it.
    pub(super) term: PhysicsTerm,
    /// Its numbers.
    pub(super) corrections: Vec<Correction>,
}

/// Deviations of curvature are widened by this before a correction is claimed.
const DEVIATION_FACTOR: f64 = 2.0;

/// Numbers beyond what their identification is good for: of the structure by 3 %, friction by 8 %, damping by
/// 12 %.
pub(super) fn material(c: &Correction) -> bool {
    is_law(&c.name) || is_material(&c.name, c.value / c.nominal)
}

/// True for a number of a law that the model states; others are keys of the drive.
fn is_law(name: &str) -> bool {
    name.contains('.')
}

/// The same of a key and how many times the stated value it has.
pub(super) fn is_material(key: &str, times: f64) -> bool {
    let limit = if key.contains("damping") {
        0.12
    } else if key.contains("coulomb") {
        0.08
    } else if key.ends_with("_s") {
        // A delay is listed only where it is off by more than how a sample is taken.
        return true;
    } else {
        0.03
    };
    (times - 1.0).abs() > limit
}

/// Every number of the model that stands significantly elsewhere, with its interval.
pub(super) fn corrections(p: &Problem, bench: &Bench<'_>) -> Vec<Correction> {
    let s = &bench.solution;
    let scale = scale_deviation(is_scaled(p));
    let mut list = Vec::new();
    let common = common_scale(p, bench);
    for (k, n) in p.numbers.iter().enumerate() {
        let Some(name) = n.key else { continue };
        let f = n.key_per_coefficient / common;
        list.extend(correction(
            name,
            n.key_per_coefficient * n.nominal,
            (f * s.coefficients[k], f * s.deviations[k]),
            scale,
        ));
    }
    let constant = p.drive.torque_constant_nm_a().filter(|_| common != 1.0);
    list.extend(constant.map(|nominal| of_torque_constant((nominal, nominal / common))));
    list
}

/// A torque constant that every force is measured by, known to 1.5 %.
fn of_torque_constant((nominal, value): (f64, f64)) -> Correction {
    let half = 1.96 * 0.015 * value;
    Correction { name: "torque_constant_nm_a".into(), nominal, value, ci95: [value - half, value + half] }
}

/// What the scale of the recorded unit adds to every number's deviation, as a share.
fn scale_deviation(scaled: bool) -> f64 {
    if scaled { terms::SCALE_DEVIATION } else { 0.0 }
}

/// True where a torque constant says what the recorded unit is in newtons.
pub(super) fn is_scaled(p: &Problem) -> bool {
    p.motions.iter().any(|m| (m.thrust_per_unit - 1.0).abs() > 1e-12)
}

/// A number with its deviation by curvature, if it stands significantly elsewhere than stated.
fn correction(
    name: &'static str,
    nominal: f64,
    (value, deviation): (f64, f64),
    scale: f64,
) -> Option<Correction> {
    let deviation = DEVIATION_FACTOR * deviation;
    let apart = (value - nominal).abs();
    let half = 1.96 * deviation.hypot(scale * value);
    let significant = apart > (4.0 * deviation).max(half) && apart > 0.005 * nominal.abs();
    // A number that the recordings cannot tell runs anywhere.
    let told = significant && (0.2..5.0).contains(&(value / nominal));
    told.then_some(Correction { name: name.into(), nominal, value, ci95: [value - half, value + half] })
}

/// Corrections of numbers that were fitted in closed loop: key, value, deviation.
pub(super) fn of_loop(
    stated: &AxisModel,
    found: &AxisModel,
    numbers: &[(&'static str, f64, f64)],
    scaled: bool,
) -> Vec<Correction> {
    let scale = scale_deviation(scaled);
    let of = |axis: &AxisModel, key: &str| axis.drive.number(key);
    let told = numbers
        .iter()
        .filter_map(|(key, value, deviation)| correction(key, of(stated, key)?, (*value, *deviation), scale));
    let mut list: Vec<Correction> = told.collect();
    let constants = stated.drive.torque_constant_nm_a().zip(found.drive.torque_constant_nm_a());
    list.extend(constants.filter(|(nominal, value)| value != nominal).map(of_torque_constant));
    list
}

/// Every number that the recordings know, where they know it to be, listed as a correction or not: numbers
/// that were fitted together stand together in the model that is handed on.
pub(super) fn known_numbers(p: &Problem, bench: &Bench<'_>) -> Vec<(&'static str, f64)> {
    /// Share of itself that a number's deviation may be.
    const KNOWN: f64 = 0.03;
    let s = &bench.solution;
    let common = common_scale(p, bench);
    let of = |(k, n): (usize, &super::problem::Number)| {
        let (value, deviation) = (s.coefficients[k] / common, DEVIATION_FACTOR * s.deviations[k] / common);
        let known = deviation < KNOWN * value && (0.2..5.0).contains(&(value / n.nominal));
        n.key.filter(|_| known).map(|name| (name, value * n.key_per_coefficient))
    };
    p.numbers.iter().enumerate().filter_map(of).collect()
}

/// Masses, inertia and stiffness all off by one factor: the force they are measured by is off by it.
///
/// A balance holds for any common factor on all of its terms; that one torque constant is wrong is likelier
/// than that three independent numbers are, by the same share. 1: no such factor.
pub(super) fn common_scale(p: &Problem, bench: &Bench<'_>) -> f64 {
    if !is_scaled(p) {
        return 1.0;
    }
    let mut ratios: Vec<f64> = p
        .numbers
        .iter()
        .zip(&bench.solution.coefficients)
        .filter(|(n, _)| {
            matches!(n.key, Some("rotary_inertia_kg_m2" | "movable_mass_kg" | "axial_stiffness_n_m"))
        })
        .map(|(n, b)| b / n.nominal)
        .collect();
    ratios.sort_by(f64::total_cmp);
    let [low, middle, high] = ratios[..] else { return 1.0 };
    let together = low > 0.0 && (high / low).ln() < 0.08;
    if together && middle.ln().abs() > 0.05 { middle } else { 1.0 }
}
