//! Series from which the columns of hypotheses are built: waves, shifts, what an encoder, a lag, a gap or a
//! twist adds.

use super::kernel::{Action, Kernel};
use super::motion::{band_hz, thrust_delay_s};
use super::problem::{Column, Problem, Sides, stretch, stretch_rate};
use super::terms::lag_bandwidth;
use crate::plant::effects::Port;
use crate::plant::effects::coupling::{Torsion, after_backlash};
use crate::plant::effects::friction::sliding_direction;
use crate::plant::effects::periodic::wave;

/// Sine and cosine of each harmonic: sin, cos, sin 2, cos 2, ... from one evaluation by complex powers.
pub(super) fn waves(position_m: &[f64], wavelength_m: f64, harmonics: usize) -> Vec<Vec<f64>> {
    let first: (Vec<f64>, Vec<f64>) = position_m.iter().map(|x| wave(*x, wavelength_m)).unzip();
    let mut parts: Vec<Vec<f64>> = Vec::with_capacity(2 * harmonics);
    for order in 0..harmonics {
        let (s, c) = match order {
            0 => first.clone(),
            _ => next_harmonic((&parts[2 * order - 2], &parts[2 * order - 1]), (&first.0, &first.1)),
        };
        parts.extend([s, c]);
    }
    parts
}

/// Sine and cosine of the sum of two angles.
fn next_harmonic((s, c): (&[f64], &[f64]), (s1, c1): (&[f64], &[f64])) -> (Vec<f64>, Vec<f64>) {
    let four = || s.iter().zip(c).zip(s1.iter().zip(c1));
    let sines = four().map(|((s, c), (s1, c1))| s * c1 + c * s1).collect();
    let cosines = four().map(|((s, c), (s1, c1))| c * c1 - s * s1).collect();
    (sines, cosines)
}

pub(super) fn motor(x: Vec<f64>) -> Sides {
    Sides { motor: Some(x), stage: None }
}

/// Lagrange interpolation over six samples: x at k + shift.
pub(super) fn shifted(x: &[f64], shift_samples: f64) -> Vec<f64> {
    let whole = shift_samples.floor();
    let f = shift_samples - whole;
    let nodes = [-2.0, -1.0, 0.0, 1.0, 2.0, 3.0];
    let weights =
        nodes.map(|a| nodes.iter().filter(|b| **b != a).map(|b| (f - b) / (a - b)).product::<f64>());
    let n = x.len() as isize;
    let sum = |near: [f64; 6]| near.iter().zip(&weights).map(|(x, w)| w * x).sum::<f64>();
    (0..n)
        .map(|k| {
            let first = k + whole as isize - 2;
            let inside = usize::try_from(first).ok().and_then(|first| x.get(first..)?.first_chunk::<6>());
            inside.map_or_else(
                || sum(std::array::from_fn(|j| x[(first + j as isize).clamp(0, n - 1) as usize])),
                |near| sum(*near),
            )
        })
        .collect()
}

/// x(t) - x(t + shift).
pub(crate) fn difference(x: &[f64], shift_samples: f64) -> Vec<f64> {
    x.iter().zip(shifted(x, shift_samples)).map(|(a, b)| a - b).collect()
}

/// e = x(t) - x(t + shift) of position, velocity and acceleration.
pub(super) fn advanced_difference(side: &super::motion::Side, shift_samples: f64) -> [Vec<f64>; 3] {
    [
        difference(&side.position_m, shift_samples),
        difference(&side.velocity_m_s, shift_samples),
        difference(&side.accel_m_s2, shift_samples),
    ]
}

/// An encoder error and its derivatives, through masses, dampers and spring (sign of a column).
pub(super) fn encoder_sides(p: &Problem, port: Port, [e, e1, e2]: &[Vec<f64>; 3]) -> Sides {
    let m = &p.mechanics;
    let at_motor = port == Port::MotorEncoder;
    let (mass, damping) = if at_motor {
        (m.motor_mass_kg, m.motor_damping_n_s_m)
    } else {
        (m.stage_mass_kg, m.stage_damping_n_s_m)
    };
    let spring: Vec<f64> =
        e.iter().zip(e1).map(|(x, v)| m.stiffness_n_m * x + m.structural_damping_n_s_m * v).collect();
    let near = (0..e.len()).map(|k| -(mass * e2[k] + damping * e1[k] + spring[k])).collect();
    if at_motor {
        Sides { motor: Some(near), stage: Some(spring) }
    } else {
        Sides { motor: Some(spring), stage: Some(near) }
    }
}

/// One kernel for everything an encoder's error passes, to the side of its mass and to the other.
pub(super) fn encoder_kernels(p: &Problem, port: Port) -> (Kernel, Kernel) {
    let rate = p.motions.first().map_or(1.0, |m| m.rate_hz);
    let m = &p.mechanics;
    let at_motor = port == Port::MotorEncoder;
    let delay = if port == Port::MotorEncoder {
        p.drive.motor_encoder_delay_s()
    } else {
        p.drive.stage_encoder_delay_s()
    };
    let (mass, damping) = if at_motor {
        (m.motor_mass_kg, m.motor_damping_n_s_m)
    } else {
        (m.stage_mass_kg, m.stage_damping_n_s_m)
    };
    let k = |derivative| Kernel::low_pass(band_hz(rate), rate, Action { derivative, advance_s: delay });
    let (k0, k1, k2) = (k(0), k(1), k(2));
    let spring = k0.times(m.stiffness_n_m).plus(m.structural_damping_n_s_m, &k1);
    let near = k2.times(-mass).plus(-damping, &k1).plus(-1.0, &spring).then(&p.thinning.kernel);
    (near, spring.then(&p.thinning.kernel))
}

/// Slower loop filtered where the kernel has data; held at the edges.
pub(super) fn apply_inside(kernel: &Kernel, x: &[f64], grid: super::kernel::Grid) -> Vec<f64> {
    let half = kernel.half();
    if grid.first >= half {
        return kernel.apply(x, grid);
    }
    let inner = kernel.apply(x, super::kernel::Grid { first: half, step: 1, count: x.len() - 2 * half });
    (0..grid.count)
        .map(|j| inner[(grid.first + j * grid.step).saturating_sub(half).min(inner.len() - 1)])
        .collect()
}

pub(super) fn lag(p: &Problem, extra_s: f64) -> Column {
    let slower = lag_bandwidth(p, extra_s);
    let rate = p.motions.first().map_or(1.0, |m| m.rate_hz);
    let advance_s = -(thrust_delay_s(&p.drive, rate) + p.timing_s);
    let kernel =
        Kernel::of_held_reference(band_hz(rate), rate, advance_s, Some(slower)).then(&p.thinning.kernel);
    p.motions
        .iter()
        .map(|m| {
            let now = p.thinning.thin(&m.thrust_n);
            let slow = apply_inside(&kernel, &m.raw_reference_n, p.thinning.grid(m.len()));
            motor(now.iter().zip(&slow).map(|(a, b)| a - b).collect())
        })
        .collect()
}

/// A law of the stretch between the sides, of the positions as recorded: a low-pass before a corner or a cube
/// is not one after it. `law`: N from the stretch beyond the free one.
pub(super) fn coupling_law(p: &Problem, law: impl Fn(f64) -> f64) -> Column {
    let rate = p.motions.first().map_or(1.0, |m| m.rate_hz);
    let kernel = Kernel::low_pass(band_hz(rate), rate, Action { derivative: 0, advance_s: 0.0 })
        .then(&p.thinning.kernel);
    let (motor_late, stage_late) =
        (p.drive.motor_encoder_delay_s() * rate, p.drive.stage_encoder_delay_s() * rate);
    p.motions
        .iter()
        .zip(&p.free_stretch_m)
        .map(|(m, free)| {
            let at_motor = shifted(&m.motor.raw_m, motor_late);
            let at_stage = shifted(&m.stage.raw_m, stage_late);
            let free = |x: f64| m.stretch_zero_m + free + p.lead_error * (x - m.centre_m);
            let sides = at_motor.iter().zip(&at_stage);
            let force: Vec<f64> = sides.map(|(a, b)| law(a - b - free(*b))).collect();
            let force = apply_inside(&kernel, &force, p.thinning.grid(m.len()));
            Sides { stage: Some(force.iter().map(|f| -f).collect()), motor: Some(force) }
        })
        .collect()
}

/// What Coulomb friction of both sides gains when it turns over `ratio` times the stated speed.
pub(super) fn smoothing(p: &Problem, ratio: f64) -> Column {
    let vs = p.mechanics.smoothing_m_s;
    let gain = |f: f64, v: &[f64]| {
        v.iter().map(|v| f * (sliding_direction(*v, ratio * vs) - sliding_direction(*v, vs))).collect()
    };
    p.column(|m| Sides {
        motor: Some(gain(p.mechanics.motor_coulomb_n, &m.motor.velocity_m_s)),
        stage: Some(gain(p.mechanics.stage_coulomb_n, &m.stage.velocity_m_s)),
    })
}

pub(super) fn backlash(p: &Problem, gap_m: f64) -> Column {
    let k = p.mechanics.stiffness_n_m;
    coupling_law(p, |d| k * (after_backlash(d, gap_m) - d))
}

pub(super) fn torsion(p: &Problem, frequency_hz: f64, screw_share: f64, damping_ratio: f64) -> Column {
    let m0 = &p.mechanics;
    let screw = screw_share * m0.motor_mass_kg;
    let stiffness = Torsion::stiffness_of(frequency_hz, m0.motor_mass_kg - screw, screw);
    let t = Torsion {
        screw_mass_kg: screw,
        torsional_stiffness_n_m: stiffness,
        torsional_damping_n_s_m: 2.0 * damping_ratio * (stiffness * screw).sqrt(),
        axial_stiffness_n_m: m0.stiffness_n_m,
        axial_damping_n_s_m: m0.structural_damping_n_s_m,
    };
    p.column(|m| {
        let (d, d1) = (stretch(m), stretch_rate(m));
        let load: Vec<f64> = (0..m.len())
            .map(|k| {
                -screw * m.motor.accel_m_s2[k] - m0.stiffness_n_m * d[k] - m0.structural_damping_n_s_m * d1[k]
            })
            .collect();
        let [e, e1, e2] = t.response(&load, 1.0 / m.rate_hz);
        let spring: Vec<f64> =
            e.iter().zip(&e1).map(|(e, v)| m0.stiffness_n_m * e + m0.structural_damping_n_s_m * v).collect();
        Sides {
            motor: Some(spring.iter().zip(&e2).map(|(s, a)| s + screw * a).collect()),
            stage: Some(spring.iter().map(|s| -s).collect()),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::shifted;

    /// Fifth powers pass exactly where six samples are there; beyond the ends the last one is held.
    #[test]
    fn a_shift_is_that_of_the_polynomial() {
        let power = |t: f64| (0.1 * t).powi(5);
        let x: Vec<f64> = (0..40).map(|k| power(f64::from(k))).collect();
        for shift in [0.0, 0.3, -0.7, 2.6, -11.4, 100.0, -100.0] {
            let y = shifted(&x, shift);
            assert_eq!(y.len(), x.len());
            for (k, y) in y.iter().enumerate() {
                let t = k as f64 + shift;
                if (2.0..37.0).contains(&t) {
                    assert!((y - power(t)).abs() < 1e-9 * power(40.0), "{shift} {k}: {y} for {}", power(t));
                }
                if !(-3.0..42.0).contains(&t) {
                    assert!((y - x[if t < 0.0 { 0 } else { 39 }]).abs() < 1e-9 * power(40.0));
                }
            }
        }
    }
}
