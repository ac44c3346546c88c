//! LiDAR-inertial odometry: scans are deskewed with the predicted motion, registered to a local map of planes, and
//! inserted into it.
//!
//! With an IMU the prediction comes from a filter that learns velocity, biases and gravity (tightly coupled through the
//! prior of the registration). Without one, motion is taken to continue as in the last scan, and the start defines a
//! world that is not level.

mod agreement;
mod config;
mod degeneracy;
mod first_second;
mod free_space;
mod imu_check;
mod imu_pauses;
mod inertial;
mod learned_start;
mod motion;
mod online;
mod point_clock;
mod range_check;
mod report;
mod ring_order;
mod run;
mod start_scan;
mod uncertainty;
mod unseen;
mod warning;
mod wide_search;

#[cfg(test)]
pub(crate) mod tests;

use std::collections::VecDeque;

use lsfb_geometry::{ImuNoiseModel, Matrix6, RigLidar, Se3, StampedPose, Vector3, Vector6};
use lsfb_perception::lidar::{
    LocalMap, MotionKnot, PosePrior, Registration, RegistrationConfig, ScanFinder, deskew,
    register, voxel_downsample,
};
use lsfb_types::{ImuSample, LidarScan, Stamped, Timestamp};

pub use config::OdometryConfig;
pub use degeneracy::{MotionKind, Unseen};
pub(crate) use imu_check::{ImuUnits, mend_units};
pub(crate) use imu_pauses::imu_pauses;
pub use inertial::{InertialFilter, InertialState};
pub use online::OnlineOdometry;
pub use point_clock::{DeskewReport, TimedScan};
pub use report::OdometryReport;
pub use ring_order::AzimuthProblem;
pub(crate) use run::Damages;
pub use run::{
    DeskewedCloud, ImuSamples, OdometryResult, OdometryRun, ScanPose, run_odometry, scan_count,
};
pub use unseen::UnseenStretch;
pub use warning::OdometryWarning;

use crate::{Error, Refusal};
use degeneracy::ScanInformation;
use first_second::FirstSecond;
use free_space::FreeSpace;
use learned_start::LearnedStart;
use motion::{InertialMotion, Motion, constant_path, end_pose};
use start_scan::StartScan;
use uncertainty::{ConstantMotionCovariance, Uncertainty};
use wide_search::Innovations;

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
    /// Where this scan told that the walk began otherwise than was thought: the steps of all scans before it anew, in place of those given
    /// then. Empty but in the first seconds of a walk.
    pub anew: Vec<OdometryStep>,
}

impl OdometryStep {
    /// Whether the steps given before are void: the walk begins with this scan, or with those that come anew.
    pub fn begins_again(&self) -> bool {
        self.outcome == StepOutcome::First || !self.anew.is_empty()
    }

    fn instead_of(self, anew: Vec<OdometryStep>) -> Self {
        Self { anew, ..self }
    }

    /// The scans that found their place, those that come anew before the scan itself.
    pub fn placed(&self) -> impl Iterator<Item = &OdometryStep> {
        let all = self.anew.iter().chain([self]);
        all.filter(|step| step.outcome != StepOutcome::Lost)
    }
}

/// Whether a scan found its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepOutcome {
    /// The first scan: it defines the map. Scans before it found no place in what the walk began with until then, and have none.
    First,
    /// Registered to the map.
    Registered,
    /// Too few points, or too few that agreed with the map: the pose is the prediction, and the map was left alone.
    Lost,
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
    /// The same of the last that found its place.
    last_registered: Option<StampedPose>,
    /// Shortest time from scan to scan so far, nanoseconds.
    interval_ns: Option<i64>,
    /// How far registrations moved from their predictions lately, metres.
    corrections_m: VecDeque<f64>,
    innovations: Innovations,
    free_space: FreeSpace,
    /// Where the map was last rid of what is far.
    rid_at: Option<Vector3<f64>>,
    /// When a scan was last searched for since one found its place.
    searched_in_vain: Option<Timestamp>,
    /// What the walk may have to begin again from, until a scan has found its place.
    start_scan: Option<StartScan>,
    /// The same, in its first second.
    first_second: Option<FirstSecond>,
    /// The same, until its motion has told the gyroscope's bias.
    learned_start: Option<LearnedStart>,
    /// Until then scans count little: the map is drawn by too few.
    unsteady_until: Option<Timestamp>,
    /// So many times more points of the scan at hand share an error.
    shared_by: f64,
    /// Whether it set off without its IMU feeling it, and whether that was in the first second.
    unfelt: bool,
    began_unfelt: bool,
}

/// A scan deskewed to its end, reduced twice.
struct ReducedScan {
    insert_points: Vec<Vector3<f64>>,
    keypoints: Vec<Vector3<f64>>,
    /// Whether its points carry times.
    is_timed: bool,
}

/// What a scan makes of the motion: the pose of scan and prediction together, and what the scan tells of it.
struct Estimate {
    world_from_rig: Se3,
    information: Matrix6<f64>,
}

/// How far a usual point is: what an error of rotation does to a scan, metres.
const USUAL_RANGE_M: f64 = 10.0;
/// Smallest gate: the noise of a scan needs this much room, metres.
const MIN_GATE_M: f64 = 0.3;
/// Rounding of poses: radians, metres.
const LEAST_BEHIND: f64 = 1e-9;
/// Fewer points draw no map and find no place.
const LEAST_KEYPOINTS: usize = 10;
/// What is far is forgotten each time the carrier is so much farther on, as a share of how far that is.
const RID_EVERY: f64 = 0.05;
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
                start: None,
                gyro_bias: None,
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
            last_registered: None,
            interval_ns: None,
            corrections_m: VecDeque::new(),
            innovations: Innovations::default(),
            free_space: FreeSpace::default(),
            rid_at: None,
            searched_in_vain: None,
            start_scan: None,
            first_second: None,
            learned_start: None,
            unsteady_until: None,
            shared_by: 1.0,
            unfelt: false,
            began_unfelt: false,
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
        if let Some(first) = &mut self.first_second {
            first.push_imu(sample);
        }
        if let Some(learned) = &mut self.learned_start {
            learned.push_imu(sample);
        }
        if let Some(start) = &mut self.start_scan {
            start.push_imu(sample);
        }
    }

    /// Takes one scan and gives the pose at its last firing.
    pub fn push_scan(&mut self, scan: &Stamped<LidarScan>) -> Result<OdometryStep, Error> {
        // Taken out first: where the walk begins again, the odometry is another one.
        let learned = match self.last {
            None => LearnedStart::before(self),
            Some(_) => self.learned_start.take(),
        };
        match (self.take_as_it_comes(scan), learned) {
            (Ok(step), Some(learned)) => Ok(learned.go_on(self, scan, step)),
            (step, learned) => {
                self.learned_start = learned;
                step
            }
        }
    }

    /// The same, with no look back at the start but in its first second.
    fn take_as_it_comes(&mut self, scan: &Stamped<LidarScan>) -> Result<OdometryStep, Error> {
        if self.last.is_none() {
            return StartScan::begin(self, scan);
        }
        let step = match self.first_second.take() {
            Some(first) => first.go_on(self, scan),
            None => self.take_scan(scan),
        }?;
        Ok(match self.start_scan.take() {
            Some(start) => start.go_on(self, scan, step),
            None => step,
        })
    }

    /// Whether the carrier moved at the start, and its IMU did not feel it: it rolled evenly.
    pub fn began_unfelt(&self) -> bool {
        self.began_unfelt
    }

    fn take_scan(&mut self, scan: &Stamped<LidarScan>) -> Result<OdometryStep, Error> {
        let end = self.end_of(scan)?;
        let mut path = self.predict(scan.time, end)?;
        let mut reduced = self.reduce(scan, &path);
        self.steady(&reduced, &path);
        let find = self.search(&reduced, &path);
        let mut found = match &find {
            Some(find) => find.registration,
            None => self.register(&reduced, &path),
        };
        if let (Motion::Constant { .. }, true, Some(_)) = (&self.motion, end > scan.time, self.last)
        {
            // Without an IMU a first pass finds the motion by which the second deskews.
            path = constant_path(self.last, scan.time, end, &found.world_from_rig);
            reduced = self.reduce(scan, &path);
            found = self.register(&reduced, &path);
        }
        let outcome = self.judge(&reduced, &found);
        let by_scan_alone = match &find {
            Some(find) => find.registration.world_from_rig,
            None => without(&self.prior(&path), &found),
        };
        let predicted = self.predicted_covariance();
        let mut seen = ScanInformation::default();
        if outcome == StepOutcome::Registered {
            seen = self.see(&reduced, &found);
            self.unseen = seen.unseen.is_some();
            let mut estimate = Estimate {
                world_from_rig: found.world_from_rig,
                information: found.information,
            };
            let mut pose = found.world_from_rig;
            if let (None, Some(seen_alone)) = (&find, &seen.seen_alone) {
                estimate = seen_alone.estimate(&self.prior(&path), &pose);
                pose = estimate.world_from_rig;
            }
            if let Some(find) = &find {
                self.innovations.take(find.squared_sigmas);
                seen.lasting = find.weakened(&seen.lasting);
                estimate = Estimate {
                    world_from_rig: find.with_prediction,
                    information: find.weakened(&found.information),
                };
            }
            self.correct(&mut path, &pose, &estimate, &seen.lasting);
        }
        let covariance = self.covariance_of(&reduced, &path, &predicted, &seen.lasting);
        if outcome == StepOutcome::Lost {
            // It may be anywhere near: look as far as at the start.
            self.corrections_m.clear();
        } else {
            self.insert(&reduced, &path, &covariance);
            self.last_registered = path.last().copied();
            self.searched_in_vain = None;
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
            anew: Vec::new(),
        })
    }

    fn end_of(&self, scan: &Stamped<LidarScan>) -> Result<Timestamp, Error> {
        let last_offset_ns = scan
            .sample
            .points
            .iter()
            .map(|p| p.time_offset_ns)
            .max()
            .ok_or(Refusal::EmptyScan { time: scan.time })?;
        let end = scan.time.plus_nanos(i64::from(last_offset_ns));
        match self.last {
            Some(last) if last.time >= end => Err(Refusal::ScanOrder {
                time: end,
                previous: last.time,
            }
            .into()),
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
                let Some(last) = self.last else {
                    // The end of the first scan is the world's origin.
                    let back = -*twist_per_s * end.secs_since(start);
                    let begin = StampedPose {
                        time: start,
                        world_from_rig: Se3::identity().retract(&back),
                    };
                    return Ok(constant_path(Some(begin), start, end, &Se3::identity()));
                };
                let secs = end.secs_since(last.time);
                let predicted = last.world_from_rig.retract(&(*twist_per_s * secs));
                covariance.predict(&last.world_from_rig, &predicted, secs);
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
        let ranges = self.config.ranges();
        let cloud = deskew(&scan.sample, &self.lidar.rig_from_lidar, &knots, ranges);
        let insert_points = voxel_downsample(&cloud, self.config.insert_voxel_m);
        let keypoints = voxel_downsample(&insert_points, self.config.keypoint_voxel_m);
        ReducedScan {
            insert_points,
            keypoints,
            is_timed: scan.sample.points.iter().any(|p| p.time_offset_ns > 0),
        }
    }

    fn register(&self, reduced: &ReducedScan, path: &[StampedPose]) -> Registration {
        let prior = self.prior(path);
        let config = self.registration(self.gate_m(path, &prior));
        let sensor_in_rig = self.lidar.rig_from_lidar.translation;
        let mut finder = ScanFinder::new(&self.map, &reduced.keypoints, &sensor_in_rig);
        register(&reduced.keypoints, &prior, &config, |pose, gate_m| {
            finder.find_all(pose, gate_m)
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
        let mut config = self.config.registration(&self.lidar, gate_m);
        config.points_per_independent *= self.shared_by;
        config
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

    fn judge(&self, reduced: &ReducedScan, found: &Registration) -> StepOutcome {
        if reduced.keypoints.len() < LEAST_KEYPOINTS {
            StepOutcome::Lost
        } else if self.map.is_empty() {
            StepOutcome::First
        } else if found.inlier_ratio < self.config.min_inlier_ratio {
            StepOutcome::Lost
        } else {
            StepOutcome::Registered
        }
    }

    /// Takes in the registered pose and bends the path so that it ends there.
    fn correct(
        &mut self,
        path: &mut [StampedPose],
        found: &Se3,
        estimate: &Estimate,
        lasting: &Matrix6<f64>,
    ) {
        let correction = end_pose(path).local(found);
        let moved_m = correction.fixed_rows::<3>(3).norm()
            + USUAL_RANGE_M * correction.fixed_rows::<3>(0).norm();
        self.corrections_m.push_back(moved_m);
        if self.corrections_m.len() > CORRECTIONS {
            self.corrections_m.pop_front();
        }
        match &mut self.motion {
            Motion::Inertial(inertial) => {
                if let Some(filter) = &mut inertial.filter {
                    filter.correct(&estimate.world_from_rig, &estimate.information, lasting);
                }
            }
            Motion::Constant { covariance, .. } => covariance.correct(lasting),
        }
        let (Some(first), Some(last)) = (path.first().copied(), path.last().copied()) else {
            return;
        };
        // After a search the filter goes on from its own pose, which is not quite the scan's.
        let behind = match self.last {
            Some(before) => first.world_from_rig.local(&before.world_from_rig),
            None => Vector6::zeros(),
        };
        let behind = if behind.norm() > LEAST_BEHIND {
            behind
        } else {
            Vector6::zeros()
        };
        let span = last.time.secs_since(first.time);
        for pose in path {
            // A wrong velocity or turn rate moves the pose in proportion to time.
            let fraction = if span > 0.0 {
                pose.time.secs_since(first.time) / span
            } else {
                1.0
            };
            let bend = correction * fraction + behind * (1.0 - fraction);
            pose.world_from_rig = pose.world_from_rig.retract(&bend);
        }
    }

    fn insert(&mut self, reduced: &ReducedScan, path: &[StampedPose], covariance: &Matrix6<f64>) {
        let world_from_rig = end_pose(path);
        let sensor_in_rig = self.lidar.rig_from_lidar.translation;
        self.map
            .insert(&reduced.insert_points, &world_from_rig, &sensor_in_rig);
        self.free_space
            .insert(&reduced.insert_points, &sensor_in_rig, &world_from_rig);
        self.uncertainty
            .draw(self.map.place(), &world_from_rig, covariance);
        // All of the map is looked through: not at each scan.
        let here = world_from_rig.translation;
        let range_m = 1.5 * self.config.max_range_m;
        let at = *self.rid_at.get_or_insert(here);
        if (here - at).norm() > RID_EVERY * range_m {
            self.map.forget_beyond(&here, range_m);
            self.rid_at = Some(here);
        }
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
