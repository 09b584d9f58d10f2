//! Whether a configuration can be used, before anything is started.

use super::start::{ServiceError, access};
use crate::config::service::ServiceConfig;
use crate::http::tls_acceptor;
use crate::ownership;
use crate::store::{FILES, RECORDINGS};
use crate::transport::Domain;
use std::path::Path;

/// Whether what the configuration names can be used by `user`: tokens, certificate and key, shared memory
/// domain, and the places of the state. Changes nothing. Errors: what `start` would refuse, too.
pub fn check(config: &ServiceConfig, user: u32) -> Result<(), ServiceError> {
    access(config)?;
    config.http.tls.as_ref().map(|(c, k)| tls_acceptor(c, k)).transpose()?;
    Domain::new(&config.transport.0, &config.transport.1)?;
    let files = |path: &Path, source| ServiceError::Files { path: path.to_owned(), source };
    // Whoever writes them sets the turret's limits.
    for path in [&config.file, &config.model].into_iter().flatten() {
        ownership::not_everybodys(path).map_err(|source| files(path, source))?;
    }
    if user != ownership::own_user() {
        let certificate = config.http.tls.as_ref().map(|(certificate, _)| certificate);
        let read = [config.file.as_ref(), config.model.as_ref(), certificate];
        for path in read.into_iter().flatten().chain([&config.history.folder, &config.transport.1]) {
            ownership::reachable_by(user, path).map_err(|source| files(path, source))?;
        }
    }
    let state = &config.history.folder;
    let parts = FILES.map(|name| state.join(name));
    let folders = [state, &config.transport.1, &state.join(RECORDINGS)];
    for path in folders.into_iter().chain(&parts) {
        let found = match ownership::kept_by(user, path) {
            Err(source) if ownership::is_refusal(&source) => return Err(files(path, source)),
            found => found.ok().flatten(),
        };
        let Some(found) = found else { continue };
        match folders.contains(&path) {
            true if !found.is_dir() => return Err(files(path, std::io::ErrorKind::NotADirectory.into())),
            false if !found.is_file() => return Err(files(path, ownership::no_file())),
            _ => {}
        }
    }
    let secrets = [config.http.tokens.as_ref(), config.http.tls.as_ref().map(|(_, key)| key)];
    for path in secrets.into_iter().flatten() {
        ownership::read_by(user, path).map_err(|source| files(path, source))?;
    }
    Ok(())
}

/// Whether nobody else holds a name of the shared memory domain against `user`. A start looks itself, when it
/// joins: this may be over at the next. Errors: the first such file, and whose it is.
pub fn check_shared_memory(config: &ServiceConfig, user: u32) -> Result<(), ServiceError> {
    Ok(Domain::new(&config.transport.0, &config.transport.1)?.refuse_foreign(user)?)
}

/// The user that the service will run as: this one, or, where root asks, who owns the history's folder, or
/// else the domain's.
#[must_use]
pub fn user_of(config: &ServiceConfig) -> u32 {
    ownership::user_of(&[&config.history.folder, &config.transport.1])
}
