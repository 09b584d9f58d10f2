//! Two opposed tools that cut one slender bar: the cut's stiffness and damping, and the linear equation
//! with two delays that says whether small vibration grows.
//!
//! Each tool cuts what the other one left half a turn before, on the opposite side: a bar that moves
//! toward tool 1 moves away from tool 2, so the delayed terms carry **plus** signs. A model of tools on
//! one side, or of flexible tools, has minus signs and other stable windows.
//!
//! What it leaves out: loss of contact, the flank that stops growing chatter, and whatever a scenario states
//! beyond the structure; `cut_loop` is the linear equation with all of it.

use super::scenario_error::{Rule, ScenarioError, checked};
use nalgebra::Complex;
use std::f64::consts::PI;

/// What each tool does, before it is checked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawCutting {
    /// K_r: radial force per chip area.
    pub radial_stiffness_pa: f64,
    /// b: width of cut of each tool.
    pub width_m: f64,
    /// Feed per turn of the workpiece.
    pub feed_m_rev: f64,
    /// C_i: radial force per unit slope of the cut surface.
    pub process_damping_n: f64,
    /// False: each tool cuts the nominal chip plus its own movement, no memory of the surface.
    pub regeneration: bool,
    /// gamma: beyond the slope tan(gamma) the flank pushes back.
    pub clearance_rad: f64,
    /// C_f: force per unit slope beyond the clearance, per tool.
    pub flank_force_n: f64,
    /// Tangential over radial force.
    pub tangential_ratio: f64,
    /// F_e: force of the edge, whatever the chip, per tool.
    pub edge_force_n: f64,
    /// p: the force grows with this power of the chip; 1 is in proportion.
    pub exponent: f64,
}

impl Default for RawCutting {
    fn default() -> Self {
        Self {
            radial_stiffness_pa: 2500e6,
            width_m: 0.2e-3,
            feed_m_rev: 0.15e-3,
            process_damping_n: 60.0,
            regeneration: true,
            clearance_rad: 0.122,
            flank_force_n: 3000.0,
            tangential_ratio: 2.0,
            edge_force_n: 0.0,
            exponent: 1.0,
        }
    }
}

/// The cut of each of the two tools.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cutting {
    raw: RawCutting,
}

impl Cutting {
    /// Errors: a value that is negative or not finite, a stiffness of zero.
    pub fn new(raw: RawCutting) -> Result<Self, ScenarioError> {
        checked("radial_stiffness_pa", raw.radial_stiffness_pa, Rule::Positive)?;
        checked("width_m", raw.width_m, Rule::NotNegative)?;
        checked("feed_m_rev", raw.feed_m_rev, Rule::NotNegative)?;
        checked("process_damping_n", raw.process_damping_n, Rule::NotNegative)?;
        checked("clearance_rad", raw.clearance_rad, Rule::Angle)?;
        checked("flank_force_n", raw.flank_force_n, Rule::NotNegative)?;
        checked("tangential_ratio", raw.tangential_ratio, Rule::NotNegative)?;
        checked("edge_force_n", raw.edge_force_n, Rule::NotNegative)?;
        checked("exponent", raw.exponent, Rule::Power)?;
        Ok(Self { raw })
    }

    /// What it was made from.
    #[must_use]
    pub fn raw(&self) -> &RawCutting {
        &self.raw
    }

    /// K = K_r b: radial force of one tool per metre of chip thickness, N/m.
    #[must_use]
    pub fn stiffness_n_m(&self) -> f64 {
        self.raw.radial_stiffness_pa * self.raw.width_m
    }

    /// c_p = C_i / v: damping of one tool at the surface speed `surface_speed_m_s`, N s/m.
    ///
    /// The slope of the wave that the edge runs along is x'/v; the flank pushes back in proportion.
    /// Checked by: `stability::tests::printed_roots`.
    #[must_use]
    pub fn process_damping_n_s_m(&self, surface_speed_m_s: f64) -> f64 {
        self.raw.process_damping_n / surface_speed_m_s
    }
}

/// Coefficients of the linear equation of the bar between two opposed tools, at a frozen tool position.
///
/// m s^2 + c s + k + K (2 + e^{-s tau1} + e^{-s tau2}) = 0
///
/// with c = c_bar + 2 c_p phi^2 and K = K_r b phi^2 (docs/errata.md; the minimal model of two opposed tools).
/// Checked by: `stability::tests::printed_roots`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwoDelay {
    /// m.
    pub mass_kg: f64,
    /// c, structure and process together.
    pub damping_n_s_m: f64,
    /// k.
    pub stiffness_n_m: f64,
    /// K phi^2, of one tool.
    pub cutting_stiffness_n_m: f64,
    /// From tool 1's cut to tool 2's, s.
    pub delay_1_s: f64,
    /// From tool 2's cut to tool 1's, s.
    pub delay_2_s: f64,
}

impl TwoDelay {
    /// K/k: how stiff the cut is over the bar.
    #[must_use]
    pub fn cutting_over_stiffness(&self) -> f64 {
        self.cutting_stiffness_n_m / self.stiffness_n_m
    }

    /// Left side of the equation at `s`, N/m; zero at a root.
    #[must_use]
    pub fn characteristic(&self, s: Complex<f64>) -> Complex<f64> {
        let delayed = (-s * self.delay_1_s).exp() + (-s * self.delay_2_s).exp();
        s * s * self.mass_kg
            + s * self.damping_n_s_m
            + self.stiffness_n_m
            + (delayed + 2.0) * self.cutting_stiffness_n_m
    }

    /// Frequency of the bar while both tools cut and nothing is delayed: sqrt((k + 2 K)/m)/2 pi, Hz.
    ///
    /// Here the phase difference of the two waves must be pi, and chatter starts
    /// near it: it lies 5-25 % above the natural frequency.
    #[must_use]
    pub fn in_cut_frequency_hz(&self) -> f64 {
        ((self.stiffness_n_m + 2.0 * self.cutting_stiffness_n_m) / self.mass_kg).sqrt() / (2.0 * PI)
    }
}

/// tau_i = theta_i/(2 pi) * 60/S with theta_1 = pi - dtheta/2, theta_2 = pi + dtheta/2, in s.
#[must_use]
pub fn delays_s(turn_s: f64, pitch_difference_rad: f64) -> [f64; 2] {
    let per_rad = turn_s / (2.0 * PI);
    [(PI - pitch_difference_rad / 2.0) * per_rad, (PI + pitch_difference_rad / 2.0) * per_rad]
}

/// How many tools cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ToolCount {
    /// Ordinary turning: one delay of a whole turn.
    One,
    /// Two opposed tools.
    #[default]
    Two,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_delays_add_to_one_turn() {
        let [a, b] = delays_s(0.05, 0.1);
        assert!((a + b - 0.05).abs() < 1e-15);
        assert!((b - a - 0.05 * 0.1 / (2.0 * PI)).abs() < 1e-15);
    }
}
