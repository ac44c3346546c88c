use std::path::PathBuf;

use lsfb_recording::cloud::PointTimes;

use super::*;

/// A file of a folder that is gone with it.
struct Written {
    _folder: tempfile::TempDir,
    path: PathBuf,
}

fn written(name: &str, bytes: &[u8]) -> Written {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("file");
    Written {
        _folder: folder,
        path,
    }
}

fn read(name: &str, bytes: &[u8]) -> Result<Cloud, Error> {
    read_cloud(&written(name, bytes).path)
}

/// The two points that every file here holds, 80 ms apart.
fn expect_two(cloud: &Cloud, name: &str) {
    let places: Vec<[f32; 3]> = cloud.scan.points.iter().map(|p| p.position_m).collect();
    assert_eq!(places, [[1.0, 2.0, 3.0], [-1.0, -2.0, 0.5]], "{name}");
    let intensities: Vec<u8> = cloud.scan.points.iter().map(|p| p.intensity).collect();
    assert_eq!(intensities, [40, 255], "{name}");
}

fn expect_times(cloud: &Cloud, name: &str) {
    assert!(
        matches!(&cloud.times, PointTimes::Field { .. }),
        "{name}: {:?}",
        cloud.times
    );
    let offsets: Vec<u32> = cloud.scan.points.iter().map(|p| p.time_offset_ns).collect();
    assert!(
        offsets[0] == 0 && offsets[1].abs_diff(80_000_000) < 300,
        "{name}: {offsets:?}"
    );
}

const POINTS: [[f32; 5]; 2] = [[1.0, 2.0, 3.0, 40.0, 0.02], [-1.0, -2.0, 0.5, 300.0, 0.1]];

fn pcd_header(data: &str) -> String {
    format!(
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity time\nSIZE 4 4 4 4 4\nTYPE F F F F F\n\
         COUNT 1 1 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA {data}\n"
    )
}

fn numbers(points: &[[f32; 5]]) -> Vec<u8> {
    points
        .iter()
        .flatten()
        .flat_map(|v| v.to_le_bytes())
        .collect()
}

fn text() -> String {
    let line = |p: &[f32; 5]| p.map(|v| v.to_string()).join(" ");
    POINTS.iter().map(line).collect::<Vec<_>>().join("\n") + "\n"
}

/// As PCL writes it: fields one after the other, in runs of LZF that are all literal.
fn compressed_pcd() -> Vec<u8> {
    let by_fields: Vec<u8> = (0..5)
        .flat_map(|i| POINTS.iter().flat_map(move |p| p[i].to_le_bytes()))
        .collect();
    let mut packed = Vec::new();
    for run in by_fields.chunks(32) {
        packed.push(run.len() as u8 - 1);
        packed.extend(run);
    }
    let lengths = [packed.len(), by_fields.len()].map(|n| (n as u32).to_le_bytes());
    [
        pcd_header("binary_compressed").as_bytes(),
        &lengths[0],
        &lengths[1],
        &packed,
    ]
    .concat()
}

fn ply_header(format: &str) -> String {
    format!(
        "ply\nformat {format} 1.0\ncomment of ours\nelement vertex 2\nproperty float x\nproperty float y\n\
         property float z\nproperty float scalar_intensity\nproperty float scalar_Time\n\
         element face 0\nproperty list uchar int vertex_index\nend_header\n"
    )
}

#[test]
fn every_kind_of_file_says_the_same() {
    let big: Vec<u8> = POINTS
        .iter()
        .flatten()
        .flat_map(|v| v.to_be_bytes())
        .collect();
    let raw = numbers(&POINTS);
    for (name, bytes) in [
        (
            "a.pcd",
            [pcd_header("ascii").as_bytes(), text().as_bytes()].concat(),
        ),
        ("b.PCD", [pcd_header("binary").as_bytes(), &raw].concat()),
        ("c.pcd", compressed_pcd()),
        (
            "a.ply",
            [ply_header("ascii").as_bytes(), text().as_bytes()].concat(),
        ),
        (
            "b.ply",
            [ply_header("binary_little_endian").as_bytes(), &raw].concat(),
        ),
        (
            "c.ply",
            [ply_header("binary_big_endian").as_bytes(), &big].concat(),
        ),
    ] {
        let cloud = read(name, &bytes).expect(name);
        expect_two(&cloud, name);
        expect_times(&cloud, name);
    }
}

/// Naively words that are no numbers, and those that are not there, were returns that did not come: their points vanished.
#[test]
fn text_that_is_no_number_is_named_by_its_line() {
    let with = |name: &str, line: &str| {
        let header = match name {
            "a.pcd" => pcd_header("ascii"),
            _ => ply_header("ascii"),
        };
        read(
            name,
            format!("{header}1 2 3 40 0.02\n\n{line}\n").as_bytes(),
        )
    };
    for (name, number) in [("a.pcd", 13), ("a.ply", 15)] {
        for (line, words) in [
            ("1,5 2 0.5 255 0.1", "\"1,5\" is not a number"),
            ("1 2 0.5 255 x", "\"x\" is not a number"),
            ("1 2 0.5", "3 words, but the header says 5"),
            ("1 2 0.5 255 0.1 7", "6 words, but the header says 5"),
        ] {
            let error = with(name, line).expect_err(line).to_string();
            let place = format!("line {number}: {words}");
            assert!(error.contains(name) && error.contains(&place), "{error}");
        }
        for line in [
            "nan nan nan 0 0",
            "-nan(ind) 2 0.5 0 0",
            "1.#QNAN inf 2 0 0",
        ] {
            let cloud = with(name, line).expect(line);
            assert_eq!(cloud.scan.points.len(), 1, "{line}");
        }
    }
    let error = with("a.pcd", "1 2 0.5 255 0.1\n1 2 0.5 255 0.1").expect_err("a third");
    assert!(error.to_string().contains("3 points, but"), "{error}");
}

/// Naively seconds of a week were added to the name of a file, or to the time by which it is the n-th.
#[test]
fn clocks_that_count_from_elsewhere_are_no_offsets_of_a_folder() {
    for (names, told, seconds) in [
        (
            ["0.pcd", "1.pcd"],
            ScanTimes::Points,
            [302_400.0, 302_400.2],
        ),
        (
            ["1700000000.0.pcd", "1700000000.2.pcd"],
            ScanTimes::Names,
            [1_700_000_000.0, 1_700_000_000.2],
        ),
    ] {
        let folder = tempfile::tempdir().expect("folder");
        for (name, second) in names.iter().zip([302_400.0, 302_400.2]) {
            let times = [second, second + 0.1].map(|t: f64| format!("{t:.3}"));
            let text = ascii_pcd(1, [&times[0], &times[1]]);
            std::fs::write(folder.path().join(name), text).expect("cloud");
        }
        let clouds = CloudFolder::open(folder.path(), 10.0).expect("clouds");
        let scans: Vec<FileScan> = clouds.scans().map(|s| s.expect("a scan")).collect();
        for (scan, second) in scans.iter().zip(seconds) {
            let expected = lsfb_types::Timestamp::from_secs_f64(second);
            assert!(scan.time.secs_since(expected).abs() < 1e-6, "{second}");
            let last_ns = scan.cloud.scan.points[1].time_offset_ns;
            assert!(last_ns.abs_diff(100_000_000) < 300, "{last_ns}");
        }
        assert_eq!(clouds.scan_times(), told);
    }
}

#[test]
fn bare_numbers_are_read_where_they_can_be_a_scan() {
    let kitti: Vec<u8> = [[1.0_f32, 2.0, 3.0, 40.0], [-1.0, -2.0, 0.5, 255.0]]
        .as_flattened()
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let cloud = read("0.bin", &kitti).expect("KITTI");
    expect_two(&cloud, "0.bin");
    assert_eq!(cloud.times, PointTimes::Absent);
    let nuscenes: Vec<u8> = [1.0_f32, 2.0, 3.0, 4.0, 31.0]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    assert_eq!(
        read("0.pcd.bin", &nuscenes).expect("nuScenes").scan.points[0].ring,
        31
    );
    // Points of three numbers, of which sixteen bytes are no point.
    let three: Vec<u8> = [1.0_f32, 2.0, 3.0, -4.0]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    for (bytes, words) in [
        (&kitti[..30], "not a whole number of points"),
        (&three, "intensity = -4"),
    ] {
        let error = read("0.bin", bytes).expect_err(words).to_string();
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn damage_is_named_and_never_panics() {
    let files = [
        (
            "a.pcd",
            [pcd_header("binary").as_bytes(), &numbers(&POINTS)].concat(),
        ),
        ("b.pcd", compressed_pcd()),
        (
            "a.ply",
            [
                ply_header("binary_little_endian").as_bytes(),
                &numbers(&POINTS),
            ]
            .concat(),
        ),
    ];
    for (name, whole) in files {
        for cut in (0..whole.len()).step_by(7) {
            assert!(read(name, &whole[..cut]).is_err(), "{name} {cut}");
        }
        for at in (0..whole.len()).step_by(3) {
            let mut damaged = whole.clone();
            damaged[at] ^= 0xff;
            let _ = read(name, &damaged);
        }
    }
    let error = read("a.xyz", b"").expect_err("unknown").to_string();
    assert!(error.contains(".pcd.bin .pcd .ply"), "{error}");
}

fn ascii_pcd(x: u32, times: [&str; 2]) -> String {
    format!(
        "VERSION 0.7\nFIELDS x y z time\nSIZE 4 4 4 8\nTYPE F F F F\nPOINTS 2\nDATA ascii\n\
         {x} 1 2 {}\n{x} 2 2 {}\n",
        times[0], times[1]
    )
}

#[test]
fn folders_are_read_in_the_order_of_their_numbers_with_the_times_there_are() {
    let folder = tempfile::tempdir().expect("folder");
    let scans = folder.path().join("velodyne");
    std::fs::create_dir(&scans).expect("folder");
    for x in [10, 2, 0, 1] {
        std::fs::write(scans.join(format!("{x}.pcd")), ascii_pcd(x, ["0", "0.1"])).expect("cloud");
    }
    let read = || {
        let clouds = CloudFolder::open(&scans, 5.0).expect("clouds");
        let scans: Vec<FileScan> = clouds.scans().map(|s| s.expect("a scan")).collect();
        let order: Vec<f32> = scans
            .iter()
            .map(|s| s.cloud.scan.points[0].position_m[0])
            .collect();
        assert_eq!(order, [0.0, 1.0, 2.0, 10.0]);
        (clouds.scan_times(), scans[3].time.nanos())
    };
    assert_eq!(read(), (ScanTimes::Rate, 600_000_000));
    std::fs::write(folder.path().join("times.txt"), "0\n0.1\n0.2\n0.4\n").expect("times");
    assert_eq!(read(), (ScanTimes::List, 400_000_000));
    for (x, from) in [
        (0, "1700000000.0"),
        (1, "1700000001.0"),
        (2, "1700000002.0"),
        (10, "1700000003.5"),
    ] {
        let till = format!("{from}9");
        std::fs::write(scans.join(format!("{x}.pcd")), ascii_pcd(x, [from, &till])).expect("cloud");
    }
    assert_eq!(read(), (ScanTimes::Points, 1_700_000_003_500_000_000));
    std::fs::write(
        scans.join("11.pcd"),
        ascii_pcd(11, ["1700000001.0", "1700000001.1"]),
    )
    .expect("cloud");
    let clouds = CloudFolder::open(&scans, 5.0).expect("clouds");
    let error = clouds
        .scans()
        .find_map(Result::err)
        .expect("out of order")
        .to_string();
    assert!(error.contains("11.pcd"), "{error}");
    assert!(matches!(
        CloudFolder::open(folder.path(), 5.0),
        Err(Error::NoClouds { .. })
    ));
}

/// Its folders hold a cloud each, and nothing was found in it.
#[test]
fn a_folder_of_gtsam_points_is_a_folder_of_clouds() {
    let test = "a_folder_of_gtsam_points_is_a_folder_of_clouds";
    let Some(folder) = lsfb_tests::recordings(test, "lidar/gtsam_points") else {
        return;
    };
    for (below, points) in [("kitti_07_dump", 21_562), ("newer_01", 19_968 + 1_309)] {
        let clouds = CloudFolder::open(&folder.join(below), 10.0).expect("clouds");
        assert_eq!((clouds.len(), clouds.scan_times()), (5, ScanTimes::Rate));
        let first = clouds.scans().next().expect("a scan").expect("read");
        assert_eq!(first.cloud.scan.points.len(), points, "{below}");
    }
}

/// CloudCompare's binary files of the pair that small_gicp is tried on.
#[test]
fn plys_of_others_are_read() {
    let test = "plys_of_others_are_read";
    let Some(folder) = lsfb_tests::recordings(test, "lidar/small_gicp") else {
        return;
    };
    let cloud = read_cloud(&folder.join("source.ply")).expect("a cloud");
    assert_eq!(cloud.scan.points.len(), 69_792);
    assert_eq!(cloud.times, PointTimes::Absent);
}

/// The two points as surveying software writes them.
fn las_file(is_compressed: bool, is_timed: bool) -> Vec<u8> {
    let mut format = ::las::point::Format::new(if is_timed { 1 } else { 0 }).expect("format");
    format.is_compressed = is_compressed;
    let mut builder = ::las::Builder::from((1, 4));
    builder.point_format = format;
    let header = builder.into_header().expect("header");
    let file = std::io::Cursor::new(Vec::new());
    let mut writer = ::las::Writer::new(file, header).expect("writer");
    for [x, y, z, intensity, time] in POINTS.map(|p| p.map(f64::from)) {
        let point = ::las::Point {
            x,
            y,
            z,
            intensity: intensity as u16,
            gps_time: is_timed.then_some(time),
            ..::las::Point::default()
        };
        writer.write_point(point).expect("written");
    }
    writer.into_inner().expect("closed").into_inner()
}

#[test]
fn las_and_laz_are_read() {
    for name in ["a.las", "a.LAZ"] {
        let bytes = las_file(name.ends_with('Z'), true);
        let cloud = read(name, &bytes).expect("valid");
        expect_two(&cloud, name);
        expect_times(&cloud, name);
        let untimed = read(name, &las_file(name.ends_with('Z'), false)).expect("valid");
        assert!(matches!(untimed.times, PointTimes::Absent), "{name}");
        for cut in [0, 4, 100, bytes.len() - 20] {
            let error = read(name, &bytes[..cut])
                .expect_err("cut short")
                .to_string();
            assert!(error.contains(name), "{error}");
        }
    }
}
