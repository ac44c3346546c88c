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

/// Length and hash of a file.
#[derive(PartialEq, Eq)]
pub(crate) struct Fingerprint {
    pub bytes: u64,
    pub sha256: String,
}

impl Fingerprint {
    /// Reads the file rather than mapping it: a map is larger than what is looked at later, and whatever was looked at in a mapped file
    /// counts as memory of this process.
    pub fn of(path: &Path) -> Result<Self, Error> {
        const PIECE: usize = 1 << 20;
        let mut file = File::open(path).map_err(Error::io(path))?;
        let (mut hash, mut bytes) = (Sha256::new(), 0);
        let mut piece = vec![0; PIECE];
        loop {
            match file.read(&mut piece) {
                Ok(0) => break,
                Ok(count) => {
                    hash.update(&piece[..count]);
                    bytes += count as u64;
                }
                Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
                Err(e) => return Err(Error::io(path)(e)),
            }
        }
        let sha256 = hash.finalize().iter().map(|b| format!("{b:02x}")).collect();
        Ok(Self { bytes, sha256 })
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
