//! The IMU's term of Eq. (4): what its samples say of the motion from each keyframe to the next.

mod report;

#[cfg(test)]
mod tests;

use lsfb_geometry::{ImuNoiseModel, Rig, Se3, StampedPose, Trajectory, Vector3};
use lsfb_perception::statistics::median;
use lsfb_recording::Recording;
use lsfb_solver::{Block, Problem};
use lsfb_types::{ImuSample, STANDARD_GRAVITY_M_S2, Stamped, Timestamp};

use super::MappingConfig;
use crate::frames::{ReadImu, read_imu_if_any};
use crate::inertial_blocks::{
    StateBlocks, USUAL_ACCEL_BIAS_M_S2, USUAL_GYRO_BIAS_RAD_S, about, add_bias_walks, add_samples,
    inflated,
};
use crate::odometry::{ImuUnits, OdometryReport, imu_pauses, mend_units};
use crate::residuals::ImuPreintegration;
use crate::{Error, Refusal};
use lsfb_perception::imu::{ImuBias, ImuErrors, NavState, PreintegratedImu, standard_gravity_m_s2};
pub use report::InertialReport;

/// What is summed up over longer says less than anything else, and is off by what its noise leaves out, seconds: somebody who stands has no keyframes.
const LONGEST_INTERVAL_S: f64 = 10.0;
/// Samples that are so many times as far apart as they usually are miss some of the motion.
const MOST_PERIODS: f64 = 3.5;
/// A velocity is the difference of poses of the start so long before and after, seconds.
const VELOCITY_SPAN_S: f64 = 0.05;
/// Standard deviation of gravity about what the samples make of it along the start, m/s², in each direction: a bias of the accelerometer and a start that leans by a
/// degree are in it.
const GRAVITY_SIGMA_M_S2: f64 = 0.3;

/// The samples of a recording, in the rig's frame: that is the main IMU's, by which the odometry moves too.
pub(super) struct RecordedImu {
    samples: Vec<Stamped<ImuSample>>,
    /// As Eq. (4) takes it.
    noise: ImuNoiseModel,
    /// By how much that is larger than the rig file says.
    noise_factor: f64,
    /// Samples further apart leave a gap, seconds.
    bridged_s: f64,
    /// Messages that could not be read.
    pub damaged: u64,
}

impl RecordedImu {
    /// `None` where the settings do not ask for the term. [`Refusal::NoImuTerm`] where they do, and there is no IMU to make it of.
    pub fn read(
        recording: &Recording,
        rig: &Rig,
        config: &MappingConfig,
    ) -> Result<Option<Self>, Error> {
        if !config.terms.imu {
            return Ok(None);
        }
        let refused = |reason: &str| {
            Error::Refused(Refusal::NoImuTerm {
                path: recording.path().to_owned(),
                reason: reason.to_owned(),
            })
        };
        let noise = rig
            .imu_noise()
            .ok_or_else(|| refused("its rig file has no IMU"))?;
        let densities = [
            noise.gyro_noise_density,
            noise.accel_noise_density,
            noise.gyro_bias_walk,
            noise.accel_bias_walk,
        ];
        if !densities.iter().all(|density| *density > 0.0) {
            return Err(refused(
                "its rig file says that the IMU has no noise, or a constant bias",
            ));
        }
        let ReadImu {
            mut samples,
            damaged,
            ..
        } = read_imu_if_any(recording)?;
        if samples.len() < 2 {
            return Err(refused("it has no IMU samples"));
        }
        // Of an accelerometer in gravities the odometry says so.
        if let ImuUnits::Wrong { problem } = mend_units(&mut samples) {
            return Err(refused(&problem));
        }
        Ok(Some(Self {
            damaged,
            ..Self::new(samples, noise, config.imu_noise_factor)
        }))
    }

    fn new(samples: Vec<Stamped<ImuSample>>, noise: &ImuNoiseModel, noise_factor: f64) -> Self {
        let periods = samples.windows(2).map(|w| w[1].time.secs_since(w[0].time));
        let usual_s = median(periods.collect()).unwrap_or_default();
        Self {
            noise: inflated(noise, noise_factor),
            noise_factor,
            bridged_s: MOST_PERIODS * usual_s,
            damaged: 0,
            samples,
        }
    }

    /// The samples between keyframes, which lie where the trajectory has them.
    pub fn between<'a>(
        &'a self,
        keyframes: &[StampedPose],
        trajectory: &Trajectory,
        odometry: &OdometryReport,
    ) -> Result<KeyframeImu<'a>, Error> {
        let begin = trajectory.poses().first().map(|pose| pose.time);
        let pauses = imu_pauses(&self.samples, trajectory.poses());
        let pauses: Vec<[Timestamp; 2]> = begin
            .iter()
            .flat_map(|begin| pauses.iter().map(|p| p.map(|secs| begin.plus_secs(secs))))
            .collect();
        let is_whole = |pair: &[StampedPose]| {
            let [from, to] = [pair[0].time, pair[1].time];
            let is_felt = pauses.iter().all(|p| p[1] <= from || to <= p[0]);
            to.secs_since(from) <= LONGEST_INTERVAL_S && is_felt && self.has_all(from, to)
        };
        let mut imu = KeyframeImu {
            times: keyframes.iter().map(|k| k.time).collect(),
            whole: keyframes.windows(2).map(is_whole).collect(),
            start: InertialEstimate {
                velocities_m_s: keyframes
                    .iter()
                    .map(|k| velocity(trajectory, k.time))
                    .collect(),
                biases: vec![first_bias(odometry); keyframes.len()],
                gravity_m_s2: standard_gravity_m_s2(),
            },
            recorded: self,
        };
        imu.start.gravity_m_s2 = imu.gravity_along(keyframes);
        Ok(imu)
    }

    /// Whether samples lie close to one another from one time to another.
    fn has_all(&self, from: Timestamp, to: Timestamp) -> bool {
        let before = self.samples.partition_point(|s| s.time <= from);
        let behind = self.samples.partition_point(|s| s.time < to);
        let Some(first) = before.checked_sub(1) else {
            return false;
        };
        let around = self.samples.get(first..=behind).unwrap_or_default();
        let mut gaps = around.windows(2).map(|w| w[1].time.secs_since(w[0].time));
        !around.is_empty() && gaps.all(|secs| secs <= self.bridged_s)
    }
}

/// As the odometry has the biases in the end; none where another program walked.
fn first_bias(odometry: &OdometryReport) -> ImuBias {
    ImuBias {
        gyro_rad_s: odometry.gyro_bias_rad_s.unwrap_or_default().into(),
        accel_m_s2: odometry.accel_bias_m_s2.unwrap_or_default().into(),
    }
}

/// In the world; none where the trajectory does not tell it.
fn velocity(trajectory: &Trajectory, time: Timestamp) -> Vector3<f64> {
    let ends = [-VELOCITY_SPAN_S, VELOCITY_SPAN_S].map(|secs| {
        let there = time.plus_secs(secs);
        let pose = trajectory.at(there).map(|pose| (there, pose));
        pose.or_else(|| Some((time, trajectory.at(time)?)))
    });
    match ends {
        [Some((from, a)), Some((to, b))] if from < to => {
            (b.translation - a.translation) / to.secs_since(from)
        }
        _ => Vector3::zeros(),
    }
}

/// What is searched beside the poses of the keyframes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct InertialEstimate {
    /// Of each keyframe, in the world, m/s.
    pub velocities_m_s: Vec<Vector3<f64>>,
    /// At each keyframe.
    pub biases: Vec<ImuBias>,
    /// In the world, m/s².
    pub gravity_m_s2: Vector3<f64>,
}

/// The samples of a recording between its keyframes.
pub(super) struct KeyframeImu<'a> {
    recorded: &'a RecordedImu,
    /// Of the keyframes.
    times: Vec<Timestamp>,
    /// Whether the samples from each keyframe to the next are whole.
    whole: Vec<bool>,
    /// What is known before Eq. (4) is solved.
    pub start: InertialEstimate,
}

impl<'a> KeyframeImu<'a> {
    /// The term, with the samples summed up at the biases of an estimate.
    pub fn term(&'a self, estimate: &InertialEstimate) -> InertialTerm<'a> {
        let intervals = estimate.biases.iter().take(self.whole.len()).enumerate();
        let intervals =
            intervals.map(|(k, bias)| self.sum_up(k, *bias).and_then(ImuPreintegration::new));
        InertialTerm {
            imu: self,
            intervals: intervals.collect(),
            estimate: estimate.clone(),
        }
    }

    /// From a keyframe to the next; `None` where samples are missing.
    fn sum_up(&self, k: usize, bias: ImuBias) -> Option<PreintegratedImu> {
        if !self.whole[k] {
            return None;
        }
        let RecordedImu { samples, noise, .. } = self.recorded;
        let [from, to] = [self.times[k], self.times[k + 1]];
        PreintegratedImu::integrate(samples, from, to, bias, noise).ok()
    }

    /// As strong as gravity is, where the samples have it on average along the keyframes: what they gained and what the velocities did not.
    fn gravity_along(&self, keyframes: &[StampedPose]) -> Vector3<f64> {
        let InertialEstimate {
            velocities_m_s,
            biases,
            ..
        } = &self.start;
        let mut fallen = Vector3::zeros();
        for k in 0..self.whole.len() {
            if let Some(sum) = self.sum_up(k, biases[k]) {
                let felt = keyframes[k].world_from_rig.rotation * sum.velocity_m_s;
                fallen += velocities_m_s[k + 1] - velocities_m_s[k] - felt;
            }
        }
        let direction = fallen.try_normalize(f64::MIN_POSITIVE);
        direction.map_or_else(standard_gravity_m_s2, |down| down * STANDARD_GRAVITY_M_S2)
    }
}

/// The IMU's term at an estimate.
pub(super) struct InertialTerm<'a> {
    imu: &'a KeyframeImu<'a>,
    /// What the samples say from each keyframe to the next; `None` where some are missing, or it is too long.
    intervals: Vec<Option<ImuPreintegration>>,
    estimate: InertialEstimate,
}

/// Blocks of the keyframes that the IMU ties to another, and of gravity.
pub(super) struct InertialBlocks {
    /// With the numbers of the keyframes.
    states: Vec<(usize, StateBlocks)>,
    gravity: Block<Vector3<f64>>,
}

impl InertialTerm<'_> {
    /// Whether the IMU says how one goes from a keyframe to the next.
    pub fn has(&self, k: usize) -> bool {
        self.intervals.get(k).is_some_and(Option::is_some)
    }

    /// Adds the term. Keyframes without a factor have no velocity and no bias: nothing would determine them.
    pub fn add(
        &self,
        problem: &mut Problem,
        poses: &[Block<Se3>],
    ) -> Result<InertialBlocks, Error> {
        let (imu, estimate) = (self.imu, &self.estimate);
        let known = imu.start.gravity_m_s2;
        let gravity = about(problem, known, Vector3::repeat(GRAVITY_SIGMA_M_S2))?;
        problem.set_value(gravity, &estimate.gravity_m_s2);
        let is_tied = |k: &usize| self.has(*k) || k.checked_sub(1).is_some_and(|k| self.has(k));
        let tied = (0..poses.len()).filter(is_tied);
        let states: Vec<(usize, StateBlocks)> = tied
            .map(|k| {
                let (velocity_m_s, bias) = (estimate.velocities_m_s[k], &estimate.biases[k]);
                let blocks = StateBlocks::beside(problem, poses[k], velocity_m_s, bias);
                (k, blocks)
            })
            .collect();
        if let Some((_, first)) = states.first() {
            first.hold_biases(problem, USUAL_GYRO_BIAS_RAD_S, USUAL_ACCEL_BIAS_M_S2)?;
        }
        for pair in states.windows(2) {
            let [(from, a), (to, b)] = [&pair[0], &pair[1]];
            let secs = imu.times[*to].secs_since(imu.times[*from]);
            add_bias_walks(problem, [a, b], secs, &imu.recorded.noise, 1.0)?;
            // Keyframes side by side in this list may have others between them, or a gap.
            if let (true, Some(samples)) = (*to == *from + 1, &self.intervals[*from]) {
                add_samples(problem, [a, b], gravity, samples.clone(), &[])?;
            }
        }
        Ok(InertialBlocks { states, gravity })
    }

    /// What a solution has in place of the estimate.
    pub fn solved(&self, problem: &Problem, blocks: &InertialBlocks) -> InertialEstimate {
        let mut estimate = self.estimate.clone();
        for (k, blocks) in &blocks.states {
            let state = blocks.read(problem);
            estimate.velocities_m_s[*k] = state.nav.velocity_m_s;
            estimate.biases[*k] = state.bias;
        }
        estimate.gravity_m_s2 = problem.value(blocks.gravity);
        estimate
    }

    /// How many factors there are, and how well keyframes at these poses agree with them.
    pub fn report(&self, keyframes: &[StampedPose]) -> InertialReport {
        let InertialEstimate {
            velocities_m_s,
            biases,
            gravity_m_s2,
        } = &self.estimate;
        let state = |k: usize| NavState {
            world_from_rig: keyframes[k].world_from_rig,
            velocity_m_s: velocities_m_s[k],
        };
        let (mut factors, mut squares) = (0u64, 0.0);
        for (k, samples) in self.intervals.iter().enumerate() {
            if let Some(samples) = samples {
                let ends = [&state(k), &state(k + 1)];
                let off = samples.whitened(ends, &biases[k], &ImuErrors::default(), gravity_m_s2);
                squares += off.norm_squared();
                factors += 1;
            }
        }
        let rms = (squares / (9 * factors.max(1)) as f64).sqrt();
        InertialReport {
            factors,
            left_out: self.intervals.len() as u64 - factors,
            rms_sigmas: self.imu.recorded.noise_factor * rms,
        }
    }
}
