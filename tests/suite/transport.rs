//! Shared memory between real participants: delivery, loss, restart, and the janitor.

use crate::folders::not_run;
use std::path::{Path, PathBuf};
use stillcut::transport::wire::{COMMAND_OFFSET, ServoBatch, ServoPoint, TurretCommand, TurretStatus};
use stillcut::transport::{
    CommandPublisher, CommandSubscriber, Domain, ServoPublisher, ServoSubscriber, StatusPublisher,
    StatusSubscriber,
};

/// A domain of its own for one test, removed at the end.
struct TestDomain {
    domain: Domain,
}

impl TestDomain {
    fn new(word: &str) -> Self {
        let prefix = format!("t{}{word}", std::process::id());
        let root: PathBuf = std::env::temp_dir().join(format!("stillcut-{prefix}"));
        Self { domain: Domain::new(&prefix, &root).unwrap() }
    }
}

impl Drop for TestDomain {
    fn drop(&mut self) {
        self.domain.remove();
    }
}

fn batch(first: u64, count: u32) -> ServoBatch {
    let mut batch = ServoBatch {
        stream: 7,
        sample_rate_hz: 9000.0,
        sample_count: count,
        axis_count: 2,
        ..ServoBatch::default()
    };
    for (i, point) in batch.points.iter_mut().take(count as usize).enumerate() {
        *point = ServoPoint {
            sequence: first + i as u64,
            valid: ServoPoint::all_valid(2),
            ..ServoPoint::default()
        };
        point.axes[1].stage_position_m = (first + i as u64) as f64 * 1e-6;
    }
    batch
}

#[test]
fn samples_arrive_in_order_and_unchanged() {
    let test = TestDomain::new("order");
    let (service, machine) = (test.domain.join("service").unwrap(), test.domain.join("machine").unwrap());
    let reader = ServoSubscriber::open(&service).unwrap();
    let writer = ServoPublisher::open(&machine).unwrap();
    for k in 0..100 {
        assert_eq!(writer.send(&batch(9 * k, 9)).unwrap(), 1);
    }
    let mut seen = Vec::new();
    let drained = reader
        .drain(|b| seen.extend(b.used_points().iter().map(|p| (p.sequence, p.axes[1].stage_position_m))));
    assert_eq!(drained.unwrap(), 100);
    assert_eq!(seen.len(), 900);
    assert!(
        seen.iter().enumerate().all(|(i, (s, x))| *s == i as u64 && (*x - i as f64 * 1e-6).abs() < 1e-15)
    );
}

#[test]
fn a_stalled_reader_loses_the_oldest_and_never_blocks_the_machine() {
    let test = TestDomain::new("stall");
    let (service, machine) = (test.domain.join("service").unwrap(), test.domain.join("machine").unwrap());
    let reader = ServoSubscriber::open(&service).unwrap();
    let writer = ServoPublisher::open(&machine).unwrap();
    for k in 0..1500 {
        writer.send(&batch(k, 1)).unwrap();
    }
    let mut sequences = Vec::new();
    reader.drain(|b| sequences.push(b.points[0].sequence)).unwrap();
    assert_eq!(sequences.last(), Some(&1499), "the newest is kept");
    assert!(sequences.windows(2).all(|w| w[1] == w[0] + 1), "one gap, at the old end");
    assert_eq!(sequences.len(), 1024, "the buffer's worth is kept");
}

#[test]
fn commands_and_reports_cross_and_a_restarted_machine_is_heard_again() {
    let test = TestDomain::new("restart");
    let service = test.domain.join("service").unwrap();
    let commands = CommandPublisher::open(&service).unwrap();
    let reports = StatusSubscriber::open(&service).unwrap();
    for life in 1..=3_u64 {
        let machine = test.domain.join("machine").unwrap();
        let orders = CommandSubscriber::open(&machine).unwrap();
        let status = StatusPublisher::open(&machine).unwrap();
        let command =
            TurretCommand { epoch: 1, sequence: life, kind: COMMAND_OFFSET, ..TurretCommand::default() };
        assert_eq!(commands.send(&command).unwrap(), 1);
        let mut got = Vec::new();
        orders.drain(|c| got.push(c.sequence)).unwrap();
        assert_eq!(got, [life]);
        status.send(&TurretStatus { acknowledged_sequence: life, ..TurretStatus::default() }).unwrap();
        let mut heard = Vec::new();
        reports.drain(|s| heard.push(s.acknowledged_sequence)).unwrap();
        assert_eq!(heard, [life]);
    }
}

/// The return to equal pitch is the last thing that a service says: it must not vanish with the port.
#[test]
fn the_last_word_outlives_its_sender() {
    let test = TestDomain::new("last");
    let machine = test.domain.join("machine").unwrap();
    let orders = CommandSubscriber::open(&machine).unwrap();
    let mut got = Vec::new();
    for sequence in 1..=3 {
        let service = test.domain.join("service").unwrap();
        let commands = CommandPublisher::open(&service).unwrap();
        orders.drain(|_| {}).unwrap(); // a controller looks every millisecond, so it knows the port
        commands.send(&TurretCommand { sequence, ..TurretCommand::default() }).unwrap();
        drop(commands);
        drop(service);
        orders.drain(|c| got.push(c.sequence)).unwrap();
    }
    assert_eq!(got, [1, 2, 3]);
}

#[test]
fn a_second_producer_is_refused() {
    let test = TestDomain::new("second");
    let (one, two) = (test.domain.join("one").unwrap(), test.domain.join("two").unwrap());
    let _first = ServoPublisher::open(&one).unwrap();
    let error = ServoPublisher::open(&two).unwrap_err().to_string();
    assert!(error.contains("another producer runs in this domain; stop it first"), "{error}");
    assert_eq!(error.lines().count(), 1);
}

/// What a kill in the first milliseconds leaves: an empty, write-only management file, and a service
/// without its dynamic part. Without the janitor the first makes every later start hang for ever.
#[test]
fn the_janitor_cures_a_wedged_domain() {
    let test = TestDomain::new("wedged");
    let (management, services) = {
        let machine = test.domain.join("machine").unwrap();
        let _writer = ServoPublisher::open(&machine).unwrap();
        let folder = test.domain.root().join("services");
        let services: Vec<_> = std::fs::read_dir(folder).unwrap().flatten().map(|e| e.path()).collect();
        let kept: Vec<_> = services.iter().map(|p| (p.clone(), std::fs::read(p).unwrap())).collect();
        (files_in_shared_memory(&test.domain, ".global_mgmt"), kept)
    };
    assert!(!management.is_empty() && !services.is_empty(), "a live domain has both");
    for file in &management {
        std::fs::write(file, b"").unwrap();
        use std::os::unix::fs::PermissionsExt as _;
        std::fs::set_permissions(file, std::fs::Permissions::from_mode(0o200)).unwrap();
    }
    for (file, content) in &services {
        std::fs::write(file, content).unwrap();
    }
    let machine = test.domain.join("machine").unwrap();
    let service = test.domain.join("service").unwrap();
    let reader = ServoSubscriber::open(&service).unwrap();
    let writer = ServoPublisher::open(&machine).unwrap();
    writer.send(&batch(0, 3)).unwrap();
    assert_eq!(reader.drain(|_| {}).unwrap(), 1);
}

#[test]
fn the_janitor_leaves_a_domain_alone_while_somebody_is_in_it() {
    let test = TestDomain::new("alive");
    let first = test.domain.join("machine").unwrap();
    let writer = ServoPublisher::open(&first).unwrap();
    for _ in 0..3 {
        let other = test.domain.join("service").unwrap();
        let reader = ServoSubscriber::open(&other).unwrap();
        writer.send(&batch(0, 1)).unwrap();
        assert_eq!(reader.drain(|_| {}).unwrap(), 1);
    }
}

fn files_in_shared_memory(domain: &Domain, ending: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(Path::new("/dev/shm")).unwrap().flatten().map(|e| e.path());
    let ours = |p: &PathBuf| {
        let name = p.file_name().unwrap_or_default().to_string_lossy().into_owned();
        name.starts_with(domain.prefix()) && name.ends_with(ending)
    };
    entries.filter(ours).collect()
}

/// The domain is one user's: nobody else may write to its segments, whatever the library's own modes.
#[test]
fn nobody_else_may_write_to_the_domain() {
    use std::os::unix::fs::PermissionsExt as _;
    let test = TestDomain::new("own");
    let _service = test.domain.join("service").unwrap();
    let mode = |path: &std::path::Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
    let found = files_in_shared_memory(&test.domain, "");
    assert!(!found.is_empty());
    for path in found {
        assert_eq!(mode(&path) & 0o077, 0, "{}: {:o}", path.display(), mode(&path));
    }
    assert_eq!(mode(test.domain.root()) & 0o077, 0);
}

/// A file that another user made under a name of the domain is named, instead of an endless wait for it.
#[test]
fn a_foreign_file_in_shared_memory_is_named() {
    let test = TestDomain::new("foreign");
    let path = PathBuf::from(format!("/dev/shm/{}squatted", test.domain.prefix()));
    std::fs::write(&path, "").unwrap();
    if std::os::unix::fs::chown(&path, Some(12_345), None).is_err() {
        not_run("only an administrator can make another user's file");
        std::fs::remove_file(path).unwrap();
        return;
    }
    let refused = test.domain.join("service").unwrap_err().to_string();
    std::fs::remove_file(&path).unwrap();
    assert!(refused.contains("squatted") && refused.contains("12345"), "{refused}");
}
