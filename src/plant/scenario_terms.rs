//! A scenario as the coefficients of a cut: its own condition, what its numbers are referred to, what the
//! structure and the effects add under any condition.

use super::cut_effects::Place;
use super::cut_terms::{ChipMemory, CutCondition, CutReferences, CutTerms};
use super::scenario::{Scenario, ToolCount};

impl CutCondition {
    /// The scenario's own, at the start.
    #[must_use]
    pub fn of(scenario: &Scenario) -> Self {
        let cutting = scenario.cutting.raw();
        Self {
            speed_rpm: scenario.spindle.rpm(),
            feed_m_rev: cutting.feed_m_rev,
            width_m: cutting.width_m,
            position_m: scenario.tools.position_m(),
            pitch_difference_rad: scenario.tools.pitch_difference_rad(),
            diameter_m: scenario.workpiece.diameter_m(),
            time_s: 0.0,
            edge_age_s: 0.0,
        }
    }
}

impl CutReferences {
    /// Those of a scenario.
    #[must_use]
    pub fn of(scenario: &Scenario) -> Self {
        let own = CutCondition::of(scenario);
        let per_turn = if scenario.tools.count() == ToolCount::Two { 2.0 } else { 1.0 };
        Self {
            speed_rpm: own.speed_rpm,
            surface_speed_m_s: own.surface_speed_m_s(),
            width_m: own.width_m,
            chip_m: own.feed_m_rev / 2.0,
            position_m: own.position_m,
            cutting_stiffness_n_m: scenario.cutting.stiffness_n_m(),
            mean_delay_s: own.turn_s() / per_turn,
        }
    }
}

impl CutTerms {
    /// A scenario at a condition.
    #[must_use]
    pub fn of(scenario: &Scenario, at: &CutCondition) -> Self {
        let cutting = scenario.cutting.raw();
        let reference = CutReferences::of(scenario);
        let width_ratio = if reference.width_m > 0.0 {
            at.width_m / reference.width_m
        } else if at.width_m > 0.0 {
            1.0
        } else {
            0.0
        };
        let mut terms = Self {
            at: *at,
            tools: scenario.tools.count(),
            width_ratio,
            reference_chip_m: reference.chip_m,
            radial_stiffness_pa: cutting.radial_stiffness_pa,
            pressure_factor: 1.0,
            exponent: cutting.exponent,
            ratio: 1.0,
            edge_force_n: cutting.edge_force_n,
            process_damping_n: cutting.process_damping_n,
            flank_force_n: cutting.flank_force_n,
            clearance_slope: cutting.clearance_rad.tan(),
            contact_stiffness_n_m: 0.0,
            tangential_ratio: cutting.tangential_ratio,
            overlap: if cutting.regeneration { 1.0 } else { 0.0 },
            tool2_ahead_m: 0.0,
            stock_factor: 1.0,
            force_lag_s: 0.0,
            memory: ChipMemory::NONE,
            workpiece: scenario.workpiece,
            frequency_shift_hz: 0.0,
            support_stiffness_n_m: None,
            second_plane: None,
            second_mode: None,
            turret: None,
        };
        scenario.physics.enter(&Place { at: *at, reference }, &mut terms);
        terms
    }
}

#[cfg(test)]
mod tests {
    use super::super::cut_effects::{CutEffect, Physics, SupportCompliance};
    use super::super::scenario::RawScenario;
    use super::*;

    #[test]
    fn a_rocking_bar_has_the_mass_of_its_shape() {
        let stiff = Scenario::default().workpiece.modal_stiffness_n_m();
        let support = CutEffect::SupportCompliance(SupportCompliance { n_m: 3.0 * stiff });
        let physics = Physics::new(&[support]).unwrap();
        let scenario = Scenario::new(&RawScenario { physics, ..RawScenario::default() }).unwrap();
        let length_m = 0.180;
        let at = |position_m| {
            let condition = CutCondition { position_m, ..CutCondition::of(&scenario) };
            CutTerms::of(&scenario, &condition).bar_at_tools()
        };
        let mean: f64 = (0..2000).map(|i| at(length_m * (f64::from(i) + 0.5) / 2000.0).shape.powi(2)).sum();
        let whole_kg = 4.0 * scenario.workpiece.modal_mass_kg();
        assert!((at(length_m).mass_kg - whole_kg * mean / 2000.0).abs() < 1e-6 * whole_kg);
        assert!((at(length_m).shape - 1.0).abs() < 1e-12);
        // A quarter of the tip's motion is rocking: z/L where the bar bends by 0.3395.
        assert!((at(0.09).shape - (0.75 * 0.3395 + 0.25 * 0.5)).abs() < 1e-4);
    }
}
