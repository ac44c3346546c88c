//! What is said of the motion of a recorded walk, and what of it is left out.

use lsfb_geometry::{Matrix6, Trajectory};
use lsfb_types::{Finding, Limit, Verdict};
use serde::{Deserialize, Serialize};

use super::blind::blind_stretches;
use super::{Beginning, Motion, MotionConfig, Revisits, TrackedWalk};
use crate::ground_truth::config::UNLIKELY_SIGMAS;
use crate::ground_truth::imu_refinement::ImuRefinement;
use crate::ground_truth::report::{
    CameraRefinement, GroundTruthWarning, LeftOutReason, ReprojectionErrors, Span,
};
use crate::worst_sigma::worst_sigmas;
use lsfb_perception::imu::{ImuBias, PreintegratedImu};

/// What was read, and what could not be.
#[derive(Default)]
pub(super) struct Read {
    pub images: u64,
    pub damaged_images: u64,
    pub damaged_samples: u64,
    pub repeated_samples: u64,
    pub repeated_stamps: u64,
    pub frozen_images: u64,
    pub frozen_secs: f64,
}

/// What the stage says about its own result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionReport {
    /// Images that were read.
    pub images: u64,
    /// Instants that were to get a pose.
    pub frames: u64,
    /// Those that have one.
    pub poses: u64,
    /// How the motion began.
    pub beginning: Beginning,
    /// Points that were placed.
    pub points: u64,
    /// Reprojection errors of their sights.
    pub errors: ReprojectionErrors,
    /// Share of the followed sights that fit no point.
    pub contradicted_share: f64,
    /// Beyond this share the walk is doubtful.
    pub doubtful_contradicted_share: f64,
    /// What the walk makes of the rig file's cameras.
    pub cameras: Vec<CameraRefinement>,
    /// Beyond so many standard deviations of the rig file the motion is bent.
    pub max_camera_off_sigmas: f64,
    /// Stretches left out of the trajectory.
    pub left_out: Vec<Span>,
    /// Inertial samples.
    pub imu_samples: u64,
    /// Gyroscope bias in the middle of the walk, rad/s.
    pub gyro_bias_rad_s: [f64; 3],
    /// Accelerometer bias in the middle of the walk, m/s².
    pub accel_bias_m_s2: [f64; 3],
    /// Largest of their components in the standard deviations that the settings give a first bias.
    pub bias_sigmas: f64,
    /// Places that the walk came back to.
    pub revisits: Revisits,
    /// What the walk makes of the IMU.
    #[serde(flatten)]
    pub imu: ImuRefinement,
    /// Length of the path, metres.
    pub path_length_m: f64,
    /// Largest standard deviation of a position of the trajectory relative to its first, metres.
    pub largest_position_sigma_m: f64,
    /// What the reader should know.
    pub warnings: Vec<GroundTruthWarning>,
}

/// Standard deviation of a position in its worst direction, metres.
fn position_sigma_m(covariance: &Matrix6<f64>) -> f64 {
    let [_, place_m] = worst_sigmas(covariance);
    place_m
}

/// What has no place in the trajectory.
pub(super) struct LeftOut {
    /// For each frame why it is left out, if it is.
    pub reasons: Vec<Option<LeftOutReason>>,
    /// The same as stretches of time, and those in which there was no frame at all.
    pub spans: Vec<Span>,
}

/// Leaves out the stretches in which too little is followed for too long, and poses that are not certain enough.
pub(super) fn left_out(walk: &TrackedWalk, motion: &Motion, config: &MotionConfig) -> LeftOut {
    let count = walk.frames.len();
    let time = |k: usize| walk.frames[k].time;
    let sees_enough = |k: &usize| motion.sights_in_use[*k] >= config.min_sights;
    let blind = blind_stretches(walk, &motion.sights_in_use, config);
    let not_followed = LeftOutReason::NotFollowed;
    let spans = blind
        .iter()
        .map(|[a, b]| Span::new(time(*a), time(*b), not_followed));
    let mut spans: Vec<Span> = spans.collect();
    let mut reasons = vec![None; count];
    for k in blind.into_iter().flat_map(|[a, b]| a..=b) {
        reasons[k] = (!sees_enough(&k)).then_some(not_followed);
    }
    let mut before = None;
    for (k, (reason, covariance)) in reasons.iter_mut().zip(&motion.covariances).enumerate() {
        // What is no number is not certain.
        let is_certain = position_sigma_m(covariance) <= config.max_position_sigma_m;
        if reason.is_none() && !is_certain {
            *reason = Some(LeftOutReason::Uncertain);
            match (before, spans.last_mut()) {
                (Some(LeftOutReason::Uncertain), Some(span)) => span.to_ns = time(k).nanos(),
                _ => spans.push(Span::new(time(k), time(k), LeftOutReason::Uncertain)),
            }
        }
        before = *reason;
    }
    spans.sort_by_key(|span| span.from_ns);
    LeftOut { reasons, spans }
}

impl MotionReport {
    pub(super) fn new(
        read: &Read,
        walk: &TrackedWalk,
        motion: &Motion,
        trajectory: &Trajectory,
        covariances: &[Matrix6<f64>],
        left_out: Vec<Span>,
        config: &MotionConfig,
    ) -> Self {
        let middle = motion.biases.get(motion.biases.len() / 2);
        let bias = middle.copied().unwrap_or_default();
        let adjustment = &config.adjustment;
        let gyro = bias.gyro_rad_s.amax() / adjustment.gyro_bias_sigma_rad_s;
        let accel = bias.accel_m_s2.amax() / adjustment.accel_bias_sigma_m_s2;
        let sigmas = covariances.iter().map(position_sigma_m);
        let some = |count: u64| (count > 0).then_some(count);
        let counted = [
            some(imu_gaps(walk)).map(|intervals| GroundTruthWarning::ImuGaps { intervals }),
            some(read.damaged_images).map(|images| GroundTruthWarning::DamagedImages { images }),
            some(read.damaged_samples)
                .map(|samples| GroundTruthWarning::DamagedSamples { samples }),
            some(read.repeated_samples)
                .map(|samples| GroundTruthWarning::RepeatedSamples { samples }),
            some(read.repeated_stamps).map(|images| GroundTruthWarning::RepeatedStamps { images }),
            some(read.frozen_images).map(|images| GroundTruthWarning::FrozenImages { images }),
            GroundTruthWarning::of_frozen_samples(read.frozen_secs),
        ];
        Self {
            images: read.images,
            frames: walk.frames.len() as u64,
            poses: trajectory.len() as u64,
            beginning: motion.beginning,
            points: motion.points as u64,
            errors: motion.errors.clone(),
            contradicted_share: motion.contradicted_share,
            doubtful_contradicted_share: config.doubtful_contradicted_share,
            cameras: motion.cameras.clone(),
            max_camera_off_sigmas: config.max_camera_off_sigmas,
            left_out,
            imu_samples: walk.imu.len() as u64,
            gyro_bias_rad_s: bias.gyro_rad_s.into(),
            accel_bias_m_s2: bias.accel_m_s2.into(),
            bias_sigmas: gyro.max(accel),
            revisits: motion.revisits,
            imu: motion.imu.clone(),
            path_length_m: trajectory.path_length_m(),
            largest_position_sigma_m: sigmas.fold(0.0, f64::max),
            warnings: counted
                .into_iter()
                .flatten()
                .chain(motion.unrest.clone())
                .collect(),
        }
    }

    /// Whether nothing is left out: every message was read, every frame has a pose.
    pub fn is_whole(&self) -> bool {
        self.left_out.is_empty() && !self.warnings.iter().any(GroundTruthWarning::loses_data)
    }

    /// Everything that was looked at, good or not.
    pub fn findings(&self) -> Vec<Finding> {
        let share = 100.0 * self.poses as f64 / self.frames.max(1) as f64;
        let whole = Verdict::Warn.unless(self.left_out.is_empty());
        let coverage = format!("{} of {} frames have a pose", self.poses, self.frames);
        let contradicted = 100.0 * self.contradicted_share;
        let agrees = self.contradicted_share <= self.doubtful_contradicted_share;
        let agreement = format!(
            "{contradicted:.0} % of the tracked features fit no point; the rest has a reprojection error of {:.2} px rms",
            self.errors.rms_px
        );
        let drift = format!(
            "positions relative to the first one: standard deviation up to {:.1} cm",
            self.largest_position_sigma_m * 1e2
        );
        let biases = format!(
            "the IMU's biases are up to {:.1} standard deviations off zero",
            self.bias_sigmas
        );
        let mut findings = vec![
            Finding::new("coverage", whole, "trajectory", coverage)
                .value(share, "%")
                .limit(Limit::AtLeast(100.0)),
            Finding::new("agreement", Verdict::Warn.unless(agrees), "images", agreement)
                .value(contradicted, "%")
                .limit(Limit::AtMost(100.0 * self.doubtful_contradicted_share))
                .remedy("check the rig file against the device; if it is right, moving objects fill too much of the images"),
            Finding::new("drift", Verdict::Pass, "trajectory", drift)
                .value(self.largest_position_sigma_m * 1e2, "cm"),
            Finding::new("imu-bias", Verdict::Warn.unless(self.bias_sigmas <= UNLIKELY_SIGMAS), "IMU", biases)
                .value(self.bias_sigmas, "")
                .limit(Limit::AtMost(UNLIKELY_SIGMAS))
                .remedy("check the IMU's units, scale and axes"),
        ];
        findings.extend(self.revisits.finding());
        findings.extend(self.imu.findings());
        findings.extend(self.left_out_findings());
        findings.extend(self.cameras.iter().map(|camera| self.of_camera(camera)));
        findings.extend(self.warnings.iter().map(of_warning));
        findings
    }

    /// One for each reason.
    fn left_out_findings(&self) -> impl Iterator<Item = Finding> + '_ {
        LeftOutReason::ALL.into_iter().filter_map(|reason| {
            let spans = self.left_out.iter().filter(|s| s.reason == reason);
            let (count, ns) = spans.fold((0, 0), |(count, ns), span| {
                (count + 1, ns + span.to_ns - span.from_ns)
            });
            (count > 0).then(|| {
                let left_out = GroundTruthWarning::LeftOut {
                    reason,
                    secs: ns as f64 / 1e9,
                    spans: count,
                };
                let finding = left_out.finding();
                match reason {
                    LeftOutReason::Uncertain => {
                        finding.remedy("split the walk, look at more texture, or raise the limit")
                    }
                    _ => finding,
                }
            })
        })
    }

    /// A camera that is not as the rig file says, and so far from it that the motion is bent by it, fails.
    fn of_camera(&self, camera: &CameraRefinement) -> Finding {
        match camera.largest_sigmas <= UNLIKELY_SIGMAS {
            true => camera.finding(),
            false => camera.off(self.max_camera_off_sigmas),
        }
    }
}

/// As of a walk that has no map.
fn of_warning(warning: &GroundTruthWarning) -> Finding {
    let finding = warning.finding();
    match warning {
        GroundTruthWarning::NotAtRest { .. } => finding.remedy(
            "check the calibration of the device, and whether moving objects fill the images",
        ),
        _ => finding,
    }
}

/// Intervals between frames that lack inertial samples.
fn imu_gaps(walk: &TrackedWalk) -> u64 {
    let pairs = walk.frames.windows(2);
    let gaps = pairs.filter(|pair| {
        let (from, to) = (pair[0].time, pair[1].time);
        PreintegratedImu::integrate(&walk.imu, from, to, ImuBias::default(), &walk.noise).is_err()
    });
    gaps.count() as u64
}
