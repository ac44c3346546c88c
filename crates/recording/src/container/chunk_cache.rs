//! Unpacked chunks that several readers share.

use std::collections::BTreeSet;
use std::rc::Rc;

use crate::container::chunk;
use crate::container::index::ChunkEntry;
use crate::container::source::Source;
use crate::error::Error;

/// Unpacked chunks that several readers share: where they run side by side, each chunk is unpacked once.
pub(crate) struct ChunkCache {
    capacity: usize,
    /// The latest last.
    chunks: Vec<(u64, Rc<Vec<u8>>)>,
    /// Chunks whose damage has been told: once, not by every reader.
    broken: BTreeSet<u64>,
}

impl ChunkCache {
    pub fn new(capacity: usize) -> Self {
        Self {
            capacity,
            chunks: Vec::new(),
            broken: BTreeSet::new(),
        }
    }

    pub fn read(&mut self, source: &Source, entry: &ChunkEntry) -> Result<Rc<Vec<u8>>, Error> {
        if let Some(at) = self.chunks.iter().position(|(at, _)| *at == entry.offset) {
            let found = self.chunks.remove(at);
            let records = Rc::clone(&found.1);
            self.chunks.push(found);
            return Ok(records);
        }
        if self.broken.contains(&entry.offset) {
            return Ok(Rc::default());
        }
        let mut records = Vec::new();
        if self.chunks.len() >= self.capacity && !self.chunks.is_empty() {
            // Its memory is used again where nobody reads it any more.
            let (_, oldest) = self.chunks.remove(0);
            records = Rc::try_unwrap(oldest).unwrap_or_default();
        }
        if let Err(error) = chunk::read(source, entry, &mut records) {
            self.broken.insert(entry.offset);
            return Err(error);
        }
        let records = Rc::new(records);
        self.chunks.push((entry.offset, Rc::clone(&records)));
        Ok(records)
    }
}
