//! What each hypothesis adds to the balance, column by column.
//!
//! The balance is `thrust = model(beta)` at the motor and `0 = model(beta)` at the stage; a column is a force
//! that the model needs more. Laws that are not linear are taken at the full rate and then pass the low-pass
//! of the balance; none is a first Taylor term.

use super::number::{Mechanics, TURNING};
use super::signals::{Layout, Path, Signals, Track, difference};
use super::sliding::{Follows, class_slopes};
use super::spectra::{Point, Response, Series};
use crate::plant::effects::Port;
use crate::plant::effects::backlash::play;
use crate::plant::effects::coulomb_friction::sliding_direction;
use crate::plant::effects::law::ForceLaw;
use crate::signal::inner_products::dot;
use rustfft::num_complex::Complex;
use std::sync::Arc;

/// A relative step over which a law is differentiated by a constant.
pub(super) const DIFFERENCE: f64 = 1e-3;

/// A response at a frequency, with the slopes of friction in its class. `None` for what is no function of the
/// positions.
pub(super) type Operator = Option<Arc<dyn Fn(&Point) -> Response + Send + Sync>>;

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
    /// One at one side.
    pub(super) fn at(side: usize, series: Series) -> Self {
        let mut out = Self::default();
        out.sides[side] = Some(series);
        out
    }

    /// Mean square, both sides together.
    pub(super) fn power(&self) -> f64 {
        let mean = |side: &Series| {
            let rows: usize = side.iter().map(Vec::len).sum();
            side.iter().map(|x| dot(x, x)).sum::<f64>() / rows.max(1) as f64
        };
        self.sides.iter().flatten().map(mean).sum()
    }

    /// Columns times amplitudes, added.
    pub(super) fn sum<'a>(columns: impl Iterator<Item = (&'a TimeColumn, f64)>) -> Self {
        let mut out = Self::default();
        for (column, amplitude) in columns {
            let more = column.operator.clone();
            out.operator = match (out.operator.take(), more) {
                (Some(a), Some(b)) => Some(Arc::new(move |p| added(&a(p), amplitude, &b(p)))),
                (None, Some(b)) => Some(Arc::new(move |p| b(p).map(|r| amplitude * r))),
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
pub(super) type SpringLaw = Box<dyn Fn(f64, f64) -> f64>;

/// One response and another times a factor.
fn added(a: &Response, factor: f64, b: &Response) -> Response {
    std::array::from_fn(|k| a[k] + factor * b[k])
}

/// A recording at its full rate, where a law at a port is asked.
pub(super) struct At<'a> {
    pub(super) ground: &'a Ground<'a>,
    pub(super) track: &'a Track,
    /// Of the side that the port is at.
    pub(super) x_m: &'a [f64],
    pub(super) v_m_s: &'a [f64],
}

impl At<'_> {
    /// A function of the speed.
    pub(super) fn of_speed(&self, f: impl Fn(f64) -> f64) -> Vec<f64> {
        self.v_m_s.iter().map(|v| f(*v)).collect()
    }

    /// Functions of stretch and position.
    pub(super) fn springs(&self, springs: &[SpringLaw]) -> Vec<Vec<f64>> {
        let pairs = || self.track.stretch_m.iter().zip(self.x_m);
        springs.iter().map(|law| pairs().map(|(d, x)| law(*d, *x)).collect()).collect()
    }
}

/// What is made of the position that an encoder reads.
#[derive(Clone, Copy)]
pub(super) struct ReadAt {
    pub(super) at_stage: bool,
    pub(super) spring_n_m: f64,
    pub(super) damper_n_s_m: f64,
    pub(super) mass_kg: f64,
    pub(super) damping_n_s_m: f64,
}

impl<'a> Ground<'a> {
    /// A recording where a law at a port is asked.
    pub(super) fn at(&'a self, port: Port, track: &'a Track) -> At<'a> {
        let side = &track.sides[self.moves_as(port)];
        At { ground: self, track, x_m: &side.x_m, v_m_s: &side.v_m_s }
    }

    /// The columns of forces at a port, `full` at the full rate; what of them is force of the spring.
    pub(super) fn forces(
        &self,
        port: Port,
        full: impl Fn(&Track) -> Vec<Vec<f64>>,
        springs: &[SpringLaw],
        follows: Option<Follows>,
    ) -> Vec<TimeColumn> {
        let signs = self.signs(port);
        let follows = follows.filter(|_| self.signals.sides() == 2);
        let (mut out, mut first): (Vec<TimeColumn>, Series) = Default::default();
        for (r, track) in self.signals.tracks.iter().enumerate() {
            for (k, full) in full(track).into_iter().enumerate() {
                if r == 0 {
                    out.push(TimeColumn::default());
                }
                let thin = self.signals.filtered(track, &full, 0);
                for side in 0..2 {
                    if signs[side] != 0.0 {
                        let signed = thin.iter().map(|v| signs[side] * v).collect();
                        out[k].sides[side].get_or_insert_with(Vec::new).push(signed);
                    }
                }
                if k == 0 && follows.is_some() {
                    first.push(full);
                }
            }
        }
        for (column, stiffness) in out.iter_mut().zip(self.mean_stiffness(springs)) {
            column.operator =
                Some(Arc::new(move |_| [1.0, -1.0, -1.0, 1.0].map(|s| Complex::new(s * stiffness, 0.0))));
        }
        if let (Some(column), Some(follows)) = (out.first_mut(), follows) {
            column.operator = self.friction(self.side(port), follows, &first);
        }
        out
    }

    /// What a force that follows the motion of a side makes of it, where there is a Jacobian of more than a
    /// mass.
    fn friction(&self, side: usize, follows: Follows, full: &[Vec<f64>]) -> Operator {
        if self.signals.sides() == 1 {
            return None;
        }
        let motion = |track: &'a Track| match follows {
            Follows::Speed => &track.sides[side].v_m_s[..],
            Follows::Way => &track.sides[side].x_m[..],
        };
        let all = self.signals.tracks.iter().zip(full);
        let slopes = class_slopes(all.map(|(track, full)| (&full[..], motion(track), &track.classes[..])));
        let at = [1.0 - side as f64, 0.0, 0.0, side as f64];
        Some(Arc::new(move |p| at.map(|at| p.of_slopes(follows, &slopes) * at)))
    }

    /// A function of the time in one recording, s since it began; nothing in the others.
    pub(super) fn in_recording(&self, own: usize, side: usize, of: impl Fn(f64) -> f64) -> TimeColumn {
        let at = |t: &Track, j: usize| of(t.thin_s(j, self.signals.step));
        let series = |(r, t): (usize, &Track)| -> Vec<f64> {
            (0..t.thin_count()).map(|j| if r == own { at(t, j) } else { 0.0 }).collect()
        };
        TimeColumn::at(side, self.signals.tracks.iter().enumerate().map(series).collect())
    }

    /// A force as a model states it.
    pub(super) fn stated(&self, law: &ForceLaw, port: Port) -> TimeColumn {
        let side = self.side(port);
        let of = |track: &Track| {
            let at = self.at(port, track);
            at.x_m.iter().zip(at.v_m_s).map(|(x, v)| law.force_n(*x, *v, self.smoothing_m_s)).collect()
        };
        let full = self.signals.each(of);
        if law.follows_speed() {
            self.of_speed(side, &full)
        } else {
            TimeColumn::at(side, self.thinned(&full))
        }
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

    /// Side whose position and velocity a law at a port is one of.
    fn side(&self, port: Port) -> usize {
        let of_motor = matches!(port, Port::Motor | Port::MotorEncoder);
        usize::from(self.signals.layout == Layout::TwoPositions && !of_motor)
    }

    /// The same with the stage of one position where the screw moves it.
    fn moves_as(&self, port: Port) -> usize {
        let side = self.side(port);
        if port == Port::Stage { self.signals.moved_side(side) } else { side }
    }

    /// Mean stiffness of each law of the stretch over all recordings, N/m.
    pub(super) fn mean_stiffness(&self, springs: &[SpringLaw]) -> Vec<f64> {
        let pairs = || self.signals.tracks.iter().flat_map(|t| t.stretch_m.iter().zip(&t.sides[0].x_m));
        let looked = || pairs().step_by(self.signals.step);
        let (power, count) = looked().fold((0.0, 0.0), |(p, n), (d, _)| (p + d * d, n + 1.0));
        let by = (DIFFERENCE * (power / f64::max(count, 1.0)).sqrt()).max(f64::MIN_POSITIVE);
        let slope = |law: &SpringLaw| -> f64 {
            looked().map(|(d, x)| (law(d + by, *x) - law(d - by, *x)) / (2.0 * by)).sum::<f64>() / count
        };
        springs.iter().map(slope).collect()
    }

    /// Stretch of the spring at the mean of the recordings, m.
    pub(super) fn zero_m(&self) -> f64 {
        self.mechanics.spring_zero_n / self.mechanics.stiffness_n_m.max(1e-300)
    }

    /// Unit dry friction of a side, thinned, or what one of its parts is more than the usual form: a part is
    /// in place of it, and the level of friction is one number. Of one position it turns with the stage, and
    /// the last part with the motor, where the stage follows by a stated screw.
    pub(super) fn dry(&self, side: usize, part: Option<usize>) -> TimeColumn {
        let full = self.signals.each(|track| self.dry_full(track, side, part));
        match part {
            None => self.of_speed(side, &full),
            Some(_) => TimeColumn::at(side, self.thinned(&full)),
        }
    }

    /// The same of one recording at the full rate.
    fn dry_full(&self, track: &Track, side: usize, part: Option<usize>) -> Vec<f64> {
        let (v, v_s) = (&track.sides[self.signals.moved_side(side)].v_m_s, self.smoothing_m_s);
        let mut slides: Vec<f64> = v.iter().map(|v| sliding_direction(*v, v_s)).collect();
        if let Some(part) = part {
            let other: Vec<f64> = match TURNING.get(part) {
                Some(form) => v.iter().map(|v| form(v / v_s)).collect(),
                None if part == TURNING.len() => {
                    play(&track.sides[side].x_m, 0.0, self.signals.least_way_m(side))
                }
                None => track.sides[side].v_m_s.iter().map(|v| sliding_direction(*v, v_s)).collect(),
            };
            slides.iter_mut().zip(other).for_each(|(s, o)| *s = o - *s);
        }
        slides
    }

    /// A force that follows the speed of a side, from its full-rate series.
    fn of_speed(&self, side: usize, full: &[Vec<f64>]) -> TimeColumn {
        let operator = self.friction(side, Follows::Speed, full);
        TimeColumn { operator, ..TimeColumn::at(side, self.thinned(full)) }
    }

    /// Full-rate series of each recording, filtered and thinned.
    fn thinned(&self, full: &[Vec<f64>]) -> Series {
        self.signals.tracks.iter().zip(full).map(|(t, full)| self.signals.filtered(t, full, 0)).collect()
    }

    /// What the model needs more where thrust comes another way.
    pub(super) fn path_change(&self, to: Path) -> TimeColumn {
        let of = |track: &Track| {
            let (now, then) = (self.signals.thrust(track, self.path), self.signals.thrust(track, to));
            difference(&now, &then)
        };
        TimeColumn::at(0, self.signals.each(of))
    }

    /// What is made of the position of an encoder.
    pub(super) fn read_at(&self, port: Port) -> ReadAt {
        let m = &self.mechanics;
        let two = self.signals.layout == Layout::TwoPositions;
        let at_stage = two && port == Port::StageEncoder;
        let (mass_kg, damping_n_s_m) = if at_stage || !two {
            (m.stage_mass_kg, m.stage_damping_n_s_m)
        } else {
            (m.motor_mass_kg, m.motor_damping_n_s_m)
        };
        ReadAt {
            at_stage,
            spring_n_m: if self.signals.layout == Layout::OnePosition { 0.0 } else { m.stiffness_n_m },
            damper_n_s_m: if two { m.structural_damping_n_s_m } else { 0.0 },
            mass_kg,
            damping_n_s_m,
        }
    }

    /// An encoder that is read later than stated.
    pub(super) fn encoder_later(&self, port: Port, extra_s: f64) -> Vec<TimeColumn> {
        let of = self.read_at(port);
        let error = |t: &Track| vec![read_error_m(&t.sides[self.side(port)].x_m, extra_s * t.rate_hz)];
        let mut out = self.encoder(port, error);
        let operator = Arc::new(move |p: &Point| {
            let w = p.rad_s;
            let read = 1.0 - Complex::from_polar(1.0, w * extra_s);
            let coupled = read * Complex::new(of.spring_n_m, w * of.damper_n_s_m);
            let own = read * Complex::new(of.mass_kg * w * w, -w * of.damping_n_s_m) - coupled;
            let none = Complex::new(0.0, 0.0);
            if of.at_stage { [none, coupled, none, own] } else { [own, none, coupled, none] }
        });
        out.iter_mut().for_each(|column| column.operator = Some(operator.clone()));
        out
    }

    /// An error of an encoder goes through everything that is made of its position.
    pub(super) fn encoder(&self, port: Port, error_m: impl Fn(&Track) -> Vec<Vec<f64>>) -> Vec<TimeColumn> {
        let of = self.read_at(port);
        let [own_side, other] = if of.at_stage { [1, 0] } else { [0, 1] };
        let mut out: Vec<TimeColumn> = Vec::new();
        for (r, track) in self.signals.tracks.iter().enumerate() {
            for (k, e) in error_m(track).iter().enumerate() {
                if r == 0 {
                    out.push(TimeColumn::default());
                }
                let [e0, e1, e2] = [0, 1, 2].map(|d| self.signals.filtered(track, e, d));
                let pairs = e0.iter().zip(&e1);
                let coupled: Vec<f64> = pairs.map(|(e, d)| of.spring_n_m * e + of.damper_n_s_m * d).collect();
                let triples = e1.iter().zip(&e2).zip(&coupled);
                let own = triples.map(|((d, dd), c)| -(of.mass_kg * dd + of.damping_n_s_m * d + c));
                out[k].sides[own_side].get_or_insert_with(Vec::new).push(own.collect());
                if self.signals.sides() == 2 {
                    out[k].sides[other].get_or_insert_with(Vec::new).push(coupled);
                }
            }
        }
        out
    }
}

/// What an encoder that is read that many samples later reads wrong.
pub(super) fn read_error_m(x_m: &[f64], samples: f64) -> Vec<f64> {
    x_m.iter().zip(later(x_m, samples)).map(|(now, then)| now - then).collect()
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
    use super::later;

    #[test]
    fn a_shift_is_exact_for_cubics() {
        let x: Vec<f64> = (0..50).map(|k| (0.1 * f64::from(k)).powi(3)).collect();
        let y = later(&x, 2.3);
        assert!((y[10] - 1.23_f64.powi(3)).abs() < 1e-12);
    }
}
