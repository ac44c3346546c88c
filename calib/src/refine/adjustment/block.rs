//! Images that share their corners, as part of a problem and for themselves.

use lsfb_geometry::{Camera, Matrix2x3, Se3, Vector2, Vector3};
use lsfb_solver::gauss_newton::NormalEquations;
use lsfb_solver::{self as solver, BlockId, Kernel, PosePrior, Problem, covariance, marginal};

use super::{Normal, Shared, SharedMatrix, SharedVector, Unknown, by_hand};
use crate::refine::landmarks::{Keyframe, Landmark};
use crate::refine::noise::{Left, Noise, ROBUST_SCALE, robust};
use crate::refine::residuals::{CornerResidual, OnPlane, ProjectedCorner};

/// Images in which a corner must be in view.
const MIN_IN_VIEW: usize = 2;

/// Least share of an error that is taken to be left by the fit.
const LEAST_FREE: f64 = 0.05;

const CAUCHY: Kernel = Kernel::Cauchy {
    scale: ROBUST_SCALE,
};

/// Images that share their corners with no others.
pub(in crate::refine) struct Block {
    pub frames: Vec<Keyframe>,
    pub landmarks: Vec<Landmark>,
    /// Where the LiDAR was at each image's stamp, as adjusted.
    world_from_lidar: Vec<Se3>,
}

/// A block of images in a problem.
pub(super) struct Part {
    world_from_lidar: Vec<solver::Block<Se3>>,
    /// With the number of the landmark.
    corners: Vec<(usize, solver::Block<Vector3<f64>>)>,
}

impl Block {
    /// Images without corners.
    pub fn new(frames: Vec<Keyframe>) -> Self {
        Self {
            world_from_lidar: frames.iter().map(|f| f.world_from_lidar).collect(),
            frames,
            landmarks: Vec::new(),
        }
    }

    /// Other corners; what was found of the images is forgotten.
    pub fn take(&mut self, landmarks: Vec<Landmark>) {
        self.world_from_lidar = self.frames.iter().map(|f| f.world_from_lidar).collect();
        self.landmarks = landmarks;
    }

    /// Adds its images and corners to a problem.
    pub(super) fn put_into(
        &self,
        problem: &mut Problem,
        camera: &Camera,
        unknown: &Unknown,
        noise: &Noise,
    ) -> Option<Part> {
        let mut poses = Vec::new();
        for (frame, pose) in self.frames.iter().zip(&self.world_from_lidar) {
            let block = problem.add_block(*pose);
            let odometry = PosePrior {
                value: frame.world_from_lidar,
                sqrt_information: noise
                    .odometry(&frame.information)?
                    .cholesky()?
                    .l()
                    .transpose(),
            };
            let added = problem.add_residual(odometry, &[block.id()], Kernel::Squared);
            added.ok()?;
            poses.push(block);
        }
        let shared = unknown.values(problem);
        let at_images = self.at_images(&shared);
        let mut corners = Vec::new();
        for (k, landmark) in self.landmarks.iter().enumerate() {
            let in_view = self.seen(landmark, camera, &shared, &at_images).count();
            if in_view < MIN_IN_VIEW {
                continue;
            }
            let corner = problem.add_eliminated_point(landmark.place);
            let plane = OnPlane {
                place: landmark.plane_place,
                normal: landmark.plane_normal,
                sigma_m: noise.plane_m,
            };
            problem.add_residual(plane, &[corner.id()], CAUCHY).ok()?;
            for at in &landmark.observations {
                let residual = CornerResidual {
                    camera: *camera,
                    twist: self.frames[at.frame].twist,
                    pixel: at.pixel,
                    sigma_px: noise.pixel_px,
                };
                let blocks = [
                    unknown.lidar_from_camera.id(),
                    unknown.delay_s.id(),
                    poses[at.frame].id(),
                    corner.id(),
                ];
                problem.add_residual(residual, &blocks, CAUCHY).ok()?;
            }
            corners.push((k, corner));
        }
        Some(Part {
            world_from_lidar: poses,
            corners,
        })
    }

    pub(super) fn read_back(&mut self, problem: &Problem, part: &Part) {
        let poses = part.world_from_lidar.iter();
        self.world_from_lidar = poses.map(|b| problem.value(*b)).collect();
        for (k, corner) in &part.corners {
            self.landmarks[*k].place = problem.value(*corner);
        }
    }

    /// Where the LiDAR was when each image was taken.
    fn at_images(&self, shared: &Shared) -> Vec<Se3> {
        let poses = self.world_from_lidar.iter().zip(&self.frames);
        poses
            .map(|(pose, frame)| pose.retract(&(frame.twist * shared.delay_s)))
            .collect()
    }

    /// A corner where it is in view, and where it was found.
    fn seen(
        &self,
        landmark: &Landmark,
        camera: &Camera,
        shared: &Shared,
        at_images: &[Se3],
    ) -> impl Iterator<Item = (ProjectedCorner, Vector2<f64>)> {
        landmark.observations.iter().filter_map(|at| {
            let pose = &at_images[at.frame];
            let seen =
                ProjectedCorner::new(camera, &shared.lidar_from_camera, pose, &landmark.place)?;
            Some((seen, at.pixel))
        })
    }

    /// Where corners are seen, and by how much they miss, pixels.
    pub fn errors(&self, camera: &Camera, shared: &Shared) -> Vec<[Vector2<f64>; 2]> {
        let at_images = self.at_images(shared);
        let landmarks = self.landmarks.iter();
        let all = landmarks.flat_map(|l| self.seen(l, camera, shared, &at_images));
        all.map(|(seen, pixel)| [pixel, seen.pixel - pixel])
            .collect()
    }

    /// By how much corners, put from the first image onto their planes, are elsewhere in the others, pixels.
    pub fn transfers_px(&self, camera: &Camera, camera_from_lidar: &Se3) -> Vec<f64> {
        let poses: Vec<Se3> = self
            .frames
            .iter()
            .map(|f| *camera_from_lidar * f.world_from_lidar.inverse())
            .collect();
        let mut out = Vec::new();
        for landmark in &self.landmarks {
            let Some((first, others)) = landmark.observations.split_first() else {
                continue;
            };
            let world_from_camera = poses[first.frame].inverse();
            let Some(ray) = camera.unproject(&first.pixel) else {
                continue;
            };
            let ray = world_from_camera.rotation * ray;
            let origin = world_from_camera.translation;
            let normal = &landmark.plane_normal;
            let along = normal.dot(&(landmark.plane_place - origin)) / normal.dot(&ray);
            out.extend(others.iter().filter_map(|at| {
                let point = poses[at.frame] * (origin + ray * along);
                Some((camera.project(&point)? - at.pixel).norm())
            }));
        }
        out
    }

    /// What an adjustment leaves, over the square root of the share that is not fitted away.
    pub(super) fn left(&self, camera: &Camera, shared: &Shared, noise: &Noise) -> Option<Left> {
        let at_images = self.at_images(shared);
        let (pixel_variance, plane_variance) = (
            noise.pixel_px * noise.pixel_px,
            noise.plane_m * noise.plane_m,
        );
        let (mut pixel_errors, mut plane_errors) = (Vec::new(), Vec::new());
        for landmark in &self.landmarks {
            let off_m = landmark.off_plane_m();
            let mut by_place = NormalEquations::<3>::default();
            let weight = robust(off_m * off_m / plane_variance) / plane_variance;
            by_place.add(off_m, &landmark.plane_normal, weight);
            let mut seen: Vec<(Vector2<f64>, Matrix2x3<f64>)> = Vec::new();
            for (at, pixel) in self.seen(landmark, camera, shared, &at_images) {
                let error = at.pixel - pixel;
                let weight = robust(error.norm_squared() / pixel_variance) / pixel_variance;
                by_place.add_block(&error, &at.by_corner, weight);
                seen.push((error, at.by_corner));
            }
            let inverse = by_place.information.try_inverse();
            let Some(inverse) = inverse.filter(|_| seen.len() >= MIN_IN_VIEW) else {
                continue;
            };
            for (error, by_corner) in seen {
                let fitted = by_corner * inverse * by_corner.transpose() / pixel_variance;
                let free = fitted.diagonal().map(|f| (1.0 - f).max(LEAST_FREE).sqrt());
                pixel_errors.extend(error.component_div(&free).iter());
            }
            let fitted = landmark
                .plane_normal
                .dot(&(inverse * landmark.plane_normal));
            let free = (1.0 - fitted / plane_variance).max(LEAST_FREE);
            plane_errors.push(off_m / free.sqrt());
        }
        let mut problem = Problem::new();
        let unknown = shared.put_into(&mut problem, shared)?;
        let part = self.put_into(&mut problem, camera, &unknown, noise)?;
        problem.set_constant(unknown.lidar_from_camera);
        problem.set_constant(unknown.delay_s);
        let images: Vec<BlockId> = part.world_from_lidar.iter().map(|b| b.id()).collect();
        let poses = self.frames.iter().zip(&self.world_from_lidar);
        Some(Left {
            pixel_errors,
            plane_errors,
            shifts: poses.map(|(f, p)| f.world_from_lidar.local(p)).collect(),
            variances: covariance(&problem, &images).ok()?.joint().diagonal(),
        })
    }

    /// What the block says of what is shared, its images and corners at their best.
    pub(super) fn normal(&self, camera: &Camera, shared: &Shared, noise: &Noise) -> Option<Normal> {
        let mut problem = Problem::new();
        // Around what was found, so that what is known beforehand pulls nowhere and can be taken off again.
        let unknown = shared.put_into(&mut problem, shared)?;
        self.put_into(&mut problem, camera, &unknown, noise)?;
        let ids = [unknown.lidar_from_camera.id(), unknown.delay_s.id()];
        let found = marginal(&problem, &ids).ok()?;
        let information = SharedMatrix::from_fn(|i, k| found.information[(i, k)]);
        Some(Normal {
            information: information - SharedMatrix::from_diagonal(&by_hand()),
            gradient: SharedVector::from_fn(|k, _| found.gradient[k]),
        })
    }
}

impl Landmark {
    fn off_plane_m(&self) -> f64 {
        self.plane_normal.dot(&(self.place - self.plane_place))
    }
}
