//! The rigs: where their sensors sit.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use lsfb_geometry::camera::{Camera, Lens};
use lsfb_geometry::{ImuNoiseModel, Rig, RigCamera, RigImu, RigLidar, Se3};

use crate::calendar::EPOCH;
use crate::config::{CameraConfig, Device, ImuConfig, LensKind, SimConfig};

/// Exact from the beginning on.
const CALIBRATED: Option<i64> = Some(EPOCH.nanos() / 1_000_000_000);

/// The backpack: a VLP-32C on top, four cameras looking forward, left, back and right, the IMU in the middle.
///
/// One stereo unit holds `cam0` (forward) and `cam1` (left), the other `cam2` (back) and `cam3` (right).
pub fn backpack(config: &SimConfig) -> Rig {
    // Mounting angles as a workshop leaves them, degrees: yaw, pitch, roll.
    let mounts = [
        ("cam0", [0.8, 1.5, -0.6], [0.11, 0.012, 0.15]),
        ("cam1", [89.2, 1.1, 0.9], [0.008, 0.105, 0.151]),
        ("cam2", [180.9, 2.0, 0.5], [-0.108, -0.009, 0.149]),
        ("cam3", [269.4, 1.3, -0.8], [-0.011, -0.104, 0.15]),
    ];
    Rig {
        name: "backpack".into(),
        calibrated_unix_s: CALIBRATED,
        cameras: cameras(
            &mounts,
            &config.scan_cameras,
            [-0.021, 0.0061, -0.0032, 0.0004],
        ),
        imus: RigImu::from(imu(&config.scan_imu)).alone(),
        lidars: RigLidar {
            rig_from_lidar: Se3::new(angles([0.7, 3.2, -1.1]), Vector3::new(-0.015, 0.006, 0.35)),
            range_noise_m: config.lidar.range_noise_m,
        }
        .alone(),
    }
}

/// The glasses: two cameras 11 cm apart, turned outwards a little, the IMU between them.
pub fn glasses(config: &SimConfig) -> Rig {
    let mounts = [
        ("cam0", [5.2, -2.0, 0.4], [0.012, 0.055, 0.004]),
        ("cam1", [-4.9, -1.8, -0.5], [0.012, -0.055, 0.003]),
    ];
    Rig {
        name: "glasses".into(),
        calibrated_unix_s: CALIBRATED,
        cameras: cameras(
            &mounts,
            &config.glasses_cameras,
            [-0.013, 0.0042, -0.0024, 0.0003],
        ),
        imus: RigImu::from(imu(&config.glasses_imu)).alone(),
        lidars: BTreeMap::new(),
    }
}

/// The device of the second walk.
pub fn walker(config: &SimConfig) -> Rig {
    match config.device {
        Device::Glasses => glasses(config),
        phone => Rig {
            name: phone.name().to_owned(),
            ..phone_rig(config)
        },
    }
}

/// A phone held upright before the chest: one camera, the IMU behind it.
fn phone_rig(config: &SimConfig) -> Rig {
    let mounts = [("cam0", [0.9, -4.0, 0.3], [0.006, 0.021, 0.048])];
    Rig {
        name: "phone".into(),
        calibrated_unix_s: CALIBRATED,
        cameras: cameras(&mounts, &config.glasses_cameras, [0.0; 4]),
        imus: RigImu::from(imu(&config.glasses_imu)).alone(),
        lidars: BTreeMap::new(),
    }
}

fn imu(config: &ImuConfig) -> ImuNoiseModel {
    ImuNoiseModel {
        gyro_noise_density: config.gyro_noise_density,
        accel_noise_density: config.accel_noise_density,
        gyro_bias_walk: config.gyro_bias_walk,
        accel_bias_walk: config.accel_bias_walk,
    }
}

fn angles([yaw, pitch, roll]: [f64; 3]) -> UnitQuaternion<f64> {
    UnitQuaternion::from_euler_angles(roll.to_radians(), pitch.to_radians(), yaw.to_radians())
}

/// Cameras by name, with yaw, pitch, roll in degrees (0: forward) and position in metres.
fn cameras(
    mounts: &[(&str, [f64; 3], [f64; 3])],
    config: &CameraConfig,
    distortion: [f64; 4],
) -> BTreeMap<String, RigCamera> {
    // A camera that looks forward: its z along the rig's x, its x along −y, its y along −z.
    let forward = Rotation3::from_matrix_unchecked(Matrix3::new(
        0.0, 0.0, 1.0, //
        -1.0, 0.0, 0.0, //
        0.0, -1.0, 0.0,
    ));
    let forward = UnitQuaternion::from_rotation_matrix(&forward);
    let (width, height) = (f64::from(config.width), f64::from(config.height));
    mounts
        .iter()
        .enumerate()
        .map(|(k, (name, ypr, position))| {
            // No two lenses are alike.
            let odd = k as f64 - 1.5;
            let focal = config.focal_per_width * width * (1.0 + 0.0013 * odd);
            let focal_px = [focal, focal * 1.0006];
            let principal_px = [
                0.5 * width - 0.5 + 0.0031 * width * odd,
                0.5 * height - 0.5 - 0.0042 * height * odd,
            ];
            let camera = Camera {
                width: config.width,
                height: config.height,
                lens: match config.lens {
                    LensKind::KannalaBrandt => Lens::KannalaBrandt {
                        focal_px,
                        principal_px,
                        distortion: distortion.map(|d| d * (1.0 + 0.05 * odd)),
                    },
                    // As fitted to phones: a little barrel, a little off centre.
                    LensKind::PinholeRadtan => Lens::PinholeRadtan {
                        focal_px,
                        principal_px,
                        distortion: [0.071, -0.162, 0.0006, -0.0004, 0.041],
                    },
                },
            };
            let pose = Se3::new(angles(*ypr) * forward, Vector3::from(*position));
            (
                (*name).to_owned(),
                RigCamera {
                    camera,
                    rig_from_camera: pose,
                    timing: Default::default(),
                    sigmas: Default::default(),
                },
            )
        })
        .collect()
}
