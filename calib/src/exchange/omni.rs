//! Kalibr's `omni` camera (C. Mei, P. Rives, "Single view point omnidirectional camera calibration from planar grids", ICRA 2007)
//! in a lens model of ours: a point on the unit sphere is seen from `xi` behind its centre, distorted radially and tangentially.

use lsfb_geometry::camera::{Lens, LensModel};
use lsfb_geometry::{Camera, Vector2, Vector3};

use crate::camera::fit_lens;

/// Directions in which the lens is sampled: angles from the axis, and around it.
const POLAR_STEP_DEG: f64 = 1.0;
const POLAR_STEPS: u32 = 120;
const AROUND: u32 = 48;
/// Distance by which the other model may miss, pixels: corners are found to a tenth of that.
const LARGEST_MISS_PX: f64 = 0.5;

/// An omnidirectional camera.
pub(super) struct Omni {
    pub xi: f64,
    pub focal_px: [f64; 2],
    pub principal_px: [f64; 2],
    /// k1, k2, p1, p2.
    pub distortion: [f64; 4],
}

impl Omni {
    /// Where a ray is seen and how far that is from the axis before distortion; `None` behind the mirror.
    fn project(&self, ray: &Vector3<f64>) -> Option<(Vector2<f64>, f64)> {
        let unit = ray.normalize();
        let depth = unit.z + self.xi;
        // Beyond this angle rays of both sides meet in one pixel.
        let limit = if self.xi > 1.0 {
            1.0 / self.xi
        } else {
            self.xi
        };
        if !(unit.z > -limit && depth > 1e-6) {
            return None;
        }
        let m = unit.xy() / depth;
        let [k1, k2, p1, p2] = self.distortion;
        let r2 = m.norm_squared();
        let radial = 1.0 + k1 * r2 + k2 * r2 * r2;
        let x = m.x * radial + 2.0 * p1 * m.x * m.y + p2 * (r2 + 2.0 * m.x * m.x);
        let y = m.y * radial + p1 * (r2 + 2.0 * m.y * m.y) + 2.0 * p2 * m.x * m.y;
        let [fx, fy] = self.focal_px;
        let [cx, cy] = self.principal_px;
        let off = Vector2::new(x, y).norm();
        Some((Vector2::new(fx * x + cx, fy * y + cy), off))
    }

    /// Rays and the pixels of the image in which they are seen, up to where the distortion turns back.
    fn rays(&self, width: u32, height: u32) -> Vec<(Vector3<f64>, Vector2<f64>)> {
        let mut rays = Vec::new();
        for k in 0..AROUND {
            let around = f64::from(k) / f64::from(AROUND) * std::f64::consts::TAU;
            let mut farthest = -1.0;
            for step in 0..POLAR_STEPS {
                let polar = (f64::from(step) * POLAR_STEP_DEG).to_radians();
                let ray = Vector3::new(
                    polar.sin() * around.cos(),
                    polar.sin() * around.sin(),
                    polar.cos(),
                );
                let Some((pixel, off)) = self.project(&ray).filter(|(_, off)| *off > farthest)
                else {
                    break;
                };
                farthest = off;
                let inside = |x: f64, size: u32| x > -0.5 && x < f64::from(size) - 0.5;
                if inside(pixel.x, width) && inside(pixel.y, height) {
                    rays.push((ray, pixel));
                }
            }
        }
        rays
    }

    /// The lens of ours that comes nearest, and by how much it misses at most, pixels. Without distortion it is the extended
    /// unified model of a sphere that is not stretched.
    pub(super) fn to_lens(&self, width: u32, height: u32) -> Result<(Lens, f64), String> {
        let own = 1.0 + self.xi;
        if !(self.xi >= 0.0 && own.is_finite()) {
            return Err(format!("xi of {}, expected 0 or more", self.xi));
        }
        let focal_px = self.focal_px.map(|f| f / own);
        if self.distortion == [0.0; 4] {
            let lens = Lens::ExtendedUnified {
                focal_px,
                principal_px: self.principal_px,
                distortion: [self.xi / own, 1.0],
            };
            return Ok((lens, 0.0));
        }
        let rays = self.rays(width, height);
        let like = Camera {
            width,
            height,
            lens: Lens::KannalaBrandt {
                focal_px,
                principal_px: self.principal_px,
                distortion: [0.0; 4],
            },
        };
        if rays.is_empty() || like.lens.problem().is_some() {
            return Err("the field of view of this omni lens misses its image".to_owned());
        }
        let best = [
            LensModel::KannalaBrandt,
            LensModel::DoubleSphere,
            LensModel::ExtendedUnified,
            LensModel::PinholeRadtan,
        ]
        .map(|model| {
            let lens = fit_lens(model, &like, &rays);
            let camera = Camera { lens, ..like };
            let miss_px = rays
                .iter()
                .map(|(ray, pixel)| {
                    camera
                        .project(ray)
                        .map_or(f64::INFINITY, |p| (p - pixel).norm())
                })
                .fold(0.0, f64::max);
            (lens, miss_px)
        })
        .into_iter()
        .min_by(|a, b| a.1.total_cmp(&b.1));
        match best {
            Some((lens, miss_px)) if miss_px <= LARGEST_MISS_PX => Ok((lens, miss_px)),
            Some((_, miss_px)) => Err(format!(
                "no supported model fits this omni lens: the nearest has an error of {miss_px:.1} px: calibrate with `lsfb calib camera`"
            )),
            None => Err("no lens model to fit".to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_distortion_it_is_the_unified_model() {
        let omni = Omni {
            xi: 1.6,
            focal_px: [900.0, 905.0],
            principal_px: [320.0, 240.0],
            distortion: [0.0; 4],
        };
        let (lens, miss_px) = omni.to_lens(640, 480).expect("a lens");
        assert_eq!(miss_px, 0.0);
        let camera = Camera {
            width: 640,
            height: 480,
            lens,
        };
        let rays = omni.rays(640, 480);
        assert!(rays.len() > 500, "{}", rays.len());
        for (ray, pixel) in rays {
            // K. Mei's projection of the same ray, written out.
            let [x, y, z] = [ray.x, ray.y, ray.z];
            let depth = z + 1.6 * (x * x + y * y + z * z).sqrt();
            let expected = Vector2::new(900.0 * x / depth + 320.0, 905.0 * y / depth + 240.0);
            let seen = camera.project(&ray).expect("in view");
            assert!((pixel - expected).norm() < 1e-9 && (seen - expected).norm() < 1e-9);
        }
    }

    #[test]
    fn with_distortion_the_nearest_model_is_told_with_its_miss() {
        let omni = Omni {
            xi: 1.1,
            focal_px: [660.0, 661.0],
            principal_px: [321.0, 239.0],
            distortion: [-0.12, 0.05, 5e-4, -3e-4],
        };
        let (_, miss_px) = omni.to_lens(640, 480).expect("a lens");
        assert!(miss_px > 0.0 && miss_px < LARGEST_MISS_PX, "{miss_px}");
        let strange = Omni {
            distortion: [0.9, -0.9, 0.1, 0.1],
            ..omni
        };
        let error = strange.to_lens(640, 480).expect_err("no supported model");
        assert!(error.contains("has an error of"), "{error}");
    }
}
