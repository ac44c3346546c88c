//! A ChArUco board is a checkerboard whose white squares say where they are: any part of it tells the rest.

use std::collections::BTreeMap;

use lsfb_geometry::Vector3;
use lsfb_types::Image;

use super::april_grid::homography;
use super::checkerboard::{Lattice, grow};
use super::link::Links;
use super::saddle::Saddle;
use super::{ALONE, RoughCorner, sample};
use crate::board::{MarkerDictionary, charuco_square};

/// Most bits along the edge of a marker's code.
const MOST_BITS: usize = 6;

/// The board that is looked for.
pub(super) struct Layout {
    /// Squares along x and y.
    pub columns: usize,
    pub rows: usize,
    /// Edge of a marker as a share of its square's.
    pub marker_share: f64,
    pub dictionary: MarkerDictionary,
}

impl Layout {
    /// The square of a marker.
    fn square_of(&self, marker: usize) -> (i32, i32) {
        charuco_square(marker, self.columns)
    }

    fn markers(&self) -> usize {
        self.columns * self.rows / 2
    }
}

/// How a lattice lies on the board: quarter turns, and the vertex of the board under the lattice's origin. Vertex (0, 0) is
/// the board's upper left, (1, 1) its first inner corner.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Placement {
    turn: usize,
    origin: (i32, i32),
}

impl Placement {
    /// The vertex of the board under a place of the lattice.
    fn vertex(&self, place: (i32, i32)) -> (i32, i32) {
        let (x, y) = turned_back(place, self.turn);
        (self.origin.0 + x, self.origin.1 + y)
    }
}

/// A step on the lattice as a step on the board, which is turned by quarter turns from x to y.
fn turned_back((x, y): (i32, i32), turn: usize) -> (i32, i32) {
    match turn {
        0 => (x, y),
        1 => (y, -x),
        2 => (-x, -y),
        _ => (-y, x),
    }
}

/// The corners of the board that can be numbered.
pub(super) fn read(
    image: &Image,
    saddles: &[Saddle],
    links: &Links,
    board: &Layout,
) -> Vec<RoughCorner> {
    let pixels: Vec<f32> = image.pixels.iter().map(|p| f32::from(*p)).collect();
    let reader = MarkerReader {
        width: image.width as usize,
        pixels: &pixels,
        saddles,
        board,
    };
    let mut visited = vec![false; saddles.len()];
    // Of two lattices that claim a corner the one with more markers has it.
    let mut found: Vec<(usize, Lattice, Placement)> = Vec::new();
    for seed in 0..saddles.len() {
        if !visited[seed] {
            let lattice = grow(links, seed, &mut visited);
            if let Some((markers, placement)) = reader.place(&lattice) {
                found.push((markers, lattice, placement));
            }
        }
    }
    found.sort_by_key(|(markers, ..)| std::cmp::Reverse(*markers));
    let mut corners: BTreeMap<usize, RoughCorner> = BTreeMap::new();
    for (_, lattice, placement) in &found {
        for (place, node) in lattice {
            let (x, y) = placement.vertex(*place);
            let inside = x >= 1 && y >= 1 && x < board.columns as i32 && y < board.rows as i32;
            if !inside {
                continue;
            }
            let index = (y - 1) as usize * (board.columns - 1) + (x - 1) as usize;
            let lengths = links[node.saddle].iter().flatten().map(|l| l.length_px);
            let Some(square_px) = lengths.reduce(f64::min) else {
                continue;
            };
            // The nearest corner of a marker is this far away, and half a pixel of blur.
            let margin_px = 0.5 * (1.0 - board.marker_share) * square_px;
            let free_px = std::f64::consts::SQRT_2 * margin_px - 0.5;
            corners.entry(index).or_insert(RoughCorner {
                index,
                pixel: saddles[node.saddle].position,
                clear_px: free_px.min(0.45 * square_px),
                alone_px: free_px.min(ALONE * square_px) * saddles[node.saddle].opening(),
                edges: Some(saddles[node.saddle].edges()),
            });
        }
    }
    corners.into_values().collect()
}

/// An image and what is looked for in it.
struct MarkerReader<'a> {
    width: usize,
    pixels: &'a [f32],
    saddles: &'a [Saddle],
    board: &'a Layout,
}

impl MarkerReader<'_> {
    /// Where a lattice lies by the markers in it, and how many say so. A single marker must be without fault.
    fn place(&self, lattice: &Lattice) -> Option<(usize, Placement)> {
        let mut votes: BTreeMap<Placement, (usize, u32)> = BTreeMap::new();
        for place in lattice.keys() {
            let Some((marker, turn, wrong)) = self.marker(lattice, *place) else {
                continue;
            };
            // The square's upper left on the board is one of the four corners on the lattice.
            let corner = [(0, 0), (1, 0), (1, 1), (0, 1)][turn];
            let (x, y) = turned_back((place.0 + corner.0, place.1 + corner.1), turn);
            let square = self.board.square_of(marker);
            let placement = Placement {
                turn,
                origin: (square.0 - x, square.1 - y),
            };
            let vote = votes.entry(placement).or_insert((0, u32::MAX));
            *vote = (vote.0 + 1, vote.1.min(wrong));
        }
        let (placement, (markers, wrong)) = votes
            .into_iter()
            .max_by_key(|(_, (markers, wrong))| (*markers, std::cmp::Reverse(*wrong)))?;
        (markers > 1 || wrong == 0).then_some((markers, placement))
    }

    /// Number, quarter turns and wrong bits of the marker in the white square right of and below a place of the lattice.
    fn marker(&self, lattice: &Lattice, (x, y): (i32, i32)) -> Option<(usize, usize, u32)> {
        let first = lattice.get(&(x, y))?;
        // The sector from the ray along x to that along y.
        if self.saddles[first.saddle].is_dark(first.x_ray) {
            return None;
        }
        let at = |dx: i32, dy: i32| {
            let node = lattice.get(&(x + dx, y + dy))?;
            Some(self.saddles[node.saddle].position)
        };
        let corners = [at(0, 0)?, at(1, 0)?, at(1, 1)?, at(0, 1)?];
        let pixel_from_square = homography(&corners)?;
        let bits = self.board.dictionary.edge_bits();
        let cells = bits + 2;
        let margin = 0.5 * (1.0 - self.board.marker_share);
        // Columns and rows of the marker; −1 and `cells` lie in the white margin.
        let value = |column: f64, row: f64| {
            let along = |k: f64| {
                if k < 0.0 {
                    0.5 * margin
                } else if k >= cells as f64 {
                    1.0 - 0.5 * margin
                } else {
                    margin + (k + 0.5) / cells as f64 * self.board.marker_share
                }
            };
            let p = pixel_from_square * Vector3::new(along(column), along(row), 1.0);
            sample(self.width, self.pixels, p.x / p.z, p.y / p.z)
        };
        let last = (cells - 1) as f64;
        let (mut white, mut black, mut black_highest) = (0.0, 0.0, f32::MIN);
        for k in 0..cells {
            let k = k as f64;
            for (inside, outside) in [
                ((k, 0.0), (k, -1.0)),
                ((k, last), (k, last + 1.0)),
                ((0.0, k), (-1.0, k)),
                ((last, k), (last + 1.0, k)),
            ] {
                let border = value(inside.0, inside.1)?;
                black += border;
                black_highest = black_highest.max(border);
                white += value(outside.0, outside.1)?;
            }
        }
        let count = (4 * cells) as f32;
        let (white, black) = (white / count, black / count);
        let threshold = 0.5 * (white + black);
        if white - black < 8.0 || black_highest > threshold {
            return None;
        }
        let mut seen = [[false; MOST_BITS]; MOST_BITS];
        for (row, line) in seen.iter_mut().enumerate().take(bits) {
            for (column, bit) in line.iter_mut().enumerate().take(bits) {
                *bit = value((column + 1) as f64, (row + 1) as f64)? > threshold;
            }
        }
        let markers = self.board.markers();
        (0..4)
            .flat_map(|turn| {
                let code = code(&seen, bits, turn);
                let codes = self.board.dictionary.codes().iter().take(markers);
                let apart = move |(k, c): (usize, &u64)| (k, turn, (c ^ code).count_ones());
                codes.enumerate().map(apart)
            })
            .min_by_key(|(_, _, wrong)| *wrong)
            .filter(|(_, _, wrong)| *wrong <= self.board.dictionary.forgiven())
    }
}

/// The bits as the dictionary lists them if the marker is turned by quarter turns from x to y.
fn code(seen: &[[bool; MOST_BITS]; MOST_BITS], bits: usize, turn: usize) -> u64 {
    let last = bits - 1;
    let mut code = 0;
    for row in 0..bits {
        for column in 0..bits {
            let (x, y) = match turn {
                0 => (column, row),
                1 => (last - row, column),
                2 => (last - column, last - row),
                _ => (row, last - column),
            };
            code = code << 1 | u64::from(seen[y][x]);
        }
    }
    code
}
