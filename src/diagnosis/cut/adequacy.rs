//! Is anything left? Innovations of a model that holds are white everywhere: in every band, in the means, in
//! what turns with the spindle, and below the band of the fit, where no law of a calm cut makes more than the
//! random force does.

use super::super::result::TimeSpans;
use super::criteria::CRITERIA;
use super::fit::Problem;
use super::machine::{Machine, Point};
use super::matrix::{cholesky, forward};
use super::observable::{Bin, Every, Observed, Origin, OriginKind, Part};
use super::port::likeliest;
use super::result::CutLocation;
use crate::plant::effects::Port;

/// What a model leaves.
#[derive(Debug, Clone)]
pub(crate) struct Left {
    /// Where and in what it shows.
    pub(crate) location: CutLocation,
    /// How much worse than noise, nats.
    pub(crate) excess_nats: f64,
}

/// One kind of evidence pooled over all stretches.
struct Pool {
    domain: &'static str,
    band_hz: Option<[f64; 2]>,
    /// Sum of squares, and what noise gives.
    power: f64,
    expected: f64,
    variance: f64,
    /// Share by which the model itself may be off.
    tolerance: f64,
    /// Its bins, each with the observable that it is of.
    bins: Vec<(usize, Bin)>,
    worst: Vec<(f64, Origin)>,
}

impl Pool {
    fn new(domain: &'static str, band_hz: Option<[f64; 2]>, tolerance: f64) -> Self {
        Self {
            domain,
            band_hz,
            power: 0.0,
            expected: 0.0,
            variance: 0.0,
            tolerance,
            bins: Vec::new(),
            worst: Vec::new(),
        }
    }

    /// Standard deviations by which the power exceeds that of noise.
    fn deviation(&self) -> f64 {
        let sd = (self.variance + (self.tolerance * self.expected).powi(2)).sqrt();
        (self.power - self.expected) / sd.max(1e-9)
    }

    fn add_bins<'a>(
        &mut self,
        bins: impl Iterator<Item = &'a Bin>,
        channels: usize,
        (index, origin): (usize, Origin),
    ) {
        let n = channels as f64;
        let mut above = 0.0;
        for bin in bins {
            let Some(l) = cholesky(&bin.s, channels) else { continue };
            let power: f64 = forward(&l, &bin.x, channels)[..channels].iter().map(|u| u.norm_sqr()).sum();
            self.power += power;
            self.expected += n;
            self.variance += n;
            above += power - n;
            self.bins.push((index, *bin));
        }
        self.worst.push((above, origin));
    }

    fn add_rows(&mut self, rows: &[f64], origin: Origin) {
        let power: f64 = rows.iter().map(|r| r * r).sum();
        let n = rows.len() as f64;
        self.power += power;
        self.expected += n;
        self.variance += 2.0 * n;
        self.worst.push((power - n, origin));
    }

    /// Where a force that leaves this acts.
    fn port(&self, kind: OriginKind, observables: &[Observed<'_>], machine: &Machine) -> Port {
        if kind == OriginKind::Angle {
            return Port::Spindle;
        }
        let reached = |(index, bin): &(usize, Bin)| {
            Some((*bin, observables[*index].sources(machine, bin.frequency_hz)?))
        };
        likeliest(&self.bins.iter().filter_map(reached).collect::<Vec<_>>())
    }
}

/// Band of all bins, Hz.
fn looked_at_hz<'a>(parts: impl Iterator<Item = &'a Part>) -> [f64; 2] {
    let bins = parts.filter_map(|p| match p {
        Part::Bins { bins, .. } => Some(bins),
        Part::Rows(_) => None,
    });
    let band = bins.flatten().fold([f64::MAX, 0.0], |[low, high], b| {
        [f64::min(low, b.frequency_hz), f64::max(high, b.frequency_hz + 1e-6)]
    });
    if band[0] < band[1] { band } else { [0.0, 1.0] }
}

/// What the model of a point leaves; `None`: nothing beyond noise.
pub(crate) fn left(problem: &Problem<'_>, point: &Point) -> Option<Left> {
    let machine = problem.frame.machine(point)?;
    let parts: Vec<Part> = problem.observables.iter().map(|o| o.part(&machine, Every(1))).collect();
    let [low, high] = looked_at_hz(parts.iter());
    let count = ((high - low) / CRITERIA.left_band_hz).ceil() as usize;
    let edge = |k: usize| low + k as f64 * CRITERIA.left_band_hz;
    let mut pools: Vec<Pool> = (0..count)
        .map(|k| Pool::new("frequency", Some([edge(k), edge(k + 1)]), CRITERIA.left_share))
        .collect();
    let mut whole = Pool::new("frequency", Some([low, high]), CRITERIA.left_share);
    let mut slow = Pool::new("frequency", Some([CRITERIA.slow_hz, low]), CRITERIA.left_slow_share);
    let mut means = Pool::new("mean", None, CRITERIA.left_share);
    let mut orders = Pool::new("order", None, CRITERIA.left_share);
    for (index, (observable, part)) in problem.observables.iter().zip(parts).enumerate() {
        let origin = observable.origin();
        let from = (index, origin);
        match part {
            Part::Bins { channels, bins } => {
                for (k, pool) in pools.iter_mut().enumerate() {
                    let inside = |b: &&Bin| (edge(k)..edge(k + 1)).contains(&b.frequency_hz);
                    pool.add_bins(bins.iter().filter(inside), channels, from);
                }
                whole.add_bins(bins.iter(), channels, from);
                if let Some(Part::Bins { channels, bins }) = observable.slow(&machine) {
                    slow.add_bins(bins.iter(), channels, from);
                }
            }
            Part::Rows(rows) if origin.kind == OriginKind::Means => means.add_rows(&rows, origin),
            Part::Rows(_) if origin.kind == OriginKind::Table => {}
            Part::Rows(rows) => orders.add_rows(&rows, origin),
        }
    }
    pools.extend([slow, means, orders, whole]);
    let mut loud: Vec<&Pool> = pools.iter().filter(|p| p.deviation() > CRITERIA.left_sd).collect();
    loud.sort_by(|a, b| b.deviation().total_cmp(&a.deviation()));
    let worst = *loud.first()?;
    let kind = worst
        .worst
        .iter()
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map_or(OriginKind::Calm, |(_, origin)| origin.kind);
    let excess_nats = loud.iter().map(|p| (p.power - p.expected) / 2.0).sum();
    Some(Left {
        location: CutLocation {
            port: worst.port(kind, problem.observables, &machine),
            domain: worst.domain,
            bands_hz: joined(
                loud.iter().filter_map(|p| p.band_hz).filter(|b| b[1] - b[0] < 0.5 * (high - low)),
            ),
            time: spans(&worst.worst),
        },
        excess_nats,
    })
}

/// Where most is left in the spectra of a model, ln(f/`frequency_hz`), best first.
///
/// Whitened power over cells of one per cent, three together.
pub(crate) fn peaks<'a>(parts: impl Iterator<Item = &'a Part> + Clone, frequency_hz: f64) -> Vec<f64> {
    /// One per cent, and what is kept: as many peaks as two modes may make.
    const CELL: f64 = 0.01;
    const KEPT: usize = 4;
    /// A resonance takes this many cells.
    const APART: usize = 5;
    let [low, high] = looked_at_hz(parts.clone()).map(|f| (f / frequency_hz).max(1e-3).ln());
    let count = ((high - low) / CELL).ceil() as usize + 1;
    let mut cells = vec![[0.0, 0.0]; count];
    for part in parts {
        let Part::Bins { channels, bins } = part else { continue };
        for bin in bins {
            let Some(l) = cholesky(&bin.s, *channels) else { continue };
            let power: f64 = forward(&l, &bin.x, *channels)[..*channels].iter().map(|u| u.norm_sqr()).sum();
            let cell = (((bin.frequency_hz / frequency_hz).ln() - low) / CELL).max(0.0) as usize;
            cells[cell.min(count - 1)][0] += power - *channels as f64;
            cells[cell.min(count - 1)][1] += *channels as f64;
        }
    }
    let mut scores: Vec<(f64, usize)> = (1..count.max(2) - 1)
        .map(|k| {
            let [sum, variance] = [0, 1].map(|i| cells[k - 1..=k + 1].iter().map(|c| c[i]).sum::<f64>());
            (sum / f64::max(variance, 1.0).sqrt(), k)
        })
        .collect();
    scores.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut out: Vec<usize> = Vec::new();
    for (_, k) in scores {
        if out.len() < KEPT && out.iter().all(|o| o.abs_diff(k) >= APART) {
            out.push(k);
        }
    }
    out.into_iter().map(|k| low + (k as f64 + 0.5) * CELL).collect()
}

/// Whitened power of the bins of a model, of calm and of followed stretches, the greater; at least 1.
///
/// Intervals and probabilities of a likelihood that is off by it are wider by its root and by it.
pub(crate) fn whitened_power(problem: &Problem<'_>, point: &Point) -> f64 {
    let Some(parts) = problem.parts(point, Every(1)) else { return 1.0 };
    let mut sums = [[0.0, 0.0]; 2];
    for (observable, part) in problem.observables.iter().zip(&parts) {
        let Part::Bins { channels, bins } = part else { continue };
        let kind = usize::from(observable.origin().kind == OriginKind::Followed);
        for bin in bins {
            let Some(l) = cholesky(&bin.s, *channels) else { continue };
            let power: f64 = forward(&l, &bin.x, *channels)[..*channels].iter().map(|u| u.norm_sqr()).sum();
            sums[kind][0] += power;
            sums[kind][1] += *channels as f64;
        }
    }
    sums.iter().filter(|s| s[1] > 0.0).map(|s| s[0] / s[1]).fold(1.0, f64::max)
}

/// Bands in order, neighbours joined.
pub(crate) fn joined(bands: impl Iterator<Item = [f64; 2]>) -> Vec<[f64; 2]> {
    let mut all: Vec<[f64; 2]> = bands.collect();
    all.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut out: Vec<[f64; 2]> = Vec::new();
    for band in all {
        match out.last_mut() {
            Some(last) if band[0] <= last[1] + 1e-6 => last[1] = last[1].max(band[1]),
            _ => out.push(band),
        }
    }
    out
}

/// When, in which recording: the stretches with half of the excess.
pub(crate) fn spans(excess: &[(f64, Origin)]) -> Vec<TimeSpans> {
    let mut all: Vec<&(f64, Origin)> = excess.iter().filter(|w| w.0 > 0.0).collect();
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    let total: f64 = all.iter().map(|w| w.0).sum();
    let (mut out, mut sum): (Vec<TimeSpans>, f64) = (Vec::new(), 0.0);
    for (excess, origin) in all {
        if sum > 0.5 * total {
            break;
        }
        sum += excess;
        let Some(recording) = origin.recording else { continue };
        TimeSpans::add(&mut out, recording, origin.span_s);
    }
    out
}
