//! The history file: durability, migrations, damage, retention, the audit chain.

use crate::folders::project;
use sqlx::{Connection as _, Row as _, SqliteConnection};
use std::path::Path;
use std::sync::Arc;
use stillcut::store::{
    AuditEntry, AuditVerdict, EventFilter, FILE_NAME, Retention, StoreError, StoreWriter, migrations,
    verify_audit_file,
};
use stillcut::telemetry::{Event, EventKind, Metrics};

const KEEP: Retention = Retention { max_age_ns: i64::MAX, max_bytes: u64::MAX };

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap()
}

fn metrics() -> Arc<Metrics> {
    Arc::new(Metrics::new(&[], 0.0).unwrap())
}

fn event(id: &str, wall_ns: i64) -> Event {
    Event { id: id.into(), ..Event::new(EventKind::ChatterOnset, wall_ns, "chatter") }
}

/// Writes `count` events and closes.
async fn fill(folder: &Path, count: i64) {
    let (writer, reader, _) = StoreWriter::start(folder, KEEP, metrics(), 1).await.unwrap();
    for k in 0..count {
        writer.store_durably(event(&format!("e{k}"), k)).await.unwrap();
    }
    reader.close().await;
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
        assert_eq!(page.events, [first.clone()]);
        assert!(writer.acknowledge(first.sequence, "anna", 9).await.unwrap());
        assert!(!writer.acknowledge(first.sequence, "bert", 10).await.unwrap(), "once");
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

#[test]
fn an_older_schema_is_copied_then_brought_up_to_date() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(FILE_NAME);
    runtime().block_on(async {
        // The file as the first version left it.
        fill(folder.path(), 3).await;
        let mut connection =
            SqliteConnection::connect(&format!("sqlite://{}", path.display())).await.unwrap();
        sqlx::query("DROP TABLE outbox").execute(&mut connection).await.unwrap();
        sqlx::query("DROP TABLE audit").execute(&mut connection).await.unwrap();
        sqlx::query("DELETE FROM _sqlx_migrations WHERE version > 1").execute(&mut connection).await.unwrap();
        connection.close().await.unwrap();
        let (writer, reader, report) = StoreWriter::start(folder.path(), KEEP, metrics(), 77).await.unwrap();
        let copy = report.copy.expect("a copy was made first");
        assert!(copy.is_file() && report.damage.is_none());
        let page = reader.page(&EventFilter { limit: 10, ..EventFilter::default() }).await.unwrap();
        assert_eq!(page.events.len(), 3);
        let entry = AuditEntry {
            wall_ns: 1,
            actor: "a".into(),
            role: "r".into(),
            action: "x".into(),
            detail: "d".into(),
        };
        assert_eq!(writer.audit(entry).await.unwrap(), 1);
    });
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

#[test]
fn an_empty_file_is_a_fresh_history() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join(FILE_NAME), b"").unwrap();
    runtime().block_on(fill(folder.path(), 1));
}

#[test]
fn retention_by_age_and_size_removes_the_oldest() {
    let folder = tempfile::tempdir().unwrap();
    runtime().block_on(async {
        let keep = Retention { max_age_ns: 50, max_bytes: u64::MAX };
        let (writer, reader, _) = StoreWriter::start(folder.path(), keep, metrics(), 1).await.unwrap();
        for k in 0..100 {
            writer.store_durably(event(&format!("e{k}"), k)).await.unwrap();
        }
        assert_eq!(writer.prune(100).await.unwrap(), 50);
        let all = EventFilter { limit: 1000, ascending: true, ..EventFilter::default() };
        let left = reader.page(&all).await.unwrap().events;
        assert_eq!((left.len(), left[0].wall_ns), (50, 50));
    });
    runtime().block_on(async {
        let keep = Retention { max_age_ns: i64::MAX, max_bytes: 1 };
        let (writer, reader, _) = StoreWriter::start(folder.path(), keep, metrics(), 1).await.unwrap();
        assert_eq!(writer.prune(100).await.unwrap(), 50);
        let all = EventFilter { limit: 10, ..EventFilter::default() };
        assert!(reader.page(&all).await.unwrap().events.is_empty());
    });
}

#[test]
fn tampering_with_the_audit_record_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(FILE_NAME);
    const ROWS: i64 = 300;
    let head = runtime().block_on(async {
        let (writer, reader, _) = StoreWriter::start(folder.path(), KEEP, metrics(), 1).await.unwrap();
        let mut waits = Vec::new();
        for k in 0..ROWS {
            let writer = writer.clone();
            waits.push(tokio::spawn(async move {
                let entry = AuditEntry {
                    wall_ns: k,
                    actor: "anna".into(),
                    role: "engineer".into(),
                    action: "set_mode".into(),
                    detail: format!("mode act {k}"),
                };
                writer.audit(entry).await.unwrap()
            }));
        }
        for wait in waits {
            wait.await.unwrap();
        }
        reader.close().await;
        match verify_audit_file(&path, None).await.unwrap() {
            AuditVerdict::Intact { rows, head } => {
                assert_eq!(rows, ROWS);
                head
            }
            other => panic!("{other:?}"),
        }
    });
    let tampered: [(&str, i64); 6] = [
        ("UPDATE audit SET detail = 'mode observe' WHERE sequence = 100", 100),
        ("UPDATE audit SET actor = 'bert' WHERE sequence = 1", 1),
        ("UPDATE audit SET wall_ns = 0 WHERE sequence = 299", 299),
        ("DELETE FROM audit WHERE sequence = 150", 151),
        (
            "UPDATE audit SET sequence = CASE sequence WHEN 7 THEN -8 WHEN 8 THEN -7 END WHERE sequence IN (7, 8); \
          UPDATE audit SET sequence = -sequence WHERE sequence < 0",
            7,
        ),
        ("DELETE FROM audit WHERE sequence > 290", -1),
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
            assert!(count >= 290);
            c.close().await.unwrap();
            let verdict = verify_audit_file(&copy, Some(&head)).await.unwrap();
            match verdict {
                AuditVerdict::Broken { sequence } => assert_eq!(sequence, expected, "{statement}"),
                AuditVerdict::HeadMissing { rows } => assert_eq!((rows, expected), (290, -1), "{statement}"),
                AuditVerdict::Intact { .. } => panic!("not found: {statement}"),
            }
        });
    }
}
