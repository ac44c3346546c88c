//! A phone or AR glasses: images, inertial samples and what is around, through the sidecar stream.

use std::sync::Arc;
use std::time::Duration;

use lsfb_drivers::sidecar::ClientConfig;

use super::clock::{SimClock, Turn};
use super::feed::{Shot, ShotFeed, Which};
use super::outbox::{Content, Outbox};
use super::rig_link;
use crate::{Error, Simulation};

/// The app on the device.
pub(crate) struct GlassesDevice {
    rig: ClientConfig,
    patience: Duration,
}

impl GlassesDevice {
    /// Will connect to the rig as `device`, and look for it so long.
    pub(crate) fn new(rig: &ClientConfig, device: &str, patience: Duration) -> Self {
        Self {
            rig: ClientConfig {
                device: device.to_owned(),
                ..rig.clone()
            },
            patience,
        }
    }

    /// Connects, describes the channels and sends the whole walk in order of time. Returns the messages sent.
    pub(crate) fn run(
        self,
        simulation: &Arc<Simulation>,
        clock: &SimClock,
        device: usize,
    ) -> Result<u64, Error> {
        let Some(mut client) = rig_link::connect(&self.rig, self.patience, clock)? else {
            return Ok(0);
        };
        let mut sent = 0;
        let outbox = Outbox::of(simulation);
        for channel in outbox.channels() {
            client.advertise(&channel)?;
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
            client.send(message.channel, message.device_time_ns, &message.payload)?;
            sent += 1;
        }
        client.bye()?;
        Ok(sent)
    }
}
