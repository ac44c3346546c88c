//! Byte vectors made with Python's `protobuf` package from the message definitions in `wire/mod.rs`; `docs/sidecar.md` shows them
//! to whoever writes an app, and a test there reads them back.

use super::*;
use crate::sidecar::credentials::{DeviceKey, PairingToken, to_hex};
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
        device_key: DeviceKey([0; 32]),
        pairing_token: None,
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
            device_key: DeviceKey([1; 32]),
            pairing_token: None,
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
            kind: EnvelopeKind::ALL[random.below(9)],
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
            let _ = TimeRequest::parse(&bytes);
            let _ = TimeResponse::parse(&bytes);
            let _ = State::parse(&bytes);
        }
    }
}

/// What `docs/sidecar.md` shows to whoever writes an app: whole envelopes by name.
fn vectors() -> Vec<(String, Vec<u8>)> {
    let page = include_str!("../../../../docs/sidecar.md");
    let rows = page.lines().filter_map(|line| {
        let (name, hex) = line.strip_prefix("VECTOR ")?.split_once(' ')?;
        let hex = hex.trim();
        let bytes = (0..hex.len() / 2).map(|at| u8::from_str_radix(&hex[2 * at..2 * at + 2], 16));
        Some((name.to_owned(), bytes.collect::<Result<_, _>>().unwrap()))
    });
    rows.collect()
}

#[test]
fn the_vectors_of_the_protocol_document_are_read_and_written() {
    let hello = Hello {
        session: "0b2f7c1e-walk".to_owned(),
        first_unacked: 1,
        device: "pixel8".to_owned(),
        device_key: DeviceKey(std::array::from_fn(|at| at as u8)),
        pairing_token: Some(PairingToken(std::array::from_fn(|at| at as u8 + 16))),
    };
    let asked = TimeRequest {
        t1_ns: 5_000_000_123,
        clock_id: "android.elapsedRealtime".to_owned(),
        last: TimeExchange {
            t1_ns: 4_000_000_000,
            t2_ns: 1_772_359_200_000_000_000,
            t3_ns: 1_772_359_200_000_100_000,
            t4_ns: 4_003_000_000,
        },
    };
    let answered = TimeResponse {
        t1_ns: 5_000_000_123,
        t2_ns: 1_772_359_201_000_000_000,
        t3_ns: 1_772_359_201_000_050_000,
    };
    let refused = State {
        refusal: Some(Refusal::Gap),
        text: "gap in the numbers".to_owned(),
    };
    let (hello, asked) = (hello.emit(), asked.emit());
    let (answered, refused) = (answered.emit(), refused.emit());
    let data = Envelope {
        kind: EnvelopeKind::Data,
        channel: 300,
        seq: (1 << 40) + 5,
        device_time_ns: 1_772_359_200_123_456_789,
        payload: &[1, 2, 3, 250],
    };
    let expected = [
        ("HELLO", Envelope::around(EnvelopeKind::Hello, &hello)),
        ("DATA", data),
        ("ACK", Envelope::bare(EnvelopeKind::Ack, 128)),
        ("CREDIT", Envelope::bare(EnvelopeKind::Credit, 4 << 20)),
        (
            "TIME_REQ",
            Envelope::around(EnvelopeKind::TimeRequest, &asked),
        ),
        (
            "TIME_RESP",
            Envelope::around(EnvelopeKind::TimeResponse, &answered),
        ),
        ("STATE", Envelope::around(EnvelopeKind::State, &refused)),
        ("BYE", Envelope::bare(EnvelopeKind::Bye, 5)),
    ];
    let vectors = vectors();
    let names: Vec<&str> = vectors.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, expected.map(|(name, _)| name));
    for ((name, bytes), (_, envelope)) in vectors.iter().zip(expected) {
        assert_eq!(Envelope::parse(bytes), Ok(envelope), "{name}");
        assert_eq!(to_hex(&envelope.emit().unwrap()), to_hex(bytes), "{name}");
    }
    assert_eq!(Hello::parse(&hello).unwrap().emit(), hello);
    assert_eq!(TimeRequest::parse(&asked).unwrap().emit(), asked);
    assert_eq!(TimeResponse::parse(&answered).unwrap().emit(), answered);
    assert_eq!(State::parse(&refused).unwrap().emit(), refused);
}

/// The document names every reason by its number.
#[test]
fn the_protocol_document_names_every_refusal() {
    let page = include_str!("../../../../docs/sidecar.md");
    for refusal in Refusal::ALL {
        let row = format!("| {} | {} |", refusal.code(), refusal.name());
        assert!(page.contains(&row), "{row}");
    }
}

proptest::proptest! {
    #[test]
    fn whatever_is_written_is_read_back(
        kind in 0..9_usize,
        channel: u32,
        seq: u64,
        device_time_ns: i64,
        payload in proptest::collection::vec(proptest::num::u8::ANY, 0..600),
    ) {
        let kind = EnvelopeKind::ALL[kind];
        let envelope = Envelope { kind, channel, seq, device_time_ns, payload: &payload };
        let bytes = envelope.emit().unwrap();
        proptest::prop_assert_eq!(Envelope::parse(&bytes), Ok(envelope));
        // One bit of the payload or of its checksum is found out.
        if !payload.is_empty() {
            let mut damaged = bytes.clone();
            let at = damaged.len() - 1 - (seq % (payload.len() as u64 + 4)) as usize;
            damaged[at] ^= 1 << (channel % 8);
            proptest::prop_assert_ne!(Envelope::parse(&damaged), Ok(envelope));
        }
    }

    #[test]
    fn any_bytes_give_a_value_or_an_error(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..200)) {
        if let Ok(envelope) = Envelope::parse(&bytes) {
            let written = envelope.emit().unwrap();
            proptest::prop_assert_eq!(Envelope::parse(&written), Ok(envelope));
        }
        let _ = (Hello::parse(&bytes), Advertise::parse(&bytes), State::parse(&bytes));
        let _ = (TimeRequest::parse(&bytes), TimeResponse::parse(&bytes));
    }
}
