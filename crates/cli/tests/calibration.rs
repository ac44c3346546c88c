//! `lsfb calib camera` and `camera-imu`: what they write, what they refuse, and that one takes what the other gives.

use crate::answer::json;
use crate::board_images::{BASELINE_M, CHECKERBOARD, blind, write_stereo};
use crate::pages;
use crate::process::lsfb;
use crate::refusal::{contents, found_unfit, refused};
use lsfb_calib::TransformEdge;
use lsfb_geometry::Rig;
use lsfb_recording::{Writer, WriterConfig};
use lsfb_types::{Stamped, Timestamp};

const CAMERA: [&str; 12] = [
    "calib",
    "camera",
    "--checkerboard",
    CHECKERBOARD,
    "--model",
    "pinhole-radtan",
    "--camera",
    "left=left",
    "--camera",
    "right=right",
    "--out",
    "rig.toml",
];

#[test]
fn a_stereo_pair_is_calibrated_and_its_baseline_joins() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    write_stereo(path, 0.0);
    let report = json(path, &CAMERA, 0);
    assert_ne!(report["verdict"], "fail", "{}", report["verdict"]);
    assert_eq!(report["transforms"][0], "rig.right-left.json");
    let edge = TransformEdge::read(&path.join("rig.right-left.json")).expect("transform");
    let baseline_m = edge.target_from_source.translation.norm();
    assert!((baseline_m - BASELINE_M).abs() < 3e-4, "{baseline_m}");
    assert!(edge.covariance.is_some());
    let joint = [
        "calib",
        "joint",
        "--rig",
        "rig.toml",
        "--transform",
        "rig.right-left.json",
        "--out",
        "joined.toml",
    ];
    json(path, &joint, 0);
    assert_eq!(
        Rig::read(&path.join("joined.toml"))
            .expect("rig")
            .cameras
            .len(),
        2
    );

    // Named the wrong way round.
    let mut swapped = CAMERA;
    (swapped[7], swapped[9]) = ("left=right", "right=left");
    let report = json(path, &[&swapped[..], &["--force"]].concat(), 0);
    assert_eq!(report["verdict"], "warn");
    assert!(
        report
            .to_string()
            .contains("their views or their names are swapped")
    );
}

#[test]
fn a_board_that_is_not_what_was_said_gives_a_page_and_no_rig() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    write_stereo(path, 0.008);
    let output = lsfb(path, &CAMERA);
    let errors = String::from_utf8_lossy(&output.stderr);
    let text = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(4), "{text} {errors}");
    assert!(
        errors.contains("error: rig.toml is not written"),
        "{errors}"
    );
    assert!(text.contains("FAIL: "));
    assert!(!path.join("rig.toml").exists());
    let page = std::fs::read_to_string(path.join("rig.html")).expect("page");
    pages::are_whole(path);
    assert!(page.contains("FAIL: ") && page.contains("reprojection error is"));

    let mut other = CAMERA;
    other[3] = "8,6,0.03";
    let words = ["left", "of 9 images (at least 4)", "8 × 6"];
    let found = found_unfit(path, &other, &words);
    assert_eq!(found["code"], "target-not-seen", "{found}");
    assert_eq!(found["limit"]["at_least"], 4.0, "{found}");
    assert!(found["value"].as_f64().expect("a number") < 4.0, "{found}");
    blind(path, "right");
    found_unfit(path, &CAMERA, &["right", "found in 0 of 9 images"]);
}

/// Numbers that are right in other units only, before anything is read.
#[test]
fn lengths_in_other_units_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let lidar = [
        "calib",
        "lidar-camera",
        "--checkerboard",
        "9,6,0.03",
        "--camera",
        "a=a",
    ];
    let rest = ["--clouds", "c", "--rig", "r.toml", "--out", "o.toml"];
    let plate = |size| [&lidar[..], &rest, &["--plate-m", size]].concat();
    let squares = |board| {
        [
            "calib",
            "target",
            "--checkerboard",
            board,
            "--out",
            "board.pdf",
        ]
    };
    let page = [
        "calib",
        "target",
        "--checkerboard",
        "9,6,0.02",
        "--page-m",
        "297,210",
        "--out",
        "b.pdf",
    ];
    for (arguments, words) in [
        (
            squares("9,6,25").to_vec(),
            "a square of 25 m: lengths are in metres; for 25 mm write 0.025",
        ),
        (squares("9,6,0.00003").to_vec(), "a square of 0.00003 m"),
        (
            plate("833,833"),
            "833 m: lengths are in metres; for 833 mm write 0.833",
        ),
        (
            page.to_vec(),
            "297 m: lengths are in metres; for 297 mm write 0.297",
        ),
    ] {
        let output = lsfb(folder.path(), &arguments);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {text}");
        assert!(text.contains(words), "{arguments:?}: {text}");
    }
}

#[test]
fn images_that_were_named_wrongly_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    write_stereo(path, 0.0);
    let cameras = |left, right| {
        let mut arguments = CAMERA;
        (arguments[7], arguments[9]) = (left, right);
        arguments
    };
    let twice = cameras("left=left", "right=left");
    let words = ["left and right: they show the same images"];
    found_unfit(path, &twice, &words);
    std::fs::create_dir(path.join("empty")).expect("folder");
    refused(
        path,
        &cameras("left=left", "right=empty"),
        &["empty: no image in this folder"],
    );
    let nobody = cameras("left=left/x*", "right=right");
    refused(path, &nobody, &["no name of its 9 images begins with x"]);

    // Each image of the right camera under the number of the one after it.
    std::fs::create_dir(path.join("late")).expect("folder");
    for k in 0..8 {
        let from = path.join("right").join(format!("{k}.png"));
        std::fs::copy(from, path.join("late").join(format!("{}.png", k + 1))).expect("image");
    }
    found_unfit(
        path,
        &cameras("left=left", "right=late"),
        &["their pairs are shifted", "took one instant before"],
    );
}

/// The same images as files and as messages of topics give the same rig.
#[test]
fn cameras_of_topics_are_calibrated_as_those_of_folders() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    write_stereo(path, 0.0);
    json(path, &CAMERA, 0);
    let mut writer =
        Writer::create(&path.join("walk.mcap"), &WriterConfig::default()).expect("a file");
    for k in 0..9 {
        for name in ["left", "right"] {
            let image = lsfb_perception::image::read(&path.join(name).join(format!("{k}.png")))
                .expect("image");
            let time = Timestamp::from_nanos(k * 100_000_000);
            let stamped = Stamped {
                time,
                arrival: time,
                device_ticks: 0,
                sample: image,
            };
            writer.write_image(name, &stamped).expect("written");
        }
    }
    writer.finish().expect("a file");
    let mut topics = CAMERA;
    (topics[7], topics[9]) = ("left=/left/image", "right=/right/image");
    topics[11] = "bag.toml";
    let recording = ["--recording", "walk.mcap"];
    json(path, &[&topics[..], &recording].concat(), 0);
    let [files, bag] =
        ["rig.toml", "bag.toml"].map(|name| Rig::read(&path.join(name)).expect(name));
    assert_eq!(files.cameras, bag.cameras);
    topics[7] = "left=/gone";
    refused(path, &[&topics[..], &recording].concat(), &["/gone"]);
}

#[test]
fn a_failed_run_leaves_nothing_older_that_looks_new() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    write_stereo(path, 0.0);
    json(path, &CAMERA, 0);
    let results = ["rig.toml", "rig.html", "rig.right-left.json"];
    let before = results.map(|name| std::fs::read(path.join(name)).expect("a result"));
    // Nor is anything replaced unasked, by whichever of the files that a run writes.
    for gone in ["none", "rig.toml"] {
        let _ = std::fs::remove_file(path.join(gone));
        let there = contents(path);
        let output = lsfb(path, &CAMERA);
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(text.contains("--force"), "{text}");
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert_eq!(contents(path), there, "without {gone}");
    }
    std::fs::write(path.join("rig.toml"), &before[0]).expect("rig");
    blind(path, "right");
    found_unfit(path, &CAMERA, &["right", "found in 0 of 9 images"]);
    for (name, before) in results.iter().zip(&before) {
        assert!(!path.join(name).exists(), "{name}");
        let old = std::fs::read(path.join(format!("{name}.old"))).expect("the older one");
        assert_eq!(&old, before, "{name}");
    }
    // A rig that is read as well is no result of this run.
    std::fs::write(path.join("rig.toml"), &before[0]).expect("rig");
    found_unfit(
        path,
        &[&CAMERA[..], &["--rig", "rig.toml"]].concat(),
        &["right"],
    );
    assert_eq!(
        std::fs::read(path.join("rig.toml")).expect("rig"),
        before[0]
    );
}

/// Half of TUM VI's calibration sequence, from images to a joint rig.
#[test]
fn camera_then_camera_imu_then_joint() {
    let test = "camera_then_camera_imu_then_joint";
    let Some(data) = lsfb_tests::recordings(test, "vision/tumvi_calib_imu1/mav0") else {
        return;
    };
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    let of = |camera: &str| format!("{camera}={}/{camera}/data/152052796*", data.display());
    let [cam0, cam1] = ["cam0", "cam1"].map(of);
    let imu = data.join("imu0/data.csv").display().to_string();
    let both = ["--camera", &cam0, "--camera", &cam1];
    let camera = [
        "calib",
        "camera",
        "--april-grid",
        "6,6,0.088,0.3",
        "--out",
        "lens.toml",
    ];
    let report = json(path, &[&camera[..], &both].concat(), 0);
    assert_ne!(report["verdict"], "fail");

    let mut rig = Rig::read(&path.join("lens.toml")).expect("rig");
    // As the data set states it.
    rig.set_imu_noise(lsfb_geometry::ImuNoiseModel {
        gyro_noise_density: 0.00016,
        accel_noise_density: 0.0028,
        gyro_bias_walk: 2.2e-5,
        accel_bias_walk: 0.00086,
    });
    std::fs::write(path.join("lens.toml"), rig.to_toml()).expect("rig");
    let camera_imu = ["calib", "camera-imu", "--april-grid", "6,6,0.088,0.3"];
    let files = ["--rig", "lens.toml", "--imu", &imu, "--out", "rig.toml"];
    let report = json(path, &[&camera_imu[..], &files, &both].concat(), 0);
    assert_ne!(report["verdict"], "fail");
    for (k, name) in ["rig.cam0-imu.json", "rig.cam1-imu.json"]
        .iter()
        .enumerate()
    {
        assert_eq!(report["transforms"][k], *name);
        let edge = TransformEdge::read(&path.join(name)).expect("transform");
        assert_eq!(edge.target, "imu");
    }
    let mut joint = vec![
        "calib",
        "joint",
        "--rig",
        "rig.toml",
        "--out",
        "joined.toml",
    ];
    for name in [
        "rig.cam0-imu.json",
        "rig.cam1-imu.json",
        "lens.cam1-cam0.json",
    ] {
        joint.extend(["--transform", name]);
    }
    let joined = json(path, &joint, 0);
    let edges = joined["edges"].as_array().expect("edges");
    assert!(edges.iter().all(|e| e["measured"] == true), "{joined}");

    // The gaps between its tags as another board has them.
    let wrong = ["calib", "camera-imu", "--april-grid", "6,6,0.088,0.45"];
    let files = ["--rig", "lens.toml", "--imu", &imu, "--out", "wrong.toml"];
    let output = lsfb(path, &[&wrong[..], &files, &both].concat());
    let text = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(4), "{text}");
    assert!(
        text.contains("gaps of 0.") || text.contains("geometry is wrong"),
        "{text}"
    );
    assert!(!path.join("wrong.toml").exists());
}
