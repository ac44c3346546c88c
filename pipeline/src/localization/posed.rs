use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};

use lsfb_geometry::Se3;
use lsfb_types::{Progress, ProgressFn};
use rayon::prelude::*;

use super::{Localization, Localizer, NotLocalized};
use crate::Error;
use crate::features::{FrameFeatures, SiftConfig, SiftDetector};
use crate::posed_images::PosedImages;

/// What became of one image, beside the pose its list gives.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageLocalization {
    /// The image file.
    pub path: PathBuf,
    /// The pose that the list gives: never used to find the other.
    pub listed_world_from_rig: Se3,
    /// The pose found in the map.
    pub found: Result<Localization, NotLocalized>,
}

impl ImageLocalization {
    /// Distance of the pose found from the listed one, metres; `None` where none was found.
    pub fn distance_m(&self) -> Option<f64> {
        let found = self.found.as_ref().ok()?;
        Some((found.world_from_rig.translation - self.listed_world_from_rig.translation).norm())
    }

    /// Angle between the pose found and the listed one, degrees; `None` where none was found.
    pub fn angle_deg(&self) -> Option<f64> {
        let found = self.found.as_ref().ok()?;
        let off = self.listed_world_from_rig.inverse() * found.world_from_rig;
        Some(off.rotation.angle().to_degrees())
    }
}

/// Localizes each image of a list on its own, in the list's order.
pub fn localize_posed_images(
    localizer: &Localizer,
    posed: &PosedImages,
    sift: &SiftConfig,
    progress: ProgressFn,
) -> Result<Vec<ImageLocalization>, Error> {
    let prototype = SiftDetector::new(sift)?;
    let done = AtomicU64::new(0);
    let localized = posed.images.par_iter().map_init(
        || prototype.clone(),
        |detector, image| {
            let frame = FrameFeatures {
                camera: image.camera.clone(),
                features: detector.detect(&lsfb_perception::image::read(&image.path)?),
            };
            let found = localizer.localize(&[frame], &posed.rig);
            progress(Progress {
                stage: "localization",
                done: done.fetch_add(1, Ordering::Relaxed) + 1,
                total: posed.images.len() as u64,
            })?;
            Ok(ImageLocalization {
                path: image.path.clone(),
                listed_world_from_rig: image.world_from_rig,
                found,
            })
        },
    );
    localized.collect()
}
