//! A board that a camera and a VLP-16 of others saw.

use lsfb_calib::lidar_camera::{LidarCameraConfig, calibrate_lidar_camera};
use lsfb_rigs::recorded::{ACFR_BOARD, acfr};
use lsfb_types::no_progress;

#[test]
fn acfr_poses_1_to_10() {
    let Some(folder) = lsfb_tests::recordings("acfr_poses_1_to_10", "lidar/acfr_cam_lidar") else {
        return;
    };
    let config = LidarCameraConfig::default();
    let (camera, poses) = acfr(&folder);
    let found = calibrate_lidar_camera(&ACFR_BOARD, "cam0", &camera, &poses, &config, &no_progress)
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
