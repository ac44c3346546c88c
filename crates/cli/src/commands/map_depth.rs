//! `lsfb map depth`: what the LiDAR saw, as a camera elsewhere in the map would have measured it.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_geometry::{Rig, Trajectory};
use lsfb_perception::image::{Compression, Samples, write_png};
use lsfb_pipeline::surface::{Surface, SurfaceConfig, View};
use lsfb_recording::{Provenance, read_tum};
use lsfb_types::{Judgement, Progress, Verdict, median, quantile};

use super::map_surface::{check_source, expect_sound, insert_scans};
use crate::context::Context;
use crate::existing::{expect_free_folder, expect_outside, expect_own_folder, replace_folder};
use crate::judged::{Judged, printable, problem_lines};
use crate::outcome::Outcome;

/// Render depth and normal images from the scanner's LiDAR.
///
/// For each pose and camera: OUT/depth/CAMERA/NANOSECONDS.png (16 bits, distance along the optical axis
/// in millimetres) and OUT/normals/CAMERA/NANOSECONDS.png (normal in the camera frame, (n + 1) · 127.5
/// in red, green, blue). Zero means uncertain: not scanned, not on a plane (plants, people), hidden by
/// such objects, or within a few centimetres of an outline. All pixels have the time of the pose:
/// rolling shutter is not modelled.
///
/// If the scans disagree at the poses of the trajectory (beams end behind surfaces that other scans
/// saw, walls are smeared), the trajectory belongs to another walk or clock: no image is written, and
/// the exit code is 4. With --force, OUT/depth and OUT/normals of an earlier run are replaced as a whole.
///
/// Examples:
///   lsfb map depth scan.mcap --trajectory scan.tum --out depth
///   lsfb map depth scan.mcap --trajectory scan.tum --poses walk.tum --rig glasses.toml --camera cam0 --every 10 --out depth
#[derive(clap::Args)]
#[command(verbatim_doc_comment, after_long_help = settings())]
pub struct DepthArguments {
    /// Recording of the scanner.
    #[arg(value_name = "MCAP")]
    recording: PathBuf,
    /// Trajectory of the scanner in the map, from `lsfb map --out-trajectory`.
    #[arg(long, value_name = "TUM")]
    trajectory: PathBuf,
    /// Poses, in the map, of the rig that carries the cameras, one per image; by default the scanner's.
    #[arg(long, value_name = "TUM")]
    poses: Option<PathBuf>,
    /// Rig that carries the cameras; by default the scanner's.
    #[arg(long, value_name = "TOML", requires = "poses")]
    rig: Option<PathBuf>,
    /// Cameras to use, separated by commas or once for each; by default all cameras of the rig.
    #[arg(long = "camera", value_name = "NAME", value_delimiter = ',')]
    cameras: Vec<String>,
    /// Use only every n-th pose.
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    /// Folder to write to.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Settings instead of the defaults; `lsfb map depth --help` lists them.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

fn settings() -> String {
    let settings = toml::to_string(&SurfaceConfig::default()).unwrap_or_default();
    format!("Settings of --config and their defaults:\n\n{settings}")
}

/// What stands beside the images says that they are of this command.
const MADE_BY: &str = "map depth";
/// Folders of the images.
const KINDS: [&str; 2] = ["depth", "normals"];
/// Depths are written in millimetres, 16 bits.
const MM_PER_M: f32 = 1000.0;

/// Does it.
pub fn depth(arguments: &DepthArguments, context: &Context) -> anyhow::Result<Outcome> {
    let config: SurfaceConfig = super::config_or_default(arguments.config.as_deref())?;
    config.check_bounds("surface")?;
    let mut read: Vec<&Path> = vec![&arguments.recording, &arguments.trajectory];
    read.extend(arguments.poses.as_deref());
    read.extend(arguments.rig.as_deref());
    context.claim(&arguments.out, &read)?;
    for kind in KINDS {
        let folder = arguments.out.join(kind);
        expect_free_folder(&folder, context.force())?;
        expect_own_folder(&folder, &arguments.out, MADE_BY)?;
        expect_outside(&folder, &read)?;
    }
    let settings = (&config, arguments.every, &arguments.cameras);
    let mut provenance = Provenance::new(&serde_json::json!({ MADE_BY: settings }));
    for path in read.iter().take(2 + usize::from(arguments.poses.is_some())) {
        provenance.add_input(path)?;
    }
    let recording = context.open(&arguments.recording)?;
    let rig = super::rig_for(&recording, arguments.rig.as_deref(), &mut provenance)?;
    let rig = super::with_cameras(rig, &arguments.cameras)?;
    anyhow::ensure!(
        !rig.cameras.is_empty(),
        "rig {} has no camera: give the rig of the walk with --rig",
        rig.name
    );
    let scanned = read_tum(&arguments.trajectory)?;
    let poses = match &arguments.poses {
        Some(path) => {
            expect_sound(path)?;
            read_tum(path)?
        }
        None => scanned.clone(),
    };
    check_source(&arguments.trajectory, &arguments.recording)?;
    let (builder, scans) =
        insert_scans(&arguments.recording, &recording, &scanned, &config, context)?;
    let surface = builder.finish();
    let judgement = Judgement::new(vec![surface.agreement().finding()]);
    let name = printable(&arguments.trajectory.display().to_string());
    if judgement.verdict() == Verdict::Fail {
        let made = serde_json::json!({ "scans": scans, "agreement": surface.agreement() });
        let judged = Judged::new(&judgement, &name, &made);
        context.print(&judged, || {
            format!("no image was written\n{}", problem_lines(&judgement))
                .trim_end()
                .to_owned()
        })?;
        return Ok(Outcome::JudgementFailed);
    }
    let shares = render_all(arguments, &surface, &rig, &poses, context)?;
    let blind = shares.iter().filter(|share| **share == 0.0).count();
    anyhow::ensure!(
        blind < shares.len(),
        "none of {} images shows any of the surface: give poses in the world frame of {}",
        shares.len(),
        arguments.trajectory.display()
    );
    context.check_stop()?;
    for kind in KINDS {
        let [place, aside] = [kind, &unfinished(kind)].map(|name| arguments.out.join(name));
        replace_folder(&aside, &place, &arguments.out)?;
    }
    provenance.write(&arguments.out)?;
    let [half, least] = [0.5, 0.05].map(|q| quantile(shares.clone(), q).unwrap_or(0.0));
    let summary = serde_json::json!({
        "scans": scans,
        "agreement": surface.agreement(),
        "images": shares.len(),
        "images_without_depth": blind,
        "share_with_depth": { "median": median(shares.clone()), "of_95_percent_above": least },
    });
    let judged = Judged::new(&judgement, &name, &summary);
    context.print(&judged, || {
        let made = format!(
            "{}: {} images, {blind} without any depth; {:.0} % of the pixels have depth in half of the images, {:.0} % in 95 % of them; from {scans} scans",
            arguments.out.display(),
            shares.len(),
            100.0 * half,
            100.0 * least
        );
        format!("{made}\n{}", problem_lines(&judgement))
            .trim_end()
            .to_owned()
    })?;
    Ok(Outcome::Done)
}

/// Where images are until all of them are there.
fn unfinished(kind: &str) -> String {
    format!("{kind}.part")
}

/// Writes all images, aside; which share of each has a depth.
fn render_all(
    arguments: &DepthArguments,
    surface: &Surface,
    rig: &Rig,
    poses: &Trajectory,
    context: &Context,
) -> anyhow::Result<Vec<f64>> {
    let chosen: Vec<_> = poses
        .poses()
        .iter()
        .step_by(arguments.every as usize)
        .collect();
    let total = (chosen.len() * rig.cameras.len()) as u64;
    for begun in KINDS.map(|kind| arguments.out.join(unfinished(kind))) {
        if begun.is_dir() {
            crate::files::about(&begun, std::fs::remove_dir_all(&begun))?;
        }
    }
    let mut shares = Vec::new();
    for (name, mounted) in &rig.cameras {
        let folders = KINDS.map(|kind| arguments.out.join(unfinished(kind)).join(name));
        for folder in &folders {
            std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        }
        for pose in &chosen {
            context.show(Progress {
                stage: "depth",
                done: shares.len() as u64,
                total,
            })?;
            let world_from_camera = pose.world_from_rig * mounted.rig_from_camera;
            let view = surface.render(&mounted.camera, &world_from_camera);
            let file = format!("{}.png", pose.time.nanos());
            write_depths(&folders[0].join(&file), &view)?;
            write_normals(&folders[1].join(&file), &view)?;
            shares.push(view.known_share());
        }
    }
    Ok(shares)
}

fn write_depths(path: &Path, view: &View) -> anyhow::Result<()> {
    let millimetres = view.depths_m.iter().map(|depth| {
        let rounded = depth.map_or(0.0, |m| (m * MM_PER_M).round());
        // What is farther than 16 bits reach is not known to this file.
        if rounded <= f32::from(u16::MAX) {
            rounded as u16
        } else {
            0
        }
    });
    let millimetres: Vec<u16> = millimetres.collect();
    write_view(path, view, Samples::Grey16(&millimetres))
}

fn write_normals(path: &Path, view: &View) -> anyhow::Result<()> {
    let pixels = view.normals.iter().flat_map(|normal| match normal {
        [0.0, 0.0, 0.0] => [0; 3],
        known => known.map(|n| ((n + 1.0) * 127.5).round() as u8),
    });
    let bytes: Vec<u8> = pixels.collect();
    write_view(path, view, Samples::Rgb(&bytes))
}

fn write_view(path: &Path, view: &View, samples: Samples<'_>) -> anyhow::Result<()> {
    let written = || {
        let mut file = BufWriter::new(File::create(path)?);
        let size = (view.width, view.height);
        write_png(&mut file, size, samples, Compression::default())?;
        file.flush()
    };
    written().with_context(|| path.display().to_string())
}
