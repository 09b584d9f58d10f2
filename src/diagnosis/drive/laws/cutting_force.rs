//! A cut: harmonics and a mean in a window, each recording with its own phases; and the mean force of tools
//! that cut in one recording while the spindle turns.

use super::*;
use crate::plant::effects::cutting_force::{END, FUNDAMENTAL, HARMONICS, PEAK, SPECIFICATION, START};
use crate::signal::sliding_median::sliding_median;
use std::f64::consts::TAU;

/// Harmonics of a cut.
const CUT_HARMONICS: usize = 10;
/// Harmonics whose sum a cut is searched by.
const SEARCHED_HARMONICS: usize = 4;

/// Share of all frequencies that beats may fill: so many cuts are taken for one.
const BEATS: f64 = 0.05;

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| {
        let whole = [0.0, search.signals.longest_s()];
        let of_spindle = search.signals.spindle_hz().map(|hz| Cut { hz, window_s: whole });
        let of_spindle = of_spindle.map(|law| Hypothesis::new(Port::Stage, law));
        of_spindle.into_iter().chain(search.lines().iter().copied()).collect()
    },
    ..Effect::of(&SPECIFICATION)
};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Cut {
    pub(crate) hz: f64,
    /// Begin and end, s since the recording began.
    pub(crate) window_s: [f64; 2],
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
    /// Harmonics up to the highest frequency looked at.
    fn harmonics(&self, signals: &Signals) -> usize {
        CUT_HARMONICS.min(((signals.top_hz() / self.hz) as usize).max(1))
    }

    /// True where it is what the steps of the encoder beat at the even speed of the middle half of its
    /// window: at the ends there may be starts and stops.
    fn is_beat(&self, signals: &Signals, track: &Track) -> bool {
        let [start_s, end_s] = self.window_s;
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
        let harmonics = self.harmonics(&told.balance.signals);
        let peak = peak_of_cut(told.amplitudes, harmonics, told.deviation(0));
        tell(sheet, [self.hz, told.relative(0)], peak, (self.window_s, 0.02));
        true
    }

    fn write(&self, _: &Told<'_>, term: &mut PhysicsTerm) {
        term.push(&HARMONICS, ParameterValue::Number(CUT_HARMONICS as f64));
    }

    fn constants(&mut self) -> Vec<Free<'_>> {
        vec![Free::of(&mut self.hz, &FUNDAMENTAL)]
    }

    /// What is above all that is looked at is not seen; what the steps of the encoder beat is no cut.
    fn is_void(&self, ground: &Ground<'_>, _: &[f64]) -> bool {
        let s = ground.signals;
        self.hz > s.top_hz() || s.sides() == 1 && s.tracks.iter().any(|t| self.is_beat(s, t))
    }

    /// Harmonics and mean in a window; every recording whose thrust answers has columns of its own.
    fn columns(&self, ground: &Ground<'_>, _: Port) -> Option<Vec<TimeColumn>> {
        let Self { hz, window_s: [start_s, end_s] } = *self;
        let s = ground.signals;
        let inside = |t_s: f64| (start_s..end_s).contains(&t_s);
        let mut out = Vec::new();
        for (r, track) in s.answering() {
            if !(0..track.thin_count()).any(|j| inside(track.thin_s(j, s.step))) {
                continue;
            }
            let mut push = |f: &dyn Fn(f64) -> f64| {
                out.push(ground.in_recording(r, s.last(), |t_s| if inside(t_s) { f(t_s) } else { 0.0 }));
            };
            for h in 1..=self.harmonics(s) {
                let w = TAU * hz * h as f64;
                push(&|t| (w * t).sin());
                push(&|t| (w * t).cos());
            }
            push(&|_| 1.0);
        }
        Some(out)
    }

    fn window_s(&mut self) -> Option<&mut [f64; 2]> {
        Some(&mut self.window_s)
    }

    fn repeated(&self, times: f64) -> Option<Shape> {
        Some(Self { hz: times * self.hz, ..*self }.into())
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

    fn window_s(&mut self) -> Option<&mut [f64; 2]> {
        Some(&mut self.window_s)
    }
}

/// Largest force of a cut over a period, its mean included, of the recording where it is largest.
///
/// A tool that cuts part of the time pushes in pulses: their height is what the machine feels, not the
/// amplitude of one harmonic.
fn peak_of_cut(amplitudes: &[f64], harmonics: usize, deviation: f64) -> [f64; 2] {
    /// Places in a period.
    const PLACES: usize = 360;
    // Sine and cosine of each harmonic, then the mean.
    let length = 2 * harmonics + 1;
    let mut most = 0.0_f64;
    for set in amplitudes.chunks_exact(length) {
        for place in 0..PLACES {
            let turn = TAU * place as f64 / PLACES as f64;
            let waves = set[..length - 1].chunks_exact(2).enumerate();
            let wave: f64 = waves
                .map(|(h, c)| {
                    let (sin, cos) = ((h + 1) as f64 * turn).sin_cos();
                    c[0] * sin + c[1] * cos
                })
                .sum();
            most = most.max((set[length - 1] + wave).abs());
        }
    }
    [most, deviation * (length as f64).sqrt()]
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
        let Shape::Cut(Cut { hz, window_s: [start_s, end_s] }) = h.shape else { return None };
        let mut speeds = Vec::new();
        for track in &self.signals.tracks {
            let inside = |j: &usize| (start_s..end_s).contains(&track.thin_s(*j, self.signals.step));
            speeds.extend((0..track.thin_count()).filter(inside).map(|j| track.thin.velocity[0][j].abs()));
        }
        speeds.sort_by(f64::total_cmp);
        speeds.get(speeds.len() / 2).map(|v| v / hz).filter(|way_m| *way_m > 0.0)
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
        let mut sums = vec![0.0; bins];
        for (_, power) in &blocks {
            let floor = sliding_median(power, 12);
            let ratios: Vec<f64> = power.iter().zip(&floor).map(|(p, f)| p / f.max(1e-300)).collect();
            for k in 3..bins {
                let of = |h: usize| ratios.get(h * k).map_or(0.0, |r| (r - 1.0).clamp(0.0, 200.0));
                sums[k] += (1..=SEARCHED_HARMONICS).map(of).sum::<f64>() / blocks.len() as f64;
            }
        }
        let mut order: Vec<usize> = (4..bins - 1).collect();
        order.sort_by(|a, b| sums[*b].total_cmp(&sums[*a]));
        best.extend(order.into_iter().take(2).map(|k| (sums[k], k as f64 * bin_hz, r)));
    }
    best.sort_by(|a, b| b.0.total_cmp(&a.0));
    best.truncate(2);
    best.into_iter().filter_map(|(_, hz, r)| cut_at(balance, &series[r], (hz, r))).collect()
}

/// The line near `hz` in one recording, where its envelope is above half of its plateau.
fn cut_at(balance: &Balance, x: &[f64], (hz, recording): (f64, usize)) -> Option<Hypothesis> {
    let line = Demodulated::new(&balance.signals, x, (hz, recording));
    let reach = balance.plan.bin_hz.min(0.45 / line.each_s);
    let off = strongest_off(std::slice::from_ref(&line), reach);
    let sizes: Vec<f64> = line.sums.iter().map(|v| v.norm()).collect();
    let mut sorted = sizes.clone();
    sorted.sort_by(f64::total_cmp);
    let plateau = sorted[sorted.len() * 9 / 10];
    let above: Vec<bool> = sizes.iter().map(|v| *v > 0.5 * plateau).collect();
    let (from, to) = longest_run(&above)?;
    let edge = |c: usize| line.first_s + c as f64 * line.each_s;
    Some(Hypothesis::new(Port::Stage, Cut { hz: hz + off, window_s: [edge(from), edge(to)] }))
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
    use super::beats;

    /// Three times 5012 1/3 steps a second are 15037: 37 Hz of a log of 1 kHz.
    #[test]
    fn a_beat_is_the_harmonic_of_the_steps_that_the_log_folds() {
        assert!(beats((15_037.0 / 3.0, 10.0), 1000.0, 37.0));
        assert!(!beats((15_037.0 / 3.0, 10.0), 1000.0, 41.0));
        // In too short a time anything might be one: the third is not asked.
        assert!(!beats((15_037.0 / 3.0, 0.5), 1000.0, 37.0));
    }
}
