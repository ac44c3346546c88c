//! The ground truth of a walk: where the device was at every image, to a centimetre.
//!
//! The images are localized in the HD map one by one; the IMU joins the poses and finds those that are wrong; features that
//! are not in the map become local points; and one robust bundle adjustment over all frames, eq. (5), settles poses,
//! velocities and biases with the map's points held fixed. Then the map's points are looked for again where the poses now
//! say they must be, and everything is solved once more.

mod config;
mod guided_matching;
mod inertial;
mod local_points;
mod optimization;
mod report;
mod run;
mod walk;

#[cfg(test)]
mod tests;

use lsfb_geometry::Trajectory;
use lsfb_types::{Progress, ProgressFn};

pub use config::GroundTruthConfig;
pub use report::{GroundTruthReport, ReprojectionErrors, Span};
pub use run::ground_truth;

use crate::Error;
use crate::features::Features;
use inertial::InertialStart;
use local_points::{LocalTracks, MatchableImage};
use optimization::{Optimized, drop_outliers, optimize};
use walk::{State, Walk};

/// The trajectory of a walk in the map's world.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundTruth {
    /// Pose of the device's rig at every image that could be placed.
    pub trajectory: Trajectory,
    /// How it came about, and how far to trust it.
    pub report: GroundTruthReport,
}

/// A solved walk.
struct Solved {
    states: Vec<State>,
    last: Optimized,
    guided_matching: usize,
    outliers: usize,
}

/// Solves a walk from its first states; `features` are numbered `frame * cameras + camera`.
fn solve_walk(
    walk: &mut Walk,
    start: &InertialStart,
    features: &[Features],
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<Solved, Error> {
    let images: Vec<MatchableImage> = features
        .iter()
        .enumerate()
        .map(|(k, features)| MatchableImage::new(walk, k % walk.cameras.len(), features))
        .collect();
    let tracks = LocalTracks::follow(walk, &start.states, &images, config, progress)?;

    let mut points = tracks.locate(walk, &start.states, features, config);
    let first = optimize(walk, &start.states, &points, config, progress)?;
    let mut outliers = drop_outliers(walk, &first.states, &mut points, config);

    progress(Progress {
        stage: "guided matching",
        done: 0,
        total: 0,
    })?;
    let guided_matching = guided_matching::match_again(walk, &first.states, features, config);
    let points = tracks.locate(walk, &first.states, features, config);
    let second = optimize(walk, &first.states, &points, config, progress)?;
    let mut kept = second.points.clone();
    outliers += drop_outliers(walk, &second.states, &mut kept, config);
    // Without the outliers a few iterations are left to do.
    let last = optimize(walk, &second.states, &kept, config, progress)?;
    Ok(Solved {
        states: last.states.clone(),
        last,
        guided_matching,
        outliers,
    })
}
