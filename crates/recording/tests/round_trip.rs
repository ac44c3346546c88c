//! What is written is read back, whole and in order, and the file is an MCAP file like any other.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::path::Path;

use lsfb_geometry::camera::Lens;
use lsfb_geometry::{Camera, ImuNoiseModel, Rig, RigCamera, RigImu, RigLidar, Se3, Vector6};
use lsfb_recording::{
    Channel, Compression, LIDAR_POSITION, Recording, Summary, Writer, WriterConfig, message,
    rig_sha256,
};
use lsfb_types::{
    Image, ImuSample, LidarPoint, LidarScan, Packet, Stamped, Timestamp, no_progress,
};

const START: Timestamp = Timestamp::from_nanos(1_772_359_200_000_000_000);

fn rig() -> Rig {
    let camera = Camera {
        width: 32,
        height: 20,
        lens: Lens::KannalaBrandt {
            focal_px: [17.5; 2],
            principal_px: [15.5, 9.5],
            distortion: [0.01, -0.02, 0.003, 0.0],
        },
    };
    let pose = |x: f64| Se3::exp(&Vector6::new(0.1, 0.2, x, 0.05, -0.03, x));
    let cameras = (0..2).map(|i| {
        let rig_from_camera = pose(f64::from(i));
        (
            format!("cam{i}"),
            RigCamera {
                camera,
                rig_from_camera,
                timing: Default::default(),
                sigmas: Default::default(),
            },
        )
    });
    Rig {
        calibrated_unix_s: Some(1_772_350_000),
        cameras: cameras.collect(),
        imus: RigImu::from(ImuNoiseModel {
            gyro_noise_density: 1e-3,
            accel_noise_density: 1e-2,
            gyro_bias_walk: 1e-5,
            accel_bias_walk: 1e-4,
        })
        .alone(),
        lidars: RigLidar {
            rig_from_lidar: pose(0.3),
            range_noise_m: 0.02,
        }
        .alone(),
        ..Rig::empty("backpack")
    }
}

fn image(camera: u8, n: u32) -> Stamped<Image> {
    let time = START + i64::from(n) * 100_000_000;
    Stamped {
        time,
        arrival: time + 7_000_000 + i64::from(camera),
        device_ticks: 171_323_050 + u64::from(n),
        sample: Image {
            width: 32,
            height: 20,
            pixels: (0..640u32)
                .map(|i| (i * (n + 1) + u32::from(camera)) as u8)
                .collect(),
            exposure_ns: 4_000_000 + n,
            frame_id: n,
        },
    }
}

fn imu(n: u32) -> Stamped<ImuSample> {
    let time = START + i64::from(n) * 5_000_000;
    Stamped {
        time,
        arrival: time + 1_000_000,
        device_ticks: u64::from(n) * 50 + 1,
        sample: ImuSample {
            angular_velocity_rad_s: [f64::from(n) * 1e-3, -0.1, 0.2],
            specific_force_m_s2: [0.1, 0.2, 9.81],
        },
    }
}

fn scan(n: u32) -> Stamped<LidarScan> {
    let time = START + i64::from(n) * 100_000_000;
    let points = (0..50u16).map(|i| LidarPoint {
        position_m: [f32::from(i) * 0.1, n as f32, 0.5],
        intensity: i as u8,
        ring: i % 32,
        time_offset_ns: u32::from(i) * 2304,
        ..LidarPoint::default()
    });
    Stamped {
        time,
        arrival: time + 101_000_000,
        device_ticks: 0,
        sample: LidarScan {
            points: points.collect(),
        },
    }
}

fn data_packets(n: u32) -> Vec<Packet> {
    let start = START + i64::from(n) * 100_000_000;
    (0..4u8)
        .map(|i| Packet {
            arrival: start + i64::from(i) * 660_000,
            bytes: vec![i.wrapping_add(n as u8); 1206],
        })
        .collect()
}

/// Three seconds of everything.
fn write_walk(path: &Path, config: &WriterConfig) -> Summary {
    let mut writer = Writer::create(path, config).unwrap();
    writer.attach_rig(&rig()).unwrap();
    for n in 0..30 {
        for k in 0..20 {
            writer.write_imu("imu0", &imu(n * 20 + k)).unwrap();
        }
        writer
            .write_lidar_packets(
                "lidar",
                START + i64::from(n) * 100_000_000,
                &data_packets(n),
            )
            .unwrap();
        writer.write_scan("lidar", &scan(n)).unwrap();
        writer.write_image("cam0", &image(0, n)).unwrap();
        writer
            .write_image_with_trailer("cam1", &image(1, n), &[0x3b, n as u8])
            .unwrap();
        let position = Packet {
            arrival: image(0, n).arrival,
            bytes: vec![n as u8; 512],
        };
        writer
            .write_raw(LIDAR_POSITION, 0, u64::from(n), &position, position.arrival)
            .unwrap();
        writer
            .write_raw("imu0", 54, u64::from(n), &position, position.arrival)
            .unwrap();
    }
    writer.finish().unwrap()
}

fn check_walk(recording: &Recording) {
    assert_eq!(recording.damage(), []);
    let images: Result<Vec<_>, _> = recording.images("cam0").unwrap().collect();
    assert_eq!(
        images.unwrap(),
        (0..30).map(|n| image(0, n)).collect::<Vec<_>>()
    );
    let images: Result<Vec<_>, _> = recording.images_of(&["cam1", "cam0"]).unwrap().collect();
    let images: Vec<_> = images
        .unwrap()
        .into_iter()
        .map(|i| (i.camera, i.image))
        .collect();
    assert_eq!(
        images,
        (0..30)
            .flat_map(|n| [(0, image(1, n)), (1, image(0, n))])
            .collect::<Vec<_>>()
    );
    let trailers: Result<Vec<_>, _> = recording.frame_meta("cam1").unwrap().collect();
    let trailers: Vec<_> = trailers
        .unwrap()
        .into_iter()
        .map(|m| m.sample.trailer)
        .collect();
    assert_eq!(trailers, (0..30).map(|n| vec![0x3b, n]).collect::<Vec<_>>());
    let samples: Result<Vec<_>, _> = recording.imu().unwrap().collect();
    assert_eq!(samples.unwrap(), (0..600).map(imu).collect::<Vec<_>>());
    let scans: Result<Vec<_>, _> = recording.scans().unwrap().collect();
    assert_eq!(scans.unwrap(), (0..30).map(scan).collect::<Vec<_>>());
    let packets: Result<Vec<_>, _> = recording.packets("lidar/packets").unwrap().collect();
    let packets = packets.unwrap();
    assert_eq!(packets[119].sequence, 119);
    let packets: Vec<_> = packets.into_iter().map(|p| p.packet).collect();
    assert_eq!(packets, (0..30).flat_map(data_packets).collect::<Vec<_>>());
    let positions: Result<Vec<_>, _> = recording.packets(LIDAR_POSITION).unwrap().collect();
    let positions = positions.unwrap();
    assert_eq!(
        (
            positions.len(),
            positions[29].sequence,
            positions[29].packet.bytes.len()
        ),
        (30, 29, 512)
    );
    assert_eq!(
        recording
            .packets("imu0")
            .unwrap()
            .next()
            .unwrap()
            .unwrap()
            .kind,
        54
    );
}

#[test]
fn everything_comes_back_with_every_compression() {
    let dir = tempfile::tempdir().unwrap();
    for compression in [Compression::None, Compression::Lz4, Compression::Zstd] {
        let path = dir.path().join("walk.mcap");
        let session = BTreeMap::from([("seed".to_owned(), "7".to_owned())]);
        let config = WriterConfig {
            compression,
            session,
            ..WriterConfig::default()
        };
        let summary = write_walk(&path, &config);
        assert_eq!(summary.bytes, std::fs::metadata(&path).unwrap().len());

        let recording = Recording::open(&path).unwrap();
        check_walk(&recording);
        assert_eq!(recording.topics(), summary.topics);
        let count = |topic: &str| {
            recording
                .topics()
                .iter()
                .find(|t| t.topic == topic)
                .unwrap()
                .messages
        };
        assert_eq!(
            (
                count("/imu0/data_raw"),
                count("/imu0/time_ref"),
                count("/tf_static")
            ),
            (600, 600, 1)
        );
        assert_eq!(count("/cam0/camera_info"), count("/cam0/image"), "one each");
        assert_eq!(recording.verify(&no_progress).unwrap(), []);
        assert_eq!(recording.metadata("lsfb.session").unwrap()["seed"], "7");
        assert!(recording.metadata("lsfb.session").unwrap()["software"].starts_with("lsfb "));
        let range = recording.arrival_range().unwrap();
        assert_eq!(range.start, data_packets(0)[3].arrival.min(imu(0).arrival));
        // To the last bit: its hash names it.
        let calibration = recording.calibration().unwrap();
        assert_eq!(calibration.rig, rig());
        assert_eq!(calibration.sha256, rig_sha256(&rig()));
        assert_eq!(
            calibration.stated_sha256.as_ref(),
            Some(&calibration.sha256)
        );
        let stated = recording.metadata("lsfb.rig").unwrap();
        assert_eq!(
            (
                stated["name"].as_str(),
                stated["calibrated_unix_s"].as_str()
            ),
            ("backpack", "1772350000")
        );
        let end = recording.end_time().unwrap().unwrap();
        assert!(
            (0.0..1.0).contains(&imu(599).time.secs_since(end)),
            "{end:?}"
        );
    }
}

#[test]
fn same_samples_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    for compression in [Compression::Lz4, Compression::Zstd] {
        let config = WriterConfig {
            compression,
            ..WriterConfig::default()
        };
        let files: Vec<_> = (0..4)
            .map(|i| {
                let path = dir.path().join(format!("{i}.mcap"));
                write_walk(&path, &config);
                std::fs::read(path).unwrap()
            })
            .collect();
        assert!(files.iter().all(|f| *f == files[0]), "{compression:?}");
    }
}

#[test]
fn the_mcap_crate_reads_it_and_chunks_are_bounded() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("walk.mcap");
    let config = WriterConfig {
        chunk_bytes: 20_000,
        ..WriterConfig::default()
    };
    let written = write_walk(&path, &config);
    let bytes = std::fs::read(&path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert!(summary.chunk_indexes.len() > 10);
    for chunk in &summary.chunk_indexes {
        // Frames come on top: small, and once.
        assert!(
            chunk.uncompressed_size < 24_000,
            "{}",
            chunk.uncompressed_size
        );
        assert!(chunk.message_end_time - chunk.message_start_time < 1_300_000_000);
        assert_eq!(chunk.compression, "lz4");
    }
    let messages: Result<Vec<_>, _> = mcap::MessageStream::new(&bytes).unwrap().collect();
    let messages = messages.unwrap();
    assert_eq!(messages.len() as u64, written.messages);
    let first = messages
        .iter()
        .find(|m| m.channel.topic == "/cam0/image")
        .unwrap();
    assert_eq!(first.publish_time, START.nanos() as u64);
    assert_eq!(first.log_time, image(0, 0).arrival.nanos() as u64);
    check_walk(&Recording::open(&path).unwrap());
}

#[test]
fn a_sidecar_is_found_by_its_camera() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("glasses.mcap");
    let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
    writer.attach_rig(&rig()).unwrap();
    writer.place_sidecar("glasses", &rig());
    for n in 0..3 {
        let (frame, sample) = (image(0, n), imu(n));
        let meta = message::FrameMeta {
            frame_id: n,
            exposure_ns: 4_000_000 + n,
            ..Default::default()
        };
        let pairs = [
            (
                "/sidecar/glasses/cam0/frame_meta",
                message::FRAME_META,
                message::encode_frame_meta(frame.time, "cam0", &meta),
            ),
            (
                "/sidecar/glasses/cam0/image",
                message::IMAGE,
                message::encode_image(frame.time, "cam0", &frame.sample),
            ),
            (
                "/sidecar/glasses/imu",
                message::IMU,
                message::encode_imu(
                    sample.time,
                    "imu",
                    &sample.sample,
                    message::ImuVariance::UNKNOWN,
                ),
            ),
        ];
        for (topic, schema, bytes) in pairs {
            let channel = Channel {
                topic,
                schema_name: schema.name,
                schema_text: schema.text,
            };
            writer
                .write_cdr(&channel, frame.time, frame.arrival, &bytes)
                .unwrap();
        }
    }
    writer.finish().unwrap();
    let recording = Recording::open(&path).unwrap();
    let images: Result<Vec<_>, _> = recording.images("cam0").unwrap().collect();
    let expected = (0..3).map(|n| Stamped {
        device_ticks: 0,
        ..image(0, n)
    });
    assert_eq!(images.unwrap(), expected.collect::<Vec<_>>());
    assert_eq!(recording.imu().unwrap().count(), 3);
    assert_eq!(
        recording
            .messages("/sidecar/glasses/cam0/camera_info")
            .unwrap()
            .count(),
        3
    );
    assert_eq!(recording.messages("/tf_static").unwrap().count(), 1);
}

/// A phone whose names are those of the backpack. Frames and intrinsics that are told apart by name alone would be the backpack's.
#[test]
fn a_sidecar_beside_a_rig_has_frames_and_intrinsics_of_its_own() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("both.mcap");
    let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
    writer.attach_rig(&rig()).unwrap();
    let mut phone = rig();
    phone.name = "phone".to_owned();
    for camera in phone.cameras.values_mut() {
        camera.camera = Camera::pinhole(32, 20, [41.0, 41.0], [15.5, 9.5]);
    }
    writer.place_sidecar("phone", &phone);
    let (frame, sample) = (image(0, 0), imu(0));
    writer.write_image("cam0", &frame).unwrap();
    writer.write_imu("imu0", &sample).unwrap();
    let variance = message::ImuVariance::UNKNOWN;
    let messages = [
        (
            "/sidecar/phone/cam0/image",
            message::IMAGE,
            message::encode_image(frame.time, "cam0", &frame.sample),
        ),
        (
            "/sidecar/phone/imu",
            message::IMU,
            message::encode_imu(sample.time, "imu0", &sample.sample, variance),
        ),
    ];
    for (topic, schema, bytes) in messages {
        let channel = Channel {
            topic,
            schema_name: schema.name,
            schema_text: schema.text,
        };
        writer
            .write_cdr(&channel, frame.time, frame.arrival, &bytes)
            .unwrap();
    }
    writer.finish().unwrap();

    let recording = Recording::open(&path).unwrap();
    let only = |topic: &str| {
        let mut messages = recording.messages(topic).unwrap();
        let bytes = messages.next().unwrap().unwrap().bytes;
        assert!(messages.next().is_none(), "{topic}");
        bytes
    };
    assert_eq!(
        only("/sidecar/phone/cam0/image"),
        message::encode_image(frame.time, "phone/cam0", &frame.sample)
    );
    assert_eq!(
        only("/sidecar/phone/imu"),
        message::encode_imu(sample.time, "phone/imu0", &sample.sample, variance)
    );
    let lens = &phone.cameras["cam0"].camera;
    assert_eq!(
        only("/sidecar/phone/cam0/camera_info"),
        message::encode_camera_info(frame.time, "phone/cam0", lens)
    );
    let own = &rig().cameras["cam0"].camera;
    assert_eq!(
        only("/cam0/camera_info"),
        message::encode_camera_info(frame.time, "cam0", own)
    );
    let frames = only("/tf_static");
    let holds = |name: &str| {
        let name = format!("{name}\0");
        frames.windows(name.len()).any(|w| w == name.as_bytes())
    };
    assert!(
        ["cam0", "phone/rig", "phone/cam0", "phone/cam1"]
            .iter()
            .all(|name| holds(name))
    );
}

/// Two units whose links run seconds apart; the file is in the order of arrival.
#[test]
fn images_of_several_cameras_come_in_the_order_of_their_time() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("walk.mcap");
    let config = WriterConfig {
        chunk_bytes: 2_000,
        ..WriterConfig::default()
    };
    let mut writer = Writer::create(&path, &config).unwrap();
    for n in 0..20 {
        writer.write_image("cam0", &image(0, n)).unwrap();
        if let Some(late) = n.checked_sub(8) {
            writer.write_image("cam1", &image(1, late)).unwrap();
        }
    }
    for late in 12..20 {
        writer.write_image("cam1", &image(1, late)).unwrap();
    }
    writer.finish().unwrap();
    let recording = Recording::open(&path).unwrap();
    let images = recording.images_of(&["cam0", "cam1"]).unwrap();
    let order: Vec<_> = images
        .map(Result::unwrap)
        .map(|i| (i.image.sample.frame_id, i.camera))
        .collect();
    let expected: Vec<_> = (0..20).flat_map(|n| [(n, 0), (n, 1)]).collect();
    assert_eq!(order, expected);
}

#[test]
fn what_is_not_there_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("walk.mcap");
    let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
    writer.write_imu("imu1", &imu(0)).unwrap();
    writer.write_imu("imu2", &imu(0)).unwrap();
    let error = writer
        .write_imu(
            "imu1",
            &Stamped {
                time: START + i64::MAX / 2,
                ..imu(0)
            },
        )
        .unwrap_err();
    assert!(
        error.to_string().contains("check the device's clock"),
        "{error}"
    );
    let mut wrong = image(0, 0);
    wrong.sample.width = 31;
    let error = writer.write_image("cam0", &wrong).unwrap_err();
    assert!(
        error.to_string().contains("640 pixels in a 31×20 image"),
        "{error}"
    );
    writer.finish().unwrap();

    let recording = Recording::open(&path).unwrap();
    let message = |error: lsfb_recording::Error| {
        let message = error.to_string();
        assert!(message.contains("walk.mcap"), "{message}");
        message
    };
    let text = message(recording.images("cam0").err().unwrap());
    assert!(
        text.contains("no topic for `cam0`") && text.contains("/imu1/data_raw"),
        "{text}"
    );
    let text = message(recording.imu().err().unwrap());
    assert!(text.contains("/imu1/data_raw, /imu2/data_raw"), "{text}");
    let text = message(recording.images("/imu1/data_raw").err().unwrap());
    assert!(
        text.contains("carries cdr sensor_msgs/msg/Imu, expected cdr sensor_msgs/msg/Image"),
        "{text}"
    );
    let text = message(recording.rig().unwrap_err());
    assert!(text.contains("no attachment `rig.toml`"), "{text}");
    assert!(message(recording.scans().err().unwrap()).contains("/lidar/points"));
    assert!(recording.metadata("nothing").unwrap().is_empty());
}

#[test]
fn the_rig_in_the_specification_is_one() {
    let page = include_str!("../FORMAT.md");
    let (_, rest) = page.split_once("```toml\n").unwrap();
    let (example, _) = rest.split_once("```").unwrap();
    let rig = Rig::from_toml(example, "FORMAT.md").unwrap();
    assert_eq!(
        (
            rig.cameras["cam0"].camera.width,
            rig.lidar().unwrap().range_noise_m
        ),
        (640, 0.03)
    );
    assert_eq!(rig.imu_noise().unwrap().accel_bias_walk, 1e-4);
}

/// Without compression a large message goes into the file as it lies, and closes its chunk.
#[test]
fn large_messages_that_are_not_copied_come_back_among_small_ones() {
    const LARGE_BYTES: usize = 300 << 10;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.mcap");
    let config = WriterConfig {
        compression: Compression::None,
        ..WriterConfig::default()
    };
    let mut writer = Writer::create(&path, &config).unwrap();
    let channel = |topic| Channel {
        topic,
        schema_name: "x/msg/X",
        schema_text: "uint8[] data",
    };
    let bytes =
        |n: usize, len: usize| -> Vec<u8> { (0..len).map(|i| (i * 31 + n) as u8).collect() };
    for n in 0..12 {
        let time = START + n as i64 * 1_000_000;
        let small = bytes(n, 10 + n);
        writer
            .write_cdr(&channel("/small"), time, time, &small)
            .unwrap();
        assert_eq!(writer.open_messages(), 1);
        // Every third image has a meta message in its own chunk.
        if n % 3 == 0 {
            let side = 1024;
            let image = Image {
                width: side,
                height: 300,
                pixels: bytes(n, LARGE_BYTES),
                exposure_ns: 1,
                frame_id: n as u32,
            };
            let stamped = Stamped {
                time,
                arrival: time,
                device_ticks: 1,
                sample: image,
            };
            writer.write_image("cam0", &stamped).unwrap();
        } else {
            let large = bytes(n, LARGE_BYTES);
            writer
                .write_cdr(&channel("/large"), time, time, &large)
                .unwrap();
        }
        assert_eq!(writer.open_messages(), 0);
    }
    writer.finish().unwrap();

    let recording = Recording::open(&path).unwrap();
    assert_eq!(recording.verify(&no_progress).unwrap(), []);
    for (n, message) in recording.messages("/small").unwrap().enumerate() {
        assert_eq!(message.unwrap().bytes, bytes(n, 10 + n));
    }
    let large: Vec<_> = recording.messages("/large").unwrap().collect();
    let numbers = (0..12).filter(|n| n % 3 != 0);
    assert_eq!(large.len(), 8);
    for (message, n) in large.into_iter().zip(numbers) {
        assert!(message.unwrap().bytes == bytes(n, LARGE_BYTES), "{n}");
    }
    for (image, n) in recording.images("cam0").unwrap().zip((0..12).step_by(3)) {
        assert!(image.unwrap().sample.pixels == bytes(n, LARGE_BYTES), "{n}");
    }
    // Another reader, checksums included.
    let file = std::fs::read(&path).unwrap();
    let messages = mcap::MessageStream::new(&file).unwrap();
    assert_eq!(messages.map(Result::unwrap).count(), 12 + 8 + 2 * 4);
    let summary = mcap::Summary::read(&file).unwrap().unwrap();
    assert_eq!(summary.chunk_indexes.len(), 12);
}
