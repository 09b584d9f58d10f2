//! The history file: durability, migrations, damage, retention, the audit chain.

use crate::folders::project;
use sqlx::migrate::{Migration, MigrationType, Migrator};
use sqlx::{Connection as _, Row as _, SqliteConnection};
use std::path::Path;
use std::sync::Arc;
use stillcut::store::{
    AuditEntry, AuditVerdict, EventFilter, FILE_NAME, Removed, Retention, StoreError, StoreWriter,
    migrations, verify_audit_file,
};
use stillcut::telemetry::{Event, EventKind, Metrics};

const KEEP: Retention =
    Retention { max_age_ns: i64::MAX, max_bytes: u64::MAX, audit_rows: u64::MAX, outbox: false };

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap()
}

fn metrics() -> Arc<Metrics> {
    Arc::new(Metrics::new(&[], 0.0).unwrap())
}

fn event(id: &str, wall_ns: i64) -> Event {
    Event { id: id.into(), ..Event::new(EventKind::ChatterEnd, wall_ns, "chatter ended") }
}

fn alarm(id: &str, wall_ns: i64) -> Event {
    Event { id: id.into(), ..Event::new(EventKind::ChatterOnset, wall_ns, "chatter") }
}

fn entry(wall_ns: i64, detail: String) -> AuditEntry {
    let (actor, role, action) = ("anna".into(), "engineer".into(), "set_mode".into());
    AuditEntry { wall_ns, actor, role, action, detail }
}

async fn connect(path: &Path) -> SqliteConnection {
    SqliteConnection::connect(&format!("sqlite://{}", path.display())).await.unwrap()
}

/// Writes `count` events and closes.
async fn fill(folder: &Path, count: i64) {
    let (writer, reader, _) = StoreWriter::start(folder, KEEP, metrics(), 1).await.unwrap();
    for k in 0..count {
        writer.store_durably(event(&format!("e{k}"), k)).await.unwrap();
    }
    reader.close().await;
    writer.close().await.unwrap();
}

#[test]
fn the_list_of_migrations_is_the_folder() {
    let folder = project("migrations");
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().flatten().map(|e| e.path()).collect();
    files.sort();
    let names: Vec<String> =
        files.iter().map(|p| p.file_name().unwrap().to_string_lossy().into_owned()).collect();
    let listed: Vec<String> = migrations().iter().map(|(v, name, _)| format!("{v:04}_{name}.sql")).collect();
    assert_eq!(names, listed);
    for (file, (_, _, text)) in files.iter().zip(migrations()) {
        assert_eq!(std::fs::read_to_string(file).unwrap(), text);
    }
}

#[test]
fn what_is_acknowledged_is_there_and_an_id_is_stored_once() {
    let folder = tempfile::tempdir().unwrap();
    runtime().block_on(async {
        let (writer, reader, report) = StoreWriter::start(folder.path(), KEEP, metrics(), 1).await.unwrap();
        assert_eq!((report.epoch, report.damage), (1, None));
        let first = writer.store_durably(event("same", 5)).await.unwrap();
        let second = writer.store_durably(event("same", 5)).await.unwrap();
        assert_eq!(first.sequence, second.sequence);
        let page = reader.page(&EventFilter { limit: 10, ..EventFilter::default() }).await.unwrap();
        assert_eq!(page.events, std::slice::from_ref(&first));
        let by = |actor: &str, wall_ns| AuditEntry { actor: actor.into(), ..entry(wall_ns, "d".into()) };
        assert!(writer.acknowledge(first.sequence, Some(false), by("anna", 9)).await.unwrap());
        assert!(writer.acknowledge(first.sequence, None, by("bert", 10)).await.unwrap());
        assert!(!writer.acknowledge(999, None, by("carl", 11)).await.unwrap(), "there is no such event");
        assert!(!writer.silence(999, 50, by("carl", 11)).await.unwrap());
        let rows = reader.audit(0).await.unwrap();
        let actors: Vec<&str> = rows.iter().map(|r| r.entry.actor.as_str()).collect();
        assert_eq!(actors, ["anna", "bert"], "a row for what was done, none for what was not");
        let seen = reader.event(first.sequence).await.unwrap().unwrap();
        assert_eq!((seen.acknowledged_by.as_deref(), seen.acknowledged_ns), (Some("anna"), Some(9)));
    });
    runtime().block_on(async {
        let (_, _, report) = StoreWriter::start(folder.path(), KEEP, metrics(), 1).await.unwrap();
        assert_eq!(report.epoch, 2, "epochs grow with every start");
    });
    // A history that is restored from a copy knows fewer lives: the time is above all of them. A clock set back is not.
    for (wall_s, epoch) in [(1_790_000_000_i64, 1_790_000_000), (1_000, 1_790_000_001)] {
        runtime().block_on(async {
            let started = StoreWriter::start(folder.path(), KEEP, metrics(), wall_s * 1_000_000_000).await;
            assert_eq!(started.unwrap().2.epoch, epoch);
        });
    }
}

/// A history as the version that knew so many migrations left it, with three events.
pub(crate) async fn older_history(path: &Path, versions: usize) {
    std::fs::write(path, "").unwrap();
    let mut connection = connect(path).await;
    let one = |(version, name, sql): &(i64, &'static str, &'static str)| {
        let (name, sql) = ((*name).into(), sqlx::SqlSafeStr::into_sql_str(*sql));
        Migration::new(*version, name, MigrationType::Simple, sql, false)
    };
    let migrator = Migrator::with_migrations(migrations()[..versions].iter().map(one).collect());
    migrator.run_direct(None, &mut connection, false).await.unwrap();
    for k in 0..3 {
        let insert = "INSERT INTO event (id, wall_ns, kind, text) VALUES (?, ?, 'chatter_onset', 't')";
        sqlx::query(insert).bind(format!("e{k}")).bind(k).execute(&mut connection).await.unwrap();
    }
    connection.close().await.unwrap();
}

/// The file as each earlier version left it.
#[test]
fn an_older_schema_is_copied_then_brought_up_to_date() {
    let all = migrations();
    for versions in 1..all.len() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE_NAME);
        runtime().block_on(async {
            older_history(&path, versions).await;
            let (writer, reader, report) =
                StoreWriter::start(folder.path(), KEEP, metrics(), 77).await.unwrap();
            let copy = report.copy.unwrap_or_else(|| panic!("version {versions}: a copy is made first"));
            assert!(copy.is_file() && report.damage.is_none());
            let page = reader.page(&EventFilter { limit: 10, ..EventFilter::default() }).await.unwrap();
            assert_eq!(page.events.len(), 3);
            assert_eq!(writer.audit(entry(1, "d".into())).await.unwrap(), 1);
            assert_eq!(reader.open_alarms(0).await.unwrap(), 3);
            writer.note_settings(report.epoch, "hash").await.unwrap();
            assert_eq!(reader.settings_before(report.epoch + 1).await.unwrap().as_deref(), Some("hash"));
        });
    }
}

#[test]
fn a_newer_schema_is_refused_and_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(FILE_NAME);
    runtime().block_on(async {
        fill(folder.path(), 1).await;
        let mut connection =
            SqliteConnection::connect(&format!("sqlite://{}", path.display())).await.unwrap();
        let newer = "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time) \
             VALUES (99, 'later', 1, x'00', 0)";
        sqlx::query(newer).execute(&mut connection).await.unwrap();
        connection.close().await.unwrap();
        let before = std::fs::read(&path).unwrap();
        let error = StoreWriter::start(folder.path(), KEEP, metrics(), 1).await.unwrap_err();
        assert!(matches!(error, StoreError::NewerSchema { found: 99, .. }), "{error}");
        assert_eq!(error.to_string().lines().count(), 1);
        assert_eq!(std::fs::read(&path).unwrap(), before);
    });
}

/// Kinds of damage; each must end in a fresh history with the damaged file set aside, or, where SQLite
/// can still read everything, in the old one.
#[test]
fn damage_is_set_aside_with_its_log_and_a_fresh_history_begins() {
    type Damage = (&'static str, fn(&Path));
    fn edit(path: &Path, at: usize, bytes: &[u8]) {
        let mut all = std::fs::read(path).unwrap();
        let end = (at + bytes.len()).min(all.len());
        all[at..end].copy_from_slice(&bytes[..end - at]);
        std::fs::write(path, all).unwrap();
    }
    let kinds: [Damage; 8] = [
        ("header", |p| edit(p, 0, b"not a database!!")),
        ("page size", |p| edit(p, 16, &[0x03, 0x03])),
        ("schema page", |p| edit(p, 100, &[0xff; 64])),
        ("every later page", |p| {
            let length = std::fs::metadata(p).unwrap().len() as usize;
            edit(p, 4096, &vec![0xa5; length - 4096]);
        }),
        ("cut in half", |p| {
            let length = std::fs::metadata(p).unwrap().len();
            std::fs::File::options().write(true).open(p).unwrap().set_len(length / 2 / 4096 * 4096).unwrap();
        }),
        ("cut inside a page", |p| {
            std::fs::File::options().write(true).open(p).unwrap().set_len(5000).unwrap()
        }),
        ("text instead", |p| std::fs::write(p, "hello, I am a note\n".repeat(500)).unwrap()),
        ("migration tampered with", |p| {
            runtime().block_on(async {
                let mut c = SqliteConnection::connect(&format!("sqlite://{}", p.display())).await.unwrap();
                sqlx::query("UPDATE _sqlx_migrations SET checksum = x'00'").execute(&mut c).await.unwrap();
                c.close().await.unwrap();
            });
        }),
    ];
    for (name, damage) in kinds {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE_NAME);
        runtime().block_on(fill(folder.path(), 200));
        runtime().block_on(async {
            let mut c = SqliteConnection::connect(&format!("sqlite://{}", path.display())).await.unwrap();
            sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&mut c).await.unwrap();
            c.close().await.unwrap();
        });
        for suffix in ["-wal", "-shm"] {
            let _ = std::fs::remove_file(folder.path().join(format!("{FILE_NAME}{suffix}")));
        }
        damage(&path);
        runtime().block_on(async {
            let started = StoreWriter::start(folder.path(), KEEP, metrics(), 1_700_000_000_000_000_000).await;
            let (writer, reader, report) = started.unwrap_or_else(|e| panic!("{name}: {e}"));
            let found = report.damage.unwrap_or_else(|| panic!("{name}: damage was not noticed"));
            assert!(found.moved_to.is_file(), "{name}: {}", found.moved_to.display());
            assert!(report.epoch > 1_000_000_000, "{name}: epochs go on growing: {}", report.epoch);
            let stored = writer.store_durably(event("after", 1)).await.unwrap();
            assert!(reader.event(stored.sequence).await.unwrap().is_some(), "{name}");
        });
    }
}

/// Log and index of the log damaged: at most what stood in the log is gone, and the history goes on.
#[test]
fn a_damaged_log_costs_no_more_than_what_stood_in_it() {
    type Damage = (&'static str, &'static str, fn(&mut Vec<u8>));
    let kinds: [Damage; 6] = [
        ("log empty", "-wal", Vec::clear),
        ("log of noise", "-wal", |b| b.fill(0xa5)),
        ("log cut", "-wal", |b| b.truncate(b.len() / 2 + 7)),
        ("log's end", "-wal", |b| {
            let from = b.len() * 3 / 4;
            b[from..].fill(0x5a);
        }),
        ("index of noise", "-shm", |b| b.fill(0xa5)),
        ("index empty", "-shm", Vec::clear),
    ];
    let source = tempfile::tempdir().unwrap();
    let runtime = runtime();
    let writer = runtime.block_on(async {
        fill(source.path(), 100).await;
        let (writer, _, _) = StoreWriter::start(source.path(), KEEP, metrics(), 1).await.unwrap();
        writer.store_durably(event("late", 500)).await.unwrap();
        writer
    });
    for (name, suffix, damage) in kinds {
        let folder = tempfile::tempdir().unwrap();
        for part in ["", "-wal", "-shm"] {
            let file = format!("{FILE_NAME}{part}");
            let mut bytes = std::fs::read(source.path().join(&file)).unwrap();
            if part == suffix {
                damage(&mut bytes);
            }
            std::fs::write(folder.path().join(&file), bytes).unwrap();
        }
        runtime.block_on(async {
            let started = StoreWriter::start(folder.path(), KEEP, metrics(), 1_700_000_000_000_000_000).await;
            let (writer, reader, _) = started.unwrap_or_else(|e| panic!("{name}: {e}"));
            let stored = writer.store_durably(event("after", 1)).await.unwrap();
            assert!(reader.event(stored.sequence).await.unwrap().is_some(), "{name}");
            let page = reader.page(&EventFilter { limit: 1000, ..EventFilter::default() }).await.unwrap();
            if suffix == "-shm" {
                assert_eq!(page.events.len(), 102, "{name}: the log itself is whole");
            }
            writer.close().await.unwrap();
        });
    }
    drop(writer);
}

#[test]
fn an_empty_file_is_a_fresh_history() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join(FILE_NAME), b"").unwrap();
    runtime().block_on(fill(folder.path(), 1));
}

#[test]
fn an_empty_file_with_an_earlier_life_is_set_aside() {
    type Trace = fn(&Path);
    let traces: [(&str, Trace); 3] = [
        ("reserve", |f| std::fs::write(f.join("history.reserve"), [0; 10]).unwrap()),
        ("log", |f| std::fs::write(f.join(format!("{FILE_NAME}-wal")), "log").unwrap()),
        ("recordings", |f| {
            std::fs::create_dir(f.join("recordings")).unwrap();
            std::fs::write(f.join("recordings/r.parquet"), "r").unwrap();
        }),
    ];
    for (name, trace) in traces {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(FILE_NAME), b"").unwrap();
        trace(folder.path());
        runtime().block_on(async {
            let (_, _, report) = StoreWriter::start(folder.path(), KEEP, metrics(), 1).await.unwrap();
            let found = report.damage.unwrap_or_else(|| panic!("{name}: not noticed"));
            assert!(found.reason.starts_with("empty") && found.moved_to.is_file(), "{name}: {found:?}");
        });
    }
}

#[test]
fn a_schema_that_was_changed_is_set_aside() {
    for change in [
        "ALTER TABLE event RENAME COLUMN text TO txt",
        "DROP TABLE event",
        "DROP TABLE audit",
        "DROP TABLE outbox",
        "ALTER TABLE life DROP COLUMN settings",
    ] {
        let folder = tempfile::tempdir().unwrap();
        runtime().block_on(async {
            fill(folder.path(), 3).await;
            let mut c = connect(&folder.path().join(FILE_NAME)).await;
            sqlx::query(change).execute(&mut c).await.unwrap();
            c.close().await.unwrap();
            let (writer, reader, report) =
                StoreWriter::start(folder.path(), KEEP, metrics(), 7).await.unwrap();
            let found = report.damage.unwrap_or_else(|| panic!("{change}: not noticed"));
            assert!(found.moved_to.is_file(), "{change}");
            let stored = writer.store_durably(event("after", 1)).await.unwrap();
            assert!(reader.event(stored.sequence).await.unwrap().is_some(), "{change}");
        });
    }
}

#[test]
fn retention_by_age_and_size_removes_the_oldest() {
    let folder = tempfile::tempdir().unwrap();
    runtime().block_on(async {
        let keep = Retention { max_age_ns: 50, ..KEEP };
        let (writer, reader, _) = StoreWriter::start(folder.path(), keep, metrics(), 1).await.unwrap();
        for k in 0..100 {
            writer.store_durably(event(&format!("e{k}"), k)).await.unwrap();
        }
        assert_eq!(writer.prune(100).await.unwrap(), Removed { aged: 50, ..Removed::default() });
        let all = EventFilter { limit: 1000, ascending: true, ..EventFilter::default() };
        let left = reader.page(&all).await.unwrap().events;
        assert_eq!((left.len(), left[0].wall_ns), (50, 50));
    });
    runtime().block_on(async {
        let keep = Retention { max_bytes: 1, ..KEEP };
        let (writer, reader, _) = StoreWriter::start(folder.path(), keep, metrics(), 1).await.unwrap();
        assert_eq!(writer.prune(100).await.unwrap(), Removed { oversize: 50, ..Removed::default() });
        let all = EventFilter { limit: 10, ..EventFilter::default() };
        assert!(reader.page(&all).await.unwrap().events.is_empty());
    });
}

/// What waits for a person or for the broker stays, until nothing else is left to remove.
#[test]
fn retention_spares_open_alarms_and_what_the_broker_has_not_taken() {
    let folder = tempfile::tempdir().unwrap();
    runtime().block_on(async {
        let keep = Retention { max_age_ns: 0, max_bytes: 1, outbox: true, ..KEEP };
        let (writer, reader, _) = StoreWriter::start(folder.path(), keep, metrics(), 1).await.unwrap();
        for k in 0..10 {
            writer.store_durably(alarm(&format!("a{k}"), k)).await.unwrap();
            writer.store_durably(event(&format!("e{k}"), k)).await.unwrap();
        }
        let left = || async {
            let all = EventFilter { limit: 1000, ascending: true, ..EventFilter::default() };
            reader.page(&all).await.unwrap().events
        };
        writer.acknowledge(1, None, entry(5, "d".into())).await.unwrap();
        writer.confirm("nats", 4).await.unwrap();
        // Sent: 1 to 4. Of these 3 is an alarm that nobody acknowledged.
        assert_eq!(writer.prune(1000).await.unwrap(), Removed { aged: 3, ..Removed::default() });
        assert_eq!(left().await.iter().map(|e| e.sequence).collect::<Vec<_>>()[..2], [3, 5]);
        assert_eq!(reader.open_alarms(1000).await.unwrap(), 9);
        writer.silence(3, 2000, entry(5, "d".into())).await.unwrap();
        assert_eq!(reader.open_alarms(1000).await.unwrap(), 8, "silenced");
        // Nothing is free to go and the file is far too large: the oldest go, and it is told.
        assert_eq!(writer.prune(1000).await.unwrap(), Removed { forced: 17, ..Removed::default() });
        assert!(left().await.is_empty());
    });
}

#[test]
fn the_audit_record_is_bounded_and_its_chain_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(FILE_NAME);
    runtime().block_on(async {
        let keep = Retention { audit_rows: 20, ..KEEP };
        let (writer, reader, _) = StoreWriter::start(folder.path(), keep, metrics(), 1).await.unwrap();
        for round in 0..3 {
            for k in 0..30 {
                writer.audit(entry(k, format!("row {k} of {round}"))).await.unwrap();
            }
            assert!(writer.prune(5).await.unwrap().audit >= 10);
            let AuditVerdict::Intact { head, .. } = verify_audit_file(&path, None).await.unwrap() else {
                panic!("round {round}: the chain holds");
            };
            assert_eq!(reader.audit(0).await.unwrap().len(), 21);
            writer.audit(entry(9, "after".into())).await.unwrap();
            let again = verify_audit_file(&path, Some(&head)).await.unwrap();
            assert!(matches!(again, AuditVerdict::Intact { .. }), "{again:?}");
        }
        assert_eq!(writer.prune(5).await.unwrap().audit, 2);
        assert_eq!(writer.prune(5).await.unwrap().audit, 0, "it comes to rest");
        writer.close().await.unwrap();
        // A beginning that no row of the chain speaks of is a forgery.
        let mut c = connect(&path).await;
        let rows = sqlx::query("SELECT sequence, hash FROM audit ORDER BY sequence LIMIT 1 OFFSET 5");
        let row = rows.fetch_one(&mut c).await.unwrap();
        let (cut, hash): (i64, Vec<u8>) = (row.get(0), row.get(1));
        sqlx::query("DELETE FROM audit WHERE sequence <= ?").bind(cut).execute(&mut c).await.unwrap();
        let forged = sqlx::query("UPDATE audit_begin SET sequence = ?, hash = ?").bind(cut).bind(hash);
        forged.execute(&mut c).await.unwrap();
        c.close().await.unwrap();
        let verdict = verify_audit_file(&path, None).await.unwrap();
        assert_eq!(verdict, AuditVerdict::Broken { sequence: cut + 1 });
    });
}

/// Where the whole file went, or all that was in it, the notes beside it say how much that was.
#[test]
fn a_history_that_is_gone_is_missing_to_the_row() {
    for (names, emptied) in
        [(vec![FILE_NAME], true), (vec![FILE_NAME], false), (vec![FILE_NAME, "history.reserve"], false)]
    {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE_NAME);
        runtime().block_on(async {
            let (writer, reader, _) = StoreWriter::start(folder.path(), KEEP, metrics(), 1).await.unwrap();
            for k in 0..3 {
                writer.audit(entry(k, format!("row {k}"))).await.unwrap();
            }
            reader.close().await;
            writer.close().await.unwrap();
            let AuditVerdict::Intact { rows, head, .. } = verify_audit_file(&path, None).await.unwrap()
            else {
                panic!("intact before");
            };
            for suffix in ["-wal", "-shm"] {
                let _ = std::fs::remove_file(folder.path().join(format!("{FILE_NAME}{suffix}")));
            }
            names.iter().for_each(|name| std::fs::remove_file(folder.path().join(name)).unwrap());
            if emptied {
                std::fs::write(&path, "").unwrap();
            }
            let AuditVerdict::Cut(missing) = verify_audit_file(&path, None).await.unwrap() else {
                panic!("{names:?}: what is not there is missing");
            };
            assert!(rows >= 3);
            assert_eq!((missing.audit_rows, missing.noted, missing.found), (rows, (rows, head), 0));
        });
    }
    let nowhere = tempfile::tempdir().unwrap().path().join(FILE_NAME);
    assert!(runtime().block_on(verify_audit_file(&nowhere, None)).is_err());
}

/// A history of years: the start does not read it all, open alarms are counted without reading it, and damage
/// in its middle is found behind the running service and set aside at the next start.
#[test]
fn a_large_history_is_checked_behind_the_start() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(FILE_NAME);
    runtime().block_on(async {
        fill(folder.path(), 3).await;
        let mut c = connect(&path).await;
        let many = "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n WHERE k < 300000) \
             INSERT INTO event (id, wall_ns, kind, text, acknowledged_ns) \
             SELECT 'many' || k, k, 'chatter_onset', 'chatter began at 652.0 Hz on axis x1', 1 FROM n";
        sqlx::query(many).execute(&mut c).await.unwrap();
        sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&mut c).await.unwrap();
        c.close().await.unwrap();
        let (writer, reader, report) = StoreWriter::start(folder.path(), KEEP, metrics(), 1).await.unwrap();
        assert!(report.unchecked && report.damage.is_none());
        reader.check_whole().await.unwrap();
        assert_eq!(reader.open_alarms(0).await.unwrap(), 0);
        let open = EventFilter { unacknowledged_alarms: true, limit: 10, ..EventFilter::default() };
        for cursor in [None, Some(5), Some(200_000)] {
            let kind = cursor.map(|_| EventKind::ChatterOnset);
            let page = reader.page(&EventFilter { cursor, kind, ..open.clone() }).await.unwrap();
            assert!(page.events.is_empty(), "found by the index of open alarms");
        }
        reader.close().await;
        writer.close().await.unwrap();
    });
    let length = std::fs::metadata(&path).unwrap().len();
    let file = std::fs::File::options().write(true).open(&path).unwrap();
    std::os::unix::fs::FileExt::write_all_at(&file, &[0xa5; 4096], length / 2 / 4096 * 4096).unwrap();
    drop(file);
    runtime().block_on(async {
        let (writer, reader, report) = StoreWriter::start(folder.path(), KEEP, metrics(), 1).await.unwrap();
        assert!(report.unchecked && report.damage.is_none(), "not seen at the start");
        assert!(reader.check_whole().await.is_err());
        reader.close().await;
        let _ = writer.close().await;
        let (_, _, report) = StoreWriter::start(folder.path(), KEEP, metrics(), 2).await.unwrap();
        assert!(report.damage.is_some_and(|d| d.moved_to.is_file()), "set aside");
    });
}

#[test]
fn tampering_with_the_audit_record_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(FILE_NAME);
    const ROWS: i64 = 10_000;
    let head = runtime().block_on(async {
        let (writer, reader, _) = StoreWriter::start(folder.path(), KEEP, metrics(), 1).await.unwrap();
        for half in 0..2 {
            let rows = (0..ROWS / 2).map(|k| {
                let writer = writer.clone();
                tokio::spawn(async move { writer.audit(entry(k, format!("mode act {k}"))).await.unwrap() })
            });
            for (k, row) in rows.collect::<Vec<_>>().into_iter().enumerate() {
                assert!(row.await.unwrap() > 0, "{half} {k}");
            }
        }
        reader.close().await;
        match verify_audit_file(&path, None).await.unwrap() {
            AuditVerdict::Intact { rows, head, .. } => {
                assert_eq!(rows, ROWS);
                head
            }
            other => panic!("{other:?}"),
        }
    });
    let tampered: [(&str, i64); 6] = [
        ("UPDATE audit SET detail = 'mode observe' WHERE sequence = 100", 100),
        ("UPDATE audit SET actor = 'bert' WHERE sequence = 1", 1),
        ("UPDATE audit SET wall_ns = -1 WHERE sequence = 9999", 9999),
        ("DELETE FROM audit WHERE sequence = 5000", 5001),
        (
            "UPDATE audit SET sequence = CASE sequence WHEN 7 THEN -8 WHEN 8 THEN -7 END WHERE sequence IN (7, 8); \
          UPDATE audit SET sequence = -sequence WHERE sequence < 0",
            7,
        ),
        ("DELETE FROM audit WHERE sequence > 9990", -1),
    ];
    for (statement, expected) in tampered {
        let copy = folder.path().join("copy.sqlite");
        let _ = std::fs::remove_file(&copy);
        runtime().block_on(async {
            let mut original =
                SqliteConnection::connect(&format!("sqlite://{}", path.display())).await.unwrap();
            sqlx::query("VACUUM INTO ?").bind(copy.to_str().unwrap()).execute(&mut original).await.unwrap();
            original.close().await.unwrap();
            let mut c = SqliteConnection::connect(&format!("sqlite://{}", copy.display())).await.unwrap();
            sqlx::raw_sql(statement).execute(&mut c).await.unwrap();
            let count: i64 =
                sqlx::query("SELECT count(*) FROM audit").fetch_one(&mut c).await.unwrap().get(0);
            assert!(count >= ROWS - 10);
            c.close().await.unwrap();
            let verdict = verify_audit_file(&copy, Some(&head)).await.unwrap();
            match verdict {
                AuditVerdict::Broken { sequence } => assert_eq!(sequence, expected, "{statement}"),
                AuditVerdict::HeadMissing { rows } => {
                    assert_eq!((rows, expected), (ROWS - 10, -1), "{statement}")
                }
                other => panic!("not found: {statement}: {other:?}"),
            }
        });
    }
}

/// A process that is killed leaves the log as it is; what a damaged, cut or deleted log took away is told at
/// the next start, on record, and before that start by whoever verifies the record.
#[test]
fn what_was_durable_and_is_missing_is_told() {
    type Damage = (&'static str, fn(&Path));
    let kinds: [Damage; 5] = [
        ("nothing", |_| {}),
        ("four bytes", |f| {
            let path = f.join(format!("{FILE_NAME}-wal"));
            let mut bytes = std::fs::read(&path).unwrap();
            let middle = bytes.len() / 2;
            bytes[middle..middle + 4].fill(0xa5);
            std::fs::write(path, bytes).unwrap();
        }),
        ("cut", |f| {
            let path = f.join(format!("{FILE_NAME}-wal"));
            let length = std::fs::metadata(&path).unwrap().len();
            std::fs::File::options().write(true).open(path).unwrap().set_len(length / 3).unwrap();
        }),
        ("deleted", |f| std::fs::remove_file(f.join(format!("{FILE_NAME}-wal"))).unwrap()),
        ("all deleted", |f| {
            for part in ["", "-wal", "-shm"] {
                std::fs::remove_file(f.join(format!("{FILE_NAME}{part}"))).unwrap();
            }
        }),
    ];
    let source = tempfile::tempdir().unwrap();
    let runtime = runtime();
    let writer = runtime.block_on(async {
        let (writer, _, _) = StoreWriter::start(source.path(), KEEP, metrics(), 1).await.unwrap();
        for k in 0..60 {
            let event = writer.store_durably(event(&format!("e{k}"), k)).await.unwrap();
            assert!(writer.acknowledge(event.sequence, None, entry(k, format!("event {k}"))).await.unwrap());
        }
        writer
    });
    for (name, damage) in kinds {
        let folder = tempfile::tempdir().unwrap();
        for file in std::fs::read_dir(source.path()).unwrap().flatten() {
            std::fs::copy(file.path(), folder.path().join(file.file_name())).unwrap();
        }
        damage(folder.path());
        let path = folder.path().join(FILE_NAME);
        runtime.block_on(async {
            if path.exists() {
                let verdict = verify_audit_file(&path, None).await.unwrap();
                let cut = matches!(&verdict, AuditVerdict::Cut(missing) if missing.audit_rows > 0);
                assert_eq!(cut, name != "nothing", "{name}: {verdict:?}");
            }
            let metrics = metrics();
            let (writer, _, report) =
                StoreWriter::start(folder.path(), KEEP, Arc::clone(&metrics), 1).await.unwrap();
            let counted = |table| Metrics::total(&metrics.history_lost, &[table]);
            // The log as it was found is kept where something is missing, and nowhere else.
            let logs = std::fs::read_dir(folder.path()).unwrap().flatten();
            let kept: Vec<_> =
                logs.filter(|f| f.file_name().to_string_lossy().contains(".log")).map(|f| f.path()).collect();
            assert_eq!(kept.first(), report.log_kept.as_ref(), "{name}");
            assert_eq!(kept.len(), usize::from(["four bytes", "cut"].contains(&name)), "{name}: {kept:?}");
            if name == "four bytes" {
                let (kept, log) = (std::fs::read(&kept[0]).unwrap(), source.path().join(FILE_NAME));
                let before = std::fs::read(format!("{}-wal", log.display())).unwrap();
                let same = kept.iter().zip(&before).filter(|(a, b)| a == b).count();
                assert!(kept.len() == before.len() && same + 4 >= before.len(), "nothing behind it is lost");
            }
            match report.missing {
                None => assert_eq!((name, counted("audit")), ("nothing", 0)),
                Some(missing) => {
                    assert_ne!(name, "nothing");
                    assert!(missing.audit_rows > 0 && missing.events > 0, "{name}: {missing:?}");
                    assert_eq!(missing.noted.0, 60, "{name}");
                    assert_eq!(missing.found, 60 - missing.audit_rows, "{name}");
                    assert_eq!(counted("audit"), missing.audit_rows as u64);
                    assert_eq!(counted("event"), missing.events as u64);
                }
            }
            writer.store_durably(event("after", 1)).await.unwrap();
            writer.close().await.unwrap();
            // From now on the record itself says that rows are missing, once.
            for life in 0..2 {
                match verify_audit_file(&path, None).await.unwrap() {
                    AuditVerdict::Intact { cuts, .. } => {
                        assert_eq!(cuts.len(), usize::from(name != "nothing"), "{name}, {life}: {cuts:?}");
                    }
                    other => panic!("{name}: {other:?}"),
                }
                let (writer, _, again) =
                    StoreWriter::start(folder.path(), KEEP, self::metrics(), 2).await.unwrap();
                assert_eq!(again.missing, None, "{name}: told once");
                writer.close().await.unwrap();
            }
        });
    }
    drop(writer);
}

/// The note of how far a history was durable stands twice: one copy tells what is missing without the other,
/// and that the other is; without both, nobody knows, and that is told for good.
#[test]
fn a_note_that_is_lost_is_told() {
    const NOTES: [&str; 2] = ["history.reserve", "history.mark"];
    let source = tempfile::tempdir().unwrap();
    let runtime = runtime();
    let writer = runtime.block_on(async {
        let (writer, _, first) = StoreWriter::start(source.path(), KEEP, metrics(), 1).await.unwrap();
        assert!(first.spoilt_notes.is_empty(), "a history that has just begun");
        for k in 0..20 {
            writer.audit(entry(k, format!("row {k}"))).await.unwrap();
        }
        writer
    });
    let zeros = |path: &Path| {
        let length = std::fs::metadata(path).unwrap().len();
        std::fs::write(path, vec![0; usize::try_from(length).unwrap()]).unwrap();
    };
    let gone = |path: &Path| std::fs::remove_file(path).unwrap();
    let spoil: [&dyn Fn(&Path); 2] = [&zeros, &gone];
    for (which, log_too) in [(vec![0], true), (vec![1], true), (vec![0], false), (vec![0, 1], true)] {
        for spoil in spoil {
            let folder = tempfile::tempdir().unwrap();
            for file in std::fs::read_dir(source.path()).unwrap().flatten() {
                std::fs::copy(file.path(), folder.path().join(file.file_name())).unwrap();
            }
            which.iter().for_each(|k: &usize| spoil(&folder.path().join(NOTES[*k])));
            let path = folder.path().join(FILE_NAME);
            if log_too {
                std::fs::remove_file(folder.path().join(format!("{FILE_NAME}-wal"))).unwrap();
            }
            runtime.block_on(async {
                let verdict = verify_audit_file(&path, None).await.unwrap();
                match &verdict {
                    AuditVerdict::Cut(missing) => assert!(log_too && missing.audit_rows > 0),
                    AuditVerdict::Intact { spoilt_notes, .. } => assert_eq!(spoilt_notes.len(), which.len()),
                    other => panic!("{other:?}"),
                }
                let told = matches!(verdict, AuditVerdict::Cut(_));
                assert_eq!(told, log_too && which.len() == 1, "{which:?}");
                let (writer, _, report) =
                    StoreWriter::start(folder.path(), KEEP, metrics(), 2).await.unwrap();
                assert_eq!(report.spoilt_notes.len(), which.len(), "{:?}", report.spoilt_notes);
                assert_eq!(report.missing.is_some(), told);
                writer.close().await.unwrap();
                let AuditVerdict::Intact { cuts, spoilt_notes, .. } =
                    verify_audit_file(&path, None).await.unwrap()
                else {
                    panic!("it goes on");
                };
                assert!(spoilt_notes.is_empty(), "{spoilt_notes:?}");
                assert_eq!(cuts.len(), usize::from(told || which.len() == 2), "{cuts:?}");
            });
        }
    }
    drop(writer);
}

/// A history that its owner may not write is refused by its own name, leaves nothing behind, and once it is
/// mended what was made beside it meanwhile does not stand in the way.
#[test]
fn a_history_that_was_read_only_starts_when_it_is_mended() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(FILE_NAME);
    let mode = |path: &Path, mode| {
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
    };
    runtime().block_on(async {
        fill(folder.path(), 3).await;
        mode(&path, 0o400);
        let refused = StoreWriter::start(folder.path(), KEEP, metrics(), 1).await.unwrap_err().to_string();
        assert!(refused.contains("history.sqlite: mode 400"), "{refused}");
        let index = folder.path().join(format!("{FILE_NAME}-shm"));
        assert!(!index.exists());
        std::fs::write(&index, "").unwrap();
        mode(&index, 0o400);
        mode(&path, 0o600);
        let (writer, _, _) = StoreWriter::start(folder.path(), KEEP, metrics(), 2).await.unwrap();
        writer.store_durably(event("after", 1)).await.unwrap();
        writer.close().await.unwrap();
    });
}

/// What is committed does not stand in the log alone for long: its damage takes no more away.
#[test]
fn the_main_file_follows_within_seconds() {
    let folder = tempfile::tempdir().unwrap();
    let runtime = runtime();
    let writer = runtime.block_on(async {
        let (writer, _, _) = StoreWriter::start(folder.path(), KEEP, metrics(), 1).await.unwrap();
        writer.store_durably(event("e", 1)).await.unwrap();
        tokio::time::sleep(std::time::Duration::from_millis(2500)).await;
        writer
    });
    let copy = tempfile::tempdir().unwrap();
    std::fs::copy(folder.path().join(FILE_NAME), copy.path().join(FILE_NAME)).unwrap();
    runtime.block_on(async {
        let mut main = connect(&copy.path().join(FILE_NAME)).await;
        let row = sqlx::query("SELECT count(*) FROM event").fetch_one(&mut main).await.unwrap();
        assert_eq!(row.get::<i64, _>(0), 1);
    });
    drop(writer);
}

/// A history that leads elsewhere, or that others can write, is not used, and is named; a new one is nobody
/// else's to read.
#[test]
fn places_that_others_can_change_are_refused_by_name() {
    use std::os::unix::fs::{PermissionsExt as _, symlink};
    let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
    let set =
        |path: &Path, bits| std::fs::set_permissions(path, std::fs::Permissions::from_mode(bits)).unwrap();
    let place = tempfile::tempdir().unwrap();
    let good = place.path().join("good");
    runtime().block_on(fill(&good, 1));
    assert_eq!((mode(&good), mode(&good.join(FILE_NAME)) & 0o027), (0o750, 0));
    assert_eq!(mode(&good.join("history.reserve")) & 0o027, 0);
    set(&good.join(FILE_NAME), 0o644);
    runtime().block_on(fill(&good, 2));
    assert_eq!(mode(&good.join(FILE_NAME)), 0o640, "one that was made by hand");
    let target = place.path().join("target");
    std::fs::write(&target, "mine").unwrap();
    let refused = |folder: &Path, word: &str| {
        let started = runtime().block_on(StoreWriter::start(folder, KEEP, metrics(), 1));
        let said = started.err().unwrap_or_else(|| panic!("{word} is refused")).to_string();
        assert!(said.contains(word), "{said}");
    };
    symlink(&good, place.path().join("link")).unwrap();
    refused(&place.path().join("link"), "link: is a symbolic link");
    for name in ["history.reserve", FILE_NAME] {
        let folder = place.path().join(name.replace('.', "-"));
        std::fs::create_dir(&folder).unwrap();
        symlink(&target, folder.join(name)).unwrap();
        refused(&folder, &format!("{name}: is a symbolic link"));
        assert_eq!(std::fs::read(&target).unwrap(), b"mine", "nothing is written over");
    }
    // A pipe without a writer: a start that opened it would wait for ever.
    for name in ["history.reserve", "history.mark", FILE_NAME] {
        let folder = place.path().join(name.replace('.', "-pipe-"));
        std::fs::create_dir(&folder).unwrap();
        let pipe = folder.join(name);
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        refused(&folder, &format!("{name}: is no file"));
    }
    set(&good, 0o777);
    refused(&good, "good: mode 777 lets every user write");
}
