//! Whether the spindle turns as fast as the windows of spindle harmonics were made for.

use super::harmonic::SPEED_TOLERANCE;
use crate::units::SampleRate;

/// Watches whether the spindle turns as fast as a window was made for.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Follow {
    pub(super) design_rpm: f64,
    /// Speed that windows are being made for; NaN: none.
    pub(super) target_rpm: f64,
    sum_rpm: f64,
    count: usize,
    before_rpm: f64,
    /// The windows in use are for another speed.
    pub(super) off: bool,
    block: usize,
}

crate::keyframe::keep!(Follow { design_rpm, target_rpm, sum_rpm, count, before_rpm, off, block });

/// Over which the spindle's speed is averaged, s: an encoder's noise in it is then far below the tolerance.
const SPEED_BLOCK_S: f64 = 0.25;

impl Follow {
    pub(super) fn new(design_rpm: f64, rate: SampleRate) -> Self {
        let block = (SPEED_BLOCK_S * rate.hz()).ceil() as usize;
        let target_rpm = f64::NAN;
        Self { design_rpm, target_rpm, sum_rpm: 0.0, count: 0, before_rpm: 0.0, off: false, block }
    }

    pub(super) fn is_tuning(&self) -> bool {
        !self.target_rpm.is_nan()
    }

    /// The windows for the target are in use.
    pub(super) fn arrived(&mut self) {
        (self.design_rpm, self.target_rpm, self.off) = (self.target_rpm, f64::NAN, false);
    }

    /// Answers a speed to design for, where it is not that of the design: that of the first sample, later one
    /// that two means in a row agree on.
    #[inline]
    pub(super) fn step(&mut self, speed_rpm: f64, first: bool) -> Option<f64> {
        let differs = |a: f64, b: f64| !((a - b).abs() <= SPEED_TOLERANCE * b);
        if first {
            (self.sum_rpm, self.count, self.before_rpm) = (0.0, 0, 0.0);
            self.off = differs(speed_rpm, self.design_rpm);
            return (speed_rpm > 0.0 && self.off).then_some(speed_rpm);
        }
        self.sum_rpm += speed_rpm;
        self.count += 1;
        if self.count < self.block {
            return None;
        }
        let mean_rpm = self.sum_rpm / self.count as f64;
        let steady = !differs(mean_rpm, self.before_rpm);
        (self.sum_rpm, self.count, self.before_rpm) = (0.0, 0, mean_rpm);
        self.off = differs(mean_rpm, self.design_rpm);
        (steady && self.off).then_some(mean_rpm)
    }
}
