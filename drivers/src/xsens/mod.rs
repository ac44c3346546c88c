//! Xsens MTi inertial units speaking the Xbus protocol with MTData2 packets over a serial line or USB.
//!
//! Wiring: serial units at 921 600 baud or more (a 60-byte packet takes 5 ms at 115 200), USB units at any baud. The
//! rules in `udev/70-lsfb-imu.rules` name the line `/dev/lsfb/imu_xsens_<serial>` and keep the modem manager away.
//! The unit stamps samples with `SampleTimeFine` (100 µs); with PPS on its SyncIn line it also sends exact UTC.
//!
//! [`XsensImu`] configures the unit and yields its bytes, [`Decoder`] turns them into samples, [`wire`] speaks the
//! protocol in both directions. A mock unit finds the host's requests with a [`Framer`] of its own.

mod decode;
mod device;
pub mod model;
pub mod wire;

pub use decode::{Decoder, DecoderConfig, FramedMessage, Framer, ImuCounters, ImuReading};
pub use device::{DeviceId, ImuConfig, XsensImu};
