//! A cut that does not chatter: its margin, what is kept of it, and what the stated cut says.

use super::*;
use crate::plant::cutting::TwoDelay;
use crate::plant::scenario::RawScenario;
use crate::stability::rightmost_root;

/// A stable cut at equal pitch whose vibration dies out at less than 6 1/s.
fn nearly_unstable() -> Scenario {
    let thin = |width_m: f64| {
        let mut raw = RawScenario::default();
        raw.cutting.width_m = width_m;
        Scenario::new(&raw).unwrap()
    };
    let growth_1_s = |cut: &Scenario| rightmost_root(&TwoDelay::from_scenario(cut)).growth_1_s;
    (20..200).map(|k| thin(1e-6 * f64::from(k))).find(|cut| growth_1_s(cut) > -6.0).unwrap()
}

/// A cut that grows wherever that one dies out.
fn four_times_as_wide(cut: &Scenario) -> Scenario {
    let mut raw = cut.raw();
    raw.cutting.width_m *= 4.0;
    Scenario::new(&raw).unwrap()
}

/// Where that is commissioned the pitch of a silent cut moves when its margin, read from servo signals, runs
/// out.
#[test]
fn a_margin_that_runs_out_moves_the_pitch_before_chatter() {
    let near = nearly_unstable();
    let decided = |before_chatter: bool| {
        let mut config = config();
        (config.cut, config.tools) = (near, Some(("z1".into(), 0.0, false)));
        config.turret.before_chatter = before_chatter;
        let mut bench = bench_of(config);
        bench.lathe = Lathe::new(LatheSettings::realistic(near, 5));
        bench.names.push("z1");
        for tenth in 0..160 {
            bench.feed(0.1, |_| {});
            if tenth == 100 {
                bench.engine.mode = Mode::Act;
            }
            bench.look();
        }
        assert_eq!(bench.engine.mode, Mode::Act);
        let asked = bench.engine.backlog.iter().find_map(|r| match r {
            Report::Intent { event, .. } => event.pitch_difference_rad,
            _ => None,
        });
        (asked, bench.hold())
    };
    let (asked, hold) = decided(true);
    assert!(asked.is_some_and(|pitch_rad| pitch_rad.abs() > 0.002), "{asked:?} {hold:?}");
    assert_eq!(decided(false), (None, Some("no_chatter")));
}

/// What cannot be heard is no silence.
#[test]
fn a_force_that_is_deaf_in_the_band_says_nothing_of_the_cut() {
    for (method, told) in [("thrust", 0), ("medob", 1)] {
        let text = format!("[machine]\nmethod = \"{method}\"\n");
        let path = std::path::Path::new("c.toml");
        let mut config = crate::config::service::service_config_from_text(path, &text).unwrap();
        (config.cut, config.turret) = (four_times_as_wide(&nearly_unstable()), super::config().turret);
        let mut bench = bench_of(config);
        bench.lathe = Lathe::new(LatheSettings::realistic(nearly_unstable(), 5));
        for _ in 0..60 {
            bench.feed(0.1, |_| {});
            bench.look();
        }
        bench.feed(0.1, |point| point.spindle_speed_rpm *= 1.1);
        assert_eq!(bench.told(EventKind::CutMismatch), told, "{method}");
        let kept = bench.engine.backlog.iter().filter(|r| matches!(r, Report::Cut(_))).count();
        assert_eq!(kept, told, "{method}: no silent cut is kept of what is not heard");
    }
}

/// A stable cut goes into the history with the growth and the line of its least damped root, as its margin
/// was read from servo signals; a cut that is stated to chatter and is silent is told, once.
#[test]
fn a_silent_cut_is_kept_with_its_root_and_compared_with_the_stated_one() {
    let cut = nearly_unstable();
    let root = rightmost_root(&TwoDelay::from_scenario(&cut));
    let heard = |stated: Scenario| {
        let mut config = config();
        (config.cut, config.tools) = (stated, Some(("z1".into(), 0.0, false)));
        let mut bench = bench_of(config);
        bench.lathe = Lathe::new(LatheSettings::realistic(cut, 5));
        bench.names.push("z1");
        for _ in 0..140 {
            bench.feed(0.1, |_| {});
            bench.look();
        }
        // At another speed it is another cut.
        bench.feed(0.1, |point| point.spindle_speed_rpm *= 1.1);
        let kept = bench.engine.backlog.iter().find_map(|r| match r {
            Report::Cut(cut) => Some((**cut).clone()),
            _ => None,
        });
        (kept.expect("a cut"), bench.told(EventKind::CutMismatch))
    };
    let (kept, told) = heard(cut);
    assert_eq!((kept.outcome(), told), ("stable", 0));
    let [growth_1_s, error_1_s] = kept.growth_1_s.expect("a margin was read");
    // The turrets of the machine give way as well, so that its root is another by some 1/s.
    assert!((growth_1_s - root.growth_1_s).abs() < 10.0 && error_1_s < 5.0, "{kept:?} {root:?}");
    assert!((kept.line_hz.unwrap() - root.frequency_hz).abs() < 10.0, "{kept:?} {root:?}");
    let (kept, told) = heard(four_times_as_wide(&cut));
    assert_eq!((kept.outcome(), told), ("stable", 1));
}
