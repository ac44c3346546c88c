//! Hesai's data packets: built by the setters, damaged, and pushed out of order; and the unit's file of beam angles.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::any_lidar::{Decoder, Reorder, Settings, device_ns, whose};
use lsfb_drivers::hesai::Model;
use lsfb_drivers::hesai::wire::{Clock, DataPacket, ReturnMode};
use lsfb_drivers::lidar::{BeamAngles, ScanSettings};
use lsfb_types::{Packet, Timestamp};

/// The fuzzer gives 12 bytes a packet.
const GIVEN: usize = 12;

fn packet(model: Model, mode: ReturnMode, given: &[u8]) -> Option<Vec<u8>> {
    let layout = model.layout();
    let bytes = vec![0; layout.len + usize::from(given[0] & 4)];
    let mut packet = DataPacket::init(bytes, model, mode).ok()?;
    for block in 0..layout.blocks {
        let azimuth = u16::from_le_bytes([given[1], given[2]]);
        packet.set_azimuth_centideg(block, azimuth.wrapping_add(block as u16 * 18));
        for channel in 0..layout.channels {
            let raw = u16::from(given[3]) * ((block + channel) % 3) as u16;
            packet.set_return(block, channel, raw, given[4]);
        }
    }
    packet.set_clock(&Clock {
        date: [given[5], given[6], 1],
        time: [0, given[7] % 61, given[8] % 62],
        micros: u32::from(given[9]) * 4_000,
    });
    packet.set_sequence(u32::from(given[10]));
    let mut bytes = packet.into_inner();
    if given[11] > 128 {
        let at = usize::from(given[11]) * 7 % bytes.len();
        bytes[at] ^= given[10];
    }
    Some(bytes)
}

fuzz_target!(|data: &[u8]| {
    let _ = (whose(data), device_ns(data), DataPacket::new(data).is_ok());
    let angles = BeamAngles::parse_csv(&String::from_utf8_lossy(data)).ok();
    let settings = Settings {
        model: None,
        scans: ScanSettings {
            angles,
            ..ScanSettings::default()
        },
    };
    let (mut decoder, mut reorder) = (Decoder::new(settings), Reorder::default());
    let mut points = 0;
    for (number, given) in data.chunks_exact(GIVEN).take(60).enumerate() {
        let model = Model::ALL[usize::from(given[0] >> 3) % 3];
        let mode = ReturnMode::ALL[usize::from(given[0] >> 5)];
        let Some(bytes) = packet(model, mode, given) else {
            continue;
        };
        let arrival = Timestamp::from_nanos(number as i64 * 1_000_000);
        for packet in reorder.push(Packet { arrival, bytes }) {
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
});
