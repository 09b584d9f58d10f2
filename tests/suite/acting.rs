//! Who may let the service act and take the turret back, asked of the running service while colleagues, disks
//! and keys are in the way.

use crate::faults::{SmallDisk, exhaust};
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

/// Under whatever name the service was reached: a token that may take the turret back does. Nothing else is
/// served there, and nothing without a token.
#[test]
fn the_way_back_does_not_ask_for_the_hosts_name() {
    let place = Place::new("hostname");
    let bench = Bench::start(&place);
    let lathe = LatheThread::start(&place.domain);
    let host = [("Host", "lathe-7.plant.example")];
    until("acting is possible", 20, || bench.raise_to_act().status == 200);
    let refused = bench.ask("guessed", ("POST", "/api/v1/override"), &host, "{}");
    assert_eq!((refused.code().as_str(), &bench.mode()["mode"]), ("unknown_host", &"act".into()));
    let read = bench.ask(&bench.operator, ("GET", "/api/v1/state"), &host, "");
    assert_eq!(read.code(), "unknown_host");
    let taken = bench.ask(&bench.operator, ("POST", "/api/v1/override"), &host, "{\"reason\":\"mine\"}");
    assert_eq!((taken.status, &bench.mode()["mode"]), (200, &"observe".into()), "{taken:?}");
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
    exhaust(&bench.address, &[("Authorization", &format!("Bearer {}", bench.operator))]);
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

/// The way back is open whatever is wrong with the words: done first, told afterwards.
#[test]
fn an_override_is_done_whatever_its_body() {
    let place = Place::new("anybody");
    let bench = Bench::start(&place);
    let lathe = LatheThread::start(&place.domain);
    until("acting is possible", 20, || bench.raise_to_act().status == 200);
    let bearer = format!("Bearer {}", bench.operator);
    let headers = [("Authorization", bearer.as_str())];
    let long = format!("{{\"reason\":\"{}\"}}", "x".repeat(501));
    let large = format!("{{\"reason\":\"{}\"}}", "x".repeat(70_000));
    let secret = format!("{{\"reason\":\"pasted {}\"}}", bench.operator);
    let bodies: [(Option<&str>, &str); 9] = [
        (None, "none was given"),
        (Some(""), "not JSON"),
        (Some("{\"reason\":\"\"}"), "1 to 500"),
        (Some("{\"reason\":\"two\\nlines\"}"), "1 to 500"),
        (Some(&long), "1 to 500"),
        (Some("{\"reason\":\"x\",\"more\":1}"), "more"),
        (Some("[\"x\"]"), "object"),
        (Some(&large), "64 KiB"),
        (Some(&secret), "token"),
    ];
    // A body of unknown length without a type is one that cannot be read; of length 0 it is none.
    let none = [headers[0], ("Content-Length", "0")];
    for (body, told) in bodies {
        let headers: &[_] = if body.is_none() { &none } else { &headers };
        until("act again", 20, || bench.raise_to_act().status == 200);
        let taken = ask(&bench.address, "POST", "/api/v1/override", headers, body);
        assert_eq!((taken.status, &taken.json()["mode"]), (200, &"observe".into()), "{told}: {taken:?}");
        let said = taken.json()["reason_refused"].as_str().unwrap_or_default().to_owned();
        assert!(said.contains(told), "{told}: {said}");
    }
    let good = bench.take_back();
    assert!(good.json()["reason_refused"].is_null(), "{good:?}");
    let rows = bench.audit("override");
    assert_eq!(rows.iter().filter(|r| r.ends_with("reason: no reason given")).count(), bodies.len());
    drop(lathe);
    bench.running.stop();
}

/// Nobody could take the turret back any more: acting ends by itself, visibly.
#[test]
fn acting_ends_where_no_token_is_in_force_that_could_end_it() {
    use std::os::unix::fs::PermissionsExt as _;
    let place = Place::new("noway");
    let bench = Bench::start(&place);
    let lathe = LatheThread::start(&place.domain);
    let file = place.folder.path().join("tokens.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    let mode = |bits| std::fs::set_permissions(&file, std::fs::Permissions::from_mode(bits)).unwrap();
    let spoil: [(&str, &dyn Fn()); 3] = [
        ("readable by others", &|| mode(0o644)),
        ("empty", &|| std::fs::write(&file, "").unwrap()),
        ("gone", &|| std::fs::remove_file(&file).unwrap()),
    ];
    for (what, spoil) in spoil {
        until("acting is possible", 20, || bench.raise_to_act().status == 200);
        spoil();
        until(what, 4, || bench.mode()["mode"] == "observe");
        let state = get(&bench.running, "/api/v1/state").json();
        assert!(state["fault"].as_str().is_some_and(|f| f.contains("token")), "{what}: {state}");
        until("it is told", 5, || {
            let ready = get(&bench.running, "/readyz");
            let warned = get(&bench.running, "/api/v1/events?kind=access_lost").json();
            let alarmed = get(&bench.running, "/api/v1/events?kind=fault&open_alarms=true").json();
            ready.status == 503
                && ready.body.contains("access")
                && !warned["events"].as_array().unwrap().is_empty()
                && !alarmed["events"].as_array().unwrap().is_empty()
        });
        std::fs::write(&file, &text).unwrap();
        mode(0o600);
        let clear = ("POST", "/api/v1/fault/clear");
        until("it is mended", 5, || {
            bench.ask(&bench.engineer, clear, &[], "{\"reason\":\"mended\"}").status == 200
        });
        assert_eq!(bench.mode()["mode"], "observe", "it does not resume by itself");
    }
    drop(lathe);
    bench.running.stop();
}

/// A token in a reason is refused and kept nowhere; one that was made a moment ago is good at once.
#[test]
fn tokens_reach_no_record_and_a_fresh_one_is_good_at_once() {
    let place = Place::new("secret");
    let bench = Bench::start(&place);
    let file = place.folder.path().join("tokens.toml");
    for k in 20..26 {
        let (fresh, digest) = stillcut::http::new_token([k; 32]);
        let entry = format!("[[token]]\nname = \"n{k}\"\nrole = \"operator\"\nsha256 = \"{digest}\"\n");
        std::fs::write(&file, std::fs::read_to_string(&file).unwrap() + &entry).unwrap();
        let answer = bench.ask(&fresh, ("POST", "/api/v1/events/1/acknowledge"), &[], "{\"reason\":\"x\"}");
        assert_eq!(answer.status, 200, "{answer:?}");
        std::thread::sleep(Duration::from_millis(150));
    }
    for token in [bench.operator.as_str(), bench.engineer.as_str(), &stillcut::http::new_token([99; 32]).0] {
        for (method, path, body) in [
            ("POST", "/api/v1/events/1/acknowledge", format!("{{\"reason\":\"{token}\"}}")),
            ("POST", "/api/v1/events/1/silence", format!("{{\"reason\":\"a {token}.\",\"minutes\":1}}")),
            ("PUT", "/api/v1/mode", format!("{{\"reason\":\"({token})\",\"mode\":\"observe\"}}")),
            ("POST", "/api/v1/recordings", format!("{{\"reason\":\"{token}\"}}")),
        ] {
            let refused = bench.ask(&bench.engineer, (method, path), &[], &body);
            assert_eq!(refused.code(), "secret_in_text", "{path}: {refused:?}");
        }
        let body = format!("{{\"reason\":\"{token}\"}}");
        assert_eq!(bench.ask(&bench.operator, ("POST", "/api/v1/override"), &[], &body).status, 200);
    }
    for page in ["/api/v1/audit", "/api/v1/events", "/api/v1/state", "/metrics"] {
        let told = get(&bench.running, page).body;
        assert!(!told.contains(&bench.operator) && !told.contains(&bench.engineer), "{page}");
    }
    bench.running.stop();
}
