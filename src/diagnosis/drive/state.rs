//! Numbers and laws of one axis as they have been taken up so far, and the fit of all of them.

pub(super) use super::accepted::Accepted;
pub(super) use super::balance::{Balance, LAG_STEP, stated_mechanics};
pub(super) use super::base::{Base, amplitude_bounds, knockoff_design, residual};
use super::base::{Laws, base};
use super::columns::Ground;
use super::laws::{Deviations, Standing, Told};
use super::number::Mechanics;
pub(super) use super::number::Number;
use super::signals::{Layout, Path};
use std::sync::Arc;

use Number as N;

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
        let bristles = self.accepted.iter().filter(|a| a.hypothesis.facts().is_dry_friction);
        self.mechanics.stage_coulomb_n + bristles.map(|a| a.scale * a.amplitudes[0]).sum::<f64>()
    }

    /// What laws are asked beside.
    pub(super) fn standing(&self) -> Standing {
        let coulomb_n = self.coulomb_n();
        Standing {
            path: self.path,
            timing_s: self.timing_s,
            smoothing_m_s: self.smoothing_m_s,
            found_delay: self.found_delay,
            found_loop: self.found_loop,
            found_smoothing: self.found_smoothing,
            stiffness_n_m: self.mechanics.stiffness_n_m,
            coulomb_n,
            dry_n: coulomb_n + self.mechanics.motor_coulomb_n,
        }
    }

    /// The numbers that a law has moved.
    pub(super) fn stand(&mut self, now: Standing) {
        (self.path, self.timing_s, self.smoothing_m_s) = (now.path, now.timing_s, now.smoothing_m_s);
        self.found_delay = now.found_delay;
        self.found_loop = now.found_loop;
        self.found_smoothing = now.found_smoothing;
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
