//! The band in which a speed tells when friction turns, and the speed over which it turns there.
//!
//! A narrow band hides the steps of the encoder and smears every start and stop; a wide one has the steps in
//! it, and friction that turns over less than they make is noise. Of one position the band is the one in
//! which mass, damper, dry friction, a load and a spring leave least of the thrust.

use super::signals::{KERNELS, Path, Read, Signals, Track, inside};
use crate::diagnosis::criteria::Criteria;
use crate::diagnosis::encoder_noise::SpeedOfStep;
use crate::plant::effects::coulomb_friction::sliding_direction;
use crate::plant::machine::AxisModel;
use nalgebra::{SMatrix, SVector};

/// Acceleration, speed, dry friction, load, spring, when the thrust acts.
const COLUMNS: usize = 6;

type Row = SVector<f64, COLUMNS>;
type Products = SMatrix<f64, COLUMNS, COLUMNS>;

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
    /// `shortest`: rows of the shortest recording.
    pub(super) fn new(
        axis: &'a AxisModel,
        (band_hz, rate_hz): (f64, f64),
        shortest: usize,
        of_step: &'a [SpeedOfStep; 2],
    ) -> Self {
        let least_hz = Criteria::STANDARD.velocity_band_share * rate_hz;
        let narrowest_hz = (0.15 * least_hz).max(KERNELS * rate_hz / shortest as f64);
        Self { axis, of_step, band_hz, least_hz, narrowest_hz }
    }

    /// As stated, or over what the steps of an encoder make in a band.
    fn smoothing_m_s(&self, of_step: &SpeedOfStep, hz: f64) -> f64 {
        let drive = &self.axis.drive;
        let of_steps_m_s = of_step.at_m_s(hz) / Criteria::STANDARD.step_share;
        drive.raw().friction_smoothing_m_s.unwrap_or(drive.friction_smoothing_m_s().max(of_steps_m_s))
    }

    /// Of two positions: steps narrow the band before they widen the speed.
    pub(super) fn of_two(&self) -> Turning {
        let [motor, stage] = self.of_step;
        let coarser = if stage.step_m > motor.step_m { stage } else { motor };
        let smoothing_m_s = self.smoothing_m_s(coarser, self.least_hz.min(self.band_hz));
        let clean_hz = |s: &SpeedOfStep| {
            let hz = s.band_hz(Criteria::STANDARD.step_share * smoothing_m_s);
            hz.max(self.narrowest_hz).min(self.band_hz)
        };
        Turning {
            velocity_hz: self.of_step.each_ref().map(clean_hz),
            smoothing_m_s: smoothing_m_s.max(self.smoothing_m_s(coarser, clean_hz(coarser))),
        }
    }

    /// Of one position: from the widest that a balance may have, by halves.
    pub(super) fn of_one(&self) -> impl Iterator<Item = Turning> {
        let c = &Criteria::STANDARD;
        let of_step = &self.of_step[0];
        let widest_hz = (c.band_share[1] * of_step.rate_hz).min(c.band_hz);
        let halves = std::iter::successors(Some(widest_hz), |hz| Some(0.5 * hz));
        halves
            .take_while(move |hz| *hz == widest_hz || *hz >= self.narrowest_hz)
            .map(|hz| Turning { velocity_hz: [hz; 2], smoothing_m_s: self.smoothing_m_s(of_step, hz) })
    }
}

/// Square sum of what is left of the thrust, each recording with numbers of its own.
pub(super) fn left(signals: &Signals, positions: &[Vec<Read>], turning: &Turning) -> f64 {
    let of = |(track, read): (&Track, &Vec<Read>)| {
        let Some(read) = read.first() else { return 0.0 };
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
    };
    signals.tracks.iter().zip(positions).map(of).sum()
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
