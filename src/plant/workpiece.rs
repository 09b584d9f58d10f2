//! The slender workpiece as a clamped-free beam that bends in its first mode.
//!
//! ```text
//!  chuck |=====================o  tool at z, diameter d, projection length L
//!        0                     L       bending mode phi(z), phi(L) = 1
//! ```
//!
//! It knows its mass, stiffness, damping and mode shape; it does not know that anything cuts it.

use super::scenario_error::{Rule, ScenarioError, checked};
use std::f64::consts::PI;

/// First root of `cos(x) cosh(x) = -1`: the wave number of a cantilever's first mode times its length.
pub const FIRST_MODE_ROOT: f64 = 1.875_104_068_711_961;

/// What is known about a bar before it is checked. `Default` is the bar of the thesis' monitoring test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawWorkpiece {
    /// d.
    pub diameter_m: f64,
    /// L, from the chuck to the free end.
    pub projection_length_m: f64,
    /// E.
    pub elastic_modulus_pa: f64,
    /// rho (the thesis calls it specific weight; mass density is meant).
    pub density_kg_m3: f64,
    /// zeta, of the first bending mode.
    pub damping_ratio: f64,
    /// Natural frequency divided by that of a rigid clamp.
    pub clamp_factor: f64,
    /// A tap test of whatever gives way; it replaces length, modulus, density and clamp.
    pub tap_test: Option<TapTest>,
}

/// Frequency and stiffness of the compliant part as they were measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TapTest {
    /// f_n.
    pub natural_frequency_hz: f64,
    /// k.
    pub modal_stiffness_n_m: f64,
}

impl Default for RawWorkpiece {
    fn default() -> Self {
        Self {
            diameter_m: 0.0249,
            projection_length_m: 0.180,
            elastic_modulus_pa: 193e9,
            density_kg_m3: 7850.0,
            damping_ratio: 0.01,
            clamp_factor: 0.975,
            tap_test: None,
        }
    }
}

impl RawWorkpiece {
    /// Another natural frequency with the same modal mass: `clamp_factor`, or the tap test's frequency, times
    /// `factor`; what moves f_n leaves mass and damping ratio.
    #[must_use]
    pub fn with_frequency_factor(mut self, factor: f64) -> Self {
        match &mut self.tap_test {
            Some(tap) => {
                tap.natural_frequency_hz *= factor;
                tap.modal_stiffness_n_m *= factor * factor;
            }
            None => self.clamp_factor *= factor,
        }
        self
    }
}

/// A bar with a physical description.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Workpiece {
    raw: RawWorkpiece,
}

impl Workpiece {
    /// Errors: a length, modulus, density or clamp factor that is not positive; damping outside [0, 1).
    pub fn new(raw: RawWorkpiece) -> Result<Self, ScenarioError> {
        checked("diameter_m", raw.diameter_m, Rule::Positive)?;
        checked("projection_length_m", raw.projection_length_m, Rule::Positive)?;
        checked("elastic_modulus_pa", raw.elastic_modulus_pa, Rule::Positive)?;
        checked("density_kg_m3", raw.density_kg_m3, Rule::Positive)?;
        checked("damping_ratio", raw.damping_ratio, Rule::Fraction)?;
        checked("clamp_factor", raw.clamp_factor, Rule::Positive)?;
        if let Some(tap) = raw.tap_test {
            checked("natural_frequency_hz", tap.natural_frequency_hz, Rule::Positive)?;
            checked("modal_stiffness_n_m", tap.modal_stiffness_n_m, Rule::Positive)?;
        }
        Ok(Self { raw })
    }

    /// What it was made from.
    #[must_use]
    pub fn raw(&self) -> &RawWorkpiece {
        &self.raw
    }

    /// The same bar turned down to another diameter. Errors: as [`Workpiece::new`].
    pub fn with_diameter_m(&self, diameter_m: f64) -> Result<Self, ScenarioError> {
        Self::new(RawWorkpiece { diameter_m, ..self.raw })
    }

    /// d.
    #[must_use]
    pub fn diameter_m(&self) -> f64 {
        self.raw.diameter_m
    }

    /// L.
    #[must_use]
    pub fn projection_length_m(&self) -> f64 {
        self.raw.projection_length_m
    }

    /// True where a tap test states the compliance: its shape is 1 everywhere.
    #[must_use]
    pub fn is_tapped(&self) -> bool {
        self.raw.tap_test.is_some()
    }

    /// Frequency of the first bending mode; that of the tap test where there is one.
    ///
    /// f_n = clamp * 1.8751^2 / (2 pi L^2) * sqrt(E I / (A rho)),  I = pi d^4/64, A = pi d^2/4      (6-11)
    ///
    /// Units: Hz. Requires: slender (L several d); the tools out of the cut.
    /// Source: Yamada, PhD thesis, Keio Univ. 2017, 6.4.3, eq. (6-11).
    /// Deviation: factor `clamp_factor` for a chuck that gives way; rho is mass density (docs/errata.md).
    /// Checked by: `bending_frequencies_of_the_thesis`, `the_reference_bar`.
    #[must_use]
    pub fn bending_frequency_hz(&self) -> f64 {
        let raw = &self.raw;
        if let Some(tap) = raw.tap_test {
            return tap.natural_frequency_hz;
        }
        // sqrt(I/A) = d/4 for a round bar.
        let wave_speed_m_s = (raw.elastic_modulus_pa / raw.density_kg_m3).sqrt();
        let l = raw.projection_length_m;
        raw.clamp_factor * FIRST_MODE_ROOT.powi(2) / (2.0 * PI * l * l) * wave_speed_m_s * raw.diameter_m
            / 4.0
    }

    /// Modal mass of the first mode with phi(L) = 1: m = rho A L / 4.
    ///
    /// Units: kg. Source: integral of rho A phi^2 over the bar. Checked by: `modal_mass_is_the_integral`.
    #[must_use]
    pub fn modal_mass_kg(&self) -> f64 {
        let raw = &self.raw;
        if let Some(tap) = raw.tap_test {
            return tap.modal_stiffness_n_m / (2.0 * PI * tap.natural_frequency_hz).powi(2);
        }
        raw.density_kg_m3 * PI * raw.diameter_m.powi(2) / 4.0 * raw.projection_length_m / 4.0
    }

    /// Modal stiffness k = m (2 pi f_n)^2, N/m at the free end. Checked by: `the_reference_bar`.
    #[must_use]
    pub fn modal_stiffness_n_m(&self) -> f64 {
        self.modal_mass_kg() * (2.0 * PI * self.bending_frequency_hz()).powi(2)
    }

    /// Modal damping c = 2 zeta sqrt(k m), N s/m.
    #[must_use]
    pub fn modal_damping_n_s_m(&self) -> f64 {
        2.0 * self.raw.damping_ratio * (self.modal_stiffness_n_m() * self.modal_mass_kg()).sqrt()
    }

    /// Shape of the first bending mode at `position_m` from the chuck, 1 at the free end.
    ///
    /// phi(z) = [cosh bz - cos bz - s (sinh bz - sin bz)] / 2,  b = 1.8751/L,
    /// s = (cosh bL + cos bL)/(sinh bL + sin bL)
    ///
    /// Outside the bar the nearest end's value holds. Source: Euler-Bernoulli beam, clamped-free.
    /// Checked by: `modal_mass_is_the_integral`, `mode_shape_at_its_ends`.
    #[must_use]
    pub fn mode_shape(&self, position_m: f64) -> f64 {
        if self.is_tapped() {
            return 1.0;
        }
        let r = FIRST_MODE_ROOT;
        let s = (r.cosh() + r.cos()) / (r.sinh() + r.sin());
        let x = r * (position_m / self.raw.projection_length_m).clamp(0.0, 1.0);
        (x.cosh() - x.cos() - s * (x.sinh() - x.sin())) / 2.0
    }

    /// z/L of a bar that stays straight and rocks at the chuck; 1 everywhere for a tap test.
    #[must_use]
    pub fn straight_shape(&self, position_m: f64) -> f64 {
        if self.is_tapped() { 1.0 } else { (position_m / self.raw.projection_length_m).clamp(0.0, 1.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bar(diameter_m: f64, projection_length_m: f64, clamp_factor: f64) -> Workpiece {
        let raw = RawWorkpiece { diameter_m, projection_length_m, clamp_factor, ..RawWorkpiece::default() };
        Workpiece::new(raw).unwrap()
    }

    #[test]
    fn bending_frequencies_of_the_thesis() {
        // Printed: 533 Hz and 599 Hz; 1 % because the material's numbers are not printed.
        for (d, l, f) in [(0.0249, 0.180, 533.0), (0.0221, 0.160, 599.0)] {
            let got = bar(d, l, 1.0).bending_frequency_hz();
            assert!((got / f - 1.0).abs() < 0.01, "{got} Hz, printed {f} Hz");
        }
    }

    #[test]
    fn the_reference_bar() {
        let bar = Workpiece::new(RawWorkpiece::default()).unwrap();
        assert!((bar.bending_frequency_hz() - 519.77).abs() < 0.01);
        assert!((bar.modal_mass_kg() - 0.172_017).abs() < 1e-6);
    }

    #[test]
    fn mode_shape_at_its_ends() {
        let bar = bar(0.02, 0.2, 1.0);
        assert!(bar.mode_shape(0.0).abs() < 1e-15);
        assert!((bar.mode_shape(0.2) - 1.0).abs() < 1e-12);
        assert!((bar.mode_shape(0.3) - 1.0).abs() < 1e-12);
        assert!((bar.mode_shape(0.1) - 0.3395).abs() < 1e-4); // tables of beam modes
    }

    #[test]
    fn modal_mass_is_the_integral() {
        let bar = bar(0.02, 0.2, 1.0);
        let n = 2000;
        let mean: f64 =
            (0..n).map(|i| bar.mode_shape(0.2 * (f64::from(i) + 0.5) / f64::from(n)).powi(2)).sum::<f64>();
        assert!((mean / f64::from(n) - 0.25).abs() < 1e-6);
    }

    #[test]
    fn an_unphysical_bar_is_refused_by_name() {
        let raw = RawWorkpiece { diameter_m: -1.0, ..RawWorkpiece::default() };
        assert_eq!(
            Workpiece::new(raw).unwrap_err().to_string(),
            "diameter_m = -1 is not physical: a finite number above zero"
        );
    }
}
