//! Entry and exit: the mean force differs from what it was one turn ago; that of a whole turn is back at what
//! it was before the entry.

use crate::units::SampleRate;

/// Between two looks.
const LOOK_S: f64 = 0.005;
/// Smoothing of the force.
const SMOOTH_S: f64 = 0.012;
/// Looks that are kept: a third of a second, one turn at 190 rpm. For so long the friction of a servo gives
/// way to a force that has come: another change belongs to the first.
const LOOKS: usize = 64;
/// Share of the force that a change must have: chatter itself moves the mean by less.
const SHARE: f64 = 0.3;
/// And over the usual ripple from turn to turn.
const OVER_RIPPLE: f64 = 8.0;

/// What the mean of a series tells of the cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeanForce {
    /// Nothing: an acceleration has none.
    Absent,
    /// By how much it differs from that in air: friction of a drive is left in it.
    OverAir,
    /// The force of the tool, which pushes and never pulls.
    Whole,
}

/// What the level does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Change {
    None,
    /// It begins to rise away from zero.
    Rises,
    /// It is back where it was before, or begins to fall where friction hides where that is.
    Falls,
    /// The same for a third of a second: chatter that throws the tool out of the cut does not last so long.
    Gone,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct CutLevel {
    period_s: f64,
    /// Of each sample in the level.
    share: f64,
    mean: MeanForce,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct CutLevelState {
    level_n: f64,
    looks: [f64; LOOKS],
    seen: usize,
    since_look_s: f64,
    ripple_n: f64,
    /// The mean force nearest to zero so far, in thirds of a second: no tool cuts there, as far as is known.
    rest_n: f64,
    /// Whether it has ever changed at once, as where tools enter or leave.
    moved: bool,
    changing: bool,
    /// Before the newest rise.
    air_n: f64,
    /// Mean since then, of the last third of a second; looks since then.
    cut_n: f64,
    risen: usize,
    /// Until this look a change is the same change, of a servo.
    quiet_until: usize,
    started: bool,
}

crate::keyframe::keep!(CutLevelState {
    level_n,
    looks,
    seen,
    since_look_s,
    ripple_n,
    rest_n,
    moved,
    changing,
    air_n,
    cut_n,
    risen,
    quiet_until,
    started
});

impl CutLevelState {
    /// Farthest that the level went from rest in the last tenth of a second: what an entry rises to.
    /// Checked by: `an_entry_is_what_the_level_went_from_rest`.
    pub(super) fn reached_n(&self) -> f64 {
        let rest_n = if self.moved && self.rest_n.is_finite() { self.rest_n } else { 0.0 };
        self.looks[..self.seen.clamp(1, LOOKS / 3)].iter().map(|n| (n - rest_n).abs()).fold(0.0, f64::max)
    }

    /// Mean of that many looks, or of those that there are.
    fn mean_of_last_n(&self, looks: usize) -> f64 {
        let looks = &self.looks[..self.seen.clamp(1, looks)];
        looks.iter().sum::<f64>() / looks.len() as f64
    }
}

impl CutLevel {
    pub(super) fn new(rate: SampleRate, mean: MeanForce) -> Self {
        let period_s = rate.period_s();
        Self { period_s, share: (period_s / SMOOTH_S).min(1.0), mean }
    }

    pub(super) fn start(&self) -> CutLevelState {
        CutLevelState {
            level_n: 0.0,
            looks: [0.0; LOOKS],
            seen: 0,
            since_look_s: 0.0,
            ripple_n: 0.0,
            rest_n: f64::INFINITY,
            moved: false,
            changing: false,
            air_n: 0.0,
            cut_n: 0.0,
            risen: 0,
            quiet_until: 0,
            started: false,
        }
    }

    /// Takes one force; `speed_hz` is turns per second, 0 where it is not known, `cuts` whether the tools are
    /// in the cut. Looks at the level every 5 ms.
    #[inline]
    pub(super) fn step(&self, state: &mut CutLevelState, force_n: f64, speed_hz: f64, cuts: bool) -> Change {
        if !state.started {
            (state.started, state.level_n) = (true, force_n);
        }
        state.level_n += (force_n - state.level_n) * self.share;
        state.since_look_s += self.period_s;
        if state.since_look_s < LOOK_S {
            return Change::None;
        }
        state.since_look_s -= LOOK_S;
        self.look(state, speed_hz, cuts)
    }

    #[inline(never)]
    fn look(&self, state: &mut CutLevelState, speed_hz: f64, cuts: bool) -> Change {
        let turn_s = if speed_hz > 0.0 { 1.0 / speed_hz } else { 0.05 };
        state.looks.rotate_right(1);
        state.looks[0] = state.level_n;
        state.seen = (state.seen + 1).min(1_000_000);
        let mean_n = state.mean_of_last_n(LOOKS);
        if state.seen >= LOOKS && mean_n.abs() < state.rest_n.abs() {
            state.rest_n = mean_n;
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let back = ((turn_s / LOOK_S).round().max(1.0) as usize).min(LOOKS - 1);
        // Looks that tell the ripple.
        let Some(looked @ 1..) = state.seen.checked_sub(back + 4) else { return Change::None };
        // It begins against one turn ago; once it has begun, half a turn without change is the end of it.
        let before = state.looks[if state.changing { back.div_ceil(2) } else { back }];
        let apart = (state.level_n - before).abs();
        let large = SHARE * state.level_n.abs().max(before.abs());
        // While the ripple is hardly known only what comes from next to nothing, far above it.
        let over_ripple = match looked {
            6..46 if before.abs() < SHARE * state.level_n.abs() => 3.0 * OVER_RIPPLE,
            0..46 => f64::INFINITY,
            _ => OVER_RIPPLE,
        };
        let changes = apart > large && apart > over_ripple * state.ripple_n;
        let begins = changes && !state.changing && state.seen > state.quiet_until;
        // What goes on past zero as the tools leave is no entry: a change rises to the side to which they
        // pushed, or begins.
        let push_n = state.cut_n - state.air_n;
        let away = state.level_n.abs() > before.abs();
        let rises = match self.mean {
            MeanForce::Whole if (state.level_n - state.air_n).abs() < push_n.abs() => {
                (state.level_n - before) * push_n > 0.0 || (begins && away)
            }
            _ => away,
        };
        state.changing = changes;
        if changes {
            (state.moved, state.quiet_until) = (true, state.seen + LOOKS);
        } else {
            let share = (1.0 / looked as f64).max(LOOK_S / 4.0);
            state.ripple_n += share * (apart - state.ripple_n);
        }
        match (self.mean, rises) {
            (MeanForce::Whole, _) if cuts => {
                state.risen += 1;
                state.cut_n += (state.level_n - state.cut_n) / state.risen.min(LOOKS) as f64;
                // Chatter that loses contact swings by all of the force, but not for a whole turn.
                let turn_n = state.mean_of_last_n(back);
                let rest_n = SHARE * (state.cut_n - state.air_n).abs();
                let left = |looks: usize, n: f64| state.risen > looks && (n - state.air_n).abs() < rest_n;
                match (left(back, turn_n), left(LOOKS, mean_n)) {
                    (true, true) => Change::Gone,
                    (true, false) => Change::Falls,
                    _ => Change::None,
                }
            }
            (MeanForce::Whole, true) if changes => {
                (state.air_n, state.cut_n, state.risen) = (before, state.level_n, 1);
                Change::Rises
            }
            (MeanForce::Whole, _) => Change::None,
            (_, true) if begins => Change::Rises,
            (_, false) if begins => Change::Falls,
            _ => Change::None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn changes(force: impl Fn(f64) -> f64) -> Vec<f64> {
        let level = CutLevel::new(SampleRate::new(9000.0).unwrap(), MeanForce::Whole);
        let mut state = level.start();
        let (mut found, mut cuts) = (Vec::new(), false);
        for n in 0..45000 {
            let t = f64::from(n) / 9000.0;
            match level.step(&mut state, force(t), 20.0, cuts) {
                Change::None => {}
                change => {
                    cuts = change == Change::Rises;
                    found.push(t);
                }
            }
        }
        found
    }

    #[test]
    fn an_entry_is_what_the_level_went_from_rest() {
        let level = CutLevel::new(SampleRate::new(9000.0).unwrap(), MeanForce::Whole);
        let reached_n = |force: &dyn Fn(f64) -> f64| {
            let mut state = level.start();
            (0..36000).for_each(|n| {
                let _ = level.step(&mut state, force(f64::from(n) / 9000.0), 20.0, false);
            });
            state.reached_n()
        };
        let drifts_n = reached_n(&|t| 6.0 + t + 0.2 * (t * 600.0).sin());
        assert!((drifts_n - 10.0).abs() < 0.2, "{drifts_n}");
        let enters_n = reached_n(&|t| 6.0 + if t > 2.0 { 20.0 } else { 0.0 });
        assert!((enters_n - 20.0).abs() < 0.1, "{enters_n}");
    }

    /// An exit is told within its turn and goes on being told; a loss of contact for a turn ends nothing.
    #[test]
    fn tools_are_gone_after_a_third_of_a_second_without_force() {
        let level = CutLevel::new(SampleRate::new(9000.0).unwrap(), MeanForce::Whole);
        let told = |without_s: f64| {
            let (mut state, mut cuts) = (level.start(), false);
            let outside = |t: f64| t < 1.0 || (2.0..2.0 + without_s).contains(&t);
            let mut step = |n: i32| {
                let t = f64::from(n) / 9000.0;
                let force_n = (t * 600.0).sin() + if outside(t) { 0.0 } else { 80.0 };
                let change = level.step(&mut state, force_n, 20.0, cuts);
                cuts |= change == Change::Rises;
                change
            };
            (0..27000).map(&mut step).filter(|c| *c == Change::Gone).count()
        };
        assert_eq!(told(0.1), 0);
        assert!(told(0.5) > 0);
    }

    /// As tools leave, a sensor that has drifted passes through zero; another may push to the other side.
    #[test]
    fn what_goes_on_past_zero_is_no_entry_and_a_push_to_the_other_side_is_one() {
        let pass = |t: f64, at: f64, n: f64| {
            n * (((t - at) / 0.05).clamp(0.0, 1.0) - ((t - at - 1.0) / 0.1).clamp(0.0, 1.0))
        };
        let drift = |t: f64| -2.6 * ((t - 1.5) / 0.5).clamp(0.0, 1.0) + 0.1 * (t * 600.0).sin();
        let one = changes(|t| drift(t) + pass(t, 1.0, 70.0));
        assert!(one.len() == 2 && (one[1] - 2.1).abs() < 0.1, "{one:?}");
        let two = changes(|t| drift(t) + pass(t, 1.0, 80.0) + pass(t, 3.0, -60.0));
        assert!(two.len() == 4 && (two[2] - 3.0).abs() < 0.05 && (two[3] - 4.1).abs() < 0.1, "{two:?}");
    }

    #[test]
    fn entry_is_noticed_within_its_turn_and_drift_is_not() {
        let ripple = |t: f64| (t * 600.0).sin() + (t * 17.0).sin();
        let entry = changes(|t| ripple(t) + 80.0 * ((t - 2.0) / 0.05).clamp(0.0, 1.0));
        assert_eq!(entry.len(), 1, "{entry:?}");
        assert!(entry[0] > 2.0 && entry[0] < 2.05);
        assert!(changes(|t| ripple(t) + 80.0 + 5.0 * t).is_empty());
        let loses_contact = |t: f64| if t > 2.2 { 60.0 * (t * 40.0).sin().max(-1.0) } else { 0.0 };
        let pass = changes(|t| {
            let inside = ((t - 2.0) / 0.05).clamp(0.0, 1.0) - ((t - 3.0) / 0.05).clamp(0.0, 1.0);
            ripple(t) + inside * (80.0 + loses_contact(t)) + if t > 3.2 { 80.0 } else { 0.0 }
        });
        assert_eq!(pass.len(), 3, "{pass:?}");
        assert!(pass[1] > 3.0 && pass[1] < 3.1 && pass[2] < 3.22);
    }
}
