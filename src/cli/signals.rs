//! The signals that end a command in good order.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tokio::signal::unix::{Signal, SignalKind, signal};

/// SIGINT, SIGTERM and SIGHUP.
pub(super) struct Signals([Signal; 3]);

impl Signals {
    /// Takes them over from the system's default, which ends the process. Call on a runtime.
    pub(super) fn listen() -> std::io::Result<Self> {
        let [interrupt, terminate] = [SignalKind::interrupt(), SignalKind::terminate()];
        Ok(Self([signal(interrupt)?, signal(terminate)?, signal(SignalKind::hangup())?]))
    }

    /// Resolves at the first of them.
    pub(super) async fn first(&mut self) {
        let [interrupt, terminate, hangup] = &mut self.0;
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
            _ = hangup.recv() => {}
        }
    }
}

/// A flag that is set at the first of them, by a thread of its own.
pub(super) fn stop_flag() -> std::io::Result<Arc<AtomicBool>> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let mut signals = runtime.block_on(async { Signals::listen() })?;
    let flag = Arc::new(AtomicBool::new(false));
    let stop = Arc::clone(&flag);
    std::thread::Builder::new().name("signals".into()).spawn(move || {
        runtime.block_on(signals.first());
        stop.store(true, Ordering::Relaxed);
    })?;
    Ok(flag)
}
