//! `stillcut campaign`: the loop closed on many random cuts, against what the stability model says.

mod hidden;

use super::bad_input;
use crate::avoidance::pitch::optimum_pitch_rad;
use crate::avoidance::{CommandKind, HoldReason, Mode};
use crate::chatter::Phase;
use crate::config::service::ServiceConfig;
use crate::plant::cut_terms::CutCondition;
use crate::plant::cutting::RawCutting;
use crate::plant::scenario::{RawScenario, Scenario};
use crate::plant::workpiece::RawWorkpiece;
use crate::recording::write_whole;
use crate::simulation::closed_loop::{ClosedLoop, LARGEST_PITCH_RAD, LoopEvent, Told};
use crate::simulation::lathe::{AXES, CARRIAGE, LatheSettings};
use crate::stability::{Root, scenario_root};
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
/// Bar, speed, depth, material and noise are drawn from the seed; the result is the same every time. The
/// controller is told diameter, projection length, width and feed as they are, and of clamp, damping and
/// material the nominal values only.
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
    /// How the pitch is chosen: by the identified two-delay model, or by eq. (6-10) alone.
    #[arg(long, default_value = "model", value_parser = ["model", "opposed"])]
    rule: String,
    /// Wider ranges: slim and stout bars, little and much damping, deep cuts, slow and fast spindles.
    #[arg(long)]
    wide: bool,
    /// Physics beyond the two-delay model that the cuts have, one of these each; comma separated, or `all`.
    #[arg(long, value_name = "EFFECTS", value_delimiter = ',')]
    conceal: Vec<String>,
    /// What the controller is told: nominal numbers without that physics, what a diagnosis of three cuts
    /// makes of these, or the truth with its numbers a little off.
    #[arg(long, default_value = "stated", value_parser = ["stated", "repaired", "truth"])]
    told: String,
    /// The pitch moves before chatter too, where the stability margin runs out.
    #[arg(long)]
    before_chatter: bool,
    /// The tools travel from near the chuck toward the free end: the cut begins silent and loses its margin.
    #[arg(long)]
    outward: bool,
    /// Folder for campaign.csv; without it only the table is printed.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Cuts whose rightmost root is nearer to zero than this are left out of the shares: noise decides there.
const MARGIN_1_S: f64 = 5.0;
/// Vibration that leaves a mark.
const MARK_M: f64 = 8e-6;
/// Where the tools enter that travel outward, over the length of the bar.
const OUTWARD_FROM: f64 = 0.45;
/// The tools enter the cut after this long in air.
const ENTRY_S: f64 = 2.0;
/// Chatter is heard late where it has left marks for so long before, s.
const LATE_S: f64 = 1.0;
/// Marks without an alarm count from here on, s: chatter grows and decays over some tenths of a second.
const GROWS_S: f64 = 0.3;
/// A cut ends stable where what is left at the end is no more than noise ever makes, m.
const STABLE_M: f64 = 10e-6;

struct Case {
    seed: u64,
    scenario: Scenario,
    /// What the controller knows of it.
    told: Scenario,
    /// Whether the diagnosis named the physics that is concealed; none was made, or nothing is concealed.
    named: Option<bool>,
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
    first_pitch_rad: Option<f64>,
    moves: u32,
    /// Of these before any alarm.
    moves_before: u32,
    hold: Option<HoldReason>,
    /// Time with vibration above what noise makes, s.
    marked_s: f64,
    /// The part of it before chatter was first heard, s.
    unheard_s: f64,
    /// The part of it after that without an alarm, s: up to `GROWS_S` at a time are its growth and decay.
    deaf_s: f64,
    /// Decisions that broke a command invariant.
    violations: u32,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    if !(1..=100_000).contains(&arguments.cuts) {
        return Err(bad_input(format!("--cuts {}: expected 1 to 100000", arguments.cuts)));
    }
    if !(arguments.duration_s.is_finite() && (8.0..=3600.0).contains(&arguments.duration_s)) {
        return Err(bad_input(format!("--duration-s {}: expected 8 to 3600", arguments.duration_s)));
    }
    let concealed = hidden::asked(&arguments.conceal).map_err(|e| bad_input(format!("--conceal: {e}")))?;
    let cases: Vec<Case> = (0..arguments.cuts as u64)
        .map(|k| draw(arguments.seed.wrapping_add(k), &arguments, &concealed))
        .collect::<anyhow::Result<_>>()
        .context("a random cut was not physical")?;
    let progress = super::progress(cases.len() as u64, "cutting");
    let (next, done) = (AtomicUsize::new(0), Mutex::new((0..cases.len()).map(|_| None).collect::<Vec<_>>()));
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, std::num::NonZero::get) {
            scope.spawn(|| {
                while let Some(case) = cases.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let index = cases.iter().position(|c| c.seed == case.seed).unwrap_or(0);
                    let outcome = cut(case, &arguments);
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
fn draw(seed: u64, arguments: &Arguments, concealed: &[hidden::Effect]) -> anyhow::Result<Case> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut between = |usual: [f64; 2], wide: [f64; 2]| {
        let [low, high] = if arguments.wide { wide } else { usual };
        random.random_range(low..high)
    };
    let raw = RawScenario {
        workpiece: RawWorkpiece {
            diameter_m: between([0.021, 0.027], [0.018, 0.032]),
            projection_length_m: between([0.150, 0.190], [0.130, 0.210]),
            damping_ratio: between([0.008, 0.018], [0.004, 0.02]),
            clamp_factor: between([0.95, 1.0], [0.93, 1.0]),
            ..RawWorkpiece::default()
        },
        cutting: RawCutting {
            radial_stiffness_pa: between([1200e6, 2800e6], [1200e6, 3000e6]),
            width_m: between([0.1e-3, 0.25e-3], [0.08e-3, 0.4e-3]),
            feed_m_rev: between([0.1e-3, 0.2e-3], [0.05e-3, 0.25e-3]),
            process_damping_n: between([30.0, 90.0], [0.0, 90.0]),
            ..RawCutting::default()
        },
        speed_rpm: between([900.0, 1800.0], [600.0, 2600.0]),
        travel_m_s: 0.0,
        ..RawScenario::default()
    };
    let noise = between([0.01, 0.05], [0.01, 0.08]);
    let feed_m_s = raw.cutting.feed_m_rev * raw.speed_rpm / 60.0;
    // One pitch for the whole way of the tools.
    let length_m = raw.workpiece.projection_length_m;
    let cutting_s = arguments.duration_s - ENTRY_S;
    let (begin_m, most_m) = if arguments.outward {
        (OUTWARD_FROM * length_m, (1.0 - OUTWARD_FROM) * length_m)
    } else {
        (length_m, -0.9 * length_m)
    };
    let way_m = (feed_m_s * cutting_s).min(most_m.abs()).copysign(most_m);
    let (position_m, travel_m_s) = (Some(begin_m), way_m / cutting_s);
    let mut scenario = Scenario::new(&RawScenario { travel_m_s, position_m, ..raw })?;
    if !concealed.is_empty() {
        let effect = concealed[random.random_range(0..concealed.len())];
        scenario.physics = hidden::drawn(effect, &scenario, &mut random)?;
    }
    let stated = stated(&scenario)?;
    let (told, named) = match arguments.told.as_str() {
        "truth" => (hidden::nearly_true(&scenario, &mut random)?, None),
        "repaired" => {
            let (told, found) = hidden::diagnosed((&scenario, &stated), noise, seed)?;
            let concealed = scenario.physics.iter().next().map(|term| term.kind());
            (told, concealed.map(|effect| found.contains(&effect)))
        }
        _ => (stated, None),
    };
    let at = |pitch_difference_rad: f64, share: f64| {
        let position_m = begin_m + share * way_m;
        scenario_root(
            &scenario,
            &CutCondition { pitch_difference_rad, position_m, ..CutCondition::of(&scenario) },
        )
    };
    // Where a bar bends most it chatters first.
    let equal = at(0.0, if arguments.outward { 1.0 } else { 0.0 });
    let growth = |pitch: f64, share: f64| at(pitch, share).growth_1_s;
    let worst = |pitch: f64| {
        [0.0, 0.5, 1.0].map(|share| growth(pitch, share)).into_iter().fold(f64::NEG_INFINITY, f64::max)
    };
    let pitches = (0..=150).map(|k| LARGEST_PITCH_RAD * f64::from(k) / 150.0);
    let best_growth_1_s = pitches.map(worst).fold(f64::INFINITY, f64::min);
    Ok(Case { seed, scenario, told, named, noise, equal, best_growth_1_s })
}

/// Bar and cut as an operator states them: lengths as they are, the rest nominal.
fn stated(scenario: &Scenario) -> Result<Scenario, crate::plant::scenario_error::ScenarioError> {
    let (bar, cut) = (scenario.workpiece.raw(), scenario.cutting.raw());
    Scenario::new(&RawScenario {
        workpiece: RawWorkpiece {
            diameter_m: bar.diameter_m,
            projection_length_m: bar.projection_length_m,
            ..RawWorkpiece::default()
        },
        cutting: RawCutting { width_m: cut.width_m, feed_m_rev: cut.feed_m_rev, ..RawCutting::default() },
        speed_rpm: scenario.spindle.rpm(),
        ..RawScenario::default()
    })
}

fn cut(case: &Case, arguments: &Arguments) -> anyhow::Result<Outcome> {
    let duration_s = arguments.duration_s;
    let lathe =
        LatheSettings { force_noise_ratio: case.noise, ..LatheSettings::realistic(case.scenario, case.seed) };
    let told = case.told;
    let tools = Some((CARRIAGE.to_owned(), 0.0, false));
    let config = ServiceConfig { cut: told, tools, ..ServiceConfig::default() };
    let names: Vec<String> = AXES.into_iter().chain([CARRIAGE]).map(str::to_owned).collect();
    let settings = config.pipeline_settings(SampleRate::new(lathe.sample_rate_hz)?, &names);
    let stated = (arguments.rule == "model").then_some(told);
    let mut cut = ClosedLoop::with_stated(
        lathe,
        settings,
        Told { mode: Mode::Act, stated, before_chatter: arguments.before_chatter },
    )?;
    let mut outcome = Outcome::default();
    let (mut rest_m, mut envelope_m, mut silent_s) = (0.0, 0.0f64, 0.0);
    let period_s = 1.0 / cut.lathe().settings().sample_rate_hz;
    while cut.lathe().truth().t_s < duration_s {
        let event = cut.step();
        let truth = cut.lathe().truth();
        // Rest follows within 5 ms: what is left is vibration in the band.
        rest_m += (truth.workpiece_displacement_m - rest_m) * 0.02;
        let vibration_m = (truth.workpiece_displacement_m - rest_m).abs();
        outcome.loudest_m = outcome.loudest_m.max(vibration_m);
        envelope_m = vibration_m.max(envelope_m * 0.998);
        let silent = envelope_m > MARK_M && cut.pipeline().agreement().phase != Phase::Chatter;
        silent_s = if silent { silent_s + period_s } else { 0.0 };
        if silent_s > GROWS_S && outcome.onsets > 0 {
            outcome.deaf_s += period_s;
        }
        if envelope_m > MARK_M {
            outcome.marked_s += period_s;
            if outcome.onsets == 0 {
                outcome.unheard_s += period_s;
            }
        }
        if truth.t_s > duration_s - 2.0 {
            outcome.last_m = outcome.last_m.max(vibration_m);
        }
        match event {
            Some(LoopEvent::Onset(_)) => {
                outcome.onsets += 1;
                outcome.first_onset_s.get_or_insert(truth.t_s);
            }
            Some(LoopEvent::Sent(command)) => {
                outcome.commands += 1;
                if command.kind == CommandKind::Move {
                    outcome.moves += 1;
                    outcome.moves_before += u32::from(outcome.onsets == 0);
                    outcome.first_pitch_rad.get_or_insert(command.requested_pitch_rad);
                }
            }
            Some(LoopEvent::Refused) => outcome.refused += 1,
            Some(LoopEvent::End) | None => {}
        }
    }
    (outcome.hold, outcome.violations) = (cut.hold(), cut.violations());
    Ok(outcome)
}

/// No chatter is left at the end.
fn ends_stable(outcome: &Outcome) -> bool {
    outcome.last_m < STABLE_M
}

fn table(cases: &[Case], outcomes: &[Outcome]) -> String {
    let mut text = String::from(
        "seed,natural_hz,speed_rpm,width_m,noise,equal_growth_1_s,equal_hz,best_growth_1_s,eq_6_10_rad,\
         onsets,first_onset_s,commands,moves,moves_before,\
         first_pitch_rad,refused,loudest_m,last_m,marked_s,deaf_s,\
         last_hold,ends_stable\n",
    );
    for (c, o) in cases.iter().zip(outcomes) {
        let pitch = optimum_pitch_rad(c.scenario.spindle, c.equal.frequency_hz, 0).unwrap_or(0.0);
        text += &format!(
            "{},{:.2},{:.1},{:.6},{:.3},{:.2},{:.2},{:.2},{:.5},{},{:.3},{},{},{},{:.5},{},\
             {:.3e},{:.3e},{:.3},{:.3},{},{}\n",
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
            o.moves,
            o.moves_before,
            o.first_pitch_rad.unwrap_or(f64::NAN),
            o.refused,
            o.loudest_m,
            o.last_m,
            o.marked_s,
            o.deaf_s,
            o.hold.map_or("", HoldReason::name),
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
    let late = unstable().filter(|(_, o)| o.onsets > 0 && o.unheard_s > LATE_S);
    writeln!(out, "  heard after {LATE_S:.0} s of marks           {}", late.count())?;
    let mut marked: Vec<f64> = curable().map(|(_, o)| o.marked_s).collect();
    marked.sort_by(f64::total_cmp);
    let median = marked.get(marked.len() / 2).copied().unwrap_or(0.0);
    writeln!(out, "  time above {:.0} um, median of these    {median:.2} s", MARK_M * 1e6)?;
    let moves: u32 = curable().map(|(_, o)| o.moves).sum();
    let each = f64::from(moves) / curable().count().max(1) as f64;
    writeln!(out, "  moves of the pitch, mean of these    {each:.1}")?;
    let judged: Vec<bool> = cases.iter().filter_map(|c| c.named).collect();
    if !judged.is_empty() {
        let right = judged.iter().filter(|named| **named).count();
        writeln!(out, "  concealed physics named, of all      {right} of {}", judged.len())?;
    }
    let moved = outcomes.iter().filter(|o| o.moves_before > 0).count();
    writeln!(out, "  pitch moved before any alarm, of all {moved}")?;
    let deaf: f64 = unstable().map(|(_, o)| o.deaf_s).sum();
    let cuts = unstable().filter(|(_, o)| o.deaf_s > LATE_S).count();
    writeln!(out, "  marks without an alarm, heard before {deaf:.1} s, over {LATE_S:.0} s in {cuts}")?;
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
    writeln!(
        out,
        "decisions that broke an invariant      {}",
        outcomes.iter().map(|o| o.violations).sum::<u32>()
    )?;
    Ok(())
}

fn share(part: usize, of: usize) -> f64 {
    100.0 * part as f64 / of.max(1) as f64
}
