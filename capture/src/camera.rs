//! A stereo unit's thread: frames → two images on the recording's clock.

use std::sync::atomic::Ordering;
use std::time::Duration;

use lsfb_drivers::camera::wire::TimeSource;
use lsfb_drivers::camera::{Decoder, DecoderConfig, MyntCamera};
use lsfb_drivers::transport::PacketSource;
use lsfb_types::{Stamped, Timestamp};

use crate::clock::OneWayClock;
use crate::config::CameraUnitConfig;
use crate::health::{Ending, StreamReport};
use crate::recorder::{Entry, Inlet};
use crate::session::Control;

/// Records until the unit ends or the session stops.
pub(crate) fn record(
    mut unit: MyntCamera,
    config: &CameraUnitConfig,
    decoder: DecoderConfig,
    inlet: &Inlet,
    control: &Control,
) -> StreamReport {
    let mut report = StreamReport::new(&format!("{}+{}", config.names[0], config.names[1]));
    let mut decoder = Decoder::new(decoder);
    let mut clock = OneWayClock::default();
    let mut free_running = 0_u64;
    report.ending = 'stream: loop {
        match unit.recv(Duration::from_millis(50)) {
            Ok(Some(packet)) => {
                report.received += 1;
                match decoder.push(&packet) {
                    Ok(Some(decoded)) => {
                        report.missing = decoder.counters().missing.saturating_sub(report.bad);
                        let frame = decoded.sample;
                        let device_ns = decoded.device_ticks.cast_signed().saturating_mul(1000);
                        let time = if frame.time_source == TimeSource::External {
                            Timestamp::from_nanos(device_ns)
                        } else {
                            free_running += 1;
                            clock.push(device_ns, decoded.arrival);
                            clock.time(device_ns)
                        };
                        // The trailer lies under the last pixels of the right image.
                        let trailer_at = packet
                            .bytes
                            .len()
                            .saturating_sub(lsfb_drivers::camera::model::TRAILER_BYTES);
                        let trailer = packet.bytes.get(trailer_at..).unwrap_or_default().to_vec();
                        for (camera, sample) in config.names.iter().zip([frame.left, frame.right]) {
                            let image = Stamped {
                                time,
                                arrival: decoded.arrival,
                                device_ticks: decoded.device_ticks,
                                sample,
                            };
                            let entry = Entry::Image {
                                camera: camera.clone(),
                                image,
                                trailer: trailer.clone(),
                            };
                            report.decoded += 1;
                            if inlet.put(entry, &mut report).is_err() {
                                break 'stream Ending::Stopped;
                            }
                        }
                        control.progress.images.fetch_add(2, Ordering::Relaxed);
                    }
                    Ok(None) => {}
                    Err(error) => report.count_bad(error),
                }
            }
            Ok(None) => {}
            Err(lsfb_drivers::Error::EndOfStream { .. }) => break Ending::EndOfStream,
            Err(error) => break Ending::Lost(error.to_string()),
        }
        if control.is_stopping() {
            break Ending::Stopped;
        }
    };
    let counters = decoder.counters();
    // Damaged frames are among the missing: their ids never came.
    report.missing = counters.missing.saturating_sub(report.bad);
    report.duplicated = counters.duplicated;
    if counters.restarts > 0 {
        report
            .notes
            .push(format!("the unit began anew {} times", counters.restarts));
    }
    if free_running > 0 {
        report.notes.push(format!(
            "{free_running} frames without external time: their time is fitted to arrival"
        ));
    }
    report
}
