//! Cutting force in one mode of a chain of any number of masses, each of whose positions is measured.
//!
//! Source: Yamada, thesis 2.6.1, (2-59)-(2-63); the multi-encoder form (2-49) is its first mode.

use super::response::Chain;

/// Factors of position, velocity and acceleration of each mass and of the thrust on the first that give the
/// cutting force on the last.
///
/// F_cut = 1/phi_t { phi_1 u - phi^T (M a + C v + K x) - sum phi_i F_i }
///
/// phi^T M a = M_k a_k, phi^T K x = K_k x_k by orthogonality, and phi^T C v = C_k v_k under proportional
/// damping (2-53); written with the physical matrices it is exact for any damping.
/// Checked by: identities::every_mode_of_three_masses_returns_the_cutting_force,
/// identities::two_masses_are_the_vibration_mode.
#[derive(Debug, Clone, PartialEq)]
pub struct ModalBalance {
    /// phi_1 / phi_t.
    pub thrust: f64,
    /// For each mass: N/m, N s/m, kg.
    pub motion: Vec<[f64; 3]>,
}

impl ModalBalance {
    /// Mode `mode` of a chain, 0 being the rigid one. `None` for a mode that the chain does not have or
    /// in which the last mass does not move: no force on it can be seen there.
    #[must_use]
    pub fn new(chain: &Chain, mode: usize) -> Option<Self> {
        let modes = chain.modes();
        let phi = modes.physical_from_modal.get(mode)?;
        let links = chain.links();
        let phi_t = *phi.last()?;
        if phi_t.abs() < 1e-9 {
            return None;
        }
        let mut motion = vec![[0.0; 3]; links.len()];
        for (i, link) in links.iter().enumerate() {
            motion[i][1] -= phi[i] * link.damping_n_s_m / phi_t;
            motion[i][2] -= phi[i] * link.mass_kg / phi_t;
            if i + 1 < links.len() {
                // A spring between i and i + 1 loads the mode by (phi_i - phi_i+1)(x_i - x_i+1).
                let apart = (phi[i] - phi[i + 1]) / phi_t;
                for (k, factor) in [link.spring_n_m, link.damper_n_s_m].into_iter().enumerate() {
                    motion[i][k] -= apart * factor;
                    motion[i + 1][k] += apart * factor;
                }
            }
        }
        Some(Self { thrust: phi[0] / phi_t, motion })
    }
}
