//! The map scans are registered to: Gaussians of the points in cubic cells at several sizes, with the plane each cell
//! shows where it is flat.
//!
//! A cell keeps the two sides of a thin wall apart: a point belongs to the surface that faces the sensor it was seen
//! from. The grid is turned against the world, because floors and walls parallel to cell faces would be cut along them.

use lsfb_geometry::{Se3, Vector3};
use nalgebra::{Matrix3, Rotation3};
use rayon::prelude::*;

use super::level::{Level, NONE, seen_from};
use super::plane_map::PlaneMap;
use super::registration::Match;

/// Sizes and tolerances of a [`LocalMap`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalMapConfig {
    /// Edge of the coarsest cell, metres; each further level halves it.
    pub cell_size_m: f64,
    /// Number of cell sizes.
    pub levels: u32,
    /// Standard deviation of one range, metres.
    pub range_noise_m: f64,
}

/// A plane must be seen from this many places, as far as there are: from one place the rings always fall on the same
/// lines, and two lines make a plane where floor and wall meet.
const MIN_PLACES: u32 = 3;
/// Distance of the sensor between two places, metres.
const MIN_PLACE_DISTANCE_M: f64 = 0.05;

/// The map of the surroundings.
#[derive(Clone, Debug)]
pub struct LocalMap {
    config: LocalMapConfig,
    grid_from_world: Matrix3<f64>,
    levels: Vec<Level>,
    /// Places from which scans were inserted so far, and the last of them.
    places: u32,
    last_place: Option<Vector3<f64>>,
}

impl LocalMap {
    /// An empty map.
    pub fn new(config: LocalMapConfig) -> Self {
        // takes z to (1, 1, 1)/√3: floor, ceiling and most walls then cross the cells at a slant
        let axis_angle = Vector3::new(-1.0, 1.0, 0.0) / 2f64.sqrt() * (1.0 / 3f64.sqrt()).acos();
        let grid_from_world = Rotation3::from_scaled_axis(axis_angle);
        let size_m = |level: u32| config.cell_size_m / f64::from(1u32 << level.min(16));
        Self {
            config,
            grid_from_world: grid_from_world.into_inner(),
            levels: (0..config.levels.max(1))
                .map(|level| Level::new(size_m(level)))
                .collect(),
            places: 0,
            last_place: None,
        }
    }

    /// Whether nothing was inserted yet.
    pub fn is_empty(&self) -> bool {
        self.levels.iter().all(|level| level.len() == 0)
    }

    /// Number of cells of the finest level.
    pub fn cell_count(&self) -> usize {
        self.levels.last().map_or(0, Level::len)
    }

    /// Its planes alone: what is left when nothing more is to be inserted, at a small part of the memory.
    pub fn into_planes(self) -> PlaneMap {
        let min_places = self.min_places();
        PlaneMap {
            finest_cell_m: self
                .levels
                .last()
                .map_or(self.config.cell_size_m, Level::size_m),
            grid_from_world: self.grid_from_world,
            levels: self
                .levels
                .into_iter()
                .map(|level| level.into_planes(min_places))
                .collect(),
        }
    }

    /// Its cells, the largest first.
    pub(super) fn levels(&self) -> &[Level] {
        &self.levels
    }

    pub(super) fn grid_from_world(&self) -> &Matrix3<f64> {
        &self.grid_from_world
    }

    /// A plane is one if it was seen from so many places.
    pub(super) fn min_places(&self) -> u32 {
        MIN_PLACES.min(self.places.div_ceil(2))
    }

    /// Adds the points of a scan taken at `world_from_rig` with its sensor at `sensor_in_rig`.
    pub fn insert(
        &mut self,
        points_in_rig: &[Vector3<f64>],
        world_from_rig: &Se3,
        sensor_in_rig: &Vector3<f64>,
    ) {
        let sensor = *world_from_rig * *sensor_in_rig;
        let moved = self
            .last_place
            .is_none_or(|place| (place - sensor).norm() > MIN_PLACE_DISTANCE_M);
        if moved {
            self.last_place = Some(sensor);
            self.places += 1;
        }
        let place = self.places;
        let noise_m = self.config.range_noise_m;
        let seen = seen_from(
            points_in_rig,
            world_from_rig,
            &sensor,
            &self.grid_from_world,
        );
        // Levels know nothing of each other, and each takes the points in their order.
        self.levels
            .par_iter_mut()
            .for_each(|level| level.insert(&seen, place, noise_m));
    }

    /// What a point seen from `sensor` belongs to, at most `gate_m` away: the largest plane it lies on, else the
    /// nearest mean of the finest level. `None` where the map is empty.
    pub fn find(
        &self,
        point: &Vector3<f64>,
        towards_sensor: &Vector3<f64>,
        gate_m: f64,
    ) -> Option<Match> {
        let in_grid = self.grid_from_world * point;
        let min_places = self.min_places();
        for level in &self.levels {
            let surface = level.find(&in_grid, towards_sensor).flatten();
            if let Some(plane) = surface.and_then(|s| s.plane_from(min_places)) {
                let distance = plane.normal.dot(&(point - plane.point)).abs();
                if distance < gate_m {
                    return Some(Match::Plane(plane));
                }
            }
        }
        let finest = self.levels.last()?;
        finest
            .nearest_mean(point, &in_grid, gate_m, &mut NONE.clone())
            .map(Match::Point)
    }

    /// The place from which the newest scan was inserted: places are numbered from 1 in the order of the walk; 0 before the first.
    pub fn place(&self) -> u32 {
        self.places
    }

    /// The place from which the surface at a point was first seen, of the largest cell with a plane there, else of the finest.
    pub fn first_seen_from(
        &self,
        point: &Vector3<f64>,
        towards_sensor: &Vector3<f64>,
    ) -> Option<u32> {
        let in_grid = self.grid_from_world * point;
        let min_places = self.min_places();
        let mut finest = None;
        for level in &self.levels {
            let Some(surface) = level.find(&in_grid, towards_sensor) else {
                continue;
            };
            let first_place = surface.map_or(0, |s| s.first_place);
            if surface.is_some_and(|s| s.plane_from(min_places).is_some()) {
                return Some(first_place);
            }
            finest = Some(first_place);
        }
        finest.filter(|place| *place > 0)
    }

    /// Forgets what is farther than `range_m` from `centre`.
    pub fn forget_beyond(&mut self, centre: &Vector3<f64>, range_m: f64) {
        for level in &mut self.levels {
            level.forget_beyond(centre, range_m);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map() -> LocalMap {
        LocalMap::new(LocalMapConfig {
            cell_size_m: 1.0,
            levels: 3,
            range_noise_m: 0.03,
        })
    }

    /// Points of the plane `x = x_m`, two metres wide and high.
    fn wall(x_m: f64) -> Vec<Vector3<f64>> {
        let steps = || (0..40).map(|i| f64::from(i) * 0.05 - 1.0);
        steps()
            .flat_map(|y| steps().map(move |z| Vector3::new(x_m, y, z)))
            .collect()
    }

    #[test]
    fn the_sides_of_a_thin_wall_stay_apart() {
        let mut map = map();
        for (x_m, sensor_x_m) in [(0.0, -3.0), (0.1, 3.0)] {
            let sensor = Vector3::new(sensor_x_m, 0.2, 0.1);
            map.insert(&wall(x_m), &Se3::identity(), &sensor);
        }
        for (x_m, towards) in [(0.0, -1.0), (0.1, 1.0)] {
            let towards_sensor = Vector3::new(towards, 0.0, 0.0);
            let point = Vector3::new(x_m, 0.33, -0.21);
            let Some(Match::Plane(plane)) = map.find(&point, &towards_sensor, 0.3) else {
                panic!("no plane at {point}");
            };
            assert!((plane.point.x - x_m).abs() < 1e-9 && plane.normal.x * towards > 0.999);
        }
        // The same of its planes alone.
        let planes = map.into_planes();
        assert!(planes.finest().len() > 10);
        for (x_m, towards) in [(0.0, -1.0), (0.1, 1.0)] {
            let normal = Vector3::new(towards, 0.0, 0.0);
            let plane = planes.find(&Vector3::new(x_m, 0.33, -0.21), &normal, 0.05, 0.9);
            let plane = plane.expect("a plane on this side");
            assert!((plane.point.x - x_m).abs() < 1e-9 && plane.normal.x * towards > 0.999);
            assert!(
                planes
                    .find(&Vector3::new(x_m + 5.0, 0.0, 0.0), &normal, 0.05, 0.9)
                    .is_none()
            );
        }
    }

    #[test]
    fn one_noisy_ring_is_no_plane() {
        let mut map = map();
        // A ring that rises by 10°, its ranges alternately too long and too short.
        let ring: Vec<Vector3<f64>> = (0..300)
            .map(|i| {
                let azimuth = f64::from(i) * 0.003 - 0.45;
                let range = 3.0 / azimuth.cos() + if i % 2 == 0 { 0.03 } else { -0.03 };
                Vector3::new(azimuth.cos(), azimuth.sin(), 10f64.to_radians().tan()) * range
            })
            .collect();
        map.insert(&ring, &Se3::identity(), &Vector3::zeros());
        for point in &ring {
            let found = map.find(point, &-point, 0.3);
            assert!(!matches!(found, Some(Match::Plane(p)) if p.normal.z.abs() > 0.5));
        }
    }

    #[test]
    fn what_is_far_is_forgotten() {
        let mut map = map();
        map.insert(&wall(2.0), &Se3::identity(), &Vector3::zeros());
        let cells = map.cell_count();
        map.forget_beyond(&Vector3::zeros(), 10.0);
        assert_eq!(map.cell_count(), cells);
        map.forget_beyond(&Vector3::zeros(), 1.0);
        assert!(map.is_empty());
    }
}
