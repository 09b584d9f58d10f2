//! A wave over the position whose length is told as an order of the motor.

use super::position_periodic_force::Wave;
use super::*;
use crate::plant::effects::position_periodic_force::ORDER;
use crate::plant::effects::torque_ripple::SPECIFICATION;

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| {
        let Some(lead_m) = search.signals.lead_m.filter(|_| search.signals.layout != Layout::Locked) else {
            return Vec::new();
        };
        let highest = lead_m / ORDER.bounds[1];
        let mut list = search.signals.motor_waves_m.clone();
        if search.two {
            list.extend(search.peaks_of_both(0, [highest, 0.5 * search.travel_m()]));
        } else {
            list.retain(|l| search.signals.is_of_turn(*l));
            list.extend(search.peaks(&search.plain(0), [highest, search.travel_m() * SHORTEST]));
        }
        list.extend(search.ways_of_lines().into_iter().filter(|l| search.signals.is_of_turn(*l)));
        let law = |wavelength_m| Wave { wavelength_m, of_motor: true };
        list.into_iter().map(|l| Hypothesis::new(Port::Motor, law(l))).collect()
    },
    ..Effect::of(&SPECIFICATION)
};

impl Signals {
    /// True where one position tells a wave from one of the guide: by how short it is, or since it cannot be
    /// told from what a motor does in a turn, more often than the screw's once or twice.
    pub(crate) fn is_of_turn(&self, wavelength_m: f64) -> bool {
        let Some(lead_m) = self.lead_m.filter(|_| self.layout != Layout::TwoPositions) else { return false };
        let [low, high] = self.travel_m();
        let resolved = 0.5 / (high - low);
        let of_motor = |m: &f64| 2.0 * m < lead_m && (1.0 / wavelength_m - 1.0 / m).abs() < resolved;
        wavelength_m < (high - low) * SHORTEST || self.motor_waves_m.iter().any(of_motor)
    }
}
