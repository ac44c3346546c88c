//! The documented commands on recordings made by others (`LSFB_TEST_DATA`).

use std::path::Path;

use crate::answer::json;
use crate::process::lsfb;
use crate::refusal::refused;
use lsfb_geometry::Vector3;
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
    let found = json(folder, &[&arguments[..], &["--out", "a.csv"]].concat(), 0);
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
