//! The residuals that a page shows: before and after, and the recording in which they tell most.

use crate::diagnosis::{Diagnosis, RecordingFit, Verdict};
use crate::plant::effects::Port;
use crate::signal::inner_products::rms;

/// A recording and one of its balances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Picked {
    pub(super) recording: usize,
    pub(super) balance: usize,
}

/// The recording and balance where before and after differ most; without findings, where most is left, on the
/// side where it was located.
pub(super) fn telling(d: &Diagnosis) -> Option<Picked> {
    let side = match (d.verdict, d.location.as_ref().map(|l| l.port)) {
        (Verdict::UnexplainedMismatch, Some(Port::Motor)) => Some(0),
        (Verdict::UnexplainedMismatch, Some(Port::Stage)) => Some(d.balances.len().saturating_sub(1)),
        _ => None,
    };
    let mut best: Option<(f64, Picked)> = None;
    for (recording, fit) in d.recordings.iter().enumerate() {
        for balance in (0..fit.residual_before_n.len()).filter(|b| side.is_none_or(|s| s == *b)) {
            let Some(after) = fit.residual_after_n.get(balance).filter(|a| !a.is_empty()) else { continue };
            let floor = d.noise_floor_n.get(balance).copied().unwrap_or(1.0).max(1.0e-9);
            let shown = before(d, fit, balance);
            let gain = (rms(shown).powi(2) - rms(after).powi(2)) / floor + 1.0e-3 * rms(shown) / floor;
            if best.is_none_or(|(g, _)| gain > g) {
                best = Some((gain, Picked { recording, balance }));
            }
        }
    }
    best.map(|(_, p)| p)
}

/// What "before" is: with a finding, the stated model with its numbers re-estimated; else as it was stated.
pub(super) fn before<'a>(d: &Diagnosis, fit: &'a RecordingFit, balance: usize) -> &'a [f64] {
    let stated = d.verdict != Verdict::MissingPhysics;
    let series = if stated { &fit.residual_nominal_n } else { &fit.residual_before_n };
    series.get(balance).map_or(&[], Vec::as_slice)
}

pub(super) fn after(fit: &RecordingFit, balance: usize) -> &[f64] {
    fit.residual_after_n.get(balance).map_or(&[], Vec::as_slice)
}
