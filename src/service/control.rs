//! What people and the store tell the pipeline thread.

use super::live::Mode;
use tokio::sync::oneshot;

/// Who asked, and why: goes into the event and the audit record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origin {
    /// Name of the person's token, or the part of the service.
    pub actor: String,
    /// Role of the actor.
    pub role: String,
    /// Reason given.
    pub reason: String,
}

/// Why the pipeline thread did not do what was asked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// The mode changed since the asker looked.
    #[error("the mode changed meanwhile: revision is {now}, the request was made for {asked}")]
    Revision {
        /// Present revision.
        now: u64,
        /// Revision that the request named.
        asked: u64,
    },
    /// The way up was asked for as if it were the way down: the mode changed since the asker looked.
    #[error("the mode is {now} by now: {asked} is the way up, which needs an engineer and If-Match")]
    WayUp {
        /// Present mode.
        now: &'static str,
        /// Mode asked for.
        asked: &'static str,
    },
    /// A fault is latched.
    #[error("a fault is latched ({0}); clear it first")]
    Faulted(String),
    /// `act` needs fresh samples and closed interlocks.
    #[error("acting is not possible: {0}")]
    NotReady(String),
    /// What was asked for exists only while acting.
    #[error("{0}")]
    NotActing(String),
    /// No fault is latched.
    #[error("no fault is latched: there is nothing to clear")]
    NoFault,
    /// The pipeline thread has ended or is too far behind.
    #[error("the pipeline does not answer")]
    NoAnswer,
}

/// The mode as the pipeline thread left it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModeNow {
    /// How far the service may go.
    pub mode: Mode,
    /// Grows with every change.
    pub revision: u64,
    /// Why it is so.
    pub reason: String,
}

/// One request to the pipeline thread.
#[derive(Debug)]
pub(crate) enum Control {
    SetMode {
        mode: Mode,
        /// The revision that somebody saw who may raise the mode; without it the way leads down only.
        revision: Option<u64>,
        origin: Origin,
        done: oneshot::Sender<Result<ModeNow, Refusal>>,
    },
    Override {
        actor: String,
        done: oneshot::Sender<Result<ModeNow, Refusal>>,
    },
    Hold {
        on: bool,
        origin: Origin,
        done: oneshot::Sender<Result<ModeNow, Refusal>>,
    },
    ClearFault {
        origin: Origin,
        done: oneshot::Sender<Result<ModeNow, Refusal>>,
    },
    SaveRecording {
        /// First part of its name.
        word: &'static str,
        reason: String,
        done: oneshot::Sender<Result<String, Refusal>>,
    },
    /// The intent of that command is durable.
    Committed {
        sequence: u64,
    },
    Stop,
}
