//! The LiDAR: data and position packets → scans on the recording's clock. Live and replayed packets go through one
//! [`LidarStream`].

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::transport::udp::UdpSource;
use lsfb_drivers::velodyne::nmea::Sentence;
use lsfb_drivers::velodyne::wire::{
    DATA_PACKET_LEN, DataPacket, POSITION_PACKET_LEN, PositionPacket, PpsStatus,
};
use lsfb_drivers::velodyne::{DecodeError, Decoder, DecoderConfig};
use lsfb_drivers::{Decoded, WireError};
use lsfb_recording::LIDAR_POSITION;
use lsfb_types::{LidarScan, Packet, Stamped, Timestamp};

use crate::clock::model_topic::{ModelTopic, Reading};
use crate::clock::{LidarClock, PositionFix};
use crate::control::Control;
use crate::health::{Ending, Expected, Meter, StreamReport};
use crate::recorder::{Entry, Inlet, WriterGone};

/// Data packets that wait for the first position packet: one second of single returns. A sensor sends about 107 position
/// packets a second, so that one without any in this time has none to send.
const HELD_PACKETS: usize = 1_600;
/// Its name.
pub(crate) const LIDAR: &str = "lidar";
/// What it sends all the time.
const DATA: &str = "data";
const POSITION: &str = "position";
/// Source of datagrams that no Velodyne sends, kept as they came.
const STRANGE: &str = "lidar";
/// Its counter runs in microseconds and wraps with the hour.
const TICK_NS: u64 = 1_000;
const TICKS_PER_HOUR: u64 = 3_600_000_000;
/// After the other devices have ended, a LiDAR silent for this long has ended too.
const SILENT: Duration = Duration::from_millis(500);

/// What a LiDAR sends all the time; how often depends on its model, its returns and its sector, and is learned.
pub(crate) fn expected() -> Vec<Expected> {
    vec![
        Expected::required(DATA, None),
        Expected::once_heard(POSITION),
    ]
}

/// Decodes and stamps, whatever the packets come from.
pub(crate) struct LidarStream {
    decoder: Decoder,
    clock: LidarClock,
    held: Vec<Packet>,
    revolution: Vec<Packet>,
    positions: u64,
    model: ModelTopic,
    meter: Meter,
    report: StreamReport,
    last_data_time: Option<Timestamp>,
}

impl LidarStream {
    pub(crate) fn new(config: DecoderConfig, meter: &Meter) -> Self {
        Self {
            decoder: Decoder::new(config),
            clock: LidarClock::default(),
            held: Vec::new(),
            revolution: Vec::new(),
            positions: 0,
            model: ModelTopic::new(LIDAR, TICK_NS, TICKS_PER_HOUR),
            meter: meter.clone(),
            report: meter.report(),
            last_data_time: None,
        }
    }

    /// Takes a packet of either kind; they differ in length.
    pub(crate) fn push(&mut self, packet: Packet, inlet: &Inlet) -> Result<(), WriterGone> {
        self.report.received += 1;
        let counters = *self.decoder.counters();
        self.report.missing = counters.lost;
        self.report.duplicated = counters.duplicates;
        self.meter.heard(&self.report);
        if packet.bytes.len() == DATA_PACKET_LEN {
            self.meter.heard_part(DATA, 1);
        }
        match packet.bytes.len() {
            POSITION_PACKET_LEN => self.position(packet, inlet),
            DATA_PACKET_LEN if self.clock.is_decided() || self.held.len() >= HELD_PACKETS => {
                self.release(inlet)?;
                self.data(packet, inlet)
            }
            DATA_PACKET_LEN => {
                self.held.push(packet);
                Ok(())
            }
            got => {
                self.report.count_bad(WireError::Length {
                    expected: DATA_PACKET_LEN,
                    got,
                });
                let time = packet.arrival;
                let raw = Entry::Raw {
                    source: STRANGE.to_owned(),
                    kind: 0,
                    sequence: self.report.bad,
                    packet,
                    time,
                };
                inlet.put(raw, &mut self.report)
            }
        }
    }

    /// Data packets waiting for a clock go through with the clock as it is.
    fn release(&mut self, inlet: &Inlet) -> Result<(), WriterGone> {
        for packet in std::mem::take(&mut self.held) {
            self.data(packet, inlet)?;
        }
        Ok(())
    }

    fn position(&mut self, packet: Packet, inlet: &Inlet) -> Result<(), WriterGone> {
        self.meter.heard_part(POSITION, 1);
        let mut time = packet.arrival;
        match PositionPacket::new(packet.bytes.as_slice()) {
            Ok(position) => {
                let toh_ns = i64::from(position.timestamp_us()) * 1000;
                let about_secs = packet.arrival.nanos().div_euclid(1_000_000_000);
                let sentence = Sentence::parse(position.nmea()).ok();
                let named_secs = sentence.and_then(|sentence| sentence.unix_secs(about_secs));
                self.clock.fix(&PositionFix {
                    toh_ns,
                    pps_locked: position.pps_status() == PpsStatus::Locked,
                    sentence: named_secs
                        .map(|secs| Timestamp::from_nanos(secs.saturating_mul(1_000_000_000))),
                });
                self.meter
                    .set_temperature(f64::from(position.top_temperature_celsius()));
                if self.clock.is_locked() {
                    time = self.clock.time(toh_ns, packet.arrival);
                }
            }
            Err(error) => self.report.count_bad(error),
        }
        let raw = Entry::Raw {
            source: LIDAR_POSITION.to_owned(),
            kind: 0,
            sequence: self.positions,
            packet,
            time,
        };
        self.positions += 1;
        inlet.put(raw, &mut self.report)
    }

    fn data(&mut self, packet: Packet, inlet: &Inlet) -> Result<(), WriterGone> {
        match self.decoder.push(&packet) {
            Ok(scan) => {
                if let Some(scan) = scan {
                    self.scan(scan, inlet)?;
                }
            }
            Err(DecodeError::Wire(error)) => self.report.count_bad(error),
            Err(error) => {
                self.report.bad += 1;
                self.report
                    .first_bad
                    .get_or_insert_with(|| format!("packet {}: {error}", self.report.received));
            }
        }
        if let Ok(data) = DataPacket::new(&packet.bytes) {
            self.clock
                .observe(i64::from(data.timestamp_us()) * 1000, packet.arrival);
        }
        self.last_data_time = Some(packet.arrival);
        self.revolution.push(packet);
        Ok(())
    }

    fn scan(&mut self, scan: Decoded<LidarScan>, inlet: &Inlet) -> Result<(), WriterGone> {
        self.report.decoded += 1;
        self.report.missing = self.decoder.counters().lost;
        let time = self
            .clock
            .time(scan.device_ticks.cast_signed(), scan.arrival);
        let device_ns = scan.device_ticks.cast_signed();
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
            && self.model.is_due(scan.arrival)
        {
            self.meter.set_sync(reading.sync_state(), reading.steps());
            let entry = self.model.entry(&reading, time, scan.arrival);
            inlet.put(entry, &mut self.report)?;
        }
        let scan = Stamped {
            time,
            arrival: scan.arrival,
            device_ticks: scan.device_ticks,
            sample: scan.sample,
        };
        inlet.put(
            Entry::Scan {
                scan,
                packets: std::mem::take(&mut self.revolution),
            },
            &mut self.report,
        )
    }

    /// Ends the stream.
    pub(crate) fn finish(mut self, ending: Ending, inlet: &Inlet) -> StreamReport {
        self.report.ending = ending;
        // A failed writer reports itself.
        let _ = self.finish_scans(inlet);
        let counters = *self.decoder.counters();
        self.report.missing = counters.lost;
        self.report.duplicated = counters.duplicates;
        for (count, what) in [
            (
                counters.late,
                "packets came after a later one and are left out of the scans",
            ),
            (self.clock.lock_losses(), "times the PPS lock was lost"),
            (counters.clock_jumps, "jumps of the sensor's clock"),
            (counters.mode_changes, "changes of model or return mode"),
            (counters.overlong, "scans without a full turn of the rotor"),
        ] {
            if count > 0 {
                self.report.notes.push(format!("{count} {what}"));
            }
        }
        if self.report.decoded > 0 && !self.clock.is_locked() {
            self.report.notes.push(
                "the sensor's clock is not locked to PPS: its time is fitted to arrival".to_owned(),
            );
        }
        self.report
    }

    fn finish_scans(&mut self, inlet: &Inlet) -> Result<(), WriterGone> {
        self.release(inlet)?;
        while let Some(scan) = self.decoder.finish() {
            self.scan(scan, inlet)?;
        }
        let packets = std::mem::take(&mut self.revolution);
        match (packets.is_empty(), self.last_data_time) {
            (false, Some(time)) => inlet.put(Entry::Packets { time, packets }, &mut self.report),
            _ => Ok(()),
        }
    }
}

/// Records until the session stops, or until the others have ended and nothing comes any more.
pub(crate) fn record(
    mut source: UdpSource,
    config: DecoderConfig,
    inlet: &Inlet,
    control: &Control,
    meter: &Meter,
) -> StreamReport {
    let mut stream = LidarStream::new(config, meter);
    let mut last_heard = Instant::now();
    let ending = loop {
        match source.recv(Duration::from_millis(50)) {
            Ok(Some(packet)) => {
                last_heard = Instant::now();
                control.set_lidar_alive(true);
                if stream.push(packet, inlet).is_err() {
                    break Ending::Stopped;
                }
                control
                    .progress
                    .lidar_packets
                    .fetch_add(1, Ordering::Relaxed);
            }
            Ok(None) if control.others_ended() && last_heard.elapsed() > SILENT => {
                break Ending::EndOfStream;
            }
            Ok(None) => control.set_lidar_alive(last_heard.elapsed() <= SILENT),
            Err(lsfb_drivers::Error::EndOfStream { .. }) => break Ending::EndOfStream,
            Err(error) => break Ending::Lost(error.to_string()),
        }
        if control.is_stopping() {
            break Ending::Stopped;
        }
    };
    control.set_lidar_alive(false);
    let mut report = stream.finish(ending, inlet);
    if source.kernel_drops() > 0 {
        report.notes.push(format!(
            "the kernel dropped {} packets: raise net.core.rmem_max (receive buffer: {} bytes)",
            source.kernel_drops(),
            source.receive_buffer_bytes()
        ));
    }
    report
}
