//! `stillcut campaign`: the loop closed on many random cuts, against what the stability model says.

use super::bad_input;
use crate::avoidance::Mode;
use crate::avoidance::pitch::optimum_pitch_rad;
use crate::config::service::ServiceConfig;
use crate::plant::cutting::{RawCutting, TwoDelay};
use crate::plant::scenario::{RawScenario, Scenario};
use crate::plant::workpiece::RawWorkpiece;
use crate::recording::write_whole;
use crate::simulation::closed_loop::{ClosedLoop, LoopEvent};
use crate::simulation::lathe::{AXES, LatheSettings};
use crate::stability::{Root, rightmost_root};
use crate::units::SampleRate;
use anyhow::Context as _;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::io::Write as _;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Closes the loop on random cuts: how many that chatter end stable, against what the model says can.
///
/// Bar, speed, depth, material and noise are drawn from the seed; the result is the same every time.
#[derive(clap::Args)]
#[command(after_help = "Example: stillcut campaign --cuts 200 --out out/campaign")]
pub(super) struct Arguments {
    /// Number of cuts.
    #[arg(long, default_value_t = 200)]
    cuts: usize,
    /// First seed.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Machine time of each cut, s.
    #[arg(long, value_name = "SECONDS", default_value_t = 14.0)]
    duration_s: f64,
    /// Folder for campaign.csv; without it only the table is printed.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Cuts whose rightmost root is nearer to zero than this are left out of the shares: noise decides there.
const MARGIN_1_S: f64 = 5.0;
/// Pitches tried for "can be made stable", up to this.
const LARGEST_PITCH_RAD: f64 = 0.15;

struct Case {
    seed: u64,
    scenario: Scenario,
    noise: f64,
    equal: Root,
    best_growth_1_s: f64,
}

#[derive(Debug, Clone, Copy, Default)]
struct Outcome {
    onsets: u32,
    commands: u32,
    refused: u32,
    first_onset_s: Option<f64>,
    loudest_m: f64,
    last_m: f64,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    if !(1..=100_000).contains(&arguments.cuts) {
        return Err(bad_input(format!("--cuts {}: expected 1 to 100000", arguments.cuts)));
    }
    if !(arguments.duration_s.is_finite() && (8.0..=3600.0).contains(&arguments.duration_s)) {
        return Err(bad_input(format!("--duration-s {}: expected 8 to 3600", arguments.duration_s)));
    }
    let cases: Vec<Case> = (0..arguments.cuts as u64)
        .map(|k| draw(arguments.seed.wrapping_add(k)))
        .collect::<Result<_, _>>()
        .context("a random cut was not physical")?;
    let progress = super::progress(cases.len() as u64, "cutting");
    let (next, done) = (AtomicUsize::new(0), Mutex::new((0..cases.len()).map(|_| None).collect::<Vec<_>>()));
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, std::num::NonZero::get) {
            scope.spawn(|| {
                while let Some(case) = cases.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let index = cases.iter().position(|c| c.seed == case.seed).unwrap_or(0);
                    let outcome = cut(case, arguments.duration_s);
                    if let Ok(mut all) = done.lock() {
                        all[index] = Some(outcome);
                    }
                    progress.inc(1);
                }
            });
        }
    });
    progress.finish_and_clear();
    let outcomes: Vec<Outcome> = done
        .into_inner()
        .map_err(|_| anyhow::anyhow!("a worker panicked"))?
        .into_iter()
        .map(|o| o.context("a cut was not run")?)
        .collect::<anyhow::Result<_>>()?;
    if let Some(folder) = &arguments.out {
        std::fs::create_dir_all(folder).map_err(|e| bad_input(format!("{}: {e}", folder.display())))?;
        write_whole(&folder.join("campaign.csv"), table(&cases, &outcomes).as_bytes()).map_err(bad_input)?;
    }
    print(&cases, &outcomes)
}

/// One random cut. Errors: never for the ranges below; the types want it checked.
fn draw(seed: u64) -> Result<Case, crate::plant::workpiece::ScenarioError> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut between = |low: f64, high: f64| random.random_range(low..high);
    let raw = RawScenario {
        workpiece: RawWorkpiece {
            diameter_m: between(0.021, 0.027),
            projection_length_m: between(0.150, 0.190),
            damping_ratio: between(0.008, 0.018),
            clamp_factor: between(0.95, 1.0),
            ..RawWorkpiece::default()
        },
        cutting: RawCutting {
            radial_stiffness_pa: between(1200e6, 2800e6),
            width_m: between(0.1e-3, 0.25e-3),
            feed_m_rev: between(0.1e-3, 0.2e-3),
            process_damping_n: between(30.0, 90.0),
        },
        speed_rpm: between(900.0, 1800.0),
        travel_m_s: 0.0,
        ..RawScenario::default()
    };
    let noise = between(0.01, 0.05);
    let feed_m_s = raw.cutting.feed_m_rev * raw.speed_rpm / 60.0;
    let scenario = Scenario::new(&RawScenario { travel_m_s: -feed_m_s, ..raw })?;
    let equal = rightmost_root(&TwoDelay::from_scenario(&scenario));
    let growth = |pitch: f64| {
        let at = RawScenario { pitch_difference_rad: pitch, ..scenario.raw() };
        Scenario::new(&at).map_or(f64::INFINITY, |s| rightmost_root(&TwoDelay::from_scenario(&s)).growth_1_s)
    };
    let pitches = (0..=150).map(|k| LARGEST_PITCH_RAD * f64::from(k) / 150.0);
    let best_growth_1_s = pitches.map(growth).fold(f64::INFINITY, f64::min);
    Ok(Case { seed, scenario, noise, equal, best_growth_1_s })
}

fn cut(case: &Case, duration_s: f64) -> anyhow::Result<Outcome> {
    let lathe =
        LatheSettings { force_noise_ratio: case.noise, ..LatheSettings::realistic(case.scenario, case.seed) };
    let config = ServiceConfig {
        workpiece: case.scenario.workpiece,
        cutting: case.scenario.cutting,
        ..ServiceConfig::default()
    };
    let names = AXES.map(str::to_owned);
    let settings = config.pipeline_settings(SampleRate::new(lathe.sample_rate_hz)?, &names);
    let mut cut = ClosedLoop::new(lathe, settings, Mode::Act)?;
    let mut outcome = Outcome::default();
    let mut rest_m = 0.0;
    while cut.lathe().truth().t_s < duration_s {
        let event = cut.step();
        let truth = cut.lathe().truth();
        // Rest follows within 5 ms: what is left is vibration in the band.
        rest_m += (truth.workpiece_displacement_m - rest_m) * 0.02;
        let vibration_m = (truth.workpiece_displacement_m - rest_m).abs();
        outcome.loudest_m = outcome.loudest_m.max(vibration_m);
        if truth.t_s > duration_s - 2.0 {
            outcome.last_m = outcome.last_m.max(vibration_m);
        }
        match event {
            Some(LoopEvent::Onset(_)) => {
                outcome.onsets += 1;
                outcome.first_onset_s.get_or_insert(truth.t_s);
            }
            Some(LoopEvent::Sent(_)) => outcome.commands += 1,
            Some(LoopEvent::Refused) => outcome.refused += 1,
            Some(LoopEvent::End) | None => {}
        }
    }
    Ok(outcome)
}

/// Chatter left at the end: a quarter of the loudest and more than noise ever makes.
fn ends_stable(outcome: &Outcome) -> bool {
    outcome.last_m < 5e-6 || outcome.last_m < 0.15 * outcome.loudest_m
}

fn table(cases: &[Case], outcomes: &[Outcome]) -> String {
    let mut text = String::from(
        "seed,natural_hz,speed_rpm,width_m,noise,equal_growth_1_s,equal_hz,best_growth_1_s,eq_6_10_rad,\
         onsets,first_onset_s,commands,refused,loudest_m,last_m,ends_stable\n",
    );
    for (c, o) in cases.iter().zip(outcomes) {
        let pitch = optimum_pitch_rad(c.scenario.spindle, c.equal.frequency_hz, 0).unwrap_or(0.0);
        text += &format!(
            "{},{:.2},{:.1},{:.6},{:.3},{:.2},{:.2},{:.2},{:.5},{},{:.3},{},{},{:.3e},{:.3e},{}\n",
            c.seed,
            c.scenario.workpiece.bending_frequency_hz(),
            c.scenario.spindle.rpm(),
            c.scenario.cutting.raw().width_m,
            c.noise,
            c.equal.growth_1_s,
            c.equal.frequency_hz,
            c.best_growth_1_s,
            pitch,
            o.onsets,
            o.first_onset_s.unwrap_or(f64::NAN),
            o.commands,
            o.refused,
            o.loudest_m,
            o.last_m,
            ends_stable(o),
        );
    }
    text
}

fn print(cases: &[Case], outcomes: &[Outcome]) -> anyhow::Result<()> {
    let pairs = || cases.iter().zip(outcomes);
    let unstable = || pairs().filter(|(c, _)| c.equal.growth_1_s > MARGIN_1_S);
    let curable = || unstable().filter(|(c, _)| c.best_growth_1_s < -MARGIN_1_S);
    let stable = || pairs().filter(|(c, _)| c.equal.growth_1_s < -MARGIN_1_S);
    let cured = curable().filter(|(_, o)| ends_stable(o)).count();
    let worst = curable().map(|(_, o)| o.loudest_m).fold(0.0, f64::max);
    let mut out = std::io::stdout().lock();
    writeln!(out, "cuts                                   {}", cases.len())?;
    writeln!(out, "unstable at equal pitch (model)        {}", unstable().count())?;
    writeln!(out, "  of these a pitch can stabilise       {}", curable().count())?;
    writeln!(out, "    ended stable                       {cured}")?;
    writeln!(out, "    share                              {:.1} %", share(cured, curable().count()))?;
    let all = unstable().filter(|(_, o)| ends_stable(o)).count();
    writeln!(out, "  ended stable, of all unstable        {:.1} %", share(all, unstable().count()))?;
    writeln!(
        out,
        "  chatter not heard                    {}",
        unstable().filter(|(_, o)| o.onsets == 0).count()
    )?;
    writeln!(out, "  worst vibration before it was cured  {:.1} um", worst * 1e6)?;
    writeln!(out, "stable at equal pitch (model)          {}", stable().count())?;
    writeln!(out, "  alarms in them                       {}", stable().map(|(_, o)| o.onsets).sum::<u32>())?;
    writeln!(
        out,
        "commands sent                          {}",
        outcomes.iter().map(|o| o.commands).sum::<u32>()
    )?;
    writeln!(
        out,
        "commands refused by the last guard     {}",
        outcomes.iter().map(|o| o.refused).sum::<u32>()
    )?;
    Ok(())
}

fn share(part: usize, of: usize) -> f64 {
    100.0 * part as f64 / of.max(1) as f64
}
