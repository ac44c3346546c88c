//! The joint graph of all sensors as an operator runs it: loops closed, and a transform that contradicts named.

use crate::answer::json;
use crate::pages;
use crate::refusal::refused;
use crate::rig_files::{apart, write_rig};
use lsfb_calib::TransformEdge;
use lsfb_geometry::{Matrix6, Rig, RigLidar, Se3, Vector6};
use lsfb_sim::SimConfig;

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
    let lidar = rig.lidar().expect("a LiDAR").rig_from_lidar;
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
    before.lidars.clear();
    write_rig(&folder.path().join("before.toml"), &before);
    arguments.extend(["--rig", "before.toml", "--out", "joined.toml"].map(str::to_owned));
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();

    let found = json(folder.path(), &arguments, 0);
    let arguments = [&arguments[..], &["--force"]].concat();
    assert_eq!(found["redundancy"], 18, "{found}");
    let joined = Rig::read(&folder.path().join("joined.toml")).expect("rig");
    let RigLidar { rig_from_lidar, .. } = joined.lidar().expect("placed");
    let [turn_deg, shift_mm] = apart(rig_from_lidar, &lidar);
    assert!(
        turn_deg < 0.06 && shift_mm < 3.0,
        "{turn_deg}° {shift_mm} mm"
    );

    // The images of two cameras were exchanged when the LiDAR was calibrated.
    let files = ["cam0-lidar.json", "cam1-lidar.json"].map(|name| folder.path().join(name));
    let [first, second] = files
        .each_ref()
        .map(|path| TransformEdge::read(path).expect("edge"));
    let exchanged = |edge: &TransformEdge, camera: &TransformEdge| TransformEdge {
        target: camera.target.clone(),
        ..edge.clone()
    };
    for (path, edge) in files
        .iter()
        .zip([exchanged(&second, &first), exchanged(&first, &second)])
    {
        std::fs::write(path, edge.to_json()).expect("a transform");
    }
    let found = json(folder.path(), &arguments, 4);
    let words = "cam0 and cam1 are swapped in the transforms to the LiDAR";
    let summary = found["summary"].as_str().expect("a summary");
    assert_eq!(found["verdict"], "fail", "{found}");
    assert!(
        summary.starts_with("FAIL: ") && summary.contains(words),
        "{found}"
    );
    let page = std::fs::read_to_string(folder.path().join("joined.html")).expect("a page");
    pages::are_whole(folder.path());
    assert!(page.contains(words), "{page}");
    for (path, edge) in files.iter().zip([first, second]) {
        std::fs::write(path, edge.to_json()).expect("a transform");
    }

    // A camera that the rig does not have was left out without a word.
    let stranger = TransformEdge {
        target: "cam9".to_owned(),
        ..TransformEdge::read(&files[0]).expect("edge")
    };
    std::fs::write(folder.path().join("cam9.json"), stranger.to_json()).expect("a transform");
    let alone = ["calib", "joint", "--transform", "cam9.json"];
    let into = ["--rig", "before.toml", "--out", "other.toml"];
    refused(
        folder.path(),
        &[&alone[..], &into].concat(),
        &["cam9.json: cam9 is neither imu nor lidar nor a camera of before.toml"],
    );

    // One camera was moved between its two calibrations.
    let path = folder.path().join("cam2-lidar.json");
    let mut moved = TransformEdge::read(&path).expect("edge");
    let bump = Vector6::new(0.0, 0.02, 0.0, 0.03, 0.0, 0.0);
    moved.target_from_source = moved.target_from_source * Se3::exp(&bump);
    std::fs::write(&path, moved.to_json()).expect("a transform");
    let found = json(folder.path(), &arguments, 4);
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
        page.contains("FAIL: ") && page.contains("cam2–lidar"),
        "{page}"
    );
}
