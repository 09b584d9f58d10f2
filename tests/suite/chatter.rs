//! The chatter monitor on made-up streams whose truth is known by construction.

use stillcut::chatter::{Band, ChatterEvent, ChatterMonitor, ChatterSettings};
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
    let settings = ChatterSettings {
        sample_rate: SampleRate::new(RATE_HZ).unwrap(),
        band: Band::new(500.0, 750.0).unwrap(),
    };
    let monitor = ChatterMonitor::new(settings).unwrap();
    let mut state = monitor.start();
    let mut noise = Noise(1);
    let mut found = Vec::new();
    for n in (start_s * RATE_HZ) as u32..(12.0 * RATE_HZ) as u32 {
        let t = f64::from(n) / RATE_HZ;
        let engaged = ((t - 1.0) * TURN_HZ).clamp(0.0, 1.0);
        let orders: f64 =
            [29.0, 32.0, 33.0].iter().map(|o| 6.0 * (std::f64::consts::TAU * o * TURN_HZ * t).cos()).sum();
        let force_n = 80.0 * engaged + orders * engaged + 2.0 * noise.next() + more(t);
        let event = monitor.step(&mut state, force_n, Some(60.0 * TURN_HZ));
        if let Some(event @ (ChatterEvent::Onset(_) | ChatterEvent::End)) = event {
            found.push((t, event));
        }
    }
    found
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

#[test]
fn the_monitor_repeats_itself() {
    let chatter = |t: f64| if t > 5.0 { 10.0 * line(t, 611.0) } else { 0.0 };
    assert_eq!(listen(chatter), listen(chatter));
}
