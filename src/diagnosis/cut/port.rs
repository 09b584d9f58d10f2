//! Where does a force that nothing explains act? The likeliest of the ways in which it may reach both tools.

use super::criteria::CRITERIA;
use super::matrix::{CHANNELS, Matrix, cholesky, forward};
use super::observable::Bin;
use super::source::{Pair, Sources};
use crate::plant::effects::Port;
use nalgebra::Complex;

/// x^H S^-1 x + ln det S of the forces of a bin, with a source of a share of its noise.
fn value(bin: &Bin, acting: &[Pair], share: f64) -> f64 {
    let power: f64 = acting.iter().flatten().map(Complex::norm_sqr).sum();
    let level = share * (bin.s[0][0].re + bin.s[1][1].re) / power.max(f64::MIN_POSITIVE);
    let mut s: Matrix = bin.s;
    for v in acting {
        for i in 0..2 {
            for j in 0..2 {
                s[i][j] += v[i] * v[j].conj() * level;
            }
        }
    }
    let Some(l) = cholesky(&s, 2) else { return f64::INFINITY };
    let mut x = [Complex::new(0.0, 0.0); CHANNELS];
    x[..2].copy_from_slice(&bin.x[..2]);
    let u = forward(&l, &x, 2);
    (0..2).map(|i| u[i].norm_sqr() + 2.0 * l[i][i].re.ln()).sum()
}

/// The likeliest port of what these bins hold beyond their spectra, each with as strong a source as fits.
///
/// What the mode of a cut amplifies looks alike whatever drives it: it is the bar's, unless another port is
/// likelier by the price of a number.
pub(crate) fn likeliest(bins: &[(Bin, Sources)]) -> Port {
    // Of each bin, by hypothesis.
    let acting: Vec<_> = bins.iter().map(|(b, s)| (b, s.hypotheses())).collect();
    let Some((_, first)) = acting.first() else { return Port::Process };
    // From a thousandth of the noise up to a thousand of it, four a factor of ten.
    let shares = || (-12..=12).map(|k| 10f64.powf(f64::from(k) / 4.0));
    let worth = |k: usize, port: Port| {
        let at = |share: f64| acting.iter().map(|(b, ways)| value(b, &ways[k].1, share)).sum::<f64>();
        let least = shares().map(at).fold(f64::INFINITY, f64::min);
        least + if port == Port::Workpiece { 0.0 } else { CRITERIA.price_nats }
    };
    let best = first.iter().enumerate().map(|(k, (port, _))| (worth(k, *port), *port));
    best.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(Port::Process, |b| b.1)
}

#[cfg(test)]
mod tests {
    use super::super::matrix::ZERO;
    use super::super::synthetic::machine;
    use super::*;
    use crate::plant::cut_loop::CutLoop;
    use crate::plant::cut_terms::CutCondition;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};
    use std::f64::consts::TAU;

    /// Bins of a calm cut with a source at one port, as strong as the random force, slow or at the bar.
    fn bins(
        acting: impl Fn(&Sources) -> Vec<Pair>,
        from_hz: f64,
        undone: bool,
        seed: u64,
    ) -> Vec<(Bin, Sources)> {
        let machine = machine();
        let cut = CutLoop::new(&machine.terms(&CutCondition::of(&machine.scenario)));
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || {
            let [re, im]: [f64; 2] = std::array::from_fn(|_| StandardNormal.sample(&mut random));
            Complex::new(re, im) * 0.5f64.sqrt()
        };
        let of = |k: usize| {
            let frequency_hz = from_hz + 2.0 * k as f64;
            let sources = Sources::of(&cut, Complex::new(0.0, TAU * frequency_hz), undone);
            let mut s = [[ZERO; CHANNELS]; CHANNELS];
            let mut x = [ZERO; CHANNELS];
            let mut add = |v: Pair, size: f64, known: bool| {
                let n = normal() * size;
                for i in 0..2 {
                    x[i] += v[i] * n;
                    for j in 0..2 {
                        s[i][j] += v[i] * v[j].conj() * if known { size * size } else { 0.0 };
                    }
                }
            };
            sources.process.iter().for_each(|v| add(*v, 1.0, true));
            let of_noise: f64 = sources.process.iter().flatten().map(Complex::norm_sqr).sum();
            for v in acting(&sources) {
                let own: f64 = v.iter().map(Complex::norm_sqr).sum();
                add(v, (of_noise / own).sqrt(), false);
            }
            (Bin { x, frequency_hz, log_jacobian: 0.0, s }, sources)
        };
        (0..60).map(of).collect()
    }

    #[test]
    fn each_port_is_told_from_the_others() {
        for undone in [false, true] {
            for from_hz in [6.0, 560.0] {
                for seed in 0..5 {
                    let told = |port: Port, acting: &dyn Fn(&Sources) -> Vec<Pair>| {
                        assert_eq!(likeliest(&bins(acting, from_hz, undone, seed)), port, "{from_hz} {seed}");
                    };
                    told(Port::Process, &|s| s.process.to_vec());
                    told(Port::Process, &|s| vec![s.process[1]]);
                    told(Port::Workpiece, &|s| vec![s.workpiece]);
                    told(Port::Turret, &|s| vec![s.turret]);
                }
            }
        }
    }
}
