//! Variance of the last N samples: the power of everything in the signal but its mean (thesis 6.3).

/// Window of a moving variance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MovingVariance {
    window_samples: usize,
}

/// State of [`MovingVariance`].
#[derive(Debug, Clone, PartialEq)]
pub struct MovingVarianceState {
    history: Vec<f64>,
    at: usize,
    filled: usize,
    /// Subtracted from each sample before it is squared, so that a large mean costs no digits.
    offset: f64,
    sum: f64,
    sum_of_squares: f64,
    fresh_sum: f64,
    fresh_sum_of_squares: f64,
}

impl MovingVariance {
    /// A window of at least two samples (fewer are taken as two).
    #[must_use]
    pub fn new(window_samples: usize) -> Self {
        Self { window_samples: window_samples.max(2) }
    }

    /// Nothing heard yet.
    #[must_use]
    pub fn start(&self) -> MovingVarianceState {
        MovingVarianceState {
            history: vec![0.0; self.window_samples],
            at: 0,
            filled: 0,
            offset: 0.0,
            sum: 0.0,
            sum_of_squares: 0.0,
            fresh_sum: 0.0,
            fresh_sum_of_squares: 0.0,
        }
    }

    /// Takes a sample and gives the variance of the last N (of those there are, at the start).
    ///
    /// s^2 = (sum y^2 - (sum y)^2/N)/N
    ///
    /// Every N samples the running sums are replaced by sums begun at zero N samples ago: rounding does
    /// not add up. Source: Yamada, thesis 6.3. Checked by: `equals_the_variance_of_the_window`.
    pub fn step(&self, state: &mut MovingVarianceState, x: f64) -> f64 {
        if state.filled == 0 {
            state.offset = x;
        }
        let y = x - state.offset;
        let old = std::mem::replace(&mut state.history[state.at], y);
        state.sum += y - old;
        state.sum_of_squares += y * y - old * old;
        state.fresh_sum += y;
        state.fresh_sum_of_squares += y * y;
        state.filled = (state.filled + 1).min(self.window_samples);
        state.at += 1;
        if state.at == self.window_samples {
            state.at = 0;
            (state.sum, state.sum_of_squares) = (state.fresh_sum, state.fresh_sum_of_squares);
            (state.fresh_sum, state.fresh_sum_of_squares) = (0.0, 0.0);
        }
        let n = state.filled as f64;
        ((state.sum_of_squares - state.sum * state.sum / n) / n).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equals_the_variance_of_the_window() {
        let moving = MovingVariance::new(50);
        let mut state = moving.start();
        let signal: Vec<f64> =
            (0..400).map(|n| 1e6 + (f64::from(n) * 0.7).sin() * 3.0 + f64::from(n) * 0.01).collect();
        for (n, x) in signal.iter().enumerate() {
            let got = moving.step(&mut state, *x);
            let window = &signal[(n + 1).saturating_sub(50)..=n];
            let mean = window.iter().sum::<f64>() / window.len() as f64;
            let want = window.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / window.len() as f64;
            assert!((got - want).abs() < 1e-7, "{got} {want}");
        }
    }
}
