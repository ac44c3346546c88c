//! Samples of the IMU as the batch takes them: in order, near the views, with what they say of the motion.

use lsfb_geometry::{Vector3, spline};
use lsfb_types::{Finding, ImuSample, Limit, Timestamp, Verdict, median};

use super::posed_views::PosedViews;
use super::state::Sample;
use super::{CameraImuConfig, KnownCamera, checks};
use crate::{Error, JoinProblem, PoorMotion};

/// Motion before the first and after the last view, seconds.
pub(super) const MARGIN_S: f64 = 0.1;
/// Share of the samples that may have the stamp of another one: a message that came twice.
const MOST_REPEATED: f64 = 0.01;
/// Share of a segment of the motion that samples must cover for its last control point to be known.
const LEAST_OF_SEGMENT: f64 = 0.1;

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
    let all = imu.len();
    imu.dedup_by_key(|s| s.0);
    let repeated = all - imu.len();
    if repeated as f64 > MOST_REPEATED * all as f64 {
        return Err(not_joined(JoinProblem::RepeatedStamps { repeated, all }));
    }
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
pub(super) fn end_within_a_segment(samples: &mut Vec<Sample>, knots: &spline::UniformKnots) {
    let segments = |sample: &Sample| (sample.time_s - knots.start_s) / knots.spacing_s;
    let last = samples.last().map_or(0.0, segments);
    if last.fract() < LEAST_OF_SEGMENT {
        samples.retain(|s| segments(s) < last.floor());
    }
}

/// Axes at the end of their range.
pub(super) fn saturation(samples: &[Sample]) -> Vec<Finding> {
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
                    "the {triad} saturates along {name}: {count} samples at the end of its range, the first at {:.2} s; they are not used",
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

/// Leaves out samples far from all views.
pub(super) fn crop(samples: &mut Vec<Sample>, seen: &[PosedViews], max_offset_s: f64) {
    let stamps = || seen.iter().flat_map(|s| s.poses.iter().map(|p| p.0));
    let start_s = stamps().fold(f64::INFINITY, f64::min) - max_offset_s - MARGIN_S;
    let end_s = stamps().fold(f64::NEG_INFINITY, f64::max) + max_offset_s + MARGIN_S;
    samples.retain(|s| s.time_s >= start_s && s.time_s <= end_s);
}

/// Spread of angular rate and specific force along each axis.
pub(super) fn excitation(samples: &[Sample]) -> [Vector3<f64>; 2] {
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
pub(super) fn check_rotation(
    rate_rms: &Vector3<f64>,
    config: &CameraImuConfig,
) -> Result<(), Error> {
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

/// Time between samples: the median, so that gaps do not count.
pub(super) fn interval_s(samples: &[Sample]) -> f64 {
    let intervals: Vec<f64> = samples
        .windows(2)
        .map(|w| w[1].time_s - w[0].time_s)
        .collect();
    median(intervals).unwrap_or(0.005)
}
