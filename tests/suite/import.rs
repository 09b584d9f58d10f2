//! Foreign files through the maps that ship with the project, and through maps that must be refused.

use crate::folders::{project, shared};
use std::path::{Path, PathBuf};
use stillcut::config::import_map::{import_map_from_text, read_import_map};
use stillcut::recording::{Table, TableColumn, import, read_recording, write_recording, write_table};

fn temporary(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("import");
    std::fs::create_dir_all(&folder).unwrap();
    folder.join(name)
}

fn imported(map: &str, file: &Path) -> Result<stillcut::sample::Recording, String> {
    let map = import_map_from_text(Path::new("map.toml"), map).map_err(|e| e.to_string())?;
    import(file, &map).map_err(|e| e.to_string())
}

const MAP: &str = "[time]\ncolumn = \"time\"\nunit = \"ms\"\n[[signals]]\nfrom = \"pos\"\nto = \"x_motor_position_m\"\n\
                   unit = \"mm\"\n[[signals]]\nfrom = \"force\"\nto = \"x_thrust_ref_n\"\nunit = \"kN\"\noffset = 0.5\n";

#[test]
fn columns_are_renamed_scaled_and_read_back() {
    let file = temporary("plain.csv");
    std::fs::write(&file, "time,force,pos,label\n0,1.5,10,7\n2,2.5,11,7\n4,0.5,12,7\n").unwrap();
    let recording = imported(MAP, &file).unwrap();
    assert_eq!(recording.get("x_thrust_ref_n"), Some(&[1000.0, 2000.0, 0.0][..]));
    assert_eq!(recording.axes, ["x"]);
    assert!((recording.sample_rate.hz() - 500.0).abs() < 1.0e-9);
    let out = temporary("plain.parquet");
    write_recording(&out, &recording).unwrap();
    let back = read_recording(&out).unwrap();
    assert_eq!(back.columns, recording.columns);
    assert_eq!(back.metadata("imported_from"), Some("plain.csv"));
}

#[test]
fn what_is_wrong_is_said_with_file_column_and_row() {
    let file = temporary("bad.csv");
    let cases = [
        ("time,force,pos\n0,1,1\n2,x,1\n", "column force, row 1: `x` is not a number"),
        ("time,force,pos\n0,1,1\n2,NaN,1\n", "column force, row 1: NaN is not a finite number"),
        ("time,force,pos\n0,1,1\n2,1,1\n1,1,1\n", "column time, row 2: time runs from 0.002 to 0.001 s"),
        ("time,force\n0,1\n2,1\n", "no column `pos`; the file has time, force"),
        (
            "time,force,pos\n0,1,1\n2,1,1\n4,1,1\n40,1,1\n",
            "not uniformly sampled; state recording.resample_hz",
        ),
        ("time,force,pos\n0,1,1\n", "1 rows are kept; at least 2 are needed"),
    ];
    for (text, expected) in cases {
        std::fs::write(&file, text).unwrap();
        let error = imported(MAP, &file).unwrap_err();
        assert!(error.contains("bad.csv") && error.contains(expected), "{error}\nexpected: {expected}");
    }
}

#[test]
fn a_column_that_is_there_twice_is_refused() {
    let file = temporary("twice.csv");
    std::fs::write(&file, "t_s,x_force_n,x_force_n\n0,1,2\n0.1,1,2\n").unwrap();
    let error = read_recording(&file).unwrap_err().to_string();
    assert!(error.contains("twice.csv: column `x_force_n` is there twice"), "{error}");
}

#[test]
fn a_rate_that_is_not_the_stated_one_is_refused() {
    let file = temporary("rate.csv");
    std::fs::write(&file, "time,force,pos\n0,1,1\n2,1,1\n4,1,1\n").unwrap();
    let error = imported(&format!("[recording]\nsample_rate_hz = 1000.0\n{MAP}"), &file).unwrap_err();
    assert!(error.contains("the times give 500.000000 Hz, the map states 1000 Hz"), "{error}");
}

#[test]
fn a_logger_with_header_lines_and_semicolons_is_read() {
    let file = temporary("logger.csv");
    std::fs::write(&file, "Logger 7\nstarted;2020\ntime;pos;force\nms;mm;kN\n0;1;0.5\n1;2;0.5\n2;3;1.5\n")
        .unwrap();
    let map = format!("[source]\ndelimiter = \";\"\nheader_row = 3\ndata_row = 5\n{MAP}");
    let recording = imported(&map, &file).unwrap();
    assert_eq!(recording.get("x_thrust_ref_n"), Some(&[0.0, 0.0, 1000.0][..]));
}

#[test]
fn the_matlab_file_of_emps_gives_the_recording_in_the_projects_format() {
    let (Some(mat), Some(own)) =
        (shared("recordings/emps/original/DATA_EMPS.mat"), shared("recordings/emps/axis.parquet"))
    else {
        return;
    };
    let map = read_import_map(&project("config/import/emps-mat.toml")).unwrap();
    let (ours, theirs) = (import(&mat, &map).unwrap(), read_recording(&own).unwrap());
    for column in ["x_thrust_ref_n", "x_motor_position_m", "x_position_cmd_m"] {
        let (a, b) = (ours.require(column).unwrap(), theirs.require(column).unwrap());
        assert_eq!(a.len(), b.len());
        let worst = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1.0e-6, "{column} differs by {worst}"); // the file's force is rounded to 8 digits
    }
}

#[test]
fn every_shipped_map_reads_its_recordings() {
    let pairs = [
        (
            "screw-drive-steady-speed",
            "screw_drive_friction/drive1_plain_lead_screw_steady_speed.parquet",
            100.0,
        ),
        (
            "screw-drive-start-stop",
            "screw_drive_friction/drive1_plain_lead_screw_start_stop_50rpm.parquet",
            25.0,
        ),
        ("friction-damper", "friction_damper_backlash/d2_0p5hz_30lb_1in.parquet", 1024.0),
        ("reducer-torque-ramp", "reducer_backlash_torque_ramp/torque_ramp_baseline_new.parquet", 100.0),
        ("servo-torque-steps", "servo_torque_steps/torque_step_pos_0p06_1.parquet", 1000.0),
        ("servo-axis-log", "servo_axis_with_load_cell/original/a3MR.csv", 1500.0),
    ];
    for (name, file, rate_hz) in pairs {
        let map = read_import_map(&project(&format!("config/import/{name}.toml"))).unwrap();
        let Some(file) = shared(&format!("recordings/{file}")) else { continue };
        let recording = import(&file, &map).unwrap();
        assert!(
            (recording.sample_rate.hz() / rate_hz - 1.0).abs() < 0.01,
            "{name}: {}",
            recording.sample_rate.hz()
        );
        assert!(recording.columns.iter().flat_map(|c| &c.values).all(|v| v.is_finite()), "{name}");
        assert!(!recording.axes.is_empty(), "{name}");
    }
}

#[test]
fn a_parquet_file_without_a_rate_is_refused() {
    let file = temporary("no-rate.parquet");
    let (times, values) = ([0.0, 0.001, 0.002], [1.0, 2.0, 3.0]);
    let columns =
        vec![("t_s", TableColumn::Double(&times)), ("x_thrust_ref_n", TableColumn::Double(&values))];
    let format = ("format".to_owned(), "stillcut.recording/1".to_owned());
    write_table(&file, &Table { columns, metadata: vec![format] }).unwrap();
    let error = read_recording(&file).unwrap_err().to_string();
    assert!(error.contains("no-rate.parquet") && error.contains("sample_rate_hz"), "{error}");
}
