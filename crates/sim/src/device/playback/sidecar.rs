//! A phone or glasses: their messages word for word, through the sidecar stream.

use std::time::Duration;

use lsfb_drivers::sidecar::ClientConfig;
use lsfb_drivers::sidecar::model::CLOCK_UTC;
use lsfb_drivers::sidecar::wire::Advertise;
use lsfb_recording::{DEVICE_TIME, Recording};

use super::{Play, readable};
use crate::Error;
use crate::device::clock::{SimClock, Turn};
use crate::device::rig_link;
use crate::device::session::SessionReport;

/// The device of a sidecar's topic: `glasses` of `/sidecar/glasses/imu`.
pub(super) fn id_of(topic: &str) -> Option<&str> {
    let (id, rest) = topic.strip_prefix("/sidecar/")?.split_once('/')?;
    (!id.is_empty() && !rest.is_empty()).then_some(id)
}

/// The devices, in order of name.
pub(super) fn names(recording: &Recording) -> Vec<String> {
    let mut names: Vec<String> = recording
        .topics()
        .iter()
        .filter_map(|t| id_of(&t.topic).map(str::to_owned))
        .collect();
    names.sort();
    names.dedup();
    names
}

/// What the recorder wrote itself, and will write again.
pub(super) fn is_recorders(topic: &str) -> bool {
    let ends = ["/camera_info", "/session", "/time_sync", DEVICE_TIME];
    ends.iter().any(|end| topic.ends_with(end))
}

/// One app.
pub(super) struct SidecarPlayer {
    id: String,
    rig: ClientConfig,
    patience: Duration,
}

impl SidecarPlayer {
    pub(super) fn new(id: &str, rig: ClientConfig, patience: Duration) -> Self {
        Self {
            id: id.to_owned(),
            rig,
            patience,
        }
    }

    /// Connects, describes its channels and sends everything in order of time.
    pub(super) fn run(
        &self,
        play: &Play,
        clock: &SimClock,
        device: usize,
    ) -> Result<SessionReport, Error> {
        let mut report = SessionReport::default();
        let Some(mut client) = rig_link::connect(&self.rig, self.patience, clock)? else {
            return Ok(report);
        };
        let recording = play.recording()?;
        let topics: Vec<&str> = recording
            .topics()
            .iter()
            .map(|t| t.topic.as_str())
            .filter(|topic| id_of(topic) == Some(&self.id) && !is_recorders(topic))
            .collect();
        for (channel, topic) in (1..).zip(&topics) {
            client.advertise(&self.advertise(&recording, channel, topic))?;
        }
        for base_ns in play.turns() {
            let mut unreadable = vec![SessionReport::default(); topics.len()];
            let mut streams = Vec::new();
            for (topic, unreadable) in topics.iter().zip(&mut unreadable) {
                streams.push(readable(recording.messages(topic)?, unreadable).peekable());
            }
            loop {
                let next = streams
                    .iter_mut()
                    .zip(1..)
                    .filter_map(|(stream, channel)| {
                        let time = stream.peek()?.time;
                        Some((time, channel, stream))
                    })
                    .min_by_key(|(time, channel, _)| (*time, *channel));
                let Some((time, channel, stream)) = next else {
                    break;
                };
                if clock.reach(device, base_ns + play.offset_ns(time)) == Turn::Stop {
                    client.bye()?;
                    return Ok(report);
                }
                if let Some(message) = stream.next() {
                    client.send(channel, message.time.nanos(), &message.bytes)?;
                    report.sidecar_messages += 1;
                }
            }
            drop(streams);
            report.unreadable += unreadable.iter().map(|r| r.unreadable).sum::<u64>();
        }
        clock.finish(device);
        client.bye()?;
        Ok(report)
    }

    fn advertise(&self, recording: &Recording, channel: u32, topic: &str) -> Advertise {
        let described = recording.topics().iter().find(|t| t.topic == topic);
        Advertise {
            channel,
            topic: topic.to_owned(),
            encoding: "cdr".to_owned(),
            schema_name: described.map_or_else(String::new, |t| t.schema.clone()),
            schema: recording
                .schema_text(topic)
                .unwrap_or_default()
                .as_bytes()
                .to_vec(),
            clock_id: CLOCK_UTC.to_owned(),
            metadata_json: self.metadata(recording, channel),
        }
    }

    /// The rig that the device brought travels with its first channel.
    fn metadata(&self, recording: &Recording, channel: u32) -> String {
        let own = format!("sidecar/{}/rig.toml", self.id);
        let rig = match recording.attachment(&own) {
            Ok(text) => Some(text),
            // It brought the only rig.
            Err(_) => recording
                .rig()
                .ok()
                .filter(|rig| rig.lidar().is_none())
                .map(|rig| rig.to_toml().into_bytes()),
        };
        match rig {
            Some(text) if channel == 1 => {
                serde_json::json!({ "rig_toml": String::from_utf8_lossy(&text) }).to_string()
            }
            _ => "{}".to_owned(),
        }
    }
}
