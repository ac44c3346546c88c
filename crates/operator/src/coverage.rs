//! How well each place was seen, and where to go back.
//!
//! A place is a square of the floor plan with structure above it. It was seen well when a camera faced it from near by for
//! long enough and from different sides; a place that has been in view for a while without that is thin. Thin places that
//! hang together make a spot to go back to.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

/// What counts as seen well.
#[derive(Clone, Debug, PartialEq)]
pub struct CoverageConfig {
    /// Edge of a square, metres.
    pub cell_m: f64,
    /// A camera resolves what is nearer than this, metres.
    pub near_m: f64,
    /// Structure farther than this belongs to another place, metres.
    pub far_m: f64,
    /// Views from near by that are enough.
    pub views: u32,
    /// Directions, of eight, from which they must come.
    pub directions: u32,
    /// How long a place must have been in view before it is called thin, seconds.
    pub patience_s: f64,
    /// Smallest area worth going back for, square metres.
    pub spot_m2: f64,
    /// Most spots shown.
    pub spots: usize,
}

impl Default for CoverageConfig {
    fn default() -> Self {
        Self {
            cell_m: 0.5,
            near_m: 6.0,
            far_m: 15.0,
            views: 10,
            directions: 2,
            patience_s: 12.0,
            spot_m2: 1.5,
            spots: 5,
        }
    }
}

/// A camera, seen from above.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewer {
    /// Direction it looks in, radians counter-clockwise from the rig's x axis.
    pub yaw_rad: f64,
    /// Half of its horizontal field of view, radians.
    pub half_fov_rad: f64,
}

/// What a spot lacks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reason {
    /// It was seen from afar only.
    Far,
    /// It was near, but no camera faced it for long.
    Unfaced,
    /// It was seen from one side only.
    OneSided,
}

/// A spot to go back to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GoBack {
    /// Where it is in the live map, metres.
    pub x_m: f64,
    /// Where it is in the live map, metres.
    pub y_m: f64,
    /// Its area, square metres.
    pub area_m2: f64,
    /// What it lacks.
    pub reason: Reason,
}

/// Index of a square.
pub(crate) type Cell = [i32; 2];

#[derive(Clone, Copy, Debug, Default)]
struct CellViews {
    first_s: f64,
    near: u32,
    faced: u32,
    /// One bit per direction of view.
    directions: u8,
}

/// From where structure is looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Standpoint {
    pub x_m: f64,
    pub y_m: f64,
    pub yaw_rad: f64,
    pub time_s: f64,
}

/// Takes note of what is seen.
#[derive(Clone, Debug)]
pub(crate) struct Coverage {
    config: CoverageConfig,
    cells: BTreeMap<Cell, CellViews>,
    now_s: f64,
}

/// Whether a place was seen well.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Quality {
    Good,
    /// Too early to tell.
    Fresh,
    Thin(Reason),
}

impl Coverage {
    pub fn new(config: CoverageConfig) -> Self {
        Self {
            config,
            cells: BTreeMap::new(),
            now_s: 0.0,
        }
    }

    /// The square of a point.
    pub fn cell(&self, x_m: f64, y_m: f64) -> Cell {
        [x_m, y_m].map(|v| (v / self.config.cell_m).floor() as i32)
    }

    fn centre(&self, cell: Cell) -> [f64; 2] {
        cell.map(|v| (f64::from(v) + 0.5) * self.config.cell_m)
    }

    /// Notes one look at structure in `cells`. Without cameras every direction is faced.
    pub fn look(&mut self, from: Standpoint, viewers: &[Viewer], cells: &BTreeSet<Cell>) {
        self.now_s = from.time_s;
        for &cell in cells {
            let [x_m, y_m] = self.centre(cell);
            let (dx_m, dy_m) = (x_m - from.x_m, y_m - from.y_m);
            let range_m = dx_m.hypot(dy_m);
            if range_m > self.config.far_m {
                continue;
            }
            let bearing_rad = dy_m.atan2(dx_m);
            let seen = self.cells.entry(cell).or_insert(CellViews {
                first_s: from.time_s,
                ..CellViews::default()
            });
            if range_m > self.config.near_m {
                continue;
            }
            seen.near = seen.near.saturating_add(1);
            let faces = |viewer: &Viewer| {
                let off = bearing_rad - from.yaw_rad - viewer.yaw_rad;
                let off = off.sin().atan2(off.cos());
                off.abs() <= viewer.half_fov_rad
            };
            if viewers.is_empty() || viewers.iter().any(faces) {
                seen.faced = seen.faced.saturating_add(1);
                let octant = (bearing_rad / std::f64::consts::FRAC_PI_4).floor() as i32;
                seen.directions |= 1 << octant.rem_euclid(8);
            }
        }
    }

    /// How well a square was seen; `None` where nothing is.
    pub fn quality(&self, cell: Cell) -> Option<Quality> {
        Some(self.judge(self.cells.get(&cell)?))
    }

    fn judge(&self, seen: &CellViews) -> Quality {
        let config = &self.config;
        if seen.faced >= config.views && seen.directions.count_ones() >= config.directions {
            return Quality::Good;
        }
        if self.now_s - seen.first_s < config.patience_s {
            return Quality::Fresh;
        }
        Quality::Thin(if seen.near < config.views {
            Reason::Far
        } else if seen.faced < config.views {
            Reason::Unfaced
        } else {
            Reason::OneSided
        })
    }

    /// Area of all squares and of those seen well, square metres.
    pub fn areas_m2(&self) -> Areas {
        let square_m2 = self.config.cell_m * self.config.cell_m;
        let good = self
            .cells
            .values()
            .filter(|s| self.judge(s) == Quality::Good);
        Areas {
            seen_m2: self.cells.len() as f64 * square_m2,
            good_m2: good.count() as f64 * square_m2,
        }
    }

    /// Where to go back to, the largest spot first.
    pub fn go_back(&self) -> Vec<GoBack> {
        let thin = self.cells.iter().filter_map(|(cell, seen)| {
            let Quality::Thin(reason) = self.judge(seen) else {
                return None;
            };
            Some((*cell, reason))
        });
        let mut left: BTreeMap<Cell, Reason> = thin.collect();
        let mut spots = Vec::new();
        while let Some((first, reason)) = left.pop_first() {
            let mut spot = vec![(first, reason)];
            let mut next = 0;
            while let Some(&([x, y], _)) = spot.get(next) {
                next += 1;
                for (dx, dy) in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy))) {
                    let cell = [x + dx, y + dy];
                    if let Some(reason) = left.remove(&cell) {
                        spot.push((cell, reason));
                    }
                }
            }
            spots.extend(self.spot(&spot));
        }
        spots.sort_by(|a, b| b.area_m2.total_cmp(&a.area_m2));
        spots.truncate(self.config.spots);
        spots
    }

    fn spot(&self, cells: &[(Cell, Reason)]) -> Option<GoBack> {
        let area_m2 = cells.len() as f64 * self.config.cell_m * self.config.cell_m;
        if area_m2 < self.config.spot_m2 {
            return None;
        }
        let centres = cells.iter().map(|(cell, _)| self.centre(*cell));
        let sum = centres
            .clone()
            .fold([0.0, 0.0], |s, c| [s[0] + c[0], s[1] + c[1]]);
        let mean = sum.map(|v| v / cells.len() as f64);
        // The square nearest to the middle: of a bent spot the middle may lie elsewhere.
        let distance = |c: &[f64; 2]| (c[0] - mean[0]).hypot(c[1] - mean[1]);
        let at = centres.min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        let count = |reason| cells.iter().filter(|(_, r)| *r == reason).count();
        let reasons = [Reason::OneSided, Reason::Unfaced, Reason::Far];
        let reason = reasons.into_iter().max_by_key(|r| count(*r))?;
        Some(GoBack {
            x_m: at[0],
            y_m: at[1],
            area_m2,
            reason,
        })
    }
}

/// Areas of a floor plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Areas {
    pub seen_m2: f64,
    pub good_m2: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    const AHEAD: Viewer = Viewer {
        yaw_rad: 0.0,
        half_fov_rad: 0.8,
    };

    fn wall(coverage: &Coverage, x_m: f64) -> BTreeSet<Cell> {
        (0..8)
            .map(|i| coverage.cell(x_m, -2.0 + 0.5 * f64::from(i)))
            .collect()
    }

    /// Walks along y = −3 … 3 at x = 0, looking along `yaw_rad`, a look every 0.1 s.
    fn walk(coverage: &mut Coverage, cells: &BTreeSet<Cell>, yaw_rad: f64) {
        for step in 0..60 {
            let from = Standpoint {
                x_m: 0.0,
                y_m: -3.0 + 0.1 * f64::from(step),
                yaw_rad,
                time_s: coverage.now_s + 0.1,
            };
            coverage.look(from, &[AHEAD], cells);
        }
    }

    fn wait(coverage: &mut Coverage) {
        let from = Standpoint {
            x_m: 100.0,
            y_m: 0.0,
            yaw_rad: 0.0,
            time_s: coverage.now_s + 20.0,
        };
        coverage.look(from, &[AHEAD], &BTreeSet::new());
    }

    #[test]
    fn a_wall_passed_by_a_camera_is_good_and_others_say_what_they_lack() {
        for (x_m, yaw_rad, expected) in [
            (3.0, 0.0, None),
            (3.0, std::f64::consts::PI, Some(Reason::Unfaced)),
            (9.0, 0.0, Some(Reason::Far)),
        ] {
            let mut coverage = Coverage::new(CoverageConfig::default());
            let cells = wall(&coverage, x_m);
            walk(&mut coverage, &cells, yaw_rad);
            assert!(coverage.go_back().is_empty(), "too early to tell");
            wait(&mut coverage);
            let spots = coverage.go_back();
            assert_eq!(spots.first().map(|s| s.reason), expected, "{x_m} {yaw_rad}");
            let areas = coverage.areas_m2();
            assert_eq!(areas.seen_m2, 2.0);
            assert_eq!(areas.good_m2, if expected.is_none() { 2.0 } else { 0.0 });
            if let Some(spot) = spots.first() {
                assert_eq!(spot.area_m2, 2.0);
                assert!(
                    (spot.x_m - x_m).abs() <= 0.5 && spot.y_m.abs() <= 0.5,
                    "{spot:?}"
                );
            }
        }
    }

    #[test]
    fn standing_still_sees_one_side() {
        let mut coverage = Coverage::new(CoverageConfig::default());
        // All in one octant.
        let cells: BTreeSet<_> = (0..8).map(|i| [6 + i, 1 + i / 4]).collect();
        for step in 0..50 {
            let from = Standpoint {
                x_m: 0.0,
                y_m: 0.0,
                yaw_rad: 0.0,
                time_s: 0.1 * f64::from(step),
            };
            coverage.look(from, &[], &cells);
        }
        wait(&mut coverage);
        let spots = coverage.go_back();
        assert_eq!(
            spots.first().map(|s| s.reason),
            Some(Reason::OneSided),
            "{spots:?}"
        );
    }
}
