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
