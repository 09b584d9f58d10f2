//! The laws of a drive's balance: one file per effect, under the name that it has in `plant::effects`.
//!
//! A law is a small `Copy` struct of the constants that are not linear in it, with its facts, its columns of
//! the balance and what it tells ([`Law`]); an effect says where candidates of it start, which law a stated
//! term is and which key of the drive a finding becomes ([`Effect`]). To add one: its file, and its line in
//! `laws!`.

pub(crate) mod asymmetric_friction;
pub(crate) mod backlash;
pub(crate) mod coulomb_friction;
pub(crate) mod current_loop_lag;
pub(crate) mod cutting_force;
pub(crate) mod dead_time;
pub(crate) mod encoder_interpolation_error;
pub(crate) mod encoder_quantization;
pub(crate) mod external_disturbance;
pub(crate) mod friction_drift;
pub(crate) mod gravity_load;
pub(crate) mod nonlinear_stiffness;
pub(crate) mod nonlinear_viscosity;
pub(crate) mod position_dependent_force;
pub(crate) mod position_dependent_stiffness;
pub(crate) mod position_periodic_force;
pub(crate) mod presliding_friction;
mod search;
mod sheet;
mod stated;
pub(crate) mod stribeck_friction;
pub(crate) mod torque_constant_saturation;
pub(crate) mod torque_ripple;
pub(crate) mod torsional_mode;
pub(crate) mod viscous_friction;

pub(crate) use search::{SHORTEST, Search, grid};
pub(crate) use sheet::{Deviations, Sheet, Told, scale_deviation};
pub(crate) use stated::Stated;

use super::balance::{Balance, Standing};
use super::columns::{At, Ground, SpringLaw, TimeColumn};
use super::gram::Column;
use super::lines::{Demodulated, strongest_off};
use super::number::Mechanics;
use super::signals::{Layout, Path, Signals, Track};
use super::sliding::Follows;
use super::spectra::{Point, Series};
use crate::diagnosis::criteria::{Criteria, Z95};
use crate::diagnosis::result::ForceFaultKind;
use crate::plant::drive::RawDriveParams;
use crate::plant::effects::{
    AMPLITUDE_N, EffectKind, HARMONICS_N, PHASE, Parameter, ParameterValue, PhysicsTerm, Port, Specification,
    WITH_DIRECTION,
};
use crate::signal::inner_products::rms;
use position_dependent_force::Over;
use rustfft::num_complex::Complex;
use std::sync::Arc;

/// Where the size of a law is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Size {
    /// In its amplitudes, of either sign.
    Free,
    /// In its amplitudes, and physics allows no negative first one.
    Positive,
    /// In its constants: its amplitude is near one if it is true.
    Dose,
    /// In its constants, all of it: another amplitude is another law.
    Whole,
}

/// What the engine needs to know of a law.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Facts {
    pub(crate) effect: EffectKind,
    pub(crate) size: Size,
    /// Forces that its amplitudes are, for people.
    pub(crate) amplitudes: &'static [Parameter],
    /// It is a number of the model, or a fault of a column, and no finding.
    pub(crate) is_number: bool,
    /// Each recording has columns of its own: nothing carries over to another recording.
    pub(crate) is_of_one_recording: bool,
    /// A law of how the stage's friction turns: over a way, in place of over a speed.
    pub(crate) turns_friction: bool,
    /// It is dry friction of the stage and counts as such.
    pub(crate) is_dry_friction: bool,
    /// It stands in the place of the dry friction of the numbers.
    pub(crate) replaces_friction: bool,
    /// What its first column follows as dry friction does: a disturbance moves the axis the less.
    pub(crate) follows: Option<Follows>,
    /// It is made of numbers of the structure, all of its size in its constants.
    pub(crate) moves_with_numbers: bool,
    /// Its constants trade along a valley: the first alone must be determined.
    pub(crate) trades: bool,
}

impl Facts {
    /// Of a law that adds forces to every recording.
    const fn of(effect: EffectKind, size: Size, amplitudes: &'static [Parameter]) -> Self {
        Self {
            effect,
            size,
            amplitudes,
            is_number: false,
            is_of_one_recording: false,
            turns_friction: false,
            is_dry_friction: false,
            replaces_friction: false,
            follows: None,
            moves_with_numbers: false,
            trades: false,
        }
    }
}

/// A constant that is fitted, in its place.
pub(crate) struct Free<'a> {
    pub(crate) value: &'a mut f64,
    pub(crate) parameter: &'static Parameter,
}

impl<'a> Free<'a> {
    fn of(value: &'a mut f64, parameter: &'static Parameter) -> Self {
        Self { value, parameter }
    }
}

/// One law.
pub(crate) trait Law {
    /// What the engine needs to know of it.
    fn facts(&self) -> Facts;

    /// Its numbers for people, where they are not its amplitudes and then its constants.
    fn tell(&self, _told: &Told<'_>, _sheet: &mut Sheet) -> bool {
        false
    }

    /// What a term says of it beside its numbers for people.
    fn write(&self, _told: &Told<'_>, _term: &mut PhysicsTerm) {}

    /// Its constants, positive, those that are fitted by logarithmic steps.
    fn constants(&mut self) -> Vec<Free<'_>> {
        Vec::new()
    }

    /// Its columns of the balance, where they are not what [`Law::full`] says at its port.
    fn columns(&self, _ground: &Ground<'_>, _port: Port) -> Option<Vec<TimeColumn>> {
        None
    }

    /// One series a column at the full rate of a recording: a force at its port, N, or an error of its
    /// encoder, m. Empty: it has thinned columns only.
    fn full(&self, at: &At<'_>) -> Vec<Vec<f64>> {
        at.springs(&self.springs(at.ground))
    }

    /// Force of the spring for a stretch and a position, where that is what it changes.
    fn springs(&self, _ground: &Ground<'_>) -> Vec<SpringLaw> {
        Vec::new()
    }

    /// Where a refinement begins as well.
    fn starts(&self, _balance: &Balance) -> Vec<Shape> {
        Vec::new()
    }

    /// The law in more or fewer columns than it has.
    fn sizes(&self, _signals: &Signals) -> Vec<Shape> {
        Vec::new()
    }

    /// The law that repeats that many times as often.
    fn repeated(&self, _times: f64, _signals: &Signals) -> Option<Shape> {
        None
    }

    /// Another form of it with the same constants.
    fn twin(&self) -> Option<Shape> {
        None
    }

    /// What it becomes at a bound of its constants, for where the recordings do not determine them; with the
    /// deviations of their logarithms.
    fn limit(&self, _signals: &Signals, _deviations: &[f64]) -> Option<Shape> {
        None
    }

    /// Begins and ends, s since a recording began, where it lasts for a while: in each recording, or in one.
    fn windows_s(&mut self) -> &mut [[f64; 2]] {
        &mut []
    }

    /// Laws that may be what it seems to be: it is told by what it explains beside them.
    fn told_beside(&self, _signals: &Signals) -> Vec<Hypothesis> {
        Vec::new()
    }

    /// Free functions of the motion that it must explain more than, where there is one position.
    fn rivals(&self) -> &'static [(Over, bool)] {
        &[]
    }

    /// Takes over into its constants what a fit says of its amplitudes.
    fn follow(&mut self, _amplitudes: &[f64]) {}

    /// The model states it by its parts: these stay where a number beside them moves.
    fn state_by_parts(&mut self) {}

    /// The motor's inertia, the screw's in it, has become another number.
    fn motor_moved(&mut self, _from_kg: f64, _to_kg: f64) {}

    /// True for what every axis has, beside dry friction of that size.
    fn is_usual(&self, _ground: &Ground<'_>, _dry_n: f64, _amplitudes: &[f64]) -> bool {
        false
    }

    /// True where with the numbers and amplitudes that a fit leaves it is no law at all.
    fn is_void(&self, _ground: &Ground<'_>, _amplitudes: &[f64]) -> bool {
        false
    }

    /// Moves a number of the state in place of standing in it as a law; false: it does not.
    fn move_number(&self, _now: &mut Standing, _balance: &Balance) -> bool {
        false
    }

    /// The fault of a column that it is.
    fn fault(&self, _amplitudes: &[f64], _recording: usize) -> Option<ForceFaultKind> {
        None
    }
}

/// A law and its amplitudes.
pub(crate) type Fixed = (Shape, Vec<f64>);

/// An effect in the balance of a drive.
pub(crate) struct Effect {
    pub(crate) specification: &'static Specification,
    /// What may be asked of a state.
    pub(crate) candidates: fn(&Search<'_>) -> Vec<Hypothesis>,
    /// What may be wrong with the column of the force.
    pub(crate) faults: fn(&Search<'_>) -> Vec<Hypothesis>,
    /// The law of a term that states no force of position and velocity alone.
    pub(crate) stated: fn(&PhysicsTerm, &Mechanics) -> Option<Fixed>,
    /// Writes a finding, with the path as it was found, into the keys of a drive; false: it stands beside
    /// them as a term.
    pub(crate) key: fn(&PhysicsTerm, Path, &mut RawDriveParams) -> bool,
}

impl Effect {
    /// One that nothing is asked of, stated as a force if at all.
    const fn of(specification: &'static Specification) -> Self {
        Self {
            specification,
            candidates: |_| Vec::new(),
            faults: |_| Vec::new(),
            stated: |_, _| None,
            key: |_, _, _| false,
        }
    }

    /// The effect of that kind; `None`: none of a drive.
    pub(crate) fn of_kind(kind: EffectKind) -> Option<&'static Self> {
        EFFECTS.iter().copied().find(|e| e.specification.kind == kind)
    }
}

macro_rules! laws {
    ($($file:ident: [$($name:ident),*]),* $(,)?) => {
        /// A law with its constants.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub(crate) enum Shape { $($($name($file::$name),)*)* Stated(Stated) }

        impl Shape {
            pub(crate) fn law(&self) -> &dyn Law {
                match self { $($(Self::$name(law) => law,)*)* Self::Stated(law) => law }
            }

            fn law_mut(&mut self) -> &mut dyn Law {
                match self { $($(Self::$name(law) => law,)*)* Self::Stated(law) => law }
            }
        }

        $($(impl From<$file::$name> for Shape {
            fn from(law: $file::$name) -> Self { Self::$name(law) }
        })*)*

        /// Every effect of a drive.
        pub(crate) const EFFECTS: &[&Effect] = &[$(&$file::EFFECT),*];
    };
}

laws! {
    coulomb_friction: [Smoothing],
    viscous_friction: [],
    stribeck_friction: [Stribeck],
    presliding_friction: [Presliding],
    asymmetric_friction: [Asymmetric],
    gravity_load: [Gravity],
    nonlinear_viscosity: [NonlinearViscosity],
    friction_drift: [Drift],
    dead_time: [Delay, EncoderDelay],
    current_loop_lag: [CurrentLoop],
    torque_constant_saturation: [Saturation],
    position_periodic_force: [Wave],
    torque_ripple: [],
    cutting_force: [Cut, Push],
    position_dependent_force: [Map],
    encoder_interpolation_error: [Interpolation],
    encoder_quantization: [],
    nonlinear_stiffness: [Cubic],
    backlash: [Backlash, Gap, Play],
    position_dependent_stiffness: [StiffnessSlope, StiffnessWave],
    torsional_mode: [ThirdInertia],
    external_disturbance: [Mains],
}

/// What is asked: a law at a port.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Hypothesis {
    pub(crate) effect: EffectKind,
    pub(crate) port: Port,
    pub(crate) shape: Shape,
}

impl Hypothesis {
    pub(crate) fn new(port: Port, law: impl Into<Shape>) -> Self {
        let shape = law.into();
        Self { effect: shape.law().facts().effect, port, shape }
    }

    /// The same effect at the same port by another law.
    pub(crate) fn by(&self, shape: Shape) -> Self {
        Self { shape, ..*self }
    }

    pub(crate) fn law(&self) -> &dyn Law {
        self.shape.law()
    }

    pub(crate) fn law_mut(&mut self) -> &mut dyn Law {
        self.shape.law_mut()
    }

    pub(crate) fn facts(&self) -> Facts {
        self.law().facts()
    }

    /// True where the size of the law is in its constants.
    pub(crate) fn has_dose(&self) -> bool {
        matches!(self.facts().size, Size::Dose | Size::Whole)
    }

    /// What it is in a recording, one value per full-rate sample, see [`Law::full`].
    pub(crate) fn full(&self, ground: &Ground<'_>, track: &Track) -> Vec<Vec<f64>> {
        self.law().full(&ground.at(self.port, track))
    }

    /// Its columns of the balance.
    pub(crate) fn columns(&self, ground: &Ground<'_>) -> Vec<TimeColumn> {
        let forces = || {
            let (springs, follows) = (self.law().springs(ground), self.facts().follows);
            ground.forces(self.port, |track| self.full(ground, track), &springs, follows)
        };
        self.law().columns(ground, self.port).unwrap_or_else(forces)
    }

    /// Its numbers for people.
    pub(crate) fn tell(&self, told: &Told<'_>, sheet: &mut Sheet) {
        if self.law().tell(told, sheet) {
            return;
        }
        for (k, p) in self.facts().amplitudes.iter().enumerate() {
            sheet.force(p, told.amplitude(k), told.deviation(k));
        }
        let mut own = self.shape;
        for (k, c) in own.law_mut().constants().into_iter().enumerate() {
            sheet.constant(c.parameter, *c.value, told.relative(k));
        }
    }

    /// True where the constants carry all of the size.
    pub(crate) fn is_whole(&self) -> bool {
        self.facts().size == Size::Whole
    }

    /// True for a free function, of the position or of what stands in for it.
    pub(crate) fn is_map(&self) -> bool {
        matches!(self.shape, Shape::Map(_))
    }

    /// Begins and ends of what lasts for a while, see [`Law::windows_s`].
    pub(crate) fn windows_s(&self) -> Vec<[f64; 2]> {
        let mut own = self.shape;
        own.law_mut().windows_s().to_vec()
    }

    /// The same from another begin to another end in one window.
    pub(crate) fn within(mut self, window: usize, ends_s: [f64; 2]) -> Self {
        self.law_mut().windows_s()[window] = ends_s;
        self
    }

    /// How many constants it has.
    pub(crate) fn constants(&self) -> usize {
        let mut own = self.shape;
        own.law_mut().constants().len()
    }

    /// True where a constant is at a bound, to 2 %: then it is none.
    pub(crate) fn is_at_bound(&self) -> bool {
        let near = Criteria::STANDARD.at_bound;
        let is_near = |c: &Free<'_>| {
            let [low, high] = c.parameter.bounds;
            *c.value < low * (1.0 + near) || *c.value > high * (1.0 - near)
        };
        let mut own = self.shape;
        own.law_mut().constants().iter().any(is_near)
    }

    /// The same with every constant moved by a step of its logarithm, within its bounds.
    pub(crate) fn moved(mut self, steps: &[f64]) -> Self {
        for (c, step) in self.law_mut().constants().into_iter().zip(steps) {
            let [low, high] = c.parameter.bounds;
            *c.value = (*c.value * step.exp()).clamp(low, high);
        }
        self
    }

    /// The same with one constant times a factor.
    pub(crate) fn scaled(mut self, constant: usize, factor: f64) -> Self {
        self.law_mut().constants().into_iter().nth(constant).into_iter().for_each(|c| *c.value *= factor);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::effects::SPECIFICATIONS;

    #[test]
    fn every_effect_of_a_drive_is_in_the_balance_once() {
        for s in SPECIFICATIONS {
            assert_eq!(EFFECTS.iter().filter(|e| e.specification.kind == s.kind).count(), 1, "{}", s.kind);
        }
        assert_eq!(EFFECTS.len(), SPECIFICATIONS.len());
    }
}
