//! Sine and cosine of two harmonics in what an encoder reads.

use super::*;
use crate::plant::effects::encoder_interpolation_error::{
    AMPLITUDE, EncoderError, HARMONICS, PERIOD, SPECIFICATION,
};
use crate::plant::effects::periodic::waves;

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| {
        let drive = &search.balance.drive;
        let of_stage = drive.raw().stage_encoder_signal_period_m.filter(|_| search.two);
        let all = [(Port::MotorEncoder, drive.motor_encoder_signal_m()), (Port::StageEncoder, of_stage)];
        let open = all.into_iter().filter(|(port, _)| !search.balance.read_right.contains(port));
        open.filter_map(|(port, period)| Some(Hypothesis::new(port, Interpolation::new(period?)))).collect()
    },
    stated: |term, _| {
        let error = EncoderError::of(term)?;
        let (period_m, harmonics) = error.wave();
        let [first, second] = [0, 1].map(|k| harmonics.get(k).copied().unwrap_or([0.0; 2]));
        let [sine_m, cosine_m] = first;
        Some((Interpolation { period_m, sine_m, cosine_m }.into(), [first, second].concat()))
    },
    ..Effect::of(&SPECIFICATION)
};

/// The first harmonic as it is known is taken off the position before the law is asked at it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Interpolation {
    period_m: f64,
    sine_m: f64,
    cosine_m: f64,
}

impl Interpolation {
    /// None of its size known.
    pub(crate) fn new(period_m: f64) -> Self {
        Self { period_m, sine_m: 0.0, cosine_m: 0.0 }
    }
}

impl Law for Interpolation {
    fn facts(&self) -> Facts {
        Facts::of(EffectKind::EncoderInterpolationError, Size::Free, &[])
    }

    fn tell(&self, told: &Told<'_>, sheet: &mut Sheet) -> bool {
        sheet.wave((&AMPLITUDE, 0.0), told);
        sheet.add(&PERIOD, self.period_m, 0.0);
        true
    }

    fn write(&self, told: &Told<'_>, term: &mut PhysicsTerm) {
        term.push(&HARMONICS, ParameterValue::List(told.amplitudes.to_vec()));
    }

    fn full(&self, at: &At<'_>) -> Vec<Vec<f64>> {
        let first = waves(at.x_m, self.period_m);
        if self.sine_m == 0.0 && self.cosine_m == 0.0 {
            return first;
        }
        let of = |(s, c): (&f64, &f64)| self.sine_m * s + self.cosine_m * c;
        let error: Vec<f64> = first[0].iter().zip(&first[1]).map(of).collect();
        let read = at.ground.signals.low_passed(&error);
        waves(&at.x_m.iter().zip(&read).map(|(x, e)| x - e).collect::<Vec<f64>>(), self.period_m)
    }

    fn columns(&self, ground: &Ground<'_>, port: Port) -> Option<Vec<TimeColumn>> {
        Some(ground.encoder(port, |track| self.full(&ground.at(port, track))))
    }

    fn is_void(&self, _: &Ground<'_>, amplitudes: &[f64]) -> bool {
        !EncoderError::new(self.period_m, amplitudes).reads_forwards()
    }

    fn follow(&mut self, amplitudes: &[f64]) {
        (self.sine_m, self.cosine_m) = (amplitudes[0], amplitudes[1]);
    }
}
