//! Which stamps of a stream to believe: number and time of every sample must agree with what came before.
//!
//! A stamp far from the others is one wrong sample, not a new time: it is refused by its name and nothing
//! follows from it, also where its number and its time tell the same tale. Only where the samples of half a
//! window agree with each other and none with what came before has the producer's counter or clock really
//! jumped, or have so many samples been lost. Which of both says this machine's own clock: what was lost took
//! its time.

use super::SILENCE;
use crate::transport::wire::ServoPoint;
use crate::units::SampleRate;

/// Number and time of a sample may disagree by the jitter of a producer that stamps in software: a time slice
/// of an ordinary scheduler (4 ms), and the sample beside it.
const JITTER_S: f64 = 5e-3;
/// A quartz is right to 1e-4; a gap's length is believed with a hundred times that.
const RATE_ERROR: f64 = 1e-2;
/// Resynchronised within 50 ms by a majority of its samples.
const MAJORITY_S: f64 = 25e-3;

#[derive(Debug, Clone, Copy, PartialEq)]
struct Stamp {
    sequence: u64,
    t_ns: u64,
}

impl Stamp {
    fn of(point: &ServoPoint) -> Self {
        Self { sequence: point.sequence, t_ns: point.t_ns }
    }
}

/// Why a sample was not taken; the words are those of `stillcut_samples_rejected_total`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reject {
    /// A signal is no number.
    NotFinite,
    /// Its number came already.
    Duplicate,
    /// Newer by its number and older by its time.
    OutOfOrder,
    /// Number and time disagree with the samples around it.
    ImplausibleStamp,
    /// The batch says that it holds none, or more than fit.
    BadCount,
    /// The head of its batch names axes or a rate that are not those of its stream.
    BadLayout,
}

impl Reject {
    pub(super) const ALL: [Self; 6] = [
        Self::NotFinite,
        Self::Duplicate,
        Self::OutOfOrder,
        Self::ImplausibleStamp,
        Self::BadCount,
        Self::BadLayout,
    ];

    /// Counted by axis.
    pub(super) const OF_AN_AXIS: [Self; 3] = [Self::NotFinite, Self::Duplicate, Self::OutOfOrder];
    /// Counted for the stream.
    pub(super) const OF_THE_STREAM: [Self; 3] = [Self::ImplausibleStamp, Self::BadCount, Self::BadLayout];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::NotFinite => "not_finite",
            Self::Duplicate => "duplicate",
            Self::OutOfOrder => "out_of_order",
            Self::ImplausibleStamp => "implausible_stamp",
            Self::BadCount => "bad_count",
            Self::BadLayout => "bad_layout",
        }
    }
}

/// What a stamp is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Judged {
    /// It goes on from what came before, or the majority has moved ahead of it.
    Good,
    /// Not to be believed.
    Refused(Reject),
    /// The majority has moved back, or further ahead than time has passed: everything begins anew.
    Anew,
}

/// Stamps that are not believed and agree with each other.
#[derive(Debug, Clone, Copy)]
struct Run {
    first: Stamp,
    last: Stamp,
    samples: u64,
}

/// The newest stamp that is believed, and the run of those that are not.
#[derive(Debug)]
pub(super) struct Stamps {
    rate_hz: f64,
    believed: Option<Stamp>,
    /// When that came, s of this machine.
    heard_s: f64,
    run: Option<Run>,
}

impl Stamps {
    pub(super) fn new(rate: SampleRate) -> Self {
        Self { rate_hz: rate.hz(), believed: None, heard_s: 0.0, run: None }
    }

    /// Samples between two stamps, by number and by time.
    fn steps(&self, from: Stamp, to: Stamp) -> [f64; 2] {
        let numbers = to.sequence as f64 - from.sequence as f64;
        let seconds = (to.t_ns as f64 - from.t_ns as f64) * 1e-9;
        [numbers, seconds * self.rate_hz]
    }

    /// Samples of half a window.
    fn majority(&self) -> f64 {
        MAJORITY_S * self.rate_hz
    }

    fn agrees(&self, from: Stamp, to: Stamp) -> bool {
        let [numbers, times] = self.steps(from, to);
        let tolerance = JITTER_S * self.rate_hz + RATE_ERROR * numbers.max(0.0);
        to.sequence > from.sequence && to.t_ns >= from.t_ns && (times - numbers).abs() <= tolerance
    }

    /// Whether number and time tell the same of what lies between two samples.
    pub(super) fn agree(&self, from: &ServoPoint, to: &ServoPoint) -> bool {
        self.agrees(Stamp::of(from), Stamp::of(to))
    }

    /// The next sample, but for some that were lost: what leaps further is alone until others bear it out.
    fn goes_on(&self, from: Stamp, to: Stamp) -> bool {
        self.steps(from, to)[0] <= self.majority() && self.agrees(from, to)
    }

    /// The run with this stamp, where it goes on; from its first stamp on, too: a clock that stands is none.
    fn longer(&self, run: Run, now: Stamp) -> Option<Run> {
        let goes_on = self.goes_on(run.last, now) && self.agrees(run.first, now);
        goes_on.then_some(Run { last: now, samples: run.samples + 1, ..run })
    }

    /// `now_s`: when it came, s of this machine, which passes no sooner than the producer's by a second.
    pub(super) fn judge(&mut self, point: &ServoPoint, now_s: f64) -> Judged {
        let now = Stamp::of(point);
        let Some(believed) = self.believed.filter(|b| !self.goes_on(*b, now)) else {
            (self.believed, self.heard_s, self.run) = (Some(now), now_s, None);
            return Judged::Good;
        };
        let alone = Run { first: now, last: now, samples: 1 };
        let run = self.run.and_then(|run| self.longer(run, now)).unwrap_or(alone);
        let ahead = now.sequence > believed.sequence && now.t_ns >= believed.t_ns;
        if run.samples as f64 >= self.majority() {
            let leapt_s = self.steps(believed, now)[1] / self.rate_hz;
            let had_time = leapt_s <= now_s - self.heard_s + SILENCE.as_secs_f64();
            (self.believed, self.heard_s, self.run) = (Some(now), now_s, None);
            return if ahead && had_time { Judged::Good } else { Judged::Anew };
        }
        self.run = Some(run);
        // Back by number and by time it came before; by one of the two alone its stamp contradicts itself.
        Judged::Refused(match (now.sequence > believed.sequence, now.t_ns > believed.t_ns) {
            (false, false) => Reject::Duplicate,
            (true, false) if !ahead => Reject::OutOfOrder,
            _ => Reject::ImplausibleStamp,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE: f64 = 9000.0;

    fn stamps() -> Stamps {
        Stamps::new(SampleRate::new(RATE).unwrap())
    }

    /// Judged as it comes where the machine's clock and this one agree.
    fn judge(stamps: &mut Stamps, point: &ServoPoint) -> Judged {
        stamps.judge(point, point.t_ns as f64 * 1e-9)
    }

    fn point(sequence: u64, at: u64) -> ServoPoint {
        ServoPoint { sequence, t_ns: (at as f64 / RATE * 1e9) as u64, ..ServoPoint::default() }
    }

    #[test]
    fn one_wrong_stamp_spoils_one_sample() {
        for wrong in [
            ServoPoint { sequence: 1_000_000_000, ..point(500, 500) },
            ServoPoint { sequence: u64::MAX, ..point(500, 500) },
            ServoPoint { t_ns: 9_000_000_000_000_000_000, ..point(500, 500) },
            ServoPoint { t_ns: 0, ..point(500, 500) },
            point(3, 500),
            // Number and time tell the same tale.
            point(1_000_000_000, 1_000_000_000),
            point(2_000_000, 2_000_000),
            point(10_000, 10_000),
        ] {
            let mut stamps = stamps();
            let refused = |j: &Judged| matches!(j, Judged::Refused(_));
            let judged: Vec<Judged> = (0..2000)
                .map(|k| if k == 500 { wrong } else { point(k, k) })
                .map(|p| judge(&mut stamps, &p))
                .collect();
            assert_eq!(judged.iter().filter(|j| refused(j)).count(), 1, "{wrong:?}");
            assert!(refused(&judged[500]) && !judged.contains(&Judged::Anew));
        }
    }

    #[test]
    fn losses_jitter_and_a_slow_quartz_are_believed() {
        let mut stamps = stamps();
        // Every second one lost, then ten seconds, then stamps that are late by up to 3 ms.
        let lossy = (0..1000).map(|k| point(2 * k, 2 * k));
        let after = (0..1000).map(|k| point(92_000 + k, 92_000 + k));
        let late = (0..1000).map(|k| point(93_000 + k, 93_000 + k + 9 * (k % 3)));
        let slow = (0..90_000).map(|k| point(94_100 + k, 94_100 + k + k / 1000));
        for p in lossy.chain(after).chain(late).chain(slow) {
            let judged = judge(&mut stamps, &p);
            let back = matches!(judged, Judged::Refused(Reject::OutOfOrder)) && p.sequence > 93_000;
            // So great a leap is borne out by half a window.
            let leap =
                judged == Judged::Refused(Reject::ImplausibleStamp) && (92_000..92_224).contains(&p.sequence);
            assert!(judged == Judged::Good || back || leap, "{judged:?} at {}", p.sequence);
        }
    }

    #[test]
    fn a_leap_into_a_stream_with_losses_is_borne_out_too() {
        let mut stamps = stamps();
        assert_eq!(judge(&mut stamps, &point(0, 0)), Judged::Good);
        let found =
            (0..450).position(|k| judge(&mut stamps, &point(90_000 + 2 * k, 90_000 + 2 * k)) == Judged::Good);
        assert_eq!(found, Some(224));
    }

    #[test]
    fn batches_of_another_time_among_good_ones_are_refused() {
        let mut stamps = stamps();
        for k in 0..9000 {
            let far = k / 9 % 2 == 1;
            let shift = if far { 1_000_000_000 } else { 0 };
            let good = judge(&mut stamps, &point(k + shift, k + shift)) == Judged::Good;
            assert_eq!(good, !far, "{k}");
        }
    }

    #[test]
    fn the_majority_moves_ahead_or_back_within_50_ms() {
        for (shift, expected) in [(1_000_000_u64, Judged::Good), (0, Judged::Anew)] {
            let mut stamps = stamps();
            for k in 0..2000 {
                judge(&mut stamps, &point(k + 5000, k + 5000));
            }
            // The counter is another one from here on, the clock goes on (ahead) or is another one, too.
            let of = |k: u64| if shift > 0 { point(shift + k, 7000 + k) } else { point(k, k) };
            let found = (0..450).position(|k| judge(&mut stamps, &of(k)) == expected).expect("within 50 ms");
            assert!(found >= 200, "a few wrong ones in a row are no majority: {found}");
            assert!((found as u64 + 1..1000).all(|k| judge(&mut stamps, &of(k)) == Judged::Good));
        }
        // Number and time jump ahead together, and no time has passed: none of that was lost.
        for (ahead, passed_s, expected) in [(9_000_000, 0.03, Judged::Anew), (90_000, 10.0, Judged::Good)] {
            let mut stamps = stamps();
            (0..2000).for_each(|k| _ = judge(&mut stamps, &point(k, k)));
            let at_s = 2000.0 / RATE + passed_s;
            let mut judged = (0..450).map(|k| stamps.judge(&point(ahead + k, ahead + k), at_s));
            let bad = |j: &Judged| matches!(j, Judged::Refused(Reject::ImplausibleStamp));
            assert_eq!(judged.find(|j| !bad(j)), Some(expected));
        }
        // A producer that repeats an old batch again and again is no majority.
        let mut stamps = stamps();
        for k in 0..2000 {
            judge(&mut stamps, &point(k, k));
        }
        assert!((0..5000).all(|k| judge(&mut stamps, &point(100 + k % 32, 100 + k % 32)) != Judged::Anew));
    }
}
