use super::*;
use crate::microstrain::model::{command, field, set};

fn hex(text: &str) -> Vec<u8> {
    let digits: Vec<u8> = text.bytes().filter(|b| !b.is_ascii_whitespace()).collect();
    digits
        .chunks(2)
        .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap())
        .collect()
}

fn emit_fields(descriptor_set: u8, fields: &[Field<'_>]) -> Vec<u8> {
    let (mut payload, mut bytes) = (Vec::new(), Vec::new());
    for field in fields {
        field.emit(&mut payload).unwrap();
    }
    MipPacket {
        descriptor_set,
        payload: &payload,
    }
    .emit(&mut bytes)
    .unwrap();
    bytes
}

/// Every field of a packet, and the packet again from its fields.
fn round_trip(bytes: &[u8]) -> Vec<Field<'_>> {
    let parsed = MipPacket::parse(bytes).unwrap().unwrap();
    assert_eq!(parsed.len, bytes.len());
    let fields = parsed
        .packet
        .fields()
        .collect::<Result<Vec<_>, _>>()
        .unwrap();
    assert_eq!(emit_fields(parsed.packet.descriptor_set, &fields), bytes);
    fields
}

#[test]
fn a_real_packet_of_inertial_data() {
    // LORD-MicroStrain/mip_sdk, test/data/mip_data.bin, first packet of set 0x80 (MIT).
    let bytes = hex(
        "75658030 0AD500000041D8BAE040 0AD600000000007A1200 0E043C8EAF72BBDA6818BF7C52E8
         0E05BB469CCF39A34C8BBB8BE12F D771",
    );
    assert_eq!(
        round_trip(&bytes),
        [
            Field::ReferenceTimeNs(282_809_000_000),
            Field::ReferenceDeltaNs(8_000_000),
            Field::AccelerometerG([0.017_417_64, -0.006_665_24, -0.985_640_05]),
            Field::GyroscopeRadS([-0.003_030_59, 0.000_311_47, -0.004_268_79]),
        ]
        .map(|field| nearest(&bytes, field))
    );
}

/// The field of the packet whose floats print like those given: the reference has seven digits.
fn nearest<'a>(bytes: &'a [u8], expected: Field<'a>) -> Field<'a> {
    let parsed = MipPacket::parse(bytes).unwrap().unwrap();
    let close = |a: [f32; 3], b: [f32; 3]| (0..3).all(|i| (a[i] - b[i]).abs() < 1e-8);
    let found = parsed
        .packet
        .fields()
        .map(Result::unwrap)
        .find(|field| match (*field, expected) {
            (Field::AccelerometerG(a), Field::AccelerometerG(b))
            | (Field::GyroscopeRadS(a), Field::GyroscopeRadS(b)) => close(a, b),
            (a, b) => a == b,
        });
    found.unwrap_or_else(|| panic!("{expected:?} is not in the packet"))
}

#[test]
fn a_computed_packet_with_gps_time() {
    let bytes = hex(
        "756580340ad5000000055ee67cc00e043d4ccccdbccccccd3f8000000e053e000000bf0000003f800000
         0ed340fe240800000000092e00035afa",
    );
    let expected = [
        Field::ReferenceTimeNs(23_067_000_000),
        Field::AccelerometerG([0.05, -0.025, 1.0]),
        Field::GyroscopeRadS([0.125, -0.5, 1.0]),
        Field::GpsTime(GpsTime {
            time_of_week_secs: 123_456.5,
            week: 2350,
            flags: 3,
        }),
    ];
    assert_eq!(round_trip(&bytes), expected);
}

#[test]
fn every_other_field_survives() {
    let gps = GpsTime {
        time_of_week_secs: 0.25,
        week: 1,
        flags: 2,
    };
    let fields = [
        Field::MagnetometerGauss([0.25, 0.5, -0.75]),
        Field::DeltaThetaRad([1.0, 2.0, 3.0]),
        Field::DeltaVelocityGS([-1.0, -2.0, -3.0]),
        Field::PressureMbar(1013.25),
        Field::GpsTimestamp(gps),
        Field::Ticks(77),
        Field::ExternalTime {
            time_ns: 1 << 40,
            valid: 1,
        },
        Field::Other(RawField {
            descriptor: 0x2A,
            data: &[9; 5],
        }),
    ];
    let bytes = emit_fields(set::SENSOR, &fields);
    assert_eq!(round_trip(&bytes), fields);
    // Shared fields mean the same elsewhere, the others do not.
    let shared = [Field::GpsTime(gps), Field::ReferenceTimeNs(3)];
    assert_eq!(round_trip(&emit_fields(set::FILTER, &shared)), shared);
    let mut bytes = emit_fields(set::FILTER, &[Field::PressureMbar(1.0)]);
    assert!(matches!(round_trip(&bytes)[..], [Field::Other(_)]));
    bytes[2] = set::SENSOR;
    assert!(matches!(
        MipPacket::parse(&bytes),
        Err(WireError::Checksum { .. })
    ));
}

#[test]
fn commands_have_the_documented_bytes() {
    let entries = [
        field::REFERENCE_TIME,
        field::ACCELEROMETER,
        field::GYROSCOPE,
    ]
    .map(|descriptor| FormatEntry {
        descriptor,
        decimation: 10,
    });
    for (command, bytes) in [
        (Command::Ping, "7565 0102 0201 E0C6"),
        (Command::Idle, "7565 0102 0202 E1C7"),
        (Command::Resume, "7565 0102 0206 E5CB"),
        (
            Command::MessageFormat {
                data_set: set::SENSOR,
                entries: entries.to_vec(),
            },
            "75650C0E0E0F018003D5000A04000A05000A91CE",
        ),
    ] {
        let mut emitted = Vec::new();
        command.emit(&mut emitted).unwrap();
        assert_eq!(emitted, hex(bytes));
        let packet = MipPacket::parse(&emitted).unwrap().unwrap().packet;
        assert_eq!(packet.descriptor_set, command.descriptor_set());
        let raw = packet.raw_fields().next().unwrap().unwrap();
        assert_eq!(
            Command::parse(packet.descriptor_set, raw),
            Ok(Some(command))
        );
    }
    let ack = hex("7565 0104 04F10100 D56A");
    let packet = MipPacket::parse(&ack).unwrap().unwrap().packet;
    let raw = packet.raw_fields().next().unwrap().unwrap();
    let expected = Ack {
        descriptor: command::PING,
        code: 0,
    };
    assert_eq!(Ack::parse(raw), Ok(Some(expected)));
    let mut payload = Vec::new();
    expected.emit(&mut payload).unwrap();
    assert_eq!(payload, packet.payload);
}

#[test]
fn damage_is_named_and_a_beginning_is_no_damage() {
    let good = hex("7565 0104 04F10100 D56A");
    for end in 0..good.len() {
        assert_eq!(MipPacket::parse(&good[..end]), Ok(None), "{end}");
    }
    for at in 0..good.len() {
        let mut bad = good.clone();
        bad[at] ^= 0x20;
        let outcome = MipPacket::parse(&bad);
        assert!(!matches!(outcome, Ok(Some(_))), "{at}: {outcome:?}");
    }
    // Field lengths that do not fit.
    for payload in [&[0u8, 4][..], &[1, 4], &[3, 4], &[5], &[2, 4, 9]] {
        let packet = MipPacket {
            descriptor_set: set::SENSOR,
            payload,
        };
        assert!(packet.fields().any(|field| field.is_err()), "{payload:?}");
        assert!(packet.fields().count() <= 2);
    }
    let long = [0; 256];
    let too_long = MipPacket {
        descriptor_set: 1,
        payload: &long,
    };
    assert!(too_long.emit(&mut Vec::new()).is_err());
}
