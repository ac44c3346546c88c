use std::path::Path;

use lsfb_recording::message::{HEALTH_VALUE, HealthValue, encode_health_value};
use lsfb_recording::{CameraUnit, Channel, HEALTH, Writer, WriterConfig};
use lsfb_types::{Image, ImuSample, LidarScan, Stamped, Timestamp, no_progress};

use super::*;
use crate::device_note::DeviceNote;
use lsfb_types::Verdict;

const START: i64 = 1_772_359_200_000_000_000;
const PERIOD_NS: i64 = 5_000_000;

/// `count` samples of an IMU at 200 Hz by its stamps, which arrive `pace` times as fast.
fn write(path: &Path, count: i64, pace: f64) {
    let config = WriterConfig {
        chunk_bytes: 4096,
        ..WriterConfig::default()
    };
    let mut writer = Writer::create(path, &config).unwrap();
    for n in 0..count {
        let sample = Stamped {
            time: Timestamp::from_nanos(START + n * PERIOD_NS),
            arrival: Timestamp::from_nanos(START + (n as f64 * PERIOD_NS as f64 / pace) as i64),
            device_ticks: 0,
            sample: ImuSample::default(),
        };
        writer.write_imu("imu0", &sample).unwrap();
    }
    writer
        .attach("health.json", "application/json", br#"{"lost": 0}"#)
        .unwrap();
    writer.finish().unwrap();
}

/// Those of some numbers of an IMU at 200 Hz, which arrive when they are measured.
fn write_samples(writer: &mut Writer, numbers: impl Iterator<Item = i64>) {
    for n in numbers {
        let time = Timestamp::from_nanos(START + n * PERIOD_NS);
        let sample = Stamped {
            time,
            arrival: time,
            device_ticks: 0,
            sample: ImuSample::default(),
        };
        writer.write_imu("imu0", &sample).unwrap();
    }
}

fn diagnosis(path: &Path, read: Depth) -> Judgement {
    let config = DoctorConfig {
        read,
        ..DoctorConfig::default()
    };
    let recording = Recording::open(path).unwrap();
    examine(&recording, &config, &no_progress)
        .unwrap()
        .judgement
}

fn found<'a>(judgement: &'a Judgement, code: &str) -> &'a Finding {
    let mut all = judgement.findings().iter();
    all.find(|f| f.code == code)
        .unwrap_or_else(|| panic!("{code} is not among {judgement:#?}"))
}

/// The index at the end and the statistics are whole while two thirds of the messages are zeros: looking at the end alone says "whole".
#[test]
fn an_overwritten_middle_is_found_without_reading_everything() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.mcap");
    write(&path, 4000, 1.0);
    assert_eq!(
        found(&diagnosis(&path, Depth::Indexes), "counts").verdict,
        Verdict::Pass
    );

    let mut bytes = std::fs::read(&path).unwrap();
    let (from, to) = (bytes.len() / 4, bytes.len() / 2);
    bytes[from..to].fill(0);
    std::fs::write(&path, &bytes).unwrap();
    let judgement = diagnosis(&path, Depth::Indexes);
    assert_eq!(
        found(&judgement, "file").verdict,
        Verdict::Pass,
        "its ends are there"
    );
    let counts = found(&judgement, "counts");
    assert_eq!(counts.verdict, Verdict::Fail, "{counts:?}");
    assert!(
        counts.value < Some(4000.0) && counts.what.contains("of 4000"),
        "{counts:?}"
    );
}

#[test]
fn what_was_not_read_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.mcap");
    write(&path, 2000, 1.0);
    let judgement = diagnosis(&path, Depth::Indexes);
    let checksums = found(&judgement, "checksums");
    assert_eq!(checksums.verdict, Verdict::Unknown);
    assert!(checksums.sentence().contains("`--full`"), "{checksums:?}");
    assert_eq!(
        found(&diagnosis(&path, Depth::Everything), "checksums").verdict,
        Verdict::Pass
    );
}

/// Twenty seconds of stamps that arrive in half a second: by arrivals 8000 Hz, and any pause of the program a silence.
#[test]
fn a_recording_made_faster_than_real_time_is_judged_by_its_stamps() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("replay.mcap");
    write(&path, 4000, 40.0);
    let judgement = diagnosis(&path, Depth::Indexes);
    assert_eq!(found(&judgement, "pace").verdict, Verdict::Pass);
    let rate = found(&judgement, "rate");
    assert_eq!(rate.verdict, Verdict::Pass, "{rate:?}");
    assert!((rate.value.unwrap() - 200.0).abs() < 1.0, "{rate:?}");
    // Nobody looked between the first and the last stamp.
    assert_eq!(found(&judgement, "silence").verdict, Verdict::Unknown);
    let silence = diagnosis(&path, Depth::Everything);
    assert_eq!(found(&silence, "silence").verdict, Verdict::Pass);
}

/// Every third message is missing and no gap is long: the longest silence says nothing.
#[test]
fn a_stream_that_loses_messages_evenly_is_found_by_its_rate() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.mcap");
    let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
    write_samples(&mut writer, (0..3000).filter(|n| n % 4 != 3));
    writer.finish().unwrap();
    let judgement = diagnosis(&path, Depth::Indexes);
    assert_eq!(found(&judgement, "silence").verdict, Verdict::Pass);
    let rate = found(&judgement, "rate");
    assert_eq!(rate.verdict, Verdict::Warn, "{rate:?}");
}

/// Two sensors on one topic: 12 000 messages a second never fall silent.
#[test]
fn a_rate_that_no_sensor_has_is_no_pass() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.mcap");
    let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
    for n in 0..24_000 {
        let time = Timestamp::from_nanos(START + n * 83_333);
        let sample = Stamped {
            time,
            arrival: time,
            device_ticks: 0,
            sample: ImuSample::default(),
        };
        writer.write_imu("imu0", &sample).unwrap();
    }
    writer.finish().unwrap();
    let rate = diagnosis(&path, Depth::Indexes);
    let rate = found(&rate, "rate");
    assert_eq!(rate.verdict, Verdict::Fail, "{rate:?}");
}

/// A recording of a LiDAR whose recorder said that it turns ten times a second, and of a camera that takes an image a second; `scan_ns`:
/// from scan to scan.
fn write_described(path: &Path, scan_ns: i64, lidar_offset_ns: i64) {
    let mut writer = Writer::create(path, &WriterConfig::default()).unwrap();
    let note = DeviceNote::new("lidar")
        .with("model", "VLP-32C")
        .with("returns", "strongest")
        .with_rate_hz(10.0);
    writer
        .write_metadata(&note.record(), note.entries().clone())
        .unwrap();
    let unit = CameraUnit {
        cameras: vec!["cam0".to_owned()],
        rate_hz: 1,
        ..CameraUnit::default()
    };
    let listed = CameraUnit::attachment(&[unit]);
    writer
        .attach(&listed.name, &listed.media_type, &listed.bytes)
        .unwrap();
    for n in 0..20_000_000_000 / scan_ns {
        let arrival = Timestamp::from_nanos(START + n * scan_ns);
        let scan = Stamped {
            time: arrival + lidar_offset_ns,
            arrival,
            device_ticks: 0,
            sample: LidarScan::default(),
        };
        writer.write_scan("lidar", &scan).unwrap();
        if (n * scan_ns) % 1_000_000_000 == 0 {
            let image = Stamped {
                time: arrival,
                arrival,
                device_ticks: 0,
                sample: Image {
                    width: 1,
                    height: 1,
                    pixels: vec![n as u8],
                    exposure_ns: 0,
                    frame_id: n as u32,
                },
            };
            writer.write_image("cam0", &image).unwrap();
        }
    }
    writer.finish().unwrap();
}

fn found_at<'a>(judgement: &'a Judgement, code: &str, subject: &str) -> &'a Finding {
    let mut all = judgement.findings().iter();
    all.find(|f| f.code == code && f.subject == subject)
        .unwrap_or_else(|| panic!("{code} of {subject} is not among {judgement:#?}"))
}

/// Five scans a second are as regular as ten, and sensors that turn so slowly exist.
#[test]
fn a_lidar_at_half_its_rate_has_failed_and_a_time_lapse_has_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.mcap");
    for (scan_ns, expected) in [
        (100_000_000, Verdict::Pass),
        (125_000_000, Verdict::Warn),
        (200_000_000, Verdict::Fail),
    ] {
        let _ = std::fs::remove_file(&path);
        write_described(&path, scan_ns, 0);
        let judgement = diagnosis(&path, Depth::Indexes);
        let rate = found_at(&judgement, "rate", "/lidar/points");
        assert_eq!(rate.verdict, expected, "{rate:?}");
        for code in ["rate", "silence"] {
            let camera = found_at(&judgement, code, "/cam0/image");
            assert_eq!(camera.verdict, Verdict::Pass, "{camera:?}");
        }
    }
    // What the sensor is outlives a recorder that was killed.
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let judgement = diagnosis(&path, Depth::Indexes);
    let device = found_at(&judgement, "device", "device lidar");
    assert!(
        device.what.contains("model VLP-32C, returns strongest"),
        "{device:?}"
    );
    let rate = found_at(&judgement, "rate", "/lidar/points");
    assert_eq!(rate.verdict, Verdict::Fail, "{rate:?}");
}

/// The recorder asked cam7 for images, and was killed before one came: nothing in the file is wrong.
#[test]
fn a_camera_that_never_sent_an_image_is_missed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.mcap");
    let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
    let unit = CameraUnit {
        cameras: vec!["cam7".to_owned()],
        rate_hz: 10,
        ..CameraUnit::default()
    };
    let listed = CameraUnit::attachment(&[unit]);
    writer
        .attach(&listed.name, &listed.media_type, &listed.bytes)
        .unwrap();
    write_samples(&mut writer, 0..1_000);
    writer.finish().unwrap();
    let judgement = diagnosis(&path, Depth::Indexes);
    let rate = found_at(&judgement, "rate", "/cam7/image");
    assert_eq!(rate.verdict, Verdict::Fail, "{rate:?}");
    assert_eq!(
        found_at(&judgement, "rate", "/imu0/data_raw").verdict,
        Verdict::Pass
    );
}

/// A receiver whose almanac is old names a second of years ago, and as steadily as any other.
#[test]
fn a_device_that_names_another_year_is_no_pass() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.mcap");
    write_described(&path, 100_000_000, 0);
    let judgement = diagnosis(&path, Depth::Indexes);
    assert_eq!(found(&judgement, "stamps").verdict, Verdict::Pass);
    let path = folder.path().join("years.mcap");
    write_described(&path, 100_000_000, -619_315_200_000_000_000);
    let judgement = diagnosis(&path, Depth::Indexes);
    let apart = judgement.findings().iter().filter(|f| f.code == "stamps");
    assert!(apart.clone().count() > 0 && apart.clone().all(|f| f.verdict != Verdict::Pass));
}

/// A recording without the recorder's report, as one that crashed is: its health is on topics.
fn interrupted(path: &Path, values: &[(&str, HealthValue)]) -> Finding {
    let mut writer = Writer::create(path, &WriterConfig::default()).unwrap();
    for (n, (quantity, value)) in values.iter().enumerate() {
        let time = Timestamp::from_nanos(START + n as i64 * PERIOD_NS);
        let channel = Channel {
            topic: &format!("{HEALTH}{quantity}"),
            schema_name: HEALTH_VALUE.name,
            schema_text: HEALTH_VALUE.text,
        };
        let bytes = encode_health_value(time, &value.device, value);
        writer.write_cdr(&channel, time, time, &bytes).unwrap();
    }
    writer.finish().unwrap();
    found(&diagnosis(path, Depth::Indexes), "losses").clone()
}

/// Naively a recording that crashed had no losses that anybody knew of: a warning, as for one that lacks nothing.
#[test]
fn what_a_crashed_recorder_had_lost_is_read_from_its_health() {
    let folder = tempfile::tempdir().unwrap();
    let value = |device: &str, value: f64, level: u8, text: &str| HealthValue {
        device: device.to_owned(),
        value,
        level,
        text: text.to_owned(),
    };
    let whole = [("drops", value("lidar", 0.0, 0, ""))];
    let losses = interrupted(&folder.path().join("whole.mcap"), &whole);
    assert_eq!(losses.verdict, Verdict::Warn, "{losses:?}");
    assert!(losses.what.contains("no packet was lost"), "{losses:?}");
    let values = [
        ("drops", value("lidar", 3.0, 0, "")),
        ("rate", value("imu0", 0.0, 2, "no samples for 0.9 s: check")),
        ("rate", value("imu0", 0.0, 2, "no samples for 1.4 s: check")),
        ("drops", value("lidar", 512.0, 2, "")),
        ("drops", value("imu0", 0.0, 0, "")),
    ];
    let losses = interrupted(&folder.path().join("lossy.mcap"), &values);
    assert_eq!(losses.verdict, Verdict::Fail, "{losses:?}");
    assert!(
        losses.what.contains("512 packets") && losses.what.contains("imu0: no samples"),
        "{losses:?}"
    );
    assert_eq!(losses.what.matches("no samples").count(), 1, "{losses:?}");
}
