//! How deep a scene is, in the unit of the poses: the length that baselines are measured by, so that a map of a desk and one of a
//! street are made alike, whatever their unit.

use lsfb_geometry::{Se3, Vector3};
use lsfb_perception::statistics::median;
use rayon::prelude::*;

use super::prepared_image::{PreparedImage, match_pair};
use super::reconstruction_config::ReconstructionConfig;
use crate::features::triangulation::{View, triangulate};

/// Images whose surroundings are looked at, evenly over all.
const ANCHORS: usize = 12;
/// Each is matched with its nearest image, and others by their rank: how far the right ones are is not known yet.
const RANKS: [usize; 6] = [0, 1, 3, 7, 15, 31];
/// Fewer points do not say how deep a scene is.
const MIN_POINTS: usize = 20;

/// Pairs of images from which the depth can be taken: near one another in rank, never at the same place.
pub(super) fn depth_pairs(
    world_from_cameras: &[Se3],
    config: &ReconstructionConfig,
) -> Vec<(usize, usize)> {
    let count = world_from_cameras.len();
    let anchors = ANCHORS.min(count);
    let min_cosine = config.max_axis_angle_deg.to_radians().cos();
    let mut pairs: Vec<(usize, usize)> = (0..anchors)
        .flat_map(|i| {
            let anchor = (2 * i + 1) * count / (2 * anchors);
            let pose = &world_from_cameras[anchor];
            let axis = pose.rotation * Vector3::z();
            let mut near: Vec<(f64, usize)> = world_from_cameras
                .iter()
                .enumerate()
                .filter(|(_, other)| (other.rotation * Vector3::z()).dot(&axis) > min_cosine)
                .map(|(j, other)| ((other.translation - pose.translation).norm(), j))
                .filter(|(baseline, _)| *baseline > 0.0)
                .collect();
            near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let chosen = RANKS
                .into_iter()
                .filter_map(move |rank| near.get(rank).copied());
            chosen.map(move |(_, j)| (anchor.min(j), anchor.max(j)))
        })
        .collect();
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// Median distance of points from the cameras that see them; `None` where too few points come together.
pub(super) fn scene_depth(
    images: &[PreparedImage],
    pairs: &[(usize, usize)],
    config: &ReconstructionConfig,
) -> Option<f64> {
    let depths: Vec<Vec<f64>> = pairs
        .par_iter()
        .map(|&(first, second)| depths_of_pair(images, first, second, config))
        .collect();
    let depths = depths.concat();
    if depths.len() < 2 * MIN_POINTS {
        return None;
    }
    median(depths)
}

/// Distances of the points that two images share, from both.
fn depths_of_pair(
    images: &[PreparedImage],
    first: usize,
    second: usize,
    config: &ReconstructionConfig,
) -> Vec<f64> {
    let matches = match_pair(images, first, second, config).matches;
    let pairs = matches.iter().flat_map(|m| {
        let seen = [(first, m.first), (second, m.second)];
        let views: Option<Vec<View>> = seen
            .into_iter()
            .map(|(image, keypoint)| images[image].placed.view(keypoint))
            .collect();
        let point = views.and_then(|v| triangulate(&v, &config.triangulation).ok());
        point.map_or_else(Vec::new, |found| {
            let distance = |image: usize| {
                let camera = images[image].placed.world_from_camera.translation;
                (found.point_in_world - camera).norm()
            };
            vec![distance(first), distance(second)]
        })
    });
    pairs.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_do_not_depend_on_the_unit_and_never_join_one_place() {
        let poses = |unit: f64| -> Vec<Se3> {
            let place = |i: usize| Vector3::new((i / 2) as f64 * 0.3 * unit, 0.0, 0.0);
            (0..80)
                .map(|i| Se3::new(Default::default(), place(i)))
                .collect()
        };
        let config = ReconstructionConfig::default();
        let pairs = depth_pairs(&poses(1.0), &config);
        assert!(pairs.len() > 30, "{}", pairs.len());
        assert!(pairs.iter().all(|(a, b)| a / 2 != b / 2), "{pairs:?}");
        assert_eq!(pairs, depth_pairs(&poses(64.0), &config));
        assert!(depth_pairs(&poses(0.0), &config).is_empty());
        assert!(depth_pairs(&[], &config).is_empty());
    }
}
