//! Frames and their trailer.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsfb_drivers::transport::uvc::FrameFormat;
use lsfb_drivers::mynt_s::wire::{Frame, Trailer, emit_frame};
use lsfb_drivers::mynt_s::{ChecksumRule, Decoder, DecoderConfig};
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
    let kinds = [
        (ChecksumRule::Required, 2),
        (ChecksumRule::Ignored, 2),
        (ChecksumRule::Ignored, 1),
        (ChecksumRule::Ignored, 3),
    ];
    let mut decoders = kinds.map(|(checksum, cameras)| {
        Decoder::new(DecoderConfig {
            format: FORMAT,
            cameras,
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
            let images = frame.images(2).expect("two images fill the frame");
            let parts: Vec<&[u8]> = images.iter().map(Vec::as_slice).collect();
            let mut written = Vec::new();
            emit_frame(FORMAT, &parts, &frame.trailer(), &mut written).expect("images of a frame");
            let again = Frame::new(written.as_slice(), FORMAT).and_then(|frame| frame.images(2));
            assert_eq!(again, Ok(images));
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
