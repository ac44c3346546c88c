//! Unpacking a chunk: bounded, and checked as a whole before anything of it is used.

use std::io::Read;

use crate::container::index::ChunkEntry;
use crate::container::record::{self, HEAD_BYTES, Packing, opcode};
use crate::container::source::Source;
use crate::container::unpack;
use crate::error::Error;

/// Larger chunks, packed or unpacked, are refused: nobody writes them, and length fields may lie.
const MAX_CHUNK_BYTES: u64 = 1 << 30;

/// A chunk as it lies in the file: its bytes, and what its head says about them.
struct Packed<'a> {
    head: record::ChunkHead,
    data: &'a [u8],
}

/// Replaces `records` by the unpacked records of a chunk.
pub(crate) fn read(
    source: &Source,
    entry: &ChunkEntry,
    records: &mut Vec<u8>,
) -> Result<(), Error> {
    let read = read_bytes(source, entry, Vec::new());
    let bytes = read.inspect_err(|_| records.clear())?;
    let packed = packed(source, entry, &bytes).inspect_err(|_| records.clear())?;
    if packed.head.packing == Packing::Plain {
        records.clear();
        check(source, entry, &packed.head, packed.data)?;
        records.extend_from_slice(packed.data);
        return Ok(());
    }
    unpack(source, entry, &packed, records)?;
    let checked = check(source, entry, &packed.head, records);
    if checked.is_err() {
        records.clear();
    }
    checked
}

/// Memory that checking one chunk after another uses again.
#[derive(Default)]
pub(crate) struct Scratch {
    bytes: Vec<u8>,
    records: Vec<u8>,
}

/// Unpacks a chunk, compares its checksum and walks its records to their end, without keeping anything: a chunk without a checksum may be
/// broken inside.
pub(crate) fn verify(
    source: &Source,
    entry: &ChunkEntry,
    scratch: &mut Scratch,
) -> Result<(), Error> {
    scratch.bytes = read_bytes(source, entry, std::mem::take(&mut scratch.bytes))?;
    let packed = packed(source, entry, &scratch.bytes)?;
    let records = match packed.head.packing {
        Packing::Plain => packed.data,
        _ => {
            unpack(source, entry, &packed, &mut scratch.records)?;
            &scratch.records
        }
    };
    check(source, entry, &packed.head, records)?;
    match records.len() - record::whole_bytes(records) {
        0 => Ok(()),
        broken => Err(source.damaged(entry.offset, broken as u64, None, RECORDS_BROKEN.to_owned())),
    }
}

/// Why the rest of a chunk cannot be read.
pub(crate) const RECORDS_BROKEN: &str = "records inside a chunk are broken";

/// Whether a chunk has a checksum at all.
pub(crate) fn has_checksum(source: &Source, entry: &ChunkEntry) -> Result<bool, Error> {
    let length = record::MAX_CHUNK_HEAD_BYTES as u64;
    let start = source.read(entry.offset, HEAD_BYTES + length)?;
    let body = start.get(HEAD_BYTES as usize..).unwrap_or_default();
    let head = record::chunk_head(body, entry.record_bytes.saturating_sub(HEAD_BYTES));
    // One that cannot be read is said to be damaged.
    Ok(head.is_none_or(|head| head.uncompressed_crc != 0))
}

/// Unpacks as much of a torn chunk as there is. Nothing of it has been checked.
pub(crate) fn unpack_torn(packing: Packing, data: &[u8]) -> Vec<u8> {
    let mut records = Vec::new();
    let mut piece = [0_u8; 16 << 10];
    let mut unpacked: Box<dyn Read + '_> = match packing {
        Packing::Plain => return data.to_vec(),
        Packing::Lz4 => match lz4::Decoder::new(data) {
            Ok(decoder) => Box::new(decoder),
            Err(_) => return records,
        },
        Packing::Zstd => match zstd::stream::read::Decoder::new(data) {
            Ok(decoder) => Box::new(decoder),
            Err(_) => return records,
        },
    };
    // Small pieces: what comes before the end of the data comes out before the error.
    while (records.len() as u64) < MAX_CHUNK_BYTES {
        match unpacked.read(&mut piece) {
            Ok(0) | Err(_) => break,
            Ok(count) => records.extend_from_slice(piece.get(..count).unwrap_or_default()),
        }
    }
    records
}

fn damaged(source: &Source, entry: &ChunkEntry, reason: String) -> Error {
    let messages = indexed_messages(source, entry.offset.saturating_add(entry.record_bytes));
    source.damaged(entry.offset, entry.record_bytes, messages, reason)
}

fn read_bytes(source: &Source, entry: &ChunkEntry, mut bytes: Vec<u8>) -> Result<Vec<u8>, Error> {
    if entry.record_bytes > MAX_CHUNK_BYTES {
        return Err(damaged(
            source,
            entry,
            format!(
                "chunk of {} bytes is larger than any that is written",
                entry.record_bytes
            ),
        ));
    }
    source.read_into(&mut bytes, entry.offset, entry.record_bytes)?;
    Ok(bytes)
}

fn packed<'a>(source: &Source, entry: &ChunkEntry, bytes: &'a [u8]) -> Result<Packed<'a>, Error> {
    let mut rest = bytes;
    let head = match record::next_record(&mut rest) {
        Some((opcode::CHUNK, body)) => {
            record::chunk_head(body, body.len() as u64).map(|head| (head, body))
        }
        _ => None,
    };
    let Some((head, body)) = head else {
        let reason = "no chunk where the index has one".to_owned();
        return Err(damaged(source, entry, reason));
    };
    if head.uncompressed_bytes > MAX_CHUNK_BYTES {
        let reason = format!(
            "chunk claims to decompress to {} bytes",
            head.uncompressed_bytes
        );
        return Err(damaged(source, entry, reason));
    }
    let data = body.get(head.head_bytes as usize..).unwrap_or_default();
    Ok(Packed { head, data })
}

fn unpack(
    source: &Source,
    entry: &ChunkEntry,
    packed: &Packed<'_>,
    records: &mut Vec<u8>,
) -> Result<(), Error> {
    let unpacked = unpack::unpack(
        packed.head.packing,
        packed.data,
        packed.head.uncompressed_bytes,
        records,
    );
    match unpacked {
        Ok(()) => Ok(()),
        Err(error) => {
            records.clear();
            let reason = format!("chunk cannot be decompressed ({error})");
            Err(damaged(source, entry, reason))
        }
    }
}

fn check(
    source: &Source,
    entry: &ChunkEntry,
    head: &record::ChunkHead,
    records: &[u8],
) -> Result<(), Error> {
    let reason = if records.len() as u64 != head.uncompressed_bytes {
        format!(
            "chunk decompresses to {} instead of {} bytes",
            records.len(),
            head.uncompressed_bytes
        )
    } else if head.uncompressed_crc != 0 && crc32fast::hash(records) != head.uncompressed_crc {
        "chunk has a wrong checksum".to_owned()
    } else {
        return Ok(());
    };
    Err(damaged(source, entry, reason))
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
