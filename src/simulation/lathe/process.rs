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

use std::f64::consts::{PI, TAU};

/// Bending mode of the bar at one position of the tools.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModeAt {
    /// Modal mass referred to the free end, kg.
    pub mass_kg: f64,
    /// Natural frequency, Hz.
    pub frequency_hz: f64,
    /// Damping ratio.
    pub damping_ratio: f64,
    /// Mode shape at the tools, 1 at the free end.
    pub shape: f64,
}

/// Constants of the cut. SI units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutSettings {
    /// K = K_r b: radial force per chip thickness of one tool, N/m.
    pub cutting_stiffness_n_m: f64,
    /// C_i: radial force per unit slope of the surface, N.
    pub process_damping_n: f64,
    /// Diameter that sets the cutting speed, m.
    pub diameter_m: f64,
    /// Feed per turn shared by the tools, m.
    pub feed_m_rev: f64,
    /// tan of the clearance angle.
    pub clearance_slope: f64,
    /// Force per unit slope beyond the clearance, N.
    pub flank_force_n: f64,
    /// Random part of the radial force over the force, standard deviation.
    pub force_noise_ratio: f64,
    /// Tangential over radial force.
    pub tangential_ratio: f64,
}

/// Where the two tool tips are, now.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ToolTips {
    /// Angle by which tool 1 is shifted against the turn, half the pitch difference, rad.
    pub shift_rad: f64,
    /// Radial retraction of tool 1 and tool 2 from the programmed radius, m.
    pub retraction_m: [f64; 2],
    /// Share of the width that is in the cut, 0 to 1 (entry at the end face).
    pub engagement: f64,
}

/// Points of the stored surface per turn at the nominal speed and step: a step passes about 1.5.
const CELLS_PER_STEP: f64 = 1.5;
/// Cells between a tool and the surface it writes, so that the cubic read sees the old surface.
const WRITE_LAG: f64 = 2.5;
const HISTORY: usize = 16;

/// One mode's motion with its exact propagation over one step (force linear within the step).
#[derive(Debug, Clone, PartialEq)]
struct ModeState {
    at: ModeAt,
    displacement_m: f64,
    velocity_m_s: f64,
    transition: [[f64; 2]; 2],
    hold: [f64; 2],
    ramp: [f64; 2],
}

impl ModeState {
    fn new(at: ModeAt, step_s: f64) -> Self {
        let mut state = Self {
            at,
            displacement_m: 0.0,
            velocity_m_s: 0.0,
            transition: [[0.0; 2]; 2],
            hold: [0.0; 2],
            ramp: [0.0; 2],
        };
        state.set(at, step_s);
        state
    }

    /// Exact response of m q'' + c q' + k q = F0 + (F1 - F0) t/h over one step h, in closed form.
    fn set(&mut self, at: ModeAt, step_s: f64) {
        self.at = at;
        let omega = TAU * at.frequency_hz;
        let sigma = at.damping_ratio * omega;
        let damped = omega * (1.0 - at.damping_ratio * at.damping_ratio).max(1e-12).sqrt();
        let decay = (-sigma * step_s).exp();
        let (sin, cos) = (damped * step_s).sin_cos();
        let a11 = decay * (cos + sigma / damped * sin);
        let a12 = decay * sin / damped;
        let a21 = -omega * omega * a12;
        let a22 = decay * (cos - sigma / damped * sin);
        self.transition = [[a11, a12], [a21, a22]];
        // Particular solution for F = F0 + r t: q = F0/k - c r/k^2 + r t/k.
        let k = at.mass_kg * omega * omega;
        let c = 2.0 * sigma * at.mass_kg;
        let step_response = [(1.0 - a11) / k, -a21 / k];
        // r = 1/h: q_p = -c/(k^2 h) + t/(k h), starting from rest.
        let (q0, v0) = (-c / (k * k * step_s), 1.0 / (k * step_s));
        let ramp = [q0 + 1.0 / k - (a11 * q0 + a12 * v0), v0 - (a21 * q0 + a22 * v0)];
        self.hold = [step_response[0] - ramp[0], step_response[1] - ramp[1]];
        self.ramp = ramp;
    }

    fn propagated(&self, force_before_n: f64, force_after_n: f64) -> (f64, f64) {
        let (f0, f1) = (force_before_n * self.at.shape, force_after_n * self.at.shape);
        let [[a11, a12], [a21, a22]] = self.transition;
        let (q, v) = (self.displacement_m, self.velocity_m_s);
        (
            a11 * q + a12 * v + self.hold[0] * f0 + self.ramp[0] * f1,
            a21 * q + a22 * v + self.hold[1] * f0 + self.ramp[1] * f1,
        )
    }
}

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
    surface_m: Vec<f64>,
    traces: [Trace; 2],
    spindle_turns: f64,
    force_on_bar_n: f64,
    radial_force_n: [f64; 2],
    slope_speed_m_s: f64,
}

impl CuttingProcess {
    /// A process in steady cutting at equal pitch, at rest.
    ///
    /// `step_s` is the step of integration; `turns_per_s` the nominal spindle speed, which sets how
    /// finely the surface is stored.
    #[must_use]
    pub fn new(cut: CutSettings, modes: &[ModeAt], step_s: f64, turns_per_s: f64) -> Self {
        let cells = (CELLS_PER_STEP / (turns_per_s * step_s)).ceil().clamp(256.0, 65_536.0);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped above")]
        let cells = cells as usize;
        let mut process = Self {
            cut,
            step_s,
            modes: modes.iter().map(|m| ModeState::new(*m, step_s)).collect(),
            surface_m: vec![0.0; cells],
            traces: std::array::from_fn(|_| Trace {
                place: [0.0; HISTORY],
                tip_m: [0.0; HISTORY],
                newest: 0,
                written: 0.0,
            }),
            spindle_turns: 0.0,
            force_on_bar_n: 0.0,
            radial_force_n: [0.0; 2],
            slope_speed_m_s: PI * cut.diameter_m * turns_per_s,
        };
        process.settle(&ToolTips::default());
        process
    }

    /// Cell coordinate of a tool: grows as the bar turns.
    fn place(&self, tool: usize, tips: &ToolTips) -> f64 {
        // Tool 2 stands at lab angle 0, tool 1 at pi - shift, ahead of it in the sense of the turn.
        let lab_turns = if tool == 0 { 0.5 - tips.shift_rad / TAU } else { 0.0 };
        (self.spindle_turns - lab_turns) * self.surface_m.len() as f64
    }

    /// Puts surface and bar into the steady state of these tips: what long stable cutting leaves.
    pub fn settle(&mut self, tips: &ToolTips) {
        let lead = 0.5 - tips.shift_rad / TAU; // share of a turn from tool 2 to tool 1
        let h0 = [self.cut.feed_m_rev * lead, self.cut.feed_m_rev * (1.0 - lead)];
        let stiffness = self.cut.cutting_stiffness_n_m * tips.engagement;
        // Static balance: k_at_tool x = K (h2 - h1), h1 = h01 + 2x, h2 = h02 - 2x.
        let compliance: f64 = self
            .modes
            .iter()
            .map(|m| m.at.shape.powi(2) / (m.at.mass_kg * (TAU * m.at.frequency_hz).powi(2)))
            .sum();
        let x = compliance * stiffness * (h0[1] - h0[0]) / (1.0 + 4.0 * stiffness * compliance);
        let force = stiffness * ((h0[1] - 2.0 * x) - (h0[0] + 2.0 * x));
        for mode in &mut self.modes {
            mode.displacement_m =
                force * mode.at.shape / (mode.at.mass_kg * (TAU * mode.at.frequency_hz).powi(2));
            mode.velocity_m_s = 0.0;
        }
        self.force_on_bar_n = force;
        self.radial_force_n = [stiffness * (h0[0] + 2.0 * x), stiffness * (h0[1] - 2.0 * x)];
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
            let (s1, s2) = (since(0), since(1));
            self.surface_m[cell] = if s1 < s2 {
                radius + self.cut.feed_m_rev * s1 - x + tips.retraction_m[0]
            } else {
                radius + self.cut.feed_m_rev * s2 + x + tips.retraction_m[1]
            };
        }
        for (tool, place) in places.into_iter().enumerate() {
            let tip = radius + if tool == 0 { -x } else { x } + tips.retraction_m[tool];
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

    /// Changes the bar under the tools (they travel, material goes).
    pub fn set_modes(&mut self, modes: &[ModeAt]) {
        let step_s = self.step_s;
        for (state, at) in self.modes.iter_mut().zip(modes) {
            state.set(*at, step_s);
        }
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
        self.modes.iter().map(|m| m.at.shape * m.displacement_m).sum()
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

    /// Radial force of one tool: chip, process damping, flank. Zero without contact.
    fn tool_force_n(&self, chip_m: f64, approach_m_s: f64, engagement: f64, noise: f64) -> f64 {
        if chip_m <= 0.0 {
            return 0.0;
        }
        let slope = approach_m_s / self.slope_speed_m_s;
        let flank = self.cut.flank_force_n * (slope - self.cut.clearance_slope).max(0.0);
        let chip = self.cut.cutting_stiffness_n_m * chip_m * (1.0 + self.cut.force_noise_ratio * noise);
        engagement * (chip + self.cut.process_damping_n * slope + flank)
    }

    /// One step of integration. `noise` is one standard normal number a tool.
    pub fn step(&mut self, turns_per_s: f64, tips: &ToolTips, noise: [f64; 2]) {
        self.spindle_turns += turns_per_s * self.step_s;
        self.slope_speed_m_s = (PI * self.cut.diameter_m * turns_per_s).max(1e-6);
        let radius = -self.cut.feed_m_rev * self.spindle_turns;
        let places = [self.place(0, tips), self.place(1, tips)];
        let surface = [self.surface_at(places[0]), self.surface_at(places[1])];
        let before = self.force_on_bar_n;
        let mut after = before;
        let mut moved = (0.0, 0.0);
        // Predict with the old force, correct once: the chip depends on the motion within the step.
        for _ in 0..2 {
            moved = self.modes.iter().fold((0.0, 0.0), |(x, v), m| {
                let (q, dq) = m.propagated(before, after);
                (x + m.at.shape * q, v + m.at.shape * dq)
            });
            let (x, v) = moved;
            let tip = [radius - x + tips.retraction_m[0], radius + x + tips.retraction_m[1]];
            let force = [
                self.tool_force_n(surface[0] - tip[0], v, tips.engagement, noise[0]),
                self.tool_force_n(surface[1] - tip[1], -v, tips.engagement, noise[1]),
            ];
            self.radial_force_n = force;
            after = force[1] - force[0];
        }
        for mode in &mut self.modes {
            (mode.displacement_m, mode.velocity_m_s) = mode.propagated(before, after);
        }
        self.force_on_bar_n = after;
        if tips.engagement > 0.0 {
            self.leave(0, places[0], radius - moved.0 + tips.retraction_m[0]);
            self.leave(1, places[1], radius + moved.0 + tips.retraction_m[1]);
        } else {
            self.settle_surface_only(places, radius, tips);
        }
    }

    /// Out of the cut the surface waits as the next entry will find it: smooth.
    fn settle_surface_only(&mut self, places: [f64; 2], radius: f64, tips: &ToolTips) {
        let x = self.displacement_m();
        for (tool, place) in places.into_iter().enumerate() {
            let tip = radius + if tool == 0 { -x } else { x } + tips.retraction_m[tool];
            self.leave(tool, place, tip);
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
