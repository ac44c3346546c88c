//! What every crate shares: [`Timestamp`], [`Packet`], the samples, [`Progress`], [`Judgement`], the
//! [`Bounds`] of settings, and what the [`median`] of some numbers is.
//!
//! No dependency, no logic beyond exact integer time, medians, and how verdicts are put into words. Vectors are plain arrays here;
//! `lsfb-geometry` gives them algebra. With the feature `serde`, verdicts and units stand in JSON.
//!
//! Samples carry no time of their own: a decoder knows only device ticks. [`Stamped`] adds the three stamps
//! (device, arrival, synchronized) that the recording keeps side by side and never overwrites.

mod bounds;
mod names;
mod packet;
mod progress;
mod ros_packets;
mod sample;
mod stamp_unit;
mod statistics;
mod timestamp;
mod verdict;

pub use bounds::{Bounds, OutOfBounds, setting_name};
pub use names::Names;
pub use packet::Packet;
pub use progress::{Progress, ProgressFn, SharedProgress, Stopped, no_progress, until};
pub use ros_packets::RosPackets;
pub use sample::{Echo, Image, ImuSample, LidarPoint, LidarScan, STANDARD_GRAVITY_M_S2, Stamped};
pub use stamp_unit::StampUnit;
pub use statistics::{median, quantile};
pub use timestamp::Timestamp;
pub use verdict::{Finding, Judgement, Limit, Verdict};
