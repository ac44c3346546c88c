//! The normal matrix behind a diagnosis.

use lsfb_geometry::camera::MAX_PARAMETERS;
use lsfb_geometry::{Camera, Se3, Vector2, Vector3};
use lsfb_perception::projection::moved_by_pose;
use lsfb_solver::{
    Kernel, Linearization, Marginal, Parameters, Problem, Residual, Shape, Undefined, marginal,
};
use nalgebra::{DMatrix, DVector, Dyn, SMatrix, SVector, SymmetricEigen};

use super::field::{FIELD, moved_by_field};
use super::one_lens::LensOfView;
use super::{AdjustedCorner, AdjustedView, from_middle};
use crate::board::Target;

/// Rings of the lens's radial profile.
pub(super) const RINGS: usize = 8;
/// Pivot below which a direction is one that poses and lens have too, as a share of what it was before.
pub(super) const SAME: f64 = 1e-9;

/// Share of a parameter in directions without information from which on it is not known: its standard deviation there is infinite.
const UNKNOWN_SHARE: f64 = 1e-6;

/// Gap, stretch, shear, three bends, shutter, rings, what models do not know.
const EXTRA: usize = 7 + RINGS + FIELD;
pub(super) const GAP: usize = 0;
pub(super) const STRETCH: usize = 1;
pub(super) const BENT: usize = 3;
pub(super) const SHUTTER: usize = 6;
pub(super) const PROFILE: usize = 7;
pub(super) const UNMODELLED: usize = PROFILE + RINGS;
const SIZE: usize = MAX_PARAMETERS + EXTRA;

/// Normal matrix of lens and causes with the views' poses eliminated.
pub(super) struct Sums {
    pub matrix: SMatrix<f64, SIZE, SIZE>,
    pub gradient: SVector<f64, SIZE>,
    pub squares: f64,
    /// What the views' own poses took off.
    pub of_poses: f64,
    /// What views' own times would take off, each alone; the sum of their squares, s², and how many there are.
    pub of_times: f64,
    pub times: [f64; 2],
    pub corners: f64,
    pub centre: Vector3<f64>,
    /// Views that were added, those that meet no pose too.
    pub views: usize,
    /// What each view says of the lens.
    pub by_view: Vec<LensOfView>,
}

/// Causes alone: with the lens eliminated too.
pub(super) struct Reduced {
    pub matrix: DMatrix<f64>,
    pub gradient: DVector<f64>,
    /// Diagonal before that.
    pub size: DVector<f64>,
    pub squares: f64,
    /// How the lens follows each cause.
    pub lens_by_cause: DMatrix<f64>,
}

/// How a corner misses, as its view's pose, the lens and the causes move it.
struct Linearized {
    error: Vector2<f64>,
    by_pose: SMatrix<f64, 2, 6>,
    by: SMatrix<f64, 2, SIZE>,
}

impl Residual for Linearized {
    fn dimension(&self) -> usize {
        2
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Se3>(), Shape::of::<SVector<f64, SIZE>>()] }
    }

    fn evaluate(&self, _: &Parameters<'_>, out: &mut Linearization<'_>) -> Result<(), Undefined> {
        out.set_residual(&self.error);
        out.set_jacobian(0, &self.by_pose);
        out.set_jacobian(1, &self.by);
        Ok(())
    }
}

impl Sums {
    pub fn new(target: &Target) -> Self {
        let [width, height] = target.corners_size();
        Self {
            matrix: SMatrix::zeros(),
            gradient: SVector::zeros(),
            squares: 0.0,
            of_poses: 0.0,
            of_times: 0.0,
            times: [0.0; 2],
            corners: 0.0,
            centre: Vector3::new(0.5 * width, 0.5 * height, 0.0),
            views: 0,
            by_view: Vec::new(),
        }
    }

    pub fn add(&mut self, target: &Target, camera: &Camera, view: &AdjustedView) {
        let mut problem = Problem::new();
        let pose = problem.add_block(view.camera_from_target);
        let unknowns = problem.add_block(SVector::<f64, SIZE>::zeros());
        let (mut of_time, mut gradient_of_time) = (0.0, 0.0);
        for corner in &view.corners {
            let in_camera = view.camera_from_target * corner.point;
            let Some(seen) = camera.project_full(&in_camera) else {
                continue;
            };
            let error = seen.pixel - corner.pixel;
            let by_pose: SMatrix<f64, 2, 6> =
                seen.pixel_by_point * moved_by_pose(&view.camera_from_target, &corner.point);
            let by_point = seen.pixel_by_point * view.camera_from_target.rotation_matrix();
            let mut by = SMatrix::<f64, 2, SIZE>::zeros();
            by.fixed_columns_mut::<MAX_PARAMETERS>(0)
                .copy_from(&seen.pixel_by_parameter);
            by.fixed_columns_mut::<EXTRA>(MAX_PARAMETERS)
                .copy_from(&self.by_causes(target, camera, corner, &seen.pixel, &by_point));
            let residual = Linearized { error, by_pose, by };
            let on = [pose.id(), unknowns.id()];
            if problem
                .add_residual(residual, &on, Kernel::Squared)
                .is_err()
            {
                continue;
            }
            of_time += corner.velocity_px_s.norm_squared();
            gradient_of_time += corner.velocity_px_s.dot(&error);
        }
        if of_time > 0.0 {
            self.of_times += gradient_of_time * gradient_of_time / of_time;
            self.times[0] += (gradient_of_time / of_time).powi(2);
            self.times[1] += 1.0;
        }
        let asked = [unknowns.id()];
        let found = marginal(&problem, &asked).or_else(|_| {
            // So few corners determine no pose: it stays.
            problem.set_constant(pose);
            marginal(&problem, &asked)
        });
        if let Ok(Marginal {
            information,
            gradient,
            squares,
            taken,
        }) = found
        {
            let corners = problem.residual_count() as f64;
            let lens = camera.lens.parameters().count;
            self.by_view.push(LensOfView {
                number: self.views,
                information: information.view((0, 0), (lens, lens)).into_owned(),
                gradient: gradient.rows(0, lens).into_owned(),
                squares,
                corners,
            });
            self.corners += corners;
            self.matrix += information;
            self.gradient += gradient;
            self.squares += squares;
            self.of_poses += taken;
        }
        self.views += 1;
    }

    /// How the pixel moves with each cause.
    fn by_causes(
        &self,
        target: &Target,
        camera: &Camera,
        corner: &AdjustedCorner,
        seen: &Vector2<f64>,
        by_point: &SMatrix<f64, 2, 3>,
    ) -> SMatrix<f64, 2, EXTRA> {
        let mut by = SMatrix::<f64, 2, EXTRA>::zeros();
        let from_centre = corner.point - self.centre;
        let (x, y) = (from_centre.x, from_centre.y);
        let mut put = |column: usize, moved: Vector3<f64>| {
            by.set_column(column, &(by_point * moved));
        };
        if let Target::AprilGrid {
            tag_size_m,
            spacing_ratio,
            ..
        } = target
        {
            // From the middle of one gap to that of the next.
            let tag =
                |at: f64| ((at / tag_size_m + 0.5 * spacing_ratio) / (1.0 + spacing_ratio)).floor();
            let tags = Vector3::new(tag(corner.point.x), tag(corner.point.y), 0.0);
            put(GAP, tags * *tag_size_m);
        }
        put(STRETCH, Vector3::new(0.0, y, 0.0));
        put(STRETCH + 1, Vector3::new(y, 0.0, 0.0));
        put(BENT, Vector3::new(0.0, 0.0, x * x));
        put(BENT + 1, Vector3::new(0.0, 0.0, x * y));
        put(BENT + 2, Vector3::new(0.0, 0.0, y * y));
        let row = corner.pixel.y / f64::from(camera.height.max(1));
        by.set_column(SHUTTER, &(corner.velocity_px_s * row));
        let (from_middle, share) = from_middle(camera, seen);
        let ring = ((share * RINGS as f64) as usize).min(RINGS - 1);
        let outwards = from_middle.try_normalize(1e-9).unwrap_or_default();
        by.set_column(PROFILE + ring, &outwards);
        let place = from_centre / self.half_m();
        by.fixed_columns_mut::<FIELD>(UNMODELLED)
            .copy_from(&moved_by_field(camera, seen, by_point, &place));
        by
    }

    /// Causes alone, the lens moving along.
    pub fn reduced(&self, camera: &Camera) -> Reduced {
        let lens = camera.lens.parameters().count;
        let (matrix, gradient) = (&self.matrix, &self.gradient);
        let of_lens = matrix.view((0, 0), (lens, lens)).into_owned();
        let to_lens = matrix.view((MAX_PARAMETERS, 0), (EXTRA, lens)).into_owned();
        let inverse = inverse(&of_lens, &of_lens.diagonal());
        let by_lens = gradient.rows(0, lens).into_owned();
        let solved = &inverse * &by_lens;
        let causes = matrix
            .view((MAX_PARAMETERS, MAX_PARAMETERS), (EXTRA, EXTRA))
            .into_owned();
        let gradient = gradient.rows(MAX_PARAMETERS, EXTRA).into_owned();
        Reduced {
            squares: self.squares - by_lens.dot(&solved),
            gradient: gradient - &to_lens * solved,
            size: causes.diagonal(),
            matrix: causes - &to_lens * &inverse * to_lens.transpose(),
            lens_by_cause: -(inverse * to_lens.transpose()),
        }
    }

    /// Half the longer edge of the board, metres.
    pub fn half_m(&self) -> f64 {
        self.centre.amax().max(1e-9)
    }
}

/// Inverse on the directions that are there at all, measured by `size`: lenses that were given are looked at by few views too, which the
/// solver refuses where they do not determine all of a lens. It is a covariance only of what [`is_determined`] says.
pub(super) fn inverse(matrix: &DMatrix<f64>, size: &DVector<f64>) -> DMatrix<f64> {
    let Scaled { eigen, scale } = Scaled::new(matrix, size);
    let values = eigen
        .eigenvalues
        .map(|v| if v > SAME { 1.0 / v } else { 0.0 });
    let inverse =
        &eigen.eigenvectors * DMatrix::from_diagonal(&values) * eigen.eigenvectors.transpose();
    DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| {
        inverse[(i, j)] * scale[i] * scale[j]
    })
}

/// Which parameters are known at all: those of no direction without information, in which any value would do.
pub(super) fn is_determined(matrix: &DMatrix<f64>, size: &DVector<f64>) -> Vec<bool> {
    let Scaled { eigen, scale } = Scaled::new(matrix, size);
    let values = eigen.eigenvalues.iter().enumerate();
    let unknown: Vec<usize> = values.filter(|(_, v)| **v <= SAME).map(|v| v.0).collect();
    let share = |k: usize| -> f64 {
        let own = unknown.iter().map(|at| eigen.eigenvectors[(k, *at)]);
        own.map(|part| part * part).sum()
    };
    (0..matrix.nrows())
        .map(|k| scale[k] > 0.0 && share(k) < UNKNOWN_SHARE)
        .collect()
}

/// A normal matrix in units of its own.
struct Scaled {
    eigen: SymmetricEigen<f64, Dyn>,
    /// What its rows were multiplied by; zero where there is nothing.
    scale: DVector<f64>,
}

impl Scaled {
    fn new(matrix: &DMatrix<f64>, size: &DVector<f64>) -> Self {
        let scale = size.map(|v| if v > 0.0 { 1.0 / v.sqrt() } else { 0.0 });
        let scaled = DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| {
            matrix[(i, j)] * scale[i] * scale[j]
        });
        Self {
            eigen: scaled.symmetric_eigen(),
            scale,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Once the standard deviation of such a parameter was that of the directions that are there: a small number for what is not known.
    #[test]
    fn directions_without_information_are_not_called_certain() {
        // Only the sum of the first two is measured, the third alone, the fourth not at all.
        let rows = [[1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 2.0, 0.0]];
        let matrix = rows.iter().fold(DMatrix::zeros(4, 4), |sum, row| {
            let row = DVector::from_row_slice(row);
            sum + &row * row.transpose()
        });
        let inverse = inverse(&matrix, &matrix.diagonal());
        assert!(inverse[(0, 0)] > 0.0 && inverse[(0, 0)].is_finite());
        let determined = is_determined(&matrix, &matrix.diagonal());
        assert_eq!(determined, [false, false, true, false]);
    }
}
