//! Position packets, and the sentence inside.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::velodyne::nmea::Sentence;
use lsfb_drivers::velodyne::wire::{POSITION_PACKET_LEN, PositionPacket, PpsStatus};

fuzz_target!(|data: &[u8]| {
    let _ = PositionPacket::new(data);
    // What the fuzzer gives begins where the fields do.
    let mut bytes = vec![0; POSITION_PACKET_LEN];
    for (to, from) in bytes[0xBB..].iter_mut().zip(data) {
        *to = *from;
    }
    let Ok(packet) = PositionPacket::new(&bytes[..]) else {
        unreachable!("it has the length");
    };
    assert_eq!(
        PpsStatus::from_code(packet.pps_status().code()),
        packet.pps_status()
    );
    let _ = (
        packet.timestamp_us(),
        packet.calibration_age_secs(),
        packet.thermal_status(),
    );
    if let Ok(sentence) = Sentence::parse(packet.nmea()) {
        let _ = sentence.unix_secs(0);
    }
    let mut copy = PositionPacket::init(vec![0; POSITION_PACKET_LEN]).expect("it has the length");
    copy.set_nmea(packet.nmea().get(..126).unwrap_or(packet.nmea()))
        .expect("it fits");
});
