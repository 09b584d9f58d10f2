//! Fans out what the pipeline thread reports: picture, stream, metrics, history.
//!
//! The pipeline thread never waits for any of it: it offers reports to a bounded queue, and this task
//! takes them to listeners, history and counters at their own pace. It waits for no disk either
//! (see `upkeep`).

use super::announcer::{Announcer, Then};
use super::clock;
use super::live::{LiveState, NOTICE, SpectrumView, StreamMessage, level};
use super::past::{Past, Seen};
use super::upkeep::Kept;
use crate::store::PastCut;
use crate::telemetry::{Event, Metrics};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::{broadcast, mpsc, watch};

/// Force of every axis over one report: smallest and largest value of each of its slices.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct ForceFrame {
    /// Time of the newest sample, s.
    pub(super) t_s: f64,
    /// Length of a slice, s.
    pub(super) slice_s: f64,
    /// Axis by axis: `[smallest, largest]` of each slice, oldest first; none where no force is estimated.
    pub(super) axes: Vec<Vec<[f32; 2]>>,
}

/// What the pipeline thread reports.
#[derive(Debug)]
pub(super) enum Report {
    /// The picture, twenty times a second.
    View(Box<View>),
    /// Something happened.
    Event(Box<Event>),
    /// A cut is over.
    Cut(Box<PastCut>),
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
    pub(super) past: Arc<Mutex<Past>>,
}

/// The task.
pub(super) struct Hub {
    outlets: Outlets,
    metrics: Arc<Metrics>,
    kept: watch::Receiver<Kept>,
    frames: u64,
}

/// How often the length of the queue is looked at.
const LOOK: Duration = Duration::from_secs(1);

impl Hub {
    /// `kept`: what the upkeep says of the history.
    pub(super) fn new(outlets: Outlets, metrics: Arc<Metrics>, kept: watch::Receiver<Kept>) -> Self {
        Self { outlets, metrics, kept, frames: 0 }
    }

    /// Runs until the pipeline thread has ended and all of its reports are dealt with.
    pub(super) async fn run(mut self, mut reports: mpsc::Receiver<Report>) {
        let mut look = tokio::time::interval(LOOK);
        look.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                report = reports.recv() => match report {
                    Some(report) => self.take(report),
                    None => break,
                },
                _ = look.tick() => {
                    self.metrics.queue_depth.with_label_values(&["reports"]).set(depth(&reports));
                }
            }
        }
    }

    fn take(&mut self, report: Report) {
        match report {
            Report::View(view) => self.show(*view),
            Report::Event(event) => self.outlets.announcer.announce(*event, Then::Nothing),
            Report::Cut(cut) => self.outlets.announcer.keep_cut(*cut),
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
        let kept = self.kept.borrow().clone();
        (view.state.store, view.state.open_alarms) = (kept.store, kept.open_alarms);
        self.remember(&view, wall_ns);
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

    /// For pages that are opened later.
    fn remember(&self, view: &View, wall_ns: i64) {
        if view.spectrum.amplitude_n.is_empty() {
            return;
        }
        let seen = Seen {
            wall_ns,
            t_s: view.force.t_s,
            grid_hz: [view.spectrum.first_hz, view.spectrum.step_hz],
            amplitude_n: &view.spectrum.amplitude_n,
            force: &view.force.axes,
            axes: view.state.axes.iter().map(|a| a.name.clone()).collect(),
            line_hz: view.state.chatter.frequency_hz,
            chatter: view.state.chatter.state == "chatter",
        };
        self.outlets.past.lock().unwrap_or_else(PoisonError::into_inner).add(seen);
    }

    fn send(&self, kind: &'static str, value: &impl Serialize) {
        let data = serde_json::to_string(value).unwrap_or_default();
        let _ = self.outlets.stream.send(StreamMessage { id: None, kind, data: data.into() });
    }
}

fn depth(reports: &mpsc::Receiver<Report>) -> i64 {
    i64::try_from(reports.len()).unwrap_or(i64::MAX)
}
