//! The band of the force in blocks, their periodograms, and the noise of the band in air.

use super::conditions::{SLICES, TOLD};
use super::interference::Bin;
use super::model::Noise;
use crate::signal::down_mix::{DownMix, DownMixState};
use crate::units::SampleRate;
use nalgebra::Complex;
use rustfft::{Fft, FftPlanner};
use std::f64::consts::PI;
use std::fmt;
use std::sync::Arc;

/// Whole bins to each side over which the spectrum of a bin is gathered, in half bins.
pub(super) const REACH: usize = 3;

/// Share of a bin's expected power that comes from half bins 0 to 3 away: the Hann window's kernel,
/// (sinc x + sinc(x-1)/2 + sinc(x+1)/2)^2, normalised to a sum of one over both sides.
fn leakage() -> [f64; REACH + 1] {
    let sinc = |x: f64| if x.abs() < 1e-12 { 1.0 } else { (PI * x).sin() / (PI * x) };
    let kernel = |half: f64| {
        let x = half / 2.0;
        (sinc(x) + 0.5 * sinc(x - 1.0) + 0.5 * sinc(x + 1.0)).powi(2)
    };
    let raw = [kernel(0.0), kernel(1.0), kernel(2.0), kernel(3.0)];
    let sum = raw[0] + 2.0 * (raw[1] + raw[2] + raw[3]);
    raw.map(|k| k / sum)
}

/// A window with its transform.
#[derive(Clone)]
struct Transform {
    fft: Arc<dyn Fft<f64>>,
    window: Vec<f64>,
    /// 1/(R sum w^2), s.
    scale: f64,
}

impl fmt::Debug for Transform {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Transform({})", self.window.len())
    }
}

impl Transform {
    fn new(length: usize, rate_hz: f64) -> Self {
        let hann = |i: usize| 0.5 - 0.5 * (2.0 * PI * i as f64 / length as f64).cos();
        let window: Vec<f64> = (0..length).map(hann).collect();
        let scale = 1.0 / (rate_hz * window.iter().map(|w| w * w).sum::<f64>());
        Self { fft: FftPlanner::new().plan_fft_forward(length), window, scale }
    }

    /// One-sided density of bins `first ..` of the last samples of `ring`, which ends at `end`, N^2/Hz.
    fn periodogram(&self, ring: Ring<'_>, work: &mut Work, (first, to): (i64, &mut [f64])) {
        let length = self.window.len();
        let signed = length as i64;
        for (i, (to, weight)) in work.buffer[..length].iter_mut().zip(&self.window).enumerate() {
            *to = ring.samples[(ring.end + ring.samples.len() - length + i) % ring.samples.len()] * *weight;
        }
        self.fft.process_with_scratch(&mut work.buffer[..length], &mut work.scratch);
        for (k, to) in (first..).zip(to) {
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            let place = k.rem_euclid(signed) as usize;
            *to = work.buffer[place].norm_sqr() * self.scale;
        }
    }
}

#[derive(Clone, Copy)]
struct Ring<'a> {
    samples: &'a [Complex<f64>],
    end: usize,
}

/// Room for a transform; holds nothing between two.
#[derive(Debug, Clone, PartialEq)]
struct Work {
    buffer: Vec<Complex<f64>>,
    scratch: Vec<Complex<f64>>,
}

/// Mixer, blocks and bins of one band.
#[derive(Debug, Clone)]
pub(super) struct BandBlocks {
    mix: DownMix,
    whole: Transform,
    /// A quarter of a block, for air: there may be little of it, and its spectrum is smooth.
    quarter: Transform,
    /// Outputs in a slice.
    slice: usize,
    /// Bins of a block: first, counted from the middle, and how many.
    first: i64,
    pub(super) bins: usize,
    quarter_first: i64,
    quarter_bins: usize,
    leakage: [f64; REACH + 1],
    pub(super) middle_hz: f64,
}

/// State of [`BandBlocks`].
#[derive(Debug, Clone, PartialEq)]
pub(super) struct BandState {
    mix: DownMixState,
    ring: Vec<Complex<f64>>,
    end: usize,
    until_slice: usize,
    /// Largest |z|^2 in each of the last slices and in the current one.
    loudest: [f64; SLICES],
    loud: f64,
    air: Vec<f64>,
    pub(super) air_count: f64,
    /// Noise of air in the middle of the band and its change in 100 Hz, ln of N^2/Hz, and where a line stands
    /// over it.
    air_noise: [f64; 2],
    lines: Vec<bool>,
    work: Work,
}

impl crate::keyframe::Keep for BandState {
    fn keep(&self, to: &mut Vec<u64>) {
        let Self { mix, ring, end, until_slice, loudest, loud, air, air_count, air_noise, lines, work: _ } =
            self;
        mix.keep(to);
        ring.keep(to);
        [end, until_slice].into_iter().for_each(|n| n.keep(to));
        loudest.keep(to);
        [loud, air_count].into_iter().for_each(|x| x.keep(to));
        air.keep(to);
        air_noise.keep(to);
        lines.keep(to);
    }

    fn restore(&mut self, from: &mut crate::keyframe::Words<'_>) -> Option<()> {
        let Self { mix, ring, end, until_slice, loudest, loud, air, air_count, air_noise, lines, work: _ } =
            self;
        mix.restore(from)?;
        ring.restore(from)?;
        [&mut *end, &mut *until_slice].into_iter().try_for_each(|n| n.restore(from))?;
        loudest.restore(from)?;
        [loud, air_count].into_iter().try_for_each(|x| x.restore(from))?;
        air.restore(from)?;
        air_noise.restore(from)?;
        lines.restore(from)?;
        (*end < ring.len() && *until_slice > 0).then_some(())
    }
}

/// The noise of air is averaged over this many pieces of an eighth of a block: 10 s.
const AIR_MEMORY: f64 = 40.0;

impl BandBlocks {
    pub(super) fn new(rate: SampleRate, band_hz: [f64; 2], block_s: f64) -> Self {
        let middle_hz = f64::midpoint(band_hz[0], band_hz[1]);
        let half_hz = (band_hz[1] - band_hz[0]) / 2.0;
        // The window's kernel reaches two bins beyond the band.
        let mix = DownMix::new(rate, middle_hz, half_hz + 4.0 / block_s);
        let slice = smooth_below(block_s * mix.output_rate_hz() / SLICES as f64);
        let length = slice * SLICES;
        let per_bin_hz = mix.output_rate_hz() / length as f64;
        let reach = |bin_hz: f64| {
            #[expect(clippy::cast_possible_truncation, reason = "a band of some hundred bins")]
            let reach = (half_hz / bin_hz).floor() as i64;
            reach
        };
        let (last, quarter_last) = (reach(per_bin_hz), reach(4.0 * per_bin_hz));
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "not negative")]
        let bins = |last: i64| (2 * last + 1) as usize;
        Self {
            whole: Transform::new(length, mix.output_rate_hz()),
            quarter: Transform::new(length / 4, mix.output_rate_hz()),
            mix,
            slice,
            first: -last,
            bins: bins(last),
            quarter_first: -quarter_last,
            quarter_bins: bins(quarter_last),
            leakage: leakage(),
            middle_hz,
        }
    }

    pub(super) fn start(&self) -> BandState {
        let length = self.whole.window.len();
        let scratch =
            self.whole.fft.get_inplace_scratch_len().max(self.quarter.fft.get_inplace_scratch_len());
        let none = Complex::new(0.0, 0.0);
        BandState {
            mix: self.mix.start(),
            ring: vec![none; length],
            end: 0,
            until_slice: self.slice,
            loudest: [0.0; SLICES],
            loud: 0.0,
            air: vec![0.0; self.quarter_bins],
            air_count: 0.0,
            air_noise: [0.0; 2],
            lines: vec![false; self.quarter_bins],
            work: Work { buffer: vec![none; length], scratch: vec![none; scratch] },
        }
    }

    /// Share of a bin's expected power from half bins 0 to [`REACH`] away.
    pub(super) fn leakage(&self) -> &[f64; REACH + 1] {
        &self.leakage
    }

    /// Distance of the bins, Hz.
    pub(super) fn bin_hz(&self) -> f64 {
        self.mix.output_rate_hz() / self.whole.window.len() as f64
    }

    /// Frequency of a half bin, counted from the first whole one, Hz.
    pub(super) fn half_bin_hz(&self, half: i64) -> f64 {
        self.middle_hz + self.bin_hz() * (self.first as f64 + half as f64 / 2.0)
    }

    /// Samples from one output of the mixer to the next.
    pub(super) fn samples_per_output(&self) -> usize {
        self.mix.decimation()
    }

    /// Length of a slice, s.
    pub(super) fn slice_s(&self) -> f64 {
        self.slice as f64 / self.mix.output_rate_hz()
    }

    /// The next slice begins with the next sample.
    pub(super) fn begin(&self, state: &mut BandState) {
        state.until_slice = self.slice;
        state.loud = 0.0;
    }

    /// Takes a sample; true when a slice is whole.
    pub(super) fn push(&self, state: &mut BandState, force_n: f64) -> bool {
        if !self.mix.push(&mut state.mix, force_n) {
            return false;
        }
        let z = self.mix.output(&mut state.mix);
        state.ring[state.end] = z;
        state.end += 1;
        if state.end == state.ring.len() {
            state.end = 0;
        }
        state.loud = state.loud.max(z.norm_sqr());
        state.until_slice -= 1;
        if state.until_slice > 0 {
            return false;
        }
        state.until_slice = self.slice;
        state.loudest.rotate_right(1);
        state.loudest[0] = std::mem::take(&mut state.loud);
        true
    }

    /// Largest amplitude of the band in the last block, N.
    pub(super) fn largest_n(&self, state: &BandState) -> f64 {
        (2.0 * state.loudest.iter().copied().fold(0.0, f64::max)).sqrt()
    }

    /// The farthest that the band falls from a slice of the last block to a later one, amplitudes.
    pub(super) fn fall(&self, state: &BandState) -> f64 {
        let (mut quietest, mut farthest) = (f64::INFINITY, 1.0_f64);
        // Newest first.
        for loudest in state.loudest {
            farthest = farthest.max(loudest / quietest.max(f64::MIN_POSITIVE));
            quietest = quietest.min(loudest);
        }
        farthest.sqrt()
    }

    /// Periodogram of the last block. Cost: one transform of some 1600 points.
    pub(super) fn block(&self, state: &mut BandState, to: &mut [f64]) {
        let ring = Ring { samples: &state.ring, end: state.end };
        self.whole.periodogram(ring, &mut state.work, (self.first, to));
    }

    /// Learns the noise of the band from two slices of air, those before the last [`TOLD`].
    pub(super) fn learn_air(&self, state: &mut BandState, piece: &mut [f64]) {
        let piece = &mut piece[..self.quarter_bins];
        let length = state.ring.len();
        let ring = Ring { samples: &state.ring, end: (state.end + length - TOLD * self.slice) % length };
        self.quarter.periodogram(ring, &mut state.work, (self.quarter_first, piece));
        state.air_count = (state.air_count + 1.0).min(AIR_MEMORY);
        for (mean, now) in state.air.iter_mut().zip(piece) {
            *mean += (*now - *mean) / state.air_count;
        }
        self.fit_air(state);
    }

    /// Straight line of ln S through what air taught, beside the lines that stand in it: from the mean of
    /// ln S, which lines hardly move, two steps of Fisher's scoring with each piece of air.
    fn fit_air(&self, state: &mut BandState) {
        let BandState { air, air_noise, lines, air_count, .. } = state;
        let step = 4.0 * self.bin_hz() / 100.0;
        let offset = |i: usize| (self.quarter_first as f64 + i as f64) * step;
        if *air_count <= 1.0 {
            let logs = air.iter().map(|power| power.max(f64::MIN_POSITIVE).ln());
            *air_noise = [logs.sum::<f64>() / air.len() as f64, 0.0];
        }
        let [level, slope] = air_noise;
        for _ in 0..2 {
            let (mut by_level, mut by_slope, mut count, mut squares) = (0.0, 0.0, 1.0, step * step);
            for (i, (power, line)) in air.iter().zip(&mut *lines).enumerate() {
                let noise = (*level + *slope * offset(i)).exp().max(f64::MIN_POSITIVE);
                let bin = Bin::new(power / noise, false);
                by_level += bin.score;
                by_slope += bin.score * offset(i);
                count += bin.own;
                squares += bin.own * offset(i).powi(2);
                *line = bin.own < 0.5;
            }
            *level += by_level / count;
            *slope += by_slope / squares;
        }
        // A simulated force is exactly zero in air.
        *level = level.max(f64::MIN_POSITIVE.ln());
    }

    /// Noise of air, where there was any.
    pub(super) fn air_noise(&self, state: &BandState) -> Option<Noise> {
        let [level, slope] = state.air_noise;
        (state.air_count >= 1.0).then_some(Noise { level, slope, middle_hz: self.middle_hz })
    }

    /// Whether a line stood in air where a bin of a block is: in the bin of a quarter block next to it.
    pub(super) fn is_line_of_air(&self, state: &BandState, bin: usize) -> bool {
        let quarter = (self.first + bin as i64 + 2).div_euclid(4) - self.quarter_first;
        usize::try_from(quarter).is_ok_and(|k| state.lines.get(k) == Some(&true))
    }
}

/// The largest product of 2, 3 and 5 that is not above `most`: a length that transforms fast.
fn smooth_below(most: f64) -> usize {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "outputs in a slice")]
    let mut length = most.max(1.0) as usize;
    let smooth = |mut n: usize| {
        for factor in [2, 3, 5] {
            while n.is_multiple_of(factor) {
                n /= factor;
            }
        }
        n == 1
    };
    while !smooth(length) {
        length -= 1;
    }
    length
}
