//! Each phone of a recording becomes a walk of its own: a file with its messages, its rig, and its clock.
//!
//! While a rig records, a phone's stamps are mapped to the host's time by when its messages arrive: too late by the shortest delay, and
//! as well as was known at that moment. Here they are mapped anew, by all exchanges of times of the whole walk. Every message keeps
//! three stamps: the device's own (`…/device_time`), its arrival (`log_time`), and the time that was made of it (`publish_time`).

mod stamps;
#[cfg(test)]
mod tests;
mod writing;

use std::collections::BTreeSet;
use std::iter::Peekable;
use std::path::{Path, PathBuf};
use std::vec::IntoIter;

use lsfb_drivers::sidecar::wire::is_name;
use lsfb_geometry::Rig;
use lsfb_recording::{CdrMessage, Channel, DEVICE_TIME, Recording};
use lsfb_types::{Progress, ProgressFn, Timestamp};
use serde::Serialize;

use crate::Error;
use crate::sidecar::CAMERA_INFO;
use stamps::{Stamp, Stamps};
use writing::Writing;

/// Messages between two looks at whether to go on.
const SHOW_EVERY: u64 = 512;

/// A walk that was written.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Walk {
    /// Name of the phone.
    pub device: String,
    /// Its file.
    pub path: PathBuf,
    /// Messages of the phone in it, without what the recorder adds.
    pub messages: u64,
    /// Messages that could not be read.
    pub unreadable: u64,
    /// Messages whose stamps were mapped by the exchanges of times.
    pub mapped: u64,
    /// Messages that should have been, and keep the time of the recording: exchanges are too few, or do not tell which of two clocks
    /// stamped them, or their stamps are missing. Messages of UTC are none of them.
    pub unmapped: u64,
    /// Its clocks, by name.
    pub clocks: Vec<WalkClock>,
}

/// How a clock of a phone was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WalkClock {
    /// Its name, as the app calls it.
    pub clock_id: String,
    /// Exchanges behind it; 0: there were too few, and it is not known.
    pub exchanges: u64,
    /// Exchanges whose stamps cannot be true, that contradict those around them, or that are too few.
    pub unusable: u64,
    /// Largest standard deviation of a message's time, microseconds, where the shortest delays of both ways are equal. `None` where
    /// no message was mapped by it.
    pub sigma_us: Option<f64>,
    /// By how much that may be wrong at most, since they may not: half the shortest round trip, microseconds.
    pub asymmetry_at_most_us: Option<f64>,
    /// How often the clock began anew.
    pub steps: usize,
    /// Of UTC, whose stamps are taken as they are: the phone's less the rig's, where they differ most, microseconds.
    pub utc_apart_us: Option<f64>,
}

/// Names of the phones in a recording.
pub fn phones(recording: &Recording) -> Vec<String> {
    let device = |topic: &str| {
        let (device, _) = topic.strip_prefix("/sidecar/")?.split_once('/')?;
        // It becomes the name of a file.
        is_name(device).then(|| device.to_owned())
    };
    let topics = recording.topics().iter();
    let names: BTreeSet<String> = topics.filter_map(|t| device(&t.topic)).collect();
    names.into_iter().collect()
}

/// Where the walk of a phone goes in a folder.
pub fn walk_path(folder: &Path, device: &str) -> PathBuf {
    folder.join(format!("{device}.walk.mcap"))
}

/// Writes the walk of a phone, with the rig that it brought, or another: calibrated since, say. The file gets its name when it is whole.
pub fn write_walk(
    recording: &Recording,
    device: &str,
    rig: Option<&Rig>,
    path: &Path,
    progress: ProgressFn<'_>,
) -> Result<Walk, Error> {
    let unfinished = path.with_extension("mcap.part");
    let written = write(recording, device, rig, &unfinished, progress);
    let walk = written
        .and_then(|walk| {
            std::fs::rename(&unfinished, path).map_err(|cause| Error::Io {
                path: path.to_owned(),
                cause,
            })?;
            Ok(walk)
        })
        .inspect_err(|_| {
            // The first error says what is wrong with the disk.
            let _ = std::fs::remove_file(&unfinished);
        })?;
    Ok(Walk {
        path: path.to_owned(),
        ..walk
    })
}

/// The messages of a topic, and the device's own stamps of them.
struct TopicMessages<'a> {
    channel: Channel<'a>,
    messages: Peekable<Box<dyn Iterator<Item = Result<CdrMessage, lsfb_recording::Error>> + 'a>>,
    /// `None` where there are none.
    stamps: Option<Peekable<IntoIter<Stamp>>>,
}

impl TopicMessages<'_> {
    /// The stamp of a message.
    fn stamp_of(&mut self, message: &CdrMessage) -> Option<Stamp> {
        let stamps = self.stamps.as_mut()?;
        let is_its =
            |stamp: &Stamp| (stamp.arrival, stamp.recorded) == (message.arrival, message.time);
        // Where a message is missing its stamp is passed over, and where a stamp is missing its message has none.
        while stamps
            .next_if(|stamp| !is_its(stamp) && stamp.arrival <= message.arrival)
            .is_some()
        {}
        stamps.next_if(is_its)
    }
}

fn write(
    recording: &Recording,
    device: &str,
    rig: Option<&Rig>,
    path: &Path,
    progress: ProgressFn<'_>,
) -> Result<Walk, Error> {
    let prefix = format!("/sidecar/{device}/");
    let mut stamps = Stamps::read(recording, device)?;
    let mut topics = Vec::new();
    let mut total = 0;
    for topic in recording.topics() {
        // Intrinsics are made anew of the rig, the device's own stamps of the messages they stand beside.
        let is_made_anew = topic.topic.ends_with(CAMERA_INFO) || topic.topic.ends_with(DEVICE_TIME);
        if !topic.topic.starts_with(&prefix) || is_made_anew {
            continue;
        }
        total += topic.messages;
        let messages: Box<dyn Iterator<Item = _>> = Box::new(recording.messages(&topic.topic)?);
        topics.push(TopicMessages {
            channel: Channel {
                topic: &topic.topic,
                schema_name: &topic.schema,
                schema_text: recording.schema_text(&topic.topic).unwrap_or_default(),
            },
            messages: messages.peekable(),
            stamps: stamps
                .of(&topic.topic)
                .map(|own| own.into_iter().peekable()),
        });
    }
    let mut writing = Writing::begin(recording, device, rig, &stamps.clocks, path)?;
    let mut done = 0;
    while let Some(next) = earliest(&mut topics) {
        if done % SHOW_EVERY == 0 {
            progress(Progress {
                stage: "writing the walk",
                done,
                total,
            })?;
        }
        done += 1;
        match next.messages.next() {
            Some(Ok(message)) => {
                let stamp = next.stamp_of(&message);
                let should_be = next.stamps.is_some();
                let is_mapped = stamp.as_ref().is_some_and(|stamp| stamp.found.is_some());
                writing.walk.unmapped += u64::from(should_be && !is_mapped);
                writing.put(&next.channel, &message, stamp.as_ref())?;
            }
            // What is damaged is told once, and the rest goes on.
            Some(Err(_)) => writing.walk.unreadable += 1,
            None => {}
        }
    }
    writing.finish()
}

/// The topic whose next message arrived first; one that is damaged is looked at before all others.
fn earliest<'a, 'b>(topics: &'a mut [TopicMessages<'b>]) -> Option<&'a mut TopicMessages<'b>> {
    let arrivals = topics.iter_mut().enumerate().filter_map(|(n, topic)| {
        let arrival = match topic.messages.peek()? {
            Ok(message) => message.arrival,
            Err(_) => Timestamp::from_nanos(i64::MIN),
        };
        Some((arrival, n))
    });
    let (_, first) = arrivals.min()?;
    topics.get_mut(first)
}
