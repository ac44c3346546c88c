//! What each camera has for itself: its views, a pose of the target in each, and whether these agree with another camera's.

use std::collections::{BTreeMap, BTreeSet};

use lsfb_geometry::{Se3, Vector2, Vector3};
use lsfb_types::{Timestamp, median};

use super::input::Input;
use super::state::View;
use super::{KnownCamera, checks};
use crate::Error;
use crate::camera::{CameraViews, as_global_shutter, copied_views, pose_of_target};
use crate::detect::Corner;

/// Corners farther than this from the first pose are outliers from the start, pixels.
const FIRST_LIMIT_PX: f64 = 4.0;
/// Share of a camera's views that must have most of their corners within that.
const LEAST_FITTING: f64 = 0.5;
/// Corners a view needs.
const MIN_CORNERS: usize = 8;
/// Views a camera needs.
pub(super) const MIN_VIEWS: usize = 10;
/// Instants at which two cameras must see the target to compare their poses with the rig's.
const MIN_SHARED: usize = 5;

/// A camera's views with its own pose of the target in each.
pub(super) struct PosedViews {
    pub views: Vec<View>,
    /// Stamp and `target_from_camera`.
    pub poses: Vec<(f64, Se3)>,
    /// Median error of its corners, each view for itself, pixels.
    pub median_px: f64,
}

/// A camera's views and its own poses, with corners that one pose explains. Where the shutter rolls the poses are those at which the middle
/// row was exposed; the corners stay where they were seen.
pub(super) fn look(
    input: &Input,
    known: &KnownCamera,
    readout_s: f64,
    camera: usize,
    origin: Timestamp,
) -> Result<PosedViews, Error> {
    let Input { target, config, .. } = *input;
    let still = as_global_shutter(&known.views, readout_s);
    let mut seen = PosedViews {
        views: Vec::new(),
        poses: Vec::new(),
        median_px: f64::INFINITY,
    };
    let mut errors = Vec::new();
    let step = config.view_step.max(1);
    let own = different_views(&known.views);
    let views = own.len();
    let instants = own.into_iter().step_by(step);
    for (number, (instant, corners)) in instants.enumerate() {
        let stamp_s = Timestamp::from_nanos(*instant).secs_since(origin);
        let Some(mut at_once) = still.views.get(instant).cloned() else {
            continue;
        };
        at_once.retain(|c| c.index < target.corner_count());
        at_once.sort_by_key(|c| c.index);
        let Some(pose) = pose_of_target(target, &known.camera, &at_once) else {
            continue;
        };
        let pixels: BTreeMap<usize, Vector2<f64>> =
            corners.iter().map(|c| (c.index, c.pixel)).collect();
        let fitting: Vec<(Vector3<f64>, Vector2<f64>)> = at_once
            .iter()
            .filter_map(|corner| {
                let point = target.corner(corner.index);
                let seen = known.camera.project(&(pose * point));
                let error = seen.map_or(f64::INFINITY, |s| (s - corner.pixel).norm());
                errors.push(error);
                let pixel = pixels.get(&corner.index)?;
                (error < FIRST_LIMIT_PX).then_some((point, *pixel))
            })
            .collect();
        if fitting.len() < MIN_CORNERS {
            continue;
        }
        seen.poses.push((stamp_s, pose.inverse()));
        let every = config.holdout_every;
        seen.views.push(View {
            camera,
            stamp_s,
            inliers: vec![true; fitting.len()],
            corners: fitting,
            holdout: every > 1 && number % every == every / 2,
        });
    }
    if views < MIN_VIEWS && views < known.views.views.len() {
        return Err(Error::CopiedImages {
            camera: known.views.name.clone(),
            found: known.views.views.len(),
            different: views,
            needed: MIN_VIEWS,
        });
    }
    if views < MIN_VIEWS {
        return Err(Error::TargetNotSeen {
            camera: known.views.name.clone(),
            found: views,
            images: known.views.images,
            needed: MIN_VIEWS,
            target: target.describe(),
        });
    }
    let median_px = median(errors).unwrap_or(f64::INFINITY);
    let fitting = seen.views.len() as f64 >= LEAST_FITTING * views as f64 / step as f64;
    if !(median_px < FIRST_LIMIT_PX && fitting) {
        return Err(Error::DoesNotFit {
            camera: known.views.name.clone(),
            rms_px: median_px,
            target: target.describe(),
            model: known.camera.lens.model().name(),
        });
    }
    seen.median_px = median_px;
    Ok(seen)
}

/// Views without those that are copies of others: a camera that repeats an image took it at the first of its stamps.
pub(super) fn different_views(views: &CameraViews) -> Vec<(&i64, &Vec<Corner>)> {
    let copies = copied_views(views).into_iter();
    let copies: BTreeSet<i64> = copies.map(|(copy, _)| copy).collect();
    let all = views.views.iter();
    all.filter(|(instant, _)| !copies.contains(instant))
        .collect()
}

/// Compares the poses of two cameras to each other, seen at shared stamps, with the rig's.
pub(super) fn compare(
    first: &KnownCamera,
    seen_first: &PosedViews,
    other: &KnownCamera,
    seen_other: &PosedViews,
    other_from_first: &Se3,
) -> Result<(), Error> {
    let shared: Vec<Se3> = seen_other
        .poses
        .iter()
        .filter_map(|(stamp_s, target_from_other)| {
            let k = seen_first
                .poses
                .binary_search_by(|p| p.0.total_cmp(stamp_s))
                .ok()?;
            Some(target_from_other.inverse() * seen_first.poses[k].1)
        })
        .collect();
    if shared.len() < MIN_SHARED {
        return Ok(());
    }
    match crate::camera::most_central(&shared) {
        Some(seen) => checks::agree(
            &first.views.name,
            &other.views.name,
            &seen,
            other_from_first,
        ),
        None => Ok(()),
    }
}
