//! The service as a user runs it who is bound by the modes of files: root may read everything.

use crate::folders::not_run;
use crate::running::{Answer, Place, ask, tokens, until};
use crate::service::Process;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _, chown};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// Whom root lets run it.
const USER: u32 = 12_345;

/// The program as an unprivileged user starts it.
struct Unprivileged {
    program: PathBuf,
    by_root: bool,
}

impl Unprivileged {
    /// Gives a place to that user. Nothing, said aloud, where root has no way to become one.
    fn owner_of(place: &Place) -> Option<Self> {
        let folder = place.folder.path();
        let built = Path::new(env!("CARGO_BIN_EXE_stillcut"));
        if std::fs::metadata(folder).unwrap().uid() != 0 {
            return Some(Self { program: built.to_owned(), by_root: false });
        }
        if !Command::new("setpriv").arg("--version").stdout(Stdio::null()).status().is_ok_and(|s| s.success())
        {
            not_run("root needs setpriv to run a service as another user");
            return None;
        }
        // Where it was built may be closed to others.
        let program = folder.join("stillcut");
        std::fs::copy(built, &program).unwrap();
        for path in [folder.to_owned(), program.clone(), folder.join("tokens.toml")] {
            chown(path, Some(USER), Some(USER)).unwrap();
        }
        Some(Self { program, by_root: true })
    }

    fn command(&self) -> Command {
        if !self.by_root {
            return Command::new(&self.program);
        }
        let mut command = Command::new("setpriv");
        let user = USER.to_string();
        command.args(["--reuid", &user, "--regid", &user, "--clear-groups"]).arg(&self.program);
        command
    }
}

struct Lathe(Child);

impl Lathe {
    fn start(user: &Unprivileged, place: &Place) -> Self {
        let mut command = user.command();
        let prefix = place.domain.prefix().trim_end_matches('_');
        command.args(["lathe", "--entry-s", "0.5", "--prefix", prefix, "--root"]).arg(place.domain.root());
        Self(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap())
    }
}

impl Drop for Lathe {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Nobody may read the token file any more, its owner neither: `act` ends, the turret comes back, who held a
/// token takes it back until then, and all of it is told; mended, it goes on.
#[test]
fn a_token_file_that_cannot_be_read_ends_acting_and_the_turret_comes_back() {
    let place = Place::new("unread");
    let [_, operator, engineer] = tokens(&place);
    let Some(user) = Unprivileged::owner_of(&place) else { return };
    let process = Process::try_run(user.command(), &place, "tokens = \"tokens.toml\"").unwrap();
    let _lathe = Lathe::start(&user, &place);
    let get = |path: &str| ask(&process.address, "GET", path, &[], None);
    let state = || get("/api/v1/state").json();
    let pitch = || state()["pitch"]["reported_rad"].as_f64().unwrap_or(0.0).abs();
    let act = || -> Answer {
        let (etag, bearer) = (get("/api/v1/mode").etag, format!("Bearer {engineer}"));
        let headers = [("If-Match", etag.as_str()), ("Authorization", &bearer)];
        let body = "{\"mode\":\"act\",\"reason\":\"test\"}";
        ask(&process.address, "PUT", "/api/v1/mode", &headers, Some(body))
    };
    let take_back = || process.ask("POST", "/api/v1/override", &operator, Some("{\"reason\":\"mine\"}"));
    let file = place.folder.path().join("tokens.toml");
    let mode = |bits| std::fs::set_permissions(&file, std::fs::Permissions::from_mode(bits)).unwrap();
    until("acting is possible", 20, || act().status == 200);
    until("the turret stands apart", 40, || pitch() > 0.06);

    mode(0o000);
    until("acting ends", 4, || state()["mode"] == "observe");
    assert!(state()["fault"].as_str().is_some_and(|f| f.contains("token")), "{}", state()["fault"]);
    assert_eq!(take_back().status, 200, "on its way back, the token that was good does it, too");
    until("equal pitch", 4, || pitch() < 1e-3);
    until("it is told", 4, || {
        let ready = get("/readyz");
        let told = get("/api/v1/events?kind=access_lost").body;
        let alarm = get("/api/v1/events?kind=fault&open_alarms=true").json();
        ready.status == 503
            && ready.body.contains("Permission denied")
            && told.contains("it must be the service's user's own, of mode 600")
            && !alarm["events"].as_array().unwrap().is_empty()
    });
    until("nobody has a token", 4, || take_back().status == 401);

    mode(0o600);
    let clear = || process.ask("POST", "/api/v1/fault/clear", &engineer, Some("{\"reason\":\"mended\"}"));
    until("it is mended", 4, || clear().status == 200);
    assert_eq!(state()["mode"], "observe", "it does not resume by itself");
}
