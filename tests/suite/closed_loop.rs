//! The loop closed in one process: chatter is heard, the turret moves, the chatter dies; in `observe` it lives.

use super::passes::onsets;
use super::pipeline::settings;
use stillcut::avoidance::{CommandKind, Mode};
use stillcut::plant::cutting::RawCutting;
use stillcut::plant::scenario::{RawScenario, Scenario};
use stillcut::simulation::closed_loop::{ClosedLoop, LoopEvent};
use stillcut::simulation::lathe::LatheSettings;

/// Radial vibration force on tool 1 about its mean, N2, over a stretch of time.
fn power_n2(cut: &mut ClosedLoop, seconds: f64, log: &mut Vec<(f64, LoopEvent)>) -> f64 {
    let until = cut.lathe().truth().t_s + seconds;
    let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
    while cut.lathe().truth().t_s < until {
        if let Some(event) = cut.step() {
            log.push((cut.lathe().truth().t_s, event));
        }
        let force = cut.lathe().truth().radial_force_n[0];
        sum += force;
        squares += force * force;
        count += 1.0;
    }
    squares / count - (sum / count) * (sum / count)
}

fn cut(mode: Mode) -> ClosedLoop {
    // A blunt limit: chatter grows large before the flank holds it.
    let limits = RawCutting {
        clearance_rad: 5.0_f64.to_radians(),
        flank_force_n: 1500.0,
        tangential_ratio: 1.5,
        ..RawCutting::default()
    };
    let raw = RawScenario { cutting: limits, travel_m_s: -3.0e-3, ..RawScenario::default() };
    let scenario = Scenario::new(&raw).unwrap();
    ClosedLoop::new(LatheSettings::realistic(scenario, 11), settings(&scenario), mode).unwrap()
}

#[test]
fn chatter_is_heard_and_silenced() {
    let mut cut = cut(Mode::Act);
    let mut log = Vec::new();
    power_n2(&mut cut, 2.5, &mut log);
    let loud = power_n2(&mut cut, 0.5, &mut log);
    power_n2(&mut cut, 5.0, &mut log);
    let quiet = power_n2(&mut cut, 6.0, &mut log);
    for (t, event) in &log {
        println!("{t:.3} s {event:?}");
    }
    println!("power {loud:.1} N2, then {quiet:.4} N2: {:.1} dB", 10.0 * (loud / quiet).log10());
    // What is left is the random part of the force, 3 % of some 40 N, and the bar that it shakes.
    assert!(loud / quiet > 50.0 && quiet < 2.0, "{loud} N2 became {quiet} N2");
    let moves = log.iter().filter(|(_, e)| matches!(e, LoopEvent::Sent(c) if c.kind == CommandKind::Move));
    assert!((1..=2).contains(&moves.count()));
    assert!(!log.iter().any(|(_, e)| matches!(e, LoopEvent::Refused)));
    let last_onset = log.iter().rev().find(|(_, e)| matches!(e, LoopEvent::Onset(_))).unwrap().0;
    assert!(last_onset < 6.0, "chatter came back at {last_onset} s");
}

#[test]
fn in_observe_nothing_moves_and_it_chatters_on() {
    let mut cut = cut(Mode::Observe);
    let mut log = Vec::new();
    power_n2(&mut cut, 2.5, &mut log);
    let early = power_n2(&mut cut, 0.5, &mut log);
    power_n2(&mut cut, 3.0, &mut log);
    let late = power_n2(&mut cut, 1.0, &mut log);
    assert!(!log.iter().any(|(_, e)| matches!(e, LoopEvent::Sent(_))));
    assert!(late > 0.2 * early, "{early} N2, then {late} N2");
    assert_eq!(cut.lathe().turret().offset_cmd_m(), [0.0, 0.0]);
}

/// The tools leave at the chuck, the axes slide back over the steps of their encoders, the tools enter again.
#[test]
fn neither_the_end_of_a_pass_nor_the_next_entry_is_chatter() {
    let onsets = onsets(2, 30.0);
    assert!(onsets.len() == 1 && onsets[0] < 4.0, "{onsets:?}");
}
