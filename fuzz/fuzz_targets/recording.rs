//! Recordings, whole and damaged: a small one of ours with edits, or whatever the fuzzer makes up.
#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use lsfb_recording::{CameraUnit, Recording, Writer, WriterConfig, recover};
use lsfb_types::{Image, ImuSample, LidarPoint, LidarScan, Packet, Stamped, Timestamp};

/// One message of each kind.
static WHOLE: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let path = std::env::temp_dir().join(format!("lsfb-fuzz-{}-whole.mcap", std::process::id()));
    let mut writer = Writer::create(&path, &WriterConfig::default()).expect("a scratch file");
    let units = CameraUnit::attachment(&[CameraUnit::default()]);
    writer
        .attach(&units.name, &units.media_type, &units.bytes)
        .expect("it fits");
    for n in 0..3 {
        let time = Timestamp::from_nanos(1_700_000_000_000_000_000 + n * 50_000_000);
        let imu = ImuSample {
            angular_velocity_rad_s: [0.0, 0.5, n as f64],
            specific_force_m_s2: [0.0, 0.0, 9.8],
        };
        let image = Image {
            width: 4,
            height: 2,
            pixels: vec![n as u8; 8],
            exposure_ns: 1,
            frame_id: n as u32,
        };
        let scan = LidarScan {
            points: vec![LidarPoint::default(); 3],
        };
        let packet = Packet {
            arrival: time,
            bytes: vec![n as u8; 1206],
        };
        writer
            .write_imu("imu", &stamped(time, imu))
            .expect("it fits");
        writer
            .write_image("cam0", &stamped(time, image))
            .expect("it fits");
        writer.write_scan("lidar", &stamped(time, scan)).expect("it fits");
        writer
            .write_lidar_packets("lidar", time, &[packet])
            .expect("it fits");
    }
    writer.finish().expect("a scratch file");
    std::fs::read(path).expect("a scratch file")
});

fn stamped<T>(time: Timestamp, sample: T) -> Stamped<T> {
    Stamped {
        time,
        arrival: time,
        device_ticks: 7,
        sample,
    }
}

fuzz_target!(|data: &[u8]| {
    let path = std::env::temp_dir().join(format!("lsfb-fuzz-{}.mcap", std::process::id()));
    let mut edited = Vec::new();
    let bytes = if data.first() == Some(&0x89) {
        data
    } else {
        edited.extend_from_slice(&WHOLE);
        for edit in data.chunks_exact(4) {
            let at = usize::from(u16::from_le_bytes([edit[1], edit[2]])) % edited.len().max(1);
            match edit[0] % 4 {
                0 => edited.truncate(at),
                1 => edited.insert(at, edit[3]),
                _ => {
                    if let Some(byte) = edited.get_mut(at) {
                        *byte ^= edit[3];
                    }
                }
            }
        }
        &edited
    };
    std::fs::write(&path, bytes).expect("a scratch file");
    let Ok(recording) = Recording::open(&path) else {
        return;
    };
    let _ = recording.verify(&lsfb_types::no_progress);
    let _ = (recording.rig(), recording.arrival_range());
    let _ = (recording.calibration(), recording.end_time());
    let _ = (recording.camera_units(), recording.arrivals(&lsfb_types::no_progress));
    let _ = recording.images("cam0").map(|items| items.take(1_000).for_each(drop));
    let _ = recording.imu().map(|items| items.take(1_000).for_each(drop));
    let _ = recording.scans().map(|items| items.take(1_000).for_each(drop));
    let _ = recording.packets("lidar/packets").map(|items| items.take(1_000).for_each(drop));
    let out = path.with_extension("recovered.mcap");
    let _ = std::fs::remove_file(&out);
    let _ = recover(&path, &out, &lsfb_types::no_progress);
    for topic in recording.topics() {
        if let Ok(messages) = recording.messages(&topic.topic) {
            messages.take(1_000).for_each(drop);
        }
    }
});
