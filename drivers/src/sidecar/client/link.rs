//! One connection of an app: envelopes out, what the rig says in.

use std::time::Duration;

use super::ClientConfig;
use crate::Error;
use crate::sidecar::model::{MAX_ENVELOPE_BYTES, STREAM_PATH, SUBPROTOCOL};
use crate::sidecar::wire::{Envelope, EnvelopeKind, Refusal, State, TimeResponse};
use crate::transport::websocket::{Endpoint, WebSocketConnection};

/// Where the stream is.
const ENDPOINT: Endpoint = Endpoint {
    path: STREAM_PATH,
    subprotocol: SUBPROTOCOL,
    max_message_bytes: MAX_ENVELOPE_BYTES,
};

/// What the rig said.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Said {
    /// Everything up to this number is stored.
    Ack(u64),
    /// So many bytes may be sent on this connection in all.
    Credit(u64),
    /// What time it was there.
    Time(TimeResponse),
    /// Why it ends the connection.
    State(State),
}

/// An open connection.
#[derive(Debug)]
pub(super) struct Link {
    socket: WebSocketConnection,
}

impl Link {
    pub(super) fn open(config: &ClientConfig) -> Result<Self, Error> {
        let key_sha256 = config.fingerprint.0;
        let socket = WebSocketConnection::connect(config.address, key_sha256, ENDPOINT)?;
        Ok(Self { socket })
    }

    /// Sends an envelope that carries nothing but a message.
    pub(super) fn send_around(&mut self, kind: EnvelopeKind, payload: &[u8]) -> Result<(), Error> {
        let bytes = self.bytes_of(&Envelope::around(kind, payload))?;
        self.socket.send(bytes)
    }

    /// Sends bytes as they are.
    pub(super) fn send(&mut self, bytes: Vec<u8>) -> Result<(), Error> {
        self.socket.send(bytes)
    }

    /// An envelope's bytes, or what is wrong with it.
    pub(super) fn bytes_of(&self, envelope: &Envelope<'_>) -> Result<Vec<u8>, Error> {
        envelope
            .emit()
            .map_err(|e| self.protocol(format!("the message cannot be sent: {e}")))
    }

    /// What the rig says next, waiting up to `timeout`.
    pub(super) fn hear(&mut self, timeout: Duration) -> Result<Option<Said>, Error> {
        let Some(packet) = self.socket.recv(timeout)? else {
            return Ok(None);
        };
        let wrong = |e| self.protocol(format!("the rig's envelope: {e}"));
        let envelope = Envelope::parse(&packet.bytes).map_err(wrong)?;
        Ok(Some(match envelope.kind {
            EnvelopeKind::Ack => Said::Ack(envelope.seq),
            EnvelopeKind::Credit => Said::Credit(envelope.seq),
            EnvelopeKind::TimeResponse => {
                Said::Time(TimeResponse::parse(envelope.payload).map_err(wrong)?)
            }
            EnvelopeKind::State => Said::State(State::parse(envelope.payload).map_err(wrong)?),
            kind => return Err(self.protocol(format!("the rig sent {kind:?}"))),
        }))
    }

    /// Whether something has arrived; false may miss what is already buffered.
    pub(super) fn has_arrived(&self) -> bool {
        self.socket.has_arrived()
    }

    /// Says goodbye.
    pub(super) fn close(self) -> Result<(), Error> {
        self.socket.close()
    }

    /// Cuts the connection when so many more bytes have been sent, wherever that is.
    pub(super) fn cut_after(&mut self, bytes: u64) {
        self.socket.cut_after(bytes);
    }

    pub(super) fn protocol(&self, problem: String) -> Error {
        Error::Protocol {
            device: self.socket.device().to_owned(),
            problem,
        }
    }

    /// The rig's own reason as an error.
    pub(super) fn refused(&self, state: State) -> Error {
        Error::Refused {
            device: self.socket.device().to_owned(),
            may_pass: state.refusal.is_none_or(Refusal::may_pass),
            reason: state.text,
        }
    }
}
