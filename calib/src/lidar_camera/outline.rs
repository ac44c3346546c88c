//! The outline of a board in the LiDAR: between the last ray that meets it and the next one that does not.

use std::f64::consts::PI;

use lsfb_geometry::{Vector2, Vector3};
use lsfb_solver::gauss_newton::{NormalEquations, minimise, until_shorter_than};
use nalgebra::Rotation3;

use super::LidarCameraConfig;
use super::plane::{Chord, Plane};
use super::scan_grid::{Direction, NEIGHBOR_STEPS, Ring};

/// A place on the outline: known in direction, its distance is the plane's.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    /// Unit ray half-way between the last return and the next ray.
    pub ray: Vector3<f64>,
    /// Way from the last return to the next ray, on the plane, metres: the outline crosses it somewhere.
    pub stride_m: Vector3<f64>,
}

/// A rectangle on a plane.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rectangle {
    /// Middle, on the plane's axes.
    pub center: Vector2<f64>,
    /// Unit vector along the longer side, on the plane's axes.
    pub along: Vector2<f64>,
    /// Longer and shorter side, metres.
    pub size_m: [f64; 2],
}

/// Both ends of a run, where nothing nearer hides them.
pub(super) fn ends<'a>(
    ring: &'a Ring,
    run: &'a [usize],
    plane: &'a Plane,
    config: &'a LidarCameraConfig,
) -> impl Iterator<Item = Edge> + 'a {
    let ends = [
        (run.last(), Direction::Forward),
        (run.first(), Direction::Backward),
    ];
    ends.into_iter().filter_map(move |(end, direction)| {
        let at = *end?;
        let (next, turn) = ring.neighbor(at, direction);
        // There the scan ends, not the board.
        if ring.is_seam(at, next) {
            return None;
        }
        let beyond = &ring.points[next];
        let last = &ring.points[at];
        // The outline lies before the next ray that returned from elsewhere; rays between were lost.
        let mut steps = 1.0;
        if turn < NEIGHBOR_STEPS * ring.step_rad {
            let there = plane.meet(&(beyond.position / beyond.range_m))?;
            // Something in front of the board ends the run, not the board itself.
            if beyond.range_m < there.norm() - config.jump_m.min(0.1) {
                return None;
            }
            steps = (turn / ring.step_rad).round().max(1.0);
        }
        let direction_of = |steps: f64| {
            let turn = Rotation3::from_axis_angle(
                &Vector3::z_axis(),
                direction.sign() * steps * ring.step_rad,
            );
            turn * (last.position / last.range_m)
        };
        let stride_m = plane.meet(&direction_of(steps))? - plane.meet(&direction_of(0.0))?;
        Some(Edge {
            ray: direction_of(0.5 * steps),
            stride_m,
        })
    })
}

/// The rectangle of least area around the edges; points of the chords are within it.
pub(super) fn rectangle(plane: &Plane, chords: &[Chord], edges: &[Edge]) -> Option<Rectangle> {
    const STEPS: usize = 90;
    let places: Vec<Vector2<f64>> = edges
        .iter()
        .filter_map(|e| Some(plane.local(&plane.meet(&e.ray)?).xy()))
        .collect();
    if places.len() < 8 || chords.is_empty() {
        return None;
    }
    // A pole or a hand adds a few places outside: the outermost of each side do not count.
    let skip = places.len() / 40;
    let extent = |along: &Vector2<f64>| {
        let mut at: Vec<f64> = places.iter().map(|p| p.dot(along)).collect();
        at.sort_by(f64::total_cmp);
        (at[skip], at[at.len() - 1 - skip])
    };
    let at_angle = |angle: f64| {
        let along = Vector2::new(angle.cos(), angle.sin());
        let across = Vector2::new(-along.y, along.x);
        let ((a, b), (c, d)) = (extent(&along), extent(&across));
        (along, across, [a, b], [c, d])
    };
    let area = |angle: f64| {
        let (_, _, [a, b], [c, d]) = at_angle(angle);
        (b - a) * (d - c)
    };
    let best = (0..STEPS)
        .map(|k| 0.5 * PI * k as f64 / STEPS as f64)
        .min_by(|a, b| area(*a).total_cmp(&area(*b)))?;
    let (along, across, [a, b], [c, d]) = at_angle(best);
    let center = along * (0.5 * (a + b)) + across * (0.5 * (c + d));
    let size = [b - a, d - c];
    Some(if size[0] >= size[1] {
        Rectangle {
            center,
            along,
            size_m: size,
        }
    } else {
        Rectangle {
            center,
            along: across,
            size_m: [size[1], size[0]],
        }
    })
}

/// The parts of chords that lie within a rectangle.
pub(super) fn within(plane: &Plane, chords: Vec<Chord>, rectangle: &Rectangle) -> Vec<Chord> {
    const MARGIN_M: f64 = 0.01;
    let across = Vector2::new(-rectangle.along.y, rectangle.along.x);
    chords
        .into_iter()
        .filter_map(|mut chord| {
            let is_within = |p: &Vector3<f64>| {
                let d = plane.local(p).xy() - rectangle.center;
                d.dot(&rectangle.along).abs() < 0.5 * rectangle.size_m[0] + MARGIN_M
                    && d.dot(&across).abs() < 0.5 * rectangle.size_m[1] + MARGIN_M
            };
            let returns = chord.points.into_iter().zip(chord.intensities);
            (chord.points, chord.intensities) = returns.filter(|(p, _)| is_within(p)).unzip();
            (!chord.points.is_empty()).then_some(chord)
        })
        .collect()
}

/// A rectangle of known size fitted to the edges alone: its middle and its longer side. What the LiDAR by itself says.
pub(super) fn fitted(
    plane: &Plane,
    edges: &[Edge],
    start: &Rectangle,
    size_m: [f64; 2],
) -> Rectangle {
    /// Error at which an edge's weight is halved, metres.
    const SCALE_M: f64 = 0.015;
    let places: Vec<Vector2<f64>> = edges
        .iter()
        .filter_map(|e| Some(plane.local(&plane.meet(&e.ray)?).xy()))
        .collect();
    let at = |unknowns: &Vector3<f64>| {
        let (sine, cosine) = unknowns.z.sin_cos();
        Rectangle {
            center: unknowns.xy(),
            along: Vector2::new(cosine, sine),
            size_m,
        }
    };
    // The middle, then the angle of the longer side.
    let terms = |unknowns: &Vector3<f64>| {
        let now = at(unknowns);
        let across = Vector2::new(-now.along.y, now.along.x);
        let mut terms = NormalEquations::<3>::default();
        // A trace of stiffness, so that a side without edges does not fly away.
        terms.information.fill_diagonal(1e-3 / (SCALE_M * SCALE_M));
        for place in &places {
            let d = place - now.center;
            let at = Vector2::new(d.dot(&now.along), d.dot(&across));
            let (side, error) = nearest_side(&at, size_m);
            let outward = now.along * side.x + across * side.y;
            // Turning by φ moves a place at p, seen from the rectangle, by φ (p.y, −p.x).
            let row = Vector3::new(-outward.x, -outward.y, side.x * at.y - side.y * at.x);
            let weight = 1.0 / (1.0 + (error / SCALE_M).powi(2)) / (SCALE_M * SCALE_M);
            terms.add(error, &row, weight);
        }
        Some(terms)
    };
    let angle = start.along.y.atan2(start.along.x);
    let unknowns = Vector3::new(start.center.x, start.center.y, angle);
    let found = minimise(unknowns, 30, terms, until_shorter_than(1e-7));
    at(&found.map_or(unknowns, |f| f.value))
}

/// Outward normal of the side that is nearest to a place, and how far outside of it the place is.
pub(super) fn nearest_side(at: &Vector2<f64>, size_m: [f64; 2]) -> (Vector2<f64>, f64) {
    let excess = Vector2::new(at.x.abs() - 0.5 * size_m[0], at.y.abs() - 0.5 * size_m[1]);
    if excess.x.abs() < excess.y.abs() {
        (Vector2::new(at.x.signum(), 0.0), excess.x)
    } else {
        (Vector2::new(0.0, at.y.signum()), excess.y)
    }
}
