//! Diagnosis jobs: each runs `stillcut diagnose` as a process of its own, at low priority, one at a time.
//!
//! A process can be ended, cannot take the pipeline with it, and its memory is its own.

use super::clock;
use crate::recording::write_whole;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio_util::sync::CancellationToken;
use utoipa::ToSchema;

/// Jobs that may wait.
const WAITING: usize = 8;
/// Finished jobs that are remembered.
const REMEMBERED: usize = 100;
/// Budget of a job that names none, s.
pub const BUDGET_S: u32 = 300;
/// Budgets that may be asked for, s.
pub const BUDGETS_S: std::ops::RangeInclusive<u32> = 10..=1800;
/// A job that is not done this long after its budget is ended: the budget counts work, and the machine may be
/// busy with other things.
const GRACE: Duration = Duration::from_secs(60);

/// Where a job stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// Waits for the one before it.
    Queued,
    /// Runs.
    Running,
    /// Ended with a result.
    Done,
    /// Ended without one.
    Failed,
    /// A person ended it.
    Cancelled,
}

/// One diagnosis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DiagnosisView {
    /// Name.
    pub id: String,
    /// Recordings that it looks at; none where it looks at past cuts.
    pub recordings: Vec<String>,
    /// Past cuts that it looks at.
    #[serde(default)]
    pub cuts: Option<usize>,
    /// Where it stands.
    pub state: JobState,
    /// When it was asked for, RFC 3339.
    pub asked_at: String,
    /// Seconds since it began to run.
    pub elapsed_s: f64,
    /// How far it is, 0 to 1.
    pub progress: f64,
    /// What it is doing.
    pub step: Option<String>,
    /// `diagnosis.json`, once done.
    pub result: Option<serde_json::Value>,
    /// Why there is no result.
    pub error: Option<String>,
    /// What it may take, s.
    #[serde(default)]
    pub budget_s: u32,
    /// Axes of the model that the result says nothing of.
    #[serde(default)]
    pub axes_not_looked_at: Vec<String>,
}

/// What a diagnosis looks at.
#[derive(Debug, Clone)]
pub(super) enum Subject {
    /// Files of recordings, against the machine's model.
    Recordings(Vec<PathBuf>),
    /// A table of cuts as CSV, against a scenario as TOML.
    Cuts { scenario: String, table: String, count: usize },
}

#[derive(Debug)]
struct Job {
    view: DiagnosisView,
    subject: Subject,
    began: Option<std::time::Instant>,
    cancel: CancellationToken,
}

#[derive(Debug)]
struct Inner {
    folder: PathBuf,
    program: PathBuf,
    jobs: Mutex<VecDeque<Job>>,
    wake: tokio::sync::Notify,
    /// The service stops: what runs is ended.
    ended: AtomicBool,
    /// Diagnoses go to the fleet's workers.
    #[cfg(feature = "nats")]
    workers: Option<super::fleet::Broker>,
}

/// What a job leaves beside its result, so that the next start of the service knows it.
const NOTE: &str = "job.json";

/// The last jobs, also those of earlier starts.
#[derive(Debug, Clone)]
pub struct Diagnoses(Arc<Inner>);

impl Diagnoses {
    /// Jobs that write below `folder` and run `program`.
    #[must_use]
    pub fn new(folder: &Path, program: PathBuf) -> Self {
        Self(Arc::new(Inner {
            jobs: Mutex::new(earlier(folder)),
            folder: folder.to_owned(),
            program,
            wake: tokio::sync::Notify::new(),
            ended: AtomicBool::new(false),
            #[cfg(feature = "nats")]
            workers: None,
        }))
    }

    /// The same, done by the workers behind this broker.
    #[cfg(feature = "nats")]
    pub(super) fn by_workers(folder: &Path, program: PathBuf, broker: super::fleet::Broker) -> Self {
        Self(Arc::new(Inner {
            jobs: Mutex::new(earlier(folder)),
            folder: folder.to_owned(),
            program,
            wake: tokio::sync::Notify::new(),
            ended: AtomicBool::new(false),
            workers: Some(broker),
        }))
    }

    /// The binary that jobs run in.
    #[must_use]
    pub fn program(&self) -> &Path {
        &self.0.program
    }

    fn with<T>(&self, act: impl FnOnce(&mut VecDeque<Job>) -> T) -> T {
        act(&mut self.0.jobs.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Adds a job. Nothing when too many wait.
    #[must_use]
    pub(super) fn add(&self, subject: Subject, budget_s: u32) -> Option<DiagnosisView> {
        let (recordings, cuts) = match &subject {
            Subject::Recordings(files) => (files.iter().filter_map(|f| stem(f)).collect(), None),
            Subject::Cuts { count, .. } => (Vec::new(), Some(*count)),
        };
        let view = DiagnosisView {
            id: clock::new_id(),
            recordings,
            cuts,
            state: JobState::Queued,
            asked_at: clock::rfc3339(clock::wall_ns()),
            elapsed_s: 0.0,
            progress: 0.0,
            step: None,
            result: None,
            error: None,
            budget_s,
            axes_not_looked_at: Vec::new(),
        };
        let added = self.with(|jobs| {
            if jobs.iter().filter(|j| j.view.state == JobState::Queued).count() >= WAITING {
                return None;
            }
            while jobs.len() >= REMEMBERED
                && !matches!(jobs.front()?.view.state, JobState::Queued | JobState::Running)
            {
                jobs.pop_front();
            }
            let cancel = CancellationToken::new();
            jobs.push_back(Job { view: view.clone(), subject, began: None, cancel });
            Some(view)
        });
        self.0.wake.notify_one();
        added
    }

    /// Ends a job that waits or runs; answers how it stands. Nothing where there is none of that name.
    #[must_use]
    pub fn cancel(&self, id: &str) -> Option<DiagnosisView> {
        self.with(|jobs| {
            let job = jobs.iter_mut().find(|j| j.view.id == id)?;
            job.cancel.cancel();
            if job.view.state == JobState::Queued {
                job.view.state = JobState::Cancelled;
            }
            Some(job.now())
        })
    }

    /// Jobs older than the one named `before`, newest first, with their results, and whether there are more.
    pub async fn page(&self, before: String, limit: usize) -> (Vec<DiagnosisView>, bool) {
        let mut found: Vec<DiagnosisView> = self.with(|jobs| {
            let older = jobs.iter().rev().filter(|j| before.is_empty() || j.view.id < before);
            older.take(limit + 1).map(Job::now).collect()
        });
        let more = found.len() > limit;
        found.truncate(limit);
        let folder = self.0.folder.clone();
        let whole = tokio::task::spawn_blocking(move || {
            found.into_iter().map(|view| with_result(&folder, view)).collect()
        });
        (whole.await.unwrap_or_default(), more)
    }

    /// One job with its result.
    pub async fn whole(&self, id: &str) -> Option<DiagnosisView> {
        let (view, folder) = (self.get(id)?, self.0.folder.clone());
        tokio::task::spawn_blocking(move || with_result(&folder, view)).await.ok()
    }

    /// One job; what an earlier start found stands in its file alone.
    #[must_use]
    pub fn get(&self, id: &str) -> Option<DiagnosisView> {
        self.with(|jobs| jobs.iter().find(|j| j.view.id == id).map(Job::now))
    }

    /// Leaves word of a job for the next start. A disk that refuses is told and changes nothing now.
    pub(super) fn note(&self, view: &DiagnosisView) -> tokio::task::JoinHandle<()> {
        let (folder, view) = (self.0.folder.join(&view.id), view.clone());
        tokio::task::spawn_blocking(move || {
            let written = std::fs::create_dir_all(&folder).map_err(|e| e.to_string()).and_then(|()| {
                let bytes = serde_json::to_vec(&view).map_err(|e| e.to_string())?;
                write_whole(&folder.join(NOTE), &bytes).map_err(|e| e.to_string())
            });
            if let Err(error) = written {
                tracing::warn!(event = "diagnosis_note", "{}: {error}", folder.display());
            }
        })
    }

    /// A file that a job left, once it is done.
    #[must_use]
    pub fn file_of(&self, id: &str, name: &str) -> Option<PathBuf> {
        let done = self.get(id).filter(|v| v.state == JobState::Done);
        done.map(|v| self.0.folder.join(v.id).join(name))
    }

    /// Here, or by a worker of the fleet.
    async fn do_task(&self, task: Task, cancel: CancellationToken) -> Result<serde_json::Value, String> {
        #[cfg(feature = "nats")]
        if let Some(broker) = &self.0.workers
            && task.start.is_model()
        {
            let note = |share, what| self.0.note_progress(&task.id, (share, what));
            // A worker that has begun goes on; nobody waits for it.
            return tokio::select! {
                outcome = super::fleet::diagnose(broker, &task, note) => outcome,
                () = cancel.cancelled() => Err("cancelled".to_owned()),
            };
        }
        let inner = Arc::clone(&self.0);
        let ran = tokio::task::spawn_blocking(move || {
            let go_on = || !inner.ended.load(Ordering::Relaxed) && !cancel.is_cancelled();
            let progress = |share, what| inner.note_progress(&task.id, (share, what));
            run_task(&inner.program, &task, go_on, progress)
        });
        ran.await.unwrap_or_else(|e| Err(e.to_string()))
    }

    /// Ends what runs; the next start says so.
    pub(super) fn end(&self) {
        self.0.ended.store(true, Ordering::Relaxed);
    }

    /// Works through the queue for ever. `model`: where every diagnosis starts from.
    pub(super) async fn run(
        self,
        (model, axes): (Option<PathBuf>, Vec<String>),
        done: impl Fn(DiagnosisView),
    ) {
        loop {
            let next = self.with(|jobs| {
                let job = jobs.iter_mut().find(|j| j.view.state == JobState::Queued)?;
                job.view.state = JobState::Running;
                job.began = Some(clock::now());
                Some((job.view.id.clone(), job.subject.clone(), (job.view.budget_s, job.cancel.clone())))
            });
            let Some((id, subject, (budget_s, cancel))) = next else {
                self.0.wake.notified().await;
                continue;
            };
            let out = self.0.folder.join(&id);
            let outcome = match prepared(subject, model.as_deref(), &out) {
                Ok((start, files)) => {
                    let task = Task { id: id.clone(), start, files, out, budget_s };
                    self.do_task(task, cancel.clone()).await
                }
                Err(error) => Err(error),
            };
            let finished = self.with(|jobs| {
                let job = jobs.iter_mut().find(|j| j.view.id == id)?;
                job.view.elapsed_s = job.now().elapsed_s;
                job.began = None;
                job.view.step = None;
                job.view.progress = 1.0;
                match outcome {
                    Ok(result) => {
                        let of_cuts = job.view.cuts.is_some();
                        let left = if of_cuts { Vec::new() } else { not_looked_at(&axes, &result) };
                        job.view.axes_not_looked_at = left;
                        (job.view.state, job.view.result) = (JobState::Done, Some(result));
                    }
                    Err(_) if cancel.is_cancelled() => job.view.state = JobState::Cancelled,
                    Err(error) => (job.view.state, job.view.error) = (JobState::Failed, Some(error)),
                }
                Some(job.view.clone())
            });
            if let Some(view) = finished {
                self.note(&view);
                done(view);
            }
        }
    }
}

/// The name of a recording by its file.
fn stem(file: &Path) -> Option<String> {
    file.file_stem().map(|name| name.to_string_lossy().into_owned())
}

/// Where a diagnosis starts from and its files; a table and its scenario are written beside the result.
/// Errors: one line.
fn prepared(subject: Subject, model: Option<&Path>, out: &Path) -> Result<(Start, Vec<PathBuf>), String> {
    match subject {
        Subject::Recordings(files) => {
            let none = || "machine.model is not configured: there is no model to start from".to_owned();
            Ok((Start::Model(model.ok_or_else(none)?.to_owned()), files))
        }
        Subject::Cuts { scenario, table, .. } => {
            let fail = |e: std::io::Error| format!("{}: {e}", out.display());
            std::fs::create_dir_all(out).map_err(fail)?;
            let (stated, cuts) = (out.join("stated.toml"), out.join("past-cuts.csv"));
            std::fs::write(&stated, scenario).and_then(|()| std::fs::write(&cuts, table)).map_err(fail)?;
            Ok((Start::Scenario(stated), vec![cuts]))
        }
    }
}

/// Axes of the model that a result does not name.
fn not_looked_at(axes: &[String], result: &serde_json::Value) -> Vec<String> {
    let named = |axis: &String| {
        let one =
            |v: &serde_json::Value| v.as_str() == Some(axis) || v.get("axis").is_some_and(|a| a == axis);
        one(&result["axis"]) || result["axes"].as_array().is_some_and(|all| all.iter().any(one))
    };
    axes.iter().filter(|axis| !named(axis)).cloned().collect()
}

/// Jobs that earlier starts left, oldest first; one that was not done then is not done.
fn earlier(folder: &Path) -> VecDeque<Job> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<PathBuf> = entries.map(|e| e.path().join(NOTE)).collect();
    names.sort_unstable();
    let newest = names.len().saturating_sub(REMEMBERED);
    names.iter().skip(newest).filter_map(|path| read_note(path)).map(ended).collect()
}

/// A note; its name is that of its folder, for files of a job are looked for by it.
fn read_note(path: &Path) -> Option<DiagnosisView> {
    let view: DiagnosisView = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
    let folder = path.parent()?.file_name()?;
    (folder == view.id.as_str()).then_some(view)
}

fn ended(mut view: DiagnosisView) -> Job {
    if matches!(view.state, JobState::Queued | JobState::Running) {
        let what = "the service ended before this was done; ask for it again";
        (view.state, view.error) = (JobState::Failed, Some(what.to_owned()));
    }
    view.result = None; // read again when somebody asks
    Job { view, subject: Subject::Recordings(Vec::new()), began: None, cancel: CancellationToken::new() }
}

fn with_result(folder: &Path, view: DiagnosisView) -> DiagnosisView {
    let there = view.result.is_some() || view.state != JobState::Done;
    let result =
        if there { view.result } else { read_note(&folder.join(&view.id).join(NOTE)).and_then(|v| v.result) };
    DiagnosisView { result, ..view }
}

impl Job {
    fn now(&self) -> DiagnosisView {
        let elapsed_s = self.began.map_or(self.view.elapsed_s, |b| b.elapsed().as_secs_f64());
        DiagnosisView { elapsed_s, ..self.view.clone() }
    }
}

/// Share and words of the last line `progress SHARE WHAT`.
pub(super) fn last_progress(said: &str) -> Option<(f64, String)> {
    let line = said.lines().rev().find_map(|line| line.strip_prefix("progress "))?;
    let (share, what) = line.split_once(' ').unwrap_or((line, ""));
    Some((share.parse::<f64>().ok()?.clamp(0.0, 1.0), what.to_owned()))
}

impl Inner {
    fn note_progress(&self, id: &str, (share, what): (f64, String)) {
        let mut jobs = self.jobs.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(job) = jobs.iter_mut().find(|j| j.view.id == id) {
            job.view.progress = share.max(job.view.progress);
            job.view.step = Some(what);
        }
    }
}

/// What a diagnosis starts from.
#[derive(Debug, Clone)]
pub(super) enum Start {
    /// A model of the machine; files are recordings.
    Model(PathBuf),
    /// A scenario of the cut; files are tables of cuts.
    Scenario(PathBuf),
}

impl Start {
    /// Options of `stillcut diagnose` for it and for a file.
    fn options(&self) -> (&'static str, &Path, &'static str) {
        match self {
            Self::Model(path) => ("--model", path, "--recording"),
            Self::Scenario(path) => ("--scenario", path, "--cuts"),
        }
    }

    /// Whether a worker of the fleet may do it: a table of cuts is small and stays here.
    #[cfg(feature = "nats")]
    fn is_model(&self) -> bool {
        matches!(self, Self::Model(_))
    }
}

/// One diagnosis to do.
#[derive(Debug, Clone)]
pub(super) struct Task {
    pub(super) id: String,
    pub(super) start: Start,
    pub(super) files: Vec<PathBuf>,
    pub(super) out: PathBuf,
    pub(super) budget_s: u32,
}

/// Whether a program's `diagnose` takes a budget: a worker may be of an earlier version.
fn takes_budget(program: &Path) -> bool {
    let asked = Command::new(program).args(["diagnose", "--help"]).stdin(Stdio::null()).output();
    asked.is_ok_and(|said| String::from_utf8_lossy(&said.stdout).contains("--budget-s"))
}

/// Runs `program diagnose` as a process of its own, at low priority; blocks, and ends it when it is not to
/// go on. Errors: its last line.
pub(super) fn run_task(
    program: &Path,
    task: &Task,
    go_on: impl Fn() -> bool,
    mut progress: impl FnMut(f64, String),
) -> Result<serde_json::Value, String> {
    let out = &task.out;
    std::fs::create_dir_all(out).map_err(|e| format!("{}: {e}", out.display()))?;
    let mut command = Command::new("nice");
    command.arg("-n").arg("19").arg(program).arg("diagnose").arg("--progress");
    let (start, path, of_file) = task.start.options();
    command.arg(start).arg(path);
    for file in &task.files {
        command.arg(of_file).arg(file);
    }
    if takes_budget(program) {
        command.arg("--budget-s").arg(task.budget_s.to_string());
    }
    let longest = Duration::from_secs(task.budget_s.into()) + GRACE;
    command.arg("--out").arg(out).stdin(Stdio::null()).stdout(Stdio::null());
    let errors = out.join("stderr.txt");
    let log = std::fs::File::create(&errors).map_err(|e| format!("{}: {e}", errors.display()))?;
    let mut child = command.stderr(log).spawn().map_err(|e| format!("cannot start the diagnosis: {e}"))?;
    super::priority::first_to_go(&child);
    let began = clock::now();
    let mut told = None;
    let status = loop {
        match child.try_wait().map_err(|e| e.to_string())? {
            Some(status) => break status,
            None if began.elapsed() > longest || !go_on() => {
                let _ = child.kill();
                let _ = child.wait();
                let why =
                    if go_on() { "its budget is over" } else { "it was cancelled, or the service stops" };
                return Err(format!("ended before there was a result: {why}"));
            }
            None => clock::sleep(Duration::from_millis(200)),
        }
        let now = last_progress(&std::fs::read_to_string(&errors).unwrap_or_default());
        if now != told {
            now.iter().for_each(|(share, what)| progress(*share, what.clone()));
            told = now;
        }
    };
    if !status.success() {
        let said = std::fs::read_to_string(&errors).unwrap_or_default();
        let reason = said.lines().rfind(|line| !line.starts_with("progress "));
        return Err(reason.unwrap_or("the diagnosis failed").to_owned());
    }
    let path = out.join("diagnosis.json");
    let text = std::fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
    serde_json::from_str(&text).map_err(|e| format!("{}: {e}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_diagnosis_survives_a_restart_with_its_result() {
        let folder = tempfile::tempdir().unwrap();
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let ids: Vec<String> = runtime.block_on(async {
            let before = Diagnoses::new(folder.path(), "none".into());
            let mut done = before.add(Subject::Recordings(vec!["r".into()]), BUDGET_S).unwrap();
            (done.state, done.result) =
                (JobState::Done, Some(serde_json::json!({"verdict": "model_adequate"})));
            before.note(&done).await.unwrap();
            clock::sleep(Duration::from_millis(5)); // names order by the millisecond
            let waiting = before.add(Subject::Recordings(vec!["s".into()]), BUDGET_S).unwrap();
            before.note(&waiting).await.unwrap();
            vec![done.id, waiting.id]
        });
        drop(runtime);
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let after = Diagnoses::new(folder.path(), "none".into());
        let (page, more) = runtime.block_on(after.page(String::new(), 1));
        assert_eq!((page.len(), more, &page[0].id), (1, true, &ids[1]));
        assert!(
            page[0].state == JobState::Failed && page[0].error.as_ref().unwrap().contains("ask for it again")
        );
        let (page, more) = runtime.block_on(after.page(ids[1].clone(), 1));
        assert_eq!((more, &page[0].id), (false, &ids[0]));
        assert_eq!(page[0].result.as_ref().unwrap()["verdict"], "model_adequate");
        assert!(after.file_of(&ids[0], "report.html").is_some(), "its report is one click away as before");
        assert_eq!(runtime.block_on(after.whole(&ids[0])).unwrap().result, page[0].result);
    }

    #[test]
    fn a_note_that_names_another_folder_is_no_job() {
        let folder = tempfile::tempdir().unwrap();
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let view = runtime.block_on(async {
            let jobs = Diagnoses::new(folder.path(), "none".into());
            let view = jobs.add(Subject::Recordings(vec!["r".into()]), BUDGET_S).unwrap();
            jobs.note(&view).await.unwrap();
            view
        });
        let elsewhere = DiagnosisView { id: "../elsewhere".to_owned(), ..view.clone() };
        let note = serde_json::to_vec(&elsewhere).unwrap();
        std::fs::create_dir(folder.path().join("planted")).unwrap();
        write_whole(&folder.path().join("planted").join(NOTE), &note).unwrap();
        let after = Diagnoses::new(folder.path(), "none".into());
        assert!(after.get("../elsewhere").is_none() && after.get(&view.id).is_some());
    }

    #[test]
    fn the_last_word_on_progress_counts() {
        let said = "warning\nprogress 0.1 reading\nprogress 0.425 fitting friction\nhalf a li";
        assert_eq!(last_progress(said), Some((0.425, "fitting friction".to_owned())));
        assert_eq!(last_progress("progress much"), None);
        assert_eq!(last_progress("progress 7"), Some((1.0, String::new())));
    }
}
