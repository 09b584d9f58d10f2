//! What a spectrum shows: the notches of a moving average, lines of the mains.

use super::columns::{AxisColumns, Role};
use super::fault::{Action, FaultKind};
use super::statistics::{changes, deviation, mean, median};
use super::work::{Told, Work};
use rustfft::{FftPlanner, num_complex::Complex64};
use std::f64::consts::{PI, TAU};

/// Rows of a window of the spectrum.
const WINDOW: usize = 2048;

/// Tells a moving average over 5 to 32 rows: every multiple of fs / n is a notch.
pub(super) fn smoothed(work: &mut Work<'_>, axis: &AxisColumns) {
    let columns: Vec<(usize, Role)> = axis
        .measured()
        // Not of columns with a lower rate: repeating a value k times is an average over k rows, too.
        .filter(|c| !work.silent[c.index] && !work.has(c.index, FaultKind::LowerRate))
        .map(|c| (c.index, c.role))
        .collect();
    for (column, role) in columns {
        let Some(spectrum) = spectrum(work.values(column)) else { continue };
        let c = work.criteria;
        let Some(n) = (5..=32).rev().find(|n| has_notches(&spectrum, *n, c.notch_db)) else { continue };
        match role {
            Role::Drive => work.averaged[0] = n,
            Role::Position => work.averaged[1] = n,
            _ => {}
        }
        let name = work.name(column);
        let statement = format!(
            "{name} is a moving average over {n} rows: unless it is centred it is {:.2} ms late.",
            0.5e3 * (n - 1) as f64 * work.period_s()
        );
        work.tell(Told {
            column: &name,
            kind: FaultKind::Smoothed,
            action: Action::Tell,
            rows: &[],
            statement,
        });
    }
}

/// Mean power of the changes in windows of [`WINDOW`] rows, over that of a difference; `None`: too short.
fn spectrum(x: &[f64]) -> Option<Vec<f64>> {
    if x.len() < WINDOW {
        return None;
    }
    let d = changes(x);
    let fft = FftPlanner::new().plan_fft_forward(WINDOW);
    let hann: Vec<f64> = (0..WINDOW).map(|i| (PI * (i as f64 + 0.5) / WINDOW as f64).sin().powi(2)).collect();
    let mut power = vec![0.0; WINDOW / 2];
    let step = (WINDOW / 2).max((d.len() - WINDOW + 1) / 64);
    for start in (0..=d.len().saturating_sub(WINDOW)).step_by(step).filter(|s| s + WINDOW <= d.len()) {
        let part = &d[start..start + WINDOW];
        let mut z: Vec<Complex64> = part.iter().zip(&hann).map(|(v, w)| Complex64::new(v * w, 0.0)).collect();
        fft.process(&mut z);
        power.iter_mut().zip(&z).for_each(|(p, z)| *p += z.norm_sqr());
    }
    for (k, p) in power.iter_mut().enumerate() {
        *p /= (PI * k.max(1) as f64 / WINDOW as f64).sin().powi(2);
    }
    Some(power)
}

/// Each multiple of fs / n below what lies on either side of it, from a quarter to half of the way to the
/// next one. Of that the median: lines (chatter with its harmonics) stand out of a spectrum that has no
/// notch, too.
fn has_notches(power: &[f64], n: usize, [each_db, mean_db]: [f64; 2]) -> bool {
    let spacing = WINDOW as f64 / n as f64;
    let db = |power: f64| 10.0 * power.max(f64::MIN_POSITIVE).log10();
    let bin = |at: f64| (at.round() as usize).min(power.len() - 1);
    let beside = |from: f64, to: f64| db(median(&power[bin(from.min(to))..=bin(from.max(to))]));
    let depth_db = |m: usize| {
        let centre = m as f64 * spacing;
        let side = |way: f64| beside(centre + 0.25 * way * spacing, centre + 0.5 * way * spacing);
        // In decibels: a spectrum that only falls has no notch.
        0.5 * (side(-1.0) + side(1.0)) - db(mean(&power[bin(centre) - 1..=bin(centre + 1.0)]))
    };
    let depths: Vec<f64> = (1..=(n - 1) / 2).map(depth_db).collect();
    depths.len() >= 2 && depths.iter().all(|d| *d >= each_db) && mean(&depths) >= mean_db
}

/// Tells a line of the mains, or of a multiple, in a drive column, if no other line about it is as large: of
/// the lines of an excitation one may lie there.
pub(super) fn mains_line(work: &mut Work<'_>, axis: &AxisColumns) {
    let drives: Vec<usize> = axis.with(Role::Drive).filter(|i| !work.silent[*i]).collect();
    let spindle_hz = spindle_hz(work);
    let c = *work.criteria;
    for column in drives {
        let x = work.values(column);
        let Some(lines) = Lines::of(x, work.recording.sample_rate.hz()) else { continue };
        let spread = deviation(x);
        let of_mains = [50.0, 60.0].into_iter().flat_map(|f| [1.0, 2.0, 3.0, 6.0].map(|k| f * k));
        let is_line = |k: usize| lines.rms(k) > c.line_over_neighbours * lines.beside(k);
        let alone = |k: usize| {
            let others = k / 2..2 * k;
            let larger = |other: &usize| !lines.is_of_mains(*other) && lines.rms(*other) > lines.rms(k);
            others.filter(larger).all(|other| !is_line(other))
        };
        let found = of_mains
            .filter(|f| !of_spindle(spindle_hz, *f))
            .filter_map(|f| Some((f, lines.largest_near(f)?)))
            .filter(|(_, k)| lines.rms(*k) > c.line_share * spread && is_line(*k) && alone(*k));
        let Some((frequency_hz, k)) = found.max_by(|a, b| lines.rms(a.1).total_cmp(&lines.rms(b.1))) else {
            continue;
        };
        let name = work.name(column);
        let statement = format!(
            "{name} carries a line at {frequency_hz} Hz, {:.1} % of its spread: the mains, or something \
             that turns.",
            100.0 * lines.rms(k) / spread
        );
        work.tell(Told {
            column: &name,
            kind: FaultKind::MainsLine,
            action: Action::Tell,
            rows: &[],
            statement,
        });
    }
}

/// Mean turns of the spindle a second, where it is recorded and turns.
fn spindle_hz(work: &Work<'_>) -> Option<f64> {
    let turns = mean(work.recording.get("spindle_speed_rpm")?) / 60.0;
    (turns > 0.1).then_some(turns)
}

/// True where the spindle or its teeth make that line.
fn of_spindle(spindle_hz: Option<f64>, frequency_hz: f64) -> bool {
    const NEAR_HZ: f64 = 0.5;
    spindle_hz.is_some_and(|s| (frequency_hz / s - (frequency_hz / s).round()).abs() * s < NEAR_HZ)
}

/// Spectrum of a whole column with a Hann window.
struct Lines {
    /// Sums of the power of the bins below each: a sine of root mean square 1 has 1 in its bin.
    sums: Vec<f64>,
    bin_hz: f64,
}

impl Lines {
    /// What a line is held against, to both sides, Hz.
    const NEAR_HZ: f64 = 4.0;
    /// Bins to both sides that a line itself fills.
    const OWN: usize = 3;

    /// `None`: too short.
    fn of(x: &[f64], rate_hz: f64) -> Option<Self> {
        let (n, middle) = (x.len(), mean(x));
        let bin_hz = rate_hz / n as f64;
        if Self::NEAR_HZ < (2 * Self::OWN + 2) as f64 * bin_hz {
            return None;
        }
        let window = |i: usize| 1.0 - (TAU * i as f64 / n as f64).cos();
        let mut z: Vec<Complex64> =
            x.iter().enumerate().map(|(i, v)| Complex64::new((v - middle) * window(i), 0.0)).collect();
        FftPlanner::new().plan_fft_forward(n).process(&mut z);
        let mut sums = vec![0.0];
        let mut sum = 0.0;
        for z in &z[..n / 2] {
            sum += 2.0 * z.norm_sqr() / (n as f64).powi(2);
            sums.push(sum);
        }
        Some(Self { sums, bin_hz })
    }

    fn power(&self, [from, to]: [usize; 2]) -> f64 {
        let end = self.sums.len() - 1;
        (self.sums[to.min(end)] - self.sums[from.min(end)]).max(0.0)
    }

    fn rms(&self, k: usize) -> f64 {
        self.power([k, k + 1]).sqrt()
    }

    /// Root mean square of the bins within [`Self::NEAR_HZ`], the line's own left out.
    fn beside(&self, k: usize) -> f64 {
        let reach = (Self::NEAR_HZ / self.bin_hz) as usize;
        let below = self.power([k.saturating_sub(reach), k.saturating_sub(Self::OWN)]);
        let above = self.power([k + Self::OWN + 1, k + reach + 1]);
        ((below + above) / (2 * (reach - Self::OWN)) as f64).sqrt()
    }

    /// The largest bin within one of a frequency; `None`: too fast.
    fn largest_near(&self, frequency_hz: f64) -> Option<usize> {
        let k = (frequency_hz / self.bin_hz).round() as usize;
        let reach = (Self::NEAR_HZ / self.bin_hz) as usize;
        let inside = k > reach && k + reach < self.sums.len();
        (k - inside as usize..=k + 1).max_by(|a, b| self.rms(*a).total_cmp(&self.rms(*b))).filter(|_| inside)
    }

    /// True of the bins of a multiple of the mains.
    fn is_of_mains(&self, k: usize) -> bool {
        let off = |f: f64| {
            let times = (k as f64 * self.bin_hz / f).round().max(1.0);
            (k as f64 - times * f / self.bin_hz).abs()
        };
        off(50.0).min(off(60.0)) <= (Self::OWN + 1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise, the same every time.
    fn noise(rows: usize) -> impl Iterator<Item = f64> {
        let mut state = 7u64;
        (0..rows).map(move |_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        })
    }

    /// Chatter with its harmonics behind a low-pass has lines and gaps between them; a notch at every
    /// multiple of a fifth of the rate has a moving average alone.
    #[test]
    fn chatter_is_no_moving_average() {
        let rows = 20_000;
        let notched = |x: &[f64]| {
            let spectrum = spectrum(x).expect("long enough");
            (5..=32).rev().find(|n| has_notches(&spectrum, *n, [9.0, 12.0]))
        };
        let (mut low, mut slow) = ([0.0; 4], 0.0);
        let force: Vec<f64> = noise(rows)
            .zip(noise(rows + 5).skip(5))
            .enumerate()
            .map(|(k, (random, sensor))| {
                // 592 Hz at 9 kHz: its second and fifth harmonic lie beside what a mean of 5 rows takes.
                slow += 0.003 * (random - slow);
                let turn = TAU * 592.0 * k as f64 / 9000.0 + 0.5 * slow;
                let chatter: f64 = (1..=8).map(|h| 20.0 / f64::from(h) * (f64::from(h) * turn).sin()).sum();
                let mut x = 2.0 * random + chatter;
                for stage in &mut low {
                    *stage += 0.45 * (x - *stage);
                    x = *stage;
                }
                x + 0.02 * sensor
            })
            .collect();
        assert_eq!(notched(&force), None);
        for n in [5, 8, 20] {
            let average: Vec<f64> = force.windows(n).map(mean).collect();
            assert_eq!(notched(&average), Some(n));
        }
    }
}
