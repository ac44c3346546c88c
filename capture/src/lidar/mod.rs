//! LiDARs: data and position packets → scans on the recording's clock. Live and replayed packets go through one
//! [`LidarStream`].

mod blocked;
mod lasers;
mod listening;
mod senders;
mod shared_ports;
mod sight;
mod turns;
mod two_sensors;
mod utc;

use std::borrow::Cow;
use std::net::IpAddr;

use lsfb_drivers::any_lidar::{DecodeError, Decoder, Reorder, Settings, device_ns};
use lsfb_drivers::lidar::Position;
use lsfb_drivers::{Decoded, WireError};
use lsfb_recording::lidar_position;
use lsfb_types::{LidarScan, Packet, Stamped, Timestamp};

use crate::Error;
use crate::clock::model_topic::{ModelTopic, Reading};
use crate::clock::{LidarClock, PositionFix};
use crate::device_note::DeviceNote;
use crate::health::{Ending, Expected, Meter, Says, Stale, StreamReport};
use crate::order::Order;
use crate::recorder::{Entry, RecorderSender, WriterGone};
pub(crate) use listening::{Listened, Listening, record};
pub(crate) use shared_ports::Lidars;
pub(crate) use sight::Sight;
use turns::Turns;
use two_sensors::TwoSensors;
use utc::Utc;

/// Data packets that wait for the first position packet: one second of single returns. A sensor sends about 107 position
/// packets a second, so that one without any in this time has none to send.
const HELD_PACKETS: usize = 1_600;
/// How often the recording is told what the sensor is: one that says something else all the time is several.
const MOST_NOTES: usize = 16;
/// What it sends all the time.
const DATA: &str = "data";
const POSITION: &str = "position";
/// Its counter runs in microseconds and wraps with the hour.
const TICK_NS: u64 = 1_000;
const TICKS_PER_HOUR: u64 = 3_600_000_000;
/// So many packets without a scan are a problem: a turn has 720 at most (a Pandar64 at 5 Hz), and every LiDAR sends as many in a second.
const PACKETS_OF_NO_SCAN: u64 = 750;
/// Copies of each packet that a network may make: switches and captures on several interfaces make one or two.
const MOST_COPIES: u64 = 9;
/// Problems of a sensor that sends, and nothing to see.
const NO_SCAN: &str = "no complete scan: is its rotor turning?";
const NO_RETURN: &str = "no returns: is its window covered?";
const ANOTHER_SPEED: &str = "it rotates at another speed than configured: check its web page";
const POOR_SIGHT: &str =
    "most of its lasers have no returns: are they dead, or is its window covered?";
const TWO_SENSORS: &str =
    "two sensors send from one address and are mixed into one cloud: give each its own address";

/// What a LiDAR sends all the time; how often depends on its model, its returns and its sector, and is learned.
pub(crate) fn expected() -> Vec<Expected> {
    vec![
        Expected::required(DATA, None),
        Expected::once_heard(POSITION),
    ]
}

/// Decodes and stamps, whatever the packets come from.
pub(crate) struct LidarStream {
    name: String,
    /// Whose packets these are, where they carry a sender.
    address: Option<IpAddr>,
    /// The speed that it was set to, revolutions per minute, where that is known.
    set_rpm: Option<u16>,
    decoder: Decoder,
    reorder: Reorder,
    clock: LidarClock,
    held: Vec<Packet>,
    revolution: Vec<Packet>,
    positions: u64,
    model: ModelTopic,
    meter: Meter,
    report: StreamReport,
    last_data_time: Option<Timestamp>,
    /// Data of which no scan is made, and scans without a return.
    without_scan: Stale,
    without_return: Stale,
    /// Whether anything ever came back.
    has_seen: bool,
    /// Whether nothing more comes.
    has_ended: bool,
    sight: Sight,
    sensors: TwoSensors,
    arrivals: Order,
    utc: Utc,
    /// When the first and the last scan began.
    scans: Option<(Timestamp, Timestamp)>,
    turns: Turns,
    /// Scans that the decoder had cut for their length when the last one came.
    overlong: u64,
    /// Turns a second, once they are known.
    rate_hz: Option<f64>,
    /// What the recording says of it.
    noted: Vec<DeviceNote>,
}

impl LidarStream {
    pub(crate) fn new(name: &str, settings: Settings, meter: &Meter) -> Self {
        Self {
            name: name.to_owned(),
            address: None,
            set_rpm: None,
            decoder: Decoder::new(settings),
            reorder: Reorder::default(),
            clock: LidarClock::default(),
            held: Vec::new(),
            revolution: Vec::new(),
            positions: 0,
            model: ModelTopic::new(name, TICK_NS, TICKS_PER_HOUR),
            meter: meter.clone(),
            report: meter.report(),
            last_data_time: None,
            without_scan: Stale::after(PACKETS_OF_NO_SCAN),
            without_return: Stale::default(),
            has_seen: false,
            has_ended: false,
            sight: Sight::default(),
            sensors: TwoSensors::default(),
            arrivals: Order::default(),
            utc: Utc::default(),
            scans: None,
            turns: Turns::default(),
            overlong: 0,
            rate_hz: None,
            noted: Vec::new(),
        }
    }

    /// Takes a datagram of this LiDAR: a data packet, a position packet, or what nobody knows.
    pub(crate) fn push(
        &mut self,
        packet: Packet,
        to_recorder: &RecorderSender,
    ) -> Result<(), WriterGone> {
        let is_data = self.decoder.is_data(&packet.bytes);
        let position = self.decoder.position(&packet.bytes, packet.arrival);
        self.report.received += 1;
        self.arrivals.note(packet.arrival);
        self.take_counters();
        self.meter.heard(&self.report, packet.arrival);
        if is_data {
            self.meter.heard_part(DATA, 1);
            for packet in self.reorder.push(packet) {
                self.ordered(packet, to_recorder)?;
            }
            return Ok(());
        }
        match position {
            _ if self.decoder.is_beside(&packet.bytes) => {
                self.meter.heard_part(POSITION, 1);
                let time = packet.arrival;
                self.put_beside(packet, time, to_recorder)
            }
            Some(position) => self.position(position, packet, to_recorder),
            None => self.strange(packet, to_recorder),
        }
    }

    /// A datagram that no LiDAR sends, kept as it came.
    fn strange(&mut self, packet: Packet, to_recorder: &RecorderSender) -> Result<(), WriterGone> {
        // The decoder says whose it seems to be.
        if let Err(error) = self.decoder.push(&packet) {
            self.refused(&error);
        }
        let time = packet.arrival;
        let raw = Entry::Raw {
            source: self.name.clone(),
            kind: 0,
            sequence: self.report.bad,
            packet,
            time,
        };
        to_recorder.put(raw, &mut self.report)
    }

    fn refused(&mut self, error: &DecodeError) {
        match error {
            DecodeError::Wire(error) => self.report.count_bad(*error),
            error => {
                self.report.bad += 1;
                self.report
                    .first_bad
                    .get_or_insert_with(|| format!("packet {}: {error}", self.report.received));
            }
        }
    }

    /// Counts a part of a file that cannot be read.
    pub(crate) fn count_damage(&mut self, what: String) {
        self.report.bad += 1;
        if self.report.notes.len() < MOST_NOTES {
            self.report.notes.push(what.clone());
        }
        self.report.first_bad.get_or_insert(what);
    }

    /// Data packets in the order in which they were sent.
    fn ordered(&mut self, packet: Packet, to_recorder: &RecorderSender) -> Result<(), WriterGone> {
        if self.clock.is_decided() || self.held.len() >= HELD_PACKETS {
            self.release(to_recorder)?;
            self.data(packet, to_recorder)
        } else {
            self.held.push(packet);
            Ok(())
        }
    }

    /// Data packets waiting for a clock go through with the clock as it is.
    fn release(&mut self, to_recorder: &RecorderSender) -> Result<(), WriterGone> {
        for packet in std::mem::take(&mut self.held) {
            self.data(packet, to_recorder)?;
        }
        Ok(())
    }

    fn position(
        &mut self,
        position: Result<Position, WireError>,
        packet: Packet,
        to_recorder: &RecorderSender,
    ) -> Result<(), WriterGone> {
        self.meter.heard_part(POSITION, 1);
        let mut time = packet.arrival;
        match position {
            Ok(position) => {
                let fix = PositionFix {
                    toh_ns: position.toh_ns,
                    pps_locked: position.pps_locked,
                    sentence: position.sentence,
                };
                time = self.clock.fix(&fix, packet.arrival).unwrap_or(time);
                if let Some(celsius) = position.temperature_celsius {
                    self.meter.set_temperature(celsius);
                }
                self.utc.note(&position, packet.arrival);
                self.meter.set_utc(self.utc.problem());
            }
            Err(error) => self.report.count_bad(error),
        }
        self.put_beside(packet, time, to_recorder)
    }

    /// Records a packet beside the data as it came.
    fn put_beside(
        &mut self,
        packet: Packet,
        time: Timestamp,
        to_recorder: &RecorderSender,
    ) -> Result<(), WriterGone> {
        let raw = Entry::Raw {
            source: lidar_position(&self.name),
            kind: 0,
            sequence: self.positions,
            packet,
            time,
        };
        self.positions += 1;
        to_recorder.put(raw, &mut self.report)
    }

    fn data(&mut self, packet: Packet, to_recorder: &RecorderSender) -> Result<(), WriterGone> {
        match self.decoder.push(&packet) {
            Ok(scan) => {
                if let Some(scan) = scan {
                    self.scan(scan, to_recorder)?;
                }
            }
            Err(error) => self.refused(&error),
        }
        while let Some(scan) = self.decoder.ready() {
            self.scan(scan, to_recorder)?;
        }
        // Scans above are of packets before this one, and of the clock as it was then.
        if let Some(toh_ns) = device_ns(&packet.bytes) {
            self.clock.observe(toh_ns, packet.arrival);
        }
        self.last_data_time = Some(packet.arrival);
        self.without_scan.note(Says::NothingNew, packet.arrival);
        self.take_stale();
        self.revolution.push(packet);
        Ok(())
    }

    fn take_stale(&mut self) {
        self.sensors.note(self.decoder.counters());
        self.report.stale = self.without_scan.stretches()
            + self.without_return.stretches()
            + self.sight.stretches()
            + u64::from(self.was_blind())
            + u64::from(self.was_stuck())
            + u64::from(self.was_standing());
        let problem = if self.are_two() {
            Some(TWO_SENSORS)
        } else if self.set_hz().is_some_and(|hz| self.turns.misses(hz)) {
            Some(ANOTHER_SPEED)
        } else if self.without_scan.is_problem() {
            Some(NO_SCAN)
        } else if self.without_return.is_problem() {
            Some(NO_RETURN)
        } else if self.sight.is_poor() {
            Some(POOR_SIGHT)
        } else {
            None
        };
        self.meter.set_stale(problem.map(Cow::Borrowed));
    }

    fn scan(
        &mut self,
        scan: Decoded<LidarScan>,
        to_recorder: &RecorderSender,
    ) -> Result<(), WriterGone> {
        self.report.decoded += 1;
        self.take_counters();
        let has_returns = !scan.sample.points.is_empty();
        self.without_return
            .note(Says::news_if(has_returns), scan.arrival);
        if has_returns {
            self.has_seen = true;
            let lasers = self.decoder.found().map(|found| found.model.lasers());
            let seen = &self.decoder.counters().azimuths;
            self.sight.note(&scan.sample, lasers, seen);
            self.meter.set_partial(self.sight.problem());
        }
        let device_ns = scan.device_ticks.cast_signed();
        // What was cut for its length is no turn either, however regularly it comes.
        let overlong = self.decoder.counters().overlong;
        let was_cut = overlong > std::mem::replace(&mut self.overlong, overlong);
        let is_turn = self.turns.note(device_ns) && !was_cut;
        self.without_scan.note(Says::news_if(is_turn), scan.arrival);
        let time = self.clock.time(device_ns, scan.arrival);
        self.scans = Some((self.scans.map_or(time, |(first, _)| first), time));
        self.note_device(to_recorder)?;
        let jumps = self.decoder.counters().clock_jumps;
        let epoch = u32::try_from(jumps).unwrap_or(u32::MAX).saturating_add(1);
        let reading = match (self.clock.estimate(), self.clock.holdover_since()) {
            (Some(estimate), _) => Some(Reading::Fitted(estimate)),
            (None, Some(since)) => Some(Reading::Holdover {
                device_ns,
                time,
                since,
                epoch,
            }),
            (None, None) if self.clock.is_locked() => Some(Reading::Locked {
                device_ns,
                time,
                epoch,
            }),
            (None, None) => None,
        };
        if let Some(reading) = reading
            && self.model.is_due(&reading, scan.arrival)
        {
            self.meter.set_sync(reading.sync_state(), reading.steps());
            let entry = self.model.entry(&reading, time, scan.arrival);
            to_recorder.put(entry, &mut self.report)?;
        }
        let scan = Stamped {
            time,
            arrival: scan.arrival,
            device_ticks: scan.device_ticks,
            sample: scan.sample,
        };
        to_recorder.put(
            Entry::Scan {
                lidar: self.name.clone(),
                scan,
                packets: std::mem::take(&mut self.revolution),
            },
            &mut self.report,
        )
    }

    fn take_counters(&mut self) {
        let counters = self.decoder.counters();
        self.report.missing = counters.lost;
        self.report.reordered = counters.reordered;
        self.report.duplicated = counters.duplicates;
    }

    /// Turns a second that it was set to.
    fn set_hz(&self) -> Option<f64> {
        self.set_rpm.map(|rpm| f64::from(rpm) / 60.0)
    }

    /// Says in the recording what the sensor is, where that is new.
    fn note_device(&mut self, to_recorder: &RecorderSender) -> Result<(), WriterGone> {
        let Some(found) = self.decoder.found() else {
            return Ok(());
        };
        if self.rate_hz.is_none() {
            self.rate_hz = self.set_hz().or(self.turns.rate_hz());
        }
        let mut note = DeviceNote::new(&self.name)
            .with("model", found.model)
            .with("returns", found.returns);
        if let Some(ip) = self.address {
            note = note.with("address", ip);
        }
        if let Some(rate_hz) = self.rate_hz {
            note = note.with_rate_hz(rate_hz);
        }
        if self.noted.last() == Some(&note) || self.noted.len() >= MOST_NOTES {
            return Ok(());
        }
        self.noted.push(note.clone());
        to_recorder.put(Entry::Device(note), &mut self.report)
    }

    /// Whether it has ended, after less than what counts as a stretch, without a single return.
    fn was_blind(&self) -> bool {
        self.has_ended
            && self.report.decoded > 0
            && !self.has_seen
            && self.without_return.stretches() == 0
    }

    /// Whether it has ended, after less than what counts as a stretch, and nearly all its packets repeat the one before.
    fn was_stuck(&self) -> bool {
        let counters = self.decoder.counters();
        self.has_ended
            && counters.duplicates > MOST_COPIES * counters.packets.max(1)
            && self.without_scan.stretches() == 0
    }

    /// Whether it has ended, after less than what counts as a stretch, and all its scans but the last were no turn.
    fn was_standing(&self) -> bool {
        let counters = self.decoder.counters();
        self.has_ended
            && counters.overlong > 0
            && counters.overlong + 1 >= counters.scans
            && self.without_scan.stretches() == 0
    }

    /// Whether its packets are those of two sensors.
    pub(crate) fn are_two(&self) -> bool {
        self.sensors.are_two()
    }

    /// That its packets are those of two sensors, where they are.
    pub(crate) fn mixture(&self) -> Option<Error> {
        self.are_two().then(|| Error::TwoSensors {
            lidar: self.name.clone(),
            address: self.address,
        })
    }

    /// Decodes what was held back, as nothing more comes, and refuses packets of two sensors.
    pub(crate) fn drain(&mut self, to_recorder: &RecorderSender) -> Result<(), Error> {
        // A failed writer reports itself.
        let _ = self.finish_scans(to_recorder);
        self.mixture().map_or(Ok(()), Err)
    }

    /// Ends the stream.
    pub(crate) fn finish(mut self, ending: Ending, to_recorder: &RecorderSender) -> StreamReport {
        // A failed writer reports itself.
        let _ = self.finish_scans(to_recorder);
        self.take_counters();
        self.has_ended = true;
        self.sight.finish();
        self.take_stale();
        self.report.ending = match self.are_two() {
            true => Ending::Lost(TWO_SENSORS.to_owned()),
            false => ending,
        };
        let counters = *self.decoder.counters();
        for (count, what) in [
            (
                counters.reordered,
                "packets came too late to be reordered: they are recorded, but are in no scan",
            ),
            (
                self.reorder.moved(),
                "packets arrived out of order and were reordered",
            ),
            (self.clock.lock_losses(), "losses of the PPS lock"),
            (
                self.utc.stretches(),
                "times UTC was not backed by GNSS for more than three seconds: its receiver had no fix",
            ),
            (
                self.without_scan.stretches(),
                "stretches without a complete scan for more than a second",
            ),
            (
                self.without_return.stretches(),
                "stretches of scans without returns for more than a second",
            ),
            (
                if self.was_blind() {
                    self.report.decoded
                } else {
                    0
                },
                "scans, none with any returns",
            ),
            (
                if self.was_stuck() {
                    counters.duplicates
                } else {
                    0
                },
                "packets repeat the previous time and were left out: the sensor's clock is stuck",
            ),
            (counters.clock_jumps, "jumps of the sensor's clock"),
            (counters.mode_changes, "changes of model or return mode"),
            (counters.overlong, "scans longer than a turn of the rotor"),
        ] {
            if count > 0 {
                self.report.notes.push(format!("{count} {what}"));
            }
        }
        if let Some(problem) = self.arrivals.problem() {
            self.report.notes.push(format!(
                "arrivals of its packets {problem}: the host's clock was set, captures from different times were joined, or their stamps were removed"
            ));
        }
        let silent = self.sight.worst().map(lasers::Silent::words);
        let blocked = self.sight.ever_blocked().map(blocked::Blocked::words);
        self.report.notes.extend(silent.into_iter().chain(blocked));
        if let Some(what) = self.what_it_is() {
            self.report.notes.insert(0, what);
        }
        if self.report.decoded > 0 && !self.clock.is_locked() {
            self.report.notes.push(
                "the sensor's clock is not locked to PPS: its time is estimated from arrivals"
                    .to_owned(),
            );
        }
        self.report
    }

    /// Model, address, returns and speed of the sensor, as they were found.
    fn what_it_is(&self) -> Option<String> {
        let found = self.decoder.found()?;
        let mut what = found.model.to_string();
        if let Some(ip) = self.address {
            what += &format!(" at {ip}");
        }
        what += &format!(", returns: {}", found.returns);
        if let Some(rpm) = found.rpm {
            what += &format!(", {rpm} rpm");
        }
        if let Some((first, last)) = self.scans
            && last > first
        {
            let scans = self.report.decoded.saturating_sub(1) as f64;
            what += &format!(", {:.1} scans per second", scans / last.secs_since(first));
        }
        Some(what)
    }

    fn finish_scans(&mut self, to_recorder: &RecorderSender) -> Result<(), WriterGone> {
        for packet in self.reorder.finish() {
            self.ordered(packet, to_recorder)?;
        }
        self.release(to_recorder)?;
        while let Some(scan) = self.decoder.finish() {
            self.scan(scan, to_recorder)?;
        }
        let packets = std::mem::take(&mut self.revolution);
        match (packets.is_empty(), self.last_data_time) {
            (false, Some(time)) => {
                let lidar = self.name.clone();
                let rest = Entry::Packets {
                    lidar,
                    time,
                    packets,
                };
                to_recorder.put(rest, &mut self.report)
            }
            _ => Ok(()),
        }
    }
}
