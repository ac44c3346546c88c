//! A walk without a map: the motion by tracks of features and the IMU alone.
//!
//! It begins where the device stands ([`standing`]), or else where it moves enough ([`moving`]): there gravity, velocity, scale and the
//! gyroscope's bias follow from tracks and samples without any guess. From there on frames are added by the IMU's prediction, half a second at
//! a time, and the same adjustment as with a map, less its points, settles all of them ([`extension`]). The world is level; its origin and
//! heading are those of the first frame of the beginning.

mod blind;
mod config;
mod extension;
mod front_end;
mod gyro_bias;
mod measured;
mod moving;
mod recorded;
mod report;
mod revisits;
mod sights;
mod standing;
mod turns;
mod uncertainty;

use lsfb_geometry::{ImuNoiseModel, Matrix6, RigCamera, StampedPose, Trajectory, Vector2, Vector3};
use lsfb_types::{ImuSample, ProgressFn, Stamped, Timestamp};
use serde::{Deserialize, Serialize};

use super::GroundTruthConfig;
use super::estimate::Estimate;
use super::imu_refinement::ImuRefinement;
use super::report::{
    CameraRefinement, GroundTruthWarning, ReprojectionErrors, local_errors, refinements,
};
use super::settling::ROUNDS;
use super::walk::{Frame, FrameState, LocalPoint, Walk};
use crate::residuals::MovingCamera;
use crate::{Error, Refusal};
use blind::blind_stretches;
pub use config::MotionConfig;
use extension::{Extension, Settled};
pub use front_end::FrontEnd;
use lsfb_perception::imu::{ImuBias, NavState};
pub use recorded::{RecordedMotion, motion_of_recording, motion_of_recording_in_stages};
pub use report::MotionReport;
use revisits::{Before, ClosedLoops};
pub use revisits::{RevisitConfig, Revisits, WalkView};
use sights::Tracks;
use uncertainty::uncertainty;

/// What a front end followed, and what the IMU felt.
#[derive(Clone, Debug)]
pub struct TrackedWalk {
    /// The cameras; the rig's frame is the IMU's.
    pub cameras: Vec<RigCamera>,
    /// Instants with images, in order of time.
    pub frames: Vec<TrackedFrame>,
    /// Inertial samples, in order of time.
    pub imu: Vec<Stamped<ImuSample>>,
    /// Noise of the IMU.
    pub noise: ImuNoiseModel,
    /// Images by which places are recognised again, in order of frames; none where that is not asked for.
    pub views: Vec<WalkView>,
}

/// One instant.
#[derive(Clone, Debug)]
pub struct TrackedFrame {
    /// Its stamp.
    pub time: Timestamp,
    /// What is seen.
    pub sights: Vec<Sight>,
}

/// A tracked feature in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight {
    /// Number of the track: sights of one track show one point.
    pub track: u32,
    /// Index of the camera.
    pub camera: usize,
    /// Where, pixels.
    pub pixel: Vector2<f64>,
}

/// How the motion began.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Beginning {
    /// From states that were given.
    Given,
    /// At rest.
    Standing,
    /// In motion.
    Moving,
}

/// The motion of a walk.
#[derive(Clone, Debug)]
pub struct Motion {
    /// Pose of the IMU at each frame.
    pub trajectory: Trajectory,
    /// Covariance of each pose relative to that of [`Motion::first`], tangent `[rotation, translation]` on the right, rad² and m²: what the
    /// adjustment leaves open of images, IMU and cameras. Corners that were followed wrongly all along are not in it.
    pub covariances: Vec<Matrix6<f64>>,
    /// The first frame that sees enough.
    pub first: usize,
    /// Velocity at each frame, m/s in the world.
    pub velocities_m_s: Vec<Vector3<f64>>,
    /// Bias at each frame.
    pub biases: Vec<ImuBias>,
    /// Sights of placed points in use at each frame: with hardly any the IMU alone says where the device was.
    pub sights_in_use: Vec<usize>,
    /// How it began.
    pub beginning: Beginning,
    /// What was recognised again.
    pub revisits: Revisits,
    /// What the walk makes of the IMU.
    pub imu: ImuRefinement,
    /// Points that were placed.
    pub points: usize,
    /// Reprojection errors of those in use.
    pub errors: ReprojectionErrors,
    /// The same errors before anything was solved, where states were given.
    pub errors_before: Option<ReprojectionErrors>,
    /// Share of the sights of followed tracks that fit no point.
    pub contradicted_share: f64,
    /// How far each camera had to be moved, turned, zoomed or set from what is stated of it: beyond three of the standard deviations that
    /// the settings give these it is not as stated, and the motion is bent. Their names are their numbers.
    pub cameras: Vec<CameraRefinement>,
    /// Where observations still came or went when the rounds of choosing them and solving were done.
    pub unrest: Option<GroundTruthWarning>,
}

/// Largest share of the followed sights that may fit no point: up to 0.12 in motions that are right, 0.87 in one without a gyroscope.
const LARGEST_CONTRADICTED_SHARE: f64 = 0.4;

/// The motion of a walk without a map, from states that are known roughly or from nothing.
///
/// [`Refusal::NoBeginning`] where nothing tells scale and gravity, [`Refusal::TracksContradict`] where tracks and IMU do not agree,
/// [`Error::UnknownView`] where a view is of no frame or camera of the walk; `start`, where given, has a state for each frame.
pub fn motion_without_map(
    walk: &TrackedWalk,
    start: Option<Vec<(NavState, ImuBias)>>,
    config: &MotionConfig,
    progress: ProgressFn<'_>,
) -> Result<Motion, Error> {
    config.check_bounds("motion")?;
    revisits::check(walk)?;
    let settings = config;
    let config = &settings.adjustment;
    let tracks = Tracks::of(walk);
    let inner = Walk {
        cameras: walk.cameras.iter().map(MovingCamera::new).collect(),
        frames: walk.frames.iter().map(|f| empty_frame(f.time)).collect(),
        imu: walk.imu.clone(),
        noise: config.inflated(&walk.noise),
        noise_factors: Default::default(),
        point_covariances_m2: Default::default(),
    };
    let mut errors_before = None;
    let (mut extension, beginning) = match start {
        Some(states) if states.len() == walk.frames.len() => {
            let states = states
                .into_iter()
                .map(|(nav, bias)| FrameState { nav, bias });
            let states: Vec<FrameState> = states.collect();
            let estimate = Estimate::of_states(&inner, states.clone());
            let points = tracks.locate(&estimate, 0..states.len(), config);
            errors_before = Some(local_errors(&estimate, &points));
            (Extension::of(&inner, &tracks, 0, states), Beginning::Given)
        }
        _ => begin(&inner, &tracks, config, progress)?,
    };
    extension.extend(config, progress)?;
    let (settled, revisits) = match walk.views.is_empty() {
        true => (
            extension.finish(config, ROUNDS, progress)?,
            Revisits::default(),
        ),
        false => finish_closed(walk, &inner, &tracks, extension, settings, progress)?,
    };
    let solved = &settled.last;
    let frames = 0..walk.frames.len();
    let contradicted_share = tracks.contradicted_share(&solved.estimate, frames, config);
    if contradicted_share > LARGEST_CONTRADICTED_SHARE {
        return Err(Refusal::TracksContradict {
            share: contradicted_share,
            limit: LARGEST_CONTRADICTED_SHARE,
        }
        .into());
    }
    let sights_in_use = in_use(&solved.points, walk.frames.len());
    let first = first_seeing(&sights_in_use, settings);
    let imu = ImuRefinement::of(&inner, solved, config)?;
    let all: Vec<usize> = (0..walk.frames.len()).collect();
    let less_sure = less_sure(walk, inner, &sights_in_use, &imu, settings);
    let uncertainty = uncertainty(&less_sure, &settled, first, &all, progress)?;
    let numbers: Vec<String> = (0..walk.cameras.len()).map(|k| k.to_string()).collect();
    let numbers = numbers.iter().map(String::as_str);
    let states = &solved.estimate.states;
    let poses = walk.frames.iter().zip(states);
    Ok(Motion {
        trajectory: Trajectory::new(
            poses
                .map(|(frame, state)| StampedPose {
                    time: frame.time,
                    world_from_rig: state.nav.world_from_rig,
                })
                .collect(),
        ),
        covariances: uncertainty.poses,
        first,
        velocities_m_s: states.iter().map(|s| s.nav.velocity_m_s).collect(),
        biases: states.iter().map(|s| s.bias).collect(),
        sights_in_use,
        beginning,
        revisits,
        imu,
        points: solved.points.iter().filter(|p| p.is_determined()).count(),
        errors: local_errors(&solved.estimate, &solved.points),
        errors_before,
        contradicted_share,
        cameras: refinements(numbers, &solved.estimate, &uncertainty.corrections, config),
        unrest: settled.unrest.clone(),
    })
}

/// The first frame that sees enough.
fn first_seeing(sights_in_use: &[usize], config: &MotionConfig) -> usize {
    let sees_enough = |sights: &usize| *sights >= config.min_sights;
    sights_in_use.iter().position(sees_enough).unwrap_or(0)
}

/// The walk with the IMU as it showed itself, and less of it where it alone says where the device was.
fn less_sure(
    walk: &TrackedWalk,
    mut less_sure: Walk,
    sights_in_use: &[usize],
    imu: &ImuRefinement,
    config: &MotionConfig,
) -> Walk {
    let blind = blind_stretches(walk, sights_in_use, config);
    less_sure.loosen_imu(imu.noise_factor());
    for k in blind.into_iter().flat_map(|[a, b]| a..b) {
        let factor = less_sure.noise_factors.entry(k).or_insert(1.0);
        *factor = factor.max(config.blind_imu_noise_factor);
    }
    less_sure
}

/// Looks for places that the walk came back to, and solves all with those loops closed that then fit.
fn finish_closed(
    walk: &TrackedWalk,
    inner: &Walk,
    tracks: &Tracks,
    mut extension: Extension<'_>,
    config: &MotionConfig,
    progress: ProgressFn<'_>,
) -> Result<(Settled, Revisits), Error> {
    let settled = &extension.roughly(&config.adjustment, progress)?;
    let mut frames: Vec<usize> = walk.views.iter().map(|v| v.frame).collect();
    frames.dedup();
    let imu = ImuRefinement::of(inner, &settled.last, &config.adjustment)?;
    let sights_in_use = in_use(&settled.last.points, walk.frames.len());
    let less_sure = less_sure(walk, inner.clone(), &sights_in_use, &imu, config);
    let first = first_seeing(&sights_in_use, config);
    let known = uncertainty(&less_sure, settled, first, &frames, progress)?;
    let before = Before {
        walk: inner,
        tracked: walk,
        settled,
        covariances: &known.poses,
        config: &config.revisits,
        adjustment: &config.adjustment,
    };
    let mut loops = ClosedLoops::find(&before, progress)?;
    loop {
        let joined;
        let extension = match loops.bend(progress)? {
            Some(bent) => {
                joined = tracks.with(&bent.tracks);
                extension.clone().closed(&joined, &bent.states)
            }
            None => extension.clone(),
        };
        let settled = extension.finish(&config.adjustment, ROUNDS, progress)?;
        if !loops.open_misfits(&settled) {
            return Ok((settled, loops.revisits()));
        }
    }
}

fn in_use(points: &[LocalPoint], frames: usize) -> Vec<usize> {
    let mut counts = vec![0; frames];
    let placed = points.iter().filter(|p| p.is_determined());
    for seen in placed.flat_map(|p| &p.observations).filter(|s| s.used) {
        counts[seen.frame] += 1;
    }
    counts
}

fn empty_frame(time: Timestamp) -> Frame {
    Frame {
        time,
        localized: None,
        recognised: Vec::new(),
        fixed: Vec::new(),
    }
}

/// At rest where the walk begins so, else wherever the device first moves enough.
fn begin<'a>(
    walk: &'a Walk,
    tracks: &'a Tracks,
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<(Extension<'a>, Beginning), Error> {
    if let Some(states) = standing::states(walk, tracks) {
        return Ok((
            Extension::of(walk, tracks, 0, states).at_rest(),
            Beginning::Standing,
        ));
    }
    let mut first = 0;
    while let Some(window) = moving::next_window(walk, first) {
        if let Some(states) = moving::states(walk, tracks, window.clone(), config) {
            let begun = Extension::of(walk, tracks, window.start, states);
            if let Some(begun) = begun.if_sound(config, progress)? {
                return Ok((begun, Beginning::Moving));
            }
        }
        first = window.start + window.len().div_ceil(4);
    }
    Err(Refusal::NoBeginning {
        frames: walk.frames.len(),
    }
    .into())
}
