//! Devices to one Recording.
//!
//! - [`Session`] opens the devices that a [`DevicesConfig`] names and records them until they end or are told to stop.
//! - One named thread per device decodes what its driver yields and puts stamps on it; one thread writes. Between them is one
//!   bounded queue: what does not fit is dropped, counted and reported (see [`Overflow`]).
//! - [`replay`] sends the packets of a capture file through the very functions used live.
//! - [`record_incoming`] does so with the packets of a whole rig that come from somewhere else, arrivals included.
//! - [`clock`] is the only place in the workspace that turns device ticks into a `Timestamp`.
//!
//! ```no_run
//! use std::path::Path;
//! use lsfb_capture::{DevicesConfig, Session};
//!
//! let config = DevicesConfig::read(Path::new("devices.toml"))?;
//! let report = Session::open(&config)?.run(Path::new("scan.mcap"), &lsfb_types::no_progress)?;
//! println!("{} messages, {} lost", report.messages, report.lost);
//! # Ok::<(), lsfb_capture::Error>(())
//! ```

mod camera;
pub mod clock;
mod config;
mod control;
mod counted;
mod device_note;
pub mod doctor;
mod entry;
mod error;
mod feed;
mod grey;
pub mod health;
mod imu;
mod incoming;
mod lidar;
mod order;
mod pace;
mod poses;
mod receipt;
mod recorder;
mod remark;
mod replay;
mod report;
mod session;
mod sidecar;
mod sync;
mod tap;
mod threads;
mod topics;
pub mod walks;
mod wifi_scans;

pub use config::{
    CameraUnitConfig, DevicesConfig, ImuLineConfig, LidarData, LidarNetConfig, LidarSettingsConfig,
    Overflow, RecorderConfig, SidecarConfig,
};
pub use control::Counts;
pub use error::Error;
pub use feed::{Feed, Feeder};
pub use incoming::{Incoming, record_incoming};
pub use poses::Poses;
pub use recorder::Latencies;
pub use remark::Remarks;
pub use replay::{ReplayConfig, ReplayedSensor, replay, replay_recording};
pub use report::{CaptureReport, Ending, StreamReport};
pub use session::Session;
pub use sidecar::{INVITATION, PairingFolder, PhonesListener};
pub use sync::GroupReport;
// The families of units are the drivers'; a list of devices names one.
pub use lsfb_drivers::ImuFamily;
pub use tap::{Tap, TapClosed, Tapped};
