//! AR glasses: images and inertial samples through the sidecar stream.

use std::net::SocketAddr;
use std::sync::Arc;

use lsfb_drivers::phone::model::CLOCK_UTC;
use lsfb_drivers::phone::wire::Advertise;
use lsfb_drivers::phone::{ClientConfig, SidecarClient};
use lsfb_recording::message::{IMAGE, IMU, Schema, encode_image, encode_imu};

use super::clock::{SimClock, Turn};
use super::feed::{ShotFeed, Which};
use crate::{BiasedSample, Error, RigSim, Simulation};

/// Name of the device in its topics.
const DEVICE: &str = "glasses";
/// Channel of the inertial samples; the cameras' follow.
const IMU_CHANNEL: u32 = 1;

/// The app on the glasses.
pub(crate) struct GlassesDevice {
    client: SidecarClient,
    sent: u64,
}

impl GlassesDevice {
    /// Connects to the rig and describes the channels.
    pub(crate) fn connect(rig: &RigSim, address: SocketAddr, session: &str) -> Result<Self, Error> {
        let mut client = SidecarClient::connect(ClientConfig {
            address,
            device: DEVICE.to_owned(),
            session: session.to_owned(),
            ..ClientConfig::default()
        })?;
        // The device's calibration travels with its first channel.
        client.advertise(&Advertise {
            metadata_json: serde_json::json!({ "rig_toml": rig.rig().to_toml() }).to_string(),
            ..advertise(IMU_CHANNEL, "imu", IMU)
        })?;
        for (camera, name) in rig.rig().cameras.keys().enumerate() {
            let topic = format!("{name}/image");
            client.advertise(&advertise(camera_channel(camera), &topic, IMAGE))?;
        }
        Ok(Self { client, sent: 0 })
    }

    /// Sends the whole walk in order of time. Returns the messages sent.
    pub(crate) fn run(
        mut self,
        simulation: &Arc<Simulation>,
        clock: &SimClock,
        device: usize,
    ) -> Result<u64, Error> {
        let rig = simulation.glasses();
        let names: Vec<&String> = rig.rig().cameras.keys().collect();
        let feed = ShotFeed::start(
            "sim-glasses-render",
            Arc::clone(simulation),
            Which::Glasses,
            (0..names.len()).collect(),
        )?;
        let mut imu = rig.imu().iter().peekable();
        while let Some(shot) = feed.wait() {
            while let Some(sample) = imu.next_if(|s| s.offset_ns <= shot.offset_ns) {
                self.send_imu(rig, sample)?;
            }
            if clock.reach(device, shot.offset_ns) == Turn::Stop {
                break;
            }
            let time = rig.time(shot.offset_ns);
            for (camera, (image, name)) in shot.images.iter().zip(&names).enumerate() {
                let payload = encode_image(time, name, image);
                self.client
                    .send(camera_channel(camera), time.nanos(), &payload)?;
                self.sent += 1;
            }
        }
        if !clock.is_stopped() {
            for sample in imu {
                self.send_imu(rig, sample)?;
            }
        }
        self.client.bye()?;
        Ok(self.sent)
    }

    fn send_imu(&mut self, rig: &RigSim, sample: &BiasedSample) -> Result<(), Error> {
        let time = rig.time(sample.offset_ns);
        let payload = encode_imu(time, "imu", &sample.sample);
        self.client.send(IMU_CHANNEL, time.nanos(), &payload)?;
        self.sent += 1;
        Ok(())
    }
}

fn camera_channel(camera: usize) -> u32 {
    IMU_CHANNEL + 1 + camera as u32
}

fn advertise(channel: u32, topic: &str, schema: Schema) -> Advertise {
    Advertise {
        channel,
        topic: format!("/sidecar/{DEVICE}/{topic}"),
        encoding: "cdr".to_owned(),
        schema_name: schema.name.to_owned(),
        schema: schema.text.as_bytes().to_vec(),
        clock_id: CLOCK_UTC.to_owned(),
        metadata_json: "{}".to_owned(),
    }
}
