//! LiDAR-inertial odometry: scans are deskewed with the predicted motion, registered to a local map of planes, and
//! inserted into it.
//!
//! With an IMU the prediction comes from a filter that learns velocity, biases and gravity (tightly coupled through the
//! prior of the registration). Without one, motion is taken to continue as in the last scan, and the start defines a
//! world that is not level.

mod degeneracy;
mod extrinsic_check;
mod imu_check;
mod inertial;
mod online;
mod point_clock;
mod report;
mod run;
mod uncertainty;
mod unseen;
mod warning;

#[cfg(test)]
pub(crate) mod tests;

use std::collections::VecDeque;

use lsfb_geometry::{ImuNoiseModel, Matrix6, RigLidar, Se3, StampedPose, Vector3, Vector6};
use lsfb_perception::lidar::{
    KNOT_NS, LocalMap, LocalMapConfig, MotionKnot, PosePrior, RangeWindow, Registration,
    RegistrationConfig, Weighting, deskew, register, voxel_downsample,
};
use lsfb_types::{Bounds, ImuSample, LidarScan, Stamped, Timestamp};
use serde::{Deserialize, Serialize};

pub use degeneracy::{MotionKind, Unseen};
pub use inertial::{GRAVITY_M_S2, InertialFilter, InertialState};
pub use online::OnlineOdometry;
pub use point_clock::{DeskewReport, TimedScan};
pub use report::OdometryReport;
pub(crate) use run::Damages;
pub use run::{DeskewedCloud, ImuSamples, OdometryResult, OdometryRun, ScanPose, run_odometry};
pub use unseen::UnseenStretch;
pub use warning::OdometryWarning;

use crate::Error;
use degeneracy::Seen;
use uncertainty::{ConstantMotionCovariance, Uncertainty};

/// Parameters of the odometry. The defaults suit rooms and corridors; outdoors take cells of 2 m and keypoints of 1 m.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OdometryConfig {
    /// Nearest range used, metres: nearer returns are the carrier.
    pub min_range_m: f64,
    /// Farthest range used, metres; the map is kept to 1.5 times as far.
    pub max_range_m: f64,
    /// Edge of the largest map cell, metres.
    pub cell_size_m: f64,
    /// Number of cell sizes, each half the one before.
    pub cell_levels: u32,
    /// Edge of the voxels a scan is reduced to for registration, metres.
    pub keypoint_voxel_m: f64,
    /// Edge of the voxels a scan is reduced to for insertion into the map, metres.
    pub insert_voxel_m: f64,
    /// Farthest correspondence while the motion is still unknown, metres.
    pub initial_gate_m: f64,
    /// Gauss–Newton iterations per scan at most.
    pub max_iterations: u32,
    /// How many neighbouring points share their errors and count as one measurement.
    pub points_per_independent: f64,
    /// Share of points that must agree with the map; below it the scan is reported as lost.
    pub min_inlier_ratio: f64,
    /// How many scans in a row share the faults of the surfaces that they see: the covariance counts them as one.
    pub correlated_scans: f64,
}

impl OdometryConfig {
    /// For streets and car-mounted LiDARs: far ranges, coarse cells.
    pub fn outdoor() -> Self {
        Self {
            min_range_m: 3.0,
            max_range_m: 100.0,
            cell_size_m: 2.0,
            keypoint_voxel_m: 1.0,
            insert_voxel_m: 0.25,
            ..Self::default()
        }
    }

    /// The map of the surroundings, for a LiDAR.
    pub(crate) fn local_map(&self, lidar: &RigLidar) -> LocalMapConfig {
        LocalMapConfig {
            cell_size_m: self.cell_size_m,
            levels: self.cell_levels,
            range_noise_m: lidar.range_noise_m.max(LEAST_NOISE_M),
        }
    }

    /// How scans of a LiDAR are registered to it.
    pub(crate) fn registration(&self, lidar: &RigLidar, gate_m: f64) -> RegistrationConfig {
        let noise_m = lidar.range_noise_m.max(LEAST_NOISE_M);
        RegistrationConfig {
            max_iterations: self.max_iterations,
            gate_m,
            min_kernel_m: (3.0 * noise_m).max(0.03),
            range_noise_m: noise_m,
            point_noise_m: noise_m.hypot(0.3 * self.finest_cell_m()),
            points_per_independent: self.points_per_independent,
            weighting: Weighting::Tightening,
        }
    }

    fn finest_cell_m(&self) -> f64 {
        self.cell_size_m / f64::from(1u32 << (self.cell_levels - 1))
    }
}

/// No LiDAR is better than this, whatever its rig says, metres.
const LEAST_NOISE_M: f64 = 0.005;

impl Default for OdometryConfig {
    fn default() -> Self {
        Self {
            min_range_m: 0.7,
            max_range_m: 80.0,
            cell_size_m: 1.0,
            cell_levels: 3,
            keypoint_voxel_m: 0.2,
            insert_voxel_m: 0.05,
            initial_gate_m: 2.0,
            max_iterations: 30,
            points_per_independent: 4.0,
            min_inlier_ratio: 0.2,
            correlated_scans: 10.0,
        }
    }
}

lsfb_types::bounds! {
    OdometryConfig {
        min_range_m: number(Bounds::NOT_NEGATIVE),
        max_range_m: number(Bounds::POSITIVE),
        cell_size_m: number(Bounds::POSITIVE),
        cell_levels: number(Bounds::Within(1.0, 8.0)),
        keypoint_voxel_m: number(Bounds::POSITIVE),
        insert_voxel_m: number(Bounds::POSITIVE),
        initial_gate_m: number(Bounds::POSITIVE),
        max_iterations: number(Bounds::AT_LEAST_ONE),
        points_per_independent: number(Bounds::POSITIVE),
        min_inlier_ratio: number(Bounds::Within(0.0, 1.0)),
        correlated_scans: number(Bounds::AT_LEAST_ONE),
    }
}

/// What one scan gave.
#[derive(Clone, Debug, PartialEq)]
pub struct OdometryStep {
    /// The instant the scan was deskewed to: its last firing.
    pub time: Timestamp,
    /// Pose of the rig then.
    pub world_from_rig: Se3,
    /// What the scan alone says of the pose, without what the prediction adds to it.
    pub by_scan_alone: Se3,
    /// How far [`OdometryStep::world_from_rig`] may be off, relative to the first pose: covariance of `[rotation, translation]` in its tangent.
    pub covariance: Matrix6<f64>,
    /// The motion that the scan sees least, where it does not see all.
    pub unseen: Option<Unseen>,
    /// Poses since the scan before, oldest first, ending with this scan's: at IMU rate where there is an IMU.
    pub poses: Vec<StampedPose>,
    /// The deskewed keypoints, in the rig frame at [`OdometryStep::time`].
    pub keypoints_in_rig: Vec<Vector3<f64>>,
    /// Share of the keypoints that agree with the map.
    pub inlier_ratio: f64,
    /// Root mean square distance of those to the planes of the map, metres.
    pub plane_rms_m: f64,
    /// Gauss–Newton iterations taken.
    pub iterations: u32,
    /// Whether the scan was registered, or the prediction had to do.
    pub outcome: StepOutcome,
}

/// Whether a scan found its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepOutcome {
    /// The first scan: it defines the map.
    First,
    /// Registered to the map.
    Registered,
    /// Too few points agreed with the map: the pose is the prediction, and the map was left alone.
    Lost,
}

/// How motion between scans is predicted.
#[derive(Clone, Debug)]
enum Motion {
    /// From the IMU.
    Inertial(InertialMotion),
    /// As in the scan before.
    Constant {
        /// `[rotation, translation]` per second, in the rig frame.
        twist_per_s: Vector6<f64>,
        covariance: Box<ConstantMotionCovariance>,
    },
}

#[derive(Clone, Debug)]
struct InertialMotion {
    noise: ImuNoiseModel,
    samples: Vec<Stamped<ImuSample>>,
    filter: Option<Box<InertialFilter>>,
}

/// The odometry of one walk.
#[derive(Clone, Debug)]
pub struct Odometry {
    config: OdometryConfig,
    lidar: RigLidar,
    motion: Motion,
    map: LocalMap,
    uncertainty: Uncertainty,
    /// Whether the last scan did not see all of its motion.
    unseen: bool,
    /// Pose at the end of the last scan.
    last: Option<StampedPose>,
    /// Shortest time from scan to scan so far, nanoseconds.
    interval_ns: Option<i64>,
    /// How far registrations moved from their predictions lately, metres.
    corrections_m: VecDeque<f64>,
}

/// A scan deskewed to its end, reduced twice.
struct ReducedScan {
    insert_points: Vec<Vector3<f64>>,
    keypoints: Vec<Vector3<f64>>,
}

/// How far a usual point is: what an error of rotation does to a scan, metres.
const USUAL_RANGE_M: f64 = 10.0;
/// Smallest gate: the noise of a scan needs this much room, metres.
const MIN_GATE_M: f64 = 0.3;
/// Predictions looked back at for the gate.
const CORRECTIONS: usize = 10;

impl Odometry {
    /// Odometry for a rig with this LiDAR and, if there is one, this IMU.
    pub fn new(
        config: &OdometryConfig,
        lidar: &RigLidar,
        imu: Option<&ImuNoiseModel>,
    ) -> Result<Self, Error> {
        config.check_bounds("odometry")?;
        let motion = match imu {
            Some(noise) => Motion::Inertial(InertialMotion {
                noise: noise.clone(),
                samples: Vec::new(),
                filter: None,
            }),
            None => Motion::Constant {
                twist_per_s: Vector6::zeros(),
                covariance: Box::new(ConstantMotionCovariance::start()),
            },
        };
        Ok(Self {
            map: LocalMap::new(config.local_map(lidar)),
            config: config.clone(),
            lidar: lidar.clone(),
            motion,
            uncertainty: Uncertainty::default(),
            unseen: false,
            last: None,
            interval_ns: None,
            corrections_m: VecDeque::new(),
        })
    }

    /// The inertial estimate at the end of the last scan; `None` without IMU or before the first scan.
    pub fn inertial_state(&self) -> Option<&InertialState> {
        match &self.motion {
            Motion::Inertial(inertial) => inertial.filter.as_ref().map(|f| f.state()),
            Motion::Constant { .. } => None,
        }
    }

    /// The LiDAR it was made for.
    pub fn lidar(&self) -> &RigLidar {
        &self.lidar
    }

    /// Takes one inertial sample. Samples must come in order of time, and all up to the end of a scan before the scan.
    /// Ignored by an odometry without IMU.
    pub fn push_imu(&mut self, sample: &Stamped<ImuSample>) {
        if let Motion::Inertial(inertial) = &mut self.motion
            && inertial.samples.last().is_none_or(|s| s.time < sample.time)
        {
            inertial.samples.push(sample.clone());
        }
    }

    /// Takes one scan and gives the pose at its last firing.
    pub fn push_scan(&mut self, scan: &Stamped<LidarScan>) -> Result<OdometryStep, Error> {
        let end = self.end_of(scan)?;
        let mut path = self.predict(scan.time, end)?;
        let mut reduced = self.reduce(scan, &path);
        let mut found = self.register(&reduced, &path);
        if let (Motion::Constant { .. }, true) = (&self.motion, end > scan.time) {
            // Without an IMU a first pass finds the motion by which the second deskews.
            path = constant_path(self.last, scan.time, end, &found.world_from_rig);
            reduced = self.reduce(scan, &path);
            found = self.register(&reduced, &path);
        }
        let outcome = self.judge(&found);
        let by_scan_alone = without(&self.prior(&path), &found);
        let predicted = self.predicted_covariance();
        let mut seen = Seen::default();
        if outcome == StepOutcome::Registered {
            seen = self.see(&reduced, &found);
            self.unseen = seen.unseen.is_some();
            self.correct(&mut path, &found, &seen.lasting);
        }
        let covariance = self.covariance_of(&reduced, &path, &predicted, &seen.lasting);
        if outcome == StepOutcome::Lost {
            // It may be anywhere near: look as far as at the start.
            self.corrections_m.clear();
        } else {
            self.insert(&reduced, &path, &covariance);
        }
        self.finish(&path);
        Ok(OdometryStep {
            time: end,
            world_from_rig: end_pose(&path),
            by_scan_alone,
            covariance,
            unseen: seen.unseen,
            poses: path,
            keypoints_in_rig: reduced.keypoints,
            inlier_ratio: found.inlier_ratio,
            plane_rms_m: found.plane_rms_m,
            iterations: found.iterations,
            outcome,
        })
    }

    fn end_of(&self, scan: &Stamped<LidarScan>) -> Result<Timestamp, Error> {
        let last_offset_ns = scan
            .sample
            .points
            .iter()
            .map(|p| p.time_offset_ns)
            .max()
            .ok_or(Error::EmptyScan { time: scan.time })?;
        let end = scan.time.plus_nanos(i64::from(last_offset_ns));
        match self.last {
            Some(last) if last.time >= end => Err(Error::ScanOrder {
                time: end,
                previous: last.time,
            }),
            _ => Ok(end),
        }
    }

    /// Poses from the end of the last scan (or the start of the first) to `end`.
    fn predict(&mut self, start: Timestamp, end: Timestamp) -> Result<Vec<StampedPose>, Error> {
        match &mut self.motion {
            Motion::Inertial(inertial) => inertial.predict(start, end),
            Motion::Constant {
                twist_per_s,
                covariance,
            } => {
                let predicted = self.last.map_or_else(Se3::identity, |last| {
                    let secs = end.secs_since(last.time);
                    let predicted = last.world_from_rig.retract(&(*twist_per_s * secs));
                    covariance.predict(&last.world_from_rig, &predicted, secs);
                    predicted
                });
                Ok(constant_path(self.last, start, end, &predicted))
            }
        }
    }

    fn reduce(&self, scan: &Stamped<LidarScan>, path: &[StampedPose]) -> ReducedScan {
        let end_from_world = end_pose(path).inverse();
        let knots: Vec<_> = path
            .iter()
            .map(|p| MotionKnot {
                offset_ns: p.time - scan.time,
                reference_from_rig: end_from_world * p.world_from_rig,
            })
            .collect();
        let window = RangeWindow {
            min_m: self.config.min_range_m,
            max_m: self.config.max_range_m,
        };
        let cloud = deskew(&scan.sample, &self.lidar.rig_from_lidar, &knots, window);
        let insert_points = voxel_downsample(&cloud, self.config.insert_voxel_m);
        let keypoints = voxel_downsample(&insert_points, self.config.keypoint_voxel_m);
        ReducedScan {
            insert_points,
            keypoints,
        }
    }

    fn register(&self, reduced: &ReducedScan, path: &[StampedPose]) -> Registration {
        let prior = self.prior(path);
        let config = self.registration(self.gate_m(path, &prior));
        let sensor_in_rig = self.lidar.rig_from_lidar.translation;
        register(&reduced.keypoints, &prior, &config, |pose, gate_m| {
            let points = &reduced.keypoints;
            self.map.find_all(points, &sensor_in_rig, pose, gate_m)
        })
    }

    /// What is known of the end of a predicted path.
    fn prior(&self, path: &[StampedPose]) -> PosePrior {
        match &self.motion {
            Motion::Inertial(InertialMotion {
                filter: Some(filter),
                ..
            }) => filter.pose_prior(),
            _ => PosePrior {
                world_from_rig: end_pose(path),
                // Keeps a scan without structure where it is predicted, and weighs nothing against one with.
                information: Matrix6::identity(),
            },
        }
    }

    fn registration(&self, gate_m: f64) -> RegistrationConfig {
        self.config.registration(&self.lidar, gate_m)
    }

    /// Farthest correspondence: three times what predictions were lately wrong by, or what this one says it may be. After a gap
    /// without an IMU nothing is known of either.
    fn gate_m(&self, path: &[StampedPose], prior: &PosePrior) -> f64 {
        if self.corrections_m.len() < 3 || self.is_after_gap(path) {
            return self.config.initial_gate_m;
        }
        let squares: f64 = self.corrections_m.iter().map(|c| c * c).sum();
        let lately_m = (squares / self.corrections_m.len() as f64).sqrt();
        let predicted_m = match &self.motion {
            Motion::Inertial(_) => prior.information.cholesky().map_or(0.0, |information| {
                let covariance = information.inverse();
                let turned = covariance.fixed_view::<3, 3>(0, 0).trace();
                let moved = covariance.fixed_view::<3, 3>(3, 3).trace();
                (moved + (USUAL_RANGE_M * USUAL_RANGE_M) * turned).sqrt()
            }),
            Motion::Constant { .. } => 0.0,
        };
        (3.0 * lately_m.max(predicted_m)).clamp(
            MIN_GATE_M.min(self.config.initial_gate_m),
            self.config.initial_gate_m,
        )
    }

    /// Whether scans are missing before this one, and no IMU tells what happened meanwhile.
    fn is_after_gap(&self, path: &[StampedPose]) -> bool {
        let passed_ns = self
            .last
            .zip(path.last())
            .map(|(last, end)| end.time - last.time);
        let is_blind = matches!(self.motion, Motion::Constant { .. });
        is_blind
            && passed_ns
                .zip(self.interval_ns)
                .is_some_and(|(passed, usual)| passed > 2 * usual)
    }

    fn judge(&self, found: &Registration) -> StepOutcome {
        if self.map.is_empty() {
            StepOutcome::First
        } else if found.inlier_ratio < self.config.min_inlier_ratio {
            StepOutcome::Lost
        } else {
            StepOutcome::Registered
        }
    }

    /// Takes in the registered pose and bends the path so that it ends there.
    fn correct(&mut self, path: &mut [StampedPose], found: &Registration, lasting: &Matrix6<f64>) {
        let correction = end_pose(path).local(&found.world_from_rig);
        let moved_m = correction.fixed_rows::<3>(3).norm()
            + USUAL_RANGE_M * correction.fixed_rows::<3>(0).norm();
        self.corrections_m.push_back(moved_m);
        if self.corrections_m.len() > CORRECTIONS {
            self.corrections_m.pop_front();
        }
        match &mut self.motion {
            Motion::Inertial(inertial) => {
                if let Some(filter) = &mut inertial.filter {
                    filter.correct(&found.world_from_rig, &found.information, lasting);
                }
            }
            Motion::Constant { covariance, .. } => covariance.correct(lasting),
        }
        let (Some(first), Some(last)) = (path.first().copied(), path.last().copied()) else {
            return;
        };
        let span = last.time.secs_since(first.time);
        for pose in path {
            // A wrong velocity or turn rate moves the pose in proportion to time.
            let fraction = if span > 0.0 {
                pose.time.secs_since(first.time) / span
            } else {
                1.0
            };
            pose.world_from_rig = pose.world_from_rig.retract(&(correction * fraction));
        }
    }

    fn insert(&mut self, reduced: &ReducedScan, path: &[StampedPose], covariance: &Matrix6<f64>) {
        let world_from_rig = end_pose(path);
        let sensor_in_rig = self.lidar.rig_from_lidar.translation;
        self.map
            .insert(&reduced.insert_points, &world_from_rig, &sensor_in_rig);
        self.uncertainty
            .draw(self.map.place(), &world_from_rig, covariance);
        let range_m = 1.5 * self.config.max_range_m;
        self.map.forget_beyond(&world_from_rig.translation, range_m);
    }

    fn finish(&mut self, path: &[StampedPose]) {
        let Some(end) = path.last().copied() else {
            return;
        };
        match &mut self.motion {
            Motion::Inertial(inertial) => {
                // The sample before the next span is its left neighbour.
                let used = inertial.samples.partition_point(|s| s.time <= end.time);
                inertial.samples.drain(..used.saturating_sub(1));
            }
            Motion::Constant { twist_per_s, .. } => {
                if let Some(last) = self.last {
                    let moved = last.world_from_rig.local(&end.world_from_rig);
                    *twist_per_s = moved / end.time.secs_since(last.time);
                }
            }
        }
        if let Some(last) = self.last {
            let interval_ns = end.time - last.time;
            self.interval_ns = Some(self.interval_ns.map_or(interval_ns, |i| i.min(interval_ns)));
        }
        self.last = Some(end);
    }
}

impl InertialMotion {
    fn predict(&mut self, start: Timestamp, end: Timestamp) -> Result<Vec<StampedPose>, Error> {
        let filter = match &mut self.filter {
            Some(filter) => filter,
            none => {
                let before_end = self.samples.partition_point(|s| s.time <= end);
                let begun = InertialFilter::start(&self.samples[..before_end], start, &self.noise)
                    .ok_or(Error::ImuMissing { time: end })?;
                none.insert(Box::new(begun))
            }
        };
        Ok(filter.predict(&self.samples, end))
    }
}

/// A registered pose without its prior: where the two are balanced, `H_s (x − x_s) + H_p (x − x_p) = 0`.
fn without(prior: &PosePrior, found: &Registration) -> Se3 {
    let pulled = prior.information * prior.world_from_rig.local(&found.world_from_rig);
    // Where the scan says nothing the prior stays.
    let of_scan = found.information + Matrix6::identity();
    let back = of_scan.cholesky().map(|c| c.solve(&pulled));
    back.map_or(found.world_from_rig, |back| {
        found.world_from_rig.retract(&back)
    })
}

/// Where a path ends.
fn end_pose(path: &[StampedPose]) -> Se3 {
    path.last()
        .map_or_else(Se3::identity, |end| end.world_from_rig)
}

/// A path of constant twist from the last pose through the scan's start to `end_pose` at `end`.
fn constant_path(
    last: Option<StampedPose>,
    start: Timestamp,
    end: Timestamp,
    end_pose: &Se3,
) -> Vec<StampedPose> {
    let begin = last.unwrap_or(StampedPose {
        time: start,
        world_from_rig: *end_pose,
    });
    let twist = begin.world_from_rig.local(end_pose);
    let span_ns = end - begin.time;
    let steps = (span_ns / KNOT_NS).clamp(1, 100);
    (0..=steps)
        .map(|i| StampedPose {
            time: begin.time.plus_nanos(span_ns * i / steps),
            world_from_rig: begin
                .world_from_rig
                .retract(&(twist * (i as f64 / steps as f64))),
        })
        .collect()
}
