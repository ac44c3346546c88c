use std::collections::BTreeMap;
use std::path::Path;

use lsfb_types::{ProgressFn, Timestamp};

use crate::container::index::{ChunkEntry, Index};
use crate::container::record::timestamp;
use crate::container::record::{self, MessageRecord, NamedRecord, opcode};
use crate::container::source::Source;
use crate::container::verify::{self, TopicArrivals};
use crate::container::{chunk, summary_reader};
use crate::error::{Damage, Error};
use crate::layout::TopicSummary;
use crate::message;

/// A recording, read chunk by chunk: memory holds one chunk per iterator.
///
/// A file that was cut, or damaged in the middle, opens; [`Recording::damage`] says what is missing. Damage inside a
/// chunk shows when the chunk is read: the iterator gives one [`Error::Damaged`] and goes on behind it.
pub struct Recording {
    pub(crate) source: Source,
    pub(crate) index: Index,
    topics: Vec<TopicSummary>,
}

/// First and last arrival in a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArrivalRange {
    /// The first.
    pub start: Timestamp,
    /// The last.
    pub end: Timestamp,
}

/// A message as it lies in the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CdrMessage {
    /// Synchronized time.
    pub time: Timestamp,
    /// Host receive time.
    pub arrival: Timestamp,
    /// The serialised message.
    pub bytes: Vec<u8>,
}

impl Recording {
    /// Opens a file. Its end may be missing and parts of it broken; see [`Recording::damage`].
    pub fn open(path: &Path) -> Result<Self, Error> {
        let source = Source::open(path)?;
        let index = summary_reader::read(&source, source.data_start()?)?;
        let topics = topics(&index);
        Ok(Self {
            source,
            index,
            topics,
        })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.source.path
    }

    /// The topics, by name.
    pub fn topics(&self) -> &[TopicSummary] {
        &self.topics
    }

    /// What was found missing when the recording was opened; empty where it is whole as far as its index tells.
    /// [`Recording::verify`] looks at everything.
    pub fn damage(&self) -> &[Damage] {
        &self.index.damage
    }

    /// First and last arrival; `None` without messages.
    pub fn arrival_range(&self) -> Option<ArrivalRange> {
        Some(ArrivalRange {
            start: timestamp(self.index.chunks.iter().map(|c| c.start_time).min()?),
            end: timestamp(self.index.chunks.iter().map(|c| c.end_time).max()?),
        })
    }

    /// Reads every chunk and walks its records, on all cores, and says everything that is missing, in the order of the file.
    pub fn verify(&self, progress: ProgressFn<'_>) -> Result<Vec<Damage>, Error> {
        verify::all(&self.source, &self.index, progress)
    }

    /// How many of its chunks have no checksum: of these nobody can tell whether the bytes of a message are those that were written.
    pub fn chunks_without_checksum(&self) -> Result<u64, Error> {
        let mut without = 0;
        for entry in &self.index.chunks {
            without += u64::from(!chunk::has_checksum(&self.source, entry)?);
        }
        Ok(without)
    }

    /// When the messages of each topic arrived, from the indices alone: fast whatever the size of the file. Chunks without
    /// message indices are passed over.
    pub fn arrivals(&self, progress: ProgressFn<'_>) -> Result<Vec<TopicArrivals>, Error> {
        verify::arrivals(&self.source, &self.index, progress)
    }

    /// The last message of a topic, found from the end: fast whatever the size of the file. `None` where there is none.
    pub fn last_message(&self, topic: &str) -> Result<Option<CdrMessage>, Error> {
        let channels: Vec<u16> = self.channels_of(topic).collect();
        let mut last = None;
        self.visit_last_chunk(&channels, |message| {
            last = Some(CdrMessage {
                time: timestamp(message.publish_time),
                arrival: timestamp(message.log_time),
                bytes: message.data.to_vec(),
            });
        })?;
        Ok(last)
    }

    /// Until when images, scans or inertial samples were measured, by the last chunk that has any: right to the length of a
    /// chunk, and fast whatever the size of the file. `None` where there are none.
    pub fn end_time(&self) -> Result<Option<Timestamp>, Error> {
        let samples = [message::IMAGE, message::IMU, message::POINT_CLOUD];
        let schemas = &self.index.schemas;
        let is_measured = |schema_id: &u16| {
            let name = schemas.get(schema_id).map(|s| s.name.as_str());
            name.is_some_and(|name| {
                samples.iter().any(|s| s.name == name) || message::holds_lidar_packets(name)
            })
        };
        let channels = self.index.channels.values();
        let channels: Vec<u16> = channels
            .filter(|c| is_measured(&c.schema_id))
            .map(|c| c.id)
            .collect();
        let mut end = None;
        self.visit_last_chunk(&channels, |message| {
            end = end.max(Some(timestamp(message.publish_time)));
        })?;
        Ok(end)
    }

    /// Shows `take` the messages on `channels` of the last whole chunk that has any, in the order of the file.
    fn visit_last_chunk(
        &self,
        channels: &[u16],
        mut take: impl FnMut(&MessageRecord<'_>),
    ) -> Result<(), Error> {
        let with_channel = |c: &&ChunkEntry| channels.iter().any(|id| c.channels.contains(id));
        for entry in self.index.chunks.iter().rev().filter(with_channel) {
            let mut records = Vec::new();
            match chunk::read(&self.source, entry, &mut records) {
                Ok(()) => {}
                Err(Error::Damaged { .. }) => continue,
                Err(error) => return Err(error),
            }
            let mut rest = records.as_slice();
            let mut any = false;
            while let Some((opcode, body)) = record::next_record(&mut rest) {
                if opcode == opcode::MESSAGE
                    && let Some(message) = record::message(body)
                    && channels.contains(&message.channel_id)
                {
                    take(&message);
                    any = true;
                }
            }
            if any {
                break;
            }
        }
        Ok(())
    }

    /// Content of an attachment.
    pub fn attachment(&self, name: &str) -> Result<Vec<u8>, Error> {
        let missing = || Error::MissingAttachment {
            path: self.path().to_owned(),
            name: name.to_owned(),
        };
        let entry = self
            .index
            .attachments
            .iter()
            .rfind(|a| a.name == name)
            .ok_or_else(missing)?;
        let bytes = self.source.read(entry.offset, entry.record_bytes)?;
        match record::next_record(&mut bytes.as_slice()) {
            Some((opcode::ATTACHMENT, body)) => {
                record::attachment(body).map(|(_, data)| data.to_vec())
            }
            _ => None,
        }
        .ok_or_else(|| self.broken("attachment", entry))
    }

    /// Entries of a metadata record, `lsfb.session` among them; empty where there is none of that name.
    pub fn metadata(&self, name: &str) -> Result<BTreeMap<String, String>, Error> {
        let Some(entry) = self.index.metadata.iter().rfind(|m| m.name == name) else {
            return Ok(BTreeMap::new());
        };
        let bytes = self.source.read(entry.offset, entry.record_bytes)?;
        match record::next_record(&mut bytes.as_slice()) {
            Some((opcode::METADATA, body)) => record::metadata(body).map(|(_, entries)| entries),
            _ => None,
        }
        .ok_or_else(|| self.broken("metadata", entry))
    }

    pub(crate) fn channels_of(&self, topic: &str) -> impl Iterator<Item = u16> {
        let matching = self
            .index
            .channels
            .values()
            .filter(move |c| c.topic == topic);
        matching.map(|c| c.id).collect::<Vec<_>>().into_iter()
    }

    pub(crate) fn check_type(&self, topic: &str, schema: &str) -> Result<(), Error> {
        let mut known = false;
        for channel in self.index.channels.values().filter(|c| c.topic == topic) {
            known = true;
            let found = self
                .index
                .schemas
                .get(&channel.schema_id)
                .map_or("no schema", |s| s.name.as_str());
            if found != schema || channel.message_encoding != "cdr" {
                return Err(Error::TopicType {
                    path: self.path().to_owned(),
                    topic: topic.to_owned(),
                    found: format!("{} {found}", channel.message_encoding),
                    expected: format!("cdr {schema}"),
                });
            }
        }
        if known {
            Ok(())
        } else {
            Err(self.no_such_topic(topic))
        }
    }

    pub(crate) fn no_such_topic(&self, wanted: &str) -> Error {
        let available: Vec<&str> = self.topics.iter().map(|t| t.topic.as_str()).collect();
        Error::NoSuchTopic {
            path: self.path().to_owned(),
            wanted: wanted.to_owned(),
            available: if available.is_empty() {
                "no topics".to_owned()
            } else {
                available.join(", ")
            },
        }
    }

    fn broken(&self, what: &str, entry: &NamedRecord) -> Error {
        let reason = format!("{what} `{}` is broken", entry.name);
        self.source
            .damaged(entry.offset, entry.record_bytes, None, reason)
    }
}

fn topics(index: &Index) -> Vec<TopicSummary> {
    let mut topics: BTreeMap<&str, TopicSummary> = BTreeMap::new();
    for channel in index.channels.values() {
        let schema = index.schemas.get(&channel.schema_id);
        let entry = topics
            .entry(&channel.topic)
            .or_insert_with(|| TopicSummary {
                topic: channel.topic.clone(),
                schema: schema.map_or_else(String::new, |s| s.name.clone()),
                messages: 0,
            });
        entry.messages += index
            .messages_by_channel
            .get(&channel.id)
            .copied()
            .unwrap_or(0);
    }
    topics.into_values().collect()
}
