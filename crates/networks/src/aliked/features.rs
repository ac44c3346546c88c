use crate::keypoints::normalise;
use crate::tensor::{Between, Tensor, corners};

/// What the four maps say of each pixel together, put together where it is asked for.
pub(super) struct Features {
    maps: Vec<Stretched>,
    /// Columns and rows of the image.
    pub size: [usize; 2],
}

/// A map, and where in it each column and row of the image lies.
struct Stretched {
    map: Tensor,
    columns: Vec<Between>,
    rows: Vec<Between>,
}

impl Features {
    /// From maps of a padded image, of which the image begins at `begin`.
    pub fn new(maps: Vec<Tensor>, padded: [usize; 2], begin: [usize; 2], size: [usize; 2]) -> Self {
        let part = |places: Vec<Between>, axis: usize| {
            places[begin[axis]..begin[axis] + size[axis]].to_vec()
        };
        let stretched = |map: Tensor| Stretched {
            columns: part(corners(map.width, padded[0]), 0),
            rows: part(corners(map.height, padded[1]), 1),
            map,
        };
        Self {
            maps: maps.into_iter().map(stretched).collect(),
            size,
        }
    }

    /// Number of values of a pixel.
    pub fn channels(&self) -> usize {
        self.maps.iter().map(|m| m.map.channels).sum()
    }

    /// The values of a pixel, of unit length.
    pub fn of_pixel(&self, column: usize, row: usize, target: &mut [f32]) {
        let mut rest = &mut target[..];
        for stretched in &self.maps {
            let (part, others) = rest.split_at_mut(stretched.map.channels);
            let (row, column) = (&stretched.rows[row], &stretched.columns[column]);
            stretched.map.between(row, column, part);
            rest = others;
        }
        normalise(target);
    }
}
