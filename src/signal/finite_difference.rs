//! Weights that turn equally spaced samples into a value, slope or curvature at any instant.
//!
//! One polynomial through all nodes gives interpolation (a fractional delay), velocity and
//! acceleration alike, so signals that are aligned with these weights carry the same error in band.

/// Nodes of a [`Stencil`]: error of the slope falls with the 7th power of frequency.
pub const STENCIL_NODES: usize = 8;

/// Weights over consecutive samples of a line, youngest first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stencil {
    /// Age in samples of the youngest node.
    pub youngest: usize,
    /// Weights from the youngest node to the oldest.
    pub weights: [f64; STENCIL_NODES],
}

/// Fornberg's weights of derivatives 0, 1, 2 at `at` for values given at the nodes 0, 1, 2, ...
///
/// f^(k)(at) = sum_j w[k][j] f(j), exact for polynomials of degree below the number of nodes.
///
/// Source: B. Fornberg, Generation of finite difference formulas on arbitrarily spaced grids,
/// Math. Comp. 51 (1988). Checked by: polynomials_come_back_exactly.
#[must_use]
pub fn weights<const N: usize>(at: f64) -> [[f64; N]; 3] {
    let mut w = [[0.0; N]; 3];
    w[0][0] = 1.0;
    let (mut c1, mut c4) = (1.0, -at);
    for i in 1..N {
        let highest = i.min(2);
        let c5 = c4;
        let mut c2 = 1.0;
        c4 = i as f64 - at;
        for j in 0..i {
            let c3 = (i - j) as f64;
            c2 *= c3;
            if j == i - 1 {
                for k in (1..=highest).rev() {
                    w[k][i] = c1 * (k as f64 * w[k - 1][i - 1] - c5 * w[k][i - 1]) / c2;
                }
                w[0][i] = -c1 * c5 * w[0][i - 1] / c2;
            }
            for k in (1..=highest).rev() {
                w[k][j] = (c4 * w[k][j] - k as f64 * w[k - 1][j]) / c3;
            }
            w[0][j] *= c4 / c3;
        }
        c1 = c2;
    }
    w
}

/// Stencils for value, d/dt and d2/dt2 of a signal as it was `age_samples` ago (not below 3).
///
/// d/dt = -d/d(age) / period. The nodes lie around the wanted instant: three or four on each side.
#[must_use]
pub fn stencils(age_samples: f64, period_s: f64) -> [Stencil; 3] {
    // Whole samples, within rounding, are met on a node; the float to integer cast is of a small number >= 0.
    let whole = (age_samples + 1e-9).floor().max(3.0);
    let youngest = whole as usize - 3;
    let w = weights::<STENCIL_NODES>(age_samples - youngest as f64);
    let scale = [1.0, -1.0 / period_s, 1.0 / (period_s * period_s)];
    [0, 1, 2].map(|k| Stencil { youngest, weights: w[k].map(|x| x * scale[k]) })
}

impl Stencil {
    /// Sum of `factors[k] * stencils[k]`: a force from position, velocity and acceleration in one pass.
    #[must_use]
    pub fn combined(stencils: &[Stencil; 3], factors: [f64; 3]) -> Stencil {
        let mut weights = [0.0; STENCIL_NODES];
        for (stencil, factor) in stencils.iter().zip(factors) {
            for (sum, w) in weights.iter_mut().zip(stencil.weights) {
                *sum += factor * w;
            }
        }
        Stencil { youngest: stencils[0].youngest, weights }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_come_back_exactly() {
        for at in [3.0, 3.25, 3.9, 0.0] {
            let w = weights::<8>(at);
            for degree in 0..8 {
                let d = f64::from(degree);
                let exact = [
                    at.powf(d),
                    d * at.powf((d - 1.0).max(0.0)),
                    d * (d - 1.0) * at.powf((d - 2.0).max(0.0)),
                ];
                for k in 0..3 {
                    let got: f64 = (0..8).map(|j| w[k][j] * (j as f64).powi(degree)).sum();
                    let expected = if at == 0.0 && degree as usize != k { 0.0 } else { exact[k] };
                    assert!(
                        (got - expected).abs() < 1e-8,
                        "at {at} degree {degree} derivative {k}: {got} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_sine_at_800_hz_keeps_its_acceleration_within_a_thousandth() {
        let (rate, f) = (9000.0, 800.0);
        let w = std::f64::consts::TAU * f;
        for age in [3.0, 3.3, 3.8] {
            let s = stencils(age, 1.0 / rate);
            let error = (0..100).map(|i| {
                let t = f64::from(i) / 900.0;
                let sum: f64 = (0..8).map(|j| s[2].weights[j] * (w * (t - j as f64 / rate)).sin()).sum();
                (sum / (w * w) + (w * (t - age / rate)).sin()).abs()
            });
            assert!(error.fold(0.0, f64::max) < 2e-3);
        }
    }
}
