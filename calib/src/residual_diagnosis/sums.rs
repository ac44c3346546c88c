//! The normal matrix behind a diagnosis.

use lsfb_geometry::camera::MAX_PARAMETERS;
use lsfb_geometry::{Camera, Matrix6, Vector2, Vector3, Vector6};
use lsfb_types::{Finding, Verdict};
use nalgebra::{DMatrix, DVector, RowSVector, SMatrix, SVector};

use super::field::{DEFORMATIONS, FIELD, Field, Unmodelled, moved_by_field, usual_sigma};
use super::{AdjustedCorner, AdjustedView, BoardDeformation, Deformation, from_middle};
use crate::board::Target;
use crate::projection::moved_by_pose;

/// Rings of the lens's radial profile.
const RINGS: usize = 8;
/// Pivot below which a direction is one that poses and lens have too, as a share of what it was before.
const SAME: f64 = 1e-9;

/// Gap, stretch, shear, three bends, shutter, rings, what models do not know.
const EXTRA: usize = 7 + RINGS + FIELD;
const GAP: usize = 0;
const STRETCH: usize = 1;
const BENT: usize = 3;
const SHUTTER: usize = 6;
const PROFILE: usize = 7;
const UNMODELLED: usize = PROFILE + RINGS;
const SIZE: usize = MAX_PARAMETERS + EXTRA;

/// Share of what views' own poses explain that their times alone must, and of all squares: by chance a sixth, and a hundredth.
const TIMES_OF_POSES: f64 = 0.7;
const LEAST_OF_TIMES: f64 = 0.15;

/// Standard deviations of a board: how far the middle of an edge is out of its plane, metres; stretch and shear.
const BEND_SIGMA_M: f64 = 2e-3;
const STRETCH_SIGMA: f64 = 1e-3;
/// Chi-square of [`DEFORMATIONS`] that a flat board exceeds once in a thousand recordings.
const FLAT_CHI_SQUARE: f64 = 20.5;
/// Chi-square of [`FIELD`] that noise exceeds once in a thousand recordings, and of [`FREED`].
const FIELD_CHI_SQUARE: f64 = 31.3;
const UNMODELLED_CHI_SQUARE: f64 = 39.3;
/// Share of the squares, and of their variance, that another lens must take off one that was given.
const LENS_SHARE: f64 = 0.2;
const LENS_CHI_SQUARE: f64 = 60.0;
/// Standard deviations of lenses about those that were given where these do not fit: focal lengths as a share, the principal
/// point as a share of the image's width, distortion.
const LENS_SIGMAS: [f64; 3] = [0.005, 0.01, 0.02];

/// Change of the gap between tags, as a share of their edge, that is no inaccuracy of a print.
const ANOTHER_GAP: f64 = 0.02;

/// One thing that would explain errors.
struct Cause {
    /// First of its columns and how many it has.
    columns: [usize; 2],
    words: fn(&Target, &DVector<f64>) -> String,
}

const CAUSES: [Cause; 5] = [
    Cause {
        columns: [GAP, 1],
        words: |target, by| match *target {
            Target::AprilGrid { spacing_ratio, .. } => format!(
                "gaps of {:.3} of a tag's edge instead of {spacing_ratio}: measure a tag and a gap, and correct tagSpacing",
                spacing_ratio + by[0]
            ),
            Target::Checkerboard { .. } | Target::Charuco { .. } => String::new(),
        },
    },
    Cause {
        columns: [STRETCH, 2],
        words: |_, by| {
            format!(
                "a board that is {:+.2} % longer along y and whose corners are {:+.2}° from right angles: measure both of its edges and diagonals",
                by[0] * 100.0,
                by[1].atan().to_degrees()
            )
        },
    },
    Cause {
        columns: [BENT, 3],
        words: |target, by| {
            let half = target.corners_size().map(|s| 0.5 * s);
            let bends = [
                by[0] * half[0] * half[0],
                by[1] * half[0] * half[1],
                by[2] * half[1] * half[1],
            ];
            let most = bends.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
            format!(
                "a board that is bent by {:.1} mm: glue it to a stiff plate",
                most * 1e3
            )
        },
    },
    Cause {
        columns: [SHUTTER, 1],
        words: |_, by| {
            format!(
                "a shutter that rolls, {:.1} ms from the first row to the last: give the rig its readout_s, or have it searched (readout = \"estimated\")",
                by[0] * 1e3
            )
        },
    },
    Cause {
        columns: [PROFILE, RINGS],
        words: |_, _| "a lens of another model: try another --model".to_owned(),
    },
];

/// A cause, and the share of the squares that it takes off.
pub(super) struct Explained {
    pub share: f64,
    pub words: String,
    /// Whether it is a gap between tags that no print of the board said has.
    pub is_another_gap: bool,
}

/// Normal matrix of lens and causes with the views' poses eliminated.
pub(super) struct Sums {
    matrix: SMatrix<f64, SIZE, SIZE>,
    gradient: SVector<f64, SIZE>,
    squares: f64,
    /// What the views' own poses took off.
    of_poses: f64,
    /// What views' own times would take off, each alone; the sum of their squares, s², and how many there are.
    of_times: f64,
    times: [f64; 2],
    corners: f64,
    centre: Vector3<f64>,
}

/// Deformations of the board and [`Field`].
const FREED: usize = DEFORMATIONS + FIELD;

/// Both, freed together.
struct Freed {
    step: SVector<f64, FREED>,
    covariance: SMatrix<f64, FREED, FREED>,
}

/// A step of a lens's own parameters.
struct OwnLens {
    inverse: DMatrix<f64>,
    step: DVector<f64>,
    /// Squares that it takes off.
    taken: f64,
    /// Of a corner in one direction then, px².
    variance: f64,
}

/// Causes alone: with the lens eliminated too.
struct Reduced {
    matrix: DMatrix<f64>,
    gradient: DVector<f64>,
    /// Diagonal before that.
    size: DVector<f64>,
    squares: f64,
    /// How the lens follows each cause.
    lens_by_cause: DMatrix<f64>,
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
        }
    }

    pub fn add(&mut self, target: &Target, camera: &Camera, view: &AdjustedView) {
        let mut of_pose = Matrix6::zeros();
        let mut gradient_of_pose = Vector6::zeros();
        let mut coupling = SMatrix::<f64, SIZE, 6>::zeros();
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
            self.matrix += by.transpose() * by;
            self.gradient += by.transpose() * error;
            self.squares += error.norm_squared();
            self.corners += 1.0;
            of_pose += by_pose.transpose() * by_pose;
            gradient_of_pose += by_pose.transpose() * error;
            coupling += by.transpose() * by_pose;
            of_time += corner.velocity_px_s.norm_squared();
            gradient_of_time += corner.velocity_px_s.dot(&error);
        }
        if of_time > 0.0 {
            self.of_times += gradient_of_time * gradient_of_time / of_time;
            self.times[0] += (gradient_of_time / of_time).powi(2);
            self.times[1] += 1.0;
        }
        if let Some(inverse) = of_pose.try_inverse() {
            let solved = inverse * gradient_of_pose;
            self.matrix -= coupling * inverse * coupling.transpose();
            self.gradient -= coupling * solved;
            self.squares -= gradient_of_pose.dot(&solved);
            self.of_poses += gradient_of_pose.dot(&solved);
        }
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

    fn reduced(&self, camera: &Camera) -> Reduced {
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

    /// A lens that was given, beside the one that these views have for themselves: one step of its own parameters.
    pub fn given_lens(&self, name: &str, camera: &Camera) -> Option<Finding> {
        let lens = camera.lens.parameters();
        let OwnLens {
            inverse,
            step,
            taken,
            variance,
        } = self.own_lens(camera)?;
        // Focal lengths and the principal point come first in every model.
        let sigma = |k: usize| (inverse[(k, k)] * variance).max(0.0).sqrt();
        let clearest = (0..4).max_by(|a, b| {
            let clear = |k: usize| step[k].abs() / sigma(k).max(1e-12);
            clear(*a).total_cmp(&clear(*b))
        })?;
        let value = lens.values[clearest] + step[clearest];
        let what = format!(
            "the lens that was given does not fit these images: {:.0} % of the squares would be explained by another, with {} = {value:.1} ± {:.1} px instead of {:.1}",
            100.0 * taken / self.squares,
            camera.lens.model().parameter_names()[clearest],
            sigma(clearest),
            lens.values[clearest]
        );
        let finding = Finding::new("given-lens", Verdict::Warn, name, what);
        let finding = finding.value(value, "px").sigma(sigma(clearest));
        Some(finding.remedy("calibrate the camera again"))
    }

    /// The lens that these views have for themselves where that fits clearly better than the one that was given; parameters that few
    /// views do not tell stay near those given, as lenses usually do.
    pub fn lens_of_its_own(&self, camera: &Camera) -> Option<Camera> {
        let OwnLens { variance, .. } = self.own_lens(camera)?;
        let lens = camera.lens.parameters();
        let mut information = self
            .matrix
            .view((0, 0), (lens.count, lens.count))
            .into_owned();
        for k in 0..lens.count {
            let usual = match k {
                0 | 1 => LENS_SIGMAS[0] * lens.values[k],
                2 | 3 => LENS_SIGMAS[1] * f64::from(camera.width),
                _ => LENS_SIGMAS[2],
            };
            information[(k, k)] += variance / (usual * usual);
        }
        let gradient = self.gradient.rows(0, lens.count).into_owned();
        let step = information.cholesky()?.solve(&gradient);
        let mut values = lens.values;
        for (value, step) in values.iter_mut().zip(step.iter()) {
            *value -= step;
        }
        let own = camera.lens.model().lens(&values);
        own.problem().is_none().then_some(Camera {
            lens: own,
            ..*camera
        })
    }

    /// One step of a lens's own parameters; `None` where it is no clear gain.
    fn own_lens(&self, camera: &Camera) -> Option<OwnLens> {
        let count = camera.lens.parameters().count;
        let own = self.matrix.view((0, 0), (count, count)).into_owned();
        let inverse = inverse(&own, &own.diagonal());
        let gradient = self.gradient.rows(0, count).into_owned();
        let step = -(&inverse * &gradient);
        let taken = -gradient.dot(&step);
        let left = (self.squares - taken).max(1e-12);
        let variance = left / (2.0 * self.corners - count as f64).max(1.0);
        let clear = taken >= LENS_SHARE * self.squares && taken >= LENS_CHI_SQUARE * variance;
        clear.then_some(OwnLens {
            inverse,
            step,
            taken,
            variance,
        })
    }

    /// Views that were not taken when their stamps say, if that is what keeps them off the IMU's motion.
    pub fn off_their_stamps(&self) -> Option<Explained> {
        let share = self.of_times / (self.of_poses + self.squares).max(1e-12);
        let dominant = self.of_times > TIMES_OF_POSES * self.of_poses;
        (dominant && share > LEAST_OF_TIMES).then(|| Explained {
            share,
            words: format!(
                "views that were taken {:.1} ms rms off their stamps: these jitter or jump",
                (self.times[0] / self.times[1].max(1.0)).sqrt() * 1e3
            ),
            is_another_gap: false,
        })
    }

    /// The cause that explains most; `None` where nothing can be said.
    pub fn explain(&self, target: &Target, camera: &Camera) -> Option<Explained> {
        let reduced = self.reduced(camera);
        let of_views = Explained {
            share: self.of_poses / (self.of_poses + self.squares).max(1e-12),
            words: format!(
                "poses of the views that do not follow the IMU (each alone is met to {:.2} px): the board is of another size, the IMU's noise is understated, or clocks jump",
                (self.squares / self.corners.max(1.0)).max(0.0).sqrt()
            ),
            is_another_gap: false,
        };
        let explained = CAUSES.iter().map(|cause| {
            let [first, count] = cause.columns;
            let own = reduced.matrix.view((first, first), (count, count));
            let size = reduced.size.rows(first, count).into_owned();
            let gradient = reduced.gradient.rows(first, count).into_owned();
            let step = -(inverse(&own.into_owned(), &size) * &gradient);
            Explained {
                share: -gradient.dot(&step) / reduced.squares.max(1e-12),
                words: (cause.words)(target, &step),
                is_another_gap: first == GAP && step[0].abs() > ANOTHER_GAP,
            }
        });
        let explained = explained.chain([of_views]);
        explained.max_by(|a, b| a.share.total_cmp(&b.share))
    }

    /// What moves pixels that lens and board do not know of, beside a board that may be deformed; `None` where it could be noise.
    pub fn field(&self, camera: &Camera, variance: f64) -> Option<Field> {
        let Freed { step, covariance } = self.freed(camera, variance)?;
        let own = covariance.fixed_view::<FIELD, FIELD>(DEFORMATIONS, DEFORMATIONS);
        let field: Field = step.fixed_rows::<FIELD>(DEFORMATIONS).into_owned();
        let chi_square = field.dot(&(own.into_owned().try_inverse()? * field));
        (chi_square > FIELD_CHI_SQUARE).then_some(field)
    }

    /// The same with the deformations of the board.
    pub fn unmodelled(&self, camera: &Camera, variance: f64) -> Option<Unmodelled> {
        let Freed { step, covariance } = self.freed(camera, variance)?;
        let chi_square = step.dot(&(covariance.try_inverse()? * step));
        (chi_square > UNMODELLED_CHI_SQUARE).then(|| Unmodelled {
            field: step.fixed_rows::<FIELD>(DEFORMATIONS).into_owned(),
            board: step.fixed_rows::<DEFORMATIONS>(0).into_owned(),
        })
    }

    /// Deformations of the board and [`Field`], beside the lens, within what is usual.
    fn freed(&self, camera: &Camera, variance: f64) -> Option<Freed> {
        let reduced = self.reduced(camera);
        let rows: [usize; FREED] = std::array::from_fn(|k| match k.checked_sub(DEFORMATIONS) {
            Some(k) => UNMODELLED + k,
            None => STRETCH + k,
        });
        let variance = variance.max(1e-12);
        let usual = self.usual_deformation();
        let information = SMatrix::<f64, FREED, FREED>::from_fn(|i, j| {
            let prior = match usual.get(i) {
                Some(usual) => *usual,
                None => usual_sigma(i - DEFORMATIONS).powi(-2),
            };
            let prior = if i == j { prior } else { 0.0 };
            reduced.matrix[(rows[i], rows[j])] / variance + prior
        });
        let covariance = information.try_inverse()?;
        let gradient = SVector::<f64, FREED>::from_fn(|i, _| reduced.gradient[rows[i]] / variance);
        Some(Freed {
            step: -covariance * gradient,
            covariance,
        })
    }

    /// Half the longer edge of the board, metres.
    fn half_m(&self) -> f64 {
        self.centre.amax().max(1e-9)
    }

    /// Information beforehand of stretch, shear and bends, by what boards usually are.
    fn usual_deformation(&self) -> [f64; DEFORMATIONS] {
        let half_m = self.half_m();
        let bend = (half_m * half_m / BEND_SIGMA_M).powi(2);
        let stretch = STRETCH_SIGMA.powi(-2);
        [stretch, stretch, bend, bend, bend]
    }

    /// The board if it may be stretched, sheared and bent, by what boards usually are.
    pub fn board(&self, target: &Target, camera: &Camera, variance: f64) -> Deformation {
        let variance = variance.max(1e-12);
        let reduced = self.reduced(camera);
        let usual = SVector::from(self.usual_deformation());
        let own = reduced
            .matrix
            .fixed_view::<DEFORMATIONS, DEFORMATIONS>(STRETCH, STRETCH);
        let information = own / variance + SMatrix::from_diagonal(&usual);
        let lens = reduced.lens_by_cause.nrows();
        let Some(covariance) = information.try_inverse() else {
            return Deformation {
                board: BoardDeformation::default(),
                lens_covariance: DMatrix::zeros(lens, lens),
            };
        };
        let gradient = reduced.gradient.fixed_rows::<DEFORMATIONS>(STRETCH) / variance;
        let step = -covariance * gradient;
        // What freeing the board takes off, in variances, is a chi-square where it is flat.
        let is_likely = -gradient.dot(&step) > FLAT_CHI_SQUARE;
        let by_deformation = reduced.lens_by_cause.columns(STRETCH, DEFORMATIONS);
        let lens_covariance = if is_likely {
            by_deformation * (covariance + step * step.transpose()) * by_deformation.transpose()
        } else {
            DMatrix::zeros(lens, lens)
        };
        let root = |variance: f64| variance.max(0.0).sqrt();

        let focal_px = camera.focal_px();
        let of_focal = |row: usize| -> RowSVector<f64, DEFORMATIONS> {
            let of_lens = reduced
                .lens_by_cause
                .fixed_view::<1, DEFORMATIONS>(row, STRETCH);
            of_lens * (0.5 / focal_px[row])
        };
        let of_focal = of_focal(0) + of_focal(1);

        let height = |k: usize| -> RowSVector<f64, DEFORMATIONS> {
            let from = target.corner(k) - self.centre;
            [0.0, 0.0, from.x * from.x, from.x * from.y, from.y * from.y].into()
        };
        let count = target.corner_count();
        // The plane is that of the mean.
        let mean = (0..count)
            .map(height)
            .sum::<RowSVector<f64, DEFORMATIONS>>()
            / count.max(1) as f64;
        let (bend_m, bend_sigma_m) = (0..count)
            .map(|k| {
                let by = height(k) - mean;
                (
                    (by * step)[0].abs(),
                    root((by * covariance * by.transpose())[0]),
                )
            })
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap_or_default();
        Deformation {
            board: BoardDeformation {
                bend_m,
                bend_sigma_m,
                focal_change: (of_focal * step)[0],
                focal_sigma: root((of_focal * covariance * of_focal.transpose())[0]),
                is_likely,
            },
            lens_covariance,
        }
    }
}

/// Inverse on the directions that are there at all, measured by `size`.
fn inverse(matrix: &DMatrix<f64>, size: &DVector<f64>) -> DMatrix<f64> {
    let scale = size.map(|v| if v > 0.0 { 1.0 / v.sqrt() } else { 0.0 });
    let scaled = DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| {
        matrix[(i, j)] * scale[i] * scale[j]
    });
    let eigen = scaled.symmetric_eigen();
    let values = eigen
        .eigenvalues
        .map(|v| if v > SAME { 1.0 / v } else { 0.0 });
    let inverse =
        &eigen.eigenvectors * DMatrix::from_diagonal(&values) * eigen.eigenvectors.transpose();
    DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| {
        inverse[(i, j)] * scale[i] * scale[j]
    })
}
