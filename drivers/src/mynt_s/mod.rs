//! Mynt Eye S2 stereo units (S2100, S2110, S200B): two global-shutter cameras and an IMU behind one USB 3 plug.
//!
//! Wiring: one unit per USB 3 root port, no hub; `udev/70-lsfb-camera.rules` names the capture node by its port, since
//! units of one batch may share a USB serial string. The true serial is read through the extension unit and compared
//! with the configured one: swapped cables are swapped extrinsics.
//!
//! Images come as one YUYV frame, left and right side by side (units of any number of cameras are read alike), with a trailer that carries the frame counter, the
//! unit's microseconds, and the exposure. Options, device information and the unit's own IMU go through extension
//! unit transactions. The trailer lies over the last 8 pixels of the last image's bottom row.
//!
//! [`MyntCamera`] configures a unit and yields frames, [`Decoder`] turns frames into images, [`ImuDecoder`] turns
//! IMU answers into samples, [`wire`] speaks all of it in both directions.

mod decode;
mod device;
mod imu_decode;
mod mock;
pub mod model;
pub mod wire;

pub use decode::{
    ChecksumRule, Decoder, DecoderConfig, FrameCounters, StampInstant, Trigger, UnitFrame,
};
pub use device::{CameraConfig, Exposure, MyntCamera};
pub use imu_decode::{ImuCounters, ImuDecoder};
