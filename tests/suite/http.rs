//! The API over real HTTP: access, problems, paging, limits, browsers that are led astray.

use crate::running::{LatheThread, Place, ask, get, service, tokens, until};
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};
use stillcut::service::start;

/// (method, path, body, least role: 0 nobody's token needed on loopback, 2 operator, 3 engineer)
const ROUTES: &[(&str, &str, Option<&str>, usize)] = &[
    ("GET", "/api/v1/state", None, 0),
    ("GET", "/api/v1/axes", None, 0),
    ("GET", "/api/v1/spectrum", None, 0),
    ("GET", "/api/v1/stability", None, 0),
    ("GET", "/api/v1/config", None, 0),
    ("GET", "/api/v1/commissioning", None, 0),
    ("GET", "/api/v1/past", None, 0),
    ("GET", "/api/v1/events", None, 0),
    ("GET", "/api/v1/events/1", None, 0),
    ("GET", "/api/v1/mode", None, 0),
    ("GET", "/api/v1/recordings", None, 0),
    ("GET", "/api/v1/recordings/none/file.parquet", None, 0),
    ("GET", "/api/v1/recordings/none/file.csv", None, 0),
    ("GET", "/api/v1/recordings/none/file.json", None, 0),
    ("GET", "/api/v1/recordings/none/replay", None, 0),
    ("GET", "/api/v1/diagnoses", None, 0),
    ("GET", "/api/v1/diagnoses/none", None, 0),
    ("GET", "/api/v1/diagnoses/none/report.html", None, 0),
    ("GET", "/api/v1/diagnoses/none/scenario.toml", None, 0),
    ("GET", "/api/v1/cuts", None, 0),
    ("GET", "/api/v1/cuts/file.csv", None, 0),
    ("GET", "/api/v1/audit", None, 0),
    ("GET", "/healthz", None, 0),
    ("GET", "/readyz", None, 0),
    ("GET", "/metrics", None, 0),
    ("POST", "/api/v1/events/1/acknowledge", Some(r#"{"reason":"test"}"#), 2),
    ("POST", "/api/v1/events/1/silence", Some(r#"{"reason":"test","minutes":1}"#), 2),
    ("PUT", "/api/v1/mode", Some(r#"{"mode":"observe","reason":"test"}"#), 2),
    ("POST", "/api/v1/override", Some(r#"{"reason":"test"}"#), 2),
    ("PUT", "/api/v1/hold", Some(r#"{"hold":true,"reason":"test"}"#), 2),
    ("POST", "/api/v1/fault/clear", Some(r#"{"reason":"test"}"#), 3),
    ("POST", "/api/v1/recordings", Some(r#"{"reason":"test"}"#), 2),
    ("POST", "/api/v1/diagnoses", Some(r#"{"reason":"test","recordings":["none"]}"#), 3),
    ("POST", "/api/v1/cuts/diagnose", Some(r#"{"reason":"test"}"#), 3),
    ("POST", "/api/v1/diagnoses/none/cancel", Some(r#"{"reason":"test"}"#), 2),
    ("POST", "/api/v1/diagnoses/none/accept", Some(r#"{"reason":"test"}"#), 3),
];

/// Reads what is there; a signal to another test of this process is no end.
fn read_some(stream: &mut TcpStream, buffer: &mut [u8]) -> usize {
    loop {
        match stream.read(buffer) {
            Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
            result => return result.unwrap(),
        }
    }
}

#[test]
fn every_route_asks_for_its_role_and_no_other() {
    let place = Place::new("roles");
    let tokens = tokens(&place);
    let running = start(place.config("tokens = \"tokens.toml\"")).unwrap();
    let address = running.handle().address().to_string();
    let described = serde_json::to_value(stillcut::http::description()).unwrap();
    for (method, path, body, least) in ROUTES {
        let template = path.replace("/1/", "/{sequence}/").replace("/none", "/{id}");
        let template =
            if template.ends_with("/events/1") { "/api/v1/events/{sequence}".to_owned() } else { template };
        assert!(!described["paths"][&template][method.to_lowercase()].is_null(), "{template} is described");
        let no_token = ask(&address, method, path, &[], *body);
        let refused = |a: &crate::running::Answer| [401, 403].contains(&a.status);
        assert_eq!(refused(&no_token), *least > 0, "{method} {path} without a token: {no_token:?}");
        for (rank, token) in tokens.iter().enumerate() {
            let answer = ask(&address, method, path, &[("Authorization", &format!("Bearer {token}"))], *body);
            let expected = rank + 1 < *least;
            assert_eq!(answer.status == 403, expected, "{method} {path} as rank {}: {answer:?}", rank + 1);
            assert!(!expected || answer.json()["instance"] == *path, "{answer:?}");
            assert!(answer.status != 401 && answer.status < 500 || answer.status == 503, "{answer:?}");
        }
    }
    let scrape = get(&running, "/metrics").body;
    let series = scrape.lines().filter(|l| !l.starts_with('#')).count();
    assert!(series < 300, "{series} series after every route was asked");
    // A token that nobody knows or that has expired is refused everywhere, at first by name, then by its number.
    let (old, digest) = stillcut::http::new_token([9; 32]);
    let file = place.folder.path().join("tokens.toml");
    let expired = format!(
        "[[token]]\nname = \"old\"\nrole = \"engineer\"\nsha256 = \"{digest}\"\nexpires = \"2026-01-01T00:00:00Z\"\n"
    );
    std::fs::write(&file, std::fs::read_to_string(&file).unwrap() + &expired).unwrap();
    until("the changed file is in force", 5, || {
        let answer =
            ask(&address, "GET", "/api/v1/state", &[("Authorization", &format!("Bearer {old}"))], None);
        [401, 429].contains(&answer.status)
    });
    for token in ["garbage", old.as_str()] {
        for (method, path, body, _) in ROUTES {
            let answer = ask(&address, method, path, &[("Authorization", &format!("Bearer {token}"))], *body);
            assert!([401, 429].contains(&answer.status), "{method} {path}: {answer:?}");
        }
    }
    // Every described route stands in the table (the stream has its own test).
    let count: usize =
        described["paths"].as_object().unwrap().values().map(|p| p.as_object().unwrap().len()).sum();
    assert_eq!(count, ROUTES.len() + 1, "a new route needs a line in the table");
    running.stop();
}

#[test]
fn wrong_tokens_are_counted_and_braked_but_never_a_right_one() {
    let place = Place::new("guess");
    let [_, operator, _] = tokens(&place);
    let running = start(place.config("tokens = \"tokens.toml\"")).unwrap();
    let address = running.handle().address().to_string();
    let with = |token: &str| {
        ask(&address, "GET", "/api/v1/state", &[("Authorization", &format!("Bearer {token}"))], None)
    };
    for _ in 0..5 {
        assert_eq!(with("guess").code(), "bad_token");
    }
    assert_eq!(with("guess").status, 429);
    assert_eq!(with(&operator).status, 200);
    let metrics = get(&running, "/metrics").body;
    assert!(metrics.contains("stillcut_security_events_total{kind=\"bad_token\"} 5"), "{metrics}");
    assert!(metrics.contains("stillcut_security_events_total{kind=\"rate_limited\"} 1"));
    for page in ["/metrics", "/api/v1/config", "/api/v1/audit", "/api/v1/events"] {
        assert!(!get(&running, page).body.contains(&operator), "{page} tells no token");
    }
    running.stop();
}

#[test]
fn every_refusal_is_a_problem_with_a_code() {
    let place = Place::new("problem");
    let mut config = place.config("");
    config.http.trust_loopback = true;
    let running = start(config).unwrap();
    let address = running.handle().address().to_string();
    let big = format!("{{\"reason\":\"{}\"}}", "x".repeat(70_000));
    let deep = "[".repeat(60);
    let twice = "{\"reason\":\"x\",\"recordings\":[\"a\",\"b\",\"a\"]}";
    let cases: &[(&str, &str, Option<&str>, u16, &str)] = &[
        ("GET", "/nothing/here", None, 404, "not_found"),
        ("GET", "/api/v1/events/abc", None, 404, "not_found"),
        ("GET", "/api/v1/events/999999", None, 404, "not_found"),
        ("DELETE", "/api/v1/state", None, 405, "method_not_allowed"),
        ("GET", "/api/v1/events?limit=0", None, 400, "invalid_query"),
        ("GET", "/api/v1/events?limit=x", None, 400, "invalid_query"),
        ("GET", "/api/v1/events?kind=nonsense", None, 400, "invalid_query"),
        ("GET", "/api/v1/events?since=yesterday", None, 400, "invalid_query"),
        ("GET", "/api/v1/events?color=red", None, 400, "invalid_query"),
        ("POST", "/api/v1/fault/clear", Some("{"), 400, "malformed_json"),
        ("POST", "/api/v1/fault/clear", Some(&deep), 400, "json_too_deep"),
        ("POST", "/api/v1/fault/clear", Some("{\"reason\":7}"), 422, "invalid_body"),
        ("POST", "/api/v1/fault/clear", Some("{\"reason\":\"x\",\"more\":1}"), 422, "invalid_body"),
        ("POST", "/api/v1/fault/clear", Some("{\"reason\":\"  \"}"), 422, "reason_required"),
        ("POST", "/api/v1/fault/clear", Some(&big), 413, "body_too_large"),
        ("POST", "/api/v1/fault/clear", None, 415, "unsupported_media_type"),
        ("POST", "/api/v1/diagnoses", Some(twice), 422, "invalid_body"),
        ("PUT", "/api/v1/mode", Some("{\"mode\":\"act\",\"reason\":\"x\"}"), 428, "if_match_required"),
        ("PUT", "/api/v1/hold", Some("{\"hold\":true,\"reason\":\"x\"}"), 409, "not_acting"),
        ("POST", "/api/v1/fault/clear", Some("{\"reason\":\"x\"}"), 409, "no_fault"),
        ("PUT", "/api/v1/mode", Some("{\"mode\":\"fly\",\"reason\":\"x\"}"), 422, "invalid_body"),
        ("GET", "/api/v1/recordings/..%2f..%2fhistory/file.parquet", None, 404, "not_found"),
    ];
    for (method, path, body, status, code) in cases {
        let answer = ask(&address, method, path, &[], *body);
        assert_eq!((answer.status, answer.code().as_str()), (*status, *code), "{method} {path}: {answer:?}");
        assert_eq!(answer.kind, "application/problem+json", "{method} {path}");
        assert!(answer.json()["detail"].as_str().is_some_and(|d| !d.is_empty()));
        assert_eq!(answer.json()["instance"], path.split('?').next().unwrap(), "{method} {path}");
    }
    for (query, name) in [("cursor=x", "cursor"), ("color=red", "color"), ("limit=0", "limit")] {
        let errors = get(&running, &format!("/api/v1/events?{query}")).json()["errors"].clone();
        assert_eq!(errors[0]["pointer"], format!("query/{name}"), "{query}: {errors}");
        assert!(!errors.to_string().contains("deserialize"), "{errors}");
    }
    let stale = [("If-Match", "\"99\"")];
    let answer = ask(&address, "PUT", "/api/v1/mode", &stale, Some("{\"mode\":\"advise\",\"reason\":\"x\"}"));
    assert_eq!((answer.status, answer.code().as_str()), (412, "stale_revision"));
    running.stop();
}

#[test]
fn a_browser_that_was_led_here_under_another_name_gets_nothing() {
    let place = Place::new("rebind");
    let mut config = place.config("");
    config.http.trust_loopback = true;
    let running = start(config).unwrap();
    let address = running.handle().address().to_string();
    for host in ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example:80"] {
        let answer = ask(&address, "POST", "/api/v1/override", &[("Host", host)], Some("{\"reason\":\"x\"}"));
        assert_eq!(answer.code(), "unknown_host", "{host}");
    }
    let answer = get(&running, "/");
    assert!(answer.body.contains("<title>Stillcut</title>"));
    let mut stream = TcpStream::connect(&address).unwrap();
    stream.write_all(b"GET /api/v1/state HTTP/1.1\r\nHost: localhost\r\nOrigin: http://evil.example\r\nConnection: close\r\n\r\n").unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).unwrap();
    let head = text.split("\r\n\r\n").next().unwrap().to_lowercase();
    assert!(!head.contains("access-control-allow-origin"), "{head}");
    for header in [
        "content-security-policy: default-src 'none'",
        "x-content-type-options: nosniff",
        "x-frame-options: deny",
    ] {
        assert!(head.contains(header), "{header} in {head}");
    }
    running.stop();
}

/// Two names for one host, two lengths for one body: what a proxy in front might read in another way.
#[test]
fn requests_that_can_be_read_in_two_ways_are_not_obeyed() {
    let place = Place::new("ways");
    let mut config = place.config("");
    config.http.trust_loopback = true;
    let running = start(config).unwrap();
    let address = running.handle().address().to_string();
    let say = |request: String| {
        let mut stream = TcpStream::connect(&address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let (mut said, mut piece) = (String::new(), [0; 4096]);
        while let Ok(count @ 1..) = stream.read(&mut piece) {
            said += &String::from_utf8_lossy(&piece[..count]);
        }
        said
    };
    let post = "POST /api/v1/override HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n";
    let (good, evil) = ("Host: localhost\r\n", "Host: evil.example\r\n");
    let end = "Connection: close\r\n\r\n";
    for (request, code) in [
        (format!("GET /healthz HTTP/1.1\r\n{good}{evil}{end}"), "ambiguous_host"),
        (format!("GET /healthz HTTP/1.1\r\n{evil}{good}{end}"), "ambiguous_host"),
        (format!("GET http://evil.example/healthz HTTP/1.1\r\n{good}{end}"), "ambiguous_host"),
        (format!("{post}Content-Length: 2\r\nContent-Length: 3\r\n\r\n{{}}x"), "malformed_request"),
        (format!("{post}Content-Length: 2, 3\r\n\r\n{{}}x"), "malformed_request"),
    ] {
        let said = say(request.clone());
        let (head, body) = said.split_once("\r\n\r\n").unwrap_or_else(|| panic!("{request}: {said}"));
        assert!(head.starts_with("HTTP/1.1 400 ") && head.contains("problem+json"), "{request}: {said}");
        assert_eq!(serde_json::from_str::<serde_json::Value>(body).unwrap()["code"], code, "{request}");
    }
    let same = format!("GET http://localhost/healthz HTTP/1.1\r\n{good}{end}");
    assert!(say(same).starts_with("HTTP/1.1 200 "), "one host, named twice");
    // Chunks count, the length does not, and nothing behind them is taken for a request.
    let hidden = format!("GET /healthz HTTP/1.1\r\n{good}\r\n");
    let (length, chunked) = ("Content-Length: 4\r\n", "Transfer-Encoding: chunked\r\n");
    for fields in [format!("{length}{chunked}"), format!("{chunked}{length}")] {
        let said = say(format!("{post}{fields}\r\n2\r\n{{}}\r\n0\r\n\r\n{hidden}"));
        assert_eq!(said.matches("HTTP/1.1 ").count(), 1, "{fields}: {said}");
        assert!(said.starts_with("HTTP/1.1 200 ") && said.contains("connection: close"), "{fields}: {said}");
    }
    // Lengths that only some would understand: whoever reads the body as empty finds a request in it.
    for field in [
        "Transfer-Encoding: xchunked",
        "Transfer-Encoding: identity",
        "Transfer-Encoding : chunked",
        "Transfer-Encoding: chunked, identity",
        "Transfer-Encoding: \x0bchunked",
        "Transfer-Encoding: chunked\r\nTransfer-Encoding: identity",
        "X: y\r\n Transfer-Encoding: chunked",
        "X: y\rTransfer-Encoding: chunked",
        "Transfer-Encoding\0: chunked",
        "Content-Length: +0",
        "Content-Length: -1",
        "Content-Length: 0x0",
        "Content-Length: 0 0",
        "Content-Length : 0",
        "Content-Length: 99999999999999999999",
    ] {
        let said = say(format!("{post}{field}\r\n\r\n{hidden}"));
        assert!(said.matches("HTTP/1.1 ").count() <= 1 && !said.contains("alive"), "{field:?}: {said}");
    }
    for chunk in ["0x2", "2 2", "-2", "fffffffffffffffff", "2;\n", ""] {
        let said = say(format!("{post}{chunked}\r\n{chunk}\r\n{{}}\r\n0\r\n\r\n{hidden}"));
        assert!(!said.contains("alive"), "{chunk:?}: {said}");
    }
    running.stop();
}

#[test]
fn clients_that_send_nothing_are_cut_off() {
    let place = Place::new("slow");
    let running = service(&place);
    let address = running.handle().address();
    let began = Instant::now();
    let mut slow: Vec<TcpStream> = (0..20).map(|_| TcpStream::connect(address).unwrap()).collect();
    for stream in &mut slow {
        stream.write_all(b"GET / HT").unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(12))).unwrap();
    }
    assert_eq!(get(&running, "/healthz").status, 200, "others are served meanwhile");
    for stream in &mut slow {
        let mut rest = Vec::new();
        let _ = stream.read_to_end(&mut rest); // closed, with or without a farewell
    }
    let took = began.elapsed();
    assert!((Duration::from_secs(4)..Duration::from_secs(9)).contains(&took), "cut after {took:?}");
    running.stop();
}

#[test]
fn the_live_stream_resumes_after_the_last_event_seen() {
    let place = Place::new("resume");
    let mut config = place.config("");
    config.http.trust_loopback = true;
    let running = start(config).unwrap();
    let address = running.handle().address().to_string();
    for k in 0..3 {
        let body = format!("{{\"reason\":\"take {k}\"}}");
        assert_eq!(ask(&address, "POST", "/api/v1/override", &[], Some(&body)).status, 200);
    }
    until("four events are stored", 5, || {
        get(&running, "/api/v1/events").json()["events"].as_array().unwrap().len() >= 4
    });
    let mut stream = TcpStream::connect(&address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    stream.write_all(b"GET /api/v1/stream HTTP/1.1\r\nHost: localhost\r\nLast-Event-ID: 2\r\n\r\n").unwrap();
    let mut text = String::new();
    let mut buffer = [0; 4096];
    while !(text.contains("id: 4") && text.contains("event: state")) {
        let count = read_some(&mut stream, &mut buffer);
        assert!(count > 0, "the stream ended early: {text}");
        text += &String::from_utf8_lossy(&buffer[..count]);
    }
    assert!(text.contains("id: 3\n") && !text.contains("id: 2\n"), "{text}");
    // A place beyond the end is of a history that was set aside: what is new comes all the same.
    let mut lost = TcpStream::connect(&address).unwrap();
    lost.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    lost.write_all(b"GET /api/v1/stream HTTP/1.1\r\nHost: localhost\r\nLast-Event-ID: 9000\r\n\r\n").unwrap();
    let mut text = String::new();
    while !text.contains("event: event") {
        if text.contains("event: state") {
            ask(&address, "POST", "/api/v1/override", &[], Some("{\"reason\":\"test\"}"));
        }
        let count = read_some(&mut lost, &mut buffer);
        text += &String::from_utf8_lossy(&buffer[..count]);
        assert!(count > 0 && text.len() < 1_000_000, "no event came");
    }
    // Taking the turret back needs no words.
    let taken = ask(&address, "POST", "/api/v1/override", &[], Some("{}"));
    assert_eq!(taken.status, 200, "{taken:?}");
    let began = Instant::now();
    running.stop();
    assert!(began.elapsed() < Duration::from_secs(5), "an open stream does not hold up the end");
}

#[test]
fn a_stream_ends_with_its_token() {
    let place = Place::new("revoked");
    let [viewer, ..] = tokens(&place);
    let running = start(place.config("tokens = \"tokens.toml\"")).unwrap();
    let mut stream = TcpStream::connect(running.handle().address()).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    let ask =
        format!("GET /api/v1/stream HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {viewer}\r\n\r\n");
    stream.write_all(ask.as_bytes()).unwrap();
    let mut buffer = [0; 65_536];
    let mut listen = |time: Duration| {
        let until = Instant::now() + time;
        while Instant::now() < until {
            let count = read_some(&mut stream, &mut buffer);
            if count == 0 || buffer[..count].ends_with(b"0\r\n\r\n") {
                return false;
            }
        }
        true
    };
    assert!(listen(Duration::from_secs(3)), "a good token is heard all the time");
    std::fs::remove_file(place.folder.path().join("tokens.toml")).unwrap();
    assert!(!listen(Duration::from_secs(5)), "it ends when the token is gone");
    let metrics = get(&running, "/metrics").body;
    assert!(metrics.contains("stillcut_security_events_total{kind=\"bad_token\"} 0"), "no guess");
    running.stop();
}

/// A client that was away for a long time misses nothing.
#[test]
fn a_stream_resumes_over_more_than_one_page() {
    let place = Place::new("long");
    const MISSED: usize = 1700;
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    runtime.block_on(async {
        use stillcut::store::{Retention, StoreWriter};
        use stillcut::telemetry::{Event, EventKind, Metrics};
        let keep = Retention { max_age_ns: i64::MAX, max_bytes: u64::MAX, audit_rows: 10_000, outbox: false };
        let metrics = std::sync::Arc::new(Metrics::new(&[], 0.0).unwrap());
        let (writer, _, _) = StoreWriter::start(&place.state(), keep, metrics, 1).await.unwrap();
        let event = |k: usize| Event { id: format!("m{k}"), ..Event::new(EventKind::ChatterEnd, 1, "over") };
        let stored: Vec<_> = (0..MISSED).map(|k| writer.begin_store(event(k)).unwrap()).collect();
        for one in stored {
            one.await.unwrap();
        }
        writer.close().await.unwrap();
    });
    let running = service(&place);
    let mut stream = TcpStream::connect(running.handle().address()).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    stream.write_all(b"GET /api/v1/stream HTTP/1.1\r\nHost: localhost\r\nLast-Event-ID: 1\r\n\r\n").unwrap();
    let (mut text, mut buffer) = (String::new(), vec![0; 65_536]);
    while !text.contains(&format!("id: {MISSED}\n")) {
        let count = read_some(&mut stream, &mut buffer);
        assert!(count > 0, "the stream ended early");
        text += &String::from_utf8_lossy(&buffer[..count]);
    }
    let ids: Vec<usize> = text.lines().filter_map(|l| l.strip_prefix("id: ")?.parse().ok()).collect();
    assert_eq!(ids[..MISSED - 1], (2..=MISSED).collect::<Vec<_>>()[..]);
    assert!(!text.contains("event: lag"));
    running.stop();
}

#[test]
fn recordings_come_in_pages() {
    let place = Place::new("recpage");
    let running = service(&place);
    let folder = place.state().join("recordings");
    let mut first = None;
    for k in 0..5 {
        let kind = if k == 2 { "fault" } else { "chatter_onset" };
        let path = folder.join(format!("{kind}-{k}.parquet"));
        std::fs::write(&path, "x").unwrap();
        let time = *first.get_or_insert(std::fs::metadata(&path).unwrap().modified().unwrap());
        let time = time + Duration::from_millis(k);
        std::fs::File::options().write(true).open(&path).unwrap().set_modified(time).unwrap();
    }
    let address = running.handle().address().to_string();
    let (mut cursor, mut seen) = (String::new(), Vec::new());
    loop {
        let mut answer =
            ureq::get(format!("http://{address}/api/v1/recordings?limit=2{cursor}")).call().unwrap();
        let next = answer.headers().get("next-cursor").map(|v| v.to_str().unwrap().to_owned());
        let page: serde_json::Value =
            serde_json::from_str(&answer.body_mut().read_to_string().unwrap()).unwrap();
        seen.extend(page.as_array().unwrap().iter().map(|r| r["id"].as_str().unwrap().to_owned()));
        let Some(next) = next else { break };
        cursor = format!("&cursor={next}");
    }
    assert_eq!(seen, ["chatter_onset-4", "chatter_onset-3", "fault-2", "chatter_onset-1", "chatter_onset-0"]);
    let faults = get(&running, "/api/v1/recordings?kind=fault").json();
    assert_eq!((faults.as_array().unwrap().len(), faults[0]["id"].as_str()), (1, Some("fault-2")));
    assert_eq!(get(&running, "/api/v1/recordings?limit=0").code(), "invalid_query");
    assert_eq!(get(&running, "/api/v1/diagnoses?limit=5000").code(), "invalid_query");
    running.stop();
}

#[test]
fn pages_and_filters_reach_every_event_once() {
    let place = Place::new("paging");
    let mut config = place.config("");
    config.http.trust_loopback = true;
    let running = start(config).unwrap();
    let address = running.handle().address().to_string();
    for k in 0..25 {
        ask(&address, "POST", "/api/v1/override", &[], Some(&format!("{{\"reason\":\"={k}\"}}")));
    }
    until("all are stored", 5, || {
        get(&running, "/api/v1/events?kind=override&limit=100").json()["events"].as_array().unwrap().len()
            == 25
    });
    for order in ["newest", "oldest"] {
        let (mut cursor, mut seen) = (String::new(), Vec::new());
        loop {
            let page =
                get(&running, &format!("/api/v1/events?kind=override&limit=7&order={order}{cursor}")).json();
            seen.extend(page["events"].as_array().unwrap().iter().map(|e| e["sequence"].as_i64().unwrap()));
            let Some(next) = page["next"].as_i64() else { break };
            cursor = format!("&cursor={next}");
        }
        let mut sorted = seen.clone();
        sorted.sort_unstable();
        sorted.dedup();
        assert_eq!((seen.len(), sorted.len()), (25, 25), "{order}");
    }
    let csv = ask(&address, "GET", "/api/v1/events?kind=override", &[("Accept", "text/csv")], None);
    assert!(csv.kind.starts_with("text/csv") && csv.body.lines().count() == 26);
    let csv = get(&running, "/api/v1/events?kind=override&format=csv&limit=7");
    assert!(csv.kind.starts_with("text/csv") && csv.body.lines().count() == 8);
    let parquet = get(&running, "/api/v1/events?kind=override&format=parquet");
    assert!(parquet.status == 200 && parquet.kind == "application/vnd.apache.parquet");
    running.stop();
}

#[test]
fn the_way_up_is_decided_where_the_mode_is() {
    use stillcut::service::{OperationError, Origin, Refusal, live::Mode};
    let place = Place::new("wayup");
    let running = service(&place);
    let origin = || Origin { actor: "o".into(), role: "operator".into(), reason: "test".into() };
    // As if the asker's picture still showed the higher mode.
    let refused = running.wait(running.handle().set_mode(Mode::Advise, None, origin())).unwrap_err();
    assert!(matches!(refused, OperationError::Refused(Refusal::WayUp { .. })), "{refused}");
    assert!(running.wait(running.handle().set_mode(Mode::Observe, None, origin())).is_ok());
    running.stop();
}

#[test]
fn a_key_is_good_for_one_request_and_the_turret_is_always_taken_back() {
    let place = Place::new("key");
    let mut config = place.config("");
    config.http.trust_loopback = true;
    let running = start(config).unwrap();
    let address = running.handle().address().to_string();
    let post = |path: &str, reason: &str| {
        let body = format!("{{\"reason\":\"{reason}\"}}");
        ask(&address, "POST", path, &[("Idempotency-Key", "k1")], Some(&body))
    };
    for _ in 0..3 {
        assert_eq!(post("/api/v1/override", "now").status, 200);
    }
    // The answer does not wait for the history.
    crate::running::until("each override in the history", 5, || {
        let events = get(&running, "/api/v1/events?kind=override").json();
        events["events"].as_array().unwrap().len() == 3
    });
    let first = post("/api/v1/recordings", "a");
    assert_eq!((first.status, &post("/api/v1/recordings", "a").body), (202, &first.body));
    assert_eq!(post("/api/v1/recordings", "b").code(), "idempotency_key_reused");
    for key in ["sch\u{fc}ssel", ""] {
        let body = Some("{\"reason\":\"x\"}");
        let refused = ask(&address, "POST", "/api/v1/recordings", &[("Idempotency-Key", key)], body);
        assert_eq!((refused.status, refused.code().as_str()), (400, "invalid_idempotency_key"), "{key}");
    }
    running.stop();
}

#[test]
fn a_recording_is_given_as_parquet_csv_and_json_and_played_again() {
    let place = Place::new("forms");
    let mut config = place.config("");
    config.http.trust_loopback = true;
    config.program = Some(env!("CARGO_BIN_EXE_stillcut").into());
    (config.recorder.before_s, config.recorder.after_s) = (1.0, 0.5);
    let running = start(config).unwrap();
    let lathe = LatheThread::start(&place.domain);
    until("a recording of the onset", 40, || {
        !get(&running, "/api/v1/recordings").json().as_array().unwrap().is_empty()
    });
    let id = get(&running, "/api/v1/recordings").json()[0]["id"].as_str().unwrap().to_owned();
    let path = |form: &str| format!("/api/v1/recordings/{id}/{form}");
    let csv = get(&running, &path("file.csv"));
    assert!(csv.kind.starts_with("text/csv") && csv.body.starts_with("t_s,"), "{}", csv.kind);
    let json = get(&running, &path("file.json")).json();
    let values = json["columns"]["x1_stage_position_m"].as_array().unwrap().len();
    assert_eq!(values + 1, csv.body.lines().count());
    let replay = get(&running, &path("replay"));
    assert_eq!(replay.status, 200, "{replay:?}");
    let replay = replay.json();
    assert!(
        replay["events"].as_array().unwrap().iter().any(|e| e["kind"] == "chatter_onset"),
        "{replay:.300}"
    );
    assert!(replay["track"]["chatter"].as_array().unwrap().iter().any(|c| c == true));
    assert_eq!(get(&running, "/api/v1/recordings/none/replay").code(), "not_found");
    drop(lathe);
    running.stop();
}

/// Whoever hangs up leaves no work behind, and no place that looks free while its work goes on.
#[test]
fn work_ends_with_the_asker_and_its_seat_with_the_work() {
    use std::os::unix::fs::PermissionsExt as _;
    let place = Place::new("hangup");
    let (pids, program) = (place.folder.path().join("pids"), place.folder.path().join("slow"));
    let script = format!("#!/bin/sh\necho $$ >> {}\nexec sleep 50\n", pids.display());
    std::fs::write(&program, script).unwrap();
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
    let mut config = place.config("");
    config.program = Some(program);
    let running = start(config).unwrap();
    let values = (0..400_000).map(f64::from).collect();
    let recording = stillcut::sample::Recording {
        sample_rate: stillcut::units::SampleRate::new(9000.0).unwrap(),
        experiment: "long".into(),
        axes: vec!["x1".into()],
        columns: vec![stillcut::sample::Column { name: "x1_force_n".into(), values }],
        start_s: 0.0,
        metadata: vec![],
    };
    let path = place.state().join("recordings/long.parquet");
    stillcut::recording::write_recording(&path, &recording).unwrap();
    let say = |form: &str| {
        let mut stream = TcpStream::connect(running.handle().address()).unwrap();
        let request = format!("GET /api/v1/recordings/long/{form} HTTP/1.1\r\nHost: localhost\r\n\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        stream
    };
    // A listener that waits for its answer; refused, it asks again.
    let listen = || loop {
        let mut stream = say("replay");
        stream.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
        if stream.read(&mut [0; 12]).is_err() {
            break stream;
        }
        std::thread::sleep(Duration::from_millis(50));
    };
    for round in 1..3 {
        let listeners = [listen(), listen()];
        let begun = || std::fs::read_to_string(&pids).unwrap_or_default();
        until("both replays run", 10, || begun().lines().count() == 2 * round);
        assert_eq!(get(&running, "/api/v1/recordings/long/replay").code(), "busy");
        drop(listeners);
        let gone = |pid: &str| !std::path::Path::new(&format!("/proc/{pid}")).exists();
        until("no process is left", 10, || begun().lines().all(gone));
    }
    // A reader that takes nothing keeps its seat; one that is gone does not.
    let mut readers: Vec<TcpStream> = Vec::new();
    until("two downloads run", 10, || {
        readers = vec![say("file.json"), say("file.csv")];
        readers.iter_mut().all(|reader| {
            let mut head = [0; 12];
            read_some(reader, &mut head) == 12 && head.ends_with(b"200")
        })
    });
    assert_eq!(get(&running, "/api/v1/recordings/long/file.csv").code(), "busy");
    drop(readers);
    until("a download is given", 10, || get(&running, "/api/v1/recordings/long/file.csv").status == 200);
    running.stop();
}

#[test]
fn the_configuration_has_an_etag_and_no_secrets() {
    let place = Place::new("etag");
    let running = service(&place);
    let first = get(&running, "/api/v1/config");
    assert_eq!(first.status, 200);
    let address = running.handle().address().to_string();
    assert_eq!(first.json()["can_diagnose"], false, "there is no model");
    let again = ask(&address, "GET", "/api/v1/config", &[("If-None-Match", &first.etag)], None);
    assert_eq!(again.status, 304);
    running.stop();
}

#[test]
fn the_page_and_the_api_browser_load_nothing_from_elsewhere() {
    let place = Place::new("page");
    let running = service(&place);
    for path in ["/", "/page.css", "/page.js", "/charts.js", "/icon.svg", "/docs/problems", "/api/"] {
        let answer = get(&running, path);
        assert_eq!(answer.status, 200, "{path}");
        let outside: Vec<_> = answer
            .body
            .match_indices("http")
            .map(|(i, _)| &answer.body[i..(i + 40).min(answer.body.len())])
            .collect();
        let harmless = |t: &&str| {
            t.starts_with("http://www.w3.org/") || !t.starts_with("http://") && !t.starts_with("https://")
        };
        assert!(outside.iter().all(harmless), "{path}: {outside:?}");
    }
    let size: usize =
        ["/", "/page.css", "/page.js", "/charts.js"].iter().map(|p| get(&running, p).body.len()).sum();
    assert!(size < 300_000, "{size} bytes");
    let problems = get(&running, "/docs/problems").body;
    for code in ["bad_token", "role_too_low", "stale_revision", "not_ready", "store_unavailable"] {
        assert!(problems.contains(&format!("id=\"{code}\"")), "{code} is explained");
    }
    running.stop();
}

#[test]
fn a_post_that_is_sent_again_with_its_key_is_done_once() {
    let place = Place::new("idem");
    let mut config = place.config("");
    config.http.trust_loopback = true;
    let running = start(config).unwrap();
    let address = running.handle().address().to_string();
    for _ in 0..3 {
        let key = [("Idempotency-Key", "save-1")];
        let answer = ask(&address, "POST", "/api/v1/recordings", &key, Some("{\"reason\":\"x\"}"));
        assert_eq!(answer.status, 202, "{answer:?}");
    }
    let other = [("Idempotency-Key", "save-2")];
    ask(&address, "POST", "/api/v1/recordings", &other, Some("{\"reason\":\"x\"}"));
    let rows = get(&running, "/api/v1/audit").json();
    let saved = rows.as_array().unwrap().iter().filter(|r| r["action"] == "save_recording").count();
    assert_eq!(saved, 2, "{rows}");
    // The same rows, two a page.
    let (mut after, mut seen) = ("0".to_owned(), Vec::new());
    loop {
        let path = format!("http://{address}/api/v1/audit?limit=2&after={after}");
        let mut page = ureq::get(path).call().unwrap();
        let next = page.headers().get("next-cursor").map(|v| v.to_str().unwrap().to_owned());
        let text = page.body_mut().read_to_string().unwrap();
        seen.extend(serde_json::from_str::<Vec<serde_json::Value>>(&text).unwrap());
        let Some(next) = next else { break };
        after = next;
    }
    assert_eq!(&seen, rows.as_array().unwrap());
    assert_eq!(get(&running, "/api/v1/audit?limit=0").code(), "invalid_query");
    running.stop();
}

/// A client that trusts one certificate, and what it reads.
fn over_tls(address: &str, certificate: &[u8], request: &str) -> String {
    let mut roots = rustls::RootCertStore::empty();
    roots.add(rustls::pki_types::CertificateDer::from(certificate.to_vec())).unwrap();
    let provider = std::sync::Arc::new(rustls::crypto::ring::default_provider());
    let config = rustls::ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    let name = rustls::pki_types::ServerName::try_from("localhost").unwrap();
    let mut connection = rustls::ClientConnection::new(std::sync::Arc::new(config), name).unwrap();
    let mut socket = TcpStream::connect(address).unwrap();
    let mut tls = rustls::Stream::new(&mut connection, &mut socket);
    tls.write_all(request.as_bytes()).unwrap();
    let mut text = String::new();
    let _ = tls.read_to_string(&mut text); // ends without a farewell
    text
}

#[test]
fn tls_is_spoken_where_it_is_configured() {
    let place = Place::new("tls");
    tokens(&place);
    let made = rcgen::generate_simple_self_signed(vec!["localhost".to_owned()]).unwrap();
    std::fs::write(place.folder.path().join("tls.crt"), made.cert.pem()).unwrap();
    std::fs::write(place.folder.path().join("tls.key"), made.signing_key.serialize_pem()).unwrap();
    let key = place.folder.path().join("tls.key");
    let mode = |mode| {
        std::fs::set_permissions(&key, std::os::unix::fs::PermissionsExt::from_mode(mode)).unwrap();
    };
    mode(0o644);
    let http = "certificate = \"tls.crt\"\nkey = \"tls.key\"\ntokens = \"tokens.toml\"";
    let refused = start(place.config(http)).unwrap_err().to_string();
    assert!(refused.contains("tls.key: mode 644 lets others read it"), "{refused}");
    mode(0o600);
    let other = rcgen::generate_simple_self_signed(vec!["localhost".to_owned()]).unwrap();
    std::fs::write(&key, other.signing_key.serialize_pem()).unwrap();
    let refused = start(place.config(http)).unwrap_err().to_string();
    assert!(refused.contains("http.key: ") && refused.contains("tls.key: "), "{refused}");
    std::fs::write(&key, made.signing_key.serialize_pem()).unwrap();
    let running = start(place.config(http)).unwrap();
    let address = running.handle().address().to_string();
    let request = "GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    let text = over_tls(&address, made.cert.der(), request);
    assert!(text.starts_with("HTTP/1.1 200") && text.ends_with("alive\n"), "{text}");
    let mut plain = TcpStream::connect(&address).unwrap();
    plain.write_all(request.as_bytes()).unwrap();
    let mut answer = Vec::new();
    let _ = plain.read_to_end(&mut answer);
    assert!(!String::from_utf8_lossy(&answer).contains("alive"), "nothing is told in plain text");
    running.stop();
}

#[test]
fn an_mtconnect_agent_is_told_what_changes() {
    let place = Place::new("shdr");
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let agents = free.local_addr().unwrap();
    drop(free);
    let mut config = place.config("");
    config.mtconnect = Some(agents);
    let running = start(config).unwrap();
    let mut agent = TcpStream::connect(agents).unwrap();
    agent.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    agent.write_all(b"* PING\n").unwrap();
    let mut text = String::new();
    let mut buffer = [0; 1024];
    while !(text.contains("* PONG 10000\n") && text.contains("|chatter_condition|UNAVAILABLE||||\n")) {
        let count = read_some(&mut agent, &mut buffer);
        assert!(count > 0, "{text}");
        text += &String::from_utf8_lossy(&buffer[..count]);
    }
    assert!(text.contains("|mode|UNAVAILABLE\n"), "{text}");
    running.stop();
}
