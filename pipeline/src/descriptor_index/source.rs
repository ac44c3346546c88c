use std::fs::File;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use crate::Error;
use crate::features::{DESCRIPTOR_LEN, Descriptor};

/// Where the descriptors are that an index is made of.
#[derive(Clone, Copy, Debug)]
pub enum DescriptorSource<'a> {
    /// In memory.
    Memory(&'a [Descriptor]),
    /// In a file, of which a piece at a time is read.
    File(&'a DescriptorFile),
}

impl DescriptorSource<'_> {
    /// Number of descriptors.
    pub fn len(&self) -> usize {
        match self {
            Self::Memory(descriptors) => descriptors.len(),
            Self::File(file) => file.len(),
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Some of them, in order. The range must lie within the number there is.
    pub fn read(&self, range: Range<usize>) -> Result<Vec<Descriptor>, Error> {
        match self {
            Self::Memory(descriptors) => Ok(descriptors[range].to_vec()),
            Self::File(file) => file.read(range),
        }
    }
}

/// Bytes before each descriptor: its length as a little-endian number.
const LENGTH_BYTES: usize = 4;
const RECORD_BYTES: usize = LENGTH_BYTES + DESCRIPTOR_LEN;

/// A `.bvecs` file of descriptors, the format of the public benchmarks of nearest-neighbour search: each is its length as a
/// little-endian u32, then its bytes (<http://corpus-texmex.irisa.fr>).
#[derive(Debug)]
pub struct DescriptorFile {
    path: PathBuf,
    file: File,
    len: usize,
}

impl DescriptorFile {
    /// Opens a file; refuses one whose length is not that of whole descriptors.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let file = File::open(path).map_err(Error::io(path))?;
        let bytes = file.metadata().map_err(Error::io(path))?.len();
        let count = usize::try_from(bytes / RECORD_BYTES as u64);
        match count {
            Ok(len) if bytes.is_multiple_of(RECORD_BYTES as u64) => Ok(Self {
                path: path.to_owned(),
                file,
                len,
            }),
            _ => Err(Error::DescriptorFile {
                path: path.to_owned(),
                reason: format!(
                    "{bytes} bytes are not a whole number of records of {RECORD_BYTES}"
                ),
            }),
        }
    }

    /// Number of descriptors.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Some of them, in order. Refuses records of another length, and a file that has become shorter.
    pub fn read(&self, range: Range<usize>) -> Result<Vec<Descriptor>, Error> {
        let mut bytes = vec![0; range.len() * RECORD_BYTES];
        let at = (range.start * RECORD_BYTES) as u64;
        self.file
            .read_exact_at(&mut bytes, at)
            .map_err(Error::io(&self.path))?;
        let records = bytes.as_chunks::<RECORD_BYTES>().0.iter().enumerate();
        records
            .map(|(i, record)| {
                let (length, descriptor) = record.split_at(LENGTH_BYTES);
                let expected = (DESCRIPTOR_LEN as u32).to_le_bytes();
                match <&Descriptor>::try_from(descriptor) {
                    Ok(descriptor) if length == expected => Ok(*descriptor),
                    _ => Err(Error::DescriptorFile {
                        path: self.path.clone(),
                        reason: format!(
                            "descriptor {} does not have {DESCRIPTOR_LEN} bytes",
                            range.start + i
                        ),
                    }),
                }
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_read_in_pieces_and_damage_is_named() {
        let folder = tempfile::tempdir().expect("scratch folder");
        let path = folder.path().join("few.bvecs");
        let descriptors: Vec<Descriptor> = (0..5u8).map(|i| [i; DESCRIPTOR_LEN]).collect();
        let record = |d: &Descriptor| [&[128, 0, 0, 0], d.as_slice()].concat();
        let bytes: Vec<u8> = descriptors.iter().flat_map(record).collect();
        std::fs::write(&path, &bytes).expect("written");
        let file = DescriptorFile::open(&path).expect("opened");
        assert_eq!(file.len(), 5);
        assert_eq!(file.read(2..4).expect("there"), descriptors[2..4]);
        assert!(file.read(4..6).is_err());

        std::fs::write(&path, &bytes[..bytes.len() - 1]).expect("cut off");
        let error = DescriptorFile::open(&path).expect_err("cut off");
        assert!(error.to_string().contains("few.bvecs"), "{error}");
        let mut other = bytes.clone();
        other[3 * RECORD_BYTES] = 64;
        std::fs::write(&path, &other).expect("written");
        let file = DescriptorFile::open(&path).expect("the length is right");
        let error = file.read(0..5).expect_err("another length");
        assert!(error.to_string().contains("descriptor 3"), "{error}");
    }
}
