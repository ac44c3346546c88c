//! The MCAP side of the writer: chunks, channels, and staying failed.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{IoSlice, Write as _};
use std::path::{Path, PathBuf};

use lsfb_types::Timestamp;

use crate::container::emit;
use crate::container::header::header;
use crate::container::open_chunk::{MessageHead, OpenChunk, Outgoing, PLAIN};
use crate::container::pack::Packer;
use crate::container::record::opcode;
use crate::container::summary_writer::{self, ChunkIndex, NamedIndex, SummaryBuilder};
use crate::error::Error;
use crate::layout::{Compression, Durability, Existing, Summary, TopicSummary, WriterConfig};
use crate::topic;

struct OpenChannel {
    id: u16,
    schema: String,
    messages: u64,
}

/// A message from this size on is not copied into a chunk that is written as it is: it goes from where it lies into the file,
/// and its chunk with it.
const DIRECT_BYTES: u64 = 256 << 10;
/// Opcode, length and header of a message record.
const MESSAGE_RECORD_BYTES: u64 = 31;
/// Schema and channel record without the schema's text, generously.
const DEFINITION_RECORDS_BYTES: u64 = 256;
/// The latest time that a recording can hold, and zero the earliest: stamps of ROS messages are `int32` seconds.
pub const LAST_STAMP: Timestamp = Timestamp::from_nanos((i32::MAX as i64) * 1_000_000_000);

/// Puts messages into chunks and chunks into the file.
pub(crate) struct Encoder {
    path: PathBuf,
    config: WriterConfig,
    file: File,
    /// The first failure; from then on nothing reaches the file.
    failure: Option<String>,
    /// Everything up to here is in the file and ends with a whole record.
    intact_bytes: u64,
    schemas: BTreeMap<String, u16>,
    channels: BTreeMap<String, OpenChannel>,
    chunk: OpenChunk,
    packed: Vec<u8>,
    indices: Vec<u8>,
    packer: Packer,
    summary: SummaryBuilder,
}

impl Encoder {
    pub fn create(path: &Path, config: &WriterConfig) -> Result<Self, Error> {
        let io = |source: std::io::Error| match source.kind() {
            std::io::ErrorKind::AlreadyExists => Error::Exists {
                path: path.to_owned(),
            },
            _ => Error::Io {
                path: path.to_owned(),
                action: "create the recording",
                source,
            },
        };
        let file = match config.existing {
            Existing::Replace => File::create(path),
            Existing::Refuse => File::create_new(path),
        };
        let mut encoder = Self {
            path: path.to_owned(),
            config: config.clone(),
            file: file.map_err(io)?,
            failure: None,
            intact_bytes: 0,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            chunk: OpenChunk::default(),
            packed: Vec::new(),
            indices: Vec::new(),
            packer: Packer::new(config.zstd_level),
            summary: SummaryBuilder::default(),
        };
        encoder.append(&header())?;
        Ok(encoder)
    }

    /// Size of what is in the file.
    pub fn bytes(&self) -> u64 {
        self.intact_bytes
    }

    /// Messages that are not in the file yet.
    pub fn open_messages(&self) -> u64 {
        self.chunk.messages
    }

    /// Another handle on the file, for a thread that brings it to the disk.
    pub fn file(&self) -> std::io::Result<File> {
        self.file.try_clone()
    }

    pub fn attach(&mut self, name: &str, media_type: &str, bytes: &[u8]) -> Result<(), Error> {
        self.flush()?;
        let mut record = Vec::with_capacity(bytes.len() + 128);
        emit::attachment(&mut record, name, media_type, bytes);
        let offset = self.intact_bytes;
        self.append(&record)?;
        self.summary.attachments.push(NamedIndex {
            offset,
            record_bytes: record.len() as u64,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data_bytes: bytes.len() as u64,
        });
        Ok(())
    }

    pub fn write_metadata(
        &mut self,
        name: &str,
        entries: &BTreeMap<String, String>,
    ) -> Result<(), Error> {
        self.flush()?;
        let mut record = Vec::new();
        emit::metadata(&mut record, name, entries);
        let offset = self.intact_bytes;
        self.append(&record)?;
        self.summary.metadata.push(NamedIndex {
            offset,
            record_bytes: record.len() as u64,
            name: name.to_owned(),
            media_type: String::new(),
            data_bytes: 0,
        });
        Ok(())
    }

    /// Closes the current chunk, so that everything up to here survives.
    pub fn flush(&mut self) -> Result<(), Error> {
        self.check()?;
        if self.chunk.bytes.is_empty() {
            return Ok(());
        }
        let compression = match self.config.compression {
            Compression::None => PLAIN,
            Compression::Lz4 => self.pack("lz4"),
            Compression::Zstd => self.pack("zstd"),
        };
        self.write_chunk(compression, [&[], &[]])
    }

    /// Writes the open chunk, packed or as it is. `rest` is the end of its last message, which was not copied into it.
    fn write_chunk(&mut self, compression: &'static str, rest: [&[u8]; 2]) -> Result<(), Error> {
        let rest_bytes: u64 = rest.iter().map(|piece| piece.len() as u64).sum();
        let uncompressed_bytes = self.chunk.data().len() as u64 + rest_bytes;
        let crc = std::mem::take(&mut self.chunk.hasher).finalize();
        let mut record = match compression {
            PLAIN => std::mem::take(&mut self.chunk.bytes),
            _ => std::mem::take(&mut self.packed),
        };
        let (start_time, end_time) = (self.chunk.start_time, self.chunk.end_time);
        emit::fill_chunk_prefix(
            &mut record,
            rest_bytes,
            &emit::ChunkHead {
                start_time,
                end_time,
                uncompressed_bytes,
                crc,
                compression,
            },
        );
        let offset = self.intact_bytes;
        let record_bytes = record.len() as u64 + rest_bytes;
        let mut indices = std::mem::take(&mut self.indices);
        indices.clear();
        let indexed = summary_writer::append_message_indices(
            &mut indices,
            offset + record_bytes,
            &self.chunk.index,
        );
        let [first, second] = rest;
        let written = self.append_pieces(&[&record, first, second, &indices]);
        // The buffers are used again.
        self.indices = indices;
        record.clear();
        match compression {
            PLAIN => self.chunk.bytes = record,
            _ => self.packed = record,
        }
        written?;
        for (channel, entries) in &mut self.chunk.index {
            *self.summary.messages.entry(*channel).or_default() += entries.len() as u64;
            entries.clear();
        }
        self.summary.chunks.push(ChunkIndex {
            start_time,
            end_time,
            offset,
            record_bytes,
            index_offsets: indexed.index_offsets,
            index_bytes: indexed.index_bytes,
            compression,
            compressed_bytes: record_bytes - emit::chunk_prefix_bytes(compression) as u64,
            uncompressed_bytes,
        });
        self.chunk.bytes.clear();
        self.chunk.first_arrival = None;
        self.chunk.messages = 0;
        Ok(())
    }

    /// Packs the open chunk; the name of the compression that was used, none where it gains nothing.
    fn pack(&mut self, name: &'static str) -> &'static str {
        let data = self.chunk.data();
        let prefix_bytes = emit::chunk_prefix_bytes(name);
        let packed = self.packer.pack(
            self.config.compression,
            data,
            &mut self.packed,
            prefix_bytes,
        );
        match packed {
            Ok(()) if self.packed.len() - prefix_bytes < data.len() => name,
            _ => PLAIN,
        }
    }

    /// Writes index and end, and closes the file.
    pub fn finish(mut self) -> Result<Summary, Error> {
        self.flush()?;
        self.close()
    }

    /// Writes index and end behind the last whole chunk of a file that could not be written any further. What was cut
    /// off makes room for them.
    pub fn salvage(mut self) -> Result<Summary, Error> {
        self.failure = None;
        for (channel, entries) in &self.chunk.index {
            let unwritten = entries.len() as u64;
            if let Some(channel) = self.channels.values_mut().find(|c| c.id == *channel) {
                channel.messages = channel.messages.saturating_sub(unwritten);
            }
        }
        use std::io::{Seek, SeekFrom};
        let sought = self.file.seek(SeekFrom::Start(self.intact_bytes));
        sought.map_err(|source| Error::Io {
            path: self.path.clone(),
            action: "close the recording",
            source,
        })?;
        self.close()
    }

    fn close(mut self) -> Result<Summary, Error> {
        let end = self.summary.end_of_file(self.intact_bytes);
        self.append(&end)?;
        let topics: Vec<TopicSummary> = self
            .channels
            .iter()
            .map(|(topic, channel)| TopicSummary {
                topic: topic.clone(),
                schema: channel.schema.clone(),
                messages: channel.messages,
            })
            .collect();
        Ok(Summary {
            bytes: self.intact_bytes,
            messages: topics.iter().map(|t| t.messages).sum(),
            path: self.path,
            topics,
        })
    }

    /// Makes sure that messages of one instant come into one chunk. Nothing is written where a stamp does not fit.
    pub fn begin(
        &mut self,
        time: Timestamp,
        arrival: Timestamp,
        messages: &[Outgoing<'_>],
    ) -> Result<(), Error> {
        self.check()?;
        for stamp in [time, arrival] {
            if !(0..=LAST_STAMP.nanos()).contains(&stamp.nanos()) {
                let topic = messages.first().map_or("", |m| m.topic);
                let reason =
                    format!("time {stamp} s is outside 1970 … 2038; check the device's clock");
                return Err(self.unwritable(topic, reason));
            }
        }
        let bytes: u64 = messages.iter().map(|m| self.bytes_in_chunk(m)).sum();
        let full = self.chunk.first_arrival.is_some_and(|first| {
            self.chunk.bytes.len() as u64 + bytes > self.config.chunk_bytes
                || arrival.secs_since(first).abs() >= self.config.chunk_secs
        });
        if full {
            self.flush()?;
        }
        Ok(())
    }

    /// What a message adds to its chunk, with the definition of its topic where it is the first.
    fn bytes_in_chunk(&self, message: &Outgoing<'_>) -> u64 {
        let definition = match self.channels.contains_key(message.topic) {
            true => 0,
            false => message.schema_text.len() as u64 + DEFINITION_RECORDS_BYTES,
        };
        message.data_bytes() + MESSAGE_RECORD_BYTES + definition
    }

    pub fn put(
        &mut self,
        time: Timestamp,
        arrival: Timestamp,
        message: &Outgoing<'_>,
    ) -> Result<(), Error> {
        let (log_time, publish_time) = (arrival.nanos() as u64, time.nanos() as u64);
        self.chunk.open(arrival, log_time);
        let channel_id = self.channel_id(message)?;
        let sequence = self.channels.get_mut(message.topic).map_or(0, |channel| {
            channel.messages += 1;
            channel.messages as u32
        });
        let head = MessageHead {
            channel_id,
            sequence,
            log_time,
            publish_time,
        };
        let direct =
            self.config.compression == Compression::None && message.data_bytes() >= DIRECT_BYTES;
        if !direct {
            self.chunk.put(&head, message);
            return Ok(());
        }
        self.chunk.put_last(&head, message);
        let written = self.write_chunk(PLAIN, [message.bytes, message.tail]);
        // Whoever hands it over counts it if it cannot be written; it does not wait here.
        written.inspect_err(|_| self.chunk.messages = self.chunk.messages.saturating_sub(1))
    }

    fn channel_id(&mut self, message: &Outgoing<'_>) -> Result<u16, Error> {
        if let Some(channel) = self.channels.get(message.topic) {
            if channel.schema != message.schema_name {
                let reason = format!(
                    "contains {} and cannot hold {}",
                    channel.schema, message.schema_name
                );
                return Err(self.unwritable(message.topic, reason));
            }
            return Ok(channel.id);
        }
        if self.channels.len() >= usize::from(u16::MAX) {
            let reason = "the recording has 65 535 topics and can hold no more".to_owned();
            return Err(self.unwritable(message.topic, reason));
        }
        let schema_id = self.schema_id(message);
        let id = self.channels.len() as u16;
        let mut metadata = BTreeMap::new();
        if message.topic == topic::TF_STATIC {
            metadata.insert(
                "offered_qos_profiles".to_owned(),
                summary_writer::TRANSIENT_LOCAL.to_owned(),
            );
        }
        let mut body = Vec::new();
        emit::u16(&mut body, id);
        emit::u16(&mut body, schema_id);
        emit::string(&mut body, message.topic);
        emit::string(&mut body, "cdr");
        emit::string_map(&mut body, &metadata);
        self.chunk.define(opcode::CHANNEL, &body);
        self.summary.channels.insert(id, body);
        self.channels.insert(
            message.topic.to_owned(),
            OpenChannel {
                id,
                schema: message.schema_name.to_owned(),
                messages: 0,
            },
        );
        Ok(id)
    }

    /// Number 0 means none, so that schemas count from 1.
    fn schema_id(&mut self, message: &Outgoing<'_>) -> u16 {
        if let Some(id) = self.schemas.get(message.schema_name) {
            return *id;
        }
        let id = self.schemas.len() as u16 + 1;
        let mut body = Vec::new();
        emit::u16(&mut body, id);
        emit::string(&mut body, message.schema_name);
        emit::string(&mut body, "ros2msg");
        emit::string(&mut body, message.schema_text);
        self.chunk.define(opcode::SCHEMA, &body);
        self.summary.schemas.insert(id, body);
        self.schemas.insert(message.schema_name.to_owned(), id);
        id
    }

    fn append(&mut self, records: &[u8]) -> Result<(), Error> {
        self.append_pieces(&[records])
    }

    /// Writes whole records that lie in pieces. The first failure cuts the file back to its last whole record and is the
    /// last.
    fn append_pieces(&mut self, pieces: &[&[u8]]) -> Result<(), Error> {
        self.check()?;
        let mut written = write_all_vectored(&mut self.file, pieces);
        if self.config.durability == Durability::Power {
            written = written.and_then(|()| self.file.sync_data());
        }
        match written {
            Ok(()) => {
                self.intact_bytes += pieces.iter().map(|piece| piece.len() as u64).sum::<u64>();
                Ok(())
            }
            Err(error) => {
                self.failure = Some(format!("cannot write: {error}"));
                // Best effort: a reader recognises the broken tail as well.
                let _ = self.file.set_len(self.intact_bytes);
                self.check()
            }
        }
    }

    fn check(&self) -> Result<(), Error> {
        match &self.failure {
            None => Ok(()),
            Some(cause) => Err(Error::WriterFailed {
                path: self.path.clone(),
                intact_bytes: self.intact_bytes,
                cause: cause.clone(),
            }),
        }
    }

    pub fn unwritable(&self, topic: &str, reason: String) -> Error {
        Error::Unwritable {
            path: self.path.clone(),
            topic: topic.to_owned(),
            reason,
        }
    }
}

/// Hands all pieces to the operating system at once.
fn write_all_vectored(file: &mut File, pieces: &[&[u8]]) -> std::io::Result<()> {
    let mut slices: Vec<IoSlice<'_>> = pieces
        .iter()
        .filter(|piece| !piece.is_empty())
        .map(|piece| IoSlice::new(piece))
        .collect();
    let mut left = slices.as_mut_slice();
    while !left.is_empty() {
        match file.write_vectored(left) {
            Ok(0) => return Err(std::io::ErrorKind::WriteZero.into()),
            Ok(count) => IoSlice::advance_slices(&mut left, count),
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}
