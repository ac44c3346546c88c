//! `lsfb calib imu-noise`: a recording at rest → noise of the IMU.

use std::path::PathBuf;

use lsfb_calib::exchange::imu_to_kalibr;
use lsfb_calib::imu_noise::{ImuNoise, ImuNoiseConfig, imu_noise};
use lsfb_geometry::Rig;
use lsfb_recording::Provenance;
use lsfb_types::Verdict;

use super::calib_input::{Source, add_input, imu_of};
use super::calib_result::Results;
use super::write;
use crate::context::Context;
use crate::judged::{self, Judged};
use crate::outcome::Outcome;
use crate::pages;

/// Measure the IMU's noise (Allan variance) from a recording at rest.
///
/// Two hours of recording are enough for all parameters.
///
/// Examples:
///   lsfb calib imu-noise --recording night.mcap --out noise.html
///   lsfb calib imu-noise --imu imu0/data.csv --out noise.html --out-kalibr imu.yaml --rig rig.toml --out-rig rig.toml
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Recording with the IMU; or a ROS bag (.bag, .mcap, .db3, or a rosbag2 folder).
    #[arg(long, value_name = "MCAP", required_unless_present = "imu")]
    recording: Option<PathBuf>,
    /// IMU table (EuRoC: ns, rad/s, m/s²) instead of the recording's IMU; or its topic in a bag.
    #[arg(long, value_name = "CSV|TOPIC")]
    imu: Option<PathBuf>,
    /// The page with figures and plots to write.
    #[arg(long, value_name = "HTML")]
    out: PathBuf,
    /// Also write Kalibr's imu.yaml.
    #[arg(long, value_name = "YAML")]
    out_kalibr: Option<PathBuf>,
    /// Topic to name in Kalibr's file.
    #[arg(long, value_name = "TOPIC", default_value = "/imu")]
    topic: String,
    /// Rig to put the noise into; the rest of it is kept.
    #[arg(long, value_name = "TOML", requires = "out_rig")]
    rig: Option<PathBuf>,
    /// The rig with the noise to write; may be the one given with --rig.
    #[arg(long, value_name = "TOML", requires = "rig")]
    out_rig: Option<PathBuf>,
    /// Settings instead of the defaults.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

/// Reads the noise, writes the files, prints the report.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let config: ImuNoiseConfig = match &arguments.config {
        Some(path) => super::read_config(path)?,
        None => ImuNoiseConfig::default(),
    };
    let results = Results {
        out: &arguments.out,
        transforms: &[],
        others: &[
            arguments.out_kalibr.as_deref(),
            arguments.out_rig.as_deref(),
        ],
        rig: arguments.rig.as_deref(),
        read: [&arguments.recording, &arguments.imu]
            .into_iter()
            .flatten()
            .map(PathBuf::as_path)
            .collect(),
    };
    results.claim(context)?;
    let rig = match (&arguments.rig, &arguments.out_rig) {
        (Some(before), Some(after)) => Some((Rig::read(before)?, after)),
        _ => None,
    };
    let mut provenance = Provenance::new(&config);
    for path in [&arguments.recording, &arguments.imu].into_iter().flatten() {
        if path.exists() {
            add_input(&mut provenance, path)?;
        }
    }
    let recording = match &arguments.recording {
        Some(path) => Some(Source::open(path, &[], context)?),
        None => None,
    };
    let samples = imu_of(arguments.imu.as_deref(), recording.as_ref(), context)?;
    let found = imu_noise(&samples, &config, &|p| context.show(p))?;
    context.check_stop()?;
    pages::write(&arguments.out, found.page("IMU noise"), &provenance)?;
    let judgement = found.judgement();
    let is_usable = judgement.verdict() != Verdict::Fail;
    if let Some(path) = arguments.out_kalibr.as_ref().filter(|_| is_usable) {
        let rate_hz = found.rate_hz.round();
        write(
            path,
            imu_to_kalibr(&found.rig_imu(), rate_hz, &arguments.topic),
        )?;
    }
    if let Some((mut rig, path)) = rig.filter(|_| is_usable) {
        rig.set_imu_noise(found.rig_imu());
        write(path, rig.to_toml())?;
    }
    provenance.write(&arguments.out)?;
    let judged = Judged::new(&judgement, &found.summary(), &found);
    context.print(&judged, || {
        let mut text = format!("{}: {}", arguments.out.display(), judged.summary);
        text += &format!("{}\n{}", table(&found), judged::problem_lines(&judgement));
        judged::printable(text.trim_end())
    })?;
    Ok(Outcome::of(judgement.verdict()))
}

fn table(found: &ImuNoise) -> String {
    let mut text = String::new();
    let axes = found
        .axes
        .iter()
        .map(|a| (a.name.as_str(), &a.noise, &a.sigma));
    let triads = [
        ("gyroscope", &found.gyro, &found.gyro_sigma),
        ("accelerometer", &found.accel, &found.accel_sigma),
    ];
    for (name, noise, sigma) in axes.chain(triads) {
        text += &format!(
            "\n  {name:13} noise density {:.3e} ± {:.1e} /√Hz, bias instability {:.3e} ± {:.1e}, random walk {:.3e} ± {:.1e} /s/√Hz",
            noise.density,
            sigma.density,
            noise.instability,
            sigma.instability,
            noise.walk,
            sigma.walk
        );
    }
    text
}
