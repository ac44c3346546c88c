//! Space that beams went through: where a camera looks through anything else, something nobody saw may stand in its way.

use lsfb_geometry::Vector3;
use lsfb_perception::lidar::{CellMap, cell_key};

use super::BLOCK_M;

/// Voxels along each side of a block, a power of two, and their edge.
const SIDE: usize = 4;
const VOXEL_M: f64 = BLOCK_M / SIDE as f64;
/// Distance of the places that are looked at along a ray, metres.
const STEP_M: f64 = 0.75 * VOXEL_M;
/// A beam is known to be free up to so far from where it ends, a ray has to be, metres: noise, and slanting surfaces.
const END_M: f64 = 0.25;

/// Which voxels some beam went through.
#[derive(Clone, Debug, Default)]
pub(super) struct FreeSpace {
    blocks: CellMap<u64>,
}

impl FreeSpace {
    /// A beam went from one point to another.
    pub fn pass(&mut self, from: &Vector3<f64>, to: &Vector3<f64>) {
        let length_m = (to - from).norm();
        let direction = (to - from) / length_m;
        let mut here: (u64, u64) = (0, 0);
        for at in steps(length_m).map(|m| from + direction * m) {
            let (key, bit) = place(&at);
            if key != here.0 {
                self.add(here);
                here = (key, 0);
            }
            here.1 |= bit;
        }
        self.add(here);
    }

    fn add(&mut self, (key, bits): (u64, u64)) {
        if bits != 0 {
            *self.blocks.entry(key).or_default() |= bits;
        }
    }

    /// Whether all of a ray of unit length is free up to where it ends after `length_m`.
    pub fn is_clear(&self, from: &Vector3<f64>, direction: &Vector3<f64>, length_m: f64) -> bool {
        steps(length_m).all(|m| {
            let (key, bit) = place(&(from + direction * m));
            self.blocks.get(&key).is_some_and(|bits| bits & bit != 0)
        })
    }
}

/// Distances along a ray, its end left out.
fn steps(length_m: f64) -> impl Iterator<Item = f64> {
    let count = ((length_m - END_M) / STEP_M).floor().max(-1.0) as i64 + 1;
    (0..count).map(|step| step as f64 * STEP_M)
}

/// Key of the block, and bit of the voxel in it: a block is what shares all but the last bits of a voxel's key.
fn place(at: &Vector3<f64>) -> (u64, u64) {
    const INSIDE: u64 = SIDE as u64 - 1;
    let voxel = cell_key(at, 1.0 / VOXEL_M);
    let inside = [42, 21, 0].map(|axis| voxel >> axis & INSIDE);
    let index = inside.iter().fold(0, |index, at| index * SIDE as u64 + at);
    let block = voxel & !(INSIDE << 42 | INSIDE << 21 | INSIDE);
    (block, 1 << index)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_was_passed_is_free() {
        let mut free = FreeSpace::default();
        let sensor = Vector3::new(0.1, -0.1, 1.5);
        free.pass(&sensor, &Vector3::new(5.0, 0.1, 1.3));
        let along = (Vector3::new(5.0, 0.1, 1.3) - sensor).normalize();
        assert!(free.is_clear(&sensor, &along, 4.9));
        assert!(!free.is_clear(&sensor, &along, 5.6));
        assert!(!free.is_clear(&sensor, &Vector3::new(0.8, 0.6, 0.0), 2.0));
        // Too short to hold anything.
        assert!(free.is_clear(&Vector3::repeat(30.0), &along, 0.2));
    }
}
