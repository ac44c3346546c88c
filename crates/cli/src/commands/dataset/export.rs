//! `lsfb dataset export`: a sequence in the files of other programs.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_eval::dataset::{indoor_location, lamar_session};
use lsfb_eval::slam_bench::{HiddenRegions, Layout, camera_name, export_without};
use lsfb_eval::{euroc_text, read_poses};
use lsfb_geometry::{Rig, Trajectory};
use lsfb_pipeline::hd_map::{ColmapCamera, ExportedFile, ImagePose, MapFormat, export_image_poses};
use lsfb_recording::{Provenance, Recording, message};
use lsfb_types::Timestamp;
use serde::Serialize;

use crate::bad_argument::BadArgument;
use crate::commands::map_tools::colmap_cameras;
use crate::context::Context;
use crate::existing::{expect_outside, expect_own_folder, replace_folder};
use crate::files::write;
use crate::outcome::Outcome;

/// Export a sequence of a dataset for other programs, with its truth if present.
///
/// EuRoC and TUM-VI folders get images, IMU data, sensor.yaml and truth; kitti and images have stamps
/// in a file; all get the rig and truth.tum. kapture, COLMAP and LaMAR sessions place every image by
/// the truth, and Indoor Location 2.0 takes its waypoints from it; these are refused without it. The
/// recordings themselves are ROS 2 bags.
///
/// --hidden-regions fills regions with their mean grey: lines of CAMERA FROM_S TO_S X Y WIDTH HEIGHT,
/// with - - for all times. lsfb does not detect faces: run a detector that writes this file. Only
/// exported images are changed, never the recordings.
///
/// With --force, the folder of an earlier export is replaced as a whole; any other is left as it is.
///
/// Examples:
///   lsfb dataset export dataset C3-android --format euroc --out c3
///   lsfb dataset export dataset C3-android --format colmap --out c3-model --hidden-regions faces.txt
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The dataset.
    #[arg(value_name = "FOLDER")]
    dataset: PathBuf,
    /// Name of the sequence.
    #[arg(value_name = "NAME")]
    sequence: String,
    /// Format to export.
    #[arg(long, value_name = "FORMAT", value_enum)]
    format: Program,
    /// Folder for the files.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Regions of images to hide.
    #[arg(long, value_name = "FILE")]
    hidden_regions: Option<PathBuf>,
}

#[derive(Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
enum Program {
    Euroc,
    TumVi,
    Kitti,
    Images,
    Kapture,
    Colmap,
    Lamar,
    IndoorLocation,
}

#[derive(Serialize)]
struct Exported<'a> {
    folder: &'a Path,
    true_poses: usize,
    /// Images that the truth does not reach to, which have no pose.
    without_pose: usize,
    /// Cameras whose lens the layout's `sensor.yaml` has no name for: `rig.toml` alone has it.
    without_lens: Vec<String>,
    /// Bluetooth advertisements that LaMAR's format has no place for.
    without_beacon: usize,
}

/// What stands beside an export says that it is one.
const MADE_BY: &str = "dataset export";

/// Reads, writes, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let (folder, description) = super::open(&arguments.dataset)?;
    let name = &arguments.sequence;
    anyhow::ensure!(
        description.query(name).is_some(),
        BadArgument::new(format!("the dataset has no sequence {name:?}"))
    );
    let out = &arguments.out;
    let (walk, truth_path) = (folder.walk(name), folder.walk_truth(name));
    let mut read = vec![arguments.dataset.as_path(), &walk, &truth_path];
    read.extend(arguments.hidden_regions.as_deref());
    context.claim_folder(out, &read)?;
    // Whatever else is there is not thrown away, forced or not.
    expect_own_folder(out, out, MADE_BY)?;
    expect_outside(out, &read)?;
    let config = serde_json::json!({ MADE_BY: name, "format": arguments.format });
    let mut provenance = Provenance::new(&config);
    for path in read.iter().skip(1).filter(|path| path.exists()) {
        provenance.add_input(path)?;
    }
    let recording = context.open(&walk)?;
    let truth = match truth_path.exists() {
        true => read_poses(&truth_path)?,
        false => Vec::new(),
    };
    let hidden = match &arguments.hidden_regions {
        Some(path) => HiddenRegions::read(path)?,
        None => HiddenRegions::default(),
    };
    let mut exported = Exported {
        folder: out,
        true_poses: truth.len(),
        without_pose: 0,
        without_lens: Vec::new(),
        without_beacon: 0,
    };
    // Written aside, and put in its place as a whole.
    let mut aside = out.file_name().unwrap_or_default().to_os_string();
    aside.push(".unfinished");
    let staged = out.with_file_name(aside);
    let (layout, images) = match arguments.format {
        Program::Euroc => (Layout::Euroc, staged.clone()),
        Program::TumVi => (Layout::TumVi, staged.clone()),
        Program::Kitti => (Layout::Kitti, staged.clone()),
        Program::Images => (Layout::Images, staged.clone()),
        Program::Kapture => (Layout::Stamped, staged.join("sensors").join("records_data")),
        Program::Colmap => (Layout::Stamped, staged.join("images")),
        Program::Lamar => (Layout::Stamped, staged.join("raw_data")),
        // A text: what is hidden in images is in none.
        Program::IndoorLocation => (Layout::AsIs, staged.clone()),
    };
    let places_images = matches!(arguments.format, Program::Kapture | Program::Colmap);
    let needs_truth =
        places_images || matches!(arguments.format, Program::Lamar | Program::IndoorLocation);
    anyhow::ensure!(
        !needs_truth || !truth.is_empty(),
        "{}: there is no truth, which this format needs to place images or waypoints: use euroc or images",
        truth_path.display()
    );
    if staged.is_dir() {
        crate::files::about(&staged, std::fs::remove_dir_all(&staged))?;
    }
    let around = images.parent().unwrap_or(&staged);
    std::fs::create_dir_all(around).with_context(|| around.display().to_string())?;
    export_without(&recording, layout, &hidden, &images)?;
    context.check_stop()?;
    if matches!(arguments.format, Program::Euroc | Program::TumVi) {
        exported.without_lens = without_lens(&staged)?;
    }
    let truth = Trajectory::new(truth);
    match arguments.format {
        Program::Lamar => {
            let rig = recording.rig()?;
            let cameras = camera_rows(&rig)?;
            let session = lamar_session(&recording, &rig, &cameras, truth.poses())?;
            exported.without_beacon = session.without_beacon;
            for (name, text) in session.files {
                put(&staged.join(name), text.as_bytes())?;
            }
        }
        Program::IndoorLocation => {
            let floor = description
                .query(name)
                .map_or("", |query| &query.environment);
            let text = indoor_location(&recording, truth.poses(), floor)?;
            put(&staged.join(format!("{name}.txt")), text.as_bytes())?;
        }
        _ => {}
    }
    if places_images {
        let (format, below) = match arguments.format {
            Program::Kapture => (MapFormat::Kapture, staged.clone()),
            _ => (MapFormat::ColmapText, staged.join("sparse")),
        };
        let (files, without) = placed(&recording, &truth, format)?;
        exported.without_pose = without;
        for file in files {
            put(&below.join(&file.path), &file.bytes)?;
        }
    }
    if !truth.is_empty() {
        let euroc = match arguments.format {
            Program::Euroc => Some("mav0/state_groundtruth_estimate0/data.csv"),
            Program::TumVi => Some("mav0/mocap0/data.csv"),
            _ => None,
        };
        if let Some(name) = euroc {
            put(&staged.join(name), euroc_text(truth.poses()).as_bytes())?;
        }
        lsfb_recording::write_tum(&staged.join("truth.tum"), &truth)?;
    }
    context.check_stop()?;
    replace_folder(&staged, out, out)?;
    provenance.write(out)?;
    context.print(&exported, || {
        let mut text = format!("{}: {} true poses", out.display(), exported.true_poses);
        if exported.without_pose > 0 {
            text += &format!("; {} images have none", exported.without_pose);
        }
        if exported.without_beacon > 0 {
            let left_out = exported.without_beacon;
            text += &format!(
                "\n{left_out} Bluetooth advertisements are not from iBeacons and were left out"
            );
        }
        for camera in &exported.without_lens {
            text += &format!(
                "\n{camera} has no sensor.yaml, which cannot hold its lens model: see rig.toml"
            );
        }
        text
    })?;
    Ok(Outcome::Done)
}

/// Cameras of an EuRoC folder that have images and no `sensor.yaml`.
fn without_lens(out: &Path) -> anyhow::Result<Vec<String>> {
    let sensors = out.join("mav0");
    let mut without = Vec::new();
    for entry in std::fs::read_dir(&sensors).with_context(|| sensors.display().to_string())? {
        let folder = entry?.path();
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with("cam") && !folder.join("sensor.yaml").exists() {
            without.push(name.into_owned());
        }
    }
    without.sort();
    Ok(without)
}

/// Model, size and parameters of each camera of the rig, as COLMAP has them.
fn camera_rows(rig: &Rig) -> anyhow::Result<Vec<String>> {
    let (cameras, _, _) = colmap_cameras(rig)?;
    let row = |camera: &ColmapCamera| {
        let [width, height] = camera.size;
        let parameters = camera.parameters.iter().map(|p| format!(", {p:?}"));
        format!(
            "{}, {width}, {height}{}",
            camera.model,
            parameters.collect::<String>()
        )
    };
    Ok(cameras.iter().map(row).collect())
}

fn put(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let around = path.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(around).with_context(|| around.display().to_string())?;
    write(path, bytes)
}

/// The files that place images by the truth, and how many it does not reach to.
fn placed(
    recording: &Recording,
    truth: &Trajectory,
    format: MapFormat,
) -> anyhow::Result<(Vec<ExportedFile>, usize)> {
    let rig = recording.rig()?;
    let (cameras, _, _) = colmap_cameras(&rig)?;
    let names: Vec<String> = rig.cameras.keys().cloned().collect();
    let topics = recording.topics().iter();
    let topics = topics.filter(|t| t.schema == message::IMAGE.name && t.messages > 0);
    let (mut poses, mut without) = (Vec::new(), 0);
    for topic in topics {
        let own = camera_name(&topic.topic);
        let place = names.iter().position(|name| name == own);
        let (camera, mounted) = place
            .zip(rig.cameras.get(own))
            .with_context(|| format!("the rig has no camera {own}"))?;
        for image in recording.images(&topic.topic)? {
            let time = image?.time;
            // Its own clock may not be the rig's.
            let at = time.plus_secs(mounted.timing.rig_from_camera_s);
            match truth.at(at) {
                Some(world_from_rig) => poses.push(ImagePose {
                    camera,
                    time_ns: Timestamp::nanos(time),
                    camera_from_world: (world_from_rig * mounted.rig_from_camera).inverse(),
                }),
                None => without += 1,
            }
        }
    }
    let files = export_image_poses(format, &rig, &cameras, &poses)?;
    Ok((
        files.context("the format cannot hold image poses")?,
        without,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An exported phone whose lens the format does not know had images without a calibration, and nobody was told.
    #[test]
    fn a_camera_without_calibration_is_named() {
        let folder = tempfile::tempdir().expect("folder");
        for (sensor, file) in [
            ("cam0", "sensor.yaml"),
            ("cam1", "data.csv"),
            ("imu0", "data.csv"),
        ] {
            let around = folder.path().join("mav0").join(sensor);
            std::fs::create_dir_all(&around).expect("folder");
            std::fs::write(around.join(file), "").expect("file");
        }
        assert_eq!(without_lens(folder.path()).expect("read"), ["cam1"]);
    }
}
