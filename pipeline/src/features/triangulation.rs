//! A point from its viewing rays.

use lsfb_geometry::{Camera, Matrix3, Se3, Vector2, Vector3};
use lsfb_solver::gauss_newton::{NormalEquations, minimise_damped};
use lsfb_types::Bounds;
use serde::{Deserialize, Serialize};

/// Steps tried at most to refine a point.
const MAX_TRIALS: u32 = 12;

/// A pixel in a camera whose pose is known.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// Its pose.
    pub world_from_camera: Se3,
    /// Where the point is seen.
    pub pixel: Vector2<f64>,
}

/// Configuration of [`triangulate`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TriangulationConfig {
    /// Least angle between two of the rays, degrees.
    pub min_parallax_deg: f64,
    /// Largest reprojection error of a view that is kept, pixels.
    pub max_reprojection_px: f64,
    /// Least number of views that agree.
    pub min_views: usize,
    /// Least distance from every camera, metres.
    pub min_depth_m: f64,
}

impl Default for TriangulationConfig {
    fn default() -> Self {
        Self {
            min_parallax_deg: 1.5,
            max_reprojection_px: 3.0,
            min_views: 2,
            min_depth_m: 0.1,
        }
    }
}

lsfb_types::bounds! {
    TriangulationConfig {
        min_parallax_deg: number(Bounds::NOT_NEGATIVE),
        max_reprojection_px: number(Bounds::POSITIVE),
        min_views: any,
        min_depth_m: number(Bounds::NOT_NEGATIVE),
    }
}

/// A triangulated point.
#[derive(Clone, Debug, PartialEq)]
pub struct TriangulatedPoint {
    /// The point, metres.
    pub point_in_world: Vector3<f64>,
    /// Indices of the views that agree with it, ascending.
    pub inliers: Vec<usize>,
    /// Root mean square of the reprojection errors of the inliers, pixels.
    pub reprojection_rms_px: f64,
    /// Largest angle between two of the inliers' rays, radians.
    pub parallax_rad: f64,
}

/// Why views give no point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TriangulationFailure {
    /// Fewer views agree than asked for.
    #[error("too few views agree")]
    TooFewViews,
    /// The rays are too parallel.
    #[error("too little parallax")]
    TooLittleParallax,
    /// The point is behind a camera or too near.
    #[error("behind or too close to a camera")]
    NotInFront,
}

/// A view with its ray in the world.
struct Ray {
    index: usize,
    origin: Vector3<f64>,
    direction: Vector3<f64>,
}

/// The point that is seen in these views: midpoint of the rays, then least squares of the reprojection errors. While a
/// view disagrees, the worst one is left out and the rest begins anew.
pub fn triangulate(
    views: &[View],
    config: &TriangulationConfig,
) -> Result<TriangulatedPoint, TriangulationFailure> {
    let mut rays: Vec<Ray> = views
        .iter()
        .enumerate()
        .filter_map(|(index, view)| {
            let ray = view.camera.unproject(&view.pixel)?;
            Some(Ray {
                index,
                origin: view.world_from_camera.translation,
                direction: view.world_from_camera.rotation * ray,
            })
        })
        .collect();
    loop {
        if rays.len() < config.min_views.max(2) {
            return Err(TriangulationFailure::TooFewViews);
        }
        let directions: Vec<Vector3<f64>> = rays.iter().map(|ray| ray.direction).collect();
        let parallax_rad = largest_angle(&directions);
        if parallax_rad < config.min_parallax_deg.to_radians() {
            return Err(TriangulationFailure::TooLittleParallax);
        }
        let start = midpoint(&rays).ok_or(TriangulationFailure::TooLittleParallax)?;
        let point = refine(views, &rays, start);
        let errors: Vec<f64> = rays
            .iter()
            .map(|ray| reprojection_px(&views[ray.index], &point, config.min_depth_m))
            .collect();
        let worst = (0..errors.len())
            .max_by(|&a, &b| errors[a].total_cmp(&errors[b]))
            .ok_or(TriangulationFailure::TooFewViews)?;
        if errors[worst] <= config.max_reprojection_px {
            if has_no_place(&point, rays.iter().map(|ray| ray.origin), config) {
                return Err(TriangulationFailure::TooLittleParallax);
            }
            let squares: f64 = errors.iter().map(|e| e * e).sum();
            return Ok(TriangulatedPoint {
                point_in_world: point,
                inliers: rays.iter().map(|r| r.index).collect(),
                reprojection_rms_px: (squares / errors.len() as f64).sqrt(),
                parallax_rad,
            });
        }
        if errors[worst].is_infinite() && rays.len() == 2 {
            return Err(TriangulationFailure::NotInFront);
        }
        rays.remove(worst);
    }
}

/// Pixels turn rays towards each other by so much that a point comes to lie where its cameras see it under no angle: below this share of
/// the least one it has a direction and no place.
const LEAST_PARALLAX_SHARE: f64 = 0.5;

/// Whether a point is so far from the cameras at `centres` that where it is rests on less than half of the parallax asked for.
pub(crate) fn has_no_place(
    point_in_world: &Vector3<f64>,
    centres: impl IntoIterator<Item = Vector3<f64>>,
    config: &TriangulationConfig,
) -> bool {
    let towards = centres.into_iter().map(|centre| centre - point_in_world);
    let towards: Vec<Vector3<f64>> = towards.filter_map(|v| v.try_normalize(0.0)).collect();
    largest_angle(&towards) < LEAST_PARALLAX_SHARE * config.min_parallax_deg.to_radians()
}

/// Largest angle between two of these directions, radians.
fn largest_angle(directions: &[Vector3<f64>]) -> f64 {
    let mut smallest_cosine = 1.0f64;
    for (i, a) in directions.iter().enumerate() {
        for b in &directions[..i] {
            smallest_cosine = smallest_cosine.min(a.dot(b));
        }
    }
    smallest_cosine.clamp(-1.0, 1.0).acos()
}

/// The point with the least summed squared distance to the rays.
fn midpoint(rays: &[Ray]) -> Option<Vector3<f64>> {
    let mut normal = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for ray in rays {
        let across = Matrix3::identity() - ray.direction * ray.direction.transpose();
        normal += across;
        right += across * ray.origin;
    }
    Some(normal.cholesky()?.solve(&right))
}

/// The point with the least reprojection errors.
fn refine(views: &[View], rays: &[Ray], start: Vector3<f64>) -> Vector3<f64> {
    let cost = |point: &Vector3<f64>| -> f64 {
        rays.iter()
            .map(|ray| reprojection_px(&views[ray.index], point, 0.0).powi(2))
            .sum()
    };
    let terms = |point: &Vector3<f64>| {
        let mut terms = NormalEquations::default();
        for ray in rays {
            let view = &views[ray.index];
            let camera_from_world = view.world_from_camera.inverse();
            let in_camera = camera_from_world * *point;
            if let Some(seen) = view.camera.project_with_jacobian(&in_camera) {
                let by_point = seen.pixel_by_point * camera_from_world.rotation_matrix();
                terms.add_block(&(seen.pixel - view.pixel), &by_point, 1.0);
            }
        }
        terms
    };
    minimise_damped(start, MAX_TRIALS, terms, cost).0
}

/// Distance between where the point should be and is seen, pixels; infinite behind or nearer than `min_depth_m`.
fn reprojection_px(view: &View, point_in_world: &Vector3<f64>, min_depth_m: f64) -> f64 {
    let point = view.world_from_camera.inverse() * *point_in_world;
    if point.norm() < min_depth_m {
        return f64::INFINITY;
    }
    match view.camera.project(&point) {
        Some(pixel) => (pixel - view.pixel).norm(),
        None => f64::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_geometry::camera::Lens;
    use proptest::prelude::*;

    fn fisheye() -> Camera {
        Camera {
            width: 640,
            height: 400,
            lens: Lens::KannalaBrandt {
                focal_px: [350.0; 2],
                principal_px: [319.5, 199.5],
                distortion: [0.02, -0.01, 0.003, -0.001],
            },
        }
    }

    fn views<'a>(camera: &'a Camera, poses: &[Se3], point: &Vector3<f64>) -> Vec<View<'a>> {
        poses
            .iter()
            .map(|pose| View {
                camera,
                world_from_camera: *pose,
                pixel: camera
                    .project(&(pose.inverse() * *point))
                    .expect("in front"),
            })
            .collect()
    }

    fn poses(count: usize) -> Vec<Se3> {
        (0..count)
            .map(|i| {
                let i = i as f64;
                Se3::exp(&[0.01 * i, -0.06 * i, 0.02, 0.2 * i, 0.03 * i, 0.0].into())
            })
            .collect()
    }

    proptest! {
        #[test]
        fn recovers_the_point(x in -2.0..2.0f64, y in -1.0..1.0f64, z in 1.0..6.0f64) {
            let (camera, point) = (fisheye(), Vector3::new(x, y, z));
            let views = views(&camera, &poses(4), &point);
            let found = triangulate(&views, &TriangulationConfig { min_parallax_deg: 0.5, ..Default::default() })
                .expect("consistent views");
            prop_assert!((found.point_in_world - point).norm() < 1e-7);
            prop_assert_eq!(found.inliers, vec![0, 1, 2, 3]);
        }
    }

    #[test]
    fn a_wrong_view_is_left_out() {
        let (camera, point) = (fisheye(), Vector3::new(0.3, -0.2, 3.0));
        let mut views = views(&camera, &poses(5), &point);
        views[2].pixel.y += 40.0;
        let found = triangulate(&views, &TriangulationConfig::default()).expect("four agree");
        assert_eq!(found.inliers, [0, 1, 3, 4]);
        assert!((found.point_in_world - point).norm() < 1e-7);
    }

    #[test]
    fn refuses_parallel_rays_and_points_behind() {
        let camera = fisheye();
        let far = views(
            &camera,
            &poses(2)[..1].repeat(2),
            &Vector3::new(0.0, 0.0, 4.0),
        );
        let config = TriangulationConfig::default();
        assert_eq!(
            triangulate(&far, &config),
            Err(TriangulationFailure::TooLittleParallax)
        );
        // Rays that pass each other have an angle, and what they see together may be anywhere far away.
        let side_by_side = [0.0, 0.1].map(|x| Se3::new(Default::default(), Vector3::x() * x));
        let mut passing = views(&camera, &side_by_side, &Vector3::new(0.0, 0.0, 200.0));
        passing[1].pixel.y += 4.0;
        let low = TriangulationConfig {
            min_parallax_deg: 0.5,
            ..Default::default()
        };
        assert_eq!(
            triangulate(&passing, &low),
            Err(TriangulationFailure::TooLittleParallax)
        );
        // Rays that diverge meet behind the cameras.
        let mut behind = views(&camera, &poses(2), &Vector3::new(0.1, 0.0, 2.0));
        let (a, b) = (behind[0].pixel, behind[1].pixel);
        (behind[0].pixel, behind[1].pixel) =
            (b - Vector2::new(40.0, 0.0), a + Vector2::new(40.0, 0.0));
        assert!(triangulate(&behind, &config).is_err());
    }
}
