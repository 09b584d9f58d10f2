//! `stillcut resolution`.

use super::bad_input;
use super::budget::{BudgetTable, budget_tables};
use crate::config::machine::read_machine;
use crate::identify::resolution::{
    EncoderSteps, ForceVariance, MonteCarlo, force_variance, monte_carlo_variance,
};
use crate::plant::drive::DriveParams;
use crate::plant::machine::AxisModel;
use crate::recording::write_whole;
use crate::report::force_plots::{Curve, Panel, panels_svg};
use crate::units::SampleRate;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::PathBuf;

/// Force variance caused by encoder quantization, and error budgets of the observers.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Machine model.
    #[arg(long)]
    model: PathBuf,
    /// Cutoffs of the observer's low-pass.
    #[arg(long, value_delimiter = ',', required = true)]
    cutoff_hz: Vec<f64>,
    /// Rate of the estimation; the model's when not given.
    #[arg(long)]
    rate_hz: Option<f64>,
    /// Picture of variance over encoder step (SVG).
    #[arg(long)]
    out: Option<PathBuf>,
    /// Adds the error of each observer for wrong masses, stiffness, delays and encoder steps, and what its
    /// estimate is made of.
    #[arg(long)]
    budget: bool,
    /// The axis' control cancels disturbances behind a low-pass of this cutoff (with --budget).
    #[arg(long, requires = "budget")]
    loop_disturbance_cutoff_rad_s: Option<f64>,
    /// One JSON object instead of a table.
    #[arg(long)]
    json: bool,
}

struct Row {
    axis: String,
    lyapunov: ForceVariance,
    tried: ForceVariance,
    /// Tried at a feed below a step a sample, where the error is not white.
    slow: ForceVariance,
}

/// Feed of the slow try, steps a sample.
const SLOW_STEPS: f64 = 0.13;

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    let machine = read_machine(&arguments.model).map_err(bad_input)?;
    let rate = match arguments.rate_hz {
        Some(hz) => SampleRate::new(hz).map_err(|e| bad_input(format!("--rate-hz: {e}")))?,
        None => machine.sample_rate,
    };
    let mut rows = Vec::new();
    for axis in &machine.axes {
        for cutoff_hz in &arguments.cutoff_hz {
            rows.push(row(axis, *cutoff_hz, rate)?);
        }
    }
    let budgets = if arguments.budget {
        let cutoff = arguments.loop_disturbance_cutoff_rad_s;
        if let Some(g) = cutoff.filter(|g| !(g.is_finite() && *g > 0.0)) {
            return Err(bad_input(format!("--loop-disturbance-cutoff-rad-s {g}: expected above 0")));
        }
        budget_tables(&machine.axes, rate, cutoff).map_err(bad_input)?
    } else {
        Vec::new()
    };
    let mut text = if arguments.json { json(&rows, &budgets)? } else { table(&rows, rate) };
    if !arguments.json {
        budgets.iter().for_each(|t| text.push_str(&t.text()));
    }
    if let Some(out) = &arguments.out {
        let mut panels = Vec::new();
        for axis in &machine.axes {
            panels.extend(step_panels(axis, &arguments.cutoff_hz, rate)?);
        }
        panels.extend(budgets.iter().map(BudgetTable::panel));
        write_whole(out, panels_svg(&panels)?.as_bytes()).map_err(bad_input)?;
    }
    write!(std::io::stdout(), "{text}")?;
    Ok(())
}

fn steps_of(drive: &DriveParams) -> EncoderSteps {
    EncoderSteps { motor_m: drive.motor_encoder_resolution_m(), stage_m: drive.stage_encoder_resolution_m() }
}

fn row(axis: &AxisModel, cutoff_hz: f64, rate: SampleRate) -> anyhow::Result<Row> {
    let steps = steps_of(&axis.drive);
    if steps.motor_m == 0.0 && steps.stage_m == 0.0 {
        return Err(bad_input(format!(
            "axis {}: neither motor_encoder_resolution_m nor stage_encoder_resolution_m is stated",
            axis.name
        )));
    }
    let lyapunov = force_variance(&axis.drive, steps, cutoff_hz, rate).map_err(bad_input)?;
    let settings = MonteCarlo { rate, samples: 200_000, seed: 1, feed_steps: None };
    let tried = monte_carlo_variance(&axis.drive, steps, cutoff_hz, settings).map_err(bad_input)?;
    let settings = MonteCarlo { feed_steps: Some(SLOW_STEPS), ..settings };
    let slow = monte_carlo_variance(&axis.drive, steps, cutoff_hz, settings).map_err(bad_input)?;
    Ok(Row { axis: axis.name.clone(), lyapunov, tried, slow })
}

fn table(rows: &[Row], rate: SampleRate) -> String {
    let mut text = String::new();
    let _ =
        writeln!(text, "force variance by encoder steps at {} Hz sampling, second-order low-pass", rate.hz());
    let _ = writeln!(
        text,
        "{:6} {:>9} {:>13} {:>13} {:>12} {:>14} {:>14}",
        "axis", "cutoff_hz", "motor_n2", "stage_n2", "deviation_n", "tried_n", "slow_feed_n"
    );
    for row in rows {
        let v = row.lyapunov;
        let _ = writeln!(
            text,
            "{:6} {:9} {:13.5e} {:13.5e} {:12.5} {:14.5} {:14.5}",
            row.axis,
            v.cutoff_hz,
            v.motor_n2,
            v.stage_n2,
            v.deviation_n(),
            row.tried.deviation_n(),
            row.slow.deviation_n()
        );
    }
    text
}

fn json(rows: &[Row], budgets: &[BudgetTable]) -> anyhow::Result<String> {
    let list: Vec<serde_json::Value> = rows
        .iter()
        .map(|r| {
            serde_json::json!({
                "axis": r.axis,
                "cutoff_hz": r.lyapunov.cutoff_hz,
                "motor_variance_n2": r.lyapunov.motor_n2,
                "stage_variance_n2": r.lyapunov.stage_n2,
                "deviation_n": r.lyapunov.deviation_n(),
                "monte_carlo_deviation_n": r.tried.deviation_n(),
                "slow_feed_deviation_n": r.slow.deviation_n(),
            })
        })
        .collect();
    let mut whole = serde_json::json!({ "rows": list });
    if !budgets.is_empty() {
        whole["budgets"] = budgets.iter().map(BudgetTable::json).collect();
    }
    Ok(serde_json::to_string(&whole)? + "\n")
}

/// Variance over the step of each encoder, the other one perfect (figure 5 of Hayashi et al.).
fn step_panels(axis: &AxisModel, cutoffs_hz: &[f64], rate: SampleRate) -> anyhow::Result<Vec<Panel>> {
    let mut panels = Vec::new();
    for motor in [true, false] {
        let mut curves = Vec::new();
        for cutoff_hz in cutoffs_hz {
            let mut points = Vec::new();
            for k in 0..=40 {
                let step_m = 1e-10 * 10f64.powf(f64::from(k) / 8.0);
                let (motor_m, stage_m) = if motor { (step_m, 0.0) } else { (0.0, step_m) };
                let v = force_variance(&axis.drive, EncoderSteps { motor_m, stage_m }, *cutoff_hz, rate);
                let v = v.map_err(bad_input)?;
                points.push((step_m * 1e9, v.motor_n2 + v.stage_n2));
            }
            curves.push(Curve { label: format!("{cutoff_hz} Hz"), points, dots: false });
        }
        let which = if motor { "rotary encoder" } else { "linear scale" };
        panels.push(Panel {
            title: format!("axis {}: force variance over the step of the {which}", axis.name),
            x_label: "step as travel, nm".to_owned(),
            y_label: "N2".to_owned(),
            log_y: true,
            curves,
        });
    }
    Ok(panels)
}
