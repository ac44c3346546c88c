//! The floor plan that grows while one walks.

use std::collections::{BTreeMap, BTreeSet};

use lsfb_geometry::{Se3, Vector3};
use lsfb_types::Timestamp;

use crate::coverage::{Coverage, CoverageConfig, Quality, Standpoint, Viewer};
use crate::state::{CoverageState, PoseState};

/// How the floor plan is drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct MapConfig {
    /// Edge of a square, metres.
    pub cell_m: f64,
    /// Structure higher than this above the floor of its square is a wall or furniture, metres.
    pub wall_m: f64,
    /// Points higher than this above the rig are the ceiling, metres.
    pub above_m: f64,
    /// Points lower than this below the rig belong to the floor below, metres.
    pub below_m: f64,
    /// Distance between two points of the path, metres.
    pub step_m: f64,
    /// What counts as seen well.
    pub coverage: CoverageConfig,
}

impl Default for MapConfig {
    /// For a rig on a person's back.
    fn default() -> Self {
        Self {
            cell_m: 0.2,
            wall_m: 0.5,
            above_m: 0.6,
            below_m: 2.4,
            step_m: 0.1,
            coverage: CoverageConfig::default(),
        }
    }
}

/// Grows from registered scans.
#[derive(Clone, Debug)]
pub struct LiveMap {
    config: MapConfig,
    viewers: Vec<Viewer>,
    cells: BTreeMap<[i32; 2], Column>,
    coverage: Coverage,
    path: Vec<[f32; 2]>,
    path_m: f64,
    pose: Option<PoseState>,
    start: Option<Timestamp>,
    version: u32,
    generation: u32,
}

/// What was measured above one square.
#[derive(Clone, Copy, Debug)]
struct Column {
    lowest_m: f32,
    highest_m: f32,
    shown: Shade,
    version: u32,
}

/// How a square is drawn; the numbers are those of the page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
enum Shade {
    Floor = 0,
    /// Structure, seen well or too new to tell.
    Wall = 1,
    /// Structure that was seen thinly.
    Thin = 2,
}

impl LiveMap {
    /// An empty map for a rig with these cameras.
    pub fn new(config: MapConfig, viewers: Vec<Viewer>) -> Self {
        Self {
            coverage: Coverage::new(config.coverage.clone()),
            config,
            viewers,
            cells: BTreeMap::new(),
            path: Vec::new(),
            path_m: 0.0,
            pose: None,
            start: None,
            version: 0,
            generation: 0,
        }
    }

    /// Forgets everything: another recording begins, with these cameras.
    pub fn restart(&mut self, viewers: Vec<Viewer>) {
        *self = Self {
            generation: self.generation + 1,
            ..Self::new(self.config.clone(), viewers)
        };
    }

    /// Forgets everything: the walk began otherwise than was thought.
    pub fn begin_again(&mut self) {
        let viewers = std::mem::take(&mut self.viewers);
        self.restart(viewers);
    }

    /// Takes a registered scan: its points in the rig frame, and the pose of the rig then.
    pub fn push(&mut self, time: Timestamp, world_from_rig: &Se3, points_in_rig: &[Vector3<f64>]) {
        self.version += 1;
        let version = self.version;
        let rig = world_from_rig.translation;
        let forward = world_from_rig.rotation * Vector3::x();
        let start = *self.start.get_or_insert(time);
        let from = Standpoint {
            x_m: rig.x,
            y_m: rig.y,
            yaw_rad: forward.y.atan2(forward.x),
            time_s: time.secs_since(start),
        };
        let mut structure = BTreeSet::new();
        for point in points_in_rig {
            let point = world_from_rig.rotation * point + rig;
            let height_m = point.z - rig.z;
            if !(-self.config.below_m..=self.config.above_m).contains(&height_m) {
                continue;
            }
            let cell = [point.x, point.y].map(|v| (v / self.config.cell_m).floor() as i32);
            let column = self.cells.entry(cell).or_insert(Column {
                lowest_m: point.z as f32,
                highest_m: point.z as f32,
                shown: Shade::Floor,
                version,
            });
            column.lowest_m = column.lowest_m.min(point.z as f32);
            column.highest_m = column.highest_m.max(point.z as f32);
            if f64::from(column.highest_m - column.lowest_m) >= self.config.wall_m {
                structure.insert(self.coverage.cell(point.x, point.y));
                if column.shown == Shade::Floor {
                    column.shown = Shade::Wall;
                    column.version = version;
                }
            }
        }
        self.coverage.look(from, &self.viewers, &structure);
        self.step(from, rig.z);
    }

    fn step(&mut self, at: Standpoint, z_m: f64) {
        if let Some(last) = self.pose {
            self.path_m += (at.x_m - last.x_m).hypot(at.y_m - last.y_m);
        }
        self.pose = Some(PoseState {
            x_m: at.x_m,
            y_m: at.y_m,
            z_m,
            yaw_rad: at.yaw_rad,
        });
        let here = [at.x_m as f32, at.y_m as f32];
        let moved = self.path.last().is_none_or(|last| {
            f64::from((here[0] - last[0]).hypot(here[1] - last[1])) >= self.config.step_m
        });
        if moved {
            self.path.push(here);
        }
    }

    /// Where the rig is.
    pub fn pose(&self) -> Option<PoseState> {
        self.pose
    }

    /// Length of the path, metres.
    pub fn path_m(&self) -> f64 {
        self.path_m
    }

    /// How well the place was seen.
    pub fn coverage(&self) -> CoverageState {
        let areas = self.coverage.areas_m2();
        CoverageState {
            seen_m2: areas.seen_m2,
            good_m2: areas.good_m2,
            go_back: self.coverage.go_back(),
        }
    }

    /// The map as it is now, for the page. What was seen thinly, or is so no longer, is drawn anew.
    pub fn snapshot(&mut self) -> MapSnapshot {
        self.version += 1;
        let (cell_m, version) = (self.config.cell_m, self.version);
        for (cell, column) in &mut self.cells {
            if column.shown == Shade::Floor {
                continue;
            }
            let [x_m, y_m] = cell.map(|v| (f64::from(v) + 0.5) * cell_m);
            let quality = self.coverage.quality(self.coverage.cell(x_m, y_m));
            let shade = match quality {
                Some(Quality::Thin(_)) => Shade::Thin,
                _ => Shade::Wall,
            };
            if shade != column.shown {
                (column.shown, column.version) = (shade, version);
            }
        }
        MapSnapshot {
            generation: self.generation,
            version,
            cell_m: cell_m as f32,
            cells: self
                .cells
                .iter()
                .filter_map(|(cell, column)| {
                    let [x, y] = cell.map(i16::try_from);
                    Some(ShownCell {
                        x: x.ok()?,
                        y: y.ok()?,
                        shade: column.shown as u8,
                        version: column.version,
                    })
                })
                .collect(),
            path: self.path.clone(),
        }
    }
}

/// The map at one instant.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapSnapshot {
    generation: u32,
    version: u32,
    cell_m: f32,
    cells: Vec<ShownCell>,
    path: Vec<[f32; 2]>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct ShownCell {
    x: i16,
    y: i16,
    shade: u8,
    version: u32,
}

/// What a client has of a map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Shown {
    /// Whether it has anything at all.
    begun: bool,
    generation: u32,
    version: u32,
    path_points: usize,
}

impl MapSnapshot {
    /// What a client lacks: little-endian `u8` 1, `u8` 1 where it must forget what it has, `u16` 0, `f32` edge of a square in
    /// metres, `u32` squares, `u32` points of the path; squares of `i16` x, `i16` y, `u8` shade, `u8` 0; points of `f32` x,
    /// `f32` y. `None`: nothing.
    pub(crate) fn news(&self, shown: &mut Shown) -> Option<Vec<u8>> {
        let anew = !shown.begun || shown.generation != self.generation;
        if anew {
            *shown = Shown {
                begun: true,
                generation: self.generation,
                ..Shown::default()
            };
        }
        let cells = || self.cells.iter().filter(|c| c.version > shown.version);
        let path = self.path.get(shown.path_points..).unwrap_or_default();
        let count = cells().count();
        if !anew && count == 0 && path.is_empty() {
            return None;
        }
        let mut bytes = Vec::with_capacity(16 + 6 * count + 8 * path.len());
        bytes.extend([1, u8::from(anew), 0, 0]);
        bytes.extend(self.cell_m.to_le_bytes());
        bytes.extend((count as u32).to_le_bytes());
        bytes.extend((path.len() as u32).to_le_bytes());
        for cell in cells() {
            bytes.extend(cell.x.to_le_bytes());
            bytes.extend(cell.y.to_le_bytes());
            bytes.extend([cell.shade, 0]);
        }
        for point in path {
            bytes.extend(point.iter().flat_map(|v| v.to_le_bytes()));
        }
        shown.version = self.version;
        shown.path_points = self.path.len();
        Some(bytes)
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::UnitQuaternion;

    use super::*;

    /// A wall 3 m ahead, 4 m wide, and the floor before it.
    fn scan() -> Vec<Vector3<f64>> {
        let wall = (0..40).flat_map(|i| {
            (0..10).map(move |k| {
                Vector3::new(3.0, -2.0 + 0.1 * f64::from(i), -1.2 + 0.15 * f64::from(k))
            })
        });
        let floor = (0..20).map(|i| Vector3::new(1.0 + 0.1 * f64::from(i), 0.0, -1.3));
        wall.chain(floor).collect()
    }

    fn pose(y_m: f64) -> Se3 {
        Se3::new(UnitQuaternion::identity(), Vector3::new(0.0, y_m, 1.3))
    }

    fn shades(bytes: &[u8]) -> Vec<u8> {
        let count = u32::from_le_bytes(bytes[8..12].try_into().unwrap()) as usize;
        bytes[16..16 + 6 * count]
            .chunks(6)
            .map(|cell| cell[4])
            .collect()
    }

    #[test]
    fn a_client_gets_the_whole_map_once_and_then_what_is_new() {
        let mut map = LiveMap::new(MapConfig::default(), Vec::new());
        map.push(Timestamp::from_nanos(0), &pose(0.0), &scan());
        let mut shown = Shown::default();
        let first = map.snapshot().news(&mut shown).unwrap();
        assert_eq!(first[1], 1);
        assert!(shades(&first).contains(&0) && shades(&first).contains(&1));
        assert_eq!(map.snapshot().news(&mut shown), None);
        // A step aside, and nothing new: one more point of the path.
        map.push(Timestamp::from_nanos(1), &pose(0.3), &[]);
        let second = map.snapshot().news(&mut shown).unwrap();
        assert_eq!((second.len(), second[1]), (16 + 8, 0));
        assert!((map.path_m() - 0.3).abs() < 1e-12);
        // Passed over quickly and left alone: thin.
        map.push(Timestamp::from_nanos(30_000_000_000), &pose(0.3), &[]);
        let third = map.snapshot().news(&mut shown).unwrap();
        assert!(shades(&third).iter().all(|shade| *shade == 2));
        let coverage = map.coverage();
        assert_eq!(coverage.go_back.len(), 1, "{coverage:?}");
        map.restart(Vec::new());
        let cleared = map.snapshot().news(&mut shown).unwrap();
        assert_eq!((cleared.len(), cleared[1]), (16, 1));
    }

    #[test]
    fn a_map_without_limits_is_cut_where_the_page_ends() {
        let mut map = LiveMap::new(MapConfig::default(), Vec::new());
        let far = [
            Vector3::new(1e9, 0.0, 0.0),
            Vector3::new(f64::NAN, 0.0, 0.0),
        ];
        map.push(Timestamp::from_nanos(0), &pose(0.0), &far);
        let bytes = map.snapshot().news(&mut Shown::default()).unwrap();
        assert!(shades(&bytes).len() <= 1);
    }
}
