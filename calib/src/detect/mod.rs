//! Finding a [`Target`] in an image, to a few hundredths of a pixel.
//!
//! Every corner of either board is a saddle of brightness: dark and light meet in four sectors. So both are found alike:
//! `saddle` finds such points, `link` joins those that one straight edge connects, `checkerboard` walks the links as a
//! lattice, `charuco` reads the markers in its white squares, `april_grid` walks the links around dark squares and reads their
//! bits, `refine` measures the corners, and `saddle_fit` their last tenths of a pixel, once more when `bent_edges` knows how the lens bends
//! the edges.

mod april_grid;
mod bent_edges;
mod charuco;
mod checkerboard;
mod link;
mod refine;
mod saddle;
mod saddle_fit;

use lsfb_geometry::Vector2;
use lsfb_perception::image::Around;
use lsfb_types::Image;

use crate::board::Target;

/// A corner of the target as seen in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner {
    /// Number of the corner, see [`Target::corner`].
    pub index: usize,
    /// Where it is seen, pixels; (0, 0) is the centre of the first pixel.
    pub pixel: Vector2<f64>,
}

/// The corners of a target in an image, in order of their numbers; empty where it was not found. A checkerboard is found
/// whole or not at all, of an AprilGrid each tag for itself, of a ChArUco board each part in which a marker can be read.
pub fn detect(image: &Image, target: &Target) -> Vec<Corner> {
    let Some(gray) = saddle::Blurred::new(image) else {
        return Vec::new();
    };
    let mut saddles = saddle::find(&gray);
    if matches!(target, Target::Charuco { .. }) {
        saddle::leave_out_weak(&mut saddles, target.corner_count());
    }
    let links = link::join(&gray, &saddles);
    let mut corners = match *target {
        Target::AprilGrid { columns, rows, .. } => {
            april_grid::read(image, &saddles, &links, columns * rows)
        }
        Target::Checkerboard { columns, rows, .. } => {
            checkerboard::walk(&saddles, &links, columns as usize, rows as usize)
        }
        Target::Charuco {
            columns,
            rows,
            square_m,
            marker_m,
            dictionary,
        } => {
            let board = charuco::Layout {
                columns: columns as usize,
                rows: rows as usize,
                marker_share: marker_m / square_m,
                dictionary,
            };
            charuco::read(image, &saddles, &links, &board)
        }
    };
    corners.retain_mut(|seen| refine::refine(image, seen));
    let bends = bent_edges::bends(target, &corners);
    for (seen, bends) in corners.iter_mut().zip(&bends) {
        if *bends != bent_edges::STRAIGHT {
            refine::fit_sectors(image, seen, bends);
        }
    }
    let mut corners: Vec<Corner> = corners
        .into_iter()
        .map(|seen| Corner {
            index: seen.index,
            pixel: seen.pixel,
        })
        .collect();
    if matches!(target, Target::Checkerboard { .. }) && corners.len() != target.corner_count() {
        corners.clear();
    }
    corners.sort_by_key(|c| c.index);
    corners
}

/// What an image shows where the target is not found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instead {
    /// Its tags as in a mirror.
    Mirrored,
    /// Tags, but none of its own.
    OtherTags,
}

/// Tags that an image must show to say something.
const TAGS_TO_SAY: usize = 3;

/// What an image shows in which the target was not found; `None` where that is nothing that is known.
pub fn seen_instead(image: &Image, target: &Target) -> Option<Instead> {
    let Target::AprilGrid { columns, rows, .. } = *target else {
        return None;
    };
    let gray = saddle::Blurred::new(image)?;
    let saddles = saddle::find(&gray);
    let links = link::join(&gray, &saddles);
    match april_grid::strangers(image, &saddles, &links, columns * rows) {
        [mirrored, others] if mirrored >= TAGS_TO_SAY && mirrored > others => {
            Some(Instead::Mirrored)
        }
        [_, others] if others >= TAGS_TO_SAY => Some(Instead::OtherTags),
        _ => None,
    }
}

/// A corner on its way: with the length within which nothing else is seen.
struct RoughCorner {
    index: usize,
    pixel: Vector2<f64>,
    /// Half the edge of the window that holds this corner alone, pixels.
    clear_px: f64,
    /// Radius of the disc that holds this corner and its four edges alone, pixels.
    alone_px: f64,
    /// Directions of its two edges; `None` where no saddle was found.
    edges: Option<[Vector2<f64>; 2]>,
}

/// Share of the way to the next corner in which neither that nor its edges are seen, blurred as they are.
const ALONE: f64 = 0.8;

/// Brightness between pixels; `None` off the image.
fn sample(width: usize, values: &[f32], x: f64, y: f64) -> Option<f32> {
    Some(Around::new(width, values, &Vector2::new(x, y))?.value() as f32)
}
