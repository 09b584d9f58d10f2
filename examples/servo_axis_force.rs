//! How good is a force estimated from the motor of a real axis, against a load cell in the same stroke?
//!
//! `cargo run --release --no-default-features --features cli --example servo_axis_force -- FOLDER`
//! with FOLDER the recordings `servo_log.parquet` (amplifier: speed, torque in % of rated) and
//! `load_cell_log.parquet` (force, its own clock).
//!
//! Force per % of torque, moved mass and friction are not published: they are fitted, and each eighth
//! of the stroke is judged by a fit to the other seven.

use nalgebra::{DMatrix, DVector};
use std::path::Path;
use stillcut::force::balance::Method;
use stillcut::force::estimator::ForceEstimator;
use stillcut::force::motion::MotionSample;
use stillcut::force::offline::estimate_run;
use stillcut::force::physics::physics_of;
use stillcut::force::settings::{ForceSettings, LowPass};
use stillcut::force::signals::{AxisSignals, Signals};
use stillcut::plant::drive::{DriveParams, RawDriveParams};
use stillcut::plant::effects::{EffectKind, ParameterValue, PhysicsTerm, Port};
use stillcut::recording::read_columns;
use stillcut::sample::{Column, Recording};
use stillcut::signal::butterworth::{Butterworth, zero_phase};
use stillcut::units::SampleRate;

/// By how much the load cell's clock is ahead, s: least residual of all shifts of half a millisecond.
const CLOCK_SHIFT_S: f64 = 7.5e-3;
const BAND_HZ: f64 = 60.0;
const PARTS: usize = 8;

struct Stroke {
    rate: SampleRate,
    torque_percent: Vec<f64>,
    velocity_m_s: Vec<f64>,
    travel_m: Vec<f64>,
    accel_m_s2: Vec<f64>,
    load_n: Vec<f64>,
    /// Samples where the load cell was recording.
    from: usize,
    to: usize,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(1).ok_or("usage: servo_axis_force FOLDER")?;
    let folder = Path::new(&folder);
    let servo = log(&folder.join("servo_log.parquet"))?;
    let cell = log(&folder.join("load_cell_log.parquet"))?;
    let stroke = stroke(&servo, &cell)?;
    println!("{:28} {:>12} {:>12}", "model of the axis", "error, N", "of the force");
    for (name, terms) in
        [("thrust", 1), ("dob: + mass", 2), ("dob: + viscous friction", 3), ("dob: + Coulomb friction", 4)]
    {
        let (error_n, share) = judged(&stroke, terms)?;
        println!("{name:28} {error_n:12.2} {:11.1} %", 100.0 * share);
    }
    Ok(())
}

/// A log as it was published: its rate is that of its times, its metadata says none.
fn log(path: &Path) -> Result<Recording, Box<dyn std::error::Error>> {
    let columns = read_columns(path)?;
    let times = columns.iter().find(|(name, _)| name == "t_s").map(|(_, t)| t).ok_or("no column t_s")?;
    let (Some(first), Some(last)) = (times.first(), times.last()) else { return Err("no rows".into()) };
    Ok(Recording {
        sample_rate: SampleRate::new((times.len() - 1) as f64 / (last - first))?,
        experiment: "stroke".to_owned(),
        axes: Vec::new(),
        start_s: *first,
        columns: columns.into_iter().map(|(name, values)| Column { name, values }).collect(),
        metadata: Vec::new(),
    })
}

fn stroke(servo: &Recording, cell: &Recording) -> Result<Stroke, Box<dyn std::error::Error>> {
    let rate = servo.sample_rate;
    let velocity_m_s = servo.require("carriage_velocity_m_s")?.to_vec();
    let load = cell.require("load_force_n")?;
    let at = |t_s: f64| {
        let place = ((t_s - cell.start_s) * cell.sample_rate.hz()).clamp(0.0, (load.len() - 2) as f64);
        let i = place as usize;
        load[i] + (place - i as f64) * (load[i + 1] - load[i])
    };
    let n = velocity_m_s.len();
    let mut travel_m = vec![0.0; n];
    for i in 1..n {
        travel_m[i] = travel_m[i - 1] + 0.5 * (velocity_m_s[i] + velocity_m_s[i - 1]) * rate.period_s();
    }
    let low = Butterworth::low_pass(2, BAND_HZ, rate)?;
    let accel: Vec<f64> = (0..n)
        .map(|i| (velocity_m_s[(i + 1).min(n - 1)] - velocity_m_s[i.saturating_sub(1)]) * 0.5 * rate.hz())
        .collect();
    let end_s = cell.time_s(cell.len() - 1) + CLOCK_SHIFT_S;
    Ok(Stroke {
        rate,
        torque_percent: zero_phase(&low, servo.require("motor_torque_percent_of_rated")?),
        accel_m_s2: zero_phase(&low, &accel),
        load_n: zero_phase(&low, &(0..n).map(|i| at(servo.time_s(i) - CLOCK_SHIFT_S)).collect::<Vec<_>>()),
        from: (0.02 * rate.hz()) as usize,
        to: ((end_s - 0.01) * rate.hz()) as usize,
        velocity_m_s,
        travel_m,
    })
}

/// Error on each part of the stroke by a fit to the others, through the estimator itself.
fn judged(s: &Stroke, terms: usize) -> Result<(f64, f64), Box<dyn std::error::Error>> {
    let part = (s.to - s.from) / PARTS;
    let (mut error, mut power, mut count) = (0.0, 0.0, 0.0);
    for k in 0..PARTS {
        let left_out = s.from + k * part..s.from + (k + 1) * part;
        let fitted = fit(s, terms, &left_out);
        let force = estimate(s, &fitted)?;
        for i in left_out {
            error += (force[i] - s.load_n[i]).powi(2);
            power += s.load_n[i].powi(2);
            count += 1.0;
        }
    }
    Ok(((error / count).sqrt(), (error / power).sqrt()))
}

/// Load = gain * torque - mass a - viscous v - coulomb tanh(v / v_s), least squares outside of `left_out`.
fn fit(s: &Stroke, terms: usize, left_out: &std::ops::Range<usize>) -> Vec<f64> {
    let rows: Vec<usize> = (s.from..s.to).filter(|i| !left_out.contains(i)).collect();
    let column = |i: usize| {
        [
            s.torque_percent[i],
            -s.accel_m_s2[i],
            -s.velocity_m_s[i],
            -(s.velocity_m_s[i] / SMOOTHING_M_S).tanh(),
        ]
    };
    let a = DMatrix::from_fn(rows.len(), terms, |r, c| column(rows[r])[c]);
    let b = DVector::from_iterator(rows.len(), rows.iter().map(|i| s.load_n[*i]));
    let mut fitted: Vec<f64> =
        a.svd(true, true).solve(&b, 1e-12).map(|x| x.iter().copied().collect()).unwrap_or_default();
    fitted.resize(4, 0.0);
    fitted
}

const SMOOTHING_M_S: f64 = 5e-3;

fn estimate(s: &Stroke, fitted: &[f64]) -> Result<Vec<f64>, Box<dyn std::error::Error>> {
    let term = |effect, name: &str, value: f64| PhysicsTerm {
        effect,
        port: Port::Stage,
        parameters: vec![(name.to_owned(), ParameterValue::Number(value))],
    };
    let physics = [
        term(EffectKind::ViscousFriction, "n_s_m", fitted[2]),
        term(EffectKind::CoulombFriction, "force_n", fitted[3]),
    ];
    // A mass below zero is no mass: the fit has none to give, the thrust alone is left.
    let raw = RawDriveParams {
        movable_mass_kg: Some(fitted[1].max(1e-6)),
        friction_smoothing_m_s: Some(SMOOTHING_M_S),
        ..RawDriveParams::default()
    };
    let (model, drive) = physics_of(&physics, &DriveParams::new(raw)?);
    let axis = AxisSignals { drive: &drive, rate: s.rate, signals: Signals::MotorOnly };
    let settings = ForceSettings {
        low_pass: LowPass::LinearPhase { pass_hz: BAND_HZ, width_hz: BAND_HZ },
        physics: Some(model),
        ..ForceSettings::default()
    };
    let estimator = ForceEstimator::new(Method::Dob, &axis, settings)?;
    let samples: Vec<MotionSample> = (0..s.velocity_m_s.len())
        .map(|i| MotionSample {
            thrust_ref_n: fitted[0] * s.torque_percent[i],
            motor_travel_m: Some(s.travel_m[i]),
            ..MotionSample::default()
        })
        .collect();
    let lag = (estimator.properties().delay_s * s.rate.hz()).round() as usize;
    let force: Vec<f64> = estimate_run(&estimator, &samples).iter().map(|e| e.force_n).collect();
    Ok((0..force.len()).map(|i| force[(i + lag).min(force.len() - 1)]).collect())
}
