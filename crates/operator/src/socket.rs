//! WebSockets of screens and apps: said in time, or not at all.

use std::time::{Duration, Instant};

use futures_util::SinkExt as _;
use lsfb_web::Socket;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::{Bytes, Message};

/// How long a client may take to make room before it is given up.
const SEND_TIMEOUT: Duration = Duration::from_secs(5);
/// Who has been silent for this long is asked; every browser answers by itself.
const ASK_AFTER: Duration = Duration::from_secs(3);
/// Who has been silent for this long has gone.
const GONE_AFTER: Duration = Duration::from_secs(10);
/// Longest message of a client: a note.
pub(crate) const MAX_MESSAGE_BYTES: usize = 64 << 10;

/// The other side has gone, or must go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Gone;

/// Sends a message, or gives the other side up.
pub(crate) async fn send(socket: &mut Socket, message: Message) -> Result<(), Gone> {
    match timeout(SEND_TIMEOUT, socket.send(message)).await {
        Ok(Ok(())) => Ok(()),
        _ => Err(Gone),
    }
}

/// Says goodbye, where somebody listens.
pub(crate) async fn close(mut socket: Socket) {
    let _ = timeout(SEND_TIMEOUT, socket.close(None)).await;
}

/// Whether the other side of a WebSocket is still there: a phone that left the network says no goodbye, and its place must not stay
/// taken.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Presence {
    heard: Instant,
    asked: Instant,
}

impl Presence {
    pub fn new() -> Self {
        let now = Instant::now();
        Self {
            heard: now,
            asked: now,
        }
    }

    /// Something arrived, an answer at least.
    pub fn heard(&mut self) {
        self.heard = Instant::now();
    }

    /// Asks where it is time to. An error: nobody has answered for too long.
    pub async fn check(&mut self, socket: &mut Socket) -> Result<(), Gone> {
        let silent = self.heard.elapsed();
        if silent >= GONE_AFTER {
            return Err(Gone);
        }
        if silent >= ASK_AFTER && self.asked.elapsed() >= ASK_AFTER {
            self.asked = Instant::now();
            send(socket, Message::Ping(Bytes::new())).await?;
        }
        Ok(())
    }
}
