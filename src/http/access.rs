//! Who may do what: bearer tokens, roles, and the brake on guessing.
//!
//! Reads are open on loopback. A right token is never held up by other people's wrong ones.

use super::problem::Problem;
use super::secrets::{holds_token, holds_token_of};
use super::token_file::{Changed, Role, Token, TokenFileError, changed, read_tokens};
use crate::service::clock;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use sha2::{Digest as _, Sha256};
use std::collections::HashMap;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use subtle::ConstantTimeEq as _;

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
/// Most addresses remembered; beyond it the oldest are forgotten.
const ADDRESSES: usize = 4096;

/// An instant of the monotonic clock, and the wall clock then.
type Clocks = (Instant, i64);

struct Loaded {
    tokens: Vec<Token>,
    changed: Option<Changed>,
    /// Tokens of operators that were in force last: where none is any more, these take the turret back, and
    /// nothing else, until it is.
    last_operators: Vec<Token>,
    /// Whether one ever was.
    had_operator: bool,
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

    /// Whether a token is in force that may take the turret back; notes which.
    fn has_operator(&mut self, now: Instant) -> bool {
        let good = self.tokens.iter().filter(|t| t.role >= Role::Operator && self.is_good(t, now));
        let good: Vec<Token> = good.cloned().collect();
        let any = !good.is_empty();
        if any {
            (self.last_operators, self.had_operator) = (good, true);
        }
        any
    }
}

/// The tokens and the memory of wrong ones.
pub struct Access {
    file: Option<PathBuf>,
    trust_loopback: bool,
    loaded: Mutex<Loaded>,
    /// When the file was looked at for the sake of an unknown token; held while it is.
    looked: Arc<tokio::sync::Mutex<Option<Instant>>>,
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
        let changed = file.and_then(changed); // before the look: a change meanwhile is seen at the next
        let tokens = file.map(read_tokens).transpose()?.unwrap_or_default();
        let (last_operators, had_operator) = (Vec::new(), false);
        let mut loaded = Loaded { tokens, changed, last_operators, had_operator, refused: None, read };
        loaded.has_operator(read.0);
        Ok(Self {
            file: file.map(Path::to_owned),
            trust_loopback,
            loaded: Mutex::new(loaded),
            looked: Arc::default(),
            guesses: Mutex::default(),
        })
    }

    fn loaded(&self) -> MutexGuard<'_, Loaded> {
        self.loaded.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Errors: there is a file of tokens, and none in it is good at this time.
    pub fn needs_a_good_token(&self, now: Instant) -> Result<(), TokenFileError> {
        let Some(path) = &self.file else { return Ok(()) };
        let loaded = self.loaded();
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
        let changed = changed(file);
        if changed == self.loaded().changed {
            return;
        }
        let read = read_tokens(file);
        let mut loaded = self.loaded();
        loaded.has_operator(clock::now());
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
        self.trust_loopback || self.loaded().has_operator(now)
    }

    /// Nothing is to be taken back any more: tokens that are not in force do not do it either.
    pub fn close_way_back(&self) {
        self.loaded().last_operators.clear();
    }

    /// Who takes the turret back with a token that was in force until none of an operator was.
    pub(crate) fn last_operator(&self, headers: &HeaderMap, now: Instant) -> Option<Caller> {
        let digest = digest_of(headers.get(header::AUTHORIZATION)?);
        let mut loaded = self.loaded();
        if loaded.has_operator(now) {
            return None;
        }
        let token = loaded.last_operators.iter().find(|t| bool::from(t.digest.ct_eq(&digest)))?;
        Some(Caller { name: token.name.clone(), role: Some(Role::Operator) })
    }

    /// What is wrong with the tokens: the file cannot be used, or nobody may take the turret back any more.
    /// One line; nothing where no file was asked for, or where it never named an operator.
    pub fn trouble(&self, now: Instant) -> Option<String> {
        let path = self.file.as_ref()?.display();
        let mut loaded = self.loaded();
        let none = !loaded.has_operator(now);
        let named = loaded.tokens.iter().any(|t| t.role >= Role::Operator);
        let told = match &loaded.refused {
            Some(refused) => Some(refused.clone()),
            None if loaded.tokens.is_empty() => Some(format!("http.tokens: {path}: holds no token")),
            None if none && named => {
                Some(format!("http.tokens: {path}: every token of an operator has expired"))
            }
            None if none && loaded.had_operator => {
                Some(format!("http.tokens: {path}: holds no token of an operator any more"))
            }
            None => None,
        };
        told.map(|what| format!("{what}; no token is in force that may take the turret back"))
    }

    /// Whether a text holds a token, by its form or by its hash.
    pub(crate) fn is_in(&self, text: &str) -> bool {
        let loaded = self.loaded();
        let known = |d: &[u8; 32]| loaded.tokens.iter().chain(&loaded.last_operators).any(|t| t.digest == *d);
        holds_token(text) || holds_token_of(text, known)
    }

    /// Whether any of these settings holds a token.
    #[must_use]
    pub fn holds_secret(&self, texts: &[&String]) -> bool {
        texts.iter().any(|text| self.is_in(text))
    }

    /// Looks at the file because somebody came with a token that is not known: it may have been added a
    /// moment ago. Whoever guesses makes one look at a time; who came before it began shares it.
    pub(crate) async fn look_again(self: &Arc<Self>, came: Instant) {
        if self.file.is_none() {
            return;
        }
        let mut looked = Arc::clone(&self.looked).lock_owned().await;
        if looked.is_some_and(|at| at > came) {
            return;
        }
        let access = Arc::clone(self);
        let look = tokio::task::spawn_blocking(move || {
            *looked = Some(clock::now());
            access.refresh();
        });
        drop(look.await);
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
        self.find(&digest_of(value), now)
    }

    fn without_token(&self, address: IpAddr) -> Caller {
        let name = "loopback".to_owned();
        match (address.is_loopback(), self.trust_loopback) {
            (true, true) => Caller { name, role: Some(Role::Engineer) },
            (true, false) => Caller { name, role: Some(Role::Viewer) },
            (false, _) => Caller { name: "stranger".to_owned(), role: None },
        }
    }

    fn find(&self, digest: &[u8; 32], now: Instant) -> Option<Caller> {
        let loaded = self.loaded();
        let valid = |t: &&Token| loaded.is_good(t, now) && bool::from(t.digest.ct_eq(digest));
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

/// SHA-256 of the token in a header.
fn digest_of(value: &HeaderValue) -> [u8; 32] {
    let token = value.to_str().ok().and_then(bearer).unwrap_or_default();
    Sha256::digest(token.as_bytes()).into()
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
    use super::super::token_file::new_token;
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
        let now = clock::now();
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
        let (empty, old, now) = (file(""), file(&entry(&hash)), clock::now());
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
        let now = clock::now();
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
        let now = clock::now();
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
        let now = clock::now();
        assert!(matches!(access.judge(&with(&one), FAR, now), Verdict::Known(_)));
        std::thread::sleep(Duration::from_millis(20));
        std::fs::write(file.path(), "").unwrap();
        access.refresh();
        assert_eq!(access.judge(&with(&one), FAR, now), Verdict::BadToken);
        assert!(access.trouble(now).is_some_and(|t| t.contains("holds no token")));
    }

    /// In `act` the file is spoilt: until the turret is back, who could take it back still can, and no more.
    #[test]
    fn who_could_take_the_turret_back_can_until_it_is() {
        let (anna, hash) = new_token([1; 32]);
        let (eve, _) = new_token([2; 32]);
        let entry =
            |role: &str| format!("[[token]]\nname = \"anna\"\nrole = \"{role}\"\nsha256 = \"{hash}\"\n");
        let mode = |f: &tempfile::NamedTempFile, m| {
            std::fs::set_permissions(f.path(), std::fs::Permissions::from_mode(m)).unwrap();
        };
        let spoilt: [&dyn Fn(&tempfile::NamedTempFile); 4] = [
            &|f| mode(f, 0o644),
            &|f| std::fs::remove_file(f.path()).unwrap(),
            &|f| std::fs::write(f.path(), "").unwrap(),
            &|f| std::fs::write(f.path(), entry("viewer")).unwrap(),
        ];
        for spoil in spoilt {
            let file = file(&entry("engineer"));
            let access = Access::load(Some(file.path()), false).unwrap();
            let now = clock::now();
            assert_eq!(access.last_operator(&with(&anna), now), None, "the token itself is in force");
            std::thread::sleep(Duration::from_millis(10));
            spoil(&file);
            access.refresh();
            assert!(!access.way_back(now) && access.trouble(now).is_some());
            let may = |c: Option<Caller>| c.is_some_and(|c| c.role >= Some(Role::Operator));
            assert!(!may(access.caller(&with(&anna), NEAR, now)), "nothing else");
            let back = access.last_operator(&with(&anna), now).expect("takes it back");
            assert_eq!(back, Caller { name: "anna".to_owned(), role: Some(Role::Operator) });
            assert_eq!(access.last_operator(&with(&eve), now), None);
            assert!(access.is_in(&anna), "still a secret");
            access.close_way_back();
            assert_eq!(access.last_operator(&with(&anna), now), None, "it is back");
            let _ = std::fs::write(file.path(), ""); // for its own removal
        }
    }

    #[tokio::test]
    async fn a_token_that_was_added_a_moment_ago_is_known_whoever_guessed_before() {
        let (anna, hash) = new_token([1; 32]);
        let file = file("");
        let access = Arc::new(Access::load(Some(file.path()), false).unwrap());
        access.look_again(clock::now()).await;
        let entry = format!("[[token]]\nname = \"anna\"\nrole = \"operator\"\nsha256 = \"{hash}\"\n");
        std::fs::write(file.path(), entry).unwrap();
        access.look_again(clock::now()).await;
        assert!(access.caller(&with(&anna), FAR, clock::now()).is_some());
    }

    #[test]
    fn the_way_back_ends_with_the_last_operators_token() {
        let (_, hash) = new_token([1; 32]);
        let entry = |role: &str, expires: &str| {
            format!("[[token]]\nname = \"n\"\nrole = \"{role}\"\nsha256 = \"{hash}\"\n{expires}")
        };
        let expiry = clock::parse_rfc3339("2026-01-01T00:00:00Z").unwrap();
        let expires = "expires = \"2026-01-01T00:00:00Z\"\n";
        let now = clock::now();
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
