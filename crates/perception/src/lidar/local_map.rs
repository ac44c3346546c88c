//! The map scans are registered to: Gaussians of the points in cubic cells at several sizes, with the plane each cell
//! shows where it is flat.
//!
//! A cell keeps the two sides of a thin wall apart: a point belongs to the surface that faces the sensor it was seen
//! from. The grid is turned against the world, because floors and walls parallel to cell faces would be cut along them.

use lsfb_geometry::{Se3, Vector3};
use nalgebra::{Matrix3, Rotation3};
use rayon::prelude::*;

use super::plane::{Plane, PointSums};
use super::plane_map::PlaneMap;
use super::registration::Match;
use super::voxels::{CellMap, cell_key, neighbour_key};

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

/// Beyond this a cell is known well enough; later scans would only smear it with their own pose errors.
const MAX_POINTS_PER_SURFACE: u32 = 1000;
/// Fewer points do not make a plane.
const MIN_POINTS_PER_PLANE: u32 = 6;
/// Points that one place may add to a surface: standing still must not fill it.
const MAX_POINTS_PER_PLACE: u32 = 250;
/// A plane must be seen from this many places, as far as there are: from one place the rings always fall on the same
/// lines, and two lines make a plane where floor and wall meet.
const MIN_PLACES: u32 = 3;
/// Distance of the sensor between two places, metres.
const MIN_PLACE_DISTANCE_M: f64 = 0.05;
/// Sine of the least angle between a plane and the rays that see it: the returns of one ring alone spread along their
/// rays by noise, and would show a plane through the sensor.
const MIN_SLANT: f64 = 0.1;
/// The farthest neighbour searched, in cells of the finest level.
const MAX_NEIGHBOUR_CELLS: i64 = 4;

/// Points per task.
const CHUNK: usize = 256;

/// The points of one surface in one cell.
#[derive(Clone, Debug, Default)]
struct Surface {
    sums: PointSums,
    /// Places it was seen from, the first and the last of them.
    places: u32,
    first_place: u32,
    last_place: u32,
    /// Points added from that place.
    count_here: u32,
    /// Points at the last plane fit.
    fitted_count: u32,
    /// Sum of the unit directions towards the sensor.
    towards_sensor: Vector3<f64>,
    plane: Option<Plane>,
}

/// The surfaces of one cell: the first seen, and one that faces the other way.
#[derive(Clone, Debug, Default)]
struct Cell {
    sides: [Surface; 2],
}

type Level = CellMap<Cell>;

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

impl Surface {
    /// Its plane, if it was seen from enough places.
    fn plane_from(&self, min_places: u32) -> Option<Plane> {
        self.plane.filter(|_| self.places >= min_places)
    }

    /// Direction that tells its points from those of the other side.
    fn facing(&self) -> Vector3<f64> {
        self.plane.map_or(self.towards_sensor, |p| p.normal)
    }

    fn add(&mut self, point: &Vector3<f64>, towards_sensor: &Vector3<f64>) {
        self.sums.add(point);
        self.count_here += 1;
        self.towards_sensor += towards_sensor;
    }

    fn enter(&mut self, place: u32) {
        if self.last_place != place {
            if self.places == 0 {
                self.first_place = place;
            }
            self.last_place = place;
            self.places += 1;
            self.count_here = 0;
        }
    }

    fn needs_fit(&self) -> bool {
        let count = self.sums.count();
        count >= MIN_POINTS_PER_PLANE && count * 10 >= self.fitted_count * 12
    }

    fn fit(&mut self, cell_size_m: f64, range_noise_m: f64) {
        self.fitted_count = self.sums.count();
        let limit_m = (1.5 * range_noise_m).hypot(0.02 * cell_size_m);
        let fitted = self.sums.plane().filter(|p| {
            // A line has no normal, and that of a patch narrower than its noise leans anywhere: walls would then hold the height.
            p.thickness_m < limit_m
                && p.breadth_m > 0.1 * cell_size_m
                && p.breadth_m > 3.0 * p.thickness_m
        });
        self.plane = fitted.and_then(|plane| {
            let slant = plane.normal.dot(&self.towards_sensor) / f64::from(self.fitted_count);
            let sign = if slant < 0.0 { -1.0 } else { 1.0 };
            (slant.abs() > MIN_SLANT).then(|| Plane {
                normal: plane.normal * sign,
                ..plane
            })
        });
    }
}

impl Cell {
    /// The side seen from direction `towards_sensor`.
    fn side(&self, towards_sensor: &Vector3<f64>) -> usize {
        let first = &self.sides[0];
        usize::from(first.sums.count() > 0 && first.facing().dot(towards_sensor) < 0.0)
    }
}

impl LocalMap {
    /// An empty map.
    pub fn new(config: LocalMapConfig) -> Self {
        // takes z to (1, 1, 1)/√3: floor, ceiling and most walls then cross the cells at a slant
        let axis_angle = Vector3::new(-1.0, 1.0, 0.0) / 2f64.sqrt() * (1.0 / 3f64.sqrt()).acos();
        let grid_from_world = Rotation3::from_scaled_axis(axis_angle);
        Self {
            config,
            grid_from_world: grid_from_world.into_inner(),
            levels: vec![Level::default(); config.levels.max(1) as usize],
            places: 0,
            last_place: None,
        }
    }

    /// Whether nothing was inserted yet.
    pub fn is_empty(&self) -> bool {
        self.levels.iter().all(CellMap::is_empty)
    }

    /// Number of cells of the finest level.
    pub fn cell_count(&self) -> usize {
        self.levels.last().map_or(0, CellMap::len)
    }

    /// Its planes alone: what is left when nothing more is to be inserted, at a small part of the memory.
    pub fn into_planes(self) -> PlaneMap {
        let min_places = self.min_places();
        let planes_of = |cells: Level| {
            let flat = cells.into_iter().filter_map(|(key, cell)| {
                let planes = cell.sides.map(|side| side.plane_from(min_places));
                planes.iter().any(Option::is_some).then_some((key, planes))
            });
            let mut planes: CellMap<[Option<Plane>; 2]> = flat.collect();
            planes.shrink_to_fit();
            planes
        };
        PlaneMap {
            finest_cell_m: self.size_m(self.levels.len() - 1),
            grid_from_world: self.grid_from_world,
            levels: self.levels.into_iter().map(planes_of).collect(),
        }
    }

    fn min_places(&self) -> u32 {
        MIN_PLACES.min(self.places.div_ceil(2))
    }

    fn size_m(&self, level: usize) -> f64 {
        self.config.cell_size_m / f64::from(1u32 << level.min(16))
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
        let rotation = world_from_rig.rotation_matrix();
        let points: Vec<_> = points_in_rig
            .iter()
            .map(|p| rotation * p + world_from_rig.translation)
            .collect();
        for level in 0..self.levels.len() {
            let size_m = self.size_m(level);
            let cells = &mut self.levels[level];
            for point in &points {
                let towards_sensor = (sensor - point).normalize();
                let key = cell_key(&(self.grid_from_world * point), 1.0 / size_m);
                let cell = cells.entry(key).or_default();
                let side = cell.side(&towards_sensor);
                let surface = &mut cell.sides[side];
                surface.enter(place);
                if surface.sums.count() >= MAX_POINTS_PER_SURFACE
                    || surface.count_here >= MAX_POINTS_PER_PLACE
                {
                    continue;
                }
                surface.add(point, &towards_sensor);
                if surface.needs_fit() {
                    surface.fit(size_m, self.config.range_noise_m);
                }
            }
        }
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
        for (level, cells) in self.levels.iter().enumerate() {
            let key = cell_key(&in_grid, 1.0 / self.size_m(level));
            let plane = cells
                .get(&key)
                .and_then(|cell| cell.sides[cell.side(towards_sensor)].plane_from(min_places));
            if let Some(plane) = plane {
                let distance = plane.normal.dot(&(point - plane.point)).abs();
                if distance < gate_m {
                    return Some(Match::Plane(plane));
                }
            }
        }
        self.nearest_mean(point, &in_grid, gate_m).map(Match::Point)
    }

    /// What each point of a scan belongs to, seen from its sensor at a pose of the rig.
    pub fn find_all(
        &self,
        points_in_rig: &[Vector3<f64>],
        sensor_in_rig: &Vector3<f64>,
        world_from_rig: &Se3,
        gate_m: f64,
    ) -> Vec<Option<Match>> {
        let rotation = world_from_rig.rotation_matrix();
        let sensor = *world_from_rig * *sensor_in_rig;
        points_in_rig
            .par_iter()
            .with_min_len(CHUNK)
            .map(|p| {
                let in_world = rotation * p + world_from_rig.translation;
                self.find(&in_world, &(sensor - in_world), gate_m)
            })
            .collect()
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
        for (level, cells) in self.levels.iter().enumerate() {
            let cell = cells.get(&cell_key(&in_grid, 1.0 / self.size_m(level)));
            let Some(cell) = cell else {
                continue;
            };
            let surface = &cell.sides[cell.side(towards_sensor)];
            if surface.plane_from(min_places).is_some() {
                return Some(surface.first_place);
            }
            finest = Some(surface.first_place);
        }
        finest.filter(|place| *place > 0)
    }

    fn nearest_mean(
        &self,
        point: &Vector3<f64>,
        in_grid: &Vector3<f64>,
        gate_m: f64,
    ) -> Option<Vector3<f64>> {
        let finest = self.levels.last()?;
        let size_m = self.size_m(self.levels.len() - 1);
        let reach = ((gate_m / size_m).ceil() as i64).clamp(1, MAX_NEIGHBOUR_CELLS);
        let key = cell_key(in_grid, 1.0 / size_m);
        let mut best: Option<(f64, Vector3<f64>)> = None;
        for dx in -reach..=reach {
            for dy in -reach..=reach {
                for dz in -reach..=reach {
                    let Some(cell) = finest.get(&neighbour_key(key, [dx, dy, dz])) else {
                        continue;
                    };
                    let mean = cell.sides[0].sums.mean();
                    let squared = (mean - point).norm_squared();
                    if squared < best.map_or(gate_m * gate_m, |b| b.0) {
                        best = Some((squared, mean));
                    }
                }
            }
        }
        best.map(|b| b.1)
    }

    /// Forgets what is farther than `range_m` from `centre`.
    pub fn forget_beyond(&mut self, centre: &Vector3<f64>, range_m: f64) {
        for cells in &mut self.levels {
            cells.retain(|_, cell| (cell.sides[0].sums.first() - centre).norm() < range_m);
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
