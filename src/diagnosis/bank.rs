//! The bank of hypotheses: the vocabulary on grids of its nonlinear constants, and lines read off the
//! residual.

use super::bench::Bench;
use super::problem::{Problem, Sides};
use super::shape::{Hypothesis, Shape, least_stribeck_m_s};
use crate::plant::effects::{EffectKind as E, Port};
use rustfft::{FftPlanner, num_complex::Complex};

/// Frequencies from which a torsional mode is looked for, Hz; a fit moves on from there.
const TORSIONAL_HZ: [f64; 15] = [
    110.0, 135.0, 165.0, 200.0, 245.0, 295.0, 350.0, 500.0, 650.0, 780.0, 900.0, 1050.0, 1250.0, 1500.0,
    2000.0,
];

/// Everything that is tried on a bench.
pub(crate) fn of(bench: &Bench<'_>) -> Vec<Hypothesis> {
    let mut list = fixed(bench.problem);
    list.extend(adaptive(bench));
    list
}

/// Hypotheses whose constants stand on a fixed grid.
fn fixed(p: &Problem) -> Vec<Hypothesis> {
    let h = Hypothesis::new;
    let mut list = Vec::new();
    for port in [Port::Stage, Port::Motor] {
        let speeds = [5e-4, 1e-3, 2e-3, 3.5e-3, 6e-3, 1e-2, 1.6e-2, 2.5e-2];
        for velocity_m_s in speeds.into_iter().filter(|v| *v >= least_stribeck_m_s(p)) {
            list.push(h(E::StribeckFriction, port, Shape::Stribeck { velocity_m_s }));
        }
        for stiffness_n_m in [1e5, 3e5, 1e6, 2e6, 4e6, 8e6, 1.6e7, 3.2e7, 1e8] {
            list.push(h(E::PreslidingFriction, port, Shape::Presliding { stiffness_n_m }));
        }
        list.push(h(E::AsymmetricFriction, port, Shape::Asymmetric));
        list.push(h(E::NonlinearViscosity, port, Shape::NonlinearViscosity));
        let coulomb =
            if port == Port::Motor { p.mechanics.motor_coulomb_n } else { p.mechanics.stage_coulomb_n };
        if coulomb == 0.0 {
            list.push(h(E::CoulombFriction, port, Shape::Coulomb));
        } else {
            for time_constant_s in [0.5, 1.5, 5.0, 15.0, 60.0] {
                let drift = |viscous| h(E::FrictionDrift, port, Shape::Drift { time_constant_s, viscous });
                list.extend([false, true].map(drift));
            }
        }
        let viscous = if port == Port::Motor {
            p.mechanics.motor_damping_n_s_m
        } else {
            p.mechanics.stage_damping_n_s_m
        };
        if viscous == 0.0 {
            list.push(h(E::ViscousFriction, port, Shape::Viscous));
        }
    }
    if p.mechanics.stage_coulomb_n + p.mechanics.motor_coulomb_n > 0.0 {
        let ratios = [0.4, 0.7, 1.5, 2.5];
        list.extend(ratios.map(|ratio| h(E::CoulombFriction, Port::Stage, Shape::Smoothing { ratio })));
    }
    list.push(h(E::GravityLoad, Port::Stage, Shape::Constant));
    list.push(h(E::TorqueConstantSaturation, Port::Current, Shape::Saturation));
    let rate = p.motions.first().map_or(1.0, |m| m.rate_hz);
    for samples in [0.3, 0.6, 1.0, 1.6, 2.5, 4.0, 7.0] {
        let extra_s = samples / rate;
        list.push(h(E::DeadTime, Port::Current, Shape::Delay { extra_s }));
        list.push(h(E::CurrentLoopLag, Port::Current, Shape::Lag { extra_s }));
        list.push(h(E::DeadTime, Port::MotorEncoder, Shape::Delay { extra_s }));
        list.push(h(E::DeadTime, Port::StageEncoder, Shape::Delay { extra_s }));
        // A delay can be stated too long, by no more than what is stated.
        let stated = stated_delays(p).into_iter().filter(|(_, stated_s)| extra_s <= *stated_s);
        list.extend(stated.map(|(port, _)| h(E::DeadTime, port, Shape::Delay { extra_s: -extra_s })));
    }
    let (low, high) = p
        .motions
        .iter()
        .flat_map(|m| m.stage.position_m.iter())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(*x), h.max(*x)));
    if high - low > 1e-3 {
        let knots = 24;
        let spacing_m = (high - low) / (knots - 1) as f64;
        list.push(h(
            E::PositionDependentForce,
            Port::Stage,
            Shape::Map { first_m: low, spacing_m, knots, flips: false },
        ));
    }
    couplings(&mut list);
    encoder_periods(p, &mut list);
    list
}

/// Delays that the model states, s.
fn stated_delays(p: &Problem) -> [(Port, f64); 3] {
    [
        (Port::Current, p.drive.amplifier_dead_time_s()),
        (Port::MotorEncoder, p.drive.motor_encoder_delay_s()),
        (Port::StageEncoder, p.drive.stage_encoder_delay_s()),
    ]
}

fn couplings(list: &mut Vec<Hypothesis>) {
    let h = Hypothesis::new;
    for gap_m in [3e-8, 1e-7, 2e-7, 3e-7, 5e-7, 7e-7, 1e-6, 1.4e-6, 2e-6, 3e-6, 5e-6, 1e-5, 2e-5] {
        list.push(h(E::Backlash, Port::Coupling, Shape::Backlash { gap_m }));
    }
    list.push(h(E::NonlinearStiffness, Port::Coupling, Shape::Cubic));
    list.push(h(E::PositionDependentStiffness, Port::Coupling, Shape::StiffnessSlope));
    for frequency_hz in TORSIONAL_HZ {
        for screw_share in [0.3, 0.5, 0.7] {
            list.push(h(
                E::TorsionalMode,
                Port::Coupling,
                Shape::Torsion { frequency_hz, screw_share, damping_ratio: 0.02 },
            ));
        }
    }
}

fn encoder_periods(p: &Problem, list: &mut Vec<Hypothesis>) {
    let raw = p.drive.raw();
    let angle = p.drive.motor_encoder_signal_m();
    let periods = [(Port::MotorEncoder, angle), (Port::StageEncoder, raw.stage_encoder_signal_period_m)];
    list.extend(periods.into_iter().filter_map(|(port, period)| {
        let shape = Shape::EncoderError { period_m: period?, harmonics: 1 };
        Some(Hypothesis::new(E::EncoderInterpolationError, port, shape))
    }));
}

/// Hypotheses read off the residual: wavelengths in position, lines in time.
fn adaptive(bench: &Bench<'_>) -> Vec<Hypothesis> {
    let p = bench.problem;
    let q = bench.weights.whitener.adjoint(&bench.whitened_residual(), &bench.weights.layout);
    let residual = bench.residual();
    let mut list = known_wavelengths(p);
    // Weighted by the noise; and all frequencies alike: a loud wave is noise to itself.
    list.extend(wavelengths(p, &q, 5));
    list.extend(wavelengths(p, &residual, 2));
    list.extend(lines(p, &residual));
    list
}

/// Waves that read off best, so many a kind.
pub(super) fn wavelengths(p: &Problem, q: &[Sides], most: usize) -> Vec<Hypothesis> {
    let mut list = Vec::new();
    let lead = p.drive.screw_lead_m();
    for at_motor in [false, true] {
        for flips in [false, true] {
            if at_motor && flips {
                continue;
            }
            let port = if at_motor { Port::Motor } else { Port::Stage };
            let least_m = lead.map_or(1e-4, |l| if at_motor { l / 150.0 } else { l / 40.0 });
            for wavelength_m in spatial_peaks(p, q, &Spatial { at_motor, flips, least_m, most }) {
                let effect = if at_motor { E::TorqueRipple } else { E::PositionPeriodicForce };
                list.push(Hypothesis::new(
                    effect,
                    port,
                    Shape::Periodic { wavelength_m, harmonics: 1, flips },
                ));
            }
        }
    }
    list
}

/// Waves of the screw, the motor's poles and slots.
fn known_wavelengths(p: &Problem) -> Vec<Hypothesis> {
    let mut list = Vec::new();
    if let Some(lead) = p.drive.screw_lead_m() {
        for order in [1.0, 2.0, 3.0] {
            for flips in [false, true] {
                list.push(Hypothesis::new(
                    E::PositionPeriodicForce,
                    Port::Stage,
                    Shape::Periodic { wavelength_m: lead / order, harmonics: 1, flips },
                ));
            }
        }
        let raw = p.drive.raw();
        let mut orders = vec![1.0, 2.0];
        if let Some(poles) = raw.motor_pole_count {
            orders.extend([poles / 2.0, poles, 3.0 * poles]);
            if let Some(slots) = raw.motor_slot_count {
                orders.extend([slots, lcm(poles, slots)]);
            }
        }
        for order in orders {
            list.push(Hypothesis::new(
                E::TorqueRipple,
                Port::Motor,
                Shape::Periodic { wavelength_m: lead / order, harmonics: 1, flips: false },
            ));
        }
    }
    list
}

/// Periods of the cogging torque in a turn: the least common multiple of poles and slots.
pub(super) fn lcm(a: f64, b: f64) -> f64 {
    let (x, y) = (a.round() as u64, b.round() as u64);
    let (mut u, mut v) = (x, y);
    while v != 0 {
        (u, v) = (v, u % v);
    }
    x.checked_div(u).map_or(0.0, |part| (part * y) as f64)
}

/// Nothing in a screw drive repeats more slowly than the screw turns: a longer wave is known to be one, and
/// no map, once it has repeated so often over the travel.
const LEAST_PERIODS: f64 = 4.0;
/// The same of shorter ones, and where the lead is not known.
const LEAST_PERIODS_OF_SCREW: f64 = 1.5;

struct Spatial {
    at_motor: bool,
    flips: bool,
    least_m: f64,
    most: usize,
}

/// Wavelengths at the highest peaks of the least-squares spectrum of `q` over position, m.
fn spatial_peaks(p: &Problem, q: &[Sides], s: &Spatial) -> Vec<f64> {
    let vs = p.mechanics.smoothing_m_s;
    let mut points: Vec<(f64, f64)> = Vec::new();
    for (m, q) in p.motions.iter().zip(q) {
        let side = if s.at_motor { &m.motor } else { &m.stage };
        let series = if s.at_motor { &q.motor } else { &q.stage };
        let Some(series) = series else { continue };
        let x = p.thinning.pick(&side.position_m);
        let v = p.thinning.pick(&side.velocity_m_s);
        for k in 0..series.len() {
            let w = if s.flips { (v[k] / vs).tanh() } else { 1.0 };
            points.push((x[k], w * series[k]));
        }
    }
    let low = points.iter().map(|a| a.0).fold(f64::INFINITY, f64::min);
    let high = points.iter().map(|a| a.0).fold(f64::NEG_INFINITY, f64::max);
    let span = high - low;
    if !span.is_finite() || span < 4.0 * s.least_m {
        return Vec::new();
    }
    let wanted = 4.0 * span / s.least_m * 2.0;
    let n = (wanted.clamp(256.0, 131_072.0) as usize).next_power_of_two();
    let cell = s.least_m / 4.0;
    let length = n as f64 * cell;
    let power = least_squares_spectrum(&points, (low, cell), n);
    let of_lead = |lead: f64| (span / LEAST_PERIODS).max(1.01 * lead);
    let longest_m = p.drive.screw_lead_m().map_or(span, of_lead).min(span / LEAST_PERIODS_OF_SCREW);
    let first = (length / longest_m).ceil() as usize;
    let mut peaks: Vec<(f64, f64)> = (first.max(1)..power.len().saturating_sub(1))
        .filter(|&k| power[k] > power[k - 1] && power[k] >= power[k + 1])
        .map(|k| {
            let (a, b, c) = (power[k - 1].sqrt(), power[k].sqrt(), power[k + 1].sqrt());
            let shift = 0.5 * (a - c) / (a - 2.0 * b + c).min(-1e-300);
            (power[k], length / (k as f64 + shift.clamp(-0.5, 0.5)))
        })
        .collect();
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
    peaks.truncate(s.most);
    peaks.into_iter().map(|a| a.1).collect()
}

/// What a wave and a constant beside it take of the sum of squares of values at positions, at k cycles in n
/// cells, k < n / 4. A sweep dwells at one place: a plain spectrum would show the wave and that place
/// multiplied.
///
/// From the sums over position and the counts at the single and the double frequency (generalised
/// Lomb-Scargle: Zechmeister and Kuerster 2009). Checked by:
/// tests::a_place_where_the_axis_dwells_hides_no_wave.
fn least_squares_spectrum(points: &[(f64, f64)], (low, cell): (f64, f64), n: usize) -> Vec<f64> {
    let mut sums = vec![Complex::new(0.0, 0.0); n];
    let mut counts = sums.clone();
    for (x, w) in points {
        let k = (((x - low) / cell) as usize).min(n - 1);
        sums[k].re += w;
        counts[k].re += 1.0;
    }
    let fft = FftPlanner::new().plan_fft_forward(n);
    fft.process(&mut sums);
    fft.process(&mut counts);
    (0..n / 4).map(|k| taken(&sums, &counts, k)).collect()
}

/// What the wave at bin `k` and a constant take; zero where positions cannot tell the two apart.
fn taken(sums: &[Complex<f64>], counts: &[Complex<f64>], k: usize) -> f64 {
    /// Share of the counts below which a sine is not told from the constant.
    const TOLD: f64 = 1e-3;
    let total = counts[0].re;
    let (single, double) = (counts[k], counts[2 * k]);
    let [c, s] = [single.re, -single.im];
    let cc = 0.5 * (total + double.re) - c * c / total;
    let ss = 0.5 * (total - double.re) - s * s / total;
    let cs = -0.5 * double.im - c * s / total;
    let [yc, ys] = [sums[k].re - sums[0].re * c / total, -sums[k].im - sums[0].re * s / total];
    let determinant = cc * ss - cs * cs;
    if determinant < (TOLD * total).powi(2) {
        return 0.0;
    }
    (yc * yc * ss - 2.0 * yc * ys * cs + ys * ys * cc) / determinant
}

/// A line of one recording.
struct Line {
    recording: usize,
    strength: f64,
    frequency_hz: f64,
    window_s: [f64; 2],
}

/// Lines of constant frequency in the stage residual, with the time in which they stand.
fn lines(p: &Problem, residual: &[Sides]) -> Vec<Hypothesis> {
    let rate = p.rate_hz();
    let mut found: Vec<Line> = Vec::new();
    for (recording, sides) in residual.iter().enumerate() {
        let Some(x) = &sides.stage else {
            continue;
        };
        let m = &p.motions[recording];
        let start = m.time_s(p.thinning.edge());
        for (strength, frequency_hz) in strongest_lines(x, rate) {
            if let Some((from, to)) = when(x, rate, frequency_hz) {
                found.push(Line { recording, strength, frequency_hz, window_s: [start + from, start + to] });
            }
        }
    }
    found.sort_by(|a, b| b.strength.total_cmp(&a.strength));
    let Some(first) = found.first() else { return Vec::new() };
    let mut list = Vec::new();
    for line in found.iter().filter(|l| l.recording == first.recording).take(2) {
        list.extend(cuts(p, line, &found));
    }
    list
}

/// Hypotheses of a cut whose strongest line is this one.
fn cuts(p: &Problem, line: &Line, found: &[Line]) -> Vec<Hypothesis> {
    let span = line.window_s[1] - line.window_s[0];
    let near = |l: &&Line| {
        (l.frequency_hz - line.frequency_hz).abs() < 0.5 / span.min(l.window_s[1] - l.window_s[0]).max(0.1)
    };
    let mut recordings: Vec<usize> = found.iter().filter(near).map(|l| l.recording).collect();
    recordings.sort_unstable();
    recordings.dedup();
    let band = super::motion::band_hz(p.motions.first().map_or(1.0, |m| m.rate_hz));
    let mut list = Vec::new();
    for divisor in [1.0, 2.0, 3.0] {
        let fundamental_hz = line.frequency_hz / divisor;
        if fundamental_hz < 4.0 {
            break;
        }
        let harmonics = ((0.9 * band / fundamental_hz) as usize).clamp(1, 14);
        let overlapping: Vec<usize> =
            (0..p.motions.len()).filter(|&r| overlap_s(&p.motions[r], line.window_s) > 0.3).collect();
        let mut sets = vec![(overlapping.clone(), true)];
        if recordings != overlapping {
            sets.push((recordings.clone(), true));
        }
        if overlapping.len() > 1 {
            sets.push((overlapping, false));
        }
        for (recordings, common) in sets {
            let harmonics = if common { harmonics } else { harmonics.min(4) };
            let shape =
                Shape::Lines { fundamental_hz, harmonics, window_s: line.window_s, recordings, common };
            list.push(Hypothesis::new(E::CuttingForce, Port::Stage, shape));
        }
    }
    list
}

/// Seconds of a recording inside a window.
fn overlap_s(m: &super::motion::Motion, window_s: [f64; 2]) -> f64 {
    m.time_s(m.len()).min(window_s[1]) - m.start_s.max(window_s[0])
}

/// Window in which waves of known amplitudes best explain a residual: the largest sum of 2 r s - s^2.
pub(crate) fn best_window(
    p: &Problem,
    residual: &[Sides],
    (h, amplitudes): (&Hypothesis, &[f64]),
) -> Option<[f64; 2]> {
    let Shape::Lines { fundamental_hz, harmonics, recordings, common, .. } = &h.shape else { return None };
    let everywhere = Shape::Lines {
        fundamental_hz: *fundamental_hz,
        harmonics: *harmonics,
        window_s: [f64::NEG_INFINITY, f64::INFINITY],
        recordings: recordings.clone(),
        common: *common,
    };
    let columns = Hypothesis { shape: everywhere, ..h.clone() }.columns(p);
    let mut starts = Vec::new();
    let mut ends: Vec<f64> = Vec::new();
    for &r in recordings {
        let Some(x) = &residual[r].stage else { continue };
        let mut s = vec![0.0; x.len()];
        for (c, a) in columns.iter().zip(amplitudes) {
            if let Some(w) = &c[r].stage {
                s.iter_mut().zip(w).for_each(|(s, w)| *s += a * w);
            }
        }
        let (mut best, mut sum, mut from) = ((0.0, 0, 0), 0.0f64, 0);
        for k in 0..x.len() {
            if sum <= 0.0 {
                (sum, from) = (0.0, k);
            }
            sum += 2.0 * x[k] * s[k] - s[k] * s[k];
            if sum > best.0 {
                best = (sum, from, k);
            }
        }
        let at = |k: usize| p.motions[r].time_s(p.thinning.edge() + k * p.thinning.step);
        starts.push(at(best.1));
        ends.push(at(best.2));
    }
    starts.sort_by(f64::total_cmp);
    let end = ends.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let start = *starts.get(starts.len().checked_sub(1)? / 2)?;
    (end > start).then_some([start, end])
}

/// The strongest narrow peaks over the neighbourhood's median.
pub(super) fn strongest_lines(x: &[f64], rate: f64) -> Vec<(f64, f64)> {
    let n = x.len().next_power_of_two() * 2;
    let mut bins: Vec<Complex<f64>> =
        (0..n).map(|k| Complex::new(x.get(k).copied().unwrap_or(0.0), 0.0)).collect();
    let len = x.len() as f64;
    for (k, b) in bins.iter_mut().enumerate().take(x.len()) {
        b.re *= (std::f64::consts::PI * k as f64 / len).sin().powi(2);
    }
    FftPlanner::new().plan_fft_forward(n).process(&mut bins);
    let power: Vec<f64> = bins[..n / 2].iter().map(|c| c.norm_sqr()).collect();
    let width = (n / 400).max(8);
    let first = ((8.0 / rate) * n as f64) as usize;
    let last = ((0.3 * rate).min(700.0) / rate * n as f64) as usize;
    let medians: Vec<f64> = power
        .chunks(width)
        .map(|c| {
            let mut c = c.to_vec();
            c.sort_by(f64::total_cmp);
            c[c.len() / 2]
        })
        .collect();
    let mut peaks: Vec<(f64, f64)> = Vec::new();
    for k in first.max(1)..last.min(n / 2 - 1) {
        if power[k] > power[k - 1] && power[k] >= power[k + 1] {
            let ratio = power[k] / medians[(k / width).min(medians.len() - 1)].max(1e-300);
            let (a, b, c) = (power[k - 1].ln(), power[k].ln(), power[k + 1].ln());
            let shift = 0.5 * (a - c) / (a - 2.0 * b + c).min(-1e-12);
            peaks.push((ratio, (k as f64 + shift.clamp(-0.5, 0.5)) * rate / n as f64));
        }
    }
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
    peaks.truncate(2);
    peaks.retain(|a| a.0 > 40.0);
    peaks
}

/// When a line stands: the span in which its demodulated amplitude exceeds half of its largest.
pub(super) fn when(x: &[f64], rate: f64, frequency_hz: f64) -> Option<(f64, f64)> {
    if !frequency_hz.is_finite() || frequency_hz < 1.0 {
        return None;
    }
    let window = ((0.15 * rate).max(4.0 * rate / frequency_hz)) as usize;
    let w = std::f64::consts::TAU * frequency_hz / rate;
    let hop = (window / 4).max(1);
    let mut amplitudes = Vec::new();
    let mut start = 0;
    while start + window <= x.len() {
        let (mut c, mut s) = (0.0, 0.0);
        for k in start..start + window {
            let (sin, cos) = (w * k as f64).sin_cos();
            c += x[k] * cos;
            s += x[k] * sin;
        }
        amplitudes.push(c.hypot(s));
        start += hop;
    }
    let mut sorted = amplitudes.clone();
    sorted.sort_by(f64::total_cmp);
    let most = *sorted.get(sorted.len().checked_sub(1)? * 9 / 10)?;
    let first = amplitudes.iter().position(|a| *a > 0.5 * most)?;
    let last = amplitudes.iter().rposition(|a| *a > 0.5 * most)?;
    let centre = |k: usize| (k * hop) as f64 + 0.5 * window as f64;
    Some((centre(first) / rate, centre(last) / rate))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn a_place_where_the_axis_dwells_hides_no_wave() {
        let wavelength_m = 4.18e-3;
        let wave = |x: f64| (TAU * x / wavelength_m + 0.4).sin();
        let strokes = (0..3000).map(|k| 6.1e-2 * f64::from(k) / 3000.0);
        let dwell = (0..9000).map(|k| 1.3e-2 + 6e-4 * (f64::from(k) * 0.013).sin());
        let points: Vec<(f64, f64)> = strokes.chain(dwell).map(|x| (x, wave(x))).collect();
        let (cell, n) = (6.25e-5, 4096);
        let power = least_squares_spectrum(&points, (0.0, cell), n);
        let total: f64 = points.iter().map(|p| p.1 * p.1).sum();
        let mean = points.iter().map(|p| p.1).sum::<f64>() / points.len() as f64;
        let about_mean = total - mean * mean * points.len() as f64;
        let best = (4..power.len()).max_by(|a, b| power[*a].total_cmp(&power[*b])).expect("a peak");
        let found_m = n as f64 * cell / best as f64;
        assert!((found_m / wavelength_m - 1.0).abs() < 0.01, "{found_m}");
        assert!(power[best] > 0.9 * about_mean && power[best] <= about_mean * (1.0 + 1e-9));
    }
}
