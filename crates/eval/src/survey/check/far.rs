//! Marks without a rest in reach that the device rested on all the same: the trajectory is off there by more than the reach, and an error
//! of the marks that fit alone would be the smaller the more it is bent.

use lsfb_geometry::{Vector2, Vector3};

use super::{Order, Pairs};

/// A place and the rest that is its own.
pub(super) struct Far {
    pub place: usize,
    pub rest: usize,
    pub distance_m: f64,
}

/// For each place without a rest the nearest of those that are no other place's, within `most_m`, metres; where the order is known, of those
/// between the rests of its neighbours. No rest is taken twice: the nearest pairs come first.
pub(super) fn marks(
    places: &[Vector2<f64>],
    rests: &[Vector3<f64>],
    pairs: &Pairs,
    order: Order,
    most_m: f64,
) -> Vec<Far> {
    let is_between = |rest: usize, place: usize| {
        let is_in_order = |(i, k): &(usize, usize)| (*i < rest) == (*k < place);
        order == Order::Unknown || pairs.iter().all(is_in_order)
    };
    let is_free = |rest: &usize| pairs.iter().all(|(i, _)| i != rest);
    let is_missing = |place: &usize| pairs.iter().all(|(_, k)| k != place);
    let mut candidates: Vec<Far> = Vec::new();
    for place in (0..places.len()).filter(is_missing) {
        for rest in (0..rests.len()).filter(is_free) {
            let distance_m = (rests[rest].xy() - places[place]).norm();
            if distance_m <= most_m && is_between(rest, place) {
                candidates.push(Far {
                    place,
                    rest,
                    distance_m,
                });
            }
        }
    }
    candidates.sort_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
    let mut found: Vec<Far> = Vec::new();
    for far in candidates {
        if found
            .iter()
            .all(|f| f.place != far.place && f.rest != far.rest)
        {
            found.push(far);
        }
    }
    found.sort_by_key(|far| far.place);
    found
}
