//! The threads of a session's devices, and the loop that waits for them.

use std::sync::Arc;
use std::thread::JoinHandle;

use lsfb_types::{Progress, ProgressFn};

use crate::Error;
use crate::config::Overflow;
use crate::control::{Control, POLL};
use crate::health::{Expected, Meter, Monitor};
use crate::poses::PoseQueue;
use crate::recorder::{self, Recorder, RecorderSender};
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
    pub(crate) to_recorder: &'a RecorderSender,
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

/// What several devices on one thread work with.
pub(crate) struct GroupContext<'a> {
    pub(crate) to_recorder: &'a RecorderSender,
    pub(crate) control: &'a Control,
    /// One for each of them, in their order.
    pub(crate) meters: &'a [Meter],
}

/// The threads of one session.
pub(crate) struct Threads {
    control: Arc<Control>,
    overflow: Overflow,
    running: Vec<(String, JoinHandle<Vec<StreamReport>>)>,
    meters: Vec<Meter>,
    to_recorder: RecorderSender,
    remarks: Option<RemarkQueue>,
    poses: Option<PoseQueue>,
}

impl Threads {
    pub(crate) fn new(
        control: Control,
        overflow: Overflow,
        to_recorder: RecorderSender,
        remarks: Option<RemarkQueue>,
        poses: Option<PoseQueue>,
    ) -> Self {
        Self {
            control: Arc::new(control),
            overflow,
            running: Vec::new(),
            meters: Vec::new(),
            to_recorder,
            remarks,
            poses,
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
        let meter = self.meter(device.name, device.expected);
        self.spawn(device.thread, device.ends, move |to_recorder, control| {
            let mut report = work(&DeviceContext {
                to_recorder,
                control,
                meter: &meter,
            });
            meter.end(&mut report);
            vec![report]
        })
    }

    /// Starts one thread for devices that never end by themselves: `devices` are their names and what is expected of each, and
    /// `work` gives a report for each.
    pub(crate) fn start_group(
        &mut self,
        thread: &str,
        devices: impl IntoIterator<Item = (String, Vec<Expected>)>,
        work: impl FnOnce(&GroupContext<'_>) -> Vec<StreamReport> + Send + 'static,
    ) -> Result<(), Error> {
        let devices = devices.into_iter();
        let meters: Vec<Meter> = devices
            .map(|(name, expected)| self.meter(&name, expected))
            .collect();
        self.spawn(thread, Ends::Never, move |to_recorder, control| {
            let mut reports = work(&GroupContext {
                to_recorder,
                control,
                meters: &meters,
            });
            for (meter, report) in meters.iter().zip(&mut reports) {
                meter.end(report);
            }
            reports
        })
    }

    fn meter(&mut self, name: &str, expected: Vec<Expected>) -> Meter {
        let meter = match self.overflow {
            Overflow::Drop => Meter::expecting(name, expected),
            // Devices that wait for the disk, as only simulated ones can, come as fast as they may.
            Overflow::Wait => Meter::new(name),
        };
        self.meters.push(meter.clone());
        meter
    }

    fn spawn(
        &mut self,
        thread: &str,
        ends: Ends,
        work: impl FnOnce(&RecorderSender, &Control) -> Vec<StreamReport> + Send + 'static,
    ) -> Result<(), Error> {
        let (to_recorder, control) = (self.to_recorder.clone(), Arc::clone(&self.control));
        let handle = recorder::spawn(thread, move || {
            let reports = work(&to_recorder, &control);
            if ends == Ends::ByItself {
                control.leave();
            }
            reports
        })?;
        self.running.push((thread.to_owned(), handle));
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
                let _ = remarks.forward(&self.to_recorder);
            }
            if let Some(poses) = &mut self.poses {
                let _ = poses.forward(&self.to_recorder);
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
            let _ = remarks.forward(&self.to_recorder);
        }
        // What happened since the last snapshot is told too, a device that was lost above all.
        monitor.finish();
        let mut reports = Vec::new();
        for (name, thread) in self.running {
            reports.extend(recorder::join(&name, thread)?);
        }
        Ok(reports)
    }
}
