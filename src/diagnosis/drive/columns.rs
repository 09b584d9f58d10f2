//! What each hypothesis adds to the balance, column by column.
//!
//! The balance is `thrust = model(beta)` at the motor and `0 = model(beta)` at the stage; a column is a force
//! that the model needs more. Laws that are not linear are taken at the full rate and then pass the low-pass
//! of the balance; none is a first Taylor term.

use super::number::{Mechanics, TURNING};
use super::shape::{CUT_HARMONICS, DIFFERENCE, Hypothesis, Over, Shape};
use super::signals::{Layout, Path, Signals, Track};
use super::spectra::{Response, Series};
use crate::plant::effects::Port;
use crate::plant::effects::coupling::{after_backlash, cubic};
use crate::plant::effects::friction::{
    Presliding, asymmetric, drift, nonlinear_viscosity, sliding_direction, stribeck,
};
use crate::plant::effects::law::ForceLaw;
use rustfft::num_complex::Complex;
use std::f64::consts::TAU;
use std::sync::Arc;

/// A response as a function of w, rad/s. `None` for what is no linear function of the positions.
pub(super) type Operator = Option<Arc<dyn Fn(f64) -> Response + Send + Sync>>;

/// (i w)^order.
pub(super) fn derivative(w: f64, order: i32) -> Complex<f64> {
    Complex::new(0.0, w).powi(order)
}

/// What laws are evaluated on.
#[derive(Clone, Copy)]
pub(super) struct Ground<'a> {
    pub(super) signals: &'a Signals,
    pub(super) mechanics: Mechanics,
    pub(super) smoothing_m_s: f64,
    pub(super) path: Path,
}

/// One column in time, thinned: at the motor, at the stage.
#[derive(Clone, Default)]
pub(super) struct TimeColumn {
    pub(super) sides: [Option<Series>; 2],
    /// What it makes of the positions.
    pub(super) operator: Operator,
}

impl TimeColumn {
    /// Columns times amplitudes, added.
    pub(super) fn sum<'a>(columns: impl Iterator<Item = (&'a TimeColumn, f64)>) -> Self {
        let mut out = Self::default();
        for (column, amplitude) in columns {
            let more = column.operator.clone();
            out.operator = match (out.operator.take(), more) {
                (Some(a), Some(b)) => Some(Arc::new(move |w| added(&a(w), amplitude, &b(w)))),
                (None, Some(b)) => Some(Arc::new(move |w| b(w).map(|r| amplitude * r))),
                (a, None) => a,
            };
            for (sum, side) in out.sides.iter_mut().zip(&column.sides) {
                let Some(side) = side else { continue };
                let sum = sum.get_or_insert_with(|| side.iter().map(|x| vec![0.0; x.len()]).collect());
                for (s, x) in sum.iter_mut().zip(side) {
                    s.iter_mut().zip(x).for_each(|(s, x)| *s += amplitude * x);
                }
            }
        }
        out
    }
}

/// Force of a spring by its stretch and the position.
type SpringLaw = Box<dyn Fn(f64, f64) -> f64>;

/// One response and another times a factor.
fn added(a: &Response, factor: f64, b: &Response) -> Response {
    std::array::from_fn(|k| a[k] + factor * b[k])
}

/// A law at the full rate of one recording, with its sign at motor and stage.
struct Full {
    series: Vec<f64>,
    signs: [f64; 2],
}

impl Ground<'_> {
    /// The columns of a hypothesis.
    pub(super) fn columns(&self, h: &Hypothesis) -> Vec<TimeColumn> {
        match h.shape {
            Shape::Cut { hz, start_s, end_s } => self.cut(hz, [start_s, end_s]),
            Shape::Mains { hz } => self.mains(hz),
            Shape::Push { recording, start_s, end_s, .. } => vec![self.push(recording, [start_s, end_s])],
            Shape::Map { pieces, flips, over } => self.map((pieces, flips), over),
            Shape::Torsion { frequency_hz, share, damping } => {
                vec![self.torsion(frequency_hz, share, damping)]
            }
            Shape::Delay { extra_s, early } => {
                let by = if early { -extra_s } else { extra_s };
                vec![self.path_change(Path { delay_s: self.path.delay_s + by, ..self.path })]
            }
            Shape::Loop { rad_s, in_place } => {
                vec![self.path_change(self.path.with_loop(rad_s, in_place))]
            }
            Shape::EncoderError { .. } | Shape::EncoderDelay { .. } => self.encoder(h),
            Shape::Smoothing { speed_m_s } => self.turning(speed_m_s),
            _ => self.forces(h),
        }
    }

    /// What the law is in the recording, one value per full-rate sample, for a contribution: a force at its
    /// port in N, or an error of its encoder in m. `None`: it has only thinned columns.
    pub(super) fn law(&self, h: &Hypothesis, track: &Track) -> Option<Vec<Vec<f64>>> {
        match h.shape {
            Shape::EncoderError { .. } | Shape::EncoderDelay { .. } => Some(self.encoder_errors(h, track)),
            _ => Some(self.full(h, track).into_iter().map(|f| f.series).collect())
                .filter(|l: &Vec<_>| !l.is_empty()),
        }
    }

    fn forces(&self, h: &Hypothesis) -> Vec<TimeColumn> {
        let mut out: Vec<TimeColumn> = Vec::new();
        for (r, track) in self.signals.tracks.iter().enumerate() {
            for (k, full) in self.full(h, track).into_iter().enumerate() {
                if r == 0 {
                    out.push(TimeColumn::default());
                }
                let thin = self.signals.filtered(track, &full.series, 0);
                for side in 0..2 {
                    if full.signs[side] != 0.0 {
                        let signed = thin.iter().map(|v| full.signs[side] * v).collect();
                        out[k].sides[side].get_or_insert_with(Vec::new).push(signed);
                    }
                }
            }
        }
        for (column, stiffness) in out.iter_mut().zip(self.mean_stiffness(h)) {
            column.operator =
                Some(Arc::new(move |_| [1.0, -1.0, -1.0, 1.0].map(|s| Complex::new(s * stiffness, 0.0))));
        }
        out
    }

    /// A force as a model states it.
    pub(super) fn stated(&self, law: &ForceLaw, port: Port) -> TimeColumn {
        let side = self.side(port);
        let of = |track: &Track| {
            let s = &track.sides[side];
            let force = s.x_m.iter().zip(&s.v_m_s).map(|(x, v)| law.force_n(*x, *v, self.smoothing_m_s));
            self.signals.filtered(track, &force.collect::<Vec<f64>>(), 0)
        };
        let mut out = TimeColumn::default();
        out.sides[side] = Some(self.signals.each(of));
        out
    }

    /// Signs of a force at a port: at motor and stage.
    fn signs(&self, port: Port) -> [f64; 2] {
        let two = self.signals.layout == Layout::TwoPositions;
        match port {
            Port::Coupling if two => [1.0, -1.0],
            Port::Stage if two => [0.0, 1.0],
            _ => [1.0, 0.0],
        }
    }

    /// Side whose position and velocity a force at a port is a law of.
    fn side(&self, port: Port) -> usize {
        usize::from(self.signals.layout == Layout::TwoPositions && port != Port::Motor)
    }

    fn full(&self, h: &Hypothesis, track: &Track) -> Vec<Full> {
        let signs = self.signs(h.port);
        let side = &track.sides[self.side(h.port)];
        let (x, v) = (&side.x_m, &side.v_m_s);
        let vs = self.smoothing_m_s;
        let one = |series: Vec<f64>| vec![Full { series, signs }];
        let of_v = |f: &dyn Fn(f64) -> f64| v.iter().map(|v| f(*v)).collect::<Vec<f64>>();
        let slide = |v: f64| sliding_direction(v, vs);
        match h.shape {
            Shape::Stribeck { speed_m_s } => one(of_v(&|v| stribeck(v, speed_m_s, vs))),
            Shape::Asymmetric => one(of_v(&|v| asymmetric(v, vs))),
            Shape::AsymmetricViscous => {
                [of_v(&|v| asymmetric(v, vs)), of_v(&|v| 0.5 * v.abs())].into_iter().flat_map(one).collect()
            }
            Shape::Gravity => one(vec![1.0; v.len()]),
            Shape::NonlinearViscosity => one(of_v(&nonlinear_viscosity)),
            Shape::Drift { tau_s } => {
                one(v.iter().enumerate().map(|(k, v)| drift(track.full_s(k), tau_s) * slide(*v)).collect())
            }
            Shape::Presliding { yield_m } => {
                bristle(v, yield_m, track.rate_hz).into_iter().flat_map(one).collect()
            }
            Shape::Wave { wavelength_m } => waves(x, wavelength_m).into_iter().flat_map(one).collect(),
            Shape::Saturation { per_a2, parabolic } => {
                let thrust = self.signals.thrust_full(track, self.path);
                let per_unit = track.reference.per_unit;
                let lost = |f: &f64| f * lost_share(per_a2 * (f / per_unit).powi(2), parabolic);
                one(thrust.iter().map(lost).collect())
            }
            Shape::Play { gap_m, yield_m } => one(play(x, gap_m, yield_m)),
            Shape::Backlash { gap_m, loose: true } => one(self.loose(track, gap_m)),
            Shape::Backlash { .. }
            | Shape::Gap { .. }
            | Shape::Cubic
            | Shape::StiffnessSlope
            | Shape::StiffnessWave { .. } => {
                let of = |law: SpringLaw| track.stretch_m.iter().zip(x).map(|(d, x)| law(*d, *x)).collect();
                self.springs(h).into_iter().map(of).flat_map(one).collect()
            }
            Shape::Cut { .. }
            | Shape::Mains { .. }
            | Shape::Push { .. }
            | Shape::Map { .. }
            | Shape::Torsion { .. }
            | Shape::Delay { .. }
            | Shape::Loop { .. }
            | Shape::Smoothing { .. }
            | Shape::EncoderError { .. }
            | Shape::EncoderDelay { .. } => Vec::new(),
        }
    }

    /// What spring and damper do not hold in a gap: a dry nut between its flanks has neither.
    fn loose(&self, track: &Track, gap_m: f64) -> Vec<f64> {
        let (k, zero) = (self.mechanics.stiffness_n_m, self.zero_m());
        let d = |i: usize| track.stretch_m[i.min(track.stretch_m.len() - 1)] + zero;
        let per_m = 0.5 * track.rate_hz * self.mechanics.structural_damping_n_s_m;
        (0..track.stretch_m.len())
            .map(|i| {
                let inside = d(i).abs() < 0.5 * gap_m;
                let damper = if inside { per_m * (d(i + 1) - d(i.saturating_sub(1))) } else { 0.0 };
                k * (after_backlash(d(i), gap_m) - d(i)) - damper
            })
            .collect()
    }

    /// Laws of the stretch d and the position.
    fn springs(&self, h: &Hypothesis) -> Vec<SpringLaw> {
        let (k, zero) = (self.mechanics.stiffness_n_m, self.zero_m());
        match h.shape {
            Shape::Backlash { gap_m, .. } => {
                vec![Box::new(move |d, _| k * (after_backlash(d + zero, gap_m) - (d + zero)))]
            }
            Shape::Gap { gap_m, flank_m } => {
                let least_m =
                    self.signals.tracks.iter().flat_map(|t| &t.stretch_m).copied().fold(0.0, f64::min);
                let middle_m = least_m + flank_m + 0.5 * gap_m;
                vec![Box::new(move |d, _| k * (after_backlash(d - middle_m, gap_m) - (d - middle_m)))]
            }
            Shape::Cubic => vec![Box::new(move |d, _| cubic(d + zero))],
            Shape::StiffnessSlope => vec![Box::new(move |d, x| k * (d + zero) * x)],
            Shape::StiffnessWave { length_m } => [f64::sin, f64::cos]
                .map(|f| Box::new(move |d, x| k * (d + zero) * f(TAU * x / length_m)) as SpringLaw)
                .into(),
            _ => Vec::new(),
        }
    }

    /// Mean stiffness of each law of the stretch over all recordings, N/m.
    fn mean_stiffness(&self, h: &Hypothesis) -> Vec<f64> {
        let pairs = || self.signals.tracks.iter().flat_map(|t| t.stretch_m.iter().zip(&t.sides[0].x_m));
        let looked = || pairs().step_by(self.signals.step);
        let (power, count) = looked().fold((0.0, 0.0), |(p, n), (d, _)| (p + d * d, n + 1.0));
        let by = (DIFFERENCE * (power / f64::max(count, 1.0)).sqrt()).max(f64::MIN_POSITIVE);
        let slope = |law: &SpringLaw| -> f64 {
            looked().map(|(d, x)| (law(d + by, *x) - law(d - by, *x)) / (2.0 * by)).sum::<f64>() / count
        };
        self.springs(h).iter().map(slope).collect()
    }

    /// True for a gap in which the spring is most of the time: then it is no spring, and its Jacobian none.
    pub(super) fn is_mostly_loose(&self, h: &Hypothesis) -> bool {
        matches!(h.shape, Shape::Backlash { .. })
            && self.mean_stiffness(h).iter().any(|loss| -loss > 0.5 * self.mechanics.stiffness_n_m)
    }

    /// Stretch of the spring at the mean of the recordings, m.
    fn zero_m(&self) -> f64 {
        self.mechanics.spring_zero_n / self.mechanics.stiffness_n_m.max(1e-300)
    }

    /// Unit dry friction of a side, thinned, or what one of its parts is more than the usual form: a part is
    /// in place of it, and the level of friction is one number.
    pub(super) fn dry(&self, track: &Track, side: usize, part: Option<usize>) -> Vec<f64> {
        let (v, v_s) = (&track.sides[side].v_m_s, self.smoothing_m_s);
        let mut slides: Vec<f64> = v.iter().map(|v| sliding_direction(*v, v_s)).collect();
        if let Some(part) = part {
            let other: Vec<f64> = match TURNING.get(part) {
                Some(form) => v.iter().map(|v| form(v / v_s)).collect(),
                None => play(&track.sides[side].x_m, 0.0, self.signals.least_way_m(side)),
            };
            slides.iter_mut().zip(other).for_each(|(s, o)| *s = o - *s);
        }
        self.signals.filtered(track, &slides, 0)
    }

    /// Dry friction of each side that turns over another speed: it takes the place of that of the numbers.
    fn turning(&self, speed_m_s: f64) -> Vec<TimeColumn> {
        let other = Self { smoothing_m_s: speed_m_s, ..*self };
        let of = |side: usize| {
            let mut column = TimeColumn::default();
            column.sides[side] = Some(self.signals.each(|track| other.dry(track, side, None)));
            column
        };
        (0..self.signals.sides()).map(of).collect()
    }

    /// What the model needs more where the current loop is slower by a factor.
    pub(super) fn lagging(&self, factor: f64) -> TimeColumn {
        self.path_change(Path { loop_rad_s: self.path.loop_rad_s.map(|w| factor * w), ..self.path })
    }

    fn path_change(&self, to: Path) -> TimeColumn {
        let of = |track: &Track| {
            let (now, then) = (self.signals.thrust(track, self.path), self.signals.thrust(track, to));
            now.iter().zip(&then).map(|(a, b)| a - b).collect::<Vec<f64>>()
        };
        TimeColumn { sides: [Some(self.signals.each(of)), None], operator: None }
    }

    /// What an encoder reads too much, m.
    fn encoder_errors(&self, h: &Hypothesis, track: &Track) -> Vec<Vec<f64>> {
        let two = self.signals.layout == Layout::TwoPositions;
        let x = &track.sides[usize::from(two && h.port == Port::StageEncoder)].x_m;
        match h.shape {
            Shape::EncoderError { period_m, sine_m, cosine_m } => {
                if sine_m == 0.0 && cosine_m == 0.0 {
                    return waves(x, period_m);
                }
                let first = waves(x, period_m);
                let error: Vec<f64> =
                    first[0].iter().zip(&first[1]).map(|(s, c)| sine_m * s + cosine_m * c).collect();
                let read = self.signals.low_passed(&error);
                waves(&x.iter().zip(&read).map(|(x, e)| x - e).collect::<Vec<f64>>(), period_m)
            }
            Shape::EncoderDelay { extra_s } => {
                let samples = extra_s * track.rate_hz;
                vec![x.iter().zip(later(x, samples)).map(|(now, then)| now - then).collect()]
            }
            _ => Vec::new(),
        }
    }

    /// An error of an encoder goes through everything that is made of its position.
    fn encoder(&self, h: &Hypothesis) -> Vec<TimeColumn> {
        let m = &self.mechanics;
        let two = self.signals.layout == Layout::TwoPositions;
        let at_stage = two && h.port == Port::StageEncoder;
        let spring = if self.signals.layout == Layout::OnePosition { 0.0 } else { m.stiffness_n_m };
        let damper = if two { m.structural_damping_n_s_m } else { 0.0 };
        let (mass, damping) = if at_stage || !two {
            (m.stage_mass_kg, m.stage_damping_n_s_m)
        } else {
            (m.motor_mass_kg, m.motor_damping_n_s_m)
        };
        let mut out: Vec<TimeColumn> = Vec::new();
        for (r, track) in self.signals.tracks.iter().enumerate() {
            for (k, e) in self.encoder_errors(h, track).iter().enumerate() {
                if r == 0 {
                    out.push(TimeColumn::default());
                }
                let [e0, e1, e2] = [0, 1, 2].map(|d| self.signals.filtered(track, e, d));
                let coupled: Vec<f64> = e0.iter().zip(&e1).map(|(e, d)| spring * e + damper * d).collect();
                let own: Vec<f64> = e1
                    .iter()
                    .zip(&e2)
                    .zip(&coupled)
                    .map(|((d, dd), c)| -(mass * dd + damping * d + c))
                    .collect();
                let [own_side, other] = if at_stage { [1, 0] } else { [0, 1] };
                out[k].sides[own_side].get_or_insert_with(Vec::new).push(own);
                if two {
                    out[k].sides[other].get_or_insert_with(Vec::new).push(coupled);
                }
            }
        }
        if let (Shape::EncoderDelay { extra_s }, [column]) = (h.shape, &mut out[..]) {
            column.operator = Some(Arc::new(move |w| {
                let read = 1.0 - Complex::from_polar(1.0, w * extra_s);
                let coupled = read * Complex::new(spring, w * damper);
                let own = read * Complex::new(mass * w * w, -w * damping) - coupled;
                let none = Complex::new(0.0, 0.0);
                if at_stage { [none, coupled, none, own] } else { [own, none, coupled, none] }
            }));
        }
        out
    }

    /// Harmonics and mean in a window; every recording has columns of its own.
    fn cut(&self, hz: f64, window_s: [f64; 2]) -> Vec<TimeColumn> {
        let side = usize::from(self.signals.sides() == 2);
        let empty = self.signals.each(|t| vec![0.0; t.thin_count()]);
        let mut out = Vec::new();
        for (r, track) in self.signals.tracks.iter().enumerate() {
            let inside = |j: usize| {
                let t = track.thin_s(j, self.signals.step);
                (t >= window_s[0] && t < window_s[1]).then_some(t)
            };
            if !(0..track.thin_count()).any(|j| inside(j).is_some()) {
                continue;
            }
            let mut push = |f: &dyn Fn(f64) -> f64| {
                let mut series = empty.clone();
                series[r].iter_mut().enumerate().for_each(|(j, v)| *v = inside(j).map_or(0.0, f));
                let mut column = TimeColumn::default();
                column.sides[side] = Some(series);
                out.push(column);
            };
            let heard = (self.signals.top_hz() / hz) as usize;
            for h in 1..=CUT_HARMONICS.min(heard.max(1)) {
                let w = TAU * hz * h as f64;
                push(&|t| (w * t).sin());
                push(&|t| (w * t).cos());
            }
            push(&|_| 1.0);
        }
        out
    }

    /// Sine and cosine of a line in the recorded force, of every recording its own.
    fn mains(&self, hz: f64) -> Vec<TimeColumn> {
        let tracks = &self.signals.tracks;
        let of = |own: usize, f: fn(f64) -> f64| {
            let series = |(r, t): (usize, &Track)| {
                let at = |j| if r == own { f(TAU * hz * t.thin_s(j, self.signals.step)) } else { 0.0 };
                (0..t.thin_count()).map(at).collect()
            };
            let series = tracks.iter().enumerate().map(series).collect();
            TimeColumn { sides: [Some(series), None], operator: None }
        };
        (0..tracks.len()).flat_map(|r| [of(r, f64::sin), of(r, f64::cos)]).collect()
    }

    /// One in a window of one recording, at the stage.
    fn push(&self, recording: usize, window_s: [f64; 2]) -> TimeColumn {
        let side = usize::from(self.signals.sides() == 2);
        let mut series = self.signals.each(|t| vec![0.0; t.thin_count()]);
        let track = &self.signals.tracks[recording];
        for (j, v) in series[recording].iter_mut().enumerate() {
            let t = track.thin_s(j, self.signals.step);
            *v = f64::from(u8::from(t >= window_s[0] && t < window_s[1]));
        }
        let mut column = TimeColumn::default();
        column.sides[side] = Some(series);
        column
    }

    /// Splines over the travel.
    fn map(&self, (pieces, flips): (usize, bool), over: Over) -> Vec<TimeColumn> {
        let side = usize::from(self.signals.sides() == 2);
        let abscissa = self.signals.each(|t| match over {
            Over::Position => t.thin.position.clone(),
            Over::Speed => t.thin.velocity[side].iter().map(|v| v.abs()).collect(),
            Over::Way => since_reversal(&t.thin.position),
        });
        let ends = |e: [f64; 2], v: &f64| [e[0].min(*v), e[1].max(*v)];
        let [low, high] = abscissa.iter().flatten().fold([f64::INFINITY, f64::NEG_INFINITY], ends);
        let spacing = (high - low).max(1e-300) / pieces as f64;
        // The direction as the friction of the balance has it; a spline is slow beside it.
        let direction = self
            .signals
            .each(|track| if flips { self.dry(track, side, None) } else { vec![1.0; track.thin_count()] });
        (0..pieces + 3)
            .map(|k| {
                let of = |(x, direction): (&Vec<f64>, &Vec<f64>)| {
                    let place = |x: &f64| (x - low) / spacing - k as f64 + 3.0;
                    x.iter().zip(direction).map(|(x, d)| spline(place(x)) * d).collect()
                };
                let mut column = TimeColumn::default();
                column.sides[side] = Some(abscissa.iter().zip(&direction).map(of).collect());
                column
            })
            .collect()
    }
}

/// Way since the axis last turned round, by more than a thousandth of its travel.
fn since_reversal(x: &[f64]) -> Vec<f64> {
    const TURNED: f64 = 1e-3;
    let [low, high] = x.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |e, v| [e[0].min(*v), e[1].max(*v)]);
    let turned = TURNED * (high - low);
    let (mut from, mut end, mut sign) = (x.first().copied().unwrap_or(0.0), 0.0, 0.0_f64);
    let mut out = Vec::with_capacity(x.len());
    for v in x {
        let way = v - from;
        if sign == 0.0 && way.abs() > turned {
            (sign, end) = (way.signum(), *v);
        }
        if sign != 0.0 {
            if sign * (v - end) > 0.0 {
                end = *v;
            } else if sign * (end - v) > turned {
                (from, end, sign) = (end, *v, -sign);
            }
        }
        out.push((v - from).abs());
    }
    out
}

/// Share of its torque that a saturated motor loses; `bent`: b i^2.
fn lost_share(bent: f64, parabolic: f64) -> f64 {
    bent / (1.0 + (1.0 - parabolic) * bent)
}

/// Uniform cubic B-spline on [0, 4].
pub(super) fn spline(t: f64) -> f64 {
    match t {
        t if (0.0..1.0).contains(&t) => t * t * t / 6.0,
        t if (1.0..2.0).contains(&t) => {
            let u = t - 1.0;
            (1.0 + 3.0 * u + 3.0 * u * u - 3.0 * u * u * u) / 6.0
        }
        t if (2.0..3.0).contains(&t) => {
            let u = t - 2.0;
            (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0
        }
        t if (3.0..4.0).contains(&t) => (4.0 - t).powi(3) / 6.0,
        _ => 0.0,
    }
}

/// Dahl's bristle of unit force, and its rate times a second of the speed at which it is half yielded.
fn bristle(v: &[f64], yield_m: f64, rate_hz: f64) -> Vec<Vec<f64>> {
    let law = Presliding { stiffness_n_m: 1.0 / yield_m, coulomb_n: 1.0 };
    let dt = 1.0 / rate_hz;
    let (mut z, mut last, mut out) = (0.0, 0.0, Vec::with_capacity(v.len()));
    for v in v {
        // The speed between two samples: that at either end would make it half a sample early or late.
        z = law.step(z, 0.5 * (last + v), dt);
        last = *v;
        out.push(z);
    }
    let rate = out.iter().enumerate().map(|(k, z)| (z - out[k.saturating_sub(1)]) * rate_hz * 1e-3).collect();
    vec![out, rate]
}

/// Force of a slider of unit friction behind a spring with play: the way between axis and slider is lost in
/// the gap, then in the spring, then the slider gives.
fn play(x: &[f64], gap_m: f64, yield_m: f64) -> Vec<f64> {
    let most = 0.5 * gap_m + yield_m;
    let (mut between, mut last) = (0.0_f64, x.first().copied().unwrap_or(0.0));
    let mut of = |x: &f64| {
        between = (between + x - last).clamp(-most, most);
        last = *x;
        after_backlash(between, gap_m) / yield_m
    };
    x.iter().map(&mut of).collect()
}

/// Sine and cosine of one and two turns per wavelength.
fn waves(x: &[f64], wavelength_m: f64) -> Vec<Vec<f64>> {
    let mut out: Vec<Vec<f64>> = (0..4).map(|_| Vec::with_capacity(x.len())).collect();
    for x in x {
        let (s, c) = (TAU * (x / wavelength_m).fract()).sin_cos();
        out[0].push(s);
        out[1].push(c);
        out[2].push(2.0 * s * c);
        out[3].push(c * c - s * s);
    }
    out
}

/// The series that many samples later, by cubic interpolation.
fn later(x: &[f64], samples: f64) -> Vec<f64> {
    let whole = samples.floor();
    let t = samples - whole;
    let weights = [
        -t * (t - 1.0) * (t - 2.0) / 6.0,
        (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0,
        -(t + 1.0) * t * (t - 2.0) / 2.0,
        (t + 1.0) * t * (t - 1.0) / 6.0,
    ];
    let at = |k: usize, j: usize| x[(k + whole as usize + j).saturating_sub(1).min(x.len() - 1)];
    (0..x.len()).map(|k| (0..4).map(|j| weights[j] * at(k, j)).sum()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splines_add_to_one_and_a_shift_is_exact_for_cubics() {
        for k in 0..100 {
            let t = 3.0 + 0.01 * f64::from(k);
            let sum: f64 = (0..7).map(|j| spline(t - f64::from(j))).sum();
            assert!((sum - 1.0).abs() < 1e-12, "{t} {sum}");
        }
        let x: Vec<f64> = (0..50).map(|k| (0.1 * f64::from(k)).powi(3)).collect();
        let y = later(&x, 2.3);
        assert!((y[10] - 1.23_f64.powi(3)).abs() < 1e-12);
    }
}
