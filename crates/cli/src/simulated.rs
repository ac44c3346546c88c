//! Simulated devices beside the recorder that reads them.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use lsfb_capture::{
    CameraUnitConfig, CaptureReport, Counts, DevicesConfig, ImuLineConfig, Incoming,
    LidarNetConfig, Overflow, RecorderConfig, Session, SidecarConfig, record_incoming,
};
use lsfb_drivers::sidecar::ClientConfig;
use lsfb_geometry::{MAIN_IMU, Rig};
use lsfb_recording::Existing;
use lsfb_sim::{
    Clocked, Emitted, FlowControl, LidarModel, Pace, Returns, SIMULATED_LIDARS, ScanEndpoints,
    SimConfig, SimSession, SimulatedImu, Simulation,
};
use lsfb_types::Stopped;

use crate::context::Context;
use crate::one_of::one_of;
use crate::phones;

/// How long glasses look for a recorder in this process.
const PATIENCE: Duration = Duration::from_secs(60);

/// Name of the file with the settings of a simulated session.
pub const SETTINGS: &str = "sim.toml";

/// Where the devices send to, and a phone connects.
#[derive(clap::Args, Clone, Debug)]
pub struct Endpoints {
    /// Address to send the LiDAR's data packets to.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:2368")]
    pub lidar_data: SocketAddr,
    /// Address to send the LiDAR's position packets to.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:8308")]
    pub lidar_position: SocketAddr,
    /// Address of the recorder that phones and glasses connect to.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:8790")]
    pub sidecar: SocketAddr,
}

/// What the simulated backpack carries, where it is not as configured.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct Equipment {
    /// The LiDAR.
    #[arg(long, value_name = "MODEL", value_parser = one_of(&SIMULATED_LIDARS, LidarModel::key))]
    lidar_model: Option<LidarModel>,
    /// Return mode of the LiDAR.
    #[arg(long, value_name = "MODE", value_parser = one_of(&Returns::ALL, Returns::key))]
    returns: Option<Returns>,
    /// Protocol of the IMU.
    #[arg(long, value_name = "FAMILY", value_parser = one_of(&SimulatedImu::ALL, |unit| unit.family().key()))]
    imu_family: Option<SimulatedImu>,
}

impl Equipment {
    /// Puts it into the settings.
    pub fn apply(&self, config: &mut SimConfig) {
        let lidar = &mut config.lidar;
        lidar.model = self.lidar_model.unwrap_or(lidar.model);
        lidar.returns = self.returns.unwrap_or(lidar.returns);
        config.scan_imu_family = self.imu_family.unwrap_or(config.scan_imu_family);
    }
}

/// Names of the files of a simulated session in its folder.
pub struct Layout {
    folder: PathBuf,
}

impl Layout {
    /// Makes the folder.
    pub fn create(folder: &Path) -> anyhow::Result<Self> {
        let layout = Self {
            folder: folder.to_owned(),
        };
        for path in [layout.folder.clone(), layout.truth(), layout.devices()] {
            std::fs::create_dir_all(&path).with_context(|| path.display().to_string())?;
        }
        Ok(layout)
    }

    /// A file or folder in the session's folder.
    pub fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// The folder of the truth, for `lsfb eval` alone.
    pub fn truth(&self) -> PathBuf {
        self.file("truth")
    }

    /// Sockets and lines of the simulated devices.
    fn devices(&self) -> PathBuf {
        self.file("devices")
    }

    fn camera_sockets(&self) -> [PathBuf; 2] {
        ["mynt_front", "mynt_rear"].map(|name| self.devices().join(name))
    }

    fn imu_line(&self) -> PathBuf {
        self.devices().join("imu0")
    }
}

/// Builds the world and writes what is known beforehand: rigs and settings beside, the truth in a folder of its own. Rigs of backpack
/// and second walk that were `calibrated` are what the devices state; without, they state how they were built. The world of an `earlier`
/// simulation is taken where it is the same.
pub fn prepare(
    layout: &Layout,
    config: &SimConfig,
    calibrated: [Option<Rig>; 2],
    earlier: Option<&Simulation>,
    context: &Context,
) -> anyhow::Result<Arc<Simulation>> {
    let mut asked = config.clone();
    if asked.light.baked && asked.light.cache.as_os_str().is_empty() {
        asked.light.cache = layout.file("light");
    }
    let simulation = Simulation::after(earlier, &asked, &|p| context.show(p))?;
    if let Some(report) = simulation.world().light_report()
        && let (Some(file), Some(problem)) = (&report.file, &report.damaged)
    {
        context.note(&format!(
            "{}: {problem}; the light was computed again",
            file.display()
        ));
    }
    let simulation = Arc::new(simulation.calibrated(calibrated));
    let marks = simulation.marks();
    for (name, text) in [
        ("backpack.toml", simulation.scan().stated_rig().to_toml()),
        ("glasses.toml", simulation.glasses().stated_rig().to_toml()),
        (SETTINGS, toml::to_string(config)?),
        ("marks.csv", marks.clicks),
    ] {
        crate::files::write(&layout.file(name), text)?;
    }
    if !marks.control_points.is_empty() {
        crate::files::write(&layout.file("control_points.csv"), marks.control_points)?;
    }
    simulation.write_truth(&layout.truth())?;
    crate::files::write(&layout.truth().join("truth_marks.survey"), marks.survey)?;
    Ok(simulation)
}

/// Simulated walks are short: room for a minute is enough.
pub fn short_walk() -> RecorderConfig {
    RecorderConfig {
        least_space_secs: 60.0,
        ..RecorderConfig::default()
    }
}

/// The backpack's devices as `lsfb scan` sees them.
pub fn backpack_devices(
    layout: &Layout,
    config: &SimConfig,
    lidar: LidarNetConfig,
    overflow: Overflow,
) -> DevicesConfig {
    let [front, rear] = layout.camera_sockets();
    let cameras = &config.scan_cameras;
    let unit = |path, names: [&str; 2]| CameraUnitConfig {
        // Both images side by side.
        frame_px: [2 * cameras.width, cameras.height],
        rate_hz: cameras.rate_hz,
        ..CameraUnitConfig::stereo(path, names.map(str::to_owned))
    };
    DevicesConfig {
        rig: Some(layout.file("backpack.toml")),
        overflow,
        lidars: vec![lidar],
        cameras: vec![unit(front, ["cam0", "cam1"]), unit(rear, ["cam2", "cam3"])],
        imus: vec![ImuLineConfig {
            name: MAIN_IMU.to_owned(),
            family: config.scan_imu_family.family(),
            path: layout.imu_line(),
            baud: 921_600,
            rate_hz: u16::try_from(config.scan_imu.rate_hz).unwrap_or(u16::MAX),
        }],
        recorder: short_walk(),
        sidecar: None,
    }
}

/// What a recorder of the glasses listens on.
pub fn glasses_devices(layout: &Layout, listen: SocketAddr, overflow: Overflow) -> DevicesConfig {
    DevicesConfig {
        sidecar: Some(SidecarConfig::new(listen, layout.file(phones::FOLDER))),
        overflow,
        recorder: short_walk(),
        ..DevicesConfig::default()
    }
}

/// Starts the backpack's devices. With `counts` of a recorder in this process none of their datagrams is lost.
pub fn start_backpack(
    layout: &Layout,
    simulation: &Arc<Simulation>,
    lidar: LidarNetConfig,
    pace: Pace,
    counts: Option<&Counts>,
) -> anyhow::Result<SimSession> {
    let camera_sockets = layout.camera_sockets();
    for path in camera_sockets.iter().chain([&layout.imu_line()]) {
        // Left behind by an earlier run; if it cannot go, binding says so.
        let _ = std::fs::remove_file(path);
    }
    let endpoints = ScanEndpoints {
        lidar_data: lidar.data,
        lidar_position: lidar.position,
        camera_sockets,
    };
    let flow = counts.map(|c| FlowControl::new(Arc::clone(&c.lidar_packets)));
    let session = SimSession::start_scan(simulation, &endpoints, pace, flow)?;
    let line = session
        .imu_path()
        .context("the simulated IMU has no serial line")?;
    std::os::unix::fs::symlink(line, layout.imu_line())
        .with_context(|| layout.imu_line().display().to_string())?;
    Ok(session)
}

/// What lies there from an earlier run is replaced, and how much it will be is known.
fn in_a_folder_of_our_own() -> RecorderConfig {
    RecorderConfig {
        existing: Existing::Replace,
        least_space_secs: 0.0,
        ..RecorderConfig::default()
    }
}

/// Records everything without sockets and without waiting: what the devices send arrives when the simulated links say.
/// Clocks can be told from such recordings, and they are the same on any machine.
pub fn record_with_simulated_arrivals(
    layout: &Layout,
    simulation: &Simulation,
    context: &Context,
) -> anyhow::Result<Vec<CaptureReport>> {
    let nowhere = SocketAddr::from(([127, 0, 0, 1], 0));
    let net = LidarNetConfig {
        data: nowhere,
        position: nowhere,
        ..LidarNetConfig::default()
    };
    let mut backpack = backpack_devices(layout, simulation.config(), net, Overflow::Wait);
    backpack.recorder = in_a_folder_of_our_own();
    let mut glasses = glasses_devices(layout, nowhere, Overflow::Wait);
    glasses.recorder = in_a_folder_of_our_own();
    Ok(vec![
        record_emitted(
            simulation.emit_scan(&Clocked::SCAN),
            &backpack,
            &layout.file("scan.mcap"),
            context,
        )?,
        record_emitted(
            simulation.emit_walk(),
            &glasses,
            &layout.file("walk.mcap"),
            context,
        )?,
    ])
}

fn record_emitted(
    emitted: impl Iterator<Item = Result<Emitted, lsfb_sim::Error>>,
    devices: &DevicesConfig,
    out: &Path,
    context: &Context,
) -> anyhow::Result<CaptureReport> {
    let mut failure = None;
    let incoming = emitted.map_while(|item| match item {
        Ok(Emitted::Lidar(packet)) => Some(Incoming::Lidar { lidar: 0, packet }),
        Ok(Emitted::Imu(packet)) => Some(Incoming::Imu { imu: 0, packet }),
        Ok(Emitted::Frame { unit, packet }) => Some(Incoming::Frame { unit, packet }),
        Ok(Emitted::Sidecar { arrival, message }) => Some(Incoming::Sidecar { arrival, message }),
        Err(error) => {
            failure = Some(error);
            None
        }
    });
    let report = record_incoming(incoming, devices, out, &|p| context.show(p))?;
    match failure {
        Some(error) => Err(error.into()),
        None => whole(report),
    }
}

/// Records the simulated backpack, all in this process.
pub fn record_backpack(
    layout: &Layout,
    simulation: &Arc<Simulation>,
    context: &Context,
) -> anyhow::Result<CaptureReport> {
    let loopback = SocketAddr::from(([127, 0, 0, 1], 0));
    let any = LidarNetConfig {
        data: loopback,
        position: loopback,
        ..LidarNetConfig::default()
    };
    let mut devices = backpack_devices(layout, simulation.config(), any, Overflow::Wait);
    devices.recorder = in_a_folder_of_our_own();
    let recorder = Session::open(&devices)?;
    let [data, position] = recorder.lidar_addresses()[..] else {
        anyhow::bail!("the recorder has no LiDAR address")
    };
    let lidar = LidarNetConfig {
        data,
        position,
        ..LidarNetConfig::default()
    };
    let devices = start_backpack(
        layout,
        simulation,
        lidar,
        Pace::Unlimited,
        Some(&recorder.counts()),
    )?;
    record(
        recorder,
        devices,
        &layout.file("scan.mcap"),
        "recording the scan",
        context,
    )
}

/// How the simulated glasses connect to their recorder.
pub fn invite_glasses(
    layout: &Layout,
    simulation: &Simulation,
    address: SocketAddr,
) -> anyhow::Result<ClientConfig> {
    let session = format!("seed-{}", simulation.config().seed);
    phones::invite(&layout.file(phones::FOLDER), address, "glasses", &session)
}

/// What a recording of a walk says besides what was measured.
pub struct WalkTold<'a> {
    /// Name of the session, which is in the recording.
    pub session: String,
    /// The key by which identifiers of access points and beacons are hashed; made where it is not there. Without, they are recorded.
    pub identifiers_key: Option<&'a Path>,
}

/// Records the simulated glasses, all in this process.
pub fn record_glasses(
    layout: &Layout,
    simulation: &Arc<Simulation>,
    context: &Context,
) -> anyhow::Result<CaptureReport> {
    let told = WalkTold {
        session: format!("seed-{}", simulation.config().seed),
        identifiers_key: None,
    };
    record_walk(layout, simulation, &told, context)
}

/// The same, with what the recording says besides.
pub fn record_walk(
    layout: &Layout,
    simulation: &Arc<Simulation>,
    told: &WalkTold,
    context: &Context,
) -> anyhow::Result<CaptureReport> {
    let any = SocketAddr::from(([127, 0, 0, 1], 0));
    let mut devices = glasses_devices(layout, any, Overflow::Wait);
    devices.recorder = in_a_folder_of_our_own();
    if let Some(sidecar) = &mut devices.sidecar {
        sidecar.hash_identifiers = told.identifiers_key.is_some();
    }
    let folder = layout.file(phones::FOLDER);
    if let Some(key) = told.identifiers_key.filter(|key| key.exists()) {
        phones::give_identifiers_key(&folder, key)?;
    }
    let recorder = Session::open(&devices)?;
    if let Some(key) = told.identifiers_key.filter(|key| !key.exists()) {
        phones::keep_identifiers_key(&folder, key)?;
    }
    let address = recorder
        .sidecar_address()
        .context("the recorder has no sidecar address")?;
    let rig = phones::invite(&folder, address, "glasses", &told.session)?;
    let devices = SimSession::start_glasses(simulation, &rig, Pace::Unlimited, PATIENCE)?;
    let recorded = record(
        recorder,
        devices,
        &layout.file("walk.mcap"),
        "recording the walk",
        context,
    );
    // Nobody comes back; if it cannot go, it is in nobody's way.
    let _ = std::fs::remove_dir_all(folder);
    recorded
}

/// What the recorder could not go on with is an error here: nobody waits for the rest.
fn whole(report: CaptureReport) -> anyhow::Result<CaptureReport> {
    match &report.failure {
        Some(why) => crate::files::about(&report.path, Err(anyhow::anyhow!("{why}"))),
        None => Ok(report),
    }
}

/// Half a walk looks like a whole one.
fn discard(report: &CaptureReport) {
    for part in &report.parts {
        // Somebody else may have been faster.
        let _ = std::fs::remove_file(part);
    }
}

fn record(
    recorder: Session,
    devices: SimSession,
    out: &Path,
    stage: &'static str,
    context: &Context,
) -> anyhow::Result<CaptureReport> {
    let stop = devices.stop_handle();
    std::thread::scope(|scope| {
        let recording = std::thread::Builder::new()
            .name("recording".to_owned())
            .spawn_scoped(scope, || {
                let report = recorder.run(out, &|_| context.check_stop());
                // A recorder that failed or was stopped must not leave the devices waiting for it.
                stop.stop();
                report
            })?;
        let sent = devices.join(&|p| context.show(lsfb_types::Progress { stage, ..p }));
        let recorded = recording
            .join()
            .map_err(|_| anyhow::anyhow!("the recording thread panicked"))?;
        let report = unless_stopped(recorded, context.check_stop())?;
        sent?;
        Ok(report)
    })
}

/// A whole recording. Where an end was asked for there is none, and that a device which was told to end is gone is no failure.
fn unless_stopped(
    recorded: Result<CaptureReport, lsfb_capture::Error>,
    asked: Result<(), Stopped>,
) -> anyhow::Result<CaptureReport> {
    if let Err(stopped) = asked {
        if let Ok(report) = &recorded {
            discard(report);
        }
        return Err(stopped.into());
    }
    whole(recorded?)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Devices are told to end as well, maybe before the recorder has looked: it has lost one of them then.
    #[test]
    fn a_device_that_ends_as_was_asked_for_is_no_failure() {
        let gone = || Err(lsfb_capture::Error::NoDevice);
        let stopped = unless_stopped(gone(), Err(Stopped)).expect_err("no recording");
        assert!(stopped.is::<Stopped>(), "{stopped}");
        let failed = unless_stopped(gone(), Ok(())).expect_err("no recording");
        assert!(!failed.is::<Stopped>(), "{failed}");
    }
}
