//! Medians, scales, the step and the digits of a column.

/// Of a normal law: standard deviation over the median of the absolute deviation.
pub(super) const NORMAL: f64 = 1.4826;

/// Value below which a share of `x` lies; 0 of nothing.
pub(super) fn percentile(x: &[f64], share: f64) -> f64 {
    if x.is_empty() {
        return 0.0;
    }
    let mut sorted = x.to_vec();
    let place = ((sorted.len() - 1) as f64 * share).round() as usize;
    *sorted.select_nth_unstable_by(place, f64::total_cmp).1
}

/// Median; 0 of nothing.
pub(super) fn median(x: &[f64]) -> f64 {
    percentile(x, 0.5)
}

/// Robust standard deviation: [`NORMAL`] med|x - med x|.
pub(super) fn scale(x: &[f64]) -> f64 {
    let middle = median(x);
    NORMAL * median(&x.iter().map(|v| (v - middle).abs()).collect::<Vec<_>>())
}

/// 99th percentile of the deviation from the median: how far a column goes.
pub(super) fn range(x: &[f64]) -> f64 {
    let middle = median(x);
    percentile(&x.iter().map(|v| (v - middle).abs()).collect::<Vec<_>>(), 0.99)
}

/// Mean; 0 of nothing.
pub(super) fn mean(x: &[f64]) -> f64 {
    x.iter().sum::<f64>() / x.len().max(1) as f64
}

/// Standard deviation.
pub(super) fn deviation(x: &[f64]) -> f64 {
    let middle = mean(x);
    (x.iter().map(|v| (v - middle).powi(2)).sum::<f64>() / x.len().max(1) as f64).sqrt()
}

/// Changes from row to row.
pub(super) fn changes(x: &[f64]) -> Vec<f64> {
    x.windows(2).map(|w| w[1] - w[0]).collect()
}

/// Step of a column, or the least change that it shows where there is none.
pub(super) fn resolution(x: &[f64], step: f64) -> f64 {
    if step > 0.0 {
        return step;
    }
    let least = least_change(x);
    let changes = x.windows(2).map(|w| (w[1] - w[0]).abs()).filter(|d| *d > least);
    changes.reduce(f64::min).unwrap_or(0.0)
}

/// Largest step of a column that is rounded to five digits or fewer; 0 where it is not.
pub(super) fn digit_step(x: &[f64], step: f64) -> f64 {
    let largest = x.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    let of = |digits: i32| 10f64.powi(largest.log10().floor() as i32 - digits + 1);
    digits(x, step, 5).map_or(0.0, of)
}

/// Changes of fewer parts of the largest value are the rounding of the numbers themselves.
fn least_change(x: &[f64]) -> f64 {
    1e-12 * x.iter().fold(0.0_f64, |m, v| m.max(v.abs()))
}

/// Step of a column: what its changes are whole multiples of; 0 where there is none.
///
/// The largest q among some percentiles of the changes and their halves of which 97 % of the changes below
/// 30 q are multiples within 0.12, refined by least squares. Of a continuous column a quarter is, by chance.
pub(super) fn step(x: &[f64]) -> f64 {
    /// Of a step the scatter of its multiples, or else the changes of a steady speed have one.
    const SCATTER: f64 = 0.01;
    let least = least_change(x);
    let mut found = steps_of(x.windows(2).map(|w| (w[1] - w[0]).abs()).filter(|d| *d > least).collect());
    if found.iter().all(|[q, off]| *off > SCATTER * q) {
        // A column that never changes slowly shows its step between values that are not neighbours in time.
        let mut sorted = x.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        found.extend(steps_of(sorted.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > least).collect()));
    }
    found.iter().find(|[q, off]| *off <= SCATTER * q).map_or(0.0, |f| f[0])
}

/// Steps of which these differences are multiples, with the scatter of those, the largest first.
fn steps_of(mut differences: Vec<f64>) -> Vec<[f64; 2]> {
    /// Of a column that hardly ever changes by little: places among the sorted changes.
    const SMALLEST: [usize; 3] = [0, 5, 20];
    const PERCENTILES: [f64; 4] = [0.02, 0.06, 0.12, 0.25];
    const WITHIN: f64 = 0.12;
    const SHARE: f64 = 0.97;
    const REACH: f64 = 30.0;
    const LEAST: usize = 20;
    let of = PERCENTILES.iter().map(|p| percentile(&differences, *p)).collect::<Vec<_>>();
    if differences.len() > LEAST {
        differences.select_nth_unstable_by(LEAST, f64::total_cmp);
        differences[..=LEAST].sort_unstable_by(f64::total_cmp);
    }
    let smallest = SMALLEST.iter().filter_map(|k| differences.get(*k).copied());
    let mut candidates: Vec<f64> = of.into_iter().chain(smallest).flat_map(|q| [q, 0.5 * q]).collect();
    candidates.sort_unstable_by(|a, b| b.total_cmp(a));
    let mut found = Vec::new();
    for q in candidates.into_iter().filter(|q| *q > 0.0) {
        let near: Vec<f64> = differences.iter().copied().filter(|d| *d < REACH * q).collect();
        let whole = |d: &f64| (d / q).round() >= 1.0 && (d / q - (d / q).round()).abs() < WITHIN;
        let multiples: Vec<f64> = near.iter().copied().filter(whole).collect();
        if near.len() < LEAST || (multiples.len() as f64) < SHARE * near.len() as f64 {
            continue;
        }
        let (mut top, mut bottom) = (0.0, 0.0);
        for d in &multiples {
            let n = (d / q).round();
            top += n * d;
            bottom += n * n;
        }
        let q = top / bottom;
        let off: f64 = multiples.iter().map(|d| (d - (d / q).round() * q).powi(2)).sum();
        found.push([q, (off / multiples.len() as f64).sqrt()]);
    }
    found
}

/// Significant digits of a column, if there are few of them and its step is not what limits them.
pub(super) fn digits(x: &[f64], step: f64, most: i32) -> Option<i32> {
    const SHARE: f64 = 0.998;
    const BEYOND_STEP: f64 = 1.5;
    let largest = x.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    (1..=most).find(|digits| {
        let written = |v: &&f64| {
            if **v == 0.0 {
                return true;
            }
            let scaled = v.abs() / 10f64.powi(v.abs().log10().floor() as i32 - digits + 1);
            (scaled - scaled.round()).abs() < 1e-6 * scaled
        };
        // Almost every column shows on its first rows that it has more.
        const FIRST: usize = 500;
        let enough = |x: &[f64]| x.iter().filter(written).count() as f64 >= 0.9 * x.len() as f64;
        if !enough(&x[..x.len().min(FIRST)]) {
            return false;
        }
        let count = x.iter().filter(written).count();
        count as f64 >= SHARE * x.len() as f64 && largest > BEYOND_STEP * 10f64.powi(*digits) * step
    })
}

/// Runs of equal values: first row and length, of at least `least` rows.
pub(super) fn runs(x: &[f64], least: usize) -> Vec<Run> {
    let mut out = Vec::new();
    let mut first = 0;
    for i in 1..=x.len() {
        if i == x.len() || x[i] != x[first] {
            if i - first >= least {
                out.push(Run { first, rows: i - first });
            }
            first = i;
        }
    }
    out
}

/// Rows with one value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Run {
    pub(super) first: usize,
    pub(super) rows: usize,
}

impl Run {
    /// The row behind it.
    pub(super) fn end(self) -> usize {
        self.first + self.rows
    }
}

/// Mean over `2 half + 1` rows, three times: low-pass without a delay, -3 dB at 0.26 / (2 half + 1) of the
/// rate.
pub(super) fn smooth(x: &[f64], half: usize) -> Vec<f64> {
    let mut y = x.to_vec();
    for _ in 0..3 {
        let origin = y.first().copied().unwrap_or(0.0);
        let mut sums = Vec::with_capacity(y.len() + 1);
        let mut sum = 0.0;
        sums.push(sum);
        for v in &y {
            sum += v - origin;
            sums.push(sum);
        }
        for (i, v) in y.iter_mut().enumerate() {
            // Symmetric at the ends, too, or a ramp would be bent there.
            let reach = half.min(i).min(sums.len() - 2 - i);
            *v = origin + (sums[i + reach + 1] - sums[i - reach]) / (2 * reach + 1) as f64;
        }
    }
    y
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_step_of_a_rounded_column_is_found_and_a_smooth_one_has_none() {
        let smooth: Vec<f64> = (0..5000).map(|k| (f64::from(k) * 1e-3).sin() + 1e-4 * hash(k)).collect();
        let rounded: Vec<f64> = smooth.iter().map(|v| (v / 3e-4).round() * 3e-4).collect();
        assert_eq!(step(&smooth), 0.0);
        assert!((step(&rounded) / 3e-4 - 1.0).abs() < 1e-6, "{}", step(&rounded));
    }

    /// Of a steady speed nearly all changes are alike: they are no step.
    #[test]
    fn the_changes_of_a_steady_speed_are_no_step() {
        let q = 2.4e-5;
        // There and back.
        let way = |k: i32| 6.5e-4 * f64::from(k.min(20_000 - k)) + 6e-5 * hash(k);
        let x: Vec<f64> = (0..20_000).map(|k| (way(k) / q).round() * q).collect();
        assert!((step(&x) / q - 1.0).abs() < 1e-6, "{}", step(&x));
    }

    #[test]
    fn digits_are_counted_where_the_step_is_finer() {
        let x: Vec<f64> = (1..2000).map(|k| f64::from(k) * 1.2345e-3).collect();
        let three: Vec<f64> = x.iter().map(|v| format!("{v:.2e}").parse().unwrap()).collect();
        assert_eq!(digits(&x, 0.0, 4), None);
        assert_eq!(digits(&three, 0.0, 4), Some(3));
    }

    fn hash(k: i32) -> f64 {
        let x = (f64::from(k) * 12.9898).sin() * 43_758.545_3;
        x - x.floor()
    }
}
