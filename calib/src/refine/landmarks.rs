//! Corners of images on surfaces that the LiDAR saw. The plane at a corner says how its patch looks in any other image, so that it is
//! found there from far apart, without following it in between.

use lsfb_geometry::{Matrix6, Se3, Vector2, Vector3, Vector6};
use lsfb_perception::image::{Gray, Patch, PatchSearch, corners};
use nalgebra::Matrix2;
use rayon::prelude::*;

use crate::overlapping_planes::OverlappingPlanes;

/// Share of the brightness's variance that may be left.
const MOST_LEFT: f64 = 0.25;
/// Gradients that a corner needs, grey levels squared: several times those of noise.
const FAINT: f64 = 400.0;
/// By how much a patch may be stretched or shrunk in another image.
const STRETCH: [f64; 2] = [0.5, 1.9];
/// Corners nearer than this to one already found elsewhere are the same, pixels.
const SAME_PX: f64 = 6.0;
/// Images of a block in which new corners are looked for are so many apart.
const ANCHORS_APART: usize = 3;
/// Images, beside its own, that a corner must be found in.
const MIN_OTHERS: usize = 2;

/// An image with where the LiDAR was.
pub(super) struct Keyframe {
    pub time_s: f64,
    /// Half as large, and as large as corners are found in.
    pub levels: [Gray; 2],
    pub world_from_lidar: Se3,
    /// How fast that changes, perturbed on the right, per second.
    pub twist: Vector6<f64>,
    /// What the scans know of it.
    pub information: Matrix6<f64>,
}

/// Where a corner is seen.
#[derive(Clone, Copy)]
pub(super) struct Observation {
    /// Number of the image in its block.
    pub frame: usize,
    pub pixel: Vector2<f64>,
}

/// A corner on a surface.
#[derive(Clone)]
pub(super) struct Landmark {
    /// In the image it was found in first.
    pub observations: Vec<Observation>,
    pub plane_place: Vector3<f64>,
    pub plane_normal: Vector3<f64>,
    /// In the world.
    pub place: Vector3<f64>,
}

/// How far from what was expected a corner is looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reach {
    /// In the images next to its own, from a rig that is only nearly right.
    Near(usize),
    /// In all images of the block.
    All,
}

impl Keyframe {
    /// How many corners there are.
    pub fn corners(&self) -> usize {
        corners(&self.levels[1], FAINT).len()
    }
}

/// Corners of a block of images.
pub(super) fn landmarks(
    frames: &[Keyframe],
    camera_from_lidar: &Se3,
    place: &OverlappingPlanes,
    reach: Reach,
) -> Vec<Landmark> {
    let camera_from_world: Vec<Se3> = frames
        .iter()
        .map(|f| *camera_from_lidar * f.world_from_lidar.inverse())
        .collect();
    let mut found: Vec<Landmark> = Vec::new();
    for anchor in (0..frames.len()).step_by(ANCHORS_APART) {
        let fine = &frames[anchor].levels[1];
        let taken: Vec<Vector2<f64>> = found
            .iter()
            .flat_map(|l| &l.observations)
            .filter(|o| o.frame == anchor)
            .map(|o| o.pixel)
            .collect();
        let new: Vec<Vector2<f64>> = corners(fine, FAINT)
            .into_iter()
            .filter(|c| taken.iter().all(|t| (t - c).norm() > SAME_PX))
            .collect();
        let seen: Vec<Option<Landmark>> = new
            .par_iter()
            .map(|corner| landmark(frames, &camera_from_world, place, reach, anchor, corner))
            .collect();
        found.extend(seen.into_iter().flatten());
    }
    found
}

fn landmark(
    frames: &[Keyframe],
    camera_from_world: &[Se3],
    place: &OverlappingPlanes,
    reach: Reach,
    anchor: usize,
    corner: &Vector2<f64>,
) -> Option<Landmark> {
    let camera = &frames[anchor].levels[1].camera;
    let world_from_camera = camera_from_world[anchor].inverse();
    let ray = world_from_camera.rotation * camera.unproject(corner)?;
    let (hit, plane) = place.first_hit(&world_from_camera.translation, &ray)?;
    let patch = PatchPyramid::new(&frames[anchor].levels, corner)?;
    // Where the point of the plane seen at a pixel of this image is seen in another one.
    let transferred = |pixel: &Vector2<f64>, other: usize| -> Option<Vector2<f64>> {
        let ray = world_from_camera.rotation * camera.unproject(pixel)?;
        let origin = world_from_camera.translation;
        let along = plane.normal.dot(&(hit - origin)) / plane.normal.dot(&ray);
        let point = camera_from_world[other] * (origin + ray * along);
        camera.project(&point).filter(|_| along > 0.0)
    };
    let mut observations = vec![Observation {
        frame: anchor,
        pixel: *corner,
    }];
    for (frame, other) in frames.iter().enumerate() {
        let near = match reach {
            Reach::Near(most) => frame.abs_diff(anchor) <= most,
            Reach::All => true,
        };
        if frame == anchor || !near {
            continue;
        }
        let found = || {
            let expected = transferred(corner, frame)?;
            if !camera.contains(&expected, Patch::HALF_PX) {
                return None;
            }
            let step = |x: f64, y: f64| transferred(&(corner + Vector2::new(x, y)), frame);
            let by_x = (step(1.0, 0.0)? - step(-1.0, 0.0)?) * 0.5;
            let by_y = (step(0.0, 1.0)? - step(0.0, -1.0)?) * 0.5;
            patch.found_in(
                &other.levels,
                &expected,
                &Matrix2::from_columns(&[by_x, by_y]),
            )
        };
        observations.extend(found().map(|pixel| Observation { frame, pixel }));
    }
    (observations.len() > MIN_OTHERS).then_some(Landmark {
        observations,
        plane_place: plane.point,
        plane_normal: plane.normal,
        place: hit,
    })
}

/// What an image looks like around a corner, half as large and as large as it is.
struct PatchPyramid([Patch; 2]);

impl PatchPyramid {
    fn new(levels: &[Gray; 2], corner: &Vector2<f64>) -> Option<Self> {
        Some(Self([
            Patch::new(&levels[0], &halved(corner))?,
            Patch::new(&levels[1], corner)?,
        ]))
    }

    fn found_in(
        &self,
        levels: &[Gray; 2],
        expected: &Vector2<f64>,
        there_by_here: &Matrix2<f64>,
    ) -> Option<Vector2<f64>> {
        let sizes = there_by_here.singular_values();
        if !(sizes.min() > STRETCH[0] && sizes.max() < STRETCH[1]) {
            return None;
        }
        let search = PatchSearch {
            there_by_here: *there_by_here,
            most_left: MOST_LEFT,
        };
        let near = self.0[0].find(&levels[0], &halved(expected), &search)?;
        self.0[1].find(&levels[1], &doubled(&near), &search)
    }
}

/// The same place in an image half as wide.
fn halved(pixel: &Vector2<f64>) -> Vector2<f64> {
    pixel.map(|c| 0.5 * (c + 0.5) - 0.5)
}

fn doubled(pixel: &Vector2<f64>) -> Vector2<f64> {
    pixel.map(|c| 2.0 * (c + 0.5) - 0.5)
}
