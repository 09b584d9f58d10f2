//! The chatter monitor on made-up streams whose truth is known by construction.

use crate::pipeline::settings;
use stillcut::chatter::{Band, ChatterEvent, ChatterMonitor, ChatterSettings, FALSE_ALARM_S, MeanForce};
use stillcut::force::motion::ForceEstimate;
use stillcut::force::validity::Validity;
use stillcut::pipeline::{AxisPlan, CutConditions, Pipeline, PipelineSettings};
use stillcut::plant::scenario::Scenario;
use stillcut::units::SampleRate;

const RATE_HZ: f64 = 9000.0;
const TURN_HZ: f64 = 20.0;

/// Noise of unit variance from a fixed seed.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        let mut sum = 0.0;
        for _ in 0..12 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sum += (self.0 >> 11) as f64 / (1u64 << 53) as f64;
        }
        sum - 6.0
    }
}

/// Onsets and ends over 12 s: noise, a cut that begins at 1 s with strong spindle orders, and `more`.
fn listen(more: impl Fn(f64) -> f64) -> Vec<(f64, ChatterEvent)> {
    listen_from(0.0, more)
}

/// The same, heard from `start_s` on.
fn listen_from(start_s: f64, more: impl Fn(f64) -> f64) -> Vec<(f64, ChatterEvent)> {
    let cut = |t: f64| (80.0 + orders(t)) * ((t - 1.0) * TURN_HZ).clamp(0.0, 1.0);
    hear(start_s, MeanForce::Whole, |t| cut(t) + more(t))
}

/// What is said of a force under noise; `mean`: what its mean tells.
fn hear(start_s: f64, mean: MeanForce, force: impl Fn(f64) -> f64) -> Vec<(f64, ChatterEvent)> {
    hear_at(60.0 * TURN_HZ, (start_s, mean), force)
}

/// The same where the speed is told as `speed_rpm`.
fn hear_at(
    speed_rpm: f64,
    (start_s, mean): (f64, MeanForce),
    force: impl Fn(f64) -> f64,
) -> Vec<(f64, ChatterEvent)> {
    let settings = ChatterSettings {
        sample_rate: SampleRate::new(RATE_HZ).unwrap(),
        band: Band::new(500.0, 750.0).unwrap(),
        mean,
        false_alarm_s: FALSE_ALARM_S,
    };
    let monitor = ChatterMonitor::new(settings).unwrap();
    let mut state = monitor.start();
    let mut noise = Noise(1);
    let mut found = Vec::new();
    for n in (start_s * RATE_HZ) as u32..(12.0 * RATE_HZ) as u32 {
        let t = f64::from(n) / RATE_HZ;
        let event = monitor.step(&mut state, force(t) + 2.0 * noise.next(), Some(speed_rpm));
        if let Some(event @ (ChatterEvent::Onset(_) | ChatterEvent::End)) = event {
            found.push((t, event));
        }
    }
    found
}

fn orders(t: f64) -> f64 {
    [29.0, 32.0, 33.0].iter().map(|o| 6.0 * (std::f64::consts::TAU * o * TURN_HZ * t).cos()).sum()
}

fn line(t: f64, frequency_hz: f64) -> f64 {
    (std::f64::consts::TAU * frequency_hz * t).sin()
}

#[test]
fn a_growing_line_is_heard_early_and_its_end_too() {
    // From 0.05 N at 5 s, 30 1/s, to 40 N; cut off at 9 s.
    let chatter = |t: f64| {
        if (5.0..9.0).contains(&t) {
            (0.05 * (30.0 * (t - 5.0)).exp()).min(40.0) * line(t, 651.3)
        } else {
            0.0
        }
    };
    let found = listen(chatter);
    let [(onset_s, ChatterEvent::Onset(heard)), (end_s, ChatterEvent::End)] = found[..] else {
        panic!("{found:?}")
    };
    // The line reaches the noise of 25 Hz around it, 0.15 N rms, some 50 ms after its start.
    assert!(onset_s > 5.0 && onset_s < 5.22, "{onset_s}");
    assert!((heard.frequency_hz - 651.3).abs() < 3.0 && heard.growth_1_s > 5.0);
    assert!(end_s > 9.0 && end_s < 9.4, "{end_s}");
}

/// Grown chatter on two lobes that beat, near the mean force: it scatters as noise does and is none.
#[test]
fn two_lobes_that_beat_go_on_as_one_alarm() {
    let beat = |t: f64| {
        let grown = |from_s: f64| (0.05 * (30.0 * (t - from_s)).exp()).min(50.0);
        let other = if t > 5.5 { grown(5.5) * line(t, 647.9) } else { 0.0 };
        if (5.0..10.0).contains(&t) { grown(5.0) * line(t, 651.3) + other } else { 0.0 }
    };
    let found = listen(beat);
    let [(onset_s, ChatterEvent::Onset(_)), (end_s, ChatterEvent::End)] = found[..] else {
        panic!("{found:?}")
    };
    assert!((5.0..5.3).contains(&onset_s) && (10.0..10.6).contains(&end_s), "{onset_s} {end_s}");
}

/// A fault of a sensor for one sample rings in every filter.
#[test]
fn one_wild_sample_is_no_chatter() {
    for wild_n in [500.0, -3e3, 1e30] {
        for at in [1.22, 1.4, 3.0] {
            let n = (at * RATE_HZ) as u32;
            let found = listen(|t| if (t * RATE_HZ).round() as u32 == n { wild_n } else { 0.0 });
            assert!(found.is_empty(), "{wild_n} N at {at} s: {found:?}");
        }
    }
}

/// Growth as told at the onset, for exponentials that a turn or more shows.
#[test]
fn the_growth_is_told_within_a_factor_of_two() {
    for growth_1_s in [15.0, 25.0, 35.0] {
        let chatter = |t: f64| {
            let grown = |t: f64| (0.05 * (growth_1_s * (t - 4.0)).exp()).min(40.0);
            if t > 4.0 { grown(t) * line(t, 651.3) } else { 0.0 }
        };
        let found = listen(chatter);
        let Some((_, ChatterEvent::Onset(heard))) = found.first() else { panic!("{found:?}") };
        let ratio = heard.growth_1_s / growth_1_s;
        assert!((0.5..2.0).contains(&ratio), "{growth_1_s} told as {}", heard.growth_1_s);
    }
}

/// Which way the spindle turns is nothing to the orders; a speed that no spindle cuts at tells nothing.
#[test]
fn a_speed_of_either_sign_or_none_that_can_be_is_borne() {
    let chatter = |t: f64| {
        let grown = (0.05 * (30.0 * (t - 5.0)).exp()).min(40.0);
        if (5.0..9.0).contains(&t) { grown * line(t, 651.3) } else { 0.0 }
    };
    let cut = |t: f64, orders_n: f64| (80.0 + orders_n) * ((t - 1.0) * TURN_HZ).clamp(0.0, 1.0);
    let forward = listen(chatter);
    let backward = hear_at(-60.0 * TURN_HZ, (0.0, MeanForce::Whole), |t| cut(t, orders(t)) + chatter(t));
    assert_eq!(forward, backward);
    for speed_rpm in [0.0, 1e-3, 2.0, 5.0, 60.0] {
        let found = hear_at(speed_rpm, (0.0, MeanForce::Whole), |t| cut(t, 0.0) + chatter(t));
        let [(onset_s, ChatterEvent::Onset(_)), (_, ChatterEvent::End)] = found[..] else {
            panic!("{speed_rpm} rpm: {found:?}")
        };
        assert!((5.0..5.3).contains(&onset_s), "{speed_rpm} rpm: {onset_s}");
    }
}

#[test]
fn orders_hits_bursts_and_known_lines_are_not_chatter() {
    let hits = |t: f64| {
        // A struck bar every 0.7 s, ringing down with 35 1/s; a constant foreign line from the start.
        let since = (t - 3.0).rem_euclid(0.7);
        let ring = if t > 3.0 { 60.0 * (-35.0 * since).exp() * line(since, 633.0) } else { 0.0 };
        ring + 2.0 * line(t, 703.0)
    };
    let found = listen(hits);
    assert!(found.is_empty(), "{found:?}");
    let mut noise = Noise(7);
    let burst = (0..(12.0 * RATE_HZ) as usize).map(|_| noise.next()).collect::<Vec<f64>>();
    let found = listen(|t| if (6.0..6.4).contains(&t) { 15.0 * burst[(t * RATE_HZ) as usize] } else { 0.0 });
    assert!(found.is_empty(), "{found:?}");
}

/// No noise was heard before it, and all that is heard is it.
#[test]
fn chatter_that_is_there_from_the_first_sample_is_heard() {
    let found = listen_from(5.0, |t| 30.0 * line(t, 651.3));
    let [(onset_s, ChatterEvent::Onset(heard))] = found[..] else { panic!("{found:?}") };
    assert!(onset_s < 5.8, "{onset_s}");
    assert!((heard.frequency_hz - 651.3).abs() < 1.0, "{heard:?}");
    // It goes on to be followed: its end is told too.
    let found = listen_from(5.0, |t| if t < 9.0 { 30.0 * line(t, 651.3) } else { 0.0 });
    let [(_, ChatterEvent::Onset(_)), (end_s, ChatterEvent::End)] = found[..] else { panic!("{found:?}") };
    assert!(end_s > 9.0 && end_s < 9.4, "{end_s}");
    // A foreign line of a small share of the force, and a bar that rings down, are something else.
    assert!(listen_from(5.0, |t| 3.0 * line(t, 651.3)).is_empty());
    assert!(listen_from(5.0, |t| 60.0 * (-12.0 * (t - 5.0)).exp() * line(t, 651.3)).is_empty());
}

/// What an entry strikes swells over the first turns and rings down at 9 1/s.
#[test]
fn what_the_first_turns_of_a_stable_cut_leave_is_not_chatter() {
    for start_s in [0.0, 0.5, 0.7, 0.9] {
        for most_n in [4.0, 8.0] {
            let swell =
                |u: f64| most_n * (1.0 - (-15.0 * u.min(0.15)).exp()) * (-9.0 * (u - 0.15).max(0.0)).exp();
            let found = listen_from(start_s, |t| if t > 1.0 { swell(t - 1.0) * line(t, 651.3) } else { 0.0 });
            assert!(found.is_empty(), "from {start_s} s, {most_n} N: {found:?}");
        }
    }
}

/// The recording begins with the cut, and it chatters from the first turn: what is learned then is not it.
#[test]
fn chatter_that_grows_before_any_noise_is_known_is_heard() {
    for (growth_1_s, most_n, from_s) in
        [(15.0, 17.0, 0.95), (30.0, 27.0, 0.7), (30.0, 5.0, 0.6), (8.0, 17.0, 0.8)]
    {
        let grown = |t: f64| (0.3 * (growth_1_s * (t - 1.05)).exp()).min(most_n);
        let found = listen_from(from_s, |t| if t > 1.05 { grown(t) * line(t, 651.3) } else { 0.0 });
        let [(onset_s, ChatterEvent::Onset(heard))] = found[..] else { panic!("{growth_1_s} {found:?}") };
        // 2 N is what rises above the orders that are not known yet.
        let loud_s = 1.05 + (2.0f64 / 0.3).ln() / growth_1_s;
        assert!((0.0..0.3).contains(&(onset_s - loud_s)), "{growth_1_s} {onset_s} {loud_s}");
        assert!((heard.frequency_hz - 651.3).abs() < 3.0, "{growth_1_s} {heard:?}");
    }
}

/// A finishing pass after a deep one: its force is within the noise, so nothing tells of its entry.
#[test]
fn chatter_in_a_cut_too_shallow_to_be_seen_is_heard() {
    let mean = |t: f64| match t {
        1.0..4.0 => 100.0 * ((t - 1.0) * TURN_HZ).min(1.0),
        6.0.. => 3.0 * ((t - 6.0) * 2.0).min(1.0),
        _ => 0.0,
    };
    for growth_1_s in [10.0, 20.0] {
        let grown = |t: f64| if t > 8.0 { (0.05 * (growth_1_s * (t - 8.0)).exp()).min(5.0) } else { 0.0 };
        let found = hear(0.0, MeanForce::Whole, |t| mean(t) + grown(t) * line(t, 651.3));
        let [(onset_s, ChatterEvent::Onset(heard))] = found[..] else { panic!("{growth_1_s} {found:?}") };
        let loud_s = 8.0 + (5.0f64 / 0.05).ln() / growth_1_s;
        assert!((8.0..loud_s + 0.3).contains(&onset_s), "{onset_s} {loud_s}");
        assert!((heard.frequency_hz - 651.3).abs() < 3.0, "{heard:?}");
    }
}

/// After a cut in which the tools were seen a tone of another machine is switched on.
#[test]
fn a_tone_in_air_after_a_cut_is_no_chatter() {
    let mean = |t: f64| if (1.0..4.0).contains(&t) { 100.0 * ((t - 1.0) * TURN_HZ).min(1.0) } else { 0.0 };
    for kind in [MeanForce::Whole, MeanForce::OverAir] {
        for most_n in [0.5, 1.0, 4.0] {
            let tone = |t: f64| most_n * ((t - 8.0) / 0.005).clamp(0.0, 1.0) * line(t, 651.3);
            let found = hear(0.0, kind, |t| mean(t) + tone(t));
            assert!(found.is_empty(), "{kind:?} {most_n} N: {found:?}");
        }
    }
}

/// A tool only pushes: where it does not, a line is not its.
#[test]
fn a_line_without_a_cutting_force_is_not_chatter() {
    let grown = |t: f64| 4.0 * (20.0 * (t - 4.0)).exp().min(1.0) * line(t, 651.3);
    let tone = |t: f64| if t > 4.0 { 4.0 * line(t, 651.3) } else { 0.0 };
    assert!(hear(0.0, MeanForce::Whole, tone).is_empty() && hear(0.0, MeanForce::Whole, grown).is_empty());
    // The zero drifts by as much as the noise.
    assert!(hear(0.0, MeanForce::Whole, |t| 1.5 * line(t, 0.3) + tone(t)).is_empty());
    // Of an acceleration nothing of the kind is known.
    assert_eq!(hear(0.0, MeanForce::Absent, grown).len(), 1);
    // And in the cut it is one.
    assert_eq!(listen(grown).len(), 1);
}

/// A tool that pushes and never pulls leaves the cut where a line is as large as its force: no tone does that.
#[test]
fn a_line_for_which_the_tool_leaves_the_cut_is_chatter_however_it_began() {
    let of = |size_n: f64| {
        let whole = move |t: f64| (80.0 + size_n * line(t, 651.3)).max(0.0) - 80.0;
        listen(move |t| if t > 4.0 { whole(t) } else { 0.0 })
    };
    assert!(of(40.0).is_empty());
    let found = of(110.0);
    assert!(matches!(found[..], [(4.3..5.5, ChatterEvent::Onset(_))]), "{found:?}");
}

/// A pump or a fan is there at once; chatter grows, faster or slower, and may stand then.
#[test]
fn a_tone_that_is_switched_on_in_the_cut_is_not_chatter() {
    for (size_n, hz) in [(8.0, 651.3), (12.0, 615.0), (20.0, 703.0)] {
        let made = |growth_1_s: f64| {
            let size = move |t: f64| if t > 4.0 { 1.0 } else { (growth_1_s * (t - 4.0)).exp() };
            move |t: f64| size_n * size(t) * line(t, hz)
        };
        for growth_1_s in [5.0, 15.0, 40.0, 80.0] {
            let found = listen(made(growth_1_s));
            assert!(matches!(found[..], [(_, ChatterEvent::Onset(_))]), "{size_n} {growth_1_s} {found:?}");
        }
        let found = listen(made(1e4));
        assert!(found.is_empty(), "{size_n} {found:?}");
    }
}

/// What is struck rings at its own rate, from whatever place in the windows on.
#[test]
fn rings_of_any_rate_are_not_chatter() {
    for (k, ring_1_s) in [8.0, 12.0, 15.0, 17.0, 25.0, 35.0].into_iter().enumerate() {
        let ring = |t: f64| {
            let ago_s = (t - 4.0 - 0.011 * k as f64).rem_euclid(1.3);
            if t > 4.1 { 12.0 * (-ring_1_s * ago_s).exp() * line(ago_s, 640.0) } else { 0.0 }
        };
        let found = listen(ring);
        assert!(found.is_empty(), "{ring_1_s} {found:?}");
    }
}

/// A cut that shakes a lightly damped mode, 15 1/s, a thousand times louder than what was heard before.
#[test]
fn a_mode_that_noise_excites_is_told_by_its_scatter() {
    let mut noise = Noise(11);
    let (w, fade) = (std::f64::consts::TAU * 648.0 / RATE_HZ, (-15.0 / RATE_HZ).exp());
    let mut before = [0.0; 2];
    let mode: Vec<f64> = (0..(12.0 * RATE_HZ) as usize)
        .map(|_| {
            let now = 2.0 * fade * w.cos() * before[0] - fade * fade * before[1] + 0.5 * noise.next();
            before = [now, before[0]];
            now
        })
        .collect();
    let found = listen(|t| if t > 4.0 { mode[(t * RATE_HZ) as usize] } else { 0.0 });
    let mut alarm_s = 0.0;
    for (t, event) in &found {
        alarm_s += if matches!(event, ChatterEvent::End) { *t } else { -*t };
    }
    assert!(found.len() <= 2 && (0.0..1.5).contains(&alarm_s), "{alarm_s} {found:?}");
}

/// Orders between which a short window sees a line: over a turn they repeat, however fast they change.
#[test]
fn orders_that_fade_or_step_are_not_chatter() {
    let step = |t: f64, from_s: f64, lasts_s: f64| {
        let u = ((t - from_s) / lasts_s).clamp(0.0, 1.0);
        u * u * (3.0 - 2.0 * u)
    };
    let strong = |t: f64| orders(t) + 12.0 * line(t, 30.0 * TURN_HZ) + 9.0 * line(t, 31.0 * TURN_HZ + 0.01);
    for lasts_s in [0.15, 0.2, 0.3, 0.5] {
        // The tools leave.
        let found = listen(|t| {
            let left = 1.0 - step(t, 9.0, lasts_s);
            strong(t) * step(t, 1.0, 0.05) * left - (80.0 + orders(t)) * (1.0 - left)
        });
        assert!(found.is_empty(), "{lasts_s} {found:?}");
        // A workpiece that begins to run out.
        let found = listen(|t| strong(t) * step(t, 6.0, lasts_s));
        assert!(found.is_empty(), "{lasts_s} {found:?}");
    }
}

/// An encoder line that goes with the feed, through the band or into it, and chatter beside it.
#[test]
fn a_line_that_sweeps_is_not_chatter_and_hides_none() {
    let sweep = |t: f64, rate_hz_s: f64, stops_s: f64| {
        let (since, beyond) = ((t - 2.0).clamp(0.0, stops_s), (t - 2.0 - stops_s).max(0.0));
        let turns = 430.0 * (t - 2.0) + rate_hz_s * (0.5 * since * since + stops_s * beyond);
        3.0 * (std::f64::consts::TAU * turns).sin()
    };
    for (rate_hz_s, stops_s) in [(40.0, 9.0), (80.0, 5.0), (200.0, 1.0), (150.0, 1.6), (70.0, 4.6)] {
        let found = listen(|t| sweep(t, rate_hz_s, stops_s));
        assert!(found.is_empty(), "{rate_hz_s} {found:?}");
        let grows = |t: f64| if t > 8.0 { (0.05 * (20.0 * (t - 8.0)).exp()).min(15.0) } else { 0.0 };
        let found = listen(|t| sweep(t, rate_hz_s, stops_s) + grows(t) * line(t, 611.3));
        let [(onset_s, ChatterEvent::Onset(heard)), ..] = found[..] else { panic!("{rate_hz_s} {found:?}") };
        assert!((8.0..8.35).contains(&onset_s), "{rate_hz_s} {onset_s}");
        assert!((heard.frequency_hz - 611.3).abs() < 3.0, "{rate_hz_s} {heard:?}");
    }
}

/// An encoder line comes into the band with a step of the feed and rests there: it has come too far.
#[test]
fn a_weak_line_that_came_from_elsewhere_and_rests_is_not_chatter() {
    let line = |t: f64| {
        let (since, beyond) = ((t - 6.0).clamp(0.0, 0.25), (t - 6.25).max(0.0));
        let turns = 455.0 * (t - 6.0) + 150.0 * (0.5 * since * since + 0.25 * beyond);
        if t > 5.95 { 1.2 * (std::f64::consts::TAU * turns).sin() } else { 0.0 }
    };
    assert!(listen(line).is_empty(), "{:?}", listen(line));
}

/// Between two orders it moves as they do: no line that sweeps by itself.
/// Orders that no window tells apart are no way that a line has come.
#[test]
fn chatter_between_close_orders_is_heard() {
    let (turn_hz, first, last) = (11.0, 40, 80);
    let comb =
        |t: f64| (first..last).map(|j| line(t + f64::from(j * j), turn_hz * f64::from(j))).sum::<f64>();
    for order in [47.45, 52.45, 60.4] {
        let grown = |t: f64| (0.05 * (8.0 * (t - 5.0)).exp()).min(8.0) * line(t, order * turn_hz);
        let force = |t: f64| {
            let cut = ((t - 1.0) * turn_hz).clamp(0.0, 1.0);
            cut * (40.0 + comb(t)) + if t > 5.0 { grown(t) } else { 0.0 }
        };
        let found = hear_at(60.0 * turn_hz, (0.0, MeanForce::Whole), force);
        let [(onset_s, ChatterEvent::Onset(_))] = found[..] else { panic!("{order}: {found:?}") };
        assert!((5.0..5.8).contains(&onset_s), "{order}: {found:?}");
    }
}

/// However loud it is.
#[test]
fn a_force_beside_the_band_is_no_chatter() {
    for frequency_hz in [380.0, 860.0, 900.0] {
        let cut = |t: f64| ((t - 1.0) * TURN_HZ).clamp(0.0, 1.0);
        let found = hear(0.0, MeanForce::Whole, |t| cut(t) * (19.0 + 12.0 * line(t, frequency_hz + 0.37)));
        assert!(found.is_empty(), "{frequency_hz}: {found:?}");
    }
}

/// Its band rings on and the noise was not learned meanwhile.
#[test]
fn what_is_left_after_an_alarm_is_no_new_one() {
    let chatter = |t: f64| match t {
        3.0..7.0 => (0.05 * (30.0 * (t - 3.0)).exp()).min(30.0) * line(t, 651.3),
        7.0..12.0 => {
            (30.0 * (-20.0 * (t - 7.0)).exp() * line(t, 651.3))
                + 1.5 * line(t, 560.0) * (1.0 - (-9.0 * (t - 7.0)).exp())
        }
        _ => 0.0,
    };
    let found = hear(0.0, MeanForce::Whole, |t| 40.0 * ((t - 1.0) * TURN_HZ).clamp(0.0, 1.0) + chatter(t));
    let soon = found.iter().filter(|(t, e)| matches!(e, ChatterEvent::Onset(_)) && (7.0..8.5).contains(t));
    assert!(soon.count() == 0, "{found:?}");
}

#[test]
fn chatter_that_goes_with_the_speed_is_heard() {
    let band = Band::new(500.0, 750.0).unwrap();
    let settings = ChatterSettings {
        sample_rate: SampleRate::new(RATE_HZ).unwrap(),
        band,
        mean: MeanForce::Whole,
        false_alarm_s: FALSE_ALARM_S,
    };
    let monitor = ChatterMonitor::new(settings).unwrap();
    for order in [36.4, 37.6] {
        let (mut state, mut noise, mut turns, mut onset_s) = (monitor.start(), Noise(3), 0.0, None);
        for n in 0..(7.0 * RATE_HZ) as u32 {
            let t = f64::from(n) / RATE_HZ;
            // From 14 to 20 turns a second in two seconds: a line at order 37 moves by 110 Hz/s.
            let turn_hz = 14.0 + 3.0 * (t - 4.0).clamp(0.0, 2.0);
            turns += turn_hz / RATE_HZ;
            let grown = if t > 4.6 { (0.05 * (15.0 * (t - 4.6)).exp()).min(40.0) } else { 0.0 };
            let force_n = 80.0 * (t - 1.0).clamp(0.0, 1.0)
                + 3.0 * (std::f64::consts::TAU * 40.0 * turns).cos()
                + grown * (std::f64::consts::TAU * order * turns).sin()
                + noise.next();
            let event = monitor.step(&mut state, force_n, Some(60.0 * turn_hz));
            if let (None, Some(ChatterEvent::Onset(_))) = (onset_s, event) {
                onset_s = Some(t);
            }
        }
        assert!(onset_s.is_some_and(|t| (4.65..5.2).contains(&t)), "{order} {onset_s:?}");
    }
}

#[test]
fn the_monitor_repeats_itself() {
    let chatter = |t: f64| if t > 5.0 { 10.0 * line(t, 611.0) } else { 0.0 };
    assert_eq!(listen(chatter), listen(chatter));
}

/// A window hears what was: chatter that goes with the spindle's speed is told for now.
#[test]
fn the_frequency_is_that_of_now_while_the_speed_changes() {
    for rpm_s in [-40.0, 0.0, 40.0] {
        let settings = ChatterSettings {
            sample_rate: SampleRate::new(RATE_HZ).unwrap(),
            band: Band::new(500.0, 800.0).unwrap(),
            mean: MeanForce::Whole,
            false_alarm_s: FALSE_ALARM_S,
        };
        let monitor = ChatterMonitor::new(settings).unwrap();
        let (mut state, mut noise, mut turns) = (monitor.start(), Noise(3), 0.0);
        let mut errors_hz = Vec::new();
        for n in 0..(9.0 * RATE_HZ) as u32 {
            let t = f64::from(n) / RATE_HZ;
            let speed_hz = TURN_HZ + rpm_s / 60.0 * (t - 4.0).max(0.0);
            turns += speed_hz / RATE_HZ;
            let order = |o: f64| (std::f64::consts::TAU * o * turns).sin();
            let chatter =
                if t > 5.0 { (0.05 * (30.0 * (t - 5.0)).exp()).min(40.0) * order(32.4) } else { 0.0 };
            let cut = if t > 1.0 { 80.0 + 6.0 * order(29.0) + 6.0 * order(33.0) } else { 0.0 };
            monitor.step(&mut state, cut + chatter + 2.0 * noise.next(), Some(60.0 * speed_hz));
            if t > 5.8 {
                let told = monitor.output(&state).frequency_hz;
                errors_hz.push((told.expect("it is heard") - 32.4 * speed_hz).abs());
            }
        }
        errors_hz.sort_by(f64::total_cmp);
        let [median_hz, most_hz] = [errors_hz[errors_hz.len() / 2], errors_hz[errors_hz.len() - 1]];
        println!("{rpm_s} rpm/s: median {median_hz:.2}, most {most_hz:.2} Hz");
        assert!(median_hz < 0.4 && most_hz < 1.0, "{rpm_s} rpm/s: {median_hz} {most_hz}");
    }
}

/// Tones of 30 ms rise, which seem to grow, where two tools half a turn apart damp (63 half turns of the
/// spindle) and where they feed: how many alarm in a recorded force of 5 to 60 N.
#[test]
fn a_stated_pitch_tells_tones_where_none_is_reported() {
    let alarms = |line_hz: f64, stated_pitch_rad: Option<f64>, reported: Option<f64>| -> usize {
        let of = |seed: u64, most_n: f64| {
            let stated = settings(&Scenario::default());
            let axis = AxisPlan { force: None, ..stated.axes[1].clone() };
            let plan =
                PipelineSettings { stated_pitch_rad, axes: vec![axis], mean: MeanForce::Whole, ..stated };
            let mut pipeline = Pipeline::new(plan).unwrap();
            let mut noise = Noise(seed);
            let conditions = CutConditions {
                spindle_speed_rpm: Some(1200.0),
                pitch_difference_rad: reported,
                ..CutConditions::default()
            };
            (0..36_000).any(|n| {
                let t_s = f64::from(n) / 9000.0;
                let size_n = 1.5 * ((t_s - 3.0) / 0.03).clamp(0.0, 1.0);
                let mean_n = if t_s > 0.5 { most_n } else { 0.0 };
                let force_n = mean_n + size_n * line(t_s, line_hz) + 2.0 * noise.next();
                let force = ForceEstimate { force_n, flags: Validity::VALID };
                let output = pipeline.step_estimates(t_s, &[force], &conditions);
                matches!(output.event, Some((_, ChatterEvent::Onset(_))))
            })
        };
        [5.0, 8.0, 12.0, 20.0, 60.0]
            .map(|most_n| (1..13).filter(|seed| of(*seed, most_n)).count())
            .iter()
            .sum()
    };
    let damped = [(None, None), (Some(0.0), None), (None, Some(0.0))].map(|(s, r)| alarms(630.0, s, r));
    let fed = [None, Some(0.0)].map(|stated| alarms(650.0, stated, None));
    // 14 of 60 against 29, and 37 against 30.
    assert!(damped[1] == damped[2] && damped[0] > damped[1], "{damped:?}");
    assert!(fed[1] > fed[0], "{fed:?}");
}
