//! Byte vectors made with Python's `protobuf` package from the message definitions in `wire.rs`.

use super::*;
use crate::test_random::Random;

const DATA: &[u8] = &[
    0x08, 0x03, 0x10, 0xAC, 0x02, 0x18, 0x85, 0x80, 0x80, 0x80, 0x80, 0x20, 0x20, 0x95, 0x9A, 0x84,
    0xCE, 0xD5, 0xE9, 0xAB, 0xCC, 0x18, 0x2A, 0x04, 0x01, 0x02, 0x03, 0xFA, 0x35, 0xA6, 0x5C, 0x26,
    0x76,
];
const NEGATIVE_TIME: &[u8] = &[
    0x08, 0x03, 0x10, 0x01, 0x18, 0x01, 0x20, 0xFE, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF,
    0x01, 0x2A, 0x01, 0x00, 0x35, 0x51, 0x53, 0x7D, 0x52,
];
const ACK: &[u8] = &[0x08, 0x04, 0x18, 0x80, 0x01];
const HELLO: &[u8] = &[
    0x0A, 0x02, 0x61, 0x31, 0x10, 0x01, 0x1A, 0x08, 0x67, 0x6C, 0x61, 0x73, 0x73, 0x65, 0x73, 0x30,
];
const ADVERTISE: &[u8] = &[
    0x08, 0x02, 0x12, 0x04, 0x2F, 0x69, 0x6D, 0x75, 0x1A, 0x03, 0x63, 0x64, 0x72, 0x22, 0x13, 0x73,
    0x65, 0x6E, 0x73, 0x6F, 0x72, 0x5F, 0x6D, 0x73, 0x67, 0x73, 0x2F, 0x6D, 0x73, 0x67, 0x2F, 0x49,
    0x6D, 0x75, 0x2A, 0x09, 0x66, 0x6C, 0x6F, 0x61, 0x74, 0x36, 0x34, 0x20, 0x78, 0x32, 0x03, 0x75,
    0x74, 0x63, 0x3A, 0x0C, 0x7B, 0x22, 0x72, 0x69, 0x67, 0x22, 0x3A, 0x22, 0xC3, 0xA9, 0x22, 0x7D,
];

#[test]
fn envelopes_with_every_field() {
    let data = Envelope {
        kind: EnvelopeKind::Data,
        channel: 300,
        seq: (1 << 40) + 5,
        device_time_ns: 1_772_359_200_123_456_789,
        payload: &[1, 2, 3, 250],
    };
    let negative_time = Envelope {
        kind: EnvelopeKind::Data,
        channel: 1,
        seq: 1,
        device_time_ns: -2,
        payload: &[0],
    };
    let ack = Envelope::bare(EnvelopeKind::Ack, 128);
    for (envelope, bytes) in [(data, DATA), (negative_time, NEGATIVE_TIME), (ack, ACK)] {
        assert_eq!(Envelope::parse(bytes), Ok(envelope));
        assert_eq!(envelope.emit().unwrap(), bytes);
    }
    for kind in EnvelopeKind::ALL {
        let envelope = Envelope::bare(kind, 1);
        assert_eq!(Envelope::parse(&envelope.emit().unwrap()), Ok(envelope));
    }
}

#[test]
fn messages_with_every_field() {
    let hello = Hello {
        session: "a1".to_owned(),
        first_unacked: 1,
        device: "glasses0".to_owned(),
    };
    assert_eq!(Hello::parse(HELLO), Ok(hello.clone()));
    assert_eq!(hello.emit(), HELLO);
    let advertise = Advertise {
        channel: 2,
        topic: "/imu".to_owned(),
        encoding: "cdr".to_owned(),
        schema_name: "sensor_msgs/msg/Imu".to_owned(),
        schema: b"float64 x".to_vec(),
        clock_id: "utc".to_owned(),
        metadata_json: "{\"rig\":\"é\"}".to_owned(),
    };
    assert_eq!(Advertise::parse(ADVERTISE), Ok(advertise.clone()));
    assert_eq!(advertise.emit(), ADVERTISE);
}

#[test]
fn unknown_fields_are_passed_over() {
    let mut bytes = vec![0x58, 0x96, 0x01, 0x61, 1, 2, 3, 4, 5, 6, 7, 8];
    bytes.extend([0x6A, 2, 9, 9, 0x75, 1, 2, 3, 4]);
    let whole = [bytes.as_slice(), ACK, bytes.as_slice()].concat();
    assert_eq!(
        Envelope::parse(&whole),
        Ok(Envelope::bare(EnvelopeKind::Ack, 128))
    );
}

#[test]
fn damage_is_named() {
    let mut damaged = DATA.to_vec();
    damaged[26] ^= 1;
    assert!(matches!(
        Envelope::parse(&damaged),
        Err(WireError::Checksum { .. })
    ));
    assert!(matches!(
        Envelope::parse(&DATA[..25]),
        Err(WireError::Length { .. })
    ));
    // No type, a type that does not exist, groups, a number without end, a channel beyond 32 bits.
    for bytes in [
        &[][..],
        &[0x08, 0x63],
        &[0x0B],
        &[
            0x18, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x02,
        ],
        &[0x10, 0xFF, 0xFF, 0xFF, 0xFF, 0x7F],
    ] {
        assert!(
            matches!(Envelope::parse(bytes), Err(WireError::Value { .. })),
            "{bytes:x?}"
        );
    }
    assert_eq!(
        Hello::parse(&[0x0A, 2, 0x61, 0xFF]),
        Err(WireError::Value {
            field: "text",
            offset: 1,
            got: 0xFF
        })
    );
    for name in ["", "../rig", "a b", &"a".repeat(65)] {
        let hello = Hello {
            session: "s".to_owned(),
            first_unacked: 1,
            device: name.to_owned(),
        };
        assert!(matches!(
            Hello::parse(&hello.emit()),
            Err(WireError::Value {
                field: "device name",
                ..
            })
        ));
    }
    let payload = vec![0; MAX_ENVELOPE_BYTES];
    let too_long = Envelope {
        payload: &payload,
        ..Envelope::bare(EnvelopeKind::Data, 1)
    };
    assert!(matches!(too_long.emit(), Err(WireError::Length { .. })));
    assert!(matches!(
        Envelope::parse(&[0; MAX_ENVELOPE_BYTES + 1]),
        Err(WireError::Length { .. })
    ));
}

#[test]
fn random_envelopes_round_trip() {
    let mut random = Random::new(6);
    for _ in 0..2000 {
        let payload = random.bytes(300);
        let shift = random.below(64);
        let envelope = Envelope {
            kind: EnvelopeKind::ALL[random.below(5)],
            channel: random.next() as u32 >> random.below(32),
            seq: random.next() >> shift,
            device_time_ns: random.next().cast_signed() >> shift,
            payload: &payload,
        };
        let bytes = envelope.emit().unwrap();
        assert_eq!(Envelope::parse(&bytes), Ok(envelope));
    }
}

#[test]
fn no_bytes_make_the_parsers_panic() {
    let mut random = Random::new(7);
    for round in 0..20_000 {
        for seed in [DATA, ACK, HELLO, ADVERTISE] {
            let mut bytes = seed.to_vec();
            if round % 4 == 0 {
                bytes = random.bytes(60);
            } else {
                random.mutate(&mut bytes);
            }
            if let Ok(envelope) = Envelope::parse(&bytes) {
                envelope.emit().unwrap();
            }
            let _ = Hello::parse(&bytes);
            let _ = Advertise::parse(&bytes);
        }
    }
}
