//! Numbers of the model beside the recordings: deviations, those that the model leaves out, and what is
//! judged as it is stated.

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
use crate::plant::effects::Port;
use crate::plant::machine::AxisModel;
use nalgebra::DVector;
use std::cell::LazyCell;

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

/// The dry friction that a number is a part of.
fn level_of(number: Number) -> Option<Number> {
    match number {
        Number::MotorTurning(_) => Some(Number::MotorCoulomb),
        Number::StageTurning(_) => Some(Number::StageCoulomb),
        _ => None,
    }
}

/// A part of a dry friction of another level, in the form in which it was fitted.
fn in_same_form(state: &State, place: usize, [fitted, now]: [f64; 2]) -> f64 {
    if fitted > 0.0 { state.base.fit.beta[place] / fitted * now } else { 0.0 }
}

/// What is held where some numbers are as they are stated, by place: nothing of those that are left out, or
/// what the motor has of one.
fn held_as_stated(balance: &Balance, state: &State, numbers: &[Number]) -> Vec<(usize, f64)> {
    let stated = stated_numbers(balance, state);
    let held = |number: &Number| numbers.contains(number);
    let number = |(k, n): (usize, &Number)| match level_of(*n).filter(held) {
        Some(level) => Some((k, in_same_form(state, k, [state.now.mechanics.of(level), stated.of(level)]))),
        None => held(n).then(|| (k, stated.of(*n))),
    };
    let is_gone = held(&Number::StageCoulomb) && stated_mechanics(balance).stage_coulomb_n == 0.0;
    let bristle = |(k, a): (usize, &Accepted)| {
        let is_bristle = a.given.is_none() && a.hypothesis.facts().is_dry_friction;
        let places = state.place(k)..state.place(k) + a.coefficients();
        places.filter(move |_| is_bristle).map(|place| (place, 0.0))
    };
    let bristles = state.accepted.iter().enumerate().filter(|_| is_gone).flat_map(bristle);
    state.base.numbers.iter().enumerate().filter_map(number).chain(bristles).collect()
}

/// The design with some numbers held as they are stated, and where a fit begins. The masses stay as the state
/// has them: that friction is left out is no reason for another mass, and where nothing else moves the axis
/// one of any size is the likeliest. Where it is a mass that is held the others make up for it.
fn as_stated(balance: &Balance, state: &State, numbers: &[Number]) -> (Design, Vec<f64>) {
    let (mut design, mut beta) = (state.base.design.clone(), state.base.fit.beta.clone());
    let held = held_as_stated(balance, state, numbers);
    held.iter().for_each(|(k, value)| beta[*k] = *value);
    let of_masses = design.masses.iter().map(|(k, _)| (*k, beta[*k]));
    let masses: Vec<(usize, f64)> = of_masses.filter(|_| !numbers.iter().any(|n| n.is_mass())).collect();
    held.into_iter().chain(masses).for_each(|(k, value)| design.bounds[k] = [value; 2]);
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
    /// Without numbers that nothing says, contested ones as they are stated.
    pub(super) state: State,
    /// Its deviations; of masses, and of when a force acts, as they were beside all numbers.
    pub(super) doubt: Doubt,
    /// What is said.
    pub(super) absent: Vec<Absent>,
    /// What is not: the model that is written has none of it.
    pub(super) unsaid: Vec<Number>,
    /// See [`contested`]: the model that is written has them as they were.
    pub(super) contested: Vec<Beside>,
    /// See [`undivided`].
    pub(super) undivided: Option<[f64; 2]>,
}

/// Numbers that nothing says, and contested ones.
pub(super) fn held(unsaid: &[Number], contested: &[Beside]) -> Vec<Number> {
    unsaid.iter().copied().chain(contested.iter().map(|c| c.number)).collect()
}

/// A state with its deviations as it is written; `axis`: as stated; `level`: what chance reaches;
/// `stated_rest_n`: what the model states to leave, N. Contested numbers are as stated, but where something
/// was found that then leaves what it did not leave beside them: it is judged beside numbers that fit.
pub(super) fn as_written(
    (balance, axis): (&Balance, &AxisModel),
    (state, beside_all): (&State, Doubt),
    (level, stated_rest_n): (f64, f64),
) -> AsWritten {
    let mut absent = absent(balance, state, &beside_all, level);
    let now = &state.now;
    let nothing_found =
        !now.found_delay && !now.found_loop && state.accepted.iter().all(|law| law.given.is_some());
    // Deviations of a fit with numbers held; `rest`: what they are wider by.
    let doubt_of = |held: &State, rest: &Rest| {
        let mut doubt = doubt(balance, held, rest);
        doubt.path = beside_all.path;
        for (k, _) in &held.base.design.masses {
            doubt.numbers[*k] = beside_all.numbers[*k];
        }
        doubt
    };
    loop {
        let unsaid = unsaid(balance, state, &absent);
        let all_said = unsaid.is_empty();
        let written = if all_said { state.clone() } else { refitted_as_is(balance, state, &unsaid) };
        let left = LazyCell::new(|| rest(balance, &written));
        let mut doubt = if all_said { beside_all.clone() } else { doubt_of(&written, &left) };
        let with = |numbers: &[Number]| {
            let held = refitted_as_is(balance, &written, &[&unsaid[..], numbers].concat());
            let stands = || !rest(balance, &held).is_left(stated_rest_n) || left.is_left(stated_rest_n);
            (nothing_found || stands()).then_some(held)
        };
        let (contested, written) = contested((balance, axis), (&written, &doubt), with);
        if !contested.is_empty() {
            doubt = doubt_of(&written, &left);
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
    if open.is_empty() {
        return None;
    }
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
    let evidence_nats = evidence_nats(balance, state, &open);
    (evidence_nats > level_nats).then_some([evidence_nats, level_nats])
}

/// Numbers that the model leaves out and nothing says: the model that is written has none of them.
pub(super) fn unsaid(balance: &Balance, state: &State, said: &[Absent]) -> Vec<Number> {
    let all = left_out(balance, state).into_iter();
    all.filter(|number| said.iter().all(|a| a.number != *number)).collect()
}

/// Numbers as they are stated: of dry friction what is not in a bristle.
fn stated_numbers(balance: &Balance, state: &State) -> Mechanics {
    let mut m = stated_mechanics(balance);
    let bristles = state.accepted.iter().filter(|a| a.hypothesis.facts().is_dry_friction);
    m.stage_coulomb_n = (m.stage_coulomb_n - bristles.map(|a| a.amplitudes[0]).sum::<f64>()).max(0.0);
    m
}

/// The stated numbers in the order of the balance, and its laws as they are stated. What nobody states is as
/// fitted: zero and scale of the encoders, and in what form dry friction turns. So is a mass that nothing
/// accelerates (not `inertial`): a stated one moves the noise of its acceleration.
pub(super) fn stated_beta(balance: &Balance, state: &State, inertial: bool) -> Vec<f64> {
    let m = stated_numbers(balance, state);
    let fitted =
        |number| state.base.numbers.iter().position(|n| *n == number).map(|k| state.base.fit.beta[k]);
    let number = |(k, n): (usize, &Number)| match n {
        Number::Zero | Number::Scale => state.base.fit.beta[k],
        Number::StageMass if !inertial => state.base.fit.beta[k],
        Number::EncoderTiming => -balance.stage_later_s.unwrap_or(0.0),
        n => match level_of(*n) {
            Some(level) => in_same_form(state, k, [fitted(level).unwrap_or(0.0), m.of(level)]),
            None => m.of(*n),
        },
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
    pub(super) other: f64,
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

    /// True where what is stated is no farther than a number must be from its statement to be wrong.
    fn is_near(&self) -> bool {
        (self.value - self.nominal).abs() < Criteria::STANDARD.correction_deviations * self.deviation
    }

    /// True where the recordings contradict it.
    pub(super) fn is_told_wrong(&self, off: f64) -> bool {
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

/// Numbers that are fitted elsewhere than they are stated, and that the recordings do not contradict: of a
/// state, and those that are elsewhere when these are as they are stated; with the state in which they are,
/// as `with` has it, if it stands. None where all forces are off by a factor, or numbers of a second mass are
/// guesses.
fn contested(
    (balance, axis): (&Balance, &AxisModel),
    (state, doubt): (&State, &Doubt),
    with: impl Fn(&[Number]) -> Option<State>,
) -> (Vec<Beside>, State) {
    let free = beside(balance, axis, state, doubt);
    let (mut list, mut judged) = (Vec::<Beside>::new(), state.clone());
    if told_scale(balance, &free) != 0.0 || free.iter().any(|n| n.is_of_second_mass(balance)) {
        return (list, judged);
    }
    loop {
        let now = beside(balance, axis, &judged, doubt);
        let is_open = |(free, now): &(&Beside, Beside)| {
            let is_new = list.iter().all(|known| known.number != now.number);
            let is_untold = free.is_near() && !free.is_told_wrong(0.0);
            free.nominal > 0.0 && now.is_elsewhere(0.0) && is_untold && is_new
        };
        let more: Vec<Beside> = free.iter().zip(now).filter(is_open).map(|(_, now)| now).collect();
        if more.is_empty() {
            return (list, judged);
        }
        let all = [&list[..], &more].concat();
        match with(&held(&[], &all)) {
            Some(held) => (list, judged) = (all, held),
            None => return (list, judged),
        }
    }
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
pub(super) fn told_scale(balance: &Balance, numbers: &[Beside]) -> f64 {
    let c = &Criteria::STANDARD;
    let common = common_scale(balance, numbers);
    if common.abs() > c.correction_tolerances * c.mass_tolerance { common } else { 0.0 }
}
