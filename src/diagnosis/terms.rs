//! Between hypotheses and what leaves the diagnosis: named parameters, terms of a model, sentences.

use super::bench::rms;
use super::hypothesis_fit::HypothesisFit;
use super::problem::Problem;
use super::result::Estimate;
use super::shape::{Hypothesis, Shape};
use crate::plant::effects::periodic::amplitude_phase;
use crate::plant::effects::{EffectKind as E, ParameterValue, PhysicsTerm, Port};
use std::f64::consts::TAU;

/// A stated torque constant is good to about one per cent, and every force is measured by it.
pub(crate) const SCALE_DEVIATION: f64 = 0.01;
/// Curvature intervals are widened: neighbouring samples of a residual are not quite independent.
const DEVIATION_FACTOR: f64 = 3.0;
/// Where inside a sample the drive takes up a reference is stated nowhere: part of a sample, as a deviation.
/// An eighth lies between the two simulations that were met.
const TAKING_UP_SAMPLES: f64 = 0.07;
/// What the balance is exact to, as a relative deviation of a constant that is no wavelength: series are
/// sampled, and a law between the samples is interpolated.
const EXACTNESS: f64 = 5e-4;
/// No model holds to better than this share of the thrust; what is left below it is no finding.
pub(super) const INEXACT_SHARE: f64 = 0.0015;
/// Where the data say nothing of a constant its interval ends at a thousandth and a thousand times it.
const MOST_DOUBT: f64 = 6.9;
pub(super) const Z95: f64 = 1.96;

/// Half of a 95 % interval of something of this deviation.
pub(crate) fn half_width(deviation: f64) -> f64 {
    (Z95 * DEVIATION_FACTOR * deviation).min(f64::MAX)
}

/// Collects estimates with their intervals.
struct Sheet {
    list: Vec<Estimate>,
    scale: f64,
}

impl Sheet {
    fn add(&mut self, name: &str, unit: &'static str, value: f64, deviation: f64) {
        let half = half_width(deviation);
        self.list.push(Estimate { name: name.to_owned(), value, unit, ci95: [value - half, value + half] });
    }

    /// A number that is measured in newtons: the torque constant's own error adds.
    fn add_force(&mut self, name: &str, unit: &'static str, value: f64, deviation: f64) {
        let total = (DEVIATION_FACTOR * deviation).hypot(self.scale * value);
        let half = (Z95 * total).min(f64::MAX);
        self.list.push(Estimate { name: name.to_owned(), value, unit, ci95: [value - half, value + half] });
    }

    /// A constant of a law that is evaluated between the samples.
    fn add_constant(&mut self, name: &str, unit: &'static str, value: f64, relative: f64) {
        self.add_log(name, unit, value, relative.hypot(EXACTNESS / DEVIATION_FACTOR));
    }

    /// Wavelengths and their like carry the interval of their logarithm.
    fn add_log(&mut self, name: &str, unit: &'static str, value: f64, relative: f64) {
        let half = half_width(relative).min(MOST_DOUBT);
        self.list.push(Estimate {
            name: name.to_owned(),
            value,
            unit,
            ci95: [value * (-half).exp(), value * half.exp()],
        });
    }
}

/// Numbers of an accepted finding.
pub(crate) fn estimates(p: &Problem, h: &Hypothesis, fit: &HypothesisFit) -> Vec<Estimate> {
    let scaled = p.motions.iter().any(|m| (m.thrust_per_unit - 1.0).abs() > 1e-12);
    let mut s = Sheet { list: Vec::new(), scale: if scaled { SCALE_DEVIATION } else { 0.0 } };
    let a = |k: usize| fit.amplitudes.get(k).copied().unwrap_or(0.0);
    let d = |k: usize| fit.amplitude_deviations.get(k).copied().unwrap_or(0.0);
    let r = |k: usize| fit.step_deviations.get(k).copied().unwrap_or(0.0);
    match &h.shape {
        Shape::Coulomb | Shape::Constant => s.add_force("force_n", "N", a(0), d(0)),
        Shape::Viscous => s.add_force("n_s_m", "N s/m", a(0), d(0)),
        Shape::Stribeck { velocity_m_s } => {
            s.add_force("stribeck_force_n", "N", a(0), d(0));
            s.add_constant("stribeck_velocity_m_s", "m/s", *velocity_m_s, r(0));
        }
        Shape::Presliding { stiffness_n_m } => {
            s.add_constant("presliding_stiffness_n_m", "N/m", *stiffness_n_m, r(0).hypot(s.scale));
            s.add("share", "1", a(0), d(0));
        }
        Shape::Asymmetric => s.add_force("force_difference_n", "N", a(0), d(0)),
        Shape::AsymmetricViscous => {
            s.add_force("force_difference_n", "N", a(0), d(0));
            s.add_force("viscous_difference_n_s_m", "N s/m", a(1), d(1));
        }
        Shape::NonlinearViscosity => s.add_force("n_s2_m2", "N s2/m2", a(0), d(0)),
        Shape::Drift { time_constant_s, .. } => {
            s.add("relative_change", "1", a(0), d(0));
            s.add_constant("time_constant_s", "s", *time_constant_s, r(0));
        }
        Shape::Periodic { wavelength_m, .. } => {
            let (amplitude, phase) = amplitude_phase(a(0), a(1));
            let deviation = d(0).max(d(1));
            if h.effect == E::TorqueRipple {
                let lead = p.drive.screw_lead_m().unwrap_or(TAU);
                s.add_log("order_per_rev", "1", lead / wavelength_m, r(0));
            } else {
                s.add_log("wavelength_m", "m", *wavelength_m, r(0));
            }
            s.add_force("amplitude_n", "N", amplitude, deviation);
            s.add("phase_rad", "rad", phase, deviation / amplitude.max(1e-300));
        }
        Shape::Map { .. } => {
            s.add_force("amplitude_n", "N", peak_of_map(&fit.amplitudes), d(0));
        }
        Shape::Saturation => s.add("per_a2", "1/A2", a(0), d(0).hypot(a(0) * EXACTNESS / DEVIATION_FACTOR)),
        Shape::Lag { extra_s } => {
            let w = lag_bandwidth(p, *extra_s);
            s.add_constant("bandwidth_rad_s", "rad/s", w, r(0) * (w * extra_s).min(1.0));
        }
        Shape::Delay { extra_s } => {
            let rate_hz = p.motions.first().map_or(1.0, |m| m.rate_hz);
            let taking_up = TAKING_UP_SAMPLES / rate_hz / extra_s / DEVIATION_FACTOR;
            s.add_constant("extra_delay_s", "s", *extra_s, r(0).hypot(taking_up));
        }
        Shape::Backlash { gap_m } => {
            // The gap is crossed where friction turns, and what no model of that holds to is told as a gap.
            let inexact_m = INEXACT_SHARE * rms(&p.target) / p.mechanics.stiffness_n_m;
            s.add_constant("gap_m", "m", *gap_m, r(0).hypot(inexact_m / gap_m / DEVIATION_FACTOR));
        }
        Shape::Smoothing { ratio } => {
            s.add_constant("friction_smoothing_m_s", "m/s", ratio * p.mechanics.smoothing_m_s, r(0));
        }
        Shape::Cubic => s.add_force("cubic_n_m3", "N/m3", a(0), d(0)),
        Shape::StiffnessSlope => {
            // The slope is what the recordings tell; the length is where they went.
            let length = travel_m(p);
            s.add("relative_variation", "1", a(0) * length, d(0) * length);
            s.add("length_m", "m", length, 0.0);
        }
        Shape::Torsion { frequency_hz, screw_share, damping_ratio } => {
            s.add_constant("free_free_frequency_hz", "Hz", *frequency_hz, r(0));
            s.add_constant("screw_inertia_share", "1", *screw_share, r(1));
            s.add_constant("damping_ratio", "1", *damping_ratio, r(2));
        }
        Shape::EncoderError { period_m, .. } => {
            let (amplitude, phase) = amplitude_phase(a(0), a(1));
            s.add("signal_period_m", "m", *period_m, 0.0);
            s.add("amplitude_m", "m", amplitude, d(0).max(d(1)));
            s.add("phase_rad", "rad", phase, d(0).max(d(1)) / amplitude.max(1e-300));
        }
        // Free forms are never a finding; they only say that no named effect is.
        Shape::Resonance { .. } | Shape::VelocityMap { .. } | Shape::PositionTimesVelocity => {}
        Shape::Lines { fundamental_hz, harmonics, window_s, .. } => {
            s.add_log("fundamental_hz", "Hz", *fundamental_hz, r(0));
            let (peak_n, deviation_n) = peak_of_cut(*harmonics, &fit.amplitudes, &fit.amplitude_deviations);
            s.add_force("amplitude_n", "N", peak_n, deviation_n);
            s.add("start_s", "s", window_s[0], 0.01);
            s.add("end_s", "s", window_s[1], 0.01);
        }
    }
    s.list
}

/// Largest force of a map about its mean.
pub(super) fn peak_of_map(knots: &[f64]) -> f64 {
    let mean = knots.iter().sum::<f64>() / knots.len().max(1) as f64;
    knots.iter().map(|f| (f - mean).abs()).fold(0.0, f64::max)
}

/// Largest force of a cut over a period, its mean included, with the deviation of the force there.
///
/// A tool that cuts part of the time pushes in pulses: their height is what the machine feels, not the
/// amplitude of one harmonic. `amplitudes`: as [`Hypothesis::columns`] orders them, set by set, then the
/// means.
pub(super) fn peak_of_cut(harmonics: usize, amplitudes: &[f64], deviations: &[f64]) -> (f64, f64) {
    /// Places in a period.
    const PLACES: usize = 360;
    let waves_of = 2 * harmonics;
    let sets = amplitudes.len() / (waves_of + 1);
    let mut most = (0.0, 0.0);
    for set in 0..sets {
        let waves = waves_of * set..waves_of * (set + 1);
        let mean = waves_of * sets + set;
        for place in 0..PLACES {
            let turn = TAU * place as f64 / PLACES as f64;
            let basis = (1..=harmonics).flat_map(|h| <[f64; 2]>::from((h as f64 * turn).sin_cos()));
            let (mut force, mut variance) = (amplitudes[mean], deviations[mean].powi(2));
            for (k, b) in waves.clone().zip(basis) {
                force += amplitudes[k] * b;
                variance += (deviations[k] * b).powi(2);
            }
            if force.abs() > most.0 {
                most = (force.abs(), variance.sqrt());
            }
        }
    }
    most
}

/// Bandwidth of the slower loop: 1/w' = 1/w + extra.
pub(super) fn lag_bandwidth(p: &Problem, extra_s: f64) -> f64 {
    1.0 / (p.drive.current_loop_s() + extra_s)
}

/// Travel that the recordings cover, m.
pub(crate) fn travel_m(p: &Problem) -> f64 {
    let (low, high) = p
        .motions
        .iter()
        .flat_map(|m| m.stage.position_m.iter())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(*x), h.max(*x)));
    (high - low).max(1e-9)
}

/// The finding as a term of a model, from which [`hypothesis`] rebuilds it.
pub(crate) fn term(p: &Problem, h: &Hypothesis, fit: &HypothesisFit) -> PhysicsTerm {
    let mut parameters: Vec<(String, ParameterValue)> =
        estimates(p, h, fit).into_iter().map(|e| (e.name, ParameterValue::Number(e.value))).collect();
    let mut list =
        |name: &str, values: Vec<f64>| parameters.push((name.to_owned(), ParameterValue::List(values)));
    match &h.shape {
        Shape::Periodic { harmonics, flips, .. } => {
            if *harmonics > 1 {
                list("harmonics_n", fit.amplitudes.clone());
            }
            if *flips {
                parameters.push(("with_direction".to_owned(), ParameterValue::Number(1.0)));
            }
        }
        Shape::Drift { viscous: true, .. } => {
            parameters.push(("with_viscous".to_owned(), ParameterValue::Number(1.0)));
        }
        Shape::EncoderError { harmonics, .. } if *harmonics > 1 => {
            list("harmonics_m", fit.amplitudes.clone())
        }
        Shape::Map { first_m, spacing_m, .. } => {
            list("force_n", fit.amplitudes.clone());
            parameters.push(("first_m".to_owned(), ParameterValue::Number(*first_m)));
            parameters.push(("spacing_m".to_owned(), ParameterValue::Number(*spacing_m)));
        }
        Shape::Lines { harmonics, .. } => {
            parameters.push(("harmonics".to_owned(), ParameterValue::Number(*harmonics as f64)))
        }
        _ => {}
    }
    PhysicsTerm { effect: h.effect, port: h.port, parameters }
}

/// The hypothesis that a term of a model states, with its amplitudes; `None`: not a law of this bank.
pub(crate) fn hypothesis(p: &Problem, term: &PhysicsTerm) -> Option<(Hypothesis, Vec<f64>)> {
    let get = |name: &str| term.number(name);
    let wave = |amplitude: f64| {
        let phase = get("phase_rad").unwrap_or(0.0);
        vec![amplitude * phase.cos(), amplitude * phase.sin()]
    };
    let (shape, amplitudes) = match term.effect {
        E::CoulombFriction => (Shape::Coulomb, vec![get("force_n")?]),
        E::GravityLoad => (Shape::Constant, vec![get("force_n")?]),
        E::ViscousFriction => (Shape::Viscous, vec![get("n_s_m")?]),
        E::StribeckFriction => {
            (Shape::Stribeck { velocity_m_s: get("stribeck_velocity_m_s")? }, vec![get("stribeck_force_n")?])
        }
        E::PreslidingFriction => (
            Shape::Presliding { stiffness_n_m: get("presliding_stiffness_n_m")? },
            vec![get("share").unwrap_or(1.0)],
        ),
        E::AsymmetricFriction => match get("viscous_difference_n_s_m") {
            Some(viscous) => (Shape::AsymmetricViscous, vec![get("force_difference_n")?, viscous]),
            None => (Shape::Asymmetric, vec![get("force_difference_n")?]),
        },
        E::NonlinearViscosity => (Shape::NonlinearViscosity, vec![get("n_s2_m2")?]),
        E::FrictionDrift => {
            let viscous = get("with_viscous").is_some_and(|x| x != 0.0);
            let time_constant_s = get("time_constant_s")?;
            (Shape::Drift { time_constant_s, viscous }, vec![get("relative_change")?])
        }
        E::PositionPeriodicForce | E::TorqueRipple => {
            let wavelength_m = match get("wavelength_m") {
                Some(w) => w,
                None => p.drive.screw_lead_m()? / get("order_per_rev")?,
            };
            let amplitudes = term
                .list("harmonics_n")
                .map_or_else(|| wave(get("amplitude_n").unwrap_or(0.0)), <[f64]>::to_vec);
            let flips = get("with_direction").is_some_and(|x| x != 0.0);
            (Shape::Periodic { wavelength_m, harmonics: amplitudes.len() / 2, flips }, amplitudes)
        }
        E::PositionDependentForce => {
            let force = term.list("force_n")?.to_vec();
            (
                Shape::Map {
                    first_m: get("first_m")?,
                    spacing_m: get("spacing_m")?,
                    knots: force.len(),
                    flips: false,
                },
                force,
            )
        }
        E::TorqueConstantSaturation => (Shape::Saturation, vec![get("per_a2")?]),
        E::Backlash => (Shape::Backlash { gap_m: get("gap_m")? }, vec![1.0]),
        E::TorsionalMode => (
            Shape::Torsion {
                frequency_hz: get("free_free_frequency_hz")?,
                screw_share: get("screw_inertia_share").unwrap_or(0.5),
                damping_ratio: get("damping_ratio").unwrap_or(0.02),
            },
            vec![1.0],
        ),
        E::PositionDependentStiffness => {
            (Shape::StiffnessSlope, vec![get("relative_variation")? / get("length_m")?])
        }
        E::NonlinearStiffness => (Shape::Cubic, vec![get("cubic_n_m3")?]),
        E::DeadTime => (Shape::Delay { extra_s: get("extra_delay_s")? }, vec![1.0]),
        E::CurrentLoopLag => {
            let slow = 1.0 / get("bandwidth_rad_s")?;
            let stated = p.drive.current_loop_s();
            (Shape::Lag { extra_s: (slow - stated).max(1e-7) }, vec![1.0])
        }
        E::EncoderInterpolationError => {
            let amplitudes = term
                .list("harmonics_m")
                .map_or_else(|| wave(get("amplitude_m").unwrap_or(0.0)), <[f64]>::to_vec);
            (
                Shape::EncoderError { period_m: get("signal_period_m")?, harmonics: amplitudes.len() / 2 },
                amplitudes,
            )
        }
        E::CuttingForce => {
            let harmonics = get("harmonics").unwrap_or(4.0).clamp(1.0, 20.0) as usize;
            let window_s = [get("start_s").unwrap_or(0.0), get("end_s").unwrap_or(f64::MAX)];
            let recordings: Vec<usize> = (0..p.motions.len()).collect();
            let amplitudes = vec![0.0; (2 * harmonics + 1) * recordings.len()];
            (
                Shape::Lines {
                    fundamental_hz: get("fundamental_hz")?,
                    harmonics,
                    window_s,
                    recordings,
                    common: false,
                },
                amplitudes,
            )
        }
        _ => return None,
    };
    Some((Hypothesis::new(term.effect, term.port, shape), amplitudes))
}

/// The law in symbols.
pub(crate) fn equation(effect: E) -> &'static str {
    match effect {
        E::CoulombFriction => "F = F_c tanh(v / v_s)",
        E::ViscousFriction => "F = C v",
        E::StribeckFriction => "F = F_st exp(-(v / v_st)^2) tanh(v / v_s)",
        E::PreslidingFriction => "F = s_0 z, dz/dt = v - |v| s_0 z / F_c",
        E::AsymmetricFriction => "F = (d / 2) |tanh(v / v_s)|",
        E::NonlinearViscosity => "F = c v |v|",
        E::FrictionDrift => "F = (F_c tanh(v / v_s) [+ C v]) r (1 - exp(-t / tau))",
        E::PositionPeriodicForce => "F = sum_h A_h sin(2 pi h x / wavelength + phase_h)",
        E::PositionDependentForce => "F = F(x), cubic between knots",
        E::TorqueRipple => "F = sum_h A_h sin(h order theta + phase_h)",
        E::TorqueConstantSaturation => "T = K_t i (1 - b i^2)",
        E::GravityLoad => "F = constant",
        E::Backlash => "S = K (D - clamp(D, -gap/2, gap/2))",
        E::TorsionalMode => "J_s e'' + c e' + (k + K) e = -J_s a_m - K D",
        E::PositionDependentStiffness => "S = K (1 + r x / L) D",
        E::NonlinearStiffness => "S = K D + K_3 D^3",
        E::DeadTime => "signal(t) -> signal(t - T)",
        E::CurrentLoopLag => "i' = w (i_ref - i)",
        E::EncoderInterpolationError => "x_read = x + sum_h A_h sin(2 pi h x / p + phase_h)",
        E::EncoderQuantization => "x_read = step round(x / step)",
        E::CuttingForce => "F = F_0 + sum_h A_h sin(2 pi h f t + phase_h) from start to end",
        _ => "a force with no known law",
    }
}

/// Domain in which the effect is a curve.
pub(crate) fn domain(effect: E) -> &'static str {
    match effect {
        E::PositionPeriodicForce
        | E::PositionDependentForce
        | E::EncoderInterpolationError
        | E::PositionDependentStiffness => "position",
        E::TorqueRipple => "motor_angle",
        E::CoulombFriction | E::ViscousFriction | E::StribeckFriction | E::NonlinearViscosity => "velocity",
        E::AsymmetricFriction | E::GravityLoad => "direction",
        E::PreslidingFriction | E::Backlash => "history",
        E::TorqueConstantSaturation | E::NonlinearStiffness => "current",
        E::DeadTime | E::CurrentLoopLag | E::TorsionalMode => "frequency",
        _ => "time",
    }
}

/// One sentence for a person.
pub(crate) fn statement(effect: E, port: Port, parameters: &[Estimate]) -> String {
    let name = |e: &Estimate| match effect {
        E::CuttingForce if e.name == "amplitude_n" => "peak".to_owned(),
        _ => quantity(&e.name, e.unit),
    };
    let numbers: Vec<String> = parameters
        .iter()
        .filter(|e| e.name != "phase_rad" && e.name != "share" && e.name != "length_m")
        .map(|e| format!("{} {}", name(e), engineering(e.value, e.unit)))
        .collect();
    format!(
        "The model leaves out {} at the {}: {}.",
        effect.name().replace('_', " "),
        port.name().replace('_', " "),
        numbers.join(", ")
    )
}

/// A parameter's name without its unit, in words.
fn quantity(name: &str, unit: &str) -> String {
    let tail = unit.to_lowercase().replace('/', " ");
    let words = name.replace('_', " ");
    words.strip_suffix(&tail).unwrap_or(&words).trim_end().to_owned()
}

/// A value in the unit of the shop floor: 1.0 um, 165 us, 5.64 N.
pub(crate) fn engineering(value: f64, unit: &str) -> String {
    let size = value.abs();
    let (factor, prefix) = match unit {
        "m" | "s" | "m/s" if size > 0.0 && size < 1e-6 => (1e9, "n"),
        "m" | "s" | "m/s" if size > 0.0 && size < 1e-3 => (1e6, "u"),
        "m" | "s" | "m/s" if size > 0.0 && size < 0.5 => (1e3, "m"),
        "N/m" if size > 1e6 => (1e-6, "M"),
        _ => (1.0, ""),
    };
    let x = value * factor;
    let text = if x.abs() >= 1e5 || (x != 0.0 && x.abs() < 1e-3) {
        format!("{x:.3e}")
    } else if x.abs() >= 100.0 {
        format!("{x:.0}")
    } else {
        format!("{x:.3}")
    };
    if unit == "1" { text } else { format!("{text} {prefix}{unit}") }
}

#[cfg(test)]
mod tests {
    use super::peak_of_cut;

    /// Two sets of two harmonics: 0.5 + sin and 1 - 2 cos 2; the deviation there is that of mean and wave.
    #[test]
    fn the_peak_of_a_cut_is_that_of_the_stronger_set() {
        let amplitudes = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -2.0, 0.5, 1.0];
        let mut deviations = [0.0; 10];
        (deviations[7], deviations[9]) = (0.3, 0.4);
        let (peak, deviation) = peak_of_cut(2, &amplitudes, &deviations);
        assert!((peak - 3.0).abs() < 1e-12 && (deviation - 0.5).abs() < 1e-12, "{peak} {deviation}");
        assert_eq!(peak_of_cut(2, &[], &[]), (0.0, 0.0));
    }
}
