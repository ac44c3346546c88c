//! `lsfb map info`, `export`, `crop`, `merge` and the others: maps that stand.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_calib::exchange::{Format, export};
use lsfb_geometry::{Rig, Vector3};
use lsfb_pipeline::descriptor_index::IndexConfig;
use lsfb_pipeline::hd_map::{
    ColmapCamera, ExportedFile, MapFormat, MergeConfig, Region, SiteFrame,
};
use lsfb_types::{median, quantile};
use serde::Serialize;

use super::map_depth::{DepthArguments, depth};
use super::map_distances::{DistancesArguments, distances};
use super::map_folder::{bytes_in, print_made, written};
use super::map_keyframes::{self, KeyframeSigma};
use super::map_prune::{PruneArguments, prune};
use super::map_scans::{ScansArguments, scans};
#[cfg(feature = "view")]
use super::map_view::{ViewArguments, view};
use crate::bad_argument::BadArgument;
use crate::context::Context;
use crate::outcome::Outcome;

/// What to do with a map that stands.
#[derive(clap::Subcommand)]
pub enum Tool {
    Info(InfoArguments),
    Export(ExportArguments),
    Crop(CropArguments),
    Merge(MergeArguments),
    Prune(PruneArguments),
    Depth(DepthArguments),
    Distances(DistancesArguments),
    Scans(ScansArguments),
    #[cfg(feature = "view")]
    View(ViewArguments),
}

/// Show what a map contains: points and their accuracy, keyframes, cameras, extent.
///
/// Examples:
///   lsfb map info map
///   lsfb --json map info map
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct InfoArguments {
    /// The map.
    #[arg(value_name = "MAP")]
    map: PathBuf,
}

/// Export a map to COLMAP, kapture, nerfstudio, a point cloud, or keyframe poses.
///
/// Images are named CAMERA/NANOSECONDS.png; put them beside the model. Poses are keyframes.tum, and
/// keyframes_covariance.txt with the covariance relative to the first keyframe, for `lsfb eval --align
/// origin`.
///
/// Examples:
///   lsfb map export colmap map --out model
///   lsfb map export laz map --out cloud
///   lsfb map export keyframes map --out poses
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct ExportArguments {
    /// Format to export.
    #[arg(value_enum)]
    format: Program,
    /// The map.
    #[arg(value_name = "MAP")]
    map: PathBuf,
    /// Folder to write the files to.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
}

/// Crop a map to an axis-aligned box: the points in it, and the keyframes that see them.
///
/// Examples:
///   lsfb map crop map --min-m=-5,-5,-1 --max-m 5,5,3 --out room
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct CropArguments {
    /// The map.
    #[arg(value_name = "MAP")]
    map: PathBuf,
    /// Smallest coordinates of the box.
    #[arg(long, value_name = "X,Y,Z", value_parser = coordinates, allow_hyphen_values = true)]
    min_m: Vector3<f64>,
    /// Largest coordinates of the box.
    #[arg(long, value_name = "X,Y,Z", value_parser = coordinates, allow_hyphen_values = true)]
    max_m: Vector3<f64>,
    /// Map to write (folder).
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
}

/// Merge two overlapping maps of one place: the second is moved into the frame of the first.
///
/// Refused if they share too little, if another alignment is nearly as good, or if the alignment is too
/// uncertain.
///
/// Examples:
///   lsfb map merge ground-floor stairs --out building
#[derive(clap::Args)]
#[command(verbatim_doc_comment, after_long_help = merge_settings())]
pub struct MergeArguments {
    /// Map whose frame is kept.
    #[arg(value_name = "MAP")]
    first: PathBuf,
    /// Map to be moved.
    #[arg(value_name = "MAP")]
    second: PathBuf,
    /// Map to write (folder).
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Settings instead of the defaults; `lsfb map merge --help` lists them.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
}

fn merge_settings() -> String {
    let settings = toml::to_string(&MergeConfig::default()).unwrap_or_default();
    format!("Settings of --config and their defaults:\n\n{settings}")
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Program {
    Colmap,
    ColmapBinary,
    Kapture,
    Nerfstudio,
    Ply,
    Las,
    Laz,
    Keyframes,
}

impl Program {
    /// The library's format; `None` where the files are written here.
    fn format(self) -> Option<MapFormat> {
        Some(match self {
            Self::Colmap => MapFormat::ColmapText,
            Self::ColmapBinary => MapFormat::ColmapBinary,
            Self::Kapture => MapFormat::Kapture,
            Self::Nerfstudio => MapFormat::Nerfstudio,
            Self::Ply => MapFormat::Ply,
            Self::Las => MapFormat::Las,
            Self::Laz => MapFormat::Laz,
            Self::Keyframes => return None,
        })
    }
}

fn coordinates(text: &str) -> Result<Vector3<f64>, String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|word| {
            word.trim()
                .parse()
                .map_err(|_| format!("{word:?} is not a number"))
        })
        .collect::<Result<_, String>>()?;
    match numbers[..] {
        [x, y, z] if numbers.iter().all(|v| v.is_finite()) => Ok(Vector3::new(x, y, z)),
        _ => Err("expected three numbers: X,Y,Z in metres".to_owned()),
    }
}

/// Does it.
pub fn run(tool: &Tool, context: &Context) -> anyhow::Result<Outcome> {
    match tool {
        Tool::Info(arguments) => info(arguments, context),
        Tool::Export(arguments) => run_export(arguments, context),
        Tool::Crop(arguments) => crop(arguments, context),
        Tool::Merge(arguments) => merge(arguments, context),
        Tool::Prune(arguments) => prune(arguments, context),
        Tool::Depth(arguments) => depth(arguments, context),
        Tool::Distances(arguments) => distances(arguments, context),
        Tool::Scans(arguments) => scans(arguments, context),
        #[cfg(feature = "view")]
        Tool::View(arguments) => view(arguments, context),
    }
}

#[derive(Serialize)]
struct Info<'a> {
    points: usize,
    keyframes: usize,
    observations: usize,
    descriptors: usize,
    /// What the descriptors are of.
    feature: String,
    cameras: &'a [String],
    rig: &'a str,
    /// Smallest and largest coordinates of the points, metres.
    min_m: Option<[f64; 3]>,
    max_m: Option<[f64; 3]>,
    observations_per_point: f64,
    /// Median, and what 95 % stay below.
    reprojection_px: Option<[f64; 2]>,
    point_sigma_m: Option<[f64; 2]>,
    /// Of the keyframes, relative to the first; absent where their covariances are unknown.
    keyframe_sigma: Option<KeyframeSigma>,
    bytes: u64,
    /// The surveyed frame it stands in; absent where nothing was surveyed.
    #[serde(skip_serializing_if = "Option::is_none")]
    site: Option<&'a SiteFrame>,
    /// What was found wrong with it when it was made.
    failures: &'a [String],
    provenance: &'a str,
}

fn info(arguments: &InfoArguments, context: &Context) -> anyhow::Result<Outcome> {
    let map = super::open_map(&arguments.map)?;
    let quality: Vec<_> = (0..map.point_count() as u32)
        .filter_map(|p| map.quality(p))
        .collect();
    let region = map.region();
    let info = Info {
        points: map.point_count(),
        keyframes: map.keyframe_count(),
        observations: map.observation_count(),
        descriptors: map.descriptor_count(),
        feature: map.feature().to_string(),
        cameras: map.cameras(),
        rig: &map.rig().name,
        min_m: region.map(|r| r.min.into()),
        max_m: region.map(|r| r.max.into()),
        observations_per_point: map.observation_count() as f64 / map.point_count().max(1) as f64,
        reprojection_px: shares(quality.iter().map(|q| q.reprojection_rms_px)),
        point_sigma_m: shares(quality.iter().map(|q| q.worst_sigma_m())),
        keyframe_sigma: KeyframeSigma::of(&map),
        bytes: bytes_in(&arguments.map)?,
        site: map.site(),
        failures: map.failures(),
        provenance: map.provenance(),
    };
    context.print(&info, || text(&arguments.map, &info))?;
    Ok(Outcome::Done)
}

fn text(folder: &Path, info: &Info) -> String {
    let mut lines = vec![
        format!(
            "{}: {} points, {} observations ({:.1} each), {} descriptors, {:.1} MB",
            folder.display(),
            info.points,
            info.observations,
            info.observations_per_point,
            info.descriptors,
            info.bytes as f64 / 1e6
        ),
        format!(
            "{} keyframes of {}: {}",
            info.keyframes,
            info.rig,
            info.cameras.join(", ")
        ),
    ];
    if let (Some(min), Some(max)) = (info.min_m, info.max_m) {
        let side = |i: usize| format!("{} {:.2} to {:.2} m", ["x", "y", "z"][i], min[i], max[i]);
        lines.push(format!("{}, {}, {}", side(0), side(1), side(2)));
    }
    lines.extend(info.site.map(super::map_control::of_site));
    if let Some([half, most]) = info.reprojection_px {
        lines.push(format!(
            "reprojection error of a point: median {half:.2} px, 95 % below {most:.2} px"
        ));
    }
    if let Some([half, most]) = info.point_sigma_m {
        lines.push(format!(
            "σ of a point in the worst direction, given exact keyframes: median {:.1} cm, 95 % below {:.1} cm",
            100.0 * half,
            100.0 * most
        ));
    }
    lines.push(match &info.keyframe_sigma {
        Some(sigma) => sigma.sentence(info.keyframes),
        None => "σ of the keyframes: unknown".to_owned(),
    });
    let failures = info.failures.iter();
    lines.extend(failures.map(|what| format!("failed its checks when it was made: {what}")));
    lines.join("\n")
}

/// The median, and what 95 % stay below; of nothing, nothing.
fn shares(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    let values: Vec<f64> = values.collect();
    Some([median(values.clone())?, quantile(values, 0.95)?])
}

fn run_export(arguments: &ExportArguments, context: &Context) -> anyhow::Result<Outcome> {
    context.claim(&arguments.out, &[&arguments.map])?;
    let map = super::open_map(&arguments.map)?;
    let Some(format) = arguments.format.format() else {
        let outcome = map_keyframes::export(&map, &arguments.out, context)?;
        written(&map, &arguments.out, &[&arguments.map], &())?;
        return Ok(outcome);
    };
    let (cameras, rig_config, notes) = colmap_cameras(map.rig())?;
    let mut files = map.export(format, &cameras)?;
    if matches!(arguments.format, Program::Colmap | Program::ColmapBinary) {
        files.extend(rig_config);
    }
    for file in &files {
        context.claim(&arguments.out.join(&file.path), &[])?;
    }
    for file in &files {
        let path = arguments.out.join(&file.path);
        let folder = path.parent().unwrap_or(&arguments.out);
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        super::write(&path, &file.bytes)?;
    }
    written(&map, &arguments.out, &[&arguments.map], &())?;
    let summary = serde_json::json!({
        "files": files.len(),
        "points": map.point_count(),
        "notes": &notes,
        "failures": map.failures(),
    });
    let text = || {
        let out = arguments.out.display();
        let mut text = format!("{out}: {} files, {} points", files.len(), map.point_count());
        for note in &notes {
            text += &format!("\n  {note}");
        }
        text
    };
    print_made(&map, &arguments.out, &summary, text, context)
}

/// The cameras of a rig as COLMAP describes them, its `rig_config.json`, and what neither can hold.
pub fn colmap_cameras(
    rig: &Rig,
) -> anyhow::Result<(Vec<ColmapCamera>, Option<ExportedFile>, Vec<String>)> {
    // No IMU's rate is written.
    let exported = export(rig, Format::Colmap, 1.0)?;
    let text_of = |name: &str| exported.files.iter().find(|f| f.name == name);
    let lines = text_of("cameras.txt").map_or("", |f| &f.text).lines();
    let cameras = lines.filter(|line| !line.starts_with('#')).map(|line| {
        let words: Vec<&str> = line.split(' ').collect();
        let [_, model, width, height, parameters @ ..] = &words[..] else {
            anyhow::bail!("{line:?} is not a COLMAP camera");
        };
        let parameters = parameters.iter().map(|word| word.parse());
        Ok(ColmapCamera {
            model: (*model).to_owned(),
            size: [width.parse()?, height.parse()?],
            parameters: parameters.collect::<Result<_, _>>()?,
        })
    });
    let rig_config = text_of("rig_config.json").map(|f| ExportedFile {
        path: f.name.clone(),
        bytes: f.text.clone().into_bytes(),
    });
    Ok((
        cameras.collect::<anyhow::Result<_>>()?,
        rig_config,
        exported.notes.clone(),
    ))
}

fn crop(arguments: &CropArguments, context: &Context) -> anyhow::Result<Outcome> {
    let region = Region {
        min: arguments.min_m,
        max: arguments.max_m,
    };
    let named = [("min", "--min-m"), ("max", "--max-m")];
    BadArgument::check(region.check_bounds(""), &named)?;
    context.claim(&arguments.out, &[&arguments.map])?;
    let map = super::open_map(&arguments.map)?;
    let part = map.crop(&region, &IndexConfig::default(), &|p| context.show(p))?;
    part.write(&arguments.out)?;
    written(
        &part,
        &arguments.out,
        &[&arguments.map],
        &[arguments.min_m, arguments.max_m].map(<[f64; 3]>::from),
    )?;
    let summary = serde_json::json!({
        "points": part.point_count(),
        "of_points": map.point_count(),
        "keyframes": part.keyframe_count(),
        "failures": part.failures(),
    });
    let text = || {
        format!(
            "{}: {} of {} points, {} keyframes",
            arguments.out.display(),
            part.point_count(),
            map.point_count(),
            part.keyframe_count()
        )
    };
    print_made(&part, &arguments.out, &summary, text, context)
}

fn merge(arguments: &MergeArguments, context: &Context) -> anyhow::Result<Outcome> {
    let config: MergeConfig = super::config_or_default(arguments.config.as_deref())?;
    let read = [arguments.first.as_path(), &arguments.second];
    context.claim(&arguments.out, &read)?;
    let (first, second) = (super::open_map(read[0])?, super::open_map(read[1])?);
    let (merged, report) = first.merge(&second, &config, &|p| context.show(p))?;
    merged.write(&arguments.out)?;
    written(&merged, &arguments.out, &read, &config)?;
    let q = report.first_from_second.rotation.quaternion();
    let t = report.first_from_second.translation;
    let summary = serde_json::json!({
        "points": merged.point_count(),
        "keyframes": merged.keyframe_count(),
        "report": &report,
        "failures": merged.failures(),
        "first_from_second": { "translation_m": [t.x, t.y, t.z], "quaternion_xyzw": [q.i, q.j, q.k, q.w] },
    });
    let text = || {
        format!(
            "{}: {} points, {} of them in both maps, median {:.1} cm apart; position of the second map: {:.1} cm (1 σ) in the worst direction",
            arguments.out.display(),
            merged.point_count(),
            report.shared,
            100.0 * report.median_distance_m,
            100.0 * report.worst_sigma_m
        )
    };
    print_made(&merged, &arguments.out, &summary, text, context)
}
