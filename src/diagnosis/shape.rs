//! Hypotheses: each effect of the vocabulary as columns of the force balance.

use super::columns::{
    advanced_difference, backlash, coupling_law, difference, encoder_kernels, encoder_sides, lag, motor,
    smoothing, torsion, waves,
};
use super::motion::Motion;
use super::problem::{Column, Problem, Sides, stretch};
use crate::plant::effects::coupling::{Torsion, cubic};
use crate::plant::effects::friction::{
    Presliding, asymmetric, drift, nonlinear_viscosity, sliding_direction, stribeck,
};
use crate::plant::effects::periodic::{knots_at, wave};
use crate::plant::effects::{EffectKind, Port};
use std::f64::consts::TAU;

/// Frequency in Hz, share of the inertia and damping ratio that a torsional mode can have.
const TORSION: [[f64; 2]; 3] = [[100.0, 5000.0], [0.05, 0.95], [1e-4, 0.3]];
/// A time constant is known up to this many times the longest recording.
const WATCHED: f64 = 3.0;
/// Friction that has changed sooner than this was never seen otherwise.
const SOONEST_S: f64 = 0.3;
/// A Stribeck velocity is below this share of the highest speed.
const SPEEDS_RUN: f64 = 0.3;
/// Least speed of a Stribeck bump, in those over which dry friction turns: below, the two are one law, and
/// what a noisy velocity takes off the turn looks like a bump.
const SMOOTHINGS: f64 = 2.0;

/// The law of a hypothesis with its nonlinear constants; amplitudes are the regression's.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Shape {
    Coulomb,
    Viscous,
    Stribeck {
        velocity_m_s: f64,
    },
    Presliding {
        stiffness_n_m: f64,
    },
    Asymmetric,
    AsymmetricViscous,
    NonlinearViscosity,
    /// Of dry friction; `viscous`: of all friction.
    Drift {
        time_constant_s: f64,
        viscous: bool,
    },
    Constant,
    /// Sine and cosine in position; `flips`: times the direction.
    Periodic {
        wavelength_m: f64,
        harmonics: usize,
        flips: bool,
    },
    /// Free map over position.
    Map {
        first_m: f64,
        spacing_m: f64,
        knots: usize,
        flips: bool,
    },
    Saturation,
    Lag {
        extra_s: f64,
    },
    /// Positive: later than stated; negative: the stated delay is too long.
    Delay {
        extra_s: f64,
    },
    Backlash {
        gap_m: f64,
    },
    /// Coulomb friction turns its sign over another speed than stated: times this.
    Smoothing {
        ratio: f64,
    },
    Cubic,
    StiffnessSlope,
    Torsion {
        frequency_hz: f64,
        screw_share: f64,
        damping_ratio: f64,
    },
    EncoderError {
        period_m: f64,
        harmonics: usize,
    },
    /// A resonance driven by the acceleration of a side: y'' + 2 z w y' + w^2 y = -a.
    Resonance {
        frequency_hz: f64,
        damping_ratio: f64,
    },
    /// Free map over velocity; its knots stand evenly in asinh(v / 1 mm/s).
    VelocityMap {
        largest_m_s: f64,
        knots: usize,
    },
    PositionTimesVelocity,
    /// Harmonics of a line in a window of time, the same in each of some recordings (or with phases of their
    /// own).
    Lines {
        fundamental_hz: f64,
        harmonics: usize,
        window_s: [f64; 2],
        recordings: Vec<usize>,
        common: bool,
    },
}

/// Least speed over which a Stribeck bump falls off, m/s.
pub(super) fn least_stribeck_m_s(p: &Problem) -> f64 {
    SMOOTHINGS * p.mechanics.smoothing_m_s
}

impl Shape {
    /// Nonlinear constants, all positive.
    pub(crate) fn constants(&self) -> Vec<f64> {
        match self {
            Shape::Stribeck { velocity_m_s: x }
            | Shape::Presliding { stiffness_n_m: x }
            | Shape::Drift { time_constant_s: x, .. }
            | Shape::Lag { extra_s: x }
            | Shape::Backlash { gap_m: x }
            | Shape::Periodic { wavelength_m: x, .. }
            | Shape::Smoothing { ratio: x }
            | Shape::Lines { fundamental_hz: x, .. } => vec![*x],
            Shape::Delay { extra_s } => vec![extra_s.abs()],
            Shape::Torsion { frequency_hz, screw_share, damping_ratio } => {
                vec![*frequency_hz, *screw_share, *damping_ratio]
            }
            Shape::Resonance { frequency_hz, damping_ratio } => vec![*frequency_hz, *damping_ratio],
            _ => Vec::new(),
        }
    }

    /// The same law with other constants, held inside what the law allows.
    fn with_constants(&self, c: &[f64]) -> Self {
        let mut shape = self.clone();
        match &mut shape {
            Shape::Stribeck { velocity_m_s: x }
            | Shape::Presliding { stiffness_n_m: x }
            | Shape::Drift { time_constant_s: x, .. }
            | Shape::Lag { extra_s: x }
            | Shape::Backlash { gap_m: x }
            | Shape::Periodic { wavelength_m: x, .. }
            | Shape::Lines { fundamental_hz: x, .. } => *x = c[0],
            Shape::Smoothing { ratio } => *ratio = c[0].clamp(0.05, 20.0),
            Shape::Delay { extra_s } => *extra_s = c[0].copysign(*extra_s),
            Shape::Torsion { frequency_hz, screw_share, damping_ratio } => {
                *frequency_hz = c[0].clamp(TORSION[0][0], TORSION[0][1]);
                *screw_share = c[1].clamp(TORSION[1][0], TORSION[1][1]);
                *damping_ratio = c[2].clamp(TORSION[2][0], TORSION[2][1]);
            }
            Shape::Resonance { frequency_hz, damping_ratio } => {
                *frequency_hz = c[0].clamp(1.0, 5000.0);
                *damping_ratio = c[1].clamp(1e-4, 0.3);
            }
            _ => {}
        }
        shape
    }

    /// True where a constant ran into the end of what the law allows: another law imitated, not this one
    /// found.
    pub(crate) fn at_limit(&self) -> bool {
        matches!(self, Shape::Torsion { .. })
            && self
                .constants()
                .iter()
                .zip(TORSION)
                .any(|(c, [low, high])| !(1.001 * low..0.999 * high).contains(c))
    }

    /// Largest relative step of a constant in one iteration: as far as the law is nearly linear in it.
    pub(crate) fn trust(&self) -> f64 {
        match self {
            Shape::Periodic { .. } => 0.004,
            Shape::Lines { .. } => 0.0005,
            Shape::Resonance { .. } => 0.02,
            Shape::Torsion { .. } => 0.15,
            Shape::Stribeck { .. } | Shape::Presliding { .. } | Shape::Drift { .. } => 0.4,
            _ => 0.25,
        }
    }

    /// Relative step of the difference quotient.
    fn quotient_step(&self) -> f64 {
        match self {
            Shape::Periodic { .. } => 1e-4,
            Shape::Lines { .. } => 1e-5,
            _ => 0.01,
        }
    }

    /// True where the constants say everything and the amplitude is one.
    pub(crate) fn unit(&self) -> bool {
        matches!(
            self,
            Shape::Lag { .. }
                | Shape::Delay { .. }
                | Shape::Backlash { .. }
                | Shape::Torsion { .. }
                | Shape::Smoothing { .. }
        )
    }

    /// Start for the constants from a fit of the amplitude, where the two trade one for one.
    pub(crate) fn absorb(&self, amplitude: f64) -> Self {
        match self {
            Shape::Lag { .. } | Shape::Delay { .. } | Shape::Backlash { .. } => {
                self.with_constants(&[self.constants()[0] * amplitude.clamp(0.3, 3.0)])
            }
            _ => self.clone(),
        }
    }
}

/// A hypothesis.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Hypothesis {
    pub(crate) effect: EffectKind,
    pub(crate) port: Port,
    pub(crate) shape: Shape,
}

impl Hypothesis {
    /// True for a force for every place.
    pub(crate) fn is_map(&self) -> bool {
        matches!(self.shape, Shape::Map { .. })
    }

    /// A wave with its next overtone, and that overtone alone; `None`: no wave, or it has enough of them.
    pub(crate) fn overtone(&self) -> Option<(Self, Self)> {
        /// Harmonics that the vocabulary's waves have.
        const MOST: usize = 3;
        let (mut whole, mut alone) = (self.clone(), self.clone());
        match (&mut whole.shape, &mut alone.shape) {
            (
                Shape::Periodic { harmonics, .. },
                Shape::Periodic { wavelength_m: length_m, harmonics: one, .. },
            )
            | (
                Shape::EncoderError { harmonics, .. },
                Shape::EncoderError { period_m: length_m, harmonics: one, .. },
            ) if *harmonics < MOST => {
                *harmonics += 1;
                *length_m /= *harmonics as f64;
                *one = 1;
            }
            _ => return None,
        }
        Some((whole, alone))
    }

    pub(crate) fn new(effect: EffectKind, port: Port, shape: Shape) -> Self {
        Self { effect, port, shape }
    }

    /// The same physics with other constants, held inside what law and recordings allow: friction that
    /// settles more slowly than it is watched is a ramp, whatever its time constant, and one that falls over
    /// more than the speeds that were run is constant.
    pub(crate) fn with_constants(&self, p: &Problem, constants: &[f64]) -> Self {
        let mut shape = self.shape.with_constants(constants);
        match &mut shape {
            Shape::Drift { time_constant_s, .. } => {
                let longest_s = p.motions.iter().map(|m| m.len() as f64 / m.rate_hz).fold(0.0, f64::max);
                *time_constant_s = time_constant_s.min(WATCHED * longest_s).max(SOONEST_S);
            }
            Shape::Stribeck { velocity_m_s } => {
                *velocity_m_s = velocity_m_s.max(least_stribeck_m_s(p));
                let speeds = p.motions.iter().flat_map(|m| &self.side(m).velocity_m_s);
                let fastest_m_s = speeds.fold(0.0, |most: f64, v| most.max(v.abs()));
                *velocity_m_s = velocity_m_s.min(SPEEDS_RUN * fastest_m_s);
            }
            _ => {}
        }
        Self { shape, ..self.clone() }
    }

    /// The columns that the hypothesis adds to the balance.
    pub(crate) fn columns(&self, p: &Problem) -> Vec<Column> {
        let vs = p.mechanics.smoothing_m_s;
        match &self.shape {
            Shape::Coulomb => vec![self.of_velocity(p, |v| sliding_direction(v, vs))],
            Shape::Viscous => vec![self.of_velocity(p, |v| v)],
            Shape::Stribeck { velocity_m_s } => vec![self.of_velocity(p, |v| stribeck(v, *velocity_m_s, vs))],
            Shape::Presliding { stiffness_n_m } => vec![self.presliding(p, *stiffness_n_m)],
            Shape::Asymmetric => vec![self.of_velocity(p, |v| asymmetric(v, vs))],
            Shape::AsymmetricViscous => {
                vec![self.of_velocity(p, |v| asymmetric(v, vs)), self.of_velocity(p, |v| 0.5 * v.abs())]
            }
            Shape::NonlinearViscosity => vec![self.of_velocity(p, nonlinear_viscosity)],
            Shape::Drift { time_constant_s, viscous } => {
                let m = &p.mechanics;
                let (c, d) = if self.port == Port::Motor {
                    (m.motor_coulomb_n, m.motor_damping_n_s_m)
                } else {
                    (m.stage_coulomb_n, m.stage_damping_n_s_m)
                };
                let c = if c > 0.0 { c } else { m.motor_coulomb_n };
                let d = if *viscous { d } else { 0.0 };
                vec![self.force(p, |m| {
                    let v = &self.side(m).velocity_m_s;
                    (0..m.len())
                        .map(|k| {
                            (c * sliding_direction(v[k], vs) + d * v[k])
                                * drift(m.time_s(k) - m.start_s, *time_constant_s)
                        })
                        .collect()
                })]
            }
            Shape::Constant => vec![self.force(p, |m| vec![1.0; m.len()])],
            Shape::Periodic { wavelength_m, harmonics, flips } => {
                self.periodic(p, *wavelength_m, (*harmonics, *flips))
            }
            Shape::Map { first_m, spacing_m, knots, flips } => {
                self.map(p, (*first_m, *spacing_m, *knots), *flips)
            }
            Shape::Saturation => {
                vec![p.column(|m| {
                    motor(m.thrust_n.iter().map(|u| u * (u / m.thrust_per_unit).powi(2)).collect())
                })]
            }
            Shape::Lag { extra_s } => vec![lag(p, *extra_s)],
            Shape::Delay { extra_s } => vec![self.delay(p, *extra_s)],
            Shape::Backlash { gap_m } => vec![backlash(p, *gap_m)],
            Shape::Smoothing { ratio } => vec![smoothing(p, *ratio)],
            Shape::Cubic => vec![coupling_law(p, cubic)],
            Shape::StiffnessSlope => vec![p.coupling(|m| {
                let x = &m.stage.position_m;
                stretch(m).iter().zip(x).map(|(d, x)| p.mechanics.stiffness_n_m * d * x).collect()
            })],
            Shape::Torsion { frequency_hz, screw_share, damping_ratio } => {
                vec![torsion(p, *frequency_hz, *screw_share, *damping_ratio)]
            }
            Shape::EncoderError { period_m, harmonics } => self.encoder_error(p, *period_m, *harmonics),
            Shape::Resonance { frequency_hz, damping_ratio } => {
                vec![self.resonance(p, *frequency_hz, *damping_ratio)]
            }
            Shape::VelocityMap { largest_m_s, knots } => self.velocity_map(p, *largest_m_s, *knots),
            Shape::PositionTimesVelocity => vec![self.force(p, |m| {
                let side = self.side(m);
                side.position_m.iter().zip(&side.velocity_m_s).map(|(x, v)| x * v).collect()
            })],
            Shape::Lines { .. } => self.lines(p),
        }
    }

    /// Derivative of the force at given amplitudes with respect to the logarithm of each constant.
    pub(crate) fn tangents(&self, p: &Problem, columns: &[Column], amplitudes: &[f64]) -> Vec<Column> {
        let constants = self.shape.constants();
        let step = self.shape.quotient_step();
        (0..constants.len())
            .map(|i| {
                let mut moved = constants.clone();
                moved[i] *= 1.0 + step;
                let there =
                    Hypothesis { shape: self.shape.with_constants(&moved), ..self.clone() }.columns(p);
                let mut sum: Column = vec![Sides::default(); p.motions.len()];
                for ((a, b), amplitude) in there.iter().zip(columns).zip(amplitudes) {
                    super::bench::add(&mut sum, a, amplitude / step);
                    super::bench::add(&mut sum, b, -amplitude / step);
                }
                sum
            })
            .collect()
    }

    fn side<'a>(&self, m: &'a Motion) -> &'a super::motion::Side {
        if self.port == Port::Motor { &m.motor } else { &m.stage }
    }

    /// A force series at this port.
    fn force(&self, p: &Problem, f: impl Fn(&Motion) -> Vec<f64>) -> Column {
        let at_stage = self.port != Port::Motor;
        p.column(|m| {
            let x = f(m);
            if at_stage { Sides { motor: None, stage: Some(x) } } else { motor(x) }
        })
    }

    fn of_velocity(&self, p: &Problem, law: impl Fn(f64) -> f64) -> Column {
        self.force(p, |m| self.side(m).velocity_m_s.iter().map(|v| law(*v)).collect())
    }

    fn presliding(&self, p: &Problem, stiffness_n_m: f64) -> Column {
        let at_motor = self.port == Port::Motor;
        let coulomb_n =
            if at_motor { p.mechanics.motor_coulomb_n } else { p.mechanics.stage_coulomb_n }.max(1e-3);
        let law = Presliding { stiffness_n_m, coulomb_n };
        let vs = p.mechanics.smoothing_m_s;
        self.force(p, |m| {
            let side = self.side(m);
            // A recording begins at rest more often than where the filters have data.
            let mut force = side.before_m.windows(2).fold(0.0, |force, pair| {
                let dt = 1.0 / m.rate_hz;
                law.step(force, (pair[1] - pair[0]) / dt, dt)
            });
            side.velocity_m_s
                .iter()
                .map(|v| {
                    force = law.step(force, *v, 1.0 / m.rate_hz);
                    force - coulomb_n * sliding_direction(*v, vs)
                })
                .collect()
        })
    }

    /// Sine and cosine columns of each harmonic.
    fn periodic(&self, p: &Problem, wavelength_m: f64, (harmonics, flips): (usize, bool)) -> Vec<Column> {
        let vs = p.mechanics.smoothing_m_s;
        let at_stage = self.port != Port::Motor;
        let mut columns: Vec<Column> = vec![Vec::new(); 2 * harmonics];
        for m in &p.motions {
            let side = self.side(m);
            let mut parts = waves(&side.position_m, wavelength_m, harmonics);
            if flips {
                for part in &mut parts {
                    part.iter_mut()
                        .zip(&side.velocity_m_s)
                        .for_each(|(x, v)| *x *= sliding_direction(*v, vs));
                }
            }
            for (column, part) in columns.iter_mut().zip(&parts) {
                let thin = p.thinning.thin(part);
                column.push(if at_stage { Sides { motor: None, stage: Some(thin) } } else { motor(thin) });
            }
        }
        columns
    }

    /// One column per knot over position.
    fn map(&self, p: &Problem, (first, spacing, knots): (f64, f64, usize), flips: bool) -> Vec<Column> {
        let vs = p.mechanics.smoothing_m_s;
        let places = p.motions.iter().map(|m| {
            let side = self.side(m);
            let places = side.position_m.iter().zip(&side.velocity_m_s).map(|(x, v)| {
                let (first, parts) = knots_at(*x, first, spacing, knots);
                let sign = if flips { sliding_direction(*v, vs) } else { 1.0 };
                (first, parts.map(|part| sign * part))
            });
            places.collect()
        });
        self.of_table(p, &places.collect::<Vec<_>>(), knots)
    }

    /// One column per knot over velocity, close together where it is slow.
    fn velocity_map(&self, p: &Problem, largest_m_s: f64, knots: usize) -> Vec<Column> {
        let scale = 1e-3;
        let reach = (largest_m_s / scale).asinh();
        let spacing = 2.0 * reach / (knots - 1) as f64;
        let places = p.motions.iter().map(|m| {
            let speeds = self.side(m).velocity_m_s.iter();
            speeds.map(|v| knots_at((v / scale).asinh(), -reach, spacing, knots)).collect()
        });
        self.of_table(p, &places.collect::<Vec<_>>(), knots)
    }

    /// One column per knot: of each sample of each recording the knots that it has a part of.
    fn of_table(&self, p: &Problem, places: &[Vec<(usize, [f64; 4])>], knots: usize) -> Vec<Column> {
        // An error of the scale stretches the spring; of its mass and damper little is seen at these
        // wavelengths.
        let stretches = self.port == Port::StageEncoder;
        let unit = if stretches { p.mechanics.stiffness_n_m } else { 1.0 };
        let at = |index: usize, (first, parts): &(usize, [f64; 4])| {
            let part = index.checked_sub(*first).and_then(|k| parts.get(k));
            part.map_or(0.0, |part| unit * part)
        };
        let column = |index: usize| {
            let series = places.iter().map(|places| {
                let series: Vec<f64> = places.iter().map(|place| at(index, place)).collect();
                let thin = p.thinning.thin(&series);
                match self.port {
                    Port::Motor => motor(thin),
                    _ if stretches => {
                        Sides { stage: Some(thin.iter().map(|x| -x).collect()), motor: Some(thin) }
                    }
                    _ => Sides { motor: None, stage: Some(thin) },
                }
            });
            series.collect()
        };
        (0..knots).map(column).collect()
    }

    /// Unit gain: what an encoder reads too much is y; a force is y'' times one kilogram.
    fn resonance(&self, p: &Problem, frequency_hz: f64, damping_ratio: f64) -> Column {
        let w = TAU * frequency_hz;
        let mode = Torsion {
            screw_mass_kg: 1.0,
            torsional_stiffness_n_m: w * w,
            torsional_damping_n_s_m: 2.0 * damping_ratio * w,
            axial_stiffness_n_m: 0.0,
            axial_damping_n_s_m: 0.0,
        };
        p.column(|m| {
            let drive: Vec<f64> = self.side(m).accel_m_s2.iter().map(|a| -a).collect();
            let [y, y1, y2] = mode.response(&drive, 1.0 / m.rate_hz);
            match self.port {
                Port::StageEncoder => encoder_sides(p, Port::StageEncoder, &[y, y1, y2]),
                Port::Stage => Sides { motor: None, stage: Some(y2) },
                _ => motor(y2),
            }
        })
    }

    /// Extra delay at the current or an encoder: what the balance misses when it is not known.
    fn delay(&self, p: &Problem, extra_s: f64) -> Column {
        match self.port {
            Port::MotorEncoder => p.column(|m| {
                encoder_sides(p, Port::MotorEncoder, &advanced_difference(&m.motor, extra_s * m.rate_hz))
            }),
            Port::StageEncoder => p.column(|m| {
                encoder_sides(p, Port::StageEncoder, &advanced_difference(&m.stage, extra_s * m.rate_hz))
            }),
            _ => p.column(|m| motor(difference(&m.thrust_n, -extra_s * m.rate_hz))),
        }
    }

    /// An error e(x) of an encoder as the balance sees it: through all of its derivatives, sampled as
    /// recorded.
    fn encoder_error(&self, p: &Problem, period_m: f64, harmonics: usize) -> Vec<Column> {
        let at_motor = self.port == Port::MotorEncoder;
        let (near, far) = encoder_kernels(p, self.port);
        let mut columns: Vec<Column> = vec![Vec::new(); 2 * harmonics];
        for m in &p.motions {
            let raw = if at_motor { &m.motor.raw_m } else { &m.stage.raw_m };
            let grid = p.thinning.grid(m.len());
            for (column, e) in columns.iter_mut().zip(waves(raw, period_m, harmonics)) {
                let near_side = Some(near.apply(&e, grid));
                let far_side = Some(far.apply(&e, grid));
                column.push(if at_motor {
                    Sides { motor: near_side, stage: far_side }
                } else {
                    Sides { motor: far_side, stage: near_side }
                });
            }
        }
        columns
    }

    /// What an encoder reports too much, m, per recording.
    pub(crate) fn encoder_series(&self, p: &Problem, amplitudes: &[f64]) -> Vec<Vec<f64>> {
        let at_motor = self.port == Port::MotorEncoder;
        p.motions
            .iter()
            .map(|m| {
                let side = if at_motor { &m.motor } else { &m.stage };
                match &self.shape {
                    Shape::EncoderError { period_m, .. } => side
                        .raw_m
                        .iter()
                        .map(|x| {
                            amplitudes
                                .chunks_exact(2)
                                .enumerate()
                                .map(|(h, ab)| {
                                    let (s, c) = wave(*x, period_m / (h + 1) as f64);
                                    ab[0] * s + ab[1] * c
                                })
                                .sum()
                        })
                        .collect(),
                    Shape::Delay { extra_s } => difference(&side.position_m, extra_s * m.rate_hz),
                    _ => vec![0.0; m.len()],
                }
            })
            .collect()
    }

    /// Sine and cosine of each harmonic set by set, then the mean force of each set: a cut pushes one way.
    fn lines(&self, p: &Problem) -> Vec<Column> {
        let Shape::Lines { fundamental_hz, harmonics, window_s, recordings, common } = &self.shape else {
            return Vec::new();
        };
        let at_stage = self.port != Port::Motor;
        let sets = if *common { 1 } else { recordings.len() };
        let waves_of = 2 * harmonics;
        let mut out: Vec<Column> = vec![vec![Sides::default(); p.motions.len()]; (waves_of + 1) * sets];
        for (place, &recording) in recordings.iter().enumerate() {
            let m = &p.motions[recording];
            let turns: Vec<f64> = (0..m.len()).map(|k| m.time_s(k)).collect();
            let set = if *common { 0 } else { place };
            let mean = (waves_of * sets + set, vec![1.0; m.len()]);
            let waves = waves(&turns, 1.0 / fundamental_hz, *harmonics).into_iter().enumerate();
            for (column, mut wave) in waves.map(|(k, w)| (waves_of * set + k, w)).chain([mean]) {
                wave.iter_mut()
                    .zip(&turns)
                    .filter(|(_, t)| **t < window_s[0] || **t > window_s[1])
                    .for_each(|(x, _)| *x = 0.0);
                let thin = p.thinning.thin(&wave);
                out[column][recording] =
                    if at_stage { Sides { motor: None, stage: Some(thin) } } else { motor(thin) };
            }
        }
        out
    }
}
