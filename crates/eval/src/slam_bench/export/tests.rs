use super::*;
use lsfb_recording::{Writer, WriterConfig};
use lsfb_types::{ImuSample, LidarPoint, LidarScan, Stamped};

fn stamped<T>(millis: i64, sample: T) -> Stamped<T> {
    let time = Timestamp::from_nanos(1_700_000_000_000_000_000 + millis * 1_000_000);
    Stamped {
        time,
        arrival: time,
        device_ticks: 0,
        sample,
    }
}

/// Two cameras of which one lost an image, an IMU and a LiDAR.
fn recording(folder: &Path) -> Recording {
    let path = folder.join("walk.mcap");
    let mut writer = Writer::create(&path, &WriterConfig::default()).expect("file");
    for i in 0..4 {
        for (camera, grey) in [("cam0", 10), ("cam1", 20)] {
            let image = Image {
                width: 4,
                height: 2,
                pixels: vec![grey + i as u8; 8],
                exposure_ns: 5_000_000,
                frame_id: i as u32,
            };
            if (camera, i) != ("cam1", 2) {
                writer
                    .write_image(camera, &stamped(50 * i, image))
                    .expect("image");
            }
        }
        let sample = ImuSample {
            angular_velocity_rad_s: [0.1, 0.2, 0.3],
            specific_force_m_s2: [0.0, 0.0, 9.81],
        };
        writer
            .write_imu("imu0", &stamped(5 * i, sample))
            .expect("sample");
        let point = LidarPoint {
            position_m: [1.0, 2.0, 3.0],
            intensity: 255,
            ..LidarPoint::default()
        };
        let scan = LidarScan {
            points: vec![point; 3],
        };
        writer
            .write_scan("lidar", &stamped(100 * i, scan))
            .expect("scan");
    }
    writer.finish().expect("finished");
    Recording::open(&path).expect("opens")
}

fn read(folder: &Path, name: &str) -> String {
    fs::read_to_string(folder.join(name)).expect(name)
}

#[test]
fn every_layout_has_what_its_readers_look_for() {
    let folder = tempfile::tempdir().expect("folder");
    let recording = recording(folder.path());
    let written = |layout: Layout| {
        let out = folder.path().join(layout.name());
        export(&recording, layout, &out).expect("written");
        assert!(!out.with_extension("part").exists());
        out
    };
    let euroc = written(Layout::TumVi);
    let list = read(&euroc, "mav0/cam1/data.csv");
    assert_eq!(list.lines().count(), 4, "{list}");
    assert!(list.contains("1700000000150000000,1700000000150000000.png"));
    assert!(
        read(&euroc, "mav0/imu0/data.csv").contains("1700000000005000000,0.1,0.2,0.3,0,0,9.81")
    );
    assert!(
        read(&euroc, "dso/cam0/times.txt").contains("1700000000000000000 1700000000.000000000 5")
    );
    let pixels = fs::read(euroc.join("mav0/cam0/data/1700000000050000000.png")).expect("image");
    let mut reader = png::Decoder::new(io::Cursor::new(pixels))
        .read_info()
        .expect("PNG");
    let mut grey = vec![0; 8];
    reader.next_frame(&mut grey).expect("pixels");
    assert_eq!(grey, [11; 8]);
    let kitti = written(Layout::Kitti);
    // Row 2 of the one camera is row 2 of the other: what only one saw is left out.
    assert_eq!(
        read(&kitti, "times.txt"),
        "0.000000000\n0.050000000\n0.150000000\n"
    );
    assert!(
        kitti.join("image_1/000002.png").exists() && !kitti.join("image_0/000003.png").exists()
    );
    assert_eq!(
        fs::read(kitti.join("velodyne/000003.bin"))
            .expect("scan")
            .len(),
        48
    );
    assert_eq!(
        read(&kitti, "velodyne_stamps.txt").lines().nth(1),
        Some("1700000000.100000000")
    );
    let images = written(Layout::Images);
    assert_eq!(read(&images, "cam1/times.txt").lines().count(), 3);
}
