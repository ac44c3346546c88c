//! Frames, their trailer, and extension unit transactions: bytes to structs and back.

mod calibration;
mod files;
mod frame;
mod imu;
mod info;
mod options;
#[cfg(test)]
mod tests;
mod xu;

pub use calibration::{
    AxesCalibration, ImageCalibration, ImuCalibration, Intrinsics, StereoCalibration, UnitTransform,
};
pub use files::UnitFile;
pub use frame::{Frame, TimeSource, Trailer, emit_frame};
pub use imu::{ImuProtocol, ImuRequest, ImuResponse, ImuSegment, ImuValues};
pub use info::{DeviceInfo, Version};
pub use options::{CameraOption, OptionCommand, OptionRange, OptionTable};
pub use xu::XuDevice;
