//! Why a camera is not placed, in words.

use super::noise::Noise;

/// Why no pose of a camera is given out.
#[derive(Clone, Copy, Debug, thiserror::Error)]
pub(super) enum Refusal {
    #[error(
        "only {images} images lie within the time of the scans: check the clocks, or record longer"
    )]
    FewImages { images: usize },
    #[error("its images have no content: the camera is covered, in the dark, or lacks contrast")]
    Blank,
    #[error(
        "{corners} image corners lie on surfaces seen by the LiDAR, but {needed} are needed: record a place with pictures, furniture and floor visible to both; or the rig is off by more than 2.5° and 5 cm"
    )]
    FewCorners { corners: usize, needed: usize },
    #[error(
        "the pose did not converge: camera and LiDAR see too little in common, or the rig is off by more than 2.5° and 5 cm"
    )]
    Unsettled,
    #[error(
        "{parts} parts of the recording are usable, but {needed} are needed: record longer, in a place with pictures and furniture"
    )]
    FewParts { parts: usize, needed: usize },
    #[error(
        "corners and surfaces do not match ({:.2} px, {:.0} mm; images {:.2}° and {:.0} mm off the LiDAR's trajectory): the rig is off by more than 2.5° and 5 cm, or the lens or a clock is wrong; look at the overlays, and run `lsfb calib verify`",
        .0.pixel_px, .0.plane_m * 1e3, .0.turn_rad.to_degrees(), .0.shift_m * 1e3
    )]
    PoorFit(Noise),
    #[error(
        "the best pose is {:.1}° and {:.0} mm away, too far to be trusted: start from a rig that is right within 2.5° and 5 cm, or use `lsfb calib lidar-camera`",
        turn_rad.to_degrees(), shift_m * 1e3
    )]
    FarAway { turn_rad: f64, shift_m: f64 },
    #[error(
        "no better pose was found: the transfer error of corners is {before_px:.2} px with the rig and {after_px:.2} px with the best pose"
    )]
    NoBetter { before_px: f64, after_px: f64 },
    #[error(
        "two halves of the recording disagree significantly (χ² = {square:.1} with 6 degrees of freedom; limit exceeded by chance in one of ten thousand): something moved, or a clock is wrong"
    )]
    HalvesDisagree { square: f64 },
}
