//! Measured cuts of others, heard as a user hears them: `import`, then `replay`. What their spectra say stands
//! in `docs/results-chatter.md`; that stable passes are silent and strong chatter is one alarm may not get lost.

use crate::folders::{project, shared};
use std::path::Path;
use std::process::Command;
use stillcut::recording::read_columns;

/// What has to be heard.
#[derive(Debug, Clone, Copy)]
enum Heard {
    /// No alarm.
    Nothing,
    /// At most so many alarms, for less than this share of the time.
    AtMost(usize, f64),
    /// So many alarms, for more than this share of the time.
    Chatter(usize, f64),
}

/// Publisher's speed by the file's name, rpm.
const MILLED: [(&str, &str, Heard); 17] = [
    ("air_cut_6000rpm_piezo_8khz", "6000", Heard::Nothing),
    ("alu3flute_slot_d0p125in_12000rpm", "12000", Heard::Nothing),
    ("alu3flute_slot_d0p375in_6000rpm", "6000", Heard::Nothing),
    ("alu3flute_slot_d0p375in_7000rpm", "7000", Heard::Nothing),
    ("alu_flank_40pct_7000rpm_second_sensor", "7000", Heard::Nothing),
    ("cut4flute_eng25_d0p125in_6000to6900rpm", "6000", Heard::AtMost(1, 0.25)),
    ("cut4flute_eng25_d0p25in_6900rpm", "6900", Heard::Chatter(1, 0.7)),
    ("cut4flute_eng75_d0p25in_6900rpm", "6900", Heard::Chatter(1, 0.7)),
    ("cut4flute_f18ipm_eng25_d0p25in_3000rpm", "3000", Heard::Nothing),
    ("cut4flute_f18ipm_eng25_d0p25in_4000rpm", "4000", Heard::Nothing),
    ("cut4flute_f18ipm_eng50_d0p25in_4000rpm", "4000", Heard::Nothing),
    ("cut4flute_f18ipm_eng75_d0p125in_3000rpm_sensor_on_vice", "3000", Heard::Nothing),
    ("cut4flute_f18ipm_slot_d0p25in_4000rpm", "4000", Heard::Chatter(1, 0.7)),
    ("cut4flute_slot_d0p125in_6000rpm", "6000", Heard::Nothing),
    ("cut4flute_slot_d0p25in_6900rpm", "6900", Heard::Chatter(1, 0.7)),
    ("steel4140_eng25_d0p05in_4000rpm", "4000", Heard::Nothing),
    ("steel4140_eng50_d0p125in_4000rpm", "4000", Heard::Nothing),
];

/// Depth and speed, of the third input of the sensor.
const TURNED: [(&str, &str, Heard); 4] = [
    ("force_4mm_325rpm", "325", Heard::Nothing),
    ("force_4mm_550rpm", "550", Heard::Nothing),
    ("force_6mm_550rpm", "550", Heard::Nothing),
    ("force_5mm_550rpm", "550", Heard::Chatter(1, 0.7)),
];

fn stillcut(arguments: &[&str], files: &[(&str, &Path)]) -> bool {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stillcut"));
    command.args(arguments);
    files.iter().for_each(|(option, path)| {
        command.arg(option).arg(path);
    });
    command.output().unwrap().status.success()
}

/// Asserts what is heard of an imported recording.
fn hear(name: &str, recording: &Path, arguments: &[&str], heard: Heard) {
    let out = recording.with_extension("out");
    assert!(stillcut(arguments, &[("--recording", recording), ("--out", &out)]), "{name}");
    let events = std::fs::read_to_string(out.join("events.jsonl")).unwrap();
    let alarms = events.matches("\"chatter_onset\"").count();
    let columns = read_columns(&out.join("track.parquet")).unwrap();
    let (_, chatter) = columns.into_iter().find(|(name, _)| name == "chatter").unwrap();
    let share = chatter.iter().sum::<f64>() / chatter.len() as f64;
    println!("{name}: {share:.2} of the time, {alarms} alarms");
    let right = match heard {
        Heard::Nothing => alarms == 0,
        Heard::AtMost(most, below) => alarms <= most && share < below,
        Heard::Chatter(count, above) => alarms == count && share > above,
    };
    assert!(right, "{name}: {heard:?} expected, {share:.2} of the time in {alarms} alarms");
}

#[test]
fn measured_milling_is_heard_as_its_spectra_say() {
    let folder = tempfile::tempdir().unwrap();
    let maps = ["milling-accelerometers", "milling-accelerometers-two-axes"];
    let maps = maps.map(|map| project(&format!("config/import/{map}.toml")));
    for (name, rpm, heard) in MILLED {
        let Some(file) = shared(&format!("recordings/milling_vibration_chatter/{name}.parquet")) else {
            return;
        };
        let recording = folder.path().join(format!("{name}.parquet"));
        let import = [file.to_str().unwrap()];
        let fits = |map: &Path| stillcut(&["import", import[0]], &[("--map", map), ("--out", &recording)]);
        assert!(maps.iter().any(|map| fits(map)), "{name}: neither map fits");
        let signal = ["--signal", "accel_m_s2", "--band-hz", "100,760", "--spindle-speed-rpm", rpm];
        hear(name, &recording, &[&["replay"], &signal[..]].concat(), heard);
    }
}

#[test]
fn measured_turning_is_heard_as_its_spectra_say() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map.toml");
    let text = "[time]\ncolumn = \"t_s\"\nunit = \"s\"\n[recording]\nexperiment = \"cut\"\n\
                [[signals]]\nfrom = \"c_force_n\"\nto = \"y1_force_n\"\nunit = \"N\"\n";
    std::fs::write(&map, text).unwrap();
    for (name, rpm, heard) in TURNED {
        let Some(file) = shared(&format!("recordings/turning_chatter_force/{name}.parquet")) else { return };
        let recording = folder.path().join(format!("{name}.parquet"));
        let import = ["import", file.to_str().unwrap()];
        assert!(stillcut(&import, &[("--map", &map), ("--out", &recording)]), "{name}");
        hear(name, &recording, &["replay", "--band-hz", "50,400", "--spindle-speed-rpm", rpm], heard);
    }
}
