//! What the mapping says about its own result.

use lsfb_types::{Finding, Limit, Verdict};
use serde::{Deserialize, Serialize};

use super::camera_error::CameraError;
use super::control::ControlReport;
use super::inertial::InertialReport;
use super::residuals::{LidarResiduals, RegionResiduals};
use super::scan_offsets::ScanOffsets;
use crate::hd_map::CameraResiduals;
use crate::loops::Closing;
use crate::odometry::{OdometryReport, OdometryWarning};
use crate::surface::Agreement;

/// What the mapping says about its own result.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MappingReport {
    /// The odometry's own report.
    pub odometry: OdometryReport,
    /// What closing loops did to it; absent where that was not asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub loops: Option<Closing>,
    /// Keyframes.
    pub keyframes: u64,
    /// Images of the keyframes.
    pub images: u64,
    /// Features in those images.
    pub features: u64,
    /// Tracks before triangulation.
    pub tracks: u64,
    /// Points in the map.
    pub points: u64,
    /// Observations of those points.
    pub observations: u64,
    /// Observations left out of the map because their point is seen elsewhere; they count in the reprojection error.
    pub dropped_observations: u64,
    /// Root mean square reprojection error with the odometry's poses, pixels, as [`Self::reprojection_rms_px`].
    pub reprojection_rms_before_px: f64,
    /// Median reprojection error with the odometry's poses, pixels.
    pub reprojection_median_before_px: f64,
    /// Root mean square reprojection error, pixels: of the normal distribution that has the median of every observation of every
    /// track that has a point, those left out of the map among them.
    pub reprojection_rms_px: f64,
    /// Median reprojection error of the same observations, pixels.
    pub reprojection_median_px: f64,
    /// Share of them farther off than `max_reprojection_px`: wrong matches, as long as they are few.
    pub outlier_share: f64,
    /// Reprojection error of each of them, pixels; the image's diagonal where a point lies behind the camera.
    #[serde(skip)]
    pub reprojection_errors_px: Vec<f64>,
    /// Residuals of the LiDAR terms with the odometry's poses.
    pub lidar_before: LidarResiduals,
    /// Residuals of the LiDAR terms of the map.
    pub lidar_after: LidarResiduals,
    /// Reprojection errors by camera.
    #[serde(default)]
    pub by_camera: Vec<CameraResiduals>,
    /// Reprojection errors, residuals of the LiDAR terms, and coverage by region, in the order of the way.
    #[serde(default)]
    pub by_region: Vec<RegionResiduals>,
    /// By how much the cameras differ from the rig file, as the images show it.
    pub cameras: Vec<CameraError>,
    /// Cameras that were taken as the images showed them, and by how much they differed from the rig file: [`Self::cameras`] then says what is left.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub refined: Vec<CameraError>,
    /// How well all scans agree at the poses of the map; absent without a LiDAR.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub agreement: Option<Agreement>,
    /// How far scans lie from the surfaces of keyframes that they had no part in; absent without a LiDAR.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scan_offsets: Option<ScanOffsets>,
    /// What control points say of the map, and it of them; absent where none were given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub control: Option<ControlReport>,
    /// What the IMU's term was made of; absent where the settings do not ask for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub imu: Option<InertialReport>,
    /// What each round of correspondences and minimisation did.
    pub rounds: Vec<RoundReport>,
    /// What the reader should know.
    pub warnings: Vec<MappingWarning>,
}

impl MappingReport {
    /// Everything that was looked at, good or not.
    pub fn findings(&self) -> Vec<Finding> {
        let of_odometry = self.odometry.warnings.iter().map(OdometryWarning::finding);
        let own = self.warnings.iter().map(MappingWarning::finding);
        let refined = self.refined.iter().map(CameraError::refined_finding);
        let of_cameras = refined.chain(self.cameras.iter().flat_map(CameraError::findings));
        let of_scans = self.agreement.iter().map(|agreement| {
            agreement.finding().remedy(
                "part of the map is bent, or much of what the LiDAR saw has moved: check the trajectory, walk loops, and start where little moves",
            )
        });
        of_odometry
            .chain(own)
            .chain(of_scans)
            .chain(self.scan_offsets.iter().flat_map(ScanOffsets::findings))
            .chain(self.control.iter().flat_map(ControlReport::findings))
            .chain(self.imu.iter().flat_map(InertialReport::findings))
            .chain(of_cameras)
            .collect()
    }

    /// Whether nothing is left out: every message was read, every scan found its place, none stayed away for long, and a trajectory to start from has all of
    /// the walk.
    pub fn is_whole(&self) -> bool {
        let leaves_out = |w: &MappingWarning| {
            matches!(
                w,
                MappingWarning::Damaged { .. }
                    | MappingWarning::StartHole { .. }
                    | MappingWarning::StartPartial { .. }
                    | MappingWarning::CloudsPartial { .. }
                    | MappingWarning::ScanGap { .. }
            )
        };
        self.odometry.is_whole() && !self.warnings.iter().any(leaves_out)
    }
}

/// One round of new correspondences and Eq. (4).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RoundReport {
    /// Plane correspondences between keyframes.
    pub plane_matches: u64,
    /// Edge correspondences between keyframes.
    pub edge_matches: u64,
    /// Observations of points.
    pub observations: u64,
    /// Standard deviation given to a distance from a plane, metres.
    pub plane_sigma_m: f64,
    /// Standard deviation given to a distance from an edge, metres.
    pub edge_sigma_m: f64,
    /// Standard deviation given to a pixel coordinate, pixels.
    pub pixel_sigma_px: f64,
    /// Cost before.
    pub initial_cost: f64,
    /// Cost after.
    pub final_cost: f64,
    /// Linearizations.
    pub iterations: u64,
    /// Farthest that a keyframe moved, metres.
    pub moved_m: f64,
    /// Farthest that a keyframe turned, degrees.
    pub turned_deg: f64,
    /// How many of its own standard deviations the motion from keyframe to keyframe of the start is off by, rotation and translation: 1 or more.
    #[serde(default)]
    pub start_contradicted: [f64; 2],
}

impl MappingWarning {
    /// Whether it is of one solution of Eq. (4), and not of what that was made from.
    pub(super) fn is_of_adjustment(&self) -> bool {
        matches!(
            self,
            Self::PosesUndetermined { .. }
                | Self::CamerasUndetermined { .. }
                | Self::NotAtRest { .. }
                | Self::ManyOutliers { .. }
        )
    }
}

/// Something the reader should know of a map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
#[non_exhaustive]
pub enum MappingWarning {
    /// A camera of the rig took no part.
    CameraMissing {
        /// The camera.
        camera: String,
        /// Why.
        reason: String,
    },
    /// A camera sees too little.
    FewFeatures {
        /// The camera.
        camera: String,
        /// Features in all of its images.
        features: u64,
        /// Its images.
        images: u64,
    },
    /// Many images of a camera show hardly anything.
    FeaturelessImages {
        /// The camera.
        camera: String,
        /// Its images with hardly a feature.
        featureless: u64,
        /// All of its images.
        images: u64,
    },
    /// A camera shows coarse features only.
    Blurred {
        /// The camera.
        camera: String,
        /// Median scale of its features, pixels.
        scale_px: f64,
        /// The same of the other cameras, their median, pixels.
        of_others_px: f64,
    },
    /// A part of the recording could not be read.
    Damaged {
        /// Which, and why.
        what: String,
    },
    /// The measurements do not determine all keyframes.
    PosesUndetermined {
        /// Which, as the solver says it.
        #[serde(default)]
        reason: String,
    },
    /// The measurements do not tell the errors of the cameras.
    CamerasUndetermined {
        /// Which, as the solver says it.
        reason: String,
    },
    /// For a while there was no scan.
    ScanGap {
        /// When it began, seconds after the first scan.
        after_secs: f64,
        /// How long.
        secs: f64,
    },
    /// A part of the walk that no loop spans.
    NoLoops {
        /// Length of that part, metres.
        open_m: f64,
        /// As near as it would have had to come, metres.
        within_m: f64,
    },
    /// A trajectory to start from does not reach all scans.
    StartPartial {
        /// Scans that it does not reach.
        missing: u64,
        /// All scans.
        scans: u64,
    },
    /// A trajectory to start from has a hole.
    StartHole {
        /// When it begins, seconds after its first pose.
        after_secs: f64,
        /// How long.
        secs: f64,
    },
    /// Stored clouds do not have all scans.
    CloudsPartial {
        /// Scans that are not among them.
        missing: u64,
        /// All scans.
        scans: u64,
    },
    /// Eq. (4) and its correspondences still changed one another when the last round was done.
    NotAtRest {
        /// Rounds.
        rounds: u64,
        /// Farthest that a keyframe moved in the last, metres.
        moved_m: f64,
        /// Farthest that one turned, degrees.
        turned_deg: f64,
    },
    /// Many observations do not agree with the poses.
    ManyOutliers {
        /// Share of the observations farther off than `max_px`.
        share: f64,
        /// The limit, pixels.
        max_px: f64,
    },
}

/// Good maps of simulated walks have 15 to 25 % of wrong matches in their tracks; more is something else.
pub(super) const USUAL_OUTLIER_SHARE: f64 = 0.4;

/// A part of a walk this long that no loop spans has checked nothing against its beginning, metres: longer than the trial's and the demo's walks.
pub(super) const LONGEST_WITHOUT_LOOP_M: f64 = 50.0;

/// Share of a camera's images that show hardly a feature before it is said, at the least so many: bare walls make a quarter of them on the way
/// through an office.
pub(super) const FEATURELESS_SHARE: f64 = 0.4;
/// Features of a camera that are so many times as large as those of the other cameras: it is not in focus.
pub(super) const BLURRED_SCALE: f64 = 1.5;

impl MappingWarning {
    /// As every command and page says it.
    pub fn finding(&self) -> Finding {
        let warn = |code: &'static str, subject: &str, what: String| {
            Finding::new(code, Verdict::Warn, subject, what)
        };
        match self {
            Self::CameraMissing { camera, reason } => {
                warn("camera-missing", camera, format!("the map is made without the IMU: {reason}"))
            }
            Self::FewFeatures {
                camera,
                features,
                images,
            } => warn(
                "few-features",
                camera,
                format!("only {features} features in {images} images"),
            )
            .remedy("check focus, exposure and lens cap"),
            Self::FeaturelessImages {
                camera,
                featureless,
                images,
            } => warn(
                "featureless-images",
                camera,
                format!("{featureless} of its {images} images have hardly any features"),
            )
            .value(1e2 * *featureless as f64 / (*images).max(1) as f64, "%")
            .limit(Limit::AtMost(1e2 * FEATURELESS_SHARE))
            .remedy("check light, exposure and the camera's cable"),
            Self::Blurred {
                camera,
                scale_px,
                of_others_px,
            } => warn(
                "blurred",
                camera,
                format!(
                    "its features are {:.1} times as large as those of the other cameras",
                    scale_px / of_others_px
                ),
            )
            .value(*scale_px, "px")
            .limit(Limit::AtMost(BLURRED_SCALE * of_others_px))
            .remedy("check its focus and clean its lens"),
            Self::Damaged { what } => warn("damaged", "", what.clone()),
            Self::PosesUndetermined { reason } => warn(
                "poses-undetermined",
                "",
                format!("images and scans do not determine all keyframes, so that the accuracy of their poses is unknown ({reason})"),
            )
            .remedy("map where the LiDAR sees walls on several sides, or with more images"),
            Self::CamerasUndetermined { reason } => warn(
                "cameras-undetermined",
                "",
                format!("images and scans do not determine the camera errors, so that the rig file is not checked ({reason})"),
            )
            .remedy("map where more can be seen, or check the rig file with `lsfb calib verify`"),
            Self::ScanGap { after_secs, secs } => warn(
                "scan-gap",
                "LiDAR",
                format!("no scans for {secs:.1} s, {after_secs:.1} s after the first scan: the poses there come from IMU and images, and may be off by centimetres"),
            )
            .value(*secs, "s")
            .remedy("check the LiDAR's cable and network (`lsfb doctor`), and scan that part again"),
            Self::NoLoops { open_m, within_m } => warn(
                "no-loops",
                "trajectory",
                format!("no loop closure over {open_m:.0} m of the walk: it does not come back to within {within_m} m of where it was before, so drift there is unchecked"),
            )
            .value(*open_m, "m")
            .limit(Limit::AtMost(LONGEST_WITHOUT_LOOP_M))
            .remedy("walk back to where that part began, or give surveyed points (--control-points)"),
            Self::StartPartial { missing, scans } => warn(
                "start-partial",
                "trajectory",
                format!("{missing} of {scans} scans are outside the initial trajectory: what they saw is not in the map"),
            )
            .remedy("give the whole trajectory of this recording"),
            Self::StartHole { after_secs, secs } => warn(
                "start-hole",
                "trajectory",
                format!("the initial trajectory has no pose for {secs:.1} s, {after_secs:.1} s after its first: what was seen there is not in the map"),
            )
            .value(*secs, "s")
            .remedy("find out why the program that made it lost track there, and scan that part again"),
            Self::CloudsPartial { missing, scans } => warn(
                "clouds-partial",
                "clouds",
                format!("{missing} of {scans} scans are not among the stored clouds: what they saw is not in the map"),
            )
            .remedy("the odometry does not store scans that it loses: see its report"),
            Self::NotAtRest {
                rounds,
                moved_m,
                turned_deg,
            } => warn(
                "not-at-rest",
                "poses",
                format!("not converged after {rounds} iterations: the last one moved keyframes by {:.1} mm and {turned_deg:.2}°", 1e3 * moved_m),
            )
            .value(1e3 * *moved_m, "mm")
            .remedy("start from a better trajectory, or allow more iterations (outer_iterations)"),
            Self::ManyOutliers { share, max_px } => warn(
                "many-outliers",
                "",
                format!(
                    "{:.0} % of the observations have a reprojection error above {max_px} px",
                    100.0 * share
                ),
            )
            .value(100.0 * share, "%")
            .limit(Limit::AtMost(100.0 * USUAL_OUTLIER_SHARE))
            .remedy("check the calibration of the cameras, their poses in the rig, and their clocks relative to the LiDAR's"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_of_a_damaged_recording_has_not_all_data() {
        assert!(MappingReport::default().is_whole());
        let what = "chunk cannot be decompressed".to_owned();
        let images = MappingReport {
            warnings: vec![MappingWarning::Damaged { what }],
            ..MappingReport::default()
        };
        assert!(!images.is_whole());
        let mut scans = MappingReport::default();
        scans.odometry.skipped = 1;
        assert!(!scans.is_whole());
    }
}
