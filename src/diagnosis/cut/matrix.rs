//! Spectral matrices of a bin's channels, three by three, and their Cholesky factor.

use nalgebra::Complex;

/// Channels of one bin: force of tool 1, of tool 2, probe.
pub(crate) const CHANNELS: usize = 3;

/// Three by three; of fewer channels the first.
pub(crate) type Matrix = [[Complex<f64>; CHANNELS]; CHANNELS];

/// Nought.
pub(crate) const ZERO: Complex<f64> = Complex::new(0.0, 0.0);

/// Lower triangle L of S = L L^H; `None`: not positive.
pub(crate) fn cholesky(s: &Matrix, n: usize) -> Option<Matrix> {
    let mut l = [[ZERO; CHANNELS]; CHANNELS];
    for i in 0..n {
        for j in 0..=i {
            let mut sum = s[i][j];
            for k in 0..j {
                sum -= l[i][k] * l[j][k].conj();
            }
            if i == j {
                if !(sum.re > 0.0) {
                    return None;
                }
                l[i][i] = Complex::new(sum.re.sqrt(), 0.0);
            } else {
                l[i][j] = sum / l[j][j].re;
            }
        }
    }
    Some(l)
}

/// L^-1 x.
pub(crate) fn forward(l: &Matrix, x: &[Complex<f64>; CHANNELS], n: usize) -> [Complex<f64>; CHANNELS] {
    let mut u = [ZERO; CHANNELS];
    for i in 0..n {
        let mut sum = x[i];
        for k in 0..i {
            sum -= l[i][k] * u[k];
        }
        u[i] = sum / l[i][i].re;
    }
    u
}
