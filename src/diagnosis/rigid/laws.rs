//! Laws of force that one position can carry, as columns of a regression.

use super::signals::Series;
use crate::diagnosis::columns::difference;
use crate::plant::effects::{EffectKind, PhysicsTerm, Port};
use std::f64::consts::TAU;

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
    /// F(t) - F(t - T): the drive acts later than it is told.
    Late { delay_s: f64 },
    /// F i^2: torque that falls behind a large current.
    Saturation,
    /// K (x - x0), silent inside the gap; only where the output is locked.
    Spring { centre_m: f64, gap_m: f64 },
    /// K3 (x - x0)^3; only where the output is locked.
    Cubic { centre_m: f64 },
}

/// A slider that a spring pulls over a gap: at `yield_m` beyond the gap it slides.
///
/// D <- clamp(D + dx, +-(gap/2 + yield)); state = dz(D, gap/2) / yield. yield = 0: tanh(v / v_s).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Slider {
    pub(super) yield_m: f64,
    pub(super) gap_m: f64,
}

impl Slider {
    /// Friction that follows the sign of the velocity at once.
    pub(super) const STEP: Slider = Slider { yield_m: 0.0, gap_m: 0.0 };

    fn state(self, s: &Series, smoothing_m_s: f64) -> Vec<f64> {
        if self.yield_m <= 0.0 {
            return s.velocity_m_s.iter().map(|v| (v / smoothing_m_s).tanh()).collect();
        }
        let (half, reach) = (0.5 * self.gap_m, 0.5 * self.gap_m + self.yield_m);
        let mut d: f64 = 0.0;
        let mut last = s.position_m.first().copied().unwrap_or(0.0);
        let step = |x: &f64| {
            d = (d + x - last).clamp(-reach, reach);
            last = *x;
            d.signum() * (d.abs() - half).max(0.0) / self.yield_m
        };
        s.position_m.iter().map(step).collect()
    }
}

/// Shortest distance over which friction is taken to turn over, m: asperities of ground surfaces.
const FINEST_YIELD_M: f64 = 1.0e-6;

/// Scales of the motion that a law refers to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scales {
    pub(super) smoothing_m_s: f64,
    pub(super) fastest_m_s: f64,
    pub(super) stroke_m: f64,
    pub(super) resolution_m: f64,
    /// Travel per turn of the motor, where there is a screw.
    pub(super) lead_m: Option<f64>,
    /// Time between samples of the recording, s.
    pub(super) period_s: f64,
    /// True where a current is recorded.
    pub(super) current: bool,
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
                vec![state.iter().zip(&s.t_s).map(|(z, t)| z * (1.0 - (-t / time_s).exp())).collect()]
            }
            Law::Wave { wavelength_m } => {
                vec![place(&|x| (TAU * x / wavelength_m).sin()), place(&|x| (TAU * x / wavelength_m).cos())]
            }
            Law::Late { delay_s } => vec![difference(&s.thrust_n, -delay_s * s.rate_hz)],
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

    /// Factors of the columns as a model states them; nothing where it does not. `friction_n`: level that a
    /// relative change refers to. Inverse of what the answer writes.
    pub(super) fn stated_amplitudes(self, term: &PhysicsTerm, friction_n: f64) -> Option<Vec<f64>> {
        let get = |name: &str| term.number(name);
        let one = match self {
            Law::Viscous | Law::Inertia => get("n_s_m")?,
            Law::Constant | Law::Friction(_) => get("force_n")?,
            Law::DirectionalDry(_) => 0.5 * get("force_difference_n")?,
            Law::DirectionalViscous => 0.5 * get("viscous_difference_n_s_m")?,
            Law::Square => get("n_s2_m2")?,
            Law::Stribeck { .. } => get("stribeck_force_n")?,
            Law::Drift { .. } => get("relative_change")? * friction_n,
            Law::Late { .. } => 1.0,
            Law::Saturation => get("per_a2")?,
            Law::Wave { .. } => {
                let (sin, cos) = get("phase_rad").unwrap_or(0.0).sin_cos();
                let amplitude = get("amplitude_n")?;
                return Some(vec![amplitude * cos, amplitude * sin]);
            }
            Law::Spring { .. } | Law::Cubic { .. } => return None,
        };
        Some(vec![one])
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
            Law::Late { .. } => (E::DeadTime, Port::Current),
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
            Law::Late { .. } => (0.7..1.4).contains(&amplitudes[0]),
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

/// `count` values from `low` to `high`, evenly in their logarithm.
pub(super) fn geometric(low: f64, high: f64, count: usize) -> Vec<f64> {
    let (low, high) = (low.max(1.0e-12), high.max(1.0e-12));
    let ratio = (high / low).ln() / count.saturating_sub(1).max(1) as f64;
    (0..count).map(|k| low * (ratio * k as f64).exp()).collect()
}

/// Every law that is tried, with its inner constants on a grid. `slider`: the friction state accepted so far.
pub(super) fn candidates(scales: &Scales, slider: Slider, locked: bool, centre_m: f64) -> Vec<Law> {
    let smallest = (3.0 * scales.resolution_m).max(1.0e-3 * scales.stroke_m);
    let yields = geometric(smallest, 0.15 * scales.stroke_m, 12);
    let mut list = vec![Law::Constant, Law::Friction(Slider::STEP)];
    list.extend(yields.iter().map(|&y| Law::Friction(Slider { yield_m: y, gap_m: 0.0 })));
    // Guideways slide after micrometres, however long the stroke is.
    let finest = (3.0 * scales.resolution_m).max(FINEST_YIELD_M);
    let fine = geometric(finest, smallest, 8).into_iter().filter(|y| *y < 0.9 * smallest);
    list.extend(fine.map(|y| Law::Friction(Slider { yield_m: y, gap_m: 0.0 })));
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
    if scales.current {
        list.push(Law::Saturation);
    }
    list.extend(
        geometric(5.0 * scales.smoothing_m_s, 0.5 * scales.fastest_m_s, 12)
            .into_iter()
            .map(|v| Law::Stribeck { velocity_m_s: v }),
    );
    for gap in geometric(smallest, 0.5 * scales.stroke_m, 12) {
        list.extend(yields.iter().map(|&y| Law::Friction(Slider { yield_m: y, gap_m: gap })));
    }
    let finest = (scales.stroke_m / 300.0).max(20.0 * scales.resolution_m);
    let waves = (2.0 * scales.stroke_m / finest).clamp(8.0, 600.0) as usize;
    list.extend((3..waves).map(|k| Law::Wave { wavelength_m: 2.0 * scales.stroke_m / k as f64 }));
    // Turns of the motor and its first harmonics, however long the stroke is.
    let turns = scales.lead_m.into_iter().flat_map(|lead| (1..=12).map(move |k| lead / f64::from(k)));
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
            rate_hz: 100.0,
            band_hz: 30.0,
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
        let state = Slider { yield_m: 1.0e-3, gap_m: 2.0e-3 }.state(&triangle(), 1.0e-4);
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

    #[test]
    fn the_richer_slider_takes_the_place_of_the_poorer() {
        let (step, soft, play) =
            (Slider::STEP, Slider { yield_m: 1.0, gap_m: 0.0 }, Slider { yield_m: 1.0, gap_m: 1.0 });
        assert!(Law::Friction(soft).replaces(Law::Friction(step)));
        assert!(Law::Friction(play).replaces(Law::Friction(soft)));
        assert!(!Law::Friction(step).replaces(Law::Friction(soft)));
    }
}
