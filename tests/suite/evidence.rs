//! Every decision of the running service can be made again: what its black box stored, replayed by
//! `stillcut replay` with the same configuration, gives the same bytes.

use crate::running::{LatheThread, Place, ask, get, until};
use std::path::Path;
use std::process::Command;
use stillcut::recording::{read_recording, write_recording};
use stillcut::service::{Running, start};

fn replay(config: &Path, recording: &Path, out: &Path) -> (bool, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stillcut"));
    command.args(["replay", "--verify", "--config"]).arg(config).arg("--recording").arg(recording);
    let output = command.arg("--out").arg(out).output().unwrap();
    (output.status.success(), String::from_utf8_lossy(&output.stderr).into_owned())
}

fn stored(running: &Running, word: &str) -> Option<std::path::PathBuf> {
    let list = get(running, "/api/v1/recordings").json();
    let ids = list.as_array()?.iter().filter_map(|r| r["id"].as_str());
    let id = ids.filter(|id| id.starts_with(word)).max()?.to_owned();
    running.handle().recording_path(&id).ok()
}

#[test]
fn what_the_black_box_stored_replays_to_the_same_bytes() {
    let place = Place::new("evid");
    let mut toml = place.toml("");
    toml += "[recorder]\nbefore_s = 1.0\nafter_s = 0.5\n";
    let path = place.folder.path().join("c.toml");
    std::fs::write(&path, &toml).unwrap();
    let mut config = stillcut::config::service::service_config_from_text(&path, &toml).unwrap();
    config.http.trust_loopback = true;
    let running = start(config).unwrap();
    let lathe = LatheThread::start(&place.domain);
    until("the onset is recorded", 30, || stored(&running, "chatter_onset").is_some());
    // A second one from inside the chatter: it begins in the middle of everything.
    let address = running.handle().address().to_string();
    let asked = ask(&address, "POST", "/api/v1/recordings", &[], Some("{\"reason\":\"test\"}"));
    assert!(asked.status < 300, "{asked:?}");
    until("the second is recorded", 30, || stored(&running, "manual").is_some());
    let onset = get(&running, "/api/v1/events?kind=chatter_onset").json()["events"][0].clone();
    drop(lathe);
    let out = place.folder.path().join("out");
    for word in ["chatter_onset", "manual"] {
        let file = stored(&running, word).unwrap();
        let recording = read_recording(&file).unwrap();
        let first: u64 = recording.metadata("first_sequence").unwrap().parse().unwrap();
        assert!(first > 0, "{word}: the stream is older than the recording");
        let (good, said) = replay(&path, &file, &out);
        assert!(good, "{word}: {said}");
        let events = std::fs::read_to_string(out.join("events.jsonl")).unwrap();
        assert_eq!(Some(events.as_str()), recording.metadata("decisions"));
        if word == "chatter_onset" {
            // The history tells the same onset, to the last bit.
            let replayed: Vec<serde_json::Value> =
                events.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
            let same = replayed.iter().find(|e| e["kind"] == "chatter_onset").unwrap();
            for key in ["t_s", "axis", "frequency_hz", "power_n2"] {
                assert_eq!(same[key], onset[key], "{key}");
            }
            assert!(same["pitch_difference_rad"].is_number());
        }
    }
    // One bit of one sample changed: the comparison can fail.
    let file = stored(&running, "manual").unwrap();
    let mut recording = read_recording(&file).unwrap();
    let motor = recording.columns.iter_mut().find(|c| c.name == "x1_stage_position_m").unwrap();
    // The scale reads exactly zero now and then, and a bit of a zero changes nothing.
    let value = motor.values[500..].iter_mut().find(|v| **v != 0.0).unwrap();
    *value = f64::from_bits(value.to_bits() ^ (1 << 40));
    let changed = place.folder.path().join("changed.parquet");
    write_recording(&changed, &recording).unwrap();
    let (good, said) = replay(&path, &changed, &out);
    assert!(!good && said.contains("differs from the live run"), "{said}");
    // Another configuration: refused, not compared.
    std::fs::write(&path, toml.replace("[recorder]", "[machine]\nforce_cutoff_hz = 900.0\n[recorder]"))
        .unwrap();
    let (good, said) = replay(&path, &file, &out);
    assert!(!good && said.contains("nothing to compare"), "{said}");
    running.stop();
}
