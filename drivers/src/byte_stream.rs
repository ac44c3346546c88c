//! Messages out of a byte stream that may begin anywhere and be damaged anywhere.

use std::collections::VecDeque;

use lsfb_types::Timestamp;

use crate::WireError;

/// Bytes that arrived in pieces, until messages have been made of them.
///
/// After a bad message it looks again from the byte behind the bogus beginning, so that a good message inside is found.
#[derive(Clone, Debug, Default)]
pub(crate) struct ByteStream {
    buffer: Vec<u8>,
    /// Bytes of the buffer that are done with; removed when they outweigh the rest.
    done: usize,
    /// Arrival of each pushed piece still in the buffer, with the piece's length.
    pieces: VecDeque<Piece>,
    skipped_bytes: u64,
    bad_checksums: u64,
}

#[derive(Clone, Copy, Debug)]
struct Piece {
    arrival: Timestamp,
    len: usize,
}

impl ByteStream {
    /// Adds bytes as they arrived.
    pub(crate) fn push(&mut self, arrival: Timestamp, bytes: &[u8]) {
        self.buffer.extend_from_slice(bytes);
        self.pieces.push_back(Piece {
            arrival,
            len: bytes.len(),
        });
    }

    /// The next message that `read` finds at the front of some bytes, with its length: `Ok(None)` where its end is not
    /// there yet, an error where none begins. `make` gets the arrival of its first byte.
    pub(crate) fn next<M, T>(
        &mut self,
        read: impl for<'a> Fn(&'a [u8]) -> Result<Option<(M, usize)>, WireError>,
        make: impl FnOnce(Timestamp, M) -> T,
    ) -> Option<T> {
        let mut at = 0;
        loop {
            let rest = self.buffer.get(self.done + at..).unwrap_or_default();
            match read(rest) {
                Ok(None) => {
                    self.drop_front(at);
                    return None;
                }
                Ok(Some((message, len))) => {
                    let made = make(self.arrival_at(at), message);
                    self.drop_front(at + len);
                    return Some(made);
                }
                Err(error) => {
                    self.skipped_bytes += 1;
                    if matches!(error, WireError::Checksum { .. }) {
                        self.bad_checksums += 1;
                    }
                    at += 1;
                }
            }
        }
    }

    /// For the end of the stream: gives up an unfinished message at the front, so that whole ones behind it are found.
    pub(crate) fn skip_unfinished(&mut self) -> bool {
        if self.done == self.buffer.len() {
            return false;
        }
        self.skipped_bytes += 1;
        self.drop_front(1);
        true
    }

    /// The bytes not yet part of a message.
    pub(crate) fn take_rest(&mut self) -> Vec<u8> {
        self.pieces.clear();
        let mut rest = std::mem::take(&mut self.buffer);
        rest.drain(..std::mem::take(&mut self.done));
        rest
    }

    /// Bytes that belong to no message.
    pub(crate) fn skipped_bytes(&self) -> u64 {
        self.skipped_bytes
    }

    /// Messages dropped for their checksum.
    pub(crate) fn bad_checksums(&self) -> u64 {
        self.bad_checksums
    }

    fn arrival_at(&self, offset: usize) -> Timestamp {
        let mut end = 0;
        for piece in &self.pieces {
            end += piece.len;
            if offset < end {
                return piece.arrival;
            }
        }
        self.pieces
            .back()
            .map_or(Timestamp::default(), |piece| piece.arrival)
    }

    fn drop_front(&mut self, mut count: usize) {
        self.done += count;
        if 2 * self.done > self.buffer.len() {
            self.buffer.drain(..self.done);
            self.done = 0;
        }
        while let Some(piece) = self.pieces.front_mut() {
            if piece.len > count {
                piece.len -= count;
                break;
            }
            count -= piece.len;
            self.pieces.pop_front();
        }
    }
}
