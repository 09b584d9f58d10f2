//! sin, cos of x and of 2 x over the wavelength.

use super::*;
use crate::plant::effects::periodic::waves;
use crate::plant::effects::position_periodic_force::{ORDER, SPECIFICATION, WAVELENGTH};
use std::f64::consts::TAU;

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| {
        if search.signals.layout == Layout::Locked {
            return Vec::new();
        }
        let longest = longest_m(search.signals);
        let shortest = search.travel_m() * SHORTEST;
        // Waves of the screw itself, then peaks of what is left, with and without the weights of its bands: a
        // slow wave has made its own band worthless.
        let of_screw = search.signals.lead_m.into_iter().flat_map(|l| [l, 0.5 * l]);
        let of_screw = of_screw.filter(|l| (shortest..longest).contains(l));
        let found = search.peaks_of_both(search.signals.last(), [shortest, longest]);
        // What lasts while the axis moves at one speed is a wave over position as well.
        let all =
            of_screw.chain(found).chain(search.ways_of_lines()).filter(|l| !search.signals.is_of_turn(*l));
        all.map(|wavelength_m| Hypothesis::new(Port::Stage, Wave { wavelength_m, of_motor: false })).collect()
    },
    ..Effect::of(&SPECIFICATION)
};

/// Longest wavelength: what does not come again is no wave.
fn longest_m(signals: &Signals) -> f64 {
    let [low, high] = signals.travel_m();
    0.5 * (high - low)
}

/// Of the guide, or of the motor's torque.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Wave {
    pub(super) wavelength_m: f64,
    pub(super) of_motor: bool,
}

impl Law for Wave {
    fn facts(&self) -> Facts {
        let (motor, guide) = (EffectKind::TorqueRipple, EffectKind::PositionPeriodicForce);
        Facts::of(if self.of_motor { motor } else { guide }, Size::Free, &[])
    }

    fn tell(&self, told: &Told<'_>, sheet: &mut Sheet) -> bool {
        let lead_m = told.balance.drive.screw_lead_m().unwrap_or(TAU);
        match self.of_motor {
            true => sheet.constant(&ORDER, lead_m / self.wavelength_m, told.relative(0)),
            false => sheet.constant(&WAVELENGTH, self.wavelength_m, told.relative(0)),
        }
        sheet.wave((&AMPLITUDE_N, sheet.scale), told);
        true
    }

    fn write(&self, told: &Told<'_>, term: &mut PhysicsTerm) {
        term.push(&HARMONICS_N, ParameterValue::List(told.amplitudes.to_vec()));
    }

    fn constants(&mut self) -> Vec<Free<'_>> {
        vec![Free::of(&mut self.wavelength_m, &WAVELENGTH)]
    }

    fn full(&self, at: &At<'_>) -> Vec<Vec<f64>> {
        waves(at.x_m, self.wavelength_m)
    }

    fn repeated(&self, times: f64, _: &Signals) -> Option<Shape> {
        Some(Self { wavelength_m: self.wavelength_m / times, ..*self }.into())
    }

    /// It comes but once; or one position has it as another's; or most of the way it passes at more than half
    /// the rate of the log, which folds it: at an even speed it may be a constant there.
    fn is_void(&self, ground: &Ground<'_>, _: &[f64]) -> bool {
        let s = ground.signals;
        let speeds = || s.tracks.iter().flat_map(|t| &t.sides[s.last()].v_m_s).map(|v| v.abs());
        let seen_m_s = 0.5 * self.wavelength_m * s.rate_hz;
        let is_folded = speeds().filter(|v| *v > seen_m_s).sum::<f64>() > 0.5 * speeds().sum::<f64>();
        let one = s.layout != Layout::TwoPositions;
        let is_anothers = one && self.of_motor != s.is_of_turn(self.wavelength_m);
        is_folded || is_anothers || (one || !self.of_motor) && self.wavelength_m > longest_m(s)
    }

    /// The texture of a guide by itself.
    fn is_usual(&self, _: &Ground<'_>, dry_n: f64, amplitudes: &[f64]) -> bool {
        rms(amplitudes) * (amplitudes.len() as f64).sqrt() < Criteria::STANDARD.texture * dry_n
    }
}
