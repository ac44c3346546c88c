//! The exchange of four times: the app's clock against the rig's.

use super::protobuf::{Fields, Value, put_bytes, put_varint};
use super::text;
use crate::WireError;

/// One exchange: `t1` sent and `t4` received by the app on its clock, `t2` received and `t3` sent by the rig on the host's,
/// nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TimeExchange {
    /// When the app sent, on the app's clock.
    pub t1_ns: i64,
    /// When the rig received, on the host's clock.
    pub t2_ns: i64,
    /// When the rig answered, on the host's clock.
    pub t3_ns: i64,
    /// When the app had the answer, on the app's clock.
    pub t4_ns: i64,
}

/// The app asks, and tells how its last question went.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TimeRequest {
    /// When it is sent, on the app's clock; taken as late as can be.
    pub t1_ns: i64,
    /// The clock, as in [`super::Advertise`].
    pub clock_id: String,
    /// The last exchange that was completed; all zero where there was none.
    pub last: TimeExchange,
}

impl TimeRequest {
    /// Reads the payload.
    pub fn parse(payload: &[u8]) -> Result<Self, WireError> {
        let mut request = Self::default();
        for field in Fields::new(payload) {
            match field? {
                (1, Value::Varint(value)) => request.t1_ns = value.cast_signed(),
                (2, Value::Bytes(value)) => request.clock_id = text(value)?,
                (3, Value::Varint(value)) => request.last.t1_ns = value.cast_signed(),
                (4, Value::Varint(value)) => request.last.t2_ns = value.cast_signed(),
                (5, Value::Varint(value)) => request.last.t3_ns = value.cast_signed(),
                (6, Value::Varint(value)) => request.last.t4_ns = value.cast_signed(),
                _ => {}
            }
        }
        Ok(request)
    }

    /// The payload's bytes.
    pub fn emit(&self) -> Vec<u8> {
        let mut out = Vec::new();
        put_varint(1, self.t1_ns.cast_unsigned(), &mut out);
        put_bytes(2, self.clock_id.as_bytes(), &mut out);
        put_varint(3, self.last.t1_ns.cast_unsigned(), &mut out);
        put_varint(4, self.last.t2_ns.cast_unsigned(), &mut out);
        put_varint(5, self.last.t3_ns.cast_unsigned(), &mut out);
        put_varint(6, self.last.t4_ns.cast_unsigned(), &mut out);
        out
    }
}

/// The rig answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TimeResponse {
    /// The question's.
    pub t1_ns: i64,
    /// When it was received, on the host's clock.
    pub t2_ns: i64,
    /// When this is sent, on the host's clock.
    pub t3_ns: i64,
}

impl TimeResponse {
    /// Reads the payload.
    pub fn parse(payload: &[u8]) -> Result<Self, WireError> {
        let mut response = Self::default();
        for field in Fields::new(payload) {
            match field? {
                (1, Value::Varint(value)) => response.t1_ns = value.cast_signed(),
                (2, Value::Varint(value)) => response.t2_ns = value.cast_signed(),
                (3, Value::Varint(value)) => response.t3_ns = value.cast_signed(),
                _ => {}
            }
        }
        Ok(response)
    }

    /// The payload's bytes.
    pub fn emit(&self) -> Vec<u8> {
        let mut out = Vec::new();
        put_varint(1, self.t1_ns.cast_unsigned(), &mut out);
        put_varint(2, self.t2_ns.cast_unsigned(), &mut out);
        put_varint(3, self.t3_ns.cast_unsigned(), &mut out);
        out
    }
}
