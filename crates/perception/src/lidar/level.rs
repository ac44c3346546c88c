//! The surfaces of a map in cubic cells of one size.
//!
//! Cells are asked for far more often than there are any, and most of them have one side alone: so cells hold the places of their surfaces in a
//! list and nothing else, and looking for one touches a few bytes.

use lsfb_geometry::{Se3, Vector3};

use super::plane::{Plane, PointSums};
use super::voxels::{CellMap, cell_key, neighbour_key};

/// Beyond this a cell is known well enough; later scans would only smear it with their own pose errors.
const MAX_POINTS_PER_SURFACE: u32 = 1000;
/// Fewer points do not make a plane.
const MIN_POINTS_PER_PLANE: u32 = 6;
/// Points that one place may add to a surface: standing still must not fill it.
const MAX_POINTS_PER_PLACE: u32 = 250;
/// Sine of the least angle between a plane and the rays that see it: the returns of one ring alone spread along their
/// rays by noise, and would show a plane through the sensor.
const MIN_SLANT: f64 = 0.1;
/// The farthest neighbour searched, in cells.
const MAX_NEIGHBOUR_CELLS: i64 = 4;
/// Neighbours of a cell along one axis, the nearest first.
const OUTWARDS: [i64; 2 * MAX_NEIGHBOUR_CELLS as usize + 1] = [0, -1, 1, -2, 2, -3, 3, -4, 4];

/// The points of one surface in one cell. What is asked of it first stands together at its begin, as memory comes in pieces: most surfaces are full, and
/// take no more.
#[derive(Clone, Debug, Default)]
#[repr(C)]
pub(super) struct Surface {
    /// Direction that tells its points from those of the other side.
    facing: Vector3<f64>,
    /// Places it was seen from, the first and the last of them.
    places: u32,
    pub first_place: u32,
    last_place: u32,
    /// Points added from that place, and in all.
    count_here: u32,
    count: u32,
    /// Points at the last plane fit.
    fitted_count: u32,
    plane: Option<Plane>,
    /// Sum of the unit directions towards the sensor.
    towards_sensor: Vector3<f64>,
    sums: PointSums,
}

impl Surface {
    /// Its plane, if it was seen from enough places.
    pub fn plane_from(&self, min_places: u32) -> Option<Plane> {
        self.plane.filter(|_| self.places >= min_places)
    }

    fn add(&mut self, point: &Vector3<f64>, towards_sensor: &Vector3<f64>) {
        self.sums.add(point);
        self.count += 1;
        self.count_here += 1;
        self.towards_sensor += towards_sensor;
        self.face();
    }

    /// Without a plane it faces where it was seen from.
    fn face(&mut self) {
        self.facing = self.plane.map_or(self.towards_sensor, |p| p.normal);
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

    fn is_full(&self) -> bool {
        self.count >= MAX_POINTS_PER_SURFACE || self.count_here >= MAX_POINTS_PER_PLACE
    }

    fn needs_fit(&self) -> bool {
        self.count >= MIN_POINTS_PER_PLANE && self.count * 10 >= self.fitted_count * 12
    }

    fn fit(&mut self, cell_size_m: f64, range_noise_m: f64) {
        self.fitted_count = self.count;
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
        self.face();
    }
}

/// A point of a scan, as all levels take it.
#[derive(Clone, Copy, Debug)]
pub(super) struct ScanPoint {
    pub point: Vector3<f64>,
    /// The same in the axes of the grid.
    pub in_grid: Vector3<f64>,
    /// Unit vector.
    pub towards_sensor: Vector3<f64>,
}

impl ScanPoint {
    /// A point of a scan taken from a sensor.
    pub fn from(sensor: &Vector3<f64>, point: Vector3<f64>, in_grid: Vector3<f64>) -> Self {
        Self {
            point,
            in_grid,
            towards_sensor: (sensor - point).normalize(),
        }
    }
}

/// Where the surfaces of a cell are: the first seen, and one that faces the other way.
type Sides = [u32; 2];
/// Points whose cells are looked up before they are taken in.
const AHEAD: usize = 64;
/// No surface.
pub(super) const NONE: u32 = u32::MAX;

/// A cell, and the surfaces in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    key: u64,
    sides: Sides,
}

impl Default for Cell {
    /// None: keys have 63 bits.
    fn default() -> Self {
        Self {
            key: u64::MAX,
            sides: [NONE; 2],
        }
    }
}

/// The cells of one size.
#[derive(Clone, Debug)]
pub(super) struct Level {
    size_m: f64,
    sides_of: CellMap<Sides>,
    surfaces: Vec<Surface>,
    /// Those of the surfaces that are forgotten.
    free: Vec<u32>,
}

impl Level {
    /// Without cells.
    pub fn new(size_m: f64) -> Self {
        Self {
            size_m,
            sides_of: CellMap::default(),
            surfaces: Vec::new(),
            free: Vec::new(),
        }
    }

    /// Edge of its cells, metres.
    pub fn size_m(&self) -> f64 {
        self.size_m
    }

    /// How many cells hold something.
    pub fn len(&self) -> usize {
        self.sides_of.len()
    }

    fn key(&self, in_grid: &Vector3<f64>) -> u64 {
        cell_key(in_grid, 1.0 / self.size_m)
    }

    /// Of the sides of a cell the one seen from direction `towards_sensor`.
    fn side(&self, sides: &Sides, towards_sensor: &Vector3<f64>) -> usize {
        let first = self.surfaces.get(sides[0] as usize);
        usize::from(first.is_some_and(|first| first.facing.dot(towards_sensor) < 0.0))
    }

    /// Takes in the points of a scan that was taken from a place.
    pub fn insert(&mut self, seen: &[ScanPoint], place: u32, range_noise_m: f64) {
        let mut cells = [Cell::default(); AHEAD];
        for seen in seen.chunks(AHEAD) {
            self.go_ahead(seen, &mut cells);
            for (of, cell) in seen.iter().zip(&cells) {
                self.take_in(of, cell, place, range_noise_m);
            }
        }
    }

    /// Looks up the cells of points that are to be taken in: what takes long is waiting for memory, and so it is waited for many of them at once.
    fn go_ahead(&self, seen: &[ScanPoint], cells: &mut [Cell; AHEAD]) {
        let mut here = Cell::default();
        let mut points = 0_u32;
        for (of, cell) in seen.iter().zip(cells) {
            // Neighbours of a ring mostly lie in one cell.
            self.enter(&of.in_grid, &mut here);
            let first = self.surfaces.get(here.sides[0] as usize);
            points = points.wrapping_add(first.map_or(0, |first| first.count));
            *cell = here;
        }
        std::hint::black_box(points);
    }

    /// Takes in a point of a cell as it was a little before.
    fn take_in(&mut self, of: &ScanPoint, cell: &Cell, place: u32, range_noise_m: f64) {
        let Cell { key, mut sides } = *cell;
        let mut side = self.side(&sides, &of.towards_sensor);
        if sides[side] == NONE {
            // Others of these points may have made it meanwhile.
            sides = self.sides_of.get(&key).copied().unwrap_or([NONE; 2]);
            side = self.side(&sides, &of.towards_sensor);
        }
        if sides[side] == NONE {
            sides[side] = self.new_surface();
            self.sides_of.insert(key, sides);
        }
        let Some(surface) = self.surfaces.get_mut(sides[side] as usize) else {
            return;
        };
        surface.enter(place);
        if surface.is_full() {
            return;
        }
        surface.add(&of.point, &of.towards_sensor);
        if surface.needs_fit() {
            surface.fit(self.size_m, range_noise_m);
        }
    }

    fn new_surface(&mut self) -> u32 {
        self.free.pop().unwrap_or_else(|| {
            self.surfaces.push(Surface::default());
            (self.surfaces.len() - 1) as u32
        })
    }

    /// Goes to the cell of a point, if it is not there.
    pub fn enter(&self, in_grid: &Vector3<f64>, cell: &mut Cell) {
        let key = self.key(in_grid);
        if cell.key != key {
            let sides = self.sides_of.get(&key).copied().unwrap_or([NONE; 2]);
            *cell = Cell { key, sides };
        }
    }

    /// The surface in a cell that is seen from a direction.
    pub fn surface(&self, cell: &Cell, towards_sensor: &Vector3<f64>) -> Option<&Surface> {
        let side = self.side(&cell.sides, towards_sensor);
        self.surfaces.get(cell.sides[side] as usize)
    }

    /// The surface at a point that is seen from a direction: `None` without a cell there, and inside `None` where nothing in it was seen
    /// from that side.
    pub fn find(
        &self,
        in_grid: &Vector3<f64>,
        towards_sensor: &Vector3<f64>,
    ) -> Option<Option<&Surface>> {
        let sides = self.sides_of.get(&self.key(in_grid))?;
        let side = self.side(sides, towards_sensor);
        Some(self.surfaces.get(sides[side] as usize))
    }

    /// The nearest mean of a cell's points, of its first side, nearer than `gate_m`. `near` is the surface that had the nearest mean where the point was before,
    /// if there is one: it is the nearest still unless one is nearer, so that most cells need not be looked into. It becomes the one found.
    pub fn nearest_mean(
        &self,
        point: &Vector3<f64>,
        in_grid: &Vector3<f64>,
        gate_m: f64,
        near: &mut u32,
    ) -> Option<Vector3<f64>> {
        let farthest = (gate_m / self.size_m).ceil() as i64;
        let reach = farthest.clamp(1, MAX_NEIGHBOUR_CELLS);
        let around = OUTWARDS.get(..=2 * reach as usize)?;
        // As the key has it.
        let in_cells = in_grid * (1.0 / self.size_m);
        let within = in_cells - in_cells.map(f64::floor);
        // A mean lies in the cell of its points: nearer than the cell it cannot be.
        let squared_gap = |axis: usize, steps: i64| {
            let cells = match steps {
                0 => 0.0,
                1.. => steps as f64 - within[axis],
                _ => within[axis] - (steps + 1) as f64,
            };
            (cells * self.size_m).powi(2)
        };
        let key = self.key(in_grid);
        let mut squared = gate_m * gate_m;
        let mut best = None;
        // Where all cells within the gate are looked into, that of the former mean is one of them.
        let before = self.surfaces.get(*near as usize);
        if let Some(surface) = before.filter(|_| farthest <= MAX_NEIGHBOUR_CELLS) {
            let mean = surface.sums.mean();
            let of_mean = (mean - point).norm_squared();
            if of_mean < squared {
                // Of two that are equally near the first counts, whichever that is.
                squared = of_mean.next_up();
                best = Some(mean);
            }
        }
        if best.is_none() {
            *near = NONE;
        }
        for dx in around {
            let of_x = squared_gap(0, *dx);
            if of_x > squared {
                continue;
            }
            for dy in around {
                let of_y = of_x + squared_gap(1, *dy);
                if of_y > squared {
                    continue;
                }
                for dz in around {
                    if of_y + squared_gap(2, *dz) > squared {
                        continue;
                    }
                    let sides = self.sides_of.get(&neighbour_key(key, [*dx, *dy, *dz]));
                    let Some(sides) = sides else {
                        continue;
                    };
                    let Some(first) = self.surfaces.get(sides[0] as usize) else {
                        continue;
                    };
                    let mean = first.sums.mean();
                    let of_mean = (mean - point).norm_squared();
                    if of_mean < squared {
                        squared = of_mean;
                        best = Some(mean);
                        *near = sides[0];
                    }
                }
            }
        }
        best
    }

    /// Forgets what is farther than `range_m` from `centre`.
    pub fn forget_beyond(&mut self, centre: &Vector3<f64>, range_m: f64) {
        let (surfaces, free) = (&mut self.surfaces, &mut self.free);
        self.sides_of.retain(|_, sides| {
            let first = surfaces.get(sides[0] as usize);
            let is_near = first.is_some_and(|s| (s.sums.first() - centre).norm() < range_m);
            if !is_near {
                for side in sides {
                    if let Some(surface) = surfaces.get_mut(*side as usize) {
                        *surface = Surface::default();
                        free.push(*side);
                    }
                }
            }
            is_near
        });
    }

    /// Its cells with the planes of both sides that were seen from enough places, where there is one.
    pub fn into_planes(self, min_places: u32) -> CellMap<[Option<Plane>; 2]> {
        let flat = self.sides_of.iter().filter_map(|(key, sides)| {
            let plane = |side: u32| self.surfaces.get(side as usize)?.plane_from(min_places);
            let planes = sides.map(plane);
            planes.iter().any(Option::is_some).then_some((*key, planes))
        });
        let mut planes: CellMap<[Option<Plane>; 2]> = flat.collect();
        planes.shrink_to_fit();
        planes
    }
}

/// The points of a scan at a pose, in a grid.
pub(super) fn seen_from(
    points_in_rig: &[Vector3<f64>],
    world_from_rig: &Se3,
    sensor: &Vector3<f64>,
    grid_from_world: &lsfb_geometry::Matrix3<f64>,
) -> Vec<ScanPoint> {
    let rotation = world_from_rig.rotation_matrix();
    let points = points_in_rig.iter().map(|p| {
        let point = rotation * p + world_from_rig.translation;
        ScanPoint::from(sensor, point, grid_from_world * point)
    });
    points.collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use rand::{RngExt, SeedableRng};

    use super::*;

    fn seen(point: Vector3<f64>) -> ScanPoint {
        ScanPoint {
            point,
            in_grid: point,
            towards_sensor: Vector3::z(),
        }
    }

    #[test]
    fn the_nearest_mean_is_the_nearest_of_all() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let mut anywhere = || Vector3::from_fn(|_, _| rng.random_range(-2.0..2.0));
        let points: Vec<_> = (0..1500).map(|_| anywhere()).collect();
        let mut level = Level::new(0.25);
        level.insert(
            &points.iter().copied().map(seen).collect::<Vec<_>>(),
            1,
            0.02,
        );
        let mut cells: BTreeMap<u64, PointSums> = BTreeMap::new();
        for point in &points {
            let sums = cells.entry(cell_key(point, 4.0)).or_default();
            sums.add(point);
        }
        for gate_m in [0.1, 0.3, 0.9] {
            for _ in 0..200 {
                let from = anywhere();
                let means = cells.values().map(PointSums::mean);
                let distance = |mean: &Vector3<f64>| (mean - from).norm();
                let nearest = means.min_by(|a, b| distance(a).total_cmp(&distance(b)));
                let expected = nearest.filter(|mean| distance(mean) < gate_m);
                assert_eq!(
                    level.nearest_mean(&from, &from, gate_m, &mut NONE.clone()),
                    expected
                );
            }
        }
    }

    #[test]
    fn what_is_forgotten_makes_room() {
        let mut level = Level::new(0.25);
        for lap in 0..5 {
            let far = f64::from(lap) * 100.0;
            let wall = (0..40).map(|k| seen(Vector3::new(far, 0.1 * f64::from(k), 0.3)));
            level.insert(&wall.collect::<Vec<_>>(), 1, 0.02);
            level.forget_beyond(&Vector3::new(far, 0.0, 0.0), 10.0);
            assert!(level.len() < 20 && level.surfaces.len() < 40);
        }
    }
}
