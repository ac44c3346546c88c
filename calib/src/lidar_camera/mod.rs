//! Pose of a LiDAR to a camera, from views of a board that both see.
//!
//! In each scan `scan_grid` and `candidates` find what could be the board, `association` says which of them is, by the one
//! transform that takes all poses of the camera's boards there. `adjustment` then moves transform and boards until corners,
//! planes and outlines agree, with weights from the spread that each of the three leaves. Where the board was not at rest,
//! `motion` then puts every return where it would be at the image's time, and all is done again.

mod adjustment;
mod association;
mod board_view;
mod candidates;
mod checks;
mod clocks;
mod halves;
mod lens_bias;
mod motion;
mod outline;
mod page;
mod picture;
mod plane;
mod poses;
mod problem;
mod residuals;
mod scan_grid;
mod shades;
mod solved;
mod summary;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use lsfb_geometry::{Camera, Se3, Vector3};
use lsfb_types::{Bounds, Finding, LidarScan, ProgressFn, SharedProgress};
use nalgebra::Matrix6;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::board::Target;
use crate::detect::Corner;
use crate::{Error, TargetProblem};
use motion::Track;

pub use poses::{RecordingConfig, poses_from_folder, poses_from_recording};

/// The plate that the pattern is fixed on: the LiDAR sees its outline, not the pattern.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MountedBoard {
    /// The pattern.
    pub target: Target,
    /// Edge of the plate along the pattern's x axis, metres.
    pub width_m: f64,
    /// Edge of the plate along the pattern's y axis, metres.
    pub height_m: f64,
    /// Middle of the plate from the middle of the corners, along the pattern's axes, metres.
    pub offset_m: [f64; 2],
}

/// One pose of the board: what the camera and the LiDAR saw of it.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardPose {
    /// Name for reports: of the image, or its time.
    pub name: String,
    /// The board in images around the scan, in order of time. A single one: the board was at rest to the rig.
    pub sights: Vec<BoardSight>,
    /// The scan.
    pub scan: LidarScan,
}

/// The board in one image.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardSight {
    /// Number of the image, or its stamp in nanoseconds, as its [`CameraViews`](crate::camera::CameraViews) has it.
    pub instant: i64,
    /// Time of the image after the scan's first firing, nanoseconds; of no account where it is the only one.
    pub time_offset_ns: i64,
    /// Its corners.
    pub corners: Vec<Corner>,
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

lsfb_types::bounds! {
    LidarCameraConfig {
        range_noise_m: number(Bounds::POSITIVE),
        jump_m: number(Bounds::POSITIVE),
        max_range_m: number(Bounds::POSITIVE),
        min_poses: any,
        max_edge_error_m: number(Bounds::POSITIVE),
        min_tilt_deg: number(Bounds::NOT_NEGATIVE),
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
    /// Root mean square of [`PoseFit::corner_rms_px`] over the poses used, pixels.
    pub corner_rms_px: f64,
    /// Root mean square of [`PoseFit::center_error_m`] over the poses used, metres.
    pub center_rms_m: f64,
    /// Root mean square distance from the plane along the ray over all points, metres.
    pub range_noise_m: f64,
    /// Standard deviation of what all points of one beam on one board have in common, metres.
    pub beam_noise_m: f64,
    /// By how much the ranges of beams are too long, by ring, metres: found along with the pose, and taken off; those of which
    /// nothing is known are not in it.
    pub beam_offsets_m: BTreeMap<u16, f64>,
    /// By how much ranges to dark parts of the board are longer than those to bright ones, metres: found along with the pose, and taken
    /// off; `None` where that is not clear.
    pub dark_excess_m: Option<f64>,
    /// Standard deviation of [`LidarCameraCalibration::dark_excess_m`], metres.
    pub dark_excess_sigma_m: Option<f64>,
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
    /// Root mean square of the distance between the middles on poses that were held back from the solution they are judged by,
    /// a quarter at a time, metres; `None` with too few poses.
    pub holdout_center_rms_m: Option<f64>,
    /// The same of the angle between normals, radians.
    pub holdout_normal_rms_rad: Option<f64>,
    /// By how much the plate's middle lies elsewhere on the pattern than was said, along the pattern's axes, metres: a wrong
    /// offset, or a pattern that is upside down on its plate.
    pub offset_error_m: [f64; 2],
    /// Standard deviations of [`LidarCameraCalibration::offset_error_m`], metres: large where the board was always held upright.
    pub offset_error_sigma_m: [f64; 2],
    /// By how much the LiDAR's times are late against the camera's, as boards that moved have it, seconds; `None` where all were
    /// at rest.
    pub lidar_late_s: Option<f64>,
    /// Standard deviation of [`LidarCameraCalibration::lidar_late_s`], seconds.
    pub lidar_late_sigma_s: Option<f64>,
    /// Corners of the poses used per part of the image (12 × 8), by rows from the upper left.
    pub cells: Vec<u32>,
    /// Size of the image, pixels.
    pub image_px: [u32; 2],
    /// What the plots show.
    #[serde(skip)]
    pub residuals: BoardResiduals,
    /// What was looked at, and how it came out.
    #[serde(skip)]
    pub findings: Vec<Finding>,
}

/// What all poses used leave, for plots.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BoardResiduals {
    /// Ranges of all returns on boards less those of the planes found, metres.
    pub ranges_m: Vec<f64>,
    /// Distances of the places on the outlines from them, outwards, metres.
    pub edges_m: Vec<f64>,
    /// Middle of the board in the image as the camera alone has it, and as the LiDAR alone, pixels, by pose used.
    pub centers_px: Vec<[[f64; 2]; 2]>,
}

/// A board as one camera sees it.
struct InCamera {
    camera_from_board: Se3,
    /// Information of its tangent, for corners of unit variance.
    information: Matrix6<f64>,
    rms_px: f64,
}

/// Everything about a pose that later steps read.
struct Scene<'a> {
    name: String,
    in_camera: InCamera,
    /// Corners of the image that stands for the scan.
    corners: &'a [Corner],
    track: Track,
    /// The pose whose image this one has as well: it says nothing more.
    copy_of: Option<String>,
    scan: &'a LidarScan,
    in_lidar: Vec<candidates::Patch>,
}

/// Rounds in which the returns of boards that moved are put where they would be at the image's time.
const MOTION_ROUNDS: usize = 2;

/// Finds the pose of a LiDAR to a camera whose lens is known. The order of poses does not matter.
pub fn calibrate_lidar_camera(
    board: &MountedBoard,
    name: &str,
    camera: &Camera,
    poses: &[BoardPose],
    config: &LidarCameraConfig,
    progress: ProgressFn,
) -> Result<LidarCameraCalibration, Error> {
    config.check_bounds("lidar_camera")?;
    board.check()?;
    // One order, whatever was given: sums of floats depend on it.
    let mut order: Vec<usize> = (0..poses.len()).collect();
    order.sort_by(|a, b| in_order(&poses[*a], &poses[*b]));
    let sorted: Vec<&BoardPose> = order.iter().map(|k| &poses[*k]).collect();

    let mut scenes = scenes(board, name, camera, &sorted, config, progress)?;
    let mut joined = association::join(board, name, &scenes, config)?;
    let mut solved = adjustment::adjust(board, name, &scenes, &joined, config)?;
    if scenes.iter().any(|s| s.track.moved()) {
        for _ in 0..MOTION_ROUNDS {
            hold_still(board, &mut scenes, &solved.camera_from_lidar, config);
            joined = association::join(board, name, &scenes, config)?;
            solved = adjustment::adjust(board, name, &scenes, &joined, config)?;
        }
    }
    lens_bias::widen(
        board,
        name,
        camera,
        &mut scenes,
        &joined,
        &mut solved,
        config,
    );
    let mut calibration =
        summary::summarize(board, name, camera, &scenes, &joined, &solved, config)?;
    // Back in the order given.
    let mut fits: Vec<(usize, PoseFit)> = order.into_iter().zip(calibration.poses).collect();
    fits.sort_by_key(|f| f.0);
    calibration.poses = fits.into_iter().map(|f| f.1).collect();
    Ok(calibration)
}

/// By name; what is in them decides between poses of one name.
fn in_order(a: &BoardPose, b: &BoardPose) -> std::cmp::Ordering {
    let key = |p: &BoardPose| {
        let lowest = |s: &BoardSight| s.corners.iter().min_by_key(|c| c.index).map(|c| c.pixel);
        let pixel = p.sights.first().and_then(lowest).unwrap_or_default();
        (p.scan.points.len(), pixel)
    };
    let ((points_a, pixel_a), (points_b, pixel_b)) = (key(a), key(b));
    a.name
        .cmp(&b.name)
        .then(points_a.cmp(&points_b))
        .then(pixel_a.x.total_cmp(&pixel_b.x))
        .then(pixel_a.y.total_cmp(&pixel_b.y))
}

fn scenes<'a>(
    board: &MountedBoard,
    name: &str,
    camera: &Camera,
    poses: &[&'a BoardPose],
    config: &LidarCameraConfig,
    progress: ProgressFn,
) -> Result<Vec<Scene<'a>>, Error> {
    let copies = poses::copied(poses);
    let done = SharedProgress::new("boards", poses.len(), progress);
    let looked: Result<Vec<Scene>, Error> = poses
        .par_iter()
        .enumerate()
        .map(|(k, pose)| {
            let scene = match copies.get(&k) {
                Some(first) => Scene::copy(pose, &poses[*first].name),
                None => Scene::new(board, camera, pose, config),
            };
            done.one_more()?;
            Ok(scene)
        })
        .collect();
    let scenes = looked?;
    let found = scenes.iter().filter(|s| s.seen_by_camera()).count();
    if found < config.min_poses {
        return Err(Error::TargetNotSeen {
            camera: name.to_owned(),
            found,
            images: poses.len(),
            needed: config.min_poses,
            target: board.target.describe(),
        });
    }
    Ok(scenes)
}

/// Looks for the boards again where they would have been, had they not moved.
fn hold_still(
    board: &MountedBoard,
    scenes: &mut [Scene],
    camera_from_lidar: &Se3,
    config: &LidarCameraConfig,
) {
    scenes
        .par_iter_mut()
        .filter(|s| s.track.moved())
        .for_each(|scene| {
            let scan = scene.track.at_rest(scene.scan, camera_from_lidar);
            scene.in_lidar = candidates::find(board, &scan, config);
        });
}

impl<'a> Scene<'a> {
    /// A pose with the image of another one stays in the list, to be named.
    fn copy(pose: &'a BoardPose, of: &str) -> Self {
        Self {
            name: pose.name.clone(),
            in_camera: InCamera::nothing(),
            corners: &[],
            track: Track::new(&pose.scan, std::iter::empty()),
            copy_of: Some(of.to_owned()),
            scan: &pose.scan,
            in_lidar: Vec::new(),
        }
    }

    /// A pose that the camera did not see stays in the list, to be named.
    fn new(
        board: &MountedBoard,
        camera: &Camera,
        pose: &'a BoardPose,
        config: &LidarCameraConfig,
    ) -> Self {
        let seen: Vec<(f64, &[Corner], InCamera)> = pose
            .sights
            .iter()
            .filter_map(|s| {
                let in_camera = board_view::view(board, camera, &s.corners)?;
                Some((s.time_offset_ns as f64 * 1e-9, &s.corners[..], in_camera))
            })
            .collect();
        let track = Track::new(
            &pose.scan,
            seen.iter().map(|s| (s.0, s.2.camera_from_board)),
        );
        // A board that moved, but was seen once only, is where nobody knows.
        let lost = pose.sights.len() > 1 && !track.moved();
        let chosen = seen.into_iter().nth(track.chosen()).filter(|_| !lost);
        let (in_camera, corners, in_lidar) = match chosen {
            Some((_, corners, in_camera)) => {
                let in_lidar = candidates::find(board, &pose.scan, config);
                (in_camera, corners, in_lidar)
            }
            None => (InCamera::nothing(), &[][..], Vec::new()),
        };
        Self {
            name: pose.name.clone(),
            in_camera,
            corners,
            track,
            copy_of: None,
            scan: &pose.scan,
            in_lidar,
        }
    }
}

impl InCamera {
    fn nothing() -> Self {
        Self {
            camera_from_board: Se3::identity(),
            information: Matrix6::zeros(),
            rms_px: f64::NAN,
        }
    }
}

impl Scene<'_> {
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

impl MountedBoard {
    fn check(&self) -> Result<(), Error> {
        if let Some(problem) = self.target.problem() {
            return Err(problem.into());
        }
        let size = self.target.corners_size();
        let room = [self.width_m - size[0], self.height_m - size[1]];
        let fits =
            (0..2).all(|k| room[k].is_finite() && room[k] + 1e-9 >= 2.0 * self.offset_m[k].abs());
        if !fits {
            let problem = TargetProblem::SmallPlate {
                plate_m: [self.width_m, self.height_m],
                corners_m: size,
            };
            return Err(problem.into());
        }
        Ok(())
    }

    /// A corner in the board's frame: its origin is the middle of the plate, its axes are the pattern's.
    pub fn corner(&self, index: usize) -> Vector3<f64> {
        let size = self.target.corners_size();
        let middle = Vector3::new(0.5 * size[0], 0.5 * size[1], 0.0);
        let offset = Vector3::new(self.offset_m[0], self.offset_m[1], 0.0);
        self.target.corner(index) - middle - offset
    }
}
