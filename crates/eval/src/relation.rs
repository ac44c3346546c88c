//! What is compared, and in which unit.

use std::fmt;

use serde::Serialize;

/// Which part of a pose's error counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PoseRelation {
    /// Length of the translation.
    TranslationPart,
    /// Frobenius norm of rotation matrix minus identity.
    RotationPart,
    /// Frobenius norm of the 4×4 matrix minus identity.
    FullTransformation,
    /// Rotation angle in radians.
    RotationAngleRad,
    /// Rotation angle in degrees.
    RotationAngleDeg,
    /// Difference of two distances; for an absolute error the distance itself.
    PointDistance,
    /// `PointDistance` in percent of the true distance; relative errors only.
    PointDistanceErrorRatio,
}

impl PoseRelation {
    /// Unit of the errors.
    pub fn unit(self) -> Unit {
        match self {
            Self::TranslationPart | Self::PointDistance => Unit::Metres,
            Self::RotationAngleDeg => Unit::Degrees,
            Self::RotationAngleRad => Unit::Radians,
            Self::PointDistanceErrorRatio => Unit::Percent,
            Self::RotationPart | Self::FullTransformation => Unit::None,
        }
    }
}

impl fmt::Display for PoseRelation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::TranslationPart => "translation",
            Self::RotationPart => "rotation part",
            Self::FullTransformation => "full transformation",
            Self::RotationAngleRad | Self::RotationAngleDeg => "rotation",
            Self::PointDistance => "point distance",
            Self::PointDistanceErrorRatio => "point distance ratio",
        })
    }
}

/// Unit of an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    /// A pure number.
    None,
    /// Metres.
    Metres,
    /// Degrees.
    Degrees,
    /// Radians.
    Radians,
    /// Per cent.
    Percent,
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::None => "",
            Self::Metres => "m",
            Self::Degrees => "°",
            Self::Radians => "rad",
            Self::Percent => "%",
        })
    }
}

/// What a delta counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DeltaUnit {
    /// Poses.
    Frames,
    /// Metres of path.
    Metres,
    /// Seconds.
    Seconds,
    /// Degrees of rotation.
    Degrees,
    /// Radians of rotation.
    Radians,
}

impl DeltaUnit {
    /// Every unit.
    pub const ALL: [Self; 5] = [
        Self::Frames,
        Self::Metres,
        Self::Seconds,
        Self::Degrees,
        Self::Radians,
    ];

    /// Its name on the command line.
    pub const fn key(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Metres => "metres",
            Self::Seconds => "seconds",
            Self::Degrees => "degrees",
            Self::Radians => "radians",
        }
    }

    /// As it stands behind a number.
    pub fn symbol(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Metres => "m",
            Self::Seconds => "s",
            Self::Degrees => "deg",
            Self::Radians => "rad",
        }
    }
}

impl fmt::Display for DeltaUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.symbol())
    }
}
