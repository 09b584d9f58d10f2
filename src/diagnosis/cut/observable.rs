//! What enters the likelihood: an observable says, for a machine, its residuals or its spectra.
//!
//! -ln L = sum_f [ x^H S^-1 x + ln det S ] + 1/2 sum rho(r)^2 + 1/2 sum p^2
//!
//! Recordings give both kinds; a row of a table gives residuals (an outcome as its deviance residual).

use super::machine::Machine;
use super::matrix::{CHANNELS, Matrix, cholesky, forward};
use super::source::Sources;
use crate::stability::Root;
use nalgebra::Complex;

/// One bin of a spectrum: what is left unexplained, and the spectrum that it should have.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bin {
    /// Complex amplitudes, root of the one-sided spectrum.
    pub(crate) x: [Complex<f64>; CHANNELS],
    /// Its frequency.
    pub(crate) frequency_hz: f64,
    /// ln |d x/d recorded|^2: what is computed from the recorded forces with the machine's own numbers is no
    /// smaller for that; 0 where x is what was recorded.
    pub(crate) log_jacobian: f64,
    /// Their spectra and cross-spectra.
    pub(crate) s: Matrix,
}

/// What a machine says of an observable.
#[derive(Debug, Clone)]
pub(crate) enum Part {
    /// Residuals over their standard deviations.
    Rows(Vec<f64>),
    /// Bins of `channels` channels.
    Bins {
        /// Channels in use, the first of each bin.
        channels: usize,
        /// The bins.
        bins: Vec<Bin>,
    },
}

/// How much of the bins is looked at: every `n`th.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Every(pub(crate) usize);

/// Something observed, of whichever kind.
pub(crate) type Observed<'a> = Box<dyn Observable + 'a>;

/// Something observed of a machine.
pub(crate) trait Observable: Sync {
    /// What this machine says of it. The number of values must not depend on the machine.
    fn part(&self, machine: &Machine, every: Every) -> Part;

    /// The same of several machines. They are neighbours: what they have in common is computed once.
    fn parts(&self, machines: &[Machine], every: Every) -> Vec<Part> {
        machines.iter().map(|machine| self.part(machine, every)).collect()
    }

    /// Where it is from, for the search of what is left.
    fn origin(&self) -> Origin;

    /// Bins that no fit looks at, below its band: what is left there is slow.
    fn slow(&self, _: &Machine) -> Option<Part> {
        None
    }

    /// What forces elsewhere would make of its bins at a frequency; `None`: not of two tools.
    fn sources(&self, _: &Machine, _frequency_hz: f64) -> Option<Sources> {
        None
    }

    /// Forces less what is foretold one sample ahead, squared, N^2; `None`: no forces.
    fn left_over(&self, _: &Machine) -> Option<LeftOver> {
        None
    }

    /// Its line, and the root of a machine under its condition; `None`: no line was followed.
    fn line(&self, _: &Machine) -> Option<LineBeside> {
        None
    }
}

/// The line of a stretch beside that of a machine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LineBeside {
    /// As measured, without any model.
    pub(crate) measured: Root,
    /// Standard deviation of the measured growth, 1/s.
    pub(crate) deviation_1_s: f64,
    /// The machine's rightmost root.
    pub(crate) foretold: Root,
}

/// Mean square of the forces less what is foretold, of one tool, N^2.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct LeftOver {
    /// As recorded.
    pub(crate) recorded_n2: f64,
    /// What random force and sensor leave at best.
    pub(crate) floor_n2: f64,
}

impl LeftOver {
    /// Error of the prediction one sample ahead out of the whitened spectra of `tools` forces, a band of
    /// `band_hz` wide.
    ///
    /// A spectrum S = H V H^H with H causal, monic and of causal inverse has the innovations V (Kolmogorov,
    /// Szego), ln det V = mean of ln det S; who predicts by a wrong S leaves its whitened power times that,
    /// never less than who predicts by the right one:
    ///
    /// floor = (exp mean ln det S)^(1/tools) band,  recorded = floor mean(x^H S^-1 x)/tools
    pub(crate) fn of_bins(bins: &[Bin], tools: usize, band_hz: f64) -> Self {
        let (mut power, mut log_det, mut count) = (0.0, 0.0, 0.0);
        for bin in bins {
            let Some(l) = cholesky(&bin.s, tools) else { continue };
            power += forward(&l, &bin.x, tools)[..tools].iter().map(Complex::norm_sqr).sum::<f64>();
            log_det += (0..tools).map(|i| 2.0 * l[i][i].re.ln()).sum::<f64>() - bin.log_jacobian;
            count += tools as f64;
        }
        let count = f64::max(count, 1.0);
        let floor_n2 = (log_det / count).exp() * band_hz;
        Self { recorded_n2: floor_n2 * power / count, floor_n2 }
    }
}

impl std::ops::Mul<f64> for LeftOver {
    type Output = Self;
    fn mul(self, factor: f64) -> Self {
        Self { recorded_n2: self.recorded_n2 * factor, floor_n2: self.floor_n2 * factor }
    }
}

/// Where an observable is from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Origin {
    /// Kind.
    pub(crate) kind: OriginKind,
    /// Index of the recording; `None`: a table.
    pub(crate) recording: Option<usize>,
    /// Begin and end, s.
    pub(crate) span_s: [f64; 2],
}

/// Kinds of observables.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum OriginKind {
    /// Spectra of a calm stretch.
    Calm,
    /// Innovations of a followed stretch.
    Followed,
    /// Mean forces.
    Means,
    /// Lines of the spindle.
    Orders,
    /// Spindle angle.
    Angle,
    /// Rows of a table.
    Table,
}

/// An observable that is lent to a fit of some of them.
pub(crate) struct Lent<'a>(pub(crate) &'a dyn Observable);

impl Observable for Lent<'_> {
    fn part(&self, machine: &Machine, every: Every) -> Part {
        self.0.part(machine, every)
    }

    fn origin(&self) -> Origin {
        self.0.origin()
    }

    fn sources(&self, machine: &Machine, frequency_hz: f64) -> Option<Sources> {
        self.0.sources(machine, frequency_hz)
    }

    fn slow(&self, machine: &Machine) -> Option<Part> {
        self.0.slow(machine)
    }
}

#[cfg(test)]
mod tests {
    use super::super::matrix::ZERO;
    use super::*;

    /// Who predicts by the right spectrum leaves the floor; by a wrong one more, however loud it is.
    #[test]
    fn a_wrong_spectrum_predicts_worse_than_the_right_one() {
        let truth = |k: usize| 1.0 + 0.9 * (0.13 * k as f64).sin();
        let left = |model: &dyn Fn(usize) -> f64| {
            let bin = |k: usize| {
                let mut s = [[ZERO; CHANNELS]; CHANNELS];
                s[0][0] = Complex::new(model(k), 0.0);
                let x = [Complex::new(truth(k).sqrt(), 0.0), ZERO, ZERO];
                Bin { x, frequency_hz: k as f64, log_jacobian: 0.0, s }
            };
            LeftOver::of_bins(&(0..400).map(bin).collect::<Vec<_>>(), 1, 1.0)
        };
        let right = left(&truth);
        assert!((right.recorded_n2 - right.floor_n2).abs() < 1e-12);
        for scale in [0.1, 1.0, 10.0] {
            let wrong = left(&|k| scale * (1.0 + 0.5 * (0.13 * k as f64).sin()));
            assert!(wrong.recorded_n2 > 1.05 * right.recorded_n2, "{scale}: {wrong:?} {right:?}");
        }
    }
}
