//! Laws that the model states, held against the size that the recordings have them at.
//!
//! Their amplitudes and constants are fitted again beside the numbers of the drive. One that comes out
//! elsewhere is a wrong number of the model, as a mass would be.

use super::assemble::Case;
use super::bench::{Accepted, add, rms};
use super::corrections::OtherSize;
use super::hypothesis_fit::HypothesisFit;
use super::problem::Column;
use super::result::{Correction, Estimate};
use super::terms;
use crate::plant::effects::EffectKind;
use std::f64::consts::{PI, TAU};

/// A size that is off by less is the same law: friction is not the same twice.
const SAME_SIZE: f64 = 0.15;
/// The same of a length, an order or a frequency.
const SAME_PLACE: f64 = 0.02;
/// The same of a phase, rad.
const SAME_PHASE: f64 = 0.3;

impl Case<'_> {
    /// Laws of the stated model that the recordings have at another size.
    pub(super) fn laws_of_other_size(&self) -> Vec<OtherSize> {
        let p = &self.outcome.state.problem;
        let accepted = &self.outcome.state.accepted[..self.outcome.state.given];
        let stated = self.axis.physics.iter().enumerate();
        let known = stated.filter_map(|(index, term)| Some((index, term, terms::hypothesis(p, term)?)));
        let mut list = Vec::new();
        for (k, ((index, term, (h, amplitudes)), a)) in known.zip(accepted).enumerate() {
            if term.effect == EffectKind::CuttingForce {
                continue; // a cut belongs to its own recording
            }
            let fit = self.bench.accepted_fit(k);
            let stated = terms::estimates(p, &h, &HypothesisFit::exact(&h, amplitudes.clone()));
            let found = terms::estimates(p, &a.hypothesis, &fit);
            let corrections = contradicted(term.effect, &stated, &found);
            let mut change = force(&Accepted::new(p, h, amplitudes), &[]);
            add(&mut change, &force(a, &fit.amplitudes), -1.0);
            if !corrections.is_empty() && rms(&change) > self.floor_rms_n() {
                let term = terms::term(p, &a.hypothesis, &fit);
                list.push(OtherSize { index, term, corrections });
            }
        }
        list
    }
}

/// What a law does to the balance; without amplitudes those that it states.
fn force(law: &Accepted, amplitudes: &[f64]) -> Column {
    let amplitudes = if amplitudes.is_empty() { &law.amplitudes } else { amplitudes };
    let mut parts = law.columns.iter().zip(amplitudes);
    let Some((first, amplitude)) = parts.next() else { return Column::default() };
    let mut sum = scaled(first, *amplitude);
    parts.for_each(|(column, amplitude)| add(&mut sum, column, *amplitude));
    sum
}

fn scaled(column: &Column, factor: f64) -> Column {
    let mut column = column.clone();
    for side in column.iter_mut().flat_map(|s| [&mut s.motor, &mut s.stage]).flatten() {
        side.iter_mut().for_each(|x| *x *= factor);
    }
    column
}

/// Numbers of a stated law that lie outside their interval and far from what it says.
fn contradicted(effect: EffectKind, stated: &[Estimate], found: &[Estimate]) -> Vec<Correction> {
    let of = |e: &Estimate| {
        let nominal = stated.iter().find(|s| s.name == e.name)?.value;
        let apart = match e.name.as_str() {
            "phase_rad" => ((e.value - nominal + PI).rem_euclid(TAU) - PI).abs() / SAME_PHASE,
            "length_m" => 0.0,
            "wavelength_m" | "signal_period_m" | "order_per_rev" | "free_free_frequency_hz" => {
                (e.value / nominal - 1.0).abs() / SAME_PLACE
            }
            _ => (e.value - nominal).abs() / nominal.abs().max(e.value.abs()) / SAME_SIZE,
        };
        let outside = !(e.ci95[0].min(e.ci95[1])..=e.ci95[0].max(e.ci95[1])).contains(&nominal);
        let name = format!("{}.{}", effect.name(), e.name).into();
        (outside && apart > 1.0).then_some(Correction { name, nominal, value: e.value, ci95: e.ci95 })
    };
    found.iter().filter_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(amplitude_n: f64, phase_rad: f64, half: f64) -> Vec<Estimate> {
        let of = |name: &str, value: f64, half: f64| Estimate {
            name: name.into(),
            value,
            unit: "",
            ci95: [value - half, value + half],
        };
        vec![
            of("wavelength_m", 0.005, 1e-6),
            of("amplitude_n", amplitude_n, half),
            of("phase_rad", phase_rad, 0.25 * half),
        ]
    }

    #[test]
    fn only_what_lies_outside_its_interval_and_far_away_is_contradicted() {
        let names = |stated: &[Estimate]| -> Vec<String> {
            let found = wave(5.6, 3.1, 0.2);
            let list = contradicted(EffectKind::PositionPeriodicForce, stated, &found);
            list.into_iter().map(|c| c.name.into_owned()).collect()
        };
        assert_eq!(names(&wave(16.8, 3.1, 0.0)), ["position_periodic_force.amplitude_n"]);
        assert_eq!(names(&wave(5.5, -3.1, 0.0)), Vec::<String>::new(), "a turn apart is the same phase");
        assert_eq!(names(&wave(5.0, 3.1, 0.0)), Vec::<String>::new(), "a tenth off is the same law");
        assert_eq!(names(&wave(5.6, 0.1, 0.0)), ["position_periodic_force.phase_rad"]);
        assert_eq!(names(&wave(0.0, 3.1, 0.0)), ["position_periodic_force.amplitude_n"]);
    }
}
