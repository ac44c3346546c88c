//! Topics that a sensor fills at a steady rate.

use lsfb_recording::{Recording, TopicArrivals};
use lsfb_types::Timestamp;

use super::{Depth, DoctorConfig};
use crate::Error;
use crate::pace::{Pace, not_in_real_time};

/// A topic that a sensor fills at a steady rate.
pub(super) struct Stream<'a> {
    pub topic: &'a str,
    pub arrivals: &'a [Timestamp],
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

/// How long a recording took by stamps and by arrivals, where it was not made in real time.
pub(super) fn unreal_pace(streams: &[Stream<'_>]) -> Option<Pace> {
    not_in_real_time(streams.iter().filter_map(Stream::pace))
}
