//! Camera models: point in the camera frame to pixel and back.
//!
//! Pixel (0, 0) is the centre of the top-left pixel. Pinhole with radial-tangential distortion as in OpenCV's
//! `calib3d`; Kannala–Brandt as in Kannala and Brandt 2006, eq. 6 (OpenCV's `fisheye`, Kalibr's `pinhole-equi`).

use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

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
        match self.lens {
            Lens::PinholeRadtan { focal_px, .. } | Lens::KannalaBrandt { focal_px, .. } => focal_px,
        }
    }

    /// Principal point, pixels.
    pub fn principal_px(&self) -> [f64; 2] {
        match self.lens {
            Lens::PinholeRadtan { principal_px, .. } | Lens::KannalaBrandt { principal_px, .. } => {
                principal_px
            }
        }
    }

    /// Whether `pixel` lies on the image, at least `margin_px` from its border.
    pub fn contains(&self, pixel: &Vector2<f64>, margin_px: f64) -> bool {
        pixel.x >= margin_px - 0.5
            && pixel.y >= margin_px - 0.5
            && pixel.x <= self.width as f64 - 0.5 - margin_px
            && pixel.y <= self.height as f64 - 0.5 - margin_px
    }

    /// Pixel at which a point in the camera frame is seen; `None` behind the lens or where the model folds over.
    /// The pixel may lie outside the image: see [`Camera::contains`].
    pub fn project(&self, point_in_camera: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.project_with_jacobian(point_in_camera).map(|p| p.pixel)
    }

    /// [`Camera::project`] with the derivative by the point.
    pub fn project_with_jacobian(&self, point_in_camera: &Vector3<f64>) -> Option<Projection> {
        let p = point_in_camera;
        if !(p.x.is_finite() && p.y.is_finite() && p.z.is_finite()) {
            return None;
        }
        match &self.lens {
            Lens::PinholeRadtan {
                focal_px: f,
                principal_px: c,
                distortion,
            } => {
                if p.z < 1e-6 {
                    return None;
                }
                let inverse_z = 1.0 / p.z;
                let n = Vector2::new(p.x * inverse_z, p.y * inverse_z);
                let (d, d_by_n) = radtan(&n, distortion)?;
                let n_by_p = Matrix2x3::new(
                    inverse_z,
                    0.0,
                    -n.x * inverse_z,
                    0.0,
                    inverse_z,
                    -n.y * inverse_z,
                );
                Some(Projection {
                    pixel: Vector2::new(f[0] * d.x + c[0], f[1] * d.y + c[1]),
                    pixel_by_point: Matrix2::new(f[0], 0.0, 0.0, f[1]) * d_by_n * n_by_p,
                })
            }
            Lens::KannalaBrandt {
                focal_px: f,
                principal_px: c,
                distortion: k,
            } => {
                let radius_squared = p.x * p.x + p.y * p.y;
                let radius = radius_squared.sqrt();
                let norm_squared = radius_squared + p.z * p.z;
                if norm_squared < 1e-18 {
                    return None;
                }
                let theta = radius.atan2(p.z);
                let (r, r_by_theta) = kannala_brandt(theta, k);
                if r_by_theta <= 0.0 || theta > MAX_THETA {
                    return None;
                }
                if radius < 1e-9 * p.z.abs() {
                    let s = 1.0 / p.z;
                    return Some(Projection {
                        pixel: Vector2::new(f[0] * p.x * s + c[0], f[1] * p.y * s + c[1]),
                        pixel_by_point: Matrix2x3::new(f[0] * s, 0.0, 0.0, 0.0, f[1] * s, 0.0),
                    });
                }
                let (ux, uy) = (p.x / radius, p.y / radius);
                // dθ/dp = (z u, −ρ)/|p|², du/dp = (I − u uᵀ)/ρ
                let t = p.z / norm_squared;
                let tz = -radius / norm_squared;
                let s = r / radius;
                let by_point = Matrix2x3::new(
                    f[0] * (r_by_theta * t * ux * ux + s * uy * uy),
                    f[0] * (r_by_theta * t - s) * ux * uy,
                    f[0] * r_by_theta * tz * ux,
                    f[1] * (r_by_theta * t - s) * ux * uy,
                    f[1] * (r_by_theta * t * uy * uy + s * ux * ux),
                    f[1] * r_by_theta * tz * uy,
                );
                Some(Projection {
                    pixel: Vector2::new(f[0] * r * ux + c[0], f[1] * r * uy + c[1]),
                    pixel_by_point: by_point,
                })
            }
        }
    }

    /// Unit viewing ray of a pixel in the camera frame; `None` where the model cannot be inverted.
    pub fn unproject(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let (f, c) = (self.focal_px(), self.principal_px());
        let d = Vector2::new((pixel.x - c[0]) / f[0], (pixel.y - c[1]) / f[1]);
        match &self.lens {
            Lens::PinholeRadtan { distortion, .. } => {
                let mut n = d;
                for _ in 0..20 {
                    let (value, jacobian) = radtan(&n, distortion)?;
                    let step = jacobian.try_inverse()? * (d - value);
                    n += step;
                    if step.norm() < 1e-14 {
                        break;
                    }
                }
                let (value, _) = radtan(&n, distortion)?;
                ((value - d).norm() < 1e-9).then(|| Vector3::new(n.x, n.y, 1.0).normalize())
            }
            Lens::KannalaBrandt { distortion: k, .. } => {
                let r = d.norm();
                if r < 1e-12 {
                    return Some(Vector3::new(d.x, d.y, 1.0).normalize());
                }
                let mut theta = r.min(MAX_THETA);
                for _ in 0..30 {
                    let (value, slope) = kannala_brandt(theta, k);
                    if slope <= 0.0 {
                        return None;
                    }
                    let step = (r - value) / slope;
                    theta += step;
                    if step.abs() < 1e-14 {
                        break;
                    }
                }
                let (value, slope) = kannala_brandt(theta, k);
                if (value - r).abs() > 1e-9 || slope <= 0.0 || !(0.0..=MAX_THETA).contains(&theta) {
                    return None;
                }
                let s = theta.sin() / r;
                Some(Vector3::new(d.x * s, d.y * s, theta.cos()))
            }
        }
    }
}

/// Angles from the axis beyond this are treated as behind the lens (200° field of view).
const MAX_THETA: f64 = 100.0 * std::f64::consts::PI / 180.0;

/// `r(θ)` and `dr/dθ`.
fn kannala_brandt(theta: f64, k: &[f64; 4]) -> (f64, f64) {
    let t2 = theta * theta;
    let r = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
    let slope = 1.0 + t2 * (3.0 * k[0] + t2 * (5.0 * k[1] + t2 * (7.0 * k[2] + t2 * 9.0 * k[3])));
    (r, slope)
}

/// Distorted normalised coordinates and their derivative; `None` where the radial polynomial has folded over.
fn radtan(
    n: &Vector2<f64>,
    [k1, k2, p1, p2, k3]: &[f64; 5],
) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let (x, y) = (n.x, n.y);
    let r2 = n.norm_squared();
    let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    let radial_by_r2 = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
    if radial + 2.0 * r2 * radial_by_r2 <= 0.0 {
        return None;
    }
    let d = Vector2::new(
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    );
    let cross = 2.0 * x * y * radial_by_r2 + 2.0 * p1 * x + 2.0 * p2 * y;
    let jacobian = Matrix2::new(
        radial + 2.0 * x * x * radial_by_r2 + 2.0 * p1 * y + 6.0 * p2 * x,
        cross,
        cross,
        radial + 2.0 * y * y * radial_by_r2 + 6.0 * p1 * y + 2.0 * p2 * x,
    );
    Some((d, jacobian))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cameras() -> [Camera; 3] {
        let fisheye = |distortion| Camera {
            width: 640,
            height: 400,
            lens: Lens::KannalaBrandt {
                focal_px: [350.0, 352.0],
                principal_px: [321.0, 198.5],
                distortion,
            },
        };
        [
            fisheye([0.01, -0.02, 0.005, -0.001]),
            fisheye([0.0; 4]),
            Camera {
                width: 640,
                height: 480,
                lens: Lens::PinholeRadtan {
                    focal_px: [500.0, 510.0],
                    principal_px: [320.0, 240.0],
                    distortion: [-0.28, 0.07, 1e-3, -5e-4, 0.0],
                },
            },
        ]
    }

    proptest! {
        #[test]
        fn unproject_inverts_project(u in 5.0..635.0f64, v in 5.0..395.0f64, depth in 0.2..50.0f64) {
            for camera in cameras() {
                let ray = camera.unproject(&Vector2::new(u, v)).expect("inside the image");
                prop_assert!((ray.norm() - 1.0).abs() < 1e-12);
                let pixel = camera.project(&(ray * depth)).expect("in front");
                prop_assert!((pixel - Vector2::new(u, v)).norm() < 1e-7);
            }
        }

        #[test]
        fn jacobian_matches_numeric_differences(x in -0.6..0.6f64, y in -0.6..0.6f64, z in 0.8..5.0f64) {
            for camera in cameras() {
                let p = Vector3::new(x, y, z);
                let Some(projection) = camera.project_with_jacobian(&p) else { continue };
                for axis in 0..3 {
                    let mut h = Vector3::zeros();
                    h[axis] = 1e-6;
                    let (Some(a), Some(b)) = (camera.project(&(p + h)), camera.project(&(p - h))) else { continue };
                    let numeric = (a - b) / 2e-6;
                    prop_assert!((numeric - projection.pixel_by_point.column(axis)).norm() < 1e-4);
                }
            }
        }
    }

    #[test]
    fn behind_and_non_finite_points_are_not_seen() {
        for camera in cameras() {
            assert!(camera.project(&Vector3::new(0.0, 0.0, -1.0)).is_none());
            assert!(camera.project(&Vector3::new(f64::NAN, 0.0, 1.0)).is_none());
            assert!(camera.project(&Vector3::zeros()).is_none());
        }
    }
}
