//! MTConnect: an SHDR adapter, so that existing agents pick up chatter, frequency, pitch and mode.
//!
//! Lines `time|id|value`; a client's `* PING` is answered with `* PONG 10000` (milliseconds). While the
//! machine is silent every value is `UNAVAILABLE`. Nothing that a client sends has any other effect.

use super::clock;
use super::handle::Handle;
use super::live::LiveState;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;

/// Agents at once.
const CLIENTS: usize = 8;
/// An agent that takes longer to read, or is silent for this long, is let go.
const PATIENCE: Duration = Duration::from_secs(30);
/// Values are looked at this often.
const LOOK: Duration = Duration::from_millis(100);
/// Longest line of an agent.
const LINE: usize = 128;
/// A picture that does not change for this long is of no machine that runs.
const OLD: Duration = Duration::from_secs(2);
/// A value that moved less than this fraction is the same.
const SAME: f64 = 1e-3;

/// One data item and its text.
type Item = (&'static str, String);

/// Text of all data items.
fn items(state: &LiveState, old: bool) -> Vec<Item> {
    if old || !state.source.connected {
        let words = ["chatter", "chatter_frequency", "pitch", "mode"];
        let mut all: Vec<Item> = words.iter().map(|w| (*w, "UNAVAILABLE".to_owned())).collect();
        all.push(("chatter_condition", "UNAVAILABLE||||".to_owned()));
        return all;
    }
    let chatter = state.chatter.state == "chatter";
    let frequency = state.chatter.frequency_hz;
    let pitch = state.pitch.reported_rad.unwrap_or(state.pitch.commanded_rad).to_degrees();
    let condition = match (chatter, state.mode.word()) {
        (false, _) => "NORMAL||||".to_owned(),
        (true, "act") => format!("WARNING|CHATTER|1||chatter at {} Hz", rounded(frequency)),
        (true, _) => format!("FAULT|CHATTER|2||chatter at {} Hz", rounded(frequency)),
    };
    vec![
        ("chatter", if chatter { "ACTIVE" } else { "INACTIVE" }.to_owned()),
        ("chatter_frequency", frequency.map_or("UNAVAILABLE".to_owned(), |_| rounded(frequency))),
        ("pitch", format!("{:.3}", if pitch.abs() < SAME { 0.0 } else { pitch })),
        ("mode", state.mode.word().to_uppercase()),
        ("chatter_condition", condition),
    ]
}

fn rounded(frequency: Option<f64>) -> String {
    frequency.map_or_else(|| "?".to_owned(), |f| format!("{f:.0}"))
}

/// Lines for what changed since `before`.
fn changes(before: &[Item], now: &[Item], time: &str) -> String {
    let differs = |item: &&Item| !before.contains(item);
    now.iter()
        .filter(differs)
        .fold(String::new(), |text, (id, value)| text + &format!("{time}|{id}|{value}\n"))
}

/// Serves agents until the service stops.
pub(super) async fn serve(handle: Handle, listener: TcpListener) {
    let stop = handle.stopping();
    let seats = Arc::new(Semaphore::new(CLIENTS));
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            () = stop.cancelled() => return,
        };
        let Ok((stream, address)) = accepted else {
            tokio::time::sleep(LOOK).await;
            continue;
        };
        let Ok(seat) = Arc::clone(&seats).try_acquire_owned() else { continue };
        let handle = handle.clone();
        tokio::spawn(async move {
            let stop = handle.stopping();
            tokio::select! {
                ended = agent(handle, stream, address) => {
                    let why = ended.err().map_or_else(String::new, |e| e.to_string());
                    tracing::info!(event = "mtconnect_agent_left", %address, why, "an agent left");
                }
                () = stop.cancelled() => {}
            }
            drop(seat);
        });
    }
}

async fn agent(handle: Handle, mut stream: TcpStream, address: SocketAddr) -> std::io::Result<()> {
    tracing::info!(event = "mtconnect_agent", %address, "an agent connected");
    let (mut read, mut write) = stream.split();
    let mut look = tokio::time::interval(LOOK);
    let (mut sent, mut line, mut byte) = (Vec::new(), Vec::new(), [0; 64]);
    let mut heard = clock::now();
    let mut picture = (0, heard);
    loop {
        let text = tokio::select! {
            count = read.read(&mut byte) => {
                let count = count?;
                if count == 0 {
                    return Ok(());
                }
                heard = clock::now();
                take(&mut line, &byte[..count])
            }
            _ = look.tick() => {
                let state = handle.state();
                if state.time_ns != picture.0 {
                    picture = (state.time_ns, clock::now());
                }
                let now = items(&state, clock::now().duration_since(picture.1) > OLD);
                let text = changes(&sent, &now, &clock::rfc3339(clock::wall_ns()));
                sent = now;
                text
            }
        };
        if clock::now().duration_since(heard) > PATIENCE {
            return Err(std::io::ErrorKind::TimedOut.into());
        }
        if !text.is_empty() {
            let written = tokio::time::timeout(PATIENCE, write.write_all(text.as_bytes())).await;
            written.map_err(|_| std::io::Error::from(std::io::ErrorKind::TimedOut))??;
        }
    }
}

/// Collects lines; answers what they ask for. A line that is too long is forgotten.
#[doc(hidden)] // public for the fuzz targets
pub fn take(line: &mut Vec<u8>, bytes: &[u8]) -> String {
    let mut answer = String::new();
    for byte in bytes {
        if *byte == b'\n' {
            if line.trim_ascii() == b"* PING" {
                answer.push_str("* PONG 10000\n");
            }
            line.clear();
        } else if line.len() < LINE {
            line.push(*byte);
        }
    }
    answer
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_is_unavailable_and_only_changes_are_told() {
        let mut state = LiveState::default();
        let silent = items(&state, false);
        assert!(silent.iter().all(|(_, value)| value.starts_with("UNAVAILABLE")));
        state.source.connected = true;
        state.chatter.state = "chatter".into();
        state.chatter.frequency_hz = Some(652.4);
        state.pitch.reported_rad = Some(5.52_f64.to_radians());
        let loud = items(&state, false);
        assert!(items(&state, true) == silent, "an old picture is no news");
        let text = changes(&silent, &loud, "2026-11-21T08:00:00.000Z");
        assert!(text.contains("2026-11-21T08:00:00.000Z|chatter|ACTIVE\n"), "{text}");
        assert!(text.contains("|chatter_frequency|652\n") && text.contains("|pitch|5.520\n"), "{text}");
        assert!(text.contains("|chatter_condition|FAULT|CHATTER|2||chatter at 652 Hz\n"), "{text}");
        assert_eq!(changes(&loud, &loud, "t"), "");
    }

    #[test]
    fn pings_are_answered_and_nothing_else() {
        let mut line = Vec::new();
        assert_eq!(take(&mut line, b"* PI"), "");
        assert_eq!(take(&mut line, b"NG\r\n* DELETE everything\n* PING\n"), "* PONG 10000\n* PONG 10000\n");
        assert_eq!(take(&mut line, &[b'x'; 10_000]), "");
        assert!(line.len() <= LINE);
    }
}
