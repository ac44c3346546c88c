//! Velocity, gravity and scale of a device in motion, from tracks and samples over a second or two.
//!
//! With rotations from the gyroscope, every position is a linear function of the first velocity, gravity and the accelerometer's bias; so
//! is the distance of a point from each of its rays. Linear least squares with the points eliminated gives all of them without a guess
//! (Martinelli, "Closed-Form Solution of Visual-Inertial Structure from Motion", IJCV 2014). That the gravity found is as strong as it must
//! be shows that it is right.

use std::ops::Range;

use lsfb_geometry::{Matrix3, Se3, UnitQuaternion, Vector3};
use lsfb_types::STANDARD_GRAVITY_M_S2;
use nalgebra::{SMatrix, SVector};

use super::gyro_bias;
use super::sights::Tracks;
use crate::ground_truth::GroundTruthConfig;
use crate::ground_truth::walk::{FrameState, LocalObservation, Walk};
use lsfb_perception::imu::{ImuBias, NavState, PreintegratedImu};

/// How long a beginning in motion is looked at, seconds, and the least of it where the walk is shorter.
const WINDOW_SECS: f64 = 2.0;
const SHORTEST_SECS: f64 = 1.0;
/// Solutions, each with the depths of the one before as weights.
const ROUNDS: usize = 5;
/// Depth of a point before any is known, metres.
const FIRST_DEPTH_M: f64 = 3.0;
/// Nearest that a point may be, metres.
const NEAREST_M: f64 = 0.1;
/// Standard deviation of a ray, radians: of its pixel, and of the rotation by the gyroscope.
const RAY_SIGMA: f64 = 4e-3;
/// Beyond this many standard deviations a ray counts less.
const HUBER: f64 = 1.5;
/// Least ratio of the eigenvalues of a point's moments: rays of less parallax (about a degree) do not place it.
const LEAST_CONDITION: f64 = 1e-4;
/// Points that tell.
const FEWEST_POINTS: usize = 15;
/// How far gravity may be from what it must be, m/s².
const LARGEST_GRAVITY_ERROR_M_S2: f64 = 0.5;
/// Largest standard deviation of the way that was gone, as a share of it: it is that of the scale.
const LARGEST_SCALE_SIGMA: f64 = 0.15;

/// First velocity, gravity, bias of the accelerometer.
type Unknowns = SVector<f64, 9>;
type Information = SMatrix<f64, 9, 9>;

/// Next window of frames from `first` on that is long enough; `None` where too little is left.
pub(super) fn next_window(walk: &Walk, first: usize) -> Option<Range<usize>> {
    let start = walk.frames.get(first)?.time;
    let within = |f: &crate::ground_truth::walk::Frame| f.time.secs_since(start) <= WINDOW_SECS;
    let end = first + walk.frames[first..].partition_point(within);
    let secs = walk.frames[end - 1].time.secs_since(start);
    (secs >= SHORTEST_SECS).then_some(first..end)
}

/// States of the frames of a window in a level world that begins there; `None` where the motion does not show them.
pub(super) fn states(
    walk: &Walk,
    tracks: &Tracks,
    window: Range<usize>,
    config: &GroundTruthConfig,
) -> Option<Vec<FrameState>> {
    let gyro_rad_s = gyro_bias::estimate(walk, tracks, &window)?;
    let bias = ImuBias {
        gyro_rad_s,
        accel_m_s2: Vector3::zeros(),
    };
    let start = walk.frames[window.start].time;
    let mut changes = vec![PreintegratedImu::nothing(bias)];
    for frame in &walk.frames[window.start + 1..window.end] {
        let change = PreintegratedImu::integrate(&walk.imu, start, frame.time, bias, &walk.noise);
        changes.push(change.ok()?);
    }
    let tracks = tracks.within(&window);
    solve(walk, &tracks, &changes, config).map(|found| found.states(&changes))
}

/// What was found.
struct Found {
    velocity_m_s: Vector3<f64>,
    gravity_m_s2: Vector3<f64>,
    bias: ImuBias,
}

impl Found {
    fn states(&self, changes: &[PreintegratedImu]) -> Vec<FrameState> {
        let level = UnitQuaternion::rotation_between(&-self.gravity_m_s2, &Vector3::z())
            .unwrap_or_else(|| {
                UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
            });
        let first = NavState {
            world_from_rig: Se3::new(level, Vector3::zeros()),
            velocity_m_s: level * self.velocity_m_s,
        };
        let gravity_m_s2 = level * self.gravity_m_s2;
        let state = |change: &PreintegratedImu| FrameState {
            nav: change.predict(&first, &self.bias, &gravity_m_s2),
            bias: self.bias,
        };
        changes.iter().map(state).collect()
    }
}

/// A ray in the frame of the first instant: direction, and its origin as a function of the unknowns.
struct Ray {
    direction: Vector3<f64>,
    origin: Vector3<f64>,
    by_unknowns: SMatrix<f64, 3, 9>,
}

impl Ray {
    fn of(walk: &Walk, changes: &[PreintegratedImu], seen: &LocalObservation) -> Option<Self> {
        let camera = &walk.cameras[seen.camera];
        let rig_from_camera = camera.camera_from_rig().inverse();
        let change = &changes[seen.frame];
        let (secs, rotation) = (change.duration_secs, change.rotation);
        let mut by_unknowns = SMatrix::<f64, 3, 9>::zeros();
        let by = [
            Matrix3::identity() * secs,
            Matrix3::identity() * (0.5 * secs * secs),
            change.by_bias.position_by_accel,
        ];
        for (k, block) in by.iter().enumerate() {
            by_unknowns
                .fixed_view_mut::<3, 3>(0, 3 * k)
                .copy_from(block);
        }
        let ray = camera.camera().unproject(&seen.pixel)?;
        Some(Self {
            direction: (rotation * (rig_from_camera.rotation * ray)).normalize(),
            origin: change.position_m + rotation * rig_from_camera.translation,
            by_unknowns,
        })
    }

    fn from(&self, unknowns: &Unknowns) -> Vector3<f64> {
        self.origin + self.by_unknowns * unknowns
    }
}

/// A point's rays and what each counts.
struct Bundle {
    rays: Vec<Ray>,
    weights: Vec<f64>,
}

impl Bundle {
    /// Moments of the rays, their derivative by the unknowns and their value without: the point is `A⁻¹ (B y + e)`.
    fn moments(&self) -> (Matrix3<f64>, SMatrix<f64, 3, 9>, Vector3<f64>) {
        let mut sum = (Matrix3::zeros(), SMatrix::zeros(), Vector3::zeros());
        for (ray, weight) in self.rays.iter().zip(&self.weights) {
            let across = across(&ray.direction) * *weight;
            sum.0 += across;
            sum.1 += across * ray.by_unknowns;
            sum.2 += across * ray.origin;
        }
        sum
    }

    fn point(&self, unknowns: &Unknowns) -> Option<Vector3<f64>> {
        let (a, b, e) = self.moments();
        let values = a.symmetric_eigenvalues();
        (values.min() > LEAST_CONDITION * values.max())
            .then(|| a.try_inverse())?
            .map(|inverse| inverse * (b * unknowns + e))
    }

    /// Weights by the distances along the rays; `false` where the point lies behind one or nowhere.
    fn weigh(&mut self, unknowns: &Unknowns) -> bool {
        let Some(point) = self.point(unknowns) else {
            return false;
        };
        for (ray, weight) in self.rays.iter().zip(&mut self.weights) {
            let from = point - ray.from(unknowns);
            let depth_m = from.dot(&ray.direction);
            if depth_m < NEAREST_M {
                return false;
            }
            let sigma_m = RAY_SIGMA * depth_m;
            let sigmas = (across(&ray.direction) * from).norm() / sigma_m;
            *weight = (HUBER / sigmas.max(HUBER)) / (sigma_m * sigma_m);
        }
        true
    }
}

/// The part of a vector that is across a direction.
fn across(direction: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::identity() - direction * direction.transpose()
}

fn solve(
    walk: &Walk,
    tracks: &[Vec<LocalObservation>],
    changes: &[PreintegratedImu],
    config: &GroundTruthConfig,
) -> Option<Found> {
    let first_weight = (RAY_SIGMA * FIRST_DEPTH_M).powi(-2);
    let bundle = |track: &Vec<LocalObservation>| {
        let rays: Vec<Ray> = track
            .iter()
            .filter_map(|seen| Ray::of(walk, changes, seen))
            .collect();
        Bundle {
            weights: vec![first_weight; rays.len()],
            rays,
        }
    };
    let mut bundles: Vec<Bundle> = tracks.iter().map(bundle).collect();
    let (mut unknowns, mut covariance) = (Unknowns::zeros(), Information::zeros());
    for round in 0..ROUNDS {
        (unknowns, covariance) = solve_once(&bundles, config)?;
        if round + 1 < ROUNDS {
            // Points behind a camera are nowhere only while the unknowns are far off.
            let placed: Vec<bool> = bundles.iter_mut().map(|b| b.weigh(&unknowns)).collect();
            let mut placed = placed.into_iter();
            if round > 0 {
                bundles.retain(|_| placed.next().unwrap_or(false));
            }
            if bundles.len() < FEWEST_POINTS {
                return None;
            }
        }
    }
    let gravity_m_s2 = unknowns.fixed_rows::<3>(3).into_owned();
    let mut way: Option<(f64, f64)> = None;
    for change in changes {
        let secs = change.duration_secs;
        let mut by = SMatrix::<f64, 3, 9>::zeros();
        by.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(secs);
        by.fixed_view_mut::<3, 3>(0, 3)
            .fill_diagonal(0.5 * secs * secs);
        by.fixed_view_mut::<3, 3>(0, 6)
            .copy_from(&change.by_bias.position_by_accel);
        let gone = change.position_m + by * unknowns;
        let sigma_m = (by * covariance * by.transpose()).trace().sqrt();
        if way.is_none_or(|(most, _)| gone.norm() > most) {
            way = Some((gone.norm(), sigma_m));
        }
    }
    let (way_m, sigma_m) = way?;
    let is_gravity =
        (gravity_m_s2.norm() - STANDARD_GRAVITY_M_S2).abs() <= LARGEST_GRAVITY_ERROR_M_S2;
    (is_gravity && sigma_m <= LARGEST_SCALE_SIGMA * way_m).then(|| Found {
        velocity_m_s: unknowns.fixed_rows::<3>(0).into_owned(),
        gravity_m_s2,
        bias: ImuBias {
            gyro_rad_s: changes[0].bias.gyro_rad_s,
            accel_m_s2: unknowns.fixed_rows::<3>(6).into_owned(),
        },
    })
}

/// Linear least squares with the points eliminated: the unknowns and their covariance.
fn solve_once(bundles: &[Bundle], config: &GroundTruthConfig) -> Option<(Unknowns, Information)> {
    let mut information = Information::zeros();
    let mut right = Unknowns::zeros();
    for k in 6..9 {
        information[(k, k)] = config.accel_bias_sigma_m_s2.powi(-2);
    }
    let mut points = 0;
    for bundle in bundles {
        let (a, b, e) = bundle.moments();
        let values = a.symmetric_eigenvalues();
        if values.min() <= LEAST_CONDITION * values.max() {
            continue;
        }
        let inverse = a.try_inverse()?;
        for (ray, weight) in bundle.rays.iter().zip(&bundle.weights) {
            let weighted = ray.by_unknowns.transpose() * across(&ray.direction) * *weight;
            information += weighted * ray.by_unknowns;
            right -= weighted * ray.origin;
        }
        information -= b.transpose() * inverse * b;
        right += b.transpose() * inverse * e;
        points += 1;
    }
    if points < FEWEST_POINTS {
        return None;
    }
    let covariance = information.cholesky()?.inverse();
    Some((covariance * right, covariance))
}
