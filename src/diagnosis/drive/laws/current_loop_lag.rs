//! A current loop of a bandwidth.

use super::*;
use crate::plant::effects::current_loop_lag::{BANDWIDTH, SPECIFICATION};

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| {
        // One that was found is a free number.
        if !search.has_command || search.balance.clock_moved || search.now.found_loop {
            return Vec::new();
        }
        let (shares, of_rad_s, in_place) = match search.now.path.loop_rad_s {
            Some(w) => (&[0.25, 0.4, 0.6, 0.85][..], w, false),
            None => (&[0.1, 0.2, 0.5, 1.2, 3.0][..], search.signals.rate_hz, search.now.found_delay),
        };
        let of = |share: &f64| CurrentLoop { rad_s: share * of_rad_s, in_place, quicker: false };
        shares.iter().map(|share| Hypothesis::new(Port::Current, of(share))).collect()
    },
    // A loop quicker than stated is a wrong number.
    faults: |search| {
        let asks = search.has_command && !search.balance.clock_moved && !search.now.found_loop;
        let stated_rad_s = search.now.path.loop_rad_s.filter(|_| asks);
        let of = |rad_s| CurrentLoop { rad_s, in_place: false, quicker: true };
        let quicker =
            |stated: f64| [1.2, 1.7, 3.0].map(|factor| Hypothesis::new(Port::Current, of(factor * stated)));
        stated_rad_s.map_or_else(Vec::new, |stated| quicker(stated).into())
    },
    key: |_, path, raw| {
        raw.current_loop_bandwidth_rad_s = path.loop_rad_s;
        true
    },
    ..Effect::of(&SPECIFICATION)
};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CurrentLoop {
    pub(crate) rad_s: f64,
    /// It takes its own lag off a dead time that was found.
    pub(crate) in_place: bool,
    /// Than stated: no lag that is missing, but a number.
    pub(crate) quicker: bool,
}

impl Law for CurrentLoop {
    fn facts(&self) -> Facts {
        let facts = Facts::of(EffectKind::CurrentLoopLag, Size::Dose, &[]);
        Facts { is_number: self.quicker, ..facts }
    }

    fn constants(&mut self) -> Vec<Free<'_>> {
        vec![Free::of(&mut self.rad_s, &BANDWIDTH)]
    }

    fn columns(&self, ground: &Ground<'_>, _: Port) -> Option<Vec<TimeColumn>> {
        Some(vec![ground.path_change(ground.path.with_loop(self.rad_s, self.in_place))])
    }

    /// In place of a dead time the second order of the lag is left: one of any bandwidth promises the same by
    /// some amplitude. None that is missing is quicker than stated.
    fn starts(&self, balance: &Balance) -> Vec<Shape> {
        if self.quicker {
            return Vec::new();
        }
        let stated_rad_s = balance.drive.current_loop_bandwidth_rad_s().unwrap_or(f64::INFINITY);
        let others = [0.25, 0.5, 1.4, 2.0, 2.8, 4.0].map(|factor| factor * self.rad_s);
        let slower = others.into_iter().filter(|rad_s| *rad_s < stated_rad_s);
        slower.map(|rad_s| Self { rad_s, ..*self }.into()).collect()
    }

    fn move_number(&self, now: &mut Standing, _: &Balance) -> bool {
        now.path = now.path.with_loop(self.rad_s, self.in_place);
        now.found_loop = true;
        true
    }
}
