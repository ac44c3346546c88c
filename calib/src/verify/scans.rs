//! Scans spread over a recording, each return where and when it was.

use std::collections::BTreeMap;

use lsfb_geometry::IntegratedGyro;
use lsfb_geometry::{Rig, Se3, Vector3, so3};
use lsfb_perception::lidar::Motion;
use lsfb_recording::Recording;
use lsfb_types::{LidarScan, Stamped};

use super::VerifyConfig;
use super::mutual_information::bins_of;
use super::scan_motion::{Moved, velocity};
use super::view::step_weight;
use crate::Error;
use crate::recorded::{seconds, unreadable};

/// Nearer returns are the rig's own, metres.
const NEAREST_M: f64 = 0.3;
/// Scans that follow each other begin at most this far apart, seconds.
const NEXT_S: f64 = 0.35;

/// A scan in the rig, each return with its own time.
pub(super) struct ScanInRig {
    /// Time of its first firing.
    start_s: f64,
    pub middle_s: f64,
    pub points: Vec<TimedPoint>,
    /// Velocity of the rig in its own axes, m/s; zero where that is not known.
    pub speed: Vector3<f64>,
}

/// A return.
#[derive(Clone, Copy)]
pub(super) struct TimedPoint {
    /// After the scan's first firing, nanoseconds.
    offset_ns: u32,
    pub in_rig: Vector3<f64>,
    /// Weight of the step in range beside it, where there is one.
    pub step: Option<f64>,
    /// Bin of its reflectivity.
    pub bin: usize,
}

/// Scans spread over the recording; none where the rig has no LiDAR.
pub(super) fn scans(
    recording: &Recording,
    rig: &Rig,
    gyro: Option<&IntegratedGyro>,
    config: &VerifyConfig,
) -> Result<Vec<ScanInRig>, Error> {
    let Some(lidar) = rig.lidar() else {
        return Ok(Vec::new());
    };
    let count = match recording.scans() {
        Ok(scans) => scans.count(),
        Err(_) => return Ok(Vec::new()),
    };
    let every = (count / config.views.max(1)).max(1);
    let all = recording.scans().map_err(unreadable(recording))?;
    let read = |scan: Stamped<LidarScan>| {
        let start_s = seconds(scan.time.nanos(), recording);
        ScanInRig::new(start_s, &scan.sample, &lidar.rig_from_lidar)
    };
    let mut out: Vec<ScanInRig> = Vec::new();
    // Whether the scan read last waits for the one after it, which says how the rig moved.
    let mut waits = false;
    for (k, scan) in all.enumerate() {
        let wanted = k % every == every / 2;
        if !wanted && !waits {
            continue;
        }
        let next = read(scan.map_err(unreadable(recording))?);
        if let Some(last) = out.last_mut().filter(|_| waits) {
            last.speed = last.speed_to(&next, gyro).unwrap_or_default();
        }
        waits = wanted;
        if wanted {
            out.push(next);
        }
    }
    Ok(out)
}

impl ScanInRig {
    fn new(start_s: f64, scan: &LidarScan, rig_from_lidar: &Se3) -> Self {
        let points = &scan.points;
        let steps = steps(scan);
        let last = points.iter().map(|p| p.time_offset_ns).max().unwrap_or(0);
        let reflectivity: Vec<u8> = points.iter().map(|p| p.intensity).collect();
        let bins = bins_of(&reflectivity);
        let placed = points.iter().zip(&steps).filter_map(|(p, step)| {
            let position = Vector3::from(p.position_m).map(f64::from);
            (position.norm() > NEAREST_M).then(|| TimedPoint {
                offset_ns: p.time_offset_ns,
                in_rig: *rig_from_lidar * position,
                step: *step,
                bin: bins[usize::from(p.intensity)],
            })
        });
        Self {
            start_s,
            middle_s: start_s + 0.5e-9 * f64::from(last),
            points: placed.collect(),
            speed: Vector3::zeros(),
        }
    }

    /// Velocity of the rig, from here to the scan that follows.
    fn speed_to(&self, next: &Self, gyro: Option<&IntegratedGyro>) -> Option<Vector3<f64>> {
        if next.middle_s - self.middle_s > NEXT_S {
            return None;
        }
        let turned = |scan: &Self| -> Vec<Moved> {
            let motion = scan.motion(self.middle_s, gyro, &Vector3::zeros());
            let points = scan.points.iter();
            points
                .map(|p| Moved {
                    place: motion.undo(i64::from(p.offset_ns), &p.in_rig),
                    after_s: scan.start_s + f64::from(p.offset_ns) * 1e-9 - self.middle_s,
                })
                .collect()
        };
        velocity(&turned(self), &turned(next))
    }

    /// How the rig moved to where it was at a time, as far as the gyroscope knows and at a constant velocity.
    fn motion(&self, time_s: f64, gyro: Option<&IntegratedGyro>, speed: &Vector3<f64>) -> Motion {
        let last = self.points.iter().map(|p| p.offset_ns).max().unwrap_or(0);
        let now = gyro.and_then(|g| g.angle(time_s));
        Motion::sampled(0..=i64::from(last), |offset_ns| {
            let at_s = self.start_s + offset_ns as f64 * 1e-9;
            let turn = match (now, gyro.and_then(|g| g.angle(at_s))) {
                (Some(now), Some(then)) => so3::exp(&(then - now)),
                _ => Default::default(),
            };
            Some(Se3::new(turn, speed * (at_s - time_s)))
        })
    }

    /// The returns as the rig would have them at a time.
    pub fn at(&self, time_s: f64, gyro: Option<&IntegratedGyro>) -> Vec<TimedPoint> {
        let motion = self.motion(time_s, gyro, &self.speed);
        let moved = self.points.iter().map(|p| TimedPoint {
            in_rig: motion.undo(i64::from(p.offset_ns), &p.in_rig),
            ..*p
        });
        moved.collect()
    }
}

/// By return: weight of the step in range beside it.
fn steps(scan: &LidarScan) -> Vec<Option<f64>> {
    let points = &scan.points;
    let mut by_ring = BTreeMap::<u16, Vec<usize>>::new();
    for (k, point) in points.iter().enumerate() {
        by_ring.entry(point.ring).or_default().push(k);
    }
    let place = |k: usize| Vector3::from(points[k].position_m).map(f64::from);
    let range = |k: usize| place(k).norm();
    let ray = |k: usize| place(k).normalize();
    let mut steps = vec![None; points.len()];
    for ring in by_ring.values() {
        for w in ring.windows(3) {
            let own = range(w[1]);
            // Neighbours in direction: a lost return is no step.
            let beside = |k: usize| ray(k).dot(&ray(w[1])) > 0.99985;
            let farther = [w[0], w[2]]
                .into_iter()
                .filter(|k| beside(*k))
                .map(|k| range(k) - own)
                .fold(0.0, f64::max);
            steps[w[1]] = step_weight(farther);
        }
    }
    steps
}
