//! A room with an AprilGrid on a stand, for the calibration of a rig.

use super::dress::Dress;
use super::site::{Area, Cladding, Site};
use crate::noise::stream;
use crate::world::april_grid;
use crate::world::builder::{Faces, Placement};
use crate::world::furniture::{plant, shelf};
use crate::world::material::Material;

/// Edge of one tag, metres.
pub const TAG_M: f32 = 0.088;
/// The room.
pub(super) const ROOM: Area = Area::new([0.0, 6.0], [0.0, 5.0]);
/// Middle of the board, metres.
const CENTRE: [f32; 3] = [3.9, 2.5, 1.3];
/// Thickness of the board, metres.
const BOARD_M: f32 = 0.02;

/// Where the board is: its face looks along −x, its corners from the grid's lower left are along −y and z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationBoard {
    /// Lower left corner of the grid (of its first black square), metres.
    pub corner_m: [f64; 3],
    /// Unit vector along increasing tag numbers of a row.
    pub right: [f64; 3],
    /// Unit vector along the columns.
    pub up: [f64; 3],
    /// Edge of one tag, metres.
    pub tag_m: f64,
    /// Edge of the plate that the grid is in the middle of, metres.
    pub plate_m: f64,
}

impl CalibrationBoard {
    /// The board of the calibration room.
    pub fn of_room() -> Self {
        let half = 0.5 * f64::from(april_grid::edge_m(TAG_M));
        Self {
            corner_m: [
                f64::from(CENTRE[0]),
                f64::from(CENTRE[1]) + half,
                f64::from(CENTRE[2]) - half,
            ],
            right: [0.0, -1.0, 0.0],
            up: [0.0, 0.0, 1.0],
            tag_m: f64::from(TAG_M),
            plate_m: 2.0 * (half + f64::from(april_grid::margin_m(TAG_M))),
        }
    }

    /// Corners of a tag in the world, metres: lower left, lower right, upper right, upper left.
    pub fn tag_corners_m(&self, id: usize) -> [[f64; 3]; 4] {
        april_grid::corners_m(id, self.tag_m as f32).map(|[x, y]| {
            std::array::from_fn(|i| {
                self.corner_m[i] + f64::from(x) * self.right[i] + f64::from(y) * self.up[i]
            })
        })
    }
}

/// The room, textured enough for LiDAR odometry to hold on to, the board clear of everything.
pub(super) fn room(site: &mut Site) {
    let cladding = Cladding {
        floor: Material::LINOLEUM,
        wall: Material::PLASTER,
        ceiling: Material::CEILING,
    };
    let walls = site.hall(ROOM, 2.8, &cladding);
    for (k, wall) in walls.iter().enumerate() {
        site.dress(wall, Dress::Gallery, k as u64);
    }
    site.lamps(ROOM, 2.8, 1.6, 0.75);
    let rng = stream(site.seed, "calibration room", 0);
    shelf(
        site.out(),
        &rng,
        &walls[2].place.moved([0.5, 0.0, 0.0], 0.0),
        [1.4, 0.32, 1.8],
    );
    plant(site.out(), &rng, [0.6, 4.4, 0.0], 1.5, 0.4);
    // Looked at along x: right is −y.
    let board = Placement::new(CENTRE, -std::f32::consts::FRAC_PI_2);
    let half = 0.5 * april_grid::edge_m(TAG_M) + april_grid::margin_m(TAG_M);
    let plate = Material::BLANK.toned(0.5);
    let out = site.out();
    let (low, high) = ([-half, 0.0, -half], [half, BOARD_M, half]);
    out.cuboid_with_front(
        &board,
        low,
        high,
        Faces::All,
        plate,
        Material::april_grid(TAG_M),
    );
    let metal = Material::METAL.toned(0.3);
    let (low, high) = ([-0.02, BOARD_M, -CENTRE[2]], [0.02, BOARD_M + 0.04, 0.2]);
    out.cuboid(&board, low, high, Faces::Standing, metal);
}
