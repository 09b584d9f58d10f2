//! What a diagnosis says: plain data, no files. The report and the commands turn it into theirs.

use crate::plant::effects::{EffectKind, Parameter, PhysicsTerm, Port};
use crate::plant::machine::{Controller, Machine};
use std::borrow::Cow;

/// The answer to "is anything missing?".
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// At least one effect of the vocabulary is missing in the model.
    MissingPhysics,
    /// The structure suffices; a number of the model is wrong.
    ParameterError,
    /// Model and recordings agree within the noise.
    ModelAdequate,
    /// Something is missing that no effect of the vocabulary explains.
    UnexplainedMismatch,
}

impl Verdict {
    /// Name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Verdict::MissingPhysics => "missing_physics",
            Verdict::ParameterError => "parameter_error",
            Verdict::ModelAdequate => "model_adequate",
            Verdict::UnexplainedMismatch => "unexplained_mismatch",
        }
    }
}

/// A fitted number with its 95 % interval.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Name with its unit, as the contract spells it.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Unit in words of the shop floor, for a person: `N`, `m`, `s`.
    pub unit: &'static str,
    /// Lower and upper end of the 95 % interval.
    pub ci95: [f64; 2],
}

impl Estimate {
    /// A parameter of that value, its 95 % interval reaching `half` to either side.
    pub(super) fn within(p: &Parameter, value: f64, half: f64) -> Self {
        Self { name: p.name.to_owned(), value, unit: p.unit, ci95: [value - half, value + half] }
    }
}

/// A list parameter (a map over position).
#[derive(Debug, Clone, PartialEq)]
pub struct MapEstimate {
    /// Name with its unit.
    pub name: String,
    /// One value a knot.
    pub values: Vec<f64>,
}

/// A part of a recording, for the place where a mismatch sits.
#[derive(Debug, Clone, PartialEq)]
pub struct TimeSpans {
    /// Index of the recording among those that were looked at.
    pub recording: usize,
    /// Begin and end in s.
    pub spans_s: Vec<[f64; 2]>,
}

impl TimeSpans {
    /// Puts a span to those of its recording.
    pub(super) fn add(all: &mut Vec<Self>, recording: usize, span_s: [f64; 2]) {
        match all.iter_mut().find(|known| known.recording == recording) {
            Some(known) => known.spans_s.push(span_s),
            None => all.push(Self { recording, spans_s: vec![span_s] }),
        }
    }
}

/// Where the mismatch is.
#[derive(Debug, Clone, PartialEq)]
pub struct Location {
    /// Port.
    pub port: Port,
    /// `position`, `motor_angle`, `velocity`, `direction`, `frequency`, `time`, `current`, `history`,
    /// `acceleration`.
    pub domain: &'static str,
    /// Bands of the residual that stand out.
    pub bands_hz: Vec<[f64; 2]>,
    /// When, in which recording.
    pub time: Vec<TimeSpans>,
    /// Share of the mismatch on motor side, stage side and in their sum (power, 0 to 1), as measured; `None`:
    /// one position shows no sides, or nothing of it is above the noise.
    pub shares: Option<[f64; 3]>,
}

/// What no finding explains and stands above the noise.
#[derive(Debug, Clone, PartialEq)]
pub struct Unexplained {
    /// Where it enters.
    pub port: Port,
    /// Bands that hold nearly all of it.
    pub bands_hz: Vec<[f64; 2]>,
    /// When it is loud, in which recording.
    pub time: Vec<TimeSpans>,
    /// Root mean square, N.
    pub force_n: f64,
    /// Noise floor in the same bands, N.
    pub floor_n: f64,
}

/// An effect that takes a part of the mismatch and is not asserted.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Effect.
    pub effect: EffectKind,
    /// Port.
    pub port: Port,
    /// Its evidence, and what it would have had to exceed, nats.
    pub evidence_nats: f64,
    /// See there.
    pub level_nats: f64,
    /// Why it is not asserted.
    pub reason: CandidateReason,
}

/// Why what takes a part of the mismatch is not asserted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CandidateReason {
    /// What is left beside it stands above the noise.
    StandsBeside,
    /// Of several that stand for one another the motion does not say which.
    Undivided,
    /// Beside what else was found it is not determined.
    Undetermined,
    /// It ends at a bound, or every axis has it.
    AtBound,
    /// Chance reaches as much.
    BelowLevel,
}

impl CandidateReason {
    /// For a reader.
    #[must_use]
    pub fn sentence(self) -> &'static str {
        match self {
            Self::StandsBeside => "what is left beside it stands above the noise, and it is no cause of that",
            Self::Undivided => {
                "with the others of this reason it is missed, and the motion does not say which of them"
            }
            Self::Undetermined => "beside what else was found the recordings do not determine it",
            Self::AtBound => "a constant of it ends at its bound, or it is what every axis has",
            Self::BelowLevel => "its evidence is below what chance and the balance's own errors reach",
        }
    }
}

/// Root mean squares of the force balance on parts that nothing was fitted to, in N.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// Without the finding (numbers re-estimated).
    pub heldout_rms_before_n: f64,
    /// With it.
    pub heldout_rms_after_n: f64,
    /// What encoders, delays and the recording's own noise leave at best.
    pub noise_floor_n: f64,
}

/// Another cause that the data leave possible.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alternative {
    /// Effect.
    pub effect: EffectKind,
    /// Port.
    pub port: Port,
    /// Probability.
    pub probability: f64,
}

/// What a finding adds over one recording: N at force ports, m at encoders, A at the current.
#[derive(Debug, Clone, PartialEq)]
pub struct Contribution {
    /// Index of the recording among those that were looked at.
    pub recording: usize,
    /// Times in s.
    pub t_s: Vec<f64>,
    /// Values.
    pub value: Vec<f64>,
}

/// One effect that the model leaves out.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// 1 is the strongest.
    pub rank: usize,
    /// Effect.
    pub effect: EffectKind,
    /// Port.
    pub port: Port,
    /// One sentence for a person.
    pub statement: String,
    /// The law in symbols.
    pub equation: &'static str,
    /// Numbers with intervals.
    pub parameters: Vec<Estimate>,
    /// Maps.
    pub maps: Vec<MapEstimate>,
    /// Fit on held-out parts.
    pub fit: Fit,
    /// Probability over all hypotheses.
    pub probability: f64,
    /// What else it could be.
    pub alternatives: Vec<Alternative>,
    /// What to record to tell the alternatives apart.
    pub next_experiment: Option<String>,
    /// Per recording.
    pub contribution: Vec<Contribution>,
    /// The same as a term of a model.
    pub term: PhysicsTerm,
    /// Twice the gain in log-likelihood on held-out parts.
    pub evidence: f64,
}

/// What is wrong with the column of the force, as the balance alone shows it. It is put right, and nothing
/// rests on it.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceFault {
    /// Index of the recording among those that were looked at.
    pub recording: usize,
    /// Column.
    pub column: String,
    /// What.
    pub kind: ForceFaultKind,
}

/// Kinds of [`ForceFault`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ForceFaultKind {
    /// A line of the mains.
    MainsLine {
        /// Frequency, Hz.
        frequency_hz: f64,
        /// Root mean square, N.
        rms_n: f64,
    },
    /// Later than the motion it makes.
    ClockOffset {
        /// By how much, s.
        late_s: f64,
    },
}

/// A number of the model that the recordings contradict.
#[derive(Debug, Clone, PartialEq)]
pub struct Correction {
    /// Key of the model; of a law that the model states `effect.parameter`.
    pub name: Cow<'static, str>,
    /// What the model says.
    pub nominal: f64,
    /// What the recordings say.
    pub value: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
}

impl Correction {
    /// Found as `value`, its 95 % interval reaching `half` to either side.
    pub(super) fn within(name: impl Into<Cow<'static, str>>, nominal: f64, value: f64, half: f64) -> Self {
        Self { name: name.into(), nominal, value, ci95: [value - half, value + half] }
    }
}

/// How one recording fits, and the series to draw.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordingFit {
    /// Free word of the recording.
    pub experiment: String,
    /// Residual of the stated model, N.
    pub rms_before_n: f64,
    /// Residual with corrections and findings, N.
    pub rms_after_n: f64,
    /// Times of the series below (thinned to the residual's own rate), s.
    pub t_s: Vec<f64>,
    /// False where nothing was measured: what is left is 0 there, and not shown.
    pub measured: Vec<bool>,
    /// Position of the stage (of the motor as travel, where there is no scale), m.
    pub position_m: Vec<f64>,
    /// Its velocity, m/s.
    pub velocity_m_s: Vec<f64>,
    /// Force balance of the stated model, N; motor and stage side, or the one balance of a rigid axis.
    pub residual_nominal_n: Vec<Vec<f64>>,
    /// With the numbers re-estimated, no finding.
    pub residual_before_n: Vec<Vec<f64>>,
    /// With corrections and findings.
    pub residual_after_n: Vec<Vec<f64>>,
}

/// A hypothesis that was tried, for the table in the report.
#[derive(Debug, Clone, PartialEq)]
pub struct Tried {
    /// Effect; `None`: a free competitor (map, resonator, drift).
    pub effect: Option<EffectKind>,
    /// Port.
    pub port: Port,
    /// Twice the gain in log-likelihood on held-out parts, numbers re-estimated.
    pub evidence: f64,
}

/// The smallest effect of its kind that these recordings would have shown.
#[derive(Debug, Clone, PartialEq)]
pub struct DetectionLimit {
    /// Effect that was not found.
    pub effect: EffectKind,
    /// Port.
    pub port: Port,
    /// Root mean square over the recordings of the force from which on it would have been claimed, N.
    pub force_rms_n: f64,
}

/// Stated model, model with numbers re-estimated and model with the findings, each in closed loop under the
/// recorded command. Arrays in that order.
#[derive(Debug, Clone, PartialEq)]
pub struct ClosedLoop {
    /// Share of the reference's changes that the control law leaves in the recording it says best.
    pub law_share: f64,
    /// The law as it was read from the recordings, where the model states none.
    pub read: Option<Controller>,
    /// One a recording.
    pub trials: Vec<SimulatedTrial>,
    /// Findings that have no law in the simulation: cuts, disturbances.
    pub not_simulated: Vec<EffectKind>,
}

/// One recording beside its models.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedTrial {
    /// Index of the recording among those that were looked at.
    pub recording: usize,
    /// True where more acted on the loop than its law (a swept sine): model and machine were given it alike.
    pub injected: bool,
    /// Recorded thrust reference less the simulated one, root mean square, N; not finite where a model ran
    /// away.
    pub thrust_rms_n: [f64; 3],
    /// The same of the stage's position, m.
    pub stage_rms_m: [f64; 3],
    /// Times of the series below, s.
    pub t_s: Vec<f64>,
    /// Recorded thrust reference less the simulated one, N; a series a model.
    pub thrust_error_n: Vec<Vec<f64>>,
}

/// Everything a diagnosis says.
#[derive(Debug, Clone, PartialEq)]
pub struct Diagnosis {
    /// Axis.
    pub axis: String,
    /// Verdict.
    pub verdict: Verdict,
    /// Where, unless nothing is.
    pub location: Option<Location>,
    /// Effects, strongest first.
    pub findings: Vec<Finding>,
    /// What is left above the noise, whatever else was found.
    pub unexplained: Option<Unexplained>,
    /// What takes part of it and is not asserted, strongest first.
    pub candidates: Vec<Candidate>,
    /// Band of the residuals.
    pub residual_band_hz: [f64; 2],
    /// What is wrong with the column of the force beyond what the gate saw.
    pub force_faults: Vec<ForceFault>,
    /// Numbers that are wrong.
    pub parameter_corrections: Vec<Correction>,
    /// Per recording that was looked at, in the order they were handed in.
    pub recordings: Vec<RecordingFit>,
    /// Indices, as they were handed in, of those of which nothing was asked: the axis stands in it while a
    /// spindle turns, it was mended or rounded and others are whole, or it is too short. The notes say why.
    pub left_out: Vec<usize>,
    /// Why nothing can be told of the drive here. The verdict is then that nothing speaks against the model,
    /// since nothing could.
    pub no_evidence: Option<String>,
    /// Names of the balances in `residual_*`: `["motor", "stage"]` or `["axis"]`.
    pub balances: Vec<&'static str>,
    /// Rate of the series in [`RecordingFit`].
    pub series_rate_hz: f64,
    /// Noise floor of each balance in the band, N.
    pub noise_floor_n: Vec<f64>,
    /// Everything that was tried in the first round, strongest first.
    pub tried: Vec<Tried>,
    /// What would have been seen of that which was not found; empty for a rigid axis.
    pub detection_limits: Vec<DetectionLimit>,
    /// The model with findings and corrections in it.
    pub model: Machine,
    /// What a reader must know of how the answer came about, in sentences.
    pub notes: Vec<String>,
    /// The proof in simulation, or in a person's words why there is none.
    pub closed_loop: Result<ClosedLoop, String>,
}

impl Diagnosis {
    /// Those of `all` (one a recording, as they were handed in) that were looked at.
    #[must_use]
    pub fn looked_at<T: Clone>(&self, all: &[T]) -> Vec<T> {
        let kept = |(k, _): &(usize, &T)| !self.left_out.contains(k);
        all.iter().enumerate().filter(kept).map(|(_, one)| one.clone()).collect()
    }

    /// Those of `all` that were left out.
    #[must_use]
    pub fn left_out<T: Clone>(&self, all: &[T]) -> Vec<T> {
        self.left_out.iter().filter_map(|k| all.get(*k).cloned()).collect()
    }

    /// The answer of an axis whose lead was put right first.
    pub(super) fn correct_lead(&mut self, lead: Correction) {
        if self.verdict == Verdict::ModelAdequate {
            self.verdict = Verdict::ParameterError;
        }
        self.notes.push(format!(
            "By the stated screw_lead_m the motor travels {:.4} times as far as the stage. This is an answer \
             for a lead of {:.6} m; an angle or a scale that is logged off by that factor looks the same.",
            lead.nominal / lead.value,
            lead.value
        ));
        self.parameter_corrections.insert(0, lead);
    }

    /// The answer where no recording tells anything of the drive: the model as it is, and why.
    pub(super) fn without_evidence(machine: &Machine, recordings: usize, why: String) -> Self {
        Self {
            axis: String::new(),
            verdict: Verdict::ModelAdequate,
            location: None,
            findings: Vec::new(),
            unexplained: None,
            candidates: Vec::new(),
            residual_band_hz: [0.0; 2],
            force_faults: Vec::new(),
            parameter_corrections: Vec::new(),
            recordings: Vec::new(),
            left_out: (0..recordings).collect(),
            no_evidence: Some(why),
            balances: Vec::new(),
            series_rate_hz: 0.0,
            noise_floor_n: Vec::new(),
            tried: Vec::new(),
            detection_limits: Vec::new(),
            model: machine.clone(),
            notes: Vec::new(),
            closed_loop: Err("nothing was recorded that could be compared".to_owned()),
        }
    }
}
