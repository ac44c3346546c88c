//! How recordings are kept: files, disks, queue.

use std::path::PathBuf;

use lsfb_recording::{Compression, Durability, Existing};
use lsfb_types::Bounds;
use serde::{Deserialize, Serialize};

/// What is kept of a LiDAR.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LidarData {
    /// Packets as received, and the clouds made of them.
    #[default]
    Both,
    /// Packets alone: less on the disk, and clouds are made of them again when the recording is replayed.
    Packets,
    /// Clouds alone: firings without an echo are gone.
    Clouds,
}

/// How recordings are kept.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecorderConfig {
    /// Compression of the chunks.
    pub compression: Compression,
    /// What the recording survives while it is being written; the disk is at most a second or two behind in any case.
    pub durability: Durability,
    /// What happens to a recording of the same name.
    pub existing: Existing,
    /// What is kept of LiDARs.
    pub lidar_data: LidarData,
    /// Largest size of a chunk before compression, bytes.
    pub chunk_bytes: u64,
    /// A new file after this many bytes; 0 never.
    pub split_bytes: u64,
    /// A new file after this many seconds; 0 never.
    pub split_secs: f64,
    /// Folder on another disk, to go on with when the first is nearly full; relative to the file that names it.
    pub second_folder: Option<PathBuf>,
    /// A disk with less room than this is full, bytes: enough to close a recording.
    pub reserve_bytes: u64,
    /// A recording is not begun with room for less than this, seconds; 0 begins in any case.
    pub least_space_secs: f64,
    /// Bytes per second to reckon with before the first are written; 0 takes what the devices send at most.
    pub expected_bytes_per_sec: f64,
    /// Memory between the devices and the disk, bytes.
    pub queue_bytes: u64,
}

impl Default for RecorderConfig {
    /// One file, `lz4`, room for ten minutes, some seconds of the whole rig in memory.
    fn default() -> Self {
        Self {
            compression: Compression::default(),
            durability: Durability::default(),
            existing: Existing::Refuse,
            lidar_data: LidarData::Both,
            chunk_bytes: 4 << 20,
            split_bytes: 0,
            split_secs: 0.0,
            second_folder: None,
            reserve_bytes: 256 << 20,
            least_space_secs: 600.0,
            expected_bytes_per_sec: 0.0,
            queue_bytes: 384 << 20,
        }
    }
}

lsfb_types::bounds! {
    RecorderConfig {
        compression: any,
        durability: any,
        existing: any,
        lidar_data: any,
        chunk_bytes: number(Bounds::AT_LEAST_ONE),
        split_bytes: any,
        split_secs: number(Bounds::NOT_NEGATIVE),
        second_folder: any,
        reserve_bytes: any,
        least_space_secs: number(Bounds::NOT_NEGATIVE),
        expected_bytes_per_sec: number(Bounds::NOT_NEGATIVE),
        queue_bytes: number(Bounds::AT_LEAST_ONE),
    }
}
