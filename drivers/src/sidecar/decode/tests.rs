use super::*;
use crate::sidecar::credentials::DeviceKey;

fn hello(first_unacked: u64) -> Vec<u8> {
    let hello = Hello {
        session: "s".to_owned(),
        first_unacked,
        device: "d".to_owned(),
        device_key: DeviceKey([1; 32]),
        pairing_token: None,
    };
    let envelope = Envelope {
        payload: &hello.emit(),
        ..Envelope::bare(EnvelopeKind::Hello, 0)
    };
    envelope.emit().unwrap()
}

fn advertise(channel: u32) -> Vec<u8> {
    let advertise = Advertise {
        channel,
        topic: format!("/topic{channel}"),
        ..Default::default()
    };
    let envelope = Envelope {
        payload: &advertise.emit(),
        ..Envelope::bare(EnvelopeKind::Advertise, 0)
    };
    envelope.emit().unwrap()
}

fn data(channel: u32, seq: u64) -> Vec<u8> {
    let envelope = Envelope {
        channel,
        device_time_ns: -5,
        payload: &[1, 2],
        ..Envelope::bare(EnvelopeKind::Data, seq)
    };
    envelope.emit().unwrap()
}

fn bare(kind: EnvelopeKind, seq: u64) -> Vec<u8> {
    Envelope::bare(kind, seq).emit().unwrap()
}

#[test]
fn repetitions_are_dropped_and_what_is_wrong_is_an_error() {
    let mut decoder = Decoder::new();
    assert!(matches!(
        decoder.push(&hello(1)),
        Ok(Some(SidecarMessage::Hello(_)))
    ));
    assert!(matches!(
        decoder.push(&advertise(3)),
        Ok(Some(SidecarMessage::Advertise(_)))
    ));
    assert_eq!(
        decoder.push(&data(3, 1)),
        Ok(Some(SidecarMessage::Data {
            channel: 3,
            seq: 1,
            device_time_ns: -5,
            payload: vec![1, 2],
        }))
    );
    assert_eq!(decoder.push(&data(3, 1)), Ok(None));
    let gap = |expected, got| Err(DecodeError::Gap { expected, got });
    assert_eq!(decoder.push(&data(3, 4)), gap(2, 4));
    assert_eq!(decoder.push(&bare(EnvelopeKind::Bye, 7)), gap(2, 7));
    let mut damaged = data(3, 2);
    let at = damaged.len() - 1;
    damaged[at] ^= 1;
    assert!(matches!(
        decoder.push(&damaged),
        Err(DecodeError::Wire(WireError::Checksum { .. }))
    ));
    assert!(matches!(
        decoder.push(&data(9, 2)),
        Err(DecodeError::Wire(WireError::Value { .. }))
    ));
    // None of it has moved the session on.
    assert!(decoder.push(&data(3, 2)).unwrap().is_some());
    assert_eq!(
        decoder.push(&bare(EnvelopeKind::Bye, 2)),
        Ok(Some(SidecarMessage::Bye { last_seq: 2 }))
    );
    assert_eq!(
        decoder.counters(),
        SidecarCounters {
            data: 2,
            payload_bytes: 4,
            duplicated: 1,
        }
    );
}

#[test]
fn a_session_begins_with_hello_and_only_once() {
    let mut decoder = Decoder::new();
    assert!(decoder.push(&advertise(1)).is_err());
    assert!(decoder.push(&hello(11)).is_ok());
    assert!(decoder.push(&hello(11)).is_err());
    for kind in [
        EnvelopeKind::Ack,
        EnvelopeKind::Credit,
        EnvelopeKind::TimeResponse,
        EnvelopeKind::State,
    ] {
        assert!(decoder.push(&bare(kind, 1)).is_err(), "{kind:?}");
    }
    // What the rig has of earlier connections is a repetition.
    decoder.resume_after(12);
    assert!(decoder.push(&advertise(1)).is_ok());
    assert_eq!(decoder.push(&data(1, 11)), Ok(None));
    assert_eq!(decoder.push(&data(1, 12)), Ok(None));
    assert!(decoder.push(&data(1, 13)).unwrap().is_some());
    assert_eq!(decoder.last_seq(), 13);
}

#[test]
fn channels_are_limited() {
    let mut decoder = Decoder::new();
    decoder.push(&hello(1)).unwrap();
    for channel in 0..64 {
        decoder.push(&advertise(channel)).unwrap();
    }
    assert!(decoder.push(&advertise(64)).is_err());
    // Described again in the same way is no news, in another way an error.
    assert_eq!(decoder.push(&advertise(63)), Ok(None));
    let other = Envelope {
        payload: &Advertise {
            channel: 63,
            ..Default::default()
        }
        .emit(),
        ..Envelope::bare(EnvelopeKind::Advertise, 0)
    }
    .emit()
    .unwrap();
    assert!(decoder.push(&other).is_err());
}
