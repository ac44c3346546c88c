//! What the data is refused for.

use std::path::PathBuf;

use lsfb_types::{Finding, Timestamp};

use super::shortage::{MIN_FEATURES_PER_IMAGE, MIN_MAP_POINTS, MapShortage};

/// Why the data gives no result that could be trusted: what was found, without what to do, which [`Refusal::finding`] adds.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// A walk that does not see the map.
    #[error("{localized} of {frames} images were localized in the map")]
    NotLocalized {
        /// The recording.
        path: PathBuf,
        /// Instants with images.
        frames: usize,
        /// Of these, found in the map.
        localized: usize,
        /// Fewest that must be found.
        needed: usize,
    },
    /// Places found in the map contradict the IMU and one another.
    #[error("{rejected} of {localized} localized poses contradict the IMU")]
    MapDisagrees {
        /// The recording.
        path: PathBuf,
        /// Images found in the map.
        localized: usize,
        /// Of these, refused.
        rejected: usize,
        /// Most that may be.
        most: usize,
    },
    /// Places found in the map explain the walk in more than one way.
    #[error(
        "{agreeing} localized poses agree with the IMU, but {rival} others agree with it and with each other in another place"
    )]
    AmbiguousPlace {
        /// The recording.
        path: PathBuf,
        /// Localized frames of the best explanation.
        agreeing: usize,
        /// Localized frames of the next best that contradict it.
        rival: usize,
        /// How many times as many must agree.
        margin: f64,
    },
    /// The whole walk fits the map nearly as well somewhere else.
    #[error(
        "{matches_here} map points are found where this walk is, and {matches_there} if all of it were {away_m:.1} m away and rotated by {turn_deg:.0}°"
    )]
    LooksAlike {
        /// The recording.
        path: PathBuf,
        /// Points that some of its instants show where they are said to be.
        matches_here: u64,
        /// The same if all of them were at the next best place.
        matches_there: u64,
        /// How far that is, metres.
        away_m: f64,
        /// How far the walk would be turned, degrees.
        turn_deg: f64,
        /// How many times as much must be found.
        margin: f64,
    },
    /// Much of what the map says should be in view is not there.
    #[error(
        "{points} map points that should be in view were searched for, and {absent_percent:.1} % of the evidence says that they are absent"
    )]
    PointsAbsent {
        /// The recording.
        path: PathBuf,
        /// Points that were looked for.
        points: usize,
        /// How much of what they say is that they are not there, percent.
        absent_percent: f64,
        /// Largest share of that.
        limit: f64,
    },
    /// Tracks and IMU contradict each other.
    #[error("{:.0} % of the tracked features fit no point", 100.0 * share)]
    TracksContradict {
        /// Share of the followed sights.
        share: f64,
        /// Largest that may be.
        limit: f64,
    },
    /// Images turn another way than the gyroscope says.
    #[error(
        "where the gyroscope rotates by 1 about its {axis} axis, the images rotate by {x:+.2}, {y:+.2}, {z:+.2} about x, y, z",
        x = images[0], y = images[1], z = images[2]
    )]
    GyroContradicts {
        /// The axis that is farthest off.
        axis: char,
        /// What the images make of one unit about it, in the rig's frame.
        images: [f64; 3],
    },
    /// An axis of the accelerometer does not read what is felt along it.
    #[error(
        "where the accelerometer reads 1 along its {axis} axis, the localized images give {x:+.2}, {y:+.2}, {z:+.2} along x, y, z",
        x = felt[0], y = felt[1], z = felt[2]
    )]
    AccelContradicts {
        /// The recording.
        path: PathBuf,
        /// The axis that is farthest off.
        axis: char,
        /// What is felt along x, y and z of the IMU where that axis reads 1.
        felt: [f64; 3],
    },
    /// Parts of the map place a walk differently, and its IMU is not what the recording says.
    #[error(
        "with half of the map's points withheld, the {frames} poses move by {moved_m:.2} m, and images and IMU contradict each other: {}",
        each(failures, |f| Some(f.what.as_str()))
    )]
    ImuContradicts {
        /// The recording.
        path: PathBuf,
        /// Poses that were found.
        frames: usize,
        /// How far halves of the map move them in the middle, metres.
        moved_m: f64,
        /// What is wrong with the IMU by this walk.
        failures: Vec<Finding>,
    },
    /// A sensor of the IMU says the same all along.
    #[error(
        "the {sensor} repeats one reading for {secs:.1} s of {of_secs:.1} s although the device moves"
    )]
    FrozenSensor {
        /// Which of the two.
        sensor: &'static str,
        /// How long it repeats one reading, at most, seconds.
        secs: f64,
        /// Length of the recording, seconds.
        of_secs: f64,
    },
    /// No pose of a walk is certain enough.
    #[error("none of {frames} poses is certain enough for the trajectory")]
    NothingCertain {
        /// The recording.
        path: PathBuf,
        /// Poses that were found.
        frames: usize,
        /// Largest standard deviation of a position that is exported, metres.
        limit_m: f64,
    },
    /// No pose of a walk without a map sees enough and is certain enough.
    #[error(
        "none of {frames} poses has enough observations (min_sights is {min_sights}) and is certain enough"
    )]
    NothingFollowed {
        /// Poses that were found.
        frames: usize,
        /// Fewest sights of placed points in a frame.
        min_sights: usize,
        /// Largest standard deviation of a position that is exported, metres.
        limit_m: f64,
    },
    /// Nothing in a walk without a map tells scale and gravity.
    #[error("no motion could be initialized from any of {frames} frames")]
    NoBeginning {
        /// Frames that were looked at.
        frames: usize,
    },
    /// The motion of a walk was found, but not how far it may be off.
    #[error("the covariance of {frames} poses could not be computed ({problem})")]
    UnknownCovariance {
        /// Poses that were found.
        frames: usize,
        /// What the solver says.
        problem: lsfb_solver::Error,
    },
    /// Parts of the map place a walk differently.
    #[error("with half of the map's points withheld, the {frames} poses move by {moved_m:.2} m")]
    MapPartsDisagree {
        /// The recording.
        path: PathBuf,
        /// Poses that were found.
        frames: usize,
        /// How far they move in the middle, metres.
        moved_m: f64,
        /// How far a pose that is exported may, metres.
        limit_m: f64,
    },
    /// Next to nothing of a walk was recognised on its own, and nothing else tells whether the map has it where it was.
    #[error(
        "the {points} map points that should be in view are not conclusive ({absent_percent:.0} % of the evidence says that they are absent), with half of the map's points withheld the poses move by {moved_m:.2} m, and {recognised} of {frames} images were recognised on their own"
    )]
    FewRecognised {
        /// The recording.
        path: PathBuf,
        /// Images that the map was recognised in.
        recognised: usize,
        /// Images in reach of these.
        frames: usize,
        /// Least share of them.
        needed_share: f64,
        /// How far halves of the map move the poses in the middle, metres.
        moved_m: f64,
        /// Points of the map that were looked for.
        points: usize,
        /// How much of what they say is that they are not there, percent.
        absent_percent: f64,
    },
    /// A least-squares problem kept moving.
    #[error("did not converge within {iterations} iterations")]
    NotConverged {
        /// What was solved.
        stage: &'static str,
        /// Iterations in all.
        iterations: usize,
    },
    /// The IMU leaves a time open that is to be integrated over.
    #[error("no IMU samples from {from} s to {to} s")]
    ImuGap {
        /// Last instant before the gap.
        from: Timestamp,
        /// First instant after it.
        to: Timestamp,
        /// Longest gap that is bridged, seconds.
        longest_secs: f64,
    },
    /// The map was judged a failure when it was made.
    #[error("failed its checks when it was made: {}", failures.join("; "))]
    FailedMap {
        /// What was found, a sentence each.
        failures: Vec<String>,
    },
    /// A walk that is to be solved together with others is found wrong by itself.
    #[error(
        "this walk must not be used, and neither must the walks solved together with it: {}", failed.what
    )]
    FailedAlone {
        /// The recording.
        path: PathBuf,
        /// What is wrong.
        failed: Box<Finding>,
    },
    /// Two maps are not surely of one place.
    #[error(
        "the maps could not be aligned reliably: {}",
        how_they_meet([*pairs, *shared, *rival], *sigma_m, *scale_shift_m)
    )]
    MapsDoNotMeet {
        /// Pairs of points that look alike.
        pairs: usize,
        /// Of these, the pairs that fit the best alignment.
        shared: usize,
        /// Those that fit the best other one.
        rival: usize,
        /// σ of the best alignment where it is worst, metres.
        sigma_m: f64,
        /// How far another scale of the second map would move it at most, metres.
        scale_shift_m: f64,
    },
    /// Two surveyed maps that do not agree where they are.
    #[error(
        "both maps have surveyed frames, but their common points shift the second by {shift_m:.3} m from its survey"
    )]
    SurveysDisagree {
        /// How far the alignment moves a keyframe of the second from its surveyed place at most, metres.
        shift_m: f64,
        /// Most that it may, metres.
        most_m: f64,
    },
    /// Two maps are of the same images.
    #[error(
        "{points} of {shared} shared points were seen in the same images at the same pixels: one map is part of the other, or both were made from one recording, and each observation would count twice"
    )]
    SameImages {
        /// Points with an observation that both maps have.
        points: usize,
        /// Points that the maps share.
        shared: usize,
    },
    /// Nothing tells how far the images of a map are from where its points place them.
    #[error(
        "no image shows {needed} points that other images of the map show too, so that neither the accuracy of the map nor that of any pose in it can be determined"
    )]
    MapErrorUnknown {
        /// Points that an image must share.
        needed: usize,
    },
    /// A map cannot be made so small.
    #[error(
        "a map that small would show only {points} points in the image of {camera} in keyframe {keyframe} ({time} s)"
    )]
    MapBudget {
        /// The keyframe that would be worst off.
        keyframe: u32,
        /// Its time.
        time: Timestamp,
        /// The camera of the view.
        camera: String,
        /// What it would be left with.
        points: usize,
        /// What it needs.
        needed: usize,
        /// A size that leaves every view enough, megabytes.
        smallest_mb: f64,
    },
    /// Images give no map, or one in which nobody would be found.
    #[error("{reason}, and {points} map points are seen in three or more images")]
    TooFewPoints {
        /// Points there are.
        points: usize,
        /// Fewest that make a map.
        needed: usize,
        /// What is missing.
        reason: MapShortage,
    },
    /// A trajectory to start from is not that of the recording.
    #[error("{:.0} % of its scans lie within the initial trajectory", 100.0 * share)]
    StartElsewhere {
        /// The recording.
        path: PathBuf,
        /// Share of its scans within the trajectory.
        share: f64,
        /// Least share.
        least: f64,
    },
    /// No scan of a recording could be used.
    #[error(
        "none of the {scans} LiDAR scans could be used{}", why.as_ref().map_or_else(String::new, |why| format!(": {why}"))
    )]
    NoScan {
        /// The recording.
        path: PathBuf,
        /// Scans in it.
        scans: u64,
        /// What may be the reason, where something speaks for it.
        why: Option<String>,
    },
    /// A scan holds no return at all.
    #[error("the LiDAR scan at {time} s is empty")]
    EmptyScan {
        /// Time of the scan.
        time: Timestamp,
    },
    /// No camera of the rig is in the recording.
    #[error("no images of any camera of rig {rig}")]
    NoImages {
        /// The recording.
        path: PathBuf,
        /// The rig's name.
        rig: String,
    },
    /// No image lies within the trajectory.
    #[error("no image was taken between the first and the last LiDAR scan")]
    NoKeyframe {
        /// The recording.
        path: PathBuf,
    },
    /// Too few control points are clicked to hold a map.
    #[error("{clicked} of {all} are clicked in two images or more")]
    FewControlPoints {
        /// Those that are clicked often enough.
        clicked: usize,
        /// Surveyed ones.
        all: usize,
        /// Fewest that hold a map.
        needed: usize,
    },
    /// Control points lie on one line, about which a map may turn.
    #[error(
        "all {count} lie within {width_m:.2} m of one line ({length_m:.1} m, both rms), about which the map could rotate"
    )]
    ControlPointsOnALine {
        /// Those that are clicked often enough.
        count: usize,
        /// How far they are from the line, rms, metres.
        width_m: f64,
        /// How far they reach along it, rms, metres.
        length_m: f64,
    },
    /// Scans came out of order.
    #[error("a LiDAR scan ends at {time} s, before the end of the previous one ({previous} s)")]
    ScanOrder {
        /// End of the scan.
        time: Timestamp,
        /// End of the scan before.
        previous: Timestamp,
    },
    /// The first scan came before any inertial sample.
    #[error("no IMU sample before {time} s")]
    ImuMissing {
        /// End of the scan.
        time: Timestamp,
    },
    /// The IMU is to take part in Eq. (4), and there is none.
    #[error("Eq. 4 cannot use the IMU (imu = true under [terms]): {reason}")]
    NoImuTerm {
        /// The recording.
        path: PathBuf,
        /// What is missing, or wrong.
        reason: String,
    },
    /// One scan has nothing to be compared with.
    #[error("{scans} scans are too few to refine poses")]
    TooFewScans {
        /// How many there are.
        scans: usize,
    },
    /// Too few descriptors to train a codebook on.
    #[error("{count} descriptors are too few for a codebook")]
    FewDescriptors {
        /// Number of descriptors.
        count: usize,
        /// Fewest that do.
        needed: usize,
    },
}

impl Refusal {
    /// For `points` map points of `images` images with `features` features in all; `no_baseline` where no two of them see one thing from
    /// two places.
    pub(crate) fn too_few_points(
        points: usize,
        images: usize,
        features: usize,
        no_baseline: bool,
    ) -> Self {
        let reason = if features < MIN_FEATURES_PER_IMAGE * images.max(1) {
            MapShortage::FewFeatures { images, features }
        } else if no_baseline {
            MapShortage::NoBaseline { images }
        } else {
            MapShortage::Disagreement { images }
        };
        Self::TooFewPoints {
            points,
            needed: MIN_MAP_POINTS,
            reason,
        }
    }
}

/// What some findings say, or have to be done.
pub(super) fn each<'a>(
    findings: &'a [Finding],
    part: impl Fn(&'a Finding) -> Option<&'a str>,
) -> String {
    findings
        .iter()
        .filter_map(part)
        .collect::<Vec<_>>()
        .join("; ")
}

fn how_they_meet([pairs, shared, rival]: [usize; 3], sigma_m: f64, scale_shift_m: f64) -> String {
    if !sigma_m.is_finite() {
        return format!("the {pairs} points that look alike do not fit any common alignment");
    }
    format!(
        "of {pairs} points that look alike, {shared} fit one alignment and {rival} another; the best is uncertain by {sigma_m:.3} m, and another scale of the second map moves it by {scale_shift_m:.3} m"
    )
}
