use super::*;
use crate::microstrain::wire::MipPacket;
use crate::test_random::Random;

const PERIOD_NS: u64 = 5_000_000;

/// Packet number `n` of a unit at 200 Hz.
fn packet(n: u64) -> Vec<u8> {
    let fields = [
        Field::ReferenceTimeNs(1_000_000_000 + n * PERIOD_NS),
        Field::ReferenceDeltaNs(PERIOD_NS),
        Field::AccelerometerG([0.0, 0.5, -1.0]),
        Field::GyroscopeRadS([0.25, -0.5, n as f32]),
    ];
    let (mut payload, mut bytes) = (Vec::new(), Vec::new());
    for field in &fields {
        field.emit(&mut payload).unwrap();
    }
    MipPacket {
        descriptor_set: set::SENSOR,
        payload: &payload,
    }
    .emit(&mut bytes)
    .unwrap();
    bytes
}

fn piece(arrival_ns: i64, bytes: &[u8]) -> Packet {
    Packet {
        arrival: Timestamp::from_nanos(arrival_ns),
        bytes: bytes.to_vec(),
    }
}

#[test]
fn every_field_of_a_reading_from_pieces() {
    let mut decoder = Decoder::new();
    let bytes = [packet(0), packet(1)].concat();
    let mut readings = Vec::new();
    for (i, part) in bytes.chunks(7).enumerate() {
        decoder.push(&piece(i as i64, part));
        readings.extend(std::iter::from_fn(|| decoder.next_reading()));
    }
    let g = STANDARD_GRAVITY_M_S2;
    let expected = |n: u64, arrival| Decoded {
        arrival: Timestamp::from_nanos(arrival),
        device_ticks: 1_000_000_000 + n * PERIOD_NS,
        sample: MipReading {
            sample: Some(ImuSample {
                angular_velocity_rad_s: [0.25, -0.5, n as f64],
                specific_force_m_s2: [0.0, 0.5 * g, -g],
            }),
            delta_ns: Some(PERIOD_NS),
            ..MipReading::default()
        },
    };
    // The second packet begins at byte 54: in the eighth piece of seven bytes.
    assert_eq!(bytes.len(), 2 * 54);
    assert_eq!(readings, [expected(0, 0), expected(1, 7)]);
}

#[test]
fn gaps_repetitions_and_restarts_are_told_apart() {
    let mut decoder = Decoder::new();
    for n in [0, 1, 4, 4, 5, 0, 1] {
        decoder.push(&piece(0, &packet(n)));
    }
    let readings: Vec<_> = std::iter::from_fn(|| decoder.next_reading()).collect();
    assert_eq!(readings.len(), 6);
    let expected = MipCounters {
        packets: 7,
        readings: 6,
        missing: 2,
        duplicated: 1,
        ..MipCounters::default()
    };
    assert_eq!(decoder.counters(), expected);
}

#[test]
fn a_packet_without_time_is_no_gap() {
    let (mut payload, mut magnetic) = (Vec::new(), Vec::new());
    Field::MagnetometerGauss([0.25, 0.5, -0.75])
        .emit(&mut payload)
        .unwrap();
    let only = MipPacket {
        descriptor_set: set::SENSOR,
        payload: &payload,
    };
    only.emit(&mut magnetic).unwrap();
    let mut decoder = Decoder::new();
    decoder.push(&piece(
        0,
        &[packet(0), magnetic.clone(), magnetic, packet(1)].concat(),
    ));
    let readings: Vec<_> = std::iter::from_fn(|| decoder.next_reading()).collect();
    assert_eq!(readings.len(), 4);
    let field = readings[2].sample.magnetic_field_gauss;
    assert_eq!(
        (readings[2].sample.sample, field),
        (None, Some([0.25, 0.5, -0.75]))
    );
    let counters = decoder.counters();
    assert_eq!((counters.missing, counters.duplicated), (0, 0));
}

#[test]
fn good_packets_are_found_behind_and_inside_bad_ones() {
    let mut decoder = Decoder::new();
    let mut damaged = packet(1);
    damaged[20] ^= 1;
    // A beginning that claims 255 bytes swallows nothing for good.
    let stream = [
        &packet(0)[..],
        &damaged,
        &[0x75, 0x65, 0x80, 0xFF],
        &packet(2),
        &packet(3),
    ];
    decoder.push(&piece(0, &stream.concat()));
    let mut numbers = Vec::new();
    numbers.extend(std::iter::from_fn(|| decoder.next_reading()));
    numbers.extend(decoder.finish());
    let at = |reading: &Decoded<MipReading>| (reading.device_ticks - 1_000_000_000) / PERIOD_NS;
    assert_eq!(numbers.iter().map(at).collect::<Vec<_>>(), [0, 2, 3]);
    let counters = decoder.counters();
    assert_eq!((counters.bad_checksums, counters.missing), (1, 1));
    assert_eq!(counters.skipped_bytes, 54 + 4);
}

#[test]
fn random_and_mutated_streams_never_panic() {
    let mut random = Random::new(11);
    for _ in 0..3_000 {
        let mut decoder = Decoder::new();
        let mut bytes = [packet(0), packet(1), random.bytes(60), packet(2)].concat();
        random.mutate(&mut bytes);
        for part in bytes.chunks(1 + random.below(50)) {
            decoder.push(&piece(0, part));
            while decoder.next_reading().is_some() {}
        }
        decoder.finish();
        let counters = decoder.counters();
        assert!(counters.packets <= 40, "{counters:?}");
    }
}
