//! A wave over the position whose length is told as an order of the motor.

use super::position_periodic_force::Wave;
use super::*;
use crate::plant::effects::position_periodic_force::ORDER;
use crate::plant::effects::torque_ripple::SPECIFICATION;

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| {
        let Some(lead_m) = search.lead_m.filter(|_| search.signals.layout != Layout::Locked) else {
            return Vec::new();
        };
        let shortest = search.travel_m() * SHORTEST;
        let raw = search.balance.drive.raw();
        let poles = raw.motor_pole_count.into_iter().flat_map(|n| [0.5 * n, n]);
        let mut list: Vec<f64> = poles.chain(raw.motor_slot_count).map(|order| lead_m / order).collect();
        let highest = lead_m / ORDER.bounds[1];
        if search.two {
            list.extend(search.peaks_of_both(0, [highest, 0.5 * search.travel_m()]));
        } else {
            // One position tells what the motor does by how often it does it in a turn.
            list.retain(|l| *l < shortest);
            list.extend(search.peaks(&search.plain(0), [highest, shortest]));
        }
        list.extend(search.ways_of_lines().into_iter().filter(|l| search.is_of_turn(*l)));
        let law = |wavelength_m| Wave { wavelength_m, of_motor: true };
        list.into_iter().map(|l| Hypothesis::new(Port::Motor, law(l))).collect()
    },
    ..Effect::of(&SPECIFICATION)
};

impl Search<'_> {
    /// True for a wave over the position that is told from one of the guide by how short it is.
    pub(crate) fn is_of_turn(&self, wavelength_m: f64) -> bool {
        !self.two && self.lead_m.is_some() && wavelength_m < self.travel_m() * SHORTEST
    }
}
