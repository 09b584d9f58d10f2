//! A state and what it leaves, as effects look for places to begin at.

use super::{Balance, Column, Complex, Hypothesis, Signals, Standing};
use crate::diagnosis::drive::spectra::Series;
use rustfft::FftPlanner;
use std::cell::OnceCell;

/// Peaks of a search that are asked about.
const PEAKS: usize = 3;
/// Places of a wave's phase on the grid that its transform is taken from.
const PLACES: f64 = 16.0;
/// Shortest wavelength of a force over position, in travels.
pub(crate) const SHORTEST: f64 = 1.0 / 160.0;

/// See the head of this file.
pub(crate) struct Search<'a> {
    pub(crate) balance: &'a Balance,
    pub(crate) signals: &'a Signals,
    /// There are two positions.
    pub(crate) two: bool,
    pub(crate) now: Standing,
    /// Dry friction of the stage, its bristle included, N.
    pub(crate) coulomb_n: f64,
    /// The recorded force comes of a command: one that was measured has nothing before it.
    pub(crate) has_command: bool,
    /// Spectra of what is left.
    pub(crate) left: Column,
    /// In time, through the weights of its bands.
    pub(crate) whitened: [Series; 2],
    /// See [`Search::lines`].
    pub(crate) found: OnceCell<Vec<Hypothesis>>,
}

impl Search<'_> {
    pub(crate) fn travel_m(&self) -> f64 {
        let [low, high] = self.signals.travel_m();
        high - low
    }

    /// What is left in time, of one balance.
    pub(crate) fn plain(&self, side: usize) -> Series {
        let spectrum = self.left.sides[side].as_ref();
        spectrum.map_or_else(Vec::new, |x| self.balance.plan.series(x, &self.signals.lengths()))
    }

    /// Lines that stand out of it.
    pub(crate) fn lines(&self) -> &[Hypothesis] {
        self.found.get_or_init(|| self.found_lines())
    }

    /// The strongest waves over position of what is left, through the weights of its bands and as it is.
    pub(crate) fn peaks_of_both(&self, side: usize, range_m: [f64; 2]) -> Vec<f64> {
        let weighted = self.peaks(&self.whitened[side], range_m);
        weighted.into_iter().chain(self.peaks(&self.plain(side), range_m)).collect()
    }

    /// Wavelengths at which a series has its strongest waves over position, strongest first.
    pub(crate) fn peaks(&self, series: &[Vec<f64>], [shortest, longest]: [f64; 2]) -> Vec<f64> {
        let [low, high] = self.signals.travel_m();
        let spacing = shortest / PLACES;
        let places = (((high - low) / spacing) as usize + 2).min(1 << 21);
        let n = (4 * places).next_power_of_two();
        let mut line = vec![Complex::new(0.0, 0.0); n];
        for (track, x) in self.signals.tracks.iter().zip(series) {
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
}

/// A factor grid from one size to another.
pub(crate) fn grid(from: f64, to: f64, count: usize) -> impl Iterator<Item = f64> {
    let step = (to / from).max(1.0).powf(1.0 / (count.max(2) - 1) as f64);
    (0..count).map(move |k| from * step.powi(k as i32))
}
