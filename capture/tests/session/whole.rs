//! Sessions in which every device does what it should.

use super::*;

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
        lidars: vec![lidar()],
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

/// Any number of cameras in any number of units.
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
