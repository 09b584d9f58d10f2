//! Places for connections: at most so many, the longest idle one gives way, and nobody is waited for.

use crate::service::clock;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::{Duration, Instant};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::Sleep;
use tokio_util::sync::CancellationToken;

/// A client that takes nothing of what is written to it for this long is let go.
pub(super) const WRITE_DEADLINE: Duration = Duration::from_secs(5);

/// Whether a connection is in the middle of a request, and since when it is as it is.
#[derive(Debug)]
pub(super) struct Activity(Mutex<(bool, Instant)>);

impl Activity {
    fn set(&self, busy: bool) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = (busy, clock::now());
    }

    /// A request has come.
    pub(super) fn begin(&self) {
        self.set(true);
    }

    /// It is answered.
    pub(super) fn end(&self) {
        self.set(false);
    }

    /// Since when nothing is asked; nothing while a request is at hand.
    fn idle_since(&self) -> Option<Instant> {
        let (busy, since) = *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        (!busy).then_some(since)
    }
}

struct Held {
    number: u64,
    activity: Arc<Activity>,
    give_up: CancellationToken,
}

#[derive(Default)]
struct Table {
    next: u64,
    held: Vec<Held>,
}

/// All places.
#[derive(Clone)]
pub(super) struct Seats {
    most: usize,
    table: Arc<Mutex<Table>>,
}

impl Seats {
    pub(super) fn new(most: usize) -> Self {
        Self { most, table: Arc::default() }
    }

    /// A place, where there is none the one of the connection that has asked nothing for longest. Nothing
    /// when all are in the middle of a request.
    pub(super) fn take(&self) -> Option<Seat> {
        let mut table = self.table.lock().unwrap_or_else(PoisonError::into_inner);
        if table.held.len() >= self.most {
            let idle = table.held.iter().enumerate().filter_map(|(k, h)| Some((h.activity.idle_since()?, k)));
            let (_, oldest) = idle.min()?;
            table.held.swap_remove(oldest).give_up.cancel();
        }
        let number = table.next;
        table.next += 1;
        let activity = Arc::new(Activity(Mutex::new((false, clock::now()))));
        let give_up = CancellationToken::new();
        table.held.push(Held { number, activity: Arc::clone(&activity), give_up: give_up.clone() });
        Some(Seat { number, activity, give_up, table: Arc::clone(&self.table) })
    }
}

/// One place, given back when dropped.
pub(super) struct Seat {
    number: u64,
    activity: Arc<Activity>,
    give_up: CancellationToken,
    table: Arc<Mutex<Table>>,
}

impl Seat {
    /// Tells that the place was given to another.
    pub(super) fn given_up(&self) -> CancellationToken {
        self.give_up.clone()
    }

    pub(super) fn activity(&self) -> Arc<Activity> {
        Arc::clone(&self.activity)
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        let mut table = self.table.lock().unwrap_or_else(PoisonError::into_inner);
        table.held.retain(|h| h.number != self.number);
    }
}

/// A stream whose writes fail when the other side takes nothing for five seconds.
pub(super) struct Prompt<S> {
    stream: S,
    patience: Duration,
    deadline: Option<Pin<Box<Sleep>>>,
}

impl<S> Prompt<S> {
    pub(super) fn new(stream: S, patience: Duration) -> Self {
        Self { stream, patience, deadline: None }
    }

    /// Starts the clock of a write that has to wait, stops it at progress.
    fn watch<T>(&mut self, context: &mut Context<'_>, outcome: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        if outcome.is_ready() {
            self.deadline = None;
            return outcome;
        }
        let patience = self.patience;
        let deadline = self.deadline.get_or_insert_with(|| Box::pin(tokio::time::sleep(patience)));
        ready!(deadline.as_mut().poll(context));
        Poll::Ready(Err(io::ErrorKind::TimedOut.into()))
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Prompt<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Prompt<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let outcome = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.watch(context, outcome)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        pieces: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let outcome = Pin::new(&mut self.stream).poll_write_vectored(context, pieces);
        self.watch(context, outcome)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let outcome = Pin::new(&mut self.stream).poll_flush(context);
        self.watch(context, outcome)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let outcome = Pin::new(&mut self.stream).poll_shutdown(context);
        self.watch(context, outcome)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::AsyncWriteExt as _;

    #[test]
    fn the_longest_idle_gives_way_and_the_busy_stay() {
        let seats = Seats::new(3);
        let [a, b, c] = [0, 1, 2].map(|_| seats.take().unwrap());
        b.activity().begin();
        a.activity().begin();
        a.activity().end();
        let d = seats.take().expect("c has asked nothing for longest");
        assert!(c.given_up().is_cancelled() && !a.given_up().is_cancelled());
        d.activity().begin();
        let e = seats.take().expect("then a");
        assert!(a.given_up().is_cancelled() && !b.given_up().is_cancelled());
        e.activity().begin();
        assert!(seats.take().is_none(), "all are in the middle of a request");
        drop(b);
        assert!(seats.take().is_some());
    }

    #[test]
    fn a_reader_that_takes_nothing_is_let_go() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        let error = runtime.block_on(async {
            let (near, _far) = tokio::io::duplex(16);
            Prompt::new(near, Duration::from_millis(20)).write_all(&[0; 64]).await.unwrap_err()
        });
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
    }
}
