//! From fitted laws to named parameters, terms of a model and sentences.

use super::columns::spline;
use super::criteria::{Criteria, Z95};
use super::shape::{CUT_HARMONICS, Shape};
use super::state::{Accepted, Balance, State};
use crate::diagnosis::result::Estimate;
use crate::plant::effects::periodic::amplitude_phase;
use crate::plant::effects::{EffectKind as E, ParameterValue, PhysicsTerm, Port};
use std::f64::consts::TAU;

/// Deviations of a law's amplitudes and of the logarithms of its constants.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Deviations {
    pub(super) amplitudes: Vec<f64>,
    pub(super) constants: Vec<f64>,
}

/// Logarithms of intervals end here: the data say nothing.
const MOST_DOUBT: f64 = 6.9;

/// Collects estimates with their intervals.
struct Sheet {
    list: Vec<Estimate>,
    scale: f64,
}

impl Sheet {
    fn add(&mut self, name: &str, unit: &'static str, value: f64, deviation: f64) {
        let half = (Z95 * deviation).min(1e3 * value.abs()).max(1e-12 * value.abs());
        self.list.push(Estimate { name: name.to_owned(), value, unit, ci95: [value - half, value + half] });
    }

    /// A number measured in newtons: the torque constant's own error adds.
    fn force(&mut self, name: &str, unit: &'static str, value: f64, deviation: f64) {
        self.add(name, unit, value, deviation.hypot(self.scale * value));
    }

    /// Amplitude, of that name, unit and relative deviation of its scale, and phase of a wave.
    fn wave(&mut self, (name, unit, scale): (&str, &'static str, f64), law: &Accepted, sd: &Deviations) {
        let of = |list: &[f64], k: usize| list.get(k).copied().unwrap_or(0.0);
        let (amplitude, phase) = amplitude_phase(of(&law.amplitudes, 0), of(&law.amplitudes, 1));
        let deviation = of(&sd.amplitudes, 0).max(of(&sd.amplitudes, 1));
        self.add(name, unit, amplitude, deviation.hypot(scale * amplitude));
        self.add("phase_rad", "rad", phase, deviation / amplitude.max(1e-300));
    }

    /// Largest force of a map: the form is kept, its size is what the last fit tells.
    fn map(&mut self, table: &TableOf, law: &Accepted, sd: &Deviations) {
        let relative = |(d, a): (&f64, &f64)| d / a.abs().max(1e-300);
        let most = sd.amplitudes.iter().zip(&law.amplitudes).map(relative).fold(0.0, f64::max);
        let peak_n = peak(&table.force_n);
        self.force("amplitude_n", "N", peak_n, most * peak_n);
    }

    /// A cut: its frequency with the relative deviation, its force with the deviation, and from when to when
    /// with the deviation of both.
    fn cut(
        &mut self,
        [hz, relative]: [f64; 2],
        (force_n, deviation_n): (f64, f64),
        [from_s, to_s, sd_s]: [f64; 3],
    ) {
        self.constant("fundamental_hz", "Hz", hz, relative);
        self.force("amplitude_n", "N", force_n, deviation_n);
        self.add("start_s", "s", from_s, sd_s);
        self.add("end_s", "s", to_s, sd_s);
    }

    /// A constant of a law that is evaluated between samples, by its logarithm.
    fn constant(&mut self, name: &str, unit: &'static str, value: f64, relative: f64) {
        let half = (Z95 * relative.hypot(Criteria::STANDARD.exactness)).min(MOST_DOUBT);
        let ci95 = [value * (-half).exp(), value * half.exp()];
        self.list.push(Estimate { name: name.to_owned(), value, unit, ci95 });
    }
}

/// Relative deviation of every force by the torque constant; none where a force is recorded.
pub(super) fn scale_deviation(balance: &Balance) -> f64 {
    let current = balance.signals.tracks.iter().any(|t| t.reference.is_current);
    if current { Criteria::STANDARD.torque_constant_tolerance } else { 0.0 }
}

/// Numbers of a law.
pub(super) fn estimates(balance: &Balance, state: &State, law: &Accepted, sd: &Deviations) -> Vec<Estimate> {
    let mut s = Sheet { list: Vec::new(), scale: scale_deviation(balance) };
    let a = |k: usize| law.amplitudes.get(k).copied().unwrap_or(0.0);
    let d = |k: usize| sd.amplitudes.get(k).copied().unwrap_or(0.0);
    let r = |k: usize| sd.constants.get(k).copied().unwrap_or(0.0);
    let of_coulomb = |x: f64| x / state.coulomb_n().max(1e-300);
    match law.hypothesis.shape {
        Shape::Stribeck { speed_m_s } => {
            s.force("stribeck_force_n", "N", a(0), d(0));
            s.constant("stribeck_velocity_m_s", "m/s", speed_m_s, r(0));
        }
        Shape::Presliding { yield_m } => {
            s.constant("presliding_stiffness_n_m", "N/m", state.coulomb_n() / yield_m, r(0).hypot(s.scale));
            s.add("share", "1", of_coulomb(a(0)), of_coulomb(d(0)));
        }
        Shape::Asymmetric => s.force("force_difference_n", "N", a(0), d(0)),
        Shape::AsymmetricViscous => {
            s.force("force_difference_n", "N", a(0), d(0));
            s.force("viscous_difference_n_s_m", "N s/m", a(1), d(1));
        }
        Shape::Gravity => s.force("force_n", "N", a(0), d(0)),
        Shape::NonlinearViscosity => s.force("n_s2_m2", "N s2/m2", a(0), d(0)),
        Shape::Drift { tau_s } => {
            s.add("relative_change", "1", of_coulomb(a(0)), of_coulomb(d(0)));
            s.constant("time_constant_s", "s", tau_s, r(0));
        }
        Shape::Wave { wavelength_m } => {
            if law.hypothesis.effect == E::TorqueRipple {
                let lead = balance.drive.screw_lead_m().unwrap_or(TAU);
                s.constant("order_per_rev", "1", lead / wavelength_m, r(0));
            } else {
                s.constant("wavelength_m", "m", wavelength_m, r(0));
            }
            s.wave(("amplitude_n", "N", s.scale), law, sd);
        }
        Shape::Map { .. } => s.map(&table(balance, law), law, sd),
        Shape::Saturation { per_a2, .. } => s.constant("per_a2", "1/A2", per_a2, r(0)),
        Shape::Backlash { gap_m, .. } | Shape::Gap { gap_m, .. } => s.constant("gap_m", "m", gap_m, r(0)),
        Shape::Play { gap_m, yield_m } => {
            s.constant("gap_m", "m", gap_m, r(0));
            s.constant("stiffness_n_m", "N/m", a(0) / yield_m, r(1).hypot(d(0) / a(0).max(1e-300)));
            s.force("force_n", "N", a(0), d(0));
        }
        Shape::Cubic => s.force("cubic_n_m3", "N/m3", a(0), d(0)),
        Shape::StiffnessSlope => {
            // Over the travel, which is what the recordings saw.
            let [low, high] = balance.signals.travel_m();
            s.add("relative_variation", "1", a(0) * (high - low), d(0) * (high - low));
            s.add("length_m", "m", high - low, 0.0);
        }
        Shape::StiffnessWave { length_m } => {
            s.wave(("relative_variation", "1", 0.0), law, sd);
            s.constant("length_m", "m", length_m, r(0));
        }
        Shape::Torsion { frequency_hz, share, damping } => {
            s.constant("free_free_frequency_hz", "Hz", frequency_hz, r(0));
            s.constant("screw_inertia_share", "1", share, r(1));
            s.constant("damping_ratio", "1", damping, r(2));
        }
        Shape::Delay { extra_s, .. } | Shape::EncoderDelay { extra_s } => {
            let within = Criteria::STANDARD.timing_deviation / balance.signals.rate_hz;
            s.add("extra_delay_s", "s", extra_s, within.hypot(extra_s * r(0)));
        }
        Shape::Loop { rad_s, .. } => s.constant("bandwidth_rad_s", "rad/s", rad_s, r(0)),
        Shape::EncoderError { period_m, .. } => {
            s.add("signal_period_m", "m", period_m, 0.0);
            s.wave(("amplitude_m", "m", 0.0), law, sd);
        }
        Shape::Cut { hz, start_s, end_s } => {
            s.cut([hz, r(0)], peak_of_cut(&law.amplitudes, d(0)), [start_s, end_s, 0.02]);
        }
        Shape::Push { spindle_hz, start_s, end_s, .. } => {
            s.cut([spindle_hz, 0.0], (a(0), d(0)), [start_s, end_s, 1.0 / spindle_hz]);
        }
        Shape::Mains { hz } => s.constant("frequency_hz", "Hz", hz, r(0)),
        Shape::Smoothing { speed_m_s } => s.constant("friction_smoothing_m_s", "m/s", speed_m_s, r(0)),
    }
    s.list
}

/// A map as a table.
pub(super) struct TableOf {
    first_m: f64,
    spacing_m: f64,
    pub(super) force_n: Vec<f64>,
}

/// The table of a map's splines, two places a piece.
pub(super) fn table(balance: &Balance, law: &Accepted) -> TableOf {
    let Shape::Map { pieces, .. } = law.hypothesis.shape else {
        return TableOf { first_m: 0.0, spacing_m: 1.0, force_n: Vec::new() };
    };
    let [low, high] = balance.signals.travel_m();
    let at = |place: f64| -> f64 {
        let of = |(k, a): (usize, &f64)| a * spline(place - k as f64 + 3.0);
        law.amplitudes.iter().enumerate().map(of).sum()
    };
    TableOf {
        first_m: low,
        spacing_m: 0.5 * (high - low) / pieces as f64,
        force_n: (0..=2 * pieces).map(|k| at(0.5 * k as f64 - 1e-9)).collect(),
    }
}

/// Largest force of a map about its mean.
fn peak(knots: &[f64]) -> f64 {
    let mean = knots.iter().sum::<f64>() / knots.len().max(1) as f64;
    knots.iter().map(|f| (f - mean).abs()).fold(0.0, f64::max)
}

/// Sine and cosine of each harmonic, then the mean: how many numbers a recording has.
fn numbers_of_cut(amplitudes: &[f64]) -> usize {
    let sets = (1..=8).filter(|n| amplitudes.len().is_multiple_of(*n));
    let lengths: Vec<usize> = sets.map(|n| amplitudes.len() / n).collect();
    lengths.iter().copied().find(|l| l % 2 == 1 && *l <= 2 * CUT_HARMONICS + 1).unwrap_or(1)
}

/// Largest force of a cut over a period, its mean included, of the recording where it is largest.
///
/// A tool that cuts part of the time pushes in pulses: their height is what the machine feels, not the
/// amplitude of one harmonic.
fn peak_of_cut(amplitudes: &[f64], deviation: f64) -> (f64, f64) {
    /// Places in a period.
    const PLACES: usize = 360;
    let length = numbers_of_cut(amplitudes);
    let mut most = 0.0_f64;
    for set in amplitudes.chunks_exact(length.max(1)) {
        for place in 0..PLACES {
            let turn = TAU * place as f64 / PLACES as f64;
            let waves = set[..length - 1].chunks_exact(2).enumerate();
            let wave: f64 = waves
                .map(|(h, c)| {
                    let (sin, cos) = ((h + 1) as f64 * turn).sin_cos();
                    c[0] * sin + c[1] * cos
                })
                .sum();
            most = most.max((set[length - 1] + wave).abs());
        }
    }
    (most, deviation * (length as f64).sqrt())
}

/// The law as a term of a model.
pub(super) fn term(balance: &Balance, law: &Accepted, estimates: &[Estimate]) -> PhysicsTerm {
    let h = &law.hypothesis;
    let mut parameters: Vec<(String, ParameterValue)> =
        estimates.iter().map(|e| (e.name.clone(), ParameterValue::Number(e.value))).collect();
    let mut list = |name: &str, values| parameters.push((name.to_owned(), ParameterValue::List(values)));
    match h.shape {
        Shape::Wave { .. } => list("harmonics_n", law.amplitudes.clone()),
        Shape::EncoderError { .. } => list("harmonics_m", law.amplitudes.clone()),
        Shape::Map { flips, .. } => {
            let table = table(balance, law);
            list("force_n", table.force_n);
            let mut number = |name: &str, x| parameters.push((name.to_owned(), ParameterValue::Number(x)));
            number("first_m", table.first_m);
            number("spacing_m", table.spacing_m);
            if flips {
                number("with_direction", 1.0);
            }
        }
        Shape::Saturation { parabolic, .. } if parabolic != 0.0 => {
            parameters.push(("parabolic".to_owned(), ParameterValue::Number(parabolic)));
        }
        Shape::Backlash { loose: true, .. } => {
            parameters.push(("loose_damper".to_owned(), ParameterValue::Number(1.0)));
        }
        Shape::Gap { flank_m, .. } => {
            parameters.push(("flank_m".to_owned(), ParameterValue::Number(flank_m)));
        }
        Shape::Presliding { .. } => {
            let rate_n = law.amplitudes.get(1).copied().unwrap_or(0.0);
            parameters.push(("bristle_rate_n".to_owned(), ParameterValue::Number(rate_n)));
        }
        Shape::Cut { .. } => {
            parameters.push(("harmonics".to_owned(), ParameterValue::Number(CUT_HARMONICS as f64)));
        }
        _ => {}
    }
    PhysicsTerm { effect: h.effect, port: h.port, parameters }
}

/// The law in symbols.
pub(in crate::diagnosis) fn equation(effect: E) -> &'static str {
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
        E::TorqueConstantSaturation => "T = K_t i (1 - b i^2 + ...)",
        E::GravityLoad => "F = constant",
        E::Backlash => "S = K (D - clamp(D, -gap/2, gap/2)), at most the friction behind it",
        E::TorsionalMode => "J_s e'' + c e' + (k + K) e = -J_s a_m - K D",
        E::PositionDependentStiffness => "S = K (1 + r x / L) D, or K (1 + r sin(2 pi x / L + phase)) D",
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
pub(in crate::diagnosis) fn domain(effect: E) -> &'static str {
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
pub(in crate::diagnosis) fn statement(effect: E, port: Port, parameters: &[Estimate]) -> String {
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
pub(in crate::diagnosis) fn engineering(value: f64, unit: &str) -> String {
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

/// What to record to tell the strongest alternative apart.
pub(super) fn next_experiment(strongest: E) -> &'static str {
    match strongest {
        E::GravityLoad | E::AsymmetricFriction => {
            "hold the axis at rest for two seconds at several positions: a load stays, friction's \
             asymmetry does not"
        }
        E::StribeckFriction | E::NonlinearViscosity | E::ViscousFriction => {
            "constant speeds from 0.5 to 50 mm/s in both directions"
        }
        E::PreslidingFriction | E::Backlash => "reversals of 1 to 100 um below 1 mm/s",
        E::DeadTime | E::CurrentLoopLag | E::TorsionalMode => {
            "a sweep up to twice the axial resonance at two amplitudes"
        }
        E::TorqueRipple | E::PositionPeriodicForce | E::PositionDependentForce => {
            "the same slow stroke in both directions at two speeds"
        }
        E::EncoderInterpolationError => {
            "a slow stroke at two speeds, with the signal period's line below the axial resonance"
        }
        E::TorqueConstantSaturation | E::NonlinearStiffness => "accelerations at a third and at full current",
        _ => "the same motion twice, without a cut",
    }
}
