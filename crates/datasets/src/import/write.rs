//! What was found becomes a recording.

use std::collections::BTreeMap;
use std::path::Path;

use lsfb_recording::message::{self, FrameMeta};
use lsfb_recording::{Channel, Writer, WriterConfig};
use lsfb_types::{Image, Progress, ProgressFn, Stamped};

use super::collected::Collected;
use super::payload::{ImageRecord, Payload, Pixels};
use super::report::ClockOf;
use super::stream::{Record, Stream};
use super::video::Frames;
use crate::{Error, read_cloud};

/// Records between two looks at whether to go on.
const SHOW_EVERY: usize = 256;

/// What is said of an import in the recording itself.
pub(super) struct Said<'a> {
    pub(super) format: &'static str,
    pub(super) source: &'a Path,
    pub(super) device: &'a str,
    pub(super) clock: ClockOf,
}

/// Writes all streams in the order in which the device had them. Gives how many messages each became.
pub(super) fn write(
    collected: &mut Collected,
    said: &Said<'_>,
    path: &Path,
    progress: ProgressFn<'_>,
) -> Result<Vec<u64>, Error> {
    let mut order: Vec<(usize, usize)> = Vec::new();
    for (stream, found) in collected.streams.iter().enumerate() {
        order.extend((0..found.records.len()).map(|record| (stream, record)));
    }
    let streams = std::mem::take(&mut collected.streams);
    // Stable: records of one instant stay in the order of their streams.
    order.sort_by_key(|(s, r)| record_at(&streams, *s, *r).map(|r| r.arrival));
    let mut writing = Writing {
        writer: Writer::create(path, &WriterConfig::default())?,
        collected,
        device: said.device,
        videos: BTreeMap::new(),
        of_two_clocks: 0,
    };
    if let Some(rig) = writing.collected.rig.clone() {
        writing.writer.attach_rig(&rig)?;
        writing.writer.place_sidecar(said.device, &rig);
    }
    let mut streams = streams;
    let mut written = vec![0; streams.len()];
    for (done, (s, r)) in order.iter().enumerate() {
        if done % SHOW_EVERY == 0 {
            progress(Progress {
                stage: "writing records",
                done: done as u64,
                total: order.len() as u64,
            })?;
        }
        let Some(stream) = streams.get_mut(*s) else {
            continue;
        };
        match writing.record(stream, *r)? {
            Ok(()) => written[*s] += 1,
            Err(why) => {
                let what = stream.what.clone();
                stream.lose(1, || format!("{what}: {why}"));
            }
        }
    }
    if writing.of_two_clocks > 0 {
        writing.collected.notes.push(format!(
            "the points of {} scans have times of another clock than their stamps: only their differences are used",
            writing.of_two_clocks
        ));
    }
    writing.say(said, &streams)?;
    writing.writer.finish()?;
    writing.collected.streams = streams;
    Ok(written)
}

fn record_at(streams: &[Stream], stream: usize, record: usize) -> Option<&Record> {
    streams.get(stream)?.records.get(record)
}

struct Writing<'a> {
    writer: Writer,
    collected: &'a mut Collected,
    device: &'a str,
    /// Videos that are being decoded.
    videos: BTreeMap<usize, Frames>,
    /// Clouds whose points have times of another clock than their stamps.
    of_two_clocks: u64,
}

impl Writing<'_> {
    /// Writes one record. Inside: what is wrong with it alone.
    fn record(&mut self, stream: &Stream, number: usize) -> Result<Result<(), String>, Error> {
        let Some(record) = stream.records.get(number) else {
            return Ok(Ok(()));
        };
        let device = stream.device.as_deref().unwrap_or(self.device);
        match &record.payload {
            Payload::Image(image) => {
                let camera = stream.topic.trim_end_matches("/image");
                self.image(record, image, device, camera)
            }
            Payload::Cloud(path) => self.cloud(record, path, &stream.topic),
            payload => {
                let frame = format!("{device}/{}", stream.topic);
                let bytes = payload.encode(record.time, &frame).unwrap_or_default();
                let schema = stream.kind.schema();
                self.put(
                    &format!("/sidecar/{device}/{}", stream.topic),
                    schema,
                    record,
                    &bytes,
                )?;
                Ok(Ok(()))
            }
        }
    }

    fn put(
        &mut self,
        topic: &str,
        schema: message::Schema,
        record: &Record,
        bytes: &[u8],
    ) -> Result<(), Error> {
        let channel = Channel {
            topic,
            schema_name: schema.name,
            schema_text: schema.text,
        };
        Ok(self
            .writer
            .write_cdr(&channel, record.time, record.arrival, bytes)?)
    }

    fn image(
        &mut self,
        record: &Record,
        image: &ImageRecord,
        device: &str,
        camera: &str,
    ) -> Result<Result<(), String>, Error> {
        let decoded = match &image.pixels {
            Pixels::File(path) => lsfb_perception::image::read(path).map_err(|e| e.to_string()),
            Pixels::Frame { video, number } => self.frame(*video, *number),
            Pixels::Record(at) => at
                .bytes()
                .and_then(|bytes| lsfb_perception::image::decode(&bytes)),
        };
        let decoded = decoded.and_then(|decoded| self.as_calibrated(camera, decoded));
        let decoded = match decoded {
            Ok(decoded) => decoded,
            Err(why) => return Ok(Err(why)),
        };
        let frame = format!("{device}/{camera}");
        let topic = format!("/sidecar/{device}/{camera}");
        let meta = FrameMeta {
            frame_id: image.frame_id,
            device_ticks: image.device_ns,
            exposure_ns: image.exposure_ns,
            trailer: Vec::new(),
        };
        let meta = message::encode_frame_meta(record.time, &frame, &meta);
        self.put(
            &format!("{topic}/frame_meta"),
            message::FRAME_META,
            record,
            &meta,
        )?;
        let bytes = message::encode_image(record.time, &frame, &decoded);
        self.put(&format!("{topic}/image"), message::IMAGE, record, &bytes)?;
        Ok(Ok(()))
    }

    /// The image, where it has the size for which its camera was calibrated: the intrinsics of another say nothing about it.
    fn as_calibrated(&self, camera: &str, image: Image) -> Result<Image, String> {
        let rig = self.collected.rig.as_ref();
        let Some(calibrated) = rig.and_then(|rig| rig.cameras.get(camera)) else {
            return Ok(image);
        };
        let (width, height) = (calibrated.camera.width, calibrated.camera.height);
        match (image.width, image.height) == (width, height) {
            true => Ok(image),
            false => Err(format!(
                "an image of {} × {} pixels, but calibrated for {width} × {height}",
                image.width, image.height
            )),
        }
    }

    fn frame(&mut self, video: usize, number: u32) -> Result<Image, String> {
        let frames = match self.videos.entry(video) {
            std::collections::btree_map::Entry::Occupied(open) => open.into_mut(),
            std::collections::btree_map::Entry::Vacant(closed) => {
                let path = self.collected.videos.get(video).ok_or("no such video")?;
                closed.insert(Frames::open(path)?)
            }
        };
        frames.read(number)
    }

    fn cloud(
        &mut self,
        record: &Record,
        path: &Path,
        topic: &str,
    ) -> Result<Result<(), String>, Error> {
        let cloud = match read_cloud(path) {
            Ok(cloud) => cloud,
            Err(error) => return Ok(Err(error.to_string())),
        };
        let lidar = topic.trim_end_matches("/points");
        if cloud.times.has_two_clocks(record.time) {
            self.of_two_clocks += 1;
        }
        self.writer.write_scan(
            lidar,
            &Stamped {
                time: cloud.times.begins(record.time),
                arrival: record.arrival,
                device_ticks: 0,
                sample: cloud.scan,
            },
        )?;
        Ok(Ok(()))
    }

    /// What the recording says about where it comes from.
    fn say(&mut self, said: &Said<'_>, streams: &[Stream]) -> Result<(), Error> {
        let count = |of: fn(&Stream) -> u64| streams.iter().map(of).sum::<u64>().to_string();
        let left_out = self.collected.left_out.iter();
        let left_out: Vec<String> = left_out
            .map(|l| format!("{} {}", l.records, l.what))
            .collect();
        let source = said.source.file_name().unwrap_or_default();
        let entries = [
            ("format", said.format.to_owned()),
            ("source", source.to_string_lossy().into_owned()),
            ("clock", said.clock.name().to_owned()),
            (
                "records",
                count(|s| if s.derived { 0 } else { s.counts.read }),
            ),
            ("unreadable", count(|s| s.counts.unreadable)),
            ("repeated", count(|s| s.counts.repeated)),
            ("reordered", count(|s| s.counts.reordered)),
            ("left_out", left_out.join("; ")),
        ];
        let entries = entries.map(|(name, value)| (name.to_owned(), value));
        Ok(self.writer.write_metadata("lsfb.import", entries.into())?)
    }
}
