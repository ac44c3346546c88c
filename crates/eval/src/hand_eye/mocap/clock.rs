//! From the motion capture's clock to the IMU's, and the times at which both are looked at.

use lsfb_geometry::{Se3, StampedPose};
use lsfb_types::Timestamp;

use super::super::ClockModel;
use super::filter::{MarkerPose, Smoothed};
use super::motion::{ImuState, Inertial};

/// Poses of motion capture that are used; more are thinned out evenly.
const MOST_POSES: usize = 20_000;
/// The clocks may come to be apart by this much more, seconds.
const CLOCK_MARGIN_SECS: f64 = 0.05;
/// Where markers are dropped, certainty is asked at least so often, seconds.
const LOOK_SECS: f64 = 0.05;

/// From the motion capture's clock to the IMU's.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clock {
    /// By how much the IMU's is ahead in the middle, seconds.
    pub ahead_secs: f64,
    pub drift: f64,
    /// On the motion capture's clock, seconds since the base.
    pub middle_secs: f64,
}

impl Clock {
    /// A time of the motion capture's clock on the IMU's, seconds.
    pub fn imu_secs(&self, mocap_secs: f64) -> f64 {
        mocap_secs + self.ahead_secs + self.drift * (mocap_secs - self.middle_secs)
    }

    /// With what the last pass found of it, the line through it; the states for the times as they are looked at then.
    pub fn moved(
        &mut self,
        found: &[Smoothed],
        seen: &mut [MarkerPose],
        model: ClockModel,
    ) -> Vec<ImuState> {
        let count = found.len().max(1) as f64;
        let times: Vec<f64> = seen.iter().map(|s| s.secs).collect();
        let mean = |of: &dyn Fn(usize) -> f64| (0..found.len()).map(of).sum::<f64>() / count;
        let value = |i: usize| found[i].state.clock_secs;
        let (late, at) = (mean(&value), mean(&|i| times[i]));
        let slope = match model {
            ClockModel::Constant => 0.0,
            ClockModel::Drifting => {
                let spread = mean(&|i| (times[i] - at).powi(2));
                let along = mean(&|i| (times[i] - at) * (value(i) - late));
                along / spread.max(f64::MIN_POSITIVE)
            }
        };
        let change = |secs: f64| late + slope * (secs - at);
        let middle = self.imu_secs(self.middle_secs);
        self.ahead_secs += change(middle);
        self.drift += slope * (1.0 + self.drift);
        let states = found.iter().zip(seen);
        states
            .map(|(found, seen)| {
                let by_secs = change(seen.secs);
                seen.secs += by_secs;
                ImuState {
                    clock_secs: found.state.clock_secs - by_secs,
                    ..found.state
                }
            })
            .collect()
    }
}

/// Poses that the samples cover, seconds since the base on the motion capture's clock, thinned out; the clock gets its middle.
pub(super) fn within(
    markers: &[StampedPose],
    base: Timestamp,
    inertial: &Inertial,
    clock: &mut Clock,
) -> Vec<(f64, Se3)> {
    let [start, end] = inertial.span_secs().unwrap_or_default();
    let mut poses: Vec<(f64, Se3)> = markers
        .iter()
        .map(|p| (p.time.secs_since(base), p.world_from_rig))
        .filter(|(secs, _)| {
            let there = secs + clock.ahead_secs;
            there > start + CLOCK_MARGIN_SECS && there < end - CLOCK_MARGIN_SECS
        })
        .collect();
    poses.dedup_by(|a, b| a.0 <= b.0);
    let step = poses.len().div_ceil(MOST_POSES).max(1);
    let poses: Vec<(f64, Se3)> = poses.into_iter().step_by(step).collect();
    clock.middle_secs = poses.get(poses.len() / 2).map_or(0.0, |p| p.0);
    poses
}

/// Poses on the IMU's clock, with times to look at where there are none.
pub(super) fn seen(poses: &[(f64, Se3)], clock: &Clock) -> Vec<MarkerPose> {
    let mut seen: Vec<MarkerPose> = Vec::with_capacity(poses.len());
    for (secs, markers) in poses {
        let secs = clock.imu_secs(*secs);
        let mut last = seen.last().map_or(secs, |s| s.secs);
        while secs - last > 2.0 * LOOK_SECS {
            last += LOOK_SECS;
            seen.push(MarkerPose {
                secs: last,
                markers: None,
            });
        }
        seen.push(MarkerPose {
            secs,
            markers: Some(*markers),
        });
    }
    seen
}
