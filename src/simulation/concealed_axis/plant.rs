//! Equations of motion of the judge's axis: richer than any model that is fitted to it.
//!
//! ```text
//!   K_t i        k_tor,c_tor      gap, K(x), K3, C_k
//!  ------>[ m1 ]=====/\/\=====[ m2 ]=====| |/\/\=====[ M ]<--- friction, maps, cut
//!          x_1                 x_2                    x       scale: x + base motion
//! ```
//! Everything is on the screw axis (angles times travel per radian), so a mass of the motor side is
//! `J/R^2`. Independent on purpose: it shares no equation with the observers, the identification or
//! the diagnosis, because fitting one's own simulation proves only the optimiser.

use std::f64::consts::TAU;

/// Number of states: motor x, v; screw x, v; stage x, v; current; bristle; base x, v.
pub(super) const STATES: usize = 10;

/// One instant of the axis.
pub(super) type State = [f64; STATES];

/// Index of each state.
pub(super) mod at {
    pub(in super::super) const MOTOR: usize = 0;
    pub(in super::super) const MOTOR_V: usize = 1;
    pub(in super::super) const SCREW: usize = 2;
    pub(in super::super) const SCREW_V: usize = 3;
    pub(in super::super) const STAGE: usize = 4;
    pub(in super::super) const STAGE_V: usize = 5;
    pub(in super::super) const CURRENT: usize = 6;
    pub(in super::super) const BRISTLE: usize = 7;
    pub(in super::super) const BASE: usize = 8;
    pub(in super::super) const BASE_V: usize = 9;
}

/// A force that is a sine of a position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wave {
    /// Wavelength in m of travel.
    pub wavelength_m: f64,
    /// Amplitude in N (in m where it is an encoder's error).
    pub amplitude: f64,
    /// Phase at position zero, rad.
    pub phase_rad: f64,
}

impl Wave {
    pub(super) fn at(&self, x: f64) -> f64 {
        self.amplitude * (TAU * x / self.wavelength_m + self.phase_rad).sin()
    }
}

impl HiddenCut {
    /// Largest value of 1 + sin p + 0.3 sin(2 p + 0.7).
    pub(super) const PEAK: f64 = 1.969_686_640_030_7;
}

/// A cut that nobody mentioned: tooth-pass force between two instants.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HiddenCut {
    /// Tooth-pass frequency, Hz.
    pub fundamental_hz: f64,
    /// Largest force, N. The fundamental is as large as the mean, the second harmonic 0.3 of it.
    pub peak_n: f64,
    /// First instant, s.
    pub start_s: f64,
    /// Last instant, s.
    pub end_s: f64,
}

/// Constants of the structure, the true ones.
#[derive(Debug, Clone, PartialEq)]
#[expect(missing_docs, reason = "each field is its own unit-carrying name; meaning in docs/symbols.md")]
pub struct TrueDrive {
    pub reflected_mass_kg: f64,
    pub movable_mass_kg: f64,
    pub thrust_constant_n_a: f64,
    pub axial_stiffness_n_m: f64,
    pub structural_damping_n_s_m: f64,
    pub reflected_damping_n_s_m: f64,
    pub translational_damping_n_s_m: f64,
    pub stage_coulomb_friction_n: f64,
    pub motor_coulomb_friction_n: f64,
    pub friction_smoothing_m_s: f64,
    /// `None`: the current follows its reference at once.
    pub current_loop_bandwidth_rad_s: Option<f64>,
}

/// What the axis has beyond its structure. Neutral by default: every field off.
#[derive(Debug, Clone, PartialEq, Default)]
#[expect(missing_docs, reason = "each field is named after the effect of the vocabulary it is")]
pub struct HiddenPhysics {
    /// Share of an algebraic instead of a hyperbolic friction step: machines are not tanh.
    pub friction_shape: f64,
    pub stribeck_force_n: f64,
    pub stribeck_velocity_m_s: f64,
    pub presliding_stiffness_n_m: Option<f64>,
    pub asymmetry_n: f64,
    pub nonlinear_viscosity_n_s2_m2: f64,
    pub friction_relative_change: f64,
    pub friction_time_constant_s: f64,
    pub stage_waves: Vec<Wave>,
    /// Bumps of a position map: centre m, width m, height N.
    pub bumps: Vec<[f64; 3]>,
    pub motor_waves: Vec<Wave>,
    pub saturation_per_a2: f64,
    pub gravity_n: f64,
    pub gap_m: f64,
    /// Free-free frequency in Hz of motor against screw, and the motor's share of the inertia.
    pub torsion: Option<(f64, f64)>,
    pub stiffness_variation: f64,
    pub stiffness_length_m: f64,
    pub cubic_n_m3: f64,
    pub cut: Option<HiddenCut>,
    /// A force with no law: pulses in time, centre s, width s, height N.
    pub pulses: Vec<[f64; 3]>,
    /// Outsider: friction that grows along the stroke, N per (m/s) per m.
    pub sloped_viscosity_n_s_m2: f64,
    /// Outsider: base mode that only the scale sees: frequency Hz, damping ratio, gain.
    pub base_mode: Option<[f64; 3]>,
}

/// Inputs that are constant over one integration step.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Drivers {
    /// Current that the amplifier was told, after the dead time, A.
    pub(super) current_a: f64,
    /// Disturbance at the motor, N.
    pub(super) motor_noise_n: f64,
    /// Disturbance at the stage, N, against positive motion.
    pub(super) stage_noise_n: f64,
}

/// The axis: structure and physics beyond it.
#[derive(Debug, Clone)]
pub(super) struct Plant {
    pub(super) drive: TrueDrive,
    pub(super) physics: HiddenPhysics,
    /// Small repeatable forces over position that every real axis has; nobody's finding.
    pub(super) texture: Vec<Wave>,
}

impl Plant {
    /// Time derivative of the state at `t_s`.
    ///
    /// m1 a1 = F_i + waves(x1) - C_r v1 - F_m(v1) - T;  m2 a2 = T - S;  M a = S - C_t v - F_stage
    ///
    /// T: torsional spring (rigid without one: m1 + m2 move together), S: axial spring with gap.
    /// Units: SI. Errors: none.
    /// Checked by: tests::two_masses_ring_at_the_closed_form_frequency, tests::rest_stays_at_rest.
    pub(super) fn derivative(&self, t_s: f64, s: &State, u: &Drivers) -> State {
        let (d, p) = (&self.drive, &self.physics);
        let mut out = [0.0; STATES];
        let (x1, v1, x, v) = (s[at::MOTOR], s[at::MOTOR_V], s[at::STAGE], s[at::STAGE_V]);
        let current = match d.current_loop_bandwidth_rad_s {
            Some(bandwidth) => {
                out[at::CURRENT] = bandwidth * (u.current_a - s[at::CURRENT]);
                s[at::CURRENT]
            }
            None => u.current_a,
        };
        let thrust = d.thrust_constant_n_a * current * (1.0 - p.saturation_per_a2 * current * current);
        let at_motor = thrust + p.motor_waves.iter().map(|w| w.at(x1)).sum::<f64>() + u.motor_noise_n
            - d.reflected_damping_n_s_m * v1
            - d.motor_coulomb_friction_n * self.step(v1);
        let at_stage = self.stage_force(t_s, s, &mut out) + u.stage_noise_n;
        out[at::MOTOR] = v1;
        out[at::STAGE] = v;
        let stage_accel;
        if let Some((frequency_hz, motor_share)) = p.torsion {
            let (m1, m2) = (d.reflected_mass_kg * motor_share, d.reflected_mass_kg * (1.0 - motor_share));
            let reduced = m1 * m2 / (m1 + m2);
            let k = reduced * (TAU * frequency_hz).powi(2);
            let c = 2.0 * 0.015 * (k * reduced).sqrt();
            let (x2, v2) = (s[at::SCREW], s[at::SCREW_V]);
            let torsion = k * (x1 - x2) + c * (v1 - v2);
            let spring = self.spring(x2 - x, v2 - v, x);
            out[at::MOTOR_V] = (at_motor - torsion) / m1;
            out[at::SCREW] = v2;
            out[at::SCREW_V] = (torsion - spring) / m2;
            stage_accel = (spring - at_stage) / d.movable_mass_kg;
        } else {
            let spring = self.spring(x1 - x, v1 - v, x);
            out[at::MOTOR_V] = (at_motor - spring) / d.reflected_mass_kg;
            stage_accel = (spring - at_stage) / d.movable_mass_kg;
        }
        out[at::STAGE_V] = stage_accel;
        if let Some([frequency_hz, damping, gain]) = p.base_mode {
            let w = TAU * frequency_hz;
            out[at::BASE] = s[at::BASE_V];
            out[at::BASE_V] = -2.0 * damping * w * s[at::BASE_V] - w * w * s[at::BASE] - gain * stage_accel;
        }
        out
    }

    /// Force against positive motion of the stage, N; also moves the bristle.
    fn stage_force(&self, t_s: f64, s: &State, out: &mut State) -> f64 {
        let (d, p) = (&self.drive, &self.physics);
        let (x, v) = (s[at::STAGE], s[at::STAGE_V]);
        let warm = if p.friction_relative_change == 0.0 {
            1.0
        } else {
            1.0 + p.friction_relative_change * (1.0 - (-t_s / p.friction_time_constant_s).exp())
        };
        let bump = if p.stribeck_force_n == 0.0 {
            0.0
        } else {
            p.stribeck_force_n * (-(v / p.stribeck_velocity_m_s).powi(2)).exp()
        };
        let level = warm * d.stage_coulomb_friction_n + bump;
        let step = match p.presliding_stiffness_n_m {
            // Dahl / LuGre bristle without micro-damping's lag: dz = v - k |v| z / level.
            Some(k) => {
                out[at::BRISTLE] = v - k * v.abs() * s[at::BRISTLE] / level;
                let micro_damping = 0.3 * (k * d.movable_mass_kg).sqrt() * (-(v / 1.0e-3).powi(2)).exp();
                (k * s[at::BRISTLE] + micro_damping * out[at::BRISTLE]) / level
            }
            None => self.step(v),
        };
        let mut force = level * step + d.translational_damping_n_s_m * v + p.gravity_n;
        force += 0.5 * p.asymmetry_n * step.abs() + p.nonlinear_viscosity_n_s2_m2 * v * v.abs();
        force += p.sloped_viscosity_n_s_m2 * v * x;
        force += p.stage_waves.iter().chain(&self.texture).map(|w| w.at(x)).sum::<f64>();
        force += p.bumps.iter().map(|[c, w, h]| h * (-((x - c) / w).powi(2)).exp()).sum::<f64>();
        force += p.pulses.iter().map(|[c, w, h]| h * (-((t_s - c) / w).powi(2)).exp()).sum::<f64>();
        if let Some(cut) = p.cut
            && (cut.start_s..cut.end_s).contains(&t_s)
        {
            let phase = TAU * cut.fundamental_hz * t_s;
            let wave = 1.0 + phase.sin() + 0.3 * (2.0 * phase + 0.7).sin();
            force += cut.peak_n / HiddenCut::PEAK * wave;
        }
        force
    }

    /// Axial spring from the screw to the stage, N: gap, place and load change it.
    fn spring(&self, stretch: f64, rate: f64, x: f64) -> f64 {
        let (d, p) = (&self.drive, &self.physics);
        let half = 0.5 * p.gap_m;
        let (pressed, engaged) = if half == 0.0 {
            (stretch, 1.0)
        } else {
            let pressed = stretch - stretch.clamp(-half, half);
            (pressed, (pressed.abs() / (0.02 * p.gap_m)).min(1.0))
        };
        let place = if p.stiffness_variation == 0.0 {
            1.0
        } else {
            1.0 + p.stiffness_variation * (x / p.stiffness_length_m).clamp(-0.9, 0.9)
        };
        d.axial_stiffness_n_m * place * pressed
            + p.cubic_n_m3 * pressed.powi(3)
            + engaged * d.structural_damping_n_s_m * rate
    }

    /// The friction step from -1 to 1: mostly tanh, partly algebraic.
    fn step(&self, v: f64) -> f64 {
        let u = v / self.drive.friction_smoothing_m_s;
        // Beyond 20 smoothing speeds tanh is 1 to the last bit.
        let smooth = if u.abs() > 20.0 { u.signum() } else { u.tanh() };
        let share = self.physics.friction_shape;
        if share == 0.0 { smooth } else { (1.0 - share) * smooth + share * u / (1.0 + u * u).sqrt() }
    }

    /// One classical fourth-order Runge-Kutta step of `h_s`.
    ///
    /// Checked by: tests::two_masses_ring_at_the_closed_form_frequency.
    pub(super) fn advance(&self, t_s: f64, s: &State, u: &Drivers, h_s: f64) -> State {
        let shifted = |k: &State, by: f64| std::array::from_fn(|i| s[i] + by * k[i]);
        let k1 = self.derivative(t_s, s, u);
        let k2 = self.derivative(t_s + 0.5 * h_s, &shifted(&k1, 0.5 * h_s), u);
        let k3 = self.derivative(t_s + 0.5 * h_s, &shifted(&k2, 0.5 * h_s), u);
        let k4 = self.derivative(t_s + h_s, &shifted(&k3, h_s), u);
        std::array::from_fn(|i| s[i] + h_s / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]))
    }

    /// The same axis without the physics beyond its structure.
    pub(super) fn bare(&self) -> Self {
        let physics =
            HiddenPhysics { friction_shape: self.physics.friction_shape, ..HiddenPhysics::default() };
        Self { drive: self.drive.clone(), physics, texture: self.texture.clone() }
    }

    /// What the physics beyond the structure adds at this instant, N: to the thrust that the motion needs at
    /// the motor, to the force of the spring, and to the thrust that it needs at the stage.
    pub(super) fn hidden_forces(&self, bare: &Self, (t_s, s, u): (f64, &State, &Drivers)) -> [f64; 3] {
        let (mut a, mut b) = ([0.0; STATES], [0.0; STATES]);
        let stage = self.stage_force(t_s, s, &mut a) - bare.stage_force(t_s, s, &mut b);
        let current =
            if self.drive.current_loop_bandwidth_rad_s.is_some() { s[at::CURRENT] } else { u.current_a };
        let motor = self.drive.thrust_constant_n_a * self.physics.saturation_per_a2 * current.powi(3)
            - self.physics.motor_waves.iter().map(|w| w.at(s[at::MOTOR])).sum::<f64>();
        let end =
            if self.physics.torsion.is_some() { (at::SCREW, at::SCREW_V) } else { (at::MOTOR, at::MOTOR_V) };
        let (x, v) = (s[at::STAGE], s[at::STAGE_V]);
        let (stretch, rate) = (s[end.0] - x, s[end.1] - v);
        let coupling = self.spring(stretch, rate, x) - bare.spring(s[at::MOTOR] - x, s[at::MOTOR_V] - v, x);
        [motor, coupling, stage]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive() -> TrueDrive {
        TrueDrive {
            reflected_mass_kg: 82.0,
            movable_mass_kg: 6.6,
            thrust_constant_n_a: 251.0,
            axial_stiffness_n_m: 4.0e7,
            structural_damping_n_s_m: 0.0,
            reflected_damping_n_s_m: 0.0,
            translational_damping_n_s_m: 0.0,
            stage_coulomb_friction_n: 0.0,
            motor_coulomb_friction_n: 0.0,
            friction_smoothing_m_s: 2.0e-4,
            current_loop_bandwidth_rad_s: None,
        }
    }

    #[test]
    fn two_masses_ring_at_the_closed_form_frequency() {
        // Free-free: w^2 = K (1/M1 + 1/M2); started stretched and at rest, the stretch is a cosine.
        let plant = Plant { drive: drive(), physics: HiddenPhysics::default(), texture: Vec::new() };
        let w = (4.0e7_f64 * (1.0 / 82.0 + 1.0 / 6.6)).sqrt();
        let mut s = [0.0; STATES];
        s[at::MOTOR] = 1.0e-6;
        let h = 1.0e-5;
        for k in 0..1000 {
            s = plant.advance(f64::from(k) * h, &s, &Drivers::default(), h);
        }
        let expected = 1.0e-6 * (w * 0.01).cos();
        assert!((s[at::MOTOR] - s[at::STAGE] - expected).abs() < 1.0e-11, "{} {expected}", s[0] - s[4]);
    }

    #[test]
    fn rest_stays_at_rest() {
        let physics =
            HiddenPhysics { gap_m: 1.0e-6, torsion: Some((800.0, 0.5)), ..HiddenPhysics::default() };
        let plant = Plant { drive: drive(), physics, texture: Vec::new() };
        assert_eq!(plant.derivative(0.0, &[0.0; STATES], &Drivers::default()), [0.0; STATES]);
    }

    #[test]
    fn inside_the_gap_the_spring_is_silent() {
        let physics = HiddenPhysics { gap_m: 1.0e-6, ..HiddenPhysics::default() };
        let plant = Plant { drive: drive(), physics, texture: Vec::new() };
        assert!(plant.spring(0.4e-6, 1.0, 0.0).abs() < 1.0e-12);
        assert!((plant.spring(1.0e-6, 0.0, 0.0) - 20.0).abs() < 1.0e-9);
    }

    #[test]
    fn a_bristle_ends_at_the_sliding_level() {
        let mut d = drive();
        d.stage_coulomb_friction_n = 50.0;
        let physics = HiddenPhysics { presliding_stiffness_n_m: Some(4.0e6), ..HiddenPhysics::default() };
        let plant = Plant { drive: d, physics, texture: Vec::new() };
        let mut s = [0.0; STATES];
        s[at::STAGE_V] = 5.0e-3;
        s[at::BRISTLE] = 50.0 / 4.0e6;
        let mut out = [0.0; STATES];
        let force = plant.stage_force(0.0, &s, &mut out);
        assert!((force - 50.0).abs() < 1.0e-9, "{force}");
        assert!(out[at::BRISTLE].abs() < 1.0e-12);
    }
}
