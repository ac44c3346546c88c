//! Deskewing: every return of a scan as the rig would have it at one instant.
//!
//! Everything keeps the order of the input, so that results do not depend on threads.

use std::ops::RangeInclusive;

use lsfb_geometry::{Matrix3, Se3, Vector3};
use lsfb_types::{LidarPoint, LidarScan};
use rayon::prelude::*;

/// Distance of knots that are close enough for straight lines between them at any speed of a walk, nanoseconds.
pub const KNOT_NS: i64 = 5_000_000;
/// Returns per task.
const CHUNK: usize = 4096;

/// Pose of the rig at one instant of a scan, relative to the instant the scan is deskewed to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionKnot {
    /// Time after the scan's first firing, nanoseconds.
    pub offset_ns: i64,
    /// Takes points from the rig at that time to the rig at the reference instant.
    pub reference_from_rig: Se3,
}

/// Which returns of a scan are used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeWindow {
    /// Nearest range kept, metres: below it the carrier sees himself.
    pub min_m: f64,
    /// Farthest range kept, metres.
    pub max_m: f64,
}

/// How points that a LiDAR measured at any instant of a scan come to the reference instant.
#[derive(Clone, Debug)]
pub struct Motion {
    /// Rigid transforms as matrices: 60 000 quaternion products per scan cost more than the registration.
    knots: Vec<(i64, Matrix3<f64>, Vector3<f64>)>,
    still: (Matrix3<f64>, Vector3<f64>),
}

impl Motion {
    /// Through knots sorted by time; between two knots a point is blended linearly, so they should lie [`KNOT_NS`] apart.
    /// Times outside the knots take the nearest knot. Without knots the rig is taken to stand still.
    pub fn new(knots: &[MotionKnot], rig_from_lidar: &Se3) -> Self {
        let knots = knots.iter().map(|k| {
            let t = k.reference_from_rig * *rig_from_lidar;
            (k.offset_ns, t.rotation_matrix(), t.translation)
        });
        Self {
            knots: knots.collect(),
            still: (rig_from_lidar.rotation_matrix(), rig_from_lidar.translation),
        }
    }

    /// Through `reference_from_lidar` at as many times of a span as are needed, those left out at which it is not known.
    pub fn sampled(
        span_ns: RangeInclusive<i64>,
        reference_from_lidar: impl Fn(i64) -> Option<Se3>,
    ) -> Self {
        let (start, length) = (*span_ns.start(), span_ns.end() - span_ns.start());
        let steps = ((length + KNOT_NS - 1) / KNOT_NS).max(1);
        let knots: Vec<MotionKnot> = (0..=steps)
            .map(|k| start + length * k / steps)
            .filter_map(|offset_ns| {
                Some(MotionKnot {
                    offset_ns,
                    reference_from_rig: reference_from_lidar(offset_ns)?,
                })
            })
            .collect();
        Self::new(&knots, &Se3::identity())
    }

    /// Whether the motion is known at a time.
    pub fn covers(&self, offset_ns: i64) -> bool {
        self.knots.first().is_some_and(|k| k.0 <= offset_ns)
            && self.knots.last().is_some_and(|k| offset_ns <= k.0)
    }

    /// A point measured at a time after the scan's first firing, at the reference instant.
    pub fn undo(&self, offset_ns: i64, point_in_lidar: &Vector3<f64>) -> Vector3<f64> {
        let p = point_in_lidar;
        let next = self.knots.partition_point(|t| t.0 < offset_ns);
        let at = |index: usize| self.knots.get(index).map(|(_, r, t)| r * p + t);
        match (next.checked_sub(1), at(next)) {
            (Some(before), Some(end)) => {
                let span = (self.knots[next].0 - self.knots[before].0) as f64;
                let fraction = (offset_ns - self.knots[before].0) as f64 / span;
                at(before).map_or(end, |start| start + (end - start) * fraction)
            }
            (None, Some(only)) => only,
            (Some(before), None) => at(before).unwrap_or(*p),
            (None, None) => self.still.0 * p + self.still.1,
        }
    }
}

/// Takes every return inside the range window to the rig frame at the reference instant of `knots`, as [`Motion`] has it.
pub fn deskew(
    scan: &LidarScan,
    rig_from_lidar: &Se3,
    knots: &[MotionKnot],
    window: RangeWindow,
) -> Vec<Vector3<f64>> {
    deskew_each(scan, rig_from_lidar, knots, window, |_, p| p)
}

/// [`deskew`], with the returns of each ring apart, in firing order.
pub fn deskew_rings(
    scan: &LidarScan,
    rig_from_lidar: &Se3,
    knots: &[MotionKnot],
    window: RangeWindow,
) -> Vec<Vec<Vector3<f64>>> {
    let points = deskew_each(scan, rig_from_lidar, knots, window, |return_, p| {
        (return_.ring, p)
    });
    let mut rings: Vec<Vec<Vector3<f64>>> = Vec::new();
    for (ring, point) in points {
        let ring = usize::from(ring);
        if rings.len() <= ring {
            rings.resize(ring + 1, Vec::new());
        }
        rings[ring].push(point);
    }
    rings
}

fn deskew_each<T: Send + Clone>(
    scan: &LidarScan,
    rig_from_lidar: &Se3,
    knots: &[MotionKnot],
    window: RangeWindow,
    make: impl Fn(&LidarPoint, Vector3<f64>) -> T + Sync,
) -> Vec<T> {
    let motion = Motion::new(knots, rig_from_lidar);
    let range_squared = window.min_m * window.min_m..=window.max_m * window.max_m;
    scan.points
        .par_chunks(CHUNK)
        .map(|points| {
            let mut kept = Vec::with_capacity(points.len());
            for point in points {
                let p = Vector3::from(point.position_m.map(f64::from));
                // NaN is in no range
                if range_squared.contains(&p.norm_squared()) {
                    kept.push(make(
                        point,
                        motion.undo(i64::from(point.time_offset_ns), &p),
                    ));
                }
            }
            kept
        })
        .collect::<Vec<_>>()
        .concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_geometry::Vector6;

    const ALL: RangeWindow = RangeWindow {
        min_m: 0.0,
        max_m: 1e3,
    };

    #[test]
    fn deskew_undoes_a_constant_twist() {
        let twist = Vector6::new(0.1, -0.2, 0.3, 0.1, 0.05, -0.02);
        let rig_from_lidar = Se3::exp(&Vector6::new(0.3, 0.0, 0.1, 0.0, 0.1, 0.4));
        // pose of the rig at offset t, seen from the end of the scan (t = 0.1 s)
        let end_from_rig = |t: f64| Se3::exp(&(twist * (t - 0.1) / 0.1));
        let truth: Vec<_> = (0..200)
            .map(|i| Vector3::new(5.0 + 0.01 * i as f64, (i as f64).sin() * 4.0, 1.0))
            .collect();
        let scan = LidarScan {
            points: truth
                .iter()
                .enumerate()
                .map(|(i, in_end)| {
                    let t = 0.1 * i as f64 / 199.0;
                    let p = (end_from_rig(t) * rig_from_lidar).inverse() * *in_end;
                    LidarPoint {
                        position_m: [p.x as f32, p.y as f32, p.z as f32],
                        time_offset_ns: (t * 1e9).round() as u32,
                        ..Default::default()
                    }
                })
                .collect(),
        };
        let knots: Vec<_> = (0..=20)
            .map(|i| MotionKnot {
                offset_ns: i * 5_000_000,
                reference_from_rig: end_from_rig(i as f64 * 0.005),
            })
            .collect();
        let deskewed = deskew(&scan, &rig_from_lidar, &knots, ALL);
        assert_eq!(deskewed.len(), truth.len());
        for (a, b) in deskewed.iter().zip(&truth) {
            // blending over 5 ms at 214°/s cuts the arc by θ²/8
            assert!((a - b).norm() < 4e-4, "{a} {b}");
        }
    }

    #[test]
    fn range_window_drops_near_far_and_nan() {
        let at = |x: f32| LidarPoint {
            position_m: [x, 0.0, 0.0],
            ..Default::default()
        };
        let scan = LidarScan {
            points: vec![at(0.3), at(1.0), at(f32::NAN), at(50.0), at(0.5)],
        };
        let window = RangeWindow {
            min_m: 0.5,
            max_m: 10.0,
        };
        let kept = deskew(&scan, &Se3::identity(), &[], window);
        assert_eq!(kept.iter().map(|p| p.x).collect::<Vec<_>>(), vec![1.0, 0.5]);
    }

    /// Little-endian floats of a file of the Newer College data set.
    fn floats(path: std::path::PathBuf) -> Vec<f32> {
        let bytes = std::fs::read(path).expect("a file");
        let float = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        bytes.chunks_exact(4).map(float).collect()
    }

    #[test]
    fn newer_college_is_deskewed_like_theirs() {
        let test = "newer_college_is_deskewed_like_theirs";
        let Some(folder) = lsfb_tests::recordings(test, "lidar/gtsam_points/newer_06") else {
            return;
        };
        for name in ["00", "01"] {
            let read = |kind: &str| floats(folder.join(format!("{kind}_{name}.bin")));
            let (raw, times, expected) = (read("raw"), read("times"), read("deskewed"));
            let point = |values: &[f32], i: usize| {
                Vector3::new(values[3 * i], values[3 * i + 1], values[3 * i + 2]).map(f64::from)
            };
            let first = times.iter().copied().fold(f32::INFINITY, f32::min);
            let offset_ns = |i: usize| (f64::from(times[i] - first) * 1e9).round() as u32;
            // The motion is not given: of every other point it is taken by alignment, the rest is the test.
            let mut bins: std::collections::BTreeMap<u32, Vec<usize>> = Default::default();
            for i in (0..times.len()).step_by(2) {
                bins.entry(offset_ns(i) / 4_000_000).or_default().push(i);
            }
            let knots: Vec<MotionKnot> = bins
                .values()
                .filter(|bin| bin.len() > 100)
                .map(|bin| {
                    let of = |values: &[f32]| -> Vec<_> {
                        bin.iter().map(|i| point(values, *i)).collect()
                    };
                    let fixed = lsfb_geometry::align::Scale::Fixed;
                    let found = lsfb_geometry::align::umeyama(&of(&raw), &of(&expected), fixed);
                    let sum: u64 = bin.iter().map(|i| u64::from(offset_ns(*i))).sum();
                    MotionKnot {
                        offset_ns: (sum / bin.len() as u64) as i64,
                        reference_from_rig: found.expect("points in space").target_from_source,
                    }
                })
                .collect();
            let turn =
                knots[0].reference_from_rig.inverse() * knots[knots.len() - 1].reference_from_rig;
            assert!(turn.rotation.angle().to_degrees() > 2.0, "it turns");
            let scan = LidarScan {
                points: (1..times.len())
                    .step_by(2)
                    .map(|i| LidarPoint {
                        position_m: [raw[3 * i], raw[3 * i + 1], raw[3 * i + 2]],
                        time_offset_ns: offset_ns(i),
                        ..Default::default()
                    })
                    .collect(),
            };
            let found = deskew(&scan, &Se3::identity(), &knots, ALL);
            let squares: f64 = found
                .iter()
                .zip((1..times.len()).step_by(2))
                .map(|(f, i)| (f - point(&expected, i)).norm_squared())
                .sum();
            let rms_m = (squares / found.len() as f64).sqrt();
            assert!(rms_m < 0.02, "{rms_m} m");
        }
    }
}
