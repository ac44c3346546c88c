//! Capture files → Recording, through the functions used live.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::velodyne::DecoderConfig;
use lsfb_geometry::Rig;
use lsfb_types::{Progress, ProgressFn};

use crate::config::{Overflow, RecorderConfig};
use crate::health::{Ending, Meter};
use crate::lidar::{LIDAR, LidarStream};
use crate::recorder::{self, Recorder};
use crate::{CaptureReport, Error};

/// How a capture file is read.
#[derive(Clone, Debug, Default)]
pub struct ReplayConfig {
    /// Model, return mode and geometry.
    pub decoder: DecoderConfig,
    /// Attached to the recording.
    pub rig: Option<Rig>,
    /// Files and disks.
    pub recorder: RecorderConfig,
}

/// Records the Velodyne packets of `source` into `out`, with the arrival stamps they have there. A file that is damaged in the
/// middle gives what lies before, and the damage is the stream's [`Ending::Lost`].
pub fn replay(
    mut source: impl PacketSource,
    config: &ReplayConfig,
    out: &Path,
    stop: &AtomicBool,
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
    let mut stream = LidarStream::new(config.decoder, &Meter::new(LIDAR));
    let mut packets = 0_u64;
    let ending = loop {
        if stop.load(Ordering::Relaxed) {
            break Ending::Stopped;
        }
        match source.recv(Duration::from_millis(50)) {
            Ok(Some(packet)) => {
                if stream.push(packet, &inlet).is_err() {
                    break Ending::Stopped;
                }
                packets += 1;
                if packets.is_multiple_of(10_000) {
                    progress(Progress {
                        stage: "reading packets",
                        done: packets,
                        total: 0,
                    });
                }
            }
            Ok(None) => {}
            Err(lsfb_drivers::Error::EndOfStream { .. }) => break Ending::EndOfStream,
            Err(error) => break Ending::Lost(error.to_string()),
        }
    };
    let stream = stream.finish(ending, &inlet);
    drop(inlet);
    let streams = vec![stream];
    Ok(CaptureReport::new(out, recorder.finish(&streams)?, streams))
}
