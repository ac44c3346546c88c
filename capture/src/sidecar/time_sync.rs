//! `/sidecar/<id>/time_sync`: each exchange of times as it went, so that a device's clock can be estimated again.

use lsfb_drivers::sidecar::wire::TimeExchange;
use lsfb_recording::message::{CdrError, CdrReader, Schema};
use lsfb_types::Timestamp;

use super::topics::TIME_SYNC;
use crate::clock::Exchange;
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
    let stamps = [
        exchange.t1_ns,
        exchange.t2_ns,
        exchange.t3_ns,
        exchange.t4_ns,
    ];
    OwnMessage {
        topic: format!("/sidecar/{device}{TIME_SYNC}"),
        schema: SCHEMA,
        time: Timestamp::from_nanos(exchange.t3_ns),
        arrival,
        bytes: encode(clock_id, stamps),
    }
}

fn encode(clock_id: &str, stamps: [i64; 4]) -> Vec<u8> {
    let mut body = Vec::with_capacity(64 + clock_id.len());
    body.extend((clock_id.len() as u32 + 1).to_le_bytes());
    body.extend(clock_id.as_bytes());
    body.push(0);
    // Eight-byte numbers stand at multiples of eight.
    body.resize(body.len().next_multiple_of(8), 0);
    body.extend(stamps.into_iter().flat_map(i64::to_le_bytes));
    [&ENCAPSULATION[..], &body].concat()
}

/// The name of a clock and one exchange with it.
pub(crate) fn decode_exchange(bytes: &[u8]) -> Result<(String, Exchange), CdrError> {
    let mut r = CdrReader::new(bytes)?;
    let clock_id = r.string("clock_id")?.to_owned();
    let mut stamp = |field| r.u64(field).map(u64::cast_signed);
    let exchange = Exchange {
        t1_ns: stamp("t1_ns")?,
        t2_ns: stamp("t2_ns")?,
        t3_ns: stamp("t3_ns")?,
        t4_ns: stamp("t4_ns")?,
    };
    Ok((clock_id, exchange))
}

/// The message of an exchange, for recordings that tests write.
#[cfg(test)]
pub(crate) fn encode_exchange(clock_id: &str, exchange: &Exchange) -> (Schema, Vec<u8>) {
    let Exchange {
        t1_ns,
        t2_ns,
        t3_ns,
        t4_ns,
    } = *exchange;
    (SCHEMA, encode(clock_id, [t1_ns, t2_ns, t3_ns, t4_ns]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exchange_comes_back_and_every_cut_one_is_refused() {
        let exchange = Exchange {
            t1_ns: -1,
            t2_ns: i64::MAX,
            t3_ns: 3,
            t4_ns: i64::MIN,
        };
        for clock_id in ["utc", "android.elapsedRealtime", ""] {
            let (_, bytes) = encode_exchange(clock_id, &exchange);
            assert_eq!(decode_exchange(&bytes), Ok((clock_id.to_owned(), exchange)));
            for cut in 0..bytes.len() {
                assert!(decode_exchange(&bytes[..cut]).is_err(), "{cut}");
            }
        }
    }
}
