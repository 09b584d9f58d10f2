//! The table of past cuts, and its diagnosis: what does the stated cut leave out?

use super::clock;
use super::control::Origin;
use super::diagnoses::{DiagnosisView, Subject};
use super::handle::{Handle, OperationError};
use crate::config::scenario::{scenario_from_text, scenario_to_text};
use crate::recording::write_whole;
use crate::store::{MAX_PAGE, PastCut};
use crate::units::counted;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;
use utoipa::ToSchema;

/// The rows as a table of cuts (contracts, section 6): CSV, SI units, one row a cut.
#[must_use]
pub fn cuts_csv(cuts: &[PastCut]) -> String {
    let mut out = String::from(
        "cut,spindle_speed_rpm,width_m,outcome,feed_m_rev,tool_position_m,pitch_difference_rad,line_hz,\
         growth_1_s,growth_se_1_s,began_at,lasted_s\n",
    );
    for cut in cuts {
        let cell =
            |value: Option<f64>, digits: usize| value.map_or_else(String::new, |v| format!("{v:.digits$}"));
        let (line, place) = (cell(cut.line_hz, 2), cell(cut.tool_position_m, 4));
        // An error is above zero; in three decimals it might not be.
        let growth = cut.growth_1_s.filter(|[_, error]| *error > 0.0);
        let [growth, error] = [0, 1].map(|k| growth.map_or_else(String::new, |g| format!("{:.3e}", g[k])));
        let PastCut { sequence, spindle_speed_rpm: speed, width_m, feed_m_rev, .. } = cut;
        let (outcome, pitch, began) = (cut.outcome(), cut.pitch_difference_rad, clock::rfc3339(cut.began_ns));
        // Into a string: cannot fail.
        let _ = writeln!(
            out,
            "{sequence},{speed:.1},{width_m},{outcome},{feed_m_rev},{place},{pitch:.4},{line},\
             {growth},{error},{began},{:.3}",
            cut.lasted_s
        );
    }
    out
}

/// Name of the scenario that a person accepted, in the folder of the history. Each diagnosis has its own: a
/// configuration that names an accepted one reads the same after the next is accepted.
fn accepted_name(id: &str) -> String {
    format!("accepted-scenario-{id}.toml")
}

/// A scenario that a person accepted, and what is left to do by hand.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct AcceptedScenario {
    /// The diagnosis that wrote it.
    pub diagnosis: String,
    /// Where it stands now.
    pub path: String,
    /// What makes the service use it.
    pub next: String,
}

/// A file that a job wrote, with its text: no link to elsewhere.
fn own_text(path: PathBuf) -> Option<(PathBuf, String)> {
    let is_own = std::fs::symlink_metadata(&path).is_ok_and(|m| m.is_file());
    let text = is_own.then(|| std::fs::read_to_string(&path).ok())??;
    Some((path, text))
}

impl Handle {
    /// A person agrees with the scenario that a diagnosis of the cut wrote: it is put on record and beside
    /// the history. What runs stays as it is until somebody names it in the configuration and starts anew.
    /// Errors: there is none, it is no scenario, or it cannot be put on record or written.
    pub async fn accept_scenario(
        &self,
        id: &str,
        origin: &Origin,
    ) -> Result<AcceptedScenario, OperationError> {
        let none = || OperationError::NotFound("there is no such scenario, or it is not ready".to_owned());
        let from = self.diagnoses().file_of(id, "scenario.toml").ok_or_else(none)?;
        let text = tokio::task::spawn_blocking(move || own_text(from)).await;
        let (from, text) = text.ok().flatten().ok_or_else(none)?;
        scenario_from_text(&from, &text).map_err(|e| OperationError::Unsuitable(e.to_string()))?;
        let what = format!("scenario of diagnosis {id}");
        self.audit(origin, "accept_scenario_asked", &what).await?;
        let to = self.0.settings.history.folder.join(accepted_name(id));
        let path = to.display().to_string();
        let written = tokio::task::spawn_blocking(move || write_whole(&to, text.as_bytes())).await;
        let failed = match written {
            Ok(Ok(())) => None,
            Ok(Err(error)) => Some(error.to_string()),
            Err(error) => Some(error.to_string()),
        };
        if let Some(why) = failed {
            self.record_outcome(origin, "accept_scenario", &format!("{what}: not written: {why}")).await;
            return Err(OperationError::NotWritten(why));
        }
        self.record_outcome(origin, "accept_scenario", &format!("{what}: written to {path}")).await;
        let next = format!(
            "let `scenario = \"{path}\"` in [cutting] stand in place of [workpiece] and the other keys of \
             [cutting], and start the service anew"
        );
        Ok(AcceptedScenario { diagnosis: id.to_owned(), path, next })
    }

    /// Past cuts before a place in the table, newest first. Errors: the history does not answer.
    pub async fn cuts(&self, before: Option<i64>, limit: i64) -> Result<Vec<PastCut>, OperationError> {
        Ok(self.0.reader.cuts(before, limit).await?)
    }

    /// Queues a diagnosis of the cut from the newest thousand cuts of the history, against the stated cut.
    /// Errors: there is no cut yet, or too many wait.
    pub async fn start_cut_diagnosis(
        &self,
        budget_s: u32,
        origin: &Origin,
    ) -> Result<DiagnosisView, OperationError> {
        let cuts = self.cuts(None, MAX_PAGE).await?;
        if cuts.is_empty() {
            let what = "the history holds no cut yet: one is told once the tools have left it";
            return Err(OperationError::Unsuitable(what.to_owned()));
        }
        let what = counted(cuts.len(), "past cut");
        let subject = Subject::Cuts {
            scenario: scenario_to_text(&self.0.settings.cut),
            table: cuts_csv(&cuts),
            count: cuts.len(),
        };
        self.queue_diagnosis((what, subject), budget_s, origin).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::cut::input::CutOutcome;
    use crate::recording::read_cuts;

    #[test]
    fn what_is_accepted_is_a_file_of_the_job_and_written_through_no_link() {
        let folder = tempfile::tempdir().unwrap();
        let [own, link, gone] = ["own.toml", "link.toml", "gone.toml"].map(|n| folder.path().join(n));
        std::fs::write(&own, "x").unwrap();
        std::os::unix::fs::symlink(&own, &link).unwrap();
        assert_eq!(own_text(own.clone()), Some((own.clone(), "x".to_owned())));
        assert!([link.clone(), gone, folder.path().to_owned()].into_iter().all(|p| own_text(p).is_none()));
        write_whole(&link, b"y").unwrap();
        assert_eq!(std::fs::read_to_string(&own).unwrap(), "x");
        assert!(std::fs::symlink_metadata(&link).unwrap().is_file());
        let names: Vec<_> =
            std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(names.len(), 2, "nothing is left beside: {names:?}");
        assert_ne!(accepted_name("a"), accepted_name("b"));
    }

    #[test]
    fn what_the_service_writes_is_a_table_of_cuts() {
        let stable = PastCut {
            sequence: 7,
            began_ns: 1_764_000_000_000_000_000,
            lasted_s: 8.25,
            spindle_speed_rpm: 1200.0,
            width_m: 2e-4,
            feed_m_rev: 1.5e-4,
            pitch_difference_rad: -0.1,
            tool_position_m: Some(0.15),
            ..PastCut::default()
        };
        let loud = PastCut { sequence: 8, chattered: true, line_hz: Some(651.5), ..stable.clone() };
        let stable = PastCut { line_hz: Some(583.25), growth_1_s: Some([-21.5, 2.25e-4]), ..stable };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cuts.csv");
        std::fs::write(&path, cuts_csv(&[loud, stable])).unwrap();
        let table = read_cuts(&path).unwrap();
        let rows: Vec<_> = table.rows.iter().map(|r| (r.outcome, r.known.line_hz)).collect();
        assert_eq!(
            rows,
            [(Some(CutOutcome::Chatter), Some(651.5)), (Some(CutOutcome::Stable), Some(583.25))]
        );
        let growth: Vec<_> = table.rows.iter().map(|r| (r.known.growth_1_s, r.known.growth_se_1_s)).collect();
        assert_eq!(growth, [(None, None), (Some(-21.5), Some(2.25e-4))]);
        assert_eq!(table.rows[1].known.pitch_difference_rad, Some(-0.1));
        assert_eq!(table.rows[1].known.tool_position_m, Some(0.15));
        assert_eq!(table.ignored_columns, ["began_at", "lasted_s"]);
    }
}
