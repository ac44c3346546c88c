//! Recordings of units whose packets are made here.

use std::path::Path;

use lsfb_capture::{
    CameraUnitConfig, DevicesConfig, ImuFamily, ImuLineConfig, Incoming, RecorderConfig,
    record_incoming,
};
use lsfb_drivers::mynt_d::model::TICK_NS;
use lsfb_drivers::mynt_d::wire::{Item, RawReading, Report};
use lsfb_drivers::mynt_s::wire::{TimeSource, Trailer, emit_frame};
use lsfb_drivers::transport::uvc::FrameFormat;
use lsfb_types::{Packet, Timestamp, no_progress};

const START: Timestamp = Timestamp::from_nanos(1_772_359_200_000_000_000);
pub const SAMPLES: u32 = 400;
pub const PERIOD_NS: i64 = 5_000_000;
const FRAME_PX: [u32; 2] = [64, 4];

/// A packet so long after the beginning.
pub fn packet(at_ns: i64, bytes: Vec<u8>) -> Packet {
    Packet {
        arrival: START.plus_nanos(at_ns),
        bytes,
    }
}

/// The reports of a Mynt D in two seconds.
pub fn mynt_d() -> Vec<Packet> {
    let report = |n: u32| {
        let ticks = n * (PERIOD_NS / TICK_NS as i64) as u32;
        let reading = |x| RawReading {
            ticks,
            xyz: [x, 0, 0x1555],
            temperature: 0x40,
        };
        let items = [
            Item::Accelerometer(reading(1)),
            Item::Gyroscope(reading(n as i16)),
        ];
        let bytes = Report::emit(n as u16, &items).expect("it fits");
        packet(i64::from(n) * PERIOD_NS, bytes.to_vec())
    };
    (0..SAMPLES).map(report).collect()
}

/// Frames of a stereo unit beside it, ten a second.
pub fn frames() -> Vec<Packet> {
    let frame = |n: u16| {
        let at_ns = i64::from(n) * 100_000_000;
        let trailer = Trailer {
            time_source: TimeSource::External,
            frame_id: n,
            timestamp_us: ((START.nanos() + at_ns) / 1_000).cast_unsigned(),
            exposure_steps: 10,
            checksum: 0,
        }
        .with_checksum();
        let format = FrameFormat {
            width: FRAME_PX[0],
            height: FRAME_PX[1],
        };
        let image = [n as u8; 128];
        let mut bytes = Vec::new();
        emit_frame(format, &[&image, &image], &trailer, &mut bytes).expect("it fits");
        packet(at_ns + 1_000_000, bytes)
    };
    (0..20).map(frame).collect()
}

/// Records what a unit and the cameras sent.
pub fn record(out: &Path, family: ImuFamily, sent: Vec<Packet>, frames: Vec<Packet>) {
    let unit = CameraUnitConfig {
        frame_px: FRAME_PX,
        ..CameraUnitConfig::stereo("".into(), ["cam0", "cam1"].map(str::to_owned))
    };
    let config = DevicesConfig {
        cameras: if frames.is_empty() {
            Vec::new()
        } else {
            vec![unit]
        },
        imus: vec![ImuLineConfig {
            name: "imu0".to_owned(),
            family,
            path: "".into(),
            baud: 921_600,
            rate_hz: 200,
        }],
        recorder: RecorderConfig {
            least_space_secs: 0.0,
            ..RecorderConfig::default()
        },
        ..DevicesConfig::default()
    };
    let frames = frames
        .into_iter()
        .map(|packet| Incoming::Frame { unit: 0, packet });
    let mut items: Vec<Incoming> = sent
        .into_iter()
        .map(|packet| Incoming::Imu { imu: 0, packet })
        .chain(frames)
        .collect();
    items.sort_by_key(|item| match item {
        Incoming::Imu { packet, .. } | Incoming::Frame { packet, .. } => packet.arrival,
        _ => Timestamp::default(),
    });
    let report = record_incoming(items.into_iter(), &config, out, &no_progress);
    let report = report.expect("recorded");
    assert_eq!(report.lost, 0, "{report:?}");
}
