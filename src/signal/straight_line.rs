//! The straight line through evenly spaced values, by least squares.

/// Slope of the line, per step, and what the values stray from it, root mean square. Fewer than two values
/// have no line: NaN.
/// Checked by: tests::a_line_with_an_alternation.
pub(crate) fn straight_line(values: &[f64]) -> [f64; 2] {
    let n = values.len() as f64;
    let (mid, mean) = (0.5 * (n - 1.0), values.iter().sum::<f64>() / n);
    let square = n * (n * n - 1.0) / 12.0;
    let slope = values.iter().enumerate().map(|(k, f)| (k as f64 - mid) * (f - mean)).sum::<f64>() / square;
    let left = values.iter().enumerate().map(|(k, f)| (f - mean - slope * (k as f64 - mid)).powi(2));
    [slope, (left.sum::<f64>() / n).sqrt()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_with_an_alternation() {
        // + - - + leaves slope and mean alone.
        let of = |k: i32| 3.0 - 0.5 * f64::from(k) + [0.2, -0.2, -0.2, 0.2][k as usize % 4];
        let [slope, scatter] = straight_line(&(0..4).map(of).collect::<Vec<_>>());
        assert!((slope + 0.5).abs() < 1e-12 && (scatter - 0.2).abs() < 1e-12, "{slope} {scatter}");
    }
}
