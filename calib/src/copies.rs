//! Images that are there more than once: each copy looks like one more measurement, standard deviations shrink by it, and views that are held
//! back are met as well as those adjusted. No camera sees the same corners twice to the last bit of their places.

use std::collections::BTreeMap;

use lsfb_types::{Finding, Limit, Verdict};

use crate::detect::Corner;

/// Which of these views are copies, each with the first that it is a copy of.
pub(crate) fn copies<'a, K: Copy>(
    views: impl IntoIterator<Item = (K, &'a [Corner])>,
) -> Vec<(K, K)> {
    let mut first_of: BTreeMap<Vec<(usize, [u64; 2])>, K> = BTreeMap::new();
    let mut copies = Vec::new();
    for (view, corners) in views {
        if corners.is_empty() {
            continue;
        }
        let places = corners.iter();
        let places = places.map(|c| (c.index, [c.pixel.x.to_bits(), c.pixel.y.to_bits()]));
        let mut places: Vec<_> = places.collect();
        places.sort_unstable();
        match first_of.get(&places) {
            Some(first) => copies.push((view, *first)),
            None => {
                first_of.insert(places, view);
            }
        }
    }
    copies
}

/// That so many of a camera's images are copies; `example`: one, and what it is a copy of.
pub(crate) fn finding(camera: &str, count: usize, of: usize, example: [&str; 2]) -> Finding {
    let [copy, first] = example;
    let what = format!(
        "{count} of {of} images are duplicates ({copy} of {first}); each image is used once"
    );
    Finding::new("copies", Verdict::Warn, camera, what)
        .value(count as f64, "images")
        .limit(Limit::AtMost(0.0))
        .remedy("check that the camera does not repeat images, and that none was copied under another name")
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_geometry::Vector2;

    #[test]
    fn copies_are_those_of_the_same_places_in_any_order() {
        let corner = |index: usize, x: f64| Corner {
            index,
            pixel: Vector2::new(x, 2.0),
        };
        let views = [
            (7, vec![corner(0, 1.0), corner(1, 5.0)]),
            (8, vec![corner(0, 1.0), corner(1, 5.0 + 1e-12)]),
            (9, vec![corner(1, 5.0), corner(0, 1.0)]),
            (10, vec![corner(0, 1.0)]),
            (11, vec![]),
            (12, vec![]),
        ];
        let found = copies(views.iter().map(|(k, corners)| (*k, corners.as_slice())));
        assert_eq!(found, [(9, 7)]);
    }
}
