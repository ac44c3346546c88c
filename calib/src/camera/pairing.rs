//! Which images of two cameras belong together: not those of one camera with themselves, nor those of neighbouring instants.

use std::collections::BTreeMap;

use lsfb_geometry::Se3;
use lsfb_types::median;

use super::CameraViews;
use super::pose_choice::{most_central, spread};
use crate::Error;

/// Median distance of corners below which two cameras show the same images, pixels: no two cameras stand in one place.
const SAME_PX: f64 = 0.5;
/// Corners that both must show to say so.
const LEAST_CORNERS: usize = 20;
/// Instants by which pairs are tried to be shifted.
const MOST_SHIFTED: i64 = 3;
/// Instants that must still be shared then.
const LEAST_SHARED: usize = 4;
/// Spread of relative poses with pairs shifted, as a share of that without, at which they are.
const SHIFTED: f64 = 0.2;

/// Fails where two cameras were given the same images.
pub(crate) fn expect_different_images<'a>(
    cameras: impl IntoIterator<Item = &'a CameraViews>,
) -> Result<(), Error> {
    let cameras: Vec<&CameraViews> = cameras.into_iter().collect();
    for (k, first) in cameras.iter().enumerate() {
        for second in &cameras[k + 1..] {
            if show_the_same(first, second) {
                return Err(Error::SameImages {
                    first: first.name.clone(),
                    second: second.name.clone(),
                });
            }
        }
    }
    Ok(())
}

fn show_the_same(first: &CameraViews, second: &CameraViews) -> bool {
    let mut apart_px: Vec<f64> = Vec::new();
    for (instant, corners) in &first.views {
        let others = second.views.get(instant).into_iter().flatten();
        let by_index: BTreeMap<usize, _> = others.map(|c| (c.index, c.pixel)).collect();
        let both = corners
            .iter()
            .filter_map(|c| Some((by_index.get(&c.index)? - c.pixel).norm()));
        apart_px.extend(both);
    }
    apart_px.len() >= LEAST_CORNERS && median(apart_px).is_some_and(|px| px < SAME_PX)
}

/// By how many instants the images of another camera come after those of the first one they belong to; `None` where they belong to
/// those of their own instant. From poses of the target in both.
pub(super) fn shift(
    first_from_target: &BTreeMap<i64, Se3>,
    other_from_target: &BTreeMap<i64, Se3>,
) -> Option<i64> {
    let shared: Vec<(Se3, Se3)> = other_from_target
        .iter()
        .filter_map(|(t, other)| Some((*first_from_target.get(t)?, *other)))
        .collect();
    let spread_of = |by: i64| {
        let poses: Vec<Se3> = (0..shared.len() as i64)
            .filter_map(|k| {
                let first = shared.get(usize::try_from(k - by).ok()?)?.0;
                Some(shared[k as usize].1 * first.inverse())
            })
            .collect();
        (poses.len() >= LEAST_SHARED).then(|| spread(&poses))
    };
    let as_named = spread_of(0)?;
    (-MOST_SHIFTED..=MOST_SHIFTED)
        .filter(|by| *by != 0)
        .filter_map(|by| Some((by, spread_of(by)?)))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .filter(|(_, least)| *least < SHIFTED * as_named)
        .map(|(by, _)| by)
}

/// How many times nearer a relative pose must be to the others' inverse than to the others, and how many must be so: by then it was
/// the other camera that took the image.
const NEARER: f64 = 5.0;
const LEAST_EXCHANGED: usize = 2;
/// Median distance of the others from each other, as a share of how far these are off: a pair that hardly differs says nothing.
const ALIKE: f64 = 0.2;

/// Instants at which the images of two cameras were exchanged: each then stands to the other as the other does to it at all others.
/// None where fewer than two are so, or where it is so of most: they are then the pair that was meant.
pub(super) fn exchanged(
    first_from_target: &BTreeMap<i64, Se3>,
    other_from_target: &BTreeMap<i64, Se3>,
) -> Vec<i64> {
    let relative: Vec<(i64, Se3)> = other_from_target
        .iter()
        .filter_map(|(t, other)| Some((*t, *other * first_from_target.get(t)?.inverse())))
        .collect();
    let distance = |a: &Se3, b: &Se3| (a.inverse() * *b).log().norm();
    // Of the pair itself or of the exchanged one, whichever is more often: both are one after the other.
    let Some(usual) = most_central(&relative.iter().map(|r| r.1).collect::<Vec<_>>()) else {
        return Vec::new();
    };
    let is_exchanged =
        |pose: &Se3| NEARER * distance(&pose.inverse(), &usual) < distance(pose, &usual);
    type Poses = Vec<(i64, Se3)>;
    let (exchanged, usually): (Poses, Poses) =
        relative.into_iter().partition(|r| is_exchanged(&r.1));
    let usually: Vec<Se3> = usually.iter().map(|r| r.1).collect();
    let far = exchanged.iter().map(|r| distance(&r.1, &usual));
    let nearest = far.fold(f64::INFINITY, f64::min);
    if exchanged.len() < LEAST_EXCHANGED || spread(&usually) > ALIKE * nearest {
        return Vec::new();
    }
    exchanged.into_iter().map(|r| r.0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::Corner;
    use lsfb_geometry::{Vector2, Vector6};

    fn views(name: &str, shift_px: f64) -> CameraViews {
        let corner = |index: usize, instant: i64| Corner {
            index,
            pixel: Vector2::new(index as f64 * 9.0 + shift_px, 3.0 * instant as f64),
        };
        CameraViews {
            name: name.to_owned(),
            width: 640,
            height: 480,
            images: 5,
            views: (0..5)
                .map(|t| (t, (0..10).map(|k| corner(k, t)).collect()))
                .collect(),
        }
    }

    #[test]
    fn one_camera_twice_is_refused() {
        let error = expect_different_images(&[views("left", 0.0), views("right", 0.0)])
            .expect_err("the same images")
            .to_string();
        assert!(
            error.contains("left and right: they show the same images"),
            "{error}"
        );
        expect_different_images(&[views("left", 0.0), views("right", 4.0)]).expect("two cameras");
    }

    /// A board in motion.
    fn pose(t: i64) -> Se3 {
        let t = t as f64;
        let turn = [0.3 * t.sin(), 0.2 * (1.7 * t).cos(), 0.1 * t.cos()];
        Se3::exp(&Vector6::new(
            turn[0],
            turn[1],
            turn[2],
            0.1 * t.sin(),
            0.05 * t.cos(),
            0.6,
        ))
    }

    fn other_from_first() -> Se3 {
        Se3::exp(&Vector6::new(0.01, 0.02, 0.0, -0.1, 0.0, 0.0))
    }

    #[test]
    fn pairs_that_are_shifted_are_found() {
        let first: BTreeMap<i64, Se3> = (0..12).map(|t| (t, pose(t))).collect();
        for by in [-2, -1, 1, 2] {
            let other = (0..12)
                .map(|t| (t, other_from_first() * pose(t - by)))
                .collect();
            assert_eq!(shift(&first, &other), Some(by));
        }
        let other = (0..12).map(|t| (t, other_from_first() * pose(t))).collect();
        assert_eq!(shift(&first, &other), None);
        // A board at rest says nothing.
        let still: BTreeMap<i64, Se3> = (0..12).map(|t| (t, pose(3))).collect();
        assert_eq!(shift(&still, &still), None);
    }

    /// Each camera alone is met well: both lenses are of a kind.
    #[test]
    fn pairs_that_are_exchanged_part_of_the_time_are_found() {
        let other = |t| other_from_first() * pose(t);
        let seen = |is_exchanged: &dyn Fn(i64) -> bool| -> [BTreeMap<i64, Se3>; 2] {
            let of = |first: bool| {
                let pose_of = |t| match is_exchanged(t) == first {
                    true => other(t),
                    false => pose(t),
                };
                (0..12).map(|t| (t, pose_of(t))).collect()
            };
            [of(true), of(false)]
        };
        let found = |is_exchanged: &dyn Fn(i64) -> bool| {
            let [first, second] = seen(is_exchanged);
            exchanged(&first, &second)
        };
        assert!(found(&|_| false).is_empty());
        assert!(found(&|_| true).is_empty());
        assert_eq!(found(&|t| t >= 8), [8, 9, 10, 11]);
        assert_eq!(found(&|t| t == 3 || t == 7), [3, 7]);
        assert_eq!(found(&|t| t % 2 == 0).len(), 6);
        // Two places that are alike: nobody knows which was which.
        let near: BTreeMap<i64, Se3> = (0..12)
            .map(|t| {
                let off = Vector6::repeat(1e-3 * (t as f64).sin());
                (t, Se3::exp(&off) * pose(t))
            })
            .collect();
        let first: BTreeMap<i64, Se3> = (0..12).map(|t| (t, pose(t))).collect();
        assert!(exchanged(&first, &near).is_empty());
    }
}
