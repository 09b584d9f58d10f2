//! The generator of concealed cuts against the linear cut: they share no equation, and must agree.

use nalgebra::Complex;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::Path;
use stillcut::config::scenario::scenario_from_text;
use stillcut::diagnosis::Verdict;
use stillcut::diagnosis::cut::diagnose;
use stillcut::diagnosis::cut::input::{CutEvidence, CutRecording};
use stillcut::diagnosis::cut::result::CutDiagnosis;
use stillcut::plant::cut_loop::CutLoop;
use stillcut::plant::cut_terms::{ChipMemory, CutCondition, CutTerms};
use stillcut::plant::effects::Port;
use stillcut::plant::scenario::Scenario;
use stillcut::report::cut_files::{CutFiles, to_json};
use stillcut::simulation::concealed_cut::{
    CUT_EFFECTS, ConcealedMachine, CutCaseSpec, Moment, conceal_cut, growth_1_s,
};
use stillcut::stability::{rightmost_cut_root, scenario_root};

/// What the linear cut does not hold whole: it varies over a turn or with time, is the structure itself or lies
/// in the signal.
const NOT_LINEAR: [&str; 8] = [
    "regenerative_effect",
    "runout/eccentricity",
    "runout/ovality",
    "runout/offset",
    "mode_drift",
    "spindle_speed_variation",
    "stock_variation",
    "force_sensor_lag",
];

fn concealed(effect: &str, seed: u64) -> ConcealedMachine {
    let spec = CutCaseSpec { effects: vec![effect.to_owned()], depth: 1.0, seed, probe: false };
    ConcealedMachine::draw(&Scenario::default(), &spec).unwrap()
}

/// The scenario that states all of the truth.
fn whole_truth(case: &ConcealedMachine) -> Scenario {
    let t = &case.truth;
    let mut text = format!(
        "[workpiece]\ndiameter_m = {}\nprojection_length_m = {}\nelastic_modulus_pa = {}\ndensity_kg_m3 = {}\n\
         damping_ratio = {}\nclamp_factor = {}\n[cutting]\nradial_stiffness_pa = {}\nwidth_m = {}\n\
         feed_m_rev = {}\nprocess_damping_n = {}\ntangential_ratio = {}\n[spindle]\nspeed_rpm = {}\n\
         [tools]\nposition_m = {}\n",
        t.diameter_m,
        t.length_m,
        t.modulus_pa,
        t.density_kg_m3,
        t.damping_ratio,
        t.clamp_factor,
        t.pressure_pa,
        t.width_m,
        t.feed_m_rev,
        t.flank_damping_n,
        t.tangential_ratio,
        t.speed_rpm,
        t.position_m,
    );
    for hidden in case.hidden.iter().filter(|h| h.name != "process_damping") {
        let (effect, port) = (hidden.name.split('/').next().unwrap(), hidden.port.name());
        writeln!(text, "[[physics]]\neffect = \"{effect}\"\nport = \"{port}\"").unwrap();
        for (name, value) in &hidden.parameters {
            writeln!(text, "{name} = {value}").unwrap();
        }
    }
    scenario_from_text(Path::new("truth.toml"), &text).unwrap()
}

#[test]
fn a_tap_on_a_concealed_machine_grows_as_the_linear_cut_says() {
    let linear: Vec<&str> = CUT_EFFECTS.into_iter().filter(|e| !NOT_LINEAR.contains(e)).collect();
    assert_eq!(linear.len(), 15);
    for (k, effect) in linear.into_iter().enumerate() {
        let case = concealed(effect, 40 + k as u64);
        let (t, scenario) = (&case.truth, whole_truth(&case));
        for (speed, width, place, pitch_rad) in [(1.0, 1.0, 1.0, 0.0), (1.15, 0.8, 0.85, 0.06)] {
            let at = Moment {
                t_s: 0.0,
                speed_rpm: speed * t.speed_rpm,
                feed_m_rev: t.feed_m_rev,
                width_m: width * t.width_m,
                position_m: place * t.position_m,
                pitch_rad,
            };
            let stated = CutCondition {
                speed_rpm: at.speed_rpm,
                width_m: at.width_m,
                position_m: at.position_m,
                pitch_difference_rad: pitch_rad,
                ..CutCondition::of(&scenario)
            };
            let (found, root) = (growth_1_s(t, &at), scenario_root(&scenario, &stated).growth_1_s);
            // A quarter of a second after the tap the next root may still beat with the first.
            let off = (found - root).abs();
            assert!(off < 3.0, "{effect}: cut {found:.2} 1/s, root {root:.2} 1/s");
        }
    }
}

/// A force that overshoots a change of its chip by g and forgets within tau is, at a root, a force
/// 1 + g s tau/(1 + s tau) of the law: larger, and early or late.
#[test]
fn a_force_that_overshoots_grows_as_one_that_remembers() {
    for seed in [51, 52, 53] {
        let case = concealed("unknown/chip_memory", seed);
        let (t, hidden) = (&case.truth, case.truth.hidden);
        let mut stated = case.clone();
        stated.hidden.clear();
        let scenario = whole_truth(&stated);
        let mut terms = CutTerms::of(&scenario, &CutCondition::of(&scenario));
        let mut root = rightmost_cut_root(&CutLoop::new(&terms));
        let without = root.growth_1_s;
        for _ in 0..20 {
            let s_tau = Complex::new(root.growth_1_s, TAU * root.frequency_hz) * hidden.fading_s;
            let over = s_tau / (s_tau + 1.0) * hidden.overshoot + 1.0;
            let late_s = -over.arg() / (TAU * root.frequency_hz);
            terms.memory = ChipMemory { gain: over.norm() * (root.growth_1_s * late_s).exp() - 1.0, late_s };
            root = rightmost_cut_root(&CutLoop::new(&terms));
        }
        let at = Moment {
            t_s: 0.0,
            speed_rpm: t.speed_rpm,
            feed_m_rev: t.feed_m_rev,
            width_m: t.width_m,
            position_m: t.position_m,
            pitch_rad: 0.0,
        };
        let found = growth_1_s(t, &at);
        let (off, moved) = ((found - root.growth_1_s).abs(), (without - root.growth_1_s).abs());
        assert!(off < 3.0 && moved > 2.0 * off, "{seed}: {found:.2}, {root:?}, without {without:.2}");
    }
}

/// The scenario and the recordings of a shop, and the verdict with the names of the findings.
fn diagnosed(effects: &[&str], seed: u64) -> (Verdict, Vec<String>) {
    let said = whole_answer(effects, seed);
    (said.verdict, said.findings.iter().map(|f| f.effect.name().to_owned()).collect())
}

fn whole_answer(effects: &[&str], seed: u64) -> CutDiagnosis {
    answer_of(effects, seed, usize::MAX)
}

/// The answer to the first `most` recordings.
fn answer_of(effects: &[&str], seed: u64, most: usize) -> CutDiagnosis {
    answer_within(effects, seed, most, 60.0)
}

fn answer_within(effects: &[&str], seed: u64, most: usize, budget_s: f64) -> CutDiagnosis {
    let effects = effects.iter().map(|name| (*name).to_owned()).collect();
    let spec = CutCaseSpec { effects, depth: 1.0, seed, probe: false };
    let case = conceal_cut(&Scenario::default(), &spec).unwrap();
    let shown = case.recordings.iter().take(most);
    let recordings: Vec<CutRecording> =
        shown.map(|r| CutRecording::new(r, &case.scenario).unwrap()).collect();
    let evidence = CutEvidence { recordings: &recordings, table: None };
    diagnose(&case.scenario, evidence, budget_s, &|_, _| {}).unwrap()
}

/// What a budget does not reach is told: hypotheses that were not asked, and stretches that were not held out.
#[test]
fn a_budget_that_ends_before_the_proof_says_so() {
    let [said, again] = [(); 2].map(|()| answer_within(&["process_damping"], 21, usize::MAX, 1.0));
    assert!(said.proof.is_none(), "{:?}", said.proof);
    for part in ["Not asked: ", "held against stretches"] {
        assert!(said.notes.iter().any(|n| n.contains(part)), "{part}: {:?}", said.notes);
    }
    assert_eq!((said.verdict, &said.notes), (again.verdict, &again.notes), "work is counted, not time");
}

#[test]
fn a_cut_that_hides_nothing_is_given_nothing_and_wear_is_named() {
    let (verdict, names) = diagnosed(&[], 7);
    assert!(matches!(verdict, Verdict::ModelAdequate | Verdict::ParameterError), "{verdict:?} {names:?}");
    assert!(names.is_empty(), "{names:?}");
    let (verdict, names) = diagnosed(&["tool_wear"], 8);
    assert_eq!((verdict, names), (Verdict::MissingPhysics, vec!["tool_wear".to_owned()]));
}

/// With the damping that the scenario leaves out the model, given no force, is as loud as the recording, calm and
/// in chatter; without it is not.
#[test]
fn the_repaired_model_runs_free_as_loud_as_the_recording() {
    let said = whole_answer(&["process_damping"], 21);
    assert_eq!(said.verdict, Verdict::MissingPhysics, "{:?}", said.notes);
    let apart: Vec<[f64; 2]> =
        said.recordings.iter().map(|r| r.free.as_ref().expect("it cuts").apart_db).collect();
    let worst = |k: usize| apart.iter().map(|a| a[k]).fold(0.0, f64::max);
    println!("{apart:?}");
    assert!(worst(0) > 10.0 && worst(1) < 0.5 * worst(0), "{apart:?}");
    let free = said.recordings[0].free.as_ref().unwrap();
    assert!(free.t_s.len() > 20 && free.recorded_n.iter().all(|n| *n > 0.0));
    let spread = |ends: &[Vec<f64>; 2]| ends[0].iter().zip(&ends[1]).all(|(low, high)| low <= high);
    assert!(spread(&free.before_n) && spread(&free.after_n));
    // Held out, the stretches say what all of them said together, and where.
    let (found, proof) = (&said.findings[0], said.proof.as_ref().unwrap());
    assert!(found.fit.gain_nats.unwrap() > 0.5 * found.evidence_nats, "{:?} {proof:?}", found.fit);
    assert!(
        proof.loss_nats.answer < proof.loss_nats.refitted
            && proof.loss_nats.refitted < proof.loss_nats.stated
    );
    assert!(!said.location.as_ref().unwrap().bands_hz.is_empty());
    let files = CutFiles { scenario: String::new(), recordings: Vec::new(), faults: Vec::new(), table: None };
    let json = to_json(&said, &files);
    assert_eq!(json["proof"]["loss_nats"]["answer"], proof.loss_nats.answer);
    assert_eq!(json["proof"]["lines"].as_array().unwrap().len(), proof.lines.len());
    assert_eq!(json["findings"][0]["fit"]["heldout_gain_nats"], found.fit.gain_nats.unwrap());
}

/// The wave that was left is met whole: neither more nor less of it, however the scenario without it bends what
/// counts as calm.
#[test]
fn a_past_that_the_scenario_forgets_is_found_whole() {
    let said = whole_answer(&["regenerative_effect"], 5);
    let found = &said.findings[0];
    assert_eq!(found.effect.name(), "regenerative_effect");
    let overlap = found.parameters.iter().find(|p| p.name == "overlap").unwrap();
    assert!(
        overlap.ci95[0] < 1.02 && overlap.ci95[1] > 0.98 && (overlap.value - 1.0).abs() < 0.06,
        "{overlap:?}"
    );
}

/// Work that runs out of centre moves line and growth a little, as another pitch would: none is corrected. And
/// one recording alone is held out in parts.
#[test]
fn work_out_of_centre_is_no_wrong_pitch() {
    let said = answer_of(&["runout/eccentricity"], 6, 1);
    assert_eq!(said.findings[0].effect.name(), "runout", "{:?}", said.notes);
    let pitch = said.parameter_corrections.iter().find(|c| c.name == "pitch_difference_rad");
    assert!(pitch.is_none(), "{pitch:?}");
    let fit = said.findings[0].fit;
    let forces = fit.forces.unwrap();
    assert!(
        fit.gain_nats.unwrap() > 0.0 && forces.heldout_rms_after_n < forces.heldout_rms_before_n,
        "{fit:?}"
    );
}

/// A holder is a narrow hill of the likelihood beside others that the stated numbers climb first.
#[test]
fn a_holder_that_gives_way_is_found_from_afar() {
    for seed in [26_154_527_952_625, 103_254_925_167_957] {
        let (verdict, names) = diagnosed(&["turret_compliance"], seed);
        assert_eq!((verdict, names), (Verdict::MissingPhysics, vec!["turret_compliance".to_owned()]));
    }
}

/// A commanded pitch that is off by a degree comes out as what is to be added to it, in the scenario, too.
#[test]
fn a_wrong_pitch_is_repaired_in_the_scenario() {
    let spec = CutCaseSpec { effects: Vec::new(), depth: 1.0, seed: 7, probe: false };
    let mut case = conceal_cut(&Scenario::default(), &spec).unwrap();
    let (off_rad, stated) = (0.0175, case.scenario.tools.pitch_difference_rad());
    for recording in &mut case.recordings {
        let pitch = recording.columns.iter_mut().find(|c| c.name == "pitch_difference_rad").unwrap();
        pitch.values.iter_mut().for_each(|p| *p -= off_rad);
    }
    let recordings: Vec<CutRecording> =
        case.recordings.iter().map(|r| CutRecording::new(r, &case.scenario).unwrap()).collect();
    let evidence = CutEvidence { recordings: &recordings, table: None };
    let said = diagnose(&case.scenario, evidence, 60.0, &|_, _| {}).unwrap();
    assert!(said.findings.is_empty(), "{:?}", said.findings);
    let told = said.parameter_corrections.iter().find(|c| c.name == "pitch_difference_rad").unwrap();
    assert!((told.value - told.nominal - off_rad).abs() < 3e-3, "{told:?}");
    let repaired = said.scenario.tools.pitch_difference_rad() - stated;
    assert!((repaired - (told.value - told.nominal)).abs() < 1e-12, "{repaired} {told:?}");
}

/// A frequency that is another one in every stretch is no law of place, speed or time.
#[test]
fn a_mode_that_wanders_is_left_unexplained() {
    let (verdict, names) = diagnosed(&["unknown/wandering_mode"], 11);
    assert_eq!(verdict, Verdict::UnexplainedMismatch, "{names:?}");
}

/// A force that depends on what the chip was before is no lag, no damping of the flank and no compliance.
#[test]
fn a_force_that_remembers_is_left_unexplained_at_the_process() {
    let said = whole_answer(&["unknown/chip_memory"], 12);
    assert_eq!(said.verdict, Verdict::UnexplainedMismatch, "{:?}", said.findings);
    assert_eq!(said.location.unwrap().port, Port::Process);
}

#[test]
fn chips_that_tangle_are_in_no_vocabulary_and_left_unexplained() {
    let (verdict, names) = diagnosed(&["unknown/chip_tangle"], 9);
    assert_eq!(verdict, Verdict::UnexplainedMismatch, "{names:?}");
}
