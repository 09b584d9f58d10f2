//! Every decision of the running service can be made again: what its black box stored, replayed by
//! `stillcut replay` with the same configuration, gives the same bytes.

use crate::running::{LatheThread, Place, ask, get, until};
use std::path::Path;
use std::process::Command;
use stillcut::avoidance::Decision;
use stillcut::avoidance::account::{LookWriter, read_looks};
use stillcut::recording::{Evidence, read_recording, write_recording};
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
    // Without a report of the turret it is compared, too: what is stated of the pitch takes no part.
    let file = stored(&running, "manual").unwrap();
    let mut recording = read_recording(&file).unwrap();
    let changed = place.folder.path().join("changed.parquet");
    let mut silent = recording.clone();
    silent.columns.retain(|c| !c.name.starts_with("pitch_"));
    assert!(silent.columns.len() < recording.columns.len());
    write_recording(&changed, &silent).unwrap();
    let (_, said) = replay(&path, &changed, &out);
    assert!(!said.contains("nothing to compare"), "{said}");
    // One bit of one sample changed: the comparison can fail.
    let motor = recording.columns.iter_mut().find(|c| c.name == "x1_stage_position_m").unwrap();
    // The scale reads exactly zero now and then, and a bit of a zero changes nothing.
    let value = motor.values[500..].iter_mut().find(|v| **v != 0.0).unwrap();
    *value = f64::from_bits(value.to_bits() ^ (1 << 40));
    write_recording(&changed, &recording).unwrap();
    let (good, said) = replay(&path, &changed, &out);
    assert!(!good && said.contains("differs from the live run"), "{said}");
    // Another configuration: refused, not compared.
    std::fs::write(&path, toml.replace("[recorder]", "[machine]\nforce_cutoff_hz = 900.0\n[recorder]"))
        .unwrap();
    let (good, said) = replay(&path, &file, &out);
    assert!(!good && said.contains("the configuration differs"), "{said}");
    running.stop();
}

/// The turret is moved, and what was decided is decided again from the recording alone, bit for bit.
#[test]
fn the_decisions_on_the_turret_are_made_again() {
    let place = Place::new("turr");
    let toml = place.toml("") + "[recorder]\nbefore_s = 3.0\nafter_s = 4.5\n";
    let path = place.folder.path().join("c.toml");
    std::fs::write(&path, &toml).unwrap();
    let mut config = stillcut::config::service::service_config_from_text(&path, &toml).unwrap();
    config.http.trust_loopback = true;
    let running = start(config).unwrap();
    let lathe = LatheThread::start(&place.domain);
    let address = running.handle().address().to_string();
    let act = "{\"mode\":\"act\",\"reason\":\"test\"}";
    until("the service acts", 20, || {
        let etag = get(&running, "/api/v1/mode").etag;
        ask(&address, "PUT", "/api/v1/mode", &[("If-Match", &etag)], Some(act)).status == 200
    });
    until("the onset is recorded", 30, || stored(&running, "chatter_onset").is_some());
    let file = stored(&running, "chatter_onset").unwrap();
    // The newest stands first; a second one may have followed.
    let told = get(&running, "/api/v1/events?kind=pitch_command").json();
    let told = told["events"].as_array().unwrap().last().unwrap().clone();
    drop(lathe);
    running.stop();
    let out = place.folder.path().join("out");
    let (good, said) = replay(&path, &file, &out);
    assert!(good, "{said}");
    let text = std::fs::read_to_string(out.join("decisions.jsonl")).unwrap();
    let lines: Vec<serde_json::Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    let moved =
        lines.iter().find(|l| l["decision"] == "move").expect("the turret was moved inside of the recording");
    assert_eq!(moved["pitch_difference_rad"], told["pitch_difference_rad"]);
    assert!(lines.iter().any(|l| l["decision"] == "renew") && lines.iter().any(|l| l["decision"] == "hold"));

    // One bit of one situation changed, and the digest made to fit: the decision is no longer the same.
    let mut recording = read_recording(&file).unwrap();
    let mut evidence = Evidence::of(&recording).unwrap().unwrap();
    let stretches = &mut evidence.account.as_mut().unwrap().stretches;
    let mut hit = None;
    for (place, stretch) in stretches.iter().enumerate() {
        let looks = read_looks(stretch).unwrap();
        if let Some(index) = looks.iter().position(|l| matches!(l.decision, Decision::Command(_))) {
            hit = hit.or(Some((place, index, looks)));
        }
    }
    let (place_hit, index, mut looks) = hit.unwrap();
    let turret = looks[index].situation.turret.as_mut().unwrap();
    turret.heard_s = f64::from_bits(turret.heard_s.to_bits() ^ (1 << 62));
    let (mut writer, mut bytes) = (LookWriter::default(), Vec::new());
    looks.iter().for_each(|look| writer.write(look, &mut bytes));
    stretches[place_hit] = bytes;
    let other = evidence.metadata();
    recording.metadata.retain(|(key, _)| other.iter().all(|(k, _)| k != key));
    recording.metadata.extend(other);
    let changed = place.folder.path().join("changed.parquet");
    write_recording(&changed, &recording).unwrap();
    let (good, said) = replay(&path, &changed, &out);
    assert!(!good && said.contains("turret decision") && said.contains("differs"), "{said}");
    // One line beside what the recording itself lacks.
    let lines = said.trim_end().lines().filter(|line| !line.starts_with("note: "));
    assert_eq!(lines.count(), 1, "{said}");
    // A changed bit that nobody made to fit: damage, before anything is compared.
    let key = "turret_looks";
    let looks = &mut recording.metadata.iter_mut().find(|(k, _)| k == key).unwrap().1;
    let last = looks.pop().unwrap();
    looks.push(if last == '0' { '1' } else { '0' });
    write_recording(&changed, &recording).unwrap();
    let (good, said) = replay(&path, &changed, &out);
    assert!(!good && said.contains("damaged"), "{said}");
}
