//! Odometry of a bag of ROS: clouds, or packets that are decoded first.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

use anyhow::{Context as _, bail};
use lsfb_capture::CaptureReport;
use lsfb_datasets::{LidarMessages, LidarTopic, RosBag, Unread};
use lsfb_drivers::transport::PacketSource;
use lsfb_pipeline::odometry::{OdometryConfig, TimedScan};
use lsfb_types::{Packet, Progress, Stamped};

use super::packets::{about_packets, decode, run_on_scans};
use super::scratch::Scratch;
use super::sensors::{Sensors, about_unread};
use super::{Choice, InputReport, Run};
use crate::commands::about;
use crate::context::Context;

/// Messages of packets that wait to be decoded.
const WAITING_MESSAGES: usize = 4;

/// Runs the odometry on a bag.
pub(super) fn run(
    choice: &Choice,
    config: &OdometryConfig,
    context: &Context,
) -> anyhow::Result<Run> {
    let bag = RosBag::open(choice.path)?;
    let LidarTopic { topic, messages } = bag.lidar(choice.lidar)?;
    let mut said = InputReport {
        lidar_topic: Some(topic.clone()),
        scan_times: "message stamps".to_owned(),
        warnings: about_damage(&bag, context),
        ..InputReport::default()
    };
    let sensors = Sensors::of_bag(&bag, choice, &bag.frame(&topic)?, &mut said, context)?;
    let mut run = sensors.start(choice, config)?;
    if messages == LidarMessages::Packets {
        let scratch = Scratch::new("packets")?;
        let (decoded, unread) = decode_bag(&topic, &scratch.scans, choice, context)?;
        said.warnings.extend(about_unread(&unread, context));
        said.scan_times = "packets".to_owned();
        said.warnings.extend(about_packets(&decoded, context));
        let result = run_on_scans(&scratch.scans, run, context)?;
        return Ok(Run {
            result,
            input: said,
        });
    }
    let mut clocks = 0_u64;
    let unread = bag.clouds(&topic, &mut |message| {
        context.show(Progress {
            stage: "lidar odometry",
            done: run.taken(),
            total: 0,
        })?;
        clocks += u64::from(message.has_two_clocks());
        let time = message.begins();
        run.push(TimedScan {
            scan: Stamped {
                time,
                arrival: message.stamp,
                device_ticks: 0,
                sample: message.cloud.scan,
            },
            times: message.cloud.times,
        })?;
        anyhow::Ok(())
    })?;
    said.warnings.extend(about_unread(&unread, context));
    if clocks > 0 {
        said.warnings.push(format!(
            "the points of {clocks} scans have times of another clock than the message stamps: only their differences are used"
        ));
    }
    Ok(Run {
        result: about(choice.path, run.finish())?,
        input: said,
    })
}

/// Why no more packets are read from a bag.
enum Ended {
    Bag(lsfb_datasets::Error),
    /// Nobody takes them any more.
    Unwanted,
}

impl From<lsfb_datasets::Error> for Ended {
    fn from(error: lsfb_datasets::Error) -> Self {
        Self::Bag(error)
    }
}

/// Decodes the packets of a bag. They are read on a thread of their own, as a bag gives and a decoder takes.
fn decode_bag(
    topic: &str,
    out: &Path,
    choice: &Choice,
    context: &Context,
) -> anyhow::Result<(CaptureReport, Unread)> {
    let (send, waiting) = sync_channel(WAITING_MESSAGES);
    let read = move || {
        let bag = RosBag::open(choice.path)?;
        bag.packets(topic, &mut |packets| {
            send.send(packets).map_err(|_| Ended::Unwanted)
        })
    };
    std::thread::scope(|scope| {
        let reader = std::thread::Builder::new().name("bag-packets".to_owned());
        let reader = reader.spawn_scoped(scope, read);
        let reader = reader.context("cannot start the thread that reads the bag")?;
        let source = BagPackets {
            waiting,
            packets: VecDeque::new(),
        };
        let decoded = decode(source, out, choice, context)?;
        match reader.join() {
            Ok(Ok(unread)) => Ok((decoded, unread)),
            Ok(Err(Ended::Unwanted)) => Ok((decoded, Unread::default())),
            Ok(Err(Ended::Bag(error))) => Err(error.into()),
            Err(_) => bail!("{}: the thread that reads it failed", choice.path.display()),
        }
    })
}

/// Packets that another thread reads.
struct BagPackets {
    waiting: Receiver<Vec<Packet>>,
    packets: VecDeque<Packet>,
}

impl PacketSource for BagPackets {
    fn recv(&mut self, _timeout: Duration) -> Result<Option<Packet>, lsfb_drivers::Error> {
        while self.packets.is_empty() {
            match self.waiting.recv() {
                Ok(packets) => self.packets.extend(packets),
                Err(_) => {
                    return Err(lsfb_drivers::Error::EndOfStream {
                        device: "bag".to_owned(),
                    });
                }
            }
        }
        Ok(self.packets.pop_front())
    }
}

/// What is missing from a bag that ends early or is torn: data is lost then.
fn about_damage(bag: &RosBag, context: &Context) -> Vec<String> {
    let damage = bag.damage();
    if !damage.is_empty() {
        context.lose_data();
    }
    damage
}
