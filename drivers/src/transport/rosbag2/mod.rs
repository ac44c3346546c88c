//! LiDAR packets out of rosbag2 sqlite files: CDR messages of the packet types of ROS drivers, which [`RosPackets`] lists.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::time::Duration;

use lsfb_types::{Packet, RosPackets, Timestamp};
use rusqlite::{Connection, OpenFlags, OptionalExtension};

use super::PacketSource;
use crate::Error;

const CDR_LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];

/// One message: the packets of a revolution, as the recording driver grouped them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BaggedScan {
    /// When the bag recorded it.
    pub recorded: Timestamp,
    /// The message's own stamp.
    pub stamp: Timestamp,
    /// Its frame of reference.
    pub frame_id: String,
    /// The packets, each with the driver's receive stamp.
    pub packets: Vec<Packet>,
}

/// The scans of one topic, in the order of recording.
#[derive(Debug)]
pub struct Rosbag2Source {
    path: PathBuf,
    database: Connection,
    scan_type: RosPackets,
    rows: VecDeque<i64>,
    waiting: VecDeque<Packet>,
}

impl Rosbag2Source {
    /// Opens a `.db3` file and its one topic of scans.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let damaged = |position: &str, problem: String| Error::File {
            path: path.to_owned(),
            position: position.to_owned(),
            problem,
        };
        // sqlite would report a missing file without its cause.
        let metadata = std::fs::metadata(path).map_err(|cause| Error::Open {
            device: path.display().to_string(),
            action: "open",
            cause,
        })?;
        if metadata.is_dir() {
            let problem = "this is a folder: name the .db3 file in it, or its .mcap with --mcap";
            return Err(damaged("the start", problem.to_owned()));
        }
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let database = Connection::open_with_flags(path, flags)
            .map_err(|error| damaged("the start", format!("not an sqlite database ({error})")))?;
        let topics = topics(&database).map_err(|error| {
            damaged("table topics", format!("not a rosbag2 database ({error})"))
        })?;
        let (topic, scan_type) =
            choose(&topics).map_err(|problem| damaged("table topics", problem))?;
        let rows = || -> rusqlite::Result<VecDeque<i64>> {
            let mut query = database
                .prepare("SELECT id FROM messages WHERE topic_id = ?1 ORDER BY timestamp, id")?;
            query.query_map([topic], |row| row.get(0))?.collect()
        };
        let rows = rows().map_err(|error| damaged("table messages", error.to_string()))?;
        Ok(Self {
            path: path.to_owned(),
            database,
            scan_type,
            rows,
            waiting: VecDeque::new(),
        })
    }

    /// The next message whole, or `None` after the last.
    pub fn next_scan(&mut self) -> Result<Option<BaggedScan>, Error> {
        let Some(row) = self.rows.pop_front() else {
            return Ok(None);
        };
        let damaged = |problem: String| Error::File {
            path: self.path.clone(),
            position: format!("message {row}"),
            problem,
        };
        let message: Option<(i64, Vec<u8>)> = self
            .database
            .query_row(
                "SELECT timestamp, data FROM messages WHERE id = ?1",
                [row],
                |row| Ok((row.get(0)?, row.get(1)?)),
            )
            .optional()
            .map_err(|error| damaged(error.to_string()))?;
        let (recorded, data) = message.ok_or_else(|| damaged("row is missing".into()))?;
        let name = self.scan_type.name;
        let scan = parse_scan(self.scan_type, Timestamp::from_nanos(recorded), &data)
            .ok_or_else(|| damaged(format!("{} bytes are not CDR {name}", data.len())))?;
        Ok(Some(scan))
    }
}

/// A row of the table of topics.
struct Topic {
    id: i64,
    name: String,
    type_name: String,
    /// Absent or empty in bags of some writers.
    serialization: Option<String>,
}

impl Topic {
    fn scan_type(&self) -> Option<RosPackets> {
        RosPackets::named(&self.type_name)
    }
}

fn topics(database: &Connection) -> rusqlite::Result<Vec<Topic>> {
    let read = |columns: &str| -> rusqlite::Result<Vec<Topic>> {
        let mut query = database.prepare(&format!("SELECT {columns} FROM topics ORDER BY id"))?;
        let rows = query.query_map([], |row| {
            Ok(Topic {
                id: row.get(0)?,
                name: row.get(1)?,
                type_name: row.get(2)?,
                serialization: row.get(3)?,
            })
        })?;
        rows.collect()
    };
    // Without the column, what is said of the first error holds for the whole table.
    read("id, name, type, serialization_format")
        .or_else(|error| read("id, name, type, NULL").map_err(|_| error))
}

/// The one topic of scans. Where nothing says how its messages are serialized they are taken for CDR, which each message's head
/// confirms or not.
fn choose(topics: &[Topic]) -> Result<(i64, RosPackets), String> {
    let scans = || {
        let scans = topics.iter();
        scans.filter_map(|topic| Some((topic, topic.scan_type()?)))
    };
    let readable =
        |topic: &Topic| matches!(topic.serialization.as_deref(), None | Some("" | "cdr"));
    let mut found = scans().filter(|(topic, _)| readable(topic));
    match (found.next(), found.next()) {
        (Some((topic, scan_type)), None) => Ok((topic.id, scan_type)),
        (Some(_), Some(_)) => {
            let names: Vec<_> = scans().map(|(topic, _)| topic.name.as_str()).collect();
            Err(format!(
                "several topics of scans, expected one: {}",
                names.join(", ")
            ))
        }
        (None, _) => Err(match scans().next() {
            Some((topic, _)) => format!(
                "{} is serialized as `{}`, but only `cdr` is supported",
                topic.name,
                topic.serialization.as_deref().unwrap_or_default()
            ),
            None => {
                let wanted = RosPackets::ALL.map(|known| known.name).join(" or ");
                let there: Vec<_> = topics
                    .iter()
                    .map(|topic| format!("{} ({})", topic.name, topic.type_name))
                    .collect();
                format!("no topic of {wanted}; it has {}", there.join(", "))
            }
        }),
    }
}

impl PacketSource for Rosbag2Source {
    fn recv(&mut self, _timeout: Duration) -> Result<Option<Packet>, Error> {
        loop {
            if let Some(packet) = self.waiting.pop_front() {
                return Ok(Some(packet));
            }
            match self.next_scan()? {
                Some(scan) => self.waiting.extend(scan.packets),
                None => {
                    return Err(Error::EndOfStream {
                        device: self.path.display().to_string(),
                    });
                }
            }
        }
    }
}

fn parse_scan(scan_type: RosPackets, recorded: Timestamp, data: &[u8]) -> Option<BaggedScan> {
    let body = data.strip_prefix(&CDR_LITTLE_ENDIAN)?;
    let mut cdr = Cdr { body, at: 0 };
    let stamp = cdr.time()?;
    let length = cdr.u32()? as usize;
    let frame_id = cdr.take(length)?.strip_suffix(&[0])?;
    let frame_id = std::str::from_utf8(frame_id).ok()?.to_owned();
    let count = cdr.u32()? as usize;
    // Each packet takes more than its payload: a larger count is damage, and must not reserve memory.
    if count > body.len() / scan_type.array_bytes {
        return None;
    }
    let mut packets = Vec::with_capacity(count);
    for _ in 0..count {
        let arrival = cdr.time()?;
        let array = cdr.take(scan_type.array_bytes)?;
        let bytes = match scan_type.has_size {
            true => array.get(..cdr.u32()? as usize)?,
            false => array,
        };
        packets.push(Packet {
            arrival,
            bytes: bytes.to_vec(),
        });
    }
    Some(BaggedScan {
        recorded,
        stamp,
        frame_id,
        packets,
    })
}

/// A reader of plain CDR: numbers are aligned to their size, counted from the end of the encapsulation header.
struct Cdr<'a> {
    body: &'a [u8],
    at: usize,
}

impl<'a> Cdr<'a> {
    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let bytes = self.body.get(self.at..self.at.checked_add(length)?)?;
        self.at += length;
        Some(bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.at = self.at.next_multiple_of(4);
        let bytes = self.take(4)?;
        Some(u32::from_le_bytes(bytes.try_into().ok()?))
    }

    fn time(&mut self) -> Option<Timestamp> {
        let secs = self.u32()? as i32;
        let nanos = self.u32()?;
        Some(Timestamp::from_nanos(
            i64::from(secs) * 1_000_000_000 + i64::from(nanos),
        ))
    }
}

#[cfg(test)]
mod tests;
