//! A phone or AR glasses: images, inertial samples and what is around, through the sidecar stream.

use std::net::SocketAddr;
use std::sync::Arc;

use lsfb_drivers::sidecar::{ClientConfig, SidecarClient};

use super::clock::{SimClock, Turn};
use super::feed::{Shot, ShotFeed, Which};
use super::outbox::{Content, DEVICE, Outbox};
use crate::{Error, Simulation};

/// The app on the device.
pub(crate) struct GlassesDevice {
    client: SidecarClient,
    sent: u64,
}

impl GlassesDevice {
    /// Connects to the rig.
    pub(crate) fn connect(address: SocketAddr, session: &str) -> Result<Self, Error> {
        let client = SidecarClient::connect(ClientConfig {
            address,
            device: DEVICE.to_owned(),
            session: session.to_owned(),
            ..ClientConfig::default()
        })?;
        Ok(Self { client, sent: 0 })
    }

    /// Describes the channels and sends the whole walk in order of time. Returns the messages sent.
    pub(crate) fn run(
        mut self,
        simulation: &Arc<Simulation>,
        clock: &SimClock,
        device: usize,
    ) -> Result<u64, Error> {
        let outbox = Outbox::of(simulation);
        for channel in outbox.channels() {
            self.client.advertise(&channel)?;
        }
        let feed = ShotFeed::start(
            "sim-glasses-render",
            Arc::clone(simulation),
            Which::Glasses,
            (0..simulation.glasses().rig().cameras.len()).collect(),
        )?;
        let mut shot: Option<Shot> = None;
        for item in outbox.items() {
            let mut image = None;
            if let Content::Image { frame, camera } = item.content {
                if shot.as_ref().is_none_or(|s| s.frame != frame) {
                    shot = feed.wait();
                    if clock.reach(device, item.ready_ns) == Turn::Stop {
                        break;
                    }
                }
                image = shot.as_ref().and_then(|s| s.images.get(camera));
            }
            let Some(message) = outbox.outgoing(item, image) else {
                continue;
            };
            self.client
                .send(message.channel, message.device_time_ns, &message.payload)?;
            self.sent += 1;
        }
        self.client.bye()?;
        Ok(self.sent)
    }
}
