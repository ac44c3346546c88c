use super::*;
use crate::Vector6;
use crate::camera::Lens;

const NOISE: ImuNoiseModel = ImuNoiseModel {
    gyro_noise_density: 1e-3,
    accel_noise_density: 1e-2,
    gyro_bias_walk: 1e-5,
    accel_bias_walk: 1e-4,
};

/// Rigs with several sensors of a kind are lists; the file of a rig with one of each is what it always was.
#[test]
fn several_lidars_and_imus_are_lists_and_one_of_each_is_written_as_ever() {
    let lidar = |x_m: f64| RigLidar {
        rig_from_lidar: Se3::exp(&Vector6::new(0.0, 0.0, 0.0, x_m, 0.0, 0.0)),
        range_noise_m: 0.03,
    };
    let mut rig = Rig {
        imus: RigImu::from(NOISE).alone(),
        lidars: lidar(0.1).alone(),
        ..Rig::empty("backpack")
    };
    let text = rig.to_toml();
    assert!(text.contains("[imu]") && text.contains("[lidar]"), "{text}");
    assert_eq!(rig.lidar(), Some(&lidar(0.1)));
    rig.lidars.insert("lidar_rear".to_owned(), lidar(-0.4));
    let inside_camera = RigImu {
        rig_from_imu: Se3::exp(&Vector6::new(0.1, 0.2, 0.3, 0.4, 0.5, 0.6)),
        noise: NOISE,
    };
    rig.imus.insert("imu1".to_owned(), inside_camera);
    let text = rig.to_toml();
    assert!(text.contains("[lidars.lidar_rear"), "{text}");
    let back = Rig::from_toml(&text, "memory").expect("own output");
    assert_eq!(back, rig);
    assert_eq!(back.to_toml(), text);
    assert_eq!(back.lidar(), Some(&lidar(0.1)), "not the rear one");
    let serde = toml::to_string(&rig).expect("serde writes a rig");
    assert_eq!(Rig::from_toml(&serde, "memory").expect("own output"), rig);

    let short = text
        .replace("lidars.lidar]", "lidar]")
        .replace("lidars.lidar.", "lidar.");
    assert_eq!(Rig::from_toml(&short, "memory").expect("short for it"), rig);
    let twice = format!(
        "{text}[lidar]\nrange_noise_m = 0.03\nrig_from_lidar = {{ rotation_xyzw = [0, 0, 0, 1], translation_m = [0, 0, 0] }}\n"
    );
    let error = Rig::from_toml(&twice, "memory").expect_err("there twice");
    assert!(error.to_string().contains("are the same sensor"), "{error}");
    let moved = text.replace("imu0", "imu2");
    let error = Rig::from_toml(&moved, "memory").expect_err("whose frame is the rig's?");
    assert!(
        error.to_string().contains("imu1 is the main IMU"),
        "{error}"
    );
}

#[test]
fn toml_round_trip_and_named_errors() {
    let (focal_px, principal_px) = ([350.0, 350.1], [319.5, 199.5]);
    let lenses = [
        Camera::pinhole(640, 400, focal_px, principal_px).lens,
        Lens::KannalaBrandt {
            focal_px,
            principal_px,
            distortion: [0.1, -0.2, 1e-3, 1e-9],
        },
        Lens::DoubleSphere {
            focal_px,
            principal_px,
            distortion: [-0.17, 0.59],
        },
        Lens::ExtendedUnified {
            focal_px,
            principal_px,
            distortion: [0.62, 1.1],
        },
        Lens::FieldOfView {
            focal_px,
            principal_px,
            distortion: [0.92],
        },
    ];
    let cameras = lenses.into_iter().enumerate().map(|(k, lens)| {
        let mounted = RigCamera {
            camera: Camera {
                width: 640,
                height: 400,
                lens,
            },
            rig_from_camera: Se3::exp(&Vector6::new(0.1, 0.2, 0.3, 0.4, 0.5, 0.6)),
            timing: CameraTiming {
                rig_from_camera_s: k as f64 * 1e-3,
                readout_s: 0.0,
            },
            sigmas: Default::default(),
        };
        (format!("cam {k} \"left\""), mounted)
    });
    let rig = Rig {
        name: "backpack".into(),
        calibrated_unix_s: Some(1_772_359_200),
        cameras: cameras.collect(),
        imus: RigImu::from(NOISE).alone(),
        lidars: RigLidar {
            rig_from_lidar: Se3::identity(),
            range_noise_m: 0.03,
        }
        .alone(),
    };
    let back = Rig::from_toml(&rig.to_toml(), "memory").expect("own output");
    assert_eq!(back, rig);
    // What serde itself writes is the same rig.
    let serde = toml::to_string(&rig).expect("serde writes a rig");
    let serde = Rig::from_toml(&serde, "memory").expect("own output");
    assert_eq!(serde, back);

    let broken = rig.to_toml().replace("1.1", "-1.1");
    let error = Rig::from_toml(&broken, "rig.toml").expect_err("bad lens");
    assert!(error.to_string().contains("beta is -1.1"), "{error}");
    // TOML has numbers that are none.
    for (from, to, problem) in [
        (
            "range_noise_m = 0.03",
            "range_noise_m = nan",
            "LiDAR lidar: range_noise_m is NaN",
        ),
        (
            "range_noise_m = 0.03",
            "range_noise_m = -0.03",
            "range_noise_m is -0.03",
        ),
        ("readout_s = 0.0", "readout_s = inf", "readout_s is inf"),
        (
            "translation_m = [0.0, 0.0, 0.0]",
            "translation_m = [nan, 0.0, 0.0]",
            "a pose that is not a number",
        ),
    ] {
        let text = rig.to_toml();
        assert!(text.contains(from), "{from} in {text}");
        let error = Rig::from_toml(&text.replace(from, to), "rig.toml").expect_err(to);
        assert!(error.to_string().contains(problem), "{error}");
    }

    for (text, problem) in [
        ("name = 'x'\nwheels = 4\n", "wheels"),
        ("name = 'x'\ncameras = [", "unclosed"),
    ] {
        let error = Rig::from_toml(text, "walk/rig.toml")
            .expect_err("no rig")
            .to_string();
        assert!(
            error.starts_with("rig file walk/rig.toml: line 2: "),
            "{error}"
        );
        assert!(
            error.contains(problem) && error.lines().count() == 1,
            "{error}"
        );
    }
}
/// The text names the calibration: it must not move when it is read and written.
#[test]
fn text_stays_the_same_to_the_last_bit() {
    let mut pose = Se3::exp(&Vector6::new(0.3, -0.2, 0.1, 0.01, 0.2, -0.3));
    for k in 0..500 {
        pose = pose * Se3::exp(&Vector6::repeat(0.1 + 1e-3 * f64::from(k)));
        let rig = Rig {
            lidars: RigLidar {
                rig_from_lidar: pose,
                range_noise_m: 0.03,
            }
            .alone(),
            ..Rig::empty("turned")
        };
        let text = rig.to_toml();
        let back = Rig::from_toml(&text, "memory").expect("own output");
        assert_eq!(back.to_toml(), text);
    }
    // Typed by hand with few digits: made a unit once, then it stays.
    let rough = "name = 'x'\n[lidar]\nrange_noise_m = 0.03\nrig_from_lidar = { rotation_xyzw = [0.1, 0.2, 0.3, 0.9273], translation_m = [0, 0, 0] }\n";
    let text = Rig::from_toml(rough, "memory").expect("a rig").to_toml();
    let again = Rig::from_toml(&text, "memory").expect("own output");
    assert_eq!(again.to_toml(), text);
}

#[test]
fn how_well_a_camera_is_known_stands_in_its_file() {
    let mut rig = Rig::empty("glasses");
    let camera = |sigmas| RigCamera {
        camera: Camera::pinhole(640, 400, [350.0; 2], [319.5, 199.5]),
        rig_from_camera: Se3::identity(),
        timing: CameraTiming::default(),
        sigmas,
    };
    let variances = [1e-8, 4e-8, 9e-8, 1e-6, 4e-6, 9e-6];
    let sigmas = CameraSigmas {
        focal_share: CameraSigmas::estimated(2e-4),
        // It was not searched.
        readout_s: CameraSigmas::estimated(0.0),
        ..CameraSigmas::of_pose(&Matrix6::from_diagonal(&Vector6::from(variances)))
    };
    assert_eq!(sigmas.readout_s, None);
    let rotation_rad = sigmas.rotation_rad.expect("known");
    assert!((rotation_rad[2] - 3e-4).abs() < 1e-12, "{rotation_rad:?}");
    rig.cameras.insert("cam0".into(), camera(sigmas));
    rig.cameras
        .insert("cam1".into(), camera(CameraSigmas::default()));
    let text = rig.to_toml();
    assert_eq!(text.matches("sigmas").count(), 1, "{text}");
    let back = Rig::from_toml(&text, "memory").expect("own output");
    assert_eq!((&back, back.to_toml()), (&rig, text.clone()));
    let serde = toml::to_string(&rig).expect("serde writes a rig");
    assert_eq!(Rig::from_toml(&serde, "memory").expect("own output"), rig);
    for wrong in ["0.0", "-2e-4", "nan", "inf"] {
        let text = text.replace("0.0002\n", &format!("{wrong}\n"));
        let error = Rig::from_toml(&text, "memory").expect_err("no standard deviation");
        let error = error.to_string();
        assert!(error.contains("cameras.cam0.sigmas"), "{error}");
    }
}
