//! Nonlinear least squares with parameters of very different size (Levenberg-Marquardt).

use nalgebra::{DMatrix, DVector};

/// Where the search ended.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// Parameters.
    pub parameters: Vec<f64>,
    /// Half the sum of squares.
    pub cost: f64,
    /// (J^T J)^-1, for residuals of unit variance; `None` where it is singular.
    pub covariance: Option<DMatrix<f64>>,
    /// Steps taken.
    pub steps: usize,
}

/// Minimises sum r(p)^2 from `start`. The Jacobian is by central differences of `scale[i] * 1e-6`.
///
/// `residuals` writes into the vector that it is given, always the same number of entries.
/// Source: Marquardt 1963, with scaling by the diagonal. Checked by: a_curve_is_recovered.
pub fn minimise(start: &[f64], scale: &[f64], mut residuals: impl FnMut(&[f64], &mut Vec<f64>)) -> Solution {
    let n = start.len();
    let mut p = start.to_vec();
    let mut r = Vec::new();
    residuals(&p, &mut r);
    let half_square = |r: &[f64]| 0.5 * r.iter().map(|x| x * x).sum::<f64>();
    let mut cost = half_square(&r);
    let mut damping = 1e-3;
    let mut steps = 0;
    let (mut plus, mut minus, mut trial) = (Vec::new(), Vec::new(), Vec::new());
    let mut normal = DMatrix::zeros(n, n);
    while steps < 60 {
        steps += 1;
        let mut jacobian = Vec::with_capacity(n);
        for i in 0..n {
            let h = 1e-6 * scale[i];
            let mut moved = p.clone();
            moved[i] += h;
            residuals(&moved, &mut plus);
            moved[i] -= 2.0 * h;
            residuals(&moved, &mut minus);
            jacobian.push(
                plus.iter().zip(&minus).map(|(a, b)| (a - b) / (2.0 * h) * scale[i]).collect::<Vec<f64>>(),
            );
        }
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        normal = DMatrix::from_fn(n, n, |i, j| dot(&jacobian[i], &jacobian[j]));
        let gradient = DVector::from_fn(n, |i, _| dot(&jacobian[i], &r));
        let mut improved = false;
        let mut change = 0.0f64;
        for _ in 0..12 {
            let mut damped = normal.clone();
            for i in 0..n {
                damped[(i, i)] += damping * normal[(i, i)].max(1e-300);
            }
            let Some(step) = damped.cholesky().map(|c| c.solve(&gradient)) else {
                damping *= 10.0;
                continue;
            };
            let candidate: Vec<f64> = (0..n).map(|i| p[i] - step[i] * scale[i]).collect();
            residuals(&candidate, &mut trial);
            let new_cost = half_square(&trial);
            if new_cost.is_finite() && new_cost < cost {
                change = (cost - new_cost) / cost.max(f64::MIN_POSITIVE);
                p = candidate;
                std::mem::swap(&mut r, &mut trial);
                cost = new_cost;
                damping = (damping * 0.2).max(1e-12);
                improved = true;
                break;
            }
            damping *= 5.0;
        }
        if !improved || change < 1e-9 {
            break;
        }
    }
    let covariance = normal
        .cholesky()
        .map(|c| c.inverse())
        .map(|inverse| DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] * scale[i] * scale[j]));
    Solution { parameters: p, cost, covariance, steps }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_is_recovered() {
        let truth = [2.0e7, 3.0e-4];
        let data: Vec<f64> = (0..50).map(|k| truth[0] * (-truth[1] * f64::from(k) * 100.0).exp()).collect();
        let solution = minimise(&[1.0e7, 1.0e-4], &[1.0e7, 1.0e-4], |p, r| {
            r.clear();
            r.extend((0..50).map(|k| p[0] * (-p[1] * f64::from(k) * 100.0).exp() - data[k as usize]));
        });
        assert!((solution.parameters[0] / truth[0] - 1.0).abs() < 1e-6);
        assert!((solution.parameters[1] / truth[1] - 1.0).abs() < 1e-6);
        assert!(solution.covariance.is_some());
    }
}
