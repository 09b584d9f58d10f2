//! Whether the tools cut, from the mean force: the bar pushes a tool away, so the mean rises where it enters
//! and falls where it leaves. Friction holds a part of the mean of a standing axis back, another one after it
//! has moved; it does not turn its sign. What changes while the turret moves is told by its friction, and
//! chatter that ends after it has moved ended by that: the tools stay where they were.

use crate::chatter::ChatterEvent;
use crate::force::motion::MotionSample;
use crate::keyframe::keep;

/// When the mean has changed, with the reason of each number.
struct Criteria;

impl Criteria {
    /// A turn at 1200 rpm: orders of the spindle leave no mean in it.
    const SLICE_S: f64 = 0.05;
    /// Slices after which a change is over: the detector's window of the mean force.
    const OVER: usize = 7;
    /// Slices of each side that are compared.
    const COMPARED: usize = 4;
    /// What a drive gives way under the force of a cut, m: 1000 N at 10 N/um.
    const STANDS_M: f64 = 100e-6;
    /// Differences of the means are real from here on, in standard errors.
    const REAL: f64 = 5.0;
}

/// Slices that are kept: those before a change, the change, those after.
const KEPT: usize = 2 * Criteria::OVER;

/// What was heard so far. One for all axes of the turret.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct CutWatch {
    ring: [f64; KEPT],
    sum_n: f64,
    count: usize,
    /// Whole slices.
    whole: usize,
    /// Slice at which the change at hand is over; 0: none.
    due: usize,
    /// The change at hand is the end of chatter.
    after_chatter: bool,
    /// The turret has moved since chatter began.
    moved: bool,
    /// Whole slices since it last moved.
    stood: usize,
    in_cut: Option<bool>,
    /// Mean force in air.
    air_n: Option<f64>,
}

keep!(CutWatch { ring, sum_n, count, whole, due, after_chatter, moved, stood, in_cut, air_n });

/// Whether an axis stands: the force on one that moves has friction and inertia of its drive in its mean.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Stand {
    place_m: f64,
    since_s: f64,
}

keep!(Stand { place_m, since_s });

impl Stand {
    /// Takes where the axis is; whether it has stayed there for as long as a change of the mean takes.
    pub(super) fn step(&mut self, motion: MotionSample, period_s: f64) -> bool {
        let place_m = motion.stage_position_m.or(motion.motor_travel_m).unwrap_or(0.0);
        if (place_m - self.place_m).abs() > Criteria::STANDS_M {
            *self = Self { place_m, since_s: 0.0 };
        }
        self.since_s += period_s;
        self.since_s > Criteria::OVER as f64 * Criteria::SLICE_S
    }
}

/// Mean and squared standard error.
fn mean_of(slices: &[f64]) -> (f64, f64) {
    let count = slices.len() as f64;
    let mean = slices.iter().sum::<f64>() / count;
    (mean, slices.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (count * (count - 1.0)))
}

impl CutWatch {
    /// Whether the tools cut; nothing before anything told it.
    pub(super) fn in_cut(&self) -> Option<bool> {
        self.in_cut
    }

    /// One sample. `away_n`: force that pushes the turret away from the bar, N; `stands`: whether all of the
    /// turret's axes do; `event`: what the detector heard with it.
    pub(super) fn step(&mut self, away_n: f64, stands: bool, period_s: f64, event: Option<&ChatterEvent>) {
        self.moved |= !stands;
        self.stood = if stands { self.stood } else { 0 };
        match event {
            Some(ChatterEvent::Onset(_)) => (self.in_cut, self.due, self.moved) = (Some(true), 0, false),
            Some(ChatterEvent::CutChanged) if self.due == 0 => self.change(false),
            Some(ChatterEvent::End) if !self.moved => self.change(true),
            _ => {}
        }
        self.sum_n += away_n;
        self.count += 1;
        if self.count as f64 * period_s < Criteria::SLICE_S {
            return;
        }
        self.ring[self.whole % KEPT] = self.sum_n / self.count as f64;
        (self.sum_n, self.count) = (0.0, 0);
        self.whole += 1;
        self.stood += 1;
        if self.whole == self.due {
            self.due = 0;
            self.judge();
        }
    }

    fn change(&mut self, after_chatter: bool) {
        (self.due, self.after_chatter) = (self.whole + Criteria::OVER, after_chatter);
    }

    /// A change is over: which way did the mean go?
    fn judge(&mut self) {
        // A drive that has come to rest lets go of its friction for some tenths of a second: that it pushes
        // less is no exit then.
        let friction = self.stood < KEPT + Criteria::OVER && !self.after_chatter;
        if self.whole < KEPT {
            return;
        }
        let slice = |back: usize| self.ring[(self.whole - back) % KEPT];
        let last: [f64; Criteria::COMPARED] = std::array::from_fn(|i| slice(i + 1));
        // One slice before the change may hold a part of it.
        let first: [f64; Criteria::COMPARED] = std::array::from_fn(|i| slice(Criteria::OVER + 2 + i));
        let ((after_n, after_se2), (before_n, before_se2)) = (mean_of(&last), mean_of(&first));
        if friction && after_n < before_n {
            return;
        }
        let real = (after_n - before_n).abs() > Criteria::REAL * (after_se2 + before_se2).sqrt();
        let nearer_air = |air_n: f64| (after_n - air_n).abs() < (after_n - before_n).abs();
        self.in_cut = if self.after_chatter {
            // It ends in the cut unless the force goes with it.
            let left = self.air_n.map(|air_n| real && after_n < before_n && nearer_air(air_n));
            left.map(|left| !left)
        } else if !real {
            self.in_cut
        } else {
            Some(after_n > before_n || self.in_cut == Some(true) && !self.air_n.is_none_or(nearer_air))
        };
        match self.in_cut {
            Some(false) => self.air_n = Some(after_n),
            Some(true) if self.air_n.is_none() && !self.after_chatter => self.air_n = Some(before_n),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chatter::Line;

    const PERIOD_S: f64 = 1e-3;

    /// Stretches of (duration, mean), each with what the detector hears at its beginning, under noise; what
    /// is said 0.6 s later.
    fn said(stretches: &[(f64, f64, Option<ChatterEvent>)]) -> Vec<Option<bool>> {
        said_while(stretches, None)
    }

    /// The same while the turret moves in one of them.
    fn said_while(stretches: &[(f64, f64, Option<ChatterEvent>)], moves: Option<usize>) -> Vec<Option<bool>> {
        let (mut watch, mut said, mut seed) = (CutWatch::default(), Vec::new(), 1u64);
        for (index, (lasts_s, mean_n, event)) in stretches.iter().enumerate() {
            let samples = (lasts_s / PERIOD_S) as usize;
            for k in 0..samples {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let noise = (seed >> 33) as f64 / f64::from(1u32 << 31) - 0.5;
                // Heard a moment later than it happens.
                let stands = moves != Some(index) || k < 1000;
                watch.step(mean_n + noise, stands, PERIOD_S, event.as_ref().filter(|_| k == 20));
                if k == 600 {
                    said.push(watch.in_cut());
                }
            }
        }
        said
    }

    const CHANGED: Option<ChatterEvent> = Some(ChatterEvent::CutChanged);
    const END: Option<ChatterEvent> = Some(ChatterEvent::End);

    fn onset() -> Option<ChatterEvent> {
        Some(ChatterEvent::Onset(Line {
            frequency_hz: 650.0,
            power_n2: 9.0,
            growth_1_s: 8.0,
            contrast: 50.0,
        }))
    }

    #[test]
    fn entry_and_exit_are_told_apart_whatever_friction_holds_back() {
        for friction_n in [-12.0, 0.0, 25.0] {
            let (air, cut) = (friction_n, friction_n + 18.0);
            let (yes, no) = (Some(true), Some(false));
            let passes =
                [(3.0, air, None), (3.0, cut, CHANGED), (3.0, air - 2.0, CHANGED), (3.0, cut + 3.0, CHANGED)];
            assert_eq!(said(&passes), [None, yes, no, yes]);
            // A deeper and a lighter cut are cuts.
            let steps =
                [(3.0, air, None), (3.0, cut, CHANGED), (3.0, cut + 9.0, CHANGED), (3.0, cut + 1.0, CHANGED)];
            assert_eq!(said(&steps), [None, yes, yes, yes]);
        }
    }

    #[test]
    fn chatter_that_ends_says_whether_the_tools_left() {
        let (yes, no) = (Some(true), Some(false));
        let healed = [(3.0, 0.0, None), (3.0, 30.0, CHANGED), (3.0, 33.0, onset()), (3.0, 30.0, END)];
        assert_eq!(said(&healed), [None, yes, yes, yes]);
        let left = [(3.0, 0.0, None), (3.0, 30.0, CHANGED), (3.0, 33.0, onset()), (3.0, 1.0, END)];
        assert_eq!(said(&left), [None, yes, yes, no]);
        // The same after the turret moved in chatter: friction took its part of the mean.
        assert_eq!(said_while(&left, Some(2)), [None, yes, yes, yes]);
        // Who began to listen in chatter knows no air.
        let early = [(3.0, 30.0, onset()), (3.0, 1.0, END), (3.0, 30.0, CHANGED)];
        assert_eq!(said(&early), [yes, None, yes]);
    }

    /// The turret moves in a cut and friction takes another part of the mean: the tools have not left.
    #[test]
    fn a_turret_that_moves_is_not_out_of_the_cut() {
        let (yes, no) = (Some(true), Some(false));
        let moves = [(3.0, 0.0, None), (3.0, 30.0, CHANGED), (3.0, 4.0, CHANGED), (3.0, -20.0, CHANGED)];
        assert_eq!(said_while(&moves, Some(1)), [None, yes, yes, no]);
        assert_eq!(said(&moves), [None, yes, no, no]);
    }

    #[test]
    fn a_change_of_the_noise_alone_says_nothing() {
        assert_eq!(said(&[(3.0, 5.0, None), (3.0, 5.0, CHANGED)]), [None, None]);
    }
}
