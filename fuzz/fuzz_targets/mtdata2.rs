//! Xbus messages and MTData2 items, whole and in pieces.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::xsens::wire::{Items, Message, OutputSetting};
use lsfb_drivers::xsens::{Decoder, DecoderConfig};
use lsfb_types::{Packet, Timestamp};

fuzz_target!(|data: &[u8]| {
    let _ = OutputSetting::parse_all(data);
    let mut written = Vec::new();
    for item in Items::new(data) {
        let Ok(item) = item else { break };
        item.emit(&mut written).expect("what was read fits");
    }
    let mut again = Vec::new();
    for item in Items::new(&written) {
        item.expect("it was written")
            .emit(&mut again)
            .expect("what was read fits");
    }
    assert_eq!(written, again);

    let mut message = Vec::new();
    let framed = Message { id: 0x36, data }.emit(&mut message).is_ok();
    for bytes in [data, &message[..]] {
        let mut decoder = Decoder::new(DecoderConfig::default());
        for piece in bytes.chunks(17) {
            decoder.push(&Packet {
                arrival: Timestamp::default(),
                bytes: piece.to_vec(),
            });
            while decoder.next_reading().is_some() {}
        }
        decoder.finish();
    }
    if framed && let Ok(Some(parsed)) = Message::parse(&message) {
        assert_eq!(parsed.message.data, data);
    }
});
