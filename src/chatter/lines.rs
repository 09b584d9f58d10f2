//! The lines of a band: the best one of each window, the strongest one, the one that stands.

use super::alternatives::against_noise;
use super::criteria::{CRITERIA, GROWTHS_1_S, LONGEST, PAST, WINDOWS};
use super::fourier::{Fourier, MOST_POINTS, POINTS};
use super::history::{History, Value};
use super::sustained::{BLOCK, KEPT, Residuals, since};
use super::window::{Conditions, Context, Detection, Window, fits};
use nalgebra::Complex;
use std::f64::consts::{EULER_GAMMA, PI, TAU};

type C = Complex<f64>;
/// The window that tells the level of all the band.
pub(super) const BAND_LEVEL: usize = 1;

/// First and last cell of a transform of `points` that lie in a band, Hz from the centre.
fn cells(band_hz: [f64; 2], rate_hz: f64, points: usize) -> std::ops::RangeInclusive<i64> {
    let (step_hz, half) = (rate_hz / points as f64, points as f64 / 2.0 - 2.0);
    let place = |hz: f64| (hz / step_hz).clamp(-half, half);
    #[expect(clippy::cast_possible_truncation, reason = "clamped to the transform")]
    let cells = (place(band_hz[0]).ceil() as i64, place(band_hz[1]).floor() as i64);
    cells.0..=cells.1
}

/// Hann's window at value `q` of `n`: what stands elsewhere does not leak here.
fn hann(q: usize, n: usize) -> f64 {
    (PI * (q as f64 + 0.5) / n as f64).sin().powi(2)
}

/// Power of cell `k`, counted from the centre. Requires: less than all cells from it.
fn power(x: &[C], k: i64) -> f64 {
    let at = if k < 0 { k + x.len() as i64 } else { k };
    x[at as usize].norm_sqr()
}

/// The cell of most power.
fn loudest(x: &[C], among: impl Iterator<Item = i64>) -> Option<i64> {
    let louder = |best: Option<(i64, f64)>, k: i64| {
        let now = power(x, k);
        if best.is_some_and(|(_, most)| now < most) { best } else { Some((k, now)) }
    };
    among.fold(None, louder).map(|(k, _)| k)
}

/// The test of one band.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Test {
    rate_hz: f64,
    centre_hz: f64,
    fourier: Fourier,
    /// Hann's window of each length.
    hann: [Vec<f64>; WINDOWS.len()],
}

impl Test {
    pub(super) fn new(rate_hz: f64, centre_hz: f64) -> Self {
        let hann = WINDOWS.map(|n| (0..n).map(|q| hann(q, n)).collect());
        Self { rate_hz, centre_hz, fourier: Fourier::new(), hann }
    }

    /// Hann's window of `n` values, the length of a window.
    fn hann(&self, n: usize) -> &[f64] {
        &self.hann[WINDOWS.iter().position(|w| *w == n).unwrap_or(WINDOWS.len() - 1)]
    }

    /// Looks at the last values, as many as a window has. Cost: no allocation.
    pub(super) fn detect(&self, history: &mut History, which: usize, context: &Context) -> Detection {
        const N: [usize; WINDOWS.len()] = WINDOWS;
        const P: [usize; WINDOWS.len()] = POINTS;
        // No more is cleared than the window needs.
        match which {
            0 => self.detect_in::<{ N[0] }, { P[0] }>(history, which, context),
            1 => self.detect_in::<{ N[1] }, { P[1] }>(history, which, context),
            2 => self.detect_in::<{ N[2] }, { P[2] }>(history, which, context),
            _ => self.detect_in::<{ N[3] }, { P[3] }>(history, which, context),
        }
    }

    /// The same in a window of `N` values, by a transform of `P` points.
    fn detect_in<const N: usize, const P: usize>(
        &self,
        history: &mut History,
        which: usize,
        context: &Context,
    ) -> Detection {
        let mut chirp = [C::ONE; N];
        let mut x = [C::ZERO; P];
        history.whiten(N);
        x[..N].copy_from_slice(history.white(N));
        let dt = 1.0 / context.rate_hz;
        if context.sweep_hz_s != 0.0 {
            for (q, (x, turn)) in x.iter_mut().zip(&mut chirp).enumerate() {
                let t = (N - 1 - q) as f64 * dt;
                *turn = C::from_polar(1.0, -0.5 * TAU * context.sweep_hz_s * t * t);
                *x *= *turn;
            }
        }
        let e: [C; N] = std::array::from_fn(|q| x[q]);
        let total: f64 = e.iter().map(C::norm_sqr).sum();
        if total <= 0.0 || !total.is_finite() {
            return Detection::default();
        }
        let line = self.line(&e, &mut x, context, total);
        let line = match against_noise(line, total, N, context) {
            (line, true) => line,
            (silent, false) => return silent,
        };
        let seen = context.seen.min(LONGEST + PAST);
        history.whiten(seen);
        Window { e: &e, chirp: &chirp, history, context, total, line, which, seen }.judge()
    }

    /// The best line of the window.
    fn line(&self, e: &[C], x: &mut [C], context: &Context, total: f64) -> Detection {
        let (n, points) = (e.len(), x.len());
        self.fourier.transform(x);
        let step_hz = context.rate_hz / points as f64;
        let among = cells(context.watched_hz, context.rate_hz, points);
        let best = loudest(x, among.clone()).unwrap_or(*among.start());
        let mut found = Detection { offset_hz: best as f64 * step_hz, ..Detection::default() };
        let mut energy = power(x, best) / n as f64;
        if energy > 0.3 * total || energy > context.levels.noise_nats * 0.3 {
            for growth_1_s in &GROWTHS_1_S {
                let cells = [best - 1, best, best + 1];
                let turns = cells.map(|k| k as f64 / points as f64);
                for (k, now) in cells.into_iter().zip(fits(e, turns, growth_1_s / context.rate_hz)) {
                    if now > energy {
                        energy = now;
                        (found.offset_hz, found.growth_1_s) = (k as f64 * step_hz, *growth_1_s);
                    }
                }
            }
        }
        found.contrast = energy;
        if energy > CRITERIA.hold * context.levels.noise_nats {
            refine(e, &mut found, (step_hz, context.rate_hz));
        }
        found
    }
}

/// A cell off by half its width loses a fifth of a line: its place to an eighth.
fn refine(e: &[C], found: &mut Detection, (step_hz, rate_hz): (f64, f64)) {
    for part in [0.5, 0.25, 0.125] {
        let from_hz = found.offset_hz;
        let places_hz = [-part, part].map(|side| from_hz + side * step_hz);
        let turns = places_hz.map(|hz| hz / rate_hz);
        for (offset_hz, now) in places_hz.into_iter().zip(fits(e, turns, found.growth_1_s / rate_hz)) {
            if now > found.contrast {
                (found.contrast, found.offset_hz) = (now, offset_hz);
            }
        }
    }
}

impl Test {
    /// Level of the band over the noise known, whatever lines stand in it: of the last values, as many as
    /// the window [`COMMON`] has.
    pub(super) fn band_level(&self, history: &mut History, context: &Context) -> f64 {
        let (n, points) = (WINDOWS[BAND_LEVEL], POINTS[BAND_LEVEL]);
        let mut x = [C::ZERO; POINTS[BAND_LEVEL]];
        let mut sum = 0.0;
        history.whiten(n);
        for ((x, white), hann) in x.iter_mut().zip(history.white(n)).zip(self.hann(n)) {
            *x = white * *hann;
            sum += hann.powi(2);
        }
        self.fourier.transform(&mut x);
        let among = cells(context.watched_hz, context.rate_hz, points);
        let count = among.clone().count().max(1) as f64;
        let all: f64 = among.map(|k| power(&x, k).max(f64::MIN_POSITIVE).ln()).sum();
        // The mean logarithm of an exponential variable is that of its mean less Euler's constant.
        (all / count + EULER_GAMMA).exp() / sum
    }

    /// Strongest line of the residual in these values, a window's length: a peak, no skirt of what
    /// stands beside; what is covered by a skirt is where it was looked for.
    pub(super) fn strongest(&self, values: &[Value], watched_hz: [f64; 2]) -> Strongest {
        let rate_hz = self.rate_hz;
        let n = values.len();
        let points = (4 * n.next_power_of_two()).min(MOST_POINTS);
        let mut x = [C::ZERO; MOST_POINTS];
        let mut sum = 0.0;
        for ((x, v), hann) in x.iter_mut().zip(values).zip(self.hann(n)) {
            *x = v.residual * *hann;
            sum += hann;
        }
        let x = &mut x[..points];
        self.fourier.transform(x);
        let among = cells(watched_hz, rate_hz, points);
        let middle = (among.start() + among.end()) / 2;
        let peak = |k: &i64| power(x, *k) >= power(x, k - 1) && power(x, *k) >= power(x, k + 1);
        let best = loudest(x, among.filter(peak)).unwrap_or(middle);
        let [a, b, c] = [best - 1, best, best + 1].map(|k| power(x, k).max(f64::MIN_POSITIVE).ln());
        let bend = a - 2.0 * b + c;
        let shift = if bend < 0.0 { (0.5 * (a - c) / bend).clamp(-0.5, 0.5) } else { 0.0 };
        let turns = (best as f64 + shift) / points as f64;
        let (first, last) = values.split_at(n / 2);
        let mut sums = [C::ZERO; 2];
        let (step, mut turn) = (C::from_polar(1.0, -TAU * turns), C::ONE);
        for (first, last) in first.iter().zip(last) {
            sums[0] += first.residual * turn;
            sums[1] += last.residual * turn;
            turn *= step;
        }
        let [first, last] = sums.map(|s| s.norm_sqr().max(f64::MIN_POSITIVE));
        let rise = last / first;
        Strongest {
            offset_hz: turns * rate_hz,
            power_n2: (b - 0.25 * (a - c) * shift).exp() / (sum * sum),
            growth_1_s: rise.max(f64::MIN_POSITIVE).ln() * rate_hz / n as f64,
        }
    }

    /// Strongest line between the orders, the strongest too of what a block does not tell from it: whether it
    /// stands, over the last `values`, which are of one cut.
    pub(super) fn sustained(&self, residuals: &Residuals, now: &Conditions, values: usize) -> Sustained {
        let (rate_hz, speed_hz) = (self.rate_hz, now.speed_hz);
        let none = Sustained { offset_hz: 0.0, nats: 0.0, power_n2: 0.0, side: 0.0 };
        if values < LONGEST {
            return none;
        }
        let mut x = [C::ZERO; MOST_POINTS];
        for ((x, v), hann) in x.iter_mut().zip(residuals.last(LONGEST)).zip(self.hann(LONGEST)) {
            *x = v * *hann;
        }
        self.fourier.transform(&mut x);
        let step_hz = rate_hz / MOST_POINTS as f64;
        let near = (2 * MOST_POINTS / BLOCK) as i64;
        let between = |k: &i64| {
            let hz = self.centre_hz + *k as f64 * step_hz;
            let order = hz / speed_hz.max(f64::MIN_POSITIVE);
            let apart_hz = (order - order.round()).abs() * speed_hz;
            now.alarm || speed_hz <= 0.0 || apart_hz > 2.5 * rate_hz / LONGEST as f64
        };
        let alone = |k: &i64| (k - near..=k + near).all(|m| power(&x, m) <= power(&x, *k));
        let among = cells(now.watched_hz, rate_hz, MOST_POINTS).filter(|k| between(k) && alone(k));
        let Some(best) = loudest(&x, among) else { return none };
        let turns = best as f64 / MOST_POINTS as f64;
        let blocks = (values / BLOCK).min(KEPT / BLOCK);
        let line = self.sums(residuals, blocks, turns);
        let powers = &line.map(|s| s.norm_sqr() / (0.25 * (BLOCK * BLOCK) as f64))[..blocks];
        let power_n2 = powers.iter().sum::<f64>() / blocks as f64;
        // What stands a turn beside the line and goes with it.
        let beside = |turn: f64| {
            let side = self.sums(residuals, blocks, turns + turn * speed_hz / rate_hz);
            let with: C = line.iter().zip(&side).map(|(l, s)| s * l.conj()).sum();
            with.norm_sqr() / line.iter().map(C::norm_sqr).sum::<f64>().powi(2)
        };
        let side = if speed_hz > 0.0 { beside(-1.0).max(beside(1.0)) } else { 0.0 };
        Sustained { offset_hz: best as f64 * step_hz, nats: since(powers), power_n2, side }
    }
}

impl Test {
    /// A line in each of the last blocks.
    fn sums(&self, residuals: &Residuals, blocks: usize, turns: f64) -> [C; KEPT / BLOCK] {
        let mut sums = [C::ZERO; KEPT / BLOCK];
        let hann = self.hann(BLOCK);
        let (step, mut turn) = (C::from_polar(1.0, -TAU * turns), C::ONE);
        for (q, v) in residuals.last(blocks * BLOCK).enumerate() {
            sums[q / BLOCK] += v * turn * hann[q % BLOCK];
            turn *= step;
        }
        sums
    }
}

/// The strongest line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Strongest {
    /// From the centre.
    pub(super) offset_hz: f64,
    pub(super) power_n2: f64,
    pub(super) growth_1_s: f64,
}

/// A line and the evidence that its power stands.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sustained {
    /// From the centre.
    pub(super) offset_hz: f64,
    pub(super) nats: f64,
    pub(super) power_n2: f64,
    /// Power of what stands one turn of the spindle beside it, over its own: the cut modulates its lines.
    pub(super) side: f64,
}
