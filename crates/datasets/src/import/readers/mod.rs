//! One reader per format.

mod aria;
mod euroc;
mod indoor_location;
mod ios_logger;
mod kapture;
mod mars_logger;
mod protobuf;
mod spectacular_rec;
mod stray_scanner;
mod video_imu_capture;

use std::path::Path;

use lsfb_types::{Progress, ProgressFn};

use super::collected::Collected;
use super::payload::{ImageRecord, Payload, Pixels};
use super::{Format, ImportConfig};
use crate::Error;

/// Microtesla in tesla.
const TESLA_PER_MICROTESLA: f64 = 1e-6;

/// Reads a source into `into`.
pub(super) fn read(
    format: Format,
    source: &Path,
    config: &ImportConfig,
    into: &mut Collected,
    progress: ProgressFn<'_>,
) -> Result<(), Error> {
    progress(Progress {
        stage: "reading records",
        done: 0,
        total: 0,
    })?;
    match format {
        Format::Euroc => euroc::read(source, config, into, progress),
        Format::IndoorLocation => indoor_location::read(source, into),
        Format::IosLogger => ios_logger::read(source, into),
        Format::StrayScanner => stray_scanner::read(source, config, into),
        Format::MarsLogger => mars_logger::read(source, into),
        Format::VideoImuCapture => video_imu_capture::read(source, into),
        Format::SpectacularRec => spectacular_rec::read(source, config, into),
        Format::Kapture => kapture::read(source, config, kapture::Layout::Kapture, into),
        Format::AriaVrs => aria::read(source, into),
        Format::Lamar => kapture::read(source, config, kapture::Layout::Lamar, into),
    }
}

/// A frame of a video; its exposure is not known.
fn frame(video: usize, number: u32) -> ImageRecord {
    ImageRecord {
        pixels: Pixels::Frame { video, number },
        exposure_ns: 0,
        device_ns: 0,
        frame_id: number,
    }
}

/// An image file that a list names below a folder; names that lead out of it are refused.
fn image_file(folder: &Path, name: &str, number: usize) -> Result<Payload, String> {
    let below = Path::new(name);
    let is_below = |c| matches!(c, std::path::Component::Normal(_));
    if name.is_empty() || !below.components().all(is_below) {
        return Err(format!("`{name}` is not a file in {}", folder.display()));
    }
    Ok(Payload::Image(Box::new(ImageRecord {
        pixels: Pixels::File(folder.join(below)),
        exposure_ns: 0,
        device_ns: 0,
        frame_id: u32::try_from(number).unwrap_or(u32::MAX),
    })))
}

/// Part of a topic made of a name in a source: letters, digits, `-` and `_`.
fn topic_name(name: &str) -> String {
    let plain = |c: char| match c.is_ascii_alphanumeric() || c == '-' || c == '_' {
        true => c,
        false => '_',
    };
    name.chars().map(plain).collect()
}
