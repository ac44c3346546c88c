//! Phones and glasses: what they describe and send goes into the recording word for word.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::time::Duration;

use lsfb_drivers::phone::model::CLOCK_UTC;
use lsfb_drivers::phone::wire::Advertise;
use lsfb_drivers::phone::{
    Delivery, Receipt, SidecarCounters, SidecarEvent, SidecarMessage, SidecarServer,
};
use lsfb_geometry::Rig;
use lsfb_recording::DEVICE_TIME;
use lsfb_recording::message::{self, TimeReference};
use lsfb_types::Timestamp;

use crate::clock::OneWayClock;
use crate::health::{Ending, Meter, StreamReport};
use crate::recorder::{Entry, Inlet, OwnMessage, WriterGone};
use crate::session::Control;

/// Topics of what a phone hears (networks, beacons, satellites): it comes when there is something to hear, seconds after it was
/// measured.
pub(crate) fn is_heard(topic: &str) -> bool {
    let ends = ["/wifi", "/ble", "/gnss"];
    topic.starts_with("/sidecar/") && ends.iter().any(|end| topic.ends_with(end))
}

/// The only encoding a recording holds.
const ENCODING: &str = "cdr";
/// Key of the rig's TOML in a channel's static metadata.
const RIG_KEY: &str = "rig_toml";

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

/// Records until every app that came has gone, or the session stops.
pub(crate) fn record(
    mut server: SidecarServer,
    inlet: &Inlet,
    control: &Control,
    meter: &Meter,
) -> StreamReport {
    let mut recording = Sidecars::new(meter);
    let mut seen = false;
    let ending = loop {
        let delivery = server.recv_unacknowledged(Duration::from_millis(50));
        let (event, receipt) = match delivery {
            Ok(Some(Delivery { event, receipt })) => (Ok(Some(event)), receipt),
            Ok(None) => (Ok(None), None),
            Err(error) => (Err(error), None),
        };
        match event {
            Ok(Some(SidecarEvent::Message {
                connection,
                arrival,
                message,
            })) => {
                seen = true;
                let from = Origin {
                    connection,
                    arrival,
                    receipt,
                };
                if recording.message(from, message, inlet).is_err() {
                    break Ending::Stopped;
                }
                meter.heard(&recording.report);
                control
                    .progress
                    .sidecar_messages
                    .store(recording.report.decoded, Ordering::Relaxed);
            }
            Ok(Some(SidecarEvent::Closed {
                connection,
                counters,
                error,
            })) => {
                recording.closed(connection, counters, error);
                if seen && recording.apps.is_empty() {
                    break recording
                        .failure
                        .take()
                        .map_or(Ending::EndOfStream, Ending::Lost);
                }
            }
            Ok(None) => {}
            Err(error) => break Ending::Lost(error.to_string()),
        }
        if control.is_stopping() {
            break Ending::Stopped;
        }
    };
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
    report: StreamReport,
    failure: Option<String>,
}

impl Sidecars {
    pub(crate) fn new(meter: &Meter) -> Self {
        Self {
            apps: BTreeMap::new(),
            report: meter.report(),
            failure: None,
        }
    }

    pub(crate) fn finish(mut self, ending: Ending) -> StreamReport {
        self.report.ending = ending;
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
        let app = self.apps.entry(connection).or_default();
        match message {
            SidecarMessage::Hello(hello) => app.device = hello.device,
            SidecarMessage::Advertise(advertised) => {
                if let Some(problem) = unfit(&advertised) {
                    self.report.bad += 1;
                    self.report.first_bad.get_or_insert(problem);
                    return Ok(());
                }
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
        let app = self.apps.remove(&connection).unwrap_or_default();
        self.report.bad += counters.bad_checksum + counters.malformed;
        // Damaged envelopes are among the missing: their numbers never came.
        self.report.missing += counters.missing.saturating_sub(counters.bad_checksum);
        self.report.duplicated += counters.duplicated;
        if let Some(error) = error {
            self.failure = Some(format!("{}: {error}", app.device));
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
    if !topic.starts_with("/sidecar/") || !topic.chars().all(allowed) {
        return Some(format!(
            "channel {topic:?}: the topic must begin with /sidecar/ and be plain ASCII"
        ));
    }
    None
}

/// The rig an app brings, if it does.
fn rig_of(advertised: &Advertise) -> Option<Result<Rig, String>> {
    let metadata: serde_json::Value = serde_json::from_str(&advertised.metadata_json).ok()?;
    let text = metadata.get(RIG_KEY)?.as_str()?;
    Some(Rig::from_toml(text, &advertised.topic).map_err(|e| e.to_string()))
}
