//! `stillcut resolution`.

use super::bad_input;
use crate::config::machine::read_machine;
use crate::force::balance::Method;
use crate::force::budget::{Budget, Imperfection};
use crate::identify::resolution::{
    EncoderSteps, ForceVariance, MonteCarlo, force_variance, monte_carlo_variance,
};
use crate::plant::drive::{DriveParams, Structure};
use crate::plant::machine::AxisModel;
use crate::recording::write_whole;
use crate::report::force_plots::{Curve, Panel, panels_svg};
use crate::units::SampleRate;
use anyhow::Context as _;
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
    /// Adds the error of each observer for wrong mass, stiffness, delays and encoder steps.
    #[arg(long)]
    budget: bool,
    /// One JSON object instead of a table.
    #[arg(long)]
    json: bool,
}

struct Row {
    axis: String,
    lyapunov: ForceVariance,
    tried: ForceVariance,
}

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
    let text = if arguments.json { json(&rows)? } else { table(&rows, rate) };
    let budget = if arguments.budget { budgets(&machine.axes)? } else { (String::new(), Vec::new()) };
    if let Some(out) = &arguments.out {
        let mut panels = Vec::new();
        for axis in &machine.axes {
            panels.extend(step_panels(axis, &arguments.cutoff_hz, rate)?);
        }
        panels.extend(budget.1);
        write_whole(out, panels_svg(&panels)?.as_bytes()).context("writing the picture")?;
    }
    let mut stdout = std::io::stdout();
    write!(stdout, "{text}")?;
    if !arguments.json {
        write!(stdout, "{}", budget.0)?;
    }
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
    let settings = MonteCarlo { rate, samples: 200_000, seed: 1 };
    let tried = monte_carlo_variance(&axis.drive, steps, cutoff_hz, settings).map_err(bad_input)?;
    Ok(Row { axis: axis.name.clone(), lyapunov, tried })
}

fn table(rows: &[Row], rate: SampleRate) -> String {
    let mut text = String::new();
    let _ =
        writeln!(text, "force variance by encoder steps at {} Hz sampling, second-order low-pass", rate.hz());
    let _ = writeln!(
        text,
        "{:6} {:>9} {:>13} {:>13} {:>12} {:>14}",
        "axis", "cutoff_hz", "motor_n2", "stage_n2", "deviation_n", "tried_n"
    );
    for row in rows {
        let v = row.lyapunov;
        let _ = writeln!(
            text,
            "{:6} {:9} {:13.5e} {:13.5e} {:12.5} {:14.5}",
            row.axis,
            v.cutoff_hz,
            v.motor_n2,
            v.stage_n2,
            v.deviation_n(),
            row.tried.deviation_n()
        );
    }
    text
}

fn json(rows: &[Row]) -> anyhow::Result<String> {
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
            })
        })
        .collect();
    Ok(serde_json::to_string(&serde_json::json!({ "rows": list }))? + "\n")
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

const BUDGET_HZ: [f64; 9] = [1.0, 10.0, 50.0, 100.0, 200.0, 300.0, 500.0, 700.0, 1000.0];

/// Error in percent of the force for one thing wrong at a time, for each observer of the axis.
fn budgets(axes: &[AxisModel]) -> anyhow::Result<(String, Vec<Panel>)> {
    let mut text = String::new();
    let mut panels = Vec::new();
    for axis in axes {
        let methods: &[Method] = if axis.drive.structure() == Structure::Rigid {
            &[Method::Dob]
        } else {
            &[Method::Dob, Method::Medob, Method::VibrationMode]
        };
        for method in methods {
            let (part, panel) = budget(axis, *method)?;
            text.push_str(&part);
            panels.push(panel);
        }
    }
    Ok((text, panels))
}

fn budget(axis: &AxisModel, method: Method) -> anyhow::Result<(String, Panel)> {
    let right = Imperfection::default();
    let late_s = (axis.drive.amplifier_dead_time_s() + axis.drive.motor_encoder_delay_s()).max(1e-4);
    let cases = [
        ("nothing wrong", right),
        ("mass +5 %", Imperfection { mass_factor: 1.05, ..right }),
        ("stiffness +5 %", Imperfection { stiffness_factor: 1.05, ..right }),
        ("both late", Imperfection { motor_late_s: late_s, stage_late_s: late_s, ..right }),
        ("stage late 10 us", Imperfection { stage_late_s: 1e-5, ..right }),
    ];
    let mut text = String::new();
    let _ = writeln!(
        text,
        "\naxis {}, {}: error in % of the force (both late: {:.3} ms)",
        axis.name,
        method.name(),
        1e3 * late_s
    );
    let _ = write!(text, "{:18}", "hz");
    for f in BUDGET_HZ {
        let _ = write!(text, "{f:>9}");
    }
    let mut curves = Vec::new();
    let steps = steps_of(&axis.drive);
    for (name, imperfection) in cases {
        let budget = Budget::new(method, &axis.drive, imperfection).map_err(bad_input)?;
        let _ = write!(text, "\n{name:18}");
        for f in BUDGET_HZ {
            let _ = write!(text, "{:9.2}", 100.0 * budget.relative_error(f));
        }
        let points = (0..=120)
            .map(|k| 10f64.powf(f64::from(k) / 40.0))
            .map(|f| (f, 100.0 * budget.relative_error(f).max(1e-6)));
        curves.push(Curve { label: name.to_owned(), points: points.collect(), dots: false });
    }
    let exact = Budget::new(method, &axis.drive, right).map_err(bad_input)?;
    let _ = write!(text, "\n{:18}", "encoder step, N");
    for f in BUDGET_HZ {
        let _ = write!(text, "{:9.3}", exact.step_error_n(f, steps.motor_m, steps.stage_m));
    }
    text.push('\n');
    let panel = Panel {
        title: format!("axis {}, {}: error of the estimate", axis.name, method.name()),
        x_label: "Hz".to_owned(),
        y_label: "% of the force".to_owned(),
        log_y: true,
        curves,
    };
    Ok((text, panel))
}
