//! What can be hidden in a cut, and how much of it is plain.

use super::CutCaseError;
use super::machine::{Mode, TrueCut};
use crate::plant::effects::Port;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Effects of the vocabulary, the kinds of runout by name.
pub const CUT_EFFECTS: [&str; 23] = [
    "regenerative_effect",
    "process_damping",
    "edge_force",
    "nonlinear_cutting_force",
    "nose_radius",
    "speed_dependent_force",
    "runout/eccentricity",
    "runout/ovality",
    "runout/offset",
    "second_mode",
    "second_plane",
    "mode_drift",
    "position_dependent_mode",
    "support_compliance",
    "contact_stiffness",
    "speed_dependent_dynamics",
    "tool_wear",
    "tool_difference",
    "turret_compliance",
    "spindle_speed_variation",
    "stock_variation",
    "force_lag",
    "force_sensor_lag",
];

/// What is no effect of the vocabulary: outsiders, and numbers wrong beyond what the contract allows.
pub const CUT_OUTSIDE: [&str; 9] = [
    "unknown/chip_tangle",
    "unknown/tone",
    "unknown/wandering_mode",
    "unknown/wandering_pressure",
    "unknown/chip_memory",
    "unknown/stiffening_bar",
    "unknown/unround_bar",
    "parameter/radial_stiffness_pa",
    "parameter/damping_ratio",
];

/// One thing that the scenario does not say.
#[derive(Debug, Clone, PartialEq)]
pub struct HiddenCut {
    /// Effect, after a slash its kind.
    pub name: String,
    /// Where it enters.
    pub port: Port,
    /// 1 is plain.
    pub depth: f64,
    /// Its parameters as the contract names them; the key one first.
    pub parameters: Vec<(&'static str, f64)>,
}

/// What the scenario will say although it is not so.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Unsaid {
    pub(super) regeneration: bool,
    pub(super) damping: bool,
    pub(super) pressure_factor: f64,
    pub(super) damping_factor: f64,
}

/// Hides one thing in a machine. Errors: a name that nothing can be hidden by.
pub(super) fn hide(
    name: &str,
    depth: f64,
    (cut, unsaid): (&mut TrueCut, &mut Unsaid),
    random: &mut ChaCha8Rng,
) -> Result<HiddenCut, CutCaseError> {
    let mut hiding = Hiding { name, depth, cut, unsaid, random };
    let found = hiding
        .in_the_chip()
        .or_else(|| hiding.at_an_angle())
        .or_else(|| hiding.in_the_bar())
        .or_else(|| hiding.elsewhere())
        .or_else(|| hiding.outside());
    match found {
        Some((port, parameters)) => Ok(HiddenCut { name: name.to_owned(), port, depth, parameters }),
        None => Err(CutCaseError::UnknownEffect { name: name.to_owned() }),
    }
}

/// Port and parameters of what was hidden.
type Done = Option<(Port, Vec<(&'static str, f64)>)>;

/// One thing that is being hidden.
struct Hiding<'a> {
    name: &'a str,
    depth: f64,
    cut: &'a mut TrueCut,
    unsaid: &'a mut Unsaid,
    random: &'a mut ChaCha8Rng,
}

impl Hiding<'_> {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.random.random_range(low..high)
    }

    /// A size at this depth.
    fn deep(&mut self, low: f64, high: f64) -> f64 {
        self.depth * self.between(low, high)
    }

    /// The same of either sign.
    fn either(&mut self, low: f64, high: f64) -> f64 {
        let sign = if self.between(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
        sign * self.deep(low, high)
    }

    /// Laws of chip and flank.
    fn in_the_chip(&mut self) -> Done {
        let cutting = self.cut.pressure_pa * self.cut.width_m;
        let (key, value) = match self.name {
            "regenerative_effect" => {
                (self.cut.memory, self.unsaid.regeneration) = (self.depth.min(1.0), true);
                ("overlap", self.cut.memory)
            }
            "process_damping" => {
                (self.cut.flank_damping_n, self.unsaid.damping) = (self.deep(30.0, 60.0), true);
                ("process_damping_n", self.cut.flank_damping_n)
            }
            "edge_force" => {
                self.cut.hidden.edge_force_n = self.deep(0.15, 0.3) * cutting * self.cut.feed_m_rev / 2.0;
                ("force_n", self.cut.hidden.edge_force_n)
            }
            "nonlinear_cutting_force" => {
                self.cut.hidden.exponent = 1.0 - self.deep(0.25, 0.4);
                ("exponent", self.cut.hidden.exponent)
            }
            "nose_radius" => {
                let radius_m = self.between(0.3e-3, 0.8e-3) / self.depth;
                self.cut.hidden.nose_radius_m = Some(radius_m);
                ("radius_m", radius_m)
            }
            "speed_dependent_force" => {
                self.cut.hidden.speed_exponent = self.deep(0.15, 0.3);
                ("exponent", self.cut.hidden.speed_exponent)
            }
            "contact_stiffness" => {
                self.cut.hidden.contact_n_m = self.deep(0.15, 0.4) * cutting;
                ("n_m", self.cut.hidden.contact_n_m)
            }
            "tool_wear" => {
                self.cut.hidden.wear_1_s = self.deep(0.01, 0.02);
                ("relative_per_s", self.cut.hidden.wear_1_s)
            }
            "tool_difference" => {
                self.cut.hidden.tool2_ratio = 1.0 + self.either(0.1, 0.2);
                ("ratio", self.cut.hidden.tool2_ratio)
            }
            "force_lag" => {
                self.cut.hidden.force_lag_s = self.deep(30e-6, 70e-6);
                ("time_constant_s", self.cut.hidden.force_lag_s)
            }
            _ => return None,
        };
        Some((Port::Process, vec![(key, value)]))
    }

    /// What follows the angle of work or spindle.
    fn at_an_angle(&mut self) -> Done {
        let around = self.between(0.0, 6.2);
        let (port, names, numbers) = match self.name {
            "runout/eccentricity" | "runout/ovality" => {
                let order = if self.name.ends_with("ovality") { 2.0 } else { 1.0 };
                let h = (self.deep(5e-6, 14e-6), order, around);
                let hidden = &mut self.cut.hidden;
                (hidden.runout_m, hidden.runout_order, hidden.runout_phase_rad) = h;
                (Port::Process, ["amplitude_m", "order", "phase_rad"], [h.0, h.1, h.2])
            }
            "runout/offset" => {
                let ahead_m = self.either(5e-6, 12e-6);
                (self.cut.hidden.runout_m, self.cut.hidden.runout_order) = (ahead_m, 0.0);
                (Port::Process, ["amplitude_m", "order", "phase_rad"], [ahead_m, 0.0, 0.0])
            }
            "spindle_speed_variation" => {
                let order = if around < 3.1 { 1.0 } else { 2.0 };
                let h = (self.deep(0.01, 0.02), order, self.between(0.0, 6.2));
                let hidden = &mut self.cut.hidden;
                (hidden.speed_ripple, hidden.ripple_order, hidden.ripple_phase_rad) = h;
                (Port::Spindle, ["relative", "order", "phase_rad"], [h.0, h.1, h.2])
            }
            "stock_variation" => {
                let h = (self.either(0.2, 0.4), self.between(0.6, 1.8), around);
                let hidden = &mut self.cut.hidden;
                (hidden.sector_change, hidden.sector_rad, hidden.sector_centre_rad) = h;
                (Port::Process, ["relative_change", "sector_rad", "centre_rad"], [h.0, h.1, h.2])
            }
            _ => return None,
        };
        Some((port, names.into_iter().zip(numbers).collect()))
    }

    /// What the bar and its support do.
    fn in_the_bar(&mut self) -> Done {
        let [stiffness, hz] = self.cut.stiffness_and_hz();
        let parameters = match self.name {
            "second_mode" => {
                let mode = self.mode(hz * 1.3, hz * 2.2, stiffness);
                self.cut.hidden.second_mode = Some(mode);
                of_mode(mode)
            }
            "second_plane" => {
                let other_hz = hz * (1.0 + self.either(0.025, 0.05));
                let orientation_rad = self.between(0.2, 0.6);
                (self.cut.hidden.plane_hz, self.cut.hidden.orientation_rad) =
                    (Some(other_hz), orientation_rad);
                vec![("frequency_hz", other_hz), ("orientation_rad", orientation_rad)]
            }
            "mode_drift" => {
                self.cut.hidden.hz_per_s = self.either(1.2, 2.5);
                vec![("hz_per_s", self.cut.hidden.hz_per_s)]
            }
            "position_dependent_mode" => {
                self.cut.hidden.hz_per_m = self.either(150.0, 350.0);
                vec![("hz_per_m", self.cut.hidden.hz_per_m)]
            }
            "support_compliance" => {
                let n_m = stiffness * self.between(2.0, 4.0) / self.depth;
                self.cut.hidden.support_n_m = Some(n_m);
                vec![("n_m", n_m)]
            }
            "speed_dependent_dynamics" => {
                self.cut.hidden.hz_per_rpm = self.either(0.02, 0.05);
                vec![("hz_per_rpm", self.cut.hidden.hz_per_rpm)]
            }
            _ => return None,
        };
        Some((Port::Workpiece, parameters))
    }

    fn mode(&mut self, low_hz: f64, high_hz: f64, stiffness_n_m: f64) -> Mode {
        Mode {
            frequency_hz: self.between(low_hz, high_hz),
            damping_ratio: self.between(0.015, 0.045),
            n_m: stiffness_n_m * self.between(1.5, 4.0) / self.depth,
        }
    }

    /// Holder of tool 2 and force signal.
    fn elsewhere(&mut self) -> Done {
        match self.name {
            "turret_compliance" => {
                let [stiffness, hz] = self.cut.stiffness_and_hz();
                let mode = self.mode(hz * 0.85, hz * 1.4, stiffness);
                self.cut.hidden.turret = Some(mode);
                Some((Port::Turret, of_mode(mode)))
            }
            "force_sensor_lag" => {
                let extra_delay_s = self.deep(1.2e-4, 3e-4);
                let bandwidth_hz = super::STATED_BANDWIDTH_HZ * (1.0 - 0.3 * self.depth.min(1.0));
                self.cut.hidden.signal_delay_s = extra_delay_s;
                self.cut.hidden.signal_bandwidth_hz = Some(bandwidth_hz);
                Some((
                    Port::ForceSensor,
                    vec![("extra_delay_s", extra_delay_s), ("bandwidth_hz", bandwidth_hz)],
                ))
            }
            _ => None,
        }
    }

    /// What the vocabulary does not have, and numbers that are wrong.
    fn outside(&mut self) -> Done {
        match self.name {
            "unknown/chip_tangle" => {
                self.cut.hidden.tangle_n = self.deep(5.0, 10.0);
                Some((Port::Workpiece, vec![("force_n", self.cut.hidden.tangle_n)]))
            }
            "unknown/tone" => {
                let (tone_n, tone_hz) = (self.deep(1.5, 3.0), self.between(130.0, 300.0));
                (self.cut.hidden.tone_n, self.cut.hidden.tone_hz) = (tone_n, tone_hz);
                Some((Port::Workpiece, vec![("force_n", tone_n), ("frequency_hz", tone_hz)]))
            }
            "unknown/wandering_mode" => {
                let (share, within_s) = (self.deep(0.006, 0.01), self.between(0.1, 0.4));
                (self.cut.hidden.wandering, self.cut.hidden.wandering_s) = (share, within_s);
                Some((Port::Workpiece, vec![("relative", share), ("time_constant_s", within_s)]))
            }
            "unknown/wandering_pressure" => {
                let (share, within_s) = (self.deep(0.04, 0.08), self.between(0.1, 1.0));
                (self.cut.hidden.wandering_pressure, self.cut.hidden.wandering_s) = (share, within_s);
                Some((Port::Process, vec![("relative", share), ("time_constant_s", within_s)]))
            }
            "unknown/chip_memory" => {
                // Chips of a millimetre or so at some metres a second.
                let sign = if self.between(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
                let (overshoot, within_s) = (sign * self.deep(0.15, 0.3), self.between(1e-4, 6e-4));
                (self.cut.hidden.overshoot, self.cut.hidden.fading_s) = (overshoot, within_s);
                Some((Port::Process, vec![("relative", overshoot), ("time_constant_s", within_s)]))
            }
            "unknown/stiffening_bar" => {
                // A tenth at some 20 um.
                self.cut.hidden.stiffening_1_m2 = self.deep(1.5e8, 4e8);
                Some((Port::Workpiece, vec![("relative_1_m2", self.cut.hidden.stiffening_1_m2)]))
            }
            "unknown/unround_bar" => {
                self.cut.hidden.unround = self.deep(0.02, 0.05);
                Some((Port::Workpiece, vec![("relative", self.cut.hidden.unround)]))
            }
            "parameter/radial_stiffness_pa" => {
                self.unsaid.pressure_factor = 1.0 + self.either(0.25, 0.4);
                Some((Port::Process, vec![("radial_stiffness_pa", self.cut.pressure_pa)]))
            }
            "parameter/damping_ratio" => {
                let sign = if self.between(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
                self.unsaid.damping_factor = (1.0 + self.deep(0.5, 0.9)).powf(sign);
                Some((Port::Workpiece, vec![("damping_ratio", self.cut.damping_ratio)]))
            }
            _ => None,
        }
    }
}

fn of_mode(mode: Mode) -> Vec<(&'static str, f64)> {
    vec![("frequency_hz", mode.frequency_hz), ("damping_ratio", mode.damping_ratio), ("n_m", mode.n_m)]
}
