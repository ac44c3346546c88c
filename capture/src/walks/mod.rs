//! Each phone of a recording becomes a walk of its own: a file with its messages, its rig, and its clock.
//!
//! While a rig records, a phone's stamps are mapped to the host's time by when its messages arrive: too late by the shortest delay, and
//! as well as was known at that moment. Here they are mapped anew, by all exchanges of times of the whole walk. Every message keeps
//! three stamps: the device's own (`…/device_time`), its arrival (`log_time`), and the time that was made of it (`publish_time`).

use std::collections::{BTreeMap, BTreeSet};
use std::iter::Peekable;
use std::path::{Path, PathBuf};

use lsfb_geometry::Rig;
use lsfb_recording::message::{self, ClockModel, TimeReference};
use lsfb_recording::{
    CLOCK_MODELS, CdrMessage, Channel, DEVICE_TIME, Recording, Writer, WriterConfig,
};
use lsfb_types::{Progress, ProgressFn, Timestamp};
use serde::Serialize;

use crate::Error;
use crate::clock::{Exchange, ExchangedClock, model_topic};
use crate::sidecar::{CAMERA_INFO, TIME_SYNC, decode_exchange};

/// Spacing of the clock models in a walk.
const MODEL_EVERY_NS: i64 = 1_000_000_000;
/// Messages between two looks at whether to go on.
const SHOW_EVERY: u64 = 512;
/// Clock of a device whose stamps are taken as they are.
const UTC: &str = lsfb_drivers::sidecar::model::CLOCK_UTC;

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
    /// Messages whose stamps were mapped by the exchanges of times; the others keep the time that they had.
    pub mapped: u64,
    /// Its clocks, by name.
    pub clocks: Vec<WalkClock>,
}

/// How a clock of a phone was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WalkClock {
    /// Its name, as the app calls it.
    pub clock_id: String,
    /// Exchanges behind it.
    pub exchanges: u64,
    /// Exchanges whose stamps cannot be true, and those of stretches with too few.
    pub unusable: u64,
    /// Largest standard deviation of a message's time, microseconds, where the shortest delays of both ways are equal.
    pub sigma_us: f64,
    /// By how much that may be wrong at most, since they may not: half the shortest round trip, microseconds.
    pub asymmetry_at_most_us: f64,
    /// How often the clock began anew.
    pub steps: usize,
}

/// Names of the phones in a recording.
pub fn phones(recording: &Recording) -> Vec<String> {
    let device = |topic: &str| {
        let (device, _) = topic.strip_prefix("/sidecar/")?.split_once('/')?;
        Some(device.to_owned())
    };
    let topics = recording.topics().iter();
    let names: BTreeSet<String> = topics.filter_map(|t| device(&t.topic)).collect();
    names.into_iter().collect()
}

/// Where the walk of a phone goes in a folder.
pub fn walk_path(folder: &Path, device: &str) -> PathBuf {
    folder.join(format!("{device}.walk.mcap"))
}

/// Writes the walk of a phone. The file gets its name when it is whole.
pub fn write_walk(
    recording: &Recording,
    device: &str,
    path: &Path,
    progress: ProgressFn<'_>,
) -> Result<Walk, Error> {
    let unfinished = path.with_extension("mcap.part");
    let written = write(recording, device, &unfinished, progress);
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

/// A message with what stands beside it.
struct Item {
    message: CdrMessage,
    /// The device's own stamp and the name of its clock.
    device: Option<(i64, String)>,
}

/// The messages of a topic.
struct TopicMessages<'a> {
    topic: &'a str,
    schema: &'a str,
    text: &'a str,
    items: Peekable<Box<dyn Iterator<Item = Result<Item, lsfb_recording::Error>> + 'a>>,
}

fn write(
    recording: &Recording,
    device: &str,
    path: &Path,
    progress: ProgressFn<'_>,
) -> Result<Walk, Error> {
    let prefix = format!("/sidecar/{device}/");
    let clocks = clocks(
        recording,
        &format!("{prefix}{}", TIME_SYNC.trim_start_matches('/')),
    )?;
    let mut topics = Vec::new();
    let mut total = 0;
    for topic in recording
        .topics()
        .iter()
        .filter(|t| t.topic.starts_with(&prefix))
    {
        // Intrinsics are made anew of the rig, the device's own stamps of the messages they stand beside.
        if topic.topic.ends_with(CAMERA_INFO) || topic.topic.ends_with(DEVICE_TIME) {
            continue;
        }
        total += topic.messages;
        topics.push(TopicMessages {
            topic: &topic.topic,
            schema: &topic.schema,
            text: recording.schema_text(&topic.topic).unwrap_or_default(),
            items: items(recording, &topic.topic)?.peekable(),
        });
    }
    let mut writing = Writing {
        writer: Writer::create(path, &config(recording, device))?,
        device,
        clocks,
        sigma_ns: BTreeMap::new(),
        modelled: BTreeMap::new(),
        walk: Walk {
            device: device.to_owned(),
            path: path.to_owned(),
            messages: 0,
            unreadable: 0,
            mapped: 0,
            clocks: Vec::new(),
        },
    };
    if let Some(rig) = rig_of(recording, device) {
        writing.writer.attach_rig(&rig)?;
        writing.writer.place_sidecar(device, &rig);
    }
    while let Some(next) = earliest(&mut topics) {
        let done = writing.walk.messages;
        if done % SHOW_EVERY == 0 {
            progress(Progress {
                stage: "writing the walk",
                done,
                total,
            })?;
        }
        match next.items.next() {
            Some(Ok(item)) => writing.put(next.topic, next.schema, next.text, item)?,
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
        let arrival = match topic.items.peek()? {
            Ok(item) => item.message.arrival,
            Err(_) => Timestamp::from_nanos(i64::MIN),
        };
        Some((arrival, n))
    });
    let (_, first) = arrivals.min()?;
    topics.get_mut(first)
}

/// The messages of a topic, each with the device's own stamp where that stands beside it.
fn items<'a>(
    recording: &'a Recording,
    topic: &str,
) -> Result<Box<dyn Iterator<Item = Result<Item, lsfb_recording::Error>> + 'a>, Error> {
    let beside = format!("{topic}{DEVICE_TIME}");
    let messages = recording.messages(topic)?;
    if !recording.topics().iter().any(|t| t.topic == beside) {
        let alone = |message| Item {
            message,
            device: None,
        };
        return Ok(Box::new(messages.map(move |m| m.map(alone))));
    }
    let mut stamps = recording
        .messages(&beside)?
        .filter_map(Result::ok)
        .peekable();
    Ok(Box::new(messages.map(move |message| {
        let message = message?;
        // Where a message is missing its stamp is passed over, and where a stamp is missing its message has none.
        let is_before = |stamp: &CdrMessage| {
            (stamp.arrival, stamp.time) != (message.arrival, message.time)
                && stamp.arrival <= message.arrival
        };
        while stamps.next_if(is_before).is_some() {}
        let own = stamps.next_if(|s| (s.arrival, s.time) == (message.arrival, message.time));
        let device = own.and_then(|stamp| {
            let reference = message::decode_time_reference(&stamp.bytes).ok()?;
            Some((
                i64::try_from(reference.device_ticks).ok()?,
                reference.source,
            ))
        });
        Ok(Item { message, device })
    })))
}

/// The clocks of a device, by the exchanges that were recorded.
fn clocks(recording: &Recording, topic: &str) -> Result<BTreeMap<String, ExchangedClock>, Error> {
    let mut exchanges: BTreeMap<String, Vec<Exchange>> = BTreeMap::new();
    if recording.topics().iter().any(|t| t.topic == topic) {
        for message in recording.messages(topic)? {
            // One that cannot be read is one of many.
            let Ok(message) = message else { continue };
            if let Ok((clock_id, exchange)) = decode_exchange(&message.bytes) {
                exchanges.entry(clock_id).or_default().push(exchange);
            }
        }
    }
    let clocks = exchanges.into_iter();
    Ok(clocks
        .filter_map(|(id, of)| Some((id, ExchangedClock::fit(&of)?)))
        .collect())
}

/// The rig that the device brought: its own attachment, or the recording's where that is of this device.
fn rig_of(recording: &Recording, device: &str) -> Option<Rig> {
    let name = format!("sidecar/{device}/rig.toml");
    match recording.attachment(&name) {
        Ok(bytes) => Rig::from_toml(&String::from_utf8_lossy(&bytes), &name).ok(),
        Err(_) => recording.rig().ok().filter(|rig| rig.name == device),
    }
}

fn config(recording: &Recording, device: &str) -> WriterConfig {
    let mut session = recording.metadata("lsfb.session").unwrap_or_default();
    // It is no part of a recording in parts.
    for name in ["part", "previous", "software"] {
        session.remove(name);
    }
    let scan = recording.path().file_name().unwrap_or_default();
    session.insert("walk_of".to_owned(), device.to_owned());
    session.insert(
        "recorded_in".to_owned(),
        scan.to_string_lossy().into_owned(),
    );
    WriterConfig {
        session,
        ..WriterConfig::default()
    }
}

struct Writing<'a> {
    writer: Writer,
    device: &'a str,
    clocks: BTreeMap<String, ExchangedClock>,
    /// Largest standard deviation by clock.
    sigma_ns: BTreeMap<String, f64>,
    /// When a model of each clock was written last.
    modelled: BTreeMap<String, Timestamp>,
    walk: Walk,
}

impl Writing<'_> {
    fn put(&mut self, topic: &str, schema: &str, text: &str, item: Item) -> Result<(), Error> {
        let Item { message, device } = item;
        let mut time = message.time;
        if let Some((device_ns, clock_id)) = &device {
            if let Some(mapped) = self.map(*device_ns, clock_id, message.arrival)? {
                time = mapped;
                self.walk.mapped += 1;
            }
            let reference = TimeReference {
                device_ticks: device_ns.unsigned_abs(),
                source: clock_id.clone(),
            };
            if let Some(bytes) = message::encode_time_reference(time, clock_id, &reference) {
                let beside = format!("{topic}{DEVICE_TIME}");
                let schema = message::TIME_REFERENCE;
                self.write(
                    &beside,
                    schema.name,
                    schema.text,
                    time,
                    message.arrival,
                    &bytes,
                )?;
            }
        }
        self.write(topic, schema, text, time, message.arrival, &message.bytes)?;
        self.walk.messages += 1;
        Ok(())
    }

    /// Time of a stamp by the exchanges; once a second it is said how. `None` where no clock of that name is known.
    fn map(
        &mut self,
        device_ns: i64,
        clock_id: &str,
        arrival: Timestamp,
    ) -> Result<Option<Timestamp>, Error> {
        let Some(clock) = self.clocks.get(clock_id).filter(|_| clock_id != UTC) else {
            return Ok(None);
        };
        let Some(found) = clock.time(device_ns, arrival) else {
            return Ok(None);
        };
        let exchanges = clock.exchanges;
        let sigma = self.sigma_ns.entry(clock_id.to_owned()).or_default();
        *sigma = sigma.max(found.sigma_ns);
        let last = self.modelled.get(clock_id);
        if last.is_none_or(|last| (arrival - *last).abs() >= MODEL_EVERY_NS) {
            self.modelled.insert(clock_id.to_owned(), arrival);
            let model = ClockModel {
                device: self.device.to_owned(),
                kind: model_topic::EXCHANGED.to_owned(),
                epoch: found.epoch,
                reference_device_ns: device_ns,
                reference_time_ns: found.time.nanos(),
                skew: found.skew,
                sigma_ns: found.sigma_ns,
                sigma_skew: found.sigma_skew,
                pairs: exchanges,
                tick_ns: 1,
                period_ticks: 0,
            };
            let bytes = message::encode_clock_model(found.time, self.device, &model);
            let topic = format!("{CLOCK_MODELS}{}", self.device);
            let schema = message::CLOCK_MODEL;
            self.write(
                &topic,
                schema.name,
                schema.text,
                found.time,
                arrival,
                &bytes,
            )?;
        }
        Ok(Some(found.time))
    }

    fn write(
        &mut self,
        topic: &str,
        schema_name: &str,
        schema_text: &str,
        time: Timestamp,
        arrival: Timestamp,
        bytes: &[u8],
    ) -> Result<(), Error> {
        let channel = Channel {
            topic,
            schema_name,
            schema_text,
        };
        Ok(self.writer.write_cdr(&channel, time, arrival, bytes)?)
    }

    fn finish(mut self) -> Result<Walk, Error> {
        self.writer.finish()?;
        for (clock_id, clock) in &self.clocks {
            let sigma_ns = self.sigma_ns.get(clock_id).copied().unwrap_or(0.0);
            self.walk.clocks.push(WalkClock {
                clock_id: clock_id.clone(),
                exchanges: clock.exchanges,
                unusable: clock.unusable,
                sigma_us: sigma_ns / 1e3,
                asymmetry_at_most_us: clock.shortest_round_trip_ns as f64 / 2e3,
                steps: clock.steps(),
            });
        }
        Ok(self.walk)
    }
}

#[cfg(test)]
mod tests;
