//! An independent generator of force streams with known chatter: a bar between two tools, and the surface that
//! each tool leaves, stored by angle. It shares no equation and no code with the crate.
//!
//! ```text
//! m x'' + c x' + k x = -F1 + F2 + hits + rough,   F = K h + C x'/v where the tool is in contact
//! chip of a tool = feed since the other tool passed + surface left there - surface cut now
//! ```
//! Tool 2 stands half a turn and the pitch difference behind tool 1. The force of tool 1 goes through a
//! low-pass of first order; orders, tones, coloured and servo noise are added to it.

use std::f64::consts::{PI, TAU};

/// Samples a second of what is made.
pub(crate) const RATE_HZ: f64 = 9000.0;
const FINE: usize = 4;
const CELLS: usize = 2048;
/// Force per depth of cut of one tool, N/m, and of its flank, N per unit slope.
const CUT_N_M: f64 = 0.5e6;
const FLANK_N: f64 = 60.0;
const FEED_M: f64 = 0.15e-3;
const DAMPING: f64 = 0.012;
const LENGTH_S: f64 = 14.0;

/// Noise and other numbers from a seed.
pub(crate) struct Random(u64);

impl Random {
    /// From a seed.
    pub(crate) fn new(seed: u64) -> Self {
        let mut random = Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x5851_f42d_4c95_7f2d);
        for _ in 0..8 {
            random.uniform();
        }
        random
    }

    /// Between 0 and 1.
    pub(crate) fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Between two numbers.
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Of unit variance.
    pub(crate) fn normal(&mut self) -> f64 {
        let u = self.uniform().max(1e-300);
        (-2.0 * u.ln()).sqrt() * (TAU * self.uniform()).cos()
    }
}

/// What a stream holds beside the cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Stable pitch throughout.
    Stable,
    /// Stable, then equal pitch from some moment on, then stable again.
    Chatter,
    /// Equal pitch as the tools enter a second time, after a stable pass.
    ChatterAtEntry,
    /// Stable, while the bar is struck again and again.
    Hits,
    /// Stable, the speed rises, an order is switched on.
    Orders,
    /// Stable, narrow noise of a servo from the moment of the entry, a tone from the start.
    Servo,
}

/// A stretch of chatter.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Episode {
    /// Equal pitch since, s.
    pub(crate) unstable_s: f64,
    /// When the bar's vibration passed thrice its stable level for good, s.
    pub(crate) onset_s: f64,
    /// When it was back below, s.
    pub(crate) end_s: f64,
}

/// A stream with its truth.
pub(crate) struct Stream {
    /// Force of tool 1, N.
    pub(crate) force_n: Vec<f64>,
    /// Spindle speed, rpm.
    pub(crate) speed_rpm: Vec<f64>,
    /// Where the bar can chatter, Hz.
    pub(crate) band_hz: [f64; 2],
    /// Chatter.
    pub(crate) episodes: Vec<Episode>,
}

struct Schedule {
    kind: Kind,
    enter_s: f64,
    again_s: f64,
    equal_s: [f64; 2],
    natural_hz: f64,
    stiffness_n_m: f64,
    speed_rpm: f64,
}

impl Schedule {
    fn new(kind: Kind, random: &mut Random) -> Self {
        let equal = random.between(6.0, 8.0);
        Self {
            kind,
            enter_s: random.between(0.8, 1.2),
            again_s: if kind == Kind::ChatterAtEntry { equal } else { f64::INFINITY },
            equal_s: [equal, equal + random.between(1.5, 3.0)],
            natural_hz: random.between(480.0, 620.0),
            stiffness_n_m: random.between(1.2e6, 2.2e6),
            speed_rpm: random.between(800.0, 1600.0),
        }
    }

    fn chatters(&self) -> bool {
        matches!(self.kind, Kind::Chatter | Kind::ChatterAtEntry)
    }

    fn speed_hz(&self, t: f64) -> f64 {
        let rise = if self.kind == Kind::Orders { 0.08 * ((t - 4.0) / 6.0).clamp(0.0, 1.0) } else { 0.0 };
        self.speed_rpm * (1.0 + rise) / 60.0
    }

    /// Depth of cut over the nominal: in over two turns, out for a third of a second before the second entry.
    fn depth(&self, t: f64) -> f64 {
        let ramp = |from: f64| ((t - from) * self.speed_rpm / 120.0).clamp(0.0, 1.0);
        if t < self.again_s { ramp(self.enter_s) - ramp(self.again_s - 0.4) } else { ramp(self.again_s) }
    }

    /// Shift of tool 2 from half a turn: a quarter of a wave of the expected chatter, or none.
    fn shift_rad(&self, t: f64) -> f64 {
        let best = 0.5 * PI * self.speed_hz(t) / (1.2 * self.natural_hz);
        let [from, to] = self.equal_s;
        let equal = self.chatters() && (from..to).contains(&t);
        if equal { 0.0 } else { best }
    }
}

/// The surface by angle; what was cut last stands there.
struct Surface(Vec<f64>);

impl Surface {
    fn read(&self, turn: f64) -> f64 {
        let place = turn.rem_euclid(1.0) * CELLS as f64;
        let (low, part) = (place as usize % CELLS, place.fract());
        self.0[low] * (1.0 - part) + self.0[(low + 1) % CELLS] * part
    }

    fn write(&mut self, turns: [f64; 2], value: f64) {
        let mut cell = (turns[0] * CELLS as f64).floor() as i64;
        let last = (turns[1] * CELLS as f64).floor() as i64;
        while cell < last {
            cell += 1;
            self.0[cell.rem_euclid(CELLS as i64) as usize] = value;
        }
    }
}

/// Displacement of the bar, m, and force of tool 1, N, at the fine rate.
fn simulate(plan: &Schedule, random: &mut Random) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
    let rate = RATE_HZ * FINE as f64;
    let (dt, count) = (1.0 / rate, (LENGTH_S * rate) as usize);
    let w = TAU * plan.natural_hz;
    let mass = plan.stiffness_n_m / (w * w);
    let damping = 2.0 * DAMPING * (plan.stiffness_n_m * mass).sqrt();
    let (mut x, mut v, mut turn) = (0.0_f64, 0.0_f64, 0.0_f64);
    // Height of the material over the bar's centre, and what has been fed since: each tool feeds as it passes.
    let mut surface = Surface(vec![0.0; CELLS]);
    let (mut xs, mut forces, mut turns) = (Vec::new(), Vec::new(), Vec::new());
    let (mut hit_n, mut hit_s) = (0.0, 2.5);
    for n in 0..count {
        let t = n as f64 * dt;
        let before = turn;
        turn += plan.speed_hz(t) * dt;
        let fed = FEED_M * turn;
        let depth = plan.depth(t);
        let second = 0.5 + plan.shift_rad(t) / TAU;
        let mut force = [0.0; 2];
        for (i, (behind, side)) in [(0.0, 1.0), (second, -1.0)].into_iter().enumerate() {
            // Coordinates fixed to the material; height h(angle) = what is left, lower as it is fed.
            let now = -fed - side * x;
            let was = surface.read(turn - behind + 2.0 / CELLS as f64);
            let chip = was - now;
            if depth > 0.0 && chip > 0.0 {
                let slope = side * v / (PI * 0.024 * plan.speed_hz(t));
                force[i] = depth * (CUT_N_M * chip + FLANK_N * slope).max(0.0);
                surface.write([before - behind, turn - behind], now);
            }
        }
        if depth == 0.0 {
            surface.0.fill(-fed - FEED_M);
        }
        if plan.kind == Kind::Hits && t > hit_s {
            hit_s = t + random.between(0.05, 0.9);
            hit_n = random.between(100.0, 1500.0);
        }
        let rough = 3.0 * random.normal() * depth;
        let push = force[1] - force[0] + rough + std::mem::take(&mut hit_n);
        v += dt * (push - damping * v - plan.stiffness_n_m * x) / mass;
        x += dt * v;
        xs.push(x);
        forces.push(force[0]);
        turns.push(turn);
    }
    (xs, forces, turns)
}

/// Amplitude of what is at a band's middle, smoothed over 20 ms, every millisecond.
fn envelope(xs: &[f64], band_hz: [f64; 2]) -> Vec<f64> {
    let rate = RATE_HZ * FINE as f64;
    let every = (rate / 1000.0) as usize;
    // A mixer and two smoothings of 5 ms: the bar's line is the only loud one.
    let centre = (band_hz[0] + band_hz[1]) / 2.0;
    let share = 1.0 / (0.003 * rate);
    let (mut a, mut b, mut slow) = ([0.0; 2], [0.0; 2], xs[0]);
    let mut out = Vec::new();
    for (n, x) in xs.iter().enumerate() {
        slow += (x - slow) / (0.002 * rate);
        let phase = TAU * centre * n as f64 / rate;
        for (i, wave) in [phase.cos(), phase.sin()].into_iter().enumerate() {
            a[i] += (2.0 * (x - slow) * wave - a[i]) * share;
            b[i] += (a[i] - b[i]) * share;
        }
        if n % every == 0 {
            out.push(b[0].hypot(b[1]));
        }
    }
    out
}

/// The stretch in which the bar chatters, if it does.
fn episode(plan: &Schedule, xs: &[f64], band_hz: [f64; 2]) -> Option<Episode> {
    if !plan.chatters() {
        return None;
    }
    let level = envelope(xs, band_hz);
    let [from, to] = plan.equal_s.map(|s| (s * 1000.0) as usize);
    let mut stable = level[2500..5500].to_vec();
    stable.sort_by(f64::total_cmp);
    let least = 3.0 * stable[stable.len() / 2];
    let most = level[from..to].iter().copied().fold(0.0, f64::max);
    if most < 2.0 * least {
        return None;
    }
    let half = from + level[from..].iter().position(|l| *l > most / 2.0)?;
    let onset = from + level[from..half].iter().rposition(|l| *l < least).unwrap_or(0);
    let end = to + level[to..].iter().position(|l| *l < least)?;
    let s = |ms: usize| ms as f64 / 1000.0;
    Some(Episode { unstable_s: plan.equal_s[0], onset_s: s(onset), end_s: s(end) })
}

/// A cut that is what its kind says: drawn until it is. Chatter is at least six times the stable level and gone
/// half a second after its cause for good; a stable cut stays within three times its own level.
fn drawn(kind: Kind, random: &mut Random) -> (Schedule, [Vec<f64>; 3], [f64; 2], Vec<Episode>) {
    loop {
        let plan = Schedule::new(kind, random);
        let (xs, forces, turns) = simulate(&plan, random);
        let band_hz = [0.93 * plan.natural_hz, 1.42 * plan.natural_hz];
        let level = envelope(&xs, band_hz);
        let mut stable = level[2500..5500].to_vec();
        stable.sort_by(f64::total_cmp);
        let least = 3.0 * stable[stable.len() / 2];
        let found = episode(&plan, &xs, band_hz);
        let after = if plan.chatters() { 1000.0 * (plan.equal_s[1] + 0.5) } else { 2500.0 } as usize;
        let quiet = plan.kind == Kind::Hits || level[after..].iter().all(|l| *l < 1.5 * least);
        if quiet && found.is_some() == plan.chatters() {
            return (plan, [xs, forces, turns], band_hz, found.into_iter().collect());
        }
    }
}

/// One stream.
pub(crate) fn stream(kind: Kind, seed: u64) -> Stream {
    let mut random = Random::new(seed);
    let (plan, [_, forces, turns], band_hz, episodes) = drawn(kind, &mut random);
    let orders: Vec<[f64; 3]> = (0..10)
        .map(|_| {
            let order = (random.between(band_hz[0], band_hz[1]) * 60.0 / plan.speed_rpm).round();
            [order, random.between(0.3, 3.0), random.between(0.0, TAU)]
        })
        .collect();
    let noise_n = random.between(0.5, 2.0);
    let tone = [random.between(band_hz[0], band_hz[1]), random.between(1.0, 4.0)];
    let servo = [random.between(band_hz[0] + 30.0, band_hz[1] - 30.0), random.between(2.0, 8.0)];
    let (mut low, mut last, mut colour) = (0.0, 0.0, [0.0; 2]);
    let (mut force_n, mut speed_rpm) = (Vec::new(), Vec::new());
    let pole = (-PI * 30.0 / RATE_HZ).exp();
    for n in 0..forces.len() / FINE {
        let t = n as f64 / RATE_HZ;
        let raw = forces[n * FINE..(n + 1) * FINE].iter().sum::<f64>() / FINE as f64;
        low += (raw - low) * (1.0 - (-TAU * 1000.0 / RATE_HZ).exp());
        let depth = plan.depth(t);
        let mut more = 0.0;
        for (i, [order, size, phase]) in orders.iter().enumerate() {
            let late = plan.kind == Kind::Orders && i == 0;
            let on = if late { 4.0 * f64::from(u8::from(t > 11.0)) } else { depth };
            more += on * size * (TAU * order * turns[n * FINE] + phase).cos();
        }
        if plan.kind == Kind::Servo {
            let next = 2.0 * pole * (TAU * servo[0] / RATE_HZ).cos() * colour[0] - pole * pole * colour[1]
                + random.normal();
            colour = [next, colour[0]];
            // Variance of the two-pole noise is about 1/(2 (1 - pole)) for unit input, by two.
            more += depth * servo[1] * next * (2.0 * (1.0 - pole)).sqrt() * 1.4;
            more += tone[1] * (TAU * tone[0] * t).cos();
        }
        // Of an encoder: rises with the frequency; 0.2 of the rate's noise lies in the band.
        let white = random.normal();
        more += noise_n * (1.5 * (white - last) + white);
        last = white;
        force_n.push(low + more + 2.0 * (TAU * 0.1 * t).sin());
        speed_rpm.push(60.0 * plan.speed_hz(t));
    }
    Stream { force_n, speed_rpm, band_hz, episodes }
}
