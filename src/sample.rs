//! What comes in: one instant of all axes ([`ServoSample`]), or many of them in columns ([`Recording`]).

use crate::units::SampleRate;
use thiserror::Error;

/// One named signal of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// Name with its unit, for example `x_stage_position_m`.
    pub name: String,
    /// One value a sample.
    pub values: Vec<f64>,
}

/// A uniformly sampled set of signals with what is known about it.
///
/// Every value is finite and all columns have the same length: the reader refuses anything else.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Samples per second.
    pub sample_rate: SampleRate,
    /// Free word: what was being done.
    pub experiment: String,
    /// Names of the axes, in the order of the file.
    pub axes: Vec<String>,
    /// The signals, without the time.
    pub columns: Vec<Column>,
    /// Time of the first sample in s.
    pub start_s: f64,
    /// Metadata that has no field of its own (workpiece, analysis band, ...).
    pub metadata: Vec<(String, String)>,
}

/// Why a signal of a recording cannot be had.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ColumnError {
    /// The recording has no such column.
    #[error("no column {name}; the recording has {present}")]
    Missing {
        /// What was asked for.
        name: String,
        /// What there is, comma separated.
        present: String,
    },
}

impl Recording {
    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.columns.first().map_or(0, |c| c.values.len())
    }

    /// True when there is no sample.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Time of sample `index` in s.
    #[must_use]
    pub fn time_s(&self, index: usize) -> f64 {
        self.start_s + index as f64 / self.sample_rate.hz()
    }

    /// A signal by its full name, if it is there.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&[f64]> {
        self.columns.iter().find(|c| c.name == name).map(|c| c.values.as_slice())
    }

    /// A signal that must be there. Errors: names the column and what there is instead.
    pub fn require(&self, name: &str) -> Result<&[f64], ColumnError> {
        self.get(name).ok_or_else(|| ColumnError::Missing {
            name: name.to_owned(),
            present: self.columns.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", "),
        })
    }

    /// A piece of metadata, if it is there.
    #[must_use]
    pub fn metadata(&self, key: &str) -> Option<&str> {
        self.metadata.iter().find(|(k, _)| k == key).map(|(_, v)| v.as_str())
    }
}

/// Largest number of servo axes that one sample carries.
pub const MAX_AXES: usize = 6;

/// What one servo axis reported at one instant. All numbers are finite.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AxisSample {
    /// Current reference, A.
    pub current_ref_a: f64,
    /// Rotary encoder on the motor, rad.
    pub motor_angle_rad: f64,
    /// Linear scale on the stage, m; `None` on a semi-closed axis.
    pub stage_position_m: Option<f64>,
}

/// One instant of all axes of a machine, as the motion controller published it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ServoSample {
    /// Counts samples since the producer started; a step of more than one is a gap.
    pub sequence: u64,
    /// Time of the sample on the producer's clock, s.
    pub t_s: f64,
    /// Axes in the order that the stream was announced with; unused places are default.
    pub axes: [AxisSample; MAX_AXES],
    /// Spindle angle, rad.
    pub spindle_angle_rad: f64,
    /// Spindle speed, rpm.
    pub spindle_speed_rpm: f64,
    /// Accelerations of the spindle housing in x, y, z; `None` where there are no accelerometers, m/s2.
    pub accel_m_s2: Option<[f64; 3]>,
    /// theta_2 - theta_1 by the last report of the turret; `None` where none is known. It does not travel
    /// with the sample: who takes the sample in adds it, rad.
    pub pitch_difference_rad: Option<f64>,
}

/// True where no sample is missing between two sequence numbers.
#[must_use]
pub fn follows(before: u64, after: u64) -> bool {
    before.checked_add(1) == Some(after)
}

/// What no signal of a machine exceeds in its unit: rad that a spindle of 30 000 rpm turns in a century. What
/// does is no measurement, and a filter would remember it for minutes.
pub const LARGEST: f64 = 1e13;

/// Why a servo sample was not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum SampleError {
    /// A signal is NaN, infinite, or larger than [`LARGEST`].
    #[error("a signal of axis {axis} is not a finite number below {LARGEST:e}")]
    AxisNotFinite {
        /// Index of the axis.
        axis: usize,
    },
    /// Time, spindle or an acceleration is NaN, infinite, or larger than [`LARGEST`].
    #[error("time, spindle or an acceleration is not a finite number below {LARGEST:e}")]
    HeadNotFinite,
}

impl ServoSample {
    /// Checks that everything is a number that a machine may have. Errors: which part is not.
    #[inline]
    pub fn check(&self) -> Result<(), SampleError> {
        // Nothing is zero times zero but what is finite, and what is too large overflows: all at once,
        // without a branch for each.
        let zero = |x: f64| x * (f64::MAX / LARGEST) * 0.0;
        let [x, y, z] = self.accel_m_s2.unwrap_or_default().map(zero);
        let head = zero(self.t_s) + zero(self.spindle_angle_rad) + zero(self.spindle_speed_rpm) + x + y + z;
        let of_axis = |a: &AxisSample| {
            zero(a.current_ref_a) + zero(a.motor_angle_rad) + zero(a.stage_position_m.unwrap_or(0.0))
        };
        let all = self.axes.iter().map(of_axis).fold(head, |sum, x| sum + x);
        if all == 0.0 { Ok(()) } else { self.not_finite() }
    }

    #[cold]
    fn not_finite(&self) -> Result<(), SampleError> {
        let head = [self.t_s, self.spindle_angle_rad, self.spindle_speed_rpm];
        let is_number = |x: f64| x.abs() <= LARGEST;
        if !head.iter().chain(self.accel_m_s2.iter().flatten()).all(|x| is_number(*x)) {
            return Err(SampleError::HeadNotFinite);
        }
        let bad = self.axes.iter().position(|a| {
            !(is_number(a.current_ref_a)
                && is_number(a.motor_angle_rad)
                && a.stage_position_m.is_none_or(is_number))
        });
        bad.map_or(Ok(()), |axis| Err(SampleError::AxisNotFinite { axis }))
    }
}
