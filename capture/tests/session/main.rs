//! Whole sessions against devices that speak the real wire formats.

#![allow(
    clippy::unwrap_used,
    reason = "a test file as a whole; clippy.toml only spares #[test] functions"
)]

mod glasses;
mod hostile;
mod live;
mod mock;
mod output;
mod phones;
mod several;
mod silent;
mod stale;
mod steps;

use std::net::SocketAddr;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use lsfb_capture::{
    CameraUnitConfig, CaptureReport, DevicesConfig, Ending, ImuFamily, ImuLineConfig,
    LidarNetConfig, Overflow, RecorderConfig, ReplayConfig, Session, StreamReport, Tapped,
    replay_recording,
};
use lsfb_drivers::mynt_s::wire::DeviceInfo;
use lsfb_recording::message::{self, Remark, decode_remark};
use lsfb_recording::{Channel, LIDAR_POSITION, REMARKS, Recording, Writer, WriterConfig};
use lsfb_types::{Packet, Timestamp, no_progress, until};
use mock::{CAMERA_PERIOD_NS, Farewell, IMU_PERIOD_NS, START_NS};

const LOOPBACK: SocketAddr =
    SocketAddr::new(std::net::IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), 0);

fn unit(path: &Path, names: [&str; 2]) -> CameraUnitConfig {
    CameraUnitConfig::stereo(path.to_owned(), names.map(str::to_owned))
}

fn line(path: &Path) -> ImuLineConfig {
    ImuLineConfig {
        name: "imu0".to_owned(),
        family: ImuFamily::Xsens,
        path: path.to_owned(),
        baud: 921_600,
        rate_hz: 200,
    }
}

/// The tests record megabytes: whatever room there is will do.
fn anywhere() -> DevicesConfig {
    DevicesConfig {
        recorder: RecorderConfig {
            least_space_secs: 0.0,
            ..RecorderConfig::default()
        },
        ..DevicesConfig::default()
    }
}

fn stream<'a>(report: &'a CaptureReport, name: &str) -> &'a StreamReport {
    report
        .streams
        .iter()
        .find(|stream| stream.name == name)
        .unwrap()
}

fn run(session: Session, out: &Path) -> CaptureReport {
    session.run(out, &no_progress).unwrap()
}

#[test]
fn every_packet_of_every_device_is_in_the_recording() {
    const LIDAR_PACKETS: u64 = 1_500;
    const FRAMES: u16 = 12;
    const SAMPLES: u32 = 400;
    const NOTES: u32 = 70;
    let folder = tempfile::tempdir().unwrap();
    let (front, rear) = (folder.path().join("front"), folder.path().join("rear"));
    let units = [
        mock::stereo_unit(&front, 65_530, Some(FRAMES), Farewell::Orderly),
        mock::stereo_unit(&rear, 7, Some(FRAMES), Farewell::Orderly),
    ];
    let imu = mock::imu(Some(SAMPLES), &[]);
    let config = DevicesConfig {
        overflow: Overflow::Wait,
        lidars: vec![LidarNetConfig {
            data: LOOPBACK,
            position: LOOPBACK,
            ..LidarNetConfig::default()
        }],
        cameras: vec![
            unit(&front, ["cam0", "cam1"]),
            unit(&rear, ["cam2", "cam3"]),
        ],
        imus: vec![line(&imu.path)],
        sidecar: Some(mock::sidecar(folder.path())),
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let lidar = mock::send_lidar(
        &session.lidar_addresses(),
        &session.counts(),
        LIDAR_PACKETS,
        Duration::ZERO,
    );
    let glasses = mock::glasses(mock::invited(&session, folder.path()), NOTES);
    let out = folder.path().join("scan.mcap");
    let report = run(session, &out);
    assert_eq!(
        lidar.join().unwrap(),
        LIDAR_PACKETS + LIDAR_PACKETS.div_ceil(14)
    );
    glasses.join().unwrap();
    imu.thread.join().unwrap();
    units.into_iter().for_each(|unit| unit.join().unwrap());

    assert_eq!(report.lost, 0, "{report:?}");
    assert!(
        report
            .streams
            .iter()
            .all(|stream| stream.ending == Ending::EndOfStream),
        "{report:?}"
    );
    assert_eq!(
        (report.groups.complete, report.groups.incomplete),
        (u64::from(FRAMES), 0)
    );

    let recording = Recording::open(&out).unwrap();
    assert!(recording.damage().is_empty());
    let packets: Vec<_> = recording
        .packets("lidar/packets")
        .unwrap()
        .map(Result::unwrap)
        .collect();
    assert_eq!(packets.len() as u64, LIDAR_PACKETS);
    for (n, packet) in packets.iter().enumerate() {
        assert_eq!(packet.packet.bytes, mock::lidar_packet(n as u64));
    }
    let positions: Vec<_> = recording
        .packets(LIDAR_POSITION)
        .unwrap()
        .map(Result::unwrap)
        .collect();
    assert_eq!(positions.len() as u64, LIDAR_PACKETS.div_ceil(14));
    assert_eq!(positions[1].packet.bytes, mock::position_packet(14 * 664));
    assert_eq!(positions[1].time.nanos(), START_NS + 14 * 664_000);

    // Ten turns a second from the top of the hour: scans begin at the tenths, whenever the packets arrived.
    let scans: Vec<_> = recording.scans().unwrap().map(Result::unwrap).collect();
    assert_eq!(scans.len(), 10);
    assert_eq!(
        scans
            .iter()
            .map(|scan| scan.sample.points.len() as u64)
            .sum::<u64>(),
        LIDAR_PACKETS * 384
    );
    for (n, scan) in scans.iter().enumerate() {
        let late_ns = scan.time.nanos() - START_NS - n as i64 * 100_000_000;
        assert!((0..56_000).contains(&late_ns), "scan {n}: {late_ns}");
        assert!((scan.sample.points[0].position_m[0] - 8.0).abs() < 1.0);
    }

    for camera in ["cam0", "cam1", "cam2", "cam3"] {
        let images: Vec<_> = recording
            .images(camera)
            .unwrap()
            .map(Result::unwrap)
            .collect();
        assert_eq!(images.len(), usize::from(FRAMES));
        for (n, image) in images.iter().enumerate() {
            assert_eq!(image.time.nanos(), START_NS + n as i64 * CAMERA_PERIOD_NS);
            assert_eq!((image.sample.width, image.sample.height), (640, 400));
            assert_eq!(image.sample.exposure_ns, 5_000_000);
            assert!(image.sample.pixels.iter().all(|grey| *grey == n as u8));
        }
    }
    let samples: Vec<_> = recording.imu().unwrap().map(Result::unwrap).collect();
    assert_eq!(samples.len(), SAMPLES as usize);
    for (n, sample) in samples.iter().enumerate() {
        assert_eq!(sample.time.nanos(), START_NS + n as i64 * IMU_PERIOD_NS);
        assert_eq!(sample.device_ticks, 50 * n as u64);
        assert_eq!(sample.sample.angular_velocity_rad_s, [0.0, 0.5, n as f64]);
        assert_eq!(sample.sample.specific_force_m_s2, [0.0, 0.0, 9.8125]);
    }
    let notes: Vec<_> = recording
        .messages("/sidecar/visor/note")
        .unwrap()
        .map(Result::unwrap)
        .collect();
    assert_eq!(notes.len(), NOTES as usize);
    for (n, note) in notes.iter().enumerate() {
        assert_eq!(note.time.nanos(), START_NS + n as i64);
        assert_eq!(note.bytes[4..], (n as u32).to_le_bytes());
    }
    let health: serde_json::Value =
        serde_json::from_slice(&recording.attachment("health.json").unwrap()).unwrap();
    assert_eq!(health["streams"].as_array().unwrap().len(), 5);
}

/// Issue 4: "N×K in general".
#[test]
fn units_of_any_number_of_cameras_form_one_group() {
    const FRAMES: u16 = 9;
    let folder = tempfile::tempdir().unwrap();
    let sizes = [1, 4, 2];
    let names = ["a", "b", "c", "d", "e", "f", "g"];
    let (mut units, mut cameras, mut first) = (Vec::new(), Vec::new(), 0);
    for (n, size) in sizes.into_iter().enumerate() {
        let path = folder.path().join(format!("unit{n}"));
        // Each began to count at another number; the last misses its last two frames.
        let frames = if n == 2 { FRAMES - 2 } else { FRAMES };
        let first_id = 100 * n as u16;
        units.push(mock::camera_unit(
            size,
            &path,
            first_id,
            Some(frames),
            Farewell::Orderly,
        ));
        cameras.push(CameraUnitConfig {
            names: names[first..first + size]
                .iter()
                .map(|n| (*n).to_owned())
                .collect(),
            ..CameraUnitConfig::stereo(path, Default::default())
        });
        first += size;
    }
    let config = DevicesConfig {
        overflow: Overflow::Wait,
        cameras,
        ..anywhere()
    };
    let out = folder.path().join("scan.mcap");
    let report = run(Session::open(&config).unwrap(), &out);
    units.into_iter().for_each(|unit| unit.join().unwrap());
    assert_eq!(
        (report.groups.complete, report.groups.incomplete),
        (7, 2),
        "{report:?}"
    );
    let missing: Vec<_> = report.groups.missing_by_camera.iter().collect();
    assert_eq!(missing, [(&"f".to_owned(), &2), (&"g".to_owned(), &2)]);
    assert_eq!(stream(&report, "b+c+d+e").decoded, 4 * u64::from(FRAMES));
    let recording = Recording::open(&out).unwrap();
    for (name, width) in names.iter().zip([1280, 320, 320, 320, 320, 640, 640]) {
        let images: Vec<_> = recording
            .images(name)
            .unwrap()
            .map(Result::unwrap)
            .collect();
        let frames = if width == 640 { FRAMES - 2 } else { FRAMES };
        assert_eq!(images.len(), usize::from(frames), "{name}");
        assert!(
            images
                .iter()
                .all(|i| (i.sample.width, i.sample.height) == (width, 400))
        );
    }
    let listed = recording.camera_units().unwrap();
    let listed: Vec<usize> = listed.iter().map(|unit| unit.cameras.len()).collect();
    assert_eq!(listed, sizes);
    // What each unit says about itself is kept as it came.
    let info = recording.attachment("unit/b/1.bin").unwrap();
    assert_eq!(DeviceInfo::parse(&info).unwrap().serial, "07C41A19");
}

#[test]
fn a_unit_of_another_family_is_recorded_too() {
    const SAMPLES: u32 = 900;
    let folder = tempfile::tempdir().unwrap();
    let imu = mock::microstrain(SAMPLES);
    let config = DevicesConfig {
        overflow: Overflow::Wait,
        imus: vec![ImuLineConfig {
            name: "imu0".to_owned(),
            family: ImuFamily::Microstrain,
            ..line(&imu.path)
        }],
        ..anywhere()
    };
    let out = folder.path().join("scan.mcap");
    let report = run(Session::open(&config).unwrap(), &out);
    imu.thread.join().unwrap();
    let found = stream(&report, "imu0");
    assert_eq!(
        (found.decoded, report.lost),
        (SAMPLES.into(), 0),
        "{report:?}"
    );
    let recording = Recording::open(&out).unwrap();
    for (sample, n) in recording.imu().unwrap().map(Result::unwrap).zip(0_u32..) {
        assert_eq!(sample.sample.angular_velocity_rad_s[2], f64::from(n));
        assert_eq!(sample.device_ticks, u64::from(n) * IMU_PERIOD_NS as u64);
    }
    let kinds: Vec<u16> = recording
        .packets("imu0")
        .unwrap()
        .map(|p| p.unwrap().kind)
        .collect();
    assert!(!kinds.is_empty() && kinds.iter().all(|kind| *kind == 1));
}

#[test]
fn a_stop_closes_the_file_within_200_ms() {
    // A busy machine may delay any one attempt.
    let attempts: Vec<Duration> = (0..3)
        .map(|_| stopped_session())
        .take_while(|took| took.as_millis() >= 200)
        .collect();
    assert!(attempts.len() < 3, "{attempts:?}");
}

/// Runs a session of every kind of device, stops it, checks what was recorded, and tells how long closing took.
fn stopped_session() -> Duration {
    let folder = tempfile::tempdir().unwrap();
    let front = folder.path().join("front");
    let unit_thread = mock::stereo_unit(&front, 0, None, Farewell::Sudden);
    let imu = mock::imu(None, &[]);
    let config = DevicesConfig {
        lidars: vec![LidarNetConfig {
            data: LOOPBACK,
            position: LOOPBACK,
            ..LidarNetConfig::default()
        }],
        cameras: vec![unit(&front, ["cam0", "cam1"])],
        imus: vec![line(&imu.path)],
        sidecar: Some(mock::sidecar(folder.path())),
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let lidar = mock::send_lidar(
        &session.lidar_addresses(),
        &session.counts(),
        1_000_000,
        Duration::from_micros(663),
    );
    let out = folder.path().join("scan.mcap");
    let stop = AtomicBool::new(false);
    let counts = session.counts();
    let (report, took) = std::thread::scope(|scope| {
        let running = std::thread::Builder::new()
            .name("session".to_owned())
            .spawn_scoped(scope, || session.run(&out, &until(&stop)).unwrap())
            .unwrap();
        live::wait_until("every device is at work", || {
            let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
            count(&counts.lidar_packets) > 900
                && count(&counts.imu_samples) > 80
                && count(&counts.images) > 4
        });
        stop.store(true, Ordering::Release);
        let asked = Instant::now();
        let report = running.join().unwrap();
        (report, asked.elapsed())
    });
    let recording = Recording::open(&out).unwrap();
    assert!(recording.damage().is_empty());
    assert_eq!(
        recording.images("cam1").unwrap().count() as u64,
        stream(&report, "cam0+cam1").decoded / 2
    );
    assert_eq!(
        recording.imu().unwrap().count() as u64,
        stream(&report, "imu0").decoded
    );
    assert!(recording.scans().unwrap().count() > 3);
    assert!(stream(&report, "imu0").decoded > 50, "{report:?}");
    // The glasses never came; that is no device of this rig gone wrong, but it is named.
    assert!(
        matches!(&stream(&report, "sidecar").ending, Ending::Lost(why) if why.contains("sidecar"))
    );
    drop((lidar, unit_thread, imu));
    took
}

#[test]
fn devices_that_go_away_send_garbage_or_nothing_are_named_and_the_rest_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let (front, rear) = (folder.path().join("front"), folder.path().join("rear"));
    let units = [
        mock::stereo_unit(&front, 0, Some(4), Farewell::Sudden),
        mock::stereo_unit(&rear, 0, Some(30), Farewell::Orderly),
    ];
    // A preamble that leads nowhere, and then some.
    let imu = mock::imu(Some(1_000), &[0xFA, 0xFF, 0x36, 0x04, 1, 2, 3, 4, 5]);
    let config = DevicesConfig {
        overflow: Overflow::Wait,
        lidars: vec![LidarNetConfig {
            data: LOOPBACK,
            position: LOOPBACK,
            ..LidarNetConfig::default()
        }],
        cameras: vec![
            unit(&front, ["cam0", "cam1"]),
            unit(&rear, ["cam2", "cam3"]),
        ],
        imus: vec![line(&imu.path)],
        ..anywhere()
    };
    let out = folder.path().join("scan.mcap");
    let report = run(Session::open(&config).unwrap(), &out);
    units.into_iter().for_each(|unit| unit.join().unwrap());
    imu.thread.join().unwrap();

    assert!(
        matches!(&stream(&report, "cam0+cam1").ending, Ending::Lost(why) if why.contains("front")),
        "{report:?}"
    );
    assert_eq!(stream(&report, "cam2+cam3").ending, Ending::EndOfStream);
    assert_eq!(stream(&report, "cam2+cam3").decoded, 60);
    assert_eq!(
        (report.groups.complete, report.groups.incomplete),
        (4, 26),
        "{report:?}"
    );
    let imu = stream(&report, "imu0");
    assert_eq!((imu.decoded, imu.missing), (1_000, 0));
    assert_eq!(imu.bad, 10, "{imu:?}");
    // The LiDAR's cable was never plugged in.
    assert!(
        matches!(&stream(&report, "lidar").ending, Ending::Lost(why) if why.contains("sent nothing"))
    );
    assert!(report.lost >= 3);
    let recording = Recording::open(&out).unwrap();
    assert_eq!(recording.images("cam3").unwrap().count(), 30);
    assert_eq!(recording.imu().unwrap().count(), 1_000);
}

/// Two LiDARs and two IMUs have topics of their own, and nobody else's packets come into a cloud.
#[test]
fn lidars_and_imus_are_recorded_by_name_and_strangers_kept_out() {
    let folder = tempfile::tempdir().unwrap();
    let imus = [mock::imu(Some(600), &[]), mock::imu(Some(300), &[])];
    let lidar = |name: &str| LidarNetConfig {
        name: name.to_owned(),
        data: LOOPBACK,
        position: LOOPBACK,
        ..LidarNetConfig::default()
    };
    let config = DevicesConfig {
        overflow: Overflow::Wait,
        lidars: vec![lidar("lidar"), lidar("lidar_rear")],
        imus: vec![
            line(&imus[0].path),
            ImuLineConfig {
                name: "imu1".to_owned(),
                ..line(&imus[1].path)
            },
        ],
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let addresses = session.lidar_addresses();
    let sensor = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let stranger = std::net::UdpSocket::bind("127.0.0.2:0").unwrap();
    for n in 0..300 {
        sensor
            .send_to(&mock::lidar_packet(n), addresses[0])
            .unwrap();
        // The same model, a third of a turn apart.
        stranger
            .send_to(&mock::lidar_packet(n + 50), addresses[0])
            .unwrap();
        stranger
            .send_to(&mock::lidar_packet(n + 20), addresses[2])
            .unwrap();
    }
    let out = folder.path().join("scan.mcap");
    let report = run(session, &out);
    imus.into_iter().for_each(|imu| imu.thread.join().unwrap());
    let notes = stream(&report, "lidar").notes.join("\n");
    assert!(
        notes.contains("VLP-32C at 127.0.0.1, returns: strongest"),
        "{notes}"
    );
    assert!(
        notes.contains("300 packets of 127.0.0.2 were kept out: another LiDAR"),
        "{notes}"
    );
    // Nobody chose which of the two counts.
    let lidar = stream(&report, "lidar");
    assert_eq!((lidar.kept_out, lidar.lost()), (300, 300), "{report:?}");
    let notes = stream(&report, "lidar_rear").notes.join("\n");
    assert!(
        notes.contains("VLP-32C at 127.0.0.2") && !notes.contains("kept out"),
        "{notes}"
    );
    assert_eq!(stream(&report, "imu1").decoded, 300);
    let recording = Recording::open(&out).unwrap();
    for (name, first) in [("lidar", 0), ("lidar_rear", 20)] {
        let packets = recording.packets(&format!("{name}/packets")).unwrap();
        let packets: Vec<_> = packets.map(|p| p.unwrap().packet.bytes).collect();
        assert_eq!(
            (packets.len(), &packets[0]),
            (300, &mock::lidar_packet(first)),
            "{name}"
        );
        assert!(recording.scans_of(name).unwrap().count() >= 2, "{name}");
    }
    assert_eq!(recording.main_lidar(), "lidar");
    assert_eq!(recording.imu().unwrap().count(), 600);
}

#[test]
fn lost_and_strange_datagrams_are_counted_and_kept() {
    let folder = tempfile::tempdir().unwrap();
    let imu = mock::imu(Some(600), &[]);
    let config = DevicesConfig {
        overflow: Overflow::Wait,
        lidars: vec![LidarNetConfig {
            data: LOOPBACK,
            position: LOOPBACK,
            ..LidarNetConfig::default()
        }],
        imus: vec![line(&imu.path)],
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let addresses = session.lidar_addresses();
    let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    socket
        .send_to(&mock::position_packet(0), addresses[1])
        .unwrap();
    for n in (0..400).filter(|n| !(100..103).contains(n)) {
        socket
            .send_to(&mock::lidar_packet(n), addresses[0])
            .unwrap();
    }
    socket.send_to(b"hello", addresses[0]).unwrap();
    let out = folder.path().join("scan.mcap");
    let report = run(session, &out);
    let lidar = stream(&report, "lidar");
    assert_eq!(
        (lidar.received, lidar.missing, lidar.bad),
        (399, 3, 1),
        "{report:?}"
    );
    assert!(
        lidar.first_bad.as_ref().unwrap().contains("5 bytes"),
        "{lidar:?}"
    );
    let recording = Recording::open(&out).unwrap();
    assert_eq!(recording.packets("lidar/packets").unwrap().count(), 397);
    let strange: Vec<_> = recording
        .packets("lidar")
        .unwrap()
        .map(Result::unwrap)
        .collect();
    assert_eq!(strange[0].packet.bytes, b"hello");
}

#[test]
fn a_recording_of_a_process_that_was_killed_opens() {
    let folder = tempfile::tempdir().unwrap();
    let imu = mock::imu(None, &[]);
    let config = DevicesConfig {
        imus: vec![line(&imu.path)],
        ..anywhere()
    };
    let session = Session::open(&config).unwrap();
    let out = folder.path().join("scan.mcap");
    let stop = AtomicBool::new(false);
    let samples = session.counts().imu_samples;
    std::thread::scope(|scope| {
        std::thread::Builder::new()
            .name("session".to_owned())
            .spawn_scoped(scope, || session.run(&out, &until(&stop)).unwrap())
            .unwrap();
        live::wait_until("samples", || samples.load(Ordering::Relaxed) > 200);
        // What has arrived is in the file after this.
        std::thread::sleep(Duration::from_secs(1));
        // What a kill leaves behind is what is in the file now.
        let torn = folder.path().join("torn.mcap");
        std::fs::copy(&out, &torn).unwrap();
        stop.store(true, Ordering::Release);
        let recording = Recording::open(&torn).unwrap();
        assert!(recording.imu().unwrap().filter(Result::is_ok).count() > 100);
    });
}

/// Issue 4: "the tap never slows capture".
#[test]
fn a_blocked_tap_loses_nothing_in_the_recording() {
    const FRAMES: u16 = 40;
    const SAMPLES: u32 = 4_000;
    let folder = tempfile::tempdir().unwrap();
    let front = folder.path().join("front");
    let camera = mock::stereo_unit(&front, 7, Some(FRAMES), Farewell::Orderly);
    let imu = mock::imu(Some(SAMPLES), &[]);
    let config = DevicesConfig {
        overflow: Overflow::Wait,
        cameras: vec![unit(&front, ["cam0", "cam1"])],
        imus: vec![line(&imu.path)],
        ..anywhere()
    };
    let mut session = Session::open(&config).unwrap();
    // Held, and never read.
    let tap = session.tap();
    let out = folder.path().join("scan.mcap");
    let report = run(session, &out);
    camera.join().unwrap();
    imu.thread.join().unwrap();
    assert!(tap.missed() > 0, "the queue was never full");
    assert_eq!(report.lost, 0, "{report:?}");
    assert_eq!(stream(&report, "imu0").decoded, u64::from(SAMPLES));
    assert_eq!(stream(&report, "cam0+cam1").decoded, 2 * u64::from(FRAMES));
    let recording = Recording::open(&out).unwrap();
    assert_eq!(recording.imu().unwrap().count(), SAMPLES as usize);
    for camera in ["cam0", "cam1"] {
        let images = recording.images(camera).unwrap();
        assert_eq!(images.count(), usize::from(FRAMES));
    }
    // What had room is still there, in order, and ends with the recording.
    let mut samples = 0;
    while let Ok(entry) = tap.next(Duration::ZERO) {
        samples += u32::from(matches!(entry, Some(Tapped::Imu { .. })));
    }
    assert!(samples > 100, "{samples}");
}

#[test]
fn remarks_go_into_the_recording_that_runs() {
    let folder = tempfile::tempdir().unwrap();
    let imu = mock::imu(Some(2_000), &[]);
    let config = DevicesConfig {
        overflow: Overflow::Wait,
        imus: vec![line(&imu.path)],
        ..anywhere()
    };
    let mut session = Session::open(&config).unwrap();
    let remarks = session.remarks();
    let time = Timestamp::from_nanos(START_NS + 5);
    let made = Remark {
        kind: "note".to_owned(),
        text: "Tür war offen".to_owned(),
        position_in_world_m: Some([1.0, 2.0, 3.0]),
    };
    remarks.put(time, time + 7, made.clone()).unwrap();
    let out = folder.path().join("scan.mcap");
    run(session, &out);
    imu.thread.join().unwrap();
    let recording = Recording::open(&out).unwrap();
    let found: Vec<_> = recording
        .messages(REMARKS)
        .unwrap()
        .map(Result::unwrap)
        .collect();
    assert_eq!(found.len(), 1);
    assert_eq!((found[0].time, found[0].arrival), (time, time + 7));
    assert_eq!(decode_remark(&found[0].bytes), Ok(made.clone()));
    let late = remarks.put(time, time, made).unwrap_err().to_string();
    assert!(late.contains("has ended"), "{late}");
}

/// A `velodyne_msgs/msg/VelodyneScan` as ROS serialises it.
fn velodyne_scan(packets: &[&Packet]) -> Vec<u8> {
    let stamp = |bytes: &mut Vec<u8>, time: Timestamp| {
        let (secs, nanos) = (time.nanos() / 1_000_000_000, time.nanos() % 1_000_000_000);
        bytes.extend((secs as u32).to_le_bytes());
        bytes.extend((nanos as u32).to_le_bytes());
    };
    let mut bytes = vec![0, 1, 0, 0];
    stamp(&mut bytes, packets[0].arrival);
    bytes.extend(9_u32.to_le_bytes());
    bytes.extend(b"velodyne\0\0\0\0");
    bytes.extend((packets.len() as u32).to_le_bytes());
    for packet in packets {
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        stamp(&mut bytes, packet.arrival);
        bytes.extend(&packet.bytes);
    }
    bytes
}

/// Issue 4: the packets of a rosbag2 MCAP and of a recording of ours go through the functions used live.
#[test]
fn packets_in_mcap_files_become_the_same_recording() {
    const PACKETS: u64 = 1_000;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut ours = Writer::create(&at("ours.mcap"), &WriterConfig::default()).unwrap();
    let mut theirs = Writer::create(&at("theirs.mcap"), &WriterConfig::default()).unwrap();
    // Recordings of ours before the packets' own type.
    let mut older = Writer::create(&at("older.mcap"), &WriterConfig::default()).unwrap();
    let arrived = |n: u64, bytes: Vec<u8>| Packet {
        arrival: Timestamp::from_nanos(START_NS + (n * 663_552) as i64 + 300_000),
        bytes,
    };
    let position = arrived(0, mock::position_packet(0));
    let time = position.arrival;
    ours.write_raw(LIDAR_POSITION, 0, 0, &position, time)
        .unwrap();
    for first in (0..PACKETS).step_by(100) {
        let packets: Vec<Packet> = (first..first + 100)
            .map(|n| arrived(n, mock::lidar_packet(n)))
            .collect();
        ours.write_lidar_packets("lidar", packets[0].arrival, &packets)
            .unwrap();
    }
    ours.finish().unwrap();
    let recording = Recording::open(&at("ours.mcap")).unwrap();
    for (topic, mcap) in [
        ("/velodyne_packets", &mut theirs),
        ("/lidar/packets", &mut older),
    ] {
        let channel = Channel {
            topic,
            schema_name: "velodyne_msgs/msg/VelodyneScan",
            schema_text: message::VELODYNE_SCAN.text,
        };
        let packets: Vec<_> = recording
            .lidar_packets()
            .unwrap()
            .map(Result::unwrap)
            .collect();
        for packets in packets.chunks(100) {
            let (first, last) = (&packets[0], &packets[packets.len() - 1]);
            let packets: Vec<_> = packets.iter().map(|p| &p.packet).collect();
            mcap.write_cdr(
                &channel,
                first.time,
                last.packet.arrival,
                &velodyne_scan(&packets),
            )
            .unwrap();
        }
    }
    older
        .write_raw(LIDAR_POSITION, 0, 0, &position, position.arrival)
        .unwrap();
    older.finish().unwrap();
    theirs.finish().unwrap();
    for (name, positions) in [("ours.mcap", 1), ("older.mcap", 1), ("theirs.mcap", 0)] {
        let out = at(&format!("again-{name}"));
        let config = ReplayConfig::default();
        let report = replay_recording(&at(name), &config, &out, &no_progress).unwrap();
        assert_eq!(report.lost, 0, "{report:?}");
        assert_eq!(stream(&report, "lidar").received, PACKETS + positions);
        let again = Recording::open(&out).unwrap();
        let packets = again.packets("lidar/packets").unwrap().map(Result::unwrap);
        assert_eq!(packets.count() as u64, PACKETS);
        for (packet, n) in again.lidar_packets().unwrap().map(Result::unwrap).zip(0..) {
            assert_eq!(
                packet.packet,
                arrived(n, mock::lidar_packet(n)),
                "{name} {n}"
            );
        }
        let scans: Vec<_> = again.scans().unwrap().map(Result::unwrap).collect();
        assert_eq!(scans.len(), 7, "{name}");
        // By its pulse, or fitted to arrivals that are 0.3 ms late.
        let late_ns = scans[0].time.nanos() - START_NS;
        let expected = if positions > 0 {
            0..56_000
        } else {
            250_000..356_000
        };
        assert!(expected.contains(&late_ns), "{name}: {late_ns}");
    }
    let empty = at("empty.mcap");
    Writer::create(&empty, &WriterConfig::default())
        .unwrap()
        .finish()
        .unwrap();
    let config = ReplayConfig::default();
    let error = replay_recording(&empty, &config, &at("x"), &no_progress);
    let message = error.unwrap_err().to_string();
    assert!(message.contains("LiDAR packets"), "{message}");
}
