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
}

impl Dynamics {
    /// Nothing yet at these frequencies; none: a rigid mass, whose Jacobian is its mass.
    pub(super) fn at(points: Arc<Vec<Point>>) -> Self {
        Self { points, moving: Vec::new(), idle: Arc::default() }
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
        let of_band = self.of_bands(bands);
        let log = |weight: f64, p: Complex<f64>| {
            if weight > 0.0 { weight * p.norm_sqr().max(1e-300).ln() } else { 0.0 }
        };
        let of = |(k, point): (usize, &Point)| {
            let [both, stage] = of_band.get(point.band).map_or([0.0; 2], |v| v.map(|v| point.share * v));
            let axis = self.axis(k, beta);
            log(both, determinant(&axis)) + log(stage, axis[3])
        };
        self.points.iter().enumerate().map(of).sum()
    }

    /// Adds half the gradient of -sum log |det P|^2 to `gradient` and half a curvature above its own to `a`.
    pub(super) fn curve(
        &self,
        bands: &[BandGram],
        beta: &[f64],
        a: &mut DMatrix<f64>,
        gradient: &mut DVector<f64>,
    ) {
        let of_band = self.of_bands(bands);
        let none = Complex::new(0.0, 0.0);
        let mut turned: Vec<Response> = Vec::with_capacity(self.moving.len());
        for (k, point) in self.points.iter().enumerate() {
            let axis = self.axis(k, beta);
            let det = determinant(&axis);
            let inverse = [axis[3] / det, -axis[1] / det, -axis[2] / det, axis[0] / det];
            let [both, stage] = of_band.get(point.band).map_or([0.0; 2], |v| v.map(|v| point.share * v));
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

    /// Values of each band, halved for the overlap: those whose Jacobian is of both balances, and of the
    /// stage's alone.
    fn of_bands(&self, bands: &[BandGram]) -> Vec<[f64; 2]> {
        let mut out = vec![[0.0; 2]; bands.iter().map(|b| b.band + 1).max().unwrap_or(0)];
        for b in bands {
            out[b.band][usize::from(self.idle.contains(&(b.recording, b.band)))] += 0.5 * b.values;
        }
        out
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
