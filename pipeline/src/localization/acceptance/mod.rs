//! What speaks for a pose, and how probable that makes it.
//!
//! Inliers after guided matching prove little: the map was projected with the pose that they are to prove, and refined on what was
//! found there, so that images of other places gather 30 of them and more. What is counted here was not searched for with the pose:
//!
//! - **First matches**, paired by look before there was a pose. A wrong pair agrees with a pose by chance with a probability that is
//!   measured on pairs of one match's pixel and another's point; from that follows how many poses with so many inliers are to be
//!   expected of matches that are all wrong (a-contrario; Moisan and Stival, IJCV 2004).
//! - **Decoys**: what guided matching finds where the points are not.
//! - **Spread** of the inliers over the image, of those of guided matching and of the first ones.
//! - **The rival**: the best pose that contradicts this one, of another place that looks the same.
//! - **The twin**: where little speaks for a pose, the best pose elsewhere by what each feature may show besides what it shows here. First matches take the
//!   point that looks most like a feature, so that of two doors that are the same one has them all.
//! - **The mirror**: the best pose with left and right exchanged, and how much each first match says for the pose: features of a network
//!   know no left and right, and parts that look alike agree with poses of their own.
//! - **Other focal lengths**: the factor with which most first matches agree. Where that is another than 1 for sure, the pose is refused
//!   whatever its probability.
//!
//! What is known of the pose beforehand (`prior`) counts with the first matches: fewer of the poses by chance agree with it.
//!
//! [`Evidence::probability`] is the product of six: a logistic regression on the first three kinds, fitted with a ridge of 0.03 in
//! units of their standard deviations; the chance that no such pose is expected of wrong matches; that they are not wrong together, as many
//! as they are and as few; the chances that the rival is wrong and the twin. Right means the right view of the right place, within 0.5 m and 10° (outdoors 1 m): how exact it is says the covariance.
//! `benches/localization/fit.py` fitted the weights on 472 queries of `examples/localization_acceptance` in the maps of
//! `hololens_office`, `sevenscenes_redkitchen` and `strecha_fountain_P11_half`: images left out, turned, halved, thinned to a tenth and
//! a thirtieth of their features, mirrored, and of other places. Fitted on the office alone, they accept none of the other maps' 138
//! mirrored images and images of other places and miss none of 58 views of their own; fitted on the kitchen alone, none of 138 and
//! none of 126.

mod first_matches;

use lsfb_geometry::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

use super::prior::DECADES_OF_UP;
use crate::features::Feature;
pub(super) use first_matches::{Agreement, FirstMatches};

/// What speaks for a pose: figures that chance, or the search for the pose itself, does not reach.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// Features paired with map points by their look alone, each point and each spot of the image once.
    pub first_matches: usize,
    /// Those of them that agree with the pose.
    pub first_inliers: usize,
    /// Probability that a pair which is wrong agrees with the pose all the same: measured on pairs of the one's pixel and
    /// another's point.
    pub chance_level: f64,
    /// Decimal logarithm of the number of poses expected to have as many inliers by chance alone, among all poses that
    /// the matches can be asked for.
    pub log10_false_alarms: f64,
    /// Decimal logarithm of the share of those that agree with what was known of the pose beforehand; 0 where nothing was.
    pub known_decades: f64,
    /// Inliers after guided matching: of the points projected with the pose.
    pub guided_inliers: usize,
    /// Inliers that the same matching finds where the points are not: projected aside, the mean of four directions.
    pub decoy_inliers: f64,
    /// How much of the image the guided inliers are spread over: 1 as evenly as can be, 0 in a point or on a line.
    pub image_spread: f64,
    /// The same of the first inliers: a thing that was carried elsewhere, or stands in another place as well, is found in its part of the
    /// image alone, while points projected with its pose are found by chance all over.
    pub first_spread: f64,
    /// Factor of the focal lengths that fits the matches best.
    pub focal_scale: f64,
    /// Standard deviation of its logarithm; infinite where the matches do not tell.
    pub focal_log_sigma: f64,
    /// By how many decades fewer poses are expected by chance with that factor than with the focal lengths as they are given.
    pub focal_decades: f64,
    /// [`Evidence::log10_false_alarms`] of the best pose with left and right of the images exchanged, which no camera shows.
    pub log10_false_alarms_mirrored: f64,
    /// Decades below one false alarm, for each first match and times their spread, that matches of this feature reach which are wrong
    /// together.
    pub decades_together: f64,
    /// First inliers of the best pose that contradicts this one and is not to be expected by chance either.
    pub rival_inliers: usize,
    /// Inliers after guided matching of the best pose elsewhere, where one was looked for: in what features may show besides what they
    /// show here. Only of poses that little speaks for.
    pub twin_inliers: usize,
}

/// Spread of pixels over an image of this size: the root of the determinant of their covariance over that of an even
/// distribution, 1 at most.
pub(super) fn image_spread(pixels: &[Vector2<f64>], width: u32, height: u32) -> f64 {
    if pixels.is_empty() {
        return 0.0;
    }
    let count = pixels.len() as f64;
    let mean = pixels.iter().sum::<Vector2<f64>>() / count;
    let covariance: Matrix2<f64> = pixels
        .iter()
        .map(|p| (p - mean) * (p - mean).transpose())
        .sum::<Matrix2<f64>>()
        / count;
    let even = f64::from(width) * f64::from(height) / 12.0;
    (covariance.determinant().max(0.0).sqrt() / even.max(1.0)).min(1.0)
}

/// Weights of the evidence in the logit of the probability; see the head of this module.
struct Weights {
    constant: f64,
    /// Of decades below one false alarm.
    false_alarms: f64,
    /// Of the logarithm of guided inliers to decoys.
    decoys: f64,
    /// Of the spread over the image.
    spread: f64,
}

const WEIGHTS: Weights = Weights {
    constant: -10.461,
    false_alarms: 0.785,
    decoys: 1.975,
    spread: 24.539,
};

/// Decades below one false alarm, for each first match and times the spread of those that agree, that matches reach which are wrong
/// together: a network's features know no left and right, and find what is built alike more often than SIFT. Pictures that hang in another
/// room too reach 0.02 with SIFT, where right poses have 0.08 and more (the kitchen of 7-Scenes); mirrored images
/// reach 0.06 with ALIKED, where right poses have 0.7.
pub(super) fn decades_together(feature: &Feature) -> f64 {
    match feature {
        Feature::Sift => 0.028,
        Feature::Learned(_) => 0.075,
    }
}

/// Guided inliers and decades below one false alarm, added up, of one thing that is the same in two places: twice as many are needed. In a bare
/// corridor with the same doors at either end 46 poses of the wrong end have 42 at most, of 5 941 right poses in nine places
/// 0.5 % have fewer than 43 (the standard trial, seed 46).
const OF_ONE_THING: f64 = 20.0;

/// Below this sum a pose is looked for elsewhere: in bare corridors with the same doors at either end wrong poses of whole walks have 30 to 130.
const THIN: f64 = 200.0;

/// A twin with this share of the pose's guided inliers makes it one half; with 0.7, 0.99. Of wrong poses in those corridors 95 % have a twin with more than 0.76, of right ones in the office of HoloLens one in 59.
const TWIN_SHARE: f64 = 1.5;
/// With a twin alone a pose is doubtful below this.
const LEAST_WITH_TWIN: f64 = 0.99;

/// Focal lengths may be off by this much, as a logarithm: what is left of calibrations, and of maps that are not quite in scale.
pub(super) const MAX_LOG_FOCAL: f64 = 0.05;
/// Others fit better for sure where they are this many standard deviations away, and this many decades less by chance.
const SURE_SIGMAS: f64 = 3.0;
const SURE_DECADES: f64 = 3.0;
/// Or by so much, with so many decades less by chance, whatever their standard deviation: of right images in the office and the kitchen none
/// has 12 decades and more than 0.026, of images that are a tenth off 3 of 86 have 17 to 46 decades and 0.05 to 0.11 at up to 0.07.
const FAR_LOG_FOCAL: f64 = 0.035;
const FAR_DECADES: f64 = 12.0;

impl Evidence {
    /// Probability that the pose is right: that of the evidence, of the search not having reached it by chance, and of the rival
    /// not being the right one.
    pub fn probability(&self) -> f64 {
        let (guided, decoys) = (self.guided_inliers as f64, self.decoy_inliers);
        // Each kind of evidence is bounded: none can do without the others.
        let logit = WEIGHTS.constant
            + WEIGHTS.false_alarms * (-self.false_alarms_as_known()).clamp(-10.0, 20.0)
            + WEIGHTS.decoys * ((guided + 1.0) / (decoys + 1.0)).ln().clamp(0.0, 2.0)
            + WEIGHTS.spread * self.image_spread.min(0.4);
        let of_evidence = 1.0 / (1.0 + (-logit).exp());
        let no_chance = 1.0 / (1.0 + 10f64.powf(self.false_alarms_as_known()));
        of_evidence
            * no_chance
            * self.probability_against_likeness()
            * self.probability_against_sameness()
            * self.probability_against_rival()
            * self.probability_against_twin()
    }

    /// Decimal logarithm of the false alarms that agree with what was known.
    fn false_alarms_as_known(&self) -> f64 {
        self.log10_false_alarms + self.known_decades
    }

    /// Against matches that are wrong together: parts that look alike in a mirror, in a row or in another room agree with a pose of their
    /// own, so many of so few at that, however unlikely that were of each alone; but all that lies around them does not agree. And
    /// against a mirror, which explains them better.
    fn probability_against_likeness(&self) -> f64 {
        let decades = -self.false_alarms_as_known() / self.first_matches.max(1) as f64;
        let decades = decades * self.first_spread;
        let together = against(self.decades_together / decades.max(1e-9));
        let by_mirror = self.log10_false_alarms - self.log10_false_alarms_mirrored;
        together / (1.0 + 10f64.powf(by_mirror))
    }

    /// Against one thing that is the same in two places, a door with its frame and sign: its matches agree with a pose as right ones do, without
    /// any that does not, where nothing else is in the image. But one thing has few features. What is known of the pose beforehand speaks
    /// against the other place; which way is up does not.
    fn probability_against_sameness(&self) -> f64 {
        let strength = self.strength().max(1e-9);
        let not_in_this_place = 10f64.powf((self.known_decades + DECADES_OF_UP).min(0.0));
        1.0 / (1.0 + not_in_this_place * (OF_ONE_THING / strength).powi(6))
    }

    /// Whether the matches surely fit another focal length than the cameras are said to have.
    pub fn contradicts_focal_length(&self) -> bool {
        let off = self.focal_scale.ln().abs();
        let surely = off > MAX_LOG_FOCAL
            && off > SURE_SIGMAS * self.focal_log_sigma
            && self.focal_decades > SURE_DECADES;
        surely || (off > FAR_LOG_FOCAL && self.focal_decades > FAR_DECADES)
    }

    /// Guided inliers and decades below one false alarm, added up.
    fn strength(&self) -> f64 {
        self.guided_inliers as f64 - self.log10_false_alarms
    }

    /// Whether so little speaks for the pose that things alike in two places may be all of it: then it is looked for elsewhere in the map. Of
    /// places that are not in the map nothing can be told.
    pub fn is_thin(&self) -> bool {
        self.strength() < THIN
    }

    /// One half where the rival has as many inliers, 0.98 where it has half of them.
    fn probability_against_rival(&self) -> f64 {
        against(self.rival_inliers as f64 / self.first_inliers.max(1) as f64)
    }

    /// Whether the twin alone makes the pose doubtful.
    pub(super) fn is_doubtful_by_twin(&self) -> bool {
        self.probability_against_twin() < LEAST_WITH_TWIN
    }

    /// Below 0.99 where the twin has 0.7 times as many guided inliers: some are found wherever points are looked for.
    fn probability_against_twin(&self) -> f64 {
        let share = self.twin_inliers as f64 / self.guided_inliers.max(1) as f64;
        against(share / TWIN_SHARE)
    }
}

/// Probability against an explanation that has this share of what a pose has.
fn against(share: f64) -> f64 {
    1.0 / (1.0 + share.powi(6))
}

#[cfg(test)]
mod tests;
