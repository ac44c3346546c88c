use std::path::{Path, PathBuf};

use lsfb_types::Timestamp;

/// What can go wrong in this crate: what, where, and what to do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be read or written.
    #[error("{path}: {source}", path = path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A setting lies outside its bounds.
    #[error(transparent)]
    Setting(#[from] lsfb_types::OutOfBounds),
    /// A camera is used that the rig does not have.
    #[error("rig {rig} has no camera {camera}: give the rig file that belongs to these images")]
    UnknownCamera {
        /// The camera asked for.
        camera: String,
        /// The rig's name.
        rig: String,
    },
    /// The principal point of a camera lies where no lens has it in images of its size.
    #[error(
        "the principal point of camera {camera}, ({x:.1}, {y:.1}) px, is far from the centre of its {width} × {height} images: give the intrinsics for images of this size",
        x = principal_px[0], y = principal_px[1], width = size_px[0], height = size_px[1]
    )]
    PrincipalPointOffCentre {
        /// The camera.
        camera: String,
        /// Size of its images, pixels.
        size_px: [u32; 2],
        /// Its principal point, pixels.
        principal_px: [f64; 2],
    },
    /// An image is not as large as its camera's images are.
    #[error(
        "{path}: {found_width} × {found_height} px, but camera {camera} has {width} × {height}: give the intrinsics for images of this size, or the original images", path = path.display(),
        found_width = found_px[0], found_height = found_px[1], width = expected_px[0], height = expected_px[1]
    )]
    ImageSize {
        /// The image.
        path: PathBuf,
        /// The camera.
        camera: String,
        /// Size of the camera's images, pixels.
        expected_px: [u32; 2],
        /// Size of this one, pixels.
        found_px: [u32; 2],
    },
    /// Stored clouds cannot be mapped with.
    #[error("{path}: {reason}", path = path.display())]
    StoredClouds {
        /// The file.
        path: PathBuf,
        /// Why, and what to do.
        reason: String,
    },
    /// A list of posed images is not what it should be.
    #[error("{path}, line {line}: {reason}", path = path.display())]
    PosedImages {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What is wrong.
        reason: &'static str,
    },
    /// A list of posed images of another program is not what it should be.
    #[error("{path}: {reason}", path = path.display())]
    PosedLayout {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// An image file cannot be read.
    #[error(transparent)]
    Image(#[from] lsfb_perception::image::ImageError),
    /// A folder holds no map.
    #[error("{folder}: no map here (map.toml is missing): give a folder written by `lsfb map`, or map again if that was interrupted", folder = folder.display())]
    NoMap {
        /// The folder.
        folder: PathBuf,
    },
    /// A map was written by another version.
    #[error("{path}: format version {found}, this program reads {oldest} to {expected}: map again, or use the program that wrote it", path = path.display())]
    MapVersion {
        /// The header file.
        path: PathBuf,
        /// The file's version.
        found: u32,
        /// The oldest that is read.
        oldest: u32,
        /// Ours.
        expected: u32,
    },
    /// A file of a map is damaged.
    #[error("{path}: {reason}; the map is damaged: copy it again or map again", path = path.display())]
    MapFile {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A file of descriptors is not what it should be.
    #[error(
        "{path}: {reason}: give a .bvecs file of descriptors of 128 bytes", path = path.display()
    )]
    DescriptorFile {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// More descriptors than an index has numbers for.
    #[error("{count} descriptors are too many for one index (at most 4294967295): split the map")]
    TooManyDescriptors {
        /// Number of descriptors.
        count: usize,
    },
    /// A file is no codebook of VLAD vectors.
    #[error("{path}: {problem}: make a codebook with `lsfb models codebook`", path = path.display())]
    BadCodebook {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A view of a walk that is of none of its frames or cameras, or out of their order.
    #[error(
        "view {view} of the walk belongs to none of its frames or cameras, is out of order, or has keypoints without descriptors"
    )]
    UnknownView {
        /// Its number.
        view: usize,
    },
    /// Too few descriptors to train a codebook on.
    #[error(
        "{count} descriptors are too few for a codebook, which needs {needed}: give more images, or use fewer words"
    )]
    FewDescriptors {
        /// Number of descriptors.
        count: usize,
        /// Fewest that do.
        needed: usize,
    },
    /// Weights of a network could not be read.
    #[error(transparent)]
    Network(#[from] lsfb_networks::Error),
    /// A file of weights holds others than are asked for.
    #[error("{path}: contains {found}, not {expected}: add the right weights with `lsfb models add`", path = path.display())]
    OtherWeights {
        /// The file.
        path: PathBuf,
        /// What is asked for.
        expected: String,
        /// What it holds.
        found: String,
    },
    /// Descriptors of one feature are to be looked up among those of another.
    #[error(
        "the map holds {map} features, the images have {images}, and their descriptors cannot be compared: localize with the map's feature, or map again with the other"
    )]
    WrongFeature {
        /// The map's.
        map: String,
        /// The query's.
        images: String,
    },
    /// A map point refers to something that is not there.
    #[error("map point {point}: {reason}")]
    MapContent {
        /// Index of the point.
        point: usize,
        /// What is wrong.
        reason: &'static str,
    },
    /// A format knows no camera of a kind.
    #[error(
        "{format} has no camera model {model}: calibrate with another lens model, or export in another format"
    )]
    CameraFormat {
        /// COLMAP's name of the model.
        model: String,
        /// The format.
        format: &'static str,
    },
    /// Points do not fit into a LAS file.
    #[error("the points do not fit into a LAS file: {reason}")]
    Las {
        /// Why.
        reason: String,
    },
    /// No point of a map lies in a region.
    #[error("no point of the map lies in that region: `lsfb map info` shows its extent")]
    EmptyRegion,
    /// A map cannot be made so small.
    #[error(
        "a map that small would show only {points} points in the image of {camera} in keyframe {keyframe} ({time} s), and {needed} are needed to localize there: give {smallest_mb:.2} MB or more, crop the map, or lower fewest_points_per_view"
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
    /// Two maps are not surely of one place.
    #[error(
        "the maps could not be aligned reliably: {}: check that both are in the same unit, merge maps that overlap more, or whose overlap does not look like another place",
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
    /// Nothing tells how far the images of a map are from where its points place them.
    #[error(
        "no image of the map shows {needed} points that other images of it show too, so that neither the accuracy of the map nor that of any pose in it can be determined; make the map from more images, or crop a larger part"
    )]
    MapErrorUnknown {
        /// Points that an image must share.
        needed: usize,
    },
    /// Two maps are of the same images.
    #[error(
        "{points} of {shared} shared points were seen in the same images at the same pixels: one map is part of the other, or both were made from one recording, and each observation would count twice. Merge maps of different recordings, and crop a map from the whole one"
    )]
    SameImages {
        /// Points with an observation that both maps have.
        points: usize,
        /// Points that the maps share.
        shared: usize,
    },
    /// Two maps of which the second alone stands in a surveyed frame.
    #[error(
        "the second map has a surveyed frame but the first does not, and the result keeps the frame of the first: name the surveyed map first"
    )]
    SurveyedSecond,
    /// Two surveyed maps that do not agree where they are.
    #[error(
        "both maps have surveyed frames, but their common points shift the second by {shift_m:.3} m from its survey (at most {most_m} m is accepted): the surveys use different frames, or the control points of one map are wrong"
    )]
    SurveysDisagree {
        /// How far the alignment moves a keyframe of the second from its surveyed place at most, metres.
        shift_m: f64,
        /// Most that it may, metres.
        most_m: f64,
    },
    /// Images give no map, or one in which nobody would be found.
    #[error(
        "{points} map points are seen in three or more images, but {needed} are needed: {reason}"
    )]
    TooFewPoints {
        /// Points there are.
        points: usize,
        /// Fewest that make a map.
        needed: usize,
        /// What is missing.
        reason: MapShortage,
    },
    /// An image belongs to a keyframe that is not there.
    #[error("an image belongs to keyframe {keyframe}, but there are {count}")]
    UnknownKeyframe {
        /// The keyframe.
        keyframe: usize,
        /// How many there are.
        count: usize,
    },
    /// A scan holds no return at all.
    #[error("the LiDAR scan at {time} s is empty: was the sensor covered, or its power cut?")]
    EmptyScan {
        /// Time of the scan.
        time: Timestamp,
    },
    /// Scans came out of order.
    #[error(
        "a LiDAR scan ends at {time} s, before the end of the previous one ({previous} s): sort the scans by time"
    )]
    ScanOrder {
        /// End of the scan.
        time: Timestamp,
        /// End of the scan before.
        previous: Timestamp,
    },
    /// A sensor is needed that the rig does not have.
    #[error("rig {rig} has no {sensor}: give the rig file of the device that recorded this")]
    SensorMissing {
        /// The sensor.
        sensor: &'static str,
        /// The rig's name.
        rig: String,
    },
    /// The IMU is to take part in Eq. (4), and there is none.
    #[error(
        "{path}: Eq. 4 cannot use the IMU (imu = true under [terms]): {reason}; map a recording that has an IMU with a rig file that states its noise, or set imu = false", path = path.display()
    )]
    NoImuTerm {
        /// The recording.
        path: PathBuf,
        /// What is missing, or wrong.
        reason: String,
    },
    /// No scan of a recording could be used.
    #[error("{path}: none of the {scans} LiDAR scans could be used: {why}", path = path.display())]
    NoScan {
        /// The recording.
        path: PathBuf,
        /// Scans in it.
        scans: u64,
        /// What may be the reason, or what to look at.
        why: String,
    },
    /// No camera of the rig is in the recording.
    #[error("{path}: no images of any camera of rig {rig}: record with the cameras on, or give the rig of this device", path = path.display())]
    NoImages {
        /// The recording.
        path: PathBuf,
        /// The rig's name.
        rig: String,
    },
    /// The system gives no more threads.
    #[error("cannot start a thread: {message}")]
    Threads {
        /// What it says.
        message: String,
    },
    /// A least-squares problem could not be solved.
    #[error("optimisation: {0}")]
    Solver(#[from] lsfb_solver::Error),
    /// One scan has nothing to be compared with.
    #[error("{scans} scans are too few: refining poses needs two or more that overlap")]
    TooFewScans {
        /// How many there are.
        scans: usize,
    },
    /// No image lies within the trajectory.
    #[error("{path}: no image was taken between the first and the last LiDAR scan: compare the cameras' clock with the LiDAR's", path = path.display())]
    NoKeyframe {
        /// The recording.
        path: PathBuf,
    },
    /// A recording could not be read.
    #[error(transparent)]
    Recording(#[from] lsfb_recording::Error),
    /// The first scan came before any inertial sample.
    #[error(
        "no IMU sample before {time} s: start the odometry without the IMU, or with scans that the IMU covers"
    )]
    ImuMissing {
        /// End of the scan.
        time: Timestamp,
    },
    /// A walk that does not see the map.
    #[error(
        "{path}: {localized} of {frames} images were localized in the map, but {needed} are needed: is it the map of this place, and the rig file of this device?", path = path.display()
    )]
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
    /// A walk that another one is to be solved together with is refused by itself.
    #[error("{path}, which was to be solved together with it: {error}", path = path.display())]
    OtherWalk {
        /// Its recording.
        path: PathBuf,
        /// Why.
        error: Box<Error>,
    },
    /// A walk that is to be solved together with others is found wrong by itself.
    #[error("{path}: it must not be used, and neither must the walks solved together with it: {what}", path = path.display())]
    FailedAlone {
        /// The recording.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// Places found in the map contradict the IMU and one another.
    #[error(
        "{path}: {rejected} of {localized} localized poses contradict the IMU: is it the map of this place, and do the cameras and the IMU of the rig file belong to this device?", path = path.display()
    )]
    MapDisagrees {
        /// The recording.
        path: PathBuf,
        /// Images found in the map.
        localized: usize,
        /// Of these, refused.
        rejected: usize,
    },
    /// Places found in the map explain the walk in more than one way.
    #[error(
        "{path}: {agreeing} localized poses agree with the IMU, but {rival} others agree with it and with each other in another place: the map has places that look alike, and this walk does not distinguish them; extend the walk to a place that is unique, or map the other place too", path = path.display()
    )]
    AmbiguousPlace {
        /// The recording.
        path: PathBuf,
        /// Localized frames of the best explanation.
        agreeing: usize,
        /// Localized frames of the next best that contradict it.
        rival: usize,
    },
    /// Files are named by cameras.
    #[error("camera name {name:?} cannot be used as a file name: rename the camera in the rig")]
    CameraName {
        /// Its name.
        name: String,
    },
    /// The whole walk fits the map nearly as well somewhere else.
    #[error(
        "{path}: {} map points are found where this walk is, and {} if all of it were {:.1} m away and rotated by {:.0}°: the map has places that look alike, and this walk does not distinguish them (min_place_margin is {margin}); extend the walk to a place that is unique", matches_here, matches_there, away_m, turn_deg, path = path.display()
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
        "{path}: {points} map points that should be in view were searched for, and {absent_percent:.1} % of the evidence says that they are absent (max_absent_share is {limit}): the place has changed since it was mapped, or it is another place built alike, such as another floor; map it again, or raise the limit if no other place looks like it", path = path.display()
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
    /// Nothing in a walk without a map tells scale and gravity.
    #[error(
        "no motion could be initialized from any of {frames} frames: begin at rest for half a second, or move by at least a hand's breadth while something with texture is in view"
    )]
    NoBeginning {
        /// Frames that were looked at.
        frames: usize,
    },
    /// Tracks and IMU contradict each other.
    #[error(
        "{:.0} % of the tracked features fit no point (at most {:.0} %): check the IMU's axes and units, the cameras' lenses and poses on the IMU, and both clocks", 100.0 * share, 100.0 * limit
    )]
    TracksContradict {
        /// Share of the followed sights.
        share: f64,
        /// Largest that may be.
        limit: f64,
    },
    /// Images turn another way than the gyroscope says.
    #[error(
        "where the gyroscope rotates by 1 about its {axis} axis, the images rotate by {x:+.2}, {y:+.2}, {z:+.2} about x, y, z: check the IMU's axes, their signs and units, and the camera poses on the IMU in the rig file",
        x = images[0], y = images[1], z = images[2]
    )]
    GyroContradicts {
        /// The axis that is farthest off.
        axis: char,
        /// What the images make of one unit about it, in the rig's frame.
        images: [f64; 3],
    },
    /// The map was judged a failure when it was made.
    #[error(
        "the map failed its checks when it was made: {}; fix that and map the place again, or set accept_failed_map if it does not matter", failures.join("; ")
    )]
    FailedMap {
        /// What was found, a sentence each.
        failures: Vec<String>,
    },
    /// No pose of a walk is certain enough.
    #[error(
        "{path}: none of {frames} poses is certain enough for the trajectory (max_position_sigma_m is {limit_m} m; attitudes to 1.1°): walk where more of the map is in view, or raise the limit", path = path.display()
    )]
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
        "none of {frames} poses has enough observations (min_sights is {min_sights}) and is certain enough (max_position_sigma_m is {limit_m} m): light the place, keep the lenses free, and look at objects with texture"
    )]
    NothingFollowed {
        /// Poses that were found.
        frames: usize,
        /// Fewest sights of placed points in a frame.
        min_sights: usize,
        /// Largest standard deviation of a position that is exported, metres.
        limit_m: f64,
    },
    /// The motion of a walk was found, but not how far it may be off.
    #[error(
        "the covariance of {frames} poses could not be computed: check the IMU's noise in the rig file ({problem})"
    )]
    UnknownCovariance {
        /// Poses that were found.
        frames: usize,
        /// What the solver says.
        problem: lsfb_solver::Error,
    },
    /// Parts of the map place a walk differently.
    #[error(
        "{path}: with half of the map's points withheld, the {frames} poses move by {moved_m:.2} m (max_disagreement_m is {limit_m} m): the map is poor here, or the place has changed since it was mapped; map the place again with more views of it, or walk where more of the map is in view", path = path.display()
    )]
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
    /// A sensor of the IMU says the same all along.
    #[error(
        "the {sensor} repeats one reading for {secs:.1} s of {of_secs:.1} s although the device moves: check the IMU and its driver, and record again"
    )]
    FrozenSensor {
        /// Which of the two.
        sensor: &'static str,
        /// How long it repeats one reading, at most, seconds.
        secs: f64,
        /// Length of the recording, seconds.
        of_secs: f64,
    },
    /// An axis of the accelerometer does not read what is felt along it.
    #[error(
        "{path}: where the accelerometer reads 1 along its {axis} axis, the localized images give {x:+.2}, {y:+.2}, {z:+.2} along x, y, z: check the accelerometer's axes, their signs and units, and the IMU's pose in the rig file", path = path.display(), x = felt[0], y = felt[1], z = felt[2]
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
        "{path}: with half of the map's points withheld, the {frames} poses move by {moved_m:.2} m, and images and IMU contradict each other: {imu}", path = path.display()
    )]
    ImuContradicts {
        /// The recording.
        path: PathBuf,
        /// Poses that were found.
        frames: usize,
        /// How far halves of the map move them in the middle, metres.
        moved_m: f64,
        /// What the walk makes of its IMU, and what to do.
        imu: String,
    },
    /// Next to nothing of a walk was recognised on its own, and nothing else tells whether the map has it where it was.
    #[error(
        "{path}: {recognised} of {frames} images were recognised on their own (min_recognised_share is {needed_share}), the {points} map points that should be in view are not conclusive ({absent_percent:.0} % of the evidence says that they are absent), and with half of the map's points withheld the poses move by {moved_m:.2} m: this is another place that has something in common with the map, or the map covers too little of the walk; check that it is the map of this place, and map it along the walk", path = path.display()
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
    #[error(
        "{stage}: did not converge within {iterations} iterations: raise solve.max_iterations, and check IMU axes, time stamps and intrinsics of the rig file"
    )]
    NotConverged {
        /// What was solved.
        stage: &'static str,
        /// Iterations in all.
        iterations: usize,
    },
    /// The IMU leaves a time open that is to be integrated over.
    #[error(
        "no IMU samples from {from} s to {to} s (the longest gap allowed is {longest_secs} s): record the IMU without gaps"
    )]
    ImuGap {
        /// Last instant before the gap.
        from: Timestamp,
        /// First instant after it.
        to: Timestamp,
        /// Longest gap that is bridged, seconds.
        longest_secs: f64,
    },
    /// A line of a list of loops cannot be used.
    #[error("{path}:{line}: {reason}", path = path.display())]
    LoopLine {
        /// The file.
        path: PathBuf,
        /// Which line, from 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// A line of a list of clicks cannot be used.
    #[error("{path}:{line}: {reason}", path = path.display())]
    ClickLine {
        /// The file.
        path: PathBuf,
        /// Which line, from 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// A line of a list of control points cannot be used.
    #[error("{path}:{line}: {reason}", path = path.display())]
    ControlPointLine {
        /// The file.
        path: PathBuf,
        /// Which line, from 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// Control points cannot hold a map.
    #[error("control points: {reason}")]
    ControlPoints {
        /// What is missing, and what to do.
        reason: String,
    },
    /// A trajectory to start from is not that of the recording.
    #[error("{path}: only {share:.0} % of its scans lie within the initial trajectory: give the trajectory of this recording", path = path.display(), share = 100.0 * share)]
    StartElsewhere {
        /// The recording.
        path: PathBuf,
        /// Share of its scans within the trajectory.
        share: f64,
    },
    /// A loop is of a scan that has no pose.
    #[error("no scan has a pose at {time} s: give the loop list of this walk")]
    UnknownScan {
        /// End of the scan.
        time: Timestamp,
    },
    /// A loop is to be closed that was not measured.
    #[error("the loop from {earlier} s to {later} s was not measured: reject it, or add its pose")]
    LoopNotMeasured {
        /// End of the earlier scan.
        earlier: Timestamp,
        /// End of the later scan.
        later: Timestamp,
    },
    /// The progress callback asked for an early end.
    #[error("{0}")]
    Stopped(#[from] lsfb_types::Stopped),
}

fn how_they_meet([pairs, shared, rival]: [usize; 3], sigma_m: f64, scale_shift_m: f64) -> String {
    if !sigma_m.is_finite() {
        return format!("the {pairs} points that look alike do not fit any common alignment");
    }
    format!(
        "of {pairs} points that look alike, {shared} fit one alignment and {rival} another; the best is uncertain by {sigma_m:.3} m, and another scale of the second map moves it by {scale_shift_m:.3} m"
    )
}

/// Why images give too few map points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MapShortage {
    /// The images are blank.
    #[error("{images} images show {features} features: check focus, exposure and lens caps")]
    FewFeatures {
        /// Images.
        images: usize,
        /// Features in all of them.
        features: usize,
    },
    /// Nothing is seen from two places.
    #[error(
        "no two of the {images} images see the same thing from different positions: move between images, since rotation alone gives no depth"
    )]
    NoBaseline {
        /// Images.
        images: usize,
    },
    /// What images share does not agree with their poses.
    #[error(
        "too few matches between {images} images agree with their poses: do they overlap, are these camera poses (world from camera, z forward), and does the calibration belong to them?"
    )]
    Disagreement {
        /// Images.
        images: usize,
    },
}

/// Fewer points localize nobody.
pub(crate) const MIN_MAP_POINTS: usize = 100;
/// An image with fewer features on average sees too little.
pub(crate) const MIN_FEATURES_PER_IMAGE: usize = 50;

impl Error {
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

    /// Names the path in an I/O error: `fs::read(path).map_err(Error::io(path))`.
    pub fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, source }
    }
}
