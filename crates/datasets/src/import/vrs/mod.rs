//! VRS (`facebookresearch/vrs`): a file of records, each of a stream, packed or not. What the bytes of a record are is said in the head of
//! the file, as JSON: a layout of named values, and behind them an image or whatever else.
//!
//! Little endian throughout. Nothing in the file is believed: every length is checked against what is there.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

mod layout;

pub(super) use layout::{Layout, Values};

/// How a file begins.
pub(super) const MAGIC: &[u8] = b"VisionRe";
/// Bytes of the file's own head that are used, and those of a record's.
const FILE_HEAD: usize = 48;
const RECORD_HEAD: u64 = 32;
/// Types of records that are the file's own.
const OWN_TYPES: [u32; 2] = [1, 2];
/// A record that says what a sensor measured.
const DATA: u8 = 3;
/// Version of the description that is read.
const DESCRIPTION: u32 = 2;
/// Largest record, packed or not.
const MOST_BYTES: u64 = 256 << 20;

/// A stream: the type of its device, and which of those.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Id {
    pub(super) of: u32,
    pub(super) instance: u16,
}

impl std::fmt::Display for Id {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}-{}", self.of, self.instance)
    }
}

/// Where the bytes of a record are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RecordSpan {
    at: u64,
    size: u64,
    unpacked: u64,
    packing: u8,
}

impl RecordSpan {
    /// What is there, unpacked.
    fn read(&self, file: &mut File) -> Result<Vec<u8>, String> {
        let mut packed = vec![0; self.size as usize];
        read_at(file, self.at, &mut packed)?;
        let limit = self.unpacked + 1;
        let mut unpacked = Vec::new();
        let read = match self.packing {
            0 => return Ok(packed),
            1 => lz4::Decoder::new(packed.as_slice())
                .and_then(|d| d.take(limit).read_to_end(&mut unpacked)),
            2 => zstd::stream::read::Decoder::new(packed.as_slice())
                .and_then(|d| d.take(limit).read_to_end(&mut unpacked)),
            other => {
                return Err(format!(
                    "compression {other} is not supported: use lz4 or zstd"
                ));
            }
        };
        match read {
            Ok(_) if unpacked.len() as u64 == self.unpacked => Ok(unpacked),
            Ok(_) => Err(format!("it does not decompress to {} bytes", self.unpacked)),
            Err(why) => Err(format!("it cannot be decompressed: {why}")),
        }
    }
}

fn read_at(file: &mut File, at: u64, into: &mut [u8]) -> Result<(), String> {
    let read = file.seek(SeekFrom::Start(at));
    read.and_then(|_| file.read_exact(into))
        .map_err(|why| format!("byte {at}: {why}"))
}

/// A record of data.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    pub(super) id: Id,
    /// Version of its layout.
    pub(super) version: u32,
    /// Byte of the file at which its head is.
    pub(super) head_at: u64,
    pub(super) place: RecordSpan,
}

/// What a stream says of its records, by names.
pub(super) type Tags = BTreeMap<String, String>;

/// An open file.
pub(super) struct Vrs {
    pub(super) streams: BTreeMap<Id, Tags>,
    /// Tags of the file itself.
    pub(super) tags: Tags,
    file: File,
    length: u64,
    next: u64,
}

impl Vrs {
    /// Opens a file and reads its description; what is wrong with it, in words.
    pub(super) fn open(path: &Path) -> Result<Self, String> {
        let mut file = File::open(path).map_err(|e| e.to_string())?;
        let length = file.metadata().map_err(|e| e.to_string())?.len();
        let mut head = [0; FILE_HEAD];
        file.read_exact(&mut head)
            .map_err(|_| "truncated within its header".to_owned())?;
        let mut head = Bytes(&head);
        if head.take(MAGIC.len()) != Some(MAGIC) {
            return Err("not a VRS file".to_owned());
        }
        let cut = || "truncated within its header".to_owned();
        head.take(8);
        let own_head = u64::from(head.u32().ok_or_else(cut)?);
        let record_head = u64::from(head.u32().ok_or_else(cut)?);
        let [_, description, first] = [(); 3].map(|()| head.u64().unwrap_or_default());
        if record_head != RECORD_HEAD {
            return Err(format!(
                "records with a header of {record_head} bytes are not supported, only {RECORD_HEAD}"
            ));
        }
        let next = if first == 0 { own_head } else { first };
        let mut vrs = Self {
            streams: BTreeMap::new(),
            tags: Tags::new(),
            file,
            length,
            next,
        };
        let (found, size) = vrs.head(description)?;
        if found.version != DESCRIPTION {
            return Err(format!(
                "description version {} is not supported, only {DESCRIPTION}",
                found.version
            ));
        }
        if next >= length {
            return Err(format!(
                "truncated at byte {length}: its records begin at byte {next}"
            ));
        }
        let mut text = vec![0; usize::try_from(size - RECORD_HEAD).map_err(|e| e.to_string())?];
        vrs.read_at(description + RECORD_HEAD, &mut text)?;
        let damaged = || "its description is damaged".to_owned();
        (vrs.streams, vrs.tags) = described(&text).ok_or_else(damaged)?;
        Ok(vrs)
    }

    /// The next record of data; behind the last one, nothing. An error ends the file: where the next record would be is not known.
    pub(super) fn record(&mut self) -> Option<Result<Found, String>> {
        while self.next < self.length {
            let at = self.next;
            let (found, size) = match self.head(at) {
                Ok(found) => found,
                Err(why) => {
                    self.next = self.length;
                    return Some(Err(why));
                }
            };
            self.next = at + size;
            if !OWN_TYPES.contains(&found.id.of) && found.kind == DATA {
                return Some(Ok(Found {
                    id: found.id,
                    version: found.version,
                    head_at: at,
                    place: found.place,
                }));
            }
        }
        None
    }

    /// The bytes of a record, unpacked.
    pub(super) fn bytes(&mut self, place: &RecordSpan) -> Result<Vec<u8>, String> {
        place.read(&mut self.file)
    }

    fn read_at(&mut self, at: u64, into: &mut [u8]) -> Result<(), String> {
        read_at(&mut self.file, at, into)
    }

    /// The head of a record at a byte, and its size with it.
    fn head(&mut self, at: u64) -> Result<(Head, u64), String> {
        let breaks_off = || format!("breaks off at byte {at} of {}", self.length);
        let rest = self.length.checked_sub(at).ok_or_else(breaks_off)?;
        if rest < RECORD_HEAD {
            return Err(breaks_off());
        }
        let mut head = [0; RECORD_HEAD as usize];
        self.read_at(at, &mut head)?;
        let mut head = Bytes(&head);
        let damaged = || format!("byte {at}: a damaged record");
        let size = u64::from(head.u32().ok_or_else(damaged)?);
        let _ = head.u32();
        let of = head.u32().ok_or_else(damaged)?;
        let version = head.u32().ok_or_else(damaged)?;
        let _ = head.u64();
        let instance = head.u16().ok_or_else(damaged)?;
        let [kind, packing] = [(); 2].map(|()| head.take(1).map_or(0, |b| b[0]));
        let unpacked = u64::from(head.u32().ok_or_else(damaged)?);
        if !(RECORD_HEAD..=MOST_BYTES).contains(&size) || unpacked > MOST_BYTES {
            return Err(damaged());
        }
        if size > rest {
            return Err(format!("breaks off at byte {at} of {}", self.length));
        }
        let found = Head {
            id: Id { of, instance },
            version,
            kind,
            place: RecordSpan {
                at: at + RECORD_HEAD,
                size: size - RECORD_HEAD,
                unpacked,
                packing,
            },
        };
        Ok((found, size))
    }
}

struct Head {
    id: Id,
    version: u32,
    kind: u8,
    place: RecordSpan,
}

/// The image in a record, as its bytes: what is behind the values of its layout.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ImageAt {
    pub(super) file: PathBuf,
    pub(super) place: RecordSpan,
    /// Where it begins in the record.
    pub(super) skip: usize,
}

impl ImageAt {
    /// Reads it.
    pub(super) fn bytes(&self) -> Result<Vec<u8>, String> {
        let mut file = File::open(&self.file).map_err(|e| e.to_string())?;
        let mut record = self.place.read(&mut file)?;
        Ok(record.split_off(self.skip.min(record.len())))
    }
}

/// Streams with their tags, and those of the file.
fn described(text: &[u8]) -> Option<(BTreeMap<Id, Tags>, Tags)> {
    let mut text = Bytes(text);
    let mut streams = BTreeMap::new();
    for _ in 0..text.u32()? {
        let of = text.u32()?;
        let id = Id {
            of,
            instance: text.u16()?,
        };
        // Those of whoever recorded it, and behind them VRS's own.
        let mut tags = text.tags()?;
        tags.append(&mut text.tags()?);
        streams.insert(id, tags);
    }
    Some((streams, text.tags()?))
}

/// Bytes, read from the front.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }

    fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    fn text(&mut self) -> Option<String> {
        let length = self.u32()? as usize;
        let text = self.take(length)?;
        Some(String::from_utf8_lossy(text).into_owned())
    }

    fn tags(&mut self) -> Option<Tags> {
        let mut tags = Tags::new();
        for _ in 0..self.u32()? {
            let name = self.text()?;
            tags.insert(name, self.text()?);
        }
        Some(tags)
    }
}

#[cfg(test)]
mod tests;
