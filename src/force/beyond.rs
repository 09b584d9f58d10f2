//! State of what an axis has beyond its lane.

use super::guideway_learner::GuidewayState;
use super::harmonic::HarmonicState;
use super::settings::MAX_NOTCHES;
use super::stiffness_learner::LearnedStiffness;
use super::two_sides::SeenSides;
use crate::keyframe::{Keep, Words};
use crate::signal::linear_phase::LinearPhaseState;
use crate::signal::notch::NotchState;

/// State of what an axis has beyond its balance and a Butterworth low-pass.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Beyond {
    pub(super) linear_phase: Option<LinearPhaseState>,
    pub(super) harmonic: Option<HarmonicState>,
    pub(super) guideway: Option<GuidewayState>,
    pub(super) learned: LearnedStiffness,
    pub(super) sides: SeenSides,
    pub(super) notches: [NotchState; MAX_NOTCHES],
    /// Speed of the axis, slowed down: what the notches follow.
    pub(super) speed_m_s: f64,
}

impl Keep for Beyond {
    fn keep(&self, to: &mut Vec<u64>) {
        let Self { linear_phase, harmonic, guideway, learned, sides, notches, speed_m_s } = self;
        if let Some(linear_phase) = linear_phase {
            linear_phase.keep(to);
        }
        if let Some(harmonic) = harmonic {
            harmonic.keep(to);
        }
        if let Some(guideway) = guideway {
            guideway.keep(to);
        }
        learned.keep(to);
        sides.keep(to);
        notches.keep(to);
        speed_m_s.keep(to);
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        let Self { linear_phase, harmonic, guideway, learned, sides, notches, speed_m_s } = self;
        linear_phase.as_mut().map_or(Some(()), |x| x.restore(from))?;
        harmonic.as_mut().map_or(Some(()), |x| x.restore(from))?;
        guideway.as_mut().map_or(Some(()), |x| x.restore(from))?;
        learned.restore(from)?;
        sides.restore(from)?;
        notches.restore(from)?;
        speed_m_s.restore(from)
    }
}
