//! What the page was not open for: spectra and forces of the last seconds, and of hours by the second.
//! `past_file` keeps the seconds over a restart.

use super::clock;
use super::live::level;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use utoipa::ToSchema;

/// The last 20 s as they were shown, 20 columns a second.
const FINE: usize = 400;
/// Eight hours by the second: a shift.
const COARSE: usize = 8 * 3600;
/// Longest range that can be asked for, s.
pub const LONGEST_S: u32 = 8 * 3600;
/// Most columns of an answer: more than a screen has places for.
const COLUMNS: usize = 600;

/// One picture, or the largest values of many.
#[derive(Debug, Clone, PartialEq)]
struct Column {
    wall_ns: i64,
    levels: Vec<u8>,
    /// Smallest and largest force of each axis, N.
    force: Vec<[f32; 2]>,
    line_hz: Option<f32>,
    chatter: bool,
}

impl Column {
    fn take_in(&mut self, other: &Self) {
        for (most, level) in self.levels.iter_mut().zip(&other.levels) {
            *most = (*most).max(*level);
        }
        for (mine, [low, high]) in self.force.iter_mut().zip(&other.force) {
            *mine = [mine[0].min(*low), mine[1].max(*high)];
        }
        self.line_hz = other.line_hz.or(self.line_hz);
        self.chatter |= other.chatter;
    }

    fn is_like(&self, other: &Self) -> bool {
        self.levels.len() == other.levels.len() && self.force.len() == other.force.len()
    }
}

/// Columns by the second as they are kept in a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Kept {
    grid_hz: [f64; 2],
    axes: Vec<String>,
    wall_ns: Vec<i64>,
    /// Base64 of the columns one after the other.
    levels: String,
    /// Column by column, axis by axis; null where none was estimated.
    force_n: Vec<Vec<[Option<f32>; 2]>>,
    line_hz: Vec<Option<f32>>,
    chatter: Vec<bool>,
}

impl Kept {
    /// Of the newest column, ns since 1970.
    pub(super) fn newest_ns(&self) -> Option<i64> {
        self.wall_ns.last().copied()
    }

    /// Whether its parts fit each other.
    pub(super) fn is_whole(&self) -> bool {
        let count = self.wall_ns.len();
        let sizes = [self.force_n.len(), self.line_hz.len(), self.chatter.len()];
        let axes = self.force_n.iter().all(|f| f.len() == self.axes.len());
        count > 0 && sizes == [count; 3] && axes && self.columns().len() == count
    }

    fn columns(&self) -> Vec<Column> {
        let levels = STANDARD.decode(&self.levels).unwrap_or_default();
        let bins = levels.len() / self.wall_ns.len().max(1);
        if bins == 0 || !levels.len().is_multiple_of(bins) {
            return Vec::new();
        }
        let ends = [f32::INFINITY, f32::NEG_INFINITY];
        let known = |pair: &[Option<f32>; 2]| [pair[0].unwrap_or(ends[0]), pair[1].unwrap_or(ends[1])];
        let rest = self.wall_ns.iter().zip(&self.force_n).zip(self.line_hz.iter().zip(&self.chatter));
        let columns =
            levels.chunks(bins).zip(rest).map(|(levels, ((wall_ns, force), (line_hz, chatter)))| {
                let force = force.iter().map(known).collect();
                Column {
                    wall_ns: *wall_ns,
                    levels: levels.to_vec(),
                    force,
                    line_hz: *line_hz,
                    chatter: *chatter,
                }
            });
        columns.collect()
    }
}

/// What one picture adds.
pub(super) struct Seen<'a> {
    pub(super) wall_ns: i64,
    /// On the machine's clock.
    pub(super) t_s: f64,
    pub(super) grid_hz: [f64; 2],
    pub(super) amplitude_n: &'a [f64],
    /// Slices of each axis.
    pub(super) force: &'a [Vec<[f32; 2]>],
    pub(super) axes: Vec<String>,
    pub(super) line_hz: Option<f64>,
    pub(super) chatter: bool,
}

/// The memory.
#[derive(Debug, Default)]
pub(super) struct Past {
    grid_hz: [f64; 2],
    axes: Vec<String>,
    fine: VecDeque<Column>,
    coarse: VecDeque<Column>,
    /// Newest column of this life on the machine's clock, s.
    newest_t_s: Option<f64>,
}

/// Spectra and forces of a time that has passed.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PastView {
    /// First bin, Hz.
    pub first_hz: f64,
    /// Distance of the bins, Hz.
    pub step_hz: f64,
    /// Bins of a column.
    pub bins: usize,
    /// Age of each column, s; oldest first.
    pub age_s: Vec<f64>,
    /// Time of the newest column on the machine's clock, which the live stream goes on from, s; absent before
    /// the first sample of this life.
    pub newest_t_s: Option<f64>,
    /// Base64 of the columns one after the other, one byte a bin: half decibels above -80 dB re 1 N, the
    /// largest of what a column stands for.
    pub levels: String,
    /// Tracked line of each column, Hz; null where none was.
    pub line_hz: Vec<Option<f32>>,
    /// Whether there was chatter in each column.
    pub chatter: Vec<bool>,
    /// Names of the axes.
    pub axes: Vec<String>,
    /// Axis by axis: smallest and largest force of each column, N, about its mean where that cannot be
    /// observed; null where none was estimated.
    pub force_n: Vec<Vec<[Option<f32>; 2]>>,
}

fn extremes(slices: &[[f32; 2]]) -> [f32; 2] {
    slices.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |all, s| [all[0].min(s[0]), all[1].max(s[1])])
}

impl Past {
    /// Takes in a picture; another stream forgets what was.
    #[allow(clippy::cast_possible_truncation)]
    pub(super) fn add(&mut self, seen: Seen<'_>) {
        let column = Column {
            wall_ns: seen.wall_ns,
            levels: seen.amplitude_n.iter().map(|a| level(*a)).collect(),
            force: seen.force.iter().map(|slices| extremes(slices)).collect(),
            line_hz: seen.line_hz.map(|hz| hz as f32),
            chatter: seen.chatter,
        };
        let other_grid = self.fine.is_empty() && self.grid_hz != seen.grid_hz;
        let other = other_grid || self.coarse.back().is_some_and(|last| !last.is_like(&column));
        if self.axes != seen.axes || other {
            *self = Self { axes: seen.axes, ..Self::default() };
        }
        (self.grid_hz, self.newest_t_s) = (seen.grid_hz, Some(seen.t_s));
        let second = |c: &Column| c.wall_ns.div_euclid(1_000_000_000);
        match self.coarse.back_mut() {
            Some(last) if second(last) == second(&column) => last.take_in(&column),
            _ => push(&mut self.coarse, column.clone(), COARSE),
        }
        push(&mut self.fine, column, FINE);
    }

    /// The seconds after `since_ns`; the one that is going on only where it is the last. Nothing where there
    /// is none.
    pub(super) fn since(&self, since_ns: i64, with_last: bool) -> Option<Kept> {
        let ended = self.coarse.len().saturating_sub(usize::from(!with_last));
        let new: Vec<&Column> = self.coarse.iter().take(ended).filter(|c| c.wall_ns > since_ns).collect();
        let known = |pair: &[f32; 2]| pair.map(|f| Some(f).filter(|f| f.is_finite()));
        let levels: Vec<u8> = new.iter().flat_map(|c| c.levels.iter().copied()).collect();
        let kept = Kept {
            grid_hz: self.grid_hz,
            axes: self.axes.clone(),
            wall_ns: new.iter().map(|c| c.wall_ns).collect(),
            levels: STANDARD.encode(levels),
            force_n: new.iter().map(|c| c.force.iter().map(known).collect()).collect(),
            line_hz: new.iter().map(|c| c.line_hz).collect(),
            chatter: new.iter().map(|c| c.chatter).collect(),
        };
        (!new.is_empty()).then_some(kept)
    }

    /// What earlier lives saw, oldest first, of the same axes and bins as now; nothing of the future.
    pub(super) fn put_before(&mut self, kept: Vec<Kept>, now_ns: i64) {
        if self.coarse.is_empty()
            && let Some(newest) = kept.last()
        {
            (self.grid_hz, self.axes) = (newest.grid_hz, newest.axes.clone());
        }
        let first_ns = self.coarse.front().map_or(now_ns, |c| c.wall_ns);
        let like = |k: &Kept| k.axes == self.axes && k.grid_hz == self.grid_hz;
        let mut columns: Vec<Column> = kept.iter().filter(|k| like(k)).flat_map(Kept::columns).collect();
        let model = self.coarse.front().or(columns.last()).cloned();
        columns.retain(|c| c.wall_ns < first_ns && model.as_ref().is_some_and(|m| m.is_like(c)));
        columns.sort_by_key(|c| c.wall_ns);
        let room = COARSE - self.coarse.len();
        columns.into_iter().rev().take(room).for_each(|c| self.coarse.push_front(c));
    }

    /// The last `seconds`, in as many columns as a screen can show.
    pub(super) fn view(&self, seconds: u32, now_ns: i64) -> PastView {
        let since_ns = now_ns.saturating_sub(i64::from(seconds) * 1_000_000_000);
        let fine = self.fine.front().is_some_and(|c| c.wall_ns <= since_ns) || seconds <= 20;
        let kept = if fine { &self.fine } else { &self.coarse };
        let within: Vec<&Column> = kept.iter().filter(|c| c.wall_ns >= since_ns).collect();
        let together = within.len().div_ceil(COLUMNS).max(1);
        let columns: Vec<Column> = within.chunks(together).filter_map(merged).collect();
        let levels: Vec<u8> = columns.iter().flat_map(|c| c.levels.iter().copied()).collect();
        let known = |pair: [f32; 2]| pair.map(|f| Some(f).filter(|f| f.is_finite()));
        let axis =
            |i: usize| columns.iter().map(|c| known(c.force.get(i).copied().unwrap_or_default())).collect();
        PastView {
            first_hz: self.grid_hz[0],
            step_hz: self.grid_hz[1],
            bins: columns.first().map_or(0, |c| c.levels.len()),
            age_s: columns.iter().map(|c| now_ns.saturating_sub(c.wall_ns) as f64 * 1e-9).collect(),
            newest_t_s: self.newest_t_s,
            levels: STANDARD.encode(levels),
            line_hz: columns.iter().map(|c| c.line_hz).collect(),
            chatter: columns.iter().map(|c| c.chatter).collect(),
            axes: self.axes.clone(),
            force_n: (0..self.axes.len()).map(axis).collect(),
        }
    }
}

fn push(columns: &mut VecDeque<Column>, column: Column, most: usize) {
    if columns.len() >= most {
        columns.pop_front();
    }
    columns.push_back(column);
}

fn merged(group: &[&Column]) -> Option<Column> {
    let (last, earlier) = group.split_last()?;
    let mut all = (*last).clone();
    earlier.iter().for_each(|c| all.take_in(c));
    all.line_hz = last.line_hz.or(all.line_hz);
    Some(all)
}

impl super::Handle {
    /// Spectra and forces of the last `seconds`, 10 to [`LONGEST_S`].
    pub async fn past(&self, seconds: u32) -> PastView {
        let past = std::sync::Arc::clone(&self.0.past);
        let look = move || {
            let past = past.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            past.view(seconds, clock::wall_ns())
        };
        // Hours are put together on a thread that may take its time.
        let viewed = tokio::task::spawn_blocking(look).await;
        viewed.unwrap_or_else(|_| Past::default().view(seconds, clock::wall_ns()))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    impl Past {
        /// As if the stream had another axis.
        pub(in crate::service) fn rename(&mut self, axis: &str) {
            self.axes = vec![axis.to_owned()];
        }

        pub(in crate::service) fn put_after(&mut self, later: &Self) {
            self.coarse.extend(later.coarse.iter().cloned());
        }
    }

    /// One picture in each of these seconds, each with levels of its own.
    pub(in crate::service) fn filled(from_s: i64, to_s: i64) -> Past {
        let mut past = Past::default();
        for s in from_s..to_s {
            let force = [vec![[-1.0, s as f32]]];
            past.add(Seen { line_hz: Some(s as f64), ..seen(s * 1000 * MS, s % 7 == 0, &force) });
        }
        past
    }

    /// The seconds of a view's columns.
    pub(in crate::service) fn seconds_of(view: &PastView, now_ns: i64) -> Vec<i64> {
        view.age_s.iter().map(|age| (now_ns as f64 * 1e-9 - age).round() as i64).collect()
    }

    const MS: i64 = 1_000_000;

    fn seen(wall_ns: i64, loud: bool, force: &[Vec<[f32; 2]>]) -> Seen<'_> {
        Seen {
            wall_ns,
            t_s: wall_ns as f64 * 1e-9 - 7.0,
            grid_hz: [400.0, 2.0],
            amplitude_n: if loud { &[0.1, 10.0] } else { &[0.1, 0.1] },
            force,
            axes: vec!["x1".into()],
            line_hz: loud.then_some(402.0),
            chatter: loud,
        }
    }

    #[test]
    fn a_short_event_is_still_there_hours_later() {
        let mut past = Past::default();
        let quiet = [vec![[-1.0, 1.0], [-2.0, 0.5]]];
        // Two hours of one picture a second, then a loud one, then 20 s of twenty a second.
        for s in 0..7200_i64 {
            past.add(seen(s * 1000 * MS, false, &quiet));
        }
        past.add(seen(7200 * 1000 * MS, true, &[vec![[-50.0, 60.0]]]));
        for k in 1..=400_i64 {
            past.add(seen((7_200_000 + 50 * k) * MS, false, &quiet));
        }
        let now = 7_220_000 * MS;
        let short = past.view(20, now);
        assert!(short.age_s.len() >= 399 && !short.chatter.contains(&true), "{}", short.age_s.len());
        let long = past.view(3 * 3600, now);
        assert!(long.age_s.len() <= COLUMNS && long.age_s.windows(2).all(|w| w[0] > w[1]));
        let place = long.chatter.iter().position(|c| *c).expect("the loud one is seen");
        assert_eq!((long.line_hz[place], long.force_n[0][place]), (Some(402.0), [Some(-50.0), Some(60.0)]));
        let levels = STANDARD.decode(&long.levels).unwrap();
        assert_eq!(levels.len(), long.bins * long.age_s.len());
        assert_eq!(levels[place * 2 + 1], level(10.0));
        assert_eq!(short.force_n[0][0], [Some(-2.0), Some(1.0)]);
        assert_eq!(short.newest_t_s, Some(7213.0), "the stream goes on from there");
        past.add(seen(now, false, &[vec![]]));
        assert_eq!(past.view(20, now).force_n[0].last(), Some(&[None, None]), "nobody estimates it");
    }

    #[test]
    fn memory_is_bounded_and_another_stream_begins_anew() {
        let mut past = Past::default();
        let force = [vec![[0.0, 1.0]]];
        for s in 0..40_000_i64 {
            past.add(seen(s * 1000 * MS, false, &force));
        }
        assert_eq!((past.fine.len(), past.coarse.len()), (FINE, COARSE));
        past.add(Seen { axes: vec!["x2".into()], ..seen(40_001 * 1000 * MS, false, &force) });
        assert_eq!((past.fine.len(), past.coarse.len()), (1, 1));
        assert_eq!(past.view(20, 40_001 * 1000 * MS).axes, ["x2"]);
        assert!(Past::default().view(20, 0).age_s.is_empty());
    }
}
