//! Envelopes and the messages inside: protobuf, written and read by hand.
//!
//! ```text
//! message Envelope { uint32 type = 1; uint32 channel = 2; uint64 seq = 3; int64 device_time_ns = 4;
//!                    bytes payload = 5; fixed32 crc32c = 6; }        // crc32c of the payload
//! message Hello     { string session = 1; uint64 first_unacked = 2; string device = 3;
//!                     bytes device_key = 4; bytes pairing_token = 5; }
//! message Advertise { uint32 channel = 1; string topic = 2; string encoding = 3; string schema_name = 4;
//!                     bytes schema = 5; string clock_id = 6; string metadata_json = 7; }
//! message TimeRequest  { int64 t1_ns = 1; string clock_id = 2; int64 last_t1_ns = 3; int64 last_t2_ns = 4;
//!                        int64 last_t3_ns = 5; int64 last_t4_ns = 6; }
//! message TimeResponse { int64 t1_ns = 1; int64 t2_ns = 2; int64 t3_ns = 3; }
//! message State     { uint32 code = 1; string text = 2; }
//! ```
//!
//! What `seq` of an envelope means by its type: of DATA its number, from 1; of ACK the last one stored; of CREDIT how many
//! bytes of DATA envelopes may be sent on this connection in all; of BYE the last DATA sent. Unknown fields are passed over.

mod hello;
mod protobuf;
mod state;
#[cfg(test)]
mod tests;
mod time;

use protobuf::{Fields, Value, put_bytes, put_fixed32, put_varint};

pub use hello::{Advertise, Hello, is_name};
pub use state::{Refusal, State};
pub use time::{TimeExchange, TimeRequest, TimeResponse};

use super::model::MAX_ENVELOPE_BYTES;
use crate::WireError;

/// What an envelope is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum EnvelopeKind {
    /// Opens a session.
    Hello,
    /// Describes a channel.
    Advertise,
    /// One message of a channel.
    Data,
    /// Everything up to `seq` is stored.
    Ack,
    /// Bytes that may be sent.
    Credit,
    /// The app asks what time it is.
    TimeRequest,
    /// The rig's answer.
    TimeResponse,
    /// The rig says why it ends the connection.
    State,
    /// Nothing follows.
    Bye,
}

impl EnvelopeKind {
    /// In order of their numbers, from 1.
    const ALL: [Self; 9] = [
        Self::Hello,
        Self::Advertise,
        Self::Data,
        Self::Ack,
        Self::Credit,
        Self::TimeRequest,
        Self::TimeResponse,
        Self::State,
        Self::Bye,
    ];

    /// Its number on the wire.
    pub(super) fn id(self) -> u64 {
        match self {
            Self::Hello => 1,
            Self::Advertise => 2,
            Self::Data => 3,
            Self::Ack => 4,
            Self::Credit => 5,
            Self::TimeRequest => 6,
            Self::TimeResponse => 7,
            Self::State => 8,
            Self::Bye => 9,
        }
    }
}

/// One WebSocket message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Envelope<'a> {
    /// What it is.
    pub kind: EnvelopeKind,
    /// Channel of DATA, else 0.
    pub channel: u32,
    /// Number of DATA within the session, from 1; see the other kinds for theirs.
    pub seq: u64,
    /// Time of the measurement on the channel's clock, nanoseconds.
    pub device_time_ns: i64,
    /// The message inside.
    pub payload: &'a [u8],
}

impl<'a> Envelope<'a> {
    /// An envelope that carries nothing but its kind and number.
    pub fn bare(kind: EnvelopeKind, seq: u64) -> Self {
        Self {
            kind,
            channel: 0,
            seq,
            device_time_ns: 0,
            payload: &[],
        }
    }

    /// An envelope around a message.
    pub fn around(kind: EnvelopeKind, payload: &'a [u8]) -> Self {
        Self {
            payload,
            ..Self::bare(kind, 0)
        }
    }

    /// Reads an envelope and checks its payload against the checksum.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, WireError> {
        if bytes.len() > MAX_ENVELOPE_BYTES {
            return Err(WireError::Length {
                expected: MAX_ENVELOPE_BYTES,
                got: bytes.len(),
            });
        }
        let mut kind_id = 0;
        let mut crc = 0;
        let mut envelope = Self::bare(EnvelopeKind::Data, 0);
        for field in Fields::new(bytes) {
            match field? {
                (1, Value::Varint(value)) => kind_id = value,
                (2, Value::Varint(value)) => envelope.channel = channel_from(value)?,
                (3, Value::Varint(value)) => envelope.seq = value,
                (4, Value::Varint(value)) => envelope.device_time_ns = value.cast_signed(),
                (5, Value::Bytes(value)) => envelope.payload = value,
                (6, Value::Fixed32(value)) => crc = value,
                _ => {}
            }
        }
        envelope.kind = EnvelopeKind::ALL
            .into_iter()
            .find(|kind| kind.id() == kind_id)
            .ok_or(WireError::Value {
                field: "envelope type",
                offset: 0,
                got: kind_id,
            })?;
        let expected = crc32c::crc32c(envelope.payload);
        if crc != expected {
            return Err(WireError::Checksum { expected, got: crc });
        }
        Ok(envelope)
    }

    /// The envelope's bytes. One that is too long for the other side is an error.
    pub fn emit(&self) -> Result<Vec<u8>, WireError> {
        // Keys and numbers take less than 64 bytes.
        let mut out = Vec::with_capacity(self.payload.len() + 64);
        put_varint(1, self.kind.id(), &mut out);
        put_varint(2, self.channel.into(), &mut out);
        put_varint(3, self.seq, &mut out);
        put_varint(4, self.device_time_ns.cast_unsigned(), &mut out);
        put_bytes(5, self.payload, &mut out);
        put_fixed32(6, crc32c::crc32c(self.payload), &mut out);
        if out.len() > MAX_ENVELOPE_BYTES {
            return Err(WireError::Length {
                expected: MAX_ENVELOPE_BYTES,
                got: out.len(),
            });
        }
        Ok(out)
    }
}

fn channel_from(value: u64) -> Result<u32, WireError> {
    u32::try_from(value).map_err(|_| WireError::Value {
        field: "channel",
        offset: 0,
        got: value,
    })
}

fn text(bytes: &[u8]) -> Result<String, WireError> {
    std::str::from_utf8(bytes)
        .map(str::to_owned)
        .map_err(|e| WireError::Value {
            field: "text",
            offset: e.valid_up_to(),
            got: bytes
                .get(e.valid_up_to())
                .copied()
                .unwrap_or_default()
                .into(),
        })
}
