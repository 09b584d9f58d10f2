//! A cut: harmonics and a mean in a window, each recording with its own phases and window; and the mean force
//! of tools that cut in one recording while the spindle turns.

use super::*;
use crate::plant::effects::cutting_force::{END, FUNDAMENTAL, HARMONICS, PEAK, SPECIFICATION, START};
use crate::signal::sliding_median::sliding_median;
use rustfft::num_complex::Complex;
use std::f64::consts::TAU;

/// Harmonics of a cut: it is searched by the sum of as many as the first, and where these say anything the
/// others are tried.
const HARMONICS_TRIED: [usize; 4] = [4, 1, 2, 10];

/// Begin and end in each recording, s since it began; those after the last have that of the last.
type Windows = [[f64; 2]; 16];

fn in_all(window_s: [f64; 2]) -> Windows {
    std::array::from_fn(|_| window_s)
}

/// Share of all frequencies that beats may fill: so many cuts are taken for one.
const BEATS: f64 = 0.05;

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| {
        let whole = in_all([0.0, search.signals.longest_s()]);
        let of_spindle = search.signals.spindle_hz().map(|hz| Cut::searched(hz, whole, search.signals));
        let of_spindle = of_spindle.map(|law| Hypothesis::new(Port::Stage, law));
        of_spindle.into_iter().chain(search.lines().iter().copied()).collect()
    },
    ..Effect::of(&SPECIFICATION)
};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Cut {
    pub(crate) hz: f64,
    windows_s: Windows,
    harmonics: usize,
}

/// Frequency with its relative deviation, force with its deviation, and from when to when, both to `sd_s`.
fn tell(sheet: &mut Sheet, [hz, relative]: [f64; 2], [force_n, sd_n]: [f64; 2], window: ([f64; 2], f64)) {
    sheet.constant(&FUNDAMENTAL, hz, relative);
    sheet.force(&PEAK, force_n, sd_n);
    let ([start_s, end_s], sd_s) = window;
    sheet.add(&START, start_s, sd_s);
    sheet.add(&END, end_s, sd_s);
}

impl Signals {
    /// Recordings whose thrust answers to what acts on the axis, with their places.
    pub(crate) fn answering(&self) -> impl Iterator<Item = (usize, &Track)> {
        self.tracks.iter().enumerate().filter(|(_, track)| !track.reference.is_switched)
    }
}

fn facts() -> Facts {
    let facts = Facts::of(EffectKind::CuttingForce, Size::Free, &[]);
    Facts { is_of_one_recording: true, ..facts }
}

impl Cut {
    fn searched(hz: f64, windows_s: Windows, signals: &Signals) -> Self {
        Self { hz, windows_s, harmonics: HARMONICS_TRIED[0] }.below(signals.top_hz())
    }

    /// Without the harmonics above a frequency, the first apart.
    fn below(self, top_hz: f64) -> Self {
        Self { harmonics: self.harmonics.min((top_hz / self.hz) as usize).max(1), ..self }
    }

    /// From when to when it lasts in a recording, s since that began.
    fn window_s(&self, recording: usize) -> [f64; 2] {
        self.windows_s[recording.min(self.windows_s.len() - 1)]
    }

    /// True while it lasts in a recording.
    fn lasts(&self, recording: usize, t_s: f64) -> bool {
        let [start_s, end_s] = self.window_s(recording);
        (start_s..end_s).contains(&t_s)
    }

    /// How long two cuts last at once in one of so many recordings, s at most.
    pub(crate) fn longest_beside_s(&self, other: &Self, recordings: usize) -> f64 {
        let both_s = |(a, b): (&[f64; 2], &[f64; 2])| a[1].min(b[1]) - a[0].max(b[0]);
        self.windows_s.iter().zip(&other.windows_s).take(recordings).map(both_s).fold(0.0, f64::max)
    }

    /// True where it has a mean: one that lasts for all of the recordings is a load, unless a spindle turns.
    fn has_mean(&self, signals: &Signals) -> bool {
        let ends = |(r, _): (usize, &Track)| {
            let [start_s, end_s] = self.window_s(r);
            start_s > 0.0 || end_s < signals.longest_s()
        };
        signals.answering().any(ends) || signals.spindle_hz().is_some()
    }

    /// Recordings that it has columns of, with their places.
    fn recordings(self, signals: &Signals) -> impl Iterator<Item = (usize, &Track)> {
        let step = signals.step;
        let has = move |(r, track): &(usize, &Track)| {
            (0..track.thin_count()).any(|j| self.lasts(*r, track.thin_s(j, step)))
        };
        signals.answering().filter(has)
    }

    /// True where the drive pushes at the frequency of its strongest harmonic with more than twice its force:
    /// a loop with usual margins answers to a force by less, and what a command makes of laws that are left
    /// out is no cut.
    fn is_driven(&self, ground: &Ground<'_>, amplitudes: &[f64]) -> bool {
        let s = ground.signals;
        let harmonics = self.harmonics;
        let length = 2 * harmonics + usize::from(self.has_mean(s));
        let sizes = self.recordings(s).zip(amplitudes.chunks_exact(length)).flat_map(|(of, set)| {
            let waves = set[..2 * harmonics].chunks_exact(2).enumerate();
            waves.map(move |(h, c)| (of, (h + 1) as f64 * self.hz, c[0].hypot(c[1])))
        });
        let Some(((r, track), hz, most_n)) = sizes.max_by(|a, b| a.2.total_cmp(&b.2)) else { return false };
        let thrust = s.thrust(track, ground.path).into_iter().enumerate();
        let thrust: Vec<(f64, f64)> = thrust
            .map(|(j, f)| (track.thin_s(j, s.step), f))
            .filter(|(t_s, _)| self.lasts(r, *t_s))
            .collect();
        0.5 * stands_out_n(&thrust, hz) > most_n
    }

    /// True where it is what the steps of the encoder beat at the even speed of the middle half of its
    /// window: at the ends there may be starts and stops.
    fn is_beat(&self, signals: &Signals, (recording, track): (usize, &Track)) -> bool {
        let [start_s, end_s] = self.window_s(recording);
        let inside = |j: &usize| {
            let t_s = track.thin_s(*j, signals.step);
            (t_s - 0.5 * (start_s + end_s)).abs() < 0.25 * (end_s - start_s)
        };
        let x: Vec<f64> = (0..track.thin_count()).filter(inside).map(|j| track.thin.position[j]).collect();
        let (Some(first), Some(last)) = (x.first(), x.last()) else { return false };
        let step_m = signals.steps_m[0];
        let way_m = |k: usize| k as f64 / (x.len() - 1).max(1) as f64 * (last - first);
        let is_even = x.iter().enumerate().all(|(k, x)| (x - first - way_m(k)).abs() < 2.0 * step_m);
        let long_s = (x.len() - 1) as f64 * signals.step as f64 / track.rate_hz;
        let steps_s = (last - first).abs() / (step_m * long_s).max(f64::MIN_POSITIVE);
        is_even && beats((steps_s, long_s), track.rate_hz, self.hz)
    }
}

/// Amplitude of a line of a force, N, over times, s, more than what is beside it: under a Hann window, of
/// which four bins away nothing is left of a line, and little of steps.
///
/// Checked by: tests::a_line_stands_out_of_friction_and_friction_is_none.
fn stands_out_n(force: &[(f64, f64)], hz: f64) -> f64 {
    let (Some(first), Some(last)) = (force.first(), force.last()) else { return 0.0 };
    let long_s = (last.0 - first.0).max(f64::MIN_POSITIVE);
    let line_n = |hz: f64| {
        let of = |(t_s, f): &(f64, f64)| {
            let window = 0.5 - 0.5 * (TAU * (t_s - first.0) / long_s).cos();
            Complex::from_polar(window * f, -TAU * hz * t_s)
        };
        4.0 * force.iter().map(of).sum::<Complex<f64>>().norm() / force.len() as f64
    };
    line_n(hz) - [-4.0, 4.0].map(|bins| line_n(hz + bins / long_s)).into_iter().fold(0.0, f64::max)
}

/// True for the k-th harmonic of so many steps a second in a log of that rate, |k n - m rate|: the control
/// answers steps faster than the log is written. Of a number of steps that is known to 1 / T the harmonics
/// are told to (k + 1) / T; they are asked as long as they fill less than [`BEATS`] of all frequencies.
///
/// Checked by: tests::a_beat_is_the_harmonic_of_the_steps_that_the_log_folds.
fn beats((steps_s, long_s): (f64, f64), rate_hz: f64, hz: f64) -> bool {
    let mut filled = 0.0;
    (1..)
        .map(|k| (f64::from(k) * steps_s, f64::from(k + 1) / long_s))
        .take_while(|(_, within_hz)| {
            filled += 4.0 * within_hz / rate_hz;
            filled < BEATS
        })
        .any(|(of_steps_hz, within_hz)| {
            let folded_hz = (of_steps_hz - rate_hz * (of_steps_hz / rate_hz).round()).abs();
            (folded_hz - hz).abs() < within_hz
        })
}

impl Law for Cut {
    fn facts(&self) -> Facts {
        facts()
    }

    fn tell(&self, told: &Told<'_>, sheet: &mut Sheet) -> bool {
        let signals = &told.balance.signals;
        let columns = (self.harmonics, self.has_mean(signals));
        let length = 2 * columns.0 + usize::from(columns.1);
        let (set, peak_n) = peak_of_cut(told.amplitudes, columns);
        let sd_n = told.deviation(set * length) * (length as f64).sqrt();
        let of = self.recordings(signals).nth(set).map_or(0, |(r, _)| r);
        tell(sheet, [self.hz, told.relative(0)], [peak_n, sd_n], (self.window_s(of), 0.02));
        true
    }

    fn write(&self, _: &Told<'_>, term: &mut PhysicsTerm) {
        term.push(&HARMONICS, ParameterValue::Number(self.harmonics as f64));
    }

    fn constants(&mut self) -> Vec<Free<'_>> {
        vec![Free::of(&mut self.hz, &FUNDAMENTAL)]
    }

    /// What is above all that is looked at is not seen; what the steps of the encoder beat, or the drive
    /// makes, is no cut.
    fn is_void(&self, ground: &Ground<'_>, amplitudes: &[f64]) -> bool {
        let s = ground.signals;
        let is_beat = || s.sides() == 1 && s.tracks.iter().enumerate().any(|of| self.is_beat(s, of));
        self.hz > s.top_hz() || is_beat() || self.is_driven(ground, amplitudes)
    }

    /// Harmonics and mean in a window; every recording whose thrust answers has columns of its own.
    fn columns(&self, ground: &Ground<'_>, _: Port) -> Option<Vec<TimeColumn>> {
        let s = ground.signals;
        let mut out = Vec::new();
        for (r, _) in self.recordings(s) {
            let mut push = |f: &dyn Fn(f64) -> f64| {
                out.push(ground.in_recording(
                    r,
                    s.last(),
                    |t_s| if self.lasts(r, t_s) { f(t_s) } else { 0.0 },
                ));
            };
            for h in 1..=self.harmonics {
                let w = TAU * self.hz * h as f64;
                push(&|t| (w * t).sin());
                push(&|t| (w * t).cos());
            }
            if self.has_mean(s) {
                push(&|_| 1.0);
            }
        }
        Some(out)
    }

    fn windows_s(&mut self) -> &mut [[f64; 2]] {
        &mut self.windows_s
    }

    /// Its mean is a load as long as it lasts; where a spindle turns it is the cut's.
    fn told_beside(&self, signals: &Signals) -> Vec<Hypothesis> {
        let load = Hypothesis::new(Port::Stage, super::gravity_load::Gravity);
        signals.spindle_hz().map_or_else(|| vec![load], |_| Vec::new())
    }

    fn sizes(&self, signals: &Signals) -> Vec<Shape> {
        let of =
            |harmonics: &usize| Self { harmonics: *harmonics, ..*self }.below(signals.top_hz()).harmonics;
        let mut others: Vec<usize> =
            HARMONICS_TRIED.iter().map(of).filter(|n| *n != self.harmonics).collect();
        others.sort_unstable();
        others.dedup();
        others.into_iter().map(|harmonics| Self { harmonics, ..*self }.into()).collect()
    }

    fn repeated(&self, times: f64, signals: &Signals) -> Option<Shape> {
        Some(Self { hz: times * self.hz, ..*self }.below(signals.top_hz()).into())
    }
}

/// The mean force in a window of one recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Push {
    pub(crate) recording: usize,
    pub(crate) spindle_hz: f64,
    /// Begin and end, s since the recording began.
    pub(crate) window_s: [f64; 2],
}

impl Law for Push {
    fn facts(&self) -> Facts {
        facts()
    }

    fn tell(&self, told: &Told<'_>, sheet: &mut Sheet) -> bool {
        let force = [told.amplitude(0), told.deviation(0)];
        tell(sheet, [self.spindle_hz, 0.0], force, (self.window_s, 1.0 / self.spindle_hz));
        true
    }

    fn columns(&self, ground: &Ground<'_>, _: Port) -> Option<Vec<TimeColumn>> {
        let [start_s, end_s] = self.window_s;
        let inside = |t_s: f64| f64::from(u8::from((start_s..end_s).contains(&t_s)));
        Some(vec![ground.in_recording(self.recording, ground.signals.last(), inside)])
    }

    fn windows_s(&mut self) -> &mut [[f64; 2]] {
        std::slice::from_mut(&mut self.window_s)
    }
}

/// Largest force of a cut over a period, its mean included, of the set of amplitudes where it is largest.
///
/// A tool that cuts part of the time pushes in pulses: their height is what the machine feels, not the
/// amplitude of one harmonic.
fn peak_of_cut(amplitudes: &[f64], (harmonics, has_mean): (usize, bool)) -> (usize, f64) {
    /// Places in a period.
    const PLACES: usize = 360;
    // Sine and cosine of each harmonic, then the mean.
    let length = 2 * harmonics + usize::from(has_mean);
    let force_n = |set: &[f64], place: usize| {
        let (waves, mean) = set.split_at(2 * harmonics);
        let turn = TAU * place as f64 / PLACES as f64;
        let of = |(h, c): (usize, &[f64])| {
            let (sin, cos) = ((h + 1) as f64 * turn).sin_cos();
            c[0] * sin + c[1] * cos
        };
        (mean.iter().sum::<f64>() + waves.chunks_exact(2).enumerate().map(of).sum::<f64>()).abs()
    };
    let peaks =
        amplitudes.chunks_exact(length).map(|set| (0..PLACES).map(|k| force_n(set, k)).fold(0.0, f64::max));
    peaks.enumerate().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0))
}

impl Search<'_> {
    /// Where lines of what is left may be a cut.
    pub(crate) fn found_lines(&self) -> Vec<Hypothesis> {
        match self.signals.layout {
            Layout::Locked => Vec::new(),
            Layout::TwoPositions | Layout::OnePosition => cuts(self.balance, &self.left),
        }
    }

    /// Ways in a period of each line, at the middle one of the speeds that the axis has while it lasts, m.
    pub(crate) fn ways_of_lines(&self) -> Vec<f64> {
        self.lines().iter().filter_map(|h| self.way_of_line(h)).collect()
    }

    fn way_of_line(&self, h: &Hypothesis) -> Option<f64> {
        let Shape::Cut(cut) = h.shape else { return None };
        let mut speeds = Vec::new();
        for (r, track) in self.signals.tracks.iter().enumerate() {
            let inside = |j: &usize| cut.lasts(r, track.thin_s(*j, self.signals.step));
            speeds.extend((0..track.thin_count()).filter(inside).map(|j| track.thin.velocity[0][j].abs()));
        }
        speeds.sort_by(f64::total_cmp);
        speeds.get(speeds.len() / 2).map(|v| v / cut.hz).filter(|way_m| *way_m > 0.0)
    }
}

/// Lines that stand out of the unwhitened stage balance with their harmonics, for a while.
fn cuts(balance: &Balance, left: &Column) -> Vec<Hypothesis> {
    let s = &balance.signals;
    let Some(spectrum) = &left.sides[s.last()] else { return Vec::new() };
    let bin_hz = balance.plan.bin_hz;
    let series = balance.plan.series(spectrum, &s.lengths());
    let mut best: Vec<(f64, f64, usize)> = Vec::new();
    for (r, _) in s.answering() {
        let blocks = balance.plan.powers(spectrum, r);
        let bins = blocks.first().map_or(0, |b| b.1.len());
        if bins < 32 {
            continue;
        }
        let mut over = vec![0.0; bins];
        for (_, power) in &blocks {
            let floor = sliding_median(power, 12);
            for ((over, p), f) in over.iter_mut().zip(power).zip(&floor) {
                *over += (p / f.max(1e-300) - 1.0).clamp(0.0, 200.0) / blocks.len() as f64;
            }
        }
        // With as many harmonics as pay a price of one each: a third of a line's frequency explains it too.
        let of = |k: usize| {
            let each = (1..=HARMONICS_TRIED[0]).map(|h| over.get(h * k).map_or(-1.0, |over| over - 1.0));
            let sums = each.scan(0.0, |sum, next| {
                *sum += next;
                Some(*sum)
            });
            sums.fold(f64::NEG_INFINITY, f64::max)
        };
        let sums: Vec<f64> = (0..bins).map(of).collect();
        let mut order: Vec<usize> = (4..bins - 1).collect();
        order.sort_by(|a, b| sums[*b].total_cmp(&sums[*a]));
        best.extend(order.into_iter().take(2).map(|k| (sums[k], k as f64 * bin_hz, r)));
    }
    best.sort_by(|a, b| b.0.total_cmp(&a.0));
    best.truncate(2);
    best.into_iter().filter_map(|(_, hz, r)| cut_at(balance, &series, (hz, r))).collect()
}

/// The line near `hz` in one recording, and where its envelope is above half of its plateau in that one and
/// in each other one.
fn cut_at(balance: &Balance, series: &[Vec<f64>], (hz, recording): (f64, usize)) -> Option<Hypothesis> {
    let s = &balance.signals;
    let line = Demodulated::new(s, &series[recording], (hz, recording));
    let reach = balance.plan.bin_hz.min(0.45 / line.each_s);
    let hz = hz + strongest_off(std::slice::from_ref(&line), reach);
    let mut windows_s = in_all(plateau_s(&line)?);
    let last = windows_s.len() - 1;
    for (r, _) in s.answering().filter(|(r, _)| *r <= last && *r != recording) {
        windows_s[r] = plateau_s(&Demodulated::new(s, &series[r], (hz, r))).unwrap_or(windows_s[r]);
    }
    Some(Hypothesis::new(Port::Stage, Cut::searched(hz, windows_s, s)))
}

/// Where the envelope of a line is above half of its plateau, s.
fn plateau_s(line: &Demodulated) -> Option<[f64; 2]> {
    let sizes: Vec<f64> = line.sums.iter().map(|v| v.norm()).collect();
    let mut sorted = sizes.clone();
    sorted.sort_by(f64::total_cmp);
    let plateau = sorted.get(sorted.len() * 9 / 10)?;
    let above: Vec<bool> = sizes.iter().map(|v| *v > 0.5 * plateau).collect();
    let (from, to) = longest_run(&above)?;
    Some([from, to].map(|c| line.first_s + c as f64 * line.each_s))
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

#[cfg(test)]
mod tests {
    use super::{beats, stands_out_n};

    /// A push of 3 N at 12.5 Hz beside friction of 20 N that turns over with strokes of 0.7 s.
    #[test]
    fn a_line_stands_out_of_friction_and_friction_is_none() {
        let of = |line_n: f64| -> Vec<(f64, f64)> {
            let times = (0..20_000).map(|k| 1e-3 * f64::from(k));
            let friction_n = |t_s: f64| if ((t_s / 0.7) as u32).is_multiple_of(2) { 20.0 } else { -20.0 };
            times
                .map(|t_s| (t_s, friction_n(t_s) + line_n * (std::f64::consts::TAU * 12.5 * t_s).sin()))
                .collect()
        };
        let (with, without) = (stands_out_n(&of(3.0), 12.5), stands_out_n(&of(0.0), 12.5));
        assert!((with - 3.0).abs() < 0.3, "{with} N");
        assert!(without < 0.3, "{without} N");
        assert!(stands_out_n(&[], 12.5) == 0.0);
    }

    /// Three times 5012 1/3 steps a second are 15037: 37 Hz of a log of 1 kHz.
    #[test]
    fn a_beat_is_the_harmonic_of_the_steps_that_the_log_folds() {
        assert!(beats((15_037.0 / 3.0, 10.0), 1000.0, 37.0));
        assert!(!beats((15_037.0 / 3.0, 10.0), 1000.0, 41.0));
        // In too short a time anything might be one: the third is not asked.
        assert!(!beats((15_037.0 / 3.0, 0.5), 1000.0, 37.0));
    }
}
