//! Whether images show what their poses say they show. Matches for a map are looked for along epipolar lines, where some are found by chance
//! whatever the poses; images that belong to other poses so give a map all the same. Matches that were found by their
//! descriptors alone tell: in the right poses most of them lie along these lines.

use rayon::prelude::*;

use super::prepared_image::{PreparedImage, compare_pair};
use super::reconstruction_config::ReconstructionConfig;
use super::scene_depth::depth_pairs;

/// Fewer matches say nothing: the images show hardly anything that could be compared, and give no map.
const LEAST_MATCHES: usize = 40;
/// Share of the matches that lie where the poses have them, below which the images belong to others. The HoloLens office has 0.90, the
/// kitchen of 7-Scenes 0.86, Strecha's fountain 0.96; the office with its images in another order 0.15, thirty images late 0.21.
const LEAST_SHARE: f64 = 0.4;

/// What is wrong, in words; `None` where nothing is.
pub(super) fn contradicted(
    images: &[PreparedImage],
    config: &ReconstructionConfig,
) -> Option<String> {
    let poses: Vec<_> = images.iter().map(|i| i.placed.world_from_camera).collect();
    let pairs = depth_pairs(&poses, config);
    let compared: Vec<(usize, usize)> = pairs
        .par_iter()
        .map(|&(first, second)| compare_pair(images, first, second, config))
        .collect();
    let all: usize = compared.iter().map(|(all, _)| all).sum();
    let right: usize = compared.iter().map(|(_, right)| right).sum();
    let share = right as f64 / all.max(1) as f64;
    (all >= LEAST_MATCHES && share < LEAST_SHARE).then(|| {
        format!(
            "of {all} matches between images that should see the same only {right} lie where their poses have them: the poses are not those of these images"
        )
    })
}
