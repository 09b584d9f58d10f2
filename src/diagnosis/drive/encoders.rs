//! What the encoders of an axis read wrong, as they tell it of one another.
//!
//! Above the band of a balance, and of the axial resonance, motor and stage hardly move apart whatever the
//! drive is: what d = x_m - x_t has there is what they read, to a percent in closed loop. With h: all that
//! is above that band, x the position that an encoder reads, low-passed and without the error that is known,
//! p its signal period,
//!
//! ```text
//! h * d = sum_k a_k h * w_k(x) + noise,     w = sin, cos of 2 pi x / p and of 4 pi x / p
//! ```
//!
//! by least squares, the noise free in each block. The statistic is that of a balance: the worst of the gain
//! and of what is foretold of quarters and of recordings, against knockoffs: waves of longer periods. The
//! slow position makes the phase: steps of an encoder in it would go with its own steps in d. A balance sees
//! such an error up to its band alone, where the drive's own laws are, and an axis that is one mass up to a
//! tenth of that.
//! Checked by: tests::*, and in closed loop by `suite/diagnosis`.

use super::accepted::Accepted;
use super::evidence::price;
use super::laws::encoder_interpolation_error::Interpolation;
use super::laws::{Deviations, Hypothesis};
use super::model::is_other_size;
use super::recorded::{has_both_positions, position_at, position_column};
use super::rounding::QUARTERS;
use super::spectra::{FOLDS, LONGEST_BLOCK};
use super::subject::PASSES;
use crate::diagnosis::DiagnoseOptions;
use crate::diagnosis::criteria::Criteria;
use crate::diagnosis::kernel::{Action, Grid, Kernel};
use crate::diagnosis::two_cores::on_two_cores;
use crate::plant::effects::Port;
use crate::plant::effects::encoder_interpolation_error::EncoderError;
use crate::plant::effects::periodic::waves;
use crate::plant::machine::AxisModel;
use crate::sample::Recording;
use crate::signal::inner_products::dot;
use nalgebra::{Matrix4, Vector4};
use std::borrow::Cow;

/// The recordings with what their encoders read wrong taken off.
pub(super) struct Readings<'a> {
    pub(super) recordings: Cow<'a, [Recording]>,
    pub(super) errors: Vec<ReadError>,
}

/// The error inside a signal period of one encoder.
pub(super) struct ReadError {
    pub(super) law: Accepted,
    pub(super) deviations: Deviations,
    pub(super) evidence_nats: f64,
    pub(super) level_nats: f64,
    /// Root mean square of what both encoders differ by above the band, with it and without, m.
    pub(super) apart_m: [f64; 2],
    /// First amplitude that the model states, m.
    pub(super) stated_m: Option<f64>,
    curve: EncoderError,
}

impl ReadError {
    fn new(of: Signal, amplitudes: Vector4<f64>) -> Self {
        let law = Hypothesis::new(of.port, Interpolation::new(of.period_m));
        Self {
            law: Accepted::found(law, amplitudes.as_slice().to_vec()),
            deviations: Deviations::default(),
            evidence_nats: 0.0,
            level_nats: 0.0,
            apart_m: [0.0; 2],
            stated_m: of.stated.map(|a| a[0].hypot(a[1])),
            curve: EncoderError::new(of.period_m, amplitudes.as_slice()),
        }
    }

    /// True for one that the model states of another size.
    pub(super) fn is_other_size(&self) -> bool {
        let [sine_m, cosine_m] = [0, 1].map(|k| self.law.amplitudes[k]);
        let deviation_m = self.deviations.amplitudes.iter().take(2).fold(0.0_f64, |most, d| most.max(*d));
        let other = |m: f64| is_other_size(sine_m.hypot(cosine_m) / m, deviation_m / m);
        self.evidence_nats > self.level_nats && self.stated_m.is_some_and(other)
    }

    pub(super) fn port(&self) -> Port {
        self.law.hypothesis.port
    }

    /// What is read too much where `x_m` is read, m.
    fn at_read_m(&self, x_m: f64) -> f64 {
        let mut error_m = self.curve.at(x_m);
        for _ in 0..PASSES {
            let next_m = self.curve.at(x_m - error_m);
            let more_m = (next_m - error_m).abs();
            error_m = next_m;
            if more_m <= Criteria::STANDARD.exactness * error_m.abs() {
                break;
            }
        }
        error_m
    }

    /// The same along a recording, m; `None`: the encoder is not recorded.
    pub(super) fn along_m(&self, axis: &AxisModel, recording: &Recording) -> Option<Vec<f64>> {
        Some(position_at(axis, recording, self.port())?.into_iter().map(|x| self.at_read_m(x)).collect())
    }

    /// Takes it off a recording.
    fn put_right(&self, axis: &AxisModel, recording: &mut Recording) {
        let Some((name, m_per_unit)) = position_column(axis, recording, self.port()) else { return };
        for column in recording.columns.iter_mut().filter(|c| c.name == name) {
            let right = |v: &mut f64| *v -= self.at_read_m(*v * m_per_unit) / m_per_unit;
            column.values.iter_mut().for_each(right);
        }
    }
}

impl<'a> Readings<'a> {
    /// Looks at every encoder with a stated signal period that another one stands beside.
    pub(super) fn of(axis: &AxisModel, recordings: &'a [Recording], options: &DiagnoseOptions) -> Self {
        let mut out = Self { recordings: Cow::Borrowed(recordings), errors: Vec::new() };
        // A mean over rows has less of a wave the quicker it is.
        if options.averaged[1] > 1 || !recordings.iter().all(|r| has_both_positions(axis, r)) {
            return out;
        }
        let mut open = signals(axis);
        let count = open.len();
        out.errors.extend(open.iter().filter_map(|of| Some(ReadError::new(*of, of.stated?))));
        if !out.errors.is_empty() {
            out.recordings = Cow::Owned(out.put_right(axis, recordings));
        }
        while !open.is_empty() {
            let Some(pairs) = Pair::of_each(axis, &out.recordings, &options.masked) else { break };
            let asked = on_two_cores(&open, |of| Asked::new(&pairs, *of));
            let best = asked.into_iter().zip(&open).filter_map(|(a, of)| Some((a?, *of)));
            let best = best.max_by(|a, b| a.0.score_nats.total_cmp(&b.0.score_nats));
            let Some((asked, of)) = best else { break };
            let level_nats = asked.level_nats(&pairs, of, count);
            open.retain(|other| other.port != of.port);
            if asked.score_nats <= level_nats {
                continue;
            }
            out.errors.retain(|error| error.port() != of.port);
            if let Some(error) = out.refined((axis, recordings), of, &asked, &options.masked) {
                out.errors.push(ReadError { evidence_nats: asked.score_nats, level_nats, ..error });
            }
            out.recordings = Cow::Owned(out.put_right(axis, recordings));
        }
        out
    }

    /// The recordings as they came, without all errors.
    fn put_right(&self, axis: &AxisModel, recordings: &[Recording]) -> Vec<Recording> {
        let mut right = recordings.to_vec();
        for recording in &mut right {
            self.errors.iter().for_each(|error| error.put_right(axis, recording));
        }
        right
    }

    /// An error beside the others, its phase at the position that it leaves. `None`: it would read backwards
    /// somewhere.
    fn refined(
        &self,
        (axis, recordings): (&AxisModel, &[Recording]),
        of: Signal,
        asked: &Asked,
        masked: &[Vec<bool>],
    ) -> Option<ReadError> {
        let others = self.put_right(axis, recordings);
        let mut amplitudes = of.stated.unwrap_or_default();
        let (mut by, mut noise, mut apart_m) = (asked.fit.amplitudes, asked.fit.deviations(), asked.apart_m);
        for _ in 0..PASSES {
            amplitudes += by;
            let error = ReadError::new(of, amplitudes);
            let mut right = others.clone();
            right.iter_mut().for_each(|recording| error.put_right(axis, recording));
            let rest = Asked::new(&Pair::of_each(axis, &right, masked)?, of)?;
            (by, noise, apart_m) = (rest.fit.amplitudes, rest.fit.deviations(), rest.apart_m);
            if by.iter().zip(&noise).all(|(by, noise)| by.abs() < *noise) {
                break;
            }
        }
        amplitudes += by;
        let exact_m = Criteria::STANDARD.exactness * amplitudes.norm();
        let deviations = noise.iter().map(|d| d.hypot(exact_m)).collect();
        let error = ReadError::new(of, amplitudes);
        let deviations = Deviations { amplitudes: deviations, constants: Vec::new() };
        let apart_m = [asked.apart_m, apart_m];
        error.curve.reads_forwards().then_some(ReadError { deviations, apart_m, ..error })
    }

    /// Encoders that were put right.
    pub(super) fn ports(&self) -> Vec<Port> {
        self.errors.iter().map(ReadError::port).collect()
    }
}

/// The signals that an encoder divides, and the error in a period of them that the model states.
#[derive(Debug, Clone, Copy)]
struct Signal {
    port: Port,
    period_m: f64,
    stated: Option<Vector4<f64>>,
}

/// Those of each encoder of which a period is known.
fn signals(axis: &AxisModel) -> Vec<Signal> {
    let d = &axis.drive;
    let of_drive = [
        (Port::MotorEncoder, d.motor_encoder_signal_m()),
        (Port::StageEncoder, d.raw().stage_encoder_signal_period_m),
    ];
    let of = |(port, period_m): (Port, Option<f64>)| {
        let mut stated = axis.physics.iter().filter(|t| t.port == port).filter_map(EncoderError::of);
        match (stated.next(), stated.next()) {
            (None, _) => Some(Signal { port, period_m: period_m?, stated: None }),
            (Some(error), None) if error.wave().1.len() <= 2 => {
                let (period_m, waves) = error.wave();
                let two = Vector4::from_iterator(waves.iter().flatten().copied().chain([0.0; 4]).take(4));
                Some(Signal { port, period_m, stated: Some(two) })
            }
            // Two at one encoder, and further harmonics, stay in the balance.
            _ => None,
        }
    };
    let all: Vec<Signal> = of_drive.into_iter().filter_map(of).filter(|of| of.period_m > 0.0).collect();
    // Waves of one period say nothing of which encoder they are; a period as travel is as good as the lead.
    let alike =
        |ratio: f64| [0.5, 1.0, 2.0].iter().any(|n| (ratio / n - 1.0).abs() < Criteria::STANDARD.travel_off);
    match &all[..] {
        [motor, stage] if alike(motor.period_m / stage.period_m) => Vec::new(),
        _ => all,
    }
}

/// Both positions of a recording on one grid.
struct Pair {
    /// Low-passed, motor and stage, m.
    slow_m: [Vec<f64>; 2],
    /// h * d on the grid of what h leaves of those, m.
    quick_m: Vec<f64>,
    /// Rows of it that were measured, and all that the filters reach from them.
    open: Vec<bool>,
    low_pass: Kernel,
}

impl Pair {
    /// `None`: a recording has one position, or is shorter than the filters.
    fn of_each(axis: &AxisModel, recordings: &[Recording], masked: &[Vec<bool>]) -> Option<Vec<Self>> {
        let of =
            |(k, r): (usize, &Recording)| Self::new(axis, r, masked.get(k).map_or(&[][..], Vec::as_slice));
        recordings.iter().enumerate().map(of).collect()
    }

    fn new(axis: &AxisModel, recording: &Recording, masked: &[bool]) -> Option<Self> {
        let read = |port| position_at(axis, recording, port);
        let x_m = [read(Port::MotorEncoder)?, read(Port::StageEncoder)?];
        let rate_hz = recording.sample_rate.hz();
        let plain = Action { derivative: 0, advance_s: 0.0 };
        let low_pass = Kernel::low_pass(Criteria::STANDARD.band_share[0] * rate_hz, rate_hz, plain);
        let half = low_pass.half();
        let rows = recording.len().checked_sub(4 * half).filter(|rows| *rows >= LONGEST_BLOCK)?;
        let inner = Grid { first: half, step: 1, count: recording.len() - 2 * half };
        let slow = |x: &[f64]| -> Vec<f64> {
            let origin = x[0];
            let local: Vec<f64> = x.iter().map(|v| v - origin).collect();
            low_pass.apply(&local, inner).iter().map(|v| v + origin).collect()
        };
        let d: Vec<f64> =
            x_m[0].iter().zip(&x_m[1]).map(|(m, t)| (m - x_m[0][0]) - (t - x_m[1][0])).collect();
        let reached = |k: usize| masked.get(k..(k + 4 * half + 1).min(masked.len()));
        Some(Self {
            slow_m: [slow(&x_m[0]), slow(&x_m[1])],
            quick_m: above(&low_pass, &d[half..half + inner.count]),
            open: (0..rows).map(|k| !reached(k).is_some_and(|near| near.contains(&true))).collect(),
            low_pass,
        })
    }

    /// Inner products of h * d with the waves of an encoder, block by block.
    fn blocks(&self, recording: usize, Signal { port, period_m, .. }: Signal) -> Vec<Block> {
        // The stage is taken off in d.
        let (side, sign) = if port == Port::MotorEncoder { (0, 1.0) } else { (1, -1.0) };
        let of_wave = |w: &Vec<f64>| above(&self.low_pass, w).iter().map(|v| sign * v).collect();
        let mut columns: Vec<Vec<f64>> = waves(&self.slow_m[side], period_m).iter().map(of_wave).collect();
        columns.push(self.quick_m.clone());
        for column in &mut columns {
            column.iter_mut().zip(&self.open).filter(|(_, open)| !**open).for_each(|(v, _)| *v = 0.0);
        }
        let rows = self.open.len();
        let of = |k: usize| {
            let part = k * LONGEST_BLOCK..((k + 1) * LONGEST_BLOCK).min(rows);
            let product = |i: usize, j: usize| dot(&columns[i][part.clone()], &columns[j][part.clone()]);
            Block {
                recording,
                quarter: FOLDS * part.start / rows,
                rows: self.open[part.clone()].iter().filter(|open| **open).count() as f64,
                of_waves: Matrix4::from_fn(|i, j| product(i.min(j), i.max(j))),
                with_d: Vector4::from_fn(|i, _| product(i, 4)),
                of_d: product(4, 4),
            }
        };
        (0..rows.div_ceil(LONGEST_BLOCK)).map(of).filter(|b| b.rows > 0.0).collect()
    }
}

/// What a low-pass does not let through, where it has all of its length.
fn above(low_pass: &Kernel, x: &[f64]) -> Vec<f64> {
    let half = low_pass.half();
    let grid = Grid { first: half, step: 1, count: x.len() - 2 * half };
    low_pass.apply(x, grid).iter().zip(&x[half..]).map(|(low, all)| all - low).collect()
}

/// Inner products over some rows of one recording.
struct Block {
    recording: usize,
    quarter: usize,
    rows: f64,
    of_waves: Matrix4<f64>,
    with_d: Vector4<f64>,
    of_d: f64,
}

impl Block {
    /// Mean square of what amplitudes leave, m2.
    fn left_m2(&self, a: &Vector4<f64>) -> f64 {
        let sum = self.of_d - 2.0 * a.dot(&self.with_d) + a.dot(&(self.of_waves * a));
        sum.max(0.0) / self.rows
    }
}

/// Amplitudes by least squares, each block by its own noise.
struct LeastSquares {
    amplitudes: Vector4<f64>,
    /// Inverse of the information.
    covariance: Matrix4<f64>,
    /// Of each block that counts, m2.
    noise_m2: Vec<f64>,
}

/// Noise of each block: between its own and that of all, so that none is free of noise.
fn noise_m2(blocks: &[Block], a: &Vector4<f64>) -> Vec<f64> {
    let rows: f64 = blocks.iter().map(|b| b.rows).sum();
    let all_m2 = blocks.iter().map(|b| b.rows * b.left_m2(a)).sum::<f64>() / rows;
    blocks.iter().map(|b| 0.5 * (b.left_m2(a) + all_m2)).collect()
}

/// Amplitudes by the blocks that count, each with its noise, and the inverse of the information.
fn weighted<'a>(counted: impl Iterator<Item = (&'a Block, f64)>) -> Option<(Vector4<f64>, Matrix4<f64>)> {
    let none = (Matrix4::zeros(), Vector4::zeros());
    let (information, with_d) =
        counted.fold(none, |(i, w), (b, noise_m2)| (i + b.of_waves / noise_m2, w + b.with_d / noise_m2));
    let covariance = information.try_inverse()?;
    Some((covariance * with_d, covariance))
}

impl LeastSquares {
    /// `None`: the position moves too little for the waves to differ.
    fn new(blocks: &[Block]) -> Option<Self> {
        let mut out = Self {
            amplitudes: Vector4::zeros(),
            covariance: Matrix4::zeros(),
            noise_m2: noise_m2(blocks, &Vector4::zeros()),
        };
        for _ in 0..PASSES {
            if out.noise_m2.iter().any(|v| *v <= 0.0) {
                return None;
            }
            let counted = blocks.iter().zip(out.noise_m2.iter().copied());
            (out.amplitudes, out.covariance) = weighted(counted)?;
            out.noise_m2 = noise_m2(blocks, &out.amplitudes);
        }
        Some(out)
    }

    /// Of the amplitudes, m: noise is not white within a block.
    fn deviations(&self) -> Vector4<f64> {
        let c = &Criteria::STANDARD;
        self.covariance.diagonal().map(|v| c.serial * (v.max(0.0) / white_share()).sqrt())
    }
}

/// Rows that are independent of one another over all: what lies below the band of a balance is gone.
fn white_share() -> f64 {
    1.0 - 2.0 * Criteria::STANDARD.band_share[0]
}

/// The waves of one period, asked.
struct Asked {
    fit: LeastSquares,
    /// The worst of gain, quarters and recordings, less the price, nats.
    score_nats: f64,
    /// Root mean square of h * d, m.
    apart_m: f64,
}

impl Asked {
    fn new(pairs: &[Pair], of: Signal) -> Option<Self> {
        let each = pairs.iter().enumerate();
        let blocks: Vec<Block> = each.flat_map(|(k, pair)| pair.blocks(k, of)).collect();
        let fit = LeastSquares::new(&blocks)?;
        let none_m2 = noise_m2(&blocks, &Vector4::zeros());
        // Nats that amplitudes gain in a block.
        let gain = |k: usize, a: &Vector4<f64>| {
            let b: &Block = &blocks[k];
            let nats = |noise_m2: f64, a: &Vector4<f64>| noise_m2.ln() + b.left_m2(a) / noise_m2;
            0.5 * white_share() * b.rows * (nats(none_m2[k], &Vector4::zeros()) - nats(fit.noise_m2[k], a))
        };
        let all: f64 = (0..blocks.len()).map(|k| gain(k, &fit.amplitudes)).sum();
        let foretold = |part_of: &dyn Fn(&Block) -> usize, parts: usize| -> Option<f64> {
            let one = |part: usize| -> Option<f64> {
                let counted = || blocks.iter().zip(fit.noise_m2.iter().copied());
                let others = || counted().filter(|(b, _)| part_of(b) != part);
                // What stands still elsewhere foretells nothing here.
                let told = |(b, noise_m2): (&Block, f64)| b.of_waves.trace() / noise_m2;
                let told_of_all: f64 = counted().map(told).sum();
                if others().map(told).sum::<f64>() <= Criteria::STANDARD.exactness * told_of_all {
                    return Some(0.0);
                }
                let (a, _) = weighted(others())?;
                let own = (0..blocks.len()).filter(|k| part_of(&blocks[*k]) == part);
                Some(own.map(|k| gain(k, &a)).sum())
            };
            (0..parts).map(one).sum()
        };
        let quarters = foretold(&|b| b.quarter, FOLDS)?;
        let mut score_nats = all.min(quarters);
        if pairs.len() > 1 {
            score_nats = score_nats.min(foretold(&|b| b.recording, pairs.len())?);
        }
        let rows: f64 = blocks.iter().map(|b| b.rows).sum();
        let apart_m = (blocks.iter().map(|b| b.of_d).sum::<f64>() / rows).sqrt();
        Some(Self { fit, score_nats: score_nats - price(4, rows), apart_m })
    }

    /// What chance reaches: by the count of encoders, and by waves that are a quarter, a half and three
    /// quarters of a period longer.
    fn level_nats(&self, pairs: &[Pair], of: Signal, count: usize) -> f64 {
        let c = &Criteria::STANDARD;
        let by_count = (c.odds * count as f64).ln() * c.serial.powi(2);
        if self.score_nats <= by_count {
            return by_count;
        }
        let other = |more: &f64| Self::new(pairs, Signal { period_m: (1.0 + more) * of.period_m, ..of });
        let others = on_two_cores(&QUARTERS, other);
        others.iter().flatten().fold(by_count, |level, o| level.max(c.knockoff_factor * o.score_nats))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::chance::normal;
    use crate::plant::drive::{DriveParams, RawDriveParams};
    use crate::sample::Column;
    use crate::units::SampleRate;
    use std::f64::consts::TAU;

    const LEAD_M: f64 = 0.01;

    /// Signal periods of 10 um (1000 a turn) and 4 um.
    fn axis() -> AxisModel {
        let raw = RawDriveParams {
            screw_lead_m: Some(LEAD_M),
            movable_mass_kg: Some(100.0),
            motor_encoder_signals_per_rev: Some(1000.0),
            stage_encoder_signal_period_m: Some(4e-6),
            ..RawDriveParams::default()
        };
        let drive = DriveParams::new(raw).expect("a drive");
        AxisModel { name: "x".to_owned(), drive, controller: None, physics: Vec::new() }
    }

    fn curves([motor, stage]: [[f64; 4]; 2]) -> [EncoderError; 2] {
        [EncoderError::new(LEAD_M / 1000.0, &motor), EncoderError::new(4e-6, &stage)]
    }

    /// A stroke with a screw that winds, at 10 kHz; the stage 2 nm of noise; both read in steps.
    fn stroke(seconds: u32, curves: &[EncoderError; 2], steps_m: [f64; 2], way_m: f64) -> Recording {
        let mut chance = normal(3);
        let (mut angle, mut stage) = (Vec::new(), Vec::new());
        for k in 0..10_000 * seconds {
            let t = f64::from(k) * 1e-4;
            let x = way_m * (0.7 * t).sin() + 0.1 * way_m * (9.0 * t).sin();
            let motor = x + 1e-6 * (0.7 * t).cos() + 2e-8 * (TAU * 240.0 * t).sin();
            let still = x + 2e-9 * chance();
            let read = |k: usize, x: f64| ((x + curves[k].at(x)) / steps_m[k]).round() * steps_m[k];
            angle.push(read(0, motor) * TAU / LEAD_M);
            stage.push(read(1, still));
        }
        let column = |name: &str, values| Column { name: name.to_owned(), values };
        Recording {
            sample_rate: SampleRate::new(10_000.0).expect("a rate"),
            experiment: "stroke".to_owned(),
            axes: vec!["x".to_owned()],
            columns: vec![column("x_motor_angle_rad", angle), column("x_stage_position_m", stage)],
            start_s: 0.0,
            metadata: Vec::new(),
        }
    }

    const WRONG: [[f64; 4]; 2] = [[3e-8, 1e-8, 4e-9, 0.0], [-1.2e-8, 5e-9, 0.0, 3e-9]];

    #[test]
    fn each_encoder_is_told_by_the_other_through_steps_longer_than_its_error() {
        let (axis, options) = (axis(), DiagnoseOptions::default());
        let recordings = [2, 3].map(|s| stroke(s, &curves(WRONG), [2e-8, 8e-8], 0.01));
        let found = Readings::of(&axis, &recordings, &options);
        assert_eq!(found.errors.len(), 2, "{:?}", found.ports());
        for error in &found.errors {
            let side = usize::from(error.port() == Port::StageEncoder);
            for k in 0..4 {
                let off_m = (error.law.amplitudes[k] - WRONG[side][k]).abs();
                let deviation_m = error.deviations.amplitudes[k];
                assert!(
                    off_m < 3.0 * deviation_m && deviation_m < 1e-9,
                    "{side} {k} {off_m:e} {deviation_m:e}"
                );
            }
        }
        // What the balance gets: as without the errors, but for the steps.
        let right = stroke(3, &curves([[0.0; 4]; 2]), [2e-8, 8e-8], 0.01);
        let off: Vec<f64> = found.recordings[1].columns[1]
            .values
            .iter()
            .zip(&right.columns[1].values)
            .map(|(a, b)| a - b)
            .collect();
        let rms_m = (dot(&off, &off) / off.len() as f64).sqrt();
        assert!(rms_m < 1.05 * 8e-8 / 6.0_f64.sqrt(), "{rms_m:e}");
    }

    #[test]
    fn encoders_that_read_right_are_left_as_they_are() {
        let (axis, options) = (axis(), DiagnoseOptions::default());
        // Over a stroke, and creeping over few signal periods, step by step.
        for way_m in [0.01, 5e-6, 2e-7] {
            let recordings = [stroke(3, &curves([[0.0; 4]; 2]), [2e-8, 8e-8], way_m)];
            let found = Readings::of(&axis, &recordings, &options);
            assert!(found.errors.is_empty() && found.recordings[0] == recordings[0], "{way_m}");
        }
    }

    #[test]
    fn rows_that_were_not_measured_tell_nothing() {
        let axis = axis();
        let wrong = stroke(4, &curves(WRONG), [1e-9; 2], 0.01);
        let right = stroke(4, &curves([[0.0; 4]; 2]), [1e-9; 2], 0.01);
        let mut mixed = right;
        for (column, of) in mixed.columns.iter_mut().zip(&wrong.columns) {
            column.values[10_000..30_000].copy_from_slice(&of.values[10_000..30_000]);
        }
        let masked = vec![(0..40_000).map(|k| (10_000..30_000).contains(&k)).collect()];
        let options = DiagnoseOptions { masked, ..DiagnoseOptions::default() };
        assert!(Readings::of(&axis, &[mixed.clone()], &options).errors.is_empty());
        // One encoder, and positions that were averaged: nobody tells.
        mixed.columns.pop();
        assert!(Readings::of(&axis, &[mixed], &DiagnoseOptions::default()).errors.is_empty());
        let averaged = DiagnoseOptions { averaged: [1, 9], ..DiagnoseOptions::default() };
        assert!(Readings::of(&axis, &[wrong], &averaged).errors.is_empty());
    }
}
