//! Where a recording keeps the counters of its devices.

use lsfb_drivers::any_lidar::device_ns;
use lsfb_drivers::xsens::model::SAMPLE_TIME_FINE_NS;
use lsfb_recording::message::{self, ClockModel};
use lsfb_recording::{DEVICE_TIME, Recording};
use lsfb_types::Timestamp;

use super::super::{HOUR_NS, Unwrap};
use crate::{Error, topics};

/// A phone's message that took longer had waited on it, nanoseconds.
const WAITED_NS: i64 = 500_000_000;

/// A recorded triple of stamps.
#[derive(Clone, Copy)]
pub(super) struct Triple {
    pub(super) device_ns: i64,
    pub(super) arrival: Timestamp,
    pub(super) recorded: Timestamp,
}

/// Where counters are found.
pub(super) enum Source {
    Lidar(String),
    Camera(String),
    Imu(String),
    Sidecar(String),
}

pub(super) fn devices(recording: &Recording) -> Vec<Source> {
    let mut found = Vec::new();
    // A LiDAR's counter is in its packets; beside its scans it is repeated.
    let is_lidar = |name: &str| {
        let points = format!("{name}/points");
        recording.topics().iter().any(|t| t.topic == points)
    };
    for topic in recording.topics() {
        match topic.topic.as_str() {
            _ if message::holds_lidar_packets(&topic.schema) => {
                found.push(Source::Lidar(topic.topic.clone()));
            }
            name => {
                if let Some(channel) = name.strip_suffix(DEVICE_TIME) {
                    // What waited to be sent says nothing about a clock; that of its app is told by the others.
                    if !topics::is_occasional(channel) {
                        found.push(Source::Sidecar(name.to_owned()));
                    }
                } else if let Some(camera) = name.strip_suffix("/frame_meta") {
                    found.push(Source::Camera(format!("{camera}/image")));
                } else if let Some(imu) = name.strip_suffix("/time_ref").filter(|n| !is_lidar(n)) {
                    found.push(Source::Imu(imu.to_owned()));
                }
            }
        }
    }
    found
}

impl Source {
    pub(super) fn name(&self) -> String {
        match self {
            Self::Lidar(topic) => topic
                .trim_start_matches('/')
                .trim_end_matches("/packets")
                .to_owned(),
            Self::Camera(topic) => topic
                .trim_start_matches('/')
                .trim_end_matches("/image")
                .to_owned(),
            Self::Imu(topic) => topic.trim_start_matches('/').to_owned(),
            Self::Sidecar(topic) => topic
                .trim_start_matches('/')
                .trim_end_matches(DEVICE_TIME)
                .to_owned(),
        }
    }

    /// One tick of the counter, nanoseconds. Without a recorded model an IMU is an Xsens unit.
    pub(super) fn tick_ns(&self, model: Option<&ClockModel>) -> u64 {
        match self {
            Self::Lidar(_) | Self::Camera(_) => 1_000,
            Self::Imu(_) => model.map_or(SAMPLE_TIME_FINE_NS, |model| model.tick_ns),
            Self::Sidecar(_) => 1,
        }
    }

    pub(super) fn triples(
        &self,
        recording: &Recording,
        model: Option<&ClockModel>,
    ) -> Result<Vec<Triple>, Error> {
        let mut triples = Vec::new();
        match self {
            Self::Lidar(topic) => {
                let mut unwrap = Unwrap::default();
                for packet in recording.packets_on(topic)?.flatten() {
                    let Some(toh_ns) = device_ns(&packet.packet.bytes) else {
                        continue;
                    };
                    let device_ns = unwrap.unwrap(toh_ns.rem_euclid(HOUR_NS), HOUR_NS);
                    triples.push(Triple {
                        device_ns,
                        arrival: packet.packet.arrival,
                        recorded: packet.time,
                    });
                }
                // The revolution's time belongs to its first packet only.
                let mut last = None;
                for triple in &mut triples {
                    if last.replace(triple.recorded) == Some(triple.recorded) {
                        triple.recorded = Timestamp::default();
                    }
                }
            }
            Self::Camera(topic) => {
                for meta in recording.frame_meta(topic)?.flatten() {
                    triples.push(Triple {
                        device_ns: meta.device_ticks.cast_signed().saturating_mul(1_000),
                        arrival: meta.arrival,
                        recorded: meta.time,
                    });
                }
            }
            Self::Imu(imu) => {
                let tick_ns = i64::try_from(self.tick_ns(model)).unwrap_or(1);
                let period = match i64::try_from(model.map_or(1 << 32, |m| m.period_ticks)) {
                    Ok(0) | Err(_) => i64::MAX,
                    Ok(period) => period,
                };
                let topic = format!("{imu}/time_ref");
                triples = references(recording, &topic, tick_ns, period)?;
            }
            Self::Sidecar(topic) => {
                triples = references(recording, topic, 1, i64::MAX)?;
                // What waited on a phone that was out of reach arrived late by that, and not because its clock was set.
                triples.retain(|t| t.arrival - t.recorded <= WAITED_NS);
            }
        }
        Ok(triples)
    }
}

/// Counters that travel as time references.
fn references(
    recording: &Recording,
    topic: &str,
    tick_ns: i64,
    period: i64,
) -> Result<Vec<Triple>, Error> {
    let mut unwrap = Unwrap::default();
    let mut triples = Vec::new();
    for found in recording.messages(topic)?.flatten() {
        let Ok(reference) = message::decode_time_reference(&found.bytes) else {
            continue;
        };
        let ticks = unwrap.unwrap(reference.device_ticks.cast_signed(), period);
        triples.push(Triple {
            device_ns: ticks.saturating_mul(tick_ns),
            arrival: found.arrival,
            recorded: found.time,
        });
    }
    Ok(triples)
}
