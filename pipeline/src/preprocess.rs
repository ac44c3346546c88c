//! From a raw scan to points worth registering: deskew to one instant, range filter, voxel downsampling.
//!
//! Everything keeps the order of the input, so that results do not depend on hashing or threads.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use lsfb_geometry::{Se3, Vector3};
use lsfb_types::{LidarPoint, LidarScan};
use nalgebra::Matrix3;
use rayon::prelude::*;

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

/// Takes every return inside the range window to the rig frame at the reference instant of `knots`.
///
/// `knots` must be sorted by time; between two knots a point is blended linearly, so they should lie a few
/// milliseconds apart. Times outside the knots take the nearest knot. Without knots the rig is taken to stand still.
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
    // Rigid transforms as matrices: 60 000 quaternion products per scan cost more than the registration.
    let transforms: Vec<(i64, Matrix3<f64>, Vector3<f64>)> = knots
        .iter()
        .map(|k| {
            let t = k.reference_from_rig * *rig_from_lidar;
            (k.offset_ns, t.rotation_matrix(), t.translation)
        })
        .collect();
    let still = (rig_from_lidar.rotation_matrix(), rig_from_lidar.translation);
    let range_squared = window.min_m * window.min_m..=window.max_m * window.max_m;
    scan.points
        .par_chunks(4096)
        .map(|points| {
            let mut kept = Vec::with_capacity(points.len());
            for point in points {
                let p = Vector3::from(point.position_m.map(f64::from));
                // NaN is in no range
                if !range_squared.contains(&p.norm_squared()) {
                    continue;
                }
                let time = i64::from(point.time_offset_ns);
                let next = transforms.partition_point(|t| t.0 < time);
                let at = |index: usize| transforms.get(index).map(|(_, r, t)| r * p + t);
                let moved = match (next.checked_sub(1), at(next)) {
                    (Some(before), Some(end)) => {
                        let span = (transforms[next].0 - transforms[before].0) as f64;
                        let fraction = (time - transforms[before].0) as f64 / span;
                        at(before).map_or(end, |start| start + (end - start) * fraction)
                    }
                    (None, Some(only)) => only,
                    (Some(before), None) => at(before).unwrap_or(p),
                    (None, None) => still.0 * p + still.1,
                };
                kept.push(make(point, moved));
            }
            kept
        })
        .collect::<Vec<_>>()
        .concat()
}

/// Replaces the points in each cubic voxel by their mean; voxels in order of their first point.
pub fn voxel_downsample(points: &[Vector3<f64>], voxel_size_m: f64) -> Vec<Vector3<f64>> {
    let mut index_of = HashMap::with_capacity_and_hasher(points.len() / 4, CellState::default());
    let mut sums: Vec<(Vector3<f64>, u32)> = Vec::with_capacity(points.len() / 4);
    for point in points {
        let index = *index_of
            .entry(cell_key(point, 1.0 / voxel_size_m))
            .or_insert(sums.len());
        match sums.get_mut(index) {
            Some((sum, count)) => {
                *sum += point;
                *count += 1;
            }
            None => sums.push((*point, 1)),
        }
    }
    sums.iter()
        .map(|(sum, count)| sum / f64::from(*count))
        .collect()
}

/// Key of the grid cell that holds `point`: 21 bits per axis, so cells 2²¹ apart share a key.
pub(crate) fn cell_key(point: &Vector3<f64>, cells_per_m: f64) -> u64 {
    let part = |x: f64| (x * cells_per_m).floor() as i64 as u64 & 0x1f_ffff;
    part(point.x) << 42 | part(point.y) << 21 | part(point.z)
}

/// The key `dx, dy, dz` cells away.
pub(crate) fn neighbour_key(key: u64, offset: [i64; 3]) -> u64 {
    let part =
        |shift: u32, d: i64| (((key >> shift) & 0x1f_ffff).wrapping_add(d as u64)) & 0x1f_ffff;
    part(42, offset[0]) << 42 | part(21, offset[1]) << 21 | part(0, offset[2])
}

/// Hashes a cell key by one multiplication; std's keyed hash costs more than the work per cell.
#[derive(Default)]
pub(crate) struct CellHasher(u64);

impl Hasher for CellHasher {
    fn finish(&self) -> u64 {
        self.0
    }
    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.write_u64(self.0 << 8 | u64::from(*byte));
        }
    }
    fn write_u64(&mut self, key: u64) {
        let mixed = key.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = mixed ^ (mixed >> 32);
    }
}

/// Hash state of maps keyed by cells.
pub(crate) type CellState = BuildHasherDefault<CellHasher>;

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

    #[test]
    fn downsampling_averages_in_order_of_first_appearance() {
        let p = |x: f64| Vector3::new(x, 0.2, -0.3);
        let out = voxel_downsample(&[p(5.1), p(-0.2), p(5.3), p(0.2)], 1.0);
        assert_eq!(out.len(), 3);
        assert!((out[0].x - 5.2).abs() < 1e-12 && out[1].x == -0.2 && out[2].x == 0.2);
    }

    #[test]
    fn neighbour_keys_wrap_like_the_cells() {
        let a = Vector3::new(-0.5, 0.5, 3.5);
        let b = Vector3::new(0.5, -0.5, 2.5);
        assert_eq!(
            neighbour_key(cell_key(&a, 1.0), [1, -1, -1]),
            cell_key(&b, 1.0)
        );
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
