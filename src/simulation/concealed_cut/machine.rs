//! The true machine of a concealed case: numbers, and physics that its scenario does not state.
//!
//! Its laws are written here from the contract alone; nothing of `plant::cut_effects`, of the linear cut or
//! of the diagnosis is used.

use std::f64::consts::{PI, TAU};

/// What is concealed, with its numbers; most are absent.
#[derive(Debug, Clone, Copy, PartialEq)]
#[expect(missing_docs, reason = "each field is a parameter of contracts, section 6, under its own name")]
pub struct Hidden {
    pub edge_force_n: f64,
    pub exponent: f64,
    pub nose_radius_m: Option<f64>,
    pub speed_exponent: f64,
    pub runout_m: f64,
    pub runout_order: f64,
    pub runout_phase_rad: f64,
    pub second_mode: Option<Mode>,
    pub plane_hz: Option<f64>,
    pub orientation_rad: f64,
    pub hz_per_s: f64,
    pub hz_per_m: f64,
    pub support_n_m: Option<f64>,
    pub contact_n_m: f64,
    pub hz_per_rpm: f64,
    pub wear_1_s: f64,
    pub tool2_ratio: f64,
    pub turret: Option<Mode>,
    pub speed_ripple: f64,
    pub ripple_order: f64,
    pub ripple_phase_rad: f64,
    pub sector_change: f64,
    pub sector_rad: f64,
    pub sector_centre_rad: f64,
    pub force_lag_s: f64,
    pub signal_delay_s: f64,
    pub signal_bandwidth_hz: Option<f64>,
    /// Outsider: force of tangled chips on the bar, N: bursts of a tenth of a second, at random.
    pub tangle_n: f64,
    /// Outsider: a tone on the bar that follows no angle, N and Hz.
    pub tone_n: f64,
    pub tone_hz: f64,
    /// Outsider: the bar's frequency wanders at random, by this share of itself and within this time.
    pub wandering: f64,
    pub wandering_s: f64,
    /// Outsider: the pressure does, by this share of itself and within the same time.
    pub wandering_pressure: f64,
    /// Outsider: how much of a change of the chip the force overshoots, and how fast that fades.
    pub overshoot: f64,
    pub fading_s: f64,
    /// Outsider: the bar's stiffness grows with its motion, by this share and (m at the tools)^2.
    pub stiffening_1_m2: f64,
    /// Outsider: a bar that is not round, share of its stiffness that goes up and down twice a turn.
    pub unround: f64,
}

/// A resonance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mode {
    /// Frequency.
    pub frequency_hz: f64,
    /// Damping ratio.
    pub damping_ratio: f64,
    /// Stiffness.
    pub n_m: f64,
}

impl Default for Hidden {
    fn default() -> Self {
        Self {
            edge_force_n: 0.0,
            exponent: 1.0,
            nose_radius_m: None,
            speed_exponent: 0.0,
            runout_m: 0.0,
            runout_order: 1.0,
            runout_phase_rad: 0.0,
            second_mode: None,
            plane_hz: None,
            orientation_rad: 0.0,
            hz_per_s: 0.0,
            hz_per_m: 0.0,
            support_n_m: None,
            contact_n_m: 0.0,
            hz_per_rpm: 0.0,
            wear_1_s: 0.0,
            tool2_ratio: 1.0,
            turret: None,
            speed_ripple: 0.0,
            ripple_order: 1.0,
            ripple_phase_rad: 0.0,
            sector_change: 0.0,
            sector_rad: 0.0,
            sector_centre_rad: 0.0,
            force_lag_s: 0.0,
            signal_delay_s: 0.0,
            signal_bandwidth_hz: None,
            tangle_n: 0.0,
            tone_n: 0.0,
            tone_hz: 0.0,
            wandering: 0.0,
            wandering_s: 1.0,
            wandering_pressure: 0.0,
            overshoot: 0.0,
            fading_s: 1.0,
            stiffening_1_m2: 0.0,
            unround: 0.0,
        }
    }
}

/// The machine as it is.
#[derive(Debug, Clone, Copy, PartialEq)]
#[expect(missing_docs, reason = "each field is its own unit-carrying name; meaning in contracts, section 3")]
pub struct TrueCut {
    pub two_tools: bool,
    pub diameter_m: f64,
    pub length_m: f64,
    pub modulus_pa: f64,
    pub density_kg_m3: f64,
    pub damping_ratio: f64,
    pub clamp_factor: f64,
    pub pressure_pa: f64,
    pub width_m: f64,
    pub feed_m_rev: f64,
    pub flank_damping_n: f64,
    pub memory: f64,
    pub clearance_rad: f64,
    pub flank_force_n: f64,
    pub tangential_ratio: f64,
    pub speed_rpm: f64,
    pub position_m: f64,
    pub random_ratio: f64,
    pub hidden: Hidden,
}

/// Condition of one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
#[expect(missing_docs, reason = "each field is its own unit-carrying name; meaning in contracts, section 6")]
pub struct Moment {
    pub t_s: f64,
    pub speed_rpm: f64,
    pub feed_m_rev: f64,
    pub width_m: f64,
    pub position_m: f64,
    pub pitch_rad: f64,
}

/// Bending of the bar as the tools see it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bending {
    pub(super) shape: f64,
    pub(super) straight: f64,
    pub(super) mass_kg: f64,
    /// Angular frequencies of the stated plane and of the other one.
    pub(super) rad_s: [f64; 2],
}

impl TrueCut {
    /// Deflection of a clamped beam in its first mode, 1 at its end: from the printed table of ratios.
    fn beam(share: f64) -> f64 {
        let (x, ratio) = (1.875_104_07 * share, 0.734_095_514);
        0.5 * ((x.cosh() - x.cos()) - ratio * (x.sinh() - x.sin()))
    }

    fn natural_hz(&self) -> f64 {
        // f = (1.8751)^2/(2 pi) sqrt(E I/(rho A L^4)).
        let area = PI * self.diameter_m * self.diameter_m / 4.0;
        let inertia = PI * self.diameter_m.powi(4) / 64.0;
        let stiff = self.modulus_pa * inertia / (self.density_kg_m3 * area * self.length_m.powi(4));
        self.clamp_factor * 3.516_015 / TAU * stiff.sqrt()
    }

    /// Stiffness at the free end, N/m, and frequency, Hz, of the bar in a stiff chuck.
    pub(super) fn stiffness_and_hz(&self) -> [f64; 2] {
        let hz = self.natural_hz();
        // A quarter of the bar's mass moves with its end.
        let kg = self.density_kg_m3 * PI * self.diameter_m * self.diameter_m / 16.0 * self.length_m;
        [kg * (TAU * hz).powi(2), hz]
    }

    /// Bending at a moment: the mass by adding up the bar's slices.
    pub(super) fn bending(&self, at: &Moment) -> Bending {
        let h = &self.hidden;
        let per_m = self.density_kg_m3 * PI * self.diameter_m * self.diameter_m / 4.0;
        let slices = 400;
        let sum = |shape: &dyn Fn(f64) -> f64| {
            let parts = (0..slices).map(|k| shape((f64::from(k) + 0.5) / f64::from(slices)).powi(2));
            per_m * self.length_m * parts.sum::<f64>() / f64::from(slices)
        };
        let hz = self.natural_hz();
        let clamped_kg = sum(&Self::beam);
        let rocking = h.support_n_m.map_or(0.0, |n_m| {
            let k = clamped_kg * (TAU * hz).powi(2);
            k / (k + n_m)
        });
        let shape = |share: f64| (1.0 - rocking) * Self::beam(share) + rocking * share;
        let moved = h.hz_per_s * at.t_s
            + h.hz_per_m * (at.position_m - self.position_m)
            + h.hz_per_rpm * (at.speed_rpm - self.speed_rpm);
        let share = at.position_m / self.length_m;
        Bending {
            shape: shape(share),
            straight: share,
            mass_kg: if rocking > 0.0 { sum(&shape) } else { clamped_kg },
            rad_s: [TAU * (hz + moved), TAU * (h.plane_hz.unwrap_or(hz) + moved)],
        }
    }

    /// Surface speed, m/s.
    pub(super) fn surface_m_s(&self, rpm: f64) -> f64 {
        PI * self.diameter_m * rpm / 60.0
    }

    /// Radial share behind a round corner.
    fn corner(radius_m: f64, width_m: f64) -> f64 {
        if width_m <= radius_m {
            (1.0 - width_m / (2.0 * radius_m)).sqrt()
        } else {
            radius_m / (radius_m * radius_m + width_m * width_m).sqrt()
        }
    }

    /// Force per chip area of a tool at a moment, Pa.
    fn pressure_pa(&self, tool: usize, at: &Moment) -> f64 {
        let h = &self.hidden;
        let corner =
            h.nose_radius_m.map_or(1.0, |r| Self::corner(r, at.width_m) / Self::corner(r, self.width_m));
        let speed =
            (self.surface_m_s(at.speed_rpm) / self.surface_m_s(self.speed_rpm)).powf(-h.speed_exponent);
        let tool = if tool == 1 { h.tool2_ratio } else { 1.0 };
        self.pressure_pa * corner * speed * tool * (1.0 + h.wear_1_s * at.t_s)
    }

    /// Radial force on a tool, N.
    pub(super) fn force_n(&self, tool: usize, at: &Moment, contact: &Contact) -> f64 {
        let h = &self.hidden;
        if contact.chip_m <= 0.0 || at.width_m <= 0.0 {
            return 0.0;
        }
        let order = if h.runout_order > 0.0 {
            h.runout_m * (h.runout_order * contact.psi_rad - h.runout_phase_rad).cos()
        } else {
            0.0
        };
        let width = (at.width_m + order).max(0.0);
        let reference = self.feed_m_rev / 2.0;
        let thick = reference * (contact.chip_m / reference).powf(h.exponent);
        let slope = contact.into_m_s / self.surface_m_s(contact.rpm);
        let rub = (slope - self.clearance_rad.tan()).max(0.0);
        let body = h.edge_force_n
            + h.contact_n_m * contact.into_m
            + self.flank_damping_n * slope
            + self.flank_force_n * rub;
        let whole = self.pressure_pa(tool, at) * width * thick + width / self.width_m * body;
        let from_centre = (contact.psi_rad - h.sector_centre_rad).rem_euclid(TAU);
        let inside = from_centre <= h.sector_rad / 2.0 || from_centre >= TAU - h.sector_rad / 2.0;
        let stock = if inside && h.sector_rad > 0.0 { 1.0 + h.sector_change } else { 1.0 };
        (stock * whole).max(0.0) * (1.0 + self.random_ratio * contact.noise)
    }
}

/// Where one tool meets the work.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Contact {
    pub(super) chip_m: f64,
    pub(super) into_m: f64,
    pub(super) into_m_s: f64,
    pub(super) psi_rad: f64,
    pub(super) rpm: f64,
    pub(super) noise: f64,
}
