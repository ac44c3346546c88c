//! The index of a file from the summary at its end; where it has none, or a broken one, record by record.

use crate::container::index::{ChunkEntry, Index};
use crate::container::record::{self, HEAD_BYTES, opcode};
use crate::container::rescan::{Rescan, WhyRescan};
use crate::container::source::Source;
use crate::error::Error;

/// Reads the index of a file whose first bytes are known to be good; `data_start` is the end of its header record.
pub(crate) fn read(source: &Source, data_start: u64) -> Result<Index, Error> {
    match from_summary(source)? {
        FromSummary::Index(index) => Ok(index),
        FromSummary::None => Rescan::run(source, data_start, WhyRescan::ByIntent),
        FromSummary::CutOff => Rescan::run(source, data_start, WhyRescan::CutOff),
        FromSummary::Broken(reason) => Rescan::run(source, data_start, WhyRescan::Broken(reason)),
    }
}

/// The records of the summary, where a file has one whose checksum is right.
pub(crate) fn summary_bytes(source: &Source) -> Result<Option<Vec<u8>>, Error> {
    Ok(match find_summary(source)? {
        Found::Summary { bytes, .. } => Some(bytes),
        Found::Not(_) => None,
    })
}

enum Found {
    Summary { bytes: Vec<u8>, start: u64 },
    Not(FromSummary),
}

enum FromSummary {
    Index(Index),
    None,
    CutOff,
    Broken(&'static str),
}

fn from_summary(source: &Source) -> Result<FromSummary, Error> {
    let (bytes, start) = match find_summary(source)? {
        Found::Summary { bytes, start } => (bytes, start),
        Found::Not(why) => return Ok(why),
    };
    Ok(match parse_summary(&bytes, start) {
        Some(Parsed::Index(index)) => FromSummary::Index(index),
        Some(Parsed::NoChunkIndex) => FromSummary::None,
        None => FromSummary::Broken("it does not describe this file"),
    })
}

fn find_summary(source: &Source) -> Result<Found, Error> {
    let tail_bytes = record::FOOTER_BYTES + record::MAGIC.len() as u64;
    let Some(footer_offset) = source.bytes.checked_sub(tail_bytes) else {
        return Ok(Found::Not(FromSummary::CutOff));
    };
    let tail = source.read(footer_offset, tail_bytes)?;
    let mut records = tail.as_slice();
    let Some((opcode::FOOTER, footer)) = record::next_record(&mut records) else {
        return Ok(Found::Not(FromSummary::CutOff));
    };
    let mut fields = record::Fields(footer);
    let (Some(start), Some(_offsets), Some(crc)) = (fields.u64(), fields.u64(), fields.u32())
    else {
        return Ok(Found::Not(FromSummary::CutOff));
    };
    if records != record::MAGIC {
        return Ok(Found::Not(FromSummary::CutOff));
    }
    if start == 0 {
        return Ok(Found::Not(FromSummary::None));
    }
    if start >= footer_offset {
        return Ok(Found::Not(FromSummary::Broken(
            "the footer points past itself",
        )));
    }
    let summary = source.read(start, footer_offset - start)?;
    if crc != 0 {
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(&summary);
        hasher.update(&tail[..(HEAD_BYTES + 16) as usize]);
        if hasher.finalize() != crc {
            return Ok(Found::Not(FromSummary::Broken(
                "its checksum does not match",
            )));
        }
    }
    Ok(Found::Summary {
        bytes: summary,
        start,
    })
}

enum Parsed {
    Index(Index),
    NoChunkIndex,
}

fn parse_summary(mut summary: &[u8], data_end: u64) -> Option<Parsed> {
    let mut index = Index::default();
    let mut statistics = None;
    let inside =
        |offset: u64, bytes: u64| offset.checked_add(bytes).is_some_and(|end| end <= data_end);
    while !summary.is_empty() {
        let (opcode, body) = record::next_record(&mut summary)?;
        match opcode {
            opcode::SCHEMA => index.add_schema(record::schema(body)?),
            opcode::CHANNEL => index.add_channel(record::channel(body)?),
            opcode::CHUNK_INDEX => {
                let chunk = record::chunk_index(body)?;
                if !inside(chunk.offset, chunk.record_bytes) {
                    return None;
                }
                index.chunks.push(ChunkEntry {
                    offset: chunk.offset,
                    record_bytes: chunk.record_bytes,
                    start_time: chunk.start_time,
                    end_time: chunk.end_time,
                    channels: chunk.channels.into_iter().collect(),
                    index_bytes: chunk.index_bytes,
                });
            }
            opcode::ATTACHMENT_INDEX => index.attachments.push(record::attachment_index(body)?),
            opcode::METADATA_INDEX => index.metadata.push(record::metadata_index(body)?),
            opcode::STATISTICS => statistics = Some(record::statistics(body)?),
            _ => {}
        }
    }
    if !index
        .attachments
        .iter()
        .chain(&index.metadata)
        .all(|r| inside(r.offset, r.record_bytes))
    {
        return None;
    }
    let statistics = statistics?;
    // Without message indices the summary does not tell which chunk holds which topic.
    let unindexed = statistics.messages > 0 && index.chunks.iter().all(|c| c.channels.is_empty());
    if unindexed || statistics.chunks as usize != index.chunks.len() {
        return Some(Parsed::NoChunkIndex);
    }
    index.messages_by_channel = statistics.by_channel;
    index.chunks.sort_by_key(|c| c.offset);
    Some(Parsed::Index(index))
}
