//! What lies between two points: the surfaces that a straight line enters.

use nalgebra::Vector3;

use crate::world::vector::{cross, norm};
use crate::world::{Outline, Substance, World};

/// Surfaces on one line at most.
const MOST_SURFACES: usize = 48;
/// How far behind a surface the line goes on, metres.
const BEYOND_M: f64 = 2e-3;
/// A surface of this edge is in the way with all of its loss; waves bend around smaller ones.
const FULL_EDGE_M: f64 = 0.8;
/// Walls lose no more than this: what goes round them is then stronger, decibel.
const MOST_LOSS_DB: f64 = 50.0;

/// Calls `meet` for each surface that the line from one point to another enters, until it answers `false`. Bodies are
/// closed: each is entered once. Who walks by is not met.
pub(super) fn along(
    world: &World,
    from: Vector3<f64>,
    to: Vector3<f64>,
    mut meet: impl FnMut(usize, Substance) -> bool,
) {
    let way = to - from;
    let length = way.norm();
    if length < BEYOND_M {
        return;
    }
    let direction = way / length;
    let ray = direction.map(|v| v as f32).into();
    let mut travelled = 0.0;
    for _ in 0..MOST_SURFACES {
        let origin = (from + direction * travelled).map(|v| v as f32).into();
        let Some(hit) = world.cast(origin, ray) else {
            return;
        };
        travelled += f64::from(hit.distance);
        if travelled > length - BEYOND_M || !meet(hit.facet, world.substance(hit.facet)) {
            return;
        }
        travelled += BEYOND_M;
    }
}

/// What a wave loses in walls and furniture on the straight line between two points, decibel.
pub fn wall_loss_db(
    world: &World,
    from: Vector3<f64>,
    to: Vector3<f64>,
    frequency_mhz: f64,
) -> f64 {
    let mut loss_db = 0.0;
    along(world, from, to, |facet, substance| {
        loss_db += substance.loss_db(frequency_mhz) * share_in_the_way(world, facet);
        loss_db < MOST_LOSS_DB
    });
    loss_db.min(MOST_LOSS_DB)
}

/// How much of a wave a surface of this size is in the way of.
fn share_in_the_way(world: &World, facet: usize) -> f64 {
    let edge_m = f64::from(area_m2(world, facet).sqrt());
    (edge_m / FULL_EDGE_M).min(1.0)
}

/// Area of a facet, square metres.
pub(super) fn area_m2(world: &World, facet: usize) -> f32 {
    world.facets().get(facet).map_or(0.0, |f| {
        let whole = norm(cross(f.edge_a, f.edge_b));
        match f.outline() {
            Outline::Parallelogram => whole,
            Outline::Triangle => 0.5 * whole,
        }
    })
}
