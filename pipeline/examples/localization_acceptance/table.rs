//! What became of the queries, as a table to read and as one to compute with.

use std::fmt::Write;

use lsfb_geometry::Vector6;
use lsfb_pipeline::localization::{Localization, NotLocalized};

use crate::disturbances::Query;
use crate::places::Place;

/// What became of one query.
pub struct Row {
    pub feature: String,
    pub place: &'static str,
    pub kind: String,
    pub image: String,
    pub outcome: Outcome,
}

/// The localizer's answer beside the truth.
pub struct Outcome {
    pub accepted: bool,
    /// Distance and angle from the truth, metres and degrees; `None` without pose or truth.
    pub error: Option<(f64, f64)>,
    pub right: bool,
    /// Squared error in units of the stated covariance, of six degrees of freedom; NaN without truth.
    pub normalized_squared: f64,
    /// The best pose, accepted or not.
    pub best: Option<Localization>,
}

impl Outcome {
    pub fn new(found: &Result<Localization, NotLocalized>, query: &Query, place: &Place) -> Self {
        let best = found.as_ref().map_or_else(NotLocalized::best, Some);
        let pose = best.map(|found| found.world_from_rig);
        let off = pose.zip(query.world_from_rig);
        let off = off.map(|(found, truth)| found.inverse() * truth);
        let error = off.map(|off| {
            let angle_deg = off.rotation.angle().to_degrees();
            (off.translation.norm(), angle_deg)
        });
        let information = best.and_then(|found| found.covariance.try_inverse());
        let normalized = off.zip(information).map(|(off, information)| {
            let tangent: Vector6<f64> = off.log();
            tangent.dot(&(information * tangent))
        });
        Self {
            accepted: found.is_ok(),
            error,
            right: error.is_some_and(|(m, deg)| m <= place.right_m && deg <= 5.0),
            normalized_squared: normalized.unwrap_or(f64::NAN),
            best: best.cloned(),
        }
    }
}

/// Squared errors in units of the covariance, of six degrees of freedom: 95 of 100 are smaller (χ²).
const COVERED: f64 = 12.592;

impl Outcome {
    /// Whether the truth lies in the region of 95 % of the stated covariance.
    fn is_covered(&self) -> bool {
        self.normalized_squared <= COVERED
    }
}

impl Row {
    fn key(&self) -> [&str; 3] {
        [&self.feature, self.place, &self.kind]
    }
}

/// A line for each kind of query in each map: *covered* is the share of accepted poses whose error lies in the region of 95 %.
pub fn summary(rows: &[Row]) -> String {
    let mut kinds: Vec<[&str; 3]> = Vec::new();
    for row in rows {
        if !kinds.contains(&row.key()) {
            kinds.push(row.key());
        }
    }
    let mut text = format!(
        "{:8} {:10} {:24} {:>7} {:>8} {:>6} {:>6} {:>10} {:>8} {:>8}\n",
        "feature",
        "map",
        "images",
        "queries",
        "accepted",
        "right",
        "wrong",
        "median m",
        "deg",
        "covered"
    );
    for key in kinds {
        let here: Vec<&Outcome> = rows
            .iter()
            .filter(|r| r.key() == key)
            .map(|r| &r.outcome)
            .collect();
        let accepted = here.iter().filter(|o| o.accepted).count();
        let right = here.iter().filter(|o| o.accepted && o.right).count();
        let errors = |pick: fn(&(f64, f64)) -> f64| {
            let accepted = here.iter().filter(|o| o.accepted);
            let mut values: Vec<f64> = accepted
                .filter_map(|o| o.error.as_ref().map(pick))
                .collect();
            values.sort_by(f64::total_cmp);
            let median = values.get(values.len() / 2);
            median.map_or("-".to_owned(), |m| format!("{m:.4}"))
        };
        let covered = here.iter().filter(|o| o.accepted && o.is_covered()).count();
        let covered = match accepted {
            0 => "-".to_owned(),
            _ => format!("{:.2}", covered as f64 / accepted as f64),
        };
        let [feature, place, kind] = key;
        let _ = writeln!(
            text,
            "{feature:8} {place:10} {kind:24} {:7} {accepted:8} {right:6} {:6} {:>10} {:>8} {covered:>8}",
            here.len(),
            accepted - right,
            errors(|e| e.0),
            errors(|e| e.1),
        );
    }
    text
}

/// One line for each query.
pub fn csv(rows: &[Row]) -> String {
    let mut text = "feature,place,kind,image,accepted,right,distance_m,angle_deg,normalized_squared,probability,votes,\
                    first_matches,first_inliers,chance_level,log10_false_alarms,guided_inliers,decoy_inliers,\
                    image_spread,first_spread,rival_inliers,twin_inliers,rms_px,focal_scale,focal_log_sigma,focal_decades,log10_false_alarms_mirrored,sigma_m\n"
        .to_owned();
    for row in rows {
        let outcome = &row.outcome;
        let (distance_m, angle_deg) = outcome.error.unwrap_or((f64::NAN, f64::NAN));
        let _ = write!(
            text,
            "{},{},{},{},{},{},{distance_m},{angle_deg},{}",
            row.feature,
            row.place,
            row.kind.replace(',', ""),
            row.image,
            u8::from(outcome.accepted),
            u8::from(outcome.right),
            outcome.normalized_squared,
        );
        if let Some(best) = &outcome.best {
            let e = &best.evidence;
            let _ = write!(
                text,
                ",{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{}",
                best.probability,
                best.votes,
                e.first_matches,
                e.first_inliers,
                e.chance_level,
                e.log10_false_alarms,
                e.guided_inliers,
                e.decoy_inliers,
                e.image_spread,
                e.first_spread,
                e.rival_inliers,
                e.twin_inliers,
                best.reprojection_rms_px,
                e.focal_scale,
                e.focal_log_sigma,
                e.focal_decades,
                e.log10_false_alarms_mirrored,
                best.covariance.fixed_view::<3, 3>(3, 3).trace().sqrt(),
            );
        }
        text.push('\n');
    }
    text
}
