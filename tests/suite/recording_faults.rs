//! Each fault put into a recording of a drive that is written down here, and into the measured one beside the
//! project: told by name and column, and the numbers of the model as of the recording without it.

use crate::folders::shared;
use stillcut::diagnosis::{DiagnoseOptions, Diagnosis, diagnose_with};
use stillcut::gate::{Action, Criteria, Fault, FaultKind, Gated, Logged, check, rounded_by_one};
use stillcut::plant::drive::{DriveParams, RawDriveParams};
use stillcut::plant::machine::{AxisModel, Machine};
use stillcut::sample::{Column, Recording};
use stillcut::units::SampleRate;

const RATE_HZ: f64 = 1000.0;
const MASS_KG: f64 = 90.0;
const VISCOUS_N_S_M: f64 = 200.0;
const COULOMB_N: f64 = 20.0;
const STEP_M: f64 = 1e-7;
const THRUST: &str = "x_thrust_ref_n";
const POSITION: &str = "x_motor_position_m";
const SPEED: &str = "x_motor_velocity_m_s";

/// Deterministic noise of a normal law, near enough: twelve uniform numbers.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }

    fn row(&mut self, from: usize, to: usize) -> usize {
        from + (self.uniform() * (to - from) as f64) as usize
    }
}

/// Position, velocity and acceleration of a move of `way` in `length_s`, after the share `s` of its time: the
/// polynomial of fifth order that starts and ends at rest (minimum jerk).
pub(crate) fn smooth_move(way: f64, length_s: f64, s: f64) -> [f64; 3] {
    [
        way * s.powi(3) * (10.0 - 15.0 * s + 6.0 * s * s),
        way / length_s * 30.0 * (s * (1.0 - s)).powi(2),
        way / length_s.powi(2) * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
    ]
}

/// A drive that goes to and fro by moves of minimum jerk.
fn drive() -> Logged {
    let mut noise = Noise(11);
    let (mut thrust, mut position, mut speed) = (Vec::new(), Vec::new(), Vec::new());
    let moves = [0.2, 0.7, 0.35, 1.0, 0.5, 0.8, 0.3, 0.9, 0.6, 0.4];
    let mut from = 0.0;
    for (k, part) in moves.iter().cycle().take(20).enumerate() {
        let d = 0.12 * part * if k % 2 == 0 { 1.0 } else { -1.0 } * if k % 4 < 2 { 1.0 } else { -0.9 };
        let rows = (500.0 + 700.0 * part) as usize;
        let length_s = rows as f64 / RATE_HZ;
        for i in 0..rows + 60 {
            let s = (i as f64 / rows as f64).min(1.0);
            let [way, v, a] = smooth_move(d, length_s, s);
            let x = from + way;
            let force = MASS_KG * a + VISCOUS_N_S_M * v + COULOMB_N * (v / 1e-3).tanh();
            thrust.push(force + 0.4 * noise.normal());
            position.push((x / STEP_M).round() * STEP_M);
            speed.push(v + 2e-5 * noise.normal());
        }
        from += d;
    }
    let column = |name: &str, values| Column { name: name.into(), values };
    Logged::even(Recording {
        sample_rate: SampleRate::new(RATE_HZ).unwrap(),
        experiment: "moves".into(),
        axes: vec!["x".into()],
        columns: vec![column(THRUST, thrust), column(POSITION, position), column(SPEED, speed)],
        start_s: 0.0,
        metadata: Vec::new(),
    })
}

fn gate(logged: &Logged) -> Gated {
    check(logged, &["x".to_owned()], &Criteria::default())
}

fn values<'a>(logged: &'a mut Logged, name: &str) -> &'a mut Vec<f64> {
    &mut logged.recording.columns.iter_mut().find(|c| c.name == name).unwrap().values
}

/// Rows at which the drive of [`drive`] moves.
fn moving(logged: &Logged) -> Vec<usize> {
    let v = logged.recording.get(SPEED).unwrap();
    (500..v.len() - 500).filter(|i| v[*i].abs() > 0.03).collect()
}

fn even_times(logged: &mut Logged) {
    logged.times_s = (0..logged.recording.len()).map(|i| i as f64 / RATE_HZ).collect();
}

/// Rows put in (again) or taken out, with time counted as if nothing had happened.
fn with_rows(logged: &mut Logged, rows: impl Fn(usize) -> usize) {
    for column in &mut logged.recording.columns {
        let x = std::mem::take(&mut column.values);
        column.values = x.iter().enumerate().flat_map(|(i, v)| std::iter::repeat_n(*v, rows(i))).collect();
    }
    even_times(logged);
}

/// A fault in three sizes. `None`: there is no such size.
fn put(kind: FaultKind, size: usize, logged: &mut Logged) {
    let mut noise = Noise(100 + size as u64);
    let moving = moving(logged);
    let mut draw = |count: usize| -> Vec<usize> {
        (0..count)
            .map(|k| moving[noise.row(k * moving.len() / count, (k + 1) * moving.len() / count)])
            .collect()
    };
    let n = logged.recording.len();
    match kind {
        FaultKind::Held => {
            let rows = [6, 20, 100][size];
            for start in draw(5) {
                for name in [THRUST, POSITION, SPEED] {
                    let x = values(logged, name);
                    let held = x[start];
                    x[start..start + rows].fill(held);
                }
            }
        }
        FaultKind::LowerRate => {
            let k = [2, 5, 20][size];
            let x = values(logged, THRUST);
            (0..n).for_each(|i| x[i] = x[i / k * k]);
        }
        FaultKind::Doubled | FaultKind::Dropped => {
            let places = draw([1, 5, 20][size]);
            let there = if kind == FaultKind::Doubled { 2 } else { 0 };
            with_rows(logged, |i| if places.contains(&i) { there } else { 1 });
        }
        FaultKind::IrregularTime => {
            let jitter = [0.04, 0.1, 0.4][size] / RATE_HZ;
            let mut noise = Noise(5);
            logged.times_s.iter_mut().for_each(|t| *t += jitter * (noise.uniform() - 0.5));
        }
        FaultKind::Rounded => {
            let step = [5e-4, 1e-3, 1e-2][size];
            values(logged, POSITION).iter_mut().for_each(|x| *x = (*x / step).round() * step);
        }
        FaultKind::Outlier => {
            let off = [15.0, 40.0, 120.0][size];
            draw(5).into_iter().for_each(|i| values(logged, THRUST)[i] += off);
        }
        FaultKind::LongRest => {
            let rest = n * [2, 3, 6][size];
            for name in [THRUST, POSITION, SPEED] {
                let x = values(logged, name);
                let last = if name == POSITION { x[n - 1] } else { 0.0 };
                x.extend((0..rest).map(|_| last + if name == THRUST { 0.3 * noise.normal() } else { 0.0 }));
            }
            even_times(logged);
        }
        other => put_values(other, size, logged),
    }
}

/// Faults of the values of one column, wherever they are.
fn put_values(kind: FaultKind, size: usize, logged: &mut Logged) {
    let n = logged.recording.len();
    match kind {
        FaultKind::Clipped => {
            let x = values(logged, THRUST);
            let most = [0.8, 0.7, 0.5][size] * x.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            x.iter_mut().for_each(|v| *v = v.clamp(-most, most));
        }
        FaultKind::Rectified => {
            let offset = [0.0, 3.0, 8.0][size];
            values(logged, THRUST).iter_mut().for_each(|v| *v = (*v + offset).abs());
        }
        FaultKind::WrongSign => values(logged, THRUST).iter_mut().for_each(|v| *v = -*v),
        FaultKind::Swapped => {
            let x = std::mem::take(values(logged, THRUST));
            let x = std::mem::replace(values(logged, POSITION), x);
            *values(logged, THRUST) = x;
        }
        FaultKind::WrongScale => {
            let times = [1.03, 1.2, 60.0][size];
            values(logged, SPEED).iter_mut().for_each(|v| *v *= times);
        }
        FaultKind::ClockOffset => {
            let late = [4, 8, 20][size];
            values(logged, THRUST).rotate_right(late);
        }
        FaultKind::Smoothed => {
            let k = [5, 9, 20][size];
            let x = values(logged, SPEED);
            let mean = |i: usize| x[(i + 1).saturating_sub(k)..=i].iter().sum::<f64>() / k.min(i + 1) as f64;
            *x = (0..n).map(mean).collect();
        }
        FaultKind::MainsLine => {
            let high = [1.0, 2.0, 6.0][size];
            let x = values(logged, THRUST);
            (0..n).for_each(|i| x[i] += high * (std::f64::consts::TAU * 50.0 * i as f64 / RATE_HZ).sin());
        }
        FaultKind::Empty => values(logged, THRUST).fill([0.0, 1.5, -7.0][size]),
        other => unreachable!("{} changes rows", other.name()),
    }
}

/// Column that has the fault.
fn column_of(kind: FaultKind) -> &'static str {
    use FaultKind::*;
    match kind {
        Held | LowerRate | Clipped | Outlier | Rectified | WrongSign | Swapped | ClockOffset | MainsLine
        | Empty => THRUST,
        Doubled | Dropped | Rounded | LongRest => POSITION,
        WrongScale | Smoothed => SPEED,
        IrregularTime => "t_s",
    }
}

fn named(faults: &[Fault]) -> Vec<(&'static str, &str)> {
    faults.iter().map(|f| (f.kind.name(), f.column.as_str())).collect()
}

#[test]
fn a_sound_recording_has_no_fault() {
    let logged = drive();
    let gated = gate(&logged);
    assert_eq!(named(&gated.faults), vec![]);
    assert_eq!(gated.recording, logged.recording, "and is left as it was");
    assert!(gated.usable.iter().all(|u| *u));
}

#[test]
fn each_fault_is_told_in_three_sizes_by_name_and_column() {
    let mut complaints = Vec::new();
    for kind in FaultKind::ALL {
        for size in 0..3 {
            let mut logged = drive();
            put(kind, size, &mut logged);
            let gated = gate(&logged);
            let told = named(&gated.faults);
            if !told.contains(&(kind.name(), column_of(kind))) {
                complaints.push(format!("{} {size}: {told:?}", kind.name()));
            }
            for fault in &gated.faults {
                assert!((0.0..=1.0).contains(&fault.share) && fault.share > 0.0, "{fault:?}");
                assert!(fault.time_s.iter().all(|[a, b]| a <= b), "{fault:?}");
            }
        }
    }
    assert!(complaints.is_empty(), "{complaints:#?}");
}

/// A position that stands while a motion ends: it moved before, and is at rest elsewhere behind.
#[test]
fn a_hold_in_which_a_motion_ends_is_told() {
    let mut logged = drive();
    let x = logged.recording.get(POSITION).unwrap().to_vec();
    let ends = (400..x.len() - 400).find(|i| {
        x[*i..i + 40].iter().all(|v| v == &x[*i]) && x[i - 12..*i].windows(2).all(|w| w[0] != w[1])
    });
    let last = ends.unwrap() + 5;
    let first = last - 80;
    let position = logged.recording.columns.iter_mut().find(|c| c.name == POSITION).unwrap();
    position.values[first..last].fill(x[first]);
    let gated = gate(&logged);
    let told: Vec<&str> = named(&gated.faults).iter().filter(|f| f.0 == "held").map(|f| f.1).collect();
    assert!(told.contains(&POSITION), "{:?}", gated.faults);
    assert!(gated.usable[first + 1..last].iter().all(|u| !u));
}

/// A logger that stands while a motion begins: the position was at rest before, and is elsewhere behind.
#[test]
fn a_hold_in_which_a_motion_begins_is_told() {
    let mut logged = drive();
    let x = logged.recording.get(POSITION).unwrap();
    let begins =
        (400..x.len() - 400).find(|i| x[i - 40..*i].iter().all(|v| v == &x[i - 1]) && x[*i] != x[i - 1]);
    let first = begins.unwrap() - 10;
    for column in &mut logged.recording.columns {
        let kept = column.values[first];
        column.values[first..first + 80].fill(kept);
    }
    let gated = gate(&logged);
    let told: Vec<&str> = named(&gated.faults).iter().filter(|f| f.0 == "held").map(|f| f.1).collect();
    assert!(told.contains(&THRUST) && told.contains(&POSITION), "{:?}", gated.faults);
    assert!(
        gated.usable[first + 1..first + 80].iter().all(|u| !u)
            && gated.usable[first + 90..first + 200].iter().all(|u| *u)
    );
}

#[test]
fn what_cannot_be_judged_is_refused_and_the_rest_is_not() {
    for kind in FaultKind::ALL {
        let mut logged = drive();
        put(kind, 1, &mut logged);
        let refused = gate(&logged).refusal().is_some();
        let expected = matches!(kind, FaultKind::Rectified | FaultKind::Swapped | FaultKind::Empty);
        assert_eq!(refused, expected, "{}", kind.name());
    }
}

#[test]
fn a_clock_and_a_sign_are_put_right() {
    let sound = drive().recording;
    let truth = sound.get(THRUST).unwrap();
    for kind in [FaultKind::ClockOffset, FaultKind::WrongSign] {
        let mut logged = drive();
        put(kind, 1, &mut logged);
        let gated = gate(&logged);
        assert!(gated.faults.iter().any(|f| f.kind == kind && f.action == Action::Correct));
        let mended = gated.recording.get(THRUST).unwrap();
        let off = (100..truth.len() - 100).map(|i| (mended[i] - truth[i]).powi(2)).sum::<f64>();
        let rms = (off / (truth.len() - 200) as f64).sqrt();
        assert!(rms < 2.0, "{}: {rms} N off", kind.name());
    }
}

#[test]
fn missing_and_doubled_rows_leave_the_motion_as_it_was() {
    let sound = drive().recording;
    let truth = sound.get(POSITION).unwrap();
    for kind in [FaultKind::Doubled, FaultKind::Dropped] {
        let mut logged = drive();
        put(kind, 2, &mut logged);
        let gated = gate(&logged);
        let mended = gated.recording.get(POSITION).unwrap();
        assert_eq!(mended.len(), truth.len(), "{}", kind.name());
        let worst = mended.iter().zip(truth).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-5, "{}: {worst} m off", kind.name());
    }
}

#[test]
fn a_block_of_rows_that_stands_there_twice_is_taken_out() {
    let sound = drive();
    let mut logged = drive();
    let moving = moving(&logged);
    let block = moving[moving.len() / 3]..moving[moving.len() / 3] + 10;
    for column in &mut logged.recording.columns {
        let again = column.values[block.clone()].to_vec();
        column.values.splice(block.end..block.end, again);
    }
    even_times(&mut logged);
    let gated = gate(&logged);
    assert_eq!(named(&gated.faults), vec![("doubled", POSITION)]);
    assert_eq!(gated.recording.get(POSITION), sound.recording.get(POSITION));
}

fn bare(mass_kg: f64) -> Machine {
    let raw = RawDriveParams { movable_mass_kg: Some(mass_kg), ..Default::default() };
    let drive = DriveParams::new(raw).unwrap();
    let axis = AxisModel { name: "x".into(), drive, controller: None, physics: Vec::new() };
    Machine { name: "bare".into(), sample_rate: SampleRate::new(RATE_HZ).unwrap(), axes: vec![axis] }
}

fn diagnosed(gated: Gated, mass_kg: f64) -> Diagnosis {
    let options = DiagnoseOptions { masked: vec![gated.masked()], ..Default::default() };
    diagnose_with(&bare(mass_kg), &[gated.recording], &options, &|_, _| ()).unwrap()
}

/// A number of the laws that every such drive has.
fn number(diagnosis: &Diagnosis, name: &str) -> f64 {
    let of = diagnosis.findings.iter().flat_map(|f| &f.parameters);
    of.clone().find(|p| p.name == name).map_or(f64::NAN, |p| p.value)
}

#[test]
fn the_laws_are_those_of_the_sound_recording() {
    let sound = diagnosed(gate(&drive()), MASS_KG);
    use FaultKind::{Clipped, Dropped, Held, LongRest, Outlier, WrongSign};
    for kind in [Held, Dropped, Outlier, WrongSign, LongRest, Clipped] {
        let mut logged = drive();
        put(kind, 2, &mut logged);
        let found = diagnosed(gate(&logged), MASS_KG);
        assert_eq!(found.recordings.len(), 1, "one entry a recording");
        for name in ["force_n", "n_s_m"] {
            let (a, b) = (number(&sound, name), number(&found, name));
            assert!((b / a - 1.0).abs() < 0.1, "{}: {name} {b}, sound {a}", kind.name());
        }
    }
}

/// Holds, and rows that are missing, take strokes out of their rhythm: what seems to repeat then does not.
#[test]
fn the_measured_axis_is_sound_and_holds_or_gaps_in_it_change_no_law() {
    let Some(path) = shared("recordings/emps/axis.parquet") else { return };
    let logged = stillcut::recording::read_logged(&path).unwrap();
    let sound = gate(&logged);
    assert_eq!(named(&sound.faults), vec![]);
    let sound = diagnosed(sound, 95.1);
    let laws = |d: &Diagnosis| {
        let mut names: Vec<&str> = d.findings.iter().map(|f| f.effect.name()).collect();
        names.sort_unstable();
        names.into_iter().map(str::to_owned).collect::<Vec<String>>()
    };
    let places = [2000, 7300, 12_500, 17_000, 21_200];
    let mut held = logged.clone();
    for column in &mut held.recording.columns {
        for start in places {
            let value = column.values[start];
            column.values[start..start + 100].fill(value);
        }
    }
    let mut gaps = logged;
    with_rows(&mut gaps, |i| usize::from(!places.iter().any(|p| (*p..p + 10).contains(&i))));
    for logged in [held, gaps] {
        let found = diagnosed(gate(&logged), 95.1);
        assert_eq!(laws(&found), laws(&sound));
        for name in ["force_n", "n_s_m"] {
            let (a, b) = (number(&sound, name), number(&found, name));
            assert!((b / a - 1.0).abs() < 0.08, "{name} {b}, of the sound recording {a}");
        }
    }
}

#[test]
fn simulated_axes_beside_the_project_have_no_fault() {
    let Some(folder) = shared("feed-axis-cases") else { return };
    for case in ["case-01", "case-06", "case-13"] {
        for file in ["moves.parquet", "idle.parquet"] {
            let logged = stillcut::recording::read_logged(&folder.join(case).join(file)).unwrap();
            assert_eq!(named(&gate(&logged).faults), vec![], "{case} {file}");
        }
    }
}

/// Stamps that were written unevenly of rows that were taken evenly: moved, every column would be rougher.
#[test]
fn uneven_stamps_of_even_rows_move_no_value() {
    let sound = drive().recording;
    let mut logged = drive();
    put(FaultKind::IrregularTime, 2, &mut logged);
    let gated = gate(&logged);
    assert!(gated.faults.iter().any(|f| f.kind == FaultKind::IrregularTime));
    assert_eq!(gated.recording.get(POSITION), sound.get(POSITION));
}

/// Two encoders of one axis, of 1 and 4 nm, and a current that follows the coarser one without noise: the gain
/// of its controller on how far the encoder went in the row.
fn followed() -> Logged {
    let (mut current, mut motor, mut stage) = (Vec::new(), Vec::new(), Vec::new());
    let mut before = 0.0;
    for i in 0..20_000 {
        let t = f64::from(i) / RATE_HZ;
        // From rest to a steady speed, with a slow swing and a faster one.
        let begun = (t - 1.0).max(0.0);
        let x =
            5e-4 * begun * (begun / 0.1).min(1.0) - 2e-5 * (4.0 * begun).cos() + 1e-8 * (211.0 * begun).sin();
        let seen = ((x + 2e-8) / 4e-9).round() * 4e-9;
        let rounded: f64 = seen - before;
        before = seen;
        current.push((1e5 * (0.02 + 1e-3 * (4.0 * t).sin() + 1e5 * (5e-7 - rounded))).round() * 1e-5);
        motor.push(seen);
        stage.push((x / 1e-9).round() * 1e-9);
    }
    let column = |name: &str, values| Column { name: name.into(), values };
    Logged::even(Recording {
        sample_rate: SampleRate::new(RATE_HZ).unwrap(),
        experiment: "moves".into(),
        axes: vec!["x".into()],
        columns: vec![
            column("x_current_ref_a", current),
            column(POSITION, motor),
            column("x_stage_position_m", stage),
        ],
        start_s: 0.0,
        metadata: Vec::new(),
    })
}

/// A controller repeats itself where its encoder goes on evenly, and kicks where it does not.
#[test]
fn a_current_that_follows_an_encoder_is_sound() {
    let logged = followed();
    let current = logged.recording.get("x_current_ref_a").unwrap();
    let longest = current.chunk_by(|a, b| a == b).map(<[f64]>::len).max().unwrap();
    assert!(longest > 2, "{longest}: it never repeats itself");
    assert_eq!(named(&gate(&logged).faults), vec![]);
    let mut spiked = followed();
    values(&mut spiked, "x_current_ref_a")[7000] += 0.3;
    assert_eq!(named(&gate(&spiked).faults), vec![("outlier", "x_current_ref_a")]);
}

/// A position that jumps out for single rows is as smooth as it was: it is in its place.
#[test]
fn outliers_of_a_position_make_no_force_of_it() {
    let mut logged = drive();
    let rows = moving(&logged);
    let position = values(&mut logged, POSITION);
    rows.iter().step_by(rows.len() / 7).for_each(|i| position[*i] += 1.0);
    assert_eq!(named(&gate(&logged).faults), vec![("outlier", POSITION)]);
}

/// A row is one of all columns: an encoder that alone seems to stand and to catch up has jitter.
#[test]
fn a_row_is_missing_in_both_encoders_or_not_at_all() {
    let mut logged = followed();
    let motor = values(&mut logged, POSITION);
    for x in &mut motor[5000..] {
        *x += 1e-6;
    }
    assert!(!named(&gate(&logged).faults).iter().any(|f| f.0 == "dropped"));
    let mut logged = followed();
    with_rows(&mut logged, |i| usize::from(i != 5000));
    assert!(named(&gate(&logged).faults).contains(&("dropped", POSITION)), "{:?}", gate(&logged).faults);
}

/// The later of two positions is the one with which the drive fits worse; what a soft spring is late by is
/// none of the clock's.
#[test]
fn a_late_position_is_moved_and_a_soft_spring_is_not() {
    let shifted = |column: &str, delay_rows: usize| {
        let mut logged = drive();
        let x = logged.recording.get(POSITION).unwrap().to_vec();
        let stage = Column { name: "x_stage_position_m".into(), values: x };
        logged.recording.columns.push(stage);
        let x = values(&mut logged, column);
        x.rotate_right(delay_rows);
        x[..delay_rows].fill(0.0);
        logged
    };
    for column in [POSITION, "x_stage_position_m"] {
        let gated = gate(&shifted(column, 5));
        let told = gated.faults.iter().find(|f| f.kind == FaultKind::ClockOffset && f.column == column);
        let told = told.unwrap_or_else(|| panic!("{:?}", gated.faults));
        assert_eq!(told.action, Action::Correct);
        assert!(told.statement.contains("5.0"), "{}", told.statement);
    }
    // A stage behind a spring and its damper: 25 Hz, 0.2 of the critical damping, thousand times a second.
    let mut logged = shifted(POSITION, 0);
    let x = logged.recording.get(POSITION).unwrap().to_vec();
    let (mut at, mut speed, omega, dt) = (x[0], 0.0, 25.0 * std::f64::consts::TAU, 1.0 / RATE_HZ);
    for (i, v) in values(&mut logged, "x_stage_position_m").iter_mut().enumerate() {
        let driven = if i > 0 { (x[i] - x[i - 1]) / dt } else { 0.0 };
        speed += dt * (omega * omega * (x[i] - at) + 0.4 * omega * (driven - speed));
        at += dt * speed;
        *v = (at / STEP_M).round() * STEP_M;
    }
    assert!(!named(&gate(&logged).faults).iter().any(|f| f.0 == "clock_offset"));
}

/// A force that leads its motion has another clock where that explains most of what is left, and not where a
/// force over the position is the rest of it.
#[test]
fn a_force_that_leads_is_another_clock_where_that_explains_most() {
    let early = |wave_n: f64| {
        let mut logged = drive();
        let x = logged.recording.get(POSITION).unwrap().to_vec();
        let u = values(&mut logged, THRUST);
        u.iter_mut().zip(&x).for_each(|(u, x)| *u += wave_n * (std::f64::consts::TAU * x / 0.05).sin());
        u.rotate_left(6);
        named(&gate(&logged).faults).contains(&("clock_offset", THRUST))
    };
    assert!(early(0.0));
    assert!(!early(60.0));
}

/// Where friction is nearly all of the drive its turns tell the time, though inertia is too little to. A spring
/// that is moved by a quarter of its period looks like friction.
#[test]
fn friction_alone_has_a_clock_and_a_spring_has_none() {
    let told = |force: &dyn Fn(f64, f64) -> f64, rows: usize| {
        let mut logged = drive();
        let x = logged.recording.get(POSITION).unwrap().to_vec();
        let speed = |i: usize| {
            let (from, to) = (i.saturating_sub(5), (i + 5).min(x.len() - 1));
            (x[to] - x[from]) * RATE_HZ / (to - from) as f64
        };
        let u = values(&mut logged, THRUST);
        for (i, u) in u.iter_mut().enumerate() {
            *u = force(x[i], speed(i)) + 0.5 * ((i * i) as f64).sin();
        }
        u.rotate_right(rows);
        named(&gate(&logged).faults).contains(&("clock_offset", THRUST))
    };
    let friction = |_: f64, v: f64| 40.0 * (v / 2e-3).tanh();
    assert!(told(&friction, 9));
    assert!(!told(&friction, 0));
    assert!(!told(&|x, _| 2000.0 * x, 0));
}

/// A screw winds up before its stage slides: where the stage is recorded beside the motor neither the friction that
/// turns later nor the stage is of another clock, in varied moves and in sines, and a clock is told beside it. Nor is
/// there one where the motor's position stands alone.
#[test]
fn friction_behind_a_screw_that_winds_up_has_no_clock() {
    let told = |logged: &Logged, (wound_m, rows): (f64, usize), has_stage: bool| {
        let mut logged = logged.clone();
        let x = logged.recording.get(POSITION).unwrap().to_vec();
        let (mut between, mut last, mut stage) = (0.0_f64, x[0], Vec::new());
        for (u, x) in values(&mut logged, THRUST).iter_mut().zip(&x) {
            between = (between + x - last).clamp(-wound_m, wound_m);
            last = *x;
            *u += 3.0 * COULOMB_N * (between / wound_m);
            stage.push(((x - between) / STEP_M).round() * STEP_M);
        }
        values(&mut logged, THRUST).rotate_right(rows);
        if has_stage {
            logged.recording.columns.push(Column { name: "x_stage_position_m".into(), values: stage });
        }
        gate(&logged).faults.into_iter().find(|f| f.kind == FaultKind::ClockOffset)
    };
    let swung = |hz: f64, size_m: f64| {
        let mut logged = drive();
        let w = std::f64::consts::TAU * hz;
        let rows = logged.recording.len();
        for i in 0..rows {
            let t_s = i as f64 / RATE_HZ;
            let (x, v) = (size_m * (w * t_s).sin(), size_m * w * (w * t_s).cos());
            let force = -MASS_KG * w * w * x + VISCOUS_N_S_M * v + COULOMB_N * (v / 1e-3).tanh();
            values(&mut logged, THRUST)[i] = force + 0.4 * ((i * i) as f64).sin();
            values(&mut logged, POSITION)[i] = (x / STEP_M).round() * STEP_M;
            values(&mut logged, SPEED)[i] = v;
        }
        logged
    };
    for logged in [drive(), swung(0.3, 0.1), swung(0.5, 0.05), swung(2.0, 0.01)] {
        for wound_m in [2e-5, 1e-4, 5e-4] {
            for has_stage in [true, false] {
                let none = told(&logged, (wound_m, 0), has_stage);
                assert!(none.is_none(), "{wound_m} m, {has_stage}: {none:?}");
            }
        }
    }
    // Half of a small swing is wound up: a shift in time takes all but a hundredth of that.
    let none = told(&swung(9.0, 1e-3), (5e-4, 0), true);
    assert!(none.is_none(), "{none:?}");
    let late = told(&drive(), (1e-5, 6), true).expect("six rows late");
    assert_eq!(late.column, THRUST);
    let late_ms: f64 = late.statement.split_whitespace().find_map(|w| w.parse().ok()).unwrap();
    assert!((late_ms - 6e3 / RATE_HZ).abs() < 1.5, "{}", late.statement);
}

/// The same of a motion of one frequency, in which a spring is a mass of the other sign.
#[test]
fn a_spring_that_swings_has_no_clock() {
    for hz in [5.0, 10.0] {
        let mut logged = drive();
        let swing = |i: usize| 0.01 * (std::f64::consts::TAU * hz * i as f64 / RATE_HZ).sin();
        for (i, x) in values(&mut logged, POSITION).iter_mut().enumerate() {
            *x = (swing(i) / STEP_M).round() * STEP_M;
        }
        for (i, u) in values(&mut logged, THRUST).iter_mut().enumerate() {
            *u = 4000.0 * swing(i) + 0.5 * ((i * i) as f64).sin();
        }
        let gated = gate(&logged);
        assert!(!named(&gated.faults).contains(&("clock_offset", THRUST)), "{hz} Hz: {:?}", gated.faults);
    }
}

/// Of two positions the one against which the drive works is turned, whichever it is.
#[test]
fn an_encoder_that_counts_the_other_way_round_is_turned() {
    const STAGE: &str = "x_stage_position_m";
    for column in [POSITION, STAGE] {
        let mut logged = drive();
        let x = logged.recording.get(POSITION).unwrap().to_vec();
        logged.recording.columns.push(Column { name: STAGE.into(), values: x.clone() });
        let turned = |gated: &Gated| {
            let of_signs = gated.faults.iter().filter(|f| f.kind == FaultKind::WrongSign);
            of_signs.map(|f| f.column.clone()).collect::<Vec<_>>()
        };
        assert!(turned(&gate(&logged)).is_empty());
        values(&mut logged, column).iter_mut().for_each(|v| *v = -*v);
        let gated = gate(&logged);
        assert_eq!(turned(&gated), [column]);
        assert_eq!(gated.recording.get(column).unwrap(), x);
    }
}

#[test]
fn a_force_in_the_place_of_the_second_position_is_told() {
    const STAGE: &str = "x_stage_position_m";
    let mut logged = drive();
    let x = logged.recording.get(POSITION).unwrap().to_vec();
    let force = std::mem::replace(values(&mut logged, THRUST), x);
    logged.recording.columns.push(Column { name: STAGE.into(), values: force });
    let refusal = gate(&logged).refusal().cloned().unwrap();
    assert_eq!((refusal.kind, refusal.column.as_str()), (FaultKind::Swapped, THRUST));
    assert!(refusal.statement.contains(STAGE), "{}", refusal.statement);
}

/// A line of the mains stands alone; of the lines of an excitation one lies there by chance.
#[test]
fn a_line_among_equals_is_no_line_of_the_mains() {
    let with = |lines: &[f64]| {
        let mut logged = drive();
        for (i, u) in values(&mut logged, THRUST).iter_mut().enumerate() {
            let t = i as f64 / RATE_HZ;
            *u += lines.iter().map(|f| 3.0 * (std::f64::consts::TAU * f * t).sin()).sum::<f64>();
        }
        named(&gate(&logged).faults).contains(&("mains_line", THRUST))
    };
    assert!(with(&[50.0]));
    assert!(!with(&[43.0, 50.0, 57.01, 64.02]));
}

/// An encoder has one step; a coarser one in one recording is that of its logger.
#[test]
fn a_step_that_one_recording_has_is_its_loggers() {
    let mut all = [drive(), drive()];
    values(&mut all[1], POSITION).iter_mut().for_each(|x| *x = (*x / 1e-6).round() * 1e-6);
    let mut gated: Vec<Gated> = all.iter().map(gate).collect();
    assert!(gated.iter().all(|g| g.faults.is_empty()));
    rounded_by_one(&mut gated, &["x".to_owned()]);
    assert_eq!(named(&gated[0].faults), vec![]);
    assert_eq!(named(&gated[1].faults), vec![("rounded", POSITION)]);
}
