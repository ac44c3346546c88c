//! `/sidecar/<id>/time_sync`: each exchange of times as it went, so that a device's clock can be estimated again.

use lsfb_drivers::sidecar::wire::TimeExchange;
use lsfb_recording::message::Schema;
use lsfb_types::Timestamp;

use super::topics::TIME_SYNC;
use crate::recorder::OwnMessage;

const SCHEMA: Schema = Schema {
    name: "lsfb_msgs/msg/TimeSync",
    text: "# One exchange of times with a phone: t1 sent and t4 received on its clock, t2 received and t3 sent on the host's.\n\
           string clock_id\nint64 t1_ns\nint64 t2_ns\nint64 t3_ns\nint64 t4_ns\n",
};
/// CDR, little-endian.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

pub(super) fn message(
    device: &str,
    clock_id: &str,
    exchange: &TimeExchange,
    arrival: Timestamp,
) -> OwnMessage {
    let mut body = Vec::with_capacity(64 + clock_id.len());
    body.extend((clock_id.len() as u32 + 1).to_le_bytes());
    body.extend(clock_id.as_bytes());
    body.push(0);
    // Eight-byte numbers stand at multiples of eight.
    body.resize(body.len().next_multiple_of(8), 0);
    for value in [
        exchange.t1_ns,
        exchange.t2_ns,
        exchange.t3_ns,
        exchange.t4_ns,
    ] {
        body.extend(value.to_le_bytes());
    }
    OwnMessage {
        topic: format!("/sidecar/{device}{TIME_SYNC}"),
        schema: SCHEMA,
        time: Timestamp::from_nanos(exchange.t3_ns),
        arrival,
        bytes: [&ENCAPSULATION[..], &body].concat(),
    }
}
