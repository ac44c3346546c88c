//! How well the poses of the keyframes are known.

use arrow_buffer::ScalarBuffer;
use lsfb_geometry::Matrix6;

use super::HdMap;

/// Rows and columns of the upper triangle, in the order of the file.
const UPPER: [(usize, usize); 21] = {
    let mut upper = [(0, 0); 21];
    let (mut row, mut column, mut next) = (0, 0, 0);
    while next < 21 {
        upper[next] = (row, column);
        next += 1;
        column += 1;
        if column == 6 {
            row += 1;
            column = row;
        }
    }
    upper
};

/// Covariances of the keyframes' poses, `[rotation, translation]` in their tangents: the upper triangle, row by row; infinite where unknown.
#[derive(Clone, Debug)]
pub(super) struct CovarianceColumns([ScalarBuffer<f64>; 21]);

impl CovarianceColumns {
    pub(super) fn new(covariances: &[Option<Matrix6<f64>>]) -> Self {
        let column = |at: (usize, usize)| -> ScalarBuffer<f64> {
            let value = |known: &Option<Matrix6<f64>>| known.map_or(f64::INFINITY, |c| c[at]);
            covariances.iter().map(value).collect::<Vec<f64>>().into()
        };
        Self(UPPER.map(column))
    }

    pub(super) fn unknown(keyframes: usize) -> Self {
        Self::new(&vec![None; keyframes])
    }

    /// In the order of the file.
    pub(super) fn columns(&self) -> &[ScalarBuffer<f64>; 21] {
        &self.0
    }

    /// [`CovarianceColumns::columns`] back again; `None` if there are not 21.
    pub(super) fn from_columns(columns: Vec<ScalarBuffer<f64>>) -> Option<Self> {
        Some(Self(columns.try_into().ok()?))
    }
}

impl HdMap {
    /// Covariance of a keyframe's pose, `[rotation, translation]` in its tangent, relative to the first keyframe of the map that it was made
    /// for: that one is exact, and its covariance zero. `None` where it is unknown, as where the poses were given, and of a keyframe that is not there.
    pub fn keyframe_covariance(&self, keyframe: u32) -> Option<Matrix6<f64>> {
        let columns = self.keyframes.covariance.columns();
        let mut covariance = Matrix6::zeros();
        for ((row, column), values) in UPPER.into_iter().zip(columns) {
            let value = values
                .get(keyframe as usize)
                .copied()
                .filter(|v| v.is_finite())?;
            covariance[(row, column)] = value;
            covariance[(column, row)] = value;
        }
        Some(covariance)
    }

    /// With how well the poses of its keyframes are known, in their order; `None` where that is unknown, and so is what is missing at the end.
    pub fn with_keyframe_covariances(mut self, mut covariances: Vec<Option<Matrix6<f64>>>) -> Self {
        covariances.resize(self.keyframe_count(), None);
        self.keyframes.covariance = CovarianceColumns::new(&covariances);
        self
    }
}
