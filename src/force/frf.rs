//! Force from accelerometers on the spindle housing, by frequency responses that depend on speed.
//!
//! ```text
//!  F_i(f) = sum_j [ H_ij(f) + 2 pi i f Omega G_ij(f) + Omega^2 N_ij(f) ] X_j(f),   X = -A / (2 pi f)^2
//! ```
//! Nine functions for each force axis, piecewise linear over nodes of frequency. The stream is
//! filtered by overlap-add: each block of accelerations is convolved with the impulse responses of its
//! spindle speed. The mean force is not estimated: accelerometers do not see it.
//!
//! Source: Vogl, Fabro and Qu, CIRP Annals 2022/2023, eq. (1), (2).

use super::validity::Validity;
use crate::units::SampleRate;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex64;
use std::f64::consts::{PI, TAU};
use std::sync::Arc;
use thiserror::Error;

/// Accelerometer axes that an estimator reads.
pub const ACCEL_AXES: usize = 3;

/// Functions for each accelerometer axis: H, G, N.
pub const TERMS: usize = 3;

/// Unknowns at one node: H, G, N of x, then of y, then of z.
pub const NODE_UNKNOWNS: usize = ACCEL_AXES * TERMS;

/// Speed by which Omega is scaled, rpm; frequency by which the derivative is: so that the three
/// functions have the same unit (N/m) and like sizes.
pub const SPEED_SCALE_RPM: f64 = 10_000.0;
/// See [`SPEED_SCALE_RPM`].
pub const FREQUENCY_SCALE_HZ: f64 = 500.0;

/// Why an accelerometer estimator cannot be used.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum FrfError {
    /// Nodes are not at least two growing frequencies, or the functions have another length.
    #[error(
        "estimator has {nodes} nodes and {functions} values a function, expected at least 2 nodes and as many"
    )]
    Shape {
        /// Nodes.
        nodes: usize,
        /// Values.
        functions: usize,
    },
    /// The rate is too low for the band.
    #[error("the estimator reaches {high_hz} Hz, the recording ends at {nyquist_hz} Hz, half its rate")]
    Rate {
        /// Upper end of the estimator.
        high_hz: f64,
        /// Half the rate.
        nyquist_hz: f64,
    },
}

/// Nine functions of one force axis, and what they were made from.
#[derive(Debug, Clone, PartialEq)]
pub struct FrfEstimator {
    /// Force axis.
    pub axis: String,
    /// Node frequencies, growing, Hz.
    pub nodes_hz: Vec<f64>,
    /// At each node the nine values, N/m.
    pub values: Vec<[Complex64; NODE_UNKNOWNS]>,
    /// Slowest and fastest spindle speed it was made from, rpm.
    pub speed_range_rpm: [f64; 2],
    /// Standard deviation that sensor noise causes in the force, N (in the whole band, mid speed).
    pub noise_floor_n: f64,
    /// Condition number of the fit.
    pub condition: f64,
}

/// The factors of H, G, N in the response at a frequency and speed; G's is imaginary.
#[must_use]
pub fn term_factors(frequency_hz: f64, speed_rpm: f64) -> [Complex64; TERMS] {
    let omega = speed_rpm / SPEED_SCALE_RPM;
    [
        Complex64::new(1.0, 0.0),
        Complex64::new(0.0, omega * frequency_hz / FREQUENCY_SCALE_HZ),
        Complex64::new(omega * omega, 0.0),
    ]
}

impl FrfEstimator {
    /// Errors: fewer than two nodes, or values that do not fit them.
    pub fn check(&self) -> Result<(), FrfError> {
        let growing = self.nodes_hz.windows(2).all(|w| w[1] > w[0]) && self.nodes_hz.iter().all(|f| *f > 0.0);
        if self.nodes_hz.len() < 2 || self.values.len() != self.nodes_hz.len() || !growing {
            return Err(FrfError::Shape { nodes: self.nodes_hz.len(), functions: self.values.len() });
        }
        Ok(())
    }

    /// Band of the estimator, Hz.
    #[must_use]
    pub fn band_hz(&self) -> [f64; 2] {
        [self.nodes_hz.first().copied().unwrap_or(0.0), self.nodes_hz.last().copied().unwrap_or(0.0)]
    }

    /// Force per acceleration of each axis, N s2/m = kg, at a frequency and spindle speed; zero outside
    /// the band.
    #[must_use]
    pub fn response_kg(&self, frequency_hz: f64, speed_rpm: f64) -> [Complex64; ACCEL_AXES] {
        let zero = [Complex64::new(0.0, 0.0); ACCEL_AXES];
        let [low, high] = self.band_hz();
        if !(low..=high).contains(&frequency_hz) {
            return zero;
        }
        let k = self.nodes_hz.partition_point(|f| *f <= frequency_hz).clamp(1, self.nodes_hz.len() - 1) - 1;
        let share = (frequency_hz - self.nodes_hz[k]) / (self.nodes_hz[k + 1] - self.nodes_hz[k]);
        let factors = term_factors(frequency_hz, speed_rpm);
        let displacement = -1.0 / (TAU * frequency_hz).powi(2);
        let mut out = zero;
        for (j, sum) in out.iter_mut().enumerate() {
            for (g, factor) in factors.iter().enumerate() {
                let u = j * TERMS + g;
                let value = self.values[k][u] * (1.0 - share) + self.values[k + 1][u] * share;
                *sum += value * factor * displacement;
            }
        }
        out
    }

    /// What speaks against an estimate at this speed.
    #[must_use]
    pub fn flags(&self, speed_rpm: f64) -> Validity {
        let [slow, fast] = self.speed_range_rpm;
        // Between two trained speeds the functions interpolate; beyond them the quadratic runs away.
        let margin = 0.02 * (fast - slow);
        let outside = speed_rpm < slow - margin || speed_rpm > fast + margin;
        Validity::when(outside, Validity::EXTRAPOLATED)
    }
}

/// Samples of one instant of the three accelerometers, m/s2.
pub type AccelSample = [f64; ACCEL_AXES];

/// Streaming filter: overlap-add of blocks, impulse responses of the block's spindle speed.
pub struct FrfStream {
    estimator: FrfEstimator,
    rate: SampleRate,
    /// Half of the (odd) length of the impulse responses.
    half: usize,
    block: usize,
    forward: Arc<dyn RealToComplex<f64>>,
    backward: Arc<dyn ComplexToReal<f64>>,
    responses: [Vec<Complex64>; ACCEL_AXES],
    responses_rpm: f64,
    pending: [Vec<f64>; ACCEL_AXES],
    pending_rpm: f64,
    /// Output that later blocks still add to.
    tail: Vec<f64>,
    ready: std::collections::VecDeque<f64>,
}

/// A fifth of a second: the block that one spindle speed is taken for.
const BLOCK_S: f64 = 0.1;
/// Length of the impulse responses: 1 s resolves 1 Hz, as the runs that the estimator is made from.
const RESPONSE_S: f64 = 0.8;
/// A speed change below this share does not call for new impulse responses.
const SPEED_STEP: f64 = 1e-3;

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
        Ok(Self {
            estimator,
            rate,
            half,
            block,
            forward,
            backward,
            responses: Default::default(),
            responses_rpm: f64::NAN,
            pending: Default::default(),
            pending_rpm: 0.0,
            tail: vec![0.0; size],
            ready: std::collections::VecDeque::new(),
        })
    }

    /// By how much an estimate lags: half an impulse response and one block.
    #[must_use]
    pub fn delay_s(&self) -> f64 {
        self.delay_samples() as f64 * self.rate.period_s()
    }

    /// The same in samples.
    #[must_use]
    pub fn delay_samples(&self) -> usize {
        self.half + self.block
    }

    /// One sample in, the estimate of [`Self::delay_samples`] ago out (zero until there is one).
    pub fn step(&mut self, accel: AccelSample, speed_rpm: f64) -> (f64, Validity) {
        for (pending, a) in self.pending.iter_mut().zip(accel) {
            pending.push(a);
        }
        self.pending_rpm += speed_rpm / self.block as f64;
        let out = self.ready.pop_front();
        if self.pending[0].len() == self.block {
            self.filter_block();
        }
        let settling = Validity::when(out.is_none(), Validity::SETTLING);
        (out.unwrap_or(0.0), settling | self.estimator.flags(speed_rpm))
    }

    fn filter_block(&mut self) {
        let speed_rpm = self.pending_rpm;
        self.pending_rpm = 0.0;
        let same = (speed_rpm - self.responses_rpm).abs() <= SPEED_STEP * self.responses_rpm.abs();
        if !same {
            self.responses = self.impulse_spectra(speed_rpm);
            self.responses_rpm = speed_rpm;
        }
        let size = self.tail.len();
        let mut sum = vec![Complex64::new(0.0, 0.0); size / 2 + 1];
        let mut time = vec![0.0; size];
        let mut spectrum = self.forward.make_output_vec();
        for (pending, response) in self.pending.iter_mut().zip(&self.responses) {
            time.fill(0.0);
            time[..pending.len()].copy_from_slice(pending);
            pending.clear();
            // Lengths are those of the plan: the transforms cannot refuse them.
            let _ = self.forward.process(&mut time, &mut spectrum);
            for ((s, x), h) in sum.iter_mut().zip(&spectrum).zip(response) {
                *s += x * h;
            }
        }
        let _ = self.backward.process(&mut sum, &mut time);
        for (tail, y) in self.tail.iter_mut().zip(&time) {
            *tail += y;
        }
        self.ready.extend(self.tail.drain(..self.block));
        self.tail.resize(size, 0.0);
    }

    /// Spectra of the windowed impulse responses, shifted by half their length so that they are causal.
    fn impulse_spectra(&self, speed_rpm: f64) -> [Vec<Complex64>; ACCEL_AXES] {
        let size = self.tail.len();
        let bin_hz = self.rate.hz() / size as f64;
        let mut out: [Vec<Complex64>; ACCEL_AXES] = Default::default();
        let wanted: Vec<[Complex64; ACCEL_AXES]> =
            (0..=size / 2).map(|k| self.estimator.response_kg(k as f64 * bin_hz, speed_rpm)).collect();
        for (axis, spectrum) in out.iter_mut().enumerate() {
            let mut freq: Vec<Complex64> = wanted.iter().map(|w| w[axis] / size as f64).collect();
            freq[0] = Complex64::new(0.0, 0.0);
            freq[size / 2] = Complex64::new(0.0, 0.0);
            let mut time = vec![0.0; size];
            let _ = self.backward.process(&mut freq, &mut time);
            let mut shifted = vec![0.0; size];
            for k in 0..=2 * self.half {
                let age = k as f64 - self.half as f64;
                let window = (0.5 * PI * age / (self.half as f64 + 1.0)).cos().powi(2);
                let from = (k + size - self.half) % size;
                shifted[k] = window * time[from];
            }
            let mut result = self.forward.make_output_vec();
            let _ = self.forward.process(&mut shifted, &mut result);
            // The inverse transform of the product is not normalised by the library.
            *spectrum = result.into_iter().map(|x| x / size as f64).collect();
        }
        out
    }
}

/// A whole recording through the stream, without its delay. Before the start and after the end the
/// signal is continued by whole turns of the spindle, so that the ends do not ring.
///
/// Errors: as [`FrfStream::new`].
pub fn force_of_recording(
    estimator: &FrfEstimator,
    rate: SampleRate,
    accel: &[AccelSample],
    speed_rpm: &[f64],
) -> Result<Vec<f64>, FrfError> {
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
        let (f, _) = stream.step(accel[k], speed_rpm.get(k).copied().unwrap_or(0.0));
        let belongs_to = i - stream.delay_samples() as isize;
        if (0..n as isize).contains(&belongs_to) {
            force.push(f);
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
