//! Codebooks as files: `FORMAT.md`.

use std::path::Path;

use sha2::{Digest, Sha256};

use super::Codebook;
use crate::Error;
use crate::features::DESCRIPTOR_LEN;

const MAGIC: &[u8; 8] = b"LSFBVLAD";
const VERSION: u32 = 1;
/// Magic, version, words, dimensions.
const HEAD_BYTES: usize = 20;
const HASH_BYTES: usize = 32;

impl Codebook {
    /// The bytes of a file.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        for number in [VERSION, self.len() as u32, DESCRIPTOR_LEN as u32] {
            bytes.extend(number.to_le_bytes());
        }
        bytes.extend(&self.words);
        let hash = Sha256::digest(&bytes);
        bytes.extend(hash);
        bytes
    }

    /// From the bytes of a file; the error says what is wrong with them.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, &'static str> {
        let head: &[u8; HEAD_BYTES] = bytes.first_chunk().ok_or("it is too short")?;
        if !head.starts_with(MAGIC) {
            return Err("it is not a codebook");
        }
        let [version, words, dimensions] = [8, 12, 16].map(|at| {
            u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]) as usize
        });
        if version != VERSION as usize {
            return Err("it has another version");
        }
        if dimensions != DESCRIPTOR_LEN {
            return Err("its descriptors have another length");
        }
        let length = words.checked_mul(DESCRIPTOR_LEN);
        let length = length.and_then(|n| n.checked_add(HEAD_BYTES + HASH_BYTES));
        if words == 0 || length != Some(bytes.len()) {
            return Err("its length does not match its header");
        }
        let (content, hash) = bytes.split_at(bytes.len() - HASH_BYTES);
        if Sha256::digest(content).as_slice() != hash {
            return Err("it is damaged: its hash does not match");
        }
        Ok(Self::of_words(content[HEAD_BYTES..].to_vec()))
    }

    /// Reads a file.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let bytes = std::fs::read(path).map_err(Error::io(path))?;
        Self::from_bytes(&bytes).map_err(|problem| Error::BadCodebook {
            path: path.to_owned(),
            problem,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comes_back_and_refuses_what_is_none() {
        let codebook = Codebook::of_words((0..3 * DESCRIPTOR_LEN).map(|k| k as u8).collect());
        let bytes = codebook.to_bytes();
        let read = Codebook::from_bytes(&bytes).expect("read");
        assert_eq!((read.len(), read.words), (3, codebook.words));
        for end in 0..bytes.len() {
            assert!(Codebook::from_bytes(&bytes[..end]).is_err(), "{end}");
        }
        for at in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[at] ^= 4;
            assert!(Codebook::from_bytes(&damaged).is_err(), "{at}");
        }
        let mut longer = bytes.clone();
        longer.push(0);
        assert!(Codebook::from_bytes(&longer).is_err());
    }
}
