//! The signals that end a command in good order.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio_util::sync::CancellationToken;

/// SIGINT, SIGTERM and SIGHUP.
struct Signals([Signal; 3]);

impl Signals {
    /// Takes them over from the system's default, which ends the process. Call on a runtime.
    fn listen() -> std::io::Result<Self> {
        let [interrupt, terminate] = [SignalKind::interrupt(), SignalKind::terminate()];
        Ok(Self([signal(interrupt)?, signal(terminate)?, signal(SignalKind::hangup())?]))
    }

    /// Resolves at the first of them.
    async fn first(&mut self) {
        let [interrupt, terminate, hangup] = &mut self.0;
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
            _ = hangup.recv() => {}
        }
    }
}

/// Does something at the first of them, on a thread of its own. They are heard when this returns.
fn at_the_first(what: impl FnOnce() + Send + 'static) -> std::io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let mut signals = runtime.block_on(async { Signals::listen() })?;
    std::thread::Builder::new().name("signals".into()).spawn(move || {
        runtime.block_on(signals.first());
        what();
    })?;
    Ok(())
}

/// A flag that is set at the first of them.
pub(super) fn stop_flag() -> std::io::Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    let stop = Arc::clone(&flag);
    at_the_first(move || stop.store(true, Ordering::Relaxed))?;
    Ok(flag)
}

/// The same for those who wait.
pub(super) fn stop_token() -> std::io::Result<CancellationToken> {
    let token = CancellationToken::new();
    let stop = token.clone();
    at_the_first(move || stop.cancel())?;
    Ok(token)
}
