//! Why two sensors cannot be joined.

use lsfb_types::Finding;

use super::missed;

/// What two sensors lack to be joined; what to do about it is in the finding, or here where the input is wrong. Times are seconds.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum JoinProblem {
    /// A rig names one camera twice.
    #[error("a camera is named twice")]
    NamedTwice,
    /// One is joined to itself.
    #[error("a transform joins two different sensors")]
    SameSensor,
    /// No transforms lead from one to the other.
    #[error(
        "no chain of transforms connects them: add one between a camera and the IMU (from a rig, or from `lsfb calib camera-imu`)"
    )]
    NoChain,
    /// There is no transform at all.
    #[error("no transform was given")]
    NoTransform,
    /// One measurement is there twice.
    #[error("the same transform is given twice and would count as two measurements: leave one out")]
    GivenTwice,

    /// Two cameras see the board together too seldom.
    #[error("both see the target at {shared} instants")]
    FewInstants {
        /// Instants at which both see it.
        shared: usize,
        /// Instants needed.
        needed: usize,
    },
    /// Poses of two cameras agree if the board is turned by half a turn for one.
    #[error(
        "they see the board from opposite ends: the board is upside down for one of them, or one camera is mounted upside down"
    )]
    OppositeEnds,
    /// Images of two cameras are paired wrongly.
    #[error(
        "their pairs are shifted: images of the second camera belong to those that the first took {} {}; they are not triggered together, or one of them lost images before they were numbered",
        instants(*by), if *by > 0 { "before" } else { "after" }
    )]
    ShiftedPairs {
        /// Instants by which the second is late.
        by: i64,
    },
    /// Images of two cameras were exchanged part of the time.
    #[error(
        "their images are swapped at {exchanged} of {shared} instants, from {first_instant} to {last_instant}: cables, names or device numbers were exchanged in between"
    )]
    Exchanged {
        /// Instants at which they are.
        exchanged: usize,
        /// Instants at which both see the target.
        shared: usize,
        /// The first of those, as its images are numbered or stamped.
        first_instant: i64,
        /// The last of them.
        last_instant: i64,
    },
    /// Cameras that fit alone do not fit together.
    #[error(
        "each camera fits by itself, but together {}: they are not triggered together, their stamps are wrong, or one of them is loose",
        missed(*rms_px)
    )]
    MissTogether {
        /// Root mean square of the reprojection error of all together, pixels.
        rms_px: f64,
    },
    /// Two cameras fit each other's place on the rig.
    #[error("their views are swapped: each fits the other's pose in the rig")]
    Swapped,
    /// Two cameras are not where the rig has them.
    #[error(
        "relative to each other they are {:.1}° and {:.0} mm off the rig",
        turn_rad.to_degrees(), shift_m * 1e3
    )]
    Misplaced {
        /// Angle between both poses, radians.
        turn_rad: f64,
        /// Distance between both poses, metres.
        shift_m: f64,
    },

    /// The IMU has no sample.
    #[error("there are no IMU samples")]
    NoSample,
    /// The IMU has a sample that is no number.
    #[error("the IMU sample at {time_s:.3} s is not a number")]
    BadSample {
        /// Since the first sample.
        time_s: f64,
    },
    /// Samples of the IMU share their stamps.
    #[error(
        "{repeated} of {all} IMU samples have the same stamp as another one, so that their time is unknown"
    )]
    RepeatedStamps {
        /// Samples with the stamp of an earlier one.
        repeated: usize,
        /// Of all.
        all: usize,
    },
    /// The IMU measured while the camera saw nothing.
    #[error("only {samples} of the samples from {length_s:.1} s lie within {within_s} s of a view")]
    FewSamples {
        /// Samples near views.
        samples: usize,
        /// Length of all samples.
        length_s: f64,
        /// How near a view they must be.
        within_s: f64,
        /// Samples needed.
        needed: usize,
    },
    /// The camera saw the board while the IMU did not measure.
    #[error("only {pairs} pairs of neighbouring views lie within the IMU's {length_s:.1} s")]
    FewRates {
        /// Pairs of views.
        pairs: usize,
        /// Length of the IMU's samples.
        length_s: f64,
        /// Pairs needed.
        needed: usize,
    },
    /// The offset between two clocks is another at the end than at the start.
    #[error(
        "their clocks are not synchronised: the offset is {:.1} ms in the first half and {:.1} ms in the second",
        first_half_s * 1e3, second_half_s * 1e3
    )]
    ClocksDrift {
        /// Offset in the first half.
        first_half_s: f64,
        /// Offset in the second half.
        second_half_s: f64,
    },
    /// The offset between two clocks is larger than was to be searched.
    #[error(
        "their clocks are not synchronised: the rotations agree if {offset_s:+.2} s are added to the camera's stamps"
    )]
    FarOffset {
        /// The offset.
        offset_s: f64,
        /// The largest that was searched.
        largest_s: f64,
    },
    /// A gyroscope in degrees per second.
    #[error("camera and gyroscope rotate alike if its samples are in degrees per second")]
    InDegrees,
    /// No offset makes a camera and the gyroscope turn alike.
    #[error(
        "the rotations of camera and gyroscope do not agree at any offset within {within_s} s ({:.0} % agreement): their clocks are not synchronised, a clock jumps, or one of them belongs to another device",
        100.0 * agreement.max(0.0)
    )]
    TurnApart {
        /// Offsets that were tried.
        within_s: f64,
        /// Share of the turning that agrees with the best of them.
        agreement: f64,
    },
    /// Camera and gyroscope turn alike once the rows of its images are taken to be exposed one after the other.
    #[error(
        "rolling shutter detected: the rotation fits the gyroscope with a readout of about {:.0} ms, not with the {:.0} ms in the rig",
        1e3 * found_s, 1e3 * known_s
    )]
    RollingShutter {
        /// Readout time of the rig.
        known_s: f64,
        /// Readout time that fits, to a few milliseconds.
        found_s: f64,
    },
    /// Views fit alone, but not along one motion with the IMU.
    #[error(
        "reprojection error is {alone_px:.1} px for each view alone, but {together_px:.1} px along one motion with the IMU: an axis of the accelerometer has the wrong sign or is swapped, the images are mirrored, or the size of the board is very wrong"
    )]
    MissAlongMotion {
        /// Median error of views alone, pixels.
        alone_px: f64,
        /// Median error of all along one motion, pixels.
        together_px: f64,
    },

    /// The camera never sees the board.
    #[error("the target was found in 0 of {images} images")]
    NotSeen {
        /// Images looked at.
        images: usize,
    },
    /// No cloud has the number of an image.
    #[error(
        "{images} images with the board and {clouds} clouds, but no image has the number of a cloud"
    )]
    NoSameNumber {
        /// Images with the board.
        images: usize,
        /// Clouds.
        clouds: usize,
    },
    /// Scans and images are of different times.
    #[error(
        "{scans} scans and {seen} of {images} images with the board, but none at the same time"
    )]
    NoSameTime {
        /// Scans.
        scans: usize,
        /// Images with the board.
        seen: usize,
        /// Images looked at.
        images: usize,
    },
    /// The board is never at rest.
    #[error("{scans} scans and {seen} images with the board, but it always moves too fast")]
    AlwaysMoving {
        /// Scans.
        scans: usize,
        /// Images with the board.
        seen: usize,
    },
    /// Returns of a board do not span a plane.
    #[error("its points lie on a line")]
    PointsOnALine,
    /// What looks like the board in scans is not where the camera sees it.
    #[error(
        "patches like the board were found in {found} of {scans} scans, but no transform puts {needed} of them where the camera sees it"
    )]
    NoTransformFits {
        /// Scans with such a patch.
        found: usize,
        /// Scans looked at.
        scans: usize,
        /// Scans that must agree.
        needed: usize,
    },
    /// Too few poses of the board agree.
    #[error("{left} poses remain")]
    FewPoses {
        /// Poses that agree.
        left: usize,
        /// Poses needed.
        needed: usize,
    },
    /// The weights of camera and LiDAR were made anew without end.
    #[error("the camera/LiDAR weighting did not converge")]
    WeightsUnsettled,
    /// Both sensors have the board at different places.
    #[error(
        "board centres are {:.0} mm apart at the best fit of both sensors: images and scans do not belong together, or the board's size is wrong{}",
        rms_m * 1e3, also_words(also)
    )]
    MiddlesApart {
        /// Root mean square of the distances, metres.
        rms_m: f64,
        /// What else was found.
        also: Option<Box<Finding>>,
    },

    /// The rig has no LiDAR.
    #[error("the rig has no LiDAR: add its pose as measured by hand")]
    NoLidar,
    /// The recording has other cameras than the rig.
    #[error("none of the rig's cameras is in the recording")]
    NoCamera,
    /// The recording has no scans.
    #[error("the recording has no scans")]
    NoScans,
    /// The scans last too short a time.
    #[error("{length_s:.1} s of scans are too short")]
    ShortScans {
        /// Length of the scans.
        length_s: f64,
        /// Length needed.
        needed_s: f64,
    },
    /// Scans cannot be registered to each other.
    #[error(
        "scans cannot be registered to each other: the LiDAR sees too few surfaces, or moves too fast"
    )]
    ScansUnregistered,
}

fn instants(by: i64) -> String {
    match by.abs() {
        1 => "one instant".to_owned(),
        n => format!("{n} instants"),
    }
}

/// What else was found, behind the sentence.
pub(super) fn also_words(also: &Option<Box<Finding>>) -> String {
    also.as_ref()
        .map_or_else(String::new, |finding| format!("; {}", finding.what))
}
