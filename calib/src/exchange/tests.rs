use lsfb_geometry::{CameraTiming, ImuNoiseModel, Vector6};

use super::*;

fn rig(lenses: &[Lens]) -> Rig {
    let mut rig = Rig::empty("test");
    for (k, lens) in lenses.iter().enumerate() {
        let camera = Camera {
            width: 640,
            height: 480,
            lens: *lens,
        };
        let pose = Se3::exp(&Vector6::new(
            1.2,
            -1.1,
            1.3 + 0.1 * k as f64,
            0.05,
            -0.02,
            0.01,
        ));
        let mut camera = mounted(camera, pose * Se3::exp(&Vector6::repeat(0.03 * k as f64)));
        camera.timing = CameraTiming {
            rig_from_camera_s: 1.9e-3,
            readout_s: 0.0,
        };
        rig.cameras.insert(format!("cam{k}"), camera);
    }
    rig.set_imu_noise(ImuNoiseModel {
        gyro_noise_density: 1.6e-4,
        accel_noise_density: 2.8e-3,
        gyro_bias_walk: 2.2e-5,
        accel_bias_walk: 8.6e-4,
    });
    rig
}

fn lenses() -> [Lens; 5] {
    let (focal_px, principal_px) = ([310.0, 311.5], [321.25, 238.75]);
    [
        Lens::KannalaBrandt {
            focal_px,
            principal_px,
            distortion: [0.01, -0.01, 0.004, -0.001],
        },
        Lens::PinholeRadtan {
            focal_px: [500.0, 503.0],
            principal_px,
            distortion: [-0.25, 0.06, 1e-3, -5e-4, 0.0],
        },
        Lens::DoubleSphere {
            focal_px: [240.0, 241.0],
            principal_px,
            distortion: [-0.18, 0.58],
        },
        Lens::ExtendedUnified {
            focal_px,
            principal_px,
            distortion: [0.6, 1.1],
        },
        Lens::FieldOfView {
            focal_px,
            principal_px,
            distortion: [0.9],
        },
    ]
}

/// Poses within rounding, everything else to the last bit.
fn assert_same(a: &Rig, b: &Rig) {
    assert_eq!(a.cameras.len(), b.cameras.len());
    for ((name, a), (other, b)) in a.cameras.iter().zip(&b.cameras) {
        assert_eq!((name, a.camera, a.timing), (other, b.camera, b.timing));
        let moved = (a.rig_from_camera.inverse() * b.rig_from_camera)
            .log()
            .norm();
        assert!(moved < 1e-12, "{name}: {moved}");
    }
    assert_eq!(a.imus, b.imus);
}

fn text<'a>(exported: &'a Exported, name: &str) -> &'a str {
    let file = exported.files.iter().find(|f| f.name == name);
    &file
        .unwrap_or_else(|| panic!("{name} in {exported:?}"))
        .text
}

#[test]
fn kalibr_round_trip() {
    let rig = rig(&lenses());
    let out = export(&rig, Format::Kalibr, 200.0).expect("exported");
    assert!(out.notes.is_empty(), "{:?}", out.notes);
    let mut back = import_kalibr(text(&out, "camchain-imucam.yaml"), "own").expect("own output");
    back.set_imu_noise(import_kalibr_imu(text(&out, "imu.yaml"), "own").expect("own output"));
    assert_same(&rig, &back);

    // Without the IMU the first camera is the origin.
    let chain: String = text(&out, "camchain-imucam.yaml").replace("T_cam_imu", "T_unknown");
    let alone = import_kalibr(&chain, "own").expect("a chain");
    let first = rig.cameras["cam0"].rig_from_camera;
    for (name, camera) in &alone.cameras {
        let expected = first.inverse() * rig.cameras[name].rig_from_camera;
        assert!((camera.rig_from_camera.inverse() * expected).log().norm() < 1e-12);
    }
}

#[test]
fn basalt_round_trip() {
    let rig = rig(&lenses());
    let out = export(&rig, Format::Basalt, 200.0).expect("exported");
    assert!(
        matches!(&out.notes[..], [n] if n.contains("add 1900000 ns")),
        "{:?}",
        out.notes
    );
    let imported = import_basalt(text(&out, "calibration.json"), "own").expect("own output");
    assert!(imported.notes.is_empty(), "{:?}", imported.notes);
    let back = imported.rig;
    for (a, b) in rig.cameras.values().zip(back.cameras.values()) {
        assert_eq!(a.camera, b.camera);
        assert!((a.timing.rig_from_camera_s - b.timing.rig_from_camera_s).abs() < 1e-15);
        assert!(
            (a.rig_from_camera.inverse() * b.rig_from_camera)
                .log()
                .norm()
                < 1e-12
        );
    }
    let (a, b) = (
        rig.imu_noise().expect("an IMU"),
        back.imu_noise().expect("an IMU"),
    );
    assert!((a.gyro_noise_density / b.gyro_noise_density - 1.0).abs() < 1e-12);
    assert!((a.accel_bias_walk / b.accel_bias_walk - 1.0).abs() < 1e-12);

    // What a rig does not hold is said.
    let mut file: serde_json::Value =
        serde_json::from_str(text(&out, "calibration.json")).expect("JSON");
    file["value0"]["calib_gyro_bias"][4] = 0.01.into();
    file["value0"]["accel_noise_std"][2] = 1.0.into();
    let notes = import_basalt(&file.to_string(), "own").expect("read").notes;
    assert!(
        matches!(&notes[..], [a, b] if a.contains("scale and misalignment") && b.contains("three axes")),
        "{notes:?}"
    );
}

#[test]
fn colmap_round_trip_keeps_half_a_pixel() {
    let [kb, radtan, .., fov] = lenses();
    let rig = rig(&[kb, radtan, fov]);
    let out = export(&rig, Format::Colmap, 200.0).expect("exported");
    assert!(
        text(&out, "cameras.txt").contains("1 OPENCV_FISHEYE 640 480 310.0 311.5 321.75 239.25 ")
    );
    let back = import_colmap(
        text(&out, "cameras.txt"),
        Some(text(&out, "rig_config.json")),
        "own",
    )
    .expect("own output");
    let first = rig.cameras["cam0"].rig_from_camera;
    for (name, camera) in &back.cameras {
        assert_eq!(camera.camera, rig.cameras[name].camera);
        let expected = first.inverse() * rig.cameras[name].rig_from_camera;
        assert!((camera.rig_from_camera.inverse() * expected).log().norm() < 1e-12);
    }
}

#[test]
fn ros_round_trip_and_lenses_it_does_not_know() {
    let rig = rig(&lenses());
    let out = export(&rig, Format::Ros, 200.0).expect("exported");
    for (name, mounted) in &rig.cameras {
        let back = import_camera_info(text(&out, &format!("{name}.yaml")), "own").expect("own");
        assert_eq!(back.name.as_deref(), Some(name.as_str()));
        let off = deviation_px(&mounted.camera, &back.camera);
        if matches!(name.as_str(), "cam0" | "cam1") {
            assert_eq!(back.camera, mounted.camera);
        } else {
            assert!(off < 0.5, "{name}: {off}");
            assert!(
                out.notes
                    .iter()
                    .any(|n| n.starts_with(&format!("{name}: the lens model")))
            );
        }
    }
    // The message as `ros2 topic echo` prints it, and as ROS 1 did.
    let echo = "header:\n  frame_id: cam0\nheight: 480\nwidth: 640\ndistortion_model: plumb_bob\nd:\n- -0.25\n- 0.06\n- 0.001\n- -0.0005\n- 0.0\nk: [500.0, 0.0, 321.25, 0.0, 503.0, 238.75, 0.0, 0.0, 1.0]\nr: [1.0, 0.0]\nbinning_x: 0\n";
    for text in [
        echo.to_owned(),
        echo.replace("\nd:", "\nD:").replace("\nk:", "\nK:"),
    ] {
        let back = import_camera_info(&text, "echo").expect("a message");
        assert_eq!(back.camera, rig.cameras["cam1"].camera);
    }
}

#[test]
fn wrong_files_are_named() {
    let kalibr = export(&rig(&lenses()), Format::Kalibr, 200.0).expect("exported");
    let chain = text(&kalibr, "camchain-imucam.yaml");
    for (from, to, problem) in [
        (
            "camera_model: ds",
            "camera_model: omni",
            "camera_model omni is not known",
        ),
        ("cam1:", "left:", "left: expected cam0"),
        ("equidistant", "radial", "pinhole with distortion radial"),
        (
            "T_cam_imu:\n  - [",
            "T_cam_imu:\n  - [9.0, 9.0, 9.0, 9.0]\n  - [",
            "path.yaml",
        ),
        ("[640, 480]", "[0, 480]", "0 × 480"),
        (
            "intrinsics: [310.0, ",
            "intrinsics: [",
            "3 intrinsics, expected 4",
        ),
    ] {
        let error = import_kalibr(&chain.replacen(from, to, 1), "path.yaml")
            .expect_err(to)
            .to_string();
        assert!(
            error.contains(problem) && error.lines().count() == 1,
            "{error}"
        );
    }
    for text in ["", "cam0: 3", "[", "a: &a [*a]"] {
        assert!(import_kalibr(text, "x").is_err(), "{text}");
        assert!(import_camera_info(text, "x").is_err(), "{text}");
        assert!(import_basalt(text, "x").is_err(), "{text}");
        assert!(import_colmap(text, None, "x").is_err(), "{text}");
    }
    let error =
        import_colmap("1 THIN_PRISM_FISHEYE 6 4 1 1", None, "cameras.txt").expect_err("model");
    assert!(
        error
            .to_string()
            .contains("line 1: model THIN_PRISM_FISHEYE"),
        "{error}"
    );
    let k3 = Lens::PinholeRadtan {
        focal_px: [500.0; 2],
        principal_px: [320.0, 240.0],
        distortion: [0.0, 0.0, 0.0, 0.0, 0.05],
    };
    let notes = export(&rig(&[k3]), Format::Kalibr, 200.0)
        .expect("exported")
        .notes;
    assert!(notes.iter().any(|n| n.contains("no k3")), "{notes:?}");
}
