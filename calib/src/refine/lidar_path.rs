//! The LiDAR's way through the place, by its own scans: each is registered to planes of all others, each return at its own time. The
//! gyroscope says how it turned in between.

use lsfb_geometry::IntegratedGyro;
use lsfb_geometry::{Matrix3, Matrix6, Rig, Se3, UnitQuaternion, Vector3, so3};
use lsfb_perception::RelativePose;
use lsfb_perception::lidar::Motion;
use lsfb_solver::{Kernel, PosePrior, Problem, SolveConfig, solve};
use lsfb_types::{Progress, ProgressFn, Stopped};
use rayon::prelude::*;

use super::predicted_rotation::PredictedRotation;
use super::scan::Scan;
use crate::overlapping_planes::{OverlappingPlanes, OverlappingPlanesBuilder, register_to_planes};

/// Times that the place is made again of all scans.
const ROUNDS: usize = 4;
/// Scans that are put a second time onto what was seen after them: at first too little of floor and ceiling is known.
const AGAIN_S: f64 = 10.0;
/// By how much a scan is expected to be elsewhere than predicted, radians and metres.
const EXPECTED: [f64; 2] = [0.02, 0.08];
/// Returns of a scan with which it is first put onto those before.
const FIRST_RETURNS: usize = 4000;
/// What the gyroscope knows of the turn from one scan to the next, radians.
const GYRO_RAD: f64 = 2e-4;
/// What a scan knows of its pose beside what its returns do on their own: errors of planes are common to many returns.
const SCAN_WORTH: f64 = 0.25;
/// Between scans farther apart than this nothing is known, seconds.
const MOST_GAP_S: f64 = 0.5;
/// Beyond the first and last scan the way goes on for so long, seconds.
const BEYOND_S: f64 = 0.06;

/// Poses of the LiDAR at the middle of each scan, and between.
pub(super) struct LidarPath<'a> {
    times_s: Vec<f64>,
    world_from_lidar: Vec<Se3>,
    /// What each scan knew of its pose, perturbed on the right.
    information: Vec<Matrix6<f64>>,
    predicted_rotation: PredictedRotation<'a>,
}

/// The way, and the place as all scans have it; `None` where scans do not fit on each other.
pub(super) fn follow<'a>(
    scans: &[Scan],
    rig: &Rig,
    gyro: Option<&'a IntegratedGyro>,
    progress: ProgressFn,
) -> Result<Option<(LidarPath<'a>, OverlappingPlanes)>, Stopped> {
    let Some(lidar) = rig.lidar() else {
        return Ok(None);
    };
    let predicted_rotation = PredictedRotation {
        gyro,
        lidar_from_rig: lidar.rig_from_lidar.rotation.inverse(),
        bias_rad_s: Vector3::zeros(),
    };
    let Some(mut path) = register_in_sequence(scans, predicted_rotation, progress)? else {
        return Ok(None);
    };
    path.realign_start(scans);
    for round in 0..ROUNDS {
        progress(Progress {
            stage: "LiDAR odometry",
            done: round as u64,
            total: ROUNDS as u64,
        })?;
        path.predicted_rotation
            .fit(&path.times_s, &path.world_from_lidar);
        let still = path.deskewed(scans);
        let place = path.place(&still);
        let refined: Vec<(Se3, Matrix6<f64>)> = still
            .par_iter()
            .zip(&path.world_from_lidar)
            .map(|(scan, pose)| {
                let found = register_to_planes(scan, *pose, EXPECTED, |at| place.plane(at));
                found.unwrap_or((*pose, Matrix6::zeros()))
            })
            .collect();
        (path.world_from_lidar, path.information) = refined.into_iter().unzip();
        path.join_with_gyro();
    }
    let place = path.place(&path.deskewed(scans));
    Ok(Some((path, place)))
}

/// Each scan after the one before, onto planes of all before.
fn register_in_sequence<'a>(
    scans: &[Scan],
    predicted_rotation: PredictedRotation<'a>,
    progress: ProgressFn,
) -> Result<Option<LidarPath<'a>>, Stopped> {
    let mut surfaces = OverlappingPlanesBuilder::default();
    let mut path = LidarPath {
        times_s: Vec::new(),
        world_from_lidar: Vec::new(),
        information: Vec::new(),
        predicted_rotation,
    };
    for (k, scan) in scans.iter().enumerate() {
        if k % 16 == 0 {
            progress(Progress {
                stage: "LiDAR odometry",
                done: k as u64,
                total: scans.len() as u64,
            })?;
        }
        let (pose, speed) = path.predicted(scan.middle_s);
        let every = scan.returns.len().div_ceil(FIRST_RETURNS).max(1);
        let from_world = pose.rotation.inverse();
        let motion = Motion::sampled(scan.span_ns(), |offset_ns| {
            let at_s = scan.time_s(offset_ns);
            let turn = path.predicted_rotation.between(scan.middle_s, at_s);
            Some(Se3::new(turn, from_world * speed * (at_s - scan.middle_s)))
        });
        let returns = scan.returns.iter().step_by(every);
        let still: Vec<Vector3<f64>> = returns
            .map(|r| motion.undo(i64::from(r.offset_ns), &r.in_lidar))
            .collect();
        let found = if k == 0 {
            Some((pose, Matrix6::zeros()))
        } else {
            register_to_planes(&still, pose, EXPECTED, |at| surfaces.plane(at))
        };
        let Some((pose, information)) = found else {
            return Ok(None);
        };
        surfaces.add(still.iter().map(|p| pose * *p));
        path.times_s.push(scan.middle_s);
        path.world_from_lidar.push(pose);
        path.information.push(information);
    }
    Ok((path.times_s.len() > 2).then_some(path))
}

impl LidarPath<'_> {
    /// Where the next scan should be, and the speed in the world, as far as is known.
    fn predicted(&self, time_s: f64) -> (Se3, Vector3<f64>) {
        let [.., last] = self.world_from_lidar.as_slice() else {
            return (Se3::identity(), Vector3::zeros());
        };
        let n = self.times_s.len();
        let since_s = time_s - self.times_s[n - 1];
        let mut speed = Vector3::zeros();
        if n > 1 {
            let before = &self.world_from_lidar[n - 2];
            let whole = (last.translation - before.translation)
                / (self.times_s[n - 1] - self.times_s[n - 2]);
            // As far as returns showed it: along a corridor nothing is believed.
            let shown = self.information[n - 1]
                .fixed_view::<3, 3>(3, 3)
                .into_owned();
            let prior = Matrix3::identity() / (EXPECTED[1] * EXPECTED[1]);
            if let Some(inverse) = (shown + prior).try_inverse() {
                speed = last.rotation * (inverse * shown * (last.rotation.inverse() * whole));
            }
        }
        let turn = if self.predicted_rotation.gyro.is_some() {
            self.predicted_rotation.between(self.times_s[n - 1], time_s)
        } else if n > 1 {
            let before = self.world_from_lidar[n - 2].rotation.inverse() * last.rotation;
            let share = since_s / (self.times_s[n - 1] - self.times_s[n - 2]);
            so3::exp(&(so3::log(&before) * share))
        } else {
            UnitQuaternion::identity()
        };
        let pose = Se3::new(last.rotation * turn, last.translation + speed * since_s);
        (pose, speed)
    }

    /// The first and the last time at which the way is known, seconds.
    pub fn span_s(&self) -> [f64; 2] {
        [
            self.times_s.first().copied().unwrap_or(0.0),
            self.times_s.last().copied().unwrap_or(0.0),
        ]
    }

    /// `world_from_lidar` at a time: the gyroscope's turning, bent so that it meets the scans; a cubic through positions.
    pub fn at(&self, time_s: f64) -> Option<Se3> {
        let [first, last] = self.span_s();
        if time_s < first - BEYOND_S || time_s > last + BEYOND_S {
            return None;
        }
        let t = &self.times_s;
        let k = t.partition_point(|x| *x <= time_s).clamp(1, t.len() - 1) - 1;
        let (a, b) = (&self.world_from_lidar[k], &self.world_from_lidar[k + 1]);
        let gap_s = t[k + 1] - t[k];
        if gap_s > MOST_GAP_S {
            return None;
        }
        let share = (time_s - t[k]) / gap_s;
        let whole = self.predicted_rotation.between(t[k], t[k + 1]);
        let left = so3::local(&(a.rotation * whole), &b.rotation);
        let turned = a.rotation * self.predicted_rotation.between(t[k], time_s);
        let rotation = so3::retract(&turned, &(left * share));
        let speed = |k: usize| {
            let (from, to) = (k.saturating_sub(1), (k + 1).min(t.len() - 1));
            (self.world_from_lidar[to].translation - self.world_from_lidar[from].translation)
                / (t[to] - t[from])
        };
        let (u, v) = (share, 1.0 - share);
        let translation = a.translation * (v * v * (1.0 + 2.0 * u))
            + b.translation * (u * u * (1.0 + 2.0 * v))
            + (speed(k) * (v * v * u) - speed(k + 1) * (u * u * v)) * gap_s;
        Some(Se3::new(rotation, translation))
    }

    /// What is known of the pose at a time by the scan nearest to it.
    pub fn information(&self, time_s: f64) -> Matrix6<f64> {
        let after = self.times_s.partition_point(|x| *x <= time_s);
        let near = [after.saturating_sub(1), after.min(self.times_s.len() - 1)];
        let nearest = if time_s - self.times_s[near[0]] < self.times_s[near[1]] - time_s {
            near[0]
        } else {
            near[1]
        };
        self.information[nearest]
    }

    /// The returns of a scan as the LiDAR would have them at a time.
    pub fn returns_at(&self, scan: &Scan, time_s: f64) -> Vec<Vector3<f64>> {
        let Some(now) = self.at(time_s).map(|p| p.inverse()) else {
            return Vec::new();
        };
        let motion = Motion::sampled(scan.span_ns(), |offset_ns| {
            Some(now * self.at(scan.time_s(offset_ns))?)
        });
        let returns = scan.returns.iter();
        returns
            .filter(|r| motion.covers(i64::from(r.offset_ns)))
            .map(|r| motion.undo(i64::from(r.offset_ns), &r.in_lidar))
            .collect()
    }

    /// The first scans once more, last to first, onto planes of those after them.
    fn realign_start(&mut self, scans: &[Scan]) {
        let [first, last] = self.span_s();
        let until_s = first + AGAIN_S.min(0.5 * (last - first));
        let again = self.times_s.partition_point(|t| *t < until_s);
        let thin = |scan: &Scan, path: &Self| -> Vec<Vector3<f64>> {
            let every = scan.returns.len().div_ceil(FIRST_RETURNS).max(1);
            let all = path.returns_at(scan, scan.middle_s);
            all.into_iter().step_by(every).collect()
        };
        let mut surfaces = OverlappingPlanesBuilder::default();
        for (scan, pose) in scans.iter().zip(&self.world_from_lidar).skip(again) {
            surfaces.add(thin(scan, self).into_iter().map(|p| *pose * p));
        }
        for k in (0..again).rev() {
            // As it was to the scan after it, which may have moved.
            let still = thin(&scans[k], self);
            let pose = self.world_from_lidar[k];
            let Some((found, information)) =
                register_to_planes(&still, pose, EXPECTED, |at| surfaces.plane(at))
            else {
                return;
            };
            surfaces.add(still.iter().map(|p| found * *p));
            let moved = found * pose.inverse();
            for earlier in &mut self.world_from_lidar[..k] {
                *earlier = moved * *earlier;
            }
            self.world_from_lidar[k] = found;
            self.information[k] = information;
        }
    }

    /// Scans as they lie on planes and the gyroscope's turns between them, together.
    fn join_with_gyro(&mut self) {
        let n = self.times_s.len();
        if self.predicted_rotation.gyro.is_none() || n < 2 {
            return;
        }
        let Some(joined) = self.joined_with_gyro() else {
            return;
        };
        self.world_from_lidar = joined;
    }

    /// `None` where the equations have no solution.
    fn joined_with_gyro(&self) -> Option<Vec<Se3>> {
        let mut problem = Problem::new();
        let poses: Vec<_> = self
            .world_from_lidar
            .iter()
            .map(|pose| problem.add_block(*pose))
            .collect();
        for (k, information) in self.information.iter().enumerate() {
            let information = information * SCAN_WORTH + Matrix6::identity();
            let prior = PosePrior {
                value: self.world_from_lidar[k],
                sqrt_information: information.cholesky()?.l().transpose(),
            };
            let added = problem.add_residual(prior, &[poses[k].id()], Kernel::Squared);
            added.ok()?;
        }
        let mut sqrt_information = Matrix6::zeros();
        sqrt_information
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&(Matrix3::identity() / GYRO_RAD));
        for (k, t) in self.times_s.windows(2).enumerate() {
            if t[1] - t[0] > MOST_GAP_S {
                continue;
            }
            let turn = RelativePose {
                a_from_b: Se3::new(
                    self.predicted_rotation.between(t[0], t[1]),
                    Vector3::zeros(),
                ),
                sqrt_information,
            };
            let added =
                problem.add_residual(turn, &[poses[k].id(), poses[k + 1].id()], Kernel::Squared);
            added.ok()?;
        }
        solve(&mut problem, &SolveConfig::default()).ok()?;
        Some(poses.iter().map(|p| problem.value(*p)).collect())
    }

    fn deskewed(&self, scans: &[Scan]) -> Vec<Vec<Vector3<f64>>> {
        scans
            .par_iter()
            .map(|s| self.returns_at(s, s.middle_s))
            .collect()
    }

    fn place(&self, still: &[Vec<Vector3<f64>>]) -> OverlappingPlanes {
        let mut surfaces = OverlappingPlanesBuilder::default();
        for (scan, pose) in still.iter().zip(&self.world_from_lidar) {
            surfaces.add(scan.iter().map(|p| *pose * *p));
        }
        surfaces.finish()
    }
}
