//! Phones and glasses: what they describe and send goes into the recording word for word.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use lsfb_drivers::sidecar::model::CLOCK_UTC;
use lsfb_drivers::sidecar::wire::Advertise;
use lsfb_drivers::sidecar::{
    Delivery, Receipt, SidecarCounters, SidecarEvent, SidecarMessage, SidecarServer,
};
use lsfb_geometry::Rig;
use lsfb_recording::DEVICE_TIME;
use lsfb_recording::message::{self, TimeReference};
use lsfb_types::Timestamp;

use crate::clock::OneWayClock;
use crate::control::Control;
use crate::health::{Connection, Ending, Meter, StreamReport};
use crate::recorder::{Entry, Inlet, OwnMessage, WriterGone};

/// The only encoding a recording holds.
const ENCODING: &str = "cdr";
/// Key of the rig's TOML in a channel's static metadata.
const RIG_KEY: &str = "rig_toml";

/// Most channels of one app …
const MAX_CHANNELS: usize = 256;
/// … and topics of all that ever came.
const MAX_TOPICS: usize = 4_096;
/// How long an app that was lost is waited for when nothing else is recorded.
const COME_BACK: Duration = Duration::from_secs(5);

/// A channel whose stamps step back by more has a clock that began anew.
const RESET_NS: i64 = 750_000_000;

/// One app.
#[derive(Default)]
struct App {
    device: String,
    channels: BTreeMap<u32, Channel>,
    /// Clocks that are not UTC, by name: channels that share one tell it together.
    clocks: BTreeMap<String, AppClock>,
    rig_seen: bool,
}

struct Channel {
    advertised: Advertise,
    last_device_ns: Option<i64>,
}

/// A clock of an app.
#[derive(Default)]
struct AppClock {
    one_way: OneWayClock,
    last_device_ns: Option<i64>,
}

impl AppClock {
    /// Time of a stamp. What was measured before other messages that came earlier (a scan that took seconds) says nothing
    /// about the clock; only a channel that steps back itself shows that it began anew.
    fn time(&mut self, device_ns: i64, channel_last: Option<i64>, arrival: Timestamp) -> Timestamp {
        let is_latest = self.last_device_ns.is_none_or(|last| device_ns > last);
        let began_anew = channel_last.is_some_and(|last| device_ns < last.saturating_sub(RESET_NS));
        if is_latest || began_anew {
            self.one_way.push(device_ns, arrival);
            self.last_device_ns = Some(device_ns);
        }
        self.one_way.time(device_ns)
    }
}

/// Records until every app that came has gone and nothing else is recorded, or the session stops. As long as others send, apps
/// may come, go and come back.
pub(crate) fn record(
    mut server: SidecarServer,
    inlet: &Inlet,
    control: &Control,
    meter: &Meter,
) -> StreamReport {
    let mut recording = Sidecars::new(meter);
    // Since when nobody is connected of those who came.
    let mut all_gone: Option<Instant> = None;
    let ending = loop {
        let delivery = server.recv_unacknowledged(Duration::from_millis(50));
        match delivery {
            Ok(Some(Delivery {
                event:
                    SidecarEvent::Message {
                        connection,
                        arrival,
                        message,
                    },
                receipt,
            })) => {
                if all_gone.take().is_some() {
                    control.come_back();
                    meter.set_connected(Connection::There);
                }
                let from = Origin {
                    connection,
                    arrival,
                    receipt,
                };
                if recording.message(from, message, inlet).is_err() {
                    break Ending::Stopped;
                }
                meter.heard(&recording.report, arrival);
                control
                    .progress
                    .sidecar_messages
                    .store(recording.report.decoded, Ordering::Relaxed);
            }
            Ok(Some(Delivery {
                event:
                    SidecarEvent::Closed {
                        connection,
                        counters,
                        error,
                    },
                ..
            })) => {
                recording.closed(connection, counters, error);
                meter.count(&recording.report);
                if recording.seen && recording.apps.is_empty() && all_gone.is_none() {
                    all_gone = Some(Instant::now());
                    control.leave();
                    meter.set_connected(match recording.lost.is_empty() {
                        true => Connection::Left,
                        false => Connection::Gone,
                    });
                }
            }
            Ok(None) => {}
            Err(error) => break Ending::Lost(error.to_string()),
        }
        // First, as the others have ended too by then.
        if control.is_stopping() {
            break Ending::Stopped;
        }
        if let Some(since) = all_gone
            && control.nothing_is_left()
            && (recording.lost.is_empty() || since.elapsed() > COME_BACK)
        {
            break Ending::EndOfStream;
        }
    };
    if all_gone.is_some() {
        // Whoever runs this thread counts it out again.
        control.come_back();
    }
    recording.finish(ending)
}

impl Channel {
    /// The app's own stamp, beside the one made of it: none is overwritten.
    fn device_time(
        &self,
        time: Timestamp,
        arrival: Timestamp,
        device_time_ns: i64,
    ) -> Option<Entry> {
        let reference = TimeReference {
            device_ticks: u64::try_from(device_time_ns).ok()?,
            source: self.advertised.clock_id.clone(),
        };
        Some(Entry::Own(OwnMessage {
            topic: format!("{}{DEVICE_TIME}", self.advertised.topic),
            schema: message::TIME_REFERENCE,
            time,
            arrival,
            bytes: message::encode_time_reference(time, &self.advertised.clock_id, &reference)?,
        }))
    }
}

/// Where a message comes from, and what is owed for it.
pub(crate) struct Origin {
    pub(crate) connection: u64,
    pub(crate) arrival: Timestamp,
    pub(crate) receipt: Option<Receipt>,
}

pub(crate) struct Sidecars {
    apps: BTreeMap<u64, App>,
    /// Everything that was ever advertised: one topic carries one schema, and belongs to one connection at a time.
    topics: BTreeMap<String, Topic>,
    report: StreamReport,
    /// Whether anybody ever came.
    seen: bool,
    /// Apps that went without a goodbye and have not come back, and why.
    lost: BTreeMap<String, String>,
}

/// A topic of the recording that an app fills.
struct Topic {
    /// The connection that may send on it; `None`: it has gone.
    owner: Option<u64>,
    schema_name: String,
    schema: Vec<u8>,
}

impl Sidecars {
    pub(crate) fn new(meter: &Meter) -> Self {
        Self {
            apps: BTreeMap::new(),
            topics: BTreeMap::new(),
            report: meter.report(),
            seen: false,
            lost: BTreeMap::new(),
        }
    }

    pub(crate) fn finish(mut self, ending: Ending) -> StreamReport {
        self.report.ending = match self.lost.pop_first() {
            Some((_, why)) if !matches!(ending, Ending::Lost(_)) => Ending::Lost(why),
            _ => ending,
        };
        self.report
    }

    pub(crate) fn message(
        &mut self,
        from: Origin,
        message: SidecarMessage,
        inlet: &Inlet,
    ) -> Result<(), WriterGone> {
        let Origin {
            connection,
            arrival,
            receipt,
        } = from;
        self.seen = true;
        let app = self.apps.entry(connection).or_default();
        match message {
            SidecarMessage::Hello(hello) => {
                if self.lost.remove(&hello.device).is_some() {
                    self.report.interruptions += 1;
                }
                app.device = hello.device;
            }
            SidecarMessage::Advertise(advertised) => {
                let known = self.topics.get(&advertised.topic);
                let problem = unfit(&advertised)
                    .or_else(|| taken(known, connection, &advertised))
                    .or_else(|| too_many(app, &self.topics, &advertised));
                if let Some(problem) = problem {
                    self.report.bad += 1;
                    self.report.first_bad.get_or_insert(problem);
                    // What this number meant before, it does not mean any more.
                    app.channels.remove(&advertised.channel);
                    return Ok(());
                }
                self.topics.insert(
                    advertised.topic.clone(),
                    Topic {
                        owner: Some(connection),
                        schema_name: advertised.schema_name.clone(),
                        schema: advertised.schema.clone(),
                    },
                );
                let rig = rig_of(&advertised).filter(|_| !app.rig_seen);
                let owner = app.device.clone();
                app.rig_seen |= rig.is_some();
                app.channels.insert(
                    advertised.channel,
                    Channel {
                        advertised,
                        last_device_ns: None,
                    },
                );
                match rig {
                    Some(Ok(rig)) => inlet.put(
                        Entry::Rig {
                            owner,
                            rig: Box::new(rig),
                        },
                        &mut self.report,
                    )?,
                    Some(Err(problem)) => self.report.notes.push(problem),
                    None => {}
                }
            }
            SidecarMessage::Data {
                channel,
                device_time_ns,
                payload,
                ..
            } => {
                self.report.received += 1;
                // A channel whose description was refused; that is counted already.
                let Some(channel) = app.channels.get_mut(&channel) else {
                    return match receipt {
                        Some(receipt) => inlet.put(Entry::Skipped(receipt), &mut self.report),
                        None => Ok(()),
                    };
                };
                let time = if channel.advertised.clock_id == CLOCK_UTC {
                    Timestamp::from_nanos(device_time_ns)
                } else {
                    let name = channel.advertised.clock_id.clone();
                    let clock = app.clocks.entry(name).or_default();
                    let time = clock.time(device_time_ns, channel.last_device_ns, arrival);
                    channel.last_device_ns = Some(device_time_ns);
                    if let Some(entry) = channel.device_time(time, arrival, device_time_ns) {
                        inlet.put(entry, &mut self.report)?;
                    }
                    time
                };
                self.report.decoded += 1;
                let entry = Entry::Cdr {
                    topic: channel.advertised.topic.clone(),
                    schema_name: channel.advertised.schema_name.clone(),
                    schema_text: String::from_utf8_lossy(&channel.advertised.schema).into_owned(),
                    time,
                    arrival,
                    bytes: payload,
                    receipt,
                };
                inlet.put(entry, &mut self.report)?;
            }
            SidecarMessage::Bye { .. } => {}
        }
        Ok(())
    }

    fn closed(
        &mut self,
        connection: u64,
        counters: SidecarCounters,
        error: Option<lsfb_drivers::Error>,
    ) {
        self.report.bad += counters.bad_checksum + counters.malformed;
        // Damaged envelopes are among the missing: their numbers never came.
        self.report.missing += counters.missing.saturating_sub(counters.bad_checksum);
        self.report.duplicated += counters.duplicated;
        for topic in self.topics.values_mut() {
            if topic.owner == Some(connection) {
                topic.owner = None;
            }
        }
        let Some(app) = self.apps.remove(&connection) else {
            // Whoever never said what it is is none of ours: a browser, a port scanner.
            return;
        };
        if let Some(error) = error {
            let why = format!("{}: {error}", app.device);
            self.lost.insert(app.device, why);
        }
    }
}

/// Why a channel cannot be recorded.
fn unfit(advertised: &Advertise) -> Option<String> {
    let Advertise {
        topic, encoding, ..
    } = advertised;
    if encoding != ENCODING {
        return Some(format!(
            "channel {topic}: encoding {encoding:?}, a recording holds {ENCODING:?} only"
        ));
    }
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '/' | '_' | '-' | '.');
    if topic.ends_with(DEVICE_TIME) {
        return Some(format!(
            "channel {topic}: topics that end in {DEVICE_TIME} are the recorder's own"
        ));
    }
    if !topic.starts_with("/sidecar/") || !topic.chars().all(allowed) {
        return Some(format!(
            "channel {topic:?}: the topic must begin with /sidecar/ and be plain ASCII"
        ));
    }
    None
}

/// Why a topic is not this connection's to advertise so.
fn taken(known: Option<&Topic>, connection: u64, advertised: &Advertise) -> Option<String> {
    let topic = &advertised.topic;
    let known = known?;
    if known.owner.is_some_and(|owner| owner != connection) {
        return Some(format!(
            "channel {topic}: another app that is connected sends on it"
        ));
    }
    let same = (&known.schema_name, &known.schema) == (&advertised.schema_name, &advertised.schema);
    (!same).then(|| {
        format!(
            "channel {topic}: the recording holds {} there, which is not the {} that is advertised",
            known.schema_name, advertised.schema_name
        )
    })
}

/// Why an app, or all of them, may have no more topics: a recording holds 65 535.
fn too_many(app: &App, topics: &BTreeMap<String, Topic>, advertised: &Advertise) -> Option<String> {
    let is_new = !topics.contains_key(&advertised.topic);
    let limit = match app.channels.len() {
        MAX_CHANNELS.. if !app.channels.contains_key(&advertised.channel) => MAX_CHANNELS,
        _ if is_new && topics.len() >= MAX_TOPICS => MAX_TOPICS,
        _ => return None,
    };
    Some(format!(
        "channel {}: there are {limit} already, and no more are taken",
        advertised.topic
    ))
}

/// The rig an app brings, if it does.
fn rig_of(advertised: &Advertise) -> Option<Result<Rig, String>> {
    let metadata: serde_json::Value = serde_json::from_str(&advertised.metadata_json).ok()?;
    let text = metadata.get(RIG_KEY)?.as_str()?;
    Some(Rig::from_toml(text, &advertised.topic).map_err(|e| e.to_string()))
}
