//! How well the points of a map are known: from the pixels that saw them, with the poses of the keyframes taken as they are.

use arrow_buffer::ScalarBuffer;
use lsfb_geometry::{Matrix3, Vector3};
use lsfb_perception::statistics::median;
use rayon::prelude::*;

use super::{HdMap, QualityColumns};
use crate::worst_sigma::worst_sigma;

/// Median of the distance of a two-dimensional normal distribution, in its σ per axis (a Rayleigh distribution's √(2 ln 2)).
const MEDIAN_PER_SIGMA: f64 = 1.177_410_022_515_474_7;

/// How well a map point is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointQuality {
    /// Covariance of its position in the world, m²: σ² (Σ Jᵀ J)⁻¹ over its observations, J the pixel's derivative by the
    /// position and σ the error per axis of the whole map's observations. Errors of the keyframes' poses are not in it:
    /// neighbouring points share those. Infinite where the observations do not determine the position.
    pub covariance_m2: Matrix3<f64>,
    /// Root mean square of its own reprojection errors, pixels.
    pub reprojection_rms_px: f64,
    /// Mean direction towards the cameras that saw it, length 1; zero where it was seen from all around.
    pub mean_view: Vector3<f64>,
    /// Cosine of the largest angle between `mean_view` and the direction to a camera that saw it: the cone it was seen in.
    pub view_cos: f64,
}

impl PointQuality {
    /// Standard deviation in the direction in which the point is known worst, metres.
    pub fn worst_sigma_m(&self) -> f64 {
        worst_sigma(&self.covariance_m2)
    }
}

impl QualityColumns {
    /// In the order of the file.
    pub(super) fn columns(&self) -> [&ScalarBuffer<f32>; 11] {
        let ([xx, xy, xz, yy, yz, zz], [x, y, z]) = (&self.covariance_m2, &self.view);
        [
            xx,
            xy,
            xz,
            yy,
            yz,
            zz,
            &self.rms_px,
            x,
            y,
            z,
            &self.view_cos,
        ]
    }

    /// [`QualityColumns::columns`] back again; `None` if there are not eleven.
    pub(super) fn from_columns(columns: Vec<ScalarBuffer<f32>>) -> Option<Self> {
        let [xx, xy, xz, yy, yz, zz, rms_px, x, y, z, view_cos]: [_; 11] =
            columns.try_into().ok()?;
        Some(Self {
            covariance_m2: [xx, xy, xz, yy, yz, zz],
            rms_px,
            view: [x, y, z],
            view_cos,
        })
    }
}

/// What the observations of one point say.
struct Evidence {
    /// Σ Jᵀ J, px²/m².
    information: Matrix3<f64>,
    /// Reprojection errors, pixels.
    errors_px: Vec<f64>,
    /// Directions to the cameras, length 1.
    views: Vec<Vector3<f64>>,
}

impl HdMap {
    /// The map with its points' quality measured anew.
    pub(super) fn with_quality(mut self) -> Self {
        let points: Vec<u32> = (0..self.point_count() as u32).collect();
        let evidence: Vec<Evidence> = points.par_iter().map(|p| self.evidence(*p)).collect();
        let errors = evidence.iter().flat_map(|e| e.errors_px.iter().copied());
        let sigma_px = median(errors.collect()).unwrap_or(0.0) / MEDIAN_PER_SIGMA;
        let quality: Vec<PointQuality> = evidence.par_iter().map(|e| e.quality(sigma_px)).collect();
        let column = |value: &dyn Fn(&PointQuality) -> f64| {
            let values = quality.iter().map(|q| value(q) as f32);
            values.collect::<Vec<f32>>().into()
        };
        const UPPER: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
        self.quality = QualityColumns {
            covariance_m2: UPPER.map(|at| column(&|q| q.covariance_m2[at])),
            rms_px: column(&|q| q.reprojection_rms_px),
            view: [0, 1, 2].map(|axis| column(&|q| q.mean_view[axis])),
            view_cos: column(&|q| q.view_cos),
        };
        self
    }

    fn evidence(&self, point: u32) -> Evidence {
        let mut found = Evidence {
            information: Matrix3::zeros(),
            errors_px: Vec::new(),
            views: Vec::new(),
        };
        let Some(position) = self.position(point) else {
            return found;
        };
        for o in self.observations(point) {
            let name = self.cameras.get(usize::from(o.camera));
            let mounted = name.and_then(|name| self.rig.cameras.get(name));
            let (Some(mounted), Some(keyframe)) = (mounted, self.keyframe(o.keyframe)) else {
                continue;
            };
            let world_from_camera = keyframe.world_from_rig * mounted.rig_from_camera;
            let to_camera = world_from_camera.translation - position;
            found.views.extend(to_camera.try_normalize(0.0));
            let camera_from_world = world_from_camera.inverse();
            let in_camera = camera_from_world * position;
            if let Some(seen) = mounted.camera.project_with_jacobian(&in_camera) {
                let by_position = seen.pixel_by_point * camera_from_world.rotation_matrix();
                found.information += by_position.tr_mul(&by_position);
                let [u, v] = o.pixel.map(f64::from);
                found
                    .errors_px
                    .push((seen.pixel.x - u).hypot(seen.pixel.y - v));
            }
        }
        found
    }
}

impl Evidence {
    fn quality(&self, sigma_px: f64) -> PointQuality {
        let inverse = self.information.try_inverse();
        let determined = inverse.filter(|c| c.iter().all(|v| v.is_finite()));
        let squares: f64 = self.errors_px.iter().map(|e| e * e).sum();
        let sum: Vector3<f64> = self.views.iter().sum();
        let mean_view = sum.try_normalize(1e-9).unwrap_or_else(Vector3::zeros);
        let cosines = self.views.iter().map(|v| v.dot(&mean_view));
        PointQuality {
            covariance_m2: match determined {
                Some(c) => c * sigma_px.powi(2),
                None => Matrix3::from_diagonal_element(f64::INFINITY),
            },
            reprojection_rms_px: (squares / self.errors_px.len().max(1) as f64).sqrt(),
            mean_view,
            view_cos: cosines.fold(1.0, f64::min),
        }
    }
}
