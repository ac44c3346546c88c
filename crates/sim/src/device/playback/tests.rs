use std::time::Duration;

use lsfb_drivers::mynt_s::wire::{
    DeviceInfo, ImuProtocol, ImuResponse, ImuSegment, ImuValues, TimeSource, Version,
};
use lsfb_drivers::mynt_s::{CameraConfig, Decoder, DecoderConfig, ImuDecoder, MyntCamera};
use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::transport::uvc::FrameFormat;
use lsfb_recording::{CameraUnit, KeptFile, Writer, WriterConfig};
use lsfb_types::{Image, ImuSample, Packet, Stamped, Timestamp};

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
    let packet = Packet {
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
        can: String::new(),
        usb: PathBuf::new(),
        sidecars: BTreeMap::new(),
        patience: Duration::ZERO,
    };
    let session = playback
        .start(&endpoints, Pace::RealTimes(1.0), Turns::Endless)
        .unwrap();
    session.stop_handle().stop();
    let sent = session.join(&lsfb_types::no_progress).unwrap();
    assert_eq!(sent, SessionReport::default());
}

const START_NS: i64 = 1_772_359_200_000_000_000;
const CAMERAS: [&str; 4] = ["cam0", "cam1", "cam2", "cam3"];
const SERIAL: &str = "07C41A1900090731";

/// A segment of protocol 1 every 5 ms, gyroscope and accelerometer by turns; serials from 1.
fn segment(serial: u32) -> ImuSegment {
    let raw = [serial as i16, 0, 7];
    ImuSegment {
        serial,
        timestamp_us: 5_000 * u64::from(serial),
        time_source: TimeSource::Device,
        temperature: 0.0,
        values: if serial.is_multiple_of(2) {
            ImuValues::RawGyroscope(raw)
        } else {
            ImuValues::RawAccelerometer(raw)
        },
    }
}

/// A unit of four cameras at 10 Hz whose IMU speaks protocol 1: three frames, 60 segments, the first answers repeated, and one
/// that was damaged on the way.
fn record_a_unit_of_four(path: &Path) {
    let mut writer = Writer::create(path, &WriterConfig::default()).unwrap();
    let info = DeviceInfo {
        serial: SERIAL.to_owned(),
        spec: Version { major: 1, minor: 2 },
        ..DeviceInfo::default()
    };
    let unit = CameraUnit {
        cameras: CAMERAS.map(str::to_owned).to_vec(),
        frame_px: [64, 4],
        rate_hz: 10,
        imu: Some("imu1".to_owned()),
        files: vec![KeptFile {
            id: UnitFile::DeviceInfo.id(),
            attachment: "info".to_owned(),
        }],
    };
    writer
        .attach("info", "application/octet-stream", &info.emit())
        .unwrap();
    let list = CameraUnit::attachment(&[unit]);
    writer
        .attach(&list.name, &list.media_type, &list.bytes)
        .unwrap();
    let time = |ms: i64| Timestamp::from_nanos(START_NS + ms * 1_000_000);
    let mut answers = 0;
    let mut answer = |writer: &mut Writer, ms: i64, serials: std::ops::RangeInclusive<u32>| {
        let segments = serials.map(segment).collect();
        let bytes = ImuResponse { segments }.emit(ImuProtocol::Integer).unwrap();
        let packet = Packet {
            arrival: time(ms),
            bytes,
        };
        writer
            .write_raw("imu1", 0, answers, &packet, time(ms))
            .unwrap();
        answers += 1;
    };
    for n in 0..3 {
        let ms = 100 * n;
        for (camera, name) in (0..).zip(CAMERAS) {
            let image = Stamped {
                time: time(ms),
                arrival: time(ms + 3),
                device_ticks: 5_000 + 1_000 * ms as u64,
                sample: Image {
                    width: 16,
                    height: 4,
                    pixels: vec![10 * n as u8 + camera; 64],
                    exposure_ns: 4_000_000,
                    frame_id: n as u32,
                },
            };
            writer.write_image(name, &image).unwrap();
        }
        let first = 20 * n as u32 + 1;
        // The host asked again for what it had not confirmed.
        answer(&mut writer, ms + 50, first..=first + 9);
        answer(&mut writer, ms + 90, first..=first + 19);
        if n == 1 {
            let damaged = Packet {
                arrival: time(ms + 95),
                bytes: vec![0x5B, 0, 0, 1, 9, 8],
            };
            writer
                .write_raw("imu1", 0, 99, &damaged, time(ms + 95))
                .unwrap();
        }
    }
    writer.finish().unwrap();
}

#[test]
fn a_unit_of_four_cameras_and_its_imu_are_played_to_any_host() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.mcap");
    record_a_unit_of_four(&path);
    let playback = Playback::open(&path).unwrap();
    assert!(playback.unplayed().is_empty());
    let [plan] = playback.cameras() else {
        panic!("one unit: {:?}", playback.cameras());
    };
    assert_eq!(plan.names, CAMERAS);
    assert_eq!((plan.frame_px, plan.rate_hz), ([64, 4], 10));
    assert_eq!(plan.imu.as_deref(), Some("imu1"));
    let socket = folder.path().join("unit");
    let endpoints = PlaybackEndpoints {
        lidar_data: ([127, 0, 0, 1], 2368).into(),
        lidar_position: ([127, 0, 0, 1], 8308).into(),
        camera_sockets: vec![socket.clone()],
        can: String::new(),
        usb: PathBuf::new(),
        sidecars: BTreeMap::new(),
        patience: Duration::ZERO,
    };
    let session = playback
        .start(&endpoints, Pace::RealTimes(4.0), Turns::Times(1))
        .unwrap();
    let format = FrameFormat {
        width: 64,
        height: 4,
    };
    let mut camera = MyntCamera::open(&CameraConfig {
        path: socket,
        // That of the recorded unit.
        serial: SERIAL.to_owned(),
        format,
        ..CameraConfig::default()
    })
    .unwrap();
    assert_eq!(camera.imu_protocol(), ImuProtocol::Integer);
    let mut decoder = Decoder::new(DecoderConfig {
        format,
        cameras: 4,
        ..DecoderConfig::default()
    });
    let mut imu = ImuDecoder::new(ImuProtocol::Integer);
    let mut greys = Vec::new();
    let mut samples = Vec::new();
    // The unit stays until its IMU is read out.
    loop {
        match camera.recv(Duration::from_millis(5)) {
            Ok(Some(packet)) => {
                let frame = decoder.push(&packet).unwrap().unwrap().sample;
                greys.push(frame.images.iter().map(|i| i.pixels[0]).collect::<Vec<_>>());
            }
            Ok(None) => {}
            Err(lsfb_drivers::Error::EndOfStream { .. }) => break,
            Err(error) => panic!("{error}"),
        }
        if let Ok(answer) = camera.poll_imu(imu.last_serial()) {
            samples.extend(imu.push(&answer).unwrap_or_default());
        }
    }
    let sent = session.join(&lsfb_types::no_progress).unwrap();
    assert_eq!(
        greys,
        [[0, 1, 2, 3], [10, 11, 12, 13], [20, 21, 22, 23]].map(|g| g.to_vec())
    );
    assert_eq!((sent.stereo_frames, sent.unit_imu_segments), (3, 60));
    let counters = imu.counters();
    assert_eq!((counters.segments, counters.missing), (60, 0));
    assert_eq!(counters.bad_answers, 1);
    let ticks: Vec<u64> = samples.iter().map(|s| s.device_ticks).collect();
    let expected: Vec<u64> = (2..60).step_by(2).map(|serial| 5_000 * serial).collect();
    assert_eq!(ticks, expected);
}

#[test]
fn recordings_that_list_no_units_have_their_cameras_in_pairs() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("old.mcap");
    let write = |names: &[&str]| {
        let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
        for name in names {
            let time = Timestamp::from_nanos(START_NS);
            let image = Stamped {
                time,
                arrival: time,
                device_ticks: 1,
                sample: Image {
                    width: 16,
                    height: 4,
                    pixels: vec![0; 64],
                    exposure_ns: 1,
                    frame_id: 0,
                },
            };
            writer.write_image(name, &image).unwrap();
        }
        writer.finish().unwrap();
        Playback::open(&path)
    };
    let playback = write(&CAMERAS).unwrap();
    let names: Vec<_> = playback.cameras().iter().map(|c| &c.names).collect();
    assert_eq!(names, [&["cam0", "cam1"], &["cam2", "cam3"]]);
    let message = write(&CAMERAS[..3]).unwrap_err().to_string();
    assert!(message.contains("cam2 has no partner"), "{message}");
}
