//! The balance of one axis with what has been taken up so far: columns, inner products, the present fit.

pub(super) use super::accepted::Accepted;
use super::accepted::moved_laws;
use super::columns::{Ground, TimeColumn, derivative};
use super::criteria::Criteria;
use super::dynamics::Dynamics;
use super::gram::{BandGram, Column, Gram, Part};
use super::likelihood::{Design, FREE, Fit, POSITIVE, Spread};
pub(super) use super::number::Number;
use super::number::{Mechanics, TURNING};
use super::shape::{Hypothesis, Shape};
use super::signals::{Layout, Path, Signals};
use super::spectra::{FOLDS, Plan};
use crate::plant::drive::DriveParams;
use std::sync::Arc;

/// Turns of the knockoffs, as shares of a recording.
const TURNS: [f64; 3] = [0.25, 0.5, 0.75];
/// A central difference of the thrust over its time of arrival, samples.
const TIMING_STEP: f64 = 0.1;
/// A step of a loop's bandwidth, as a factor.
pub(super) const LAG_STEP: f64 = 0.98;
/// Steps of the bandwidth, and samples of a delay that was found, that a fit may take at once.
const MOST_STEPS: f64 = 15.0;
const MOST_DELAY_SAMPLES: f64 = 2.0;

use Number as N;

/// The axis as recorded, and how it is looked at.
pub(super) struct Balance {
    pub(super) drive: DriveParams,
    pub(super) signals: Signals,
    pub(super) plan: Plan,
    /// A column was moved in time: when a reference acts is free, and no delay is asked about.
    pub(super) clock_moved: bool,
    /// Columns that never change, by number.
    fixed: Vec<(Number, Column)>,
}

/// Numbers and laws, and the fit of all of them.
#[derive(Clone)]
pub(super) struct State {
    pub(super) path: Path,
    pub(super) timing_s: f64,
    pub(super) smoothing_m_s: f64,
    pub(super) mechanics: Mechanics,
    pub(super) accepted: Vec<Accepted>,
    /// The recordings tell the inertia: thrust is what accelerates. Else it is a force beside a motion, and
    /// nothing says when it came.
    pub(super) inertial: bool,
    /// A dead time, a current loop, a smoothing speed other than stated were found.
    pub(super) found_delay: bool,
    pub(super) found_loop: bool,
    pub(super) found_smoothing: bool,
    pub(super) base: Arc<Base>,
}

/// What fits are made of.
pub(super) struct Base {
    pub(super) numbers: Vec<Number>,
    /// Target, numbers, accepted laws, knockoffs.
    pub(super) gram: Gram,
    pub(super) all: Vec<BandGram>,
    pub(super) design: Design,
    pub(super) fit: Fit,
    pub(super) weights: Vec<Spread>,
    /// Bands, `(recording, band)`, whose recorded force moves nothing, see [`super::dynamics`].
    idle: Arc<Vec<(usize, usize)>>,
    /// First of the knockoffs' columns.
    pub(super) knockoffs: usize,
    /// Fits of the knockoffs with numbers and laws alone.
    pub(super) knockoff_fits: Vec<Fit>,
    /// What is fitted, what is judged, the fit.
    pub(super) held_out: Vec<HeldOut>,
}

/// A part that is left out of a fit and judged by it.
#[derive(Clone)]
pub(super) struct HeldOut {
    pub(super) trained: Part,
    pub(super) judged: Part,
    /// L of the judged part.
    pub(super) nats: f64,
}

impl Balance {
    /// Columns of the numbers that are linear in signals alone.
    pub(super) fn new(drive: DriveParams, signals: Signals, clock_moved: bool) -> Self {
        let masked: Vec<Vec<bool>> = signals.tracks.iter().map(|t| t.masked.clone()).collect();
        // One position tells friction at the lowest frequencies, where every real axis leaves most: weights
        // by band would give those few bins away for the many of the noise.
        let white = signals.layout != Layout::TwoPositions;
        let plan = Plan::new(&masked, signals.thin_rate_hz(), (signals.top_hz(), white));
        let mut out = Self { drive, signals, plan, clock_moved, fixed: Vec::new() };
        let changing = |n: &Number| n.is_dry_friction() || *n == N::Timing;
        out.fixed = out
            .numbers()
            .into_iter()
            .filter(|n| !changing(n))
            .map(|n| (n, out.column(&out.linear(n))))
            .collect();
        out
    }

    /// The numbers that this balance has.
    pub(super) fn numbers(&self) -> Vec<Number> {
        let mut numbers = match self.signals.layout {
            Layout::TwoPositions => vec![
                N::MotorMass,
                N::MotorDamping,
                N::MotorCoulomb,
                N::Stiffness,
                N::StructuralDamping,
                N::StageMass,
                N::StageDamping,
                N::StageCoulomb,
                N::Timing,
                N::Zero,
                N::Scale,
            ],
            Layout::OnePosition => vec![N::StageMass, N::StageDamping, N::StageCoulomb, N::Timing],
            Layout::Locked => {
                vec![N::StageMass, N::StageDamping, N::StageCoulomb, N::Timing, N::Stiffness, N::Zero]
            }
        };
        let of_motor = numbers.contains(&N::MotorCoulomb);
        let parts = 0..TURNING.len();
        numbers.extend(parts.clone().filter(|_| of_motor).map(N::MotorTurning));
        numbers.extend(parts.map(N::StageTurning));
        numbers.extend((self.signals.sides() == 1).then_some(N::StageTurning(TURNING.len())));
        numbers
    }

    fn linear(&self, number: Number) -> TimeColumn {
        let two = self.signals.layout == Layout::TwoPositions;
        let each = |of: &dyn Fn(&super::signals::Thin) -> Vec<f64>| self.signals.each(|t| of(&t.thin));
        let negative = |x: &[f64]| x.iter().map(|v| -v).collect::<Vec<f64>>();
        let coupled = |of: &dyn Fn(&super::signals::Thin) -> Vec<f64>| TimeColumn {
            sides: [Some(each(of)), two.then(|| each(&|t| negative(&of(t))))],
            operator: None,
        };
        let spring = |order: i32, of: &dyn Fn(&super::signals::Thin) -> Vec<f64>| TimeColumn {
            operator: Some(Arc::new(move |w| [1.0, -1.0, -1.0, 1.0].map(|sign| sign * derivative(w, order)))),
            ..coupled(of)
        };
        let own = |side: usize, order: i32, of: &dyn Fn(&super::signals::Thin) -> Vec<f64>| {
            let mut column = TimeColumn::default();
            column.sides[if two { side } else { 0 }] = Some(each(of));
            let at = [1.0 - side as f64, 0.0, 0.0, side as f64];
            column.operator = Some(Arc::new(move |w| at.map(|at| at * derivative(w, order))));
            column
        };
        let last = usize::from(two);
        match number {
            N::MotorMass => own(0, 2, &|t| t.accel[0].clone()),
            N::MotorDamping => own(0, 1, &|t| t.velocity[0].clone()),
            N::Stiffness => spring(0, &|t| t.stretch.clone()),
            N::StructuralDamping => spring(1, &|t| t.stretch_rate.clone()),
            N::StageMass => own(1, 2, &|t| t.accel[last].clone()),
            N::StageDamping => own(1, 1, &|t| t.velocity[last].clone()),
            N::Zero => coupled(&|t| vec![1.0; t.position.len()]),
            N::Scale => coupled(&|t| {
                let middle = 0.5 * self.signals.travel_m().iter().sum::<f64>();
                t.position.iter().map(|x| x - middle).collect()
            }),
            N::MotorCoulomb
            | N::StageCoulomb
            | N::MotorTurning(_)
            | N::StageTurning(_)
            | N::Timing
            | N::Lag => TimeColumn::default(),
        }
    }

    /// A number's column in time.
    pub(super) fn number_column(&self, number: Number, state: &Ground<'_>) -> TimeColumn {
        match number {
            N::MotorCoulomb | N::StageCoulomb | N::MotorTurning(_) | N::StageTurning(_) => {
                let two = self.signals.layout == Layout::TwoPositions;
                let side = usize::from(two && matches!(number, N::StageCoulomb | N::StageTurning(_)));
                let of = |t: &super::signals::Track| state.dry(t, side, number.part());
                let mut column = TimeColumn::default();
                column.sides[side] = Some(self.signals.each(of));
                column
            }
            N::Timing => {
                let by = TIMING_STEP / self.signals.rate_hz;
                let at = |delay_s: f64| {
                    let path = Path { delay_s: state.path.delay_s + delay_s, ..state.path };
                    self.signals.each(|t| self.signals.thrust(t, path))
                };
                // Later by a second: thrust less its rate; the model needs the rate more.
                let rate = at(-by)
                    .iter()
                    .zip(&at(by))
                    .map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b) / (2.0 * by)).collect())
                    .collect();
                TimeColumn { sides: [Some(rate), None], operator: None }
            }
            N::Lag => state.lagging(LAG_STEP),
            _ => self.linear(number),
        }
    }

    /// A column's spectra.
    pub(super) fn column(&self, time: &TimeColumn) -> Column {
        let points = &self.plan.points;
        let response = time.operator.as_ref().map(|of| points.iter().map(|p| of(p.rad_s)).collect());
        Column {
            sides: [0, 1].map(|k| time.sides[k].as_ref().map(|s| self.plan.transform(s))),
            response: response.map(Arc::new),
        }
    }

    /// What is fitted to: the thrust at the motor, nothing at the stage.
    pub(super) fn target(&self, path: Path) -> TimeColumn {
        let thrust = self.signals.each(|t| self.signals.thrust(t, path));
        TimeColumn { sides: [Some(thrust), None], operator: None }
    }

    /// Parts that are held out in turn: quarters, and recordings where there are several.
    pub(super) fn parts(&self) -> Vec<(Part, Part)> {
        let folds = (0..FOLDS).map(|f| (Part::WithoutFold(f), Part::Fold(f)));
        let several = self.plan.recordings() > 1;
        let recordings = (0..self.plan.recordings()).filter(|_| several);
        folds.chain(recordings.map(|r| (Part::WithoutRecording(r), Part::Recording(r)))).collect()
    }

    /// Weights of a floor that is flat below the bands it is read off in.
    fn flat_weights(&self, design: &Design, bands: &[BandGram], beta: &[f64]) -> Vec<Spread> {
        let share = Criteria::STANDARD.floor_band;
        let [low, high] = share.map(|s| s * self.signals.top_hz());
        let spreads: Vec<Spread> = bands.iter().map(|b| design.spread(b, beta)).collect();
        let middle = |b: &BandGram| 0.5 * self.plan.band_hz(b.band).iter().sum::<f64>();
        let flat = |b: &BandGram, s: &Spread| {
            let reference =
                bands.iter().position(|o| o.recording == b.recording && (low..high).contains(&middle(o)));
            reference.filter(|_| middle(b) < low).map_or(*s, |k| spreads[k])
        };
        bands.iter().zip(&spreads).map(|(b, s)| design.weight(flat(b, s))).collect()
    }

    /// The better of two fits: from the weights of the present residuals, and from a flat floor.
    pub(super) fn fit(&self, design: &Design, bands: &[BandGram], beta: &[f64], weights: &[Spread]) -> Fit {
        let one = design.fit(bands, beta.to_vec(), weights.to_vec());
        let flat = self.flat_weights(design, bands, beta);
        let other = design.fit(bands, beta.to_vec(), flat);
        if other.nats < one.nats { other } else { one }
    }
}

impl State {
    /// The state of a model: its numbers, its laws, nothing found.
    pub(super) fn new(balance: &Balance, given: Vec<Accepted>) -> Self {
        let two = balance.signals.layout == Layout::TwoPositions;
        let first = Self::of(balance, given.clone(), two);
        if !two && first.tells_inertia() { Self::of(balance, given, true) } else { first }
    }

    /// True where the force of inertia stands above what is left.
    fn tells_inertia(&self) -> bool {
        let base = &self.base;
        let Some(k) = base.numbers.iter().position(|n| *n == N::StageMass) else { return false };
        let (mut inertia, mut left) = (0.0, 0.0);
        for band in &base.all {
            let n = base.gram.len();
            inertia += base.fit.beta[k].powi(2) * band.products[0][(k + 1) * n + k + 1];
            left += base.design.spread(band, &base.fit.beta)[0] * band.values;
        }
        base.fit.beta[k] > 0.0 && inertia > left
    }

    fn of(balance: &Balance, given: Vec<Accepted>, inertial: bool) -> Self {
        let d = &balance.drive;
        let mechanics = stated_mechanics(balance);
        let path = Path { delay_s: d.amplifier_dead_time_s(), loop_rad_s: d.current_loop_bandwidth_rad_s() };
        let smoothing_m_s = balance.signals.smoothing_m_s;
        let laws =
            Laws { path, timing_s: 0.0, smoothing_m_s, mechanics, found: [false; 2], inertial, idle: None };
        let mut state = Self {
            path,
            timing_s: 0.0,
            smoothing_m_s,
            mechanics,
            inertial,
            found_delay: false,
            found_loop: false,
            found_smoothing: false,
            base: Arc::new(base(balance, laws, &given)),
            accepted: given,
        };
        state.take_over();
        state
    }

    /// What laws are evaluated on.
    pub(super) fn ground<'a>(&self, balance: &'a Balance) -> Ground<'a> {
        Ground {
            signals: &balance.signals,
            mechanics: self.mechanics,
            smoothing_m_s: self.smoothing_m_s,
            path: Path { delay_s: self.path.delay_s + self.timing_s, ..self.path },
        }
    }

    /// The balance built again from the numbers and laws as they are.
    pub(super) fn rebuilt(self, balance: &Balance) -> Self {
        let idle = self.base.idle.clone();
        self.built(balance, Some(idle))
    }

    /// The same before anything is asked: what moves nothing is looked at anew.
    pub(super) fn begun(self, balance: &Balance) -> Self {
        self.built(balance, None)
    }

    fn built(mut self, balance: &Balance, idle: Option<Arc<Vec<(usize, usize)>>>) -> Self {
        let laws = Laws {
            path: self.path,
            timing_s: self.timing_s,
            smoothing_m_s: self.smoothing_m_s,
            mechanics: self.mechanics,
            found: [self.found_delay, self.found_loop],
            inertial: self.inertial,
            idle,
        };
        self.base = Arc::new(base(balance, laws, &self.accepted));
        self.take_over();
        self
    }

    /// Numbers of a fit beside this state.
    pub(super) fn with_numbers(&self, beta: &[f64]) -> Self {
        let mut out = self.clone();
        out.take_numbers(beta);
        (out.timing_s, out.path) = (self.timing_s, self.path);
        out
    }

    fn take_numbers(&mut self, beta: &[f64]) {
        let base = self.base.clone();
        for (number, value) in base.numbers.iter().zip(beta) {
            match number {
                // A dead time that was found and when a reference acts are one number.
                N::Timing if self.found_delay => self.path.delay_s += value,
                N::Timing => self.timing_s += value,
                N::Lag => self.path.loop_rad_s = self.path.loop_rad_s.map(|w| w * LAG_STEP.powf(*value)),
                number => {
                    let kept = if *number == N::Zero { *value } else { value.max(0.0) };
                    self.mechanics.of_mut(*number).into_iter().for_each(|x| *x = kept);
                }
            }
        }
    }

    /// Numbers and amplitudes from the fit.
    fn take_over(&mut self) {
        let base = self.base.clone();
        self.take_numbers(&base.fit.beta);
        let mut place = base.numbers.len();
        for a in &mut self.accepted {
            let n = a.coefficients();
            let beta = &base.fit.beta[place..place + n];
            if a.given.is_some() {
                a.scale = beta[0];
            } else if a.is_one_column() {
                a.amplitudes.iter_mut().for_each(|x| *x *= beta[0]);
            } else {
                a.amplitudes.copy_from_slice(beta);
            }
            place += n;
        }
    }

    /// True where the recorded force has noise that moves nothing up to the highest frequencies: it is no
    /// command, and what lies between a command and its force is not asked about.
    pub(super) fn is_measured(&self, balance: &Balance) -> bool {
        self.base.idle.iter().any(|(_, band)| band + 1 == balance.plan.bands())
    }

    /// Dry friction of the stage (of the axis, with one position), its bristle included, N.
    pub(super) fn coulomb_n(&self) -> f64 {
        let bristles =
            self.accepted.iter().filter(|a| matches!(a.hypothesis.shape, Shape::Presliding { .. }));
        self.mechanics.stage_coulomb_n + bristles.map(|a| a.scale * a.amplitudes[0]).sum::<f64>()
    }
}

/// The stated numbers on the screw axis.
pub(super) fn stated_mechanics(balance: &Balance) -> Mechanics {
    let d = &balance.drive;
    let total = balance.signals.layout != Layout::TwoPositions;
    let sum = |motor: f64, stage: f64| if total { motor + stage } else { stage };
    Mechanics {
        motor_mass_kg: d.reflected_mass_kg(),
        motor_damping_n_s_m: d.reflected_damping_n_s_m(),
        motor_coulomb_n: d.motor_coulomb_friction_n(),
        stiffness_n_m: d.axial_stiffness_n_m(),
        structural_damping_n_s_m: d.structural_damping_n_s_m(),
        stage_mass_kg: sum(d.reflected_mass_kg(), d.movable_mass_kg()),
        stage_damping_n_s_m: sum(d.reflected_damping_n_s_m(), d.translational_damping_n_s_m()),
        stage_coulomb_n: sum(d.motor_coulomb_friction_n(), d.stage_coulomb_friction_n()),
        spring_zero_n: 0.0,
    }
}

/// What the columns depend on.
struct Laws {
    path: Path,
    timing_s: f64,
    smoothing_m_s: f64,
    mechanics: Mechanics,
    /// A dead time, a current loop that were found: they stay free, since each bends the other.
    found: [bool; 2],
    /// See [`State`].
    inertial: bool,
    /// See [`Base`]; `None`: not known yet.
    idle: Option<Arc<Vec<(usize, usize)>>>,
}

/// Bounds of the amplitudes of a hypothesis.
pub(super) fn amplitude_bounds(h: &Hypothesis, count: usize) -> Vec<[f64; 2]> {
    let mut bounds = vec![FREE; count];
    if let Some(first) = bounds.first_mut() {
        if h.has_dose() {
            *first = Criteria::STANDARD.dose;
        } else if h.is_positive() {
            *first = POSITIVE;
        }
    }
    bounds
}

/// Bounds of a number of the balance.
fn number_bounds(balance: &Balance, laws: &Laws, (number, accepted): (Number, &[Accepted])) -> [f64; 2] {
    match number {
        N::Lag => [-MOST_STEPS, MOST_STEPS],
        N::Timing if laws.found[0] => {
            [-MOST_DELAY_SAMPLES, MOST_DELAY_SAMPLES].map(|s| s / balance.signals.rate_hz)
        }
        // To two rows, which is what a clock is put right to, and to all that the model delays.
        N::Timing if balance.clock_moved => {
            let d = &balance.drive;
            let encoders_s = d.motor_encoder_delay_s().max(d.stage_encoder_delay_s());
            let lag_s = laws.path.loop_rad_s.map_or(0.0, f64::recip);
            let mean_s = balance.signals.averaged_s();
            let within_s = laws.path.delay_s + encoders_s + lag_s + mean_s + 2.0 / balance.signals.rate_hz;
            [-within_s, within_s].map(|s| s - laws.timing_s)
        }
        N::Timing => {
            let [low, high] = Criteria::STANDARD.timing_samples;
            let high = if balance.signals.layout == Layout::TwoPositions { 0.0 } else { high };
            [low, high].map(|s| s / balance.signals.rate_hz - laws.timing_s)
        }
        // No part is more than all of it.
        N::MotorTurning(_) => [0.0, laws.mechanics.motor_coulomb_n],
        N::StageTurning(_) if accepted.iter().any(|a| a.hypothesis.turns_friction()) => [0.0, 0.0],
        N::StageTurning(_) => [0.0, laws.mechanics.stage_coulomb_n],
        _ => FREE,
    }
}

fn base(balance: &Balance, laws: Laws, accepted: &[Accepted]) -> Base {
    let ground = Ground {
        signals: &balance.signals,
        mechanics: laws.mechanics,
        smoothing_m_s: laws.smoothing_m_s,
        path: Path { delay_s: laws.path.delay_s + laws.timing_s, ..laws.path },
    };
    let mut numbers = balance.numbers();
    numbers.extend(laws.found[1].then_some(N::Lag));
    let mut columns = vec![balance.column(&balance.target(ground.path))];
    let mut bounds = Vec::new();
    let mut start = Vec::new();
    let m = laws.mechanics;
    let moved = moved_laws(&ground, accepted);
    for number in &numbers {
        let fixed = balance.fixed.iter().find(|(n, _)| n == number).map(|(_, c)| c.clone());
        let more = moved.iter().find(|(n, _, _)| n == number).map(|(_, _, column)| (column, 1.0));
        columns.push(match (more, fixed) {
            (Some(more), _) => balance.column(&TimeColumn::sum(
                [(&balance.number_column(*number, &ground), 1.0), more].into_iter(),
            )),
            (None, Some(fixed)) => fixed,
            (None, None) => balance.column(&balance.number_column(*number, &ground)),
        });
        bounds.push(number_bounds(balance, &laws, (*number, accepted)));
        start.push(m.of(*number));
    }
    let mut offset = false;
    for a in accepted {
        let mut time = a.columns(&ground);
        if a.moves_with_numbers() && !std::mem::replace(&mut offset, true) {
            let parts = moved.iter().map(|(_, value, column)| (column, -value));
            time = vec![TimeColumn::sum(time.iter().map(|t| (t, 1.0)).chain(parts))];
        }
        let one = a.is_one_column();
        bounds.extend(match a.hypothesis {
            // Numbers have moved beside it: what is not one now is not the law.
            h if (h.is_whole() || a.moves_with_numbers()) && a.given.is_none() => vec![[1.0, 1.0]],
            _ if one => vec![FREE],
            _ => amplitude_bounds(&a.hypothesis, time.len()),
        });
        start.extend(if one {
            vec![if a.given.is_some() { a.scale } else { 1.0 }]
        } else {
            a.amplitudes.clone()
        });
        columns.extend(time.iter().map(|t| balance.column(t)));
    }
    let knockoffs = columns.len();
    let is_mass = |n: &Number| matches!(n, N::MotorMass | N::StageMass);
    let plan = &balance.plan;
    let gram = Gram::new(plan, columns);
    let mut design = Design {
        target: 0,
        columns: Vec::new(),
        bounds: Vec::new(),
        dynamics: Dynamics::at(plan.points.clone()),
        masses: numbers
            .iter()
            .enumerate()
            .filter(|(_, n)| is_mass(n) && laws.inertial)
            .map(|(k, _)| (k, 0.0))
            .collect(),
        sides: balance.signals.sides(),
    };
    design.add(&gram, 1..knockoffs, bounds);
    let two = balance.signals.layout == Layout::TwoPositions;
    let all = gram.sum(plan, Part::All);
    let look = || if two { design.idle(&all, &numbers, &start) } else { Vec::new() };
    let idle = laws.idle.unwrap_or_else(|| Arc::new(look()));
    design.dynamics = design.dynamics.idle_in(idle.clone());
    let weights = design.weights(&all, &start);
    let fit = balance.fit(&design, &all, &start, &weights);
    let weights = design.weights(&all, &fit.beta);
    // What is left, turned.
    let left = residual(balance, &gram, &design, &fit.beta);
    let turned = TURNS
        .map(|share| [0, 1].map(|k| left.sides[k].as_ref().map(|s| plan.turned(s, share))))
        .map(|sides| Column { sides, response: None });
    let gram = gram.with(plan, turned.to_vec());
    let all = gram.sum(plan, Part::All);
    let null = |k: usize| {
        let design = knockoff_design(&design, &fit.beta, knockoffs + k);
        design.fit(&all, vec![0.0; design.columns.len()], weights.clone())
    };
    let knockoff_fits = (0..TURNS.len()).map(null).collect();
    let held_out = held_out(balance, (&gram, &design), &fit.beta);
    Base { numbers, gram, all, design, fit, weights, idle, knockoffs, knockoff_fits, held_out }
}

/// Every part that is left out in turn, and what a fit to the rest makes of it.
fn held_out(balance: &Balance, (gram, design): (&Gram, &Design), beta: &[f64]) -> Vec<HeldOut> {
    let of = |(trained, judged): (Part, Part)| {
        let bands = gram.sum(&balance.plan, trained);
        let fit = design.fit(&bands, beta.to_vec(), design.weights(&bands, beta));
        let nats = design.nats(&gram.sum(&balance.plan, judged), &fit.beta);
        HeldOut { trained, judged, nats }
    };
    balance.parts().into_iter().map(of).collect()
}

/// The design of a knockoff: its target beside the present fit. No motion comes of it, and it has no Jacobian
/// but that of a rigid mass.
pub(super) fn knockoff_design(design: &Design, beta: &[f64], target: usize) -> Design {
    let rigid = design.masses.iter().filter(|_| design.dynamics.is_rigid());
    let masses = rigid.map(|(k, held)| (*k, held + beta[*k])).collect();
    Design {
        target,
        bounds: design.bounds.iter().zip(beta).map(|(b, x)| [b[0] - x, b[1] - x]).collect(),
        masses,
        dynamics: Dynamics::default(),
        ..design.clone()
    }
}

/// Spectra of what is left.
pub(super) fn residual(balance: &Balance, gram: &Gram, design: &Design, beta: &[f64]) -> Column {
    let sides = balance.signals.sides();
    let of = |side: usize| {
        let mut out: Option<Vec<f64>> = None;
        let mut add = |factor: f64, index: usize| {
            if let Some(spectrum) = &gram.column(index).sides[side] {
                let sum = out.get_or_insert_with(|| vec![0.0; spectrum.len()]);
                sum.iter_mut().zip(spectrum.iter()).for_each(|(s, v)| *s += factor * v);
            }
        };
        add(1.0, design.target);
        design.columns.iter().zip(beta).for_each(|(k, b)| add(-b, *k));
        out.filter(|_| side < sides).map(Arc::new)
    };
    Column { sides: [of(0), of(1)], response: None }
}

/// True for a shape that moves a number of the path instead of adding a law.
pub(super) fn is_of_path(h: &Hypothesis) -> bool {
    matches!(h.shape, Shape::Delay { .. } | Shape::Loop { .. })
}
