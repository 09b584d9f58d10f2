//! What the tools do to the bar: the law of the force on one tool, in time.

use crate::plant::cut_effects::{AtAngle, Physics};
use crate::plant::cut_terms::CutTerms;
use crate::plant::scenario::ToolCount;

/// Constants of the cut. SI units; per tool, at the width of the cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutSettings {
    /// One tool or two.
    pub tools: ToolCount,
    /// k_j: radial force per chip thickness at the reference chip, N/m.
    pub cutting_n_m: [f64; 2],
    /// h_r, m.
    pub reference_chip_m: f64,
    /// p.
    pub exponent: f64,
    /// Force of the edge, whatever the chip, N.
    pub edge_force_n: f64,
    /// Force per motion of the edge into the work, N/m.
    pub contact_stiffness_n_m: f64,
    /// C_i: radial force per unit slope of the surface, N.
    pub process_damping_n: f64,
    /// Force per unit slope beyond the clearance, N.
    pub flank_force_n: f64,
    /// tan of the clearance angle.
    pub clearance_slope: f64,
    /// b, m.
    pub width_m: f64,
    /// Share of the surface's memory in the chip.
    pub overlap: f64,
    /// Tool 2 stands so far ahead, m.
    pub tool2_ahead_m: f64,
    /// Lag of first order of the force, s.
    pub force_lag_s: f64,
    /// Tangential over radial force.
    pub tangential_ratio: f64,
    /// Diameter that sets the cutting speed, m.
    pub diameter_m: f64,
    /// Feed per turn, m.
    pub feed_m_rev: f64,
    /// Random part of the radial force over the force, standard deviation.
    pub force_noise_ratio: f64,
    /// Effects that follow the angle.
    pub physics: Physics,
}

/// One tool in one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToolNow {
    /// Chip thickness, m.
    pub chip_m: f64,
    /// Motion of the edge into the work, m.
    pub into_m: f64,
    /// Its slope over the surface: speed into the work over surface speed.
    pub slope: f64,
    /// Standard normal number.
    pub noise: f64,
    /// What the angle does.
    pub at_angle: AtAngle,
}

impl CutSettings {
    /// Constants of these coefficients. What varies over a turn is in `physics`, not in its mean.
    #[must_use]
    pub fn of(terms: &CutTerms, physics: Physics, force_noise_ratio: f64) -> Self {
        let first = terms.radial_stiffness_pa * terms.at.width_m * terms.pressure_factor;
        Self {
            tools: terms.tools,
            cutting_n_m: [first, first * terms.ratio],
            reference_chip_m: terms.reference_chip_m,
            exponent: terms.exponent,
            edge_force_n: terms.width_ratio * terms.edge_force_n,
            contact_stiffness_n_m: terms.width_ratio * terms.contact_stiffness_n_m,
            process_damping_n: terms.width_ratio * terms.process_damping_n,
            flank_force_n: terms.width_ratio * terms.flank_force_n,
            clearance_slope: terms.clearance_slope,
            width_m: terms.at.width_m,
            overlap: terms.overlap,
            tool2_ahead_m: terms.tool2_ahead_m,
            force_lag_s: terms.force_lag_s,
            tangential_ratio: terms.tangential_ratio,
            diameter_m: terms.at.diameter_m,
            feed_m_rev: terms.at.feed_m_rev,
            force_noise_ratio,
            physics,
        }
    }

    /// Radial force of one tool: chip, edge, contact, process damping, flank. Zero without contact, never
    /// negative.
    ///
    /// F = (b_j/b) r [k h_r (h/h_r)^p + F_e + k_c u + C_i u'/v + C_f max(0, u'/v - tan gamma)]
    #[must_use]
    pub fn force_n(&self, tool: usize, now: &ToolNow) -> f64 {
        if now.chip_m <= 0.0 {
            return 0.0;
        }
        let relative = if self.reference_chip_m > 0.0 { now.chip_m / self.reference_chip_m } else { 1.0 };
        // A power of one is most cuts, and powf the dearest step of the lathe.
        let bend = if (self.exponent - 1.0).abs() > 0.0 { relative.powf(self.exponent - 1.0) } else { 1.0 };
        let chip = self.cutting_n_m[tool] * now.chip_m * bend * (1.0 + self.force_noise_ratio * now.noise);
        let flank = self.flank_force_n * (now.slope - self.clearance_slope).max(0.0);
        let body = chip
            + self.edge_force_n
            + self.contact_stiffness_n_m * now.into_m
            + self.process_damping_n * now.slope
            + flank;
        let width =
            if self.width_m > 0.0 { (1.0 + now.at_angle.width_m / self.width_m).max(0.0) } else { 1.0 };
        (width * now.at_angle.factor * body).max(0.0)
    }
}
