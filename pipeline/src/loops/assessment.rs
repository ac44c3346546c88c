//! Whether two scans that look alike are of one place: what the odometry says of it, and the registration of one to the other.

use lsfb_geometry::{Matrix3, Matrix6, Se3, Vector3, Vector6};
use lsfb_perception::lidar::{Observability, Registration};

use super::keyframes::{self, Keyframe, Scans};
use super::ways::Way;
use super::{Loop, LoopDecision, LoopRejection, LoopScores, MeasuredLoop};
use crate::odometry::OdometryConfig;
use crate::place_search::{self, Query, Region};
use crate::worst_sigma::worst_sigmas;

/// What the odometry may drift besides what its covariance says, as a share of the way: errors of the rig are not in that, and the twin's
/// walks drift by less than half as much.
const DRIFT_SHARE: f64 = 0.002;
/// The same of the heading, radians per metre.
const DRIFT_RAD_PER_M: f64 = 0.000_1;
/// Two scans farther apart than this are no loop, metres.
const MAX_DISTANCE_M: f64 = 5.0;
/// Floors are farther apart than this: a loop never moves the height by more, metres.
const MAX_RISE_M: f64 = 1.25;
/// Where the odometry's covariance leaves this much (three standard deviations) open, nothing is proven by likeness, metres.
const MAX_OPEN_M: f64 = 10.0;
/// What is held against the odometry, in standard deviations of one direction.
const SIGMAS: f64 = 3.0;
/// χ² of six numbers that one in a thousand exceeds.
pub(crate) const CHI_SQUARED: f64 = 22.5;
/// Scans this far around the earlier keyframe make the map, metres.
const SUBMAP_M: f64 = 6.0;
/// Share of the points that must lie on what was seen before.
const MIN_OVERLAP: f64 = 0.6;
/// A rival is nearly as good where it leaves less than so many times as many points over, and a share that chance makes.
const RIVAL_FACTOR: f64 = 1.5;
const RIVAL_SHARE: f64 = 0.02;
/// A direction known less well than this is not determined by the scan, metres.
const MAX_SIGMA_M: f64 = 0.05;
/// Errors of the surfaces that both measure against, which no count of points reduces: metres and radians.
const SHARED_M: f64 = 0.01;
const SHARED_RAD: f64 = 0.001;
/// Farthest correspondence from a start, metres.
const GATE_M: f64 = 0.75;

/// Judges pairs of keyframes by the scans of the walk.
#[derive(Clone, Copy)]
pub(super) struct Assessor<'a> {
    pub scans: Scans<'a>,
    /// How scans are registered.
    pub config: &'a OdometryConfig,
}

/// What two keyframes that look alike come to.
pub(super) struct Assessment {
    pub found: Loop,
    /// Whether registration was tried.
    pub is_registered: bool,
}

impl Assessor<'_> {
    /// `way` is what is known of the later keyframe's pose on the earlier. A loop that passes is accepted as far as one alone can be.
    pub fn assess(
        &self,
        earlier: &Keyframe,
        later: &Keyframe,
        way: &Way,
        appearance: f64,
    ) -> Assessment {
        let mut found = Loop {
            earlier: earlier.time,
            later: later.time,
            decision: LoopDecision::Accepted,
            scores: LoopScores {
                appearance: Some(appearance),
                ..LoopScores::default()
            },
            measured: None,
        };
        let open = Open::of(earlier, way);
        let before = open.objection();
        let objection = match before {
            Some(rejection) => Some(rejection),
            None => self.register(earlier, later, &open, &mut found),
        };
        if let Some(rejection) = objection {
            found.decision = LoopDecision::Rejected(rejection);
        }
        Assessment {
            found,
            is_registered: before.is_none(),
        }
    }

    /// Registers the later scan to those around the earlier, and gives what speaks against the loop.
    fn register(
        &self,
        earlier: &Keyframe,
        later: &Keyframe,
        open: &Open,
        found: &mut Loop,
    ) -> Option<LoopRejection> {
        let points = keyframes::query_points(&self.scans.clouds[later.scan]);
        let query = Query {
            points_in_rig: &points,
            sensor_in_rig: self.scans.lidar.rig_from_lidar.translation,
        };
        let reach_m = SUBMAP_M + SIGMAS * open.worst_sigma_m;
        // Nothing of the later visit itself.
        let last_m = 0.5 * (earlier.path_m + later.path_m);
        let map = keyframes::submap(&self.scans, earlier, reach_m, last_m, self.config);
        let region = Region {
            map_from_rig: open.earlier_from_later,
            covariance: open.covariance,
            up_in_rig: later.world_from_rig.rotation.inverse() * Vector3::z(),
        };
        let settings = self.config.registration(self.scans.lidar, GATE_M);
        let Some(places) = place_search::search(&query, &region, &map, &settings) else {
            return Some(LoopRejection::OdometryTooUncertain);
        };
        let best = places.best()?;
        let rival = places.rival_overlap();
        found.scores.overlap = Some(best.inlier_ratio);
        found.scores.rival_overlap = Some(rival);
        found.scores.plane_rms_m = Some(best.plane_rms_m);
        let off = open.earlier_from_later.local(&best.world_from_rig);
        let squared = open.squared_sigmas(&off);
        found.scores.odometry_sigmas = Some(squared.sqrt());
        let seen = place_search::seen(&query, best, &map, &settings);
        found.measured = seen.and_then(|seen| measured(best, &seen.information_of(|_| true)));
        if best.inlier_ratio < MIN_OVERLAP {
            return Some(LoopRejection::LittleOverlap);
        }
        let left_over = (1.0 - best.inlier_ratio) * RIVAL_FACTOR + RIVAL_SHARE;
        if 1.0 - rival < left_over {
            return Some(LoopRejection::Ambiguous);
        }
        let least_per_m2 = (MAX_SIGMA_M * MAX_SIGMA_M).recip();
        let is_seen =
            |s: &Observability| s.directions.iter().all(|d| d.seen_per_m2() > least_per_m2);
        if !seen.as_ref().is_some_and(is_seen) {
            return Some(LoopRejection::Undetermined);
        }
        let rise_m = (earlier.world_from_rig.rotation
            * (best.world_from_rig.translation - open.earlier_from_later.translation))
            .z;
        let is_elsewhere = squared > CHI_SQUARED || rise_m.abs() > MAX_RISE_M;
        is_elsewhere.then_some(LoopRejection::ContradictsOdometry)
    }
}

/// What the odometry leaves open of the later pose on the earlier.
struct Open {
    earlier_from_later: Se3,
    covariance: Matrix6<f64>,
    worst_sigma_m: f64,
    /// By its own covariance alone, of the height, metres.
    height_sigma_m: f64,
    /// Height of the later above the earlier, metres.
    rise_m: f64,
}

impl Open {
    fn of(earlier: &Keyframe, way: &Way) -> Self {
        let of_place: Matrix3<f64> = way.covariance.fixed_view::<3, 3>(3, 3).into();
        let up = (earlier.world_from_rig.rotation * way.here_from_target.rotation).inverse()
            * Vector3::z();
        let height_sigma_m = up.dot(&(of_place * up)).max(0.0).sqrt();
        let mut covariance = way.covariance;
        let (turn, shift) = (DRIFT_RAD_PER_M * way.length_m, DRIFT_SHARE * way.length_m);
        for k in 0..3 {
            covariance[(k, k)] += turn * turn;
            covariance[(k + 3, k + 3)] += shift * shift;
        }
        let [_, worst_sigma_m] = worst_sigmas(&covariance);
        Self {
            earlier_from_later: way.here_from_target,
            covariance,
            worst_sigma_m,
            height_sigma_m,
            rise_m: (earlier.world_from_rig.rotation * way.here_from_target.translation).z,
        }
    }

    /// What speaks against a loop before any scan is looked at.
    fn objection(&self) -> Option<LoopRejection> {
        let distance_m = self.earlier_from_later.translation.norm();
        let open_m = SIGMAS * self.worst_sigma_m;
        if distance_m - open_m > MAX_DISTANCE_M {
            Some(LoopRejection::ContradictsOdometry)
        } else if open_m > MAX_OPEN_M || SIGMAS * self.height_sigma_m > MAX_RISE_M {
            Some(LoopRejection::OdometryTooUncertain)
        } else if self.rise_m.abs() > 2.0 * MAX_RISE_M {
            // Another floor, even if it had drifted as far as it may.
            Some(LoopRejection::ContradictsOdometry)
        } else {
            None
        }
    }

    fn squared_sigmas(&self, off: &Vector6<f64>) -> f64 {
        let whitened = self.covariance.cholesky().map(|c| c.solve(off));
        whitened.map_or(f64::INFINITY, |w| off.dot(&w))
    }
}

/// A registered place with its standard deviations; `None` where a direction is not seen at all.
fn measured(place: &Registration, information: &Matrix6<f64>) -> Option<MeasuredLoop> {
    let covariance = information.cholesky()?.inverse();
    let [turn_rad, shift_m] = worst_sigmas(&covariance);
    let rotation_sigma_rad = turn_rad.hypot(SHARED_RAD);
    let translation_sigma_m = shift_m.hypot(SHARED_M);
    let is_finite = rotation_sigma_rad.is_finite() && translation_sigma_m.is_finite();
    is_finite.then_some(MeasuredLoop {
        earlier_from_later: place.world_from_rig,
        rotation_sigma_rad,
        translation_sigma_m,
    })
}
