//! The accept loop: caps, head deadline, TLS, and an end that does not wait for idle listeners.

use super::PeerAddress;
use super::refusals::Worded;
use super::seats::{Activity, Prompt, Seats, WRITE_DEADLINE};
use super::token_file::open_to_others;
use crate::telemetry::Metrics;
use axum::Router;
use hyper::body::Body as _;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::TlsAcceptor;
use tokio_util::sync::CancellationToken;
use tower::ServiceExt as _;

/// Most connections at once.
const CONNECTIONS: usize = 256;
/// A request's head must be there within this time.
const HEAD_DEADLINE: Duration = Duration::from_secs(5);
/// Largest head of a request.
const HEAD_BYTES: usize = 16 * 1024;
const HEADERS: usize = 64;
/// How long open requests may go on once the service stops.
const DRAIN: Duration = Duration::from_secs(3);
/// A TLS handshake that takes longer is ended.
const TLS_DEADLINE: Duration = Duration::from_secs(5);

/// A longer answer keeps its connection busy until it has gone.
const SHORT: u64 = 256 * 1024;

/// Why TLS cannot be set up. One line.
#[derive(Debug, Error)]
pub enum TlsError {
    /// A file cannot be read.
    #[error("http.certificate and http.key: {}: {source}; expected a file that this user may read", path.display())]
    Read {
        /// File.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Others than the owner may read the key.
    #[error("http.key: {}: mode {mode:03o} lets others read it; expected 600", path.display())]
    Open {
        /// File.
        path: PathBuf,
        /// Permission bits.
        mode: u32,
    },
    /// The file holds no certificate or key.
    #[error(
        "http.certificate and http.key: {}: no {what} in PEM form; expected lines from -----BEGIN on",
        path.display()
    )]
    Missing {
        /// File.
        path: PathBuf,
        /// `certificate` or `private key`.
        what: &'static str,
    },
    /// Certificate and key do not work together.
    #[error(
        "http.certificate and http.key: {} with {}: {source}; expected the key of this certificate",
        path.display(),
        key.display()
    )]
    Unusable {
        /// Certificate file.
        path: PathBuf,
        /// Key file.
        key: PathBuf,
        /// What rustls said.
        source: rustls::Error,
    },
}

/// TLS 1.2 and 1.3 with the certificate chain and key of two PEM files.
/// Errors: a file cannot be read, holds no such thing, or others may read the key.
pub fn tls_acceptor(certificate: &Path, key: &Path) -> Result<TlsAcceptor, TlsError> {
    let open = |path: &Path| {
        let bytes = std::fs::read(path).map_err(|source| TlsError::Read { path: path.to_owned(), source })?;
        Ok::<_, TlsError>(std::io::Cursor::new(bytes))
    };
    let chain: Vec<_> = rustls_pemfile::certs(&mut open(certificate)?).flatten().collect();
    if chain.is_empty() {
        return Err(TlsError::Missing { path: certificate.to_owned(), what: "certificate" });
    }
    let unreadable = |source| TlsError::Read { path: key.to_owned(), source };
    if let Some(mode) = open_to_others(key).map_err(unreadable)? {
        return Err(TlsError::Open { path: key.to_owned(), mode });
    }
    let key_der = rustls_pemfile::private_key(&mut open(key)?)
        .map_err(unreadable)?
        .ok_or_else(|| TlsError::Missing { path: key.to_owned(), what: "private key" })?;
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let unusable = |source| TlsError::Unusable { path: certificate.to_owned(), key: key.to_owned(), source };
    let mut config = rustls::ServerConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(unusable)?
        .with_no_client_auth()
        .with_single_cert(chain, key_der)
        .map_err(unusable)?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(TlsAcceptor::from(Arc::new(config)))
}

/// Serves until `stop`, then lets open requests end for three seconds.
pub async fn serve(
    listener: TcpListener,
    router: Router,
    tls: Option<TlsAcceptor>,
    (metrics, stop): (Arc<Metrics>, CancellationToken),
) {
    let seats = Seats::new(CONNECTIONS);
    let graceful = Arc::new(GracefulShutdown::new());
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            () = stop.cancelled() => break,
        };
        let (stream, address) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                // Out of descriptors: let some close instead of spinning.
                tracing::warn!(event = "accept_failed", "{error}");
                tokio::time::sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        let Some(seat) = seats.take() else {
            metrics.http_refused.with_label_values(&["connections"]).inc();
            continue; // dropped: the client sees the connection close
        };
        let (router, tls, metrics) = (router.clone(), tls.clone(), Arc::clone(&metrics));
        let watcher = graceful.watcher();
        tokio::spawn(async move {
            metrics.http_connections.inc();
            let given_up = seat.given_up();
            tokio::select! {
                () = connection(stream, address, (router, tls, watcher, seat.activity())) => {}
                () = given_up.cancelled() => metrics.http_refused.with_label_values(&["idle"]).inc(),
            }
            metrics.http_connections.dec();
            drop(seat);
        });
    }
    drop(listener);
    if let Some(graceful) = Arc::into_inner(graceful) {
        let _ = tokio::time::timeout(DRAIN, graceful.shutdown()).await;
    }
}

type Parts = (Router, Option<TlsAcceptor>, hyper_util::server::graceful::Watcher, Arc<Activity>);

async fn connection(stream: TcpStream, address: SocketAddr, (router, tls, watcher, activity): Parts) {
    let _ = stream.set_nodelay(true);
    let stream = Prompt::new(stream, WRITE_DEADLINE);
    match tls {
        None => requests(stream, (address, activity), router, watcher).await,
        Some(acceptor) => {
            // A failed or slow handshake is the client's affair.
            if let Ok(Ok(stream)) = tokio::time::timeout(TLS_DEADLINE, acceptor.accept(stream)).await {
                requests(stream, (address, activity), router, watcher).await;
            }
        }
    }
}

async fn requests(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    (address, activity): (SocketAddr, Arc<Activity>),
    router: Router,
    watcher: hyper_util::server::graceful::Watcher,
) {
    let service = tower::service_fn(move |mut request: hyper::Request<hyper::body::Incoming>| {
        activity.begin();
        request.extensions_mut().insert(PeerAddress(address));
        let (router, activity) = (router.clone(), Arc::clone(&activity));
        async move {
            let response = router.oneshot(request.map(axum::body::Body::new)).await;
            // A stream or download goes on; a short answer leaves the connection idle.
            let short =
                |r: &axum::response::Response| r.body().size_hint().exact().is_some_and(|n| n < SHORT);
            if response.as_ref().is_ok_and(short) {
                activity.end();
            }
            response
        }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_DEADLINE)
        .max_headers(HEADERS)
        .max_buf_size(HEAD_BYTES)
        .keep_alive(true)
        .serve_connection(TokioIo::new(Worded::new(stream)), TowerToHyperService::new(service));
    // What a client does wrong on its connection ends that connection, nothing else.
    let _ = watcher.watch(connection).await;
}
