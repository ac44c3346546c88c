//! Frames and their trailer.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::camera::model::FrameFormat;
use lsfb_drivers::camera::wire::{Frame, Side, Trailer};
use lsfb_drivers::camera::{ChecksumRule, Decoder, DecoderConfig};
use lsfb_types::{Packet, Timestamp};

const FORMAT: FrameFormat = FrameFormat {
    width: 16,
    height: 2,
};

fuzz_target!(|data: &[u8]| {
    if let Ok(trailer) = Trailer::parse(data) {
        let written = trailer.emit();
        assert_eq!(Trailer::parse(&written), Ok(trailer));
    }
    let mut decoders = [ChecksumRule::Required, ChecksumRule::Ignored].map(|checksum| {
        Decoder::new(DecoderConfig {
            format: FORMAT,
            checksum,
            ..DecoderConfig::default()
        })
    });
    // The first byte says how long the frames are: usually as they should be.
    let Some((&first, data)) = data.split_first() else {
        return;
    };
    let len = match first {
        0..240 => FORMAT.frame_bytes(),
        other => usize::from(other) - 239,
    };
    for bytes in data.chunks(len) {
        if let Ok(frame) = Frame::new(bytes, FORMAT) {
            assert_eq!(frame.grey(Side::Left).len(), frame.grey(Side::Right).len());
        }
        let packet = Packet {
            arrival: Timestamp::default(),
            bytes: bytes.to_vec(),
        };
        for decoder in &mut decoders {
            let _ = decoder.push(&packet);
        }
    }
});
