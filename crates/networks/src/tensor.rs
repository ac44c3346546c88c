use rayon::prelude::*;

/// A map of `height` × `width` cells with `channels` values each; the values of a cell lie together, cells row by row.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tensor {
    pub height: usize,
    pub width: usize,
    pub channels: usize,
    pub values: Vec<f32>,
}

impl Tensor {
    pub fn zeros(height: usize, width: usize, channels: usize) -> Self {
        Self {
            height,
            width,
            channels,
            values: vec![0.0; height * width * channels],
        }
    }

    /// The values of a cell.
    pub fn cell(&self, row: usize, column: usize) -> &[f32] {
        let from = (row * self.width + column) * self.channels;
        &self.values[from..from + self.channels]
    }

    /// Adds another map of the same size.
    pub fn add(&mut self, other: &Self) {
        for (sum, value) in self.values.iter_mut().zip(&other.values) {
            *sum += value;
        }
    }

    /// Adds a smaller map, linear between its cells, of which the first and the last coincide with those of this one.
    pub fn add_stretched(&mut self, small: &Self) {
        let (rows, columns) = (
            corners(small.height, self.height),
            corners(small.width, self.width),
        );
        let channels = self.channels;
        let targets = self
            .values
            .par_chunks_mut((self.width * channels).max(1))
            .zip(rows);
        targets.for_each_init(
            || vec![0.0; channels],
            |part, (target, row)| {
                let cells = target.chunks_exact_mut(channels.max(1));
                for (cell, column) in cells.zip(&columns) {
                    small.between(&row, column, part);
                    for (sum, value) in cell.iter_mut().zip(&*part) {
                        *sum += value;
                    }
                }
            },
        );
    }

    /// Adds the values at a place `[x, y]`, linear between the cells around it; beyond the rim there are zeros.
    pub fn add_sample(&self, [x, y]: [f32; 2], target: &mut [f32]) {
        for around in cells_around([x, y], [self.width, self.height]) {
            let cell = self.cell(around.row, around.column);
            for (sum, value) in target.iter_mut().zip(cell) {
                *sum += around.weight * value;
            }
        }
    }

    /// The largest values, or the means, of squares of `side` × `side` cells.
    pub fn pooled(&self, side: usize, pooling: Pooling) -> Self {
        let mut pooled = Self::zeros(self.height / side, self.width / side, self.channels);
        if pooling == Pooling::Largest {
            pooled.values.fill(f32::NEG_INFINITY);
        }
        let share = 1.0 / (side * side) as f32;
        let (width, channels) = (pooled.width, pooled.channels);
        for row in 0..pooled.height * side {
            let target = &mut pooled.values[row / side * width * channels..][..width * channels];
            for column in 0..width * side {
                let sums = &mut target[column / side * channels..][..channels];
                for (sum, value) in sums.iter_mut().zip(self.cell(row, column)) {
                    match pooling {
                        Pooling::Largest => *sum = sum.max(*value),
                        Pooling::Mean => *sum += value * share,
                    }
                }
            }
        }
        pooled
    }

    /// Enlarged to `height` × `width` cells, linear between the centres of the cells.
    pub fn enlarged(&self, height: usize, width: usize) -> Self {
        let rows = centres(self.height, height);
        let columns = centres(self.width, width);
        let mut large = Self::zeros(height, width, self.channels);
        let cells = large.values.chunks_exact_mut(self.channels.max(1));
        for (index, target) in cells.enumerate() {
            let (row, column) = (&rows[index / width], &columns[index % width]);
            self.between(row, column, target);
        }
        large
    }

    /// The values between four cells.
    pub fn between(&self, row: &Between, column: &Between, target: &mut [f32]) {
        let [a, b] =
            [row.first, row.second].map(|r| [column.first, column.second].map(|c| self.cell(r, c)));
        for (channel, value) in target.iter_mut().enumerate() {
            let upper = a[0][channel] + (a[1][channel] - a[0][channel]) * column.share;
            let lower = b[0][channel] + (b[1][channel] - b[0][channel]) * column.share;
            *value = upper + (lower - upper) * row.share;
        }
    }
}

/// How cells are summed up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pooling {
    Largest,
    Mean,
}

/// A cell beside a place.
pub(crate) struct Around {
    pub column: usize,
    pub row: usize,
    /// Its part in what is seen at the place, 0–1.
    pub weight: f32,
}

/// The cells around a place `[x, y]` among `width` × `height`, as far as they are there.
pub(crate) fn cells_around(
    [x, y]: [f32; 2],
    [width, height]: [usize; 2],
) -> impl Iterator<Item = Around> {
    let (left, top) = (x.floor(), y.floor());
    let (u, v) = (x - left, y - top);
    let corners = [
        (left, top, (1.0 - u) * (1.0 - v)),
        (left + 1.0, top, u * (1.0 - v)),
        (left, top + 1.0, (1.0 - u) * v),
        (left + 1.0, top + 1.0, u * v),
    ];
    let corners = corners.into_iter();
    corners.filter_map(move |(column, row, weight)| {
        let is_inside =
            (0.0..width as f32).contains(&column) && (0.0..height as f32).contains(&row);
        is_inside.then_some(Around {
            column: column as usize,
            row: row as usize,
            weight,
        })
    })
}

/// A place between two cells of a row or column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Between {
    pub first: usize,
    pub second: usize,
    /// How far from the first to the second, 0–1.
    pub share: f32,
}

impl Between {
    /// At `position`, in cells, of `count` cells; beyond the last ones, these.
    pub fn new(position: f32, count: usize) -> Self {
        let last = count.saturating_sub(1);
        let position = position.clamp(0.0, last as f32);
        let first = (position as usize).min(last);
        Self {
            first,
            second: (first + 1).min(last),
            share: position - first as f32,
        }
    }
}

/// Where the centres of `large` cells lie among `small` ones that cover the same.
fn centres(small: usize, large: usize) -> Vec<Between> {
    let ratio = small as f32 / large as f32;
    let centre = |i: usize| Between::new((i as f32 + 0.5) * ratio - 0.5, small);
    (0..large).map(centre).collect()
}

/// Where `large` cells lie among `small` ones when the first and the last of both coincide.
pub(crate) fn corners(small: usize, large: usize) -> Vec<Between> {
    let ratio = small.saturating_sub(1) as f32 / large.saturating_sub(1).max(1) as f32;
    let corner = |i: usize| Between::new(i as f32 * ratio, small);
    (0..large).map(corner).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pooling_and_enlarging() {
        let map = Tensor {
            height: 2,
            width: 4,
            channels: 1,
            values: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 12.0],
        };
        assert_eq!(map.pooled(2, Pooling::Largest).values, [6.0, 12.0]);
        assert_eq!(map.pooled(2, Pooling::Mean).values, [3.5, 6.5]);
        let row = Tensor {
            height: 1,
            width: 2,
            channels: 1,
            values: vec![0.0, 4.0],
        };
        assert_eq!(row.enlarged(1, 4).values, [0.0, 1.0, 3.0, 4.0]);
        let places: Vec<f32> = corners(2, 5)
            .iter()
            .map(|b| b.first as f32 + b.share)
            .collect();
        assert_eq!(places, [0.0, 0.25, 0.5, 0.75, 1.0]);
        let mut sum = Tensor {
            height: 1,
            width: 5,
            channels: 1,
            values: vec![1.0; 5],
        };
        sum.add_stretched(&row);
        assert_eq!(sum.values, [1.0, 2.0, 3.0, 4.0, 5.0]);
    }

    #[test]
    fn samples_fade_to_zero_beyond_the_rim() {
        let map = Tensor {
            height: 2,
            width: 2,
            channels: 1,
            values: vec![1.0, 2.0, 3.0, 5.0],
        };
        let at = |x: f32, y: f32| {
            let mut value = [0.0];
            map.add_sample([x, y], &mut value);
            value[0]
        };
        assert_eq!(at(0.5, 0.5), 2.75);
        assert_eq!(
            [at(-0.5, 0.0), at(1.0, 1.5), at(1.75, 1.0)],
            [0.5, 2.5, 1.25]
        );
        assert_eq!([at(-1.0, 0.0), at(0.0, 2.0), at(1e30, 0.0)], [0.0; 3]);
        assert_eq!(at(f32::NAN, 0.0), 0.0);
    }
}
