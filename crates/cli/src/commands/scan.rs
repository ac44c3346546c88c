//! `lsfb scan`: devices or capture files → Recording.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::bail;
use lsfb_capture::{CaptureReport, DevicesConfig, RecorderConfig, ReplayConfig, Session, replay};
use lsfb_drivers::transport::pcap::PcapSource;
use lsfb_drivers::transport::rosbag2::Rosbag2Source;
use lsfb_geometry::Rig;
use lsfb_recording::Existing;

use crate::context::Context;
use crate::outcome::Outcome;

/// Record devices, or the packets of a capture file, into one MCAP.
///
/// Ctrl-C ends the recording and closes the file. Exit code 3: recorded, but something was lost.
///
/// Examples:
///   lsfb scan --devices devices.toml --out scan.mcap
///   lsfb scan --devices devices.toml --out scan.mcap --split-secs 300 --second-disk /media/spare
///   lsfb scan --pcap drive.pcap --out drive.mcap
///   lsfb scan --db3 rosbag2_0.db3 --out bag.mcap
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// List of devices (TOML); `lsfb sim` writes one for its simulated devices.
    #[arg(long, value_name = "FILE", group = "source", required_unless_present_any = ["pcap", "db3"])]
    devices: Option<PathBuf>,
    /// Velodyne packets of a pcap or pcapng capture.
    #[arg(long, value_name = "FILE", group = "source")]
    pcap: Option<PathBuf>,
    /// Velodyne packets of a rosbag2 database.
    #[arg(long, value_name = "FILE", group = "source")]
    db3: Option<PathBuf>,
    /// Rig attached to what comes from a capture file.
    #[arg(long, value_name = "FILE", conflicts_with = "devices")]
    rig: Option<PathBuf>,
    /// The recording. A file that is there already is not replaced.
    #[arg(long, value_name = "MCAP")]
    out: PathBuf,
    /// Replace a recording of the same name.
    #[arg(long)]
    force: bool,
    /// Begin a new file after this many megabytes; each opens by itself.
    #[arg(long, value_name = "MB")]
    split_mb: Option<u64>,
    /// Begin a new file after this many seconds.
    #[arg(long, value_name = "S")]
    split_secs: Option<f64>,
    /// Folder on another disk, to go on with when the first is nearly full.
    #[arg(long, value_name = "FOLDER")]
    second_disk: Option<PathBuf>,
}

impl Arguments {
    /// What the command line says about files goes before what the list of devices says.
    fn apply(&self, recorder: &mut RecorderConfig) {
        if self.force {
            recorder.existing = Existing::Replace;
        }
        if let Some(megabytes) = self.split_mb {
            recorder.split_bytes = megabytes.saturating_mul(1_000_000);
        }
        if let Some(secs) = self.split_secs {
            recorder.split_secs = secs;
        }
        if let Some(folder) = &self.second_disk {
            recorder.second_folder = Some(folder.clone());
        }
    }
}

/// Records, prints the report.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let show = |p| context.show(p);
    for (path, remedy) in [
        (&arguments.devices, "let `lsfb sim` write an example"),
        (&arguments.pcap, "name a capture file"),
        (&arguments.db3, "name a rosbag2 database"),
        (&arguments.rig, "leave --rig out"),
    ] {
        if let Some(path) = path {
            super::expect_file(path, remedy)?;
        }
    }
    let report = if let Some(devices) = &arguments.devices {
        let mut config = DevicesConfig::read(devices)?;
        arguments.apply(&mut config.recorder);
        let session = Session::open(&config)?;
        session.run(&arguments.out, context.stop(), &show)?
    } else {
        let rig = arguments.rig.as_deref().map(Rig::read).transpose()?;
        let mut config = ReplayConfig {
            rig,
            ..ReplayConfig::default()
        };
        arguments.apply(&mut config.recorder);
        let out: &Path = &arguments.out;
        match (&arguments.pcap, &arguments.db3) {
            (Some(pcap), _) => replay(
                PcapSource::open(pcap, &[2368, 8308])?,
                &config,
                out,
                context.stop(),
                &show,
            )?,
            (_, Some(db3)) => replay(
                Rosbag2Source::open(db3)?,
                &config,
                out,
                context.stop(),
                &show,
            )?,
            _ => bail!("name a source: --devices, --pcap or --db3"),
        }
    };
    context.print(&report, || text(&report))?;
    Ok(if report.lost == 0 {
        Outcome::Done
    } else {
        Outcome::DataLost
    })
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
            (s.duplicated, "repeated"),
            (s.dropped, "dropped because the disk could not keep up"),
            (s.interruptions, "times gone and back"),
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
    for part in report.parts.iter().skip(1) {
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
