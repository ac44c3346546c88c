//! `lsfb scan`: devices or capture files → Recording.

use std::fmt::Write as _;
use std::io::Read as _;
use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, bail};
use lsfb_capture::{
    CaptureReport, DevicesConfig, PairingFolder, PhonesListener, RecorderConfig, ReplayConfig,
    ReplayedSensor, replay, replay_recording,
};
use lsfb_drivers::any_lidar::{self, Model, Settings};
use lsfb_drivers::lidar::{BeamAngles, Returns, ScanSettings};
use lsfb_drivers::transport::pcap::PcapSource;
use lsfb_drivers::transport::rosbag2::Rosbag2Source;
use lsfb_geometry::{MAIN_LIDAR, Rig};
use lsfb_operator::{ScreenConfig, SecureScreen};
use lsfb_recording::Existing;
use lsfb_types::{Finding, Verdict};

use crate::context::{Context, sentence};
use crate::live::{Live, LiveConfig, LiveOdometryReport, Odometry, Recorded};
use crate::one_of::one_of;
use crate::outcome::Outcome;
use crate::refused::Refused;

/// Where the rig's certificate is, beside a list of devices without a `[sidecar]`.
const SIDECAR_FOLDER: &str = "sidecar";

/// Record devices, or the packets of a capture file, into one MCAP file.
///
/// Ctrl-C ends the recording and closes the file. Exit code 3: recorded, but data was lost.
///
/// --screen serves a page for the operator's phone or tablet: live map, state of every sensor, disk and
/// battery, start and stop, notes and control points (which are recorded). Recordings are started and
/// stopped there; each gets its own file (scan.mcap, scan-2.mcap, …), no file is overwritten, and
/// Ctrl-C ends the program. The page needs no internet and by default opens on this machine only. At an
/// address that other machines can reach (0.0.0.0:8700), or the phones' address (`[sidecar]`), it uses
/// TLS at /operator/ and asks for a PIN, printed at the start with a QR code of the link. Your browser
/// will warn about the rig's self-signed certificate; continue anyway.
///
/// Examples:
///   lsfb scan --devices devices.toml --out scan.mcap
///   lsfb scan --devices devices.toml --out scan.mcap --split-secs 300 --out-second-disk /media/spare
///   lsfb scan --devices devices.toml --out scan.mcap --screen 0.0.0.0:8700
///   lsfb scan --devices devices.toml --out scan.mcap --foxglove --rerun
///   lsfb scan --pcap drive.pcap --out drive.mcap
///   lsfb scan --pcap drive.pcap --lidar-sender front=192.168.1.201 --lidar-sender rear=192.168.1.202 --out drive.mcap
///   lsfb scan --db3 rosbag2_0.db3 --out bag.mcap
///   lsfb scan --mcap rosbag2_0.mcap --out bag.mcap
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// List of devices (see docs/devices.md); `lsfb sim` and `lsfb mock` write one for their devices.
    #[arg(long, value_name = "TOML", group = "source", required_unless_present_any = ["pcap", "db3", "mcap"])]
    devices: Option<PathBuf>,
    /// LiDAR packets of a pcap or pcapng capture.
    #[arg(long, value_name = "PCAP", group = "source")]
    pcap: Option<PathBuf>,
    /// LiDAR packets of a rosbag2 database, as recorded by the ROS driver of one of the LiDARs of --lidar-model.
    #[arg(long, value_name = "DB3", group = "source")]
    db3: Option<PathBuf>,
    /// LiDAR packets of an MCAP file, from rosbag2 or from `lsfb scan`: scans are decoded again.
    #[arg(long, value_name = "MCAP", group = "source")]
    mcap: Option<PathBuf>,
    /// The LiDAR of a capture file; see `lsfb scan --help` for the models.
    #[command(flatten)]
    lidar: LidarArguments,
    /// Rig to attach to the recording of a capture file.
    #[arg(long, value_name = "TOML", conflicts_with = "devices")]
    rig: Option<PathBuf>,
    /// Recording to write.
    #[arg(long, value_name = "MCAP")]
    out: PathBuf,
    /// Start a new file after this many megabytes; each file can be read on its own.
    #[arg(long, value_name = "MB")]
    split_mb: Option<u64>,
    /// Start a new file after this many seconds.
    #[arg(long, value_name = "SECS")]
    split_secs: Option<f64>,
    /// Folder on another disk, used when the first disk is nearly full.
    #[arg(long, value_name = "FOLDER")]
    out_second_disk: Option<PathBuf>,
    /// Serve the operator's screen; on this machine only, unless ADDR or the phones' address (`[sidecar]`)
    /// makes it reachable from others.
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = "127.0.0.1:8700", conflicts_with_all = ["pcap", "db3", "mcap"])]
    screen: Option<SocketAddr>,
    /// PIN of the screen, at least four characters; random by default; only other machines need it.
    #[arg(long, value_name = "PIN", requires = "screen", value_parser = pin)]
    pin: Option<String>,
    /// Another name of this machine (for example a DNS name) at which the screen may be opened, besides its
    /// host name and addresses; may be repeated.
    #[arg(long, value_name = "NAME", requires = "screen")]
    screen_name: Vec<String>,
    /// Start the first recording at once, without waiting for START on the screen.
    #[arg(long, requires = "screen")]
    now: bool,
    /// Stream live data to Foxglove, which connects to ADDR.
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = "127.0.0.1:8765", conflicts_with_all = ["pcap", "db3", "mcap"])]
    foxglove: Option<SocketAddr>,
    /// Run odometry while recording, and record the rig's poses (/tf), even without a live map; always on
    /// with --screen, --foxglove or --rerun. Needs a rig with the LiDAR.
    #[arg(long, requires = "devices")]
    odometry: bool,
    /// Folder with the battery state, if it is not /sys/class/power_supply.
    #[arg(long, value_name = "FOLDER")]
    power_supplies: Option<PathBuf>,
    /// Stream live data to the Rerun viewer at URL.
    #[cfg(feature = "view")]
    #[arg(long, value_name = "URL", num_args = 0..=1, default_missing_value = "rerun+http://127.0.0.1:9876/proxy", conflicts_with_all = ["pcap", "db3", "mcap"])]
    rerun: Option<String>,
}

/// How the LiDAR packets of a capture file are read; for devices their list says it.
#[derive(clap::Args)]
struct LidarArguments {
    #[arg(long, value_name = "MODEL", help = lidar_model_help(), conflicts_with = "devices", value_parser = lidar_model)]
    lidar_model: Option<Model>,
    /// Ignore the model and return mode stated in the packets; use --lidar-model and this mode.
    #[arg(long, value_name = "MODE", requires = "lidar_model", value_parser = one_of(&Returns::ALL, Returns::key))]
    force_returns: Option<Returns>,
    /// Beam angles of this unit (CSV), for sensors that come with a file of them.
    #[arg(long, value_name = "CSV", conflicts_with = "devices")]
    lidar_angles: Option<PathBuf>,
    /// Record only the packets of this sender, under this name; may be repeated. By default every LiDAR of
    /// a pcap capture is recorded, as lidar, lidar2, … in order of appearance.
    #[arg(long, value_name = "[NAME=]IP", requires = "pcap", value_parser = lidar_sender)]
    lidar_sender: Vec<Sender>,
    /// UDP ports of the LiDAR in a pcap capture, separated by commas or once for each.
    #[arg(long = "lidar-port", alias = "lidar-ports", value_name = "PORT", value_delimiter = ',', default_values_t = any_lidar::factory_ports(), requires = "pcap")]
    lidar_ports: Vec<u16>,
}

/// A LiDAR of a capture file.
#[derive(Clone)]
struct Sender {
    name: Option<String>,
    address: IpAddr,
}

fn lidar_sender(text: &str) -> Result<Sender, String> {
    let (name, address) = match text.split_once('=') {
        Some((name, address)) => (Some(name.to_owned()), address),
        None => (None, text),
    };
    let refused = |_| {
        format!(
            "expected an address such as 192.168.1.201, or a name and an address such as rear=192.168.1.201, not {text:?}"
        )
    };
    let address = address.parse().map_err(refused)?;
    Ok(Sender { name, address })
}

/// A sensor by its name on the command line.
pub fn lidar_model(name: &str) -> Result<Model, String> {
    Model::from_key(name).ok_or_else(|| format!("expected one of {}", Model::keys()))
}

/// What `--lidar-model` takes.
fn lidar_model_help() -> String {
    format!("Expected LiDAR of a capture file, one of {}", Model::keys())
}

impl LidarArguments {
    /// Those that were chosen, if any.
    fn sensors(&self) -> Vec<ReplayedSensor> {
        let named = |(index, sender): (usize, &Sender)| ReplayedSensor {
            name: match (&sender.name, index) {
                (Some(name), _) => name.clone(),
                (None, 0) => MAIN_LIDAR.to_owned(),
                (None, _) => format!("{MAIN_LIDAR}{}", index + 1),
            },
            address: sender.address,
        };
        self.lidar_sender.iter().enumerate().map(named).collect()
    }

    fn settings(&self) -> anyhow::Result<Settings> {
        let angles = match &self.lidar_angles {
            Some(path) => {
                let name = || path.display().to_string();
                let text = std::fs::read_to_string(path).with_context(name)?;
                Some(BeamAngles::parse_csv(&text).with_context(name)?)
            }
            None => None,
        };
        Ok(Settings {
            model: self.lidar_model,
            scans: ScanSettings {
                force_returns: self.force_returns,
                angles,
                ..ScanSettings::default()
            },
        })
    }
}

impl Arguments {
    /// What the command line says about files goes before what the list of devices says.
    fn apply(&self, recorder: &mut RecorderConfig, context: &Context) {
        if context.force() {
            recorder.existing = Existing::Replace;
        }
        if let Some(megabytes) = self.split_mb {
            recorder.split_bytes = megabytes.saturating_mul(1_000_000);
        }
        if let Some(secs) = self.split_secs {
            recorder.split_secs = secs;
        }
        if let Some(folder) = &self.out_second_disk {
            recorder.second_folder = Some(folder.clone());
        }
    }
}

fn pin(text: &str) -> Result<String, String> {
    if text.chars().count() >= 4 {
        Ok(text.to_owned())
    } else {
        Err("expected at least four characters".to_owned())
    }
}

/// Records, prints the report.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    for (path, remedy) in [
        (&arguments.devices, "`lsfb sim` writes an example"),
        (&arguments.pcap, "give a capture file"),
        (&arguments.db3, "give a rosbag2 database"),
        (&arguments.mcap, "give an MCAP file"),
        (&arguments.rig, "leave out --rig"),
    ] {
        if let Some(path) = path {
            super::expect_file(path, remedy)?;
        }
    }
    if let Some(devices) = &arguments.devices {
        let mut devices = DevicesConfig::read(devices)?;
        arguments.apply(&mut devices.recorder, context);
        let live = Live::start(&arguments.live(&devices)?, &arguments.out)?;
        live.say_where(context);
        if arguments.screen.is_some() {
            return record_on_demand(arguments, &devices, &live, context);
        }
        let recorded = live.record(&devices, &arguments.out, context)?;
        context.print_ended(&recorded, || text_of_live(&recorded))?;
        return Ok(outcome([&recorded.capture]));
    }
    let show = |p| context.show(p);
    let rig = arguments.rig.as_deref().map(Rig::read).transpose()?;
    let mut config = ReplayConfig {
        rig,
        lidar: arguments.lidar.settings()?,
        sensors: arguments.lidar.sensors(),
        ..ReplayConfig::default()
    };
    arguments.apply(&mut config.recorder, context);
    context.will_write(&arguments.out);
    let out: &Path = &arguments.out;
    let mut beside = String::new();
    let report = match (&arguments.pcap, &arguments.db3, &arguments.mcap) {
        (Some(pcap), _, _) => {
            let mut source = PcapSource::open(pcap, &arguments.lidar.lidar_ports)?;
            let report = replay(&mut source, &config, out, &show)?;
            beside = source.survey().describe(any_lidar::whose);
            report
        }
        (_, Some(db3), _) => replay(Rosbag2Source::open(db3)?, &config, out, &show)?,
        (_, _, Some(mcap)) => replay_recording(mcap, &config, out, &show)?,
        _ => bail!("give a source: --devices, --pcap, --db3 or --mcap"),
    };
    if report.streams.iter().all(|stream| stream.decoded == 0) {
        let mut why = nothing(&report, &beside);
        if report.streams.iter().all(|stream| stream.received == 0) {
            std::fs::remove_file(&report.path)
                .with_context(|| report.path.display().to_string())?;
        } else {
            let _ = write!(why, "; the packets are in {}", report.path.display());
        }
        let captures = [&arguments.pcap, &arguments.db3, &arguments.mcap];
        let subject = captures.into_iter().flatten().next();
        let subject = subject.map_or_else(String::new, |path| path.display().to_string());
        let none = Finding::new("no-scans", Verdict::Fail, subject, why).remedy(
            match arguments.pcap.is_some() {
                true => "check --lidar-port, --lidar-model and which sensor was captured",
                false => "check --lidar-model and which sensor was captured",
            },
        );
        return Err(Refused(none).into());
    }
    print(&report, context)
}

/// Why no scan was made of a capture file, in one sentence.
fn nothing(report: &CaptureReport, beside: &str) -> String {
    let received: u64 = report.streams.iter().map(|s| s.received).sum();
    let bad = report.streams.iter().find_map(|s| s.first_bad.as_deref());
    let mut why = match (received, bad) {
        (0, _) => "no scan: it has no LiDAR datagrams".to_owned(),
        (_, Some(bad)) => format!("no scan could be assembled from {received} datagrams: {bad}"),
        (_, None) => format!("no scan could be assembled from {received} datagrams"),
    };
    if !beside.is_empty() {
        let _ = write!(why, "; also found: {beside}");
    }
    why
}

impl Arguments {
    fn live(&self, devices: &DevicesConfig) -> anyhow::Result<LiveConfig> {
        let (screen, phones) = match self.screen {
            Some(address) => {
                let (screen, phones) = self.open_screen(address, devices)?;
                (Some(screen), phones)
            }
            None => (None, None),
        };
        Ok(LiveConfig {
            screen,
            phones,
            foxglove: self.foxglove,
            odometry: match self.odometry {
                true => Odometry::Always,
                false => Odometry::WhereShown,
            },
            power_supplies: self.power_supplies.clone().unwrap_or_default(),
            #[cfg(feature = "view")]
            rerun: self.rerun.clone(),
        })
    }

    /// Where the screen is served: on this machine as it is, to others by TLS, and where phones have an address there.
    fn open_screen(
        &self,
        address: SocketAddr,
        devices: &DevicesConfig,
    ) -> anyhow::Result<(ScreenConfig, Option<PhonesListener>)> {
        let is_local = address.ip().is_loopback();
        let mut listeners = Vec::new();
        let mut phones = None;
        if let Some(sidecar) = &devices.sidecar {
            let folder = PairingFolder::open(&sidecar.folder)?;
            let open = PhonesListener::start(sidecar.listen, &folder)?;
            listeners.push(Arc::clone(open.listener()));
            phones = Some(open);
        }
        if !is_local && devices.sidecar.as_ref().map(|s| s.listen) != Some(address) {
            let folder = match &devices.sidecar {
                Some(sidecar) => sidecar.folder.clone(),
                // As a list of devices has it where it says nothing.
                None => self.beside_devices(SIDECAR_FOLDER),
            };
            let own = PhonesListener::start(address, &PairingFolder::open(&folder)?)?;
            listeners.push(Arc::clone(own.listener()));
        }
        let secure = match listeners.is_empty() {
            true => None,
            false => Some(SecureScreen {
                listeners,
                pin: self.pin.clone().map_or_else(random_pin, Ok)?,
            }),
        };
        let config = ScreenConfig {
            address: is_local.then_some(address),
            pin: self.pin.clone(),
            secure,
            names: self.screen_name.clone(),
        };
        Ok((config, phones))
    }

    fn beside_devices(&self, name: &str) -> PathBuf {
        let folder = self.devices.as_deref().and_then(Path::parent);
        folder.unwrap_or(Path::new("")).join(name)
    }
}

/// Six digits.
fn random_pin() -> anyhow::Result<String> {
    let mut bytes = [0; 8];
    std::fs::File::open("/dev/urandom")
        .and_then(|mut source| source.read_exact(&mut bytes))
        .context("cannot generate a random PIN; choose one with --pin")?;
    Ok(format!("{:06}", u64::from_le_bytes(bytes) % 1_000_000))
}

/// One recording after another, as the operator likes.
fn record_on_demand(
    arguments: &Arguments,
    devices: &DevicesConfig,
    live: &Live,
    context: &Context,
) -> anyhow::Result<Outcome> {
    let mut reports: Vec<Recorded> = Vec::new();
    let mut failures = 0;
    let mut begin = arguments.now;
    while begin || live.wait_for_start(context) {
        begin = false;
        let out = unused(&arguments.out);
        match live.record(devices, &out, context) {
            Ok(recorded) => {
                context.note(&text_of_live(&recorded));
                reports.push(recorded);
            }
            // The operator mends it and presses START again.
            Err(error) => {
                failures += 1;
                context.say(&format!("{}: {}", out.display(), sentence(&error)));
            }
        }
    }
    context.print_ended(&reports, || match reports.len() {
        0 => "nothing was recorded".to_owned(),
        n => format!("{n} recordings"),
    })?;
    anyhow::ensure!(
        failures == 0 || !reports.is_empty(),
        "no recording could be made; see above"
    );
    Ok(outcome(reports.iter().map(|recorded| &recorded.capture)))
}

/// The name itself where it is free, else with the first free number.
fn unused(out: &Path) -> PathBuf {
    let numbered = |n: u32| {
        let stem = out.file_stem().unwrap_or_default().to_string_lossy();
        let ending = out.extension().unwrap_or_default().to_string_lossy();
        out.with_file_name(format!("{stem}-{n}.{ending}"))
    };
    let names = std::iter::once(out.to_owned()).chain((2..).map(numbered));
    let mut free = names.filter(|name| !name.exists());
    free.next().unwrap_or_else(|| out.to_owned())
}

fn print(report: &CaptureReport, context: &Context) -> anyhow::Result<Outcome> {
    context.print(report, || text(report))?;
    Ok(outcome([report]))
}

fn outcome<'a>(reports: impl IntoIterator<Item = &'a CaptureReport>) -> Outcome {
    if reports.into_iter().all(|report| report.lost == 0) {
        Outcome::Done
    } else {
        Outcome::DataLost
    }
}

/// The report of a recording of devices, for people.
fn text_of_live(recorded: &Recorded) -> String {
    let mut out = text(&recorded.capture);
    if let Some(odometry) = &recorded.live_odometry {
        let _ = write!(out, "\n  live map     {}", about_odometry(odometry));
    }
    out
}

fn about_odometry(odometry: &LiveOdometryReport) -> String {
    let mut out = format!(
        "{} scans registered, {} lost; poses after {:.0} ms (median), {:.0} ms (99 %)",
        odometry.registered, odometry.lost, odometry.latency_p50_ms, odometry.latency_p99_ms
    );
    if let Some(loops) = odometry.loops.filter(|loops| *loops > 0) {
        let _ = write!(out, "; {loops} loops");
    }
    if let Some(scans) = odometry.unsearched_scans.filter(|scans| *scans > 0) {
        let _ = write!(out, "; loops not looked for at {scans} scans");
    }
    for (count, what) in [
        (odometry.skipped_scans, "scans"),
        (odometry.skipped_imu_samples, "IMU samples"),
    ] {
        if count > 0 {
            let _ = write!(out, "; {count} {what} skipped because it was behind");
        }
    }
    if odometry.missed_by_tap > 0 {
        let missed = odometry.missed_by_tap;
        let _ = write!(
            out,
            "; {missed} messages not shown, because the live view was behind"
        );
    }
    out
}

/// The report for people.
pub fn text(report: &CaptureReport) -> String {
    let mut out = format!(
        "{}: {:.1} MB, {} messages, {} lost\n",
        report.path.display(),
        report.bytes as f64 / 1e6,
        report.messages,
        report.lost
    );
    for s in &report.streams {
        let _ = write!(
            out,
            "  {:<12} {} received, {} samples",
            s.name, s.received, s.decoded
        );
        for (count, what) in [
            (s.bad, "unreadable"),
            (s.missing, "missing"),
            (s.reordered, "too late for their scan"),
            (s.kept_out, "from another LiDAR, rejected"),
            (s.duplicated, "repeated"),
            (s.dropped, "dropped because the disk could not keep up"),
            (s.interruptions, "disconnections"),
            (s.silences, "times silent"),
            (s.slowdowns, "stretches with a much too low rate"),
            (s.stale, "stretches of repeated data"),
        ] {
            if count > 0 {
                let _ = write!(out, ", {count} {what}");
            }
        }
        if let lsfb_capture::Ending::Lost(why) = &s.ending {
            let _ = write!(out, "; LOST: {why}");
        }
        out.push('\n');
        for line in s.first_bad.iter().chain(&s.notes) {
            let _ = writeln!(out, "               {line}");
        }
    }
    if let Some(why) = &report.failure {
        let _ = writeln!(out, "  STOPPED      {why}");
    }
    for warning in &report.warnings {
        let _ = writeln!(out, "  WARNING      {warning}");
    }
    for part in report.parts.iter().filter(|part| **part != report.path) {
        let _ = writeln!(out, "  continued in {}", part.display());
    }
    if report.groups.complete + report.groups.incomplete > 0 {
        let _ = write!(
            out,
            "  triggers     {} complete, {} incomplete",
            report.groups.complete, report.groups.incomplete
        );
    }
    out.trim_end().to_owned()
}
