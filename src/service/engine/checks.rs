//! The pipeline thread's part, fed by hand: planted faults and doubtful estimates must end in a refusal.

use super::acting::commissioned;
use super::{Engine, Setup};
use crate::config::service::ServiceConfig;
use crate::plant::scenario::Scenario;
use crate::service::clock;
use crate::service::hub::Report;
use crate::service::live::Mode;
use crate::simulation::lathe::{Lathe, LatheSettings};
use crate::telemetry::{EventKind, Metrics};
use crate::transport::Domain;
use crate::transport::wire::{ServoBatch, ServoPoint, TURRET_REACHED, TurretStatus, axis_name_bytes};
use std::sync::Arc;
use std::time::Duration;

const AXES: [&str; 4] = ["x1", "y1", "x2", "y2"];

struct Bench {
    engine: Engine,
    lathe: Lathe,
    names: [&'static str; 4],
    jobs: std::sync::mpsc::Receiver<crate::service::recorder::Job>,
    // Kept open for the engine.
    _ends: Box<dyn std::any::Any>,
    _folder: tempfile::TempDir,
}

fn bench() -> Bench {
    let folder = tempfile::tempdir().unwrap();
    let (reports, reported) = tokio::sync::mpsc::channel(1);
    let (control, controls) = tokio::sync::mpsc::channel(1);
    let (recorder, jobs) = std::sync::mpsc::sync_channel(4);
    let (drift, feeds) = std::sync::mpsc::sync_channel(4);
    let engine = Engine::new(Setup {
        config: Arc::new(ServiceConfig::default()),
        config_hash: String::new(),
        domain: Domain::new("checks", folder.path()).unwrap(),
        epoch: 1,
        reports,
        controls,
        recorder,
        drift,
        metrics: Arc::new(Metrics::new(&[], 0.0).unwrap()),
        progress: Arc::default(),
    });
    let ends = Box::new((reported, control, feeds));
    let lathe = Lathe::new(LatheSettings::realistic(Scenario::default(), 1));
    Bench { engine, lathe, names: AXES, jobs, _ends: ends, _folder: folder }
}

impl Bench {
    fn feed(&mut self, seconds: f64, change: impl Fn(&mut ServoPoint)) {
        let batches = (seconds * 9000.0 / 9.0) as usize;
        for _ in 0..batches {
            let mut batch = ServoBatch {
                stream: 1,
                sample_rate_hz: 9000.0,
                sample_count: 9,
                axis_count: AXES.len() as u32,
                ..ServoBatch::default()
            };
            for (to, name) in batch.axis_names.iter_mut().zip(self.names) {
                *to = axis_name_bytes(name);
            }
            for point in batch.points.iter_mut().take(9) {
                let sample = self.lathe.step();
                *point = ServoPoint::from_sample(&sample, (sample.t_s * 1e9) as u64, AXES.len());
                change(point);
            }
            self.engine.take_batch(&batch, clock::now());
        }
    }

    /// Mode act, turret and interlocks heard, one interval over: what is decided?
    fn decide_in_act(&mut self) {
        let now = clock::now() + Duration::from_millis(1100);
        let status =
            TurretStatus { stream: 1, axis_count: 4, state: TURRET_REACHED, ..TurretStatus::default() };
        self.engine.take_status(&status, now);
        self.engine.last_arrival = Some((now, clock::wall_ns()));
        self.engine.mode = Mode::Act;
        self.engine.backlog.clear();
        self.engine.decide(now);
    }

    fn intents(&self) -> usize {
        self.engine.backlog.iter().filter(|r| matches!(r, Report::Intent { .. })).count()
    }

    fn told(&self, kind: EventKind) -> usize {
        let of_kind = |r: &&Report| matches!(r, Report::Event(event) if event.kind == kind);
        self.engine.backlog.iter().filter(of_kind).count()
    }

    fn hold(&self) -> Option<&'static str> {
        self.engine.acting.as_ref().and_then(|a| a.hold)
    }
}

#[test]
fn chatter_in_act_leads_to_an_intent() {
    let mut bench = bench();
    bench.feed(3.5, |_| {});
    bench.decide_in_act();
    assert_eq!((bench.intents(), bench.hold()), (1, None));
    assert_eq!(bench.engine.mode, Mode::Act);
}

/// The decision believes in limits that the monitor was not told of: nothing goes out, a person is called.
#[test]
fn a_decision_that_breaks_a_rule_is_not_sent_and_ends_acting() {
    let mut bench = bench();
    bench.feed(3.5, |_| {});
    let narrow = commissioned(&ServiceConfig::default(), [0, 1]);
    let narrow = crate::avoidance::invariants::Commissioned {
        axes: narrow.axes.map(|(index, direction, ..)| (index, direction, -1e-6, 1e-6, 1.0)),
        ..narrow
    };
    bench.engine.acting.as_mut().unwrap().mislead(narrow, 0.0);
    bench.decide_in_act();
    assert_eq!(bench.intents(), 0, "nothing is on its way");
    assert_eq!(bench.told(EventKind::InvariantViolation), 1);
    assert_eq!(bench.told(EventKind::Fault), 1);
    assert_eq!(bench.engine.mode, Mode::Observe);
    assert!(bench.engine.fault.as_deref().unwrap().contains("envelope"));
    let counted = Metrics::total(&bench.engine.setup.metrics.invariant_violations, &["envelope"]);
    assert_eq!((counted, bench.hold()), (1, Some("guarded")));
    assert!(bench.engine.save.is_some(), "the samples behind it are kept");
}

#[test]
fn an_estimate_that_forbids_acting_is_a_refusal_with_its_reason() {
    let mut bench = bench();
    bench.feed(3.5, |_| {});
    // The linear scales fall silent for a moment: the last value is held, and flagged.
    bench.feed(0.01, |point| point.valid &= 0b011_011_011_011);
    let agreement = *bench.engine.stream.as_ref().unwrap().pipeline().agreement();
    assert_eq!(agreement.phase, crate::chatter::Phase::Chatter, "it would command otherwise");
    bench.decide_in_act();
    assert_eq!((bench.intents(), bench.hold()), (0, Some("estimate_not_valid")));
    assert_eq!(Metrics::total(&bench.engine.setup.metrics.holds, &["estimate_not_valid"]), 1);
    assert_eq!(bench.engine.mode, Mode::Act, "it is no fault: the next interval may act");
}

/// A machine whose stream has no two turret axes is observed like any other; it only cannot be commanded.
#[test]
fn a_stream_without_turret_axes_is_heard_and_not_commanded() {
    let mut bench = bench();
    bench.names = ["x1", "z1", "x2", "y2"];
    bench.feed(3.5, |_| {});
    let stream = bench.engine.stream.as_ref().expect("the stream is taken");
    assert_eq!(stream.pipeline().agreement().phase, crate::chatter::Phase::Chatter);
    let why = bench.engine.no_pitch.clone().unwrap();
    assert!(why.contains("turret.axes") && why.contains("no axis"), "{why}");
    let told = |r: &Report| matches!(r, Report::Event(e) if e.text.contains("no pitch control"));
    assert!(bench.engine.backlog.iter().any(told), "it is said when the stream begins");
    bench.decide_in_act();
    assert_eq!(bench.intents(), 0);
    assert_eq!(bench.engine.view(clock::now()).state.pitch.unavailable, Some(why));
}

#[test]
fn a_recording_that_waits_is_saved_when_the_samples_cease() {
    let mut bench = bench();
    bench.feed(3.5, |_| {});
    assert!(bench.engine.save.is_some() && bench.jobs.try_recv().is_err(), "it waits for the seconds after");
    bench.engine.supervise(clock::now() + Duration::from_millis(1500));
    assert!(bench.engine.stream.is_none() && bench.engine.save.is_none());
    let job = bench.jobs.try_recv().expect("what there is was handed over");
    assert!(job.chunks.iter().map(|c| c.samples.len()).sum::<usize>() > 9000);
    // A stream that begins anew does the same.
    bench.feed(3.5, |_| {});
    bench.engine.save_around("manual", "test");
    bench.names = ["a", "b", "c", "d"];
    bench.feed(0.001, |_| {});
    assert!(bench.jobs.try_recv().is_ok());
}

#[test]
fn batches_without_a_usable_sample_are_silence() {
    let mut bench = bench();
    bench.feed(0.1, |_| {});
    let before = bench.engine.last_arrival;
    bench.feed(0.1, |point| point.axes.iter_mut().for_each(|a| a.current_ref_a = f64::NAN));
    assert_eq!(bench.engine.last_arrival, before, "what is no number is not fresh");
    let later = clock::now() + Duration::from_millis(1500);
    bench.engine.last_batch = Some(later);
    bench.engine.supervise(later);
    assert_eq!(bench.told(EventKind::SourceLost), 1);
    assert!(!bench.engine.view(later).state.source.connected);
    bench.feed(0.1, |_| {});
    assert!(
        !bench.engine.source_lost && bench.engine.stream.is_some(),
        "good samples go on in the same stream"
    );
}
