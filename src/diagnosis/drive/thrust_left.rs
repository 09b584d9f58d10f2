//! What a rigid mass with friction leaves of a thrust, for ways in which friction may turn.

use super::one_mass::coefficients;
use super::reads::{Read, Side};
use super::signals::{Path, Signals, Track, inside};
use super::turning::Turning;
use crate::plant::effects::coulomb_friction::sliding_direction;
use nalgebra::{SMatrix, SVector};

/// Acceleration, speed, dry friction, load, spring, when the thrust acts; and sums of their products.
type Row = SVector<f64, 6>;
type Products = SMatrix<f64, 6, 6>;

impl Signals {
    /// Square sums of what is left of the thrust, one a way of turning, each recording with its own numbers.
    pub(super) fn left(&self, positions: &[Vec<Read>], turnings: &[Turning]) -> Vec<f64> {
        let mut sums = vec![0.0; turnings.len()];
        for (track, read) in self.tracks.iter().zip(positions) {
            let Some(read) = read.first() else { continue };
            let thrust = self.thrust(track, Path { delay_s: 0.0, loop_rad_s: None });
            let local: Vec<f64> = read.x_m.iter().map(|x| x - read.x_m[0]).collect();
            let judged = track.judged();
            for (sum, turning) in sums.iter_mut().zip(turnings) {
                let smoothing_m_s = turning.smoothing_m_s;
                // A stage that follows remembers: at the ends its motor is where it was read.
                let of = |derivative: u32| {
                    let kernel = self.low_pass(turning.velocity_hz[0], derivative, read.delay_s);
                    let ends = if derivative == 0 { local.clone() } else { vec![0.0; local.len()] };
                    let all = inside(&kernel, &local, ends);
                    all[track.full_first..all.len() - track.full_first].to_vec()
                };
                let mut slides = Side { x_m: Vec::new(), v_m_s: of(1) };
                if let Some(stage) = self.following {
                    slides.x_m = of(0);
                    slides = stage.behind(&slides, self.rate_hz, smoothing_m_s);
                }
                let dry: Vec<f64> =
                    slides.v_m_s.iter().map(|v| sliding_direction(*v, smoothing_m_s)).collect();
                *sum += left_of(track, (&thrust, &self.filtered(track, &dry, 0)), &judged);
            }
        }
        sums
    }
}

fn left_of(track: &Track, (thrust, dry): (&[f64], &[f64]), judged: &[bool]) -> f64 {
    let (mut normal, mut pull, mut power) = (Products::zeros(), Row::zeros(), 0.0);
    let t = &track.thin;
    for j in (1..thrust.len().saturating_sub(1)).filter(|j| judged[*j]) {
        let (x, rate) = (t.position[j] - t.position[0], thrust[j + 1] - thrust[j - 1]);
        let row = Row::from([t.accel[0][j], t.velocity[0][j], dry[j], 1.0, x, rate]);
        normal += row * row.transpose();
        pull += row * thrust[j];
        power += thrust[j] * thrust[j];
    }
    power - coefficients(normal.as_view(), pull.as_view()).map_or(0.0, |beta| pull.dot(&beta))
}
