//! A thrust later than stated, or earlier, which is a wrong number; an encoder that answers later.

use super::super::columns::read_error_m;
use super::*;
use crate::plant::effects::dead_time::{EXTRA, SPECIFICATION};

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| {
        let mut list = Vec::new();
        if search.balance.clock_moved {
            return list;
        }
        let period_s = 1.0 / search.signals.rate_hz;
        // One that was found is a free number.
        if search.has_command && !search.now.found_delay {
            let late = |samples| Delay { extra_s: samples * period_s, early: false };
            list.extend([0.3, 0.8, 1.6, 3.0, 5.0].map(|s| Hypothesis::new(Port::Current, late(s))));
        }
        if search.two && search.balance.stage_later_s.is_none() {
            let law = EncoderDelay { extra_s: 0.5 / search.signals.rate_hz };
            list.extend([Port::MotorEncoder, Port::StageEncoder].map(|port| Hypothesis::new(port, law)));
        }
        list
    },
    // A force later than stated that its motion shows: a wrong number or another clock.
    faults: |search| {
        if !search.now.inertial || search.balance.clock_moved || search.now.found_delay {
            return Vec::new();
        }
        let of = |samples: f64| Delay { extra_s: samples / search.signals.rate_hz, early: true };
        [0.5, 1.5, 5.0, 15.0].map(|samples| Hypothesis::new(Port::Current, of(samples))).into()
    },
    key: |found, path, raw| {
        let of_drive = found.port == Port::Current;
        if of_drive {
            raw.amplifier_dead_time_s = Some(path.delay_s);
        }
        of_drive
    },
    ..Effect::of(&SPECIFICATION)
};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Delay {
    pub(crate) extra_s: f64,
    pub(crate) early: bool,
}

impl Delay {
    fn by_s(&self) -> f64 {
        if self.early { -self.extra_s } else { self.extra_s }
    }
}

fn tell(extra_s: f64, told: &Told<'_>, sheet: &mut Sheet) {
    let within = told.balance.timing_deviation_s(told.coulomb_n);
    sheet.add(&EXTRA, extra_s, within.hypot(extra_s * told.relative(0)));
}

impl Law for Delay {
    fn facts(&self) -> Facts {
        let facts = Facts::of(EffectKind::DeadTime, Size::Dose, &[]);
        Facts { is_number: self.early, ..facts }
    }

    fn tell(&self, told: &Told<'_>, sheet: &mut Sheet) -> bool {
        tell(self.extra_s, told, sheet);
        true
    }

    fn constants(&mut self) -> Vec<Free<'_>> {
        vec![Free::of(&mut self.extra_s, &EXTRA)]
    }

    fn columns(&self, ground: &Ground<'_>, _: Port) -> Option<Vec<TimeColumn>> {
        let path = ground.path;
        Some(vec![ground.path_change(Path { delay_s: path.delay_s + self.by_s(), ..path })])
    }

    fn move_number(&self, now: &mut Standing, balance: &Balance) -> bool {
        now.path.delay_s += self.by_s();
        now.found_delay = true;
        now.timing_s = Criteria::STANDARD.timing_usual / balance.signals.rate_hz;
        true
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct EncoderDelay {
    extra_s: f64,
}

impl Law for EncoderDelay {
    fn facts(&self) -> Facts {
        Facts::of(EffectKind::DeadTime, Size::Dose, &[])
    }

    fn tell(&self, told: &Told<'_>, sheet: &mut Sheet) -> bool {
        tell(self.extra_s, told, sheet);
        true
    }

    fn constants(&mut self) -> Vec<Free<'_>> {
        vec![Free::of(&mut self.extra_s, &EXTRA)]
    }

    fn full(&self, at: &At<'_>) -> Vec<Vec<f64>> {
        vec![read_error_m(at.x_m, self.extra_s * at.track.rate_hz)]
    }

    fn columns(&self, ground: &Ground<'_>, port: Port) -> Option<Vec<TimeColumn>> {
        Some(ground.encoder_later(port, self.extra_s))
    }

    /// When inside a sample an encoder is read.
    fn is_usual(&self, ground: &Ground<'_>, _: f64, _: &[f64]) -> bool {
        self.extra_s * ground.signals.rate_hz < Z95 * Criteria::STANDARD.timing_deviation
    }
}
