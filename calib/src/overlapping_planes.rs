//! What the LiDAR saw of a place: planes in small cells, each fitted to all returns around the cell, so that no wall is cut in two by
//! a cell's border.

use lsfb_geometry::{Matrix6, Se3, Vector3, Vector6};
use lsfb_perception::lidar::{
    CellMap, Match, Plane, PointSums, PosePrior, Registration, RegistrationConfig, Weighting,
    cell_key, neighbour_key, register,
};
use lsfb_perception::statistics::median;
use rayon::prelude::*;

/// Edge of a cell, metres; a plane is fitted to those around it too.
const CELL_M: f64 = 0.16;
/// What is a plane in and around a cell: returns, and how thick and wide they lie at most and at least, standard deviations in
/// metres.
const MIN_RETURNS: u32 = 12;
const THICK_M: f64 = 0.05;
const WIDE_M: f64 = 0.06;
/// A plane that landmarks may lie on: more returns, all around, and no thicker than this many times the usual plane.
const GOOD_RETURNS: u32 = 40;
const GOOD_WIDE_M: f64 = 0.09;
const GOOD_THICKNESS: f64 = 1.25;
/// A cell that is no plane hides what is behind it where it has this share of a usual cell's returns.
const HIDES: f64 = 0.1;
/// Where things may be seen, metres from the camera, and the step along a ray.
const NEAR_M: f64 = 0.5;
const FAR_M: f64 = 30.0;
const STEP_M: f64 = 0.5 * CELL_M;
/// A ray that meets a plane more aslant than this cosine says little of where.
const LEAST_COSINE: f64 = 0.25;

/// Returns that must lie on planes.
const MIN_MATCHES: f64 = 150.0;
/// How scans are put onto planes.
const REGISTRATION: RegistrationConfig = RegistrationConfig {
    max_iterations: 10,
    // Cells say what is near: nothing is gained by a narrower one.
    gate_m: 0.75,
    min_kernel_m: 0.25,
    // Least spread of returns about a plane.
    range_noise_m: 0.008,
    point_noise_m: 0.1,
    points_per_independent: 1.0,
    weighting: Weighting::ByPlane { deviations: 2.5 },
};

/// A plane through the returns in and around a cell.
#[derive(Clone, Copy)]
struct Fitted {
    plane: Plane,
    returns: u32,
}

/// Returns by cell, with the planes asked for so far.
#[derive(Default)]
pub(crate) struct OverlappingPlanesBuilder {
    cells: CellMap<PointSums>,
    planes: CellMap<Option<Fitted>>,
}

/// All planes of a place, when nothing is added to it any more.
pub(crate) struct OverlappingPlanes {
    planes: CellMap<Option<Fitted>>,
    own_counts: CellMap<u32>,
    usual_thickness_m: f64,
    usual_count: f64,
}

fn cell_of(place: &Vector3<f64>) -> u64 {
    cell_key(place, 1.0 / CELL_M)
}

fn middle_of_cell(place: &Vector3<f64>) -> Vector3<f64> {
    place.map(|x| ((x / CELL_M).floor() + 0.5) * CELL_M)
}

/// The pose at which returns lie on planes, with what they say of it; `None` where too few do. `expected`: by how much, in radians
/// and metres, it is expected to be elsewhere than `start`.
pub(crate) fn register_to_planes(
    returns: &[Vector3<f64>],
    start: Se3,
    expected: [f64; 2],
    mut plane: impl FnMut(&Vector3<f64>) -> Option<Plane>,
) -> Option<(Se3, Matrix6<f64>)> {
    let information = Vector6::from_fn(|k, _| expected[k / 3].powi(-2));
    let prior = PosePrior {
        world_from_rig: start,
        information: Matrix6::from_diagonal(&information),
    };
    let found: Registration = register(returns, &prior, &REGISTRATION, |pose, _| {
        let planes = returns.iter().map(|p| plane(&(*pose * *p)));
        planes.map(|p| p.map(Match::Plane)).collect()
    });
    let inliers = found.inlier_ratio * returns.len() as f64;
    (inliers >= MIN_MATCHES).then_some((found.world_from_rig, found.information))
}

impl OverlappingPlanesBuilder {
    /// Adds returns; planes known so far are forgotten.
    pub fn add(&mut self, returns: impl Iterator<Item = Vector3<f64>>) {
        self.planes.clear();
        for place in returns {
            self.cells.entry(cell_of(&place)).or_default().add(&place);
        }
    }

    /// The plane near a place; `None` where there is none.
    pub fn plane(&mut self, place: &Vector3<f64>) -> Option<Plane> {
        let cell = cell_of(place);
        let known = self.planes.get(&cell).copied();
        let fitted = known.unwrap_or_else(|| {
            let fitted = self.fitted(cell);
            self.planes.insert(cell, fitted);
            fitted
        });
        fitted.map(|f| f.plane)
    }

    fn fitted(&self, cell: u64) -> Option<Fitted> {
        let mut all = PointSums::default();
        for x in -1..=1 {
            for y in -1..=1 {
                for z in -1..=1 {
                    if let Some(sums) = self.cells.get(&neighbour_key(cell, [x, y, z])) {
                        all.add_all(sums);
                    }
                }
            }
        }
        if all.count() < MIN_RETURNS {
            return None;
        }
        let plane = all.plane()?;
        (plane.thickness_m < THICK_M && plane.breadth_m > WIDE_M).then(|| Fitted {
            plane,
            returns: all.count(),
        })
    }

    /// All planes at once.
    pub fn finish(self) -> OverlappingPlanes {
        let mut cells: Vec<u64> = self.cells.keys().copied().collect();
        cells.sort_unstable();
        let planes: Vec<(u64, Option<Fitted>)> = cells
            .par_iter()
            .map(|cell| (*cell, self.fitted(*cell)))
            .collect();
        let known = planes.iter().filter_map(|(_, f)| f.as_ref());
        let good = known.filter(|f| f.is_good());
        let thicknesses = good.map(|f| f.plane.thickness_m).collect();
        let counts = planes.iter().filter(|(_, f)| f.is_some());
        let counts = counts.map(|(cell, _)| f64::from(self.cells[cell].count()));
        OverlappingPlanes {
            usual_thickness_m: median(thicknesses).unwrap_or(0.0),
            usual_count: median(counts.collect()).unwrap_or(0.0),
            own_counts: self.cells.iter().map(|(c, s)| (*c, s.count())).collect(),
            planes: planes.into_iter().collect(),
        }
    }
}

impl Fitted {
    /// Whether landmarks may lie on it, as far as returns go.
    fn is_good(&self) -> bool {
        self.returns >= GOOD_RETURNS && self.plane.breadth_m > GOOD_WIDE_M
    }
}

impl OverlappingPlanes {
    /// The plane near a place; `None` where there is none.
    pub fn plane(&self, place: &Vector3<f64>) -> Option<Plane> {
        Some(self.planes.get(&cell_of(place))?.as_ref()?.plane)
    }

    /// How many cells hold a plane.
    pub fn planes(&self) -> usize {
        self.planes.values().flatten().count()
    }

    /// The plane that a ray meets first, and where; `None` where that is not a plane, or not known.
    pub fn first_hit(
        &self,
        origin: &Vector3<f64>,
        ray: &Vector3<f64>,
    ) -> Option<(Vector3<f64>, &Plane)> {
        let mut along_m = NEAR_M;
        while along_m < FAR_M {
            let place = origin + ray * along_m;
            let cell = cell_of(&place);
            along_m += STEP_M;
            let Some(fitted) = self.planes.get(&cell) else {
                continue;
            };
            let Some(fitted) = fitted else {
                if f64::from(self.own_counts[&cell]) > HIDES * self.usual_count {
                    return None;
                }
                continue;
            };
            let plane = &fitted.plane;
            let cosine = plane.normal.dot(ray);
            let hit = origin + ray * (plane.normal.dot(&(plane.point - origin)) / cosine);
            if !((hit - middle_of_cell(&place)).amax() < 0.6 * CELL_M) {
                continue;
            }
            let good = fitted.is_good()
                && plane.thickness_m < GOOD_THICKNESS * self.usual_thickness_m
                && cosine.abs() > LEAST_COSINE;
            return good.then_some((hit, plane));
        }
        None
    }
}
