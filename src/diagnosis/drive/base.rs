//! Columns, inner products and fits of a balance with the laws that have been taken up.

use super::accepted::{Accepted, moved_laws};
use super::balance::Balance;
use super::columns::{Ground, TimeColumn};
use super::criteria::Criteria;
use super::dynamics::Dynamics;
use super::gram::{BandGram, Column, Gram, Part};
use super::laws::{Hypothesis, Size};
use super::likelihood::{Design, FREE, Fit, POSITIVE, Spread, weights_of};
use super::number::{Mechanics, Number};
use super::rounding::{QUARTERS, rounding};
use super::signals::{Layout, Path};
use std::sync::Arc;

/// Steps of the bandwidth, and samples of a delay that was found, that a fit may take at once.
const MOST_STEPS: f64 = 15.0;
const MOST_DELAY_SAMPLES: f64 = 2.0;

use Number as N;

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
    pub(super) idle: Arc<Vec<(usize, usize)>>,
    /// First of the knockoffs' columns.
    pub(super) knockoffs: usize,
    /// Fits of the knockoffs with numbers and laws alone: of the turned residual, then of rounding.
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

/// What the columns depend on.
pub(super) struct Laws {
    pub(super) path: Path,
    pub(super) timing_s: f64,
    pub(super) smoothing_m_s: f64,
    pub(super) mechanics: Mechanics,
    /// A dead time, a current loop that were found: they stay free, since each bends the other.
    pub(super) found: [bool; 2],
    /// See [`State`].
    pub(super) inertial: bool,
    /// See [`Base`]; `None`: not known yet.
    pub(super) idle: Option<Arc<Vec<(usize, usize)>>>,
}

/// Bounds of the amplitudes of a hypothesis.
pub(super) fn amplitude_bounds(h: &Hypothesis, count: usize) -> Vec<[f64; 2]> {
    let mut bounds = vec![FREE; count];
    if let Some(first) = bounds.first_mut() {
        *first = match h.facts().size {
            Size::Dose | Size::Whole => Criteria::STANDARD.dose,
            Size::Positive => POSITIVE,
            Size::Free => FREE,
        };
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
        N::StageTurning(_) if accepted.iter().any(|a| a.hypothesis.facts().turns_friction) => [0.0, 0.0],
        N::StageTurning(_) => [0.0, laws.mechanics.stage_coulomb_n],
        _ => FREE,
    }
}

/// Columns of laws, where a fit of them begins and within what.
#[derive(Default)]
struct Taken {
    columns: Vec<Column>,
    bounds: Vec<[f64; 2]>,
    start: Vec<f64>,
}

fn columns_of_laws(
    balance: &Balance,
    ground: &Ground<'_>,
    accepted: &[Accepted],
    moved: &[(Number, f64, TimeColumn)],
) -> Taken {
    let mut out = Taken::default();
    let mut offset = false;
    for a in accepted {
        let mut time = a.columns(ground);
        if a.moves_with_numbers() && !std::mem::replace(&mut offset, true) {
            let parts = moved.iter().map(|(_, value, column)| (column, -value));
            time = vec![TimeColumn::sum(time.iter().map(|t| (t, 1.0)).chain(parts))];
        }
        let one = a.is_one_column();
        out.bounds.extend(match a.hypothesis {
            // Numbers have moved beside it: what is not one now is not the law.
            h if (h.is_whole() || a.moves_with_numbers()) && a.given.is_none() => vec![[1.0, 1.0]],
            _ if one => vec![FREE],
            _ => amplitude_bounds(&a.hypothesis, time.len()),
        });
        out.start.extend(if one {
            vec![if a.given.is_some() { a.scale } else { 1.0 }]
        } else {
            a.amplitudes.clone()
        });
        out.columns.extend(time.iter().map(|t| balance.column(t)));
    }
    out
}

/// Columns, inner products and the fit of numbers and laws.
pub(super) fn base(balance: &Balance, laws: Laws, accepted: &[Accepted]) -> Base {
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
    let taken = columns_of_laws(balance, &ground, accepted, &moved);
    columns.extend(taken.columns);
    bounds.extend(taken.bounds);
    start.extend(taken.start);
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
    let turned = QUARTERS
        .map(|share| [0, 1].map(|k| left.sides[k].as_ref().map(|s| plan.turned(s, share))))
        .map(|sides| Column { sides, response: None });
    let rounding: Vec<Column> = rounding(&ground).iter().map(|t| balance.column(t)).collect();
    let nulls = QUARTERS.len() + rounding.len();
    let gram = gram.with(plan, turned.into_iter().chain(rounding).collect());
    let all = gram.sum(plan, Part::All);
    let null = |k: usize| {
        let design = knockoff_design(&design, &fit.beta, knockoffs + k);
        design.fit(&all, vec![0.0; design.columns.len()], weights.clone())
    };
    let knockoff_fits = (0..nulls).map(null).collect();
    let held_out = held_out(balance, (&gram, &design), (&all, &weights), &fit.beta);
    Base { numbers, gram, all, design, fit, weights, idle, knockoffs, knockoff_fits, held_out }
}

/// Every part that is left out in turn, and what a fit to the rest makes of it.
fn held_out(
    balance: &Balance,
    (gram, design): (&Gram, &Design),
    (all, weights): (&[BandGram], &[Spread]),
    beta: &[f64],
) -> Vec<HeldOut> {
    let of = |(trained, judged): (Part, Part)| {
        let bands = gram.sum(&balance.plan, trained);
        let beta = design.fit_under(&bands, beta, &weights_of(&bands, (all, weights)));
        let nats = design.nats(&gram.sum(&balance.plan, judged), &beta);
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
