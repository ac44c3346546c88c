//! All devices of a walk, running.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use lsfb_drivers::sidecar::ClientConfig;
use lsfb_types::{Progress, ProgressFn};

use super::clock::{Pace, SimClock};
use super::glasses::GlassesDevice;
use super::inertial::InertialDevice;
use super::lidar::{FlowControl, LidarDevice};
use super::mynt::MyntDevice;
use super::thread::spawn;
use crate::{Error, Simulation};

/// Stereo units on the backpack.
pub const MYNT_UNITS: usize = 2;
/// How far one device may run ahead of another, simulated nanoseconds.
const SKEW_NS: i64 = 200_000_000;
const REPORT_EVERY: Duration = Duration::from_millis(100);

/// Where the host of the backpack listens, and where the devices are to appear.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScanEndpoints {
    /// The LiDAR's data packets go here.
    pub lidar_data: SocketAddr,
    /// The LiDAR's position packets go here.
    pub lidar_position: SocketAddr,
    /// Sockets that the stereo units make: `cam0` and `cam1`, `cam2` and `cam3`.
    pub camera_sockets: [PathBuf; MYNT_UNITS],
}

/// What the devices have sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SessionReport {
    /// LiDAR data packets.
    pub lidar_data_packets: u64,
    /// LiDAR position packets.
    pub lidar_position_packets: u64,
    /// Frames of all camera units together.
    pub stereo_frames: u64,
    /// Segments of the IMUs inside the camera units, of a played recording.
    pub unit_imu_segments: u64,
    /// Packets of the backpack's IMU.
    pub imu_packets: u64,
    /// Sidecar messages.
    pub sidecar_messages: u64,
    /// Messages of a played recording that could not be read, and were not sent.
    pub unreadable: u64,
}

impl SessionReport {
    fn plus(self, other: Self) -> Self {
        Self {
            lidar_data_packets: self.lidar_data_packets + other.lidar_data_packets,
            lidar_position_packets: self.lidar_position_packets + other.lidar_position_packets,
            stereo_frames: self.stereo_frames + other.stereo_frames,
            unit_imu_segments: self.unit_imu_segments + other.unit_imu_segments,
            imu_packets: self.imu_packets + other.imu_packets,
            sidecar_messages: self.sidecar_messages + other.sidecar_messages,
            unreadable: self.unreadable + other.unreadable,
        }
    }
}

/// Running devices. Dropping it stops them.
#[derive(Debug)]
pub struct SimSession {
    clock: Arc<SimClock>,
    threads: Vec<JoinHandle<Result<SessionReport, Error>>>,
    imu_path: Option<PathBuf>,
    total_ns: i64,
}

/// Stops a session from another thread.
#[derive(Clone, Debug)]
pub struct StopHandle {
    clock: Arc<SimClock>,
}

impl StopHandle {
    /// Ends the streams where they are; the hosts see the end of each.
    pub fn stop(&self) {
        self.clock.stop();
    }
}

impl SimSession {
    /// Starts the devices of the backpack. The host must already listen for the LiDAR; cameras and IMU may be opened
    /// when it likes. Simulated time begins when all are.
    pub fn start_scan(
        simulation: &Arc<Simulation>,
        endpoints: &ScanEndpoints,
        pace: Pace,
        flow: Option<FlowControl>,
    ) -> Result<Self, Error> {
        let lidar = LidarDevice::new(endpoints.lidar_data, endpoints.lidar_position, flow)?;
        let rate_hz = simulation.scan().imu_rate_hz() as u16;
        let imu = InertialDevice::new(simulation.config().scan_imu_family, rate_hz)?;
        let [first, second] = &endpoints.camera_sockets;
        let units = [MyntDevice::bind(0, first)?, MyntDevice::bind(1, second)?];
        let duration_s = simulation.scan().walk().duration_s();
        let mut session = Self::empty(2 + MYNT_UNITS, pace, duration_s);
        session.imu_path = Some(imu.path());
        session.spawn(
            "sim-lidar",
            0,
            simulation,
            move |simulation, clock, device| {
                let tally = lidar.run(simulation, clock, device)?;
                Ok(SessionReport {
                    lidar_data_packets: tally.data_packets,
                    lidar_position_packets: tally.position_packets,
                    ..SessionReport::default()
                })
            },
        )?;
        session.spawn(
            "sim-imu",
            1,
            simulation,
            move |simulation, clock, device| {
                Ok(SessionReport {
                    imu_packets: imu.run(simulation.scan(), clock, device)?,
                    ..SessionReport::default()
                })
            },
        )?;
        for (k, unit) in units.into_iter().enumerate() {
            let name = format!("sim-mynt{k}");
            session.spawn(
                &name,
                2 + k,
                simulation,
                move |simulation, clock, device| {
                    Ok(SessionReport {
                        stereo_frames: unit.run(simulation, clock, device)?,
                        ..SessionReport::default()
                    })
                },
            )?;
        }
        Ok(session)
    }

    /// Starts the glasses, which look for their rig as long as `patience`.
    pub fn start_glasses(
        simulation: &Arc<Simulation>,
        rig: &ClientConfig,
        pace: Pace,
        patience: Duration,
    ) -> Result<Self, Error> {
        let glasses = GlassesDevice::new(rig, &simulation.glasses().rig().name, patience);
        let duration_s = simulation.glasses().walk().duration_s();
        let mut session = Self::empty(1, pace, duration_s);
        session.spawn(
            "sim-glasses",
            0,
            simulation,
            move |simulation, clock, device| {
                Ok(SessionReport {
                    sidecar_messages: glasses.run(simulation, clock, device)?,
                    ..SessionReport::default()
                })
            },
        )?;
        Ok(session)
    }

    /// The serial line of the backpack's IMU.
    pub fn imu_path(&self) -> Option<&Path> {
        self.imu_path.as_deref()
    }

    /// For stopping the session while another thread is in [`SimSession::join`].
    pub fn stop_handle(&self) -> StopHandle {
        StopHandle {
            clock: Arc::clone(&self.clock),
        }
    }

    /// Waits until everything is sent. The first device that failed decides the error; the others have run to their
    /// end all the same. Told to stop, it ends the streams where they are,
    /// as [`StopHandle::stop`] does.
    pub fn join(mut self, progress: ProgressFn) -> Result<SessionReport, Error> {
        while self.threads.iter().any(|thread| !thread.is_finished()) {
            let done_ns = self.clock.slowest_ns().unwrap_or(self.total_ns);
            let told = progress(Progress {
                stage: "simulated walk",
                done: done_ns as u64 / 1_000_000,
                total: self.total_ns as u64 / 1_000_000,
            });
            if told.is_err() {
                self.clock.stop();
            }
            thread::sleep(REPORT_EVERY);
        }
        let mut outcome = Ok(SessionReport::default());
        for thread in self.threads.drain(..) {
            let name = thread.thread().name().unwrap_or_default().to_owned();
            let sent = thread.join().unwrap_or(Err(Error::Thread {
                name,
                problem: "panicked".to_owned(),
            }));
            outcome = match (outcome, sent) {
                (Ok(report), Ok(sent)) => Ok(report.plus(sent)),
                (Ok(_), Err(e)) | (Err(e), _) => Err(e),
            };
        }
        outcome
    }

    pub(super) fn empty(devices: usize, pace: Pace, duration_s: f64) -> Self {
        Self {
            clock: Arc::new(SimClock::new(devices, SKEW_NS, pace)),
            threads: Vec::new(),
            imu_path: None,
            total_ns: (duration_s * 1e9) as i64,
        }
    }

    fn spawn(
        &mut self,
        name: &str,
        device: usize,
        simulation: &Arc<Simulation>,
        run: impl FnOnce(&Arc<Simulation>, &SimClock, usize) -> Result<SessionReport, Error>
        + Send
        + 'static,
    ) -> Result<(), Error> {
        let simulation = Arc::clone(simulation);
        self.spawn_device(name, device, move |clock, device| {
            run(&simulation, clock, device)
        })
    }

    pub(super) fn set_imu_path(&mut self, path: PathBuf) {
        self.imu_path = Some(path);
    }

    /// Starts the thread of the device with this number.
    pub(super) fn spawn_device(
        &mut self,
        name: &str,
        device: usize,
        run: impl FnOnce(&SimClock, usize) -> Result<SessionReport, Error> + Send + 'static,
    ) -> Result<(), Error> {
        let clock = Arc::clone(&self.clock);
        let thread = spawn(name, move || {
            let outcome = run(&clock, device);
            clock.finish(device);
            outcome
        })?;
        self.threads.push(thread);
        Ok(())
    }
}

impl Drop for SimSession {
    fn drop(&mut self) {
        self.stop_handle().stop();
        for thread in self.threads.drain(..) {
            // A panic there has been reported by the panic hook already.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests;
