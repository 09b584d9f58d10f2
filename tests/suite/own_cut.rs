//! What `simulate` writes, `diagnose` reads: a cut of the program's own lathe, given to the diagnosis with
//! the scenario that made it, has nothing that the scenario leaves out.

use std::path::Path;
use std::process::Command;
use stillcut::recording::{read_recording, write_recording};

/// The example of the README, with what a case changes in it.
const SCENARIO: &str = "
[workpiece]
diameter_m = 0.0249
projection_length_m = 0.180
damping_ratio = 0.01
clamp_factor = 0.975
[cutting]
radial_stiffness_pa = 2500e6
width_m = 0.2e-3
feed_m_rev = 0.15e-3
process_damping_n = 60.0
[spindle]
speed_rpm = 1200.0
[tools]
count = 2
position_m = 0.180
travel_m_s = -3.0e-3
pitch_difference_rad = 0.0
";
const NOISE: [&str; 2] = ["--force-noise-ratio", "0.03"];
const FILTER: [&str; 4] = ["--force-bandwidth-hz", "1000", "--force-delay-s", "8.7e-4"];
const CALM: [&str; 2] = ["pitch_difference_rad = 0.0", "pitch_difference_rad = 0.1"];
const THIN: [&str; 2] = ["width_m = 0.2e-3", "width_m = 0.05e-3"];

/// The scenario with one line changed.
fn changed([from, to]: [&str; 2]) -> String {
    assert!(SCENARIO.contains(from), "{from}");
    SCENARIO.replace(from, to)
}

fn run(arguments: &[&str], folder: &Path) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stillcut"));
    let output = command.args(arguments).current_dir(folder).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
}

/// What a diagnosis with the scenario `stated` says of four seconds of a cut of `true_one`.
fn said(true_one: &str, stated: &str, options: &[&str], probe: bool) -> serde_json::Value {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("true.toml"), true_one).unwrap();
    std::fs::write(at("stated.toml"), stated).unwrap();
    let simulate = ["simulate", "--scenario", "true.toml", "--duration-s", "4", "--out", "cut.parquet"];
    run(&[&simulate[..], options].concat(), folder.path());
    if !probe {
        let mut recording = read_recording(&at("cut.parquet")).unwrap();
        recording.columns.retain(|c| c.name != "workpiece_displacement_m");
        write_recording(&at("cut.parquet"), &recording).unwrap();
    }
    let diagnose = ["diagnose", "--scenario", "stated.toml", "--recording", "cut.parquet", "--out", "said"];
    run(&diagnose, folder.path());
    serde_json::from_str(&std::fs::read_to_string(at("said/diagnosis.json")).unwrap()).unwrap()
}

fn says_nothing(scenario: &str, options: &[&str], probe: bool) -> serde_json::Value {
    let said = said(scenario, scenario, options, probe);
    let nothing = |key: &str| said[key].as_array().is_some_and(Vec::is_empty);
    let right =
        said["verdict"] == "model_adequate" && nothing("findings") && nothing("parameter_corrections");
    assert!(right, "{options:?} {scenario}: {} {}", said["verdict"], said["notes"]);
    said
}

/// Chatter from the first turn on, and calm cuts, with a probe and without, the force as it is and as a
/// signal shows it: the random force drives the bar in the same instant in which it is recorded.
#[test]
fn a_cut_of_the_own_lathe_hides_nothing() {
    says_nothing(SCENARIO, &NOISE, true);
    says_nothing(&changed(CALM), &NOISE, true);
    says_nothing(&changed(THIN), &[&NOISE[..], &FILTER, &["--seed", "2"]].concat(), true);
    says_nothing(&changed(CALM), &[&NOISE[..], &FILTER].concat(), false);
    says_nothing(&changed(["count = 2", "count = 1"]), &NOISE, true);
}

/// An ideal cut has no random force, by which vibration is judged: that is said, and nothing else.
#[test]
fn a_cut_without_a_random_force_is_not_judged_by_its_vibration() {
    for scenario in [SCENARIO.to_owned(), changed(CALM), changed(THIN)] {
        let said = says_nothing(&scenario, &[], true);
        let notes = said["notes"].as_array().unwrap();
        assert!(notes.iter().any(|n| n.as_str().unwrap().contains("no random force")), "{notes:?}");
    }
}

/// What the lathe has beyond the scenario is found in its cut, as late as it is.
#[test]
fn a_late_signal_of_the_own_lathe_is_found() {
    let late = "[[physics]]\neffect = \"force_sensor_lag\"\nport = \"force_sensor\"\nextra_delay_s = 5e-5\n";
    let calm = changed(CALM);
    let said = said(&format!("{calm}{late}"), &calm, &NOISE, true);
    let findings = said["findings"].as_array().unwrap();
    assert_eq!(findings.len(), 1, "{findings:?}");
    assert_eq!(findings[0]["effect"], "force_sensor_lag");
    let delay_s = findings[0]["parameters"]["extra_delay_s"]["value"].as_f64().unwrap();
    assert!((delay_s - 5e-5).abs() < 5e-6, "{delay_s}");
}

/// A pressure of a fifth of what is stated is no tolerance: the fit ends at the last value that a machine
/// has, and neither that value nor a law that was fitted beside it is an answer.
#[test]
fn a_number_beyond_every_machine_is_no_correction() {
    let [true_one, stated] = ["500e6", "2500e6"];
    let thin = changed(THIN);
    let said = said(&thin.replace(stated, true_one), &thin, &NOISE, true);
    assert_eq!(said["verdict"], "unexplained_mismatch", "{}", said["findings"]);
    let nothing = |key: &str| said[key].as_array().is_some_and(Vec::is_empty);
    assert!(nothing("findings") && nothing("parameter_corrections"), "{}", said["parameter_corrections"]);
}
