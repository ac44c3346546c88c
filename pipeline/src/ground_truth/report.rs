use lsfb_geometry::so3;
use lsfb_solver::Termination;
use lsfb_types::Timestamp;
use serde::{Deserialize, Serialize};

use super::GroundTruthConfig;
use super::estimate::Estimate;
use super::imu_refinement::ImuRefinement;
use super::map_agreement::MapAgreement;
use super::other_place::OtherPlace;
use super::walk::{LocalPoint, Walk};
use crate::residuals::{CameraCorrection, entry, stated_from_found};

/// Why a stretch is left out of the trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LeftOutReason {
    /// Too little of the map was recognised in its images, for too long.
    NotRecognised,
    /// Its poses are less certain than is asked for.
    Uncertain,
    /// Its images were found at places that contradict the IMU and the rest of the walk.
    Contradicted,
    /// With parts of the map withheld they lie elsewhere.
    MapPartsDisagree,
    /// Much of what the map says should be in view there is not.
    PointsAbsent,
    /// Without a map: too few features could be followed in its images, for too long.
    NotFollowed,
    /// Without a map: the IMU recorded nothing for so long that nothing joins them to the rest.
    NotMeasured,
}

impl LeftOutReason {
    pub(super) const ALL: [Self; 7] = [
        Self::NotRecognised,
        Self::Uncertain,
        Self::Contradicted,
        Self::MapPartsDisagree,
        Self::PointsAbsent,
        Self::NotFollowed,
        Self::NotMeasured,
    ];
}

/// A stretch of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Span {
    /// First instant, nanoseconds.
    pub from_ns: i64,
    /// Last instant, nanoseconds.
    pub to_ns: i64,
    /// Why it is left out.
    pub reason: LeftOutReason,
}

impl Span {
    pub(super) fn new(from: Timestamp, to: Timestamp, reason: LeftOutReason) -> Self {
        Self {
            reason,
            from_ns: from.nanos(),
            to_ns: to.nanos(),
        }
    }
}

/// Reprojection errors of one kind of observation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ReprojectionErrors {
    /// Observations.
    pub count: u64,
    /// Root mean square, pixels.
    pub rms_px: f64,
    /// Number of errors per bin of [`ReprojectionErrors::BIN_PX`]; the last bin holds all larger ones.
    pub histogram: Vec<u64>,
}

impl ReprojectionErrors {
    /// Width of a bin, pixels.
    pub const BIN_PX: f64 = 0.25;
    const BINS: usize = 24;

    fn of(errors: impl Iterator<Item = f64>) -> Self {
        let mut result = Self {
            histogram: vec![0; Self::BINS],
            ..Self::default()
        };
        let mut squares = 0.0;
        for error in errors {
            result.count += 1;
            squares += error * error;
            let bin = ((error / Self::BIN_PX) as usize).min(Self::BINS - 1);
            result.histogram[bin] += 1;
        }
        result.rms_px = (squares / result.count.max(1) as f64).sqrt();
        result
    }
}

/// What others that were solved with a walk did to it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Together {
    /// The other walks.
    pub others: u64,
    /// Points of the map that this walk and another one see.
    pub map_points: u64,
    /// Points beside the map's that both see.
    pub common_points: u64,
    /// Farthest that a pose was moved by them, metres.
    pub moved_m: f64,
    /// Farthest in the standard deviations that its own walk gives it (a norm over six numbers, divided by what 95 % of them are below).
    pub moved_sigmas: f64,
}

/// What the stage says about its own result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GroundTruthReport {
    /// Instants with images in the recording.
    pub frames: u64,
    /// Features found in all images.
    pub features: u64,
    /// Frames that were looked up in the map on their own (`localize_every_secs`).
    pub looked_up: u64,
    /// Those of them that visual localization placed in the map.
    pub localized: u64,
    /// Localizations that disagreed with the IMU and the others, and were dropped.
    pub rejected_localizations: u64,
    /// Those among them that agree with the IMU and with one another at another place: the next best explanation of the walk.
    pub rival_localizations: u64,
    /// The next best place of the whole walk; `None` where its images are found nowhere else.
    pub other_place: Option<OtherPlace>,
    /// Frames in the trajectory.
    pub poses: u64,
    /// Frames in the trajectory that see too few map points to be placed alone: IMU and local points carry them.
    pub bridged: u64,
    /// Farthest that half of the map's points move a position of the trajectory, metres.
    pub largest_disagreement_m: f64,
    /// How far they may, metres.
    pub max_disagreement_m: f64,
    /// Points of the map that should be in view and were looked for, stretch by stretch.
    pub points_in_view: u64,
    /// Whether what they say suffices to tell the place from one that is built alike.
    pub place_checked: bool,
    /// How much of what they say is that they are not there.
    pub absent_share: f64,
    /// Largest such share.
    pub max_absent_share: f64,
    /// Stretches left out of the trajectory.
    pub left_out: Vec<Span>,
    /// Observations of map points added by the search after the first solve.
    pub guided_matching: u64,
    /// Observations not used because they are too far from where they should be.
    pub outliers: u64,
    /// Local points.
    pub local_points: u64,
    /// Errors of the map's points.
    pub map_errors: ReprojectionErrors,
    /// Errors of the local points.
    pub local_errors: ReprojectionErrors,
    /// Inertial samples.
    pub imu_samples: u64,
    /// Intervals between frames that lack inertial samples.
    pub imu_gaps: u64,
    /// Cost before the last solve.
    pub initial_cost: f64,
    /// Cost after it.
    pub final_cost: f64,
    /// Its iterations.
    pub iterations: u64,
    /// Why it stopped.
    pub termination: Termination,
    /// Gyroscope bias in the middle of the walk, rad/s.
    pub gyro_bias_rad_s: [f64; 3],
    /// Accelerometer bias in the middle of the walk, m/s².
    pub accel_bias_m_s2: [f64; 3],
    /// What the walk makes of the rig file's cameras.
    pub cameras: Vec<CameraRefinement>,
    /// What it makes of the IMU, where there is one.
    #[serde(flatten)]
    pub imu: Option<ImuRefinement>,
    /// What the IMU says of the map's size and vertical.
    pub map: Option<MapAgreement>,
    /// What other walks did to it that were solved together with it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub together: Option<Together>,
    /// Length of the path, metres.
    pub path_length_m: f64,
    /// What the reader should know.
    pub warnings: Vec<GroundTruthWarning>,
}

/// Something the reader of a trajectory should know.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
#[non_exhaustive]
pub enum GroundTruthWarning {
    /// Stretches of the walk have no poses.
    LeftOut {
        /// Why.
        reason: LeftOutReason,
        /// How long they are together, seconds.
        secs: f64,
        /// How many they are.
        spans: u64,
    },
    /// A camera is not as the rig file says.
    CameraOff {
        /// How it differs.
        found: CameraRefinement,
    },
    /// There are no inertial samples: images alone say where the device was.
    WithoutImu {
        /// Whether the rig file has an IMU.
        in_rig: bool,
    },
    /// Intervals between frames lack inertial samples.
    ImuGaps {
        /// How many.
        intervals: u64,
    },
    /// The IMU recorded nothing for longer than can be bridged.
    ImuPause {
        /// Since the first frame, seconds.
        after_secs: f64,
        /// How long, seconds.
        secs: f64,
        /// Longest that is bridged, seconds.
        longest_secs: f64,
    },
    /// Images could not be read.
    DamagedImages {
        /// How many.
        images: u64,
    },
    /// Inertial samples could not be read, or have the stamp of another one.
    DamagedSamples {
        /// How many messages, or stretches of the file.
        samples: u64,
    },
    /// Inertial samples were recorded once more.
    RepeatedSamples {
        /// How many.
        samples: u64,
    },
    /// Images of one camera carry the stamp of another of its images.
    RepeatedStamps {
        /// How many were not used.
        images: u64,
    },
    /// A camera sent the same image again while it was moved.
    FrozenImages {
        /// How many were not used.
        images: u64,
    },
    /// A sensor of the IMU repeated one reading while the device moved.
    FrozenSamples {
        /// How long, seconds; these samples were not used.
        secs: f64,
    },
    /// Too little of the map was mapped from where the walk went to tell the place from one that is built alike.
    PlaceNotChecked {
        /// How long, seconds.
        secs: f64,
    },
    /// The whole walk fits the map not much worse somewhere else.
    LooksAlike {
        /// Where.
        other: OtherPlace,
    },
    /// Most of it was recognised at a place where what should have been in view was not there; it was solved at another, where it is.
    FoundElsewhere {
        /// How far that is from the place where most of it was recognised, metres.
        away_m: f64,
        /// How far it is turned from there, degrees.
        turn_deg: f64,
        /// Share of what should have been in view there that was not.
        absent_share: f64,
    },
    /// Observations still came or went when the rounds of choosing them and solving were done.
    NotAtRest {
        /// How many rounds.
        rounds: u64,
        /// Observations that another round would take in or leave out.
        changing: u64,
        /// Farthest that the last round moved a pose, metres.
        moved_m: f64,
        /// Farthest that it turned one, degrees.
        turned_deg: f64,
    },
    /// The map failed when it was made, and was used all the same.
    FailedMap {
        /// What was found.
        what: String,
    },
}

/// How a camera differs from the rig file, as far as the walk shows it and the file's standard deviations allow.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraRefinement {
    /// Its name.
    pub camera: String,
    /// How points before the camera turn, from where the rig file says that they are, about the camera's axes, degrees.
    pub turn_deg: [f64; 3],
    /// How they are shifted, along the camera's axes, metres.
    pub shift_m: [f64; 3],
    /// Share by which the focal length is larger.
    pub focal_share: f64,
    /// Its standard deviation.
    pub focal_sigma: f64,
    /// Added to the camera's stamps, seconds.
    pub clock_s: f64,
    /// Its standard deviation, seconds.
    pub clock_sigma_s: f64,
    /// Readout time, that of the rig file included, seconds.
    pub readout_s: f64,
    /// Its standard deviation, seconds.
    pub readout_sigma_s: f64,
    /// Largest of these in standard deviations of the rig file; but for the readout time where that does not say how well it is known, as many files do not state it.
    pub largest_sigmas: f64,
}

pub(super) fn refinements<'a>(
    names: impl Iterator<Item = &'a str>,
    estimate: &Estimate,
    deviations: &[CameraCorrection],
    config: &GroundTruthConfig,
) -> Vec<CameraRefinement> {
    let found = estimate.corrections.iter().zip(&estimate.cameras);
    let named = names.zip(found.zip(deviations));
    named
        .map(|(name, ((correction, camera), deviation))| {
            let found_from_stated = stated_from_found(correction).inverse();
            let mut sigmas = correction.component_div(&config.calibration_sigmas(camera));
            if camera.sigmas().readout_s.is_none() {
                sigmas[entry::READOUT] = 0.0;
            }
            CameraRefinement {
                camera: name.to_owned(),
                turn_deg: so3::log(&found_from_stated.rotation)
                    .map(f64::to_degrees)
                    .into(),
                shift_m: found_from_stated.translation.into(),
                focal_share: correction[entry::FOCAL],
                focal_sigma: deviation[entry::FOCAL],
                clock_s: correction[entry::CLOCK],
                clock_sigma_s: deviation[entry::CLOCK],
                readout_s: camera.timing().readout_s,
                readout_sigma_s: deviation[entry::READOUT],
                largest_sigmas: sigmas.amax(),
            }
        })
        .collect()
}

pub(super) fn map_errors(walk: &Walk, estimate: &Estimate) -> ReprojectionErrors {
    ReprojectionErrors::of(walk.frames.iter().enumerate().flat_map(|(k, frame)| {
        let error_px = move |seen| estimate.fixed_error_px(k, seen);
        frame.fixed.iter().map(error_px)
    }))
}

pub(super) fn local_errors(estimate: &Estimate, points: &[LocalPoint]) -> ReprojectionErrors {
    ReprojectionErrors::of(points.iter().flat_map(|point| {
        let used = point.observations.iter().filter(|seen| seen.used);
        used.map(move |seen| estimate.local_error_px(point, seen))
    }))
}
