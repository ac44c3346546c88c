//! A trajectory beside a gyroscope on the same body: how the gyroscope is turned on it, its bias, and the offset of the clocks.

use lsfb_geometry::{IntegratedGyro, Matrix3, Se3, StampedPose, UnitQuaternion, Vector3, so3};
use lsfb_types::Timestamp;
use serde::Serialize;

use super::HandEyeConfig;
use super::continuous::Continuous;
use super::correlation::correlate;
use crate::Error;

/// Rates are compared where this much of them lies around, seconds: white noise averages out.
const WINDOW_SECS: f64 = 0.05;
/// Turns about the second axis that are needed, rad/s rms.
const LEAST_SECOND_RATE: f64 = 0.02;
/// Halvings of the interval around the best offset.
const REFINEMENTS: usize = 40;

/// What a gyroscope said.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroSample {
    /// When.
    pub time: Timestamp,
    /// Angular velocity in its axes, rad/s.
    pub rate_rad_s: Vector3<f64>,
}

/// How a gyroscope sits on a body.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GyroAlignment {
    /// `gyroscope_from_body`: rotation x y z w.
    pub rotation_xyzw: [f64; 4],
    /// What must be added to the trajectory's stamps to have the gyroscope's, seconds.
    pub offset_secs: f64,
    /// What the gyroscope says at rest, rad/s.
    pub bias_rad_s: [f64; 3],
    /// Root mean square of the rates' difference, rad/s.
    pub rms_rad_s: f64,
    /// Correlation of the angular speeds, by which the offset was found first.
    pub correlation: f64,
}

/// Aligns the rates of a trajectory's body with those of a gyroscope; both in order of time.
pub fn align_gyroscope(
    poses: &[StampedPose],
    samples: &[GyroSample],
    config: &HandEyeConfig,
) -> Result<GyroAlignment, Error> {
    let (Some(first), false) = (poses.first(), samples.is_empty()) else {
        return Err(Error::TooFewPoses {
            role: "estimate",
            poses: poses.len().min(samples.len()),
            needed: 1,
        });
    };
    let body = Continuous::new(poses, first.time);
    let gyroscope = Continuous::new(&integrated(samples, first.time), first.time);
    let found = correlate(
        &body,
        &gyroscope,
        config.offset_guess_secs,
        config.search_secs,
    )?;
    // Golden sections: the difference of the rates has one valley within a tenth of a second of the best correlation.
    let golden = 0.5 * (5.0f64.sqrt() - 1.0);
    let (mut low, mut high) = (found.offset_secs - 0.1, found.offset_secs + 0.1);
    for _ in 0..REFINEMENTS {
        let (left, right) = (high - golden * (high - low), low + golden * (high - low));
        match align_rates(&body, &gyroscope, left)?.rms_rad_s
            < align_rates(&body, &gyroscope, right)?.rms_rad_s
        {
            true => high = right,
            false => low = left,
        }
    }
    let offset_secs = 0.5 * (low + high);
    let best = align_rates(&body, &gyroscope, offset_secs)?;
    Ok(GyroAlignment {
        rotation_xyzw: best.rotation.coords.into(),
        offset_secs,
        bias_rad_s: best.bias.into(),
        rms_rad_s: best.rms_rad_s,
        correlation: found.correlation,
    })
}

/// Orientations that follow from the rates, without a place.
fn integrated(samples: &[GyroSample], base: Timestamp) -> Vec<StampedPose> {
    let rates = samples
        .iter()
        .map(|s| (s.time.secs_since(base), s.rate_rad_s));
    let gyro = IntegratedGyro::new(rates);
    let turned = gyro.rotations().map(|(_, rotation)| rotation);
    let pose = |(sample, rotation): (&GyroSample, _)| StampedPose {
        time: sample.time,
        world_from_rig: Se3::new(rotation, Vector3::zeros()),
    };
    samples.iter().zip(turned).map(pose).collect()
}

struct AlignedRates {
    rotation: UnitQuaternion<f64>,
    bias: Vector3<f64>,
    rms_rad_s: f64,
}

/// The best turn and bias at an offset (Kabsch on the rates without their means).
fn align_rates(
    body: &Continuous,
    gyroscope: &Continuous,
    offset_secs: f64,
) -> Result<AlignedRates, Error> {
    let rate = |of: &Continuous, secs: f64| {
        let from = of.at(secs - 0.5 * WINDOW_SECS)?.rotation;
        let to = of.at(secs + 0.5 * WINDOW_SECS)?.rotation;
        Some(so3::local(&from, &to) / WINDOW_SECS)
    };
    let [start, end] = body.span_secs().unwrap_or([0.0, 0.0]);
    let count = ((end - start) / WINDOW_SECS) as usize;
    let rates: Vec<(Vector3<f64>, Vector3<f64>)> = (0..count)
        .filter_map(|i| {
            let secs = start + i as f64 * WINDOW_SECS;
            Some((rate(body, secs)?, rate(gyroscope, secs + offset_secs)?))
        })
        .collect();
    let n = rates.len().max(1) as f64;
    let mean = rates
        .iter()
        .fold((Vector3::zeros(), Vector3::zeros()), |s, r| {
            (s.0 + r.0, s.1 + r.1)
        });
    let (body_mean, gyro_mean) = (mean.0 / n, mean.1 / n);
    let mut crossed = Matrix3::zeros();
    for (a, b) in &rates {
        crossed += (b - gyro_mean) * (a - body_mean).transpose();
    }
    let mut sizes: Vec<f64> = (crossed / n).singular_values().iter().copied().collect();
    sizes.sort_by(|a, b| b.total_cmp(a));
    if !(sizes[1] >= LEAST_SECOND_RATE * LEAST_SECOND_RATE) {
        return Err(Error::OneAxis {
            first_deg: sizes[0].sqrt().to_degrees() * WINDOW_SECS,
            second_deg: sizes[1].sqrt().to_degrees() * WINDOW_SECS,
        });
    }
    let rotation = so3::nearest(&crossed).ok_or(Error::Degenerate)?;
    let bias = gyro_mean - rotation * body_mean;
    let squares: f64 = rates
        .iter()
        .map(|(a, b)| (b - bias - rotation * a).norm_squared())
        .sum();
    Ok(AlignedRates {
        rotation,
        bias,
        rms_rad_s: (squares / n).sqrt(),
    })
}
