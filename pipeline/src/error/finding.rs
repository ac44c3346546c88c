//! Refusals as findings: the name of the check, what it is about, the number that was judged, and what to do.

use std::path::Path;

use lsfb_types::{Finding, Limit, Verdict};

use super::refusal::{Refusal, each};

/// What is about all of the data.
const EVERYTHING: &str = "";

impl Refusal {
    /// As every command says it. Where a result that is used with care has a finding of the same, the code is that one's.
    pub fn finding(&self) -> Finding {
        let of = |code: &'static str, subject: &str| {
            Finding::new(code, Verdict::Fail, subject, self.to_string())
        };
        let at = |code: &'static str, path: &Path| of(code, &path.display().to_string());
        match self {
            Self::NotLocalized {
                path,
                localized,
                needed,
                ..
            } => at("localized", path)
                .value(*localized as f64, "")
                .limit(Limit::AtLeast(*needed as f64))
                .remedy("check that it is the map of this place, and the rig file of this device"),
            Self::MapDisagrees {
                path,
                rejected,
                most,
                ..
            } => at("contradicted", path)
                .value(*rejected as f64, "")
                .limit(Limit::AtMost(*most as f64))
                .remedy(
                    "check that it is the map of this place, and that the cameras and the IMU of the rig file belong to this device",
                ),
            Self::AmbiguousPlace {
                path,
                agreeing,
                rival,
                margin,
            } => at("ambiguous-place", path)
                .value(*rival as f64, "")
                .limit(Limit::AtMost((*agreeing as f64 / margin).floor()))
                .remedy(
                    "extend the walk to a place that is unique, or map the other place too: the map has places that look alike, and this walk does not distinguish them",
                ),
            Self::LooksAlike {
                path,
                matches_here,
                matches_there,
                margin,
                ..
            } => at("looks-alike", path)
                .value(*matches_there as f64, "")
                .limit(Limit::AtMost((*matches_here as f64 / margin).floor()))
                .remedy(format!(
                    "extend the walk to a place that is unique: the map has places that look alike, and this walk does not distinguish them (min_place_margin is {margin})"
                )),
            Self::PointsAbsent {
                path,
                absent_percent,
                limit,
                ..
            } => crossed(
                at("points-absent", path).value(*absent_percent, "%"),
                percent(*limit),
            )
            .remedy(
                    "map it again, or raise max_absent_share if no other place looks like it: the place has changed since it was mapped, or it is another place built alike, such as another floor",
                ),
            Self::FewRecognised {
                path,
                recognised,
                frames,
                needed_share,
                ..
            } => at("not-recognised", path)
                .value(*recognised as f64, "")
                .limit(Limit::AtLeast((needed_share * *frames as f64).ceil()))
                .remedy(
                    "check that it is the map of this place, and map it along the walk: this is another place that has something in common with the map, or the map covers too little of the walk (min_recognised_share)",
                ),
            Self::MapPartsDisagree {
                path,
                moved_m,
                limit_m,
                ..
            } => crossed(
                at("map-parts-disagree", path).value(*moved_m, "m"),
                *limit_m,
            )
            .remedy(
                "map the place again with more views of it, or walk where more of the map is in view: the map is poor here, or the place has changed since it was mapped (max_disagreement_m is the limit of each pose)",
            ),
            Self::ImuContradicts {
                path,
                moved_m,
                failures,
                ..
            } => at("imu-contradicts", path).value(*moved_m, "m").remedy(each(
                failures,
                |failed| failed.remedy.as_deref(),
            )),
            Self::AccelContradicts { path, .. } => at("accel-axes", path).remedy(
                "check the accelerometer's axes, their signs and units, and the IMU's pose in the rig file",
            ),
            Self::GyroContradicts { .. } => of("gyro-axes", "IMU").remedy(
                "check the IMU's axes, their signs and units, and the camera poses on the IMU in the rig file",
            ),
            Self::TracksContradict { share, limit } => of("tracks-contradict", EVERYTHING)
                .value(100.0 * share, "%")
                .limit(Limit::AtMost(percent(*limit)))
                .remedy(
                    "check the IMU's axes and units, the cameras' lenses and poses on the IMU, and both clocks",
                ),
            Self::FrozenSensor { secs, .. } => of("frozen-samples", "IMU")
                .value(*secs, "s")
                .remedy("check the IMU and its driver, and record again"),
            Self::ImuGap {
                from,
                to,
                longest_secs,
            } => crossed(
                of("imu-pause", "IMU").value(to.secs_since(*from), "s"),
                *longest_secs,
            )
            .remedy("record the IMU without gaps"),
            Self::ImuMissing { .. } => of("imu-missing", "IMU").remedy(
                "start the odometry without the IMU, or with scans that the IMU covers",
            ),
            Self::NoImuTerm { path, .. } => at("no-imu", path).remedy(
                "map a recording that has an IMU with a rig file that states its noise, or set imu = false",
            ),
            Self::NothingCertain { path, limit_m, .. } => Finding {
                unit: "m",
                ..at("uncertain", path)
            }
            .limit(Limit::AtMost(*limit_m))
            .remedy(
                "walk where more of the map is in view, or raise the limit (max_position_sigma_m; attitudes to 1.1°)",
            ),
            Self::NothingFollowed { limit_m, .. } => Finding {
                unit: "m",
                ..of("not-followed", EVERYTHING)
            }
            .limit(Limit::AtMost(*limit_m))
            .remedy("light the place, keep the lenses free, and look at objects with texture, or raise the limit (max_position_sigma_m)"),
            Self::NoBeginning { .. } => of("no-beginning", EVERYTHING).remedy(
                "begin at rest for half a second, or move by at least a hand's breadth while something with texture is in view",
            ),
            Self::UnknownCovariance { .. } => {
                of("unknown-covariance", EVERYTHING).remedy("check the IMU's noise in the rig file")
            }
            Self::NotConverged { stage, iterations } => of("not-converged", stage)
                .value(*iterations as f64, "")
                .remedy(
                    "raise solve.max_iterations, and check IMU axes, time stamps and intrinsics of the rig file",
                ),
            Self::FailedMap { .. } => of("failed-map", "map").remedy(
                "fix that and map the place again, or set accept_failed_map if it does not matter",
            ),
            Self::FailedAlone { path, failed } => Finding {
                code: failed.code.clone(),
                value: failed.value,
                sigma: failed.sigma,
                unit: failed.unit,
                limit: failed.limit,
                ..at("", path)
            }
            .remedy(
                failed
                    .remedy
                    .as_deref()
                    .unwrap_or("solve the other walks without it"),
            ),
            Self::MapsDoNotMeet { .. } => of("maps-apart", EVERYTHING).remedy(
                "check that both are in the same unit, merge maps that overlap more, or whose overlap does not look like another place",
            ),
            Self::SurveysDisagree { shift_m, most_m } => of("surveys-disagree", EVERYTHING)
                .value(*shift_m, "m")
                .limit(Limit::AtMost(*most_m))
                .remedy(
                    "check that both surveys use one frame, and the control points of both maps",
                ),
            Self::SameImages { points, .. } => of("same-images", EVERYTHING)
                .value(*points as f64, "")
                .remedy("merge maps of different recordings, and crop a map from the whole one"),
            Self::MapErrorUnknown { .. } => of("map-error-unknown", "map")
                .remedy("make the map from more images, or crop a larger part"),
            Self::MapBudget {
                camera,
                points,
                needed,
                smallest_mb,
                ..
            } => of("map-size", camera)
                .value(*points as f64, "")
                .limit(Limit::AtLeast(*needed as f64))
                .remedy(format!(
                    "give {smallest_mb:.2} MB or more, crop the map, or lower fewest_points_per_view"
                )),
            Self::TooFewPoints {
                points,
                needed,
                reason,
            } => of("few-points", EVERYTHING)
                .value(*points as f64, "")
                .limit(Limit::AtLeast(*needed as f64))
                .remedy(reason.remedy()),
            Self::StartElsewhere { path, share, least } => at("start-elsewhere", path)
                .value(100.0 * share, "%")
                .limit(Limit::AtLeast(percent(*least)))
                .remedy("give the trajectory of this recording"),
            Self::NoScan { path, why, .. } => at("no-scans", path).remedy(match why {
                Some(_) => "give ranges in metres, or limits of range for this LiDAR",
                None => "check the LiDAR and its clock against the IMU's",
            }),
            Self::EmptyScan { .. } => of("empty-scan", EVERYTHING)
                .remedy("check whether the sensor was covered, and its power"),
            Self::ScanOrder { .. } => of("scan-order", EVERYTHING).remedy("sort the scans by time"),
            Self::TooFewScans { scans } => of("few-scans", EVERYTHING)
                .value(*scans as f64, "")
                .limit(Limit::AtLeast(2.0))
                .remedy("give scans that overlap"),
            Self::NoImages { path, .. } => at("no-images", path)
                .remedy("record with the cameras on, or give the rig of this device"),
            Self::NoKeyframe { path } => {
                at("no-keyframe", path).remedy("compare the cameras' clock with the LiDAR's")
            }
            Self::FewControlPoints {
                clicked, needed, ..
            } => of("control-points", "control points")
                .value(*clicked as f64, "")
                .limit(Limit::AtLeast(*needed as f64))
                .remedy(
                    "click marks that are not on one line: with one, the map could rotate about it, with two, about the line through both",
                ),
            Self::ControlPointsOnALine { width_m, .. } => of("control-points", "control points")
                .value(*width_m, "m")
                .remedy("survey and click a mark away from it"),
            Self::FewDescriptors { count, needed } => of("few-descriptors", EVERYTHING)
                .value(*count as f64, "")
                .limit(Limit::AtLeast(*needed as f64))
                .remedy("give more images, or use fewer words"),
        }
    }
}

/// A share in percent, without the digits that only its binary form has.
fn percent(share: f64) -> f64 {
    (1e6 * share).round() / 1e4
}

/// With the limit, where the value lies beyond it: what is said of a walk as a whole may keep what each of its parts crosses.
fn crossed(finding: Finding, limit: f64) -> Finding {
    match finding.value.is_some_and(|value| value > limit) {
        true => finding.limit(Limit::AtMost(limit)),
        false => finding,
    }
}
