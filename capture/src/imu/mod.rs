//! An IMU's thread: packets → readings → samples on the recording's clock.

mod unit;

use std::borrow::Cow;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use lsfb_drivers::ImuFamily;
use lsfb_types::{ImuSample, Packet, Stamped, Timestamp};

use crate::clock::model_topic::{self, ModelTopic};
use crate::clock::{OneWayClock, Unwrap};
use crate::config::ImuLineConfig;
use crate::control::Control;
use crate::device_note::DeviceNote;
use crate::health::{Ending, Expected, Meter, Repeats, StreamReport};
use crate::recorder::{Entry, RecorderSender, WriterGone};

pub(crate) use unit::ImuUnit;
use unit::{ImuDecoder, Reading};

/// After all other devices have ended, a unit on a bus that is silent for this long has ended too.
const SILENT: Duration = Duration::from_millis(500);
/// What it sends all the time.
const SAMPLES: &str = "samples";
/// Problem of a unit that sends nothing new.
const SAME_SAMPLE: &str = "it keeps sending the same sample: restart it";

/// What a unit sends all the time; only some are told how often.
pub(crate) fn expected(line: &ImuLineConfig) -> Vec<Expected> {
    vec![Expected::required(SAMPLES, told_hz(line))]
}

fn told_hz(line: &ImuLineConfig) -> Option<f64> {
    let is_told = matches!(line.family, ImuFamily::Xsens | ImuFamily::Microstrain);
    is_told.then(|| line.rate_hz.into())
}

/// Says in the recording what the units are.
pub(crate) fn introduce(lines: &[ImuLineConfig], to_recorder: &RecorderSender) {
    for line in lines {
        let mut note = DeviceNote::new(&line.name).with("family", line.family.key());
        if let Some(rate_hz) = told_hz(line) {
            note = note.with_rate_hz(rate_hz);
        }
        // A writer that is gone reports itself.
        let _ = to_recorder
            .waiting()
            .put(Entry::Device(note), &mut StreamReport::default());
    }
}

struct Clock {
    unwrap: Unwrap,
    counter: unit::Counter,
    one_way: OneWayClock,
    model: ModelTopic,
    without_utc: u64,
}

impl Clock {
    fn new(name: &str, family: ImuFamily) -> Self {
        let counter = unit::Counter::of(family);
        Self {
            unwrap: Unwrap::default(),
            counter,
            one_way: OneWayClock::ticking(counter.tick_ns),
            model: ModelTopic::new(name, counter.tick_ns, counter.period_ticks.cast_unsigned()),
            without_utc: 0,
        }
    }

    fn time(&mut self, reading: &Reading) -> Timed {
        let ticks = i64::try_from(reading.device_ticks).unwrap_or(i64::MAX);
        let ticks = match self.counter.period_ticks {
            0 => ticks,
            period => self.unwrap.unwrap(ticks, period),
        };
        let device_ns = ticks.saturating_mul(self.counter.tick_ns.cast_signed());
        if let Some(time) = reading.utc {
            return Timed {
                time,
                how: Some(model_topic::Reading::Locked {
                    device_ns,
                    time,
                    epoch: 1,
                }),
            };
        }
        self.without_utc += 1;
        self.one_way.push(device_ns, reading.arrival);
        Timed {
            time: self.one_way.time(device_ns),
            how: self.one_way.estimate().map(model_topic::Reading::Fitted),
        }
    }
}

/// A reading's time, and where it comes from.
struct Timed {
    time: Timestamp,
    how: Option<model_topic::Reading>,
}

/// A unit that can be opened again.
pub(crate) struct Line {
    pub(crate) unit: ImuUnit,
    pub(crate) config: ImuLineConfig,
}

/// Records until the unit ends or the session stops. A unit that goes away may come back.
pub(crate) fn record(
    mut line: Line,
    to_recorder: &RecorderSender,
    control: &Control,
    meter: &Meter,
) -> StreamReport {
    let mut stream = ImuStream::new(&line.config, meter);
    let is_silent_at_its_end = line.config.family == ImuFamily::Sbg;
    let mut last_heard = Instant::now();
    stream.report.ending = loop {
        match line.unit.recv(Duration::from_millis(50)) {
            Ok(Some(packet)) => {
                last_heard = Instant::now();
                let arrival = packet.arrival;
                let before = stream.report.decoded;
                let put = stream.packet(packet, to_recorder, meter);
                if put.is_err() {
                    break Ending::Stopped;
                }
                stream.take_counters(line.unit.kernel_drops());
                meter.heard(&stream.report, arrival);
                control
                    .progress
                    .imu_samples
                    .fetch_add(stream.report.decoded - before, Ordering::Relaxed);
            }
            Ok(None) if control.is_stopping() => break Ending::Stopped,
            Ok(None)
                if is_silent_at_its_end
                    && control.only_one_is_left()
                    && last_heard.elapsed() > SILENT =>
            {
                break Ending::EndOfStream;
            }
            Ok(None) => meter.looked(),
            Err(lsfb_drivers::Error::EndOfStream { .. }) => break Ending::EndOfStream,
            Err(error) => {
                let reopen = || ImuUnit::open(&line.config);
                match control.reopen(&mut stream.report, meter, reopen) {
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
    let _ = stream.rest(to_recorder, meter);
    stream.finish(line.unit.kernel_drops())
}

pub(crate) struct ImuStream {
    name: String,
    family: ImuFamily,
    decoder: ImuDecoder,
    clock: Clock,
    report: StreamReport,
    /// Sensors have noise: even at rest they do not measure the same for a second.
    samples: Repeats<ImuSample>,
}

impl ImuStream {
    pub(crate) fn new(config: &ImuLineConfig, meter: &Meter) -> Self {
        let family = config.family;
        Self {
            name: config.name.clone(),
            family,
            decoder: ImuDecoder::new(family),
            clock: Clock::new(&config.name, family),
            report: meter.report(),
            samples: Repeats::default(),
        }
    }

    /// Takes a packet: its bytes are recorded, and what they say.
    pub(crate) fn packet(
        &mut self,
        packet: Packet,
        to_recorder: &RecorderSender,
        meter: &Meter,
    ) -> Result<(), WriterGone> {
        let readings = self.decoder.push(&packet);
        let time = packet.arrival;
        let raw = Entry::Raw {
            source: self.name.clone(),
            kind: self.family.raw_kind(),
            sequence: self.report.received,
            packet,
            time,
        };
        self.report.received += 1;
        to_recorder.put(raw, &mut self.report)?;
        self.put(readings, to_recorder, meter)
    }

    /// What the decoder still holds at the end.
    pub(crate) fn rest(
        &mut self,
        to_recorder: &RecorderSender,
        meter: &Meter,
    ) -> Result<(), WriterGone> {
        let readings = self.decoder.finish();
        self.put(readings, to_recorder, meter)
    }

    fn put(
        &mut self,
        readings: Vec<Reading>,
        to_recorder: &RecorderSender,
        meter: &Meter,
    ) -> Result<(), WriterGone> {
        for reading in readings {
            let Timed { time, how } = self.clock.time(&reading);
            if let Some(celsius) = reading.temperature_celsius {
                meter.set_temperature(celsius);
            }
            if let Some(how) = how
                && self.clock.model.is_due(&how, reading.arrival)
            {
                meter.set_sync(how.sync_state(), how.steps());
                let model = self.clock.model.entry(&how, time, reading.arrival);
                to_recorder.put(model, &mut self.report)?;
            }
            let Some(sample) = reading.sample else {
                continue;
            };
            self.report.decoded += 1;
            meter.heard_part(SAMPLES, 1);
            self.samples.note(sample, reading.arrival);
            self.report.stale = self.samples.stale().stretches();
            let is_same = self.samples.stale().is_problem();
            meter.set_stale(is_same.then_some(Cow::Borrowed(SAME_SAMPLE)));
            let sample = Stamped {
                time,
                arrival: reading.arrival,
                device_ticks: reading.device_ticks,
                sample,
            };
            let entry = Entry::Imu {
                imu: self.name.clone(),
                sample,
            };
            to_recorder.put(entry, &mut self.report)?;
        }
        Ok(())
    }

    /// What the kernel dropped is among the missing where the unit counts, and is missing where it does not.
    fn take_counters(&mut self, kernel_drops: u64) {
        let tally = self.decoder.tally();
        self.report.bad = tally.bad;
        self.report.missing = tally.missing.max(u64::from(kernel_drops > 0));
        self.report.duplicated = tally.duplicated;
    }

    pub(crate) fn finish(mut self, kernel_drops: u64) -> StreamReport {
        self.take_counters(kernel_drops);
        let without_utc = (
            self.clock.without_utc,
            "samples without UTC: their time is estimated from arrivals",
        );
        let drops = (
            kernel_drops,
            "frames dropped by the kernel because they were not read in time",
        );
        let stale = (
            self.report.stale,
            "stretches of the same sample for more than a second",
        );
        let remarks = self.decoder.tally().remarks;
        for (count, what) in remarks.into_iter().chain([without_utc, drops, stale]) {
            if count > 0 {
                self.report.notes.push(format!("{count} {what}"));
            }
        }
        self.report
    }
}
