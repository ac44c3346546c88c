//! One pose out of several guesses of it.

use lsfb_geometry::Se3;

/// Of several guesses of one pose the one that agrees best with the others.
pub(crate) fn most_central(candidates: &[Se3]) -> Option<Se3> {
    let distance = |a: &Se3, b: &Se3| (a.inverse() * *b).log().norm();
    let cost = |a: &Se3| candidates.iter().map(|b| distance(a, b)).sum::<f64>();
    candidates
        .iter()
        .map(|c| (cost(c), c))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|c| *c.1)
}

/// Median distance of guesses of one pose from the one that agrees best with the others.
pub(super) fn spread(candidates: &[Se3]) -> f64 {
    let Some(central) = most_central(candidates) else {
        return f64::INFINITY;
    };
    let distance = |c: &Se3| (central.inverse() * *c).log().norm();
    let mut distances: Vec<f64> = candidates.iter().map(distance).collect();
    distances.sort_by(f64::total_cmp);
    distances[distances.len() / 2]
}
