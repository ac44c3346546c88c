//! The byte stream of an IMU on a serial line, as it was received.

use lsfb_drivers::imu::model::SAMPLE_TIME_FINE_NS;
use lsfb_drivers::imu::{Decoder, DecoderConfig};
use lsfb_drivers::microstrain;
use lsfb_recording::{RecordedPacket, Recording};
use lsfb_types::Timestamp;

use super::{Play, readable};
use crate::device::clock::{SimClock, Turn};
use crate::device::inertial::InertialDevice;
use crate::device::session::SessionReport;
use crate::{Error, ImuFamily};

/// Where the samples are.
pub(super) const SAMPLES_TOPIC: &str = "/imu0/data_raw";
pub(super) const SOURCE: &str = "imu0";
/// The counter of the fine sample time wraps here.
const TICKS_PERIOD: i64 = 1 << 32;
/// Samples that the rate is told by.
const RATE_SAMPLES: usize = 101;

/// Kinds of the packets that are pieces of a unit's stream, by what the unit speaks.
const KINDS: [(u16, ImuFamily); 2] = [(0, ImuFamily::Xsens), (1, ImuFamily::Microstrain)];

/// What the recorded unit speaks; `None` without one, or where it is none on a serial line.
pub(super) fn family(recording: &Recording) -> Option<ImuFamily> {
    let first = recording.packets(SOURCE).ok()?.next()?.ok()?;
    let found = KINDS.into_iter().find(|(kind, _)| *kind == first.kind);
    found.map(|(_, family)| family)
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
    mut unit: InertialDevice,
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
        let mut schedule = match unit {
            InertialDevice::Xsens(_) => Schedule::ByTime(PacketTimes::new(&recording, play.start)),
            InertialDevice::Microstrain(_) => Schedule::ByTicks(PacketTicks::new(&recording)),
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

/// A unit that knows no time but its own: the first of its packets is due as long after the beginning as it arrived, the
/// others by the unit's counter.
struct PacketTicks {
    decoder: microstrain::Decoder,
    began: Option<Timestamp>,
    first: Option<FirstPacket>,
    last_ns: i64,
}

struct FirstPacket {
    ticks: u64,
    offset_ns: i64,
}

impl PacketTicks {
    fn new(recording: &Recording) -> Self {
        Self {
            decoder: microstrain::Decoder::new(),
            began: recording.arrival_range().map(|range| range.start),
            first: None,
            last_ns: 0,
        }
    }

    /// Of the last reading in a piece; that of the piece before where it ends none.
    fn offset_ns(&mut self, packet: &RecordedPacket) -> i64 {
        self.decoder.push(&packet.packet);
        let readings = std::iter::from_fn(|| self.decoder.next_reading());
        let Some(ticks) = readings.last().map(|r| r.device_ticks) else {
            return self.last_ns;
        };
        let arrival = packet.packet.arrival;
        let first = self.first.get_or_insert_with(|| FirstPacket {
            ticks,
            offset_ns: self.began.map_or(0, |began| (arrival - began).max(0)),
        });
        // A unit that began anew goes on where it was.
        let past_ns = ticks.saturating_sub(first.ticks).cast_signed().max(0);
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
