//! The MCAP side of the writer: chunks, channels, and staying failed.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use lsfb_types::Timestamp;
use mcap::records::{MessageHeader, Metadata};

use crate::error::Error;
use crate::layout::{Compression, Summary, TopicSummary, WriterConfig};
use crate::sink::{SharedState, Sink};
use crate::{message, summary, topic};

struct OpenChannel {
    id: u16,
    schema: String,
    messages: u64,
}

/// A message on its way into the file.
pub(crate) struct Outgoing<'a> {
    pub topic: &'a str,
    pub schema_name: &'a str,
    pub schema_text: &'a str,
    pub bytes: &'a [u8],
}

impl<'a> Outgoing<'a> {
    pub fn new(topic: &'a str, schema: message::Schema, bytes: &'a [u8]) -> Self {
        Self {
            topic,
            schema_name: schema.name,
            schema_text: schema.text,
            bytes,
        }
    }
}

struct OpenChunk {
    first_arrival: Timestamp,
    bytes: u64,
}

/// Opcode, length and header of a message record.
const MESSAGE_RECORD_BYTES: u64 = 31;
/// Schema and channel record without the schema's text, generously.
const DEFINITION_RECORDS_BYTES: u64 = 256;
/// Stamps of ROS messages are `int32` seconds.
const MAX_STAMP_NANOS: i64 = (i32::MAX as i64) * 1_000_000_000;

/// Puts messages into chunks and chunks into the file.
pub(crate) struct Encoder {
    path: PathBuf,
    config: WriterConfig,
    mcap: mcap::Writer<Sink>,
    state: SharedState,
    channels: BTreeMap<String, OpenChannel>,
    chunk: Option<OpenChunk>,
}

impl Encoder {
    pub fn create(path: &Path, config: &WriterConfig) -> Result<Self, Error> {
        let io = |source| Error::Io {
            path: path.to_owned(),
            action: "create the recording",
            source,
        };
        let sink = Sink::new(File::create(path).map_err(io)?, config.durability);
        let state = sink.state();
        let mcap = mcap::WriteOptions::new()
            .profile("ros2")
            .library(concat!("lsfb-recording ", env!("CARGO_PKG_VERSION")))
            .compression(match config.compression {
                Compression::None => None,
                Compression::Lz4 => Some(mcap::Compression::Lz4),
                Compression::Zstd => Some(mcap::Compression::Zstd),
            })
            // Bytes must not depend on the number of cores.
            .compression_threads(0)
            // Chunks are closed here, by size and by time.
            .chunk_size(None)
            // A chunk is written in one piece: no header on the disk ever waits for its length.
            .disable_seeking(true)
            .create(sink)
            .map_err(|e| io(std::io::Error::other(e)))?;
        Ok(Self {
            path: path.to_owned(),
            config: config.clone(),
            mcap,
            state,
            channels: BTreeMap::new(),
            chunk: None,
        })
    }

    pub fn attach(&mut self, name: &str, media_type: &str, bytes: &[u8]) -> Result<(), Error> {
        self.check()?;
        self.close_chunk()?;
        let attachment = mcap::Attachment {
            log_time: 0,
            create_time: 0,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: Cow::Borrowed(bytes),
        };
        let result = self.mcap.attach(&attachment);
        self.encoded(name, result)?;
        self.flush()
    }

    pub fn write_metadata(
        &mut self,
        name: &str,
        entries: BTreeMap<String, String>,
    ) -> Result<(), Error> {
        self.check()?;
        self.close_chunk()?;
        let result = self.mcap.write_metadata(&Metadata {
            name: name.to_owned(),
            metadata: entries,
        });
        self.encoded(name, result)?;
        self.flush()
    }

    /// Closes the current chunk, so that everything up to here survives. The writer does so by itself once a second of
    /// recording; call this when the devices fall silent.
    pub fn flush(&mut self) -> Result<(), Error> {
        self.check()?;
        self.chunk = None;
        let result = self.mcap.flush();
        self.encoded("chunk", result)
    }

    /// Writes index and end, and closes the file.
    pub fn finish(mut self) -> Result<Summary, Error> {
        self.flush()?;
        self.state.lock().held = Some(Vec::new());
        let result = self.mcap.finish();
        self.encoded("summary", result)?;
        let messages = self.channels.values().map(|c| c.messages).sum();
        let topics = self
            .channels
            .iter()
            .map(|(topic, channel)| TopicSummary {
                topic: topic.clone(),
                schema: channel.schema.clone(),
                messages: channel.messages,
            })
            .collect();
        let mut sink = self.mcap.into_inner();
        let end = summary::in_fixed_order(&sink.release());
        let written = sink.write_all(&end).and_then(|()| sink.flush());
        let state = self.state.lock();
        if let Some(cause) = state
            .failure
            .clone()
            .or(written.err().map(|e| e.to_string()))
        {
            return Err(Error::WriterFailed {
                path: self.path,
                intact_bytes: state.intact_bytes,
                cause,
            });
        }
        Ok(Summary {
            bytes: state.intact_bytes,
            path: self.path.clone(),
            messages,
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
            if !(0..=MAX_STAMP_NANOS).contains(&stamp.nanos()) {
                let topic = messages.first().map_or("", |m| m.topic);
                let reason =
                    format!("time {stamp} s is outside 1970 … 2038; check the device's clock");
                return Err(self.unwritable(topic, reason));
            }
        }
        let bytes = messages.iter().map(|m| self.bytes_in_chunk(m)).sum();
        self.make_room(arrival, bytes)
    }

    /// Closes the chunk where `bytes` more at `arrival` would make it too large or too long.
    fn make_room(&mut self, arrival: Timestamp, bytes: u64) -> Result<(), Error> {
        let full = self.chunk.as_ref().is_some_and(|chunk| {
            chunk.bytes + bytes > self.config.chunk_bytes
                || arrival.secs_since(chunk.first_arrival).abs() >= self.config.chunk_secs
        });
        if full {
            self.flush()?;
        }
        let chunk = self.chunk.get_or_insert(OpenChunk {
            first_arrival: arrival,
            bytes: 0,
        });
        chunk.bytes += bytes;
        Ok(())
    }

    /// What a message adds to its chunk, with the definition of its topic where it is the first.
    fn bytes_in_chunk(&self, message: &Outgoing<'_>) -> u64 {
        let definition = match self.channels.contains_key(message.topic) {
            true => 0,
            false => message.schema_text.len() as u64 + DEFINITION_RECORDS_BYTES,
        };
        message.bytes.len() as u64 + MESSAGE_RECORD_BYTES + definition
    }

    pub fn put(
        &mut self,
        time: Timestamp,
        arrival: Timestamp,
        message: &Outgoing<'_>,
    ) -> Result<(), Error> {
        let id = self.channel_id(message)?;
        let channel = self.channels.get_mut(message.topic);
        let sequence = channel.map_or(0, |c| {
            c.messages += 1;
            c.messages as u32
        });
        let header = MessageHeader {
            channel_id: id,
            sequence,
            log_time: arrival.nanos() as u64,
            publish_time: time.nanos() as u64,
        };
        let result = self.mcap.write_to_known_channel(&header, message.bytes);
        self.encoded(message.topic, result)
    }

    fn channel_id(&mut self, message: &Outgoing<'_>) -> Result<u16, Error> {
        if let Some(channel) = self.channels.get(message.topic) {
            if channel.schema != message.schema_name {
                let reason = format!(
                    "carries {} and cannot take {}",
                    channel.schema, message.schema_name
                );
                return Err(self.unwritable(message.topic, reason));
            }
            return Ok(channel.id);
        }
        let mut metadata = BTreeMap::new();
        if message.topic == topic::TF_STATIC {
            metadata.insert(
                "offered_qos_profiles".to_owned(),
                summary::TRANSIENT_LOCAL.to_owned(),
            );
        }
        let result = self
            .mcap
            .add_schema(
                message.schema_name,
                "ros2msg",
                message.schema_text.as_bytes(),
            )
            .and_then(|schema| {
                self.mcap
                    .add_channel(schema, message.topic, "cdr", &metadata)
            });
        let id = match result {
            Ok(id) => id,
            Err(error) => return Err(self.unwritable(message.topic, error.to_string())),
        };
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

    fn close_chunk(&mut self) -> Result<(), Error> {
        match self.chunk {
            Some(_) => self.flush(),
            None => Ok(()),
        }
    }

    /// Turns what the encoder says, and what the file said meanwhile, into our error.
    fn encoded<T>(&mut self, what: &str, result: mcap::McapResult<T>) -> Result<(), Error> {
        if let Err(error) = result {
            let mut state = self.state.lock();
            state
                .failure
                .get_or_insert_with(|| format!("cannot encode {what}: {error}"));
        }
        self.check()
    }

    fn check(&self) -> Result<(), Error> {
        let state = self.state.lock();
        match &state.failure {
            None => Ok(()),
            Some(cause) => Err(Error::WriterFailed {
                path: self.path.clone(),
                intact_bytes: state.intact_bytes,
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
