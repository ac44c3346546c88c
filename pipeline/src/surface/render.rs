//! What a camera would see of a surface.

use lsfb_geometry::{Camera, Se3, Vector2, Vector3};
use lsfb_perception::lidar::cell_key;
use rayon::prelude::*;

use super::patch::Meeting;
use super::{BLOCK_M, Block, MARGIN_M, Surface, VOXEL_M};

/// What one image shows, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Width of the image, pixels.
    pub width: u32,
    /// Height of the image, pixels.
    pub height: u32,
    /// Distance along the optical axis, metres; `None` where it is not certain.
    pub depths_m: Vec<Option<f32>>,
    /// Unit normals in the camera's frame, towards it; zero where there is no depth.
    pub normals: Vec<[f32; 3]>,
}

impl View {
    /// Share of the pixels that have a depth.
    pub fn known_share(&self) -> f64 {
        let known = self.depths_m.iter().flatten().count();
        known as f64 / self.depths_m.len().max(1) as f64
    }
}

/// Surfaces closer to one another than this along a ray are one, metres.
const TOGETHER_M: f64 = 0.12;

/// What a ray meets first.
pub(super) enum Sight {
    /// Surface, so far away, with this normal.
    Surface(f64, Vector3<f64>),
    /// Something without a depth of its own.
    Unknown,
}

impl Surface {
    /// What a camera at a pose sees, its whole image at one instant.
    pub fn render(&self, camera: &Camera, world_from_camera: &Se3) -> View {
        let width = camera.width as usize;
        let mut depths_m = vec![None; width * camera.height as usize];
        let mut normals = vec![[0.0; 3]; depths_m.len()];
        let rotation = world_from_camera.rotation_matrix();
        let rows = depths_m.par_chunks_mut(width.max(1));
        rows.zip(normals.par_chunks_mut(width.max(1)))
            .enumerate()
            .for_each(|(v, (depths_m, normals))| {
                for (u, (depth_m, normal)) in depths_m.iter_mut().zip(normals).enumerate() {
                    let pixel = Vector2::new(u as f64, v as f64);
                    let Some(ray) = camera.unproject(&pixel) else {
                        continue;
                    };
                    let sight = self.sight(&world_from_camera.translation, &(rotation * ray));
                    let Some(Sight::Surface(reach_m, seen)) = sight else {
                        continue;
                    };
                    let along_axis_m = reach_m * ray.z;
                    if along_axis_m > 0.0 {
                        *depth_m = Some(along_axis_m as f32);
                        *normal = (rotation.transpose() * seen).cast::<f32>().into();
                    }
                }
            });
        View {
            width: camera.width,
            height: camera.height,
            depths_m,
            normals,
        }
    }

    /// What a ray of unit length meets; `None` where it meets nothing within reach.
    pub(super) fn sight(&self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Option<Sight> {
        // The nearest place beside an outline.
        let mut passed_m = f64::INFINITY;
        // Block by block (Amanatides and Woo, "A fast voxel traversal algorithm", 1987).
        let mut block = origin.map(|x| (x / BLOCK_M).floor());
        let step = direction.map(|d| if d < 0.0 { -1.0 } else { 1.0 });
        let next = |block: &Vector3<f64>, axis: usize| {
            let side = block[axis] + if step[axis] > 0.0 { 1.0 } else { 0.0 };
            let reach = (side * BLOCK_M - origin[axis]) / direction[axis];
            if reach.is_finite() {
                reach
            } else {
                f64::INFINITY
            }
        };
        let mut enter_m = 0.0;
        while enter_m < self.max_depth_m {
            let reaches = [0, 1, 2].map(|axis| next(&block, axis));
            let axis = (0..3).fold(
                0,
                |best, k| if reaches[k] < reaches[best] { k } else { best },
            );
            let leave_m = reaches[axis];
            let key = cell_key(&(block.add_scalar(0.5) * BLOCK_M), 1.0 / BLOCK_M);
            if let Some(found) = self.blocks.get(&key) {
                let within = enter_m - MARGIN_M..=leave_m + MARGIN_M;
                let passage = meet(found, origin, direction, |t| within.contains(&t));
                passed_m = passed_m.min(passage.beside_m);
                if let Some(Met { reach_m, normal }) = passage.met {
                    let hidden = passed_m < reach_m - TOGETHER_M;
                    return Some(match normal {
                        Some(normal)
                            if !hidden
                                && reach_m <= self.max_depth_m
                                && self.free.is_clear(origin, direction, reach_m) =>
                        {
                            Sight::Surface(reach_m, normal)
                        }
                        _ => Sight::Unknown,
                    });
                }
            }
            block[axis] += step[axis];
            enter_m = leave_m;
        }
        None
    }
}

/// Something that a ray meets.
struct Met {
    reach_m: f64,
    /// Where it is a surface that was seen from this side.
    normal: Option<Vector3<f64>>,
}

/// What a ray meets on its way through a block.
struct Passage {
    /// First of all.
    met: Option<Met>,
    /// How far away it first passes beside an outline; infinite where it does not.
    beside_m: f64,
}

/// Looks along a ray, as far as it is `within` the block.
fn meet(
    block: &Block,
    origin: &Vector3<f64>,
    direction: &Vector3<f64>,
    within: impl Fn(f64) -> bool,
) -> Passage {
    let mut met: Option<Met> = None;
    let mut beside_m = f64::INFINITY;
    let mut found = |reach_m: f64, normal: Option<Vector3<f64>>| {
        if met.as_ref().is_none_or(|nearest| reach_m < nearest.reach_m) {
            met = Some(Met { reach_m, normal });
        }
    };
    for patch in &block.patches {
        let reach_m = patch.reach_m(origin, direction).filter(|t| within(*t));
        let Some(reach_m) = reach_m else {
            continue;
        };
        match patch.meets(&(origin + direction * reach_m)) {
            // From behind it is there, and nobody knows how thick it is.
            Some(Meeting::Surface) => found(reach_m, patch.normal_towards(direction)),
            Some(Meeting::Outline) => beside_m = beside_m.min(reach_m),
            None => {}
        }
    }
    for point in &block.rough {
        let along = direction.dot(&(point - origin));
        let beside = (origin + direction * along - point).norm_squared();
        if along > 0.0 && within(along) && beside < VOXEL_M * VOXEL_M {
            found(along, None);
        }
    }
    Passage { met, beside_m }
}
