//! The messages of some channels in the order of the file, and each sample joined with what was written beside it.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

use lsfb_types::Stamped;

use crate::cdr::CdrError;
use crate::container::chunk::RECORDS_BROKEN;
use crate::container::chunk_cache::ChunkCache;
use crate::container::index::Index;
use crate::container::record::{self, MessageRecord, opcode, timestamp};
use crate::container::source::Source;
use crate::error::Error;
use crate::message;

/// Companion messages waiting for their sample; more than this many are not waited for.
const MAX_WAITING_COMPANIONS: usize = 4096;

pub(crate) fn stamped<T>(message: &MessageRecord<'_>, device_ticks: u64, sample: T) -> Stamped<T> {
    Stamped {
        time: timestamp(message.publish_time),
        arrival: timestamp(message.log_time),
        device_ticks,
        sample,
    }
}

/// What a channel is to an iterator.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Role {
    /// Carries the samples of the n-th thing asked for.
    Sample(usize),
    /// Carries what belongs to them.
    Companion(usize),
}

/// Companions whose sample is still to come, by number and publish time.
pub(crate) struct Waiting<T>(BTreeMap<(usize, u64), T>);

impl<T> Default for Waiting<T> {
    fn default() -> Self {
        Self(BTreeMap::new())
    }
}

impl<T> Waiting<T> {
    pub fn put(&mut self, of: usize, publish_time: u64, companion: T) {
        if self.0.len() >= MAX_WAITING_COMPANIONS {
            self.0.pop_first();
        }
        self.0.insert((of, publish_time), companion);
    }

    pub fn take(&mut self, of: usize, publish_time: u64) -> Option<T> {
        self.0.remove(&(of, publish_time))
    }
}

/// Decodes samples whose device counter travels beside them in a time reference.
pub(crate) fn with_ticks<T>(
    decode: impl Fn(&[u8]) -> Result<T, CdrError>,
) -> impl FnMut(Role, &MessageRecord<'_>) -> Result<Option<Stamped<T>>, CdrError> {
    let mut ticks = Waiting::default();
    move |role, message| match role {
        Role::Companion(of) => {
            let reference = message::decode_time_reference(message.data)?;
            ticks.put(of, message.publish_time, reference.device_ticks);
            Ok(None)
        }
        Role::Sample(of) => {
            let sample = decode(message.data)?;
            let device_ticks = ticks.take(of, message.publish_time).unwrap_or(0);
            Ok(Some(stamped(message, device_ticks, sample)))
        }
    }
}

/// The messages of some channels, chunk after chunk.
pub(crate) struct MessageIter<'a> {
    source: &'a Source,
    index: &'a Index,
    roles: BTreeMap<u16, Role>,
    cache: Rc<RefCell<ChunkCache>>,
    next_chunk: usize,
    chunk_offset: u64,
    records: Rc<Vec<u8>>,
    position: usize,
}

pub(crate) struct Found<'a> {
    pub role: Role,
    pub message: MessageRecord<'a>,
}

impl<'a> MessageIter<'a> {
    pub fn new(source: &'a Source, index: &'a Index, roles: BTreeMap<u16, Role>) -> Self {
        let cache = Rc::new(RefCell::new(ChunkCache::new(1)));
        Self::through(source, index, roles, cache)
    }

    /// One that shares unpacked chunks with others.
    pub fn through(
        source: &'a Source,
        index: &'a Index,
        roles: BTreeMap<u16, Role>,
        cache: Rc<RefCell<ChunkCache>>,
    ) -> Self {
        Self {
            source,
            index,
            roles,
            cache,
            next_chunk: 0,
            chunk_offset: 0,
            records: Rc::default(),
            position: 0,
        }
    }

    pub fn next_message(&mut self) -> Option<Result<Found<'_>, Error>> {
        let (role, start, end) = loop {
            let rest = self.records.get(self.position..).unwrap_or_default();
            if rest.is_empty() {
                if let Err(error) = self.load_next_chunk()? {
                    return Some(Err(error));
                }
                continue;
            }
            let mut records = rest;
            let Some((opcode, body)) = record::next_record(&mut records) else {
                let lost = rest.len() as u64;
                let reason = RECORDS_BROKEN.to_owned();
                self.records = Rc::default();
                return Some(Err(self.source.damaged(
                    self.chunk_offset,
                    lost,
                    None,
                    reason,
                )));
            };
            let end = self.records.len() - records.len();
            let start = end - body.len();
            self.position = end;
            if opcode != opcode::MESSAGE {
                continue;
            }
            let role = record::message(body).and_then(|m| self.roles.get(&m.channel_id));
            if let Some(role) = role {
                break (*role, start, end);
            }
        };
        let message = record::message(self.records.get(start..end)?)?;
        Some(Ok(Found { role, message }))
    }

    /// `None` after the last chunk.
    fn load_next_chunk(&mut self) -> Option<Result<(), Error>> {
        self.records = Rc::default();
        self.position = 0;
        loop {
            let entry = self.index.chunks.get(self.next_chunk)?;
            self.next_chunk += 1;
            if self.roles.keys().any(|id| entry.channels.contains(id)) {
                self.chunk_offset = entry.offset;
                let read = self.cache.borrow_mut().read(self.source, entry);
                return Some(read.map(|records| self.records = records));
            }
        }
    }
}
