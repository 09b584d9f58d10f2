//! The speed of a spindle from what repeats with its turns, where nobody measured it: order tracking without
//! a tachometer.
//!
//! Frames of 40 turns. A bin of a frame's spectrum is noise (exponential in power) or holds a line of unknown
//! power; at the orders of a speed lines are expected, elsewhere they are as frequent as this frame shows. So
//! one line tells next to nothing, however loud, and a comb of lines tells the speed. Of all courses of the
//! speed the most probable one is found (Viterbi); it is believed where it beats the speed that was stated.

use super::sliding_median::sliding_median;
use crate::units::{SampleRate, SpindleSpeed};
use rustfft::{FftPlanner, num_complex::Complex64};
use std::f64::consts::{LN_2, TAU};

/// Turns in a frame: an order is told from its neighbour, a change of 1 % from none.
const TURNS: f64 = 40.0;
/// Frames that begin in the length of one, and points of the spectrum in a bin of it.
const FINE: usize = 4;
/// Steps of the logarithm of the speed: a bin at order 10 is 2.5 of them.
const STEP: f64 = 1e-3;
/// Farthest from the stated speed, steps: the override of a machine tool, 80 to 125 %.
const REACH: usize = 223;
/// What an asynchronous drive slips under load, steps: this near it the stated speed stands. And what the
/// speed usually changes by from frame to frame.
const SLIP: usize = 5;
/// Power of a line over that of the noise in its bin: half of the lines are louder, some by any factor.
const LINE: f64 = 100.0;
/// Odds against a spindle that does not turn as stated, nats: one in a million.
const DOUBT_NATS: f64 = 14.0;

/// A frame's log-likelihood of each speed over that of no spindle, and the sum of the logarithms of the
/// powers at its orders.
struct Frame {
    nats: Vec<f64>,
    power: Vec<f64>,
}

/// Speed at each sample of vibration `columns` (same length, any unit), Hz, where their orders contradict the
/// `stated` speed; none where they do not, or where fewer than two frames fit.
#[must_use]
pub fn speed_from_orders(columns: &[&[f64]], rate: SampleRate, stated: SpindleSpeed) -> Option<Vec<f64>> {
    let rows = columns.iter().map(|c| c.len()).min()?;
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let length = (TURNS * rate.hz() / stated.hz()).round() as usize;
    let hop = length / FINE;
    if hop == 0 || rows < 2 * length {
        return None;
    }
    let frames: Vec<Frame> = (0..=rows - length)
        .step_by(hop)
        .map(|from| {
            let parts: Vec<&[f64]> = columns.iter().map(|c| &c[from..from + length]).collect();
            frame(&parts, rate, stated.hz())
        })
        .collect();
    let (wide_nats, course) = most_probable(&frames, REACH);
    let (stated_nats, _) = most_probable(&frames, SLIP);
    // Against the stated speed, and against no spindle at all. Frames overlap: each sample counts once.
    if wide_nats - stated_nats.max(0.0) < DOUBT_NATS * FINE as f64 {
        return None;
    }
    let ratio: Vec<f64> = frames.iter().zip(&course).map(|(frame, step)| refined(frame, *step)).collect();
    let at = |row: usize| {
        let place = ((row as f64 - 0.5 * length as f64) / hop as f64).clamp(0.0, (ratio.len() - 1) as f64);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let below = (place as usize).min(ratio.len() - 2);
        let share = place - below as f64;
        stated.hz() * (ratio[below] * (1.0 - share) + ratio[below + 1] * share)
    };
    Some((0..rows).map(at).collect())
}

fn speed_ratio(step: usize) -> f64 {
    ((step as f64 - REACH as f64) * STEP).exp()
}

/// The loudest comb beside what the course says; the stated speed where it stands.
fn refined(frame: &Frame, step: usize) -> f64 {
    if step.abs_diff(REACH) <= SLIP {
        return 1.0;
    }
    let near = step.saturating_sub(SLIP)..=(step + SLIP).min(2 * REACH);
    speed_ratio(near.max_by(|a, b| frame.power[*a].total_cmp(&frame.power[*b])).unwrap_or(step))
}

/// Columns hear the same orders: they count as one, their mean.
fn frame(columns: &[&[f64]], rate: SampleRate, stated_hz: f64) -> Frame {
    let mut frame = Frame { nats: vec![0.0; 2 * REACH + 1], power: vec![0.0; 2 * REACH + 1] };
    let length = columns[0].len();
    // Above this an order is lost in its neighbours, or in the filter before the sampling.
    let highest_hz = (TURNS * stated_hz).min(0.45 * rate.hz());
    let point_hz = rate.hz() / (FINE * length) as f64;
    for column in columns {
        let over_noise = over_noise(column);
        // Below the first order there is none, and much else.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let [first, last] =
            [stated_hz, highest_hz].map(|hz| ((hz / point_hz) as usize).min(over_noise.len() - 2));
        let lines = share_of_lines(over_noise[first.min(last)..=last].iter().step_by(FINE));
        for step in 0..=2 * REACH {
            let order_hz = stated_hz * speed_ratio(step);
            let mut hz = order_hz;
            while hz < highest_hz {
                let place = hz / point_hz;
                #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
                let below = (place as usize).min(last);
                let share = place - below as f64;
                let power = over_noise[below] * (1.0 - share) + over_noise[below + 1] * share;
                let told = (density(power, 0.5) / density(power, lines)).ln();
                frame.nats[step] += told / columns.len() as f64;
                frame.power[step] += power.ln_1p();
                hz += order_hz;
            }
        }
    }
    frame
}

/// Density of the power of a bin over that of noise, where it holds a line with probability `line`.
fn density(power: f64, line: f64) -> f64 {
    (1.0 - line) * (-power).exp() + line * line_density(power)
}

fn line_density(power: f64) -> f64 {
    LINE / (LINE + power).powi(2)
}

/// Most probable share of the bins that hold a line: where the falling slope of the log-likelihood is 0.
fn share_of_lines<'a>(bins: impl Iterator<Item = &'a f64> + Clone) -> f64 {
    let (mut low, mut high) = (1.0 / bins.clone().count().max(2) as f64, 0.5);
    let slope = |share: f64| -> f64 {
        bins.clone().map(|p| (line_density(*p) - (-p).exp()) / density(*p, share)).sum()
    };
    for _ in 0..f64::MANTISSA_DIGITS {
        let middle = 0.5 * (low + high);
        if slope(middle) > 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

/// Power of a frame (squared Hann window: no loud line leaks far), `FINE` points a bin, over that of the
/// noise around: the median of a turn's frequency to each side.
fn over_noise(column: &[f64]) -> Vec<f64> {
    let length = column.len();
    let mean = column.iter().sum::<f64>() / length as f64;
    let mut values = vec![Complex64::new(0.0, 0.0); FINE * length];
    for (at, (to, x)) in values.iter_mut().zip(column).enumerate() {
        let hann = 1.0 - (TAU * at as f64 / length as f64).cos();
        *to = Complex64::new((x - mean) * hann * hann, 0.0);
    }
    FftPlanner::new().plan_fft_forward(values.len()).process(&mut values);
    let power: Vec<f64> = values[..values.len() / 2].iter().map(Complex64::norm_sqr).collect();
    let bins: Vec<f64> = power.iter().step_by(FINE).copied().collect();
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let half = TURNS as usize;
    let noise: Vec<f64> =
        sliding_median(&bins, half).iter().map(|m| (m / LN_2).max(f64::MIN_POSITIVE)).collect();
    power.iter().enumerate().map(|(at, p)| p / noise[at / FINE]).collect()
}

/// The most probable course of the speed within `reach` steps of the stated one, and its log-probability: it
/// begins there, and changes as often up as down.
fn most_probable(frames: &[Frame], reach: usize) -> (f64, Vec<usize>) {
    let first = REACH - reach;
    let count = 2 * reach + 1;
    let change = |steps: usize| -(steps as f64) / SLIP as f64 - (2.0 * SLIP as f64).ln();
    let mut best: Vec<f64> =
        (0..count).map(|i| frames[0].nats[first + i] - i.abs_diff(reach) as f64 / SLIP as f64).collect();
    let mut from: Vec<Vec<usize>> = Vec::new();
    for frame in &frames[1..] {
        let reached = |to: usize, at: usize| best[at] + change(to.abs_diff(at));
        let back: Vec<usize> = (0..count)
            .map(|to| (0..count).max_by(|a, b| reached(to, *a).total_cmp(&reached(to, *b))).unwrap_or(to))
            .collect();
        best = back.iter().enumerate().map(|(to, at)| reached(to, *at) + frame.nats[first + to]).collect();
        from.push(back);
    }
    let mut at = (0..count).max_by(|a, b| best[*a].total_cmp(&best[*b])).unwrap_or(reach);
    let nats = best[at];
    let mut course = vec![first + at];
    for back in from.iter().rev() {
        at = back[at];
        course.push(first + at);
    }
    course.reverse();
    (nats, course)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// White, uniform within half a unit.
    fn noise() -> impl Iterator<Item = f64> {
        let mut seed = 7_u64;
        std::iter::repeat_with(move || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 33) as f64 / f64::from(1_u32 << 31) - 0.5
        })
    }

    /// Orders 3, 4, 5 and 7 of a spindle that turns at `speed_hz(t)`, a line at `line_hz(t)`, and noise.
    fn vibration(speed_hz: impl Fn(f64) -> f64, line_hz: impl Fn(f64) -> f64) -> Vec<f64> {
        let (mut turns, mut cycles) = (0.0, 0.0);
        let value = |(row, noise): (u32, f64)| {
            let t_s = f64::from(row) / 1650.0;
            turns += speed_hz(t_s) / 1650.0;
            cycles += line_hz(t_s) / 1650.0;
            let order = |k: f64, size: f64| size * (TAU * k * turns).sin();
            let orders = order(3.0, 0.3) + order(4.0, 5.0) + order(5.0, 0.4) + order(7.0, 0.2);
            orders + noise + 3.0 * (TAU * cycles).sin()
        };
        (0..16_500).zip(noise()).map(value).collect()
    }

    fn tracked(column: &[f64], stated_rpm: f64) -> Option<Vec<f64>> {
        let rate = SampleRate::new(1650.0).unwrap();
        speed_from_orders(&[column], rate, SpindleSpeed::from_rpm(stated_rpm).unwrap())
    }

    #[test]
    fn steps_of_the_override_are_followed_whatever_else_is_loud() {
        let speed_hz = |t: f64| 100.0 + (t - 2.0).clamp(0.0, 6.0).floor();
        let column = vibration(speed_hz, |t| if t < 5.0 { 533.0 } else { 346.0 });
        let found = tracked(&column, 6000.0).unwrap();
        for row in (0..16_500).step_by(825) {
            let t_s = row as f64 / 1650.0;
            // Half a frame beside a step it is between both.
            if [-0.25, 0.25].iter().all(|d| (speed_hz(t_s + d) - speed_hz(t_s)).abs() < 0.1) {
                assert!((found[row] - speed_hz(t_s)).abs() < 0.3, "{t_s} s: {}", found[row]);
            }
        }
    }

    #[test]
    fn a_speed_that_is_stated_wrong_is_told() {
        let found = tracked(&vibration(|_| 96.0, |_| 533.0), 6000.0).unwrap();
        assert!(found.iter().skip(1650).all(|hz| (hz - 96.0).abs() < 0.2));
    }

    #[test]
    fn the_stated_speed_stands_while_nothing_contradicts_it() {
        // Chatter that hops is no speed; a slip of 0.3 % is none either; nor does noise tell one.
        assert!(tracked(&vibration(|_| 100.0, |t| 533.0 + 40.0 * (t / 3.0).floor()), 6000.0).is_none());
        assert!(tracked(&vibration(|_| 99.7, |_| 610.0), 6000.0).is_none());
        let noise: Vec<f64> = noise().take(16_500).collect();
        assert!(tracked(&noise, 6000.0).is_none());
        assert!(tracked(&noise[..600], 6000.0).is_none());
    }
}
