//! One recording session: opens devices, runs their threads, waits for the end.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use lsfb_drivers::camera::MyntCamera;
use lsfb_drivers::phone::{self, SidecarServer};
use lsfb_drivers::transport::udp::UdpSource;
use lsfb_drivers::velodyne::SensorPage;
use lsfb_drivers::velodyne::{self, VelodyneConfig};
use lsfb_geometry::Rig;
use lsfb_types::{Progress, ProgressFn};

use crate::config::DevicesConfig;
use crate::health::{Connection, HealthFeed, Meter, Monitor, StreamReport};
use crate::recorder::{self, Inlet, Recorder};
use crate::remark::{RemarkQueue, Remarks, remarks};
use crate::tap::{Spout, Tap, tap};
use crate::{CaptureReport, Error, camera, imu, lidar, sidecar};

/// Between two attempts to open a device that is gone.
const REOPEN: Duration = Duration::from_millis(500);
/// How often it is looked whether the session stops.
const POLL: Duration = Duration::from_millis(20);

/// What device threads share.
#[derive(Debug)]
pub(crate) struct Control {
    stop: AtomicBool,
    /// Devices that end by themselves and have not ended yet.
    running: AtomicUsize,
    /// How many of them there were.
    finite: usize,
    lidar_alive: AtomicBool,
    pub(crate) progress: Counts,
}

impl Control {
    /// For streams that no session runs.
    pub(crate) fn alone() -> Self {
        Self {
            stop: AtomicBool::new(false),
            running: AtomicUsize::new(0),
            finite: 0,
            lidar_alive: AtomicBool::new(false),
            progress: Counts::default(),
        }
    }

    pub(crate) fn is_stopping(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Whether no device is left that says when it ends. A LiDAR alone never ends by itself.
    pub(crate) fn others_ended(&self) -> bool {
        self.running.load(Ordering::Relaxed) == 0
    }

    /// Whether of several devices one is left, and the LiDAR is silent too. A unit on a bus cannot say that it has ended.
    pub(crate) fn only_one_is_left(&self) -> bool {
        let left = self.running.load(Ordering::Relaxed);
        self.finite > 1 && left <= 1 && !self.lidar_alive.load(Ordering::Relaxed)
    }

    /// Whether the LiDAR was heard lately: then the session goes on, and devices that are gone may come back.
    pub(crate) fn set_lidar_alive(&self, alive: bool) {
        self.lidar_alive.store(alive, Ordering::Relaxed);
    }

    /// Opens a device that is gone again and again, until it is back or the session has nothing left to record.
    pub(crate) fn reopen<D>(
        &self,
        report: &mut StreamReport,
        meter: &Meter,
        open: impl Fn() -> Result<D, lsfb_drivers::Error>,
    ) -> Option<D> {
        meter.set_connected(Connection::Gone);
        self.running.fetch_sub(1, Ordering::Relaxed);
        let gone = Instant::now();
        let mut tried = gone;
        let back = loop {
            let over = self.others_ended() && !self.lidar_alive.load(Ordering::Relaxed);
            if self.is_stopping() || over {
                break None;
            }
            std::thread::sleep(POLL);
            if tried.elapsed() >= REOPEN {
                tried = Instant::now();
                if let Ok(device) = open() {
                    break Some(device);
                }
            }
        };
        self.running.fetch_add(1, Ordering::Relaxed);
        if back.is_some() {
            report.interruptions += 1;
            let secs = gone.elapsed().as_secs_f64();
            report.notes.push(format!("gone for {secs:.1} s, and back"));
            meter.count(report);
            meter.set_connected(Connection::There);
        }
        back
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

impl Counts {
    fn sum(&self) -> u64 {
        let counts = [
            &self.lidar_packets,
            &self.images,
            &self.imu_samples,
            &self.sidecar_messages,
        ];
        counts.iter().map(|c| c.load(Ordering::Relaxed)).sum()
    }
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
    health: HealthFeed,
}

impl Session {
    /// Reads the rig, sets the LiDAR where that is asked for, and begins to listen for it and for sidecars.
    pub fn open(config: &DevicesConfig) -> Result<Self, Error> {
        if config.lidar.is_none()
            && config.cameras.is_empty()
            && config.imu.is_none()
            && config.sidecar.is_none()
        {
            return Err(Error::NoDevice);
        }
        config.check()?;
        let rig = config.rig.as_deref().map(Rig::read).transpose()?;
        if let Some(net) = &config.lidar
            && let Some(settings) = &net.settings
        {
            let changes = settings.changes(net.data.port(), net.position.port());
            SensorPage::at(settings.page).apply(&changes)?;
        }
        let lidar = match &config.lidar {
            Some(net) => Some(velodyne::open(&VelodyneConfig {
                data_bind: net.data,
                position_bind: net.position,
                sensor: net.sensor,
                receive_buffer_bytes: net.receive_buffer_bytes,
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
            health: HealthFeed::default(),
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

    /// What the rig is doing, twice a second while [`Session::run`] runs.
    pub fn health(&self) -> HealthFeed {
        self.health.clone()
    }

    /// Opens and configures cameras and IMU (the first that refuses is the error), records into `out` until every device
    /// has ended or `progress` asks for an end, and closes the file properly: to be told to stop is how a recording of
    /// devices that never end is finished, and no error.
    pub fn run(self, out: &Path, progress: ProgressFn<'_>) -> Result<CaptureReport, Error> {
        recorder::make_folder(out)?;
        self.check_space(out)?;
        let (cameras, imu) = open_devices(&self.config)?;
        let units = self.config.cameras.iter();
        let names: Vec<Vec<String>> = units.map(|unit| unit.names.clone()).collect();
        let settings = &self.config.recorder;
        let recorder = Recorder::start(out, self.rig, &names, settings, self.config.overflow)?;
        camera::introduce(&cameras, &recorder.inlet());
        let finite =
            cameras.len() + usize::from(imu.is_some()) + usize::from(self.sidecar.is_some());
        let control = Arc::new(Control {
            stop: AtomicBool::new(false),
            // A LiDAR alone runs until it is stopped.
            running: AtomicUsize::new(if finite == 0 { usize::MAX } else { finite }),
            finite,
            lidar_alive: AtomicBool::new(false),
            progress: self.counts.clone(),
        });
        let mut threads = Threads {
            control: Arc::clone(&control),
            running: Vec::new(),
            meters: Vec::new(),
            inlet: recorder.inlet().tapped(self.tap),
            remarks: self.remarks,
        };
        if let (Some(source), Some(net)) = (self.lidar, &self.config.lidar) {
            let decoder = net.decoder();
            threads.start(lidar::LIDAR, lidar::LIDAR, Ends::Never, move |on| {
                lidar::record(source, decoder, on.inlet, on.control, on.meter)
            })?;
        }
        for (index, unit) in cameras.into_iter().enumerate() {
            let thread = format!("camera{index}");
            let device = unit.config.names.join("+");
            threads.start(&thread, &device, Ends::ByItself, move |on| {
                camera::record(unit, on.inlet, on.control, on.meter)
            })?;
        }
        if let Some(line) = imu {
            threads.start("imu", imu::IMU, Ends::ByItself, |on| {
                imu::record(line, on.inlet, on.control, on.meter)
            })?;
        }
        if let Some(server) = self.sidecar {
            threads.start("sidecar", "sidecar", Ends::ByItself, |on| {
                sidecar::record(server, &on.inlet.patient(), on.control, on.meter)
            })?;
        }
        let meters = threads.meters.clone();
        let monitor = Monitor::new(&recorder, meters, self.health.clone(), out, &self.config);
        let streams = threads.wait(&recorder, monitor, progress);
        self.health.close();
        let mut streams = streams?;
        streams.iter_mut().for_each(StreamReport::name_silence);
        let written = recorder.finish(&streams)?;
        Ok(CaptureReport::new(out, written, streams))
    }

    /// Refuses to begin what will not fit.
    fn check_space(&self, out: &Path) -> Result<(), Error> {
        let settings = &self.config.recorder;
        if settings.least_space_secs <= 0.0 {
            return Ok(());
        }
        let folder = out.parent().unwrap_or(Path::new("")).to_owned();
        let mut folders = vec![folder];
        if let Some(second) = &settings.second_folder {
            recorder::make_folder(&second.join("x"))?;
            folders.push(second.clone());
        }
        recorder::check_space(
            &folders,
            self.config.expected_bytes_per_sec(),
            settings.least_space_secs,
        )
    }
}

/// The devices that are asked rather than listened to.
fn open_devices(config: &DevicesConfig) -> Result<(Vec<camera::Unit>, Option<imu::Line>), Error> {
    let mut cameras = Vec::new();
    for unit in &config.cameras {
        cameras.push(camera::Unit {
            camera: MyntCamera::open(&unit.open())?,
            config: unit.clone(),
        });
    }
    let Some(line) = &config.imu else {
        return Ok((cameras, None));
    };
    let line = imu::Line {
        unit: imu::ImuUnit::open(line)?,
        config: line.clone(),
    };
    Ok((cameras, Some(line)))
}

/// Whether a device says when it has no more to send.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Ends {
    ByItself,
    Never,
}

/// What a device's thread works with.
struct Bench<'a> {
    inlet: &'a Inlet,
    control: &'a Control,
    meter: &'a Meter,
}

struct Threads {
    control: Arc<Control>,
    running: Vec<(String, JoinHandle<StreamReport>)>,
    meters: Vec<Meter>,
    inlet: Inlet,
    remarks: Option<RemarkQueue>,
}

impl Threads {
    fn start(
        &mut self,
        thread: &str,
        device: &str,
        ends: Ends,
        work: impl FnOnce(&Bench<'_>) -> StreamReport + Send + 'static,
    ) -> Result<(), Error> {
        let (inlet, control) = (self.inlet.clone(), Arc::clone(&self.control));
        let meter = Meter::new(device);
        self.meters.push(meter.clone());
        let handle = recorder::spawn(thread, move || {
            let report = work(&Bench {
                inlet: &inlet,
                control: &control,
                meter: &meter,
            });
            meter.end(&report);
            if ends == Ends::ByItself {
                control.running.fetch_sub(1, Ordering::Relaxed);
            }
            report
        })?;
        self.running.push((thread.to_owned(), handle));
        Ok(())
    }

    fn wait(
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
                self.control.stop.store(true, Ordering::Relaxed);
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
