//! Where the condition of a cut stands still: calm stretches, whose noise is stationary, and stretches that
//! are followed in time because something swells or fades in them while the cut stays linear.
//!
//! ```text
//! loudness   ______/~~~~~~~~\________      condition constant throughout
//!            followed   |    |followed, then calm
//!            (linear)   +-- contact may be lost: left out
//! ```

use super::criteria::CRITERIA;
use super::force_signal::{filtered, signal_response, stated_filter, without_line};
use super::input::CutRecording;
use super::machine::Noise;
use super::matrix::ZERO;
use crate::plant::cut_loop::CutLoop;
use crate::plant::cut_terms::{CutCondition, CutTerms};
use crate::plant::scenario::{Scenario, ToolCount};
use crate::stability::rightmost_cut_root;
use nalgebra::Complex;
use std::f64::consts::TAU;
use std::ops::Range;

/// Samples of one recording under one condition.
#[derive(Debug, Clone)]
pub(crate) struct Stretch {
    /// Index of the recording.
    pub(crate) recording: usize,
    /// Samples.
    pub(crate) samples: Range<usize>,
}

/// The stretches of all recordings.
#[derive(Debug, Clone, Default)]
pub(crate) struct Stretches {
    /// Stationary.
    pub(crate) calm: Vec<Stretch>,
    /// Linear, with vibration that swells or fades.
    pub(crate) followed: Vec<Stretch>,
    /// Recordings without a random force, by index: somewhere in a cut they are quieter than any machine.
    /// Their vibration is none that a random force makes; means and lines of the spindle are what they are.
    pub(crate) silent: Vec<usize>,
}

impl Stretches {
    /// The same with every stretch in up to `parts` pieces of one length, none shorter than one must be that
    /// is followed.
    pub(crate) fn divided(&self, recordings: &[CutRecording], parts: usize) -> Self {
        let of = |stretch: &Stretch| {
            let Stretch { recording, samples } = stretch.clone();
            let shortest = CRITERIA.shortest_followed_s * recordings[recording].sample_rate.hz();
            let count = ((samples.len() as f64 / shortest) as usize).clamp(1, parts);
            let edge = move |k: usize| samples.start + samples.len() * k / count;
            (0..count).map(move |k| Stretch { recording, samples: edge(k)..edge(k + 1) })
        };
        let divided = |all: &[Stretch]| all.iter().flat_map(of).collect();
        Self { calm: divided(&self.calm), followed: divided(&self.followed), silent: self.silent.clone() }
    }

    /// True where a random force drives what a stretch shows.
    pub(crate) fn is_random(&self, stretch: &Stretch) -> bool {
        !self.silent.contains(&stretch.recording)
    }
}

/// Condition of a recording at a sample.
pub(crate) fn condition(recording: &CutRecording, at: usize, scenario: &Scenario) -> CutCondition {
    let time_s = at as f64 / recording.sample_rate.hz();
    CutCondition {
        speed_rpm: recording.spindle_speed_rpm[at],
        feed_m_rev: recording.feed_m_rev[at],
        width_m: recording.width_m[at],
        position_m: recording.tool_position_m[at],
        pitch_difference_rad: recording.pitch_difference_rad[at],
        diameter_m: recording.workpiece_diameter_m.unwrap_or(scenario.workpiece.diameter_m()),
        time_s,
        edge_age_s: time_s,
    }
}

/// Band in which the forces of a recording say something, Hz.
///
/// From below the bar up to where the signal's filter still leaves a third, and to where the lines of a cut
/// may lie, above the bar; where no filter is stated, to what a second mode may reach: three times the bar.
/// Never beyond what the rate can hold.
pub(crate) fn band_hz(recording: &CutRecording, scenario: &Scenario) -> [f64; 2] {
    let natural = scenario.workpiece.bending_frequency_hz();
    let corner = |b: f64| CRITERIA.to_bandwidths * b.max(natural);
    let widest = recording.signal.bandwidth_hz.map_or(3.3 * natural, corner);
    [CRITERIA.from_hz.min(0.3 * natural), widest.min(0.4 * recording.sample_rate.hz())]
}

/// The oldest surface that a tool meets, s.
fn longest_delay_s(at: &CutCondition, scenario: &Scenario) -> f64 {
    match scenario.tools.count() {
        ToolCount::One => at.turn_s(),
        ToolCount::Two => at.turn_s() * (0.5 + at.pitch_difference_rad.abs() / (2.0 * TAU)),
    }
}

/// Ranges of samples in which speed, pitch, feed and width stand still and the tools cut.
pub(crate) fn constant(recording: &CutRecording) -> Vec<Range<usize>> {
    let (speed, pitch) = (&recording.spindle_speed_rpm, &recording.pitch_difference_rad);
    let (feed, width) = (&recording.feed_m_rev, &recording.width_m);
    // 1e-4 of itself, or 1e-4 rad: what single precision and the end of a smooth move leave.
    let near = |x: &[f64], a: usize, b: usize| (x[a] - x[b]).abs() <= 1e-4 * x[a].abs();
    let step = 2.0 * width.iter().copied().fold(0.0, f64::max).max(1e-6);
    let masked = |k: usize| recording.masked.get(k).copied().unwrap_or(false);
    let same = |a: usize, b: usize| {
        !masked(a)
            && !masked(b)
            && near(speed, a, b)
            && near(feed, a, b)
            && near(width, a, b)
            && (pitch[a] - pitch[b]).abs() <= 1e-4
            // A tool that jumps along the bar was out of the cut.
            && (recording.tool_position_m[b] - recording.tool_position_m[b.max(1) - 1]).abs() < step
    };
    let (mut out, mut begin) = (Vec::new(), 0);
    while begin < recording.len() {
        let end = (begin + 1..recording.len()).find(|b| !same(begin, *b)).unwrap_or(recording.len());
        if width[begin] > 0.0 && !masked(begin) {
            out.push(begin..end);
        }
        begin = end;
    }
    out
}

/// Forces of a recording in a band, and the bar's motion that they drive.
struct Banded {
    /// Force of each tool, without the signal's filter and delay.
    forces_n: [Vec<f64>; 2],
    /// The same from nought up.
    whole_n: [Vec<f64>; 2],
    /// |F1|^2 + |F2|^2 summed over pieces, its root: loudness.
    loudness_n: Vec<f64>,
    /// Root mean square of the probe over pieces, m; empty: there is none.
    moved_m: Vec<f64>,
    /// Speed of the bar at the tools over surface speed: slope of the surface.
    slope: Vec<f64>,
    /// Samples of a piece of loudness.
    piece: usize,
}

/// A piece of loudness: a tenth of a turn, some periods of the bar, s.
const PIECE_S: f64 = 60.0 / 9000.0;

impl Banded {
    fn new(recording: &CutRecording, scenario: &Scenario) -> Self {
        let n = recording.len();
        let rate = recording.sample_rate.hz();
        let natural = scenario.workpiece.bending_frequency_hz();
        // From the bar's first bending up: a second mode or a holder chatters as well.
        let band = [0.75 * natural, (3.3 * natural).min(band_hz(recording, scenario)[1])];
        let filter = stated_filter(recording);
        let mid = condition(recording, n / 2, scenario);
        let bar = CutLoop::new(&CutTerms::of(scenario, &mid));
        let undone_from = |from: f64| {
            let undone = |f: f64| {
                let inside = f >= from && f <= band[1];
                if inside {
                    signal_response(filter.as_ref(), recording.signal.delay_s, f).finv()
                } else {
                    ZERO
                }
            };
            [0, 1].map(|tool| match &recording.forces_n[tool] {
                Some(force) => filtered(force, rate, &undone),
                None => vec![0.0; n],
            })
        };
        let (forces_n, whole_n) = (undone_from(band[0]), undone_from(0.0));
        let driving: Vec<f64> = forces_n[1].iter().zip(&forces_n[0]).map(|(two, one)| two - one).collect();
        let moved = |f: f64| {
            let s = Complex::new(0.0, TAU * f);
            bar.bar_response(s) * s
        };
        let motion = filtered(&driving, rate, &moved);
        // The bar gives way as the square of its shape; the tools travel and jump.
        let shape = |at: f64| scenario.workpiece.mode_shape(at).powi(2).max(1e-6);
        let own = shape(mid.position_m);
        let slope_of = |(k, v): (usize, &f64)| {
            let at = condition(recording, k, scenario);
            v * shape(at.position_m) / own / at.surface_speed_m_s()
        };
        let slope = motion.iter().enumerate().map(slope_of).collect();
        let length = ((PIECE_S * rate).round() as usize).max(1);
        let over_pieces = |power: &dyn Fn(usize) -> f64| -> Vec<f64> {
            let of = |p: usize| {
                let piece = p * length..((p + 1) * length).min(n);
                (piece.clone().map(power).sum::<f64>() / piece.len() as f64).sqrt()
            };
            (0..n.div_ceil(length)).map(of).collect()
        };
        let loudness_n = over_pieces(&|k| forces_n[0][k].powi(2) + forces_n[1][k].powi(2));
        let inside = |f: f64| Complex::from(if f >= band[0] && f <= band[1] { 1.0 } else { 0.0 });
        let probe = recording.displacement_m.as_ref().map(|y| filtered(y, rate, &inside));
        let moved_m = probe.map_or_else(Vec::new, |y| over_pieces(&|k| y[k].powi(2)));
        Self { forces_n, whole_n, loudness_n, moved_m, slope, piece: length }
    }

    /// The last piece of some in which the probe shows more than random ringing: the forces of a light cut
    /// need not show what an earlier condition left on the bar. Its floor is what the bar does at the end.
    fn last_moved(&self, pieces: &Range<usize>) -> Option<usize> {
        let moved_m = self.moved_m.get(pieces.clone())?;
        let floor_m = rms(&moved_m[moved_m.len() - moved_m.len().div_ceil(3)..]);
        let last = moved_m.iter().rposition(|m| *m > CRITERIA.loud_floors * floor_m)?;
        Some(pieces.start + last)
    }

    /// Loudness of the pieces inside of a range.
    fn loudness(&self, range: &Range<usize>) -> &[f64] {
        let last = (range.end / self.piece).min(self.loudness_n.len());
        &self.loudness_n[range.start.div_ceil(self.piece).min(last)..last]
    }
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

/// Divides the recordings.
///
/// Errors: none; a recording in which nothing stands still has no stretch.
/// Cost: three transforms of each recording.
pub(crate) fn divide(recordings: &[CutRecording], scenario: &Scenario) -> Stretches {
    let banded: Vec<Banded> = recordings.iter().map(|r| Banded::new(r, scenario)).collect();
    let mut blocks = Vec::new();
    for (index, recording) in recordings.iter().enumerate() {
        let rate = recording.sample_rate.hz();
        for range in constant(recording) {
            let met_s = longest_delay_s(&condition(recording, range.start, scenario), scenario);
            let left_out = ((met_s + recording.signal.delay_s) * rate).ceil() as usize;
            if left_out < range.len() {
                blocks.push(Stretch { recording: index, samples: range.start + left_out..range.end });
            }
        }
    }
    // The floor grows with the force: loudness over the mean force, the quietest fifth of the stretches.
    let mean_n = |s: &Stretch| {
        let all = recordings[s.recording].forces_n.iter().flatten();
        all.map(|f| median(&f[s.samples.clone()]).abs()).sum::<f64>().max(1e-6)
    };
    let mut floors: Vec<f64> = blocks
        .iter()
        .map(|s| median(banded[s.recording].loudness(&s.samples)) / mean_n(s))
        .filter(|f| f.is_finite() && *f > 0.0)
        .collect();
    floors.sort_by(f64::total_cmp);
    let floor = floors.get(floors.len() / 5).copied().unwrap_or(0.0);
    let is_silent = |k: &usize| {
        let own = blocks.iter().filter(|s| s.recording == *k);
        let share = own.map(|s| quietest_n(s, recordings) / mean_n(s)).fold(f64::INFINITY, f64::min);
        share < Noise::least_random_share()
    };
    let silent = (0..recordings.len()).filter(is_silent).collect();
    let mut out = Stretches { silent, ..Stretches::default() };
    for block in blocks {
        let loud_n = CRITERIA.loud_floors * floor * mean_n(&block);
        split(&block, &recordings[block.recording], &banded[block.recording], (loud_n, scenario), &mut out);
    }
    out
}

/// Vibration of both forces in the quietest piece of a block. By the samples of that piece alone: a filter
/// of a band remembers chatter that comes later.
fn quietest_n(block: &Stretch, recordings: &[CutRecording]) -> f64 {
    let recording = &recordings[block.recording];
    let length = ((PIECE_S * recording.sample_rate.hz()).round() as usize).max(1);
    let forces: Vec<&[f64]> =
        recording.forces_n.iter().flatten().map(|force| &force[block.samples.clone()]).collect();
    let of = |piece: usize| {
        let range = piece * length..(piece + 1) * length;
        forces.iter().map(|force| rms(&without_line(&force[range.clone()])).powi(2)).sum::<f64>().sqrt()
    };
    (0..block.samples.len() / length).map(of).fold(f64::INFINITY, f64::min)
}

/// The calm end of a block, and what of the rest is linear.
fn split(
    block: &Stretch,
    recording: &CutRecording,
    banded: &Banded,
    (loud_n, scenario): (f64, &Scenario),
    out: &mut Stretches,
) {
    let rate = recording.sample_rate.hz();
    let range = block.samples.clone();
    let loud = |p: &usize| banded.loudness_n[*p] > loud_n;
    let pieces = range.start.div_ceil(banded.piece)..(range.end / banded.piece).min(banded.loudness_n.len());
    let fading = (fading_s(recording, range.start, scenario) * rate) as usize;
    // A calm cut meets what was cut while its own condition held, and so did that.
    let settled = range.start
        + (longest_delay_s(&condition(recording, range.start, scenario), scenario) * rate) as usize;
    let last_loud = pieces.clone().rev().find(loud).max(banded.last_moved(&pieces));
    let after_loud = last_loud.map_or(settled, |p| ((p + 1) * banded.piece + fading).max(settled));
    let mut rest = range.clone();
    // What rings as loud all the time is stationary too, and no calm cut: contact is lost in it.
    let quiet = after_loud.min(range.end)..range.end;
    let own = (range.start, loud_n);
    let last = linear(&quiet, recording, banded, (own, scenario)).pop();
    let tail = last.filter(|t| t.end == range.end).unwrap_or(range.end..range.end);
    if tail.len() as f64 >= CRITERIA.shortest_calm_s * rate && !swells(banded.loudness(&tail)) {
        rest.end = tail.start;
        out.calm.push(Stretch { recording: block.recording, samples: tail });
    }
    let linear = linear(&rest, recording, banded, (own, scenario));
    for linear in linear.into_iter().flat_map(|part| growing(&part, &range, banded, loud_n)) {
        let turn = condition(recording, linear.start, scenario).turn_s() * rate;
        if linear.len() as f64 >= turn {
            out.followed.push(Stretch { recording: block.recording, samples: linear });
        }
    }
}

/// What rang as loud as [`Criteria::loud_floors`] is a tenth of that after this time: a hundredth of the
/// noise in power, s. By the root of the cut as stated, whose growth is good to a few 1/s.
fn fading_s(recording: &CutRecording, at: usize, scenario: &Scenario) -> f64 {
    let cut = CutLoop::new(&CutTerms::of(scenario, &condition(recording, at, scenario)));
    let slowest_1_s = 5.0;
    10f64.ln() / (-rightmost_cut_root(&cut).growth_1_s).max(slowest_1_s)
}

fn swells(loudness: &[f64]) -> bool {
    let third = loudness.len() / 3;
    let (first, last) = (rms(&loudness[..third]), rms(&loudness[loudness.len() - third..]));
    third > 0 && !(last < CRITERIA.swelling * first && first < CRITERIA.swelling * last)
}

/// Parts of a range that stand well below the loudest of its block. What ends the growth of chatter, contact
/// that is lost or a flank that rubs, is felt from there on; this asks nothing of the bar, whose stated
/// frequency may be wrong enough to miss the slope of the surface by its half.
fn growing(part: &Range<usize>, block: &Range<usize>, banded: &Banded, loud_n: f64) -> Vec<Range<usize>> {
    let loudest_n = banded.loudness(block).iter().copied().fold(0.0, f64::max);
    let largest_n = loud_n.max(CRITERIA.largest_of_loudest * loudest_n);
    runs(part, 0, |k| banded.loudness_n.get(k / banded.piece).is_some_and(|l| *l <= largest_n))
}

/// Parts of a range in which every sample is good, and those of a turn before, too.
fn runs(range: &Range<usize>, turn: usize, good: impl Fn(usize) -> bool) -> Vec<Range<usize>> {
    let mut out = Vec::new();
    let first = range.start.saturating_sub(turn);
    let mut since = first;
    for k in first..range.end {
        if !good(k) {
            out.push((since + turn).max(range.start)..k);
            since = k + 1;
        }
    }
    out.push((since + turn).max(range.start)..range.end);
    out.retain(|r| !r.is_empty());
    out
}

/// Parts of a range in which, and for a turn before, no contact is lost and no flank rubs, and nothing was
/// loud under another condition: the wave that it left is none of this cut's.
fn linear(
    range: &Range<usize>,
    recording: &CutRecording,
    banded: &Banded,
    ((own_from, loud_n), scenario): ((usize, f64), &Scenario),
) -> Vec<Range<usize>> {
    if range.is_empty() {
        return Vec::new();
    }
    let at = condition(recording, range.start, scenario);
    let turn = (at.turn_s() * recording.sample_rate.hz()).ceil() as usize;
    let tools = if scenario.tools.count() == ToolCount::Two { 2 } else { 1 };
    // Contact is lost where a force swings down to nothing: from the lesser of what K_r as stated makes of
    // it, which may be wrong, and of what was recorded, which is greater than at rest once contact is lost.
    let model_n = CutLoop::new(&CutTerms::of(scenario, &at)).means().force_n;
    let recorded_n = |j: usize| {
        let force = recording.forces_n[j].as_ref().map(|f| &f[range.clone()]);
        force.map_or(f64::INFINITY, |f| f.iter().sum::<f64>() / f.len() as f64)
    };
    let mean_n = [0, 1].map(|j| model_n[j].min(recorded_n(j)));
    let steep = CRITERIA.largest_swing * scenario.cutting.raw().clearance_rad.tan();
    runs(range, turn, |k| {
        // A tool that is out of the cut for a while does not swing.
        let swing = |j: usize| {
            recording.forces_n[j].is_none()
                || (banded.forces_n[j][k].abs() < CRITERIA.largest_swing * mean_n[j]
                    && banded.whole_n[j][k] > (1.0 - CRITERIA.largest_swing) * mean_n[j])
        };
        let left_n = banded.loudness_n.get(k / banded.piece).copied().unwrap_or(0.0);
        (k >= own_from || left_n <= loud_n) && (0..tools).all(swing) && banded.slope[k].abs() < steep
    })
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::{machine, recording};
    use super::*;

    /// A bar that still rings is not calm, even where the forces no longer show it.
    #[test]
    fn what_the_probe_still_sees_is_not_calm() {
        let scenario = machine().scenario;
        let natural = std::f64::consts::TAU * scenario.workpiece.bending_frequency_hz();
        let noise = |t: f64| 0.3 * (natural * t).sin();
        let mut cuts = recording(&scenario, 2.0, |t| [50.0 + noise(t), 50.0 - noise(t)]);
        let calm =
            |cuts: &CutRecording| divide(std::slice::from_ref(cuts), &scenario).calm[0].samples.clone();
        let all = calm(&cuts);
        let ring = |k: usize| {
            let t = k as f64 / 9000.0;
            (1e-5 * (-8.0 * t).exp() + 1e-7) * (natural * t).cos()
        };
        cuts.displacement_m = Some((0..cuts.len()).map(ring).collect());
        let rung = calm(&cuts);
        assert_eq!(rung.end, all.end);
        // Until 3.5 floors are left: ln(1e-5/2.5e-7)/8, some 0.46 s.
        assert!(rung.start as f64 > all.start as f64 + 0.4 * 9000.0, "{rung:?}, without a probe {all:?}");
    }

    /// Rows that a gate has masked are in no stretch, and a stretch does not go over them.
    #[test]
    fn masked_rows_end_a_stretch() {
        let scenario = machine().scenario;
        let cuts = recording(&scenario, 1.0, |_| [50.0, 50.0]);
        let mut masked = vec![false; cuts.len()];
        masked[4000..4100].fill(true);
        assert_eq!(constant(&cuts), [0..9000]);
        assert_eq!(constant(&cuts.with_masked(masked)), [0..4000, 4100..9000]);
    }

    /// The band is that of the signal, not of one machine: it follows filter, bar and rate.
    #[test]
    fn the_band_follows_the_signal() {
        let scenario = machine().scenario;
        let mut cuts = recording(&scenario, 0.1, |_| [50.0, 50.0]);
        cuts.signal.bandwidth_hz = Some(800.0);
        assert!((band_hz(&cuts, &scenario)[1] - 1040.0).abs() < 1e-9);
        cuts.signal.bandwidth_hz = Some(1e5);
        assert!((band_hz(&cuts, &scenario)[1] - 3600.0).abs() < 1e-9);
    }
}
