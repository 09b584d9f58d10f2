//! Who may do what: bearer tokens, roles, and the brake on guessing.
//!
//! A token is 256 random bits; the file holds its SHA-256, so the file is no use to a thief. Reads are
//! open on loopback. A right token is never held up by other people's wrong ones.

use super::problem::Problem;
use super::secrets::{PREFIX, holds_token, holds_token_of};
use crate::service::clock;
use axum::http::{HeaderMap, StatusCode, header};
use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use serde::Deserialize;
use sha2::{Digest as _, Sha256};
use std::collections::HashMap;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use subtle::ConstantTimeEq as _;
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
    #[error("http.tokens: {}: {source}; `stillcut token --file FILE` makes one", path.display())]
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
struct Token {
    name: String,
    role: Role,
    digest: [u8; 32],
    expires_ns: Option<i64>,
}

/// Permission bits of a file of secrets that others than its owner may read; nothing where none may.
/// Errors: it cannot be looked at.
pub(super) fn open_to_others(path: &Path) -> std::io::Result<Option<u32>> {
    use std::os::unix::fs::PermissionsExt as _;
    let mode = std::fs::metadata(path)?.permissions().mode() & 0o777;
    Ok((mode & 0o077 != 0).then_some(mode))
}

fn read_tokens(path: &Path) -> Result<Vec<Token>, TokenFileError> {
    let read = |source| TokenFileError::Read { path: path.to_owned(), source };
    let content = |message: String| TokenFileError::Content { path: path.to_owned(), message };
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

/// Who is calling.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Caller {
    /// Name of the token, or `loopback`.
    pub name: String,
    /// What the caller may do; none for a stranger.
    pub role: Option<Role>,
}

/// Tokens that are not good within this time count against an address.
const GUESS_WINDOW: Duration = Duration::from_secs(60);
const GUESSES: usize = 5;
/// Between two looks at the file for the sake of unknown tokens.
const LOOK_AGAIN: Duration = Duration::from_millis(100);
/// Most addresses remembered; beyond it the oldest are forgotten.
const ADDRESSES: usize = 4096;

/// An instant of the monotonic clock, and the wall clock then.
type Clocks = (Instant, i64);

struct Loaded {
    tokens: Vec<Token>,
    changed: Option<(i64, i64)>,
    /// Why no token of the file is in force.
    refused: Option<String>,
    /// When the tokens were read.
    read: Clocks,
}

impl Loaded {
    /// Whether a token has not expired, by the wall clock when it was read and the time since: a wall clock
    /// that jumps neither ends nor revives it.
    fn is_good(&self, token: &Token, now: Instant) -> bool {
        let (read, wall_ns) = self.read;
        let passed_ns = now.saturating_duration_since(read).as_nanos();
        let now_ns = wall_ns.saturating_add(i64::try_from(passed_ns).unwrap_or(i64::MAX));
        token.expires_ns.is_none_or(|e| now_ns < e)
    }
}

/// The tokens and the memory of wrong ones.
pub struct Access {
    file: Option<PathBuf>,
    trust_loopback: bool,
    loaded: Mutex<Loaded>,
    /// When the file was looked at for the sake of an unknown token.
    asked_again: Mutex<Option<Instant>>,
    guesses: Mutex<HashMap<IpAddr, Vec<Instant>>>,
}

impl std::fmt::Debug for Access {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Access").field("file", &self.file).finish_non_exhaustive()
    }
}

/// What became of the look at a request's token.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Verdict {
    Known(Caller),
    BadToken,
    RateLimited,
}

impl Access {
    /// Reads the token file, where there is one. `trust_loopback`: loopback needs no token at all (demo).
    /// Errors: the file is not what it should be.
    pub fn load(file: Option<&Path>, trust_loopback: bool) -> Result<Self, TokenFileError> {
        Self::load_at(file, trust_loopback, (clock::now(), clock::wall_ns()))
    }

    fn load_at(file: Option<&Path>, trust_loopback: bool, read: Clocks) -> Result<Self, TokenFileError> {
        let tokens = file.map(read_tokens).transpose()?.unwrap_or_default();
        let changed = file.and_then(changed);
        let loaded = Loaded { tokens, changed, refused: None, read };
        Ok(Self {
            file: file.map(Path::to_owned),
            trust_loopback,
            loaded: Mutex::new(loaded),
            asked_again: Mutex::default(),
            guesses: Mutex::default(),
        })
    }

    /// Errors: there is a file of tokens, and none in it is good at this time.
    pub fn needs_a_good_token(&self, now: Instant) -> Result<(), TokenFileError> {
        let Some(path) = &self.file else { return Ok(()) };
        let loaded = self.loaded.lock().unwrap_or_else(PoisonError::into_inner);
        match loaded.tokens.iter().any(|t| loaded.is_good(t, now)) {
            true => Ok(()),
            false => Err(TokenFileError::NoneGood { path: path.clone() }),
        }
    }

    /// Takes a changed file into use. One that is gone, cannot be read or that others may read leaves no
    /// token in force. One whose content is no list of tokens changes nothing: it may be half written.
    /// Reads the disk: not for the thread that answers requests.
    pub fn refresh(&self) {
        let Some(file) = &self.file else { return };
        let lock = || self.loaded.lock().unwrap_or_else(PoisonError::into_inner);
        let changed = changed(file);
        if changed == lock().changed {
            return;
        }
        let read = read_tokens(file);
        let mut loaded = lock();
        loaded.changed = changed;
        match read {
            Ok(tokens) => {
                tracing::info!(event = "token_file", tokens = tokens.len(), "taken into use");
                loaded.tokens = tokens;
                loaded.refused = None;
                loaded.read = (clock::now(), clock::wall_ns());
            }
            Err(error @ TokenFileError::Content { .. }) => {
                tracing::error!(event = "token_file", "{error}; the tokens in force stay");
            }
            Err(error) => {
                tracing::error!(event = "token_file", "{error}; no token is in force until it is mended");
                loaded.tokens.clear();
                loaded.refused = Some(error.to_string());
            }
        }
    }

    /// Whether a token is in force that may take the turret back; where loopback is trusted, none is needed.
    pub fn way_back(&self, now: Instant) -> bool {
        let loaded = self.loaded.lock().unwrap_or_else(PoisonError::into_inner);
        self.trust_loopback
            || loaded.tokens.iter().any(|t| t.role >= Role::Operator && loaded.is_good(t, now))
    }

    /// What is wrong with the tokens: the file cannot be used, or nobody may take the turret back any more.
    /// One line; nothing where no file was asked for, or where it never named an operator.
    pub fn trouble(&self, now: Instant) -> Option<String> {
        let path = self.file.as_ref()?.display();
        let loaded = self.loaded.lock().unwrap_or_else(PoisonError::into_inner);
        let operators = || loaded.tokens.iter().filter(|t| t.role >= Role::Operator);
        let expired = operators().next().is_some() && !operators().any(|t| loaded.is_good(t, now));
        let told = match &loaded.refused {
            Some(refused) => Some(refused.clone()),
            None if loaded.tokens.is_empty() => Some(format!("http.tokens: {path}: holds no token")),
            None if expired => Some(format!("http.tokens: {path}: every token of an operator has expired")),
            None => None,
        };
        told.map(|what| format!("{what}; no token is in force that may take the turret back"))
    }

    /// Whether a text holds a token, by its form or by its hash.
    pub(crate) fn is_in(&self, text: &str) -> bool {
        let loaded = self.loaded.lock().unwrap_or_else(PoisonError::into_inner);
        holds_token(text) || holds_token_of(text, |d| loaded.tokens.iter().any(|t| t.digest == *d))
    }

    /// Whether any of these settings holds a token.
    #[must_use]
    pub fn holds_secret(&self, texts: &[&String]) -> bool {
        texts.iter().any(|text| self.is_in(text))
    }

    /// Whether it is time to look at the file because somebody came with a token that is not known: it may
    /// have been added a moment ago. Whoever guesses makes no more looks than this.
    pub(crate) fn looks_again(&self, now: Instant) -> bool {
        let mut asked = self.asked_again.lock().unwrap_or_else(PoisonError::into_inner);
        let due = asked.is_none_or(|t| now.duration_since(t) >= LOOK_AGAIN);
        if due {
            *asked = Some(now);
        }
        due && self.file.is_some()
    }

    pub(crate) fn judge(&self, headers: &HeaderMap, address: IpAddr, now: Instant) -> Verdict {
        match self.caller(headers, address, now) {
            Some(caller) => Verdict::Known(caller),
            None if self.count_guess(address, now) => Verdict::BadToken,
            None => Verdict::RateLimited,
        }
    }

    /// Who it is now, where the token is good or none is needed. Counts no guess.
    pub(crate) fn caller(&self, headers: &HeaderMap, address: IpAddr, now: Instant) -> Option<Caller> {
        let Some(value) = headers.get(header::AUTHORIZATION) else {
            return Some(self.without_token(address));
        };
        self.find(value.to_str().ok().and_then(bearer).unwrap_or_default(), now)
    }

    fn without_token(&self, address: IpAddr) -> Caller {
        let name = "loopback".to_owned();
        match (address.is_loopback(), self.trust_loopback) {
            (true, true) => Caller { name, role: Some(Role::Engineer) },
            (true, false) => Caller { name, role: Some(Role::Viewer) },
            (false, _) => Caller { name: "stranger".to_owned(), role: None },
        }
    }

    fn find(&self, text: &str, now: Instant) -> Option<Caller> {
        let digest: [u8; 32] = Sha256::digest(text.as_bytes()).into();
        let loaded = self.loaded.lock().unwrap_or_else(PoisonError::into_inner);
        let valid = |t: &&Token| loaded.is_good(t, now) && bool::from(t.digest.ct_eq(&digest));
        let token = loaded.tokens.iter().find(valid)?;
        Some(Caller { name: token.name.clone(), role: Some(token.role) })
    }

    /// Remembers a wrong token; false when the address had too many.
    fn count_guess(&self, address: IpAddr, now: Instant) -> bool {
        let mut guesses = self.guesses.lock().unwrap_or_else(PoisonError::into_inner);
        if guesses.len() >= ADDRESSES {
            guesses.retain(|_, times| times.last().is_some_and(|t| now.duration_since(*t) < GUESS_WINDOW));
        }
        if guesses.len() >= ADDRESSES && !guesses.contains_key(&address) {
            return false;
        }
        let times = guesses.entry(address).or_default();
        times.retain(|t| now.duration_since(*t) < GUESS_WINDOW);
        if times.len() >= GUESSES {
            return false;
        }
        times.push(now);
        true
    }
}

/// The token of `Bearer TOKEN`; the scheme in any case, as RFC 9110 has it.
fn bearer(value: &str) -> Option<&str> {
    let (scheme, token) = value.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then_some(token)
}

/// When the content, the owner or the mode of the file changed last: mending its mode counts too.
fn changed(file: &Path) -> Option<(i64, i64)> {
    use std::os::unix::fs::MetadataExt as _;
    std::fs::metadata(file).map(|m| (m.ctime(), m.ctime_nsec())).ok()
}

impl Caller {
    /// Nothing when the caller may; else 401 (no token) or 403 (a lesser role).
    pub(crate) fn require(&self, role: Role) -> Result<(), Problem> {
        match self.role {
            Some(own) if own >= role => Ok(()),
            Some(_) if self.name != "loopback" => Err(Problem::new(
                StatusCode::FORBIDDEN,
                "role_too_low",
                format!("this needs the role {}", role.word()),
            )),
            _ => Err(Problem::new(
                StatusCode::UNAUTHORIZED,
                "token_required",
                format!("this needs a token of role {} in the header Authorization: Bearer", role.word()),
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::Ipv4Addr;
    use std::os::unix::fs::PermissionsExt as _;

    const FAR: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 0, 0, 9));
    const NEAR: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);

    fn with(token: &str) -> HeaderMap {
        let mut headers = HeaderMap::new();
        headers.insert(header::AUTHORIZATION, format!("Bearer {token}").parse().unwrap());
        headers
    }

    fn file(text: &str) -> tempfile::NamedTempFile {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        std::fs::set_permissions(file.path(), std::fs::Permissions::from_mode(0o600)).unwrap();
        file
    }

    #[test]
    fn roles_expiry_and_strangers() {
        let (anna, anna_hash) = new_token([1; 32]);
        let (old, old_hash) = new_token([2; 32]);
        let text = format!(
            "[[token]]\nname = \"anna\"\nrole = \"operator\"\nsha256 = \"{anna_hash}\"\n\
             [[token]]\nname = \"old\"\nrole = \"engineer\"\nsha256 = \"{old_hash}\"\n\
             expires = \"2026-01-01T00:00:00Z\"\n"
        );
        let file = file(&text);
        let now = Instant::now();
        let wall = clock::parse_rfc3339("2026-06-01T00:00:00Z").unwrap();
        let access = Access::load_at(Some(file.path()), false, (now, wall)).unwrap();
        let Verdict::Known(caller) = access.judge(&with(&anna), FAR, now) else { panic!("known") };
        assert!(caller.require(Role::Operator).is_ok());
        assert_eq!(caller.require(Role::Engineer).unwrap_err().status, 403);
        assert_eq!(access.judge(&with(&old), FAR, now), Verdict::BadToken, "expired");
        let Verdict::Known(near) = access.judge(&HeaderMap::new(), NEAR, now) else { panic!("known") };
        assert!(near.require(Role::Viewer).is_ok());
        assert_eq!(near.require(Role::Operator).unwrap_err().status, 401);
        let Verdict::Known(far) = access.judge(&HeaderMap::new(), FAR, now) else { panic!("known") };
        assert_eq!(far.require(Role::Viewer).unwrap_err().status, 401);
    }

    #[test]
    fn a_file_without_a_good_token_is_told() {
        let hash = new_token([1; 32]).1;
        let entry = |h: &str| {
            format!(
                "[[token]]\nname = \"n\"\nrole = \"viewer\"\nsha256 = \"{h}\"\n\
                 expires = \"2026-01-01T00:00:00Z\"\n"
            )
        };
        let expiry = clock::parse_rfc3339("2026-01-01T00:00:00Z").unwrap();
        let (empty, old, now) = (file(""), file(&entry(&hash)), Instant::now());
        let load = |f: &tempfile::NamedTempFile, wall_ns| {
            Access::load_at(Some(f.path()), false, (now, wall_ns)).unwrap()
        };
        assert!(load(&empty, expiry).needs_a_good_token(now).is_err());
        assert!(load(&old, expiry).needs_a_good_token(now).is_err());
        assert!(load(&old, expiry - 1).needs_a_good_token(now).is_ok());
        // What counts is the time since the file was read, whatever the wall clock says by now.
        let access = load(&old, expiry - 10_000_000_000);
        assert!(access.needs_a_good_token(now + Duration::from_secs(9)).is_ok());
        assert!(access.needs_a_good_token(now + Duration::from_secs(10)).is_err());
    }

    #[test]
    fn guessing_is_braked_but_never_a_right_token() {
        let (anna, hash) = new_token([1; 32]);
        let file = file(&format!("[[token]]\nname = \"anna\"\nrole = \"operator\"\nsha256 = \"{hash}\"\n"));
        let access = Access::load(Some(file.path()), false).unwrap();
        let now = Instant::now();
        for _ in 0..5 {
            assert_eq!(access.judge(&with("guess"), FAR, now), Verdict::BadToken);
        }
        assert_eq!(access.judge(&with("guess"), FAR, now), Verdict::RateLimited);
        assert!(matches!(access.judge(&with(&anna), FAR, now), Verdict::Known(_)));
        let later = now + Duration::from_secs(61);
        assert_eq!(access.judge(&with("guess"), FAR, later), Verdict::BadToken);
    }

    #[test]
    fn a_file_that_others_can_read_is_refused() {
        let file = file("");
        std::fs::set_permissions(file.path(), std::fs::Permissions::from_mode(0o644)).unwrap();
        let error = Access::load(Some(file.path()), false).unwrap_err().to_string();
        assert!(error.contains("mode 644"), "{error}");
    }

    #[test]
    fn tokens_rotate_without_a_restart() {
        let (one, one_hash) = new_token([1; 32]);
        let (two, two_hash) = new_token([2; 32]);
        let entry = |h: &str| format!("[[token]]\nname = \"n\"\nrole = \"viewer\"\nsha256 = \"{h}\"\n");
        let file = file(&entry(&one_hash));
        let access = Access::load(Some(file.path()), false).unwrap();
        let now = Instant::now();
        assert!(matches!(access.judge(&with(&one), FAR, now), Verdict::Known(_)));
        std::fs::write(file.path(), entry(&two_hash)).unwrap();
        let mode = |m| std::fs::set_permissions(file.path(), std::fs::Permissions::from_mode(m)).unwrap();
        // Others can read it: no token is in force until the mode is mended, without any further touch.
        mode(0o644);
        access.refresh();
        assert!(access.trouble(now).is_some_and(|t| t.contains("mode 644")));
        assert_eq!(access.judge(&with(&one), FAR, now), Verdict::BadToken);
        std::thread::sleep(Duration::from_millis(20));
        mode(0o600);
        access.refresh();
        assert_eq!(access.trouble(now), None);
        assert!(matches!(access.judge(&with(&two), FAR, now), Verdict::Known(_)));
        assert_eq!(access.judge(&with(&one), FAR, now), Verdict::BadToken, "revoked");
        // Half written: what is in force stays.
        std::thread::sleep(Duration::from_millis(20));
        std::fs::write(file.path(), "[[token]]\nname = ").unwrap();
        access.refresh();
        assert!(matches!(access.judge(&with(&two), FAR, now), Verdict::Known(_)));
        std::fs::remove_file(file.path()).unwrap();
        access.refresh();
        assert!(access.trouble(now).is_some());
        assert_eq!(access.judge(&with(&two), NEAR, now), Verdict::BadToken, "the file is gone");
    }

    #[test]
    fn a_file_that_is_blanked_revokes_every_token() {
        let (one, hash) = new_token([1; 32]);
        let file = file(&format!("[[token]]\nname = \"n\"\nrole = \"viewer\"\nsha256 = \"{hash}\"\n"));
        let access = Access::load(Some(file.path()), false).unwrap();
        let now = Instant::now();
        assert!(matches!(access.judge(&with(&one), FAR, now), Verdict::Known(_)));
        std::thread::sleep(Duration::from_millis(20));
        std::fs::write(file.path(), "").unwrap();
        access.refresh();
        assert_eq!(access.judge(&with(&one), FAR, now), Verdict::BadToken);
        assert!(access.trouble(now).is_some_and(|t| t.contains("holds no token")));
    }

    #[test]
    fn the_way_back_ends_with_the_last_operators_token() {
        let (_, hash) = new_token([1; 32]);
        let entry = |role: &str, expires: &str| {
            format!("[[token]]\nname = \"n\"\nrole = \"{role}\"\nsha256 = \"{hash}\"\n{expires}")
        };
        let expiry = clock::parse_rfc3339("2026-01-01T00:00:00Z").unwrap();
        let expires = "expires = \"2026-01-01T00:00:00Z\"\n";
        let now = Instant::now();
        let load =
            |text: &str| Access::load_at(Some(file(text).path()), false, (now, expiry - 1_000_000_000));
        let later = now + Duration::from_secs(1);
        let operator = load(&entry("operator", expires)).unwrap();
        assert!(operator.way_back(now) && operator.trouble(now).is_none());
        assert!(!operator.way_back(later) && operator.trouble(later).is_some_and(|t| t.contains("expired")));
        let engineer = load(&(entry("operator", expires) + &entry("engineer", ""))).unwrap();
        assert!(engineer.way_back(later) && engineer.trouble(later).is_none());
        let viewer = load(&entry("viewer", "")).unwrap();
        assert!(!viewer.way_back(now) && viewer.trouble(now).is_none(), "nobody was ever to act");
        assert!(Access::load(None, true).unwrap().way_back(now));
        assert!(!Access::load(None, false).unwrap().way_back(now));
    }
}
