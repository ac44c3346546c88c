//! Corners followed from one image to the next: patches moved until they agree (Lucas and Kanade), coarse first, and back again:
//! what does not come back to where it began was not the same thing. What is lost is looked for again where its neighbours went.

use lsfb_geometry::{UnitQuaternion, Vector2, Vector3};
use nalgebra::Matrix2;

use super::alignment::{Alignment, Frame, align};
use super::corners::corners;
use super::gray::Gray;
use super::patch::{Patch, PatchSearch};

/// Share of a patch's variance that may be left where a corner is found.
const MOST_LEFT: f64 = 0.4;
/// A patch that does not change.
const STILL: Matrix2<f64> = Matrix2::new(1.0, 0.0, 0.0, 1.0);
/// Way there and back that still ends where it began, pixels.
const RETURN_PX: f64 = 0.3;
/// Gradients that a corner needs, grey levels squared: several times those of noise.
pub(super) const FAINT: f64 = 150.0;
/// Neighbours whose ways are tried for what was lost.
const NEIGHBOURS: usize = 3;

/// A corner in two images, as rays in either camera.
#[derive(Clone, Copy, Debug)]
pub struct Track {
    /// In the first camera, of length one.
    pub first: Vector3<f64>,
    /// In the second.
    pub second: Vector3<f64>,
}

/// Two images of a camera, a tenth of a second apart or so.
#[derive(Clone, Debug)]
pub struct Pair {
    /// When the first image was taken, seconds.
    pub from_s: f64,
    /// When the second one was.
    pub to_s: f64,
    /// As the images as a whole say it.
    pub b_from_a: UnitQuaternion<f64>,
    /// Corners seen in both.
    pub tracks: Vec<Track>,
}

impl Pair {
    /// `None` where the images do not fit.
    pub fn new(a: &Frame, b: &Frame) -> Option<Self> {
        let guess = align(a, b)?;
        Some(Self {
            from_s: a.time_s,
            to_s: b.time_s,
            b_from_a: guess.b_from_a,
            tracks: follow(a, b, &guess),
        })
    }
}

/// Corners of `a` that are found in `b`; `guess` says about where.
fn follow(a: &Frame, b: &Frame, guess: &Alignment) -> Vec<Track> {
    let (Some(fine_a), Some(fine_b)) = (a.fine.first(), b.fine.first()) else {
        return Vec::new();
    };
    let wanted: Vec<(Vector2<f64>, Vector2<f64>)> = corners(fine_a, FAINT)
        .into_iter()
        .filter_map(|corner| {
            let ray = fine_a.camera.unproject(&corner)?;
            let turned = guess.b_from_a * ray + guess.shift;
            Some((corner, fine_b.camera.project(&turned)?))
        })
        .collect();
    let mut found: Vec<Option<Vector2<f64>>> = wanted
        .iter()
        .map(|(corner, start)| {
            there_and_back(&a.fine, &b.fine, corner, start, a.fine.len(), &STILL)
        })
        .collect();
    let known: Vec<(Vector2<f64>, Vector2<f64>)> = wanted
        .iter()
        .zip(&found)
        .filter_map(|((corner, start), there)| Some((*corner, (*there)? - start)))
        .collect();
    for ((corner, start), there) in wanted.iter().zip(&mut found) {
        if there.is_none() {
            let mut near: Vec<(f64, Vector2<f64>)> = known
                .iter()
                .map(|(place, way)| ((place - corner).norm_squared(), *way))
                .collect();
            near.sort_by(|x, y| x.0.total_cmp(&y.0));
            *there = near.iter().take(NEIGHBOURS).find_map(|(_, way)| {
                there_and_back(&a.fine, &b.fine, corner, &(start + way), 2, &STILL)
            });
        }
    }
    wanted
        .iter()
        .zip(found)
        .filter_map(|((corner, _), there)| {
            Some(Track {
                first: fine_a.camera.unproject(corner)?.normalize(),
                second: fine_b.camera.unproject(&there?)?.normalize(),
            })
        })
        .collect()
}

/// Where a corner went, from some level on; `None` where it does not come back. `warp` is how the patch changes on the way: pixels there
/// by pixels here.
pub(super) fn there_and_back(
    a: &[Gray],
    b: &[Gray],
    corner: &Vector2<f64>,
    start: &Vector2<f64>,
    levels: usize,
    warp: &Matrix2<f64>,
) -> Option<Vector2<f64>> {
    let there = through(a, b, corner, start, levels, warp)?;
    let back = find(b.first()?, a.first()?, &there, corner, &warp.try_inverse()?)?;
    ((back - corner).norm() < RETURN_PX).then_some(there)
}

/// Coarse first: a level that shows nothing leaves the guess as it was.
fn through(
    first: &[Gray],
    second: &[Gray],
    from: &Vector2<f64>,
    start: &Vector2<f64>,
    levels: usize,
    warp: &Matrix2<f64>,
) -> Option<Vector2<f64>> {
    let mut at = *start;
    for level in (1..levels.min(first.len())).rev() {
        let factor = f64::from(1 << level);
        let smaller = |pixel: &Vector2<f64>| pixel.map(|c| (c + 0.5) / factor - 0.5);
        let (here, there) = (smaller(from), smaller(&at));
        let near = find(&first[level], &second[level], &here, &there, warp);
        at = near.map_or(at, |n| n.map(|c| factor * (c + 0.5) - 0.5));
    }
    find(first.first()?, second.first()?, from, &at, warp)
}

/// Where the patch around `from` in one image lies in another.
fn find(
    first: &Gray,
    second: &Gray,
    from: &Vector2<f64>,
    start: &Vector2<f64>,
    warp: &Matrix2<f64>,
) -> Option<Vector2<f64>> {
    let search = PatchSearch {
        there_by_here: *warp,
        most_left: MOST_LEFT,
    };
    Patch::new(first, from)?.find(second, start, &search)
}
