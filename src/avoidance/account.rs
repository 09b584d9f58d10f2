//! The account of the turret decisions: every look at the decision with all that was known, small enough to
//! be kept always, so that each decision can be made again.
//!
//! ```text
//!  state of the decision, look, look, look ...      look = what was known + what was decided
//! ```
//! A look is its numbers, each exclusive-or the same number of the look before: most of them are zero and
//! cost one bit, the rest lose their leading zeros.

use super::{Avoidance, AvoidanceSettings, Decision, Situation};
use crate::keyframe::{Digest, Keep, Words, keep};
use thiserror::Error;

/// One look at the decision.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Look {
    /// Time of the newest sample on the producer's clock, s; nothing before the first.
    pub t_s: Option<f64>,
    /// What was known.
    pub situation: Situation,
    /// What was decided.
    pub decision: Decision,
}
keep!(Look { t_s, situation, decision });

/// Most numbers of a look: one bit each in the mask.
const MOST_WORDS: usize = 64;
/// Most bytes of a look: count, mask and every number whole.
pub const MOST_BYTES: usize = 2 + 10 + 10 * MOST_WORDS;

/// Writes looks, the first whole, each other as what changed.
#[derive(Debug, Clone, PartialEq)]
pub struct LookWriter {
    before: Vec<u64>,
    now: Vec<u64>,
}

impl Default for LookWriter {
    fn default() -> Self {
        Self { before: Vec::with_capacity(MOST_WORDS), now: Vec::with_capacity(MOST_WORDS) }
    }
}

impl LookWriter {
    /// Appends a look to `to`. Cost: some fifty operations, no allocation where `to` has [`MOST_BYTES`] free.
    /// Checked by: `looks_come_back_bit_for_bit`.
    pub fn write(&mut self, look: &Look, to: &mut Vec<u8>) {
        self.now.clear();
        look.keep(&mut self.now);
        debug_assert!(self.now.len() <= MOST_WORDS);
        let change = |k: usize| self.now[k] ^ self.before.get(k).copied().unwrap_or(0);
        let mask = (0..self.now.len()).filter(|k| change(*k) != 0).fold(0_u64, |mask, k| mask | 1 << k);
        put(self.now.len() as u64, to);
        put(mask, to);
        (0..self.now.len()).filter(|k| mask >> k & 1 == 1).for_each(|k| put(change(k), to));
        std::mem::swap(&mut self.before, &mut self.now);
    }

    /// The next look is written whole.
    pub fn begin(&mut self) {
        self.before.clear();
    }
}

/// Seven bits a byte, the lowest first.
fn put(mut word: u64, to: &mut Vec<u8>) {
    while word >= 0x80 {
        to.push(word.to_le_bytes()[0] | 0x80);
        word >>= 7;
    }
    to.push(word.to_le_bytes()[0]);
}

fn take(from: &mut std::slice::Iter<'_, u8>) -> Option<u64> {
    let mut word = 0;
    for shift in (0..64).step_by(7) {
        let byte = *from.next()?;
        word |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Some(word);
        }
    }
    None
}

/// Looks that [`LookWriter`] wrote from one beginning on. Nothing: they are damaged.
#[must_use]
pub fn read_looks(bytes: &[u8]) -> Option<Vec<Look>> {
    let (mut looks, mut words) = (Vec::new(), Vec::new());
    let mut from = bytes.iter();
    while from.len() > 0 {
        let count = usize::try_from(take(&mut from)?).ok().filter(|n| *n <= MOST_WORDS)?;
        let mask = take(&mut from)?;
        words.resize(count, 0);
        for (k, word) in words.iter_mut().enumerate() {
            if mask >> k & 1 == 1 {
                *word ^= take(&mut from)?;
            }
        }
        let (mut look, mut rest) = (Look::default(), Words::new(&words));
        look.restore(&mut rest)?;
        if !rest.is_empty() {
            return None;
        }
        looks.push(look);
    }
    Some(looks)
}

/// Decisions of some seconds, each with what it rests on.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Account {
    /// [`settings_digest`] of the settings that decided.
    pub settings: u64,
    /// State of the decision before the first look.
    pub state: Vec<u64>,
    /// Looks of [`LookWriter`], stretch after stretch, each from a beginning.
    pub stretches: Vec<Vec<u8>>,
}

/// Why the decisions of an account cannot be made again.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum AccountError {
    /// Not what was written.
    #[error("the account of the turret decisions is damaged")]
    Damaged,
    /// Other settings decide otherwise.
    #[error(
        "the turret decisions were made with other settings of turret, workpiece or cutting, or \
         another version"
    )]
    Settings,
    /// Something else was decided.
    #[error("the turret decision {number} at {now_s} s differs: live {live:?}, now {again:?}")]
    Differs {
        /// Which look.
        number: usize,
        /// When, on the clock of the service.
        now_s: f64,
        /// Decided then.
        live: Box<Decision>,
        /// Decided now.
        again: Box<Decision>,
    },
}

/// Tells settings apart that would decide differently.
#[must_use]
pub fn settings_digest(settings: &AvoidanceSettings) -> u64 {
    let mut digest = Digest::default();
    digest.bytes(env!("CARGO_PKG_VERSION").as_bytes());
    digest.bytes(format!("{settings:?}").as_bytes());
    digest.value()
}

/// Makes every decision of the account again. Errors: it is damaged, of other settings, or something
/// differs in any bit.
/// Checked by: `decisions_are_made_again`, `suite/evidence.rs`.
pub fn decide_again(avoidance: &Avoidance, account: &Account) -> Result<Vec<Look>, AccountError> {
    if settings_digest(avoidance.settings()) != account.settings {
        return Err(AccountError::Settings);
    }
    let mut state = avoidance.start(0, 0.0);
    let mut words = Words::new(&account.state);
    state.restore(&mut words).filter(|()| words.is_empty()).ok_or(AccountError::Damaged)?;
    let bits = |decision: &Decision| {
        let mut words = Vec::new();
        decision.keep(&mut words);
        words
    };
    let mut looks = Vec::new();
    for stretch in &account.stretches {
        looks.extend(read_looks(stretch).ok_or(AccountError::Damaged)?);
    }
    for (number, look) in looks.iter().enumerate() {
        let again = avoidance.decide(&mut state, &look.situation);
        if bits(&again) != bits(&look.decision) {
            let (live, again) = (Box::new(look.decision), Box::new(again));
            return Err(AccountError::Differs { number, now_s: look.situation.now_s, live, again });
        }
    }
    Ok(looks)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::avoidance::turret::{TurretAxis, TurretKinematics};
    use crate::avoidance::{Heard, Interlock, Mode, TurretReport};
    use crate::chatter::Phase;

    fn avoidance() -> Avoidance {
        let axis = |index, direction_rad| TurretAxis {
            index,
            direction_rad,
            lowest_m: -1e-3,
            highest_m: 1e-3,
            speed_m_s: 2e-3,
            acceleration_m_s2: 50.0e-3,
        };
        Avoidance::new(AvoidanceSettings {
            turret: TurretKinematics::new([axis(0, 0.0), axis(1, 0.8)]).unwrap(),
            diameter_m: 0.024,
            largest_pitch_rad: 0.14,
            interval_s: 1.0,
            ttl_s: 2.5,
            freshness_s: 0.05,
            report_deadline_s: 0.5,
            reached_m: 20e-6,
            stated: None,
            before_chatter: false,
        })
        .unwrap()
    }

    fn situation(k: u32) -> Situation {
        let now_s = 10.0 + 1e-3 * f64::from(k);
        let loud = (1000..4000).contains(&k);
        Situation {
            now_s,
            newest_sample_s: Some(now_s - 3e-4),
            window_full: true,
            estimate_valid: true,
            heard: Heard {
                phase: if loud { Phase::Chatter } else { Phase::Quiet },
                frequency_hz: loud.then(|| 650.0 + (f64::from(k) * 0.1).sin()),
                power_n2: if loud { 20.0 } else { 0.1 },
                growth_1_s: loud.then_some(3.0),
            },
            spindle_speed_rpm: Some(1200.0),
            turret: Some(TurretReport { heard_s: now_s - 1e-3, ..TurretReport::default() }),
            interlock: Some(Interlock { heard_s: now_s - 1e-3, open: false }),
            mode: Mode::Act,
            store_writable: true,
            ..Situation::default()
        }
    }

    fn account() -> Account {
        let avoidance = avoidance();
        let mut state = avoidance.start(7, 9.5);
        for k in 0..500 {
            let _ = avoidance.decide(&mut state, &situation(k));
        }
        let mut account = Account { settings: settings_digest(avoidance.settings()), ..Account::default() };
        state.keep(&mut account.state);
        for part in [500..2500, 2500..5000] {
            let (mut writer, mut bytes) = (LookWriter::default(), Vec::new());
            for k in part {
                let situation = situation(k);
                let decision = avoidance.decide(&mut state, &situation);
                writer.write(&Look { t_s: Some(f64::from(k)), situation, decision }, &mut bytes);
            }
            account.stretches.push(bytes);
        }
        account
    }

    #[test]
    fn looks_come_back_bit_for_bit() {
        let looks: Vec<Look> = (0..300)
            .map(|k| Look {
                t_s: (k != 7).then_some(1e9 / f64::from(k)),
                situation: Situation { turret: None, ..situation(20 * k) },
                decision: Decision::Hold(super::super::HoldReason::ALL[k as usize % 20]),
            })
            .collect();
        let (mut writer, mut bytes) = (LookWriter::default(), Vec::new());
        looks.iter().for_each(|look| writer.write(look, &mut bytes));
        assert_eq!(read_looks(&bytes), Some(looks));
        assert_eq!(read_looks(&bytes[..bytes.len() - 1]), None);
    }

    #[test]
    fn decisions_are_made_again() {
        let account = account();
        let looks = decide_again(&avoidance(), &account).unwrap();
        assert_eq!(looks.len(), 4500);
        assert!(looks.iter().filter(|l| matches!(l.decision, Decision::Command(_))).count() >= 2);
        // Some forty bytes a look.
        assert!(account.stretches.iter().map(Vec::len).sum::<usize>() < 4500 * 45);
        let other = Account { settings: 1, ..account.clone() };
        assert_eq!(decide_again(&avoidance(), &other), Err(AccountError::Settings));
        let mut short = account;
        short.state.pop();
        assert_eq!(decide_again(&avoidance(), &short), Err(AccountError::Damaged));
    }

    /// Chatter that one look did not hear: what was decided then is not decided again.
    #[test]
    fn another_situation_is_noticed() {
        let mut account = account();
        let mut looks = read_looks(&account.stretches[0]).unwrap();
        let first = looks.iter().position(|l| matches!(l.decision, Decision::Command(_))).unwrap();
        looks[first].situation.heard.phase = Phase::Quiet;
        let (mut writer, mut bytes) = (LookWriter::default(), Vec::new());
        looks.iter().for_each(|look| writer.write(look, &mut bytes));
        account.stretches[0] = bytes;
        let error = decide_again(&avoidance(), &account).unwrap_err();
        assert!(matches!(error, AccountError::Differs { number, .. } if number == first), "{error}");
        assert_eq!(error.to_string().lines().count(), 1);
    }
}
