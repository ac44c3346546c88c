//! The IMU's thread: bytes → readings → samples on the recording's clock.

use std::sync::atomic::Ordering;
use std::time::Duration;

use lsfb_drivers::Decoded;
use lsfb_drivers::imu::{Decoder, DecoderConfig, ImuReading};
use lsfb_drivers::transport::PacketSource;
use lsfb_types::{Stamped, Timestamp};

use crate::clock::{OneWayClock, Unwrap};
use crate::health::{Ending, StreamReport};
use crate::recorder::{Entry, Inlet, WriterGone};
use crate::session::Control;

/// Name of the backpack's IMU in topics.
const IMU: &str = "imu0";
/// `SampleTimeFine` wraps at 2³² ticks.
const TICKS_PERIOD: i64 = 1 << 32;

#[derive(Default)]
struct Clock {
    unwrap: Unwrap,
    one_way: OneWayClock,
    without_utc: u64,
}

impl Clock {
    fn time(&mut self, reading: &Decoded<ImuReading>) -> Timestamp {
        if let Some(utc_ns) = reading.sample.utc_ns {
            return Timestamp::from_nanos(utc_ns);
        }
        self.without_utc += 1;
        let ticks = self
            .unwrap
            .unwrap(reading.device_ticks.cast_signed(), TICKS_PERIOD);
        let device_ns = ticks * lsfb_drivers::imu::model::SAMPLE_TIME_FINE_NS.cast_signed();
        self.one_way.push(device_ns, reading.arrival);
        self.one_way.time(device_ns)
    }
}

/// Records until the line ends or the session stops.
pub(crate) fn record(
    mut source: impl PacketSource,
    inlet: &Inlet,
    control: &Control,
) -> StreamReport {
    let mut report = StreamReport::new(IMU);
    let mut decoder = Decoder::new(DecoderConfig::default());
    let mut clock = Clock::default();
    let mut sequence = 0;
    report.ending = loop {
        match source.recv(Duration::from_millis(50)) {
            Ok(Some(packet)) => {
                decoder.push(&packet);
                let readings = std::iter::from_fn(|| decoder.next_reading()).collect::<Vec<_>>();
                let time = packet.arrival;
                let raw = Entry::Raw {
                    source: IMU,
                    sequence,
                    packet,
                    time,
                };
                sequence += 1;
                let counters = decoder.counters();
                report.received = sequence;
                report.bad = counters.bad_checksums + counters.bad_items;
                report.missing = counters.missing;
                if inlet
                    .put(raw, &mut report)
                    .and_then(|()| put(readings, &mut clock, inlet, &mut report))
                    .is_err()
                {
                    break Ending::Stopped;
                }
                control
                    .progress
                    .imu_samples
                    .store(report.decoded, Ordering::Relaxed);
            }
            Ok(None) if control.is_stopping() => break Ending::Stopped,
            Ok(None) => {}
            Err(lsfb_drivers::Error::EndOfStream { .. }) => break Ending::EndOfStream,
            Err(error) => break Ending::Lost(error.to_string()),
        }
        if control.is_stopping() {
            break Ending::Stopped;
        }
    };
    // A failed writer reports itself.
    let _ = put(decoder.finish(), &mut clock, inlet, &mut report);
    let counters = decoder.counters();
    report.received = sequence;
    report.bad = counters.bad_checksums + counters.bad_items;
    report.missing = counters.missing;
    report.duplicated = counters.duplicated;
    if counters.skipped_bytes > 0 {
        report.notes.push(format!(
            "{} bytes belong to no message",
            counters.skipped_bytes
        ));
    }
    if counters.device_errors > 0 {
        report.notes.push(format!(
            "the unit reported {} errors",
            counters.device_errors
        ));
    }
    if clock.without_utc > 0 {
        report.notes.push(format!(
            "{} samples without UTC: their time is fitted to arrival",
            clock.without_utc
        ));
    }
    report
}

fn put(
    readings: Vec<Decoded<ImuReading>>,
    clock: &mut Clock,
    inlet: &Inlet,
    report: &mut StreamReport,
) -> Result<(), WriterGone> {
    for reading in readings {
        let time = clock.time(&reading);
        let Some(sample) = reading.sample.sample else {
            continue;
        };
        report.decoded += 1;
        let sample = Stamped {
            time,
            arrival: reading.arrival,
            device_ticks: reading.device_ticks,
            sample,
        };
        inlet.put(Entry::Imu { imu: IMU, sample }, report)?;
    }
    Ok(())
}
