//! Frequency responses of a drive: what thrust and cutting force do to motor and stage.
//!
//! A chain of masses on the screw axis (one, two or three for a drive, up to [`MAX_MASSES`] otherwise), each
//! damped to the ground, with springs and dampers between neighbours; solved numerically, so no expanded
//! polynomial can be misprinted.

use crate::plant::drive::{DriveParams, Structure};
use rustfft::num_complex::Complex64;
use std::f64::consts::TAU;

/// Most masses of a chain.
pub const MAX_MASSES: usize = 8;

/// One mass of the chain and its spring to the next one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ChainLink {
    /// kg on the screw axis.
    pub mass_kg: f64,
    /// Damping to the ground, N s/m.
    pub damping_n_s_m: f64,
    /// Spring to the next mass, N/m; unused on the last.
    pub spring_n_m: f64,
    /// Damper beside that spring, N s/m.
    pub damper_n_s_m: f64,
}

/// The masses of a drive from motor to stage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Chain {
    links: [ChainLink; MAX_MASSES],
    count: usize,
}

/// Positions in m per newton.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Receptance {
    /// Motor travel per thrust.
    pub motor_per_thrust: Complex64,
    /// Stage position per thrust.
    pub stage_per_thrust: Complex64,
    /// Motor travel per cutting force (which acts against the stage).
    pub motor_per_cutting: Complex64,
    /// Stage position per cutting force.
    pub stage_per_cutting: Complex64,
}

impl Chain {
    /// The chain of a drive.
    #[must_use]
    pub fn of_drive(drive: &DriveParams) -> Self {
        let r2 = drive.travel_m_rad().powi(2);
        let stage = ChainLink {
            mass_kg: drive.movable_mass_kg(),
            damping_n_s_m: drive.translational_damping_n_s_m(),
            ..ChainLink::default()
        };
        let motor = ChainLink {
            mass_kg: drive.reflected_mass_kg(),
            damping_n_s_m: drive.reflected_damping_n_s_m(),
            spring_n_m: drive.axial_stiffness_n_m(),
            damper_n_s_m: drive.structural_damping_n_s_m(),
        };
        match drive.structure() {
            Structure::Rigid => {
                let all = ChainLink {
                    mass_kg: drive.total_mass_kg(),
                    damping_n_s_m: stage.damping_n_s_m + motor.damping_n_s_m,
                    ..ChainLink::default()
                };
                Self::new(&[all])
            }
            Structure::DualInertia => Self::new(&[motor, stage]),
            Structure::TripleInertia => {
                let rotor = ChainLink {
                    spring_n_m: drive.torsional_stiffness_nm_rad() / r2,
                    damper_n_s_m: drive.torsional_damping_nm_s_rad() / r2,
                    ..motor
                };
                let screw =
                    ChainLink { mass_kg: drive.screw_inertia_kg_m2() / r2, damping_n_s_m: 0.0, ..motor };
                Self::new(&[rotor, screw, stage])
            }
        }
    }

    /// A chain from links; the last one's spring is not used. At most [`MAX_MASSES`] links, more are cut off.
    #[must_use]
    pub fn new(given: &[ChainLink]) -> Self {
        let mut links = [ChainLink::default(); MAX_MASSES];
        let count = given.len().clamp(1, MAX_MASSES);
        links[..count.min(given.len())].copy_from_slice(&given[..count.min(given.len())]);
        Self { links, count }
    }

    /// The masses.
    #[must_use]
    pub fn links(&self) -> &[ChainLink] {
        &self.links[..self.count]
    }

    /// Receptances at a frequency: (K - omega^2 M + i omega C) x = f, by elimination along the chain.
    ///
    /// Checked by: identities::the_chain_equals_the_printed_transfer_functions.
    #[must_use]
    pub fn receptance(&self, frequency_hz: f64) -> Receptance {
        let n = self.count;
        let w = TAU * frequency_hz;
        let spring = |i: usize| Complex64::new(self.links[i].spring_n_m, w * self.links[i].damper_n_s_m);
        let zero = Complex64::new(0.0, 0.0);
        let mut diagonal = [zero; MAX_MASSES];
        let mut off = [zero; MAX_MASSES];
        for i in 0..n {
            let link = &self.links[i];
            diagonal[i] = Complex64::new(-w * w * link.mass_kg, w * link.damping_n_s_m);
            if i + 1 < n {
                diagonal[i] += spring(i);
                off[i] = -spring(i);
            }
            if i > 0 {
                diagonal[i] += spring(i - 1);
            }
        }
        let solve = |force: [Complex64; MAX_MASSES]| {
            let (mut d, mut f) = (diagonal, force);
            for i in 1..n {
                let factor = off[i - 1] / d[i - 1];
                d[i] -= factor * off[i - 1];
                f[i] -= factor * f[i - 1];
            }
            let mut x = [zero; MAX_MASSES];
            for i in (0..n).rev() {
                let next = if i + 1 < n { off[i] * x[i + 1] } else { zero };
                x[i] = (f[i] - next) / d[i];
            }
            (x[0], x[n - 1])
        };
        let mut thrust = [zero; MAX_MASSES];
        thrust[0].re = 1.0;
        let mut cutting = [zero; MAX_MASSES];
        cutting[n - 1].re = -1.0;
        let (motor_per_thrust, stage_per_thrust) = solve(thrust);
        let (motor_per_cutting, stage_per_cutting) = solve(cutting);
        Receptance { motor_per_thrust, stage_per_thrust, motor_per_cutting, stage_per_cutting }
    }

    /// Free modes of the undamped chain: frequencies in Hz, growing (the first is rigid motion, 0 Hz),
    /// and the modal matrix, one column a mode, scaled so that the motor moves by one.
    ///
    /// Numerically for any number of masses, as the thesis asks for in 2.6.1: eigenvectors of
    /// M^-1/2 K M^-1/2. Checked by: identities::modal_matrices_are_diagonal.
    #[must_use]
    pub fn modes(&self) -> Modes {
        let n = self.count;
        let mut a = nalgebra::DMatrix::<f64>::zeros(n, n);
        let root = |i: usize| self.links[i].mass_kg.sqrt();
        for i in 0..n.saturating_sub(1) {
            let k = self.links[i].spring_n_m;
            for (r, c, sign) in [(i, i, 1.0), (i + 1, i + 1, 1.0), (i, i + 1, -1.0), (i + 1, i, -1.0)] {
                a[(r, c)] += sign * k / (root(r) * root(c));
            }
        }
        let eigen = nalgebra::SymmetricEigen::new(a);
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|x, y| eigen.eigenvalues[*x].total_cmp(&eigen.eigenvalues[*y]));
        let frequencies_hz = order.iter().map(|k| eigen.eigenvalues[*k].max(0.0).sqrt() / TAU).collect();
        let physical_from_modal = order
            .iter()
            .map(|k| {
                let shape: Vec<f64> = (0..n).map(|i| eigen.eigenvectors[(i, *k)] / root(i)).collect();
                shape.iter().map(|x| x / shape[0]).collect()
            })
            .collect();
        Modes { frequencies_hz, physical_from_modal }
    }
}

/// Modes of a chain.
#[derive(Debug, Clone, PartialEq)]
pub struct Modes {
    /// Natural frequencies, Hz, growing.
    pub frequencies_hz: Vec<f64>,
    /// phi: for each mode the movement of the masses, motor first and equal to one.
    pub physical_from_modal: Vec<Vec<f64>>,
}
