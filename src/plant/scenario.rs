//! One parallel turning cut: bar, cut, spindle, tools (contracts, section 3). The virtual lathe, the
//! stability map and the tests all start from it.

use super::cutting::{Cutting, RawCutting};
use super::workpiece::{RawWorkpiece, Rule, ScenarioError, Workpiece, checked};
use crate::units::SpindleSpeed;
use std::f64::consts::PI;

/// Where the tools stand and how they move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tools {
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
        Ok(Self { position_m, travel_m_s, pitch_difference_rad })
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
    /// Tools from the chuck; `None`: at the free end.
    pub position_m: Option<f64>,
    /// Speed of the tools away from the chuck.
    pub travel_m_s: f64,
    /// theta_2 - theta_1.
    pub pitch_difference_rad: f64,
}

impl Default for RawScenario {
    fn default() -> Self {
        Self {
            workpiece: RawWorkpiece::default(),
            cutting: RawCutting::default(),
            speed_rpm: 1200.0,
            position_m: None,
            travel_m_s: 0.0,
            pitch_difference_rad: 0.0,
        }
    }
}

impl Scenario {
    /// Errors: the first value that is not physical, by name. A tool position beyond the free end is one.
    pub fn new(raw: &RawScenario) -> Result<Self, ScenarioError> {
        let workpiece = Workpiece::new(raw.workpiece)?;
        let length_m = workpiece.projection_length_m();
        let position_m = raw.position_m.unwrap_or(length_m);
        if position_m > length_m * (1.0 + 1e-9) {
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
        let tools = Tools::new(position_m, raw.travel_m_s, raw.pitch_difference_rad)?;
        Ok(Self { workpiece, cutting: Cutting::new(raw.cutting)?, spindle, tools })
    }

    /// The plain numbers; `Scenario::new` makes the same scenario of them.
    #[must_use]
    pub fn raw(&self) -> RawScenario {
        RawScenario {
            workpiece: *self.workpiece.raw(),
            cutting: *self.cutting.raw(),
            speed_rpm: self.spindle.rpm(),
            position_m: Some(self.tools.position_m),
            travel_m_s: self.tools.travel_m_s,
            pitch_difference_rad: self.tools.pitch_difference_rad,
        }
    }
}

impl Default for Scenario {
    fn default() -> Self {
        match Self::new(&RawScenario::default()) {
            Ok(scenario) => scenario,
            Err(error) => unreachable!("the defaults are physical: {error}"),
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
}
