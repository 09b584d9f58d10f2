//! `stillcut token`.

use super::bad_input;
use crate::http::{Access, Role, holds_token, new_token, token_names};
use crate::service::clock;
use anyhow::Context as _;
use std::fs::File;
use std::io::{Read as _, Write as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::PathBuf;

/// Makes an access token: prints it once, and adds its SHA-256 to the file of tokens.
///
/// The running service takes a changed file into use within a second. To revoke a token, delete its
/// entry; to rotate, add a new one and delete the old one when nobody uses it any more.
#[derive(clap::Args)]
#[command(after_help = "Example: stillcut token --file tokens.toml --name anna --role engineer")]
pub(super) struct Arguments {
    /// File of tokens, as `http.tokens` names it; made with mode 600 where it is not there.
    #[arg(long, value_name = "FILE")]
    file: PathBuf,
    /// Whose token it is: letters, digits, `.`, `-`, `_`.
    #[arg(long)]
    name: String,
    /// viewer, operator or engineer.
    #[arg(long)]
    role: String,
    /// Days until it expires, 1 to 3650.
    #[arg(long, default_value_t = 365, value_parser = clap::value_parser!(u32).range(1..=3650))]
    days: u32,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    let plain = |c: char| c.is_ascii_alphanumeric() || ".-_".contains(c);
    if arguments.name.is_empty() || arguments.name.len() > 64 || !arguments.name.chars().all(plain) {
        return Err(bad_input(format!(
            "--name `{}` is not 1 to 64 letters, digits, `.`, `-`, `_`",
            arguments.name
        )));
    }
    let of_the_file = || Access::load(Some(&arguments.file), false);
    if holds_token(&arguments.name) || of_the_file().is_ok_and(|a| a.holds_secret(&[&arguments.name])) {
        return Err(bad_input("--name is a token itself; expected whose token it is: names go on record"));
    }
    let roles = [Role::Viewer, Role::Operator, Role::Engineer];
    let role = roles.into_iter().find(|r| r.word() == arguments.role).ok_or_else(|| {
        bad_input(format!("--role `{}` is not one of viewer, operator, engineer", arguments.role))
    })?;
    let names = token_names(&arguments.file).map_err(bad_input)?;
    let place = arguments.file.display();
    if names.contains(&arguments.name) {
        let what = "is there already; delete its entry first or choose another name";
        return Err(bad_input(format!("{place}: a token named `{}` {what}", arguments.name)));
    }
    let mut random = [0; 32];
    File::open("/dev/urandom").and_then(|mut f| f.read_exact(&mut random)).context("/dev/urandom")?;
    let (text, digest) = new_token(random);
    let expires =
        clock::rfc3339(clock::wall_ns().saturating_add(i64::from(arguments.days) * 86_400_000_000_000));
    let entry = format!(
        "{}[[token]]\nname = \"{}\"\nrole = \"{}\"\nsha256 = \"{digest}\"\nexpires = \"{expires}\"\n",
        if names.is_empty() { "" } else { "\n" },
        arguments.name,
        role.word()
    );
    let opened = File::options().create(true).append(true).mode(0o600).open(&arguments.file);
    let mut file = opened.map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => bad_input(format!("--file {place}: its folder is not there")),
        _ => bad_input(format!("--file {place}: {e}")),
    })?;
    file.write_all(entry.as_bytes()).and_then(|()| file.sync_all()).with_context(|| place.to_string())?;
    writeln!(std::io::stdout(), "{text}")?;
    Ok(())
}
