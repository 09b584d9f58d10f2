//! Diagnoses by workers: files through the broker's object store, jobs through a work queue.

use super::{Broker, BrokerError, FILES, JOB_SUBJECT, files, jobs_stream, refused};
use crate::service::diagnoses::{BUDGET_S, Start, Task, run_task};
use async_nats::jetstream::consumer::{AckPolicy, pull};
use async_nats::jetstream::message::PublishMessage;
use async_nats::jetstream::object_store::ObjectStore;
use async_nats::jetstream::{AckKind, Context};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::io::AsyncReadExt as _;
use tokio_stream::StreamExt as _;

/// A worker that is silent for this long has died; the job goes to another.
const ACK_WAIT: Duration = Duration::from_secs(30);
/// A worker says this often that it is alive.
const ALIVE: Duration = Duration::from_secs(5);
/// A job that failed so often with its worker is given up.
const DELIVERIES: i64 = 3;
/// Nobody took it or nobody came to an end.
const LONGEST: Duration = Duration::from_secs(3 * 3600);
/// How often the asker looks for the result.
const LOOK: Duration = Duration::from_secs(1);
/// Most files of one job.
const MOST_RECORDINGS: usize = 16;

/// A job as it travels.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Job {
    id: String,
    recordings: Vec<String>,
    /// Left out where it is the usual one: workers of earlier versions know none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    budget_s: Option<u32>,
}

/// What came of it.
#[derive(Debug, Serialize, Deserialize)]
struct Outcome {
    result: Option<serde_json::Value>,
    error: Option<String>,
}

fn progress_subject(id: &str) -> String {
    format!("stillcut.progress.{id}")
}

fn is_plain(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_' || c == '.';
    !name.is_empty() && name.len() <= 100 && name.chars().all(plain) && !name.starts_with('.')
}

async fn put(bucket: &ObjectStore, name: &str, path: &Path) -> Result<(), String> {
    let mut file = tokio::fs::File::open(path).await.map_err(|e| format!("{}: {e}", path.display()))?;
    bucket.put(name, &mut file).await.map(|_| ()).map_err(|e| format!("{FILES}/{name}: {e}"))
}

async fn read(bucket: &ObjectStore, name: &str) -> Result<Vec<u8>, String> {
    let fail = |e: String| format!("{FILES}/{name}: {e}");
    let mut object = bucket.get(name).await.map_err(|e| fail(e.to_string()))?;
    let mut bytes = Vec::new();
    object.read_to_end(&mut bytes).await.map_err(|e| fail(e.to_string()))?;
    Ok(bytes)
}

/// The asker's side: sends files and job, follows the progress, fetches result and report into `task.out`.
/// Errors: one line.
pub(in crate::service) async fn diagnose(
    broker: &Broker,
    task: &Task,
    progress: impl Fn(f64, String),
) -> Result<serde_json::Value, String> {
    let client = broker.connect().await.map_err(|e| e.to_string())?;
    let context = async_nats::jetstream::new(client.clone());
    let bucket = files(&context).await.map_err(|e| e.to_string())?;
    jobs_stream(&context).await.map_err(|e| e.to_string())?;
    let id = task.id.as_str();
    let mut said = client.subscribe(progress_subject(id)).await.map_err(|e| e.to_string())?;
    let Start::Model(model) = &task.start else {
        return Err("a worker takes recordings alone; expected a machine's model".to_owned());
    };
    put(&bucket, &format!("{id}/model.toml"), model).await?;
    let mut recordings = Vec::new();
    for path in &task.files {
        let name = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        put(&bucket, &format!("{id}/{name}"), path).await?;
        recordings.push(name);
    }
    let body = serde_json::to_vec(&Job {
        id: id.to_owned(),
        recordings: recordings.clone(),
        budget_s: Some(task.budget_s).filter(|s| *s != BUDGET_S),
    });
    let message = PublishMessage::build().payload(body.map_err(|e| e.to_string())?.into()).message_id(id);
    let sent = context.send_publish(JOB_SUBJECT, message).await.map_err(|e| e.to_string())?;
    sent.await.map_err(|e| e.to_string())?;
    progress(0.0, "waits for a worker".to_owned());
    let deadline = tokio::time::Instant::now() + LONGEST;
    let outcome = loop {
        match tokio::time::timeout(LOOK, said.next()).await {
            Ok(Some(message)) => {
                let text = String::from_utf8_lossy(&message.payload).into_owned();
                if let Some((share, what)) = crate::service::diagnoses::last_progress(&text) {
                    progress(share, what);
                }
            }
            Ok(None) => return Err("the connection to the broker ended".to_owned()),
            Err(_) => {}
        }
        if let Ok(bytes) = read(&bucket, &format!("{id}/outcome.json")).await {
            break serde_json::from_slice::<Outcome>(&bytes).map_err(|e| e.to_string())?;
        }
        if tokio::time::Instant::now() > deadline {
            return Err("no worker came to a result in three hours".to_owned());
        }
    };
    if outcome.result.is_some() {
        let report = read(&bucket, &format!("{id}/report.html")).await?;
        std::fs::create_dir_all(&task.out).map_err(|e| format!("{}: {e}", task.out.display()))?;
        let path = task.out.join("report.html");
        std::fs::write(&path, report).map_err(|e| format!("{}: {e}", path.display()))?;
    }
    for name in recordings.iter().map(String::as_str).chain(["model.toml", "outcome.json", "report.html"]) {
        let _ = bucket.delete(format!("{id}/{name}")).await; // what stays ages away
    }
    outcome.result.ok_or_else(|| outcome.error.unwrap_or_else(|| "the worker gave no reason".to_owned()))
}

/// A worker: takes jobs until `jobs` are done, or for ever. Any number of them may run. A broker that is away
/// is waited for; a job that fails is an answer, not an error.
/// Errors: the credentials cannot be read.
pub async fn work(broker: &Broker, program: PathBuf, jobs: Option<u64>) -> Result<(), BrokerError> {
    broker.check()?;
    let (mut done, mut away) = (0, false);
    while jobs.is_none_or(|most| done < most) {
        if let Err(error) = work_while_connected(broker, &program, (&mut done, jobs), &mut away).await {
            if !std::mem::replace(&mut away, true) {
                tracing::warn!(event = "broker_away", "{error}; trying again every second");
            }
            tokio::time::sleep(LOOK).await;
        }
    }
    Ok(())
}

async fn work_while_connected(
    broker: &Broker,
    program: &Path,
    (done, jobs): (&mut u64, Option<u64>),
    away: &mut bool,
) -> Result<(), BrokerError> {
    let client = broker.connect().await?;
    let context = async_nats::jetstream::new(client.clone());
    let bucket = files(&context).await?;
    let stream = jobs_stream(&context).await?;
    let config = pull::Config {
        durable_name: Some("diagnose".into()),
        ack_policy: AckPolicy::Explicit,
        ack_wait: ACK_WAIT,
        max_deliver: DELIVERIES,
        ..pull::Config::default()
    };
    let consumer = stream.get_or_create_consumer("diagnose", config).await;
    let consumer = consumer.map_err(|e| refused("consumer of jobs")(e.into()))?;
    *away = false;
    tracing::info!(event = "worker_ready", "waiting for jobs");
    while jobs.is_none_or(|most| *done < most) {
        let waiting = consumer.fetch().max_messages(1).expires(Duration::from_secs(10)).messages().await;
        let mut waiting = waiting.map_err(|e| refused("next job")(e.into()))?;
        let Some(message) = waiting.next().await else { continue };
        let message = message.map_err(|e| refused("next job")(e))?;
        let worker = Worker { client: &client, context: &context, bucket: &bucket, program };
        match worker.take(&message).await {
            Ok(()) => {
                message.double_ack().await.map_err(|e| refused("acknowledging a job")(e))?;
                *done += 1;
            }
            Err(error) => {
                tracing::warn!(event = "job_returned", "{error}");
                let again = AckKind::Nak(Some(Duration::from_secs(5)));
                message.ack_with(again).await.map_err(|e| refused("returning a job")(e))?;
            }
        }
    }
    Ok(())
}

struct Worker<'a> {
    client: &'a async_nats::Client,
    context: &'a Context,
    bucket: &'a ObjectStore,
    program: &'a Path,
}

impl Worker<'_> {
    /// Does one job and stores its outcome. Errors: it should be tried again.
    async fn take(&self, message: &async_nats::jetstream::Message) -> Result<(), String> {
        let job: Job = match serde_json::from_slice(&message.payload) {
            Ok(job) => job,
            Err(error) => {
                tracing::warn!(event = "job_refused", "{error}");
                return Ok(()); // nobody can ever do it
            }
        };
        let good = is_plain(&job.id)
            && (1..=MOST_RECORDINGS).contains(&job.recordings.len())
            && job.recordings.iter().all(|name| is_plain(name));
        if !good {
            tracing::warn!(event = "job_refused", "names that are none of ours");
            return Ok(());
        }
        let outcome_name = format!("{}/outcome.json", job.id);
        if self.bucket.info(&outcome_name).await.is_ok() {
            return Ok(()); // done before, only the acknowledgement was lost
        }
        let folder = std::env::temp_dir().join(format!("stillcut-job-{}-{}", std::process::id(), job.id));
        let outcome = self.run(&job, &folder, message).await;
        let _ = std::fs::remove_dir_all(&folder); // the system's cleaner takes what stays
        let outcome = outcome?;
        let bytes = serde_json::to_vec(&outcome).map_err(|e| e.to_string())?;
        let put = self.bucket.put(outcome_name.as_str(), &mut bytes.as_slice()).await;
        put.map(|_| ()).map_err(|e| e.to_string())
    }

    async fn run(
        &self,
        job: &Job,
        folder: &Path,
        message: &async_nats::jetstream::Message,
    ) -> Result<Outcome, String> {
        let fail = |path: &Path, e: std::io::Error| format!("{}: {e}", path.display());
        std::fs::create_dir_all(folder).map_err(|e| fail(folder, e))?;
        let fetch = async |name: &str| -> Result<PathBuf, String> {
            let path = folder.join(name);
            let bytes = read(self.bucket, &format!("{}/{name}", job.id)).await?;
            tokio::fs::write(&path, bytes).await.map_err(|e| fail(&path, e))?;
            Ok(path)
        };
        let model = fetch("model.toml").await?;
        let mut recordings = Vec::new();
        for name in &job.recordings {
            recordings.push(fetch(name).await?);
        }
        let out = folder.join("out");
        let budget_s = job.budget_s.unwrap_or(BUDGET_S);
        let task = Task { id: job.id.clone(), start: Start::Model(model), files: recordings, out, budget_s };
        let (program, out) = (self.program.to_owned(), task.out.clone());
        let (tell, mut told) = tokio::sync::mpsc::unbounded_channel();
        let running = tokio::task::spawn_blocking(move || {
            run_task(
                &program,
                &task,
                || true,
                |share, what| {
                    let _ = tell.send(format!("progress {share:.3} {what}"));
                },
            )
        });
        tokio::pin!(running);
        let mut alive = tokio::time::interval(ALIVE);
        let ended = loop {
            tokio::select! {
                ended = &mut running => break ended.unwrap_or_else(|e| Err(e.to_string())),
                Some(line) = told.recv() => {
                    let _ = self.client.publish(progress_subject(&job.id), line.into_bytes().into()).await;
                }
                _ = alive.tick() => {
                    let _ = message.ack_with(AckKind::Progress).await; // silence returns the job
                }
            }
        };
        let _ = self.context; // the context keeps the bucket's requests alive
        match ended {
            Ok(result) => {
                put(self.bucket, &format!("{}/report.html", job.id), &out.join("report.html")).await?;
                Ok(Outcome { result: Some(result), error: None })
            }
            Err(error) => Ok(Outcome { result: None, error: Some(error) }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::is_plain;

    #[test]
    fn names_from_the_queue_cannot_leave_the_folder() {
        for bad in ["", "..", ".hidden", "a/b", "a\\b", "a\0", &"x".repeat(101)] {
            assert!(!is_plain(bad), "{bad:?}");
        }
        assert!(is_plain("chatter_onset-01JD3Z1V8Q5N4B6XG2W0S7KFTM.parquet"));
    }
}
