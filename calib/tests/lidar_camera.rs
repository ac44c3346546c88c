//! A board that a camera and a VLP-16 of others saw.

use lsfb_calib::Target;
use lsfb_calib::camera::views_from_folder;
use lsfb_calib::exchange::import_camera_info;
use lsfb_calib::lidar_camera::{
    LidarCameraConfig, MountedBoard, calibrate_lidar_camera, poses_from_folder,
};
use lsfb_types::no_progress;

#[test]
fn acfr_poses_1_to_10() {
    let Some(folder) = lsfb_tests::recordings("acfr_poses_1_to_10", "lidar/acfr_cam_lidar") else {
        return;
    };
    let info = folder.join("camera_info.yaml");
    let text = std::fs::read_to_string(&info).expect("a camera");
    let camera = import_camera_info(&text, "camera_info.yaml").expect("a lens");
    let board = MountedBoard {
        target: Target::Checkerboard {
            columns: 7,
            rows: 5,
            square_m: 0.095,
        },
        width_m: 0.85,
        height_m: 0.61,
        // params.yaml: 2 mm along the shorter side.
        offset_m: [0.0, 0.002],
    };
    let views = views_from_folder(
        "cam0",
        &folder.join("images"),
        "",
        &board.target,
        &no_progress,
    )
    .expect("images");
    let config = LidarCameraConfig::default();
    let poses = poses_from_folder(&views, &folder.join("pcd"), "", "_full.pcd").expect("clouds");
    let found = calibrate_lidar_camera(
        &board,
        "cam0",
        &camera.camera,
        &poses,
        &config,
        &no_progress,
    )
    .expect("calibrated");
    println!("{}", found.judgement().headline(&found.summary()));
    println!("{:?}", found.camera_from_lidar);
    println!("{:?}", found.sigma);
    println!(
        "range {:.1} mm, beam {:.1} mm, all ranges {:.1} mm, excess {:?}, scale {} ± {}, spread {:?}, halves {:?} {:?}",
        1e3 * found.range_noise_m,
        1e3 * found.beam_noise_m,
        1e3 * found.range_excess_m,
        found.edge_excess_m,
        found.scale,
        found.scale_sigma,
        found.spread,
        found.halves_rotation_rad.map(f64::to_degrees),
        found.halves_translation_m
    );
    for pose in &found.poses {
        println!("{pose:?}");
    }
    let used = found.poses.iter().filter(|p| p.rejected.is_none()).count();
    assert!(used >= 9, "{used}");
    assert!(found.center_rms_m <= 0.008, "{}", found.center_rms_m);
    // What two halves of the poses differ by is within the spread of the references.
    let turn = found.halves_rotation_rad.expect("halves").to_degrees();
    let shift = found.halves_translation_m.expect("halves");
    assert!(turn < 0.7 && shift < 0.03, "{turn} {shift}");
}
