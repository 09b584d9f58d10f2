//! The stage of an axis whose motor alone is measured, as the stated screw moves it.
//!
//! ```text
//! M a_t = K (x_m - x_t) + C (v_m - v_t) - D v_t - F tanh(v_t / v_s)
//! ```
//! Friction of the stage turns when the stage turns: after a reversal of the motor the screw unwinds first,
//! 2 F / K of the way, and then the stage swings. Taken at the motor's speed that friction is early at each
//! reversal. Where the axis began is not known: the screw is taken as wound by what moves it then.

use super::reads::Side;
use crate::plant::drive::DriveParams;
use crate::plant::effects::coulomb_friction::sliding_direction;

/// A stage on its screw, by unit mass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Following {
    swing_rad2_s2: f64,
    damper_1_s: f64,
    drag_1_s: f64,
    dry_m_s2: f64,
}

impl Following {
    /// As stated. `None`: the model does not say what mass, spring, damper and dry friction are at the end of
    /// the screw, or the stage swings by more than a radian from sample to sample.
    pub(super) fn stated(d: &DriveParams, rate_hz: f64) -> Option<Self> {
        let of = [
            d.axial_stiffness_n_m(),
            d.structural_damping_n_s_m(),
            d.translational_damping_n_s_m(),
            d.stage_coulomb_friction_n(),
        ];
        let [swing_rad2_s2, damper_1_s, drag_1_s, dry_m_s2] = of.map(|x| x / d.movable_mass_kg());
        let is_whole = [swing_rad2_s2, damper_1_s, dry_m_s2].iter().all(|x| x.is_finite() && *x > 0.0);
        let is_shown = swing_rad2_s2.sqrt() < rate_hz && drag_1_s.is_finite();
        (is_whole && is_shown).then_some(Self { swing_rad2_s2, damper_1_s, drag_1_s, dry_m_s2 })
    }

    /// The stage behind a motor, at first as fast as that and wound as at a constant speed; friction turns
    /// over `smoothing_m_s`.
    ///
    /// In a sample half of the way, the speed, the other half; dampers, and friction by its slope, are taken
    /// implicitly, for friction that turns is the stiffest of all.
    /// Checked by: tests.
    pub(super) fn behind(&self, motor: &Side, rate_hz: f64, smoothing_m_s: f64) -> Side {
        let h = 1.0 / rate_hz;
        let pairs = motor.x_m.iter().zip(&motor.v_m_s);
        let (mut x, mut v) = pairs.clone().next().map_or((0.0, 0.0), |(x, v)| {
            let pull = self.drag_1_s * v + self.dry_m_s2 * sliding_direction(*v, smoothing_m_s);
            (x - pull / self.swing_rad2_s2, *v)
        });
        let mut out = Side::default();
        let next = pairs.clone().skip(1).chain(pairs.clone().next_back());
        for ((x0, v0), (x1, v1)) in pairs.zip(next) {
            out.x_m.push(x);
            out.v_m_s.push(v);
            let (x_m, v_m) = (0.5 * (x0 + x1), 0.5 * (v0 + v1));
            x += 0.5 * h * v;
            let slides = sliding_direction(v, smoothing_m_s);
            let pull = self.swing_rad2_s2 * (x_m - x) + self.damper_1_s * (v_m - v)
                - self.drag_1_s * v
                - self.dry_m_s2 * slides;
            let turning_1_s = self.dry_m_s2 / smoothing_m_s * (1.0 - slides * slides);
            v += h * pull / (1.0 + h * (self.damper_1_s + self.drag_1_s + turning_1_s));
            x += 0.5 * h * v;
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STAGE: Following =
        Following { swing_rad2_s2: 4e5, damper_1_s: 60.0, drag_1_s: 5.0, dry_m_s2: 10.0 };

    const SMOOTHING_M_S: f64 = 1e-4;

    fn motor(seconds: f64, rate: f64, x: impl Fn(f64) -> f64, v: impl Fn(f64) -> f64) -> Side {
        let t = || (0..(seconds * rate) as usize).map(|k| k as f64 / rate);
        Side { x_m: t().map(&x).collect(), v_m_s: t().map(v).collect() }
    }

    #[test]
    fn the_screw_winds_by_what_the_stage_needs() {
        let (rate, a) = (4000.0, 2.0);
        let stage = STAGE.behind(&motor(1.0, rate, |t| 0.5 * a * t * t, |t| a * t), rate, SMOOTHING_M_S);
        let k = 3999;
        let (x_m, v_m) = (0.5 * a * (k as f64 / rate).powi(2), a * k as f64 / rate);
        // M a, D v and F, the stage as fast as the motor but for the rate at which the wind grows.
        let rate_of_wind = STAGE.drag_1_s * a / STAGE.swing_rad2_s2;
        let pull = a + STAGE.drag_1_s * (v_m - rate_of_wind) + STAGE.dry_m_s2;
        let wound_m = (pull - STAGE.damper_1_s * rate_of_wind) / STAGE.swing_rad2_s2;
        assert!(((x_m - stage.x_m[k]) / wound_m - 1.0).abs() < 0.01, "{} {wound_m}", x_m - stage.x_m[k]);
    }

    #[test]
    fn after_a_reversal_the_stage_stays_until_the_screw_is_wound_the_other_way() {
        let (rate, speed) = (4000.0, 1e-3);
        let v = |t: f64| if t < 0.5 { speed } else { -speed };
        let stage =
            STAGE.behind(&motor(1.0, rate, |t| speed * (0.5 - (t - 0.5).abs()), v), rate, SMOOTHING_M_S);
        let turned = stage.v_m_s.iter().skip(2010).position(|v| *v < -0.5 * speed).expect("it turns");
        // At the beginning it is wound already.
        assert!(stage.v_m_s.iter().take(1990).all(|v| (v / speed - 1.0).abs() < 0.05));
        let way_m = (turned + 10) as f64 / rate * speed;
        let wind_m = 2.0 * STAGE.dry_m_s2 / STAGE.swing_rad2_s2;
        assert!((way_m / wind_m - 1.0).abs() < 0.1, "{way_m} of {wind_m}");
    }
}
