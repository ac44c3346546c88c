//! `lsfb calib`: boards, images → rig.

use std::path::{Path, PathBuf};

use lsfb_calib::board::MarkerDictionary;
use lsfb_calib::camera::{CameraViews, views_from_folder, views_from_recording};
use lsfb_calib::camera_imu::read_imu_table;
use lsfb_calib::joint::IMU;
use lsfb_calib::verify::Outcome as Judgement;
use lsfb_calib::{Target, TransformEdge};
use lsfb_recording::Recording;
use lsfb_types::{ImuSample, Timestamp};
use serde::Serialize;

use crate::context::Context;
use crate::outcome::Outcome;

use super::{
    calib_camera, calib_camera_imu, calib_exchange, calib_imu_noise, calib_joint,
    calib_lidar_camera, calib_refine, calib_target, calib_verify,
};

/// Calibrate: print a board, find lenses and poses of cameras, IMU and LiDAR, join and verify them.
#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    step: Step,
}

#[derive(clap::Subcommand)]
enum Step {
    Target(calib_target::Arguments),
    Camera(calib_camera::Arguments),
    CameraImu(calib_camera_imu::Arguments),
    ImuNoise(calib_imu_noise::Arguments),
    LidarCamera(calib_lidar_camera::Arguments),
    Joint(calib_joint::Arguments),
    Verify(calib_verify::Arguments),
    Refine(calib_refine::Arguments),
    Import(calib_exchange::ImportArguments),
    Export(calib_exchange::ExportArguments),
}

/// Runs the step.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    match &arguments.step {
        Step::Target(a) => calib_target::run(a, context),
        Step::Camera(a) => calib_camera::run(a, context),
        Step::CameraImu(a) => calib_camera_imu::run(a, context),
        Step::ImuNoise(a) => calib_imu_noise::run(a, context),
        Step::LidarCamera(a) => calib_lidar_camera::run(a, context),
        Step::Joint(a) => calib_joint::run(a, context),
        Step::Verify(a) => calib_verify::run(a, context),
        Step::Refine(a) => calib_refine::run(a, context),
        Step::Import(a) => calib_exchange::run_import(a, context),
        Step::Export(a) => calib_exchange::run_export(a, context),
    }
}

/// Which board.
#[derive(clap::Args)]
#[group(required = true, multiple = false)]
pub struct TargetArguments {
    /// The board, as a Kalibr target file.
    #[arg(long, value_name = "YAML")]
    target: Option<PathBuf>,
    /// AprilGrid: tags across, tags up, edge of a tag in metres, gap as a share of it.
    #[arg(long, value_name = "COLS,ROWS,SIZE,SPACING", value_parser = april_grid)]
    april_grid: Option<Target>,
    /// Checkerboard: inner corners across, inner corners down, edge of a square in metres.
    #[arg(long, value_name = "COLS,ROWS,SIZE", value_parser = checkerboard)]
    checkerboard: Option<Target>,
    /// ChArUco board: squares across, squares down, edge of a square and of a marker in metres, bits of a marker (4x4, 5x5,
    /// 6x6).
    #[arg(long, value_name = "COLS,ROWS,SQUARE,MARKER,BITS", value_parser = charuco)]
    charuco: Option<Target>,
}

impl TargetArguments {
    /// The board that was named.
    pub fn target(&self) -> anyhow::Result<Target> {
        if let Some(path) = &self.target {
            return Ok(Target::read_kalibr(path)?);
        }
        let named = self.april_grid.or(self.checkerboard).or(self.charuco);
        named.ok_or_else(|| {
            anyhow::anyhow!("no target: give --target, --april-grid, --checkerboard or --charuco")
        })
    }
}

fn april_grid(text: &str) -> Result<Target, String> {
    let [columns, rows, size, spacing] = words(text, "COLS,ROWS,SIZE,SPACING")?;
    checked(Target::AprilGrid {
        columns: count(columns)?,
        rows: count(rows)?,
        tag_size_m: number(size)?,
        spacing_ratio: number(spacing)?,
    })
}

fn checkerboard(text: &str) -> Result<Target, String> {
    let [columns, rows, size] = words(text, "COLS,ROWS,SIZE")?;
    checked(Target::Checkerboard {
        columns: count(columns)?,
        rows: count(rows)?,
        square_m: number(size)?,
    })
}

fn charuco(text: &str) -> Result<Target, String> {
    let [columns, rows, square, marker, bits] = words(text, "COLS,ROWS,SQUARE,MARKER,BITS")?;
    checked(Target::Charuco {
        columns: count(columns)?,
        rows: count(rows)?,
        square_m: number(square)?,
        marker_m: number(marker)?,
        dictionary: MarkerDictionary::named(bits)
            .ok_or_else(|| format!("{bits}: expected 4x4, 5x5 or 6x6"))?,
    })
}

/// Exactly `N` words between commas.
pub fn words<'a, const N: usize>(text: &'a str, expected: &str) -> Result<[&'a str; N], String> {
    let words: Vec<&str> = text.split(',').map(str::trim).collect();
    words.try_into().map_err(|_| format!("expected {expected}"))
}

fn count(word: &str) -> Result<u32, String> {
    word.parse().map_err(|_| format!("{word} is not a count"))
}

/// A number, or what is wrong with it.
pub fn number(word: &str) -> Result<f64, String> {
    word.parse().map_err(|_| format!("{word} is not a number"))
}

fn checked(target: Target) -> Result<Target, String> {
    target.problem().map_or(Ok(target), Err)
}

/// What a camera saw: `NAME` in the recording, `NAME=FOLDER` or `NAME=FOLDER/PREFIX*`.
pub fn views_of(
    camera: &str,
    recording: Option<&Recording>,
    target: &Target,
    context: &Context,
) -> anyhow::Result<CameraViews> {
    context.check_stop()?;
    let show = |p| context.show(p);
    Ok(match (camera.split_once('='), recording) {
        (Some((name, place)), _) => {
            let (folder, prefix) = folder_and_prefix(place);
            views_from_folder(name, folder, prefix, target, &show)?
        }
        (None, Some(recording)) => views_from_recording(camera, recording, target, &show)?,
        (None, None) => {
            anyhow::bail!("camera {camera} has no images: give NAME=FOLDER, or --recording")
        }
    })
}

/// The IMU's samples: of a table if there is one, else of the recording.
pub fn imu_of(
    table: Option<&Path>,
    recording: Option<&Recording>,
) -> anyhow::Result<Vec<(Timestamp, ImuSample)>> {
    Ok(match (table, recording) {
        (Some(path), _) => read_imu_table(path)?,
        (None, Some(recording)) => recording
            .imu()?
            .map(|s| s.map(|s| (s.time, s.sample)))
            .collect::<Result<_, _>>()?,
        (None, None) => anyhow::bail!("there is no IMU: give --imu or --recording"),
    })
}

/// 1 January 2000 in seconds since 1970: stamps before it count from the start of something.
const YEAR_2000_UNIX_S: i64 = 946_684_800;

/// When the data of a step ended, for `Rig::calibrated_unix_s`: the end of the recording, else the last of `stamps_ns`. `None`
/// where that is no time of day.
pub fn calibrated_unix_s(
    recording: Option<&Recording>,
    stamps_ns: impl Iterator<Item = i64>,
) -> anyhow::Result<Option<i64>> {
    let end_ns = match recording {
        Some(recording) => recording.end_time()?.map(Timestamp::nanos),
        None => stamps_ns.max(),
    };
    let end_s = end_ns.map(|ns| ns.div_euclid(1_000_000_000));
    Ok(end_s.filter(|s| *s >= YEAR_2000_UNIX_S))
}

/// A calibration as it is printed: with its verdict, and what was written beside the rig.
#[derive(Serialize)]
pub struct Judged<'a, C: Serialize> {
    pub outcome: Judgement,
    pub verdict: String,
    pub page: &'a Path,
    /// For `lsfb calib joint`.
    pub transforms: &'a [PathBuf],
    #[serde(flatten)]
    pub calibration: &'a C,
}

impl<C: Serialize> Judged<'_, C> {
    /// The first line of the text.
    pub fn headline(&self, out: &Path) -> String {
        let mut text = format!(
            "{}: {} See {}",
            out.display(),
            self.verdict,
            self.page.display()
        );
        if !self.transforms.is_empty() {
            text += &format!("; for `lsfb calib joint`: {}", listed(self.transforms));
        }
        text + "."
    }

    /// Fails where the calibration must not be used.
    pub fn ensure_usable(&self, out: &Path) -> anyhow::Result<()> {
        anyhow::ensure!(
            self.outcome != Judgement::Fail,
            "{} is not written, its calibration cannot be used: see {} for why",
            out.display(),
            self.page.display()
        );
        Ok(())
    }
}

/// Writes transforms beside a rig, `RIG.TARGET-SOURCE.json`, and says where; `imu` comes last in the names.
pub fn write_transforms(rig: &Path, edges: &[TransformEdge]) -> anyhow::Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    for edge in edges {
        let (a, b) = if edge.target == IMU {
            (&edge.source, &edge.target)
        } else {
            (&edge.target, &edge.source)
        };
        let path = rig.with_extension(format!("{a}-{b}.json"));
        super::write(&path, edge.to_json())?;
        paths.push(path);
    }
    Ok(paths)
}

/// Files in a sentence.
pub fn listed(paths: &[PathBuf]) -> String {
    let names: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
    names.join(", ")
}

/// `FOLDER` or `FOLDER/PREFIX*`.
fn folder_and_prefix(place: &str) -> (&Path, &str) {
    let Some(pattern) = place.strip_suffix('*') else {
        return (Path::new(place), "");
    };
    match pattern.rsplit_once('/') {
        Some((folder, prefix)) => (Path::new(folder), prefix),
        None => (Path::new("."), pattern),
    }
}
