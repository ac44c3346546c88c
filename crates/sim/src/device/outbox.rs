//! What the app on the phone or the glasses sends, in the order in which it does.

use lsfb_drivers::sidecar::model::CLOCK_UTC;
use lsfb_drivers::sidecar::wire::Advertise;
use lsfb_recording::message::{IMAGE, IMU, ImuVariance, Schema, encode_image, encode_imu};
use lsfb_types::{Image, Timestamp};

use crate::ambient::{AmbientChannel, AmbientMessage};
use crate::timing::{Clocked, DeviceClock, Discipline};
use crate::{RigSim, Simulation};

/// Channel of the inertial samples; the cameras' follow, then those of the surroundings.
const IMU_CHANNEL: u32 = 1;
/// What a phone calls the clock that stamps all its sensors and counts from its start.
const CLOCK_BOOT: &str = "android.elapsedRealtime";

/// One message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Item {
    /// When the app has it, nanoseconds after the beginning.
    pub ready_ns: i64,
    pub content: Content,
    /// When it was measured.
    pub measured_ns: i64,
}

/// What is in it, by number; what is ready at the same time is sent in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Content {
    Imu(usize),
    Image { frame: u32, camera: usize },
    Ambient(usize),
}

/// A message that is ready for the wire.
pub(super) struct Outgoing {
    pub channel: u32,
    /// On the device's clock.
    pub device_time_ns: i64,
    pub payload: Vec<u8>,
}

/// Everything a walk's device sends.
pub(super) struct Outbox<'a> {
    rig: &'a RigSim,
    cameras: Vec<&'a String>,
    ambient: Vec<AmbientMessage>,
    items: Vec<Item>,
}

impl<'a> Outbox<'a> {
    pub(super) fn of(simulation: &'a Simulation) -> Self {
        let rig = simulation.glasses();
        let ambient = simulation
            .surroundings()
            .messages(simulation.world(), rig.walk());
        let cameras: Vec<&String> = rig.rig().cameras.keys().collect();
        let mut items: Vec<Item> = Vec::new();
        items.extend(rig.imu().iter().enumerate().map(|(k, sample)| Item {
            ready_ns: sample.offset_ns,
            content: Content::Imu(k),
            measured_ns: sample.offset_ns,
        }));
        for frame in 0..rig.frame_count() {
            let offset_ns = rig.frame_offset_ns(frame);
            items.extend((0..cameras.len()).map(|camera| Item {
                ready_ns: offset_ns,
                content: Content::Image { frame, camera },
                measured_ns: offset_ns,
            }));
        }
        items.extend(ambient.iter().enumerate().map(|(k, message)| Item {
            ready_ns: message.ready_ns,
            content: Content::Ambient(k),
            measured_ns: message.measured_ns,
        }));
        items.sort_unstable();
        Self {
            rig,
            cameras,
            ambient,
            items,
        }
    }

    /// In order.
    pub(super) fn items(&self) -> &[Item] {
        &self.items
    }

    fn clock(&self) -> &DeviceClock {
        self.rig.clocks().of(Clocked::Walker)
    }

    /// The channels, each described.
    pub(super) fn channels(&self) -> Vec<Advertise> {
        let clock_id = match self.clock().discipline() {
            Discipline::Utc => CLOCK_UTC,
            Discipline::Free => CLOCK_BOOT,
        };
        let device = &self.rig.rig().name;
        let describe = |channel: u32, topic: &str, schema: Schema| Advertise {
            channel,
            topic: format!("/sidecar/{device}/{topic}"),
            encoding: "cdr".to_owned(),
            schema_name: schema.name.to_owned(),
            schema: schema.text.as_bytes().to_vec(),
            clock_id: clock_id.to_owned(),
            metadata_json: "{}".to_owned(),
        };
        // The device's calibration travels with its first channel.
        let mut channels = vec![Advertise {
            metadata_json: serde_json::json!({ "rig_toml": self.rig.stated_rig().to_toml() })
                .to_string(),
            ..describe(IMU_CHANNEL, "imu", IMU)
        }];
        for (camera, name) in self.cameras.iter().enumerate() {
            let topic = format!("{name}/image");
            channels.push(describe(self.camera_channel(camera), &topic, IMAGE));
        }
        for kind in AmbientChannel::ALL {
            if self.ambient.iter().any(|m| m.channel() == kind) {
                channels.push(describe(
                    self.ambient_channel(kind),
                    kind.name(),
                    kind.schema(),
                ));
            }
        }
        channels
    }

    fn camera_channel(&self, camera: usize) -> u32 {
        IMU_CHANNEL + 1 + camera as u32
    }

    fn ambient_channel(&self, kind: AmbientChannel) -> u32 {
        self.camera_channel(self.cameras.len()) + kind as u32
    }

    /// A message for the wire. `image` is that of its frame and camera, where it is one of an image. `None`: there is none.
    pub(super) fn outgoing(&self, item: &Item, image: Option<&Image>) -> Option<Outgoing> {
        let device_time_ns = self.clock().device_ns(item.measured_ns);
        // The app knows no other time than its device's.
        let stamp = Timestamp::from_nanos(device_time_ns);
        let (channel, payload) = match item.content {
            Content::Imu(k) => (
                IMU_CHANNEL,
                encode_imu(
                    stamp,
                    "imu0",
                    &self.rig.imu().get(k)?.sample,
                    ImuVariance::UNKNOWN,
                ),
            ),
            Content::Image { camera, .. } => (
                self.camera_channel(camera),
                encode_image(stamp, self.cameras.get(camera)?, image?),
            ),
            Content::Ambient(k) => {
                let message = self.ambient.get(k)?;
                (
                    self.ambient_channel(message.channel()),
                    message.encode(stamp),
                )
            }
        };
        Some(Outgoing {
            channel,
            device_time_ns,
            payload,
        })
    }
}
