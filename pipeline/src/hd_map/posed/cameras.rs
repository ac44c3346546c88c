//! What images show of their cameras, where their poses are given.
//!
//! Lists of posed images come with intrinsics that nobody has checked: those of the HoloLens office are 1.2 % too long, and the focal
//! length of 7-Scenes is a guess. Points then stand where they fit the wrong lens, and every image that is localized by them is off.
//! The poses are given, so that the images tell: with points and poses as they are, each camera's turn and shift against the poses and
//! its focal length are solved for (as `mapping::rig_check` does it for a rig with a LiDAR), and how well each is known is what
//! remains of it when runs of keyframes are left out, one after the other: errors of the poses are in that, and in no pixel's σ.

use std::collections::BTreeMap;

use lsfb_geometry::{Rig, RigCamera, StampedPose, Vector3, so3};
use lsfb_perception::statistics::median;
use lsfb_solver::{Problem, SolveConfig};
use lsfb_types::ProgressFn;

use crate::Error;
use crate::features::tracks::Track;
use crate::features::triangulation::TriangulationConfig;
use crate::hd_map::{
    CERTAIN_VIEWS, FreedCameras, KeyframeImage, MapPoint, Sights, triangulate_tracks,
};
use crate::residuals::{CameraCorrection, FrameMotion, MovingCamera, entry};
use crate::solve::solve_or_stop;

/// Images with poses, and what they share.
pub(super) struct Shown<'a> {
    pub keyframes: &'a [StampedPose],
    pub images: &'a [KeyframeImage],
    pub tracks: &'a [Track],
    /// How deep the scene is, in the unit of the poses.
    pub depth: f64,
    pub triangulation: &'a TriangulationConfig,
}

/// What is thought possible, one standard deviation: turn, share of the depth by which a camera is shifted, share of the focal length.
const TURN_SIGMA_RAD: f64 = 0.1;
const SHIFT_SIGMA_PER_DEPTH: f64 = 0.05;
const FOCAL_SIGMA: f64 = 0.1;
/// Clocks and readouts are not searched.
const TIME_SIGMA_S: f64 = 1e-6;
/// Keeps a point that no camera has before it any more from being undetermined, as a share of the depth.
const POINT_SIGMA_PER_DEPTH: f64 = 10.0;

/// Points that are triangulated with wrong cameras are wrong, and some are missed: with the cameras found they are again.
const ROUNDS: usize = 3;
/// In the first round views that are off by so many times the limit are kept.
const FIRST_TOLERANCE: f64 = 2.0;
/// With fewer observations nothing is said of a camera; more tell nothing new.
const FEWEST_OBSERVATIONS: usize = 1_500;
const MOST_OBSERVATIONS: usize = 20_000;
/// Runs of keyframes that are left out in turn.
const RUNS: usize = 6;
/// Standard deviations that are no chance: of so few runs they are known to a third.
const CERTAIN_SIGMAS: f64 = 5.0;

/// The rig with the cameras that are surely other than stated as they were found, and these as they were stated.
pub(super) fn found_cameras(
    stated: &Rig,
    shown: &Shown,
    progress: ProgressFn,
) -> Result<(Rig, BTreeMap<String, RigCamera>), Error> {
    let mut rig = stated.clone();
    let seen = |name: &String| shown.images.iter().any(|image| image.camera == *name);
    rig.cameras.retain(|name, _| seen(name));
    let mut points = Vec::new();
    for round in 0..ROUNDS {
        points = certain_points(&rig, shown, round)?;
        let observations: usize = points.iter().map(|p| p.observations.len()).sum();
        if observations < FEWEST_OBSERVATIONS {
            return Ok((stated.clone(), BTreeMap::new()));
        }
        let every = observations.div_ceil(MOST_OBSERVATIONS).max(1);
        points = points.into_iter().step_by(every).collect();
        rig = corrected(&rig, &solve(&rig, shown, &points, None, progress)?);
    }
    let mut without_runs = Vec::with_capacity(RUNS);
    for run in 0..RUNS {
        let corrections = solve(&rig, shown, &points, Some(run), progress)?;
        without_runs.push(corrected(&rig, &corrections));
    }
    let observations = counts(shown, &points);
    let mut all = stated.clone();
    let mut otherwise = BTreeMap::new();
    for (name, camera) in &mut all.cameras {
        let enough = observations.get(name.as_str()) >= Some(&FEWEST_OBSERVATIONS);
        let of_runs: Vec<&RigCamera> = without_runs
            .iter()
            .filter_map(|rig| rig.cameras.get(name))
            .collect();
        let Some(found) = rig.cameras.get(name).filter(|_| enough) else {
            continue;
        };
        if is_certain(camera, found, &of_runs) {
            otherwise.insert(name.clone(), std::mem::replace(camera, found.clone()));
        }
    }
    Ok((all, otherwise))
}

/// Points that several images agree on, with these cameras.
fn certain_points(rig: &Rig, shown: &Shown, round: usize) -> Result<Vec<MapPoint>, Error> {
    let tolerance = if round == 0 { FIRST_TOLERANCE } else { 1.0 };
    let triangulation = TriangulationConfig {
        max_reprojection_px: tolerance * shown.triangulation.max_reprojection_px,
        ..shown.triangulation.clone()
    };
    let mut points = triangulate_tracks(
        rig,
        shown.keyframes,
        shown.images,
        shown.tracks,
        &triangulation,
    )?;
    points.retain(|p| p.observations.len() >= CERTAIN_VIEWS);
    Ok(points)
}

/// Observations of each camera.
fn counts<'a>(shown: &'a Shown, points: &[MapPoint]) -> BTreeMap<&'a str, usize> {
    let mut counts = BTreeMap::new();
    for o in points.iter().flat_map(|p| &p.observations) {
        let camera = shown.images[o.image].camera.as_str();
        *counts.entry(camera).or_default() += 1;
    }
    counts
}

/// The corrections of all cameras, by name, with which the points fit their images best, poses held; without those that a run of
/// keyframes saw first.
fn solve(
    rig: &Rig,
    shown: &Shown,
    points: &[MapPoint],
    without_run: Option<usize>,
    progress: ProgressFn,
) -> Result<BTreeMap<String, CameraCorrection>, Error> {
    let mut problem = Problem::new();
    let poses: Vec<_> = shown
        .keyframes
        .iter()
        .map(|k| {
            let block = problem.add_block(k.world_from_rig);
            problem.set_constant(block);
            block
        })
        .collect();
    let cameras = FreedCameras::add_to(&mut problem, rig, &possible(shown.depth))?;
    let errors = points.iter().map(|p| p.reprojection_rms_px).collect();
    // Of two numbers.
    let sigma_px = (median(errors).unwrap_or(0.0) / 2f64.sqrt()).max(0.1);
    let run_of = |p: &MapPoint| {
        let first = p.observations.first();
        let keyframe = first.map_or(0, |o| shown.images[o.image].keyframe);
        keyframe * RUNS / shown.keyframes.len().max(1)
    };
    let sights = Sights {
        images: shown.images,
        poses: &poses,
        motions: &vec![FrameMotion::default(); poses.len()],
        sigma_px,
        point_sigma: POINT_SIGMA_PER_DEPTH * shown.depth,
    };
    let used = points.iter().filter(|p| Some(run_of(p)) != without_run);
    cameras.add_points(&mut problem, used, &sights)?;
    solve_or_stop("cameras", &mut problem, &SolveConfig::default(), progress)?;
    let found = cameras.corrections();
    Ok(found
        .map(|(name, block)| (name.to_owned(), problem.value(block)))
        .collect())
}

fn possible(depth: f64) -> CameraCorrection {
    let mut sigmas = CameraCorrection::repeat(TIME_SIGMA_S);
    sigmas.fixed_rows_mut::<3>(entry::TURN).fill(TURN_SIGMA_RAD);
    sigmas
        .fixed_rows_mut::<3>(entry::SHIFT)
        .fill(SHIFT_SIGMA_PER_DEPTH * depth);
    sigmas[entry::FOCAL] = FOCAL_SIGMA;
    sigmas
}

fn corrected(rig: &Rig, corrections: &BTreeMap<String, CameraCorrection>) -> Rig {
    let mut corrected = rig.clone();
    for (name, camera) in &mut corrected.cameras {
        if let Some(correction) = corrections.get(name) {
            // Images have the times of their poses.
            let timing = camera.timing;
            *camera = MovingCamera::new(camera).corrected(correction).mounted();
            camera.timing = timing;
        }
    }
    corrected
}

/// By how much a camera differs from what is stated of it: turn, shift, logarithm of the focal length.
fn difference(stated: &RigCamera, found: &RigCamera) -> [Vector3<f64>; 3] {
    let moved = found.rig_from_camera.inverse() * stated.rig_from_camera;
    let focal = found.camera.focal_px()[0] / stated.camera.focal_px()[0];
    [
        so3::log(&moved.rotation),
        moved.translation,
        Vector3::new(focal.ln(), 0.0, 0.0),
    ]
}

/// Whether a camera is other than stated for sure, by what remains of it when runs are left out (the jackknife).
fn is_certain(stated: &RigCamera, found: &RigCamera, of_runs: &[&RigCamera]) -> bool {
    let differs = difference(stated, found);
    let count = of_runs.len() as f64;
    let scattered: Vec<_> = of_runs.iter().map(|run| difference(found, run)).collect();
    (0..differs.len()).any(|kind| {
        let Some(along) = differs[kind].try_normalize(0.0) else {
            return false;
        };
        let lengths: Vec<f64> = scattered.iter().map(|d| d[kind].dot(&along)).collect();
        let mean = lengths.iter().sum::<f64>() / count;
        let squares: f64 = lengths.iter().map(|l| (l - mean).powi(2)).sum();
        let sigma = ((count - 1.0) / count * squares).sqrt();
        differs[kind].norm() > CERTAIN_SIGMAS * sigma && count > 1.0
    })
}
