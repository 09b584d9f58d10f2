//! A line of the mains in the recorded force, each recording with its own phase: no force, a fault.

use super::*;
use crate::plant::effects::external_disturbance::{FREQUENCY, SPECIFICATION};
use std::f64::consts::TAU;

pub(super) const EFFECT: Effect = Effect {
    // Within the 0.2 % that mains keep, where what is left has most.
    faults: |search| {
        let series = search.plain(0);
        let near = |hz: f64| {
            let of = |(r, x): (usize, &Vec<f64>)| Demodulated::new(search.signals, x, (hz, r));
            let all: Vec<Demodulated> = series.iter().enumerate().map(of).collect();
            let hz = hz + strongest_off(&all, Criteria::STANDARD.mains_off * hz);
            Hypothesis::new(Port::Current, Mains { hz })
        };
        let lines = [50.0, 60.0].into_iter().flat_map(|f| [1.0, 2.0, 3.0, 6.0].map(|k| f * k));
        lines.filter(|hz| *hz < search.signals.top_hz()).map(near).collect()
    },
    ..Effect::of(&SPECIFICATION)
};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Mains {
    hz: f64,
}

impl Law for Mains {
    fn facts(&self) -> Facts {
        let facts = Facts::of(EffectKind::ExternalDisturbance, Size::Free, &[]);
        Facts { is_number: true, is_of_one_recording: true, ..facts }
    }

    fn tell(&self, told: &Told<'_>, sheet: &mut Sheet) -> bool {
        sheet.constant(&FREQUENCY, self.hz, told.relative(0));
        true
    }

    /// Sine and cosine, of every recording its own.
    fn columns(&self, ground: &Ground<'_>, _: Port) -> Option<Vec<TimeColumn>> {
        let of = |own, f: fn(f64) -> f64| ground.in_recording(own, 0, |t_s| f(TAU * self.hz * t_s));
        let recordings = 0..ground.signals.tracks.len();
        Some(recordings.flat_map(|r| [of(r, f64::sin), of(r, f64::cos)]).collect())
    }

    fn fault(&self, amplitudes: &[f64], recording: usize) -> Option<ForceFaultKind> {
        let rms_n = rms(&amplitudes[2 * recording..2 * recording + 2]);
        Some(ForceFaultKind::MainsLine { frequency_hz: self.hz, rms_n })
    }
}
