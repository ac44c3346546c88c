//! Scans whose place is known to a region alone.
//!
//! Scans that are seconds apart are bridged by the IMU to half a metre or two, from where a registration may end on the wrong surface. There
//! the whole region is searched, from many starts, and a place is taken only where most of the scan lies on the map and nowhere else in reach
//! nearly as well, and where its rays pass through nothing that earlier scans saw. After a gap that the IMU does not bridge the region around the last place is searched.
//!
//! Over seconds the filter lives on tilt: a degree that the prediction was wrong by is 0.4 m/s after five seconds. A scan whose points carry no
//! times is turned against its stamp by what the carrier turned while it was taken, and a carrier that sways turns by a degree: so
//! much a scan that was not deskewed leaves open.
//!
//! How wrong an IMU is over seconds no data sheet tells: biases shift when a carrier begins to walk. The covariance of the prediction is
//! therefore widened by what predictions were lately off by, against what they said (a fading memory, as in Sorenson and Sacks, "Recursive
//! fading memory filtering", Information Sciences 1971, with the factor from the normalized innovations).

use std::collections::VecDeque;

use lsfb_geometry::{Matrix3, Matrix6, Se3, StampedPose, Vector3};
use lsfb_perception::lidar::{PosePrior, Registration};
use lsfb_types::Timestamp;

use super::free_space::PASSED_M;
use super::motion::{Motion, end_pose};
use super::{Odometry, ReducedScan};
use crate::place_search::{self, Places, Query, Region};
use crate::worst_sigma::worst_sigmas;

/// From nearer than this a registration finds its way by itself, metres (three standard deviations of the prediction).
const SURE_REACH_M: f64 = 0.75;
/// Scans that come more often find their way by themselves, seconds: while a walk that begins in motion does not know its speed yet, the
/// next scan teaches it.
const RARE_S: f64 = 0.5;
/// Share of a scan that must lie on the map where it was searched for: wrong places reach 0.3.
const MIN_OVERLAP: f64 = 0.4;
/// A rival that fits this share as well as the best place, and that the prediction does not rule out, leaves the place open.
const RIVAL_SHARE: f64 = 0.9;
/// No place is taken where a larger share of what two scans could both see contradicts it. Right places: up to 0.02, where people walk some
/// more; wrong ones that most of a scan fits: from 0.1.
const MOST_CONTRADICTED: f64 = 0.05;
/// By so much more in squared standard deviations a rival is ruled out: three of them.
const RULED_OUT: f64 = 9.0;
/// The largest region that is searched, one standard deviation in metres: along the ground, and up.
const LARGEST_ALONG_M: f64 = 8.0 / 3.0;
const LARGEST_UP_M: f64 = 0.35;
/// Shares of it, where it is still too large because the heading is open as well.
const SHARES: [f64; 3] = [1.0, 0.75, 0.5];
/// After a search in vain the next may begin so much later, seconds: scans that come ten times a second must not wait for one each.
const PAUSE_S: f64 = 3.0;
/// A scan without times may have been taken so long before its stamp, seconds: sensors that spin do so ten times a second.
const SWEEP_S: f64 = 0.1;

/// Where a scan was found that was searched for.
#[derive(Clone, Debug)]
pub(super) struct Find {
    /// Of the scan alone; agreeing with nothing where the place is not known.
    pub registration: Registration,
    /// What the scan leaves open because its points carry no times: covariance in the tangent of its pose.
    pub open: Matrix6<f64>,
    /// The pose in which scan and prediction agree best.
    pub with_prediction: Se3,
    /// How far the prediction was off, in squared standard deviations of six numbers.
    pub squared_sigmas: f64,
}

impl Find {
    /// Information of the scan on the pose at its stamp.
    pub fn weakened(&self, information: &Matrix6<f64>) -> Matrix6<f64> {
        // (H⁻¹ + M)⁻¹ = H − H (H + M⁻¹)⁻¹ H, which holds where H sees nothing of a direction.
        let open = self.open + Matrix6::identity() * LEAST_OPEN;
        let inner = open.cholesky().map(|c| c.inverse() + information);
        let inner = inner.and_then(|inner| inner.cholesky());
        inner.map_or(*information, |c| {
            information - information * c.solve(information)
        })
    }
}

/// What predictions of searched scans were off by lately.
#[derive(Clone, Debug, Default)]
pub(super) struct Innovations {
    /// In squared standard deviations of six numbers.
    squared_sigmas: VecDeque<f64>,
}

impl Innovations {
    /// By how much the covariance of a prediction is to be multiplied.
    fn inflation(&self) -> f64 {
        let sum: f64 = self.squared_sigmas.iter().sum();
        let count = (self.squared_sigmas.len() + SUPPOSED) as f64;
        let mean = (sum / 6.0 + SUPPOSED as f64 * SUPPOSED_DOUBT) / count;
        mean.clamp(1.0, MOST_INFLATION)
    }

    pub fn take(&mut self, squared_sigmas: f64) {
        if self.squared_sigmas.len() == INNOVATIONS {
            self.squared_sigmas.pop_front();
        }
        self.squared_sigmas.push_back(squared_sigmas);
    }
}

/// Predictions looked back at.
const INNOVATIONS: usize = 10;
/// What is supposed before there are any, as so many of them, each off by more than it says by so much (in squares).
const SUPPOSED: usize = 2;
const SUPPOSED_DOUBT: f64 = 2.0;
/// No prediction is doubted more.
const MOST_INFLATION: f64 = 10.0;

/// Keeps what is not open at all from failing to be inverted: next to nothing.
const LEAST_OPEN: f64 = 1e-12;

impl Odometry {
    /// Searches for a scan. `None` where the prediction is good enough to register from, or where there is none to search about.
    pub(super) fn search(&mut self, reduced: &ReducedScan, path: &[StampedPose]) -> Option<Find> {
        let now = path.last()?.time;
        let is_soon = |last: Timestamp| now.secs_since(last) < PAUSE_S;
        let last = self.last_registered?;
        if now.secs_since(last.time) < RARE_S
            || self.searched_in_vain.is_some_and(is_soon)
            || !self.is_known_to_a_region_alone(&self.prior(path))
        {
            return None;
        }
        // Once for each prediction, however many scans are then searched for with it.
        let mut inflation = 1.0;
        if self.searched_in_vain.is_none()
            && let Motion::Inertial(inertial) = &mut self.motion
        {
            inflation = self.innovations.inflation();
            inertial.filter.as_mut()?.widen(inflation);
        }
        self.searched_in_vain = Some(now);
        let prior = self.prior(path);
        let query = Query {
            points_in_rig: &reduced.keypoints,
            sensor_in_rig: self.lidar.rig_from_lidar.translation,
        };
        let config = self.registration(SURE_REACH_M.min(self.config.initial_gate_m));
        let mut regions = self.regions(&prior)?.into_iter();
        let search = |region: Region| place_search::search(&query, &region, &self.map, &config);
        let mut places = regions.find_map(search)?;
        let mut registration = *places.best()?;
        let may_be = |place: &Registration| !self.is_contradicted(reduced, &place.world_from_rig);
        places.found.retain(may_be);
        if let Some(best) = places.best() {
            registration = *best;
        }
        if !is_known(&places, &prior) {
            registration.inlier_ratio = 0.0;
        }
        let open = match reduced.is_timed {
            true => Matrix6::zeros(),
            false => moved_while_taken(path),
        };
        let mut find = Find {
            registration,
            open,
            with_prediction: registration.world_from_rig,
            squared_sigmas: 0.0,
        };
        let information = find.weakened(&registration.information);
        find.with_prediction = with_prior(&prior, &registration.world_from_rig, &information);
        let off = prior.world_from_rig.local(&registration.world_from_rig);
        let both = prior.information.cholesky()?.inverse() + open;
        // Against what it says itself, without the inflation.
        find.squared_sigmas = inflation * both.cholesky().map_or(0.0, |c| off.dot(&c.solve(&off)));
        Some(find)
    }

    /// Whether a registration from the predicted pose may end on the wrong surface.
    fn is_known_to_a_region_alone(&self, prior: &PosePrior) -> bool {
        matches!(self.motion, Motion::Inertial(_))
            && !self.map.is_empty()
            && sigma_m(prior).is_some_and(|sigma_m| 3.0 * sigma_m >= SURE_REACH_M)
    }

    /// Whether too much speaks against a scan at a place: rays through what was seen, or points where nothing was.
    fn is_contradicted(&self, reduced: &ReducedScan, world_from_rig: &Se3) -> bool {
        let sensor_in_rig = self.lidar.rig_from_lidar.translation;
        let sensor = *world_from_rig * sensor_in_rig;
        let gate_m = PASSED_M.min(self.config.initial_gate_m);
        let is_on_map = |point: &Vector3<f64>| {
            let found = self.map.find(point, &(sensor - point), gate_m);
            found.is_some()
        };
        let points = &reduced.insert_points;
        let against =
            self.free_space
                .contradictions(points, &sensor_in_rig, world_from_rig, is_on_map);
        against.share() > MOST_CONTRADICTED
    }

    /// Where to search: the first of these that is not too large.
    fn regions(&self, prior: &PosePrior) -> Option<Vec<Region>> {
        let covariance = prior.information.cholesky()?.inverse();
        let down_in_world = self.inertial_state()?.gravity_m_s2;
        let up = -(prior.world_from_rig.rotation.inverse() * down_in_world).normalize();
        let predicted = Region {
            map_from_rig: prior.world_from_rig,
            covariance,
            up_in_rig: up,
        };
        let mut regions = Vec::new();
        if sigma_m(prior)? < LARGEST_ALONG_M {
            regions.push(predicted);
        }
        // Otherwise the IMU knows which way it looks, and no more where it is: most likely not far from where it was.
        let last = self.last_registered?.world_from_rig.translation;
        let of_turn = covariance.fixed_view::<3, 3>(0, 0);
        regions.extend(SHARES.map(|share| {
            let vertical = up * up.transpose();
            let of_place = (Matrix3::identity() - vertical) * (share * LARGEST_ALONG_M).powi(2)
                + vertical * LARGEST_UP_M.powi(2);
            let mut around = predicted;
            around.map_from_rig.translation = last;
            around.covariance.fill(0.0);
            let mut set = |at: usize, block: &Matrix3<f64>| {
                around
                    .covariance
                    .fixed_view_mut::<3, 3>(at, at)
                    .copy_from(block);
            };
            set(0, &of_turn.into());
            set(3, &of_place);
            around
        }));
        Some(regions)
    }
}

/// Standard deviation of the predicted place in its worst direction, metres.
fn sigma_m(prior: &PosePrior) -> Option<f64> {
    let covariance = prior.information.cholesky()?.inverse();
    let [_, place_m] = worst_sigmas(&covariance);
    Some(place_m)
}

/// Whether the best place is good, and no other that may be meant is nearly as good.
fn is_known(places: &Places, prior: &PosePrior) -> bool {
    let squared_sigmas = |place: &Registration| {
        let off = prior.world_from_rig.local(&place.world_from_rig);
        off.dot(&(prior.information * off))
    };
    let Some((best, others)) = places.found.split_first() else {
        return false;
    };
    let limit = squared_sigmas(best) + RULED_OUT;
    let is_rival = |other: &Registration| {
        other.inlier_ratio > RIVAL_SHARE * best.inlier_ratio && squared_sigmas(other) < limit
    };
    best.inlier_ratio >= MIN_OVERLAP && !others.iter().any(is_rival)
}

/// A pose that a scan alone gave, drawn to what was known before: `H_s (x − x_s) + H_p (x − x_p) = 0`.
fn with_prior(prior: &PosePrior, by_scan: &Se3, information: &Matrix6<f64>) -> Se3 {
    let pulled = prior.information * prior.world_from_rig.local(by_scan);
    let both = (information + prior.information).cholesky();
    both.map_or(*by_scan, |c| by_scan.retract(&-c.solve(&pulled)))
}

/// Mean square motion between the end of a path and the poses of one sweep before it.
fn moved_while_taken(path: &[StampedPose]) -> Matrix6<f64> {
    let end = end_pose(path);
    let is_within = |p: &&StampedPose| {
        path.last()
            .is_some_and(|last| last.time.secs_since(p.time) <= SWEEP_S)
    };
    let moved = path.iter().filter(is_within);
    let moved: Vec<_> = moved.map(|p| end.local(&p.world_from_rig)).collect();
    let sum: Matrix6<f64> = moved.iter().map(|d| d * d.transpose()).sum();
    sum / moved.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{UnitQuaternion, Vector6};

    use super::*;

    /// A place so far along x at which such a share of the scan lies on the map.
    fn place(x_m: f64, inlier_ratio: f64) -> Registration {
        Registration {
            world_from_rig: Se3::new(UnitQuaternion::identity(), Vector3::x() * x_m),
            information: Matrix6::identity() * 1e6,
            plane_information: Matrix6::identity() * 1e6,
            inlier_ratio,
            plane_rms_m: 0.01,
            iterations: 5,
        }
    }

    /// Predicted at the origin, to a metre in each direction.
    fn prior() -> PosePrior {
        PosePrior {
            world_from_rig: Se3::identity(),
            information: Matrix6::identity(),
        }
    }

    #[test]
    fn a_place_is_taken_only_without_a_rival_that_may_be_meant() {
        let is_known_among = |places: &[(f64, f64)]| {
            let found = places.iter().map(|(x_m, share)| place(*x_m, *share));
            let places = Places {
                found: found.collect(),
            };
            is_known(&places, &prior())
        };
        assert!(is_known_among(&[(0.5, 0.7), (2.0, 0.5)]));
        // Doors every two metres: both may be meant. Naively the better one was taken.
        assert!(!is_known_among(&[(0.5, 0.7), (2.5, 0.68)]));
        // One that is four standard deviations off is not.
        assert!(is_known_among(&[(0.5, 0.7), (4.5, 0.68)]));
        // What chance alone makes is no place, and nothing is none.
        assert!(!is_known_among(&[(0.5, 0.3)]));
        assert!(!is_known_among(&[]));
    }

    #[test]
    fn what_a_carrier_turned_while_a_scan_was_taken_is_open() {
        let rate_rad_s = 0.2;
        let pose = |k: i64| StampedPose {
            time: Timestamp::from_nanos(k * 5_000_000),
            world_from_rig: Se3::exp(&Vector6::new(
                rate_rad_s * 0.005 * k as f64,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
            )),
        };
        let path: Vec<_> = (0..1000).map(pose).collect();
        let open = moved_while_taken(&path);
        // The root of the mean square of an even turn is its end over √3.
        let expected = rate_rad_s * SWEEP_S / 3f64.sqrt();
        assert!(
            (open[(0, 0)].sqrt() / expected - 1.0).abs() < 0.05,
            "{open}"
        );
        let find = Find {
            registration: place(0.0, 0.7),
            open,
            with_prediction: Se3::identity(),
            squared_sigmas: 0.0,
        };
        let weakened = find.weakened(&find.registration.information);
        let turn = weakened[(0, 0)].recip().sqrt();
        assert!(
            (turn - expected.hypot(1e-3)).abs() < 0.02 * expected,
            "{turn}"
        );
        assert!((weakened[(5, 5)] / 1e6 - 1.0).abs() < 1e-3, "{weakened}");
        // Nothing is seen, nothing is told.
        assert!(find.weakened(&Matrix6::zeros()).norm() < 1e-9);
    }

    #[test]
    fn predictions_that_are_off_by_more_than_they_say_are_doubted() {
        let mut innovations = Innovations::default();
        assert!(innovations.inflation() > 1.5);
        (0..20).for_each(|_| innovations.take(6.0));
        assert!(innovations.inflation() < 1.2);
        (0..20).for_each(|_| innovations.take(24.0));
        assert!((3.0..4.5).contains(&innovations.inflation()));
        (0..20).for_each(|_| innovations.take(1e9));
        assert!(innovations.inflation() <= MOST_INFLATION);
    }
}
