//! The stability margin of each watched axis, and the smallest of them.

use super::{Channel, Pipeline, PipelineSettings};
use crate::chatter::MeanForce;
use crate::keyframe::{Keep, Words};
use crate::sample::ServoSample;
use crate::stability::margin::{MarginMonitor, MarginSettings, MarginState};

pub use crate::stability::margin::{CutConditions, CutPrior, DeafReason, Margin, MarginReading};

/// What the margin is told of the cut beside the force.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarginPlan {
    /// Bar and cut as far as they are known.
    pub prior: CutPrior,
    /// Corner of the first-order low-pass through which the force is seen, Hz.
    pub force_hz: f64,
}

impl MarginPlan {
    /// Low-pass of the forces here unless something else is known (thesis, Table 6-2), Hz.
    pub const FORCE_HZ: f64 = 1000.0;
}

/// An axis whose margin begins to run out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarginWarning {
    /// Place of the axis.
    pub axis: usize,
    /// What was read then.
    pub margin: Margin,
}

/// The margins of all axes.
#[derive(Debug, Clone)]
pub(super) struct Margins {
    monitor: MarginMonitor,
    states: Vec<MarginState>,
    warning: Option<MarginWarning>,
}

impl Margins {
    /// Nothing where the settings do not ask for it. `band_hz`: where roots are looked for.
    pub(super) fn new(settings: &PipelineSettings, band_hz: [f64; 2]) -> Option<Self> {
        let plan = settings.margin?;
        let monitor = MarginMonitor::new(MarginSettings {
            sample_rate: settings.sample_rate,
            band_hz,
            prior: plan.prior,
            pushes: settings.mean == MeanForce::Whole,
            force_hz: plan.force_hz,
        });
        let states = (0..settings.axes.len()).map(|axis| monitor.start(axis)).collect();
        Some(Self { monitor, states, warning: None })
    }

    /// One force of one axis.
    pub(super) fn step(&mut self, axis: usize, force_n: f64, conditions: &CutConditions) {
        let state = &mut self.states[axis];
        if self.monitor.step(state, force_n, conditions)
            && let MarginReading::Known(margin) = *self.monitor.reading(state)
        {
            self.warning = Some(MarginWarning { axis, margin });
        }
    }

    pub(super) fn restart(&mut self) {
        for (axis, state) in self.states.iter_mut().enumerate() {
            *state = self.monitor.start(axis);
        }
        self.warning = None;
    }

    /// What began with this sample.
    pub(super) fn take_warning(&mut self) -> Option<MarginWarning> {
        self.warning.take()
    }

    pub(super) fn keep(&self, to: &mut Vec<u64>) {
        self.states.iter().for_each(|state| state.keep(to));
    }

    pub(super) fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        self.states.iter_mut().try_for_each(|state| state.restore(from))
    }
}

impl Pipeline {
    /// What is said of the margin of one axis; nothing where it is not watched for it.
    #[must_use]
    pub fn margin_reading(&self, axis: usize) -> Option<&MarginReading> {
        let margins = self.margins.as_ref()?;
        self.channels.get(axis).filter(|channel: &&Channel| channel.watch)?;
        if self.is_deaf(axis) {
            return Some(&MarginReading::Deaf(DeafReason::ForceAboveBand));
        }
        margins.states.get(axis).map(|state| margins.monitor.reading(state))
    }

    /// The smallest margin of the watched axes, where one is known.
    #[must_use]
    pub fn margin(&self) -> Option<&Margin> {
        let readings = (0..self.channels.len()).filter_map(|axis| self.margin_reading(axis)?.margin());
        readings.min_by(|a, b| a.margin_1_s.total_cmp(&b.margin_1_s))
    }

    /// `known` where one is; else what is said of the margin on the first watched axis; `off` where none is.
    #[must_use]
    pub fn margin_word(&self) -> &'static str {
        let first = || (0..self.channels.len()).find_map(|axis| self.margin_reading(axis));
        self.margin().map_or_else(|| first().map_or("off", MarginReading::word), |_| "known")
    }

    /// The smallest margin of the watched axes on which it runs out, and which axis that is.
    #[must_use]
    pub fn margin_running_out(&self) -> Option<(usize, &Margin)> {
        let margins = self.margins.as_ref()?;
        let heard =
            (0..self.channels.len()).filter(|axis| self.channels[*axis].watch && !self.is_deaf(*axis));
        let running_out =
            heard.filter_map(|axis| Some((axis, margins.monitor.running_out(margins.states.get(axis)?)?)));
        running_out.min_by(|a, b| a.1.margin_1_s.total_cmp(&b.1.margin_1_s))
    }

    /// Tools from the chuck, where an axis of the stream tells it, m.
    #[must_use]
    pub fn tool_position_m(&self, sample: &ServoSample) -> Option<f64> {
        self.settings.tools.and_then(|axis| axis.distance_m(sample))
    }

    /// What a servo sample tells of the cut.
    pub(super) fn conditions(&self, sample: &ServoSample) -> CutConditions {
        CutConditions {
            spindle_speed_rpm: Some(sample.spindle_speed_rpm),
            pitch_difference_rad: sample.pitch_difference_rad,
            tool_position_m: self.tool_position_m(sample),
            ..CutConditions::default()
        }
    }
}
