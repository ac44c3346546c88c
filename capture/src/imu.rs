//! The IMU's thread: bytes → readings → samples on the recording's clock.

use std::sync::atomic::Ordering;
use std::time::Duration;

use lsfb_drivers::Decoded;
use lsfb_drivers::imu::model::SAMPLE_TIME_FINE_NS;
use lsfb_drivers::imu::{Decoder, DecoderConfig, ImuConfig, ImuReading, XsensImu};
use lsfb_drivers::transport::PacketSource;
use lsfb_types::{Stamped, Timestamp};

use crate::clock::model_topic::{ModelTopic, Reading};
use crate::clock::{OneWayClock, Unwrap};
use crate::health::{Ending, Meter, StreamReport};
use crate::recorder::{Entry, Inlet, WriterGone};
use crate::session::Control;

/// Name of the backpack's IMU in topics.
pub(crate) const IMU: &str = "imu0";
/// `SampleTimeFine` wraps at 2³² ticks.
const TICKS_PERIOD: i64 = 1 << 32;

struct Clock {
    unwrap: Unwrap,
    one_way: OneWayClock,
    model: ModelTopic,
    without_utc: u64,
}

impl Clock {
    fn new() -> Self {
        Self {
            unwrap: Unwrap::default(),
            one_way: OneWayClock::default(),
            model: ModelTopic::new(IMU, SAMPLE_TIME_FINE_NS, TICKS_PERIOD.cast_unsigned()),
            without_utc: 0,
        }
    }

    fn time(&mut self, reading: &Decoded<ImuReading>) -> Timed {
        let ticks = self
            .unwrap
            .unwrap(reading.device_ticks.cast_signed(), TICKS_PERIOD);
        let device_ns = ticks.saturating_mul(SAMPLE_TIME_FINE_NS.cast_signed());
        if let Some(utc_ns) = reading.sample.utc_ns {
            let time = Timestamp::from_nanos(utc_ns);
            return Timed {
                time,
                reading: Some(Reading::Locked { device_ns, time }),
            };
        }
        self.without_utc += 1;
        self.one_way.push(device_ns, reading.arrival);
        Timed {
            time: self.one_way.time(device_ns),
            reading: self.one_way.estimate().map(Reading::Fitted),
        }
    }
}

/// A sample's time, and where it comes from.
struct Timed {
    time: Timestamp,
    reading: Option<Reading>,
}

/// A line that can be opened again.
pub(crate) struct Line {
    pub(crate) unit: XsensImu,
    pub(crate) open: ImuConfig,
}

/// Records until the line ends or the session stops. A unit that goes away may come back.
pub(crate) fn record(
    mut line: Line,
    inlet: &Inlet,
    control: &Control,
    meter: &Meter,
) -> StreamReport {
    let mut report = meter.report();
    let mut decoder = Decoder::new(DecoderConfig::default());
    let mut clock = Clock::new();
    report.ending = loop {
        match line.unit.recv(Duration::from_millis(50)) {
            Ok(Some(packet)) => {
                decoder.push(&packet);
                let readings = std::iter::from_fn(|| decoder.next_reading()).collect::<Vec<_>>();
                let time = packet.arrival;
                let raw = Entry::Raw {
                    source: IMU.to_owned(),
                    sequence: report.received,
                    packet,
                    time,
                };
                report.received += 1;
                if inlet
                    .put(raw, &mut report)
                    .and_then(|()| put(readings, &mut clock, inlet, &mut report, meter))
                    .is_err()
                {
                    break Ending::Stopped;
                }
                take_counters(&mut report, &decoder);
                meter.heard(&report);
                control
                    .progress
                    .imu_samples
                    .store(report.decoded, Ordering::Relaxed);
            }
            Ok(None) if control.is_stopping() => break Ending::Stopped,
            Ok(None) => {}
            Err(lsfb_drivers::Error::EndOfStream { .. }) => break Ending::EndOfStream,
            Err(error) => {
                let reopen = || XsensImu::open(&line.open);
                match control.reopen(&mut report, meter, reopen) {
                    Some(unit) => line.unit = unit,
                    None => break Ending::Lost(error.to_string()),
                }
            }
        }
        if control.is_stopping() {
            break Ending::Stopped;
        }
    };
    // A failed writer reports itself.
    let _ = put(decoder.finish(), &mut clock, inlet, &mut report, meter);
    take_counters(&mut report, &decoder);
    let counters = decoder.counters();
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

fn take_counters(report: &mut StreamReport, decoder: &Decoder) {
    let counters = decoder.counters();
    report.bad = counters.bad_checksums + counters.bad_items;
    report.missing = counters.missing;
    report.duplicated = counters.duplicated;
}

fn put(
    readings: Vec<Decoded<ImuReading>>,
    clock: &mut Clock,
    inlet: &Inlet,
    report: &mut StreamReport,
    meter: &Meter,
) -> Result<(), WriterGone> {
    for reading in readings {
        let Timed { time, reading: how } = clock.time(&reading);
        if let Some(celsius) = reading.sample.temperature_celsius {
            meter.set_temperature(celsius);
        }
        if let Some(how) = how
            && clock.model.is_due(reading.arrival)
        {
            meter.set_sync(how.sync_state());
            inlet.put(clock.model.entry(&how, time, reading.arrival), report)?;
        }
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
        let entry = Entry::Imu {
            imu: IMU.to_owned(),
            sample,
        };
        inlet.put(entry, report)?;
    }
    Ok(())
}
