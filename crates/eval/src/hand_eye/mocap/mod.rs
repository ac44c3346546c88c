//! Motion capture beside an IMU on one body: where the IMU sits on the markers' body, how the clocks run, and the IMU's path, smoother than the
//! markers' jitter and through times in which they were dropped or swapped.
//!
//! The motion is continuous in time: between poses of the motion capture the inertial samples lead along. Unknown beside it are the
//! markers' body on the IMU, both biases, gravity, and the offset of the clocks, which may wander.

mod clock;
mod filter;
mod judge;
mod motion;
mod outcome;

use lsfb_geometry::{ImuNoiseModel, Se3, StampedPose, Vector3};
use lsfb_types::{Bounds, ImuSample, OutOfBounds, ProgressFn, STANDARD_GRAVITY_M_S2, Stamped};

use super::gyroscope::{GyroSample, align_gyroscope};
use super::refine::{correlation_factor, deviations, sigmas};
use super::{ClockModel, HandEyeConfig, OFFSET_SECS, SEARCH_SECS, show_round};
use crate::Error;
use clock::{Clock, seen, within};
use filter::{About, MarkerPose, Model, Smoothed, smooth};
use motion::{
    ACCEL_BIAS, CLOCK, GRAVITY, GYRO_BIAS, ImuState, Inertial, MOUNT_PLACE, MOUNT_ROTATION,
    Matrix25, PLACE, ROTATION, VELOCITY,
};
pub use outcome::MocapAlignment;
use outcome::{Noise, outcome};

/// How motion capture is aligned to an IMU.
#[derive(Clone, Debug, PartialEq)]
pub struct MocapConfig {
    /// What must be added to the IMU's stamps to have about the motion capture's, seconds.
    pub offset_guess_secs: f64,
    /// How far from it is searched, seconds.
    pub search_secs: f64,
    /// Whether the offset stays; a drifting one may also wander.
    pub clock: ClockModel,
    /// Noise of the IMU.
    pub noise: ImuNoiseModel,
}

impl Default for MocapConfig {
    /// Noise as consumers' IMUs have it, rather too large.
    fn default() -> Self {
        Self {
            offset_guess_secs: 0.0,
            search_secs: 10.0,
            clock: ClockModel::Constant,
            noise: ImuNoiseModel {
                gyro_noise_density: 3e-4,
                accel_noise_density: 3e-3,
                gyro_bias_walk: 3e-5,
                accel_bias_walk: 3e-4,
            },
        }
    }
}

lsfb_types::bounds! {
    MocapConfig {
        offset_guess_secs: number(OFFSET_SECS),
        search_secs: number(SEARCH_SECS),
        clock: any,
        noise: any,
    }
    also has_noise
}

impl MocapConfig {
    /// The model of the noise is the rig's, whose files are checked as a whole.
    fn has_noise(&self, section: &str) -> Result<(), OutOfBounds> {
        let noise = &self.noise;
        for (name, value) in [
            ("gyro_noise_density", noise.gyro_noise_density),
            ("accel_noise_density", noise.accel_noise_density),
            ("gyro_bias_walk", noise.gyro_bias_walk),
            ("accel_bias_walk", noise.accel_bias_walk),
        ] {
            if !Bounds::NOT_NEGATIVE.hold(value) {
                let section = lsfb_types::setting_name(section, "noise");
                return Err(OutOfBounds::new(
                    &section,
                    name,
                    &value,
                    &Bounds::NOT_NEGATIVE,
                ));
            }
        }
        Ok(())
    }
}

/// Fewer say nothing.
const LEAST_POSES: usize = 100;
/// Passes through all poses after the first: numbers that stay follow from the last, noise of the markers from that before.
const PASSES: usize = 6;
/// Of these the last, in which what does not fit counts nothing.
const LAST_PASSES: usize = 3;
/// No motion capture is better, rad and metres: a model of it that says so would take every pose for an outlier.
const LEAST_JITTER: [f64; 2] = [1e-4, 5e-5];
/// Samples further apart leave the motion between them open, seconds.
const LONGEST_GAP_SECS: f64 = 0.1;
/// Random walk of a drifting clock about an even drift, s/√s.
const CLOCK_WALK: f64 = 2e-5;
/// What is known before: rotation of the IMU, rad, its place, m, velocity, m/s, biases, rad/s and m/s², markers on the IMU, rad and m, clock, s,
/// gravity, m/s².
const PRIOR: [f64; 9] = [0.2, 0.5, 2.0, 0.05, 0.5, 0.2, 0.5, 0.005, 0.3];

/// Aligns; both in order of time.
pub fn align_mocap(
    markers: &[StampedPose],
    samples: &[Stamped<ImuSample>],
    config: &MocapConfig,
    progress: ProgressFn<'_>,
) -> Result<MocapAlignment, Error> {
    config.check_bounds("")?;
    let too_few = |poses: usize| Error::TooFewPoses {
        role: "reference",
        poses,
        needed: LEAST_POSES,
    };
    let (Some(first), true) = (samples.first(), markers.len() >= LEAST_POSES) else {
        return Err(too_few(markers.len().min(samples.len())));
    };
    let base = first.time;
    let inertial = Inertial::new(samples, base);
    let turned = turned(markers, samples, config, progress)?;
    let mut clock = Clock {
        ahead_secs: turned.offset_secs,
        drift: 0.0,
        middle_secs: 0.0,
    };
    let poses = within(markers, base, &inertial, &mut clock);
    if poses.len() < LEAST_POSES {
        return Err(too_few(poses.len()));
    }
    let [from, to] = [poses[0].0, poses[poses.len() - 1].0].map(|t| clock.imu_secs(t));
    let gap_secs = inertial.longest_step_secs(from, to);
    if gap_secs > LONGEST_GAP_SECS {
        return Err(Error::InertialGap { gap_secs });
    }
    let mut model = Model {
        noise: config.noise.clone(),
        clock_walk: match config.clock {
            ClockModel::Constant => 0.0,
            ClockModel::Drifting => CLOCK_WALK,
        },
        sigmas: at_least(jitter(&poses)),
    };
    let start = start(&poses, &clock, &inertial, &turned);
    let mut seen = seen(&poses, &clock);
    let mut found = smooth(&inertial, &seen, About::Filter(&start), &prior(), &model)?;
    for pass in 0..PASSES {
        show_round(pass, PASSES, progress)?;
        let left: Vec<_> = found.iter().map(Smoothed::fits).collect();
        let fit = left.iter().flatten().count();
        if fit < LEAST_POSES {
            return Err(Error::NotOneMotion {
                fit,
                poses: poses.len(),
                needed: LEAST_POSES,
                force_m_s2: inertial.mean_force_m_s2(),
            });
        }
        model.sigmas = at_least(sigmas(&left));
        let is_last = pass + LAST_PASSES >= PASSES;
        let weights: Vec<f64> = found.iter().map(|f| f.weight(is_last)).collect();
        let states = clock.moved(&found, &mut seen, config.clock);
        let about = About::States(&states, &weights);
        found = smooth(&inertial, &seen, about, &prior(), &model)?;
    }
    show_round(PASSES, PASSES, progress)?;
    let halves = halves(&inertial, &seen, &found, &model);
    let left: Vec<_> = found.iter().map(Smoothed::fits).collect();
    let noise = Noise {
        sigmas: deviations(&left),
        factor: correlation_factor(&left),
    };
    let mut alignment = outcome(&inertial, &seen, &found, &clock, noise)?;
    alignment.findings = judge::judge(&alignment, noise, halves.as_ref());
    Ok(alignment)
}

/// How the gyroscope is turned on the markers' body, and its clock.
fn turned(
    markers: &[StampedPose],
    samples: &[Stamped<ImuSample>],
    config: &MocapConfig,
    progress: ProgressFn<'_>,
) -> Result<super::GyroAlignment, Error> {
    let rates: Vec<GyroSample> = samples
        .iter()
        .map(|s| GyroSample {
            time: s.time,
            rate_rad_s: s.sample.angular_velocity_rad_s.into(),
        })
        .collect();
    let search = HandEyeConfig {
        offset_guess_secs: -config.offset_guess_secs,
        search_secs: config.search_secs,
        clock: ClockModel::Constant,
    };
    align_gyroscope(markers, &rates, &search, progress).map_err(seen_from_the_markers)
}

/// What the search says of offsets is of the other direction; zero minus an offset, so that there is no -0.
fn seen_from_the_markers(error: Error) -> Error {
    match error {
        Error::NoCommonTime {
            search_secs,
            around_secs,
            spans,
        } => Error::NoCommonTime {
            search_secs,
            around_secs: 0.0 - around_secs,
            spans,
        },
        Error::TwoOffsets {
            first_secs,
            second_secs,
        } => Error::TwoOffsets {
            first_secs: 0.0 - first_secs,
            second_secs: 0.0 - second_secs,
        },
        error => error,
    }
}

/// Standard deviations of rotations and positions as they follow from what two poses say of the one between them: rather too large, as the
/// motion is in it.
fn jitter(poses: &[(f64, Se3)]) -> [f64; 2] {
    let off = poses.windows(3).map(|w| {
        let share = (w[1].0 - w[0].0) / (w[2].0 - w[0].0);
        Some(w[0].1.interpolate(&w[2].1, share).local(&w[1].1))
    });
    sigmas(&off.collect::<Vec<_>>())
}

fn at_least(sigmas: [f64; 2]) -> [f64; 2] {
    std::array::from_fn(|k| sigmas[k].max(LEAST_JITTER[k]))
}

fn start(
    poses: &[(f64, Se3)],
    clock: &Clock,
    inertial: &Inertial,
    turned: &super::GyroAlignment,
) -> ImuState {
    let imu_from_markers = lsfb_geometry::UnitQuaternion::new_normalize(
        lsfb_geometry::Quaternion::from_vector(turned.rotation_xyzw.into()),
    );
    let rotation = |pose: &Se3| pose.rotation * imu_from_markers.inverse();
    let up: Vector3<f64> = poses
        .iter()
        .map(|(secs, pose)| rotation(pose) * inertial.at(clock.imu_secs(*secs)).1)
        .sum();
    let down = -up.try_normalize(0.0).unwrap_or(Vector3::z());
    let (first, later) = (&poses[0], &poses[LEAST_POSES / 10]);
    ImuState {
        rotation: rotation(&first.1),
        place: first.1.translation,
        velocity: (later.1.translation - first.1.translation) / (later.0 - first.0),
        gyro_bias: turned.bias_rad_s.into(),
        accel_bias: Vector3::zeros(),
        mount: Se3::new(imu_from_markers, Vector3::zeros()),
        clock_secs: 0.0,
        gravity: down * STANDARD_GRAVITY_M_S2,
    }
}

fn prior() -> Matrix25 {
    let at = [
        ROTATION,
        PLACE,
        VELOCITY,
        GYRO_BIAS,
        ACCEL_BIAS,
        MOUNT_ROTATION,
        MOUNT_PLACE,
        CLOCK,
        GRAVITY,
    ];
    let mut known = Matrix25::zeros();
    for (at, sigma) in at.into_iter().zip(PRIOR) {
        for k in at..if at == CLOCK { at + 1 } else { at + 3 } {
            known[(k, k)] = sigma * sigma;
        }
    }
    known
}

/// What stays, of the first and of the second half of the time alone; `None` where a half does not tell it.
fn halves(
    inertial: &Inertial,
    seen: &[MarkerPose],
    found: &[Smoothed],
    model: &Model,
) -> Option<[Smoothed; 2]> {
    let middle = seen.len() / 2;
    let half = |range: std::ops::Range<usize>| {
        let half = &found[range.clone()];
        let states: Vec<ImuState> = half.iter().map(|f| f.state).collect();
        let weights: Vec<f64> = half.iter().map(|f| f.weight(true)).collect();
        let about = About::States(&states, &weights);
        let found = smooth(inertial, &seen[range], about, &prior(), model).ok()?;
        found.into_iter().next()
    };
    Some([half(0..middle)?, half(middle..seen.len())?])
}

#[cfg(test)]
pub(super) mod tests;
