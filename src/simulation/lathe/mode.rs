//! One mode's motion with its exact propagation over one step.

use std::f64::consts::TAU;

/// A mode seen from the tools: of the bar, or of the holder of tool 2.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModeAt {
    /// Modal mass, kg.
    pub mass_kg: f64,
    /// Natural frequency, Hz.
    pub frequency_hz: f64,
    /// Damping ratio.
    pub damping_ratio: f64,
    /// Shape at the tools: force into the mode.
    pub shape: f64,
    /// Shape at the tools: motion out of the mode. The same as `shape`, of the other sign where the plane's
    /// force acts against it.
    pub output: f64,
}

impl ModeAt {
    /// At rest, motion per force, m/N.
    #[must_use]
    pub fn compliance_m_n(&self) -> f64 {
        self.shape * self.output / (self.mass_kg * (TAU * self.frequency_hz).powi(2))
    }
}

/// A mode's motion, force linear within the step.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ModeState {
    pub(super) at: ModeAt,
    pub(super) displacement_m: f64,
    pub(super) velocity_m_s: f64,
    transition: [[f64; 2]; 2],
    hold: [f64; 2],
    ramp: [f64; 2],
}

/// Displacement and velocity.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Motion {
    pub(super) m: f64,
    pub(super) m_s: f64,
}

impl ModeState {
    pub(super) fn new(at: ModeAt, step_s: f64) -> Self {
        let mut state = Self {
            at,
            displacement_m: 0.0,
            velocity_m_s: 0.0,
            transition: [[0.0; 2]; 2],
            hold: [0.0; 2],
            ramp: [0.0; 2],
        };
        state.set(at, step_s);
        state
    }

    /// Exact response of m q'' + c q' + k q = F0 + (F1 - F0) t/h over one step h, in closed form.
    pub(super) fn set(&mut self, at: ModeAt, step_s: f64) {
        self.at = at;
        let omega = TAU * at.frequency_hz;
        let sigma = at.damping_ratio * omega;
        let damped = omega * (1.0 - at.damping_ratio * at.damping_ratio).max(1e-12).sqrt();
        let decay = (-sigma * step_s).exp();
        let (sin, cos) = (damped * step_s).sin_cos();
        let a11 = decay * (cos + sigma / damped * sin);
        let a12 = decay * sin / damped;
        let a21 = -omega * omega * a12;
        let a22 = decay * (cos - sigma / damped * sin);
        self.transition = [[a11, a12], [a21, a22]];
        // Particular solution for F = F0 + r t: q = F0/k - c r/k^2 + r t/k.
        let k = at.mass_kg * omega * omega;
        let c = 2.0 * sigma * at.mass_kg;
        let step_response = [(1.0 - a11) / k, -a21 / k];
        // r = 1/h: q_p = -c/(k^2 h) + t/(k h), starting from rest.
        let (q0, v0) = (-c / (k * k * step_s), 1.0 / (k * step_s));
        let ramp = [q0 + 1.0 / k - (a11 * q0 + a12 * v0), v0 - (a21 * q0 + a22 * v0)];
        self.hold = [step_response[0] - ramp[0], step_response[1] - ramp[1]];
        self.ramp = ramp;
    }

    /// Where a force that goes from `before_n` to `after_n` takes it in one step.
    pub(super) fn propagated(&self, before_n: f64, after_n: f64) -> Motion {
        let (f0, f1) = (before_n * self.at.shape, after_n * self.at.shape);
        let [[a11, a12], [a21, a22]] = self.transition;
        let (q, v) = (self.displacement_m, self.velocity_m_s);
        Motion {
            m: a11 * q + a12 * v + self.hold[0] * f0 + self.ramp[0] * f1,
            m_s: a21 * q + a22 * v + self.hold[1] * f0 + self.ramp[1] * f1,
        }
    }

    /// Takes that step.
    pub(super) fn take(&mut self, before_n: f64, after_n: f64) {
        let to = self.propagated(before_n, after_n);
        (self.displacement_m, self.velocity_m_s) = (to.m, to.m_s);
    }

    /// Rests under a constant force.
    pub(super) fn rest_under(&mut self, force_n: f64) {
        let k = self.at.mass_kg * (TAU * self.at.frequency_hz).powi(2);
        (self.displacement_m, self.velocity_m_s) = (force_n * self.at.shape / k, 0.0);
    }
}
