//! Laws of force that one position can carry, as columns of a regression.

use super::signals::Series;
use crate::diagnosis::columns::{difference, waves};
use crate::diagnosis::floor::band_gain;
use crate::diagnosis::terms::peak_of_map;
use crate::plant::effects::periodic::knots_at;
use crate::plant::effects::{EffectKind, ParameterValue, PhysicsTerm, Port};
use std::f64::consts::TAU;

/// Knots of a map, and the travel from which on there is one, m.
const KNOTS: usize = 24;
const LEAST_MAP_M: f64 = 1.0e-3;
/// Distances over which the friction of guides and bearings turns over, m.
const YIELD_M: [f64; 2] = [2.0e-6, 2.0e-4];

/// A law with its inner constants; its amplitudes are what the regression finds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Law {
    /// M a.
    Inertia,
    /// C v.
    Viscous,
    /// F, whatever the motion.
    Constant,
    /// F times a friction state between -1 and 1: a step in velocity, or a slider behind a spring and a gap.
    Friction(Slider),
    /// Dry friction that differs between the directions: |state|.
    DirectionalDry(Slider),
    /// Viscous friction that differs between the directions: |v|.
    DirectionalViscous,
    /// c v |v|.
    Square,
    /// F exp(-(v/v_s)^2) sgn v.
    Stribeck { velocity_m_s: f64 },
    /// Friction that changes with time: state (1 - exp(-t/tau)).
    Drift { time_s: f64, slider: Slider },
    /// A sin + B cos of 2 pi x / lambda.
    Wave { wavelength_m: f64 },
    /// A force for every place: cubic between knots.
    Map { first_m: f64, spacing_m: f64, knots: usize },
    /// Harmonics of a cut and its mean while it lasts, in one recording or in all.
    Cut { fundamental_hz: f64, harmonics: usize, window_s: [f64; 2], recording: Option<usize> },
    /// F(t) - F(t - T): the drive acts later than it is told.
    Late { delay_s: f64 },
    /// F(t) less F behind a current loop that is slower by a time constant.
    Slow { extra_s: f64 },
    /// What an encoder reads too much, A sin + B cos of 2 pi x / period, as the force that its acceleration
    /// asks for.
    Interpolation { period_m: f64 },
    /// F i^2: torque that falls behind a large current.
    Saturation,
    /// K (x - x0), silent inside the gap; only where the output is locked.
    Spring { centre_m: f64, gap_m: f64 },
    /// K3 (x - x0)^3; only where the output is locked.
    Cubic { centre_m: f64 },
}

/// A slider that a spring pulls over a gap: at `yield_m` beyond the gap it slides.
///
/// D <- clamp(D + dx, +-(gap/2 + yield)); state = dz(D, gap/2) / yield. yield = 0: tanh(v / v_s). Gradual
/// (Dahl 1968), without a gap: d state = (sgn dx - state) |dx| / yield.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Slider {
    pub(super) yield_m: f64,
    pub(super) gap_m: f64,
    pub(super) gradual: bool,
}

impl Slider {
    /// Friction that follows the sign of the velocity at once.
    pub(super) const STEP: Slider = Slider { yield_m: 0.0, gap_m: 0.0, gradual: false };

    /// Friction behind a spring, without a gap.
    pub(super) fn soft(yield_m: f64, gradual: bool) -> Self {
        Slider { yield_m, gap_m: 0.0, gradual }
    }

    /// The same behind a gap.
    pub(super) fn behind_gap(yield_m: f64, gap_m: f64) -> Self {
        Slider { yield_m, gap_m, gradual: false }
    }

    fn state(self, s: &Series, smoothing_m_s: f64) -> Vec<f64> {
        if self.yield_m <= 0.0 {
            return s.velocity_m_s.iter().map(|v| (v / smoothing_m_s).tanh()).collect();
        }
        let mut last = s.position_m.first().copied().unwrap_or(0.0);
        if self.gradual {
            let mut state: f64 = 0.0;
            let step = |x: &f64| {
                let (way, dx) = ((x - last).signum(), (x - last).abs());
                state = way + (state - way) * (-dx / self.yield_m).exp();
                last = *x;
                state
            };
            return s.position_m.iter().map(step).collect();
        }
        let (half, reach) = (0.5 * self.gap_m, 0.5 * self.gap_m + self.yield_m);
        let mut d: f64 = 0.0;
        let step = |x: &f64| {
            d = (d + x - last).clamp(-reach, reach);
            last = *x;
            d.signum() * (d.abs() - half).max(0.0) / self.yield_m
        };
        s.position_m.iter().map(step).collect()
    }
}

/// Scales of the motion that a law refers to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scales {
    pub(super) smoothing_m_s: f64,
    pub(super) fastest_m_s: f64,
    pub(super) stroke_m: f64,
    /// Lowest place.
    pub(super) lowest_m: f64,
    pub(super) resolution_m: f64,
    /// All that moves, kg.
    pub(super) mass_kg: f64,
    /// Time constant of the current loop as stated, s.
    pub(super) loop_s: f64,
    /// Period of the motor encoder's signals, as travel.
    pub(super) signal_m: Option<f64>,
    /// Travel per turn of the motor, where there is a screw.
    pub(super) lead_m: Option<f64>,
    /// Time between samples of the recording, s.
    pub(super) period_s: f64,
    /// True where a current is recorded.
    pub(super) current: bool,
}

impl Scales {
    /// Least distance over which friction can be seen to turn, m.
    pub(super) fn least_yield_m(&self) -> f64 {
        YIELD_M[0].max(10.0 * self.resolution_m)
    }
}

impl Law {
    /// Columns of the law over one recording.
    pub(super) fn columns(self, s: &Series, scales: &Scales) -> Vec<Vec<f64>> {
        let v = &s.velocity_m_s;
        let each = |f: &dyn Fn(f64) -> f64| -> Vec<f64> { v.iter().map(|v| f(*v)).collect() };
        let place = |f: &dyn Fn(f64) -> f64| -> Vec<f64> { s.position_m.iter().map(|x| f(*x)).collect() };
        match self {
            Law::Inertia => vec![s.accel_m_s2.clone()],
            Law::Viscous => vec![v.clone()],
            Law::Constant => vec![vec![1.0; v.len()]],
            Law::Friction(slider) => vec![slider.state(s, scales.smoothing_m_s)],
            Law::DirectionalDry(slider) => {
                vec![slider.state(s, scales.smoothing_m_s).iter().map(|z| z.abs()).collect()]
            }
            Law::DirectionalViscous => vec![each(&f64::abs)],
            Law::Square => vec![each(&|v| v * v.abs())],
            Law::Stribeck { velocity_m_s } => {
                vec![each(&|v| (-(v / velocity_m_s).powi(2)).exp() * (v / scales.smoothing_m_s).tanh())]
            }
            Law::Drift { time_s, slider } => {
                let state = slider.state(s, scales.smoothing_m_s);
                vec![
                    state
                        .iter()
                        .zip(&s.t_s)
                        .map(|(z, t)| z * (1.0 - (-(t - s.start_s) / time_s).exp()))
                        .collect(),
                ]
            }
            Law::Wave { wavelength_m } => {
                vec![place(&|x| (TAU * x / wavelength_m).sin()), place(&|x| (TAU * x / wavelength_m).cos())]
            }
            Law::Map { first_m, spacing_m, knots } => parts(&s.position_m, (first_m, spacing_m), knots),
            Law::Cut { fundamental_hz, harmonics, window_s, recording } => {
                let mut columns = waves(&s.t_s, 1.0 / fundamental_hz, harmonics);
                columns.push(vec![1.0; s.t_s.len()]);
                let here = recording.is_none_or(|only| only == s.recording);
                for column in &mut columns {
                    let cut = |t: f64| here && (window_s[0]..window_s[1]).contains(&t);
                    column.iter_mut().zip(&s.t_s).filter(|(_, t)| !cut(**t)).for_each(|(x, _)| *x = 0.0);
                }
                columns
            }
            Law::Late { delay_s } => vec![difference(&s.thrust_n, -delay_s * s.rate_hz)],
            Law::Slow { extra_s } => {
                let slower_s = scales.loop_s + extra_s;
                let mut left = vec![0.0; s.thrust_n.len()];
                for (node, weight) in LAGUERRE {
                    let late = difference(&s.thrust_n, -node * slower_s * s.rate_hz);
                    left.iter_mut().zip(late).for_each(|(l, x)| *l += weight * extra_s / slower_s * x);
                }
                vec![left]
            }
            Law::Interpolation { period_m } => interpolation(s, scales.mass_kg, TAU / period_m),
            Law::Saturation => {
                let per_ampere = s.thrust_n_a.unwrap_or(f64::INFINITY);
                vec![s.thrust_n.iter().map(|f| f * (f / per_ampere).powi(2)).collect()]
            }
            Law::Spring { centre_m, gap_m } => {
                vec![place(&|x| (x - centre_m).signum() * ((x - centre_m).abs() - 0.5 * gap_m).max(0.0))]
            }
            Law::Cubic { centre_m } => vec![place(&|x| (x - centre_m).powi(3))],
        }
    }

    /// Columns that the law has.
    pub(super) fn width(self) -> usize {
        match self {
            Law::Wave { .. } | Law::Interpolation { .. } => 2,
            Law::Map { knots, .. } => knots,
            Law::Cut { harmonics, .. } => 2 * harmonics + 1,
            _ => 1,
        }
    }

    /// Factors of the columns as a model states them; nothing where it does not. `friction_n`: level that a
    /// relative change refers to. Inverse of what the answer writes.
    pub(super) fn stated_amplitudes(self, term: &PhysicsTerm, friction_n: f64) -> Option<Vec<f64>> {
        match self {
            Law::Late { .. } | Law::Slow { .. } => Some(vec![1.0]),
            Law::Map { .. } => term.list("force_n").map(<[f64]>::to_vec),
            law => {
                let (key, unit) = law.amplitude_key(friction_n)?;
                let size = term.number(key)? / unit;
                let (sin, cos) = term.number("phase_rad").unwrap_or(0.0).sin_cos();
                Some(if law.width() == 2 { vec![size * cos, size * sin] } else { vec![size] })
            }
        }
    }

    /// Key under which a model states the size of the law, and its value for a size of 1.
    pub(super) fn amplitude_key(self, friction_n: f64) -> Option<(&'static str, f64)> {
        Some(match self {
            Law::Viscous | Law::Inertia => ("n_s_m", 1.0),
            Law::Constant | Law::Friction(_) => ("force_n", 1.0),
            Law::DirectionalDry(_) => ("force_difference_n", 2.0),
            Law::DirectionalViscous => ("viscous_difference_n_s_m", 2.0),
            Law::Square => ("n_s2_m2", 1.0),
            Law::Stribeck { .. } => ("stribeck_force_n", 1.0),
            Law::Drift { .. } => ("relative_change", 1.0 / friction_n.max(f64::MIN_POSITIVE)),
            Law::Interpolation { .. } => ("amplitude_m", 1.0),
            Law::Saturation => ("per_a2", 1.0),
            Law::Wave { .. } | Law::Map { .. } => ("amplitude_n", 1.0),
            Law::Late { .. }
            | Law::Slow { .. }
            | Law::Spring { .. }
            | Law::Cubic { .. }
            | Law::Cut { .. } => {
                return None;
            }
        })
    }

    /// How large the law is with these factors.
    pub(super) fn size(self, amplitudes: &[f64]) -> f64 {
        match (self, amplitudes) {
            (Law::Map { .. }, _) => peak_of_map(amplitudes),
            (_, [one]) => *one,
            _ => amplitudes.iter().map(|a| a * a).sum::<f64>().sqrt(),
        }
    }

    /// The term with these factors, its other numbers as they are. Inverse of [`Law::stated_amplitudes`].
    pub(super) fn with_amplitudes(
        self,
        term: PhysicsTerm,
        amplitudes: &[f64],
        friction_n: f64,
    ) -> PhysicsTerm {
        let Some((key, unit)) = self.amplitude_key(friction_n) else { return term };
        let size = self.size(amplitudes) * unit;
        // A slider yields after the same way as before.
        let stiffness = term.number("presliding_stiffness_n_m").zip(term.number(key));
        let mut term = term.with_number(key, size);
        if let Some((stiffness, force)) = stiffness.filter(|(_, force)| *force != 0.0) {
            term = term.with_number("presliding_stiffness_n_m", stiffness * size / force);
        }
        if let (2, [sin, cos]) = (self.width(), amplitudes) {
            term = term.with_number("phase_rad", cos.atan2(*sin));
        }
        let list = term.parameters.iter_mut().find(|(name, _)| name == "force_n");
        if let (Law::Map { .. }, Some((_, ParameterValue::List(list)))) = (self, list) {
            list.copy_from_slice(amplitudes);
        }
        term
    }

    /// Name in the vocabulary, and where it enters.
    pub(super) fn effect(self) -> (EffectKind, Port) {
        use EffectKind as E;
        match self {
            Law::Inertia | Law::Viscous => (E::ViscousFriction, Port::Stage),
            Law::Constant => (E::GravityLoad, Port::Stage),
            Law::Friction(s) if s.gap_m > 0.0 => (E::Backlash, Port::Coupling),
            Law::Friction(s) if s.yield_m > 0.0 => (E::PreslidingFriction, Port::Stage),
            Law::Friction(_) => (E::CoulombFriction, Port::Stage),
            Law::DirectionalDry(_) | Law::DirectionalViscous => (E::AsymmetricFriction, Port::Stage),
            Law::Square => (E::NonlinearViscosity, Port::Stage),
            Law::Stribeck { .. } => (E::StribeckFriction, Port::Stage),
            Law::Drift { .. } => (E::FrictionDrift, Port::Stage),
            Law::Wave { .. } => (E::PositionPeriodicForce, Port::Stage),
            Law::Map { .. } => (E::PositionDependentForce, Port::Stage),
            Law::Cut { .. } => (E::CuttingForce, Port::Stage),
            Law::Late { .. } => (E::DeadTime, Port::Current),
            Law::Slow { .. } => (E::CurrentLoopLag, Port::Current),
            Law::Interpolation { .. } => (E::EncoderInterpolationError, Port::MotorEncoder),
            Law::Saturation => (E::TorqueConstantSaturation, Port::Current),
            Law::Spring { .. } => (E::Backlash, Port::Coupling),
            Law::Cubic { .. } => (E::NonlinearStiffness, Port::Coupling),
        }
    }

    /// Amplitudes that a law of this kind cannot have: friction that pushes, a bump that is a hole.
    pub(super) fn plausible(self, amplitudes: &[f64]) -> bool {
        match self {
            Law::Viscous | Law::Square | Law::Friction(_) | Law::Stribeck { .. } | Law::Spring { .. } => {
                amplitudes.iter().all(|a| *a > 0.0)
            }
            Law::Saturation => amplitudes[0] > 0.0,
            // The delay is in the law; its amplitude only says how well the law holds.
            Law::Late { .. } | Law::Slow { .. } => (0.7..1.4).contains(&amplitudes[0]),
            _ => true,
        }
    }

    /// True where `self` is the richer form of `other` and takes its place.
    pub(super) fn replaces(self, other: Law) -> bool {
        match (self, other) {
            (Law::Friction(a), Law::Friction(b)) => a.yield_m > 0.0 && (b.yield_m <= 0.0 || a.gap_m > 0.0),
            (Law::Spring { gap_m, .. }, Law::Spring { gap_m: before, .. }) => gap_m > 0.0 && before <= 0.0,
            _ => false,
        }
    }
}

impl Law {
    /// The law with its inner constants moved by factors near one, for refining and for profiles.
    pub(super) fn neighbours(self, by: f64) -> Vec<Law> {
        let both = |value: f64| [value * (1.0 + by), value / (1.0 + by)];
        match self {
            Law::Friction(s) if s.gradual => {
                both(s.yield_m).map(|yield_m| Law::Friction(Slider { yield_m, ..s })).to_vec()
            }
            Law::Friction(s) if s.yield_m > 0.0 => {
                let y = both(s.yield_m).map(|yield_m| Law::Friction(Slider { yield_m, ..s }));
                let g = both(s.gap_m).map(|gap_m| Law::Friction(Slider { gap_m, ..s }));
                y.into_iter().chain(g).collect()
            }
            Law::Stribeck { velocity_m_s } => {
                both(velocity_m_s).map(|velocity_m_s| Law::Stribeck { velocity_m_s }).to_vec()
            }
            Law::Drift { time_s, slider } => {
                both(time_s).map(|time_s| Law::Drift { time_s, slider }).to_vec()
            }
            Law::Wave { wavelength_m } => {
                // A wave is sharp in its length: a hundredth of the other steps.
                let fine = 1.0 + 0.05 * by;
                [wavelength_m * fine, wavelength_m / fine]
                    .map(|wavelength_m| Law::Wave { wavelength_m })
                    .to_vec()
            }
            Law::Cut { fundamental_hz, harmonics, window_s: [from, to], recording } => {
                // A line is sharp in its frequency: a fraction of a turn over the cut.
                let (apart_hz, apart_s) = (by / (to - from), 0.1 * by * (to - from));
                let moved = |hz: f64, ends: [f64; 2]| {
                    let window_s = [from + ends[0] * apart_s, to + ends[1] * apart_s];
                    Law::Cut {
                        fundamental_hz: fundamental_hz + hz * apart_hz,
                        harmonics,
                        window_s,
                        recording,
                    }
                };
                [1.0, -1.0]
                    .into_iter()
                    .flat_map(|x| [moved(x, [0.0; 2]), moved(0.0, [x, 0.0]), moved(0.0, [0.0, x])])
                    .collect()
            }
            Law::Slow { extra_s } => both(extra_s).map(|extra_s| Law::Slow { extra_s }).to_vec(),
            Law::Late { delay_s } => both(delay_s).map(|delay_s| Law::Late { delay_s }).to_vec(),
            Law::Spring { centre_m, gap_m } if gap_m > 0.0 => {
                let g = both(gap_m).map(|gap_m| Law::Spring { centre_m, gap_m });
                let shift = 0.2 * by * gap_m;
                let c = [centre_m + shift, centre_m - shift].map(|centre_m| Law::Spring { centre_m, gap_m });
                g.into_iter().chain(c).collect()
            }
            _ => Vec::new(),
        }
    }
}

/// Nodes and weights of Gauss and Laguerre: the integral of exp(-u) f(u) from zero on.
const LAGUERRE: [(f64, f64); 5] = [
    (0.263_560_319_718, 0.521_755_610_583),
    (1.413_403_059_107, 0.398_666_811_083),
    (3.596_425_771_041, 0.075_942_449_681_7),
    (7.085_810_005_859, 0.003_611_758_679_92),
    (12.640_800_844_276, 0.000_023_369_972_385_8),
];

/// Sine and cosine of `per_m` x as readings that are too large: what they add to M a and is not there, in the
/// band in which a is known.
fn interpolation(s: &Series, mass_kg: f64, per_m: f64) -> Vec<Vec<f64>> {
    let mut columns = vec![Vec::new(); 2];
    for ((x, v), a) in s.position_m.iter().zip(&s.velocity_m_s).zip(&s.accel_m_s2) {
        let (sin, cos) = (per_m * x).sin_cos();
        let (slope, curve) = (per_m * a, (per_m * v).powi(2));
        let seen = -mass_kg * band_gain((per_m * v).abs() / TAU, s.band_hz);
        columns[0].push(seen * (slope * cos - curve * sin));
        columns[1].push(seen * (-slope * sin - curve * cos));
    }
    columns
}

/// `count` values from `low` to `high`, evenly in their logarithm.
pub(super) fn geometric(low: f64, high: f64, count: usize) -> Vec<f64> {
    let (low, high) = (low.max(1.0e-12), high.max(1.0e-12));
    let ratio = (high / low).ln() / count.saturating_sub(1).max(1) as f64;
    (0..count).map(|k| low * (ratio * k as f64).exp()).collect()
}

/// Of each knot of a table how much a place has of it.
fn parts(position_m: &[f64], (first_m, spacing_m): (f64, f64), knots: usize) -> Vec<Vec<f64>> {
    let mut columns = vec![vec![0.0; position_m.len()]; knots];
    for (k, x) in position_m.iter().enumerate() {
        let (first, parts) = knots_at(*x, first_m, spacing_m, knots);
        for (column, part) in columns[first..].iter_mut().zip(parts) {
            column[k] = part;
        }
    }
    columns
}

/// Every law that is tried, with its inner constants on a grid. `slider`: the friction state accepted so far.
pub(super) fn candidates(scales: &Scales, slider: Slider, locked: bool, centre_m: f64) -> Vec<Law> {
    let smallest = (3.0 * scales.resolution_m).max(1.0e-3 * scales.stroke_m);
    let yields = geometric(smallest, 0.15 * scales.stroke_m, 12);
    // A bearing's friction turns over within micrometres, however long the stroke is.
    let soonest = smallest.min(scales.least_yield_m());
    let short = geometric(soonest, YIELD_M[1].min(smallest), 8);
    let mut list = vec![Law::Constant, Law::Friction(Slider::STEP)];
    let soft = yields.iter().chain(&short);
    list.extend(soft.flat_map(|&y| [false, true].map(|gradual| Law::Friction(Slider::soft(y, gradual)))));
    if locked {
        let stroke = scales.stroke_m;
        list.extend(gaps(stroke, centre_m));
        list.push(Law::Cubic { centre_m });
        return list;
    }
    // Velocity laws need more than one speed; where there is one, they are each other's twins and the order
    // decides.
    list.extend([Law::Viscous, Law::DirectionalDry(slider), Law::DirectionalViscous, Law::Square]);
    list.extend(
        geometric(scales.period_s, 40.0 * scales.period_s, 14).into_iter().map(|t| Law::Late { delay_s: t }),
    );
    list.extend(scales.signal_m.map(|period_m| Law::Interpolation { period_m }));
    if scales.current {
        list.push(Law::Saturation);
        let extra = geometric(scales.period_s, 40.0 * scales.period_s, 14);
        list.extend(extra.into_iter().map(|extra_s| Law::Slow { extra_s }));
    }
    list.extend(
        geometric(5.0 * scales.smoothing_m_s, 0.5 * scales.fastest_m_s, 12)
            .into_iter()
            .map(|v| Law::Stribeck { velocity_m_s: v }),
    );
    for gap in geometric(smallest, 0.5 * scales.stroke_m, 12) {
        list.extend(yields.iter().map(|&y| Law::Friction(Slider::behind_gap(y, gap))));
    }
    let finest = (scales.stroke_m / 300.0).max(20.0 * scales.resolution_m);
    let waves = (2.0 * scales.stroke_m / finest).clamp(8.0, 600.0) as usize;
    list.extend((3..waves).map(|k| Law::Wave { wavelength_m: 2.0 * scales.stroke_m / k as f64 }));
    // Turns of the motor and its first harmonics, however long the stroke is.
    let turns = scales.lead_m.into_iter().flat_map(|lead| (1..=12).map(move |k| lead / f64::from(k)));
    if scales.stroke_m > LEAST_MAP_M {
        let spacing_m = scales.stroke_m / (KNOTS - 1) as f64;
        list.push(Law::Map { first_m: scales.lowest_m, spacing_m, knots: KNOTS });
    }
    list.extend(turns.filter(|w| *w < scales.stroke_m).map(|wavelength_m| Law::Wave { wavelength_m }));
    list
}

/// Springs with a gap, evenly over the travel: behind a stiff spring a gap must be met to a few hundredths of
/// it.
pub(super) fn gaps(stroke_m: f64, centre_m: f64) -> impl Iterator<Item = Law> {
    (1..50).flat_map(move |k| {
        let gap_m = 0.02 * f64::from(k) * stroke_m;
        let slack = 0.5 * (stroke_m - gap_m);
        (-4..=4).map(move |j| Law::Spring { centre_m: centre_m + 0.2 * f64::from(j) * slack, gap_m })
    })
}

/// Drifts of a friction that is in the model.
pub(super) fn drifts(slider: Slider) -> impl Iterator<Item = Law> {
    geometric(1.0, 100.0, 8).into_iter().map(move |time_s| Law::Drift { time_s, slider })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle() -> Series {
        let position_m: Vec<f64> = (0..400)
            .map(|k| {
                if k < 100 {
                    f64::from(k)
                } else if k < 300 {
                    200.0 - f64::from(k)
                } else {
                    f64::from(k) - 400.0
                }
            })
            .map(|x| x * 1.0e-4)
            .collect();
        Series {
            experiment: "t".into(),
            recording: 0,
            rate_hz: 100.0,
            band_hz: 30.0,
            start_s: 0.0,
            t_s: (0..400).map(|k| f64::from(k) * 0.01).collect(),
            velocity_m_s: vec![0.0; 400],
            accel_m_s2: vec![0.0; 400],
            thrust_n: vec![0.0; 400],
            position_m,
            thrust_n_a: None,
        }
    }

    #[test]
    fn a_slider_is_silent_in_its_gap_and_slides_beyond_its_yield() {
        // From +1 after a reversal: yields over 1 mm to zero, silent over the gap of 2 mm, then rises over 1
        // mm to -1.
        let state = Slider::behind_gap(1.0e-3, 2.0e-3).state(&triangle(), 1.0e-4);
        assert!((state[99] - 1.0).abs() < 1.0e-9);
        assert!((state[100 + 5] - 0.5).abs() < 0.02, "half unloaded after 0.5 mm: {}", state[105]);
        assert!(state[120].abs() < 1.0e-9, "inside the gap");
        assert!((state[100 + 44] + 1.0).abs() < 1.0e-9, "slides the other way after 4 mm");
    }

    #[test]
    fn without_gap_and_yield_friction_is_the_sign_of_the_velocity() {
        let mut s = triangle();
        s.velocity_m_s = vec![-1.0; 400];
        assert!(Slider::STEP.state(&s, 1.0e-3).iter().all(|z| (z + 1.0).abs() < 1.0e-12));
    }

    /// Closed form: from rest over d to 1 - exp(-d/y); after a reversal at s, -1 + (1 + s) exp(-d/y).
    #[test]
    fn a_gradual_slider_forgets_with_the_distance() {
        let state = Slider::soft(1.0e-3, true).state(&triangle(), 1.0e-4);
        let top = 1.0 - (-9.9_f64).exp();
        assert!((state[99] - top).abs() < 1.0e-9);
        for k in [101, 105, 130] {
            let d = f64::from(k as u8 - 100) * 0.1;
            let expected = -1.0 + (1.0 + state[100]) * (-d).exp();
            assert!((state[k] - expected).abs() < 1.0e-9, "{k}: {} for {expected}", state[k]);
        }
    }

    fn scales(loop_s: f64) -> Scales {
        Scales {
            smoothing_m_s: 1.0e-4,
            fastest_m_s: 1.0,
            stroke_m: 1.0,
            lowest_m: 0.0,
            resolution_m: 1.0e-9,
            mass_kg: 60.0,
            loop_s,
            signal_m: None,
            lead_m: None,
            period_s: 1.0e-3,
            current: true,
        }
    }

    /// Closed form: a loop of t0 that is slower by T takes 1 - (1 + jw t0) / (1 + jw (t0 + T)) of a wave.
    #[test]
    fn a_slower_loop_takes_what_its_response_says() {
        let (w, loop_s, extra_s) = (TAU * 8.0, 4.0e-3, 6.0e-3);
        let mut s = triangle();
        s.thrust_n = s.t_s.iter().map(|t| (w * t).cos()).collect();
        let column = &Law::Slow { extra_s }.columns(&s, &scales(loop_s))[0];
        let (a, b) = (w * loop_s, w * (loop_s + extra_s));
        // 1 - (1 + ja)/(1 + jb) = (b^2 - ab + j (b - a)) / (1 + b^2)
        let [re, im] = [b * b - a * b, b - a].map(|x| x / (1.0 + b * b));
        for k in 60..340 {
            let (sin, cos) = (w * s.t_s[k]).sin_cos();
            let expected = re * cos - im * sin;
            assert!((column[k] - expected).abs() < 2.0e-3, "{k}: {} for {expected}", column[k]);
        }
    }

    /// The force that an error of a reading asks for, against second differences of the reading.
    #[test]
    fn an_error_of_an_encoder_is_its_acceleration_times_the_mass() {
        let (period_m, step_s) = (2.0e-3, 1.0e-2);
        let x = |t: f64| 5.0e-3 * (0.9 * t).sin();
        let mut s = triangle();
        s.position_m = s.t_s.iter().map(|t| x(*t)).collect();
        s.velocity_m_s = s.t_s.iter().map(|t| 4.5e-3 * (0.9 * t).cos()).collect();
        s.accel_m_s2 = s.t_s.iter().map(|t| -4.05e-3 * (0.9 * t).sin()).collect();
        let columns = Law::Interpolation { period_m }.columns(&s, &scales(0.0));
        let read = |t: f64| [(TAU * x(t) / period_m).sin(), (TAU * x(t) / period_m).cos()];
        for (k, t) in s.t_s.iter().enumerate() {
            let [before, now, after] = [t - step_s / 10.0, *t, t + step_s / 10.0].map(read);
            for wave in 0..2 {
                let accel = (before[wave] - 2.0 * now[wave] + after[wave]) / (step_s / 10.0).powi(2);
                let largest_n = 60.0 * (TAU * 4.5e-3 / period_m).powi(2);
                assert!((columns[wave][k] + 60.0 * accel).abs() < 1.0e-3 * largest_n, "{k}, {wave}");
            }
        }
    }

    #[test]
    fn the_richer_slider_takes_the_place_of_the_poorer() {
        let (step, soft, play) = (Slider::STEP, Slider::soft(1.0, false), Slider::behind_gap(1.0, 1.0));
        assert!(Law::Friction(soft).replaces(Law::Friction(step)));
        assert!(Law::Friction(play).replaces(Law::Friction(soft)));
        assert!(!Law::Friction(step).replaces(Law::Friction(soft)));
    }
}
