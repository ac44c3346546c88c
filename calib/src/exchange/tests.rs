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
    assert!(back.notes.is_empty(), "{:?}", back.notes);
    let imu = import_kalibr_imu(text(&out, "imu.yaml"), "own").expect("own output");
    assert!(imu.notes.is_empty(), "{:?}", imu.notes);
    back.rig.set_imu_noise(imu.noise);
    assert_same(&rig, &back.rig);

    // Without the IMU the first camera is the origin.
    let chain: String = text(&out, "camchain-imucam.yaml").replace("T_cam_imu", "T_unknown");
    let ImportedRig {
        rig: alone,
        poses,
        notes,
    } = import_kalibr(&chain, "own").expect("a chain");
    assert_eq!(poses, PosesOf::FirstCamera);
    assert!(
        notes[0].starts_with("it has no pose relative to an IMU")
            && notes[1].contains("not used: T_unknown"),
        "{notes:?}"
    );
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
    .expect("own output")
    .rig;
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

/// They were written into files that no program reads.
#[test]
fn rates_that_no_imu_has_are_refused() {
    for rate_hz in [0.0, -5.0, f64::NAN, f64::INFINITY] {
        let refused = export(&rig(&lenses()), Format::Kalibr, rate_hz).expect_err("no rate");
        assert!(refused.to_string().contains("imu_rate_hz"), "{refused}");
    }
}

#[test]
fn wrong_files_are_named() {
    let kalibr = export(&rig(&lenses()), Format::Kalibr, 200.0).expect("exported");
    let chain = text(&kalibr, "camchain-imucam.yaml");
    for (from, to, problem) in [
        (
            "camera_model: ds",
            "camera_model: sphere",
            "camera_model sphere is not supported",
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
    let line = format!("1 THIN_PRISM_FISHEYE 6 4{}", " 1".repeat(12));
    let error = import_colmap(&line, None, "cameras.txt").expect_err("model");
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

/// OpenVINS's files begin with OpenCV's head and name the pose the other way round: it was an identity once, with exit code 0.
#[test]
fn openvins_chains_are_read_with_their_poses() {
    let text = "%YAML:1.0 # need to specify the file type at the top!\n\ncam0:\n  T_imu_cam: #rotation from camera to imu\n    - [0.0, 0.0, 1.0, 0.1]\n    - [-1.0, 0.0, 0.0, 0.2]\n    - [0.0, -1.0, 0.0, 0.3]\n    - [0.0, 0.0, 0.0, 1.0]\n  cam_overlaps: [1]\n  camera_model: pinhole\n  distortion_coeffs: [-0.28, 0.07, 0.0002, 0.00002]\n  distortion_model: radtan\n  intrinsics: [458.6, 457.3, 367.2, 248.4]\n  resolution: [752, 480]\n  rostopic: /cam0/image_raw\n  timeshift_cam_imu: 0.005\n";
    let found = import_kalibr(text, "openvins").expect("a chain");
    assert!(found.notes.is_empty(), "{:?}", found.notes);
    let cam0 = &found.rig.cameras["cam0"];
    assert_eq!(
        cam0.rig_from_camera.translation,
        Vector3::new(0.1, 0.2, 0.3)
    );
    // The camera looks along the rig's x axis.
    let ahead = cam0.rig_from_camera.rotation * Vector3::z();
    assert!((ahead - Vector3::x()).norm() < 1e-12, "{ahead}");
    assert_eq!(cam0.timing.rig_from_camera_s, 0.005);

    let both = format!(
        "{text}  T_cam_imu:\n    - [1.0, 0.0, 0.0, 0.1]\n    - [0.0, 1.0, 0.0, 0.0]\n    - [0.0, 0.0, 1.0, 0.0]\n    - [0.0, 0.0, 0.0, 1.0]\n"
    );
    let error = import_kalibr(&both, "both")
        .expect_err("they contradict")
        .to_string();
    assert!(
        error.contains("T_cam_imu and T_imu_cam contradict"),
        "{error}"
    );

    let imu = "%YAML:1.0\n\nimu0:\n  T_i_b:\n    - [1.0, 0.0, 0.0, 0.0]\n    - [0.0, 1.0, 0.0, 0.0]\n    - [0.0, 0.0, 1.0, 0.0]\n    - [0.0, 0.0, 0.0, 1.0]\n  accelerometer_noise_density: 2.0e-3\n  accelerometer_random_walk: 3.0e-3\n  gyroscope_noise_density: 1.7e-4\n  gyroscope_random_walk: 2.0e-5\n  model: calibrated\n  rostopic: /imu0\n  time_offset: 0.0\n  update_rate: 200.0\n";
    let found = import_kalibr_imu(imu, "openvins").expect("an IMU");
    assert_eq!(found.noise.gyro_noise_density, 1.7e-4);
    assert!(found.notes.is_empty(), "{:?}", found.notes);
    let late = imu.replace("time_offset: 0.0", "time_offset: 0.2");
    let found = import_kalibr_imu(&late, "openvins").expect("an IMU");
    assert!(
        found.notes[0].contains("not used: time_offset"),
        "{:?}",
        found.notes
    );
}

const ECHO: &str = "header:\n  stamp:\n    sec: 1\n    nanosec: 2\n  frame_id: cam0\nheight: 480\nwidth: 640\ndistortion_model: plumb_bob\nd:\n- -0.25\n- 0.06\n- 0.001\n- -0.0005\n- 0.0\nk: [500.0, 0.0, 321.25, 0.0, 503.0, 238.75, 0.0, 0.0, 1.0]\nr: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]\np: [500.0, 0.0, 321.25, 0.0, 0.0, 503.0, 238.75, 0.0, 0.0, 0.0, 1.0, 0.0]\nbinning_x: 0\nbinning_y: 0\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0\n  do_rectify: false\n---\n";

#[test]
fn the_output_of_ros2_topic_echo_is_read_as_it_is() {
    let found = import_camera_info(ECHO, "echo").expect("a message");
    assert!(found.notes.is_empty(), "{:?}", found.notes);
    assert_eq!(found.camera.principal_px(), [321.25, 238.75]);
    let twice = format!("{ECHO}{}", ECHO.replace("sec: 1", "sec: 7"));
    assert_eq!(import_camera_info(&twice, "echo").expect("messages"), found);
    let changed = format!("{ECHO}{}", ECHO.replace("[500.0", "[501.0"));
    let error = import_camera_info(&changed, "echo").expect_err("two lenses");
    assert!(
        error.to_string().contains("document 2 of 2 differs"),
        "{error}"
    );
}

#[test]
fn a_part_of_the_sensor_is_honoured_and_binning_refused() {
    let part = ECHO
        .replace("x_offset: 0", "x_offset: 100")
        .replace("y_offset: 0", "y_offset: 40")
        .replace("height: 0\n  width: 0", "height: 240\n  width: 320");
    let found = import_camera_info(&part, "echo").expect("a message");
    assert_eq!((found.camera.width, found.camera.height), (320, 240));
    assert_eq!(found.camera.principal_px(), [221.25, 198.75]);
    assert!(found.notes[0].contains("320 × 240"), "{:?}", found.notes);
    for (from, to, problem) in [
        ("binning_x: 0", "binning_x: 2", "binning of 2 × 0"),
        (
            "x_offset: 0",
            "x_offset: 9",
            "region of interest has no size",
        ),
        (
            "height: 0\n  width: 0",
            "height: 481\n  width: 640",
            "region of interest of 640 × 481",
        ),
    ] {
        let error = import_camera_info(&ECHO.replace(from, to), "echo").expect_err(to);
        assert!(error.to_string().contains(problem), "{error}");
    }
    let turned = ECHO.replace("r: [1.0, 0.0", "r: [0.9, 0.1");
    let notes = import_camera_info(&turned, "echo")
        .expect("a message")
        .notes;
    assert!(notes[0].contains("rectification matrix"), "{notes:?}");
}

#[test]
fn opencvs_own_calibration_is_read() {
    let text = "%YAML:1.0\n---\ncalibration_time: \"Sun Nov 22 2026\"\nimage_width: 640\nimage_height: 480\nboard_width: 9\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 536.07, 0., 342.37, 0., 536.01, 235.53, 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n   data: [ -0.265, -0.0467, 0.00183, -0.000315, 0.252 ]\navg_reprojection_error: 0.2\n";
    let found = import_camera_info(text, "out.yml").expect("a camera");
    assert_eq!(
        found.camera.lens.distortion(),
        [-0.265, -0.0467, 0.00183, -0.000315, 0.252]
    );
    let [model, others] = &found.notes[..] else {
        panic!("{:?}", found.notes)
    };
    assert!(
        model.contains("it has no distortion_model: plumb_bob is assumed"),
        "{model}"
    );
    assert!(
        others.ends_with("avg_reprojection_error, board_width, calibration_time"),
        "{others}"
    );
}

#[test]
fn units_of_a_rig_are_looked_at() {
    let mut rig = rig(&lenses());
    assert_eq!(implausible(&rig), Vec::<String>::new());
    let cam1 = rig.cameras.get_mut("cam1").expect("a camera");
    cam1.rig_from_camera.translation = Vector3::new(83.0, 0.0, 0.0);
    cam1.timing.rig_from_camera_s = 19.0;
    rig.imus
        .values_mut()
        .next()
        .expect("an IMU")
        .noise
        .gyro_noise_density = 0.4;
    let notes = implausible(&rig);
    for (note, words) in notes
        .iter()
        .zip(["83.0 m from", "offsets are in seconds", "rad/s/√Hz"])
    {
        assert!(note.contains(words), "{notes:?}");
    }
    assert_eq!(notes.len(), 3);
}

#[test]
fn omni_lenses_of_kalibr_are_read() {
    let text = "cam0:\n  camera_model: omni\n  intrinsics: [1.6, 900.0, 905.0, 320.0, 240.0]\n  distortion_model: none\n  resolution: [640, 480]\n";
    let found = import_kalibr(text, "omni").expect("a chain");
    assert_eq!(
        found.rig.cameras["cam0"].camera.lens.model(),
        LensModel::ExtendedUnified
    );
    let distorted = text.replace(
        "none",
        "radtan\n  distortion_coeffs: [-0.1, 0.03, 0.0, 0.0]",
    );
    let notes = import_kalibr(&distorted, "omni").expect("a chain").notes;
    assert!(
        notes[0].contains("the omni lens is converted to"),
        "{notes:?}"
    );
}
