//! Diagnoses as people ask for them: queued, cancelled, and told when they end.

use super::control::Origin;
use super::diagnoses::{Diagnoses, DiagnosisView, JobState, Subject};
use super::handle::{Handle, OperationError};
use crate::config::service::ServiceConfig;
use crate::telemetry::EventKind;

pub(super) fn diagnoses_of(config: &ServiceConfig) -> Diagnoses {
    let own = || std::env::current_exe().unwrap_or_else(|_| "stillcut".into());
    let program = config.program.clone().unwrap_or_else(own);
    let folder = config.history.folder.join("diagnoses");
    #[cfg(feature = "nats")]
    if let Some(fleet) = config.fleet.as_ref().filter(|f| f.diagnose) {
        return Diagnoses::by_workers(&folder, program, super::fleet::Broker::of(fleet));
    }
    Diagnoses::new(&folder, program)
}

pub(super) async fn run_diagnoses(handle: Handle) {
    let (jobs, model, told) = (handle.diagnoses().clone(), handle.model().cloned(), handle.clone());
    let axes = stream_axes(&handle.0.settings);
    let done = move |view: DiagnosisView| {
        let outcome = match view.state {
            JobState::Done => "done",
            JobState::Cancelled => "cancelled",
            _ => "failed",
        };
        told.metrics().diagnoses.with_label_values(&[outcome]).inc();
        let said = |key: &str| view.result.as_ref().and_then(|r| r.get(key)).and_then(|v| v.as_str());
        let text = match view.state {
            JobState::Done if said("no_evidence").is_some() => {
                let why = said("no_evidence").unwrap_or_default();
                format!("diagnosis {}: nothing can be told of the drive here: {why}", view.id)
            }
            JobState::Done => {
                let left = &view.axes_not_looked_at;
                let left = if left.is_empty() {
                    String::new()
                } else {
                    format!("; not looked at: {}", left.join(", "))
                };
                format!("diagnosis {}: {}{left}", view.id, said("verdict").unwrap_or("no verdict"))
            }
            JobState::Cancelled => format!("diagnosis {} was cancelled", view.id),
            _ => format!("diagnosis {} failed: {}", view.id, view.error.unwrap_or_default()),
        };
        let handle = told.clone();
        tokio::spawn(async move { handle.report(EventKind::DiagnosisDone, text).await });
    };
    let stop = handle.stopping();
    tokio::select! {
        () = jobs.clone().run((model, axes), done) => {}
        () = stop.cancelled() => jobs.end(),
    }
}

impl Handle {
    /// Ends a diagnosis that waits or runs.
    /// Errors: there is none of that name, it has ended already, or nothing can be put on record.
    pub async fn cancel_diagnosis(&self, id: &str, origin: &Origin) -> Result<DiagnosisView, OperationError> {
        let none = || OperationError::NotFound("there is no such diagnosis".to_owned());
        let before = self.diagnoses().get(id).ok_or_else(none)?;
        if !matches!(before.state, JobState::Queued | JobState::Running) {
            let what = "the diagnosis has ended: there is nothing to cancel";
            return Err(OperationError::Unsuitable(what.to_owned()));
        }
        let view = self.diagnoses().cancel(id).ok_or_else(none)?;
        self.diagnoses().note(&view);
        self.record_outcome(origin, "cancel_diagnosis", &format!("diagnosis {id}")).await;
        Ok(view)
    }

    /// Queues a diagnosis of stored recordings.
    /// Errors: no model, no such recording, too many that wait, or nothing can be put on record.
    pub async fn start_diagnosis(
        &self,
        names: Vec<String>,
        budget_s: u32,
        origin: &Origin,
    ) -> Result<DiagnosisView, OperationError> {
        let mut files = Vec::with_capacity(names.len());
        for name in &names {
            files.push(self.recording_file(name).await?);
        }
        if self.model().is_none() {
            let what = "machine.model is not configured: there is no model to start from";
            return Err(OperationError::Unsuitable(what.to_owned()));
        }
        self.queue_diagnosis((names.join(", "), Subject::Recordings(files)), budget_s, origin).await
    }

    /// Puts a diagnosis into the queue and on record. Errors: it cannot be put on record, or too many wait.
    pub(super) async fn queue_diagnosis(
        &self,
        (what, subject): (String, Subject),
        budget_s: u32,
        origin: &Origin,
    ) -> Result<DiagnosisView, OperationError> {
        self.audit(origin, "start_diagnosis_asked", &what).await?;
        let Some(added) = self.diagnoses().add(subject, budget_s) else {
            let busy = OperationError::Busy("eight diagnoses wait already".to_owned());
            self.record_outcome(origin, "start_diagnosis", &format!("{what}: refused, {busy}")).await;
            return Err(busy);
        };
        self.diagnoses().note(&added);
        self.record_outcome(origin, "start_diagnosis", &format!("{what}: queued as {}", added.id)).await;
        Ok(added)
    }
}

/// Axes that get their series before the first sample.
pub(super) fn stream_axes(config: &ServiceConfig) -> Vec<String> {
    config.machine.axes.iter().map(|a| a.name.clone()).collect()
}
