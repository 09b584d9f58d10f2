//! The operator page: a few files inside the binary, nothing loaded from elsewhere.

use super::Site;
use axum::Router;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use axum::routing::get;

const HTML: &str = include_str!("page/index.html");
const CSS: &str = include_str!("page/page.css");
const JS: &str = include_str!("page/page.js");
const CHARTS: &str = include_str!("page/charts.js");
const WORDS: &str = include_str!("page/words.js");
const ICON: &str = include_str!("page/icon.svg");
const PROBLEMS: &str = include_str!("page/problems.html");

fn file(kind: &'static str, text: &'static str) -> Response {
    // Checked again after every upgrade: the browser must not mix two versions.
    ([(header::CONTENT_TYPE, kind), (header::CACHE_CONTROL, "no-cache")], text).into_response()
}

pub(super) fn routes() -> Router<Site> {
    Router::new()
        .route("/", get(|| async { file("text/html; charset=utf-8", HTML) }))
        .route("/page.css", get(|| async { file("text/css; charset=utf-8", CSS) }))
        .route("/page.js", get(|| async { file("text/javascript; charset=utf-8", JS) }))
        .route("/words.js", get(|| async { file("text/javascript; charset=utf-8", WORDS) }))
        .route("/charts.js", get(|| async { file("text/javascript; charset=utf-8", CHARTS) }))
        .route("/favicon.ico", get(|| async { file("image/svg+xml", ICON) }))
        .route("/icon.svg", get(|| async { file("image/svg+xml", ICON) }))
        .route("/docs/problems", get(|| async { file("text/html; charset=utf-8", PROBLEMS) }))
}

#[cfg(test)]
mod tests {
    use crate::avoidance::HoldReason;
    use crate::telemetry::EventKind;

    /// What the page shows of an event or a hold is said in every language of it.
    #[test]
    fn every_kind_of_event_and_reason_has_its_words() {
        let table = super::WORDS;
        let words = EventKind::ALL.iter().map(|k| k.word()).chain(HoldReason::ALL.iter().map(|r| r.name()));
        for word in words {
            let key = format!("\n  \"{}\": [\"", word.replace('_', " "));
            assert_eq!(table.matches(&key).count(), 1, "{word}");
        }
    }

    /// So with what a recording that is played again tells.
    #[test]
    fn every_event_of_a_replay_has_its_words() {
        use crate::chatter::{ChatterEvent, Reason};
        // An onset is an event of the service, too: it stands in the first table.
        let events = [
            ChatterEvent::End,
            ChatterEvent::Hop { from_hz: 1.0, to_hz: 2.0 },
            ChatterEvent::Dismissed(Reason::Noise),
            ChatterEvent::CutChanged,
        ];
        for event in events {
            let kind =
                crate::report::events::EventLine::from_chatter(0.0, "x1", &event).kind.replace('_', " ");
            assert!(super::WORDS.contains(&format!("\n  \"{kind}\": [\"")), "{kind}");
        }
    }

    /// So with why a pitch waits before chatter: the page has a sentence for each.
    #[test]
    fn every_wait_before_chatter_has_its_words() {
        for wait in crate::avoidance::Wait::ALL {
            let told =
                super::JS.split(&format!("{}: \"", wait.name())).nth(1).and_then(|t| t.split('"').next());
            let key = format!("\n  \"{}\": [\"", told.unwrap_or_default());
            assert!(super::WORDS.contains(&key), "{wait:?}: {told:?}");
        }
    }

    /// So with what became of a diagnosis, as it is told by word.
    #[test]
    fn every_outcome_of_a_diagnosis_has_its_words() {
        use crate::diagnosis::Verdict::{MissingPhysics, ModelAdequate, ParameterError, UnexplainedMismatch};
        use crate::service::JobState::{Cancelled, Failed, Queued, Running};
        let verdicts = [MissingPhysics, ModelAdequate, ParameterError, UnexplainedMismatch];
        let verdicts = verdicts.map(|v| v.name().replace('_', " "));
        let states = [Queued, Running, Failed, Cancelled].map(|s| serde_json::to_value(s).unwrap());
        let words = states.iter().filter_map(|s| s.as_str()).map(str::to_owned).chain(verdicts);
        for word in words {
            assert!(super::WORDS.contains(&format!("\n  \"{word}\": [\"")), "{word}");
        }
    }

    #[test]
    fn what_the_pointer_shows_has_its_words() {
        let texts = ["title=\"", "aria-label=\""].iter().flat_map(|name| super::HTML.split(*name).skip(1));
        let texts: Vec<&str> = texts.filter_map(|rest| rest.split('"').next()).collect();
        assert!(texts.len() > 15);
        for text in texts {
            assert!(super::WORDS.contains(&format!("\n  \"{text}\": [\"")), "{text}");
        }
    }
}
