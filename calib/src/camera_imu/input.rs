//! What a batch is given.

use lsfb_geometry::ImuNoiseModel;
use lsfb_types::{ImuSample, Timestamp};

use super::{CameraImuConfig, KnownCamera};
use crate::board::Target;

/// What a batch starts from.
#[derive(Clone, Copy)]
pub(super) struct Input<'a> {
    pub target: &'a Target,
    pub cameras: &'a [KnownCamera],
    pub imu: &'a [(Timestamp, ImuSample)],
    pub noise: &'a ImuNoiseModel,
    pub config: &'a CameraImuConfig,
}
