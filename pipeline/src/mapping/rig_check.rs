//! Whether the cameras are what the rig file says, by what the map shows.
//!
//! A camera that is turned by some degrees against the file, or whose focal length is some per cent off, makes points that fit its own
//! images: reprojection errors grow by a tenth of a pixel, and the points stand elsewhere. So when Eq. (4) is solved, it is solved once
//! more with the errors of each camera free: turn, shift, focal length and clock. The LiDAR holds the poses of the keyframes; how points
//! move through the images between them is what tells the errors.

use std::collections::BTreeMap;

use lsfb_geometry::{Rig, RigCamera, Se3, Trajectory, Vector3, so3};
use lsfb_solver::{Block, Problem, covariance};
use lsfb_types::{ProgressFn, Timestamp};
use nalgebra::SMatrix;

use super::adjustment::{Terms, add_keyframes};
use super::camera_error::{
    CLOCK_LIMITS_S, CameraError, FOCAL_LIMITS, SHIFT_LIMITS_M, TURN_LIMITS_DEG,
};
use super::keyframes::Keyframes;
use super::placed_points::triangulate_round;
use super::{MappingConfig, MappingWarning};
use crate::Error;
use crate::features::tracks::Track;
use crate::hd_map::{CERTAIN_VIEWS, FreedCameras, MapPoint, Sights};
use crate::residuals::{CameraCorrection, FrameMotion, MovingCamera, entry};
use crate::solve::solve_or_stop;

/// What is checked.
pub(super) struct Checked<'a> {
    pub rig: &'a Rig,
    pub keyframes: &'a Keyframes,
    pub tracks: &'a [Track],
    /// For the motion around each image.
    pub trajectory: &'a Trajectory,
    pub terms: Terms<'a>,
}

/// What is thought possible, one standard deviation: a rig file with the worst of mistakes that its images still match with.
const TURN_SIGMA_RAD: f64 = 0.1;
const SHIFT_SIGMA_M: f64 = 0.1;
const FOCAL_SIGMA: f64 = 0.1;
const CLOCK_SIGMA_S: f64 = 0.1;
/// Readouts are not searched.
const READOUT_SIGMA_S: f64 = 1e-6;

/// Keeps a point that no camera has before it any more, as its errors change, from being undetermined.
const POINT_SIGMA_M: f64 = 10.0;

/// Points that are triangulated with wrong cameras are wrong, and some are missed: with the errors found they are again.
const ROUNDS: usize = 3;
/// Errors that change by less than this many standard deviations, or this share of what a map bears, are found.
const FOUND_SIGMAS: f64 = 0.5;
const FOUND_SHARE: f64 = 0.25;
/// More observations tell nothing new: all that is common to them is known by then.
const MOST_OBSERVATIONS: usize = 30_000;

/// Time before and after an image from which its motion follows, nanoseconds.
const MOTION_NS: i64 = 10_000_000;

/// The cameras as images show them.
pub(super) struct ShownCameras {
    pub errors: Vec<CameraError>,
    /// Those that have images, with their lenses and places as found.
    rig: Rig,
}

impl ShownCameras {
    /// Where nothing is known of them.
    pub fn none(stated: &Rig) -> Self {
        Self {
            errors: Vec::new(),
            rig: stated.clone(),
        }
    }

    /// The rig with the cameras as found that are other than stated for sure; `None` where none is. A camera whose clock is off stays as it is: its images are
    /// at wrong poses.
    pub fn refined(&self, stated: &Rig) -> Option<Rig> {
        let mut refined = stated.clone();
        let mut any = false;
        for error in self.errors.iter().filter(|error| error.is_refinable()) {
            let found = self.rig.cameras.get(&error.camera);
            let Some((camera, found)) = refined.cameras.get_mut(&error.camera).zip(found) else {
                continue;
            };
            *camera = RigCamera {
                timing: camera.timing,
                ..found.clone()
            };
            any = true;
        }
        any.then_some(refined)
    }
}

/// Finds the errors of all cameras that have images. Where the measurements do not determine them, that is the warning.
pub(super) fn camera_errors(
    checked: &Checked,
    config: &MappingConfig,
    progress: ProgressFn<'_>,
) -> Result<Result<ShownCameras, MappingWarning>, Error> {
    let images = &checked.keyframes.images;
    let mut rig = checked.rig.clone();
    // Images are posed at their own times already.
    for camera in rig.cameras.values_mut() {
        camera.timing = Default::default();
    }
    rig.cameras
        .retain(|name, _| images.iter().any(|image| image.camera == *name));
    let stated = rig.clone();
    let mut errors: Vec<CameraError> = Vec::new();
    for round in 0..ROUNDS {
        let mut points = triangulate_round(&rig, checked.keyframes, checked.tracks, round, config)?;
        points.retain(|point| point.observations.len() >= CERTAIN_VIEWS);
        let counts = counts_of(checked, &points);
        let observations: usize = points.iter().map(|p| p.observations.len()).sum();
        let every = observations.div_ceil(MOST_OBSERVATIONS).max(1);
        let points: Vec<MapPoint> = points.into_iter().step_by(every).collect();
        let found = match solve_round(checked, &rig, &points, config, progress) {
            Err(Error::Solver(error @ lsfb_solver::Error::Undetermined { .. })) => {
                let reason = error.to_string();
                return Ok(Err(MappingWarning::CamerasUndetermined { reason }));
            }
            found => found?,
        };
        let mut rests = true;
        errors.clear();
        for ((name, camera), found) in rig.cameras.iter_mut().zip(found) {
            let counts = counts.get(name.as_str()).copied().unwrap_or_default();
            let settled = found.is_small();
            rests &= settled;
            *camera = MovingCamera::new(camera)
                .corrected(&found.correction)
                .mounted();
            let stated = stated.cameras.get(name).unwrap_or(camera);
            errors.push(error_of(
                name,
                counts,
                (stated, camera),
                &found.covariance,
                settled,
            ));
        }
        if rests {
            break;
        }
    }
    Ok(Ok(ShownCameras { errors, rig }))
}

/// What one camera is off by, and how well that is known.
struct Found {
    correction: CameraCorrection,
    covariance: SMatrix<f64, 9, 9>,
}

impl Found {
    /// Whether it changes nothing that matters.
    fn is_small(&self) -> bool {
        let mut matters = CameraCorrection::repeat(TURN_LIMITS_DEG[0].to_radians());
        matters
            .fixed_rows_mut::<3>(entry::SHIFT)
            .fill(SHIFT_LIMITS_M[0]);
        matters[entry::FOCAL] = FOCAL_LIMITS[0];
        matters[entry::CLOCK] = CLOCK_LIMITS_S[0];
        let sigmas = self.covariance.diagonal().map(f64::sqrt);
        let found = |k: &usize| {
            let bound = (FOUND_SIGMAS * sigmas[*k]).max(FOUND_SHARE * matters[*k]);
            self.correction[*k].abs() < bound
        };
        (entry::TURN..entry::READOUT).all(|k| found(&k))
    }
}

/// Eq. (4) from where it ended, with the errors of the cameras free.
fn solve_round(
    checked: &Checked,
    rig: &Rig,
    points: &[MapPoint],
    config: &MappingConfig,
    progress: ProgressFn<'_>,
) -> Result<Vec<Found>, Error> {
    let Keyframes { frames, images } = checked.keyframes;
    let mut problem = Problem::new();
    let poses = add_keyframes(&mut problem, checked.keyframes, &checked.terms, config)?.poses;
    let cameras = FreedCameras::add_to(&mut problem, rig, &possible())?;
    let motions: Vec<FrameMotion> = frames
        .iter()
        .map(|k| motion_at(checked.trajectory, k.time, &k.world_from_rig).unwrap_or_default())
        .collect();
    let sights = Sights {
        images,
        poses: &poses,
        motions: &motions,
        sigma_px: checked.terms.weights.pixel_sigma_px,
        point_sigma: POINT_SIGMA_M,
    };
    cameras.add_points(&mut problem, points, &sights)?;
    let solver = checked.terms.solver(config);
    solve_or_stop("cameras", &mut problem, &solver, progress)?;
    let blocks: Vec<_> = cameras.corrections().map(|(_, block)| block).collect();
    let ids: Vec<_> = blocks.iter().map(|block| block.id()).collect();
    let covariance = covariance(&problem, &ids)?;
    let found = |block: &Block<CameraCorrection>| {
        let own = covariance.between(block.id(), block.id());
        Found {
            correction: problem.value(*block),
            covariance: own.map_or_else(SMatrix::zeros, |own| own.fixed_view::<9, 9>(0, 0).into()),
        }
    };
    Ok(blocks.iter().map(found).collect())
}

fn possible() -> CameraCorrection {
    let mut sigmas = CameraCorrection::repeat(TURN_SIGMA_RAD);
    sigmas.fixed_rows_mut::<3>(entry::SHIFT).fill(SHIFT_SIGMA_M);
    sigmas[entry::FOCAL] = FOCAL_SIGMA;
    sigmas[entry::CLOCK] = CLOCK_SIGMA_S;
    sigmas[entry::READOUT] = READOUT_SIGMA_S;
    sigmas
}

/// Motion of the rig around an image; `None` at the ends of the trajectory.
fn motion_at(
    trajectory: &Trajectory,
    time: Timestamp,
    world_from_rig: &Se3,
) -> Option<FrameMotion> {
    let before = trajectory.at(time + -MOTION_NS)?;
    let after = trajectory.at(time + MOTION_NS)?;
    let secs = 2e-9 * MOTION_NS as f64;
    let moved = before.inverse() * after;
    // The odometry's world may be turned a little against that of the keyframes.
    let velocity_in_rig = before
        .rotation
        .inverse_transform_vector(&(after.translation - before.translation))
        / secs;
    Some(FrameMotion {
        turn_rate_rad_s: so3::log(&moved.rotation) / secs,
        velocity_m_s: world_from_rig.rotation * velocity_in_rig,
        ..FrameMotion::default()
    })
}

/// Of each camera the keypoints that match in two others or more, and those of them that show a point.
fn counts_of<'a>(checked: &Checked<'a>, points: &[MapPoint]) -> BTreeMap<&'a str, [u64; 2]> {
    let mut counts: BTreeMap<&str, [u64; 2]> = BTreeMap::new();
    let long = |track: &&Track| track.keypoints.len() >= CERTAIN_VIEWS;
    let tracked = checked.tracks.iter().filter(long);
    let tracked = tracked.flat_map(|track| &track.keypoints);
    let seen = points.iter().flat_map(|point| &point.observations);
    let images = tracked
        .map(|k| (0, k.image as usize))
        .chain(seen.map(|o| (1, o.image)));
    for (which, image) in images {
        if let Some(image) = checked.keyframes.images.get(image) {
            counts.entry(&image.camera).or_default()[which] += 1;
        }
    }
    counts
}

fn error_of(
    name: &str,
    [tracked, observations]: [u64; 2],
    (stated, found): (&RigCamera, &RigCamera),
    covariance: &SMatrix<f64, 9, 9>,
    settled: bool,
) -> CameraError {
    let moved = stated.rig_from_camera.inverse() * found.rig_from_camera;
    let focal_px = |camera: &RigCamera| camera.camera.lens.parameters().values[0];
    let sigma = |k: usize| covariance[(k, k)].sqrt();
    let turn = so3::log(&moved.rotation);
    CameraError {
        camera: name.to_owned(),
        tracked,
        observations,
        turn_deg: turn.norm().to_degrees(),
        turn_sigma_deg: sigma_along(covariance, entry::TURN, &turn).to_degrees(),
        shift_m: moved.translation.norm(),
        shift_sigma_m: sigma_along(covariance, entry::SHIFT, &moved.translation),
        focal_share: focal_px(found) / focal_px(stated) - 1.0,
        focal_sigma: sigma(entry::FOCAL),
        clock_s: found.timing.rig_from_camera_s - stated.timing.rig_from_camera_s,
        clock_sigma_s: sigma(entry::CLOCK),
        settled,
    }
}

/// Standard deviation of three entries in a direction.
fn sigma_along(covariance: &SMatrix<f64, 9, 9>, from: usize, along: &Vector3<f64>) -> f64 {
    let own = covariance.fixed_view::<3, 3>(from, from);
    match along.try_normalize(0.0) {
        Some(unit) => unit.dot(&(own * unit)).max(0.0).sqrt(),
        None => own.trace().max(0.0).sqrt(),
    }
}
