//! What is taken from a bag: topics of LiDARs, samples of an IMU, and what could not be read.

use lsfb_recording::message::holds_lidar_packets;
use lsfb_types::{ImuSample, Timestamp};

use super::CLOUD;

/// What a topic of a LiDAR carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LidarMessages {
    /// Clouds of points.
    Clouds,
    /// Packets as the sensor sent them.
    Packets,
}

/// A topic of a LiDAR.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LidarTopic {
    /// Its name.
    pub topic: String,
    /// What it carries.
    pub messages: LidarMessages,
}

/// The samples of an IMU.
#[derive(Clone, Debug, PartialEq)]
pub struct BagImu {
    /// Its topic.
    pub topic: String,
    /// The frame in which it measures, as the first message has it.
    pub frame: String,
    /// Stamps and samples in the order of the bag.
    pub samples: Vec<(Timestamp, ImuSample)>,
    /// Messages that are not among them.
    pub unread: Unread,
}

/// Messages of a bag that could not be read and were passed over.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Unread {
    /// How many: of messages, or of chunks of them.
    pub count: u64,
    /// Where the first is, and what is wrong with it.
    pub first: Option<String>,
}

impl Unread {
    pub(super) fn note(&mut self, problem: String) {
        self.count += 1;
        self.first.get_or_insert(problem);
    }
}

/// What messages of a type carry of a LiDAR; nothing where it is another type.
pub(super) fn lidar_messages(kind: &str) -> Option<LidarMessages> {
    if kind == CLOUD {
        Some(LidarMessages::Clouds)
    } else if holds_lidar_packets(&kind.replacen('/', "/msg/", 1)) {
        Some(LidarMessages::Packets)
    } else {
        None
    }
}
