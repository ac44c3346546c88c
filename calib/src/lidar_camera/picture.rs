//! Returns of a scan over the image of the same pose: what a person believes before any figure.

use lsfb_geometry::{Camera, Vector3};
use lsfb_types::Image;

use super::{BoardPose, LidarCameraCalibration};
use crate::Error;
use crate::overlay::{Overlay, Picture};

impl LidarCameraCalibration {
    /// The pose that shows most: of those that count, the one with the most returns on its board.
    pub fn pictured_pose<'a>(&self, poses: &'a [BoardPose]) -> Option<&'a BoardPose> {
        let counts = self.poses.iter().filter(|p| p.rejected.is_none());
        let best = counts.max_by_key(|p| p.points)?;
        poses.iter().find(|pose| pose.name == best.name)
    }

    /// The scan of a pose over its image: returns should end where the board does.
    pub fn overlay(
        &self,
        lens: &Camera,
        pose: &BoardPose,
        image: &Image,
    ) -> Result<Overlay, Error> {
        let returns = pose.scan.points.iter();
        let points: Vec<Vector3<f64>> = returns
            .map(|p| Vector3::from(p.position_m.map(f64::from)))
            .collect();
        let (picture, points) = Picture::new(image, lens, &self.camera_from_lidar, &points);
        Ok(Overlay {
            camera: self.camera.clone(),
            time_ns: pose.middle_sight().map_or(0, |sight| sight.instant),
            points,
            png: picture.to_png()?,
        })
    }
}

impl BoardPose {
    /// The image taken nearest to the middle of the scan.
    pub fn middle_sight(&self) -> Option<&super::BoardSight> {
        self.sights.get(self.sights.len() / 2)
    }
}
