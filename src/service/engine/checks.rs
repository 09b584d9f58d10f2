//! The pipeline thread's part, fed by hand: planted faults and doubtful estimates must end in a refusal.

mod security;
mod silence;
mod stamps;

use super::acting::{Outcome, commissioned};
use super::{Engine, Ports, Setup};
use crate::avoidance::invariants::{Commissioned, CommissionedAxis};
use crate::avoidance::{Command, CommandKind};
use crate::config::service::ServiceConfig;
use crate::plant::scenario::Scenario;
use crate::service::clock;
use crate::service::control::{Control, Origin, Refusal};
use crate::service::hub::Report;
use crate::service::live::Mode;
use crate::service::store_watch::StoreWatch;
use crate::service::way_back::WayBack;
use crate::simulation::lathe::{Lathe, LatheSettings};
use crate::store::WriterGauges;
use crate::telemetry::{EventKind, Metrics};
use crate::transport::Domain;
use crate::transport::wire::{
    ServoBatch, ServoPoint, TURRET_REACHED, TURRET_REFUSED, TurretStatus, axis_name_bytes,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

const AXES: [&str; 4] = ["x1", "y1", "x2", "y2"];

struct Bench {
    engine: Engine,
    gauges: Arc<WriterGauges>,
    /// The machine's time: goes on with the samples, whatever the real one does.
    at: Instant,
    lathe: Lathe,
    /// Reports of the turret so far.
    reports: u64,
    /// Number of the machine's stream.
    stream: u64,
    names: Vec<&'static str>,
    /// Whether a token is in force that may take the turret back.
    operators: bool,
    jobs: std::sync::mpsc::Receiver<crate::service::recorder::Job>,
    // Kept open for the engine.
    _ends: Box<dyn std::any::Any>,
    _folder: tempfile::TempDir,
}

fn config() -> ServiceConfig {
    let mut config = ServiceConfig::default();
    config.turret.commissioned = Some(("the tests".into(), "2026-11-21".into()));
    config.turret.accept = vec!["estimators_disagree".into()];
    config
}

/// What the transport keeps of a domain in shared memory outlives it.
impl Drop for Bench {
    fn drop(&mut self) {
        self.engine.setup.domain.remove();
    }
}

fn bench() -> Bench {
    bench_of(config())
}

fn bench_of(config: ServiceConfig) -> Bench {
    static BENCHES: AtomicU32 = AtomicU32::new(0);
    let folder = tempfile::tempdir().unwrap();
    // One prefix each: benches run side by side, and names in shared memory are told apart by it alone.
    let prefix = format!("checks{}n{}", std::process::id(), BENCHES.fetch_add(1, Ordering::Relaxed));
    let (reports, reported) = tokio::sync::mpsc::channel(1);
    let (control, controls) = tokio::sync::mpsc::channel(1);
    let (recorder, jobs) = std::sync::mpsc::sync_channel(4);
    let (drift, feeds) = std::sync::mpsc::sync_channel(4);
    let gauges = Arc::new(WriterGauges::default());
    let engine = Engine::new(Setup {
        config: Arc::new(config),
        config_hash: String::new(),
        domain: Domain::new(&prefix, folder.path()).unwrap(),
        epoch: 1,
        reports,
        controls,
        recorder,
        drift,
        metrics: Arc::new(Metrics::new(&[], 0.0).unwrap()),
        progress: Arc::default(),
        store: StoreWatch::new(Arc::clone(&gauges)),
        way_back: Arc::new(WayBack::new()),
        commissioning: Arc::default(),
    });
    let ends = Box::new((reported, control, feeds));
    let lathe = Lathe::new(LatheSettings::realistic(Scenario::default(), 1));
    let at = clock::now() + Duration::from_secs(3600);
    Bench {
        engine,
        gauges,
        at,
        lathe,
        reports: 0,
        stream: 1,
        names: AXES.to_vec(),
        operators: true,
        jobs,
        _ends: ends,
        _folder: folder,
    }
}

impl Bench {
    /// Batches of a millisecond.
    fn feed(&mut self, seconds: f64, change: impl Fn(&mut ServoPoint)) {
        let batches = (seconds * 9000.0 / 9.0) as usize;
        for _ in 0..batches {
            let mut batch = ServoBatch {
                stream: self.stream,
                sample_rate_hz: 9000.0,
                sample_count: 9,
                axis_count: self.names.len() as u32,
                ..ServoBatch::default()
            };
            for (to, name) in batch.axis_names.iter_mut().zip(&self.names) {
                *to = axis_name_bytes(name);
            }
            for point in batch.points.iter_mut().take(9) {
                let sample = self.lathe.step();
                *point = ServoPoint::from_sample(&sample, (sample.t_s * 1e9) as u64, self.names.len());
                change(point);
            }
            self.wait(1);
            self.engine.take_batch(&batch, self.at);
        }
    }

    /// Mode act, turret and interlocks heard, one interval over: what is decided?
    fn decide_in_act(&mut self) {
        self.engine.mode = Mode::Act;
        self.engine.backlog.clear();
        self.look();
    }

    /// A look at the decision with the turret at equal pitch and every interlock closed.
    fn look(&mut self) {
        self.look_at(TURRET_REACHED);
    }

    fn look_at(&mut self, state: u32) {
        self.hear(&TurretStatus { state, ..TurretStatus::default() });
    }

    fn hear(&mut self, status: &TurretStatus) {
        self.reports += 1;
        let status = TurretStatus {
            stream: 1,
            sequence: self.reports,
            axis_count: self.names.len() as u32,
            ..*status
        };
        self.engine.take_status(&status, self.at);
        self.engine.supervise(self.at);
        self.engine.decide(self.at);
    }

    /// Time without samples.
    fn wait(&mut self, ms: u64) {
        self.at += Duration::from_millis(ms);
        self.engine.setup.way_back.confirm(self.operators, self.at);
    }

    /// Numbers of the commands that wait for their record, taken out.
    fn take_intents(&mut self) -> Vec<u64> {
        let number = |r: Report| if let Report::Intent { sequence, .. } = r { Some(sequence) } else { None };
        self.engine.backlog.drain(..).filter_map(number).collect()
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

/// A disk that is slower than samples may be old: the record counts for a later command of the same pitch.
#[test]
fn a_record_that_came_late_is_good_for_the_same_pitch() {
    let mut bench = bench();
    bench.feed(3.5, |_| {});
    bench.decide_in_act();
    let intent = |r: &Report| match r {
        Report::Intent { sequence, event } => event.pitch_difference_rad.map(|pitch| (*sequence, pitch)),
        _ => None,
    };
    let (number, pitch_rad) = bench.engine.backlog.iter().find_map(intent).unwrap();
    bench.wait(80);
    let facts = bench.engine.facts(bench.at);
    let acting = bench.engine.acting.as_mut().unwrap();
    let late = acting.recorded(number, &facts);
    assert!(matches!(late, Some(Outcome::Held(..))), "{late:?}");
    let move_to = |pitch_difference_rad| Command {
        kind: CommandKind::Move,
        pitch_difference_rad,
        ..Command::default()
    };
    assert!(!acting.needs_record(&move_to(pitch_rad + 0.5e-3)), "as it is on record");
    assert!(acting.needs_record(&move_to(pitch_rad + 5e-3)), "another pitch waits for its own");
}

/// The decision believes in limits that the monitor was not told of: nothing goes out, a person is called.
#[test]
fn a_decision_that_breaks_a_rule_is_not_sent_and_ends_acting() {
    let mut bench = bench();
    bench.feed(3.5, |_| {});
    let narrow = commissioned(&ServiceConfig::default(), [0, 1]);
    let narrow = Commissioned {
        axes: narrow.axes.map(|axis| CommissionedAxis { range_m: [-1e-6, 1e-6], ..axis }),
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

/// A controller may tell a refusal once, and that within the second after the command.
#[test]
fn a_refusal_told_once_right_after_the_command_is_heard() {
    let mut bench = bench();
    bench.feed(3.5, |_| {});
    bench.decide_in_act();
    assert_eq!(bench.intents(), 1);
    let sent_s = bench.engine.seconds(bench.at);
    bench.engine.acting.as_mut().unwrap().sent_at(sent_s);
    // Not in step with the second that is waited for.
    bench.feed(0.017, |_| {});
    bench.look_at(TURRET_REFUSED);
    for _ in 0..62 {
        bench.feed(0.017, |_| {});
        bench.look();
    }
    assert_eq!((bench.intents(), bench.hold()), (1, Some("turret_refused")));
}

/// An interlock that opens, or a turret that is not heard any more, ends acting; it never resumes by itself.
#[test]
fn a_condition_that_is_lost_ends_acting() {
    for (why, open) in [("interlock open", Some(1)), ("interlock unheard", None)] {
        let mut bench = bench();
        bench.feed(3.5, |_| {});
        bench.decide_in_act();
        assert_eq!(bench.engine.mode, Mode::Act);
        for _ in 0..11 {
            bench.feed(0.1, |_| {});
            if let Some(interlocks_open) = open {
                bench.hear(&TurretStatus {
                    interlocks_open,
                    state: TURRET_REACHED,
                    ..TurretStatus::default()
                });
            } else {
                bench.engine.supervise(bench.at);
                bench.engine.decide(bench.at);
            }
        }
        assert_eq!(bench.engine.mode, Mode::Observe, "{why}");
        assert!(bench.engine.fault.as_deref().unwrap().contains(why));
        for _ in 0..15 {
            bench.feed(0.1, |_| {});
            bench.look();
        }
        assert_eq!(bench.engine.mode, Mode::Observe, "{why}: it is heard and closed again");
    }
}

/// Nobody could take the turret back any more: acting ends with an alarm, and nobody raises it again.
#[test]
fn acting_ends_with_the_last_operators_token() {
    let mut bench = bench();
    let ports = Ports::open(&bench.engine.setup.domain).unwrap();
    bench.feed(3.5, |_| {});
    bench.decide_in_act();
    assert_eq!(bench.engine.mode, Mode::Act);
    bench.operators = false;
    bench.feed(0.1, |_| {});
    bench.look();
    assert_eq!(bench.engine.mode, Mode::Observe);
    assert_eq!(bench.told(EventKind::Fault), 1);
    assert!(bench.engine.fault.take().unwrap().contains("token"));
    let (done, mut answer) = tokio::sync::oneshot::channel();
    let revision = Some(bench.engine.mode_revision);
    bench.engine.obey(Control::SetMode { mode: Mode::Act, revision, origin: person(), done }, &ports);
    let refused = answer.try_recv().unwrap().unwrap_err().to_string();
    assert!(refused.contains("token"), "{refused}");
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
    bench.names = vec!["x1", "z1", "x2", "y2"];
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
    bench.wait(1500);
    bench.engine.supervise(bench.at);
    assert!(bench.engine.stream.is_none() && bench.engine.save.is_none());
    let job = bench.jobs.try_recv().expect("what there is was handed over");
    assert!(job.chunks.iter().map(|c| c.samples.len()).sum::<usize>() > 9000);
    // A stream that begins anew does the same.
    bench.feed(3.5, |_| {});
    bench.engine.save_around("manual", "test");
    bench.stream = 2;
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
    bench.wait(1500);
    let later = bench.at;
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

fn person() -> Origin {
    Origin { actor: "p".into(), role: "engineer".into(), reason: "test".into() }
}

/// In act, whatever comes but no usable sample: nothing is commanded, the silence is told within a second.
#[test]
fn samples_that_cannot_be_used_are_no_fresh_samples() {
    type Spoilt = (&'static str, fn(&mut ServoPoint));
    let spoilt: [Spoilt; 5] = [
        ("no number", |p| p.axes[0].current_ref_a = f64::NAN),
        ("not measured", |p| p.valid = 0),
        ("repeated", |p| p.sequence = 5),
        ("back in time", |p| p.t_ns = 5),
        ("infinite spindle", |p| p.spindle_speed_rpm = f64::INFINITY),
    ];
    for (kind, spoil) in spoilt {
        let mut bench = bench();
        bench.feed(3.5, |_| {});
        bench.engine.mode = Mode::Act;
        bench.engine.backlog.clear();
        bench.wait(60);
        bench.feed(0.01, spoil);
        bench.look();
        assert_eq!((bench.intents(), bench.hold()), (0, Some("stale_samples")), "{kind}");
        bench.feed(1.0, spoil);
        bench.look();
        assert_eq!(bench.told(EventKind::SourceLost), 1, "{kind}");
        assert_eq!((bench.intents(), bench.engine.mode), (0, Mode::Observe), "{kind}");
        assert!(bench.engine.fault.is_some(), "{kind}: a person must look");
    }
}

#[test]
fn one_spoilt_sample_spoils_the_window() {
    let mut bench = bench();
    bench.feed(3.5, |_| {});
    bench.feed(0.001, |p| p.axes[1].motor_angle_rad = f64::NAN);
    bench.feed(0.02, |_| {});
    bench.decide_in_act();
    assert_eq!((bench.intents(), bench.hold()), (0, Some("window_not_full")));
    // A second of good ones fills it again.
    bench.feed(1.01, |_| {});
    bench.look();
    assert_eq!((bench.intents(), bench.hold()), (1, None));
}

/// A turret that does not follow is a fault; once a person has cleared it, `act` starts from the beginning.
#[test]
fn a_cleared_fault_does_not_come_back_by_itself() {
    let mut bench = bench();
    let ports = Ports::open(&bench.engine.setup.domain).unwrap();
    bench.feed(3.5, |_| {});
    bench.engine.acting.as_mut().unwrap().open_port(&ports.who).unwrap();
    bench.engine.mode = Mode::Act;
    let second = |bench: &mut Bench| {
        bench.wait(999);
        bench.feed(0.002, |_| {});
        bench.look();
        // The record is there at once; the turret stays where it is.
        let intents = bench.take_intents();
        for sequence in &intents {
            let facts = bench.engine.facts(bench.at);
            let outcome = bench.engine.acting.as_mut().unwrap().recorded(*sequence, &facts);
            assert!(matches!(outcome, Some(super::acting::Outcome::Sent(_))), "{outcome:?}");
        }
        intents.len()
    };
    let sent: usize = (1..8).map(|_| second(&mut bench)).sum();
    assert!(sent >= 1);
    assert_eq!(bench.engine.fault.as_deref(), Some("stopped acting: turret not reached"));
    assert_eq!(bench.engine.mode, Mode::Observe);
    let (done, mut answer) = tokio::sync::oneshot::channel();
    bench.engine.obey(Control::ClearFault { origin: person(), done }, &ports);
    assert!(answer.try_recv().unwrap().is_ok() && bench.engine.fault.is_none());
    second(&mut bench);
    bench.engine.acting.as_mut().unwrap().open_port(&ports.who).unwrap();
    bench.engine.mode = Mode::Act;
    let sent: usize = (0..2).map(|_| second(&mut bench)).sum();
    assert_eq!((sent, bench.engine.fault.as_deref(), bench.engine.mode), (1, None, Mode::Act));
}

/// Invariant I10: a history that hangs stops new commands at once, ends acting after ten seconds, and is
/// never taken for a turret that is stuck.
#[test]
fn a_history_that_hangs_ends_acting_after_ten_seconds_and_for_that_reason() {
    let mut bench = bench();
    let ports = Ports::open(&bench.engine.setup.domain).unwrap();
    bench.feed(3.5, |_| {});
    bench.engine.acting.as_mut().unwrap().open_port(&ports.who).unwrap();
    bench.engine.mode = Mode::Act;
    bench.gauges.waiting.store(1, Ordering::Relaxed);
    let mut ended = None;
    for k in 1..120_u64 {
        bench.wait(99);
        bench.feed(0.001, |_| {});
        bench.look();
        if bench.engine.mode != Mode::Act && ended.is_none() {
            ended = Some(100 * k);
        }
        assert_eq!(bench.engine.fault, None, "after {} ms", 100 * k);
    }
    assert_eq!((bench.engine.mode, ended), (Mode::Advise, Some(10_100)));
    assert!(bench.engine.mode_reason.contains("history"), "{}", bench.engine.mode_reason);
    let held = |reason| Metrics::total(&bench.engine.setup.metrics.holds, &[reason]);
    assert!(held("store_not_writable") >= 8);
    assert_eq!(bench.intents(), 1, "the one from before it was noticed");
    assert_eq!(held("store_unavailable"), 1, "it did not go out");
    let metrics = &bench.engine.setup.metrics;
    assert_eq!(Metrics::total(&metrics.commands, &["sent"]), 0);
    // The disk is back: raised again, it commands.
    bench.gauges.waiting.store(0, Ordering::Relaxed);
    bench.engine.mode = Mode::Act;
    bench.engine.backlog.clear();
    bench.wait(2000);
    bench.feed(0.001, |_| {});
    bench.look();
    assert_eq!((bench.intents(), bench.hold()), (1, None));
}

#[test]
fn overrides_faults_and_ceased_samples_are_recorded() {
    for word in ["override", "fault", "source_lost"] {
        let mut bench = bench();
        bench.feed(0.5, |_| {});
        match word {
            "override" => bench.engine.take_back("anna"),
            "fault" => bench.engine.latch("test"),
            _ => {}
        }
        bench.wait(1500);
        bench.look();
        let saved = bench.jobs.try_recv().unwrap_or_else(|e| panic!("{word}: {e}"));
        assert!(saved.id.starts_with(word), "{}", saved.id);
    }
}

/// Who raises the mode, and from what, is judged where the mode is.
#[test]
fn only_the_revision_of_now_leads_up() {
    let mut bench = bench();
    let ports = Ports::open(&bench.engine.setup.domain).unwrap();
    bench.feed(3.5, |_| {});
    bench.look();
    let ask = |bench: &mut Bench, mode, revision| {
        let (done, mut answer) = tokio::sync::oneshot::channel();
        bench.engine.obey(Control::SetMode { mode, revision, origin: person(), done }, &ports);
        answer.try_recv().unwrap()
    };
    let seen = bench.engine.mode_revision;
    let up = ask(&mut bench, Mode::Act, Some(seen)).unwrap();
    assert_eq!((up.mode, up.revision), (Mode::Act, seen + 1));
    let (done, mut answer) = tokio::sync::oneshot::channel();
    bench.engine.obey(Control::Override { actor: "anna".into(), done }, &ports);
    assert_eq!(answer.try_recv().unwrap().unwrap().mode, Mode::Observe);
    // Pictures still show `act`: for them this is no way up.
    assert!(matches!(ask(&mut bench, Mode::Act, None), Err(Refusal::WayUp { .. })));
    assert!(matches!(ask(&mut bench, Mode::Act, Some(up.revision)), Err(Refusal::Revision { .. })));
    assert_eq!(bench.engine.mode, Mode::Observe);
    assert_eq!(ask(&mut bench, Mode::Observe, None).unwrap().mode, Mode::Observe, "down is always free");
}
