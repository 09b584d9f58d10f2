//! Metrics in the Prometheus text format, version 0.0.4. Every counter exists at 0 from the start.

use super::event::EventKind;
use super::process::append_process_metrics;
use crate::avoidance::HoldReason;
use crate::avoidance::guard::Refusal;
use crate::avoidance::invariants::Violation;
use prometheus::{
    Encoder as _, Gauge, GaugeVec, Histogram, HistogramOpts, HistogramVec, IntCounter, IntCounterVec,
    IntGauge, IntGaugeVec, Opts, Registry, TextEncoder,
};

/// Why a sample was not taken.
pub const REJECT_REASONS: [&str; 3] = ["not_finite", "duplicate", "out_of_order"];
/// Why samples were not taken on any axis; counted with the axis `all`.
const STREAM_REJECT_REASONS: [&str; 3] = ["implausible_stamp", "bad_count", "bad_layout"];

/// The service's own reasons not to send what was decided, beside the decision's.
pub const HOLD_REASONS: [&str; 5] =
    ["store_unavailable", "intent_expired", "mode_left", "no_port", "stage_failed"];
/// What becomes of a command.
pub const COMMAND_OUTCOMES: [&str; 8] =
    ["sent", "renewed", "returned", "advised", "reached", "refused", "limited", "expired"];

/// Upper bounds of the decision latency: 10 us times powers of two.
pub const DECISION_BUCKETS_S: [f64; 12] =
    [1e-5, 2e-5, 4e-5, 8e-5, 1.6e-4, 3.2e-4, 6.4e-4, 1.28e-3, 2.56e-3, 5.12e-3, 1.024e-2, 2.048e-2];

const HTTP_BUCKETS_S: [f64; 2] = [0.05, 0.5];
const STEP_BUCKETS_S: [f64; 6] = [4e-5, 1.6e-4, 6.4e-4, 2.56e-3, 1.024e-2, 4.096e-2];
/// Parts of the API and classes of answers that requests are counted by: few series, whatever is asked.
pub const HTTP_ROUTES: [&str; 5] = ["live", "history", "control", "operation", "page"];
/// Classes of status codes; all below 400 is `2xx`.
pub const HTTP_CODES: [&str; 3] = ["2xx", "4xx", "5xx"];

/// What the binary is.
#[derive(Debug, Clone, Copy)]
pub struct BuildInfo {
    /// Version of the package.
    pub version: &'static str,
    /// Revision it was built from, or `unknown`.
    pub revision: &'static str,
    /// Compiler that the package asks for.
    pub rustc: &'static str,
}

impl BuildInfo {
    /// This binary.
    pub const THIS: Self = Self {
        version: env!("CARGO_PKG_VERSION"),
        revision: match option_env!("STILLCUT_REVISION") {
            Some(revision) => revision,
            None => "unknown",
        },
        rustc: env!("CARGO_PKG_RUST_VERSION"),
    };
}

macro_rules! series {
    ($($field:ident: $kind:ty = $make:ident($($argument:expr),*);)*) => {
        /// All series of the service.
        #[derive(Debug)]
        #[allow(missing_docs)] // each field is named like its series, whose help text stands in the table
        pub struct Metrics {
            registry: Registry,
            start_s: f64,
            $(pub $field: $kind,)*
        }

        impl Metrics {
            fn register(make: &Maker, start_s: f64) -> prometheus::Result<Self> {
                Ok(Self { registry: make.0.clone(), start_s, $($field: make.$make($($argument),*)?,)* })
            }
        }
    };
}

series! {
    samples: IntCounterVec = counters("stillcut_samples_total", "Samples taken in.", &["axis"]);
    samples_lost: IntCounterVec = counters("stillcut_samples_lost_total",
        "Samples that never came.", &["axis"]);
    samples_rejected: IntCounterVec = counters("stillcut_samples_rejected_total",
        "Samples refused.", &["axis", "reason"]);
    sample_gaps: IntCounterVec = counters("stillcut_sample_gaps_total",
        "Interruptions of the sample stream.", &["axis"]);
    last_sample_timestamp_seconds: GaugeVec = gauges("stillcut_last_sample_timestamp_seconds",
        "Wall clock when the newest sample was taken in; absent before the first.", &[]);
    queue_depth: IntGaugeVec = int_gauges("stillcut_queue_depth", "Entries waiting in a queue.", &["queue"]);
    queue_dropped: IntCounterVec = counters("stillcut_queue_dropped_total",
        "Entries dropped from a queue.", &["queue", "intentional"]);
    decision_latency_seconds: Histogram = histogram("stillcut_decision_latency_seconds",
        "Time from the wake that took in the newest samples to the end of its decision, in seconds. What \
        they waited before it is not in it: up to 1 ms in act, 50 ms else.");
    step_duration_seconds: Histogram = step_histogram("stillcut_step_duration_seconds",
        "Time of the pipeline for what one wake took in, in seconds.");
    http_request_duration_seconds: HistogramVec = http_histogram("stillcut_http_request_duration_seconds",
        "Time from the request's head to the response's head, in seconds, by part of the API and class of \
        the answer.",
        &["route", "code"]);
    http_connections: IntGauge = int_gauge("stillcut_http_connections", "Open HTTP connections.");
    http_refused: IntCounterVec = counters("stillcut_http_refused_total",
        "Requests or connections refused.", &["reason"]);
    chatter_active: IntGauge = int_gauge("stillcut_chatter_active", "1 while chatter is detected.");
    chatter_deaf: GaugeVec = gauges("stillcut_chatter_deaf",
        "1 while chatter of the bar cannot be heard for this reason; absent otherwise.", &["reason"]);
    chatter_frequency_hertz: GaugeVec = gauges("stillcut_chatter_frequency_hertz",
        "Tracked line; absent while stillcut_chatter_frequency_valid is 0.", &[]);
    chatter_frequency_valid: IntGauge = int_gauge("stillcut_chatter_frequency_valid",
        "1 while a line is tracked.");
    chatter_power_newtons_squared: Gauge = gauge("stillcut_chatter_power_newtons_squared",
        "Power of the strongest line of the band.");
    stability_margin_per_second: GaugeVec = gauges("stillcut_stability_margin_per_second",
        "Damping left before chatter, and its 95 % interval; absent while it is not known.",
        &["axis", "bound"]);
    stability_margin_known: IntGaugeVec = int_gauges("stillcut_stability_margin_known",
        "1 while the margin of an axis is known.", &["axis"]);
    stability_margin_deaf: GaugeVec = gauges("stillcut_stability_margin_deaf",
        "1 while the cut cannot be heard for this reason; absent otherwise.", &["axis", "reason"]);
    force_disagreement_newtons: GaugeVec = gauges("stillcut_force_disagreement_newtons",
        "Standard deviation of the difference of an axis' two force estimators, last second.", &["axis"]);
    force_usable_band_hertz: GaugeVec = gauges("stillcut_force_usable_band_hertz",
        "Band in which an axis' force estimator is right within a tenth of the force.", &["axis", "end"]);
    force_noise_floor_newtons: GaugeVec = gauges("stillcut_force_noise_floor_newtons",
        "Standard deviation that encoder steps alone cause in an axis' force.", &["axis"]);
    predicted_band_hertz: GaugeVec = gauges("stillcut_predicted_band_hertz",
        "Edges of the watched band.", &["edge"]);
    mode: IntGaugeVec = int_gauges("stillcut_mode", "1 for the mode that is on.", &["mode"]);
    commands: IntCounterVec = counters("stillcut_commands_total",
        "Turret commands by what became of them.", &["outcome"]);
    holds: IntCounterVec = counters("stillcut_holds_total",
        "Intervals that ended without a command.", &["reason"]);
    pitch_difference_radians: GaugeVec = gauges("stillcut_pitch_difference_radians",
        "Pitch angle difference of the two tools.", &["kind"]);
    pitch_reported_valid: IntGauge = int_gauge("stillcut_pitch_reported_valid",
        "1 while the controller reports its offsets.");
    interlock_open: IntGaugeVec = int_gauges("stillcut_interlock_open",
        "1 while open or not heard.", &["name"]);
    limit_active: IntGaugeVec = int_gauges("stillcut_limit_active",
        "1 while a limit cuts the command.", &["limit"]);
    events: IntCounterVec = counters("stillcut_events_total", "Events by kind.", &["kind"]);
    events_unpersisted: IntGauge = int_gauge("stillcut_events_unpersisted", "Events waiting to be stored.");
    store_errors: IntCounterVec = counters("stillcut_store_errors_total",
        "Failures of the history file by code.", &["code"]);
    history_removed: IntCounterVec = counters("stillcut_history_removed_total",
        "Events (audit: rows of the audit record) that the retention removed; forced: events that \
        still waited for a person or the broker.", &["reason"]);
    history_lost: IntCounterVec = counters("stillcut_history_lost_total",
        "Rows that were durable in an earlier life and that this start did not find.", &["table"]);
    store_bytes: IntGauge = int_gauge("stillcut_store_bytes", "Size of the history file.");
    wal_bytes: IntGauge = int_gauge("stillcut_wal_bytes", "Size of the history file's write-ahead log.");
    store_filesystem_available_bytes: IntGauge = int_gauge("stillcut_store_filesystem_available_bytes",
        "Free bytes for this user on the file system of the history and the recordings.");
    store_filesystem_size_bytes: IntGauge = int_gauge("stillcut_store_filesystem_size_bytes",
        "Size of the file system of the history and the recordings; 0 before the first look.");
    last_commit_timestamp_seconds: Gauge = gauge("stillcut_last_commit_timestamp_seconds",
        "Wall clock of the last durable commit.");
    recordings: IntCounterVec = counters("stillcut_recordings_total",
        "Black-box recordings by outcome.", &["outcome"]);
    security_events: IntCounterVec = counters("stillcut_security_events_total",
        "Access events by kind.", &["kind"]);
    stage_up: IntGaugeVec = int_gauges("stillcut_stage_up", "1 while the stage works.", &["stage"]);
    invariant_violations: IntCounterVec = counters("stillcut_invariant_violations_total",
        "Decisions that broke a rule of the independent monitor; none was sent.", &["rule"]);
    model_residual_ratio: GaugeVec = gauges("stillcut_model_residual_ratio",
        "Part of the thrust that the model leaves open while an axis moves and the spindle stands; \
        absent before the first window.", &["axis"]);
    model_windows: IntCounterVec = counters("stillcut_model_windows_total",
        "Seconds in which model and machine could be compared.", &["axis"]);
    model_mismatches: IntCounterVec = counters("stillcut_model_mismatches_total",
        "Significant differences of model and machine.", &["axis"]);
    diagnoses: IntCounterVec = counters("stillcut_diagnoses_total", "Diagnoses by outcome.", &["outcome"]);
    outbox_waiting: IntGauge = int_gauge("stillcut_outbox_waiting",
        "Events that the fleet's broker has not confirmed yet.");
    outbox_sent: IntCounterVec = counters("stillcut_outbox_total",
        "Events for the fleet's broker by outcome.", &["outcome"]);
}

/// Makes and registers series; a name that cannot be registered is a slip of ours, found by any test.
struct Maker(Registry);

impl Maker {
    fn put<C: prometheus::core::Collector + Clone + 'static>(
        &self,
        made: prometheus::Result<C>,
    ) -> prometheus::Result<C> {
        let collector = made?;
        self.0.register(Box::new(collector.clone()))?;
        Ok(collector)
    }

    fn counters(&self, name: &str, help: &str, labels: &[&str]) -> prometheus::Result<IntCounterVec> {
        self.put(IntCounterVec::new(Opts::new(name, help), labels))
    }

    fn gauges(&self, name: &str, help: &str, labels: &[&str]) -> prometheus::Result<GaugeVec> {
        self.put(GaugeVec::new(Opts::new(name, help), labels))
    }

    fn int_gauges(&self, name: &str, help: &str, labels: &[&str]) -> prometheus::Result<IntGaugeVec> {
        self.put(IntGaugeVec::new(Opts::new(name, help), labels))
    }

    fn gauge(&self, name: &str, help: &str) -> prometheus::Result<Gauge> {
        self.put(Gauge::new(name, help))
    }

    fn int_gauge(&self, name: &str, help: &str) -> prometheus::Result<IntGauge> {
        self.put(IntGauge::new(name, help))
    }

    fn http_histogram(&self, name: &str, help: &str, labels: &[&str]) -> prometheus::Result<HistogramVec> {
        self.put(HistogramVec::new(HistogramOpts::new(name, help).buckets(HTTP_BUCKETS_S.to_vec()), labels))
    }

    fn histogram(&self, name: &str, help: &str) -> prometheus::Result<Histogram> {
        let options = HistogramOpts::new(name, help).buckets(DECISION_BUCKETS_S.to_vec());
        self.put(Histogram::with_opts(options))
    }

    fn step_histogram(&self, name: &str, help: &str) -> prometheus::Result<Histogram> {
        let options = HistogramOpts::new(name, help).buckets(STEP_BUCKETS_S.to_vec());
        self.put(Histogram::with_opts(options))
    }
}

impl Metrics {
    /// All series, at zero. `axes`: the configured axes. `start_s`: seconds since 1970.
    /// Errors: a name that the registry refuses.
    pub fn new(axes: &[String], start_s: f64) -> prometheus::Result<Self> {
        let make = Maker(Registry::new());
        let metrics = Self::register(&make, start_s)?;
        metrics.register_info(&make)?;
        metrics.start_at_zero(axes);
        Ok(metrics)
    }

    fn register_info(&self, make: &Maker) -> prometheus::Result<()> {
        let info = BuildInfo::THIS;
        let build = make.int_gauges(
            "stillcut_build_info",
            "What is running; always 1.",
            &["version", "revision", "rustc"],
        )?;
        build.with_label_values(&[info.version, info.revision, info.rustc]).set(1);
        Ok(())
    }

    /// Adds the series that names the configuration in force.
    /// Errors: called twice.
    pub fn set_config_hash(&self, hash: &str) -> prometheus::Result<()> {
        let make = Maker(self.registry.clone());
        let info = make.int_gauges("stillcut_config_info", "Configuration in force; always 1.", &["hash"])?;
        info.with_label_values(&[hash]).set(1);
        Ok(())
    }

    /// Touches every member of every closed label set, so that it exists before it first counts.
    fn start_at_zero(&self, axes: &[String]) {
        for axis in axes.iter().map(String::as_str) {
            for family in [&self.samples, &self.samples_lost, &self.sample_gaps] {
                family.with_label_values(&[axis]);
            }
            for family in [&self.model_windows, &self.model_mismatches] {
                family.with_label_values(&[axis]);
            }
            for reason in REJECT_REASONS {
                self.samples_rejected.with_label_values(&[axis, reason]);
            }
        }
        for reason in STREAM_REJECT_REASONS {
            self.samples_rejected.with_label_values(&["all", reason]);
        }
        let zero = |family: &IntCounterVec, words: &[&str]| {
            for word in words {
                family.with_label_values(&[*word]);
            }
        };
        zero(&self.commands, &COMMAND_OUTCOMES);
        zero(&self.holds, &HOLD_REASONS);
        zero(&self.holds, &Refusal::NAMES);
        let decided: Vec<&str> = HoldReason::ALL.iter().map(|r| r.name()).collect();
        zero(&self.holds, &decided);
        let rules = Violation::ALL.map(Violation::name);
        zero(&self.invariant_violations, &rules);
        zero(&self.diagnoses, &["done", "failed", "cancelled"]);
        zero(&self.outbox_sent, &["sent", "failed", "dropped"]);
        zero(&self.store_errors, &["full", "io", "corrupt", "not_a_database", "busy", "other"]);
        zero(&self.history_removed, &["age", "size", "forced", "audit"]);
        zero(&self.history_lost, &["event", "audit"]);
        zero(&self.recordings, &["saved", "too_short", "failed", "dropped", "removed"]);
        zero(&self.security_events, &["bad_token", "forbidden", "rate_limited", "bad_host", "token_file"]);
        zero(&self.http_refused, &["connections", "idle", "streams", "exports", "body_too_large"]);
        let kinds: Vec<&str> = EventKind::ALL.iter().map(|k| k.word()).collect();
        zero(&self.events, &kinds);
        for queue in ["reports", "store"] {
            self.queue_depth.with_label_values(&[queue]);
        }
        // Meant to be shed: pictures (the next is 50 ms away) and comparisons with the model.
        for queue in ["reports", "drift"] {
            self.queue_dropped.with_label_values(&[queue, "true"]);
        }
        // Never to be lost: events, recordings, rows of the history.
        for queue in ["reports", "recorder", "store"] {
            self.queue_dropped.with_label_values(&[queue, "false"]);
        }
        for mode in ["observe", "advise", "act"] {
            self.mode.with_label_values(&[mode]);
        }
        for stage in ["transport", "pipeline", "turret", "store", "recorder", "drift"] {
            self.stage_up.with_label_values(&[stage]);
        }
        for limit in ["pitch", "rate"] {
            self.limit_active.with_label_values(&[limit]);
        }
        for kind in ["commanded", "reported"] {
            self.pitch_difference_radians.with_label_values(&[kind]);
        }
        for edge in ["lower", "upper"] {
            self.predicted_band_hertz.with_label_values(&[edge]);
        }
    }

    /// Everything in the Prometheus text format.
    /// Errors: the encoder's.
    pub fn text(&self) -> prometheus::Result<String> {
        let mut bytes = Vec::with_capacity(32 * 1024);
        TextEncoder::new().encode(&self.registry.gather(), &mut bytes)?;
        let mut text = String::from_utf8_lossy(&bytes).into_owned();
        append_process_metrics(&mut text, self.start_s);
        Ok(text)
    }

    /// Shows a value where it is known; what is not known has no series, and not the value 0.
    pub fn show(family: &GaugeVec, labels: &[&str], value: Option<f64>) {
        match value {
            Some(value) => family.with_label_values(labels).set(value),
            None => drop(family.remove_label_values(labels)), // it may not be there
        }
    }

    /// A counter's reader for tests and the status view.
    #[must_use]
    pub fn total(family: &IntCounterVec, labels: &[&str]) -> u64 {
        let counter: IntCounter = family.with_label_values(labels);
        counter.get()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_counter_exists_at_zero_and_names_follow_the_convention() {
        let axes = ["x1", "y1", "x2", "y2"].map(str::to_owned);
        let metrics = Metrics::new(&axes, 5.0).unwrap();
        for code in HTTP_CODES {
            for route in HTTP_ROUTES {
                metrics.http_request_duration_seconds.with_label_values(&[route, code]).observe(0.1);
            }
        }
        let text = metrics.text().unwrap();
        assert!(text.contains("stillcut_samples_lost_total{axis=\"y1\"} 0"));
        assert!(text.contains("stillcut_events_total{kind=\"chatter_onset\"} 0"));
        assert!(text.contains("process_start_time_seconds 5"));
        let series = text.lines().filter(|l| !l.starts_with('#')).count();
        // Four axes with their margins, every route with every code: one scrape of some 30 KB.
        assert!(series < 320, "{series} series");
        for line in text.lines().filter(|l| l.starts_with("# TYPE") && l.ends_with(" counter")) {
            assert!(line.contains("_total "), "{line}");
        }
        assert!(!text.contains("NaN"));
        // What is not known is not 0.
        let (line, name) = (&metrics.chatter_frequency_hertz, "\nstillcut_chatter_frequency_hertz ");
        for known in [None, Some(652.0), None] {
            Metrics::show(line, &[], known);
            assert_eq!(metrics.text().unwrap().contains(name), known.is_some());
        }
        for name in ["stillcut_last_sample_timestamp_seconds", "stillcut_model_residual_ratio"] {
            assert!(!text.contains(name), "{name}");
        }
    }
}
