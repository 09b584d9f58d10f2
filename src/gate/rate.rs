//! Columns that take a new value every k rows only: the recording is brought to its true rate.

use super::columns::{AxisColumns, Role};
use super::fault::{Action, FaultKind};
use super::statistics::median;
use super::work::{Told, Work};
use crate::units::SampleRate;

/// Largest number of rows between two values that is looked for.
const MOST_ROWS: usize = 1000;

/// How a column is updated.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Updates {
    /// Rows between two values, a mean where they differ.
    rows: f64,
    /// Row of an update, modulo `rows`.
    phase: usize,
}

/// Tells every column with a lower rate; thins the recording where a drive or a position has one.
pub(super) fn true_rate(work: &mut Work<'_>, axes: &[AxisColumns]) {
    let mut slowest: Option<Updates> = None;
    let measured = axes.iter().flat_map(AxisColumns::measured);
    let columns: Vec<_> = measured.filter(|c| !work.silent[c.index]).collect();
    let mut slow = Vec::new();
    for column in columns {
        let Some(updates) = updates(work, column.index) else { continue };
        work.updates[column.index] = updates.rows.ceil() as usize;
        slow.push((column.index, updates));
        let used = matches!(column.role, Role::Drive | Role::Position);
        let rate_hz = work.recording.sample_rate.hz() / updates.rows;
        let name = work.name(column.index);
        work.tell(Told {
            column: &name,
            kind: FaultKind::LowerRate,
            action: if used { Action::Correct } else { Action::Tell },
            rows: &[],
            statement: format!(
                "{name} has a new value every {} rows only: its true rate is {rate_hz:.4} Hz.",
                if updates.rows.fract() == 0.0 {
                    format!("{}", updates.rows)
                } else {
                    format!("{:.2}", updates.rows)
                }
            ),
        });
        if used && slowest.is_none_or(|s| s.rows < updates.rows) {
            slowest = Some(updates);
        }
    }
    if let Some(slowest) = slowest {
        thin(work, slowest, &slow);
    }
}

/// How a column is updated, where that is not with every row.
fn updates(work: &Work<'_>, column: usize) -> Option<Updates> {
    let c = work.criteria;
    let x = work.values(column);
    let changes: Vec<usize> = (1..x.len()).filter(|&i| x[i] != x[i - 1]).collect();
    if changes.len() < c.rate_changes {
        return None;
    }
    let jumps: Vec<f64> = changes.iter().map(|&i| (x[i] - x[i - 1]).abs()).collect();
    if median(&jumps) < c.update_steps * work.step(column) {
        return None;
    }
    let gaps: Vec<usize> = changes.windows(2).map(|w| w[1] - w[0]).collect();
    let mut counts = vec![0_usize; MOST_ROWS + 2];
    gaps.iter().filter(|g| **g <= MOST_ROWS).for_each(|g| counts[*g] += 1);
    let usual = (1..=MOST_ROWS).max_by_key(|k| (counts[*k], MOST_ROWS - k))?;
    if usual < 2 && counts[2] * 2 < counts[1] {
        return None;
    }
    if usual >= 2 {
        let mut residues = vec![0_usize; usual];
        changes.iter().for_each(|i| residues[i % usual] += 1);
        let phase = (0..usual).max_by_key(|r| residues[*r])?;
        if residues[phase] as f64 >= c.residue_share * changes.len() as f64 {
            return Some(Updates { rows: usual as f64, phase });
        }
    }
    // Between two whole numbers: runs of k and k + 1 rows.
    let low = if counts[usual.saturating_sub(1)] > counts[usual + 1] { usual - 1 } else { usual };
    let inside = low * counts[low] + (low + 1) * counts[low + 1];
    let mean = inside as f64 / (counts[low] + counts[low + 1]).max(1) as f64;
    let share = inside as f64 / x.len() as f64;
    (low >= 1 && mean > 1.25 && share >= c.run_share && (low >= 2 || alternates(&gaps)))
        .then(|| Updates { rows: mean, phase: changes[0] % usual })
}

/// True where runs of one and two rows follow a rule and are not chance: a sequence of updates at an even
/// rate never differs by more than one in the rows that the same number of updates takes.
fn alternates(gaps: &[usize]) -> bool {
    const TOGETHER: usize = 16;
    const LEAST: usize = 8;
    let sums: Vec<usize> = gaps.chunks_exact(TOGETHER).map(|g| g.iter().sum()).collect();
    let middle = median(&sums.iter().map(|s| *s as f64).collect::<Vec<_>>());
    let near = sums.iter().filter(|s| (**s as f64 - middle).abs() <= 1.0).count();
    sums.len() >= LEAST && near as f64 >= 0.9 * sums.len() as f64
}

/// Takes the slow columns where they are new and the others as means about those instants.
fn thin(work: &mut Work<'_>, to: Updates, slow: &[(usize, Updates)]) {
    let Ok(rate) = SampleRate::new(work.recording.sample_rate.hz() / to.rows) else { return };
    let half = (0.5 * to.rows).round() as usize;
    let instants: Vec<usize> = (0..)
        .map(|j| to.phase + (f64::from(j) * to.rows).round() as usize)
        .take_while(|row| *row < work.rows())
        .filter(|row| *row >= half && row + half < work.rows())
        .collect();
    for (index, column) in work.recording.columns.iter_mut().enumerate() {
        let x = &column.values;
        let is_slow = slow.iter().any(|(i, u)| *i == index && u.rows > 0.5 * to.rows);
        let take = |&row: &usize| {
            if is_slow {
                return x[row];
            }
            // Over k rows, the outermost with half their weight: centred on the instant.
            let inside: f64 = x[row + 1 - half..row + half].iter().sum();
            (inside + 0.5 * (x[row - half] + x[row + half])) / (2 * half) as f64
        };
        column.values = instants.iter().map(take).collect();
    }
    work.usable =
        instants.iter().map(|&row| work.usable[row - half..row + half].iter().all(|u| *u)).collect();
    work.times_s = instants.iter().map(|&row| work.times_s[row]).collect();
    work.recording.sample_rate = rate;
    for (index, updates) in work.updates.iter_mut().enumerate() {
        let own = slow.iter().find(|(i, _)| *i == index).map_or(1.0, |(_, u)| u.rows);
        *updates = (own / to.rows).round().max(1.0) as usize;
    }
}
