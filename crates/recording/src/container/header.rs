//! The header of a file: how it is written, and where the records begin behind one that is damaged.

use crate::container::emit;
use crate::container::record::{self, HEAD_BYTES, opcode};
use crate::container::source::Source;
use crate::error::Error;

/// A header, and what stands before the first chunk, fit into this.
const SEARCH_BYTES: u64 = 1 << 20;

/// Magic bytes and header record of a recording.
pub(crate) fn header() -> Vec<u8> {
    let mut bytes = record::MAGIC.to_vec();
    emit::record(&mut bytes, opcode::HEADER, |out| {
        emit::string(out, "ros2");
        emit::string(out, concat!("lsfb-recording ", env!("CARGO_PKG_VERSION")));
    });
    bytes
}

/// Whether what a header record says, profile and library, ends where the record does.
pub(crate) fn ends_at(source: &Source, data_start: u64) -> Result<bool, Error> {
    let start = record::MAGIC.len() as u64 + HEAD_BYTES;
    let body = source.read(start, data_start.saturating_sub(start))?;
    let mut fields = record::Fields(&body);
    Ok(fields.string().is_some() && fields.string().is_some() && fields.0.is_empty())
}

/// Where records begin in a file whose header cannot be read: the first offset at which a chunk begins, or two records in a
/// row that can be understood. The end of the file where there is none.
pub(crate) fn records_behind_damage(source: &Source) -> Result<u64, Error> {
    let window = source.read(0, SEARCH_BYTES)?;
    let is_start = |at: &usize| {
        let Some(first) = record_at(&window, *at, source.bytes) else {
            return false;
        };
        first.opcode == opcode::CHUNK || record_at(&window, first.end, source.bytes).is_some()
    };
    let found = (0..window.len()).find(is_start);
    Ok(found.map_or(source.bytes, |at| at as u64))
}

struct Understood {
    opcode: u8,
    end: usize,
}

/// The record at an offset, where it is of a kind that stands before or among the chunks and says what such a record says.
fn record_at(window: &[u8], at: usize, file_bytes: u64) -> Option<Understood> {
    let mut fields = record::Fields(window.get(at..)?);
    let (opcode, body_bytes) = (fields.u8()?, fields.u64()?);
    let end = (at as u64 + HEAD_BYTES).checked_add(body_bytes)?;
    if end > file_bytes {
        return None;
    }
    let understood = Understood {
        opcode,
        end: usize::try_from(end).ok()?,
    };
    if opcode == opcode::CHUNK {
        return record::chunk_head(fields.0, body_bytes).map(|_| understood);
    }
    let body = fields.0.get(..usize::try_from(body_bytes).ok()?)?;
    let says = match opcode {
        opcode::SCHEMA => record::schema(body).is_some_and(|s| !s.name.is_empty()),
        opcode::CHANNEL => record::channel(body).is_some_and(|c| !c.topic.is_empty()),
        opcode::ATTACHMENT => record::attachment(body).is_some_and(|(name, _)| !name.is_empty()),
        opcode::METADATA => record::metadata(body).is_some_and(|(name, _)| !name.is_empty()),
        _ => false,
    };
    says.then_some(understood)
}
