//! `lsfb map view`: a map's points and keyframes, and the surface that the LiDAR saw, to look at.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use lsfb_eval::report::{Figure, Report};
use lsfb_geometry::{Se3, Trajectory, Vector2, Vector3};
use lsfb_pipeline::hd_map::HdMap;
use lsfb_pipeline::surface::SurfaceConfig;
use lsfb_recording::{Provenance, read_tum};
use lsfb_types::{Finding, Judgement, median, quantile};
use lsfb_view::{CameraPyramids, MapPoints, NamedTrajectory, ViewConfig, ViewInputs, write_rrd};

use super::map_coverage::coverage;
use super::map_report::track;
use super::map_surface::{check_source, insert_scans};
use crate::context::Context;
use crate::files;
use crate::judged::{Judged, printable, problem_lines};
use crate::outcome::Outcome;
use crate::pages;

/// Colours of the cameras, in order: distinguishable without red and green, and none of the points'.
const COLORS: [[u8; 3]; 4] = [
    [230, 159, 0],
    [86, 180, 233],
    [204, 121, 167],
    [0, 158, 115],
];
const KEYFRAMES: [u8; 3] = [240, 228, 66];
/// A point that is known well, and one that is known badly.
const WELL_KNOWN: [f64; 3] = [60.0, 110.0, 190.0];
const BADLY_KNOWN: [f64; 3] = [213.0, 94.0, 0.0];
const SURFACE: [u8; 3] = [130, 130, 130];
/// One point of the surface is shown in a cell so large, metres.
const SURFACE_CELL_M: f64 = 0.05;
/// More points than this the viewer does not turn smoothly: cells are doubled until there are fewer.
const MOST_SURFACE_POINTS: usize = 2_000_000;
/// Length of a pyramid in distances between neighbouring keyframes.
const PYRAMID_STEPS: f64 = 0.5;

/// View a map in the Rerun viewer and in a browser.
///
/// Shows points, keyframe images, and the surface from the LiDAR. Points are blue if they are at least
/// as accurate as the median point, and orange if they are as inaccurate as the worst 5 %. The page
/// works in any browser without a network; it shows a thinned version of the viewer's file. The surface
/// needs the scanner's recording and the trajectory that `lsfb map --out-trajectory` wrote with this
/// map.
///
/// Examples:
///   lsfb map view map --out map.rrd
///   lsfb map view map --recording scan.mcap --trajectory scan.tum --out map.rrd --out-report map.html
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct ViewArguments {
    /// The map.
    #[arg(value_name = "MAP")]
    map: PathBuf,
    /// Recording of the scanner, for the surface.
    #[arg(long, value_name = "MCAP", requires = "trajectory")]
    recording: Option<PathBuf>,
    /// Trajectory of the scanner in the map.
    #[arg(long, value_name = "TUM", requires = "recording")]
    trajectory: Option<PathBuf>,
    /// Rerun file to write.
    #[arg(long, value_name = "RRD")]
    out: PathBuf,
    /// Also write a page with the map in 3D.
    #[arg(long, value_name = "HTML")]
    out_report: Option<PathBuf>,
}

/// Does it.
pub fn view(arguments: &ViewArguments, context: &Context) -> anyhow::Result<Outcome> {
    let mut read: Vec<&Path> = vec![&arguments.map];
    read.extend(arguments.recording.as_deref());
    read.extend(arguments.trajectory.as_deref());
    context.claim(&arguments.out, &read)?;
    if let Some(page) = &arguments.out_report {
        context.claim(page, &read)?;
    }
    let map = super::open_map(&arguments.map)?;
    let seen = match (&arguments.recording, &arguments.trajectory) {
        (Some(recording), Some(trajectory)) => Some(surface(recording, trajectory, context)?),
        _ => None,
    };
    let (surface, agreement): (Vec<Vector3<f64>>, Vec<Finding>) = match seen {
        Some((points, finding)) => (points, vec![finding]),
        None => (Vec::new(), Vec::new()),
    };
    let mut judgement = map.checks();
    judgement.push(coverage(&map));
    agreement
        .into_iter()
        .for_each(|found| judgement.push(found));
    let keyframes = Trajectory::new(map.keyframes().collect());
    let cameras = pyramids(&map);
    let images: usize = cameras.iter().map(|camera| camera.strips_m.len()).sum();
    let inputs = ViewInputs {
        map: MapPoints {
            positions_m: map.positions().map(|p| p.cast::<f32>().into()).collect(),
            colors_rgb: colors(&map),
        },
        surface: MapPoints {
            positions_m: surface.iter().map(|p| p.cast::<f32>().into()).collect(),
            colors_rgb: vec![SURFACE; surface.len()],
        },
        cameras,
        trajectories: vec![NamedTrajectory {
            name: "keyframes".to_owned(),
            trajectory: keyframes.clone(),
            color_rgb: KEYFRAMES,
        }],
        ..ViewInputs::default()
    };
    write_rrd(&arguments.out, &inputs, &ViewConfig::default(), &|p| {
        context.show(p)
    })?;
    if let Some(page) = &arguments.out_report {
        let name = arguments.map.display().to_string();
        let mut made_from = Provenance::new(&());
        made_from.add_input(&arguments.map.join(HdMap::HEADER))?;
        let of_surface = [&arguments.recording, &arguments.trajectory];
        for path in of_surface.into_iter().flatten() {
            made_from.add_input(path)?;
        }
        let drawn = Report {
            provenance: pages::settings(&made_from),
            ..report(&name, &map, keyframes, &surface, &judgement)
        };
        files::write(page, drawn.to_html())?;
    }
    let summary = serde_json::json!({
        "points": map.point_count(),
        "images": images,
        "surface_points": surface.len(),
    });
    let name = printable(&arguments.map.display().to_string());
    context.print(&Judged::new(&judgement, &name, &summary), || {
        let out = arguments.out.display();
        let points = map.point_count();
        let seen = surface.len();
        let made = format!(
            "{out}: {points} points, {images} images, {seen} points of the LiDAR's surface"
        );
        format!("{made}\n{}", problem_lines(&judgement))
            .trim_end()
            .to_owned()
    })?;
    Ok(Outcome::of(judgement.verdict()))
}

/// By how well each point is known, from that of half of the map to that of 95 %.
fn colors(map: &HdMap) -> Vec<[u8; 3]> {
    let points = 0..map.point_count() as u32;
    let sigmas: Vec<f64> = points
        .filter_map(|p| Some(map.quality(p)?.worst_sigma_m()))
        .collect();
    let finite = || sigmas.iter().copied().filter(|s| s.is_finite()).collect();
    let low = median(finite()).unwrap_or(0.0);
    let high = quantile(finite(), 0.95).unwrap_or(low).max(low);
    let color = |sigma: &f64| {
        let share = match high > low {
            true => ((sigma - low) / (high - low)).clamp(0.0, 1.0),
            false => f64::from(u8::from(*sigma > high)),
        };
        let mix = |k: usize| WELL_KNOWN[k] + (BADLY_KNOWN[k] - WELL_KNOWN[k]) * share;
        [0, 1, 2].map(|k| mix(k) as u8)
    };
    sigmas.iter().map(color).collect()
}

/// The images that saw a point, by camera.
fn pyramids(map: &HdMap) -> Vec<CameraPyramids> {
    let all = (0..map.point_count() as u32).flat_map(|p| map.observations(p));
    let images: BTreeSet<(u16, u32)> = all.map(|o| (o.camera, o.keyframe)).collect();
    let places = map.keyframes().map(|k| k.world_from_rig.translation);
    let places: Vec<Vector3<f64>> = places.collect();
    let steps = places.windows(2).map(|pair| (pair[1] - pair[0]).norm());
    let moved = steps.filter(|step| *step > 0.0).collect();
    let length = PYRAMID_STEPS * median(moved).unwrap_or(1.0);
    let named = (0..).zip(map.cameras());
    named
        .filter_map(|(number, name): (u16, &String)| {
            let mounted = map.rig().cameras.get(name)?;
            let (width, height) = (mounted.camera.width, mounted.camera.height);
            let [right, bottom] = [width, height].map(|side| f64::from(side) - 1.0);
            let corners = [[0.0, 0.0], [right, 0.0], [right, bottom], [0.0, bottom]];
            // Corners of wide images may show nothing: their pyramid is that of what does.
            let rays: Vec<Vector3<f64>> = corners
                .iter()
                .filter_map(|corner| mounted.camera.unproject(&Vector2::from(*corner)))
                .filter_map(|ray| ray.try_normalize(0.0))
                .collect();
            let of_camera = images.iter().filter(|(camera, _)| *camera == number);
            let strips = of_camera.filter_map(|(_, keyframe)| {
                let pose = map.keyframe(*keyframe)?.world_from_rig * mounted.rig_from_camera;
                Some(strip(&pose, &rays, length))
            });
            Some(CameraPyramids {
                name: name.clone(),
                strips_m: strips.collect(),
                color_rgb: COLORS[usize::from(number) % COLORS.len()],
            })
        })
        .collect()
}

/// Around the base, with a way to the tip and back at each corner.
fn strip(world_from_camera: &Se3, rays: &[Vector3<f64>], length: f64) -> Vec<[f32; 3]> {
    let at = |point: Vector3<f64>| (*world_from_camera * point).cast::<f32>().into();
    let tip = at(Vector3::zeros());
    let around = rays.iter().chain(rays.first());
    let corners = around.flat_map(|ray| [at(*ray * length), tip, at(*ray * length)]);
    std::iter::once(tip).chain(corners).collect()
}

/// What the LiDAR saw, one point a cell, and whether its scans agree at the poses of the trajectory.
fn surface(
    recording: &Path,
    trajectory: &Path,
    context: &Context,
) -> anyhow::Result<(Vec<Vector3<f64>>, Finding)> {
    check_source(trajectory, recording)?;
    let opened = context.open(recording)?;
    let world_from_rig = read_tum(trajectory)?;
    let config = SurfaceConfig::default();
    let (builder, _) = insert_scans(recording, &opened, &world_from_rig, &config, context)?;
    let mut cells = Cells::new();
    builder.points_m().for_each(|point| cells.insert(point));
    Ok((cells.points, builder.finish().agreement().finding()))
}

/// The first point of each cell.
struct Cells {
    cell_m: f64,
    taken: BTreeSet<[i32; 3]>,
    points: Vec<Vector3<f64>>,
}

impl Cells {
    fn new() -> Self {
        Self {
            cell_m: SURFACE_CELL_M,
            taken: BTreeSet::new(),
            points: Vec::new(),
        }
    }

    fn insert(&mut self, point: Vector3<f64>) {
        let cell = [0, 1, 2].map(|axis| (point[axis] / self.cell_m).floor() as i32);
        if !self.taken.insert(cell) {
            return;
        }
        self.points.push(point);
        if self.points.len() > MOST_SURFACE_POINTS {
            let points = std::mem::take(&mut self.points);
            self.taken.clear();
            self.cell_m *= 2.0;
            points.into_iter().for_each(|point| self.insert(point));
        }
    }
}

/// What the page shows.
fn report(
    name: &str,
    map: &HdMap,
    keyframes: Trajectory,
    surface: &[Vector3<f64>],
    judgement: &Judgement,
) -> Report {
    let quality: Vec<_> = (0..map.point_count() as u32)
        .filter_map(|p| map.quality(p))
        .collect();
    let sigmas = quality.iter().map(|q| q.worst_sigma_m());
    let sigma_m = median(sigmas.collect()).unwrap_or(f64::INFINITY);
    let errors = quality.iter().map(|q| q.reprojection_rms_px);
    let error_px = median(errors.collect()).unwrap_or(f64::INFINITY);
    let count = |name: &str, value: usize| Figure::new(name, value as f64, "");
    Report {
        title: format!("Map {name}"),
        figures: vec![
            count("map points", map.point_count()),
            count("keyframes", map.keyframe_count()),
            count("observations", map.observation_count()),
            count("descriptors", map.descriptor_count()),
            count("points of the LiDAR's surface", surface.len()),
            Figure::new("reprojection error of a point, median", error_px, "px"),
            Figure::new(
                "σ of a point in the worst direction, median",
                sigma_m * 1e2,
                "cm",
            ),
        ],
        map_points: map.positions().chain(surface.iter().copied()).collect(),
        tracks: vec![track("keyframes", keyframes.poses().to_vec())],
        findings: judgement.findings().to_vec(),
        ..Report::default()
    }
}
