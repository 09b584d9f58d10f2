//! What the service says about itself: events (one event, one log line, one counter) and metrics.

mod event;
mod logs;
mod metrics;
mod process;

pub use event::{Event, EventKind, Severity};
pub use logs::{LogFormat, start_logs};
pub use metrics::{
    BuildInfo, COMMAND_OUTCOMES, DECISION_BUCKETS_S, HOLD_REASONS, HTTP_CODES, HTTP_ROUTES, Metrics,
    REJECT_REASONS,
};
