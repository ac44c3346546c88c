//! The recorder for devices that no driver here knows: samples in, a recording out.

use std::path::{Path, PathBuf};

use lsfb_geometry::Rig;
use lsfb_types::{Image, ImuSample, LidarScan, Packet, Stamped};

use crate::config::{Overflow, RecorderConfig};
use crate::recorder::{self, Entry, Recorder, RecorderSender};
use crate::{CaptureReport, Error, StreamReport};

/// A recording in progress, fed from any number of threads through [`Feeder`]s.
pub struct Feed {
    recorder: Recorder,
    out: PathBuf,
}

/// One thread's way into a [`Feed`].
pub struct Feeder {
    to_recorder: RecorderSender,
    report: StreamReport,
}

impl Feed {
    /// Creates the file. `units`: the camera names of each unit, which together form the camera group.
    pub fn start(
        out: &Path,
        rig: Option<Rig>,
        units: &[Vec<String>],
        config: &RecorderConfig,
        overflow: Overflow,
    ) -> Result<Self, Error> {
        recorder::make_folder(out)?;
        Ok(Self {
            recorder: Recorder::start(out, rig, units, config, overflow)?,
            out: out.to_owned(),
        })
    }

    /// A way in for the device `name`.
    pub fn feeder(&self, name: &str) -> Feeder {
        Feeder {
            to_recorder: self.recorder.sender(),
            report: StreamReport::new(name),
        }
    }

    /// Whether recording has ended by itself: the disk failed, or is full.
    pub fn has_ended(&self) -> bool {
        self.recorder.has_ended()
    }

    /// Writes what waits and closes the files. Waits until every [`Feeder`] is gone; their reports say what they lost.
    pub fn finish(self, reports: Vec<StreamReport>) -> Result<CaptureReport, Error> {
        let written = self.recorder.finish(&reports)?;
        Ok(written.report(&self.out, reports))
    }
}

impl Feeder {
    /// Records an image. False, here and below: recording has ended by itself.
    pub fn image(&mut self, camera: &str, image: Stamped<Image>) -> bool {
        self.put(Entry::Image {
            camera: camera.to_owned(),
            image,
            trailer: Vec::new(),
        })
    }

    /// Records an inertial sample.
    pub fn imu(&mut self, imu: &str, sample: Stamped<ImuSample>) -> bool {
        self.put(Entry::Imu {
            imu: imu.to_owned(),
            sample,
        })
    }

    /// Records a revolution and the packets it came in.
    pub fn scan(&mut self, lidar: &str, scan: Stamped<LidarScan>, packets: Vec<Packet>) -> bool {
        self.put(Entry::Scan {
            lidar: lidar.to_owned(),
            scan,
            packets,
        })
    }

    /// What went in, and what was dropped because the queue was full.
    pub fn finish(self) -> StreamReport {
        self.report
    }

    fn put(&mut self, entry: Entry) -> bool {
        self.report.received += 1;
        self.report.decoded += 1;
        self.to_recorder.put(entry, &mut self.report).is_ok()
    }
}
