//! The Jacobian of the balance: how a disturbance becomes motion.
//!
//! Forces are P x with P the axis at each frequency. Motion is what was recorded, so the likelihood of the
//! forces is that of the motion only with log |det P|^2. Where the axis is moved by the disturbances
//! themselves (near a resonance, in a sweep above its band) least squares without it make P small there, and
//! bend stiffness, dampings and whatever else moves a resonance.
//!
//! A force that was measured has noise that moves nothing: there it is P x and that noise, and its likelihood
//! has no Jacobian but that of the stage's own balance. Which of the two holds is seen in each band: with F
//! the force less friction, log p(x | F) p(F) and log p(F | x) p(x) differ by log |F|^2 - log |P x|^2.

use super::gram::{BandGram, Column};
use super::sliding::CLASSES;
use super::spectra::{Point, Response};
use nalgebra::{DMatrix, DVector};
use rustfft::num_complex::Complex;
use std::sync::Arc;

/// Bands, `(recording, band)`, whose recorded force moves nothing.
pub(super) type Idle = Arc<Vec<(usize, usize)>>;

/// A column that moves with the positions.
#[derive(Debug, Clone)]
struct Moving {
    place: usize,
    response: Arc<Vec<Response>>,
}

/// The axis as its coefficients make it.
#[derive(Debug, Clone, Default)]
pub(super) struct Dynamics {
    points: Arc<Vec<Point>>,
    moving: Vec<Moving>,
    idle: Idle,
    /// Of each recording, share of its time in each class.
    shares: Arc<Vec<[f64; CLASSES]>>,
}

impl Dynamics {
    /// Nothing yet at these frequencies; none: a rigid mass, whose Jacobian is its mass.
    pub(super) fn at(points: Arc<Vec<Point>>, shares: Arc<Vec<[f64; CLASSES]>>) -> Self {
        Self { points, moving: Vec::new(), idle: Arc::default(), shares }
    }

    /// With bands whose recorded force moves nothing.
    pub(super) fn idle_in(mut self, idle: Idle) -> Self {
        self.idle = idle;
        self
    }

    /// True where there is nothing to be said of resonances.
    pub(super) fn is_rigid(&self) -> bool {
        self.points.is_empty()
    }

    /// A column at a place of the coefficients.
    pub(super) fn add(&mut self, place: usize, column: &Column) {
        if let Some(response) = column.response.as_ref().filter(|_| !self.is_rigid()) {
            self.moving.push(Moving { place, response: response.clone() });
        }
    }

    /// Sum of log |det P|^2 over the values of all bands, nats.
    pub(super) fn log_det(&self, bands: &[BandGram], beta: &[f64]) -> f64 {
        let of_point = self.of_points(bands);
        let log = |weight: f64, p: Complex<f64>| {
            if weight > 0.0 { weight * p.norm_sqr().max(1e-300).ln() } else { 0.0 }
        };
        let of = |(k, [both, stage]): (usize, [f64; 2])| {
            let axis = self.axis(k, beta);
            log(both, determinant(&axis)) + log(stage, axis[3])
        };
        of_point.into_iter().enumerate().map(of).sum()
    }

    /// Adds half the gradient of -sum log |det P|^2 to `gradient` and half a curvature above its own to `a`.
    pub(super) fn curve(
        &self,
        bands: &[BandGram],
        beta: &[f64],
        a: &mut DMatrix<f64>,
        gradient: &mut DVector<f64>,
    ) {
        let of_point = self.of_points(bands);
        let none = Complex::new(0.0, 0.0);
        let mut turned: Vec<Response> = Vec::with_capacity(self.moving.len());
        for (k, [both, stage]) in of_point.into_iter().enumerate() {
            let axis = self.axis(k, beta);
            let det = determinant(&axis);
            let inverse = [axis[3] / det, -axis[1] / det, -axis[2] / det, axis[0] / det];
            if both > 0.0 && det.norm_sqr() > 1e-300 {
                turned.clear();
                turned.extend(self.moving.iter().map(|m| product(&inverse, &m.response[k])));
                self.add_curve(&turned, both, a, gradient);
            }
            if stage > 0.0 && axis[3].norm_sqr() > 1e-300 {
                turned.clear();
                turned.extend(self.moving.iter().map(|m| [none, none, none, m.response[k][3] / axis[3]]));
                self.add_curve(&turned, stage, a, gradient);
            }
        }
    }

    /// The part of one frequency; `turned`: P^-1 times each column's response.
    fn add_curve(&self, turned: &[Response], weight: f64, a: &mut DMatrix<f64>, gradient: &mut DVector<f64>) {
        for (i, x) in turned.iter().enumerate() {
            let place = self.moving[i].place;
            gradient[place] -= weight * (x[0] + x[3]).re;
            for (j, y) in turned.iter().enumerate().take(i + 1) {
                let other = self.moving[j].place;
                let curvature = weight * (0..4).map(|e| (x[e] * y[e].conj()).re).sum::<f64>();
                a[(place, other)] += curvature;
                if i != j {
                    a[(other, place)] += curvature;
                }
            }
        }
    }

    /// Values of each point, halved for the overlap: those whose Jacobian is of both balances, and of the
    /// stage's alone.
    fn of_points(&self, bands: &[BandGram]) -> Vec<[f64; 2]> {
        let count = bands.iter().map(|b| b.band + 1).max().unwrap_or(0);
        let mut of_band = vec![[[0.0; 2]; CLASSES]; count];
        for b in bands {
            let stage = usize::from(self.idle.contains(&(b.recording, b.band)));
            for (values, share) in of_band[b.band].iter_mut().zip(&self.shares[b.recording]) {
                values[stage] += 0.5 * share * b.values;
            }
        }
        let of = |p: &Point| of_band.get(p.band).map_or([0.0; 2], |v| v[p.class].map(|v| p.share * v));
        self.points.iter().map(of).collect()
    }

    fn axis(&self, k: usize, beta: &[f64]) -> Response {
        let mut out = [Complex::new(0.0, 0.0); 4];
        for m in &self.moving {
            out.iter_mut().zip(&m.response[k]).for_each(|(o, r)| *o += r * beta[m.place]);
        }
        out
    }
}

fn determinant(p: &Response) -> Complex<f64> {
    p[0] * p[3] - p[1] * p[2]
}

fn product(a: &Response, b: &Response) -> Response {
    [
        a[0] * b[0] + a[1] * b[2],
        a[0] * b[1] + a[1] * b[3],
        a[2] * b[0] + a[3] * b[2],
        a[2] * b[1] + a[3] * b[3],
    ]
}

#[cfg(test)]
mod tests {
    use super::super::sliding::{Follows, class_slopes};
    use super::*;
    use std::f64::consts::PI;

    /// log |det|^2 of the force by the motion of a mass below an eighth of the rate, friction F tanh(v / v_s)
    /// linearised at each sample: in a basis of sines and cosines, friction is no function of the frequency.
    fn exact(mass_kg: f64, damper: &[f64], modes: usize) -> f64 {
        let n = damper.len();
        let basis = |k: usize, t: usize, order: i32| {
            let (w, phase) = (2.0 * PI * (k / 2 + 1) as f64 / n as f64, PI * 0.5 * (k % 2) as f64);
            let turned = phase + 0.5 * PI * f64::from(order);
            w.powi(order) * (2.0 / n as f64).sqrt() * (w * t as f64 + turned).sin()
        };
        let force = |k: usize, t: usize| mass_kg * basis(k, t, 2) + damper[t] * basis(k, t, 1);
        let of = |i: usize, k: usize| (0..n).map(|t| basis(i, t, 0) * force(k, t)).sum::<f64>();
        let eigen = DMatrix::from_fn(2 * modes, 2 * modes, of).complex_eigenvalues();
        eigen.iter().map(|e| e.norm_sqr().ln()).sum::<f64>()
    }

    #[test]
    fn the_jacobian_of_an_axis_that_sticks_is_a_mean_over_the_time() {
        let (n, modes) = (256, 32);
        let of_mass = |mass_kg: f64, stuck: usize| {
            let damper: Vec<f64> = (0..n).map(|t| if t < stuck { 40.0 } else { 0.0 }).collect();
            let class = |t: usize| if t < stuck { 3 } else { 0 };
            let classes: Vec<u8> = (0..n).map(class).collect();
            let speed: Vec<f64> = (0..n).map(|t| (t as f64).sin()).collect();
            let force: Vec<f64> = speed.iter().zip(&damper).map(|(v, s)| v * s).collect();
            let slopes = class_slopes([(&force[..], &speed[..], &classes[..])].into_iter());
            let share = stuck as f64 / n as f64;
            let points = (0..modes).flat_map(|k| {
                let rad_s = 2.0 * PI * (k + 1) as f64 / n as f64;
                [0, 3].map(|class| Point { band: 0, share: 1.0 / modes as f64, rad_s, class })
            });
            let points: Vec<Point> = points.collect();
            let mut of =
                Dynamics::at(Arc::new(points.clone()), Arc::new(vec![[1.0 - share, 0.0, 0.0, share]]));
            let mut add = |place: usize, response: &dyn Fn(&Point) -> Response| {
                let response = Some(Arc::new(points.iter().map(response).collect()));
                of.add(place, &Column { sides: [None, None], response });
            };
            let [zero, one] = [0.0, 1.0].map(|re| Complex::new(re, 0.0));
            add(0, &|_| [one, zero, zero, zero]);
            add(1, &|p| [zero, zero, zero, Complex::new(-p.rad_s * p.rad_s, 0.0)]);
            add(2, &|p| [zero, zero, zero, p.of_slopes(Follows::Speed, &slopes)]);
            let products = [vec![0.0], vec![0.0], vec![0.0]];
            let band = BandGram { recording: 0, band: 0, values: 4.0 * modes as f64, order: 1, products };
            [of.log_det(&[band], &[1.0, mass_kg, 1.0]), exact(mass_kg, &damper, modes)]
        };
        for stuck in [0, 64, 128] {
            let [lighter, heavier] = [10.0, 20.0].map(|mass_kg| of_mass(mass_kg, stuck));
            // What a mass twice as large is worth, of 2 ln 2 a value.
            let [said, true_nats] = [heavier[0] - lighter[0], heavier[1] - lighter[1]];
            let free = 2.0 * 2.0f64.ln() * 2.0 * modes as f64;
            assert!((said - true_nats).abs() < 0.05 * free, "{stuck}: {said} {true_nats} {free}");
        }
    }
}
