//! What the recording shows of a run: forces late and low-passed, with noise; angle, probe, conditions.

use super::bench::{SUBSTEPS, Shown};
use super::machine::{Moment, TrueCut};
use super::{RATE_HZ, STATED_BANDWIDTH_HZ, STATED_DELAY_S};
use crate::sample::{Column, Recording};
use crate::units::SampleRate;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::{FRAC_PI_8, PI};

/// Noise of the probe, m.
const PROBE_NOISE_M: f64 = 0.1e-6;

/// A second-order section.
struct Section {
    b: [f64; 3],
    a: [f64; 2],
}

/// Butterworth's fourth order, bilinear: s = (1 - 1/z)/(1 + 1/z) / tan(pi f/rate).
fn sections(bandwidth_hz: f64) -> [Section; 2] {
    let k = (PI * bandwidth_hz / RATE_HZ).tan();
    [FRAC_PI_8, 3.0 * FRAC_PI_8].map(|angle| {
        let q = 2.0 * angle.cos();
        let over = 1.0 / (1.0 + q * k + k * k);
        let b = k * k * over;
        Section { b: [b, 2.0 * b, b], a: [2.0 * (k * k - 1.0) * over, (1.0 - q * k + k * k) * over] }
    })
}

/// A force as its signal shows it, from its values at every step. The noise of the sensor stands before the
/// low-pass, as in every estimate of a force.
fn shown(
    force: &dyn Fn(usize) -> f64,
    (steps, cut): (usize, &TrueCut),
    noise_n: &mut dyn FnMut() -> f64,
) -> Vec<f64> {
    let per_s = RATE_HZ * SUBSTEPS as f64;
    let delay = (STATED_DELAY_S + cut.hidden.signal_delay_s) * per_s;
    let rows = steps / SUBSTEPS;
    let bandwidth_hz = cut.hidden.signal_bandwidth_hz.unwrap_or(STATED_BANDWIDTH_HZ);
    let first = force(0);
    let mut out: Vec<f64> = (0..rows)
        .map(|row| {
            let place = (row * SUBSTEPS) as f64 - delay;
            if place < 0.0 {
                return first;
            }
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "not negative")]
            let before = place as usize;
            let t = place - before as f64;
            let at = |k: usize| force(k.min(steps - 1));
            // Newton's cubic: straight lines between steps would be a low-pass of their own.
            let [a, b, c, d] = [at(before.saturating_sub(1)), at(before), at(before + 1), at(before + 2)];
            b + t
                * ((c - b)
                    + (t - 1.0) * ((c - 2.0 * b + a) / 2.0 + (t + 1.0) * (d - 3.0 * c + 3.0 * b - a) / 6.0))
        })
        .collect();
    out.iter_mut().for_each(|f| *f += noise_n());
    for section in sections(bandwidth_hz) {
        let [mut x1, mut x2, mut y1, mut y2] = [first; 4];
        for value in &mut out {
            let x = *value;
            let y = section.b[0] * x + section.b[1] * x1 + section.b[2] * x2
                - section.a[0] * y1
                - section.a[1] * y2;
            (x2, x1, y2, y1) = (x1, x, y1, y);
            *value = y;
        }
    }
    out
}

/// The recording of a run.
pub(super) fn recording(
    name: &str,
    cut: &TrueCut,
    (moments, shows): (&[Moment], &[Shown]),
    probe: bool,
    random: &mut ChaCha8Rng,
) -> Recording {
    let rows = moments.len() / SUBSTEPS;
    let noise_n = random.random_range(0.3..1.5);
    let mut normal = |scale: f64| {
        let x: f64 = StandardNormal.sample(random);
        scale * x
    };
    let column = |name: &str, values: Vec<f64>| Column { name: name.to_owned(), values };
    let by_row =
        |f: &dyn Fn(&Moment) -> f64| (0..rows).map(|r| f(&moments[r * SUBSTEPS])).collect::<Vec<_>>();
    let mut columns = Vec::new();
    for tool in 0..if cut.two_tools { 2 } else { 1 } {
        let force = shown(&|k: usize| shows[k].force_n[tool], (moments.len(), cut), &mut || normal(noise_n));
        columns.push(column(&format!("tool{}_radial_force_n", tool + 1), force));
    }
    let angle = (0..rows).map(|r| shows[r * SUBSTEPS].angle_rad + normal(2e-4)).collect();
    columns.push(column("spindle_angle_rad", angle));
    columns.push(column("spindle_speed_rpm", by_row(&|m| m.speed_rpm)));
    columns.push(column("tool_position_m", by_row(&|m| m.position_m)));
    columns.push(column("pitch_difference_rad", by_row(&|m| m.pitch_rad)));
    columns.push(column("feed_m_rev", by_row(&|m| m.feed_m_rev)));
    columns.push(column("width_m", by_row(&|m| m.width_m)));
    if probe {
        let bar = (0..rows).map(|r| shows[r * SUBSTEPS].bar_m + normal(PROBE_NOISE_M)).collect();
        columns.push(column("workpiece_displacement_m", bar));
    }
    let metadata = [
        ("force_bandwidth_hz", STATED_BANDWIDTH_HZ),
        ("force_delay_s", STATED_DELAY_S),
        ("workpiece_diameter_m", cut.diameter_m),
        ("workpiece_projection_length_m", cut.length_m),
    ];
    Recording {
        sample_rate: SampleRate::new(RATE_HZ).unwrap_or_else(|_| unreachable!("9 kHz is a rate")),
        experiment: name.to_owned(),
        axes: Vec::new(),
        start_s: 0.0,
        columns,
        metadata: metadata.iter().map(|(k, v)| ((*k).to_owned(), format!("{v:?}"))).collect(),
    }
}
