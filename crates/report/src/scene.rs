//! A view of points and paths in space that can be turned.

use std::collections::BTreeMap;

use maud::{Markup, PreEscaped, html};

use super::layout::SERIES;
use super::plot::ink_css;

/// Points that a page carries at most; more cannot be told apart.
const MOST_POINTS: usize = 20_000;
/// Corners of a path that a page carries at most.
const MOST_CORNERS: usize = 3_000;
/// Steps from the middle of a scene to its border: coordinates are whole numbers of them.
const STEPS: f64 = 10_000.0;

/// Points and paths in one world, metres, z up.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// A map or a cloud; drawn thinned out.
    pub points: Vec<[f64; 3]>,
    /// Trajectories.
    pub paths: Vec<Path>,
}

/// A line through space.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    /// As the legend calls it.
    pub name: String,
    /// Which colour; paths that belong together have the same.
    pub series: usize,
    /// Whether this is what another path should be: drawn thin.
    pub is_truth: bool,
    /// Points in order, metres; nothing is drawn between two pieces.
    pub pieces: Vec<Vec<[f64; 3]>>,
}

impl Scene {
    /// `None` where there is no path and no point.
    pub fn draw(&self) -> Option<Markup> {
        let of_paths = self.paths.iter().flat_map(|p| p.pieces.iter().flatten());
        let (center, reach_m) = bounds(of_paths.chain(&self.points))?;
        let step_m = reach_m / STEPS;
        let whole = |point: &[f64; 3]| -> [i64; 3] {
            std::array::from_fn(|axis| ((point[axis] - center[axis]) / step_m).round() as i64)
        };
        let numbers = |points: &mut dyn Iterator<Item = [i64; 3]>| -> String {
            let words: Vec<String> = points.flatten().map(|n| n.to_string()).collect();
            format!("[{}]", words.join(","))
        };
        let points = thinned(&self.points, &center, reach_m);
        let cloud = numbers(&mut points.iter().map(whole));
        let paths: Vec<String> = self
            .paths
            .iter()
            .map(|path| {
                let all: usize = path.pieces.iter().map(Vec::len).sum();
                let step = all.div_ceil(MOST_CORNERS).max(1);
                let pieces = path.pieces.iter().map(|piece| {
                    let finite = piece.iter().filter(|p| is_finite(p));
                    numbers(&mut finite.step_by(step).map(whole))
                });
                let pieces: Vec<String> = pieces.filter(|p| p != "[]").collect();
                let ink = path.series % usize::from(SERIES);
                format!(
                    "{{\"ink\":{ink},\"truth\":{},\"pieces\":[{}]}}",
                    path.is_truth,
                    pieces.join(",")
                )
            })
            .collect();
        let data = format!(
            "{{\"step\":{step_m},\"cloud\":{cloud},\"paths\":[{}]}}",
            paths.join(",")
        );
        Some(html! {
            figure.scene {
                canvas tabindex="0" role="img" aria-label="map and trajectories in 3D" {}
                // Numbers alone: nothing in it can end the script.
                script type="application/json" { (PreEscaped(data)) }
                figcaption {
                    @for path in self.paths.iter().filter(|p| !p.is_truth) {
                        span.key { span.line style=(format!("border-color:{}", ink_css(path.series))) {} (path.name) }
                    }
                    @if self.paths.iter().any(|p| p.is_truth) { span.key { span.line.truth {} "truth" } }
                    span.key.hint { "drag to rotate, two fingers or Shift to move, Ctrl and wheel to zoom, double-click to reset" }
                }
            }
        })
    }
}

fn is_finite(point: &[f64; 3]) -> bool {
    point.iter().all(|v| v.is_finite())
}

/// Middle of all points but the outermost half percent on each side, and the largest distance along an axis from there that they
/// have: a stray point must not shrink the rest.
fn bounds<'a>(points: impl Iterator<Item = &'a [f64; 3]>) -> Option<([f64; 3], f64)> {
    let finite: Vec<&[f64; 3]> = points.filter(|p| is_finite(p)).collect();
    let ends = [0, 1, 2].map(|axis| {
        let mut values: Vec<f64> = finite.iter().map(|p| p[axis]).collect();
        values.sort_by(f64::total_cmp);
        let beyond = values.len() / 200;
        let low = values.get(beyond).copied();
        low.zip(values.iter().rev().nth(beyond).copied())
    });
    let mut center = [0.0; 3];
    let mut reach_m: f64 = 0.1;
    for (axis, end) in ends.into_iter().enumerate() {
        let (low, high) = end?;
        center[axis] = 0.5 * (low + high);
        reach_m = reach_m.max(0.5 * (high - low));
    }
    Some((center, 1.05 * reach_m))
}

/// One point per cell of a grid that is as fine as the page allows; those far outside are left out.
fn thinned(points: &[[f64; 3]], center: &[f64; 3], reach_m: f64) -> Vec<[f64; 3]> {
    let inside = |p: &&[f64; 3]| {
        let near = |axis: usize| (p[axis] - center[axis]).abs() <= 1.5 * reach_m;
        is_finite(p) && (0..3).all(near)
    };
    let inside: Vec<&[f64; 3]> = points.iter().filter(inside).collect();
    let mut cell_m = reach_m / 400.0;
    loop {
        let mut cells: BTreeMap<[i64; 3], [f64; 3]> = BTreeMap::new();
        for point in &inside {
            let cell = point.map(|v| (v / cell_m).floor() as i64);
            cells.entry(cell).or_insert(**point);
        }
        if cells.len() <= MOST_POINTS {
            return cells.into_values().collect();
        }
        cell_m *= 1.25;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sphere(count: usize) -> Vec<[f64; 3]> {
        let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
        (0..count)
            .map(|k| {
                let z = 1.0 - 2.0 * (k as f64 + 0.5) / count as f64;
                let (sine, cosine) = (golden * k as f64).sin_cos();
                let radius = (1.0 - z * z).sqrt();
                [5.0 * radius * cosine, 5.0 * radius * sine, 5.0 * z]
            })
            .collect()
    }

    #[test]
    fn a_large_scene_stays_small_on_the_page() {
        let scene = Scene {
            points: sphere(300_000),
            paths: vec![Path {
                name: "scanner".to_owned(),
                series: 0,
                is_truth: false,
                pieces: vec![sphere(100_000)],
            }],
        };
        let drawn = scene.draw().expect("points").into_string();
        assert!(drawn.len() < 500_000, "{} bytes", drawn.len());
        assert_eq!(drawn, scene.draw().expect("points").into_string());
    }

    #[test]
    fn what_is_nowhere_is_left_out() {
        assert!(Scene::default().draw().is_none());
        let scene = Scene {
            points: vec![[f64::NAN, 0.0, 0.0], [1.0, 2.0, f64::INFINITY]],
            paths: Vec::new(),
        };
        assert!(scene.draw().is_none());
        let mut points = sphere(1000);
        points.push([1e9, 0.0, 0.0]);
        let (center, reach_m) = bounds(points.iter()).expect("points");
        assert!(
            reach_m < 6.0 && center[0].abs() < 1.0,
            "{center:?} {reach_m}"
        );
    }
}
