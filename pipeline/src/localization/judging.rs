//! The best pose of a query judged: what speaks for it, and how far it may be off.

use super::acceptance::{Agreement, Evidence, decades_together, image_spread};
use super::focal_length::{FocalFit, fit_focal_length, other_focal_lengths};
use super::given_poses::{OWN_PER_MAP_ERROR, pose_among_given};
use super::guided_matching::Query;
use super::localizer::{Found, Hypothesis, Localizer};
use super::matches::{PointMatch, PosedMatches};
use super::outcome::Localization;
use super::ransac::estimate_pose;
use super::shared_errors::shared_covariance;

/// The largest spread of matches over any of the images.
fn largest_spread(query: &Query, matches: &[PointMatch]) -> f64 {
    let spreads = query.cameras.iter().enumerate().map(|(index, mounted)| {
        let here = matches.iter().filter(|m| m.camera == index);
        let pixels: Vec<_> = here.map(|m| m.pixel).collect();
        image_spread(&pixels, mounted.camera.width, mounted.camera.height)
    });
    spreads.fold(0.0, f64::max)
}

/// The focal lengths that fit best, as evidence has them.
struct FocalEvidence {
    scale: f64,
    log_sigma: f64,
    decades: f64,
}

impl Localizer {
    /// The pose with its evidence and covariance; `None` where its matches do not determine it.
    pub(super) fn judge(&self, found: Found, query: &Query) -> Option<Localization> {
        let pose = &found.hypothesis.pose;
        let resolved = query.resolve(&pose.matches);
        let near = self.near_focal_length(&found.hypothesis, query, &resolved);
        let evidence = self.evidence(&found, query, &resolved, near);
        let posed = PosedMatches {
            cameras: query.cameras,
            matches: &resolved,
            world_from_rig: &pose.world_from_rig,
            huber_px: self.config.ransac.refinement.huber_px,
        };
        let log_focal = near.map_or((0.0, 0.0), |fit| (fit.log_scale, fit.log_sigma));
        let among_given = pose_among_given(query, pose, &self.map_error);
        // The given poses next to it are in the pose among them.
        let of_map = match among_given {
            Some(_) => self.map_error.scaled(OWN_PER_MAP_ERROR),
            None => self.map_error,
        };
        let shared = shared_covariance(&posed, log_focal, &of_map)?;
        let pose = found.hypothesis.pose;
        let (world_from_rig, covariance) = match among_given {
            Some(among) => (among.world_from_rig, among.covariance),
            None => (pose.world_from_rig, pose.covariance),
        };
        Some(Localization {
            world_from_rig,
            covariance: covariance + shared,
            matches: pose.matches,
            reprojection_rms_px: pose.reprojection_rms_px,
            votes: found.hypothesis.votes,
            evidence,
            probability: evidence.probability(),
        })
    }

    fn evidence(
        &self,
        found: &Found,
        query: &Query,
        resolved: &[PointMatch],
        near: Option<FocalFit>,
    ) -> Evidence {
        let Found {
            hypothesis, places, ..
        } = found;
        let (pose, agreement) = (&hypothesis.pose, &hypothesis.agreement);
        let first = &hypothesis.first;
        let first = first.agreeing(query.cameras, &pose.world_from_rig, agreement.tolerance_px);
        let focal = self.focal_length(found, query, near);
        Evidence {
            first_matches: agreement.matches,
            first_inliers: agreement.inliers,
            chance_level: agreement.chance_level,
            log10_false_alarms: agreement.log10_false_alarms(*places),
            known_decades: found.known_decades,
            guided_inliers: pose.matches.len(),
            decoy_inliers: query.decoy_inliers(&hypothesis.points, pose, &self.guided()),
            image_spread: largest_spread(query, resolved),
            first_spread: largest_spread(query, &first),
            focal_scale: focal.scale,
            focal_log_sigma: focal.log_sigma,
            focal_decades: focal.decades,
            log10_false_alarms_mirrored: self.false_alarms_mirrored(found, query),
            decades_together: decades_together(self.map.feature()),
            rival_inliers: found.rival_inliers,
            twin_inliers: 0,
        }
    }

    /// Decimal logarithm of the false alarms of the best pose with left and right exchanged.
    fn false_alarms_mirrored(&self, found: &Found, query: &Query) -> f64 {
        let ransac = &self.config.ransac;
        let mirrored = found.hypothesis.first.mirrored(query.cameras);
        let estimate = estimate_pose(query.cameras, mirrored.matches(), ransac);
        let none = Agreement::none(mirrored.matches().len());
        let agreement = estimate.map_or(none, |e| {
            mirrored.agreement(query.cameras, &e.world_from_rig, ransac.max_error_px)
        });
        agreement.log10_false_alarms(found.places)
    }

    /// The focal lengths to which the pose and its matches lead.
    fn near_focal_length(
        &self,
        hypothesis: &Hypothesis,
        query: &Query,
        resolved: &[PointMatch],
    ) -> Option<FocalFit> {
        let mut all = resolved.to_vec();
        all.extend(hypothesis.first.matches());
        let given = (&hypothesis.pose.world_from_rig, 1.0);
        fit_focal_length(query.cameras, &all, given, &self.config.ransac)
    }

    /// The focal lengths with which most first matches agree, wherever the search for them began.
    fn focal_length(&self, found: &Found, query: &Query, near: Option<FocalFit>) -> FocalEvidence {
        let (hypothesis, ransac) = (&found.hypothesis, &self.config.ransac);
        let first = &hypothesis.first;
        let others = other_focal_lengths(query.cameras, first.matches(), ransac);
        let false_alarms = |fit: &FocalFit| {
            let (cameras, pose) = (fit.cameras(query.cameras), &fit.world_from_rig);
            let agreement = first.agreement(&cameras, pose, ransac.max_error_px);
            agreement.log10_false_alarms(found.places)
        };
        let fits = near.into_iter().chain(others);
        let best = fits
            .map(|fit| (false_alarms(&fit), fit))
            .min_by(|(a, _), (b, _)| a.total_cmp(b));
        let as_given = hypothesis.agreement.log10_false_alarms(found.places);
        best.map_or(
            FocalEvidence {
                scale: 1.0,
                log_sigma: f64::INFINITY,
                decades: 0.0,
            },
            |(false_alarms, fit)| FocalEvidence {
                scale: fit.log_scale.exp(),
                log_sigma: fit.log_sigma,
                decades: as_given - false_alarms,
            },
        )
    }
}
