//! A recording at rest as six series of evenly spaced samples.

use lsfb_perception::statistics::median;
use lsfb_types::{Finding, ImuSample, Limit, Timestamp, Verdict};

use super::ImuNoiseConfig;
use crate::{Error, NoRest};

/// Share of samples that may be missing before it is an error.
const MOST_MISSING: f64 = 0.01;

/// Six series, gyroscope first.
pub(super) struct Log {
    pub axes: [Vec<f64>; 6],
    pub interval_s: f64,
    pub duration_s: f64,
    pub findings: Vec<Finding>,
}

fn value(sample: &ImuSample, axis: usize) -> f64 {
    match axis {
        0..3 => sample.angular_velocity_rad_s[axis],
        _ => sample.specific_force_m_s2[axis - 3],
    }
}

impl Log {
    pub fn new(imu: &[(Timestamp, ImuSample)], config: &ImuNoiseConfig) -> Result<Self, Error> {
        let mut imu: Vec<&(Timestamp, ImuSample)> = imu.iter().collect();
        imu.sort_by_key(|s| s.0);
        let all = imu.len();
        imu.dedup_by_key(|s| s.0);
        let repeated = all - imu.len();
        if repeated as f64 > MOST_MISSING * all as f64 {
            return Err(NoRest::Repeated { repeated, all }.into());
        }
        let (Some(first), Some(last)) = (imu.first(), imu.last()) else {
            return Err(NoRest::NoSample.into());
        };
        let duration_s = last.0.secs_since(first.0);
        if !(duration_s >= config.min_duration_s) {
            let short = NoRest::Short {
                length_s: duration_s,
                needed_s: config.min_duration_s,
            };
            return Err(short.into());
        }
        let intervals: Vec<f64> = imu.windows(2).map(|w| w[1].0.secs_since(w[0].0)).collect();
        let median_s = median(intervals.clone()).unwrap_or(f64::INFINITY);
        let missing: f64 = intervals
            .iter()
            .map(|i| (i / median_s).round() - 1.0)
            .filter(|n| *n > 0.0)
            .sum::<f64>()
            // The sum of nothing is −0.
            .abs();
        let all = imu.len() as f64 + missing;
        if missing > MOST_MISSING * all {
            return Err(NoRest::Missing { missing, all }.into());
        }
        let text = format!("{missing:.0} of {all:.0} samples are missing");
        let verdict = Verdict::Warn.unless(missing == 0.0);
        let samples = Finding::new("missing-samples", verdict, "samples", text)
            .value(missing, "samples")
            .limit(Limit::AtMost(0.0))
            .remedy("find out why they are lost with `lsfb doctor`: they make the clusters uneven");
        let axes: [Vec<f64>; 6] =
            std::array::from_fn(|axis| imu.iter().map(|s| value(&s.1, axis)).collect());
        if let Some(index) = axes
            .iter()
            .flat_map(|a| a.iter().position(|v| !v.is_finite()))
            .min()
        {
            return Err(NoRest::BadSample { index }.into());
        }
        let interval_s = duration_s / (imu.len() as f64 - 1.0 + missing);
        if let Some(after_s) = first_motion(&axes, interval_s, config) {
            return Err(NoRest::Moved { after_s }.into());
        }
        Ok(Self {
            axes,
            interval_s,
            duration_s,
            findings: vec![samples],
        })
    }
}

/// Start of the first second in which an axis spreads far more than it does in most.
fn first_motion(axes: &[Vec<f64>; 6], interval_s: f64, config: &ImuNoiseConfig) -> Option<f64> {
    let length = ((1.0 / interval_s).round() as usize).max(2);
    axes.iter()
        .filter_map(|samples| {
            let spreads: Vec<f64> = samples
                .chunks_exact(length)
                .map(|second| {
                    let n = length as f64;
                    let mean = second.iter().sum::<f64>() / n;
                    (second.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n).sqrt()
                })
                .collect();
            let typical = median(spreads.clone())?;
            let far = |s: &f64| typical > 0.0 && *s > config.motion_ratio * typical;
            spreads.iter().position(far)
        })
        .min()
        .map(|k| (k * length) as f64 * interval_s)
}
