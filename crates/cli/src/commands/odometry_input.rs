//! What `lsfb odometry` runs on: a recording of ours, somebody's bag, a capture of packets, a folder of clouds.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

use anyhow::{Context as _, bail};
use lsfb_capture::{CaptureReport, Ending, ReplayConfig, replay};
use lsfb_datasets::{CloudFolder, LidarMessages, LidarTopic, RosBag, ScanTimes, Unread, pose_in};
use lsfb_drivers::any_lidar::{Model, Settings};
use lsfb_drivers::transport::PacketSource;
use lsfb_drivers::transport::pcap::PcapSource;
use lsfb_geometry::{ImuNoiseModel, MAIN_LIDAR, Rig, RigLidar, Se3};
use lsfb_pipeline::odometry::{
    ImuSamples, OdometryConfig, OdometryResult, OdometryRun, TimedScan, run_odometry,
};
use lsfb_recording::Recording;
use lsfb_recording::cloud::{PointTimes, TimesBegin};
use lsfb_types::{Packet, Progress, Stamped};
use serde::Serialize;

use crate::context::Context;

/// Noise of an IMU of which nothing is known: a cheap one.
const UNKNOWN_IMU: ImuNoiseModel = ImuNoiseModel {
    gyro_noise_density: 1e-3,
    accel_noise_density: 1e-2,
    gyro_bias_walk: 1e-4,
    accel_bias_walk: 1e-3,
};
/// Noise of one range of a LiDAR of which nothing is known, metres.
const UNKNOWN_RANGE_NOISE_M: f64 = 0.02;
/// Messages of packets that wait to be decoded.
const WAITING_MESSAGES: usize = 4;

/// What the command line says about the input.
pub struct Choice<'a> {
    pub path: &'a Path,
    pub rig: Option<&'a Path>,
    pub lidar: Option<&'a str>,
    pub imu: Option<&'a str>,
    pub rate_hz: f64,
    /// The sensor: of packets the one that they must be of; of clouds one whose azimuths are times.
    pub model: Option<Model>,
}

/// What the scans and samples were taken from.
#[derive(Clone, Debug, Default, Serialize)]
pub struct InputReport {
    /// The topic of the scans.
    pub lidar_topic: Option<String>,
    /// The topic of the inertial samples.
    pub imu_topic: Option<String>,
    /// Where the LiDAR's pose on the IMU is from; absent without IMU.
    pub extrinsic: Option<&'static str>,
    /// When the scans were taken, by what.
    pub scan_times: String,
    /// What the reader should know.
    pub warnings: Vec<String>,
}

/// The odometry's result, and what it was made from.
pub struct Run {
    pub result: OdometryResult,
    pub input: InputReport,
}

/// Runs the odometry on whatever the input is.
pub fn run(choice: &Choice, config: &OdometryConfig, context: &Context) -> anyhow::Result<Run> {
    super::expect_file(choice.path, "record one with `lsfb scan`")?;
    let ending = choice.path.extension().and_then(|e| e.to_str());
    let ending = ending.map(str::to_lowercase);
    let run = match ending.as_deref() {
        Some("mcap") if is_ours(choice)? => of_recording(choice, config, context),
        Some("pcap" | "pcapng") => of_capture(choice, config, context),
        Some("mcap" | "db3" | "bag") => of_bag(choice, config, context),
        _ if choice.path.is_dir() && holds_a_bag(choice.path)? => of_bag(choice, config, context),
        _ => of_clouds(choice, config, context),
    }?;
    if run.result.trajectory.is_empty() {
        bail!(lsfb_pipeline::Error::NoScan {
            path: choice.path.to_owned(),
            scans: run.result.report.scans,
        });
    }
    Ok(run)
}

/// Whether an MCAP has a rig of its own, good or bad, and no other is asked for.
fn is_ours(choice: &Choice) -> anyhow::Result<bool> {
    let is_foreign = choice.lidar.is_some() || choice.imu.is_some() || choice.rig.is_some();
    let rig = Recording::open(choice.path)?.rig();
    let has_none = matches!(rig, Err(lsfb_recording::Error::MissingAttachment { .. }));
    Ok(!is_foreign && !has_none)
}

fn holds_a_bag(folder: &Path) -> anyhow::Result<bool> {
    let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    for entry in entries {
        if RosBag::is_file_of_one(&entry?.path()) {
            return Ok(true);
        }
    }
    Ok(false)
}

fn of_recording(
    choice: &Choice,
    config: &OdometryConfig,
    context: &Context,
) -> anyhow::Result<Run> {
    let recording = context.open(choice.path)?;
    let result = run_odometry(&recording, config, &|p| context.show(p));
    Ok(Run {
        result: super::about(choice.path, result)?,
        input: InputReport {
            lidar_topic: Some(format!("/{}/points", recording.main_lidar())),
            extrinsic: Some("rig"),
            scan_times: "stamps of the messages".to_owned(),
            ..InputReport::default()
        },
    })
}

/// The sensors of a foreign input, and what was said about them.
struct Sensors {
    lidar: RigLidar,
    imu: Option<ImuSamples>,
}

impl Sensors {
    /// A LiDAR alone: as a rig file has it, else in its own frame.
    fn lidar_alone(choice: &Choice) -> anyhow::Result<Self> {
        let lidar = match choice.rig {
            Some(path) => {
                let rig = Rig::read(path)?;
                let lidar = rig.lidar().cloned();
                lidar.with_context(|| format!("{}: the rig has no LiDAR", path.display()))?
            }
            None => RigLidar {
                rig_from_lidar: Se3::identity(),
                range_noise_m: UNKNOWN_RANGE_NOISE_M,
            },
        };
        Ok(Self { lidar, imu: None })
    }

    /// As a rig file has them; without one what a bag says of them: the IMU is used only where its place on the LiDAR is known.
    fn of_bag(
        bag: &RosBag,
        choice: &Choice,
        lidar_frame: &str,
        said: &mut InputReport,
        context: &Context,
    ) -> anyhow::Result<Self> {
        let mut sensors = Self::lidar_alone(choice)?;
        let rig = choice.rig.map(Rig::read).transpose()?;
        if !bag.has_imu() && choice.imu.is_none() {
            return Ok(sensors);
        }
        let imu = match bag.imu(choice.imu) {
            Ok(imu) => imu,
            // Nobody asked for it.
            Err(error) if choice.imu.is_none() => {
                said.warnings.push(format!("no IMU is used: {error}"));
                return Ok(sensors);
            }
            Err(error) => return Err(error.into()),
        };
        if rig.is_some() {
            said.extrinsic = Some("rig");
        } else if imu.frame == lidar_frame {
            said.extrinsic = Some("same frame");
        } else if let Some(pose) = pose_in(&imu.frame, lidar_frame, &bag.static_transforms()?) {
            sensors.lidar.rig_from_lidar = pose;
            said.extrinsic = Some("/tf_static");
        } else {
            let why = format!(
                "neither --rig nor /tf_static says where the LiDAR (frame {lidar_frame:?}) is on the IMU (frame {:?})",
                imu.frame
            );
            anyhow::ensure!(choice.imu.is_none(), "{}: {why}", choice.path.display());
            said.warnings.push(format!("no IMU is used: {why}"));
            return Ok(sensors);
        }
        said.warnings.extend(about_unread(&imu.unread, context));
        said.imu_topic = Some(imu.topic);
        let noise = rig.as_ref().and_then(Rig::imu_noise).cloned();
        let mut samples: Vec<_> = imu
            .samples
            .into_iter()
            .map(|(time, sample)| Stamped {
                time,
                arrival: time,
                device_ticks: 0,
                sample,
            })
            .collect();
        samples.sort_by_key(|s| s.time);
        sensors.imu = Some(ImuSamples {
            noise: noise.unwrap_or(UNKNOWN_IMU),
            samples,
        });
        Ok(sensors)
    }

    fn start(self, choice: &Choice, config: &OdometryConfig) -> anyhow::Result<OdometryRun> {
        let run = OdometryRun::new(config, &self.lidar, self.imu)?;
        Ok(match choice.model {
            Some(_) => run.with_times_by_azimuth(),
            None => run,
        })
    }
}

fn of_bag(choice: &Choice, config: &OdometryConfig, context: &Context) -> anyhow::Result<Run> {
    let bag = RosBag::open(choice.path)?;
    let LidarTopic { topic, messages } = bag.lidar(choice.lidar)?;
    let mut said = InputReport {
        lidar_topic: Some(topic.clone()),
        scan_times: "stamps of the messages".to_owned(),
        warnings: about_damage(&bag, context),
        ..InputReport::default()
    };
    let sensors = Sensors::of_bag(&bag, choice, &bag.frame(&topic)?, &mut said, context)?;
    let mut run = sensors.start(choice, config)?;
    if messages == LidarMessages::Packets {
        let scratch = Scratch::new()?;
        let (decoded, unread) = decode_bag(&topic, &scratch.scans, choice, context)?;
        said.warnings.extend(about_unread(&unread, context));
        said.scan_times = "packets".to_owned();
        said.warnings.extend(about_packets(&decoded, context));
        let result = run_on_scans(&scratch.scans, run, context)?;
        return Ok(Run {
            result,
            input: said,
        });
    }
    let mut clocks = 0_u64;
    let unread = bag.clouds(&topic, &mut |message| {
        context.show(Progress {
            stage: "lidar odometry",
            done: run.taken(),
            total: 0,
        })?;
        clocks += u64::from(message.has_two_clocks());
        let time = message.begins();
        run.push(TimedScan {
            scan: Stamped {
                time,
                arrival: message.stamp,
                device_ticks: 0,
                sample: message.cloud.scan,
            },
            times: message.cloud.times,
        })?;
        anyhow::Ok(())
    })?;
    said.warnings.extend(about_unread(&unread, context));
    if clocks > 0 {
        said.warnings.push(format!(
            "the points of {clocks} scans have times of another clock than the stamps of the messages: of them only the differences are used"
        ));
    }
    Ok(Run {
        result: super::about(choice.path, run.finish())?,
        input: said,
    })
}

fn of_capture(choice: &Choice, config: &OdometryConfig, context: &Context) -> anyhow::Result<Run> {
    expect_no_topics(choice)?;
    let scratch = Scratch::new()?;
    let source = PcapSource::open(choice.path, &[])?;
    let decoded = decode(source, &scratch.scans, choice, context)?;
    let run = Sensors::lidar_alone(choice)?.start(choice, config)?;
    Ok(Run {
        result: run_on_scans(&scratch.scans, run, context)?,
        input: InputReport {
            scan_times: "packets".to_owned(),
            warnings: about_packets(&decoded, context),
            ..InputReport::default()
        },
    })
}

/// Fails where a topic is named that the input cannot have.
fn expect_no_topics(choice: &Choice) -> anyhow::Result<()> {
    anyhow::ensure!(
        choice.imu.is_none() && choice.lidar.is_none(),
        "--imu-topic and --lidar-topic name topics of a bag, and {} is none",
        choice.path.display()
    );
    Ok(())
}

fn of_clouds(choice: &Choice, config: &OdometryConfig, context: &Context) -> anyhow::Result<Run> {
    expect_no_topics(choice)?;
    let clouds = CloudFolder::open(choice.path, choice.rate_hz)?;
    let mut run = Sensors::lidar_alone(choice)?.start(choice, config)?;
    for scan in clouds.scans() {
        context.show(Progress {
            stage: "lidar odometry",
            done: run.taken(),
            total: clouds.len() as u64,
        })?;
        let scan = scan?;
        run.push(TimedScan {
            scan: Stamped {
                time: scan.time,
                arrival: scan.time,
                device_ticks: 0,
                sample: scan.cloud.scan,
            },
            times: scan.cloud.times,
        })?;
    }
    let mut warnings = Vec::new();
    let scan_times = match clouds.scan_times() {
        ScanTimes::Points => "points".to_owned(),
        ScanTimes::Names => "names of the files".to_owned(),
        ScanTimes::List => "list beside the files".to_owned(),
        ScanTimes::Rate => {
            let rate = format!("{} scans a second (--rate-hz)", choice.rate_hz);
            warnings.push(format!(
                "nothing says when the scans were taken: {rate} are assumed"
            ));
            rate
        }
    };
    Ok(Run {
        result: super::about(choice.path, run.finish())?,
        input: InputReport {
            scan_times,
            warnings,
            ..InputReport::default()
        },
    })
}

/// The odometry over scans that were decoded from packets.
fn run_on_scans(
    path: &Path,
    mut run: OdometryRun,
    context: &Context,
) -> anyhow::Result<OdometryResult> {
    let recording = Recording::open(path)?;
    for scan in recording.scans_of(MAIN_LIDAR)? {
        context.show(Progress {
            stage: "lidar odometry",
            done: run.taken(),
            total: 0,
        })?;
        let times = PointTimes::Field {
            name: "t".to_owned(),
            begins: TimesBegin::AfterStamp { nanos: 0 },
        };
        run.push(TimedScan { scan: scan?, times })?;
    }
    Ok(run.finish()?)
}

/// Why no more packets are read from a bag.
enum Ended {
    Bag(lsfb_datasets::Error),
    /// Nobody takes them any more.
    Unwanted,
}

impl From<lsfb_datasets::Error> for Ended {
    fn from(error: lsfb_datasets::Error) -> Self {
        Self::Bag(error)
    }
}

/// Decodes the packets of a bag. They are read on a thread of their own, as a bag gives and a decoder takes.
fn decode_bag(
    topic: &str,
    out: &Path,
    choice: &Choice,
    context: &Context,
) -> anyhow::Result<(CaptureReport, Unread)> {
    let (send, waiting) = sync_channel(WAITING_MESSAGES);
    let read = move || {
        let bag = RosBag::open(choice.path)?;
        bag.packets(topic, &mut |packets| {
            send.send(packets).map_err(|_| Ended::Unwanted)
        })
    };
    std::thread::scope(|scope| {
        let reader = std::thread::Builder::new().name("bag-packets".to_owned());
        let reader = reader.spawn_scoped(scope, read);
        let reader = reader.context("cannot start the thread that reads the bag")?;
        let source = BagPackets {
            waiting,
            packets: VecDeque::new(),
        };
        let decoded = decode(source, out, choice, context)?;
        match reader.join() {
            Ok(Ok(unread)) => Ok((decoded, unread)),
            Ok(Err(Ended::Unwanted)) => Ok((decoded, Unread::default())),
            Ok(Err(Ended::Bag(error))) => Err(error.into()),
            Err(_) => bail!("{}: the thread that reads it failed", choice.path.display()),
        }
    })
}

/// Packets that another thread reads.
struct BagPackets {
    waiting: Receiver<Vec<Packet>>,
    packets: VecDeque<Packet>,
}

impl PacketSource for BagPackets {
    fn recv(&mut self, _timeout: Duration) -> Result<Option<Packet>, lsfb_drivers::Error> {
        while self.packets.is_empty() {
            match self.waiting.recv() {
                Ok(packets) => self.packets.extend(packets),
                Err(_) => {
                    return Err(lsfb_drivers::Error::EndOfStream {
                        device: "bag".to_owned(),
                    });
                }
            }
        }
        Ok(self.packets.pop_front())
    }
}

/// Makes scans of packets.
fn decode(
    source: impl PacketSource,
    out: &Path,
    choice: &Choice,
    context: &Context,
) -> anyhow::Result<CaptureReport> {
    let config = ReplayConfig {
        lidar: Settings {
            model: choice.model,
            ..Settings::default()
        },
        ..ReplayConfig::default()
    };
    let report = replay(source, &config, out, &|p| context.show(p))?;
    if report.streams.iter().all(|stream| stream.decoded == 0) {
        let bad = report.streams.iter().find_map(|s| s.first_bad.as_deref());
        let why = bad.unwrap_or("no packet of a LiDAR is in it");
        bail!("{}: no scan was made of it: {why}", choice.path.display());
    }
    Ok(report)
}

/// What is missing from a bag that ends early or is torn: data is lost then.
fn about_damage(bag: &RosBag, context: &Context) -> Vec<String> {
    let damage = bag.damage();
    if !damage.is_empty() {
        context.lose_data();
    }
    damage
}

/// What the odometry's reader should know of messages that could not be read: data is lost then.
fn about_unread(unread: &Unread, context: &Context) -> Option<String> {
    let first = unread.first.as_ref()?;
    context.lose_data();
    Some(format!(
        "{} messages could not be read and are left out; the first: {first}",
        unread.count
    ))
}

/// What the odometry's reader should know of packets: where any are missing or cannot be read, data is lost.
fn about_packets(report: &CaptureReport, context: &Context) -> Vec<String> {
    let mut said = Vec::new();
    if report.lost > 0 {
        context.lose_data();
        let bad = report.streams.iter().find_map(|s| s.first_bad.as_ref());
        let bad = bad.map_or(String::new(), |bad| {
            format!("; the first of the latter: {bad}")
        });
        said.push(format!(
            "{} packets are missing or cannot be read{bad}",
            report.lost
        ));
        let endings = report.streams.iter().filter_map(|s| match &s.ending {
            Ending::Lost(why) => Some(why.clone()),
            Ending::Stopped | Ending::EndOfStream => None,
        });
        said.extend(endings);
    }
    if report.streams.len() > 1 {
        let names: Vec<&str> = report.streams.iter().map(|s| s.name.as_str()).collect();
        said.push(format!(
            "there are packets of several LiDARs ({}): the scans of {MAIN_LIDAR} are used",
            names.join(", ")
        ));
    }
    said.extend(report.streams.iter().flat_map(|s| s.notes.iter().cloned()));
    said
}

/// A folder for scans between decoder and odometry, away from the result; gone with this.
struct Scratch {
    folder: PathBuf,
    scans: PathBuf,
}

impl Scratch {
    fn new() -> anyhow::Result<Self> {
        let folder = std::env::temp_dir().join(format!("lsfb-odometry-{}", std::process::id()));
        std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        Ok(Self {
            scans: folder.join("scans.mcap"),
            folder,
        })
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // What stays behind in the system's folder for such files is the system's to clear.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}
