use super::*;
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
fn stamps_are_exact() {
    let nanos = |text, exponent| decimal_nanos(text, exponent).map(Timestamp::nanos);
    assert_eq!(
        nanos("1311868164.363181", 9),
        Some(1_311_868_164_363_181_000)
    );
    assert_eq!(
        nanos("1.403715529112143517e+09", 9),
        Some(1_403_715_529_112_143_517)
    );
    assert_eq!(
        nanos("1403715524907143168", 0),
        Some(1_403_715_524_907_143_168)
    );
    assert_eq!(nanos("-0.0000000015", 9), Some(-2));
    assert_eq!(nanos("1e-60", 9), Some(0));
    assert_eq!(nanos("0e99", 9), Some(0));
    assert_eq!(
        nanos("0.00000000000000000000000000000000000000001", 9),
        Some(0)
    );
    for bad in [
        "",
        ".",
        "-",
        "1.2.3",
        "nan",
        "1e",
        "0x10",
        "1e12",
        "99999999999999999999",
        "1e2147483648",
    ] {
        assert_eq!(nanos(bad, 9), None, "{bad}");
    }
}

#[test]
fn reads_the_three_formats() {
    let tum = read("\u{feff}# a comment\n\n1.5 1 2 3 0 0 2e0 0.0\r\n").expect_err("length 2");
    assert!(
        tum.to_string().contains("line 3: quaternion of length 2"),
        "{tum}"
    );
    let tum = read("# a comment\n1.5 1 2 3 0 0 0.8 0.6\n1.25 1 2 3 0 0 0 1\n").expect("valid");
    assert_eq!(tum.len(), 2);
    assert_eq!(tum[0].time.nanos(), 1_500_000_000);
    assert_eq!(tum[1].time.nanos(), 1_250_000_000);
    assert_eq!(
        tum[0].world_from_rig.translation,
        Vector3::new(1.0, 2.0, 3.0)
    );
    let q = tum[0].world_from_rig.rotation;
    assert_eq!((q.w, q.i, q.j, q.k), (0.6, 0.0, 0.0, 0.8));

    let euroc =
        read("#timestamp, p_x\n1403715524907143168,1,2,3,0.6,0,0,0.8,9,9\n").expect("valid");
    assert_eq!(euroc[0].time.nanos(), 1_403_715_524_907_143_168);
    assert_eq!(euroc[0].world_from_rig, tum[0].world_from_rig);

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
    let read = read_kitti_poses(&poses, &times).expect("valid");
    assert_eq!(read[0].time.nanos(), 103_735_900);
    let (_c, two) = file(b"0\n1\n");
    let error = read_kitti_poses(&poses, &two)
        .expect_err("two stamps")
        .to_string();
    assert!(error.contains("2 stamps for the 1 poses"), "{error}");
    let (_d, cut) = file(&bytes[..bytes.len() - 9]);
    assert!(matches!(read_poses(&cut), Err(Error::Io { .. })));
}

#[test]
fn says_what_is_wrong_and_where() {
    for (content, part) in [
        ("", "no pose in it"),
        ("# only a comment\n", "no pose in it"),
        ("1 2 3\n", "line 1: 3 columns; expected 8"),
        (
            "1 0 0 0 0 0 0 1\n2 0 0 nan 0 0 0 1\n",
            "line 2: 'nan' is no finite number",
        ),
        (
            "1 0 0 0 0 0 0 1\n2 0 0 inf 0 0 0 1\n",
            "line 2: 'inf' is no finite number",
        ),
        (
            "1 0 0 0 0 0 0 1\n2 0 0 x 0 0 0 1\n",
            "line 2: 'x' is no finite number",
        ),
        ("now 0 0 0 0 0 0 1\n", "line 1: 'now' is no stamp"),
        ("1 0 0 0 0 0 0 0\n", "quaternion of length 0"),
        ("1,2,3\n", "line 1: 1 columns"),
        (
            "1 0 0 0 0 0 0 1\n1 0 0 7 0 1 0 8 0 0 1 9\n",
            "line 2: a row of Kitti among",
        ),
        ("2 0 0 7 0 1 0 8 0 0 1 9\n", "no rotation"),
        ("-1 0 0 7 0 1 0 8 0 0 1 9\n", "no rotation"),
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
