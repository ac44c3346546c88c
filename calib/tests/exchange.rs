//! Rig files that foreign programs read and wrote.
//!
//! Expected values: `benches/exchange/foreign.py` (OpenCV 5.0, pycolmap 4.2), which reads the files in `tests/exchange`.

use std::path::Path;

use lsfb_calib::exchange::{
    Format, export, import_basalt, import_camera_info, import_colmap, import_kalibr,
};
use lsfb_geometry::{Camera, Rig, RigCamera, Se3, Vector2, Vector3};

const POINTS: [[f64; 3]; 3] = [[0.3, -0.2, 1.5], [-0.4, 0.25, 1.2], [0.05, 0.4, 2.0]];
const OPENCV: [[[f64; 2]; 3]; 2] = [
    [
        [382.127701141, 197.968486225],
        [222.674265522, 300.657946149],
        [328.900445638, 300.249711388],
    ],
    [
        [419.764474074, 172.699000869],
        [160.619038146, 339.800150100],
        [333.618815918, 338.396402383],
    ],
];
const COLMAP: [[[f64; 2]; 3]; 2] = [
    [
        [382.627701141, 198.468486225],
        [223.174265522, 301.157946149],
        [329.400445638, 300.749711388],
    ],
    [
        [420.264474074, 173.199000869],
        [161.119038146, 340.300150100],
        [334.118815918, 338.896402383],
    ],
];
const COLMAP_CAM1_FROM_CAM0: [f64; 3] = [-0.82112, -1.31584, 0.5852];

fn file(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/exchange")
        .join(name);
    std::fs::read_to_string(path).expect("a file of this test")
}

fn assert_sees(camera: &Camera, expected: &[[f64; 2]; 3], shift_px: f64) {
    for (point, pixel) in POINTS.iter().zip(expected) {
        let seen = camera.project(&Vector3::from(*point)).expect("in view");
        let off = (seen + Vector2::repeat(shift_px) - Vector2::from(*pixel)).norm();
        assert!(off < 1e-8, "{point:?}: {off}");
    }
}

#[test]
fn camera_info_is_read_and_written_as_opencv_has_it() {
    let mut rig = Rig::empty("test");
    for (k, expected) in OPENCV.iter().enumerate() {
        let name = format!("cam{k}");
        let found = import_camera_info(&file(&format!("{name}.yaml")), &name).expect("a camera");
        assert_sees(&found.camera, expected, 0.0);
        rig.cameras.insert(
            name,
            RigCamera {
                camera: found.camera,
                rig_from_camera: Se3::identity(),
                timing: Default::default(),
                sigmas: Default::default(),
            },
        );
    }
    let out = export(&rig, Format::Ros, 200.0).expect("exported");
    for written in &out.files {
        assert_eq!(written.text, file(&written.name), "{}", written.name);
    }
}

#[test]
fn colmap_counts_pixels_from_the_corner() {
    let cameras = file("cameras.txt");
    let rig = import_colmap(&cameras, Some(&file("rig_config.json")), "cameras.txt")
        .expect("a rig")
        .rig;
    for (mounted, expected) in rig.cameras.values().zip(&COLMAP) {
        assert_sees(&mounted.camera, expected, 0.5);
    }
    let cam1_from_cam0 =
        rig.cameras["cam1"].rig_from_camera.inverse() * rig.cameras["cam0"].rig_from_camera;
    let moved = cam1_from_cam0 * Vector3::from(POINTS[0]);
    assert!((moved - Vector3::from(COLMAP_CAM1_FROM_CAM0)).norm() < 1e-12);
    let out = export(&rig, Format::Colmap, 200.0).expect("exported");
    assert_eq!(out.files[0].text, cameras);
    let numbers = |text: &str| -> serde_json::Value { serde_json::from_str(text).expect("JSON") };
    let (own, theirs) = (
        numbers(&out.files[1].text),
        numbers(&file("rig_config.json")),
    );
    let member = |v: &serde_json::Value, key: &str| v[0]["cameras"][1][key].clone();
    for (key, n) in [
        ("cam_from_rig_rotation", 4),
        ("cam_from_rig_translation", 3),
        ("camera_params", 8),
    ] {
        for k in 0..n {
            let [a, b] = [&own, &theirs].map(|v| member(v, key)[k].as_f64().expect("a number"));
            assert!((a - b).abs() < 1e-12, "{key} {k}: {a} {b}");
        }
    }
}

fn data(test: &str, name: &str) -> Option<String> {
    let path = lsfb_tests::recordings(test, name)?;
    Some(std::fs::read_to_string(path).expect("a text"))
}

/// Kalibr's own file has both `T_cam_imu` and `T_cn_cnm1`: they say the same where frames are read as Kalibr means them.
#[test]
fn kalibr_frames_of_the_hilti_rig() {
    let name = "lidar/gtsfm_hilti/calibration/calib_3_cam0-1-camchain-imucam.yaml";
    let Some(text) = data("kalibr_frames_of_the_hilti_rig", name) else {
        return;
    };
    let rig = import_kalibr(&text, name).expect("a camera chain").rig;
    assert_eq!(
        rig.cameras["cam0"].timing.rig_from_camera_s,
        0.0019071204237431304
    );
    let alone = import_kalibr(&text.replace("T_cam_imu", "unused"), name)
        .expect("a chain")
        .rig;
    let relative = |rig: &Rig| {
        rig.cameras["cam1"].rig_from_camera.inverse() * rig.cameras["cam0"].rig_from_camera
    };
    let off = relative(&rig).inverse() * relative(&alone);
    assert!(off.log().norm() < 1e-6, "{}", off.log());
    // The stereo pair is 10.8 cm apart: cam0 lies along the x axis of cam1.
    assert!(
        (relative(&rig).translation.x - 0.108).abs() < 0.002,
        "{}",
        relative(&rig).translation
    );
    let out = export(&rig, Format::Kalibr, 200.0).expect("exported");
    let back = import_kalibr(&out.files[0].text, "own")
        .expect("own output")
        .rig;
    for (a, b) in rig.cameras.values().zip(back.cameras.values()) {
        assert_eq!((a.camera, a.timing), (b.camera, b.timing));
        assert!(
            (a.rig_from_camera.inverse() * b.rig_from_camera)
                .log()
                .norm()
                < 1e-12
        );
    }
}

/// The same rig in Basalt's file and in Kalibr's figures: two lens models, one pair of poses.
#[test]
fn basalt_frames_of_the_tum_rig() {
    let (Some(basalt), Some(kalibr)) = (
        data(
            "basalt_frames_of_the_tum_rig",
            "vision/tumvi_calib_imu1/initial_calibration_doublesphere.json",
        ),
        data(
            "basalt_frames_of_the_tum_rig",
            "vision/tumvi_calib_imu1/reference_calibration.json",
        ),
    ) else {
        return;
    };
    let rig = import_basalt(&basalt, "basalt").expect("a calibration").rig;
    let cam1_from_cam0 =
        rig.cameras["cam1"].rig_from_camera.inverse() * rig.cameras["cam0"].rig_from_camera;
    let reference: serde_json::Value = serde_json::from_str(&kalibr).expect("JSON");
    let pose = |name: &str| {
        let rows = &reference[name]["T_cam_imu"];
        let at = |i: usize, j: usize| rows[i][j].as_f64().expect("a number");
        let turn = nalgebra::Matrix3::from_fn(at);
        let turn = nalgebra::Rotation3::from_matrix(&turn);
        Se3::new(
            nalgebra::UnitQuaternion::from_rotation_matrix(&turn),
            Vector3::from_fn(|i, _| at(i, 3)),
        )
    };
    let expected = pose("cam1") * pose("cam0").inverse();
    let off = (expected.inverse() * cam1_from_cam0).log();
    // The file is Basalt's before its own adjustment: a degree and half a centimetre tell frames apart.
    assert!(off.fixed_rows::<3>(0).norm() < 0.02, "{off}");
    assert!(off.fixed_rows::<3>(3).norm() < 0.005, "{off}");
}
