//! What an IMU sent, as it was received: bytes of a serial line, frames of a CAN bus, reports of a USB device.

use std::path::PathBuf;
use std::time::Duration;

use lsfb_drivers::transport::can::{CanFrame, CanSender};
use lsfb_drivers::transport::usb::MockUsb;
use lsfb_drivers::xsens::model::SAMPLE_TIME_FINE_NS;
use lsfb_drivers::xsens::{Decoder, DecoderConfig};
use lsfb_drivers::{ImuFamily, microstrain, mynt_d, sbg};
use lsfb_recording::{RecordedPacket, Recording};
use lsfb_types::{Packet, Timestamp};

use super::{Play, PlaybackEndpoints, readable};
use crate::device::clock::{SimClock, Turn};
use crate::device::host;
use crate::device::inertial::InertialDevice;
use crate::device::session::SessionReport;
use crate::{Error, SimulatedImu};

/// How often it is looked whether there is a host.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// Where the samples are.
pub(super) const SAMPLES_TOPIC: &str = "/imu0/data_raw";
pub(super) const SOURCE: &str = "imu0";
/// The counter of the fine sample time wraps here.
const TICKS_PERIOD: i64 = 1 << 32;
/// Samples that the rate is told by.
const RATE_SAMPLES: usize = 101;

/// What the recorded unit speaks; `None` without one, or where nobody knows its packets.
pub(super) fn family(recording: &Recording) -> Option<ImuFamily> {
    let first = recording.packets(SOURCE).ok()?.next()?.ok()?;
    let mut known = ImuFamily::ALL.into_iter();
    known.find(|family| family.raw_kind() == first.kind)
}

/// A unit and its end of the line, of the bus, or of the cable.
pub(super) enum PlayedUnit {
    Serial(InertialDevice),
    Can { bus: CanSender, interface: String },
    Usb(MockUsb),
}

impl PlayedUnit {
    pub(super) fn new(
        family: ImuFamily,
        rate_hz: u16,
        endpoints: &PlaybackEndpoints,
    ) -> Result<Self, Error> {
        let serial = |unit| InertialDevice::new(unit, rate_hz).map(Self::Serial);
        Ok(match family {
            ImuFamily::Xsens => serial(SimulatedImu::Xsens)?,
            ImuFamily::Microstrain => serial(SimulatedImu::Microstrain)?,
            ImuFamily::Sbg => Self::Can {
                bus: CanSender::open(&endpoints.can)?,
                interface: endpoints.can.clone(),
            },
            ImuFamily::MyntD => Self::Usb(MockUsb::bind(
                &endpoints.usb,
                mynt_d::model::USB_VENDOR,
                mynt_d::model::USB_PRODUCT,
            )?),
        })
    }

    /// The serial line that the host opens; the others are where they were told to be.
    pub(super) fn line(&self) -> Option<PathBuf> {
        match self {
            Self::Serial(unit) => Some(unit.path()),
            Self::Can { .. } | Self::Usb(_) => None,
        }
    }

    /// Waits for the host. `false`: the session was stopped before.
    fn configure(&mut self, rate_hz: u16, clock: &SimClock) -> Result<bool, Error> {
        loop {
            let is_there = match self {
                Self::Serial(unit) => return unit.configure(rate_hz, clock),
                Self::Can { interface, .. } => host::listens_on_can(interface),
                Self::Usb(unit) => unit.accept(LOOK_EVERY)?,
            };
            if is_there || clock.is_stopped() {
                return Ok(is_there);
            }
            std::thread::sleep(LOOK_EVERY);
        }
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), Error> {
        match self {
            Self::Serial(unit) => unit.send(bytes),
            // Errors of the bus were told by the kernel: no device can send them.
            Self::Can { bus, .. } => match CanFrame::parse(bytes) {
                Ok(frame) if !frame.is_error() => Ok(bus.send(&frame)?),
                _ => Ok(()),
            },
            Self::Usb(unit) => Ok(unit.send(bytes)?),
        }
    }

    /// Hangs up once the host has, or can have, read everything. A bus stays.
    fn finish(self) -> Result<(), Error> {
        match self {
            Self::Serial(unit) => unit.finish(),
            Self::Can { .. } => Ok(()),
            Self::Usb(unit) => Ok(unit.finish()?),
        }
    }
}

/// Samples per second, from the first of them; 200 where there are none.
pub(super) fn rate_hz(recording: &Recording) -> u16 {
    let times: Vec<Timestamp> = recording
        .messages(SAMPLES_TOPIC)
        .into_iter()
        .flatten()
        .filter_map(Result::ok)
        .take(RATE_SAMPLES)
        .map(|m| m.time)
        .collect();
    let mut steps: Vec<i64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_unstable();
    match steps.get(steps.len() / 2) {
        Some(&step) if step > 0 => (1e9 / step as f64).round().clamp(1.0, 10_000.0) as u16,
        _ => 200,
    }
}

/// Waits for the host to configure the unit, then sends the stream.
pub(super) fn run(
    family: ImuFamily,
    mut unit: PlayedUnit,
    rate_hz: u16,
    play: &Play,
    clock: &SimClock,
    device: usize,
) -> Result<SessionReport, Error> {
    let mut report = SessionReport::default();
    if !unit.configure(rate_hz, clock)? {
        return Ok(report);
    }
    let recording = play.recording()?;
    for base_ns in play.turns() {
        let mut unreadable = SessionReport::default();
        let by_ticks = |counter| Schedule::ByTicks(PacketTicks::new(&recording, counter));
        let mut schedule = match family {
            ImuFamily::Xsens => Schedule::ByTime(PacketTimes::new(&recording, play.start)),
            ImuFamily::Microstrain => by_ticks(Counter::Microstrain(Default::default())),
            ImuFamily::Sbg => by_ticks(Counter::Sbg(Default::default())),
            ImuFamily::MyntD => by_ticks(Counter::MyntD(Default::default())),
        };
        for packet in readable(recording.packets(SOURCE)?, &mut unreadable) {
            let due_ns = base_ns + schedule.offset_ns(play, &packet);
            if clock.reach(device, due_ns) == Turn::Stop {
                return Ok(report);
            }
            unit.send(&packet.packet.bytes)?;
            report.imu_packets += 1;
        }
        report.unreadable += unreadable.unreadable;
    }
    // The clock must not wait for this one while the line is read out.
    clock.finish(device);
    unit.finish()?;
    Ok(report)
}

/// When the pieces of the stream are due.
enum Schedule {
    ByTime(PacketTimes),
    ByTicks(PacketTicks),
}

impl Schedule {
    fn offset_ns(&mut self, play: &Play, packet: &RecordedPacket) -> i64 {
        match self {
            Self::ByTime(times) => play.offset_ns(times.of(packet)),
            Self::ByTicks(ticks) => ticks.offset_ns(packet),
        }
    }
}

/// What a unit that knows no time but its own counts.
enum Counter {
    Microstrain(microstrain::Decoder),
    Sbg(sbg::Decoder),
    MyntD(mynt_d::Decoder),
}

impl Counter {
    /// Of the last reading that a packet ends, nanoseconds.
    fn last_ns(&mut self, packet: &Packet) -> Option<u64> {
        match self {
            Self::Microstrain(decoder) => {
                decoder.push(packet);
                std::iter::from_fn(|| decoder.next_reading())
                    .last()
                    .map(|reading| reading.device_ticks)
            }
            Self::Sbg(decoder) => {
                let reading = decoder.push(packet).ok().flatten()?;
                Some(reading.device_ticks.saturating_mul(1_000))
            }
            Self::MyntD(decoder) => {
                // The readings before a damaged part are good.
                let _ = decoder.push(packet);
                std::iter::from_fn(|| decoder.next_reading())
                    .last()
                    .map(|reading| reading.device_ticks.saturating_mul(mynt_d::model::TICK_NS))
            }
        }
    }
}

/// The first of the unit's packets is due as long after the beginning as it arrived, the others by its counter.
struct PacketTicks {
    counter: Counter,
    began: Option<Timestamp>,
    first: Option<FirstPacket>,
    last_ns: i64,
}

struct FirstPacket {
    counted_ns: u64,
    offset_ns: i64,
}

impl PacketTicks {
    fn new(recording: &Recording, counter: Counter) -> Self {
        Self {
            counter,
            began: recording.arrival_range().map(|range| range.start),
            first: None,
            last_ns: 0,
        }
    }

    /// Of the last reading in a piece; that of the piece before where it ends none.
    fn offset_ns(&mut self, packet: &RecordedPacket) -> i64 {
        let Some(counted_ns) = self.counter.last_ns(&packet.packet) else {
            return self.last_ns;
        };
        let arrival = packet.packet.arrival;
        let first = self.first.get_or_insert_with(|| FirstPacket {
            counted_ns,
            offset_ns: self.began.map_or(0, |began| (arrival - began).max(0)),
        });
        // A unit that began anew goes on where it was.
        let past_ns = counted_ns
            .saturating_sub(first.counted_ns)
            .cast_signed()
            .max(0);
        self.last_ns = self.last_ns.max(first.offset_ns.saturating_add(past_ns));
        self.last_ns
    }
}

/// When the samples in each piece of the stream were taken.
struct PacketTimes {
    decoder: Decoder,
    /// A sample whose time and counter are known.
    known: Option<(Timestamp, u64)>,
    last: Timestamp,
}

impl PacketTimes {
    fn new(recording: &Recording, start: Timestamp) -> Self {
        let first = recording.imu().into_iter().flatten().find_map(Result::ok);
        Self {
            decoder: Decoder::new(DecoderConfig::default()),
            known: first.map(|s| (s.time, s.device_ticks)),
            last: start,
        }
    }

    /// Time of the last sample in it; that of the piece before where it ends none.
    fn of(&mut self, packet: &RecordedPacket) -> Timestamp {
        self.decoder.push(&packet.packet);
        let readings = std::iter::from_fn(|| self.decoder.next_reading());
        if let Some(reading) = readings.last() {
            self.last = match (reading.sample.utc_ns, self.known) {
                (Some(utc_ns), _) => Timestamp::from_nanos(utc_ns),
                (None, Some((time, ticks))) => {
                    let past = reading.device_ticks.wrapping_sub(ticks).cast_signed();
                    let past_ns = past.rem_euclid(TICKS_PERIOD) * SAMPLE_TIME_FINE_NS.cast_signed();
                    time.plus_nanos(past_ns)
                }
                (None, None) => self.last,
            };
        }
        self.last
    }
}
