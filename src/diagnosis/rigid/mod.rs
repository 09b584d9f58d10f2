//! Axes with one position: rigid ones, semi-closed ones, friction devices, and outputs that are locked.
//!
//! ```text
//!   F(t) = M a + C v + F_c state(x) + F_0 + ...        rigid; the state: sgn v, or a slider behind a gap
//!   F(t) = K dz(x - x0, gap) + F_c state(x) + F_0      output locked to the frame
//! ```
//! There is one balance, so no port can be told from its side; laws are told apart by what they are
//! functions of. Every law is judged on stretches of time that were not fitted; inner constants that are not
//! smooth (gap, yield) carry profile intervals.

mod answer;
mod fit;
mod laws;
mod numbers;
mod search;
mod signals;
mod words;

use super::motion::is_flexible;
use super::{DiagnoseError, Diagnosis, Progress};
use crate::plant::drive::Structure;
use crate::plant::effects::{EffectKind, PhysicsTerm, Port};
use crate::plant::machine::{AxisModel, Machine};
use crate::sample::Recording;
use crate::signal::inner_products::rms;
use fit::Rows;
use laws::{Law, Scales, Slider};
use search::{Origin, Search, Term};
use signals::{Encoder, Series, series};
pub(super) use signals::{is_locked, motor_position, position, thrust};

/// Inertia below this share of the thrust carries no news about the mass: it is taken as stated.
const LEAST_INERTIA_SHARE: f64 = 0.02;

/// True where this module and not the two-sided balance is to answer.
pub(super) fn applies(axis: &AxisModel, recordings: &[Recording]) -> bool {
    axis.drive.structure() == Structure::Rigid
        || recordings.iter().all(|r| is_locked(axis, r))
        || !recordings.iter().all(|r| is_flexible(axis, r))
}

/// Says what the model of an axis with one position leaves out.
/// Errors: a missing column, a recording shorter than the filters.
pub(super) fn diagnose(
    machine: &Machine,
    axis: &AxisModel,
    recordings: &[Recording],
    progress: Progress<'_>,
) -> Result<Diagnosis, DiagnoseError> {
    let locked = axis.drive.structure() != Structure::Rigid && recordings.iter().all(|r| is_locked(axis, r));
    let series = recordings.iter().enumerate().map(|r| series(axis, r)).collect::<Result<Vec<_>, _>>()?;
    progress(0.1, "signals aligned");
    let scales = scales(axis, recordings, &series);
    let mut terms = base_terms(axis, &series, locked);
    let inertia = if locked { axis.drive.reflected_mass_kg() } else { axis.drive.total_mass_kg() };
    let carried = !terms.iter().any(|t| t.law == Law::Inertia);
    let target = series
        .iter()
        .flat_map(|s| s.thrust_n.iter().zip(&s.accel_m_s2))
        .map(|(f, a)| if carried { f - inertia * a } else { *f })
        .collect();
    let lengths: Vec<usize> = series.iter().map(|s| s.t_s.len()).collect();
    let stated = axis.physics.iter().enumerate();
    terms.extend(stated.filter_map(|(k, p)| Some(Term { law: given(p, axis)?, origin: Origin::Given(k) })));
    let rows = Rows::new(target, &lengths);
    let mut search = Search {
        rows,
        series,
        scales,
        terms,
        locked,
        stiffness_n_m: axis.drive.axial_stiffness_n_m(),
        tried: Vec::new(),
        independent: 0.0,
        least_evidence: 0.0,
    };
    let start = search.terms.clone();
    search.run();
    progress(0.8, "laws found");
    let mut answer = answer::answer((machine, axis), &search, &start);
    answer.notes.extend(one_side(axis, recordings).into_iter().filter(|_| !locked));
    progress(1.0, "done");
    Ok(answer)
}

/// Sentences where the model is of two sides and recordings show one of them only.
fn one_side(axis: &AxisModel, recordings: &[Recording]) -> Vec<String> {
    if axis.drive.structure() == Structure::Rigid {
        return Vec::new();
    }
    let note = |what: &str, column: &str, lacks: &dyn Fn(&Recording) -> bool| {
        let lacking = recordings.iter().filter(|r| lacks(r));
        let without: Vec<&str> = lacking.map(|r| r.experiment.as_str()).collect();
        (!without.is_empty()).then(|| {
            format!(
                "The {what} ({column}) is absent from {}: the answer is of one force balance of the whole \
                 axis, below {:.0} % of its resonance, and cannot tell the motor's side from the stage's.",
                without.join(", "),
                100.0 * signals::RIGID_SHARE
            )
        })
    };
    let [stage, motor] =
        ["stage_position_m", "motor_angle_rad"].map(|suffix| format!("{}_{suffix}", axis.name));
    let no_stage = note("stage's position", &stage, &|r| r.get(&stage).is_none());
    let no_motor = note("motor's angle", &motor, &|r| signals::motor_position(axis, r).is_none());
    no_stage.into_iter().chain(no_motor).collect()
}

fn scales(axis: &AxisModel, recordings: &[Recording], series: &[Series]) -> Scales {
    let fastest = series.iter().flat_map(|s| &s.velocity_m_s).fold(0.0_f64, |a, v| a.max(v.abs()));
    let [low, high] = series
        .iter()
        .flat_map(|s| &s.position_m)
        .fold([f64::INFINITY, f64::NEG_INFINITY], |e, x| [e[0].min(*x), e[1].max(*x)]);
    let stated = axis.drive.raw().friction_smoothing_m_s;
    let read = recordings.first().map(|r| Encoder::of(axis, r));
    Scales {
        smoothing_m_s: stated.unwrap_or(2.0e-3 * fastest).max(1.0e-12),
        fastest_m_s: fastest,
        stroke_m: (high - low).max(1.0e-12),
        lowest_m: low,
        resolution_m: read.map_or(0.0, |e| e.resolution_m),
        mass_kg: axis.drive.total_mass_kg(),
        loop_s: axis.drive.current_loop_s(),
        signal_m: read.and_then(|e| e.signal_m),
        lead_m: axis.drive.screw_lead_m(),
        period_s: recordings.first().map_or(0.0, |r| r.sample_rate.period_s()),
        current: series.iter().all(|s| s.thrust_n_a.is_some()),
    }
}

/// Numbers that the model states for the structure.
fn base_terms(axis: &AxisModel, series: &[Series], locked: bool) -> Vec<Term> {
    let d = &axis.drive;
    let number = |law, key| Term { law, origin: Origin::Number(key) };
    if locked {
        let centre = series.iter().flat_map(|s| &s.position_m).sum::<f64>()
            / series.iter().map(|s| s.t_s.len()).sum::<usize>().max(1) as f64;
        let spring = number(Law::Spring { centre_m: centre, gap_m: 0.0 }, "axial_stiffness_n_m");
        return vec![spring, Term { law: Law::Constant, origin: Origin::Nuisance }];
    }
    let mut terms = Vec::new();
    let thrust: Vec<f64> = series.iter().flat_map(|s| s.thrust_n.iter().copied()).collect();
    let accel: Vec<f64> = series.iter().flat_map(|s| s.accel_m_s2.iter().copied()).collect();
    if d.total_mass_kg() * rms(&accel) > LEAST_INERTIA_SHARE * rms(&thrust) {
        terms.push(number(Law::Inertia, "movable_mass_kg"));
    }
    if d.translational_damping_n_s_m() + d.reflected_damping_n_s_m() > 0.0 {
        terms.push(number(Law::Viscous, "translational_damping_n_s_m"));
    }
    if d.stage_coulomb_friction_n() + d.motor_coulomb_friction_n() > 0.0 {
        terms.push(number(Law::Friction(Slider::STEP), "stage_coulomb_friction_n"));
    }
    terms
}

/// True where a law of the model is heeded here.
pub(super) fn knows(term: &PhysicsTerm, axis: &AxisModel) -> bool {
    // Friction and gap of a slider are parts of one law.
    let part = matches!(term.effect, EffectKind::CoulombFriction | EffectKind::Backlash);
    given(term, axis).is_some()
        || part && axis.physics.iter().any(|t| t.effect == EffectKind::PreslidingFriction)
}

/// A physics table of the model as a law; its amplitude is re-estimated like any number.
fn given(term: &PhysicsTerm, axis: &AxisModel) -> Option<Law> {
    let (all, lead_m) = (&axis.physics, axis.drive.screw_lead_m());
    let friction = |key: &str| {
        let one = |e: EffectKind| all.iter().find(|t| t.effect == e);
        one(EffectKind::PreslidingFriction).and_then(|t| t.number(key))
    };
    Some(match term.effect {
        EffectKind::ViscousFriction => Law::Viscous,
        // Beside presliding it is the force of that slider.
        EffectKind::CoulombFriction if friction("force_n").is_some() => return None,
        EffectKind::CoulombFriction => Law::Friction(Slider::STEP),
        EffectKind::GravityLoad => Law::Constant,
        EffectKind::NonlinearViscosity => Law::Square,
        EffectKind::AsymmetricFriction
            if term.number("viscous_difference_n_s_m").is_some_and(|slope| slope != 0.0) =>
        {
            Law::DirectionalViscous
        }
        EffectKind::AsymmetricFriction => Law::DirectionalDry(Slider::STEP),
        EffectKind::StribeckFriction => Law::Stribeck { velocity_m_s: term.number("stribeck_velocity_m_s")? },
        EffectKind::PreslidingFriction => {
            let yield_m = term.number("force_n")? / term.number("presliding_stiffness_n_m")?;
            let gap_m = all.iter().find(|t| t.effect == EffectKind::Backlash).and_then(|t| t.number("gap_m"));
            // Without a gap the law of the simulation, unless the table says otherwise.
            let gradual = gap_m.is_none() && term.number("gradual").is_none_or(|x| x != 0.0);
            Law::Friction(Slider { yield_m, gap_m: gap_m.unwrap_or(0.0), gradual })
        }
        EffectKind::Backlash => {
            // Beside presliding the gap is part of the slider; alone it belongs to a locked output.
            if friction("presliding_stiffness_n_m").is_some() && term.number("centre_m").is_none() {
                return None;
            }
            Law::Spring { centre_m: term.number("centre_m").unwrap_or(0.0), gap_m: term.number("gap_m")? }
        }
        EffectKind::FrictionDrift => {
            Law::Drift { time_s: term.number("time_constant_s")?, slider: Slider::STEP }
        }
        EffectKind::PositionPeriodicForce => Law::Wave { wavelength_m: term.number("wavelength_m")? },
        EffectKind::PositionDependentForce => Law::Map {
            first_m: term.number("first_m")?,
            spacing_m: term.number("spacing_m")?,
            knots: term.list("force_n").map(<[f64]>::len).filter(|n| *n > 1)?,
        },
        EffectKind::TorqueRipple => Law::Wave { wavelength_m: lead_m? / term.number("order_per_rev")? },
        EffectKind::DeadTime if term.port == Port::Current => {
            Law::Late { delay_s: term.number("extra_delay_s")? }
        }
        EffectKind::CurrentLoopLag => {
            let slower_s = 1.0 / term.number("bandwidth_rad_s")?;
            Law::Slow { extra_s: (slower_s - axis.drive.current_loop_s()).max(1e-7) }
        }
        EffectKind::EncoderInterpolationError if term.port == Port::MotorEncoder => {
            Law::Interpolation { period_m: term.number("signal_period_m")? }
        }
        EffectKind::TorqueConstantSaturation => Law::Saturation,
        _ => return None,
    })
}
