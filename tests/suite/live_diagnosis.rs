//! Diagnosis on the running service: a machine that its model does not describe is noticed while it moves in
//! air, the evidence is stored, and a diagnosis of it runs to a report over HTTP.

use crate::folders::shared;
use crate::running::{LatheThread, Place, ask, get, until};
use stillcut::recording::read_recording;
use stillcut::sample::Recording;
use stillcut::service::{Running, start};
use stillcut::transport::wire::{MAX_SAMPLES, ServoBatch, ServoPoint, axis_name_bytes};
use stillcut::transport::{Domain, ServoPublisher};

/// Publishes a recording's axis x as a machine would, four times as fast, again and again for `seconds` of it.
fn play(domain: &Domain, recording: &Recording, seconds: f64) {
    let who = domain.join("player").unwrap();
    let port = ServoPublisher::open(&who).unwrap();
    let column = |name: &str| recording.get(name).unwrap();
    let (current, motor, stage) =
        (column("x_current_ref_a"), column("x_motor_angle_rad"), column("x_stage_position_m"));
    let rate_hz = recording.sample_rate.hz();
    let total = (seconds * rate_hz) as usize;
    let began = std::time::Instant::now();
    for first in (0..total).step_by(MAX_SAMPLES) {
        let mut batch = ServoBatch {
            stream: 1,
            sample_rate_hz: rate_hz,
            sample_count: MAX_SAMPLES as u32,
            axis_count: 2, // the second stands still
            ..ServoBatch::default()
        };
        batch.axis_names[0] = axis_name_bytes("x");
        batch.axis_names[1] = axis_name_bytes("y");
        for (offset, point) in batch.points.iter_mut().enumerate() {
            let sequence = first + offset;
            let index = sequence % recording.len();
            *point = ServoPoint { valid: ServoPoint::all_valid(2), ..ServoPoint::default() };
            point.sequence = sequence as u64;
            point.t_ns = (sequence as f64 / rate_hz * 1e9) as u64;
            point.axes[0].current_ref_a = current[index];
            point.axes[0].motor_angle_rad = motor[index];
            point.axes[0].stage_position_m = stage[index];
        }
        port.send(&batch).unwrap();
        let due_s = first as f64 / rate_hz / 4.0;
        while began.elapsed().as_secs_f64() < due_s {
            std::thread::sleep(std::time::Duration::from_micros(500));
        }
    }
}

/// A service whose machine is `model`.
fn service_of(place: &Place, (model, watched): (&str, &str)) -> Running {
    std::fs::write(place.folder.path().join("machine.toml"), model).unwrap();
    // Its turret is moved by nobody.
    let mut toml = place.toml("").replace("the tests", "not commissioned");
    toml += &format!("[machine]\nmodel = \"machine.toml\"\nwatch = [\"{watched}\"]\n");
    toml += "[recorder]\nbefore_s = 10.0\nafter_s = 0.5\n";
    let path = place.folder.path().join("c.toml");
    let mut config = stillcut::config::service::service_config_from_text(&path, &toml).unwrap();
    config.http.trust_loopback = true;
    config.program = Some(env!("CARGO_BIN_EXE_stillcut").into());
    start(config).unwrap()
}

fn residual(running: &Running) -> f64 {
    let text = get(running, "/metrics").body;
    let line = text.lines().find(|l| l.starts_with("stillcut_model_residual_ratio{axis=\"x\"}"));
    line.map_or(0.0, |l| l.rsplit(' ').next().unwrap().parse().unwrap())
}

fn diagnose(running: &Running, recording: &str) -> serde_json::Value {
    let body = format!("{{\"recordings\":[\"{recording}\"],\"reason\":\"test\"}}");
    let (view, report, shares) = diagnosed(running, "/api/v1/diagnoses", &body);
    assert!(report.contains("<svg"), "the report has its pictures");
    assert!(shares.iter().any(|s| *s > 0.0 && *s < 1.0), "progress is seen on the way: {shares:?}");
    view
}

/// What came of a diagnosis, its report, and the shares of progress that were seen.
fn diagnosed(running: &Running, route: &str, body: &str) -> (serde_json::Value, String, Vec<f64>) {
    let address = running.handle().address().to_string();
    let asked = ask(&address, "POST", route, &[], Some(body));
    assert_eq!(asked.status, 202, "{asked:?}");
    let id = asked.json()["id"].as_str().unwrap().to_owned();
    let path = format!("/api/v1/diagnoses/{id}");
    let mut shares = Vec::new();
    until("the diagnosis ends", 240, || {
        let view = get(running, &path).json();
        shares.push(view["progress"].as_f64().unwrap());
        view["state"] == "done" || view["state"] == "failed"
    });
    let view = get(running, &path).json();
    assert_eq!(view["state"], "done", "{view}");
    assert!(shares.windows(2).all(|w| w[0] <= w[1] + 1e-9), "progress does not run back");
    let report = get(running, &format!("{path}/report.html"));
    assert_eq!(report.status, 200);
    (view, report.body, shares)
}

#[test]
fn a_wrong_model_is_noticed_in_air_and_diagnosed_over_http() {
    let Some(folder) = shared("feed-axis-cases/case-13") else { return };
    let place = Place::new("diag");
    let moves = read_recording(&folder.join("moves.parquet")).unwrap();
    // The model as it was identified, and one that believes in 60 % of the moving masses.
    let good = std::fs::read_to_string(folder.join("machine.toml")).unwrap();
    let scaled = |line: &str| match line.split_once(" = ") {
        Some((key @ ("movable_mass_kg" | "rotary_inertia_kg_m2"), value)) => {
            format!("{key} = {}", 0.6 * value.split('#').next().unwrap().trim().parse::<f64>().unwrap())
        }
        _ => line.to_owned(),
    };
    let wrong: Vec<String> = good.lines().map(scaled).collect();
    let running = service_of(&place, (&wrong.join("\n"), "x"));
    play(&place.domain, &moves, 16.0);
    until("the mismatch is told", 20, || {
        !get(&running, "/api/v1/events?kind=model_mismatch").json()["events"].as_array().unwrap().is_empty()
    });
    let event = get(&running, "/api/v1/events?kind=model_mismatch").json()["events"][0].clone();
    let text = event["text"].as_str().unwrap().to_owned();
    // The event keeps what was measured when it was raised; the gauge goes on with the motion.
    let percent = text.split("leaves ").nth(1).and_then(|t| t.split(' ').next()?.parse::<f64>().ok());
    assert!(percent.is_some_and(|p| p > 20.0), "{text}");
    assert!(residual(&running) > 0.0, "the gauge shows the axis");
    let id = text.split("(recording ").nth(1).unwrap().trim_end_matches(')').to_owned();
    assert!(id.starts_with("model_mismatch-"), "{text}");
    until("its recording is stored", 10, || running.handle().recording_path(&id).is_ok());
    let view = diagnose(&running, &id);
    assert_eq!(view["result"]["schema"], "stillcut.diagnosis/1");
    let corrections = view["result"]["parameter_corrections"].to_string();
    let verdict = view["result"]["verdict"].as_str().unwrap().to_owned();
    println!("stored by the service: {verdict}, corrections {corrections}");
    assert_ne!(verdict, "model_adequate");
    // An imported one, put beside the service's own.
    let imported = running.handle().recording_path(&id).unwrap().with_file_name("imported-sweep.parquet");
    std::fs::copy(folder.join("sweep.parquet"), &imported).unwrap();
    let view = diagnose(&running, "imported-sweep");
    let corrections = view["result"]["parameter_corrections"].to_string();
    println!("imported: {}, corrections {corrections}", view["result"]["verdict"]);
    assert!(corrections.contains("mass") || corrections.contains("inertia"), "{corrections}");
    // A diagnosis of the drive wrote no scenario of the cut.
    let route = format!("/api/v1/diagnoses/{}/accept", view["id"].as_str().unwrap());
    let address = running.handle().address().to_string();
    let refused = ask(&address, "POST", &route, &[], Some("{\"reason\":\"test\"}"));
    assert_eq!(refused.status, 404, "{refused:?}");
    assert!(get(&running, "/metrics").body.contains("stillcut_diagnoses_total{outcome=\"done\"} 2"));
    running.stop();
}

/// A recording in which every axis stands in the cut is no failure of the job: its answer says that nothing can
/// be told of the drive here, and beside another it is left out by name.
#[test]
fn a_recording_that_tells_nothing_of_the_drive_fails_no_job() {
    let place = Place::new("still");
    let running = service_of(&place, (include_str!("../../config/turrets.toml"), "x1"));
    let address = running.handle().address().to_string();
    let lathe = LatheThread::start(&place.domain);
    until("samples come", 20, || get(&running, "/readyz").status == 200);
    let ids = || -> Vec<String> {
        let list = get(&running, "/api/v1/recordings").json();
        list.as_array().unwrap().iter().map(|r| r["id"].as_str().unwrap().to_owned()).collect()
    };
    for many in [1, 2] {
        std::thread::sleep(std::time::Duration::from_secs(3));
        let asked = ask(&address, "POST", "/api/v1/recordings", &[], Some("{\"reason\":\"test\"}"));
        assert!(asked.status < 300, "{asked:?}");
        until("it is stored", 30, || ids().len() >= many);
    }
    drop(lathe);
    let [first, second] = [0, 1].map(|k| ids()[k].clone());
    let both = format!("[\"{first}\",\"{second}\"]");
    let body = format!("{{\"recordings\":{both},\"budget_s\":10,\"reason\":\"test\"}}");
    let (view, report, _) = diagnosed(&running, "/api/v1/diagnoses", &body);
    let why = view["result"]["no_evidence"].as_str().unwrap();
    assert!(why.contains("nothing can be told"), "{view}");
    assert_eq!(view["result"]["left_out"].as_array().unwrap().len(), 2);
    assert!(report.contains("Nothing can be told of the drive"), "{report}");
    until("the event says so", 10, || {
        let events = get(&running, "/api/v1/events?kind=diagnosis_done").json()["events"].to_string();
        events.contains("nothing can be told of the drive here")
    });
    running.stop();
}

/// What was cut stands in the history; its diagnosis is one request away, and the scenario that it wrote is
/// there for a person to take.
#[test]
fn past_cuts_are_kept_and_diagnosed_over_http() {
    let place = Place::new("cuts");
    let mut config = place.config("");
    config.http.trust_loopback = true;
    config.program = Some(env!("CARGO_BIN_EXE_stillcut").into());
    let running = start(config).unwrap();
    let address = running.handle().address().to_string();
    let early = ask(&address, "POST", "/api/v1/cuts/diagnose", &[], Some("{\"reason\":\"test\"}"));
    assert!(early.status >= 400 && early.body.contains("no cut yet"), "{early:?}");
    let lathe = LatheThread::start(&place.domain);
    let cuts = || get(&running, "/api/v1/cuts").json()["cuts"].as_array().unwrap().clone();
    until("the first cut is told", 30, || !cuts().is_empty());
    let cut = cuts()[0].clone();
    assert!(cut["outcome"] == "chatter" && cut["spindle_speed_rpm"] == 1200.0, "{cut}");
    assert!((cut["line_hz"].as_f64().unwrap() - 650.0).abs() < 15.0, "{cut}");
    drop(lathe);
    let table = get(&running, "/api/v1/cuts/file.csv").body;
    assert!(
        table.starts_with("cut,spindle_speed_rpm,width_m,outcome,") && table.contains(",chatter,"),
        "{table}"
    );
    let (view, report, _) = diagnosed(&running, "/api/v1/cuts/diagnose", "{\"reason\":\"test\"}");
    assert!(view["cuts"] == 1 && view["recordings"] == serde_json::json!([]), "{view}");
    // The virtual lathe is cut as it is stated.
    assert_eq!(view["result"]["verdict"], "model_adequate", "{view}");
    assert!(report.contains("foretells 1 of 1 cuts"), "{report}");
    let id = view["id"].as_str().unwrap();
    let scenario = get(&running, &format!("/api/v1/diagnoses/{id}/scenario.toml"));
    assert!(scenario.status == 200 && scenario.body.contains("[workpiece]"), "{scenario:?}");
    // A person agrees: it is on record and beside the history, and nothing that runs has changed.
    let config = get(&running, "/api/v1/config").body;
    let route = format!("/api/v1/diagnoses/{id}/accept");
    let accepted = ask(&address, "POST", &route, &[], Some("{\"reason\":\"the map fits our bars\"}"));
    assert_eq!(accepted.status, 200, "{accepted:?}");
    let path = accepted.json()["path"].as_str().unwrap().to_owned();
    assert_eq!(std::fs::read_to_string(&path).unwrap(), scenario.body);
    assert!(accepted.json()["next"].as_str().unwrap().contains(&path), "{accepted:?}");
    assert!(
        path.ends_with(&format!("accepted-scenario-{id}.toml")),
        "no other acceptance changes it: {path}"
    );
    assert_eq!(get(&running, "/api/v1/config").body, config);
    until("the acceptance is on record", 10, || {
        let audit = get(&running, "/api/v1/audit").body;
        audit.contains("accept_scenario") && audit.contains("the map fits our bars")
    });
    let none = ask(&address, "POST", "/api/v1/diagnoses/nothing/accept", &[], Some("{\"reason\":\"test\"}"));
    assert_eq!(none.status, 404, "{none:?}");
    running.stop();
}
