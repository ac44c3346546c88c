//! Topics that a sensor fills at a steady rate.

use std::collections::BTreeMap;

use lsfb_recording::{Recording, TopicArrivals};
use lsfb_types::Timestamp;

use super::{Depth, DoctorConfig};
use crate::Error;
use crate::device_note::DeviceNote;
use crate::pace::{Pace, not_in_real_time};

/// A topic that a sensor fills at a steady rate.
pub(super) struct Stream<'a> {
    pub topic: &'a str,
    pub arrivals: &'a [Timestamp],
    /// How many a second its device was set to send, or was seen to send, hertz: what the recorder wrote of it.
    pub nominal_hz: Option<f64>,
    /// Synchronized times of its first and its last message.
    pub first_stamp: Timestamp,
    pub last_stamp: Timestamp,
    /// Synchronized times of all its messages, where they were read.
    pub stamps: Option<Vec<Timestamp>>,
}

/// Endings of topics of sensors, and between which rates such a sensor can be, hertz.
const SENSORS: &[(&str, [f64; 2])] = &[
    // Rotating LiDARs turn 5 to 20 times a second (VLP-16 User Manual 63-9243 Rev. E, 300 to 1200 rpm).
    ("/packets", [4.0, 25.0]),
    ("/points", [4.0, 25.0]),
    ("/image", [0.5, 1000.0]),
    ("/data_raw", [20.0, 10_000.0]),
    ("/imu", [20.0, 10_000.0]),
    ("/mag", [0.5, 10_000.0]),
    ("/pressure", [0.1, 10_000.0]),
];

/// Between which rates the sensor of a topic can be; `None` where no sensor fills it steadily.
pub(super) fn possible_hz(topic: &str) -> Option<[f64; 2]> {
    let sensor = SENSORS.iter().find(|(end, _)| topic.ends_with(end));
    sensor.map(|(_, range)| *range)
}

impl<'a> Stream<'a> {
    /// The steady topics of a recording. All stamps are read where everything is, or where arrivals say nothing.
    pub(super) fn all(
        recording: &Recording,
        arrivals: &'a [TopicArrivals],
        config: &DoctorConfig,
    ) -> Result<Vec<Self>, Error> {
        let mut streams = Vec::new();
        let cameras_hz = camera_rates(recording);
        for topic in arrivals.iter().filter(|a| possible_hz(&a.topic).is_some()) {
            let (Some(first), Some(last)) = (topic.times.first(), topic.times.last()) else {
                continue;
            };
            let first_message = recording.messages(&topic.topic)?.next();
            // What cannot be read is judged by its arrivals; its end is not looked for in a whole file of the same.
            let stamps = match first_message {
                Some(Ok(first)) => {
                    let last = recording.last_message(&topic.topic)?;
                    last.map(|last| [first.time, last.time])
                }
                _ => None,
            };
            let [first_stamp, last_stamp] = stamps.unwrap_or([*first, *last]);
            streams.push(Self {
                topic: &topic.topic,
                arrivals: &topic.times,
                nominal_hz: nominal_hz(recording, &cameras_hz, &topic.topic),
                first_stamp,
                last_stamp,
                stamps: None,
            });
        }
        if config.read == Depth::Everything && unreal_pace(&streams).is_some() {
            for stream in &mut streams {
                let read = recording.messages(stream.topic)?;
                // What is damaged is said elsewhere.
                let mut stamps: Vec<Timestamp> =
                    read.filter_map(Result::ok).map(|m| m.time).collect();
                stamps.sort_unstable();
                stream.stamps = Some(stamps);
            }
        }
        Ok(streams)
    }

    /// Name of its device.
    pub(super) fn device(&self) -> Option<&str> {
        let (device, _) = self.topic.strip_prefix('/')?.split_once('/')?;
        Some(device)
    }

    /// From a stamp to its arrival, seconds: of the first and the last message the one that came sooner, as a link may hold messages
    /// back for a while.
    pub(super) fn stamp_offset_secs(&self) -> Option<f64> {
        let first_secs = self.arrivals.first()?.secs_since(self.first_stamp);
        let last_secs = self.arrivals.last()?.secs_since(self.last_stamp);
        let is_sooner = last_secs.abs() < first_secs.abs();
        Some(if is_sooner { last_secs } else { first_secs })
    }

    /// Whether a phone or glasses sent it, which may keep messages until they are heard again.
    pub(super) fn is_of_a_sidecar(&self) -> bool {
        self.topic.starts_with("/sidecar/")
    }

    pub(super) fn rate_by_stamps_hz(&self) -> f64 {
        let span_secs = self.last_stamp.secs_since(self.first_stamp);
        self.arrivals.len().saturating_sub(1) as f64 / span_secs.max(1e-9)
    }

    /// How long it took, by stamps and by arrivals; `None` with too few messages.
    pub(super) fn pace(&self) -> Option<Pace> {
        let (first, last) = (self.arrivals.first()?, self.arrivals.last()?);
        let pace = Pace {
            stamped_secs: self.last_stamp.secs_since(self.first_stamp),
            arrived_secs: last.secs_since(*first),
        };
        (self.arrivals.len() > 2).then_some(pace)
    }
}

/// Frames a second that were asked of each camera, where the recording says it.
fn camera_rates(recording: &Recording) -> BTreeMap<String, f64> {
    let units = recording.camera_units().unwrap_or_default();
    let with_rate = units.into_iter().filter(|unit| unit.rate_hz > 0);
    with_rate
        .flat_map(|unit| {
            let rate_hz = f64::from(unit.rate_hz);
            unit.cameras.into_iter().map(move |name| (name, rate_hz))
        })
        .collect()
}

/// Messages a second on a topic of a device as the recorder described that.
fn nominal_hz(
    recording: &Recording,
    cameras_hz: &BTreeMap<String, f64>,
    topic: &str,
) -> Option<f64> {
    let (device, quantity) = topic.strip_prefix('/')?.split_once('/')?;
    match quantity {
        "image" => cameras_hz.get(device).copied(),
        "packets" | "points" | "data_raw" => DeviceNote::read(recording, device)?.rate_hz(),
        _ => None,
    }
}

/// How long a recording took by stamps and by arrivals, where it was not made in real time.
pub(super) fn unreal_pace(streams: &[Stream<'_>]) -> Option<Pace> {
    not_in_real_time(streams.iter().filter_map(Stream::pace))
}
