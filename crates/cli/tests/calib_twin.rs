//! Calibration without hardware: the board of the twin's calibration place, then the checks, as an operator runs them.

use std::path::Path;

use crate::answer::json;
use crate::pages;
use crate::process::lsfb;
use crate::rig_files::{apart, write_rig};
use lsfb_geometry::{Rig, Se3, Vector6};
use lsfb_rigs::walk::Walk;
use lsfb_sim::{Place, SimConfig};
use serde_json::Value;

/// A check of `lsfb calib verify`.
fn outcome<'a>(printed: &'a Value, name: &str) -> &'a str {
    let checks = printed["checks"].as_array().expect("checks");
    let check = checks.iter().find(|c| c["name"] == name);
    check.and_then(|c| c["outcome"].as_str()).unwrap_or("none")
}

/// A walk before the board, where the LiDAR is by it (`after.toml`), and how far off that is: degrees, millimetres.
fn placed_by_the_board(seed: u64, folder: &Path) -> (Walk, [f64; 2]) {
    let mut config = SimConfig {
        place: Place::Calibration,
        seed,
        ..SimConfig::default()
    };
    config.scan.duration_s = 60.0;
    let walk = Walk::simulate(&config, &["cam0"], 20.0);
    walk.write(&folder.join("scan.mcap"), 0.0);
    // The rig as it is before: nobody knows where the LiDAR is.
    let mut before = walk.rig.clone();
    before.lidars.clear();
    write_rig(&folder.join("before.toml"), &before);

    let arguments = [
        "calib",
        "lidar-camera",
        "--april-grid",
        "6,6,0.088,0.3",
        "--plate-m",
        "0.836,0.836",
        "--camera",
        "cam0",
        "--recording",
        "scan.mcap",
        "--rig",
        "before.toml",
        "--out",
        "after.toml",
    ];
    let found = json(folder, &arguments, 0);
    let after = Rig::read(&folder.join("after.toml")).expect("rig");
    let off = apart(
        &after.lidar().expect("placed").rig_from_lidar,
        &walk.rig.lidar().expect("a LiDAR").rig_from_lidar,
    );
    let largest = |from: usize| {
        let sigmas = (from..from + 3).filter_map(|k| found["sigma"][k].as_f64());
        sigmas.fold(0.0, f64::max)
    };
    let sigmas = [largest(0).to_degrees(), 1e3 * largest(3)];
    let is_within = off
        .iter()
        .zip(sigmas)
        .all(|(off, sigma)| *off < 3.0 * sigma);
    assert!(
        is_within && sigmas[0] < 0.1 && sigmas[1] < 4.0,
        "{off:?}: {found}"
    );
    (walk, off)
}

#[test]
fn the_board_of_the_twin_places_the_lidar_and_the_rig_is_verified() {
    let (folder, other) = (tempfile::tempdir(), tempfile::tempdir());
    let (folder, other) = (folder.expect("folder"), other.expect("folder"));
    let (walk, [turn_deg, shift_mm]) = placed_by_the_board(1, folder.path());
    let (_, [other_deg, other_mm]) = placed_by_the_board(2, other.path());
    let rms = |a: f64, b: f64| (0.5 * (a * a + b * b)).sqrt();
    assert!(rms(turn_deg, other_deg) < 0.12, "{turn_deg}° {other_deg}°");
    assert!(rms(shift_mm, other_mm) < 5.0, "{shift_mm} mm {other_mm} mm");
    let page = std::fs::read_to_string(folder.path().join("after.html")).expect("a page");
    assert!(page.contains("held-out") && page.contains("<svg"), "{page}");

    let checked = json(
        folder.path(),
        &["calib", "verify", "scan.mcap", "--rig", "after.toml"],
        0,
    );
    assert_eq!(outcome(&checked, "cam0 time offset"), "PASS", "{checked}");
    pages::are_whole(folder.path());
    assert_eq!(
        outcome(&checked, "cam0 rotation to the IMU"),
        "PASS",
        "{checked}"
    );
    let picture = folder.path().join("scan.verify.cam0.png");
    // What was said stands, and is said again, until one of the files that were written is another.
    let verify = ["calib", "verify", "scan.mcap", "--rig", "after.toml"];
    let drawn = std::fs::metadata(&picture).expect("a picture");
    assert_eq!(json(folder.path(), &verify, 0), checked);
    let again = std::fs::metadata(&picture).expect("a picture");
    assert_eq!(again.modified().ok(), drawn.modified().ok());
    std::fs::write(&picture, "another").expect("a picture");
    let output = lsfb(folder.path(), &verify);
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(text.contains("scan.verify.html: exists already"), "{text}");
    assert_eq!(output.status.code(), Some(1), "{text}");

    // The images as if their clock were 5 ms off either way, the camera as if it had been turned by 2°.
    for wrong_s in [0.005, -0.005] {
        let mut wrong = walk.rig.clone();
        let camera = wrong.cameras.get_mut("cam0").expect("cam0");
        camera.timing.rig_from_camera_s = wrong_s;
        camera.rig_from_camera =
            camera.rig_from_camera * Se3::exp(&Vector6::new(0.0, 0.035, 0.0, 0.0, 0.0, 0.0));
        write_rig(&folder.path().join("wrong.toml"), &wrong);
        let checked = json(
            folder.path(),
            &[
                "calib",
                "verify",
                "scan.mcap",
                "--rig",
                "wrong.toml",
                "--force",
            ],
            4,
        );
        for name in ["cam0 time offset", "cam0 rotation to the IMU"] {
            assert_eq!(outcome(&checked, name), "FAIL", "{checked}");
        }
    }
}
