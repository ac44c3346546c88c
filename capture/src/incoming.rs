//! Packets that somebody else received, with their arrivals → Recording, through the functions used live. Nothing here looks
//! at the host's clock: the same packets give the same messages.

use std::path::Path;

use lsfb_drivers::sidecar::SidecarMessage;
use lsfb_geometry::Rig;
use lsfb_types::{Packet, Progress, ProgressFn, Timestamp};

use crate::camera::CameraStream;
use crate::config::{DevicesConfig, Overflow};
use crate::control::Control;
use crate::health::{Ending, Meter, StreamReport};
use crate::imu::{self, ImuStream};
use crate::lidar::LidarStream;
use crate::recorder::{self, Recorder, RecorderSender, WriterGone};
use crate::sidecar::{Apps, Topics};
use crate::{CaptureReport, Error};

/// Packets between two looks at progress; simulated images among them take their time.
const SHOW_EVERY: u64 = 64;

/// Something that arrived.
#[derive(Clone, Debug, PartialEq)]
pub enum Incoming {
    /// A datagram of a LiDAR, of either kind.
    Lidar {
        /// Which of [`DevicesConfig::lidars`].
        lidar: usize,
        /// Its bytes.
        packet: Packet,
    },
    /// A packet of an IMU.
    Imu {
        /// Which of [`DevicesConfig::imus`].
        imu: usize,
        /// Its bytes.
        packet: Packet,
    },
    /// A frame of a camera unit.
    Frame {
        /// Which of [`DevicesConfig::cameras`].
        unit: usize,
        /// Its bytes.
        packet: Packet,
    },
    /// What a phone or glasses said.
    Sidecar {
        /// When it arrived.
        arrival: Timestamp,
        /// What it said.
        message: SidecarMessage,
    },
}

/// Records what arrives, in its order, into `out`. `config` says what the devices are; none is opened. What comes from devices
/// that it does not name is passed over. What is told to stop leaves nothing.
pub fn record_incoming(
    incoming: impl Iterator<Item = Incoming>,
    config: &DevicesConfig,
    out: &Path,
    progress: ProgressFn<'_>,
) -> Result<CaptureReport, Error> {
    config.check()?;
    recorder::make_folder(out)?;
    let rig = config.rig.as_deref().map(Rig::read).transpose()?;
    let names: Vec<Vec<String>> = config.cameras.iter().map(|c| c.names.clone()).collect();
    let recorder = Recorder::start(out, rig, &names, &config.recorder, Overflow::Wait)?;
    let to_recorder = recorder.sender();
    imu::introduce(&config.imus, &to_recorder);
    let mut streams = Streams::new(config)?;
    let mut ending = Ending::EndOfStream;
    let mut told = Ok(());
    for (taken, item) in (0_u64..).zip(incoming) {
        if taken.is_multiple_of(SHOW_EVERY) {
            told = progress(Progress {
                stage: "recording",
                done: taken,
                total: 0,
            });
        }
        if told.is_err() || streams.take(item, &to_recorder).is_err() {
            ending = Ending::Stopped;
            break;
        }
    }
    let reports = streams.finish(&ending, &to_recorder);
    drop(to_recorder);
    let written = recorder.finish(&reports)?;
    told.inspect_err(|_| written.discard())?;
    Ok(written.report(out, reports))
}

/// One stream for each device that is configured.
struct Streams {
    control: Control,
    lidars: Vec<LidarStream>,
    imus: Vec<(ImuStream, Meter)>,
    cameras: Vec<(CameraStream, Meter)>,
    sidecar: Option<Sidecar>,
}

/// The one phone or pair of glasses.
struct Sidecar {
    apps: Apps,
    topics: Topics,
    device: String,
}

impl Sidecar {
    fn take(
        &mut self,
        arrival: Timestamp,
        message: SidecarMessage,
        to_recorder: &RecorderSender,
    ) -> Result<(), WriterGone> {
        match &message {
            SidecarMessage::Hello(hello) => self.device.clone_from(&hello.device),
            SidecarMessage::Advertise(described) => {
                if let Err(why) = self.topics.admit(&self.device, described) {
                    self.apps.refuse(why);
                    return Ok(());
                }
            }
            _ => {}
        }
        let device = &self.device;
        self.apps
            .message(device, arrival, message, None, to_recorder)
    }
}

impl Streams {
    fn new(config: &DevicesConfig) -> Result<Self, Error> {
        let lidars = config.lidars.iter().map(|net| {
            let meter = Meter::new(&net.name);
            Ok::<_, Error>(LidarStream::new(&net.name, net.decoder()?, &meter))
        });
        let imus = config.imus.iter().map(|line| {
            let meter = Meter::new(&line.name);
            (ImuStream::new(line, &meter), meter)
        });
        Ok(Self {
            control: Control::alone(),
            lidars: lidars.collect::<Result<_, _>>()?,
            imus: imus.collect(),
            cameras: config
                .cameras
                .iter()
                .map(|unit| {
                    let meter = Meter::new(&unit.names.join("+"));
                    (CameraStream::new(unit, None, &meter), meter)
                })
                .collect(),
            sidecar: config.sidecar.as_ref().map(|_| Sidecar {
                apps: Apps::new(&Meter::new("sidecar"), None),
                topics: Topics::default(),
                device: String::new(),
            }),
        })
    }

    fn take(&mut self, item: Incoming, to_recorder: &RecorderSender) -> Result<(), WriterGone> {
        match item {
            Incoming::Lidar { lidar, packet } => match self.lidars.get_mut(lidar) {
                Some(stream) => stream.push(packet, to_recorder),
                None => Ok(()),
            },
            Incoming::Imu { imu, packet } => match self.imus.get_mut(imu) {
                Some((stream, meter)) => stream.packet(packet, to_recorder, meter),
                None => Ok(()),
            },
            Incoming::Frame { unit, packet } => match self.cameras.get_mut(unit) {
                Some((stream, meter)) => stream.frame(&packet, to_recorder, &self.control, meter),
                None => Ok(()),
            },
            Incoming::Sidecar { arrival, message } => match &mut self.sidecar {
                Some(sidecar) => sidecar.take(arrival, message, to_recorder),
                None => Ok(()),
            },
        }
    }

    fn finish(self, ending: &Ending, to_recorder: &RecorderSender) -> Vec<StreamReport> {
        let mut reports = Vec::new();
        let lidars = self.lidars.into_iter();
        reports.extend(lidars.map(|s| s.finish(ending.clone(), to_recorder)));
        for (stream, _) in self.cameras {
            let report = stream.finish();
            reports.push(StreamReport {
                ending: ending.clone(),
                ..report
            });
        }
        for (mut stream, meter) in self.imus {
            // A writer that is gone reports itself.
            let _ = stream.rest(to_recorder, &meter);
            reports.push(StreamReport {
                ending: ending.clone(),
                ..stream.finish(0)
            });
        }
        reports.extend(self.sidecar.map(|sidecar| StreamReport {
            ending: ending.clone(),
            ..sidecar.apps.into_report()
        }));
        reports.iter_mut().for_each(StreamReport::name_silence);
        reports
    }
}
