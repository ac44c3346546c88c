//! Returns summed up, and the plane through them.

use lsfb_geometry::{Matrix3, Vector3};

/// Sums over places.
#[derive(Clone, Default)]
pub(super) struct Moments {
    pub count: f64,
    sum: Vector3<f64>,
    squares: Matrix3<f64>,
}

/// What returns need to be a plane.
pub(super) struct Limits {
    pub min_returns: f64,
    /// How thick it may be and how wide it must be, standard deviations in metres.
    pub thick_m: f64,
    pub wide_m: f64,
}

/// The plane through returns.
pub(super) struct Fitted {
    pub place: Vector3<f64>,
    pub normal: Vector3<f64>,
    /// Standard deviations of the returns from it, and along its narrower side, metres.
    pub thickness_m: f64,
    pub wide_m: f64,
}

impl Moments {
    pub fn add(&mut self, place: &Vector3<f64>) {
        self.count += 1.0;
        self.sum += place;
        self.squares += place * place.transpose();
    }

    pub fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.sum += other.sum;
        self.squares += other.squares;
    }

    /// `None` where they are no plane.
    pub fn plane(&self, limits: &Limits) -> Option<Fitted> {
        if self.count < limits.min_returns {
            return None;
        }
        let place = self.sum / self.count;
        let spread = self.squares / self.count - place * place.transpose();
        let eigen = spread.symmetric_eigen();
        let mut sizes: [f64; 3] = std::array::from_fn(|k| eigen.eigenvalues[k].max(0.0).sqrt());
        sizes.sort_by(f64::total_cmp);
        (sizes[0] < limits.thick_m && sizes[1] > limits.wide_m).then(|| Fitted {
            place,
            normal: eigen.eigenvectors.column(eigen.eigenvalues.imin()).into(),
            thickness_m: sizes[0],
            wide_m: sizes[1],
        })
    }
}
