//! Running median of a series.

/// Median over `half` rows to both sides (fewer at the ends).
pub(crate) fn sliding_median(x: &[f64], half: usize) -> Vec<f64> {
    let place = |window: &[f64], v: f64| window.partition_point(|w| *w < v);
    let mut window: Vec<f64> = Vec::with_capacity(2 * half + 2);
    let mut out = Vec::with_capacity(x.len());
    for v in x.iter().take(half) {
        window.insert(place(&window, *v), *v);
    }
    for i in 0..x.len() {
        if let Some(v) = x.get(i + half) {
            window.insert(place(&window, *v), *v);
        }
        if i > half {
            window.remove(place(&window, x[i - half - 1]));
        }
        out.push(window[window.len() / 2]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sliding_median_is_the_median_of_each_window() {
        let x: Vec<f64> = (0..200).map(|k| (f64::from(k) * f64::from(k) * 0.37).sin()).collect();
        let of = sliding_median(&x, 7);
        for i in 10..190 {
            let mut window = x[i - 7..=i + 7].to_vec();
            window.sort_by(f64::total_cmp);
            assert_eq!(of[i], window[7]);
        }
    }
}
