//! What is looked at once a second beside everything else: health and size of the history, open alarms, the
//! wall clock; and what is removed by age and size. It may wait for the disk: nothing waits for it.

use super::announcer::{Announcer, Then};
use super::clock;
use super::commissioning::{Commissioning, state_of};
use super::live::StoreView;
use super::recordings::{RecordingLimits, Recordings};
use super::store_watch::StoreWatch;
use crate::config::service::TurretConfig;
use crate::store::{FILE_NAME, Observer, Removed, StoreReader, StoreWriter};
use crate::telemetry::{Event, EventKind, Metrics};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use tokio::sync::watch;

const LOOK: Duration = Duration::from_secs(1);
/// Looks between two removals.
const PRUNE_EVERY: u32 = 600;
/// Looks between two of commissioning; what was observed is noted with each.
const COMMISSION_EVERY: u32 = 10;
/// Looks between two rounds through the folders.
const TIDY_EVERY: u32 = 3600;
/// A large history is checked whole this long after the start.
const CHECK_AFTER: Duration = Duration::from_secs(30);
/// A step of the wall clock that is told, s.
const STEP_S: f64 = 30.0;
/// After a step nothing is removed by age for this long: the clock may be set right again.
const NO_PRUNING: Duration = Duration::from_secs(86_400);
/// Nor for this long after the start: a clock that is wrong then is set right within minutes.
const FIRST: Duration = Duration::from_secs(3600);

/// The history and what is known of it.
pub(super) struct History {
    pub(super) writer: StoreWriter,
    pub(super) reader: StoreReader,
    pub(super) folder: PathBuf,
    pub(super) replaced: Option<String>,
    /// It was too large to be read whole at the start.
    pub(super) unchecked: bool,
    /// Which file it is.
    pub(super) file: Option<FileId>,
}

/// Device and number of a file: the same path may lead to another.
pub(super) type FileId = (u64, u64);

/// Which file stands at that path.
pub(super) fn file_id(path: &Path) -> Option<FileId> {
    use std::os::unix::fs::MetadataExt as _;
    std::fs::metadata(path).ok().map(|m| (m.dev(), m.ino()))
}

/// What the picture shows of it.
#[derive(Debug, Clone, Default)]
pub(super) struct Kept {
    pub(super) store: StoreView,
    pub(super) open_alarms: u64,
}

/// Compares the clocks: a wall clock that jumps makes everything look old or young.
#[derive(Debug)]
struct Clocks {
    then: (Instant, i64),
    prune_after: Option<Instant>,
}

impl Clocks {
    fn new(now: Instant, wall_ns: i64) -> Self {
        Self { then: (now, wall_ns), prune_after: Some(now + FIRST) }
    }

    /// The step since the last look, where there was one; nothing is removed for a day then.
    fn step_s(&mut self, now: Instant, wall_ns: i64) -> Option<f64> {
        let (then, then_ns) = std::mem::replace(&mut self.then, (now, wall_ns));
        let passed_s = now.duration_since(then).as_secs_f64();
        let step_s = (wall_ns.saturating_sub(then_ns)) as f64 * 1e-9 - passed_s;
        let stepped = step_s.abs() > STEP_S;
        if stepped {
            self.prune_after = Some(now + NO_PRUNING);
        }
        stepped.then_some(step_s)
    }

    fn may_prune(&self, now: Instant) -> bool {
        self.prune_after.is_none_or(|after| now >= after)
    }
}

/// The task.
pub(super) struct Upkeep {
    pub(super) history: History,
    pub(super) recordings: (Recordings, RecordingLimits),
    pub(super) announcer: Announcer,
    pub(super) metrics: Arc<Metrics>,
    pub(super) kept: watch::Sender<Kept>,
    pub(super) commissioning: CommissioningUpkeep,
}

/// What commissioning is computed from.
pub(super) struct CommissioningUpkeep {
    pub(super) shown: Arc<Commissioning>,
    pub(super) observer: Observer,
    pub(super) turret: TurretConfig,
    pub(super) axes: Vec<String>,
}

impl Upkeep {
    /// Looks once a second, for ever.
    pub(super) async fn run(self) {
        let mut clocks = Clocks::new(clock::now(), clock::wall_ns());
        let mut store = StoreWatch::new(Arc::clone(self.history.writer.gauges()));
        let mut last_commits = 0;
        let mut look = tokio::time::interval(LOOK);
        look.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut until_prune = PRUNE_EVERY;
        let mut told = false;
        if self.history.unchecked {
            tokio::spawn(check_whole(self.history.reader.clone()));
        }
        for ticks in 0_u32.. {
            look.tick().await;
            self.compare(&mut clocks);
            let healthy = self.look(&mut store, &mut last_commits).await;
            self.tell_damage(&mut told);
            self.tell_room();
            if ticks.is_multiple_of(COMMISSION_EVERY) {
                self.commission(ticks > 0 && healthy).await;
            }
            if ticks.is_multiple_of(TIDY_EVERY) {
                self.tidy(clocks.may_prune(clock::now()));
            }
            until_prune = until_prune.saturating_sub(1);
            if until_prune == 0 && healthy && clocks.may_prune(clock::now()) {
                until_prune = if self.prune().await { 1 } else { PRUNE_EVERY };
            }
        }
    }

    fn tell(&self, kind: EventKind, text: String) {
        let event = Event { id: clock::new_id(), ..Event::new(kind, clock::wall_ns(), text) };
        self.announcer.announce(event, Then::Nothing);
    }

    /// Told once; the next start deals with it.
    fn tell_damage(&self, told: &mut bool) {
        let broken = self.history.writer.gauges().broken.load(Ordering::Relaxed);
        let text = match self.history.reader.damage() {
            _ if *told => return,
            Some(damage) => {
                format!("the history is damaged ({damage}); restart the service to have it set aside")
            }
            None if broken => {
                let path = self.history.folder.join(FILE_NAME);
                let what = "is no longer the file that was opened: nothing is kept; put it back and restart";
                format!("{} {what} the service", path.display())
            }
            None => return,
        };
        *told = true;
        self.tell(EventKind::HistoryDamaged, text);
    }

    /// Recordings that went because the disk is full.
    fn tell_room(&self) {
        let gone = self.recordings.0.take_gone();
        if gone.is_empty() {
            return;
        }
        self.metrics.recordings.with_label_values(&["removed"]).inc_by(gone.len() as u64);
        let (count, first) = (gone.len(), gone.iter().take(NAMED).cloned().collect::<Vec<_>>().join(", "));
        let more = if count > NAMED { ", .." } else { "" };
        let what = match count {
            1 => "the oldest recording was removed".to_owned(),
            _ => format!("{count} of the oldest recordings were removed"),
        };
        self.tell(EventKind::RecordingsRemoved, format!("the disk is full: {what}: {first}{more}"));
    }

    fn compare(&self, clocks: &mut Clocks) {
        if let Some(step_s) = clocks.step_s(clock::now(), clock::wall_ns()) {
            let text = format!("the wall clock jumped by {step_s:.0} s; nothing is removed by age for a day");
            self.tell(EventKind::ClockStep, text);
        }
    }

    async fn look(&self, store: &mut StoreWatch, last_commits: &mut i64) -> bool {
        let gauges = self.history.writer.gauges();
        let waiting = gauges.waiting.load(Ordering::Relaxed) as u64;
        // A disk that hangs fails no write: nothing gets done either way.
        let failing = gauges.failures.load(Ordering::Relaxed) > 0 || !store.writable(clock::now());
        let commits = gauges.commits.load(Ordering::Relaxed);
        if commits != std::mem::replace(last_commits, commits) {
            self.metrics.last_commit_timestamp_seconds.set(clock::wall_s());
        }
        let kept = self.kept.borrow().clone();
        let gauge = |value: u64| i64::try_from(value).unwrap_or(i64::MAX);
        let folder = self.history.folder.clone();
        // What hangs here hangs on a thread of its own; the health above is told all the same.
        let look = move || (sizes(&folder), file_id(&folder.join(FILE_NAME)), space(&folder));
        let seen = if failing { None } else { tokio::task::spawn_blocking(look).await.ok() };
        let sizes = seen.map(|(sizes, ..)| sizes);
        if let Some((available, size)) = seen.and_then(|(.., space)| space) {
            self.metrics.store_filesystem_available_bytes.set(gauge(available));
            self.metrics.store_filesystem_size_bytes.set(gauge(size));
        }
        let moved = seen.is_some_and(|(_, file, _)| file != self.history.file);
        if moved || self.history.reader.damage().is_some() {
            gauges.broken.store(true, Ordering::Relaxed);
        }
        let broken = gauges.broken.load(Ordering::Relaxed);
        let bytes = sizes.map_or(kept.store.bytes, |(bytes, _)| bytes);
        self.metrics.events_unpersisted.set(gauge(waiting));
        self.metrics.queue_depth.with_label_values(&["store"]).set(gauge(waiting));
        self.metrics.store_bytes.set(gauge(bytes));
        if let Some((_, log)) = sizes {
            self.metrics.wal_bytes.set(gauge(log));
        }
        let healthy = !failing && !broken;
        self.metrics.stage_up.with_label_values(&["store"]).set(i64::from(healthy));
        let counted = match failing {
            true => None,
            false => self.history.reader.open_alarms(clock::wall_ns()).await.ok(),
        };
        let replaced = self.history.replaced.clone();
        let store = StoreView { healthy, unpersisted: waiting, bytes, replaced };
        self.kept.send_replace(Kept { store, open_alarms: counted.unwrap_or(kept.open_alarms) });
        healthy
    }

    /// Where commissioning stands; `note`: what this life has observed goes into the history.
    async fn commission(&self, note: bool) {
        let CommissioningUpkeep { shown, observer, turret, axes } = &self.commissioning;
        let total = |family| axes.iter().map(|axis| Metrics::total(family, &[axis])).sum();
        let counted = (total(&self.metrics.model_windows), total(&self.metrics.model_mismatches));
        let now = shown.evidence.so_far(counted);
        if note {
            // What is not stored now is stored with the next.
            let _ = self.history.writer.note_observed(observer, now.clone()).await;
        }
        if let Ok((before, judged)) = self.history.reader.observed_before(observer).await {
            shown.show(state_of(turret, &before.with(&now), judged));
        }
    }

    /// Answers whether there may be more to remove.
    async fn prune(&self) -> bool {
        let Ok(removed) = self.history.writer.prune(clock::wall_ns()).await else { return false };
        let Removed { aged, oversize, forced, audit } = removed;
        for (reason, count) in [("age", aged), ("size", oversize), ("forced", forced), ("audit", audit)] {
            self.metrics.history_removed.with_label_values(&[reason]).inc_by(count);
        }
        if forced > 0 {
            let text = format!(
                "the history is full: {forced} of the oldest events went although nobody had acknowledged \
                 them or the broker had not taken them"
            );
            self.tell(EventKind::EventsRemoved, text);
        }
        removed.is_full()
    }

    fn tidy(&self, by_age: bool) {
        let ((recordings, limits), metrics) = (self.recordings.clone(), Arc::clone(&self.metrics));
        let folder = self.history.folder.clone();
        tokio::task::spawn_blocking(move || {
            let limits =
                RecordingLimits { max_age_ns: if by_age { limits.max_age_ns } else { i64::MAX }, ..limits };
            match recordings.prune(limits, clock::wall_ns()) {
                Ok(removed) => metrics.recordings.with_label_values(&["removed"]).inc_by(removed as u64),
                Err(error) => tracing::warn!(event = "recordings_prune", "{error}"),
            }
            tidy_folder(&folder);
        });
    }
}

/// Names in one sentence.
const NAMED: usize = 5;

/// Bytes of the history file and of its log.
fn sizes(folder: &Path) -> (u64, u64) {
    let size =
        |suffix: &str| std::fs::metadata(folder.join(format!("{FILE_NAME}{suffix}"))).map_or(0, |m| m.len());
    (size(""), size("-wal"))
}

/// Bytes that this user may still write on the file system of a folder, and its size.
fn space(folder: &Path) -> Option<(u64, u64)> {
    let told = rustix::fs::statvfs(folder).ok()?;
    let bytes = |blocks: u64| blocks.saturating_mul(told.f_frsize);
    Some((bytes(told.f_bavail), bytes(told.f_blocks)))
}

/// What it finds, the reader remembers.
async fn check_whole(reader: StoreReader) {
    tokio::time::sleep(CHECK_AFTER).await;
    if let Err(error) = reader.check_whole().await {
        tracing::warn!(event = "history_checked", "{error}");
    }
}

/// Histories that were set aside, and copies made before a change of schema: this many of each stay.
const SET_ASIDE: usize = 3;
/// Diagnoses that stay.
const DIAGNOSES: usize = 100;
/// What a process that was killed left half written goes after this.
const LEFT_OVER: Duration = Duration::from_secs(3600);

/// Removes what nobody will ask for again; what cannot be removed is tried again at the next round.
fn tidy_folder(folder: &Path) {
    let names = names_in(folder);
    let keep_newest = |fits: &dyn Fn(&str) -> bool| {
        let mut found: Vec<&String> = names.iter().filter(|n| fits(n)).collect();
        found.sort_unstable(); // their names end with the time
        let surplus = found.len().saturating_sub(SET_ASIDE);
        found.into_iter().take(surplus).cloned().collect::<Vec<String>>()
    };
    let main = |n: &str| !n.ends_with("-wal") && !n.ends_with("-shm") && !n.ends_with(".suspect");
    let damaged = keep_newest(&|n| n.starts_with("history.sqlite.damaged-") && main(n));
    let copies = keep_newest(&|n| n.starts_with("history.before-"));
    for name in damaged.iter().chain(&copies) {
        for suffix in ["", "-wal", "-shm", ".suspect"] {
            let _ = std::fs::remove_file(folder.join(format!("{name}{suffix}")));
        }
        tracing::info!(event = "tidied", name, "an old copy of the history was removed");
    }
    let mut diagnoses = names_in(&folder.join("diagnoses"));
    diagnoses.sort_unstable(); // by the time at which they were asked for
    for name in diagnoses.iter().take(diagnoses.len().saturating_sub(DIAGNOSES)) {
        let _ = std::fs::remove_dir_all(folder.join("diagnoses").join(name));
    }
    for place in [folder.to_owned(), folder.join("recordings")] {
        for name in names_in(&place).iter().filter(|n| n.starts_with('.')) {
            remove_left_over(&place.join(name));
        }
    }
}

fn names_in(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|e| e.file_name().to_string_lossy().into_owned()).collect()
}

fn remove_left_over(path: &Path) {
    let age = std::fs::metadata(path).and_then(|m| m.modified()).ok().and_then(|t| t.elapsed().ok());
    let ours = path.extension().is_some_and(|e| e == "part")
        || path.file_name().is_some_and(|n| n.to_string_lossy().starts_with(".export-"));
    if ours && age.is_some_and(|a| a > LEFT_OVER) {
        let _ = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_of_the_wall_clock_ends_removing_for_a_day() {
        let began = clock::now();
        let after = |s: u64| began + Duration::from_secs(s);
        let wall_ns = |s: i64| s * 1_000_000_000;
        let mut clocks = Clocks::new(began, wall_ns(1000));
        assert_eq!(clocks.step_s(after(600), wall_ns(1620)), None, "20 s are no step");
        assert!(!clocks.may_prune(after(600)), "the clock may still be set");
        assert!(clocks.may_prune(after(3600)));
        assert_eq!(clocks.step_s(after(601), wall_ns(315_360_000)).map(|s| s > 3e8), Some(true));
        assert!(!clocks.may_prune(after(601)) && !clocks.may_prune(after(80_000)));
        assert!(clocks.may_prune(after(601 + 86_400)));
        assert!(clocks.step_s(after(602), wall_ns(1622)).is_some_and(|s| s < -3e8), "back again");
    }

    #[test]
    fn the_file_system_has_a_size_and_room() {
        let (available, size) = space(Path::new("/tmp")).unwrap();
        assert!(available <= size && size > 1_000_000, "{available} of {size}");
        assert_eq!(space(Path::new("/tmp/there/is/nothing")), None);
    }

    #[test]
    fn only_the_newest_copies_and_diagnoses_stay() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for time in 100..106 {
            for suffix in ["", "-wal"] {
                std::fs::write(path(&format!("history.sqlite.damaged-{time}{suffix}")), "x").unwrap();
            }
            std::fs::write(path(&format!("history.before-4-{time}.sqlite")), "x").unwrap();
        }
        for number in 0..105 {
            std::fs::create_dir_all(path(&format!("diagnoses/01{number:03}"))).unwrap();
        }
        std::fs::create_dir_all(path("recordings")).unwrap();
        for name in ["recordings/.a.parquet.7.part", "recordings/.b.parquet.8.part", "recordings/c.parquet"] {
            std::fs::write(path(name), "x").unwrap();
        }
        let old = std::time::UNIX_EPOCH + 2 * LEFT_OVER;
        let file = std::fs::File::options().write(true).open(path("recordings/.a.parquet.7.part")).unwrap();
        file.set_modified(old).unwrap();
        std::fs::write(path(FILE_NAME), "the history itself").unwrap();
        tidy_folder(folder.path());
        let mut left = names_in(folder.path());
        left.sort_unstable();
        assert_eq!(left.iter().filter(|n| n.contains("damaged-")).count(), 6, "{left:?}");
        assert!(
            left.contains(&"history.sqlite.damaged-105-wal".to_owned())
                && left.contains(&FILE_NAME.to_owned())
        );
        assert!(!left.contains(&"history.before-4-102.sqlite".to_owned()), "{left:?}");
        assert_eq!(names_in(&path("diagnoses")).len(), DIAGNOSES);
        let mut recordings = names_in(&path("recordings"));
        recordings.sort_unstable();
        assert_eq!(recordings, [".b.parquet.8.part", "c.parquet"]);
    }
}
