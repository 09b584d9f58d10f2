//! The Jacobian of the balance: how a disturbance becomes motion.
//!
//! Forces are P x with P the axis at each frequency. Motion is what was recorded, so the likelihood of the
//! forces is that of the motion only with log |det P|^2. Where the axis is moved by the disturbances
//! themselves (near a resonance, in a sweep above its band) least squares without it make P small there, and
//! bend stiffness, dampings and whatever else moves a resonance.

use super::gram::{BandGram, Column};
use super::spectra::{Point, Response};
use nalgebra::{DMatrix, DVector};
use rustfft::num_complex::Complex;
use std::sync::Arc;

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
}

impl Dynamics {
    /// Nothing yet at these frequencies; none: a rigid mass, whose Jacobian is its mass.
    pub(super) fn at(points: Arc<Vec<Point>>) -> Self {
        Self { points, moving: Vec::new() }
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

    /// The same with some places alone, in their order.
    pub(super) fn kept(&self, places: &[usize]) -> Self {
        let moved =
            |m: &Moving| places.iter().position(|p| *p == m.place).map(|place| Moving { place, ..m.clone() });
        Self { points: self.points.clone(), moving: self.moving.iter().filter_map(moved).collect() }
    }

    /// Sum of log |det P|^2 over the values of all bands, nats.
    pub(super) fn log_det(&self, bands: &[BandGram], beta: &[f64]) -> f64 {
        let of_band = of_bands(bands);
        let of = |(k, point): (usize, &Point)| {
            let weight = point.share * of_band.get(point.band).copied().unwrap_or(0.0);
            if weight > 0.0 {
                weight * determinant(&self.axis(k, beta)).norm_sqr().max(1e-300).ln()
            } else {
                0.0
            }
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
        let of_band = of_bands(bands);
        let mut turned: Vec<Response> = Vec::with_capacity(self.moving.len());
        for (k, point) in self.points.iter().enumerate() {
            let weight = point.share * of_band.get(point.band).copied().unwrap_or(0.0);
            let axis = self.axis(k, beta);
            let det = determinant(&axis);
            if weight <= 0.0 || det.norm_sqr() < 1e-300 {
                continue;
            }
            let inverse = [axis[3] / det, -axis[1] / det, -axis[2] / det, axis[0] / det];
            turned.clear();
            turned.extend(self.moving.iter().map(|m| product(&inverse, &m.response[k])));
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
    }

    fn axis(&self, k: usize, beta: &[f64]) -> Response {
        let mut out = [Complex::new(0.0, 0.0); 4];
        for m in &self.moving {
            out.iter_mut().zip(&m.response[k]).for_each(|(o, r)| *o += r * beta[m.place]);
        }
        out
    }
}

/// Values of each band, halved for the overlap.
fn of_bands(bands: &[BandGram]) -> Vec<f64> {
    let mut out = vec![0.0; bands.iter().map(|b| b.band + 1).max().unwrap_or(0)];
    bands.iter().for_each(|b| out[b.band] += 0.5 * b.values);
    out
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
