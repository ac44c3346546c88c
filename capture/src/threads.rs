//! The threads of a session's devices, and the loop that waits for them.

use std::sync::Arc;
use std::thread::JoinHandle;

use lsfb_types::{Progress, ProgressFn};

use crate::Error;
use crate::config::Overflow;
use crate::control::{Control, POLL};
use crate::health::{Expected, Meter, Monitor};
use crate::recorder::{self, Inlet, Recorder};
use crate::remark::RemarkQueue;
use crate::report::StreamReport;

/// Whether a device says when it has no more to send.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ends {
    ByItself,
    Never,
}

/// What a device's thread works with.
pub(crate) struct DeviceContext<'a> {
    pub(crate) inlet: &'a Inlet,
    pub(crate) control: &'a Control,
    pub(crate) meter: &'a Meter,
}

/// A device as its thread and its meter are called, and what is expected of it.
pub(crate) struct Device<'a> {
    pub(crate) thread: &'a str,
    pub(crate) name: &'a str,
    pub(crate) ends: Ends,
    pub(crate) expected: Vec<Expected>,
}

/// The threads of one session.
pub(crate) struct Threads {
    control: Arc<Control>,
    overflow: Overflow,
    running: Vec<(String, JoinHandle<StreamReport>)>,
    meters: Vec<Meter>,
    inlet: Inlet,
    remarks: Option<RemarkQueue>,
}

impl Threads {
    pub(crate) fn new(
        control: Control,
        overflow: Overflow,
        inlet: Inlet,
        remarks: Option<RemarkQueue>,
    ) -> Self {
        Self {
            control: Arc::new(control),
            overflow,
            running: Vec::new(),
            meters: Vec::new(),
            inlet,
            remarks,
        }
    }

    pub(crate) fn meters(&self) -> Vec<Meter> {
        self.meters.clone()
    }

    pub(crate) fn start(
        &mut self,
        device: Device<'_>,
        work: impl FnOnce(&DeviceContext<'_>) -> StreamReport + Send + 'static,
    ) -> Result<(), Error> {
        let (inlet, control) = (self.inlet.clone(), Arc::clone(&self.control));
        let meter = match self.overflow {
            Overflow::Drop => Meter::expecting(device.name, device.expected),
            // Devices that wait for the disk, as only simulated ones can, come as fast as they may.
            Overflow::Wait => Meter::new(device.name),
        };
        self.meters.push(meter.clone());
        let ends = device.ends;
        let handle = recorder::spawn(device.thread, move || {
            let mut report = work(&DeviceContext {
                inlet: &inlet,
                control: &control,
                meter: &meter,
            });
            meter.end(&mut report);
            if ends == Ends::ByItself {
                control.leave();
            }
            report
        })?;
        self.running.push((device.thread.to_owned(), handle));
        Ok(())
    }

    /// Until all have ended.
    pub(crate) fn wait(
        mut self,
        recorder: &Recorder,
        mut monitor: Monitor,
        progress: ProgressFn<'_>,
    ) -> Result<Vec<StreamReport>, Error> {
        while !self.running.iter().all(|(_, thread)| thread.is_finished()) {
            if let Some(remarks) = &mut self.remarks {
                // A writer that is gone ends the loop by itself.
                let _ = remarks.forward(&self.inlet);
            }
            let told = progress(Progress {
                stage: "recording",
                done: self.control.progress.sum(),
                total: 0,
            });
            if told.is_err() || recorder.has_ended() {
                self.control.stop();
            }
            monitor.tick();
            std::thread::sleep(POLL);
        }
        if let Some(mut remarks) = self.remarks.take() {
            // What was said last.
            let _ = remarks.forward(&self.inlet);
        }
        // What happened since the last snapshot is told too, a device that was lost above all.
        monitor.finish();
        self.running
            .into_iter()
            .map(|(name, thread)| recorder::join(&name, thread))
            .collect()
    }
}
