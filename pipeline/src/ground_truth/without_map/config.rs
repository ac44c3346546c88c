use lsfb_types::Bounds;
use serde::{Deserialize, Serialize};

use super::RevisitConfig;
use crate::ground_truth::GroundTruthConfig;
use crate::ground_truth::config::BENDING_SIGMAS;

/// Parameters of the motion of a walk without a map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MotionConfig {
    /// Features are followed through all images; instants at least so far apart become frames, and get poses, seconds.
    pub frame_secs: f64,
    /// A frame with fewer sights of placed points is carried by the IMU alone.
    pub min_sights: usize,
    /// Longest time from one frame with enough sights to the next, seconds; what lies within a longer one is left out.
    pub max_blind_secs: f64,
    /// Longest pause of the IMU that is bridged by images and by what bodies do, seconds: a longer one parts the walk, and its longest part
    /// alone is computed.
    pub max_imu_gap_secs: f64,
    /// How many times larger the IMU's noise is taken for the covariances where too little is followed for longer than that: no track
    /// corrects its scale, axes and clock there.
    pub blind_imu_noise_factor: f64,
    /// Largest standard deviation, in its worst direction and relative to the first pose, of a position that is exported, metres.
    pub max_position_sigma_m: f64,
    /// Share of the followed sights that fit no point beyond which the walk is doubtful.
    pub doubtful_contradicted_share: f64,
    /// Standard deviations that a camera may be from what the rig file says of it before the motion counts as bent by it.
    pub max_camera_off_sigmas: f64,
    /// Places that the walk comes back to.
    pub revisits: RevisitConfig,
    /// The adjustment; what it says of a map is not used. Nothing but its `inertial` holds the walk's scale.
    pub adjustment: GroundTruthConfig,
}

impl Default for MotionConfig {
    fn default() -> Self {
        Self {
            frame_secs: 0.1,
            min_sights: 8,
            max_blind_secs: 0.5,
            max_imu_gap_secs: 0.2,
            blind_imu_noise_factor: 4.0,
            max_position_sigma_m: 1.0,
            doubtful_contradicted_share: 0.2,
            max_camera_off_sigmas: BENDING_SIGMAS,
            revisits: RevisitConfig::default(),
            adjustment: GroundTruthConfig::default(),
        }
    }
}

lsfb_types::bounds! {
    MotionConfig {
        frame_secs: number(Bounds::POSITIVE),
        min_sights: any,
        max_blind_secs: number(Bounds::POSITIVE),
        max_imu_gap_secs: number(Bounds::POSITIVE),
        blind_imu_noise_factor: number(Bounds::AtLeast(1.0)),
        max_position_sigma_m: number(Bounds::POSITIVE),
        doubtful_contradicted_share: number(Bounds::Within(0.0, 1.0)),
        max_camera_off_sigmas: number(Bounds::POSITIVE),
        revisits: section,
        adjustment: section,
    }
}
