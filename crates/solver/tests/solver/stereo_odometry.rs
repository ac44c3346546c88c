//! Stereo factors of a real drive.

use lsfb_geometry::{Se3, Vector3, Vector6};
use lsfb_problems::stereo;
use lsfb_solver::{SolveConfig, check_residual_jacobian, solve};

use crate::recordings;

check_residual_jacobian!(
    stereo_observation,
    stereo::StereoObservation {
        camera: stereo::StereoCamera {
            focal_px: [450.0, 460.0],
            centre_px: [320.0, 240.0],
            baseline_m: 0.5,
        },
        measured_px: Vector3::new(300.0, 280.0, 210.0),
    },
    Se3::exp(&Vector6::new(-0.1, 0.2, 0.1, 0.5, 0.1, -2.0)),
    Vector3::new(1.0, 0.5, 6.0),
);

/// The cost that GTSAM 4.3 begins with and the one it ends at (`benches/solver/gtsam_stereo.py`), where it stops early.
#[test]
fn kitti_goes_below_the_cost_of_gtsam() {
    let test = "kitti_goes_below_the_cost_of_gtsam";
    let read = |name: &str| recordings::text(test, &format!("vision/kitti_gtsam/{name}00s.txt.gz"));
    let Some(calibration) = read("VO_calibration") else {
        return;
    };
    let (Some(poses), Some(factors)) = (read("VO_camera_poses"), read("VO_stereo_factors")) else {
        return;
    };
    let texts = stereo::Texts {
        calibration,
        poses,
        factors,
    };
    let mut problem = stereo::parse(&texts).expect("stereo factors");
    let report = solve(&mut problem, &SolveConfig::default()).expect("solves");
    assert!(
        (report.initial_cost / 30785.8465 - 1.0).abs() < 1e-5,
        "{report:?}"
    );
    assert!(
        report.final_cost <= 6239.6 && report.final_cost > 6239.0,
        "{report:?}"
    );
}
