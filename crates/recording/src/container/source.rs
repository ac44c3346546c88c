//! The file below a recording.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use crate::container::record::{self, HEAD_BYTES, opcode};
use crate::error::{Damage, Error};

/// A file that is read in pieces, each checked against its size.
pub(crate) struct Source {
    pub path: PathBuf,
    pub bytes: u64,
    file: File,
}

impl Source {
    pub fn open(path: &Path) -> Result<Self, Error> {
        let io = |source| Error::Io {
            path: path.to_owned(),
            action: "open the recording",
            source,
        };
        let file = File::open(path).map_err(io)?;
        let metadata = file.metadata().map_err(io)?;
        if metadata.is_dir() {
            return Err(io(std::io::Error::from(std::io::ErrorKind::IsADirectory)));
        }
        Ok(Self {
            path: path.to_owned(),
            bytes: metadata.len(),
            file,
        })
    }

    /// Replaces `buffer` by the bytes at `offset`; what lies behind the end is missing from it.
    pub fn read_into(&self, buffer: &mut Vec<u8>, offset: u64, length: u64) -> Result<(), Error> {
        let available = length.min(self.bytes.saturating_sub(offset));
        // Memory that is overwritten anyway is not cleared first.
        buffer.resize(available as usize, 0);
        self.file
            .read_exact_at(buffer, offset)
            .map_err(|source| Error::Io {
                path: self.path.clone(),
                action: "read the recording",
                source,
            })
    }

    pub fn read(&self, offset: u64, length: u64) -> Result<Vec<u8>, Error> {
        let mut buffer = Vec::new();
        self.read_into(&mut buffer, offset, length)?;
        Ok(buffer)
    }

    /// Where the records of the data section begin, behind a header that is that of a recording.
    pub fn data_start(&self) -> Result<u64, Error> {
        let path = self.path.clone();
        if self.bytes == 0 {
            return Err(Error::Empty { path });
        }
        let start = self.read(0, 4096)?;
        let Some(mut records) = start.strip_prefix(record::MAGIC) else {
            return Err(Error::NotMcap { path });
        };
        let header = match record::next_record(&mut records) {
            Some((opcode::HEADER, body)) => record::Fields(body)
                .string()
                .map(|profile| (profile, body.len() as u64)),
            _ => None,
        };
        let Some((profile, header_bytes)) = header else {
            return Err(Error::NotMcap { path });
        };
        if profile != "ros2" {
            let found = profile.to_owned();
            return Err(Error::Profile { path, found });
        }
        Ok(record::MAGIC.len() as u64 + HEAD_BYTES + header_bytes)
    }

    pub fn damaged(&self, offset: u64, bytes: u64, messages: Option<u64>, reason: String) -> Error {
        Error::Damaged {
            path: self.path.clone(),
            damage: Damage {
                offset,
                bytes,
                messages,
                reason,
            },
        }
    }
}
