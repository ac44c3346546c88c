//! The odometry as a batch stage: a recording in, a trajectory out.

use std::iter::Peekable;
use std::vec::IntoIter;

use lsfb_geometry::{
    ImuNoiseModel, Matrix3, Matrix6, Rig, RigLidar, Se3, StampedPose, Trajectory, UnitQuaternion,
    Vector3,
};
use lsfb_perception::statistics::median;
use lsfb_recording::Recording;
use lsfb_recording::cloud::{PointTimes, TimesBegin};
use lsfb_types::{ImuSample, LidarScan, Progress, ProgressFn, Stamped, Timestamp};

use super::extrinsic_check::rotation_off;
use super::imu_check::{ImuUnits, mend_units};
use super::point_clock::{PointClock, TimedScan};
use super::report::OdometryReport;
use super::unseen::UnseenStretches;
use super::warning::OdometryWarning;
use super::{InertialState, Odometry, OdometryConfig, StepOutcome};
use crate::Error;

/// The reduced scans and the trajectory of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct OdometryResult {
    /// Pose of the rig at the end of every scan that found its place, and between such scans at the rate of the IMU.
    pub trajectory: Trajectory,
    /// Pose and covariance at the end of every scan that found its place.
    pub scan_poses: Vec<ScanPose>,
    /// Every scan that found its place.
    pub clouds: Vec<DeskewedCloud>,
    /// The LiDAR that saw them.
    pub lidar: RigLidar,
    /// What happened.
    pub report: OdometryReport,
}

/// The pose of a scan, and how far it may be off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanPose {
    /// When, and where the rig was.
    pub pose: StampedPose,
    /// Relative to the first scan's pose: covariance of `[rotation, translation]` in the tangent of this one.
    pub covariance: Matrix6<f64>,
}

/// A scan deskewed to its last firing and downsampled.
#[derive(Clone, Debug, PartialEq)]
pub struct DeskewedCloud {
    /// Time of the last firing.
    pub time: Timestamp,
    /// Points in the rig frame at that time, metres.
    pub points_in_rig: Vec<[f32; 3]>,
}

impl OdometryResult {
    /// Says in the report what follows from poses that were changed.
    pub(crate) fn summarise(&mut self) {
        self.report.path_length_m = self.trajectory.path_length_m();
        let sigma_m = self.scan_poses.last().map_or(0.0, ScanPose::worst_sigma_m);
        self.report.set_sigma_at_end(sigma_m);
    }
}

impl ScanPose {
    /// Standard deviation of the place in its worst direction, metres.
    fn worst_sigma_m(&self) -> f64 {
        let place: Matrix3<f64> = self.covariance.fixed_view::<3, 3>(3, 3).into();
        place.symmetric_eigenvalues().max().max(0.0).sqrt()
    }
}

/// Damaged messages named in the report; the rest are counted.
const NAMED_DAMAGES: u64 = 5;

/// An IMU and what it measured.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuSamples {
    /// Its noise.
    pub noise: ImuNoiseModel,
    /// Samples in order of time.
    pub samples: Vec<Stamped<ImuSample>>,
}

/// The odometry over scans from anywhere, one after the other; [`OdometryRun::finish`] gives the result.
pub struct OdometryRun {
    odometry: Odometry,
    waiting_imu: Peekable<IntoIter<Stamped<ImuSample>>>,
    /// All samples, to hold the scans' turns against at the end.
    samples: Vec<Stamped<ImuSample>>,
    clock: PointClock,
    found: Found,
}

impl OdometryRun {
    /// For a LiDAR and, if there is one, an IMU whose frame is the rig's. Without inertial samples it works from the scans alone and
    /// warns that the world is not level.
    pub fn new(
        config: &OdometryConfig,
        lidar: &RigLidar,
        imu: Option<ImuSamples>,
    ) -> Result<Self, Error> {
        let mut found = Found::default();
        let mut imu = imu.filter(|imu| !imu.samples.is_empty());
        if let Some(samples) = imu.as_mut().map(|imu| &mut imu.samples) {
            match mend_units(samples) {
                ImuUnits::Right => {}
                ImuUnits::Gravities => found
                    .report
                    .warnings
                    .push(OdometryWarning::AccelerometerInGravities),
                ImuUnits::Wrong { problem } => {
                    let reason = problem;
                    found
                        .report
                        .warnings
                        .push(OdometryWarning::ImuNotUsed { reason });
                    imu = None;
                }
            }
        }
        found.report.imu_samples = imu.as_ref().map_or(0, |imu| imu.samples.len() as u64);
        Ok(Self {
            odometry: Odometry::new(config, lidar, imu.as_ref().map(|imu| &imu.noise))?,
            samples: imu
                .as_ref()
                .map_or_else(Vec::new, |imu| imu.samples.clone()),
            waiting_imu: imu
                .map_or_else(Vec::new, |imu| imu.samples)
                .into_iter()
                .peekable(),
            clock: PointClock::default(),
            found,
        })
    }

    /// Takes azimuths for times where points carry none: for clouds of a spinning sensor as it fired them.
    #[must_use]
    pub fn with_times_by_azimuth(mut self) -> Self {
        self.clock.azimuths_are_times = true;
        self
    }

    /// Takes the next scan. It is registered when the one behind it is there: the time between them says whether its points' times
    /// can be right.
    pub fn push(&mut self, scan: TimedScan) -> Result<(), Error> {
        match self.clock.push(scan) {
            Some(ready) => self.register(&ready),
            None => Ok(()),
        }
    }

    /// How many scans were taken.
    pub fn taken(&self) -> u64 {
        self.found.report.scans
    }

    fn register(&mut self, scan: &Stamped<LidarScan>) -> Result<(), Error> {
        // Half a second ahead: more than one revolution of the slowest LiDAR.
        let ahead = scan.time.plus_nanos(500_000_000);
        while let Some(sample) = self.waiting_imu.next_if(|s| s.time <= ahead) {
            self.odometry.push_imu(&sample);
        }
        self.found.take(self.odometry.push_scan(scan))
    }

    /// The result of all scans that were pushed. Without a single pose its trajectory is empty.
    pub fn finish(mut self) -> Result<OdometryResult, Error> {
        if let Some(last) = self.clock.finish() {
            self.register(&last)?;
        }
        self.found.report.deskew = self.clock.report;
        let by_scans = std::mem::take(&mut self.found.by_scans);
        let mut result = self
            .found
            .finish(self.odometry.inertial_state(), self.odometry.lidar());
        if let Some(off) = rotation_off(&by_scans, &self.samples) {
            result
                .report
                .warnings
                .push(OdometryWarning::ExtrinsicRotation {
                    off_deg: off.off_rad.to_degrees(),
                    sigma_deg: off.sigma_rad.to_degrees(),
                });
        }
        if result.report.imu_samples == 0 {
            let deskew = &result.report.deskew;
            let deskewed = deskew.by_times + deskew.by_azimuth > 0;
            let warning = OdometryWarning::NoImu { deskewed };
            result.report.warnings.push(warning);
        }
        Ok(result)
    }
}

/// Runs the odometry over a recording.
///
/// Without inertial samples it works from the scans alone and warns that the world is not level; without LiDAR it is an
/// error.
pub fn run_odometry(
    recording: &Recording,
    config: &OdometryConfig,
    progress: ProgressFn<'_>,
) -> Result<OdometryResult, Error> {
    let rig = recording.rig()?;
    let lidar = rig.lidar().ok_or_else(|| Error::SensorMissing {
        sensor: "LiDAR",
        rig: rig.name.clone(),
    })?;
    let mut damages = Damages::default();
    let samples = imu_samples(recording, &rig, &mut damages);
    let imu = rig.imu_noise().map(|noise| ImuSamples {
        noise: noise.clone(),
        samples,
    });
    let mut run = OdometryRun::new(config, lidar, imu)?;
    let total = scan_count(recording);
    for scan in recording.scans()? {
        let Some(scan) = damages.keep(scan) else {
            continue;
        };
        progress(Progress {
            stage: "lidar odometry",
            done: run.taken(),
            total,
        })?;
        let timed = scan.sample.points.iter().any(|p| p.time_offset_ns > 0);
        let times = match timed {
            true => PointTimes::Field {
                name: "t".to_owned(),
                begins: TimesBegin::AfterStamp { nanos: 0 },
            },
            false => PointTimes::Absent,
        };
        run.push(TimedScan { scan, times })?;
    }
    let mut result = run.finish()?;
    let damaged = damages.into_sentences().into_iter();
    result
        .report
        .warnings
        .extend(damaged.map(|what| OdometryWarning::Damaged { what }));
    if result.trajectory.is_empty() {
        return Err(Error::NoScan {
            path: recording.path().to_owned(),
            scans: result.report.scans,
        });
    }
    Ok(result)
}

/// Inertial samples in order of time; none where the rig or the recording has no IMU.
fn imu_samples(recording: &Recording, rig: &Rig, damages: &mut Damages) -> Vec<Stamped<ImuSample>> {
    if rig.imu().is_none() {
        return Vec::new();
    }
    let Ok(stream) = recording.imu() else {
        return Vec::new();
    };
    let mut samples: Vec<_> = stream.filter_map(|s| damages.keep(s)).collect();
    samples.sort_by_key(|s| s.time);
    samples
}

fn scan_count(recording: &Recording) -> u64 {
    let points = format!("/{}/points", recording.main_lidar());
    recording
        .topics()
        .iter()
        .filter(|t| t.topic == points)
        .map(|t| t.messages)
        .sum()
}

/// Parts of a recording that could not be read: reported, not fatal.
#[derive(Default)]
pub(crate) struct Damages {
    count: u64,
    first: Vec<String>,
}

impl Damages {
    /// The item, or `None` after noting why there is none.
    pub(crate) fn keep<T>(&mut self, item: Result<T, lsfb_recording::Error>) -> Option<T> {
        item.map_err(|error| {
            self.count += 1;
            if self.count <= NAMED_DAMAGES {
                self.first.push(error.to_string());
            }
        })
        .ok()
    }

    /// What was noted: the first few by name, and how many more.
    pub(crate) fn into_sentences(self) -> Vec<String> {
        let mut sentences = self.first;
        if self.count > NAMED_DAMAGES {
            let more = self.count - NAMED_DAMAGES;
            sentences.push(format!("{more} more messages could not be read"));
        }
        sentences
    }
}

/// What has come together so far.
#[derive(Default)]
struct Found {
    poses: Vec<StampedPose>,
    scan_poses: Vec<ScanPose>,
    /// What the registered scans alone say of these.
    by_scans: Vec<StampedPose>,
    unseen: UnseenStretches,
    clouds: Vec<DeskewedCloud>,
    report: OdometryReport,
    inlier_ratios: f64,
    plane_squares: f64,
    measured: u64,
}

impl Found {
    fn take(&mut self, step: Result<super::OdometryStep, Error>) -> Result<(), Error> {
        self.report.scans += 1;
        let step = match step {
            Ok(step) => step,
            Err(Error::EmptyScan { .. } | Error::ScanOrder { .. } | Error::ImuMissing { .. }) => {
                self.report.skipped += 1;
                return Ok(());
            }
            Err(other) => return Err(other),
        };
        if step.outcome == StepOutcome::Lost {
            self.report.lost += 1;
            self.report.lost_at_end += 1;
            return Ok(());
        }
        self.report.registered += 1;
        self.unseen.take(&step);
        self.scan_poses.push(ScanPose {
            pose: StampedPose {
                time: step.time,
                world_from_rig: step.world_from_rig,
            },
            covariance: step.covariance,
        });
        if step.outcome == StepOutcome::Registered {
            self.by_scans.push(StampedPose {
                time: step.time,
                world_from_rig: step.by_scan_alone,
            });
            self.measured += 1;
            self.inlier_ratios += step.inlier_ratio;
            self.plane_squares += step.plane_rms_m * step.plane_rms_m;
        }
        let points = step.keypoints_in_rig.iter();
        self.clouds.push(DeskewedCloud {
            time: step.time,
            points_in_rig: points
                .map(|p| [p.x as f32, p.y as f32, p.z as f32])
                .collect(),
        });
        // After a gap only the pose of the scan itself is more than a prediction.
        let gap = std::mem::take(&mut self.report.lost_at_end) > 0;
        let known = if gap {
            step.poses.len().saturating_sub(1)
        } else {
            0
        };
        self.poses.extend(step.poses.into_iter().skip(known));
        Ok(())
    }

    fn finish(self, state: Option<&InertialState>, lidar: &RigLidar) -> OdometryResult {
        let mut report = self.report;
        let mut poses = self.poses;
        let mut scan_poses = self.scan_poses;
        let mut level = UnitQuaternion::identity();
        if let Some(state) = state {
            // Gravity is known best at the end of the walk; the whole walk is turned level with it.
            let down = -Vector3::z();
            level = UnitQuaternion::rotation_between(&state.gravity_m_s2, &down)
                .unwrap_or_else(UnitQuaternion::identity);
            let of_scans = scan_poses.iter_mut().map(|scan| &mut scan.pose);
            for pose in poses.iter_mut().chain(of_scans) {
                pose.world_from_rig = Se3::new(level, Vector3::zeros()) * pose.world_from_rig;
            }
            report.gyro_bias_rad_s = Some(state.gyro_bias_rad_s.into());
            report.accel_bias_m_s2 = Some(state.accel_bias_m_s2.into());
        }
        let trajectory = Trajectory::new(poses);
        let measured = self.measured.max(1) as f64;
        report.path_length_m = trajectory.path_length_m();
        report.mean_inlier_ratio = self.inlier_ratios / measured;
        report.plane_rms_m = (self.plane_squares / measured).sqrt();
        report.unseen = self.unseen.finish(&level);
        report.sigma_at_end_m = scan_poses.last().map_or(0.0, ScanPose::worst_sigma_m);
        report.scan_interval_s = usual_interval_s(&scan_poses);
        report.add_warnings();
        OdometryResult {
            trajectory,
            scan_poses,
            clouds: self.clouds,
            lidar: lidar.clone(),
            report,
        }
    }
}

/// The median time from one pose to the next, seconds; 0 for less than two.
fn usual_interval_s(scan_poses: &[ScanPose]) -> f64 {
    let pairs = scan_poses.windows(2);
    let intervals_s = pairs.map(|pair| pair[1].pose.time.secs_since(pair[0].pose.time));
    median(intervals_s.collect()).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::super::OdometryStep;
    use super::*;

    fn lidar() -> RigLidar {
        RigLidar {
            rig_from_lidar: Se3::identity(),
            range_noise_m: 0.02,
        }
    }

    /// A step that ends at so many tenths of a second, with a pose in the middle, as an IMU gives it.
    fn step(tenths: i64, outcome: StepOutcome) -> Result<OdometryStep, Error> {
        let pose = |nanos: i64| StampedPose {
            time: Timestamp::from_nanos(nanos),
            world_from_rig: Se3::new(
                UnitQuaternion::identity(),
                Vector3::x() * nanos as f64 * 1e-9,
            ),
        };
        let end = pose(tenths * 100_000_000);
        Ok(OdometryStep {
            time: end.time,
            world_from_rig: end.world_from_rig,
            by_scan_alone: end.world_from_rig,
            covariance: Matrix6::identity() * 1e-4,
            unseen: None,
            poses: vec![pose(tenths * 100_000_000 - 50_000_000), end],
            keypoints_in_rig: Vec::new(),
            inlier_ratio: 0.9,
            plane_rms_m: 0.01,
            iterations: 4,
            outcome,
        })
    }

    #[test]
    fn lost_scans_are_no_poses() {
        use StepOutcome::{First, Lost, Registered};
        let mut run = Found::default();
        let outcomes = [First, Registered, Lost, Lost, Registered, Registered, Lost];
        for (tenths, outcome) in (1..).zip(outcomes) {
            run.take(step(tenths, outcome)).expect("taken");
        }
        let result = run.finish(None, &lidar());
        let millis: Vec<i64> = result
            .trajectory
            .poses()
            .iter()
            .map(|p| p.time.nanos() / 1_000_000)
            .collect();
        assert_eq!(millis, [50, 100, 150, 200, 500, 550, 600]);
        let report = &result.report;
        assert_eq!((report.registered, report.lost), (4, 3));
        assert_eq!(report.lost_at_end, 1);
        assert!(!report.is_whole());
        assert_eq!(result.clouds.len(), 4);
        let warnings = [
            OdometryWarning::Lost { lost: 3, scans: 7 },
            OdometryWarning::LostAtEnd { scans: 1 },
        ];
        assert_eq!(report.warnings, warnings);
        let sentence = warnings[1].finding().sentence();
        assert!(sentence.contains("the last 1 scans are lost"), "{sentence}");
    }

    #[test]
    fn scans_that_are_seconds_apart_are_said_to_be() {
        use StepOutcome::{First, Registered};
        for (tenths, said) in [([10, 11, 12, 60], false), ([10, 60, 110, 111], true)] {
            let mut run = Found::default();
            for (tenths, outcome) in tenths
                .into_iter()
                .zip([First, Registered, Registered, Registered])
            {
                run.take(step(tenths, outcome)).expect("taken");
            }
            let report = run.finish(None, &lidar()).report;
            let is_it = |w: &OdometryWarning| matches!(w, OdometryWarning::RareScans { .. });
            assert_eq!(report.warnings.iter().any(is_it), said, "{report:?}");
            assert!(report.is_whole());
        }
    }
}
