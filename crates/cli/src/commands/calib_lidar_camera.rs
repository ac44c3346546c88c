//! `lsfb calib lidar-camera`: views of a board by both → pose of the LiDAR to the camera.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_calib::PoseNumbers;
use lsfb_calib::joint::LIDAR;
use lsfb_calib::lidar_camera::{
    BoardPose, LidarCameraConfig, MountedBoard, RecordingConfig, calibrate_lidar_camera,
    poses_from_folder, poses_from_recording,
};
use lsfb_geometry::{Rig, RigLidar};
use lsfb_recording::Provenance;
use lsfb_types::{Image, Verdict};

use super::calib_board::{BoardArguments, two_lengths};
use super::calib_input::{
    Source, add_input, calibrated_unix_s, image_at, name_of_camera, views_of,
};
use super::calib_result::{Calibrated, Results, picture_path, write_transforms};
use super::write;
use crate::context::Context;
use crate::outcome::Outcome;
use crate::pages;

/// Calibrate the LiDAR's pose relative to a camera, from poses of a board that both see.
///
/// Images and clouds (PCD with rings) belong together if the last numbers in their names are equal; the
/// board must then be at rest. In a recording, the board or the rig may move: the images around each
/// scan give the board's pose at each return. The board must stand free (nothing within 20 cm behind
/// it) and be tilted differently each time. Ten poses are the minimum, thirty are good.
///
/// Examples:
///   lsfb calib lidar-camera --checkerboard 7,5,0.095 --plate-m 0.85,0.61 --camera cam0=images --clouds 'pcd/*_full.pcd' --rig rig.toml --out calibrated.toml
///   lsfb calib lidar-camera --target grid.yaml --plate-m 0.83,0.75 --camera cam0 --recording scan.mcap --rig rig.toml --out calibrated.toml
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(flatten)]
    board: BoardArguments,
    /// Size of the plate along the pattern's x and y axes.
    #[arg(long, value_name = "W,H", value_parser = two_lengths)]
    plate_m: [f64; 2],
    /// Centre of the plate relative to the centre of the corners, along the pattern's x and y axes.
    #[arg(long, value_name = "X,Y", value_parser = two_lengths, default_value = "0,0", allow_hyphen_values = true)]
    plate_offset_m: [f64; 2],
    /// The camera, whose lens is in the rig: NAME in the recording, NAME=FOLDER, or NAME=FOLDER/PREFIX*.
    #[arg(long, value_name = "NAME[=FOLDER]")]
    camera: String,
    /// The clouds: FOLDER or FOLDER/PREFIX*SUFFIX.
    #[arg(
        long,
        value_name = "FOLDER",
        group = "source",
        required_unless_present = "recording"
    )]
    clouds: Option<String>,
    /// The recording. Best is to hold the board still for two seconds in each pose, since the result then does not depend on the clocks.
    #[arg(long, value_name = "MCAP", group = "source")]
    recording: Option<PathBuf>,
    /// Largest number of poses to use from a recording.
    #[arg(long, value_name = "N", default_value_t = 60)]
    max_poses: usize,
    /// The rig to start from, with the camera.
    #[arg(long, value_name = "TOML")]
    rig: PathBuf,
    /// The rig with the LiDAR to write; a page with plots and the transform for `lsfb calib joint` are written beside it.
    #[arg(long, value_name = "TOML")]
    out: PathBuf,
    /// Settings instead of the defaults.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

/// Calibrates, writes rig, transform and page, prints the report.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let board = MountedBoard {
        target: arguments.board.target()?,
        width_m: arguments.plate_m[0],
        height_m: arguments.plate_m[1],
        offset_m: arguments.plate_offset_m,
    };
    let name = name_of_camera(&arguments.camera);
    let results = Results {
        out: &arguments.out,
        transforms: &[[name, LIDAR]],
        others: &[],
        rig: Some(&arguments.rig),
        read: arguments.recording.iter().map(PathBuf::as_path).collect(),
    };
    results.claim(context)?;
    let config: LidarCameraConfig = super::config_or_default(arguments.config.as_deref())?;
    let mut rig = Rig::read(&arguments.rig)?;
    let mut provenance = Provenance::new(&config);
    provenance.add_input(&arguments.rig)?;
    let mounted = rig.cameras.get(name).with_context(|| {
        let known: Vec<&str> = rig.cameras.keys().map(String::as_str).collect();
        format!(
            "{}: no camera {name}; it has {}: calibrate it with `lsfb calib camera`",
            arguments.rig.display(),
            known.join(", ")
        )
    })?;
    let recording = match &arguments.recording {
        Some(path) => {
            add_input(&mut provenance, path)?;
            Some(Source::open(path, &[&arguments.camera], context)?)
        }
        None => None,
    };
    let views = views_of(
        &arguments.camera,
        recording.as_ref(),
        &board.target,
        context,
    )?;
    let camera = mounted.camera;
    anyhow::ensure!(
        (views.width, views.height) == (camera.width, camera.height),
        "camera {name}: images are {} × {} pixels, but its lens in {} is for {} × {}",
        views.width,
        views.height,
        arguments.rig.display(),
        camera.width,
        camera.height
    );
    let poses = match (&arguments.clouds, &recording) {
        (Some(clouds), _) => {
            let (folder, prefix, suffix) = pattern(clouds);
            poses_from_folder(&views, folder, prefix, suffix)?
        }
        (None, Some(source)) => poses_from_recording(
            &views,
            source.recording()?,
            &RecordingConfig {
                most: arguments.max_poses,
                rig_from_camera_s: mounted.timing.rig_from_camera_s,
            },
        )?,
        (None, None) => anyhow::bail!("no scans: give --clouds or --recording"),
    };
    let show = |p| context.show(p);
    let mut found = calibrate_lidar_camera(&board, name, &camera, &poses, &config, &show)?;
    found.compare_with(&rig);

    rig.set_lidar(RigLidar {
        rig_from_lidar: mounted.rig_from_camera * found.camera_from_lidar,
        range_noise_m: found.range_noise_m,
    });
    let stamps_ns = views.views.keys().next_back().copied().into_iter();
    rig.calibrated_unix_s = calibrated_unix_s(recording.as_ref(), stamps_ns)?;
    let page = arguments.out.with_extension("html");
    let picture = picture_path(&arguments.out);
    let overlay = match found.pictured_pose(&poses) {
        Some(pose) => image_of(&arguments.camera, recording.as_ref(), pose)?
            .map(|image| found.overlay(&camera, pose, &image))
            .transpose()?,
        None => None,
    };
    if let Some(overlay) = &overlay {
        write(&picture, &overlay.png)?;
    }
    let drawn = overlay.as_ref().map(|overlay| overlay.png.as_slice());
    let content = found.page("LiDAR–camera calibration", drawn);
    pages::write(&page, content, &provenance)?;
    let mut transforms = Vec::new();
    let judgement = found.judgement();
    if judgement.verdict() != Verdict::Fail {
        write(&arguments.out, rig.to_toml())?;
        transforms = write_transforms(&arguments.out, &[found.edge()])?;
        provenance.write(&arguments.out)?;
    }
    let result = Calibrated {
        judgement: &judgement,
        summary: found.summary(),
        out: &arguments.out,
        page: &page,
        transforms: &transforms,
        calibration: &found,
    };
    result.print(context, || {
        let mut text = String::new();
        let numbers = PoseNumbers::of(&found.camera_from_lidar, &found.covariance);
        let angles = &numbers.angles;
        for (k, (axis, value)) in angles.names.iter().zip(angles.degrees).enumerate() {
            let sigma = numbers.angle_sigma_deg[k];
            text += &format!("\n  {axis:10} {value:9.3} ± {sigma:.3} °");
        }
        if let Some(remark) = angles.remark {
            text += &format!("\n  ({remark})");
        }
        for (k, axis) in ["x", "y", "z"].iter().enumerate() {
            text += &format!(
                "\n  {axis:10} {:9.1} ± {:.1} mm",
                numbers.translation_m[k] * 1e3,
                numbers.translation_sigma_m[k] * 1e3
            );
        }
        for pose in &found.poses {
            if let Some(why) = &pose.rejected {
                text += &format!("\n  {} left out: {why}", pose.name);
            }
        }
        text
    })
}

/// The image of a pose, from where its corners came.
fn image_of(
    camera: &str,
    source: Option<&Source>,
    pose: &BoardPose,
) -> anyhow::Result<Option<Image>> {
    match pose.middle_sight() {
        Some(sight) => image_at(camera, source, sight.instant),
        None => Ok(None),
    }
}

/// `FOLDER` or `FOLDER/PREFIX*SUFFIX`.
fn pattern(text: &str) -> (&Path, &str, &str) {
    let Some((before, suffix)) = text.split_once('*') else {
        return (Path::new(text), "", "");
    };
    match before.rsplit_once('/') {
        Some((folder, prefix)) => (Path::new(folder), prefix, suffix),
        None => (Path::new("."), before, suffix),
    }
}
