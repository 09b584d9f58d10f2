//! What recordings alone can say: how the answer stands on stretches that nothing was fitted to, what each
//! finding adds in time, what is left, and the cuts for the map.

use super::super::result::Verdict;
use super::super::selection::Work;
use super::adequacy::{Left, left};
use super::along::{Motion, added, law_forces, true_forces};
use super::answer::{Fitting, standing};
use super::bursts::bursts;
use super::contact::{impossible_chatter, pulls};
use super::fit::Problem;
use super::free::free_fit;
use super::input::CutRecording;
use super::known::Reference;
use super::laws::Law;
use super::machine::Machine;
use super::observable::Observable;
use super::observe::observe;
use super::proof::{HELD_OUT, Models, gained, held_out_groups, left_over, prove};
use super::result::{CutContribution, CutDiagnosis, CutLocation, CutRecordingFit, CutSeries, MappedCut};
use super::stretches::{Stretch, Stretches, band_hz, condition};
use crate::plant::cut_effects::CutEffect;
use crate::plant::effects::{EffectKind, Port};
use crate::plant::scenario::Scenario;

/// Points of a series for a picture.
const DRAWN: usize = 1500;

/// Completes a diagnosis by what only recordings can say.
pub(crate) fn complete(
    fitting: &Fitting<'_>,
    recordings: &[CutRecording],
    (stretches, known): (&Stretches, &Reference),
    work: &mut Work,
    diagnosis: &mut CutDiagnosis,
) {
    let problem = fitting.problem;
    let point = &fitting.selected.model.point;
    let bands = recordings.iter().map(|r| band_hz(r, &diagnosis.stated));
    diagnosis.residual_band_hz = bands.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
    // Where there is too little to leave a stretch out, parts of it are, in time.
    let parts = || observe(recordings, &stretches.divided(recordings, HELD_OUT), known);
    let parts = (held_out_groups(problem.observables) < HELD_OUT).then(parts);
    let models = Models::of(fitting, &diagnosis.findings, work);
    prove(problem.frame, &models, parts.as_deref().unwrap_or(problem.observables), work, diagnosis);
    if work.has_refused() {
        diagnosis.notes.push(
            "The budget ended before the answer was held against stretches that were left out of its fits."
                .to_owned(),
        );
    }
    let effects: Vec<CutEffect> = diagnosis.scenario.physics.iter().collect();
    for finding in &mut diagnosis.findings {
        let Some(effect) = effects.iter().find(|e| finding.is(e)) else { continue };
        finding.contribution = contribution(recordings, &diagnosis.scenario, effect);
    }
    if let Some(after) = problem.frame.machine(point)
        && let Some(before) = problem.frame.stated_in(after.noise)
    {
        diagnosis.recordings = (0..recordings.len())
            .map(|k| recording_fit(problem, &recordings[k], k, [&before, &after]))
            .collect();
    }
    if let (Some(location), Some(first)) = (&mut diagnosis.location, diagnosis.findings.first()) {
        location.domain = domain(first.effect);
        if let Some(gained) = gained(fitting, &models) {
            location.bands_hz = gained.bands_hz;
            location.time = gained.time;
        }
    }
    diagnosis.notes.extend(stretches.silent.iter().map(|k| silent_note(&recordings[*k])));
    diagnosis.mapped.extend(mapped(recordings, stretches, &diagnosis.stated));
    // Of what is left the greater.
    let scattered = fitting.scattered.map(|s| s.left.clone());
    let bursts = bursts(recordings, stretches, &diagnosis.stated);
    let unnamed = remembered(fitting);
    let left = left(problem, point).into_iter().chain(scattered).chain(bursts).chain(unnamed);
    judge(left.max_by(|a, b| a.excess_nats.total_cmp(&b.excess_nats)), diagnosis);
    let impossible = || {
        let posterior = fitting.posterior.as_ref()?;
        impossible_chatter(problem, posterior, recordings, stretches)
    };
    if let Some(other) = pulls(recordings).or_else(impossible) {
        beyond(other, diagnosis);
    }
}

fn silent_note(recording: &CutRecording) -> String {
    format!(
        "{}: there is no random force in it, as there is in every cut that was measured; an ideal simulation \
         has one with --force-noise-ratio 0.03. What its vibration says of the cut cannot be judged without: \
         means and lines of the spindle alone were looked at. Nothing found is no proof.",
        recording.experiment
    )
}

/// A force that remembers, where the model has one.
fn remembered(fitting: &Fitting<'_>) -> Option<Left> {
    let excess_nats = standing(fitting, Law::Memory)?.evidence_nats;
    let location =
        CutLocation { port: Port::Process, domain: "frequency", bands_hz: Vec::new(), time: Vec::new() };
    let taken = fitting.selected.model.point.terms.iter().any(|t| t.law == Law::Memory);
    taken.then_some(Left { location, excess_nats })
}

/// What no cut does: the answer where nothing else was found.
fn beyond(other: Left, diagnosis: &mut CutDiagnosis) {
    let port = other.location.port;
    let what = match port {
        Port::ForceSensor => "lines larger than a tool that only pushes can exert",
        _ => "chatter all through where the machine as stated is stable",
    };
    diagnosis.notes.push(format!("The force signal shows {what} (at {}).", port.name()));
    if diagnosis.findings.is_empty() && diagnosis.verdict != Verdict::UnexplainedMismatch {
        diagnosis.verdict = Verdict::UnexplainedMismatch;
        diagnosis.location = Some(other.location);
    }
}

/// In what an effect shows first.
fn domain(effect: EffectKind) -> &'static str {
    match effect {
        EffectKind::EdgeForce
        | EffectKind::NonlinearCuttingForce
        | EffectKind::NoseRadius
        | EffectKind::SpeedDependentForce
        | EffectKind::ToolDifference => "mean",
        EffectKind::Runout | EffectKind::StockVariation | EffectKind::SpindleSpeedVariation => "order",
        EffectKind::ModeDrift | EffectKind::ToolWear => "time",
        _ => "frequency",
    }
}

/// What is left decides whether what was found is the answer.
fn judge(left: Option<Left>, diagnosis: &mut CutDiagnosis) {
    let Some(left) = left else { return };
    let found: f64 = diagnosis.findings.iter().map(|f| f.evidence_nats).sum();
    // A law that explains less than it leaves has bent to something that is none of the vocabulary.
    if found < left.excess_nats {
        // So have the numbers that were fitted beside it.
        if !diagnosis.findings.is_empty() {
            diagnosis.proof = None;
            diagnosis.findings.clear();
            diagnosis.parameter_corrections.clear();
            diagnosis.scenario = diagnosis.stated;
        }
        diagnosis.verdict = Verdict::UnexplainedMismatch;
        diagnosis.location = Some(left.location);
    } else {
        let note = format!(
            "Something is left beside the findings: at {} in {}.",
            left.location.port.name(),
            left.location.domain
        );
        diagnosis.notes.push(note);
    }
}

fn contribution(recordings: &[CutRecording], with: &Scenario, effect: &CutEffect) -> Vec<CutContribution> {
    let of = |(index, recording): (usize, &CutRecording)| {
        let added = added(recording, with, effect);
        CutContribution {
            recording: index,
            t_s: (0..recording.len()).map(|k| recording.time_s(k)).collect(),
            value: added.value,
            value_2: added.value_2,
        }
    };
    recordings.iter().enumerate().map(of).collect()
}

/// One recording before and after, with the series to draw.
fn recording_fit(
    problem: &Problem<'_>,
    recording: &CutRecording,
    index: usize,
    [before, after]: [&Machine; 2],
) -> CutRecordingFit {
    let own = || {
        let own = problem.observables.iter().filter(|o| o.origin().recording == Some(index));
        own.map(|o| o.as_ref() as &dyn Observable)
    };
    let forces = true_forces(recording);
    let error = |machine: &Machine| -> Vec<f64> {
        let motion = Motion::under(recording, &machine.scenario, &forces);
        let [law, _] = law_forces(recording, &machine.scenario, &motion);
        forces[0].iter().zip(&law).map(|(f, l)| f - l).collect()
    };
    let step = recording.len().div_ceil(DRAWN).max(1);
    let thin = |x: &[f64]| x.iter().step_by(step).copied().collect::<Vec<f64>>();
    CutRecordingFit {
        experiment: recording.experiment.clone(),
        rms_before_n: left_over(own(), before).mean().recorded_n2.sqrt(),
        rms_after_n: left_over(own(), after).mean().recorded_n2.sqrt(),
        series: CutSeries {
            t_s: (0..recording.len()).step_by(step).map(|k| recording.time_s(k)).collect(),
            force_n: thin(&forces[0]),
            error_before_n: thin(&error(before)),
            error_after_n: thin(&error(after)),
        },
        free: free_fit(recording, [before, after]),
    }
}

/// The stretches as cuts of a map: what swells chatters.
fn mapped(recordings: &[CutRecording], stretches: &Stretches, scenario: &Scenario) -> Vec<MappedCut> {
    let one = |stretch: &Stretch, chatter: Option<bool>| {
        let recording = &recordings[stretch.recording];
        let middle = usize::midpoint(stretch.samples.start, stretch.samples.end);
        let at = condition(recording, middle, scenario);
        MappedCut { name: format!("{} {:.1} s", recording.experiment, at.time_s), at, chatter }
    };
    let calm = stretches.calm.iter().map(|s| one(s, Some(false)));
    let followed = stretches.followed.iter().map(|s| {
        let force = recordings[s.recording].forces_n.iter().flatten().next();
        let swells = force.is_some_and(|f| {
            let middle = usize::midpoint(s.samples.start, s.samples.end);
            scatter(&f[middle..s.samples.end]) > scatter(&f[s.samples.start..middle])
        });
        one(s, Some(swells))
    });
    calm.chain(followed).collect()
}

fn scatter(x: &[f64]) -> f64 {
    let n = x.len().max(1) as f64;
    let mean = x.iter().sum::<f64>() / n;
    x.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n
}
