//! How a line began: chatter grows out of the noise, what is struck or switched on is there at once.
//!
//! Two hypotheses of one line, by all that is in sight of it: it grows still, or grew until some moment and
//! stands since at a size at which chatter stands; or it was switched on within some milliseconds and stands
//! or fades since. The whitening filter leaves more of a beginning than of what follows, where it knows noise
//! at the place of the line.

use super::Reason;
use super::criteria::{CRITERIA, LONGEST, MEMORY, PAST, RATES_1_S, RISES, WINDOWS};
use super::window::{Context, Detection, Window, loudness_nats, stands_nats};
use nalgebra::Complex;
use std::f64::consts::TAU;

type C = Complex<f64>;

impl Window<'_> {
    /// What the beginning of the line says of it.
    pub(super) fn judge_beginning(&self, found: &mut Detection) {
        let levels = &self.context.levels;
        let Context { rate_hz, stable_n2, .. } = *self.context;
        let quarter_hz = 0.25 * rate_hz / self.e.len() as f64;
        let regenerated = self.context.regenerated_nats(self.line.offset_hz, quarter_hz);
        let grown = self.growth_nats() + loudness_nats(self.line.power_n2, stable_n2) + regenerated;
        if grown > -self.context.beginning_nats()
            && !self.context.is_young()
            && self.seen >= self.e.len() + WINDOWS[0]
        {
            let stayed = self.stayed() / levels.cause_nats;
            found.least(stayed, Reason::Interference);
            found.moved = stayed < -1.0;
        }
        found.grown_nats = Some(grown);
    }

    /// Evidence, nats, that the line grew and may stand since, against one that was switched on and may have
    /// faded since.
    fn growth_nats(&self) -> f64 {
        let Context { whitener, rate_hz, .. } = self.context;
        let switched = |line: &[C], turns: f64| switched_on(line, &whitener.at(turns), *rate_hz);
        let stands_nats = stands_nats(self.line.power_n2, self.context.stable_n2);
        self.more_than(self.history.white(self.seen), stands_nats, switched)
    }

    /// The same against one that moved here.
    fn stayed(&self) -> f64 {
        let values = self.history.white(self.seen.min(self.e.len() + PAST));
        let moved = self.sweep(values);
        self.more_than(values, 0.0, |_, _| moved)
    }

    /// Evidence, nats, that the line grew, by these values, against what explains the energy of `other`;
    /// `stands_nats` where it grows no more.
    fn more_than(&self, values: &[C], stands_nats: f64, other: impl Fn(&[C], f64) -> f64) -> f64 {
        let n = values.len();
        let rate_hz = self.context.rate_hz;
        let mut line = [C::ZERO; LONGEST + PAST];
        let line = &mut line[..n];
        let [mut all, mut not] = [0.0; 2];
        let mut grown = rates_1_s().map(|_| Growth::default());
        for k in -2..=2 {
            let turns = self.turns() + f64::from(k) * 0.25 / self.e.len() as f64;
            for (q, (to, from)) in line.iter_mut().zip(values.iter().rev()).enumerate() {
                let ago = q as f64;
                let bent = 0.5 * self.context.sweep_hz_s * (ago / rate_hz).powi(2);
                *to = *from * C::from_polar(1.0, TAU * (turns * ago - bent));
            }
            all = line.iter().map(C::norm_sqr).sum();
            not = other(line, turns).max(not);
            for (most, growth_1_s) in grown.iter_mut().zip(rates_1_s()) {
                let Growth { lasts, ended } = growing(line, growth_1_s / rate_hz);
                *most = Growth { lasts: lasts.max(most.lasts), ended: ended.max(most.ended) };
            }
        }
        let left = |energy: f64| (all - energy).max(1e-12 * all);
        let of = |energy: f64| (n as f64 - 1.0) * (left(not) / left(energy)).ln();
        let nats = grown.map(|Growth { lasts, ended }| of(lasts).max(of(ended) + stands_nats));
        let [slower @ .., fastest] = nats;
        slower.into_iter().fold(fastest - CRITERIA.fastest_nats, f64::max)
    }
}

/// Most energy of a line at zero that was switched on, at any time, as `filter` leaves it; the newest value
/// is the first. What a filter leaves of a template fits a series as the template fits what the filter run
/// backwards makes of the series.
fn switched_on(line: &[C], filter: &[C; MEMORY + 1], rate_hz: f64) -> f64 {
    let mut matched = [C::ZERO; LONGEST + PAST];
    for (p, to) in matched[..line.len()].iter_mut().enumerate() {
        *to = filter.iter().take(p + 1).enumerate().map(|(m, a)| a.conj() * line[p - m]).sum();
    }
    let steady = RISES.into_iter().map(|rise| (rise, 0.0));
    let fading = RATES_1_S.into_iter().map(|ring_1_s| (1, ring_1_s));
    let of = |(rise, ring_1_s): (usize, f64)| {
        let fade = (-ring_1_s / rate_hz).exp();
        at_any_time(line, &matched[..line.len()], &sizes(filter, rise, fade), (rise, fade))
    };
    steady.chain(fading).map(of).fold(0.0, f64::max)
}

/// The first values of a line that rises in `rise` values and fades, as the filter leaves it. At the end all
/// of the filter sees all of its size: from there on it only fades.
fn sizes(filter: &[C; MEMORY + 1], rise: usize, fade: f64) -> [C; WINDOWS[0]] {
    let size = |k: usize| ((k as f64 + 1.0) / rise as f64).min(1.0) * fade.powf(k as f64);
    let (mut head, sizes): ([C; WINDOWS[0]], [f64; WINDOWS[0]]) =
        ([C::ZERO; WINDOWS[0]], std::array::from_fn(size));
    for (k, to) in head.iter_mut().enumerate() {
        *to = filter.iter().take(k + 1).enumerate().map(|(m, a)| a * sizes[k - m]).sum();
    }
    head
}

/// Most energy of a line that began as `head` does, at any time.
fn at_any_time(line: &[C], matched: &[C], head: &[C], (rise, fade): (usize, f64)) -> f64 {
    // Some of the line and some silence before it, or it is no beginning.
    let seen = WINDOWS[0] / 4..=line.len() - line.len() / 8;
    let mut sums = [C::ZERO; RISES[RISES.len() - 1]];
    let (mut over_noise, mut size, mut energy, mut best) = (C::ZERO, C::ZERO, 0.0, 0.0f64);
    let (mut always, mut all) = (C::ZERO, 0.0);
    // So many values ago it began.
    for (k, (x, y)) in line.iter().zip(matched).enumerate() {
        over_noise = over_noise * fade + y;
        sums[k % rise] = over_noise;
        size = if k < head.len() { head[k] } else { size * fade };
        energy += size.norm_sqr();
        if seen.contains(&(k + 1)) {
            let sum = sums[..rise].iter().sum::<C>() / rise as f64;
            best = best.max(sum.norm_sqr() / energy);
        }
        always = always * fade + x;
        all = all * fade * fade + 1.0;
    }
    // At last, that it was there before all that is in sight.
    best.max(always.norm_sqr() / all)
}

/// Rates at which a line may grow: from a quarter of the slowest that is told from one that fades, which in
/// all that is in sight becomes four times as large, each twice the one before.
fn rates_1_s() -> [f64; RATES_1_S.len() + 2] {
    std::array::from_fn(|k| 0.25 * RATES_1_S[0] * f64::from(1 << k))
}

/// Energies of a line that grows.
#[derive(Debug, Clone, Copy, Default)]
struct Growth {
    /// Until now.
    lasts: f64,
    /// Until the best moment before; it stands since.
    ended: f64,
}

/// The same of one that grew, at so much a value. What grows slowly leaves the filter as what stands does.
fn growing(line: &[C], growth: f64) -> Growth {
    let mut ended: f64 = 0.0;
    let back = (-growth).exp();
    let mut stood: C = line.iter().sum();
    let (mut grown, mut energy) = (C::ZERO, 0.0);
    for (q, x) in line.iter().enumerate().rev() {
        // What is older than this value grew, up to the size at which it stands from here on.
        if q < line.len() - line.len() / 4 {
            ended = ended.max((stood + grown * back).norm_sqr() / ((q + 1) as f64 + energy * back * back));
        }
        stood -= x;
        grown = grown * back + x;
        energy = energy * back * back + 1.0;
    }
    Growth { lasts: grown.norm_sqr() / energy, ended }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Energy of the best growth.
    fn grown(line: &[C]) -> f64 {
        let of = |growth_1_s| growing(line, growth_1_s / 500.0);
        rates_1_s().map(of).into_iter().map(|of| of.lasts.max(of.ended)).fold(0.0, f64::max)
    }

    #[test]
    fn a_line_that_grew_is_told_from_one_that_was_switched_on() {
        let mut plain = [C::ZERO; MEMORY + 1];
        plain[0] = C::ONE;
        // Newest first, 240 values of 2 ms.
        let of = |size: &dyn Fn(f64) -> f64| {
            let line: Vec<C> = (0..240).map(|q| C::new(size(0.002 * f64::from(q)), 0.0)).collect();
            let all: f64 = line.iter().map(C::norm_sqr).sum();
            (switched_on(&line, &plain, 500.0) / all, grown(&line) / all)
        };
        let (at, growth_nats) = of(&|ago_s| (-20.0 * (ago_s - 0.1).max(0.0)).exp());
        assert!(growth_nats > 0.999 && at < 0.95, "{at} {growth_nats}");
        // Between two of the rates.
        let (at, growth_nats) = of(&|ago_s| (-15.0 * (ago_s - 0.1).max(0.0)).exp());
        assert!(growth_nats > 0.995 && at < 0.95, "{at} {growth_nats}");
        // So slowly that it has only just left the noise.
        let (at, growth_nats) = of(&|ago_s| (-4.0 * ago_s).exp());
        assert!(growth_nats > 0.99 && at < 0.95, "{at} {growth_nats}");
        let (at, growth_nats) = of(&|ago_s| if ago_s < 0.1 { 1.0 } else { 0.0 });
        assert!(at > 0.999 && growth_nats < 0.98, "{at} {growth_nats}");
        let (at, growth_nats) = of(&|ago_s| ((0.1 - ago_s) / 0.006).clamp(0.0, 1.0));
        assert!(at > 0.999 && growth_nats < 0.99, "{at} {growth_nats}");
        let (at, growth_nats) = of(&|ago_s| if ago_s < 0.1 { (20.0 * ago_s).exp() } else { 0.0 });
        assert!(at > 0.999 && growth_nats < 0.8, "{at} {growth_nats}");
    }

    #[test]
    fn what_the_filter_leaves_of_a_beginning_is_looked_for() {
        // A filter that knows a line here: it leaves the first value of it, and a hundredth of what follows.
        let mut filter = [C::ZERO; MEMORY + 1];
        (filter[0], filter[1]) = (C::ONE, C::new(-0.99, 0.0));
        let began: Vec<C> = (0..240)
            .map(|ago| if ago < 120 { 0.01 } else { f64::from(u8::from(ago == 120)) })
            .map(|x| C::new(x, 0.0))
            .collect();
        let all: f64 = began.iter().map(C::norm_sqr).sum();
        assert!(switched_on(&began, &filter, 500.0) > 0.999 * all && grown(&began) < 0.1 * all);
    }
}
