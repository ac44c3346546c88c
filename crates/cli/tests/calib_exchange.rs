//! `lsfb calib import` and `export`, both ways: rigs of the simulator, and files of others.

use std::path::Path;

use crate::answer::json;
use crate::refusal::{badly_asked, refused};
use lsfb_geometry::{Camera, Rig, Se3};
use lsfb_sim::{SimConfig, rigs};

/// What is written and read again, at most.
const SAME: f64 = 1e-9;

const PROGRAMS: [(&str, &[&str]); 4] = [
    ("kalibr", &["camchain-imucam.yaml", "imu.yaml"]),
    ("ros", &["cam0.yaml", "cam1.yaml", "cam2.yaml", "cam3.yaml"]),
    ("colmap", &["cameras.txt", "rig_config.json"]),
    ("basalt", &["calibration.json"]),
];

/// The simulator's backpack, its cameras late as real ones are.
fn backpack(offsets_s: [f64; 4]) -> Rig {
    let mut rig = rigs::backpack(&SimConfig::default());
    for (mounted, offset_s) in rig.cameras.values_mut().zip(offsets_s) {
        mounted.timing.rig_from_camera_s = offset_s;
    }
    rig
}

fn notes(printed: &serde_json::Value) -> Vec<String> {
    let findings = printed["findings"].as_array().expect("findings");
    let warned = findings.iter().filter(|f| f["verdict"] == "warn");
    let text = |f: &serde_json::Value| f["what"].as_str().expect("text").to_owned();
    warned.map(text).collect()
}

fn assert_same_camera(name: &str, a: &Camera, b: &Camera) {
    assert_eq!(
        (a.width, a.height, a.lens.model()),
        (b.width, b.height, b.lens.model()),
        "{name}"
    );
    let numbers = |c: &Camera| [&c.focal_px()[..], &c.principal_px(), c.lens.distortion()].concat();
    for (a, b) in numbers(a).into_iter().zip(numbers(b)) {
        assert!((a - b).abs() < SAME, "{name}: {a} {b}");
    }
}

fn assert_same_pose(name: &str, a: &Se3, b: &Se3) {
    let moved = (a.inverse() * *b).log().norm();
    assert!(moved < SAME, "{name}: {moved}");
}

fn assert_same_rig(program: &str, a: &Rig, b: &Rig) {
    assert_eq!(a.cameras.len(), b.cameras.len(), "{program}");
    for ((name, a), (other, b)) in a.cameras.iter().zip(&b.cameras) {
        assert_eq!(name, other);
        let name = format!("{program} {name}");
        assert_same_camera(&name, &a.camera, &b.camera);
        assert_same_pose(&name, &a.rig_from_camera, &b.rig_from_camera);
        let late_s = a.timing.rig_from_camera_s - b.timing.rig_from_camera_s;
        assert!(late_s.abs() < SAME, "{name}: {late_s}");
    }
    let noises = |rig: &Rig| {
        rig.imu_noise().map(|i| {
            [
                i.gyro_noise_density,
                i.accel_noise_density,
                i.gyro_bias_walk,
                i.accel_bias_walk,
            ]
        })
    };
    match (noises(a), noises(b)) {
        (Some(a), Some(b)) => {
            for (a, b) in a.into_iter().zip(b) {
                assert!((a / b - 1.0).abs() < SAME, "{program}: {a} {b}");
            }
        }
        (a, b) => assert_eq!(a.is_some(), b.is_some(), "{program}"),
    }
}

fn read(folder: &Path, name: &str) -> Rig {
    Rig::read(&folder.join(name)).expect("a rig")
}

#[test]
fn the_simulators_rig_comes_back_from_every_format() {
    let folder = tempfile::tempdir().expect("folder");
    let rig = backpack([1.9e-3; 4]);
    std::fs::write(folder.path().join("rig.toml"), rig.to_toml()).expect("file");
    for (program, files) in PROGRAMS {
        let written = json(
            folder.path(),
            &["calib", "export", program, "rig.toml", "--out", program],
            0,
        );
        let paths: Vec<String> = files.iter().map(|f| format!("{program}/{f}")).collect();
        assert_eq!(written["files"], serde_json::json!(paths), "{program}");
        // What it cannot hold is said.
        let expected: &[&str] = match program {
            "kalibr" => &["LiDAR", "the calibration date"],
            "ros" => &["poses and time offsets", "LiDAR", "the calibration date"],
            "colmap" => &["the pose in the IMU", "LiDAR", "the calibration date"],
            _ => &["its odometry does not", "LiDAR", "the calibration date"],
        };
        let said = notes(&written);
        assert_eq!(said.len(), expected.len(), "{program}: {said:?}");
        for (said, expected) in said.iter().zip(expected) {
            assert!(said.contains(expected), "{program}: {said}");
        }

        let mut import = vec!["calib", "import", program];
        import.extend(paths.iter().map(String::as_str));
        let alone = [&import[..], &["--out", "alone.toml", "--force"]].concat();
        let said = notes(&json(folder.path(), &alone, 0));
        match program {
            "ros" => assert!(
                matches!(&said[..], [n] if n.contains("CameraInfo has no poses")),
                "{said:?}"
            ),
            _ => assert!(said.is_empty(), "{program}: {said:?}"),
        }
        let found = read(folder.path(), "alone.toml");
        for (name, mounted) in &rig.cameras {
            assert_same_camera(name, &mounted.camera, &found.cameras[name].camera);
        }
        match program {
            "kalibr" | "basalt" => {
                let held = Rig {
                    lidars: Default::default(),
                    ..rig.clone()
                };
                assert_same_rig(program, &held, &found);
            }
            "colmap" => {
                let first = rig.cameras["cam0"].rig_from_camera;
                for (name, found) in &found.cameras {
                    let expected = first.inverse() * rig.cameras[name].rig_from_camera;
                    assert_same_pose(name, &expected, &found.rig_from_camera);
                }
            }
            _ => assert!(found.imus.is_empty() && found.lidars.is_empty()),
        }

        // Into a rig that has the rest: everything is as it was, but nobody knows since when.
        let into = ["--rig", "rig.toml", "--out", "into.toml", "--force"];
        let into = [&import[..], &into].concat();
        json(folder.path(), &into, 0);
        let again = read(folder.path(), "into.toml");
        assert_same_rig(program, &rig, &again);
        assert_eq!(again.lidars, rig.lidars, "{program}");
        assert_eq!(again.calibrated_unix_s, None);
    }
}

#[test]
fn what_a_format_cannot_hold_is_said_with_its_size() {
    let folder = tempfile::tempdir().expect("folder");
    let mut rig = backpack([1e-3, 1e-3, 1e-3, 2e-3]);
    // A phone's lens, and a camera of another name.
    let phone = rigs::walker(&SimConfig::for_place(
        lsfb_sim::Place::ENVIRONMENTS[0],
        lsfb_sim::Device::Iphone,
    ));
    let mut lens = phone.cameras["cam0"].clone();
    lens.timing.readout_s = 0.02;
    rig.cameras.insert("right".to_owned(), lens);
    std::fs::write(folder.path().join("rig.toml"), rig.to_toml()).expect("file");
    let said = |program: &str| {
        let arguments = ["calib", "export", program, "rig.toml", "--out", program];
        notes(&json(folder.path(), &arguments, 0)).join("\n")
    };
    let kalibr = said("kalibr");
    for words in [
        "right: Kalibr's radtan has no k3 (0.041)",
        "right is cam4",
        "readout times",
    ] {
        assert!(kalibr.contains(words), "{words}: {kalibr}");
    }
    let basalt = said("basalt");
    assert!(
        basalt.contains("a single time offset: the mean is written")
            && basalt.contains("µs")
            && basalt.contains("right is cam4"),
        "{basalt}"
    );
}

#[test]
fn files_that_are_none_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let rig = backpack([0.0; 4]);
    std::fs::write(folder.path().join("rig.toml"), rig.to_toml()).expect("file");
    for (program, _) in PROGRAMS {
        refused(
            folder.path(),
            &["calib", "import", program, "rig.toml", "--out", "new.toml"],
            &["rig.toml"],
        );
        refused(
            folder.path(),
            &["calib", "import", program, "gone", "--out", "new.toml"],
            &["gone"],
        );
    }
    badly_asked(
        folder.path(),
        &["calib", "import", "basalt", "a", "b", "--out", "new.toml"],
        &["2 files, but at most 1"],
    );
}

/// They ended with 0, and Kalibr's file had a rate of NaN.
#[test]
fn rates_that_no_imu_has_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let rig = backpack([0.0; 4]);
    std::fs::write(folder.path().join("rig.toml"), rig.to_toml()).expect("file");
    let export = ["calib", "export", "kalibr", "rig.toml", "--out", "out"];
    for rate in ["0", "-5", "nan"] {
        let rate = format!("--imu-rate-hz={rate}");
        let arguments = [&export[..], &[&rate]].concat();
        badly_asked(
            folder.path(),
            &arguments,
            &["--imu-rate-hz is", "1 to 100000"],
        );
    }
}

fn data(test: &str, name: &str) -> Option<String> {
    Some(lsfb_tests::recordings(test, name)?.display().to_string())
}

#[test]
fn the_noise_of_an_imu_alone_goes_into_a_rig() {
    let folder = tempfile::tempdir().expect("folder");
    let rig = backpack([1.9e-3; 4]);
    let without = Rig {
        imus: Default::default(),
        ..rig.clone()
    };
    std::fs::write(folder.path().join("rig.toml"), rig.to_toml()).expect("file");
    std::fs::write(folder.path().join("bare.toml"), without.to_toml()).expect("file");
    let export = ["calib", "export", "kalibr", "rig.toml", "--out", "out"];
    json(folder.path(), &export, 0);
    let import = ["calib", "import", "kalibr", "out/imu.yaml"];
    let into = ["--rig", "bare.toml", "--out", "whole.toml"];
    json(folder.path(), &[&import[..], &into].concat(), 0);
    // The lenses are as old as they were.
    assert_eq!(read(folder.path(), "whole.toml"), rig);

    refused(
        folder.path(),
        &[&import[..], &["--out", "alone.toml"]].concat(),
        &["out/imu.yaml", "--rig"],
    );
}

/// A chain without an IMU says how cameras stand to each other: put into a rig, its first camera was moved to the IMU once, and all
/// clocks set to zero.
#[test]
fn cameras_that_are_put_into_a_rig_stay_where_it_has_them() {
    let folder = tempfile::tempdir().expect("folder");
    let rig = backpack([1.9e-3; 4]);
    std::fs::write(folder.path().join("rig.toml"), rig.to_toml()).expect("file");
    let export = ["calib", "export", "kalibr", "rig.toml", "--out", "out"];
    json(folder.path(), &export, 0);
    let chain = std::fs::read_to_string(folder.path().join("out/camchain-imucam.yaml"));
    let chain = chain.expect("a chain").replace("T_cam_imu", "T_unknown");
    std::fs::write(folder.path().join("chain.yaml"), &chain).expect("file");
    let import = ["calib", "import", "kalibr", "chain.yaml", "--rig"];
    let into = [&import[..], &["rig.toml", "--out", "into.toml"]].concat();
    json(folder.path(), &into, 0);
    assert_same_rig("kalibr", &rig, &read(folder.path(), "into.toml"));

    // No camera of the rig is in it: nothing says where these are.
    let mut other = rig.clone();
    other.cameras = [("left".to_owned(), rig.cameras["cam0"].clone())].into();
    std::fs::write(folder.path().join("other.toml"), other.to_toml()).expect("file");
    refused(
        folder.path(),
        &[&import[..], &["other.toml", "--out", "new.toml"]].concat(),
        &["the pose of cam0 on the rig is unknown; the rig has left"],
    );
}

/// Files that Kalibr, Basalt and a ROS driver wrote: read, written for each program that holds them, and read again.
#[test]
fn files_of_others_come_back() {
    let folder = tempfile::tempdir().expect("folder");
    for (program, name) in [
        (
            "kalibr",
            "lidar/gtsfm_hilti/calibration/calib_3_cam0-1-camchain-imucam.yaml",
        ),
        (
            "kalibr",
            "lidar/gtsfm_hilti/calibration/calib_3_cam2-camchain-imucam.yaml",
        ),
        (
            "basalt",
            "vision/tumvi_calib_imu1/initial_calibration_doublesphere.json",
        ),
        ("ros", "lidar/acfr_cam_lidar/camera_info.yaml"),
    ] {
        let Some(path) = data("files_of_others_come_back", name) else {
            return;
        };
        json(
            folder.path(),
            &[
                "calib",
                "import",
                program,
                &path,
                "--out",
                "first.toml",
                "--force",
            ],
            0,
        );
        let first = read(folder.path(), "first.toml");
        assert!(!first.cameras.is_empty());
        // Basalt and Kalibr hold what either wrote.
        let through: &[&str] = match program {
            "ros" => &["ros"],
            _ => &["kalibr", "basalt"],
        };
        for through in through {
            let export = ["calib", "export", through, "first.toml", "--out", through];
            let written = json(folder.path(), &[&export[..], &["--force"]].concat(), 0);
            let mut import = vec!["calib", "import", through];
            let files = written["files"].as_array().expect("files");
            import.extend(files.iter().map(|f| f.as_str().expect("a path")));
            json(
                folder.path(),
                &[&import[..], &["--out", "again.toml", "--force"]].concat(),
                0,
            );
            let again = read(folder.path(), "again.toml");
            let mut held = first.clone();
            if *through == "basalt" {
                // One offset for all.
                let offsets_s = first.cameras.values().map(|c| c.timing.rig_from_camera_s);
                let mean_s = offsets_s.sum::<f64>() / first.cameras.len() as f64;
                for mounted in held.cameras.values_mut() {
                    mounted.timing.rig_from_camera_s = mean_s;
                }
            }
            assert_same_rig(&format!("{name} through {through}"), &held, &again);
        }
    }
}
