//! When a recording starts and how long it is, on the clock of its devices.

use std::path::Path;

use lsfb_recording::Recording;
use lsfb_types::Timestamp;

use super::{camera, imu, lidar, sidecar};
use crate::Error;

/// Topics whose time is that of the devices' clocks.
fn topics(recording: &Recording) -> Vec<String> {
    let known = |topic: &str| {
        [lidar::DATA_TOPIC, lidar::POSITION_TOPIC, imu::SAMPLES_TOPIC].contains(&topic)
            || camera::is_meta(topic)
            || sidecar::id_of(topic).is_some() && !sidecar::is_recorders(topic)
    };
    let topics = recording.topics().iter().map(|t| t.topic.clone());
    topics.filter(|topic| known(topic)).collect()
}

/// Time of the first sample of any device.
pub(super) fn of(recording: &Recording) -> Timestamp {
    let firsts = topics(recording).into_iter().filter_map(|topic| {
        let mut messages = recording.messages(&topic).ok()?;
        messages.find_map(Result::ok).map(|m| m.time)
    });
    firsts.min().unwrap_or_default()
}

/// How long it takes from there to the last sample: reads everything once.
pub(super) fn span(path: &Path, start: Timestamp) -> Result<i64, Error> {
    let recording = Recording::open(path)?;
    let mut end = start;
    for topic in topics(&recording) {
        let messages = recording.messages(&topic)?.filter_map(Result::ok);
        end = messages.map(|m| m.time).fold(end, Timestamp::max);
    }
    Ok(end - start)
}

/// How long it took to record: good enough for a bar.
pub(super) fn span_of_arrivals(path: &Path) -> Result<i64, Error> {
    let range = Recording::open(path)?.arrival_range();
    Ok(range.map_or(0, |range| range.end - range.start))
}
