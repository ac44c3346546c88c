//! A camera unit's thread: frames → images on the recording's clock, and the samples of the unit's own IMU.

use std::borrow::Cow;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use lsfb_drivers::Decoded;
use lsfb_drivers::mynt_s::model::TRAILER_BYTES;
use lsfb_drivers::mynt_s::wire::{ImuProtocol, TimeSource};
use lsfb_drivers::mynt_s::{Decoder, ImuDecoder, MyntCamera, UnitFrame};
use lsfb_drivers::transport::PacketSource;
use lsfb_recording::{Attachment, CameraUnit, KeptFile};
use lsfb_types::{Image, ImuSample, Packet, Stamped, Timestamp};

use crate::clock::OneWayClock;
use crate::clock::model_topic::{ModelTopic, Reading};
use crate::config::CameraUnitConfig;
use crate::control::Control;
use crate::grey::{is_black, saturated_share, some_pixels};
use crate::health::{Ending, Expected, Meter, Repeats, StreamReport};
use crate::recorder::{Entry, RecorderSender, WriterGone};

/// What it sends all the time, beside the samples of its IMU, which are called as that is.
const IMAGES: &str = "images";
/// The unit's counter, in nanoseconds.
const TICK_NS: u64 = 1_000;
/// The unit keeps some 50 ms of IMU segments.
const IMU_PERIOD: Duration = Duration::from_millis(25);
/// Problems of a unit that sends nothing new.
const SAME_IMAGE: &str =
    "keeps sending the same image: is the lens covered, or did the camera freeze?";
const BLACK: &str = "images are black: is the lens cap on, or the exposure too short?";
const SAME_SAMPLE: &str = "the IMU keeps sending the same sample: restart it";
/// Samples of the IMU before the first frame that are kept until it comes: some seconds.
const MOST_EARLY_SAMPLES: usize = 4_096;

/// What a unit sends all the time.
pub(crate) fn expected(unit: &CameraUnitConfig) -> Vec<Expected> {
    let images = Expected::required(IMAGES, Some(unit.rate_hz.into()));
    let imu = unit.imu.as_ref().map(|name| Expected::required(name, None));
    std::iter::once(images).chain(imu).collect()
}

/// A unit that can be opened again.
pub(crate) struct Unit {
    pub(crate) camera: MyntCamera,
    pub(crate) config: CameraUnitConfig,
}

/// Tells the recording which cameras share a unit, and what the units say about themselves.
pub(crate) fn introduce(units: &[Unit], to_recorder: &RecorderSender) {
    if units.is_empty() {
        return;
    }
    let mut attachments = Vec::new();
    let mut listed = Vec::new();
    for Unit { camera, config } in units {
        let first = config.names.first().map_or("", String::as_str);
        let kept = camera.files().iter().map(|(file, answer)| {
            let attachment = format!("unit/{first}/{}.bin", file.id());
            attachments.push(Attachment {
                name: attachment.clone(),
                media_type: "application/octet-stream".to_owned(),
                bytes: answer.clone(),
            });
            KeptFile {
                id: file.id(),
                attachment,
            }
        });
        listed.push(CameraUnit {
            files: kept.collect(),
            cameras: config.names.clone(),
            frame_px: config.frame_px,
            rate_hz: config.rate_hz,
            imu: config.imu.clone(),
        });
    }
    attachments.push(CameraUnit::attachment(&listed));
    for attachment in attachments {
        // A writer that is gone reports itself.
        let _ = to_recorder
            .waiting()
            .put(Entry::Attachment(attachment), &mut StreamReport::default());
    }
}

/// Records until the unit ends or the session stops. A unit that goes away may come back.
pub(crate) fn record(
    mut unit: Unit,
    to_recorder: &RecorderSender,
    control: &Control,
    meter: &Meter,
) -> StreamReport {
    let protocol = unit.camera.imu_protocol();
    let mut stream = CameraStream::new(&unit.config, Some(protocol), meter);
    stream.report.ending = loop {
        match unit.camera.recv(stream.patience()) {
            Ok(Some(packet)) => {
                if stream.frame(&packet, to_recorder, control, meter).is_err() {
                    break Ending::Stopped;
                }
            }
            Ok(None) => meter.looked(),
            Err(lsfb_drivers::Error::EndOfStream { .. }) => break Ending::EndOfStream,
            Err(error) => {
                let reopen = || MyntCamera::open(&unit.config.open());
                match control.reopen(&mut stream.report, meter, reopen) {
                    Some(camera) => unit.camera = camera,
                    None => break Ending::Lost(error.to_string()),
                }
            }
        }
        if stream
            .poll_imu(&mut unit.camera, to_recorder, meter)
            .is_err()
            || control.is_stopping()
        {
            break Ending::Stopped;
        }
    };
    stream.finish()
}

pub(crate) struct CameraStream {
    names: Vec<String>,
    decoder: Decoder,
    clock: OneWayClock,
    models: Vec<ModelTopic>,
    imu: Option<UnitImu>,
    report: StreamReport,
    free_running: u64,
    /// Some pixels of each camera's images: one that is frozen is not hidden by the others of its unit.
    images: Vec<Repeats<Vec<u8>>>,
    /// Whether one of them is frozen, and how often that began.
    is_frozen: bool,
    frozen: u64,
    /// Images of each that showed nothing.
    black: Vec<u64>,
}

/// The unit's own IMU; its counter is the unit's.
struct UnitImu {
    name: String,
    decoder: ImuDecoder,
    polled: Instant,
    answers: u64,
    unanswered: u64,
    /// Polls without answer of which it is not known yet whether the unit is still there.
    unsettled: u64,
    model: ModelTopic,
    /// Whether frames carry external time, and the IMU's segments with them; unknown before the first frame.
    external: Option<bool>,
    /// Samples that wait until that is known.
    early: Vec<Decoded<ImuSample>>,
    samples: Repeats<ImuSample>,
}

impl CameraStream {
    /// `protocol`: how the unit speaks of its IMU; without one that is not asked.
    pub(crate) fn new(
        unit: &CameraUnitConfig,
        protocol: Option<ImuProtocol>,
        meter: &Meter,
    ) -> Self {
        let names = unit.names.clone();
        let imu = unit.imu.as_ref().zip(protocol);
        let imu = imu.map(|(name, protocol)| UnitImu {
            name: name.clone(),
            decoder: ImuDecoder::new(protocol),
            polled: Instant::now(),
            answers: 0,
            unanswered: 0,
            unsettled: 0,
            model: ModelTopic::new(name, TICK_NS, 0),
            external: None,
            early: Vec::new(),
            samples: Repeats::default(),
        });
        Self {
            models: names
                .iter()
                .map(|n| ModelTopic::new(n, TICK_NS, 0))
                .collect(),
            images: names.iter().map(|_| Repeats::default()).collect(),
            is_frozen: false,
            frozen: 0,
            black: vec![0; names.len()],
            names,
            decoder: Decoder::new(unit.decoder()),
            clock: OneWayClock::ticking(TICK_NS),
            imu,
            report: meter.report(),
            free_running: 0,
        }
    }

    /// How long to wait for a frame before the IMU must be asked.
    fn patience(&self) -> Duration {
        match self.imu {
            Some(_) => Duration::from_millis(10),
            None => Duration::from_millis(50),
        }
    }

    pub(crate) fn frame(
        &mut self,
        packet: &Packet,
        to_recorder: &RecorderSender,
        control: &Control,
        meter: &Meter,
    ) -> Result<(), WriterGone> {
        self.report.received += 1;
        match self.decoder.push(packet) {
            Ok(Some(decoded)) => {
                let images = decoded.sample.images.len() as u64;
                meter.heard_part(IMAGES, 1);
                self.images(decoded, packet, to_recorder, meter)?;
                control.progress.images.fetch_add(images, Ordering::Relaxed);
            }
            Ok(None) => {}
            Err(error) => self.report.count_bad(error),
        }
        self.take_counters();
        meter.heard(&self.report, packet.arrival);
        Ok(())
    }

    fn images(
        &mut self,
        decoded: Decoded<UnitFrame>,
        packet: &Packet,
        to_recorder: &RecorderSender,
        meter: &Meter,
    ) -> Result<(), WriterGone> {
        let frame = decoded.sample;
        let external = frame.time_source == TimeSource::External;
        let device_ns = decoded
            .device_ticks
            .cast_signed()
            .saturating_mul(TICK_NS.cast_signed());
        let stamp = if external {
            Timestamp::from_nanos(device_ns)
        } else {
            self.free_running += 1;
            self.clock.push(device_ns, decoded.arrival);
            self.clock.time(device_ns)
        };
        let time = stamp.plus_nanos(frame.mid_exposure_from_stamp_ns);
        if let Some(imu) = &mut self.imu {
            imu.external = Some(external);
        }
        self.look_at(&frame.images, decoded.arrival, meter);
        self.take_stale(meter);
        let reading = if external {
            Some(Reading::Locked {
                device_ns,
                time: stamp,
                epoch: 1,
            })
        } else {
            self.clock.estimate().map(Reading::Fitted)
        };
        if let Some(reading) = reading {
            meter.set_sync(reading.sync_state(), reading.steps());
            let due = |model: &&mut ModelTopic| model.is_due(&reading, decoded.arrival);
            for model in self.models.iter_mut().filter(due) {
                let entry = model.entry(&reading, time, decoded.arrival);
                to_recorder.put(entry, &mut self.report)?;
            }
        }
        // The trailer lies under the last pixels of the last image.
        let trailer_at = packet.bytes.len().saturating_sub(TRAILER_BYTES);
        let trailer = packet.bytes.get(trailer_at..).unwrap_or_default();
        for (camera, sample) in self.names.iter().zip(frame.images) {
            let entry = Entry::Image {
                camera: camera.clone(),
                image: Stamped {
                    time,
                    arrival: decoded.arrival,
                    device_ticks: decoded.device_ticks,
                    sample,
                },
                trailer: trailer.to_vec(),
            };
            self.report.decoded += 1;
            to_recorder.put(entry, &mut self.report)?;
        }
        Ok(())
    }

    /// Asks the unit's IMU for what it has measured since, where it is time.
    fn poll_imu(
        &mut self,
        camera: &mut MyntCamera,
        to_recorder: &RecorderSender,
        meter: &Meter,
    ) -> Result<(), WriterGone> {
        let Some(imu) = &mut self.imu else {
            return Ok(());
        };
        if imu.polled.elapsed() < IMU_PERIOD {
            return Ok(());
        }
        imu.polled = Instant::now();
        imu.unanswered += std::mem::take(&mut imu.unsettled);
        let Ok(answer) = camera.poll_imu(imu.decoder.last_serial()) else {
            // A unit that has ended says so when it is waited for; one that goes on has refused.
            imu.unsettled += 1;
            return Ok(());
        };
        // A bad answer is counted by the decoder.
        let decoded = imu.decoder.push(&answer).unwrap_or_default();
        if !decoded.is_empty() {
            meter.heard_part(&imu.name, decoded.len() as u64);
        }
        let arrival = answer.arrival;
        for sample in &decoded {
            imu.samples.note(sample.sample, arrival);
        }
        imu.early.extend(decoded);
        let raw = Entry::Raw {
            source: imu.name.clone(),
            kind: 0,
            sequence: imu.answers,
            packet: answer,
            time: arrival,
        };
        imu.answers += 1;
        to_recorder.put(raw, &mut self.report)?;
        let Some(external) = imu.external else {
            let excess = imu.early.len().saturating_sub(MOST_EARLY_SAMPLES);
            imu.early.drain(..excess);
            return Ok(());
        };
        for decoded in std::mem::take(&mut imu.early) {
            let device_ns = decoded
                .device_ticks
                .cast_signed()
                .saturating_mul(TICK_NS.cast_signed());
            // One counter for frames and segments; the answers, 25 ms late, would only blur it.
            let time = if external {
                Timestamp::from_nanos(device_ns)
            } else {
                self.clock.time(device_ns)
            };
            let reading = if external {
                Some(Reading::Locked {
                    device_ns,
                    time,
                    epoch: 1,
                })
            } else {
                self.clock.estimate().map(Reading::Fitted)
            };
            if let Some(reading) = reading
                && imu.model.is_due(&reading, arrival)
            {
                to_recorder.put(imu.model.entry(&reading, time, arrival), &mut self.report)?;
            }
            let entry = Entry::Imu {
                imu: imu.name.clone(),
                sample: Stamped {
                    time,
                    arrival: decoded.arrival,
                    device_ticks: decoded.device_ticks,
                    sample: decoded.sample,
                },
            };
            to_recorder.put(entry, &mut self.report)?;
        }
        Ok(())
    }

    /// Whether each camera sees something, and something new.
    fn look_at(&mut self, images: &[Image], arrival: Timestamp, meter: &Meter) {
        let mut saturated: f64 = 0.0;
        let mut black = Vec::new();
        for (k, image) in images.iter().enumerate().take(self.names.len()) {
            let some = some_pixels(image);
            saturated = saturated.max(saturated_share(&some));
            if is_black(&some) {
                self.black[k] += 1;
                black.push(self.names[k].as_str());
            }
            self.images[k].note(some, arrival);
        }
        if let Some(first) = images.first() {
            meter.set_frame(f64::from(first.exposure_ns) / 1e6, saturated);
        }
        meter.set_partial((!black.is_empty()).then(|| format!("{}: {BLACK}", black.join(", "))));
    }

    /// The cameras that are frozen.
    fn frozen_names(&self) -> Vec<&str> {
        let cameras = self.names.iter().zip(&self.images);
        cameras
            .filter(|(_, images)| images.stale().is_problem())
            .map(|(name, _)| name.as_str())
            .collect()
    }

    fn take_stale(&mut self, meter: &Meter) {
        let frozen = self.frozen_names();
        let same_image =
            (!frozen.is_empty()).then(|| format!("{}: {SAME_IMAGE}", frozen.join(", ")));
        self.frozen += u64::from(same_image.is_some() && !self.is_frozen);
        self.is_frozen = same_image.is_some();
        let of_imu = self.imu.as_ref().map(|imu| imu.samples.stale());
        self.report.stale = self.frozen + of_imu.map_or(0, |stale| stale.stretches());
        let same_sample = of_imu.filter(|stale| stale.is_problem());
        let same_sample = same_sample.map(|_| SAME_SAMPLE.to_owned());
        meter.set_stale(same_image.or(same_sample).map(Cow::Owned));
    }

    fn take_counters(&mut self) {
        let counters = self.decoder.counters();
        // Damaged frames are among the missing: their ids never came.
        self.report.missing = counters.missing.saturating_sub(self.report.bad);
        self.report.duplicated = counters.duplicated;
    }

    pub(crate) fn finish(mut self) -> StreamReport {
        self.take_counters();
        let counters = self.decoder.counters();
        let stale = self.report.stale;
        let mut note = |count: u64, what: &str| {
            if count > 0 {
                self.report.notes.push(format!("{count} {what}"));
            }
        };
        note(counters.restarts, "restarts of the unit");
        note(
            stale,
            "stretches of more than a second with the same image or the same IMU sample",
        );
        for (name, black) in self.names.iter().zip(&self.black) {
            note(*black, &format!("images of {name} are black"));
        }
        note(
            self.free_running,
            "frames without external time: their time is estimated from arrivals",
        );
        if let Some(imu) = &self.imu {
            let counters = imu.decoder.counters();
            self.report.bad += counters.bad_answers + imu.unanswered;
            self.report.missing += counters.missing;
            self.report.notes.push(format!(
                "{}: {} segments, {} missing, {} unpaired",
                imu.name, counters.segments, counters.missing, counters.unpaired
            ));
            if counters.gaps > 0 {
                self.report.notes.push(format!(
                    "{}: {} gaps, the longest of {:.0} ms",
                    imu.name,
                    counters.gaps,
                    counters.longest_gap_us as f64 / 1e3
                ));
            }
        }
        self.report
    }
}
