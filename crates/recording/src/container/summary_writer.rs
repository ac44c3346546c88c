//! The end of an MCAP file: what is where in it. Everything in the order of numbers and of the file: same messages, same
//! bytes.

use std::collections::BTreeMap;

use crate::container::emit;
use crate::container::record::{self, opcode};

/// How rosbag2 marks a latched topic: keep the last message, reliable, transient local.
pub(crate) const TRANSIENT_LOCAL: &str = "- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
";

/// A chunk as the summary names it.
pub(crate) struct ChunkIndex {
    pub start_time: u64,
    pub end_time: u64,
    pub offset: u64,
    pub record_bytes: u64,
    /// Where each channel's message index begins.
    pub index_offsets: BTreeMap<u16, u64>,
    pub index_bytes: u64,
    pub compression: &'static str,
    pub compressed_bytes: u64,
    pub uncompressed_bytes: u64,
}

/// An attachment or a metadata record as the summary names it.
pub(crate) struct NamedIndex {
    pub offset: u64,
    pub record_bytes: u64,
    pub name: String,
    /// Attachments only.
    pub media_type: String,
    /// Attachments only.
    pub data_bytes: u64,
}

/// What the end of a file will say.
#[derive(Default)]
pub(crate) struct SummaryBuilder {
    /// Bodies of the schema records.
    pub schemas: BTreeMap<u16, Vec<u8>>,
    /// Bodies of the channel records.
    pub channels: BTreeMap<u16, Vec<u8>>,
    pub chunks: Vec<ChunkIndex>,
    pub attachments: Vec<NamedIndex>,
    pub metadata: Vec<NamedIndex>,
    pub messages: BTreeMap<u16, u64>,
}

impl SummaryBuilder {
    /// Everything from the data-end record at `offset` to the end of the file.
    pub fn end_of_file(&self, offset: u64) -> Vec<u8> {
        let mut out = Vec::new();
        // No checksum over the data section: each chunk and attachment has its own.
        emit::record(&mut out, opcode::DATA_END, |out| emit::u32(out, 0));
        let summary_at = out.len();
        let mut groups = Vec::new();
        let mut group = |out: &mut Vec<u8>, opcode: u8, write: &dyn Fn(&mut Vec<u8>)| {
            let start = out.len();
            write(out);
            if out.len() > start {
                groups.push((opcode, offset + start as u64, (out.len() - start) as u64));
            }
        };
        let bodies = |out: &mut Vec<u8>, opcode: u8, bodies: &BTreeMap<u16, Vec<u8>>| {
            for body in bodies.values() {
                emit::record(out, opcode, |out| out.extend_from_slice(body));
            }
        };
        group(&mut out, opcode::SCHEMA, &|out| {
            bodies(out, opcode::SCHEMA, &self.schemas);
        });
        group(&mut out, opcode::CHANNEL, &|out| {
            bodies(out, opcode::CHANNEL, &self.channels);
        });
        group(&mut out, opcode::STATISTICS, &|out| self.statistics(out));
        group(&mut out, opcode::CHUNK_INDEX, &|out| {
            self.chunks.iter().for_each(|chunk| chunk_index(out, chunk));
        });
        group(&mut out, opcode::ATTACHMENT_INDEX, &|out| {
            self.attachments
                .iter()
                .for_each(|a| attachment_index(out, a));
        });
        group(&mut out, opcode::METADATA_INDEX, &|out| {
            self.metadata.iter().for_each(|m| metadata_index(out, m));
        });
        let offsets_at = out.len();
        for (opcode, start, bytes) in groups {
            emit::record(&mut out, opcode::SUMMARY_OFFSET, |out| {
                out.push(opcode);
                emit::u64(out, start);
                emit::u64(out, bytes);
            });
        }
        out.push(opcode::FOOTER);
        emit::u64(&mut out, 20);
        emit::u64(&mut out, offset + summary_at as u64);
        emit::u64(&mut out, offset + offsets_at as u64);
        let crc = crc32fast::hash(out.get(summary_at..).unwrap_or_default());
        emit::u32(&mut out, crc);
        out.extend_from_slice(record::MAGIC);
        out
    }

    fn statistics(&self, out: &mut Vec<u8>) {
        emit::record(out, opcode::STATISTICS, |out| {
            emit::u64(out, self.messages.values().sum());
            emit::u16(out, self.schemas.len() as u16);
            emit::u32(out, self.channels.len() as u32);
            emit::u32(out, self.attachments.len() as u32);
            emit::u32(out, self.metadata.len() as u32);
            emit::u32(out, self.chunks.len() as u32);
            let with_messages = || self.chunks.iter().filter(|c| !c.index_offsets.is_empty());
            emit::u64(
                out,
                with_messages().map(|c| c.start_time).min().unwrap_or(0),
            );
            emit::u64(out, with_messages().map(|c| c.end_time).max().unwrap_or(0));
            emit::sized(out, |out| {
                for (channel, messages) in &self.messages {
                    emit::u16(out, *channel);
                    emit::u64(out, *messages);
                }
            });
        });
    }
}

fn chunk_index(out: &mut Vec<u8>, chunk: &ChunkIndex) {
    emit::record(out, opcode::CHUNK_INDEX, |out| {
        emit::u64(out, chunk.start_time);
        emit::u64(out, chunk.end_time);
        emit::u64(out, chunk.offset);
        emit::u64(out, chunk.record_bytes);
        emit::sized(out, |out| {
            for (channel, offset) in &chunk.index_offsets {
                emit::u16(out, *channel);
                emit::u64(out, *offset);
            }
        });
        emit::u64(out, chunk.index_bytes);
        emit::string(out, chunk.compression);
        emit::u64(out, chunk.compressed_bytes);
        emit::u64(out, chunk.uncompressed_bytes);
    });
}

fn attachment_index(out: &mut Vec<u8>, attachment: &NamedIndex) {
    emit::record(out, opcode::ATTACHMENT_INDEX, |out| {
        emit::u64(out, attachment.offset);
        emit::u64(out, attachment.record_bytes);
        emit::u64(out, 0);
        emit::u64(out, 0);
        emit::u64(out, attachment.data_bytes);
        emit::string(out, &attachment.name);
        emit::string(out, &attachment.media_type);
    });
}

fn metadata_index(out: &mut Vec<u8>, metadata: &NamedIndex) {
    emit::record(out, opcode::METADATA_INDEX, |out| {
        emit::u64(out, metadata.offset);
        emit::u64(out, metadata.record_bytes);
        emit::string(out, &metadata.name);
    });
}

/// Where the data of a chunk begins, and the message indices that belong behind it.
pub(crate) struct Indexed {
    pub index_offsets: BTreeMap<u16, u64>,
    pub index_bytes: u64,
}

/// Appends the message indices of a chunk to `out`, which will lie at `offset` of the file.
pub(crate) fn append_message_indices(
    out: &mut Vec<u8>,
    offset: u64,
    index: &BTreeMap<u16, Vec<emit::IndexEntry>>,
) -> Indexed {
    let start = out.len();
    let mut index_offsets = BTreeMap::new();
    for (channel, entries) in index.iter().filter(|(_, entries)| !entries.is_empty()) {
        index_offsets.insert(*channel, offset + out.len() as u64);
        emit::message_index(out, *channel, entries);
    }
    Indexed {
        index_offsets,
        index_bytes: (out.len() - start) as u64,
    }
}
