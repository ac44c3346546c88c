//! The survey as a whole: Eq. (6) of the paper, from the distances to the marks.

use lsfb_geometry::Vector2;

use super::adjustment::adjust;
use super::file::{Survey, Tape, TapeKind};
use super::initial::{Edge, mirrored, places};
use super::observation::{Observation, Quantity};
use super::snooping;
use super::solution::SurveySolution;
use crate::Error;

/// A second place of a mark counts where it fits about as well: by this much of the sum of weighted squares.
const SAME_FIT: f64 = 4.0;

/// Computes the marks, names blunders and leaves them out.
pub fn solve_survey(survey: &Survey) -> Result<SurveySolution, Error> {
    let names = survey.marks();
    let observations = observations(survey, &names);
    let start = places(&names, &edges(survey, &names))?;
    let start = best_sides(&names, &observations, start)?;
    snooping::without_blunders(&names, &observations, start)
}

fn index(names: &[&str], name: &str) -> usize {
    // Every end of a tape is one of the names.
    names.iter().position(|n| *n == name).unwrap_or_default()
}

fn edges(survey: &Survey, names: &[&str]) -> Vec<Edge> {
    let edge = |tape: &Tape| Edge {
        kind: tape.kind,
        ends: [index(names, &tape.ends[0]), index(names, &tape.ends[1])],
        distance_m: tape.distance_m,
    };
    survey.tapes.iter().map(edge).collect()
}

fn observations(survey: &Survey, names: &[&str]) -> Vec<Observation> {
    let mut all = Vec::new();
    for (tape, (edge, read)) in edges(survey, names).iter().zip(&survey.tapes).enumerate() {
        let mut add = |quantity, sigma_m| {
            all.push(Observation {
                quantity,
                ends: edge.ends,
                sigma_m,
                tape,
            });
        };
        add(Quantity::Distance(read.distance_m), read.sigma_m);
        match read.kind {
            TapeKind::Horizontal => add(Quantity::SameY, survey.line_sigma_m),
            TapeKind::Vertical => add(Quantity::SameX, survey.line_sigma_m),
            TapeKind::Free => {}
        }
    }
    all
}

/// Marks that only free distances place may lie on either side: the side that fits, or an error where both do.
fn best_sides(
    names: &[&str],
    observations: &[Observation],
    start: Vec<Vector2<f64>>,
) -> Result<Vec<Vector2<f64>>, Error> {
    let mut best = adjust(names, observations, &start)?;
    for mark in 0..names.len() {
        let own = || observations.iter().filter(|o| o.ends.contains(&mark));
        let is_free = own().all(|o| matches!(o.quantity, Quantity::Distance(_)));
        let neighbours: Vec<Vector2<f64>> = own()
            .map(|o| best.places[o.ends[usize::from(o.ends[0] == mark)]])
            .collect();
        // In a triangle alone the side is a matter of how one looks at it.
        let is_open = is_free && names.len() > 3 && best.places[mark] != Vector2::zeros();
        let Some(other) = mirrored(&best.places[mark], &neighbours).filter(|_| is_open) else {
            continue;
        };
        let mut flipped = best.places.clone();
        if (other - flipped[mark]).norm() < 1e-3 {
            continue;
        }
        flipped[mark] = other;
        let Ok(flipped) = adjust(names, observations, &flipped) else {
            continue;
        };
        let moved_m = (flipped.places[mark] - best.places[mark]).norm();
        if flipped.cost() < best.cost() - SAME_FIT {
            best = flipped;
        } else if flipped.cost() < best.cost() + SAME_FIT && moved_m > 0.01 {
            return Err(Error::TwoPlaces {
                mark: names[mark].to_owned(),
                apart_m: moved_m,
            });
        }
    }
    Ok(best.places)
}

#[cfg(test)]
mod tests;
