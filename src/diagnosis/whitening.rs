//! Whitening of the two residuals together: a vector autoregression, estimated where the residual is quiet.

use super::problem::{Column, Sides};
use crate::signal::inner_products::{add_filtered, dot};
use nalgebra::{DMatrix, Matrix2};

/// Length of the autoregression in samples of the regression.
const ORDER: usize = 20;
/// Blocks in which the residual is judged quiet or loud, s.
const BLOCK_S: f64 = 0.1;
/// Part of the blocks that the noise is taken from.
const QUIET_SHARE: f64 = 0.5;

/// e_w[t] = L^-1 (e[t] - sum_k A_k e[t-k]).
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Whitener {
    /// A_1 .. A_p.
    lags: Vec<Matrix2<f64>>,
    scale: Matrix2<f64>,
    sides: usize,
}

/// How a flat vector is cut: per recording, side by side.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Layout {
    pub(crate) lengths: Vec<usize>,
    pub(crate) sides: usize,
}

impl Layout {
    pub(crate) fn total(&self) -> usize {
        self.lengths.iter().sum::<usize>() * self.sides
    }

    /// Start of each (recording, side).
    pub(crate) fn start(&self, recording: usize, side: usize) -> usize {
        self.lengths[..recording].iter().sum::<usize>() * self.sides + side * self.lengths[recording]
    }
}

fn series(sides: &Sides, side: usize) -> Option<&[f64]> {
    if side == 0 { sides.motor.as_deref() } else { sides.stage.as_deref() }
}

fn mean(sides: &Sides, side: usize) -> f64 {
    series(sides, side).map_or(0.0, |x| x.iter().sum::<f64>() / x.len().max(1) as f64)
}

impl Whitener {
    /// Estimates the noise of residuals. `rate_hz`: of the series.
    pub(crate) fn fit(residual: &Column, layout: &Layout, rate_hz: f64) -> Self {
        let s = layout.sides;
        // A constant is a load, not noise: the autoregression would answer with a root at one.
        let means: Vec<[f64; 2]> = residual.iter().map(|r| [mean(r, 0), mean(r, 1)]).collect();
        let block = ((BLOCK_S * rate_hz) as usize).max(4 * ORDER);
        let quiet = quiet_blocks(residual, layout, block);
        let dim = s * ORDER;
        let mut n = Normal {
            normal: DMatrix::zeros(dim, dim),
            right: DMatrix::zeros(dim, s),
            power: DMatrix::zeros(s, s),
            count: 0.0,
        };
        for &(recording, start, end) in &quiet {
            let sides: Vec<Vec<f64>> = (0..s)
                .map(|side| {
                    let mean = means[recording][side];
                    series(&residual[recording], side).map_or_else(
                        || vec![0.0; end - start],
                        |x| x[start..end].iter().map(|v| v - mean).collect(),
                    )
                })
                .collect();
            n.add(&sides);
        }
        for a in 0..dim {
            for b in 0..a {
                n.normal[(b, a)] = n.normal[(a, b)];
            }
        }
        Self::solve(n, s)
    }

    /// Weights by the covariance of the two sides only, all frequencies alike.
    ///
    /// An error of the stretch acts on both sides and not on their sum, a force on its own side: the
    /// covariance says which of the three is to be trusted.
    pub(crate) fn flat(residual: &Column, layout: &Layout) -> Self {
        let power = |a: usize, b: usize| -> f64 {
            let sides = residual.iter().filter_map(|r| Some((series(r, a)?, series(r, b)?)));
            sides.map(|(x, y)| dot(x, y)).sum::<f64>() / layout.total().max(1) as f64
        };
        let mut covariance = Matrix2::identity();
        for a in 0..layout.sides {
            for b in 0..layout.sides {
                covariance[(a, b)] = power(a, b);
            }
        }
        Self { lags: Vec::new(), scale: whitening_root(covariance), sides: layout.sides }
    }

    /// Weights each of two sides by one over its scale.
    pub(crate) fn of_scales(scales: [f64; 2]) -> Self {
        let scale = Matrix2::from_diagonal(&scales.map(f64::recip).into());
        Self { lags: Vec::new(), scale, sides: 2 }
    }

    fn solve(mut n: Normal, sides: usize) -> Self {
        // A floor of 1e-3 of the power: the band above the low-pass holds no noise and must not be amplified
        // without end.
        for k in 0..n.normal.nrows() {
            let c = k % sides;
            n.normal[(k, k)] += 1e-3 * n.power[(c, c)] + f64::MIN_POSITIVE;
        }
        let dim = n.normal.nrows();
        let solution =
            n.normal.clone().cholesky().map_or_else(|| DMatrix::zeros(dim, sides), |c| c.solve(&n.right));
        let explained = solution.transpose() * &n.right;
        let count = n.count.max(1.0);
        let mut covariance = Matrix2::<f64>::identity();
        for a in 0..sides {
            for b in 0..sides {
                covariance[(a, b)] =
                    (n.power[(a, b)] - 0.5 * (explained[(a, b)] + explained[(b, a)])) / count;
            }
            let least = 1e-6 * n.power[(a, a)] / count + 1e-300;
            covariance[(a, a)] = covariance[(a, a)].max(least);
        }
        let scale = whitening_root(covariance);
        let lags = (0..ORDER)
            .map(|k| {
                let mut m = Matrix2::zeros();
                for a in 0..sides {
                    for b in 0..sides {
                        m[(a, b)] = solution[(k * sides + b, a)];
                    }
                }
                m
            })
            .collect();
        Self { lags, scale, sides }
    }

    /// Filter taps from input side `b` to output side `a`.
    fn taps(&self, a: usize, b: usize) -> Vec<f64> {
        let mut taps = vec![self.scale[(a, b)]];
        taps.extend(
            self.lags.iter().map(|m| -(0..self.sides).map(|c| self.scale[(a, c)] * m[(c, b)]).sum::<f64>()),
        );
        taps
    }

    /// Whitens a column into a flat vector. The first samples of a recording, without a past, become zero.
    pub(crate) fn whiten(&self, column: &Column, layout: &Layout) -> Vec<f64> {
        let mut flat = vec![0.0; layout.total()];
        for b in 0..self.sides {
            for a in 0..self.sides {
                let taps = self.taps(a, b);
                if taps.iter().all(|t| *t == 0.0) {
                    continue;
                }
                for (recording, sides) in column.iter().enumerate() {
                    let Some(x) = series(sides, b) else { continue };
                    let start = layout.start(recording, a);
                    add_filtered(&mut flat[start..start + x.len()], x, &taps);
                }
            }
        }
        flat
    }

    /// Transpose of [`Whitener::whiten`]: back to series per side.
    pub(crate) fn adjoint(&self, flat: &[f64], layout: &Layout) -> Column {
        (0..layout.lengths.len())
            .map(|recording| {
                let n = layout.lengths[recording];
                let mut out = vec![vec![0.0; n]; self.sides];
                for (b, o) in out.iter_mut().enumerate() {
                    for a in 0..self.sides {
                        let start = layout.start(recording, a);
                        let z = &flat[start..start + n];
                        for (k, tap) in self.taps(a, b).iter().enumerate() {
                            for t in k.max(self.lags.len())..n {
                                o[t - k] += tap * z[t];
                            }
                        }
                    }
                }
                let mut out = out.into_iter();
                Sides { motor: out.next(), stage: out.next() }
            })
            .collect()
    }
}

/// L^-1 of L L' = `covariance`.
fn whitening_root(mut covariance: Matrix2<f64>) -> Matrix2<f64> {
    for k in 0..2 {
        covariance[(k, k)] += 1e-300;
    }
    covariance.cholesky().and_then(|c| c.l().try_inverse()).unwrap_or_else(|| {
        Matrix2::new(covariance[(0, 0)].powf(-0.5), 0.0, 0.0, covariance[(1, 1)].powf(-0.5))
    })
}

/// Normal equations of the autoregression; rows and columns count lag by lag, side by side inside a lag.
struct Normal {
    /// Lower triangle of sum_t x[t - 1 - k] x[t - 1 - j].
    normal: DMatrix<f64>,
    right: DMatrix<f64>,
    power: DMatrix<f64>,
    count: f64,
}

impl Normal {
    /// Adds one block of all sides, the first [`ORDER`] samples of which are only past.
    ///
    /// Products of lag k + 1 with lag j + 1 are those of k with j, one sample more at the begin and one less
    /// at the end: only those with lag 0 are summed. Checked by: tests::lags_are_summed_once.
    fn add(&mut self, sides: &[Vec<f64>]) {
        let s = sides.len();
        let (first, end) = (ORDER, sides.first().map_or(0, Vec::len));
        if end <= first {
            return;
        }
        let lagged = |c: usize, k: usize| &sides[c][first - k..end - k];
        let mut block = DMatrix::zeros(s * ORDER, s * ORDER);
        for (a, c) in (0..s).flat_map(|a| (0..s).map(move |c| (a, c))) {
            self.power[(a, c)] += dot(lagged(a, 0), lagged(c, 0));
            for k in 0..ORDER {
                self.right[(k * s + a, c)] += dot(lagged(a, k + 1), lagged(c, 0));
                block[(k * s + a, c)] = dot(lagged(a, k + 1), lagged(c, 1));
            }
            for k in 1..ORDER {
                for j in 1..=k {
                    let begin = sides[a][first - 1 - k] * sides[c][first - 1 - j];
                    let past = sides[a][end - 1 - k] * sides[c][end - 1 - j];
                    block[(k * s + a, j * s + c)] = block[((k - 1) * s + a, (j - 1) * s + c)] + begin - past;
                }
            }
        }
        self.normal += block;
        self.count += (end - first) as f64;
    }
}

/// The quieter share of blocks, by the power of each side in units of its median.
fn quiet_blocks(residual: &Column, layout: &Layout, block: usize) -> Vec<(usize, usize, usize)> {
    let mut blocks = Vec::new();
    for (recording, &n) in layout.lengths.iter().enumerate() {
        let mut start = 0;
        while start + block <= n {
            let powers: Vec<f64> = (0..layout.sides)
                .map(|c| {
                    series(&residual[recording], c)
                        .map_or(0.0, |x| x[start..start + block].iter().map(|v| v * v).sum())
                })
                .collect();
            blocks.push((recording, start, start + block, powers));
            start += block;
        }
    }
    let medians: Vec<f64> = (0..layout.sides)
        .map(|c| {
            let mut p: Vec<f64> = blocks.iter().map(|b| b.3[c]).collect();
            p.sort_by(f64::total_cmp);
            p.get(p.len() / 2).copied().unwrap_or(1.0).max(1e-300)
        })
        .collect();
    let mut ranked: Vec<(f64, (usize, usize, usize))> = blocks
        .iter()
        .map(|b| (b.3.iter().zip(&medians).map(|(p, m)| p / m).sum::<f64>(), (b.0, b.1, b.2)))
        .collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    let keep = ((ranked.len() as f64 * QUIET_SHARE).ceil() as usize).max(1).min(ranked.len());
    ranked.truncate(keep);
    ranked.into_iter().map(|r| r.1).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lags_are_summed_once() {
        let side = |w: f64| (0..90).map(|k| (w * f64::from(k)).sin() + 0.01 * f64::from(k % 7)).collect();
        let sides: Vec<Vec<f64>> = vec![side(0.31), side(1.7)];
        let dim = 2 * ORDER;
        let mut n = Normal {
            normal: DMatrix::zeros(dim, dim),
            right: DMatrix::zeros(dim, 2),
            power: DMatrix::zeros(2, 2),
            count: 0.0,
        };
        n.add(&sides);
        for a in 0..dim {
            for b in 0..=a {
                let sum: f64 =
                    (ORDER..90).map(|t| sides[a % 2][t - 1 - a / 2] * sides[b % 2][t - 1 - b / 2]).sum();
                assert!((n.normal[(a, b)] - sum).abs() < 1e-9, "{a} {b}: {} for {sum}", n.normal[(a, b)]);
            }
        }
    }
}
