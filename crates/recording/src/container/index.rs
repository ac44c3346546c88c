//! What is where in a file.

use std::collections::{BTreeMap, BTreeSet};

use crate::container::record::{ChannelRecord, NamedRecord, SchemaRecord};
use crate::error::Damage;

/// A chunk: where it is and what is in it.
#[derive(Clone, Debug)]
pub(crate) struct ChunkEntry {
    pub offset: u64,
    /// Its size, head included.
    pub record_bytes: u64,
    pub start_time: u64,
    pub end_time: u64,
    pub channels: BTreeSet<u16>,
    /// Size of the message indices that follow it.
    pub index_bytes: u64,
}

#[derive(Default)]
pub(crate) struct Index {
    pub schemas: BTreeMap<u16, SchemaRecord>,
    pub channels: BTreeMap<u16, ChannelRecord>,
    pub chunks: Vec<ChunkEntry>,
    pub attachments: Vec<NamedRecord>,
    pub metadata: Vec<NamedRecord>,
    pub messages_by_channel: BTreeMap<u16, u64>,
    pub damage: Vec<Damage>,
}

impl Index {
    pub fn add_schema(&mut self, schema: SchemaRecord) {
        self.schemas.entry(schema.id).or_insert(schema);
    }

    pub fn add_channel(&mut self, channel: ChannelRecord) {
        self.channels.entry(channel.id).or_insert(channel);
    }
}
