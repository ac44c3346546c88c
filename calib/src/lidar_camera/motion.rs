//! A board that moves while it is scanned, or a rig that moves before a board: the images around the scan say how.
//!
//! With `B(t)` the board in the camera and `G` the LiDAR in it, what was measured at `p` at time `t` would have been measured at
//! `G⁻¹ B(t₀) B(t)⁻¹ G p` at the time `t₀` of the image. `G` need not be known well for that: it turns a way of centimetres.

use lsfb_geometry::{Se3, Vector3, Vector6};
use lsfb_perception::lidar::Motion;
use lsfb_types::LidarScan;

/// The board in the camera over time.
#[derive(Clone, Debug)]
pub(super) struct Track {
    /// Seconds after the scan's first firing.
    poses: Vec<(f64, Se3)>,
    /// Number of the pose that stands for the scan.
    chosen: usize,
}

impl Track {
    /// From poses in order of time; the one nearest the middle of the scan stands for it.
    pub fn new(scan: &LidarScan, poses: impl Iterator<Item = (f64, Se3)>) -> Self {
        let poses: Vec<(f64, Se3)> = poses.collect();
        let last_ns = scan.points.iter().map(|p| p.time_offset_ns).max();
        let middle_s = 0.5e-9 * f64::from(last_ns.unwrap_or(0));
        let off = |k: &usize| (poses[*k].0 - middle_s).abs();
        let chosen = (0..poses.len()).min_by(|a, b| off(a).total_cmp(&off(b)));
        Self {
            chosen: chosen.unwrap_or(0),
            poses,
        }
    }

    /// Number of the pose that stands for the scan.
    pub fn chosen(&self) -> usize {
        self.chosen
    }

    /// Whether the board was not at rest.
    pub fn moved(&self) -> bool {
        self.poses.len() > 1
    }

    /// Pose at a time: on the curve of third degree through the two poses around it and the next ones on either side, as far as
    /// there are any. Between two alone, a rig that is swung would be a centimetre off at two metres.
    fn at(&self, time_s: f64) -> Option<Se3> {
        let after = self.poses.partition_point(|p| p.0 <= time_s);
        let after = after.clamp(1, self.poses.len().checked_sub(1)?);
        let last = (after + 2).min(self.poses.len());
        let nodes = self.poses.get(after.saturating_sub(2)..last)?;
        let (_, start) = self.poses.get(after - 1)?;
        let way = nodes.iter().enumerate().map(|(k, (own_s, pose))| {
            let others = nodes.iter().enumerate().filter(|(other, _)| *other != k);
            let share: f64 = others
                .map(|(_, (other_s, _))| (time_s - other_s) / (own_s - other_s))
                .product();
            start.local(pose) * share
        });
        let way: Vector6<f64> = way.sum();
        way.iter()
            .all(|x| x.is_finite())
            .then(|| start.retract(&way))
    }

    /// The scan as if the board had stayed where the chosen image shows it.
    pub fn at_rest(&self, scan: &LidarScan, camera_from_lidar: &Se3) -> LidarScan {
        let Some((_, then)) = self.poses.get(self.chosen) else {
            return scan.clone();
        };
        let lidar_from_camera = camera_from_lidar.inverse();
        let last_ns = scan
            .points
            .iter()
            .map(|p| i64::from(p.time_offset_ns))
            .max();
        let span_ns = 0..=last_ns.unwrap_or(0);
        let motion = Motion::sampled(span_ns.clone(), |offset_ns| {
            let now = self.at(offset_ns as f64 * 1e-9)?;
            Some(lidar_from_camera * *then * now.inverse() * *camera_from_lidar)
        });
        if !(motion.covers(*span_ns.start()) && motion.covers(*span_ns.end())) {
            return scan.clone();
        }
        let mut still = scan.clone();
        for point in &mut still.points {
            let position = Vector3::from(point.position_m).map(f64::from);
            let moved = motion.undo(i64::from(point.time_offset_ns), &position);
            point.position_m = moved.map(|x| x as f32).into();
        }
        still
    }

    /// Velocity of the board in its own axes at the chosen image, rad/s then m/s; `None` for a board at rest.
    pub fn twist(&self) -> Option<Vector6<f64>> {
        let first = self.chosen.saturating_sub(1);
        let last = (self.chosen + 1).min(self.poses.len().checked_sub(1)?);
        let (a, b) = (self.poses.get(first)?, self.poses.get(last)?);
        (b.0 > a.0).then(|| a.1.local(&b.1) / (b.0 - a.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_types::LidarPoint;

    #[test]
    fn what_moves_with_the_board_comes_to_rest() {
        let camera_from_lidar = Se3::exp(&Vector6::new(1.2, -1.2, 1.2, 0.1, -0.2, 0.3));
        let start = Se3::exp(&Vector6::new(3.0, 0.1, 0.2, 0.3, 0.1, 1.6));
        let velocity = Vector6::new(0.3, -0.2, 0.4, 0.2, 0.1, -0.3);
        // Swung: to and fro within a second.
        let swing = Vector6::new(0.02, 0.03, -0.02, 0.01, 0.02, 0.03);
        let pose = |t: f64| start * Se3::exp(&(velocity * t + swing * (6.0 * t).sin()));
        let on_board = Vector3::new(0.2, -0.3, 0.0);
        let seen = |t: f64| camera_from_lidar.inverse() * pose(t) * on_board;
        let scan = LidarScan {
            points: (0..10)
                .map(|k| LidarPoint {
                    position_m: seen(0.01 * f64::from(k)).map(|x| x as f32).into(),
                    time_offset_ns: 10_000_000 * k,
                    ..LidarPoint::default()
                })
                .collect(),
        };
        let times = [-0.02, 0.03, 0.08, 0.13];
        let track = Track::new(&scan, times.into_iter().map(|t| (t, pose(t))));
        assert_eq!(track.chosen(), 1);
        let twist = velocity + swing * (6.0 * (6.0 * 0.03_f64).cos());
        assert!((track.twist().expect("it moves") - twist).norm() < 0.02);
        for point in track.at_rest(&scan, &camera_from_lidar).points {
            let off = Vector3::from(point.position_m).map(f64::from) - seen(0.03);
            assert!(off.norm() < 2e-4, "{off}");
        }
    }
}
