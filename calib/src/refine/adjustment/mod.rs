//! The pose of a camera to the LiDAR from corners on surfaces (the paper's Eq. 4, with the calibration as an unknown).
//!
//! A corner `X` on a plane `(q, n)` that the LiDAR saw, in an image taken when the LiDAR was at `T`:
//!
//! `Σ ‖π((T exp(v τ + ξ) E)⁻¹ X) − x‖² / σ² + Σ (nᵀ(X − q))² / σ_p² + Σ ξᵀ Σ_ξ⁻¹ ξ`
//!
//! over the camera's pose `E` on the LiDAR, the camera's clock `τ`, each image's own error of the odometry `ξ`, and all corners. `v` is the LiDAR's velocity at
//! that time. Spreads `σ`, `σ_p` and the two of `Σ_ξ` are measured along with it. Blocks of images share `E` and `τ` alone: each
//! is reduced to an information matrix over these seven numbers, and how well blocks agree says what they are worth.

use lsfb_geometry::{Camera, Se3, Vector2, Vector3, Vector6, so3};
use lsfb_perception::gauss_newton::{Next, NormalEquations, minimise};
use nalgebra::{DMatrix, DVector, Matrix2x3, SMatrix, SVector};
use rayon::prelude::*;

use super::landmarks::{Keyframe, Landmark, Observation};
use super::noise::{Left, Noise, START, robust};

/// The six numbers of the pose, in the camera's axes, and the clock.
pub(super) const SHARED: usize = 7;
pub(super) type SharedMatrix = SMatrix<f64, SHARED, SHARED>;
pub(super) type SharedVector = SVector<f64, SHARED>;

/// How far a pose by hand may be wrong (rad, m), and how far clocks may be that were calibrated (s): standard deviations.
pub(super) const BY_HAND: [f64; 2] = [0.026, 0.03];
pub(super) const CLOCK_S: f64 = 1e-3;

const ITERATIONS: usize = 25;
/// Steps of a corner after each of the pose's.
const CORNER_STEPS: u32 = 3;
/// A step shorter than this ends the search: radians, metres.
const SHORTEST: [f64; 2] = [2e-6, 1e-5];
/// Information of a corner that nothing determines, 1/m².
const LITTLE: f64 = 1e-3;
/// Nearest that a corner may be to the camera, metres.
const NEAREST_M: f64 = 0.1;

/// Images that share their corners with no others.
pub(super) struct Block {
    pub frames: Vec<Keyframe>,
    pub landmarks: Vec<Landmark>,
    /// What the odometry errs by in each image, perturbed on the right.
    pub shifts: Vec<Vector6<f64>>,
}

/// What all images share.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shared {
    /// The camera's pose on the LiDAR.
    pub lidar_from_camera: Se3,
    /// What is to be added to the camera's times.
    pub delay_s: f64,
}

/// Normal equations over what is shared.
pub(super) type Normal = NormalEquations<SHARED>;

/// What was found.
pub(super) struct Adjusted {
    pub shared: Shared,
    pub noise: Noise,
    /// By block, at what was found.
    pub normals: Vec<Normal>,
}

/// A block's equations, with what leads back to its images.
struct Linear {
    normal: Normal,
    step: DVector<f64>,
    by_shared: DMatrix<f64>,
    left: Left,
}

/// Starts from a pose that is known as well as by hand. Numbers in `held` stay as they are there.
pub(super) fn adjusted(
    camera: &Camera,
    blocks: &mut [Block],
    start: &Se3,
    first: &Shared,
    held: &[usize],
) -> Option<Adjusted> {
    let mut shared = *first;
    let mut noise = START;
    for round in 0..=ITERATIONS {
        let linears: Vec<Linear> = blocks
            .par_iter_mut()
            .map(|b| {
                b.settle(camera, &shared, &noise);
                b.linear(camera, &shared, &noise)
            })
            .collect::<Option<_>>()?;
        let normals: Vec<Normal> = linears.iter().map(|l| l.normal).collect();
        let step = total(&normals, start, &shared, held).step()?;
        let still = step.fixed_rows::<3>(0).norm() < SHORTEST[0]
            && step.fixed_rows::<3>(3).norm() < SHORTEST[1];
        if round == ITERATIONS || (still && round > 6) {
            return Some(Adjusted {
                shared,
                noise,
                normals,
            });
        }
        shared = shared.moved(&step);
        for (block, linear) in blocks.iter_mut().zip(&linears) {
            let own = &linear.step - &linear.by_shared * step;
            for (k, shift) in block.shifts.iter_mut().enumerate() {
                *shift += own.fixed_rows::<6>(6 * k);
            }
        }
        let left = linears.iter().map(|l| &l.left);
        noise = noise.measured(blocks.iter().map(|b| &b.shifts[..]).zip(left));
    }
    None
}

/// All blocks together with what was known before.
pub(super) fn total(normals: &[Normal], start: &Se3, shared: &Shared, held: &[usize]) -> Normal {
    const FAST: f64 = 1e14;
    let off = start.local(&shared.lidar_from_camera);
    let deviation = SharedVector::from_fn(|k, _| if k < 6 { off[k] } else { shared.delay_s });
    let known = SharedVector::from_fn(|k, _| {
        let sigma = if k < 6 { BY_HAND[k / 3] } else { CLOCK_S };
        if held.contains(&k) {
            FAST
        } else {
            1.0 / (sigma * sigma)
        }
    });
    let mut all = Normal::default();
    all.add_prior(&deviation, &SharedMatrix::from_diagonal(&known));
    for normal in normals {
        all.add_all(normal);
    }
    all
}

impl Shared {
    pub fn moved(&self, step: &SharedVector) -> Self {
        Self {
            lidar_from_camera: self
                .lidar_from_camera
                .retract(&step.fixed_rows::<6>(0).into()),
            delay_s: self.delay_s + step[6],
        }
    }
}

/// A corner in an image, by everything that it depends on.
struct Seen {
    error: Vector2<f64>,
    by_point: Matrix2x3<f64>,
    /// By what is shared, then by the image's own error.
    by_rest: SMatrix<f64, 2, 13>,
}

impl Block {
    /// Images without corners.
    pub fn new(frames: Vec<Keyframe>) -> Self {
        Self {
            shifts: vec![Vector6::zeros(); frames.len()],
            frames,
            landmarks: Vec::new(),
        }
    }

    /// Other corners; what was found of the images is forgotten.
    pub fn take(&mut self, landmarks: Vec<Landmark>) {
        self.shifts.fill(Vector6::zeros());
        self.landmarks = landmarks;
    }

    fn lidar_from_world(&self, frame: usize, shared: &Shared) -> Se3 {
        let own = &self.frames[frame];
        let off = own.twist * shared.delay_s + self.shifts[frame];
        own.world_from_lidar.retract(&off).inverse()
    }

    fn seen(
        &self,
        camera: &Camera,
        shared: &Shared,
        lidar_from_world: &Se3,
        at: &Observation,
        place: &Vector3<f64>,
    ) -> Option<Seen> {
        let in_lidar = *lidar_from_world * *place;
        let camera_from_lidar = shared.lidar_from_camera.inverse();
        let in_camera = camera_from_lidar * in_lidar;
        if in_camera.z < NEAREST_M {
            return None;
        }
        let projected = camera.project_with_jacobian(&in_camera)?;
        let by_camera = projected.pixel_by_point;
        let turned = by_camera * camera_from_lidar.rotation_matrix();
        let mut by_shift = SMatrix::<f64, 2, 6>::zeros();
        by_shift
            .fixed_view_mut::<2, 3>(0, 0)
            .copy_from(&(turned * so3::hat(&in_lidar)));
        by_shift.fixed_view_mut::<2, 3>(0, 3).copy_from(&-turned);
        let mut by_rest = SMatrix::<f64, 2, 13>::zeros();
        by_rest
            .fixed_view_mut::<2, 3>(0, 0)
            .copy_from(&(by_camera * so3::hat(&in_camera)));
        by_rest.fixed_view_mut::<2, 3>(0, 3).copy_from(&-by_camera);
        by_rest
            .fixed_view_mut::<2, 1>(0, 6)
            .copy_from(&(by_shift * self.frames[at.frame].twist));
        by_rest.fixed_view_mut::<2, 6>(0, 7).copy_from(&by_shift);
        Some(Seen {
            error: projected.pixel - at.pixel,
            by_point: turned * lidar_from_world.rotation_matrix(),
            by_rest,
        })
    }

    fn poses(&self, shared: &Shared) -> Vec<Se3> {
        (0..self.frames.len())
            .map(|k| self.lidar_from_world(k, shared))
            .collect()
    }

    /// Where corners are seen, and by how much they miss, pixels.
    pub fn errors(&self, camera: &Camera, shared: &Shared) -> Vec<[Vector2<f64>; 2]> {
        let poses = self.poses(shared);
        let all = self.landmarks.iter().flat_map(|landmark| {
            landmark.observations.iter().filter_map(|at| {
                let pose = &poses[at.frame];
                let seen = self.seen(camera, shared, pose, at, &landmark.place)?;
                Some([at.pixel, seen.error])
            })
        });
        all.collect()
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

    /// Corners where they fit best.
    fn settle(&mut self, camera: &Camera, shared: &Shared, noise: &Noise) {
        let poses = self.poses(shared);
        let mut landmarks = std::mem::take(&mut self.landmarks);
        for landmark in &mut landmarks {
            let terms = |place: &Vector3<f64>| {
                let mut terms = landmark.by_plane(place, noise);
                for at in &landmark.observations {
                    let pose = &poses[at.frame];
                    if let Some(seen) = self.seen(camera, shared, pose, at, place) {
                        terms.add_block(&seen.error, &seen.by_point, noise.weight(&seen.error));
                    }
                }
                Some(terms)
            };
            let found = minimise(landmark.place, CORNER_STEPS, terms, |_| Next::Iterate);
            landmark.place = found.map_or(landmark.place, |f| f.value);
        }
        self.landmarks = landmarks;
    }

    fn linear(&self, camera: &Camera, shared: &Shared, noise: &Noise) -> Option<Linear> {
        let n = SHARED + 6 * self.frames.len();
        let poses = self.poses(shared);
        let mut information = DMatrix::<f64>::zeros(n, n);
        let mut gradient = DVector::<f64>::zeros(n);
        let (mut pixel_errors, mut plane_errors) = (Vec::new(), Vec::new());
        let column = |k: usize, frame: usize| if k < SHARED { k } else { k + 6 * frame };
        for landmark in &self.landmarks {
            let mut by_place = landmark.by_plane(&landmark.place, noise);
            let mut seen: Vec<(usize, f64, Seen)> = Vec::new();
            for at in &landmark.observations {
                let pose = &poses[at.frame];
                if let Some(s) = self.seen(camera, shared, pose, at, &landmark.place) {
                    let weight = noise.weight(&s.error);
                    by_place.add_block(&s.error, &s.by_point, weight);
                    seen.push((at.frame, weight, s));
                }
            }
            let Some(inverse) = by_place.information.try_inverse() else {
                continue;
            };
            // Columns of the mixed part: by what is shared, then by each image.
            let mut mixed: Vec<(usize, Vector3<f64>)> =
                (0..SHARED).map(|k| (k, Vector3::zeros())).collect();
            for (frame, weight, s) in &seen {
                let own = s.by_rest.transpose() * s.by_rest * *weight;
                let pull = s.by_rest.transpose() * s.error * *weight;
                for i in 0..13 {
                    gradient[column(i, *frame)] += pull[i];
                    for k in 0..13 {
                        information[(column(i, *frame), column(k, *frame))] += own[(i, k)];
                    }
                }
                let by_rest = s.by_point.transpose() * s.by_rest * *weight;
                for k in 0..13 {
                    if k < SHARED {
                        mixed[k].1 += by_rest.column(k);
                    } else {
                        mixed.push((column(k, *frame), by_rest.column(k).into()));
                    }
                }
                let fitted = s.by_point * inverse * s.by_point.transpose();
                for k in 0..2 {
                    let free = 1.0 - fitted[(k, k)] / (noise.pixel_px * noise.pixel_px);
                    pixel_errors.push(s.error[k] / free.max(0.05).sqrt());
                }
            }
            for (i, a) in &mixed {
                let taken = inverse * a;
                gradient[*i] -= taken.dot(&by_place.gradient);
                for (k, b) in &mixed {
                    information[(*i, *k)] -= taken.dot(b);
                }
            }
            let fitted = (landmark.plane_normal.transpose() * inverse * landmark.plane_normal)[0];
            let free = 1.0 - fitted / (noise.plane_m * noise.plane_m);
            plane_errors.push(landmark.off_plane_m(&landmark.place) / free.max(0.05).sqrt());
        }
        for (k, shift) in self.shifts.iter().enumerate() {
            let prior = noise.odometry(&self.frames[k].information)?;
            let at = SHARED + 6 * k;
            let mut own = information.fixed_view_mut::<6, 6>(at, at);
            own += prior;
            let mut pull = gradient.fixed_rows_mut::<6>(at);
            pull += prior * shift;
        }
        let m = n - SHARED;
        let own = information.view((SHARED, SHARED), (m, m)).into_owned();
        let factor = own.cholesky()?;
        let by_shared = factor.solve(&information.view((SHARED, 0), (m, SHARED)));
        let step = -factor.solve(&gradient.rows(SHARED, m));
        let across = information.view((0, SHARED), (SHARED, m));
        let reduced = information.view((0, 0), (SHARED, SHARED)) - across * &by_shared;
        let reduced_gradient = gradient.rows(0, SHARED) + across * &step;
        Some(Linear {
            normal: Normal {
                information: SharedMatrix::from_fn(|i, k| {
                    0.5 * (reduced[(i, k)] + reduced[(k, i)])
                }),
                gradient: SharedVector::from_fn(|k, _| reduced_gradient[k]),
            },
            step,
            by_shared,
            left: Left {
                pixel_errors,
                plane_errors,
                variances: factor.inverse().diagonal(),
            },
        })
    }
}

impl Landmark {
    fn off_plane_m(&self, place: &Vector3<f64>) -> f64 {
        self.plane_normal.dot(&(place - self.plane_place))
    }

    /// What the plane says of where it is.
    fn by_plane(&self, place: &Vector3<f64>, noise: &Noise) -> NormalEquations<3> {
        let off_m = self.off_plane_m(place);
        let variance = noise.plane_m * noise.plane_m;
        let mut terms = NormalEquations::<3>::default();
        // A little everywhere, so that there is always an answer.
        terms.information.fill_diagonal(LITTLE);
        let weight = robust(off_m * off_m / variance) / variance;
        terms.add(off_m, &self.plane_normal, weight);
        terms
    }
}

#[cfg(test)]
mod tests;
