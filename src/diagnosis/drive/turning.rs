//! The band in which a speed tells when friction turns, and the speed over which it turns there.
//!
//! A narrow band hides the steps of the encoder and smears every start and stop; a wide one has the steps in
//! it, and friction that turns over less than they make is noise. Of one position the band is the one in
//! which mass, damper, dry friction, a load and a spring leave least of the thrust.

use crate::diagnosis::criteria::Criteria;
use crate::diagnosis::encoder_noise::SpeedOfStep;
use crate::plant::machine::AxisModel;

/// Where friction is told to turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Turning {
    /// Band of the speed of each side, Hz.
    pub(super) velocity_hz: [f64; 2],
    /// Speed over which friction turns, m/s.
    pub(super) smoothing_m_s: f64,
}

/// Bands that are open.
pub(super) struct Bands<'a> {
    axis: &'a AxisModel,
    of_step: &'a [SpeedOfStep; 2],
    /// Of the balance.
    band_hz: f64,
    /// In which steps narrow the band of two positions before they widen the speed.
    least_hz: f64,
    narrowest_hz: f64,
}

impl<'a> Bands<'a> {
    /// `narrowest_hz`: what the shortest recording has room for.
    pub(super) fn new(
        axis: &'a AxisModel,
        (band_hz, rate_hz): (f64, f64),
        narrowest_hz: f64,
        of_step: &'a [SpeedOfStep; 2],
    ) -> Self {
        let least_hz = Criteria::STANDARD.band_share[0] * rate_hz;
        Self { axis, of_step, band_hz, least_hz, narrowest_hz }
    }

    /// As stated, or no less than what the steps of an encoder make.
    fn smoothing_m_s(&self, of_steps_m_s: f64) -> f64 {
        let drive = &self.axis.drive;
        drive.raw().friction_smoothing_m_s.unwrap_or(drive.friction_smoothing_m_s().max(of_steps_m_s))
    }

    /// Of two positions: steps narrow the band before they widen the speed. It is wider than the balance's
    /// where the low-pass makes it and steps do not bend friction there: noise of n makes tanh(u) less by
    /// n^2 tanh''(u) / 2, by 0.385 n^2 at most.
    pub(super) fn of_two(&self) -> Turning {
        let c = &Criteria::STANDARD;
        let [motor, stage] = self.of_step;
        let coarser = if stage.step_m > motor.step_m { stage } else { motor };
        let at_least = |hz: f64| self.smoothing_m_s(coarser.at_m_s(hz) / c.step_share);
        let smoothing_m_s = at_least(self.least_hz.min(self.band_hz));
        let noisier_hz = |s: &SpeedOfStep, share: f64| s.band_hz(share * smoothing_m_s);
        let clean_hz = |s: &SpeedOfStep| {
            let own_hz = noisier_hz(s, c.step_share).max(self.narrowest_hz).min(self.band_hz);
            let widest_hz = c.velocity_share * s.rate_hz;
            own_hz.max(noisier_hz(s, (c.exactness / 0.385).sqrt()).min(widest_hz))
        };
        Turning {
            velocity_hz: self.of_step.each_ref().map(clean_hz),
            smoothing_m_s: smoothing_m_s.max(at_least(clean_hz(coarser))),
        }
    }

    /// Of one position: from the widest that a balance may have, by halves. The balance averages what
    /// friction turns too far by a step, and the forms beside it turn later.
    pub(super) fn of_one(&self) -> impl Iterator<Item = Turning> {
        let c = &Criteria::STANDARD;
        let of_step = &self.of_step[0];
        let widest_hz = (c.band_share[1] * of_step.rate_hz).min(c.band_hz);
        let halves = std::iter::successors(Some(widest_hz), |hz| Some(0.5 * hz));
        halves
            .take_while(move |hz| *hz == widest_hz || *hz >= self.narrowest_hz)
            .map(|hz| Turning { velocity_hz: [hz; 2], smoothing_m_s: self.smoothing_m_s(of_step.at_m_s(hz)) })
    }
}
