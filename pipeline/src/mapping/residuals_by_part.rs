//! What is left of residuals, camera by camera and region by region: where a map is weak, the means of all of it do not say.

use std::collections::BTreeMap;

use lsfb_geometry::{StampedPose, Vector3};
use lsfb_perception::statistics::median;

use super::keyframes::Keyframes;
use super::report::MappingReport;
use super::residuals::RegionResiduals;
use super::scan_pairs::Compared;
use super::weights::lidar_residuals;
use crate::hd_map::{
    CameraResiduals, KeypointError, MapPoint, PixelResiduals, residuals_by_camera,
};

/// Edge of a region, metres: a room, or a stretch of a corridor.
const REGION_M: f64 = 5.0;

/// Which keyframes are of which region.
pub(super) struct Regions {
    of_keyframe: Vec<usize>,
    count: usize,
}

impl Regions {
    /// By where the start has the keyframes, in the order in which the way comes to them.
    pub fn of(start: &[StampedPose]) -> Self {
        let mut numbers: BTreeMap<[i64; 3], usize> = BTreeMap::new();
        let cells = start.iter().map(|keyframe| {
            let place = keyframe.world_from_rig.translation;
            // The walk begins in the middle of one, not where eight meet.
            let cell = [place.x, place.y, place.z].map(|c| (c / REGION_M).round() as i64);
            let next = numbers.len();
            *numbers.entry(cell).or_insert(next)
        });
        let of_keyframe: Vec<usize> = cells.collect();
        Self {
            count: numbers.len(),
            of_keyframe,
        }
    }

    fn of_image(&self, keyframes: &Keyframes, image: usize) -> Option<usize> {
        let keyframe = keyframes.images.get(image)?.keyframe;
        self.of_keyframe.get(keyframe).copied()
    }
}

/// What is measured at poses as they are.
pub(super) struct Measured<'a> {
    pub keyframes: &'a Keyframes,
    pub errors: Vec<KeypointError>,
    pub scans: &'a [Compared],
    /// `max_reprojection_px`.
    pub max_px: f64,
}

/// Residuals of both kinds at one time.
#[derive(Clone, Copy)]
pub(super) enum Moment {
    Before,
    After,
}

impl Measured<'_> {
    /// Puts what is measured into the report, by camera and by region. Returns the errors alone, pixels.
    pub fn put(self, regions: &Regions, moment: Moment, report: &mut MappingReport) -> Vec<f64> {
        self.by_camera(moment, &mut report.by_camera);
        self.by_region(regions, moment, &mut report.by_region);
        self.errors.iter().map(|error| error.px).collect()
    }

    /// Puts what is measured into the residuals of each camera, ascending by name.
    fn by_camera(&self, moment: Moment, into: &mut Vec<CameraResiduals>) {
        let found = residuals_by_camera(&self.keyframes.images, &self.errors, self.max_px);
        into.resize_with(found.len(), CameraResiduals::default);
        for ((camera, found), residuals) in found.into_iter().zip(into) {
            residuals.camera = camera;
            *moment.of(&mut residuals.before, &mut residuals.after) = found;
        }
    }

    /// The same of each region.
    fn by_region(&self, regions: &Regions, moment: Moment, into: &mut Vec<RegionResiduals>) {
        let mut errors = vec![Vec::new(); regions.count];
        for error in &self.errors {
            let region = regions.of_image(self.keyframes, error.image);
            let of_region = region.and_then(|region| errors.get_mut(region));
            of_region.into_iter().for_each(|all| all.push(error.px));
        }
        into.resize_with(regions.count, RegionResiduals::default);
        for (number, (residuals, errors)) in into.iter_mut().zip(errors).enumerate() {
            let is_here = |scan: &&Compared| regions.of_keyframe.get(scan.0.n) == Some(&number);
            let lidar = lidar_residuals(&self.keyframes.frames, self.scans.iter().filter(is_here));
            *moment.of(&mut residuals.before, &mut residuals.after) =
                PixelResiduals::of(&errors, self.max_px);
            *moment.of(&mut residuals.lidar_before, &mut residuals.lidar_after) = lidar;
        }
    }
}

impl Moment {
    fn of<'a, T>(self, before: &'a mut T, after: &'a mut T) -> &'a mut T {
        match self {
            Self::Before => before,
            Self::After => after,
        }
    }
}

/// Where the regions are, and how many observations of the map's points their keyframes have.
pub(super) fn put_coverage(
    regions: &Regions,
    keyframes: &Keyframes,
    points: &[MapPoint],
    into: &mut [RegionResiduals],
) {
    let mut observations = vec![0_u64; keyframes.frames.len()];
    for seen in points.iter().flat_map(|p| &p.observations) {
        let keyframe = keyframes.images.get(seen.image).map(|i| i.keyframe);
        let count = keyframe.and_then(|keyframe| observations.get_mut(keyframe));
        count.into_iter().for_each(|count| *count += 1);
    }
    for (number, region) in into.iter_mut().enumerate() {
        let mut place = Vector3::zeros();
        let mut counts = Vec::new();
        let all = keyframes.frames.iter().zip(&observations);
        for ((frame, count), _) in all
            .zip(&regions.of_keyframe)
            .filter(|(_, region)| **region == number)
        {
            place += frame.world_from_rig.translation;
            counts.push(*count);
        }
        region.keyframes = counts.len() as u64;
        region.fewest_observations = counts.iter().copied().min().unwrap_or(0);
        region.center_m = (place / counts.len().max(1) as f64).into();
        let counts = counts.into_iter().map(|count| count as f64);
        region.median_observations = median(counts.collect()).unwrap_or(0.0);
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Se3;
    use lsfb_types::Timestamp;

    use super::*;
    use crate::features::Features;
    use crate::hd_map::{KeyframeImage, PointObservation};
    use crate::mapping::keyframes::Keyframe;

    /// Along x, a metre apart, each with an image of two cameras.
    fn keyframes(count: usize) -> Keyframes {
        let frames = (0..count).map(|k| Keyframe {
            time: Timestamp::from_nanos(k as i64),
            world_from_rig: Se3::new(Default::default(), Vector3::x() * k as f64),
            lidar: None,
        });
        let images = (0..2 * count).map(|image| KeyframeImage {
            keyframe: image / 2,
            camera: ["left", "right"][image % 2].to_owned(),
            features: Features::default(),
        });
        Keyframes {
            frames: frames.collect(),
            images: images.collect(),
        }
    }

    /// The mean of all images says nothing of a camera, nor of a room, that is worse.
    #[test]
    fn a_camera_and_a_region_that_are_worse_are_seen() {
        let keyframes = keyframes(15);
        let regions = Regions::of(&keyframes.poses());
        // The right camera is off by twice as much, and both by five times as much from 8 m on.
        let errors: Vec<KeypointError> = (0..keyframes.images.len())
            .map(|image| {
                let of_place = if image / 2 < 8 { 1.0 } else { 5.0 };
                let px = of_place * [1.0, 2.0][image % 2];
                KeypointError { image, px }
            })
            .collect();
        let measured = Measured {
            keyframes: &keyframes,
            errors,
            scans: &[],
            max_px: 3.0,
        };
        let (mut cameras, mut found) = (Vec::new(), Vec::new());
        measured.by_camera(Moment::Before, &mut cameras);
        measured.by_region(&regions, Moment::Before, &mut found);
        let better = Measured {
            errors: Vec::new(),
            ..measured
        };
        better.by_camera(Moment::After, &mut cameras);
        better.by_region(&regions, Moment::After, &mut found);
        let points = [MapPoint {
            point_in_world: Vector3::zeros(),
            observations: (0..20)
                .map(|image| PointObservation { image, keypoint: 0 })
                .collect(),
            reprojection_rms_px: 0.0,
        }];
        put_coverage(&regions, &keyframes, &points, &mut found);
        let names: Vec<&str> = cameras.iter().map(|c| c.camera.as_str()).collect();
        assert_eq!(names, ["left", "right"]);
        assert!((cameras[1].before.rms_px / cameras[0].before.rms_px - 2.0).abs() < 1e-9);
        assert_eq!((cameras[0].before.count, cameras[0].after.count), (15, 0));
        let shares: Vec<f64> = found.iter().map(|r| r.before.outlier_share).collect();
        assert_eq!(shares, [0.0, 0.0, 1.0, 1.0]);
        let places: Vec<f64> = found.iter().map(|r| r.center_m[0]).collect();
        assert_eq!(places, [1.0, 5.0, 10.0, 13.5]);
        let seen: Vec<u64> = found.iter().map(|r| r.fewest_observations).collect();
        assert_eq!(seen, [2, 2, 0, 0]);
    }
}
