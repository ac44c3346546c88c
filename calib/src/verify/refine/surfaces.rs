//! What the LiDAR saw of a place: planes in small cells, each fitted to all returns around the cell, so that no wall is cut in two by
//! a cell's border.

use std::collections::HashMap;

use lsfb_geometry::Vector3;
use rayon::prelude::*;

use super::super::moments::{Limits, Moments};

/// Edge of a cell, metres; a plane is fitted to those around it too.
const CELL_M: f64 = 0.16;
/// What is a plane in and around a cell.
const LIMITS: Limits = Limits {
    min_returns: 12.0,
    thick_m: 0.05,
    wide_m: 0.06,
};
/// A plane that landmarks may lie on: more returns, all around, and no thicker than this many times the usual plane.
const GOOD_RETURNS: f64 = 40.0;
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

type Cell = [i32; 3];

/// A plane through returns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    pub place: Vector3<f64>,
    pub normal: Vector3<f64>,
    /// Standard deviation of the returns from it, metres.
    pub thickness_m: f64,
    wide_m: f64,
    count: f64,
}

/// Returns by cell, with the planes asked for so far.
#[derive(Default)]
pub(super) struct Surfaces {
    cells: HashMap<Cell, Moments>,
    planes: HashMap<Cell, Option<Plane>>,
}

/// Surfaces that nothing is added to any more.
pub(super) struct Place {
    planes: HashMap<Cell, Option<Plane>>,
    own_counts: HashMap<Cell, f64>,
    usual_thickness_m: f64,
    usual_count: f64,
}

fn cell_of(place: &Vector3<f64>) -> Cell {
    std::array::from_fn(|k| (place[k] / CELL_M).floor() as i32)
}

fn middle_of(cell: &Cell) -> Vector3<f64> {
    Vector3::from_fn(|k, _| (f64::from(cell[k]) + 0.5) * CELL_M)
}

impl Surfaces {
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
        if let Some(known) = self.planes.get(&cell) {
            return *known;
        }
        let plane = self.fitted(&cell);
        self.planes.insert(cell, plane);
        plane
    }

    fn fitted(&self, cell: &Cell) -> Option<Plane> {
        let mut all = Moments::default();
        for x in -1..=1 {
            for y in -1..=1 {
                for z in -1..=1 {
                    let beside = [cell[0] + x, cell[1] + y, cell[2] + z];
                    if let Some(moments) = self.cells.get(&beside) {
                        all.merge(moments);
                    }
                }
            }
        }
        let fitted = all.plane(&LIMITS)?;
        Some(Plane {
            place: fitted.place,
            normal: fitted.normal,
            thickness_m: fitted.thickness_m,
            wide_m: fitted.wide_m,
            count: all.count,
        })
    }

    /// All planes at once.
    pub fn finish(self) -> Place {
        let mut cells: Vec<Cell> = self.cells.keys().copied().collect();
        cells.sort_unstable();
        let planes: Vec<(Cell, Option<Plane>)> = cells
            .par_iter()
            .map(|cell| (*cell, self.fitted(cell)))
            .collect();
        let wide = |p: &&Plane| p.count >= GOOD_RETURNS && p.wide_m > GOOD_WIDE_M;
        let known = || planes.iter().filter_map(|(_, p)| p.as_ref()).filter(wide);
        let median = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(0.0)
        };
        let counts = planes.iter().filter(|(_, p)| p.is_some());
        Place {
            usual_thickness_m: median(known().map(|p| p.thickness_m).collect()),
            usual_count: median(counts.map(|(c, _)| self.cells[c].count).collect()),
            own_counts: self.cells.iter().map(|(c, m)| (*c, m.count)).collect(),
            planes: planes.into_iter().collect(),
        }
    }
}

impl Place {
    /// The plane near a place; `None` where there is none.
    pub fn plane(&self, place: &Vector3<f64>) -> Option<&Plane> {
        self.planes.get(&cell_of(place))?.as_ref()
    }

    /// How many cells hold a plane.
    pub fn planes(&self) -> usize {
        self.planes.values().flatten().count()
    }

    /// The plane that a ray meets first, and where; `None` where that is not a plane, or not known.
    pub fn met(&self, origin: &Vector3<f64>, ray: &Vector3<f64>) -> Option<(Vector3<f64>, &Plane)> {
        let mut along_m = NEAR_M;
        while along_m < FAR_M {
            let cell = cell_of(&(origin + ray * along_m));
            along_m += STEP_M;
            let Some(plane) = self.planes.get(&cell) else {
                continue;
            };
            let Some(plane) = plane else {
                if self.own_counts[&cell] > HIDES * self.usual_count {
                    return None;
                }
                continue;
            };
            let cosine = plane.normal.dot(ray);
            let hit = origin + ray * (plane.normal.dot(&(plane.place - origin)) / cosine);
            if !((hit - middle_of(&cell)).amax() < 0.6 * CELL_M) {
                continue;
            }
            let good = plane.count >= GOOD_RETURNS
                && plane.wide_m > GOOD_WIDE_M
                && plane.thickness_m < GOOD_THICKNESS * self.usual_thickness_m
                && cosine.abs() > LEAST_COSINE;
            return good.then_some((hit, plane));
        }
        None
    }
}
