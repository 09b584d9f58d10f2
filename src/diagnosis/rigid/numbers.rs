//! Numbers of the model, of its structure and of its laws, that the recordings have elsewhere.

use super::answer::{Context, Fitted, Z95};
use super::search::Origin;
use crate::diagnosis::Correction;
use crate::diagnosis::corrections::OtherSize;
use crate::signal::inner_products::rms;

/// The motor side's part of a sum is known as well as a data sheet is, as a deviation.
const STATED_SHARE: f64 = 0.02;

impl Context<'_> {
    /// Numbers of the drive that differ by more than four standard deviations and more than they are known
    /// to.
    pub(super) fn corrections(&self) -> Vec<Correction> {
        let d = &self.axis.drive;
        let mut list = Vec::new();
        for f in &self.fitted {
            let Origin::Number(name) = f.term.origin else { continue };
            let (nominal, other, limit) = match name {
                "movable_mass_kg" => (d.movable_mass_kg(), d.total_mass_kg() - d.movable_mass_kg(), 0.02),
                "translational_damping_n_s_m" => {
                    (d.translational_damping_n_s_m(), d.reflected_damping_n_s_m(), 0.12)
                }
                "stage_coulomb_friction_n" => {
                    (d.stage_coulomb_friction_n(), d.motor_coulomb_friction_n(), 0.08)
                }
                _ => (d.axial_stiffness_n_m(), 0.0, 0.03),
            };
            // The balance holds the sum of both sides; what is off is off from the sum.
            let (value, total) = (f.amplitudes[0] - other, nominal + other);
            let sure = f.deviations[0].hypot(self.scale() * f.amplitudes[0]);
            // Which side it is off on, the balance does not say: that widens the number, not the doubt.
            let half = Z95 * sure.hypot(STATED_SHARE * other);
            let apart = (value - nominal).abs();
            if nominal > 0.0 && value > 0.0 && apart > 3.0 * sure && apart > limit * total {
                let name = name.into();
                list.push(Correction { name, nominal, value, ci95: [value - half, value + half] });
            }
        }
        list
    }

    /// Laws that the model states and the recordings have at another size: index, term and number.
    pub(super) fn laws_of_other_size(&self) -> Vec<OtherSize> {
        /// Beyond this share of itself, and of the thrust.
        const APART: [f64; 2] = [0.2, 0.01];
        let thrust_n = self.thrust_rms_n();
        let of = |f: &Fitted<'_>| {
            let Origin::Given(index) = f.term.origin else { return None };
            let (term, law, level) = (&self.axis.physics[index], f.term.law, self.friction_level());
            let stated = law.stated_amplitudes(term, level)?;
            let columns = self.search.columns(law);
            let force_n = |amplitudes: &[f64]| {
                let at = |k: usize| columns.iter().zip(amplitudes).map(|(c, a)| a * c[k]).sum::<f64>();
                rms(&(0..self.search.rows.target.len()).map(at).collect::<Vec<f64>>())
            };
            let change: Vec<f64> = f.amplitudes.iter().zip(&stated).map(|(a, s)| a - s).collect();
            let change_n = force_n(&change);
            let (key, unit) = law.amplitude_key(level)?;
            let [nominal, value] = [&stated, &f.amplitudes].map(|a| law.size(a) * unit);
            let sure = f.deviations[0].hypot(self.scale() * f.amplitudes[0]);
            let told = change_n > APART[0] * force_n(&stated).max(force_n(&f.amplitudes))
                && change_n > (APART[1] * thrust_n).max(self.floor_n)
                && change.iter().map(|c| c * c).sum::<f64>().sqrt() > 3.0 * sure;
            let name = format!("{}.{key}", term.effect.name()).into();
            let half = Z95 * sure * unit.abs();
            told.then(|| OtherSize {
                index,
                term: law.with_amplitudes(term.clone(), &f.amplitudes, level),
                corrections: vec![Correction { name, nominal, value, ci95: [value - half, value + half] }],
            })
        };
        self.fitted.iter().filter_map(of).collect()
    }
}
