//! Messages on their way, and the chunk that is being filled with them.

use std::collections::BTreeMap;

use lsfb_types::Timestamp;

use crate::container::emit::{self, IndexEntry};
use crate::container::record::opcode;
use crate::message;

/// Room before the data of a chunk that is written as it is.
pub(crate) const PLAIN: &str = "";

/// A message on its way into the file: its bytes are `bytes` and, behind them, `tail`, which need not be copied together.
#[derive(Clone, Copy)]
pub(crate) struct Outgoing<'a> {
    pub topic: &'a str,
    pub schema_name: &'a str,
    pub schema_text: &'a str,
    pub bytes: &'a [u8],
    pub tail: &'a [u8],
}

impl<'a> Outgoing<'a> {
    pub fn new(topic: &'a str, schema: message::Schema, bytes: &'a [u8]) -> Self {
        Self {
            topic,
            schema_name: schema.name,
            schema_text: schema.text,
            bytes,
            tail: &[],
        }
    }

    pub fn data_bytes(&self) -> u64 {
        (self.bytes.len() + self.tail.len()) as u64
    }
}

/// What stands before a message's bytes.
pub(crate) struct MessageHead {
    pub channel_id: u16,
    pub sequence: u32,
    pub log_time: u64,
    pub publish_time: u64,
}

/// The chunk that is being filled. Its bytes begin with room for the chunk's head, so that it is written as it lies here.
#[derive(Default)]
pub(crate) struct OpenChunk {
    pub bytes: Vec<u8>,
    pub first_arrival: Option<Timestamp>,
    pub start_time: u64,
    pub end_time: u64,
    pub hasher: crc32fast::Hasher,
    pub index: BTreeMap<u16, Vec<IndexEntry>>,
    pub messages: u64,
}

impl OpenChunk {
    /// What is in it, without the room before.
    pub fn data(&self) -> &[u8] {
        let start = emit::chunk_prefix_bytes(PLAIN);
        self.bytes.get(start..).unwrap_or_default()
    }

    /// Call it before anything is put in.
    pub fn open(&mut self, arrival: Timestamp, log_time: u64) {
        if self.bytes.is_empty() {
            self.bytes.resize(emit::chunk_prefix_bytes(PLAIN), 0);
            (self.start_time, self.end_time) = (log_time, log_time);
        }
        self.first_arrival.get_or_insert(arrival);
    }

    /// Puts a message in.
    pub fn put(&mut self, head: &MessageHead, message: &Outgoing<'_>) {
        let start = self.bytes.len();
        self.put_head(head, message);
        self.bytes.extend_from_slice(message.bytes);
        self.bytes.extend_from_slice(message.tail);
        // While these bytes are still in the processor's cache.
        self.hasher
            .update(self.bytes.get(start..).unwrap_or_default());
    }

    /// Puts in a message whose own bytes will follow the chunk's: it is the last.
    pub fn put_last(&mut self, head: &MessageHead, message: &Outgoing<'_>) {
        let start = self.bytes.len();
        self.put_head(head, message);
        self.hasher
            .update(self.bytes.get(start..).unwrap_or_default());
        self.hasher.update(message.bytes);
        self.hasher.update(message.tail);
    }

    fn put_head(&mut self, head: &MessageHead, message: &Outgoing<'_>) {
        let start = self.bytes.len();
        let out = &mut self.bytes;
        out.push(opcode::MESSAGE);
        emit::u64(out, 22 + message.data_bytes());
        emit::u16(out, head.channel_id);
        emit::u32(out, head.sequence);
        emit::u64(out, head.log_time);
        emit::u64(out, head.publish_time);
        self.index
            .entry(head.channel_id)
            .or_default()
            .push(IndexEntry {
                log_time: head.log_time,
                offset: (start - emit::chunk_prefix_bytes(PLAIN)) as u64,
            });
        self.start_time = self.start_time.min(head.log_time);
        self.end_time = self.end_time.max(head.log_time);
        self.messages += 1;
    }

    /// Puts a definition in, before the first message that needs it.
    pub fn define(&mut self, opcode: u8, body: &[u8]) {
        let start = self.bytes.len();
        emit::record(&mut self.bytes, opcode, |out| out.extend_from_slice(body));
        let record = self.bytes.get(start..).unwrap_or_default();
        self.hasher.update(record);
    }
}
