//! How a camera turned between neighbouring views, beside the IMU's integrated angular velocity: clocks and a first orientation.

use lsfb_geometry::IntegratedGyro;
use lsfb_geometry::align::{Scale, umeyama};
use lsfb_geometry::{Se3, UnitQuaternion, Vector3, so3};

use super::CameraImuConfig;
use super::state::Sample;
use crate::{BadImu, Error, JoinProblem, PoorMotion};

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
/// Offsets that are tried where none of the allowed ones fits, and their step, seconds.
const FAR_OFFSET_S: f64 = 10.0;
const FAR_STEP_S: f64 = 0.01;
/// Share of the views that must then have samples.
const FAR_VIEWS: f64 = 1.0 / 3.0;
/// Share of the turning that may be about other axes than the camera's.
const OTHER_AXES: f64 = 0.5;

#[derive(Clone)]
pub(super) struct GyroAlignment {
    /// Start, end, mean angular velocity in the camera.
    seen: Vec<(f64, f64, Vector3<f64>)>,
    gyro: IntegratedGyro,
    /// Number of samples before each that are at the end of the gyroscope's range.
    saturated: Vec<usize>,
}

/// What turning alone says of a camera.
pub(super) struct Aligned {
    pub offset_s: f64,
    pub camera_from_rig: UnitQuaternion<f64>,
    /// Share of the turning that camera and gyroscope have in common.
    pub agreement: f64,
}

impl GyroAlignment {
    /// `poses`: stamps and `target_from_camera`.
    pub fn new(samples: &[Sample], poses: &[(f64, Se3)]) -> Self {
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
                let turn = so3::local(&w[0].1.rotation, &w[1].1.rotation);
                (w[0].0, w[1].0, turn / (w[1].0 - w[0].0))
            });
        Self {
            seen: seen.collect(),
            gyro: IntegratedGyro::new(samples.iter().map(|s| (s.time_s, s.gyro))),
            saturated,
        }
    }

    /// Offset and orientation of the camera named `camera`; an error where the clocks cannot belong together.
    pub fn solve(&self, camera: &str, config: &CameraImuConfig) -> Result<Aligned, Error> {
        let not_joined = |cause: JoinProblem| Error::NotJoined {
            first: camera.to_owned(),
            second: "the IMU".into(),
            cause,
        };
        if self.seen.len() < MIN_RATES {
            let length_s = self.gyro.span_s().map_or(0.0, |span| span[1]);
            return Err(not_joined(JoinProblem::FewRates {
                pairs: self.seen.len(),
                length_s,
                needed: MIN_RATES,
            }));
        }
        let all = 0..self.seen.len();
        let offset_s = self.offset_s(all.clone(), config.max_offset_s, OFFSET_STEP_S);
        let agreement = self.agreement(all, offset_s);
        let at_the_end = offset_s.abs() > config.max_offset_s - 2.0 * OFFSET_STEP_S;
        if !(agreement >= LEAST_AGREEMENT) || at_the_end {
            return Err(not_joined(self.why_apart(agreement, config)));
        }
        if self.seen.len() >= 2 * MIN_RATES_OF_PART {
            let half = self.seen.len() / 2;
            let [first_half_s, second_half_s] = [0..half, half..self.seen.len()]
                .map(|part| self.offset_s(part, config.max_offset_s, OFFSET_STEP_S));
            // Halves are half the recording apart: over all of it the drift is twice that.
            if 2.0 * (second_half_s - first_half_s).abs() > config.max_drift_s + 2.0 * OFFSET_STEP_S
            {
                return Err(not_joined(JoinProblem::ClocksDrift {
                    first_half_s,
                    second_half_s,
                }));
            }
        }
        let (camera_rates, rig_rates) = self.pairs(0..self.seen.len(), offset_s);
        let aligned =
            umeyama(&rig_rates, &camera_rates, Scale::Fixed).ok_or(PoorMotion::OneAxis)?;
        let camera_from_rig = aligned.target_from_source.rotation;
        if about_other_axes(&camera_rates, &rig_rates, &camera_from_rig) > OTHER_AXES {
            let mirrored: Vec<Vector3<f64>> = camera_rates.iter().map(|c| -c).collect();
            let left_handed = umeyama(&rig_rates, &mirrored, Scale::Fixed).is_some_and(|a| {
                let turn = a.target_from_source.rotation;
                about_other_axes(&mirrored, &rig_rates, &turn) < OTHER_AXES
            });
            let camera = camera.to_owned();
            let bad = match left_handed {
                true => BadImu::LeftHanded { camera },
                false => BadImu::OtherAxes { camera },
            };
            return Err(bad.into());
        }
        Ok(Aligned {
            offset_s,
            camera_from_rig,
            agreement,
        })
    }

    /// Why no offset that is allowed makes camera and gyroscope turn alike.
    fn why_apart(&self, agreement: f64, config: &CameraImuConfig) -> JoinProblem {
        let all = 0..self.seen.len();
        // No offset fits samples in degrees, so that the best one is any; the camera's rates in degrees are tried instead.
        let in_degrees = Self {
            seen: self
                .seen
                .iter()
                .map(|(start, end, rate)| (*start, *end, rate * 1f64.to_degrees()))
                .collect(),
            ..self.clone()
        };
        let offset_s = in_degrees.offset_s(all.clone(), config.max_offset_s, OFFSET_STEP_S);
        if in_degrees.agreement(all.clone(), offset_s) >= LEAST_AGREEMENT {
            return JoinProblem::InDegrees;
        }
        let far_s = self.offset_s(all.clone(), FAR_OFFSET_S, FAR_STEP_S);
        let (camera, _) = self.pairs(all.clone(), far_s);
        let enough = camera.len() as f64 > FAR_VIEWS * self.seen.len() as f64;
        if enough && self.agreement(all.clone(), far_s) >= LEAST_AGREEMENT {
            return JoinProblem::FarOffset {
                offset_s: far_s,
                largest_s: config.max_offset_s,
            };
        }
        JoinProblem::TurnApart {
            within_s: FAR_OFFSET_S,
            agreement,
        }
    }

    /// The integral up to a time, and how many samples before its end say nothing.
    fn integral_at(&self, time_s: f64) -> Option<(Vector3<f64>, usize)> {
        let before = self.gyro.sample_before(time_s)?;
        Some((self.gyro.angle(time_s)?, self.saturated[before + 1]))
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
    fn offset_s(&self, part: std::ops::Range<usize>, largest_s: f64, step_s: f64) -> f64 {
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
        let steps = (largest_s / step_s).ceil() as i32;
        let costs: Vec<f64> = (-steps..=steps)
            .map(|k| cost(f64::from(k) * step_s))
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
        at * step_s
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

/// Share of a camera's turning that its mounting does not explain.
fn about_other_axes(
    camera: &[Vector3<f64>],
    rig: &[Vector3<f64>],
    camera_from_rig: &UnitQuaternion<f64>,
) -> f64 {
    let mean =
        |rates: &[Vector3<f64>]| rates.iter().sum::<Vector3<f64>>() / rates.len().max(1) as f64;
    let (camera_mean, rig_mean) = (mean(camera), mean(rig));
    let (mut missed, mut all) = (0.0, 0.0);
    for (c, r) in camera.iter().zip(rig) {
        let c = c - camera_mean;
        missed += (c - camera_from_rig * (r - rig_mean)).norm();
        all += c.norm();
    }
    missed / all.max(1e-12)
}
