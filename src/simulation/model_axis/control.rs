//! The control law of an axis, and whether a recording obeys it.

use crate::plant::machine::Controller;

/// P position on the stage encoder, PI velocity on the motor encoder, velocity feed-forward:
/// `u = g K_v (e + K_i sum e T)`, `e = v_cmd + K_p (x_cmd - x_t) - v_m`.
///
/// v_cmd, v_m: backward difference quotients; v_m filtered by a backward-Euler lag.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControlLaw {
    /// Gains.
    pub controller: Controller,
    /// g: reference per acceleration, in the reference's unit times s2/m.
    pub per_accel: f64,
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
    pub(super) fn error_m_s(
        &self,
        state: &mut LawState,
        [command_m, motor_m, stage_m]: [f64; 3],
        period_s: f64,
    ) -> f64 {
        let c = &self.controller;
        let w = c.velocity_filter_rad_s * period_s;
        let share = if w > 0.0 { w / (1.0 + w) } else { 1.0 };
        let quotient = (motor_m - state.last_motor_m) / period_s;
        state.velocity_m_s += share * (quotient - state.velocity_m_s);
        let forward = (command_m - state.last_command_m) / period_s;
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
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoopRecord<'a> {
    /// Position command, m.
    pub command_m: &'a [f64],
    /// Motor encoder as travel, m.
    pub motor_m: &'a [f64],
    /// Stage encoder, m.
    pub stage_m: &'a [f64],
    /// Reference, in whatever unit.
    pub reference: &'a [f64],
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
/// The gain is taken from the recording that the law says best; a recording in which something was added to
/// the loop shows it as what is beyond. `None`: no recording has a moving reference.
/// Errors: none. Checked by: `model_axis::the_law_replays_a_recorded_loop`.
#[must_use]
pub fn replay(controller: Controller, period_s: f64, records: &[LoopRecord<'_>]) -> Option<Replay> {
    let unit = ControlLaw { controller, per_accel: 1.0 };
    let said: Vec<Vec<f64>> = records.iter().map(|r| law_output(&unit, period_s, r)).collect();
    let lines: Vec<Line> = said.iter().zip(records).map(|(x, r)| Line::fit(x, r.reference, None)).collect();
    let best = lines.iter().min_by(|a, b| a.share.total_cmp(&b.share)).filter(|l| l.slope > 0.0)?;
    let slope = best.slope;
    let law = ControlLaw { per_accel: slope / controller.velocity_gain_1_s, ..unit };
    let mut out = Replay { law, integral_m: Vec::new(), beyond: Vec::new(), share: Vec::new() };
    for (x, r) in said.iter().zip(records) {
        let line = Line::fit(x, r.reference, Some(slope));
        // What stands constant beyond the law is the integral that was there before the first sample.
        let k_i = controller.velocity_integral_1_s;
        out.integral_m.push(if k_i > 0.0 { line.offset / (slope * k_i) } else { 0.0 });
        out.beyond.push(r.reference.iter().zip(x).map(|(u, x)| u - slope * x - line.offset).collect());
        out.share.push(line.share);
    }
    Some(out)
}

/// e + K_i sum e T from recorded signals.
fn law_output(law: &ControlLaw, period_s: f64, r: &LoopRecord<'_>) -> Vec<f64> {
    let first = |x: &[f64]| x.first().copied().unwrap_or(0.0);
    let velocity = r.motor_m.get(1).map_or(0.0, |x| (x - first(r.motor_m)) / period_s);
    let mut state = LawState::new(first(r.command_m), first(r.motor_m), (velocity, 0.0));
    r.command_m
        .iter()
        .zip(r.motor_m)
        .zip(r.stage_m)
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
