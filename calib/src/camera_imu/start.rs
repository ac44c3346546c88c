//! A first guess of motion, clocks and orientation.
//!
//! A clock's offset is that at which camera and gyroscope turn equally fast; the orientation is the rotation between their
//! angular velocities; the motion is the cameras' own, pose by pose.

use lsfb_geometry::{Se3, StampedPose, Trajectory, UnitQuaternion, Vector3, spline};
use lsfb_types::Timestamp;

use super::bend::Bend;
use super::gyro_alignment::GyroAlignment;
use super::inertial::AxisErrors;
use super::input::Input;
use super::knot_spacing::knot_spacing_s;
use super::posed_views::{MIN_VIEWS, PosedViews, compare, different_views, look};
use super::samples::{
    MARGIN_S, check_rotation, crop, end_within_a_segment, excitation, interval_s, samples_of,
    saturation,
};
use super::state::{Mounted, RigEstimate, View};
use super::{Clock, KnownCamera, Motion, ORDER, checks};
use crate::camera::copied;
use crate::coverage::corners_by_cell;
use crate::residual_diagnosis::Unmodelled;
use crate::{Error, JoinProblem, PoorMotion};

/// Samples of the IMU needed.
const MIN_SAMPLES: usize = 200;

impl RigEstimate {
    /// With the readout times of the cameras as they are known, or others, seconds.
    pub fn with_readouts(input: &Input, readouts_s: &[f64]) -> Result<Self, Error> {
        let Input {
            target,
            cameras,
            imu,
            noise,
            config,
        } = *input;
        let (origin, mut samples) = samples_of(imu, cameras)?;
        let mut findings = saturation(&samples);
        findings.extend(cameras.iter().filter_map(|c| copied(&c.views)));
        let seen: Vec<PosedViews> = cameras
            .iter()
            .zip(readouts_s)
            .enumerate()
            .map(|(k, (known, readout_s))| look(input, known, *readout_s, k, origin))
            .collect::<Result<_, _>>()
            .map_err(|error| match error {
                // A rig at rest sees the same again and again: that it rests is what is wrong.
                Error::CopiedImages { .. } => {
                    let [rate_rms, _] = excitation(&samples);
                    check_rotation(&rate_rms, config).err().unwrap_or(error)
                }
                error => error,
            })?;
        let Some(first) = cameras.first() else {
            return Err(Error::TargetNotSeen {
                camera: "(none given)".into(),
                found: 0,
                images: 0,
                needed: MIN_VIEWS,
                target: target.describe(),
            });
        };
        let length_s = samples.last().map_or(0.0, |s| s.time_s);
        crop(&mut samples, &seen, config.max_offset_s);
        if samples.len() < MIN_SAMPLES {
            return Err(Error::NotJoined {
                first: first.views.name.clone(),
                second: "the IMU".into(),
                cause: JoinProblem::FewSamples {
                    samples: samples.len(),
                    length_s,
                    within_s: config.max_offset_s,
                    needed: MIN_SAMPLES,
                },
            });
        }
        checks::unit_of_accelerometer(&samples, config)?;
        let [rate_rms, force_rms] = excitation(&samples);
        check_rotation(&rate_rms, config)?;
        let from_rig =
            |known: &KnownCamera| known.camera_from_first * first.camera_from_first.inverse();
        let mut mounted = Vec::with_capacity(cameras.len());
        let mut first_from_rig = UnitQuaternion::identity();
        for (k, ((known, own), readout_s)) in cameras.iter().zip(&seen).zip(readouts_s).enumerate()
        {
            let turned =
                GyroAlignment::new(&samples, &own.poses).solve(&known.views.name, config)?;
            if k == 0 {
                first_from_rig = turned.camera_from_rig;
            } else {
                compare(first, &seen[0], known, own, &from_rig(known))?;
            }
            mounted.push(Mounted {
                name: known.views.name.clone(),
                camera: known.camera,
                camera_from_rig: from_rig(known) * Se3::new(first_from_rig, Vector3::zeros()),
                clock: Clock::new(turned.offset_s, 0.0),
                readout_s: *readout_s,
                sigma_px: config.corner_sigma_px,
                unmodelled: Unmodelled::none(),
                alone_px: own.median_px,
                cells: corners_by_cell(
                    different_views(&known.views).into_iter().flat_map(|v| v.1),
                    [known.views.width, known.views.height],
                ),
            });
        }
        let path = path_of(&mounted, &seen, origin);
        let (Some(start), Some(end)) = (path.poses().first(), path.poses().last()) else {
            return Err(PoorMotion::NothingSeen.into());
        };
        let start_s = (start.time.secs_since(origin) - MARGIN_S).max(0.0);
        let end_s = end.time.secs_since(origin) + MARGIN_S;
        samples.retain(|s| s.time_s >= start_s && s.time_s <= end_s);
        let interval_s = interval_s(&samples);
        let knots = spline::UniformKnots {
            start_s,
            spacing_s: knot_spacing_s(&samples, config.knot_spacing_s),
        };
        end_within_a_segment(&mut samples, &knots);
        let end_s = samples.last().map_or(end_s, |s| s.time_s);

        let (rotations, positions) = (0..knots.count::<ORDER>(end_s))
            .map(|k| {
                let time_s = start_s + (k as f64 - 0.5 * (ORDER - 2) as f64) * knots.spacing_s;
                let pose = nearest(&path, origin.plus_secs(time_s));
                (pose.rotation, pose.translation)
            })
            .unzip();
        let force: Vector3<f64> = samples
            .iter()
            .map(|s| nearest(&path, origin.plus_secs(s.time_s)).rotation * s.accel)
            .sum();
        let gravity = -force.try_normalize(1e-9).unwrap_or_else(Vector3::z) * config.gravity_m_s2;
        // An even number: one control point lies in the middle.
        let spans = 2.0
            * (0.5 * (end_s - start_s) / config.bias_spacing_s)
                .ceil()
                .max(1.0);
        let biases = vec![Vector3::zeros(); spans as usize + 1];
        // Sample noise of white noise with a density: density over the root of the interval.
        let per_sample = 1.0 / interval_s.sqrt();
        let points = || (0..target.corner_count()).map(|k| target.corner(k));
        let centre = points().sum::<Vector3<f64>>() / target.corner_count() as f64;
        let half_board_m = points().map(|p| (p - centre).amax()).fold(0.0, f64::max);
        let views: Vec<View> = seen.into_iter().flat_map(|s| s.views).collect();
        Ok(Self {
            motion: Motion {
                origin,
                knots,
                rotations,
                positions,
            },
            cameras: mounted,
            gyro_bias: biases.clone(),
            accel_bias: biases,
            bias_spacing_s: (end_s - start_s) / spans,
            gyro_axes: AxisErrors::zeros(),
            accel_axes: AxisErrors::zeros(),
            accel_delay_s: 0.0,
            gravity,
            bend: Bend::zeros(),
            middle_s: 0.5 * (start_s + end_s),
            centre,
            half_board_m,
            samples,
            views,
            gyro_sigma: noise.gyro_noise_density * per_sample,
            accel_sigma: noise.accel_noise_density * per_sample,
            noise: noise.clone(),
            rate_rms,
            force_rms,
            findings,
        })
    }
}

/// The rig's own poses: the first camera's, and others' where that one sees nothing.
fn path_of(cameras: &[Mounted], seen: &[PosedViews], origin: Timestamp) -> Trajectory {
    const APART_S: f64 = 0.03;
    let mut poses: Vec<(f64, Se3)> = Vec::new();
    for (camera, own) in cameras.iter().zip(seen) {
        let taken: Vec<f64> = poses.iter().map(|p| p.0).collect();
        for (stamp_s, target_from_camera) in &own.poses {
            let time_s = stamp_s + camera.clock.x;
            let next = taken.partition_point(|t| *t < time_s);
            let near = |k: usize| taken.get(k).is_some_and(|t| (t - time_s).abs() < APART_S);
            let before = next.checked_sub(1).is_some_and(near);
            if !(near(next) || before) {
                poses.push((time_s, *target_from_camera * camera.camera_from_rig));
            }
        }
        poses.sort_by(|a, b| a.0.total_cmp(&b.0));
    }
    let stamped = poses.into_iter().map(|(time_s, pose)| StampedPose {
        time: origin.plus_secs(time_s),
        world_from_rig: pose,
    });
    Trajectory::new(stamped.collect())
}

/// Pose at a time, that of the nearest end outside.
fn nearest(motion: &Trajectory, time: Timestamp) -> Se3 {
    motion.at(time).unwrap_or_else(|| {
        let poses = motion.poses();
        let end = match poses.first() {
            Some(first) if time < first.time => Some(first),
            _ => poses.last(),
        };
        end.map_or_else(Se3::identity, |p| p.world_from_rig)
    })
}
