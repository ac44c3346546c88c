//! `lsfb localize`: images or a walk against a map.

mod drawing;
mod folder;
mod frames;
mod input;
mod matches;
mod page;
mod unfinished;

use std::path::{Path, PathBuf};

use lsfb_pipeline::kept_stages::KeptStages;
use lsfb_pipeline::localization::{Localizer, RIGHT_ANGLE_DEG, RIGHT_DISTANCE_M, Tally};
use lsfb_types::{Verdict, median};
use serde::Serialize;

use super::map_settings;
use super::models::ModelFolder;
use crate::bad_argument::BadArgument;
use crate::context::Context;
use crate::judged::{Judged, problem_lines};
use crate::outcome::Outcome;
use frames::Frame;
use input::{Input, Kept};
use unfinished::Unfinished;

/// Localize images, or the frames of a walk, in an HD map.
///
/// Each frame is localized on its own. A pose is given if it is right with a probability of 0.99.
/// Frames of a walk that are lost are searched for again where neighbouring frames and the IMU place
/// them; if less than a fifth of a walk is recognized, no pose is given. With --out, an interrupted run
/// resumes from OUT.unfinished.
///
/// Images without poses, in one of these layouts:
///   EuRoC, TUM-VI     mav0/cam0/data.csv and sensor.yaml; poses are those of the body
///   kapture           sensors/sensors.txt and records_camera.txt
///   COLMAP            cameras.txt or .bin in the folder, sparse/0 or sparse; with one camera also unregistered images
///   nerfstudio        transforms.json, transform_matrix left out
///   7-Scenes          NAME.color.png, and K.txt if the camera is a different one
///   Strecha           images/ and gt_dense_cameras
///   one camera        images, or images/, beside K.txt (3 × 3, undistorted pinhole)
///   any               images alone, with --rig
/// If a folder matches two layouts, name the image folder and pass --rig. --rig overrides the
/// intrinsics in the folder.
///
/// Examples:
///   lsfb localize map walk.mcap --out walk.csv
///   lsfb localize map photos --rig phone.toml --out photos.csv
///   lsfb localize map photos --explain 12 --out-drawing 12.svg
///   lsfb localize map walk.mcap --out walk.csv --out-matches walk_matches.csv
///   lsfb localize --posed-images hololens_office --every 5 --map office-map
#[derive(clap::Args)]
#[command(verbatim_doc_comment, after_long_help = map_settings::help_of_localize())]
pub struct Arguments {
    /// HD map (folder), unless given by --map; then a walk (MCAP) or a folder of images without poses.
    #[arg(value_name = "PATH", num_args = 0..=2)]
    paths: Vec<PathBuf>,
    /// HD map (folder).
    #[arg(long, value_name = "FOLDER")]
    map: Option<PathBuf>,
    /// Folder of images with poses: K.txt, poses_T_world_cam_rowmajor4x4.txt and images/; a 7-Scenes
    /// sequence; a Strecha scene; nerfstudio's transforms.json; a kapture; or a COLMAP project or model.
    /// Reports how many were localized correctly.
    #[arg(long, value_name = "FOLDER")]
    posed_images: Option<PathBuf>,
    /// Use only every n-th image.
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    /// Rig for a folder of images, instead of the intrinsics in the folder.
    #[arg(long, value_name = "TOML", conflicts_with = "posed_images")]
    rig: Option<PathBuf>,
    /// Camera of that rig that took the images, if it has several.
    #[arg(long, value_name = "NAME", requires = "rig")]
    camera: Option<String>,
    /// Write one line per frame (CSV): pose, inliers, probability, standard deviations, covariance.
    #[arg(long, value_name = "CSV")]
    out: Option<PathBuf>,
    /// Write the inliers of each frame's best pose, one line each (CSV): camera, pixel, map point with its
    /// position, reprojection error; whether the frame was localized.
    #[arg(long, value_name = "CSV")]
    out_matches: Option<PathBuf>,
    /// Settings instead of the defaults; `lsfb localize --help` lists them.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
    #[command(flatten)]
    models: ModelFolder,
    /// Also write a page: why frames were not localized, with pictures of some of them.
    #[arg(long, value_name = "HTML")]
    out_report: Option<PathBuf>,
    /// Draw the matches of this frame, counted from 0.
    #[arg(long, value_name = "FRAME", requires = "out_drawing")]
    explain: Option<usize>,
    /// Drawing of the matches (SVG).
    #[arg(long, value_name = "SVG", requires = "explain")]
    out_drawing: Option<PathBuf>,
}

/// Metres and degrees within which recall is reported besides.
const RECALL: [(f64, f64); 3] = [(0.10, 1.0), (0.25, 2.0), (1.0, 5.0)];
/// Inliers beyond which the paper counts an image as localized (Liu et al., section V-A).
const PAPER_INLIERS: usize = 30;

#[derive(Serialize)]
struct Summary {
    images: usize,
    localized: usize,
    /// Least probability of those.
    min_probability: f64,
    /// By the paper's rule, whatever their probability.
    more_than_30_inliers: usize,
    /// Localized by so little that a place outside the map that looks the same may have all of it.
    by_little: usize,
    /// Within 10 cm and 5° of the listed pose; `None` where no poses are listed.
    right: Option<usize>,
    /// Of all images; empty where no poses are listed.
    recall: Vec<Recall>,
    median_distance_m: Option<f64>,
    median_angle_deg: Option<f64>,
    /// What was found wrong with the map when it was made: poses in it may be far off.
    map_failures: Vec<String>,
    frames: Vec<Frame>,
}

/// The share of the images that were localized within limits of their listed poses.
#[derive(Serialize)]
struct Recall {
    distance_m: f64,
    angle_deg: f64,
    share: f64,
}

/// Localizes, writes, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let (map, input) = input::resolve(arguments)?;
    let results = [
        &arguments.out,
        &arguments.out_matches,
        &arguments.out_drawing,
        &arguments.out_report,
    ];
    let results: Vec<&Path> = results
        .into_iter()
        .flatten()
        .map(PathBuf::as_path)
        .collect();
    for result in results {
        context.claim(result, &[&input])?;
    }
    let config = map_settings::localization(arguments.config.as_deref())?;
    let localizer = Localizer::new(&super::open_map(&map)?, &config)?;
    let input = Input::open(&input, arguments, context)?;
    if let (Some(frame), Some(count)) = (arguments.explain, input.count()) {
        expect_frame(frame, count)?;
    }
    let mut detector = arguments.models.detector(localizer.map().feature())?;
    let mut unfinished = match &arguments.out {
        Some(out) => input.unfinished(out, &map, &config)?,
        None => None,
    };
    if let Some(before) = unfinished.as_ref().map(Unfinished::len).filter(|n| *n > 0) {
        context.note(&format!("resuming after {before} localized images"));
    }
    let stages = match &arguments.out {
        Some(out) => input.kept_stages(out, &map, &config, context)?,
        None => KeptStages::none(),
    };
    let kept = Kept {
        images: unfinished.as_mut(),
        walk: &stages,
    };
    let found = input.localize(&localizer, &detector, kept, context)?;
    anyhow::ensure!(!found.frames.is_empty(), "there are no images to localize");
    if let (Some(path), Some(frame)) = (&arguments.out_drawing, arguments.explain) {
        expect_frame(frame, found.frames.len())?;
        for shown in input.shown(&[frame], &found.times)? {
            let answer = (&found.frames[frame], &found.inliers[frame]);
            let drawn = drawing::draw(&localizer, &mut detector, &shown?, answer)?;
            crate::files::write(path, drawn)?;
        }
    }
    if let Some(path) = &arguments.out {
        crate::files::write(path, frames::csv(&found.frames))?;
    }
    if let Some(path) = &arguments.out_matches {
        matches::write_csv(path, &found.frames, &found.inliers, &localizer, input.rig())?;
    }
    if let Some(unfinished) = unfinished {
        unfinished.remove()?;
    }
    stages.remove()?;
    let summary = summary(found.frames, &input, &localizer);
    let tally = Tally {
        images: summary.images,
        localized: summary.localized,
        by_little: summary.by_little,
        right: summary.right,
        min_probability: summary.min_probability,
        damaged: found.damaged,
    };
    let judgement = tally.judgement(localizer.map().failed_checks());
    if let Some(path) = &arguments.out_report {
        let page_input = page::PageInput {
            input: &input,
            times: &found.times,
            inliers: &found.inliers,
        };
        let judged = (&summary, &judgement);
        let page = page::page(judged, &page_input, &localizer, &mut detector, context)?;
        crate::pages::write(path, page, &input.made_from(&map, &config)?)?;
    }
    context.print(&Judged::new(&judgement, "localization", &summary), || {
        let text = format!("{}\n{}", text(&summary), problem_lines(&judgement));
        text.trim_end().to_owned()
    })?;
    Ok(match (judgement.verdict(), found.damaged) {
        (Verdict::Fail, _) => Outcome::JudgementFailed,
        (_, 0) => Outcome::Done,
        _ => Outcome::DataLost,
    })
}

fn expect_frame(frame: usize, count: usize) -> anyhow::Result<()> {
    anyhow::ensure!(
        frame < count,
        BadArgument::new(format!(
            "--explain {frame}: there are {count} frames, counted from 0"
        ))
    );
    Ok(())
}

fn summary(frames: Vec<Frame>, input: &Input, localizer: &Localizer) -> Summary {
    let map = localizer.map();
    let localized: Vec<&Frame> = frames.iter().filter(|f| f.localized).collect();
    let median_of = |value: fn(&Frame) -> Option<f64>| {
        median(localized.iter().filter_map(|f| value(f)).collect())
    };
    let within = |distance_m: f64, angle_deg: f64| {
        let is_right = |frame: &&&Frame| {
            frame.distance_m.is_some_and(|d| d <= distance_m)
                && frame.angle_deg.is_some_and(|a| a <= angle_deg)
        };
        localized.iter().filter(is_right).count()
    };
    let recall = |(distance_m, angle_deg)| Recall {
        distance_m,
        angle_deg,
        share: within(distance_m, angle_deg) as f64 / frames.len().max(1) as f64,
    };
    let by_little = |frame: &&&Frame| frame.pose.as_ref().is_some_and(|p| p.evidence.is_thin());
    let more_than_30 = |frame: &&Frame| frame.pose.as_ref().is_some_and(|p| p.more_than_30_inliers);
    Summary {
        images: frames.len(),
        localized: localized.len(),
        by_little: localized.iter().filter(by_little).count(),
        more_than_30_inliers: frames.iter().filter(more_than_30).count(),
        right: input
            .lists_poses()
            .then(|| within(RIGHT_DISTANCE_M, RIGHT_ANGLE_DEG)),
        recall: match input.lists_poses() {
            true => RECALL.map(recall).into(),
            false => Vec::new(),
        },
        median_distance_m: median_of(|f| f.distance_m),
        median_angle_deg: median_of(|f| f.angle_deg),
        map_failures: map.failures().to_vec(),
        min_probability: localizer.min_probability(),
        frames,
    }
}

fn text(s: &Summary) -> String {
    let mut text = String::new();
    if let Some(right) = s.right {
        let share = 100.0 * right as f64 / s.images.max(1) as f64;
        text = format!(
            "{right} of {} images right within 10 cm and 5° ({share:.1} %)",
            s.images
        );
        if let (Some(m), Some(deg)) = (s.median_distance_m, s.median_angle_deg) {
            text += &format!("; median {:.1} mm, {deg:.2}°", m * 1e3);
        }
        let recall = s.recall.iter().map(|r| {
            let (percent, m, deg) = (100.0 * r.share, r.distance_m, r.angle_deg);
            format!("{percent:.1} % within {m} m and {deg}°")
        });
        text += &format!("\n{}\n", recall.collect::<Vec<_>>().join(", "));
    }
    let share = 100.0 * s.localized as f64 / s.images.max(1) as f64;
    text += &format!(
        "{} of {} localized ({share:.1} %), each right with a probability of {}; {} have more than 30 inliers",
        s.localized, s.images, s.min_probability, s.more_than_30_inliers
    );
    text
}
