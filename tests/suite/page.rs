//! The operator page in a real browser, without a network. The browser is driven over its debugging
//! pipe, so that the test waits for what the page shows and not for a time.

use crate::folders::not_run;
use crate::running::{LatheThread, Place, get, until};
use serde_json::{Value, json};
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

const PATIENCE: Duration = Duration::from_secs(60);

fn program() -> Option<&'static str> {
    ["chromium", "chromium-browser", "google-chrome"].into_iter().find(|name| {
        let tried = Command::new(name).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
        tried.is_ok_and(|s| s.success())
    })
}

/// One page of one browser; messages are JSON with a NUL after each, commands in on 3, answers out on 4.
struct Browser {
    child: Child,
    commands: ChildStdin,
    answers: Receiver<Value>,
    session: Value,
    last_id: u64,
    complaints: Vec<String>,
}

impl Browser {
    fn open(program: &str, profile: &Path) -> Self {
        let line = format!(
            "exec {program} --headless --no-sandbox --disable-gpu --remote-debugging-pipe \
             --host-resolver-rules='MAP * ~NOTFOUND, EXCLUDE 127.0.0.1' --user-data-dir='{}' \
             about:blank 3<&0 4>&1 1>/dev/null 2>&1",
            profile.display()
        );
        let mut command = Command::new("sh");
        let mut child =
            command.args(["-c", &line]).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let commands = child.stdin.take().unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap());
        let (out, answers) = channel();
        std::thread::spawn(move || {
            let mut message = Vec::new();
            while lines.read_until(0, &mut message).is_ok_and(|n| n > 0) {
                message.pop();
                let Ok(value) = serde_json::from_slice(&message) else { break };
                if out.send(value).is_err() {
                    break;
                }
                message.clear();
            }
        });
        let complaints = Vec::new();
        let mut this = Self { child, commands, answers, session: Value::Null, last_id: 0, complaints };
        let target = this.ask("Target.createTarget", json!({"url": "about:blank"}))["targetId"].clone();
        let attached = this.ask("Target.attachToTarget", json!({"targetId": target, "flatten": true}));
        this.session = attached["sessionId"].clone();
        for domain in ["Page.enable", "Runtime.enable", "Log.enable"] {
            this.ask(domain, json!({}));
        }
        this
    }

    fn ask(&mut self, method: &str, params: Value) -> Value {
        self.last_id += 1;
        let mut message = json!({"id": self.last_id, "method": method, "params": params});
        if self.session.is_string() {
            message["sessionId"] = self.session.clone();
        }
        self.commands.write_all(format!("{message}\0").as_bytes()).unwrap();
        loop {
            let said = self.answers.recv_timeout(PATIENCE).unwrap_or_else(|_| panic!("{method}: no answer"));
            if said["id"] == self.last_id {
                assert!(said["error"].is_null(), "{method}: {said}");
                return said["result"].clone();
            }
            let level = &said["params"]["entry"]["level"];
            let kind = &said["params"]["type"];
            if said["method"] == "Runtime.exceptionThrown"
                || level == "error"
                || level == "warning"
                || kind == "error"
                || kind == "warning"
            {
                self.complaints.push(said["params"].to_string());
            }
        }
    }

    fn value(&mut self, expression: &str) -> Value {
        let params = json!({"expression": expression, "returnByValue": true});
        self.ask("Runtime.evaluate", params)["result"]["value"].clone()
    }

    fn wait_for(&mut self, what: &str, expression: &str) {
        let began = Instant::now();
        while self.value(expression) != true {
            let page = self.value("document.body.innerText");
            assert!(began.elapsed() < PATIENCE, "waited for {what}; the page says {page}");
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    fn size(&mut self, width: u32, height: u32) {
        let params = json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600});
        self.ask("Emulation.setDeviceMetricsOverride", params);
    }

    /// Keeps a picture where `STILLCUT_PICTURES` names a folder, for eyes.
    fn picture(&mut self, name: &str) {
        let Some(folder) = std::env::var_os("STILLCUT_PICTURES") else { return };
        let shot = self.ask("Page.captureScreenshot", json!({"format": "png"}));
        let text = shot["data"].as_str().unwrap();
        std::fs::write(Path::new(&folder).join(format!("{name}.png.base64")), text).unwrap();
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Browser {
    fn click(&mut self, expression: &str) {
        self.wait_for("something to click", &format!("Boolean({expression})"));
        self.value(&format!("{expression}.click()"));
    }

    fn press(&mut self, key: &str) {
        let event = format!("new KeyboardEvent('keydown', {{key: '{key}', bubbles: true}})");
        self.value(&format!("document.body.dispatchEvent({event})"));
    }

    /// Confirms the question that is open.
    fn confirm(&mut self) {
        self.wait_for("the question", "document.getElementById('ask').open");
        self.value("document.getElementById('ask-ok').click()");
        self.wait_for("its answer", "!document.getElementById('ask').open");
    }
}

/// What an operator does: dark mode by key, silence and acknowledge an alarm, raise the mode, take the turret
/// back with one key.
fn operate(browser: &mut Browser) {
    browser.size(1280, 800);
    browser.press("t");
    let theme = browser.value("document.documentElement.dataset.theme");
    browser.press("t");
    let other = browser.value("document.documentElement.dataset.theme");
    assert!(theme.is_string() && other.is_string() && theme != other, "{theme} {other}");
    browser.value("document.documentElement.dataset.theme = 'dark'");
    std::thread::sleep(Duration::from_millis(500)); // colours fade
    browser.picture("dark");
    browser.value("document.documentElement.dataset.theme = 'light'");
    let button = |list: &str, word: &str| {
        format!("[...document.querySelectorAll('#{list} button')].find((b) => b.innerText === '{word}')")
    };
    browser.wait_for("an open alarm", "document.getElementById('alarms').innerText === '1 open'");
    browser.size(1280, 1500);
    std::thread::sleep(Duration::from_millis(500));
    browser.picture("alarm");
    browser.size(1280, 800);
    browser.click(&button("open-alarms", "Silence"));
    browser.value("document.getElementById('ask-reason').value = 'known'");
    browser.confirm();
    browser.wait_for("no alarm stands out", "document.getElementById('open').hidden");
    browser
        .wait_for("it is silenced", "document.getElementById('events').innerText.includes('silenced until')");
    browser.click(&button("events", "Acknowledge"));
    browser.confirm();
    browser.wait_for(
        "it is acknowledged",
        "document.getElementById('events').innerText.includes('acknowledged by')",
    );
    let pressed = |mode: &str| {
        format!("document.getElementById('mode-{mode}').getAttribute('aria-pressed') === 'true'")
    };
    browser.press("2");
    browser.wait_for("the question", "document.getElementById('ask').open");
    browser.value("document.getElementById('ask-reason').value = 'second shift'");
    browser.confirm();
    browser.wait_for("advise", &pressed("advise"));
    // The way back works from a dialog, by its button and by its key.
    browser.press("?");
    browser.wait_for("the keys", "document.getElementById('keys-list').open");
    browser.press("r");
    browser.wait_for("observe", &pressed("observe"));
    browser.wait_for("the dialog is gone", "document.querySelector('dialog[open]') === null");
    browser.press("2");
    browser.wait_for("the question", "document.getElementById('ask').open");
    browser.click("document.querySelector('#ask [data-take-back]')");
    browser.wait_for("the question is gone", "!document.getElementById('ask').open");
    // It stays in sight wherever the page is scrolled to, and works there.
    browser.size(390, 844);
    browser.value("window.scrollTo(0, document.body.scrollHeight)");
    let seen = "(() => { const b = document.getElementById('take-back').getBoundingClientRect(); \
        return b.top >= 0 && b.bottom <= innerHeight && b.height > 30; })()";
    assert_eq!(browser.value(seen), true, "the way back stays in sight");
    browser.picture("scrolled");
    browser.size(1280, 800);
    browser.value("speak('ja')");
    browser.picture("japanese");
    browser.value("speak('de')");
    assert_eq!(browser.value("document.getElementById('take-back').innerText"), "Revolver zurückholen");
    browser.wait_for("a comma", "/± \\d+,\\d N/.test(document.getElementById('legend').innerText)");
    let numbers = "[say('4.5 s saved as r-1 (1.0.2)'), local('v0.1.0'), fixed(651.25, 1)].join(' | ')";
    let told = browser.value(numbers);
    assert_eq!(told, "4,5 s gesichert als r-1 (1.0.2) | v0.1.0 | 651,3");
    browser.picture("german");
    browser.value("speak('en')");
    browser.press("r");
    let note = "document.getElementById('take-back-note').innerText.includes('turret taken back')";
    browser.wait_for("word of it", note);
}

/// Both charts tell of the moment under the pointer, which stands at one place in both, with a line through it;
/// the spectrum takes what room its row leaves.
fn look_at_one_moment(browser: &mut Browser) {
    let room = "(() => { const c = waterfall.canvas, s = c.parentElement.getBoundingClientRect(); \
        return s.bottom - c.getBoundingClientRect().bottom; })()";
    let room = browser.value(room).as_f64().unwrap();
    assert!(room < 20.0, "{room} pixels under the spectrum");
    let over = "(() => { const c = force.canvas, b = c.getBoundingClientRect(); \
        const at = { clientX: b.left + 52 + 0.9 * (b.width - 110), clientY: b.top + 20, bubbles: true }; \
        c.dispatchEvent(new PointerEvent('pointermove', at)); \
        return parseFloat(document.getElementById('force-note').textContent); })()";
    let age_s = browser.value(over).as_f64().unwrap();
    assert!((age_s + 2.0).abs() < 0.06, "{age_s} s: a tenth of the range before now");
    let line = |chart: &str| {
        format!(
            "(() => {{ const c = {chart}.canvas, x = Math.round(52 + 0.9 * (c.clientWidth - 110)); \
             const read = document.createElement('canvas').getContext('2d', {{ willReadFrequently: true }}); \
             read.drawImage(c, -x + 2, -40); \
             const p = (k) => [...read.getImageData(2 + k, 0, 1, 1).data].join(); \
             return p(0) !== p(-2) && p(0) !== p(2); }})()"
        )
    };
    for chart in ["waterfall", "force"] {
        browser.wait_for("a line at the pointer", &line(chart));
    }
    browser.value("force.canvas.dispatchEvent(new PointerEvent('pointerleave'))");
    assert_eq!(browser.value("document.getElementById('force-note').textContent"), "");
}

#[test]
fn the_page_comes_alive_in_a_browser_without_a_network() {
    let Some(program) = program() else {
        not_run("no chromium is installed");
        return;
    };
    let place = Place::new("page");
    let mut config = place.config("");
    config.http.trust_loopback = true;
    config.program = Some(env!("CARGO_BIN_EXE_stillcut").into());
    (config.recorder.before_s, config.recorder.after_s) = (1.5, 0.5);
    let running = stillcut::service::start(config).unwrap();
    let lathe = LatheThread::start(&place.domain);
    until("samples come", 10, || get(&running, "/readyz").status == 200);
    std::thread::sleep(Duration::from_secs(4));
    let mut browser = Browser::open(program, place.folder.path());
    browser.size(1280, 800);
    let url = format!("http://{}/", running.handle().address());
    browser.ask("Page.navigate", json!({"url": url}));
    browser.wait_for("the stream", "document.getElementById('link')?.innerText === 'live'");
    browser.wait_for("the speed", "document.body.innerText.includes('1200 rpm')");
    browser.wait_for("the band", "document.body.innerText.includes('watched band')");
    // The charts open with what was before the page: more than came since.
    let past = "waterfall.columns.filter(Boolean).length";
    browser.wait_for("the past", &format!("{past} > 40 && force.slices.length > 40"));
    // Frames that were under way while the past was asked for take nothing of it away.
    let overlap = "(() => { const f = new ForceTrace(document.getElementById('force')); \
        const age = Array.from({length: 400}, (_, k) => 20 - 0.05 * (k + 1)); \
        f.load({seconds: 20, newest_t_s: 100, age_s: age, force_n: [age.map(() => [-1, 1])]}); \
        for (const t of [99.9, 99.95, 100, 100.05]) f.add({t_s: t, slice_s: 0.005, axes: [[], Array(10).fill([0, 1])]}); \
        const t = f.slices.map((s) => s.t); \
        return f.slices.length > 390 && t.every((x, k) => k === 0 || x > t[k - 1]); })()";
    assert_eq!(browser.value(overlap), true);
    look_at_one_moment(&mut browser);
    browser.value("document.getElementById('range').value = '60'; loadPast()");
    browser.wait_for("the last minute", &format!("waterfall.rangeS === 60 && {past} > 10"));
    browser.value("document.getElementById('range').value = '20'; loadPast()");
    let fits = "document.documentElement.scrollWidth <= window.innerWidth";
    assert_eq!(browser.value(fits), true, "nothing sticks out at 1280 pixels");
    std::thread::sleep(Duration::from_secs(if std::env::var_os("STILLCUT_PICTURES").is_some() {
        6
    } else {
        0
    }));
    browser.picture("wide");
    browser.size(390, 844);
    assert_eq!(browser.value(fits), true, "nothing sticks out on a phone");
    browser.picture("phone");
    browser.size(320, 640);
    let widest = "[...document.querySelectorAll('body *')].filter((e) => e.getBoundingClientRect().right > innerWidth + 1) \
        .map((e) => e.tagName + '#' + e.id + '.' + e.className).slice(0, 8).join(' ')";
    assert_eq!(browser.value(fits), true, "nor on a small one: {}", browser.value(widest));
    browser.size(390, 844);
    // The recording around the onset is one click from being played again.
    let button = "[...document.querySelectorAll('#recordings button')].find((b) => b.innerText === 'Replay')";
    browser.wait_for("a recording", &format!("Boolean({button})"));
    browser.value(&format!("{button}.click()"));
    browser.wait_for(
        "the replay",
        "document.getElementById('replay-note').innerText.includes('shaded chatter')",
    );
    let onset = "document.getElementById('replay-events').innerText.includes('chatter onset')";
    assert_eq!(
        browser.value(onset),
        true,
        "{}",
        browser.value("document.getElementById('replay').innerText")
    );
    browser.picture("replay");
    browser.value("document.getElementById('replay-close').click()");
    let diagnose = button.replace("Replay", "Diagnose");
    let without_model = format!("{diagnose}.disabled && {diagnose}.title.includes('machine.model')");
    assert_eq!(browser.value(&without_model), true, "without a model there is no diagnosis");
    operate(&mut browser);
    let page = browser.value("document.documentElement.outerHTML");
    let page = page.as_str().unwrap();
    assert!(page.contains("Take the turret back"), "{page:.500}");
    let outside = ["http://", "https://"].iter().flat_map(|p| page.match_indices(p)).filter(|(at, _)| {
        let rest = &page[*at..];
        !(rest.starts_with("http://127.0.0.1") || rest.starts_with("http://www.w3.org"))
    });
    assert_eq!(outside.count(), 0, "nothing on the page points elsewhere");
    assert!(browser.complaints.is_empty(), "{:?}", browser.complaints);
    // The service goes: the page stays, says so, and comes back by itself.
    let address = running.handle().address();
    running.stop();
    browser.wait_for("the loss", "document.body.innerText.includes('service away')");
    let verdict = "document.getElementById('verdict')";
    let nothing =
        format!("{verdict}.className.trim() === 'verdict' && {verdict}.innerText.includes('No data')");
    assert_eq!(browser.value(&nothing), true, "what was said last is not said any more");
    browser.picture("away");
    assert!(browser.value("document.body.innerText.length").as_u64().unwrap() > 300, "never a blank page");
    let mut config = place.config("");
    config.http.listen = address;
    config.model = Some("machine.toml".into());
    let running = stillcut::service::start(config).unwrap();
    browser.wait_for("the return", "document.getElementById('link').innerText === 'live'");
    browser.wait_for("the diagnosis, now that there is a model", &format!("!{diagnose}.disabled"));
    if std::env::var_os("STILLCUT_PICTURES").is_some() {
        std::thread::sleep(Duration::from_secs(4));
    }
    browser.picture("return");
    drop(lathe);
    running.stop();
}
