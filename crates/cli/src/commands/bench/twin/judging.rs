//! Single images of a walk against a map and the truth.

use lsfb_geometry::{Se3, Trajectory};
use lsfb_pipeline::features::{FrameFeatures, SiftConfig, SiftDetector};
use lsfb_pipeline::hd_map::HdMap;
use lsfb_pipeline::localization::{Localizer, LocalizerConfig};
use lsfb_recording::Recording;
use lsfb_types::{Image, Progress, Timestamp};
use rayon::prelude::*;

use super::result::WRONG_M;
use crate::context::Context;

/// Instants that are localized on their own, spread over the walk.
const INSTANTS: usize = 40;
/// A rotation that is further off is wrong, degrees.
const WRONG_DEG: f64 = 5.0;
/// Images of one instant are no further apart, nanoseconds.
const SAME_INSTANT_NS: i64 = 1_000_000;

/// Shares of the instants that were looked at.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Localized {
    /// With a pose.
    pub claimed: f64,
    /// With a pose that is right.
    pub right: f64,
}

/// Images taken at one instant, by the number of their camera.
type Instant = (Timestamp, Vec<(usize, Image)>);

/// Localizes some instants of a walk on their own.
pub fn localize(
    walk: &Recording,
    map: &HdMap,
    truth: &Trajectory,
    truth_from_map: &Se3,
    context: &Context,
) -> anyhow::Result<Localized> {
    let rig = walk.rig()?;
    let names: Vec<&str> = rig.cameras.keys().map(String::as_str).collect();
    let chosen = some_instants(walk, &names)?;
    let localizer = Localizer::new(map, &LocalizerConfig::default())?;
    let detector = SiftDetector::new(&SiftConfig::default())?;
    let found: Vec<anyhow::Result<[bool; 2]>> = chosen
        .par_iter()
        .map_init(
            || detector.clone(),
            |detector, (time, images)| {
                context.check_stop()?;
                let frames: Vec<FrameFeatures> = images
                    .iter()
                    .map(|(camera, image)| FrameFeatures {
                        camera: names[*camera].to_owned(),
                        features: detector.detect(image),
                    })
                    .collect();
                let Ok(pose) = localizer.localize(&frames, &rig) else {
                    return Ok([false; 2]);
                };
                let right = truth.at(*time).is_some_and(|true_pose| {
                    let off = true_pose.inverse() * *truth_from_map * pose.world_from_rig;
                    off.translation.norm() <= WRONG_M
                        && off.rotation.angle().to_degrees() <= WRONG_DEG
                });
                Ok([true, right])
            },
        )
        .collect();
    let mut counts = [0_usize; 2];
    for one in found {
        for (count, is) in counts.iter_mut().zip(one?) {
            *count += usize::from(is);
        }
    }
    let share = |count: usize| count as f64 / chosen.len().max(1) as f64;
    context.show(Progress {
        stage: "localizing single images",
        done: chosen.len() as u64,
        total: chosen.len() as u64,
    })?;
    Ok(Localized {
        claimed: share(counts[0]),
        right: share(counts[1]),
    })
}

fn some_instants(walk: &Recording, names: &[&str]) -> anyhow::Result<Vec<Instant>> {
    let mut all: Vec<Timestamp> = Vec::new();
    for image in walk.images(names.first().copied().unwrap_or_default())? {
        all.push(image?.time);
    }
    let step = all.len().div_ceil(INSTANTS).max(1);
    let wanted: Vec<Timestamp> = all.into_iter().step_by(step).collect();
    let mut chosen: Vec<Instant> = wanted.into_iter().map(|time| (time, Vec::new())).collect();
    for item in walk.images_of(names)? {
        let item = item?;
        let ns = item.image.time.nanos();
        let near = chosen.partition_point(|(time, _)| time.nanos() < ns - SAME_INSTANT_NS);
        if let Some((time, images)) = chosen.get_mut(near)
            && time.nanos() <= ns + SAME_INSTANT_NS
        {
            images.push((item.camera, item.image.sample));
        }
    }
    Ok(chosen)
}
