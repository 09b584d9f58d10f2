//! What the HTTP library refuses by itself, before any of our code sees the request (a malformed head, one
//! that is too large), it answers without a body. On its way out such an answer becomes a problem like all
//! others.

use super::problem::{PROBLEM_JSON, Problem};
use axum::http::StatusCode;
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

const NO_BODY: &str = "content-length: 0\r\n";

/// The answer that leaves instead of `bytes`, where these are a refusal of the library: our own refusals have
/// a body.
fn as_problem(bytes: &[u8]) -> Option<Vec<u8>> {
    let (code, detail) =
        match bytes.strip_prefix(b"HTTP/1.1 ").or(bytes.strip_prefix(b"HTTP/1.0 "))?.get(..4)? {
            b"400 " => ("malformed_request", "the head of the request is no HTTP"),
            b"414 " => ("uri_too_long", "the address is too long"),
            b"431 " => ("head_too_large", "the head of the request has more than 64 fields or 16 KB"),
            _ => return None,
        };
    let head = std::str::from_utf8(bytes).ok()?;
    if !head.contains(NO_BODY) || head.find("\r\n\r\n") != Some(head.len() - 4) {
        return None;
    }
    let status = StatusCode::from_bytes(bytes.get(9..12)?).ok()?;
    let body = serde_json::to_string(&Problem::new(status, code, detail)).ok()?;
    let fields = format!("content-type: {PROBLEM_JSON}\r\ncontent-length: {}\r\n", body.len());
    Some((head.replacen(NO_BODY, &fields, 1) + &body).into_bytes())
}

/// A stream on which refusals without a body become problems.
pub(super) struct Worded<S> {
    stream: S,
    /// A problem that is on its way, and how much of it has gone.
    going: (Vec<u8>, usize),
}

impl<S: AsyncWrite + Unpin> Worded<S> {
    pub(super) fn new(stream: S) -> Self {
        Self { stream, going: (Vec::new(), 0) }
    }

    fn poll_go(&mut self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let (bytes, gone) = &mut self.going;
        while let Some(rest) = bytes.get(*gone..).filter(|rest| !rest.is_empty()) {
            match ready!(Pin::new(&mut self.stream).poll_write(context, rest))? {
                0 => return Poll::Ready(Err(io::ErrorKind::WriteZero.into())),
                count => *gone += count,
            }
        }
        Poll::Ready(Ok(()))
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Worded<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Worded<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        ready!(self.poll_go(context))?;
        if let Some(problem) = as_problem(bytes) {
            self.going = (problem, 0);
            return Poll::Ready(Ok(bytes.len())); // it leaves with the next write, flush or end
        }
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        pieces: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        // A refusal of the library is one piece: it has no body.
        if let [piece] = pieces {
            return self.poll_write(context, piece);
        }
        ready!(self.poll_go(context))?;
        Pin::new(&mut self.stream).poll_write_vectored(context, pieces)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        ready!(self.poll_go(context))?;
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        ready!(self.poll_go(context))?;
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

    #[test]
    fn a_refusal_without_a_body_gets_one_and_all_else_passes() {
        let refusal =
            "HTTP/1.1 431 Request Header Fields Too Large\r\nconnection: close\r\ncontent-length: 0\r\n\r\n";
        let good = "HTTP/1.1 204 No Content\r\ncontent-length: 0\r\n\r\n";
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let pass = |text: &'static str| {
            runtime.block_on(async {
                // A narrow stream: the problem goes in many pieces.
                let (near, mut far) = tokio::io::duplex(7);
                let mut near = Worded::new(near);
                let sent = async move {
                    near.write_all(text.as_bytes()).await.unwrap();
                    near.shutdown().await.unwrap();
                };
                let mut said = String::new();
                let (_, read) = tokio::join!(sent, far.read_to_string(&mut said));
                read.map(|_| said).unwrap()
            })
        };
        assert_eq!(pass(good), good);
        let (head, body) =
            pass(refusal).split_once("\r\n\r\n").map(|(h, b)| (h.to_owned(), b.to_owned())).unwrap();
        assert!(head.contains("connection: close") && head.contains(PROBLEM_JSON), "{head}");
        assert!(head.contains(&format!("content-length: {}", body.len())), "{head}");
        let body: serde_json::Value = serde_json::from_str(&body).unwrap();
        assert_eq!((&body["status"], &body["code"]), (&431.into(), &"head_too_large".into()));
    }
}
