//! Turns from scan to scan, as gyroscope and scans have them.

use lsfb_geometry::{IntegratedGyro, StampedPose, Vector3, so3};
use lsfb_perception::statistics::median;
use lsfb_types::{ImuSample, Stamped, Timestamp};

/// Length of a span, seconds, at least; and at most, where scans come often: longer ones have gaps.
const LEAST_S: f64 = 0.45;
const MOST_S: f64 = 1.5;
/// Where scans are rarer, a span may be so many times what is usual: one scan between may be lost.
const USUAL_TIMES: f64 = 2.2;
/// No gyroscope is known to be held longer, seconds.
const MOST_AT_ALL_S: f64 = 12.0;
/// Fewer spans tell nothing.
pub(super) const MIN_SPANS: usize = 8;
/// More tell no more.
const MAX_SPANS: usize = 1000;

/// One span of the walk.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turn {
    /// The rotation from its begin to its end, in the rig, radians.
    pub by_gyro: Vector3<f64>,
    pub by_scans: Vector3<f64>,
    pub duration_s: f64,
}

/// The spans of a walk.
#[derive(Clone, Debug)]
pub(super) struct Turns {
    start: Timestamp,
    gyro: IntegratedGyro,
    /// Of rates with the other sign.
    reversed: IntegratedGyro,
    spans: Vec<[StampedPose; 2]>,
}

impl Turns {
    /// `None` where there are too few.
    pub fn new(by_scans: &[StampedPose], samples: &[Stamped<ImuSample>]) -> Option<Self> {
        let start = samples.first()?.time;
        let integrated = |sign: f64| {
            IntegratedGyro::new(samples.iter().map(|s| {
                let rate = Vector3::from(s.sample.angular_velocity_rad_s) * sign;
                (s.time.secs_since(start), rate)
            }))
        };
        let spans = spans(by_scans);
        (spans.len() >= MIN_SPANS).then(|| Self {
            start,
            gyro: integrated(1.0),
            reversed: integrated(-1.0),
            spans,
        })
    }

    /// If the IMU's stamps are so much too late, seconds.
    pub fn late(&self, late_s: f64) -> Vec<Turn> {
        self.of(&self.gyro, late_s, 1.0)
    }

    /// As an IMU has them whose axes are mirrored, but for the mirror: a mirror changes which way round axes are turned about, so that rates that change
    /// their axis add up to another rotation.
    pub fn mirrored(&self) -> Vec<Turn> {
        self.of(&self.reversed, 0.0, -1.0)
    }

    fn of(&self, gyro: &IntegratedGyro, late_s: f64, sign: f64) -> Vec<Turn> {
        let turn = |[begin, end]: &[StampedPose; 2]| {
            let at_s = |pose: &StampedPose| pose.time.secs_since(self.start) + late_s;
            let duration_s = end.time.secs_since(begin.time);
            let rate = gyro.mean_rate(at_s(begin), at_s(end))?;
            Some(Turn {
                by_gyro: rate * (sign * duration_s),
                by_scans: so3::local(&begin.world_from_rig.rotation, &end.world_from_rig.rotation),
                duration_s,
            })
        };
        self.spans.iter().filter_map(turn).collect()
    }
}

/// The longest span that has no gap in it, seconds.
pub(super) fn longest_s(by_scans: &[StampedPose]) -> f64 {
    let pairs = by_scans.windows(2);
    let intervals_s = pairs.map(|pair| pair[1].time.secs_since(pair[0].time));
    let usual_s = median(intervals_s.collect()).unwrap_or(0.0);
    (USUAL_TIMES * usual_s).clamp(MOST_S, MOST_AT_ALL_S)
}

fn spans(by_scans: &[StampedPose]) -> Vec<[StampedPose; 2]> {
    let longest_s = longest_s(by_scans);
    let mut spans = Vec::new();
    let mut from: Option<&StampedPose> = None;
    for pose in by_scans {
        let Some(begin) = from else {
            from = Some(pose);
            continue;
        };
        let duration_s = pose.time.secs_since(begin.time);
        if duration_s < LEAST_S {
            continue;
        }
        from = Some(pose);
        if duration_s <= longest_s {
            spans.push([*begin, *pose]);
        }
    }
    let every = spans.len().div_ceil(MAX_SPANS).max(1);
    spans.into_iter().step_by(every).collect()
}

/// What is left of each turn by a map from the gyroscope's to the scans', once the bias that most of them agree on is taken out, radians.
pub(super) fn residuals(
    turns: &[Turn],
    scans_from_gyro: impl Fn(&Vector3<f64>) -> Vector3<f64>,
) -> Vec<Vector3<f64>> {
    let off = |t: &Turn| t.by_scans - scans_from_gyro(&t.by_gyro);
    let rates: Vec<_> = turns.iter().map(|t| off(t) / t.duration_s).collect();
    let usual = |axis: usize| median(rates.iter().map(|r| r[axis]).collect()).unwrap_or(0.0);
    let bias = Vector3::new(usual(0), usual(1), usual(2));
    turns.iter().map(|t| off(t) - bias * t.duration_s).collect()
}

/// Standard deviation of a component, from the median size of all that are measured: those that are not are 0.
pub(super) fn scatter(residuals: &[Vector3<f64>]) -> f64 {
    let sizes = residuals
        .iter()
        .flat_map(|r| [r.x.abs(), r.y.abs(), r.z.abs()])
        .filter(|size| *size > 0.0);
    // 1.4826: from the median to the standard deviation of what is normal.
    1.4826 * median(sizes.collect()).unwrap_or(0.0)
}

/// Weight of a residual of which each component has that standard deviation: what does not fit loses it (Cauchy, of three components).
pub(super) fn weight(residual: &Vector3<f64>, sigma: f64) -> f64 {
    1.0 / (sigma * sigma + residual.norm_squared() / 9.0)
}

/// The squares of a residual in its standard deviation; of large ones less and less, as [`weight`] has it.
pub(super) fn cost(residual: &Vector3<f64>, sigma: f64) -> f64 {
    9.0 * (residual.norm_squared() / (9.0 * sigma * sigma)).ln_1p()
}
