//! Map and trajectories in a plane, metres the same length on both axes.

use std::collections::BTreeMap;

use lsfb_geometry::{StampedPose, Trajectory, Vector3};
use lsfb_report::{Ink, Layer, Plot, SHADES};
use maud::Markup;

use super::equal_scale::equal_scale;
use super::{Inset, Report, View, break_secs};

/// More dots cannot be told apart, and make the page heavy.
const MAX_DOTS: usize = 5_000;

/// A drawn top view.
pub(super) struct TopView {
    pub drawing: Markup,
    /// What is drawn.
    pub plot: Plot,
    /// Lowest and highest map point drawn; absent without a map.
    pub heights_m: Option<[f64; 2]>,
    /// Where the axes of the plane are not x and y: their names.
    pub plane: Option<String>,
}

/// Which coordinates the plane shows.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Plane {
    right: usize,
    up: usize,
}

const ABOVE: Plane = Plane { right: 0, up: 1 };

impl Plane {
    fn of(report: &Report) -> Self {
        if report.view == View::Above {
            return ABOVE;
        }
        let extent = |axis: usize| {
            let values = report
                .tracks
                .iter()
                .flat_map(|t| {
                    t.estimate
                        .poses()
                        .iter()
                        .chain(t.truth.iter().flat_map(|t| t.poses()))
                })
                .map(|p| p.world_from_rig.translation[axis]);
            let (low, high) = values.fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
            high - low
        };
        let [x, y, z] = [extent(0), extent(1), extent(2)];
        if z <= x && z <= y {
            ABOVE
        } else if y <= x {
            Self { right: 0, up: 2 }
        } else {
            Self { right: 1, up: 2 }
        }
    }

    fn point(self, p: &Vector3<f64>) -> (f64, f64) {
        (p[self.right], p[self.up])
    }

    fn path(self, poses: &[StampedPose]) -> impl Iterator<Item = (f64, f64)> {
        poses
            .iter()
            .map(move |p| self.point(&p.world_from_rig.translation))
            .filter(|(right, up)| right.is_finite() && up.is_finite())
    }
}

fn axis_name(axis: usize) -> &'static str {
    ["x", "y", "z"][axis.min(2)]
}

/// `None` where there is neither map nor trajectory.
pub(super) fn draw(report: &Report) -> Option<TopView> {
    let plane = Plane::of(report);
    let bounds = Bounds::of(report, plane)?;
    let dots = thinned(&report.map_points, plane, bounds);
    let heights_m = height_range(&dots);
    let mut plot = drawn(report, plane, bounds, &dots, heights_m);
    if plane == ABOVE {
        plot.layers.extend(report.insets.iter().flat_map(outline));
    }
    Some(TopView {
        drawing: plot.draw(),
        heights_m,
        plane: (plane != ABOVE)
            .then(|| format!("{} and {}", axis_name(plane.right), axis_name(plane.up))),
        plot,
    })
}

/// The insets with their names, in the shades of the whole.
pub(super) fn draw_insets(report: &Report) -> Vec<(String, Plot)> {
    let plane = Plane::of(report);
    let Some(bounds) = Bounds::of(report, plane).filter(|_| plane == ABOVE) else {
        return Vec::new();
    };
    let heights_m = height_range(&thinned(&report.map_points, plane, bounds));
    let insets = report.insets.iter().map(|inset| {
        let [x, y] = inset.ranges();
        let bounds = Bounds { x, y };
        let dots = thinned(&report.map_points, plane, bounds);
        let plot = drawn(report, plane, bounds, &dots, heights_m);
        (inset.name.clone(), plot)
    });
    insets.collect()
}

/// Around a square, dashed, with its name at the corner.
fn outline(inset: &Inset) -> [Layer; 2] {
    let [[left, right], [low, high]] = inset.ranges();
    let corners = [
        [left, low],
        [right, low],
        [right, high],
        [left, high],
        [left, low],
    ];
    [
        Layer::Line {
            points: corners.to_vec(),
            ink: Ink::Truth,
            width_px: 1.2,
        },
        Layer::Names {
            names: vec![([right, high], inset.name.clone())],
        },
    ]
}

/// Map points and trajectories within bounds.
fn drawn(
    report: &Report,
    plane: Plane,
    bounds: Bounds,
    dots: &[Vector3<f64>],
    heights_m: Option<[f64; 2]>,
) -> Plot {
    let mut layers: Vec<Layer> = (0..SHADES)
        .map(|own| {
            let of_shade = dots.iter().filter(|dot| shade(dot.z, heights_m) == own);
            Layer::Dots {
                points: of_shade.map(|dot| plane.point(dot).into()).collect(),
                ink: Ink::Shade(own),
                radius_px: 1.0,
            }
        })
        .collect();
    for (i, track) in report.tracks.iter().enumerate() {
        let ink = Ink::Series(track.series.unwrap_or(i));
        layers.extend(path(plane, bounds, &track.estimate, ink, 2.2));
    }
    for (i, track) in report.tracks.iter().enumerate() {
        let truth = track.truth.iter();
        layers.extend(truth.flat_map(|truth| path(plane, bounds, truth, Ink::Truth, 1.0)));
        let start = plane.path(track.estimate.poses()).next();
        let start = start.filter(|at| bounds.contains(*at));
        layers.push(Layer::Dots {
            points: start.map(<[f64; 2]>::from).into_iter().collect(),
            ink: Ink::Series(track.series.unwrap_or(i)),
            radius_px: 5.0,
        });
    }
    Plot {
        layers,
        ..frame(plane, bounds)
    }
}

/// A trajectory in the plane, apart where nothing is known for a while, and where it leaves the bounds.
fn path(
    plane: Plane,
    bounds: Bounds,
    trajectory: &Trajectory,
    ink: Ink,
    width_px: f64,
) -> Vec<Layer> {
    let poses = trajectory.poses();
    let longest_secs = break_secs(poses);
    let is_inside = |p: &StampedPose| bounds.contains(plane.point(&p.world_from_rig.translation));
    let pieces = poses
        .chunk_by(|a, b| b.time.secs_since(a.time) <= longest_secs && is_inside(a) == is_inside(b));
    let pieces = pieces.filter(|piece| piece.first().is_some_and(is_inside));
    let line = |piece| Layer::Line {
        points: plane.path(piece).map(<[f64; 2]>::from).collect(),
        ink,
        width_px,
    };
    pieces.map(line).collect()
}

#[derive(Clone, Copy)]
struct Bounds {
    x: [f64; 2],
    y: [f64; 2],
}

impl Bounds {
    /// All of the trajectories, and the map but for its outermost half percent: a stray point must not shrink the rest.
    fn of(report: &Report, plane: Plane) -> Option<Self> {
        let tracks = report.tracks.iter().flat_map(|t| {
            let truth = t.truth.iter().flat_map(|truth| plane.path(truth.poses()));
            plane.path(t.estimate.poses()).chain(truth)
        });
        let (mut xs, mut ys): (Vec<f64>, Vec<f64>) = tracks.unzip();
        let map = |axis: usize| {
            let mut values: Vec<f64> = report
                .map_points
                .iter()
                .map(|p| p[axis])
                .filter(|v| v.is_finite())
                .collect();
            values.sort_by(f64::total_cmp);
            let beyond = values.len() / 200;
            values.drain(..beyond);
            values.truncate(values.len() - beyond.min(values.len()));
            values
        };
        xs.extend(map(plane.right));
        ys.extend(map(plane.up));
        let range = |values: &[f64]| {
            let low = values.iter().copied().reduce(f64::min)?;
            let high = values.iter().copied().reduce(f64::max)?;
            let edge = 0.03 * (high - low) + 0.05;
            Some([low - edge, high + edge])
        };
        Some(Self {
            x: range(&xs)?,
            y: range(&ys)?,
        })
    }

    fn contains(&self, (x, y): (f64, f64)) -> bool {
        (self.x[0]..=self.x[1]).contains(&x) && (self.y[0]..=self.y[1]).contains(&y)
    }
}

/// An empty plot of equal scale.
fn frame(plane: Plane, bounds: Bounds) -> Plot {
    let label = |axis: usize| format!("{} (m)", axis_name(axis));
    equal_scale(
        "map and trajectories",
        [label(plane.right), label(plane.up)],
        [bounds.x, bounds.y],
    )
}

/// One point, the highest, of each cell of a grid that is as fine as [`MAX_DOTS`] allows.
fn thinned(points: &[Vector3<f64>], plane: Plane, bounds: Bounds) -> Vec<Vector3<f64>> {
    let inside: Vec<&Vector3<f64>> = points
        .iter()
        .filter(|p| p.iter().all(|v| v.is_finite()) && bounds.contains(plane.point(p)))
        .collect();
    let mut cell_m = (bounds.x[1] - bounds.x[0]).max(bounds.y[1] - bounds.y[0]) / 600.0;
    loop {
        let mut cells: BTreeMap<(i64, i64), Vector3<f64>> = BTreeMap::new();
        for p in &inside {
            let (x, y) = plane.point(p);
            let cell = ((x / cell_m).floor() as i64, (y / cell_m).floor() as i64);
            let kept = cells.entry(cell).or_insert(**p);
            if p.z > kept.z {
                *kept = **p;
            }
        }
        if cells.len() <= MAX_DOTS {
            return cells.into_values().collect();
        }
        cell_m *= 1.25;
    }
}

fn height_range(points: &[Vector3<f64>]) -> Option<[f64; 2]> {
    let low = points.iter().map(|p| p.z).reduce(f64::min)?;
    let high = points.iter().map(|p| p.z).reduce(f64::max)?;
    Some([low, high])
}

fn shade(height_m: f64, heights_m: Option<[f64; 2]>) -> u8 {
    let Some([low, high]) = heights_m else {
        return 0;
    };
    let place = (height_m - low) / (high - low).max(1e-9);
    ((place * f64::from(SHADES)) as u8).min(SHADES - 1)
}
