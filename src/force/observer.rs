//! The force of one axis, sample by sample: whichever estimator a plan names, with what it needs to run live.
//!
//! The live pipeline steps [`Observers`] of all its axes, `stillcut force` an [`Observer`], which is the same
//! for one: one code, one number.

use super::motion::{ForceEstimate, MotionSample};
use super::observers::{AxisObserver, Observers};
use super::plan::ForcePlan;
use super::settings::ForceError;
use crate::units::SampleRate;

/// The running estimator of one axis alone.
#[derive(Debug, Clone)]
pub struct Observer(Observers<1>);

impl Observer {
    /// Designs the estimator. Errors: as [`AxisObserver::new`].
    pub fn new(plan: &ForcePlan, rate: SampleRate) -> Result<Self, ForceError> {
        Ok(Self(Observers::new(vec![AxisObserver::new(plan, rate)?])))
    }

    /// One sample in, one estimate out. The first one settles the filters and alone asks for memory.
    #[inline]
    pub fn step(&mut self, sample: &MotionSample) -> ForceEstimate {
        let [estimate] = self.0.step(|_| *sample);
        estimate
    }

    /// Forgets all but the design.
    pub fn restart(&mut self) {
        self.0.restart();
    }
}

impl std::ops::Deref for Observer {
    type Target = AxisObserver;

    fn deref(&self) -> &AxisObserver {
        self.0.alone()
    }
}
