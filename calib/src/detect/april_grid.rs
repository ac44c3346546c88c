//! Tags: dark squares between four saddles, with bits inside.

use std::collections::BTreeMap;

use lsfb_geometry::{Matrix3, Vector2, Vector3};
use lsfb_types::Image;
use nalgebra::{SMatrix, SVector};

use super::link::Links;
use super::saddle::Saddle;
use super::{ALONE, RoughCorner, sample};
use crate::board::{BORDER_BITS, CODE_BITS, EDGE_BITS, tag_codes};

/// White bits that a tag has at least.
const LEAST_WHITE: usize = 6;
/// Wrong bits forgiven; codes of the family differ by 11.
const MAX_WRONG: u32 = 3;

/// The corners of all tags with numbers below `tags`.
pub(super) fn read(
    image: &Image,
    saddles: &[Saddle],
    links: &Links,
    tags: u32,
) -> Vec<RoughCorner> {
    let pixels: Vec<f32> = image.pixels.iter().map(|p| f32::from(*p)).collect();
    let width = image.width as usize;
    let mut found: BTreeMap<usize, (u32, [usize; 4])> = BTreeMap::new();
    for i in 0..saddles.len() {
        for ray in 0..4 {
            let Some(square) = dark_square(saddles, links, i, ray) else {
                continue;
            };
            let Some(tag) = decode(width, &pixels, &square.map(|k| saddles[k].position), tags)
            else {
                continue;
            };
            // The square's corners run with the clock, the tag's against it.
            let corners = std::array::from_fn(|k| square[(tag.turn + 4 - k) % 4]);
            let best = found.entry(tag.number).or_insert((tag.wrong, corners));
            // A grid has each tag once: of two the one with fewer wrong bits.
            if tag.wrong < best.0 {
                *best = (tag.wrong, corners);
            }
        }
    }
    let mut seen = Vec::with_capacity(4 * found.len());
    for (number, (_, corners)) in found {
        for (k, saddle) in corners.into_iter().enumerate() {
            let shortest = links[saddle]
                .iter()
                .flatten()
                .fold(f64::INFINITY, |a, l| a.min(l.length_px));
            let gap_px = shortest.min(0.3 * edge_px(saddles, &corners));
            seen.push(RoughCorner {
                index: 4 * number + k,
                pixel: saddles[saddle].position,
                clear_px: 0.45 * gap_px,
                alone_px: ALONE * gap_px * saddles[saddle].opening(),
                edges: Some(saddles[saddle].edges()),
            });
        }
    }
    seen
}

fn edge_px(saddles: &[Saddle], corners: &[usize; 4]) -> f64 {
    (0..4)
        .map(|k| (saddles[corners[k]].position - saddles[corners[(k + 1) % 4]].position).norm())
        .fold(f64::INFINITY, f64::min)
}

/// The dark square behind a ray: its corners in order of rising angle, starting at the saddle with the lowest number, so that
/// each square is met once.
fn dark_square(saddles: &[Saddle], links: &Links, start: usize, ray: usize) -> Option<[usize; 4]> {
    if !saddles[start].is_dark(ray) {
        return None;
    }
    let mut corners = [start; 4];
    let (mut at, mut along) = (start, ray);
    // The last step leads back to the first corner.
    for k in [1, 2, 3, 0] {
        let link = links[at][along]?;
        at = link.saddle;
        // The square lies before the ray that points back.
        along = (link.back + 3) % 4;
        corners[k] = at;
    }
    let closed = at == start && along == ray;
    (closed && corners[1..].iter().all(|c| *c > start)).then_some(corners)
}

struct Tag {
    number: usize,
    /// Which corner of the square is the tag's lower left.
    turn: usize,
    wrong: u32,
}

/// How many dark squares of an image are tags, though none of the grid's: those that can be read in a mirror, and the others.
pub(super) fn strangers(image: &Image, saddles: &[Saddle], links: &Links, tags: u32) -> [usize; 2] {
    let pixels: Vec<f32> = image.pixels.iter().map(|p| f32::from(*p)).collect();
    let mut counts = [0; 2];
    let starts = (0..saddles.len()).flat_map(|i| (0..4).map(move |ray| (i, ray)));
    for square in starts.filter_map(|(i, ray)| dark_square(saddles, links, i, ray)) {
        let corners = square.map(|k| saddles[k].position);
        let Some(mut bits) = read_bits(image.width as usize, &pixels, &corners) else {
            continue;
        };
        // Squares without any white are those between tags, or no tags at all.
        let white = bits.iter().flatten().filter(|b| **b).count();
        if white < LEAST_WHITE {
            continue;
        }
        bits.iter_mut().for_each(|row| row.reverse());
        counts[usize::from(nearest(&bits, tags).is_none())] += 1;
    }
    counts
}

fn decode(width: usize, pixels: &[f32], corners: &[Vector2<f64>; 4], tags: u32) -> Option<Tag> {
    nearest(&read_bits(width, pixels, corners)?, tags)
}

/// What is inside of a tag's border, by rows from corner 0 of the square; white is `true`.
type Bits = [[bool; CODE_BITS]; CODE_BITS];

/// `None` where there is no border.
fn read_bits(width: usize, pixels: &[f32], corners: &[Vector2<f64>; 4]) -> Option<Bits> {
    let pixel_from_tag = homography(corners)?;
    let at = |x: f64, y: f64| {
        let p = pixel_from_tag * Vector3::new(x, y, 1.0);
        sample(width, pixels, p.x / p.z, p.y / p.z)
    };
    let bit = 1.0 / EDGE_BITS as f64;
    // White outside, black border inside: the levels between which a bit is decided.
    let (mut white, mut black, mut black_highest) = (0.0, 0.0, f32::MIN);
    let mut outside = 0.0f32;
    for k in 0..EDGE_BITS {
        let along = (k as f64 + 0.5) * bit;
        for (x, y, inward) in [
            (along, 0.0, (0.0, 1.0)),
            (1.0, along, (-1.0, 0.0)),
            (along, 1.0, (0.0, -1.0)),
            (0.0, along, (1.0, 0.0)),
        ] {
            let inside = at(x + inward.0 * bit, y + inward.1 * bit)?;
            black += inside;
            black_highest = black_highest.max(inside);
            // Off the image there is no white to compare with.
            if let Some(value) = at(x - inward.0 * 1.2 * bit, y - inward.1 * 1.2 * bit) {
                white += value;
                outside += 1.0;
            }
        }
    }
    if outside < 1.0 {
        return None;
    }
    let (white, black) = (white / outside, black / (4 * EDGE_BITS) as f32);
    let threshold = 0.5 * (white + black);
    if white - black < 8.0 || black_highest > threshold {
        return None;
    }
    let mut bits = [[false; CODE_BITS]; CODE_BITS];
    for (j, row) in bits.iter_mut().enumerate() {
        for (i, value) in row.iter_mut().enumerate() {
            let centre = |k: usize| ((k + BORDER_BITS) as f64 + 0.5) * bit;
            *value = at(centre(i), centre(j))? > threshold;
        }
    }
    Some(bits)
}

/// The tag of the family whose code it is, in whatever turn.
fn nearest(bits: &Bits, tags: u32) -> Option<Tag> {
    (0..4)
        .flat_map(|turn| {
            let code = code(bits, turn);
            (0..tags as usize).map(move |number| Tag {
                number,
                turn,
                wrong: tag_codes()
                    .get(number)
                    .map_or(u32::MAX, |c| (c ^ code).count_ones()),
            })
        })
        .min_by_key(|tag| tag.wrong)
        .filter(|tag| tag.wrong <= MAX_WRONG)
}

/// The 36 bits as the family writes them, by rows from the tag's lower right, if corner `turn` of the square is its lower left.
fn code(bits: &Bits, turn: usize) -> u64 {
    let last = CODE_BITS - 1;
    let mut code = 0;
    for row in 0..CODE_BITS {
        for column in 0..CODE_BITS {
            // Place on the square, whose x runs from corner 0 to 1 and y from corner 0 to 3.
            let (x, y) = match turn {
                0 => (row, last - column),
                1 => (column, row),
                2 => (last - row, column),
                _ => (last - column, last - row),
            };
            code = code << 1 | u64::from(bits[y][x]);
        }
    }
    code
}

/// `pixel ~ H (x, y, 1)` with the unit square's corners (0,0), (1,0), (1,1), (0,1) on the four pixels.
pub(super) fn homography(corners: &[Vector2<f64>; 4]) -> Option<Matrix3<f64>> {
    let mut a = SMatrix::<f64, 8, 8>::zeros();
    let mut b = SVector::<f64, 8>::zeros();
    let square = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
    for (k, ((x, y), p)) in square.into_iter().zip(corners).enumerate() {
        a.fixed_view_mut::<1, 8>(2 * k, 0).copy_from_slice(&[
            x,
            y,
            1.0,
            0.0,
            0.0,
            0.0,
            -p.x * x,
            -p.x * y,
        ]);
        a.fixed_view_mut::<1, 8>(2 * k + 1, 0).copy_from_slice(&[
            0.0,
            0.0,
            0.0,
            x,
            y,
            1.0,
            -p.y * x,
            -p.y * y,
        ]);
        b[2 * k] = p.x;
        b[2 * k + 1] = p.y;
    }
    let h = a.lu().solve(&b)?;
    Some(Matrix3::new(
        h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0,
    ))
}
