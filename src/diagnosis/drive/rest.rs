//! What is left above the floor, where it enters, and when.

use super::criteria::Criteria;
use super::likelihood::{Design, Spread};
use super::signals::Layout;
use super::state::{Balance, State};
use crate::plant::effects::Port;

/// Bands from which on an axis with one position shows its floor, as a share of the highest frequency.
const QUIET_FROM: f64 = 0.02;
/// Share of the excess that the stated band holds.
const MOST: f64 = 0.95;

/// What a state leaves above the floor.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rest {
    /// Root mean square of what is above the floor in the direction where it is largest, N.
    pub(super) force_n: f64,
    /// The floor in the same bands, N.
    pub(super) floor_n: f64,
    /// The floor over the whole band, motor and stage, N.
    pub(super) floors_n: [f64; 2],
    /// Where it enters.
    pub(super) port: Port,
    /// From zero to where nearly all of it is, Hz.
    pub(super) band_hz: [f64; 2],
}

impl Rest {
    /// True where it stands above the floor by itself, or above what the model states to leave.
    pub(super) fn is_left(&self, stated_n: f64) -> bool {
        let c = &Criteria::STANDARD;
        self.force_n > (c.rest_floors * self.floor_n).max(c.repeat_factor * stated_n)
    }
}

/// What is left of a state.
pub(super) fn rest(balance: &Balance, state: &State) -> Rest {
    rest_of(balance, state, (&state.base.design, &state.base.fit.beta))
}

/// What another design leaves of the same inner products.
pub(super) fn rest_of(balance: &Balance, state: &State, (design, beta): (&Design, &[f64])) -> Rest {
    let base = &state.base;
    let plan = &balance.plan;
    let two = balance.signals.sides() == 2;
    let [low_hz, high_hz] = Criteria::STANDARD.floor_band.map(|s| s * balance.signals.top_hz());
    let middle = |band: usize| 0.5 * plan.band_hz(band).iter().sum::<f64>();
    let all = base.gram.sum_by_band(plan);
    let spreads: Vec<Spread> = all.iter().map(|b| design.spread(b, beta)).collect();
    // Noise of a position through the mass, before the low-pass: white position, squared by frequency.
    let of_position = |recording: usize, hz: f64| {
        let s = &balance.signals;
        let per_m = state.mechanics.stage_mass_kg * (std::f64::consts::TAU * hz).powi(2);
        2.0 / s.step as f64 * s.noise_m2[recording] * per_m * per_m
    };
    let floor_of = |recording: usize| -> Spread {
        let own = || all.iter().zip(&spreads).filter(move |(b, _)| b.recording == recording);
        if two {
            let reference = own().find(|(b, _)| (low_hz..high_hz).contains(&middle(b.band)));
            return reference.or(own().next_back()).map_or([0.0; 3], |(_, s)| *s);
        }
        let from_hz = QUIET_FROM * balance.signals.top_hz();
        // Noise of the force is white before the low-pass; where that has taken half of it, nothing is read.
        // Where the low-pass has taken half of it, little is read; a slow recording may have nothing else.
        let quiet = |least: f64| {
            let bands = own().filter(|(b, _)| middle(b.band) > from_hz).filter_map(|(b, s)| {
                let kept = balance.signals.kept_power(middle(b.band));
                (kept > least).then_some((s[0] / kept - of_position(recording, middle(b.band))).max(0.0))
            });
            Some(bands.fold(f64::INFINITY, f64::min)).filter(|f| f.is_finite())
        };
        [quiet(0.5).or_else(|| quiet(0.0)).unwrap_or(0.0), 0.0, 0.0]
    };
    let scale = 1.0 / plan.measured().max(1.0);
    let (mut excess, mut floor, mut whole) = ([0.0; 3], 0.0, [0.0; 2]);
    let mut by_band = vec![0.0; plan.bands()];
    for (band, s) in all.iter().zip(&spreads) {
        let f = floor_of(band.recording);
        let share = band.values * scale;
        whole[0] += f[0] * share;
        whole[1] += f[2] * share;
        if middle(band.band) < low_hz || !two {
            let f = if two {
                f
            } else {
                let hz = middle(band.band);
                [balance.signals.kept_power(hz) * (f[0] + of_position(band.recording, hz)), 0.0, 0.0]
            };
            (0..3).for_each(|k| excess[k] += (s[k] - f[k]) * share);
            by_band[band.band] += (s[0] - f[0] + s[2] - f[2]).max(0.0) * share;
            floor += (f[0] + f[2]) * share;
        }
    }
    let (value, direction) = largest(excess);
    let total: f64 = by_band.iter().sum();
    let mut sum = 0.0;
    let last = by_band.iter().position(|b| {
        sum += b;
        sum >= MOST * total
    });
    Rest {
        force_n: value.max(0.0).sqrt(),
        floor_n: floor.sqrt(),
        floors_n: whole.map(f64::sqrt),
        port: port_of(balance.signals.layout, direction),
        band_hz: [0.0, plan.band_hz(last.unwrap_or(0))[1]],
    }
}

/// Largest eigenvalue of a symmetric 2x2 and its direction.
fn largest(s: Spread) -> (f64, [f64; 2]) {
    let [a, b, d] = s;
    let half = 0.5 * (a - d);
    let root = half.hypot(b);
    let angle = 0.5 * (2.0 * b).atan2(a - d);
    (0.5 * (a + d) + root, [angle.cos(), angle.sin()])
}

/// The port whose force lies nearest to a direction.
fn port_of(layout: Layout, direction: [f64; 2]) -> Port {
    if layout != Layout::TwoPositions {
        return Port::Stage;
    }
    let h = std::f64::consts::FRAC_1_SQRT_2;
    let ports = [(Port::Motor, [1.0, 0.0]), (Port::Stage, [0.0, 1.0]), (Port::Coupling, [h, -h])];
    let along = |of: [f64; 2]| (of[0] * direction[0] + of[1] * direction[1]).abs();
    let best = ports.into_iter().max_by(|a, b| along(a.1).total_cmp(&along(b.1)));
    best.map_or(Port::Stage, |b| b.0)
}

/// When the low bands of a recording stand above their own median, s.
pub(super) fn spans_s(
    balance: &Balance,
    state: &State,
    recording: usize,
    band_hz: [f64; 2],
) -> Vec<[f64; 2]> {
    /// Over the median of the blocks.
    const LOUD: f64 = 3.0;
    let base = &state.base;
    let left = super::state::residual(balance, &base.gram, &base.design, &base.fit.beta);
    let track = &balance.signals.tracks[recording];
    let step = balance.signals.step;
    let whole = [track.start_s, track.start_s + track.samples as f64 / track.rate_hz];
    let mut powers: Vec<(usize, f64)> = Vec::new();
    let last = ((band_hz[1] / balance.plan.bin_hz) as usize + 1).max(1);
    for spectrum in left.sides.iter().flatten() {
        for (k, (at, power)) in balance.plan.powers(spectrum, recording).into_iter().enumerate() {
            let sum: f64 = power[..last.min(power.len())].iter().sum();
            match powers.get_mut(k) {
                Some(p) => p.1 += sum,
                None => powers.push((at, sum)),
            }
        }
    }
    let mut sorted: Vec<f64> = powers.iter().map(|p| p.1).collect();
    sorted.sort_by(f64::total_cmp);
    let limit = LOUD * sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    let half_s = 0.5 / balance.plan.bin_hz;
    let mut spans: Vec<[f64; 2]> = Vec::new();
    for (at, _) in powers.iter().filter(|p| p.1 > limit) {
        let middle = track.start_s + track.thin_s(*at, step);
        let span = [(middle - half_s).max(whole[0]), (middle + half_s).min(whole[1])];
        match spans.last_mut() {
            Some(s) if s[1] >= span[0] => s[1] = span[1],
            _ => spans.push(span),
        }
    }
    if spans.is_empty() { vec![whole] } else { spans }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_force_between_the_sides_is_told_from_one_at_a_side() {
        let of = |direction: [f64; 2]| {
            let s = [direction[0].powi(2), direction[0] * direction[1], direction[1].powi(2)];
            let (value, along) = largest(s);
            assert!((value - s[0] - s[2]).abs() < 1e-12);
            port_of(Layout::TwoPositions, along)
        };
        assert_eq!(of([2.0, 0.1]), Port::Motor);
        assert_eq!(of([0.1, -1.0]), Port::Stage);
        assert_eq!(of([-1.0, 1.1]), Port::Coupling);
    }
}
