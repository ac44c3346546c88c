//! What an alignment came to.

use lsfb_geometry::{Matrix6, Se3, StampedPose, Vector6};
use lsfb_types::Finding;
use serde::Serialize;

use super::super::{UncertainPose, statistics, uncertain};
use super::clock::Clock;
use super::filter::{MarkerPose, Smoothed};
use super::motion::{CLOCK, Inertial, MOUNT_ROTATION, Matrix25, PLACE, ROTATION};
use crate::{Error, Statistics};

/// Poses less certain than this are left out of the path: rotation, degrees, and position, metres.
const MOST_SIGMA: (f64, f64) = (0.2, 0.002);

/// Motion capture aligned to an IMU.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MocapAlignment {
    /// Where the IMU sits on the markers' body.
    pub markers_from_imu: UncertainPose,
    /// What must be added to the IMU's stamps to have the motion capture's, in the middle, seconds.
    pub offset_secs: f64,
    /// Its standard deviation, seconds.
    pub sigma_offset_secs: f64,
    /// Change of the offset, seconds per second; zero where the clock does not drift.
    pub drift: f64,
    /// Least and largest offset, seconds.
    pub offset_range_secs: [f64; 2],
    /// In the middle, rad/s.
    pub gyro_bias_rad_s: [f64; 3],
    /// In the middle, m/s².
    pub accel_bias_m_s2: [f64; 3],
    /// In the world of the motion capture, m/s².
    pub gravity_m_s2: [f64; 3],
    /// Distances of the markers' body from where the IMU has it, where used, metres.
    pub translation_m: Statistics,
    /// Angles between them, degrees.
    pub rotation_deg: Statistics,
    /// Poses of the motion capture looked at.
    pub poses: usize,
    /// Of these, those that do not fit: swapped markers.
    pub outliers: usize,
    /// Longest time without a pose that fits, seconds.
    pub longest_gap_secs: f64,
    /// Share of the time in which the path is certain enough to be given, 0 to 1.
    pub given: f64,
    /// What must not be trusted.
    #[serde(skip)]
    pub findings: Vec<Finding>,
    /// Path of the IMU in the world of the motion capture, on the IMU's clock, at its samples, where it is certain.
    #[serde(skip)]
    pub path: Vec<StampedPose>,
    /// Markers' body from IMU.
    #[serde(skip)]
    pub body: Se3,
}

/// How far the motion capture's errors reach.
#[derive(Clone, Copy, Debug)]
pub(super) struct Noise {
    /// Standard deviations of a component of what is left over, rotation and position, rad and metres.
    pub sigmas: [f64; 2],
    /// By which standard deviations of what all poses tell together are raised, as neighbouring errors hang together.
    pub factor: f64,
}

/// Standard deviations are raised by `noise`.
pub(super) fn outcome(
    inertial: &Inertial,
    seen: &[MarkerPose],
    found: &[Smoothed],
    clock: &Clock,
    noise: Noise,
) -> Result<MocapAlignment, Error> {
    let factor = noise.factor;
    let left: Vec<_> = found.iter().map(Smoothed::fits).collect();
    let known = || left.iter().flatten();
    let middle = &found[found.len() / 2];
    let sigma = |at: usize| factor * middle.covariance[(at, at)].max(0.0).sqrt();
    // In its own tangent the inverse moves by the adjoint.
    let mount = middle.state.mount;
    let body = mount.inverse();
    let offsets = || {
        found
            .iter()
            .zip(seen)
            .map(|(f, s)| offset_secs(f, s, clock))
    };
    let seen_poses = seen.iter().filter(|s| s.markers.is_some()).count();
    let used = known().count();
    let (path, given) = path(inertial, seen, found, noise);
    Ok(MocapAlignment {
        markers_from_imu: uncertain(&body, &inverse_sigmas(&mount, &middle.covariance, factor)),
        offset_secs: offset_secs(middle, &seen[found.len() / 2], clock),
        sigma_offset_secs: sigma(CLOCK),
        drift: -clock.drift,
        offset_range_secs: offsets().fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], o| {
            [l.min(o), h.max(o)]
        }),
        gyro_bias_rad_s: middle.state.gyro_bias.into(),
        accel_bias_m_s2: middle.state.accel_bias.into(),
        gravity_m_s2: middle.state.gravity.into(),
        translation_m: statistics(
            &known()
                .map(|e| e.fixed_rows::<3>(3).norm())
                .collect::<Vec<_>>(),
        )?,
        rotation_deg: statistics(
            &known()
                .map(|e| e.fixed_rows::<3>(0).norm().to_degrees())
                .collect::<Vec<_>>(),
        )?,
        poses: seen_poses,
        outliers: seen_poses - used,
        longest_gap_secs: longest_gap_secs(seen, &left),
        given,
        findings: Vec::new(),
        path,
        body,
    })
}

/// What must be added to the IMU's stamp at which a pose was looked at to have the motion capture's.
fn offset_secs(found: &Smoothed, seen: &MarkerPose, clock: &Clock) -> f64 {
    let at = seen.secs;
    let mocap_secs =
        (at - clock.ahead_secs + clock.drift * clock.middle_secs) / (1.0 + clock.drift);
    mocap_secs - at - found.state.clock_secs
}

/// Standard deviations of the inverse of a pose, in its own tangent.
fn inverse_sigmas(mount: &Se3, covariance: &Matrix25, factor: f64) -> [f64; 6] {
    let mut of_tangent = Matrix6::identity();
    let back = mount.rotation.inverse().to_rotation_matrix().into_inner();
    of_tangent.fixed_view_mut::<3, 3>(3, 3).copy_from(&back);
    let own = covariance.fixed_view::<6, 6>(MOUNT_ROTATION, MOUNT_ROTATION);
    let to_inverse = -mount.adjoint() * of_tangent;
    let moved = to_inverse * own * to_inverse.transpose();
    std::array::from_fn(|k| factor * moved[(k, k)].max(0.0).sqrt())
}

fn longest_gap_secs(seen: &[MarkerPose], left: &[Option<Vector6<f64>>]) -> f64 {
    let used: Vec<f64> = seen
        .iter()
        .zip(left)
        .filter_map(|(s, l)| l.map(|_| s.secs))
        .collect();
    used.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max)
}

/// The IMU's path where it is certain, and the share of the time of which that is.
fn path(
    inertial: &Inertial,
    seen: &[MarkerPose],
    found: &[Smoothed],
    noise: Noise,
) -> (Vec<StampedPose>, f64) {
    // Errors that hang together do not average out, but no pose of the path is further off by them than they are large.
    let sigma = |f: &Smoothed, at: usize, own: f64| {
        let largest = (at..at + 3)
            .map(|k| f.covariance[(k, k)])
            .fold(0.0, f64::max)
            .sqrt();
        f64::min(noise.factor * largest, largest.hypot(own))
    };
    let is_certain = |f: &Smoothed| {
        sigma(f, ROTATION, noise.sigmas[0]).to_degrees() <= MOST_SIGMA.0
            && sigma(f, PLACE, noise.sigmas[1]) <= MOST_SIGMA.1
    };
    let mut path = Vec::new();
    let (mut given, mut all) = (0.0, 0.0);
    for (pair, times) in found.windows(2).zip(seen.windows(2)) {
        let secs = times[1].secs - times[0].secs;
        all += secs;
        if is_certain(&pair[0]) && is_certain(&pair[1]) {
            given += secs;
            path.extend(inertial.poses_from(&pair[0].state, times[0].secs, times[1].secs));
        }
    }
    (path, given / f64::max(all, f64::MIN_POSITIVE))
}
