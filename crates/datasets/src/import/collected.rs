//! What a reader found: records in streams, a calibration, and what has no place in a recording.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use lsfb_geometry::{Rig, Trajectory};
use lsfb_types::Timestamp;

use super::overlap;
use super::payload::{Kind, Payload};
use super::report::{ClockOf, LeftOut};
use super::stream::{Counts, Record, Stream};
use super::table::{Row, Table};
use crate::Error;

/// Stamps from here on, 1 January 2000, count from 1970; earlier ones from the start of something.
const YEAR_2000: Timestamp = Timestamp::from_nanos(946_684_800_000_000_000);
/// Streams whose middles lie further apart than this were stamped by different clocks: a day.
const FARTHEST_NS: i64 = 86_400_000_000_000;

/// A stream by its number.
pub(super) type StreamId = usize;

/// What was found.
#[derive(Default)]
pub(super) struct Collected {
    pub(super) streams: Vec<Stream>,
    pub(super) rig: Option<Rig>,
    pub(super) notes: Vec<String>,
    pub(super) left_out: Vec<LeftOut>,
    /// Files of which something was made.
    pub(super) used: BTreeSet<PathBuf>,
    pub(super) videos: Vec<PathBuf>,
    /// Poses that somebody made for these records: they belong beside the recording.
    pub(super) trajectories: Vec<(String, Trajectory)>,
}

impl Collected {
    /// A stream for records called `what` in their source, which become `topic` below the device.
    pub(super) fn stream(&mut self, what: impl Into<String>, topic: &str, kind: Kind) -> StreamId {
        self.streams.push(Stream {
            what: what.into(),
            topic: topic.to_owned(),
            device: None,
            kind,
            records: Vec::new(),
            derived: false,
            counts: Counts::default(),
        });
        self.streams.len() - 1
    }

    /// The same for a device of its own.
    pub(super) fn stream_of(
        &mut self,
        device: &str,
        what: impl Into<String>,
        topic: &str,
        kind: Kind,
    ) -> StreamId {
        let id = self.stream(what, topic, kind);
        if let Some(stream) = self.streams.get_mut(id) {
            stream.device = Some(device.to_owned());
        }
        id
    }

    /// Takes what was made of a line: a record with its stamp in nanoseconds, or what is wrong with it.
    pub(super) fn row(
        &mut self,
        stream: StreamId,
        table: &Table,
        row: &Row<'_>,
        record: Result<(i64, Payload), String>,
    ) {
        let record = record.map(|(time_ns, payload)| measured(time_ns, payload));
        self.take(
            stream,
            || format!("{}: line {}", table.name(), row.line),
            record,
        );
    }

    /// Takes a record of another kind of file.
    pub(super) fn take(
        &mut self,
        stream: StreamId,
        place: impl FnOnce() -> String,
        record: Result<Record, String>,
    ) {
        if let Some(stream) = self.streams.get_mut(stream) {
            stream.take(place, record);
        }
    }

    /// Reads a file, remembers that it was, and tells where it may have been cut.
    pub(super) fn table(&mut self, path: &Path) -> Result<Table, Error> {
        let table = Table::read(path)?;
        self.used.insert(path.to_owned());
        if table.ends_within_a_line() {
            self.notes.push(format!(
                "{}: its last line is not terminated: the file may have been truncated there",
                table.name()
            ));
        }
        Ok(table)
    }

    /// Says that something has no place in the recording.
    pub(super) fn leave_out(&mut self, what: impl Into<String>, records: u64, why: &str) {
        self.left_out.push(LeftOut {
            what: what.into(),
            records,
            why: why.to_owned(),
        });
    }

    /// Puts everything in order and looks whether it can be true. Gives whose clock it is.
    pub(super) fn settle(&mut self, source: &Path) -> Result<ClockOf, Error> {
        for stream in &mut self.streams {
            stream.put_in_order();
            if let Some(period_s) = stream.impossible_period_s() {
                return Err(Error::StampUnit {
                    path: source.to_owned(),
                    what: stream.what.clone(),
                    period_s,
                });
            }
            if let Some(problem) = stream.impossible() {
                return Err(Error::Recorded {
                    path: source.to_owned(),
                    problem: format!("{}: {problem}", stream.what),
                });
            }
        }
        let middles = self.streams.iter().filter_map(|s| Some((s, s.middle()?)));
        let first = middles.clone().min_by_key(|(_, middle)| *middle);
        let last = middles.max_by_key(|(_, middle)| *middle);
        let (Some((early, from)), Some((late, to))) = (first, last) else {
            let problems = self.streams.iter();
            let problem = problems
                .filter_map(|s| s.counts.first_problem.as_ref())
                .next();
            return Err(Error::Recorded {
                path: source.to_owned(),
                problem: match problem {
                    Some(problem) => format!("no record could be read; the first: {problem}"),
                    None => "it has no records".to_owned(),
                },
            });
        };
        if to - from <= FARTHEST_NS {
            let (apart, mut notes) = overlap::look(&self.streams);
            self.notes.append(&mut notes);
            if let Some(apart) = apart {
                return Err(apart.error(source));
            }
        } else {
            return Err(Error::ClocksApart {
                path: source.to_owned(),
                early: early.what.clone(),
                early_s: from.nanos() as f64 / 1e9,
                late: late.what.clone(),
                late_s: to.nanos() as f64 / 1e9,
            });
        }
        Ok(match from >= YEAR_2000 {
            true => ClockOf::Utc,
            false => ClockOf::Device,
        })
    }
}

/// A record that the device had as soon as it was measured.
pub(super) fn measured(time_ns: i64, payload: Payload) -> Record {
    let time = Timestamp::from_nanos(time_ns);
    Record {
        time,
        arrival: time,
        payload,
    }
}
