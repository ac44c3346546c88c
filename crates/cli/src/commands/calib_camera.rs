//! `lsfb calib camera`: views of a board → lenses and poses of cameras.

use std::path::PathBuf;

use lsfb_calib::camera::{CameraConfig, CameraViews, as_global_shutter, calibrate_cameras};
use lsfb_calib::exchange::{ChainOrigin, camera_chain};
use lsfb_geometry::Rig;
use lsfb_geometry::camera::LensModel;
use lsfb_recording::Provenance;
use lsfb_types::Verdict;

use super::calib_board::BoardArguments;
use super::calib_input::{Source, add_input, calibrated_unix_s, name_of_camera, views_of};
use super::calib_result::{Calibrated, Results, write_transforms};
use super::write;
use crate::context::Context;
use crate::one_of::one_of;
use crate::outcome::Outcome;
use crate::pages;

/// Calibrate camera lenses and the cameras' poses relative to each other, from views of a board.
///
/// Images in different folders belong together if the last numbers in their names are equal. If the
/// reprojection error is larger than the noise of any detector, no rig is written, the page says why,
/// and the exit code is 4.
///
/// Examples:
///   lsfb calib camera --checkerboard 9,6,0.025 --model pinhole-radtan --camera left=images/left* --camera right=images/right* --out rig.toml
///   lsfb calib camera --target grid.yaml --recording scan.mcap --camera cam0 --camera cam1 --out rig.toml
///   lsfb calib camera --target grid.yaml --recording ros.bag --camera cam0=/cam0/image_raw --out rig.toml
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(flatten)]
    board: BoardArguments,
    /// A camera: NAME in the recording, NAME=TOPIC in a ROS bag, NAME=FOLDER, or NAME=FOLDER/PREFIX*; may be repeated. The first is
    /// the reference.
    #[arg(long = "camera", required = true, value_name = "NAME[=FOLDER]")]
    cameras: Vec<String>,
    /// Recording with the cameras given without a folder; or a ROS bag (.bag, .mcap, .db3, or a rosbag2 folder).
    #[arg(long, value_name = "MCAP")]
    recording: Option<PathBuf>,
    /// Lens model of all cameras.
    #[arg(long, value_name = "NAME", default_value = LensModel::KannalaBrandt.name(), value_parser = one_of(&LensModel::ALL, LensModel::name))]
    model: LensModel,
    /// Rig to put the cameras into; the rest of it is kept. A warning names cameras that seem to be
    /// swapped. Its shutter times (readout_s) are corrected for in images less than a quarter of a second
    /// apart.
    #[arg(long, value_name = "TOML")]
    rig: Option<PathBuf>,
    /// The rig to write; a page with plots and, for several cameras, the transforms for `lsfb calib joint` are written beside it.
    #[arg(long, value_name = "TOML")]
    out: PathBuf,
    /// Also write Kalibr's camera chain.
    #[arg(long, value_name = "YAML")]
    out_kalibr: Option<PathBuf>,
    /// Settings instead of the defaults; --model still selects the model.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

/// The views as a global shutter would have them, where the rig says how long the camera's takes to roll.
fn as_shutter_of(views: CameraViews, rig: &Rig) -> CameraViews {
    let known = rig.cameras.get(&views.name);
    as_global_shutter(&views, known.map_or(0.0, |camera| camera.timing.readout_s))
}

/// Calibrates, writes rig and page, prints the report.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let target = arguments.board.target()?;
    let names: Vec<&str> = arguments
        .cameras
        .iter()
        .map(|c| name_of_camera(c))
        .collect();
    let pairs: Vec<[&str; 2]> = names.iter().skip(1).map(|n| [*n, names[0]]).collect();
    let results = Results {
        out: &arguments.out,
        transforms: &pairs,
        others: &[arguments.out_kalibr.as_deref()],
        rig: arguments.rig.as_deref(),
        read: arguments.recording.iter().map(PathBuf::as_path).collect(),
    };
    results.claim(context)?;
    let mut config: CameraConfig = match &arguments.config {
        Some(path) => super::read_config(path)?,
        None => CameraConfig::default(),
    };
    config.model = arguments.model;
    let mut rig = match &arguments.rig {
        Some(path) => Rig::read(path)?,
        None => Rig::empty("rig"),
    };
    let mut provenance = Provenance::new(&config);
    let cameras: Vec<&str> = arguments.cameras.iter().map(String::as_str).collect();
    let recording = match &arguments.recording {
        Some(path) => {
            add_input(&mut provenance, path)?;
            Some(Source::open(path, &cameras, context)?)
        }
        None => None,
    };
    let show = |p| context.show(p);
    let views: Vec<CameraViews> = arguments
        .cameras
        .iter()
        .map(|camera| views_of(camera, recording.as_ref(), &target, context))
        .map(|views| Ok(as_shutter_of(views?, &rig)))
        .collect::<anyhow::Result<_>>()?;
    let mut calibration = calibrate_cameras(&target, &views, &config, &show)?;
    calibration.compare_with(&rig);
    calibration.put_into(&mut rig);
    let stamps_ns = views.iter().filter_map(|v| v.views.keys().next_back());
    rig.calibrated_unix_s = calibrated_unix_s(recording.as_ref(), stamps_ns.copied())?;
    let page = arguments.out.with_extension("html");
    pages::write(&page, calibration.page("Camera calibration"), &provenance)?;
    let mut transforms = Vec::new();
    let judgement = calibration.judgement();
    if judgement.verdict() != Verdict::Fail {
        write(&arguments.out, rig.to_toml())?;
        transforms = write_transforms(&arguments.out, &calibration.edges())?;
        if let Some(path) = &arguments.out_kalibr {
            let names = calibration.cameras.iter().map(|c| c.name.as_str());
            write(path, camera_chain(&rig, names, ChainOrigin::FirstCamera))?;
        }
        provenance.write(&arguments.out)?;
    }
    let result = Calibrated {
        judgement: &judgement,
        summary: calibration.summary(),
        out: &arguments.out,
        page: &page,
        transforms: &transforms,
        calibration: &calibration,
    };
    result.print(context, || {
        let mut text = String::new();
        for c in &calibration.cameras {
            text += &format!(
                "\n  {}: {:.3} px rms over {} corners in {} of {} images, {} outliers",
                c.name, c.rms_px, c.corners, c.found, c.images, c.outliers
            );
            for p in &c.parameters {
                text += &format!("\n    {:5} {:10.4} ± {:.4}", p.name, p.value, p.sigma);
            }
            if c.board.is_likely {
                text += &format!(
                    "\n    board bent by {:.1} ± {:.1} mm, as the views make likely; the standard deviations account for it",
                    c.board.bend_m * 1e3,
                    c.board.bend_sigma_m * 1e3
                );
            }
        }
        text
    })
}
