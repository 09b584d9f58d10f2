//! Measured cuts of others, asked as their publishers describe them: what they cannot decide is not asserted.
//!
//! No data set states a whole scenario; what none states is an engineer's estimate, written beside it. Which
//! channel is the radial force is often not told, so that each is asked. The table of `docs/results-cut.md` is
//! what these tests print:
//!
//! `cargo test --profile quick --test suite real_cuts -- --nocapture --test-threads 1`

use crate::folders::shared;
use std::path::{Path, PathBuf};
use stillcut::config::scenario::scenario_from_text;
use stillcut::diagnosis::Verdict;
use stillcut::diagnosis::cut::diagnose;
use stillcut::diagnosis::cut::input::{
    CutEvidence, CutInputError, CutOutcome, CutRecording, CutRow, CutTable, KnownOfCut,
};
use stillcut::diagnosis::cut::result::CutDiagnosis;
use stillcut::plant::cut_terms::CutCondition;
use stillcut::plant::effects::{EffectKind, Port};
use stillcut::plant::scenario::Scenario;
use stillcut::recording::{read_columns, read_cuts, read_recording};
use stillcut::sample::{Column, Recording};
use stillcut::stability::scenario_root;

/// One tool; stiffness, damping and pressure are estimates.
struct Stated {
    natural_hz: f64,
    stiffness_n_m: f64,
    pressure_pa: f64,
    width_m: f64,
    feed_m_rev: f64,
    speed_rpm: f64,
}

fn scenario(s: &Stated) -> Scenario {
    let text = format!(
        "[workpiece]\nnatural_frequency_hz = {}\nmodal_stiffness_n_m = {}\ndamping_ratio = 0.03\n\
         diameter_m = 0.05\n[cutting]\nradial_stiffness_pa = {}\nwidth_m = {}\nfeed_m_rev = {}\n\
         process_damping_n = 0.0\n[spindle]\nspeed_rpm = {}\n[tools]\ncount = 1\n",
        s.natural_hz, s.stiffness_n_m, s.pressure_pa, s.width_m, s.feed_m_rev, s.speed_rpm,
    );
    scenario_from_text(Path::new("real.toml"), &text).unwrap()
}

fn real(relative: &str) -> Option<PathBuf> {
    shared(&format!("recordings/{relative}"))
}

/// A recording of a cut from columns of another name.
fn cut(
    experiment: &str,
    columns: Vec<(&str, Vec<f64>)>,
    scenario: &Scenario,
) -> Result<CutRecording, CutInputError> {
    let column = |(name, values): (&str, Vec<f64>)| Column { name: name.to_owned(), values };
    let recording = Recording {
        sample_rate: stillcut::units::SampleRate::new(10_000.0).unwrap(),
        experiment: experiment.to_owned(),
        axes: vec!["tool1".to_owned()],
        columns: columns.into_iter().map(column).collect(),
        start_s: 0.0,
        metadata: Vec::new(),
    };
    CutRecording::new(&recording, scenario)
}

fn asked(
    name: &str,
    scenario: &Scenario,
    recordings: &[CutRecording],
    table: Option<&CutTable>,
) -> CutDiagnosis {
    let said = diagnose(scenario, CutEvidence { recordings, table }, 60.0, &|_, _| {}).unwrap();
    let found: Vec<&str> = said.findings.iter().map(|f| f.effect.name()).collect();
    let place = said.location.as_ref().map_or("-", |l| l.port.name());
    println!("| `{name}` | {:?} | {place} | {found:?} |", said.verdict);
    said.notes.iter().for_each(|n| println!("  {n}"));
    said
}

/// A column of a file that is no recording yet.
fn column(file: &Path, name: &str) -> Vec<f64> {
    read_columns(file).unwrap().into_iter().find(|(n, _)| n == name).unwrap().1
}

fn hidden(said: &CutDiagnosis, effect: EffectKind) -> bool {
    said.not_identifiable.iter().any(|n| n.effect == effect)
}

/// One cut at one speed, feed and width; which of x and y is radial is not told. Lines at 150 to 220 Hz are
/// of no bar whose one mode was stated, whichever it is; the angle comes of one pulse a turn, some missing.
#[test]
fn one_cut_with_unknown_dynamics_is_a_mismatch_without_a_name() {
    let Some(file) = real("turning_force/turning_feed0p416mm_rev_depth1mm.parquet") else { return };
    let stated = Stated {
        natural_hz: 207.0,
        stiffness_n_m: 1e7,
        pressure_pa: 700e6,
        width_m: 1e-3,
        feed_m_rev: 0.401e-3,
        speed_rpm: 1060.0,
    };
    let scenario = scenario(&stated);
    let tacho = column(&file, "tacho_raw");
    let pulses: Vec<usize> = (1..tacho.len()).filter(|k| tacho[k - 1] <= 30.0 && tacho[*k] > 30.0).collect();
    let (first, last) = (pulses[0], pulses[pulses.len() - 1]);
    let turns_of = |pair: &[usize]| ((pair[1] - pair[0]) as f64 / 560.0).round();
    let mut angle = Vec::new();
    for pair in pulses.windows(2) {
        let (from, step) =
            (angle.last().copied().unwrap_or(0.0), turns_of(pair) / (pair[1] - pair[0]) as f64);
        let own = (1..=pair[1] - pair[0]).map(|k| from + std::f64::consts::TAU * step * k as f64);
        angle.extend(own.collect::<Vec<f64>>());
    }
    for channel in ["force_x_n", "force_y_n"] {
        let force = column(&file, channel);
        // Air until 1 s, the cut until 5.1 s.
        let zero_n = force[..7000].iter().sum::<f64>() / 7000.0;
        let in_cut = |k: usize| if (10_500..50_500).contains(&k) { 1e-3 } else { 0.0 };
        let columns = vec![
            ("tool1_radial_force_n", force[first..last].iter().map(|f| f - zero_n).collect()),
            ("spindle_angle_rad", angle.clone()),
            ("spindle_speed_rpm", vec![1060.0; last - first]),
            ("feed_m_rev", vec![0.401e-3; last - first]),
            ("width_m", (first..last).map(in_cut).collect()),
        ];
        let cut = cut(channel, columns, &scenario).unwrap();
        let said = asked(&format!("turning_force, {channel}"), &scenario, &[cut], None);
        assert_eq!((said.verdict, said.findings.len()), (Verdict::UnexplainedMismatch, 0));
        let undecided = [EffectKind::EdgeForce, EffectKind::NoseRadius, EffectKind::SpeedDependentForce];
        assert!(undecided.into_iter().all(|e| hidden(&said, e)), "{:?}", said.not_identifiable);
    }
}

/// Three inputs, none of them named radial, with a line of 50 Hz that is as loud in the air as in the cut.
#[test]
fn hum_that_no_tool_exerts_is_told_at_the_sensor() {
    let Some(folder) = real("turning_chatter_force") else { return };
    // Feed and diameter are not published; frequency as in the other cuts of that course.
    let stated = Stated {
        natural_hz: 95.0,
        stiffness_n_m: 4e6,
        pressure_pa: 400e6,
        width_m: 5e-3,
        feed_m_rev: 0.05e-3,
        speed_rpm: 420.0,
    };
    let scenario = scenario(&stated);
    // Zero of each input in air.
    for (channel, zero_n) in [("a_force_n", 10.0), ("b_force_n", -10.0), ("c_force_n", -40.0)] {
        let mut cuts = Vec::new();
        for depth in [4, 5, 6] {
            for speed in [325, 420, 550] {
                let name = format!("{depth}mm_{speed}rpm");
                let force = column(&folder.join(format!("force_{name}.parquet")), channel);
                let columns = vec![
                    ("tool1_radial_force_n", force.iter().map(|f| f - zero_n).collect()),
                    ("spindle_speed_rpm", vec![f64::from(speed); force.len()]),
                    ("width_m", vec![1e-3 * f64::from(depth); force.len()]),
                ];
                cuts.push(cut(&name, columns, &scenario).unwrap());
            }
        }
        let said = asked(&format!("turning_chatter_force, {channel}"), &scenario, &cuts, None);
        assert_eq!((said.verdict, said.findings.len()), (Verdict::UnexplainedMismatch, 0));
        let location = said.location.unwrap();
        assert_eq!(location.port, Port::ForceSensor);
        assert!(location.bands_hz[0][0] < 50.5 && location.bands_hz[0][1] > 49.0, "{:?}", location.bands_hz);
    }
}

/// Two teeth that enter and leave pull the tool both ways: no force of one tool that stays in its cut.
#[test]
fn milling_is_no_turning() {
    let Some(folder) = real("milling_force_dynamometer") else { return };
    let stated = Stated {
        natural_hz: 900.0,
        stiffness_n_m: 1e7,
        pressure_pa: 1000e6,
        width_m: 3e-3,
        feed_m_rev: 0.075e-3,
        speed_rpm: 12_000.0,
    };
    let scenario = scenario(&stated);
    let mut cuts = Vec::new();
    for feed in [300, 900, 1200] {
        let file = folder.join(format!("slot_6000rpm_feed{feed}mm_min_depth3mm.parquet"));
        let force = column(&file, "force_y_n");
        // A tooth passes 12 000 times a minute; y pushes the work in the negative direction.
        let columns = vec![
            ("tool1_radial_force_n", force.iter().map(|f| -f).collect()),
            ("spindle_speed_rpm", vec![12_000.0; force.len()]),
            ("feed_m_rev", vec![f64::from(feed) * 1e-3 / 12_000.0; force.len()]),
            ("width_m", vec![3e-3; force.len()]),
        ];
        cuts.push(cut(&format!("feed{feed}"), columns, &scenario).unwrap());
    }
    let said = asked("milling_force_dynamometer", &scenario, &cuts, None);
    assert_eq!((said.verdict, said.findings.len()), (Verdict::UnexplainedMismatch, 0));
}

/// Seven means of one cut each: the exponent that the publishers fit is one candidate, the edge another; that
/// one of them is there, seven numbers without a spread do not carry.
#[test]
fn seven_mean_forces_assert_nothing() {
    let Some(file) = real("turning_mean_force/cuts.csv") else { return };
    let stated = Stated {
        natural_hz: 207.0,
        stiffness_n_m: 1e7,
        pressure_pa: 1000e6,
        width_m: 1e-3,
        feed_m_rev: 0.104e-3,
        speed_rpm: 1080.0,
    };
    let table = read_cuts(&file).unwrap();
    let said = asked("turning_mean_force", &scenario(&stated), &[], Some(&table));
    assert!(said.findings.is_empty() && said.verdict == Verdict::ModelAdequate);
    let candidates: Vec<EffectKind> = said.tried.iter().filter_map(|t| t.effect).take(2).collect();
    assert!(candidates.contains(&EffectKind::NonlinearCuttingForce), "{candidates:?}");
    assert!(candidates.contains(&EffectKind::EdgeForce), "{candidates:?}");
    assert!(said.plan[0].feed_m_rev > 0.1e-3, "a plan with another feed: {:?}", said.plan);
    assert!(hidden(&said, EffectKind::ProcessDamping) && hidden(&said, EffectKind::ModeDrift));
}

/// Acceleration without unit is no force: refused by name. As a table, three outcomes assert nothing.
#[test]
fn a_boring_bar_without_force_is_refused_and_three_outcomes_are_no_proof() {
    let Some(file) = real("boring_bar_chatter/bar_c_770_005.parquet") else { return };
    let stated = Stated {
        natural_hz: 500.0,
        stiffness_n_m: 1e6,
        pressure_pa: 1000e6,
        width_m: 0.127e-3,
        feed_m_rev: 0.0508e-3,
        speed_rpm: 770.0,
    };
    let scenario = scenario(&stated);
    let recording = read_recording(&file).unwrap();
    let refused = CutRecording::new(&recording, &scenario).unwrap_err().to_string();
    assert!(refused.contains("tool1_radial_force_n") && refused.contains("bar_accel_raw"), "{refused}");
    let row = |(cut, speed_rpm, width_m, outcome): (&str, f64, f64, Option<CutOutcome>)| CutRow {
        cut: cut.to_owned(),
        spindle_speed_rpm: speed_rpm,
        width_m,
        outcome,
        outcome_word: outcome.map_or("unknown", CutOutcome::name).to_owned(),
        known: KnownOfCut { feed_m_rev: Some(0.0508e-3), ..KnownOfCut::default() },
    };
    let cuts = [
        ("s_320_030", 320.0, 0.762e-3, Some(CutOutcome::Stable)),
        ("s_320_040", 320.0, 1.016e-3, Some(CutOutcome::Stable)),
        ("c_770_005", 770.0, 0.127e-3, Some(CutOutcome::Chatter)),
        ("u_570_005", 570.0, 0.127e-3, None),
    ];
    let table = CutTable { rows: cuts.map(row).to_vec(), ignored_columns: Vec::new() };
    let said = asked("boring_bar_chatter", &scenario, &[], Some(&table));
    assert!(said.findings.is_empty(), "{:?}", said.findings);
}

/// A row of the thesis: speed, feed and width of table 6-2.
fn thesis_row(cut: &str, width_m: f64, pitch_rad: f64, chatters: bool) -> CutRow {
    let outcome = if chatters { CutOutcome::Chatter } else { CutOutcome::Stable };
    CutRow {
        cut: cut.to_owned(),
        spindle_speed_rpm: 1200.0,
        width_m,
        outcome: Some(outcome),
        outcome_word: outcome.name().to_owned(),
        known: KnownOfCut {
            feed_m_rev: Some(0.15e-3),
            pitch_difference_rad: Some(pitch_rad),
            ..KnownOfCut::default()
        },
    }
}

/// Thesis, table 6-2: 0.2 mm chatters, 0.3 mm does not. The plain model cannot have both: candidates are
/// ranked, a cut that would tell is named, and two rows prove none of them.
#[test]
fn deeper_and_stable_ranks_candidates_and_proves_none() {
    let text = "[workpiece]\ndiameter_m = 0.025\nprojection_length_m = 0.13\n[tools]\nposition_m = 0.13\n";
    let scenario = scenario_from_text(Path::new("thesis.toml"), text).unwrap();
    let rows = vec![thesis_row("0.2 mm", 0.2e-3, 0.0, true), thesis_row("0.3 mm", 0.3e-3, 0.0, false)];
    let table = CutTable { rows, ignored_columns: Vec::new() };
    let said = asked("thesis, table 6-2", &scenario, &[], Some(&table));
    let ranked: Vec<String> = said
        .tried
        .iter()
        .map(|t| format!("{} {:.1}", t.effect.map_or("none", EffectKind::name), t.evidence_nats))
        .collect();
    println!("  {ranked:?}");
    assert!(said.findings.is_empty() && said.verdict == Verdict::ModelAdequate, "{:?}", said.verdict);
    assert_eq!(said.table.map(|t| (t.heldout_right_after, t.heldout_cuts)), Some((1, 2)));
    let candidates: Vec<EffectKind> = said.tried.iter().filter_map(|t| t.effect).collect();
    assert!(candidates.len() >= 5 && candidates[0] == EffectKind::NonlinearCuttingForce, "{candidates:?}");
    assert!(!said.plan.is_empty() && said.parameter_corrections.is_empty());
}

/// Lines that hop by 40 Hz and a pitch that heals are no missing physics: the plain model with two tools has
/// both (two turns a lobe; 652, 612, 572 Hz; 0.8 to 1.1 pi). What it has not, 0.7 and 1.2 pi, asserts nothing.
#[test]
fn hopping_lines_and_a_pitch_that_heals_are_in_the_plain_model() {
    let scenario = Scenario::default();
    let at = |position_m: f64| CutCondition { position_m, ..CutCondition::of(&scenario) };
    let mut lines: Vec<f64> = Vec::new();
    for step in 0..=60 {
        let line_hz = scenario_root(&scenario, &at(0.18 - 0.001 * f64::from(step))).frequency_hz;
        if lines.last().is_none_or(|last| (last - line_hz).abs() > 20.0) {
            lines.push(line_hz);
        }
    }
    println!("  lines from the end of the bar on: {lines:.0?}");
    for (line, thesis) in lines.iter().zip([652.0, 612.0, 572.0]) {
        assert!((line - thesis).abs() < 5.0, "{lines:?}");
    }
    let row = |(tenths_pi, chatters): (f64, bool)| {
        let pitch_rad = 0.1 * tenths_pi * std::f64::consts::PI * 20.0 / 652.0;
        thesis_row(&format!("{tenths_pi} tenths of pi"), 0.2e-3, pitch_rad, chatters)
    };
    let outcomes = [0.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0].map(|p| (p, !(6.5..11.5).contains(&p)));
    let table = CutTable { rows: outcomes.map(row).to_vec(), ignored_columns: Vec::new() };
    let said = asked("thesis, pitch", &scenario, &[], Some(&table));
    assert!(said.findings.is_empty(), "{:?}", said.findings);
    let right = said.rows.iter().zip(&table.rows);
    let right = right
        .filter(|(fit, row)| {
            (fit.before.chatter_probability > 0.5) == (row.outcome == Some(CutOutcome::Chatter))
        })
        .count();
    assert_eq!(right, 7);
}
