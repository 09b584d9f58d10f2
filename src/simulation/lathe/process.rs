//! Two tools cut one slender bar: chips from the surface that each tool really left.
//!
//! ```text
//!            tool 2 ->  ( bar )  <- tool 1        x: bar toward tool 1, at the tools
//!                     turns ->
//! ```
//! The surface is a profile of radius over workpiece angle. Each tool removes what stands above its
//! tip: chip h_i = surface(angle_i) - tip_i. A tool that leaves the work removes nothing and leaves
//! the surface as it was, so lost contact and regeneration over several turns need no rule of their
//! own. Linearised, this is facts section 7:
//!
//! m x'' + (c + 2 c_p phi^2) x' + (k + K phi^2 (2 + e^{-s tau1} + e^{-s tau2})) x = 0
//!
//! Limiter: the flank. When the bar comes at a tool faster than the clearance angle allows,
//! x'/v > tan(clearance), the flank rubs with `flank_force_n` per unit of excess slope. Loss of
//! contact alone does not bound chatter of two opposed tools.
//!
//! A holder of tool 2 that gives way, a lag of the force, unequal tools, one tool alone and what follows the
//! angle of the work are part of the same step; the force law stands in [`super::law`].

use super::law::{CutSettings, ToolNow};
use super::mode::{ModeAt, ModeState, Motion};
use crate::plant::cut_effects::AtAngle;
use crate::plant::scenario::ToolCount;
use std::f64::consts::{PI, TAU};

/// Where the two tool tips are, now.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ToolTips {
    /// Angle by which tool 1 is shifted with the turn, half the pitch difference, rad.
    pub shift_rad: f64,
    /// Radial retraction of tool 1 and tool 2 from the programmed radius, m.
    pub retraction_m: [f64; 2],
    /// Share of the width that is in the cut, 0 to 1 (entry at the end face).
    pub engagement: f64,
}

/// Modes of bar and holder as the tools see them.
#[derive(Debug, Clone, PartialEq)]
pub struct ModesAt {
    /// Of the bar.
    pub bar: Vec<ModeAt>,
    /// Of the holder of tool 2, where it gives way.
    pub holder: Option<ModeAt>,
}

/// Where a tool stands around the work, turns in the sense of the turn: alpha_1 = d/2, alpha_2 = pi.
fn lab_turns(tool: usize, tips: &ToolTips) -> f64 {
    if tool == 0 { tips.shift_rad / TAU } else { 0.5 }
}

/// Points of the stored surface per turn at the nominal speed and step: a step passes about 1.5.
const CELLS_PER_STEP: f64 = 1.5;
/// Cells between a tool and the surface it writes, so that the cubic read sees the old surface.
const WRITE_LAG: f64 = 2.5;
const HISTORY: usize = 16;

/// The last places of one tool's tip, from which the surface is written.
#[derive(Debug, Clone, PartialEq)]
struct Trace {
    place: [f64; HISTORY],
    tip_m: [f64; HISTORY],
    newest: usize,
    written: f64,
}

/// Bar, surface and tools in motion.
#[derive(Debug, Clone, PartialEq)]
pub struct CuttingProcess {
    cut: CutSettings,
    step_s: f64,
    modes: Vec<ModeState>,
    holder: Option<ModeState>,
    surface_m: Vec<f64>,
    traces: [Trace; 2],
    spindle_turns: f64,
    /// Where the commanded speed would have turned the spindle to.
    commanded_turns: f64,
    radial_force_n: [f64; 2],
    /// What the law says, before the lag of the force.
    law_n: [f64; 2],
    slope_speed_m_s: f64,
}

/// Where the edges are and how fast they go, into the work.
#[derive(Debug, Clone, Copy, Default)]
struct Edges {
    into_m: [f64; 2],
    into_m_s: [f64; 2],
}

impl CuttingProcess {
    /// A process in steady cutting at equal pitch, at rest.
    ///
    /// `step_s` is the step of integration; `turns_per_s` the nominal spindle speed, which sets how
    /// finely the surface is stored.
    #[must_use]
    pub fn new(cut: CutSettings, modes: &ModesAt, step_s: f64, turns_per_s: f64) -> Self {
        let cells = (CELLS_PER_STEP / (turns_per_s * step_s)).ceil().clamp(256.0, 65_536.0);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped above")]
        let cells = cells as usize;
        let mut process = Self {
            cut,
            step_s,
            modes: modes.bar.iter().map(|m| ModeState::new(*m, step_s)).collect(),
            holder: modes.holder.map(|m| ModeState::new(m, step_s)),
            surface_m: vec![0.0; cells],
            traces: std::array::from_fn(|_| Trace {
                place: [0.0; HISTORY],
                tip_m: [0.0; HISTORY],
                newest: 0,
                written: 0.0,
            }),
            spindle_turns: 0.0,
            commanded_turns: 0.0,
            radial_force_n: [0.0; 2],
            law_n: [0.0; 2],
            slope_speed_m_s: PI * cut.diameter_m * turns_per_s,
        };
        process.settle(&ToolTips::default());
        process
    }

    /// Cell coordinate of a tool: grows as the bar turns.
    fn place(&self, tool: usize, tips: &ToolTips) -> f64 {
        (self.spindle_turns - lab_turns(tool, tips)) * self.surface_m.len() as f64
    }

    /// Advance of a tool since the surface that it cuts was left, m.
    fn advance_m(&self, tool: usize, tips: &ToolTips) -> f64 {
        // From tool 2 on to tool 1 the work turns by theta_2 = pi + d/2.
        let share = match (self.cut.tools, tool) {
            (ToolCount::One, _) => 1.0,
            (ToolCount::Two, 0) => 0.5 + tips.shift_rad / TAU,
            (ToolCount::Two, _) => 0.5 - tips.shift_rad / TAU,
        };
        self.cut.feed_m_rev * share
    }

    /// Puts surface and bar into the steady state of these tips: what long stable cutting leaves.
    pub fn settle(&mut self, tips: &ToolTips) {
        let bar: f64 = self.modes.iter().map(|m| m.at.compliance_m_n()).sum();
        let holder = self.holder.as_ref().map_or(0.0, |m| m.at.compliance_m_n());
        let (mut x, mut w, mut force) = (0.0, 0.0, [0.0; 2]);
        // Fixed point, damped by a half: force law and statics of bar and holder.
        for _ in 0..100 {
            let into_m = [x, w + self.cut.tool2_ahead_m - x];
            let own = if self.cut.tools == ToolCount::One { into_m[0] } else { into_m[1] };
            let past = [own, into_m[0]].map(|u| self.cut.overlap * u);
            force = std::array::from_fn(|tool| {
                let chip_m = self.advance_m(tool, tips) + into_m[tool] - past[tool];
                let at_angle = AtAngle::default();
                let now = ToolNow { chip_m, into_m: into_m[tool], slope: 0.0, noise: 0.0, at_angle };
                if self.cuts(tool) { tips.engagement * self.cut.force_n(tool, &now) } else { 0.0 }
            });
            x += (bar * (force[1] - force[0]) - x) / 2.0;
            w += (-holder * force[1] - w) / 2.0;
        }
        for mode in &mut self.modes {
            mode.rest_under(force[1] - force[0]);
        }
        if let Some(holder) = &mut self.holder {
            holder.rest_under(-force[1]);
        }
        self.radial_force_n = force;
        self.law_n = force;
        let into_m = [x, w + self.cut.tool2_ahead_m - x];
        let radius = -self.cut.feed_m_rev * self.spindle_turns;
        let cells = self.surface_m.len();
        let places = [self.place(0, tips), self.place(1, tips)];
        for cell in 0..cells {
            // Turns since each tool passed this cell; the later one left the surface. The last cells
            // behind a tool are still to be written from its trace.
            let since = |tool: usize| {
                let written = (places[tool] - WRITE_LAG).floor();
                let behind = (written - cell as f64).rem_euclid(cells as f64);
                (behind + places[tool] - written) / cells as f64
            };
            let last = if self.cuts(1) && since(1) <= since(0) { 1 } else { 0 };
            self.surface_m[cell] =
                radius + self.cut.feed_m_rev * since(last) - into_m[last] + tips.retraction_m[last];
        }
        for (tool, place) in places.into_iter().enumerate() {
            let tip = radius - into_m[tool] + tips.retraction_m[tool];
            let trace = &mut self.traces[tool];
            let back = self.cut.feed_m_rev / cells as f64;
            for i in 0..HISTORY {
                let steps_ago = (HISTORY - 1 - i) as f64;
                trace.place[i] = place - steps_ago;
                trace.tip_m[i] = tip + back * steps_ago;
            }
            trace.newest = HISTORY - 1;
            trace.written = (place - WRITE_LAG).floor();
        }
    }

    /// Changes bar and cut under the tools (they travel, material goes, edges wear).
    pub fn change(&mut self, cut: CutSettings, modes: &ModesAt) {
        let step_s = self.step_s;
        self.cut = cut;
        for (state, at) in self.modes.iter_mut().zip(&modes.bar) {
            state.set(*at, step_s);
        }
        if let (Some(state), Some(at)) = (&mut self.holder, modes.holder) {
            state.set(at, step_s);
        }
    }

    /// True for a tool that is there.
    fn cuts(&self, tool: usize) -> bool {
        tool == 0 || self.cut.tools == ToolCount::Two
    }

    /// Strikes the bar: adds a velocity to its first mode.
    pub fn strike(&mut self, velocity_m_s: f64) {
        if let Some(mode) = self.modes.first_mut() {
            mode.velocity_m_s += velocity_m_s;
        }
    }

    /// Displacement of the bar at the tools, toward tool 1, m.
    #[must_use]
    pub fn displacement_m(&self) -> f64 {
        self.modes.iter().map(|m| m.at.output * m.displacement_m).sum()
    }

    /// Radial force on tool 1 and tool 2, positive away from the bar, N.
    #[must_use]
    pub fn radial_force_n(&self) -> [f64; 2] {
        self.radial_force_n
    }

    /// Tangential force on tool 1 and tool 2, N.
    #[must_use]
    pub fn tangential_force_n(&self) -> [f64; 2] {
        self.radial_force_n.map(|f| f * self.cut.tangential_ratio)
    }

    /// Spindle angle since the start, turns.
    #[must_use]
    pub fn spindle_turns(&self) -> f64 {
        self.spindle_turns
    }

    fn surface_at(&self, place: f64) -> f64 {
        let cells = self.surface_m.len();
        let base = place.floor();
        let t = place - base;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 <= rem < cells")]
        let first = (base - 1.0).rem_euclid(cells as f64) as usize;
        let at = |k: usize| {
            let i = first + k;
            self.surface_m[if i >= cells { i - cells } else { i }]
        };
        // Catmull-Rom through the cells at -1, 0, 1, 2.
        let (p0, p1, p2, p3) = (at(0), at(1), at(2), at(3));
        p1 + 0.5 * t * (p2 - p0 + t * (2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3 + t * (3.0 * (p1 - p2) + p3 - p0)))
    }

    /// Bar and edges at the end of a step in which the forces go from `self.radial_force_n` to `after_n`.
    fn edges(&self, after_n: [f64; 2]) -> Edges {
        let before = self.radial_force_n;
        let bar = self.modes.iter().fold(Motion::default(), |sum, mode| {
            let to = mode.propagated(before[1] - before[0], after_n[1] - after_n[0]);
            Motion { m: sum.m + mode.at.output * to.m, m_s: sum.m_s + mode.at.output * to.m_s }
        });
        let holder =
            self.holder.as_ref().map_or(Motion::default(), |m| m.propagated(-before[1], -after_n[1]));
        Edges {
            into_m: [bar.m, holder.m + self.cut.tool2_ahead_m - bar.m],
            into_m_s: [bar.m_s, holder.m_s - bar.m_s],
        }
    }

    /// Chip of a tool: what stands above its tip, of which the memory of the surface is a share.
    fn chip_m(&self, tool: usize, above_tip_m: f64, into_m: f64, tips: &ToolTips) -> f64 {
        let overlap = self.cut.overlap;
        if (overlap - 1.0).abs() <= 0.0 {
            return above_tip_m;
        }
        let nominal = self.advance_m(tool, tips) + into_m - tips.retraction_m[tool];
        overlap * above_tip_m + (1.0 - overlap) * nominal
    }

    /// Force of the law through its lag (trapezoidal rule).
    fn lagged(&self, tool: usize, law_n: f64) -> f64 {
        let (lag_s, half_s) = (self.cut.force_lag_s, self.step_s / 2.0);
        if lag_s <= 0.0 {
            return law_n;
        }
        ((lag_s - half_s) * self.radial_force_n[tool] + half_s * (law_n + self.law_n[tool]))
            / (lag_s + half_s)
    }

    /// True turns over a step at that commanded speed.
    fn turned(&mut self, turns_per_s: f64) -> f64 {
        let half = turns_per_s * self.step_s / 2.0;
        let angle = TAU * (self.commanded_turns + half);
        self.commanded_turns += 2.0 * half;
        let factor: f64 = self.cut.physics.iter().map(|e| e.speed_factor(angle)).product();
        2.0 * half * factor
    }

    /// What the effects do to each tool at the angle that the work has now.
    fn at_angle(&self, tips: &ToolTips) -> [AtAngle; 2] {
        let mut now = [AtAngle::default(); 2];
        for effect in self.cut.physics.iter() {
            for (tool, now) in now.iter_mut().enumerate() {
                effect.modulate(TAU * (self.spindle_turns - lab_turns(tool, tips)), now);
            }
        }
        now
    }

    /// One step of integration. `noise` is one standard normal number a tool.
    pub fn step(&mut self, turns_per_s: f64, tips: &ToolTips, noise: [f64; 2]) {
        let turned = self.turned(turns_per_s);
        self.spindle_turns += turned;
        self.slope_speed_m_s = (PI * self.cut.diameter_m * turned / self.step_s).max(1e-6);
        let radius = -self.cut.feed_m_rev * self.spindle_turns;
        let places = [self.place(0, tips), self.place(1, tips)];
        let surface = [self.surface_at(places[0]), self.surface_at(places[1])];
        let at_angle = self.at_angle(tips);
        let (mut after, mut law) = (self.radial_force_n, self.law_n);
        let mut edges = Edges::default();
        // Predict with the old force, correct once: the chip depends on the motion within the step.
        for _ in 0..2 {
            edges = self.edges(after);
            for tool in 0..if self.cuts(1) { 2 } else { 1 } {
                let tip = radius - edges.into_m[tool] + tips.retraction_m[tool];
                let now = ToolNow {
                    chip_m: self.chip_m(tool, surface[tool] - tip, edges.into_m[tool], tips),
                    into_m: edges.into_m[tool],
                    slope: edges.into_m_s[tool] / self.slope_speed_m_s,
                    noise: noise[tool],
                    at_angle: at_angle[tool],
                };
                law[tool] = tips.engagement * self.cut.force_n(tool, &now);
                after[tool] = self.lagged(tool, law[tool]);
            }
        }
        let before = self.radial_force_n;
        for mode in &mut self.modes {
            mode.take(before[1] - before[0], after[1] - after[0]);
        }
        if let Some(holder) = &mut self.holder {
            holder.take(-before[1], -after[1]);
        }
        (self.radial_force_n, self.law_n) = (after, law);
        // Out of the cut the surface waits as the next entry will find it: smooth.
        let into_m = if tips.engagement > 0.0 {
            edges.into_m
        } else {
            let x = self.displacement_m();
            [x, self.cut.tool2_ahead_m - x]
        };
        for tool in 0..if self.cuts(1) { 2 } else { 1 } {
            self.leave(tool, places[tool], radius - into_m[tool] + tips.retraction_m[tool]);
        }
    }

    /// Removes what stands above the tip's path, a little behind the tool.
    fn leave(&mut self, tool: usize, place: f64, tip_m: f64) {
        let cells = self.surface_m.len();
        let trace = &mut self.traces[tool];
        trace.newest = (trace.newest + 1) % HISTORY;
        trace.place[trace.newest] = place;
        trace.tip_m[trace.newest] = tip_m;
        let until = (place - WRITE_LAG).floor();
        for back in 0..cells {
            let cell = until - back as f64;
            if cell <= trace.written {
                break;
            }
            let tip = trace.tip_at(cell);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 <= rem < cells")]
            let index = (cell.rem_euclid(cells as f64) as usize).min(cells - 1);
            self.surface_m[index] = self.surface_m[index].min(tip);
        }
        trace.written = trace.written.max(until);
    }
}

impl Trace {
    /// Tip at a cell that was passed within the last steps, linear between steps.
    fn tip_at(&self, cell: f64) -> f64 {
        let mut newer = self.newest;
        for _ in 1..HISTORY {
            let older = (newer + HISTORY - 1) % HISTORY;
            let (p0, p1) = (self.place[older], self.place[newer]);
            if cell >= p0 {
                let share = if p1 > p0 { (cell - p0) / (p1 - p0) } else { 1.0 };
                return self.tip_m[older] + share * (self.tip_m[newer] - self.tip_m[older]);
            }
            newer = older;
        }
        self.tip_m[newer]
    }
}
