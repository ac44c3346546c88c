//! Surfaces that overlap in one plane, moved apart: which of two a ray meets there hangs on the last digits of its distance.

use super::bounds::Bounds;
use super::builder::Surface;
use super::facet::Facet;
use super::vector::{add, cross, dot, scale, sub};

/// Distance between surfaces that were in one plane, metres: far more than rounding at 100 m, less than any sensor tells.
const APART_M: f32 = 3e-4;
/// Surfaces closer than this are in one plane, metres.
const SAME_M: f32 = APART_M / 2.0;
/// Sine of the angle between planes that are one, at most.
const PARALLEL: f32 = 1e-4;
/// Surfaces that touch overlap by less than this, metres.
const TOUCHING_M: f32 = 1e-3;
/// A direction along which no two faces of what is built have the same part by accident.
const ASKEW: [f32; 3] = [0.537_1, 0.712_9, 0.451_3];

/// Moves what was built later before what it overlaps.
pub(super) fn separate(surfaces: &mut [Surface]) {
    let facets: Vec<Facet> = surfaces.iter().map(|s| s.facet).collect();
    let mut pairs = overlapping(&facets);
    pairs.sort_unstable_by_key(|[_, later]| *later);
    let mut layers = vec![0_u32; surfaces.len()];
    for [earlier, later] in pairs {
        layers[later] = layers[later].max(layers[earlier] + 1);
    }
    for (surface, layer) in surfaces.iter_mut().zip(layers) {
        if layer > 0 {
            let f = &surface.facet;
            let corner = add(f.corner, scale(f.normal, APART_M * layer as f32));
            surface.facet = Facet::new(corner, f.edge_a, f.edge_b, f.outline());
        }
    }
}

/// Pairs of facets that face the same way and overlap in one plane, the earlier first.
pub(crate) fn overlapping(facets: &[Facet]) -> Vec<[usize; 2]> {
    let mut all: Vec<usize> = (0..facets.len()).collect();
    let bounds: Vec<Bounds> = facets.iter().map(Bounds::of).collect();
    let mut pairs = Vec::new();
    for alike in clusters(&mut all, |i| dot(facets[i].normal, ASKEW), PARALLEL) {
        for plane in clusters(alike, |i| facets[i].offset, SAME_M) {
            find_overlapping(facets, &bounds, plane, &mut pairs);
        }
    }
    pairs
}

/// Runs of numbers of which each is within `gap` of the next by its key.
fn clusters(
    numbers: &mut [usize],
    key: impl Fn(usize) -> f32,
    gap: f32,
) -> impl Iterator<Item = &mut [usize]> {
    numbers.sort_unstable_by(|a, b| key(*a).total_cmp(&key(*b)));
    numbers.chunk_by_mut(move |a, b| key(*b) - key(*a) <= gap)
}

/// Pairs that overlap, among facets that are about in one plane.
fn find_overlapping(
    facets: &[Facet],
    bounds: &[Bounds],
    numbers: &mut [usize],
    pairs: &mut Vec<[usize; 2]>,
) {
    let mut all = Bounds::EMPTY;
    numbers.iter().for_each(|i| all.include(&bounds[*i]));
    let extent = |axis: &usize| all.max[*axis] - all.min[*axis];
    let longest = (0..3).max_by(|a, b| extent(a).total_cmp(&extent(b)));
    let axis = longest.unwrap_or(0);
    numbers.sort_unstable_by(|a, b| bounds[*a].min[axis].total_cmp(&bounds[*b].min[axis]));
    for (k, i) in numbers.iter().enumerate() {
        let reached = numbers[k + 1..].iter();
        for j in reached.take_while(|j| bounds[**j].min[axis] <= bounds[*i].max[axis]) {
            if overlap(&facets[*i], &facets[*j]) {
                pairs.push([*i.min(j), *i.max(j)]);
            }
        }
    }
}

/// Whether two facets face the same way, are in one plane, and overlap there.
fn overlap(a: &Facet, b: &Facet) -> bool {
    if dot(a.normal, b.normal) < 0.0 {
        return false;
    }
    let (of_a, of_b) = (a.vertices(), b.vertices());
    let lies_in = |plane: &Facet, vertices: &[[f32; 3]]| {
        let mut heights = vertices.iter().map(|v| plane.height_of(*v).abs());
        heights.all(|height_m| height_m < SAME_M)
    };
    if !lies_in(a, &of_b) && !lies_in(b, &of_a) {
        return false;
    }
    // Convex shapes are apart if they are along the normal of one of their edges.
    let is_between = |vertices: &[[f32; 3]]| {
        (0..vertices.len()).any(|k| {
            let edge = sub(vertices[(k + 1) % vertices.len()], vertices[k]);
            let across = cross(a.normal, edge);
            let length = dot(across, across).sqrt().max(f32::MIN_POSITIVE);
            let span = |of: &[[f32; 3]]| {
                let along = of
                    .iter()
                    .map(|v| dot(sub(*v, vertices[k]), across) / length);
                along.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], x| {
                    [low.min(x), high.max(x)]
                })
            };
            let ([low_a, high_a], [low_b, high_b]) = (span(&of_a), span(&of_b));
            high_a.min(high_b) - low_a.max(low_b) < TOUCHING_M
        })
    };
    !is_between(&of_a) && !is_between(&of_b)
}

#[cfg(test)]
mod tests {
    use super::super::facet::Outline;
    use super::super::material::Material;
    use super::*;

    fn square(x: f32, y: f32, z: f32, size: f32) -> Facet {
        let (a, b) = ([size, 0.0, 0.0], [0.0, size, 0.0]);
        Facet::new([x, y, z], a, b, Outline::Parallelogram)
    }

    #[test]
    fn what_overlaps_in_a_plane_is_found_and_what_touches_is_not() {
        let floor = square(0.0, 0.0, 0.0, 10.0);
        let cases = [
            (square(4.0, 4.0, 0.0, 1.0), true),
            (square(9.5, 9.5, 5e-5, 1.0), true),
            (square(10.0, 0.0, 0.0, 1.0), false),
            (square(4.0, 4.0, 1e-3, 1.0), false),
            (square(12.0, 4.0, 0.0, 1.0), false),
        ];
        for (other, expected) in cases {
            let found = !overlapping(&[floor, other]).is_empty();
            assert_eq!(found, expected, "{other:?}");
        }
        // Back to back, and the halves of one square.
        let below = Facet::new(
            [4.0, 4.0, 0.0],
            [0.0, 1.0, 0.0],
            [1.0, 0.0, 0.0],
            Outline::Parallelogram,
        );
        assert!(overlapping(&[floor, below]).is_empty());
        let half = |corner, sign: f32| {
            let (a, b) = ([sign, 0.0, 0.0], [0.0, sign, 0.0]);
            Facet::new(corner, a, b, Outline::Triangle)
        };
        let halves = [half([0.0; 3], 1.0), half([1.0, 1.0, 0.0], -1.0)];
        assert!(overlapping(&halves).is_empty());
    }

    #[test]
    fn layers_lie_one_above_the_other_in_the_order_in_which_they_were_built() {
        let surface = |facet| Surface {
            facet,
            material: Material::PLASTER,
        };
        let facets = [
            square(0.0, 0.0, 1.0, 10.0),
            square(5.0, 5.0, 1.0, 2.0),
            square(2.0, 2.0, 1.0, 2.0),
            square(6.0, 6.0, 1.0, 2.0),
        ];
        let mut surfaces = facets.map(surface);
        separate(&mut surfaces);
        let heights_mm = surfaces.map(|s| 1e3 * (s.facet.corner[2] - 1.0));
        for (height_mm, expected) in heights_mm.into_iter().zip([0.0, 0.3, 0.3, 0.6]) {
            assert!((height_mm - expected).abs() < 1e-3, "{heights_mm:?}");
        }
        let facets = surfaces.map(|s| s.facet);
        assert!(overlapping(&facets).is_empty());
    }
}
