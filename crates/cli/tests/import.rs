//! `lsfb import`: recordings of other programs, real ones (`LSFB_TEST_DATA`) and small ones made here.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::answer::json;
use crate::process::lsfb;
use lsfb_recording::{Recording, message};
use lsfb_tests::{foreign_python, recordings};
use serde_json::Value;

/// What an independent script counts in the recordings of others: `python3 crates/cli/tests/import/counts.py ../shared/data`.
const COUNTS: &str = include_str!("import/counts.txt");

/// Kinds of records of a source and how many there are.
fn counted(source: &str) -> BTreeMap<&'static str, u64> {
    let lines = COUNTS
        .lines()
        .filter_map(|line| line.strip_prefix(source)?.strip_prefix('\t'));
    lines
        .map(|line| {
            let (kind, count) = line.split_once('\t').expect("two columns");
            (kind, count.parse().expect("a number"))
        })
        .collect()
}

/// Records of a kind in a report: those read, written and unreadable; what was left out was neither.
fn found(report: &Value, kind: &str) -> [u64; 3] {
    let records = report["records"].as_array().expect("records");
    let own = records.iter().filter(|r| {
        let what = r["what"].as_str().unwrap_or_default();
        what == kind || what.ends_with(&format!(" in {kind}")) && !what.starts_with("bias")
    });
    let own = own.filter(|r| r["derived"] == false);
    let mut sums = [0; 3];
    for record in own {
        for (sum, name) in sums.iter_mut().zip(["read", "written", "unreadable"]) {
            *sum += record[name].as_u64().expect("a number");
        }
    }
    sums
}

fn left_out(report: &Value, what: &str) -> u64 {
    let list = report["left_out"].as_array().expect("a list");
    let own = list
        .iter()
        .find(|l| l["what"].as_str().is_some_and(|w| w.contains(what)));
    own.and_then(|l| l["records"].as_u64()).unwrap_or(0)
}

fn import(folder: &Path, source: &Path, more: &[&str], code: i32) -> Value {
    let source = source.to_str().expect("UTF-8");
    let arguments = [&["import", source, "--out", "walk.mcap"], more].concat();
    json(folder, &arguments, code)
}

#[test]
fn all_walks_of_a_mall_come_over_whole() {
    let test = "all_walks_of_a_mall_come_over_whole";
    let below = "vision/indoorloc20/site1/F1/path_data_files";
    let Some(walks) = recordings(test, below) else {
        return;
    };
    let mut sources: Vec<PathBuf> = std::fs::read_dir(walks)
        .expect("walks")
        .map(|entry| entry.expect("a file").path())
        .collect();
    sources.sort();
    assert_eq!(sources.len(), 24);
    for source in &sources {
        let name = source.file_name().expect("a name").to_string_lossy();
        let folder = tempfile::tempdir().expect("folder");
        let report = import(folder.path(), source, &["--device", "oppo"], 0);
        assert_eq!(
            (&report["format"], &report["clock"]),
            (&"indoor-location".into(), &"utc".into())
        );
        let counts = counted(&format!("{below}/{name}"));
        assert!(counts.len() >= 14, "{name}: {counts:?}");
        for (kind, count) in counts {
            let imported = found(&report, kind);
            match imported[0] {
                0 => assert_eq!(left_out(&report, kind), count, "{name}: {kind}"),
                _ => assert_eq!(imported, [count, count, 0], "{name}: {kind}"),
            }
        }
    }
    // Of the last one: a reading, its scan and a waypoint as the file has them, and the whole of it read by others.
    let folder = tempfile::tempdir().expect("folder");
    let source = sources
        .iter()
        .find(|s| s.ends_with("5dd9e7c29191710006b57061.txt.gz"));
    let report = import(
        folder.path(),
        source.expect("a walk"),
        &["--device", "oppo"],
        0,
    );
    let path = folder.path().join("walk.mcap");
    let recording = Recording::open(&path).expect("recording");
    let imu = recording.imu().expect("imu").count() as u64;
    assert_eq!(imu, found(&report, "TYPE_GYROSCOPE")[0]);
    for wifi in recording.wifi(None).expect("wifi") {
        let wifi = wifi.expect("a reading");
        assert!(wifi.sample.scan > 0 && wifi.time <= wifi.arrival.plus_nanos(1_000_000_000));
    }
    let mut readings = 0;
    for scan in recording
        .messages("/sidecar/oppo/wifi_scan")
        .expect("scans")
    {
        let scan = message::decode_wifi_scan(&scan.expect("a scan").bytes).expect("a scan");
        readings += u64::from(scan.readings);
    }
    assert_eq!(readings, found(&report, "TYPE_WIFI")[0]);
    let point = recording
        .messages("/sidecar/oppo/waypoint")
        .expect("waypoints")
        .next();
    let point =
        message::decode_remark(&point.expect("one").expect("whole").bytes).expect("a remark");
    let place: Value = serde_json::from_str(&point.text).expect("JSON");
    assert!(place["x_m"].is_f64() && place["floor"] == "F1", "{place}");
    others_read(test, &path, &report);
}

/// PyPI `mcap` and `rosbags` read what the report says.
fn others_read(test: &str, path: &Path, report: &Value) {
    let Some(python) = foreign_python(test) else {
        return;
    };
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/import/open.py");
    let output = Command::new(python)
        .arg(script)
        .arg(path)
        .output()
        .expect("python");
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let theirs: BTreeMap<&str, u64> = said
        .lines()
        .filter_map(|line| line.split_once('\t'))
        .map(|(topic, count)| (topic, count.parse().expect("a number")))
        .collect();
    for record in report["records"].as_array().expect("records") {
        let topic = record["topic"].as_str().expect("a topic");
        let written = record["written"].as_u64().expect("a number");
        assert_eq!(theirs.get(topic).copied().unwrap_or(0), written, "{topic}");
    }
}

#[test]
fn real_recordings_of_others_come_over_whole() {
    let test = "real_recordings_of_others_come_over_whole";
    for (below, format, left) in [
        ("vision/tumvi_calib_imu1", "euroc", "mocap0"),
        ("vision/ios_logger_iphone", "ios-logger", "Head.txt"),
        // Its images and clouds are empty files: each is counted as unreadable.
        ("vision/kapture_samples/m1x", "kapture", ""),
        ("vision/aria/recording.vrs", "aria-vrs", "sound in 231-1"),
        // Its images are H.265.
        (
            "vision/aria/aria_gen2_unit_test_sequence_with_bluetooth.vrs",
            "aria-vrs",
            "SLAM camera in 1201-4",
        ),
    ] {
        let is_empty = |kind: &str| ["records_camera.txt", "records_lidar.txt"].contains(&kind);
        let Some(source) = recordings(test, below) else {
            return;
        };
        let folder = tempfile::tempdir().expect("folder");
        let code = if format == "kapture" { 3 } else { 0 };
        let report = import(folder.path(), &source, &[], code);
        assert_eq!(report["format"], format);
        for (kind, count) in counted(below) {
            let imported = found(&report, kind);
            match imported[0] {
                0 => assert!(
                    left_out(&report, kind.trim_end_matches("/data.csv")) == count,
                    "{below}: {kind}"
                ),
                _ if is_empty(kind) => assert_eq!(imported, [count, 0, count], "{below}: {kind}"),
                _ => assert_eq!(imported, [count, count, 0], "{below}: {kind}"),
            }
        }
        assert!(
            left.is_empty() || left_out(&report, left) > 0,
            "{below}: {report}"
        );
        others_read(test, &folder.path().join("walk.mcap"), &report);
        let doctor = lsfb(folder.path(), &["doctor", "walk.mcap", "--full", "--json"]);
        let judged: Value = serde_json::from_slice(&doctor.stdout).expect("JSON");
        let findings = judged["findings"].as_array().expect("findings");
        let said = findings.iter().map(ToString::to_string).collect::<String>();
        assert!(said.contains("no host received it"), "{below}: {said}");
        assert!(
            said.contains("records were imported")
                || said.contains("24 of 36 records could not be read"),
            "{below}: {said}"
        );
        assert!(
            !said.contains("stamps agree with this machine's clock"),
            "{below}: {said}"
        );
    }
}

/// A phone at rest: ten seconds at 100 Hz.
fn inertial_rows(header: &str, row: impl Fn(i64) -> String) -> String {
    let mut text = format!("{header}\n");
    for n in 0..1_000 {
        let _ = writeln!(text, "{}", row(n));
    }
    text
}

/// Something that stands for `ffmpeg`: so many frames of 4 × 2 pixels, each of its number.
fn fake_ffmpeg(folder: &Path, frames: usize) {
    let path = folder.join("bin/ffmpeg");
    std::fs::create_dir_all(folder.join("bin")).expect("folder");
    let script = format!(
        "#!/bin/sh\ncase \"$*\" in\n*framecrc*) n=0; while [ $n -lt {frames} ]; do echo \"0, $n, $n, 1, 100, 0x0\"; n=$((n+1)); done;;\n\
         *) n=0; while [ $n -lt {frames} ]; do printf 'P5\\n4 2\\n255\\n'; printf \"\\\\$(printf %03o $n)%.0s\" 1 2 3 4 5 6 7 8; n=$((n+1)); done;;\nesac\n"
    );
    std::fs::write(&path, script).expect("script");
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).expect("mode");
}

/// Imports with what stands for `ffmpeg` in `bin`, or with none.
fn import_video(folder: &Path, source: &str, code: i32) -> Value {
    let output = Command::new(env!("CARGO_BIN_EXE_lsfb"))
        .args(["import", source, "--out", "walk.mcap", "--force", "--json"])
        .current_dir(folder)
        .env(
            "PATH",
            format!("{}:/usr/bin:/bin", folder.join("bin").display()),
        )
        .output()
        .expect("the built binary");
    assert_eq!(
        output.status.code(),
        Some(code),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// The pixels, stamps and exposures of the images that were imported.
fn images(folder: &Path) -> Vec<(i64, u8, u32)> {
    let recording = Recording::open(&folder.join("walk.mcap")).expect("recording");
    let images = recording.images("cam0").expect("images");
    images
        .map(|image| image.expect("an image"))
        .map(|i| (i.time.nanos(), i.sample.pixels[0], i.sample.exposure_ns))
        .collect()
}

fn written(folder: &Path, files: &[(&str, String)]) {
    for (name, text) in files {
        let path = folder.join(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("folder");
        std::fs::write(path, text).expect("file");
    }
}

/// What can be imported need not be what an IMU measures: a gyroscope that was never switched on, readings of 10 Hz written at 100 Hz.
#[test]
fn an_imu_that_repeats_itself_is_said() {
    let header = "#timestamp [ns],w_x [rad s^-1],w_y,w_z,a_x [m s^-2],a_y,a_z";
    let turning = |n: i64| {
        let wave = |hz: f64| (hz * n as f64 * 0.01 * std::f64::consts::TAU).sin();
        [
            [0.3 * wave(1.0), wave(1.3), 0.5 * wave(0.4)],
            [2.0 * wave(1.9), wave(1.1), 9.81 + wave(2.0)],
        ]
    };
    let said = |measured: &dyn Fn(i64) -> [[f64; 3]; 2]| {
        let folder = tempfile::tempdir().expect("folder");
        let rows = inertial_rows(header, |n| {
            let [[wx, wy, wz], [ax, ay, az]] = measured(n);
            let at = 5_000_000_000 + n * 10_000_000;
            format!("{at},{wx},{wy},{wz},{ax},{ay},{az}")
        });
        written(folder.path(), &[("mav0/imu0/data.csv", rows)]);
        let report = import(folder.path(), Path::new("mav0"), &[], 0);
        let findings = report["findings"].as_array().expect("findings").iter();
        let what: Vec<&str> = findings.filter_map(|f| f["what"].as_str()).collect();
        (report["verdict"].clone(), what.join("; "))
    };
    assert_eq!(said(&turning).0, "pass");
    let (verdict, what) = said(&|n| [[0.0; 3], turning(n)[1]]);
    assert!(
        verdict == "fail" && what.contains("gyroscope reads (0, 0, 0)"),
        "{what}"
    );
    let (verdict, what) = said(&|n| turning(n / 10 * 10));
    assert!(
        verdict == "fail" && what.contains("repeat the previous reading"),
        "{what}"
    );
}

fn mars_logger(folder: &Path) {
    written(folder, &[
        ("mars/gyro_accel.csv", inertial_rows(
            "Timestamp[nanosec],gx[rad/s],gy[rad/s],gz[rad/s],ax[m/s^2],ay[m/s^2],az[m/s^2],Unix time[nanosec]",
            |n| format!("{},0.1,0.2,0.3,0.0,0.0,9.81,{}", 5_000_000_000 + n * 10_000_000, n),
        )),
        ("mars/frame_timestamps.txt", "Frame timestamp[nanosec],Unix time[nanosec]\n5000000000,1\n5033000000,2\n5066000000,3\n".into()),
        ("mars/movie_metadata.csv", "Timestamp[nanosec],fx[px],fy[px],Frame No.,Exposure time[nanosec],Sensor frame duration[nanosec],Frame readout time[nanosec],ISO,Focal length,Focus distance,AF mode,Unix time[nanosec]\n\
            5000000000,1,1,0,10000000,33000000,20000000,100,4,0,0,1\n5033000000,1,1,1,10000000,33000000,20000000,100,4,0,0,2\n5066000000,1,1,2,10000000,33000000,20000000,100,4,0,0,3\n".into()),
        ("mars/movie.mp4", "no video".into()),
    ]);
}

#[test]
fn frames_of_a_video_get_their_stamps_and_exposures() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    mars_logger(root);
    fake_ffmpeg(root, 3);
    let report = import_video(root, "mars", 0);
    assert_eq!(
        (&report["format"], &report["clock"]),
        (&"mars-logger".into(), &"device".into())
    );
    assert_eq!(found(&report, "gyro_accel.csv"), [1_000, 1_000, 0]);
    // The middle of the middle row: half an exposure of 10 ms and half a readout of 20 ms later.
    assert_eq!(
        images(root),
        [
            (5_015_000_000, 0, 10_000_000),
            (5_048_000_000, 1, 10_000_000),
            (5_081_000_000, 2, 10_000_000)
        ]
    );
    // One frame more than stamps: which belongs to which nobody knows, and no image is better than one with another's stamp.
    fake_ffmpeg(root, 4);
    let report = import_video(root, "mars", 3);
    assert_eq!(found(&report, "frame_timestamps.txt"), [3, 0, 3]);
    assert!(
        report.to_string().contains("4 frames but 3 stamps"),
        "{report}"
    );
    // None at all is said with what to do about it.
    std::fs::remove_file(root.join("bin/ffmpeg")).expect("removed");
    if !Path::new("/usr/bin/ffmpeg").exists() {
        let report = import_video(root, "mars", 3);
        assert_eq!(found(&report, "gyro_accel.csv"), [1_000, 1_000, 0]);
        assert!(
            report
                .to_string()
                .contains("install it (apt install ffmpeg)"),
            "{report}"
        );
    }
}

#[test]
fn recorders_with_documented_formats_come_over() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    fake_ffmpeg(root, 3);
    written(root, &[
        ("stray/odometry.csv", "timestamp, frame, x, y, z, qx, qy, qz, qw\n100.0, 000000, 0, 0, 0, 0, 0, 0, 1\n100.033, 000001, 1, 0, 0, 0, 0, 0, 1\n100.066, 000002, 2, 0, 0, 0, 0, 0, 1\n".into()),
        ("stray/camera_matrix.csv", "3.5, 0.0, 1.5\n0.0, 3.5, 0.5\n0.0, 0.0, 1.0\n".into()),
        ("stray/imu.csv", inertial_rows("timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z", |n| {
            format!("{:.3}, 0.0, 0.0, -1.0, 0.1, 0.2, 0.3", 100.0 + n as f64 * 0.01)
        })),
        ("stray/rgb.mp4", "no video".into()),
        ("stray/depth/000000.png", "depth".into()),
        ("stray/depth/000001.png", "depth".into()),
    ]);
    let report = import_video(root, "stray", 0);
    assert_eq!(report["format"], "stray-scanner");
    assert_eq!(report["has_rig"], true);
    assert_eq!(left_out(&report, "depth/*.png"), 2);
    assert_eq!(
        images(root).iter().map(|i| i.1).collect::<Vec<_>>(),
        [0, 1, 2]
    );
    let recording = Recording::open(&root.join("walk.mcap")).expect("recording");
    assert_eq!(
        recording.rig().expect("a rig").cameras["cam0"]
            .camera
            .focal_px(),
        [3.5, 3.5]
    );
    let sample = recording
        .imu()
        .expect("imu")
        .next()
        .expect("one")
        .expect("whole")
        .sample;
    // On its back: Apple says −1 g, the accelerometer is pushed upward.
    assert_eq!(sample.specific_force_m_s2[2], 9.806_65);
    assert_eq!(recording.poses(None).expect("poses").len(), 3);

    let mut events = String::new();
    for n in 0..300 {
        let time = 2.0 + f64::from(n) * 0.01;
        let _ = writeln!(
            events,
            "{{\"sensor\":{{\"type\":\"accelerometer\",\"values\":[0,0,9.81]}},\"time\":{}}}",
            time + 0.003
        );
        let _ = writeln!(
            events,
            "{{\"sensor\":{{\"type\":\"gyroscope\",\"values\":[0.1,0.2,0.3]}},\"time\":{time}}}"
        );
        if n % 100 == 50 {
            let _ = writeln!(
                events,
                "{{\"frames\":[{{\"cameraInd\":0}}],\"number\":{},\"time\":{time}}}",
                n / 100
            );
            let _ = writeln!(
                events,
                "{{\"groundTruth\":{{\"position\":{{\"x\":0,\"y\":0,\"z\":0}}}},\"time\":{time}}}"
            );
        }
    }
    written(root, &[
        ("rec/data.jsonl", events),
        ("rec/data.mkv", "no video".into()),
        ("rec/calibration.json", "{\"cameras\":[{\"focalLengthX\":3.5,\"focalLengthY\":3.5,\"principalPointX\":1.5,\"principalPointY\":0.5,\"model\":\"pinhole\",\"distortionCoefficients\":[],\"imuToCamera\":[[1,0,0,0.1],[0,1,0,0],[0,0,1,0],[0,0,0,1]],\"imageWidth\":4,\"imageHeight\":2}]}".into()),
    ]);
    let report = import_video(root, "rec", 0);
    assert_eq!(report["format"], "spectacular-rec");
    assert_eq!(found(&report, "accelerometer"), [300, 300, 0]);
    assert_eq!(left_out(&report, "groundTruth"), 3);
    let recording = Recording::open(&root.join("walk.mcap")).expect("recording");
    // Before its first sample there is nothing of the accelerometer.
    assert_eq!(recording.imu().expect("imu").count(), 299);
    assert_eq!(images(root).len(), 3);
    let rig = recording.rig().expect("a rig");
    assert_eq!(rig.cameras["cam0"].rig_from_camera.translation.x, -0.1);
}

/// A protobuf field of bytes.
fn field(number: u8, value: &[u8]) -> Vec<u8> {
    let length = u8::try_from(value.len()).expect("a short field");
    [&[number << 3 | 2, length], value].concat()
}

fn varint(number: u8, mut value: u64) -> Vec<u8> {
    let mut bytes = vec![number << 3];
    while value > 0x7f {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
    bytes
}

#[test]
fn protobuf_of_videoimucapture_comes_over_and_what_is_cut_is_counted() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    fake_ffmpeg(root, 3);
    let axes = |values: [f32; 3]| values.map(f32::to_le_bytes).concat();
    let mut bytes = Vec::new();
    for n in 0..200_u64 {
        let sample = [
            varint(1, 7_000_000_000 + n * 5_000_000),
            field(2, &axes([0.1, 0.2, 0.3])),
            field(4, &axes([0.0, 0.0, 9.81])),
        ];
        bytes.extend(field(4, &sample.concat()));
    }
    for n in 0..3_u64 {
        let frame = [
            varint(1, 7_000_000_000 + n * 33_000_000),
            varint(2, n),
            varint(3, 4_000_000),
            varint(5, 16_000_000),
        ];
        bytes.extend(field(5, &frame.concat()));
    }
    written(root, &[("app/video_recording.mp4", "no video".into())]);
    std::fs::write(root.join("app/video_meta.pb3"), &bytes).expect("file");
    let report = import_video(root, "app", 0);
    assert_eq!(report["format"], "video-imu-capture");
    assert_eq!(found(&report, "imu of video_meta.pb3"), [200, 200, 0]);
    assert_eq!(images(root)[1], (7_043_000_000, 1, 4_000_000));
    std::fs::write(root.join("app/video_meta.pb3"), &bytes[..bytes.len() - 1]).expect("file");
    let report = import_video(root, "app", 3);
    // The last frame is cut: two stamps for three frames of the video, so none of them is sure.
    assert!(
        report.to_string().contains("breaks off at byte"),
        "{report}"
    );
    assert_eq!(found(&report, "video_meta of video_meta.pb3"), [2, 0, 2]);
}

#[test]
fn a_session_of_lamar_keeps_its_poses_beside_it() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    written(root, &[
        ("s1/sensors.txt", "# sensor_id, name, sensor_type, [sensor_params]+\nphone/cam, , camera, PINHOLE, 640, 480, 500, 501, 320, 240\nphone/bt, , bluetooth\n".into()),
        ("s1/images.txt", "# timestamp, sensor_id, image_path\n1620000000000000, phone/cam, missing.jpg\n".into()),
        ("s1/bt.txt", "# timestamp, sensor_id, mac_addr, rssi, name\n1620000000500000, phone/bt, aa:bb, -70.0, \n1620000000600000, phone/bt, aa:bc, -71, x\n".into()),
        ("s1/trajectories.txt", "# timestamp, device_id, qw, qx, qy, qz, tx, ty, tz, *covar\n1620000000000000, phone/cam, 1, 0, 0, 0, 1, 2, 3\n".into()),
    ]);
    let report = import(root, &root.join("s1"), &[], 3);
    assert_eq!(report["format"], "lamar");
    assert_eq!(
        found(&report, "images.txt"),
        [1, 0, 1],
        "the image is not there"
    );
    assert_eq!(found(&report, "bt.txt"), [2, 2, 0]);
    let poses = lsfb_recording::read_tum(&root.join("walk.phone_cam.tum")).expect("poses");
    assert_eq!(poses.poses()[0].world_from_rig.translation.z, 3.0);
    let rig = Recording::open(&root.join("walk.mcap"))
        .expect("recording")
        .rig()
        .expect("a rig");
    // COLMAP counts from the corner of the first pixel.
    assert_eq!(
        rig.cameras["phone_cam"].camera.principal_px(),
        [319.5, 239.5]
    );
}
