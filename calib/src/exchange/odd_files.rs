//! Files as other programs write them, each with a twist: what cannot be used is refused or named, never dropped.

use super::*;

const CHAIN: &str = "cam0:\n  T_cam_imu:\n  - [0.0, -1.0, 0.0, 0.1]\n  - [0.0, 0.0, -1.0, 0.2]\n  - [1.0, 0.0, 0.0, 0.3]\n  - [0.0, 0.0, 0.0, 1.0]\n  camera_model: pinhole\n  intrinsics: [458.6, 457.3, 367.2, 248.4]\n  distortion_model: radtan\n  distortion_coeffs: [-0.28, 0.07, 0.0002, 0.00002]\n  resolution: [752, 480]\n  rostopic: /cam0/image_raw\n  timeshift_cam_imu: 0.005\n";

fn refused(result: Result<ImportedRig, Error>) -> String {
    let error = result.expect_err("refused").to_string();
    assert_eq!(error.lines().count(), 1, "{error}");
    error
}

#[test]
fn kalibr_chains_that_say_too_little_or_too_much() {
    let read = |from: &str, to: &str| {
        assert!(CHAIN.contains(from), "{from}");
        import_kalibr(&CHAIN.replace(from, to), "chain.yaml")
    };
    assert!(
        import_kalibr(CHAIN, "chain.yaml")
            .expect("a chain")
            .notes
            .is_empty()
    );
    for (from, to, problem) in [
        // Without its model the lens would be one that does not distort.
        (
            "  distortion_model: radtan\n",
            "",
            "distortion_coeffs without a distortion_model",
        ),
        // By columns: the translation would be lost, and the rotation turned around.
        (
            "[0.0, -1.0, 0.0, 0.1]\n  - [0.0, 0.0, -1.0, 0.2]\n  - [1.0, 0.0, 0.0, 0.3]\n  - [0.0, 0.0, 0.0, 1.0]",
            "[0.0, 0.0, 1.0, 0.0]\n  - [-1.0, 0.0, 0.0, 0.0]\n  - [0.0, -1.0, 0.0, 0.0]\n  - [0.1, 0.2, 0.3, 1.0]",
            "is it written column by column?",
        ),
        (
            "-1.0, 0.2]",
            "-1.0, .nan]",
            "has a translation that is not a number",
        ),
        (
            "0.005",
            ".nan",
            "the time offset or line delay is not a number",
        ),
        (
            "rostopic",
            "line_delay: 30000\n  rostopic",
            "line_delay is in seconds",
        ),
    ] {
        let error = refused(read(from, to));
        assert!(error.contains(problem), "{error}");
    }
    // The last of two would have been taken.
    let error = refused(import_kalibr(&format!("{CHAIN}{CHAIN}"), "chain.yaml"));
    assert!(error.contains("duplicate"), "{error}");
    let again = CHAIN.replace("cam0:", "cam00:");
    let error = refused(import_kalibr(&format!("{CHAIN}{again}"), "chain.yaml"));
    assert!(error.contains("a second camera named cam0"), "{error}");

    let found = read("  timeshift_cam_imu: 0.005\n", "").expect("a chain");
    assert!(
        matches!(&found.notes[..], [n] if n.contains("no timeshift_cam_imu")),
        "{:?}",
        found.notes
    );
}

/// Stamps of the first row, 480 rows 50 µs apart: a rig has the middle row's stamp and the time to one row below the last.
#[test]
fn rolling_shutters_of_kalibr_are_read() {
    for delay in ["line_delay_nanoseconds: 50000", "line_delay: 5.0e-5"] {
        let text = CHAIN.replace("rostopic", &format!("{delay}\n  rostopic"));
        let found = import_kalibr(&text, "chain.yaml").expect("a chain");
        let timing = found.rig.cameras["cam0"].timing;
        assert!((timing.readout_s - 0.024).abs() < 1e-12, "{timing:?}");
        let middle_s = 0.005 + 239.5 * 50e-6;
        assert!(
            (timing.rig_from_camera_s - middle_s).abs() < 1e-12,
            "{timing:?}"
        );
        assert!(
            matches!(&found.notes[..], [n] if n.contains("24.00 ms") && n.contains("16.98 ms")),
            "{:?}",
            found.notes
        );
    }
}

#[test]
fn an_imu_that_lacks_a_number_is_told_so() {
    let text = "imu0:\n  accelerometer_noise_density: 2.0e-3\n  accelerometer_random_walk: 3.0e-3\n  gyroscope_noise_density: 1.7e-4\n  update_rate: 200.0\n";
    let error = import_kalibr_imu(text, "imu.yaml").expect_err("one is missing");
    assert!(
        error.to_string().contains("gyroscope_random_walk"),
        "{error}"
    );
}

const INFO: &str = "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\ndistortion_model: plumb_bob\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 536.07, 0., 342.37, 0., 536.01, 235.53, 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n   data: [ -0.265, -0.0467, 0.00183, -0.000315, 0.252 ]\n";

#[test]
fn camera_matrices_are_what_they_must_be() {
    assert!(
        import_camera_info(INFO, "out.yml")
            .expect("a camera")
            .notes
            .is_empty()
    );
    for (from, to, problem) in [
        // The principal point was (0, 0).
        (
            "536.07, 0., 342.37, 0., 536.01, 235.53, 0., 0., 1.",
            "536.07, 0., 0., 0., 536.01, 0., 342.37, 235.53, 1.",
            "is it written column by column?",
        ),
        ("0., 0., 1. ]", "0., 0., 2. ]", "the camera matrix is"),
        (
            "-0.265, -0.0467, 0.00183, -0.000315, 0.252",
            "-0.265, -0.0467, 0.00183",
            "3 distortion coefficients",
        ),
        ("536.07", ".nan", "fx is NaN"),
        (
            "image_width: 640",
            "image_width: 640\nk: [500.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0]",
            "camera_matrix and k contradict each other",
        ),
    ] {
        assert!(INFO.contains(from), "{from}");
        let error = import_camera_info(&INFO.replace(from, to), "out.yml").expect_err(to);
        assert!(error.to_string().contains(problem), "{error}");
    }
    let (lens, _) = INFO
        .split_once("distortion_coefficients")
        .expect("it is there");
    let notes = import_camera_info(lens, "out.yml").expect("a camera").notes;
    assert!(
        matches!(&notes[..], [n] if n.contains("no distortion coefficients")),
        "{notes:?}"
    );
}

const BASALT: &str = r#"{"value0": {
    "T_imu_cam": [{"px": 0.0, "py": 0.1, "pz": 0.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0}],
    "intrinsics": [{"camera_type": "ds", "intrinsics": {"fx": 150.0, "fy": 151.0, "cx": 255.0, "cy": 256.0, "xi": -0.2, "alpha": 0.6}}],
    "resolution": [[512, 512]],
    "gyro_noise_std": [1e-4, 1e-4, 1e-4],
    "accel_noise_std": [1e-3, 1e-3, 1e-3],
    "gyro_bias_std": [1e-5, 1e-5, 1e-5],
    "accel_bias_std": [1e-4, 1e-4, 1e-4]
}}"#;

#[test]
fn values_of_basalt_that_have_no_place_are_named() {
    let found = import_basalt(BASALT, "basalt").expect("a calibration");
    assert!(found.notes.is_empty(), "{:?}", found.notes);
    for (from, to, words) in [
        (
            "\"xi\": -0.2",
            "\"xi\": -0.2, \"k1\": 0.1",
            "cam0: unknown and not used: k1",
        ),
        (
            "\"px\": 0.0",
            "\"px\": 0.0, \"scale\": 2.0",
            "not used: scale",
        ),
        (
            "\"gyro_bias_std\"",
            "\"gyro_bias\"",
            "the noise of the IMU is not used: one of gyro_noise_std",
        ),
    ] {
        assert!(BASALT.contains(from), "{from}");
        let found = import_basalt(&BASALT.replace(from, to), "basalt").expect("a calibration");
        assert!(
            found.notes.iter().any(|n| n.contains(words)),
            "{:?}",
            found.notes
        );
    }
}

const CAMERAS: &str = "7 OPENCV_FISHEYE 640 480 310.0 311.5 321.75 239.25 0.01 -0.01 0.004 -0.001\n3 OPENCV 640 480 500.0 503.0 321.75 239.25 -0.25 0.06 0.001 -0.0005\n";
const RIG: &str = r#"[{"cameras": [
    {"image_prefix": "cam0/images/", "ref_sensor": true, "camera_model_name": "OPENCV_FISHEYE",
     "camera_params": [310.0, 311.5, 321.75, 239.25, 0.01, -0.01, 0.004, -0.001]},
    {"image_prefix": "cam1/images/", "cam_from_rig_rotation": [1.0, 0.0, 0.0, 0.0],
     "cam_from_rig_translation": [0.1, 0.0, 0.0], "camera_model_name": "OPENCV",
     "camera_params": [500.0, 503.0, 321.75, 239.25, -0.25, 0.06, 0.001, -0.0005]}
]}]"#;

/// Numbers against the order of the rig, and folders that all have one name: lenses were exchanged, and one camera lost.
#[test]
fn members_of_colmaps_rigs_are_the_cameras_with_their_parameters() {
    let found = import_colmap(CAMERAS, Some(RIG), "cameras.txt").expect("a rig");
    assert!(found.notes.is_empty(), "{:?}", found.notes);
    let names: Vec<&str> = found.rig.cameras.keys().map(String::as_str).collect();
    assert_eq!(names, ["cam0_images", "cam1_images"]);
    let focal_px = |name: &str| found.rig.cameras[name].camera.focal_px()[0];
    assert_eq!((focal_px(names[0]), focal_px(names[1])), (310.0, 500.0));

    // Adjusted since: nothing tells them apart but their order.
    let adjusted = CAMERAS.replace("310.0", "310.5").replace("500.0", "500.5");
    let notes = import_colmap(&adjusted, Some(RIG), "cameras.txt")
        .expect("a rig")
        .notes;
    assert!(
        matches!(&notes[..], [n] if n.contains("matched in the order of their numbers")),
        "{notes:?}"
    );
    for (from, to, problem) in [
        (
            "\"ref_sensor\": true, ",
            "",
            "0 of its cameras are the ref_sensor",
        ),
        (
            "\"ref_sensor\": true, ",
            "\"ref_sensor\": true, \"cam_from_rig_translation\": [0.1, 0.0, 0.0], ",
            "it is the ref_sensor, but has a cam_from_rig",
        ),
    ] {
        assert!(RIG.contains(from), "{from}");
        let error = refused(import_colmap(CAMERAS, Some(&RIG.replace(from, to)), "x"));
        assert!(error.contains(problem), "{error}");
    }
    let twice = CAMERAS.replace("3 OPENCV ", "7 OPENCV ");
    let error = refused(import_colmap(&twice, None, "cameras.txt"));
    assert!(error.contains("line 2: a second camera 7"), "{error}");
    let broken = CAMERAS.replace("503.0", "nan");
    let error = refused(import_colmap(&broken, None, "cameras.txt"));
    assert!(error.contains("line 2: fy is NaN"), "{error}");
}

/// The lens of an image of another size, or width and height exchanged.
#[test]
fn a_principal_point_outside_the_image_is_remarked() {
    let text = CHAIN.replace("[752, 480]", "[376, 240]");
    let found = import_kalibr(&text, "chain.yaml").expect("a chain");
    let notes = implausible(&found.rig);
    assert!(
        matches!(&notes[..], [n] if n.contains("the principal point (367.2, 248.4) px is outside")),
        "{notes:?}"
    );
}

/// Numbers that are read, and are no camera's.
#[test]
fn lenses_that_do_not_exist_are_remarked() {
    for (from, to, words) in [
        (
            "[458.6, 457.3, 367.2, 248.4]",
            "[367.2, 248.4, 458.6, 457.3]",
            "pixels are square",
        ),
        (
            "[752, 480]",
            "[480, 752]",
            "far from the middle of the image of 480 × 752 px",
        ),
        ("[752, 480]", "[1504, 960]", "far from the middle"),
        (
            "0.0002, 0.00002]",
            "0.05, 0.3]",
            "the order of the coefficients",
        ),
    ] {
        assert!(CHAIN.contains(from), "{from}");
        let found = import_kalibr(&CHAIN.replace(from, to), "chain.yaml").expect("a chain");
        let notes = implausible(&found.rig);
        assert!(
            notes.iter().any(|n| n.contains(words)),
            "{words}: {notes:?}"
        );
    }
}

#[test]
fn files_of_other_programs_are_named_instead_of_read_as_chains() {
    for (text, words) in [
        (
            "%YAML:1.0\nimu: 1\nnum_of_cam: 2\nbody_T_cam0: !!opencv-matrix\n   rows: 4\n",
            "VINS-Fusion",
        ),
        (
            "%YAML:1.0\nFile.version: \"1.0\"\nCamera1.fx: 458.6\n",
            "ORB-SLAM",
        ),
        (INFO, "import ros"),
        ("accelerometer_noise_density: 2.0e-3\n", "an IMU's file"),
        ("left:\n  intrinsics: [1, 2]\n", "whose keys are cam0"),
    ] {
        let error = refused(import_kalibr(text, "x.yaml"));
        assert!(error.contains(words), "{error}");
    }
}
