//! A pcap file of a LiDAR, made in memory.

use crate::velodyne_packets::{data_packet, position_packet};

/// A capture of raw IPv4: every position packet is followed by 14 data packets.
pub fn pcap(data_packets: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    for word in [0xa1b2_c3d4_u32, 0x0004_0002, 0, 0, 65_535, 101] {
        bytes.extend(word.to_le_bytes());
    }
    let mut frame = |n: u64, port: u16, payload: &[u8]| {
        let length = payload.len() + 28;
        let micros = (n * 664) as u32;
        for word in [
            1_772_359_200 + micros / 1_000_000,
            micros % 1_000_000,
            length as u32,
            length as u32,
        ] {
            bytes.extend(word.to_le_bytes());
        }
        bytes.extend([0x45, 0]);
        bytes.extend((length as u16).to_be_bytes());
        bytes.extend([
            0, 0, 0, 0, 64, 17, 0, 0, 192, 168, 1, 201, 255, 255, 255, 255,
        ]);
        for half in [port, port, length as u16 - 20, 0] {
            bytes.extend(half.to_be_bytes());
        }
        bytes.extend(payload);
    };
    for n in 0..data_packets {
        if n.is_multiple_of(14) {
            frame(n, 8308, &position_packet(n));
        }
        frame(n, 2368, &data_packet(n));
    }
    bytes
}
