//! Forces and encoder errors that few models have, as lanes: what a model lacks is zero in its lane.

use super::constants::{Constants, Lane};
use crate::plant::effects::law::ForceLaw;
use crate::signal::dispatch::multiply_add;
use crate::signal::exponential::exp;
use crate::signal::sine::sine_cosine;

/// exp of less than this is none.
const LEAST_EXPONENT: f64 = -700.0;

/// Harmonics over position.
#[derive(Debug, Clone)]
pub(super) struct Waves<const L: usize> {
    per_m: Lane<L>,
    /// 1 where the force turns with the direction.
    flips: Lane<L>,
    /// Sine and cosine amplitude of each harmonic.
    harmonics: Vec<[Lane<L>; 2]>,
}

impl<const L: usize> Waves<L> {
    /// The waves of one lane put in their place among `all`.
    fn put(all: &mut Vec<Self>, (place, l): (usize, usize), (length_m, harmonics): (f64, &[[f64; 2]])) {
        if all.len() <= place {
            all.push(Self { per_m: [0.0; L], flips: [0.0; L], harmonics: Vec::new() });
        }
        let waves = &mut all[place];
        waves.per_m[l] = 1.0 / length_m;
        let most = waves.harmonics.len().max(harmonics.len());
        waves.harmonics.resize(most, [[0.0; L]; 2]);
        for (lanes, [sine, cosine]) in waves.harmonics.iter_mut().zip(harmonics) {
            (lanes[0][l], lanes[1][l]) = (*sine, *cosine);
        }
    }

    /// Errors of an encoder of each model.
    pub(super) fn of_encoder(models: &[Constants; L], encoder: usize) -> Vec<Self> {
        let mut all = Vec::new();
        for (l, model) in models.iter().enumerate() {
            for (place, error) in model.errors[encoder].iter().enumerate() {
                Self::put(&mut all, (place, l), error.wave());
            }
        }
        all
    }

    #[inline(always)]
    pub(super) fn at<const FUSED: bool>(&self, x_m: &Lane<L>) -> Lane<L> {
        let mut base = [[0.0; L]; 2];
        for l in 0..L {
            let [sine, cosine] = sine_cosine::<FUSED>(x_m[l] * self.per_m[l]);
            (base[0][l], base[1][l]) = (sine, cosine);
        }
        let mut turned = base;
        let mut sum = [0.0; L];
        for (k, [sine, cosine]) in self.harmonics.iter().enumerate() {
            for l in 0..L {
                if k > 0 {
                    // One more turn: sin(a + b), cos(a + b).
                    let (s, c) = (turned[0][l], turned[1][l]);
                    turned[0][l] = multiply_add::<FUSED>(s, base[1][l], c * base[0][l]);
                    turned[1][l] = multiply_add::<FUSED>(c, base[1][l], -(s * base[0][l]));
                }
                let more = multiply_add::<FUSED>(cosine[l], turned[1][l], sum[l]);
                sum[l] = multiply_add::<FUSED>(sine[l], turned[0][l], more);
            }
        }
        sum
    }
}

/// A share of a force that is not there at low speed, or not from the start on.
type Fading<const L: usize> = [Lane<L>; 2];

/// Forces against the motion of one side.
#[derive(Debug, Clone)]
pub(super) struct Further<const L: usize> {
    constant_n: Lane<L>,
    /// Times the direction of sliding, its size, the speed, and the speed by its size.
    sliding_n: Lane<L>,
    tilt_n: Lane<L>,
    speed_n_s_m: Lane<L>,
    square_n_s2_m2: Lane<L>,
    viscous_n_s_m: Lane<L>,
    waves: Vec<Waves<L>>,
    /// Force and one over the velocity of Stribeck's bump.
    bumps: Vec<Fading<L>>,
    /// Change of dry friction and one over its time constant.
    warming: Vec<Fading<L>>,
    /// Change of viscous friction, beside each of those.
    warming_n_s_m: Vec<Lane<L>>,
    /// Tables, each of one lane.
    maps: Vec<(usize, ForceLaw)>,
}

impl<const L: usize> Further<L> {
    /// `None`: no model has any at this side.
    pub(super) fn of(models: &[Constants; L], side: usize) -> Option<Self> {
        let has = |m: &Constants| !(m.forces[side].is_empty() && m.warming[side].is_empty());
        models.iter().any(has).then(|| {
            let zero = [0.0; L];
            let mut all = Self {
                constant_n: zero,
                sliding_n: zero,
                tilt_n: zero,
                speed_n_s_m: zero,
                square_n_s2_m2: zero,
                viscous_n_s_m: zero,
                waves: Vec::new(),
                bumps: Vec::new(),
                warming: Vec::new(),
                warming_n_s_m: Vec::new(),
                maps: Vec::new(),
            };
            for (l, model) in models.iter().enumerate() {
                all.put(l, model, side);
            }
            all
        })
    }

    fn put(&mut self, l: usize, model: &Constants, side: usize) {
        let (mut waves, mut bumps) = (0, 0);
        for law in &model.forces[side] {
            match law {
                ForceLaw::Coulomb { force_n } => self.sliding_n[l] += force_n,
                ForceLaw::Viscous { n_s_m } => self.viscous_n_s_m[l] += n_s_m,
                ForceLaw::Stribeck { force_n, velocity_m_s } => {
                    place(&mut self.bumps, (bumps, l), [*force_n, 1.0 / velocity_m_s]);
                    bumps += 1;
                }
                ForceLaw::Asymmetric { difference_n, viscous_n_s_m } => {
                    self.tilt_n[l] += 0.5 * difference_n;
                    self.speed_n_s_m[l] += 0.5 * viscous_n_s_m;
                }
                ForceLaw::NonlinearViscosity { n_s2_m2 } => self.square_n_s2_m2[l] += n_s2_m2,
                ForceLaw::Constant { force_n } => self.constant_n[l] += force_n,
                ForceLaw::Periodic { wavelength_m, harmonics_n, flips } => {
                    Waves::put(&mut self.waves, (waves, l), (*wavelength_m, harmonics_n));
                    self.waves[waves].flips[l] = f64::from(u8::from(*flips));
                    waves += 1;
                }
                ForceLaw::Map { .. } => self.maps.push((l, law.clone())),
            }
        }
        for (k, w) in model.warming[side].iter().enumerate() {
            place(&mut self.warming, (k, l), [w.change_n, 1.0 / w.time_constant_s]);
            self.warming_n_s_m.resize(self.warming.len(), [0.0; L]);
            self.warming_n_s_m[k][l] = w.change_n_s_m;
        }
    }

    /// The force at a time, position, velocity and direction of sliding, N.
    #[inline(always)]
    pub(super) fn force_n<const FUSED: bool>(
        &self,
        t_s: f64,
        (x, v): (&Lane<L>, &Lane<L>),
        sliding: &Lane<L>,
    ) -> Lane<L> {
        let mut sum = self.constant_n;
        let mut friction = self.sliding_n;
        for [force, per_m_s] in &self.bumps {
            for l in 0..L {
                let speed = v[l] * per_m_s[l];
                friction[l] += force[l] * exp::<FUSED>((-speed * speed).max(LEAST_EXPONENT));
            }
        }
        for ([change, per_s], change_n_s_m) in self.warming.iter().zip(&self.warming_n_s_m) {
            for l in 0..L {
                let warm = 1.0 - exp::<FUSED>((-t_s * per_s[l]).max(LEAST_EXPONENT));
                friction[l] += change[l] * warm;
                sum[l] += change_n_s_m[l] * warm * v[l];
            }
        }
        for waves in &self.waves {
            let force = waves.at::<FUSED>(x);
            for l in 0..L {
                friction[l] += waves.flips[l] * force[l];
                sum[l] += (1.0 - waves.flips[l]) * force[l];
            }
        }
        for l in 0..L {
            let speed = v[l].abs();
            let drag = self.viscous_n_s_m[l] + self.square_n_s2_m2[l] * speed;
            sum[l] += drag * v[l] + self.speed_n_s_m[l] * speed;
            sum[l] += friction[l] * sliding[l] + self.tilt_n[l] * sliding[l].abs();
        }
        for (l, map) in &self.maps {
            sum[*l] += map.force_n(x[*l], v[*l], 1.0);
        }
        sum
    }
}

/// Two constants of one lane put in their place.
fn place<const L: usize>(all: &mut Vec<Fading<L>>, (at, l): (usize, usize), constants: [f64; 2]) {
    if all.len() <= at {
        all.push([[0.0; L]; 2]);
    }
    (all[at][0][l], all[at][1][l]) = (constants[0], constants[1]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::drive::{DriveParams, RawDriveParams};
    use crate::plant::machine::AxisModel;

    /// Each law of the vocabulary says the same alone and among lanes.
    #[test]
    fn lanes_say_what_the_laws_say() {
        let periodic = |flips| ForceLaw::Periodic {
            wavelength_m: 0.0047,
            harmonics_n: vec![[3.0, -1.0], [0.5, 0.2], [-0.1, 0.3]],
            flips,
        };
        let laws = [
            ForceLaw::Coulomb { force_n: 7.0 },
            ForceLaw::Viscous { n_s_m: 90.0 },
            ForceLaw::Stribeck { force_n: -4.0, velocity_m_s: 3e-3 },
            ForceLaw::Asymmetric { difference_n: 5.0, viscous_n_s_m: 20.0 },
            ForceLaw::NonlinearViscosity { n_s2_m2: 400.0 },
            ForceLaw::Constant { force_n: -2.5 },
            periodic(false),
            periodic(true),
            ForceLaw::Map { first_m: 0.0, spacing_m: 0.01, force_n: vec![1.0, 4.0, -2.0] },
        ];
        let raw = RawDriveParams { movable_mass_kg: Some(100.0), ..Default::default() };
        let drive = DriveParams::new(raw).expect("a drive");
        let axis = AxisModel { name: "x".to_owned(), drive, controller: None, physics: Vec::new() };
        let bare = Constants::of(&axis, None);
        let smoothing_m_s: f64 = 2e-4;
        for law in &laws {
            for other in &laws {
                let mut models: [Constants; 2] = [bare.clone(), bare.clone()];
                models[0].forces[1] = vec![law.clone(), other.clone()];
                models[1].forces[1] = vec![other.clone()];
                let lanes = Further::of(&models, 1).expect("laws");
                for (x, v) in [(0.0131, 2.3e-3), (-0.4, -1e-5), (0.0061, -0.31)] {
                    let sliding = [(v / smoothing_m_s).tanh(); 2];
                    let told = lanes.force_n::<false>(0.0, (&[x; 2], &[v; 2]), &sliding);
                    let of = |m: &Constants| -> f64 {
                        m.forces[1].iter().map(|law| law.force_n(x, v, smoothing_m_s)).sum()
                    };
                    for (told, model) in told.iter().zip(&models) {
                        assert!((told - of(model)).abs() < 1e-11, "{law:?} {other:?}: {told}");
                    }
                }
            }
        }
    }
}
