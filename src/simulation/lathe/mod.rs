//! The virtual lathe: bar, two tools, two turrets with two servo axes each. It takes turret orders and
//! gives servo samples; it knows nothing of who listens.
//!
//! ```text
//! order -> turret path -> X1, Y1 drives -> tool 1 --\
//!                         X2, Y2 drives -> tool 2 ---> chips from the surface left -> forces -> drives
//!                                                       ^ bar bends <-----------------/   \-> samples
//! ```
//! Directions: X1 points from tool 1 toward the bar's axis; Y1 stands at 45 degrees to it, turned in the
//! sense in which a positive shift moves tool 1 around the bar. Turret 2 mirrors turret 1.

pub mod bar;
pub mod law;
pub mod mode;
pub mod process;
pub mod turret;
pub mod turret_axis;

use crate::plant::cut_loop::RANDOM_FORCE_CORNER_HZ;
use crate::plant::cut_terms::{CutCondition, CutTerms};
use crate::plant::scenario::{Scenario, ToolCount};
use crate::sample::{AxisSample, MAX_AXES, ServoSample};
use bar::Bar;
use law::CutSettings;
use process::{CuttingProcess, ToolTips};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::{FRAC_1_SQRT_2, TAU};
use turret::{Turret, TurretSettings};
use turret_axis::{AxisReport, AxisSettings, TurretAxis};

/// Names of the servo axes, in the order of the samples.
pub const AXES: [&str; 4] = ["x1", "y1", "x2", "y2"];
/// Name of the carriage that takes both tools along the bar. It follows [`AXES`] in the samples and reports
/// nothing but its scale: the distance of the tools from the chuck.
pub const CARRIAGE: &str = "z1";
/// Steps of the cutting process per sample: 9.3 us at 9 kHz.
const SUBSTEPS: usize = 12;
/// Air between two passes where they repeat, s.
pub const PAUSE_S: f64 = 2.0;

/// What the lathe is and does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LatheSettings {
    /// Bar, cut, spindle, tools.
    pub scenario: Scenario,
    /// Rate of control and samples, Hz.
    pub sample_rate_hz: f64,
    /// Seed of everything random.
    pub seed: u64,
    /// When the tools enter the cut, s; before, they turn in air. 0: in the cut from the start.
    pub entry_s: f64,
    /// Air between two passes, s: where the tools travel, they enter again at the place they started from
    /// once they have come to the end of the bar. `None`: one pass, and they stay in the cut at its end.
    pub pause_s: Option<f64>,
    /// Random part of the cutting force over the force, standard deviation; white to 2 kHz.
    pub force_noise_ratio: f64,
    /// Velocity with which the bar is struck at the start, m/s: a seed for growth where there is no noise.
    pub strike_m_s: f64,
    /// Whether the bar has its second bending mode.
    pub with_second_mode: bool,
    /// Whether the bar is thinner where the tools have passed; otherwise it stays the one that is stated.
    pub turned_down: bool,
    /// Whether the turrets are servo axes; otherwise they are rigid and the samples carry none.
    pub with_servo: bool,
    /// Speed and limits of turret 1's own control.
    pub turret: TurretSettings,
}

impl LatheSettings {
    /// An ideal cut of `scenario`: one mode, rigid turrets, no noise, a tap of 10 pm/s to start with: by the
    /// time vibration is visible, the rightmost root has left the others behind.
    ///
    /// Its small vibration follows the two-delay characteristic equation.
    #[must_use]
    pub fn ideal(scenario: Scenario) -> Self {
        Self {
            scenario,
            sample_rate_hz: 9000.0,
            seed: 1,
            entry_s: 0.0,
            pause_s: None,
            force_noise_ratio: 0.0,
            strike_m_s: 1.0e-11,
            with_second_mode: false,
            turned_down: false,
            with_servo: false,
            turret: TurretSettings::default(),
        }
    }

    /// A cut as a machine makes it: two modes, a bar that is turned down, servo turrets, 3 % random force,
    /// entry after 2 s of air.
    #[must_use]
    pub fn realistic(scenario: Scenario, seed: u64) -> Self {
        Self {
            seed,
            entry_s: 2.0,
            force_noise_ratio: 0.03,
            strike_m_s: 0.0,
            with_second_mode: true,
            turned_down: true,
            with_servo: true,
            ..Self::ideal(scenario)
        }
    }
}

/// What an ideal dynamometer and probe see at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Time, s.
    pub t_s: f64,
    /// Displacement of the bar toward tool 1, at the tools, m.
    pub workpiece_displacement_m: f64,
    /// Radial forces on tool 1 and tool 2, away from the bar, N.
    pub radial_force_n: [f64; 2],
    /// Tools from the chuck, m.
    pub tool_position_m: f64,
    /// Actual pitch difference, rad.
    pub pitch_difference_rad: f64,
    /// Spindle angle since the start, not wrapped, rad.
    pub spindle_angle_rad: f64,
    /// Width of cut of each tool; 0 out of the cut, m.
    pub width_m: f64,
}

/// The lathe in motion.
#[derive(Debug, Clone)]
pub struct Lathe {
    settings: LatheSettings,
    bar: Bar,
    process: CuttingProcess,
    axes: [TurretAxis; 4],
    turret: Turret,
    reports: [AxisReport; 4],
    random: ChaCha8Rng,
    random_force: [RandomForce; 2],
    samples: u64,
    tips: ToolTips,
    truth: Truth,
}

impl Lathe {
    /// A lathe whose tools stand at the scenario's position and pitch.
    #[must_use]
    pub fn new(settings: LatheSettings) -> Self {
        let scenario = &settings.scenario;
        let terms = CutTerms::of(scenario, &CutCondition::of(scenario));
        let cut = CutSettings::of(&terms, scenario.physics, settings.force_noise_ratio);
        let thinner = settings.turned_down && !is_zero(scenario.tools.travel_m_s());
        let removed = if thinner { cut.width_m } else { 0.0 };
        let bar = Bar::new(scenario.workpiece, removed, settings.with_second_mode);
        let step_s = 1.0 / (settings.sample_rate_hz * SUBSTEPS as f64);
        let modes = bar.modes_at(&terms);
        let mut process = CuttingProcess::new(cut, &modes, step_s, scenario.spindle.hz());
        let tips = ToolTips {
            shift_rad: scenario.tools.pitch_difference_rad() / 2.0,
            retraction_m: [0.0; 2],
            engagement: if settings.entry_s > 0.0 { 0.0 } else { 1.0 },
        };
        process.settle(&tips);
        process.strike(settings.strike_m_s);
        let axis = |settings_of: AxisSettings| TurretAxis::new(settings_of, settings.sample_rate_hz);
        let still = AxisReport { current_ref_a: 0.0, motor_angle_rad: 0.0, stage_position_m: None };
        let truth = Truth {
            t_s: 0.0,
            workpiece_displacement_m: process.displacement_m(),
            radial_force_n: process.radial_force_n(),
            tool_position_m: scenario.tools.position_m(),
            pitch_difference_rad: scenario.tools.pitch_difference_rad(),
            spindle_angle_rad: 0.0,
            width_m: cut.width_m * tips.engagement,
        };
        let mut random = ChaCha8Rng::seed_from_u64(settings.seed);
        let random_force = [0; 2].map(|_| RandomForce::new(step_s, &mut random));
        Self {
            bar,
            process,
            axes: [
                axis(AxisSettings::rolling(true)),
                axis(AxisSettings::sliding(true)),
                axis(AxisSettings::rolling(false)),
                axis(AxisSettings::sliding(false)),
            ],
            turret: Turret::new(settings.turret),
            reports: [still; 4],
            random,
            random_force,
            samples: 0,
            tips,
            truth,
            settings,
        }
    }

    /// Turret 1's own control: orders go in here.
    pub fn turret_mut(&mut self) -> &mut Turret {
        &mut self.turret
    }

    /// Turret 1's own control.
    #[must_use]
    pub fn turret(&self) -> &Turret {
        &self.turret
    }

    /// Actual offsets of X1 and Y1 from equal pitch, m.
    #[must_use]
    pub fn actual_offset_m(&self) -> [f64; 2] {
        if self.settings.with_servo {
            [self.axes[0].stage_position_m(), self.axes[1].stage_position_m()]
        } else {
            self.turret.offset_cmd_m()
        }
    }

    /// What is true now.
    #[must_use]
    pub fn truth(&self) -> &Truth {
        &self.truth
    }

    /// Settings it was made with.
    #[must_use]
    pub fn settings(&self) -> &LatheSettings {
        &self.settings
    }

    /// One sample period. Allocates only when bar or cut have changed.
    pub fn step(&mut self) -> ServoSample {
        let dt = 1.0 / self.settings.sample_rate_hz;
        self.samples += 1;
        self.turret.step(dt);
        self.travel();
        self.place_tips();
        self.change();
        let turns_per_s = self.settings.scenario.spindle.hz();
        let is_random = self.settings.force_noise_ratio > 0.0;
        for _ in 0..SUBSTEPS {
            let noise = if is_random {
                self.random_force.each_mut().map(|force| force.step(&mut self.random))
            } else {
                [0.0; 2]
            };
            self.process.step(turns_per_s, &self.tips, noise);
        }
        if self.settings.with_servo {
            self.drive_axes();
        }
        self.truth = Truth {
            t_s: self.samples as f64 * dt,
            workpiece_displacement_m: self.process.displacement_m(),
            radial_force_n: self.process.radial_force_n(),
            tool_position_m: self.truth.tool_position_m,
            pitch_difference_rad: 2.0 * self.tips.shift_rad,
            spindle_angle_rad: TAU * self.process.spindle_turns(),
            width_m: self.settings.scenario.cutting.raw().width_m * self.tips.engagement,
        };
        self.sample()
    }

    /// Speed of the tools along the bar, away from the chuck, m/s. At the free end there is only one way to
    /// feed.
    #[must_use]
    pub fn travel_m_s(&self) -> f64 {
        let (tools, length) = (&self.settings.scenario.tools, self.length_m());
        let at_end = tools.position_m() >= length * (1.0 - 1e-9);
        if at_end { -tools.travel_m_s().abs() } else { tools.travel_m_s() }
    }

    fn length_m(&self) -> f64 {
        self.settings.scenario.workpiece.projection_length_m()
    }

    /// How long the tools take to the end of the bar that they travel to, s; without end where they do not
    /// travel.
    #[must_use]
    pub fn pass_s(&self) -> f64 {
        let (from, speed) = (self.settings.scenario.tools.position_m(), self.travel_m_s());
        if is_zero(speed) {
            f64::INFINITY
        } else if speed < 0.0 {
            from / -speed
        } else {
            (self.length_m() - from) / speed
        }
    }

    /// How long the tools have been in this pass, and how long they are still in it, s: out of the cut before
    /// the one or after the other.
    fn in_pass_s(&self) -> [f64; 2] {
        let since_s = self.truth.t_s - self.settings.entry_s;
        let pass_s = self.pass_s();
        match self.settings.pause_s.filter(|_| since_s > 0.0 && pass_s.is_finite()) {
            Some(pause_s) => {
                let since_s = since_s.rem_euclid(pass_s + pause_s);
                [since_s, pass_s - since_s]
            }
            None => [since_s, f64::INFINITY],
        }
    }

    /// Moves the tools along the bar while they are in the cut, and back while they are not.
    fn travel(&mut self) {
        let (speed, [since_s, left_s]) = (self.travel_m_s(), self.in_pass_s());
        if is_zero(speed) || since_s < 0.0 {
            return;
        }
        let cutting_s = if left_s > 0.0 { since_s } else { 0.0 };
        let from = self.settings.scenario.tools.position_m();
        self.truth.tool_position_m = (from + speed * cutting_s).clamp(0.0, self.length_m());
    }

    /// Bar and cut as position and time have changed them: in each sample, because a bar that changes in
    /// steps is struck by each of them.
    fn change(&mut self) {
        let scenario = &self.settings.scenario;
        let still = is_zero(self.travel_m_s()) && scenario.physics.is_empty();
        if still {
            return;
        }
        let at = CutCondition {
            position_m: self.truth.tool_position_m,
            time_s: self.truth.t_s,
            edge_age_s: self.truth.t_s,
            ..CutCondition::of(scenario)
        };
        let terms = CutTerms::of(scenario, &at);
        let cut = CutSettings::of(&terms, scenario.physics, self.settings.force_noise_ratio);
        self.process.change(cut, &self.bar.modes_at(&terms));
    }

    /// Where the tips are: order and scenario around the bar, entry over one turn.
    fn place_tips(&mut self) {
        let radius = self.settings.scenario.workpiece.diameter_m() / 2.0;
        let [u, w] = self.actual_offset_m();
        // Toward the axis and around the bar, from the axes' own directions.
        let toward = u + w * FRAC_1_SQRT_2;
        let around = w * FRAC_1_SQRT_2;
        let shift = around.atan2(radius - toward);
        let scenario = &self.settings.scenario;
        self.tips.shift_rad = scenario.tools.pitch_difference_rad() / 2.0 + shift;
        self.tips.retraction_m = [around.hypot(radius - toward) - radius, 0.0];
        let two = scenario.tools.count() == ToolCount::Two;
        if two && self.settings.with_servo {
            let [u2, w2] = [self.axes[2].stage_position_m(), self.axes[3].stage_position_m()];
            self.tips.retraction_m[1] = -(u2 + w2 * FRAC_1_SQRT_2);
        }
        let [since_s, left_s] = self.in_pass_s();
        // Without air before it, the first pass begins in the cut.
        let no_entry = self.settings.entry_s <= 0.0 && since_s >= self.truth.t_s;
        let turns = if no_entry { left_s } else { since_s.min(left_s) } * scenario.spindle.hz();
        self.tips.engagement = turns.clamp(0.0, 1.0);
    }

    /// Forces on the axes: what each drive has to hold is the force along its own direction.
    fn drive_axes(&mut self) {
        let radial = self.process.radial_force_n();
        let tangential = self.process.tangential_force_n();
        let cmd = self.turret.offset_cmd_m();
        for turret in 0..2 {
            let along_y = (radial[turret] + tangential[turret]) * FRAC_1_SQRT_2;
            let cmd = if turret == 0 { cmd } else { [0.0; 2] };
            let first = 2 * turret;
            let noise: [f64; 2] = std::array::from_fn(|_| StandardNormal.sample(&mut self.random));
            self.reports[first] = self.axes[first].step(cmd[0], radial[turret], noise[0]);
            self.reports[first + 1] = self.axes[first + 1].step(cmd[1], along_y, noise[1]);
        }
    }

    fn sample(&self) -> ServoSample {
        let mut axes = [AxisSample::default(); MAX_AXES];
        for (axis, report) in axes.iter_mut().zip(&self.reports) {
            *axis = AxisSample {
                current_ref_a: report.current_ref_a,
                motor_angle_rad: report.motor_angle_rad,
                stage_position_m: report.stage_position_m,
            };
        }
        axes[AXES.len()].stage_position_m = Some(self.truth.tool_position_m);
        ServoSample {
            sequence: self.samples,
            t_s: self.truth.t_s,
            axes,
            spindle_angle_rad: self.process.spindle_turns().fract() * TAU,
            spindle_speed_rpm: self.settings.scenario.spindle.rpm(),
            accel_m_s2: None,
            pitch_difference_rad: None,
        }
    }
}

/// Random part of a force over its standard deviation: of first order, white to its corner, whatever the rate
/// of the samples. A number drawn once a sample and held would show in the force half a sample later than in
/// the motion that it drives.
#[derive(Debug, Clone, Copy)]
struct RandomForce {
    now: f64,
    /// What is left of it after a step, and how much of a fresh number comes to it.
    kept: f64,
    added: f64,
}

impl RandomForce {
    fn new(step_s: f64, random: &mut ChaCha8Rng) -> Self {
        let kept = (-TAU * RANDOM_FORCE_CORNER_HZ * step_s).exp();
        Self { now: StandardNormal.sample(random), kept, added: (1.0 - kept * kept).sqrt() }
    }

    fn step(&mut self, random: &mut ChaCha8Rng) -> f64 {
        let fresh: f64 = StandardNormal.sample(random);
        self.now = self.kept * self.now + self.added * fresh;
        self.now
    }
}

fn is_zero(x: f64) -> bool {
    x.abs() < f64::MIN_POSITIVE
}
