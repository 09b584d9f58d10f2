//! The lines of a band: the best one of each window, the strongest one, the one that stands.

use super::alternatives::Window;
use super::criteria::{CRITERIA, GROWTHS_1_S, LONGEST, WINDOWS};
use super::fourier::Fourier;
use super::steady::{BLOCK, KEPT, Steady, evidence};
use super::sweep::PAST;
use super::window::{Around, Heard, Value, fit};
use nalgebra::Complex;
use std::f64::consts::{PI, TAU};

type C = Complex<f64>;
const ZERO: C = C::new(0.0, 0.0);
/// Points of the transforms: twice the values of the windows.
pub(super) const POINTS: [usize; WINDOWS.len()] = [64, 128, 256, 512];
const MOST_POINTS: usize = POINTS[POINTS.len() - 1];

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

/// Power of cell `k`, counted from the centre.
fn power(x: &[C], k: i64) -> f64 {
    let at = k.rem_euclid(x.len() as i64) as usize;
    x[at].norm_sqr()
}

/// The test of one band.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Test {
    fourier: Fourier,
}

impl Test {
    pub(super) fn new() -> Self {
        Self { fourier: Fourier::new(POINTS[POINTS.len() - 1]) }
    }

    /// Looks at the last values, as many as a window has. Cost: no allocation.
    pub(super) fn look(&self, values: &[Value], which: usize, around: &Around) -> Heard {
        let n = WINDOWS[which];
        let past = &values[values.len() - n - PAST..values.len() - n];
        let values = &values[values.len() - n..];
        let mut e = [ZERO; LONGEST];
        let mut chirp = [C::new(1.0, 0.0); LONGEST];
        let dt = 1.0 / around.rate_hz;
        for (q, (x, turn)) in e.iter_mut().zip(&mut chirp).take(n).enumerate() {
            if around.sweep_hz_s != 0.0 {
                let t = (n - 1 - q) as f64 * dt;
                *turn = C::from_polar(1.0, -0.5 * TAU * around.sweep_hz_s * t * t);
            }
            *x = values[q].white * *turn;
        }
        let (e, chirp) = (&e[..n], &chirp[..n]);
        let total: f64 = e.iter().map(C::norm_sqr).sum();
        if total <= 0.0 || !total.is_finite() {
            return Heard::default();
        }
        let heard = self.line(e, which, around, total);
        Window { e, chirp, values, past, around, total, heard, which }.judge()
    }

    /// The best line of the window.
    fn line(&self, e: &[C], which: usize, around: &Around, total: f64) -> Heard {
        let (n, points) = (e.len(), POINTS[which]);
        let mut x = [ZERO; MOST_POINTS];
        x[..n].copy_from_slice(e);
        let x = &mut x[..points];
        self.fourier.transform(x);
        let step_hz = around.rate_hz / points as f64;
        let among = cells(around.watched_hz, around.rate_hz, points);
        let best = among.clone().max_by(|a, b| power(x, *a).total_cmp(&power(x, *b)));
        let best = best.unwrap_or(*among.start());
        let mut found = Heard { offset_hz: best as f64 * step_hz, ..Heard::default() };
        let mut energy = power(x, best) / n as f64;
        if energy > 0.3 * total || energy > around.levels.noise_nats * 0.3 {
            for growth_1_s in &GROWTHS_1_S[1..] {
                for k in best - 1..=best + 1 {
                    let now = fit(e, k as f64 / points as f64, growth_1_s / around.rate_hz);
                    if now > energy {
                        energy = now;
                        (found.offset_hz, found.growth_1_s) = (k as f64 * step_hz, *growth_1_s);
                    }
                }
            }
        }
        found.contrast = energy;
        if energy > CRITERIA.silent * around.levels.noise_nats {
            refine(e, &mut found, (step_hz, around.rate_hz));
        }
        found
    }
}

/// A cell off by half its width loses a fifth of a line: its place to an eighth.
fn refine(e: &[C], found: &mut Heard, (step_hz, rate_hz): (f64, f64)) {
    for part in [0.5, 0.25, 0.125] {
        let from_hz = found.offset_hz;
        for side in [-part, part] {
            let offset_hz = from_hz + side * step_hz;
            let now = fit(e, offset_hz / rate_hz, found.growth_1_s / rate_hz);
            if now > found.contrast {
                (found.contrast, found.offset_hz) = (now, offset_hz);
            }
        }
    }
}

impl Test {
    /// Level of the band over the noise known, whatever lines stand in it: of the last values, as many as
    /// window `which` has.
    pub(super) fn common(&self, values: &[Value], which: usize, around: &Around) -> f64 {
        let (n, points) = (WINDOWS[which], POINTS[which]);
        let mut x = [ZERO; MOST_POINTS];
        let mut sum = 0.0;
        for (q, (x, v)) in x.iter_mut().zip(&values[values.len() - n..]).enumerate() {
            *x = v.white * hann(q, n);
            sum += hann(q, n).powi(2);
        }
        let x = &mut x[..points];
        self.fourier.transform(x);
        let among = cells(around.watched_hz, around.rate_hz, points);
        let count = among.clone().count().max(1) as f64;
        let all: f64 = among.map(|k| power(x, k).max(f64::MIN_POSITIVE).ln()).sum();
        // The mean logarithm of an exponential variable is that of its mean less Euler's constant.
        (all / count + EULER).exp() / sum
    }

    /// Strongest line of the residual in the last `n` values, a window's length: a peak, no skirt of what
    /// stands beside; what is covered by a skirt is where it was looked for.
    pub(super) fn strongest(
        &self,
        values: &[Value],
        n: usize,
        (rate_hz, watched_hz): (f64, [f64; 2]),
    ) -> Strongest {
        let points = (4 * n.next_power_of_two()).min(MOST_POINTS);
        let mut x = [ZERO; MOST_POINTS];
        let values = &values[values.len() - n..];
        let mut sum = 0.0;
        for (q, (x, v)) in x.iter_mut().zip(values).enumerate() {
            *x = v.residual * hann(q, n);
            sum += hann(q, n);
        }
        let x = &mut x[..points];
        self.fourier.transform(x);
        let among = cells(watched_hz, rate_hz, points);
        let middle = (among.start() + among.end()) / 2;
        let peak = |k: &i64| power(x, *k) >= power(x, k - 1) && power(x, *k) >= power(x, k + 1);
        let best = among.filter(peak).max_by(|a, b| power(x, *a).total_cmp(&power(x, *b))).unwrap_or(middle);
        let [a, b, c] = [best - 1, best, best + 1].map(|k| power(x, k).max(f64::MIN_POSITIVE).ln());
        let bend = a - 2.0 * b + c;
        let shift = if bend < 0.0 { (0.5 * (a - c) / bend).clamp(-0.5, 0.5) } else { 0.0 };
        let turns = (best as f64 + shift) / points as f64;
        let half = |part: &[Value]| {
            let turned = |(q, v): (usize, &Value)| v.residual * C::from_polar(1.0, -TAU * turns * q as f64);
            part.iter().enumerate().map(turned).sum::<C>().norm_sqr().max(f64::MIN_POSITIVE)
        };
        let rise = half(&values[n / 2..]) / half(&values[..n / 2]);
        Strongest {
            offset_hz: turns * rate_hz,
            power_n2: (b - 0.25 * (a - c) * shift).exp() / (sum * sum),
            growth_1_s: rise.max(f64::MIN_POSITIVE).ln() * rate_hz / n as f64,
        }
    }

    /// Strongest line between the orders, the strongest too of what a block does not tell from it: whether it
    /// stands, over as many of the last values as are `clean`.
    pub(super) fn standing(&self, steady: &Steady, place: &Place) -> Standing {
        let Place { rate_hz, centre_hz, speed_hz, .. } = *place;
        let none = Standing { offset_hz: 0.0, nats: 0.0, power_n2: 0.0, side: 0.0 };
        if place.clean < LONGEST {
            return none;
        }
        let mut x = [ZERO; MOST_POINTS];
        for (q, (x, v)) in x.iter_mut().zip(steady.last(LONGEST)).enumerate() {
            *x = v * hann(q, LONGEST);
        }
        self.fourier.transform(&mut x);
        let step_hz = rate_hz / MOST_POINTS as f64;
        let near = (2 * MOST_POINTS / BLOCK) as i64;
        let between = |k: &i64| {
            let hz = centre_hz + *k as f64 * step_hz;
            let order = hz / speed_hz.max(f64::MIN_POSITIVE);
            let apart_hz = (order - order.round()).abs() * speed_hz;
            let slip_hz = (CRITERIA.slip * hz).min(0.25 * speed_hz);
            place.alarm || speed_hz <= 0.0 || apart_hz > slip_hz.max(2.5 * rate_hz / LONGEST as f64)
        };
        let alone = |k: &i64| (k - near..=k + near).all(|m| power(&x, m) <= power(&x, *k));
        let among = cells(place.watched_hz, rate_hz, MOST_POINTS).filter(|k| between(k) && alone(k));
        let Some(best) = among.max_by(|a, b| power(&x, *a).total_cmp(&power(&x, *b))) else { return none };
        let turns = best as f64 / MOST_POINTS as f64;
        let blocks = (place.clean / BLOCK).min(KEPT / BLOCK);
        let line = sums(steady, blocks, turns);
        let powers = &line.map(|s| s.norm_sqr() / (0.25 * (BLOCK * BLOCK) as f64))[..blocks];
        let power_n2 = powers.iter().sum::<f64>() / blocks as f64;
        // What stands a turn beside the line and goes with it.
        let beside = |turn: f64| {
            let side = sums(steady, blocks, turns + turn * speed_hz / rate_hz);
            let with: C = line.iter().zip(&side).map(|(l, s)| s * l.conj()).sum();
            with.norm_sqr() / line.iter().map(C::norm_sqr).sum::<f64>().powi(2)
        };
        let side = if speed_hz > 0.0 { beside(-1.0).max(beside(1.0)) } else { 0.0 };
        Standing { offset_hz: best as f64 * step_hz, nats: evidence(powers), power_n2, side }
    }
}

/// A line in each of the last blocks.
fn sums(steady: &Steady, blocks: usize, turns: f64) -> [C; KEPT / BLOCK] {
    let mut sums = [ZERO; KEPT / BLOCK];
    for (q, v) in steady.last(blocks * BLOCK).enumerate() {
        let turn = C::from_polar(hann(q % BLOCK, BLOCK), -TAU * (turns * q as f64).fract());
        sums[q / BLOCK] += v * turn;
    }
    sums
}

const EULER: f64 = 0.577;

/// The strongest line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Strongest {
    /// From the centre.
    pub(super) offset_hz: f64,
    pub(super) power_n2: f64,
    pub(super) growth_1_s: f64,
}

/// Where a line that stands is looked for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    pub(super) rate_hz: f64,
    pub(super) centre_hz: f64,
    pub(super) speed_hz: f64,
    /// Where orders count too.
    pub(super) alarm: bool,
    pub(super) watched_hz: [f64; 2],
    /// Values that are of one cut.
    pub(super) clean: usize,
}

/// A line and the evidence that its power stands.
#[derive(Debug, Clone, Copy)]
pub(super) struct Standing {
    /// From the centre.
    pub(super) offset_hz: f64,
    pub(super) nats: f64,
    pub(super) power_n2: f64,
    /// Power of what stands one turn of the spindle beside it, over its own: the cut modulates its lines.
    pub(super) side: f64,
}
