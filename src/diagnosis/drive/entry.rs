//! When tools cut, where the spindle turns and nothing else says so.
//!
//! A cut pushes: the mean of what is left steps up as the tools enter and back as they leave, which no law of
//! position, speed or time since the start does. It is asked before anything else, in the one stretch of a
//! recording whose mean stands furthest from the rest of it.

use super::answer::is_other_than_zero;
use super::case::Case;
use super::evidence::{ask, level};
use super::laws::cutting_force::Push;
use super::laws::{Deviations, Hypothesis, Shape};
use super::numbers::doubt;
use super::rest::{Rest, rest};
use super::state::{Accepted, Balance, State, residual};
use super::subject::Drive;
use crate::diagnosis::criteria::Criteria;
use crate::diagnosis::cuts::Mask;
use crate::diagnosis::result::{Diagnosis, Verdict};
use crate::diagnosis::selection::{Fitted, Round, Screened, Subject, Work};
use crate::plant::effects::Port;

/// A cut that was found.
pub(super) struct Entered {
    pub(super) fitted: Fitted<Hypothesis, State>,
}

/// The cut beside a state. `None`: none is told of, the spindle stands, or the budget is spent.
pub(super) fn entered(balance: &Balance, state: &State, work: &mut Work) -> Option<Entered> {
    let spindle_hz = balance.signals.spindle_hz()?;
    let (recording, window_s) = stretch(balance, state, spindle_hz)?;
    let h = Hypothesis::new(Port::Stage, Push { recording, spindle_hz, window_s });
    let chance = work.take(1).then(|| ask(balance, state, &h, true).chance)?;
    // Friction holds any force at rest, in a short recording as well.
    let c = &Criteria::STANDARD;
    let drive = Drive::beside_chance(balance, chance.max(c.artefact_nats / c.knockoff_factor));
    let mut fitted = drive.fit(state, &h, work)?;
    (fitted.model, _) = drive.settle(state, fitted.model, work);
    fitted.qualifies().then_some(Entered { fitted })
}

impl Entered {
    /// The round in which it was asked.
    pub(super) fn round(&self) -> Round<Hypothesis, State> {
        let screened =
            vec![Screened { hypothesis: self.fitted.hypothesis, promise_nats: self.fitted.evidence_nats }];
        Round { fitted: vec![self.fitted.clone()], screened, accepted: true }
    }

    /// Rows of each recording in the cut; the chip grows and ends over a turn.
    pub(super) fn rows(&self, balance: &Balance) -> Vec<Mask> {
        let mut out: Vec<Mask> = balance.signals.tracks.iter().map(|t| vec![false; t.samples]).collect();
        if let Shape::Push(push) = self.fitted.hypothesis.shape {
            let Push { recording, spindle_hz, window_s: [start_s, end_s] } = push;
            let track = &balance.signals.tracks[recording];
            let row = |t_s: f64| ((t_s * track.rate_hz).max(0.0) as usize).min(track.samples);
            out[recording][row(start_s - 1.0 / spindle_hz)..row(end_s + 1.0 / spindle_hz)].fill(true);
        }
        out
    }
}

impl Case<'_> {
    /// The answer of what is left without a cut, the cut before all else (`state`: the model with it).
    ///
    /// `in_air`: what is left, `None` where too little was measured in motion without the cut. `None`: the
    /// mean of the cut is not told, and what is left was not asked.
    pub(super) fn beside_cut(
        self,
        state: State,
        in_air: impl FnOnce() -> Option<Diagnosis>,
    ) -> Option<Diagnosis> {
        let left = rest(self.balance, &state);
        // How a cut's force varies about its mean is in the spectrum of what is left.
        let doubt = doubt(self.balance, &state, &Rest { force_n: 0.0, ..left.clone() });
        let sized = |(a, d): (&Accepted, &Deviations)| is_other_than_zero(self.balance, (&state, a), d);
        if !state.accepted.iter().zip(&doubt.laws).all(sized) {
            return None;
        }
        let mut in_air = in_air().unwrap_or_else(|| self.nothing_else(&state));
        let found = self.found(&state, &doubt, &[], level(&state, (1, 0.0)));
        let named = found.first().map(|f| f.named);
        let mut findings = self.findings(found, (&state, &[]), &left);
        in_air.notes.extend(self.notes.iter().cloned());
        if in_air.verdict == Verdict::UnexplainedMismatch {
            return Some(in_air);
        }
        if let Some(first) = findings.first() {
            in_air.location =
                self.location(Verdict::MissingPhysics, (Some(first), named), &left, (&state, &[]));
            in_air.verdict = Verdict::MissingPhysics;
        }
        findings.append(&mut in_air.findings);
        findings.iter_mut().enumerate().for_each(|(k, f)| f.rank = k + 1);
        Some(Diagnosis { findings, ..in_air })
    }

    /// The answer of an axis of which nothing can be told but a cut (`state`: the model with it).
    fn nothing_else(&self, state: &State) -> Diagnosis {
        let series = self.series(state);
        let found = Case { notes: Vec::new(), ..*self }.answer(self.start.clone());
        let note =
            "Without the cut too little was measured in motion: nothing else can be told of this axis.";
        Diagnosis {
            verdict: Verdict::ModelAdequate,
            findings: Vec::new(),
            parameter_corrections: Vec::new(),
            recordings: self.recording_fits(&series, false),
            force_faults: Vec::new(),
            detection_limits: Vec::new(),
            model: self.machine.clone(),
            notes: vec![note.to_owned()],
            ..found
        }
    }
}

/// Rows that are in `masks` and not in `others`.
pub(super) fn without(masks: &[Mask], others: &[Mask]) -> Vec<Mask> {
    joined(masks, others, |own, other| own && !other)
}

/// Rows that are in `rows` or in `masks`.
pub(super) fn with(rows: &[Mask], masks: &[Mask]) -> Vec<Mask> {
    joined(rows, masks, |own, other| own || other)
}

fn joined(masks: &[Mask], others: &[Mask], of: fn(bool, bool) -> bool) -> Vec<Mask> {
    let none = Mask::new();
    let each = |(r, mask): (usize, &Mask)| {
        let other = others.get(r).unwrap_or(&none).iter().copied().chain(std::iter::repeat(false));
        mask.iter().zip(other).map(|(own, other)| of(*own, other)).collect()
    };
    masks.iter().enumerate().map(each).collect()
}

/// The recording and the stretch, s since it began, in which the mean of what is left stands furthest off.
///
/// Of n parts with mean m, k of them with sum s: (s - k m)^2 / (k (1 - k / n)) is the gain in squares.
fn stretch(balance: &Balance, state: &State, spindle_hz: f64) -> Option<(usize, [f64; 2])> {
    let s = &balance.signals;
    let left = residual(balance, state.base.fitted());
    let series = balance.plan.series(left.sides[s.last()].as_ref()?, &s.lengths());
    let mut best: Option<(f64, usize, [f64; 2])> = None;
    for (r, track) in s.answering() {
        // Half a block at either end is known to a part only.
        let half = (0.5 * s.thin_rate_hz() / balance.plan.bin_hz) as usize;
        let known = series[r].iter().rposition(|v| *v != 0.0).map_or(0, |last| last + 1);
        let x = series[r].get(half..known.saturating_sub(half)).unwrap_or_default();
        // Over whole turns an eccentric bar has no mean.
        let length = ((s.thin_rate_hz() / spindle_hz) as usize).max(1);
        let sums: Vec<f64> = std::iter::once(0.0)
            .chain(x.chunks_exact(length).scan(0.0, |sum, part| {
                *sum += part.iter().sum::<f64>() / length as f64;
                Some(*sum)
            }))
            .collect();
        let parts = sums.len() - 1;
        let n = parts as f64;
        // The first and the last part reach to the ends of the recording.
        let at_s = |k: usize| match k {
            0 => 0.0,
            _ if k < parts => track.thin_s(half + k * length, s.step),
            _ => track.samples as f64 / track.rate_hz,
        };
        for from in 0..parts {
            for to in from + 1..=parts {
                let (k, sum) = ((to - from) as f64, sums[to] - sums[from]);
                // Of a stretch and the rest the cut is what pushes harder.
                if k < n && (sum / k).abs() > ((sums[parts] - sum) / (n - k)).abs() {
                    let off = sum - k / n * sums[parts];
                    let gain = off * off / (k * (1.0 - k / n));
                    if best.is_none_or(|b| gain > b.0) {
                        best = Some((gain, r, [at_s(from), at_s(to)]));
                    }
                }
            }
        }
    }
    best.map(|(_, r, window_s)| (r, window_s))
}
