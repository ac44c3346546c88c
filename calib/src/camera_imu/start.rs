//! A first guess of motion, clocks and orientation.
//!
//! A clock's offset is that at which camera and gyroscope turn equally fast; the orientation is the rotation between their
//! angular velocities; the motion is the cameras' own, pose by pose.

use std::collections::BTreeMap;

use lsfb_geometry::{
    ImuNoiseModel, Se3, StampedPose, Trajectory, UnitQuaternion, Vector2, Vector3, spline,
};
use lsfb_types::{Finding, ImuSample, Limit, Timestamp, Verdict};

use super::bend::Bend;
use super::gyro_alignment::GyroAlignment;
use super::inertial::{AccelAxes, GyroAxes};
use super::state::{Mounted, Sample, State, View};
use super::{CameraImuConfig, Clock, KnownCamera, Motion, ORDER, checks};
use crate::board::Target;
use crate::camera::{as_global_shutter, pose_of_target};
use crate::coverage::corners_by_cell;
use crate::residual_diagnosis::Field;
use crate::{Error, JoinProblem, PoorMotion};

/// Corners farther than this from the first pose are outliers from the start, pixels.
const FIRST_LIMIT_PX: f64 = 4.0;
/// Share of a camera's views that must have most of their corners within that.
const LEAST_FITTING: f64 = 0.5;
/// Corners a view needs.
const MIN_CORNERS: usize = 8;
/// Views a camera needs.
const MIN_VIEWS: usize = 10;
/// Instants at which two cameras must see the target to compare their poses with the rig's.
const MIN_SHARED: usize = 5;
/// Samples of the IMU needed.
const MIN_SAMPLES: usize = 200;
/// Motion before the first and after the last view, seconds.
const MARGIN_S: f64 = 0.1;
/// Share of a segment of the motion that samples must cover for its last control point to be known.
const LEAST_OF_SEGMENT: f64 = 0.1;

/// A camera's views with its own pose of the target in each.
pub(super) struct PosedViews {
    views: Vec<View>,
    /// Stamp and `target_from_camera`.
    pub poses: Vec<(f64, Se3)>,
    /// Median error of its corners, each view for itself, pixels.
    median_px: f64,
}

/// What a batch starts from.
#[derive(Clone, Copy)]
pub(super) struct Input<'a> {
    pub target: &'a Target,
    pub cameras: &'a [KnownCamera],
    pub imu: &'a [(Timestamp, ImuSample)],
    pub noise: &'a ImuNoiseModel,
    pub config: &'a CameraImuConfig,
}

impl State {
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
        let findings = saturation(&samples);
        let seen: Vec<PosedViews> = cameras
            .iter()
            .zip(readouts_s)
            .enumerate()
            .map(|(k, (known, readout_s))| look(input, known, *readout_s, k, origin))
            .collect::<Result<_, _>>()?;
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
                field: Field::zeros(),
                board: Bend::zeros(),
                alone_px: own.median_px,
                cells: corners_by_cell(
                    known.views.views.values().flatten(),
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
            spacing_s: config.knot_spacing_s,
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
            gyro_axes: GyroAxes::zeros(),
            accel_axes: AccelAxes::zeros(),
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

/// The samples in order of time, with the first one's as origin.
pub(super) fn samples_of(
    imu: &[(Timestamp, ImuSample)],
    cameras: &[KnownCamera],
) -> Result<(Timestamp, Vec<Sample>), Error> {
    let not_joined = |cause: JoinProblem| Error::NotJoined {
        first: cameras
            .first()
            .map_or_else(|| "no camera".into(), |c| c.views.name.clone()),
        second: "the IMU".into(),
        cause,
    };
    let mut imu: Vec<&(Timestamp, ImuSample)> = imu.iter().collect();
    // Of samples with one stamp the same one stays in whatever order they come.
    imu.sort_by(|a, b| {
        let values = |s: &ImuSample| [s.angular_velocity_rad_s, s.specific_force_m_s2];
        let (va, vb) = (values(&a.1), values(&b.1));
        let of_values = va.iter().flatten().zip(vb.iter().flatten());
        a.0.cmp(&b.0).then_with(|| {
            of_values.fold(std::cmp::Ordering::Equal, |o, (x, y)| {
                o.then(x.total_cmp(y))
            })
        })
    });
    imu.dedup_by_key(|s| s.0);
    let Some(first) = imu.first() else {
        return Err(not_joined(JoinProblem::NoSample));
    };
    let origin = first.0;
    let column = |value: &dyn Fn(&ImuSample) -> f64| {
        checks::saturated(&imu.iter().map(|s| value(&s.1)).collect::<Vec<_>>())
    };
    let gyro_ends = [0, 1, 2].map(|k| column(&|s| s.angular_velocity_rad_s[k]));
    let accel_ends = [0, 1, 2].map(|k| column(&|s| s.specific_force_m_s2[k]));
    let samples: Vec<Sample> = imu
        .iter()
        .enumerate()
        .map(|(n, (time, s))| Sample {
            time_s: time.secs_since(origin),
            gyro: Vector3::from(s.angular_velocity_rad_s),
            accel: Vector3::from(s.specific_force_m_s2),
            gyro_saturated: [0, 1, 2].map(|k| gyro_ends[k][n]),
            accel_saturated: [0, 1, 2].map(|k| accel_ends[k][n]),
        })
        .collect();
    let finite = |v: &Vector3<f64>| v.iter().all(|x| x.is_finite());
    if let Some(bad) = samples
        .iter()
        .find(|s| !finite(&s.gyro) || !finite(&s.accel))
    {
        return Err(not_joined(JoinProblem::BadSample { time_s: bad.time_s }));
    }
    Ok((origin, samples))
}

/// Leaves samples out that lie at the very beginning of the last segment: they say nothing of its last control point.
fn end_within_a_segment(samples: &mut Vec<Sample>, knots: &spline::UniformKnots) {
    let segments = |sample: &Sample| (sample.time_s - knots.start_s) / knots.spacing_s;
    let last = samples.last().map_or(0.0, segments);
    if last.fract() < LEAST_OF_SEGMENT {
        samples.retain(|s| segments(s) < last.floor());
    }
}

/// Axes at the end of their range.
fn saturation(samples: &[Sample]) -> Vec<Finding> {
    let mut findings = Vec::new();
    let names = ["x", "y", "z"];
    for (triad, at_end) in [
        (
            "gyroscope",
            (|s| s.gyro_saturated) as fn(&Sample) -> [bool; 3],
        ),
        ("accelerometer", |s| s.accel_saturated),
    ] {
        for (k, name) in names.iter().enumerate() {
            let mut ends = samples.iter().filter(|s| at_end(s)[k]);
            if let Some(first) = ends.next() {
                let count = ends.count() + 1;
                let what = format!(
                    "the {triad} saturates along {name}: {count} samples at the end of its range, the first at {:.2} s; they count for nothing",
                    first.time_s
                );
                let finding = Finding::new("saturation", Verdict::Warn, triad, what);
                let remedy = "move more gently or widen the range";
                findings.push(
                    finding
                        .value(count as f64, "samples")
                        .limit(Limit::AtMost(0.0))
                        .remedy(remedy),
                );
            }
        }
    }
    findings
}

/// A camera's views and its own poses, with corners that one pose explains. Where the shutter rolls the poses are those at which the middle
/// row was exposed; the corners stay where they were seen.
pub(super) fn look(
    input: &Input,
    known: &KnownCamera,
    readout_s: f64,
    camera: usize,
    origin: Timestamp,
) -> Result<PosedViews, Error> {
    let Input { target, config, .. } = *input;
    let still = as_global_shutter(&known.views, readout_s);
    let mut seen = PosedViews {
        views: Vec::new(),
        poses: Vec::new(),
        median_px: f64::INFINITY,
    };
    let mut errors = Vec::new();
    let step = config.view_step.max(1);
    let instants = known.views.views.iter().step_by(step);
    for (number, (instant, corners)) in instants.enumerate() {
        let stamp_s = Timestamp::from_nanos(*instant).secs_since(origin);
        let Some(mut at_once) = still.views.get(instant).cloned() else {
            continue;
        };
        at_once.retain(|c| c.index < target.corner_count());
        at_once.sort_by_key(|c| c.index);
        let Some(pose) = pose_of_target(target, &known.camera, &at_once) else {
            continue;
        };
        let pixels: BTreeMap<usize, Vector2<f64>> =
            corners.iter().map(|c| (c.index, c.pixel)).collect();
        let fitting: Vec<(Vector3<f64>, Vector2<f64>)> = at_once
            .iter()
            .filter_map(|corner| {
                let point = target.corner(corner.index);
                let seen = known.camera.project(&(pose * point));
                let error = seen.map_or(f64::INFINITY, |s| (s - corner.pixel).norm());
                errors.push(error);
                let pixel = pixels.get(&corner.index)?;
                (error < FIRST_LIMIT_PX).then_some((point, *pixel))
            })
            .collect();
        if fitting.len() < MIN_CORNERS {
            continue;
        }
        seen.poses.push((stamp_s, pose.inverse()));
        let every = config.holdout_every;
        seen.views.push(View {
            camera,
            stamp_s,
            inliers: vec![true; fitting.len()],
            corners: fitting,
            holdout: every > 1 && number % every == every / 2,
        });
    }
    if known.views.views.len() < MIN_VIEWS {
        return Err(Error::TargetNotSeen {
            camera: known.views.name.clone(),
            found: known.views.views.len(),
            images: known.views.images,
            needed: MIN_VIEWS,
            target: target.describe(),
        });
    }
    errors.sort_by(f64::total_cmp);
    let median_px = errors
        .get(errors.len() / 2)
        .copied()
        .unwrap_or(f64::INFINITY);
    let fitting =
        seen.views.len() as f64 >= LEAST_FITTING * known.views.views.len() as f64 / step as f64;
    if !(median_px < FIRST_LIMIT_PX && fitting) {
        return Err(Error::DoesNotFit {
            camera: known.views.name.clone(),
            rms_px: median_px,
            target: target.describe(),
            model: known.camera.lens.model().name(),
        });
    }
    seen.median_px = median_px;
    Ok(seen)
}

/// Leaves out samples far from all views.
fn crop(samples: &mut Vec<Sample>, seen: &[PosedViews], max_offset_s: f64) {
    let stamps = || seen.iter().flat_map(|s| s.poses.iter().map(|p| p.0));
    let start_s = stamps().fold(f64::INFINITY, f64::min) - max_offset_s - MARGIN_S;
    let end_s = stamps().fold(f64::NEG_INFINITY, f64::max) + max_offset_s + MARGIN_S;
    samples.retain(|s| s.time_s >= start_s && s.time_s <= end_s);
}

/// Spread of angular rate and specific force along each axis.
fn excitation(samples: &[Sample]) -> [Vector3<f64>; 2] {
    let spread = |value: fn(&Sample) -> Vector3<f64>| {
        let n = samples.len().max(1) as f64;
        let mean = samples.iter().map(value).sum::<Vector3<f64>>() / n;
        let squares: Vector3<f64> = samples
            .iter()
            .map(|s| (value(s) - mean).map(|x| x * x))
            .sum();
        (squares / n).map(f64::sqrt)
    };
    [spread(|s| s.gyro), spread(|s| s.accel)]
}

/// An error where an axis is not turned about.
fn check_rotation(rate_rms: &Vector3<f64>, config: &CameraImuConfig) -> Result<(), Error> {
    let axes: Vec<(&str, f64)> = ["x", "y", "z"]
        .into_iter()
        .zip(rate_rms.iter().copied())
        .filter(|(_, rate)| !(*rate >= config.min_rate_rad_s))
        .collect();
    if axes.is_empty() {
        return Ok(());
    }
    let poor = PoorMotion::FewTurns {
        axes,
        needed_rad_s: config.min_rate_rad_s,
    };
    Err(poor.into())
}

/// Compares the poses of two cameras to each other, seen at shared stamps, with the rig's.
fn compare(
    first: &KnownCamera,
    seen_first: &PosedViews,
    other: &KnownCamera,
    seen_other: &PosedViews,
    other_from_first: &Se3,
) -> Result<(), Error> {
    let shared: Vec<Se3> = seen_other
        .poses
        .iter()
        .filter_map(|(stamp_s, target_from_other)| {
            let k = seen_first
                .poses
                .binary_search_by(|p| p.0.total_cmp(stamp_s))
                .ok()?;
            Some(target_from_other.inverse() * seen_first.poses[k].1)
        })
        .collect();
    if shared.len() < MIN_SHARED {
        return Ok(());
    }
    match crate::camera::most_central(&shared) {
        Some(seen) => checks::agree(
            &first.views.name,
            &other.views.name,
            &seen,
            other_from_first,
        ),
        None => Ok(()),
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

/// Time between samples: the median, so that gaps do not count.
fn interval_s(samples: &[Sample]) -> f64 {
    let mut intervals: Vec<f64> = samples
        .windows(2)
        .map(|w| w[1].time_s - w[0].time_s)
        .collect();
    intervals.sort_by(f64::total_cmp);
    intervals.get(intervals.len() / 2).copied().unwrap_or(0.005)
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
