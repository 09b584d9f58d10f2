//! What `stillcut force` says and writes.

use super::super::bad_input;
use crate::force::balance::Method;
use crate::force::motion::ForceEstimate;
use crate::force::observer::Observer;
use crate::force::two_sides::Mismatch;
use crate::force::validity::Validity;
use crate::recording::{Table, TableColumn, write_table};
use crate::sample::Recording;
use std::io::Write as _;
use std::path::Path;

/// What the estimator says of itself, for the file's metadata.
pub(super) fn describe(
    observer: &Observer,
    estimates: &[ForceEstimate],
    note: &mut impl FnMut(&str, String),
) {
    note("usable_band_hz", format!("{:?}", observer.properties().usable_band_hz));
    if let Some(above_hz) = observer.properties().usable_above_hz {
        note("usable_above_hz", format!("{above_hz:?}"));
    }
    let floor_n = observer.properties().noise_floor_n;
    let unknown =
        || "not known: the model states no encoder steps, or no controller to carry them".to_owned();
    note("noise_floor_n", if floor_n > 0.0 { format!("{floor_n:.4}") } else { unknown() });
    if let Some(travel) = observer.guideway_travel() {
        note("guideway_travel", travel.describe());
        if let Some(travel_m) = travel.known_m() {
            note("guideway_travel_m", format!("{travel_m:.2e}"));
        }
    }
    if let Some(condition) = observer.properties().condition {
        note("condition", format!("{condition:.3e}"));
    }
    let seen = estimates.iter().fold(Validity::VALID, |seen, e| seen | e.flags);
    note("flags", seen.to_string());
    for name in seen.names() {
        let count = estimates.iter().filter(|e| e.flags.names().any(|n| n == name)).count();
        note(&format!("flag_{name}_share"), format!("{:.4}", count as f64 / estimates.len().max(1) as f64));
    }
    if let Some(bound_n) =
        observer.properties().friction_bound_n.filter(|_| seen.contains(Validity::BELOW_FRICTION))
    {
        note("below_friction", format!("not observable, bound {bound_n:.0} N"));
    }
}

/// Rows whose size is not that of the force: a line on the terminal with the share to expect.
pub(super) fn say_what_is_doubtful(
    (axis, method): (&str, Method),
    estimates: &[ForceEstimate],
    observer: &Observer,
    mismatch: Mismatch,
) -> anyhow::Result<()> {
    let percent = |flag: Validity| {
        let count = estimates.iter().filter(|e| e.flags.contains(flag)).count();
        100.0 * count as f64 / estimates.len().max(1) as f64
    };
    let (method, mut out) = (method.name(), std::io::stdout());
    let above = percent(Validity::FORCE_ABOVE_BAND);
    if above > 0.0 {
        let [low_hz, high_hz] = observer.properties().usable_band_hz;
        let again = observer.properties().usable_above_hz.map(|hz| format!(" and from {hz:.0} Hz on"));
        let again = again.unwrap_or_default();
        let band = format!("{low_hz:.0} to {high_hz:.0} Hz{again}");
        let what = format!("right within a tenth from {band}, the force lies above");
        writeln!(out, "axis {axis}: {method}: {what} in {above:.0} % of the recording")?;
    }
    if mismatch.is_large() {
        let share = 100.0 * mismatch.share();
        let what = "motor side and stretch of the screw contradict each other, a mode outside the model";
        let so = format!("expected error {:.1} N, {share:.0} % of the force", mismatch.error_n);
        writeln!(out, "axis {axis}: {method}: {what}: {so}")?;
    }
    Ok(())
}

/// Where friction hides the force there is no number: NaN in the file, a line on the terminal.
pub(super) fn say_what_is_hidden(
    axis: &str,
    estimates: &[ForceEstimate],
    force_n: &mut [f64],
    bound_n: f64,
) -> anyhow::Result<()> {
    let mut hidden = 0.0;
    for (force_n, estimate) in force_n.iter_mut().zip(estimates) {
        let settled = !estimate.flags.contains(Validity::SETTLING);
        if settled && estimate.flags.contains(Validity::BELOW_FRICTION) {
            *force_n = f64::NAN;
            hidden += 1.0;
        }
    }
    if hidden > 0.0 {
        let percent = 100.0 * hidden / estimates.len() as f64;
        let said = format!("below friction, not observable, bound {bound_n:.0} N");
        writeln!(std::io::stdout(), "axis {axis}: {said} ({percent:.0} % of the recording)")?;
    }
    Ok(())
}

/// What the command writes.
pub(super) struct Forces {
    /// Column name and values.
    pub(super) forces: Vec<(String, Vec<f64>)>,
    /// Column name and flags as bits.
    pub(super) flags: Vec<(String, Vec<i64>)>,
    pub(super) delay_s: f64,
    /// Further metadata.
    pub(super) notes: Vec<(String, String)>,
}

pub(super) fn write_forces(out: &Path, recording: &Recording, forces: &Forces) -> anyhow::Result<()> {
    let times: Vec<f64> = (0..recording.len()).map(|i| recording.time_s(i)).collect();
    let mut columns = vec![("t_s", TableColumn::Double(&times))];
    columns.extend(forces.forces.iter().map(|(name, values)| (name.as_str(), TableColumn::Double(values))));
    columns.extend(forces.flags.iter().map(|(name, bits)| (name.as_str(), TableColumn::Integer(bits))));
    let axes: Vec<&str> =
        forces.forces.iter().filter_map(|(name, _)| name.strip_suffix("_force_n")).collect();
    let mut metadata = vec![
        ("format".to_owned(), crate::recording::FORMAT.to_owned()),
        ("sample_rate_hz".to_owned(), format!("{:?}", recording.sample_rate.hz())),
        ("experiment".to_owned(), recording.experiment.clone()),
        ("axes".to_owned(), axes.join(",")),
        ("delay_s".to_owned(), format!("{:?}", forces.delay_s)),
        ("flag_bits".to_owned(), Validity::describe_bits()),
    ];
    metadata.extend(forces.notes.iter().cloned());
    write_table(out, &Table { columns, metadata }).map_err(bad_input)
}
