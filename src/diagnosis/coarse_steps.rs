//! Encoders whose steps are coarser than the model states, as findings.

use super::assemble::Case;
use super::bench::rms;
use super::motion::{Motion, Side};
use super::result::{Contribution, Estimate, Finding, Fit};
use super::steps::stated_step_m;
use super::terms::Z95;
use crate::plant::effects::{EffectKind, ParameterValue, PhysicsTerm, Port};

impl Case<'_> {
    /// Encoders whose steps are coarser than the model states.
    pub(super) fn encoder_steps(&self) -> Vec<Finding> {
        let p = &self.outcome.state.problem;
        [Port::MotorEncoder, Port::StageEncoder]
            .into_iter()
            .zip(p.steps_m)
            .filter(|(port, step)| *step > stated_step_m(self.axis, *port))
            .map(|(port, step)| self.step_finding(port, step))
            .collect()
    }

    fn step_finding(&self, port: Port, step: f64) -> Finding {
        let p = &self.outcome.state.problem;
        let (evidence, deviation_m) = certainty(&p.motions, port, [step, stated_step_m(self.axis, port)]);
        let parameters = vec![Estimate {
            name: "step_m".to_owned(),
            value: step,
            unit: "m",
            ci95: [step - Z95 * deviation_m, step + Z95 * deviation_m],
        }];
        let rms_after = rms(&self.bench.heldout_residual(None));
        let contribution = p
            .motions
            .iter()
            .zip(self.recordings)
            .enumerate()
            .map(|(r, (m, recording))| {
                let side = read_by(m, port);
                let delay = if port == Port::MotorEncoder {
                    p.drive.motor_encoder_delay_s()
                } else {
                    p.drive.stage_encoder_delay_s()
                };
                let shift = (delay * m.rate_hz).round() as usize;
                // What was read, less the low-passed position at that instant.
                let error: Vec<f64> =
                    (0..m.len()).map(|k| side.raw_m[k] - side.position_m[k.saturating_sub(shift)]).collect();
                let value = (0..recording.len())
                    .map(|k| error[k.saturating_sub(m.offset).min(error.len() - 1)])
                    .collect();
                Contribution {
                    recording: r,
                    t_s: (0..recording.len()).map(|k| recording.time_s(k)).collect(),
                    value,
                }
            })
            .collect();
        let term = PhysicsTerm {
            effect: EffectKind::EncoderQuantization,
            port,
            parameters: vec![("step_m".to_owned(), ParameterValue::Number(step))],
        };
        Finding {
            fit: Fit {
                heldout_rms_before_n: rms_after,
                heldout_rms_after_n: rms_after,
                noise_floor_n: rms_after,
            },
            probability: 1.0 / (1.0 + (-0.5 * evidence).exp()),
            evidence,
            ..self.named((term, parameters), (&[], [rms_after; 2]), contribution)
        }
    }
}

fn read_by(m: &Motion, port: Port) -> &Side {
    if port == Port::MotorEncoder { &m.motor } else { &m.stage }
}

/// Twice the log-likelihood of a step before the stated one, and its deviation, m.
///
/// A reading that changes by whole steps of q does so on the stated grid q0 by chance of q0/q: ln(q/q0) a
/// change. The deviation is that of d = n q fitted to the changes d with their counts n, and of one change
/// at least what its readings are rounded to.
fn certainty(motions: &[Motion], port: Port, [step_m, stated_m]: [f64; 2]) -> (f64, f64) {
    let (mut changes, mut squares, mut counts) = (0.0_f64, 0.0, 0.0);
    let mut rounding_m = 0.0_f64;
    for m in motions {
        for w in read_by(m, port).raw_m.windows(2) {
            rounding_m = rounding_m.max(w[0].abs() * f64::EPSILON);
            let change = (w[1] - w[0]).abs();
            let count = (change / step_m).round();
            if count >= 1.0 {
                changes += 1.0;
                squares += (change - count * step_m).powi(2);
                counts += count * count;
            }
        }
    }
    let deviation_m = (squares / changes.max(1.0) / counts.max(1.0)).sqrt().max(rounding_m);
    (2.0 * changes * (step_m / stated_m).ln(), deviation_m)
}
