//! What an app says before it sends: who it is, and what its channels are.

use super::protobuf::{Fields, Value, put_bytes, put_varint};
use super::{channel_from, text};
use crate::WireError;
use crate::sidecar::credentials::{DeviceKey, PairingToken};

/// Opens a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hello {
    /// Name of the session, unique among the device's: a UUID. 1 to 64 letters, digits, `-` and `_`.
    pub session: String,
    /// First DATA that the device still holds, from 1.
    pub first_unacked: u64,
    /// Name of the device: the `<id>` in `/sidecar/<id>/…`. As above.
    pub device: String,
    /// What the device proves with that it was paired.
    pub device_key: DeviceKey,
    /// The invitation, until the first time that it is accepted.
    pub pairing_token: Option<PairingToken>,
}

impl Hello {
    /// Reads the payload.
    pub fn parse(payload: &[u8]) -> Result<Self, WireError> {
        let mut hello = Self {
            session: String::new(),
            first_unacked: 0,
            device: String::new(),
            device_key: DeviceKey([0; 32]),
            pairing_token: None,
        };
        for field in Fields::new(payload) {
            match field? {
                (1, Value::Bytes(value)) => hello.session = text(value)?,
                (2, Value::Varint(value)) => hello.first_unacked = value,
                (3, Value::Bytes(value)) => hello.device = text(value)?,
                (4, Value::Bytes(value)) => hello.device_key = DeviceKey(secret(value)?),
                (5, Value::Bytes(value)) => {
                    hello.pairing_token = Some(PairingToken(secret(value)?));
                }
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
        if self.device_key.0 != [0; 32] {
            put_bytes(4, &self.device_key.0, &mut out);
        }
        if let Some(token) = &self.pairing_token {
            put_bytes(5, &token.0, &mut out);
        }
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
    /// The clock of `device_time_ns`, see [`crate::sidecar::model`].
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

/// A secret of the length it should have. What it is instead is not said.
fn secret<const N: usize>(bytes: &[u8]) -> Result<[u8; N], WireError> {
    bytes.try_into().map_err(|_| WireError::Length {
        expected: N,
        got: bytes.len(),
    })
}

/// Whether a device or a session can be called so: 1 to 64 letters, digits, `-` and `_`. Names end up in topics and file names.
pub fn is_name(name: &str) -> bool {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    (1..=64).contains(&name.len()) && name.chars().all(is_plain)
}

fn check_name(field: &'static str, name: &str) -> Result<(), WireError> {
    if is_name(name) {
        return Ok(());
    }
    Err(WireError::Value {
        field,
        offset: 0,
        got: name.len() as u64,
    })
}
