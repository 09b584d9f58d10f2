//! What a diagnosis of the cut says: plain data, no files (contracts, section 6, "Outputs").

use super::super::result::{Alternative, Correction, Estimate, Fit, TimeSpans, Verdict};
use crate::plant::cut_effects::CutEffect;
use crate::plant::cut_terms::CutCondition;
use crate::plant::effects::{EffectKind, Port};
use crate::plant::scenario::Scenario;
use crate::stability::Root;

/// Where the mismatch is.
#[derive(Debug, Clone, PartialEq)]
pub struct CutLocation {
    /// Port.
    pub port: Port,
    /// `frequency`, `mean`, `order`, `time`, `outcome`: in what it shows first.
    pub domain: &'static str,
    /// Bands of the residual that stand out.
    pub bands_hz: Vec<[f64; 2]>,
    /// When, in which recording.
    pub time: Vec<TimeSpans>,
}

/// How a table is foretold by fits that did not see the rows of the same speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TableFit {
    /// Mean of -ln P(outcome) over the judged rows, the stated structure refitted.
    pub heldout_log_loss_before: f64,
    /// With the finding.
    pub heldout_log_loss_after: f64,
    /// Judged rows whose outcome is the likelier one, before.
    pub heldout_right_before: usize,
    /// After.
    pub heldout_right_after: usize,
    /// Judged rows.
    pub heldout_cuts: usize,
    /// Median over the rows of which growth was measured, of what is foretold of it less that, 1/s; none: no
    /// such row.
    pub growth_off_1_s: Option<Sides<f64>>,
}

/// How a finding shows on cuts that no parameter was fitted to; at least one of the two.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CutFit {
    /// Radial forces less what is predicted one sample ahead.
    pub forces: Option<Fit>,
    /// Table of cuts.
    pub table: Option<TableFit>,
    /// What ln L of the held-out stretches gains by the finding, all other numbers fitted anew with it and
    /// without it, nats.
    pub gain_nats: Option<f64>,
}

/// The same of three models: as stated; its structure with other numbers alone; with the findings.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sides<T> {
    /// The scenario as stated.
    pub stated: T,
    /// The stated structure, its numbers fitted anew.
    pub refitted: T,
    /// Corrections and findings.
    pub answer: T,
}

/// How an answer stands on recorded stretches, each foretold by fits that did not see it.
#[derive(Debug, Clone, PartialEq)]
pub struct CutProof {
    /// Stretches.
    pub stretches: usize,
    /// In so many parts they were held out, one after the other.
    pub parts: usize,
    /// -ln L of the stretches, nats; a constant is common to all three.
    pub loss_nats: Sides<f64>,
    /// Radial forces less what is predicted one sample ahead, root mean square, N.
    pub rms_n: Sides<f64>,
    /// What random force and sensor leave at best, N.
    pub noise_floor_n: f64,
    /// Stretches that swell or fade, with their lines.
    pub lines: Vec<ProvenLine>,
}

/// Growth and line of one stretch, measured without any model, beside those of three models.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProvenLine {
    /// Index of the recording.
    pub recording: usize,
    /// Begin and end, s.
    pub span_s: [f64; 2],
    /// From block to block of a quarter of a turn.
    pub measured: Root,
    /// Standard deviation of the measured growth, 1/s; 2 pi times that of the line, Hz.
    pub deviation_1_s: f64,
    /// Rightmost root under the condition of the stretch.
    pub foretold: Sides<Root>,
}

/// What a finding adds over one recording: N at `process` and `force_sensor`, m at `workpiece` and `turret`,
/// rad at `spindle`.
#[derive(Debug, Clone, PartialEq)]
pub struct CutContribution {
    /// Index of the recording as it was handed in.
    pub recording: usize,
    /// Times, s: one a sample.
    pub t_s: Vec<f64>,
    /// Values; of tool 1 where there are two.
    pub value: Vec<f64>,
    /// Values of tool 2, at `process` and `force_sensor`.
    pub value_2: Option<Vec<f64>>,
}

/// A cut that would tell hypotheses apart.
#[derive(Debug, Clone, PartialEq)]
pub struct PlannedCut {
    /// Speed, rpm.
    pub spindle_speed_rpm: f64,
    /// Feed per turn, m.
    pub feed_m_rev: f64,
    /// Width of cut of each tool, m.
    pub width_m: f64,
    /// Tools from the chuck, m.
    pub tool_position_m: f64,
    /// theta_2 - theta_1, rad.
    pub pitch_difference_rad: f64,
    /// How long, s.
    pub duration_s: f64,
    /// What it tells, for a person.
    pub tells: String,
    /// Expected gain of the right hypothesis over its nearest rival, nats.
    pub expected_nats: f64,
}

/// One effect that the scenario leaves out.
#[derive(Debug, Clone, PartialEq)]
pub struct CutFinding {
    /// 1 is the strongest.
    pub rank: usize,
    /// Effect.
    pub effect: EffectKind,
    /// Port.
    pub port: Port,
    /// One sentence for a person.
    pub statement: String,
    /// The law in symbols.
    pub equation: String,
    /// Numbers with intervals; the key one first.
    pub parameters: Vec<Estimate>,
    /// Fit on cuts that nothing was fitted to.
    pub fit: CutFit,
    /// Probability over all hypotheses.
    pub probability: f64,
    /// What else it could be.
    pub alternatives: Vec<Alternative>,
    /// The cut to add to tell the alternatives apart.
    pub next_experiment: Option<String>,
    /// Per recording; empty from a table alone.
    pub contribution: Vec<CutContribution>,
    /// Gain in log-likelihood after the price of its parameters, nats.
    pub evidence_nats: f64,
}

impl CutFinding {
    /// Whether this effect is the one found: its key number says which, where an effect may stand twice.
    pub(crate) fn is(&self, effect: &CutEffect) -> bool {
        let key = self.parameters.first().map_or(f64::NAN, |p| p.value);
        effect.kind() == self.effect && (effect.values()[0] - key).abs() <= 0.0
    }
}

/// What these cuts could not have shown at any size that matters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NotIdentifiable {
    /// Effect.
    pub effect: EffectKind,
    /// Port.
    pub port: Port,
    /// Why, and what would.
    pub why: String,
}

/// How one recording fits, and the series to draw.
#[derive(Debug, Clone, PartialEq)]
pub struct CutRecordingFit {
    /// Free word of the recording.
    pub experiment: String,
    /// Root mean square of radial forces less their prediction, the scenario as stated, N.
    pub rms_before_n: f64,
    /// With corrections and findings, N.
    pub rms_after_n: f64,
    /// Series for the report, thinned.
    pub series: CutSeries,
    /// The model running free, with no measured force; `None`: nothing was cut.
    pub free: Option<FreeFit>,
}

/// How loud a recording is beside what the model, running free under the same speed, feed, width, position
/// and pitch, would have been: whether, when and how far it chatters.
#[derive(Debug, Clone, PartialEq)]
pub struct FreeFit {
    /// Middle of each window in the cut, s.
    pub t_s: Vec<f64>,
    /// Vibration of both forces from the bar's first bending up, rms, as recorded, N.
    pub recorded_n: Vec<f64>,
    /// Least and greatest of the scenario as stated, over its random force.
    pub before_n: [Vec<f64>; 2],
    /// The same with corrections and findings.
    pub after_n: [Vec<f64>; 2],
    /// Recorded over the middle of the runs, rms over the windows, dB: as stated, and with the answer.
    pub apart_db: [f64; 2],
}

/// What is drawn of a recording.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CutSeries {
    /// Times, s.
    pub t_s: Vec<f64>,
    /// Recorded force of the tool shown, N.
    pub force_n: Vec<f64>,
    /// Recorded less predicted, the scenario as stated, N.
    pub error_before_n: Vec<f64>,
    /// Recorded less predicted, with corrections and findings, N.
    pub error_after_n: Vec<f64>,
}

/// One side, before or after, of a row of a table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForetoldCut {
    /// Real part of the rightmost root, 1/s.
    pub growth_1_s: f64,
    /// Its frequency, Hz.
    pub frequency_hz: f64,
    /// Probability of chatter, 0 to 1.
    pub chatter_probability: f64,
}

/// A row of the table with what the scenario foretells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutRowFit {
    /// The scenario as stated.
    pub before: ForetoldCut,
    /// With corrections and findings, from a fit that did not see the rows of this speed.
    pub after: ForetoldCut,
}

/// A hypothesis that was tried, for the table in the report.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutTried {
    /// Effect; `None`: the stated structure refitted, to which the others are compared.
    pub effect: Option<EffectKind>,
    /// Port.
    pub port: Port,
    /// Gain in log-likelihood after the price, nats.
    pub evidence_nats: f64,
}

/// A cut that was recorded, as a point of the stability map.
#[derive(Debug, Clone, PartialEq)]
pub struct MappedCut {
    /// Where it is from: experiment, or the cut's name.
    pub name: String,
    /// Its condition, the pitch as commanded.
    pub at: CutCondition,
    /// Whether it chattered; `None`: not judged.
    pub chatter: Option<bool>,
}

/// Everything a diagnosis of the cut says.
#[derive(Debug, Clone, PartialEq)]
pub struct CutDiagnosis {
    /// Verdict.
    pub verdict: Verdict,
    /// Where, unless nothing is.
    pub location: Option<CutLocation>,
    /// Effects, strongest first.
    pub findings: Vec<CutFinding>,
    /// Band of the residuals; nothing from a table alone.
    pub residual_band_hz: Option<[f64; 2]>,
    /// What the force signal's own noise leaves at best, N; nothing from a table alone.
    pub noise_floor_n: Option<f64>,
    /// Numbers that are wrong.
    pub parameter_corrections: Vec<Correction>,
    /// Per recording, in the order they were handed in.
    pub recordings: Vec<CutRecordingFit>,
    /// Per row of the table, in its order; empty without a table.
    pub rows: Vec<CutRowFit>,
    /// How the answer stands on held-out stretches; nothing from a table alone.
    pub proof: Option<CutProof>,
    /// How the table as a whole is foretold.
    pub table: Option<TableFit>,
    /// What these cuts could not have shown.
    pub not_identifiable: Vec<NotIdentifiable>,
    /// Cuts to add, the most telling first.
    pub plan: Vec<PlannedCut>,
    /// Everything that was tried in the first round, strongest first.
    pub tried: Vec<CutTried>,
    /// Cuts for the stability map.
    pub mapped: Vec<MappedCut>,
    /// The scenario as stated.
    pub stated: Scenario,
    /// The scenario with corrections and findings in it.
    pub scenario: Scenario,
    /// What a reader must know of how the answer came about, in sentences.
    pub notes: Vec<String>,
}
