//! Numbers of the model beside the recordings: deviations, corrections, numbers that the model leaves out.

use super::accepted::Accepted;
use super::columns::TimeColumn;
use super::evidence::{Wider, level, part_gains, price, wider};
use super::given;
use super::gram::{BandGram, Gram, Part};
use super::laws::{Deviations, scale_deviation};
use super::likelihood::{Design, FREE, Fit, Spread, values, weights_of};
use super::model::screw_kg_m2;
use super::number::Mechanics;
use super::rest::{Rest, rest};
use super::rounding::QUARTERS;
use super::signals::Layout;
use super::spectra::FOLDS;
use super::state::{Balance, Base, LAG_STEP, Number, State, knockoff_design, stated_mechanics};
use super::subject::slopes;
use crate::diagnosis::criteria::{Criteria, Z95};
use crate::diagnosis::result::Correction;
use crate::plant::effects::Port;
use crate::plant::effects::current_loop_lag::BANDWIDTH;
use crate::plant::machine::AxisModel;
use nalgebra::DVector;

/// Deviations of everything that was fitted.
#[derive(Debug, Clone, Default)]
pub(super) struct Doubt {
    /// Of each number, in the order of the balance.
    pub(super) numbers: Vec<f64>,
    /// Of each law.
    pub(super) laws: Vec<Deviations>,
    /// Of the delay, s, and of the logarithm of the bandwidth.
    pub(super) path: [f64; 2],
}

/// Deviations with all shapes free at once, see [`super::likelihood::Fit::variances`], wider by what is left
/// above the floor.
pub(super) fn doubt(balance: &Balance, state: &State, rest: &Rest) -> Doubt {
    let base = &state.base;
    let plan = &balance.plan;
    let mut columns: Vec<TimeColumn> = Vec::new();
    for a in state.accepted.iter().filter(|a| !a.is_one_column()) {
        columns.extend(slopes(balance, state, &a.hypothesis, &a.amplitudes));
    }
    let free = vec![FREE; columns.len()];
    let Wider { gram, bands, design, start } = wider(balance, base.fitted(), (&columns, free));
    let weights = design.weights(&bands, &start);
    let fit = design.fit(&bands, start, weights);
    let weights = design.weights(&bands, &fit.beta);
    let scores = scores(balance, (&gram, &design), (&bands, &weights), &fit.beta);
    let by_band = design.noise_by_band(&gram.sum_by_band(plan), (&bands, &weights), &fit.beta);
    let variances = fit.variances(&scores, &by_band);
    let wider = 1.0_f64.hypot(rest.force_n / rest.floor_n.max(1e-300));
    let sd = |k: usize| wider * variances[k].max(0.0).sqrt().hypot(by_rounding(base, k));
    let numbers = (0..base.numbers.len()).map(sd).collect();
    let (mut place, mut slope) = (base.numbers.len(), base.fit.beta.len());
    let mut laws = Vec::new();
    for a in &state.accepted {
        let n = a.coefficients();
        let amplitudes = if a.is_one_column() {
            a.amplitudes.iter().map(|x| x.abs() * sd(place)).collect()
        } else {
            (place..place + n).map(sd).collect()
        };
        let constants = if a.is_one_column() { 0 } else { a.hypothesis.constants() };
        laws.push(Deviations { amplitudes, constants: (slope..slope + constants).map(sd).collect() });
        (place, slope) = (place + n, slope + constants);
    }
    let of = |number| base.numbers.iter().position(|n| *n == number).map_or(0.0, sd);
    Doubt { numbers, laws, path: [of(Number::Timing), -LAG_STEP.ln() * of(Number::Lag)] }
}

/// Deviation of a coefficient by the steps of the position.
fn by_rounding(base: &Base, place: usize) -> f64 {
    let fits = &base.knockoff_fits[QUARTERS.len()..];
    let power: f64 = fits.iter().filter_map(|f| f.beta.get(place)).map(|b| b * b).sum();
    (power / fits.len().max(1) as f64).sqrt()
}

/// Scores of each quarter of each recording.
fn scores(
    balance: &Balance,
    (gram, design): (&Gram, &Design),
    (bands, weights): (&[BandGram], &[Spread]),
    beta: &[f64],
) -> Vec<DVector<f64>> {
    let mut out = Vec::new();
    for fold in 0..FOLDS {
        let part = gram.sum(&balance.plan, Part::Fold(fold));
        for recording in 0..balance.plan.recordings() {
            let own: Vec<BandGram> = part.iter().filter(|b| b.recording == recording).cloned().collect();
            let weights = weights_of(&own, (bands, weights));
            out.push(design.score(&own, &weights, beta));
        }
    }
    out
}

/// A number of the structure that the model leaves out or states as nothing, with its evidence.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Absent {
    pub(super) number: Number,
    pub(super) value: f64,
    pub(super) deviation: f64,
    /// T of its column, nats.
    pub(super) evidence_nats: f64,
}

impl Absent {
    /// Where such a number enters.
    pub(super) fn port_of(balance: &Balance, number: Number) -> Port {
        let one = balance.signals.sides() == 1;
        if one || number.is_of_stage() { Port::Stage } else { Port::Motor }
    }
}

/// What a model states at the motor of a number that the balance has as one with the stage's.
pub(super) fn stated_at_motor(balance: &Balance, number: Number) -> f64 {
    let of_motor = number.of_motor().filter(|_| balance.signals.layout != Layout::TwoPositions);
    of_motor.map_or(0.0, |motor| stated_mechanics(balance).of(motor))
}

/// A number's estimate in the balance.
fn estimate(state: &State, (place, number): (usize, Number)) -> f64 {
    if number == Number::StageCoulomb { state.coulomb_n() } else { state.base.fit.beta[place] }
}

/// Numbers that are effects of the vocabulary and that the model leaves out, of both sides. Of one that is
/// stated at the motor alone what there is more than that.
fn left_out(balance: &Balance, state: &State) -> Vec<Number> {
    let (stated, apart) = (stated_mechanics(balance), Criteria::STANDARD.correction_tolerances);
    let is_more = |number: Number| {
        let at_motor = stated_at_motor(balance, number);
        let place = state.base.numbers.iter().position(|n| *n == number);
        let least = number.key().map_or(0.0, |(_, tolerance)| (apart * tolerance).exp());
        at_motor == 0.0 || place.is_some_and(|k| estimate(state, (k, number)) > least * at_motor)
    };
    let own_is_stated = |n: &Number| stated.of(*n) > stated_at_motor(balance, *n);
    let open = balance.numbers().into_iter().filter(|n| n.effect().is_some() && !own_is_stated(n));
    open.filter(|n| is_more(*n)).collect()
}

/// What is held where some numbers are as they are stated, by place: nothing of those that are left out, or
/// what the motor has of one.
fn held_as_stated(balance: &Balance, state: &State, numbers: &[Number]) -> Vec<(usize, f64)> {
    let stated = stated_numbers(balance, state);
    // Parts of a dry friction that is not there are not there.
    let is_gone = |n: Number| numbers.contains(&n) && stated_mechanics(balance).of(n) == 0.0;
    let is_part = |n: &Number| match n {
        Number::MotorTurning(_) => is_gone(Number::MotorCoulomb),
        Number::StageTurning(_) => is_gone(Number::StageCoulomb),
        _ => false,
    };
    let number = |(k, n): (usize, &Number)| (numbers.contains(n) || is_part(n)).then(|| (k, stated.of(*n)));
    let bristle = |(k, a): (usize, &Accepted)| {
        let is_bristle = a.given.is_none() && a.hypothesis.facts().is_dry_friction;
        let places = state.place(k)..state.place(k) + a.coefficients();
        places.filter(move |_| is_bristle).map(|place| (place, 0.0))
    };
    let bristles =
        state.accepted.iter().enumerate().filter(|_| is_gone(Number::StageCoulomb)).flat_map(bristle);
    state.base.numbers.iter().enumerate().filter_map(number).chain(bristles).collect()
}

/// The design with some numbers held as they are stated, and where a fit begins. The masses stay as the state
/// has them: that friction is left out is no reason for another mass, and where nothing else moves the axis
/// one of any size is the likeliest.
fn as_stated(balance: &Balance, state: &State, numbers: &[Number]) -> (Design, Vec<f64>) {
    let (mut design, mut beta) = (state.base.design.clone(), state.base.fit.beta.clone());
    held_as_stated(balance, state, numbers).into_iter().for_each(|(k, value)| beta[k] = value);
    let masses = design.masses.iter().map(|(k, _)| (*k, beta[*k])).collect::<Vec<_>>();
    let held = held_as_stated(balance, state, numbers).into_iter().chain(masses);
    held.for_each(|(k, value)| design.bounds[k] = [value; 2]);
    (design, beta)
}

/// The fit of a state whose `numbers` are as they are stated: nothing, of those that are left out.
pub(super) fn fit_as_stated(balance: &Balance, state: &State, numbers: &[Number]) -> (Design, Vec<f64>) {
    let (design, fit) = refitted(balance, state, numbers);
    (design, fit.beta)
}

fn refitted(balance: &Balance, state: &State, numbers: &[Number]) -> (Design, Fit) {
    if numbers.is_empty() {
        return (state.base.design.clone(), state.base.fit.clone());
    }
    let (design, start) = as_stated(balance, state, numbers);
    let all = &state.base.all;
    let weights = design.weights(all, &start);
    let fit = design.fit(all, start, weights);
    (design, fit)
}

/// A state as it is written.
pub(super) struct AsWritten {
    /// Without numbers that nothing says, others as they are stated.
    pub(super) state: State,
    /// Its deviations; of masses, and of when a force acts, as they were beside all numbers.
    pub(super) doubt: Doubt,
    /// What is said.
    pub(super) absent: Vec<Absent>,
    /// What is not: the model that is written has none of it.
    pub(super) unsaid: Vec<Number>,
    /// See [`contested`]: the model that is written has them as they were.
    pub(super) contested: Vec<Contested>,
    /// See [`undivided`].
    pub(super) undivided: Option<[f64; 2]>,
}

impl AsWritten {
    /// Numbers that are held as they are stated.
    pub(super) fn held(&self) -> Vec<Number> {
        held(&self.unsaid, &self.contested)
    }

    /// The same with [`contested`] numbers as they are stated; `axis`: the stated one. Deviations are those
    /// of the fit.
    pub(super) fn judged(self, balance: &Balance, axis: &AxisModel) -> Self {
        let contested = contested(balance, axis, &self.state, &self.doubt);
        if contested.is_empty() {
            return self;
        }
        let state = refitted_as_is(balance, &self.state, &held(&self.unsaid, &contested));
        Self { state, contested, ..self }
    }
}

/// Numbers that nothing says, and contested ones.
pub(super) fn held(unsaid: &[Number], contested: &[Contested]) -> Vec<Number> {
    unsaid.iter().copied().chain(contested.iter().map(|c| c.number)).collect()
}

/// A state with its deviations as it is written; `level`: what chance reaches.
pub(super) fn as_written(balance: &Balance, (state, beside_all): (&State, Doubt), level: f64) -> AsWritten {
    let mut absent = absent(balance, state, &beside_all, level);
    let contested = Vec::new();
    loop {
        let unsaid = unsaid(balance, state, &absent);
        if unsaid.is_empty() {
            let (state, doubt) = (state.clone(), beside_all);
            return AsWritten { state, doubt, absent, unsaid, contested, undivided: None };
        }
        let written = refitted_as_is(balance, state, &unsaid);
        let mut doubt = doubt(balance, &written, &rest(balance, &written));
        doubt.path = beside_all.path;
        for (k, _) in &written.base.design.masses {
            doubt.numbers[*k] = beside_all.numbers[*k];
        }
        let count = absent.len();
        absent.retain_mut(|a| {
            let told = more_than_at_motor(balance, (&written, &doubt), a.number);
            let (value, deviation) = told.unwrap_or((0.0, 0.0));
            (a.value, a.deviation) = (value, deviation);
            value > Z95 * deviation
        });
        if absent.len() == count {
            let undivided = undivided(balance, state, &unsaid);
            return AsWritten { state: written, doubt, absent, unsaid, contested, undivided };
        }
    }
}

/// A state whose fit has some numbers as they are stated, masses and when a force acts as they are.
fn refitted_as_is(balance: &Balance, state: &State, numbers: &[Number]) -> State {
    let of_time = state.base.numbers.iter().filter(|n| matches!(n, Number::Timing | Number::Lag));
    let held: Vec<Number> = numbers.iter().chain(of_time.clone()).copied().collect();
    let (mut design, fit) = refitted(balance, state, &held);
    for (k, n) in state.base.numbers.iter().enumerate() {
        if !numbers.contains(n) && (n.is_mass() || matches!(n, Number::Timing | Number::Lag)) {
            design.bounds[k] = state.base.design.bounds[k];
        }
    }
    state.fitted_as(design, fit)
}

/// Numbers that the model leaves out and the recordings have, strongest first; `level`: what chance reaches.
fn absent(balance: &Balance, state: &State, doubt: &Doubt, level: f64) -> Vec<Absent> {
    let mut list = Vec::new();
    for number in left_out(balance, state) {
        let Some((value, deviation)) = more_than_at_motor(balance, (state, doubt), number) else { continue };
        let evidence_nats = evidence_nats(balance, state, &[number]);
        if value > Z95 * deviation && evidence_nats > level {
            list.push(Absent { number, value, deviation, evidence_nats });
        }
    }
    list.sort_by(|a, b| b.evidence_nats.total_cmp(&a.evidence_nats));
    list
}

/// A number less what is stated of it at the motor, and its deviation.
fn more_than_at_motor(
    balance: &Balance,
    (state, doubt): (&State, &Doubt),
    number: Number,
) -> Option<(f64, f64)> {
    let k = state.base.numbers.iter().position(|n| *n == number)?;
    let at_motor = stated_at_motor(balance, number);
    let of_statement = number.key().map_or(0.0, |(_, tolerance)| tolerance * at_motor);
    Some((estimate(state, (k, number)) - at_motor, doubt.numbers[k].hypot(of_statement)))
}

/// T of all columns of some numbers together, nats.
fn evidence_nats(balance: &Balance, state: &State, numbers: &[Number]) -> f64 {
    let base = &state.base;
    let (design, beta) = fit_as_stated(balance, state, numbers);
    let score = design.nats(&base.all, &beta) - base.fit.nats - price(numbers.len(), values(&base.all));
    let others = balance.held_out_nats(&base.gram, &design, &beta);
    let gains = part_gains(balance, &others, &base.held_out_nats);
    gains.into_iter().flatten().fold(score, f64::min)
}

/// Evidence of numbers that are missed together, none of which is missed beside the others, and what chance
/// reaches by them in the same recordings, nats: of two that stand for one another the recordings do not say
/// which it is. `None`: none are.
fn undivided(balance: &Balance, state: &State, unsaid: &[Number]) -> Option<[f64; 2]> {
    let base = &state.base;
    let open: Vec<Number> = unsaid.iter().filter(|n| base.numbers.contains(n)).copied().collect();
    let held = held_as_stated(balance, state, &open);
    let cost = price(open.len(), values(&base.all));
    let chance = |(k, null): (usize, &Fit)| {
        let mut design = knockoff_design(&base.design, &base.fit.beta, base.knockoffs + k);
        let mut start = null.beta.clone();
        held.iter().for_each(|(k, _)| (design.bounds[*k], start[*k]) = ([0.0; 2], 0.0));
        let weights = design.weights(&base.all, &start);
        design.fit(&base.all, start, weights).nats - null.nats - cost
    };
    let most_nats = base.knockoff_fits.iter().enumerate().map(chance).fold(0.0, f64::max);
    let level_nats = level(state, (1, most_nats));
    let evidence_nats = if open.is_empty() { 0.0 } else { evidence_nats(balance, state, &open) };
    (evidence_nats > level_nats).then_some([evidence_nats, level_nats])
}

/// Numbers that the model leaves out and nothing says: the model that is written has none of them.
pub(super) fn unsaid(balance: &Balance, state: &State, said: &[Absent]) -> Vec<Number> {
    let all = left_out(balance, state).into_iter();
    all.filter(|number| said.iter().all(|a| a.number != *number)).collect()
}

/// Numbers as they are stated: of dry friction what is not in a stated bristle.
fn stated_numbers(balance: &Balance, state: &State) -> Mechanics {
    let mut m = stated_mechanics(balance);
    let bristles =
        state.accepted.iter().filter(|a| a.given.is_some() && a.hypothesis.facts().is_dry_friction);
    m.stage_coulomb_n = (m.stage_coulomb_n - bristles.map(|a| a.amplitudes[0]).sum::<f64>()).max(0.0);
    m
}

/// The stated numbers in the order of the balance, and its laws as they are stated. What nobody states is as
/// fitted: zero and scale of the encoders, and in what form dry friction turns.
pub(super) fn stated_beta(balance: &Balance, state: &State) -> Vec<f64> {
    let m = stated_numbers(balance, state);
    let fitted =
        |number| state.base.numbers.iter().position(|n| *n == number).map(|k| state.base.fit.beta[k]);
    let same_form = |part: f64, level| {
        let fitted = fitted(level).filter(|fitted| *fitted > 0.0);
        fitted.map_or(0.0, |fitted| part / fitted * m.of(level))
    };
    let number = |(k, n): (usize, &Number)| match n {
        Number::Zero | Number::Scale => state.base.fit.beta[k],
        // What does not accelerate tells no mass: a stated one moves the noise of its acceleration.
        Number::StageMass if !state.now.inertial => state.base.fit.beta[k],
        Number::MotorTurning(_) => same_form(state.base.fit.beta[k], Number::MotorCoulomb),
        Number::StageTurning(_) => same_form(state.base.fit.beta[k], Number::StageCoulomb),
        Number::EncoderTiming => -balance.stage_later_s.unwrap_or(0.0),
        n => m.of(*n),
    };
    let mut beta: Vec<f64> = state.base.numbers.iter().enumerate().map(number).collect();
    beta.extend(state.accepted.iter().map(|_| 1.0));
    beta
}

/// The fitted numbers, those that the model states and the recordings tell as they are stated.
pub(super) fn fitted_as_stated(balance: &Balance, state: &State) -> Vec<f64> {
    let m = stated_numbers(balance, state);
    let mut beta = state.base.fit.beta.clone();
    for (value, number) in beta.iter_mut().zip(&state.base.numbers) {
        let is_told = state.now.inertial || *number != Number::StageMass;
        if number.key().is_some() && is_told && m.of(*number) > 0.0 {
            *value = m.of(*number);
        }
    }
    beta
}

/// A number of the drive beside its estimate.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Beside {
    pub(super) number: Number,
    pub(super) key: &'static str,
    pub(super) nominal: f64,
    pub(super) value: f64,
    pub(super) deviation: f64,
    /// What the balance has with it as one: of the motor's side with one position, of a screw that is stated
    /// beside the motor.
    other: f64,
    tolerance: f64,
}

impl Beside {
    /// What it is where all forces are off by a factor, e^`off`.
    pub(super) fn under(&self, off: f64) -> f64 {
        (self.value + self.other) * (-off).exp() - self.other
    }

    /// How far it is from its statement where all forces are off by e^`off`, as a logarithm.
    fn apart(&self, off: f64) -> f64 {
        ((self.under(off) + self.other).max(0.0) / (self.nominal + self.other)).ln().abs()
    }

    /// True where that is more than numbers are stated to.
    fn is_elsewhere(&self, off: f64) -> bool {
        self.apart(off) > Criteria::STANDARD.correction_tolerances * self.tolerance
    }

    /// True where the recordings contradict it.
    fn is_told_wrong(&self, off: f64) -> bool {
        let share = self.deviation / (self.value + self.other);
        self.value > 0.0
            && self.is_elsewhere(off)
            && self.apart(off) > Criteria::STANDARD.correction_deviations * share
    }

    /// True for a number of a second mass that the model does not have.
    pub(super) fn is_of_second_mass(&self, balance: &Balance) -> bool {
        self.nominal == 0.0 && balance.drive.number(self.key).is_some_and(|guess| guess > 0.0)
    }
}

/// A number that is fitted elsewhere than it is stated, with an interval that reaches to there: nothing says
/// that it is wrong.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Contested {
    pub(super) number: Number,
    pub(super) key: &'static str,
    pub(super) nominal: f64,
    pub(super) fitted: f64,
}

/// Those of a state, unless all forces are off by a factor.
fn contested(balance: &Balance, axis: &AxisModel, state: &State, doubt: &Doubt) -> Vec<Contested> {
    let all = beside(balance, axis, state, doubt);
    if told_scale(balance, &all) != 0.0 {
        return Vec::new();
    }
    let open = all.iter().filter(|n| n.nominal > 0.0 && n.is_elsewhere(0.0) && !n.is_told_wrong(0.0));
    let of = |n: &Beside| Contested { number: n.number, key: n.key, nominal: n.nominal, fitted: n.value };
    open.map(of).collect()
}

/// Every number of the drive that the balance has, in the key's unit; `axis`: as stated.
pub(super) fn beside(balance: &Balance, axis: &AxisModel, state: &State, doubt: &Doubt) -> Vec<Beside> {
    let as_stated = given::folded(axis).drive;
    let r2 = balance.drive.travel_m_rad().powi(2);
    let open = left_out(balance, state);
    let of = |(k, number): (usize, &Number)| -> Option<Beside> {
        if *number == Number::StageMass && !state.now.inertial {
            return None; // what does not accelerate tells no mass
        }
        let at_motor = stated_at_motor(balance, *number);
        // What is stated at the motor alone, and is not more, is the motor's.
        let is_motors = stated_mechanics(balance).of(*number) <= at_motor && !open.contains(number);
        let named = number.of_motor().filter(|_| at_motor > 0.0 && is_motors).unwrap_or(*number);
        let (key, tolerance) = named.key()?;
        let unit = if matches!(named, Number::MotorMass | Number::MotorDamping) { r2 } else { 1.0 };
        let of_screw = if named == Number::MotorMass { screw_kg_m2(axis) } else { 0.0 };
        let other = of_screw + if named == *number { at_motor } else { 0.0 };
        let nominal = as_stated.number(key).unwrap_or(0.0) - of_screw;
        let value = unit * estimate(state, (k, *number)) - other;
        let deviation = unit * doubt.numbers[k];
        Some(Beside { number: *number, key, nominal, value, deviation, other, tolerance })
    };
    state.base.numbers.iter().enumerate().filter_map(of).collect()
}

/// The factor by which all forces are off: the weighted median of the logarithms, that of the torque constant
/// itself among them. 0: none, or nothing that tells.
pub(super) fn common_scale(balance: &Balance, numbers: &[Beside]) -> f64 {
    let c = &Criteria::STANDARD;
    let is_split = numbers.iter().any(|n| n.is_of_second_mass(balance));
    if scale_deviation(balance) == 0.0 || balance.signals.layout != Layout::TwoPositions || is_split {
        return 0.0;
    }
    let told = numbers.iter().filter(|n| n.nominal > 0.0 && n.value > 0.0);
    let mut list: Vec<(f64, f64)> = told
        .map(|n| (n.value + n.other, n))
        .map(|(all, n)| ((all / (n.nominal + n.other)).ln(), 1.0 / n.tolerance.hypot(n.deviation / all)))
        .chain([(0.0, 1.0 / c.torque_constant_tolerance)])
        .collect();
    list.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * list.iter().map(|l| l.1).sum::<f64>();
    let mut sum = 0.0;
    let middle = list.iter().find(|l| {
        sum += l.1;
        sum >= half
    });
    middle.map_or(0.0, |m| m.0)
}

/// That factor where it is more than masses are stated to, else none: 0.
fn told_scale(balance: &Balance, numbers: &[Beside]) -> f64 {
    let c = &Criteria::STANDARD;
    let common = common_scale(balance, numbers);
    if common.abs() > c.correction_tolerances * c.mass_tolerance { common } else { 0.0 }
}

/// True where the force comes later than its motion, whatever its dead time and the sample in which it acts:
/// its clock is another.
pub(super) fn is_late(balance: &Balance, state: &State, doubt: &Doubt) -> bool {
    let within_s = balance.timing_deviation_s(state.coulomb_n());
    let earliest_s = Criteria::STANDARD.timing_samples[0] / balance.signals.rate_hz;
    state.now.found_delay && state.now.path.delay_s < earliest_s - Z95 * doubt.path[0].hypot(within_s)
}

/// Numbers that the recordings contradict.
pub(super) fn corrections(
    balance: &Balance,
    axis: &AxisModel,
    state: &State,
    doubt: &Doubt,
) -> Vec<Correction> {
    let c = &Criteria::STANDARD;
    let all = beside(balance, axis, state, doubt);
    let scale = scale_deviation(balance);
    let off = told_scale(balance, &all);
    let mut list = Vec::new();
    for n in all.iter().filter(|n| n.nominal > 0.0 && n.is_told_wrong(off)) {
        let value = n.under(off);
        let half = Z95 * n.deviation.hypot(scale * (value + n.other));
        list.push(Correction::within(n.key, n.nominal, value, half));
    }
    for n in all.iter().filter(|n| n.is_of_second_mass(balance) && n.value > Z95 * n.deviation) {
        list.push(Correction::within(n.key, 0.0, n.value, Z95 * n.deviation.hypot(scale * n.value)));
    }
    if let Some(nominal) = balance.drive.torque_constant_nm_a().filter(|_| off != 0.0) {
        let value = nominal * (-off).exp();
        let half = Z95 * c.torque_constant_tolerance * value;
        list.push(Correction::within("torque_constant_nm_a", nominal, value, half));
    }
    let stated_s = balance.drive.amplifier_dead_time_s();
    let found_s = state.now.path.delay_s.max(0.0);
    let half_s = Z95 * doubt.path[0].hypot(balance.timing_deviation_s(state.coulomb_n()));
    if state.now.found_delay && found_s + half_s < stated_s && !is_late(balance, state, doubt) {
        list.push(Correction::within("amplifier_dead_time_s", stated_s, found_s, half_s));
    }
    list.extend(quicker_loop(balance, state, doubt));
    list.extend(read_apart(balance, axis, state, doubt));
    if state.now.found_smoothing && axis.drive.raw().friction_smoothing_m_s.is_some() {
        let (nominal, value) = (balance.signals.smoothing_m_s, state.now.smoothing_m_s);
        let told = Correction::within("friction_smoothing_m_s", nominal, value, 0.0);
        list.push(Correction { ci95: [0.9 * value, 1.1 * value], ..told });
    }
    list
}

/// A current loop that is quicker than stated. One at a bound is none.
fn quicker_loop(balance: &Balance, state: &State, doubt: &Doubt) -> Option<Correction> {
    let stated = balance.drive.current_loop_bandwidth_rad_s().filter(|_| state.now.found_loop)?;
    let most = (1.0 - Criteria::STANDARD.at_bound) * BANDWIDTH.bounds[1];
    let found = state.now.path.loop_rad_s.filter(|found| *found < most)?;
    let k = state.base.numbers.iter().position(|n| *n == Number::Lag)?;
    // Of a loop its lag is told.
    let half = Z95 * doubt.path[1].hypot(balance.timing_deviation_s(state.coulomb_n()) * found);
    let told = Correction::within("current_loop_bandwidth_rad_s", stated, found, 0.0);
    let is_told = (found / stated).ln() > half && !state.base.fit.held[k];
    is_told.then(|| Correction { ci95: [-half, half].map(|h| found * h.exp()), ..told })
}

/// How much later one encoder is read than the other, where nobody states when both are. One at a bound is
/// none.
fn read_apart(balance: &Balance, axis: &AxisModel, state: &State, doubt: &Doubt) -> Option<Correction> {
    let k = state.base.numbers.iter().position(|n| *n == Number::EncoderTiming)?;
    let more_s = balance.stage_later_s? + state.base.fit.beta[k];
    let half_s = Z95 * doubt.numbers[k].hypot(Criteria::STANDARD.timing_deviation / balance.signals.rate_hz);
    let stated = given::folded(axis).drive;
    let (key, nominal_s) = if more_s > 0.0 {
        ("stage_encoder_delay_s", stated.stage_encoder_delay_s())
    } else {
        ("motor_encoder_delay_s", stated.motor_encoder_delay_s())
    };
    let told = Correction::within(key, nominal_s, nominal_s + more_s.abs(), half_s);
    (more_s.abs() > half_s && !state.base.fit.held[k]).then_some(told)
}
