//! What several axes say together: chatter shakes the bar, and every axis of the turret feels it.

use super::criteria::SAME_LINE_HZ;
use super::track::Track;
use super::{ChatterOutput, Phase};
use crate::sample::MAX_AXES;

/// Two axes must agree for this long: two drives that hunt meet on one line only in passing.
const TOGETHER_S: f64 = 0.12;
/// A line that one axis alone hears must last this long before it counts: hunting of a single drive does not.
const ALONE_S: f64 = 1.0;
/// A line so many times over the noise must last no longer than two axes must agree, a weaker one as much
/// longer as it is weaker: noise of a colour that is not known swells, and is gone before it weighs as much.
const CLEAR: f64 = 500.0;

/// What all watched axes say together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// Where the machine stands.
    pub phase: Phase,
    /// The axis whose line stands out most.
    pub leading_axis: usize,
    /// Its line, Hz.
    pub frequency_hz: Option<f64>,
    /// Highest line of any axis that is in chatter: what the pitch is computed from (thesis 6.5.2), Hz.
    pub highest_hz: Option<f64>,
    /// Power of the leading axis' line, N2.
    pub power_n2: f64,
    /// Growth of the leading axis' line, 1/s.
    pub growth_1_s: Option<f64>,
}

crate::keyframe::keep!(Agreement {
    phase, leading_axis, frequency_hz, highest_hz, power_n2, growth_1_s
} if |s| s.leading_axis < MAX_AXES);

/// Since when one axis has stood on its line, alone and with another.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Clock {
    track: Track,
    alone_since_s: Option<f64>,
    together_since_s: Option<f64>,
    /// Time since then, each moment weighed by how clear the line stands.
    clear_s: f64,
    looked_s: f64,
}

crate::keyframe::keep!(Clock { track, alone_since_s, together_since_s, clear_s, looked_s });

/// What is remembered of the axes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AgreementState {
    clocks: [Clock; MAX_AXES],
    declared: bool,
}

crate::keyframe::keep!(AgreementState { clocks, declared });

impl Clock {
    /// Takes what its axis says and whether another hears the same line; answers whether that has lasted.
    fn look(&mut self, t_s: f64, output: &ChatterOutput, heard_by_another: bool) -> bool {
        // A line that jumps about is the comb of a hunting drive: the clocks start again.
        if !self.track.follow(output.frequency_hz) {
            let track = Track { line_hz: output.frequency_hz };
            *self = Self { track, looked_s: self.looked_s, ..Self::default() };
        }
        let chatter = output.phase == Phase::Chatter;
        let since = |clock: &mut Option<f64>, on: bool| {
            *clock = on.then(|| clock.unwrap_or(t_s));
            clock.map_or(0.0, |since_s| t_s - since_s)
        };
        let passed_s = (t_s - std::mem::replace(&mut self.looked_s, t_s)).clamp(0.0, TOGETHER_S);
        self.clear_s = if chatter { self.clear_s + passed_s * output.contrast / CLEAR } else { 0.0 };
        let clear = self.clear_s >= TOGETHER_S;
        let alone_s = since(&mut self.alone_since_s, chatter);
        let together_s = since(&mut self.together_since_s, chatter && heard_by_another);
        alone_s >= if clear { TOGETHER_S } else { ALONE_S } || together_s >= TOGETHER_S
    }
}

fn rank(phase: Phase) -> u8 {
    match phase {
        Phase::Learning => 0,
        Phase::Quiet => 1,
        Phase::Suspected => 2,
        Phase::Chatter => 3,
    }
}

/// Brings the outputs of the watched axes (index, output) to one statement at time `t_s`.
///
/// The machine is in chatter when one axis is and another hears the same line, when there is only one
/// axis, or when one axis has been alone in it for a second; it stays there until no axis is. Each axis has
/// its own clock: what another hears, louder or not, does not stop it. Indices are below `MAX_AXES`.
/// Checked by: `suite/pipeline.rs`, `one_axis_alone_must_last`,
/// `another_line_elsewhere_does_not_stop_the_clock`.
pub fn agree<'a>(
    state: &mut AgreementState,
    t_s: f64,
    watched: impl Iterator<Item = (usize, &'a ChatterOutput)> + Clone,
) -> Agreement {
    let same = |a: &ChatterOutput, b: &ChatterOutput| {
        let lines = a.frequency_hz.zip(b.frequency_hz);
        lines.is_some_and(|(a, b)| (a - b).abs() < SAME_LINE_HZ)
    };
    let hearing = |line: &ChatterOutput| {
        watched.clone().filter(|(_, other)| rank(other.phase) >= 2 && same(line, other)).count()
    };
    let count = watched.clone().count();
    let mut sure = [false; MAX_AXES];
    for (axis, output) in watched.clone() {
        sure[axis] = state.clocks[axis].look(t_s, output, hearing(output) >= 2);
    }
    let leading = watched.clone().max_by(|(i, a), (j, b)| {
        let order = rank(a.phase).cmp(&rank(b.phase)).then(sure[*i].cmp(&sure[*j]));
        order.then(a.contrast.total_cmp(&b.contrast))
    });
    let Some((leading_axis, output)) = leading else {
        return Agreement {
            phase: Phase::Learning,
            leading_axis: 0,
            frequency_hz: None,
            highest_hz: None,
            power_n2: 0.0,
            growth_1_s: None,
        };
    };
    let believed = state.declared || count == 1 || sure[leading_axis];
    let phase = match output.phase {
        Phase::Chatter if !believed => Phase::Suspected,
        phase => phase,
    };
    state.declared = phase == Phase::Chatter;
    Agreement {
        phase,
        leading_axis,
        frequency_hz: output.frequency_hz,
        highest_hz: watched
            .clone()
            .filter(|(_, o)| o.phase == Phase::Chatter)
            .filter_map(|(_, o)| o.frequency_hz)
            .reduce(f64::max),
        power_n2: output.power_n2,
        growth_1_s: output.growth_1_s,
    }
}

#[cfg(test)]
mod tests {
    use super::super::Reason;
    use super::*;

    fn output(phase: Phase, frequency_hz: f64) -> ChatterOutput {
        ChatterOutput {
            phase,
            frequency_hz: Some(frequency_hz),
            power_n2: 1.0,
            contrast: 20.0,
            growth_1_s: None,
            reason: Reason::default(),
            event: None,
        }
    }

    fn phase(state: &mut AgreementState, t_s: f64, outputs: &[ChatterOutput]) -> Phase {
        agree(state, t_s, outputs.iter().enumerate()).phase
    }

    #[test]
    fn two_axes_on_one_line_are_believed_soon() {
        let both = [output(Phase::Chatter, 650.0), output(Phase::Suspected, 652.0)];
        let mut state = AgreementState::default();
        assert_eq!(phase(&mut state, 0.0, &both), Phase::Suspected);
        assert_eq!(phase(&mut state, 0.13, &both), Phase::Chatter);
    }

    #[test]
    fn one_axis_alone_must_last() {
        let mut state = AgreementState::default();
        let alone = [output(Phase::Chatter, 540.0), output(Phase::Suspected, 650.0)];
        assert_eq!(phase(&mut state, 0.0, &alone), Phase::Suspected);
        assert_eq!(phase(&mut state, 0.9, &alone), Phase::Suspected);
        assert_eq!(phase(&mut state, 1.0, &alone), Phase::Chatter);
        // The only axis there is has nobody to ask.
        assert_eq!(phase(&mut AgreementState::default(), 0.0, &alone[..1]), Phase::Chatter);
    }

    #[test]
    fn one_axis_alone_is_believed_the_sooner_the_clearer_it_is() {
        let told_s = |contrast: f64| {
            let mut state = AgreementState::default();
            (0..300).map(|k| 0.005 * f64::from(k)).find(|t_s| {
                let alone = ChatterOutput { contrast, ..output(Phase::Chatter, 540.0) };
                phase(&mut state, *t_s, &[alone, output(Phase::Suspected, 650.0)]) == Phase::Chatter
            })
        };
        for (contrast, after_s) in [(3000.0, 0.12), (500.0, 0.12), (150.0, 0.4), (30.0, 1.0)] {
            assert!((told_s(contrast).unwrap() - after_s).abs() < 0.011, "{contrast}");
        }
    }

    #[test]
    fn another_line_elsewhere_does_not_stop_the_clock() {
        // The other axis is louder now and then, each time on another line.
        let mut state = AgreementState::default();
        let mut phase_at = |t_s: f64| {
            let loud = ChatterOutput { contrast: 90.0, ..output(Phase::Chatter, 300.0 + 100.0 * t_s) };
            let quiet = output(Phase::Quiet, 300.0);
            let other = if ((t_s * 4.0) as u32).is_multiple_of(2) { loud } else { quiet };
            agree(&mut state, t_s, [output(Phase::Chatter, 540.0), other].iter().enumerate())
        };
        assert_eq!((0..100).find(|k| phase_at(0.01 * f64::from(*k)).phase == Phase::Chatter), None);
        let now = phase_at(1.0);
        assert_eq!((now.phase, now.frequency_hz), (Phase::Chatter, Some(540.0)));
    }
}
