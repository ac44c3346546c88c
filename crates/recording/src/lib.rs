#![doc = include_str!("../FORMAT.md")]
//!
//! # Example
//!
//! ```
//! use lsfb_recording::{Recording, Writer, WriterConfig};
//! use lsfb_types::{Image, Stamped, Timestamp};
//!
//! # let folder = tempfile::tempdir()?;
//! # let path = folder.path().join("scan.mcap");
//! let mut writer = Writer::create(&path, &WriterConfig::default())?;
//! let time = Timestamp::from_nanos(1_772_359_200_000_000_000);
//! let sample = Image { width: 4, height: 2, pixels: vec![128; 8], exposure_ns: 5_000_000, frame_id: 1 };
//! writer.write_image("cam0", &Stamped { time, arrival: time + 2_000_000, device_ticks: 17, sample })?;
//! writer.finish()?;
//!
//! let recording = Recording::open(&path)?;
//! for image in recording.images("cam0")? {
//!     assert_eq!(image?.sample.exposure_ns, 5_000_000);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod calibration;
mod cdr;
pub mod cloud;
mod container;
mod error;
mod hash;
mod interval;
mod layout;
pub mod message;
mod message_iter;
mod natural_order;
mod provenance;
mod reader;
mod samples;
mod topic;
mod tum;
mod unit;
mod writer;

pub use calibration::{RecordedCalibration, rig_sha256};
pub use container::encoder::LAST_STAMP;
pub use container::recover::{Recovered, recover};
pub use container::verify::TopicArrivals;
pub use error::{Damage, Error};
pub use hash::sha256_of;
pub use layout::{Channel, Compression, Durability, Existing, Summary, TopicSummary, WriterConfig};
pub use natural_order::sort_naturally;
pub use provenance::{Provenance, READ_ONCE, provenance_path};
pub use reader::{ArrivalRange, CdrMessage, Recording};
pub use samples::{CameraImage, RecordedPacket};
pub use topic::{
    CAMERA_GROUPS, CLOCK_MODELS, DEVICE_TIME, HEALTH, LIDAR_POSITION, ODOM_FRAME, REMARKS, TF,
    lidar_position,
};
pub use tum::{read_tum, write_tum};
pub use unit::{Attachment, CameraUnit, KeptFile};
pub use writer::Writer;
