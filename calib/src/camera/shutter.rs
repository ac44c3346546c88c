//! Rolling shutters before a lens is known: how corners move over the image, from the views before and after, says where they were when
//! the middle row was exposed.

use std::collections::BTreeMap;

use lsfb_geometry::Vector2;

use super::CameraViews;
use crate::detect::Corner;

/// Views are of one motion when they are no further apart, and no nearer, nanoseconds. Numbers of files are no times.
const MOST_NS: i64 = 250_000_000;
const LEAST_NS: i64 = 1_000_000;

/// Where a corner was, and when.
type CornerTime = (Vector2<f64>, f64);

/// Views as a global shutter would have them that exposes when the middle row was exposed. `readout_s` is the time from the first row to
/// one row below the last, zero for a global shutter. Corners that neither the view before nor the one after has are left out: nobody
/// knows how they moved. Over a tenth of a second boards that are moved slowly move evenly.
pub fn as_global_shutter(views: &CameraViews, readout_s: f64) -> CameraViews {
    if readout_s == 0.0 {
        return views.clone();
    }
    let row_s = readout_s / f64::from(views.height.max(1));
    let moved = views.views.iter().filter_map(|(instant, corners)| {
        let velocities = velocities(&views.views, *instant, row_s);
        let corners: Vec<Corner> = corners
            .iter()
            .filter_map(|corner| {
                let velocity = velocities.get(&corner.index)?;
                let late_s = row_s * (corner.pixel.y - 0.5 * (f64::from(views.height) - 1.0));
                Some(Corner {
                    pixel: corner.pixel - velocity * late_s,
                    ..*corner
                })
            })
            .collect();
        (!corners.is_empty()).then_some((*instant, corners))
    });
    CameraViews {
        name: views.name.clone(),
        views: moved.collect(),
        ..*views
    }
}

/// How fast the corners of a view move over the image, pixels per second, by their numbers; `row_s` is the time from one row to the
/// next.
pub(super) fn velocities(
    views: &BTreeMap<i64, Vec<Corner>>,
    instant: i64,
    row_s: f64,
) -> BTreeMap<usize, Vector2<f64>> {
    let near = |other: Option<(&i64, &Vec<Corner>)>| -> BTreeMap<usize, CornerTime> {
        let other = other.filter(|(at, _)| (LEAST_NS..=MOST_NS).contains(&(*at - instant).abs()));
        let Some((at, corners)) = other else {
            return BTreeMap::new();
        };
        let after_s = (at - instant) as f64 * 1e-9;
        let seen = |c: &Corner| (c.index, (c.pixel, after_s + row_s * c.pixel.y));
        corners.iter().map(seen).collect()
    };
    let before = near(views.range(..instant).next_back());
    let after = near(views.range(instant + 1..).next());
    let own = views.get(&instant).map(Vec::as_slice).unwrap_or_default();
    own.iter()
        .filter_map(|corner| {
            let here = (corner.pixel, row_s * corner.pixel.y);
            let speed = |from: &CornerTime, to: &CornerTime| (to.0 - from.0) / (to.1 - from.1);
            let velocity = match (before.get(&corner.index), after.get(&corner.index)) {
                // The slope at this instant of the parabola through all three.
                (Some(before), Some(after)) => {
                    let [past, next] = [speed(before, &here), speed(&here, after)];
                    let share = (here.1 - before.1) / (after.1 - before.1);
                    past * (1.0 - share) + next * share
                }
                (Some(before), None) => speed(before, &here),
                (None, Some(after)) => speed(&here, after),
                (None, None) => return None,
            };
            Some((corner.index, velocity))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A board of four corners that runs over the image, faster and faster, seen row by row.
    fn running(readout_s: f64) -> CameraViews {
        let row_s = readout_s / 480.0;
        let place = |index: usize, t: f64| {
            let corner = Vector2::new(
                100.0 + 60.0 * (index % 2) as f64,
                90.0 + 300.0 * (index / 2) as f64,
            );
            corner + Vector2::new(80.0, -35.0) * t + Vector2::new(30.0, 25.0) * (t * t)
        };
        let view = |k: i64| {
            let t = 0.1 * k as f64;
            let corners = (0..4).map(|index| {
                let mut late_s = 0.0;
                for _ in 0..20 {
                    late_s = row_s * (place(index, t + late_s).y - 239.5);
                }
                Corner {
                    index,
                    pixel: place(index, t + late_s),
                }
            });
            (k * 100_000_000, corners.collect())
        };
        CameraViews {
            name: "cam0".into(),
            width: 640,
            height: 480,
            images: 9,
            views: (0..9).map(view).collect(),
        }
    }

    #[test]
    fn corners_are_put_where_the_middle_row_saw_them() {
        let (rolling, global) = (running(0.024), running(0.0));
        let found = as_global_shutter(&rolling, 0.024);
        let apart = |a: &CameraViews, instant: i64| {
            let pairs = a.views[&instant].iter().zip(&global.views[&instant]);
            pairs
                .map(|(a, b)| (a.pixel - b.pixel).norm())
                .fold(0.0, f64::max)
        };
        for k in 1..8 {
            let instant = k * 100_000_000;
            let [before, after] = [&rolling, &found].map(|views| apart(views, instant));
            assert!(before > 0.4 && after < 0.01, "{k}: {before} px, {after} px");
        }
        assert_eq!(as_global_shutter(&rolling, 0.0), rolling);
    }

    /// Images that are numbered, and a single one, say nothing about motion.
    #[test]
    fn corners_of_which_nobody_knows_how_they_moved_are_left_out() {
        let mut numbered = running(0.024);
        numbered.views = (0..).zip(numbered.views.into_values()).collect();
        assert!(as_global_shutter(&numbered, 0.024).views.is_empty());
    }
}
