//! A checkerboard is a lattice of links.

use std::collections::{BTreeMap, VecDeque};

use lsfb_geometry::Vector2;
use lsfb_perception::statistics::median;

use super::link::Links;
use super::saddle::Saddle;
use super::{ALONE, RoughCorner};

/// A saddle's place on the lattice, and which of its rays points along x.
#[derive(Clone, Copy)]
pub(super) struct Node {
    pub saddle: usize,
    pub x_ray: usize,
}

pub(super) type Lattice = BTreeMap<(i32, i32), Node>;

/// The corners of the board; empty where no lattice has exactly its size.
///
/// The first corner is the one whose outer square is dark; a board on which opposite outer squares are alike is turned so
/// that the first corner is the upper or left one.
pub(super) fn walk(
    saddles: &[Saddle],
    links: &Links,
    columns: usize,
    rows: usize,
) -> Vec<RoughCorner> {
    let mut visited = vec![false; saddles.len()];
    for seed in 0..saddles.len() {
        if visited[seed] {
            continue;
        }
        let lattice = grow(links, seed, &mut visited);
        if let Some(board) = fit(saddles, &lattice, columns, rows) {
            return seen(saddles, links, &board, columns);
        }
    }
    Vec::new()
}

/// All saddles that links join to `seed`.
pub(super) fn grow(links: &Links, seed: usize, visited: &mut [bool]) -> Lattice {
    let mut lattice = Lattice::from([(
        (0, 0),
        Node {
            saddle: seed,
            x_ray: 0,
        },
    )]);
    visited[seed] = true;
    let mut queue = VecDeque::from([(0, 0)]);
    while let Some(place) = queue.pop_front() {
        let node = lattice[&place];
        for (turn, (dx, dy)) in [(1, 0), (0, 1), (-1, 0), (0, -1)].into_iter().enumerate() {
            let Some(link) = links[node.saddle][(node.x_ray + turn) % 4] else {
                continue;
            };
            let there = (place.0 + dx, place.1 + dy);
            if visited[link.saddle] || lattice.contains_key(&there) {
                continue;
            }
            visited[link.saddle] = true;
            // The ray that points back is opposite to the direction of travel.
            let x_ray = (link.back + 2 + 4 - turn) % 4;
            lattice.insert(
                there,
                Node {
                    saddle: link.saddle,
                    x_ray,
                },
            );
            queue.push_back(there);
        }
    }
    lattice
}

/// Corners that may be missing: one in so many.
const ONE_IN: usize = 8;

/// The board in a lattice, row by row: a rectangle of the board's size, nearly full, in the board's own orientation.
fn fit(
    saddles: &[Saddle],
    lattice: &Lattice,
    columns: usize,
    rows: usize,
) -> Option<Vec<Option<Node>>> {
    let least = columns * rows - columns * rows / ONE_IN;
    if lattice.len() < least {
        return None;
    }
    let bounds = |f: fn(&(i32, i32)) -> i32| {
        let low = lattice.keys().map(f).min()?;
        Some((low, lattice.keys().map(f).max()?))
    };
    let (left, right) = bounds(|k| k.0)?;
    let (top, bottom) = bounds(|k| k.1)?;
    let (columns, rows) = (columns as i32, rows as i32);
    let mut best: Option<Vec<Option<Node>>> = None;
    let (mut most, mut alike) = (least, 0);
    for (wide, high, turned) in [(columns, rows, false), (rows, columns, true)] {
        for y in top..=bottom + 1 - high {
            for x in left..=right + 1 - wide {
                let node = |i: i32, j: i32| {
                    // The four orientations of a rectangle differ by a half turn and by the exchange of axes.
                    let place = if turned {
                        (x + wide - 1 - j, y + i)
                    } else {
                        (x + i, y + j)
                    };
                    lattice.get(&place).map(|n| Node {
                        saddle: n.saddle,
                        x_ray: if turned { (n.x_ray + 1) % 4 } else { n.x_ray },
                    })
                };
                let board: Vec<Option<Node>> = (0..rows)
                    .flat_map(|j| (0..columns).map(move |i| (i, j)))
                    .map(|(i, j)| node(i, j))
                    .collect();
                let count = board.iter().flatten().count();
                if count > most || (count == most && best.is_none()) {
                    (best, most, alike) = (Some(board), count, 1);
                } else if count == most {
                    alike += 1;
                }
            }
        }
        if columns == rows {
            break;
        }
    }
    // Two alike: the lattice is larger than the board, and nothing says which part is meant.
    let board = best.filter(|_| alike == 1)?;
    Some(orient(saddles, board, columns as usize, rows as usize))
}

fn orient(
    saddles: &[Saddle],
    board: Vec<Option<Node>>,
    columns: usize,
    rows: usize,
) -> Vec<Option<Node>> {
    let Some((at, node)) = board
        .iter()
        .enumerate()
        .find_map(|(k, n)| n.map(|n| (k, n)))
    else {
        return board;
    };
    // The sectors to −x −y and to +x +y are alike, and change from corner to corner.
    let is_odd = (at % columns + at / columns) % 2 == 1;
    let first_is_dark = saddles[node.saddle].is_dark(node.x_ray) != is_odd;
    let last_is_dark = first_is_dark != ((columns + rows) % 2 == 1);
    let turn = match (first_is_dark, last_is_dark) {
        (true, false) => false,
        (false, true) => true,
        _ => {
            // Upper left: the half of the board with the smaller coordinates comes first.
            let sum = |nodes: &[Option<Node>]| -> f64 {
                let places = nodes.iter().flatten().map(|n| saddles[n.saddle].position);
                places.map(|p| p.x + p.y).sum::<f64>() / nodes.iter().flatten().count() as f64
            };
            let (first, last) = board.split_at(board.len() / 2);
            sum(last) < sum(first)
        }
    };
    if !turn {
        return board;
    }
    let turned = board.into_iter().rev().map(|n| {
        n.map(|n| Node {
            saddle: n.saddle,
            x_ray: (n.x_ray + 2) % 4,
        })
    });
    turned.collect()
}

/// The corners; where no link led, the place that neighbours point to, for the refinement to confirm.
fn seen(
    saddles: &[Saddle],
    links: &Links,
    board: &[Option<Node>],
    columns: usize,
) -> Vec<RoughCorner> {
    let mut places: Vec<Option<Vector2<f64>>> = board
        .iter()
        .map(|n| n.map(|n| saddles[n.saddle].position))
        .collect();
    // Holes beside holes are filled from those filled before.
    for _ in 0..board.len() / ONE_IN {
        let known = places.clone();
        for (k, place) in places.iter_mut().enumerate().filter(|(_, p)| p.is_none()) {
            *place = pointed_to(&known, k, columns);
        }
    }
    let spacing = |k: usize| {
        let node = board[k]?;
        let lengths = links[node.saddle].iter().flatten().map(|l| l.length_px);
        lengths.reduce(f64::min)
    };
    let usual = median((0..board.len()).filter_map(spacing).collect()).unwrap_or_default();
    places
        .iter()
        .enumerate()
        .filter_map(|(index, place)| {
            let square_px = spacing(index).unwrap_or(0.7 * usual);
            let saddle = board[index].map(|n| &saddles[n.saddle]);
            let opening = saddle.map_or(1.0, Saddle::opening);
            Some(RoughCorner {
                index,
                pixel: (*place)?,
                clear_px: 0.45 * square_px,
                alone_px: ALONE * square_px * opening,
                edges: saddle.map(Saddle::edges),
            })
        })
        .collect()
}

/// The middle of two opposite neighbours or, at the border, where three in a row go on to.
fn pointed_to(places: &[Option<Vector2<f64>>], k: usize, columns: usize) -> Option<Vector2<f64>> {
    let (x, y) = ((k % columns) as isize, (k / columns) as isize);
    let at = |dx: isize, dy: isize| {
        let (x, y) = (x + dx, y + dy);
        let inside = x >= 0 && y >= 0 && x < columns as isize;
        let index = inside.then_some(y as usize * columns + x as usize)?;
        places.get(index).copied().flatten()
    };
    let mut guesses = Vec::new();
    for (dx, dy) in [(1, 0), (0, 1)] {
        if let (Some(a), Some(b)) = (at(dx, dy), at(-dx, -dy)) {
            // Less the bend of a curved row: four neighbours fit a cubic.
            let bend = match (at(2 * dx, 2 * dy), at(-2 * dx, -2 * dy)) {
                (Some(c), Some(d)) => (a + b - c - d) / 6.0,
                _ => Vector2::zeros(),
            };
            guesses.push((a + b) * 0.5 + bend);
        }
    }
    if guesses.is_empty() {
        for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            if let (Some(a), Some(b), Some(c)) =
                (at(dx, dy), at(2 * dx, 2 * dy), at(3 * dx, 3 * dy))
            {
                guesses.push(a * 3.0 - b * 3.0 + c);
            }
        }
    }
    let n = guesses.len() as f64;
    (n > 0.0).then(|| guesses.iter().sum::<Vector2<f64>>() / n)
}
