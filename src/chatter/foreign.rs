//! Lines that were seen to move through the band as no chatter does: encoders, gears, whatever a feed drives.
//! They are followed for as long as they are heard, moving or at rest, and taken for what they are.

use super::baseline::Baseline;
use crate::signal::line_bank::{LineBank, LineBankState};

/// Lines that are followed at once: a line and its harmonic.
const LINES: usize = 2;
/// Filters on each side in which a line is looked for from one decision to the next.
const NEAR: usize = 1;
/// It is the same line while its power is within this of what it was, a decision's share of which follows:
/// 0.2 s.
const SAME: f64 = 4.0;
const FOLLOWS: f64 = 0.02;
/// It is lost after so many decisions (0.1 s) without it.
const LOST: u32 = 25;

/// What was seen to move must have gone on for so many decisions (0.5 s) by this share of its way: noise
/// beside a weak line moves it for a moment.
const PROVES: u32 = 125;
const GOES_ON: f64 = 0.3;
/// What has this much of the power that it was taken up with grows where it stands: 10 dB.
const GROWN: f64 = 10.0;

/// One line: frequency relative to the centre, power, decisions without it, whether more stands there now.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Followed {
    frequency_hz: f64,
    power_n2: f64,
    /// When it was taken up.
    first_n2: f64,
    missed: u32,
    grown: bool,
    /// How far it would come within `PROVES`, where it began, for how long it is followed.
    way_hz: f64,
    from_hz: f64,
    age: u32,
}

crate::keyframe::keep!(Followed { frequency_hz, power_n2, first_n2, missed, grown, way_hz, from_hz, age });

/// The lines that are followed.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Foreign {
    lines: [Option<Followed>; LINES],
}

crate::keyframe::keep!(Foreign { lines });

impl Foreign {
    pub(super) fn any(&self) -> bool {
        self.lines.iter().any(Option::is_some)
    }

    /// Follows a line from now on that comes `way_hz` far in half a second, instead of the weakest if
    /// there are enough.
    pub(super) fn add(&mut self, frequency_hz: f64, way_hz: f64, power_n2: f64) {
        let weight = |line: &Option<Followed>| line.map_or(0.0, |line| line.power_n2);
        let free = self.lines.iter_mut().min_by(|a, b| weight(a).total_cmp(&weight(b)));
        if let Some(free) = free {
            let (from_hz, first_n2) = (frequency_hz, power_n2);
            let line = Followed { frequency_hz, power_n2, first_n2, way_hz, from_hz, ..Followed::default() };
            *free = Some(line);
        }
    }

    /// Follows them to where they are now in a bank whose powers were read.
    pub(super) fn follow(&mut self, bank: &LineBank, state: &LineBankState, heard: &Baseline) {
        let last = bank.frequencies_hz().len().saturating_sub(1);
        for place in &mut self.lines {
            let Some(line) = place else { continue };
            let middle = bank.nearest(line.frequency_hz);
            let around = middle.saturating_sub(NEAR)..=(middle + NEAR).min(last);
            let best = around.max_by(|a, b| heard.power(*a).total_cmp(&heard.power(*b))).unwrap_or(middle);
            let power_n2 = heard.power(best);
            line.grown = power_n2 > SAME * line.power_n2;
            let same = !line.grown && power_n2 * SAME > line.power_n2;
            if same {
                line.frequency_hz = bank.refined_hz(state, best);
                line.power_n2 += FOLLOWS * (power_n2 - line.power_n2);
            }
            line.missed = if same { 0 } else { line.missed + 1 };
            line.age = (line.age + 1).min(PROVES + 1);
            let stands = (line.frequency_hz - line.from_hz).abs() < GOES_ON * line.way_hz;
            let grows = line.power_n2 > GROWN * line.first_n2;
            if line.missed > LOST || line.age == PROVES && stands || grows {
                *place = None;
            }
        }
    }

    /// The filters of a bank that they are nearest to. Where one has grown something else grows.
    pub(super) fn filters(&self, bank: &LineBank) -> impl Iterator<Item = usize> {
        self.lines.iter().flatten().filter(|line| !line.grown).map(|line| bank.nearest(line.frequency_hz))
    }

    /// Whether a line is one of them.
    pub(super) fn has(&self, frequency_hz: f64, within_hz: f64) -> bool {
        self.lines.iter().flatten().any(|line| (line.frequency_hz - frequency_hz).abs() < within_hz)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Complex;

    /// Whether a line at 41.3 Hz that was taken up with 1 N^2 is still followed after two seconds.
    fn followed(growth_1_s: f64) -> bool {
        let bank = LineBank::new(1000.0, 150.0, 0.025);
        let filters = bank.frequencies_hz().len();
        let (mut state, mut heard) = (bank.start(), Baseline::new(filters));
        let mut foreign = Foreign::default();
        for look in 0..500 {
            let value = |k: u32| {
                let t = f64::from(4 * look + k) / 1000.0;
                Complex::from_polar((growth_1_s * t).exp(), std::f64::consts::TAU * 41.3 * t)
            };
            bank.step(&mut state, &[0, 1, 2, 3].map(value));
            heard.look(&bank, &state, 0..filters);
            if look == 50 {
                foreign.add(41.3, 0.0, heard.power(bank.nearest(41.3)));
            }
            foreign.follow(&bank, &state, &heard);
        }
        foreign.any()
    }

    #[test]
    fn what_grows_where_it_stands_is_let_go() {
        assert!(followed(0.0));
        assert!(!followed(1.5), "10 dB in 0.77 s");
    }
}
