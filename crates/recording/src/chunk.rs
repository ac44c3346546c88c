//! Unpacking a chunk: bounded, and checked as a whole before anything of it is used.

use std::io::Read;

use crate::error::Error;
use crate::index::ChunkEntry;
use crate::record::{self, HEAD_BYTES, Packing, opcode};
use crate::source::Source;

/// Larger chunks, packed or unpacked, are refused: nobody writes them, and length fields may lie.
const MAX_CHUNK_BYTES: u64 = 1 << 30;

/// Replaces `records` by the unpacked records of a chunk.
pub(crate) fn read(
    source: &Source,
    entry: &ChunkEntry,
    records: &mut Vec<u8>,
) -> Result<(), Error> {
    records.clear();
    let damaged = |reason: String| {
        let messages = indexed_messages(source, entry.offset.saturating_add(entry.record_bytes));
        source.damaged(entry.offset, entry.record_bytes, messages, reason)
    };
    if entry.record_bytes > MAX_CHUNK_BYTES {
        return Err(damaged(format!(
            "chunk of {} bytes is larger than any that is written",
            entry.record_bytes
        )));
    }
    let packed = source.read(entry.offset, entry.record_bytes)?;
    let mut rest = packed.as_slice();
    let head = match record::next_record(&mut rest) {
        Some((opcode::CHUNK, body)) => {
            record::chunk_head(body, body.len() as u64).map(|head| (head, body))
        }
        _ => None,
    };
    let Some((head, body)) = head else {
        return Err(damaged("no chunk where the index has one".to_owned()));
    };
    if head.uncompressed_bytes > MAX_CHUNK_BYTES {
        return Err(damaged(format!(
            "chunk claims to unpack to {} bytes",
            head.uncompressed_bytes
        )));
    }
    let data = body.get(head.head_bytes as usize..).unwrap_or_default();
    // One byte more than promised is enough to notice.
    let limit = head.uncompressed_bytes + 1;
    let unpacked = match head.packing {
        Packing::Plain => data.take(limit).read_to_end(records),
        Packing::Lz4 => lz4::Decoder::new(data).and_then(|d| d.take(limit).read_to_end(records)),
        Packing::Zstd => {
            zstd::stream::read::Decoder::new(data).and_then(|d| d.take(limit).read_to_end(records))
        }
    };
    let reason = match unpacked {
        Err(error) => format!("chunk does not unpack ({error})"),
        Ok(bytes) if bytes as u64 != head.uncompressed_bytes => {
            format!(
                "chunk unpacks to {bytes} instead of {} bytes",
                head.uncompressed_bytes
            )
        }
        Ok(_)
            if head.uncompressed_crc != 0 && crc32fast::hash(records) != head.uncompressed_crc =>
        {
            "chunk has a wrong checksum".to_owned()
        }
        Ok(_) => return Ok(()),
    };
    records.clear();
    Err(damaged(reason))
}

/// How many messages the indices behind a chunk list; `None` where there are none.
fn indexed_messages(source: &Source, mut offset: u64) -> Option<u64> {
    let mut messages = None;
    loop {
        let start = source
            .read(offset, HEAD_BYTES + record::MESSAGE_INDEX_HEAD_BYTES)
            .ok()?;
        let mut fields = record::Fields(&start);
        if fields.u8() != Some(opcode::MESSAGE_INDEX) {
            return messages;
        }
        let body_bytes = fields.u64()?;
        let Some(head) = record::message_index_head(fields.0, body_bytes) else {
            return messages;
        };
        messages = Some(messages.unwrap_or(0) + head.messages);
        offset = offset.checked_add(HEAD_BYTES)?.checked_add(body_bytes)?;
    }
}
