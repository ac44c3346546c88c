//! MIP packets and fields, whole and in pieces, and the unit's side of a conversation.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::microstrain::wire::{Command, MipPacket};
use lsfb_drivers::microstrain::{Decoder, MipUnit};
use lsfb_types::{Packet, Timestamp};

fuzz_target!(|data: &[u8]| {
    let mut framed = Vec::new();
    for descriptor_set in [0x01, 0x0C, 0x80, 0x82] {
        let packet = MipPacket {
            descriptor_set,
            payload: data.get(..255).unwrap_or(data),
        };
        packet.emit(&mut framed).expect("it fits");
        let mut written = Vec::new();
        for field in packet.fields() {
            let Ok(field) = field else { break };
            field.emit(&mut written).expect("what was read fits");
        }
        assert!(packet.payload.starts_with(&written));
        for raw in packet.raw_fields().map_while(Result::ok) {
            if let Ok(Some(command)) = Command::parse(descriptor_set, raw) {
                let mut bytes = Vec::new();
                command.emit(&mut bytes).expect("what was read fits");
            }
        }
    }
    for bytes in [data, &framed[..]] {
        let mut decoder = Decoder::new();
        for piece in bytes.chunks(23) {
            decoder.push(&Packet {
                arrival: Timestamp::default(),
                bytes: piece.to_vec(),
            });
            while decoder.next_reading().is_some() {}
        }
        decoder.finish();
        let mut unit = MipUnit::new(1000);
        unit.handle(bytes).expect("answers fit");
    }
});
