//! A logged speed that is not the travel's.

use super::columns::{AxisColumns, Role};
use super::fault::{Action, FaultKind};
use super::motion::travel;
use super::rows::same_unit;
use super::work::{Told, Work};

/// Slope of b on a, and how well they agree.
pub(super) struct Ratio {
    /// Ratio of the spreads: errors are in both.
    of_spreads: f64,
    pub(super) correlation: f64,
}

pub(super) fn ratio(a: &[f64], b: &[f64]) -> Ratio {
    let n = a.len().max(1) as f64;
    let mean = |x: &[f64]| x.iter().sum::<f64>() / n;
    let (ma, mb) = (mean(a), mean(b));
    let (mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0);
    for (x, y) in a.iter().zip(b) {
        aa += (x - ma).powi(2);
        bb += (y - mb).powi(2);
        ab += (x - ma) * (y - mb);
    }
    let correlation = ab / (aa * bb).sqrt().max(f64::MIN_POSITIVE);
    Ratio { of_spreads: (bb / aa.max(f64::MIN_POSITIVE)).sqrt(), correlation }
}

/// Tells a speed of the same unit that is not what the travel says.
pub(super) fn wrong_scale(work: &mut Work<'_>, axis: &AxisColumns) {
    let c = *work.criteria;
    let live: Vec<usize> = axis.with(Role::Speed).filter(|i| !work.silent[*i]).collect();
    for speed in live {
        let position = axis.with(Role::Position).find(|p| !work.silent[*p] && same_unit(work, *p, speed));
        let Some(position) = position else { continue };
        // As quickly as the speed follows, as slowly as its steps ask.
        let reach = 2.max(work.updates[speed]).max(work.rows_in(2e-3));
        let v = travel(work.values(position), reach, work.period_s());
        let logged = super::motion::averaged(work.values(speed), reach);
        let Ratio { of_spreads: k, correlation: r } = ratio(&work.kept(&v), &work.kept(&logged));
        let margin = 1.0 + c.scale_error;
        let inside = (r.abs() * k / margin..=k / r.abs() * margin).contains(&1.0);
        if r.abs() <= c.scale_correlation || inside && r > 0.0 {
            continue;
        }
        let (name, of) = (work.name(speed), work.name(position));
        let statement = format!(
            "{name} is {:.4} times what the travel of {of} says; the travel is used.",
            k * r.signum()
        );
        work.tell(Told {
            column: &name,
            kind: FaultKind::WrongScale,
            action: Action::Tell,
            rows: &[],
            statement,
        });
    }
}
