//! What a recording session did, device by device.

use std::path::PathBuf;

use lsfb_drivers::WireError;
use serde::Serialize;

use crate::sync::GroupReport;

/// Why a stream ended.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ending {
    /// The recording was stopped.
    #[default]
    Stopped,
    /// The device said goodbye, or the file was read to its end.
    EndOfStream,
    /// The device was lost; the others went on.
    Lost(String),
}

/// What one device sent, and what became of it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct StreamReport {
    /// Name of the device.
    pub name: String,
    /// Packets, frames or messages received.
    pub received: u64,
    /// Samples decoded.
    pub decoded: u64,
    /// Packets that could not be read; recorded raw where the device has a raw topic.
    pub bad: u64,
    /// What the device's own counters say never arrived.
    pub missing: u64,
    /// Packets that came too late to be put back in order: they are recorded, and no scan has their points.
    pub reordered: u64,
    /// Packets of another LiDAR on its ports that nobody named: they are not in the recording.
    pub kept_out: u64,
    /// Repetitions left out.
    pub duplicated: u64,
    /// Samples dropped because the writer's queue was full.
    pub dropped: u64,
    /// How often the device was gone and came back.
    pub interruptions: u64,
    /// How often something that it sends all the time (data, images, samples) stayed away for more than a second.
    pub silences: u64,
    /// How often that came far too slowly for some seconds.
    pub slowdowns: u64,
    /// How often it went on sending for more than a second and said nothing new: the same image or sample, scans without a return.
    pub stale: u64,
    /// The first packet that could not be read: number and reason.
    pub first_bad: Option<String>,
    /// What an operator should know.
    pub notes: Vec<String>,
    /// Why it ended.
    pub ending: Ending,
}

impl StreamReport {
    pub(crate) fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            ..Self::default()
        }
    }

    /// Counts a packet that could not be read.
    pub(crate) fn count_bad(&mut self, error: WireError) {
        self.bad += 1;
        if self.first_bad.is_none() {
            self.first_bad = Some(format!("packet {}: {error}", self.received));
        }
    }

    /// A device that was configured and sent nothing is lost, whatever ended its stream.
    pub(crate) fn name_silence(&mut self) {
        if self.received == 0 && !matches!(self.ending, Ending::Lost(_)) {
            self.ending = Ending::Lost(format!(
                "no data from {}; check its power, cable and address",
                self.name
            ));
        }
    }

    /// Whatever should have been recorded and was not.
    pub fn lost(&self) -> u64 {
        self.counted_lost() + u64::from(matches!(self.ending, Ending::Lost(_)))
    }

    /// What was counted so far, whatever ends it.
    pub(crate) fn counted_lost(&self) -> u64 {
        self.bad
            + self.missing
            + self.reordered
            + self.kept_out
            + self.dropped
            + self.interruptions
            + self.silences
            + self.slowdowns
            + self.stale
    }
}

/// What goes into the recording itself, as attachment `health.json`: everything but the file's own size.
#[derive(Serialize)]
pub(crate) struct HealthAttachment<'a> {
    pub(crate) streams: &'a [StreamReport],
    pub(crate) groups: &'a GroupReport,
    pub(crate) lost: u64,
}

/// What a recording session did.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CaptureReport {
    /// The recording, or its first part.
    pub path: PathBuf,
    /// All parts, in order.
    pub parts: Vec<PathBuf>,
    /// Size of all parts, bytes.
    pub bytes: u64,
    /// Messages in all parts.
    pub messages: u64,
    /// One entry per device.
    pub streams: Vec<StreamReport>,
    /// How the cameras' images fit together.
    pub groups: GroupReport,
    /// Sum of everything that should have been recorded and was not; 0 is the only good value.
    pub lost: u64,
    /// Why recording ended before it was told to; what was written before is intact.
    pub failure: Option<String>,
    /// Files that were removed, renamed or whose disk went away while they were written, and where recording went on; the first
    /// message that could not be written.
    pub warnings: Vec<String>,
    /// 99 % of the messages were in the file this long after they were queued, milliseconds.
    pub write_p99_ms: f64,
    /// The longest of these times, milliseconds.
    pub write_longest_ms: f64,
}
