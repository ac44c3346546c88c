use std::fs::File;
use std::io::{BufWriter, Error, ErrorKind, Result, Seek, SeekFrom, Write};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::layout::Durability;

/// What the writer needs to know of the file while the MCAP encoder owns the [`Sink`].
#[derive(Default)]
pub(crate) struct SinkState {
    /// The first failure; from then on nothing reaches the file.
    pub failure: Option<String>,
    /// Everything up to here is in the file and ends with a whole record.
    pub intact_bytes: u64,
    /// While `Some`, bytes are kept here instead of going to the file.
    pub held: Option<Vec<u8>>,
}

/// The file below the MCAP encoder. It never fails towards the encoder, which would panic or write on behind a hole:
/// after the first failure it swallows everything, and the [`Writer`](crate::Writer) asks for the failure after each call.
pub(crate) struct Sink {
    /// `None` once a write has failed.
    file: Option<BufWriter<File>>,
    state: Arc<Mutex<SinkState>>,
    durability: Durability,
    position: u64,
}

impl Sink {
    pub fn new(file: File, durability: Durability) -> Self {
        Self {
            file: Some(BufWriter::with_capacity(1 << 20, file)),
            state: Arc::default(),
            durability,
            position: 0,
        }
    }

    pub fn state(&self) -> SharedState {
        SharedState(Arc::clone(&self.state))
    }

    /// Takes what was held back, as if it had never been written.
    pub fn release(&mut self) -> Vec<u8> {
        let held = self.state().lock().held.take().unwrap_or_default();
        self.position -= held.len() as u64;
        held
    }

    /// Runs `operation` on the file; the first failure cuts the file back to its last whole record and closes it.
    fn attempt(&mut self, operation: impl FnOnce(&mut BufWriter<File>) -> Result<()>) -> bool {
        let Some(file) = &mut self.file else {
            return false;
        };
        let Err(error) = operation(file) else {
            return true;
        };
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.failure = Some(format!("cannot write: {error}"));
        if let Some(file) = self.file.take() {
            // Dropping the buffered writer would write what it still holds, behind what is missing.
            let (file, _) = file.into_parts();
            // Best effort: a reader recognises the broken tail as well.
            let _ = file.set_len(state.intact_bytes);
        }
        false
    }
}

/// A handle on the [`SinkState`].
#[derive(Clone)]
pub(crate) struct SharedState(Arc<Mutex<SinkState>>);

impl SharedState {
    pub fn lock(&self) -> MutexGuard<'_, SinkState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        self.position += bytes.len() as u64;
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(held) = &mut state.held {
            held.extend_from_slice(bytes);
        } else {
            drop(state);
            self.attempt(|file| file.write_all(bytes));
        }
        Ok(bytes.len())
    }

    /// Called where a record ends.
    fn flush(&mut self) -> Result<()> {
        let durability = self.durability;
        let done = self.attempt(|file| {
            file.flush()?;
            match durability {
                Durability::Process => Ok(()),
                Durability::Power => file.get_ref().sync_data(),
            }
        });
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if done && state.held.is_none() {
            state.intact_bytes = self.position;
        }
        Ok(())
    }
}

impl Seek for Sink {
    /// The encoder buffers its chunks and only asks where it is.
    fn seek(&mut self, target: SeekFrom) -> Result<u64> {
        match target {
            SeekFrom::Current(0) => Ok(self.position),
            _ => Err(Error::from(ErrorKind::Unsupported)),
        }
    }
}
