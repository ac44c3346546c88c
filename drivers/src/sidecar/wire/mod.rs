//! Envelopes and the messages inside: protobuf, written and read by hand.
//!
//! ```text
//! message Envelope { uint32 type = 1; uint32 channel = 2; uint64 seq = 3; int64 device_time_ns = 4;
//!                    bytes payload = 5; fixed32 crc32c = 6; }        // crc32c of the payload
//! message Hello     { string session = 1; uint64 first_unacked = 2; string device = 3; }
//! message Advertise { uint32 channel = 1; string topic = 2; string encoding = 3; string schema_name = 4;
//!                     bytes schema = 5; string clock_id = 6; string metadata_json = 7; }
//! ```
//!
//! ACK has no payload: `seq` is the last one stored. BYE has no payload: `seq` is the last one sent. DATA is numbered
//! from 1. Unknown fields are passed over.

mod protobuf;
#[cfg(test)]
mod tests;

use protobuf::{Fields, Value, put_bytes, put_fixed32, put_varint};

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
    /// Nothing follows.
    Bye,
}

impl EnvelopeKind {
    const ALL: [Self; 5] = [
        Self::Hello,
        Self::Advertise,
        Self::Data,
        Self::Ack,
        Self::Bye,
    ];

    /// Its number. 5 to 8 belong to credit, time exchange and state, which this version does not speak.
    pub(super) fn id(self) -> u64 {
        match self {
            Self::Hello => 1,
            Self::Advertise => 2,
            Self::Data => 3,
            Self::Ack => 4,
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

/// Opens a session.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Hello {
    /// Name of the session, unique among the device's: a UUID. 1 to 64 letters, digits, `-` and `_`.
    pub session: String,
    /// First DATA that the device still holds, from 1.
    pub first_unacked: u64,
    /// Name of the device: the `<id>` in `/sidecar/<id>/…`. As above.
    pub device: String,
}

impl Hello {
    /// Reads the payload.
    pub fn parse(payload: &[u8]) -> Result<Self, WireError> {
        let mut hello = Self::default();
        for field in Fields::new(payload) {
            match field? {
                (1, Value::Bytes(value)) => hello.session = text(value)?,
                (2, Value::Varint(value)) => hello.first_unacked = value,
                (3, Value::Bytes(value)) => hello.device = text(value)?,
                _ => {}
            }
        }
        check_name("session name", &hello.session)?;
        check_name("device name", &hello.device)?;
        Ok(hello)
    }

    /// The payload's bytes.
    pub fn emit(&self) -> Vec<u8> {
        let mut out = Vec::new();
        put_bytes(1, self.session.as_bytes(), &mut out);
        put_varint(2, self.first_unacked, &mut out);
        put_bytes(3, self.device.as_bytes(), &mut out);
        out
    }
}

/// Describes a channel: what an MCAP file keeps as schema and channel, so that it can be copied there word for word.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Advertise {
    /// Number of the channel.
    pub channel: u32,
    /// Topic.
    pub topic: String,
    /// Encoding of the payloads, for instance `cdr`.
    pub encoding: String,
    /// Name of the schema, for instance `sensor_msgs/msg/Imu`.
    pub schema_name: String,
    /// Text of the schema.
    pub schema: Vec<u8>,
    /// The clock of `device_time_ns`, see [`super::model`].
    pub clock_id: String,
    /// What does not change during the session, JSON.
    pub metadata_json: String,
}

impl Advertise {
    /// Reads the payload.
    pub fn parse(payload: &[u8]) -> Result<Self, WireError> {
        let mut advertise = Self::default();
        for field in Fields::new(payload) {
            match field? {
                (1, Value::Varint(value)) => advertise.channel = channel_from(value)?,
                (2, Value::Bytes(value)) => advertise.topic = text(value)?,
                (3, Value::Bytes(value)) => advertise.encoding = text(value)?,
                (4, Value::Bytes(value)) => advertise.schema_name = text(value)?,
                (5, Value::Bytes(value)) => advertise.schema = value.to_vec(),
                (6, Value::Bytes(value)) => advertise.clock_id = text(value)?,
                (7, Value::Bytes(value)) => advertise.metadata_json = text(value)?,
                _ => {}
            }
        }
        Ok(advertise)
    }

    /// The payload's bytes.
    pub fn emit(&self) -> Vec<u8> {
        let mut out = Vec::new();
        put_varint(1, self.channel.into(), &mut out);
        put_bytes(2, self.topic.as_bytes(), &mut out);
        put_bytes(3, self.encoding.as_bytes(), &mut out);
        put_bytes(4, self.schema_name.as_bytes(), &mut out);
        put_bytes(5, &self.schema, &mut out);
        put_bytes(6, self.clock_id.as_bytes(), &mut out);
        put_bytes(7, self.metadata_json.as_bytes(), &mut out);
        out
    }
}

fn channel_from(value: u64) -> Result<u32, WireError> {
    u32::try_from(value).map_err(|_| WireError::Value {
        field: "channel",
        offset: 0,
        got: value,
    })
}

/// Names end up in topics and file names.
fn check_name(field: &'static str, name: &str) -> Result<(), WireError> {
    let bad = |c: char| !c.is_ascii_alphanumeric() && c != '-' && c != '_';
    match name.find(bad) {
        None if (1..=64).contains(&name.len()) => Ok(()),
        found => Err(WireError::Value {
            field,
            offset: found.unwrap_or(0),
            got: name.len() as u64,
        }),
    }
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
