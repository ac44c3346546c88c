//! What all images of one camera say together of its focal length.
//!
//! A camera has one focal length in all of its images, and what misleads one of them does not mislead most: points of a map that are off
//! fit any focal length somewhat better somewhere (in the kitchen of 7-Scenes up to 1.26 ± 0.05 times the right one), and a view of a wall
//! says nothing of one that is a tenth off. The weighted median of what the images find is neither's prey.

use std::fmt;

use super::acceptance::Evidence;

/// Factor of the focal lengths that most images of a camera find.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointFocalLength {
    /// Natural logarithm of the factor.
    pub log_scale: f64,
    /// Its standard deviation, by how far the images are from one another.
    pub log_sigma: f64,
    /// Images that say so.
    pub images: usize,
}

/// What all images say of one of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FocalLengthDecision {
    /// It was taken with another focal length, as all were.
    Refused,
    /// Its own focal length is no reason to refuse it.
    Borne,
    /// No more than it says itself.
    AsAlone,
}

/// Fewer images say no more together than alone.
const FEWEST_IMAGES: usize = 5;
/// Images that may be of another place, or hardly know their focal length, have no say.
const PROBABLE: f64 = 0.9;
const MAX_LOG_SIGMA: f64 = 0.1;
/// What the logarithm of one image is off by besides its own standard deviation.
const MAP_LOG_SIGMA: f64 = 0.02;
/// Standard deviations of the median in units of the mean's, and of normal deviates in units of their median length.
const MEDIAN_PER_MEAN: f64 = 1.2533;
const SIGMA_PER_MEDIAN: f64 = 1.4826;
/// A joint focal length is sure where it is this many standard deviations away.
const SURE_SIGMAS: f64 = 3.0;
/// An image is surely by itself another one than its camera's others, resized or cropped: by so many standard deviations,
const ALONE_SIGMAS: f64 = 5.0;
/// by more than any image of the right size was found to be off,
const ALONE_LOG: f64 = 0.288;
/// or by so large a share of all decades that speak for its pose (the kitchen: up to 0.12, half-size images in a frame 0.15 to 4).
const ALONE_SHARE: f64 = 0.15;
/// or by so many decades (the kitchen: up to 10; of the office's images enlarged by a tenth among others as they are, which came out 13 to 28 cm
/// off, five of seven had 32 to 61).
const ALONE_DECADES: f64 = 12.0;

impl JointFocalLength {
    /// Of the evidence of a camera's images; `None` where too few of them tell.
    pub fn of<'a>(evidence: impl IntoIterator<Item = &'a Evidence>) -> Option<Self> {
        let telling = evidence.into_iter().filter(|e| {
            e.focal_log_sigma <= MAX_LOG_SIGMA && e.focal_scale > 0.0 && e.probability() >= PROBABLE
        });
        let mut found: Vec<(f64, f64)> = telling
            .map(|e| {
                let variance = e.focal_log_sigma.powi(2) + MAP_LOG_SIGMA.powi(2);
                (e.focal_scale.ln(), 1.0 / variance)
            })
            .collect();
        let images = found.len();
        if images < FEWEST_IMAGES {
            return None;
        }
        let log_scale = weighted_median(&mut found)?;
        let mut off: Vec<(f64, f64)> = found
            .iter()
            .map(|(log, weight)| ((log - log_scale).abs(), *weight))
            .collect();
        let scatter = (SIGMA_PER_MEDIAN * weighted_median(&mut off)?).max(MAP_LOG_SIGMA);
        Some(Self {
            log_scale,
            log_sigma: MEDIAN_PER_MEAN * scatter / (images as f64).sqrt(),
            images,
        })
    }

    /// Whether the camera has another focal length than is said, for sure.
    pub fn is_another(&self) -> bool {
        let off = self.log_scale.abs();
        off > super::acceptance::MAX_LOG_FOCAL && off > SURE_SIGMAS * self.log_sigma
    }

    /// What this says of an image that was localized by itself, or was not.
    pub fn judge(&self, evidence: &Evidence, localized: bool) -> FocalLengthDecision {
        let alone = evidence.contradicts_focal_length();
        let together = self.contradicts(evidence);
        if together && self.is_another() && (localized || alone) {
            FocalLengthDecision::Refused
        } else if alone && !together {
            FocalLengthDecision::Borne
        } else {
            FocalLengthDecision::AsAlone
        }
    }

    /// Whether an image of this camera is refused for its focal length.
    fn contradicts(&self, evidence: &Evidence) -> bool {
        let alone = evidence.contradicts_focal_length();
        let log = evidence.focal_scale.ln();
        if self.is_another() {
            let sigma = self.log_sigma.hypot(evidence.focal_log_sigma);
            let sigma = sigma.hypot(MAP_LOG_SIGMA);
            return alone || (log - self.log_scale).abs() <= ALONE_SIGMAS * sigma;
        }
        let decades = -evidence.log10_false_alarms;
        let most_decades = ALONE_DECADES.min(ALONE_SHARE * decades);
        alone && (log.abs() > ALONE_LOG || evidence.focal_decades > most_decades)
    }
}

impl fmt::Display for JointFocalLength {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (scale, images) = (self.log_scale.exp(), self.images);
        write!(
            f,
            "the matches of {images} images of the camera fit {scale:.3} ± {:.3} times its focal \
             length: the images were resized or cropped, or taken with another lens; give the \
             intrinsics that belong to them",
            scale * self.log_sigma,
        )
    }
}

/// Sorts by value. `None` of nothing.
fn weighted_median(values: &mut [(f64, f64)]) -> Option<f64> {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = values.iter().map(|(_, weight)| weight).sum::<f64>() / 2.0;
    let mut below = 0.0;
    let middle = values.iter().find(|(_, weight)| {
        below += weight;
        below >= half
    });
    middle.map(|(value, _)| *value)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of an image that finds this factor.
    fn image(focal_scale: f64, focal_log_sigma: f64, focal_decades: f64) -> Evidence {
        Evidence {
            first_matches: 300,
            first_inliers: 90,
            chance_level: 0.001,
            log10_false_alarms: -120.0,
            known_decades: 0.0,
            guided_inliers: 200,
            decoy_inliers: 12.0,
            image_spread: 0.6,
            first_spread: 0.6,
            focal_scale,
            focal_log_sigma,
            focal_decades,
            log10_false_alarms_mirrored: 3.0,
            decades_together: 0.02,
            rival_inliers: 0,
            twin_inliers: 0,
        }
    }

    #[test]
    fn an_image_that_says_little_is_borne_with_its_camera() {
        // The kitchen of 7-Scenes: 22 images near 1, three that were refused though they were placed within 6 cm.
        let right = (0..22).map(|k| image(0.98 + 0.001 * f64::from(k), 0.012, 2.0));
        let doubted = [
            (1.106, 0.030, 9.4),
            (1.259, 0.047, 10.0),
            (0.874, 0.017, 3.2),
        ];
        let doubted = doubted.map(|(scale, sigma, decades)| image(scale, sigma, decades));
        let all: Vec<Evidence> = right.chain(doubted).collect();
        let joint = JointFocalLength::of(&all).expect("enough");
        assert!(!joint.is_another() && joint.images == 25);
        assert!(doubted.iter().all(Evidence::contradicts_focal_length));
        assert!(!all.iter().any(|e| joint.contradicts(e)));
        // One of half the size among them.
        assert!(joint.contradicts(&image(0.5, 0.02, 80.0)));
        assert!(joint.contradicts(&image(0.484, 0.045, 9.8)));
        // One enlarged by a tenth, seen well.
        let enlarged = Evidence {
            log10_false_alarms: -545.0,
            ..image(1.09, 0.01, 54.6)
        };
        assert!(joint.contradicts(&enlarged));
    }

    #[test]
    fn a_camera_that_is_a_tenth_off_is_refused_with_all_its_images() {
        // The office with focal lengths a tenth too short: two of these are borne alone.
        let found = [
            (1.060, 0.015, 5.6),
            (1.086, 0.008, 112.2),
            (1.090, 0.008, 72.2),
            (1.092, 0.008, 47.3),
            (1.097, 0.011, 17.9),
            (1.103, 0.009, 47.9),
            (1.109, 0.009, 37.8),
            (1.111, 0.012, 1.5),
            (1.129, 0.027, -1.2),
        ];
        let all = found.map(|(scale, sigma, decades)| image(scale, sigma, decades));
        assert!(!all.iter().all(Evidence::contradicts_focal_length));
        let joint = JointFocalLength::of(&all).expect("enough");
        assert!(joint.is_another() && all.iter().all(|e| joint.contradicts(e)));
        // Two per cent are borne.
        let near = all.map(|e| image(e.focal_scale / 1.07, e.focal_log_sigma, -1.0));
        let joint = JointFocalLength::of(&near).expect("enough");
        assert!(!near.iter().any(|e| joint.contradicts(e)));
        // An image with the right camera among those of half the size.
        let halves = all.map(|e| image(e.focal_scale / 2.2, e.focal_log_sigma, 90.0));
        let joint = JointFocalLength::of(&halves).expect("enough");
        assert!(halves.iter().all(|e| joint.contradicts(e)));
        assert!(!joint.contradicts(&image(1.01, 0.01, -3.0)));
    }

    #[test]
    fn few_images_say_nothing_together() {
        let four = [image(1.1, 0.01, 30.0); 4];
        assert_eq!(JointFocalLength::of(&four), None);
        let unsure = [image(1.1, 0.3, 30.0); 9];
        assert_eq!(JointFocalLength::of(&unsure), None);
    }
}
