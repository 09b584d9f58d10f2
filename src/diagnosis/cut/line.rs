//! The line of a stretch that swells or fades, filtered in time.
//!
//! Near its root p a cut is one mode, driven by the random force through its residue:
//!
//! Z(s) = v u'/(s - p) + rest,   F = v a + rest n + sensor,   a' = p a + u' n
//!
//! The forces are taken down from the line in blocks of half a turn, through a window of Hann whose noise is
//! white from block to block; where the neighbouring lines lie, it passes half, and they count as noise. A
//! Kalman filter foretells each block from those before it: -ln L is the sum over its innovations, exact for
//! one mode, whether it swells or fades, and growth, frequency and the ratio of both tools' forces are in it.
//! Of the innovations of all forces ([`super::followed`]) this part is lost where the bar amplifies the
//! sensor's noise; here that noise enters as what it is, noise of the sensor.

use super::criteria::CRITERIA;
use super::input::CutRecording;
use super::known::Reference;
use super::machine::Machine;
use super::observable::{Bin, CHANNELS, Every, Observable, Origin, OriginKind, Part, ZERO};
use super::spectra::Place;
use super::stretches::{Stretch, condition, signal_response};
use crate::plant::cut_loop::CutLoop;
use crate::plant::scenario::ToolCount;
use crate::stability::{Root, cut_root_near};
use nalgebra::{Complex, DMatrix, DVector, Matrix2, Vector2};
use rustfft::FftPlanner;
use std::f64::consts::{PI, TAU};

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

/// |W|^2 of a window of Hann of weight one, so many bins (1/length) off.
fn passed(bins: f64) -> f64 {
    let sinc = |x: f64| if x.abs() > 0.0 { (PI * x).sin() / (PI * x) } else { 1.0 };
    (sinc(bins) + 0.5 * (sinc(bins - 1.0) + sinc(bins + 1.0))).powi(2)
}

/// Amplitudes of forces in blocks of `length` samples at a line of `line` periods a sample, the last one at
/// the end; each with its middle, samples from that of all.
fn blocks(forces: &[&[f64]], line: f64, length: usize) -> Vec<(f64, Vector2<Complex<f64>>)> {
    let n = forces[0].len();
    let hann = |k: usize| (1.0 - (TAU * (k as f64 + 0.5) / length as f64).cos()) / length as f64;
    let weights: Vec<f64> = (0..length).map(|k| 2.0 * hann(k)).collect();
    let taken = |force: &[f64], from: usize| -> Complex<f64> {
        let of = |(k, w): (usize, &f64)| {
            Complex::from_polar(w * force[from + k], -TAU * (line * (from + k) as f64).fract())
        };
        weights.iter().enumerate().map(of).sum()
    };
    let block = |from: usize| {
        let mut both = Vector2::zeros();
        forces.iter().zip(both.iter_mut()).for_each(|(force, x)| *x = taken(force, from));
        (from as f64 + (length as f64 - n as f64) / 2.0, both)
    };
    (n % length..n).step_by(length).map(block).collect()
}

impl SwellingLine {
    /// `None`: a force is not there, or the stretch is shorter than two turns.
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
        let length = (0.5 * place.condition.turn_s() * rate).round() as usize;
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
        for orders in [-1.0, 1.0, -2.0, 2.0] {
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

    /// Covariance of what else than its modes is in a block.
    fn rest(
        &self,
        machine: &Machine,
        cut: &CutLoop,
        modes: &[Mode],
        random: [f64; 2],
    ) -> Matrix2<Complex<f64>> {
        let step_hz = 0.5 / self.block_s;
        let mut rest = Matrix2::zeros();
        // Three nulls either way: beyond, the window passes a thousandth.
        for m in -6..=6 {
            let f = self.line_hz + f64::from(m) * step_hz;
            let s = Complex::new(0.0, TAU * f);
            let z = cut.closed(s);
            let weight = 2.0 * step_hz * passed(0.5 * f64::from(m));
            let ([sensor, behind], folded) =
                (self.place.sensor_n2_hz(machine, f), self.place.folded_1_hz(machine, f));
            for j in 0..2 {
                let of_modes = modes.iter().map(|m| m.shape * (m.driven[j] / (s - m.root)));
                let own = of_modes.fold(column(&z, j), |own, mode| own - mode);
                rest += own * own.adjoint() * Complex::new(weight * random[j] * machine.random_1_hz(f), 0.0);
                rest[(j, j)] += weight * (sensor + behind / self.stated.norm_sqr() + random[j] * folded);
            }
        }
        rest
    }
}

impl Observable for SwellingLine {
    fn part(&self, machine: &Machine, every: Every) -> Part {
        let cut = CutLoop::new(&machine.terms(&self.place.condition));
        let modes = self.modes(&cut);
        let random = self.place.random(machine, &cut);
        let mut rest = self.rest(machine, &cut, &modes, random);
        let channels = self.place.used.len();
        if channels == 1 {
            // The other tool is not there: what stands for it says nothing.
            rest = Matrix2::from_diagonal(&rest.diagonal());
        }
        let ratio = self
            .place
            .lag(machine)
            .map_or(Complex::new(1.0, 0.0), |lag| Place::signal_ratio(&lag, self.line_hz, self.stated));
        let n = modes.len();
        let shapes = DMatrix::from_fn(2, n, |j, m| modes[m].shape[j] * ratio);
        let density = random.map(|r| 2.0 * r * machine.random_1_hz(self.line_hz));
        let driven = |a: usize, b: usize| -> Complex<f64> {
            (0..2).map(|j| modes[a].driven[j] * modes[b].driven[j].conj() * density[j]).sum()
        };
        // On to the next block, by the roots and by what the random force adds meanwhile.
        let off: Vec<Complex<f64>> =
            modes.iter().map(|m| (m.root - Complex::new(0.0, TAU * self.line_hz)) * self.block_s).collect();
        let gathered = DMatrix::from_fn(n, n, |a, b| {
            let both = off[a] + off[b].conj();
            let over = if both.norm() > 1e-6 { (both.exp() - 1.0) / both } else { 1.0.into() };
            driven(a, b) * over * self.block_s
        });
        let largest = self.blocks.iter().map(|b| b.1.norm_squared()).fold(0.0, f64::max);
        let mut mean = DVector::from_element(n, ZERO);
        let mut covariance = DMatrix::from_diagonal_element(n, n, Complex::new(largest, 0.0));
        let mut bins = Vec::with_capacity(self.blocks.len());
        for (t_s, x) in &self.blocks {
            let own = CRITERIA.followed_share.powi(2) * x.norm_squared();
            let noise = rest + Matrix2::from_diagonal_element(Complex::new(own, 0.0));
            let spread = &shapes * &covariance * shapes.adjoint() + noise;
            let error = x - &shapes * &mean;
            bins.push(self.bin(&error, &spread));
            let Some(inverse) = spread.try_inverse() else { continue };
            let gain = &covariance * shapes.adjoint() * inverse;
            mean += &gain * error;
            // Joseph's form: no rounding makes it negative.
            let left = DMatrix::identity(n, n) - &gain * &shapes;
            covariance = &left * covariance * left.adjoint() + &gain * noise * gain.adjoint();
            // The roots move as the tools travel.
            let moved = Complex::new(self.travelling.growth_1_s, TAU * self.travelling.frequency_hz)
                * (t_s + 0.5 * self.block_s)
                * self.block_s;
            let on: Vec<Complex<f64>> = off.iter().map(|off| (off + moved).exp()).collect();
            mean.iter_mut().zip(&on).for_each(|(a, on)| *a *= on);
            covariance =
                DMatrix::from_fn(n, n, |a, b| covariance[(a, b)] * on[a] * on[b].conj() + gathered[(a, b)]);
        }
        Part::Bins { channels, bins: bins.into_iter().step_by(every.0).collect() }
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
    use crate::stability::rightmost_cut_root;

    /// Forces that swell at the root of the cut and in its own ratio are foretold; those that swell by 10 1/s
    /// less, or 1 Hz beside it, are not.
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
            part_value(&line.part(&machine, Every(1)))
        };
        let own = value(0.0, 0.0);
        assert!(value(10.0, 0.0) > own + 4.5, "{own} {}", value(10.0, 0.0));
        assert!(value(0.0, 1.0) > own + 4.5, "{own} {}", value(0.0, 1.0));
    }
}
