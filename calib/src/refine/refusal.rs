//! Why a camera is not placed, in words.

use super::noise::Noise;

/// Why no pose of a camera is given out.
#[derive(Clone, Copy, Debug, thiserror::Error)]
pub(super) enum Refusal {
    #[error(
        "{images} images lie within the time of the scans, too few: check clocks, or record longer"
    )]
    FewImages { images: usize },
    #[error("its images show nothing: it is covered, dark, or has no contrast")]
    Blank,
    #[error(
        "{corners} corners of images lie on surfaces that the LiDAR saw, {needed} are needed: record a place with pictures, furniture and floor in sight of both, or the rig is farther off than 2.5° and 5 cm"
    )]
    FewCorners { corners: usize, needed: usize },
    #[error(
        "the search for the pose did not settle: too little is seen by both, or the rig is farther off than 2.5° and 5 cm"
    )]
    Unsettled,
    #[error(
        "{parts} parts of the recording say something, {needed} are needed: record longer, in a place with pictures and furniture"
    )]
    FewParts { parts: usize, needed: usize },
    #[error(
        "corners and surfaces do not fit on each other ({:.2} px, {:.0} mm; images {:.2}° and {:.0} mm off the LiDAR's way): the rig is farther off than 2.5° and 5 cm, or the lens or a clock is wrong; look at the overlays, and run `lsfb calib verify`",
        .0.pixel_px, .0.plane_m * 1e3, .0.turn_rad.to_degrees(), .0.shift_m * 1e3
    )]
    PoorFit(Noise),
    #[error(
        "the best pose is {:.1}° and {:.0} mm away, farther than can be vouched for: start from a rig that is right within 2.5° and 5 cm, or use `lsfb calib lidar-camera`",
        turn_rad.to_degrees(), shift_m * 1e3
    )]
    FarAway { turn_rad: f64, shift_m: f64 },
    #[error(
        "no better pose was found: corners are {before_px:.2} px off as the rig was and {after_px:.2} px with the best pose"
    )]
    NoBetter { before_px: f64, after_px: f64 },
    #[error(
        "two halves of the recording disagree, beyond what one in ten thousand would ({square:.1} σ² for 6 numbers): something moved, or a clock is wrong"
    )]
    HalvesDisagree { square: f64 },
}
