//! The line of a stretch that swells or fades, filtered in time.
//!
//! Near its root p a cut is one mode, driven by the random force through its residue:
//!
//! Z(s) = v u'/(s - p) + rest,   F = v a + rest n + sensor,   a' = p a + u' n
//!
//! The forces are taken down from the line in blocks of a quarter of a turn, through a window of Hann whose
//! noise is white from block to block; it passes half of the fourth of the neighbouring lines, all of which
//! are modes beside it. A Kalman filter foretells each block from those before it: -ln L is the sum over its
//! innovations, whether they swell or fade; growth, frequency and the ratio of both tools' forces are in it.
//! Of the innovations of all forces (`followed`) this part is lost where the bar amplifies the
//! sensor's noise; here that noise enters as what it is, noise of the sensor.

use super::criteria::CRITERIA;
use super::force_signal::signal_response;
use super::input::CutRecording;
use super::known::Reference;
use super::machine::Machine;
use super::matrix::{CHANNELS, ZERO};
use super::observable::{Bin, Every, LineBeside, Observable, Origin, OriginKind, Part};
use super::spectra::Place;
use super::stretches::{Stretch, condition};
use crate::plant::cut_loop::CutLoop;
use crate::plant::scenario::ToolCount;
use crate::stability::{Root, cut_root_near, rightmost_cut_root};
use nalgebra::{Complex, Matrix2, RowVector2, Vector2};
use rustfft::FftPlanner;
use std::f64::consts::{PI, TAU};

/// Places in a block at which what the random force adds is summed.
const NODES: usize = 16;

/// The line of one stretch.
pub(crate) struct SwellingLine {
    place: Place,
    line_hz: f64,
    /// Where its root and those of its neighbours are looked for.
    guesses: Vec<Root>,
    /// By how much the root moves as the tools travel, 1/s and Hz a second.
    travelling: Root,
    /// When, from the middle of the stretch on, s; amplitudes of both forces, without the signal's filter.
    blocks: Vec<(f64, Vector2<Complex<f64>>)>,
    block_s: f64,
    /// The signal's low-pass as stated at the line.
    stated: Complex<f64>,
}

/// Loudest line of forces in a band, Hz, by zero padding to an eighth of a bin.
fn loudest_line(forces: &[&[f64]], rate_hz: f64, band_hz: [f64; 2]) -> f64 {
    let n = forces[0].len();
    let padded = (8 * n).next_power_of_two();
    let transform = FftPlanner::new().plan_fft_forward(padded);
    let mut power = vec![0.0; padded / 2];
    for force in forces {
        let mean = force.iter().sum::<f64>() / n as f64;
        let hann = |k: usize| 0.5 - 0.5 * (TAU * (k as f64 + 0.5) / n as f64).cos();
        let mut x: Vec<Complex<f64>> =
            force.iter().enumerate().map(|(k, v)| Complex::new((v - mean) * hann(k), 0.0)).collect();
        x.resize(padded, ZERO);
        transform.process(&mut x);
        power.iter_mut().zip(&x).for_each(|(p, x)| *p += x.norm_sqr());
    }
    let at = |k: usize| k as f64 * rate_hz / padded as f64;
    let inside = |k: &usize| (band_hz[0]..band_hz[1]).contains(&at(*k));
    (0..padded / 2).filter(inside).max_by(|a, b| power[*a].total_cmp(&power[*b])).map_or(0.0, at)
}

/// What a window of Hann of weight one and length L passes of exp(p t) about its middle; `through`: p L.
fn passed(through: Complex<f64>) -> Complex<f64> {
    let bare = |x: Complex<f64>| if x.norm() > 0.0 { x.sinh() / x } else { 1.0.into() };
    let [x, bin] = [through * 0.5, Complex::new(0.0, PI)];
    bare(x) + 0.5 * (bare(x + bin) + bare(x - bin))
}

/// Amplitudes of forces in blocks of `length` samples at a line of `line` periods a sample, the last one at
/// the end; each with its middle, samples from that of all. Without their mean: a block is a few periods.
fn blocks(forces: &[&[f64]], line: f64, length: usize) -> Vec<(f64, Vector2<Complex<f64>>)> {
    let n = forces[0].len();
    let mean = |force: &[f64]| force.iter().sum::<f64>() / n as f64;
    let hann = |k: usize| (1.0 - (TAU * (k as f64 + 0.5) / length as f64).cos()) / length as f64;
    let weights: Vec<f64> = (0..length).map(|k| 2.0 * hann(k)).collect();
    let taken = |force: &[f64], mean: f64, from: usize| -> Complex<f64> {
        let of = |(k, w): (usize, &f64)| {
            Complex::from_polar(w * (force[from + k] - mean), -TAU * (line * (from + k) as f64).fract())
        };
        weights.iter().enumerate().map(of).sum()
    };
    let block = |from: usize| {
        let mut both = Vector2::zeros();
        let means = forces.iter().map(|force| (force, mean(force)));
        means.zip(both.iter_mut()).for_each(|((force, mean), x)| *x = taken(force, mean, from));
        (from as f64 + (length as f64 - n as f64) / 2.0, both)
    };
    (n % length..n).step_by(length).map(block).collect()
}

impl SwellingLine {
    /// `None`: a force is not there, or the stretch is shorter than a turn.
    pub(crate) fn new(recording: &CutRecording, stretch: &Stretch, known: &Reference) -> Option<Self> {
        let range = stretch.samples.clone();
        let rate = recording.sample_rate.hz();
        let middle = usize::midpoint(range.start, range.end);
        let mut place = Place::new(recording, stretch, middle, known);
        place.used.retain(|j| *j < 2);
        place.origin.kind = OriginKind::Followed;
        let forces: Vec<&[f64]> = place
            .used
            .iter()
            .filter_map(|j| recording.forces_n[*j].as_ref().map(|f| &f[range.clone()]))
            .collect();
        let length = (0.25 * place.condition.turn_s() * rate).round() as usize;
        let two = known.machine.scenario.tools.count() == ToolCount::Two;
        if forces.len() != usize::from(two) + 1 || range.len() < 4 * length {
            return None;
        }
        let line_hz = loudest_line(&forces, rate, place.band_hz);
        let path = signal_response(place.filter.as_ref(), recording.signal.delay_s, line_hz);
        let mut blocks = blocks(&forces, line_hz / rate, length);
        for (at, both) in &mut blocks {
            *at /= rate;
            *both /= path;
        }
        let [begin, end] = [&blocks[..blocks.len() / 2], &blocks[blocks.len() / 2..]]
            .map(|half| half.iter().map(|b| b.1.norm_squared()).sum::<f64>() / half.len() as f64);
        let seconds = range.len() as f64 / rate;
        let line = Root { growth_1_s: (end / begin.max(1e-12)).ln() / seconds, frequency_hz: line_hz };
        let root = |at: usize| {
            let at = condition(recording, at, &known.machine.scenario);
            cut_root_near(&CutLoop::new(&known.machine.terms(&at)), line).unwrap_or(line)
        };
        let (first, last) = (root(range.start), root(range.end - 1));
        let travelling = Root {
            growth_1_s: (last.growth_1_s - first.growth_1_s) / seconds,
            frequency_hz: (last.frequency_hz - first.frequency_hz) / seconds,
        };
        let stated = signal_response(place.filter.as_ref(), 0.0, line_hz);
        let block_s = length as f64 / rate;
        let mut out = Self { place, line_hz, guesses: vec![line], travelling, blocks, block_s, stated };
        out.add_neighbours(&known.machine, root(middle));
        Some(out)
    }

    /// The neighbours of a line of a machine as further guesses.
    fn add_neighbours(&mut self, machine: &Machine, line: Root) {
        let cut = CutLoop::new(&machine.terms(&self.place.condition));
        let [from, to] = self.band_hz();
        let mut known = vec![line];
        for orders in [-1.0, 1.0, -2.0, 2.0, -3.0, 3.0, -4.0, 4.0] {
            let frequency_hz = self.line_hz + orders / self.place.condition.turn_s();
            let Some(root) = cut_root_near(&cut, Root { growth_1_s: 0.0, frequency_hz }) else { continue };
            let inside = (from..to).contains(&root.frequency_hz);
            if inside && known.iter().all(|k| apart(k, &root)) {
                known.push(root);
            }
        }
        self.guesses.extend(&known[1..]);
    }

    /// The band that the blocks take, Hz: from null to null of their window.
    pub(crate) fn band_hz(&self) -> [f64; 2] {
        [-2.0, 2.0].map(|nulls| self.line_hz + nulls / self.block_s)
    }
}

/// The root of amplitudes that go on from block to block by one factor, and the standard deviation of its
/// growth: least squares, x' = factor x. `None`: fewer than three blocks, or nothing in them.
fn measured_root(
    blocks: &[(f64, Vector2<Complex<f64>>)],
    tools: usize,
    (block_s, line_hz): (f64, f64),
) -> Option<(Root, f64)> {
    let pairs = || blocks.windows(2).map(|w| (w[0].1, w[1].1));
    let power: f64 = pairs().map(|(x, _)| x.norm_squared()).sum();
    let factor = pairs().map(|(x, next)| x.dotc(&next)).sum::<Complex<f64>>() / power;
    let left: f64 = pairs().map(|(x, next)| (next - x * factor).norm_squared()).sum();
    let free = (tools * blocks.len().checked_sub(2).filter(|n| *n > 0)?) as f64;
    // Of either part of the factor, over its size.
    let deviation = (left / free / (2.0 * power)).sqrt() / factor.norm();
    let growth_1_s = factor.norm().ln() / block_s;
    let root = Root { growth_1_s, frequency_hz: line_hz + factor.arg() / (TAU * block_s) };
    (growth_1_s.is_finite() && deviation.is_finite()).then_some((root, deviation / block_s))
}

/// Column vector of a matrix of the tools.
fn column(z: &[[Complex<f64>; 2]; 2], j: usize) -> Vector2<Complex<f64>> {
    Vector2::new(z[0][j], z[1][j])
}

/// One mode of a cut: its root, its shape in the forces, and what each tool's random force drives of it.
struct Mode {
    root: Complex<f64>,
    shape: Vector2<Complex<f64>>,
    driven: [Complex<f64>; 2],
}

impl Mode {
    /// By the residue, half of the difference across the root: what is even there is no part of it.
    fn at(cut: &CutLoop, root: Root) -> Self {
        let root = Complex::new(root.growth_1_s, TAU * root.frequency_hz);
        let [after, before] = [0.5, -0.5].map(|d| cut.closed(root + d));
        let residues = [0, 1].map(|j| (column(&after, j) - column(&before, j)) * Complex::new(0.25, 0.0));
        let loudest = if residues[0].norm_squared() >= residues[1].norm_squared() { 0 } else { 1 };
        let shape = residues[loudest].normalize();
        Self { root, shape, driven: residues.map(|r| shape.dotc(&r)) }
    }
}

impl SwellingLine {
    /// The modes of a cut in the band of the blocks.
    fn modes(&self, cut: &CutLoop) -> Vec<Mode> {
        let mut roots: Vec<Root> = Vec::with_capacity(self.guesses.len());
        for guess in &self.guesses {
            let Some(root) = cut_root_near(cut, *guess) else { continue };
            // Two that have become one are one.
            if roots.iter().all(|r| apart(r, &root)) {
                roots.push(root);
            }
        }
        roots.into_iter().map(|root| Mode::at(cut, root)).collect()
    }

    /// What else than its modes the random force of each tool makes at a frequency.
    fn beside(cut: &CutLoop, modes: &[Mode], frequency_hz: f64) -> [Vector2<Complex<f64>>; 2] {
        let s = Complex::new(0.0, TAU * frequency_hz);
        let z = cut.closed(s);
        [0, 1].map(|j| {
            let of_modes = modes.iter().map(|m| m.shape * (m.driven[j] / (s - m.root)));
            of_modes.fold(column(&z, j), |own, mode| own - mode)
        })
    }
}

/// What the random force within a block adds, from its begin on: to the modes at its end, to the block
/// itself, and to both.
struct Added {
    /// Row by row.
    modes: Vec<Complex<f64>>,
    block: Matrix2<Complex<f64>>,
    /// Of each mode.
    both: Vec<Row>,
}

/// One mode beside both forces.
type Row = RowVector2<Complex<f64>>;

impl Added {
    /// By sums over a block. `over`: growth of each mode over it; `beside`: what each tool's force makes at
    /// once, without modes; `density`: of the forces, two-sided.
    fn of(
        modes: &[Mode],
        over: &[Complex<f64>],
        block_s: f64,
        beside: &[Vector2<Complex<f64>>; 2],
        density: [f64; 2],
    ) -> Self {
        let n = modes.len();
        let mut out = Self { modes: vec![ZERO; n * n], block: Matrix2::zeros(), both: vec![Row::zeros(); n] };
        // The window takes of a mode what follows a push, to the end: summed from there.
        let mut follows = vec![ZERO; n];
        for node in (0..NODES).rev() {
            let at = (node as f64 + 0.5) / NODES as f64;
            let share = (1.0 - (TAU * at).cos()) / NODES as f64;
            let taken: Vec<Complex<f64>> = follows.iter().map(|f| f + 0.5 * share).collect();
            for (follows, over) in follows.iter_mut().zip(over) {
                *follows = (*follows + share) * (over / NODES as f64).exp();
            }
            let remains: Vec<Complex<f64>> = over.iter().map(|over| (over * (1.0 - at)).exp()).collect();
            for j in 0..2 {
                let width = Complex::new(density[j] * block_s / NODES as f64, 0.0);
                let through = modes.iter().zip(&taken).map(|(m, taken)| m.shape * (m.driven[j] * taken));
                let through: Vector2<Complex<f64>> = through.sum();
                // Beside the modes a push shows at once.
                let at_once = beside[j] * Complex::new(share * NODES as f64 / block_s, 0.0);
                let all = through + at_once;
                out.block += all * all.adjoint() * width;
                for a in 0..n {
                    let left = modes[a].driven[j] * remains[a] * width;
                    out.both[a] += all.adjoint() * left;
                    for b in 0..n {
                        out.modes[a * n + b] += left * (modes[b].driven[j] * remains[b]).conj();
                    }
                }
            }
        }
        out
    }
}

impl Observable for SwellingLine {
    fn part(&self, machine: &Machine, every: Every) -> Part {
        let cut = CutLoop::new(&machine.terms(&self.place.condition));
        let modes = self.modes(&cut);
        let random = self.place.random(machine, &cut);
        let channels = self.place.used.len();
        let ratio = self
            .place
            .lag(machine)
            .map_or(Complex::new(1.0, 0.0), |lag| Place::signal_ratio(&lag, self.line_hz, self.stated));
        let n = modes.len();
        // From the begin of a block to its end.
        let over: Vec<Complex<f64>> =
            modes.iter().map(|m| (m.root - Complex::new(0.0, TAU * self.line_hz)) * self.block_s).collect();
        let shape = |(m, over): (&Mode, &Complex<f64>)| m.shape * (passed(*over) * (over * 0.5).exp());
        let shapes: Vec<Vector2<Complex<f64>>> = modes.iter().zip(&over).map(shape).collect();
        let density = random.map(|r| 2.0 * r * machine.random_1_hz(self.line_hz));
        let beside = Self::beside(&cut, &modes, self.line_hz);
        let added = Added::of(&modes, &over, self.block_s, &beside, density);
        // A window of Hann is as wide as 1.5 bins; one-sided spectra, complex amplitudes.
        let width_hz = 2.0 * 1.5 / self.block_s;
        let [one, two, _] = self.place.noise(machine, random, (self.line_hz, self.stated * ratio));
        let sensor = Vector2::new(one, two).map(|s| Complex::new(width_hz * s, 0.0));
        let mut rest = added.block + Matrix2::from_diagonal(&sensor);
        if channels == 1 {
            // The other tool is not there: what stands for it says nothing.
            rest = Matrix2::from_diagonal(&rest.diagonal());
        }
        // Where it begins nothing is known but how loud it is.
        let begin = &self.blocks[..2];
        let loud = begin.iter().map(|b| b.1.norm_squared()).sum::<f64>() / begin.len() as f64;
        let mut mean = vec![ZERO; n];
        let mut covariance = vec![ZERO; n * n];
        (0..n).for_each(|m| covariance[m * (n + 1)] = loud.into());
        let mut bins = Vec::with_capacity(self.blocks.len());
        let mut seen: Vec<Row> = vec![Row::zeros(); n];
        for (t_s, x) in &self.blocks {
            let x = x / ratio;
            let own = CRITERIA.followed_share.powi(2) * x.norm_squared();
            let mut spread = rest + Matrix2::from_diagonal_element(Complex::new(own, 0.0));
            let mut error = x;
            for m in 0..n {
                let row = &covariance[m * n..(m + 1) * n];
                seen[m] = row.iter().zip(&shapes).fold(Row::zeros(), |sum, (p, v)| sum + v.adjoint() * *p);
                spread += shapes[m] * seen[m];
                error -= shapes[m] * mean[m];
            }
            spread = (spread + spread.adjoint()) * Complex::new(0.5, 0.0);
            bins.push(self.bin(&(error * ratio), &(spread * Complex::new(ratio.norm_sqr(), 0.0))));
            // The roots move as the tools travel.
            let moved = Complex::new(self.travelling.growth_1_s, TAU * self.travelling.frequency_hz)
                * *t_s
                * self.block_s;
            let on: Vec<Complex<f64>> = over.iter().map(|over| (over + moved).exp()).collect();
            let inverse = spread.try_inverse().unwrap_or_else(Matrix2::zeros);
            let both: Vec<Row> = (0..n).map(|m| seen[m] * on[m] + added.both[m]).collect();
            let gain: Vec<Row> = both.iter().map(|both| both * inverse).collect();
            for a in 0..n {
                mean[a] = mean[a] * on[a] + (gain[a] * error)[0];
                for b in 0..=a {
                    let led = covariance[a * n + b] * on[a] * on[b].conj() + added.modes[a * n + b];
                    let left = led - (gain[a] * both[b].adjoint())[0];
                    covariance[a * n + b] = left;
                    covariance[b * n + a] = left.conj();
                }
                // Hermitian, whatever rounding leaves.
                covariance[a * n + a].im = 0.0;
            }
        }
        Part::Bins { channels, bins: bins.into_iter().step_by(every.0).collect() }
    }

    fn line(&self, machine: &Machine) -> Option<LineBeside> {
        let block = (self.block_s, self.line_hz);
        let (measured, deviation_1_s) = measured_root(&self.blocks, self.place.used.len(), block)?;
        let foretold = rightmost_cut_root(&CutLoop::new(&machine.terms(&self.place.condition)));
        Some(LineBeside { measured, deviation_1_s, foretold })
    }

    fn origin(&self) -> Origin {
        self.place.origin
    }
}

impl SwellingLine {
    fn bin(&self, error: &Vector2<Complex<f64>>, spread: &Matrix2<Complex<f64>>) -> Bin {
        let (mut x, mut s) = ([ZERO; CHANNELS], [[ZERO; CHANNELS]; CHANNELS]);
        for a in 0..self.place.used.len() {
            x[a] = error[a];
            for b in 0..self.place.used.len() {
                s[a][b] = spread[(a, b)];
            }
        }
        Bin { x, frequency_hz: self.line_hz, log_jacobian: 0.0, s }
    }
}

/// True for roots that are not the same one, found twice.
fn apart(a: &Root, b: &Root) -> bool {
    (a.growth_1_s - b.growth_1_s).hypot(TAU * (a.frequency_hz - b.frequency_hz)) > 1.0
}

#[cfg(test)]
mod tests {
    use super::super::fit::part_value;
    use super::super::synthetic::{machine, recording};
    use super::*;
    use crate::plant::cut_terms::CutCondition;

    /// The window passes all of what stands still, half of what is one bin off, nothing two bins off.
    #[test]
    fn a_window_passes_its_own_line() {
        let off = |bins: f64| passed(Complex::new(0.0, TAU * bins));
        for (bins, share) in [(0.0, 1.0), (1.0, 0.5), (-1.0, 0.5), (2.0, 0.0)] {
            assert!((off(bins) - share).norm() < 1e-12, "{bins}: {}", off(bins));
        }
    }

    /// Forces that swell at the root of the cut and in its own ratio are foretold; those that swell by 10 1/s
    /// less, or 1 Hz beside it, are not. Measured is what they do, whatever the machine.
    #[test]
    fn a_line_is_foretold_by_its_own_root_alone() {
        let machine = machine();
        let at = CutCondition::of(&machine.scenario);
        let cut = CutLoop::new(&machine.terms(&at));
        let root = rightmost_cut_root(&cut);
        let value = |slower_1_s: f64, higher_hz: f64| {
            let s = Complex::new(root.growth_1_s, TAU * root.frequency_hz);
            let m = cut.force_per_force(s);
            let ratio = -(m[0][0] + 1.0) / m[0][1];
            let moved = s + Complex::new(-slower_1_s, TAU * higher_hz);
            let force = |t: f64| {
                let swell = (moved * (t - 0.8)).exp() * 20.0;
                [50.0 + swell.re, 50.0 + (swell * ratio).re]
            };
            let cuts = recording(&machine.scenario, 0.9, force);
            let stretch = Stretch { recording: 0, samples: 5000..7200 };
            let line = SwellingLine::new(&cuts, &stretch, &Reference::of(machine)).expect("a line");
            let seen = line.line(&machine).expect("growth");
            assert!(
                (seen.foretold.growth_1_s - seen.measured.growth_1_s - slower_1_s).abs() < 1.0,
                "{seen:?}"
            );
            assert!(
                (seen.measured.frequency_hz - seen.foretold.frequency_hz - higher_hz).abs() < 0.2,
                "{seen:?}"
            );
            part_value(&line.part(&machine, Every(1)))
        };
        let own = value(0.0, 0.0);
        assert!(value(10.0, 0.0) > own + 4.5, "{own} {}", value(10.0, 0.0));
        assert!(value(0.0, 1.0) > own + 4.5, "{own} {}", value(0.0, 1.0));
    }
}
