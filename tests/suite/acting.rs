//! Who may let the service act and take the turret back, asked of the running service while colleagues, disks
//! and keys are in the way.

use crate::faults::SmallDisk;
use crate::folders::not_run;
use crate::running::{Answer, LatheThread, Place, ask, get, tokens, until};
use std::time::{Duration, Instant};
use stillcut::service::{Running, start};

struct Bench {
    running: Running,
    address: String,
    operator: String,
    engineer: String,
}

impl Bench {
    fn start(place: &Place) -> Self {
        let [_, operator, engineer] = tokens(place);
        let running = start(place.config("tokens = \"tokens.toml\"")).unwrap();
        let address = running.handle().address().to_string();
        Self { running, address, operator, engineer }
    }

    fn ask(&self, token: &str, (method, path): (&str, &str), more: &[(&str, &str)], body: &str) -> Answer {
        let bearer = format!("Bearer {token}");
        let mut headers = vec![("Authorization", bearer.as_str())];
        headers.extend_from_slice(more);
        ask(&self.address, method, path, &headers, Some(body))
    }

    fn take_back(&self) -> Answer {
        self.ask(&self.operator, ("POST", "/api/v1/override"), &[], "{\"reason\":\"mine now\"}")
    }

    fn raise_to_act(&self) -> Answer {
        let etag = get(&self.running, "/api/v1/mode").etag;
        let body = "{\"mode\":\"act\",\"reason\":\"commissioned\"}";
        self.ask(&self.engineer, ("PUT", "/api/v1/mode"), &[("If-Match", &etag)], body)
    }

    fn mode(&self) -> serde_json::Value {
        get(&self.running, "/api/v1/mode").json()
    }

    fn audit(&self, action: &str) -> Vec<String> {
        let path = ("GET", "/api/v1/audit?after=0");
        let headers = [("Authorization", format!("Bearer {}", self.engineer))];
        let rows = ask(&self.address, path.0, path.1, &[(headers[0].0, &headers[0].1)], None).json();
        let rows = rows.as_array().unwrap().iter();
        let of_action = rows.filter(|r| r["action"] == action);
        of_action.map(|r| r["detail"].as_str().unwrap().to_owned()).collect()
    }
}

/// A colleague takes the turret back; the picture still says `act` for a moment. In that moment an operator
/// who asks for `act` asks for the way up.
#[test]
fn nobody_slips_into_act_behind_an_override() {
    let place = Place::new("race");
    let bench = Bench::start(&place);
    let lathe = LatheThread::start(&place.domain);
    until("acting is possible", 20, || bench.raise_to_act().status == 200);
    let mut refused = 0;
    for _ in 0..10 {
        assert_eq!(bench.raise_to_act().status, 200);
        std::thread::scope(|scope| {
            let taken = scope.spawn(|| bench.take_back());
            std::thread::sleep(Duration::from_millis(12));
            let body = "{\"mode\":\"act\",\"reason\":\"no If-Match\"}";
            let slipped = bench.ask(&bench.operator, ("PUT", "/api/v1/mode"), &[], body);
            refused += u32::from(slipped.status >= 400);
            assert_eq!(taken.join().unwrap().status, 200);
        });
        assert_eq!(bench.mode()["mode"], "observe", "the turret stays taken back");
    }
    assert!(refused > 0);
    drop(lathe);
    bench.running.stop();
}

/// What was done and what was refused is on record as such.
#[test]
fn the_record_tells_refusals_from_deeds() {
    let place = Place::new("record");
    let bench = Bench::start(&place);
    let etag = get(&bench.running, "/api/v1/mode").etag;
    let put = |tag: &str, mode: &str| {
        let body = format!("{{\"mode\":\"{mode}\",\"reason\":\"test\"}}");
        bench.ask(&bench.engineer, ("PUT", "/api/v1/mode"), &[("If-Match", tag)], &body)
    };
    assert_eq!(put("\"77\"", "advise").code(), "stale_revision");
    assert_eq!(put(&etag, "act").code(), "not_ready");
    assert_eq!(put(&etag, "advise").status, 200);
    assert_eq!(bench.take_back().status, 200);
    let rows = bench.audit("set_mode");
    let words = ["refused, the mode changed", "refused, acting is not possible", "done"];
    assert_eq!(rows.len(), 3, "{rows:?}");
    for (row, word) in rows.iter().zip(words) {
        assert!(row.contains(word), "{row}");
    }
    assert_eq!(bench.audit("set_mode_asked").len(), 3);
    assert!(bench.audit("override")[0].contains("done"));
    bench.running.stop();
}

/// A full disk does not stand between a person and the turret.
#[test]
fn an_override_is_done_and_answered_while_the_disk_is_full() {
    let place = Place::new("fulltake");
    let Some(disk) = SmallDisk::mount(&place.state(), "size=4m") else {
        not_run("mounting a small file system is not allowed here");
        return;
    };
    let bench = Bench::start(&place);
    let lathe = LatheThread::start(&place.domain);
    until("acting is possible", 20, || bench.raise_to_act().status == 200);
    let ballast = disk.fill();
    let began = Instant::now();
    let taken = bench.take_back();
    assert!(began.elapsed() < Duration::from_secs(2), "{:?}", began.elapsed());
    assert_eq!((taken.status, &taken.json()["mode"]), (200, &"observe".into()), "{taken:?}");
    assert_eq!(taken.json()["recorded"], false, "and it says that its record waits");
    assert_eq!(bench.mode()["mode"], "observe");
    let up = bench.raise_to_act();
    assert_eq!(up.code(), "store_unavailable", "without a record there is no way up: {up:?}");
    std::fs::remove_file(ballast).unwrap();
    until("the record is there", 15, || bench.audit("override").iter().any(|r| r.contains("done")));
    drop(lathe);
    bench.running.stop();
}

/// Four callers with one key at once: one deed, the others are told so or get its answer.
#[test]
fn one_key_is_one_deed_also_at_once() {
    let place = Place::new("once");
    let bench = Bench::start(&place);
    let lathe = LatheThread::start(&place.domain);
    until("samples come", 20, || get(&bench.running, "/readyz").status == 200);
    let post = || {
        let path = ("POST", "/api/v1/recordings");
        bench.ask(&bench.operator, path, &[("Idempotency-Key", "k")], "{\"reason\":\"x\"}")
    };
    let answers: Vec<Answer> = std::thread::scope(|scope| {
        let asked: Vec<_> = (0..4).map(|_| scope.spawn(post)).collect();
        asked.into_iter().map(|a| a.join().unwrap()).collect()
    });
    for answer in &answers {
        let told = answer.status == 409 && answer.code() == "request_under_way";
        assert!(answer.status == 202 || told, "{answer:?}");
    }
    assert_eq!(bench.audit("save_recording").len(), 1);
    assert_eq!(post().status, 202, "afterwards the answer is kept");
    assert_eq!(bench.audit("save_recording").len(), 1);
    drop(lathe);
    bench.running.stop();
}
