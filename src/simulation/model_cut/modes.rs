//! Motion of one resonance over a step, exact for a force that runs on a parabola.

use super::lanes::Lane;
use crate::plant::cut_loop::Resonance;
use crate::signal::dispatch::multiply_add;

/// A resonance of each model; by default there is none, and it is at rest.
#[derive(Debug, Clone, Default)]
pub(super) struct Modes {
    /// Displacement, m.
    pub(super) at: Lane,
    /// Velocity, m/s.
    pub(super) speed: Lane,
    gain_1_kg: Lane,
    transition: [[Lane; 2]; 2],
    driven: [[Lane; 3]; 2],
}

impl Modes {
    /// Takes on the numbers of model `l`. The modal motion goes on; what the tools see of it changes with the
    /// shape, whose square is in the gain.
    pub(super) fn tune(&mut self, l: usize, resonance: &Resonance, dt: f64) {
        let (w, zeta) = (resonance.rad_s, resonance.damping_ratio);
        let damped = w * (1.0 - zeta * zeta).max(1e-12).sqrt();
        let (sin, cos) = (damped * dt).sin_cos();
        let fade = (-zeta * w * dt).exp();
        let (s, c) = (fade * sin / damped, fade * cos);
        let map = [[c + zeta * w * s, s], [-w * w * s, c - zeta * w * s]];
        // A force c0 + c1 t + c2 t^2 is followed by a0 + a1 t + a2 t^2, once what was there has rung down.
        let followed = |[c0, c1, c2]: [f64; 3]| {
            let a2 = c2 / (w * w);
            let a1 = (c1 - 4.0 * zeta * w * a2) / (w * w);
            let a0 = (c0 - 2.0 * zeta * w * a1 - 2.0 * a2) / (w * w);
            let (q, v) = (-a0, -a1);
            [
                map[0][0] * q + map[0][1] * v + a0 + a1 * dt + a2 * dt * dt,
                map[1][0] * q + map[1][1] * v + a1 + 2.0 * a2 * dt,
            ]
        };
        let g = resonance.gain_1_kg;
        let seen = if self.gain_1_kg[l].abs() > 0.0 { (g / self.gain_1_kg[l]).abs().sqrt() } else { 1.0 };
        self.at[l] *= seen;
        self.speed[l] *= seen;
        self.gain_1_kg[l] = g;
        // The parabola through forces of now, a step ago and two steps ago, each of one newton.
        let (t, t2) = (g / dt, g / (dt * dt));
        let of = [[g, 1.5 * t, 0.5 * t2], [0.0, -2.0 * t, -t2], [0.0, 0.5 * t, 0.5 * t2]].map(followed);
        for row in 0..2 {
            for column in 0..2 {
                self.transition[row][column][l] = map[row][column];
            }
            for back in 0..3 {
                self.driven[row][back][l] = of[back][row];
            }
        }
    }

    /// One step of model `l` under a force: now, a step ago and two.
    #[inline(always)]
    pub(super) fn advance<const FUSED: bool>(&mut self, l: usize, [now, then, before]: [f64; 3]) {
        let (q, v) = (self.at[l], self.speed[l]);
        // The newest force comes last: all else is known before it is.
        let row = |t: &[Lane; 2], d: &[Lane; 3]| {
            let older = multiply_add::<FUSED>(d[1][l], then, d[2][l] * before);
            let free = multiply_add::<FUSED>(t[0][l], q, multiply_add::<FUSED>(t[1][l], v, older));
            multiply_add::<FUSED>(d[0][l], now, free)
        };
        let at = row(&self.transition[0], &self.driven[0]);
        self.speed[l] = row(&self.transition[1], &self.driven[1]);
        self.at[l] = at;
    }
}
