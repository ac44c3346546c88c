//! `lsfb sim`: simulated devices to record from.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use lsfb_capture::{DevicesConfig, LidarNetConfig, Overflow};
use lsfb_sim::{GlassesEndpoint, Pace, SimConfig, SimSession};
use serde::Serialize;

use crate::context::Context;
use crate::outcome::Outcome;
use crate::simulated::{self, Endpoints, Layout};

/// How long the glasses look for their recorder.
const PATIENCE: Duration = Duration::from_secs(3600);

/// Simulate a building, a backpack and glasses; play the devices, or record them at once.
///
/// Writes rigs, settings, and the truth (in a folder of its own, for `lsfb eval`). Without --record the devices wait for
/// `lsfb scan` in another terminal: first the backpack, then the glasses.
///
/// Examples:
///   lsfb sim --out sim --seed 7 --record
///   lsfb sim --out sim --pace 1        # then, in another terminal:
///   lsfb scan --devices sim/backpack-devices.toml --out scan.mcap
///   lsfb scan --devices sim/glasses-devices.toml --out walk.mcap
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder for everything.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Seed of building, walks and noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Settings of the simulation (TOML), instead of the defaults; --seed overrides its seed.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Record scan.mcap and walk.mcap in this process.
    #[arg(long)]
    record: bool,
    /// Simulated seconds per second at most; 0 is as fast as it goes.
    #[arg(long, default_value_t = 1.0, conflicts_with = "record")]
    pace: f64,
    #[command(flatten)]
    endpoints: Endpoints,
}

impl Arguments {
    /// Devices that wait for `lsfb scan`.
    pub fn playing(out: &Path, seed: u64, pace: f64, endpoints: Endpoints) -> Self {
        Self {
            out: out.to_owned(),
            seed,
            config: None,
            record: false,
            pace,
            endpoints,
        }
    }
}

#[derive(Serialize)]
struct Made {
    folder: PathBuf,
    seed: u64,
    recordings: Vec<lsfb_capture::CaptureReport>,
}

/// Builds the world, plays or records.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let mut config: SimConfig = super::config_or_default(arguments.config.as_deref())?;
    config.seed = arguments.seed;
    let layout = Layout::create(&arguments.out)?;
    let simulation = simulated::prepare(&layout, &config, context)?;
    let mut recordings = Vec::new();
    if arguments.record {
        recordings.push(simulated::record_backpack(&layout, &simulation, context)?);
        recordings.push(simulated::record_glasses(&layout, &simulation, context)?);
    } else {
        let pace = if arguments.pace > 0.0 {
            Pace::RealTimes(arguments.pace)
        } else {
            Pace::Unlimited
        };
        let lidar = LidarNetConfig {
            data: arguments.endpoints.lidar_data,
            position: arguments.endpoints.lidar_position,
            ..LidarNetConfig::default()
        };
        let glasses = arguments.endpoints.sidecar;
        let backpack_file = layout.file("backpack-devices.toml");
        let glasses_file = layout.file("glasses-devices.toml");
        let write = |path: &PathBuf, devices: DevicesConfig| {
            std::fs::write(path, devices.to_toml()).with_context(|| path.display().to_string())
        };
        // The list of devices lies beside what it names.
        let absolute = Layout::create(&std::path::absolute(&arguments.out)?)?;
        write(
            &backpack_file,
            simulated::backpack_devices(&absolute, &config, lidar.clone(), Overflow::Drop),
        )?;
        write(
            &glasses_file,
            simulated::glasses_devices(glasses, Overflow::Drop),
        )?;

        let devices = simulated::start_backpack(&layout, &simulation, lidar, pace, None)?;
        context.note(&format!(
            "waiting for: lsfb scan --devices {} --out scan.mcap",
            backpack_file.display()
        ));
        play(devices, context)?;
        context.note(&format!(
            "waiting for: lsfb scan --devices {} --out walk.mcap",
            glasses_file.display()
        ));
        let endpoint = GlassesEndpoint {
            address: glasses,
            session: format!("seed-{}", config.seed),
        };
        let waiting_since = Instant::now();
        let devices = loop {
            match SimSession::start_glasses(&simulation, &endpoint, pace) {
                Ok(devices) => break devices,
                Err(error) if waiting_since.elapsed() > PATIENCE => return Err(error.into()),
                Err(_) => std::thread::sleep(Duration::from_millis(200)),
            }
            context.check_stop()?;
        };
        play(devices, context)?;
    }
    let lost = recordings.iter().any(|r| r.lost > 0);
    let made = Made {
        folder: arguments.out.clone(),
        seed: config.seed,
        recordings,
    };
    context.print(&made, || {
        let mut text = format!(
            "{}: rigs, truth and settings of seed {}",
            made.folder.display(),
            made.seed
        );
        for report in &made.recordings {
            let _ = write!(text, "\n{}", super::scan::text(report));
        }
        text
    })?;
    Ok(if lost {
        Outcome::DataLost
    } else {
        Outcome::Done
    })
}

/// Plays to the end, or until Ctrl-C.
fn play(devices: SimSession, context: &Context) -> anyhow::Result<()> {
    let stop = devices.stop_handle();
    devices.join(&|p| {
        if context.check_stop().is_err() {
            stop.stop();
        }
        context.show(p);
    })?;
    context.check_stop()
}
