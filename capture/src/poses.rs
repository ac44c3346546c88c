//! Where the rig is while it is recorded, by an odometry that somebody else runs: written into the recording as it comes.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use lsfb_geometry::{Se3, StampedPose};
use lsfb_recording::TF;
use lsfb_recording::message;
use lsfb_types::Timestamp;

use crate::recorder::{Entry, OwnMessage, RecorderSender, WriterGone};
use crate::report::StreamReport;

/// Poses between their author and the recording: some seconds of a LiDAR's.
const QUEUE_POSES: usize = 64;

/// Where poses are put; see [`crate::Session::poses`].
#[derive(Clone, Debug)]
pub struct Poses {
    queue: SyncSender<Known>,
}

/// A pose, and when it was known.
#[derive(Clone, Copy, Debug)]
struct Known {
    time: Timestamp,
    odom_from_rig: Se3,
    arrival: Timestamp,
}

impl Poses {
    /// Writes a pose into the recording that runs. `pose` is in the odometry's own frame, its time on the devices' clock; `arrival` is
    /// when it was known, on the host's. Nobody waits: what the recorder does not take in time, and what comes after its end, is left out.
    pub fn put(&self, pose: &StampedPose, arrival: Timestamp) {
        let known = Known {
            time: pose.time,
            odom_from_rig: pose.world_from_rig,
            arrival,
        };
        // It can be computed again from what is recorded.
        let _ = self.queue.try_send(known);
    }
}

/// The end that the session holds.
#[derive(Debug)]
pub(crate) struct PoseQueue {
    queue: Receiver<Known>,
    report: StreamReport,
}

pub(crate) fn poses() -> (Poses, PoseQueue) {
    let (sender, queue) = sync_channel(QUEUE_POSES);
    let report = StreamReport::new("odometry");
    (Poses { queue: sender }, PoseQueue { queue, report })
}

impl PoseQueue {
    /// Hands what has come to the writer.
    pub(crate) fn forward(&mut self, to_recorder: &RecorderSender) -> Result<(), WriterGone> {
        while let Ok(known) = self.queue.try_recv() {
            let message = OwnMessage {
                topic: TF.to_owned(),
                schema: message::TF_MESSAGE,
                time: known.time,
                arrival: known.arrival,
                bytes: message::encode_odometry(known.time, &known.odom_from_rig),
            };
            to_recorder.put(Entry::Own(message), &mut self.report)?;
        }
        Ok(())
    }
}
