//! The running service: wiring, threads, shutdown.
//!
//! ```text
//! pipeline thread (shared memory, steps, decisions)      one tokio worker
//!    reports  ---- bounded queue ---->  hub ----> picture, live stream, metrics
//!    controls <--- bounded queue ----    |  \---> history (SQLite writer task)
//!    recorder <--- bounded queue         HTTP (reads pictures and history, asks through Handle)
//! ```
//! The pipeline thread owns every port and waits for nobody; the tokio side never sees a port.

mod announcer;
mod black_box;
mod check;
pub mod clock;
mod commissioning;
mod config_hash;
mod control;
mod cut_book;
mod cut_jobs;
pub mod demo;
mod diagnoses;
mod diagnosis_jobs;
mod drift;
mod engine;
mod exports;
mod first_entries;
#[cfg(feature = "nats")]
pub mod fleet;
mod handle;
mod hub;
mod ledger;
pub mod live;
#[doc(hidden)]
pub mod mtconnect;
mod past;
mod past_file;
mod priority;
mod recorder;
mod recordings;
pub mod stability;
mod start;
mod store_watch;
mod upkeep;
pub mod virtual_lathe;
mod way_back;

pub use crate::store::{AuditRow, EventFilter, EventPage, MAX_PAGE, PastCut};
pub use check::{check, check_shared_memory, user_of};
pub use commissioning::{CommissioningItem, CommissioningView};
pub use control::{ModeNow, Origin, Refusal};
pub use cut_jobs::{AcceptedScenario, cuts_csv};
pub use diagnoses::{BUDGET_S, BUDGETS_S, Diagnoses, DiagnosisView, JobState};
pub use exports::{ReplayView, TextForm, TrackView};
pub use handle::{Changed, Check, Handle, OperationError, ShownConfig};
pub use live::StreamMessage;
pub use past::{LONGEST_S, PastView};
pub use recordings::{RecordingInfo, RecordingLimits, Recordings, RecordingsError};
pub use start::{Running, ServiceError, start};
