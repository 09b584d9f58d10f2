//! `stillcut diagnose --scenario`: what physics of the cut the scenario leaves out.

use super::bad_input;
use super::diagnose_arguments::Arguments;
use super::gated::{Checked, read_checked};
use super::progress::with_progress;
use crate::config::scenario::read_scenario;
use crate::diagnosis::Verdict;
use crate::diagnosis::cut::input::{CutEvidence, CutRecording, CutTable};
use crate::diagnosis::cut::result::CutDiagnosis;
use crate::gate::Gated;
use crate::plant::scenario::Scenario;
use crate::recording::{read_cuts, write_whole};
use crate::report::cut_files::{CutFiles, write};
use crate::report::cut_page::cut_page;
use std::io::Write as _;
use std::path::{Path, PathBuf};

pub(super) fn run(arguments: &Arguments, scenario_file: &Path) -> anyhow::Result<()> {
    let scenario = read_scenario(scenario_file).map_err(bad_input)?;
    let axes = FORCE_AXES.map(str::to_owned);
    let paths = arguments.recordings.iter().map(PathBuf::as_path);
    let Checked { gated, paths, files: names, faults, .. } = read_checked(paths, &axes)?;
    let recordings = gated.iter().zip(&paths).map(|(gated, path)| cut_recording(gated, path, &scenario));
    let recordings = recordings.collect::<anyhow::Result<Vec<_>>>()?;
    let table = arguments.cuts.as_deref().map(read_cuts).transpose().map_err(bad_input)?;
    if recordings.is_empty() && table.is_none() {
        return Err(bad_input("--scenario needs cuts: expected --recording or --cuts"));
    }
    let evidence = CutEvidence { recordings: &recordings, table: table.as_ref() };
    let diagnosis = with_progress(arguments.progress, |progress| {
        crate::diagnosis::cut::diagnose(&scenario, evidence, arguments.budget_s, progress)
    })
    .map_err(bad_input)?;
    told(&diagnosis, table.as_ref());
    let files = CutFiles { scenario: name(scenario_file), recordings: names, faults, table: table.as_ref() };
    let out: &PathBuf = &arguments.out;
    write(out, &diagnosis, &files)?;
    write_whole(&out.join("report.html"), cut_page(&diagnosis, &files).as_bytes())?;
    if arguments.plan {
        print_plan(&diagnosis)?;
    }
    Ok(())
}

/// Columns of a cut that a gate can judge: the forces are measured, the rest is commanded.
const FORCE_AXES: [&str; 2] = ["tool1", "tool2"];

fn cut_recording(gated: &Gated, path: &Path, scenario: &Scenario) -> anyhow::Result<CutRecording> {
    let refused = |error| bad_input(format!("{}: {error}", path.display()));
    let cut = CutRecording::new(&gated.recording, scenario).map_err(refused)?;
    Ok(cut.with_masked(gated.masked()))
}

/// What a reader must know, on standard error.
fn told(diagnosis: &CutDiagnosis, table: Option<&CutTable>) {
    let mut lines: Vec<String> = diagnosis.notes.clone();
    if let Some(table) = table.filter(|t| !t.ignored_columns.is_empty()) {
        lines.push(format!("columns of the table that are not used: {}", table.ignored_columns.join(", ")));
    }
    for line in lines {
        // Whoever reads standard error may have gone; the files are written all the same.
        let _ = writeln!(std::io::stderr(), "note: {line}");
    }
}

/// One line a cut: what to set, and what it tells; or why there is none.
fn print_plan(diagnosis: &CutDiagnosis) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    let likeliest = diagnosis.tried.iter().find_map(|t| t.effect);
    match (diagnosis.plan.is_empty(), diagnosis.verdict, likeliest) {
        (false, ..) => {}
        (true, Verdict::MissingPhysics, _) => {
            writeln!(out, "no cut to add: what was found is told apart from its rivals")?;
        }
        (true, Verdict::UnexplainedMismatch, _) => {
            writeln!(out, "no cut to add: what is left follows none of the effects that were asked for")?;
        }
        (true, _, Some(effect)) => {
            let name = effect.name();
            writeln!(
                out,
                "no cut to add: none near this scenario's would tell {name}, the likeliest, from none"
            )?;
        }
        (true, _, None) => writeln!(out, "no cut to add: no effect was asked for")?,
    }
    for (k, cut) in diagnosis.plan.iter().enumerate() {
        writeln!(
            out,
            "{}. {:.0} rpm, feed {:.3} mm, width {:.3} mm, {:.1} mm from the chuck, pitch difference \
             {:.4} rad, {:.0} s: {}",
            k + 1,
            cut.spindle_speed_rpm,
            1e3 * cut.feed_m_rev,
            1e3 * cut.width_m,
            1e3 * cut.tool_position_m,
            cut.pitch_difference_rad,
            cut.duration_s,
            cut.tells
        )?;
    }
    Ok(())
}

fn name(path: &Path) -> String {
    path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned())
}
