//! Data packets: every return of a packet, and streams of packets through the decoder.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::velodyne::model::Model;
use lsfb_drivers::velodyne::wire::{DATA_PACKET_LEN, DataPacket, Returns, identify};
use lsfb_drivers::velodyne::{
    Decoder, DecoderConfig, ModelChoice, OpticalOffset, PacketLayout, returns,
};
use lsfb_types::{Packet, Timestamp};

/// The fuzzer gives 25 bytes a packet: three blocks' heads and what follows the blocks. Distances come from a counter.
const GIVEN: usize = 25;

fn packet(given: &[u8], number: usize) -> Vec<u8> {
    let mut bytes = vec![0; DATA_PACKET_LEN];
    for block in 0..12 {
        let at = 100 * block;
        bytes[at..at + 2].copy_from_slice(&[0xFF, 0xEE]);
        let azimuth = u16::from_le_bytes([given[2 * (block / 2)], given[2 * (block / 2) + 1]]);
        let step = u16::from(given[12]) * (block % 2) as u16;
        bytes[at + 2..at + 4].copy_from_slice(&azimuth.wrapping_add(step).to_le_bytes());
        for k in 0..96 {
            bytes[at + 4 + k] = given[13 + (k + block + number) % 4];
        }
    }
    bytes[1200..1206].copy_from_slice(&given[17..23]);
    let edit = usize::from(u16::from_le_bytes([given[23], given[24]])) % (DATA_PACKET_LEN * 4);
    if edit < DATA_PACKET_LEN {
        bytes[edit] ^= given[16];
    }
    bytes
}

fuzz_target!(|data: &[u8]| {
    let _ = identify(data);
    let _ = DataPacket::new(data);
    let config = |model, optical_offset| DecoderConfig {
        model,
        optical_offset,
        cut_azimuth_centideg: u16::from(data.first().copied().unwrap_or(0)) * 141,
    };
    let forced = ModelChoice::Force(Model::Vlp16, Returns::Dual);
    let mut decoders = [
        Decoder::new(config(ModelChoice::FromPackets, OpticalOffset::Ignored)),
        Decoder::new(config(forced, OpticalOffset::Applied)),
    ];
    let mut arrival = 0i64;
    for (number, given) in data.chunks_exact(GIVEN).take(40).enumerate() {
        let bytes = packet(given, number);
        if let Ok(packet) = DataPacket::new(&bytes[..]) {
            for model in Model::ALL {
                for mode in [Returns::Strongest, Returns::Last, Returns::Dual] {
                    let layout = PacketLayout::new(&packet, model, mode);
                    for hit in returns(&packet, &layout) {
                        assert!(hit.range_raw > 0 && hit.azimuth_centideg.is_finite());
                    }
                }
            }
        }
        arrival += 1_327_104 + i64::from(given[12]) * 1_000_000;
        let packet = Packet {
            arrival: Timestamp::from_nanos(arrival),
            bytes,
        };
        for decoder in &mut decoders {
            let _ = decoder.push(&packet);
        }
    }
    for decoder in &mut decoders {
        let mut points = 0;
        while let Some(scan) = decoder.finish() {
            points += scan.sample.points.len() as u64;
            for point in &scan.sample.points {
                assert!(point.position_m.iter().all(|v| v.is_finite()));
            }
        }
        assert!(points <= decoder.counters().points);
    }
});
