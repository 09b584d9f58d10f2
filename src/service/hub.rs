//! Fans out what the pipeline thread reports: picture, stream, metrics, history.
//!
//! The pipeline thread never waits for any of it: it offers reports to a bounded queue, and this task
//! takes them to listeners, disk and counters at their own pace.

use super::announcer::{Announcer, Then};
use super::clock;
use super::handle::StreamMessage;
use super::live::{LiveState, NOTICE, SpectrumView, StoreView};
use super::store_watch::StoreWatch;
use crate::store::{EventFilter, FILE_NAME, StoreReader, StoreWriter};
use crate::telemetry::{Event, EventKind, Metrics};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use tokio::sync::{broadcast, mpsc, watch};

/// Force of every axis over one report: smallest and largest value of each of its slices.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct ForceFrame {
    /// Time of the newest sample, s.
    pub(super) t_s: f64,
    /// Length of a slice, s.
    pub(super) slice_s: f64,
    /// Axis by axis: `[smallest, largest]` of each slice, oldest first.
    pub(super) axes: Vec<Vec<[f32; 2]>>,
}

/// What the pipeline thread reports.
#[derive(Debug)]
pub(super) enum Report {
    /// The picture, twenty times a second.
    View(Box<View>),
    /// Something happened.
    Event(Box<Event>),
    /// A command is about to be sent; it must be durable first.
    Intent { sequence: u64, event: Box<Event> },
}

/// One picture with its data for plots.
#[derive(Debug, Default)]
pub(super) struct View {
    pub(super) state: LiveState,
    pub(super) force: ForceFrame,
    pub(super) spectrum: SpectrumView,
}

/// A spectrum column for the page: levels in steps of half a decibel.
#[derive(Debug, Serialize)]
struct SpectrumFrame {
    t_s: f64,
    first_hz: f64,
    step_hz: f64,
    /// Base64 of one byte a bin: `2 * (20 log10(amplitude / 1 N) + 80)`, cut to 0..255.
    levels: String,
}

/// The level byte of an amplitude: half decibels above -80 dB re 1 N.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn level(amplitude_n: f64) -> u8 {
    let decibel = 20.0 * amplitude_n.max(1e-9).log10();
    (2.0 * (decibel + 80.0)).clamp(0.0, 255.0) as u8
}

fn spectrum_frame(view: &SpectrumView) -> SpectrumFrame {
    let levels: Vec<u8> = view.amplitude_n.iter().map(|a| level(*a)).collect();
    SpectrumFrame {
        t_s: view.t_s,
        first_hz: view.first_hz,
        step_hz: view.step_hz,
        levels: STANDARD.encode(levels),
    }
}

/// Ends of the channels that the hub feeds.
pub(super) struct Outlets {
    pub(super) state: watch::Sender<Arc<LiveState>>,
    pub(super) spectrum: watch::Sender<Arc<SpectrumView>>,
    pub(super) stream: broadcast::Sender<StreamMessage>,
    pub(super) announcer: Announcer,
}

/// The history and what is known of it.
pub(super) struct History {
    pub(super) writer: StoreWriter,
    pub(super) reader: StoreReader,
    pub(super) folder: PathBuf,
    pub(super) replaced: Option<String>,
}

/// Slow things (file sizes, open alarms, retention) are looked at this often.
const SLOW: Duration = Duration::from_secs(1);
const PRUNE_EVERY: u32 = 600;

/// A step of the wall clock that is told, s.
const STEP_S: f64 = 30.0;
/// After a step nothing is removed by age for this long: the clock may be set right again.
const NO_PRUNING: Duration = Duration::from_secs(86_400);

/// The task.
pub(super) struct Hub {
    outlets: Outlets,
    history: History,
    metrics: Arc<Metrics>,
    store_view: StoreView,
    open_alarms: u64,
    last_commits: i64,
    store_watch: StoreWatch,
    frames: u64,
    clocks: (Instant, i64),
    prune_after: Option<Instant>,
}

impl Hub {
    pub(super) fn new(
        outlets: Outlets,
        history: History,
        metrics: Arc<Metrics>,
        store_view: StoreView,
    ) -> Self {
        let store_watch = StoreWatch::new(Arc::clone(history.writer.gauges()));
        Self {
            outlets,
            history,
            metrics,
            store_view,
            open_alarms: 0,
            last_commits: 0,
            store_watch,
            frames: 0,
            clocks: (clock::now(), clock::wall_ns()),
            prune_after: None,
        }
    }

    /// Runs until the pipeline thread has ended and all of its reports are dealt with.
    pub(super) async fn run(mut self, mut reports: mpsc::Receiver<Report>) {
        let mut slow = tokio::time::interval(SLOW);
        slow.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut ticks = 0_u32;
        loop {
            tokio::select! {
                report = reports.recv() => match report {
                    Some(report) => self.take(report),
                    None => break,
                },
                _ = slow.tick() => {
                    ticks = ticks.wrapping_add(1);
                    self.look_around(ticks.is_multiple_of(PRUNE_EVERY)).await;
                    self.metrics.queue_depth.with_label_values(&["reports"]).set(depth(&reports));
                }
            }
        }
    }

    fn take(&mut self, report: Report) {
        match report {
            Report::View(view) => self.show(*view),
            Report::Event(event) => self.outlets.announcer.announce(*event, Then::Nothing),
            Report::Intent { sequence, event } => {
                self.outlets.announcer.announce(*event, Then::Committed(sequence))
            }
        }
    }

    fn show(&mut self, mut view: View) {
        let wall_ns = clock::wall_ns();
        view.state.version = env!("CARGO_PKG_VERSION").to_owned();
        view.state.notice = NOTICE.to_owned();
        view.state.time = clock::rfc3339(wall_ns);
        view.state.time_ns = wall_ns;
        view.state.store = self.store_view.clone();
        view.state.open_alarms = self.open_alarms;
        self.frames += 1;
        if self.outlets.stream.receiver_count() > 0 {
            self.send("force", &view.force);
            if !view.spectrum.amplitude_n.is_empty() {
                self.send("spectrum", &spectrum_frame(&view.spectrum));
            }
            if self.frames.is_multiple_of(2) {
                self.send("state", &view.state);
            }
        }
        self.outlets.spectrum.send_replace(Arc::new(view.spectrum));
        self.outlets.state.send_replace(Arc::new(view.state));
    }

    fn send(&self, kind: &'static str, value: &impl Serialize) {
        let data = serde_json::to_string(value).unwrap_or_default();
        let _ = self.outlets.stream.send(StreamMessage { id: None, kind, data: data.into() });
    }

    /// A wall clock that jumps makes everything look old or young: nothing is removed by age for a day.
    fn compare_clocks(&mut self) {
        let (now, wall_ns) = (clock::now(), clock::wall_ns());
        let (then, then_ns) = std::mem::replace(&mut self.clocks, (now, wall_ns));
        let passed_s = now.duration_since(then).as_secs_f64();
        let step_s = (wall_ns.saturating_sub(then_ns)) as f64 * 1e-9 - passed_s;
        if step_s.abs() > STEP_S {
            self.prune_after = Some(now + NO_PRUNING);
            let text = format!("the wall clock jumped by {step_s:.0} s; nothing is removed by age for a day");
            let event = Event { id: clock::new_id(), ..Event::new(EventKind::ClockStep, wall_ns, text) };
            self.outlets.announcer.announce(event, Then::Nothing);
        }
    }

    async fn look_around(&mut self, prune: bool) {
        self.compare_clocks();
        let prune = prune && self.prune_after.is_none_or(|after| clock::now() >= after);
        let gauges = self.history.writer.gauges();
        let waiting = gauges.waiting.load(Ordering::Relaxed) as u64;
        // A disk that hangs fails no write: nothing gets done either way.
        let failing = gauges.failures.load(Ordering::Relaxed) > 0 || !self.store_watch.writable(clock::now());
        let commits = gauges.commits.load(Ordering::Relaxed);
        let size = |suffix: &str| {
            let path = self.history.folder.join(format!("{FILE_NAME}{suffix}"));
            std::fs::metadata(path).map_or(0, |m| m.len())
        };
        let (bytes, wal) = (size(""), size("-wal"));
        self.store_view = StoreView {
            healthy: !failing,
            unpersisted: waiting,
            bytes,
            replaced: self.history.replaced.clone(),
        };
        self.metrics.events_unpersisted.set(i64::try_from(waiting).unwrap_or(i64::MAX));
        self.metrics
            .queue_depth
            .with_label_values(&["store"])
            .set(i64::try_from(waiting).unwrap_or(i64::MAX));
        self.metrics.store_bytes.set(i64::try_from(bytes).unwrap_or(i64::MAX));
        self.metrics.wal_bytes.set(i64::try_from(wal).unwrap_or(i64::MAX));
        self.metrics.stage_up.with_label_values(&["store"]).set(i64::from(!failing));
        if commits != self.last_commits {
            self.last_commits = commits;
            self.metrics.last_commit_timestamp_seconds.set(clock::wall_s());
        }
        if !failing {
            self.count_alarms().await;
        }
        if prune && !failing {
            let writer = self.history.writer.clone();
            tokio::spawn(async move { writer.prune(clock::wall_ns()).await });
        }
    }

    async fn count_alarms(&mut self) {
        let filter = EventFilter { unacknowledged_alarms: true, limit: 200, ..EventFilter::default() };
        let now = clock::wall_ns();
        if let Ok(page) = self.history.reader.page(&filter).await {
            let loud = |e: &&Event| e.silenced_until_ns.is_none_or(|until| until < now);
            self.open_alarms = page.events.iter().filter(loud).count() as u64;
        }
    }
}

fn depth(reports: &mpsc::Receiver<Report>) -> i64 {
    i64::try_from(reports.len()).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::level;

    #[test]
    fn levels_are_half_decibels_above_a_tenth_of_a_millinewton() {
        assert_eq!(level(1.0), 160);
        assert_eq!(level(10.0), 200);
        assert_eq!(level(1e-4), 0);
        assert_eq!(level(0.0), 0);
        assert_eq!(level(1e6), 255);
    }
}
