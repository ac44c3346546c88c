//! The `.bag` files of ROS 1, version 2.0: records, each a header of `name=value` fields and data; messages lie in chunks.
//!
//! Read from the start to the end without the index, so that a bag that was not closed is read as far as it goes.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use super::file::{Visit, unreadable};
use crate::Error;

const MAGIC: &[u8] = b"#ROSBAG V2.0\n";
/// Kinds of records.
const MESSAGE: u8 = 2;
const BAG_HEADER: u8 = 3;
const CHUNK: u8 = 5;
const CONNECTION: u8 = 7;
/// Longest header and data that are believed, bytes.
const LONGEST_HEADER: usize = 1 << 20;
const LONGEST_DATA: usize = 1 << 30;

/// What records are given to, and what is wrong with those that are damaged. Answered with an error it gets no more.
type Each<'a> = &'a mut dyn FnMut(Result<&Record<'_>, String>) -> Result<(), String>;

pub(super) struct Bag {
    path: PathBuf,
    /// By number: topic and type.
    connections: BTreeMap<u32, (String, String)>,
    damage: Option<String>,
}

/// What the first record of a bag announces, and what there is of it.
#[derive(Default)]
struct Extent {
    /// Where the index begins: 0 in a bag that was not closed.
    index_pos: Option<u64>,
    announced_chunks: Option<u32>,
    chunks: u32,
}

impl Extent {
    fn note(&mut self, record: &Record<'_>) {
        match record.kind {
            BAG_HEADER => {
                let index_pos = record.field("index_pos").ok();
                let index_pos = index_pos.and_then(|bytes| bytes.try_into().ok());
                self.index_pos = index_pos.map(u64::from_le_bytes);
                self.announced_chunks = record.u32("chunk_count").ok();
            }
            CHUNK => self.chunks += 1,
            _ => {}
        }
    }

    /// What is missing from a file of so many bytes.
    fn missing(&self, end: End, bytes: u64) -> Option<String> {
        let of = |chunks: u32| match self.announced_chunks {
            Some(announced) if announced > 0 => format!("{chunks} of {announced} chunks"),
            _ => format!("{chunks} chunks"),
        };
        let is_short = self.announced_chunks.is_some_and(|all| all > self.chunks);
        if self.index_pos == Some(0) {
            let found = "the bag was not closed and has no index: messages that its recorder had buffered are missing";
            Some(format!("{found}; {} were read", of(self.chunks)))
        } else if end == End::Torn || is_short || self.index_pos.is_some_and(|at| at > bytes) {
            Some(format!(
                "the bag is truncated: {} are present",
                of(self.chunks)
            ))
        } else {
            None
        }
    }
}

/// How a file ends.
#[derive(Clone, Copy, PartialEq, Eq)]
enum End {
    /// Behind a record.
    Whole,
    /// Within one.
    Torn,
}

impl Bag {
    /// Opens a bag and reads which topics it has.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let mut bag = Self {
            path: path.to_owned(),
            connections: BTreeMap::new(),
            damage: None,
        };
        let mut extent = Extent::default();
        let mut connections = BTreeMap::new();
        let mut damage = None;
        let end = bag.read(&mut |record| {
            if let Ok(record) = record {
                extent.note(record);
            }
            match record {
                Ok(record) if record.kind == CONNECTION => {
                    let (id, connection) = record.connection()?;
                    connections.insert(id, connection);
                }
                Ok(_) => {}
                Err(problem) => _ = damage.get_or_insert(problem),
            }
            Ok(())
        })?;
        // What else is damaged is said of the messages that are missed.
        if let Some(problem) = damage.filter(|_| connections.is_empty()) {
            return Err(unreadable(path, problem));
        }
        bag.connections = connections;
        let bytes = std::fs::metadata(path).map_or(u64::MAX, |file| file.len());
        let missing = extent.missing(end, bytes);
        bag.damage = missing.map(|missing| format!("{}: {missing}", path.display()));
        Ok(bag)
    }

    /// What is missing, where it was not closed or was cut off.
    pub fn damage(&self) -> Option<&str> {
        self.damage.as_deref()
    }

    pub fn topics(&self) -> impl Iterator<Item = (&str, &str)> {
        self.connections
            .values()
            .map(|(topic, kind)| (topic.as_str(), kind.as_str()))
    }

    /// Gives the messages of a topic in the order of the file, and chunks that cannot be read: whose messages they hold nobody knows.
    pub fn visit(&self, topic: &str, each: Visit<'_>) -> Result<(), Error> {
        self.read(&mut |record| {
            let record = match record {
                Ok(record) => record,
                Err(problem) => return each(Err(problem)),
            };
            if record.kind != MESSAGE {
                return Ok(());
            }
            let connection = self.connections.get(&record.u32("conn")?);
            match connection {
                Some((of, _)) if of == topic => each(Ok(record.data)),
                _ => Ok(()),
            }
        })?;
        Ok(())
    }

    /// Gives every record, chunks before those in them, and instead of chunks that are damaged what is wrong with them.
    fn read(&self, each: Each<'_>) -> Result<End, Error> {
        let io = |source| Error::Io {
            path: self.path.clone(),
            source,
        };
        let wrong = |problem: String| unreadable(&self.path, problem);
        let mut file = BufReader::new(File::open(&self.path).map_err(io)?);
        let mut magic = [0; MAGIC.len()];
        let is_bag = file.read_exact(&mut magic).is_ok() && magic == MAGIC;
        if !is_bag {
            return Err(wrong("not a ROS bag of version 2.0".to_owned()));
        }
        loop {
            if file.fill_buf().map_err(io)?.is_empty() {
                return Ok(End::Whole);
            }
            // A bag that was not closed ends anywhere: what is whole before was read.
            let Some(header) = block(&mut file, LONGEST_HEADER).map_err(wrong)? else {
                return Ok(End::Torn);
            };
            let Some(data) = block(&mut file, LONGEST_DATA).map_err(wrong)? else {
                return Ok(End::Torn);
            };
            let record = Record::new(&header, &data).map_err(wrong)?;
            each(Ok(&record)).map_err(wrong)?;
            if record.kind == CHUNK {
                let unpacked = match record.unpack() {
                    Ok(unpacked) => unpacked,
                    Err(problem) => {
                        each(Err(problem)).map_err(wrong)?;
                        continue;
                    }
                };
                let mut rest = unpacked.as_slice();
                while !rest.is_empty() {
                    match inner(&mut rest) {
                        Ok((header, data)) => {
                            let inner = Record::new(&header, &data);
                            each(inner.as_ref().map_err(String::clone)).map_err(wrong)?;
                        }
                        Err(problem) => {
                            // Where the next one begins is not known.
                            each(Err(problem)).map_err(wrong)?;
                            break;
                        }
                    }
                }
            }
        }
    }
}

/// Header and data of a record of a chunk.
fn inner(rest: &mut &[u8]) -> Result<(Vec<u8>, Vec<u8>), String> {
    let header = block(rest, LONGEST_HEADER)?;
    let data = block(rest, LONGEST_DATA)?;
    let both = header.zip(data);
    both.ok_or_else(|| "a truncated chunk".to_owned())
}

/// A length and as many bytes; `None` where the input ends before them.
fn block(input: &mut impl Read, longest: usize) -> Result<Option<Vec<u8>>, String> {
    let mut length = [0; 4];
    if input.read_exact(&mut length).is_err() {
        return Ok(None);
    }
    let length = u32::from_le_bytes(length) as usize;
    if length > longest {
        return Err(format!("a record of {length} bytes"));
    }
    let mut bytes = Vec::new();
    let read = input.take(length as u64).read_to_end(&mut bytes);
    let read = read.map_err(|e| e.to_string())?;
    Ok((read == length).then_some(bytes))
}

struct Record<'a> {
    kind: u8,
    fields: BTreeMap<&'a [u8], &'a [u8]>,
    data: &'a [u8],
}

impl<'a> Record<'a> {
    fn new(header: &'a [u8], data: &'a [u8]) -> Result<Self, String> {
        let fields = fields(header)?;
        let kind = match fields.get(b"op".as_slice()) {
            Some([kind]) => *kind,
            _ => return Err("a record without a type".to_owned()),
        };
        Ok(Self { kind, fields, data })
    }

    fn field(&self, name: &str) -> Result<&'a [u8], String> {
        let value = self.fields.get(name.as_bytes()).copied();
        value.ok_or_else(|| format!("a record without {name}"))
    }

    fn u32(&self, name: &str) -> Result<u32, String> {
        let bytes = self.field(name)?.try_into();
        let bytes = bytes.map_err(|_| format!("{name} of another length"))?;
        Ok(u32::from_le_bytes(bytes))
    }

    /// Number, topic and type of a connection.
    fn connection(&self) -> Result<(u32, (String, String)), String> {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        let of_data = fields(self.data)?;
        let kind = of_data.get(b"type".as_slice());
        let kind = kind.ok_or("a connection without a type")?;
        let connection = (text(self.field("topic")?), text(kind));
        Ok((self.u32("conn")?, connection))
    }

    /// The records of a chunk.
    fn unpack(&self) -> Result<Vec<u8>, String> {
        let size = self.u32("size")? as usize;
        if size > LONGEST_DATA {
            return Err(format!("a chunk of {size} bytes"));
        }
        let unpack = |from: &mut dyn Read| {
            let mut bytes = Vec::new();
            let read = from.take(size as u64 + 1).read_to_end(&mut bytes);
            read.map_err(|e| format!("a damaged chunk ({e})"))?;
            Ok::<_, String>(bytes)
        };
        let bytes = match self.field("compression")? {
            b"none" => self.data.to_vec(),
            b"lz4" => {
                let decoder = lz4::Decoder::new(self.data);
                unpack(&mut decoder.map_err(|e| format!("a damaged chunk ({e})"))?)?
            }
            b"bz2" => unpack(&mut bzip2::read::BzDecoder::new(self.data))?,
            other => {
                return Err(format!(
                    "chunk compression {} is not supported: use none, lz4 or bz2",
                    String::from_utf8_lossy(other)
                ));
            }
        };
        if bytes.len() != size {
            return Err(format!(
                "a chunk of {} bytes, but {size} were announced",
                bytes.len()
            ));
        }
        Ok(bytes)
    }
}

/// Fields of a header: each a length, then `name=value`.
fn fields(mut header: &[u8]) -> Result<BTreeMap<&[u8], &[u8]>, String> {
    let mut fields = BTreeMap::new();
    while let Some((length, rest)) = header.split_first_chunk::<4>() {
        let length = u32::from_le_bytes(*length) as usize;
        let field = rest.get(..length).ok_or("a truncated header")?;
        let equals = field.iter().position(|b| *b == b'=');
        let equals = equals.ok_or("a field without a value")?;
        fields.insert(&field[..equals], &field[equals + 1..]);
        header = &rest[length..];
    }
    Ok(fields)
}
