//! The odometry as a batch stage: a recording in, a trajectory out.

mod damages;
mod found;
mod untold;

use std::iter::Peekable;
use std::path::Path;
use std::vec::IntoIter;

use lsfb_geometry::{ImuNoiseModel, MAIN_LIDAR, Matrix6, Rig, RigLidar, StampedPose, Trajectory};
use lsfb_perception::statistics::median;
use lsfb_recording::cloud::{PointTimes, TimesBegin};
use lsfb_recording::{Recording, Writer, WriterConfig};
use lsfb_types::{ImuSample, LidarScan, Progress, ProgressFn, Stamped, Timestamp};

use super::agreement::{Scans, contradictions, is_told_along, lay};
use super::imu_check::{ImuUnits, mend_units};
use super::imu_pauses::imu_pauses;
use super::point_clock::{PointClock, TimedScan};
use super::range_check::RangeCheck;
use super::report::OdometryReport;
use super::warning::OdometryWarning;
use super::{Odometry, OdometryConfig, OdometryStep};
use crate::read_ahead::read_ahead;
use crate::worst_sigma::worst_sigmas;
use crate::{Error, Refusal};
pub(crate) use damages::Damages;
use found::Found;

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
    /// Fails where no scan has a pose; `path` is what they were read from.
    pub fn expect_poses(&self, path: &Path) -> Result<(), Error> {
        if !self.trajectory.is_empty() {
            return Ok(());
        }
        let why = self.report.warnings.iter().find_map(|w| match w {
            OdometryWarning::OutOfRange { what } => Some(what.clone()),
            _ => None,
        });
        Err(Refusal::NoScan {
            path: path.to_owned(),
            scans: self.report.scans,
            why,
        }
        .into())
    }

    /// The trajectory without what the IMU alone has of gaps between scans: it may be decimetres off, and nothing tells. Whoever has images of them may go on from it.
    pub fn trajectory_outside_gaps(&self) -> Trajectory {
        let gaps = &self.report.gaps;
        let Some(start) = self.scan_poses.first().map(|scan| scan.pose.time) else {
            return self.trajectory.clone();
        };
        let is_told = |pose: &&StampedPose| {
            let at_s = pose.time.secs_since(start);
            !gaps
                .iter()
                .any(|[from_s, to_s]| *from_s < at_s && at_s < *to_s)
        };
        Trajectory::new(
            self.trajectory
                .poses()
                .iter()
                .filter(is_told)
                .copied()
                .collect(),
        )
    }

    /// Says in the report what follows from poses that were changed.
    pub(crate) fn summarise(&mut self) {
        self.report.path_length_m = self.trajectory.path_length_m();
        let start = self.scan_poses.first().map(|scan| scan.pose.time);
        let sigmas = self.scan_poses.iter().map(|scan| {
            let at_s = start.map_or(0.0, |start| scan.pose.time.secs_since(start));
            [at_s, scan.worst_sigma_m()]
        });
        let at_end_m = sigmas
            .clone()
            .next_back()
            .map_or(0.0, |[_, sigma_m]| sigma_m);
        let largest = sigmas.max_by(|a, b| a[1].total_cmp(&b[1]));
        self.report
            .set_sigmas(at_end_m, largest.unwrap_or_default());
    }
}

impl ScanPose {
    /// Of a scan that found its place.
    pub(crate) fn of(step: &OdometryStep) -> Self {
        Self {
            pose: StampedPose {
                time: step.time,
                world_from_rig: step.world_from_rig,
            },
            covariance: step.covariance,
        }
    }

    /// Standard deviation of the place in its worst direction, metres.
    fn worst_sigma_m(&self) -> f64 {
        let [_, place_m] = worst_sigmas(&self.covariance);
        place_m
    }
}

impl DeskewedCloud {
    /// Of a scan that found its place.
    pub(crate) fn of(step: &OdometryStep) -> Self {
        let points = step.keypoints_in_rig.iter();
        Self {
            time: step.time,
            points_in_rig: points
                .map(|p| [p.x as f32, p.y as f32, p.z as f32])
                .collect(),
        }
    }
}

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
    config: OdometryConfig,
    ranges: RangeCheck,
    /// How long each scan took, seconds.
    durations_s: Vec<f64>,
    /// Places of the points of the scan before.
    last_positions_m: Vec<[f32; 3]>,
    found: Found,
    /// Where scans are kept, if they are, and the name of their LiDAR there.
    kept: Option<(Writer, String)>,
}

/// What lasts less than this share of what scans usually last is a piece of one.
const PIECE: f64 = 0.5;

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
            config: config.clone(),
            ranges: RangeCheck::default(),
            durations_s: Vec::new(),
            last_positions_m: Vec::new(),
            found,
            kept: None,
        })
    }

    /// Keeps each scan in a recording with this rig, its points timed as the odometry takes them: clouds can be stored from there afterwards, whatever the scans
    /// came from.
    pub fn keeping_scans(mut self, path: &Path, rig: &Rig) -> Result<Self, Error> {
        let lidar = rig.main_lidar_name().unwrap_or(MAIN_LIDAR);
        let mut writer = Writer::create(path, &WriterConfig::default())?;
        writer.attach_rig(rig)?;
        self.kept = Some((writer, lidar.to_owned()));
        Ok(self)
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
        if let Some((writer, lidar)) = &mut self.kept {
            writer.write_scan(lidar, scan)?;
        }
        self.ranges.take(&scan.sample, &self.config);
        self.durations_s.push(duration_s(&scan.sample));
        let positions_m: Vec<[f32; 3]> = scan.sample.points.iter().map(|p| p.position_m).collect();
        let is_repeated = !positions_m.is_empty() && positions_m == self.last_positions_m;
        self.found.report.repeated += u64::from(is_repeated);
        self.last_positions_m = positions_m;
        // Half a second ahead: more than one revolution of the slowest LiDAR.
        let ahead = scan.time.plus_nanos(500_000_000);
        while let Some(sample) = self.waiting_imu.next_if(|s| s.time <= ahead) {
            self.odometry.push_imu(&sample);
        }
        self.found.take(self.odometry.push_scan(scan))
    }

    /// A capture ends wherever the rotor stands: what is left of a turn then, and finds no place, is no scan that was lost.
    fn register_last(&mut self, last: &Stamped<LidarScan>) -> Result<(), Error> {
        let usual_s = median(self.durations_s.clone()).unwrap_or(0.0);
        let took_s = duration_s(&last.sample);
        let (lost, ranges) = (self.found.report.lost, self.ranges.clone());
        self.register(last)?;
        let is_lost = self.found.report.lost > lost && self.found.report.lost_at_end > 0;
        if is_lost && took_s < PIECE * usual_s {
            self.ranges = ranges;
            self.found.leave_out_piece(took_s / usual_s);
            let deskew = &mut self.clock.report;
            match deskew.by_azimuth {
                0 => deskew.by_times = deskew.by_times.saturating_sub(1),
                _ => deskew.by_azimuth -= 1,
            }
        }
        Ok(())
    }

    /// The result of all scans that were pushed. Without a single pose its trajectory is empty.
    pub fn finish(mut self) -> Result<OdometryResult, Error> {
        if let Some(last) = self.clock.finish() {
            self.register_last(&last)?;
        }
        if let Some((writer, _)) = self.kept.take() {
            writer.finish()?;
        }
        self.found.report.deskew = self.clock.report;
        let state = self.odometry.inertial_state();
        self.found.level_by_scans(state);
        let by_scans = std::mem::take(&mut self.found.by_scans);
        let unseen = std::mem::take(&mut self.found.unseen_shifts);
        let mut result = self.found.finish(state, self.odometry.lidar());
        let deskew = &result.report.deskew;
        let is_deskewed = deskew.by_times + deskew.by_azimuth > deskew.none;
        // The first scan defines the map, and says nothing of its place.
        let said_by_itself = |time| by_scans.binary_search_by_key(&time, |p| p.time).is_ok();
        let walk = result.scan_poses.iter().map(|scan| scan.pose);
        let walk: Vec<_> = walk.filter(|pose| said_by_itself(pose.time)).collect();
        let said = contradictions(&by_scans, &walk, &unseen, &self.samples, is_deskewed);
        result.report.warnings.extend(said);
        if result.report.imu_samples > 0 {
            untold::widen(&mut result, |along| {
                is_told_along(&by_scans, &unseen, &self.samples, along)
            });
            lay_scans(&mut result, &self.config);
            let walk: Vec<_> = result.scan_poses.iter().map(|scan| scan.pose).collect();
            result
                .report
                .set_imu_pauses(imu_pauses(&self.samples, &walk));
        }
        let little = result.report.little_agreement();
        result.report.warnings.extend(little);
        if self.odometry.began_unfelt() {
            result.report.warnings.push(OdometryWarning::BeganUnfelt);
        }
        if let Some(ranges) = self.ranges.finish() {
            let what = ranges.sentence(&self.config);
            result
                .report
                .warnings
                .push(OdometryWarning::OutOfRange { what });
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

/// Says where scans lie elsewhere on each other than the trajectory has them, and where nothing tells.
fn lay_scans(result: &mut OdometryResult, config: &OdometryConfig) {
    let poses: Vec<_> = result.scan_poses.iter().map(|scan| scan.pose).collect();
    let clouds = result.clouds.iter();
    let clouds: Vec<_> = clouds.map(|cloud| cloud.points_in_rig.as_slice()).collect();
    let scans = Scans {
        poses: &poses,
        clouds: &clouds,
        lidar: &result.lidar,
    };
    let laid = lay(&scans, config);
    let is_rare = result.report.has_rare_scans();
    let warnings = &mut result.report.warnings;
    warnings.extend(laid.off.map(|off| OdometryWarning::ScansApart {
        off_m: off.off_m,
        from_s: off.from_s,
        to_s: off.to_s,
    }));
    // Where scans are rare that is said, and that covariances are not to be relied on.
    let unchecked = laid.unchecked.into_iter().filter(|_| !is_rare);
    warnings
        .extend(unchecked.map(|[from_s, to_s]| OdometryWarning::ScansUnchecked { from_s, to_s }));
}

/// From a scan's first point to its last, seconds; 0 where points carry no times.
fn duration_s(scan: &LidarScan) -> f64 {
    let offsets_ns = scan.points.iter().map(|p| p.time_offset_ns);
    f64::from(offsets_ns.max().unwrap_or(0)) * 1e-9
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
    read_ahead(
        || recording.scans(),
        |scan| {
            let Some(scan) = damages.keep(scan) else {
                return Ok(());
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
            run.push(TimedScan { scan, times })
        },
    )?;
    let mut result = run.finish()?;
    let damaged = damages.into_sentences().into_iter();
    result
        .report
        .warnings
        .extend(damaged.map(|what| OdometryWarning::Damaged { what }));
    result.expect_poses(recording.path())?;
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

/// How many scans of the main LiDAR a recording has.
pub fn scan_count(recording: &Recording) -> u64 {
    let points = format!("/{}/points", recording.main_lidar());
    recording
        .topics()
        .iter()
        .filter(|t| t.topic == points)
        .map(|t| t.messages)
        .sum()
}
