//! Packets of a VLP-32C at 600 rpm that sees everything at 8 m.

use lsfb_drivers::velodyne::model::{Model, Product};
use lsfb_drivers::velodyne::nmea::Rmc;
use lsfb_drivers::velodyne::wire::{
    DATA_PACKET_LEN, DataPacket, POSITION_PACKET_LEN, PositionPacket, PpsStatus, Returns,
};

/// Data packet `n`.
pub fn data_packet(n: u64) -> Vec<u8> {
    let mut packet = DataPacket::init(
        vec![0; DATA_PACKET_LEN],
        Product::Vlp32c,
        Returns::Strongest,
    )
    .expect("length");
    let start_ns = start_ns(n);
    for block in 0..12 {
        let time_ns = start_ns + u64::from(Model::Vlp32c.block_time_ns(Returns::Strongest, block));
        packet.set_azimuth_centideg(block, (time_ns * 36 / 100_000 % 36_000) as u16);
        for channel in 0..32 {
            packet.set_return(block, channel, 2000, n as u8);
        }
    }
    packet.set_timestamp_us(data_time_us(n));
    packet.into_inner()
}

/// When data packet `n` is sent, microseconds past the hour.
pub fn data_time_us(n: u64) -> u32 {
    (start_ns(n) / 1000) as u32
}

/// A position packet sent at that time past the hour: locked to the pulse, 2026-03-01T10:00:00Z.
pub fn position_packet(toh_us: u32) -> Vec<u8> {
    let mut packet = PositionPacket::init(vec![0; POSITION_PACKET_LEN]).expect("length");
    packet.set_timestamp_us(toh_us);
    packet.set_pps_status(PpsStatus::Locked);
    let rmc = Rmc {
        hour: 10,
        valid: true,
        day: 1,
        month: 3,
        year: 2026,
        ..Rmc::default()
    };
    packet.set_nmea(rmc.emit().as_bytes()).expect("length");
    packet.into_inner()
}

fn start_ns(n: u64) -> u64 {
    n * u64::from(Model::Vlp32c.packet_period_ns(Returns::Strongest))
}
