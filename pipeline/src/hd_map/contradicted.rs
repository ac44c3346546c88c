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

/// Matches of a pair of images from which on it says something by itself.
const LEAST_OF_PAIR: usize = 20;
/// Share of such pairs that may be wrong: some hardly overlap. The office has 0.05, the kitchen 0.12, the fountain none (with ALIKE 0 and 0.02); the office
/// whose second half has the images of 60 frames later 0.44.
const MOST_WRONG_PAIRS: f64 = 0.25;

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
    let told = compared.iter().filter(|(all, _)| *all >= LEAST_OF_PAIR);
    let (told, wrong) = told.fold((0u32, 0u32), |(told, wrong), pair| {
        (told + 1, wrong + u32::from(is_wrong(*pair)))
    });
    let [all, right] = compared
        .iter()
        .fold([0, 0], |sum, pair| [sum[0] + pair.0, sum[1] + pair.1]);
    if all >= LEAST_MATCHES && is_wrong((all, right)) {
        return Some(format!(
            "of {all} matches between overlapping images only {right} agree with their poses: these poses do not belong to these images"
        ));
    }
    let share = f64::from(wrong) / f64::from(told.max(1));
    (share > MOST_WRONG_PAIRS).then(|| {
        format!(
            "in {wrong} of {told} pairs of overlapping images most matches contradict the poses: some poses do not belong to their images"
        )
    })
}

/// Whether so few of all matches lie where the poses have them that these are others'.
fn is_wrong((all, right): (usize, usize)) -> bool {
    (right as f64) < LEAST_SHARE * all as f64
}
