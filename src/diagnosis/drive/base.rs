//! Columns, inner products and fits of a balance with the laws that have been taken up.

use super::accepted::{Accepted, moved_laws};
use super::balance::{Balance, Standing};
use super::columns::{Ground, TimeColumn};
use super::dynamics::{Dynamics, Idle};
use super::gram::{BandGram, Column, Gram, Part};
use super::laws::{Hypothesis, Size};
use super::likelihood::{Design, DryFriction, FREE, Fit, POSITIVE, Spread};
use super::number::Number;
use super::rounding::QUARTERS;
use super::signals::Layout;
use crate::diagnosis::criteria::Criteria;
use std::sync::Arc;

/// Steps of the bandwidth, and samples of a delay that was found, that a fit may take at once.
const MOST_STEPS: f64 = 15.0;
pub(super) const MOST_DELAY_SAMPLES: f64 = 2.0;

use Number as N;

/// What fits are made of.
#[derive(Clone)]
pub(super) struct Base {
    pub(super) numbers: Vec<Number>,
    /// Target, numbers, accepted laws, knockoffs.
    pub(super) gram: Gram,
    pub(super) all: Vec<BandGram>,
    pub(super) design: Design,
    pub(super) fit: Fit,
    pub(super) weights: Vec<Spread>,
    pub(super) idle: Idle,
    /// First of the knockoffs' columns.
    pub(super) knockoffs: usize,
    /// Fits of the knockoffs with numbers and laws alone: of the turned residual, then of rounding; of two
    /// positions of both together.
    pub(super) knockoff_fits: Vec<Fit>,
    /// See [`Balance::held_out_nats`].
    pub(super) held_out_nats: Vec<f64>,
}

impl Base {
    /// Inner products, what is fitted of them, and its coefficients.
    pub(super) fn fitted(&self) -> (&Gram, &Design, &[f64]) {
        (&self.gram, &self.design, &self.fit.beta)
    }
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
fn number_bounds(balance: &Balance, now: &Standing, (number, accepted): (Number, &[Accepted])) -> [f64; 2] {
    match number {
        N::Lag => [-MOST_STEPS, MOST_STEPS],
        N::Timing if now.found_delay => {
            [-MOST_DELAY_SAMPLES, MOST_DELAY_SAMPLES].map(|s| s / balance.signals.rate_hz)
        }
        // To two rows, which is what a clock is put right to, and to all that the model delays.
        N::Timing if balance.clock_moved => {
            let d = &balance.drive;
            let encoders_s = d.motor_encoder_delay_s().max(d.stage_encoder_delay_s());
            let lag_s = now.path.loop_rad_s.map_or(0.0, f64::recip);
            let mean_s = balance.signals.averaged_s();
            let within_s = now.path.delay_s + encoders_s + lag_s + mean_s + 2.0 / balance.signals.rate_hz;
            [-within_s, within_s].map(|s| s - now.timing_s)
        }
        N::EncoderTiming => [-MOST_DELAY_SAMPLES, MOST_DELAY_SAMPLES].map(|s| s / balance.signals.rate_hz),
        N::Timing => {
            let [low, high] = Criteria::STANDARD.timing_samples;
            let high = if balance.signals.layout == Layout::TwoPositions { 0.0 } else { high };
            [low, high].map(|s| s / balance.signals.rate_hz - now.timing_s)
        }
        // No part is more than all of it; together they are none where it is free (`Design::dry`).
        N::MotorTurning(_) => [0.0, now.mechanics.motor_coulomb_n],
        N::StageTurning(_) if accepted.iter().any(|a| a.hypothesis.facts().turns_friction) => [0.0, 0.0],
        N::StageTurning(_) => [0.0, now.mechanics.stage_coulomb_n],
        // What brakes gives nothing back.
        N::MotorDamping | N::StageDamping | N::StructuralDamping | N::MotorCoulomb | N::StageCoulomb => {
            POSITIVE
        }
        _ => FREE,
    }
}

/// Places of the levels of dry friction, each with those of the forms in which parts of it turn.
fn dry_of(numbers: &[Number]) -> Vec<DryFriction> {
    let of = |level: Number| {
        let is_part = |n: &Number| n.part().is_some() && n.is_of_stage() == level.is_of_stage();
        let parts = numbers.iter().enumerate().filter(|(_, n)| is_part(n)).map(|(k, _)| k).collect();
        Some(DryFriction { level: numbers.iter().position(|n| *n == level)?, parts })
    };
    [N::MotorCoulomb, N::StageCoulomb].into_iter().filter_map(of).collect()
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
///
/// `idle`: see [`Base`]; `None`: not known yet.
pub(super) fn base(balance: &Balance, (now, idle): (&Standing, Option<Idle>), accepted: &[Accepted]) -> Base {
    let ground = now.ground(balance);
    let mut numbers = balance.numbers();
    numbers.extend(now.found_loop.then_some(N::Lag));
    let mut columns = vec![balance.spectra_of_target(ground.path)];
    let mut bounds = Vec::new();
    let mut start = Vec::new();
    let moved = moved_laws(&ground, accepted);
    for number in &numbers {
        let more = moved.iter().find(|(n, _, _)| n == number).map(|(_, _, column)| (column, 1.0));
        columns.push(match more {
            Some(more) => balance.column(&TimeColumn::sum(
                [(&balance.number_column(*number, &ground), 1.0), more].into_iter(),
            )),
            None => balance.spectra_of(*number, &ground),
        });
        bounds.push(number_bounds(balance, now, (*number, accepted)));
        start.push(now.mechanics.of(*number));
    }
    let taken = columns_of_laws(balance, &ground, accepted, &moved);
    columns.extend(taken.columns);
    bounds.extend(taken.bounds);
    start.extend(taken.start);
    let knockoffs = columns.len();
    let plan = &balance.plan;
    let gram = Gram::new(plan, columns);
    let mut design = Design {
        target: 0,
        columns: Vec::new(),
        bounds: Vec::new(),
        dry: dry_of(&numbers),
        dynamics: Dynamics::at(balance.points.clone(), balance.shares.clone()),
        masses: numbers
            .iter()
            .enumerate()
            .filter(|(_, n)| n.is_mass() && now.inertial)
            .map(|(k, _)| (k, 0.0))
            .collect(),
        sides: balance.signals.sides(),
    };
    design.add(&gram, 1..knockoffs, bounds);
    let two = balance.signals.layout == Layout::TwoPositions;
    let all = gram.sum(plan, Part::All);
    let look = || if two { design.idle(&all, &numbers, &start) } else { Vec::new() };
    let idle = idle.unwrap_or_else(|| Arc::new(look()));
    design.dynamics = design.dynamics.idle_in(idle.clone());
    let weights = design.weights(&all, &start);
    let fit = balance.fit(&design, &all, &start, &weights);
    let weights = design.weights(&all, &fit.beta);
    // What is left, turned.
    let left = residual(balance, (&gram, &design, &fit.beta));
    let turned = |share: f64| Column {
        sides: [0, 1].map(|k| left.sides[k].as_ref().map(|s| plan.turned(s, share))),
        response: None,
    };
    let turned = QUARTERS.iter().map(|share| turned(*share));
    let rounding = balance.rounding(&ground).into_owned();
    // Of two positions what is left and steps that are elsewhere are one null world: alone, steps that make
    // nothing beside what is left would be a world of lines.
    let nulls: Vec<Column> = if two {
        turned.zip(&rounding).map(|(left, steps)| left.plus(steps)).collect()
    } else {
        turned.chain(rounding).collect()
    };
    let worlds = nulls.len();
    let gram = gram.with(plan, nulls);
    let all = gram.sum(plan, Part::All);
    let null = |k: usize| {
        let design = knockoff_design(&design, &fit.beta, knockoffs + k);
        design.fit(&all, vec![0.0; design.columns.len()], weights.clone())
    };
    let knockoff_fits = (0..worlds).map(null).collect();
    let held_out_nats = balance.held_out_nats(&gram, &design, &fit.beta);
    Base { numbers, gram, all, design, fit, weights, idle, knockoffs, knockoff_fits, held_out_nats }
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
pub(super) fn residual(balance: &Balance, (gram, design, beta): (&Gram, &Design, &[f64])) -> Column {
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
