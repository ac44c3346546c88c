//! The ground truth of a walk: where the device was at every image, to a centimetre.
//!
//! The images are localized in the HD map one by one; those that the IMU leads to from one another are a consistent set, and
//! the walk is placed by the largest of them and by all that the IMU leads to from there, the surest first; features that are not in the map
//! become local points; and one robust bundle
//! adjustment over all frames, eq. (5), settles poses, velocities and biases with the map's points held fixed. Then the map's
//! points are looked for again where the poses now say they must be, and everything is solved until nothing comes or goes any
//! more. Whatever was not used is looked at again after every solve.
//!
//! A pose is given only if it may be believed: its covariance is small enough, halves of the map's points agree on it, and what the map
//! says should be in view there is there; and no move of the whole walk leads to where the map looks much the same. A place that is the same in every image cannot be told by any of these: a walk through one of
//! two floors of which only the other is mapped, and which look alike in all that the walk sees, comes out as one on the mapped floor.
//!
//! [`motion_without_map`] has the motion of a walk for which there is no map, from tracks and the IMU, by the same adjustment.

mod accel_axes;
mod config;
mod consensus;
mod cross_check;
mod dead_reckoning;
mod dense;
mod drift;
mod estimate;
mod findings;
mod frozen_images;
mod frozen_samples;
mod guided_matching;
mod imu_agreement;
mod imu_refinement;
mod imu_swing;
mod imu_wander;
mod in_view;
mod inertial;
mod local_points;
mod map_agreement;
mod optimization;
mod other_place;
mod recorded_walk;
mod refusal;
mod report;
mod run;
mod sensor_axes;
mod settling;
mod start;
mod together;
mod trusted;
mod uncertainty;
mod walk;
mod warnings;
mod without_map;

#[cfg(test)]
mod tests;

use lsfb_geometry::{Matrix6, Se3, Trajectory, Vector3};
use lsfb_types::{Progress, ProgressFn, Timestamp};

pub use config::{GroundTruthConfig, InertialPriors};
pub use dense::DenseState;
pub use imu_refinement::ImuRefinement;
pub use imu_swing::{ImuSwing, Swinging};
pub use imu_wander::{BiasChange, BiasWander};
pub use map_agreement::{MapAgreement, MapScale};
pub use other_place::OtherPlace;
pub use recorded_walk::RecordedWalk;
pub use report::{
    CameraRefinement, GroundTruthReport, GroundTruthWarning, LeftOutReason, ReprojectionErrors,
    Span, Together,
};
pub use run::{ground_truth, ground_truth_in_stages, ground_truth_of, ground_truth_together};
pub use without_map::{
    Beginning, FrontEnd, Motion, MotionConfig, MotionReport, RecordedMotion, RevisitConfig,
    Revisits, Sight, TrackedFrame, TrackedWalk, WalkView, motion_of_recording,
    motion_of_recording_in_stages, motion_without_map,
};

use crate::Error;
use crate::features::Features;
use crate::worst_sigma::worst_sigmas;
use estimate::Estimate;
use local_points::{LocalTracks, MatchableImage};
use optimization::{Optimized, choose_observations, optimize, within_gate};
use settling::{ROUNDS, settle};
use start::Start;
use walk::Walk;

/// The trajectory of a walk in the map's world.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundTruth {
    /// Pose of the device's rig at every image that could be placed.
    pub trajectory: Trajectory,
    /// Covariance of each pose, tangent `[rotation, translation]` on the right, rad² and m²: what the solve leaves open, and what groups
    /// of the map's points that lie together are wrong by together. Errors that all of the map around shares, its scale above all, do not
    /// show in a walk and are not in it.
    pub covariances: Vec<Matrix6<f64>>,
    /// How far each position moves when half of the map's points around are withheld, at most, metres.
    pub disagreements_m: Vec<f64>,
    /// Motion at each of these poses, and at every inertial sample between two of neighbouring images.
    pub states: Vec<DenseState>,
    /// Gravity in the map's world, m/s².
    pub gravity_m_s2: Vector3<f64>,
    /// Instants that visual localization placed by themselves, in order.
    pub localizations: Vec<LocalizedInstant>,
    /// How it came about, and how far to trust it.
    pub report: GroundTruthReport,
}

impl GroundTruth {
    /// Standard deviations of each pose's attitude, radians, and position, metres, in the direction in which each is known worst.
    pub fn worst_sigmas(&self) -> Vec<[f64; 2]> {
        self.covariances.iter().map(worst_sigmas).collect()
    }
}

/// An instant that visual localization placed in the map by its images alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalizedInstant {
    /// When its images were taken.
    pub time: Timestamp,
    /// Where they were found, in the map's world.
    pub world_from_rig: Se3,
    /// Whether that agrees with the IMU and the other instants; what does not was dropped.
    pub is_accepted: bool,
}

/// A solved walk.
struct Solved {
    last: Optimized,
    /// Settings of the last solve: of an IMU that is not as good as they say, less is taken for known.
    config: GroundTruthConfig,
    /// What still changed at its end.
    unrest: Option<GroundTruthWarning>,
    guided_matching: usize,
}

/// Features are followed again where a camera reads its rows out so much faster or slower than believed, seconds: their rays were
/// turned wrongly.
const READOUT_CHANGE_S: f64 = 1e-3;

/// Solves a walk from its first states; `features` are numbered `frame * cameras + camera`.
fn solve_walk(
    walk: &mut Walk,
    start: &Start,
    features: &[Features],
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<Solved, Error> {
    let begin = Estimate::of_states(walk, start.states.clone());
    for (k, frame) in walk.frames.iter_mut().enumerate() {
        // Of a place that was accepted all counts, as far as the kernel lets it; of others what is right all the same.
        frame.fixed = if start.accepted[k] {
            frame.recognised.clone()
        } else {
            within_gate(&begin, k, frame, config)
        };
    }
    let mut tracks = follow(walk, &begin, features, config, progress)?;
    let mut points = tracks.locate(walk, &begin, features, config);
    let rough = config.roughly();
    let first = optimize(walk, &begin, &points, None, &rough, progress)?.estimate;
    choose_observations(walk, &first, &mut points, config);

    progress(Progress {
        stage: "guided matching",
        done: 0,
        total: 0,
    })?;
    let guided_matching = guided_matching::match_again(walk, &first, features, config);
    let before = begin.cameras.iter().map(|c| c.timing().readout_s);
    let after = first.cameras.iter().map(|c| c.timing().readout_s);
    if before
        .zip(after)
        .any(|(before, after)| (before - after).abs() > READOUT_CHANGE_S)
    {
        tracks = follow(walk, &first, features, config, progress)?;
    }
    let points = tracks.locate(walk, &first, features, config);
    let last = optimize(walk, &first, &points, None, &rough, progress)?;
    let settled = settle(walk, last, config, ROUNDS, progress)?;
    Ok(Solved {
        last: settled.last,
        config: settled.config,
        unrest: settled.unrest,
        guided_matching,
    })
}

fn follow(
    walk: &Walk,
    estimate: &Estimate,
    features: &[Features],
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<LocalTracks, Error> {
    let cameras = walk.cameras.len();
    let images: Vec<MatchableImage> = features
        .iter()
        .enumerate()
        .map(|(k, features)| MatchableImage::new(estimate, k / cameras, k % cameras, features))
        .collect();
    Ok(LocalTracks::follow(
        walk, estimate, &images, config, progress,
    )?)
}
