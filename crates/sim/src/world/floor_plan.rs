//! Where the walls of the furnished room and its corridor are.

use crate::noise::{stream, uniform};

/// Thickness of the wall between room and corridor, metres.
pub(super) const WALL_M: f32 = 0.12;
/// Height of the ceilings, metres.
const CEILING_M: f32 = 2.6;

/// The dimensions a walk needs to know. The room is `0 ≤ x ≤ room[0]`, `0 ≤ y ≤ room[1]`; the corridor runs along x
/// on the other side of the wall y = 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FloorPlan {
    /// Inner size of the room along x and y, metres.
    pub room_m: [f32; 2],
    /// x of the middle of the doorway, metres.
    pub doorway_x_m: f32,
    /// Width of the doorway, metres.
    pub doorway_width_m: f32,
    /// Where the corridor begins and ends along x, metres.
    pub corridor_x_m: [f32; 2],
    /// Where the corridor begins and ends along y, metres.
    pub corridor_y_m: [f32; 2],
    /// Height of the ceilings, metres.
    pub height_m: f32,
}

impl FloorPlan {
    pub(crate) fn new(seed: u64) -> Self {
        let rng = stream(seed, "plan", 0);
        let width = uniform(&rng, 4.85, 5.1);
        let corridor_width = uniform(&rng, 1.75, 1.95);
        Self {
            room_m: [width, 20.0 / width],
            doorway_x_m: uniform(&rng, 1.15, 1.3),
            doorway_width_m: 1.2,
            corridor_x_m: [uniform(&rng, -1.4, -0.9), uniform(&rng, 9.3, 9.8)],
            corridor_y_m: [-WALL_M - corridor_width, -WALL_M],
            height_m: CEILING_M,
        }
    }

    /// The middle of what one can walk around in the room.
    pub(crate) fn table_centre(&self) -> [f32; 2] {
        [0.5 * self.room_m[0], 0.5 * self.room_m[1]]
    }
}
