//! The state of a running pipeline as numbers, and the digest by which two runs are compared.

use super::{Pipeline, StepOutput};
use crate::force::disagreement::Disagreement;
use crate::force::observers::AxisObserver;
use crate::keyframe::{Digest, Keep, Words};
use crate::sample::{AxisSample, MAX_AXES, ServoSample};
use thiserror::Error;

/// Why a keyframe was not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum KeyframeError {
    /// Made by other settings or another version, or damaged.
    #[error(
        "a keyframe of {words} words does not fit this pipeline: other settings, another version or damage"
    )]
    Unfit {
        /// Length that was given.
        words: usize,
    },
}

impl Pipeline {
    /// Appends the state to `to`: everything that later decisions rest on. The spectrum that the page shows
    /// is left out; it is whole again after one second. Cost: some ten thousand stores.
    pub fn keep(&self, to: &mut Vec<u64>) {
        keep_sample(self.last.as_ref(), to);
        self.clean_samples.keep(to);
        self.agreement_state.keep(to);
        self.agreement.keep(to);
        self.declared.keep(to);
        self.since_restart.keep(to);
        self.out_of_reach.keep(to);
        self.observers.keep(to);
        if let Some(beside) = &self.beside {
            beside.keep(to);
        }
        for state in &self.states {
            state.apart.is_some().keep(to);
            if let Some(apart) = &state.apart {
                apart.keep(to);
            }
            state.monitor.keep(to);
            state.stand.keep(to);
        }
        if let Some(margins) = &self.margins {
            margins.keep(to);
        }
        self.cutting.keep(to);
    }

    /// Takes a state back that [`Pipeline::keep`] of a pipeline of the same settings wrote: from here on both
    /// say the same. Errors: it does not fit; the pipeline is then as if new.
    /// Checked by: `a_replay_may_start_at_any_keyframe`.
    pub fn restore(&mut self, words: &[u64]) -> Result<(), KeyframeError> {
        self.begin();
        let mut from = Words::new(words);
        if self.take_back(&mut from).is_some() && from.is_empty() {
            return Ok(());
        }
        self.begin();
        (self.last, self.declared) = (None, false);
        Err(KeyframeError::Unfit { words: words.len() })
    }

    fn take_back(&mut self, from: &mut Words<'_>) -> Option<()> {
        self.last = restore_sample(from)?;
        self.clean_samples.restore(from)?;
        self.agreement_state.restore(from)?;
        self.agreement.restore(from)?;
        if self.agreement.leading_axis >= self.states.len().max(1) {
            return None;
        }
        self.declared.restore(from)?;
        self.since_restart.restore(from)?;
        self.out_of_reach.restore(from)?;
        self.observers.restore(from)?;
        if let Some(beside) = &mut self.beside {
            beside.restore(from)?;
        }
        for axis in 0..self.states.len() {
            self.restore_axis(axis, from)?;
        }
        if let Some(margins) = &mut self.margins {
            margins.restore(from)?;
        }
        self.cutting.restore(from)?;
        Some(())
    }

    fn restore_axis(&mut self, axis: usize, from: &mut Words<'_>) -> Option<()> {
        let state = &mut self.states[axis];
        let mut apart = false;
        apart.restore(from)?;
        state.apart = if apart {
            let pair = [self.observers.axis(axis)?, self.beside.as_ref()?.axis(axis)?];
            let mut made = Disagreement::new(pair.map(AxisObserver::properties), self.settings.sample_rate);
            made.restore(from)?;
            Some(made)
        } else {
            None
        };
        state.monitor.restore(from)?;
        state.stand.restore(from)
    }

    /// Tells pipelines apart that would decide differently: version, rate, axes with their observers, band.
    #[must_use]
    pub fn settings_digest(&self) -> u64 {
        let mut digest = Digest::default();
        let Self { settings, .. } = self;
        let text = format!(
            "{:?} {:?} {:?} {:?} {:?}",
            settings.sample_rate, settings.axes, settings.tools, settings.margin, settings.stated_pitch_rad
        );
        digest.bytes(env!("CARGO_PKG_VERSION").as_bytes());
        digest.bytes(text.as_bytes());
        // As planned: what the monitors made of it since then is state.
        let band = self.monitor.settings().band;
        [band.low_hz(), band.high_hz()].iter().for_each(|hz| digest.word(hz.to_bits()));
        digest.value()
    }
}

impl StepOutput {
    /// Adds to a digest what this sample led to, bit for bit.
    pub fn digest(&self, axes: usize, to: &mut Digest) {
        self.forces.iter().take(axes).for_each(|force| to.word(force.force_n.to_bits()));
        let chatter = &self.chatter;
        let frequency = chatter.frequency_hz.map_or(u64::MAX, f64::to_bits);
        to.word(frequency ^ (chatter.phase as u64));
        to.word(chatter.power_n2.to_bits());
        let warned = self.margin_warning.map_or(u64::MAX, |w| w.margin.margin_1_s.to_bits());
        to.word(warned);
    }
}

fn keep_sample(sample: Option<&ServoSample>, to: &mut Vec<u64>) {
    sample.is_some().keep(to);
    let Some(sample) = sample else { return };
    to.push(sample.sequence);
    [sample.t_s, sample.spindle_angle_rad, sample.spindle_speed_rpm].keep(to);
    for axis in &sample.axes {
        [axis.current_ref_a, axis.motor_angle_rad].keep(to);
        axis.stage_position_m.keep(to);
    }
    sample.accel_m_s2.keep(to);
    sample.pitch_difference_rad.keep(to);
}

/// Nothing: not a sample. `Some(None)`: none had come.
#[allow(clippy::option_option)]
fn restore_sample(from: &mut Words<'_>) -> Option<Option<ServoSample>> {
    let (mut there, mut head) = (false, [0.0; 3]);
    there.restore(from)?;
    if !there {
        return Some(None);
    }
    let sequence = from.next_word()?;
    head.restore(from)?;
    let mut axes = [AxisSample::default(); MAX_AXES];
    for axis in &mut axes {
        let mut pair = [0.0; 2];
        pair.restore(from)?;
        [axis.current_ref_a, axis.motor_angle_rad] = pair;
        axis.stage_position_m.restore(from)?;
    }
    let [t_s, spindle_angle_rad, spindle_speed_rpm] = head;
    let (mut accel_m_s2, mut pitch_difference_rad) = (None, None);
    accel_m_s2.restore(from)?;
    pitch_difference_rad.restore(from)?;
    Some(Some(ServoSample {
        sequence,
        t_s,
        axes,
        spindle_angle_rad,
        spindle_speed_rpm,
        accel_m_s2,
        pitch_difference_rad,
    }))
}
