//! Frames of the camera units, from their images and their trailer.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use lsfb_drivers::mynt_s::model::{EXPOSURE_STEP_NS, TRAILER_BYTES};
use lsfb_drivers::mynt_s::wire::{TimeSource, Trailer, UnitFile, XuDevice, emit_frame};
use lsfb_drivers::transport::camera_socket::CameraUnit as HostedUnit;
use lsfb_drivers::transport::uvc::FrameFormat;
use lsfb_recording::message::FrameMeta;
use lsfb_recording::{CameraUnit, Recording};
use lsfb_types::{Image, OutOfBounds, Stamped, Timestamp};

use super::unit_imu::RecordedImu;
use super::{CameraPlan, Play, readable};
use crate::Error;
use crate::device::clock::{Readiness, SimClock, Turn};
use crate::device::mynt::{LISTEN, MyntDevice, Started};
use crate::device::session::SessionReport;

/// Images that wait for the rest of their frame.
const MAX_WAITING: usize = 64;
/// Images that the rate is told by.
const RATE_IMAGES: usize = 21;

/// What says something about the frames of a wired camera.
pub(super) fn is_meta(topic: &str) -> bool {
    let parts: Vec<&str> = topic.split('/').collect();
    matches!(parts.as_slice(), ["", _, "frame_meta"])
}

/// The camera units that a recording lists; in one that lists none, wired cameras in pairs, in order of their names.
pub(super) fn plans(recording: &Recording) -> Result<Vec<CameraPlan>, Error> {
    let topics = recording.topics().iter().filter(|t| is_meta(&t.topic));
    let recorded: Vec<String> = topics
        .filter_map(|t| t.topic.split('/').nth(1).map(str::to_owned))
        .collect();
    let mut units = recording.camera_units()?;
    if units.is_empty() {
        units.extend(recorded.chunks(2).map(|pair| CameraUnit {
            cameras: pair.to_vec(),
            ..CameraUnit::default()
        }));
    }
    // A unit that never sent a frame cannot be played.
    units.retain(|unit| unit.cameras.iter().any(|name| recorded.contains(name)));
    units
        .into_iter()
        .map(|unit| plan(recording, unit))
        .collect()
}

fn plan(recording: &Recording, unit: CameraUnit) -> Result<CameraPlan, Error> {
    let failed = |problem: String| Error::Source {
        path: recording.path().to_owned(),
        problem,
    };
    let first = unit.cameras.first().map_or("", String::as_str);
    let images: Vec<_> = recording
        .images(first)?
        .filter_map(Result::ok)
        .take(RATE_IMAGES)
        .collect();
    let Some(image) = images.first() else {
        return Err(failed(format!("no image of {first} can be read")));
    };
    let mut files = BTreeMap::new();
    for kept in &unit.files {
        if let Some(file) = UnitFile::ALL.into_iter().find(|f| f.id() == kept.id) {
            files.insert(file, recording.attachment(&kept.attachment)?);
        }
    }
    if unit.cameras.len() == 1 && unit.files.is_empty() {
        return Err(failed(format!(
            "camera {first} has no partner in a stereo unit"
        )));
    }
    let has_answers = |imu: &String| recording.packets(imu).is_ok();
    Ok(CameraPlan {
        frame_px: [
            unit.cameras.len() as u32 * image.sample.width,
            image.sample.height,
        ],
        rate_hz: rate_hz(&images),
        imu: unit.imu.filter(has_answers),
        names: unit.cameras,
        files,
    })
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
    let Some(Started { unit, format }) = device_unit.wait_for_host(&mut xu, clock)? else {
        return Ok(report);
    };
    if [format.width, format.height] != plan.frame_px {
        let got = format!("{}x{}", format.width, format.height);
        let bounds = "that of the recorded frames";
        return Err(OutOfBounds::new("host", "frame_format", &got, &bounds).into());
    }
    let recording = play.recording()?;
    let mut bytes = Vec::new();
    let mut hosted = Hosted { unit, xu };
    for base_ns in play.turns() {
        let mut unreadable = SessionReport::default();
        let protocol = device_unit.imu_protocol();
        let mut imu = RecordedImu::new(&recording, plan, protocol, play)?;
        for frame in frames(&recording, plan, &mut unreadable)? {
            let due_ns = play.offset_ns(frame.time);
            while let Some(at_ns) = imu.next_ns().filter(|at_ns| *at_ns <= due_ns) {
                if hosted.wait_until(base_ns + at_ns, clock, device)? == Turn::Stop {
                    return Ok(report);
                }
                imu.queue_until(at_ns + IMU_BATCH_NS, &mut hosted.xu);
            }
            if hosted.wait_until(base_ns + due_ns, clock, device)? == Turn::Stop {
                return Ok(report);
            }
            frame.emit(format, &mut bytes)?;
            hosted.unit.send_frame(&bytes)?;
            report.stereo_frames += 1;
        }
        // What was measured behind the last frame.
        imu.queue_until(i64::MAX, &mut hosted.xu);
        report.unit_imu_segments += imu.queued();
        report.unreadable += unreadable.unreadable + imu.unreadable();
    }
    // The clock must not wait for this one while the IMU is read out.
    clock.finish(device);
    hosted.serve_until_imu_is_taken(clock)?;
    hosted.unit.finish()?;
    Ok(report)
}

/// Segments of the IMU that are due within this time are queued together: hosts poll far less often.
const IMU_BATCH_NS: i64 = 5_000_000;
/// A host that wants the IMU polls again within this time.
const LAST_POLL: Duration = Duration::from_millis(300);

/// The unit with its host.
struct Hosted {
    unit: HostedUnit,
    xu: XuDevice,
}

impl Hosted {
    /// Answers requests until the time has come.
    fn wait_until(&mut self, due_ns: i64, clock: &SimClock, device: usize) -> Result<Turn, Error> {
        loop {
            self.xu.serve(&mut self.unit, LISTEN)?;
            match clock.poll(device, due_ns) {
                Readiness::Ready => return Ok(Turn::Go),
                Readiness::Early => {}
                Readiness::Stopped => return Ok(Turn::Stop),
            }
        }
    }

    /// Lets the host have the rest of the IMU; one that does not want it asks for nothing.
    fn serve_until_imu_is_taken(&mut self, clock: &SimClock) -> Result<(), Error> {
        let mut last_heard = Instant::now();
        while !self.xu.imu_is_taken() && last_heard.elapsed() < LAST_POLL && !clock.is_stopped() {
            if self.xu.serve(&mut self.unit, LISTEN)?.is_some() {
                last_heard = Instant::now();
            }
        }
        Ok(())
    }
}

/// All images of a frame.
struct FrameImages {
    time: Timestamp,
    images: Vec<Image>,
    meta: FrameMeta,
}

impl FrameImages {
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
        let images: Vec<&[u8]> = self.images.iter().map(|i| i.pixels.as_slice()).collect();
        emit_frame(format, &images, &trailer.unwrap_or_else(made), out)?;
        if let Some(recorded) = recorded {
            // As received, whatever a parser makes of it.
            out.truncate(out.len().saturating_sub(TRAILER_BYTES));
            out.extend_from_slice(recorded);
        }
        Ok(())
    }
}

/// The frames in order. One that misses an image is left out: the host will see the gap in the frame numbers, as it did when
/// it was recorded.
fn frames<'a>(
    recording: &'a Recording,
    plan: &'a CameraPlan,
    report: &'a mut SessionReport,
) -> Result<impl Iterator<Item = FrameImages> + use<'a>, Error> {
    let names: Vec<&str> = plan.names.iter().map(String::as_str).collect();
    let cameras = names.len();
    let mut metas = recording
        .frame_meta(plan.first_name())?
        .filter_map(Result::ok)
        .peekable();
    let images = readable(recording.images_of(&names)?, report);
    let mut waiting: BTreeMap<Timestamp, Vec<Option<Image>>> = BTreeMap::new();
    Ok(images.filter_map(move |found| {
        let time = found.image.time;
        let images = waiting.entry(time).or_insert_with(|| vec![None; cameras]);
        *images.get_mut(found.camera)? = Some(found.image.sample);
        if images.iter().any(Option::is_none) {
            if waiting.len() > MAX_WAITING {
                waiting.pop_first();
            }
            return None;
        }
        let images: Vec<Image> = waiting.remove(&time)?.into_iter().flatten().collect();
        while metas.next_if(|meta| meta.time < time).is_some() {}
        let meta = metas.next_if(|meta| meta.time == time)?.sample;
        Some(FrameImages { time, images, meta })
    }))
}
