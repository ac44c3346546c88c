//! ZIP archives, as far as wheels and PyTorch files use them: stored and deflated files, no ZIP64, no encryption.

use std::borrow::Cow;
use std::io::Read;

use crate::error::Damage;

const LOCAL: [u8; 4] = *b"PK\x03\x04";
const ENTRY: [u8; 4] = *b"PK\x01\x02";
const END: [u8; 4] = *b"PK\x05\x06";
/// Bytes of an entry of the directory, of the head of a file and of the end, without names and comments.
const ENTRY_BYTES: usize = 46;
const LOCAL_BYTES: usize = 30;
const END_BYTES: usize = 22;
const MAX_COMMENT_BYTES: usize = 0xffff;
/// The largest file that is unpacked, bytes.
const MAX_UNPACKED_BYTES: usize = 256 << 20;

const STORED: u16 = 0;
const DEFLATED: u16 = 8;

/// Whether these are the bytes of an archive.
pub fn is_archive(bytes: &[u8]) -> bool {
    bytes.starts_with(&LOCAL)
}

/// A file in an archive.
pub struct ArchivedFile<'a> {
    pub name: &'a str,
    method: u16,
    packed: &'a [u8],
    length: usize,
}

/// The files that the archive's directory lists.
pub fn files(bytes: &[u8]) -> Result<Vec<ArchivedFile<'_>>, Damage> {
    let cut_off = Damage::CutOff {
        what: "the directory of the archive",
    };
    let earliest = bytes.len().saturating_sub(END_BYTES + MAX_COMMENT_BYTES);
    let end = (earliest..=bytes.len().saturating_sub(END_BYTES))
        .rev()
        .find(|at| bytes[*at..].starts_with(&END))
        .ok_or(cut_off.clone())?;
    let count = u16_at(bytes, end + 10).ok_or(cut_off.clone())?;
    let mut at = u32_at(bytes, end + 16).ok_or(cut_off.clone())?;
    let mut files = Vec::new();
    for _ in 0..count {
        let (file, next) = entry(bytes, at).ok_or(cut_off.clone())?;
        files.push(file);
        at = next;
    }
    Ok(files)
}

/// The file of the entry at `at`, and where the next entry is.
fn entry(bytes: &[u8], at: usize) -> Option<(ArchivedFile<'_>, usize)> {
    let head = bytes.get(at..at.checked_add(ENTRY_BYTES)?)?;
    if !head.starts_with(&ENTRY) {
        return None;
    }
    let packed_len = u32_at(head, 20)?;
    let [name_len, extra_len, comment_len] =
        [28, 30, 32].map(|at| u16_at(head, at).map(usize::from));
    let name_end = at + ENTRY_BYTES + name_len?;
    let name = std::str::from_utf8(bytes.get(at + ENTRY_BYTES..name_end)?).ok()?;
    let local = u32_at(head, 42)?;
    let local_head = bytes.get(local..local.checked_add(LOCAL_BYTES)?)?;
    if !local_head.starts_with(&LOCAL) {
        return None;
    }
    let local_names = usize::from(u16_at(local_head, 26)?) + usize::from(u16_at(local_head, 28)?);
    let begin = local + LOCAL_BYTES + local_names;
    let file = ArchivedFile {
        name,
        method: u16_at(head, 10)?,
        packed: bytes.get(begin..begin.checked_add(packed_len)?)?,
        length: u32_at(head, 24)?,
    };
    Some((file, name_end + extra_len? + comment_len?))
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    let two = bytes.get(at..at.checked_add(2)?)?;
    Some(u16::from_le_bytes(two.try_into().ok()?))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<usize> {
    let four = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_le_bytes(four.try_into().ok()?) as usize)
}

impl<'a> ArchivedFile<'a> {
    /// Its bytes, unpacked.
    pub fn content(&self) -> Result<Cow<'a, [u8]>, Damage> {
        let damaged = Damage::CutOff {
            what: "a file in the archive",
        };
        let content = match self.method {
            STORED => Cow::Borrowed(self.packed),
            DEFLATED if self.length <= MAX_UNPACKED_BYTES => {
                let mut content = Vec::new();
                let unpacked = flate2::read::DeflateDecoder::new(self.packed);
                let mut limited = unpacked.take(self.length as u64 + 1);
                limited
                    .read_to_end(&mut content)
                    .map_err(|_| damaged.clone())?;
                Cow::Owned(content)
            }
            _ => return Err(damaged),
        };
        if content.len() == self.length {
            Ok(content)
        } else {
            Err(damaged)
        }
    }
}
