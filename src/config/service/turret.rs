//! `[turret]`: limits, who set them, and what may be missing before it is moved.

use super::{NOT_COMMISSIONED, Reader, TurretToml};
use crate::avoidance::turret::{TurretAxis, TurretError, TurretKinematics};
use crate::config::{ConfigError, is_date};
use crate::force::validity::Validity;
use std::f64::consts::TAU;

/// Items of commissioning that `turret.accept` may name.
pub const COMMISSIONING_ITEMS: [&str; 5] =
    ["hours_observed", "cuts_heard", "alarms_reviewed", "commands_advised", "model_drift"];

/// The turret that carries tool 1, and what it may do.
#[derive(Debug, Clone, PartialEq)]
pub struct TurretConfig {
    /// Names of its two axes.
    pub axes: [String; 2],
    /// Directions from "toward the bar", rad.
    pub direction_rad: [f64; 2],
    /// Least offsets, m.
    pub lowest_offset_m: [f64; 2],
    /// Greatest offsets, m.
    pub highest_offset_m: [f64; 2],
    /// Fastest motion of the offsets, m/s.
    pub speed_m_s: [f64; 2],
    /// Largest acceleration of the offsets, m/s2.
    pub acceleration_m_s2: [f64; 2],
    /// Largest pitch angle difference, rad.
    pub largest_pitch_difference_rad: f64,
    /// Lifetime of a command, s.
    pub command_ttl_s: f64,
    /// Who set these limits and on which day; nothing acts without.
    pub commissioned: Option<(String, String)>,
    /// In `act` the pitch moves while the cut is still silent, where the stability margin runs out.
    pub before_chatter: bool,
    /// What of commissioning may be missing, and which flags of the force do not hold back acting, by name.
    pub accept: Vec<String>,
}

impl TurretConfig {
    /// Which of these flags hold back acting: those that are not accepted by name.
    #[must_use]
    pub fn holding(&self, flags: Validity) -> Validity {
        let accepted = |name: &str| self.accept.iter().any(|a| a == name);
        let held = flags.only(Validity::HOLDING_BY_DEFAULT);
        held.names()
            .filter(|name| accepted(name))
            .fold(held, |held, name| held.without(Validity::named(name)))
    }

    /// Its axes at these places of the stream. Errors: axes that move no tool around a bar.
    pub(super) fn kinematics(&self, places: [usize; 2]) -> Result<TurretKinematics, TurretError> {
        let axis = |i: usize| TurretAxis {
            index: places[i],
            direction_rad: self.direction_rad[i],
            lowest_m: self.lowest_offset_m[i],
            highest_m: self.highest_offset_m[i],
            speed_m_s: self.speed_m_s[i],
            acceleration_m_s2: self.acceleration_m_s2[i],
        };
        TurretKinematics::new([axis(0), axis(1)])
    }
}

impl Reader<'_> {
    pub(super) fn turret(&self, raw: &TurretToml) -> Result<TurretConfig, ConfigError> {
        let (place, limits) = ("turret.largest_pitch_difference_rad", (1e-3, 1.0));
        let largest = self.within(place, raw.largest_pitch_difference_rad, limits)?;
        if raw.axes.0[0] == raw.axes.0[1] {
            return Err(self.bad("turret.axes", format!("{} twice: expected two axes", raw.axes.0[0])));
        }
        for direction_rad in raw.direction_rad.0 {
            self.within("turret.direction_rad", direction_rad, (-TAU, TAU))?;
        }
        for (low, high) in raw.lowest_offset_m.0.iter().zip(&raw.highest_offset_m.0) {
            self.within("turret.lowest_offset_m", *low, (-0.01, 0.0))?;
            self.within("turret.highest_offset_m", *high, (0.0, 0.01))?;
        }
        for speed in raw.speed_m_s.0 {
            self.within("turret.speed_m_s", speed, (1e-6, 0.1))?;
        }
        for acceleration in raw.acceleration_m_s2.0 {
            self.within("turret.acceleration_m_s2", acceleration, (1e-6, 10.0))?;
        }
        let turret = TurretConfig {
            axes: raw.axes.0.clone(),
            direction_rad: raw.direction_rad.0,
            lowest_offset_m: raw.lowest_offset_m.0,
            highest_offset_m: raw.highest_offset_m.0,
            speed_m_s: raw.speed_m_s.0,
            acceleration_m_s2: raw.acceleration_m_s2.0,
            largest_pitch_difference_rad: largest,
            // I7: a dead sender must not hold the turret away from equal pitch for longer.
            command_ttl_s: self.within("turret.command_ttl_s", raw.command_ttl_s, (1.1, 2.5))?,
            commissioned: self.commissioned(&raw.limits_by, &raw.limits_date)?,
            before_chatter: raw.before_chatter,
            accept: self.accepted(&raw.accept)?,
        };
        turret.kinematics([0, 1]).map_err(|e| self.bad("turret.direction_rad", e.to_string()))?;
        Ok(turret)
    }

    /// Names of what may be missing. Errors: a name that there is not.
    fn accepted(&self, names: &[String]) -> Result<Vec<String>, ConfigError> {
        let flags = || Validity::HOLDING_BY_DEFAULT.names();
        let known = |name: &str| COMMISSIONING_ITEMS.contains(&name) || flags().any(|f| f == name);
        match names.iter().find(|name| !known(name)) {
            None => Ok(names.to_vec()),
            Some(name) => {
                let all: Vec<&str> = COMMISSIONING_ITEMS.into_iter().chain(flags()).collect();
                Err(self.bad("turret.accept", format!("`{name}` is not one of {}", all.join(", "))))
            }
        }
    }

    fn commissioned(&self, by: &str, date: &str) -> Result<Option<(String, String)>, ConfigError> {
        let (by, date) = (by.trim(), date.trim());
        match (by, date) {
            (NOT_COMMISSIONED, _) => Ok(None),
            (_, NOT_COMMISSIONED) => Err(self.bad("turret.limits_date", "missing beside turret.limits_by")),
            ("", _) => Err(self.bad("turret.limits_by", "expected the name of who set the limits")),
            _ if is_date(date) => Ok(Some((by.to_owned(), date.to_owned()))),
            _ => Err(self.bad("turret.limits_date", format!("`{date}` is not a date such as 2026-11-21"))),
        }
    }
}
