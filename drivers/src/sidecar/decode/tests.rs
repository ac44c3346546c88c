use super::*;

fn hello(first_unacked: u64) -> Vec<u8> {
    let hello = Hello {
        session: "s".to_owned(),
        first_unacked,
        device: "d".to_owned(),
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
fn gaps_repetitions_and_damage_are_counted() {
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
    assert!(decoder.push(&data(3, 4)).unwrap().is_some());
    assert_eq!(decoder.push(&data(3, 2)), Ok(None));
    let mut damaged = data(3, 5);
    let at = damaged.len() - 1;
    damaged[at] ^= 1;
    assert!(matches!(
        decoder.push(&damaged),
        Err(WireError::Checksum { .. })
    ));
    assert!(decoder.push(&data(9, 5)).is_err());
    assert_eq!(
        decoder.push(&bare(EnvelopeKind::Bye, 7)),
        Ok(Some(SidecarMessage::Bye { last_seq: 7 }))
    );
    assert_eq!(
        decoder.counters(),
        SidecarCounters {
            data: 2,
            payload_bytes: 4,
            bad_checksum: 1,
            malformed: 1,
            // 2 and 3, then 5 to 7.
            missing: 5,
            duplicated: 2,
        }
    );
}

#[test]
fn a_session_begins_with_hello_and_only_once() {
    let mut decoder = Decoder::new();
    assert!(decoder.push(&advertise(1)).is_err());
    assert!(decoder.push(&hello(11)).is_ok());
    assert!(decoder.push(&hello(11)).is_err());
    assert!(decoder.push(&bare(EnvelopeKind::Ack, 1)).is_err());
    // What was stored on an earlier connection is not missing.
    assert!(decoder.push(&advertise(1)).is_ok());
    assert!(decoder.push(&data(1, 11)).unwrap().is_some());
    assert_eq!((decoder.counters().missing, decoder.last_seq()), (0, 11));
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
    assert_eq!(decoder.counters().malformed, 2);
}
