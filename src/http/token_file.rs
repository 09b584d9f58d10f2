//! The file of tokens: who has one, of which role, and until when.
//!
//! A token is 256 random bits; the file holds its SHA-256, so the file is no use to a thief.

use super::secrets::{PREFIX, holds_token};
use crate::service::clock;
use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use serde::Deserialize;
use sha2::{Digest as _, Sha256};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// What a caller may do; each role includes the ones before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Read.
    Viewer,
    /// Acknowledge, silence, take the turret back, lower the mode.
    Operator,
    /// Raise the mode, clear faults, start diagnoses.
    Engineer,
}

impl Role {
    /// The word that stands for it.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Viewer => "viewer",
            Self::Operator => "operator",
            Self::Engineer => "engineer",
        }
    }
}

/// Why a token file is not one. One line.
#[derive(Debug, Error)]
pub enum TokenFileError {
    /// Cannot be read.
    #[error("http.tokens: {}: {source}; {}", path.display(), mend(source))]
    Read {
        /// File.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Others than the owner may read it.
    #[error("http.tokens: {}: mode {mode:03o} lets others read it; expected 600", path.display())]
    Open {
        /// File.
        path: PathBuf,
        /// Permission bits.
        mode: u32,
    },
    /// Nobody could come from another machine.
    #[error(
        "http.tokens: {}: no token that is good now, and the service listens for other machines; \
         `stillcut token --file FILE` makes one",
        path.display()
    )]
    NoneGood {
        /// File.
        path: PathBuf,
    },
    /// A setting that goes on record holds a token.
    #[error("{0}: holds an access token; the record is open to more people than the token")]
    InSetting(&'static str),
    /// Its content is not a list of tokens.
    #[error("{}: {message}", path.display())]
    Content {
        /// File.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
}

/// What a person does about a file that cannot be read.
fn mend(source: &std::io::Error) -> &'static str {
    match source.kind() {
        ErrorKind::NotFound => "`stillcut token --file FILE` makes one",
        ErrorKind::PermissionDenied => "it must be the service's user's own, of mode 600",
        _ => "expected a file of tokens, as `stillcut token` makes it",
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TokenToml {
    name: String,
    role: Role,
    sha256: String,
    #[serde(default)]
    expires: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TokenFileToml {
    #[serde(default)]
    token: Vec<TokenToml>,
}

#[derive(Debug, Clone)]
pub(super) struct Token {
    pub(super) name: String,
    pub(super) role: Role,
    pub(super) digest: [u8; 32],
    pub(super) expires_ns: Option<i64>,
}

/// Permission bits of a file of secrets that others than its owner may read; nothing where none may.
/// Errors: it cannot be looked at.
pub(super) fn open_to_others(path: &Path) -> std::io::Result<Option<u32>> {
    use std::os::unix::fs::PermissionsExt as _;
    let mode = std::fs::metadata(path)?.permissions().mode() & 0o777;
    Ok((mode & 0o077 != 0).then_some(mode))
}

pub(super) fn read_tokens(path: &Path) -> Result<Vec<Token>, TokenFileError> {
    let read = |source| TokenFileError::Read { path: path.to_owned(), source };
    let content = |message: String| TokenFileError::Content { path: path.to_owned(), message };
    if std::fs::metadata(path).map_err(read)?.is_dir() {
        return Err(read(ErrorKind::IsADirectory.into()));
    }
    if let Some(mode) = open_to_others(path).map_err(read)? {
        return Err(TokenFileError::Open { path: path.to_owned(), mode });
    }
    let text = std::fs::read_to_string(path).map_err(read)?;
    // The parser's message quotes the line; a digest in it would do no harm, a pasted token would.
    let file: TokenFileToml = toml::from_str(&text).map_err(|e| content(e.message().replace('\n', " ")))?;
    file.token.into_iter().map(|t| token_from_toml(t).map_err(content)).collect()
}

/// Names in a file of tokens; none where there is no file yet. Errors: it is no such file.
pub fn token_names(path: &Path) -> Result<Vec<String>, TokenFileError> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    Ok(read_tokens(path)?.into_iter().map(|token| token.name).collect())
}

fn token_from_toml(raw: TokenToml) -> Result<Token, String> {
    if holds_token(&raw.name) {
        return Err("a name holds a token; names go on record".to_owned());
    }
    let digest = digest_from_hex(&raw.sha256)
        .ok_or_else(|| format!("token {}: sha256 is not 64 hexadecimal digits", raw.name))?;
    let expires_ns = match raw.expires {
        Some(text) => Some(
            clock::parse_rfc3339(&text)
                .ok_or_else(|| format!("token {}: expires is not an RFC 3339 time", raw.name))?,
        ),
        None => None,
    };
    Ok(Token { name: raw.name, role: raw.role, digest, expires_ns })
}

fn digest_from_hex(text: &str) -> Option<[u8; 32]> {
    let mut digest = [0; 32];
    if text.len() != 64 || !text.is_ascii() {
        return None;
    }
    for (index, byte) in digest.iter_mut().enumerate() {
        *byte = u8::from_str_radix(text.get(2 * index..2 * index + 2)?, 16).ok()?;
    }
    Some(digest)
}

/// A new token: its text, which nobody stores, and the SHA-256 that the file holds.
#[must_use]
pub fn new_token(random: [u8; 32]) -> (String, String) {
    let text = format!("{PREFIX}{}", URL_SAFE_NO_PAD.encode(random));
    let digest = Sha256::digest(text.as_bytes());
    (text, digest.iter().map(|b| format!("{b:02x}")).collect())
}

/// What shows that a file is another one: instant of the last change, size, number.
pub(super) type Changed = (i64, i64, u64, u64);

/// When the content, the owner or the mode of the file changed last: mending its mode counts too. That clock
/// ticks in milliseconds; another file in the same tick has another number or size.
pub(super) fn changed(file: &Path) -> Option<Changed> {
    use std::os::unix::fs::MetadataExt as _;
    std::fs::metadata(file).map(|m| (m.ctime(), m.ctime_nsec(), m.size(), m.ino())).ok()
}
