//! Whether the turret may be moved: a state computed from what was observed, not a sentence.
//!
//! Every item says what there is and what is needed. One that is missing keeps `act` away unless the
//! configuration accepts it by name, beside the name of who does.

use crate::config::service::{COMMISSIONING_ITEMS, TurretConfig};
use crate::store::{Judged, Observation};
use crate::units::counted;
use serde::Serialize;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use utoipa::ToSchema;

/// What is needed, with the reason of each number.
struct Criteria;

impl Criteria {
    /// One shift: everything that a machine does between switching on and off.
    const OBSERVED_S: f64 = 8.0 * 3600.0;
    /// What happens in one cut of seven is seen among twenty with 95 % (1 - (6/7)^20 = 0.954).
    const CUTS: i64 = 20;
    /// Sign test: more right alarms than false ones, at this level.
    const SIGNIFICANCE: f64 = 0.05;
    /// One command seen in `advise` before the first that is sent.
    const ADVISED: i64 = 1;
}

/// One item.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct CommissioningItem {
    /// `limits_stated`, `hours_observed`, `cuts_heard`, `alarms_reviewed`, `commands_advised`, `model_drift`
    /// or `heard_now`.
    pub name: String,
    /// What there is.
    pub found: String,
    /// What is needed.
    pub needed: String,
    /// Whether it is there.
    pub met: bool,
    /// Missing, and accepted by name in the configuration.
    pub accepted: bool,
}

/// What is heard at this moment, where it is fit to act on; else why not.
pub(super) type HeardNow = Result<String, String>;

/// Of the moment, not of the history: never done without.
fn heard_item(heard: HeardNow) -> CommissioningItem {
    let met = heard.is_ok();
    let found = heard.unwrap_or_else(|why| why);
    let needed = "noise learned and the force fit on every watched axis".to_owned();
    CommissioningItem { name: "heard_now".to_owned(), found, needed, met, accepted: false }
}

/// Where commissioning stands.
#[derive(Debug, Clone, PartialEq, Default, Serialize, ToSchema)]
pub struct CommissioningView {
    /// Every item is met or accepted.
    pub complete: bool,
    /// Who set the limits.
    pub limits_by: Option<String>,
    /// On which day.
    pub limits_date: Option<String>,
    /// Items.
    pub items: Vec<CommissioningItem>,
    /// Flags of the force estimate that the configuration accepts in `act`.
    pub accepted_flags: Vec<String>,
}

impl CommissioningView {
    /// What is missing, in one line; nothing where all is there or accepted.
    #[must_use]
    pub fn missing(&self) -> Option<String> {
        let missing = self.items.iter().filter(|i| !i.met && !i.accepted);
        let told: Vec<String> =
            missing.map(|i| format!("{} ({}, needed {})", i.name, i.found, i.needed)).collect();
        (!told.is_empty()).then(|| told.join("; "))
    }
}

/// Chance of at least `right` heads in `right + wrong` throws of a fair coin.
fn sign_test(judged: Judged) -> f64 {
    let total = judged.right + judged.wrong;
    let (mut ways, mut sum) = (1.0_f64, 0.0);
    for heads in (judged.right..=total).rev() {
        sum += ways;
        ways *= heads as f64 / (total - heads + 1) as f64;
    }
    let throws = i32::try_from(total).unwrap_or(i32::MAX);
    sum * 0.5_f64.powi(throws)
}

/// Where commissioning stands with what was observed.
pub(super) fn state_of(turret: &TurretConfig, seen: &Observation, judged: Judged) -> CommissioningView {
    let item = |name: &str, met: bool, found: String, needed: &str| CommissioningItem {
        name: name.to_owned(),
        found,
        needed: needed.to_owned(),
        met,
        accepted: !met && turret.accept.iter().any(|a| a == name),
    };
    let [hours, cuts, reviewed, advised, drift] = COMMISSIONING_ITEMS;
    let (by, date) = turret.commissioned.clone().unzip();
    let stated = by.clone().zip(date.clone()).map(|(by, date)| format!("{by}, {date}"));
    let (h, needed_h) = (seen.observed_s / 3600.0, Criteria::OBSERVED_S / 3600.0);
    let chance = sign_test(judged);
    let Judged { right, wrong } = judged;
    let items = vec![
        item(
            "limits_stated",
            stated.is_some(),
            stated.unwrap_or_else(|| "nobody".to_owned()),
            "turret.limits_by and turret.limits_date",
        ),
        item(hours, h >= needed_h, format!("{h:.1} h"), &format!("{needed_h:.0} h with samples")),
        item(cuts, seen.cuts >= Criteria::CUTS, seen.cuts.to_string(), &format!("{}", Criteria::CUTS)),
        item(
            reviewed,
            chance <= Criteria::SIGNIFICANCE,
            format!("{right} right, {wrong} false"),
            "significantly more right than false, such as 5 and 0",
        ),
        item(
            advised,
            seen.advised >= Criteria::ADVISED,
            format!("{}, up to {:.2} degrees", seen.advised, seen.largest_pitch_rad.to_degrees()),
            "one or more in mode advise",
        ),
        item(
            drift,
            seen.compared > 0 && seen.mismatches == 0,
            format!("{} in {}", counted(seen.mismatches, "difference"), counted(seen.compared, "comparison")),
            "compared, and no significant difference",
        ),
    ];
    let flags = turret.accept.iter().filter(|a| !COMMISSIONING_ITEMS.contains(&a.as_str()));
    CommissioningView {
        complete: items.iter().all(|i| i.met || i.accepted),
        limits_by: by,
        limits_date: date,
        items,
        accepted_flags: flags.cloned().collect(),
    }
}

/// Counts cuts: the tools entered and left.
#[derive(Debug, Default)]
pub(super) struct CutCounter {
    /// What was told last of whether they cut.
    inside: Option<bool>,
}

impl CutCounter {
    /// Whether the tools cut, where that is known; true where a cut ended.
    pub(super) fn look(&mut self, in_cut: Option<bool>) -> bool {
        let was = self.inside;
        self.inside = in_cut.or(was);
        was == Some(true) && in_cut == Some(false)
    }
}

/// What this life has observed so far, counted by the pipeline thread.
#[derive(Debug, Default)]
pub(super) struct Evidence {
    observed_ms: AtomicU64,
    cuts: AtomicI64,
    advised: AtomicI64,
    largest_microrad: AtomicU64,
}

impl Evidence {
    pub(super) fn observe_ms(&self, ms: u64) {
        self.observed_ms.fetch_add(ms, Ordering::Relaxed);
    }

    pub(super) fn hear_cut(&self) {
        self.cuts.fetch_add(1, Ordering::Relaxed);
    }

    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub(super) fn advise(&self, pitch_rad: f64) {
        self.advised.fetch_add(1, Ordering::Relaxed);
        self.largest_microrad.fetch_max((pitch_rad.abs() * 1e6) as u64, Ordering::Relaxed);
    }

    /// So far; `compared` and `mismatches` are counted elsewhere.
    pub(super) fn so_far(&self, (compared, mismatches): (u64, u64)) -> Observation {
        let whole = |count: u64| i64::try_from(count).unwrap_or(i64::MAX);
        Observation {
            observed_s: self.observed_ms.load(Ordering::Relaxed) as f64 * 1e-3,
            cuts: self.cuts.load(Ordering::Relaxed),
            advised: self.advised.load(Ordering::Relaxed),
            largest_pitch_rad: self.largest_microrad.load(Ordering::Relaxed) as f64 * 1e-6,
            compared: whole(compared),
            mismatches: whole(mismatches),
        }
    }
}

/// The state that everybody reads.
#[derive(Debug, Default)]
pub(super) struct Commissioning {
    pub(super) evidence: Evidence,
    view: Mutex<Arc<CommissioningView>>,
    heard: Mutex<Option<HeardNow>>,
}

impl Commissioning {
    pub(super) fn show(&self, view: CommissioningView) {
        *self.view.lock().unwrap_or_else(PoisonError::into_inner) = Arc::new(view);
    }

    /// What the history says.
    pub(super) fn of_history(&self) -> Arc<CommissioningView> {
        Arc::clone(&self.view.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Notes what is heard.
    pub(super) fn hear_now(&self, heard: HeardNow) {
        *self.heard.lock().unwrap_or_else(PoisonError::into_inner) = Some(heard);
    }

    /// What the history says, and what is heard now.
    pub(super) fn view(&self) -> CommissioningView {
        let heard = self.heard.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let item = heard_item(heard.unwrap_or_else(|| Err("nothing yet".to_owned())));
        let mut view = CommissioningView::clone(&self.of_history());
        view.complete &= item.met;
        view.items.push(item);
        view
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::service::ServiceConfig;

    fn turret(accept: &[&str]) -> TurretConfig {
        let mut turret = ServiceConfig::default().turret;
        turret.commissioned = Some(("anna".into(), "2026-11-21".into()));
        turret.accept = accept.iter().map(|a| (*a).to_owned()).collect();
        turret
    }

    fn enough() -> (Observation, Judged) {
        let seen = Observation {
            observed_s: 9.0 * 3600.0,
            cuts: 25,
            advised: 3,
            largest_pitch_rad: 0.1,
            compared: 12,
            mismatches: 0,
        };
        (seen, Judged { right: 6, wrong: 0 })
    }

    #[test]
    fn the_sign_test_is_the_binomial_tail() {
        let p = |right, wrong| sign_test(Judged { right, wrong });
        assert!((p(5, 0) - 1.0 / 32.0).abs() < 1e-12);
        assert!((p(4, 0) - 1.0 / 16.0).abs() < 1e-12);
        assert!((p(8, 2) - 56.0 / 1024.0).abs() < 1e-12, "{}", p(8, 2));
        assert!((p(0, 0) - 1.0).abs() < 1e-12 && (p(0, 7) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_cut_is_counted_as_the_tools_leave() {
        let mut counter = CutCounter::default();
        let told =
            [None, Some(true), Some(true), None, Some(true), Some(false), None, Some(false), Some(true)];
        let ended: Vec<bool> = told.into_iter().map(|in_cut| counter.look(in_cut)).collect();
        assert_eq!(ended.iter().filter(|e| **e).count(), 1);
        assert!(ended[5], "{ended:?}");
        assert!(counter.look(Some(false)));
    }

    #[test]
    fn what_is_heard_now_is_an_item_that_nobody_accepts() {
        let (seen, judged) = enough();
        let commissioning = Commissioning::default();
        commissioning.show(state_of(&turret(&["heard_now"]), &seen, judged));
        let missing = || commissioning.view().missing();
        assert!(
            !commissioning.view().complete && missing().is_some_and(|m| m.starts_with("heard_now (nothing"))
        );
        commissioning.hear_now(Err("x1: its noise is being learned".into()));
        assert!(!commissioning.view().complete && missing().is_some_and(|m| m.contains("learned")));
        commissioning.hear_now(Ok("x1, y1".into()));
        assert!(commissioning.view().complete && missing().is_none());
    }

    #[test]
    fn every_item_that_is_missing_keeps_act_away_until_it_is_accepted_by_name() {
        let (seen, judged) = enough();
        assert!(state_of(&turret(&[]), &seen, judged).complete);
        let lacks: [(&str, Observation, Judged); 5] = [
            ("hours_observed", Observation { observed_s: 100.0, ..seen.clone() }, judged),
            ("cuts_heard", Observation { cuts: 19, ..seen.clone() }, judged),
            ("alarms_reviewed", seen.clone(), Judged { right: 4, wrong: 0 }),
            ("commands_advised", Observation { advised: 0, ..seen.clone() }, judged),
            ("model_drift", Observation { mismatches: 1, ..seen.clone() }, judged),
        ];
        for (name, seen, judged) in &lacks {
            let view = state_of(&turret(&[]), seen, *judged);
            assert!(!view.complete && view.missing().is_some_and(|m| m.starts_with(name)), "{view:?}");
            assert!(state_of(&turret(&[name]), seen, *judged).complete, "{name} accepted");
        }
        let nobody = TurretConfig { commissioned: None, ..turret(&COMMISSIONING_ITEMS) };
        assert!(!state_of(&nobody, &seen, judged).complete, "who set the limits is never done without");
        assert!(!state_of(&turret(&[]), &Observation::default(), Judged::default()).complete);
    }
}
