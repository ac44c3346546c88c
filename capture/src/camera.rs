//! A stereo unit's thread: frames → two images on the recording's clock, and the samples of the unit's own IMU.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use lsfb_drivers::Decoded;
use lsfb_drivers::camera::model::TRAILER_BYTES;
use lsfb_drivers::camera::wire::TimeSource;
use lsfb_drivers::camera::{
    CameraConfig, Decoder, DecoderConfig, ImuDecoder, MyntCamera, StereoFrame,
};
use lsfb_drivers::transport::PacketSource;
use lsfb_types::{Image, Packet, Stamped, Timestamp};

use crate::clock::OneWayClock;
use crate::clock::model_topic::{ModelTopic, Reading};
use crate::config::CameraUnitConfig;
use crate::health::{Ending, Meter, StreamReport};
use crate::recorder::{Entry, Inlet, WriterGone};
use crate::session::Control;

/// The unit's counter, in nanoseconds.
const TICK_NS: u64 = 1_000;
/// The unit keeps some 50 ms of IMU segments.
const IMU_PERIOD: Duration = Duration::from_millis(25);
/// Of so many pixels one is looked at for saturation.
const PIXEL_STRIDE: usize = 16;

/// A unit that can be opened again.
pub(crate) struct Unit {
    pub(crate) camera: MyntCamera,
    pub(crate) open: CameraConfig,
    pub(crate) config: CameraUnitConfig,
    pub(crate) decoder: DecoderConfig,
}

/// Records until the unit ends or the session stops. A unit that goes away may come back.
pub(crate) fn record(
    mut unit: Unit,
    inlet: &Inlet,
    control: &Control,
    meter: &Meter,
) -> StreamReport {
    let mut stream = CameraStream::new(&unit, meter);
    stream.report.ending = loop {
        match unit.camera.recv(stream.patience()) {
            Ok(Some(packet)) => {
                if stream.frame(&packet, inlet, control, meter).is_err() {
                    break Ending::Stopped;
                }
            }
            Ok(None) => {}
            Err(lsfb_drivers::Error::EndOfStream { .. }) => break Ending::EndOfStream,
            Err(error) => {
                let reopen = || MyntCamera::open(&unit.open);
                match control.reopen(&mut stream.report, meter, reopen) {
                    Some(camera) => unit.camera = camera,
                    None => break Ending::Lost(error.to_string()),
                }
            }
        }
        if stream.poll_imu(&mut unit.camera, inlet).is_err() || control.is_stopping() {
            break Ending::Stopped;
        }
    };
    stream.finish()
}

struct CameraStream {
    names: [String; 2],
    decoder: Decoder,
    clock: OneWayClock,
    models: Vec<ModelTopic>,
    imu: Option<UnitImu>,
    report: StreamReport,
    free_running: u64,
}

/// The unit's own IMU; its counter is the unit's.
struct UnitImu {
    name: String,
    decoder: ImuDecoder,
    polled: Instant,
    answers: u64,
    unanswered: u64,
    model: ModelTopic,
    /// Whether frames carry external time; the IMU's segments then do too.
    external: bool,
}

impl CameraStream {
    fn new(unit: &Unit, meter: &Meter) -> Self {
        let names = unit.config.names.clone();
        let imu = unit.config.imu.as_ref().map(|name| UnitImu {
            name: name.clone(),
            decoder: ImuDecoder::new(unit.camera.imu_protocol()),
            polled: Instant::now(),
            answers: 0,
            unanswered: 0,
            model: ModelTopic::new(name, TICK_NS, 0),
            external: false,
        });
        Self {
            models: names
                .iter()
                .map(|n| ModelTopic::new(n, TICK_NS, 0))
                .collect(),
            names,
            decoder: Decoder::new(unit.decoder),
            clock: OneWayClock::default(),
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

    fn frame(
        &mut self,
        packet: &Packet,
        inlet: &Inlet,
        control: &Control,
        meter: &Meter,
    ) -> Result<(), WriterGone> {
        self.report.received += 1;
        match self.decoder.push(packet) {
            Ok(Some(decoded)) => {
                self.images(decoded, packet, inlet, meter)?;
                control.progress.images.fetch_add(2, Ordering::Relaxed);
            }
            Ok(None) => {}
            Err(error) => self.report.count_bad(error),
        }
        self.take_counters();
        meter.heard(&self.report);
        Ok(())
    }

    fn images(
        &mut self,
        decoded: Decoded<StereoFrame>,
        packet: &Packet,
        inlet: &Inlet,
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
            imu.external = external;
        }
        meter.set_frame(
            f64::from(frame.left.exposure_ns) / 1e6,
            saturated_share(&frame.left),
        );
        let reading = if external {
            Some(Reading::Locked {
                device_ns,
                time: stamp,
            })
        } else {
            self.clock.estimate().map(Reading::Fitted)
        };
        if let Some(reading) = reading {
            meter.set_sync(reading.sync_state());
            for model in self.models.iter_mut().filter(|m| m.is_due(decoded.arrival)) {
                let entry = model.entry(&reading, time, decoded.arrival);
                inlet.put(entry, &mut self.report)?;
            }
        }
        // The trailer lies under the last pixels of the right image.
        let trailer_at = packet.bytes.len().saturating_sub(TRAILER_BYTES);
        let trailer = packet.bytes.get(trailer_at..).unwrap_or_default();
        for (camera, sample) in self.names.iter().zip([frame.left, frame.right]) {
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
            inlet.put(entry, &mut self.report)?;
        }
        Ok(())
    }

    /// Asks the unit's IMU for what it has measured since, where it is time.
    fn poll_imu(&mut self, camera: &mut MyntCamera, inlet: &Inlet) -> Result<(), WriterGone> {
        let Some(imu) = &mut self.imu else {
            return Ok(());
        };
        if imu.polled.elapsed() < IMU_PERIOD {
            return Ok(());
        }
        imu.polled = Instant::now();
        let Ok(answer) = camera.poll_imu(imu.decoder.last_serial()) else {
            // A unit that is gone says so with its next frame.
            imu.unanswered += 1;
            return Ok(());
        };
        let samples = imu.decoder.push(&answer).unwrap_or_default();
        let arrival = answer.arrival;
        let raw = Entry::Raw {
            source: imu.name.clone(),
            sequence: imu.answers,
            packet: answer,
            time: arrival,
        };
        imu.answers += 1;
        inlet.put(raw, &mut self.report)?;
        for decoded in samples {
            let device_ns = decoded
                .device_ticks
                .cast_signed()
                .saturating_mul(TICK_NS.cast_signed());
            // One counter for frames and segments; the answers, 25 ms late, would only blur it.
            let time = if imu.external {
                Timestamp::from_nanos(device_ns)
            } else {
                self.clock.time(device_ns)
            };
            let reading = if imu.external {
                Some(Reading::Locked { device_ns, time })
            } else {
                self.clock.estimate().map(Reading::Fitted)
            };
            // Before the first frame nothing is known of the unit's clock; the bytes are recorded.
            let Some(reading) = reading else { continue };
            if imu.model.is_due(arrival) {
                inlet.put(imu.model.entry(&reading, time, arrival), &mut self.report)?;
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
            inlet.put(entry, &mut self.report)?;
        }
        Ok(())
    }

    fn take_counters(&mut self) {
        let counters = self.decoder.counters();
        // Damaged frames are among the missing: their ids never came.
        self.report.missing = counters.missing.saturating_sub(self.report.bad);
        self.report.duplicated = counters.duplicated;
    }

    fn finish(mut self) -> StreamReport {
        self.take_counters();
        let counters = self.decoder.counters();
        let mut note = |count: u64, what: &str| {
            if count > 0 {
                self.report.notes.push(format!("{count} {what}"));
            }
        };
        note(counters.restarts, "times the unit began anew");
        note(
            self.free_running,
            "frames without external time: their time is fitted to arrival",
        );
        if let Some(imu) = &self.imu {
            let counters = imu.decoder.counters();
            self.report.bad += counters.bad_answers + imu.unanswered;
            self.report.missing += counters.missing;
            self.report.notes.push(format!(
                "{}: {} segments, {} missing, {} unpaired",
                imu.name, counters.segments, counters.missing, counters.unpaired
            ));
        }
        self.report
    }
}

/// Share of the pixels that are white, 0–1, from a sample of them.
fn saturated_share(image: &Image) -> f64 {
    let looked_at = image.pixels.iter().step_by(PIXEL_STRIDE);
    let count = looked_at.len().max(1);
    looked_at.filter(|grey| **grey == u8::MAX).count() as f64 / count as f64
}
