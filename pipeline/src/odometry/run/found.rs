//! The steps of a walk, put together.

use lsfb_geometry::{RigLidar, Se3, StampedPose, Trajectory, UnitQuaternion, Vector3};
use lsfb_perception::statistics::median;
use lsfb_types::Timestamp;

use super::{DeskewedCloud, OdometryResult, ScanPose};
use crate::odometry::report::OdometryReport;
use crate::odometry::unseen::UnseenStretches;
use crate::odometry::{InertialState, MotionKind, OdometryStep, OdometryWarning, StepOutcome};
use crate::{Error, Refusal};

/// Without a scan for longer there is a gap, seconds: one second an IMU bridges to a centimetre or two; five were 18 cm.
const GAP_S: f64 = 1.5;
/// And for longer than so many scans are usually apart.
const GAP_INTERVALS: f64 = 5.0;

/// What has come together so far.
#[derive(Default)]
pub(super) struct Found {
    poses: Vec<StampedPose>,
    scan_poses: Vec<ScanPose>,
    /// What the registered scans alone say of these.
    pub by_scans: Vec<StampedPose>,
    /// And the direction of the world along which each sees no motion, if there is one.
    pub unseen_shifts: Vec<Option<Vector3<f64>>>,
    unseen: UnseenStretches,
    clouds: Vec<DeskewedCloud>,
    pub report: OdometryReport,
    /// Share of each registered scan's keypoints that agreed with the map, and when.
    agreed: Vec<(Timestamp, f64)>,
    plane_squares: f64,
    measured: u64,
}

impl Found {
    pub fn take(&mut self, step: Result<OdometryStep, Error>) -> Result<(), Error> {
        self.report.scans += 1;
        let mut step = match step {
            Ok(step) => step,
            Err(Error::Refused(
                Refusal::EmptyScan { .. } | Refusal::ScanOrder { .. } | Refusal::ImuMissing { .. },
            )) => {
                self.report.skipped += 1;
                return Ok(());
            }
            Err(other) => return Err(other),
        };
        let begins_again = step.begins_again();
        let anew = std::mem::take(&mut step.anew);
        if begins_again {
            self.forget_steps(anew.len() as u64);
        }
        for step in anew.into_iter().chain([step]) {
            self.take_step(step);
        }
        Ok(())
    }

    /// Leaves what was read, and forgets what was made of it: the last steps come anew, and scans before these have no place.
    fn forget_steps(&mut self, anew: u64) {
        let report = std::mem::take(&mut self.report);
        *self = Self::default();
        let lost = (report.registered + report.lost).saturating_sub(anew);
        self.report = OdometryReport {
            registered: 0,
            lost,
            lost_at_end: lost,
            ..report
        };
    }

    /// Takes it back that the last scan was lost: it is such a share of one, and none.
    pub fn leave_out_piece(&mut self, share: f64) {
        let report = &mut self.report;
        report.scans -= 1;
        report.lost -= 1;
        report.lost_at_end -= 1;
        report.warnings.push(OdometryWarning::Piece { share });
    }

    fn take_step(&mut self, step: OdometryStep) {
        if step.outcome == StepOutcome::Lost {
            self.report.lost += 1;
            self.report.lost_at_end += 1;
            return;
        }
        self.report.registered += 1;
        self.unseen.take(&step);
        self.scan_poses.push(ScanPose::of(&step));
        if step.outcome == StepOutcome::Registered {
            self.by_scans.push(StampedPose {
                time: step.time,
                world_from_rig: step.by_scan_alone,
            });
            let unseen = step.unseen.filter(|u| u.kind == MotionKind::Shift);
            let along = unseen.map(|u| u.direction_in_world);
            self.unseen_shifts.push(along);
            self.measured += 1;
            self.agreed.push((step.time, step.inlier_ratio));
            self.plane_squares += step.plane_rms_m * step.plane_rms_m;
        }
        self.clouds.push(DeskewedCloud::of(&step));
        // After a gap only the pose of the scan itself is more than a prediction.
        let gap = std::mem::take(&mut self.report.lost_at_end) > 0;
        let known = if gap {
            step.poses.len().saturating_sub(1)
        } else {
            0
        };
        self.poses.extend(step.poses.into_iter().skip(known));
    }

    /// Turns what the scans alone say as [`Found::finish`] turns the walk.
    pub fn level_by_scans(&mut self, state: Option<&InertialState>) {
        let level = state.map_or_else(UnitQuaternion::identity, level_of);
        for pose in &mut self.by_scans {
            pose.world_from_rig = Se3::new(level, Vector3::zeros()) * pose.world_from_rig;
        }
        for along in self.unseen_shifts.iter_mut().flatten() {
            *along = level * *along;
        }
    }

    pub fn finish(self, state: Option<&InertialState>, lidar: &RigLidar) -> OdometryResult {
        let mut report = self.report;
        let mut poses = self.poses;
        let mut scan_poses = self.scan_poses;
        let mut level = UnitQuaternion::identity();
        if let Some(state) = state {
            level = level_of(state);
            let of_scans = scan_poses.iter_mut().map(|scan| &mut scan.pose);
            for pose in poses.iter_mut().chain(of_scans) {
                pose.world_from_rig = Se3::new(level, Vector3::zeros()) * pose.world_from_rig;
            }
            report.gyro_bias_rad_s = Some(state.gyro_bias_rad_s.into());
            report.accel_bias_m_s2 = Some(state.accel_bias_m_s2.into());
        }
        report.scan_interval_s = usual_interval_s(&scan_poses);
        let longest_s = GAP_S.max(GAP_INTERVALS * report.scan_interval_s);
        report.gaps = gaps(&scan_poses, longest_s);
        let trajectory = Trajectory::new(poses);
        let measured = self.measured.max(1) as f64;
        let all_agreed = self.agreed.iter().map(|(_, share)| share);
        report.mean_inlier_ratio = all_agreed.sum::<f64>() / measured;
        report.least_agreement = least_agreement(&self.agreed);
        report.plane_rms_m = (self.plane_squares / measured).sqrt();
        report.unseen = self.unseen.finish(&level);
        report.add_warnings();
        let mut result = OdometryResult {
            trajectory,
            scan_poses,
            clouds: self.clouds,
            lidar: lidar.clone(),
            report,
        };
        result.summarise();
        result
    }
}

/// A stretch over which the agreement of scans with the map is averaged, seconds; scans it must have.
const STRETCH_S: f64 = 10.0;
const LEAST_SCANS: usize = 5;

/// Where scans agree least with the map, over ten seconds: seconds after the first, share of their keypoints.
fn least_agreement(agreed: &[(Timestamp, f64)]) -> Option<[f64; 2]> {
    let (start, _) = agreed.first()?;
    let stretches = (0..agreed.len()).filter_map(|first| {
        let (from, _) = agreed[first];
        let inside = agreed[first..].iter();
        let inside = inside.take_while(|(time, _)| time.secs_since(from) < STRETCH_S);
        let shares: Vec<f64> = inside.map(|(_, share)| *share).collect();
        let mean = shares.iter().sum::<f64>() / shares.len() as f64;
        (shares.len() >= LEAST_SCANS).then(|| [from.secs_since(*start), mean])
    });
    stretches.min_by(|a, b| a[1].total_cmp(&b[1]))
}

/// Where no scan has a pose for longer: from and until when, seconds after the first scan.
fn gaps(scan_poses: &[ScanPose], longest_s: f64) -> Vec<[f64; 2]> {
    let Some(start) = scan_poses.first().map(|scan| scan.pose.time) else {
        return Vec::new();
    };
    let pairs = scan_poses.windows(2);
    let spans = pairs.map(|pair| [0, 1].map(|k| pair[k].pose.time.secs_since(start)));
    spans
        .filter(|[from_s, to_s]| to_s - from_s > longest_s)
        .collect()
}

/// Gravity is known best at the end of the walk; the whole walk is turned level with it.
fn level_of(state: &InertialState) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(&state.gravity_m_s2, &-Vector3::z())
        .unwrap_or_else(UnitQuaternion::identity)
}

/// The median time from one pose to the next, seconds; 0 for less than two.
fn usual_interval_s(scan_poses: &[ScanPose]) -> f64 {
    let pairs = scan_poses.windows(2);
    let intervals_s = pairs.map(|pair| pair[1].pose.time.secs_since(pair[0].pose.time));
    median(intervals_s.collect()).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Matrix6;

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
            anew: Vec::new(),
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
        assert!(
            sentence.contains("the last 1 scans could not be registered"),
            "{sentence}"
        );
    }

    /// Naively the IMU's path through seconds without scans was written like any other, with exit 0 (18 cm off after five of them).
    #[test]
    fn seconds_without_scans_are_no_poses() {
        use StepOutcome::{First, Registered};
        let mut run = Found::default();
        for tenths in [10, 11, 12, 20, 21, 60, 61] {
            let outcome = if tenths == 10 { First } else { Registered };
            let mut step = step(tenths, outcome).expect("a step");
            if tenths == 60 {
                let end = step.poses[1];
                let at = |k: i64| StampedPose {
                    time: Timestamp::from_nanos(k * 100_000_000),
                    ..end
                };
                step.poses = (22..=60).map(at).collect();
            }
            run.take(Ok(step)).expect("taken");
        }
        let result = run.finish(None, &lidar());
        let told = result.trajectory_outside_gaps();
        let times = told.poses().iter().map(|p| p.time.nanos());
        let in_gap = times.filter(|t| (2_100_000_001..6_000_000_000).contains(t));
        assert_eq!(in_gap.count(), 0);
        let all = told.poses();
        assert!(all.iter().any(|p| p.time.nanos() == 6_000_000_000));
        // Eight tenths of a second are bridged.
        assert!(all.iter().any(|p| p.time.nanos() == 1_950_000_000));
        let report = &result.report;
        assert_eq!(report.gaps.len(), 1);
        let [from_s, to_s] = report.gaps[0];
        assert!((from_s - 1.1).abs() < 1e-9 && (to_s - 5.0).abs() < 1e-9);
        assert!(!report.is_whole() && report.lost == 0);
        let codes: Vec<_> = report.warnings.iter().map(|w| w.finding().code).collect();
        assert_eq!(codes, ["lidar-gap"]);
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
            // Where scans come often, five seconds without one are a gap.
            assert_eq!(report.is_whole(), said);
        }
    }
}
