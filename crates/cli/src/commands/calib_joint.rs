//! `lsfb calib joint`: pairwise transforms → one rig, Eq. 3.

use std::path::PathBuf;

use lsfb_calib::TransformEdge;
use lsfb_calib::joint::{IMU, JointConfig, LIDAR, Weights, join_transforms};
use lsfb_geometry::{Rig, RigLidar};
use lsfb_recording::Provenance;
use lsfb_types::Verdict;

use super::calib_result::{Calibrated, Results};
use super::write;
use crate::context::Context;
use crate::outcome::Outcome;
use crate::pages;

/// Join pairwise transforms between sensors into one rig (Eq. 3), and check every loop.
///
/// The cameras' poses in the rig are used as transforms to the IMU; those given with --transform are
/// added, and replace the rig's between the same sensors. If a transform contradicts the others, no rig
/// is written, the page names it, and the exit code is 4.
///
/// Examples:
///   lsfb calib joint --rig rig.toml --transform rig.cam0-lidar.json --transform rig.cam1-lidar.json --out joined.toml
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The rig to start from, with lenses and the cameras' poses in the IMU frame.
    #[arg(long, value_name = "TOML")]
    rig: PathBuf,
    /// A transform between two sensors, as written by the other steps; may be repeated.
    #[arg(long = "transform", required = true, value_name = "JSON")]
    transforms: Vec<PathBuf>,
    /// Use the paper's covariances for all transforms instead of measured ones.
    #[arg(long)]
    paper_weights: bool,
    /// The joined rig to write; a page with the table of loops is written beside it.
    #[arg(long, value_name = "TOML")]
    out: PathBuf,
    /// Settings instead of the defaults.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

/// Joins, writes rig and page, prints the table.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let mut config: JointConfig = super::config_or_default(arguments.config.as_deref())?;
    if arguments.paper_weights {
        config.weights = Weights::Paper;
    }
    let results = Results {
        out: &arguments.out,
        transforms: &[],
        others: &[],
        rig: Some(&arguments.rig),
        read: arguments.transforms.iter().map(PathBuf::as_path).collect(),
    };
    results.claim(context)?;
    let mut rig = Rig::read(&arguments.rig)?;
    let mut provenance = Provenance::new(&config);
    provenance.add_input(&arguments.rig)?;
    let mut edges = Vec::new();
    for path in &arguments.transforms {
        let edge = TransformEdge::read(path)?;
        for name in [&edge.target, &edge.source] {
            let is_known = [IMU, LIDAR].contains(&name.as_str()) || rig.cameras.contains_key(name);
            anyhow::ensure!(
                is_known,
                "{}: {name} is neither imu nor lidar nor a camera of {}, which has {}",
                path.display(),
                arguments.rig.display(),
                rig.cameras.keys().cloned().collect::<Vec<_>>().join(", ")
            );
        }
        edges.push(edge);
        provenance.add_input(path)?;
    }
    for (name, camera) in &rig.cameras {
        let given = edges.iter().any(|e| {
            [e.target.as_str(), e.source.as_str()] == [IMU, name]
                || [e.source.as_str(), e.target.as_str()] == [IMU, name]
        });
        if !given {
            edges.push(TransformEdge {
                target: IMU.to_owned(),
                source: name.clone(),
                target_from_source: camera.rig_from_camera,
                covariance: None,
            });
        }
    }
    let found = join_transforms(&edges, &config)?;
    if let Some(lidar) = found.sensor(LIDAR) {
        let range_noise_m = rig.lidar().map_or(0.03, |l| l.range_noise_m);
        rig.set_lidar(RigLidar {
            rig_from_lidar: lidar.imu_from_sensor,
            range_noise_m,
        });
    }
    found.put_into(&mut rig);
    context.check_stop()?;
    let page = arguments.out.with_extension("html");
    pages::write(&page, found.page("Joint calibration"), &provenance)?;
    let judgement = found.judgement();
    if judgement.verdict() != Verdict::Fail {
        write(&arguments.out, rig.to_toml())?;
        provenance.write(&arguments.out)?;
    }
    let result = Calibrated {
        judgement: &judgement,
        summary: found.summary(),
        out: &arguments.out,
        page: &page,
        transforms: &[],
        calibration: &found,
    };
    result.print(context, || {
        let mut text = "\n  transform            loop rotation  translation    χ² (6)".to_owned();
        for e in &found.edges {
            let name = format!("{}–{}", e.target, e.source);
            text += &match (e.loop_rotation_rad, e.loop_translation_m, e.chi_square) {
                (Some(turn), Some(shift), Some(chi)) => format!(
                    "\n  {name:20} {:11.3} ° {:9.2} mm {chi:9.1}{}",
                    turn.to_degrees(),
                    shift * 1e3,
                    if e.outlier { "  contradicts" } else { "" }
                ),
                _ => format!("\n  {name:20} not checked by any loop"),
            };
        }
        text
    })
}
