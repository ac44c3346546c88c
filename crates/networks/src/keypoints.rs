//! Keypoints of a map of scores: its peaks, to a fraction of a pixel.

use crate::tensor::Tensor;

/// A keypoint of a network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NetworkKeypoint {
    /// Position, pixels; (0, 0) is the centre of the top-left pixel.
    pub pixel: [f32; 2],
    /// How well it can be found again, 0–1.
    pub score: f32,
}

/// Pixels of a cell in each direction, of networks that say for each cell which of its pixels is a keypoint.
pub(crate) const CELL_PX: usize = 8;

/// Scores of all pixels of an image, row by row.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Scores {
    pub width: usize,
    pub values: Vec<f32>,
}

/// How peaks are found.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PeakSearch {
    /// Nothing within this many pixels is higher.
    pub radius: usize,
    /// Least score.
    pub min_score: f32,
    /// The peak of a score `s` below the highest weighs `exp(−s / temperature)` in the mean that places it.
    pub temperature: f32,
}

/// A peak: the pixel and where between the pixels it lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Peak {
    pub column: usize,
    pub row: usize,
    pub pixel: [f32; 2],
    pub score: f32,
}

impl From<&Peak> for NetworkKeypoint {
    fn from(peak: &Peak) -> Self {
        Self {
            pixel: peak.pixel,
            score: peak.score,
        }
    }
}

impl Scores {
    /// From logits of each cell: those of its pixels row by row, and that of none. Scores are probabilities.
    pub fn of_cells(logits: &Tensor) -> Self {
        let width = logits.width * CELL_PX;
        let mut values = vec![0.0; width * logits.height * CELL_PX];
        for (index, cell) in logits.values.chunks_exact(logits.channels).enumerate() {
            let largest = cell.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            let sum: f32 = cell.iter().map(|v| (v - largest).exp()).sum();
            let top = index / logits.width * CELL_PX;
            let left = index % logits.width * CELL_PX;
            for (place, value) in cell.iter().take(CELL_PX * CELL_PX).enumerate() {
                let at = (top + place / CELL_PX) * width + left + place % CELL_PX;
                values[at] = (value - largest).exp() / sum;
            }
        }
        Self { width, values }
    }

    pub fn at(&self, column: usize, row: usize) -> f32 {
        self.values[row * self.width + column]
    }

    /// The highest score of a column's first `height` rows.
    pub fn highest(&self, column: usize, height: usize) -> f32 {
        let scores = (0..height).map(|row| self.at(column, row));
        scores.fold(0.0, f32::max)
    }

    /// The peaks of the first `height` rows and `width` columns, by row and column; the first of equals counts.
    pub fn peaks(&self, width: usize, height: usize, search: &PeakSearch) -> Vec<Peak> {
        let radius = search.radius;
        let mut peaks = Vec::new();
        for row in radius..height.saturating_sub(radius) {
            for column in radius..width.saturating_sub(radius) {
                let score = self.at(column, row);
                if score >= search.min_score && self.is_highest(column, row, radius) {
                    peaks.push(self.placed(column, row, search));
                }
            }
        }
        peaks
    }

    fn is_highest(&self, column: usize, row: usize, radius: usize) -> bool {
        let here = self.at(column, row);
        (row - radius..=row + radius).all(|y| {
            let from = y * self.width + column - radius;
            let around = &self.values[from..=from + 2 * radius];
            let columns = column - radius..=column + radius;
            around.iter().zip(columns).all(|(value, x)| {
                let before = (y, x) < (row, column);
                *value < here || (*value == here && !before)
            })
        })
    }

    /// The mean of the pixels around a peak, each weighed by how high it is.
    fn placed(&self, column: usize, row: usize, search: &PeakSearch) -> Peak {
        let (radius, highest) = (search.radius, self.at(column, row));
        let (mut weights, mut x_sum, mut y_sum) = (0.0, 0.0, 0.0);
        for y in row - radius..=row + radius {
            for x in column - radius..=column + radius {
                let weight = ((self.at(x, y) - highest) / search.temperature).exp();
                weights += weight;
                x_sum += weight * (x as f32 - column as f32);
                y_sum += weight * (y as f32 - row as f32);
            }
        }
        Peak {
            column,
            row,
            pixel: [
                column as f32 + x_sum / weights,
                row as f32 + y_sum / weights,
            ],
            score: highest,
        }
    }
}

pub(crate) fn sigmoid(value: f32) -> f32 {
    1.0 / (1.0 + (-value).exp())
}

/// To unit length; zeros stay.
pub(crate) fn normalise(vector: &mut [f32]) {
    let norm = vector.iter().map(|v| v * v).sum::<f32>().sqrt();
    if norm > 0.0 {
        vector.iter_mut().for_each(|v| *v /= norm);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blob_is_found_once_and_between_the_pixels() {
        let (width, height) = (40, 30);
        let value = |x: usize, y: usize| {
            let squared = (x as f32 - 17.3).powi(2) + (y as f32 - 11.6).powi(2);
            0.9 * (-squared / 4.0).exp()
        };
        let scores = Scores {
            width,
            values: (0..width * height)
                .map(|i| value(i % width, i / width))
                .collect(),
        };
        let search = PeakSearch {
            radius: 2,
            min_score: 0.2,
            temperature: 0.1,
        };
        let peaks = scores.peaks(width, height, &search);
        assert_eq!(peaks.len(), 1, "{peaks:?}");
        let [x, y] = peaks[0].pixel;
        assert!(
            (x - 17.3).abs() < 0.15 && (y - 11.6).abs() < 0.15,
            "{x} {y}"
        );
        let flat = Scores {
            width,
            values: vec![0.5; width * height],
        };
        assert_eq!(
            flat.peaks(width, height, &search).len(),
            0,
            "the first of a plain has the rim before it"
        );
    }
}
