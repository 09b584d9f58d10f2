//! What a diagnosis of the cut looks at: recordings of cuts and tables of cuts (contracts, section 6).
//!
//! A [`CutRecording`] is a [`Recording`] with the columns of a cut found and the scenario's numbers in place
//! of those that are not recorded; each such column is told, with what cannot be seen without it. A
//! [`CutTable`] is one row a cut of constant condition; what a row does not say is `None`.

use crate::plant::effects::EffectKind;
use crate::plant::scenario::{Scenario, ToolCount};
use crate::sample::Recording;
use crate::units::SampleRate;
use thiserror::Error;

/// What a tool is called in columns: `tool1_radial_force_n`.
const FORCE_COLUMNS: [&str; 2] = ["tool1_radial_force_n", "tool2_radial_force_n"];

/// How the force signal shows the true force: `delay_s` late, through a Butterworth low-pass of fourth order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceSignal {
    /// Corner of the low-pass; `None`: not stated, none within the recording's band.
    pub bandwidth_hz: Option<f64>,
    /// Delay.
    pub delay_s: f64,
}

/// A column that a recording of a cut has not, with what stands in for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MissingColumn {
    /// Name.
    pub name: &'static str,
    /// What is used in its place, if anything is.
    pub instead: Option<&'static str>,
    /// What the cuts do not show without it.
    pub hides: &'static str,
    /// Effects of which none is told without it.
    pub effects: &'static [EffectKind],
    /// What is foretold with its help: if what stands in for it is wrong, so is that.
    pub bears: &'static [Borne],
}

/// What of a recording is foretold with the help of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Borne {
    /// Spectra and lines of the forces.
    Vibration,
    /// Mean forces.
    Means,
    /// Lines of the spindle.
    Orders,
}

/// One recording of a cut. Every series has one value a sample and is finite.
#[derive(Debug, Clone, PartialEq)]
pub struct CutRecording {
    /// Free word of the recording.
    pub experiment: String,
    /// Samples per second.
    pub sample_rate: SampleRate,
    /// Time of the first sample, s.
    pub start_s: f64,
    /// Radial force of tool 1 and of tool 2, away from the work positive, as the signal shows it, N.
    pub forces_n: [Option<Vec<f64>>; 2],
    /// How the signal shows the force.
    pub signal: ForceSignal,
    /// Whether the recording says so.
    pub signal_is_stated: bool,
    /// Spindle angle as measured, not wrapped, rad.
    pub spindle_angle_rad: Option<Vec<f64>>,
    /// Speed, rpm: as commanded, times `speed_factor`.
    pub spindle_speed_rpm: Vec<f64>,
    /// What the measured angle turned over what was commanded.
    pub speed_factor: f64,
    /// Tools from the chuck, m.
    pub tool_position_m: Vec<f64>,
    /// theta_2 - theta_1 as commanded, rad.
    pub pitch_difference_rad: Vec<f64>,
    /// Feed per turn, m.
    pub feed_m_rev: Vec<f64>,
    /// Width of cut of each tool, m; 0 is out of the cut.
    pub width_m: Vec<f64>,
    /// Bar at the tools toward tool 1, where there is a probe, m.
    pub displacement_m: Option<Vec<f64>>,
    /// Diameter of the work that the recording states, m.
    pub workpiece_diameter_m: Option<f64>,
    /// What is not in the recording.
    pub missing: Vec<MissingColumn>,
    /// One a sample: the row enters no fit; empty: all do.
    pub masked: Vec<bool>,
}

/// Why a recording is none of a cut.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum CutInputError {
    /// No force of a tool.
    #[error(
        "recording {recording}: no column tool1_radial_force_n or tool2_radial_force_n that moves; it has \
         {present}"
    )]
    NoForce {
        /// Experiment of the recording.
        recording: String,
        /// Its columns.
        present: String,
    },
    /// No speed.
    #[error("recording {recording}: no column spindle_speed_rpm; it has {present}")]
    NoSpeed {
        /// Experiment of the recording.
        recording: String,
        /// Its columns.
        present: String,
    },
    /// A value that no cut has.
    #[error("recording {recording}: column {column}, row {row}: {value}; expected {expected}")]
    NotPhysical {
        /// Experiment of the recording.
        recording: String,
        /// Column.
        column: &'static str,
        /// First such row, from 0.
        row: usize,
        /// What stands there.
        value: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// A value of a table that no cut has.
    #[error("table of cuts, cut {cut}: {column} is {value}; expected {expected}")]
    NoSuchCut {
        /// Name of the cut.
        cut: String,
        /// Column.
        column: &'static str,
        /// What stands there.
        value: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// Angle and speed of the spindle tell two tales.
    #[error(
        "recording {recording}: column spindle_angle_rad turns {factor:.3} times as far as spindle_speed_rpm \
         says; expected rad, not wrapped, and the same shaft in rpm"
    )]
    OtherSpeed {
        /// Experiment of the recording.
        recording: String,
        /// Turns of the one over those of the other.
        factor: f64,
    },
    /// A piece of metadata that cannot be used.
    #[error("recording {recording}: metadata {key} is `{found}`; expected {expected}")]
    Metadata {
        /// Experiment of the recording.
        recording: String,
        /// Key.
        key: &'static str,
        /// What stands there.
        found: String,
        /// What was expected.
        expected: &'static str,
    },
    /// No part of any recording can be compared with a model.
    #[error(
        "no stretch of these recordings can be judged: in none does the condition stand still for some turns \
         while the tools keep contact and the flanks keep clear; expected a cut of a second or more"
    )]
    NothingToJudge,
    /// Neither a recording nor a table with a cut in it.
    #[error("no cut to diagnose: expected a recording, or a table with at least one row")]
    NoCut,
}

impl CutRecording {
    /// The cut that a recording shows; what it does not say is the scenario's.
    ///
    /// Errors: no force, no speed, a value that no cut has, metadata that are no number.
    pub fn new(recording: &Recording, scenario: &Scenario) -> Result<Self, CutInputError> {
        let mut found = Columns { recording, missing: Vec::new() };
        // A column that never changes is what a logger writes where nothing is connected.
        let moves = |x: &&[f64]| x.iter().any(|v| *v != x[0]);
        let forces_n = FORCE_COLUMNS.map(|name| recording.get(name).filter(moves).map(<[f64]>::to_vec));
        if forces_n.iter().all(Option::is_none) {
            return Err(CutInputError::NoForce {
                recording: recording.experiment.clone(),
                present: found.present(),
            });
        }
        let spindle_speed_rpm = recording.get("spindle_speed_rpm").map(<[f64]>::to_vec);
        let mut spindle_speed_rpm = spindle_speed_rpm.ok_or_else(|| CutInputError::NoSpeed {
            recording: recording.experiment.clone(),
            present: found.present(),
        })?;
        let spindle_angle_rad = found.optional("spindle_angle_rad");
        let measured = spindle_angle_rad.as_deref();
        let speed_factor =
            measured.and_then(|a| turned(a, &spindle_speed_rpm, recording.sample_rate)).unwrap_or(1.0);
        if !SAME_SHAFT.contains(&speed_factor) {
            let recording = recording.experiment.clone();
            return Err(CutInputError::OtherSpeed { recording, factor: speed_factor });
        }
        spindle_speed_rpm.iter_mut().for_each(|s| *s *= speed_factor);
        let cutting = scenario.cutting.raw();
        let tools = scenario.tools;
        let bandwidth_hz = found.number("force_bandwidth_hz", Sign::Positive)?;
        let delay_s = found.number("force_delay_s", Sign::NotNegative)?;
        let two = tools.count() == ToolCount::Two;
        let feed_m_rev = found.or_stated("feed_m_rev", cutting.feed_m_rev);
        let travelled_m = travelled_m(recording, &feed_m_rev, &spindle_speed_rpm);
        let position_m = found.optional("tool_position_m");
        if two {
            for (name, force) in FORCE_COLUMNS.iter().zip(&forces_n) {
                if force.is_none() {
                    found.misses(name);
                }
            }
        }
        let width_m = found.or_stated("width_m", cutting.width_m);
        // Out of the cut tools may jump along the bar: where they are nobody knows from there on.
        let lost_from = position_m.is_none().then(|| first_pause(&width_m)).flatten();
        let cut = Self {
            masked: lost_from.map_or_else(Vec::new, |from| (0..recording.len()).map(|k| k >= from).collect()),
            tool_position_m: position_m
                .unwrap_or_else(|| travelled_m.iter().map(|x| (tools.position_m() - x).max(0.0)).collect()),
            pitch_difference_rad: if two {
                found.or_stated("pitch_difference_rad", tools.pitch_difference_rad())
            } else {
                vec![0.0; recording.len()]
            },
            width_m,
            feed_m_rev,
            spindle_angle_rad,
            speed_factor,
            displacement_m: found.optional("workpiece_displacement_m"),
            workpiece_diameter_m: found.number("workpiece_diameter_m", Sign::Positive)?,
            signal: ForceSignal { bandwidth_hz, delay_s: delay_s.unwrap_or(0.0) },
            signal_is_stated: bandwidth_hz.is_some() || delay_s.is_some(),
            experiment: recording.experiment.clone(),
            sample_rate: recording.sample_rate,
            start_s: recording.start_s,
            forces_n,
            spindle_speed_rpm,
            missing: found.missing,
        };
        cut.check(scenario)?;
        Ok(cut)
    }

    /// The same with more rows that enter no fit: one a sample, or none.
    #[must_use]
    pub fn with_masked(mut self, masked: Vec<bool>) -> Self {
        if masked.len() == self.len() {
            self.masked.resize(masked.len(), false);
            self.masked.iter_mut().zip(masked).for_each(|(own, more)| *own |= more);
        }
        self
    }

    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.spindle_speed_rpm.len()
    }

    /// True when there is no sample.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.spindle_speed_rpm.is_empty()
    }

    /// Time of sample `index`, s.
    #[must_use]
    pub fn time_s(&self, index: usize) -> f64 {
        self.start_s + index as f64 / self.sample_rate.hz()
    }

    fn check(&self, scenario: &Scenario) -> Result<(), CutInputError> {
        let above_zero = |x: f64| x > 0.0;
        let room = Room::of(scenario);
        let on_radius = |x: f64| room.is_on_radius(x);
        let along_bar = |x: f64| room.is_along_bar(x);
        self.check_column("spindle_speed_rpm", &self.spindle_speed_rpm, (above_zero, "a number above zero"))?;
        self.check_column("width_m", &self.width_m, (on_radius, Room::ON_RADIUS))?;
        self.check_column("feed_m_rev", &self.feed_m_rev, (on_radius, Room::ON_RADIUS))?;
        self.check_column("tool_position_m", &self.tool_position_m, (along_bar, Room::ALONG_BAR))?;
        let below_turn = |x: f64| x.abs() < std::f64::consts::TAU;
        let pitch = (below_turn, "less than a turn either way");
        self.check_column("pitch_difference_rad", &self.pitch_difference_rad, pitch)
    }

    fn check_column(
        &self,
        column: &'static str,
        values: &[f64],
        (good, expected): (impl Fn(f64) -> bool, &'static str),
    ) -> Result<(), CutInputError> {
        values.iter().position(|v| !good(*v)).map_or(Ok(()), |row| {
            let recording = self.experiment.clone();
            Err(CutInputError::NotPhysical { recording, column, row, value: values[row], expected })
        })
    }
}

/// What a cut has room for on the stated work. A column in mm is a thousand times what it should be.
struct Room {
    radius_m: f64,
    length_m: f64,
}

impl Room {
    const ON_RADIUS: &'static str = "m, zero or above, and less than the radius of the work";
    const ALONG_BAR: &'static str =
        "m from the chuck, zero or above, and less than twice the projection length of the work";

    fn of(scenario: &Scenario) -> Self {
        let bar = &scenario.workpiece;
        Self { radius_m: bar.diameter_m() / 2.0, length_m: bar.projection_length_m() }
    }

    fn is_on_radius(&self, x_m: f64) -> bool {
        x_m >= 0.0 && x_m < self.radius_m
    }

    fn is_along_bar(&self, x_m: f64) -> bool {
        x_m >= 0.0 && x_m < 2.0 * self.length_m
    }
}

/// A motor slips, and a command is not what an override makes of it; by more than a tenth an angle is of
/// another unit or another shaft.
const SAME_SHAFT: std::ops::Range<f64> = 0.9..1.1;

/// What a measured angle turned over what was commanded. `None`: no turn was commanded.
fn turned(angle_rad: &[f64], commanded_rpm: &[f64], rate: SampleRate) -> Option<f64> {
    let [first, last] = [angle_rad.first()?, angle_rad.last()?];
    let turns = commanded_rpm[..commanded_rpm.len() - 1].iter().sum::<f64>() / 60.0 / rate.hz();
    let factor = (last - first) / std::f64::consts::TAU / turns;
    factor.is_finite().then_some(factor)
}

/// Which numbers of the metadata are good.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sign {
    Positive,
    NotNegative,
}

/// Columns of a recording, and those that were looked for in vain.
struct Columns<'a> {
    recording: &'a Recording,
    missing: Vec<MissingColumn>,
}

/// The first row out of the cut after one in it; `None`: the tools stay in.
fn first_pause(width_m: &[f64]) -> Option<usize> {
    let begin = width_m.iter().position(|w| *w > 0.0)?;
    let pause = width_m[begin..].iter().position(|w| *w <= 0.0)?;
    Some(begin + pause)
}

/// How far the tools have travelled toward the chuck by their feed since the recording began, m.
fn travelled_m(recording: &Recording, feed_m_rev: &[f64], speed_rpm: &[f64]) -> Vec<f64> {
    let per_sample = 1.0 / (60.0 * recording.sample_rate.hz());
    let mut way = 0.0;
    let travel = feed_m_rev.iter().zip(speed_rpm).map(|(f, s)| {
        let now = way;
        way += f * s * per_sample;
        now
    });
    travel.collect()
}

const ONE_TOOL: MissingColumn = MissingColumn {
    name: "",
    instead: Some("the force of the other tool alone"),
    hides: "what one tool does and the other does not",
    effects: &[],
    bears: &[],
};

/// What stands in for a column that is missing, and what hides with it.
const REPLACED: [MissingColumn; 8] = [
    MissingColumn { name: FORCE_COLUMNS[0], ..ONE_TOOL },
    MissingColumn { name: FORCE_COLUMNS[1], ..ONE_TOOL },
    MissingColumn {
        name: "tool_position_m",
        instead: Some(
            "the scenario's position, and from there the way of the feed until the tools leave the cut",
        ),
        hides: "whatever changes along the bar, and whether it does so with the place or with time",
        effects: &[EffectKind::PositionDependentMode, EffectKind::SupportCompliance, EffectKind::ModeDrift],
        bears: &[],
    },
    MissingColumn {
        name: "pitch_difference_rad",
        instead: Some("the scenario's pitch difference"),
        hides: "the delays of the two tools apart",
        effects: &[],
        bears: &[Borne::Vibration, Borne::Means],
    },
    MissingColumn {
        name: "feed_m_rev",
        instead: Some("the scenario's feed"),
        hides: "edge force and exponent: what changes with the feed",
        effects: &[EffectKind::EdgeForce, EffectKind::NonlinearCuttingForce],
        bears: &[Borne::Vibration, Borne::Means],
    },
    MissingColumn {
        name: "width_m",
        instead: Some("the scenario's width, all through the recording"),
        hides: "nose radius: what changes with the width; entry and exit",
        effects: &[EffectKind::NoseRadius],
        bears: &[Borne::Vibration, Borne::Means, Borne::Orders],
    },
    MissingColumn {
        name: "spindle_angle_rad",
        instead: Some("the angle of uniform rotation"),
        hides: "speed variation, and the phase of what turns with the work",
        effects: &[EffectKind::SpindleSpeedVariation],
        bears: &[],
    },
    MissingColumn {
        name: "workpiece_displacement_m",
        instead: None,
        hides: "a force signal that is later or narrower than stated",
        effects: &[EffectKind::ForceSensorLag],
        bears: &[],
    },
];

impl Columns<'_> {
    fn present(&self) -> String {
        self.recording.columns.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", ")
    }

    fn misses(&mut self, name: &str) {
        self.missing.extend(REPLACED.iter().filter(|m| m.name == name));
    }

    fn optional(&mut self, name: &str) -> Option<Vec<f64>> {
        let values = self.recording.get(name).map(<[f64]>::to_vec);
        if values.is_none() {
            self.misses(name);
        }
        values
    }

    fn or_stated(&mut self, name: &str, stated: f64) -> Vec<f64> {
        self.optional(name).unwrap_or_else(|| vec![stated; self.recording.len()])
    }

    fn number(&self, key: &'static str, sign: Sign) -> Result<Option<f64>, CutInputError> {
        let Some(text) = self.recording.metadata(key) else { return Ok(None) };
        let good = |x: &f64| x.is_finite() && (*x > 0.0 || (sign == Sign::NotNegative && *x >= 0.0));
        let value = text.trim().parse().ok().filter(good);
        let wrong = || CutInputError::Metadata {
            recording: self.recording.experiment.clone(),
            key,
            found: text.escape_debug().to_string(),
            expected: if sign == Sign::Positive { "a number above zero" } else { "zero or a number above" },
        };
        value.map(Some).ok_or_else(wrong)
    }
}

/// How a cut ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CutOutcome {
    /// Small vibration died out.
    Stable,
    /// It grew.
    Chatter,
}

impl CutOutcome {
    /// Name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            CutOutcome::Stable => "stable",
            CutOutcome::Chatter => "chatter",
        }
    }

    /// The outcome of that name, in letters of either case; any other word is a cut that nobody judged.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        [CutOutcome::Stable, CutOutcome::Chatter]
            .into_iter()
            .find(|o| o.name().eq_ignore_ascii_case(name.trim()))
    }
}

/// One cut of constant condition. `None`: not known.
#[derive(Debug, Clone, PartialEq)]
pub struct CutRow {
    /// Its name.
    pub cut: String,
    /// Speed, rpm.
    pub spindle_speed_rpm: f64,
    /// Width of cut of each tool, m.
    pub width_m: f64,
    /// How it ended; `None`: not judged.
    pub outcome: Option<CutOutcome>,
    /// The word that stands in the table.
    pub outcome_word: String,
    /// What else is known of it.
    pub known: KnownOfCut,
}

/// The optional columns of a table of cuts.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct KnownOfCut {
    /// Feed per turn, m.
    pub feed_m_rev: Option<f64>,
    /// Tools from the chuck, m.
    pub tool_position_m: Option<f64>,
    /// theta_2 - theta_1, rad.
    pub pitch_difference_rad: Option<f64>,
    /// Diameter of the work, m.
    pub workpiece_diameter_m: Option<f64>,
    /// Strongest line, at chatter its frequency, Hz.
    pub line_hz: Option<f64>,
    /// Growth of the vibration, 1/s.
    pub growth_1_s: Option<f64>,
    /// Standard error of the growth, 1/s.
    pub growth_se_1_s: Option<f64>,
    /// Mean radial force of tool 1, N.
    pub tool1_radial_force_n: Option<f64>,
    /// Mean radial force of tool 2, N.
    pub tool2_radial_force_n: Option<f64>,
    /// Mean tangential force, N.
    pub cutting_force_n: Option<f64>,
    /// Mean force along the feed, N.
    pub feed_force_n: Option<f64>,
    /// When it began, on the clock of the table, s.
    pub started_s: Option<f64>,
}

/// A table of cuts, in the order of the file.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CutTable {
    /// One a cut.
    pub rows: Vec<CutRow>,
    /// Columns of the file that a diagnosis does not know.
    pub ignored_columns: Vec<String>,
}

impl CutTable {
    /// Whether the cuts have room on the stated work. Errors: the first value that has none.
    pub(crate) fn check(&self, scenario: &Scenario) -> Result<(), CutInputError> {
        let room = Room::of(scenario);
        for row in &self.rows {
            let (feed_m, place_m) = (row.known.feed_m_rev, row.known.tool_position_m);
            let of_row = [
                ("width_m", Some(row.width_m), room.is_on_radius(row.width_m), Room::ON_RADIUS),
                ("feed_m_rev", feed_m, feed_m.is_none_or(|x| room.is_on_radius(x)), Room::ON_RADIUS),
                ("tool_position_m", place_m, place_m.is_none_or(|x| room.is_along_bar(x)), Room::ALONG_BAR),
            ];
            let bad = of_row.into_iter().find(|(_, _, good, _)| !good);
            if let Some((column, Some(value), _, expected)) = bad {
                return Err(CutInputError::NoSuchCut { cut: row.cut.clone(), column, value, expected });
            }
        }
        Ok(())
    }
}

/// What a diagnosis of the cut is asked with: recordings, a table, or both.
#[derive(Debug, Clone, Copy)]
pub struct CutEvidence<'a> {
    /// Recordings of cuts.
    pub recordings: &'a [CutRecording],
    /// A table of cuts.
    pub table: Option<&'a CutTable>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::Column;

    fn recording(names: &[&str], metadata: &[(&str, &str)]) -> Recording {
        let column = |name: &&str| {
            let middle = if name.ends_with("force_n") { 0.02 } else { 0.01 };
            Column { name: (*name).to_owned(), values: vec![0.01, middle, 0.01] }
        };
        Recording {
            sample_rate: SampleRate::new(9000.0).unwrap(),
            experiment: "entry".to_owned(),
            axes: Vec::new(),
            columns: names.iter().map(column).collect(),
            start_s: 0.0,
            metadata: metadata.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect(),
        }
    }

    /// Two per cent more than commanded, whatever the speed does on the way; degrees are not believed.
    #[test]
    fn a_measured_angle_tells_the_true_speed() {
        let rate = SampleRate::new(9000.0).expect("a rate");
        let commanded: Vec<f64> = (0..18_000).map(|k| if k < 9000 { 1200.0 } else { 900.0 }).collect();
        let mut angle = vec![0.0];
        for s in &commanded[1..] {
            angle.push(angle[angle.len() - 1] + 1.02 * s / 60.0 * std::f64::consts::TAU / 9000.0);
        }
        let factor = turned(&angle, &commanded, rate).expect("a factor");
        assert!((factor - 1.02).abs() < 1e-4, "{factor}");
        let degrees: Vec<f64> = angle.iter().map(|a| a.to_degrees()).collect();
        let factor = turned(&degrees, &commanded, rate).expect("a factor");
        assert!(!SAME_SHAFT.contains(&factor), "{factor}");
    }

    #[test]
    fn force_and_speed_are_enough_and_what_is_missing_is_told() {
        let scenario = Scenario::default();
        let least = recording(&["tool1_radial_force_n", "spindle_speed_rpm"], &[]);
        let cut = CutRecording::new(&least, &scenario).unwrap();
        assert_eq!(cut.missing.len(), REPLACED.len() - 1, "the force of one tool is there");
        assert_eq!(cut.width_m, [scenario.cutting.raw().width_m; 3]);
        assert!(cut.forces_n[1].is_none() && cut.displacement_m.is_none() && !cut.signal_is_stated);
        let probe = ["tool2_radial_force_n", "spindle_speed_rpm", "workpiece_displacement_m", "width_m"];
        let cut = CutRecording::new(&recording(&probe, &[("force_delay_s", "5e-4")]), &scenario).unwrap();
        assert!(cut.missing.iter().all(|m| m.name != "width_m" && m.name != "workpiece_displacement_m"));
        assert!((cut.signal.delay_s - 5e-4).abs() < 1e-18 && cut.signal.bandwidth_hz.is_none());
        assert!(cut.signal_is_stated, "one of both is enough");
    }

    /// Tools travel with the feed: who does not say where they are says at least how fast.
    #[test]
    fn tools_that_nobody_places_travel_with_the_feed() {
        let scenario = Scenario::default();
        let mut told = recording(&["tool1_radial_force_n", "spindle_speed_rpm", "feed_m_rev"], &[]);
        told.columns[1].values = vec![600.0, 1200.0, 1200.0];
        told.columns[2].values = vec![1e-3, 2e-3, 2e-3];
        let cut = CutRecording::new(&told, &scenario).unwrap();
        let way: Vec<f64> = cut.tool_position_m.iter().map(|z| scenario.tools.position_m() - z).collect();
        let expected = [0.0, 1e-3 * 10.0 / 9000.0, (1e-3 * 10.0 + 2e-3 * 20.0) / 9000.0];
        assert!(way.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{way:?}");
        assert_eq!(first_pause(&[0.0, 1.0, 1.0, 0.0, 1.0]), Some(3));
        assert_eq!(first_pause(&[0.0, 1.0, 1.0]), None);
    }

    #[test]
    fn what_is_no_cut_is_refused_by_name() {
        let refused = |names: &[&str], metadata: &[(&str, &str)]| {
            CutRecording::new(&recording(names, metadata), &Scenario::default()).unwrap_err().to_string()
        };
        assert!(refused(&["spindle_speed_rpm"], &[]).contains("tool1_radial_force_n"));
        assert!(refused(&["tool1_radial_force_n"], &[]).contains("spindle_speed_rpm"));
        let good = ["tool1_radial_force_n", "spindle_speed_rpm"];
        assert!(refused(&good, &[("force_bandwidth_hz", "0")]).contains("force_bandwidth_hz is `0`"));
        let mut negative = recording(&[&good[..], &["width_m"]].concat(), &[]);
        negative.columns[2].values[1] = -0.1;
        let error = CutRecording::new(&negative, &Scenario::default()).unwrap_err().to_string();
        assert!(error.contains("column width_m, row 1: -0.1"), "{error}");
        // Units that are not the contract's, and a column of a channel that is not connected.
        let radius = Scenario::default().workpiece.diameter_m() / 2.0;
        for (column, value) in [("width_m", radius), ("feed_m_rev", 0.2), ("tool_position_m", 180.0)] {
            let mut other = recording(&[&good[..], &[column]].concat(), &[]);
            other.columns[2].values[2] = value;
            let error = CutRecording::new(&other, &Scenario::default()).unwrap_err().to_string();
            assert!(error.contains(&format!("column {column}, row 2: {value}; expected m")), "{error}");
        }
        let mut turning = recording(&[&good[..], &["spindle_angle_rad"]].concat(), &[]);
        turning.columns[1].values = vec![1200.0; 3];
        turning.columns[2].values = (0..3).map(|k| f64::from(k) * 20.0 * 360.0 / 9000.0).collect();
        let error = CutRecording::new(&turning, &Scenario::default()).unwrap_err().to_string();
        assert!(error.contains("turns 57.296 times as far as spindle_speed_rpm says"), "{error}");
        let mut silent = recording(&good, &[]);
        silent.columns[0].values = vec![0.0; 3];
        let error = CutRecording::new(&silent, &Scenario::default()).unwrap_err().to_string();
        assert!(
            error.contains("no column tool1_radial_force_n or tool2_radial_force_n that moves"),
            "{error}"
        );
    }
}
