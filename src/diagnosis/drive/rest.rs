//! What is left above the floor, where it enters, and when.

use super::evidence::level;
use super::gram::{BandGram, Gram};
use super::likelihood::{Design, ITERATIONS, Spread};
use super::number::{Mechanics, Number};
use super::signals::Layout;
use super::spectra::Spectrum;
use super::state::{Balance, State, residual};
use crate::diagnosis::criteria::Criteria;
use crate::plant::effects::Port;
use rustfft::num_complex::Complex;
use std::f64::consts::TAU;

/// What a state leaves above the floor.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rest {
    /// Root mean square of what is above the floor in the direction where it is largest, N.
    pub(super) force_n: f64,
    /// What every axis leaves there, N: the steps of the recorded force, which stand at rest so that no floor
    /// shows them, or the texture of its guides.
    pub(super) usual_n: f64,
    /// The floor in the same bands, N.
    pub(super) floor_n: f64,
    /// The floor over the whole band, motor and stage, N.
    pub(super) floors_n: [f64; 2],
    /// Where it enters.
    pub(super) port: Port,
    /// From zero to where nearly all of it is, Hz.
    pub(super) band_hz: [f64; 2],
    /// Shares of its power at the motor, at the stage and in their sum; `None`: one position shows no sides,
    /// or nothing is above the floor.
    pub(super) shares: Option<[f64; 3]>,
}

impl Rest {
    /// True where it stands above the floor by itself, above what the model states to leave, and above what
    /// every axis leaves.
    pub(super) fn is_left(&self, stated_n: f64) -> bool {
        let c = &Criteria::STANDARD;
        self.force_n > self.floor_n.max(c.repeat_factor * stated_n).max(self.usual_n)
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
    let [low_hz, high_hz] = plan.floor_hz();
    let middle = |band: usize| 0.5 * plan.band_hz(band).iter().sum::<f64>();
    let all = base.gram.sum_by_band(plan);
    let spreads: Vec<Spread> = all.iter().map(|b| design.spread(b, beta)).collect();
    let even = evened(&all.iter().map(|b| b.recording).collect::<Vec<_>>(), &spreads);
    let rounded = if two { rounded(balance, state) } else { vec![[0.0; 3]; all.len()] };
    // Noise of a position through the mass, before the low-pass: white position, squared by frequency.
    let of_position = |recording: usize, hz: f64| {
        let s = &balance.signals;
        let per_m = state.now.mechanics.stage_mass_kg * (std::f64::consts::TAU * hz).powi(2);
        2.0 / s.step as f64 * s.noise_m2[recording] * per_m * per_m
    };
    let floor_of = |recording: usize| -> Spread {
        let own = || all.iter().zip(&spreads).filter(move |(b, _)| b.recording == recording);
        if two {
            let read = || all.iter().zip(&even).filter(move |(b, _)| b.recording == recording);
            let reference = read().find(|(b, _)| (low_hz..high_hz).contains(&middle(b.band)));
            return reference.or(read().next_back()).map_or([0.0; 3], |(_, s)| *s);
        }
        // Noise of the force is white before the low-pass. Where that has taken half of it, little is read; a
        // slow recording may have nothing else.
        let quiet = |least: f64| {
            let bands = own().filter_map(|(b, s)| {
                let kept = balance.signals.kept_power(middle(b.band));
                (kept > least).then_some((s[0] / kept - of_position(recording, middle(b.band))).max(0.0))
            });
            Some(bands.fold(f64::INFINITY, f64::min)).filter(|f| f.is_finite())
        };
        [quiet(0.5).or_else(|| quiet(0.0)).unwrap_or(0.0), 0.0, 0.0]
    };
    // The floor of a band: of one position both noises pass the low-pass. A noise of the position that is not
    // white was read off where it is largest: no floor is above what is left.
    let floor_in = |band: &BandGram, left: &Spread| -> Spread {
        let (f, hz) = (floor_of(band.recording), middle(band.band));
        let one = || balance.signals.kept_power(hz) * (f[0] + of_position(band.recording, hz));
        if two { f } else { [one().min(left[0]), 0.0, 0.0] }
    };
    let scale = 1.0 / plan.measured().max(1.0);
    let (mut excess, mut floor, mut whole) = ([0.0; 3], 0.0, [0.0; 2]);
    let mut by_band = vec![0.0; plan.bands()];
    let mut counted: Vec<bool> = (0..plan.bands()).map(|b| plan.band_hz(b)[1] < low_hz).collect();
    for (((band, s), even), rounded) in all.iter().zip(&spreads).zip(&even).zip(&rounded) {
        let is_low = middle(band.band) < low_hz || !two;
        let f = not_below(rounded, floor_in(band, s));
        let share = band.values * scale;
        whole[0] += f[0] * share;
        whole[1] += f[2] * share;
        // Where the floor is read and above no floor says what is left; a line stands out of its neighbours.
        let f = if is_low { f } else { not_below(rounded, *even) };
        let is_line = !is_low && largest([0, 1, 2].map(|k| s[k] - f[k])) > f[0] + f[2];
        counted[band.band] |= is_line;
        if is_low || is_line {
            (0..3).for_each(|k| excess[k] += (s[k] - f[k]) * share);
            by_band[band.band] += (s[0] - f[0] + s[2] - f[2]).max(0.0) * share;
            floor += (f[0] + f[2]) * share;
        }
    }
    let floors: Vec<Spread> = (0..plan.recordings()).map(floor_of).collect();
    let total: f64 = by_band.iter().sum();
    let mut sum = 0.0;
    let last = by_band.iter().position(|b| {
        sum += b;
        sum >= Criteria::STANDARD.excess_share * total
    });
    let port = port_of(balance, state, (design, beta), (&floors, &counted));
    let thrust_n = all.iter().map(|b| b.products[0][0] * scale).sum::<f64>().sqrt();
    Rest {
        usual_n: usual_n(balance, state, (port, thrust_n)),
        force_n: largest(excess).max(0.0).sqrt(),
        floor_n: floor.sqrt(),
        floors_n: whole.map(f64::sqrt),
        port,
        band_hz: [0.0, plan.band_hz(last.unwrap_or(0))[1]],
        shares: shares(excess).filter(|_| two),
    }
}

/// The spectrum of each band (of these recordings, band by band), no more at either side than in the greater
/// of its neighbours: noise rises or falls from band to band, a line and a resonance stand out.
fn evened(recordings: &[usize], spreads: &[Spread]) -> Vec<Spread> {
    let same = |a: usize, b: usize| recordings.get(b) == Some(&recordings[a]);
    let of = |k: usize| {
        let own = spreads[k];
        let neighbours =
            k.checked_sub(1).filter(|below| same(k, *below)).zip(Some(k + 1).filter(|a| same(k, *a)));
        let Some((below, above)) = neighbours else { return own };
        let kept = [0, 2].map(|side| {
            let most = spreads[below][side].max(spreads[above][side]);
            if own[side] > most { (most / own[side]).sqrt() } else { 1.0 }
        });
        [kept[0] * kept[0] * own[0], kept[0] * kept[1] * own[1], kept[1] * kept[1] * own[2]]
    };
    (0..spreads.len()).map(of).collect()
}

/// See [`Rest::usual_n`].
fn usual_n(balance: &Balance, state: &State, (port, thrust_n): (Port, f64)) -> f64 {
    let two = balance.signals.sides() == 2;
    // A step of q is a noise of q^2 / 12.
    let steps_n = balance.signals.tracks.iter().map(|t| t.reference.step_n / 12.0_f64.sqrt());
    let rounding_n = steps_n.filter(|_| !two || port == Port::Motor).fold(0.0, f64::max);
    // All dry friction is in the one number of one position, and no friction is more than the thrust.
    let dry_n = match port {
        Port::Motor | Port::Stage if two => state.dry_n(),
        Port::Motor | Port::Stage => state.coulomb_n(),
        _ => 0.0,
    };
    rounding_n.max(Criteria::STANDARD.texture * dry_n.min(thrust_n))
}

/// What the steps of two encoders make in each band, mean square: white in no axis that creeps, a line in one
/// that moves at one speed.
fn rounded(balance: &Balance, state: &State) -> Vec<Spread> {
    let columns = balance.rounding(&state.ground(balance)).into_owned();
    let worlds = columns.len();
    let of = |b: BandGram| {
        let power = |kind: usize| (0..worlds).map(|k| b.products[kind][k * (worlds + 1)]).sum::<f64>();
        [0, 1, 2].map(|kind| power(kind) / (worlds as f64 * b.values))
    };
    Gram::new(&balance.plan, columns).sum_by_band(&balance.plan).into_iter().map(of).collect()
}

/// A floor that is at neither side below another one.
fn not_below(other: &Spread, floor: Spread) -> Spread {
    let both = if other[0] + other[2] > floor[0] + floor[2] { other[1] } else { floor[1] };
    [floor[0].max(other[0]), both, floor[2].max(other[2])]
}

/// Shares of motor, stage and their sum in what is above the floor. A force between the two has no sum; of
/// two that act alike the sum has all, and more than all is none.
fn shares([motor, both, stage]: Spread) -> Option<[f64; 3]> {
    let own = [motor, stage].map(|x| x.max(0.0));
    let whole = own[0] + own[1];
    let sum = (whole + 2.0 * both).clamp(0.0, whole);
    (whole > 0.0).then(|| [own[0], own[1], sum].map(|x| x / whole))
}

/// Largest eigenvalue of a symmetric 2x2.
fn largest([a, b, d]: Spread) -> f64 {
    0.5 * (a + d) + (0.5 * (a - d)).hypot(b)
}

/// The port that explains best how what is left divides between motor and stage at each frequency.
///
/// A force without law has the same direction at all frequencies. An error e of an encoder is the force
/// K e in the spring, and -M w^2 e besides on its own side. Of each port the size of its force is free in
/// each band of each recording, beside the floor F: S = F + s u u^H; the likeliest counts.
fn port_of(
    balance: &Balance,
    state: &State,
    (design, beta): (&Design, &[f64]),
    (floor, counted): (&[Spread], &[bool]),
) -> Port {
    if balance.signals.layout != Layout::TwoPositions {
        return Port::Stage;
    }
    let left = residual(balance, (&state.base.gram, design, beta));
    let [Some(motor), Some(stage)] = &left.sides else { return Port::Stage };
    let plan = &balance.plan;
    let nats = |port: &Port| -> f64 {
        let mut gained = vec![0.0; floor.len()];
        let mut bins = vec![Vec::new(); floor.len() * plan.bands()];
        for cell in plan.cells.iter().filter(|c| counted[c.band]) {
            let f = design.weight(floor[cell.recording]);
            let (of_motor, of_stage) = (cell.of(motor).chunks_exact(2), cell.of(stage).chunks_exact(2));
            for (k, (m, s)) in of_motor.zip(of_stage).enumerate() {
                let u = direction(*port, state, TAU * plan.hz(cell.band, k));
                let r = [Complex::new(m[0], m[1]), Complex::new(s[0], s[1])];
                let seen = [f[0] * u[0] + f[1] * u[1], f[1] * u[0] + f[2] * u[1]];
                let size = (u[0].conj() * seen[0] + u[1].conj() * seen[1]).re;
                let along = (seen[0].conj() * r[0] + seen[1].conj() * r[1]).norm_sqr();
                bins[cell.recording * plan.bands() + cell.band].push([size, along]);
            }
        }
        for (k, bins) in bins.iter().enumerate() {
            gained[k / plan.bands()] += best_gain(bins);
        }
        gained.iter().sum()
    };
    let ports = [Port::Motor, Port::Stage, Port::Coupling, Port::MotorEncoder, Port::StageEncoder];
    let gains = ports.map(|p| nats(&p));
    let best = (0..ports.len()).max_by(|a, b| gains[*a].total_cmp(&gains[*b])).unwrap_or(1);
    let (level_nats, [.., coupling, _, scale]) = (level(state, (1, 0.0)), gains);
    // Where nothing tells the spring from the encoders at its ends it is the spring if it goes with its
    // force, and else the scale that drifts.
    let alike_nats = level_nats.max(Criteria::STANDARD.exactness * gains[best]);
    if best >= 2 && gains[best] - coupling < alike_nats && goes_with_spring(balance, state, stage) {
        return Port::Coupling;
    }
    if best >= 2 && gains[best] - scale < level_nats { Port::StageEncoder } else { ports[best] }
}

/// Whether more than half of what is left at the stage is linear in what that needs of its spring, as it is
/// of one whose stiffness depends on frequency: by the coherence of both over the blocks of a recording, at
/// each frequency. K d + left is what masses and frictions of the stage need: an error of the scale is in the
/// stretch d, and not in that.
fn goes_with_spring(balance: &Balance, state: &State, left: &Spectrum) -> bool {
    let plan = &balance.plan;
    let Some(place) = state.base.numbers.iter().position(|n| *n == Number::Stiffness) else { return false };
    let Some(stretch) = state.base.gram.column(1 + place).sides[1].as_ref() else { return false };
    let stiffness_n_m = state.base.fit.beta[place];
    let [low_hz, _] = plan.floor_hz();
    let (mut linear, mut whole) = (0.0, 0.0);
    for recording in 0..plan.recordings() {
        for band in (0..plan.bands()).filter(|band| plan.band_hz(*band)[1] < low_hz) {
            let mut bins = vec![Coherence::default(); plan.width(band)];
            for cell in plan.cells.iter().filter(|c| c.recording == recording && c.band == band) {
                let pairs = cell.of(stretch).chunks_exact(2).zip(cell.of(left).chunks_exact(2));
                let count = bins.len();
                for (k, (d, r)) in pairs.enumerate() {
                    let [d, r] = [d, r].map(|x| Complex::new(x[0], x[1]));
                    // At the stage the column is the stretch with its sign turned, and what is left is what
                    // the spring gives less what is needed.
                    bins[k % count].take(stiffness_n_m * d + r, r);
                }
            }
            linear += bins.iter().map(Coherence::linear).sum::<f64>();
            whole += bins.iter().map(|bin| bin.of_left).sum::<f64>();
        }
    }
    2.0 * linear > whole
}

/// Of two complex series.
#[derive(Debug, Clone, Copy, Default)]
struct Coherence {
    values: f64,
    of_both: Complex<f64>,
    of_spring: f64,
    of_left: f64,
}

impl Coherence {
    fn take(&mut self, spring: Complex<f64>, left: Complex<f64>) {
        self.values += 1.0;
        self.of_both += spring.conj() * left;
        self.of_spring += spring.norm_sqr();
        self.of_left += left.norm_sqr();
    }

    /// Power of the second that is linear in the first, less what chance has of it: of n values one.
    fn linear(&self) -> f64 {
        if self.values < 2.0 {
            return 0.0;
        }
        let linear = self.of_both.norm_sqr() / self.of_spring.max(f64::MIN_POSITIVE);
        (linear - (self.of_left - linear) / (self.values - 1.0)).max(0.0)
    }
}

/// Force at motor and stage of a unit at a port, at w rad/s; of an encoder a metre, elsewhere a newton.
fn direction(port: Port, state: &State, w: f64) -> [Complex<f64>; 2] {
    let one = Complex::new(1.0, 0.0);
    match port {
        Port::Motor => [one, 0.0 * one],
        Port::Coupling => [one, -one],
        Port::MotorEncoder | Port::StageEncoder => pull_n_m(port, &state.now.mechanics, w),
        _ => [0.0 * one, one],
    }
}

/// What the balance needs less at motor and stage where an encoder reads a metre too much, N/m; one position
/// has one mass, and the first alone counts.
pub(super) fn pull_n_m(port: Port, m: &Mechanics, w: f64) -> [Complex<f64>; 2] {
    let spring = Complex::new(m.stiffness_n_m, w * m.structural_damping_n_s_m);
    let own = |mass: f64, damping: f64| Complex::new(-mass * w * w, w * damping) + spring;
    if m.stiffness_n_m == 0.0 {
        return [-own(m.stage_mass_kg, m.stage_damping_n_s_m), Complex::new(0.0, 0.0)];
    }
    match port {
        Port::MotorEncoder => [-own(m.motor_mass_kg, m.motor_damping_n_s_m), spring],
        _ => [spring, -own(m.stage_mass_kg, m.stage_damping_n_s_m)],
    }
}

/// Gain in log-likelihood of a force of free size s in one band, bins of (u^H F^-1 u, |u^H F^-1 r|^2):
/// sum b s / (1 + a s) - ln(1 + a s), halved for overlapping blocks.
fn best_gain(bins: &[[f64; 2]]) -> f64 {
    let gain =
        |s: f64| -> f64 { bins.iter().map(|[a, b]| 0.5 * (b * s / (1.0 + a * s) - (a * s).ln_1p())).sum() };
    // Of one size of all bins s is mean(b / a^2 - 1 / a); repeated with the weights that it gives.
    let mut s = 0.0;
    for _ in 0..ITERATIONS {
        let (mut top, mut bottom) = (0.0, 0.0);
        for [a, b] in bins {
            let weight = (a / (1.0 + a * s)).powi(2);
            top += weight * (b / (a * a) - 1.0 / a);
            bottom += weight;
        }
        s = (top / f64::max(bottom, f64::MIN_POSITIVE)).max(0.0);
    }
    gain(s).max(0.0)
}

/// When the low bands of a recording stand above their own median, s.
pub(super) fn spans_s(
    balance: &Balance,
    state: &State,
    recording: usize,
    band_hz: [f64; 2],
) -> Vec<[f64; 2]> {
    let left = residual(balance, state.base.fitted());
    let track = &balance.signals.tracks[recording];
    let step = balance.signals.step;
    let whole = track.span_s();
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
    let limit = Criteria::STANDARD.loud * sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
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
    use super::evened;

    #[test]
    fn a_line_stands_out_of_its_neighbours_and_noise_that_rises_or_falls_does_not() {
        let noise = [[1.0, 0.1, 9.0], [2.0, 0.1, 8.0], [2.0, 0.1, 2.0], [8.0, 0.2, 1.0]];
        assert_eq!(evened(&[0; 4], &noise), noise);
        let mut line = noise;
        line[1] = [2.0, 2.0, 32.0];
        let even = evened(&[0; 4], &line);
        assert_eq!((even[0], even[2], even[3]), (line[0], line[2], line[3]));
        assert!((even[1][0] - 2.0).abs() < 1e-12 && (even[1][2] - 9.0).abs() < 1e-12, "{even:?}");
        // As much of both at once as of each.
        assert!((even[1][1] / (even[1][0] * even[1][2]).sqrt() - 0.25).abs() < 1e-12, "{even:?}");
        // Of another recording nothing is a neighbour.
        assert_eq!(evened(&[0, 0, 1, 1], &line), line);
    }
}
