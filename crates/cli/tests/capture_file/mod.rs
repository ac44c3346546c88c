//! A pcap file, made in memory.

use lsfb_tests::velodyne::{data_packet, data_time_us, position_packet};

/// Protocol number of IP.
const UDP: u8 = 17;

/// One frame of a capture.
pub struct Frame {
    /// Half milliseconds and a bit since the beginning: when packet `n` of a VLP-32C arrives.
    pub n: u64,
    /// Last byte of the sender's address, 192.168.1.x.
    pub sender: u8,
    pub protocol: u8,
    pub port: u16,
    pub payload: Vec<u8>,
}

impl Frame {
    /// A datagram of the sensor at 192.168.1.201.
    pub fn udp(n: u64, port: u16, payload: Vec<u8>) -> Self {
        Self {
            n,
            sender: 201,
            protocol: UDP,
            port,
            payload,
        }
    }
}

/// A capture of raw IPv4.
pub fn capture(frames: impl IntoIterator<Item = Frame>) -> Vec<u8> {
    let mut bytes = Vec::new();
    for word in [0xa1b2_c3d4_u32, 0x0004_0002, 0, 0, 65_535, 101] {
        bytes.extend(word.to_le_bytes());
    }
    for frame in frames {
        let Frame {
            n,
            sender,
            protocol,
            port,
            payload,
        } = frame;
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
            0, 0, 0, 0, 64, protocol, 0, 0, 192, 168, 1, sender, 255, 255, 255, 255,
        ]);
        for half in [port, port, length as u16 - 20, 0] {
            bytes.extend(half.to_be_bytes());
        }
        bytes.extend(payload);
    }
    bytes
}

/// A capture of data packets of a VLP-32C; a position packet goes before every fourteenth.
pub fn pcap(data_packets: impl IntoIterator<Item = u64>) -> Vec<u8> {
    capture(data_packets.into_iter().flat_map(|n| {
        let position = n
            .is_multiple_of(14)
            .then(|| Frame::udp(n, 8308, position_packet(data_time_us(n))));
        position
            .into_iter()
            .chain([Frame::udp(n, 2368, data_packet(n))])
    }))
}
