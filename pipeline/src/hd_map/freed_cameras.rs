//! A problem in which cameras may be other than their rig says: a correction of each with what is thought possible as its prior, and
//! points with what images saw of them. Whoever sets it up adds the poses of the keyframes before, held or free.

use std::collections::BTreeMap;
use std::sync::Arc;

use lsfb_geometry::{Rig, Se3, Vector3};
use lsfb_solver::{Block, Kernel, Problem, VectorPrior};

use super::{KeyframeImage, MapPoint};
use crate::Error;
use crate::residuals::{CameraCorrection, FrameMotion, MovingCamera, MovingReprojection};

/// Standard deviations beyond which an observation counts less.
const HUBER_SIGMAS: f64 = 2.0;

/// The cameras of a rig in a problem, with their corrections.
pub(crate) struct FreedCameras<'a> {
    cameras: BTreeMap<&'a str, (Arc<MovingCamera>, Block<CameraCorrection>)>,
}

/// What images saw of points.
pub(crate) struct Sights<'a> {
    /// The images that the points' observations name.
    pub images: &'a [KeyframeImage],
    /// Poses of the rig, by keyframe.
    pub poses: &'a [Block<Se3>],
    /// Motion of the rig around them.
    pub motions: &'a [FrameMotion],
    /// Standard deviation of a pixel in each direction.
    pub sigma_px: f64,
    /// Keeps a point that no camera has before it any more, as the cameras change, from being undetermined; in the unit of the poses.
    pub point_sigma: f64,
}

impl<'a> FreedCameras<'a> {
    /// Adds a correction of each camera of the rig, zero to begin with; `possible` are standard deviations of its entries.
    pub fn add_to(
        problem: &mut Problem,
        rig: &'a Rig,
        possible: &CameraCorrection,
    ) -> Result<Self, Error> {
        let mut cameras = BTreeMap::new();
        for (name, camera) in &rig.cameras {
            let block = problem.add_block(CameraCorrection::zeros());
            let prior = VectorPrior::new(CameraCorrection::zeros(), *possible);
            problem.add_residual(prior, &[block.id()], Kernel::Squared)?;
            cameras.insert(name.as_str(), (MovingCamera::new(camera), block));
        }
        Ok(Self { cameras })
    }

    /// Adds points with their observations by these cameras.
    pub fn add_points<'p>(
        &self,
        problem: &mut Problem,
        points: impl IntoIterator<Item = &'p MapPoint>,
        sights: &Sights,
    ) -> Result<(), Error> {
        for point in points {
            let block = problem.add_eliminated_point(point.point_in_world);
            let sigma = Vector3::repeat(sights.point_sigma);
            let prior = VectorPrior::new(point.point_in_world, sigma);
            problem.add_residual(prior, &[block.id()], Kernel::Squared)?;
            for o in &point.observations {
                let image = &sights.images[o.image];
                let Some((camera, correction)) = self.cameras.get(image.camera.as_str()) else {
                    continue;
                };
                let residual = MovingReprojection {
                    camera: camera.clone(),
                    motion: sights.motions[image.keyframe],
                    pixel: image.features.keypoints[o.keypoint as usize].pixel_f64(),
                    sigma_px: sights.sigma_px,
                };
                let pose = sights.poses[image.keyframe];
                let kernel = Kernel::Huber {
                    scale: HUBER_SIGMAS,
                };
                problem.add_residual(
                    residual,
                    &[pose.id(), correction.id(), block.id()],
                    kernel,
                )?;
            }
        }
        Ok(())
    }

    /// The corrections, in order of the cameras' names.
    pub fn corrections(&self) -> impl Iterator<Item = (&'a str, Block<CameraCorrection>)> {
        self.cameras
            .iter()
            .map(|(name, (_, block))| (*name, *block))
    }
}
