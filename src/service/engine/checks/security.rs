//! Ways to act on what is not known: each is closed, with its reason.

use super::*;

fn ask_for_act(bench: &mut Bench) -> Result<(), String> {
    let ports = Ports::open(&bench.engine.setup.domain).unwrap();
    let (done, mut answer) = tokio::sync::oneshot::channel();
    let revision = Some(bench.engine.mode_revision);
    let control = Control::SetMode { mode: Mode::Act, revision, origin: person(), done };
    bench.engine.obey(control, &ports);
    answer.try_recv().unwrap().map(|_| ()).map_err(|e| e.to_string())
}

/// Samples that come and cannot be used are none: `act` is not begun on them.
#[test]
fn acting_does_not_begin_on_samples_that_cannot_be_used() {
    let mut bench = bench();
    bench.feed(0.2, |_| {});
    bench.look();
    let early = ask_for_act(&mut bench).unwrap_err();
    assert!(early.contains("heard_now (x1: its noise is being learned)"), "{early}");
    assert_eq!(bench.engine.mode, Mode::Observe);
    bench.feed(3.3, |_| {});
    bench.look();
    assert_eq!(ask_for_act(&mut bench), Ok(()));
    bench.engine.take_back("anna");
    for _ in 0..12 {
        bench.feed(0.1, |p| p.axes[0].current_ref_a = f64::NAN);
        bench.look();
    }
    let refused = ask_for_act(&mut bench).unwrap_err();
    assert!(refused.contains("cannot be used"), "{refused}");
    assert_eq!(bench.engine.mode, Mode::Observe);
    bench.feed(0.1, |_| {});
    bench.look();
    assert_eq!(ask_for_act(&mut bench), Ok(()), "good ones come again");
}

/// A method that is right nowhere in the band where the bar can chatter hears it by no number: not acted on
/// unless somebody who knows the machine accepts it by name.
#[test]
fn acting_does_not_begin_on_a_force_that_is_deaf_in_the_band() {
    for (method, deaf) in [("thrust", true), ("dob", true), ("medob", false)] {
        for accepted in [false, true] {
            let text = format!("[machine]\nmethod = \"{method}\"\n");
            let path = std::path::Path::new("c.toml");
            let mut config = crate::config::service::service_config_from_text(path, &text).unwrap();
            config.turret = super::config().turret;
            if accepted {
                config.turret.accept.push("force_above_band".into());
            }
            let mut bench = bench_of(config);
            bench.feed(3.5, |_| {});
            bench.look();
            let refused = ask_for_act(&mut bench).err().unwrap_or_default();
            assert_eq!(refused.contains("force_above_band"), deaf && !accepted, "{method}: {refused}");
        }
    }
}

/// A report that is said again and again, or that is of another stream, does not keep an interlock closed.
#[test]
fn a_report_that_is_repeated_or_of_another_machine_is_silence() {
    for (stream, grows) in [(1, false), (2, true)] {
        let mut bench = bench();
        bench.feed(3.5, |_| {});
        bench.decide_in_act();
        assert_eq!((bench.intents(), bench.engine.mode), (1, Mode::Act));
        let mut sequence = bench.reports;
        for _ in 0..25 {
            bench.feed(0.06, |_| {});
            sequence += u64::from(grows);
            let state = TURRET_REACHED;
            let report = TurretStatus { stream, sequence, axis_count: 4, state, ..TurretStatus::default() };
            bench.engine.take_status(&report, bench.at);
            bench.engine.supervise(bench.at);
            bench.engine.decide(bench.at);
        }
        assert_ne!(bench.engine.interlocks_open, 0, "unheard is open");
        assert_eq!(bench.engine.mode, Mode::Observe, "and acting has ended");
        assert!(bench.engine.fault.is_some());
    }
}

/// The next batch of the same stream.
fn next_batch(bench: &mut Bench) -> ServoBatch {
    let mut batch =
        ServoBatch { stream: 1, sample_rate_hz: 9000.0, sample_count: 9, ..ServoBatch::default() };
    batch.axis_count = AXES.len() as u32;
    for (to, name) in batch.axis_names.iter_mut().zip(AXES) {
        *to = axis_name_bytes(name);
    }
    for point in batch.points.iter_mut().take(9) {
        *point = ServoPoint::from_sample(&bench.lathe.step(), u64::MAX, AXES.len());
    }
    batch
}

/// One batch that is wrong as a whole is counted by its name, is no loss, and nothing begins anew: what does
/// not say how many samples it holds, and a head that no stream can have.
#[test]
fn a_wrong_batch_has_its_own_name_and_spoils_no_other() {
    type Wrong = (&'static str, fn(&mut ServoBatch));
    let wrongs: [Wrong; 10] = [
        ("bad_count", |b| b.sample_count = 0),
        ("bad_count", |b| b.sample_count = 33),
        ("bad_count", |b| b.sample_count = u32::MAX),
        ("bad_layout", |b| b.sample_rate_hz = f64::NAN),
        ("bad_layout", |b| b.sample_rate_hz = 1e9),
        ("bad_layout", |b| b.sample_rate_hz = 1.0),
        ("bad_layout", |b| b.sample_rate_hz = 4500.0),
        ("bad_layout", |b| b.axis_names.swap(0, 1)),
        ("bad_layout", |b| b.axis_count = 77),
        ("bad_layout", |b| (b.axis_count, b.sample_count) = (0, 0)),
    ];
    for (name, wrong) in wrongs {
        let mut bench = bench();
        bench.feed(0.5, |_| {});
        bench.engine.mode = Mode::Act;
        let mut batch = next_batch(&mut bench);
        wrong(&mut batch);
        bench.engine.take_batch(&batch, bench.at);
        bench.feed(0.1, |_| {});
        let metrics = &bench.engine.setup.metrics;
        assert_eq!(Metrics::total(&metrics.samples_lost, &["x1"]), 0);
        assert!(Metrics::total(&metrics.samples_rejected, &["all", name]) >= 1, "{name}");
        assert!(bench.engine.stream.as_ref().unwrap().totals.samples > 5000, "it is the same stream");
        assert_eq!(bench.engine.mode, Mode::Act);
        bench.engine.backlog.clear();
        bench.engine.supervise(bench.at);
        assert_eq!((bench.told(EventKind::DataGap), bench.told(EventKind::DataRejected)), (0, 1), "{name}");
        let times = bench.engine.backlog.iter().filter_map(|r| match r {
            Report::Event(e) => e.t_s,
            _ => None,
        });
        assert!(
            times.clone().all(|t| t < 1.0),
            "a time that nobody believes: {:?}",
            times.collect::<Vec<_>>()
        );
    }
}

/// Other axes under the number of a stream that speaks are wrong batches; of one that has ceased they are a
/// machine that came back.
#[test]
fn a_producer_that_keeps_its_number_is_heard_when_its_stream_is_silent() {
    let mut bench = bench();
    bench.feed(0.5, |_| {});
    bench.names = vec!["x1", "z1", "x2", "y2"];
    let axes = |bench: &Bench| bench.engine.stream.as_ref().map(|s| s.axes().to_vec());
    bench.feed(0.5, |_| {});
    assert_eq!(axes(&bench).unwrap(), AXES);
    bench.feed(0.6, |_| {});
    bench.engine.supervise(bench.at);
    assert_eq!(bench.told(EventKind::SourceLost), 1);
    bench.feed(0.1, |_| {});
    assert_eq!(axes(&bench).unwrap(), bench.names);
}
