use super::*;

/// Published by others in a public repository: full output of a unit at rest.
const ALL_OUTPUTS: &[u8] = &[
    0xFA, 0xFF, 0x36, 0x4E, 0x10, 0x60, 0x04, 0x02, 0x53, 0x35, 0xCB, 0x20, 0x10, 0x10, 0x3F, 0x7F,
    0xFA, 0x66, 0xBB, 0x40, 0x34, 0xB8, 0x3C, 0x49, 0x96, 0x2D, 0x3B, 0x5A, 0x1F, 0x82, 0x80, 0x20,
    0x0C, 0x39, 0xFF, 0x91, 0x01, 0xBA, 0xEC, 0xDD, 0x81, 0xBA, 0x86, 0x53, 0x80, 0x40, 0x20, 0x0C,
    0xBE, 0x64, 0xDB, 0x99, 0xBC, 0xE7, 0xFF, 0x83, 0x41, 0x1D, 0xC2, 0xCF, 0xC0, 0x20, 0x0C, 0xBE,
    0x90, 0x48, 0x80, 0x3F, 0x67, 0x32, 0x04, 0xBF, 0x54, 0x89, 0x04, 0xE0, 0x20, 0x04, 0x00, 0x00,
    0x00, 0x03, 0xC9,
];
/// As above: sample time and Euler angles.
const EULER: &[u8] = &[
    0xFA, 0xFF, 0x36, 0x16, 0x10, 0x60, 0x04, 0x09, 0x3A, 0x7C, 0xB7, 0x20, 0x30, 0x0C, 0xBF, 0x49,
    0x1A, 0x52, 0xBE, 0xC3, 0x6A, 0x10, 0xC3, 0x2E, 0xE2, 0xEF, 0x3E,
];
/// As above: packet counter and Euler angles.
const COUNTER: &[u8] = &[
    0xFA, 0xFF, 0x36, 0x14, 0x10, 0x20, 0x02, 0x00, 0x09, 0x20, 0x30, 0x0C, 0xBF, 0xBC, 0x67, 0xE0,
    0x3E, 0xDF, 0xAE, 0x81, 0x40, 0xA3, 0xA9, 0xDF, 0xA7,
];
/// As above: rate of turn at the sensor's own rate.
const RATE_HR: &[u8] = &[
    0xFA, 0xFF, 0x36, 0x0F, 0x80, 0x40, 0x0C, 0x3B, 0x8B, 0xBC, 0x00, 0xBB, 0xE2, 0x4F, 0x00, 0x3B,
    0x4E, 0x4A, 0x00, 0xAF,
];
/// Computed from the format's description by a script of its own.
const COMPUTED: &[u8] = &[
    0xFA, 0xFF, 0x36, 0x4F, 0x10, 0x20, 0x02, 0xFF, 0xFF, 0x10, 0x60, 0x04, 0x07, 0x5B, 0xCD, 0x15,
    0x40, 0x20, 0x0C, 0x3F, 0x00, 0x00, 0x00, 0xBE, 0x80, 0x00, 0x00, 0x41, 0x1D, 0x00, 0x00, 0x80,
    0x20, 0x0C, 0x3E, 0x00, 0x00, 0x00, 0xBF, 0x00, 0x00, 0x00, 0x3F, 0x80, 0x00, 0x00, 0xC0, 0x20,
    0x0C, 0x3E, 0x80, 0x00, 0x00, 0x3F, 0x00, 0x00, 0x00, 0xBF, 0x40, 0x00, 0x00, 0x10, 0x10, 0x0C,
    0x1D, 0xCD, 0x65, 0x00, 0x07, 0xEA, 0x05, 0x11, 0x0C, 0x22, 0x38, 0x07, 0xE0, 0x20, 0x04, 0x00,
    0x00, 0x00, 0x03, 0x07,
];
/// Asks for counter, sample time, acceleration and rate of turn at 400 Hz; computed.
const SET_OUTPUTS: &[u8] = &[
    0xFA, 0xFF, 0xC0, 0x10, 0x10, 0x20, 0xFF, 0xFF, 0x10, 0x60, 0xFF, 0xFF, 0x40, 0x20, 0x01, 0x90,
    0x80, 0x20, 0x01, 0x90, 0x73,
];

fn items(bytes: &[u8]) -> Vec<Item<'_>> {
    let parsed = Message::parse(bytes).unwrap().unwrap();
    assert_eq!(parsed.len, bytes.len());
    assert_eq!(parsed.message.id, 0x36);
    Items::new(parsed.message.data)
        .collect::<Result<_, _>>()
        .unwrap()
}

fn emitted(items: &[Item<'_>]) -> Vec<u8> {
    let mut data = Vec::new();
    for item in items {
        item.emit(&mut data).unwrap();
    }
    let mut bytes = Vec::new();
    let message = Message {
        id: 0x36,
        data: &data,
    };
    message.emit(&mut bytes).unwrap();
    bytes
}

fn assert_near<const N: usize>(got: [f64; N], expected: [f64; N], tolerance: f64) {
    for (got, expected) in got.iter().zip(&expected) {
        assert!((got - expected).abs() < tolerance, "{got} {expected}");
    }
}

#[test]
fn a_real_packet_with_all_outputs() {
    let items = items(ALL_OUTPUTS);
    let [
        Item::SampleTimeFine(39_007_691),
        Item::Quaternion { wxyz, coding },
        Item::RateOfTurn(rate),
        Item::Acceleration(force),
        Item::MagneticField(magnetic),
        Item::StatusWord(3),
    ] = items.as_slice()
    else {
        panic!("{items:?}");
    };
    assert_eq!(*coding, Coding::default());
    assert_near(*wxyz, [0.9999145, -0.0029328, 0.0123039, 0.0033283], 5e-8);
    assert_near(rate.xyz, [0.0004875, -0.0018071, -0.0010248], 5e-8);
    assert_near(force.xyz, [-0.2234939, -0.0283201, 9.8600607], 5e-7);
    assert_near(magnetic.xyz, [-0.2818031, 0.9031069, -0.8302157], 5e-8);
    for vector in [rate, force, magnetic] {
        assert_eq!(vector.coding, Coding::default());
    }
    assert_eq!(emitted(&items), ALL_OUTPUTS);
}

#[test]
fn real_packets_with_angles_counter_and_high_rate() {
    let euler = items(EULER);
    let [
        Item::SampleTimeFine(154_827_959),
        Item::EulerAnglesDeg(angles),
    ] = euler.as_slice()
    else {
        panic!("{euler:?}");
    };
    assert_near(angles.xyz, [-0.78556, -0.38167, -174.88646], 5e-6);
    assert_eq!(emitted(&euler), EULER);

    let counter = items(COUNTER);
    let [Item::PacketCounter(9), Item::EulerAnglesDeg(angles)] = counter.as_slice() else {
        panic!("{counter:?}");
    };
    assert_near(angles.xyz, [-1.47192, 0.43688, 5.11449], 5e-6);
    assert_eq!(emitted(&counter), COUNTER);

    let high_rate = items(RATE_HR);
    let [Item::RateOfTurnHr(rate)] = high_rate.as_slice() else {
        panic!("{high_rate:?}");
    };
    assert_near(rate.xyz, [0.0042644, -0.0069064, 0.0031477], 5e-8);
    assert_eq!(emitted(&high_rate), RATE_HR);
}

#[test]
fn a_computed_packet_with_utc() {
    let utc = UtcTime {
        nanosecond: 500_000_000,
        year: 2026,
        month: 5,
        day: 17,
        hour: 12,
        minute: 34,
        second: 56,
        flags: 7,
    };
    let expected = [
        Item::PacketCounter(65_535),
        Item::SampleTimeFine(123_456_789),
        Item::Acceleration(Vector::single([0.5, -0.25, 9.8125])),
        Item::RateOfTurn(Vector::single([0.125, -0.5, 1.0])),
        Item::MagneticField(Vector::single([0.25, 0.5, -0.75])),
        Item::Utc(utc),
        Item::StatusWord(3),
    ];
    assert_eq!(items(COMPUTED), expected);
    assert_eq!(emitted(&expected), COMPUTED);
    // `date -u -d '2026-05-17 12:34:56' +%s`
    assert_eq!(utc.unix_nanos(), Some(1_779_021_296_500_000_000));
}

#[test]
fn every_kind_of_item_survives_the_wire() {
    let trigger = TriggerIn {
        line: 1,
        polarity: 2,
        sample_time_fine: 0x0102_0304,
        frame_number: 513,
    };
    for precision in [
        Precision::F32,
        Precision::Fixed1220,
        Precision::Fixed1632,
        Precision::F64,
    ] {
        for frame_bits in [0, 4, 8] {
            let coding = Coding {
                precision,
                frame_bits,
            };
            // Exact in every coding.
            let vector = Vector {
                xyz: [-0.5, 1023.25, -2048.0],
                coding,
            };
            let all = [
                Item::Temperature {
                    celsius: -12.75,
                    coding,
                },
                Item::Quaternion {
                    wxyz: [0.5, -0.5, 0.25, -1.0],
                    coding,
                },
                Item::EulerAnglesDeg(vector),
                Item::DeltaV(vector),
                Item::Acceleration(vector),
                Item::AccelerationHr(vector),
                Item::RateOfTurn(vector),
                Item::RateOfTurnHr(vector),
                Item::MagneticField(vector),
                Item::SampleTimeCoarse(7),
                Item::PressurePa(101_325),
                Item::TriggerIn1(trigger),
                Item::TriggerIn2(trigger),
                Item::StatusByte(0x81),
                Item::Other {
                    id: 0x5040,
                    value: &[1, 2, 3],
                },
            ];
            assert_eq!(items(&emitted(&all)), all);
        }
    }
}

#[test]
fn fixed_point_has_the_documented_byte_order() {
    let at = |precision| {
        let coding = Coding {
            precision,
            frame_bits: 0,
        };
        let mut bytes = Vec::new();
        let vector = Vector {
            xyz: [-1.5, 0.0, 0.0],
            coding,
        };
        Item::Acceleration(vector).emit(&mut bytes).unwrap();
        bytes
    };
    assert_eq!(
        at(Precision::Fixed1220)[..7],
        [0x40, 0x21, 12, 0xFF, 0xE8, 0x00, 0x00]
    );
    // −1.5 = −2 + 0.5: fraction first, then the integer part.
    assert_eq!(
        at(Precision::Fixed1632)[..9],
        [0x40, 0x22, 18, 0x80, 0x00, 0x00, 0x00, 0xFF, 0xFE]
    );
}

#[test]
fn commands_have_the_documented_bytes() {
    let command = |id| {
        let mut bytes = Vec::new();
        Message { id, data: &[] }.emit(&mut bytes).unwrap();
        bytes
    };
    assert_eq!(command(0x30), [0xFA, 0xFF, 0x30, 0x00, 0xD1]);
    assert_eq!(command(0x10), [0xFA, 0xFF, 0x10, 0x00, 0xF1]);
    assert_eq!(command(0x00), [0xFA, 0xFF, 0x00, 0x00, 0x01]);
    assert_eq!(command(0x3E), [0xFA, 0xFF, 0x3E, 0x00, 0xC3]);

    let settings = [
        (0x1020, 0xFFFF),
        (0x1060, 0xFFFF),
        (0x4020, 400),
        (0x8020, 400),
    ]
    .map(|(id, rate_hz)| OutputSetting { id, rate_hz });
    let data = OutputSetting::emit_all(&settings);
    let mut bytes = Vec::new();
    Message {
        id: 0xC0,
        data: &data,
    }
    .emit(&mut bytes)
    .unwrap();
    assert_eq!(bytes, SET_OUTPUTS);
    assert_eq!(OutputSetting::parse_all(&data), Ok(settings.to_vec()));
    assert_eq!(
        OutputSetting::parse_all(&data[1..]),
        Err(WireError::Length {
            expected: 12,
            got: 15
        })
    );
}

#[test]
fn long_messages_use_the_extended_length() {
    for len in [253, 254, 255, 256, MAX_DATA_LEN] {
        let data = vec![0xA5; len];
        let mut bytes = Vec::new();
        Message {
            id: 0x36,
            data: &data,
        }
        .emit(&mut bytes)
        .unwrap();
        assert_eq!(bytes.len(), len + if len < 255 { 5 } else { 7 });
        let parsed = Message::parse(&bytes).unwrap().unwrap();
        assert_eq!((parsed.message.data, parsed.len), (&data[..], bytes.len()));
    }
    let data = vec![0; MAX_DATA_LEN + 1];
    let too_long = Message {
        id: 0x36,
        data: &data,
    };
    assert!(too_long.emit(&mut Vec::new()).is_err());
}

#[test]
fn damage_is_named_and_a_beginning_is_no_damage() {
    for len in 0..COMPUTED.len() {
        assert_eq!(Message::parse(&COMPUTED[..len]), Ok(None), "{len}");
    }
    let mut bytes = COMPUTED.to_vec();
    bytes[40] ^= 0x10;
    assert!(matches!(
        Message::parse(&bytes),
        Err(WireError::Checksum { .. })
    ));
    bytes[0] = 0xFB;
    assert_eq!(
        Message::parse(&bytes),
        Err(WireError::Constant {
            offset: 0,
            expected: 0xFA,
            got: 0xFB
        })
    );
    // An item that says it is longer than the packet.
    let mut cut = Items::new(&[0x10, 0x20, 4, 0, 1]);
    assert_eq!(
        cut.next(),
        Some(Err(WireError::Length {
            expected: 7,
            got: 5
        }))
    );
    assert_eq!(cut.next(), None);
}

#[test]
fn utc_reaches_across_leap_years_and_back() {
    // From `date -u -d … +%s`.
    for (date, seconds) in [
        ((1970, 1, 1, 0, 0, 0), 0),
        ((2000, 2, 29, 23, 59, 59), 951_868_799),
        ((2000, 3, 1, 0, 0, 0), 951_868_800),
        ((2026, 3, 1, 10, 0, 0), 1_772_359_200),
        ((2100, 2, 28, 12, 0, 0), 4_107_499_200),
        ((2100, 3, 1, 0, 0, 0), 4_107_542_400),
    ] {
        let (year, month, day, hour, minute, second) = date;
        let time = UtcTime {
            nanosecond: 123_456_789,
            year,
            month,
            day,
            hour,
            minute,
            second,
            flags: UtcTime::VALID,
        };
        let nanos = seconds * 1_000_000_000 + 123_456_789;
        assert_eq!(time.unix_nanos(), Some(nanos), "{date:?}");
        assert_eq!(UtcTime::from_unix_nanos(nanos), Some(time));
    }
    for day in 0..84_371 {
        let nanos = day * 86_400_000_000_000;
        let time = UtcTime::from_unix_nanos(nanos).unwrap();
        assert_eq!(time.unix_nanos(), Some(nanos));
    }
    assert_eq!(UtcTime::from_unix_nanos(-1), None);
    assert_eq!(UtcTime::from_unix_nanos(i64::MAX), None);
    let unknown = UtcTime {
        flags: 3,
        ..UtcTime::from_unix_nanos(0).unwrap()
    };
    assert_eq!(unknown.unix_nanos(), None);
}

#[test]
fn no_bytes_make_the_parsers_panic() {
    let mut random = crate::test_random::Random::new(1);
    for round in 0..20_000 {
        let mut bytes = COMPUTED.to_vec();
        if round % 2 == 0 {
            random.mutate(&mut bytes);
        } else {
            bytes = random.bytes(90);
        }
        let _ = Message::parse(&bytes);
        for item in Items::new(&bytes).flatten() {
            let _ = item.emit(&mut Vec::new());
        }
        let _ = OutputSetting::parse_all(&bytes);
    }
}
