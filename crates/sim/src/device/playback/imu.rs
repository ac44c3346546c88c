//! The byte stream of an Xsens IMU, as it was received.

use lsfb_drivers::imu::model::SAMPLE_TIME_FINE_NS;
use lsfb_drivers::imu::{Decoder, DecoderConfig};
use lsfb_recording::{RecordedPacket, Recording};
use lsfb_types::Timestamp;

use super::{Play, readable};
use crate::Error;
use crate::device::clock::{SimClock, Turn};
use crate::device::imu::ImuDevice;
use crate::device::session::SessionReport;

/// Where the samples are.
pub(super) const SAMPLES_TOPIC: &str = "/imu0/data_raw";
pub(super) const SOURCE: &str = "imu0";
/// The counter of the fine sample time wraps here.
const TICKS_PERIOD: i64 = 1 << 32;
/// Samples that the rate is told by.
const RATE_SAMPLES: usize = 101;

/// Kind of the packets that are pieces of an Xsens unit's stream.
const XSENS_KIND: u16 = 0;

/// Whether the recorded unit is one that can be played: an Xsens unit on a serial line.
pub(super) fn is_playable(recording: &Recording) -> bool {
    let first = recording.packets(SOURCE).ok().and_then(|mut p| p.next());
    first.is_some_and(|packet| packet.is_ok_and(|packet| packet.kind == XSENS_KIND))
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
    mut unit: ImuDevice,
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
        let mut times = PacketTimes::new(&recording, play.start);
        for packet in readable(recording.packets(SOURCE)?, &mut unreadable) {
            let due_ns = base_ns + play.offset_ns(times.of(&packet));
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
