//! The fleet: events of many machines to NATS JetStream, diagnoses to any number of workers.
//!
//! ```text
//! history --in order, Nats-Msg-Id = event id--> stream STILLCUT_EVENTS   stillcut.events.<machine>.<kind>
//! POST /diagnoses --> bucket stillcut-files, queue STILLCUT_JOBS --> `stillcut worker` --> result, report
//! ```
//! The history is the outbox: it keeps how far the broker has confirmed, and everything above is sent again
//! after a break. What was sent twice carries the same id and is stored once. Nothing here is on the way of
//! the pipeline, and nothing waits for the broker.

mod jobs;
mod outbox;

pub(super) use jobs::diagnose;
pub use jobs::work;
pub(super) use outbox::run;

use crate::config::service::FleetConfig;
use async_nats::jetstream::stream::{Config as StreamConfig, RetentionPolicy};
use async_nats::jetstream::{Context, object_store};
use std::path::PathBuf;
use std::time::Duration;
use thiserror::Error;

/// How the broker is reached.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Broker {
    /// `nats://host:port`.
    pub server: String,
    /// File with one line `user:password`.
    pub credentials: Option<PathBuf>,
}

/// Why something could not be done with the broker. One line.
#[derive(Debug, Error)]
pub enum BrokerError {
    /// It cannot be reached, or refuses us.
    #[error("{server}: {reason}")]
    Connect {
        /// Address.
        server: String,
        /// What the client said.
        reason: String,
    },
    /// It did not do what was asked.
    #[error("{what}: {reason}")]
    Refused {
        /// What was asked.
        what: &'static str,
        /// What the client said.
        reason: String,
    },
}

const EVENTS: &str = "STILLCUT_EVENTS";
const JOBS: &str = "STILLCUT_JOBS";
const JOB_SUBJECT: &str = "stillcut.jobs.diagnose";
const FILES: &str = "stillcut-files";
/// The broker remembers ids for this long: what is sent again after a break is still known.
const SAME_ID_WINDOW: Duration = Duration::from_secs(24 * 3600);
/// Files of jobs that nobody fetched are forgotten.
const FILES_AGE: Duration = Duration::from_secs(7 * 24 * 3600);
/// An answer that takes longer is none.
const DEADLINE: Duration = Duration::from_secs(5);

fn refused(what: &'static str) -> impl Fn(async_nats::Error) -> BrokerError {
    move |error| BrokerError::Refused { what, reason: one_line(&error.to_string()) }
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

impl Broker {
    /// The one that the configuration names.
    pub(super) fn of(fleet: &FleetConfig) -> Self {
        Self { server: fleet.server.clone(), credentials: fleet.credentials.clone() }
    }

    /// User and password, where a file is named.
    fn pair(&self) -> Result<Option<(String, String)>, BrokerError> {
        let fail = |reason: String| BrokerError::Connect { server: self.server.clone(), reason };
        let Some(path) = &self.credentials else { return Ok(None) };
        let text = std::fs::read_to_string(path).map_err(|e| fail(format!("{}: {e}", path.display())))?;
        let pair = text.trim().split_once(':').map(|(u, p)| (u.to_owned(), p.to_owned()));
        let what = || fail(format!("{}: expected one line `user:password`", path.display()));
        pair.ok_or_else(what).map(Some)
    }

    /// What no waiting mends. Errors: the credentials cannot be read.
    fn check(&self) -> Result<(), BrokerError> {
        self.pair().map(|_| ())
    }

    async fn connect(&self) -> Result<async_nats::Client, BrokerError> {
        let fail = |reason: String| BrokerError::Connect { server: self.server.clone(), reason };
        let mut options = async_nats::ConnectOptions::new()
            .name("stillcut")
            .connection_timeout(DEADLINE)
            .request_timeout(Some(DEADLINE));
        if let Some((user, password)) = self.pair()? {
            options = options.user_and_password(user, password);
        }
        options.connect(&self.server).await.map_err(|e| fail(one_line(&e.to_string())))
    }
}

async fn events_stream(context: &Context) -> Result<(), BrokerError> {
    let config = StreamConfig {
        name: EVENTS.into(),
        subjects: vec!["stillcut.events.>".into()],
        duplicate_window: SAME_ID_WINDOW,
        ..StreamConfig::default()
    };
    let made = context.get_or_create_stream(config).await;
    made.map(|_| ()).map_err(|e| refused("stream of events")(e.into()))
}

async fn jobs_stream(context: &Context) -> Result<async_nats::jetstream::stream::Stream, BrokerError> {
    let config = StreamConfig {
        name: JOBS.into(),
        subjects: vec![JOB_SUBJECT.into()],
        retention: RetentionPolicy::WorkQueue,
        duplicate_window: SAME_ID_WINDOW,
        ..StreamConfig::default()
    };
    context.get_or_create_stream(config).await.map_err(|e| refused("queue of jobs")(e.into()))
}

async fn files(context: &Context) -> Result<object_store::ObjectStore, BrokerError> {
    if let Ok(bucket) = context.get_object_store(FILES).await {
        return Ok(bucket);
    }
    let config =
        object_store::Config { bucket: FILES.into(), max_age: FILES_AGE, ..object_store::Config::default() };
    context.create_object_store(config).await.map_err(|e| refused("bucket of files")(e.into()))
}
