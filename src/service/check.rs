//! Whether a configuration can be used, before anything is started.

use super::start::{ServiceError, access};
use crate::config::service::ServiceConfig;
use crate::http::tls_acceptor;
use crate::ownership;
use crate::store::PARTS;
use crate::transport::Domain;
use std::path::Path;

/// Whether what the configuration names can be used by `user`: tokens, certificate and key, shared memory
/// domain, and the places of the state. Changes nothing. Errors: what `start` would refuse, too.
pub fn check(config: &ServiceConfig, user: u32) -> Result<(), ServiceError> {
    access(config)?;
    config.http.tls.as_ref().map(|(c, k)| tls_acceptor(c, k)).transpose()?;
    Domain::new(&config.transport.0, &config.transport.1)?;
    let files = |path: &Path, source| ServiceError::Files { path: path.to_owned(), source };
    for folder in [&config.history.folder, &config.transport.1] {
        if folder.exists() && !folder.is_dir() {
            return Err(files(folder, std::io::ErrorKind::NotADirectory.into()));
        }
    }
    let state = &config.history.folder;
    let parts = PARTS.map(|name| state.join(name));
    for path in [state, &config.transport.1].into_iter().chain(&parts) {
        if let Err(source) = ownership::kept_by(user, path)
            && ownership::is_refusal(&source)
        {
            return Err(files(path, source));
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
