//! Data packets of every LiDAR that is decoded: filled, damaged and pushed out of order; and the unit's file of beam angles.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::any_lidar::{
    Decoder, Reorder, Settings, blank_packets, device_ns, is_beside_data, whose,
};
use lsfb_drivers::lidar::{BeamAngles, Returns, ScanSettings};
use lsfb_types::{Packet, Timestamp};

/// The fuzzer gives 12 bytes a packet: which model, two fields that repeat (where, how far apart, what), and one byte that is hit.
const GIVEN: usize = 12;

fn fill(mut bytes: Vec<u8>, given: &[u8]) -> Vec<u8> {
    let len = bytes.len();
    for field in [&given[1..5], &given[5..9]] {
        let (from, stride) = (usize::from(field[0]), usize::from(field[1]) + 1);
        for (n, at) in (from..len).step_by(stride).enumerate() {
            // Angles and distances that go on from block to block, as those of a turning rotor do.
            bytes[at] = bytes[at].wrapping_add(field[2]).wrapping_add(field[3].wrapping_mul(n as u8));
        }
    }
    let hit = usize::from(u16::from_le_bytes([given[9], given[10]]));
    if hit < len {
        bytes[hit] ^= given[11];
    } else if hit < 2 * len {
        bytes.truncate(hit - len);
    }
    bytes
}

fuzz_target!(|data: &[u8]| {
    let _ = (whose(data), device_ns(data), is_beside_data(data));
    let _ = Decoder::new(Settings::default()).push(&Packet {
        arrival: Timestamp::default(),
        bytes: data.to_vec(),
    });
    let blank = blank_packets();
    let first = data.first().copied().unwrap_or_default();
    // As the packets say, and as one insists whatever they say.
    for (model, force_returns) in [
        (None, None),
        (Some(blank[usize::from(first) % blank.len()].0), Some(Returns::ALL[usize::from(first) % 3])),
    ] {
        let settings = Settings {
            model,
            scans: ScanSettings {
                force_returns,
                cut_azimuth_centideg: u16::from(first) * 141,
                angles: BeamAngles::parse_csv(&String::from_utf8_lossy(data)).ok(),
            },
        };
        let (mut decoder, mut reorder) = (Decoder::new(settings), Reorder::default());
        let mut points = 0;
        for (number, given) in data.chunks_exact(GIVEN).take(60).enumerate() {
            let bytes = blank[usize::from(given[0]) % blank.len()].1.clone();
            let packet = Packet {
                arrival: Timestamp::from_nanos(number as i64 * 1_000_000),
                bytes: fill(bytes, given),
            };
            for packet in reorder.push(packet) {
                if let Ok(Some(scan)) = decoder.push(&packet) {
                    points += scan.sample.points.len() as u64;
                    for point in &scan.sample.points {
                        assert!(point.position_m.iter().all(|v| v.is_finite()));
                    }
                }
            }
        }
        while let Some(scan) = decoder.finish() {
            points += scan.sample.points.len() as u64;
        }
        assert!(points <= decoder.counters().points);
    }
});
