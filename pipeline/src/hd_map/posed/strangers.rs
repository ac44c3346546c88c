//! Images whose poses are not theirs.
//!
//! A few images under other images' poses change neither what most pairs say (`contradicted`) nor how most points fit: their features
//! make no points, and nobody hears of it. They are found in two ways. An image that shares hardly anything with those around it is
//! looked up in the map by its features: where it resembles an image with which it should share nothing, and that so much that their matches
//! contradict the poses, its pose is not its own. And many images that share hardly anything with the others are no accident, whatever they
//! show; but for those whose matches with the images that should see the same do lie where the poses have them: cameras that hardly move make
//! no points. In the HoloLens office with every tenth image under another's pose 29 keyframes have 0 to 16 observations where the median has 216;
//! of right images the least has an eighth of the median.

use lsfb_geometry::{Rig, Se3, StampedPose, Vector3};
use lsfb_types::quantile;
use rayon::prelude::*;

use super::super::prepared_image::{PreparedImage, compare_pair, prepare};
use super::super::{CERTAIN_VIEWS, HdMap, KeyframeImage, MapPoint, ReconstructionConfig};
use crate::Error;
use crate::descriptor_index::SearchScratch;

/// Images that share much with others have as many observations as this quantile, up to where nine of ten are wrong.
const REFERENCE: f64 = 0.9;
/// Shares of that: below the first an image is looked up, below the second it shares hardly anything with the others.
const SUSPECT_SHARE: f64 = 1.0 / 6.0;
const LEAST_SHARE: f64 = 1.0 / 24.0;
/// Images with fewer features show little of anything.
const FEWEST_FEATURES: usize = 200;
/// Images that share hardly anything, and their share of all, that are no accident.
const FEWEST: usize = 2;
const FEWEST_SHARE: f64 = 0.02;
/// Features by which an image is looked up, how many neighbours of each vote, and lists that are searched for them.
const LOOKED_UP: usize = 200;
const VOTING: usize = 3;
const PROBES: usize = 8;
const COMPARED: usize = 20;
/// Matches of two images from which on they say whether the poses are theirs, and the share of these that lie where the poses have them:
/// of the right poses most do.
const LEAST_MATCHES: usize = 30;
const LEAST_RIGHT: f64 = 0.3;
/// Images that should see the same as another one look so much alike at most, radians; the nearest of them are asked, and this share of their matches
/// must lie where the poses have them.
const SAME_DIRECTION_RAD: f64 = 0.5;
const ASKED: usize = 6;
const CLEARLY_RIGHT: f64 = 0.7;
/// Images this many times as far apart as points need make some.
const SURE_PARALLAX: f64 = 2.0;
/// Images that are named.
const NAMED: usize = 5;

/// Images with the map that was made of them.
pub(super) struct Mapped<'a> {
    pub rig: &'a Rig,
    pub keyframes: &'a [StampedPose],
    pub images: &'a [KeyframeImage],
    /// Those of the map, in its order.
    pub points: &'a [MapPoint],
    pub map: &'a HdMap,
    pub config: &'a ReconstructionConfig,
    /// How deep the scene is, in the unit of the poses.
    pub depth: f64,
}

/// What is wrong, in words: a sentence for each way in which it was found. `name` names an image.
pub(super) fn strangers(
    mapped: &Mapped,
    name: impl Fn(usize) -> String,
) -> Result<Vec<String>, Error> {
    let Mapped { images, points, .. } = mapped;
    let counts = Counts::of(images, points);
    let mut said = Vec::new();
    let suspects = counts.below(SUSPECT_SHARE);
    let prepared = match suspects.is_empty() {
        true => Vec::new(),
        false => mapped.prepared()?,
    };
    let elsewhere = mapped.elsewhere(&prepared, &suspects);
    if let Some(first) = elsewhere.first() {
        let named: Vec<String> = elsewhere
            .iter()
            .take(NAMED)
            .map(|e| name(e.image))
            .collect();
        let more = match elsewhere.len() > NAMED {
            true => ", …",
            false => "",
        };
        said.push(format!(
            "{} of {} images contradict their poses ({}{more}): of {} matches of the first with {}, \
             only {} agree with the poses",
            elsewhere.len(),
            images.len(),
            named.join(", "),
            first.matches,
            name(first.resembles),
            first.right,
        ));
    }
    let lonely = counts.below(LEAST_SHARE);
    if is_no_accident(lonely.len(), images.len()) {
        let lonely = lonely.par_iter();
        let strange = lonely.filter(|image| !mapped.agrees_with_neighbours(&prepared, **image));
        said.extend(strangeness(strange.count(), images.len()));
    }
    Ok(said)
}

/// How much images share with one another.
struct Counts {
    /// Observations of certain points, by image; `None` of one that shows little of anything.
    observations: Vec<Option<usize>>,
    /// What images have that share much with others.
    reference: f64,
}

impl Counts {
    fn of(images: &[KeyframeImage], points: &[MapPoint]) -> Self {
        let mut counts = vec![0usize; images.len()];
        let is_certain = |p: &&MapPoint| p.observations.len() >= CERTAIN_VIEWS;
        let certain = points.iter().filter(is_certain);
        for o in certain.flat_map(|p| &p.observations) {
            if let Some(count) = counts.get_mut(o.image) {
                *count += 1;
            }
        }
        let all = counts.iter().map(|count| *count as f64).collect();
        let shows = |image: &KeyframeImage| image.features.len() >= FEWEST_FEATURES;
        let counted = counts.iter().zip(images);
        Self {
            reference: quantile(all, REFERENCE).unwrap_or(0.0),
            observations: counted
                .map(|(n, image)| shows(image).then_some(*n))
                .collect(),
        }
    }

    /// Images with less than a share of what others have.
    fn below(&self, share: f64) -> Vec<usize> {
        let few = |i: &usize| {
            self.observations[*i].is_some_and(|count| (count as f64) < share * self.reference)
        };
        (0..self.observations.len()).filter(few).collect()
    }
}

/// Whether so many of all images share hardly anything for a reason.
fn is_no_accident(strange: usize, all: usize) -> bool {
    strange >= FEWEST && strange as f64 >= FEWEST_SHARE * all as f64
}

/// What is wrong where too many share hardly anything.
fn strangeness(strange: usize, all: usize) -> Option<String> {
    is_no_accident(strange, all).then(|| {
        format!(
            "{strange} of {all} images have hardly any matches with those that should overlap: their poses do not belong to them"
        )
    })
}

/// An image that resembles one which it should not.
struct Elsewhere {
    image: usize,
    resembles: usize,
    matches: usize,
    right: usize,
}

impl Mapped<'_> {
    /// The images, ready to be matched.
    fn prepared(&self) -> Result<Vec<PreparedImage<'_>>, Error> {
        let images = self.images.par_iter();
        images
            .map(|image| prepare(self.rig, self.keyframes, image))
            .collect()
    }

    /// Whether an image shows what the images next to it do, where the poses have it, and none is so far from it that both would make points: a camera that
    /// is said to have moved and shows the same as before agrees with itself.
    fn agrees_with_neighbours(&self, prepared: &[PreparedImage], image: usize) -> bool {
        let own = prepared[image].placed.world_from_camera;
        let looks_along = |pose: &Se3| pose.rotation * Vector3::z();
        let others = (0..prepared.len()).filter(|other| *other != image);
        let near = others.filter_map(|other| {
            let pose = &prepared[other].placed.world_from_camera;
            let turned = looks_along(&own).angle(&looks_along(pose));
            let apart = (pose.translation - own.translation).norm();
            (turned < SAME_DIRECTION_RAD).then_some((apart, other))
        });
        let mut near: Vec<(f64, usize)> = near.collect();
        let least = SURE_PARALLAX * self.config.triangulation.min_parallax_deg.to_radians();
        let makes_points = least * self.depth..=self.config.max_baseline_per_depth * self.depth;
        if near.iter().any(|(apart, _)| makes_points.contains(apart)) {
            return false;
        }
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.truncate(ASKED);
        let compared = near
            .iter()
            .map(|(_, other)| compare_pair(prepared, image, *other, self.config));
        let most = compared.max_by_key(|(matches, _)| *matches);
        most.is_some_and(|(matches, right)| {
            matches >= LEAST_MATCHES && right as f64 >= CLEARLY_RIGHT * matches as f64
        })
    }

    /// Those of some images that were taken elsewhere.
    fn elsewhere(&self, prepared: &[PreparedImage], suspects: &[usize]) -> Vec<Elsewhere> {
        let found = suspects.par_iter().filter_map(|image| {
            let resembles = self.most_alike(*image)?;
            let (matches, right) = compare_pair(prepared, *image, resembles, self.config);
            let contradicts =
                matches >= LEAST_MATCHES && (right as f64) < LEAST_RIGHT * matches as f64;
            contradicts.then_some(Elsewhere {
                image: *image,
                resembles,
                matches,
                right,
            })
        });
        found.collect()
    }

    /// The image most features of another one vote for.
    fn most_alike(&self, image: usize) -> Option<usize> {
        let descriptors = &self.images[image].features.descriptors;
        let step = descriptors.len().div_ceil(LOOKED_UP).max(1);
        let mut votes = vec![0usize; self.images.len()];
        let mut scratch = SearchScratch::default();
        for descriptor in descriptors.iter().step_by(step) {
            let map = self.map;
            let near = map.nearest(descriptor, VOTING, PROBES, COMPARED, &mut scratch);
            let shown = near
                .iter()
                .filter_map(|n| self.points.get(n.point as usize));
            for o in shown.flat_map(|p| &p.observations) {
                if let Some(votes) = votes.get_mut(o.image).filter(|_| o.image != image) {
                    *votes += 1;
                }
            }
        }
        let most = votes
            .iter()
            .enumerate()
            .rev()
            .max_by_key(|(_, votes)| **votes)?;
        (*most.1 > 0).then_some(most.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::{Features, Keypoint};
    use crate::hd_map::PointObservation;

    /// A tenth of the images under each other's poses was PASS, and of half of them the median had no observation.
    #[test]
    fn a_tenth_of_the_images_under_other_poses_is_named() {
        let keypoint = Keypoint {
            pixel: [0.0; 2],
            scale_px: 1.0,
            angle_rad: 0.0,
            response: 0.1,
        };
        let images: Vec<KeyframeImage> = (0..40)
            .map(|keyframe| KeyframeImage {
                keyframe,
                camera: "cam0".to_owned(),
                features: Features {
                    keypoints: vec![keypoint; 300],
                    descriptors: vec![[0; 128]; 300],
                },
            })
            .collect();
        let points = |strange: usize| -> Vec<MapPoint> {
            let point = |i: usize| {
                let observation = |k: usize| PointObservation {
                    image: strange + (i + k) % (40 - strange),
                    keypoint: 0,
                };
                MapPoint {
                    point_in_world: Vector3::zeros(),
                    observations: (0..4).map(observation).collect(),
                    reprojection_rms_px: 0.5,
                }
            };
            (0..2000).map(point).collect()
        };
        let strange = |images: &[KeyframeImage], points: &[MapPoint]| {
            let few = Counts::of(images, points).below(LEAST_SHARE);
            strangeness(few.len(), images.len())
        };
        assert_eq!(strange(&images, &points(0)), None);
        assert_eq!(strange(&images, &points(1)), None);
        for wrong in [4, 20, 30] {
            let said = strange(&images, &points(wrong)).expect("named");
            assert!(said.starts_with(&format!("{wrong} of 40 images")), "{said}");
        }
        // Images that show nothing are no strangers.
        let mut black = images.clone();
        black[..4]
            .iter_mut()
            .for_each(|i| i.features = Features::default());
        assert_eq!(strange(&black, &points(4)), None);
        assert_eq!(strange(&[], &[]), None);
    }
}
