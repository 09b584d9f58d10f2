//! From recordings to aligned, low-passed signals of one axis: at the full rate for laws that are not linear,
//! thinned for the balance.

use super::following::Following;
use super::one_mass::THINNED_PER_BAND;
pub(in crate::diagnosis) use super::reads::Layout;
use super::reads::{KERNELS, Read, Side, band_hz, clean_band_hz, positions, stage_behind, stage_is_finer};
use super::recorded::{Thrust, has_both_positions, is_locked, motor_position, position, position_at, thrust};
use super::sliding::{classes, turns};
use super::spectra::{SHORTEST_BLOCK, Series};
use super::standstill::standstill;
use super::turning::{Bands, Turning};
use crate::diagnosis::DiagnoseError;
use crate::diagnosis::criteria::Criteria;
use crate::diagnosis::cuts::{Mask, spindle_hz};
use crate::diagnosis::encoder_noise::{SpeedOfStep, rounding_m};
use crate::diagnosis::kernel::{Action, Grid, Kernel, ring_s};
use crate::diagnosis::steps::coarser_step;
use crate::plant::drive::{DriveParams, Structure};
use crate::plant::effects::Port;
use crate::plant::machine::AxisModel;
use crate::sample::Recording;
use crate::signal::inner_products::{dot, rms};
use std::f64::consts::TAU;

/// Part of a recording that a slow thrust filter may take at either end.
const PATH_PARTS: usize = 12;

/// One recording of one axis.
#[derive(Debug, Clone)]
pub(super) struct Track {
    pub(super) experiment: String,
    pub(super) start_s: f64,
    pub(super) rate_hz: f64,
    /// Sample of the recording at which the full-rate series begin.
    pub(super) full_first: usize,
    /// The same of the thinned ones.
    pub(super) thin_first: usize,
    pub(super) samples: usize,
    pub(super) reference: Thrust,
    /// Of a spindle that may drive a cut, turns a second.
    pub(super) spindle_hz: Option<f64>,
    /// Motor and stage; on an axis with one position the second is as the stated screw moves it, or empty.
    pub(super) sides: [Side; 2],
    /// x_m - x_t about its mean, full rate.
    pub(super) stretch_m: Vec<f64>,
    pub(super) thin: Thin,
    /// Thinned samples that were not measured.
    pub(super) masked: Vec<bool>,
    /// What both balances are multiplied by, thinned, one in the mean square; see [`Signals::weight`].
    pub(super) weight: Vec<f64>,
    /// Of two positions: how freely each full-rate sample slides.
    pub(super) classes: Vec<u8>,
    /// Thinned samples in which the axis rests, where there is one position: friction balances what there is.
    pub(super) rests: Vec<bool>,
}

/// Thinned linear signals.
#[derive(Debug, Clone, Default)]
pub(super) struct Thin {
    pub(super) accel: [Vec<f64>; 2],
    pub(super) velocity: [Vec<f64>; 2],
    pub(super) position: Vec<f64>,
    pub(super) stretch: Vec<f64>,
    pub(super) stretch_rate: Vec<f64>,
}

/// All recordings, and the filters that made them.
pub(super) struct Signals {
    pub(super) layout: Layout,
    /// Whether the position of motor and of stage is balanced.
    balanced: [bool; 2],
    pub(super) rate_hz: f64,
    pub(super) band_hz: f64,
    pub(super) step: usize,
    /// Step of motor and stage encoder as found, m.
    pub(super) steps_m: [f64; 2],
    /// Speed over which friction turns, m/s.
    pub(super) smoothing_m_s: f64,
    pub(super) tracks: Vec<Track>,
    /// Lead of the screw, where there is one, m.
    pub(super) lead_m: Option<f64>,
    /// See [`DriveParams::motor_waves_m`].
    pub(super) motor_waves_m: Vec<f64>,
    /// Of one position: way that the spring gives under the stage's friction, m.
    pub(super) wound_m: f64,
    /// Of the motor's position alone: the stage behind it, where the model states it.
    pub(super) following: Option<Following>,
    /// Of one position: variance of its noise in each recording, m2.
    pub(super) noise_m2: Vec<f64>,
    /// Kernels without a shift: signal, first and second derivative.
    kernels: [Kernel; 3],
    /// Of the velocity of laws that are not linear, each side's.
    of_velocity: [Kernel; 2],
    /// What averages the thrust and the positions so that both are averaged alike, and laws with them.
    means: [Kernel; 2],
}

/// How this axis is balanced.
pub(in crate::diagnosis) fn layout(axis: &AxisModel, recordings: &[Recording]) -> Layout {
    let flexible = axis.drive.structure() != Structure::Rigid;
    if recordings.iter().all(|r| is_locked(axis, r)) {
        return Layout::Locked;
    }
    if !flexible || !recordings.iter().all(|r| has_both_positions(axis, r)) {
        return Layout::OnePosition;
    }
    // Errors in variables: noise of the steps over the stretch, of all recordings together. The stiffness is
    // wrong by the square of what is let through, a hundredth.
    let mut power = [0.0; 2];
    for r in recordings {
        let Ok(t) = thrust(axis, r) else { return Layout::OnePosition };
        let swing_n = swing_n(axis, r, &t.reference_n);
        let [motor_m, stage_m] = found_steps_m(axis, r);
        power[0] += swing_n.len() as f64 * (motor_m * motor_m + stage_m * stage_m) / 12.0;
        power[1] += dot(&swing_n, &swing_n) / axis.drive.axial_stiffness_n_m().powi(2);
    }
    let resolved = power[0].sqrt() < Criteria::STANDARD.step_share * power[1].sqrt();
    if resolved { Layout::TwoPositions } else { Layout::OnePosition }
}

/// Change of the thrust over half a period of the axial resonance: what makes the screw swing. A load that
/// stands shows its spring, and neither masses nor dampings of its ends.
fn swing_n(axis: &AxisModel, recording: &Recording, thrust_n: &[f64]) -> Vec<f64> {
    let (d, rate_hz) = (&axis.drive, recording.sample_rate.hz());
    let (motor_kg, stage_kg) = (d.reflected_mass_kg(), d.movable_mass_kg());
    let resonance_rad_s = (d.axial_stiffness_n_m() * (motor_kg + stage_kg)
        / (motor_kg * stage_kg).max(f64::MIN_POSITIVE))
    .sqrt();
    let half = ((0.5 * TAU * rate_hz / resonance_rad_s) as usize).clamp(1, thrust_n.len() / 2);
    thrust_n.iter().zip(&thrust_n[half..]).map(|(before, after)| after - before).collect()
}

/// Steps of motor and stage encoder, m: as stated or as the recording has them.
pub(super) fn found_steps_m(axis: &AxisModel, recording: &Recording) -> [f64; 2] {
    let rate_hz = recording.sample_rate.hz();
    let stated = [axis.drive.motor_encoder_resolution_m(), axis.drive.stage_encoder_resolution_m()];
    let raw = [Port::MotorEncoder, Port::StageEncoder].map(|port| position_at(axis, recording, port));
    std::array::from_fn(|k| {
        let Some(x) = &raw[k] else { return stated[k] };
        let step_m = stated[k].max(coarser_step(x, stated[k].max(1e-12)).unwrap_or(0.0));
        let of_noise_m = rounding_m(x, rate_hz);
        if of_noise_m > Criteria::STANDARD.coarser_step * step_m { of_noise_m } else { step_m }
    })
}

impl Signals {
    /// Reads, aligns and filters. `masks`: per recording, rows that were not measured (the caller has bridged
    /// them); empty: none. `averaged`: rows that force and positions were averaged over by the logger.
    /// Errors: a missing column, no torque constant, a recording shorter than the filters.
    pub(super) fn new(
        axis: &AxisModel,
        recordings: &[Recording],
        masks: &[Mask],
        averaged: [usize; 2],
    ) -> Result<Self, DiagnoseError> {
        let layout = layout(axis, recordings);
        let rate_hz = recordings.first().map_or(1.0, |r| r.sample_rate.hz());
        let steps_m = recordings
            .iter()
            .map(|r| found_steps_m(axis, r))
            .fold([0.0_f64; 2], |a, b| [a[0].max(b[0]), a[1].max(b[1])]);
        let by_stage = layout == Layout::OnePosition && stage_is_finer(axis, recordings);
        let two = layout == Layout::TwoPositions;
        let is_of_stage = by_stage || recordings.iter().all(|r| motor_position(axis, r).is_none());
        let steps_m = if two || !is_of_stage { steps_m } else { [steps_m[1]; 2] };
        let positions: Vec<Vec<Read>> =
            recordings.iter().map(|r| positions(axis, r, (layout, by_stage))).collect();
        let of_one = |read: &Vec<Read>| read.first().filter(|_| !two).map_or(0.0, |x| x.noise_m2(rate_hz));
        let clean_hz = recordings.iter().zip(&positions).flat_map(|(r, all)| {
            all.iter().map(|read| clean_band_hz(axis, r, (read.mass_kg, read.noise_m2(rate_hz))))
        });
        let one_mass = (layout == Layout::OnePosition).then(|| stage_behind(axis, recordings)).flatten();
        let band_hz = band_hz((layout, rate_hz), one_mass).min(clean_hz.fold(f64::INFINITY, f64::min));
        let has_motor_alone = layout == Layout::OnePosition && !is_of_stage;
        let of_step = steps_m.map(|step_m| SpeedOfStep { step_m, rate_hz });
        let shortest = recordings.iter().map(Recording::len).min().unwrap_or(1);
        let narrowest_hz = KERNELS * rate_hz / shortest as f64;
        let bands = Bands::new(axis, (band_hz, rate_hz), narrowest_hz, &of_step);
        let turning = bands.of_one().next().filter(|_| !two).unwrap_or_else(|| bands.of_two());
        let most = averaged[0].max(averaged[1]);
        let mean_of_laws = Kernel::mean(most);
        let low_pass = |hz, derivative| Kernel::low_pass(hz, rate_hz, Action { derivative, advance_s: 0.0 });
        let mut signals = Self {
            layout,
            balanced: [two || !is_of_stage, two || is_of_stage],
            rate_hz,
            band_hz,
            step: ((rate_hz / (THINNED_PER_BAND * band_hz)) as usize).max(1),
            steps_m,
            smoothing_m_s: turning.smoothing_m_s,
            tracks: Vec::new(),
            lead_m: axis.drive.screw_lead_m(),
            motor_waves_m: axis.drive.motor_waves_m(),
            wound_m: one_mass.map_or(0.0, |s| s.wound_m),
            following: has_motor_alone.then(|| Following::stated(&axis.drive, rate_hz)).flatten(),
            noise_m2: positions.iter().map(of_one).collect(),
            kernels: [0, 1, 2].map(|derivative| low_pass(band_hz, derivative).after(&mean_of_laws)),
            of_velocity: turning.velocity_hz.map(|hz| low_pass(hz, 1)),
            means: averaged.map(|rows| Kernel::mean(if rows > 1 { 1 } else { most })),
        };
        let read = |signals: &Self, turning: &Turning| -> Result<Vec<Track>, DiagnoseError> {
            let mask = |k: usize| masks.get(k).map_or(&[][..], Vec::as_slice);
            let all = recordings.iter().zip(&positions).enumerate();
            all.map(|(k, (r, read))| signals.track(axis, r, (read, turning.velocity_hz, mask(k)))).collect()
        };
        signals.tracks = read(&signals, &turning)?;
        let ways: Vec<Turning> = bands.of_one().filter(|_| !two).collect();
        let all = signals.left(&positions, &ways).into_iter().zip(ways);
        let best = all.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, t)| t);
        if let Some(told) = best.filter(|t| *t != turning) {
            signals.smoothing_m_s = told.smoothing_m_s;
            signals.of_velocity = told.velocity_hz.map(|hz| low_pass(hz, 1));
            signals.tracks = read(&signals, &told)?;
        }
        let count: usize = signals.tracks.iter().map(|t| t.stretch_m.len()).sum();
        let mean = signals.tracks.iter().flat_map(|t| &t.stretch_m).sum::<f64>() / count.max(1) as f64;
        for track in &mut signals.tracks {
            track.stretch_m.iter_mut().for_each(|d| *d -= mean);
            track.thin.stretch.iter_mut().for_each(|d| *d -= mean);
        }
        Ok(signals)
    }

    fn track(
        &self,
        axis: &AxisModel,
        recording: &Recording,
        (positions, velocity_hz, mask): (&[Read], [f64; 2], &[bool]),
    ) -> Result<Track, DiagnoseError> {
        let reference = thrust(axis, recording)?;
        if positions.is_empty() {
            position(axis, recording)?;
        }
        let samples = recording.len();
        let path_half = self.path_half(axis).min(samples / PATH_PARTS);
        let of_side = |(read, hz): (&Read, &f64)| self.low_pass(hz.min(self.band_hz), 1, read.delay_s).half();
        let halves = positions.iter().zip(&velocity_hz).map(of_side);
        let full_first = halves.max().unwrap_or(0).max(path_half) + 1;
        let thin_first = full_first + self.kernels.iter().map(Kernel::half).max().unwrap_or(0) + 1;
        // Two half-overlapping blocks.
        let needed = 2 * thin_first + 3 * SHORTEST_BLOCK / 2 * self.step;
        if samples < needed {
            let (recording, below_hz) = (recording.experiment.clone(), self.top_hz());
            return Err(DiagnoseError::TooShort {
                recording,
                samples,
                needed,
                below_hz,
                rests: false,
                one: true,
            });
        }
        let full = Grid { first: full_first, step: 1, count: samples - 2 * full_first };
        let inside = samples - 2 * thin_first;
        let thin = Grid { first: thin_first, step: self.step, count: inside.div_ceil(self.step) };
        let (sides, mut out) = self.moved(positions, velocity_hz, [full, thin]);
        let stretch_m = match self.layout {
            Layout::TwoPositions => difference(&sides[0].x_m, &sides[1].x_m),
            Layout::Locked => sides[0].x_m.clone(),
            Layout::OnePosition => Vec::new(),
        };
        if !stretch_m.is_empty() {
            // The full-rate series has passed the low-pass once as well.
            out.stretch_rate = match self.layout {
                Layout::TwoPositions => difference(&out.velocity[0], &out.velocity[1]),
                _ => out.velocity[0].clone(),
            };
            out.stretch = self.means[1].apply(&stretch_m, Grid { first: thin_first - full_first, ..thin });
        }
        let near = |rows: &[bool], reach: usize| -> Vec<bool> {
            let of = |centre: usize| {
                let part = rows.get(centre.saturating_sub(reach)..(centre + reach).min(rows.len()));
                part.is_some_and(|part| part.contains(&true))
            };
            (0..thin.count).map(|j| of(thin_first + j * self.step)).collect()
        };
        let stands = match self.layout {
            Layout::OnePosition => standstill(&positions[0].x_m, self.steps_m[0]),
            Layout::TwoPositions | Layout::Locked => Vec::new(),
        };
        let weight = self.weight(&sides, velocity_hz, Grid { first: thin_first - full_first, ..thin });
        let classes = if self.sides() == 2 { self.classes(&sides) } else { Vec::new() };
        let masked = near(mask, self.kernels[0].half());
        let rests = near(&stands, (ring_s(self.band_hz) * self.rate_hz) as usize);
        Ok(Track {
            experiment: recording.experiment.clone(),
            start_s: recording.start_s,
            rate_hz: self.rate_hz,
            full_first,
            thin_first,
            samples,
            reference,
            spindle_hz: spindle_hz(recording),
            sides,
            stretch_m,
            thin: out,
            masked,
            weight,
            classes,
            rests,
        })
    }

    /// Weight of each thinned sample of two positions.
    ///
    /// Where an axis moves no faster than friction turns, noise n of the speed is noise of the friction,
    /// F sech^2(v / v_s) n / v_s. As noise of the whole recording it makes a friction of a fifth of its size
    /// the likeliest, which has less of it. What is more than friction itself varies by is weighted down, at
    /// both sides alike, since what enters between them is alike at both.
    fn weight(&self, sides: &[Side; 2], velocity_hz: [f64; 2], at: Grid) -> Vec<f64> {
        if self.sides() == 1 {
            return Vec::new();
        }
        let hidden = [0, 1].map(|k| {
            let noise_m_s =
                SpeedOfStep { step_m: self.steps_m[k], rate_hz: self.rate_hz }.at_m_s(velocity_hz[k]);
            let half = (0.5 * self.rate_hz / velocity_hz[k]) as usize;
            hidden_share(&sides[k], at, half, noise_m_s, self.smoothing_m_s)
        });
        let most = |(a, b): (&f64, &f64)| a.max(*b) / Criteria::STANDARD.texture;
        let weight: Vec<f64> =
            hidden[0].iter().zip(&hidden[1]).map(most).map(|h| h.max(1.0).recip()).collect();
        let mean = rms(&weight);
        weight.iter().map(|w| w / mean).collect()
    }

    /// How freely each full-rate sample slides, as a band of the balance sees it.
    fn classes(&self, sides: &[Side; 2]) -> Vec<u8> {
        let turns = |v: &f64| turns(*v, self.smoothing_m_s);
        let pairs = sides[0].v_m_s.iter().zip(&sides[1].v_m_s);
        let both: Vec<f64> = pairs.map(|(m, s)| 0.5 * (turns(m) + turns(s))).collect();
        classes(&self.low_passed(&both))
    }

    /// The low-pass of a band, of the signal that much later.
    pub(super) fn low_pass(&self, hz: f64, derivative: u32, advance_s: f64) -> Kernel {
        Kernel::low_pass(hz, self.rate_hz, Action { derivative, advance_s })
    }

    /// Both sides at the full rate, and thinned.
    fn moved(&self, positions: &[Read], velocity_hz: [f64; 2], [full, thin]: [Grid; 2]) -> ([Side; 2], Thin) {
        let mut sides: [Side; 2] = Default::default();
        let mut out = Thin::default();
        for (k, read) in positions.iter().enumerate() {
            let origin = read.x_m[0];
            let local: Vec<f64> = read.x_m.iter().map(|v| v - origin).collect();
            let kernel = |hz, derivative| self.low_pass(hz, derivative, read.delay_s);
            let of = |hz, derivative, grid| kernel(hz, derivative).apply(&local, grid);
            let of_thin =
                |derivative| kernel(self.band_hz, derivative).after(&self.means[1]).apply(&local, thin);
            let back = |x: Vec<f64>| x.iter().map(|v| v + origin).collect::<Vec<f64>>();
            sides[k].x_m = back(of(self.band_hz, 0, full));
            sides[k].v_m_s = of(velocity_hz[k], 1, full);
            out.velocity[k] = of_thin(1);
            out.accel[k] = of_thin(2);
            if k == 0 {
                out.position = back(of_thin(0));
            }
        }
        if let (Some(stage), [Read { x_m, delay_s, .. }]) = (self.following, positions) {
            let wide = self.low_pass(velocity_hz[0], 0, *delay_s).apply(x_m, full);
            let motor = Side { x_m: wide, v_m_s: sides[0].v_m_s.clone() };
            sides[1] = stage.behind(&motor, self.rate_hz, self.smoothing_m_s);
        }
        (sides, out)
    }

    /// Samples that the longest thrust filter needs on either side.
    fn path_half(&self, axis: &AxisModel) -> usize {
        /// The slowest current loop that is asked about, rad/s per Hz of the rate, and delays beyond it.
        const SLOWEST: f64 = 0.1;
        const LATER_SAMPLES: f64 = 8.0;
        let delay = axis.drive.amplifier_dead_time_s() + LATER_SAMPLES / self.rate_hz;
        Kernel::of_held_reference(self.band_hz, self.rate_hz, -delay, Some(SLOWEST * self.rate_hz)).half()
    }

    /// Rate of the thinned series, Hz.
    pub(super) fn thin_rate_hz(&self) -> f64 {
        self.rate_hz / self.step as f64
    }

    /// Highest frequency looked at, Hz.
    pub(super) fn top_hz(&self) -> f64 {
        (Criteria::STANDARD.top * self.band_hz).min(0.45 * self.thin_rate_hz())
    }

    /// Half the time that a column was averaged over: what a mean of past rows is late by, s.
    pub(super) fn averaged_s(&self) -> f64 {
        self.means.iter().map(Kernel::half).max().unwrap_or(0) as f64 / self.rate_hz
    }

    /// Whether the position that the encoder at this port reads is balanced: of one position the other may
    /// have been recorded, too.
    pub(super) fn balances(&self, encoder: Port) -> bool {
        self.balanced[usize::from(encoder == Port::StageEncoder)]
    }

    /// Number of balances.
    pub(super) fn sides(&self) -> usize {
        if self.layout == Layout::TwoPositions { 2 } else { 1 }
    }

    /// Names of the balances.
    pub(super) fn sides_named(&self) -> &'static [&'static str] {
        if self.sides() == 2 { &["motor", "stage"] } else { &["axis"] }
    }

    /// The side whose motion forces at the stage's side of a balance go with: of one position that of the
    /// stage, where it follows.
    pub(super) fn moved_side(&self, balance: usize) -> usize {
        self.following.map_or(balance, |_| 1)
    }

    /// The side of the stage, of the axis where there is one position.
    pub(super) fn last(&self) -> usize {
        self.sides() - 1
    }

    /// Least way over which friction that turns is told from a step, from a stage behind its spring, and from
    /// friction that turns over a speed: what the axis goes at that speed within a period of the band, m.
    pub(super) fn least_way_m(&self, side: usize) -> f64 {
        let [low, high] = self.travel_m();
        let turning_m = self.smoothing_m_s / self.band_hz;
        turning_m.max(4.0 * self.steps_m[side]).max(self.wound_m).min(0.1 * (high - low))
    }

    /// Thinned grid in a recording.
    fn thin(&self, track: &Track) -> Grid {
        Grid { first: track.thin_first, step: self.step, count: track.thin_count() }
    }

    /// Share of its power that white noise keeps in the balance at a frequency.
    pub(super) fn kept_power(&self, hz: f64) -> f64 {
        self.kernels[0].power(hz, self.rate_hz)
    }

    /// A full-rate series, filtered and thinned; derivative 0, 1 or 2.
    pub(super) fn filtered(&self, track: &Track, full: &[f64], derivative: usize) -> Vec<f64> {
        let thin = self.thin(track);
        self.kernels[derivative].apply(full, Grid { first: thin.first - track.full_first, ..thin })
    }

    /// A full-rate series through the low-pass, its ends as they are.
    pub(super) fn low_passed(&self, full: &[f64]) -> Vec<f64> {
        inside(&self.kernels[0], full, full.to_vec())
    }

    /// Its rate in the band of a side's velocity, zero at its ends.
    pub(super) fn speed_m_s(&self, side: usize, full: &[f64]) -> Vec<f64> {
        inside(&self.of_velocity[side], full, vec![0.0; full.len()])
    }

    /// A series of all samples of a recording, filtered and thinned.
    pub(super) fn thinned(&self, track: &Track, raw: &[f64]) -> Vec<f64> {
        self.kernels[0].apply(raw, self.thin(track))
    }

    /// Thrust that has come through dead time and current loop, thinned, N.
    pub(super) fn thrust(&self, track: &Track, path: Path) -> Vec<f64> {
        self.path_kernel(path).apply(&track.reference.reference_n, self.thin(track))
    }

    /// The same at the full rate.
    pub(super) fn thrust_full(&self, track: &Track, path: Path) -> Vec<f64> {
        let grid = Grid { first: track.full_first, step: 1, count: track.sides[0].x_m.len() };
        self.path_kernel(path).apply(&track.reference.reference_n, grid)
    }

    fn path_kernel(&self, path: Path) -> Kernel {
        let kernel = Kernel::of_held_reference(self.band_hz, self.rate_hz, -path.delay_s, path.loop_rad_s)
            .after(&self.means[0]);
        let most = self.tracks.iter().map(|t| t.full_first).min().unwrap_or(usize::MAX);
        kernel.cut_to(most)
    }

    /// Travel of the stage, m: least and most position.
    pub(super) fn travel_m(&self) -> [f64; 2] {
        let x = self.tracks.iter().flat_map(|t| &t.thin.position);
        x.fold([f64::INFINITY, f64::NEG_INFINITY], |e, v| [e[0].min(*v), e[1].max(*v)])
    }

    /// Of a spindle that turns in every recording, turns a second.
    pub(super) fn spindle_hz(&self) -> Option<f64> {
        let all: Option<Vec<f64>> = self.tracks.iter().map(|t| t.spindle_hz).collect();
        all.and_then(|hz| hz.first().copied())
    }

    /// Seconds of the longest recording.
    pub(super) fn longest_s(&self) -> f64 {
        self.tracks.iter().map(|t| t.samples as f64 / t.rate_hz).fold(0.0, f64::max)
    }

    /// Lengths of the thinned series.
    pub(super) fn lengths(&self) -> Vec<usize> {
        self.tracks.iter().map(Track::thin_count).collect()
    }

    /// A series of every recording.
    pub(super) fn each(&self, of: impl Fn(&Track) -> Vec<f64>) -> Series {
        self.tracks.iter().map(of).collect()
    }
}

/// How a reference becomes thrust.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Path {
    pub(super) delay_s: f64,
    /// `None`: at once.
    pub(super) loop_rad_s: Option<f64>,
}

impl Path {
    /// As a model states it.
    pub(super) fn stated(drive: &DriveParams) -> Self {
        Self { delay_s: drive.amplifier_dead_time_s(), loop_rad_s: drive.current_loop_bandwidth_rad_s() }
    }

    /// With a loop of that bandwidth, in place of a part of the delay or beside it.
    pub(super) fn with_loop(self, rad_s: f64, in_place: bool) -> Self {
        let lag_s = if in_place { self.delay_s.min(rad_s.recip()) } else { 0.0 };
        Self { delay_s: self.delay_s - lag_s, loop_rad_s: Some(rad_s) }
    }
}

impl Track {
    /// Class of each thinned sample that was measured; of one position the first.
    pub(super) fn measured_classes(&self, step: usize) -> Vec<u8> {
        let class = |j: usize| self.classes.get(self.thin_first - self.full_first + j * step).copied();
        (0..self.thin_count()).filter(|j| !self.masked[*j]).map(|j| class(j).unwrap_or(0)).collect()
    }

    /// Thinned samples that are judged: measured, and not at rest.
    pub(super) fn judged(&self) -> Vec<bool> {
        self.masked.iter().zip(&self.rests).map(|(masked, rests)| !masked && !rests).collect()
    }

    /// From its first to behind its last sample, s.
    pub(super) fn span_s(&self) -> [f64; 2] {
        [self.start_s, self.start_s + self.samples as f64 / self.rate_hz]
    }

    /// Number of thinned samples.
    pub(super) fn thin_count(&self) -> usize {
        self.thin.position.len()
    }

    /// Time since the recording began of a full-rate sample, s.
    pub(super) fn full_s(&self, k: usize) -> f64 {
        (self.full_first + k) as f64 / self.rate_hz
    }

    /// The same of a thinned sample.
    pub(super) fn thin_s(&self, j: usize, step: usize) -> f64 {
        (self.thin_first + j * step) as f64 / self.rate_hz
    }
}

/// Share of friction that noise of the speed makes, sech^2(v / v_s) n / v_s, at each of some samples: the
/// largest within half a period of the speed's band, for which it smears a stop.
fn hidden_share(side: &Side, at: Grid, half: usize, noise_m_s: f64, turning_m_s: f64) -> Vec<f64> {
    let of = |j: usize| {
        let centre = at.first + j * at.step;
        let near = &side.v_m_s[centre.saturating_sub(half)..(centre + half + 1).min(side.v_m_s.len())];
        let slowest = near.iter().map(|v| v.abs()).fold(f64::INFINITY, f64::min);
        turns(slowest, turning_m_s) * noise_m_s / turning_m_s
    };
    (0..at.count).map(of).collect()
}

/// A series through a kernel where that has all of its length, else as in `ends`.
pub(super) fn inside(kernel: &Kernel, full: &[f64], mut ends: Vec<f64>) -> Vec<f64> {
    let half = kernel.half();
    if full.len() > 2 * half {
        let grid = Grid { first: half, step: 1, count: full.len() - 2 * half };
        ends[half..full.len() - half].copy_from_slice(&kernel.apply(full, grid));
    }
    ends
}

/// One series less another.
pub(super) fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}
