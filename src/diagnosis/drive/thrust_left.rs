//! What a rigid mass with friction leaves of a thrust, for one way in which friction turns.

use super::signals::{Path, Read, Signals, Track, inside};
use super::turning::Turning;
use crate::plant::effects::coulomb_friction::sliding_direction;
use nalgebra::{SMatrix, SVector};

/// Acceleration, speed, dry friction, load, spring, when the thrust acts; and sums of their products.
type Row = SVector<f64, 6>;
type Products = SMatrix<f64, 6, 6>;

impl Signals {
    /// Square sum of what is left of the thrust, each recording with numbers of its own.
    pub(super) fn left(&self, positions: &[Vec<Read>], turning: &Turning) -> f64 {
        let of = |(track, read): (&Track, &Vec<Read>)| {
            read.first().map_or(0.0, |r| left_of(self, track, (r, turning)))
        };
        self.tracks.iter().zip(positions).map(of).sum()
    }
}

fn left_of(signals: &Signals, track: &Track, (read, turning): (&Read, &Turning)) -> f64 {
    let kernel = signals.low_pass(turning.velocity_hz[0], 1, read.delay_s);
    let local: Vec<f64> = read.x_m.iter().map(|x| x - read.x_m[0]).collect();
    let v = inside(&kernel, &local, vec![0.0; local.len()]);
    let v = &v[track.full_first..v.len() - track.full_first];
    let dry: Vec<f64> = v.iter().map(|v| sliding_direction(*v, turning.smoothing_m_s)).collect();
    let dry = signals.filtered(track, &dry, 0);
    let thrust = signals.thrust(track, Path { delay_s: 0.0, loop_rad_s: None });
    let (mut normal, mut pull, mut power) = (Products::zeros(), Row::zeros(), 0.0);
    let t = &track.thin;
    for j in (1..thrust.len().saturating_sub(1)).filter(|j| !track.masked[*j] && !track.rests[*j]) {
        let (x, rate) = (t.position[j] - t.position[0], thrust[j + 1] - thrust[j - 1]);
        let row = Row::from([t.accel[0][j], t.velocity[0][j], dry[j], 1.0, x, rate]);
        normal += row * row.transpose();
        pull += row * thrust[j];
        power += thrust[j] * thrust[j];
    }
    power - explained(&normal, &pull)
}

/// Square sum that columns of these products explain.
fn explained(normal: &Products, pull: &Row) -> f64 {
    // To columns of unit size: metres stand beside metres per square second; one that is nothing is held.
    let scale = normal.diagonal().map(|d| d.max(f64::MIN_POSITIVE).sqrt().recip());
    let unit = Products::from_diagonal(&scale);
    let scaled = unit * normal * unit + Products::identity() * 1e-10;
    let pull = scale.component_mul(pull);
    scaled.lu().solve(&pull).map_or(0.0, |beta| beta.dot(&pull))
}
