//! Points by cubic cells.
//!
//! Everything keeps the order of the input, so that results do not depend on hashing or threads.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use lsfb_geometry::Vector3;

/// Replaces the points in each cubic voxel by their mean; voxels in order of their first point.
pub fn voxel_downsample(points: &[Vector3<f64>], voxel_size_m: f64) -> Vec<Vector3<f64>> {
    let mut index_of =
        CellMap::with_capacity_and_hasher(points.len() / 4, BuildHasherDefault::default());
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
pub fn cell_key(point: &Vector3<f64>, cells_per_m: f64) -> u64 {
    let part = |x: f64| floor(x * cells_per_m) as u64 & 0x1f_ffff;
    part(point.x) << 42 | part(point.y) << 21 | part(point.z)
}

/// The greatest integer that is not above `x`: as `f64::floor`, which is a call where the processor is not known beforehand.
fn floor(x: f64) -> i64 {
    let towards_zero = x as i64;
    towards_zero.saturating_sub(i64::from(x < towards_zero as f64))
}

/// The key `dx, dy, dz` cells away.
pub fn neighbour_key(key: u64, offset: [i64; 3]) -> u64 {
    let part =
        |shift: u32, d: i64| (((key >> shift) & 0x1f_ffff).wrapping_add(d as u64)) & 0x1f_ffff;
    part(42, offset[0]) << 42 | part(21, offset[1]) << 21 | part(0, offset[2])
}

/// Hashes a cell key by one multiplication; std's keyed hash costs more than the work per cell.
#[derive(Clone, Debug, Default)]
pub struct CellHasher(u64);

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

/// A map keyed by cells. Its order says nothing.
pub type CellMap<T> = HashMap<u64, T, BuildHasherDefault<CellHasher>>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn downsampling_averages_in_order_of_first_appearance() {
        let p = |x: f64| Vector3::new(x, 0.2, -0.3);
        let out = voxel_downsample(&[p(5.1), p(-0.2), p(5.3), p(0.2)], 1.0);
        assert_eq!(out.len(), 3);
        assert!((out[0].x - 5.2).abs() < 1e-12 && out[1].x == -0.2 && out[2].x == 0.2);
    }

    #[test]
    fn floor_is_that_of_the_standard_library() {
        let numbers = [
            0.0,
            -0.0,
            0.3,
            -0.3,
            1.0,
            -1.0,
            1e9 + 0.5,
            -1e9 - 0.5,
            1e300,
            -1e300,
        ];
        for x in numbers
            .into_iter()
            .chain([f64::NAN, f64::INFINITY, f64::NEG_INFINITY])
        {
            assert_eq!(floor(x), x.floor() as i64, "{x}");
        }
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
}
