//! The MicroStrain driver on a stream recorded by others.

#![allow(
    clippy::unwrap_used,
    reason = "a test file as a whole; clippy.toml only spares #[test] functions"
)]

use std::collections::BTreeMap;

use crate::microstrain::wire::MipPacket;
use crate::microstrain::{Decoder, MipCounters, MipReading};
use lsfb_types::{Packet, Timestamp};

fn stream(test: &str) -> Option<Vec<u8>> {
    let path = lsfb_tests::recordings(test, "lidar/mip/mip_data.bin")?;
    Some(std::fs::read(path).unwrap())
}

#[test]
fn every_packet_of_the_real_stream_is_read_and_none_is_bad() {
    let Some(bytes) = stream("every_packet_of_the_real_stream_is_read_and_none_is_bad") else {
        return;
    };
    assert_eq!(bytes.len(), 368_940);
    // Packet by packet: counts per descriptor set, and back to the same bytes.
    let mut by_set = BTreeMap::new();
    let mut with_both = 0;
    let mut at = 0;
    while at < bytes.len() {
        let parsed = MipPacket::parse(&bytes[at..]).unwrap().unwrap();
        let mut payload = Vec::new();
        for field in parsed.packet.fields() {
            field.unwrap().emit(&mut payload).unwrap();
        }
        assert_eq!(payload, parsed.packet.payload, "at byte {at}");
        let has = |descriptor| {
            let mut fields = parsed.packet.raw_fields().map(Result::unwrap);
            fields.any(|raw| raw.descriptor == descriptor)
        };
        let inertial = parsed.packet.descriptor_set == 0x80 && has(0x04) && has(0x05);
        with_both += usize::from(inertial);
        *by_set.entry(parsed.packet.descriptor_set).or_insert(0) += 1;
        at += parsed.len;
    }
    let expected = BTreeMap::from([(0x01, 1), (0x80, 7157), (0x82, 714), (0xA0, 512)]);
    assert_eq!(by_set, expected);

    // As a serial line delivers it.
    let mut decoder = Decoder::new();
    let mut readings: Vec<MipReading> = Vec::new();
    let mut first_ticks = None;
    for piece in bytes.chunks(61) {
        decoder.push(&Packet {
            arrival: Timestamp::default(),
            bytes: piece.to_vec(),
        });
        while let Some(reading) = decoder.next_reading() {
            first_ticks.get_or_insert(reading.device_ticks);
            readings.push(reading.sample);
        }
    }
    assert_eq!(decoder.finish(), []);
    let counters = decoder.counters();
    assert_eq!(counters.missing, 0);
    let expected = MipCounters {
        packets: 8_384,
        readings: 7_157,
        ..MipCounters::default()
    };
    assert_eq!(counters, expected);
    assert_eq!(readings.len(), 7_157);
    assert_eq!(first_ticks, Some(282_809_000_000));
    // Somebody holds the unit in the hand.
    let samples: Vec<_> = readings
        .iter()
        .filter_map(|reading| reading.sample)
        .collect();
    assert_eq!(samples.len(), with_both);
    let norm = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let gravity = samples.iter().map(|s| norm(s.specific_force_m_s2));
    let mean = gravity.sum::<f64>() / samples.len() as f64;
    assert!((9.5..10.2).contains(&mean), "{mean}");
    let turning = samples.iter().map(|s| norm(s.angular_velocity_rad_s));
    assert!(turning.fold(0.0, f64::max) < 20.0);
}
