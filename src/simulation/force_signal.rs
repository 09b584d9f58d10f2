//! What a force signal shows of a force: late, and through a low-pass (contracts, section 6).

use crate::plant::cut_effects::CutEffect;
use crate::plant::scenario::Scenario;
use crate::signal::butterworth::Butterworth;
use crate::units::SampleRate;

/// Order of the signal's low-pass.
const ORDER: usize = 4;

/// How a force signal shows a force.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ShownForce {
    /// Corner of its low-pass; `None`: none within the band.
    pub bandwidth_hz: Option<f64>,
    /// How late it is.
    pub delay_s: f64,
}

impl ShownForce {
    /// With what a scenario says that the signal has beyond this.
    #[must_use]
    pub fn with_physics(mut self, scenario: &Scenario) -> Self {
        for effect in scenario.physics.iter() {
            if let CutEffect::ForceSensorLag(lag) = effect {
                self.delay_s += lag.extra_delay_s;
                let narrower = self.bandwidth_hz.map_or(lag.bandwidth_hz, |b| b.min(lag.bandwidth_hz));
                self.bandwidth_hz = Some(narrower).filter(|b| b.is_finite());
            }
        }
        self
    }

    /// The signal of a force, of the same length; the first value holds before the start.
    ///
    /// A delay between samples is cubic (Lagrange). A bandwidth at or above half the rate filters nothing.
    /// Checked by: `a_sine_is_late_and_smaller`.
    #[must_use]
    pub fn of(&self, force_n: &[f64], rate: SampleRate) -> Vec<f64> {
        let late = self.delay_s * rate.hz();
        let at = |index: i64| {
            let last = i64::try_from(force_n.len()).unwrap_or(i64::MAX) - 1;
            usize::try_from(index.clamp(0, last.max(0)))
                .map_or(0.0, |i| force_n.get(i).copied().unwrap_or(0.0))
        };
        #[expect(clippy::cast_possible_truncation, reason = "rows of a recording")]
        let delayed = (0..force_n.len()).map(|row| {
            let place = row as f64 - late;
            let (first, t) = (place.floor() as i64, place - place.floor());
            let parts = [
                -t * (t - 1.0) * (t - 2.0) / 6.0,
                (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0,
                -(t + 1.0) * t * (t - 2.0) / 2.0,
                (t + 1.0) * t * (t - 1.0) / 6.0,
            ];
            (-1i64..).zip(parts).map(|(k, part)| part * at(first + k)).sum::<f64>()
        });
        let below = self.bandwidth_hz.filter(|hz| *hz < 0.499 * rate.hz());
        let Some(filter) = below.and_then(|hz| Butterworth::low_pass(ORDER, hz, rate).ok()) else {
            return delayed.collect();
        };
        let mut state = filter.settled(at(0));
        delayed.map(|x| filter.step(&mut state, x)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn a_sine_is_late_and_smaller() {
        let rate = SampleRate::new(9000.0).unwrap();
        let wave = |t: f64| 50.0 + 10.0 * (TAU * 600.0 * t).sin();
        let force: Vec<f64> = (0..9000).map(|i| wave(f64::from(i) / 9000.0)).collect();
        let late = ShownForce { bandwidth_hz: None, delay_s: 0.42e-3 }.of(&force, rate);
        for i in 8000..8100u32 {
            let wanted = wave(f64::from(i) / 9000.0 - 0.42e-3);
            assert!((late[i as usize] - wanted).abs() < 0.02, "{} {wanted}", late[i as usize]);
        }
        let narrow = ShownForce { bandwidth_hz: Some(600.0), delay_s: 0.0 }.of(&force, rate);
        let swing = narrow[8000..].iter().fold(0.0f64, |m, x| m.max((x - 50.0).abs()));
        assert!((swing - 10.0 / 2f64.sqrt()).abs() < 0.1, "{swing}");
    }
}
