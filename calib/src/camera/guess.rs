//! A first camera and first poses, without input from the user.
//!
//! Both ideal lenses, `r = f tan θ` and `r = f θ`, are tried with many focal lengths; the one under which the views look most
//! like a plane wins, and the wanted model is fitted to it.

use lsfb_geometry::camera::{Lens, LensModel, MAX_PARAMETERS};
use lsfb_geometry::{Camera, Matrix3, Se3, Vector2, Vector3, so3};
use lsfb_solver::gauss_newton::{NormalEquations, minimise_damped};
use lsfb_types::median;
use nalgebra::{SMatrix, SVector};

use super::CameraViews;
use crate::Error;
use crate::board::Target;
use crate::detect::Corner;

/// Views that the focal length is guessed from.
const GUESS_VIEWS: usize = 12;
/// Focal lengths tried, from 0.15 to about 5 image widths.
const FOCAL_STEPS: i32 = 36;
const FOCAL_FIRST: f64 = 0.15;
const FOCAL_RATIO: f64 = 1.105;
/// Steps tried at most to fit a lens.
const FIT_TRIALS: u32 = 60;

type Parameters = SVector<f64, MAX_PARAMETERS>;

/// The camera under which the views fit best.
pub(super) fn camera(
    target: &Target,
    views: &CameraViews,
    chosen: &[i64],
    model: LensModel,
) -> Result<Camera, Error> {
    let (width, height) = (f64::from(views.width), f64::from(views.height));
    let principal_px = [0.5 * (width - 1.0), 0.5 * (height - 1.0)];
    let step = chosen.len().div_ceil(GUESS_VIEWS).max(1);
    let corners: Vec<&Vec<Corner>> = chosen
        .iter()
        .step_by(step)
        .filter_map(|instant| views.views.get(instant))
        .collect();
    let mut best: Option<(f64, Camera)> = None;
    for k in 0..FOCAL_STEPS {
        let focal_px = [FOCAL_FIRST * FOCAL_RATIO.powi(k) * width; 2];
        for lens in [
            Lens::PinholeRadtan {
                focal_px,
                principal_px,
                distortion: [0.0; 5],
            },
            Lens::KannalaBrandt {
                focal_px,
                principal_px,
                distortion: [0.0; 4],
            },
        ] {
            let camera = Camera {
                width: views.width,
                height: views.height,
                lens,
            };
            let mut total = 0.0;
            for corners in &corners {
                // A view that this camera cannot explain at all counts like one that is a tenth of the image off.
                let worst = 0.1 * width;
                let error = pose_of_target(target, &camera, corners)
                    .and_then(|pose| median_error_px(target, &camera, &pose, corners));
                total += error.unwrap_or(worst).min(worst);
            }
            if best.as_ref().is_none_or(|b| total < b.0) {
                best = Some((total, camera));
            }
        }
    }
    let (_, ideal) = best.ok_or_else(|| Error::TargetNotSeen {
        camera: views.name.clone(),
        found: 0,
        images: views.images,
        needed: 1,
        target: target.describe(),
    })?;
    if ideal.lens.model() == model {
        return Ok(ideal);
    }
    let rays = lens_rays(&ideal, corners.iter().copied());
    Ok(Camera {
        lens: fit_lens(model, &ideal, &rays),
        ..ideal
    })
}

/// The rays of corners by a lens, each with its pixel: what another lens is fitted to.
pub(super) fn lens_rays<'a>(
    camera: &Camera,
    views: impl Iterator<Item = &'a Vec<Corner>>,
) -> Vec<(Vector3<f64>, Vector2<f64>)> {
    views
        .flatten()
        .filter_map(|corner| Some((camera.unproject(&corner.pixel)?, corner.pixel)))
        .collect()
}

fn median_error_px(
    target: &Target,
    camera: &Camera,
    pose: &Se3,
    corners: &[Corner],
) -> Option<f64> {
    let errors: Vec<f64> = corners
        .iter()
        .filter_map(|c| {
            let seen = camera.project(&(*pose * target.corner(c.index)))?;
            Some((seen - c.pixel).norm())
        })
        .collect();
    if 2 * errors.len() < corners.len() {
        return None;
    }
    median(errors)
}

/// Pose of the target in the camera, from the homography between its plane and the viewing rays. `None` with fewer than six
/// corners in the camera's validity region.
pub fn pose_of_target(target: &Target, camera: &Camera, corners: &[Corner]) -> Option<Se3> {
    // Centred and scaled, so that the equations are well conditioned.
    let points: Vec<(Vector3<f64>, Vector3<f64>)> = corners
        .iter()
        .filter_map(|c| Some((camera.unproject(&c.pixel)?, target.corner(c.index))))
        .collect();
    if points.len() < 6 {
        return None;
    }
    let centre = points.iter().map(|p| p.1).sum::<Vector3<f64>>() / points.len() as f64;
    let size = points
        .iter()
        .map(|p| (p.1 - centre).norm())
        .fold(0.0, f64::max);
    if !(size > 0.0) {
        return None;
    }
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for (ray, point) in &points {
        let q = (point - centre) / size;
        let plane = Vector3::new(q.x, q.y, 1.0);
        // ray × (H plane) = 0, with H by rows
        let mut rows = SMatrix::<f64, 3, 9>::zeros();
        for k in 0..3 {
            rows[(0, 6 + k)] = ray.y * plane[k];
            rows[(0, 3 + k)] = -ray.z * plane[k];
            rows[(1, k)] = ray.z * plane[k];
            rows[(1, 6 + k)] = -ray.x * plane[k];
            rows[(2, 3 + k)] = ray.x * plane[k];
            rows[(2, k)] = -ray.y * plane[k];
        }
        normal += rows.transpose() * rows;
    }
    let eigen = normal.symmetric_eigen();
    let h = eigen
        .eigenvectors
        .column(eigen.eigenvalues.imin())
        .into_owned();
    let mut h = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]);
    let ahead: f64 = points
        .iter()
        .map(|(ray, point)| {
            let q = (point - centre) / size;
            ray.dot(&(h * Vector3::new(q.x, q.y, 1.0))).signum()
        })
        .sum();
    if ahead < 0.0 {
        h = -h;
    }
    let (x, y) = (h.column(0).into_owned(), h.column(1).into_owned());
    let scale = 0.5 * (x.norm() + y.norm());
    if !(scale > 1e-9) {
        return None;
    }
    let near = Matrix3::from_columns(&[x / scale, y / scale, (x / scale).cross(&(y / scale))]);
    let rotation = so3::nearest(&near)?;
    // The third column is where the centre is, in units of the size.
    let translation = h.column(2) / scale * size - rotation * centre;
    Some(Se3::new(rotation, translation))
}

/// The lens of a model that sees the given rays at the given pixels best, in least squares.
pub(crate) fn fit_lens(
    model: LensModel,
    like: &Camera,
    rays: &[(Vector3<f64>, Vector2<f64>)],
) -> Lens {
    let ([fx, fy], [cx, cy]) = (like.focal_px(), like.principal_px());
    let starts: &[[f64; 3]] = match model {
        LensModel::PinholeRadtan | LensModel::KannalaBrandt => &[[1.0, 0.0, 0.0], [0.7, 0.0, 0.0]],
        // Factor of the focal length, then the distortion.
        LensModel::DoubleSphere => &[[0.8, -0.2, 0.6], [1.0, 0.0, 0.4]],
        LensModel::ExtendedUnified => &[[1.0, 0.6, 1.0], [1.0, 0.2, 1.0]],
        LensModel::FieldOfView => &[[1.0, 0.9, 0.0], [1.0, 0.3, 0.0]],
    };
    let fits = starts.iter().map(|[factor, d0, d1]| {
        let mut start = [0.0; MAX_PARAMETERS];
        start[..6].copy_from_slice(&[fx * factor, fy * factor, cx, cy, *d0, *d1]);
        fit_from(model, like, rays, start)
    });
    let best = fits.min_by(|a, b| a.1.total_cmp(&b.1));
    // There is always a start.
    model.lens(&best.map_or([0.0; MAX_PARAMETERS], |(values, _)| values.into()))
}

/// From one start: the parameters, and the cost.
fn fit_from(
    model: LensModel,
    like: &Camera,
    rays: &[(Vector3<f64>, Vector2<f64>)],
    start: [f64; MAX_PARAMETERS],
) -> (Parameters, f64) {
    let camera = |values: &Parameters| Camera {
        lens: model.lens(values.as_ref()),
        ..*like
    };
    // What the lens does not see counts like an error of a tenth of the image.
    let unseen = (0.1 * f64::from(like.width)).powi(2);
    let cost = |values: &Parameters| {
        let camera = camera(values);
        if camera.lens.problem().is_some() {
            return f64::INFINITY;
        }
        rays.iter()
            .map(|(ray, pixel)| {
                camera
                    .project(ray)
                    .map_or(unseen, |p| (p - pixel).norm_squared().min(unseen))
            })
            .sum::<f64>()
    };
    let terms = |values: &Parameters| {
        let camera = camera(values);
        let mut terms = NormalEquations::default();
        for (ray, pixel) in rays {
            if let Some(p) = camera.project_full(ray) {
                terms.add_block(&(p.pixel - pixel), &p.pixel_by_parameter, 1.0);
            }
        }
        terms
    };
    minimise_damped(start.into(), FIT_TRIALS, terms, cost)
}
