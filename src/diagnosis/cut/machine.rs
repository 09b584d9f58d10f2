//! A machine as a point of the fit: numbers of the scenario that may be wrong, noise, and effects.

use super::input::{CutEvidence, CutRow};
use super::laws::{Law, Scales, Term};
use crate::plant::cut_effects::Physics;
use crate::plant::cut_loop::{RANDOM_FORCE_CORNER_HZ, random_force_spectrum_1_hz};
use crate::plant::cut_terms::{ChipMemory, CutCondition, CutTerms};
use crate::plant::effects::Port;
use crate::plant::scenario::{RawScenario, Scenario, ToolCount};

/// Noise of the cut and of its signals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Noise {
    /// nu: random part of the force over its mean.
    pub(crate) random_share: f64,
    /// Corner of the random force over the stated one: a chip that breaks is no resistor, and a force that
    /// lags may lag with its random part or without.
    pub(crate) corner_factor: f64,
    /// Added to the commanded difference of pitch, rad.
    pub(crate) pitch_rad: f64,
    /// e1: noise of the force signal at low frequency, in sqrt(1e-3 N^2/Hz).
    pub(crate) sensor: f64,
    /// e2: how it rises by 1 kHz, (1 + e2 (f/1 kHz)^2).
    pub(crate) sensor_rise: f64,
    /// Share of it, at low frequency, that is white behind the filter: an amplifier's, a converter's.
    pub(crate) sensor_behind: f64,
    /// How late the recorded force is against the motion that it drives, s. A signal is known to some
    /// microseconds only, and each of them acts as a damping of K times that.
    pub(crate) late_s: f64,
    /// How late the force signal is against the probe beyond what is stated, s: both are known to as much.
    pub(crate) signal_late_s: f64,
    /// Corner of the force signal's low-pass over the stated one: known to a per cent or so.
    pub(crate) bandwidth_factor: f64,
    /// Noise of the probe, rms, m.
    pub(crate) probe_m: f64,
    /// How far the growth of a whole cut lies from that of its nominal condition, rms, 1/s.
    pub(crate) growth_spread_1_s: f64,
    /// Growth within which the outcome of a whole cut is chance, 1/s.
    pub(crate) outcome_spread_1_s: f64,
    /// How far the line of a whole cut lies from that of its nominal condition, rms, Hz.
    pub(crate) line_spread_hz: f64,
    /// Scatter of mean forces from cut to cut, share.
    pub(crate) force_scatter: f64,
    /// Tangential over radial force, over what is stated.
    pub(crate) cutting_gain: f64,
}

impl Noise {
    /// Of a typical machine: whole cuts are set to 1.5 1/s and 2 %; a random part of 3 %, 0.5 and 1 of the
    /// sensor, 0.2 um of a probe.
    const TYPICAL: Self = Self {
        random_share: 0.03,
        corner_factor: 1.0,
        pitch_rad: 0.0,
        sensor: 0.5,
        sensor_rise: 1.0,
        sensor_behind: 0.0,
        late_s: 0.0,
        signal_late_s: 0.0,
        bandwidth_factor: 1.0,
        probe_m: 0.2e-6,
        growth_spread_1_s: 1.5,
        outcome_spread_1_s: 1.5,
        line_spread_hz: 0.5,
        force_scatter: 0.02,
        cutting_gain: 1.0,
    };

    /// The least random part of a force over its mean that any machine has.
    pub(crate) fn least_random_share() -> f64 {
        let number = Number::RandomShare;
        Self::TYPICAL.random_share * (-number.furthest() * number.log_sd()).exp()
    }

    /// Spectrum of the force signal's own noise before its filter, one-sided, N^2/Hz.
    pub(crate) fn before_filter_n2_hz(&self, frequency_hz: f64) -> f64 {
        let rise = 1.0 + self.sensor_rise * (frequency_hz / 1e3).powi(2);
        1e-3 * (1.0 - self.sensor_behind) * (self.sensor * rise).powi(2)
    }

    /// The same behind it.
    pub(crate) fn behind_filter_n2_hz(&self) -> f64 {
        1e-3 * self.sensor_behind * self.sensor.powi(2)
    }
}

/// A machine of the cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Machine {
    /// Scenario with these numbers and effects.
    pub(crate) scenario: Scenario,
    /// Noise.
    pub(crate) noise: Noise,
    /// What the force on a vibrating chip is over the scenario's.
    pub(crate) memory: ChipMemory,
}

impl Machine {
    /// What the force law and the bar are under a condition, as the recordings show it.
    pub(crate) fn terms(&self, at: &CutCondition) -> CutTerms {
        let pitch_difference_rad = at.pitch_difference_rad + self.noise.pitch_rad;
        let mut terms = CutTerms::of(&self.scenario, &CutCondition { pitch_difference_rad, ..*at });
        terms.force_lag_s += self.noise.late_s;
        terms.memory = self.memory;
        terms
    }

    /// The same machine with one number off by a coordinate; `None`: there is none such.
    pub(crate) fn off(&self, number: Number, p: f64) -> Option<Self> {
        let (mut raw, mut noise) = (self.scenario.raw(), self.noise);
        number.put(p, &mut raw, &mut noise);
        Scenario::new(&raw).ok().map(|scenario| Self { scenario, noise, ..*self })
    }

    /// Spectrum of the random force over its variance, one-sided, 1/Hz.
    pub(crate) fn random_1_hz(&self, frequency_hz: f64) -> f64 {
        random_force_spectrum_1_hz(frequency_hz, RANDOM_FORCE_CORNER_HZ * self.noise.corner_factor)
    }
}

/// A number beside the effects that is free in every fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Number {
    /// K_r.
    RadialStiffness,
    /// zeta.
    DampingRatio,
    /// f_n.
    Frequency,
    /// C_i, where it is stated.
    ProcessDamping,
    /// What is added to the commanded difference of pitch.
    Pitch,
    /// nu.
    RandomShare,
    /// Corner of the random force.
    RandomCorner,
    /// e1.
    Sensor,
    /// e2.
    SensorRise,
    /// Logit of the share of the sensor's noise behind the filter.
    SensorBehind,
    /// How late the force is against the motion.
    Late,
    /// How late the force signal is against the probe.
    SignalLate,
    /// Corner of the force signal.
    SignalBandwidth,
    /// Noise of the probe.
    Probe,
    /// Spread of the growth of whole cuts.
    GrowthSpread,
    /// Growth within which outcomes are chance.
    OutcomeSpread,
    /// Spread of the lines of whole cuts.
    LineSpread,
    /// Scatter of mean forces.
    ForceScatter,
    /// Tangential over radial force.
    CuttingGain,
}

impl Number {
    /// Standard deviation of its logarithm (where it has one): the stated bound over sqrt 3, a little
    /// widened; 1.5 for noise.
    pub(crate) fn log_sd(self) -> f64 {
        match self {
            Number::RadialStiffness => 0.10,
            Number::DampingRatio => 0.20,
            Number::Frequency => 0.0125,
            Number::ProcessDamping => 0.13,
            Number::RandomShare
            | Number::Sensor
            | Number::SensorRise
            | Number::SensorBehind
            | Number::Probe => 1.5,
            Number::RandomCorner => 0.3,
            // A tenth of a degree: what a turret is set to.
            Number::Pitch => 2e-3,
            // A fiftieth of a sample at 9 kHz, s: not a logarithm.
            Number::Late | Number::SignalLate => 2e-6,
            Number::SignalBandwidth => 0.01,
            Number::GrowthSpread | Number::OutcomeSpread | Number::LineSpread | Number::ForceScatter => 1.0,
            // Of the tools and materials of handbooks: 1.4 to 3.
            Number::CuttingGain => 0.3,
        }
    }

    /// The last coordinate that any machine has, either way: a K_r off by a factor of three, a frequency by a
    /// sixth, e^9 of a noise; further is another machine.
    pub(crate) fn furthest(self) -> f64 {
        match self {
            // Later than 4 us, or narrower than 2 %, is no tolerance but an effect.
            Number::Late | Number::SignalLate | Number::SignalBandwidth => 2.0,
            // Three degrees: more is another angle.
            Number::Pitch => 25.0,
            n if n.is_stated() => 12.0,
            _ => 6.0,
        }
    }

    /// Key of the scenario, what it says, and the same at a coordinate; `None`: no number of the scenario.
    pub(crate) fn stated(self, scenario: &Scenario, p: f64) -> Option<(&'static str, [f64; 2])> {
        let (bar, cutting) = (scenario.workpiece.raw(), scenario.cutting.raw());
        let (name, nominal) = match self {
            Number::RadialStiffness => ("radial_stiffness_pa", cutting.radial_stiffness_pa),
            Number::DampingRatio => ("damping_ratio", bar.damping_ratio),
            Number::Frequency => match bar.tap_test {
                Some(tap) => ("natural_frequency_hz", tap.natural_frequency_hz),
                None => ("clamp_factor", bar.clamp_factor),
            },
            Number::ProcessDamping => ("process_damping_n", cutting.process_damping_n),
            Number::Pitch => return Some(("pitch_difference_rad", [0.0, p * self.log_sd()])),
            _ => return None,
        };
        Some((name, [nominal, nominal * (p * self.log_sd()).exp()]))
    }

    /// Puts the number of a coordinate into a machine.
    fn put(self, p: f64, raw: &mut RawScenario, noise: &mut Noise) {
        let factor = (p * self.log_sd()).exp();
        match self {
            Number::RadialStiffness => raw.cutting.radial_stiffness_pa *= factor,
            Number::DampingRatio => raw.workpiece.damping_ratio *= factor,
            Number::Frequency => raw.workpiece = raw.workpiece.with_frequency_factor(factor),
            Number::ProcessDamping => raw.cutting.process_damping_n *= factor,
            Number::Pitch => noise.pitch_rad += p * self.log_sd(),
            Number::RandomShare => noise.random_share *= factor,
            Number::RandomCorner => noise.corner_factor *= factor,
            Number::Sensor => noise.sensor *= factor,
            Number::SensorRise => noise.sensor_rise *= factor,
            Number::SensorBehind => noise.sensor_behind = factor / (1.0 + factor),
            Number::Late => noise.late_s += p * self.log_sd(),
            Number::SignalLate => noise.signal_late_s += p * self.log_sd(),
            Number::SignalBandwidth => noise.bandwidth_factor *= factor,
            Number::Probe => noise.probe_m *= factor,
            Number::GrowthSpread => noise.growth_spread_1_s *= factor,
            Number::OutcomeSpread => noise.outcome_spread_1_s *= factor,
            Number::LineSpread => noise.line_spread_hz *= factor,
            Number::ForceScatter => noise.force_scatter *= factor,
            Number::CuttingGain => noise.cutting_gain *= factor,
        }
    }

    /// Where it acts.
    pub(crate) fn port(self) -> Port {
        match self {
            Number::Frequency | Number::DampingRatio => Port::Workpiece,
            Number::Pitch => Port::Turret,
            _ => Port::Process,
        }
    }

    /// Deviations within which a number is what it is stated to be, though it need not be exactly: a turret
    /// is set to a tenth of a degree.
    pub(crate) fn set_within(self) -> f64 {
        if self == Number::Pitch { 1.0 } else { 0.0 }
    }

    /// True for a number of the scenario.
    pub(crate) fn is_stated(self) -> bool {
        matches!(
            self,
            Number::RadialStiffness
                | Number::DampingRatio
                | Number::Frequency
                | Number::ProcessDamping
                | Number::Pitch
        )
    }
}

/// What is stated, and what is free in every fit.
#[derive(Debug, Clone)]
pub(crate) struct Frame {
    /// The scenario as stated.
    pub(crate) stated: Scenario,
    /// Free numbers.
    pub(crate) numbers: Vec<Number>,
    /// Sizes to which the coordinates of the effects are referred.
    pub(crate) scales: Scales,
}

/// A point of the fit: coordinates of the free numbers, and effects with theirs.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Point {
    /// ln(number/stated)/sd, one a number of the frame.
    pub(crate) numbers: Vec<f64>,
    /// Effects.
    pub(crate) terms: Vec<Term>,
}

impl Point {
    /// All coordinates in a row: numbers, then those of each effect.
    pub(crate) fn coordinates(&self) -> Vec<f64> {
        let terms = self.terms.iter().flat_map(|t| t.values.iter());
        self.numbers.iter().chain(terms).copied().collect()
    }

    /// The same point with other coordinates.
    pub(crate) fn with(&self, coordinates: &[f64]) -> Self {
        let mut out = self.clone();
        let mut next = coordinates.iter().copied();
        let terms = out.terms.iter_mut().flat_map(|t| t.values.iter_mut());
        for (slot, value) in out.numbers.iter_mut().chain(terms).zip(&mut next) {
            *slot = value;
        }
        out
    }
}

impl Frame {
    /// Frame of a scenario and what is handed in with it.
    pub(crate) fn of(stated: &Scenario, evidence: &CutEvidence<'_>) -> Self {
        let mut numbers = vec![Number::RadialStiffness, Number::DampingRatio, Number::Frequency];
        if stated.cutting.raw().process_damping_n > 0.0 {
            numbers.push(Number::ProcessDamping);
        }
        if !evidence.recordings.is_empty() {
            let noise = [Number::RandomShare, Number::RandomCorner, Number::Sensor, Number::SensorRise];
            numbers.extend(noise.into_iter().chain([Number::Late]));
            if evidence.recordings.iter().any(|r| r.signal.bandwidth_hz.is_some()) {
                numbers.push(Number::SensorBehind);
            }
            if stated.tools.count() == ToolCount::Two {
                numbers.push(Number::Pitch);
            }
        }
        if evidence.recordings.iter().any(|r| r.displacement_m.is_some()) {
            numbers.extend([Number::Probe, Number::SignalLate]);
            if evidence.recordings.iter().any(|r| r.signal.bandwidth_hz.is_some()) {
                numbers.push(Number::SignalBandwidth);
            }
        }
        let mut scales = Scales::of(stated);
        if let Some(bandwidth_hz) = evidence.recordings.iter().find_map(|r| r.signal.bandwidth_hz) {
            scales.bandwidth_hz = bandwidth_hz;
        }
        if let Some(table) = evidence.table {
            let any = |of: fn(&CutRow) -> bool| table.rows.iter().any(of);
            if any(|r| r.known.growth_1_s.is_some()) {
                numbers.push(Number::GrowthSpread);
            }
            if any(|r| r.outcome.is_some()) {
                numbers.push(Number::OutcomeSpread);
            }
            if any(|r| r.known.line_hz.is_some()) {
                numbers.push(Number::LineSpread);
            }
            let radial = any(|r| r.known.tool1_radial_force_n.or(r.known.tool2_radial_force_n).is_some());
            let cutting = any(|r| r.known.cutting_force_n.is_some());
            if radial || cutting {
                numbers.push(Number::ForceScatter);
            }
            if cutting {
                numbers.push(Number::CuttingGain);
            }
            let last_s = table.rows.iter().filter_map(|r| r.known.started_s).fold(0.0, f64::max);
            scales.duration_s = scales.duration_s.max(last_s);
        }
        Self { stated: *stated, numbers, scales }
    }

    /// True where there is a probe on the bar.
    pub(crate) fn probe(&self) -> bool {
        self.numbers.contains(&Number::Probe)
    }

    /// True where there are rows of a table.
    pub(crate) fn has_table(&self) -> bool {
        let of_table =
            |n: &Number| matches!(n, Number::GrowthSpread | Number::OutcomeSpread | Number::ForceScatter);
        self.numbers.iter().any(of_table)
    }

    /// True where there are recordings.
    pub(crate) fn has_recordings(&self) -> bool {
        self.numbers.contains(&Number::Sensor)
    }

    /// The stated number of a point that ends at the last value that any machine has, with its coordinate.
    pub(crate) fn at_bound(&self, point: &Point) -> Option<(Number, f64)> {
        let mut stated = self.numbers.iter().copied().zip(point.numbers.iter().copied());
        stated.find(|(n, p)| n.is_stated() && p.abs() > n.furthest() - 1e-6)
    }

    /// A point with the numbers of the scenario as they are stated; noise and effects as they are.
    pub(crate) fn as_stated(&self, point: &Point) -> Point {
        let of = |(n, p): (&Number, &f64)| if n.is_stated() { 0.0 } else { *p };
        Point {
            numbers: self.numbers.iter().zip(&point.numbers).map(of).collect(),
            terms: point.terms.clone(),
        }
    }

    /// A point with the numbers that it has for those of the scenario; noise as is typical.
    pub(crate) fn with_typical_noise(&self, point: &Point) -> Point {
        let of = |(n, p): (&Number, &f64)| if n.is_stated() { *p } else { 0.0 };
        Point {
            numbers: self.numbers.iter().zip(&point.numbers).map(of).collect(),
            terms: point.terms.clone(),
        }
    }

    /// The same point with a chip that meets all of the surface which was left; `None`: it does so as stated.
    pub(crate) fn with_past(&self, point: &Point) -> Option<Point> {
        let mut out = point.clone();
        out.terms.push(Term { law: Law::Overlap, values: vec![1.0] });
        (!self.stated.cutting.raw().regeneration).then_some(out)
    }

    /// The stated structure with its stated numbers.
    pub(crate) fn origin(&self) -> Point {
        Point { numbers: vec![0.0; self.numbers.len()], terms: Vec::new() }
    }

    /// The cut as stated, with this noise: it is that of the recordings, whatever is stated of the cut.
    pub(crate) fn stated_in(&self, noise: Noise) -> Option<Machine> {
        Some(Machine { noise, ..self.machine(&self.origin())? })
    }

    /// Bounds of every coordinate of a point.
    pub(crate) fn bounds(&self, point: &Point) -> Vec<[f64; 2]> {
        let numbers = self.numbers.iter().map(|n| [-n.furthest(), n.furthest()]);
        numbers.chain(point.terms.iter().flat_map(|t| t.law.coordinates().iter().map(|c| c.bounds))).collect()
    }

    /// Centres and standard deviations of the priors of every coordinate.
    pub(crate) fn priors(&self, point: &Point) -> Vec<[f64; 2]> {
        let numbers = self.numbers.iter().map(|_| [0.0, 1.0]);
        numbers.chain(point.terms.iter().flat_map(|t| t.law.coordinates().iter().map(|c| c.prior))).collect()
    }

    /// The machine of a point; `None`: there is none such.
    pub(crate) fn machine(&self, point: &Point) -> Option<Machine> {
        let mut raw = self.stated.raw();
        let mut noise = Noise::TYPICAL;
        for (number, p) in self.numbers.iter().zip(&point.numbers) {
            number.put(*p, &mut raw, &mut noise);
        }
        let effects = point.terms.iter().filter_map(|t| t.effect(&self.scales));
        raw.physics = effects.into_iter().try_fold(raw.physics, Physics::with).ok()?;
        let memory = point.terms.iter().find_map(Term::memory).unwrap_or(ChipMemory::NONE);
        Scenario::new(&raw).ok().map(|scenario| Machine { scenario, noise, memory })
    }
}
