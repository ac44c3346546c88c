//! MCAP records as bytes: framing and the fields we need, every length checked before use.

use std::collections::BTreeMap;

use lsfb_types::Timestamp;

/// The bytes a file begins and ends with (MCAP 0, "Magic").
pub(crate) const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";

/// Opcode and length.
pub(crate) const HEAD_BYTES: u64 = 9;
/// Size of a footer record, head included.
pub(crate) const FOOTER_BYTES: u64 = HEAD_BYTES + 20;

/// MCAP times are unsigned; what does not fit is far outside any recording.
pub(crate) fn timestamp(nanos: u64) -> Timestamp {
    Timestamp::from_nanos(i64::try_from(nanos).unwrap_or(i64::MAX))
}

pub(crate) mod opcode {
    pub const HEADER: u8 = 0x01;
    pub const FOOTER: u8 = 0x02;
    pub const SCHEMA: u8 = 0x03;
    pub const CHANNEL: u8 = 0x04;
    pub const MESSAGE: u8 = 0x05;
    pub const CHUNK: u8 = 0x06;
    pub const MESSAGE_INDEX: u8 = 0x07;
    pub const CHUNK_INDEX: u8 = 0x08;
    pub const ATTACHMENT: u8 = 0x09;
    pub const STATISTICS: u8 = 0x0B;
    pub const ATTACHMENT_INDEX: u8 = 0x0A;
    pub const METADATA: u8 = 0x0C;
    pub const METADATA_INDEX: u8 = 0x0D;
    pub const SUMMARY_OFFSET: u8 = 0x0E;
    pub const DATA_END: u8 = 0x0F;
    /// Records above are for private use.
    pub const PRIVATE: u8 = 0x80;
}

/// Takes fields off the front of a record; `None` where it ends too early.
#[derive(Clone, Copy)]
pub(crate) struct Fields<'a>(pub &'a [u8]);

impl<'a> Fields<'a> {
    pub fn raw(&mut self, length: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(taken)
    }

    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*taken)
    }

    pub fn u8(&mut self) -> Option<u8> {
        self.take().map(u8::from_le_bytes)
    }

    pub fn u16(&mut self) -> Option<u16> {
        self.take().map(u16::from_le_bytes)
    }

    pub fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }

    pub fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()? as usize;
        self.raw(length)
    }

    pub fn string(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.bytes()?).ok()
    }
}

/// The next record of `bytes`: opcode and body.
pub(crate) fn next_record<'a>(bytes: &mut &'a [u8]) -> Option<(u8, &'a [u8])> {
    let mut fields = Fields(bytes);
    let opcode = fields.u8()?;
    let length = usize::try_from(fields.u64()?).ok()?;
    let body = fields.raw(length)?;
    *bytes = fields.0;
    Some((opcode, body))
}

/// How many of the bytes are whole records, from the first on; messages among them have their head.
pub(crate) fn whole_bytes(records: &[u8]) -> usize {
    let mut rest = records;
    let mut whole = 0;
    while let Some((opcode, body)) = next_record(&mut rest) {
        if opcode == opcode::MESSAGE && message(body).is_none() {
            break;
        }
        whole = records.len() - rest.len();
    }
    whole
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct SchemaRecord {
    pub id: u16,
    pub name: String,
    pub encoding: String,
    pub text: String,
}

pub(crate) fn schema(body: &[u8]) -> Option<SchemaRecord> {
    let mut fields = Fields(body);
    Some(SchemaRecord {
        id: fields.u16()?,
        name: fields.string()?.to_owned(),
        encoding: fields.string()?.to_owned(),
        text: String::from_utf8_lossy(fields.bytes()?).into_owned(),
    })
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ChannelRecord {
    pub id: u16,
    pub schema_id: u16,
    pub topic: String,
    pub message_encoding: String,
}

pub(crate) fn channel(body: &[u8]) -> Option<ChannelRecord> {
    let mut fields = Fields(body);
    Some(ChannelRecord {
        id: fields.u16()?,
        schema_id: fields.u16()?,
        topic: fields.string()?.to_owned(),
        message_encoding: fields.string()?.to_owned(),
    })
}

pub(crate) struct MessageRecord<'a> {
    pub channel_id: u16,
    pub log_time: u64,
    pub publish_time: u64,
    pub data: &'a [u8],
}

pub(crate) fn message(body: &[u8]) -> Option<MessageRecord<'_>> {
    let mut fields = Fields(body);
    let channel_id = fields.u16()?;
    let _sequence = fields.u32()?;
    Some(MessageRecord {
        channel_id,
        log_time: fields.u64()?,
        publish_time: fields.u64()?,
        data: fields.0,
    })
}

/// How a chunk's records are packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Packing {
    Plain,
    Lz4,
    Zstd,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ChunkHead {
    pub start_time: u64,
    pub end_time: u64,
    pub uncompressed_bytes: u64,
    pub uncompressed_crc: u32,
    pub packing: Packing,
    pub compressed_bytes: u64,
    /// Size of these fields.
    pub head_bytes: u64,
}

/// Longest head of a chunk record that can be one: the name of its compression has at most four letters.
pub(crate) const MAX_CHUNK_HEAD_BYTES: usize = 44;

/// The head of a chunk record of `record_bytes`; `None` where the fields contradict each other.
pub(crate) fn chunk_head(body_start: &[u8], record_bytes: u64) -> Option<ChunkHead> {
    let mut fields = Fields(body_start);
    let start_time = fields.u64()?;
    let end_time = fields.u64()?;
    let uncompressed_bytes = fields.u64()?;
    let uncompressed_crc = fields.u32()?;
    let packing = match fields.bytes()? {
        b"" => Packing::Plain,
        b"lz4" => Packing::Lz4,
        b"zstd" => Packing::Zstd,
        _ => return None,
    };
    let compressed_bytes = fields.u64()?;
    let head_bytes = (body_start.len() - fields.0.len()) as u64;
    let consistent =
        head_bytes.checked_add(compressed_bytes) == Some(record_bytes) && start_time <= end_time;
    consistent.then_some(ChunkHead {
        start_time,
        end_time,
        uncompressed_bytes,
        uncompressed_crc,
        packing,
        compressed_bytes,
        head_bytes,
    })
}

/// The arrival times that a message index lists, in its order.
pub(crate) fn message_index_times(body: &[u8]) -> Option<(u16, impl Iterator<Item = u64> + '_)> {
    let mut fields = Fields(body);
    let channel = fields.u16()?;
    let entries = fields.bytes()?;
    let times = entries
        .chunks_exact(MESSAGE_INDEX_ENTRY_BYTES as usize)
        .filter_map(|entry| {
            entry
                .first_chunk::<8>()
                .map(|time| u64::from_le_bytes(*time))
        });
    Some((channel, times))
}

/// What the first bytes of a message index tell.
pub(crate) struct MessageIndexHead {
    pub channel_id: u16,
    pub messages: u64,
}

pub(crate) const MESSAGE_INDEX_HEAD_BYTES: u64 = 6;
const MESSAGE_INDEX_ENTRY_BYTES: u64 = 16;

/// The head of a message index of `body_bytes`; `None` where its list has another size.
pub(crate) fn message_index_head(body_start: &[u8], body_bytes: u64) -> Option<MessageIndexHead> {
    let mut fields = Fields(body_start);
    let channel_id = fields.u16()?;
    let list_bytes = u64::from(fields.u32()?);
    (MESSAGE_INDEX_HEAD_BYTES + list_bytes == body_bytes).then_some(MessageIndexHead {
        channel_id,
        messages: list_bytes / MESSAGE_INDEX_ENTRY_BYTES,
    })
}

pub(crate) struct ChunkIndexRecord {
    pub start_time: u64,
    pub end_time: u64,
    pub offset: u64,
    pub record_bytes: u64,
    pub channels: Vec<u16>,
    /// Size of the message indices behind the chunk.
    pub index_bytes: u64,
}

pub(crate) fn chunk_index(body: &[u8]) -> Option<ChunkIndexRecord> {
    let mut fields = Fields(body);
    let start_time = fields.u64()?;
    let end_time = fields.u64()?;
    let offset = fields.u64()?;
    let record_bytes = fields.u64()?;
    let mut offsets = Fields(fields.bytes()?);
    let mut channels = Vec::with_capacity(offsets.0.len() / 10);
    while !offsets.0.is_empty() {
        channels.push(offsets.u16()?);
        offsets.u64()?;
    }
    let index_bytes = fields.u64()?;
    Some(ChunkIndexRecord {
        index_bytes,
        start_time,
        end_time,
        offset,
        record_bytes,
        channels,
    })
}

/// Messages by channel, and the number of chunks.
pub(crate) struct StatisticsRecord {
    pub messages: u64,
    pub chunks: u32,
    pub by_channel: BTreeMap<u16, u64>,
}

pub(crate) fn statistics(body: &[u8]) -> Option<StatisticsRecord> {
    let mut fields = Fields(body);
    let messages = fields.u64()?;
    let _schemas = fields.u16()?;
    let (_channels, _attachments, _metadata) = (fields.u32()?, fields.u32()?, fields.u32()?);
    let chunks = fields.u32()?;
    let (_start, _end) = (fields.u64()?, fields.u64()?);
    let mut counts = Fields(fields.bytes()?);
    let mut by_channel = BTreeMap::new();
    while !counts.0.is_empty() {
        by_channel.insert(counts.u16()?, counts.u64()?);
    }
    Some(StatisticsRecord {
        messages,
        chunks,
        by_channel,
    })
}

/// Where a named record lies, head included.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct NamedRecord {
    pub name: String,
    pub offset: u64,
    pub record_bytes: u64,
}

pub(crate) fn attachment_index(body: &[u8]) -> Option<NamedRecord> {
    let mut fields = Fields(body);
    let (offset, record_bytes) = (fields.u64()?, fields.u64()?);
    let (_log_time, _create_time, _data_bytes) = (fields.u64()?, fields.u64()?, fields.u64()?);
    Some(NamedRecord {
        name: fields.string()?.to_owned(),
        offset,
        record_bytes,
    })
}

pub(crate) fn metadata_index(body: &[u8]) -> Option<NamedRecord> {
    let mut fields = Fields(body);
    let (offset, record_bytes) = (fields.u64()?, fields.u64()?);
    Some(NamedRecord {
        name: fields.string()?.to_owned(),
        offset,
        record_bytes,
    })
}

/// Name and content of an attachment; `None` where it is broken or its checksum differs.
pub(crate) fn attachment(body: &[u8]) -> Option<(&str, &[u8])> {
    let mut fields = Fields(body);
    let (_log_time, _create_time) = (fields.u64()?, fields.u64()?);
    let name = fields.string()?;
    let _media_type = fields.string()?;
    let length = usize::try_from(fields.u64()?).ok()?;
    let data = fields.raw(length)?;
    let checked = body.len() - fields.0.len();
    let crc = fields.u32()?;
    (crc == 0 || crc == crc32fast::hash(&body[..checked])).then_some((name, data))
}

/// Name and entries of a metadata record.
pub(crate) fn metadata(body: &[u8]) -> Option<(&str, BTreeMap<String, String>)> {
    let mut fields = Fields(body);
    let name = fields.string()?;
    let mut entries = Fields(fields.bytes()?);
    let mut map = BTreeMap::new();
    while !entries.0.is_empty() {
        map.insert(entries.string()?.to_owned(), entries.string()?.to_owned());
    }
    Some((name, map))
}
