//! Recordings that are whole but say anything at any time: judged, their clocks estimated, replayed and looked at to be played.
#![no_main]


use libfuzzer_sys::fuzz_target;
use lsfb_capture::clock::{ClockConfig, estimate_clocks};
use lsfb_capture::doctor::{DoctorConfig, examine};
use lsfb_capture::{RecorderConfig, ReplayConfig, replay_recording};
use lsfb_recording::message::{self, ClockModel};
use lsfb_recording::{
    CLOCK_MODELS, Channel, Compression, Existing, Recording, Writer, WriterConfig,
};
use lsfb_sim::Playback;
use lsfb_types::{
    Image, ImuSample, LidarPoint, LidarScan, Packet, Stamped, Timestamp, no_progress,
};

/// Kind, four bytes of time, four of arrival, two of the counter.
const MESSAGE: usize = 11;
const MOST_MESSAGES: usize = 64;

fn write(path: &std::path::Path, data: &[u8]) -> Result<(), lsfb_recording::Error> {
    let config = WriterConfig {
        compression: Compression::None,
        existing: Existing::Replace,
        ..WriterConfig::default()
    };
    let mut writer = Writer::create(path, &config)?;
    if let Some(report) = data.strip_prefix(b"{") {
        writer.attach("health.json", "application/json", &[b"{", report].concat())?;
    }
    let mut last = Timestamp::from_nanos(1_772_359_200_000_000_000);
    for given in data.chunks_exact(MESSAGE).take(MOST_MESSAGES) {
        let word = |at: usize| {
            i32::from_le_bytes([given[at], given[at + 1], given[at + 2], given[at + 3]])
        };
        let near = |from: Timestamp, value: i32| match given[0] & 0x80 {
            0 => from.plus_nanos(i64::from(value) * 1_000),
            _ => Timestamp::from_nanos(i64::from(value) << 32),
        };
        last = near(last, word(1));
        let arrival = near(last, word(5));
        let device_ticks =
            u64::from(u16::from_le_bytes([given[9], given[10]])) << (given[0] & 0x18) * 2;
        macro_rules! stamped {
            ($sample:expr) => {
                &Stamped {
                    time: last,
                    arrival,
                    device_ticks,
                    sample: $sample,
                }
            };
        }
        match given[0] & 7 {
            0 => writer.write_imu("imu0", stamped!(ImuSample::default()))?,
            1 => {
                let image = Image {
                    width: 2,
                    height: 2,
                    pixels: vec![given[9]; 4],
                    exposure_ns: 7,
                    frame_id: given[10].into(),
                };
                writer.write_image("cam0", stamped!(image))?;
            }
            2 => {
                let point = LidarPoint {
                    position_m: [given[9].into(); 3],
                    ..LidarPoint::default()
                };
                writer.write_scan("lidar", stamped!(LidarScan {
                    points: vec![point]
                }))?;
            }
            3 => {
                let mut bytes = vec![given[9]; 1206];
                bytes[..2].copy_from_slice(&[0xFF, 0xEE]);
                for block in 0..12 {
                    bytes[100 * block..100 * block + 2].copy_from_slice(&[0xFF, 0xEE]);
                }
                bytes[1200..1204].copy_from_slice(&given[5..9]);
                bytes[1204..].copy_from_slice(&[0x37, 0x22]);
                writer.write_lidar_packets("lidar", last, &[Packet { arrival, bytes }])?;
            }
            4 | 5 => {
                let bytes = if given[0] & 1 == 0 {
                    vec![given[9]; 512]
                } else {
                    given.to_vec()
                };
                let source =
                    ["lidar/position", "imu0", "cam0/imu", "lidar"][usize::from(given[10] & 3)];
                writer.write_raw(
                    source,
                    given[9].into(),
                    device_ticks,
                    &Packet { arrival, bytes },
                    last,
                )?;
            }
            _ => {
                let model = ClockModel {
                    device: "imu0".to_owned(),
                    kind: ["locked", "fitted", "holdover", ""][usize::from(given[9] & 3)]
                        .to_owned(),
                    epoch: given[10].into(),
                    tick_ns: device_ticks,
                    period_ticks: u64::from(given[9]) << (given[10] & 0x3f),
                    ..ClockModel::default()
                };
                let bytes = message::encode_clock_model(last, "imu0", &model);
                let topic = format!("{CLOCK_MODELS}imu0");
                let channel = Channel {
                    topic: &topic,
                    schema_name: message::CLOCK_MODEL.name,
                    schema_text: message::CLOCK_MODEL.text,
                };
                writer.write_cdr(&channel, last, arrival, &bytes)?;
            }
        }
    }
    writer.finish().map(drop)
}

fuzz_target!(|data: &[u8]| {
    let name =
        |what| std::env::temp_dir().join(format!("lsfb-fuzz-{}-{what}.mcap", std::process::id()));
    let path = name("said");
    // A stamp that no file can hold is refused by the writer.
    if write(&path, data).is_err() {
        return;
    }
    let recording = Recording::open(&path).expect("it was written");
    examine(&recording, &DoctorConfig::default(), &no_progress).expect("it can be read");
    estimate_clocks(&recording, &ClockConfig::default(), &no_progress).expect("it can be read");
    let config = ReplayConfig {
        recorder: RecorderConfig {
            compression: Compression::None,
            existing: Existing::Replace,
            least_space_secs: 0.0,
            reserve_bytes: 0,
            ..RecorderConfig::default()
        },
        ..ReplayConfig::default()
    };
    let _ = replay_recording(&path, &config, &name("replayed"), &no_progress);
    let _ = Playback::open(&path);
});
