//! Simulated devices that speak real bytes: what the drivers would meet on real hardware.
//!
//! A [`SimSession`] runs one named thread per device. All follow one simulated clock: none runs further ahead of the
//! slowest than a set time, and nothing starts before every device has its host.

mod clock;
mod emission;
mod feed;
mod glasses;
mod host;
mod imu;
mod inertial;
mod lidar;
mod mip;
mod mynt;
mod outbox;
mod playback;
mod position;
mod rig_link;
mod session;
mod thread;

pub use clock::Pace;
pub use emission::{Emitted, ScanEmission, WalkEmission};
pub use lidar::FlowControl;
pub use playback::{CameraPlan, Playback, PlaybackEndpoints, Turns};
pub use session::{MYNT_UNITS, ScanEndpoints, SessionReport, SimSession, StopHandle};
