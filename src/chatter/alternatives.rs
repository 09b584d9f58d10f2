//! What else could explain a window: each alternative by its log-likelihood ratio, the least one is the
//! reason for silence.
//!
//! In (n - 1) values of white noise of unknown level a template that explains the energy E of all W leaves
//! W - E; two of them compare as (n - 1) ln((W - E2)/(W - E1)).

use super::Reason;
use super::criteria::{CRITERIA, LONGEST, RATES_1_S, WINDOWS};
use super::fourier::POINTS;
use super::near::Near;
use super::window::{Context, Detection, Knowledge, Tools, Window, fit_two, fits, loudness_nats};
use nalgebra::Complex;
use std::f64::consts::TAU;

type C = Complex<f64>;

/// What the line of a window of `n` values is against noise, white, of unknown level (Fisher's test) and of
/// the level known, and whether more is to be asked. Grown chatter stands on several lobes: in an alarm its
/// power counts, over the noise of before it.
pub(super) fn against_noise(found: Detection, total: f64, n: usize, context: &Context) -> (Detection, bool) {
    let unknown = -(n as f64 - 1.0) * (1.0 - found.contrast / total).max(1e-12).ln();
    let level = match (context.noise, context.alarm) {
        (Knowledge::Nothing, _) => unknown,
        (_, true) => found.contrast,
        _ => unknown.min(found.contrast),
    };
    let over_noise = level / context.levels.noise_nats;
    (Detection { over_noise, evidence: over_noise, ..found }, over_noise >= CRITERIA.hold)
}

impl Window<'_> {
    /// The least evidence of all alternatives, over its threshold.
    pub(super) fn judge(mut self) -> Detection {
        let levels = self.context.levels;
        if self.context.alarm {
            // On an order there is no chatter; what stands between them counts by its power.
            let resolved = self.turns_of_spindle() >= CRITERIA.resolved_turns;
            if resolved && self.orders() > CRITERIA.mostly * self.line.contrast {
                self.line.least(0.0, Reason::Order);
            }
            return self.line;
        }
        self.line.power_n2 = self.power_n2();
        let mut found = self.line;
        let beside = self.asks_mode().then(|| self.near(self.beside()));
        let order = self.order_nats(beside.as_ref()) / levels.cause_nats;
        let (mode, kept) = self.mode_nats(beside.as_ref());
        let terms = [
            (self.against(self.e.len() as f64 - 1.0, self.ring()) / levels.cause_nats, Reason::RingDown),
            (order, Reason::Order),
            (self.over_stable(), Reason::Interference),
            (mode, Reason::Mode),
        ];
        for (evidence, reason) in terms {
            found.least(evidence, reason);
        }
        if found.evidence > CRITERIA.hold {
            self.judge_beginning(&mut found);
        }
        if kept && found.over_noise > 1.0 {
            found.evidence = found.evidence.max(CRITERIA.hold);
        }
        found
    }

    /// Share of the window that this energy leaves.
    fn miss(&self, energy: f64) -> f64 {
        (1.0 - energy / self.total).max(1e-12)
    }

    /// Evidence for the line against what explains `other`, nats, in so many values of white noise.
    fn against(&self, values: f64, other: f64) -> f64 {
        values * (self.miss(other) / self.miss(self.line.contrast)).ln()
    }

    /// Whether noise through a mode is an alternative: where it is known, the longest window alone tells,
    /// once it holds nothing but this cut.
    fn asks_mode(&self) -> bool {
        let unheard = self.context.is_young() || self.context.tools == Tools::Untold;
        unheard || self.context.seen < LONGEST || self.which + 1 == WINDOWS.len()
    }

    /// Against orders that changed: as templates of the window, and as learned; of a cut whose noise is not
    /// known, among what is near the line.
    fn order_nats(&self, beside: Option<&Near>) -> f64 {
        let Context { tools, orders: known, .. } = *self.context;
        let (orders, young) = (self.orders(), self.context.is_young());
        let (nats, values) = match beside.filter(|_| young) {
            None => {
                let values = self.e.len() as f64 - 1.0;
                (self.against(values, orders), values)
            }
            Some(beside) if self.beside() > 0 => (beside.values * beside.coherence(), beside.values),
            Some(&Near { rest, values, .. }) => {
                let line = self.line.contrast;
                let left = |other: f64| (line + rest - other).max(rest).max(1e-6 * line);
                (values * (left(orders) / left(line)).ln(), values)
            }
        };
        if young && tools != Tools::Untold && !known {
            // They are learned with the line in them.
            return nats;
        }
        nats.min(self.against(values, self.learned_orders()))
    }

    /// Against noise through a damped mode, over its threshold: by its spectrum, and where a cut begins by
    /// what the orders leave too: noise of damping sigma has 1 + sigma T independent values. By that alone
    /// where nothing tells when a cut begins. And louder than the noise of a stable cut. The second: whether
    /// it is too loud to be learned as noise.
    fn mode_nats(&self, beside: Option<&Near>) -> (f64, bool) {
        let Context { levels, tools, noise, stable_n2, .. } = *self.context;
        let Some(beside) = beside else { return (f64::INFINITY, false) };
        let loud = if self.context.is_young() { loudness_nats(self.line.power_n2, stable_n2) } else { 0.0 };
        let coherent = (1.0 + self.mode_decay()) * beside.coherence();
        let either = || {
            let without_orders = (self.beside() > 0).then(|| self.near(0));
            self.over_mode_nats(without_orders.as_ref().unwrap_or(beside)).max(coherent)
        };
        let (over_mode, nats) = match (tools, noise) {
            (Tools::Untold, _) => (coherent, levels.entry_unknown_nats),
            (_, Knowledge::Known) => (self.over_mode_nats(beside), levels.mode_nats),
            (Tools::Cutting, _) => (either(), levels.cause_nats),
            (Tools::Left | Tools::Unseen, _) => (either(), levels.entry_unknown_nats),
        };
        ((over_mode + loud) / nats, noise == Knowledge::Nothing && 2.0 * loud > 1.0)
    }

    /// Where nothing is known a line may have stood in air too: then it is not the cut's, unless no stable
    /// cut is as loud.
    fn over_stable(&self) -> f64 {
        let Context { noise, tools, stable_n2, .. } = *self.context;
        match (noise, tools) {
            (Knowledge::Nothing, _) => 2.0 * self.line.power_n2 / stable_n2,
            (_, Tools::Left) => 0.0,
            (_, Tools::Untold | Tools::Cutting | Tools::Unseen) => f64::INFINITY,
        }
    }

    /// Turns of the spindle in the window.
    pub(super) fn turns_of_spindle(&self) -> f64 {
        self.e.len() as f64 / self.context.rate_hz * self.context.speed_hz
    }

    pub(super) fn turns(&self) -> f64 {
        self.line.offset_hz / self.context.rate_hz
    }

    /// Energy of the best line that fades from some moment on.
    fn ring(&self) -> f64 {
        let n = self.e.len();
        let step = 1.0 / POINTS[self.which] as f64;
        let mut best: f64 = 0.0;
        for values in WINDOWS.map(|w| w / 2).into_iter().filter(|v| *v < n).chain([n]) {
            let e = &self.e[n - values..];
            for ring_1_s in RATES_1_S {
                let turns = [-2.0, -1.0, 0.0, 1.0, 2.0].map(|k| self.turns() + k * step);
                let energies = fits(e, turns, -ring_1_s / self.context.rate_hz);
                best = energies.into_iter().fold(best, f64::max);
            }
        }
        best
    }

    /// Energy of the nearest orders at the measured angle, growing as the line does; both where the window
    /// tells them apart.
    fn orders(&self) -> f64 {
        let Context { speed_hz, centre_hz, rate_hz, .. } = *self.context;
        if speed_hz <= 0.0 {
            return 0.0;
        }
        let n = self.e.len();
        let below = ((centre_hz + self.line.offset_hz) / speed_hz).floor();
        let values = self.history.last(n);
        let wave = |q: usize, order: f64| {
            let value = &values[q];
            let grown = (self.line.growth_1_s * (q as f64 - n as f64) / rate_hz).exp();
            value.mixer * C::from_polar(grown, TAU * (order * value.angle_turns).fract()) * self.chirp[q]
        };
        if self.turns_of_spindle() >= 2.0 {
            return fit_two(self.e, |q| [wave(q, below), wave(q, below + 1.0)]);
        }
        let one = |order: f64| fit_two(self.e, |q| [wave(q, order), C::ZERO]);
        one(below).max(one(below + 1.0))
    }

    /// Energy of the orders as they were learned, all by one changing factor.
    fn learned_orders(&self) -> f64 {
        fit_two(self.e, |q| {
            let s = self.history.white_orders(self.e.len(), q) * self.chirp[q];
            [s, s * q as f64]
        })
    }

    /// Power of the line, N^2, at the end of the window.
    fn power_n2(&self) -> f64 {
        let n = self.e.len();
        let values = self.history.last(n);
        let back = C::from_polar((-self.line.growth_1_s / self.context.rate_hz).exp(), -TAU * self.turns());
        let (mut s, mut sum, mut energy) = (C::ONE, C::ZERO, 0.0);
        for q in (0..n).rev() {
            sum += s.conj() * values[q].residual * self.chirp[q];
            energy += s.norm_sqr();
            s *= back;
        }
        sum.norm_sqr() / (energy * energy)
    }
}
