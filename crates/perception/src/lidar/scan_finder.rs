//! What the points of one scan belong to in a map, at one pose after the other.
//!
//! A registration asks for the same points again and again, each time a little elsewhere, and most of them are in the cells that they were in. So their cells are
//! remembered, and the mean that was nearest, which bounds the search for the next one: what is found is the same. Points are looked up many at a
//! time, level by level: what takes long is waiting for memory, and so it is waited for many of them at once.

use lsfb_geometry::{Matrix3, Se3, Vector3};
use rayon::prelude::*;

use super::level::{Cell, Level, NONE};
use super::local_map::LocalMap;
use super::registration::Match;

/// Points per task.
const CHUNK: usize = 256;

/// Looks up the points of a scan in a map that stays as it is.
#[derive(Debug)]
pub struct ScanFinder<'a> {
    map: &'a LocalMap,
    points_in_rig: &'a [Vector3<f64>],
    sensor_in_rig: Vector3<f64>,
    remembered: Vec<Remembered>,
}

/// Where the points of a chunk were last.
#[derive(Clone, Debug)]
struct Remembered {
    /// Their cells, level by level.
    cells: Vec<Cell>,
    /// The surfaces of the finest level whose means were nearest.
    nearest: Vec<u32>,
}

/// What is looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sought {
    Planes,
    PlanesAndMeans,
}

/// A pose at which the points are looked up.
struct At<'a> {
    rotation: Matrix3<f64>,
    translation: &'a Vector3<f64>,
    sensor: Vector3<f64>,
    gate_m: f64,
    min_places: u32,
    sought: Sought,
}

/// A point at that pose.
#[derive(Clone, Copy)]
struct Placed {
    in_world: Vector3<f64>,
    in_grid: Vector3<f64>,
    towards_sensor: Vector3<f64>,
}

impl<'a> ScanFinder<'a> {
    /// For points in the rig, seen from a sensor there.
    pub fn new(
        map: &'a LocalMap,
        points_in_rig: &'a [Vector3<f64>],
        sensor_in_rig: &Vector3<f64>,
    ) -> Self {
        let levels = map.levels().len();
        let chunks = points_in_rig.chunks(CHUNK);
        let remembered = chunks.map(|points| Remembered {
            cells: vec![Cell::default(); levels * points.len()],
            nearest: vec![NONE; points.len()],
        });
        Self {
            map,
            points_in_rig,
            sensor_in_rig: *sensor_in_rig,
            remembered: remembered.collect(),
        }
    }

    /// What each point belongs to at a pose of the rig, as [`LocalMap::find`] has it.
    pub fn find_all(&mut self, world_from_rig: &Se3, gate_m: f64) -> Vec<Option<Match>> {
        self.look_up(world_from_rig, gate_m, Sought::PlanesAndMeans)
    }

    /// The same, of planes alone: `None` where a point lies on none.
    pub fn find_planes(&mut self, world_from_rig: &Se3, gate_m: f64) -> Vec<Option<Match>> {
        self.look_up(world_from_rig, gate_m, Sought::Planes)
    }

    fn look_up(&mut self, world_from_rig: &Se3, gate_m: f64, sought: Sought) -> Vec<Option<Match>> {
        let map = self.map;
        let at = At {
            rotation: world_from_rig.rotation_matrix(),
            translation: &world_from_rig.translation,
            sensor: *world_from_rig * self.sensor_in_rig,
            gate_m,
            min_places: map.min_places(),
            sought,
        };
        let mut found = vec![None; self.points_in_rig.len()];
        found
            .par_chunks_mut(CHUNK)
            .zip(self.points_in_rig.par_chunks(CHUNK))
            .zip(self.remembered.par_iter_mut())
            .for_each(|((found, points), remembered)| {
                remembered.look_up(map, points, &at, found);
            });
        found
    }
}

impl Remembered {
    fn look_up(
        &mut self,
        map: &LocalMap,
        points_in_rig: &[Vector3<f64>],
        at: &At<'_>,
        found: &mut [Option<Match>],
    ) {
        let placed = points_in_rig.iter().map(|p| {
            let in_world = at.rotation * p + at.translation;
            Placed {
                in_world,
                in_grid: map.grid_from_world() * in_world,
                towards_sensor: at.sensor - in_world,
            }
        });
        let placed: Vec<Placed> = placed.collect();
        // Points that are on no plane yet.
        let mut left: Vec<usize> = (0..placed.len()).collect();
        let of_levels = self.cells.chunks_exact_mut(placed.len());
        for (level, cells) in map.levels().iter().zip(of_levels) {
            for k in &left {
                level.enter(&placed[*k].in_grid, &mut cells[*k]);
            }
            left.retain(|k| {
                let point = &placed[*k];
                let surface = level.surface(&cells[*k], &point.towards_sensor);
                let plane = surface.and_then(|s| s.plane_from(at.min_places));
                let distance_m = |off: Vector3<f64>, normal: &Vector3<f64>| normal.dot(&off).abs();
                let plane = plane.filter(|plane| {
                    distance_m(point.in_world - plane.point, &plane.normal) < at.gate_m
                });
                found[*k] = plane.map(Match::Plane);
                plane.is_none()
            });
        }
        let finest: Option<&Level> = map.levels().last();
        let Some(finest) = finest.filter(|_| at.sought == Sought::PlanesAndMeans) else {
            return;
        };
        for k in left {
            let Placed {
                in_world, in_grid, ..
            } = &placed[k];
            let near = &mut self.nearest[k];
            let mean = finest.nearest_mean(in_world, in_grid, at.gate_m, near);
            found[k] = mean.map(Match::Point);
        }
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector6;
    use rand::{RngExt, SeedableRng};

    use super::super::LocalMapConfig;
    use super::*;

    /// Naively what is remembered of the pose before is taken for what is there now.
    #[test]
    fn what_is_found_is_the_same_as_point_by_point() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut anywhere = |n: usize| -> Vec<Vector3<f64>> {
            let mut one = || Vector3::from_fn(|_, _| rng.random_range(-4.0..4.0));
            (0..n).map(|_| one()).collect()
        };
        let mut map = LocalMap::new(LocalMapConfig {
            cell_size_m: 1.0,
            levels: 3,
            range_noise_m: 0.03,
        });
        let sensor = Vector3::new(0.1, 0.0, 0.2);
        for k in 0..4 {
            let mut points = anywhere(1500);
            // Half of them on a wall.
            points.iter_mut().skip(700).for_each(|p| p.x = 6.0);
            let pose = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, 0.1 * f64::from(k), 0.0));
            map.insert(&points, &pose, &sensor);
        }
        let mut points = anywhere(600);
        points.iter_mut().skip(300).for_each(|p| p.x = 6.0);
        let mut finder = ScanFinder::new(&map, &points, &sensor);
        for k in 0..12 {
            let s = 0.02 * f64::from(k);
            let pose = Se3::exp(&Vector6::new(
                0.2 * s,
                -0.1 * s,
                0.2 * s,
                s,
                -0.5 * s,
                3.0 * s,
            ));
            let gate_m = [2.0, 0.7, 0.3][k as usize % 3];
            let expected: Vec<_> = points
                .iter()
                .map(|p| {
                    let in_world = pose.rotation_matrix() * p + pose.translation;
                    map.find(&in_world, &(pose * sensor - in_world), gate_m)
                })
                .collect();
            let planes = expected
                .iter()
                .filter(|m| matches!(m, Some(Match::Plane(_))));
            let planes = planes.count();
            assert!(planes > 50 && planes < 550, "{planes}");
            assert_eq!(finder.find_all(&pose, gate_m), expected, "{k}");
            let only = |m: Option<Match>| m.filter(|m| matches!(m, Match::Plane(_)));
            let expected: Vec<_> = expected.into_iter().map(only).collect();
            assert_eq!(finder.find_planes(&pose, gate_m), expected, "{k}");
        }
    }
}
