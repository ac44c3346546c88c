//! What apps describe and send goes into the recording word for word, with the times made of their own.

use std::collections::BTreeMap;

use lsfb_drivers::sidecar::SidecarMessage;
use lsfb_drivers::sidecar::model::CLOCK_UTC;
use lsfb_drivers::sidecar::wire::{Advertise, TimeExchange};
use lsfb_geometry::Rig;
use lsfb_recording::DEVICE_TIME;
use lsfb_recording::message::{self, TimeReference};
use lsfb_types::Timestamp;

use super::pseudonyms::Pseudonyms;
use crate::clock::OneWayClock;
use crate::health::{Meter, StreamReport};
use crate::receipt::Receipt;
use crate::recorder::{Entry, OwnMessage, RecorderSender, WriterGone};
use crate::wifi_scans::WifiScans;

/// Key of the rig's TOML in a channel's static metadata.
const RIG_KEY: &str = "rig_toml";
/// What to do where a phone's system holds Wi-Fi scans back.
const HELD_BACK: &str =
    "its system throttles Wi-Fi scans: turn off \"Wi-Fi scan throttling\" in the developer options";
/// Kinds of readings without a place that are counted apart.
const MAX_LEFT_OUT: usize = 1_024;
/// A channel whose stamps step back by more has a clock that began anew.
const RESET_NS: i64 = 750_000_000;
/// A message that took longer had waited until the phone was in reach again: no queue of a network is as long.
const WAITED_NS: i64 = 500_000_000;

/// One app, whatever it is connected by.
#[derive(Default)]
struct App {
    channels: BTreeMap<u32, Channel>,
    /// Clocks that are not UTC, by name: channels that share one tell it together.
    clocks: BTreeMap<String, AppClock>,
    wifi: WifiScans,
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
    /// Host time less device time at the last exchange of times, nanoseconds.
    exchanged_ns: Option<i64>,
}

impl AppClock {
    /// Time of a stamp. What was measured before other messages that came earlier (a scan that took seconds) says nothing
    /// about the clock; only a channel that steps back itself shows that it began anew.
    fn time(&mut self, device_ns: i64, channel_last: Option<i64>, arrival: Timestamp) -> Timestamp {
        let is_latest = self.last_device_ns.is_none_or(|last| device_ns > last);
        let began_anew = channel_last.is_some_and(|last| device_ns < last.saturating_sub(RESET_NS));
        if (is_latest && !self.has_waited(device_ns, arrival)) || began_anew {
            self.one_way.push(device_ns, arrival);
            self.last_device_ns = Some(device_ns);
        }
        self.one_way.time(device_ns)
    }

    /// Whether a message waited on the phone, which was out of reach: its arrival says nothing about the clock, and many of them in a
    /// row would look like a clock that was set.
    fn has_waited(&self, device_ns: i64, arrival: Timestamp) -> bool {
        self.exchanged_ns.is_some_and(|ahead_ns| {
            let measured_ns = device_ns.saturating_add(ahead_ns);
            arrival.nanos().saturating_sub(measured_ns) > WAITED_NS
        })
    }
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

/// All apps of a recording. Who may describe what has been looked at before.
pub(crate) struct Apps {
    apps: BTreeMap<String, App>,
    pseudonyms: Option<Pseudonyms>,
    /// Readings of sensors that have no place in a recording, by device and sensor.
    left_out: BTreeMap<(String, String), u64>,
    pub(super) report: StreamReport,
}

impl Apps {
    pub(crate) fn new(meter: &Meter, pseudonyms: Option<Pseudonyms>) -> Self {
        Self {
            apps: BTreeMap::new(),
            pseudonyms,
            left_out: BTreeMap::new(),
            report: meter.report(),
        }
    }

    /// Counts what cannot be recorded.
    pub(crate) fn refuse(&mut self, why: String) {
        self.report.bad += 1;
        self.report.first_bad.get_or_insert(why);
    }

    /// Takes an exchange of times with a clock of a device.
    pub(super) fn exchange(&mut self, device: &str, clock_id: &str, exchange: &TimeExchange) {
        if let Some(app) = self.apps.get_mut(device)
            && let Some(clock) = app.clocks.get_mut(clock_id)
        {
            let there = i128::from(exchange.t2_ns) - i128::from(exchange.t1_ns);
            let back = i128::from(exchange.t3_ns) - i128::from(exchange.t4_ns);
            clock.exchanged_ns = i64::try_from((there + back) / 2).ok();
        }
    }

    /// Counts readings that have no place in a recording.
    pub(super) fn leave_out(&mut self, device: &str, readings: BTreeMap<String, u64>) {
        for (sensor, count) in readings {
            let is_much = self.left_out.len() >= MAX_LEFT_OUT;
            let sensor = if is_much { "others".to_owned() } else { sensor };
            *self
                .left_out
                .entry((device.to_owned(), sensor))
                .or_default() += count;
        }
    }

    /// Whose system holds Wi-Fi scans back now; `None`: nobody's.
    pub(super) fn held_back(&self) -> Option<String> {
        let apps = self.apps.iter();
        let names: Vec<&str> = apps
            .filter(|(_, app)| app.wifi.are_held_back())
            .map(|(device, _)| device.as_str())
            .collect();
        (!names.is_empty()).then(|| format!("{}: {HELD_BACK}", names.join(", ")))
    }

    pub(crate) fn into_report(mut self) -> StreamReport {
        for (device, app) in &mut self.apps {
            app.wifi.finish();
            if app.wifi.were_held_back() {
                let words = app.wifi.words();
                self.report.notes.push(format!("{device}: {words}"));
            }
        }
        let words = self.left_out.iter();
        let words: Vec<String> = words
            .map(|((device, sensor), count)| format!("{count} × {sensor} of {device}"))
            .collect();
        if !words.is_empty() {
            let words = words.join(", ");
            self.report
                .notes
                .push(format!("readings that a recording cannot hold: {words}"));
        }
        self.report
    }

    pub(crate) fn message(
        &mut self,
        device: &str,
        arrival: Timestamp,
        message: SidecarMessage,
        receipt: Option<Receipt>,
        to_recorder: &RecorderSender,
    ) -> Result<(), WriterGone> {
        let app = self.apps.entry(device.to_owned()).or_default();
        match message {
            SidecarMessage::Advertise(advertised) => {
                let rig = rig_of(&advertised).filter(|_| !app.rig_seen);
                app.rig_seen |= rig.is_some();
                let last = app.channels.get(&advertised.channel);
                let last_device_ns = last.and_then(|last| last.last_device_ns);
                app.channels.insert(
                    advertised.channel,
                    Channel {
                        advertised,
                        last_device_ns,
                    },
                );
                match rig {
                    Some(Ok(rig)) => to_recorder.put(
                        Entry::Rig {
                            owner: device.to_owned(),
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
                    return Ok(());
                };
                let time = if channel.advertised.clock_id == CLOCK_UTC {
                    Timestamp::from_nanos(device_time_ns)
                } else {
                    let name = channel.advertised.clock_id.clone();
                    let clock = app.clocks.entry(name).or_default();
                    let time = clock.time(device_time_ns, channel.last_device_ns, arrival);
                    channel.last_device_ns = Some(device_time_ns);
                    if let Some(entry) = channel.device_time(time, arrival, device_time_ns) {
                        to_recorder.put(entry, &mut self.report)?;
                    }
                    time
                };
                let replaced = self
                    .pseudonyms
                    .as_ref()
                    .and_then(|p| p.replace(&channel.advertised.schema_name, &payload));
                let bytes = match replaced.transpose() {
                    Ok(replaced) => replaced.unwrap_or(payload),
                    Err(why) => {
                        // It may hold an identifier, and is no better when it comes again.
                        let topic = &channel.advertised.topic;
                        let why =
                            format!("{topic}: {why}; left out because identifiers are hashed");
                        self.report.bad += 1;
                        self.report.first_bad.get_or_insert(why);
                        receipt.into_iter().for_each(Receipt::acknowledge);
                        return Ok(());
                    }
                };
                self.report.decoded += 1;
                if channel.advertised.schema_name == message::WIFI_READING.name
                    && let Ok(reading) = message::decode_wifi(&bytes)
                {
                    app.wifi.note(time, reading);
                }
                let entry = Entry::Cdr {
                    topic: channel.advertised.topic.clone(),
                    schema_name: channel.advertised.schema_name.clone(),
                    schema_text: String::from_utf8_lossy(&channel.advertised.schema).into_owned(),
                    time,
                    arrival,
                    bytes,
                    receipt,
                };
                to_recorder.put(entry, &mut self.report)?;
            }
            SidecarMessage::Hello(_)
            | SidecarMessage::TimeRequest(_)
            | SidecarMessage::Bye { .. } => {}
        }
        Ok(())
    }
}

/// The rig an app brings, if it does.
fn rig_of(advertised: &Advertise) -> Option<Result<Rig, String>> {
    let metadata: serde_json::Value = serde_json::from_str(&advertised.metadata_json).ok()?;
    let text = metadata.get(RIG_KEY)?.as_str()?;
    Some(Rig::from_toml(text, &advertised.topic).map_err(|e| e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const START_NS: i64 = 1_772_359_200_000_000_000;

    /// Out of reach for a minute, then all that waited at once, three times as fast as it was measured.
    #[test]
    fn what_waited_on_a_phone_sets_no_clock() {
        let mut clock = AppClock::default();
        let mut last = None;
        for n in 0..18_000_i64 {
            let device_ns = n * 10_000_000;
            let (away_ns, back_ns) = (60_000_000_000, 120_000_000_000);
            let arrival_ns = match device_ns {
                0..60_000_000_000 => device_ns,
                _ => device_ns.max(back_ns + (device_ns - away_ns) / 3),
            } + 4_000_000;
            if n % 100 == 0 && (device_ns < away_ns || arrival_ns > back_ns) {
                clock.exchanged_ns = Some(START_NS);
            }
            let arrival = Timestamp::from_nanos(START_NS + arrival_ns);
            let time = clock.time(device_ns, last, arrival);
            last = Some(device_ns);
            let error_ns = time.nanos() - START_NS - device_ns;
            assert!(error_ns.abs() < 20_000_000, "{n}: {error_ns} ns");
        }
        assert!(clock.one_way.steps().is_empty());
    }
}
