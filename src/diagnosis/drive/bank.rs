//! Which hypotheses there are for a state: shapes on a grid that the recordings scale, wavelengths and lines
//! where what is left has peaks.

use super::criteria::Criteria;
use super::shape::{Hypothesis, Over, Shape};
use super::signals::Layout;
use super::state::{Balance, State, residual};
use crate::plant::effects::{EffectKind as E, Port};
use crate::signal::inner_products::rms;
use crate::signal::sliding_median::sliding_median;
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;
use std::f64::consts::TAU;

/// Peaks of a search that are asked about.
const PEAKS: usize = 3;
/// Places of a wave's phase on the grid that its transform is taken from.
const PLACES: f64 = 16.0;
/// Shortest wavelength of a force over position, in travels, and highest order of a torque ripple.
const SHORTEST: f64 = 1.0 / 160.0;
const HIGHEST_ORDER: f64 = 130.0;
/// Harmonics whose sum a cut is searched by.
const SEARCHED_HARMONICS: usize = 4;
/// Splines of a map when it is first asked about, and then.
pub(super) const PIECES: [usize; 4] = [20, 40, 60, 90];

/// Everything that may be asked of a state.
pub(super) fn candidates(balance: &Balance, state: &State) -> Vec<Hypothesis> {
    let mut list = frictions(balance, state);
    list.extend(thrust(balance, state));
    list.extend(positions(balance, state));
    match balance.signals.layout {
        Layout::TwoPositions => list.extend(springs(balance, true)),
        Layout::Locked => list.extend(springs(balance, false)),
        Layout::OnePosition => list.extend(plays(balance)),
    }
    let taken = |h: &Hypothesis| {
        state.accepted.iter().any(|a| {
            let other = &a.hypothesis;
            other.effect == h.effect
                && other.port == h.port
                && !h.is_of_one_recording()
                && other.is_number() == h.is_number()
        })
    };
    let mut seen: Vec<Hypothesis> = Vec::new();
    list.retain(|h| {
        let new = !taken(h) && !seen.contains(h);
        seen.push(*h);
        new
    });
    list
}

/// A factor grid from one size to another.
fn grid(from: f64, to: f64, count: usize) -> impl Iterator<Item = f64> {
    let step = (to / from).max(1.0).powf(1.0 / (count.max(2) - 1) as f64);
    (0..count).map(move |k| from * step.powi(k as i32))
}

fn frictions(balance: &Balance, state: &State) -> Vec<Hypothesis> {
    let s = &balance.signals;
    let one = s.layout != Layout::TwoPositions;
    let at = |effect, shape| Hypothesis::named(effect, Port::Stage, shape);
    let last = usize::from(!one);
    let speeds = s.tracks.iter().flat_map(|t| &t.thin.velocity[last]);
    let fastest = speeds.fold(0.0_f64, |m, v| m.max(v.abs()));
    let longest_s = s.longest_s();
    let [low, high] = s.travel_m();
    let vs = state.smoothing_m_s;
    let mut list = Vec::new();
    let least = Criteria::STANDARD.turning * vs;
    let top = (0.3 * fastest).clamp(2.0 * least, 16.0 * least);
    list.extend(grid(least, top, 6).map(|v| at(E::StribeckFriction, Shape::Stribeck { speed_m_s: v })));
    let least_m = s.least_way_m(last);
    // Of what is held friction's bristle is in the train, and no softer.
    let held_m = state.coulomb_n() / state.mechanics.stiffness_n_m;
    let (most_m, count) = if s.layout == Layout::Locked {
        (held_m, 6)
    } else if one {
        (0.25 * (high - low), 10)
    } else {
        (128.0 * least_m, 8)
    };
    list.extend(
        grid(least_m, most_m.max(2.0 * least_m), count)
            .map(|x| at(E::PreslidingFriction, Shape::Presliding { yield_m: x })),
    );
    list.push(at(E::AsymmetricFriction, Shape::Asymmetric));
    list.push(at(E::AsymmetricFriction, Shape::AsymmetricViscous));
    // Beside a spindle that turns a load and the mean force of a cut are one.
    list.push(match s.spindle_hz() {
        Some(hz) => at(E::CuttingForce, Shape::Cut { hz, start_s: 0.0, end_s: longest_s }),
        None => at(E::GravityLoad, Shape::Gravity),
    });
    list.push(at(E::NonlinearViscosity, Shape::NonlinearViscosity));
    list.extend(
        grid(0.04 * longest_s, 0.6 * longest_s, 5).map(|t| at(E::FrictionDrift, Shape::Drift { tau_s: t })),
    );
    // Of one position parts in several forms are free, and a way besides: a speed is asked about where one
    // is stated.
    if !one || balance.drive.raw().friction_smoothing_m_s.is_some() {
        list.extend([0.4, 2.5].map(|r| at(E::CoulombFriction, Shape::Smoothing { speed_m_s: r * vs })));
    }
    list
}

fn thrust(balance: &Balance, state: &State) -> Vec<Hypothesis> {
    let s = &balance.signals;
    let at = |effect, shape| Hypothesis::named(effect, Port::Current, shape);
    let mut list = Vec::new();
    let period_s = 1.0 / s.rate_hz;
    // A force that was measured has nothing before it.
    if !state.inertial || state.is_measured(balance) {
        return list;
    }
    let delays = [(0.3, false), (0.8, false), (1.6, false), (3.0, false), (5.0, false)];
    for (samples, early) in delays.into_iter().filter(|_| !balance.clock_moved) {
        list.push(at(E::DeadTime, Shape::Delay { extra_s: samples * period_s, early }));
    }
    match state.path.loop_rad_s {
        _ if balance.clock_moved => {}
        Some(w) => {
            for share in [0.25, 0.4, 0.6, 0.85] {
                list.push(at(E::CurrentLoopLag, Shape::Loop { rad_s: share * w, in_place: false }));
            }
        }
        None => {
            for share in [0.1, 0.2, 0.5, 1.2, 3.0] {
                list.push(at(
                    E::CurrentLoopLag,
                    Shape::Loop { rad_s: share * s.rate_hz, in_place: state.found_delay },
                ));
            }
        }
    }
    if s.tracks.iter().all(|t| t.reference.is_current) {
        let amperes = |t: &super::signals::Track| {
            t.reference.reference_n.iter().fold(0.0_f64, |m, f| m.max((f / t.reference.per_unit).abs()))
        };
        let most = s.tracks.iter().map(amperes).fold(1e-9, f64::max);
        for bent in [0.02, 0.07, 0.25, 0.8] {
            let per_a2 = bent / (most * most);
            list.extend(
                [0.0, 1.0].map(|parabolic| {
                    at(E::TorqueConstantSaturation, Shape::Saturation { per_a2, parabolic })
                }),
            );
        }
    }
    list
}

/// Play in front of a slider, where one position is all that there is.
fn plays(balance: &Balance) -> impl Iterator<Item = Hypothesis> + use<> {
    let [low, high] = balance.signals.travel_m();
    let least_m = 4.0 * balance.signals.steps_m[0].max(1e-3 * (high - low));
    grid(least_m, 0.3 * (high - low), 6).flat_map(|gap_m| {
        [0.1, 0.5].map(|share| {
            let shape = Shape::Play { gap_m, yield_m: share * gap_m };
            Hypothesis::named(E::Backlash, Port::Coupling, shape)
        })
    })
}

/// Gaps of a stage that is held, over the travel of the motor.
pub(super) fn gaps(balance: &Balance) -> impl Iterator<Item = Shape> + use<> {
    let [low, high] = balance.signals.travel_m();
    let travel_m = high - low;
    let least = (4.0 * balance.signals.steps_m[0] / travel_m).clamp(0.02, 0.5);
    grid(least, 0.8, 6).flat_map(move |share| {
        [0.2, 0.35, 0.5, 0.65, 0.8].map(move |part| {
            let gap_m = share * travel_m;
            Shape::Gap { gap_m, flank_m: part * (travel_m - gap_m) }
        })
    })
}

fn springs(balance: &Balance, two: bool) -> Vec<Hypothesis> {
    let s = &balance.signals;
    let at = |effect, shape| Hypothesis::named(effect, Port::Coupling, shape);
    let [low, high] = s.travel_m();
    let mut list = vec![at(E::NonlinearStiffness, Shape::Cubic)];
    if !two {
        list.extend(gaps(balance).map(|shape| at(E::Backlash, shape)));
        return list;
    }
    let stretch: Vec<f64> = s.tracks.iter().map(|t| rms(&t.thin.stretch)).collect();
    let size_m = rms(&stretch);
    for share in [0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.0] {
        let gap_m = share * size_m;
        list.push(at(E::Backlash, Shape::Backlash { gap_m, loose: false }));
        list.push(at(E::Backlash, Shape::Backlash { gap_m, loose: true }));
    }
    list.push(at(E::PositionDependentStiffness, Shape::StiffnessSlope));
    for lengths in [1.0, 1.5, 2.5, 4.0, 7.0] {
        let length_m = lengths * (high - low);
        list.push(at(E::PositionDependentStiffness, Shape::StiffnessWave { length_m }));
    }
    for factor in [0.75, 0.95, 1.2, 1.6, 2.2, 3.2, 4.5] {
        let frequency_hz = factor * s.band_hz;
        list.push(at(E::TorsionalMode, Shape::Torsion { frequency_hz, share: 0.5, damping: 0.02 }));
    }
    list
}

fn positions(balance: &Balance, state: &State) -> Vec<Hypothesis> {
    let s = &balance.signals;
    let two = s.layout == Layout::TwoPositions;
    let [low, high] = s.travel_m();
    let travel_m = high - low;
    let left = residual(balance, &state.base.gram, &state.base.design, &state.base.fit.beta);
    let mut list = Vec::new();
    if s.layout != Layout::Locked {
        let whitened = whitened(balance, state, &left);
        let last = usize::from(two);
        let longest = 0.5 * travel_m;
        let shortest = travel_m * SHORTEST;
        let plain = |side: usize| {
            left.sides[side].as_ref().map_or_else(Vec::new, |x| balance.plan.series(x, &s.lengths()))
        };
        let lead_m = balance.drive.screw_lead_m();
        // Waves of the screw itself, then peaks of what is left, with and without the weights of its bands: a
        // slow wave has made its own band worthless.
        let of_screw =
            lead_m.into_iter().flat_map(|l| [l, 0.5 * l]).filter(|l| (shortest..longest).contains(l));
        let found = [&whitened[last], &plain(last)].map(|x| peaks(balance, x, [shortest, longest]));
        for wavelength_m in of_screw.chain(found.into_iter().flatten()) {
            list.push(wave(wavelength_m, Port::Stage));
        }
        if let Some(lead) = lead_m.filter(|_| two) {
            let range = [lead / HIGHEST_ORDER, longest];
            let found = [&whitened[0], &plain(0)].map(|x| peaks(balance, x, range));
            for wavelength_m in of_motor(balance, lead).chain(found.into_iter().flatten()) {
                list.push(wave(wavelength_m, Port::Motor));
            }
        }
        if let Some(lead) = lead_m.filter(|_| !two) {
            // One position tells what the motor does by how often it does it in a turn.
            let found = peaks(balance, &plain(0), [lead / HIGHEST_ORDER, shortest]);
            let of_motor = of_motor(balance, lead).filter(|l| *l < shortest);
            list.extend(of_motor.chain(found).map(|l| wave(l, Port::Motor)));
        }
        let cuts = cuts(balance, &left);
        // What lasts while the axis moves at one speed is a wave over position as well.
        for wavelength_m in cuts.iter().filter_map(|h| way_of_line(balance, h)) {
            let of_turn = !two && lead_m.is_some() && wavelength_m < shortest;
            list.push(wave(wavelength_m, if of_turn { Port::Motor } else { Port::Stage }));
        }
        list.extend(cuts);
        for flips in [false, true] {
            let shape = Shape::Map { pieces: PIECES[0], flips, over: Over::Position };
            list.push(Hypothesis::named(E::PositionDependentForce, Port::Stage, shape));
        }
    }
    let errors = [
        (Port::MotorEncoder, balance.drive.motor_encoder_signal_m()),
        (Port::StageEncoder, balance.drive.raw().stage_encoder_signal_period_m.filter(|_| two)),
    ];
    for (port, period) in errors {
        if let Some(period_m) = period {
            let shape = Shape::EncoderError { period_m, sine_m: 0.0, cosine_m: 0.0 };
            list.push(Hypothesis::named(E::EncoderInterpolationError, port, shape));
        }
        if two && !balance.clock_moved {
            let shape = Shape::EncoderDelay { extra_s: 0.5 / s.rate_hz };
            list.push(Hypothesis::named(E::DeadTime, port, shape));
        }
    }
    list
}

/// A force that repeats over the way: of the motor a ripple of its torque.
fn wave(wavelength_m: f64, port: Port) -> Hypothesis {
    let effect = if port == Port::Motor { E::TorqueRipple } else { E::PositionPeriodicForce };
    Hypothesis::named(effect, port, Shape::Wave { wavelength_m })
}

/// Way in a period of a line, at the middle one of the speeds that the axis has while it lasts, m.
fn way_of_line(balance: &Balance, h: &Hypothesis) -> Option<f64> {
    let Shape::Cut { hz, start_s, end_s } = h.shape else { return None };
    let step = balance.signals.step;
    let mut speeds = Vec::new();
    for track in &balance.signals.tracks {
        let inside = |j: &usize| (start_s..end_s).contains(&track.thin_s(*j, step));
        speeds.extend((0..track.thin_count()).filter(inside).map(|j| track.thin.velocity[0][j].abs()));
    }
    speeds.sort_by(f64::total_cmp);
    speeds.get(speeds.len() / 2).map(|v| v / hz).filter(|way_m| *way_m > 0.0)
}

/// Wavelengths of the motor's poles and slots, where they are stated.
fn of_motor(balance: &Balance, lead_m: f64) -> impl Iterator<Item = f64> + use<> {
    let raw = balance.drive.raw();
    let poles = raw.motor_pole_count.into_iter().flat_map(|n| [0.5 * n, n]);
    poles.chain(raw.motor_slot_count).map(move |order| lead_m / order)
}

/// What is left, through the weights of its bands, in time.
fn whitened(balance: &Balance, state: &State, left: &super::gram::Column) -> [super::spectra::Series; 2] {
    let base = &state.base;
    let lengths = balance.signals.lengths();
    std::array::from_fn(|side| {
        if side >= balance.signals.sides() {
            return Vec::new();
        }
        let zero = vec![0.0; left.sides[side].as_ref().map_or(0, |s| s.len())];
        let mut out = zero;
        for cell in &balance.plan.cells {
            let Some(k) = base
                .all
                .iter()
                .position(|b| b.recording == cell.recording && (balance.plan.white || b.band == cell.band))
            else {
                continue;
            };
            let w = base.weights[k];
            let row = if side == 0 { [w[0], w[1]] } else { [w[1], w[2]] };
            for (other, factor) in row.iter().enumerate() {
                if let Some(spectrum) = &left.sides[other] {
                    let into = cell.of_mut(&mut out);
                    into.iter_mut().zip(cell.of(spectrum)).for_each(|(o, v)| *o += factor * v);
                }
            }
        }
        balance.plan.series(&out, &lengths)
    })
}

/// Wavelengths at which a whitened residual has its strongest waves over position, strongest first.
fn peaks(balance: &Balance, whitened: &[Vec<f64>], [shortest, longest]: [f64; 2]) -> Vec<f64> {
    let [low, high] = balance.signals.travel_m();
    let spacing = shortest / PLACES;
    let places = (((high - low) / spacing) as usize + 2).min(1 << 21);
    let n = (4 * places).next_power_of_two();
    let mut line = vec![Complex::new(0.0, 0.0); n];
    for (track, x) in balance.signals.tracks.iter().zip(whitened) {
        for (value, position) in x.iter().zip(&track.thin.position) {
            let place = ((position - low) / spacing).clamp(0.0, (places - 2) as f64);
            let (k, part) = (place as usize, place.fract());
            line[k].re += value * (1.0 - part);
            line[k + 1].re += value * part;
        }
    }
    FftPlanner::new().plan_fft_forward(n).process(&mut line);
    let length = n as f64 * spacing;
    let [from, to] = [longest, shortest].map(|l| ((length / l) as usize).clamp(1, n / 2 - 1));
    let power: Vec<f64> = line[..=to].iter().map(|v| v.norm_sqr()).collect();
    let mut tops: Vec<usize> =
        (from.max(2)..to).filter(|k| power[*k] >= power[k - 1] && power[*k] > power[k + 1]).collect();
    tops.sort_by(|a, b| power[*b].total_cmp(&power[*a]));
    // Side lobes of a peak are four zero-padded places wide.
    let mut kept: Vec<usize> = Vec::new();
    for k in tops {
        if kept.iter().all(|o| o.abs_diff(k) > 8) {
            kept.push(k);
        }
        if kept.len() == PEAKS {
            break;
        }
    }
    let refined = |k: usize| {
        let [a, b, c] = [power[k - 1], power[k], power[k + 1]].map(|p| p.max(1e-300).ln());
        let shift = 0.5 * (a - c) / (a - 2.0 * b + c).min(-1e-12);
        length / (k as f64 + shift)
    };
    kept.into_iter().map(refined).collect()
}

/// Lines that stand out of the unwhitened stage balance with their harmonics, for a while.
fn cuts(balance: &Balance, left: &super::gram::Column) -> Vec<Hypothesis> {
    let s = &balance.signals;
    let side = usize::from(s.sides() == 2);
    let Some(spectrum) = &left.sides[side] else { return Vec::new() };
    let bin_hz = balance.plan.bin_hz;
    let series = balance.plan.series(spectrum, &s.lengths());
    let mut best: Vec<(f64, f64, usize)> = Vec::new();
    for r in 0..s.tracks.len() {
        let blocks = balance.plan.powers(spectrum, r);
        let bins = blocks.first().map_or(0, |b| b.1.len());
        if bins < 32 {
            continue;
        }
        let (mut sums, mut alone) = (vec![0.0; bins], vec![0.0; bins]);
        for (_, power) in &blocks {
            let floor = sliding_median(power, 12);
            let ratios: Vec<f64> = power.iter().zip(&floor).map(|(p, f)| p / f.max(1e-300)).collect();
            for k in 3..bins {
                let of = |h: usize| ratios.get(h * k).map_or(0.0, |r| (r - 1.0).clamp(0.0, 200.0));
                sums[k] += (1..=SEARCHED_HARMONICS).map(of).sum::<f64>() / blocks.len() as f64;
                alone[k] += of(1) / blocks.len() as f64;
            }
        }
        let mut order: Vec<usize> = (4..bins - 1).collect();
        order.sort_by(|a, b| sums[*b].total_cmp(&sums[*a]));
        best.extend(order.into_iter().take(2).map(|k| (sums[k], first_line(&alone, k) as f64 * bin_hz, r)));
    }
    best.sort_by(|a, b| b.0.total_cmp(&a.0));
    best.truncate(2);
    best.into_iter().filter_map(|(_, hz, r)| cut_at(balance, &series[r], (hz, r))).collect()
}

/// The first of a line's harmonics that is there itself: what repeats after a period does so after two.
fn first_line(alone: &[f64], k: usize) -> usize {
    /// Over the strongest of them.
    const THERE: f64 = 0.25;
    let of = |h: usize| alone.get(h * k).copied().unwrap_or(0.0);
    let strongest = (1..=SEARCHED_HARMONICS).map(of).fold(0.0, f64::max);
    k * (1..=SEARCHED_HARMONICS).find(|h| of(*h) >= THERE * strongest).unwrap_or(1)
}

/// A series about a frequency: sums of short stretches, over which every fine frequency is quick.
pub(super) struct Demodulated {
    sums: Vec<Complex<f64>>,
    /// Begin of the first, length of each, of all, s.
    first_s: f64,
    each_s: f64,
    total_s: f64,
}

impl Demodulated {
    pub(super) fn new(balance: &Balance, x: &[f64], (hz, recording): (f64, usize)) -> Self {
        let s = &balance.signals;
        let rate_hz = s.thin_rate_hz();
        let first_s = s.tracks[recording].thin_s(0, s.step);
        let length = ((0.1_f64.max(3.0 / hz) * rate_hz) as usize).clamp(4, (x.len() / 4).max(4));
        let turned =
            |(k, v): (usize, &f64)| Complex::from_polar(*v, -TAU * hz * (first_s + k as f64 / rate_hz));
        let all: Vec<Complex<f64>> = x.iter().enumerate().map(turned).collect();
        Self {
            sums: all.chunks(length).map(|c| c.iter().sum()).collect(),
            first_s,
            each_s: length as f64 / rate_hz,
            total_s: x.len() as f64 / rate_hz,
        }
    }

    fn power_at(&self, off_hz: f64) -> f64 {
        let middle = |c: usize| self.first_s + (c as f64 + 0.5) * self.each_s;
        let turned = |(c, v): (usize, &Complex<f64>)| v * Complex::from_polar(1.0, -TAU * off_hz * middle(c));
        self.sums.iter().enumerate().map(turned).sum::<Complex<f64>>().norm_sqr()
    }
}

/// By how much the strongest line of all of these is off, within a reach, Hz.
pub(super) fn strongest_off(all: &[Demodulated], reach_hz: f64) -> f64 {
    let longest_s = all.iter().map(|d| d.total_s).fold(1e-9, f64::max);
    let fine_hz = 0.2 / longest_s;
    let steps = (reach_hz / fine_hz) as i32;
    let power = |off_hz: f64| all.iter().map(|d| d.power_at(off_hz)).sum::<f64>();
    (-steps..=steps)
        .map(|k| f64::from(k) * fine_hz)
        .map(|off_hz| (off_hz, power(off_hz)))
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map_or(0.0, |best| best.0)
}

/// The line near `hz` in one recording, where its envelope is above half of its plateau.
fn cut_at(balance: &Balance, x: &[f64], (hz, recording): (f64, usize)) -> Option<Hypothesis> {
    let line = Demodulated::new(balance, x, (hz, recording));
    let reach = balance.plan.bin_hz.min(0.45 / line.each_s);
    let off = strongest_off(std::slice::from_ref(&line), reach);
    let sizes: Vec<f64> = line.sums.iter().map(|v| v.norm()).collect();
    let mut sorted = sizes.clone();
    sorted.sort_by(f64::total_cmp);
    let plateau = sorted[sorted.len() * 9 / 10];
    let above: Vec<bool> = sizes.iter().map(|v| *v > 0.5 * plateau).collect();
    let (from, to) = longest_run(&above)?;
    let edge = |c: usize| line.first_s + c as f64 * line.each_s;
    let shape = Shape::Cut { hz: hz + off, start_s: edge(from), end_s: edge(to) };
    Some(Hypothesis::named(E::CuttingForce, Port::Stage, shape))
}

/// Begin and end of the longest stretch of true, single gaps bridged.
fn longest_run(flags: &[bool]) -> Option<(usize, usize)> {
    let bridged: Vec<bool> = (0..flags.len())
        .map(|k| flags[k] || (k > 0 && k + 1 < flags.len() && flags[k - 1] && flags[k + 1]))
        .collect();
    let (mut best, mut from) = ((0, 0), None);
    for (k, flag) in bridged.iter().chain([&false]).enumerate() {
        match (flag, from) {
            (true, None) => from = Some(k),
            (false, Some(f)) => {
                if k - f > best.1 - best.0 {
                    best = (f, k);
                }
                from = None;
            }
            _ => {}
        }
    }
    (best.1 > best.0).then_some(best)
}
