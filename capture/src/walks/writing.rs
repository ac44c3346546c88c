//! The file of a walk, while it is written.

use std::collections::BTreeMap;
use std::path::Path;

use lsfb_geometry::Rig;
use lsfb_recording::message::{self, ClockModel, Schema, TimeReference};
use lsfb_recording::{
    CLOCK_MODELS, CdrMessage, Channel, DEVICE_TIME, Recording, Writer, WriterConfig,
};
use lsfb_types::Timestamp;

use super::stamps::{Clock, Stamp};
use super::{Walk, WalkClock};
use crate::Error;
use crate::clock::{ExchangedTime, model_topic};
use crate::sidecar::is_recorders_own;

/// Where frames hang on each other.
const TF_STATIC: &str = "/tf_static";
/// The frame of a recording's rig.
const RIG_FRAME: &str = "rig";
/// Spacing of the clock models in a walk, nanoseconds.
const MODEL_EVERY_NS: i64 = 1_000_000_000;

pub(super) struct Writing<'a> {
    writer: Writer,
    device: &'a str,
    clocks: &'a BTreeMap<String, Clock>,
    /// What is told of each clock.
    told: BTreeMap<String, WalkClock>,
    /// When a model of each clock was written last.
    modelled: BTreeMap<String, Timestamp>,
    pub(super) walk: Walk,
}

impl<'a> Writing<'a> {
    pub(super) fn begin(
        recording: &Recording,
        device: &'a str,
        rig: Option<&Rig>,
        clocks: &'a BTreeMap<String, Clock>,
        path: &Path,
    ) -> Result<Self, Error> {
        let mut writer = Writer::create(path, &config(recording, device))?;
        if let Some(rig) = rig.cloned().or_else(|| rig_of(recording, device)) {
            writer.attach_rig(&rig)?;
            writer.place_sidecar(device, &rig);
        }
        let told = clocks.iter();
        Ok(Self {
            writer,
            device,
            clocks,
            told: told
                .map(|(id, clock)| (id.clone(), clock.told(id)))
                .collect(),
            modelled: BTreeMap::new(),
            walk: Walk {
                device: device.to_owned(),
                path: path.to_owned(),
                messages: 0,
                unreadable: 0,
                mapped: 0,
                unmapped: 0,
                clocks: Vec::new(),
            },
        })
    }

    /// Writes a message, and the device's own stamp beside it.
    pub(super) fn put(
        &mut self,
        channel: &Channel<'_>,
        message: &CdrMessage,
        stamp: Option<&Stamp>,
    ) -> Result<(), Error> {
        let topic = channel.topic;
        let arrival = message.arrival;
        let mut time = message.time;
        if let Some(stamp) = stamp {
            if let Some(found) = stamp.found {
                time = found.time;
                self.walk.mapped += 1;
                self.tell(stamp, &found, arrival)?;
            }
            let reference = TimeReference {
                device_ticks: stamp.device_ns.unsigned_abs(),
                source: stamp.clock_id.clone(),
            };
            if let Some(bytes) = message::encode_time_reference(time, &stamp.clock_id, &reference) {
                let beside = format!("{topic}{DEVICE_TIME}");
                self.write_own(&beside, message::TIME_REFERENCE, time, arrival, &bytes)?;
            }
        }
        self.writer
            .write_cdr(channel, time, arrival, &message.bytes)?;
        self.walk.messages += u64::from(!is_recorders_own(topic));
        Ok(())
    }

    /// Says once a second how a clock is read.
    fn tell(
        &mut self,
        stamp: &Stamp,
        found: &ExchangedTime,
        arrival: Timestamp,
    ) -> Result<(), Error> {
        if let Some(told) = self.told.get_mut(&stamp.clock_id) {
            let sigma_us = found.sigma_ns / 1e3;
            told.sigma_us = Some(told.sigma_us.map_or(sigma_us, |most| most.max(sigma_us)));
        }
        let last = self.modelled.get(&stamp.clock_id);
        if last.is_some_and(|last| (arrival - *last).abs() < MODEL_EVERY_NS) {
            return Ok(());
        }
        self.modelled.insert(stamp.clock_id.clone(), arrival);
        let clock = self.clocks.get(&stamp.clock_id);
        let exchanged = clock.and_then(|clock| clock.exchanged.as_ref());
        let model = ClockModel {
            device: self.device.to_owned(),
            kind: model_topic::EXCHANGED.to_owned(),
            epoch: found.epoch,
            reference_device_ns: stamp.device_ns,
            reference_time_ns: found.time.nanos(),
            skew: found.skew,
            sigma_ns: found.sigma_ns,
            sigma_skew: found.sigma_skew,
            pairs: exchanged.map_or(0, |clock| clock.exchanges),
            tick_ns: 1,
            period_ticks: 0,
        };
        let bytes = message::encode_clock_model(found.time, self.device, &model);
        let topic = format!("{CLOCK_MODELS}{}", self.device);
        self.write_own(&topic, message::CLOCK_MODEL, found.time, arrival, &bytes)
    }

    fn write_own(
        &mut self,
        topic: &str,
        schema: Schema,
        time: Timestamp,
        arrival: Timestamp,
        bytes: &[u8],
    ) -> Result<(), Error> {
        let channel = Channel {
            topic,
            schema_name: schema.name,
            schema_text: schema.text,
        };
        Ok(self.writer.write_cdr(&channel, time, arrival, bytes)?)
    }

    pub(super) fn finish(mut self) -> Result<Walk, Error> {
        self.writer.finish()?;
        self.walk.clocks = self.told.into_values().collect();
        Ok(self.walk)
    }
}

/// The rig that the device brought: its own attachment, or the recording's where the device's frames hang on that.
fn rig_of(recording: &Recording, device: &str) -> Option<Rig> {
    let name = format!("sidecar/{device}/rig.toml");
    match recording.attachment(&name) {
        Ok(bytes) => Rig::from_toml(&String::from_utf8_lossy(&bytes), &name).ok(),
        Err(_) => recording
            .rig()
            .ok()
            .filter(|_| is_own_rig(recording, device)),
    }
}

fn is_own_rig(recording: &Recording, device: &str) -> bool {
    let prefix = format!("{device}/");
    let Ok(messages) = recording.messages(TF_STATIC) else {
        return false;
    };
    let mut edges = messages.flatten().flat_map(|message| {
        message::decode_poses(message::TF_MESSAGE.name, &message.bytes).unwrap_or_default()
    });
    edges.any(|edge| edge.frame == RIG_FRAME && edge.child_frame.starts_with(&prefix))
}

fn config(recording: &Recording, device: &str) -> WriterConfig {
    let mut session = recording.metadata("lsfb.session").unwrap_or_default();
    // It is no part of a recording in parts.
    for name in ["part", "previous", "software"] {
        session.remove(name);
    }
    let scan = recording.path().file_name().unwrap_or_default();
    session.insert("walk_of".to_owned(), device.to_owned());
    session.insert(
        "recorded_in".to_owned(),
        scan.to_string_lossy().into_owned(),
    );
    WriterConfig {
        session,
        ..WriterConfig::default()
    }
}
