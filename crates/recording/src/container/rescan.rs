//! Building an index record by record: for recordings without a summary, or with a broken one.

use std::collections::{BTreeMap, BTreeSet};

use crate::container::chunk;
use crate::container::index::{ChunkEntry, Index};
use crate::container::record::{self, HEAD_BYTES, NamedRecord, opcode};
use crate::container::source::Source;
use crate::error::{Damage, Error, INDEX_REBUILT};

/// No record but chunks and attachments is larger; nothing larger is read in one piece.
const MAX_SMALL_RECORD_BYTES: u64 = 64 << 20;
/// How far the search for the next chunk reads at a time.
const SEARCH_WINDOW_BYTES: usize = 1 << 20;
/// Enough of an attachment for its name.
const ATTACHMENT_NAME_BYTES: u64 = 4096;

/// Why a file is read record by record.
#[derive(Clone, Copy)]
pub(crate) enum WhyRescan {
    ByIntent,
    CutOff,
    Broken(&'static str),
}

/// Builds an index record by record.
pub(crate) struct Rescan<'a> {
    source: &'a Source,
    index: Index,
    /// The chunk whose message indices are being read.
    pending: Option<PendingChunk>,
}

struct PendingChunk {
    entry: ChunkEntry,
    indexed: BTreeMap<u16, u64>,
}

/// Whether the message indices behind a chunk are known to be all there.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Indices {
    Complete,
    PerhapsCut,
}

enum Step {
    Next(u64),
    End,
    Garbage,
}

impl<'a> Rescan<'a> {
    pub fn run(source: &'a Source, data_start: u64, no_summary: WhyRescan) -> Result<Index, Error> {
        let mut scan = Self {
            source,
            index: Index::default(),
            pending: None,
        };
        let mut offset = data_start;
        let mut found_end = false;
        while offset < source.bytes {
            match scan.step(offset)? {
                Step::Next(next) => offset = next,
                Step::End => {
                    found_end = true;
                    break;
                }
                Step::Garbage => {
                    scan.close_chunk(Indices::PerhapsCut)?;
                    let next = scan.next_chunk_after(offset)?;
                    scan.index.damage.push(Damage {
                        offset,
                        bytes: next.unwrap_or(source.bytes) - offset,
                        messages: None,
                        reason: match next {
                            Some(_) => "garbage between chunks".to_owned(),
                            None => "the recording breaks off".to_owned(),
                        },
                    });
                    match next {
                        Some(next) => offset = next,
                        None => break,
                    }
                }
            }
        }
        scan.close_chunk(if found_end {
            Indices::Complete
        } else {
            Indices::PerhapsCut
        })?;
        if !found_end
            && scan
                .index
                .damage
                .last()
                .is_none_or(|d| d.offset + d.bytes < source.bytes)
        {
            scan.index.damage.push(Damage {
                offset: source.bytes,
                bytes: 0,
                messages: None,
                reason: "the recording has no end: its writer was interrupted".to_owned(),
            });
        }
        let rebuilt = match no_summary {
            WhyRescan::Broken(reason) => Some(reason),
            WhyRescan::CutOff if found_end => Some("its end is cut off"),
            WhyRescan::CutOff | WhyRescan::ByIntent => None,
        };
        scan.index.damage.extend(rebuilt.map(|reason| Damage {
            offset: source.bytes,
            bytes: 0,
            messages: None,
            reason: format!("{INDEX_REBUILT}, since {reason}"),
        }));
        scan.report_unknown_channels();
        Ok(scan.index)
    }

    fn step(&mut self, offset: u64) -> Result<Step, Error> {
        let head = self.source.read(offset, HEAD_BYTES)?;
        let mut fields = record::Fields(&head);
        let (Some(opcode), Some(body_bytes)) = (fields.u8(), fields.u64()) else {
            return Ok(Step::Garbage);
        };
        let body_offset = offset + HEAD_BYTES;
        let Some(end) = body_offset
            .checked_add(body_bytes)
            .filter(|end| *end <= self.source.bytes)
        else {
            return Ok(Step::Garbage);
        };
        let large =
            matches!(opcode, opcode::CHUNK | opcode::ATTACHMENT) || opcode >= opcode::PRIVATE;
        if !large && body_bytes > MAX_SMALL_RECORD_BYTES {
            return Ok(Step::Garbage);
        }
        if opcode != opcode::MESSAGE_INDEX {
            self.close_chunk(Indices::Complete)?;
        }
        let named = |name: &str| NamedRecord {
            name: name.to_owned(),
            offset,
            record_bytes: end - offset,
        };
        let understood = match opcode {
            opcode::CHUNK => self.start_chunk(offset, body_bytes)?,
            opcode::MESSAGE_INDEX => self.add_message_index(body_offset, body_bytes)?,
            opcode::MESSAGE => {
                return Err(Error::Unchunked {
                    path: self.source.path.clone(),
                    offset,
                });
            }
            opcode::SCHEMA => record::schema(&self.source.read(body_offset, body_bytes)?)
                .map(|schema| self.index.add_schema(schema)),
            opcode::CHANNEL => record::channel(&self.source.read(body_offset, body_bytes)?)
                .map(|channel| self.index.add_channel(channel)),
            opcode::ATTACHMENT => {
                let start = self
                    .source
                    .read(body_offset, body_bytes.min(ATTACHMENT_NAME_BYTES))?;
                let mut fields = record::Fields(start.get(16..).unwrap_or_default());
                fields
                    .string()
                    .map(|name| self.index.attachments.push(named(name)))
            }
            opcode::METADATA => record::metadata(&self.source.read(body_offset, body_bytes)?)
                .map(|(name, _)| self.index.metadata.push(named(name))),
            opcode::DATA_END => return Ok(Step::End),
            opcode::PRIVATE.. => Some(()),
            _ => None,
        };
        Ok(match understood {
            Some(()) => Step::Next(end),
            None => Step::Garbage,
        })
    }

    fn start_chunk(&mut self, offset: u64, body_bytes: u64) -> Result<Option<()>, Error> {
        let start = self
            .source
            .read(offset + HEAD_BYTES, record::MAX_CHUNK_HEAD_BYTES as u64)?;
        let Some(head) = record::chunk_head(&start, body_bytes) else {
            return Ok(None);
        };
        self.pending = Some(PendingChunk {
            entry: ChunkEntry {
                offset,
                record_bytes: HEAD_BYTES + body_bytes,
                start_time: head.start_time,
                end_time: head.end_time,
                channels: BTreeSet::new(),
                index_bytes: 0,
            },
            indexed: BTreeMap::new(),
        });
        Ok(Some(()))
    }

    fn add_message_index(
        &mut self,
        body_offset: u64,
        body_bytes: u64,
    ) -> Result<Option<()>, Error> {
        let start = self
            .source
            .read(body_offset, record::MESSAGE_INDEX_HEAD_BYTES)?;
        let Some(head) = record::message_index_head(&start, body_bytes) else {
            return Ok(None);
        };
        if let Some(pending) = &mut self.pending {
            *pending.indexed.entry(head.channel_id).or_default() += head.messages;
            pending.entry.index_bytes += HEAD_BYTES + body_bytes;
        }
        Ok(Some(()))
    }

    /// Takes the pending chunk into the index. Its records are read where its message indices do not tell everything:
    /// a channel seen for the first time is defined inside the chunk.
    fn close_chunk(&mut self, indices: Indices) -> Result<(), Error> {
        let Some(PendingChunk {
            mut entry,
            mut indexed,
        }) = self.pending.take()
        else {
            return Ok(());
        };
        let all_known = indexed
            .keys()
            .all(|id| self.index.channels.contains_key(id));
        if indices == Indices::PerhapsCut || indexed.is_empty() || !all_known {
            let mut records = Vec::new();
            match chunk::read(self.source, &entry, &mut records) {
                Ok(()) => indexed = self.read_definitions(&records),
                // Reported here, once; the chunk is left out of the index.
                Err(Error::Damaged { damage, .. }) => {
                    self.index.damage.push(damage);
                    return Ok(());
                }
                Err(error) => return Err(error),
            }
        }
        for (id, messages) in &indexed {
            *self.index.messages_by_channel.entry(*id).or_default() += messages;
        }
        entry.channels = indexed.into_keys().collect();
        self.index.chunks.push(entry);
        Ok(())
    }

    fn read_definitions(&mut self, mut records: &[u8]) -> BTreeMap<u16, u64> {
        let mut messages = BTreeMap::new();
        while let Some((opcode, body)) = record::next_record(&mut records) {
            match opcode {
                opcode::SCHEMA => {
                    if let Some(schema) = record::schema(body) {
                        self.index.add_schema(schema);
                    }
                }
                opcode::CHANNEL => {
                    if let Some(channel) = record::channel(body) {
                        self.index.add_channel(channel);
                    }
                }
                opcode::MESSAGE => {
                    if let Some(message) = record::message(body) {
                        *messages.entry(message.channel_id).or_default() += 1;
                    }
                }
                _ => {}
            }
        }
        messages
    }

    /// Offset of the next record behind `offset` that can only be a chunk.
    fn next_chunk_after(&self, offset: u64) -> Result<Option<u64>, Error> {
        let candidate_bytes = HEAD_BYTES as usize + record::MAX_CHUNK_HEAD_BYTES;
        let mut window = Vec::new();
        let mut start = offset + 1;
        while start < self.source.bytes {
            self.source.read_into(
                &mut window,
                start,
                (SEARCH_WINDOW_BYTES + candidate_bytes) as u64,
            )?;
            for at in
                (0..window.len().min(SEARCH_WINDOW_BYTES)).filter(|at| window[*at] == opcode::CHUNK)
            {
                let mut fields = record::Fields(&window[at + 1..]);
                let Some(body_bytes) = fields.u64() else {
                    continue;
                };
                let body_offset = start + at as u64 + HEAD_BYTES;
                let fits = body_offset
                    .checked_add(body_bytes)
                    .is_some_and(|end| end <= self.source.bytes);
                if fits && record::chunk_head(fields.0, body_bytes).is_some() {
                    return Ok(Some(start + at as u64));
                }
            }
            start += SEARCH_WINDOW_BYTES as u64;
        }
        Ok(None)
    }

    /// Channels whose definition was in a damaged chunk: their messages are there, but nobody knows what they are.
    fn report_unknown_channels(&mut self) {
        let index = &mut self.index;
        let unknown = |id: &u16| {
            let channel = index.channels.get(id);
            channel.is_none_or(|c| c.schema_id != 0 && !index.schemas.contains_key(&c.schema_id))
        };
        let lost: Vec<_> = index
            .messages_by_channel
            .iter()
            .filter(|(id, _)| unknown(id))
            .collect();
        let messages: u64 = lost.iter().map(|(_, n)| **n).sum();
        if messages > 0 {
            index.damage.push(Damage {
                offset: 0,
                bytes: 0,
                messages: Some(messages),
                reason: format!(
                    "the definition of {} channels was in a damaged chunk",
                    lost.len()
                ),
            });
        }
    }
}
