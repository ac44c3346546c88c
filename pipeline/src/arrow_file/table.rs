use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use arrow_buffer::{Buffer, ScalarBuffer};
use sha2::{Digest, Sha256};

use super::{Column, map_table, read_table};
use crate::Error;

/// The bytes of a table's file, mapped into memory, with its path for errors.
pub(crate) struct Table {
    pub path: PathBuf,
    pub bytes: Buffer,
}

/// Length, hash and checksum of a file.
#[derive(PartialEq, Eq)]
pub(crate) struct Fingerprint {
    pub bytes: u64,
    pub sha256: String,
    pub crc32c: String,
}

impl Fingerprint {
    /// Of the whole file, from the disk.
    pub fn of(path: &Path) -> Result<Self, Error> {
        let (mut hash, mut crc) = (Sha256::new(), 0);
        let bytes = in_pieces(path, |piece| {
            hash.update(piece);
            crc = crc32c::crc32c_append(crc, piece);
        })?;
        Ok(Self {
            bytes,
            sha256: hash.finalize().iter().map(|b| format!("{b:02x}")).collect(),
            crc32c: checksum(crc),
        })
    }
}

/// Length and CRC-32C of a file, which tell damage as fast as memory is read: a hash takes seconds for gigabytes.
pub(crate) fn length_and_crc32c(path: &Path) -> Result<(u64, String), Error> {
    let mut crc = 0;
    let bytes = in_pieces(path, |piece| crc = crc32c::crc32c_append(crc, piece))?;
    Ok((bytes, checksum(crc)))
}

fn checksum(crc: u32) -> String {
    format!("{crc:08x}")
}

/// Gives a file's bytes piece by piece, and their number. It is read rather than mapped: a map is larger than what is looked at later, and whatever
/// was looked at in a mapped file counts as memory of this process.
fn in_pieces(path: &Path, mut take: impl FnMut(&[u8])) -> Result<u64, Error> {
    // As much as stays in a core's cache until it is summed up.
    const PIECE: usize = 1 << 18;
    let mut file = File::open(path).map_err(Error::io(path))?;
    let mut bytes = 0;
    let mut piece = vec![0; PIECE];
    loop {
        match file.read(&mut piece) {
            Ok(0) => return Ok(bytes),
            Ok(count) => {
                take(&piece[..count]);
                bytes += count as u64;
            }
            Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
            Err(e) => return Err(Error::io(path)(e)),
        }
    }
}

/// A file of a map that is not what it should be.
pub(crate) fn broken(path: &Path, reason: &str) -> Error {
    Error::MapFile {
        path: path.to_owned(),
        reason: reason.to_owned(),
    }
}

impl Table {
    pub fn map(path: PathBuf) -> Result<Self, Error> {
        let bytes = map_table(&path)?;
        Ok(Self { path, bytes })
    }

    pub fn columns<const N: usize>(&self, names: [&'static str; N]) -> Result<[Column; N], Error> {
        let columns = read_table(&self.path, &self.bytes, &names)?;
        columns
            .try_into()
            .map_err(|_| broken(&self.path, "a column is missing"))
    }

    fn wrong_type(&self) -> Error {
        broken(&self.path, "a column has another type")
    }

    pub fn f64(&self, column: Column) -> Result<ScalarBuffer<f64>, Error> {
        if let Column::F64(v) = column {
            Ok(v)
        } else {
            Err(self.wrong_type())
        }
    }

    pub fn f32(&self, column: Column) -> Result<ScalarBuffer<f32>, Error> {
        if let Column::F32(v) = column {
            Ok(v)
        } else {
            Err(self.wrong_type())
        }
    }

    pub fn i64(&self, column: Column) -> Result<ScalarBuffer<i64>, Error> {
        if let Column::I64(v) = column {
            Ok(v)
        } else {
            Err(self.wrong_type())
        }
    }

    pub fn u32(&self, column: Column) -> Result<ScalarBuffer<u32>, Error> {
        if let Column::U32(v) = column {
            Ok(v)
        } else {
            Err(self.wrong_type())
        }
    }

    pub fn u16(&self, column: Column) -> Result<ScalarBuffer<u16>, Error> {
        if let Column::U16(v) = column {
            Ok(v)
        } else {
            Err(self.wrong_type())
        }
    }

    /// The rows, and the bytes of each.
    pub fn rows(&self, column: Column) -> Result<(Buffer, usize), Error> {
        match column {
            Column::Bytes { width, values } => Ok((values, width)),
            _ => Err(self.wrong_type()),
        }
    }

    pub fn bytes(&self, column: Column, expected: usize) -> Result<Buffer, Error> {
        match self.rows(column)? {
            (values, width) if width == expected => Ok(values),
            _ => Err(self.wrong_type()),
        }
    }

    pub fn lists(&self, column: Column, expected: usize) -> Result<ScalarBuffer<f32>, Error> {
        match column {
            Column::F32List { width, values } if width == expected => Ok(values),
            _ => Err(self.wrong_type()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is read in pieces has the checksums of the whole: those of the digits are the algorithms' own check values.
    #[test]
    fn fingerprints_are_of_the_whole_file() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("file");
        std::fs::write(&path, "123456789").expect("written");
        let found = Fingerprint::of(&path).expect("read");
        assert_eq!((found.bytes, &*found.crc32c), (9, "e3069283"));
        assert_eq!(&found.sha256[..16], "15e2b0d3c33891eb");
        let long: Vec<u8> = (0..600_001_u32)
            .map(|i| (i.wrapping_mul(7919) >> 5) as u8)
            .collect();
        std::fs::write(&path, &long).expect("written");
        let found = Fingerprint::of(&path).expect("read");
        assert_eq!(found.bytes, 600_001);
        assert_eq!(found.crc32c, checksum(crc32c::crc32c(&long)));
        let whole: String = Sha256::digest(&long)
            .iter()
            .map(|b| format!("{b:02x}"))
            .collect();
        assert_eq!(found.sha256, whole);
        let read = length_and_crc32c(&path).expect("read");
        assert_eq!(read, (found.bytes, found.crc32c));
    }
}
