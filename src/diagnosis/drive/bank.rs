//! Which hypotheses there are for a state: laws on a grid that the recordings scale, wavelengths and lines
//! where what is left has peaks.

use super::gram::Column;
use super::laws::{EFFECTS, Hypothesis};
use super::signals::{Layout, Signals};
use super::spectra::Series;
use super::state::{Balance, State, residual};
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;
use std::cell::OnceCell;

/// Peaks of a search that are asked about.
const PEAKS: usize = 3;
/// Places of a wave's phase on the grid that its transform is taken from.
const PLACES: f64 = 16.0;
/// Shortest wavelength of a force over position, in travels.
pub(super) const SHORTEST: f64 = 1.0 / 160.0;

/// A state and what it leaves, as effects look for places to begin at.
pub(super) struct Search<'a> {
    pub(super) balance: &'a Balance,
    pub(super) state: &'a State,
    pub(super) signals: &'a Signals,
    /// There are two positions.
    pub(super) two: bool,
    pub(super) lead_m: Option<f64>,
    /// Spectra of what is left.
    pub(super) left: Column,
    whitened: OnceCell<[Series; 2]>,
    lines: OnceCell<Vec<Hypothesis>>,
}

impl<'a> Search<'a> {
    pub(super) fn new(balance: &'a Balance, state: &'a State) -> Self {
        Self {
            balance,
            state,
            signals: &balance.signals,
            two: balance.signals.layout == Layout::TwoPositions,
            lead_m: balance.drive.screw_lead_m(),
            left: residual(balance, &state.base.gram, &state.base.design, &state.base.fit.beta),
            whitened: OnceCell::new(),
            lines: OnceCell::new(),
        }
    }

    /// The side of the stage, of the axis where there is one position.
    pub(super) fn last(&self) -> usize {
        usize::from(self.two)
    }

    pub(super) fn travel_m(&self) -> f64 {
        let [low, high] = self.signals.travel_m();
        high - low
    }

    /// True where the recorded force comes of a command: a force that was measured has nothing before it.
    pub(super) fn has_command(&self) -> bool {
        self.state.inertial && !self.state.is_measured(self.balance)
    }

    /// What is left in time, of one balance.
    pub(super) fn plain(&self, side: usize) -> Series {
        let of = |x: &std::sync::Arc<Vec<f64>>| self.balance.plan.series(x, &self.signals.lengths());
        self.left.sides[side].as_ref().map_or_else(Vec::new, of)
    }

    /// The same through the weights of its bands.
    pub(super) fn whitened(&self, side: usize) -> Series {
        let all = self.whitened.get_or_init(|| whitened(self.balance, self.state, &self.left));
        all[side].clone()
    }

    /// Lines that stand out of it.
    pub(super) fn lines(&self) -> &[Hypothesis] {
        self.lines.get_or_init(|| self.found_lines())
    }

    /// Wavelengths at which a series has its strongest waves over position.
    pub(super) fn peaks(&self, series: &[Vec<f64>], range_m: [f64; 2]) -> Vec<f64> {
        peaks(self.balance, series, range_m)
    }
}

/// Everything that may be asked of a state.
pub(super) fn candidates(balance: &Balance, state: &State) -> Vec<Hypothesis> {
    let search = Search::new(balance, state);
    let taken = |h: &Hypothesis| {
        state.accepted.iter().any(|a| {
            let other = &a.hypothesis;
            other.effect == h.effect
                && other.port == h.port
                && !h.facts().is_of_one_recording
                && other.facts().is_number == h.facts().is_number
        })
    };
    let mut list: Vec<Hypothesis> = Vec::new();
    for h in EFFECTS.iter().flat_map(|effect| (effect.candidates)(&search)) {
        if !taken(&h) && !list.contains(&h) {
            list.push(h);
        }
    }
    list
}

/// What may be wrong with the column of the force.
pub(super) fn faults(balance: &Balance, state: &State) -> Vec<Hypothesis> {
    let search = Search::new(balance, state);
    EFFECTS.iter().rev().flat_map(|effect| (effect.faults)(&search)).collect()
}

/// A factor grid from one size to another.
pub(super) fn grid(from: f64, to: f64, count: usize) -> impl Iterator<Item = f64> {
    let step = (to / from).max(1.0).powf(1.0 / (count.max(2) - 1) as f64);
    (0..count).map(move |k| from * step.powi(k as i32))
}

/// What is left, through the weights of its bands, in time.
fn whitened(balance: &Balance, state: &State, left: &Column) -> [Series; 2] {
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
