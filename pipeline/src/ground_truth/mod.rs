//! The ground truth of a walk: where the device was at every image, to a centimetre.
//!
//! The images are localized in the HD map one by one; those that the IMU leads to from one another are a consistent set, and
//! the largest of them places the walk; features that are not in the map become local points; and one robust bundle
//! adjustment over all frames, eq. (5), settles poses, velocities and biases with the map's points held fixed. Then the map's
//! points are looked for again where the poses now say they must be, and everything is solved until nothing comes or goes any
//! more. Whatever was not used is looked at again after every solve.

mod config;
mod consensus;
mod drift;
mod guided_matching;
mod inertial;
mod local_points;
mod optimization;
mod report;
mod run;
mod start;
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
use local_points::{LocalTracks, MatchableImage};
use optimization::{Optimized, choose_observations, optimize, within_gate};
use start::Start;
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
}

/// Rounds at most in which observations come and go after the search for map points.
const ROUNDS: usize = 6;
/// They have settled once fewer than one in so many comes or goes.
const SETTLED: usize = 1000;

/// Solves a walk from its first states; `features` are numbered `frame * cameras + camera`.
fn solve_walk(
    walk: &mut Walk,
    start: &Start,
    features: &[Features],
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<Solved, Error> {
    for (k, frame) in walk.frames.iter_mut().enumerate() {
        // Of a place that was accepted all counts, as far as the kernel lets it; of others what is right all the same.
        frame.fixed = if start.accepted[k] {
            frame.recognised.clone()
        } else {
            within_gate(&walk.cameras, &start.states[k], frame, config)
        };
    }
    let images: Vec<MatchableImage> = features
        .iter()
        .enumerate()
        .map(|(k, features)| MatchableImage::new(walk, k % walk.cameras.len(), features))
        .collect();
    let tracks = LocalTracks::follow(walk, &start.states, &images, config, progress)?;

    let mut points = tracks.locate(walk, &start.states, features, config);
    let first = optimize(walk, &start.states, &points, config, progress)?;
    choose_observations(walk, &first.states, &mut points, config);

    progress(Progress {
        stage: "guided matching",
        done: 0,
        total: 0,
    })?;
    let guided_matching = guided_matching::match_again(walk, &first.states, features, config);
    let points = tracks.locate(walk, &first.states, features, config);
    let mut last = optimize(walk, &first.states, &points, config, progress)?;
    for _ in 0..ROUNDS {
        let changed = choose_observations(walk, &last.states, &mut last.points, config);
        if changed == 0 {
            break;
        }
        last = optimize(walk, &last.states, &last.points, config, progress)?;
        if changed * SETTLED < last.report.residuals {
            break;
        }
    }
    Ok(Solved {
        states: last.states.clone(),
        last,
        guided_matching,
    })
}
