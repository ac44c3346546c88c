//! Whether the streams of a source were recorded together: what stops early was cut, and what never meets was stamped by another clock.

use std::path::Path;

use lsfb_types::Timestamp;

use super::payload::Kind;
use super::stream::Stream;
use crate::Error;

/// Sensors begin and end within this of each other, nanoseconds; more is told.
const TOGETHER_NS: i64 = 2_000_000_000;
/// Streams of a device that lie further apart than this do not belong together, nanoseconds.
const APART_NS: i64 = 1_000_000_000;

/// What was heard further from everything that was measured is told, nanoseconds.
const ELSEWHERE_NS: i64 = 60_000_000_000;

/// Two streams that never meet.
pub(super) struct Apart {
    early: (String, Timestamp),
    late: (String, Timestamp),
}

impl Apart {
    pub(super) fn error(self, source: &Path) -> Error {
        let secs = |time: Timestamp| time.nanos() as f64 / 1e9;
        Error::ClocksApart {
            path: source.to_owned(),
            early_s: secs(self.early.1),
            early: self.early.0,
            late_s: secs(self.late.1),
            late: self.late.0,
        }
    }
}

/// A sensor that measures all the time, from its first record to its last.
struct Span<'a> {
    stream: &'a Stream,
    first: Timestamp,
    last: Timestamp,
}

impl Span<'_> {
    /// Whether it is one that moves with the device: it has no recording of its own.
    fn is_of_the_device(&self) -> bool {
        matches!(
            self.stream.kind,
            Kind::Imu | Kind::Vector | Kind::Magnetic | Kind::Orientation
        )
    }
}

/// The first two that never meet, and what begins late, ends early or is empty, in words.
pub(super) fn look(streams: &[Stream]) -> (Option<Apart>, Vec<String>) {
    let empty = streams.iter().filter(|s| s.counts.read == 0 && !s.derived);
    let mut notes: Vec<String> = empty
        .map(|s| format!("{}: it has no records", s.what))
        .collect();
    let spans: Vec<Span<'_>> = streams.iter().filter_map(span).collect();
    let apart = spans.iter().find_map(|a| {
        let other = spans.iter().find(|b| {
            (a.is_of_the_device() || b.is_of_the_device()) && b.first - a.last > APART_NS
        })?;
        let side = |s: &Span<'_>, time| (s.stream.what.clone(), time);
        Some(Apart {
            early: side(a, a.last),
            late: side(other, other.first),
        })
    });
    let first = spans.iter().map(|s| s.first).min();
    let last = spans.iter().map(|s| s.last).max();
    for span in &spans {
        let what = &span.stream.what;
        let late_ns = first.map_or(0, |first| span.first - first);
        if late_ns > TOGETHER_NS {
            let secs = late_ns as f64 / 1e9;
            notes.push(format!(
                "{what}: begins {secs:.1} s after the first of the others"
            ));
        }
        let early_ns = last.map_or(0, |last| last - span.last);
        if early_ns > TOGETHER_NS {
            let secs = early_ns as f64 / 1e9;
            notes.push(format!(
                "{what}: ends {secs:.1} s before the last of the others: it may have been truncated"
            ));
        }
    }
    if let Some((first, last)) = first.zip(last) {
        let heard = streams
            .iter()
            .filter(|s| s.kind.periods_s().is_none() && !s.derived);
        notes.extend(heard.filter_map(|stream| elsewhere(stream, first, last)));
    }
    (apart, notes)
}

/// What was heard long before or after everything that was measured, in words.
fn elsewhere(stream: &Stream, first: Timestamp, last: Timestamp) -> Option<String> {
    let (from, to) = (stream.records.first()?.time, stream.records.last()?.time);
    let (ns, side) = match (first - to, from - last) {
        (before, _) if before > ELSEWHERE_NS => (before, "before the first"),
        (_, behind) if behind > ELSEWHERE_NS => (behind, "after the last"),
        _ => return None,
    };
    let secs = ns as f64 / 1e9;
    Some(format!(
        "{}: all of it is {secs:.0} s {side} of the others",
        stream.what
    ))
}

fn span(stream: &Stream) -> Option<Span<'_>> {
    let is_steady = stream.kind.periods_s().is_some() && !stream.derived;
    let (first, last) = (stream.records.first()?, stream.records.last()?);
    (is_steady && stream.records.len() > 1).then_some(Span {
        stream,
        first: first.time,
        last: last.time,
    })
}
