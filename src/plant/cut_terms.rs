//! One condition of a cut as plain coefficients: what the structure states, and what the effects add.
//!
//! [`CutTerms::of`] (`scenario_terms`) is the one place where a scenario becomes a cut; the linear equation
//! (`cut_loop`), the lathe in time and the fits read its numbers.

use super::cutting::{ToolCount, delays_s};
use super::workpiece::{FIRST_MODE_ROOT, Workpiece};
use std::f64::consts::PI;

/// Under what a cut is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutCondition {
    /// S.
    pub speed_rpm: f64,
    /// f, feed per turn.
    pub feed_m_rev: f64,
    /// b, width of cut of each tool.
    pub width_m: f64,
    /// z, tools from the chuck.
    pub position_m: f64,
    /// d = theta_2 - theta_1.
    pub pitch_difference_rad: f64,
    /// D, of the work.
    pub diameter_m: f64,
    /// Since the start of the recording, with a cold bar.
    pub time_s: f64,
    /// Since the edges were fresh.
    pub edge_age_s: f64,
}

impl CutCondition {
    /// T = 60/S, s.
    #[must_use]
    pub fn turn_s(&self) -> f64 {
        60.0 / self.speed_rpm
    }

    /// v = pi D/T, m/s.
    #[must_use]
    pub fn surface_speed_m_s(&self) -> f64 {
        PI * self.diameter_m / self.turn_s()
    }
}

/// What the scenario's numbers are referred to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutReferences {
    /// The scenario's speed.
    pub speed_rpm: f64,
    /// v0: surface speed there.
    pub surface_speed_m_s: f64,
    /// b0: the scenario's width.
    pub width_m: f64,
    /// h_r: half the scenario's feed.
    pub chip_m: f64,
    /// The scenario's tool position.
    pub position_m: f64,
    /// K_r b0, of one tool.
    pub cutting_stiffness_n_m: f64,
    /// T/2 (two tools) or T (one) at the scenario's speed.
    pub mean_delay_s: f64,
}

/// A mass on a spring, as it is stated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Oscillator {
    /// Natural frequency.
    pub frequency_hz: f64,
    /// Damping ratio.
    pub damping_ratio: f64,
    /// Stiffness.
    pub stiffness_n_m: f64,
}

/// What the force on a chip that vibrates is over that of the law, which knows the chip of this moment alone:
/// (1 + gain) exp(-s late). Of a shear plane that hardens, a temperature that follows, an edge that builds up
/// one number each way; no scenario states it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChipMemory {
    /// 1.
    pub gain: f64,
    /// s.
    pub late_s: f64,
}

impl ChipMemory {
    /// The law as it stands.
    pub const NONE: Self = Self { gain: 0.0, late_s: 0.0 };
}

/// The bar's other plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OtherPlane {
    /// Its frequency, not shifted.
    pub frequency_hz: f64,
    /// a: angle of the stated plane from the tool line.
    pub orientation_rad: f64,
}

/// One condition of a cut: numbers of the structure, and of the effects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutTerms {
    /// The condition.
    pub at: CutCondition,
    /// One tool or two.
    pub tools: ToolCount,
    /// b/b0, by which every per-tool force grows (1 where the scenario states no width).
    pub width_ratio: f64,
    /// h_r.
    pub reference_chip_m: f64,
    /// K_r at the scenario's speed and width.
    pub radial_stiffness_pa: f64,
    /// Factor of K_r b: speed, corner, wear.
    pub pressure_factor: f64,
    /// p.
    pub exponent: f64,
    /// K_r of tool 2 over that of tool 1.
    pub ratio: f64,
    /// F_e at b0.
    pub edge_force_n: f64,
    /// C_i at b0.
    pub process_damping_n: f64,
    /// C_f at b0: flank force per unit slope beyond the clearance.
    pub flank_force_n: f64,
    /// tan gamma.
    pub clearance_slope: f64,
    /// k_c at b0.
    pub contact_stiffness_n_m: f64,
    /// Tangential over radial force.
    pub tangential_ratio: f64,
    /// Share of the past motion in the chip.
    pub overlap: f64,
    /// Runout of order 0.
    pub tool2_ahead_m: f64,
    /// Mean over a turn of what the stock does to the whole law.
    pub stock_factor: f64,
    /// Lag of first order of the force.
    pub force_lag_s: f64,
    /// Force on a chip that vibrates, over that of the law: no effect of the vocabulary.
    pub memory: ChipMemory,
    /// Bar as it is stated.
    pub workpiece: Workpiece,
    /// Added to the frequencies of the bar.
    pub frequency_shift_hz: f64,
    /// n_m of a chuck that rocks.
    pub support_stiffness_n_m: Option<f64>,
    /// Other plane.
    pub second_plane: Option<OtherPlane>,
    /// Second mode, straight shape.
    pub second_mode: Option<Oscillator>,
    /// Holder of tool 2.
    pub turret: Option<Oscillator>,
}

impl CutTerms {
    /// tau_1 and tau_2; with one tool a whole turn each.
    #[must_use]
    pub fn delays_s(&self) -> [f64; 2] {
        match self.tools {
            ToolCount::Two => delays_s(self.at.turn_s(), self.at.pitch_difference_rad),
            ToolCount::One => [self.at.turn_s(); 2],
        }
    }

    /// Advance of each tool since the surface that it cuts was left: f theta_2/2pi and f theta_1/2pi.
    #[must_use]
    pub fn chips_m(&self) -> [f64; 2] {
        let per_turn = self.at.feed_m_rev / self.at.turn_s();
        let [delay_1_s, delay_2_s] = self.delays_s();
        [per_turn * delay_2_s, per_turn * delay_1_s]
    }

    /// r2 = sin a (sin a + mu cos a): share of the other plane in the bar's motion along the tool line.
    #[must_use]
    pub fn other_plane_share(&self) -> f64 {
        self.second_plane.map_or(0.0, |plane| {
            let (sin, cos) = plane.orientation_rad.sin_cos();
            sin * (sin + self.tangential_ratio * cos)
        })
    }

    /// Shape of the bar at the tools and modal mass, with the chuck as it gives way.
    ///
    /// shape = (1-s) phi + s z/L, s = k/(k + n_m);  mass = rho A integral of shape^2
    ///
    /// With b L = 1.8751: integral of phi^2 = L/4, of phi z/L = L/(b L)^2, of (z/L)^2 = L/3. A bar that is
    /// stated by a tap test has the shape 1 everywhere.
    /// Checked by: `a_rocking_bar_has_the_mass_of_its_shape`.
    #[must_use]
    pub fn bar_at_tools(&self) -> BarAtTools {
        let bar = self.workpiece.with_diameter_m(self.at.diameter_m).unwrap_or(self.workpiece);
        let shape = bar.mode_shape(self.at.position_m);
        let mass_kg = bar.modal_mass_kg();
        let frequency_hz = bar.bending_frequency_hz() + self.frequency_shift_hz;
        let rocking = self.support_stiffness_n_m.map_or(0.0, |n_m| {
            let k = bar.modal_stiffness_n_m();
            k / (k + n_m)
        });
        let straight = bar.straight_shape(self.at.position_m);
        let over_quarter = if bar.is_tapped() {
            1.0
        } else {
            let bending = 1.0 - rocking;
            bending * bending
                + 8.0 * rocking * bending / FIRST_MODE_ROOT.powi(2)
                + 4.0 / 3.0 * rocking * rocking
        };
        BarAtTools {
            shape: (1.0 - rocking) * shape + rocking * straight,
            straight_shape: straight,
            mass_kg: mass_kg * over_quarter,
            frequency_hz,
            damping_ratio: bar.raw().damping_ratio,
        }
    }
}

/// The bar where the tools stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BarAtTools {
    /// Shape of the first mode there.
    pub shape: f64,
    /// z/L.
    pub straight_shape: f64,
    /// Modal mass of the first mode.
    pub mass_kg: f64,
    /// Frequency in the stated plane.
    pub frequency_hz: f64,
    /// Damping ratio.
    pub damping_ratio: f64,
}
