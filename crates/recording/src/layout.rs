use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// Compression of the chunks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Compression {
    /// As they are.
    None,
    /// Fast; keeps up with four cameras on one core.
    #[default]
    Lz4,
    /// Smaller and slower.
    Zstd,
}

/// What a recording in progress survives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Durability {
    /// The end of the process: every closed chunk is with the operating system.
    #[default]
    Process,
    /// The end of the machine: every closed chunk is on the disk.
    Power,
}

/// What happens to a file that is already there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Existing {
    /// It is replaced.
    #[default]
    Replace,
    /// It stays, and there is no recording.
    Refuse,
}

/// How a recording is laid out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WriterConfig {
    /// Largest size of a chunk before compression, bytes. A larger message has a chunk of its own.
    pub chunk_bytes: u64,
    /// Longest time in one chunk, seconds: what a crash may cost.
    pub chunk_secs: f64,
    /// Compression of the chunks.
    pub compression: Compression,
    /// Level of `zstd`: 1 (fast) to 19 (small).
    pub zstd_level: i32,
    /// What the recording survives while it is being written.
    pub durability: Durability,
    /// What happens to a file of the same name.
    pub existing: Existing,
    /// Entries of the metadata record `lsfb.session`: `uuid`, `seed`, `operator`, `site` … The software's version is added.
    pub session: BTreeMap<String, String>,
}

impl Default for WriterConfig {
    fn default() -> Self {
        Self {
            chunk_bytes: 4 << 20,
            chunk_secs: 1.0,
            compression: Compression::default(),
            zstd_level: 1,
            durability: Durability::default(),
            existing: Existing::default(),
            session: BTreeMap::new(),
        }
    }
}

/// What a topic carries.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicSummary {
    /// Its name.
    pub topic: String,
    /// Name of the message type, `package/msg/Type`.
    pub schema: String,
    /// Messages on it; 0 where a recording without summary does not tell.
    pub messages: u64,
}

/// What was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Summary {
    /// The file.
    pub path: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// Messages on all topics.
    pub messages: u64,
    /// The topics, by name.
    pub topics: Vec<TopicSummary>,
}

/// A topic whose messages arrive ready-made.
#[derive(Clone, Copy, Debug)]
pub struct Channel<'a> {
    /// Its name.
    pub topic: &'a str,
    /// Name of the message type, `package/msg/Type`.
    pub schema_name: &'a str,
    /// Its `ros2msg` definition.
    pub schema_text: &'a str,
}
