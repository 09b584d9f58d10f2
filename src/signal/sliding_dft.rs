//! Sliding DFT of a band of bins over a long window, without drift.
//!
//! The recursion of the thesis (6-12) adds the new sample and takes the old one off at every step. Its
//! pole lies on the unit circle: rounding stays for ever and grows in proportion to time. Here:
//!
//! ```text
//!   restart            restart            restart
//!  |--------- N ------|---- fresh --->           a block enters and leaves with a phase that starts
//!          |<-------- sums -------->|            anew with each window
//! ```
//! Two sums a bin: one slides; the other starts at zero every eighth window and takes the place of the
//! sliding one when it holds a whole one. Rounding lives for nine windows, not for ever.
//!
//! Over a block of B samples the spectrum is so smooth that R frequencies of the band tell all of its bins:
//! a block is transformed at R Chebyshev nodes and interpolated from there, R chosen so that the error lies
//! below rounding (`nodes`). What changes is the block that comes less the one that goes: 2 R/B multiply-adds
//! per bin, axis and sample, 6/B to turn them, an eighth more for the fresh sums, for all axes together; R is
//! 6 of B = 25 for 200 Hz at 20 kHz in single precision. What is kept of a block are its values at the nodes.
//! The spectrum is there after each block. [`EverySample`] gives it after each sample, at several times the
//! cost. Which bins mean what is not known here.

use super::dispatch::{Fast, run};
pub use super::sliding_dft_kernel::Real;
use super::sliding_dft_kernel::{Advance, BlockProduct, TILE, Turn};
use crate::units::SampleRate;
use nalgebra::Complex;
use std::f64::consts::TAU;
use thiserror::Error;

/// What a sliding DFT is to compute.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SlidingDftSettings {
    /// Rate of the samples.
    pub sample_rate: SampleRate,
    /// N: length of the window.
    pub window_samples: usize,
    /// Lowest bin.
    pub first_bin_hz: f64,
    /// From one bin to the next.
    pub bin_step_hz: f64,
    /// Number of bins.
    pub bins: usize,
    /// Number of axes fed side by side.
    pub axes: usize,
}

/// Why there can be no such sliding DFT.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum SlidingDftError {
    /// Nothing to compute.
    #[error("{bins} bins on {axes} axes over {window_samples} samples: none may be zero")]
    Empty {
        /// Bins asked for.
        bins: usize,
        /// Axes asked for.
        axes: usize,
        /// Window asked for.
        window_samples: usize,
    },
    /// A bin above half the sample rate or below zero, or a step that is not finite.
    #[error("bins from {first_hz} to {last_hz} Hz do not lie between 0 and {nyquist_hz} Hz")]
    OutsideNyquist {
        /// Lowest bin.
        first_hz: f64,
        /// Highest bin.
        last_hz: f64,
        /// Half the sample rate.
        nyquist_hz: f64,
    },
    /// The window is shorter than one period.
    #[error(
        "window of {window_samples} samples is shorter than a period of {first_hz} Hz at {sample_rate_hz} Hz"
    )]
    WindowTooShort {
        /// Window asked for.
        window_samples: usize,
        /// Lowest bin above zero.
        first_hz: f64,
        /// Rate.
        sample_rate_hz: f64,
    },
}

/// Windows from one fresh sum to the next.
const FRESH_EVERY: usize = 8;
/// Samples a block at most: the age of a spectrum.
const LARGEST_BLOCK: usize = 25;

/// The immutable part: table, rotor step, phase of a whole window.
#[derive(Debug, Clone, PartialEq)]
pub struct SlidingDft<T: Real> {
    settings: SlidingDftSettings,
    block: usize,
    blocks_per_window: usize,
    /// Bins rounded up so that two of them fill whole tiles.
    padded_bins: usize,
    /// R: nodes at which a block is transformed.
    nodes: usize,
    /// `[block][re.., im..]`: e^{-j w (n - c)} of the nodes for n in one block, c its middle.
    node_table: Vec<T>,
    /// `[node][bin]`: Lagrange weights.
    table: Vec<T>,
    /// `[re.., im..]`: e^{-j w B}.
    rotor_step: Vec<f64>,
    /// `[re.., im..]`: e^{-j w c}.
    rotor_start: Vec<f64>,
    /// `[re.., im..]`: e^{-j w N}, by which the new prefix stands later than the old; 1 for bins at whole
    /// multiples of rate/N.
    window_phase: Vec<T>,
    /// Every bin is a whole multiple of rate/N.
    whole_bins: bool,
    fast: Fast,
}

/// The moving part: the sums, the blocks of the window at the nodes, the samples of the block.
#[derive(Debug, Clone, PartialEq)]
pub struct SlidingDftState<T: Real> {
    samples: Vec<T>,
    in_block: usize,
    /// Blocks since the restart.
    block_in_window: usize,
    /// Whole windows since the start, up to one.
    window_full: bool,
    /// Windows since the sums were fresh.
    windows: usize,
    /// `[axis][re.., im..]` of the block at the nodes.
    at_nodes: Vec<T>,
    /// `[block][node][axis][re, im]`: the blocks of the window.
    blocks: Vec<T>,
    /// The block that comes less the one that goes.
    change: Vec<T>,
    /// `[axis][re.., im..]` of a block.
    spectrum: Vec<T>,
    rotor: Vec<f64>,
    rotor_values: Vec<T>,
    fresh: Vec<T>,
    /// `[axis][re.., im..]`: the spectrum, bins rotating with the window's restarts.
    sums: Vec<T>,
}

impl<T: Real> SlidingDft<T> {
    /// Errors: no bins, no axes, bins outside 0..rate/2, a window shorter than a period of the lowest bin.
    pub fn new(settings: SlidingDftSettings) -> Result<Self, SlidingDftError> {
        let SlidingDftSettings { sample_rate, window_samples, first_bin_hz, bin_step_hz, bins, axes } =
            settings;
        if bins == 0 || axes == 0 || window_samples == 0 {
            return Err(SlidingDftError::Empty { bins, axes, window_samples });
        }
        let last_hz = first_bin_hz + bin_step_hz * (bins - 1) as f64;
        let nyquist_hz = sample_rate.hz() / 2.0;
        let inside = |f: f64| (0.0..=nyquist_hz).contains(&f);
        if !(inside(first_bin_hz) && inside(last_hz)) {
            return Err(SlidingDftError::OutsideNyquist { first_hz: first_bin_hz, last_hz, nyquist_hz });
        }
        let lowest_hz = first_bin_hz.min(last_hz);
        if lowest_hz > 0.0 && (window_samples as f64) < sample_rate.hz() / lowest_hz {
            return Err(SlidingDftError::WindowTooShort {
                window_samples,
                first_hz: lowest_hz,
                sample_rate_hz: sample_rate.hz(),
            });
        }
        let block =
            (1..=LARGEST_BLOCK.min(window_samples)).rev().find(|b| window_samples % b == 0).unwrap_or(1);
        let padded_bins = bins.next_multiple_of(TILE);
        let middle_hz = (first_bin_hz + last_hz) / 2.0;
        let nodes_hz: Vec<f64> = {
            let half_hz = (last_hz - first_bin_hz).abs() / 2.0;
            let nodes = nodes::<T>(TAU * half_hz * (block - 1) as f64 / 2.0 / sample_rate.hz());
            let place = |i: usize| (TAU * (2 * i + 1) as f64 / (4 * nodes) as f64).cos();
            (0..nodes).map(|i| middle_hz + half_hz * place(i)).collect()
        };
        let mut design = Self {
            settings,
            block,
            blocks_per_window: window_samples / block,
            padded_bins,
            nodes: nodes_hz.len(),
            node_table: Vec::new(),
            table: vec![T::default(); nodes_hz.len() * padded_bins],
            rotor_step: vec![0.0; 2 * padded_bins],
            rotor_start: vec![0.0; 2 * padded_bins],
            window_phase: vec![T::default(); 2 * padded_bins],
            whole_bins: true,
            fast: Fast::detect(),
        };
        design.node_table = vec![T::default(); block * design.node_columns()];
        for n in 0..block {
            for (i, hz) in nodes_hz.iter().enumerate() {
                let value = design.phase(*hz, n as f64 - design.block_middle());
                let place = n * design.node_columns() + i;
                design.node_table[place] = T::from_f64(value.re);
                design.node_table[place + design.nodes] = T::from_f64(value.im);
            }
        }
        for k in 0..bins {
            for (i, weight) in lagrange_weights(&nodes_hz, design.bin_hz(k)).enumerate() {
                design.table[i * padded_bins + k] = T::from_f64(weight);
            }
            let phase = |n: f64| design.phase(design.bin_hz(k), n);
            let [step, start, turn] = [block as f64, design.block_middle(), window_samples as f64].map(phase);
            (design.rotor_step[k], design.rotor_step[padded_bins + k]) = (step.re, step.im);
            (design.rotor_start[k], design.rotor_start[padded_bins + k]) = (start.re, start.im);
            design.whole_bins &= (turn.re - 1.0).abs() < 1e-12 && turn.im.abs() < 1e-9;
            design.window_phase[k] = T::from_f64(turn.re);
            design.window_phase[padded_bins + k] = T::from_f64(turn.im);
        }
        Ok(design)
    }

    fn block_middle(&self) -> f64 {
        (self.block - 1) as f64 / 2.0
    }

    /// Columns of the transform at the nodes: real and imaginary parts, rounded up to whole tiles.
    fn node_columns(&self) -> usize {
        (2 * self.nodes).next_multiple_of(TILE)
    }

    /// e^{-j 2 pi f n / rate}, with the turns taken off before the cosine.
    fn phase(&self, hz: f64, n: f64) -> Complex<f64> {
        let turns = (hz * n / self.settings.sample_rate.hz()).fract();
        Complex::from_polar(1.0, -TAU * turns)
    }

    /// What it computes.
    #[must_use]
    pub fn settings(&self) -> &SlidingDftSettings {
        &self.settings
    }

    /// Samples between two spectra: the largest divisor of the window up to 25.
    #[must_use]
    pub fn block_samples(&self) -> usize {
        self.block
    }

    /// Frequency of bin `k`.
    #[must_use]
    pub fn bin_hz(&self, k: usize) -> f64 {
        self.settings.first_bin_hz + self.settings.bin_step_hz * k as f64
    }

    /// A window of zeros.
    #[must_use]
    pub fn start(&self) -> SlidingDftState<T> {
        let columns = self.settings.axes * 2 * self.padded_bins;
        let zeros = |n: usize| vec![T::default(); n];
        SlidingDftState {
            samples: zeros(self.settings.axes * self.block),
            in_block: 0,
            block_in_window: 0,
            window_full: false,
            windows: 0,
            at_nodes: zeros(self.settings.axes * self.node_columns()),
            blocks: zeros(self.settings.axes * 2 * self.nodes * self.blocks_per_window),
            change: zeros(self.settings.axes * 2 * self.nodes),
            spectrum: zeros(columns),
            rotor: self.rotor_start.clone(),
            rotor_values: zeros(2 * self.padded_bins),
            fresh: zeros(columns),
            sums: zeros(columns),
        }
    }

    /// Takes one sample of each axis; true when a block is complete and the spectrum is new.
    ///
    /// S_k(n) = sum over the last N samples of y e^{-j 2 pi f_k i / rate}, i = 0 at the window's oldest
    ///
    /// Shapes: `samples` one value an axis. Cost: no allocation; the work falls on each block's last sample.
    /// Source: Yamada, thesis 6.4.3, eq. (6-12); modulated sliding DFT in blocks.
    /// Deviation: (6-12) lacks /N, mixes the window's ends and drifts (docs/errata.md).
    /// Checked by: `oracle::sliding_dft_*`, `equals_the_direct_transform`.
    #[inline]
    pub fn step(&self, state: &mut SlidingDftState<T>, samples: &[f64]) -> bool {
        debug_assert_eq!(samples.len(), self.settings.axes);
        for (axis, &x) in samples.iter().enumerate().take(self.settings.axes) {
            debug_assert!(x.is_finite());
            state.samples[state.in_block * self.settings.axes + axis] = T::from_f64(x);
        }
        state.in_block += 1;
        if state.in_block < self.block {
            return false;
        }
        state.in_block = 0;
        self.finish_block(state);
        true
    }

    #[inline(never)]
    fn finish_block(&self, state: &mut SlidingDftState<T>) {
        self.transform_block(state);
        run(
            self.fast,
            Turn {
                rotor: &mut state.rotor,
                step: &self.rotor_step,
                values: &mut state.rotor_values,
                bins: self.padded_bins,
            },
        );
        let size = self.settings.axes * 2 * self.nodes;
        let place = state.block_in_window * size;
        let comes = &state.blocks[place..place + size];
        let SlidingDftState { spectrum, rotor_values, sums, fresh, change, .. } = state;
        let phase = (!self.whole_bins).then_some(&self.window_phase[..]);
        if self.is_fresh(state.windows) {
            self.take_in((comes, spectrum), rotor_values, (fresh, None));
        }
        if self.whole_bins {
            self.take_in((change, spectrum), rotor_values, (sums, None));
        } else {
            // What goes and what comes stand a window apart.
            self.take_in((comes, spectrum), rotor_values, (sums, phase));
            let goes = change.iter_mut().zip(comes.iter());
            goes.for_each(|(change, comes)| *change = change.minus(*comes));
            self.take_in((change, spectrum), rotor_values, (sums, None));
        }
        state.block_in_window += 1;
        if state.block_in_window == self.blocks_per_window {
            self.restart(state);
        }
    }

    /// Whether a fresh sum is made in this window. Bins between the multiples of rate/N change their phase
    /// with each: their sums must be.
    fn is_fresh(&self, windows: usize) -> bool {
        !self.whole_bins || windows + 1 == FRESH_EVERY
    }

    /// The block at the nodes; in its place in the window, and less what stood there.
    fn transform_block(&self, state: &mut SlidingDftState<T>) {
        let (axes, nodes, node_columns) = (self.settings.axes, self.nodes, self.node_columns());
        let at_nodes = BlockProduct {
            samples: &state.samples,
            table: &self.node_table,
            partial: &mut state.at_nodes,
            axes,
            columns: node_columns,
        };
        run(self.fast, at_nodes);
        let size = axes * 2 * nodes;
        let place = state.block_in_window * size;
        let block = &mut state.blocks[place..place + size];
        for (axis, values) in state.at_nodes.chunks_exact(node_columns).enumerate() {
            let (re, im) = values[..2 * nodes].split_at(nodes);
            for (i, parts) in re.iter().zip(im).enumerate() {
                for (part, value) in [parts.0, parts.1].into_iter().enumerate() {
                    let place = (i * axes + axis) * 2 + part;
                    state.change[place] = value.minus(std::mem::replace(&mut block[place], *value));
                }
            }
        }
    }

    /// A block from its nodes to all bins, turned to its place, into sums.
    fn take_in(
        &self,
        (nodes, spectrum): (&[T], &mut [T]),
        rotor: &[T],
        (sums, phase): (&mut [T], Option<&[T]>),
    ) {
        let (axes, columns) = (self.settings.axes, 2 * self.padded_bins);
        let at_bins = BlockProduct {
            samples: nodes,
            table: &self.table,
            partial: spectrum,
            axes: 2 * axes,
            columns: self.padded_bins,
        };
        run(self.fast, at_bins);
        for (block, sums) in spectrum.chunks_exact(columns).zip(sums.chunks_exact_mut(columns)) {
            run(self.fast, Advance { block, rotor, sums, phase, bins: self.padded_bins });
        }
    }

    fn restart(&self, state: &mut SlidingDftState<T>) {
        state.block_in_window = 0;
        state.window_full = true;
        if self.is_fresh(state.windows) {
            state.sums.copy_from_slice(&state.fresh);
            state.fresh.fill(T::default());
        }
        state.windows = (state.windows + 1) % FRESH_EVERY;
        state.rotor.copy_from_slice(&self.rotor_start);
    }

    /// Power of bin `k` of axis `axis` as that of a line: A^2/2 of a sine of amplitude A in the bin, in the
    /// signal's unit squared.
    #[must_use]
    pub fn power(&self, state: &SlidingDftState<T>, axis: usize, k: usize) -> f64 {
        let base = axis * 2 * self.padded_bins;
        let (re, im) = (state.sums[base + k].to_f64(), state.sums[base + self.padded_bins + k].to_f64());
        2.0 * (re * re + im * im) / (self.settings.window_samples as f64).powi(2)
    }

    /// Bin `k` of axis `axis` of the window that ends with the last whole block, phase zero at its oldest
    /// sample.
    #[must_use]
    pub fn value(&self, state: &SlidingDftState<T>, axis: usize, k: usize) -> Complex<f64> {
        let base = axis * 2 * self.padded_bins;
        let sum =
            Complex::new(state.sums[base + k].to_f64(), state.sums[base + self.padded_bins + k].to_f64());
        // Phases count from the restart before the window's oldest sample.
        let oldest = state.block_in_window * self.block;
        sum * self.phase(self.bin_hz(k), oldest as f64).conj()
    }

    /// The strongest bin of an axis and its power.
    #[must_use]
    pub fn strongest(&self, state: &SlidingDftState<T>, axis: usize) -> (usize, f64) {
        let base = axis * 2 * self.padded_bins;
        let (re, im) = (&state.sums[base..base + self.settings.bins], &state.sums[base + self.padded_bins..]);
        let mut best = (0, f64::NEG_INFINITY);
        for (k, (a, b)) in re.iter().zip(im).enumerate() {
            let power = a.to_f64() * a.to_f64() + b.to_f64() * b.to_f64();
            if power > best.1 {
                best = (k, power);
            }
        }
        (best.0, 2.0 * best.1 / (self.settings.window_samples as f64).powi(2))
    }

    /// Whether a whole window has been seen.
    #[must_use]
    pub fn is_full(&self, state: &SlidingDftState<T>) -> bool {
        state.window_full
    }
}

/// Nodes that a block needs whose outermost sample turns by `angle` from the middle to the edge of the band:
/// the error of Chebyshev interpolation of e^{jx} over |x| <= z, 2 (z/2)^R / R!, must lie below a quarter of
/// the rounding of `T`.
fn nodes<T: Real>(angle: f64) -> usize {
    let (mut nodes, mut error) = (0.0, 2.0);
    let mut count = 0;
    while error > 0.25 * T::ROUNDING && count < 1000 || count == 0 {
        nodes += 1.0;
        count += 1;
        error *= angle / 2.0 / nodes;
    }
    count
}

/// Weights by which values at `nodes` make the value at `x` of the polynomial through them.
fn lagrange_weights(nodes: &[f64], x: f64) -> impl Iterator<Item = f64> + '_ {
    (0..nodes.len()).map(move |i| {
        let others = nodes.iter().enumerate().filter(|(j, _)| *j != i);
        others.map(|(_, node)| (x - node) / (nodes[i] - node)).product()
    })
}

/// Sliding DFT whose spectrum is there after every sample.
///
/// Two sums a bin: one slides (new sample on, old one off), the other starts at zero every N samples and
/// takes the sliding one's place when it holds a whole window. Rounding lives for two windows, not for ever.
#[derive(Debug, Clone, PartialEq)]
pub struct EverySample {
    settings: SlidingDftSettings,
    step: Vec<Complex<f64>>,
}

/// State of [`EverySample`], one axis.
#[derive(Debug, Clone, PartialEq)]
pub struct EverySampleState {
    history: Vec<f64>,
    at: usize,
    rotor: Vec<Complex<f64>>,
    sliding: Vec<Complex<f64>>,
    fresh: Vec<Complex<f64>>,
}

impl EverySample {
    /// Errors: as [`SlidingDft::new`]; bins must be whole multiples of rate/N and there is one axis.
    pub fn new(settings: SlidingDftSettings) -> Result<Self, SlidingDftError> {
        let design = SlidingDft::<f64>::new(SlidingDftSettings { axes: 1, ..settings })?;
        let step = (0..settings.bins).map(|k| design.phase(design.bin_hz(k), 1.0)).collect();
        Ok(Self { settings: SlidingDftSettings { axes: 1, ..settings }, step })
    }

    /// A window of zeros.
    #[must_use]
    pub fn start(&self) -> EverySampleState {
        let zeros = vec![Complex::new(0.0, 0.0); self.settings.bins];
        EverySampleState {
            history: vec![0.0; self.settings.window_samples],
            at: 0,
            rotor: vec![Complex::new(1.0, 0.0); self.settings.bins],
            sliding: zeros.clone(),
            fresh: zeros,
        }
    }

    /// Takes one sample. Requires: bins at whole multiples of rate/N. Cost: no allocation.
    /// Checked by: `every_sample_equals_the_direct_transform`.
    pub fn step(&self, state: &mut EverySampleState, x: f64) {
        let change = x - std::mem::replace(&mut state.history[state.at], x);
        for (k, step) in self.step.iter().enumerate() {
            let rotor = state.rotor[k];
            state.sliding[k] += rotor * change;
            state.fresh[k] += rotor * x;
            state.rotor[k] = rotor * step;
        }
        state.at += 1;
        if state.at == self.settings.window_samples {
            state.at = 0;
            state.sliding.copy_from_slice(&state.fresh);
            state.fresh.fill(Complex::new(0.0, 0.0));
            state.rotor.fill(Complex::new(1.0, 0.0));
        }
    }

    /// Power of bin `k` as that of a line, see [`SlidingDft::power`].
    #[must_use]
    pub fn power(&self, state: &EverySampleState, k: usize) -> f64 {
        2.0 * state.sliding[k].norm_sqr() / (self.settings.window_samples as f64).powi(2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(first_bin_hz: f64, bin_step_hz: f64) -> SlidingDftSettings {
        let sample_rate = SampleRate::new(9000.0).unwrap();
        SlidingDftSettings { sample_rate, window_samples: 900, first_bin_hz, bin_step_hz, bins: 21, axes: 7 }
    }

    fn signal(axis: usize, n: usize) -> f64 {
        let t = n as f64 / 9000.0;
        3.0 + (TAU * (612.3 + axis as f64) * t).sin()
            + 0.3 * (TAU * 655.0 * t).cos()
            + 0.1 * ((n * n) as f64).sin()
    }

    fn direct(axis: usize, last: usize, f_hz: f64) -> Complex<f64> {
        let oldest = last + 1 - 900;
        let term = |i: usize| {
            Complex::from_polar(signal(axis, oldest + i), -TAU * (f_hz * i as f64 / 9000.0).fract())
        };
        (0..900).map(term).sum()
    }

    fn worst_error<T: Real>(settings: SlidingDftSettings) -> f64 {
        let design = SlidingDft::<T>::new(settings).unwrap();
        let mut state = design.start();
        let mut worst = 0.0f64;
        // Beyond two fresh sums.
        for n in 0..16_000 {
            let x: Vec<f64> = (0..7).map(|a| signal(a, n)).collect();
            if design.step(&mut state, &x) && n >= 899 && n % 49 == 0 {
                for (axis, k) in (0..7).flat_map(|a| (0..21).map(move |k| (a, k))) {
                    let error = design.value(&state, axis, k) - direct(axis, n, design.bin_hz(k));
                    worst = worst.max(error.norm() / 900.0);
                }
            }
        }
        worst
    }

    #[test]
    fn equals_the_direct_transform() {
        // Relative to a unit line; whole bins, then bins between them.
        assert!(worst_error::<f64>(settings(550.0, 10.0)) < 1e-12);
        assert!(worst_error::<f64>(settings(543.21, 7.77)) < 1e-12);
        assert!(worst_error::<f32>(settings(550.0, 10.0)) < 3e-6);
    }

    #[test]
    fn every_sample_equals_the_direct_transform() {
        let design = EverySample::new(settings(550.0, 10.0)).unwrap();
        let mut state = design.start();
        for n in 0..5000 {
            design.step(&mut state, signal(0, n));
            if n > 900 && n % 101 == 0 {
                for k in 0..21 {
                    let want = 2.0 * direct(0, n, 550.0 + 10.0 * k as f64).norm_sqr() / 900.0f64.powi(2);
                    assert!((design.power(&state, k) - want).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn a_line_has_its_power_and_is_the_strongest() {
        let design = SlidingDft::<f64>::new(SlidingDftSettings { axes: 1, ..settings(550.0, 10.0) }).unwrap();
        let mut state = design.start();
        for n in 0..900 {
            design.step(&mut state, &[5.0 * (TAU * 600.0 * n as f64 / 9000.0 + 0.4).sin()]);
        }
        assert!(design.is_full(&state));
        let (k, power) = design.strongest(&state, 0);
        assert_eq!(k, 5);
        assert!((power - 12.5).abs() < 1e-9);
    }

    #[test]
    fn impossible_windows_are_refused() {
        assert!(SlidingDft::<f64>::new(settings(4495.0, 10.0)).is_err());
        assert!(SlidingDft::<f64>::new(SlidingDftSettings { bins: 0, ..settings(550.0, 10.0) }).is_err());
        let short = SlidingDftSettings { window_samples: 10, ..settings(550.0, 10.0) };
        assert!(matches!(SlidingDft::<f64>::new(short), Err(SlidingDftError::WindowTooShort { .. })));
    }
}
