//! What is where in a file: from its summary, or by walking over its records where it has none.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use crate::chunk;
use crate::error::{Damage, Error};
use crate::record::{self, ChannelRecord, HEAD_BYTES, NamedRecord, SchemaRecord, opcode};

/// No record but chunks and attachments is larger; nothing larger is read in one piece.
const MAX_SMALL_RECORD_BYTES: u64 = 64 << 20;
/// How far the search for the next chunk reads at a time.
const SEARCH_WINDOW_BYTES: usize = 1 << 20;
/// Enough of an attachment for its name.
const ATTACHMENT_NAME_BYTES: u64 = 4096;

/// A file that is read in pieces, each checked against its size.
pub(crate) struct Source {
    pub path: PathBuf,
    pub bytes: u64,
    file: File,
}

impl Source {
    pub fn open(path: &Path) -> Result<Self, Error> {
        let io = |source| Error::Io {
            path: path.to_owned(),
            action: "open the recording",
            source,
        };
        let file = File::open(path).map_err(io)?;
        let metadata = file.metadata().map_err(io)?;
        if metadata.is_dir() {
            return Err(io(std::io::Error::from(std::io::ErrorKind::IsADirectory)));
        }
        Ok(Self {
            path: path.to_owned(),
            bytes: metadata.len(),
            file,
        })
    }

    /// Replaces `buffer` by the bytes at `offset`; what lies behind the end is missing from it.
    pub fn read_into(&self, buffer: &mut Vec<u8>, offset: u64, length: u64) -> Result<(), Error> {
        let available = length.min(self.bytes.saturating_sub(offset));
        buffer.clear();
        buffer.resize(available as usize, 0);
        self.file
            .read_exact_at(buffer, offset)
            .map_err(|source| Error::Io {
                path: self.path.clone(),
                action: "read the recording",
                source,
            })
    }

    pub fn read(&self, offset: u64, length: u64) -> Result<Vec<u8>, Error> {
        let mut buffer = Vec::new();
        self.read_into(&mut buffer, offset, length)?;
        Ok(buffer)
    }

    pub fn damaged(&self, offset: u64, bytes: u64, messages: Option<u64>, reason: String) -> Error {
        Error::Damaged {
            path: self.path.clone(),
            damage: Damage {
                offset,
                bytes,
                messages,
                reason,
            },
        }
    }
}

/// A chunk: where it is and what is in it.
#[derive(Clone, Debug)]
pub(crate) struct ChunkEntry {
    pub offset: u64,
    /// Its size, head included.
    pub record_bytes: u64,
    pub start_time: u64,
    pub end_time: u64,
    pub channels: BTreeSet<u16>,
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

/// Reads the index of a file whose first bytes are known to be good; `data_start` is the end of its header record.
pub(crate) fn read(source: &Source, data_start: u64) -> Result<Index, Error> {
    match from_summary(source)? {
        FromSummary::Index(index) => Ok(index),
        FromSummary::None => Scan::run(source, data_start, NoSummary::ByIntent),
        FromSummary::CutOff => Scan::run(source, data_start, NoSummary::CutOff),
        FromSummary::Broken(reason) => Scan::run(source, data_start, NoSummary::Broken(reason)),
    }
}

enum FromSummary {
    Index(Index),
    None,
    CutOff,
    Broken(&'static str),
}

/// Why a file is walked over.
#[derive(Clone, Copy)]
enum NoSummary {
    ByIntent,
    CutOff,
    Broken(&'static str),
}

fn from_summary(source: &Source) -> Result<FromSummary, Error> {
    let tail_bytes = record::FOOTER_BYTES + mcap::MAGIC.len() as u64;
    let Some(footer_offset) = source.bytes.checked_sub(tail_bytes) else {
        return Ok(FromSummary::CutOff);
    };
    let tail = source.read(footer_offset, tail_bytes)?;
    let mut records = tail.as_slice();
    let Some((opcode::FOOTER, footer)) = record::next_record(&mut records) else {
        return Ok(FromSummary::CutOff);
    };
    let mut fields = record::Fields(footer);
    let (Some(start), Some(_offsets), Some(crc)) = (fields.u64(), fields.u64(), fields.u32())
    else {
        return Ok(FromSummary::CutOff);
    };
    if records != mcap::MAGIC {
        return Ok(FromSummary::CutOff);
    }
    if start == 0 {
        return Ok(FromSummary::None);
    }
    if start >= footer_offset {
        return Ok(FromSummary::Broken("the footer points behind itself"));
    }
    let summary = source.read(start, footer_offset - start)?;
    if crc != 0 {
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(&summary);
        hasher.update(&tail[..(HEAD_BYTES + 16) as usize]);
        if hasher.finalize() != crc {
            return Ok(FromSummary::Broken("its checksum differs"));
        }
    }
    match parse_summary(&summary, start) {
        Some(Parsed::Index(index)) => Ok(FromSummary::Index(index)),
        Some(Parsed::NoChunkIndex) => Ok(FromSummary::None),
        None => Ok(FromSummary::Broken("it does not describe this file")),
    }
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

impl Index {
    fn add_schema(&mut self, schema: SchemaRecord) {
        self.schemas.entry(schema.id).or_insert(schema);
    }

    fn add_channel(&mut self, channel: ChannelRecord) {
        self.channels.entry(channel.id).or_insert(channel);
    }
}

/// Builds an index by walking over the file.
struct Scan<'a> {
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

impl<'a> Scan<'a> {
    fn run(source: &'a Source, data_start: u64, no_summary: NoSummary) -> Result<Index, Error> {
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
            NoSummary::Broken(reason) => Some(reason),
            NoSummary::CutOff if found_end => Some("its end is cut off"),
            NoSummary::CutOff | NoSummary::ByIntent => None,
        };
        scan.index.damage.extend(rebuilt.map(|reason| Damage {
            offset: source.bytes,
            bytes: 0,
            messages: None,
            reason: format!("the index was rebuilt from the data, since {reason}"),
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
