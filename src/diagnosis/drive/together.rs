//! When both encoders of an axis are read, where nobody states it.
//!
//! The positions are taken as they belong together once the two things are known that bend that most: what
//! lies between command and thrust, and the speed over which friction turns. By a first-order law of the
//! damped spring a dead time is structural damping of the motor's side, and one encoder's delay is that of
//! both, with opposite signs; friction that turns too late is a damper between them.

use super::base::MOST_DELAY_SAMPLES;
use super::encoders::Readings;
use super::number::Number;
use super::state::{Balance, Standing, State};
use super::subject::{Drive, PASSES};
use super::{balance_of, given, laws, second_mass, start_of};
use crate::diagnosis::criteria::{Criteria, Z95};
use crate::diagnosis::selection::{Reach, Round, Work, select};
use crate::diagnosis::{DiagnoseError, DiagnoseOptions};
use crate::plant::machine::AxisModel;

/// What is known of an axis before any law of the machine is asked.
#[derive(Clone, Default)]
pub(super) struct Known {
    standing: Option<Standing>,
    /// In which it was found.
    pub(super) rounds: Vec<Round<laws::Hypothesis, State>>,
}

impl Known {
    /// A state beside that.
    pub(super) fn beside(&self, balance: &Balance, state: State) -> State {
        match &self.standing {
            Some(known) => state.beside(balance, known, PASSES),
            None => state,
        }
    }

    /// A motor that moved earlier was driven earlier by as much.
    fn motor_is_later(&mut self, by_s: f64) {
        if let Some(now) = self.standing.as_mut().filter(|now| now.found_delay) {
            now.path.delay_s -= by_s;
        }
    }
}

/// The axis with its terms folded into keys, and its balance, the positions taken together. Where the last
/// pass still asks for all that it may they are taken as stated.
/// Errors: as [`balance_of`].
pub(super) fn together(
    stated: &AxisModel,
    readings: &Readings<'_>,
    options: &DiagnoseOptions,
    work: &mut Work,
) -> Result<(AxisModel, Balance, Known), DiagnoseError> {
    let folded = given::folded(stated);
    let folded = second_mass::two_masses(&folded, &readings.recordings).unwrap_or(folded);
    let raw = folded.drive.raw();
    let is_unstated = raw.motor_encoder_delay_s.and(raw.stage_encoder_delay_s).is_none();
    let mut balance = balance_of(&folded, readings, options, (is_unstated.then_some(0.0), false))?;
    if !balance.numbers().contains(&Number::EncoderTiming) {
        return Ok((folded, balance, Known::default()));
    }
    let (mut axis, mut later_s, mut approach) = (folded.clone(), 0.0, Approach::default());
    let (mut known, mut as_stated) = (Known::default(), None);
    let mut own = work.half();
    let mut ends_at_most = false;
    for pass in 1..=PASSES {
        let start = known.beside(&balance, start_of([stated, &axis], &balance).0);
        let found = select(&Drive::of_numbers(&balance), start, Reach::default(), &mut own, &|_, _| {});
        known.standing = Some(found.model.now);
        known.rounds.extend(found.rounds.into_iter().filter(|round| round.accepted));
        let Some((more_s, deviation_s, is_most)) = found.model.stage_is_later_s() else { break };
        let usual_s = Criteria::STANDARD.timing_deviation / balance.signals.rate_hz;
        ends_at_most = is_most;
        // What is not looked at any more stays a number of the balance.
        if more_s.abs() < Z95 * usual_s.hypot(deviation_s) || own.is_spent() || pass == PASSES {
            break;
        }
        let most_s = MOST_DELAY_SAMPLES / balance.signals.rate_hz;
        let next_s = approach.next_s(later_s, (more_s, is_most), most_s);
        let next = given::read_later(&folded, next_s);
        // So late that a recording is too short for it.
        let Ok(moved) = balance_of(&next, readings, options, (Some(next_s), false)) else { break };
        let before = std::mem::replace(&mut balance, moved);
        as_stated.get_or_insert((before, known.clone()));
        known.motor_is_later((-next_s).max(0.0) - (-later_s).max(0.0));
        (axis, later_s) = (next, next_s);
    }
    work.take_over([&own, &Work::new(0)]);
    Ok(match as_stated.filter(|_| ends_at_most) {
        Some((balance, known)) => (folded, balance, known),
        None => (axis, balance, known),
    })
}

/// The way to a time at which nothing more is asked for. Noise that is free takes most of what a time leaves
/// for itself, and each fit asks for a part of the rest: longer steps while they go one way, then the secant.
#[derive(Default)]
struct Approach {
    /// Where more was asked for last, and where less was, and how much, s.
    low: Option<[f64; 2]>,
    high: Option<[f64; 2]>,
    /// How many times that much it went last.
    factor: f64,
}

impl Approach {
    /// Where to look next, s, from here and what is asked for more here, or the most that may be. No step is
    /// longer than that.
    fn next_s(&mut self, here_s: f64, (more_s, is_most): (f64, bool), most_s: f64) -> f64 {
        let side = if more_s > 0.0 { &mut self.low } else { &mut self.high };
        *side = Some([here_s, more_s]);
        if let (Some([low_s, more_s]), Some([high_s, less_s])) = (self.low, self.high)
            && low_s < high_s
        {
            return low_s + (high_s - low_s) * more_s / (more_s - less_s);
        }
        self.factor = if is_most { 1.0 } else { (2.0 * self.factor).max(1.0) };
        here_s + (self.factor * more_s).clamp(-most_s, most_s)
    }
}

#[cfg(test)]
mod tests {
    use super::{Approach, PASSES};

    #[test]
    fn fits_that_ask_for_a_tenth_arrive() {
        let (true_s, most_s) = (2.5e-4, 1.0e-4);
        let (mut approach, mut at_s) = (Approach::default(), 0.0);
        for _ in 0..PASSES {
            let asked_s = 0.1 * (true_s - at_s);
            at_s = approach.next_s(at_s, (asked_s, false), most_s);
        }
        assert!((at_s - true_s).abs() < 1e-9, "{at_s}");
        // At its bound each step is as long as that.
        let (mut approach, mut at_s) = (Approach::default(), 0.0);
        for _ in 0..PASSES {
            let left_s: f64 = true_s - at_s;
            let asked = (left_s.clamp(-most_s, most_s), left_s.abs() >= most_s);
            at_s = approach.next_s(at_s, asked, most_s);
        }
        assert!((at_s - true_s).abs() < 1e-9, "{at_s}");
    }
}
