//! Capture files → Recording, through the functions used live.

use std::iter::Peekable;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use lsfb_drivers::any_lidar::Settings;
use lsfb_drivers::transport::PacketSource;
use lsfb_geometry::{MAIN_LIDAR, Rig};
use lsfb_recording::{LIDAR_POSITION, RecordedPacket, Recording};
use lsfb_types::{Packet, Progress, ProgressFn, Timestamp};

use crate::config::{Overflow, RecorderConfig};
use crate::health::{Ending, Meter};
use crate::lidar::LidarStream;
use crate::recorder::{self, Recorder};
use crate::{CaptureReport, Error};

/// Packets between two looks at progress.
const SHOW_EVERY: u64 = 1_000;

/// How a capture file is read.
#[derive(Clone, Debug, Default)]
pub struct ReplayConfig {
    /// Model, beam angles, and where scans are cut.
    pub lidar: Settings,
    /// Take packets of this sender only; without it the first that sends what a LiDAR sends is the sensor.
    pub sensor: Option<IpAddr>,
    /// Attached to the recording; without it, the rig of the recording that is replayed, if it has one.
    pub rig: Option<Rig>,
    /// Files and disks.
    pub recorder: RecorderConfig,
}

/// Records the LiDAR packets of `source` into `out`, with the arrival stamps they have there. A file that is damaged in the
/// middle gives what lies before, and the damage is the stream's [`Ending::Lost`]. An import that is told to stop leaves nothing.
pub fn replay(
    mut source: impl PacketSource,
    config: &ReplayConfig,
    out: &Path,
    progress: ProgressFn<'_>,
) -> Result<CaptureReport, Error> {
    recorder::make_folder(out)?;
    let recorder = Recorder::start(
        out,
        config.rig.clone(),
        &[],
        &config.recorder,
        Overflow::Wait,
    )?;
    let inlet = recorder.inlet();
    let mut stream = LidarStream::new(
        MAIN_LIDAR,
        config.lidar.clone(),
        config.sensor,
        &Meter::new(MAIN_LIDAR),
    );
    let mut packets = 0_u64;
    let mut told = Ok(());
    let ending = loop {
        if packets.is_multiple_of(SHOW_EVERY) {
            told = progress(Progress {
                stage: "reading packets",
                done: packets,
                total: 0,
            });
            if told.is_err() {
                break Ending::Stopped;
            }
        }
        match source.recv(Duration::from_millis(50)) {
            Ok(Some(packet)) => {
                if stream.push(packet, source.sender(), &inlet).is_err() {
                    break Ending::Stopped;
                }
                packets += 1;
            }
            Ok(None) => {}
            Err(lsfb_drivers::Error::EndOfStream { .. }) => break Ending::EndOfStream,
            Err(error) => break Ending::Lost(error.to_string()),
        }
    };
    let stream = stream.finish(ending, &inlet);
    drop(inlet);
    let streams = vec![stream];
    let written = recorder.finish(&streams)?;
    told.inspect_err(|_| written.discard())?;
    Ok(written.report(out, streams))
}

/// Records the LiDAR packets of an MCAP file, one of `rosbag2` or one of ours, as [`replay`] does.
pub fn replay_recording(
    path: &Path,
    config: &ReplayConfig,
    out: &Path,
    progress: ProgressFn<'_>,
) -> Result<CaptureReport, Error> {
    let recording = Recording::open(path)?;
    let config = ReplayConfig {
        rig: config.rig.clone().or_else(|| recording.rig().ok()),
        ..config.clone()
    };
    // Others keep no position packets, or not as packets.
    let positions = recording.packets(LIDAR_POSITION).into_iter().flatten();
    let source = RecordedSource {
        path: path.to_owned(),
        data: recording.lidar_packets()?.peekable(),
        positions: positions.peekable(),
    };
    replay(source, &config, out, progress)
}

/// Packets of both kinds, in the order of their arrival.
struct RecordedSource<D: Iterator, P: Iterator> {
    path: PathBuf,
    data: Peekable<D>,
    positions: Peekable<P>,
}

type Recorded = Result<RecordedPacket, lsfb_recording::Error>;

impl<D, P> PacketSource for RecordedSource<D, P>
where
    D: Iterator<Item = Recorded>,
    P: Iterator<Item = Recorded>,
{
    fn recv(&mut self, _: Duration) -> Result<Option<Packet>, lsfb_drivers::Error> {
        // What cannot be read comes first: its place is not known.
        let arrival = |next: Option<&Recorded>| {
            next.map(|next| {
                next.as_ref()
                    .map_or(Timestamp::from_nanos(i64::MIN), |p| p.packet.arrival)
            })
        };
        let (data, position) = (arrival(self.data.peek()), arrival(self.positions.peek()));
        let position_is_next = match (data, position) {
            (Some(data), Some(position)) => position <= data,
            (data, _) => data.is_none(),
        };
        let next = if position_is_next {
            self.positions.next()
        } else {
            self.data.next()
        };
        match next {
            Some(Ok(recorded)) => Ok(Some(recorded.packet)),
            Some(Err(error)) => Err(lsfb_drivers::Error::File {
                path: self.path.clone(),
                position: "a message".to_owned(),
                problem: error.to_string(),
            }),
            None => Err(lsfb_drivers::Error::EndOfStream {
                device: self.path.display().to_string(),
            }),
        }
    }
}
