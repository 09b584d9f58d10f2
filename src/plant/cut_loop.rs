//! Means and small vibration of a cut: force law, bar and holder closed to one loop.
//!
//! ```text
//! F = n - A R F,   u = -R F,   y = -G (F1 - F2)         F = (F1, F2), n random force, u edges into the work
//! A = D [ K1 + e , -K1 o exp(-s tau2) ; -K2 o exp(-s tau1) , K2 + e ]      D = 1/(1 + s lag)
//! R = [ G , -G ; -G , G + H ]                                              e = B (s C_i/v + k_c)
//! Delta(s) = det(I + A R);     Z = (I + A R)^-1;     one tool: 1 + G D (K (1 - o exp(-s T)) + e)
//! ```
//! G is the bar at the tools (planes and second mode), H the holder of tool 2, o the overlap. Linear: no loss
//! of contact, no flank limit; what varies over a turn enters with its mean.

use super::cut_terms::{ChipMemory, CutTerms};
use super::cutting::{ToolCount, TwoDelay};
use nalgebra::Complex;
use std::f64::consts::{PI, TAU};

/// Corner of the random part of the cutting force, Hz (contracts, section 6).
pub const RANDOM_FORCE_CORNER_HZ: f64 = 2000.0;

/// One resonance seen from a force to a motion: gain/(s^2 + 2 zeta w s + w^2).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resonance {
    /// Shape^2 over mass, 1/kg; negative where the plane's force acts against it.
    pub gain_1_kg: f64,
    /// w.
    pub rad_s: f64,
    /// zeta.
    pub damping_ratio: f64,
}

impl Resonance {
    /// s^2 + 2 zeta w s + w^2.
    #[must_use]
    pub fn denominator(&self, s: Complex<f64>) -> Complex<f64> {
        s * s + s * (2.0 * self.damping_ratio * self.rad_s) + self.rad_s * self.rad_s
    }

    /// Motion per force, m/N.
    #[must_use]
    pub fn response(&self, s: Complex<f64>) -> Complex<f64> {
        self.denominator(s).inv() * self.gain_1_kg
    }

    /// At rest, m/N.
    #[must_use]
    pub fn compliance_m_n(&self) -> f64 {
        self.gain_1_kg / (self.rad_s * self.rad_s)
    }
}

/// Two by two, rows are tools.
pub type ToolMatrix = [[Complex<f64>; 2]; 2];

/// Mean forces and displacements of a calm cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutMeans {
    /// Radial force on each tool, N; of one tool the second is zero.
    pub force_n: [f64; 2],
    /// Chip thickness, m.
    pub chip_m: [f64; 2],
    /// y: bar toward tool 1, m.
    pub bar_m: f64,
    /// w: holder of tool 2 into the work, m.
    pub holder_m: f64,
}

/// The loop of one condition, in numbers that need no scenario any more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutLoop {
    /// One tool or two.
    pub tools: ToolCount,
    /// tau_1, tau_2 (one tool: a turn).
    pub delays_s: [f64; 2],
    /// Advance of each tool since the surface that it cuts was left.
    pub advance_m: [f64; 2],
    /// h_r.
    pub reference_chip_m: f64,
    /// p.
    pub exponent: f64,
    /// k_j: force per chip at h_r, N/m.
    pub cutting_n_m: [f64; 2],
    /// K_j = k_j p (h_j/h_r)^(p-1) at the advance, N/m.
    pub slope_n_m: [f64; 2],
    /// o.
    pub overlap: f64,
    /// B F_e, N.
    pub edge_n: f64,
    /// B k_c, N/m.
    pub contact_n_m: f64,
    /// B C_i/v, N s/m.
    pub damping_n_s_m: f64,
    /// Lag of the force, s.
    pub lag_s: f64,
    /// What the force on a vibrating chip is over `slope_n_m`.
    pub memory: ChipMemory,
    /// Runout of order 0, m.
    pub tool2_ahead_m: f64,
    /// Planes of the bar and its second mode; a resonance that is not there has gain zero.
    pub bar: [Resonance; 3],
    /// Holder of tool 2.
    pub holder: Option<Resonance>,
}

impl CutLoop {
    /// The loop of these coefficients.
    #[must_use]
    pub fn new(terms: &CutTerms) -> Self {
        let body = terms.width_ratio * terms.stock_factor;
        let first = terms.radial_stiffness_pa * terms.at.width_m * terms.pressure_factor * terms.stock_factor;
        let cutting_n_m = match terms.tools {
            ToolCount::Two => [first, first * terms.ratio],
            ToolCount::One => [first, 0.0],
        };
        let advance_m = terms.chips_m();
        let slope = |k: f64, h: f64| {
            // No feed, no chip: the law has no slope of its own there but that of its reference.
            let relative =
                if terms.reference_chip_m > 0.0 && h > 0.0 { h / terms.reference_chip_m } else { 1.0 };
            k * terms.exponent * relative.powf(terms.exponent - 1.0)
        };
        Self {
            tools: terms.tools,
            delays_s: terms.delays_s(),
            advance_m,
            reference_chip_m: terms.reference_chip_m,
            exponent: terms.exponent,
            cutting_n_m,
            slope_n_m: [slope(cutting_n_m[0], advance_m[0]), slope(cutting_n_m[1], advance_m[1])],
            overlap: terms.overlap,
            edge_n: body * terms.edge_force_n,
            contact_n_m: body * terms.contact_stiffness_n_m,
            damping_n_s_m: body * terms.process_damping_n / terms.at.surface_speed_m_s(),
            lag_s: terms.force_lag_s,
            memory: terms.memory,
            tool2_ahead_m: terms.tool2_ahead_m,
            bar: bar_of(terms),
            holder: terms.turret.filter(|_| terms.tools == ToolCount::Two).map(|holder| {
                let rad_s = TAU * holder.frequency_hz;
                Resonance {
                    gain_1_kg: rad_s * rad_s / holder.stiffness_n_m,
                    rad_s,
                    damping_ratio: holder.damping_ratio,
                }
            }),
        }
    }

    /// G: bar at the tools per force difference, m/N.
    #[must_use]
    pub fn bar_response(&self, s: Complex<f64>) -> Complex<f64> {
        self.bar.iter().filter(|r| r.gain_1_kg.abs() > 0.0).map(|r| r.response(s)).sum()
    }

    /// H: holder of tool 2 per force, m/N.
    #[must_use]
    pub fn holder_response(&self, s: Complex<f64>) -> Complex<f64> {
        self.holder.map_or(Complex::new(0.0, 0.0), |r| r.response(s))
    }

    /// A: force per motion of the edges, N/m.
    #[must_use]
    pub fn force_law(&self, s: Complex<f64>) -> ToolMatrix {
        let one = Complex::new(1.0, 0.0);
        let late = if self.memory.late_s.abs() > 0.0 { (-s * self.memory.late_s).exp() } else { one };
        let memory = late * (1.0 + self.memory.gain);
        let [k1, k2] = self.slope_n_m.map(|k| memory * k);
        let zero = Complex::new(0.0, 0.0);
        let lag = if self.lag_s.abs() > 0.0 { (s * self.lag_s + 1.0).inv() } else { one };
        let flank = s * self.damping_n_s_m + self.contact_n_m;
        let past = |delay_s: f64| (-s * delay_s).exp() * self.overlap;
        match self.tools {
            ToolCount::Two => [
                [lag * (flank + k1), -lag * past(self.delays_s[1]) * k1],
                [-lag * past(self.delays_s[0]) * k2, lag * (flank + k2)],
            ],
            ToolCount::One => [[lag * (flank + k1 - past(self.delays_s[0]) * k1), zero], [zero; 2]],
        }
    }

    /// I + A R of a force law and the responses of bar and holder: of A only the last column and the
    /// differences of its rows are in it.
    fn return_difference(&self, s: Complex<f64>) -> ToolMatrix {
        let (a, g) = (self.force_law(s), self.bar_response(s));
        let [first, second] = [0, 1].map(|i| (a[i][0] - a[i][1]) * g);
        let mut out = [[first + 1.0, -first], [second, -second + 1.0]];
        if self.holder.is_some() {
            let h = self.holder_response(s);
            out[0][1] += a[0][1] * h;
            out[1][1] += a[1][1] * h;
        }
        out
    }

    /// Delta = det(I + A R); zero at a root.
    #[must_use]
    pub fn delta(&self, s: Complex<f64>) -> Complex<f64> {
        let m = self.return_difference(s);
        m[0][0] * m[1][1] - m[0][1] * m[1][0]
    }

    /// Z = (I + A R)^-1: forces per random force.
    #[must_use]
    pub fn closed(&self, s: Complex<f64>) -> ToolMatrix {
        let m = self.return_difference(s);
        let over = (m[0][0] * m[1][1] - m[0][1] * m[1][0]).inv();
        [[m[1][1] * over, -m[0][1] * over], [-m[1][0] * over, m[0][0] * over]]
    }

    /// A R: force per force.
    #[must_use]
    pub fn force_per_force(&self, s: Complex<f64>) -> ToolMatrix {
        let [[a, b], [c, d]] = self.return_difference(s);
        [[a - 1.0, b], [c, d - 1.0]]
    }

    /// Product of the denominators of G and H, over w^2 each: Delta times it has no poles but the lag's.
    #[must_use]
    pub fn denominators(&self, s: Complex<f64>) -> Complex<f64> {
        self.resonances().map(|r| r.denominator(s) / (r.rad_s * r.rad_s)).product()
    }

    /// The resonances that are there.
    pub fn resonances(&self) -> impl Iterator<Item = Resonance> + '_ {
        self.bar.iter().chain(&self.holder).filter(|r| r.gain_1_kg.abs() > 0.0).copied()
    }

    /// Force of tool `tool` at a chip and a motion `into_m` of its edge, at rest, N.
    fn mean_force_n(&self, tool: usize, chip_m: f64, into_m: f64) -> f64 {
        if chip_m <= 0.0 {
            return 0.0;
        }
        let reference = if self.reference_chip_m > 0.0 { self.reference_chip_m } else { chip_m };
        let chip = self.cutting_n_m[tool] * reference * (chip_m / reference).powf(self.exponent);
        (chip + self.edge_n + self.contact_n_m * into_m).max(0.0)
    }

    /// Mean forces of a calm cut: the fixed point of force law and statics, by steps that the slopes at the
    /// advance make as long as they may be.
    ///
    /// Cost: some ten evaluations. Checked by: `means_of_the_plain_cut`, `a_soft_bar_comes_to_rest`.
    #[must_use]
    pub fn means(&self) -> CutMeans {
        let bar_m_n: f64 = self.bar.iter().map(Resonance::compliance_m_n).sum();
        let holder_m_n = self.holder.map_or(0.0, |r| r.compliance_m_n());
        let two = self.tools == ToolCount::Two;
        let [first, second] = self.slope_n_m.map(|k| k * (1.0 + self.overlap) + self.contact_n_m);
        let stiff = if two { bar_m_n * (first + second) + holder_m_n * second } else { bar_m_n * first };
        let share = 1.0 / (1.0 + stiff);
        let mut now = CutMeans { force_n: [0.0; 2], chip_m: self.advance_m, bar_m: 0.0, holder_m: 0.0 };
        for _ in 0..200 {
            let into = [now.bar_m, now.holder_m + self.tool2_ahead_m - now.bar_m];
            let chip_m = if two {
                [
                    self.advance_m[0] + into[0] - self.overlap * into[1],
                    self.advance_m[1] + into[1] - self.overlap * into[0],
                ]
            } else {
                [self.advance_m[0] + into[0] - self.overlap * into[0], 0.0]
            };
            let force_n =
                [self.mean_force_n(0, chip_m[0], into[0]), self.mean_force_n(1, chip_m[1], into[1])];
            let moved = -bar_m_n * (force_n[0] - force_n[1]) - now.bar_m;
            let held = -holder_m_n * force_n[1] - now.holder_m;
            now = CutMeans {
                force_n,
                chip_m,
                bar_m: now.bar_m + share * moved,
                holder_m: now.holder_m + share * held,
            };
            // 1e-15 m: a millionth of a newton on the softest bar.
            if moved.abs() + held.abs() < 1e-15 {
                break;
            }
        }
        now
    }

    /// The same loop as the plain equation of two tools; `None` where it is not one.
    #[must_use]
    pub fn two_delay(&self) -> Option<TwoDelay> {
        let alone = self.bar[1..].iter().all(|r| r.gain_1_kg.abs() <= 0.0) && self.holder.is_none();
        let [k1, k2] = self.slope_n_m;
        let equal = (k1 - k2).abs() <= 1e-12 * k1.abs() && (self.overlap - 1.0).abs() <= 0.0;
        let plain = self.lag_s <= 0.0 && self.memory == ChipMemory::NONE;
        if !(alone && equal && plain && self.tools == ToolCount::Two) {
            return None;
        }
        let bar = self.bar[0];
        if bar.gain_1_kg <= 0.0 {
            return None;
        }
        // Referred to the tools: the bar's mass there is mass/shape^2.
        let mass_kg = 1.0 / bar.gain_1_kg;
        Some(TwoDelay {
            mass_kg,
            damping_n_s_m: 2.0 * bar.damping_ratio * bar.rad_s * mass_kg + 2.0 * self.damping_n_s_m,
            stiffness_n_m: mass_kg * bar.rad_s * bar.rad_s + 2.0 * self.contact_n_m,
            cutting_stiffness_n_m: k1,
            delay_1_s: self.delays_s[0],
            delay_2_s: self.delays_s[1],
        })
    }
}

/// Planes and second mode of the bar at the tools.
///
/// Two planes: c_a = 1 - r2 at the stated frequency, c_b = r2 at the other.
fn bar_of(terms: &CutTerms) -> [Resonance; 3] {
    let bar = terms.bar_at_tools();
    let whole = bar.shape * bar.shape / bar.mass_kg;
    let share = terms.other_plane_share();
    let other_hz = terms.second_plane.map_or(bar.frequency_hz, |p| p.frequency_hz + terms.frequency_shift_hz);
    let plane = |share: f64, hz: f64| Resonance {
        gain_1_kg: share * whole,
        rad_s: TAU * hz,
        damping_ratio: bar.damping_ratio,
    };
    let second =
        terms.second_mode.map_or(Resonance { gain_1_kg: 0.0, rad_s: 1.0, damping_ratio: 0.0 }, |m| {
            let rad_s = TAU * m.frequency_hz;
            Resonance {
                gain_1_kg: bar.straight_shape.powi(2) * rad_s * rad_s / m.stiffness_n_m,
                rad_s,
                damping_ratio: m.damping_ratio,
            }
        });
    [plane(1.0 - share, bar.frequency_hz), plane(share, other_hz), second]
}

/// One-sided spectrum of noise of unit variance that is white to a corner (first order), 1/Hz.
///
/// S(f) = (2/(pi f_c))/(1 + (f/f_c)^2);  f_c as stated: [`RANDOM_FORCE_CORNER_HZ`]
#[must_use]
pub fn random_force_spectrum_1_hz(frequency_hz: f64, corner_hz: f64) -> f64 {
    2.0 / (PI * corner_hz) / (1.0 + (frequency_hz / corner_hz).powi(2))
}
