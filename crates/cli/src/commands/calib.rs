//! `lsfb calib`: boards, images → rig.

use crate::context::Context;
use crate::outcome::Outcome;

use super::{
    calib_camera, calib_camera_imu, calib_exchange, calib_imu_noise, calib_joint,
    calib_lidar_camera, calib_refine, calib_target, calib_verify,
};

/// Calibrate cameras, IMU and LiDAR: print a board, estimate, join and verify.
///
/// All lengths are in metres. docs/calibration.md explains each step.
///
/// Examples (a whole rig, in order):
///   lsfb calib target --april-grid 6,6,0.088,0.3 --page-m 0.841,0.841 --out grid.pdf
///   lsfb calib camera --target grid.yaml --recording board.mcap --camera cam0 --camera cam1 --out rig.toml
///   lsfb calib imu-noise --recording rest.mcap --out noise.html --rig rig.toml --out-rig rig.toml
///   lsfb calib camera-imu --target grid.yaml --rig rig.toml --recording board.mcap --camera cam0 --camera cam1 --out rig2.toml
///   lsfb calib lidar-camera --target grid.yaml --plate-m 0.83,0.75 --camera cam0 --recording poses.mcap --rig rig2.toml --out rig3.toml
///   lsfb calib joint --rig rig3.toml --transform rig3.cam0-lidar.json --out joined.toml
///   lsfb calib verify walk.mcap --rig joined.toml
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    step: Step,
}

#[derive(clap::Subcommand)]
enum Step {
    Target(calib_target::Arguments),
    Camera(calib_camera::Arguments),
    CameraImu(calib_camera_imu::Arguments),
    ImuNoise(calib_imu_noise::Arguments),
    LidarCamera(calib_lidar_camera::Arguments),
    Joint(calib_joint::Arguments),
    Verify(calib_verify::Arguments),
    Refine(calib_refine::Arguments),
    Import(calib_exchange::ImportArguments),
    Export(calib_exchange::ExportArguments),
}

/// Runs the step.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    match &arguments.step {
        Step::Target(a) => calib_target::run(a, context),
        Step::Camera(a) => calib_camera::run(a, context),
        Step::CameraImu(a) => calib_camera_imu::run(a, context),
        Step::ImuNoise(a) => calib_imu_noise::run(a, context),
        Step::LidarCamera(a) => calib_lidar_camera::run(a, context),
        Step::Joint(a) => calib_joint::run(a, context),
        Step::Verify(a) => calib_verify::run(a, context),
        Step::Refine(a) => calib_refine::run(a, context),
        Step::Import(a) => calib_exchange::run_import(a, context),
        Step::Export(a) => calib_exchange::run_export(a, context),
    }
}
