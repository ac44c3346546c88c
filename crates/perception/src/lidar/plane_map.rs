//! The planes of a [`LocalMap`](super::LocalMap) that nothing more is inserted into.

use lsfb_geometry::{Matrix3, Vector3};

use super::plane::Plane;
use super::voxels::{CellMap, cell_key};

/// Planes in cubic cells at several sizes, up to two in a cell: the sides of a thin wall.
#[derive(Clone, Debug)]
pub struct PlaneMap {
    pub(super) finest_cell_m: f64,
    pub(super) grid_from_world: Matrix3<f64>,
    /// Coarsest first; each level halves the cells.
    pub(super) levels: Vec<CellMap<[Option<Plane>; 2]>>,
}

impl PlaneMap {
    /// The planes of the finest level, in order of their cells.
    pub fn finest(&self) -> Vec<Plane> {
        let Some(finest) = self.levels.last() else {
            return Vec::new();
        };
        let mut keyed: Vec<(u64, Plane)> = finest
            .iter()
            .flat_map(|(key, sides)| sides.iter().flatten().map(|plane| (*key, *plane)))
            .collect();
        keyed.sort_by_key(|(key, _)| *key);
        keyed.into_iter().map(|(_, plane)| plane).collect()
    }

    /// The largest plane within `gate_m` of `point` whose normal has a cosine above `min_normal_cosine` with `normal`.
    pub fn find(
        &self,
        point: &Vector3<f64>,
        normal: &Vector3<f64>,
        gate_m: f64,
        min_normal_cosine: f64,
    ) -> Option<Plane> {
        let in_grid = self.grid_from_world * point;
        let coarser = (0..self.levels.len() as i32).rev();
        self.levels.iter().zip(coarser).find_map(|(cells, level)| {
            let size_m = self.finest_cell_m * 2f64.powi(level);
            let sides = cells.get(&cell_key(&in_grid, 1.0 / size_m))?;
            sides.iter().flatten().copied().find(|plane| {
                plane.normal.dot(normal) > min_normal_cosine
                    && plane.normal.dot(&(point - plane.point)).abs() < gate_m
            })
        })
    }
}
