//! What is said on a WebSocket, in time, and how it ends.

use std::time::Duration;

use futures_util::{SinkExt as _, StreamExt as _};
use lsfb_drivers::sidecar::DecodeError;
use lsfb_drivers::sidecar::wire::{Envelope, Refusal};
use lsfb_web::Socket;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::{Bytes, Message};

/// How long an app may take to make room for what it is told.
pub(super) const SEND_TIMEOUT: Duration = Duration::from_secs(15);

/// Why a connection ends.
#[derive(Debug)]
pub(super) enum End {
    /// The app said BYE, and has its last acknowledgement.
    Bye,
    /// It is told why.
    Refused(Refusal, String),
    /// It has gone.
    Gone(&'static str),
}

impl From<Refusal> for End {
    fn from(refusal: Refusal) -> Self {
        Self::Refused(refusal, refusal.name().to_owned())
    }
}

impl From<DecodeError> for End {
    fn from(error: DecodeError) -> Self {
        let refusal = match error {
            DecodeError::Gap { .. } => Refusal::Gap,
            _ => Refusal::BadMessage,
        };
        Self::Refused(refusal, format!("{}: {error}", refusal.name()))
    }
}

/// The next binary message.
pub(super) async fn hear(socket: &mut Socket) -> Result<Bytes, End> {
    loop {
        match socket.next().await {
            Some(Ok(Message::Binary(bytes))) => return Ok(bytes),
            Some(Ok(Message::Text(_))) => return Err(Refusal::BadMessage.into()),
            Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_))) => {}
            None | Some(Err(_) | Ok(Message::Close(_))) => {
                return Err(End::Gone("closed the connection"));
            }
        }
    }
}

/// Sends an envelope.
pub(super) async fn send(socket: &mut Socket, envelope: &Envelope<'_>) -> Result<(), End> {
    // What the rig says is short.
    let bytes = envelope
        .emit()
        .map_err(|e| End::from(DecodeError::Wire(e)))?;
    in_time(socket.send(Message::Binary(bytes.into()))).await
}

/// Sends, or gives the other side up.
pub(super) async fn in_time<E>(sending: impl Future<Output = Result<(), E>>) -> Result<(), End> {
    match timeout(SEND_TIMEOUT, sending).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) => Err(End::Gone("its connection was lost")),
        Err(_) => Err(End::Gone("does not read messages")),
    }
}
