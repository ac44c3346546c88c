//! The documented commands on recordings made by others (`LSFB_TEST_DATA`).

use std::path::Path;

use crate::answer::json;
use crate::inlier_lines::hold_against_poses;
use crate::process::lsfb;
use crate::refusal::refused;
use lsfb_geometry::{Quaternion, Rig, UnitQuaternion, Vector3};
use lsfb_perception::image;
use lsfb_recording::{Recording, read_tum};
use lsfb_tests::recordings;
use serde_json::Value;

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

#[test]
fn capture_files_become_recordings_with_every_point() {
    let test = "capture_files_become_recordings_with_every_point";
    // Points: `lidar/reference_decodes`, and where that holds whole scans only, velodyne-decoder on the file.
    for (flag, below, packets, points) in [
        (
            "--db3",
            "lidar/nebula_velodyne/vlp32/1713492677464078412_0.db3",
            379,
            131_305,
        ),
        (
            "--pcap",
            "lidar/mrpt/sample_velodyne_vlp16_gps.pcap",
            293,
            73_486,
        ),
        (
            "--pcap",
            "lidar/mrpt/sample_velodyne_hdl32.pcap",
            500,
            146_705,
        ),
    ] {
        let Some(capture) = recordings(test, below) else {
            return;
        };
        let folder = tempfile::tempdir().expect("folder");
        let report = json(
            folder.path(),
            &["scan", flag, text(&capture), "--out", "drive.mcap"],
            0,
        );
        assert_eq!(report["lost"], 0, "{below}");
        let recording = Recording::open(&folder.path().join("drive.mcap")).expect("recording");
        assert_eq!(
            recording.packets("lidar/packets").expect("packets").count(),
            packets,
            "{below}"
        );
        let scans = recording.scans().expect("scans");
        let found: usize = scans
            .map(|scan| scan.expect("scan").sample.points.len())
            .sum();
        assert_eq!(found, points, "{below}");
    }
}

#[test]
fn a_street_ends_where_kiss_icp_ends() {
    let test = "a_street_ends_where_kiss_icp_ends";
    let Some(street) = recordings(test, "lidar/udacity_kitti_raw/data_1") else {
        return;
    };
    let folder = tempfile::tempdir().expect("folder");
    let report = json(
        folder.path(),
        &[
            "odometry",
            text(&street),
            "--outdoor",
            "--out",
            "street.tum",
        ],
        0,
    );
    assert_eq!(
        (&report["scans"], &report["registered"]),
        (&22.into(), &22.into())
    );

    let poses =
        std::fs::read_to_string(street.with_file_name("data_1_kissicp_poses.txt")).expect("poses");
    // Rows of 3 × 4 matrices.
    let position = |line: &str| {
        let numbers: Vec<f64> = line
            .split_whitespace()
            .map(|n| n.parse().expect("number"))
            .collect();
        Vector3::new(numbers[3], numbers[7], numbers[11])
    };
    let reference: Vec<_> = poses.lines().map(position).collect();
    let path_m: f64 = reference
        .windows(2)
        .map(|pair| (pair[1] - pair[0]).norm())
        .sum();
    let found = read_tum(&folder.path().join("street.tum")).expect("trajectory");
    let end = found
        .poses()
        .last()
        .expect("poses")
        .world_from_rig
        .translation;
    let off_m = (end - reference.last().expect("poses")).norm();
    assert!(off_m < 0.01 * path_m, "{off_m} m off after {path_m} m");

    // KISS-ICP finds its first steps without a motion to go by: 0.872, 0.702 and 0.802 m, where a car moves evenly. From there on:
    let steady = 3;
    let at_steady = found
        .poses()
        .iter()
        .find(|p| p.time.nanos() >= 100_000_000 * steady as i64);
    let ours = end - at_steady.expect("poses").world_from_rig.translation;
    let theirs = reference[reference.len() - 1] - reference[steady];
    let off_m = (ours - theirs).norm();
    assert!(
        off_m < 0.005 * theirs.norm(),
        "{off_m} m off after {} m",
        theirs.norm()
    );
}

/// The pair that small_gicp is tried on, as files of a folder.
#[test]
fn a_pair_of_plys_is_registered_as_given() {
    let test = "a_pair_of_plys_is_registered_as_given";
    let Some(pair) = recordings(test, "lidar/small_gicp") else {
        return;
    };
    let folder = tempfile::tempdir().expect("folder");
    let clouds = folder.path().join("pair");
    std::fs::create_dir(&clouds).expect("folder");
    for (from, to) in [("target.ply", "0.ply"), ("source.ply", "1.ply")] {
        std::fs::copy(pair.join(from), clouds.join(to)).expect("copied");
    }
    let command = ["odometry", "pair", "--outdoor", "--out", "pair.tum"];
    json(folder.path(), &command, 0);
    let found = read_tum(&folder.path().join("pair.tum")).expect("trajectory");
    let found = found.poses().last().expect("poses").world_from_rig;
    let given = std::fs::read_to_string(pair.join("T_target_source.txt")).expect("transform");
    let given: Vec<f64> = given
        .split_whitespace()
        .map(|n| n.parse().expect("number"))
        .collect();
    let off_m = (found.translation - Vector3::new(given[3], given[7], given[11])).norm();
    let trace: f64 = (0..3)
        .flat_map(|r| (0..3).map(move |c| (r, c)))
        .map(|(r, c)| given[4 * r + c] * found.rotation_matrix()[(r, c)])
        .sum();
    let off_deg = ((trace - 1.0) / 2.0).clamp(-1.0, 1.0).acos().to_degrees();
    assert!(off_m < 0.05 && off_deg < 0.5, "{off_m} m, {off_deg}°");
}

#[test]
fn an_office_is_recognised_by_every_fifth_image() {
    let test = "an_office_is_recognised_by_every_fifth_image";
    let Some(office) = recordings(test, "vision/hololens_office") else {
        return;
    };
    let folder = tempfile::tempdir().expect("folder");
    let office = text(&office);
    let map = [
        "map",
        "--posed-images",
        office,
        "--holdout-every",
        "5",
        "--out",
        "office-map",
        "--out-report",
        "office.html",
    ];
    let built = json(folder.path(), &map, 0);
    assert!(built["points"].as_u64() > Some(1_000));
    // Its focal length is another one than the list says.
    let report = &built["report"];
    let median_px = |of: &Value| of["reprojection_median_px"].as_f64().expect("pixels");
    assert!(
        median_px(report) < 0.8 && median_px(report) < median_px(&report["as_listed"]),
        "{report}"
    );
    let page = std::fs::read_to_string(folder.path().join("office.html")).expect("a page");
    assert!(page.contains("Residuals by camera") && page.contains("reprojection, rms"));
    let again = lsfb(folder.path(), &map);
    let said = String::from_utf8_lossy(&again.stderr);
    assert!(said.contains("up to date"), "{said}");
    let beside = folder.path().join("office-map.provenance.json");
    let beside = std::fs::read_to_string(beside).expect("where the map comes from");
    let made_from: Value = serde_json::from_str(&beside).expect("JSON");
    let hash = made_from["inputs"]["hololens_office"].as_str();
    assert_eq!(hash.map(str::len), Some(64), "{beside}");
    let queries = [
        "localize",
        "--posed-images",
        office,
        "--every",
        "5",
        "--map",
        "office-map",
    ];
    let found = json(folder.path(), &queries, 0);
    let share = found["right"].as_f64().expect("count") / found["images"].as_f64().expect("count");
    assert!(share >= 0.9, "{found}");
    a_folder_of_images_is_localized(folder.path(), Path::new(office));
    odd_images_are_answered_honestly(folder.path(), Path::new(office));
    drawings_say_what_was_answered(folder.path(), Path::new(office));
    poses_beside_images_change_nothing(folder.path(), office);
}

/// The same folder, its poses not looked at: the same images are localized, and none is called right.
fn poses_beside_images_change_nothing(folder: &Path, office: &str) {
    let posed = [
        "localize",
        "--posed-images",
        office,
        "--every",
        "60",
        "--map",
        "office-map",
    ];
    let alone = ["localize", "office-map", office, "--every", "60"];
    let [posed, alone] = [&posed[..], &alone].map(|arguments| json(folder, arguments, 0));
    assert!(
        posed["right"].is_u64() && alone["right"].is_null(),
        "{alone}"
    );
    assert_eq!(posed["images"], alone["images"]);
    let poses = |found: &Value| -> Vec<Value> {
        let frames = found["frames"].as_array().expect("frames").iter();
        frames.map(|frame| frame["pose"].clone()).collect()
    };
    assert_eq!(poses(&posed), poses(&alone));
}

fn write_png(path: &Path, [width, height]: [u32; 2], depth: png::BitDepth, bytes: &[u8]) {
    let file = std::fs::File::create(path).expect("file");
    let mut encoder = png::Encoder::new(file, width, height);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(depth);
    let mut writer = encoder.write_header().expect("PNG");
    writer.write_image_data(bytes).expect("PNG");
}

/// Black, with one feature, of 16 bits, and turned by a right angle: what shows nothing is nowhere, all else where it was taken.
fn odd_images_are_answered_honestly(folder: &Path, office: &Path) {
    let [odd, turned] = ["odd", "turned"].map(|name| folder.join(name));
    for made in [&odd, &turned] {
        std::fs::create_dir(made).expect("folder");
    }
    let image = image::read(&office.join("images/00033.jpg")).expect("an image");
    let (width, height) = (image.width, image.height);
    let write = |name: &str, pixels: &[u8]| {
        write_png(
            &odd.join(name),
            [width, height],
            png::BitDepth::Eight,
            pixels,
        );
    };
    write("8-bit.png", &image.pixels);
    write("black.png", &vec![0; image.pixels.len()]);
    let spot = (0..height).flat_map(|y| {
        (0..width).map(move |x| {
            let squared = (f64::from(x) - 250.0).powi(2) + (f64::from(y) - 150.0).powi(2);
            (200.0 * (-squared / 32.0).exp()) as u8
        })
    });
    write("one.png", &spot.collect::<Vec<u8>>());
    let wide = image
        .pixels
        .iter()
        .flat_map(|v| (u16::from(*v) * 257).to_be_bytes());
    let wide: Vec<u8> = wide.collect();
    write_png(
        &odd.join("16-bit.png"),
        [width, height],
        png::BitDepth::Sixteen,
        &wide,
    );
    // A right angle clockwise: columns from left to right are the rows from the lowest to the highest.
    let at = |x: u32, y: u32| image.pixels[(y * width + x) as usize];
    let pixels = (0..width).flat_map(|x| (0..height).rev().map(move |y| at(x, y)));
    let pixels: Vec<u8> = pixels.collect();
    for path in [odd.join("turned.png"), turned.join("turned.png")] {
        write_png(&path, [height, width], png::BitDepth::Eight, &pixels);
    }
    let intrinsics = std::fs::read_to_string(office.join("K.txt")).expect("intrinsics");
    std::fs::write(odd.join("K.txt"), &intrinsics).expect("intrinsics");
    let k: Vec<f64> = intrinsics
        .split_whitespace()
        .map(|v| v.parse().expect("a number"))
        .collect();
    let [fx, cx, fy, cy] = [k[0], k[2], k[4], k[5]];
    let cx_turned = f64::from(height) - 1.0 - cy;
    let text = format!("{fy} 0 {cx_turned}\n0 {fx} {cx}\n0 0 1\n");
    std::fs::write(turned.join("K.txt"), text).expect("intrinsics");

    let found = json(folder, &["localize", "office-map", "odd"], 0);
    let frame = |name: &str| -> &Value {
        let mut frames = found["frames"].as_array().expect("frames").iter();
        frames
            .find(|frame| frame["frame"] == name)
            .expect("a frame")
    };
    assert_eq!(found["localized"], 2, "{found}");
    for (name, words) in [
        ("black.png", "no place of the map"),
        ("one.png", "no place of the map"),
        ("turned.png", "has 360 × 540 px"),
    ] {
        let (frame, what) = (frame(name), format!("{name}: {found}"));
        assert_eq!(frame["localized"], false, "{what}");
        assert!(
            frame["reason"].as_str().is_some_and(|r| r.contains(words)),
            "{what}"
        );
    }
    let plain = &frame("8-bit.png")["pose"];
    assert_eq!(&frame("16-bit.png")["pose"], plain);
    let found = json(folder, &["localize", "office-map", "turned"], 0);
    let pose = &found["frames"][0]["pose"];
    let place = |pose: &Value| {
        let [x, y, z] = [0, 1, 2].map(|k| pose["translation_m"][k].as_f64().expect("metres"));
        Vector3::new(x, y, z)
    };
    let off_m = (place(pose) - place(plain)).norm();
    let turn = |pose: &Value| {
        let q = [0, 1, 2, 3].map(|k| pose["rotation_xyzw"][k].as_f64().expect("a number"));
        UnitQuaternion::from_quaternion(Quaternion::from(q))
    };
    let turned_deg = turn(pose).angle_to(&turn(plain)).to_degrees();
    // The map found another focal length than its images' list states, and takes only the camera that is stated alike to have it.
    assert!(found["localized"] == 1 && off_m < 0.05, "{off_m}: {found}");
    assert!((turned_deg - 90.0).abs() < 1.0, "{turned_deg}: {found}");
}

/// Focal lengths a twentieth too long: one of these images is localized by itself and refused among the others, and its drawing said
/// "localized".
fn drawings_say_what_was_answered(folder: &Path, office: &Path) {
    let long = folder.join("long");
    std::fs::create_dir(&long).expect("folder");
    for name in ["00008", "00133", "00196", "00259", "00323"].map(|n| format!("{n}.jpg")) {
        let image = office.join("images").join(&name);
        std::fs::copy(image, long.join(name)).expect("an image");
    }
    let intrinsics = std::fs::read_to_string(office.join("K.txt")).expect("intrinsics");
    let k = intrinsics.split_whitespace().enumerate().map(|(i, v)| {
        let value: f64 = v.parse().expect("a number");
        let factor = if matches!(i, 0 | 4) { 1.05 } else { 1.0 };
        (factor * value).to_string()
    });
    std::fs::write(long.join("K.txt"), k.collect::<Vec<_>>().join(" ")).expect("intrinsics");
    let mut arguments = vec!["localize", "office-map", "long", "--explain", "2"];
    arguments.extend(["--out-drawing", "long.svg", "--out-report", "long.html"]);
    let found = json(folder, &arguments, 4);
    let reason = found["frames"][2]["reason"].as_str().expect("a reason");
    assert!(reason.contains("of 5 images of the camera"), "{found}");
    for name in ["long.svg", "long.html"] {
        let text = std::fs::read_to_string(folder.join(name)).expect("a file");
        assert!(text.contains(&format!(">00196.jpg: {reason}: ")), "{name}");
        assert!(text.matches("stroke=\"lime\"").count() > 30, "{name}");
    }
}

/// Images without poses: a line for each, a drawing, and intrinsics of another size refused.
fn a_folder_of_images_is_localized(folder: &Path, office: &Path) {
    let photos = folder.join("photos");
    std::fs::create_dir(&photos).expect("folder");
    for name in ["00033.jpg", "00063.jpg"] {
        let image = office.join("images").join(name);
        std::fs::copy(image, photos.join(name)).expect("an image");
    }
    let elsewhere = office.with_file_name("sevenscenes_redkitchen");
    let elsewhere = elsewhere.join("frame-000000.color.jpg");
    std::fs::copy(elsewhere, photos.join("other.jpg")).expect("an image");
    let intrinsics = std::fs::read_to_string(office.join("K.txt")).expect("intrinsics");
    std::fs::write(photos.join("K.txt"), &intrinsics).expect("intrinsics");
    let arguments = ["localize", "office-map", "photos"];
    let written = ["--out", "a.csv", "--out-matches", "a_matches.csv"];
    let found = json(folder, &[&arguments[..], &written].concat(), 0);
    assert_eq!(found["localized"], 2, "{found}");
    let frames = found["frames"].as_array().expect("frames");
    for frame in &frames[..2] {
        let pose = &frame["pose"];
        assert!(pose["probability"].as_f64() > Some(0.99), "{frame}");
        assert!(pose["position_sigma_m"].as_f64() < Some(0.05), "{frame}");
        assert_eq!(pose["covariance"].as_array().map(Vec::len), Some(36));
    }
    // Another camera's image: of another size.
    let reason = frames[2]["reason"].as_str().expect("a reason");
    assert!(reason.contains("640 × 480"), "{reason}");
    let csv = std::fs::read_to_string(folder.join("a.csv")).expect("lines");
    let fields = |line: &str| line.split(',').count();
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!(lines.len(), 4);
    assert_eq!(fields(lines[1]), fields(lines[0]));
    // The camera of the map's own images is the one that was found with these.
    let rig = Rig::read(&folder.join("office-map/rig.toml")).expect("a rig");
    let [poses, matches] = ["a.csv", "a_matches.csv"].map(|name| folder.join(name));
    assert!(hold_against_poses(&poses, &matches, &rig) > 60);

    let drawing = ["--explain", "1", "--out-drawing", "a.svg"];
    json(folder, &[&arguments[..], &drawing].concat(), 0);
    let svg = std::fs::read_to_string(folder.join("a.svg")).expect("a drawing");
    assert!(svg.contains("00063.jpg") && svg.matches("stroke=\"lime\"").count() > 30);

    let twice: Vec<String> = intrinsics
        .split_whitespace()
        .map(|v| (2.0 * v.parse::<f64>().expect("a number")).to_string())
        .collect();
    std::fs::write(photos.join("K.txt"), twice.join(" ")).expect("intrinsics");
    refused(folder, &arguments, &["principal point", "540 × 360"]);
}

#[test]
fn figures_are_those_of_evo() {
    let test = "figures_are_those_of_evo";
    let Some(data) = recordings(test, "vision/trajectories_evo") else {
        return;
    };
    let file = |name: &str| data.join(format!("{name}.gz"));
    let judge = |estimate: &str, truth: &str, more: &[&str]| {
        let (estimate, truth) = (file(estimate), file(truth));
        let arguments = ["eval", text(&estimate), "--truth", text(&truth)];
        json(Path::new("."), &[&arguments, more].concat(), 0)
    };
    let digits = |value: &Value| format!("{:.6}", value.as_f64().expect("figure"));
    for (estimate, truth, align, rmse_m) in [
        ("KITTI_00_ORB.txt", "KITTI_00_gt.txt", "none", "7.790289"),
        ("KITTI_00_ORB.txt", "KITTI_00_gt.txt", "se3", "1.303450"),
        ("V102.txt", "V102_groundtruth.csv", "sim3", "0.083841"),
        (
            "fr2_desk_ORB.txt",
            "fr2_desk_groundtruth.txt",
            "se3",
            "0.008119",
        ),
    ] {
        let found = judge(estimate, truth, &["--align", align]);
        assert_eq!(
            digits(&found["ate_translation_m"]["rmse"]),
            rmse_m,
            "{estimate} {align}"
        );
    }
    let desk = judge(
        "fr2_desk_ORB.txt",
        "fr2_desk_groundtruth.txt",
        &["--rpe-delta", "1"],
    );
    assert_eq!(digits(&desk["rpe"][0]["translation_m"]["rmse"]), "0.011672");
    let by_frames = ["--rpe-delta", "100", "--rpe-unit", "frames"];
    let street = judge("KITTI_00_ORB.txt", "KITTI_00_gt.txt", &by_frames);
    assert_eq!(
        digits(&street["rpe"][0]["rotation_deg"]["rmse"]),
        "0.541330"
    );
}
