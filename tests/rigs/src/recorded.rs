//! Boards that others recorded, and what their files say of boards, cameras and IMUs.

use std::path::Path;

use lsfb_calib::Target;
use lsfb_calib::camera::{CameraCalibration, CameraViews, views_from_folder};
use lsfb_calib::camera_imu::KnownCamera;
use lsfb_calib::exchange::import_camera_info;
use lsfb_calib::lidar_camera::{BoardPose, MountedBoard, poses_from_folder};
use lsfb_geometry::{Camera, ImuNoiseModel};
use lsfb_types::no_progress;

/// The board of TUM VI.
pub const TUM_VI_GRID: Target = Target::AprilGrid {
    columns: 6,
    rows: 6,
    tag_size_m: 0.088,
    spacing_ratio: 0.3,
};

/// Noise of TUM VI's IMU as the data set states it.
pub const TUM_VI_IMU_NOISE: ImuNoiseModel = ImuNoiseModel {
    gyro_noise_density: 0.00016,
    accel_noise_density: 0.0028,
    gyro_bias_walk: 2.2e-5,
    accel_bias_walk: 0.00086,
};

/// What both cameras of a folder of TUM VI saw.
pub fn tum_vi_views(folder: &Path) -> [CameraViews; 2] {
    ["cam0", "cam1"].map(|camera| {
        let images = folder.join(camera).join("data");
        views_from_folder(camera, &images, "", &TUM_VI_GRID, &no_progress).expect("images")
    })
}

/// Cameras with the lenses and poses that were found of the same views.
pub fn with_own_lenses(views: &[CameraViews], lenses: &CameraCalibration) -> Vec<KnownCamera> {
    let known = views
        .iter()
        .zip(&lenses.cameras)
        .map(|(views, c)| KnownCamera {
            views: views.clone(),
            camera: c.camera,
            camera_from_first: c.camera_from_first,
            readout_s: 0.0,
        });
    known.collect()
}

/// The board of acfr_cam_lidar on its plate; params.yaml: 2 mm along the shorter side.
pub const ACFR_BOARD: MountedBoard = MountedBoard {
    target: Target::Checkerboard {
        columns: 7,
        rows: 5,
        square_m: 0.095,
    },
    width_m: 0.85,
    height_m: 0.61,
    offset_m: [0.0, 0.002],
};

/// The camera as acfr_cam_lidar states it, and the poses of the board that camera and LiDAR saw.
pub fn acfr(folder: &Path) -> (Camera, Vec<BoardPose>) {
    let text = std::fs::read_to_string(folder.join("camera_info.yaml")).expect("a camera");
    let camera = import_camera_info(&text, "camera_info.yaml").expect("a lens");
    let (images, target) = (folder.join("images"), &ACFR_BOARD.target);
    let views = views_from_folder("cam0", &images, "", target, &no_progress).expect("images");
    let poses = poses_from_folder(&views, &folder.join("pcd"), "", "_full.pcd").expect("clouds");
    (camera.camera, poses)
}
