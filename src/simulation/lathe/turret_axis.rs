//! One axis of a turret: motor and stage on a ball screw's spring, under closed-loop control.
//!
//! Between command and sample: position loop on the scale (on the motor encoder where there is no
//! scale), velocity loop on the motor encoder, dead time and lag of the current loop, motor and stage
//! with friction, delays and steps of both encoders.

use std::f64::consts::TAU;

/// Steps of integration per control period.
const SUBSTEPS: usize = 4;
/// Longest delay that a line holds, in substeps.
const LINE: usize = 64;

/// What the axis is made of. SI units.
#[derive(Debug, Clone, Copy, PartialEq)]
#[expect(missing_docs, reason = "each field is its own unit-carrying name; meaning in docs/symbols.md")]
pub struct AxisSettings {
    pub screw_lead_m: f64,
    pub rotary_inertia_kg_m2: f64,
    pub rotary_damping_nm_s_rad: f64,
    pub motor_coulomb_friction_n: f64,
    pub movable_mass_kg: f64,
    pub translational_damping_n_s_m: f64,
    pub stage_coulomb_friction_n: f64,
    pub axial_stiffness_n_m: f64,
    pub structural_damping_n_s_m: f64,
    pub torque_constant_nm_a: f64,
    pub current_loop_bandwidth_rad_s: f64,
    pub amplifier_dead_time_s: f64,
    pub motor_encoder_delay_s: f64,
    pub stage_encoder_delay_s: f64,
    pub motor_encoder_counts_per_rev: f64,
    /// Step of the scale; `None`: no scale on this axis.
    pub stage_encoder_step_m: Option<f64>,
    /// Noise of the scale's interpolation before it is rounded, standard deviation.
    pub stage_encoder_noise_m: f64,
    pub position_gain_1_s: f64,
    pub velocity_gain_1_s: f64,
    pub velocity_integral_1_s: f64,
    pub velocity_filter_rad_s: f64,
}

impl AxisSettings {
    /// X axis of a turret: rolling guideway, lead 8 mm, 120000 counts a turn (thesis, table 6-1).
    #[must_use]
    pub fn rolling(has_scale: bool) -> Self {
        Self {
            screw_lead_m: 8.0e-3,
            rotary_inertia_kg_m2: 2.3e-3,
            rotary_damping_nm_s_rad: 4.0e-3,
            motor_coulomb_friction_n: 60.0,
            movable_mass_kg: 150.0,
            translational_damping_n_s_m: 900.0,
            stage_coulomb_friction_n: 80.0,
            axial_stiffness_n_m: 1.3e8,
            structural_damping_n_s_m: 9.0e3,
            torque_constant_nm_a: 1.2,
            current_loop_bandwidth_rad_s: 5000.0,
            amplifier_dead_time_s: 2.0e-4,
            motor_encoder_delay_s: 1.0e-4,
            stage_encoder_delay_s: 1.0e-4,
            motor_encoder_counts_per_rev: 120_000.0,
            stage_encoder_step_m: has_scale.then_some(1.0e-9),
            stage_encoder_noise_m: 0.5e-9,
            position_gain_1_s: 40.0,
            velocity_gain_1_s: 120.0,
            velocity_integral_1_s: 10.0,
            velocity_filter_rad_s: 1200.0,
        }
    }

    /// Y axis of a turret: sliding guideway, lead 6 mm, 160000 counts a turn (thesis, table 6-1).
    #[must_use]
    pub fn sliding(has_scale: bool) -> Self {
        Self {
            screw_lead_m: 6.0e-3,
            rotary_inertia_kg_m2: 1.4e-3,
            motor_encoder_counts_per_rev: 160_000.0,
            translational_damping_n_s_m: 6000.0,
            stage_coulomb_friction_n: 200.0,
            ..Self::rolling(has_scale)
        }
    }

    fn travel_m_rad(&self) -> f64 {
        self.screw_lead_m / TAU
    }

    fn reflected_mass_kg(&self) -> f64 {
        self.rotary_inertia_kg_m2 / self.travel_m_rad().powi(2)
    }
}

/// Motor travel, motor speed, stage position, stage speed, thrust.
type Motion = [f64; 5];

/// Hysteresis of a rotary encoder's counter, in counts to either side: without one an axis that stops on the
/// edge of a count hunts over it for good, which no drive would be shipped with.
const COUNT_HYSTERESIS: f64 = 0.5;
/// Speed over which Coulomb friction turns its sign, m/s.
const FRICTION_SPEED_M_S: f64 = 2.0e-4;

/// One axis in motion.
#[derive(Debug, Clone, PartialEq)]
pub struct TurretAxis {
    settings: AxisSettings,
    control_period_s: f64,
    motion: Motion,
    current_ref_a: f64,
    velocity_integral_m: f64,
    filtered_velocity_m_s: f64,
    last_motor_m: f64,
    motor_count: f64,
    current_line: DelayLine,
    motor_line: DelayLine,
    stage_line: DelayLine,
}

/// Delay in fractions of a substep.
#[derive(Debug, Clone, PartialEq)]
struct DelayLine {
    values: [f64; LINE],
    newest: usize,
    delay: f64,
}

impl DelayLine {
    fn new(delay_s: f64, step_s: f64) -> Self {
        Self { values: [0.0; LINE], newest: 0, delay: (delay_s / step_s).clamp(0.0, (LINE - 2) as f64) }
    }

    fn push(&mut self, value: f64) -> f64 {
        self.newest = (self.newest + 1) % LINE;
        self.values[self.newest] = value;
        let whole = self.delay.floor();
        let share = self.delay - whole;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 <= whole < LINE")]
        let whole = whole as usize;
        let at = |ago: usize| self.values[(self.newest + LINE - ago) % LINE];
        at(whole) * (1.0 - share) + at(whole + 1) * share
    }
}

/// What the axis reports at a control instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisReport {
    /// Current reference that the loop computed, A.
    pub current_ref_a: f64,
    /// Motor encoder, rad.
    pub motor_angle_rad: f64,
    /// Scale, m.
    pub stage_position_m: Option<f64>,
}

impl TurretAxis {
    /// An axis at rest at zero, sampled and controlled at `rate_hz`.
    #[must_use]
    pub fn new(settings: AxisSettings, rate_hz: f64) -> Self {
        let step_s = 1.0 / (rate_hz * SUBSTEPS as f64);
        Self {
            settings,
            control_period_s: 1.0 / rate_hz,
            motion: [0.0; 5],
            current_ref_a: 0.0,
            velocity_integral_m: 0.0,
            filtered_velocity_m_s: 0.0,
            last_motor_m: 0.0,
            motor_count: 0.0,
            current_line: DelayLine::new(settings.amplifier_dead_time_s, step_s),
            motor_line: DelayLine::new(settings.motor_encoder_delay_s, step_s),
            stage_line: DelayLine::new(settings.stage_encoder_delay_s, step_s),
        }
    }

    /// True position of the stage, m.
    #[must_use]
    pub fn stage_position_m(&self) -> f64 {
        self.motion[2]
    }

    /// One control period: moves under `force_n` (positive opposes +travel), samples, controls.
    /// `noise` is one standard normal number.
    pub fn step(&mut self, position_cmd_m: f64, force_n: f64, noise: f64) -> AxisReport {
        let step_s = self.control_period_s / SUBSTEPS as f64;
        let (mut motor, mut stage) = (0.0, 0.0);
        for _ in 0..SUBSTEPS {
            let current = self.current_line.push(self.current_ref_a);
            self.integrate(step_s, current, force_n);
            motor = self.motor_line.push(self.motion[0]);
            stage = self.stage_line.push(self.motion[2]);
        }
        let s = &self.settings;
        let motor_step_m = s.screw_lead_m / s.motor_encoder_counts_per_rev;
        let counts = motor / motor_step_m;
        self.motor_count =
            self.motor_count.clamp((counts - COUNT_HYSTERESIS).floor(), (counts + COUNT_HYSTERESIS).floor());
        let motor_m = self.motor_count * motor_step_m;
        let stage = stage + s.stage_encoder_noise_m * noise;
        let stage_m = s.stage_encoder_step_m.map(|step| (stage / step).floor() * step);
        self.control(position_cmd_m, motor_m, stage_m);
        AxisReport {
            current_ref_a: self.current_ref_a,
            motor_angle_rad: motor_m / self.settings.travel_m_rad(),
            stage_position_m: stage_m,
        }
    }

    /// P position, PI velocity with a first-order filter on the measured velocity.
    fn control(&mut self, position_cmd_m: f64, motor_m: f64, stage_m: Option<f64>) {
        let s = &self.settings;
        let dt = self.control_period_s;
        let raw_velocity = (motor_m - self.last_motor_m) / dt;
        self.last_motor_m = motor_m;
        let share = 1.0 - (-s.velocity_filter_rad_s * dt).exp();
        self.filtered_velocity_m_s += share * (raw_velocity - self.filtered_velocity_m_s);
        let velocity_cmd = s.position_gain_1_s * (position_cmd_m - stage_m.unwrap_or(motor_m));
        let error = velocity_cmd - self.filtered_velocity_m_s;
        self.velocity_integral_m = (self.velocity_integral_m + error * dt).clamp(-1.0e-3, 1.0e-3);
        let accel = s.velocity_gain_1_s * (error + s.velocity_integral_1_s * self.velocity_integral_m);
        let mass = s.reflected_mass_kg() + s.movable_mass_kg;
        self.current_ref_a = mass * accel * s.travel_m_rad() / s.torque_constant_nm_a;
    }

    fn rates(&self, y: &Motion, current_a: f64, force_n: f64) -> Motion {
        let s = &self.settings;
        let [motor, motor_v, stage, stage_v, thrust] = *y;
        let r = s.travel_m_rad();
        let screw =
            s.axial_stiffness_n_m * (motor - stage) + s.structural_damping_n_s_m * (motor_v - stage_v);
        let motor_friction =
            s.rotary_damping_nm_s_rad / (r * r) * motor_v + s.motor_coulomb_friction_n * direction(motor_v);
        let stage_friction =
            s.translational_damping_n_s_m * stage_v + s.stage_coulomb_friction_n * direction(stage_v);
        [
            motor_v,
            (thrust - screw - motor_friction) / s.reflected_mass_kg(),
            stage_v,
            (screw - stage_friction - force_n) / s.movable_mass_kg,
            s.current_loop_bandwidth_rad_s * (s.torque_constant_nm_a / r * current_a - thrust),
        ]
    }

    /// One Runge-Kutta step of fourth order, current and force held.
    fn integrate(&mut self, step_s: f64, current_a: f64, force_n: f64) {
        let y = self.motion;
        let along = |k: &Motion, h: f64| -> Motion { std::array::from_fn(|i| y[i] + h * k[i]) };
        let k1 = self.rates(&y, current_a, force_n);
        let k2 = self.rates(&along(&k1, step_s / 2.0), current_a, force_n);
        let k3 = self.rates(&along(&k2, step_s / 2.0), current_a, force_n);
        let k4 = self.rates(&along(&k3, step_s), current_a, force_n);
        self.motion = std::array::from_fn(|i| y[i] + step_s / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]));
    }
}

/// Sign of a speed, smooth through zero: v / sqrt(v^2 + v_s^2).
fn direction(velocity_m_s: f64) -> f64 {
    let ratio = velocity_m_s / FRICTION_SPEED_M_S;
    ratio / (1.0 + ratio * ratio).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE_HZ: f64 = 9000.0;

    #[test]
    fn an_axis_holds_its_place_against_a_steady_force() {
        let mut axis = TurretAxis::new(AxisSettings::rolling(true), RATE_HZ);
        for _ in 0..9000 * 3 {
            axis.step(0.0, 200.0, 0.0);
        }
        assert!(axis.stage_position_m().abs() < 5.0e-6, "{}", axis.stage_position_m());
    }

    #[test]
    fn an_axis_follows_a_command_and_stays_there() {
        for settings in [AxisSettings::rolling(true), AxisSettings::sliding(false)] {
            let mut axis = TurretAxis::new(settings, RATE_HZ);
            for i in 0..9000 * 2 {
                axis.step((f64::from(i) * 2.0e-3 / RATE_HZ).min(0.5e-3), 0.0, 0.0);
            }
            assert!((axis.stage_position_m() - 0.5e-3).abs() < 5.0e-6, "{}", axis.stage_position_m());
        }
    }

    #[test]
    fn an_axis_that_stops_on_the_edge_of_a_count_does_not_hunt() {
        for place_m in [0.5e-3_f64, -0.6115e-3, -0.61162e-3, 0.88733e-3] {
            let mut axis = TurretAxis::new(AxisSettings::rolling(true), RATE_HZ);
            let mut steps = 0;
            let mut last_a = 0.0;
            for i in 0..9000 * 6 {
                let way_m = (f64::from(i) * 2.0e-3 / RATE_HZ).min(place_m.abs());
                let noise = ((f64::from(i) * 0.731).sin() * 43_758.5).fract();
                let report = axis.step(way_m.copysign(place_m), 40.0, noise);
                // A count is 67 nm: read as velocity it moves the current by 0.015 A.
                if i > 9000 * 4 && (report.current_ref_a - last_a).abs() > 0.007 {
                    steps += 1;
                }
                last_a = report.current_ref_a;
            }
            assert!(steps < 20, "{place_m}: {steps} steps of the current in two seconds");
        }
    }

    #[test]
    fn stage_motion_under_chatter_is_inertia() {
        // Far above the resonance the stage answers with F / (M omega^2): 50 N at 650 Hz move 150 kg by 20
        // nm.
        let mut axis = TurretAxis::new(AxisSettings::rolling(true), RATE_HZ);
        let mut largest: f64 = 0.0;
        for i in 0..18_000 {
            let t = f64::from(i) / RATE_HZ;
            axis.step(0.0, 50.0 * (TAU * 650.0 * t).sin(), 0.0);
            if i > 9000 {
                largest = largest.max(axis.stage_position_m().abs());
            }
        }
        let inertia = 50.0 / (150.0 * (TAU * 650.0_f64).powi(2));
        assert!((largest / inertia - 1.0).abs() < 0.15, "{largest} m against {inertia} m");
    }
}
