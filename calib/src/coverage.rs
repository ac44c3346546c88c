//! Which parts of an image were covered by corners, and how they were met there.

use lsfb_geometry::Vector2;

use crate::detect::Corner;

/// Columns and rows of the coverage map.
pub const COVERAGE_CELLS: [usize; 2] = [12, 8];

/// Cell of the coverage map in which a pixel lies.
pub(crate) fn cell(pixel: &Vector2<f64>, [width, height]: [u32; 2]) -> usize {
    let [columns, rows] = COVERAGE_CELLS;
    let place = |x: f64, size: u32, count: usize| {
        let share = (x + 0.5) / f64::from(size) * count as f64;
        (share.max(0.0) as usize).min(count - 1)
    };
    place(pixel.y, height, rows) * columns + place(pixel.x, width, columns)
}

/// Corners per cell of an image of that size, by rows from the upper left.
pub(crate) fn corners_by_cell<'a>(
    corners: impl Iterator<Item = &'a Corner>,
    size_px: [u32; 2],
) -> Vec<u32> {
    let [columns, rows] = COVERAGE_CELLS;
    let mut cells = vec![0; columns * rows];
    for corner in corners {
        cells[cell(&corner.pixel, size_px)] += 1;
    }
    cells
}

/// Errors per cell of the image.
pub(crate) struct CellErrors {
    size_px: [u32; 2],
    cells: Vec<(Vector2<f64>, f64)>,
}

impl CellErrors {
    pub fn new(size_px: [u32; 2]) -> Self {
        let [columns, rows] = COVERAGE_CELLS;
        Self {
            size_px,
            cells: vec![(Vector2::zeros(), 0.0); columns * rows],
        }
    }

    pub fn add(&mut self, pixel: &Vector2<f64>, error_px: &Vector2<f64>) {
        let (sum, count) = &mut self.cells[cell(pixel, self.size_px)];
        *sum += error_px;
        *count += 1.0;
    }

    /// The mean of each cell, zero where there is none.
    pub fn means(&self) -> Vec<[f64; 2]> {
        let mean = |(sum, count): &(Vector2<f64>, f64)| (sum / count.max(1.0)).into();
        self.cells.iter().map(mean).collect()
    }
}

/// Which parts of the image have the fewest corners, in words.
pub(crate) fn empty_parts(cells: &[u32]) -> String {
    let [columns, rows] = COVERAGE_CELLS;
    let mut parts = Vec::new();
    for (name, top, left) in [
        ("the upper left", true, true),
        ("the upper right", true, false),
        ("the lower left", false, true),
        ("the lower right", false, false),
    ] {
        let inside =
            |k: usize| ((k / columns) * 2 < rows) == top && ((k % columns) * 2 < columns) == left;
        let (mut empty, mut all) = (0, 0);
        for (_, n) in cells.iter().enumerate().filter(|(k, _)| inside(*k)) {
            all += 1;
            empty += usize::from(*n == 0);
        }
        if 2 * empty > all {
            parts.push(name);
        }
    }
    if parts.is_empty() {
        "the border".to_owned()
    } else {
        parts.join(", ")
    }
}

/// Corners of the image, two cells wide and high, in which there is nothing.
pub(crate) fn empty_corners(cells: &[u32]) -> Vec<&'static str> {
    const SIDE: usize = 2;
    let [columns, rows] = COVERAGE_CELLS;
    let corners = [
        ("the upper left corner", 0, 0),
        ("the upper right corner", 0, columns - SIDE),
        ("the lower left corner", rows - SIDE, 0),
        ("the lower right corner", rows - SIDE, columns - SIDE),
    ];
    let is_empty = |top: usize, left: usize| {
        let inside = |k: &usize| {
            let (row, column) = (k / columns, k % columns);
            (top..top + SIDE).contains(&row) && (left..left + SIDE).contains(&column)
        };
        let mut own = (0..cells.len()).filter(inside);
        own.all(|k| cells.get(k) == Some(&0))
    };
    let empty = corners
        .into_iter()
        .filter(|(_, top, left)| is_empty(*top, *left));
    empty.map(|(name, _, _)| name).collect()
}
