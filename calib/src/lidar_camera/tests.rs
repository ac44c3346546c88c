//! Scans of a board made here, in the LiDAR's frame.

use lsfb_types::{LidarPoint, LidarScan};

use super::{LidarCameraConfig, MountedBoard, candidates};
use crate::board::Target;

/// Side of the plate, metres.
const SIDE_M: f64 = 0.8;
/// Of the plate and of the wall behind it, metres.
const BOARD_AT_M: f64 = 1.2;
const WALL_AT_M: f64 = 3.0;
const SCAN_NS: f64 = 1e8;
const STEP_DEG: f64 = 0.2;

/// A turn of 24 beams that begins before the middle of an upright board, clockwise as Velodyne's turn, and ends `short_deg`
/// earlier than a whole turn: as a board looks that has moved by as much meanwhile, once it is put to rest.
fn scan_with_its_seam_on_the_board(short_deg: f64) -> LidarScan {
    let steps = ((360.0 - short_deg) / STEP_DEG) as u32;
    let points = (0..24_u16).flat_map(|ring| {
        (0..steps).map(move |step| {
            let azimuth = (-STEP_DEG * f64::from(step)).to_radians();
            let rise = (f64::from(ring) - 12.0).to_radians().tan();
            let side = azimuth.tan() * BOARD_AT_M;
            let ahead = azimuth.cos() > 0.0;
            let meets = ahead && side.abs() < 0.5 * SIDE_M;
            let up = rise * BOARD_AT_M / azimuth.cos();
            let meets = meets && up.abs() < 0.5 * SIDE_M;
            let level_m = match meets {
                true => BOARD_AT_M / azimuth.cos(),
                false => WALL_AT_M,
            };
            let position = [
                level_m * azimuth.cos(),
                level_m * azimuth.sin(),
                level_m * rise,
            ];
            LidarPoint {
                position_m: position.map(|x| x as f32),
                ring,
                time_offset_ns: (SCAN_NS * f64::from(step) / f64::from(steps)) as u32,
                ..LidarPoint::default()
            }
        })
    });
    LidarScan {
        points: points.collect(),
    }
}

#[test]
fn a_board_on_the_seam_of_the_scan_is_one_board() {
    let target = Target::AprilGrid {
        columns: 6,
        rows: 6,
        tag_size_m: 0.088,
        spacing_ratio: 0.3,
    };
    let board = MountedBoard {
        target,
        width_m: SIDE_M,
        height_m: SIDE_M,
        offset_m: [0.0; 2],
    };
    for short_deg in [0.0, 4.0, 9.0] {
        let scan = scan_with_its_seam_on_the_board(short_deg);
        let patches = candidates::find(&board, &scan, &LidarCameraConfig::default());
        let patch = patches.first().expect("the board");
        let plane = &patch.fit.plane;
        // Its left and right sides alone end beams here: none of the edges lies within.
        for edge in &patch.edges {
            let place = plane.meet(&edge.ray).expect("on the plane");
            assert!(
                place.y.abs() > 0.45 * SIDE_M || place.z.abs() > 0.4 * SIDE_M,
                "{short_deg}° short: an edge at {place:?}"
            );
        }
        let longer_m = patch.rectangle.size_m[0];
        assert!((longer_m - SIDE_M).abs() < 0.05, "{short_deg}°: {longer_m}");
    }
}
