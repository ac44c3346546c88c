use std::path::Path;

use lsfb_recording::{Writer, WriterConfig};
use lsfb_types::{ImuSample, Stamped, Timestamp, no_progress};

use super::*;
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
    for n in (0..3000).filter(|n| n % 4 != 3) {
        let time = Timestamp::from_nanos(START + n * PERIOD_NS);
        let sample = Stamped {
            time,
            arrival: time,
            device_ticks: 0,
            sample: ImuSample::default(),
        };
        writer.write_imu("imu0", &sample).unwrap();
    }
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
