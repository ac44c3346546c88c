//! The app's side, as simulated glasses use it.

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::time::{Duration, Instant};

use super::device::ENDPOINT;
use super::wire::{Advertise, Envelope, EnvelopeKind, Hello};
use crate::transport::websocket::WebSocketConnection;
use crate::{Error, WireError};

/// Where the rig is, who we are, and how much may be under way.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClientConfig {
    /// Address of the rig.
    pub address: SocketAddr,
    /// Name of the device.
    pub device: String,
    /// Name of the session.
    pub session: String,
    /// DATA messages without acknowledgement at most.
    pub window_messages: usize,
    /// Bytes without acknowledgement at most, unless one message alone has more.
    pub window_bytes: usize,
    /// How long the rig may take to acknowledge before it counts as lost, seconds.
    pub ack_timeout_secs: u32,
}

impl Default for ClientConfig {
    /// 256 messages or 4 MiB under way, half a minute for an acknowledgement.
    fn default() -> Self {
        Self {
            address: SocketAddr::from(([127, 0, 0, 1], 8790)),
            device: "glasses".to_owned(),
            session: "session".to_owned(),
            window_messages: 256,
            window_bytes: 4 << 20,
            ack_timeout_secs: 30,
        }
    }
}

/// A session with a rig.
#[derive(Debug)]
pub struct SidecarClient {
    socket: WebSocketConnection,
    config: ClientConfig,
    last_seq: u64,
    under_way: VecDeque<Sent>,
    under_way_bytes: usize,
}

#[derive(Clone, Copy, Debug)]
struct Sent {
    seq: u64,
    bytes: usize,
}

impl SidecarClient {
    /// Connects and opens the session.
    pub fn connect(config: ClientConfig) -> Result<Self, Error> {
        let mut client = Self {
            socket: WebSocketConnection::connect(config.address, ENDPOINT)?,
            config,
            last_seq: 0,
            under_way: VecDeque::new(),
            under_way_bytes: 0,
        };
        let hello = Hello {
            session: client.config.session.clone(),
            first_unacked: 1,
            device: client.config.device.clone(),
        };
        client.send_with(EnvelopeKind::Hello, &hello.emit())?;
        Ok(client)
    }

    /// Describes a channel; its DATA may follow.
    pub fn advertise(&mut self, channel: &Advertise) -> Result<(), Error> {
        self.send_with(EnvelopeKind::Advertise, &channel.emit())
    }

    /// Sends a message of a described channel, waiting while the window is full.
    pub fn send(&mut self, channel: u32, device_time_ns: i64, payload: &[u8]) -> Result<(), Error> {
        let envelope = Envelope {
            kind: EnvelopeKind::Data,
            channel,
            seq: self.last_seq + 1,
            device_time_ns,
            payload,
        };
        let bytes = envelope.emit().map_err(|e| self.unsendable(e))?;
        self.wait_for_room(bytes.len())?;
        self.last_seq = envelope.seq;
        self.under_way_bytes += bytes.len();
        self.under_way.push_back(Sent {
            seq: envelope.seq,
            bytes: bytes.len(),
        });
        self.socket.send(bytes)
    }

    /// Says that nothing follows, waits until the rig has stored everything, and closes.
    pub fn bye(mut self) -> Result<(), Error> {
        let bye = Envelope::bare(EnvelopeKind::Bye, self.last_seq);
        let bytes = bye.emit().map_err(|e| self.unsendable(e))?;
        self.socket.send(bytes)?;
        let deadline = self.ack_deadline();
        while !self.under_way.is_empty() {
            self.wait_for_ack(deadline)?;
        }
        self.socket.close()
    }

    fn send_with(&mut self, kind: EnvelopeKind, payload: &[u8]) -> Result<(), Error> {
        let envelope = Envelope {
            payload,
            ..Envelope::bare(kind, 0)
        };
        let bytes = envelope.emit().map_err(|e| self.unsendable(e))?;
        self.socket.send(bytes)
    }

    fn wait_for_room(&mut self, bytes: usize) -> Result<(), Error> {
        while self.socket.has_arrived() {
            self.take_ack(Duration::ZERO)?;
        }
        let deadline = self.ack_deadline();
        while !self.under_way.is_empty()
            && (self.under_way.len() >= self.config.window_messages
                || self.under_way_bytes + bytes > self.config.window_bytes)
        {
            self.wait_for_ack(deadline)?;
        }
        Ok(())
    }

    fn wait_for_ack(&mut self, deadline: Instant) -> Result<(), Error> {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(self.protocol(format!(
                "no acknowledgement within {} s; {} messages are under way",
                self.config.ack_timeout_secs,
                self.under_way.len()
            )));
        }
        self.take_ack(left)
    }

    fn take_ack(&mut self, timeout: Duration) -> Result<(), Error> {
        let Some(packet) = self.socket.recv(timeout)? else {
            return Ok(());
        };
        let acked = match Envelope::parse(&packet.bytes) {
            Ok(envelope) if envelope.kind == EnvelopeKind::Ack => envelope.seq,
            Ok(envelope) => {
                return Err(self.protocol(format!("the rig sent {:?}", envelope.kind)));
            }
            Err(e) => return Err(self.protocol(format!("the rig's envelope: {e}"))),
        };
        if acked > self.last_seq {
            return Err(self.protocol(format!(
                "message {acked} is acknowledged, {} was the last",
                self.last_seq
            )));
        }
        while let Some(sent) = self.under_way.front().copied()
            && sent.seq <= acked
        {
            self.under_way.pop_front();
            self.under_way_bytes -= sent.bytes;
        }
        Ok(())
    }

    fn ack_deadline(&self) -> Instant {
        Instant::now() + Duration::from_secs(self.config.ack_timeout_secs.into())
    }

    fn unsendable(&self, error: WireError) -> Error {
        self.protocol(format!("the message cannot be sent: {error}"))
    }

    fn protocol(&self, problem: String) -> Error {
        Error::Protocol {
            device: self.socket.device().to_owned(),
            problem,
        }
    }
}
