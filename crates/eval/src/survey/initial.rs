//! Where marks are before the adjustment: along lines from mark to mark, then where circles meet.

use lsfb_geometry::Vector2;

use super::file::TapeKind;
use crate::Error;

/// A distance between two marks, by their indices.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    pub kind: TapeKind,
    pub ends: [usize; 2],
    pub distance_m: f64,
}

/// A place for every mark. The first mark of the first line, or of the first distance, is the origin; without lines the second lies on
/// +x, and of two mirrored places the left one is taken where nothing decides.
pub(super) fn places(names: &[&str], edges: &[Edge]) -> Result<Vec<Vector2<f64>>, Error> {
    let mut places: Vec<Option<Vector2<f64>>> = vec![None; names.len()];
    let is_line = |edge: &&Edge| edge.kind != TapeKind::Free;
    let first_line = edges.iter().find(is_line);
    let Some(first) = first_line.or(edges.first()) else {
        return Ok(Vec::new());
    };
    places[first.ends[0]] = Some(Vector2::zeros());
    if first_line.is_none() {
        places[first.ends[1]] = Some(Vector2::new(first.distance_m, 0.0));
    }
    while places.iter().any(Option::is_none) {
        let placed = along_a_line(edges, &places).or_else(|| where_circles_meet(edges, &places));
        let Some((mark, place)) = placed else {
            let open = places.iter().position(Option::is_none);
            let open = open.and_then(|i| names.get(i)).copied().unwrap_or_default();
            return Err(Error::UndeterminedMark {
                mark: open.to_owned(),
            });
        };
        places[mark] = Some(place);
    }
    Ok(places.into_iter().flatten().collect())
}

/// A mark at the other end of a horizontal or vertical distance from one that is placed.
fn along_a_line(edges: &[Edge], places: &[Option<Vector2<f64>>]) -> Option<(usize, Vector2<f64>)> {
    edges.iter().find_map(|edge| {
        let step = match edge.kind {
            TapeKind::Horizontal => Vector2::new(edge.distance_m, 0.0),
            TapeKind::Vertical => Vector2::new(0.0, edge.distance_m),
            TapeKind::Free => return None,
        };
        let [a, b] = edge.ends;
        match (places[a], places[b]) {
            (Some(from), None) => Some((b, from + step)),
            (None, Some(to)) => Some((a, to - step)),
            _ => None,
        }
    })
}

/// A mark with distances to two that are placed, by the pair that fixes it best, on the side that other distances favour.
fn where_circles_meet(
    edges: &[Edge],
    places: &[Option<Vector2<f64>>],
) -> Option<(usize, Vector2<f64>)> {
    let open = (0..places.len()).filter(|mark| places[*mark].is_none());
    let mut best: Option<(f64, usize, Vector2<f64>)> = None;
    for mark in open {
        let circles: Vec<(Vector2<f64>, f64)> = edges
            .iter()
            .filter_map(|edge| {
                let other = edge.ends[usize::from(edge.ends[0] == mark)];
                let centre = edge.ends.contains(&mark).then(|| places[other]).flatten()?;
                Some((centre, edge.distance_m))
            })
            .collect();
        for (i, (a, to_a)) in circles.iter().enumerate() {
            for (b, to_b) in &circles[i + 1..] {
                let base = (b - a).norm();
                if base < 1e-6 {
                    continue;
                }
                let along = (to_a * to_a - to_b * to_b + base * base) / (2.0 * base);
                let aside = (to_a * to_a - along * along).max(0.0).sqrt();
                let axis = (b - a) / base;
                let across = Vector2::new(-axis.y, axis.x);
                let squared_residuals = |place: &Vector2<f64>| {
                    let off = circles
                        .iter()
                        .map(|(centre, r)| ((place - centre).norm() - r).powi(2));
                    off.sum::<f64>()
                };
                let (left, right) = (
                    a + axis * along + across * aside,
                    a + axis * along - across * aside,
                );
                let place = if squared_residuals(&right) < squared_residuals(&left) {
                    right
                } else {
                    left
                };
                let area = aside * base;
                if best.is_none_or(|(most, ..)| area > most) {
                    best = Some((area, mark, place));
                }
            }
        }
    }
    best.map(|(_, mark, place)| (mark, place))
}

/// A place mirrored on the line through the two most distant others.
pub(super) fn mirrored(place: &Vector2<f64>, others: &[Vector2<f64>]) -> Option<Vector2<f64>> {
    let mut far: Option<(f64, Vector2<f64>, Vector2<f64>)> = None;
    for (i, a) in others.iter().enumerate() {
        for b in &others[i + 1..] {
            let apart = (b - a).norm();
            if apart > far.map_or(1e-6, |(most, ..)| most) {
                far = Some((apart, *a, *b));
            }
        }
    }
    let (apart, a, b) = far?;
    let axis = (b - a) / apart;
    let from = place - a;
    Some(a + axis * (2.0 * axis.dot(&from)) - from)
}
