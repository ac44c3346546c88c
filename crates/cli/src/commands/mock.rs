//! `lsfb mock`: what was recorded, sent again as if by devices.

use std::collections::BTreeMap;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context as _;
use lsfb_capture::{
    CameraUnitConfig, DevicesConfig, ImuLineConfig, LidarNetConfig, Overflow, SidecarConfig,
};
use lsfb_drivers::ImuFamily;
use lsfb_drivers::sidecar::ClientConfig;
use lsfb_sim::{Pace, Playback, PlaybackEndpoints, Turns};

use super::sim;
use crate::context::Context;
use crate::outcome::Outcome;
use crate::phones;
use crate::simulated::{Endpoints, Equipment, short_walk};

/// Name of the IMU among the mock devices.
const IMU: &str = "imu0";
/// How long sidecars look for their recorder.
const PATIENCE: Duration = Duration::from_secs(3600);

/// Play a recording, a capture file or the simulator as live devices.
///
/// LiDAR packets go to the network, IMU bytes to a pseudo-terminal, a CAN interface or a mock USB
/// device, camera frames to sockets, and a phone's messages to the sidecar port, each exactly as
/// received and at its device's own time: `lsfb scan` in another process cannot tell the difference.
/// The list of devices to record from is written into the folder. Nothing is sent until every device is
/// connected.
///
/// With --loop, the devices' clocks restart with each repetition, and the recorder reports it. A
/// capture file (pcap, pcapng, db3) holds only a LiDAR, which never signals its end: stop the recorder
/// with Ctrl-C. A CAN bus does not signal its end either; next to devices that do, the recorder takes
/// its silence for the end.
///
/// An SBG unit needs a CAN interface, e.g. a virtual one: ip link add vcan0 type vcan && ip link set
/// vcan0 up
///
/// Examples:
///   lsfb mock scan.mcap --out mock              # then, in another terminal:
///   lsfb scan --devices mock/devices.toml --out again.mcap
///   lsfb mock drive.pcap --out mock --speed 2 --loop
///   lsfb mock --seed 7 --out sim --lidar-model vlp-16  # the simulator, like `lsfb sim`
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Recording (MCAP), pcap, pcapng or rosbag2 database (db3).
    #[arg(required_unless_present = "seed", conflicts_with = "Equipment")]
    source: Option<PathBuf>,
    /// Play the simulator with this seed instead of a file.
    #[arg(long, value_name = "N", conflicts_with_all = ["source", "turns"], value_parser = super::seed, allow_hyphen_values = true)]
    seed: Option<u64>,
    /// Folder for the list of devices, the rig, and the mock devices' sockets.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Playback speed: recorded seconds per second.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = speed)]
    speed: f64,
    /// Play it N times; without a number, until Ctrl-C.
    #[arg(long = "loop", value_name = "N", num_args = 0..=1, default_missing_value = "0")]
    turns: Option<u32>,
    /// CAN interface on which an SBG unit sends.
    #[arg(long, value_name = "INTERFACE", default_value = "vcan0")]
    can: String,
    #[command(flatten)]
    equipment: Equipment,
    #[command(flatten)]
    endpoints: Endpoints,
}

/// A speed at which time can pass.
pub fn speed(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(speed) if speed > 0.0 && speed.is_finite() => Ok(speed),
        _ => Err("expected a positive number, for example 1 or 0.5".to_owned()),
    }
}

/// Plays to the end, or until Ctrl-C.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let Some(source) = &arguments.source else {
        let simulator = sim::Arguments::playing(
            &arguments.out,
            arguments.seed.unwrap_or_default(),
            arguments.speed,
            arguments.equipment.clone(),
            arguments.endpoints.clone(),
        );
        return sim::run(&simulator, context);
    };
    let playback = Playback::open(source)?;
    for topic in playback.unplayed() {
        context.say(&format!(
            "warning: {topic} is not played: its device's raw bytes were not recorded"
        ));
    }
    let folder = Folder::create(&arguments.out)?;
    let devices = folder.devices(&playback, arguments);
    if let (Some(path), Some(rig)) = (&devices.rig, playback.rig()) {
        super::write(path, rig.to_toml())?;
    }
    let list = folder.file("devices.toml");
    super::write(&list, devices.to_toml())?;
    let endpoints = PlaybackEndpoints {
        lidar_data: arguments.endpoints.lidar_data,
        lidar_position: arguments.endpoints.lidar_position,
        camera_sockets: devices.cameras.iter().map(|c| c.path.clone()).collect(),
        can: arguments.can.clone(),
        usb: folder.device(IMU),
        sidecars: folder.invite(&playback, arguments)?,
        patience: PATIENCE,
    };
    let turns = match arguments.turns {
        None => Turns::Times(1),
        Some(0) => Turns::Endless,
        Some(times) => Turns::Times(times),
    };
    let session = playback
        .start(&endpoints, Pace::RealTimes(arguments.speed), turns)
        .with_context(|| playback_needs(&playback, arguments))?;
    if let (Some(line), Some(imu)) = (session.imu_path(), devices.imus.first()) {
        symlink(line, &imu.path).with_context(|| imu.path.display().to_string())?;
    }
    context.note(&format!(
        "waiting for: lsfb scan --devices {} --out again.mcap",
        list.display()
    ));
    let sent = session.join(&|p| match turns {
        Turns::Endless => context.check_stop(),
        Turns::Times(_) => context.show(p),
    })?;
    let report = serde_json::json!({
        "source": source,
        "lidar_data_packets": sent.lidar_data_packets,
        "lidar_position_packets": sent.lidar_position_packets,
        "stereo_frames": sent.stereo_frames,
        "unit_imu_segments": sent.unit_imu_segments,
        "imu_packets": sent.imu_packets,
        "sidecar_messages": sent.sidecar_messages,
        "unreadable": sent.unreadable,
    });
    context.print_ended(&report, || {
        let mut text = format!(
            "{}: sent {} LiDAR packets ({} of position), {} camera frames, {} chunks of the IMU's stream, {} sidecar messages",
            source.display(),
            sent.lidar_data_packets + sent.lidar_position_packets,
            sent.lidar_position_packets,
            sent.stereo_frames,
            sent.imu_packets,
            sent.sidecar_messages
        );
        if sent.unit_imu_segments > 0 {
            text += &format!(", {} segments of the cameras' own IMUs", sent.unit_imu_segments);
        }
        if sent.unreadable > 0 {
            text += &format!("\n  {} messages could not be read and were not sent", sent.unreadable);
        }
        text
    })?;
    Ok(if sent.unreadable == 0 {
        Outcome::Done
    } else {
        Outcome::DataLost
    })
}

/// What a source that cannot be played is told.
fn playback_needs(playback: &Playback, arguments: &Arguments) -> String {
    match playback.imu_family() {
        Some(ImuFamily::Sbg) => format!(
            "the recorded SBG unit needs the CAN interface {}: create it, or name another with --can",
            arguments.can
        ),
        _ => format!("the devices in {}", arguments.out.display()),
    }
}

/// Where the mock devices appear.
struct Folder {
    path: PathBuf,
}

impl Folder {
    /// Makes it; what an earlier mock left behind goes.
    fn create(path: &Path) -> anyhow::Result<Self> {
        let path = std::path::absolute(path)?;
        let devices = path.join("devices");
        std::fs::create_dir_all(&devices).with_context(|| devices.display().to_string())?;
        for entry in std::fs::read_dir(&devices).with_context(|| devices.display().to_string())? {
            let entry = entry?.path();
            std::fs::remove_file(&entry).with_context(|| entry.display().to_string())?;
        }
        Ok(Self { path })
    }

    fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// A mock device.
    fn device(&self, name: &str) -> PathBuf {
        self.path.join("devices").join(name)
    }

    /// How the phones connect.
    fn invite(
        &self,
        playback: &Playback,
        arguments: &Arguments,
    ) -> anyhow::Result<BTreeMap<String, ClientConfig>> {
        let (folder, address) = (self.file(phones::FOLDER), arguments.endpoints.sidecar);
        let invited = playback.sidecars().iter().map(|name| {
            let rig = phones::invite(&folder, address, name, "mock")?;
            Ok((name.clone(), rig))
        });
        invited.collect()
    }

    /// The devices as `lsfb scan` sees them.
    fn devices(&self, playback: &Playback, arguments: &Arguments) -> DevicesConfig {
        let endpoints = &arguments.endpoints;
        let cameras = playback.cameras().iter().map(|unit| CameraUnitConfig {
            names: unit.names.clone(),
            frame_px: unit.frame_px,
            rate_hz: unit.rate_hz,
            imu: unit.imu.clone(),
            ..CameraUnitConfig::stereo(
                self.device(&format!("mynt_{}", unit.names.join("_"))),
                Default::default(),
            )
        });
        let wired = playback.has_lidar()
            || playback.imu_rate_hz().is_some()
            || !playback.cameras().is_empty();
        DevicesConfig {
            // A sidecar brings its own.
            rig: playback
                .rig()
                .filter(|_| wired)
                .map(|_| self.file("rig.toml")),
            overflow: Overflow::Drop,
            lidars: Vec::from_iter(playback.has_lidar().then_some(LidarNetConfig {
                data: endpoints.lidar_data,
                position: endpoints.lidar_position,
                ..LidarNetConfig::default()
            })),
            cameras: cameras.collect(),
            imus: playback
                .imu_family()
                .zip(playback.imu_rate_hz())
                .map(|(family, rate_hz)| ImuLineConfig {
                    name: IMU.to_owned(),
                    family,
                    path: match family {
                        ImuFamily::Sbg => PathBuf::from(&arguments.can),
                        _ => self.device(IMU),
                    },
                    baud: 921_600,
                    rate_hz,
                })
                .into_iter()
                .collect(),
            sidecar: (!playback.sidecars().is_empty())
                .then(|| SidecarConfig::new(endpoints.sidecar, self.file(phones::FOLDER))),
            recorder: short_walk(),
        }
    }
}
