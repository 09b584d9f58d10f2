//! Where the service listens and whom it talks to: HTTP, MTConnect agents, the fleet's broker.

use super::{FleetConfig, FleetToml, HttpConfig, HttpToml, MtconnectToml, Reader};
use crate::config::ConfigError;
use std::net::{Ipv6Addr, SocketAddr};

impl Reader<'_> {
    /// SHDR knows no TLS and no token: who reaches the port reads along.
    pub(super) fn mtconnect(
        &self,
        raw: &MtconnectToml,
        http: SocketAddr,
    ) -> Result<Option<SocketAddr>, ConfigError> {
        let Some(listen) = &raw.listen else { return Ok(None) };
        let address = self.address("mtconnect.listen", listen)?;
        let everywhere = |a: SocketAddr| a.ip().is_unspecified();
        let meet = address.ip() == http.ip() || everywhere(address) || everywhere(http);
        if meet && address.port() == http.port() && address.port() != 0 {
            let what = format!("{address} is the port of http.listen: expected one of its own");
            return Err(self.bad("mtconnect.listen", what));
        }
        if !address.ip().is_loopback() && !raw.allow_remote {
            let what = format!("{address} is reachable by all: needs mtconnect.allow_remote = true");
            return Err(self.bad("mtconnect.listen", what));
        }
        Ok(Some(address))
    }

    pub(super) fn fleet(&self, raw: &FleetToml) -> Result<Option<FleetConfig>, ConfigError> {
        let Some(server) = &raw.server else {
            if raw.diagnose {
                return Err(self.bad("fleet.diagnose", "true: expected fleet.server beside it"));
            }
            return Ok(None);
        };
        if !cfg!(feature = "nats") {
            let what = "this program was built without NATS; build it with `--features nats`";
            return Err(self.bad("fleet.server", what));
        }
        if server.contains('@') {
            return Err(self.bad("fleet.server", "name and password belong into fleet.credentials"));
        }
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if raw.machine.is_empty() || raw.machine.len() > 60 || !raw.machine.chars().all(plain) {
            let what = format!("`{}`: expected 1 to 60 letters, digits, - and _", raw.machine);
            return Err(self.bad("fleet.machine", what));
        }
        Ok(Some(FleetConfig {
            server: server.clone(),
            credentials: raw.credentials.as_deref().map(|p| self.resolve(p)),
            machine: raw.machine.clone(),
            diagnose: raw.diagnose,
        }))
    }

    fn address(&self, place: &str, text: &str) -> Result<SocketAddr, ConfigError> {
        text.parse()
            .map_err(|_| self.bad(place, format!("`{text}` is not an address such as 127.0.0.1:8620")))
    }

    /// The name in `host` or `host:port`: whatever port stands in front of the service, the name decides.
    fn host(&self, text: &str) -> Result<String, ConfigError> {
        let (name, port) = match text.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
            Some((address, rest)) => (address, rest.strip_prefix(':').or(rest.is_empty().then_some("0"))),
            None => text.split_once(':').map_or((text, Some("0")), |(name, port)| (name, Some(port))),
        };
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        let labels = || name.split('.').all(|label| !label.is_empty() && label.chars().all(plain));
        let good = if text.starts_with('[') { name.parse::<Ipv6Addr>().is_ok() } else { labels() };
        if good && port.is_some_and(|p| p.parse::<u16>().is_ok()) {
            return Ok(name.to_owned());
        }
        let what = format!("`{text}` is not a host name such as lathe.example or lathe.example:8620");
        Err(self.bad("http.hosts", what))
    }

    pub(super) fn http(&self, raw: &HttpToml) -> Result<HttpConfig, ConfigError> {
        let listen = self.address("http.listen", &raw.listen)?;
        let tls = match (&raw.certificate, &raw.key) {
            (Some(certificate), Some(key)) => Some((self.resolve(certificate), self.resolve(key))),
            (None, None) => None,
            _ => return Err(self.bad("http", "certificate and key are needed together")),
        };
        let safe = listen.ip().is_loopback() || (tls.is_some() && raw.tokens.is_some());
        if !safe && !raw.allow_remote_without_tls {
            let what = "needs http.certificate, http.key and http.tokens, or allow_remote_without_tls = true";
            return Err(self.bad("http.listen", format!("{listen} is reachable from other machines: {what}")));
        }
        Ok(HttpConfig {
            listen,
            tls,
            tokens: raw.tokens.as_deref().map(|p| self.resolve(p)),
            hosts: raw.hosts.iter().map(|h| self.host(h)).collect::<Result<_, _>>()?,
            trust_loopback: false,
        })
    }
}
