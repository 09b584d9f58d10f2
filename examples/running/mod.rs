//! The real service as a process of its own, for programs that watch it from outside. Each uses a part of this.
#![allow(dead_code)]

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// Ends the program where its arguments are asked for, or are not these names with a number each.
pub(crate) fn expect_numbers(names: &[&str]) {
    let usage: Vec<String> = names.iter().map(|name| format!("[{name} N]")).collect();
    let usage = usage.join(" ");
    let mut given = std::env::args().skip(1);
    while let Some(name) = given.next() {
        if name == "--help" || name == "-h" {
            println!("expected: {usage}; what it does stands at the head of its source");
            std::process::exit(0);
        }
        let is_number = given.next().is_some_and(|v| v.parse::<f64>().is_ok());
        if !is_number || !names.contains(&name.as_str()) {
            eprintln!("error: {name}: expected {usage}");
            std::process::exit(2);
        }
    }
}

/// A number after its name on the command line.
pub(crate) fn number(name: &str, default: f64) -> f64 {
    let given = std::env::args().skip_while(|a| a != name).nth(1);
    given.and_then(|v| v.parse().ok()).unwrap_or(default)
}

/// The binary of the build that this program is of.
pub(crate) fn binary() -> Command {
    let own = std::env::current_exe().expect("this program has a place");
    Command::new(own.ancestors().nth(2).expect("target/PROFILE/examples").join("stillcut"))
}

/// A process that ends with its owner.
pub(crate) struct Process(pub(crate) Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = (self.0.kill(), self.0.wait());
    }
}

/// Settings of the system's memory allocator, as in the unit (`deploy/systemd`).
const ALLOCATOR: [(&str, &str); 2] = [("MALLOC_MMAP_THRESHOLD_", "131072"), ("MALLOC_ARENA_MAX", "2")];

/// Writes the configuration of a service with one token, and keys added to those of its history; answers the token.
pub(crate) fn configure(folder: &Path, prefix: &str, role: &str, more: &str) -> String {
    use std::os::unix::fs::PermissionsExt as _;
    let (token, digest) = stillcut::http::new_token([7; 32]);
    let tokens = folder.join("tokens.toml");
    let text = format!("[[token]]\nname = \"c\"\nrole = \"{role}\"\nsha256 = \"{digest}\"\n");
    std::fs::write(&tokens, text).expect("a folder for temporary files");
    std::fs::set_permissions(&tokens, std::fs::Permissions::from_mode(0o600)).expect("the file is ours");
    let text = format!(
        "[transport]\nprefix = \"{prefix}\"\nroot = \"{0}/iox\"\n[http]\nlisten = \"127.0.0.1:0\"\n\
         tokens = \"tokens.toml\"\n[history]\nfolder = \"{0}/state\"\n{more}",
        folder.display()
    );
    std::fs::write(folder.join("c.toml"), text).expect("a folder for temporary files");
    token
}

/// Starts the service in a folder that is configured; answers its address.
pub(crate) fn service(folder: &Path) -> (Process, String) {
    let mut command = binary();
    command.args(["run", "--config"]).arg(folder.join("c.toml")).stdout(Stdio::null()).stderr(Stdio::piped());
    command.envs(ALLOCATOR);
    let mut child = command.spawn().expect("cargo build --release made the binary");
    let address = address(&mut child).expect("it says where it listens");
    (Process(child), address)
}

/// Follows the log until it says where the service listens. Nothing when the process ends before.
pub(crate) fn address(child: &mut Child) -> Option<String> {
    let mut lines = BufReader::new(child.stderr.take()?).lines();
    loop {
        let line = lines.next()?.ok()?;
        if let Some(rest) = line.split("address=").nth(1) {
            let found = rest.split_whitespace().next()?.to_owned();
            std::thread::spawn(move || lines.for_each(drop));
            return Some(found);
        }
    }
}

/// A virtual lathe beside the service, in air.
pub(crate) fn lathe(folder: &Path, prefix: &str) -> Child {
    let mut command = binary();
    command.args(["lathe", "--prefix", prefix, "--entry-s", "100000", "--root"]).arg(folder.join("iox"));
    command
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("cargo build --release made the binary")
}

/// User and system time of a process, s.
pub(crate) fn busy_s(id: u32) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
    stat.split(' ').skip(13).take(2).filter_map(|v| v.parse::<f64>().ok()).sum::<f64>() / 100.0
}
