//! Removes what repeats with every turn of the spindle from a mixed-down band.
//!
//! Each whole order o of the spindle in the band is a line c_o e^{j o theta}; theta is the integral of the
//! measured speed, so that the lines follow when the speed changes. Over one turn the orders are
//! orthogonal: the residual's part at each order is what c_o lacks. After a restart one turn is enough;
//! later the notches narrow down to about one over the memory.
//!
//! Regenerative chatter of two opposed tools cannot sit on a whole order: its equation needs
//! sin(omega T/2) away from zero for growth, T one turn. Nothing of it is lost in the notches.

use nalgebra::Complex;
use std::f64::consts::TAU;

/// Turns after a restart from which a loud turn counts less.
const SETTLED_TURNS: f64 = 8.0;
/// Most orders that are followed; with more in the band there are no gaps left between the notches.
const MOST_ORDERS: usize = 96;

/// The band and how long the lines are averaged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrderLines {
    /// Lowest frequency of the band.
    pub low_hz: f64,
    /// Highest frequency of the band.
    pub high_hz: f64,
}

/// State of [`OrderLines`].
#[derive(Debug, Clone, PartialEq)]
pub struct OrderLinesState {
    lines: Vec<Complex<f64>>,
    sums: Vec<Complex<f64>>,
    /// Order of `lines[0]`.
    first: usize,
    count: usize,
    /// Samples in `sums`.
    samples: f64,
    angle_at_turn: f64,
    turns_since_restart: f64,
    /// Residual power of this turn, summed, and of the usual turn.
    power: f64,
    usual_power: f64,
}

crate::keyframe::keep!(OrderLinesState {
    lines, sums, first, count, samples, angle_at_turn, turns_since_restart, power, usual_power
} if |s| s.count <= s.lines.len() && s.first < 1 << 32);

/// One sample of the band with where the spindle and the mixer stand.
#[derive(Debug, Clone, Copy)]
pub struct OrderSample {
    /// The band, mixed down.
    pub value: Complex<f64>,
    /// Spindle angle in turns since the start.
    pub angle_turns: f64,
    /// e^{-j w0 t} of the mixer.
    pub mixer: Complex<f64>,
    /// Turns per second.
    pub speed_hz: f64,
    /// Turns over which a line is averaged once it is known.
    pub memory_turns: f64,
    /// Whether the lines may change (not while chatter is loud).
    pub adapt: bool,
}

impl OrderLines {
    /// Nothing known.
    #[must_use]
    pub fn start(&self) -> OrderLinesState {
        let zero = Complex::new(0.0, 0.0);
        OrderLinesState {
            lines: vec![zero; MOST_ORDERS],
            sums: vec![zero; MOST_ORDERS],
            first: 0,
            count: 0,
            samples: 0.0,
            angle_at_turn: 0.0,
            turns_since_restart: 0.0,
            power: 0.0,
            usual_power: 0.0,
        }
    }

    /// Forgets how sure the lines are (not the lines): the next turn sets them anew.
    pub fn restart(&self, state: &mut OrderLinesState, angle_turns: f64) {
        state.sums.fill(Complex::new(0.0, 0.0));
        (state.samples, state.power) = (0.0, 0.0);
        state.angle_at_turn = angle_turns;
        state.turns_since_restart = 0.0;
    }

    /// Turns averaged since the last restart.
    #[must_use]
    pub fn turns_known(&self, state: &OrderLinesState) -> f64 {
        state.turns_since_restart
    }

    /// The sample without the lines. Cost: no allocation. Checked by: `orders_vanish_and_other_lines_stay`.
    pub fn step(&self, state: &mut OrderLinesState, sample: &OrderSample) -> Complex<f64> {
        self.follow_band(state, sample);
        // e^{j o theta} for the first order, then one turn of theta more for each next.
        let start = (state.first as f64 * sample.angle_turns.fract()).fract();
        let step = Complex::from_polar(1.0, TAU * sample.angle_turns.fract());
        let mut wave = Complex::from_polar(1.0, TAU * start) * sample.mixer;
        let first_wave = wave;
        let mut left = sample.value;
        for line in &state.lines[..state.count] {
            left -= line * wave;
            wave *= step;
        }
        wave = first_wave;
        for sum in &mut state.sums[..state.count] {
            *sum += left * wave.conj();
            wave *= step;
        }
        state.samples += 1.0;
        state.power += left.norm_sqr();
        if sample.angle_turns - state.angle_at_turn >= 1.0 {
            self.finish_turn(state, sample);
        }
        left
    }

    fn finish_turn(&self, state: &mut OrderLinesState, sample: &OrderSample) {
        // The first turn sets, the n-th after it changes by 1/n, down to the memory.
        let n = state.turns_since_restart + 1.0;
        let share = if sample.adapt { 1.0 / n.min(sample.memory_turns) } else { 0.5 / sample.memory_turns };
        // A turn much louder than usual was hit or burst upon: it says little about the orders.
        let power = state.power / state.samples.max(1.0);
        let loud = n > SETTLED_TURNS && power > 2.0 * state.usual_power;
        let share = if loud { share * 2.0 * state.usual_power / power } else { share };
        let usual_share = (1.0 / n).max(0.1);
        let counted = if n > SETTLED_TURNS { power.min(2.0 * state.usual_power) } else { power };
        state.usual_power += usual_share * (counted - state.usual_power);
        state.power = 0.0;
        for (line, sum) in state.lines.iter_mut().zip(&mut state.sums).take(state.count) {
            *line += *sum * (share / state.samples);
            *sum = Complex::new(0.0, 0.0);
        }
        state.turns_since_restart = n;
        state.samples = 0.0;
        state.angle_at_turn = sample.angle_turns;
    }

    /// Moves the followed orders with the speed.
    fn follow_band(&self, state: &mut OrderLinesState, sample: &OrderSample) {
        if sample.speed_hz <= 0.0 {
            state.count = 0;
            return;
        }
        let low = (self.low_hz / sample.speed_hz).ceil();
        let high = (self.high_hz / sample.speed_hz).floor();
        if !(low >= 1.0 && high >= low && high - low < MOST_ORDERS as f64) {
            state.count = 0;
            return;
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let (first, count) = (low as usize, (high - low) as usize + 1);
        if first == state.first && count == state.count {
            return;
        }
        let zero = Complex::new(0.0, 0.0);
        let old_count = state.count;
        if first > state.first {
            let gone = (first - state.first).min(old_count);
            state.lines.copy_within(gone..old_count, 0);
            state.sums.copy_within(gone..old_count, 0);
            state.lines[old_count - gone..].fill(zero);
            state.sums[old_count - gone..].fill(zero);
        } else if first < state.first {
            let new = (state.first - first).min(MOST_ORDERS);
            state.lines.copy_within(0..MOST_ORDERS - new, new);
            state.sums.copy_within(0..MOST_ORDERS - new, new);
            state.lines[..new].fill(zero);
            state.sums[..new].fill(zero);
        }
        state.lines[count..].fill(zero);
        state.sums[count..].fill(zero);
        (state.first, state.count) = (first, count);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Residual rms after two seconds of a line at `order`, speed rising by 2 % a second.
    fn residual(order: f64) -> f64 {
        let lines = OrderLines { low_hz: 500.0, high_hz: 800.0 };
        let mut state = lines.start();
        let (mut angle, mut sum) = (0.0, 0.0);
        for n in 0..3000 {
            let t = f64::from(n) / 1000.0;
            let speed_hz = 20.0 * (1.0 + 0.02 * t);
            angle += speed_hz / 1000.0;
            let mixer = Complex::from_polar(1.0, -TAU * 650.0 * t);
            let value = Complex::from_polar(3.0, TAU * order * angle + 0.5) * mixer;
            let sample =
                OrderSample { value, angle_turns: angle, mixer, speed_hz, memory_turns: 20.0, adapt: true };
            let left = lines.step(&mut state, &sample);
            if n >= 2000 {
                sum += left.norm_sqr() / 1000.0;
            }
        }
        f64::sqrt(sum)
    }

    #[test]
    fn orders_vanish_and_other_lines_stay() {
        assert!(residual(31.0) < 0.02, "{}", residual(31.0));
        assert!((residual(31.5) - 3.0).abs() < 0.3, "{}", residual(31.5));
    }
}
