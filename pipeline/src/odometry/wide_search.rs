//! Scans whose place is known to a region alone.
//!
//! Scans that are seconds apart are bridged by the IMU to half a metre or two, from where a registration may end on the wrong surface. There
//! the whole region is searched, from many starts, and a place is taken only where most of the scan lies on the map and nowhere else in reach
//! nearly as well. After a gap that the IMU does not bridge the region around the last place is searched.
//!
//! Over seconds the filter lives on tilt: a degree that the prediction was wrong by is 0.4 m/s after five seconds. A scan whose points carry no
//! times is turned against its stamp by what the carrier turned while it was taken, and a carrier that sways turns by a degree: so
//! much a scan that was not deskewed leaves open.
//!
//! How wrong an IMU is over seconds no data sheet tells: biases shift when a carrier begins to walk. The covariance of the prediction is
//! therefore widened by what predictions were lately off by, against what they said (a fading memory, as in Sorenson and Sacks, "Recursive
//! fading memory filtering", Information Sciences 1971, with the factor from the normalized innovations).

use std::collections::VecDeque;

use lsfb_geometry::{Matrix3, Matrix6, Se3, StampedPose};
use lsfb_perception::lidar::{PosePrior, Registration};

use super::motion::{Motion, end_pose};
use super::{Odometry, ReducedScan};
use crate::place_search::{self, Places, Query, Region};

/// From nearer than this a registration finds its way by itself, metres (three standard deviations of the prediction).
const SURE_REACH_M: f64 = 0.75;
/// Share of a scan that must lie on the map where it was searched for: wrong places reach 0.3.
const MIN_OVERLAP: f64 = 0.4;
/// A rival that fits this share as well as the best place, and that the prediction does not rule out, leaves the place open.
const RIVAL_SHARE: f64 = 0.9;
/// By so much more in squared standard deviations a rival is ruled out: three of them.
const RULED_OUT: f64 = 9.0;
/// The largest region that is searched, one standard deviation in metres: along the ground, and up.
const LARGEST_ALONG_M: f64 = 8.0 / 3.0;
const LARGEST_UP_M: f64 = 0.35;
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
    fn doubt(&self) -> f64 {
        let sum: f64 = self.squared_sigmas.iter().sum();
        let count = (self.squared_sigmas.len() + SUPPOSED) as f64;
        let mean = (sum / 6.0 + SUPPOSED as f64 * SUPPOSED_DOUBT) / count;
        mean.clamp(1.0, MOST_DOUBT)
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
const MOST_DOUBT: f64 = 10.0;

/// Keeps what is not open at all from failing to be inverted: next to nothing.
const LEAST_OPEN: f64 = 1e-12;

impl Odometry {
    /// Searches for a scan. `None` where the prediction is good enough to register from, or where there is none to search about.
    pub(super) fn search(&mut self, reduced: &ReducedScan, path: &[StampedPose]) -> Option<Find> {
        self.region(&self.prior(path))?;
        let doubt = self.innovations.doubt();
        if let Motion::Inertial(inertial) = &mut self.motion {
            inertial.filter.as_mut()?.doubt(doubt);
        }
        let prior = self.prior(path);
        let region = self.region(&prior)?;
        let query = Query {
            points_in_rig: &reduced.keypoints,
            sensor_in_rig: self.lidar.rig_from_lidar.translation,
        };
        let config = self.registration(SURE_REACH_M.min(self.config.initial_gate_m));
        let places = place_search::search(&query, &region, &self.map, &config)?;
        let mut registration = *places.best()?;
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
        // Against what it says itself, without the doubt.
        find.squared_sigmas = doubt * both.cholesky().map_or(0.0, |c| off.dot(&c.solve(&off)));
        Some(find)
    }

    /// Where to search; `None` where that is not needed.
    fn region(&self, prior: &PosePrior) -> Option<Region> {
        let Motion::Inertial(_) = &self.motion else {
            return None;
        };
        if self.map.is_empty() {
            return None;
        }
        let covariance = prior.information.cholesky()?.inverse();
        let of_place: Matrix3<f64> = covariance.fixed_view::<3, 3>(3, 3).into();
        let sigma_m = of_place.symmetric_eigenvalues().max().max(0.0).sqrt();
        if 3.0 * sigma_m < SURE_REACH_M {
            return None;
        }
        let down_in_world = self.inertial_state()?.gravity_m_s2;
        let mut region = Region {
            map_from_rig: prior.world_from_rig,
            covariance,
            up_in_rig: -(prior.world_from_rig.rotation.inverse() * down_in_world).normalize(),
        };
        if sigma_m > LARGEST_ALONG_M {
            // The IMU knows which way it looks, and no more where it is: most likely not far from where it was.
            region.map_from_rig.translation = self.last_registered?.world_from_rig.translation;
            let up = region.up_in_rig;
            let vertical = up * up.transpose();
            let of_place = (Matrix3::identity() - vertical) * LARGEST_ALONG_M.powi(2)
                + vertical * LARGEST_UP_M.powi(2);
            region.covariance.fill(0.0);
            let of_turn = covariance.fixed_view::<3, 3>(0, 0);
            region
                .covariance
                .fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&of_turn);
            region
                .covariance
                .fixed_view_mut::<3, 3>(3, 3)
                .copy_from(&of_place);
        }
        Some(region)
    }
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
