//! Camera models: point in the camera frame to pixel and back.
//!
//! Pixel (0, 0) is the centre of the top-left pixel. Every model is `pixel = focal ⊙ d(point) + principal`, where `d` is
//! the lens. Each lens is one file: its formula, its derivatives, its validity region and its inverse.
//!
//! | model | file | elsewhere called |
//! | --- | --- | --- |
//! | pinhole with radial-tangential distortion | `radtan.rs` | OpenCV `calib3d`, ROS `plumb_bob`, Kalibr `pinhole-radtan` |
//! | Kannala–Brandt | `kannala_brandt.rs` | OpenCV `fisheye`, ROS `equidistant`, Kalibr `pinhole-equi` |
//! | double sphere | `double_sphere.rs` | Basalt and Kalibr `ds` |
//! | extended unified | `extended_unified.rs` | Kalibr `eucm` |
//! | field of view | `field_of_view.rs` | Kalibr `pinhole-fov`, COLMAP `FOV` |

mod colmap;
mod double_sphere;
mod extended_unified;
mod field_of_view;
mod kannala_brandt;
mod parameters;
mod radtan;

use nalgebra::{Matrix2x3, SMatrix, Vector2, Vector3};
use serde::{Deserialize, Serialize};

pub use colmap::{ColmapError, ColmapModel};
pub use parameters::{LensModel, LensParameters, MAX_PARAMETERS};

/// Derivative by the distortion parameters, columns beyond the model's own are zero.
type ByDistortion = SMatrix<f64, 2, 5>;

/// Lens model and its parameters, pixels and radians.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Lens {
    /// `x = z`-plane coordinates, distorted by `k1 k2 k3` radially and `p1 p2` tangentially.
    PinholeRadtan {
        /// Focal lengths, pixels.
        focal_px: [f64; 2],
        /// Principal point, pixels.
        principal_px: [f64; 2],
        /// `k1, k2, p1, p2, k3`.
        distortion: [f64; 5],
    },
    /// `r(θ) = θ + k1 θ³ + k2 θ⁵ + k3 θ⁷ + k4 θ⁹`.
    KannalaBrandt {
        /// Focal lengths, pixels.
        focal_px: [f64; 2],
        /// Principal point, pixels.
        principal_px: [f64; 2],
        /// `k1 … k4`.
        distortion: [f64; 4],
    },
    /// Projection by two spheres a distance `xi` apart, then a pinhole shifted by `alpha / (1 − alpha)`.
    DoubleSphere {
        /// Focal lengths, pixels.
        focal_px: [f64; 2],
        /// Principal point, pixels.
        principal_px: [f64; 2],
        /// `xi, alpha`; `alpha` in [0, 1].
        distortion: [f64; 2],
    },
    /// Projection by an ellipsoid of shape `beta`, then a pinhole shifted by `alpha / (1 − alpha)`.
    ExtendedUnified {
        /// Focal lengths, pixels.
        focal_px: [f64; 2],
        /// Principal point, pixels.
        principal_px: [f64; 2],
        /// `alpha, beta`; `alpha` in [0, 1], `beta` positive.
        distortion: [f64; 2],
    },
    /// `r = atan(2 tan(ω/2) · tan θ) / ω`.
    FieldOfView {
        /// Focal lengths, pixels.
        focal_px: [f64; 2],
        /// Principal point, pixels.
        principal_px: [f64; 2],
        /// `omega`, radians, below π.
        distortion: [f64; 1],
    },
}

/// An image size and a lens.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// The lens.
    pub lens: Lens,
}

/// A projection with its derivative.
#[derive(Clone, Copy, Debug)]
pub struct Projection {
    /// Where the point is seen, pixels.
    pub pixel: Vector2<f64>,
    /// Derivative of the pixel by the point in the camera frame, pixels per metre.
    pub pixel_by_point: Matrix2x3<f64>,
}

/// A projection with its derivatives by point and lens parameters: what calibration reads.
#[derive(Clone, Copy, Debug)]
pub struct FullProjection {
    /// Where the point is seen, pixels.
    pub pixel: Vector2<f64>,
    /// Derivative of the pixel by the point in the camera frame, pixels per metre.
    pub pixel_by_point: Matrix2x3<f64>,
    /// Derivative of the pixel by [`Lens::parameters`]; columns beyond their number are zero.
    pub pixel_by_parameter: SMatrix<f64, 2, MAX_PARAMETERS>,
}

/// A point on the normalised image of a lens, `(pixel − principal) / focal`, and its derivative by the point in space.
struct Distorted {
    value: Vector2<f64>,
    by_point: Matrix2x3<f64>,
}

impl Camera {
    /// An undistorted pinhole camera.
    pub fn pinhole(width: u32, height: u32, focal_px: [f64; 2], principal_px: [f64; 2]) -> Self {
        Self {
            width,
            height,
            lens: Lens::PinholeRadtan {
                focal_px,
                principal_px,
                distortion: [0.0; 5],
            },
        }
    }

    /// Focal lengths, pixels.
    pub fn focal_px(&self) -> [f64; 2] {
        self.lens.focal_px()
    }

    /// Principal point, pixels.
    pub fn principal_px(&self) -> [f64; 2] {
        self.lens.principal_px()
    }

    /// Whether `pixel` lies on the image, at least `margin_px` from its border.
    pub fn contains(&self, pixel: &Vector2<f64>, margin_px: f64) -> bool {
        pixel.x >= margin_px - 0.5
            && pixel.y >= margin_px - 0.5
            && pixel.x <= self.width as f64 - 0.5 - margin_px
            && pixel.y <= self.height as f64 - 0.5 - margin_px
    }

    /// Pixel at which a point in the camera frame is seen; `None` outside the model's validity region: behind the lens,
    /// or beyond the angle at which the model folds over. The pixel may lie outside the image: see [`Camera::contains`].
    #[inline]
    pub fn project(&self, point_in_camera: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.project_with_jacobian(point_in_camera).map(|p| p.pixel)
    }

    /// [`Camera::project`] with the derivative by the point.
    #[inline]
    pub fn project_with_jacobian(&self, point_in_camera: &Vector3<f64>) -> Option<Projection> {
        let (f, c) = (self.lens.focal_px(), self.lens.principal_px());
        let d = self.lens.distort(point_in_camera)?;
        Some(Projection {
            pixel: Vector2::new(f[0] * d.value.x + c[0], f[1] * d.value.y + c[1]),
            pixel_by_point: scale_rows(d.by_point, f),
        })
    }

    /// [`Camera::project`] with the derivatives by the point and by the lens parameters.
    #[inline]
    pub fn project_full(&self, point_in_camera: &Vector3<f64>) -> Option<FullProjection> {
        let (f, c) = (self.lens.focal_px(), self.lens.principal_px());
        let (d, by_distortion) = self.lens.distort_full(point_in_camera)?;
        let mut pixel_by_parameter = SMatrix::<f64, 2, MAX_PARAMETERS>::zeros();
        pixel_by_parameter[(0, 0)] = d.value.x;
        pixel_by_parameter[(1, 1)] = d.value.y;
        pixel_by_parameter[(0, 2)] = 1.0;
        pixel_by_parameter[(1, 3)] = 1.0;
        pixel_by_parameter
            .fixed_view_mut::<2, 5>(0, 4)
            .copy_from(&scale_rows(by_distortion, f));
        Some(FullProjection {
            pixel: Vector2::new(f[0] * d.value.x + c[0], f[1] * d.value.y + c[1]),
            pixel_by_point: scale_rows(d.by_point, f),
            pixel_by_parameter,
        })
    }

    /// Unit viewing ray of a pixel in the camera frame; `None` where the model cannot be inverted.
    pub fn unproject(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let (f, c) = (self.focal_px(), self.principal_px());
        let d = Vector2::new((pixel.x - c[0]) / f[0], (pixel.y - c[1]) / f[1]);
        if !(d.x.is_finite() && d.y.is_finite()) {
            return None;
        }
        match &self.lens {
            Lens::PinholeRadtan { distortion, .. } => radtan::undistort(&d, distortion),
            Lens::KannalaBrandt { distortion, .. } => kannala_brandt::undistort(&d, distortion),
            Lens::DoubleSphere { distortion, .. } => double_sphere::undistort(&d, distortion),
            Lens::ExtendedUnified { distortion, .. } => extended_unified::undistort(&d, distortion),
            Lens::FieldOfView { distortion, .. } => field_of_view::undistort(&d, distortion),
        }
    }
}

impl Lens {
    /// Focal lengths, pixels.
    #[inline]
    pub fn focal_px(&self) -> [f64; 2] {
        match self {
            Lens::PinholeRadtan { focal_px, .. }
            | Lens::KannalaBrandt { focal_px, .. }
            | Lens::DoubleSphere { focal_px, .. }
            | Lens::ExtendedUnified { focal_px, .. }
            | Lens::FieldOfView { focal_px, .. } => *focal_px,
        }
    }

    /// Principal point, pixels.
    #[inline]
    pub fn principal_px(&self) -> [f64; 2] {
        match self {
            Lens::PinholeRadtan { principal_px, .. }
            | Lens::KannalaBrandt { principal_px, .. }
            | Lens::DoubleSphere { principal_px, .. }
            | Lens::ExtendedUnified { principal_px, .. }
            | Lens::FieldOfView { principal_px, .. } => *principal_px,
        }
    }

    #[inline]
    fn distort(&self, p: &Vector3<f64>) -> Option<Distorted> {
        if !(p.x.is_finite() && p.y.is_finite() && p.z.is_finite()) {
            return None;
        }
        match self {
            Lens::PinholeRadtan { distortion, .. } => radtan::distort(p, distortion),
            Lens::KannalaBrandt { distortion, .. } => kannala_brandt::distort(p, distortion),
            Lens::DoubleSphere { distortion, .. } => double_sphere::distort(p, distortion),
            Lens::ExtendedUnified { distortion, .. } => extended_unified::distort(p, distortion),
            Lens::FieldOfView { distortion, .. } => field_of_view::distort(p, distortion),
        }
    }

    /// [`Lens::distort`] with the derivative by the distortion.
    #[inline]
    fn distort_full(&self, p: &Vector3<f64>) -> Option<(Distorted, ByDistortion)> {
        if !(p.x.is_finite() && p.y.is_finite() && p.z.is_finite()) {
            return None;
        }
        Some(match self {
            Lens::PinholeRadtan { distortion, .. } => {
                (radtan::distort(p, distortion)?, radtan::by_distortion(p))
            }
            Lens::KannalaBrandt { distortion, .. } => kannala_brandt::distort_full(p, distortion)?,
            Lens::DoubleSphere { distortion, .. } => (
                double_sphere::distort(p, distortion)?,
                double_sphere::by_distortion(p, distortion),
            ),
            Lens::ExtendedUnified { distortion, .. } => (
                extended_unified::distort(p, distortion)?,
                extended_unified::by_distortion(p, distortion),
            ),
            Lens::FieldOfView { distortion, .. } => (
                field_of_view::distort(p, distortion)?,
                field_of_view::by_distortion(p, distortion),
            ),
        })
    }
}

#[inline]
fn scale_rows<const N: usize>(
    mut rows: SMatrix<f64, 2, N>,
    factors: [f64; 2],
) -> SMatrix<f64, 2, N> {
    for column in 0..N {
        rows[(0, column)] *= factors[0];
        rows[(1, column)] *= factors[1];
    }
    rows
}

/// `(x, y) / depth` and its derivative by the point, for lenses that end in a pinhole: the depth with its gradient.
#[inline]
fn divide(p: &Vector3<f64>, depth: f64, depth_by_point: &Vector3<f64>) -> Distorted {
    let inverse = 1.0 / depth;
    let value = Vector2::new(p.x * inverse, p.y * inverse);
    let g = depth_by_point * inverse;
    Distorted {
        value,
        by_point: Matrix2x3::new(
            inverse - value.x * g.x,
            -value.x * g.y,
            -value.x * g.z,
            -value.y * g.x,
            inverse - value.y * g.y,
            -value.y * g.z,
        ),
    }
}

#[cfg(test)]
mod tests;
