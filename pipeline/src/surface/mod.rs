//! The surface that a LiDAR saw, and what of it a camera anywhere in its world would see: depth and normals.
//!
//! Ranges carry centimetres of noise. Each return is therefore moved onto the plane that the returns around it show (the cells of
//! [`LocalMap`], the largest that is flat), and a plane is surface only where returns lie on it. What lies on no plane (plants, cables, whoever
//! walked by) hides what is behind it and has no depth itself; neither has what lies next to an outline, which is known to a few centimetres
//! only, and what one sees through space that no beam went through: the leg of a table may stand there. A pixel has a depth where all of that is
//! certain, else none.

mod agreement;
mod free_space;
mod patch;
mod render;

use lsfb_geometry::{Rig, RigLidar, Trajectory, Vector3};
use lsfb_perception::lidar::{CellMap, LocalMap, LocalMapConfig, Match, Motion, cell_key};
use lsfb_types::{Bounds, LidarScan, Stamped};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

pub use agreement::Agreement;
pub use render::View;

use agreement::Beam;
use free_space::FreeSpace;
use patch::Patch;

/// What becomes surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SurfaceConfig {
    /// Edge of the largest cell in which returns may be one plane, metres; each of three further sizes is half of it.
    pub plane_cell_m: f64,
    /// Nearest return used, metres: below it the carrier sees himself.
    pub min_range_m: f64,
    /// Farthest return used, metres.
    pub max_range_m: f64,
    /// Farthest depth given, metres.
    pub max_depth_m: f64,
}

impl Default for SurfaceConfig {
    fn default() -> Self {
        Self {
            plane_cell_m: 0.8,
            min_range_m: 0.7,
            max_range_m: 60.0,
            max_depth_m: 60.0,
        }
    }
}

lsfb_types::bounds! {
    SurfaceConfig {
        plane_cell_m: number(Bounds::POSITIVE),
        min_range_m: number(Bounds::NOT_NEGATIVE),
        max_range_m: number(Bounds::POSITIVE),
        max_depth_m: number(Bounds::POSITIVE),
    }
}

/// Edge of the cells in which returns are joined before they are moved onto planes, metres; also that of a square of a patch.
const VOXEL_M: f64 = 0.05;
/// Edge of the cells that a ray walks through, metres.
const BLOCK_M: f64 = 0.8;
/// A return belongs to the blocks it is this near to, metres: patches are whole beyond the block that they are looked up in.
const MARGIN_M: f64 = 0.15;
/// Sizes of plane cells.
const LEVELS: u32 = 4;
/// Returns that a voxel must have to count: fewer are rain, or a beam that hit two things.
const LEAST_RETURNS: u32 = 2;
/// Beams of a scan whose way is remembered as free: evenly taken, more add little.
const BEAMS_PER_SCAN: usize = 8000;
/// Beams of a scan that are asked at the end whether the surface is where they ended: evenly taken.
const ASKED_PER_SCAN: usize = 64;

/// Returns of one voxel.
#[derive(Clone, Copy, Debug)]
struct Voxel {
    sum: Vector3<f64>,
    towards_sensor: Vector3<f64>,
    count: u32,
}

/// Adds a return to its voxel.
fn join_voxel(
    index_of: &mut CellMap<usize>,
    voxels: &mut Vec<Voxel>,
    point: &Vector3<f64>,
    sensor: &Vector3<f64>,
) {
    let next = voxels.len();
    let index = *index_of
        .entry(cell_key(point, 1.0 / VOXEL_M))
        .or_insert(next);
    if index == next {
        voxels.push(Voxel {
            sum: Vector3::zeros(),
            towards_sensor: Vector3::zeros(),
            count: 0,
        });
    }
    let voxel = &mut voxels[index];
    voxel.sum += point;
    voxel.towards_sensor += (sensor - point).normalize();
    voxel.count += 1;
}

/// A [`Surface`] that scans are still inserted into.
#[derive(Debug)]
pub struct SurfaceBuilder {
    lidar: RigLidar,
    config: SurfaceConfig,
    planes: LocalMap,
    free: FreeSpace,
    index_of: CellMap<usize>,
    voxels: Vec<Voxel>,
    asked: Vec<Beam>,
}

impl SurfaceBuilder {
    /// For scans of the rig's LiDAR; `None` where it has none.
    pub fn new(rig: &Rig, config: &SurfaceConfig) -> Option<Self> {
        let lidar = rig.lidar()?.clone();
        Some(Self {
            planes: LocalMap::new(LocalMapConfig {
                cell_size_m: config.plane_cell_m,
                levels: LEVELS,
                range_noise_m: lidar.range_noise_m,
            }),
            lidar,
            config: config.clone(),
            free: FreeSpace::default(),
            index_of: CellMap::default(),
            voxels: Vec::new(),
            asked: Vec::new(),
        })
    }

    /// Adds the returns of a scan whose motion the trajectory knows, each at the pose of its own time; whether it did.
    pub fn insert(&mut self, scan: &Stamped<LidarScan>, world_from_rig: &Trajectory) -> bool {
        let points = &scan.sample.points;
        let last = points.iter().map(|p| p.time_offset_ns).max().unwrap_or(0);
        let last = i64::from(last);
        let middle = world_from_rig.at(scan.time + last / 2);
        let ends = [scan.time, scan.time + last].map(|t| world_from_rig.at(t));
        let (Some(world_from_middle), [Some(_), Some(_)]) = (middle, ends) else {
            return false;
        };
        let middle_from_world = world_from_middle.inverse();
        let motion = Motion::sampled(0..=last, |offset_ns| {
            let pose = world_from_rig.at(scan.time + offset_ns)?;
            Some(middle_from_world * pose * self.lidar.rig_from_lidar)
        });
        let range_m = self.config.min_range_m..=self.config.max_range_m;
        let seen: Vec<Vector3<f64>> = points
            .par_iter()
            .filter_map(|p| {
                let in_lidar = Vector3::from(p.position_m.map(f64::from));
                let used = range_m.contains(&in_lidar.norm());
                used.then(|| motion.undo(i64::from(p.time_offset_ns), &in_lidar))
            })
            .collect();
        let sensor_in_rig = self.lidar.rig_from_lidar.translation;
        let sensor = world_from_middle * sensor_in_rig;
        let (planes, free) = (&mut self.planes, &mut self.free);
        let (asked, index_of, voxels) = (&mut self.asked, &mut self.index_of, &mut self.voxels);
        // Each by itself in order: the same whoever works on which.
        rayon::join(
            || planes.insert(&seen, &world_from_middle, &sensor_in_rig),
            || {
                let in_world = || seen.iter().map(|point| world_from_middle * *point);
                let every = |most: usize| seen.len().div_ceil(most).max(1);
                for point in in_world().step_by(every(BEAMS_PER_SCAN)) {
                    free.pass(&sensor, &point);
                }
                let ends = in_world().step_by(every(ASKED_PER_SCAN));
                asked.extend(ends.map(|end| Beam { sensor, end }));
                in_world().for_each(|point| join_voxel(index_of, voxels, &point, &sensor));
            },
        );
        true
    }

    /// Means of the returns of each voxel.
    pub fn points_m(&self) -> impl Iterator<Item = Vector3<f64>> {
        self.voxels.iter().map(|v| v.sum / f64::from(v.count))
    }

    /// What all of them saw.
    pub fn finish(self) -> Surface {
        let gate_m = 3.0 * self.lidar.range_noise_m + 0.02;
        let voxels: Vec<Voxel> = self.voxels;
        let planes = &self.planes;
        let placed: Vec<Option<Placed>> = voxels
            .par_iter()
            .map(|voxel| {
                if voxel.count < LEAST_RETURNS {
                    return None;
                }
                let mean = voxel.sum / f64::from(voxel.count);
                let found = planes.find(&mean, &voxel.towards_sensor, gate_m);
                Some(match found {
                    Some(Match::Plane(plane)) => {
                        let off = plane.normal.dot(&(mean - plane.point));
                        Placed::Flat(mean - plane.normal * off, plane.point, plane.normal)
                    }
                    _ => Placed::Rough(mean),
                })
            })
            .collect();
        let mut blocks: CellMap<Block> = CellMap::default();
        for placed in placed.iter().flatten() {
            for key in blocks_near(placed.at()) {
                blocks.entry(key).or_default().add(placed);
            }
        }
        blocks
            .par_iter_mut()
            .for_each(|(_, block)| block.patches.iter_mut().for_each(Patch::close));
        let known = placed.iter().flatten();
        let flat = known.clone().filter(|p| matches!(p, Placed::Flat(..)));
        let on_planes = flat.count() as f64 / known.count().max(1) as f64;
        let mut surface = Surface {
            blocks,
            free: self.free,
            max_depth_m: self.config.max_depth_m,
            agreement: Agreement::default(),
        };
        surface.agreement = surface.agreement_with(on_planes, &self.asked);
        surface
    }
}

/// Where the returns of a voxel lie.
enum Placed {
    /// Moved onto a plane: there, and the plane's point and normal.
    Flat(Vector3<f64>, Vector3<f64>, Vector3<f64>),
    /// On none.
    Rough(Vector3<f64>),
}

impl Placed {
    fn at(&self) -> &Vector3<f64> {
        match self {
            Self::Flat(at, ..) | Self::Rough(at) => at,
        }
    }
}

/// Keys of the blocks that a point is in or next to.
fn blocks_near(point: &Vector3<f64>) -> Vec<u64> {
    let side = |axis: usize| {
        let block = |off: f64| ((point[axis] + off) / BLOCK_M).floor();
        let mut sides = vec![block(-MARGIN_M), block(MARGIN_M)];
        sides.dedup();
        sides
    };
    let mut keys = Vec::with_capacity(8);
    for x in side(0) {
        for y in side(1) {
            for z in side(2) {
                keys.push(cell_key(
                    &(Vector3::new(x, y, z).add_scalar(0.5) * BLOCK_M),
                    1.0 / BLOCK_M,
                ));
            }
        }
    }
    keys
}

/// What is in one of the cells that rays walk through.
#[derive(Clone, Debug, Default)]
struct Block {
    patches: Vec<Patch>,
    rough: Vec<Vector3<f64>>,
}

impl Block {
    fn add(&mut self, placed: &Placed) {
        match placed {
            Placed::Rough(point) => self.rough.push(*point),
            Placed::Flat(at, point, normal) => {
                let same = self.patches.iter_mut().find(|p| p.is_on(point, normal));
                match same {
                    Some(patch) => patch.set(at),
                    None => {
                        let mut patch = Patch::new(*point, *normal, at);
                        patch.set(at);
                        self.patches.push(patch);
                    }
                }
            }
        }
    }
}

/// The surface that a LiDAR saw.
#[derive(Debug)]
pub struct Surface {
    blocks: CellMap<Block>,
    free: FreeSpace,
    max_depth_m: f64,
    agreement: Agreement,
}

impl Surface {
    /// How well the scans, at the poses that were given, agree with one another.
    pub fn agreement(&self) -> &Agreement {
        &self.agreement
    }

    /// Whether nothing is in it.
    pub fn is_empty(&self) -> bool {
        self.blocks.is_empty()
    }
}

#[cfg(test)]
mod tests;
