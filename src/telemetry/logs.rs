//! Log lines to standard error, where the service manager takes them from.

use tracing::Level;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

/// How log lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// What is logged without a word in `RUST_LOG`: iceoryx2 reports every look at a dead node; only its errors
/// matter here.
const USUAL: &str = "info,iceoryx2=error,sqlx=warn";

/// Levels by part of the program (`warn,stillcut=debug`), as far as they can be read.
fn levels(asked: Option<&str>) -> Targets {
    let asked = asked.filter(|text| !text.is_empty()).and_then(|text| text.parse().ok());
    asked.or_else(|| USUAL.parse().ok()).unwrap_or_else(|| Targets::new().with_default(Level::INFO))
}

/// Starts the log, filtered by `RUST_LOG` or `info`. A second call does nothing.
pub fn start_logs(format: LogFormat) {
    let levels = levels(std::env::var("RUST_LOG").ok().as_deref());
    // A terminal that is gone takes no complaint about itself either.
    let builder = tracing_subscriber::fmt().log_internal_errors(false).with_max_level(Level::TRACE);
    let builder = builder.with_writer(std::io::stderr);
    let outcome = match format {
        LogFormat::Text => builder.with_ansi(false).finish().with(levels).try_init(),
        LogFormat::Json => builder.json().flatten_event(true).finish().with(levels).try_init(),
    };
    drop(outcome); // already started: the first one stays
}

#[cfg(test)]
mod tests {
    use super::levels;
    use tracing::Level;

    #[test]
    fn levels_are_asked_for_by_part_and_nonsense_is_the_usual() {
        for usual in [levels(None), levels(Some("")), levels(Some("stillcut=loud"))] {
            assert!(usual.would_enable("stillcut::service", &Level::INFO));
            assert!(!usual.would_enable("stillcut::service", &Level::DEBUG));
            assert!(!usual.would_enable("iceoryx2::node", &Level::WARN));
        }
        let asked = levels(Some("warn,stillcut=debug"));
        assert!(
            asked.would_enable("stillcut::http", &Level::DEBUG) && !asked.would_enable("sqlx", &Level::INFO)
        );
    }
}
