//! Numbers and laws of one axis as they have been taken up so far, and the fit of all of them.

pub(super) use super::accepted::Accepted;
pub(super) use super::balance::{Balance, LAG_STEP, Standing, stated_mechanics};
use super::base::base;
pub(super) use super::base::{Base, amplitude_bounds, knockoff_design, residual};
use super::columns::Ground;
use super::dynamics::Idle;
use super::laws::{Deviations, Shape, Told};
use super::likelihood::{Design, Fit};
pub(super) use super::number::Number;
use super::signals::Layout;
use std::sync::Arc;

use Number as N;

/// Numbers and laws, and the fit of all of them.
#[derive(Clone)]
pub(super) struct State {
    pub(super) now: Standing,
    pub(super) accepted: Vec<Accepted>,
    pub(super) base: Arc<Base>,
}

impl State {
    /// The state of a model: its numbers, its laws, nothing found. Numbers and balance have followed one
    /// another `passes` times.
    pub(super) fn new(balance: &Balance, given: &[Accepted], passes: usize) -> Self {
        let of = |inertial: bool| {
            let first = Self::of(balance, given.to_vec(), inertial);
            (0..passes).fold(first, |state, _| state.begun(balance))
        };
        if balance.signals.layout == Layout::TwoPositions {
            return of(true);
        }
        let first = Self::of(balance, given.to_vec(), false);
        let inertial = first.tells_inertia().then(|| of(true)).filter(Self::tells_inertia);
        inertial.unwrap_or_else(|| of(false))
    }

    /// True where the force of inertia stands above what is left, and that is no more than the thrust.
    fn tells_inertia(&self) -> bool {
        let base = &self.base;
        let Some(k) = base.numbers.iter().position(|n| *n == N::StageMass) else { return false };
        let (mut inertia, mut left, mut thrust) = (0.0, 0.0, 0.0);
        for band in &base.all {
            let n = base.gram.len();
            inertia += base.fit.beta[k].powi(2) * band.products[0][(k + 1) * n + k + 1];
            left += base.design.spread(band, &base.fit.beta)[0] * band.values;
            thrust += band.products[0][0];
        }
        base.fit.beta[k] > 0.0 && inertia > left && thrust > left
    }

    /// The same where inertia is told beside what was found, if it was not before.
    pub(super) fn with_told_inertia(self, balance: &Balance, passes: usize) -> Self {
        if self.now.inertial || !self.tells_inertia() {
            return self;
        }
        let mut inertial = self.clone();
        inertial.now.inertial = true;
        let inertial = (0..passes).fold(inertial, |state, _| state.begun(balance));
        if inertial.tells_inertia() { inertial } else { self }
    }

    fn of(balance: &Balance, given: Vec<Accepted>, inertial: bool) -> Self {
        let now = Standing::stated(balance, inertial);
        let mut state = Self { now, base: Arc::new(base(balance, (&now, None), &given)), accepted: given };
        state.take_over();
        state
    }

    /// What laws are evaluated on.
    pub(super) fn ground<'a>(&self, balance: &'a Balance) -> Ground<'a> {
        self.now.ground(balance)
    }

    /// The balance built again from the numbers and laws as they are.
    pub(super) fn rebuilt(self, balance: &Balance) -> Self {
        let idle = self.base.idle.clone();
        self.built(balance, Some(idle))
    }

    /// The balance with another form of a law, fitted anew.
    pub(super) fn with_form(&self, balance: &Balance, law: usize, form: Shape) -> Self {
        let mut out = self.clone();
        let a = &mut out.accepted[law];
        a.hypothesis = a.hypothesis.by(form);
        a.amplitudes = vec![0.0; a.hypothesis.columns(&out.now.ground(balance)).len()];
        out.rebuilt(balance)
    }

    /// The same balance by another fit of it; when a force acts, what chance reaches and what was held out
    /// stay as they were.
    pub(super) fn fitted_as(&self, design: Design, fit: Fit) -> Self {
        let mut out = self.with_numbers(&fit.beta);
        for k in 0..out.accepted.len() {
            let (place, a) = (self.place(k), &mut out.accepted[k]);
            let (before, now) = (self.base.fit.beta[place], fit.beta[place]);
            if a.given.is_some() {
                a.scale = now;
            } else if a.is_one_column() {
                let factor = if before == 0.0 { 1.0 } else { now / before };
                a.amplitudes.iter_mut().for_each(|x| *x *= factor);
            } else {
                a.amplitudes.iter_mut().zip(&fit.beta[place..]).for_each(|(x, b)| *x = *b);
            }
        }
        let weights = design.weights(&self.base.all, &fit.beta);
        out.base = Arc::new(Base { design, fit, weights, ..(*self.base).clone() });
        out
    }

    /// The same before anything is asked: what moves nothing is looked at anew.
    pub(super) fn begun(self, balance: &Balance) -> Self {
        self.built(balance, None)
    }

    /// The same beside what was found between command and thrust, and the speed over which friction turns. A
    /// force of another clock has no path.
    pub(super) fn beside(mut self, balance: &Balance, known: &Standing, passes: usize) -> Self {
        let of_path = !self.now.found_delay && (known.found_delay || known.found_loop);
        if of_path {
            let Standing { path, timing_s, found_delay, found_loop, .. } = *known;
            self.now = Standing { path, timing_s, found_delay, found_loop, ..self.now };
        }
        if known.found_smoothing {
            (self.now.smoothing_m_s, self.now.found_smoothing) = (known.smoothing_m_s, true);
        }
        let passes = if of_path || known.found_smoothing { passes } else { 0 };
        (0..passes).fold(self, |state, _| state.begun(balance))
    }

    fn built(mut self, balance: &Balance, idle: Option<Idle>) -> Self {
        self.base = Arc::new(base(balance, (&self.now, idle), &self.accepted));
        self.take_over();
        self
    }

    /// Place of a law's first coefficient in the fit.
    pub(super) fn place(&self, law: usize) -> usize {
        self.base.numbers.len() + self.accepted[..law].iter().map(Accepted::coefficients).sum::<usize>()
    }

    /// Numbers of a fit beside this state.
    pub(super) fn with_numbers(&self, beta: &[f64]) -> Self {
        let mut out = self.clone();
        out.take_numbers(beta);
        (out.now.timing_s, out.now.path) = (self.now.timing_s, self.now.path);
        out
    }

    /// By how much more the stage's encoder is read later than the positions were taken, s, with its
    /// deviation by the noise alone, and whether it is at its bound.
    pub(super) fn stage_is_later_s(&self) -> Option<(f64, f64, bool)> {
        let fit = &self.base.fit;
        let k = self.base.numbers.iter().position(|n| *n == N::EncoderTiming)?;
        Some((fit.beta[k], fit.inverse()[(k, k)].max(0.0).sqrt(), fit.held[k]))
    }

    fn take_numbers(&mut self, beta: &[f64]) {
        let now = &mut self.now;
        for (number, value) in self.base.numbers.iter().zip(beta) {
            match number {
                // A dead time that was found and when a reference acts are one number.
                N::Timing if now.found_delay => now.path.delay_s += value,
                N::Timing => now.timing_s += value,
                N::Lag => now.path.loop_rad_s = now.path.loop_rad_s.map(|w| w * LAG_STEP.powf(*value)),
                number => {
                    let kept = if *number == N::Zero { *value } else { value.max(0.0) };
                    now.mechanics.of_mut(*number).into_iter().for_each(|x| *x = kept);
                }
            }
        }
    }

    /// Numbers and amplitudes from the fit.
    fn take_over(&mut self) {
        let base = self.base.clone();
        let from_kg = self.now.mechanics.motor_mass_kg;
        self.take_numbers(&base.fit.beta);
        let to_kg = self.now.mechanics.motor_mass_kg;
        let mut place = base.numbers.len();
        for a in &mut self.accepted {
            let n = a.coefficients();
            let beta = &base.fit.beta[place..place + n];
            if a.given.is_some() {
                a.scale = beta[0];
                a.hypothesis.law_mut().motor_moved(from_kg, to_kg);
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
        let bristles = self.accepted.iter().filter(|a| a.hypothesis.facts().is_dry_friction);
        self.now.mechanics.stage_coulomb_n + bristles.map(|a| a.scale * a.amplitudes[0]).sum::<f64>()
    }

    /// The same of both sides.
    pub(super) fn dry_n(&self) -> f64 {
        self.coulomb_n() + self.now.mechanics.motor_coulomb_n
    }

    /// A law of this state for people.
    pub(super) fn told<'a>(
        &self,
        balance: &'a Balance,
        law: &'a Accepted,
        deviations: &'a Deviations,
    ) -> Told<'a> {
        Told { balance, coulomb_n: self.coulomb_n(), amplitudes: &law.amplitudes, deviations }
    }
}
