//! Block spectra of thinned series, ordered so that every inner product of a cell is one pass over memory.
//!
//! ```text
//! recording | fold (a quarter of its time) | band | block | bins (re, im)
//! ```
//! Blocks overlap by half under a sine window, whose squares add to one: sums of squares over all bins are
//! sums of squares over time.

use super::sliding::{CLASSES, Follows};
use realfft::num_complex::Complex;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use std::f64::consts::PI;
use std::sync::Arc;

/// Edges of the bands, as shares of the highest frequency looked at: octaves, then what a screw's resonance
/// and an encoder's noise need.
const EDGES: [f64; 12] = [0.0, 2.0, 5.0, 10.0, 20.0, 40.0, 80.0, 160.0, 320.0, 500.0, 700.0, 950.0];
/// Parts of a recording that are held out in turn.
pub(super) const FOLDS: usize = 4;
/// Blocks that all recordings together are cut into, at least; longest and shortest block, which is what is
/// measured at least.
const LEAST_BLOCKS: usize = 24;
pub(super) const LONGEST_BLOCK: usize = 2048;
pub(super) const SHORTEST_BLOCK: usize = 32;
/// Bins that a band has at least.
const LEAST_BINS: usize = 2;

/// All spectra of one series, see the module.
pub(super) type Spectrum = Arc<Vec<f64>>;

/// A series of every recording, thinned.
pub(super) type Series = Vec<Vec<f64>>;

/// What a column makes of the positions at a frequency: motor by motor, by stage, stage by motor, by stage.
pub(super) type Response = [Complex<f64>; 4];

/// A frequency at which the Jacobian is taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Point {
    pub(super) band: usize,
    /// Share of the values of its band that it stands for.
    pub(super) share: f64,
    pub(super) rad_s: f64,
    /// Of how freely the axis slides.
    pub(super) class: usize,
}

impl Point {
    /// What a force with these slopes makes of the position that it follows.
    pub(super) fn of_slopes(&self, follows: Follows, slopes: &[f64; CLASSES]) -> Complex<f64> {
        let slope = Complex::new(slopes[self.class], 0.0);
        match follows {
            Follows::Speed => slope * Complex::new(0.0, self.rad_s),
            Follows::Way => slope,
        }
    }
}

/// One recording, fold and band.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cell {
    pub(super) recording: usize,
    pub(super) fold: usize,
    pub(super) band: usize,
    start: usize,
    end: usize,
    /// Complex values in it.
    pub(super) values: usize,
}

/// Where the values of each block and band lie.
pub(super) struct Plan {
    block: usize,
    window: Vec<f64>,
    /// Bins of each band, from and to.
    bands: Vec<[usize; 2]>,
    top_hz: f64,
    /// Width of a bin, Hz.
    pub(super) bin_hz: f64,
    /// One noise level over all bands instead of one a band.
    pub(super) white: bool,
    pub(super) cells: Vec<Cell>,
    /// First value of `[recording][block][band]`.
    starts: Vec<Vec<Vec<usize>>>,
    /// Samples at which the blocks of a recording begin; those that a mask touches are left out.
    begins: Vec<Vec<usize>>,
    forward: Arc<dyn RealToComplex<f64>>,
    inverse: Arc<dyn ComplexToReal<f64>>,
    total: usize,
    measured: f64,
}

impl Plan {
    /// Frequencies of the Jacobian, evenly over the bands; at rest nothing is made of a position. Of each
    /// class, with its share of the time, as many as it counts. None: the axis is one mass.
    pub(super) fn points(&self, shares: &[f64; CLASSES]) -> Vec<Point> {
        /// Over all bands: a resonance of 2 % damping at half of the band has three.
        const POINTS: usize = 200;
        let stride = (self.bands.last().map_or(0, |b| b[1]) / POINTS).max(1);
        let of = |class: usize, (band, [from, to]): (usize, &[usize; 2])| {
            let from = (*from).max(1);
            let stride = ((stride as f64 / shares[class]) as usize).clamp(1, (to - from).max(1));
            let bins: Vec<usize> = (from + (stride - 1) / 2..*to).step_by(stride).collect();
            let share = 1.0 / bins.len().max(1) as f64;
            let bin_rad_s = 2.0 * PI * self.bin_hz;
            bins.into_iter().map(move |k| Point { band, share, rad_s: k as f64 * bin_rad_s, class })
        };
        let classes = (0..CLASSES).filter(|class| shares[*class] > 0.0 && !self.white);
        classes
            .flat_map(|class| self.bands.iter().enumerate().map(move |band| of(class, band)))
            .flatten()
            .collect()
    }

    /// `masked`: per recording and thinned sample, what was not measured; `top_hz`: highest frequency;
    /// `white`: fits see one noise level a recording.
    pub(super) fn new(masked: &[Vec<bool>], rate_hz: f64, (top_hz, white): (f64, bool)) -> Self {
        let block = block_length(masked);
        let bin_hz = rate_hz / block as f64;
        let begins: Vec<Vec<usize>> = masked.iter().map(|m| whole_blocks(m, block)).collect();
        let bands = bands(bin_hz, top_hz, block);
        let (mut cells, mut start) = (Vec::new(), 0);
        let mut starts: Vec<Vec<Vec<usize>>> =
            begins.iter().map(|b| vec![vec![0; bands.len()]; b.len()]).collect();
        for (recording, begins) in begins.iter().enumerate() {
            for fold in 0..FOLDS {
                for (band, [from, to]) in bands.iter().enumerate() {
                    let first = start;
                    for k in (0..begins.len()).filter(|k| FOLDS * k / begins.len() == fold) {
                        starts[recording][k][band] = start;
                        start += 2 * (to - from);
                    }
                    if start > first {
                        let values = (start - first) / 2;
                        cells.push(Cell { recording, fold, band, start: first, end: start, values });
                    }
                }
            }
        }
        let mut planner = RealFftPlanner::new();
        Self {
            block,
            window: (0..block).map(|k| (PI * (k as f64 + 0.5) / block as f64).sin()).collect(),
            bands,
            top_hz,
            bin_hz,
            white,
            cells,
            starts,
            begins,
            forward: planner.plan_fft_forward(block),
            inverse: planner.plan_fft_inverse(block),
            total: start,
            measured: 0.0,
        }
        .looking_at(|_, _| true)
    }

    /// Number of bands.
    pub(super) fn bands(&self) -> usize {
        self.bands.len()
    }

    /// A band in Hz.
    pub(super) fn band_hz(&self, band: usize) -> [f64; 2] {
        self.bands[band].map(|k| (k as f64 - 0.5).max(0.0) * self.bin_hz)
    }

    /// The band that the floor of two positions is read off in, an octave: below it the floor is flat.
    pub(super) fn floor_hz(&self) -> [f64; 2] {
        [EDGES[7], EDGES[8]].map(|edge| edge * self.top_hz / EDGES[EDGES.len() - 1])
    }

    /// Frequency of a value of a cell of a band, Hz.
    pub(super) fn hz(&self, band: usize, value: usize) -> f64 {
        (self.bands[band][0] + value % self.width(band)) as f64 * self.bin_hz
    }

    /// Number of frequencies of a band.
    pub(super) fn width(&self, band: usize) -> usize {
        let [from, to] = self.bands[band];
        to - from
    }

    /// True where masks leave something to fit and something to judge it by.
    pub(super) fn is_enough(&self) -> bool {
        self.measured() >= SHORTEST_BLOCK as f64
    }

    /// Thinned samples that the blocks stand for.
    pub(super) fn in_blocks(&self) -> f64 {
        0.5 * (self.block * self.begins.iter().map(Vec::len).sum::<usize>()) as f64
    }

    /// The same, those left out that tell nothing.
    pub(super) fn measured(&self) -> f64 {
        self.measured
    }

    /// The same without samples that tell nothing, per recording.
    pub(super) fn looking_at(mut self, tells: impl Fn(usize, usize) -> bool) -> Self {
        let told = |r: usize, begin: usize| -> f64 {
            self.window.iter().enumerate().filter(|(k, _)| tells(r, begin + k)).map(|(_, w)| w * w).sum()
        };
        let of = |(r, begins): (usize, &Vec<usize>)| begins.iter().map(|b| told(r, *b)).sum::<f64>();
        self.measured = self.begins.iter().enumerate().map(of).sum();
        self
    }

    /// Number of recordings.
    pub(super) fn recordings(&self) -> usize {
        self.begins.len()
    }

    /// Bins of a block of a recording, each with its place in a spectrum.
    fn bins(&self, recording: usize, block: usize) -> impl Iterator<Item = (usize, usize)> {
        let starts = &self.starts[recording][block];
        let of = |([from, to], start): (&[usize; 2], &usize)| {
            let (from, start) = (*from, *start);
            (from..*to).map(move |bin| (bin, start + 2 * (bin - from)))
        };
        self.bands.iter().zip(starts).flat_map(of)
    }

    /// The spectra of a series.
    pub(super) fn transform(&self, series: &[Vec<f64>]) -> Spectrum {
        let mut out = vec![0.0; self.total];
        let mut bins = self.forward.make_output_vec();
        let mut input = vec![0.0; self.block];
        for (r, x) in series.iter().enumerate() {
            for (k, begin) in self.begins[r].iter().enumerate() {
                let part = &x[*begin..(*begin + self.block).min(x.len())];
                if part.iter().all(|v| *v == 0.0) {
                    continue;
                }
                input.fill(0.0);
                part.iter().zip(&self.window).zip(&mut input).for_each(|((x, w), i)| *i = x * w);
                if self.forward.process(&mut input, &mut bins).is_err() {
                    continue; // lengths are the plan's own
                }
                for (bin, place) in self.bins(r, k) {
                    let scale = (if bin == 0 { 1.0 } else { 2.0 } / self.block as f64).sqrt();
                    out[place] = scale * bins[bin].re;
                    out[place + 1] = scale * bins[bin].im;
                }
            }
        }
        Arc::new(out)
    }

    /// The series of spectra: blocks under the window again, overlapped and added; zero outside the bands.
    pub(super) fn series(&self, spectrum: &[f64], lengths: &[usize]) -> Series {
        let mut bins = self.inverse.make_input_vec();
        let mut block = self.inverse.make_output_vec();
        let mut out = Vec::new();
        for (r, length) in lengths.iter().enumerate() {
            let mut x = vec![0.0; *length];
            for (k, begin) in self.begins[r].iter().enumerate() {
                bins.fill(Complex::new(0.0, 0.0));
                for (bin, place) in self.bins(r, k) {
                    let scale = (if bin == 0 { 1.0 } else { 2.0 } * self.block as f64).sqrt().recip();
                    let im = if bin == 0 { 0.0 } else { spectrum[place + 1] };
                    bins[bin] = scale * Complex::new(spectrum[place], im);
                }
                if self.inverse.process(&mut bins, &mut block).is_ok() {
                    let into = &mut x[*begin..(*begin + self.block).min(*length)];
                    into.iter_mut().zip(&block).zip(&self.window).for_each(|((x, b), w)| *x += w * b);
                }
            }
            out.push(x);
        }
        out
    }

    /// Spectra turned in time by a share of each recording, the later half of its blocks negated: what they
    /// keep is the spectrum and the character of what is left, no law can be true of them.
    pub(super) fn turned(&self, spectrum: &[f64], share: f64) -> Spectrum {
        let mut out = vec![0.0; self.total];
        for (r, begins) in self.begins.iter().enumerate() {
            let blocks = begins.len();
            let by = (share * blocks as f64) as usize;
            for k in 0..blocks {
                let sign = if 2 * k < blocks { 1.0 } else { -1.0 };
                for ((_, to), (_, from)) in self.bins(r, k).zip(self.bins(r, (k + by) % blocks)) {
                    (out[to], out[to + 1]) = (sign * spectrum[from], sign * spectrum[from + 1]);
                }
            }
        }
        Arc::new(out)
    }

    /// Power of every bin of every block of a recording, with the middle of the block in samples.
    pub(super) fn powers(&self, spectrum: &[f64], recording: usize) -> Vec<(usize, Vec<f64>)> {
        let of = |(k, begin): (usize, &usize)| {
            let last = self.bands.last().map_or(0, |b| b[1]);
            let mut power = vec![0.0; last];
            for (bin, place) in self.bins(recording, k) {
                power[bin] = spectrum[place].powi(2) + spectrum[place + 1].powi(2);
            }
            (begin + self.block / 2, power)
        };
        self.begins[recording].iter().enumerate().map(of).collect()
    }
}

impl Cell {
    /// The cell's part of a spectrum.
    pub(super) fn of(self, spectrum: &[f64]) -> &[f64] {
        &spectrum[self.start..self.end]
    }

    /// The same to be written.
    pub(super) fn of_mut(self, spectrum: &mut [f64]) -> &mut [f64] {
        &mut spectrum[self.start..self.end]
    }
}

/// The longest block that the recordings have room for. Masks cut them into pieces: then the longest that
/// loses little more at the ends of the pieces than the best does.
fn block_length(masked: &[Vec<bool>]) -> usize {
    /// Share of what the best length keeps.
    const KEPT: f64 = 0.8;
    let total: usize = masked.iter().map(Vec::len).sum();
    let shortest = masked.iter().map(Vec::len).min().unwrap_or(0);
    let most = (total / LEAST_BLOCKS).min(shortest).clamp(SHORTEST_BLOCK, LONGEST_BLOCK);
    let longest = if most.is_power_of_two() { most } else { most.next_power_of_two() / 2 };
    let lengths: Vec<usize> =
        std::iter::successors(Some(longest), |b| Some(b / 2)).take_while(|b| *b >= SHORTEST_BLOCK).collect();
    let kept = |b: &usize| masked.iter().map(|m| whole_blocks(m, *b).len()).sum::<usize>() * b;
    let best = lengths.iter().map(kept).max().unwrap_or(0);
    lengths.iter().copied().find(|b| kept(b) as f64 >= KEPT * best as f64).unwrap_or(longest)
}

/// Begins of half-overlapping blocks without a masked sample.
fn whole_blocks(masked: &[bool], block: usize) -> Vec<usize> {
    let all = (0..).map(|k| k * (block / 2)).take_while(|b| *b == 0 || b + block <= masked.len());
    all.filter(|b| !masked[*b..(*b + block).min(masked.len())].iter().any(|m| *m)).collect()
}

fn bands(bin_hz: f64, top_hz: f64, block: usize) -> Vec<[usize; 2]> {
    let scale = top_hz / EDGES[EDGES.len() - 1];
    let mut list: Vec<[usize; 2]> = Vec::new();
    let mut from = 0;
    for edge in &EDGES[1..] {
        let to = (((edge * scale / bin_hz) + 0.5) as usize).min(block / 2);
        if to >= from + LEAST_BINS {
            list.push([from, to]);
            from = to;
        }
    }
    list
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(n: usize) -> Vec<f64> {
        let mut next = crate::diagnosis::chance::normal(5);
        (0..n).map(|_| next()).collect()
    }

    #[test]
    fn frequencies_of_a_class_stand_for_all_values_of_each_band() {
        let plan = Plan::new(&[vec![false; 8000]], 1000.0, (400.0, false));
        let points = plan.points(&[0.7, 0.0, 0.29, 0.01]);
        let of = |class: usize| points.iter().filter(move |p| p.class == class);
        for class in [0, 2, 3] {
            let sum = |band: usize| of(class).filter(|p| p.band == band).map(|p| p.share).sum::<f64>();
            assert!((0..plan.bands()).all(|band| (sum(band) - 1.0).abs() < 1e-12), "{class}");
        }
        assert!(of(0).count() > of(2).count() && of(2).count() > of(3).count() && of(1).count() == 0);
    }

    /// What is in the band comes back, sums of squares are kept, and turning twice by a half is no change but
    /// for the sign.
    #[test]
    fn spectra_keep_power_and_come_back() {
        let n = 4096;
        let low: Vec<f64> = (0..n).map(|k| (0.21 * k as f64).sin() + (0.05 * k as f64).cos()).collect();
        let plan = Plan::new(&[vec![false; n]], 1000.0, (400.0, false));
        let spectrum = plan.transform(std::slice::from_ref(&low));
        let back = plan.series(&spectrum, &[n]);
        for k in 300..n - 300 {
            assert!((back[0][k] - low[k]).abs() < 1e-3, "{k}: {} {}", back[0][k], low[k]);
        }
        let power: f64 = spectrum.iter().map(|v| v * v).sum();
        assert!((power / low.iter().map(|v| v * v).sum::<f64>() - 1.0).abs() < 0.05);
        let cells: usize = plan.cells.iter().map(|c| c.values).sum();
        assert_eq!(2 * cells, spectrum.len());
    }

    #[test]
    fn a_masked_stretch_enters_no_block() {
        let n = 8192;
        let mut masked = vec![false; n];
        masked[4000..4010].fill(true);
        let plan = Plan::new(&[masked], 1000.0, (400.0, false));
        let mut x = noise(n);
        let clean = plan.transform(&[x.clone()]);
        x[4005] = 1e6;
        assert_eq!(*clean, *plan.transform(&[x]));
    }
}
