//! The control law of an axis, and whether a recording obeys it.

use crate::plant::machine::Controller;

/// P position on the stage encoder, PI velocity on the motor encoder:
/// `u = g K_v (e + K_i sum e T)`, `e = f v_cmd + K_p (x_cmd - x_t) - v_m`.
///
/// v_cmd, v_m: backward difference quotients. What a model file leaves open is a part of the law: whether the
/// command's velocity is fed forward, and how the lag of the filter on v_m is sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControlLaw {
    /// Gains.
    pub controller: Controller,
    /// g: reference per acceleration, in the reference's unit times s2/m.
    pub per_accel: f64,
    /// f = 1 or 0.
    pub feeds_forward: bool,
    /// True: the filter's lag held exactly over a sample; false: backward Euler.
    pub exact_filter: bool,
}

/// What the loop remembers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LawState {
    last_motor_m: f64,
    last_command_m: f64,
    velocity_m_s: f64,
    integral_m: f64,
}

impl LawState {
    pub(super) fn new(command_m: f64, motor_m: f64, (velocity_m_s, integral_m): (f64, f64)) -> Self {
        Self { last_motor_m: motor_m, last_command_m: command_m, velocity_m_s, integral_m }
    }
}

impl ControlLaw {
    /// e + K_i sum e T, m/s: the reference but for its gain.
    #[inline(always)]
    pub(super) fn error_m_s(
        &self,
        state: &mut LawState,
        [command_m, motor_m, stage_m]: [f64; 3],
        period_s: f64,
    ) -> f64 {
        let c = &self.controller;
        let w = c.velocity_filter_rad_s * period_s;
        let share = match (w > 0.0, self.exact_filter) {
            (false, _) => 1.0,
            (true, true) => -(-w).exp_m1(),
            (true, false) => w / (1.0 + w),
        };
        let quotient = (motor_m - state.last_motor_m) / period_s;
        state.velocity_m_s += share * (quotient - state.velocity_m_s);
        let f = f64::from(u8::from(self.feeds_forward));
        let forward = f * (command_m - state.last_command_m) / period_s;
        (state.last_motor_m, state.last_command_m) = (motor_m, command_m);
        let error = forward + c.position_gain_1_s * (command_m - stage_m) - state.velocity_m_s;
        state.integral_m += error * period_s;
        error + c.velocity_integral_1_s * state.integral_m
    }

    /// Reference per velocity error.
    pub(super) fn gain(&self) -> f64 {
        self.per_accel * self.controller.velocity_gain_1_s
    }
}

/// One recording of a loop.
#[derive(Debug, Clone, PartialEq)]
pub struct LoopRecord {
    /// Position command, m.
    pub command_m: Vec<f64>,
    /// Motor encoder as travel, m.
    pub motor_m: Vec<f64>,
    /// Stage encoder, m.
    pub stage_m: Vec<f64>,
    /// Reference, in whatever unit.
    pub reference: Vec<f64>,
}

/// How well a law says what was recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct Replay {
    /// The law with the gain that fits the recordings that obey it.
    pub law: ControlLaw,
    /// Per recording: integral of the velocity error at its first sample, m.
    pub integral_m: Vec<f64>,
    /// Per recording: what the reference was beyond the law.
    pub beyond: Vec<Vec<f64>>,
    /// Per recording: root mean square of that over that of the reference's changes.
    pub share: Vec<f64>,
}

impl Replay {
    /// Share that the law leaves in the recording that it says best.
    #[must_use]
    pub fn least_share(&self) -> f64 {
        self.share.iter().copied().fold(f64::INFINITY, f64::min)
    }
}

/// Lets the law act on the recorded command and positions and compares with the recorded reference.
///
/// The gain, and what the controller's keys leave open, are taken from the recording that a law says best; a
/// recording in which something was added to the loop shows it as what is beyond. `None`: no recording has a
/// moving reference.
/// Errors: none. Checked by: `model_axis::the_law_replays_a_recorded_loop`.
#[must_use]
pub fn replay(controller: Controller, period_s: f64, records: &[LoopRecord]) -> Option<Replay> {
    let open = [(true, false), (true, true), (false, false), (false, true)];
    let laws = open.map(|(feeds_forward, exact_filter)| ControlLaw {
        controller,
        per_accel: 1.0,
        feeds_forward,
        exact_filter,
    });
    let fits = laws.iter().map(|law| {
        let said: Vec<Vec<f64>> = records.iter().map(|r| law_output(law, period_s, r)).collect();
        let lines = said.iter().zip(records).map(|(x, r)| Line::fit(x, &r.reference, None));
        let best = lines.filter(|l| l.slope > 0.0).min_by(|a, b| a.share.total_cmp(&b.share));
        best.map(|line| (line, *law, said))
    });
    let (best, unit, said) = fits.flatten().min_by(|a, b| a.0.share.total_cmp(&b.0.share))?;
    let slope = best.slope;
    let law = ControlLaw { per_accel: slope / controller.velocity_gain_1_s, ..unit };
    let mut out = Replay { law, integral_m: Vec::new(), beyond: Vec::new(), share: Vec::new() };
    for (x, r) in said.iter().zip(records) {
        let line = Line::fit(x, &r.reference, Some(slope));
        // What stands constant beyond the law is the integral that was there before the first sample.
        let k_i = controller.velocity_integral_1_s;
        out.integral_m.push(if k_i > 0.0 { line.offset / (slope * k_i) } else { 0.0 });
        out.beyond.push(r.reference.iter().zip(x).map(|(u, x)| u - slope * x - line.offset).collect());
        out.share.push(line.share);
    }
    Some(out)
}

/// Gains and filter of the law that says one of the recordings best, from what they hold alone: where a model
/// states no controller. `mass_kg`: all that moves; `per_unit`: thrust of a unit of the reference, N. `None`:
/// no recording has a moving reference that such a law, with gains above zero, says at all.
///
/// Linear least squares of the two gains beside each filter and integral that is tried, those by a pattern
/// search. Errors: none. Checked by: `model_axis::the_law_is_read_from_a_recorded_loop`.
#[must_use]
pub fn read_controller(
    (mass_kg, per_unit): (f64, f64),
    period_s: f64,
    records: &[LoopRecord],
) -> Option<Controller> {
    let read = records.iter().filter_map(|r| ReadLaw::search(period_s, r));
    let best = read.min_by(|a, b| a.share.total_cmp(&b.share))?;
    let w = if best.taken < 1.0 { -(-best.taken).ln_1p() / period_s } else { 0.0 };
    Some(Controller {
        position_gain_1_s: best.position_gain_1_s,
        velocity_gain_1_s: best.slope * per_unit / mass_kg,
        velocity_integral_1_s: best.integral_1_s,
        velocity_filter_rad_s: w,
    })
}

/// What of a law was read from a recording.
#[derive(Debug, Clone, Copy)]
struct ReadLaw {
    /// Share of a new velocity that its filter takes.
    taken: f64,
    integral_1_s: f64,
    position_gain_1_s: f64,
    /// Reference per velocity error.
    slope: f64,
    share: f64,
}

impl ReadLaw {
    /// First and finest step of the search, natural logarithm.
    const STEPS: [f64; 2] = [0.5, 0.01];
    /// Rows of a recording that it is read from.
    const MOST_ROWS: usize = 40_000;

    /// The best that lies around the best integral of each filter, and around its mirror: where motor and
    /// stage go together, position gain and integral may stand for one another.
    fn search(period_s: f64, r: &LoopRecord) -> Option<Self> {
        let integrals_1_s = [0.0, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0];
        let through = |taken: f64| Ingredients::of(period_s, r, taken);
        let best_of = |taken: f64| {
            let of = through(taken);
            integrals_1_s.iter().filter_map(|k| of.fit(*k)).reduce(Self::better)
        };
        let begun = [1.0, 0.7, 0.4, 0.2, 0.1].into_iter().filter_map(best_of);
        let best = begun.map(|from| from.refined(through)).reduce(Self::better)?;
        let mirror = through(best.taken).fit(best.position_gain_1_s).map(|from| from.refined(through));
        Some(mirror.into_iter().fold(best, Self::better))
    }

    fn better(self, other: Self) -> Self {
        if other.share < self.share { other } else { self }
    }

    /// Pattern search over filter and integral.
    fn refined(self, through: impl Fn(f64) -> Ingredients) -> Self {
        let [mut step, finest] = Self::STEPS;
        let mut best = self;
        while step > finest {
            let (t, k) = (best.taken, best.integral_1_s);
            let by = [-step, 0.0, step].map(f64::exp);
            let around = by.iter().flat_map(|a| {
                let of = through((t * a).min(1.0));
                by.map(move |b| of.fit(k * b))
            });
            let next = around.flatten().fold(best, Self::better);
            step = if next.share < best.share { step } else { 0.5 * step };
            best = next;
        }
        best
    }
}

/// Position error, filtered velocity of the motor and that of the command less it, the integral of each, and
/// the reference; or factors of these.
type Row = [f64; 7];

/// Of the signals that a law is made of and the reference, less their means, all inner products: what any
/// gains leave of the reference follows from them.
#[derive(Debug, Clone, Copy)]
struct Ingredients {
    taken: f64,
    products: [Row; 7],
}

impl Ingredients {
    fn of(period_s: f64, r: &LoopRecord, taken: f64) -> Self {
        let lengths = [&r.command_m, &r.motor_m, &r.stage_m, &r.reference].map(Vec::len);
        let count = lengths.into_iter().fold(ReadLaw::MOST_ROWS, usize::min);
        let change = |x: &[f64], k: usize| (x[k] - x[k.saturating_sub(1)]) / period_s;
        let mut velocity_m_s = if count > 1 { change(&r.motor_m, 1) } else { 0.0 };
        let mut integrals = [0.0; 3];
        let rows = (0..count).map(|k| {
            if k > 0 {
                velocity_m_s += taken * (change(&r.motor_m, k) - velocity_m_s);
            }
            let behind = change(&r.command_m, k) - velocity_m_s;
            let now = [r.command_m[k] - r.stage_m[k], velocity_m_s, behind];
            integrals.iter_mut().zip(now).for_each(|(sum, x)| *sum += x * period_s);
            let [[apart, motor, behind], [of_apart, of_motor, of_behind]] = [now, integrals];
            [apart, motor, behind, of_apart, of_motor, of_behind, r.reference[k]]
        });
        let rows: Vec<Row> = rows.collect();
        let mut means = Row::default();
        for row in &rows {
            means.iter_mut().zip(row).for_each(|(mean, x)| *mean += x / count as f64);
        }
        let mut products = [Row::default(); 7];
        for row in rows {
            let row: Row = std::array::from_fn(|i| row[i] - means[i]);
            for (products, x) in products.iter_mut().zip(row) {
                products.iter_mut().zip(row).for_each(|(sum, y)| *sum += x * y);
            }
        }
        Self { taken, products }
    }

    fn product(&self, a: &Row, b: &Row) -> f64 {
        let with = |row: &Row| row.iter().zip(b).map(|(p, b)| p * b).sum::<f64>();
        self.products.iter().zip(a).map(|(row, a)| a * with(row)).sum()
    }

    /// The two gains by least squares, whether the command's velocity is fed forward or not.
    fn fit(&self, integral_1_s: f64) -> Option<ReadLaw> {
        let k = integral_1_s;
        let apart = [1.0, 0.0, 0.0, k, 0.0, 0.0, 0.0];
        let fed_forward = [0.0, 0.0, 1.0, 0.0, 0.0, k, 0.0];
        let of = |speed: Row| {
            let ([of_apart, slope], share) = self.fit_pair(&apart, &speed)?;
            let position_gain_1_s = of_apart / slope;
            let is_law = slope > 0.0 && position_gain_1_s > 0.0 && share.is_finite();
            is_law.then_some(ReadLaw { taken: self.taken, integral_1_s, position_gain_1_s, slope, share })
        };
        let alone = [0.0, -1.0, 0.0, 0.0, -k, 0.0, 0.0];
        [alone, fed_forward].into_iter().filter_map(of).min_by(|a, b| a.share.total_cmp(&b.share))
    }

    /// u = a x + b y + offset by least squares, and the share of the changes of u that it leaves.
    fn fit_pair(&self, x: &Row, y: &Row) -> Option<([f64; 2], f64)> {
        let u = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        let (xx, xy, xu) = (self.product(x, x), self.product(x, y), self.product(x, &u));
        let (yy, yu, uu) = (self.product(y, y), self.product(y, &u), self.product(&u, &u));
        let determinant = xx * yy - xy * xy;
        if !(determinant > 1e-12 * xx * yy && uu > 0.0) {
            return None;
        }
        let (a, b) = ((xu * yy - yu * xy) / determinant, (yu * xx - xu * xy) / determinant);
        Some(([a, b], ((uu - a * xu - b * yu).max(0.0) / uu).sqrt()))
    }
}

/// e + K_i sum e T from recorded signals.
fn law_output(law: &ControlLaw, period_s: f64, r: &LoopRecord) -> Vec<f64> {
    let first = |x: &[f64]| x.first().copied().unwrap_or(0.0);
    let velocity = r.motor_m.get(1).map_or(0.0, |x| (x - first(&r.motor_m)) / period_s);
    let mut state = LawState::new(first(&r.command_m), first(&r.motor_m), (velocity, 0.0));
    r.command_m
        .iter()
        .zip(&r.motor_m)
        .zip(&r.stage_m)
        .map(|((c, m), s)| law.error_m_s(&mut state, [*c, *m, *s], period_s))
        .collect()
}

/// u = slope x + offset by least squares.
struct Line {
    slope: f64,
    offset: f64,
    share: f64,
}

impl Line {
    fn fit(x: &[f64], u: &[f64], slope: Option<f64>) -> Self {
        let n = x.len().max(1) as f64;
        let (mx, mu) = (x.iter().sum::<f64>() / n, u.iter().sum::<f64>() / n);
        let (mut xx, mut xu, mut uu) = (0.0, 0.0, 0.0);
        for (x, u) in x.iter().zip(u) {
            let (x, u) = (x - mx, u - mu);
            (xx, xu, uu) = (xx + x * x, xu + x * u, uu + u * u);
        }
        let slope = slope.unwrap_or(if xx > 0.0 { xu / xx } else { 0.0 });
        let left = (uu - 2.0 * slope * xu + slope * slope * xx).max(0.0);
        let share = if uu > 0.0 { (left / uu).sqrt() } else { f64::INFINITY };
        Self { slope, offset: mu - slope * mx, share }
    }
}
