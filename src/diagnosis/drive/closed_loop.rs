//! The proof in simulation: model and machine given the same command, each in its own closed loop.
//!
//! No mechanics is fitted here. Before physics comes the control law, stated or read from the recordings:
//! where it does not say the recorded reference, no simulation proves anything.

use super::recorded::{position, stage_position, thrust};
use super::signals::{Signals, Track};
use super::state::State;
use crate::diagnosis::criteria::Criteria;
use crate::diagnosis::result::{ClosedLoop, SimulatedTrial};
use crate::diagnosis::two_cores::on_two_cores;
use crate::plant::machine::{AxisModel, Controller};
use crate::sample::Recording;
use crate::signal::inner_products::rms;
use crate::simulation::model_axis::{
    LoopRecord, Replay, Trial, not_simulated, read_controller, replay, respond,
};

/// First samples that the velocity at the start is taken from.
const START_SAMPLES: usize = 20;

/// Runs stated, re-estimated and found model beside the machine. Errors: in a person's words why not.
pub(super) fn closed_loop(
    signals: &Signals,
    axes: &[AxisModel; 3],
    recordings: &[Recording],
    state: &State,
) -> Result<ClosedLoop, String> {
    let stated = &axes[0];
    let records: Vec<LoopRecord> =
        recordings.iter().map(|r| record(stated, r)).collect::<Result<Vec<_>, String>>()?;
    let period_s = 1.0 / signals.rate_hz;
    let law = match stated.controller {
        Some(controller) => law_of(controller, period_s, &records)?,
        None => read_law((signals, &axes[2]), period_s, &records)?,
    };
    let places: Vec<usize> = (0..records.len()).collect();
    let trials = on_two_cores(&places, |&k| {
        let trial = trial((k, &records[k], &law), stated, &signals.tracks[k], (period_s, state.now.timing_s));
        simulated(signals, axes, (k, &records[k], &trial), law.share[k] > Criteria::STANDARD.law_share)
    });
    let law_share = law.least_share();
    let read = stated.controller.is_none().then_some(law.law.controller);
    if read.is_some() && trials.iter().any(|t| !t.thrust_rms_n[2].is_finite()) {
        return Err(
            "the model states no controller, and with the control law that was read from the recordings \
                    the model that was found runs away"
                .to_owned(),
        );
    }
    Ok(ClosedLoop { law_share, read, trials, not_simulated: not_simulated(&axes[2]) })
}

/// The law that the recordings tell where the model states none.
fn read_law(
    (signals, found): (&Signals, &AxisModel),
    period_s: f64,
    records: &[LoopRecord],
) -> Result<Replay, String> {
    let per_unit = signals.tracks.first().map_or(1.0, |t| t.reference.per_unit);
    let read = read_controller((found.drive.total_mass_kg(), per_unit), period_s, records);
    let law = read.and_then(|controller| replay(controller, period_s, records));
    law.filter(|law| law.least_share() < Criteria::STANDARD.law_share).ok_or_else(|| {
        "the model states no controller, and in the first 40 000 rows the recorded reference follows no law \
         of a position gain, a velocity gain and an integral from the command and the positions as recorded"
            .to_owned()
    })
}

fn record(axis: &AxisModel, recording: &Recording) -> Result<LoopRecord, String> {
    let name = format!("{}_position_cmd_m", axis.name);
    let command_m = recording.get(&name).map(<[f64]>::to_vec).ok_or_else(|| {
        format!("recording {}: column {name} is missing, so the loop has no command", recording.experiment)
    })?;
    let motor_m = position(axis, recording).map_err(|e| e.to_string())?;
    let reference = thrust(axis, recording).map_err(|e| e.to_string())?;
    let stage_m = stage_position(axis, recording).map_or_else(|| motor_m.clone(), <[f64]>::to_vec);
    let unit = reference.per_unit;
    Ok(LoopRecord {
        command_m,
        motor_m,
        stage_m,
        reference: reference.reference_n.iter().map(|f| f / unit).collect(),
    })
}

/// The law that acted, or why the stated one did not.
fn law_of(controller: Controller, period_s: f64, records: &[LoopRecord]) -> Result<Replay, String> {
    let replay = replay(controller, period_s, records).ok_or("no recording has a reference that changes")?;
    let best = replay.least_share();
    if best > Criteria::STANDARD.law_share {
        return Err(format!(
            "the stated control law leaves {:.0} % of the recorded reference unsaid: gains, filter, order of \
             samples or a further feed-forward differ",
            100.0 * best
        ));
    }
    Ok(replay)
}

/// What acted in one recording.
fn trial(
    (k, s, law): (usize, &LoopRecord, &Replay),
    stated: &AxisModel,
    track: &Track,
    (period_s, timing_s): (f64, f64),
) -> Trial {
    let injected = law.share[k] > Criteria::STANDARD.law_share;
    let early = s.motor_m.get(START_SAMPLES).zip(s.motor_m.first());
    Trial {
        period_s,
        command_m: s.command_m.clone(),
        injected: if injected { law.beyond[k].clone() } else { Vec::new() },
        start_m: [s.motor_m[0], s.stage_m[0]],
        start_m_s: early.map_or(0.0, |(b, a)| (b - a) / (START_SAMPLES as f64 * period_s)),
        law: law.law,
        integral_m: law.integral_m[k],
        taken_up_s: timing_s,
        thrust_per_unit: stated.drive.thrust_constant_n_a().is_none().then_some(track.reference.per_unit),
    }
}

/// One recording beside its models.
fn simulated(
    signals: &Signals,
    axes: &[AxisModel; 3],
    (k, s, trial): (usize, &LoopRecord, &Trial),
    injected: bool,
) -> SimulatedTrial {
    let track = &signals.tracks[k];
    let responses = respond(axes, trial);
    let unit = track.reference.per_unit;
    let off = |a: &[f64], b: &[f64], unit: f64| {
        let error: Vec<f64> = a.iter().zip(b).map(|(a, b)| (a - b) * unit).collect();
        signals.thinned(track, &error)
    };
    let thrust: Vec<Vec<f64>> = responses.iter().map(|r| off(&s.reference, &r.reference, unit)).collect();
    let stage_rms_m = [0, 1, 2].map(|i| rms(&off(&s.stage_m, &responses[i].stage_m, 1.0)));
    SimulatedTrial {
        recording: k,
        injected,
        thrust_rms_n: [0, 1, 2].map(|i| rms(&thrust[i])),
        stage_rms_m,
        t_s: (0..track.thin_count()).map(|j| track.start_s + track.thin_s(j, signals.step)).collect(),
        thrust_error_n: thrust,
    }
}
