//! Calibration without hardware: the board of the twin's calibration place, then the checks, and the joint graph, as an
//! operator runs them.

mod process;
#[path = "../../../calib/tests/simulated_walk/mod.rs"]
mod simulated_walk;

use std::path::Path;
use std::process::Output;

use lsfb_calib::TransformEdge;
use lsfb_geometry::{Matrix6, Rig, RigLidar, Se3, Vector6};
use lsfb_sim::{Place, SimConfig};
use process::lsfb;
use serde_json::Value;
use simulated_walk::Walk;

/// Runs a command and takes its JSON, whatever its exit code.
fn json(folder: &Path, arguments: &[&str]) -> (Option<i32>, Value) {
    let output: Output = lsfb(folder, &[arguments, &["--json"]].concat());
    let errors = String::from_utf8_lossy(&output.stderr);
    let value = serde_json::from_slice(&output.stdout);
    let value = value.unwrap_or_else(|_| panic!("{arguments:?}: {errors}"));
    (output.status.code(), value)
}

/// Degrees and millimetres between two poses.
fn apart(a: &Se3, b: &Se3) -> [f64; 2] {
    let off = (a.inverse() * *b).log();
    [
        off.fixed_rows::<3>(0).norm().to_degrees(),
        off.fixed_rows::<3>(3).norm() * 1e3,
    ]
}

fn write_rig(path: &Path, rig: &Rig) {
    std::fs::write(path, rig.to_toml()).expect("rig");
}

/// A check of `lsfb calib verify`.
fn outcome<'a>(printed: &'a Value, name: &str) -> &'a str {
    let checks = printed["checks"].as_array().expect("checks");
    let check = checks.iter().find(|c| c["name"] == name);
    check.and_then(|c| c["outcome"].as_str()).unwrap_or("none")
}

#[test]
fn the_board_of_the_twin_places_the_lidar_and_the_rig_is_verified() {
    let folder = tempfile::tempdir().expect("folder");
    let mut config = SimConfig {
        place: Place::Calibration,
        ..SimConfig::default()
    };
    config.scan.duration_s = 60.0;
    let walk = Walk::simulate(&config, &["cam0"], 20.0);
    walk.write(&folder.path().join("scan.mcap"), 0.0);
    // The rig as it is before: nobody knows where the LiDAR is.
    let mut before = walk.rig.clone();
    before.lidar = None;
    write_rig(&folder.path().join("before.toml"), &before);

    let arguments = [
        "calib",
        "lidar-camera",
        "--april-grid",
        "6,6,0.088,0.3",
        "--plate",
        "833,833",
        "--camera",
        "cam0",
        "--recording",
        "scan.mcap",
        "--rig",
        "before.toml",
        "--out",
        "after.toml",
    ];
    let (code, found) = json(folder.path(), &arguments);
    assert_eq!(code, Some(0), "{found}");
    let after = Rig::read(&folder.path().join("after.toml")).expect("rig");
    let [turn_deg, shift_mm] = apart(
        &after.lidar.expect("placed").rig_from_lidar,
        &walk.rig.lidar.as_ref().expect("a LiDAR").rig_from_lidar,
    );
    assert!(
        turn_deg < 0.15 && shift_mm < 8.0,
        "{turn_deg}° {shift_mm} mm: {found}"
    );
    let page = std::fs::read_to_string(folder.path().join("after.html")).expect("a page");
    assert!(
        page.contains("held back") && page.contains("<svg"),
        "{page}"
    );

    let (code, checked) = json(
        folder.path(),
        &["calib", "verify", "scan.mcap", "--rig", "after.toml"],
    );
    assert_eq!(code, Some(0), "{checked}");
    assert_eq!(outcome(&checked, "cam0 time offset"), "PASS", "{checked}");
    assert_eq!(
        outcome(&checked, "cam0 rotation to the IMU"),
        "PASS",
        "{checked}"
    );
    assert!(folder.path().join("scan.verify.cam0.png").exists());

    // The images as if their clock were 5 ms off either way, the camera as if it had been turned by 2°.
    for wrong_s in [0.005, -0.005] {
        let mut wrong = walk.rig.clone();
        let camera = wrong.cameras.get_mut("cam0").expect("cam0");
        camera.timing.rig_from_camera_s = wrong_s;
        camera.rig_from_camera =
            camera.rig_from_camera * Se3::exp(&Vector6::new(0.0, 0.035, 0.0, 0.0, 0.0, 0.0));
        write_rig(&folder.path().join("wrong.toml"), &wrong);
        let (code, checked) = json(
            folder.path(),
            &["calib", "verify", "scan.mcap", "--rig", "wrong.toml"],
        );
        assert_eq!(code, Some(1), "{checked}");
        for name in ["cam0 time offset", "cam0 rotation to the IMU"] {
            assert_eq!(outcome(&checked, name), "FAIL", "{checked}");
        }
    }
}

/// A covariance as a good calibration has it: 0.06° and 3 mm.
fn good() -> Matrix6<f64> {
    Matrix6::from_diagonal(&Vector6::new(1e-6, 1e-6, 1e-6, 9e-6, 9e-6, 9e-6))
}

#[test]
fn a_loop_is_closed_and_a_transform_that_contradicts_is_named() {
    let folder = tempfile::tempdir().expect("folder");
    let rig = lsfb_sim::Simulation::new(&SimConfig::tiny(), &lsfb_types::no_progress)
        .expect("simulation")
        .scan()
        .rig()
        .clone();
    let lidar = rig.lidar.as_ref().expect("a LiDAR").rig_from_lidar;
    let mut arguments = vec!["calib".to_owned(), "joint".to_owned()];
    let mut add = |name: String, edge: &TransformEdge| {
        std::fs::write(folder.path().join(&name), edge.to_json()).expect("a transform");
        arguments.extend(["--transform".to_owned(), name]);
    };
    for (k, (name, camera)) in rig.cameras.iter().enumerate() {
        let small = |a: f64, b: f64| Vector6::new(a, -b, a, b, a, -b) * (k as f64 - 1.4);
        let edge = |target: &str, source: &str, truth: Se3, off: Vector6<f64>| TransformEdge {
            target: target.to_owned(),
            source: source.to_owned(),
            target_from_source: truth * Se3::exp(&off),
            covariance: Some(good()),
        };
        let pose = camera.rig_from_camera;
        add(
            format!("{name}-imu.json"),
            &edge("imu", name, pose, small(3e-4, 1e-3)),
        );
        let from_lidar = pose.inverse() * lidar;
        add(
            format!("{name}-lidar.json"),
            &edge(name, "lidar", from_lidar, small(-4e-4, 8e-4)),
        );
    }
    let mut before = rig.clone();
    before.lidar = None;
    write_rig(&folder.path().join("before.toml"), &before);
    arguments.extend(["--rig", "before.toml", "--out", "joined.toml"].map(str::to_owned));
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();

    let (code, found) = json(folder.path(), &arguments);
    assert_eq!(code, Some(0), "{found}");
    assert_eq!(found["redundancy"], 18, "{found}");
    let joined = Rig::read(&folder.path().join("joined.toml")).expect("rig");
    let RigLidar { rig_from_lidar, .. } = joined.lidar.expect("placed");
    let [turn_deg, shift_mm] = apart(&rig_from_lidar, &lidar);
    assert!(
        turn_deg < 0.06 && shift_mm < 3.0,
        "{turn_deg}° {shift_mm} mm"
    );

    // One camera was moved between its two calibrations.
    let path = folder.path().join("cam2-lidar.json");
    let mut moved = TransformEdge::read(&path).expect("edge");
    let bump = Vector6::new(0.0, 0.02, 0.0, 0.03, 0.0, 0.0);
    moved.target_from_source = moved.target_from_source * Se3::exp(&bump);
    std::fs::write(&path, moved.to_json()).expect("a transform");
    let (code, found) = json(folder.path(), &arguments);
    assert_eq!(code, Some(1), "{found}");
    let named: Vec<&str> = found["edges"]
        .as_array()
        .expect("edges")
        .iter()
        .filter(|e| e["outlier"] == true)
        .filter_map(|e| e["target"].as_str())
        .collect();
    assert_eq!(named, ["cam2", "imu"], "{found}");
    let page = std::fs::read_to_string(folder.path().join("joined.html")).expect("a page");
    assert!(
        page.contains("FAIL. ") && page.contains("cam2–lidar"),
        "{page}"
    );
}
