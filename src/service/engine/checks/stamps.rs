//! Numbers and times of samples that cannot be: refused by name, without harm to those that can.

use super::*;

/// What is wrong with a sample.
type Spoil = fn(&mut ServoPoint);

/// A millisecond of samples, the first of them spoilt.
fn feed_one_spoilt(bench: &mut Bench, spoil: Spoil) {
    let once = std::cell::Cell::new(true);
    bench.feed(0.001, |p| {
        if once.replace(false) {
            spoil(p);
        }
    });
}

/// In act: one sample with an impossible number or time is one sample less, and neither a loss nor silence.
#[test]
fn one_wild_stamp_is_one_sample_less() {
    let wild: [Spoil; 6] = [
        |p| (p.sequence, p.t_ns) = (1_000_000_000, 111_111_111_111_111),
        |p| p.sequence = 1_000_000_000,
        |p| p.sequence = u64::MAX,
        |p| p.sequence = 0,
        |p| p.t_ns = 9_000_000_000_000_000_000,
        |p| p.t_ns = 0,
    ];
    for spoil in wild {
        let mut bench = bench();
        bench.feed(3.5, |_| {});
        feed_one_spoilt(&mut bench, spoil);
        bench.feed(1.1, |_| {});
        let totals = bench.engine.stream.as_ref().unwrap().totals;
        assert_eq!((totals.lost, totals.rejected), (0, 1));
        let metrics = &bench.engine.setup.metrics;
        let counted = |axis, reason| Metrics::total(&metrics.samples_rejected, &[axis, reason]);
        assert_eq!(counted("all", "implausible_stamp") + counted("x1", "out_of_order"), 1);
        assert_eq!(Metrics::total(&metrics.samples_lost, &["x1"]), 0);
        let newest = bench.engine.stream.as_ref().unwrap().newest.unwrap();
        assert!(newest.t_ns < 10_000_000_000 && newest.t_ns > 4_000_000_000);
        bench.decide_in_act();
        assert_eq!((bench.intents(), bench.hold()), (1, None), "it acts on");
        assert_eq!(bench.told(EventKind::InvariantViolation), 0);
    }
}

/// One sample with a value that no machine has is one sample less; one that a machine might have is over in
/// the seconds that a filter remembers it.
#[test]
fn one_wild_value_is_one_sample_less() {
    let wild: [(Spoil, u64); 5] = [
        (|p| p.axes[1].stage_position_m = 1e300, 1),
        (|p| p.axes[0].current_ref_a = -1e14, 1),
        (|p| p.spindle_angle_rad = f64::MAX, 1),
        (|p| p.axes[1].stage_position_m = 1e6, 0),
        (|p| p.axes[0].current_ref_a = -1e12, 0),
    ];
    for (k, (spoil, refused)) in wild.into_iter().enumerate() {
        let mut bench = bench();
        bench.feed(3.5, |_| {});
        feed_one_spoilt(&mut bench, spoil);
        bench.feed(if refused > 0 { 1.1 } else { 6.0 }, |_| {});
        let totals = bench.engine.stream.as_ref().unwrap().totals;
        // A sample that is refused is missing between those beside it.
        assert_eq!((totals.lost, totals.rejected), (0, refused), "{k}");
        bench.decide_in_act();
        assert_eq!((bench.intents(), bench.hold()), (1, None), "{k}: it acts on");
    }
}

/// A counter that leaps ahead while time goes on is heard again within 50 ms: nothing was lost.
#[test]
fn a_counter_that_leaps_is_no_loss() {
    let mut bench = bench();
    bench.feed(3.5, |_| {});
    bench.feed(0.5, |p| p.sequence += 1); // one was left out, and the time tells it late
    bench.feed(1.5, |p| p.sequence += 1_000_000_000);
    let totals = bench.engine.stream.as_ref().unwrap().totals;
    assert_eq!((totals.samples, totals.rejected, totals.lost), (49_276, 224, 1));
}

/// A producer whose counter starts again without a new stream is heard again within 50 ms, as a new stream.
#[test]
fn a_counter_that_starts_again_begins_a_new_stream() {
    let mut bench = bench();
    bench.feed(3.5, |_| {});
    bench.engine.mode = Mode::Act;
    bench.engine.backlog.clear();
    bench.feed(0.05, |p| {
        p.sequence -= 30_000;
        p.t_ns -= 3_000_000_000;
    });
    let stream = bench.engine.stream.as_ref().expect("it is heard again");
    assert!(stream.totals.samples > 0 && stream.totals.lost == 0);
    assert_eq!(bench.engine.mode, Mode::Observe, "nothing acts on from another time");
    assert_eq!(bench.told(EventKind::DataRejected), 1);
    let metrics = &bench.engine.setup.metrics;
    let refused = |axis, reason| Metrics::total(&metrics.samples_rejected, &[axis, reason]);
    let refused = refused("all", "implausible_stamp") + refused("x1", "duplicate");
    let (sent, taken) = (31_500 + 450, Metrics::total(&metrics.samples, &["x1"]));
    assert_eq!(taken + refused, sent, "each sample is taken or refused by name");
}

/// A producer that counts to the end of its numbers is refused from there on, and does no harm.
#[test]
fn the_last_number_there_is_ends_no_thread() {
    let mut bench = bench();
    bench.feed(0.1, |_| {});
    bench.feed(0.01, |p| p.sequence = u64::MAX);
    assert!(bench.engine.stream.as_ref().unwrap().totals.rejected > 80);
}
