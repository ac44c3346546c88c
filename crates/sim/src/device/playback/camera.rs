//! Frames of the stereo units, from their two images and their trailer.

use std::collections::BTreeMap;

use lsfb_drivers::camera::model::{EXPOSURE_STEP_NS, FrameFormat, TRAILER_BYTES};
use lsfb_drivers::camera::wire::{TimeSource, Trailer, emit_frame};
use lsfb_recording::Recording;
use lsfb_recording::message::FrameMeta;
use lsfb_types::{Image, Stamped, Timestamp};

use super::{CameraPlan, Play, readable};
use crate::Error;
use crate::device::clock::{Readiness, SimClock};
use crate::device::mynt::{LISTEN, MyntDevice, Started};
use crate::device::session::SessionReport;

/// Images that wait for the other half of their frame.
const MAX_WAITING: usize = 64;
/// Images that the rate is told by.
const RATE_IMAGES: usize = 21;

/// What says something about the frames of a wired camera.
pub(super) fn is_meta(topic: &str) -> bool {
    let parts: Vec<&str> = topic.split('/').collect();
    matches!(parts.as_slice(), ["", _, "frame_meta"])
}

/// Wired cameras in pairs, in order of their names.
pub(super) fn plans(recording: &Recording) -> Result<Vec<CameraPlan>, Error> {
    let topics = recording.topics().iter().filter(|t| is_meta(&t.topic));
    let names: Vec<String> = topics
        .filter_map(|t| t.topic.split('/').nth(1).map(str::to_owned))
        .collect();
    let failed = |problem: String| Error::Source {
        path: recording.path().to_owned(),
        problem,
    };
    names
        .chunks(2)
        .map(|pair| {
            let [left, right] = pair else {
                return Err(failed(format!(
                    "camera {} has no partner in a stereo unit",
                    pair.join("")
                )));
            };
            let images: Vec<_> = recording
                .images(left)?
                .filter_map(Result::ok)
                .take(RATE_IMAGES)
                .collect();
            let Some(first) = images.first() else {
                return Err(failed(format!("no image of {left} can be read")));
            };
            Ok(CameraPlan {
                names: [left.clone(), right.clone()],
                frame_px: [2 * first.sample.width, first.sample.height],
                rate_hz: rate_hz(&images),
            })
        })
        .collect()
}

fn rate_hz(images: &[Stamped<Image>]) -> u32 {
    let mut steps: Vec<i64> = images.windows(2).map(|i| i[1].time - i[0].time).collect();
    steps.sort_unstable();
    match steps.get(steps.len() / 2) {
        Some(&step) if step > 0 => (1e9 / step as f64).round().clamp(1.0, 1_000.0) as u32,
        _ => 10,
    }
}

/// Serves its host, and once it asks for the stream sends the frames.
pub(super) fn run(
    device_unit: MyntDevice,
    plan: &CameraPlan,
    play: &Play,
    clock: &SimClock,
    device: usize,
) -> Result<SessionReport, Error> {
    let mut report = SessionReport::default();
    let mut xu = device_unit.extension_unit();
    let Some(Started { mut unit, format }) = device_unit.wait_for_host(&mut xu, clock)? else {
        return Ok(report);
    };
    if [format.width, format.height] != plan.frame_px {
        return Err(Error::Config {
            field: "frame format asked for by the host",
            got: format!("{}x{}", format.width, format.height),
            expected: "that of the recorded frames",
        });
    }
    let recording = play.recording()?;
    let mut bytes = Vec::new();
    for base_ns in play.turns() {
        let mut unreadable = SessionReport::default();
        for frame in frames(&recording, plan, &mut unreadable)? {
            let due_ns = base_ns + play.offset_ns(frame.time);
            loop {
                // Requests are answered while the frame's time has not come yet.
                unit.serve(&mut xu, LISTEN)?;
                match clock.poll(device, due_ns) {
                    Readiness::Ready => break,
                    Readiness::Early => {}
                    Readiness::Stopped => return Ok(report),
                }
            }
            frame.emit(format, &mut bytes)?;
            unit.send_frame(&bytes)?;
            report.stereo_frames += 1;
        }
        report.unreadable += unreadable.unreadable;
    }
    clock.finish(device);
    unit.finish()?;
    Ok(report)
}

/// Both halves of a frame.
struct StereoImages {
    time: Timestamp,
    left: Image,
    right: Image,
    meta: FrameMeta,
}

impl StereoImages {
    fn emit(&self, format: FrameFormat, out: &mut Vec<u8>) -> Result<(), Error> {
        let made = || {
            Trailer {
                time_source: TimeSource::External,
                frame_id: self.meta.frame_id as u16,
                timestamp_us: self.meta.device_ticks,
                exposure_steps: (self.meta.exposure_ns / EXPOSURE_STEP_NS) as u16,
                checksum: 0,
            }
            .with_checksum()
        };
        let recorded = self.meta.trailer.last_chunk::<TRAILER_BYTES>();
        let trailer = recorded.and_then(|bytes| Trailer::parse(bytes).ok());
        emit_frame(
            format,
            &self.left.pixels,
            &self.right.pixels,
            &trailer.unwrap_or_else(made),
            out,
        )?;
        if let Some(recorded) = recorded {
            // As received, whatever a parser makes of it.
            out.truncate(out.len().saturating_sub(TRAILER_BYTES));
            out.extend_from_slice(recorded);
        }
        Ok(())
    }
}

/// The frames in order. One that misses a half is left out: the host will see the gap in the frame numbers, as it did when
/// it was recorded.
fn frames<'a>(
    recording: &'a Recording,
    plan: &'a CameraPlan,
    report: &'a mut SessionReport,
) -> Result<impl Iterator<Item = StereoImages> + use<'a>, Error> {
    let names = [plan.names[0].as_str(), plan.names[1].as_str()];
    let mut metas = recording
        .frame_meta(names[0])?
        .filter_map(Result::ok)
        .peekable();
    let images = readable(recording.images_of(&names)?, report);
    let mut waiting: BTreeMap<Timestamp, [Option<Image>; 2]> = BTreeMap::new();
    Ok(images.filter_map(move |found| {
        let time = found.image.time;
        let halves = waiting.entry(time).or_default();
        *halves.get_mut(found.camera)? = Some(found.image.sample);
        if halves.iter().any(Option::is_none) {
            if waiting.len() > MAX_WAITING {
                waiting.pop_first();
            }
            return None;
        }
        let [Some(left), Some(right)] = waiting.remove(&time)? else {
            return None;
        };
        while metas.next_if(|meta| meta.time < time).is_some() {}
        let meta = metas.next_if(|meta| meta.time == time)?.sample;
        Some(StereoImages {
            time,
            left,
            right,
            meta,
        })
    }))
}
