//! The accelerometer estimator as a stream: overlap-add of blocks, for whole files and for the live pipeline.

use super::frf::{ACCEL_AXES, AccelSample, FrfError, FrfEstimator};
use super::harmonic::SPEED_TOLERANCE;
use super::motion::ForceEstimate;
use super::validity::{Properties, Validity};
use crate::keyframe::{Keep, Words};
use crate::units::SampleRate;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex64;
use std::f64::consts::PI;
use std::sync::Arc;

/// The block that one spindle speed is taken for, s.
const BLOCK_S: f64 = 0.1;
/// Length of the impulse responses, s: resolves about 1 Hz, as the runs that the estimator is made from.
const RESPONSE_S: f64 = 0.8;

/// Streaming filter: overlap-add of blocks, impulse responses of the block's spindle speed.
#[derive(Clone)]
pub struct FrfStream {
    estimator: FrfEstimator,
    rate: SampleRate,
    /// Half of the (odd) length of the impulse responses.
    half: usize,
    block: usize,
    forward: Arc<dyn RealToComplex<f64>>,
    backward: Arc<dyn ComplexToReal<f64>>,
    responses: [Vec<Complex64>; ACCEL_AXES],
    state: FrfState,
    time: Vec<f64>,
    spectrum: Vec<Complex64>,
    sum: Vec<Complex64>,
    scratch: Vec<Complex64>,
    /// Responses of one speed by frequency, before they are made causal.
    wanted: Vec<[Complex64; ACCEL_AXES]>,
    shifted: Vec<f64>,
}

#[derive(Debug, Clone, PartialEq)]
struct FrfState {
    /// Speed of the impulse responses; NaN: none yet.
    responses_rpm: f64,
    pending: [Vec<f64>; ACCEL_AXES],
    pending_rpm: f64,
    filled: usize,
    /// What is given out while the next block fills.
    out: Vec<f64>,
    /// Output that later blocks still add to.
    tail: Vec<f64>,
    newest: AccelSample,
    seen: usize,
    /// Samples for which an absent acceleration, or a speed beyond the runs, is still in what comes out.
    missing: usize,
    beyond: usize,
}

crate::keyframe::keep!(FrfState {
    responses_rpm, pending, pending_rpm, filled, out, tail, newest, seen, missing, beyond
}
    if |s| s.filled < s.out.len());

impl FrfState {
    fn new(block: usize, size: usize) -> Self {
        Self {
            responses_rpm: f64::NAN,
            pending: std::array::from_fn(|_| vec![0.0; block]),
            pending_rpm: 0.0,
            filled: 0,
            out: vec![0.0; block],
            tail: vec![0.0; size],
            newest: [0.0; ACCEL_AXES],
            seen: 0,
            missing: 0,
            beyond: 0,
        }
    }
}

impl std::fmt::Debug for FrfStream {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FrfStream").field("estimator", &self.estimator).field("state", &self.state).finish()
    }
}

impl Keep for FrfStream {
    fn keep(&self, to: &mut Vec<u64>) {
        self.state.keep(to);
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        self.state.restore(from)?;
        if self.state.responses_rpm.is_finite() {
            self.make_responses(self.state.responses_rpm);
        }
        Some(())
    }
}

impl FrfStream {
    /// A stream at a rate. Errors: a band beyond half the rate, nodes that are none.
    pub fn new(estimator: FrfEstimator, rate: SampleRate) -> Result<Self, FrfError> {
        estimator.check()?;
        let [_, high_hz] = estimator.band_hz();
        let nyquist_hz = rate.hz() / 2.0;
        if high_hz >= nyquist_hz {
            return Err(FrfError::Rate { high_hz, nyquist_hz });
        }
        let half = (0.5 * RESPONSE_S * rate.hz()).ceil() as usize;
        let block = (BLOCK_S * rate.hz()).ceil() as usize;
        let size = (2 * half + 1 + block).next_power_of_two();
        let mut planner = RealFftPlanner::new();
        let (forward, backward) = (planner.plan_fft_forward(size), planner.plan_fft_inverse(size));
        let spectrum = forward.make_output_vec();
        let scratch = vec![Complex64::default(); forward.get_scratch_len().max(backward.get_scratch_len())];
        Ok(Self {
            estimator,
            rate,
            half,
            block,
            forward,
            backward,
            responses: std::array::from_fn(|_| spectrum.clone()),
            wanted: vec![[Complex64::default(); ACCEL_AXES]; spectrum.len()],
            shifted: vec![0.0; size],
            state: FrfState::new(block, size),
            time: vec![0.0; size],
            sum: spectrum.clone(),
            spectrum,
            scratch,
        })
    }

    /// What it filters by.
    #[must_use]
    pub fn estimator(&self) -> &FrfEstimator {
        &self.estimator
    }

    /// Forgets what it heard.
    pub fn restart(&mut self) {
        self.state = FrfState::new(self.block, self.state.tail.len());
    }

    /// What it states of its estimates: the lag is half an impulse response and one block, and it has settled
    /// where an output rests on a whole impulse response.
    #[must_use]
    pub fn properties(&self) -> Properties {
        Properties {
            delay_s: self.delay_samples() as f64 * self.rate.period_s(),
            settling_samples: 2 * self.half + self.block,
            noise_floor_n: self.estimator.noise_floor_n,
            usable_band_hz: self.estimator.band_hz(),
            condition: Some(self.estimator.condition),
            ..Properties::default()
        }
    }

    /// Its lag in samples.
    fn delay_samples(&self) -> usize {
        self.half + self.block
    }

    /// Samples of one block.
    #[must_use]
    pub fn block_samples(&self) -> usize {
        self.block
    }

    /// One sample in, the estimate of [`Self::delay_samples`] ago out. Absent accelerations are held and
    /// flagged.
    ///
    /// Cost: a few stores; at the end of a block four transforms, and six more where the speed has changed.
    /// No allocation.
    pub fn step(&mut self, accel: Option<AccelSample>, speed_rpm: f64) -> ForceEstimate {
        let state = &mut self.state;
        state.newest = accel.unwrap_or(state.newest);
        for (pending, a) in state.pending.iter_mut().zip(state.newest) {
            pending[state.filled] = a;
        }
        state.pending_rpm += speed_rpm / self.block as f64;
        let force_n = state.out[state.filled];
        state.filled += 1;
        let memory = self.half * 2 + self.block;
        let settling = state.seen < memory;
        state.seen = state.seen.saturating_add(1);
        let lasts = |left: usize, now: bool| if now { memory + self.block } else { left.saturating_sub(1) };
        state.missing = lasts(state.missing, accel.is_none());
        state.beyond = lasts(state.beyond, !self.estimator.flags(speed_rpm).is_valid());
        let flags = Validity::when(state.beyond > 0, Validity::EXTRAPOLATED)
            | self.estimator.condition_flags()
            | Validity::when(settling, Validity::SETTLING)
            | Validity::when(state.missing > 0, Validity::SIGNAL_MISSING);
        if state.filled == self.block {
            self.filter_block();
        }
        ForceEstimate { force_n, flags }
    }

    fn filter_block(&mut self) {
        let speed_rpm = std::mem::take(&mut self.state.pending_rpm);
        let now_rpm = self.state.responses_rpm;
        if !((speed_rpm - now_rpm).abs() <= SPEED_TOLERANCE * now_rpm.abs()) {
            self.make_responses(speed_rpm);
            self.state.responses_rpm = speed_rpm;
        }
        let state = &mut self.state;
        self.sum.fill(Complex64::default());
        for (pending, response) in state.pending.iter().zip(&self.responses) {
            self.time.fill(0.0);
            self.time[..self.block].copy_from_slice(pending);
            // Lengths are those of the plan: the transforms cannot refuse them.
            let _ = self.forward.process_with_scratch(&mut self.time, &mut self.spectrum, &mut self.scratch);
            for ((s, x), h) in self.sum.iter_mut().zip(&self.spectrum).zip(response) {
                *s += x * h;
            }
        }
        let _ = self.backward.process_with_scratch(&mut self.sum, &mut self.time, &mut self.scratch);
        for (tail, y) in state.tail.iter_mut().zip(&self.time) {
            *tail += y;
        }
        state.out.copy_from_slice(&state.tail[..self.block]);
        state.tail.copy_within(self.block.., 0);
        let kept = state.tail.len() - self.block;
        state.tail[kept..].fill(0.0);
        state.filled = 0;
    }

    /// Spectra of the windowed impulse responses, shifted by half their length so that they are causal.
    fn make_responses(&mut self, speed_rpm: f64) {
        let size = self.time.len();
        let bin_hz = self.rate.hz() / size as f64;
        for (k, wanted) in self.wanted.iter_mut().enumerate() {
            *wanted = self.estimator.response_kg(k as f64 * bin_hz, speed_rpm);
        }
        for (axis, response) in self.responses.iter_mut().enumerate() {
            for (to, wanted) in self.spectrum.iter_mut().zip(&self.wanted) {
                *to = wanted[axis] / size as f64;
            }
            self.spectrum[0] = Complex64::default();
            self.spectrum[size / 2] = Complex64::default();
            // Lengths are those of the plan: the transforms cannot refuse them.
            let (spectrum, scratch) = (&mut self.spectrum, &mut self.scratch);
            let _ = self.backward.process_with_scratch(spectrum, &mut self.time, scratch);
            self.shifted.fill(0.0);
            for k in 0..=2 * self.half {
                let age = k as f64 - self.half as f64;
                let window = (0.5 * PI * age / (self.half as f64 + 1.0)).cos().powi(2);
                let from = (k + size - self.half) % size;
                // The inverse transform of the product is not normalised by the library.
                self.shifted[k] = window * self.time[from] / size as f64;
            }
            let _ = self.forward.process_with_scratch(&mut self.shifted, response, scratch);
        }
    }
}

/// A whole recording through the stream, without its delay, each row with the flags of its own instant.
/// Before the start and after the end the signal is continued by whole turns of the spindle, so that the
/// ends do not ring and nothing settles.
///
/// Errors: as [`FrfStream::new`].
pub fn force_of_recording(
    estimator: &FrfEstimator,
    rate: SampleRate,
    accel: &[AccelSample],
    speed_rpm: &[f64],
) -> Result<Vec<ForceEstimate>, FrfError> {
    let mut stream = FrfStream::new(estimator.clone(), rate)?;
    let n = accel.len();
    let (Some(first_rpm), Some(last_rpm)) = (speed_rpm.first(), speed_rpm.last()) else {
        return Ok(Vec::new());
    };
    let periods = (whole_turns_samples(*first_rpm, rate, n), whole_turns_samples(*last_rpm, rate, n));
    let at = |i: isize| {
        let (n, head, tail) = (n as isize, periods.0 as isize, periods.1 as isize);
        let folded = if i < 0 {
            i.rem_euclid(head)
        } else if i >= n {
            n - tail + (i - n).rem_euclid(tail)
        } else {
            i
        };
        folded.clamp(0, n - 1) as usize
    };
    let mut force = Vec::with_capacity(n);
    // Twice: the first half impulse response only fills the stream.
    let first = -2 * (stream.half as isize);
    for i in first..(n + stream.delay_samples() + stream.block) as isize {
        let k = at(i);
        let mut estimate = stream.step(Some(accel[k]), speed_rpm.get(k).copied().unwrap_or(0.0));
        let belongs_to = i - stream.delay_samples() as isize;
        if (0..n as isize).contains(&belongs_to) {
            estimate.flags = estimate.flags.without(Validity::SETTLING);
            force.push(estimate);
        }
    }
    Ok(force)
}

/// Samples of the number of turns, within half of the recording, that is closest to whole samples.
fn whole_turns_samples(speed_rpm: f64, rate: SampleRate, n: usize) -> usize {
    let turn = 60.0 * rate.hz() / speed_rpm;
    let longest = (n / 2).max(1) as f64;
    if !(turn.is_finite() && turn >= 2.0 && turn <= longest) {
        return n.max(1);
    }
    let mut best = (f64::INFINITY, turn);
    let mut length = turn;
    while length <= longest {
        let miss = (length - length.round()).abs();
        if miss < best.0 - 1e-9 {
            best = (miss, length);
        }
        length += turn;
    }
    best.1.round() as usize
}
