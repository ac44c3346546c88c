//! Boards photographed by others, with known results.

#![allow(clippy::print_stdout, reason = "a skipped test says so")]

use std::path::{Path, PathBuf};

use lsfb_calib::Target;
use lsfb_calib::camera::{CameraConfig, CameraViews, calibrate_cameras, views_from_folder};
use lsfb_geometry::camera::LensModel;
use lsfb_types::no_progress;

fn data(test: &str, folder: &str) -> Option<PathBuf> {
    let root = std::env::var_os("LSFB_TEST_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let path = root.join(folder);
    if !path.exists() {
        println!("skipped: {test}: no recording at {}", path.display());
        return None;
    }
    Some(path)
}

fn views(folder: &Path, prefix: &str, target: &Target) -> CameraViews {
    views_from_folder(prefix, folder, prefix, target, &no_progress).expect("images")
}

#[test]
fn opencv_stereo_pairs() {
    let Some(folder) = data("opencv_stereo_pairs", "vision/calib_opencv_stereo") else {
        return;
    };
    let target = Target::Checkerboard {
        columns: 9,
        rows: 6,
        square_m: 1.0,
    };
    let config = CameraConfig {
        model: LensModel::PinholeRadtan,
        ..CameraConfig::default()
    };
    let both = ["left", "right"].map(|side| views(&folder, side, &target));
    assert!(both.iter().all(|v| v.views.len() == 13));
    let calibration = calibrate_cameras(&target, &both, &config, &no_progress).expect("calibrated");
    for (one, bar) in both.iter().zip([0.41, 0.46]) {
        let alone = calibrate_cameras(&target, std::slice::from_ref(one), &config, &no_progress)
            .expect("calibrated");
        assert!(alone.rms_px <= bar, "{} {}", one.name, alone.rms_px);
    }
    assert!(calibration.rms_px <= 0.45);
    let [left, right] = &calibration.cameras[..] else {
        panic!("two cameras")
    };
    // OpenCV's own result (EXPECTED.md).
    for (k, expected) in [536.1, 536.0, 342.4, 235.5].into_iter().enumerate() {
        assert!(
            (left.parameters[k].value - expected).abs() < 4.0,
            "{:?}",
            left.parameters[k]
        );
    }
    assert!((right.camera_from_first.translation.norm() - 3.345).abs() < 0.03);
}

#[test]
fn camodocal_fisheye() {
    let Some(folder) = data("camodocal_fisheye", "vision/calib_camodocal_fisheye") else {
        return;
    };
    let target = Target::Checkerboard {
        columns: 9,
        rows: 6,
        square_m: 0.1,
    };
    let views = views(&folder, "img", &target);
    assert!(views.views.len() >= 19);
    let config = CameraConfig::default();
    assert_eq!(config.model, LensModel::KannalaBrandt);
    let calibration =
        calibrate_cameras(&target, &[views], &config, &no_progress).expect("calibrated");
    assert!(calibration.rms_px <= 0.43, "{}", calibration.rms_px);
    // All 63 images by other tools (EXPECTED.md).
    let parameters = &calibration.cameras[0].parameters;
    for (p, expected) in parameters.iter().zip([383.7, 384.8, 639.4, 477.4]) {
        assert!((p.value - expected).abs() < 2.0, "{p:?}");
    }
}

#[test]
fn tum_vi_stereo() {
    let Some(folder) = data("tum_vi_stereo", "vision/tumvi_calib_imu1/mav0") else {
        return;
    };
    let target = Target::AprilGrid {
        columns: 6,
        rows: 6,
        tag_size_m: 0.088,
        spacing_ratio: 0.3,
    };
    let both = ["cam0", "cam1"].map(|c| {
        let found = views_from_folder(c, &folder.join(c).join("data"), "", &target, &no_progress);
        found.expect("images")
    });
    assert!(both.iter().all(|v| v.views.len() == 400));
    let config = CameraConfig::default();
    let calibration = calibrate_cameras(&target, &both, &config, &no_progress).expect("calibrated");
    assert!(calibration.rms_px <= 0.2);
}
