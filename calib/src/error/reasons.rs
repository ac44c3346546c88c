//! What is wrong with boards, images, stamps, motions and samples.

use std::fmt;

use lsfb_types::Finding;

use super::join::also_words;

/// Why a board cannot be.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TargetProblem {
    /// A number that must be above zero.
    #[error("{what} is {value}, but must be positive")]
    NotPositive {
        /// Whose number it is.
        what: &'static str,
        /// The number.
        value: f64,
    },
    /// An edge that nobody could print.
    #[error("{what} of {edge_m} m is smaller than a millimetre")]
    TooSmall {
        /// Whose edge it is.
        what: &'static str,
        /// The edge, metres.
        edge_m: f64,
    },
    /// An edge that looks as if it were in millimetres.
    #[error("{what} of {edge_m} m: lengths are in metres; for {edge_m} mm write {}", edge_m / 1e3)]
    TooLarge {
        /// Whose edge it is.
        what: &'static str,
        /// The edge, metres.
        edge_m: f64,
    },
    /// A number of tags that the family does not have.
    #[error("{columns} × {rows} tags: expected 1 to {most}")]
    Tags {
        /// Along x.
        columns: u32,
        /// Along y.
        rows: u32,
        /// Tags that the family has.
        most: u32,
    },
    /// A number of inner corners that is none of a checkerboard.
    #[error("{columns} × {rows} inner corners: expected 2 to 100")]
    InnerCorners {
        /// Along x.
        columns: u32,
        /// Along y.
        rows: u32,
    },
    /// A number of squares that is none of a ChArUco board.
    #[error("{columns} × {rows} squares: expected at least 3 × 3 and at most {most} white ones")]
    Squares {
        /// Along x.
        columns: u32,
        /// Along y.
        rows: u32,
        /// Markers that a dictionary has.
        most: u32,
    },
    /// Markers that hide the corners of their squares.
    #[error(
        "markers of {marker_m} m in squares of {square_m} m: at most 0.9 of the square keeps its corners visible"
    )]
    LargeMarkers {
        /// Edge of a marker, metres.
        marker_m: f64,
        /// Edge of a square, metres.
        square_m: f64,
    },
    /// A page that no PDF can have.
    #[error("a page of {} × {} m: at most {most_m:.2} m are possible", page_m[0], page_m[1])]
    Page {
        /// Width and height, metres.
        page_m: [f64; 2],
        /// The most, metres.
        most_m: f64,
    },
    /// A pattern that is larger than the page.
    #[error(
        "the pattern is {:.0} × {:.0} mm and the page {:.0} × {:.0} mm: choose a larger page or smaller squares",
        pattern_m[0] * 1e3, pattern_m[1] * 1e3, page_m[0] * 1e3, page_m[1] * 1e3
    )]
    LargePattern {
        /// Width and height of the pattern, metres.
        pattern_m: [f64; 2],
        /// Width and height of the page, metres.
        page_m: [f64; 2],
    },
    /// A plate that does not hold the pattern.
    #[error(
        "a plate of {:.0} × {:.0} mm is too small for corners over {:.0} × {:.0} mm: give its width along the pattern's x axis, then its height",
        plate_m[0] * 1e3, plate_m[1] * 1e3, corners_m[0] * 1e3, corners_m[1] * 1e3
    )]
    SmallPlate {
        /// Width and height of the plate, metres.
        plate_m: [f64; 2],
        /// Extent of the corners, metres.
        corners_m: [f64; 2],
    },
}

/// What is seen instead of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SeenInstead {
    /// The board, mirrored.
    #[error("{images} show its tags mirrored")]
    Mirrored {
        /// Images that show it.
        images: usize,
    },
    /// Tags of another board.
    #[error("{images} show other tags: of another family than 36h11, or not numbered from 0")]
    OtherTags {
        /// Images that show them.
        images: usize,
    },
}

/// Numbers that are right in other units only.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WrongUnit {
    /// Stamps in a unit that is known.
    #[error("stamps are {step} ns apart and look like {unit}")]
    Stamps {
        /// Median distance of neighbours, as they are.
        step: i64,
        /// What they look like.
        unit: &'static str,
    },
    /// Numbers that are no stamps in any unit.
    #[error("numbers that are {step} apart are not stamps")]
    NoStamps {
        /// Median distance of neighbours.
        step: i64,
    },
    /// Angular velocities that no hand reaches.
    #[error(
        "a tenth of its samples are above {rate_rad_s:.0} rad/s: they are in degrees per second"
    )]
    Degrees {
        /// What a tenth of the samples exceeds, read as radians per second.
        rate_rad_s: f64,
    },
}

/// What a motion lacks.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PoorMotion {
    /// The board is in no image.
    #[error("the target is never visible")]
    NothingSeen,
    /// Every turn has one axis.
    #[error("it rotates about one axis only")]
    OneAxis,
    /// Some axes are hardly turned about.
    #[error("it rotates too little about {}", axes_words(axes))]
    FewTurns {
        /// The axes with their angular velocities, rad/s rms.
        axes: Vec<(&'static str, f64)>,
        /// Angular velocity needed, rad/s rms.
        needed_rad_s: f64,
    },
}

fn axes_words(axes: &[(&str, f64)]) -> String {
    let each = axes
        .iter()
        .map(|(axis, rate)| format!("{axis} ({rate:.3} rad/s rms)"));
    each.collect::<Vec<_>>().join(" and ")
}

/// What is wrong with an IMU's samples.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BadImu {
    /// The accelerometer reads something that is not gravity.
    #[error(
        "the accelerometer reads {mean_m_s2:.2} m/s² on average, where gravity is {gravity_m_s2:.2}{}",
        if *is_in_g { ": it is in units of g" } else { "" }
    )]
    Gravity {
        /// Mean length of its samples.
        mean_m_s2: f64,
        /// Gravity where it is.
        gravity_m_s2: f64,
        /// Whether its samples would be right in g.
        is_in_g: bool,
    },
    /// The gyroscope's axes are mirrored.
    #[error(
        "the gyroscope's axes are left-handed relative to {camera}: one has the wrong sign, or two are swapped"
    )]
    LeftHanded {
        /// The camera.
        camera: String,
    },
    /// The gyroscope turns about other axes than the camera.
    #[error(
        "{camera} and gyroscope rotate equally fast, but about axes that no mounting explains: a gyroscope axis has the wrong scale, or its columns are swapped"
    )]
    OtherAxes {
        /// The camera.
        camera: String,
    },
}

/// Why a recording does not show an IMU's noise. Times are seconds.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NoRest {
    /// There is no sample.
    #[error("there are no samples")]
    NoSample,
    /// A sample is no number.
    #[error("sample {index} is not a number")]
    BadSample {
        /// Its number, from 0.
        index: usize,
    },
    /// It is too short.
    #[error("it lasts {length_s:.1} s")]
    Short {
        /// How long it is.
        length_s: f64,
        /// How long it must be.
        needed_s: f64,
    },
    /// Too many samples are missing.
    #[error("{missing:.0} of {all:.0} samples are missing, so that clusters would be uneven")]
    Missing {
        /// Samples that are missing.
        missing: f64,
        /// With those that are there.
        all: f64,
    },
    /// Samples share their stamps.
    #[error(
        "{repeated} of {all} samples have the same stamp as another one, so that their time is unknown"
    )]
    Repeated {
        /// Samples with the stamp of an earlier one.
        repeated: usize,
        /// Of all.
        all: usize,
    },
    /// It was moved.
    #[error("it moves {after_s:.0} s after the start")]
    Moved {
        /// When, after its start.
        after_s: f64,
    },
}

/// How large a pattern is by the LiDAR.
#[derive(Clone, Debug, PartialEq)]
pub struct PatternExcess {
    /// How much larger it is than said, as a share.
    pub share: f64,
    /// Standard deviation of that.
    pub sigma: f64,
    /// Its edges then, in words.
    pub edges: String,
}

impl fmt::Display for PatternExcess {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            share,
            sigma,
            edges,
        } = self;
        let (percent, sigma_percent) = (share.abs() * 100.0, sigma * 100.0);
        let than = match *share > 0.0 {
            true => "larger",
            false => "smaller",
        };
        write!(
            f,
            "according to the LiDAR, the pattern is {percent:.1} ± {sigma_percent:.1} % {than} than specified: {edges}"
        )
    }
}

/// Why the board is not as large as was said.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WrongSize {
    /// Camera and LiDAR agree on another size, roughly.
    #[error(
        "images of {camera} fit the LiDAR if the pattern is about {factor:.2} times as large, {edges}"
    )]
    OtherScale {
        /// The camera.
        camera: String,
        /// How many times as large it seems.
        factor: f64,
        /// Its edges then.
        edges: String,
    },
    /// Camera and LiDAR agree on another size.
    #[error("{pattern}{}", also_words(also))]
    Measured {
        /// What they agree on.
        pattern: PatternExcess,
        /// What else was found.
        also: Option<Box<Finding>>,
    },
    /// Width and height of the plate are exchanged.
    #[error(
        "the plate's longer side lies along the pattern's {longer_axis} axis in {exchanged} of {poses} poses, but {:.0} × {:.0} mm was given",
        plate_m[0] * 1e3, plate_m[1] * 1e3
    )]
    Exchanged {
        /// Along which axis of the pattern the longer side lies.
        longer_axis: char,
        /// Poses in which it does.
        exchanged: usize,
        /// Poses that tell.
        poses: usize,
        /// Width and height as they were said, metres.
        plate_m: [f64; 2],
    },
}
