//! Pose of a LiDAR to a camera, from views of a board that both see.
//!
//! In each scan `scan_grid` and `candidates` find what could be the board, `association` says which of them is, by the one
//! transform that takes all poses of the camera's boards there. `adjustment` then moves transform and boards until corners,
//! planes and outlines agree, with weights from the spread that each of the three leaves.

mod adjustment;
mod association;
mod board_view;
mod candidates;
mod outline;
mod page;
mod plane;
mod poses;
mod residuals;
mod scan_grid;
mod summary;

use std::collections::BTreeMap;

use lsfb_geometry::{Camera, Se3, Vector3};
use lsfb_types::{LidarScan, Progress, ProgressFn};
use nalgebra::Matrix6;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::detect::Corner;
use crate::target::Target;

pub use poses::{poses_from_folder, poses_from_recording};

/// The plate that the pattern is fixed on: the LiDAR sees its outline, not the pattern.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Board {
    /// The pattern.
    pub target: Target,
    /// Edge of the plate along the pattern's x axis, metres.
    pub width_m: f64,
    /// Edge of the plate along the pattern's y axis, metres.
    pub height_m: f64,
    /// Middle of the plate from the middle of the corners, along the pattern's axes, metres.
    pub offset_m: [f64; 2],
}

/// One pose of the board: what the camera and the LiDAR saw of it, both at rest.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardPose {
    /// Name for reports: of the image, or its time.
    pub name: String,
    /// Corners in the image.
    pub corners: Vec<Corner>,
    /// The scan.
    pub scan: LidarScan,
}

/// Settings of [`calibrate_lidar_camera`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LidarCameraConfig {
    /// Standard deviation of one range that is expected, metres; what is found is reported.
    pub range_noise_m: f64,
    /// Step in range between neighbours that ends a surface, metres.
    pub jump_m: f64,
    /// Farthest board looked for, metres.
    pub max_range_m: f64,
    /// Poses needed.
    pub min_poses: usize,
    /// Largest error of a single edge point that is believed before adjustment, metres.
    pub max_edge_error_m: f64,
    /// Normals of the boards must differ by this much about two axes, degrees.
    pub min_tilt_deg: f64,
}

impl Default for LidarCameraConfig {
    fn default() -> Self {
        Self {
            range_noise_m: 0.03,
            jump_m: 0.15,
            max_range_m: 15.0,
            min_poses: 3,
            max_edge_error_m: 0.05,
            min_tilt_deg: 4.0,
        }
    }
}

/// How one pose fits.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PoseFit {
    /// The pose.
    pub name: String,
    /// Whether it was used; else why not.
    pub rejected: Option<String>,
    /// Distance of the board from the LiDAR, metres.
    pub distance_m: f64,
    /// Points of the scan on the board.
    pub points: usize,
    /// Points on its outline that were used.
    pub edges: usize,
    /// Distance between the middle of the board as the LiDAR alone has it and as the camera alone has it, metres.
    pub center_error_m: f64,
    /// Angle between the normals as each sensor alone has them, radians.
    pub normal_error_rad: f64,
    /// Root mean square of the reprojection error of the corners, pixels.
    pub corner_rms_px: f64,
}

/// Pose of the LiDAR to the camera, and how far it may be trusted.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LidarCameraCalibration {
    /// Name of the camera.
    pub camera: String,
    /// The transform: takes points of the LiDAR to the camera.
    #[serde(skip)]
    pub camera_from_lidar: Se3,
    /// Covariance of [`LidarCameraCalibration::camera_from_lidar`], rotation (rad) then translation (m), perturbed on the
    /// right: in LiDAR axes.
    #[serde(skip)]
    pub covariance: Matrix6<f64>,
    /// Its standard deviations, rotation (rad) then translation (m), in LiDAR axes.
    pub sigma: [f64; 6],
    /// By pose, in the order given.
    pub poses: Vec<PoseFit>,
    /// Root mean square of [`PoseFit::center_error_m`] over the poses used, metres.
    pub center_rms_m: f64,
    /// Root mean square distance from the plane along the ray over all points, metres.
    pub range_noise_m: f64,
    /// Standard deviation of what all points of one beam on one board have in common, metres.
    pub beam_noise_m: f64,
    /// By how much the ranges of beams are too long, by ring, metres: found along with the pose, and taken off; those of which
    /// nothing is known are not in it.
    pub beam_offsets_m: BTreeMap<u16, f64>,
    /// By how much half the plate looks wider and higher to the LiDAR than was said, metres: width of the beam, or a wrong
    /// size.
    pub edge_excess_m: [f64; 2],
    /// Standard deviations of [`LidarCameraCalibration::edge_excess_m`], metres.
    pub edge_excess_sigma_m: [f64; 2],
    /// By how much all ranges are too long, metres.
    pub range_excess_m: f64,
    /// Standard deviation of [`LidarCameraCalibration::range_excess_m`], metres.
    pub range_excess_sigma_m: f64,
    /// Size of the camera's scene over the LiDAR's, from the middles of the boards; 1 where the squares have the size said.
    pub scale: f64,
    /// Standard deviation of [`LidarCameraCalibration::scale`].
    pub scale_sigma: f64,
    /// Factors on the expected spread of corners, planes and edges, from what they left.
    pub spread: [f64; 3],
    /// Rotation between solutions from every other pose, radians; `None` with too few poses.
    pub halves_rotation_rad: Option<f64>,
    /// Translation between the same, metres.
    pub halves_translation_m: Option<f64>,
    /// What should be recorded better, in words.
    pub warnings: Vec<String>,
}

/// A board as one camera sees it.
struct InCamera {
    camera_from_board: Se3,
    /// Information of its tangent, for corners of unit variance.
    information: Matrix6<f64>,
    rms_px: f64,
}

/// Everything about a pose that later steps read.
struct Scene {
    name: String,
    in_camera: InCamera,
    in_lidar: Vec<candidates::Patch>,
}

/// Finds the pose of a LiDAR to a camera whose lens is known. The order of poses does not matter.
pub fn calibrate_lidar_camera(
    board: &Board,
    name: &str,
    camera: &Camera,
    poses: &[BoardPose],
    config: &LidarCameraConfig,
    progress: ProgressFn,
) -> Result<LidarCameraCalibration, Error> {
    board.check()?;
    let mut scenes = scenes(board, name, camera, poses, config, progress)?;
    // One order, whatever was given: sums of floats depend on it.
    let mut order: Vec<usize> = (0..scenes.len()).collect();
    order.sort_by(|a, b| scenes[*a].name.cmp(&scenes[*b].name));
    let mut slots: Vec<Option<Scene>> = scenes.drain(..).map(Some).collect();
    let scenes: Vec<Scene> = order.iter().filter_map(|k| slots[*k].take()).collect();

    let joined = association::join(board, name, &scenes, config)?;
    let solved = adjustment::adjust(board, name, &scenes, &joined, config)?;
    let mut calibration = summary::summarize(board, name, &scenes, &joined, &solved, config)?;
    let mut fits: Vec<Option<PoseFit>> = calibration.poses.drain(..).map(Some).collect();
    let mut back = vec![None; fits.len()];
    for (place, original) in order.iter().enumerate() {
        back[*original] = fits[place].take();
    }
    calibration.poses = back.into_iter().flatten().collect();
    Ok(calibration)
}

fn scenes(
    board: &Board,
    name: &str,
    camera: &Camera,
    poses: &[BoardPose],
    config: &LidarCameraConfig,
    progress: ProgressFn,
) -> Result<Vec<Scene>, Error> {
    let done = std::sync::atomic::AtomicU64::new(0);
    let seen: Vec<Option<Scene>> = poses
        .par_iter()
        .map(|pose| {
            let scene = board_view::view(board, camera, &pose.corners).map(|in_camera| Scene {
                name: pose.name.clone(),
                in_camera,
                in_lidar: candidates::find(board, &pose.scan, config),
            });
            progress(Progress {
                stage: "boards",
                done: done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1,
                total: poses.len() as u64,
            });
            scene
        })
        .collect();
    let found = seen.iter().flatten().count();
    if found < config.min_poses {
        return Err(Error::TargetNotSeen {
            camera: name.to_owned(),
            found,
            images: poses.len(),
            needed: config.min_poses,
            target: crate::camera::describe(&board.target),
        });
    }
    Ok(seen
        .into_iter()
        .zip(poses)
        .map(|(scene, pose)| {
            // A pose that the camera did not see stays in the list, to be named.
            scene.unwrap_or_else(|| Scene {
                name: pose.name.clone(),
                in_camera: InCamera {
                    camera_from_board: Se3::identity(),
                    information: Matrix6::zeros(),
                    rms_px: f64::NAN,
                },
                in_lidar: Vec::new(),
            })
        })
        .collect())
}

impl Scene {
    fn seen_by_camera(&self) -> bool {
        self.in_camera.rms_px.is_finite()
    }

    /// Normal of the board in the camera, towards it.
    fn normal_in_camera(&self) -> Vector3<f64> {
        let pose = &self.in_camera.camera_from_board;
        let z = pose.rotation * Vector3::z();
        if z.dot(&pose.translation) > 0.0 {
            -z
        } else {
            z
        }
    }
}

impl Board {
    fn check(&self) -> Result<(), Error> {
        let target = |problem: String| Err(Error::Target { problem });
        if let Some(problem) = self.target.problem() {
            return target(problem);
        }
        let size = self.target.corners_size();
        let room = [self.width_m - size[0], self.height_m - size[1]];
        let fits =
            (0..2).all(|k| room[k].is_finite() && room[k] + 1e-9 >= 2.0 * self.offset_m[k].abs());
        if !fits {
            return target(format!(
                "a plate of {:.0} × {:.0} mm does not hold corners over {:.0} × {:.0} mm: give its width along the pattern's x axis, then its height",
                self.width_m * 1e3,
                self.height_m * 1e3,
                size[0] * 1e3,
                size[1] * 1e3
            ));
        }
        Ok(())
    }

    /// A corner in the board's frame: its origin is the middle of the plate, its axes are the pattern's.
    fn corner(&self, index: usize) -> Vector3<f64> {
        let size = self.target.corners_size();
        let middle = Vector3::new(0.5 * size[0], 0.5 * size[1], 0.0);
        let offset = Vector3::new(self.offset_m[0], self.offset_m[1], 0.0);
        self.target.corner(index) - middle - offset
    }
}

#[cfg(test)]
mod tests;
