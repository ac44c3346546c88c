use super::*;
use lsfb_geometry::Vector3;
use lsfb_recording::{Channel, Recording, Writer, WriterConfig};
use std::io::Write;
use std::path::PathBuf;

fn file(content: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().expect("scratch");
    let path = dir.path().join("trajectory.txt");
    std::fs::write(&path, content).expect("written");
    (dir, path)
}

fn read(content: &str) -> Result<Vec<StampedPose>, Error> {
    let (_dir, path) = file(content.as_bytes());
    read_poses(&path)
}

#[test]
fn reads_the_three_formats() {
    let tum = read("\u{feff}# a comment\n\n1.5 1 2 3 0 0 2e0 0.0\r\n").expect_err("length 2");
    assert!(
        tum.to_string().contains("line 3: quaternion with norm 2"),
        "{tum}"
    );
    let tum = read("# a comment\n1.5 1 2 3 0 0 0.8 0.6\n1.25 1 2 3 0 0 0 1\n").expect("valid");
    assert_eq!(tum.len(), 2);
    // Sorted: the earlier row comes first.
    assert_eq!(tum[0].time.nanos(), 1_250_000_000);
    assert_eq!(tum[1].time.nanos(), 1_500_000_000);
    assert_eq!(
        tum[0].world_from_rig.translation,
        Vector3::new(1.0, 2.0, 3.0)
    );
    let q = tum[1].world_from_rig.rotation;
    assert_eq!((q.w, q.i, q.j, q.k), (0.6, 0.0, 0.0, 0.8));

    let euroc =
        read("#timestamp, p_x\n1403715524907143168,1,2,3,0.6,0,0,0.8,9,9\n").expect("valid");
    assert_eq!(euroc[0].time.nanos(), 1_403_715_524_907_143_168);
    assert_eq!(
        euroc[0].world_from_rig.translation,
        Vector3::new(1.0, 2.0, 3.0)
    );
    let q = euroc[0].world_from_rig.rotation;
    assert_eq!((q.w, q.i, q.j, q.k), (0.6, 0.0, 0.0, 0.8));

    let kitti = read("1 0 0 7 0 1 0 8 0 0 1 9\n0 -1 0 1 1 0 0 2 0 0 1 3\n").expect("valid");
    assert_eq!(kitti[1].time.nanos(), 1_000_000_000);
    assert_eq!(
        kitti[0].world_from_rig.translation,
        Vector3::new(7.0, 8.0, 9.0)
    );
    let x = kitti[1].world_from_rig.rotation * Vector3::x();
    assert!((x - Vector3::y()).norm() < 1e-15);
}

#[test]
fn reads_gzip_and_kitti_times() {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder
        .write_all(b"1 0 0 7 0 1 0 8 0 0 1 9\n")
        .expect("memory");
    let bytes = encoder.finish().expect("memory");
    let (_a, poses) = file(&bytes);
    let (_b, times) = file(b"1.037359e-01\n");
    let with = |times: &Path| {
        let options = ReadOptions {
            times: Some(times.to_owned()),
            ..ReadOptions::default()
        };
        read_trajectory(&poses, &options)
    };
    let read = with(&times).expect("valid");
    assert_eq!(read.poses[0].time.nanos(), 103_735_900);
    assert!(read.findings.is_empty(), "{:?}", read.findings);
    let (_c, two) = file(b"0\n1\n");
    let error = with(&two).expect_err("two stamps").to_string();
    assert!(error.contains("2 stamps for the 1 poses"), "{error}");
    let (_e, word) = file(b"soon\n");
    let error = with(&word).expect_err("a word").to_string();
    assert!(error.contains("'soon' is not a stamp"), "{error}");
    // Poses that have stamps need no others.
    let (_f, stamped) = file(b"1 0 0 0 0 0 0 1\n");
    let options = ReadOptions {
        times: Some(times.clone()),
        ..ReadOptions::default()
    };
    let error = read_trajectory(&stamped, &options).expect_err("two stamps for one pose");
    assert!(error.to_string().contains("its own stamps"), "{error}");
    let (_d, cut) = file(&bytes[..bytes.len() - 9]);
    assert!(matches!(read_poses(&cut), Err(Error::Io { .. })));
}

#[test]
fn says_what_is_wrong_and_where() {
    for (content, part) in [
        ("", "it has no poses"),
        ("# only a comment\n", "it has no poses"),
        ("1 2 3\n", "line 1: 3 columns; expected 8"),
        (
            "1 0 0 0 0 0 0 1\n2 0 0 nan 0 0 0 1\n",
            "line 2: 'nan' is not a finite number",
        ),
        (
            "1 0 0 0 0 0 0 1\n2 0 0 inf 0 0 0 1\n",
            "line 2: 'inf' is not a finite number",
        ),
        (
            "1 0 0 0 0 0 0 1\n2 0 0 x 0 0 0 1\n",
            "line 2: 'x' is not a finite number",
        ),
        ("now 0 0 0 0 0 0 1\n", "line 1: 'now' is not a stamp"),
        ("1 0 0 0 0 0 0 0\n", "quaternion with norm 0"),
        ("1,2,3\n", "line 1: 3 columns"),
        (
            "1 0 0 0 0 0 0 1\n1 0 0 7 0 1 0 8 0 0 1 9\n",
            "line 2: a row of 12 columns among rows of 8",
        ),
        ("2 0 0 7 0 1 0 8 0 0 1 9\n", "not a rotation"),
        ("-1 0 0 7 0 1 0 8 0 0 1 9\n", "not a rotation"),
    ] {
        let error = read(content).expect_err(content).to_string();
        assert!(error.contains(part), "{error}");
    }
    let (_dir, path) = file(&[0xff, 0xfe, 0x00, 0x41]);
    assert!(
        read_poses(&path)
            .expect_err("binary")
            .to_string()
            .contains("not text (byte 0)")
    );
    let missing = read_poses(Path::new("/nowhere/t.txt"))
        .expect_err("missing")
        .to_string();
    assert!(missing.starts_with("/nowhere/t.txt: "), "{missing}");
}

fn whole(content: &str) -> Result<TrajectoryFile, Error> {
    let (_dir, path) = file(content.as_bytes());
    read_trajectory(&path, &ReadOptions::default())
}

fn codes(file: &TrajectoryFile) -> Vec<&str> {
    file.findings.iter().map(|f| f.code.as_ref()).collect()
}

/// A walk in the TUM order, two poses of it.
fn rows(stamps: [&str; 3], separator: &str) -> String {
    let row = |stamp: &str, x: &str| [stamp, x, "2", "3", "0", "0", "0.8", "0.6"].join(separator);
    stamps
        .iter()
        .zip(["1", "1.5", "2"])
        .map(|(stamp, x)| row(stamp, x) + "\n")
        .collect()
}

#[test]
fn stamps_of_any_unit_and_any_separator() {
    for (stamps, separator, first_nanos, step_nanos, remarks) in [
        (
            [
                "1403636579763555584",
                "1403636579813555584",
                "1403636579863555584",
            ],
            " ",
            1_403_636_579_763_555_584,
            50_000_000,
            vec![],
        ),
        (
            ["1403636579763", "1403636579813", "1403636579863"],
            " ",
            1_403_636_579_763_000_000,
            50_000_000,
            vec![],
        ),
        (
            ["5000000000", "5050000000", "5100000000"],
            " ",
            5_000_000_000,
            50_000_000,
            vec!["stamp-unit"],
        ),
        (
            ["1403636579.763", "1403636579.813", "1403636579.863"],
            ",",
            1_403_636_579_763_000_000,
            50_000_000,
            vec!["columns"],
        ),
        (
            ["0.10", "0.15", "0.20"],
            "; ",
            100_000_000,
            50_000_000,
            vec!["columns"],
        ),
        (
            ["0", "33", "66"],
            " ",
            0,
            33_000_000_000,
            vec!["stamp-unit"],
        ),
    ] {
        let read = whole(&rows(stamps, separator)).expect("valid");
        assert_eq!(codes(&read), remarks, "{stamps:?}");
        let times: Vec<i64> = read.poses.iter().map(|p| p.time.nanos()).collect();
        assert_eq!(
            times[..2],
            [first_nanos, first_nanos + step_nanos],
            "{stamps:?}"
        );
        let pose = read.poses[1].world_from_rig;
        assert_eq!(pose.translation, Vector3::new(1.5, 2.0, 3.0));
        let q = pose.rotation;
        assert_eq!((q.w, q.i, q.j, q.k), (0.6, 0.0, 0.0, 0.8), "{stamps:?}");
    }
    let unclear = whole(&rows(["0", "1000000", "2000000"], " ")).expect_err("ambiguous");
    let text = unclear.to_string();
    assert!(
        text.contains("microseconds or nanoseconds; give the unit"),
        "{text}"
    );
    let said = ReadOptions {
        stamp_unit: Some(StampUnit::Nanoseconds),
        ..ReadOptions::default()
    };
    let (_dir, path) = file(rows(["0", "1000000", "2000000"], " ").as_bytes());
    let read = read_trajectory(&path, &said).expect("said");
    assert_eq!(read.poses[1].time.nanos(), 1_000_000);
}

/// A quaternion in the other order is one as well: without a word the file would be judged by wrong rotations.
/// Seconds with commas: the separator was taken for a comma, and half a number for a column.
#[test]
fn numbers_with_commas_are_numbers() {
    let tum = "1403636579,25 1,5 2 -3,25 0 0 0,8 0,6\n1403636579,3 1,5 2 3 0 0 0,8 0,6\n";
    for text in [
        tum.to_owned(),
        tum.replace(' ', ";"),
        tum.replace(' ', "; "),
    ] {
        let read = whole(&text).expect("valid");
        assert_eq!(read.poses[0].time.nanos(), 1_403_636_579_250_000_000);
        let place = read.poses[0].world_from_rig.translation;
        assert_eq!(place, Vector3::new(1.5, 2.0, -3.25), "{text}");
        assert_eq!(read.poses[0].world_from_rig.rotation.w, 0.6);
    }
    let named = format!("time;x;y;z;qx;qy;qz;qw\n{}", tum.replace(' ', ";"));
    assert_eq!(whole(&named).expect("valid").poses.len(), 2);
    // Between columns a comma stays what it is.
    let read = whole("1.5, 1, 2, 3, 0, 0, 0.8, 0.6\n1.6, 1, 2, 3, 0, 0, 0.8, 0.6\n");
    assert_eq!(
        read.expect("valid").poses[0].world_from_rig.translation,
        Vector3::new(1.0, 2.0, 3.0)
    );
}

#[test]
fn names_overrule_the_order_of_columns() {
    let row = "1.5,1,2,3,0.6,0,0,0.8\n1.6,1,2,3,0.6,0,0,0.8\n";
    let w_of = |content: &str| {
        let read = whole(content).expect("valid");
        (read.poses[0].world_from_rig.rotation.w, read.findings.len())
    };
    assert_eq!(w_of(&format!("t,x,y,z,qw,qx,qy,qz\n{row}")), (0.6, 0));
    assert_eq!(
        w_of(&format!("# t, x, y, z, qw, qx, qy, qz\n{row}")),
        (0.6, 0)
    );
    assert_eq!(w_of(&format!("t,x,y,z,qx,qy,qz,qw\n{row}")), (0.8, 0));
    // EuRoC's names above rows that a program has written with blanks, and the other way around.
    let blanks = row.replace(',', " ");
    assert_eq!(
        w_of(&format!(
            "#t, x [m], y [m], z [m], qw [], qx [], qy [], qz []\n{blanks}"
        )),
        (0.6, 0)
    );
    assert_eq!(w_of(&format!("# t x y z qw qx qy qz\n{row}")), (0.6, 0));
    let long = whole(&format!(
        "#t, x [mm], y [mm], z [mm], qw, qx, qy, qz\n{row}"
    ));
    let long = long.expect_err("millimetres").to_string();
    assert!(
        long.contains("positions are in mm according to their names"),
        "{long}"
    );
    // Not said: TUM's order is assumed, with a warning.
    assert_eq!(w_of(row), (0.8, 1));
    let given = ReadOptions {
        columns: Some(Columns::EUROC),
        ..ReadOptions::default()
    };
    let (_dir, path) = file(row.as_bytes());
    let read = read_trajectory(&path, &given).expect("given");
    assert_eq!(read.poses[0].world_from_rig.rotation.w, 0.6);
    let unnamed = whole(&format!("a,b,c,d,e,f,g,h\n{row}"))
        .expect_err("no names")
        .to_string();
    assert!(
        unnamed.contains("line 1: 'a,b,c,d,e,f,g,h' has no stamp"),
        "{unnamed}"
    );
    let nine = whole("1.5,1,2,3,0.6,0,0,0.8,7\n")
        .expect_err("which is which")
        .to_string();
    assert!(nine.contains("9 columns with stamps in seconds"), "{nine}");
    // VINS-Mono: a comma at the end.
    let vins = whole("1403636579763555584,1,2,3,0.6,0,0,0.8,1,1,1,\n").expect("valid");
    assert_eq!(vins.poses[0].world_from_rig.rotation.w, 0.6);
}

#[test]
fn positions_alone_have_no_orientation() {
    for content in [
        "1 1 2 3\n2 1 2 3\n",
        "1,1,2,3\n2,1,2,3\n",
        "t,x,y,z\n1,1,2,3\n",
    ] {
        let read = whole(content).expect("valid");
        assert_eq!(read.orientations, Orientations::Missing);
        assert_eq!(
            read.poses[0].world_from_rig.translation,
            Vector3::new(1.0, 2.0, 3.0)
        );
        let (_dir, path) = file(content.as_bytes());
        assert!(matches!(
            read_poses(&path),
            Err(Error::NeedsOrientation { .. })
        ));
    }
}

#[test]
fn disorder_is_sorted_and_counted() {
    let read = whole(
        "2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n3 0 0 0 0 0 0 1\n3 0 0 0 0 0 0 1\n2.5 0 0 0 0 0 0 1\n",
    );
    let read = read.expect("valid");
    assert_eq!(codes(&read), ["unsorted-stamps", "duplicate-stamps"]);
    assert_eq!(read.findings[0].value, Some(2.0));
    assert!(read.findings[1].what.contains("at the same position"));
    let secs: Vec<f64> = read
        .poses
        .iter()
        .map(|p| p.time.nanos() as f64 * 1e-9)
        .collect();
    assert_eq!(secs, [1.0, 2.0, 2.5, 3.0, 3.0]);
    let elsewhere = whole("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n2 0 3 4 0 0 0 1\n").expect("valid");
    assert!(
        elsewhere.findings[0]
            .what
            .contains("1 of them at another position (up to 5.000 m)")
    );
}

/// `std::cout << stamp` prints six digits: a whole run under two stamps.
#[test]
fn stamps_without_their_last_digits_are_refused() {
    let content: String = (0..40)
        .map(|i| format!("1.40364e+09 {i} 0 0 0 0 0 1\n"))
        .collect();
    let refused = whole(&content).expect_err("coarse").to_string();
    assert!(
        refused.contains("40 poses have only 1 different stamps"),
        "{refused}"
    );
}

#[test]
fn kapture_has_the_world_in_the_device() {
    let content = "# kapture format: 1.1\n# timestamp, device_id, qw, qx, qy, qz, tx, ty, tz\n\
        1555399760151000, rig, 0.6, 0, 0, 0.8, 1, 0, 0\n1555399760251000, rig, 0.6, 0, 0, 0.8, 1, 0, 0\n\
        1555399760351000, rig, , , , , 1, 0, 0\n";
    let read = whole(content).expect("valid");
    assert_eq!(read.poses[0].time.nanos(), 1_555_399_760_151_000_000);
    let pose = read.poses[0].world_from_rig;
    assert!((pose.rotation.k + 0.8).abs() < 1e-15);
    // −R⁻¹ t of a turn by 2 atan(0.8/0.6) about z.
    assert!((pose.translation - Vector3::new(0.28, 0.96, 0.0)).norm() < 1e-12);
    assert_eq!(codes(&read), ["rows-without-pose"]);
    let two = content.replace("60251000, rig", "60251000, phone");
    let refused = whole(&two).expect_err("two devices").to_string();
    assert!(refused.contains("the file has phone, rig"), "{refused}");
    let (_dir, path) = file(two.as_bytes());
    let phone = ReadOptions {
        stream: Some("phone".to_owned()),
        ..ReadOptions::default()
    };
    assert_eq!(
        read_trajectory(&path, &phone).expect("chosen").poses.len(),
        1
    );
}

#[test]
fn covariances_turn_with_the_body() {
    // A quarter turn about z: the world's y is the body's x.
    let mut cells = vec!["0.0".to_owned(); 36];
    for (i, value) in [1.0, 4.0, 9.0, 0.01, 0.04, 0.09].iter().enumerate() {
        cells[7 * i] = value.to_string();
    }
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let read = whole(&format!("1 0 0 0 0 0 {half} {half} {}\n", cells.join(" "))).expect("valid");
    let diagonal = read.covariances[0].diagonal();
    for (value, expected) in diagonal.iter().zip([0.04, 0.01, 0.09, 4.0, 1.0, 9.0]) {
        assert!((value - expected).abs() < 1e-12, "{diagonal}");
    }
}

#[test]
fn poses_of_a_recording() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("robot.mcap");
    let mut writer = Writer::create(&path, &WriterConfig::default()).expect("a file");
    let write = |writer: &mut Writer, topic: &str, stamp_s: u32| {
        // `geometry_msgs/PoseStamped`: header, position, orientation.
        let mut bytes = vec![0, 1, 0, 0];
        bytes.extend(stamp_s.to_le_bytes());
        bytes.extend([0; 4]);
        bytes.extend([4, 0, 0, 0]);
        bytes.extend(*b"map\0");
        for value in [1.0, 2.0, 3.0, 0.0, 0.0, 0.8, 0.6f64] {
            bytes.extend(value.to_le_bytes());
        }
        let channel = Channel {
            topic,
            schema_name: "geometry_msgs/msg/PoseStamped",
            schema_text: "std_msgs/Header header",
        };
        let time = Timestamp::from_nanos(i64::from(stamp_s) * 1_000_000_000);
        writer
            .write_cdr(&channel, time, time, &bytes)
            .expect("written");
    };
    for stamp_s in [10, 12, 11] {
        write(&mut writer, "/slam/pose", stamp_s);
    }
    write(&mut writer, "/truth", 10);
    writer.finish().expect("finished");
    assert_eq!(
        Recording::open(&path).expect("opens").pose_topics().count(),
        2
    );
    let several = read_trajectory(&path, &ReadOptions::default())
        .expect_err("two topics")
        .to_string();
    assert!(
        several.contains("/slam/pose") && several.contains("/truth"),
        "{several}"
    );
    let chosen = ReadOptions {
        stream: Some("/slam/pose".to_owned()),
        ..ReadOptions::default()
    };
    let read = read_trajectory(&path, &chosen).expect("chosen");
    assert_eq!(codes(&read), ["unsorted-stamps"]);
    assert_eq!(read.poses[2].time.nanos(), 12_000_000_000);
    assert_eq!(
        read.poses[2].world_from_rig.translation,
        Vector3::new(1.0, 2.0, 3.0)
    );
    assert!((read.poses[2].world_from_rig.rotation.k - 0.8).abs() < 1e-15);
}

#[test]
fn colmap_has_the_world_in_the_camera() {
    let content = "# Image list with two lines of data per image:\n#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n\
        #   POINTS2D[] as (X, Y, POINT3D_ID)\n\
        2 0.6 0 0 0.8 1 0 0 1 cam0/frame_1403636579.813.png\n1 2 -1 3 4 -1 5 6 7\n\
        1 0.6 0 0 0.8 1 0 0 1 cam0/frame_1403636579.763.png\n\n";
    let read = whole(content).expect("valid");
    assert!(read.findings.is_empty() && read.poses.len() == 2);
    assert_eq!(read.poses[0].time.nanos(), 1_403_636_579_763_000_000);
    let place = read.poses[0].world_from_rig.translation;
    assert!((place - Vector3::new(0.28, 0.96, 0.0)).norm() < 1e-12);
    let nameless = whole(&content.replace("_1403636579.763", ""))
        .expect_err("no stamp")
        .to_string();
    assert!(nameless.contains("does not end with a stamp"), "{nameless}");
}

#[test]
fn colmap_writes_the_same_in_bytes() {
    let mut bytes = 2_u64.to_le_bytes().to_vec();
    for (number, name) in [
        (2_u32, "cam0/1403636579.813.png"),
        (1, "1403636579.763.png"),
    ] {
        bytes.extend(number.to_le_bytes());
        for value in [0.6, 0.0, 0.0, 0.8, 1.0, 0.0, 0.1 + 0.2] {
            bytes.extend(f64::to_le_bytes(value));
        }
        bytes.extend(7_u32.to_le_bytes());
        bytes.extend(name.as_bytes());
        bytes.push(0);
        bytes.extend(1_u64.to_le_bytes());
        bytes.extend([0x11; 24]);
    }
    let dir = tempfile::tempdir().expect("scratch");
    let path = dir.path().join("images.bin");
    let read = |bytes: &[u8]| {
        std::fs::write(&path, bytes).expect("written");
        read_trajectory(&path, &ReadOptions::default())
    };
    let poses = read(&bytes).expect("valid").poses;
    assert_eq!(poses.len(), 2);
    assert_eq!(poses[0].time.nanos(), 1_403_636_579_763_000_000);
    let place = poses[0].world_from_rig.translation;
    assert!((place - Vector3::new(0.28, 0.96, -(0.1 + 0.2))).norm() < 1e-12);
    // Cut anywhere, with more behind it, or with a count that no file has: refused, and no panic.
    for length in 0..bytes.len() {
        let error = read(&bytes[..length]).expect_err("cut short").to_string();
        assert!(error.contains("images.bin"), "{error}");
    }
    assert!(read(&[bytes.clone(), vec![0]].concat()).is_err());
    bytes[..8].fill(0xff);
    assert!(read(&bytes).is_err());
}

/// As `lsfb localize --out` writes it: frames without a pose, one that is not vouched for, a reason with a comma.
#[test]
fn a_localization_tells_its_success() {
    let text = "frame,localized,probability,inliers,more_than_30_inliers,x_m,y_m,z_m,qx,qy,qz,qw,reprojection_rms_px,reason\n\
                10.0,1,0.999,120,1,1,2,3,0,0,0,1,0.5,\"\"\n\
                10.1,0,0.4,31,1,9,9,9,0,0,0,1,0.5,\"too few, too near\"\n\
                10.2,0,,,,,,,,,,,,\"no match\"\n\
                10.3,1,0.999,30,0,1.2,2,3,0,0,0,1,0.5,\"\"\n";
    let found = whole(text).expect("valid");
    let success = found.success.expect("counted");
    assert_eq!(
        (success.frames, success.succeeded, success.localized),
        (4, 2, 2)
    );
    let places: Vec<f64> = found
        .poses
        .iter()
        .map(|p| p.world_from_rig.translation.x)
        .collect();
    assert_eq!(places, [1.0, 1.2]);
    assert_eq!(found.poses[1].time.nanos(), 10_300_000_000);
    assert!(found.findings.is_empty(), "{:?}", found.findings);
    // The number of a frame is not a stamp where nothing says that this is a localization.
    assert!(whole("frame,x,y,z,qx,qy,qz,qw\n1,1,2,3,0,0,0,1\n").is_err());
    let bad = whole(&text.replace(",120,", ",many,")).expect_err("no number");
    assert!(
        bad.to_string()
            .contains("line 2: 'many' is not a number of matches"),
        "{bad}"
    );
}

#[test]
fn an_image_whose_name_has_a_blank_is_not_left_out() {
    let content = "# Image list with two lines of data per image:\n\
        1 0.6 0 0 0.8 1 0 0 1 1403636579.763.png\n1 2 -1\n\
        2 0.6 0 0 0.8 1 0 0 1 my cam 1403636579.813.png\n1 2 -1\n";
    let error = whole(content).expect_err("columns").to_string();
    assert!(error.contains("line 4: a row of 12 columns"), "{error}");
}

#[test]
fn a_path_counts_as_it_was_last_said_and_frames_are_named() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("robot.mcap");
    let mut writer = Writer::create(&path, &WriterConfig::default()).expect("a file");
    let stamp = |s: u32| Timestamp::from_nanos(i64::from(s) * 1_000_000_000);
    let pose = |bytes: &mut Vec<u8>, s: u32, child: Option<&[u8; 4]>| {
        bytes.extend(s.to_le_bytes());
        bytes.extend([0, 0, 0, 0, 4, 0, 0, 0]);
        bytes.extend(*b"map\0");
        if let Some(child) = child {
            bytes.extend(4_u32.to_le_bytes());
            bytes.extend(child);
        }
        // Doubles begin at a multiple of eight behind the four bytes at the front.
        while bytes.len() % 8 != 4 {
            bytes.push(0);
        }
        for value in [f64::from(s), 2.0, 3.0, 0.0, 0.0, 0.0, 1.0] {
            bytes.extend(value.to_le_bytes());
        }
    };
    let mut write = |topic: &str, schema_name: &str, s: u32, bytes: &[u8]| {
        let channel = Channel {
            topic,
            schema_name,
            schema_text: "std_msgs/Header header",
        };
        let written = writer.write_cdr(&channel, stamp(s), stamp(s), bytes);
        written.expect("written");
    };
    for s in 1..=3_u32 {
        let mut bytes = vec![0, 1, 0, 0];
        bytes.extend(s.to_le_bytes());
        bytes.extend([0, 0, 0, 0, 4, 0, 0, 0]);
        bytes.extend(*b"map\0");
        bytes.extend(s.to_le_bytes());
        for k in 1..=s {
            pose(&mut bytes, k, None);
        }
        write("/path", "nav_msgs/msg/Path", s, &bytes);
        let mut bytes = vec![0, 1, 0, 0];
        bytes.extend(2_u32.to_le_bytes());
        pose(&mut bytes, s, Some(b"rig\0"));
        pose(&mut bytes, s, Some(b"cam\0"));
        write("/tf", "tf2_msgs/msg/TFMessage", s, &bytes);
    }
    writer.finish().expect("finished");
    let read = |stream: Option<&str>| {
        let options = ReadOptions {
            stream: stream.map(str::to_owned),
            ..ReadOptions::default()
        };
        read_trajectory(&path, &options)
    };
    // A path repeats what it said before: three poses, not six; and it is the only topic of one body.
    assert_eq!(read(None).expect("the path").poses.len(), 3);
    assert_eq!(read(Some("/tf:map.rig")).expect("an edge").poses.len(), 3);
    for (stream, said) in [
        ("/tf", "/tf:map.cam, /tf:map.rig"),
        ("/tf:map.dog", "/tf:map.cam"),
    ] {
        let error = read(Some(stream)).expect_err("no edge").to_string();
        assert!(error.contains(said), "{error}");
    }
}

/// A device at 200 Hz with stamps in milliseconds since its start has one every "5 s", as keyframes have: it was read as seconds, and both
/// files being so, jerk and errors per second were a thousand times too small, without a remark.
#[test]
fn milliseconds_of_a_fast_device_are_told_by_its_speed() {
    let walk = |step: f64, metres: f64| -> String {
        (0..200)
            .map(|i| {
                format!(
                    "{} {} 0 0 0 0 0 1\n",
                    step * f64::from(i),
                    metres * f64::from(i)
                )
            })
            .collect()
    };
    // 1.2 m/s at 200 Hz, also with the stamps of keyframes and of a rest.
    for (step, metres, expected) in [
        (5.0, 0.006, vec!["stamp-unit"]),
        (2.0, 0.0024, vec!["stamp-unit"]),
        (0.005, 0.006, vec![]),
        (5.0, 6.0, vec![]),
        (1.0, 0.0, vec![]),
        (1.0, 1e-5, vec![]),
    ] {
        let read = whole(&walk(step, metres)).expect("valid");
        assert_eq!(codes(&read), expected, "{step} s, {metres} m");
    }
    let (_dir, path) = file(walk(5.0, 0.006).as_bytes());
    for unit in [StampUnit::Milliseconds, StampUnit::Seconds] {
        let said = ReadOptions {
            stamp_unit: Some(unit),
            ..ReadOptions::default()
        };
        let read = read_trajectory(&path, &said).expect("said");
        assert!(codes(&read).is_empty(), "{unit}");
    }
}

/// Half of a file of positions, cut within a number: -0.137 was read as -0.
#[test]
fn a_file_that_breaks_off_within_a_number_is_told() {
    let rows: Vec<String> = (0..30)
        .map(|i| format!("{}.500000 {i}.250000 0.125000 -0.137342", 10 * i))
        .collect();
    let whole_text = rows.join("\n");
    // A last row without an end is none the worse for it.
    for (cut, expected) in [(0, vec![]), (3, vec!["cut"]), (7, vec!["cut"])] {
        let text = &whole_text[..whole_text.len() - cut];
        let said = ReadOptions {
            stamp_unit: Some(StampUnit::Seconds),
            ..ReadOptions::default()
        };
        let (_dir, path) = file(text.as_bytes());
        let read = read_trajectory(&path, &said).expect("valid");
        let codes: Vec<&str> = codes(&read)
            .into_iter()
            .filter(|code| *code != "stamp-unit")
            .collect();
        assert_eq!(codes, expected, "{cut}");
    }
    // Numbers of any length are no sign of it.
    let short = "0 1 2 3\n1 1 2 3.25\n2 1 2 3";
    assert!(codes(&whole(short).expect("valid")).is_empty());
}
