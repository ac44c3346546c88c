//! MCAP records to bytes: the counterpart of [`crate::container::record`].

use std::collections::BTreeMap;

use crate::container::record::HEAD_BYTES;

/// Appends a record: opcode, length, and what `body` appends.
pub(crate) fn record(out: &mut Vec<u8>, opcode: u8, body: impl FnOnce(&mut Vec<u8>)) {
    out.push(opcode);
    let length_at = out.len();
    out.extend_from_slice(&[0; 8]);
    body(out);
    let length = (out.len() - length_at - 8) as u64;
    put_at(out, length_at, &length.to_le_bytes());
}

/// Overwrites bytes that were left free.
pub(crate) fn put_at(out: &mut [u8], at: usize, bytes: &[u8]) {
    if let Some(place) = out.get_mut(at..at + bytes.len()) {
        place.copy_from_slice(bytes);
    }
}

pub(crate) fn u16(out: &mut Vec<u8>, value: u16) {
    out.extend_from_slice(&value.to_le_bytes());
}

pub(crate) fn u32(out: &mut Vec<u8>, value: u32) {
    out.extend_from_slice(&value.to_le_bytes());
}

pub(crate) fn u64(out: &mut Vec<u8>, value: u64) {
    out.extend_from_slice(&value.to_le_bytes());
}

/// Length and bytes.
pub(crate) fn bytes(out: &mut Vec<u8>, value: &[u8]) {
    u32(out, value.len() as u32);
    out.extend_from_slice(value);
}

pub(crate) fn string(out: &mut Vec<u8>, value: &str) {
    bytes(out, value.as_bytes());
}

/// Size in bytes, and what `body` appends.
pub(crate) fn sized(out: &mut Vec<u8>, body: impl FnOnce(&mut Vec<u8>)) {
    let length_at = out.len();
    u32(out, 0);
    body(out);
    let length = (out.len() - length_at - 4) as u32;
    put_at(out, length_at, &length.to_le_bytes());
}

pub(crate) fn string_map(out: &mut Vec<u8>, map: &BTreeMap<String, String>) {
    sized(out, |out| {
        for (key, value) in map {
            string(out, key);
            string(out, value);
        }
    });
}

/// Appends an attachment record with its checksum.
pub(crate) fn attachment(out: &mut Vec<u8>, name: &str, media_type: &str, data: &[u8]) {
    record(out, crate::container::record::opcode::ATTACHMENT, |out| {
        let start = out.len();
        // Log time and creation time stay 0: equal recordings shall have equal bytes.
        u64(out, 0);
        u64(out, 0);
        string(out, name);
        string(out, media_type);
        u64(out, data.len() as u64);
        out.extend_from_slice(data);
        let crc = crc32fast::hash(out.get(start..).unwrap_or_default());
        u32(out, crc);
    });
}

pub(crate) fn metadata(out: &mut Vec<u8>, name: &str, entries: &BTreeMap<String, String>) {
    record(out, crate::container::record::opcode::METADATA, |out| {
        string(out, name);
        string_map(out, entries);
    });
}

/// The bytes before a chunk's data: record head and chunk head.
pub(crate) fn chunk_prefix_bytes(compression: &str) -> usize {
    HEAD_BYTES as usize + 8 + 8 + 8 + 4 + 4 + compression.len() + 8
}

/// What the head of a chunk says.
pub(crate) struct ChunkHead<'a> {
    pub start_time: u64,
    pub end_time: u64,
    pub uncompressed_bytes: u64,
    pub crc: u32,
    pub compression: &'a str,
}

/// Fills in the bytes that were left free before the data of a chunk, of which `rest_bytes` follow behind `out`.
pub(crate) fn fill_chunk_prefix(out: &mut [u8], rest_bytes: u64, head: &ChunkHead<'_>) {
    let prefix_bytes = chunk_prefix_bytes(head.compression);
    let data_bytes = out.len().saturating_sub(prefix_bytes) as u64 + rest_bytes;
    let body_bytes = out.len() as u64 + rest_bytes - HEAD_BYTES;
    let mut prefix = Vec::with_capacity(prefix_bytes);
    prefix.push(crate::container::record::opcode::CHUNK);
    u64(&mut prefix, body_bytes);
    u64(&mut prefix, head.start_time);
    u64(&mut prefix, head.end_time);
    u64(&mut prefix, head.uncompressed_bytes);
    u32(&mut prefix, head.crc);
    string(&mut prefix, head.compression);
    u64(&mut prefix, data_bytes);
    put_at(out, 0, &prefix);
}

/// Where a message lies in its chunk.
#[derive(Clone, Copy)]
pub(crate) struct IndexEntry {
    pub log_time: u64,
    pub offset: u64,
}

pub(crate) fn message_index(out: &mut Vec<u8>, channel: u16, entries: &[IndexEntry]) {
    record(
        out,
        crate::container::record::opcode::MESSAGE_INDEX,
        |out| {
            u16(out, channel);
            sized(out, |out| {
                for entry in entries {
                    u64(out, entry.log_time);
                    u64(out, entry.offset);
                }
            });
        },
    );
}
