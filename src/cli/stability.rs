//! `stillcut stability`: growth and frequency over a grid, as a table and as a picture.

use super::bad_input;
use crate::config::scenario::read_scenario;
use crate::diagnosis::cut::input::{CutOutcome, CutRow};
use crate::plant::cut_terms::CutCondition;
use crate::plant::scenario::Scenario;
use crate::recording::{Table, TableColumn, read_cuts, write_table, write_whole};
use crate::report::stability_picture;
use crate::stability::{Foretold, Grid, GridPoint, GridRange, foretell};
use std::path::{Path, PathBuf};

/// Options that span a grid.
const GRID: [&str; 4] = ["pitch_rad", "position_m", "speed_rpm", "width_m"];

/// Maps where two opposed tools chatter: growth and frequency over pitch difference, position, speed, width.
///
/// Of the bar's bending: roots below half its natural frequency, at which surface marks only fade, are left
/// out.
///
/// Example: stillcut stability --scenario lathe.toml --pitch-rad 0:0.4:200 --speed-rpm 800:2400:200 --out map
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// lathe.toml.
    #[arg(long)]
    scenario: PathBuf,
    /// Folder to write stability.parquet and stability.svg into.
    #[arg(long)]
    out: PathBuf,
    /// Table of cuts: cuts.parquet is written instead, with what the scenario foretells of each row.
    #[arg(long, value_name = "FILE", conflicts_with_all = GRID)]
    cuts: Option<PathBuf>,
    /// Pitch angle difference, from:to:count.
    #[arg(long, value_name = "A:B:N", allow_hyphen_values = true)]
    pitch_rad: Option<String>,
    /// Tools from the chuck, from:to:count.
    #[arg(long, value_name = "A:B:N", allow_hyphen_values = true)]
    position_m: Option<String>,
    /// Spindle speed, from:to:count.
    #[arg(long, value_name = "A:B:N", allow_hyphen_values = true)]
    speed_rpm: Option<String>,
    /// Width of cut, from:to:count.
    #[arg(long, value_name = "A:B:N", allow_hyphen_values = true)]
    width_m: Option<String>,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    let scenario = read_scenario(&arguments.scenario).map_err(bad_input)?;
    if let Some(cuts) = &arguments.cuts {
        return foretell_cuts(&scenario, cuts, &arguments.out);
    }
    let mut grid = Grid::of(scenario);
    let options = [
        ("--pitch-rad", &arguments.pitch_rad, &mut grid.pitch_rad),
        ("--position-m", &arguments.position_m, &mut grid.position_m),
        ("--speed-rpm", &arguments.speed_rpm, &mut grid.speed_rpm),
        ("--width-m", &arguments.width_m, &mut grid.width_m),
    ];
    for (name, text, range) in options {
        if let Some(text) = text {
            *range = range_from(text).map_err(|e| bad_input(format!("{name} {text}: {e}")))?;
        }
    }
    grid.check().map_err(bad_input)?;
    let points = evaluate(&grid)?;
    let folder = &arguments.out;
    std::fs::create_dir_all(folder).map_err(|e| bad_input(format!("{}: {e}", folder.display())))?;
    write_points(&arguments.out.join("stability.parquet"), &points)?;
    let picture = stability_picture::draw(&grid, &points)?;
    write_whole(&arguments.out.join("stability.svg"), picture.as_bytes())?;
    Ok(())
}

/// Writes what a scenario foretells of every row of a table.
fn foretell_cuts(scenario: &Scenario, cuts: &Path, folder: &Path) -> anyhow::Result<()> {
    let table = read_cuts(cuts).map_err(bad_input)?;
    let rows: Vec<Foretold> =
        table.rows.iter().map(|row| foretell(scenario, &condition_of(row, scenario))).collect();
    std::fs::create_dir_all(folder).map_err(|e| bad_input(format!("{}: {e}", folder.display())))?;
    let column = |value: fn(&Foretold) -> f64| rows.iter().map(value).collect::<Vec<f64>>();
    let numbers = [
        ("growth_1_s", column(|f| f.root.growth_1_s)),
        ("frequency_hz", column(|f| f.root.frequency_hz)),
        ("chatter_probability", column(Foretold::chatter_probability)),
    ];
    let names: Vec<String> = table.rows.iter().map(|row| row.cut.clone()).collect();
    let outcome = |f: &Foretold| {
        let grows = f.root.growth_1_s > 0.0;
        (if grows { CutOutcome::Chatter } else { CutOutcome::Stable }).name().to_owned()
    };
    let outcomes: Vec<String> = rows.iter().map(outcome).collect();
    let mut columns = vec![("cut", TableColumn::Text(&names))];
    columns.extend(numbers.iter().map(|(name, values)| (*name, TableColumn::Double(values))));
    columns.insert(3, ("outcome", TableColumn::Text(&outcomes)));
    let metadata = vec![("format".into(), "stillcut.foretold/1".into())];
    write_table(&folder.join("cuts.parquet"), &Table { columns, metadata })?;
    Ok(())
}

/// The condition of a row; what it does not say is the scenario's. Its bar is cold, its edges as old as the
/// table's clock.
fn condition_of(row: &CutRow, scenario: &Scenario) -> CutCondition {
    let (own, known) = (CutCondition::of(scenario), &row.known);
    CutCondition {
        speed_rpm: row.spindle_speed_rpm,
        width_m: row.width_m,
        feed_m_rev: known.feed_m_rev.unwrap_or(own.feed_m_rev),
        position_m: known.tool_position_m.unwrap_or(own.position_m),
        pitch_difference_rad: known.pitch_difference_rad.unwrap_or(own.pitch_difference_rad),
        diameter_m: known.workpiece_diameter_m.unwrap_or(own.diameter_m),
        time_s: 0.0,
        edge_age_s: known.started_s.unwrap_or(0.0),
    }
}

fn range_from(text: &str) -> Result<GridRange, String> {
    let expected = || "expected from:to:count".to_owned();
    let parts: Vec<&str> = text.split(':').collect();
    let [low, high, count] = parts[..] else { return Err(expected()) };
    let number = |t: &str| t.trim().parse::<f64>().map_err(|_| expected());
    let count = count.trim().parse::<usize>().map_err(|_| expected())?;
    GridRange::new(number(low)?, number(high)?, count).map_err(|e| e.to_string())
}

/// The grid in as many parts as there are processors.
fn evaluate(grid: &Grid) -> anyhow::Result<Vec<GridPoint>> {
    let points = grid.points();
    let workers = std::thread::available_parallelism().map_or(1, usize::from).min(points.div_ceil(64));
    let share = points.div_ceil(workers.max(1));
    let parts: Result<Vec<_>, _> = std::thread::scope(|scope| {
        let begin = |w: usize| {
            let (from, to) = (w * share, ((w + 1) * share).min(points));
            scope.spawn(move || grid.evaluate(from.min(to), to))
        };
        let handles: Vec<_> = (0..workers).map(begin).collect();
        handles.into_iter().map(std::thread::ScopedJoinHandle::join).collect()
    });
    let parts = parts.map_err(|_| anyhow::anyhow!("a worker of the stability map died"))?;
    let mut answers = Vec::with_capacity(points);
    for part in parts {
        answers.extend(part.map_err(bad_input)?);
    }
    Ok(answers)
}

fn write_points(path: &std::path::Path, points: &[GridPoint]) -> anyhow::Result<()> {
    let column = |value: fn(&GridPoint) -> f64| points.iter().map(value).collect::<Vec<f64>>();
    let columns = [
        ("pitch_rad", column(|p| p.pitch_rad)),
        ("position_m", column(|p| p.position_m)),
        ("speed_rpm", column(|p| p.speed_rpm)),
        ("width_m", column(|p| p.width_m)),
        ("growth_1_s", column(|p| p.root.growth_1_s)),
        ("frequency_hz", column(|p| p.root.frequency_hz)),
    ];
    let columns = columns.iter().map(|(name, values)| (*name, TableColumn::Double(values))).collect();
    write_table(path, &Table { columns, metadata: vec![("format".into(), "stillcut.stability/1".into())] })?;
    Ok(())
}
