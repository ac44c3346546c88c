//! A whole file from what an interruption, a full disk or a bad sector left of a recording.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

use lsfb_types::{Progress, ProgressFn};

use crate::container::chunk::{self, RECORDS_BROKEN};
use crate::container::emit::{self, IndexEntry};
use crate::container::header;
use crate::container::index::{ChunkEntry, Index};
use crate::container::record::{self, ChannelRecord, HEAD_BYTES, NamedRecord, Packing, opcode};
use crate::container::rescan::{Rescan, WhyRescan};
use crate::container::source::Source;
use crate::container::summary_reader;
use crate::container::summary_writer::{self, ChunkIndex, NamedIndex, SummaryBuilder};
use crate::error::{Damage, Error};

/// What was recovered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recovered {
    /// The new file.
    pub path: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// Messages in it.
    pub messages: u64,
    /// How many of them come from a chunk that was torn: whole messages, but nothing has checked them.
    pub salvaged_messages: u64,
    /// Chunks copied as they are, their checksum compared.
    pub chunks: u64,
    /// What could not be recovered.
    pub damage: Vec<Damage>,
}

/// Writes everything that can be read of `path` into a new file `out`, with a new index and end. Chunks whose checksum is
/// right are copied byte by byte; of a torn one at the end the whole messages are taken. A header that cannot be read is written
/// anew. `out` must not exist; after an error it does not.
pub fn recover(path: &Path, out: &Path, progress: ProgressFn<'_>) -> Result<Recovered, Error> {
    let source = Source::open(path)?;
    let start = Start::find(&source)?;
    let copy = Copy::create(out)?;
    let recovered = copy_readable(&source, &start, copy, progress);
    if recovered.is_err() {
        // What matters is the error above.
        let _ = std::fs::remove_file(out);
    }
    recovered
}

fn copy_readable(
    source: &Source,
    Start { head, index }: &Start,
    mut copy: Copy,
    progress: ProgressFn<'_>,
) -> Result<Recovered, Error> {
    copy.append(head)?;
    copy.adopt_definitions(source)?;
    let total = index.chunks.len() as u64;
    let mut pieces: Vec<Piece<'_>> = index.chunks.iter().map(Piece::Chunk).collect();
    pieces.extend(index.attachments.iter().map(Piece::Attachment));
    pieces.extend(index.metadata.iter().map(Piece::Metadata));
    pieces.sort_by_key(Piece::offset);
    // A file without its end is what this is for; only what lies there is lost.
    let mut damage: Vec<Damage> = index
        .damage
        .iter()
        .filter(|d| d.bytes > 0 || d.messages.is_some())
        .cloned()
        .collect();
    for piece in pieces {
        let copied = match piece {
            Piece::Chunk(entry) => {
                progress(Progress {
                    stage: "recovering",
                    done: copy.chunks,
                    total,
                })?;
                copy.chunk(source, entry)
            }
            Piece::Attachment(named) => copy.attachment(source, named),
            Piece::Metadata(named) => copy.metadata(source, named),
        };
        match copied {
            Ok(()) => {}
            Err(Error::Damaged { damage: found, .. }) => damage.push(found),
            Err(error) => return Err(error),
        }
    }
    let torn = damage
        .iter()
        .position(|d| d.offset + d.bytes == source.bytes);
    if let Some(at) = torn
        && let Some(found) = damage.get_mut(at)
    {
        let salvaged = copy.torn_chunk(source, found.offset)?;
        if salvaged > 0 {
            found.reason = format!("{}; {salvaged} messages of it were saved", found.reason);
        }
    }
    damage.sort_by_key(|d| d.offset);
    copy.finish(&source.path, damage)
}

/// The header of the new file, and what stands behind that of the old one.
struct Start {
    head: Vec<u8>,
    index: Index,
}

impl Start {
    fn find(source: &Source) -> Result<Self, Error> {
        let unreadable = match source.data_start() {
            // A length that was damaged may reach into the records behind.
            Ok(data_start) if header::ends_at(source, data_start)? => {
                return Ok(Self {
                    head: source.read(0, data_start)?,
                    index: Rescan::run(source, data_start, WhyRescan::CutOff)?,
                });
            }
            Ok(_) => Error::NotMcap {
                path: source.path.clone(),
            },
            Err(error @ (Error::NotMcap { .. } | Error::Profile { .. })) => error,
            Err(error) => return Err(error),
        };
        let data_start = header::records_behind_damage(source)?;
        let mut index = Rescan::run(source, data_start, WhyRescan::CutOff)?;
        // Not every file is a recording that was damaged: one of another kind is left alone.
        let is_ours = |c: &ChannelRecord| c.message_encoding == "cdr";
        if index.chunks.is_empty() || !index.channels.values().all(is_ours) {
            return Err(unreadable);
        }
        let reason = match &unreadable {
            Error::Profile { found, .. } => format!("the header names profile `{found}`"),
            _ => "the header is broken".to_owned(),
        };
        index.damage.push(Damage {
            offset: 0,
            bytes: data_start,
            messages: None,
            reason: format!("{reason}; a new one was written"),
        });
        Ok(Self {
            head: header::header(),
            index,
        })
    }
}

enum Piece<'a> {
    Chunk(&'a ChunkEntry),
    Attachment(&'a NamedRecord),
    Metadata(&'a NamedRecord),
}

impl Piece<'_> {
    fn offset(&self) -> u64 {
        match self {
            Self::Chunk(entry) => entry.offset,
            Self::Attachment(named) | Self::Metadata(named) => named.offset,
        }
    }
}

struct Copy {
    path: PathBuf,
    file: BufWriter<File>,
    bytes: u64,
    summary: SummaryBuilder,
    chunks: u64,
    salvaged_messages: u64,
}

impl Copy {
    fn create(out: &Path) -> Result<Self, Error> {
        let file = File::create_new(out).map_err(|source| match source.kind() {
            std::io::ErrorKind::AlreadyExists => Error::Exists {
                path: out.to_owned(),
            },
            _ => Error::Io {
                path: out.to_owned(),
                action: "create the recording",
                source,
            },
        })?;
        Ok(Self {
            path: out.to_owned(),
            file: BufWriter::with_capacity(1 << 20, file),
            bytes: 0,
            summary: SummaryBuilder::default(),
            chunks: 0,
            salvaged_messages: 0,
        })
    }

    fn append(&mut self, bytes: &[u8]) -> Result<(), Error> {
        self.file.write_all(bytes).map_err(|source| Error::Io {
            path: self.path.clone(),
            action: "write the recovered recording",
            source,
        })?;
        self.bytes += bytes.len() as u64;
        Ok(())
    }

    /// Where the end of the file is there, it defines every topic, those too whose first chunk is broken.
    fn adopt_definitions(&mut self, source: &Source) -> Result<(), Error> {
        let Some(summary) = summary_reader::summary_bytes(source)? else {
            return Ok(());
        };
        let mut records = summary.as_slice();
        let mut definitions = Vec::new();
        while let Some((opcode, body)) = record::next_record(&mut records) {
            if self.define(opcode, body) {
                emit::record(&mut definitions, opcode, |out| out.extend_from_slice(body));
            }
        }
        self.append(&definitions)
    }

    /// Notes a schema or a channel; whether it was one, and new.
    fn define(&mut self, opcode: u8, body: &[u8]) -> bool {
        let id = match opcode {
            opcode::SCHEMA => record::schema(body).map(|schema| schema.id),
            opcode::CHANNEL => record::channel(body).map(|channel| channel.id),
            _ => None,
        };
        let Some(id) = id else {
            return false;
        };
        let known = if opcode == opcode::SCHEMA {
            &mut self.summary.schemas
        } else {
            &mut self.summary.channels
        };
        let is_new = !known.contains_key(&id);
        known.entry(id).or_insert_with(|| body.to_vec());
        is_new
    }

    fn chunk(&mut self, source: &Source, entry: &ChunkEntry) -> Result<(), Error> {
        let mut records = Vec::new();
        chunk::read(source, entry, &mut records)?;
        let mut record = source.read(entry.offset, entry.record_bytes)?;
        let body = record.get(HEAD_BYTES as usize..).unwrap_or_default();
        let head = record::chunk_head(body, body.len() as u64);
        let Some(head) = head else {
            return Ok(());
        };
        let whole = record::whole_bytes(&records);
        if whole < records.len() {
            // Without a checksum it may be broken inside: what is whole goes into a chunk of its own.
            let broken = (records.len() - whole) as u64;
            let saved = self.put_records(records.get(..whole).unwrap_or_default(), &head)?;
            let reason = format!("{RECORDS_BROKEN}; {saved} messages of it were saved");
            return Err(source.damaged(entry.offset, broken, None, reason));
        }
        let contents = self.read_records(&records);
        self.put_chunk(&mut record, &head, &contents)?;
        self.chunks += 1;
        Ok(())
    }

    /// Definitions are noted; messages are indexed.
    fn read_records(&mut self, records: &[u8]) -> BTreeMap<u16, Vec<IndexEntry>> {
        let mut messages: BTreeMap<u16, Vec<IndexEntry>> = BTreeMap::new();
        let mut rest = records;
        loop {
            let offset = (records.len() - rest.len()) as u64;
            let Some((opcode, body)) = record::next_record(&mut rest) else {
                return messages;
            };
            self.define(opcode, body);
            if opcode == opcode::MESSAGE
                && let Some(message) = record::message(body)
            {
                messages
                    .entry(message.channel_id)
                    .or_default()
                    .push(IndexEntry {
                        log_time: message.log_time,
                        offset,
                    });
            }
        }
    }

    /// Appends a chunk record and new indices for it.
    fn put_chunk(
        &mut self,
        record: &mut Vec<u8>,
        head: &record::ChunkHead,
        messages: &BTreeMap<u16, Vec<IndexEntry>>,
    ) -> Result<(), Error> {
        let offset = self.bytes;
        let record_bytes = record.len() as u64;
        let indexed = summary_writer::append_message_indices(record, offset, messages);
        self.append(record)?;
        for (channel, entries) in messages {
            *self.summary.messages.entry(*channel).or_default() += entries.len() as u64;
        }
        self.summary.chunks.push(ChunkIndex {
            start_time: head.start_time,
            end_time: head.end_time,
            offset,
            record_bytes,
            index_offsets: indexed.index_offsets,
            index_bytes: indexed.index_bytes,
            compression: match head.packing {
                Packing::Plain => "",
                Packing::Lz4 => "lz4",
                Packing::Zstd => "zstd",
            },
            compressed_bytes: head.compressed_bytes,
            uncompressed_bytes: head.uncompressed_bytes,
        });
        Ok(())
    }

    /// Takes the whole messages of a chunk whose end is missing, into a chunk of their own. How many there were.
    fn torn_chunk(&mut self, source: &Source, offset: u64) -> Result<u64, Error> {
        let torn = source.read(offset, source.bytes - offset)?;
        let mut fields = record::Fields(&torn);
        let (Some(opcode::CHUNK), Some(body_bytes)) = (fields.u8(), fields.u64()) else {
            return Ok(0);
        };
        let Some(head) = record::chunk_head(fields.0, body_bytes) else {
            return Ok(0);
        };
        let data = fields.0.get(head.head_bytes as usize..).unwrap_or_default();
        let unpacked = chunk::unpack_torn(head.packing, data);
        let whole = record::whole_bytes(&unpacked);
        self.put_records(unpacked.get(..whole).unwrap_or_default(), &head)
    }

    /// Puts whole records of a broken chunk into one of their own. How many messages are among them.
    fn put_records(&mut self, records: &[u8], head: &record::ChunkHead) -> Result<u64, Error> {
        let messages = self.read_records(records);
        let times = || messages.values().flatten().map(|entry| entry.log_time);
        let (Some(start_time), Some(end_time)) = (times().min(), times().max()) else {
            return Ok(0);
        };
        let mut record = vec![0; emit::chunk_prefix_bytes("")];
        record.extend_from_slice(records);
        let new_head = emit::ChunkHead {
            start_time,
            end_time,
            uncompressed_bytes: records.len() as u64,
            crc: crc32fast::hash(records),
            compression: "",
        };
        emit::fill_chunk_prefix(&mut record, 0, &new_head);
        let head = record::ChunkHead {
            start_time,
            end_time,
            uncompressed_bytes: records.len() as u64,
            packing: Packing::Plain,
            compressed_bytes: records.len() as u64,
            ..*head
        };
        self.put_chunk(&mut record, &head, &messages)?;
        let salvaged = times().count() as u64;
        self.salvaged_messages += salvaged;
        Ok(salvaged)
    }

    fn attachment(&mut self, source: &Source, named: &NamedRecord) -> Result<(), Error> {
        let record = source.read(named.offset, named.record_bytes)?;
        let body = record.get(HEAD_BYTES as usize..).unwrap_or_default();
        let Some((name, data)) = record::attachment(body) else {
            let reason = format!("attachment `{}` is broken", named.name);
            return Err(source.damaged(named.offset, named.record_bytes, None, reason));
        };
        let mut fields = record::Fields(body.get(16..).unwrap_or_default());
        let _name = fields.string();
        let index = NamedIndex {
            offset: self.bytes,
            record_bytes: named.record_bytes,
            name: name.to_owned(),
            media_type: fields.string().unwrap_or_default().to_owned(),
            data_bytes: data.len() as u64,
        };
        self.append(&record)?;
        self.summary.attachments.push(index);
        Ok(())
    }

    fn metadata(&mut self, source: &Source, named: &NamedRecord) -> Result<(), Error> {
        let record = source.read(named.offset, named.record_bytes)?;
        self.put_metadata(&named.name, &record)
    }

    fn put_metadata(&mut self, name: &str, record: &[u8]) -> Result<(), Error> {
        let index = NamedIndex {
            offset: self.bytes,
            record_bytes: record.len() as u64,
            name: name.to_owned(),
            media_type: String::new(),
            data_bytes: 0,
        };
        self.append(record)?;
        self.summary.metadata.push(index);
        Ok(())
    }

    fn finish(mut self, from: &Path, damage: Vec<Damage>) -> Result<Recovered, Error> {
        let name = from.file_name().unwrap_or_default().to_string_lossy();
        let lost_bytes: u64 = damage.iter().map(|d| d.bytes).sum();
        let entries = BTreeMap::from([
            ("from".to_owned(), name.into_owned()),
            ("lost_bytes".to_owned(), lost_bytes.to_string()),
            (
                "salvaged_messages".to_owned(),
                self.salvaged_messages.to_string(),
            ),
        ]);
        let mut record = Vec::new();
        emit::metadata(&mut record, "lsfb.recovered", &entries);
        self.put_metadata("lsfb.recovered", &record)?;
        let end = self.summary.end_of_file(self.bytes);
        self.append(&end)?;
        self.file.flush().map_err(|source| Error::Io {
            path: self.path.clone(),
            action: "write the recovered recording",
            source,
        })?;
        Ok(Recovered {
            path: self.path,
            bytes: self.bytes,
            messages: self.summary.messages.values().sum(),
            salvaged_messages: self.salvaged_messages,
            chunks: self.chunks,
            damage,
        })
    }
}
