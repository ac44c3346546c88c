//! Calibration boards: where their corners are, and how to print them.
//!
//! Corners lie in the plane z = 0 of the target frame. Seen from the front, an AprilGrid has x to the right and y up (as in
//! Kalibr), with tag 0 at the origin; a checkerboard and a ChArUco board have x to the right and y down (as in OpenCV), with
//! inner corner 0 at the origin. The grid's z axis comes out of the board, the checkerboard's goes into it.

mod aruco;
mod kalibr;
mod markers;
mod pdf;
mod tag36h11;

use lsfb_geometry::Vector3;
use serde::{Deserialize, Serialize};

use crate::TargetProblem;

pub(crate) use markers::{BORDER_BITS, CODE_BITS, EDGE_BITS, charuco_square, tag_codes};
pub use markers::{MARKERS, MarkerDictionary, TAGS_36H11, tag_cells};
pub use pdf::PageSize;

/// A calibration board.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "target_type", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Target {
    /// Kalibr's grid of tags 36h11 with small squares between them.
    AprilGrid {
        /// Tags along x.
        columns: u32,
        /// Tags along y.
        rows: u32,
        /// Edge of a tag, black border included, metres.
        tag_size_m: f64,
        /// Gap between tags as a share of their edge.
        spacing_ratio: f64,
    },
    /// Black and white squares.
    Checkerboard {
        /// Inner corners along x.
        columns: u32,
        /// Inner corners along y.
        rows: u32,
        /// Edge of a square, metres.
        square_m: f64,
    },
    /// A checkerboard with ArUco markers in its white squares, numbered by rows; the upper left square is black (as OpenCV has
    /// it since 4.6).
    Charuco {
        /// Squares along x.
        columns: u32,
        /// Squares along y.
        rows: u32,
        /// Edge of a square, metres.
        square_m: f64,
        /// Edge of a marker, black border included, metres.
        marker_m: f64,
        /// Whose markers they are.
        dictionary: MarkerDictionary,
    },
}

impl Target {
    /// The target in a few words, for errors.
    pub(crate) fn describe(&self) -> String {
        match self {
            Self::AprilGrid { columns, rows, .. } => {
                format!("AprilGrid of {columns} × {rows} tags")
            }
            Self::Checkerboard { columns, rows, .. } => {
                format!("checkerboard of {columns} × {rows} inner corners")
            }
            Self::Charuco {
                columns,
                rows,
                dictionary,
                ..
            } => format!(
                "ChArUco board of {columns} × {rows} squares with markers of {} bits",
                dictionary.name()
            ),
        }
    }

    /// The edges of a board that is so many times as large, in words.
    pub(crate) fn scaled_words(&self, factor: f64) -> String {
        let (what, edge_m) = match *self {
            Self::AprilGrid { tag_size_m, .. } => ("tags", tag_size_m),
            Self::Checkerboard { square_m, .. } | Self::Charuco { square_m, .. } => {
                ("squares", square_m)
            }
        };
        format!("{what} of {:.1} mm", edge_m * factor * 1e3)
    }
}

/// Edges of squares and tags of boards that exist, metres.
const EDGES_M: std::ops::Range<f64> = 0.001..1.5;

impl Target {
    /// What is wrong with the numbers, if anything.
    pub fn problem(&self) -> Option<TargetProblem> {
        let positive = |what: &'static str, value: f64| {
            (!(value > 0.0 && value.is_finite()))
                .then_some(TargetProblem::NotPositive { what, value })
        };
        let edge = |what: &'static str, edge_m: f64| {
            let small = TargetProblem::TooSmall { what, edge_m };
            let large = TargetProblem::TooLarge { what, edge_m };
            positive(what, edge_m)
                .or((edge_m < EDGES_M.start).then_some(small))
                .or((edge_m > EDGES_M.end).then_some(large))
        };
        match *self {
            Target::AprilGrid {
                columns,
                rows,
                tag_size_m,
                spacing_ratio,
            } => {
                let tags = u64::from(columns) * u64::from(rows);
                let is_odd = tags == 0 || tags > u64::from(TAGS_36H11);
                edge("a tag", tag_size_m)
                    .or(positive("the gap between tags", spacing_ratio))
                    .or(is_odd.then_some(TargetProblem::Tags {
                        columns,
                        rows,
                        most: TAGS_36H11,
                    }))
            }
            Target::Checkerboard {
                columns,
                rows,
                square_m,
            } => {
                let is_odd = !(2..=100).contains(&columns) || !(2..=100).contains(&rows);
                edge("a square", square_m)
                    .or(is_odd.then_some(TargetProblem::InnerCorners { columns, rows }))
            }
            Target::Charuco {
                columns,
                rows,
                square_m,
                marker_m,
                ..
            } => {
                let markers = u64::from(columns) * u64::from(rows) / 2;
                let is_odd = columns < 3 || rows < 3 || markers > u64::from(MARKERS);
                let large = TargetProblem::LargeMarkers { marker_m, square_m };
                edge("a square", square_m)
                    .or_else(|| edge("a marker", marker_m))
                    .or(is_odd.then_some(TargetProblem::Squares {
                        columns,
                        rows,
                        most: MARKERS,
                    }))
                    .or((marker_m > 0.9 * square_m).then_some(large))
            }
        }
    }

    /// Number of corners.
    pub fn corner_count(&self) -> usize {
        match *self {
            Target::AprilGrid { columns, rows, .. } => 4 * columns as usize * rows as usize,
            Target::Checkerboard { columns, rows, .. } => columns as usize * rows as usize,
            Target::Charuco { columns, rows, .. } => {
                columns.saturating_sub(1) as usize * rows.saturating_sub(1) as usize
            }
        }
    }

    /// Extent of all corners along x and y, metres.
    pub fn corners_size(&self) -> [f64; 2] {
        let corners = (0..self.corner_count()).map(|k| self.corner(k));
        corners.fold([0.0, 0.0], |size: [f64; 2], c| {
            [size[0].max(c.x), size[1].max(c.y)]
        })
    }

    /// A corner in the target frame, metres. AprilGrid: four per tag, from its lower left against the clock, tags by rows
    /// from the lower left. Checkerboard and ChArUco board: inner corners by rows from the upper left.
    pub fn corner(&self, index: usize) -> Vector3<f64> {
        match *self {
            Target::AprilGrid {
                columns,
                tag_size_m,
                spacing_ratio,
                ..
            } => {
                let (tag, corner) = (index / 4, index % 4);
                let pitch = tag_size_m * (1.0 + spacing_ratio);
                let (column, row) = (tag % columns as usize, tag / columns as usize);
                let right = if matches!(corner, 1 | 2) {
                    tag_size_m
                } else {
                    0.0
                };
                let up = if matches!(corner, 2 | 3) {
                    tag_size_m
                } else {
                    0.0
                };
                Vector3::new(column as f64 * pitch + right, row as f64 * pitch + up, 0.0)
            }
            Target::Checkerboard {
                columns, square_m, ..
            } => lattice(index, columns as usize, square_m),
            Target::Charuco {
                columns, square_m, ..
            } => lattice(index, columns.saturating_sub(1).max(1) as usize, square_m),
        }
    }
}

fn lattice(index: usize, columns: usize, square_m: f64) -> Vector3<f64> {
    Vector3::new(
        (index % columns) as f64 * square_m,
        (index / columns) as f64 * square_m,
        0.0,
    )
}
