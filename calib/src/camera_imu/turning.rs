//! How a camera turned between neighbouring views, beside the IMU's integrated angular velocity: clocks and a first orientation.

use lsfb_geometry::align::{Scale, umeyama};
use lsfb_geometry::{Se3, UnitQuaternion, Vector3, so3};

use super::CameraImuConfig;
use super::start::Sample;
use crate::Error;

/// Views closer than this give an angular velocity, seconds.
const NEIGHBOURS_S: f64 = 0.2;
/// Angular velocities needed.
const MIN_RATES: usize = 30;
/// Angular velocities needed to ask for a drift.
const MIN_RATES_OF_PART: usize = 60;
/// Step of the search for the offset, seconds.
const OFFSET_STEP_S: f64 = 0.002;
/// Share of the spread of angular rates that must agree.
const LEAST_AGREEMENT: f64 = 0.7;

pub(super) struct Turning {
    /// Start, end, mean angular velocity in the camera.
    seen: Vec<(f64, f64, Vector3<f64>)>,
    times_s: Vec<f64>,
    integral: Vec<Vector3<f64>>,
    /// Number of samples before each that are at the end of the gyroscope's range.
    saturated: Vec<usize>,
}

/// What turning alone says of a camera.
pub(super) struct Turned {
    pub offset_s: f64,
    pub camera_from_rig: UnitQuaternion<f64>,
}

impl Turning {
    /// `poses`: stamps and `target_from_camera`.
    pub fn new(samples: &[Sample], poses: &[(f64, Se3)]) -> Self {
        let mut integral = vec![Vector3::zeros()];
        let mut sum = Vector3::zeros();
        for w in samples.windows(2) {
            sum += (w[0].gyro + w[1].gyro) * (0.5 * (w[1].time_s - w[0].time_s));
            integral.push(sum);
        }
        let mut count = 0;
        let saturated = samples
            .iter()
            .map(|s| {
                count += usize::from(s.gyro_saturated.contains(&true));
                count
            })
            .collect();
        let last_s = samples.last().map_or(0.0, |s| s.time_s);
        let seen = poses
            .windows(2)
            .filter(|w| {
                let apart_s = w[1].0 - w[0].0;
                apart_s > 0.0 && apart_s < NEIGHBOURS_S && w[0].0 > 0.0 && w[1].0 < last_s
            })
            .map(|w| {
                let turn = so3::log(&(w[0].1.rotation.inverse() * w[1].1.rotation));
                (w[0].0, w[1].0, turn / (w[1].0 - w[0].0))
            });
        Self {
            seen: seen.collect(),
            times_s: samples.iter().map(|s| s.time_s).collect(),
            integral,
            saturated,
        }
    }

    /// Offset and orientation of the camera named `camera`; an error where the clocks cannot belong together.
    pub fn solve(&self, camera: &str, config: &CameraImuConfig) -> Result<Turned, Error> {
        let not_joined = |problem: String| Error::NotJoined {
            first: camera.to_owned(),
            second: "the IMU".into(),
            problem,
        };
        if self.seen.len() < MIN_RATES {
            let length_s = self.times_s.last().copied().unwrap_or(0.0);
            return Err(not_joined(format!(
                "{} pairs of neighbouring views lie within the IMU's {length_s:.1} s, {MIN_RATES} are needed: check the clocks",
                self.seen.len()
            )));
        }
        let all = 0..self.seen.len();
        let offset_s = self.offset_s(all.clone(), config.max_offset_s);
        let agreement = self.agreement(all, offset_s);
        if !(agreement >= LEAST_AGREEMENT) {
            return Err(not_joined(format!(
                "camera and gyroscope do not turn alike at any offset within {} s ({:.0} % of their turning agrees): their clocks are not synchronised, jump, or one of them is another device's",
                config.max_offset_s,
                100.0 * agreement.max(0.0)
            )));
        }
        if offset_s.abs() > config.max_offset_s - 2.0 * OFFSET_STEP_S {
            return Err(not_joined(format!(
                "their clocks differ by more than {} s: raise max_offset_s or check the stamps",
                config.max_offset_s
            )));
        }
        if self.seen.len() >= 2 * MIN_RATES_OF_PART {
            let half = self.seen.len() / 2;
            let [start_s, end_s] = [0..half, half..self.seen.len()]
                .map(|part| self.offset_s(part, config.max_offset_s));
            // Halves are half the recording apart: over all of it the drift is twice that.
            if 2.0 * (end_s - start_s).abs() > config.max_drift_s + 2.0 * OFFSET_STEP_S {
                return Err(not_joined(format!(
                    "their clocks are not synchronised: the offset is {:.1} ms in the first half and {:.1} ms in the second",
                    start_s * 1e3,
                    end_s * 1e3
                )));
            }
        }
        let (camera_rates, rig_rates) = self.pairs(0..self.seen.len(), offset_s);
        let aligned =
            umeyama(&rig_rates, &camera_rates, Scale::Fixed).ok_or_else(|| Error::Motion {
                problem: "it turns about one axis alone: turn the rig about all three".into(),
            })?;
        Ok(Turned {
            offset_s,
            camera_from_rig: aligned.target_from_source.rotation,
        })
    }

    /// The integral up to a time, and how many samples before its end say nothing.
    fn integral_at(&self, time_s: f64) -> Option<(Vector3<f64>, usize)> {
        let next = self.times_s.partition_point(|t| *t < time_s);
        let (end, start) = (
            *self.times_s.get(next)?,
            *self.times_s.get(next.checked_sub(1)?)?,
        );
        let share = (time_s - start) / (end - start);
        let turned =
            self.integral[next - 1] + (self.integral[next] - self.integral[next - 1]) * share;
        Some((turned, self.saturated[next]))
    }

    /// Angular velocities of camera and rig if the camera's clock has this offset.
    fn pairs(
        &self,
        part: std::ops::Range<usize>,
        offset_s: f64,
    ) -> (Vec<Vector3<f64>>, Vec<Vector3<f64>>) {
        self.seen[part]
            .iter()
            .filter_map(|(start, end, rate)| {
                let from = self.integral_at(start + offset_s)?;
                let to = self.integral_at(end + offset_s)?;
                (from.1 == to.1).then(|| (*rate, (to.0 - from.0) / (end - start)))
            })
            .unzip()
    }

    /// The offset at which the norms of both differ least, finer than the step by a parabola.
    fn offset_s(&self, part: std::ops::Range<usize>, largest_s: f64) -> f64 {
        let cost = |offset_s: f64| {
            let (camera, rig) = self.pairs(part.clone(), offset_s);
            if camera.len() < MIN_RATES {
                return f64::INFINITY;
            }
            let differences = camera
                .iter()
                .zip(&rig)
                .map(|(c, r)| (c.norm() - r.norm()).abs());
            differences.sum::<f64>() / camera.len() as f64
        };
        let steps = (largest_s / OFFSET_STEP_S).ceil() as i32;
        let costs: Vec<f64> = (-steps..=steps)
            .map(|k| cost(f64::from(k) * OFFSET_STEP_S))
            .collect();
        let best = (0..costs.len())
            .min_by(|a, b| costs[*a].total_cmp(&costs[*b]))
            .unwrap_or_default();
        let mut at = best as f64 - f64::from(steps);
        if let Some(&[before, here, after]) = costs.get(best.wrapping_sub(1)..best.wrapping_add(2))
        {
            let bend = before - 2.0 * here + after;
            if bend.is_finite() && bend > 0.0 {
                at += (0.5 * (before - after) / bend).clamp(-0.5, 0.5);
            }
        }
        at * OFFSET_STEP_S
    }

    /// Share of the spread of the rig's rates that the camera's have as well.
    fn agreement(&self, part: std::ops::Range<usize>, offset_s: f64) -> f64 {
        let (camera, rig) = self.pairs(part, offset_s);
        let n = rig.len().max(1) as f64;
        let mean = rig.iter().map(|r| r.norm()).sum::<f64>() / n;
        let spread: f64 = rig.iter().map(|r| (r.norm() - mean).abs()).sum();
        let differs: f64 = camera
            .iter()
            .zip(&rig)
            .map(|(c, r)| (c.norm() - r.norm()).abs())
            .sum();
        1.0 - differs / spread.max(1e-12)
    }
}
