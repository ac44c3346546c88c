use std::time::Duration;

use lsfb_recording::{Writer, WriterConfig};
use lsfb_types::{ImuSample, Stamped, Timestamp};

use super::*;

#[test]
fn a_recording_without_raw_data_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("samples.mcap");
    let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
    let time = Timestamp::from_nanos(1_772_359_200_000_000_000);
    let sample = Stamped {
        time,
        arrival: time,
        device_ticks: 0,
        sample: ImuSample::default(),
    };
    writer.write_imu("imu0", &sample).unwrap();
    writer.finish().unwrap();
    let message = Playback::open(&path).unwrap_err().to_string();
    assert!(
        message.contains("samples.mcap") && message.contains("to play"),
        "{message}"
    );
}

#[test]
fn turns_follow_each_other_at_the_span() {
    let play = |turns| Play {
        path: PathBuf::new(),
        capture: false,
        start: Timestamp::default(),
        span_ns: 1_000,
        turns,
    };
    let offsets = |turns| play(turns).turns().take(3).collect::<Vec<_>>();
    assert_eq!(offsets(Turns::Times(0)), [0]);
    assert_eq!(offsets(Turns::Times(2)), [0, 1_000]);
    assert_eq!(offsets(Turns::Endless), [0, 1_000, 2_000]);
}

#[test]
fn a_host_that_never_comes_does_not_hold_the_mock() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("walk.mcap");
    let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
    let time = Timestamp::from_nanos(1_772_359_200_000_000_000);
    let packet = lsfb_types::Packet {
        arrival: time,
        bytes: vec![1, 2, 3],
    };
    writer.write_raw("imu0", 0, 0, &packet, time).unwrap();
    writer.finish().unwrap();
    let playback = Playback::open(&path).unwrap();
    assert_eq!(playback.imu_rate_hz(), Some(200));
    let endpoints = PlaybackEndpoints {
        lidar_data: ([127, 0, 0, 1], 2368).into(),
        lidar_position: ([127, 0, 0, 1], 8308).into(),
        camera_sockets: Vec::new(),
        sidecar: ([127, 0, 0, 1], 8790).into(),
        patience: Duration::ZERO,
    };
    let session = playback
        .start(&endpoints, Pace::RealTimes(1.0), Turns::Endless)
        .unwrap();
    session.stop_handle().stop();
    let sent = session.join(&lsfb_types::no_progress).unwrap();
    assert_eq!(sent, SessionReport::default());
}
