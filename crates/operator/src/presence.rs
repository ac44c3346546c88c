//! Whether the other side of a WebSocket is still there. A phone that left the network says no goodbye; its place must not
//! stay taken.

use std::io;
use std::net::TcpStream;
use std::time::{Duration, Instant};

use tungstenite::{Bytes, Message, WebSocket};

/// Who has been silent for this long is asked; every browser answers by itself.
const ASK_AFTER: Duration = Duration::from_secs(3);
/// Who has been silent for this long has gone.
const GONE_AFTER: Duration = Duration::from_secs(10);

/// When the other side was heard, and asked, last.
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
    pub fn check(&mut self, socket: &mut WebSocket<TcpStream>) -> Result<(), tungstenite::Error> {
        let silent = self.heard.elapsed();
        if silent >= GONE_AFTER {
            return Err(io::Error::from(io::ErrorKind::TimedOut).into());
        }
        if silent >= ASK_AFTER && self.asked.elapsed() >= ASK_AFTER {
            self.asked = Instant::now();
            socket.send(Message::Ping(Bytes::new()))?;
        }
        Ok(())
    }
}
