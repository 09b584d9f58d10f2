//! What is known of a machine and its recordings before they are looked at.

use super::fit::Problem;
use super::machine::{Machine, Point};

/// The best that is known of a machine and of how it was recorded.
#[derive(Debug, Clone)]
pub(crate) struct Reference {
    /// Machine.
    pub(crate) machine: Machine,
    /// Of each recording the noise of its force sensor over that of the machine: an amplifier is set anew, a
    /// tool is changed, and a noise that is taken for another bends every number.
    pub(crate) sensor_levels: Vec<f64>,
}

impl Reference {
    /// A machine whose recordings are all as noisy.
    pub(crate) fn of(machine: Machine) -> Self {
        Self { machine, sensor_levels: Vec::new() }
    }

    /// The machine of a point that was fitted with this one known; the noise of each recording by what its
    /// own spectra say.
    pub(crate) fn refined(&self, problem: &Problem<'_>, point: &Point, recordings: usize) -> Option<Self> {
        let machine = problem.frame.machine(point)?;
        let before = |k: usize| self.sensor_levels.get(k).copied().unwrap_or(1.0);
        let level = |k: usize| before(k) * problem.sensor_level(point, k).unwrap_or(1.0);
        Some(Self { machine, sensor_levels: (0..recordings).map(level).collect() })
    }
}
