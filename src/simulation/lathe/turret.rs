//! Turret 1 obeys offset orders: with a finite speed, only while they are fresh, never twice.
//!
//! The receiver's rules stand here and not in the sender: an order expires, and then the turret goes
//! back to equal pitch by itself; an order that is old, repeated or out of sequence changes nothing.

/// An order to stand at an offset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TurretOrder {
    /// Life of the sender; grows with each start.
    pub epoch: u64,
    /// Number of the order within its epoch.
    pub sequence: u64,
    /// Offsets of axes X1 and Y1 from equal pitch, m.
    pub offset_m: [f64; 2],
    /// How long the order holds, s.
    pub ttl_s: f64,
}

/// What the turret is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TurretState {
    /// It stands where the last order says (or at equal pitch without one).
    Reached,
    /// It is on its way.
    Moving,
    /// The order expired: it goes back to equal pitch.
    Expired,
    /// An interlock is open: it does not move.
    Blocked,
}

/// Speed and limits of the turret's own control.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TurretSettings {
    /// Largest speed of an offset, m/s.
    pub speed_m_s: f64,
    /// Largest acceleration of an offset, m/s2.
    pub accel_m_s2: f64,
    /// Largest offset that the controller takes, m.
    pub largest_offset_m: f64,
}

impl Default for TurretSettings {
    /// 2 mm/s, 50 mm/s2 and 2 mm: 0.47 mm take about 0.3 s and do not excite the bar.
    fn default() -> Self {
        Self { speed_m_s: 2.0e-3, accel_m_s2: 50.0e-3, largest_offset_m: 2.0e-3 }
    }
}

/// Path generator of one turret.
#[derive(Debug, Clone, PartialEq)]
pub struct Turret {
    settings: TurretSettings,
    accepted: Option<(u64, u64)>,
    refused: u64,
    target_m: [f64; 2],
    remaining_s: f64,
    position_m: [f64; 2],
    speed_m_s: f64,
    interlock_open: bool,
    expired: bool,
}

impl Turret {
    /// At equal pitch, nothing ordered.
    #[must_use]
    pub fn new(settings: TurretSettings) -> Self {
        Self {
            settings,
            accepted: None,
            refused: 0,
            target_m: [0.0; 2],
            remaining_s: 0.0,
            position_m: [0.0; 2],
            speed_m_s: 0.0,
            interlock_open: false,
            expired: false,
        }
    }

    /// Takes or refuses an order. Returns whether it counts from now on.
    pub fn order(&mut self, order: &TurretOrder) -> bool {
        let id = (order.epoch, order.sequence);
        let inside =
            order.offset_m.iter().all(|o| o.is_finite() && o.abs() <= self.settings.largest_offset_m);
        let newer = self.accepted.is_none_or(|last| id > last);
        if !(inside && newer && order.ttl_s.is_finite() && order.ttl_s > 0.0) {
            self.refused += 1;
            return false;
        }
        self.accepted = Some(id);
        self.target_m = order.offset_m;
        self.remaining_s = order.ttl_s;
        self.expired = false;
        true
    }

    /// Opens or closes the interlock: open, nothing moves.
    pub fn set_interlock(&mut self, open: bool) {
        self.interlock_open = open;
    }

    /// Whether the interlock is open.
    #[must_use]
    pub fn interlock_open(&self) -> bool {
        self.interlock_open
    }

    /// Commanded offsets now, m.
    #[must_use]
    pub fn offset_cmd_m(&self) -> [f64; 2] {
        self.position_m
    }

    /// (epoch, sequence) of the last accepted order.
    #[must_use]
    pub fn accepted(&self) -> Option<(u64, u64)> {
        self.accepted
    }

    /// Orders refused so far.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// What it is doing.
    #[must_use]
    pub fn state(&self) -> TurretState {
        if self.interlock_open {
            TurretState::Blocked
        } else if self.expired {
            TurretState::Expired
        } else if self.position_m == self.target_m {
            TurretState::Reached
        } else {
            TurretState::Moving
        }
    }

    /// One control period of `dt_s`: moves both offsets along the straight line to the target.
    pub fn step(&mut self, dt_s: f64) {
        if self.accepted.is_some() && !self.expired {
            self.remaining_s -= dt_s;
            if self.remaining_s <= 0.0 {
                self.expired = true;
                self.target_m = [0.0; 2];
            }
        }
        if self.interlock_open {
            self.speed_m_s = 0.0;
            return;
        }
        let way = [self.target_m[0] - self.position_m[0], self.target_m[1] - self.position_m[1]];
        let distance = way[0].hypot(way[1]);
        if distance <= 1.0e-12 {
            self.position_m = self.target_m;
            self.speed_m_s = 0.0;
            return;
        }
        // Trapezoid: speed up, hold, slow down in time.
        let stopping = (2.0 * self.settings.accel_m_s2 * distance).sqrt();
        let wanted = self.settings.speed_m_s.min(stopping);
        self.speed_m_s = wanted.min(self.speed_m_s + self.settings.accel_m_s2 * dt_s);
        let share = (self.speed_m_s * dt_s / distance).min(1.0);
        for (position, part) in self.position_m.iter_mut().zip(way) {
            *position += share * part;
        }
        if share >= 1.0 {
            self.position_m = self.target_m;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn order(sequence: u64, x: f64) -> TurretOrder {
        TurretOrder { epoch: 1, sequence, offset_m: [x, 0.0], ttl_s: 2.5 }
    }

    fn run(turret: &mut Turret, seconds: f64) -> f64 {
        let dt = 1.0 / 9000.0;
        let mut fastest: f64 = 0.0;
        let steps = (seconds / dt).round() as i64;
        for _ in 0..steps {
            let before = turret.offset_cmd_m()[0];
            turret.step(dt);
            fastest = fastest.max((turret.offset_cmd_m()[0] - before).abs() / dt);
        }
        fastest
    }

    #[test]
    fn it_goes_there_no_faster_than_allowed() {
        let mut turret = Turret::new(TurretSettings::default());
        assert!(turret.order(&order(1, 0.5e-3)));
        let fastest = run(&mut turret, 1.0);
        assert!(fastest <= 2.0e-3 * 1.000_001, "{fastest}");
        assert_eq!(turret.offset_cmd_m(), [0.5e-3, 0.0]);
        assert_eq!(turret.state(), TurretState::Reached);
    }

    #[test]
    fn an_order_expires_and_the_turret_goes_back() {
        let mut turret = Turret::new(TurretSettings::default());
        turret.order(&order(1, 0.5e-3));
        run(&mut turret, 4.0);
        assert_eq!(turret.offset_cmd_m(), [0.0, 0.0]);
        assert_eq!(turret.state(), TurretState::Expired);
    }

    #[test]
    fn an_old_or_repeated_order_changes_nothing() {
        let mut turret = Turret::new(TurretSettings::default());
        assert!(turret.order(&order(5, 0.5e-3)));
        assert!(!turret.order(&order(5, 0.1e-3)));
        assert!(!turret.order(&order(4, 0.1e-3)));
        assert!(!turret.order(&order(6, f64::NAN)));
        run(&mut turret, 1.0);
        assert_eq!(turret.offset_cmd_m(), [0.5e-3, 0.0]);
    }

    #[test]
    fn an_open_interlock_stops_it() {
        let mut turret = Turret::new(TurretSettings::default());
        turret.order(&order(1, 0.5e-3));
        turret.set_interlock(true);
        run(&mut turret, 0.5);
        assert_eq!(turret.offset_cmd_m(), [0.0, 0.0]);
        assert_eq!(turret.state(), TurretState::Blocked);
    }
}
