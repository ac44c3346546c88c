//! One recording session: opens devices, runs their threads, waits for the end.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use lsfb_drivers::camera::model::FrameFormat;
use lsfb_drivers::camera::{CameraConfig, DecoderConfig, MyntCamera};
use lsfb_drivers::imu::{ImuConfig, XsensImu};
use lsfb_drivers::phone::{self, SidecarServer};
use lsfb_drivers::transport::udp::UdpSource;
use lsfb_drivers::velodyne::{self, VelodyneConfig};
use lsfb_geometry::Rig;
use lsfb_types::{Progress, ProgressFn};

use crate::config::{CameraUnitConfig, DevicesConfig};
use crate::health::StreamReport;
use crate::recorder::{self, Inlet, Recorder};
use crate::remark::{RemarkQueue, Remarks, remarks};
use crate::tap::{Spout, Tap, tap};
use crate::{CaptureReport, Error, camera, imu, lidar, sidecar};

/// What device threads share.
#[derive(Debug)]
pub(crate) struct Control {
    stop: AtomicBool,
    /// Devices that end by themselves and have not ended yet.
    running: AtomicUsize,
    pub(crate) progress: Counts,
}

impl Control {
    pub(crate) fn is_stopping(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Whether no device is left that says when it ends. A LiDAR alone never ends by itself.
    pub(crate) fn others_ended(&self) -> bool {
        self.running.load(Ordering::Relaxed) == 0
    }
}

/// What has been handled so far, for progress and for senders that must not run ahead of the recording.
#[derive(Clone, Debug, Default)]
pub struct Counts {
    /// LiDAR packets of both kinds.
    pub lidar_packets: Arc<AtomicU64>,
    /// Images.
    pub images: Arc<AtomicU64>,
    /// IMU samples.
    pub imu_samples: Arc<AtomicU64>,
    /// Messages of sidecars.
    pub sidecar_messages: Arc<AtomicU64>,
}

/// Listening for the devices that send by themselves; not yet recording.
pub struct Session {
    config: DevicesConfig,
    rig: Option<Rig>,
    lidar: Option<UdpSource>,
    sidecar: Option<SidecarServer>,
    counts: Counts,
    tap: Option<Spout>,
    remarks: Option<RemarkQueue>,
}

impl Session {
    /// Reads the rig and begins to listen for the LiDAR and for sidecars.
    pub fn open(config: &DevicesConfig) -> Result<Self, Error> {
        if config.lidar.is_none()
            && config.cameras.is_empty()
            && config.imu.is_none()
            && config.sidecar.is_none()
        {
            return Err(Error::NoDevice);
        }
        let rig = config.rig.as_deref().map(Rig::read).transpose()?;
        let lidar = match &config.lidar {
            Some(net) => Some(velodyne::open(&VelodyneConfig {
                data_bind: net.data,
                position_bind: net.position,
                ..VelodyneConfig::default()
            })?),
            None => None,
        };
        let sidecar = config
            .sidecar
            .as_ref()
            .map(|s| {
                SidecarServer::bind(&phone::SidecarConfig {
                    address: s.listen,
                    ..phone::SidecarConfig::default()
                })
            })
            .transpose()?;
        Ok(Self {
            config: config.clone(),
            rig,
            lidar,
            sidecar,
            counts: Counts::default(),
            tap: None,
            remarks: None,
        })
    }

    /// Where LiDAR data packets and position packets are expected, in this order; empty without a LiDAR.
    pub fn lidar_addresses(&self) -> Vec<SocketAddr> {
        self.lidar
            .as_ref()
            .map(UdpSource::local_addresses)
            .unwrap_or_default()
    }

    /// Where sidecars connect.
    pub fn sidecar_address(&self) -> Option<SocketAddr> {
        self.sidecar.as_ref().map(SidecarServer::address)
    }

    /// Live counts; they go on counting while [`Session::run`] runs.
    pub fn counts(&self) -> Counts {
        self.counts.clone()
    }

    /// A lossy look at what is going to be recorded. There is one: of several the last gets everything.
    pub fn tap(&mut self) -> Tap {
        let (spout, tap) = tap();
        self.tap = Some(spout);
        tap
    }

    /// Where the operator's words go while this session records. There is one: of several the last is heard.
    pub fn remarks(&mut self) -> Remarks {
        let (sender, queue) = remarks();
        self.remarks = Some(queue);
        sender
    }

    /// Opens and configures cameras and IMU (the first that refuses is the error), records into `out` until every device
    /// has ended or `stop` is set, and closes the file properly.
    pub fn run(
        self,
        out: &Path,
        stop: &AtomicBool,
        progress: ProgressFn<'_>,
    ) -> Result<CaptureReport, Error> {
        let (cameras, imu) = open_devices(&self.config)?;
        recorder::make_folder(out)?;
        let camera_names = self
            .config
            .cameras
            .iter()
            .flat_map(|c| c.names.clone())
            .collect();
        let recorder = Recorder::start(out, self.rig, camera_names, self.config.overflow)?;
        let finite =
            cameras.len() + usize::from(imu.is_some()) + usize::from(self.sidecar.is_some());
        let control = Arc::new(Control {
            stop: AtomicBool::new(false),
            // A LiDAR alone runs until it is stopped.
            running: AtomicUsize::new(if finite == 0 { usize::MAX } else { finite }),
            progress: self.counts.clone(),
        });
        let mut threads = Threads {
            control: Arc::clone(&control),
            running: Vec::new(),
            inlet: recorder.inlet().tapped(self.tap),
            remarks: self.remarks,
        };
        if let Some(source) = self.lidar {
            threads.start("lidar", Ends::Never, |inlet, control| {
                lidar::record(source, inlet, control)
            })?;
        }
        for (index, (unit, config, format)) in cameras.into_iter().enumerate() {
            let decoder = DecoderConfig {
                format,
                ..DecoderConfig::default()
            };
            threads.start(
                &format!("camera{index}"),
                Ends::ByItself,
                move |inlet, control| camera::record(unit, &config, decoder, inlet, control),
            )?;
        }
        if let Some(unit) = imu {
            threads.start("imu", Ends::ByItself, |inlet, control| {
                imu::record(unit, inlet, control)
            })?;
        }
        if let Some(server) = self.sidecar {
            threads.start("sidecar", Ends::ByItself, |inlet, control| {
                sidecar::record(server, &inlet.patient(), control)
            })?;
        }
        let mut streams = threads.wait(stop, &recorder, progress)?;
        streams.iter_mut().for_each(StreamReport::name_silence);
        let written = recorder.finish(&streams)?;
        Ok(CaptureReport {
            path: written.summary.path,
            bytes: written.summary.bytes,
            messages: written.summary.messages,
            streams,
            groups: written.groups,
            lost: written.lost,
        })
    }
}

type OpenCamera = (MyntCamera, CameraUnitConfig, FrameFormat);

/// The devices that are asked rather than listened to.
fn open_devices(config: &DevicesConfig) -> Result<(Vec<OpenCamera>, Option<XsensImu>), Error> {
    let mut cameras = Vec::new();
    for unit in &config.cameras {
        let format = FrameFormat {
            width: unit.frame_px[0],
            height: unit.frame_px[1],
        };
        let open = CameraConfig {
            path: unit.path.clone(),
            serial: unit.serial.clone(),
            format,
            rate_hz: unit.rate_hz,
            ..CameraConfig::default()
        };
        cameras.push((MyntCamera::open(&open)?, unit.clone(), format));
    }
    let imu = match &config.imu {
        Some(line) => Some(XsensImu::open(&ImuConfig {
            path: line.path.clone(),
            baud: line.baud,
            rate_hz: line.rate_hz,
        })?),
        None => None,
    };
    Ok((cameras, imu))
}

/// Whether a device says when it has no more to send.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Ends {
    ByItself,
    Never,
}

struct Threads {
    control: Arc<Control>,
    running: Vec<(String, JoinHandle<StreamReport>)>,
    inlet: Inlet,
    remarks: Option<RemarkQueue>,
}

impl Threads {
    fn start(
        &mut self,
        name: &str,
        ends: Ends,
        work: impl FnOnce(&Inlet, &Control) -> StreamReport + Send + 'static,
    ) -> Result<(), Error> {
        let (inlet, control) = (self.inlet.clone(), Arc::clone(&self.control));
        let thread = recorder::spawn(name, move || {
            let report = work(&inlet, &control);
            if ends == Ends::ByItself {
                control.running.fetch_sub(1, Ordering::Relaxed);
            }
            report
        })?;
        self.running.push((name.to_owned(), thread));
        Ok(())
    }

    fn wait(
        mut self,
        stop: &AtomicBool,
        recorder: &Recorder,
        progress: ProgressFn<'_>,
    ) -> Result<Vec<StreamReport>, Error> {
        let mut last_shown = Instant::now();
        while !self.running.iter().all(|(_, thread)| thread.is_finished()) {
            if stop.load(Ordering::Relaxed) || recorder.has_ended() {
                self.control.stop.store(true, Ordering::Relaxed);
            }
            if let Some(remarks) = &mut self.remarks {
                // A writer that is gone ends the loop by itself.
                let _ = remarks.forward(&self.inlet);
            }
            if last_shown.elapsed() > Duration::from_millis(250) {
                last_shown = Instant::now();
                let c = &self.control.progress;
                let counts = [
                    &c.lidar_packets,
                    &c.images,
                    &c.imu_samples,
                    &c.sidecar_messages,
                ];
                let done = counts.iter().map(|c| c.load(Ordering::Relaxed)).sum();
                progress(Progress {
                    stage: "recording",
                    done,
                    total: 0,
                });
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        if let Some(mut remarks) = self.remarks.take() {
            // What was said last.
            let _ = remarks.forward(&self.inlet);
        }
        self.running
            .into_iter()
            .map(|(name, thread)| recorder::join(&name, thread))
            .collect()
    }
}
