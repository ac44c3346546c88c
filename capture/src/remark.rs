//! What the operator says while recording: notes and control points, written into the recording as they come.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};

use lsfb_recording::REMARKS;
use lsfb_recording::message::{self, Remark};
use lsfb_types::Timestamp;

use crate::Error;
use crate::recorder::{Entry, RecorderSender, WriterGone};
use crate::report::StreamReport;

/// Remarks between their author and the recording.
const QUEUE_REMARKS: usize = 64;

/// Where remarks are put; see [`crate::Session::remarks`].
#[derive(Clone, Debug)]
pub struct Remarks {
    queue: SyncSender<QueuedRemark>,
}

impl Remarks {
    /// Writes a remark into the recording that runs; `time` is on the devices' clock, `arrival` on the host's.
    pub fn put(&self, time: Timestamp, arrival: Timestamp, remark: Remark) -> Result<(), Error> {
        self.queue
            .try_send(QueuedRemark {
                time,
                arrival,
                remark,
            })
            .map_err(|e| Error::Remark {
                reason: match e {
                    TrySendError::Full(_) => "too many at once; try again",
                    TrySendError::Disconnected(_) => "the recording has ended",
                },
            })
    }
}

/// A remark, and when it was made.
#[derive(Debug)]
struct QueuedRemark {
    time: Timestamp,
    arrival: Timestamp,
    remark: Remark,
}

/// The end that the session holds.
#[derive(Debug)]
pub(crate) struct RemarkQueue {
    queue: Receiver<QueuedRemark>,
    report: StreamReport,
}

pub(crate) fn remarks() -> (Remarks, RemarkQueue) {
    let (sender, queue) = sync_channel(QUEUE_REMARKS);
    let report = StreamReport::new("operator");
    (Remarks { queue: sender }, RemarkQueue { queue, report })
}

impl RemarkQueue {
    /// Hands what has come to the writer.
    pub(crate) fn forward(&mut self, to_recorder: &RecorderSender) -> Result<(), WriterGone> {
        while let Ok(queued) = self.queue.try_recv() {
            let entry = Entry::Cdr {
                topic: REMARKS.to_owned(),
                schema_name: message::REMARK.name.to_owned(),
                schema_text: message::REMARK.text.to_owned(),
                time: queued.time,
                arrival: queued.arrival,
                bytes: message::encode_remark(queued.time, &queued.remark),
                receipt: None,
            };
            // A person's words are worth waiting for.
            to_recorder.waiting().put(entry, &mut self.report)?;
        }
        Ok(())
    }
}
