//! Capture files → Recording, through the functions used live.

use std::collections::BTreeSet;
use std::iter::Peekable;
use std::net::IpAddr;
use std::path::Path;
use std::time::Duration;

use lsfb_drivers::any_lidar::Settings;
use lsfb_drivers::transport::PacketSource;
use lsfb_geometry::{MAIN_LIDAR, Rig};
use lsfb_recording::{Damage, RecordedPacket, Recording, lidar_position};
use lsfb_types::{Progress, ProgressFn, Timestamp};

use crate::config::{DEVICE_NAMES, Overflow, RecorderConfig};
use crate::health::{Ending, Meter, StreamReport};
use crate::lidar::{LidarStream, Lidars};
use crate::recorder::{self, Recorder, RecorderSender, WriterGone};
use crate::{CaptureReport, Error};

/// Packets between two looks at progress.
const SHOW_EVERY: u64 = 1_000;

/// How a capture file is read.
#[derive(Clone, Debug, Default)]
pub struct ReplayConfig {
    /// Model, beam angles, and where scans are cut.
    pub lidar: Settings,
    /// The sensors whose packets are taken; without any, every sender of what a LiDAR sends is one: `lidar`, `lidar2`, …
    pub sensors: Vec<ReplayedSensor>,
    /// Attached to the recording; without it, the rig of the recording that is replayed, if it has one.
    pub rig: Option<Rig>,
    /// Files and disks.
    pub recorder: RecorderConfig,
}

/// A sensor of a capture file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReplayedSensor {
    /// Its name in the new recording.
    pub name: String,
    /// Its address in the capture file.
    pub address: IpAddr,
}

/// Records the LiDAR packets of `source` into `out`, with the arrival stamps they have there, each LiDAR under a name of its own. A
/// file that is damaged in the middle gives what lies before, and the damage is the streams' [`Ending::Lost`]. An import that is told to stop, or
/// in which packets of two sensors are mixed, leaves nothing.
pub fn replay(
    mut source: impl PacketSource,
    config: &ReplayConfig,
    out: &Path,
    progress: ProgressFn<'_>,
) -> Result<CaptureReport, Error> {
    DEVICE_NAMES.check(config.sensors.iter().map(|s| ("lidar.name", &*s.name)))?;
    check_angles(
        &config.lidar,
        config.sensors.iter().map(|s| s.name.as_str()),
    )?;
    let mut lidars = match config.sensors.as_slice() {
        [] => Lidars::as_found(config.lidar.clone()),
        sensors => Lidars::named(sensors.iter().map(|sensor| {
            let stream = new_stream(&sensor.name, &config.lidar);
            (stream, Some(sensor.address))
        })),
    };
    let import = Import::begin(out, config.rig.clone(), &config.recorder)?;
    let (ending, told) = import.take_all(progress, |to_recorder| {
        // A file gives its packets or its end at once.
        match source.recv(Duration::ZERO) {
            Ok(Some(packet)) => match lidars.push(packet, source.sender(), to_recorder) {
                Ok(_) => lidars.mixture().map_or(Next::Taken, Next::Refused),
                Err(WriterGone) => Next::Ended(Ending::Stopped),
            },
            Ok(None) => Next::Taken,
            Err(lsfb_drivers::Error::EndOfStream { .. }) => Next::Ended(Ending::EndOfStream),
            Err(error) => Next::Ended(Ending::Lost(error.to_string())),
        }
    });
    let told = told.and_then(|()| lidars.drain(&import.to_recorder));
    let reports = lidars.finish(&ending, &import.to_recorder);
    import.finish(reports, told)
}

/// Records the LiDAR packets of an MCAP file, one of `rosbag2` or one of ours, as [`replay`] does: each topic of packets is a LiDAR. What is
/// damaged is counted among what could not be read, and what lies behind it is read.
pub fn replay_recording(
    path: &Path,
    config: &ReplayConfig,
    out: &Path,
    progress: ProgressFn<'_>,
) -> Result<CaptureReport, Error> {
    let recording = Recording::open(path)?;
    let topics: Vec<&str> = recording.lidar_packet_topics().collect();
    if topics.is_empty() {
        // The error names what is there.
        drop(recording.lidar_packets()?);
    }
    let names = lidar_names(&recording, &topics);
    check_angles(&config.lidar, names.iter().map(String::as_str))?;
    let mut streams = Vec::new();
    let mut sources = Vec::new();
    for (name, topic) in names.iter().zip(topics) {
        streams.push(new_stream(name, &config.lidar));
        // Others keep no position packets, or not as packets.
        let positions = recording.packets(&lidar_position(name));
        sources.push(RecordedSource {
            data: recording.packets_on(topic)?.peekable(),
            positions: positions.into_iter().flatten().peekable(),
        });
    }
    let mut damage = DamageFound::default();
    if let Some(first) = streams.first_mut() {
        for found in recording.damage().iter().filter(|damage| damage.is_loss()) {
            damage.note(found, first);
        }
    }
    let rig = config.rig.clone().or_else(|| recording.rig().ok());
    let import = Import::begin(out, rig, &config.recorder)?;
    let (ending, told) = import.take_all(progress, |to_recorder| {
        let sources = sources.iter_mut().zip(&mut streams);
        let earliest = sources
            .filter_map(|(source, stream)| Some((source.next_arrival()?, source, stream)))
            .min_by_key(|(arrival, _, _)| *arrival);
        let Some((_, source, stream)) = earliest else {
            return Next::Ended(Ending::EndOfStream);
        };
        match source.next() {
            Some(Ok(recorded)) => match stream.push(recorded.packet, to_recorder) {
                Ok(()) => stream.mixture().map_or(Next::Taken, Next::Refused),
                Err(WriterGone) => Next::Ended(Ending::Stopped),
            },
            Some(Err(lsfb_recording::Error::Damaged { damage: found, .. })) => {
                damage.note(&found, stream);
                Next::Taken
            }
            Some(Err(error @ lsfb_recording::Error::Message { .. })) => {
                stream.count_damage(error.to_string());
                Next::Taken
            }
            Some(Err(error)) => Next::Ended(Ending::Lost(error.to_string())),
            None => Next::Ended(Ending::EndOfStream),
        }
    });
    let told = told.and_then(|()| {
        let mut streams = streams.iter_mut();
        streams.try_for_each(|stream| stream.drain(&import.to_recorder))
    });
    let finish = |stream: LidarStream| stream.finish(ending.clone(), &import.to_recorder);
    let reports = streams.into_iter().map(finish).collect();
    import.finish(reports, told)
}

/// Refuses to read several sensors with the beam angles of one.
fn check_angles<'a>(
    settings: &Settings,
    lidars: impl Iterator<Item = &'a str>,
) -> Result<(), Error> {
    let lidars: Vec<&str> = lidars.collect();
    if settings.scans.angles.is_none() || lidars.len() < 2 {
        return Ok(());
    }
    Err(Error::LidarSettings {
        lidar: lidars.join(", "),
        problem: "a beam angle file belongs to one sensor: read the sensors one by one".to_owned(),
    })
}

fn new_stream(name: &str, settings: &Settings) -> LidarStream {
    LidarStream::new(name, settings.clone(), &Meter::new(name))
}

/// What the LiDARs of topics are called: as they were in recordings of ours, else `lidar`, `lidar2`, …
fn lidar_names(recording: &Recording, topics: &[&str]) -> Vec<String> {
    let session = recording.metadata("lsfb.session").unwrap_or_default();
    let is_ours = !session.is_empty();
    let named = |(index, topic): (usize, &&str)| {
        let own = topic
            .strip_prefix('/')
            .and_then(|t| t.strip_suffix("/packets"));
        match (own.filter(|name| is_ours && !name.contains('/')), index) {
            (Some(name), _) => name.to_owned(),
            (None, 0) => MAIN_LIDAR.to_owned(),
            (None, _) => format!("{MAIN_LIDAR}{}", index + 1),
        }
    };
    topics.iter().enumerate().map(named).collect()
}

/// What became of the next packet.
enum Next {
    Taken,
    Ended(Ending),
    /// It makes no recording.
    Refused(Error),
}

/// The recording that a capture file becomes.
struct Import<'a> {
    out: &'a Path,
    recorder: Recorder,
    to_recorder: RecorderSender,
}

impl<'a> Import<'a> {
    fn begin(out: &'a Path, rig: Option<Rig>, config: &RecorderConfig) -> Result<Self, Error> {
        recorder::make_folder(out)?;
        let recorder = Recorder::start(out, rig, &[], config, Overflow::Wait)?;
        let to_recorder = recorder.sender();
        Ok(Self {
            out,
            recorder,
            to_recorder,
        })
    }

    /// Takes packet by packet until the end, or until it is told to stop.
    fn take_all(
        &self,
        progress: ProgressFn<'_>,
        mut take: impl FnMut(&RecorderSender) -> Next,
    ) -> (Ending, Result<(), Error>) {
        for packets in 0.. {
            if u64::is_multiple_of(packets, SHOW_EVERY) {
                let told = progress(Progress {
                    stage: "reading packets",
                    done: packets,
                    total: 0,
                });
                if let Err(stopped) = told {
                    return (Ending::Stopped, Err(stopped.into()));
                }
            }
            match take(&self.to_recorder) {
                Next::Taken => {}
                Next::Ended(ending) => return (ending, Ok(())),
                Next::Refused(error) => return (Ending::Stopped, Err(error)),
            }
        }
        (Ending::EndOfStream, Ok(()))
    }

    fn finish(
        self,
        streams: Vec<StreamReport>,
        told: Result<(), Error>,
    ) -> Result<CaptureReport, Error> {
        drop(self.to_recorder);
        let written = self.recorder.finish(&streams)?;
        told.inspect_err(|_| written.discard())?;
        Ok(written.report(self.out, streams))
    }
}

/// Where a file is damaged: several topics have their messages in one chunk.
#[derive(Default)]
struct DamageFound(BTreeSet<u64>);

impl DamageFound {
    fn note(&mut self, found: &Damage, stream: &mut LidarStream) {
        if self.0.insert(found.offset) {
            stream.count_damage(format!("the file is damaged: {found}"));
        }
    }
}

/// Packets of one LiDAR of both kinds, in the order of their arrival.
struct RecordedSource<D: Iterator, P: Iterator> {
    data: Peekable<D>,
    positions: Peekable<P>,
}

type Recorded = Result<RecordedPacket, lsfb_recording::Error>;

impl<D, P> RecordedSource<D, P>
where
    D: Iterator<Item = Recorded>,
    P: Iterator<Item = Recorded>,
{
    /// When the next packet arrived; `None` at the end.
    fn next_arrival(&mut self) -> Option<Timestamp> {
        let (data, position) = (arrival(self.data.peek()), arrival(self.positions.peek()));
        [data, position].into_iter().flatten().min()
    }

    fn next(&mut self) -> Option<Recorded> {
        let (data, position) = (arrival(self.data.peek()), arrival(self.positions.peek()));
        let position_is_next = match (data, position) {
            (Some(data), Some(position)) => position <= data,
            (data, _) => data.is_none(),
        };
        match position_is_next {
            true => self.positions.next(),
            false => self.data.next(),
        }
    }
}

/// When a packet arrived. What cannot be read comes first: its place is not known.
fn arrival(next: Option<&Recorded>) -> Option<Timestamp> {
    let unknown = Timestamp::from_nanos(i64::MIN);
    next.map(|next| next.as_ref().map_or(unknown, |p| p.packet.arrival))
}
