use lsfb_types::Timestamp;

use super::*;
use crate::mynt_s::wire::{Trailer, emit_frame};
use crate::test_random::Random;

const FORMAT: FrameFormat = FrameFormat {
    width: 40,
    height: 2,
};

fn config() -> DecoderConfig {
    DecoderConfig {
        format: FORMAT,
        ..Default::default()
    }
}

fn frame(frame_id: u16) -> Packet {
    let trailer = Trailer {
        time_source: TimeSource::External,
        frame_id,
        timestamp_us: 1_772_359_200_000_000 + u64::from(frame_id),
        exposure_steps: 45,
        checksum: 0,
    };
    let mut bytes = Vec::new();
    let trailer = trailer.with_checksum();
    emit_frame(FORMAT, &[&[7; 40], &[9; 40]], &trailer, &mut bytes).unwrap();
    Packet {
        arrival: Timestamp::from_nanos(11),
        bytes,
    }
}

#[test]
fn every_field_of_a_pair() {
    let mut decoder = Decoder::new(config());
    let image = |value| Image {
        width: 20,
        height: 2,
        pixels: vec![value; 40],
        exposure_ns: 4_500_000,
        frame_id: 3,
    };
    assert_eq!(
        decoder.push(&frame(3)),
        Ok(Some(Decoded {
            arrival: Timestamp::from_nanos(11),
            device_ticks: 1_772_359_200_000_003,
            sample: UnitFrame {
                images: vec![image(7), image(9)],
                time_source: TimeSource::External,
                trigger: Trigger { epoch: 0, index: 3 },
                mid_exposure_from_stamp_ns: 0,
            },
        }))
    );
}

#[test]
fn units_of_one_two_and_four_cameras_give_as_many_images() {
    for cameras in [1_u32, 2, 4] {
        let width = 40 / cameras;
        let pixels: Vec<Vec<u8>> = (0..cameras)
            .map(|camera| {
                let pixel = |i: u32| (i % width + 16 * camera) as u8;
                (0..2 * width).map(pixel).collect()
            })
            .collect();
        let images: Vec<&[u8]> = pixels.iter().map(Vec::as_slice).collect();
        let trailer = Trailer::default().with_checksum();
        let mut bytes = Vec::new();
        emit_frame(FORMAT, &images, &trailer, &mut bytes).unwrap();
        assert_eq!(bytes.len(), FORMAT.frame_bytes());
        let packet = Packet {
            arrival: Timestamp::from_nanos(1),
            bytes,
        };
        let config = DecoderConfig {
            cameras,
            ..config()
        };
        let frame = Decoder::new(config).push(&packet).unwrap().unwrap().sample;
        assert_eq!(frame.images.len(), images.len());
        for (image, expected) in frame.images.iter().zip(&pixels) {
            assert_eq!((image.width, image.height), (width, 2));
            let whole = expected.len() - 8;
            assert_eq!(image.pixels[..whole], expected[..whole]);
        }
        let last = &frame.images[images.len() - 1].pixels;
        assert!(
            last.iter()
                .rev()
                .take(9)
                .all(|grey| *grey == last[last.len() - 9])
        );
    }
    // Three images do not fill a frame of 40 pixels, nor do none.
    for cameras in [0, 3] {
        let mut decoder = Decoder::new(DecoderConfig {
            cameras,
            ..config()
        });
        assert!(matches!(
            decoder.push(&frame(1)),
            Err(WireError::Value { .. })
        ));
        assert_eq!(decoder.counters().bad_header, 1);
    }
}

#[test]
fn the_trigger_index_grows_through_the_wrap_and_a_restart_begins_an_epoch() {
    let mut decoder = Decoder::new(config());
    let mut triggers = Vec::new();
    for id in [65_535, 0, 2, 50_000, 40_000] {
        let pair = decoder.push(&frame(id)).unwrap().unwrap();
        triggers.push((pair.sample.trigger.epoch, pair.sample.trigger.index));
        assert_eq!(
            u64::from(pair.sample.images[0].frame_id),
            triggers.last().unwrap().1
        );
    }
    let restarted = triggers.pop().unwrap();
    assert_eq!(
        triggers,
        [(0, 65_535), (0, 65_536), (0, 65_538), (1, 115_536)]
    );
    assert_eq!(restarted.0, 2);
    assert!(restarted.1 > 115_536);
}

#[test]
fn the_stamp_leads_to_the_middle_of_the_exposure() {
    for (stamp, expected_ns) in [
        (StampInstant::ExposureStart, 2_250_000),
        (StampInstant::ExposureMiddle, 0),
        (StampInstant::ExposureEnd, -2_250_000),
    ] {
        let mut decoder = Decoder::new(DecoderConfig { stamp, ..config() });
        let pair = decoder.push(&frame(1)).unwrap().unwrap();
        assert_eq!(pair.sample.mid_exposure_from_stamp_ns, expected_ns);
        // The stamp itself is not touched.
        assert_eq!(pair.device_ticks, 1_772_359_200_000_001);
    }
}

#[test]
fn faults_are_named_counted_and_survived() {
    let mut decoder = Decoder::new(config());
    let mut ids = Vec::new();
    let mut push = |packet: Packet| {
        let result = decoder.push(&packet);
        if let Ok(Some(decoded)) = &result {
            ids.push(decoded.sample.images[0].frame_id);
        }
        result.map(|decoded| decoded.is_some())
    };
    assert_eq!(push(frame(65_534)), Ok(true));
    assert_eq!(push(frame(65_534)), Ok(false));
    // The id wraps.
    assert_eq!(push(frame(1)), Ok(true));

    let mut bad_header = frame(2);
    *bad_header.bytes.last_mut().unwrap() = 0x3F;
    assert!(matches!(push(bad_header), Err(WireError::Constant { .. })));
    let mut bad_checksum = frame(3);
    let at = bad_checksum.bytes.len() - 5;
    bad_checksum.bytes[at] ^= 4;
    assert!(matches!(
        push(bad_checksum),
        Err(WireError::Checksum { .. })
    ));
    let mut short = frame(4);
    short.bytes.pop();
    assert!(matches!(push(short), Err(WireError::Length { .. })));

    assert_eq!(push(frame(5)), Ok(true));
    assert_eq!(push(frame(0)), Ok(true));
    assert_eq!(ids, [65_534, 65_537, 65_541, 131_072]);
    assert_eq!(
        decoder.counters(),
        FrameCounters {
            frames: 4,
            bad_length: 1,
            bad_header: 1,
            bad_checksum: 1,
            // 65 535 and 0, then 2, 3 and 4.
            missing: 5,
            duplicated: 1,
            restarts: 1,
        }
    );
}

#[test]
fn firmware_with_another_checksum_can_be_read() {
    let mut packet = frame(1);
    let at = packet.bytes.len() - 15;
    packet.bytes[at] ^= 0xFF;
    assert!(Decoder::new(config()).push(&packet).is_err());
    let mut lenient = Decoder::new(DecoderConfig {
        checksum: ChecksumRule::Ignored,
        ..config()
    });
    assert!(lenient.push(&packet).unwrap().is_some());
}

#[test]
fn no_frame_makes_the_decoder_panic() {
    let mut random = Random::new(5);
    let mut decoder = Decoder::new(config());
    for id in 0..5000 {
        let mut packet = frame(id);
        random.mutate(&mut packet.bytes);
        let _ = decoder.push(&packet);
    }
}

#[test]
fn an_exposure_beyond_what_nanoseconds_hold_is_the_longest() {
    let mut packet = frame(1);
    let len = packet.bytes.len();
    let trailer = Trailer {
        exposure_steps: u16::MAX,
        ..Trailer::parse(&packet.bytes).unwrap()
    };
    let bytes = trailer.with_checksum().emit();
    packet.bytes[len - bytes.len()..].copy_from_slice(&bytes);
    let mut decoder = Decoder::new(config());
    let pair = decoder.push(&packet).unwrap().unwrap();
    assert_eq!(pair.sample.images[0].exposure_ns, u32::MAX);
}
