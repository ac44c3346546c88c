//! After the search for map points, observations come and go until none does any more.

use lsfb_geometry::so3;
use lsfb_types::ProgressFn;

use super::GroundTruthConfig;
use super::config::InertialPriors;
use super::estimate::Estimate;
use super::imu_wander::next_change;
use super::optimization::{Optimized, choose_observations, optimize};
use super::report::GroundTruthWarning;
use super::walk::Walk;
use crate::Error;

/// Rounds at most.
pub(super) const ROUNDS: usize = 6;
/// Observations have settled once fewer than one in so many comes or goes.
const SETTLED: usize = 1000;

/// A walk after its last round.
pub(super) struct Settled {
    pub last: Optimized,
    /// Settings of the last solve: of an IMU that is not as good as they say, less is taken for known.
    pub config: GroundTruthConfig,
    /// What still changed when the rounds were done; `None` where observations have settled.
    pub unrest: Option<GroundTruthWarning>,
}

/// Chooses observations and solves in turns, `rounds` times at most, roughly; then to the last digit.
pub(super) fn settle(
    walk: &mut Walk,
    mut last: Optimized,
    config: &GroundTruthConfig,
    rounds: usize,
    progress: ProgressFn<'_>,
) -> Result<Settled, Error> {
    let mut used = config.clone();
    let mut moved = [0.0; 2];
    let mut at_rest = false;
    for _ in 0..rounds {
        let changed = choose_observations(walk, &last.estimate, &mut last.points, config);
        let allowed = allowing(walk, &last, &used);
        at_rest = allowed.is_none() && is_few(changed, &last);
        if at_rest {
            break;
        }
        used.inertial = allowed.unwrap_or(used.inertial);
        let (estimate, points) = (&last.estimate, &last.points);
        let next = optimize(walk, estimate, points, None, &used.roughly(), progress)?;
        moved = farthest(&last.estimate, &next.estimate);
        last = next;
    }
    let unrest = match at_rest {
        true => None,
        false => unrest(walk, &last, (config, &used), (rounds, moved)),
    };
    let (estimate, points) = (&last.estimate, &last.points);
    Ok(Settled {
        last: optimize(walk, estimate, points, None, &used, progress)?,
        config: used,
        unrest,
    })
}

/// What is to be taken for known of the IMU instead, where what was is unlikely after a solve.
fn allowing(walk: &Walk, solved: &Optimized, used: &GroundTruthConfig) -> Option<InertialPriors> {
    let known = &used.inertial;
    // Errors that stay the same, and a map of another scale, pull at the biases too.
    known.allowing(&solved.imu_errors).or_else(|| {
        let change = next_change(walk, &solved.estimate.states, known)?;
        let mut allowed = known.clone();
        allowed.bias_changes.push(change);
        Some(allowed)
    })
}

/// Whether the last round was enough shows in what another one would change; the result stays that of the solve.
fn unrest(
    walk: &mut Walk,
    last: &Optimized,
    (config, used): (&GroundTruthConfig, &GroundTruthConfig),
    (rounds, moved): (usize, [f64; 2]),
) -> Option<GroundTruthWarning> {
    let (frames, mut points) = (walk.frames.clone(), last.points.clone());
    let changing = choose_observations(walk, &last.estimate, &mut points, config);
    walk.frames = frames;
    let is_settled = allowing(walk, last, used).is_none() && is_few(changing, last);
    (!is_settled).then(|| not_at_rest(rounds, changing, moved))
}

/// What is said where a walk did not settle: `changing` observations would come or go in another round; the last one moved a pose by so many metres and
/// radians at most.
pub(super) fn not_at_rest(
    rounds: usize,
    changing: usize,
    [moved_m, turned_rad]: [f64; 2],
) -> GroundTruthWarning {
    GroundTruthWarning::NotAtRest {
        rounds: rounds as u64,
        changing: changing as u64,
        moved_m,
        turned_deg: turned_rad.to_degrees(),
    }
}

/// Whether so few observations came or went that no pose feels it.
pub(super) fn is_few(changed: usize, solved: &Optimized) -> bool {
    changed * SETTLED < solved.report.residuals
}

/// Farthest that a pose moved, metres, and turned, radians.
pub(super) fn farthest(before: &Estimate, after: &Estimate) -> [f64; 2] {
    let poses = before.states.iter().zip(&after.states);
    poses.fold([0.0, 0.0], |[moved_m, turned_rad], (before, after)| {
        let step = before.nav.world_from_rig.inverse() * after.nav.world_from_rig;
        [
            step.translation.norm().max(moved_m),
            so3::log(&step.rotation).norm().max(turned_rad),
        ]
    })
}
