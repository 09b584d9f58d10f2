//! A third inertia between motor and screw.

use super::*;
use crate::plant::effects::torsional_mode::{DAMPING, FREQUENCY, SHARE, SPECIFICATION, stiffness_of};
use rustfft::FftPlanner;
use std::f64::consts::{PI, TAU};

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| {
        let of = |hz| Hypothesis::new(Port::Coupling, ThirdInertia::at(hz, SHARE.usual));
        // An amplitude makes up for what an octave is off.
        frequencies_hz(search.balance).step_by(3).filter(|_| search.two).map(of).collect()
    },
    stated: |term, _| {
        let law = ThirdInertia {
            frequency_hz: term.value(&FREQUENCY)?,
            share: term.value(&SHARE).unwrap_or(SHARE.usual),
            damping: term.value(&DAMPING).unwrap_or(DAMPING.usual),
            of_parts: false,
        };
        Some((law.into(), vec![1.0]))
    },
    ..Effect::of(&SPECIFICATION)
};

/// Frequencies that are asked, in thirds of an octave.
fn frequencies_hz(balance: &Balance) -> impl Iterator<Item = f64> {
    let below_hz = 0.5 * balance.signals.rate_hz;
    let of = |third: i32| FREQUENCY.bounds[0] * (f64::from(third) / 3.0).exp2();
    (1..).map(of).take_while(move |hz| *hz < below_hz)
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ThirdInertia {
    frequency_hz: f64,
    share: f64,
    damping: f64,
    /// The model states screw and torsional stiffness, and frequency and share are made of these.
    of_parts: bool,
}

impl ThirdInertia {
    fn at(frequency_hz: f64, share: f64) -> Self {
        Self { frequency_hz, share, damping: DAMPING.usual, of_parts: false }
    }

    /// The coupling force less what the twist takes off it, and the motor's share of inertia.
    fn column(&self, ground: &Ground<'_>) -> TimeColumn {
        let m = &ground.mechanics;
        let screw_kg = self.share * m.motor_mass_kg;
        let motor_kg = m.motor_mass_kg - screw_kg;
        let k = stiffness_of(self.frequency_hz, motor_kg, screw_kg);
        let c = 2.0 * self.damping * (k * screw_kg).sqrt();
        let (spring, damper, twisted, turned) = (m.stiffness_n_m, m.structural_damping_n_s_m, k, c);
        // As a function of the positions, motor and stage.
        let operator = move |p: &Point| {
            let w = p.rad_s;
            let i = Complex::new(0.0, w);
            let axial = spring + damper * i;
            let load = [axial - screw_kg * w * w, -axial];
            let torsional = twisted + turned * i;
            let twist = load.map(|l| l / (torsional + axial - screw_kg * w * w));
            let motor = [0, 1].map(|k| torsional * twist[k] - load[k]);
            [motor[0], motor[1], axial * twist[0], axial * twist[1]]
        };
        let mut out =
            TimeColumn { sides: [Some(Vec::new()), Some(Vec::new())], operator: Some(Arc::new(operator)) };
        let mut planner = FftPlanner::new();
        let rate_hz = ground.signals.thin_rate_hz();
        for track in &ground.signals.tracks {
            let t = &track.thin;
            let load: Vec<f64> = (0..t.stretch.len())
                .map(|j| {
                    screw_kg * t.accel[0][j]
                        + m.structural_damping_n_s_m * t.stretch_rate[j]
                        + m.stiffness_n_m * t.stretch[j]
                })
                .collect();
            let n = (load.len() + 512).next_power_of_two();
            let mean = load.iter().sum::<f64>() / load.len().max(1) as f64;
            let mut spectrum: Vec<Complex<f64>> = load.iter().map(|v| Complex::new(v - mean, 0.0)).collect();
            // Beyond the end on a half cosine back to the beginning: no step rings into the recording.
            let ends = [spectrum.last(), spectrum.first()].map(|e| e.map_or(0.0, |v| v.re));
            let beyond = n - load.len();
            spectrum.extend((0..beyond).map(|j| {
                let part = 0.5 - 0.5 * (PI * (j as f64 + 0.5) / beyond as f64).cos();
                Complex::new(ends[0] + part * (ends[1] - ends[0]), 0.0)
            }));
            planner.plan_fft_forward(n).process(&mut spectrum);
            // Twist and its rate in one transform: real and imaginary part.
            for (i, value) in spectrum.iter_mut().enumerate() {
                let signed = if 2 * i <= n { i as f64 } else { i as f64 - n as f64 };
                let w = TAU * signed * rate_hz / n as f64;
                let dynamic = Complex::new(
                    k + m.stiffness_n_m - screw_kg * w * w,
                    w * (c + m.structural_damping_n_s_m),
                );
                let twist = *value / dynamic;
                *value = twist + Complex::new(0.0, 1.0) * (Complex::new(0.0, w) * twist);
            }
            planner.plan_fft_inverse(n).process(&mut spectrum);
            let still = mean / (k + m.stiffness_n_m);
            let (mut motor, mut stage) = (Vec::with_capacity(load.len()), Vec::with_capacity(load.len()));
            for (j, value) in spectrum.iter().take(load.len()).enumerate() {
                let (twist, rate) = (value.re / n as f64 + still, value.im / n as f64);
                motor.push(k * twist + c * rate - load[j]);
                stage.push(m.stiffness_n_m * twist + m.structural_damping_n_s_m * rate);
            }
            out.sides[0].get_or_insert_with(Vec::new).push(motor);
            out.sides[1].get_or_insert_with(Vec::new).push(stage);
        }
        out
    }
}

impl Law for ThirdInertia {
    fn facts(&self) -> Facts {
        let facts = Facts::of(EffectKind::TorsionalMode, Size::Whole, &[]);
        Facts { moves_with_numbers: true, trades: true, ..facts }
    }

    fn constants(&mut self) -> Vec<Free<'_>> {
        vec![
            Free::of(&mut self.frequency_hz, &FREQUENCY),
            Free::of(&mut self.share, &SHARE),
            Free::of(&mut self.damping, &DAMPING),
        ]
    }

    fn columns(&self, ground: &Ground<'_>, _: Port) -> Option<Vec<TimeColumn>> {
        Some(vec![self.column(ground)])
    }

    fn state_by_parts(&mut self) {
        self.of_parts = true;
    }

    /// Screw and torsional stiffness stay as they are.
    fn motor_moved(&mut self, from_kg: f64, to_kg: f64) {
        let screw_kg = self.share * from_kg;
        let k = stiffness_of(self.frequency_hz, from_kg - screw_kg, screw_kg);
        let motor_kg = to_kg - screw_kg;
        if self.of_parts && motor_kg > 0.0 {
            self.share = screw_kg / to_kg;
            self.frequency_hz = (k * to_kg / (motor_kg * screw_kg)).sqrt() / TAU;
        }
    }

    /// The amplitude on the grid made up for frequency and share, which trade along a valley with two ends.
    fn starts(&self, balance: &Balance) -> Vec<Shape> {
        let of = |share| frequencies_hz(balance).map(move |hz| Self::at(hz, share).into());
        [0.2, 0.35, SHARE.usual].into_iter().flat_map(of).collect()
    }
}
