//! One parallel turning cut: bar, cut, spindle, tools (contracts, section 3). The virtual lathe, the
//! stability map and the tests all start from it.

use super::cut_effects::Physics;
pub use super::cutting::ToolCount;
use super::cutting::{Cutting, RawCutting, TwoDelay, delays_s};
use super::effects::EffectKind;
use super::scenario_error::{PhysicsError, Rule, ScenarioError, checked};
use super::workpiece::{RawWorkpiece, Workpiece};
use crate::units::SpindleSpeed;
use std::f64::consts::PI;

/// Where the tools stand and how they move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tools {
    count: ToolCount,
    position_m: f64,
    travel_m_s: f64,
    pitch_difference_rad: f64,
}

impl Tools {
    /// `position_m` from the chuck, `travel_m_s` away from it (0: the position is frozen),
    /// `pitch_difference_rad` = theta_2 - theta_1.
    /// Errors: not finite, a position below zero, a pitch difference of a whole turn or more.
    pub fn new(position_m: f64, travel_m_s: f64, pitch_difference_rad: f64) -> Result<Self, ScenarioError> {
        checked("position_m", position_m, Rule::NotNegative)?;
        checked("travel_m_s", travel_m_s, Rule::Finite)?;
        checked("pitch_difference_rad", pitch_difference_rad, Rule::Finite)?;
        if pitch_difference_rad.abs() >= 2.0 * PI {
            return Err(ScenarioError::NotPhysical {
                name: "pitch_difference_rad",
                value: pitch_difference_rad,
                expected: "less than a turn either way",
            });
        }
        Ok(Self { count: ToolCount::Two, position_m, travel_m_s, pitch_difference_rad })
    }

    /// One tool or two.
    #[must_use]
    pub fn count(&self) -> ToolCount {
        self.count
    }

    /// z, from the chuck, at the start.
    #[must_use]
    pub fn position_m(&self) -> f64 {
        self.position_m
    }

    /// Speed of both tools away from the chuck (negative: toward it).
    #[must_use]
    pub fn travel_m_s(&self) -> f64 {
        self.travel_m_s
    }

    /// theta_2 - theta_1.
    #[must_use]
    pub fn pitch_difference_rad(&self) -> f64 {
        self.pitch_difference_rad
    }
}

/// A parallel turning cut. `Default` is the example of contracts, section 3.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scenario {
    /// Bar.
    pub workpiece: Workpiece,
    /// Cut of each tool.
    pub cutting: Cutting,
    /// Speed of the workpiece.
    pub spindle: SpindleSpeed,
    /// Tools.
    pub tools: Tools,
    /// What the cut has beyond the structure.
    pub physics: Physics,
}

/// A scenario before it is checked: plain numbers, every one with a default.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawScenario {
    /// Bar.
    pub workpiece: RawWorkpiece,
    /// Cut of each tool.
    pub cutting: RawCutting,
    /// S.
    pub speed_rpm: f64,
    /// One tool or two.
    pub tool_count: ToolCount,
    /// Tools from the chuck; `None`: at the free end.
    pub position_m: Option<f64>,
    /// Speed of the tools away from the chuck.
    pub travel_m_s: f64,
    /// theta_2 - theta_1.
    pub pitch_difference_rad: f64,
    /// What the cut has beyond the structure.
    pub physics: Physics,
}

impl Default for RawScenario {
    fn default() -> Self {
        Self {
            workpiece: RawWorkpiece::default(),
            cutting: RawCutting::default(),
            speed_rpm: 1200.0,
            tool_count: ToolCount::Two,
            position_m: None,
            travel_m_s: 0.0,
            pitch_difference_rad: 0.0,
            physics: Physics::default(),
        }
    }
}

impl Scenario {
    /// Errors: the first value that is not physical, by name. A tool position beyond the free end is one; so
    /// is an effect of what the structure states already.
    pub fn new(raw: &RawScenario) -> Result<Self, ScenarioError> {
        let workpiece = Workpiece::new(raw.workpiece)?;
        let length_m = workpiece.projection_length_m();
        let position_m = raw.position_m.unwrap_or(length_m);
        if position_m > length_m * (1.0 + 1e-9) && !workpiece.is_tapped() {
            return Err(ScenarioError::NotPhysical {
                name: "position_m",
                value: position_m,
                expected: "at most the projection length",
            });
        }
        let spindle = SpindleSpeed::from_rpm(raw.speed_rpm).map_err(|_| ScenarioError::NotPhysical {
            name: "speed_rpm",
            value: raw.speed_rpm,
            expected: "a finite number above zero",
        })?;
        let mut tools = Tools::new(position_m, raw.travel_m_s, raw.pitch_difference_rad)?;
        tools.count = raw.tool_count;
        let cutting = Cutting::new(raw.cutting)?;
        not_stated(&raw.cutting, &raw.physics)?;
        Ok(Self { workpiece, cutting, spindle, tools, physics: raw.physics })
    }

    /// The plain numbers; `Scenario::new` makes the same scenario of them.
    #[must_use]
    pub fn raw(&self) -> RawScenario {
        RawScenario {
            workpiece: *self.workpiece.raw(),
            cutting: *self.cutting.raw(),
            speed_rpm: self.spindle.rpm(),
            tool_count: self.tools.count,
            position_m: Some(self.tools.position_m),
            travel_m_s: self.tools.travel_m_s,
            pitch_difference_rad: self.tools.pitch_difference_rad,
            physics: self.physics,
        }
    }
}

/// Effects of which the structure has its own number are there only where that number says nothing.
fn not_stated(cutting: &RawCutting, physics: &Physics) -> Result<(), PhysicsError> {
    let regenerates = cutting.regeneration.then_some("regeneration = false");
    let damps = (cutting.process_damping_n > 0.0).then_some("process_damping_n = 0");
    let bends = ((cutting.exponent - 1.0).abs() > 0.0).then_some("exponent = 1");
    let stated = [
        (EffectKind::RegenerativeEffect, regenerates),
        (EffectKind::ProcessDamping, damps),
        (EffectKind::NonlinearCuttingForce, bends),
    ];
    for (effect, expected) in stated {
        if let (Some(expected), Some(_)) = (expected, physics.get(effect)) {
            return Err(PhysicsError::Stated { effect, expected });
        }
    }
    Ok(())
}

impl Default for Scenario {
    fn default() -> Self {
        match Self::new(&RawScenario::default()) {
            Ok(scenario) => scenario,
            Err(error) => unreachable!("the defaults are physical: {error}"),
        }
    }
}

impl TwoDelay {
    /// The equation of a scenario as it stands.
    #[must_use]
    pub fn from_scenario(scenario: &Scenario) -> Self {
        let bar = &scenario.workpiece;
        let phi2 = bar.mode_shape(scenario.tools.position_m()).powi(2);
        let turn_s = scenario.spindle.period_s();
        let surface_speed_m_s = PI * bar.diameter_m() / turn_s;
        let process = scenario.cutting.process_damping_n_s_m(surface_speed_m_s);
        let [delay_1_s, delay_2_s] = delays_s(turn_s, scenario.tools.pitch_difference_rad());
        Self {
            mass_kg: bar.modal_mass_kg(),
            damping_n_s_m: bar.modal_damping_n_s_m() + 2.0 * process * phi2,
            stiffness_n_m: bar.modal_stiffness_n_m(),
            cutting_stiffness_n_m: scenario.cutting.stiffness_n_m() * phi2,
            delay_1_s,
            delay_2_s,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raw_and_back_is_the_same_scenario() {
        let scenario = Scenario::default();
        assert_eq!(Scenario::new(&scenario.raw()).unwrap(), scenario);
        assert!((scenario.tools.position_m() - 0.180).abs() < 1e-15);
    }

    #[test]
    fn tools_beyond_the_bar_are_refused() {
        let raw = RawScenario { position_m: Some(0.2), ..RawScenario::default() };
        assert!(Scenario::new(&raw).unwrap_err().to_string().starts_with("position_m = 0.2 is not physical"));
    }

    #[test]
    fn the_reference_cut() {
        let equation = TwoDelay::from_scenario(&Scenario::default());
        assert!((equation.cutting_stiffness_n_m - 500e3).abs() < 1e-6);
        assert!((equation.in_cut_frequency_hz() - 646.0).abs() < 1.0);
    }
}
