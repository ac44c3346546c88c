//! Which topics an app may fill: one topic carries one schema, and belongs to one device.

use std::collections::BTreeMap;

use lsfb_drivers::sidecar::wire::Advertise;
use lsfb_recording::DEVICE_TIME;

/// The only encoding a recording holds.
const ENCODING: &str = "cdr";
/// Most topics of all devices that ever came: a recording holds 65 535.
const MAX_TOPICS: usize = 4_096;
/// Longest topic, bytes.
const MAX_TOPIC_BYTES: usize = 256;
/// Longest schema, bytes.
const MAX_SCHEMA_BYTES: usize = 256 << 10;
/// Where the exchanges of times of a device go, below `/sidecar/<id>`.
pub(crate) const TIME_SYNC: &str = "/time_sync";
/// Where a device's sessions begin in a recording, below `/sidecar/<id>`.
pub(super) const SESSION: &str = "/session";
/// Intrinsics are made of the device's rig.
pub(crate) const CAMERA_INFO: &str = "/camera_info";

/// A topic of the recorder's own among those of a device.
pub(crate) fn is_recorders_own(topic: &str) -> bool {
    [DEVICE_TIME, TIME_SYNC, SESSION, CAMERA_INFO]
        .iter()
        .any(|end| topic.ends_with(end))
}

/// Where everything of a device lies.
pub(super) fn prefix_of(device: &str) -> String {
    format!("/sidecar/{device}/")
}

/// What was ever described in this recording: topic → name and text of its schema.
#[derive(Debug, Default)]
pub(crate) struct Topics {
    schemas: BTreeMap<String, (String, Vec<u8>)>,
}

impl Topics {
    /// Takes a channel that a device describes, or says why it cannot be recorded.
    pub(crate) fn admit(&mut self, device: &str, described: &Advertise) -> Result<(), String> {
        let Advertise {
            topic,
            encoding,
            schema_name,
            schema,
            ..
        } = described;
        let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '/' | '_' | '-' | '.');
        if topic.len() > MAX_TOPIC_BYTES || !topic.chars().all(is_plain) {
            return Err(format!(
                "a topic is plain ASCII of at most {MAX_TOPIC_BYTES} characters, and {topic:?} is not"
            ));
        }
        let below = topic.strip_prefix(&prefix_of(device));
        if below.is_none_or(str::is_empty) {
            return Err(format!(
                "{topic} is not a topic of {device}: they begin with /sidecar/{device}/"
            ));
        }
        if is_recorders_own(topic) {
            return Err(format!("{topic}: this topic is reserved for the recorder"));
        }
        if encoding != ENCODING {
            return Err(format!(
                "{topic}: encoding {encoding:?} is not supported, only {ENCODING:?}"
            ));
        }
        if schema_name.len() > MAX_TOPIC_BYTES || schema.len() > MAX_SCHEMA_BYTES {
            return Err(format!(
                "{topic}: a schema may have at most {MAX_SCHEMA_BYTES} bytes, and its name {MAX_TOPIC_BYTES}"
            ));
        }
        match self.schemas.get(topic) {
            Some((name, text)) if (name, text) == (schema_name, schema) => return Ok(()),
            Some((name, _)) => {
                return Err(format!(
                    "{topic}: the recording has {name} there, not the advertised {schema_name}"
                ));
            }
            None if self.schemas.len() >= MAX_TOPICS => {
                return Err(format!(
                    "{topic}: there are {MAX_TOPICS} topics already, the maximum"
                ));
            }
            None => {}
        }
        self.schemas
            .insert(topic.clone(), (schema_name.clone(), schema.clone()));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn channel(topic: &str, schema: &str) -> Advertise {
        Advertise {
            channel: 1,
            topic: topic.to_owned(),
            encoding: ENCODING.to_owned(),
            schema_name: "std_msgs/msg/UInt32".to_owned(),
            schema: schema.as_bytes().to_vec(),
            ..Advertise::default()
        }
    }

    #[test]
    fn a_device_fills_its_own_topics_each_with_one_schema() {
        let mut topics = Topics::default();
        let good = channel("/sidecar/visor/note", "uint32 data");
        topics.admit("visor", &good).unwrap();
        topics.admit("visor", &good).unwrap();
        for (device, topic, schema) in [
            // Somebody else's, whose name begins alike too.
            ("rude", "/sidecar/visor/note", "uint32 data"),
            ("vis", "/sidecar/visor/x", "uint32 data"),
            ("visor", "/sidecar/visor/", "uint32 data"),
            ("visor", "/lidar/points", "uint32 data"),
            ("visor", "/sidecar/visor/note", "string data"),
            ("visor", "/sidecar/visor/note/device_time", "uint32 data"),
            ("visor", "/sidecar/visor/session", "uint32 data"),
            ("visor", "/sidecar/visor/time_sync", "uint32 data"),
            ("visor", "/sidecar/visor/cam0/camera_info", "uint32 data"),
            ("visor", "/sidecar/visor/é", "uint32 data"),
        ] {
            let refused = topics.admit(device, &channel(topic, schema));
            assert!(refused.is_err(), "{device} {topic}");
        }
        let json = Advertise {
            encoding: "json".to_owned(),
            ..channel("/sidecar/visor/other", "{}")
        };
        assert!(topics.admit("visor", &json).is_err());
    }
}
