//! CAN frames and the samples made of them.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::sbg::Decoder;
use lsfb_drivers::sbg::wire::SbgMessage;
use lsfb_drivers::transport::can::CanFrame;
use lsfb_types::{Packet, Timestamp};

fuzz_target!(|data: &[u8]| {
    let _ = CanFrame::parse(data);
    let mut decoder = Decoder::new();
    for given in data.chunks(10) {
        // The first byte is the identifier's last, the second the length.
        let mut bytes = [0; 16];
        bytes[0] = given[0] & 0x33;
        bytes[1] = 1 + (given[0] >> 7);
        bytes[4] = given.get(1).copied().unwrap_or(8);
        for (to, from) in bytes[8..].iter_mut().zip(given.iter().skip(2)) {
            *to = *from;
        }
        if let Ok(frame) = CanFrame::parse(&bytes)
            && let Ok(Some(message)) = SbgMessage::parse(&frame)
        {
            assert_eq!(message.emit().data(), frame.data());
        }
        let _ = decoder.push(&Packet {
            arrival: Timestamp::default(),
            bytes: bytes.to_vec(),
        });
    }
    decoder.finish();
});
