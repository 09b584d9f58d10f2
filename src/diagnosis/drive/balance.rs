//! One axis as recorded: which numbers its balance has, and the columns of each.

use super::columns::{Ground, TimeColumn, derivative};
use super::gram::{BandGram, Column, Gram, Part};
use super::likelihood::{Design, Fit, Spread, values, weights_of};
use super::number::{Mechanics, Number, TURNING};
use super::rounding::{accel_m_s2, rounding};
use super::signals::{Layout, Path, Signals, Track};
use super::sliding::{CLASSES, shares};
use super::spectra::{FOLDS, Plan, Point, Series};
use crate::diagnosis::criteria::Criteria;
use crate::plant::drive::DriveParams;
use crate::plant::effects::Port;
use crate::plant::effects::backlash::play;
use crate::plant::effects::coulomb_friction::sliding_direction;
use std::borrow::Cow;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// A central difference of the thrust over its time of arrival, samples.
const TIMING_STEP: f64 = 0.1;
/// A step of a loop's bandwidth, as a factor.
pub(super) const LAG_STEP: f64 = 0.98;

use Number as N;

/// The axis as recorded, and how it is looked at.
pub(super) struct Balance {
    pub(super) drive: DriveParams,
    pub(super) signals: Signals,
    pub(super) plan: Plan,
    /// A column was moved in time: when a reference acts is free, and no delay is asked about.
    pub(super) clock_moved: bool,
    /// Where nobody states when both encoders are read: by how much later than stated the stage's was taken,
    /// s. What it is more is a number then.
    pub(super) stage_later_s: Option<f64>,
    /// Encoders whose error inside a signal period is known, and taken off.
    pub(super) read_right: Vec<Port>,
    /// The newest column of each number (none: the target): a state that is built anew has mostly moved
    /// something else.
    newest: Mutex<Vec<Made>>,
    /// See [`Self::rounding`].
    rounding: OnceLock<Vec<Column>>,
    /// Of two positions: how freely the axis slides in each recording.
    pub(super) shares: Arc<Vec<[f64; CLASSES]>>,
    /// Where the Jacobian is taken; none: the axis is one mass.
    pub(super) points: Arc<Vec<Point>>,
    accel_of_steps: OnceLock<Vec<BandGram>>,
}

/// A column and what it was made with.
struct Made {
    number: Option<Number>,
    with: MadeWith,
    column: Column,
}

/// What a column is made with beside the signals.
#[derive(Debug, Clone, Copy, PartialEq)]
enum MadeWith {
    Nothing,
    Path(Path),
    /// The speed over which friction turns, m/s.
    Turning(f64),
}

impl Balance {
    /// The axis, looked at in blocks and bands of what the masks leave.
    pub(super) fn new(
        drive: DriveParams,
        signals: Signals,
        (clock_moved, stage_later_s): (bool, Option<f64>),
    ) -> Self {
        let masked: Vec<Vec<bool>> = signals.tracks.iter().map(|t| t.masked.clone()).collect();
        // One position tells friction at the lowest frequencies, where every real axis leaves most: weights
        // by band would give those few bins away for the many of the noise.
        let white = signals.layout != Layout::TwoPositions;
        let mut plan = Plan::new(&masked, signals.thin_rate_hz(), (signals.top_hz(), white));
        if signals.layout == Layout::OnePosition {
            let rests = |r: usize, k: usize| signals.tracks[r].rests.get(k).copied().unwrap_or(false);
            plan = plan.looking_at(|r, k| !rests(r, k));
        }
        let classes: Vec<Vec<u8>> = signals.tracks.iter().map(|t| t.measured_classes(signals.step)).collect();
        let points = Arc::new(plan.points(&shares(classes.iter().flatten())));
        let shares = Arc::new(classes.iter().map(|of| shares(of.iter())).collect());
        Self {
            drive,
            signals,
            plan,
            shares,
            points,
            clock_moved,
            stage_later_s,
            read_right: Vec::new(),
            newest: Mutex::default(),
            rounding: OnceLock::new(),
            accel_of_steps: OnceLock::new(),
        }
    }

    /// True where two positions are recorded and nobody states when each was read.
    pub(super) fn asks_encoder_timing(&self) -> bool {
        self.signals.layout == Layout::TwoPositions && self.stage_later_s.is_some()
    }

    /// By how much what a force is later than its motion is not that of its path, as a deviation, s: when
    /// inside a sample a reference acts differs between drives; and with one position friction behind a screw
    /// that winds up by its force turns over that way, which a time takes for later by `<D, t'> / <t', t'>`,
    /// D what friction differs by, t' the rate of the thrust.
    pub(super) fn timing_deviation_s(&self, dry_n: f64) -> f64 {
        let wound_m = match (self.signals.layout, self.drive.axial_stiffness_n_m()) {
            (Layout::OnePosition, k) if k > 0.0 => dry_n / k,
            _ => self.signals.wound_m,
        };
        let usual_s = Criteria::STANDARD.timing_deviation / self.signals.rate_hz;
        if wound_m == 0.0 {
            return usual_s;
        }
        let rate = self.number_column(N::Timing, &Standing::stated(self, true).ground(self));
        let rate = rate.sides[0].iter().flatten();
        let v_s = self.signals.smoothing_m_s;
        let (mut along, mut power) = (0.0, 0.0);
        for (track, rate) in self.signals.tracks.iter().zip(rate) {
            let side = &track.sides[0];
            let turns = side.v_m_s.iter().zip(play(&side.x_m, 0.0, wound_m));
            let later: Vec<f64> =
                turns.map(|(v, late)| dry_n * (sliding_direction(*v, v_s) - late)).collect();
            let later = self.signals.filtered(track, &later, 0);
            for ((later, rate), _) in later.iter().zip(rate).zip(track.judged()).filter(|(_, judged)| *judged)
            {
                along += later * rate;
                power += rate * rate;
            }
        }
        usual_s.hypot(along / power.max(f64::MIN_POSITIVE))
    }

    /// The numbers that this balance has.
    pub(super) fn numbers(&self) -> Vec<Number> {
        let mut numbers = match self.signals.layout {
            Layout::TwoPositions => vec![
                N::MotorMass,
                N::MotorDamping,
                N::MotorCoulomb,
                N::Stiffness,
                N::StructuralDamping,
                N::StageMass,
                N::StageDamping,
                N::StageCoulomb,
                N::Timing,
                N::Zero,
                N::Scale,
            ],
            Layout::OnePosition => vec![N::StageMass, N::StageDamping, N::StageCoulomb, N::Timing],
            Layout::Locked => {
                vec![N::StageMass, N::StageDamping, N::StageCoulomb, N::Timing, N::Stiffness, N::Zero]
            }
        };
        numbers.extend(self.asks_encoder_timing().then_some(N::EncoderTiming));
        let of_motor = numbers.contains(&N::MotorCoulomb);
        let parts = 0..TURNING.len();
        numbers.extend(parts.clone().filter(|_| of_motor).map(N::MotorTurning));
        numbers.extend(parts.map(N::StageTurning));
        let more = usize::from(self.signals.sides() == 1) + usize::from(self.signals.following.is_some());
        numbers.extend((TURNING.len()..TURNING.len() + more).map(N::StageTurning));
        numbers
    }

    fn linear(&self, number: Number) -> TimeColumn {
        let two = self.signals.layout == Layout::TwoPositions;
        let each = |of: &dyn Fn(&super::signals::Thin) -> Vec<f64>| self.signals.each(|t| of(&t.thin));
        let negative = |x: &[f64]| x.iter().map(|v| -v).collect::<Vec<f64>>();
        let coupled = |of: &dyn Fn(&super::signals::Thin) -> Vec<f64>| TimeColumn {
            sides: [Some(each(of)), two.then(|| each(&|t| negative(&of(t))))],
            operator: None,
        };
        let spring = |order: i32, of: &dyn Fn(&super::signals::Thin) -> Vec<f64>| TimeColumn {
            operator: Some(Arc::new(move |p| {
                [1.0, -1.0, -1.0, 1.0].map(|sign| sign * derivative(p.rad_s, order))
            })),
            ..coupled(of)
        };
        let own = |side: usize, order: i32, of: &dyn Fn(&super::signals::Thin) -> Vec<f64>| {
            let mut column = TimeColumn::default();
            column.sides[if two { side } else { 0 }] = Some(each(of));
            let at = [1.0 - side as f64, 0.0, 0.0, side as f64];
            column.operator = Some(Arc::new(move |p| at.map(|at| at * derivative(p.rad_s, order))));
            column
        };
        let last = usize::from(two);
        match number {
            N::MotorMass => own(0, 2, &|t| t.accel[0].clone()),
            N::MotorDamping => own(0, 1, &|t| t.velocity[0].clone()),
            N::Stiffness => spring(0, &|t| t.stretch.clone()),
            N::StructuralDamping => spring(1, &|t| t.stretch_rate.clone()),
            N::StageMass => own(1, 2, &|t| t.accel[last].clone()),
            N::StageDamping => own(1, 1, &|t| t.velocity[last].clone()),
            N::Zero => coupled(&|t| vec![1.0; t.position.len()]),
            N::Scale => coupled(&|t| {
                let middle = 0.5 * self.signals.travel_m().iter().sum::<f64>();
                t.position.iter().map(|x| x - middle).collect()
            }),
            N::MotorCoulomb
            | N::StageCoulomb
            | N::MotorTurning(_)
            | N::StageTurning(_)
            | N::Timing
            | N::EncoderTiming
            | N::Lag => TimeColumn::default(),
        }
    }

    /// A number's column in time.
    pub(super) fn number_column(&self, number: Number, state: &Ground<'_>) -> TimeColumn {
        match number {
            N::MotorCoulomb | N::StageCoulomb | N::MotorTurning(_) | N::StageTurning(_) => {
                let side = usize::from(self.signals.sides() == 2 && number.is_of_stage());
                state.dry(side, number.part())
            }
            N::Timing => {
                let by = TIMING_STEP / self.signals.rate_hz;
                let at = |delay_s: f64| {
                    let path = Path { delay_s: state.path.delay_s + delay_s, ..state.path };
                    self.signals.each(|t| self.signals.thrust(t, path))
                };
                // Later by a second: thrust less its rate; the model needs the rate more.
                let rate = at(-by)
                    .iter()
                    .zip(&at(by))
                    .map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b) / (2.0 * by)).collect())
                    .collect();
                TimeColumn::at(0, rate)
            }
            N::EncoderTiming => {
                let by_s = TIMING_STEP / self.signals.rate_hz;
                let later = state.encoder_later(Port::StageEncoder, by_s);
                TimeColumn::sum(later.iter().map(|column| (column, by_s.recip())))
            }
            N::Lag => {
                let slower = state.path.loop_rad_s.map(|w| LAG_STEP * w);
                state.path_change(Path { loop_rad_s: slower, ..state.path })
            }
            _ => self.linear(number),
        }
    }

    /// The spectra of a number's column.
    pub(super) fn spectra_of(&self, number: Number, state: &Ground<'_>) -> Column {
        let with = match number {
            N::Timing | N::Lag => MadeWith::Path(state.path),
            n if n.is_dry_friction() => MadeWith::Turning(state.smoothing_m_s),
            // Of masses and stiffness, which always move.
            N::EncoderTiming => return self.column(&self.number_column(number, state)),
            _ => MadeWith::Nothing,
        };
        self.made_once(Some(number), with, || self.number_column(number, state))
    }

    /// The spectra of what is fitted to.
    pub(super) fn spectra_of_target(&self, path: Path) -> Column {
        self.made_once(None, MadeWith::Path(path), || self.target(path))
    }

    fn made_once(&self, number: Option<Number>, with: MadeWith, of: impl FnOnce() -> TimeColumn) -> Column {
        let newest = || self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(made) = newest().iter().find(|made| made.number == number && made.with == with) {
            return made.column.clone();
        }
        let column = self.column(&of());
        let mut newest = newest();
        newest.retain(|made| made.number != number);
        newest.push(Made { number, with, column: column.clone() });
        column
    }

    /// Spectra of [`rounding`]. Of two positions beside the numbers as they were when it was asked first.
    pub(super) fn rounding(&self, ground: &Ground<'_>) -> Cow<'_, [Column]> {
        let made = || -> Vec<Column> { rounding(ground).iter().map(|t| self.column(t)).collect() };
        if self.signals.layout == Layout::TwoPositions {
            Cow::Borrowed(self.rounding.get_or_init(made))
        } else {
            Cow::Owned(made())
        }
    }

    /// Inner products of [`accel_m_s2`] in each band.
    pub(super) fn accel_of_steps(&self) -> &[BandGram] {
        let made = || Gram::new(&self.plan, vec![self.column(&accel_m_s2(&self.signals))]);
        self.accel_of_steps.get_or_init(|| made().sum(&self.plan, Part::All))
    }

    /// A column's spectra.
    pub(super) fn column(&self, time: &TimeColumn) -> Column {
        let response = time.operator.as_ref().map(|of| self.points.iter().map(|p| of(p)).collect());
        Column {
            sides: [0, 1].map(|k| time.sides[k].as_ref().map(|s| self.plan.transform(&self.weighted(s)))),
            response: response.map(Arc::new),
        }
    }

    /// A series in which nothing is where the axis rests, which one position alone tells, or with the weights
    /// of two.
    fn weighted<'a>(&self, series: &'a Series) -> Cow<'a, Series> {
        let moving = |x: &f64, rests: &bool| if *rests { 0.0 } else { *x };
        let weights: &dyn Fn(&[f64], &Track) -> Vec<f64> = match self.signals.layout {
            Layout::Locked => return Cow::Borrowed(series),
            Layout::OnePosition => {
                &|x, t| x.iter().zip(&t.rests).map(|(x, rests)| moving(x, rests)).collect()
            }
            Layout::TwoPositions => &|x, t| x.iter().zip(&t.weight).map(|(x, w)| x * w).collect(),
        };
        Cow::Owned(series.iter().zip(&self.signals.tracks).map(|(x, track)| weights(x, track)).collect())
    }

    /// What is fitted to: the thrust at the motor, nothing at the stage.
    pub(super) fn target(&self, path: Path) -> TimeColumn {
        TimeColumn::at(0, self.signals.each(|t| self.signals.thrust(t, path)))
    }

    /// Parts that are held out in turn: quarters, and recordings where there are several.
    pub(super) fn parts(&self) -> Vec<Part> {
        let recordings = (0..self.plan.recordings()).filter(|_| self.plan.recordings() > 1);
        (0..FOLDS).map(Part::Fold).chain(recordings.map(Part::Recording)).collect()
    }

    /// L of each of [`Self::parts`], foretold by all else under the noise of all: -ln p(part | rest), p of
    /// all over p of the rest, coefficients integrated over what the rest leaves open of them. A direction
    /// that only the part shows costs its price, and is no false prediction.
    ///
    /// ```text
    ///  L(all) - L(rest) + (ln det A(all) - ln det (A(rest) + A(all) / 2N)) / 2
    /// ```
    /// A: what the values tell of the coefficients; the prior is one of the 2 N real ones (Kass and
    /// Wasserman, J. Am. Stat. Assoc. 90, 1995). The shapes of laws are those of all.
    pub(super) fn held_out_nats(&self, gram: &Gram, design: &Design, beta: &[f64]) -> Vec<f64> {
        let all = gram.sum(&self.plan, Part::All);
        let weights = design.weights(&all, beta);
        let (nats, known) = (design.nats(&all, beta), design.told_by_values(&all, &weights));
        let prior = &known / (2.0 * values(&all)).max(1.0);
        let of = |rest: Rest| {
            let known_of_rest = design.told_by_values(&rest.bands, &rest.weights);
            let open = design.log_det_free(&known).zip(design.log_det_free(&(known_of_rest + &prior)));
            // Its weights are those of all, so another fit may be the better one under its own.
            let nats_of_rest = design.nats(&rest.bands, &rest.beta).min(design.nats(&rest.bands, beta));
            nats - nats_of_rest + open.map_or(0.0, |(all, rest)| 0.5 * (all - rest))
        };
        self.rests(gram, design, beta, (&all, &weights)).map(of).collect()
    }

    /// Coefficients for each of [`Self::parts`] by a fit to all else.
    pub(super) fn foretold(&self, gram: &Gram, design: &Design, beta: &[f64]) -> Vec<Vec<f64>> {
        let all = gram.sum(&self.plan, Part::All);
        let weights = design.weights(&all, beta);
        self.rests(gram, design, beta, (&all, &weights)).map(|rest| rest.beta).collect()
    }

    /// All but each of [`Self::parts`], fitted.
    fn rests(
        &self,
        gram: &Gram,
        design: &Design,
        beta: &[f64],
        all: (&[BandGram], &[Spread]),
    ) -> impl Iterator<Item = Rest> {
        self.parts().into_iter().map(move |part| {
            let bands = gram.sum_without(&self.plan, part);
            let weights = weights_of(&bands, all);
            let beta = design.fit_under(&bands, beta, &weights);
            Rest { bands, weights, beta }
        })
    }

    /// Weights of a floor that is flat below the bands it is read off in.
    fn flat_weights(&self, design: &Design, bands: &[BandGram], beta: &[f64]) -> Vec<Spread> {
        let [low, high] = self.plan.floor_hz();
        let spreads: Vec<Spread> = bands.iter().map(|b| design.spread(b, beta)).collect();
        let middle = |b: &BandGram| 0.5 * self.plan.band_hz(b.band).iter().sum::<f64>();
        let flat = |b: &BandGram, s: &Spread| {
            let reference =
                bands.iter().position(|o| o.recording == b.recording && (low..high).contains(&middle(o)));
            reference.filter(|_| middle(b) < low).map_or(*s, |k| spreads[k])
        };
        bands.iter().zip(&spreads).map(|(b, s)| design.weight(flat(b, s))).collect()
    }

    /// The better of two fits: from the weights of the present residuals, and from a flat floor. Beside a
    /// mode that the model lacks the first ends too high.
    pub(super) fn fit(&self, design: &Design, bands: &[BandGram], beta: &[f64], weights: &[Spread]) -> Fit {
        let one = design.fit(bands, beta.to_vec(), weights.to_vec());
        let flat = self.flat_weights(design, bands, beta);
        let other = design.fit(bands, beta.to_vec(), flat);
        if other.nats < one.nats { other } else { one }
    }
}

/// What is not held out: its inner products, their weights by the noise of all, and the fit to them.
struct Rest {
    bands: Vec<BandGram>,
    weights: Vec<Spread>,
    beta: Vec<f64>,
}

/// The stated numbers on the screw axis.
pub(super) fn stated_mechanics(balance: &Balance) -> Mechanics {
    let d = &balance.drive;
    let total = balance.signals.layout != Layout::TwoPositions;
    let sum = |motor: f64, stage: f64| if total { motor + stage } else { stage };
    Mechanics {
        motor_mass_kg: d.reflected_mass_kg(),
        motor_damping_n_s_m: d.reflected_damping_n_s_m(),
        motor_coulomb_n: d.motor_coulomb_friction_n(),
        stiffness_n_m: d.axial_stiffness_n_m(),
        structural_damping_n_s_m: d.structural_damping_n_s_m(),
        stage_mass_kg: sum(d.reflected_mass_kg(), d.movable_mass_kg()),
        stage_damping_n_s_m: sum(d.reflected_damping_n_s_m(), d.translational_damping_n_s_m()),
        stage_coulomb_n: sum(d.motor_coulomb_friction_n(), d.stage_coulomb_friction_n()),
        spring_zero_n: 0.0,
    }
}

/// Numbers beside which laws stand and are asked, and which a law may move in place of standing in the model.
#[derive(Debug, Clone, Copy)]
pub(super) struct Standing {
    pub(super) path: Path,
    /// When a reference acts beside that, s.
    pub(super) timing_s: f64,
    pub(super) smoothing_m_s: f64,
    pub(super) mechanics: Mechanics,
    /// The recordings tell the inertia: thrust is what accelerates. Else it is a force beside a motion, and
    /// nothing says when it came.
    pub(super) inertial: bool,
    /// A dead time, a current loop, a smoothing speed other than stated were found. Delay and loop stay free,
    /// since each bends the other.
    pub(super) found_delay: bool,
    pub(super) found_loop: bool,
    pub(super) found_smoothing: bool,
}

impl Standing {
    /// As the model states them.
    pub(super) fn stated(balance: &Balance, inertial: bool) -> Self {
        Self {
            path: Path::stated(&balance.drive),
            timing_s: 0.0,
            smoothing_m_s: balance.signals.smoothing_m_s,
            mechanics: stated_mechanics(balance),
            inertial,
            found_delay: false,
            found_loop: false,
            found_smoothing: false,
        }
    }

    /// What laws are evaluated on.
    pub(super) fn ground<'a>(&self, balance: &'a Balance) -> Ground<'a> {
        Ground {
            signals: &balance.signals,
            mechanics: self.mechanics,
            smoothing_m_s: self.smoothing_m_s,
            path: Path { delay_s: self.path.delay_s + self.timing_s, ..self.path },
        }
    }
}
