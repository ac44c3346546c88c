//! Space that scans saw to be empty.
//!
//! Rooms are alike, and a scan that has no place in the map yet may fit a wrong one with more than half of its points. What gives it away
//! there are rays: its points stand where earlier scans looked through, or its own rays pass through what earlier scans saw. So many of those
//! among all that both could see is the share that speaks against a place.

use std::collections::VecDeque;
use std::f64::consts::{PI, TAU};

use lsfb_geometry::{Se3, Vector3};

use crate::place_search::thinned;

/// Width and height of one cell of a panorama, radians: rings of a scanner are as near to each other where it looks at most.
const CELL_WIDE_RAD: f64 = TAU / COLUMNS as f64;
const CELL_HIGH_RAD: f64 = PI / ROWS as f64;
const COLUMNS: usize = 180;
const ROWS: usize = 180;
/// A ray passes a point where it ends so much behind it, metres and share of the range: poses are off by less, and what lies flat before the
/// sensor falls into neighbouring cells at ranges that differ by less.
pub(super) const PASSED_M: f64 = 0.3;
const PASSED_SHARE: f64 = 0.15;
/// Distance of the sensor between two scans that are kept, metres.
const APART_M: f64 = 0.5;
/// Scans kept, the newest.
const KEPT: usize = 64;
/// Fewer points that both could see tell nothing: they count as so many.
const LEAST_COMPARED: u32 = 100;
/// Points of a scan that are looked at.
const POINTS: usize = 500;

/// How far one scan saw, in the axes of the rig at its time, from its sensor.
#[derive(Clone, Debug)]
struct View {
    world_from_sensor: Se3,
    /// The nearest return in each cell, metres; infinite where there was none.
    nearest_m: Vec<f32>,
    /// Some of its points, metres.
    points: Vec<Vector3<f64>>,
}

impl View {
    fn new(
        points_in_rig: &[Vector3<f64>],
        sensor_in_rig: &Vector3<f64>,
        world_from_rig: &Se3,
    ) -> Self {
        let mut nearest_m = vec![f32::INFINITY; COLUMNS * ROWS];
        let points: Vec<_> = points_in_rig.iter().map(|p| p - sensor_in_rig).collect();
        for point in &points {
            let (column, row) = cell(point);
            let nearest = &mut nearest_m[row * COLUMNS + column];
            *nearest = nearest.min(point.norm() as f32);
        }
        Self {
            world_from_sensor: Se3::new(world_from_rig.rotation, *world_from_rig * *sensor_in_rig),
            nearest_m,
            points: thinned(&points, POINTS),
        }
    }

    /// Whether it looked through a point, or saw something there or before it; `None` where it did not look.
    fn passed(&self, in_sensor: &Vector3<f64>) -> Option<bool> {
        let (column, row) = cell(in_sensor);
        let rows = row.saturating_sub(1)..=(row + 1).min(ROWS - 1);
        let columns = [COLUMNS - 1, 0, 1].map(|shift| (column + shift) % COLUMNS);
        let around =
            rows.flat_map(|row| columns.map(|column| self.nearest_m[row * COLUMNS + column]));
        let nearest_m = f64::from(around.fold(f32::INFINITY, f32::min));
        let range_m = in_sensor.norm();
        if nearest_m.is_infinite() {
            return None;
        }
        // What is behind something it did not see.
        let is_hidden = range_m > nearest_m * (1.0 + PASSED_SHARE) + PASSED_M;
        (!is_hidden).then_some(range_m * (1.0 + PASSED_SHARE) + PASSED_M < nearest_m)
    }
}

/// Column and row of a direction.
fn cell(direction: &Vector3<f64>) -> (usize, usize) {
    let azimuth = direction.y.atan2(direction.x) + PI;
    let elevation = direction.z.atan2(direction.x.hypot(direction.y)) + PI / 2.0;
    let column = (azimuth / CELL_WIDE_RAD) as usize % COLUMNS;
    (column, ((elevation / CELL_HIGH_RAD) as usize).min(ROWS - 1))
}

/// What earlier scans saw.
#[derive(Clone, Debug, Default)]
pub(super) struct FreeSpace {
    views: VecDeque<View>,
}

/// Points that two scans could both see, and those of them at which one saw nothing and the other something.
#[derive(Clone, Copy, Debug, Default)]
struct Count {
    compared: u32,
    contradicted: u32,
}

impl Count {
    fn take(&mut self, passed: Option<bool>) {
        self.compared += u32::from(passed.is_some());
        self.contradicted += u32::from(passed == Some(true));
    }

    fn share(&self) -> f64 {
        f64::from(self.contradicted) / f64::from(self.compared.max(LEAST_COMPARED))
    }
}

/// What speaks against a scan at a place.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Contradictions {
    /// Points of the scan, in the rays of earlier ones.
    points: Count,
    /// Points of earlier scans, in its rays.
    rays: Count,
}

impl Contradictions {
    /// The larger share of the two, 0–1.
    pub fn share(&self) -> f64 {
        self.points.share().max(self.rays.share())
    }
}

impl FreeSpace {
    /// Takes in a scan at its place.
    pub fn insert(
        &mut self,
        points_in_rig: &[Vector3<f64>],
        sensor_in_rig: &Vector3<f64>,
        world_from_rig: &Se3,
    ) {
        let place = *world_from_rig * *sensor_in_rig;
        let is_near = |view: &View| (view.world_from_sensor.translation - place).norm() < APART_M;
        if self.views.iter().any(is_near) {
            return;
        }
        if self.views.len() == KEPT {
            self.views.pop_front();
        }
        let view = View::new(points_in_rig, sensor_in_rig, world_from_rig);
        self.views.push_back(view);
    }

    /// What speaks against a scan at a place, where `is_on_map` tells of a point whether the map has it: it is no contradiction then.
    pub fn contradictions(
        &self,
        points_in_rig: &[Vector3<f64>],
        sensor_in_rig: &Vector3<f64>,
        world_from_rig: &Se3,
        is_on_map: impl Fn(&Vector3<f64>) -> bool,
    ) -> Contradictions {
        let here = View::new(points_in_rig, sensor_in_rig, world_from_rig);
        let points = here.points.iter();
        let points: Vec<_> = points
            .map(|p| (p, is_on_map(&(here.world_from_sensor * *p))))
            .collect();
        let mut found = Contradictions::default();
        for view in &self.views {
            let there_from_here = view.world_from_sensor.inverse() * here.world_from_sensor;
            for (point, is_on_map) in &points {
                let passed = view.passed(&(there_from_here * **point));
                found.points.take(passed.map(|passed| passed && !is_on_map));
            }
            let here_from_there = there_from_here.inverse();
            for point in &view.points {
                found.rays.take(here.passed(&(here_from_there * *point)));
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::UnitQuaternion;

    use super::*;

    /// What a scanner sees from inside a box between two corners.
    fn seen(low: [f64; 3], high: [f64; 3], from: [f64; 3]) -> Vec<Vector3<f64>> {
        let elevations = (-25..=15).map(|e| f64::from(e).to_radians());
        let rays = elevations.flat_map(|e| {
            (0..360).map(move |a| {
                let a = f64::from(a).to_radians();
                Vector3::new(e.cos() * a.cos(), e.cos() * a.sin(), e.sin())
            })
        });
        let range = |ray: &Vector3<f64>| {
            let to = |k: usize| {
                let wall = if ray[k] > 0.0 { high[k] } else { low[k] };
                (wall - from[k]) / ray[k]
            };
            (0..3).map(to).fold(f64::INFINITY, f64::min)
        };
        rays.map(|ray| ray * range(&ray)).collect()
    }

    fn at(place: [f64; 3]) -> Se3 {
        Se3::new(UnitQuaternion::identity(), place.into())
    }

    /// Two rooms of one width and height, one of 9 m and one of 5 m: most of the scan of either lies on the walls of the other.
    #[test]
    fn a_scan_of_a_shorter_room_contradicts_a_long_one_and_the_other_way_round() {
        let (low, long, short) = ([-2.0, -2.0, -1.5], [7.0, 2.0, 1.1], [3.0, 2.0, 1.1]);
        let sensor = Vector3::zeros();
        let share = |map: [f64; 3], room: [f64; 3]| {
            let mut space = FreeSpace::default();
            for x in [0.0, 0.7, 1.5] {
                let place = [x, 0.2, 0.0];
                space.insert(&seen(low, map, place), &sensor, &at(place));
            }
            assert_eq!(space.views.len(), 3);
            let place = [0.4, -0.3, 0.0];
            let is_on_map = |p: &Vector3<f64>| {
                let walls = [
                    p.y + 2.0,
                    p.y - 2.0,
                    p.z + 1.5,
                    p.z - 1.1,
                    p.x + 2.0,
                    p.x - map[0],
                ];
                walls.iter().any(|d| d.abs() < 0.1)
            };
            let scan = seen(low, room, place);
            space.contradictions(&scan, &sensor, &at(place), is_on_map)
        };
        assert_eq!(share(long, long).share(), 0.0);
        // A wall in the middle of the room that was there, and rays through the wall that was there.
        let shorter = share(long, short);
        assert!(
            shorter.points.share() > 0.03 && shorter.rays.share() < 0.01,
            "{shorter:?}"
        );
        let longer = share(short, long);
        assert!(
            longer.rays.share() > 0.03 && longer.points.share() < 0.01,
            "{longer:?}"
        );
    }

    #[test]
    fn what_no_scan_saw_contradicts_nothing() {
        let mut space = FreeSpace::default();
        let scan = seen([-2.0; 3], [2.0; 3], [0.0; 3]);
        let sensor = Vector3::zeros();
        let nothing = |_: &Vector3<f64>| false;
        let against = |space: &FreeSpace, x: f64| {
            let place = at([x, 0.0, 0.0]);
            space
                .contradictions(&scan, &sensor, &place, nothing)
                .share()
        };
        assert_eq!(against(&space, 0.0), 0.0);
        space.insert(&scan, &sensor, &at([0.0; 3]));
        assert_eq!(against(&space, 0.0), 0.0);
        // Next door, behind the wall.
        assert_eq!(against(&space, 30.0), 0.0);
        assert!(against(&space, 1.0) > 0.05);
        assert_eq!(
            space
                .contradictions(&[], &sensor, &at([0.0; 3]), nothing)
                .share(),
            0.0
        );
    }

    #[test]
    fn the_newest_scans_are_kept() {
        let mut space = FreeSpace::default();
        let scan = seen([-2.0; 3], [2.0; 3], [0.0; 3]);
        for k in 0..100 {
            space.insert(&scan, &Vector3::zeros(), &at([f64::from(k), 0.0, 0.0]));
        }
        assert_eq!(space.views.len(), KEPT);
        assert_eq!(space.views[0].world_from_sensor.translation.x, 36.0);
    }
}
