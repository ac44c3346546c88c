//! Whether the IMU finds the map as large, and as level, as it is.
//!
//! A map whose scale is wrong, or that leans, fits its own images: nothing that cameras see tells. The accelerometer measures lengths in
//! metres, and gravity the vertical, as far as its own scale is known. So the map's scale is an unknown of the solve, which takes what map
//! and IMU differ by: the IMU then does not bend the walk, whose lengths are the map's. Which of the two is wrong is not told.

use lsfb_solver::{Kernel, VectorPrior, covariance};
use lsfb_types::{Finding, Limit, Verdict};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::GroundTruthConfig;
use super::config::UNLIKELY_SIGMAS;
use super::optimization::{Adjustment, Optimized};
use super::walk::Walk;
use crate::Error;

/// Standard deviation beyond which the scale is not known, percent: with one so large no map of a few percent off would be noticed.
const KNOWN_PERCENT: f64 = 1.5;
/// What no accelerometer of a phone is off by, percent: beyond, the map is wrong.
const LARGEST_PERCENT: f64 = 5.0;
/// Standard deviation of a local point beside its sights, metres: so loose that it says nothing of lengths.
const POINT_SIGMA_M: f64 = 1e3;
/// Least share of what is known of the scale that the walk must have told.
const LEAST_SHARE: f64 = 1e-3;

/// Share of the images that a camera sent once more beyond which the scale is not judged: a few percent are no stretch worth the name.
const MANY_FROZEN: f64 = 0.05;

/// What the IMU says of the map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapAgreement {
    /// Of its lengths; nothing where the walk is too still to tell.
    pub scale: Option<MapScale>,
    /// Angle of gravity to the map's vertical, degrees.
    pub lean_deg: f64,
    /// The same in the standard deviations that the settings give gravity's direction.
    pub lean_sigmas: f64,
}

/// By how much a map is larger than the IMU has it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapScale {
    /// By how much lengths in it are too large, percent of these.
    pub too_large_percent: f64,
    /// Standard deviation of that, the accelerometer's scale included as the settings give it.
    pub sigma_percent: f64,
}

impl MapAgreement {
    /// `used` are the settings of the last solve.
    pub(super) fn of(
        walk: &Walk,
        solved: &Optimized,
        used: &GroundTruthConfig,
    ) -> Result<Self, Error> {
        let gravity = &solved.gravity_m_s2;
        let lean = Vector3::new(gravity.x, gravity.y, 0.0).norm();
        Ok(Self {
            scale: scale(walk, solved, used)?,
            lean_deg: lean.atan2(gravity.z.abs()).to_degrees(),
            lean_sigmas: lean / used.gravity_sigma_m_s2,
        })
    }

    /// Everything that was looked at, good or not. Where a camera froze for so large a share of the images, the IMU alone carries the walk: what
    /// it drifts there is no sign of a map that is a few percent too large, and does not get a finding of its own.
    pub(super) fn findings(&self, frozen_share: f64) -> [Finding; 2] {
        [self.of_scale(frozen_share), self.of_lean()]
    }

    fn of_scale(&self, frozen_share: f64) -> Finding {
        let Some(scale) = self.scale.filter(|s| s.sigma_percent <= KNOWN_PERCENT) else {
            let what = match self.scale {
                Some(s) => format!(
                    "the IMU determines the map's scale only to {:.1} %: an error of some percent would not be noticed",
                    s.sigma_percent
                ),
                None => {
                    "there is too little motion for the IMU to determine the map's scale".to_owned()
                }
            };
            return Finding::new("map-scale", Verdict::Unknown, "map", what);
        };
        let sigmas = scale.too_large_percent.abs() / scale.sigma_percent;
        let differ = format!(
            "lengths in the map differ by {:+.1} ± {:.1} % from the IMU's",
            scale.too_large_percent, scale.sigma_percent
        );
        let is_small = scale.too_large_percent.abs() <= LARGEST_PERCENT;
        if sigmas > UNLIKELY_SIGMAS && is_small && frozen_share > MANY_FROZEN {
            let what = format!(
                "{differ}, but a camera was frozen for {:.0} % of the images and the IMU alone carries the walk there: the map's scale is not judged",
                1e2 * frozen_share
            );
            return Finding::new("map-scale", Verdict::Unknown, "map", what);
        }
        let what = format!(
            "{differ}; if that is significant, \
             the scale of the map (and of the trajectory) or of the accelerometer is wrong"
        );
        let verdict = match sigmas <= UNLIKELY_SIGMAS {
            true => Verdict::Pass,
            false if !is_small => Verdict::Fail,
            false => Verdict::Warn,
        };
        Finding::new("map-scale", verdict, "map", what)
            .value(sigmas, "")
            .limit(Limit::AtMost(UNLIKELY_SIGMAS))
            .remedy(
                "measure a distance in the place and compare it with the map; calibrate the accelerometer",
            )
    }

    fn of_lean(&self) -> Finding {
        let what = format!(
            "gravity is {:.2}° off the map's vertical according to the accelerometer",
            self.lean_deg
        );
        let verdict = Verdict::Warn.unless(self.lean_sigmas <= UNLIKELY_SIGMAS);
        Finding::new("map-level", verdict, "map", what)
            .value(self.lean_sigmas, "")
            .limit(Limit::AtMost(UNLIKELY_SIGMAS))
            .remedy("level the map: everything computed from its vertical is off by as much")
    }
}

/// By what share the map is larger than the IMU has it, and the standard deviation of that; `None` where the walk says nothing.
///
/// What was known of it beforehand is taken off again, so that it is not drawn towards zero.
fn scale(
    walk: &Walk,
    solved: &Optimized,
    used: &GroundTruthConfig,
) -> Result<Option<MapScale>, Error> {
    let mut adjustment = Adjustment::of(walk, &solved.estimate, &solved.points, None, used)?;
    let Some(inertial) = adjustment.blocks.inertial else {
        return Ok(None);
    };
    // A point whose distance is open, of somebody who stands, says nothing, and undetermines nothing.
    for (point, block) in solved.points.iter().zip(&adjustment.blocks.points) {
        if let Some(block) = block {
            let prior = VectorPrior::new(point.point_in_world, Vector3::repeat(POINT_SIGMA_M));
            let squared = Kernel::Squared;
            adjustment
                .problem
                .add_residual(prior, &[block.id()], squared)?;
        }
    }
    let block = inertial.world_scale.id();
    let found = match covariance(&adjustment.problem, &[block]) {
        Ok(found) => found.between(block, block),
        Err(lsfb_solver::Error::Undetermined { .. }) => None,
        Err(other) => return Err(other.into()),
    };
    let Some(variance) = found.map(|found| found[(0, 0)]) else {
        return Ok(None);
    };
    let by_walk = variance.recip() - used.inertial.map_scale_sigma.powi(-2);
    // The rest is what the two were rounded to.
    let says_something = by_walk > LEAST_SHARE / variance;
    Ok(says_something.then(|| MapScale {
        too_large_percent: 1e2 * solved.imu_errors.world_scale / (variance * by_walk),
        sigma_percent: 1e2 / by_walk.sqrt(),
    }))
}
