//! Small sources as others write them, and hostile ones.

use std::path::Path;

use lsfb_recording::Recording;
use lsfb_types::{Progress, Stopped, no_progress};
use tempfile::TempDir;

use super::*;

const START_NS: i64 = 1_520_527_958_000_000_000;

/// An EuRoC folder: two seconds of an IMU at rest, four images, a calibration.
fn euroc() -> TempDir {
    let folder = tempfile::tempdir().expect("folder");
    let mav = folder.path().join("mav0");
    for sensor in ["imu0", "cam0/data", "state_groundtruth_estimate0"] {
        std::fs::create_dir_all(mav.join(sensor)).expect("folder");
    }
    let mut imu = "#timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z\n".to_owned();
    for n in 0..400 {
        imu += &format!("{},0.1,-0.2,0.3,0.0,0.0,9.81\n", START_NS + n * 5_000_000);
    }
    let mut images = "#timestamp [ns],filename\n".to_owned();
    for n in 0..4 {
        let stamp = START_NS + n * 500_000_000;
        images += &format!("{stamp},{stamp}.png\n");
        png(&mav.join(format!("cam0/data/{stamp}.png")), n as u8);
    }
    let camera = "%YAML:1.0\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [0.0, -1.0, 0.0, 0.1,\n  1.0, 0.0, 0.0, 0.2,\n  0.0, 0.0, 1.0, 0.3,\n  0.0, 0.0, 0.0, 1.0]\nrate_hz: 20\n\
        resolution: [4, 2]\ncamera_model: pinhole\nintrinsics: [3.5, 3.25, 1.5, 0.5]\ndistortion_model: radial-tangential\n\
        distortion_coefficients: [0.1, 0.2, 0.3, 0.4]\n";
    let noise = "%YAML:1.0\nT_BS:\n  data: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]\n\
        gyroscope_noise_density: 1.7e-04\ngyroscope_random_walk: 1.9e-05\naccelerometer_noise_density: 2.0e-03\naccelerometer_random_walk: 3.0e-03\n";
    for (name, text) in [
        ("imu0/data.csv", imu.as_str()),
        ("imu0/sensor.yaml", noise),
        ("cam0/data.csv", &images),
        ("cam0/sensor.yaml", camera),
        (
            "state_groundtruth_estimate0/data.csv",
            "#timestamp\n1,2,3\n",
        ),
        ("body.yaml", "comment: mav\n"),
    ] {
        std::fs::write(mav.join(name), text).expect("file");
    }
    folder
}

/// A grey picture of 4 × 2 pixels of one brightness.
fn png(path: &Path, grey: u8) {
    let file = std::fs::File::create(path).expect("file");
    let mut encoder = png::Encoder::new(file, 4, 2);
    encoder.set_color(png::ColorType::Grayscale);
    let mut writer = encoder.write_header().expect("PNG");
    writer.write_image_data(&[grey; 8]).expect("PNG");
}

fn imported(source: &Path) -> (ImportReport, Recording) {
    let out = source.join("walk.mcap");
    let config = ImportConfig::default();
    let report = import(source, &out, &config, &no_progress).expect("an import");
    (report, Recording::open(&out).expect("a recording"))
}

fn refused(source: &Path) -> String {
    let out = source.join("walk.mcap");
    let error = import(source, &out, &ImportConfig::default(), &no_progress);
    let error = error.expect_err("refused").to_string();
    assert!(!out.exists() && !out.with_extension("mcap.part").exists());
    error
}

fn edit(folder: &TempDir, name: &str, edit: impl FnOnce(String) -> String) {
    let path = folder.path().join(name);
    let text = std::fs::read_to_string(&path).expect("file");
    std::fs::write(path, edit(text)).expect("file");
}

fn count<'a>(report: &'a ImportReport, what: &str) -> &'a RecordCount {
    let found = report.records.iter().find(|r| r.what == what);
    found.expect("such records")
}

#[test]
fn a_euroc_folder_becomes_a_recording_with_its_rig() {
    let folder = euroc();
    let (report, recording) = imported(folder.path());
    assert_eq!((report.format, report.clock), ("euroc", ClockOf::Utc));
    assert_eq!(report.unreadable(), 0);
    let samples: Vec<_> = recording
        .imu()
        .expect("imu")
        .map(|s| s.expect("whole"))
        .collect();
    assert_eq!(samples.len(), 400);
    assert_eq!(samples[1].time.nanos(), START_NS + 5_000_000);
    assert_eq!(samples[1].arrival, samples[1].time, "no host received it");
    assert_eq!(samples[1].sample.angular_velocity_rad_s, [0.1, -0.2, 0.3]);
    assert_eq!(samples[1].sample.specific_force_m_s2, [0.0, 0.0, 9.81]);
    let images: Vec<_> = recording
        .images("cam0")
        .expect("cam0")
        .map(|i| i.expect("whole"))
        .collect();
    assert_eq!(
        images
            .iter()
            .map(|i| i.sample.pixels[0])
            .collect::<Vec<_>>(),
        [0, 1, 2, 3]
    );
    assert_eq!(images[3].time.nanos(), START_NS + 1_500_000_000);
    let rig = recording.rig().expect("a rig");
    let camera = &rig.cameras["cam0"];
    assert_eq!(camera.camera.focal_px(), [3.5, 3.25]);
    assert_eq!(
        camera.rig_from_camera.translation.as_slice(),
        [0.1, 0.2, 0.3]
    );
    let x = camera.rig_from_camera.rotation * lsfb_geometry::Vector3::x();
    assert!((x.y - 1.0).abs() < 1e-12, "{x}");
    assert_eq!(rig.imus["imu0"].noise.accel_bias_walk, 3.0e-3);
    // The truth stays beside it, and what nobody used is named.
    let left: Vec<&str> = report.left_out.iter().map(|l| l.what.as_str()).collect();
    assert_eq!(
        left,
        ["records of state_groundtruth_estimate0", "mav0/*.yaml"]
    );
    let said = recording.metadata("lsfb.import").expect("metadata");
    assert_eq!(
        (said["clock"].as_str(), said["records"].as_str()),
        ("utc", "404")
    );
}

#[test]
fn the_same_source_gives_the_same_bytes() {
    let folder = euroc();
    let bytes = [0, 1].map(|_| {
        imported(folder.path());
        let path = folder.path().join("walk.mcap");
        let bytes = std::fs::read(&path).expect("a recording");
        std::fs::remove_file(path).expect("removed");
        bytes
    });
    assert!(bytes[0] == bytes[1]);
}

/// Each line is damaged in one way; what came of it is counted, and the rest is there.
#[test]
fn damaged_lines_are_counted_and_never_imported() {
    let stamp = |n: i64| START_NS + n * 5_000_000;
    type Change = Box<dyn Fn(String) -> String>;
    let cases: [(&str, Change, [u64; 4], &str); 8] = [
        (
            "cut",
            Box::new(|t| t[..t.len() - 12].to_owned()),
            [400, 399, 1, 0],
            "columns instead of 7",
        ),
        (
            "NaN",
            Box::new(move |t| {
                t.replacen(
                    &format!("{},0.1", stamp(7)),
                    &format!("{},nan", stamp(7)),
                    1,
                )
            }),
            [400, 399, 1, 0],
            "`nan` in column 2 is not a number",
        ),
        (
            "two in one",
            Box::new(move |t| {
                t.replacen(
                    &format!("9.81\n{}", stamp(9)),
                    &format!("9.{}", stamp(9)),
                    1,
                )
            }),
            [399, 398, 1, 0],
            "13 columns",
        ),
        (
            "repeated",
            Box::new(move |t| format!("{t}{},0.1,-0.2,0.3,0.0,0.0,9.81\n", stamp(3))),
            [401, 400, 0, 1],
            "",
        ),
        (
            "contradiction",
            Box::new(move |t| format!("{t}{},0.9,-0.2,0.3,0.0,0.0,9.81\n", stamp(3))),
            [401, 400, 1, 0],
            "two different records",
        ),
        (
            "no stamp",
            Box::new(|t| format!("{t}x,0.1,-0.2,0.3,0.0,0.0,9.81\n")),
            [401, 400, 1, 0],
            "`x` is not a stamp in ns",
        ),
        (
            "another year",
            Box::new(|t| format!("{t}1720527958000000000,0.1,-0.2,0.3,0.0,0.0,9.81\n")),
            [401, 400, 1, 0],
            "days from the others",
        ),
        (
            "far future",
            Box::new(|t| format!("{t}9220527958000000000,0.1,-0.2,0.3,0.0,0.0,9.81\n")),
            [401, 400, 1, 0],
            "after 2038",
        ),
    ];
    for (case, damage, [read, written, unreadable, repeated], why) in cases {
        let folder = euroc();
        edit(&folder, "mav0/imu0/data.csv", damage);
        let (report, recording) = imported(folder.path());
        let imu = count(&report, "imu0/data.csv");
        let found = [imu.read, imu.written, imu.unreadable, imu.repeated];
        assert_eq!(
            found,
            [read, written, unreadable, repeated],
            "{case}: {imu:?}"
        );
        let problem = imu.first_problem.as_deref().unwrap_or_default();
        assert!(problem.contains(why), "{case}: {problem}");
        assert_eq!(
            recording.imu().expect("imu").count() as u64,
            written,
            "{case}"
        );
        let said = recording.metadata("lsfb.import").expect("metadata");
        assert_eq!(said["unreadable"], unreadable.to_string(), "{case}");
    }
}

#[test]
fn a_last_line_without_end_is_told() {
    let folder = euroc();
    // Cut within its last number, it looks like a whole line.
    edit(&folder, "mav0/imu0/data.csv", |t| {
        t[..t.len() - 2].to_owned()
    });
    let (report, _) = imported(folder.path());
    assert!(
        report
            .notes
            .iter()
            .any(|n| n.contains("may have been truncated")),
        "{:?}",
        report.notes
    );
}

#[test]
fn what_is_out_of_order_is_put_in_order_and_told() {
    let folder = euroc();
    edit(&folder, "mav0/imu0/data.csv", |text| {
        let mut lines: Vec<&str> = text.lines().collect();
        lines[1..].reverse();
        lines.join("\n") + "\n"
    });
    let (report, recording) = imported(folder.path());
    assert_eq!(count(&report, "imu0/data.csv").reordered, 399);
    let times: Vec<_> = recording
        .imu()
        .expect("imu")
        .map(|s| s.expect("whole").time)
        .collect();
    assert!(times.is_sorted() && times.len() == 400);
}

#[test]
fn times_that_a_clock_told_twice_are_left_out_and_counted() {
    let folder = euroc();
    // Samples 5 ms apart; from the 300th on the clock is 500 ms behind.
    edit(&folder, "mav0/imu0/data.csv", |text| {
        let mut lines = text.lines();
        let head = lines.next().expect("a head").to_owned();
        let late = lines.enumerate().map(|(n, line)| {
            let (stamp, rest) = line.split_once(',').expect("cells");
            let stamp: i64 = stamp.parse().expect("a stamp");
            let back = if n < 300 { 0 } else { 501_000_000 };
            format!("\n{},{rest}", stamp - back)
        });
        head + &late.collect::<String>() + "\n"
    });
    let (report, recording) = imported(folder.path());
    let imu = count(&report, "imu0/data.csv");
    // From 1000 to 1495 ms before it was set, from 999 to 1494 ms behind: all but the last of those.
    assert_eq!((imu.read, imu.written, imu.unreadable), (400, 201, 199));
    let problem = imu.first_problem.as_deref().expect("said");
    assert!(problem.contains("the clock was set"), "{problem}");
    assert_eq!(recording.imu().expect("imu").count(), 201);
}

#[test]
fn trajectories_are_not_replaced_and_lose_no_pose() {
    let folder = tempfile::tempdir().expect("a folder");
    let sensors = folder.path().join("sensors");
    std::fs::create_dir_all(sensors.join("records_data")).expect("a folder");
    for (name, text) in [
        (
            "sensors.txt",
            "# kapture format: 1.1\nc, , camera, SIMPLE_PINHOLE, 4, 2, 3.5, 2.0, 1.0\n",
        ),
        ("records_camera.txt", "1, c, a.png\n"),
        (
            "trajectories.txt",
            "1, c, 1, 0, 0, 0, 0, 0, 0\n2, c, 1, 0, 0, 0, 1, 0, 0\n",
        ),
    ] {
        std::fs::write(sensors.join(name), text).expect("file");
    }
    png(&sensors.join("records_data/a.png"), 1);
    let out = folder.path().join("walk.mcap");
    let run = |replace_trajectories| {
        let config = ImportConfig {
            stamp_unit: Some(StampUnit::Seconds),
            replace_trajectories,
            ..ImportConfig::default()
        };
        import(folder.path(), &out, &config, &no_progress)
    };
    let report = run(false).expect("an import");
    let [tum] = report.trajectories.as_slice() else {
        panic!("{:?}", report.trajectories);
    };
    std::fs::write(tum, "somebody's\n").expect("file");
    let error = run(false).expect_err("refused").to_string();
    assert!(error.contains("exists already"), "{error}");
    assert_eq!(std::fs::read_to_string(tum).expect("file"), "somebody's\n");
    run(true).expect("replaced");
    assert!(std::fs::read_to_string(tum).expect("file").lines().count() >= 2);

    // Two sensors whose names become one, at one time.
    let both = "1, c/0, 1, 0, 0, 0, 0, 0, 0\n1, c_0, 1, 0, 0, 0, 5, 0, 0\n";
    std::fs::write(sensors.join("trajectories.txt"), both).expect("file");
    let error = run(true).expect_err("refused").to_string();
    assert!(error.contains("1 of 2 poses"), "{error}");
}

/// Naively offsets counted from the stamp, which is that of the last point: every point a turn late. And a clock of the sensor's own.
#[test]
fn clouds_begin_where_the_times_of_their_points_do() {
    let folder = tempfile::tempdir().expect("a folder");
    let sensors = folder.path().join("sensors");
    let data = sensors.join("records_data");
    std::fs::create_dir_all(&data).expect("a folder");
    let mut list = String::new();
    for (second, first) in [(1, -0.1), (2, -0.1), (3, 302_400.0)] {
        let name = format!("{second}.pcd");
        let last = first + 0.1;
        let text = format!(
            "VERSION 0.7\nFIELDS x y z time\nSIZE 4 4 4 8\nTYPE F F F F\nPOINTS 2\nDATA ascii\n1 1 2 {first}\n1 2 2 {last}\n"
        );
        std::fs::write(data.join(&name), text).expect("cloud");
        list += &format!("{second}, lidar, {name}\n");
    }
    let listed = "# kapture format: 1.1\nlidar, , lidar\n";
    std::fs::write(sensors.join("sensors.txt"), listed).expect("file");
    std::fs::write(sensors.join("records_lidar.txt"), list).expect("file");
    let out = folder.path().join("walk.mcap");
    let config = ImportConfig {
        stamp_unit: Some(StampUnit::Seconds),
        ..ImportConfig::default()
    };
    let report = import(folder.path(), &out, &config, &no_progress).expect("an import");
    let recording = Recording::open(&out).expect("a recording");
    let scans = recording.scans_of("lidar").expect("scans");
    let found: Vec<(i64, u32)> = scans
        .map(|scan| {
            let scan = scan.expect("a scan");
            (scan.time.nanos(), scan.sample.points[1].time_offset_ns)
        })
        .collect();
    for ((time_ns, last_ns), expected) in
        found
            .into_iter()
            .zip([900_000_000_i64, 1_900_000_000, 3_000_000_000])
    {
        assert!(time_ns.abs_diff(expected) < 300, "{time_ns}");
        assert!(last_ns.abs_diff(100_000_000) < 300, "{last_ns}");
    }
    let said = report.notes.join("; ");
    assert!(
        said.contains("the points of 1 scans have times of another clock"),
        "{said}"
    );
}

#[test]
fn stamps_in_another_unit_are_refused() {
    for (case, unit) in [("microseconds", 1_000), ("milliseconds", 1_000_000)] {
        let folder = euroc();
        edit(&folder, "mav0/imu0/data.csv", |text| {
            let line = |n: i64| {
                format!(
                    "{},0.1,-0.2,0.3,0.0,0.0,9.81\n",
                    (START_NS + n * 5_000_000) / unit
                )
            };
            let head = text.lines().next().expect("a head").to_owned() + "\n";
            head + &(0..400).map(line).collect::<String>()
        });
        let error = refused(folder.path());
        assert!(error.contains("in another unit"), "{case}: {error}");
    }
    // Seconds have decimals, which nanoseconds have not: not one line is a record.
    let folder = euroc();
    edit(&folder, "mav0/imu0/data.csv", |text| {
        text.replace("1520527958", "1520527958.")
            .replace("1520527959", "1520527959.")
    });
    let (report, _) = imported(folder.path());
    let imu = count(&report, "imu0/data.csv");
    assert_eq!((imu.written, imu.unreadable), (0, 400), "{imu:?}");
}

/// What no device measures is in another unit; what never meets was stamped by another clock.
#[test]
fn units_and_clocks_that_cannot_be_are_refused() {
    let numbers = |from: usize, to: usize, value: &'static str| {
        move |text: String| -> String {
            let changed = text.lines().map(|line| {
                let mut fields: Vec<&str> = line.split(',').collect();
                if !line.starts_with('#') {
                    fields[from..to].fill(value);
                }
                fields.join(",") + "\n"
            });
            changed.collect()
        }
    };
    let later = |text: String| text.replace("152052795", "152053155");
    type Change = Box<dyn FnOnce(String) -> String>;
    let cases: [(&str, Change, &str); 4] = [
        (
            "imu0",
            Box::new(numbers(6, 7, "1.0")),
            "median specific force is 1.000",
        ),
        (
            "imu0",
            Box::new(numbers(1, 4, "20.0")),
            "angular rates above 34.6 rad/s",
        ),
        // An hour.
        ("imu0", Box::new(later), "different clocks"),
        ("cam0", Box::new(later), "different clocks"),
    ];
    for (sensor, change, why) in cases {
        let folder = euroc();
        edit(&folder, &format!("mav0/{sensor}/data.csv"), change);
        let error = refused(folder.path());
        assert!(error.contains(why), "{sensor}: {error}");
    }
}

/// An accelerometer in m/s² where the app has g, a magnetometer in tesla where it has microtesla, a place on no globe.
#[test]
fn numbers_of_other_units_in_ios_logger_are_refused() {
    let texts = |accel: &str, field: &str, latitude: &str| {
        let folder = tempfile::tempdir().expect("folder");
        for (name, row) in [("Accel.txt", accel), ("Magnet.txt", field)] {
            let rows = (0..100).map(|n| format!("{}.{n:03},{row}\n", 1_627_530_745));
            std::fs::write(folder.path().join(name), rows.collect::<String>()).expect("file");
        }
        let gps = format!("1627530745.0,{latitude},6.6,5,400,4,0,0,0\n");
        std::fs::write(folder.path().join("GPS.txt"), gps).expect("file");
        folder
    };
    let (report, _) = imported(texts("0,0,-1", "20,5,-40", "46.5").path());
    assert_eq!(report.unreadable(), 0);
    assert!(report.notes.iter().any(|n| n == "it has no Gyro.txt"));
    let error = refused(texts("0,0,-9.8", "20,5,-40", "46.5").path());
    assert!(error.contains("median specific force is 96"), "{error}");
    let error = refused(texts("0,0,-1", "2e-5,5e-6,-4e-5", "46.5").path());
    assert!(error.contains("4.50e-11 T"), "{error}");
    let (report, _) = imported(texts("0,0,-1", "20,5,-40", "465").path());
    assert_eq!(count(&report, "GPS.txt").unreadable, 1);
    let folder = texts("0,0,-1", "20,5,-40", "46.5");
    edit(&folder, "GPS.txt", |text| {
        text.replace("1627530745", "1627537945")
    });
    let (report, _) = imported(folder.path());
    let behind = "GPS.txt: all of it is 7200 s after the last of the others";
    assert!(
        report.notes.iter().any(|n| n == behind),
        "{:?}",
        report.notes
    );
}

/// What was cut off, emptied or copied twice is told.
#[test]
fn streams_that_end_early_are_empty_or_doubled_are_told() {
    let folder = euroc();
    edit(&folder, "mav0/cam0/data.csv", |text| {
        text.replace("1520527959500000000,", "1520527969500000000,")
    });
    let (report, _) = imported(folder.path());
    let said = |report: &ImportReport, what: &str| report.notes.iter().any(|n| n.contains(what));
    assert!(
        said(&report, "imu0/data.csv: ends 9.5 s before"),
        "{:?}",
        report.notes
    );
    let folder = euroc();
    edit(&folder, "mav0/imu0/data.csv", |_| "#timestamp\n".to_owned());
    let (report, _) = imported(folder.path());
    assert!(
        said(&report, "imu0/data.csv: it has no records"),
        "{:?}",
        report.notes
    );

    let folder = tempfile::tempdir().expect("folder");
    let mut walk = "\u{feff}#\tstartTime:1574560118905\n".to_owned();
    for n in 0..3 {
        for (name, mhz) in [("a", "2412"), ("b", "5180000")] {
            let ms = 1_574_560_118_905_i64 + 2_000 * n;
            walk += &format!(
                "{ms}\tTYPE_WIFI\t{name}\t0a:1b:2c:3d:4e:5f\t-50\t{mhz}\t{}\n",
                ms - 9
            );
        }
    }
    let lines = walk.clone() + &walk;
    let positive = walk.replace("\t-50\t", "\t50\t");
    let path = folder.path().join("walk.txt");
    let import = |text: &str| {
        std::fs::write(&path, text).expect("file");
        let out = folder.path().join("walk.mcap");
        import(&path, &out, &ImportConfig::default(), &no_progress)
    };
    let report = import(&lines).expect("an import");
    let wifi = count(&report, "TYPE_WIFI");
    assert_eq!((wifi.read, wifi.written, wifi.repeated), (12, 6, 6));
    assert_eq!(count(&report, "scans of TYPE_WIFI").written, 3);
    let recording = Recording::open(&folder.path().join("walk.mcap")).expect("a recording");
    let mut mhz: Vec<u32> = recording
        .wifi(None)
        .expect("wifi")
        .map(|w| w.expect("whole").sample.frequency_mhz)
        .collect();
    mhz.sort_unstable();
    assert_eq!(mhz, [2412, 2412, 2412, 5180, 5180, 5180]);
    let error = import(&positive).expect_err("refused").to_string();
    assert!(
        error.contains("50 dBm is not a plausible received power"),
        "{error}"
    );
}

#[test]
fn records_of_clocks_that_have_nothing_to_do_with_each_other_are_refused() {
    let folder = euroc();
    edit(&folder, "mav0/cam0/data.csv", |text| {
        text.lines()
            .map(|l| l.replacen("1520527", "1420527", 1) + "\n")
            .collect()
    });
    let error = refused(folder.path());
    assert!(error.contains("different clocks"), "{error}");
}

#[test]
fn images_that_are_not_there_or_of_another_size_are_counted() {
    let folder = euroc();
    let data = folder.path().join("mav0/cam0/data");
    std::fs::remove_file(data.join(format!("{START_NS}.png"))).expect("removed");
    edit(&folder, "mav0/cam0/data.csv", |text| {
        text + "1520527959700000000,../../../secret.png\n"
    });
    let (report, recording) = imported(folder.path());
    let images = count(&report, "cam0/data.csv");
    assert_eq!((images.read, images.written, images.unreadable), (5, 3, 2));
    assert_eq!(recording.images("cam0").expect("cam0").count(), 3);
    let folder = euroc();
    edit(&folder, "mav0/cam0/sensor.yaml", |text| {
        text.replace("[4, 2]", "[752, 480]")
    });
    let (report, _) = imported(folder.path());
    let images = count(&report, "cam0/data.csv");
    assert_eq!((images.written, images.unreadable), (0, 4));
    let problem = images.first_problem.as_deref().unwrap_or_default();
    assert!(problem.contains("calibrated for 752 × 480"), "{problem}");
}

#[test]
fn a_calibration_that_cannot_be_true_is_refused() {
    for (from, to, why) in [
        (
            "data: [0.0, -1.0",
            "data: [0.0, -2.0",
            "not a rigid transform",
        ),
        (
            "camera_model: pinhole",
            "camera_model: omni",
            "is not supported",
        ),
        ("resolution", "size", "no resolution"),
    ] {
        let folder = euroc();
        edit(&folder, "mav0/cam0/sensor.yaml", |text| {
            text.replace(from, to)
        });
        let error = refused(folder.path());
        assert!(
            error.contains(why) && error.contains("sensor.yaml"),
            "{error}"
        );
    }
}

#[test]
fn sources_of_no_known_program_are_told_apart() {
    let folder = tempfile::tempdir().expect("folder");
    let error = refused(folder.path());
    assert!(error.contains("not a supported recording"), "{error}");
    let missing = import(
        Path::new("nowhere"),
        Path::new("x.mcap"),
        &ImportConfig::default(),
        &no_progress,
    );
    assert!(
        missing
            .expect_err("nothing")
            .to_string()
            .contains("nowhere")
    );
    std::fs::write(folder.path().join("gyro_accel.csv"), "").expect("file");
    std::fs::write(folder.path().join("data.jsonl"), "").expect("file");
    let error = refused(folder.path());
    assert!(
        error.contains("mars-logger, spectacular-rec: choose one with --format"),
        "{error}"
    );
    std::fs::remove_file(folder.path().join("data.jsonl")).expect("removed");
    assert!(refused(folder.path()).contains("it has no records"));
}

#[test]
fn stamps_without_a_unit_are_asked_for() {
    let folder = tempfile::tempdir().expect("folder");
    let sensors = folder.path().join("sensors");
    std::fs::create_dir_all(sensors.join("records_data")).expect("folder");
    std::fs::write(
        sensors.join("sensors.txt"),
        "# kapture format: 1.1\nc, , camera, SIMPLE_PINHOLE, 4, 2, 3.5, 2.0, 1.0\n",
    )
    .expect("file");
    std::fs::write(
        sensors.join("records_camera.txt"),
        "1, c, a.png\n2, c, b.png\n",
    )
    .expect("file");
    for (n, name) in ["a.png", "b.png"].iter().enumerate() {
        png(&sensors.join("records_data").join(name), n as u8);
    }
    let error = refused(folder.path());
    assert!(error.contains("--stamp-unit"), "{error}");
    let config = ImportConfig {
        stamp_unit: Some(StampUnit::Seconds),
        ..ImportConfig::default()
    };
    let out = folder.path().join("walk.mcap");
    let report = import(folder.path(), &out, &config, &no_progress).expect("an import");
    assert_eq!((report.clock, report.unreadable()), (ClockOf::Device, 0));
    let recording = Recording::open(&out).expect("a recording");
    let times: Vec<_> = recording
        .images("c")
        .expect("c")
        .map(|i| i.expect("one").time.nanos())
        .collect();
    assert_eq!(times, [1_000_000_000, 2_000_000_000]);
}

#[test]
fn told_to_stop_it_leaves_nothing_behind() {
    let folder = euroc();
    let out = folder.path().join("walk.mcap");
    for stage in ["reading records", "writing records"] {
        let stop = |p: Progress| match p.stage == stage {
            true => Err(Stopped),
            false => Ok(()),
        };
        let error = import(folder.path(), &out, &ImportConfig::default(), &stop);
        assert!(matches!(error, Err(Error::Stopped(_))), "{stage}");
        assert!(
            !out.exists() && !out.with_extension("mcap.part").exists(),
            "{stage}"
        );
    }
}
