//! The Hesai driver against nebula's, point by point, on recordings made by others.
//!
//! nebula (TIER IV, 2023) leaves out ranges that it thinks too short, and of two echoes within 0.1 m the first; we leave out
//! nothing but the second of two equal echoes. Its frame is turned: its y is our x.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test file as a whole; clippy.toml only spares #[test] functions"
)]

use std::collections::HashMap;
use std::path::Path;

use crate::lidar::{BeamAngles, ScanSettings};
use crate::lidar_vendors::hesai::{Decoder, DecoderConfig, Model};
use crate::transport::rosbag2::Rosbag2Source;
use lsfb_tests::recordings;
use lsfb_types::{Echo, LidarPoint, LidarScan, Packet};

/// Positions of a binary PCD of x, y, z.
fn pcd(path: &Path) -> Vec<[f32; 3]> {
    let bytes = std::fs::read(path).unwrap();
    let marker = b"DATA binary\n";
    let start = bytes
        .windows(marker.len())
        .position(|w| w == marker)
        .unwrap()
        + marker.len();
    let f32_at =
        |record: &[u8], k: usize| f32::from_le_bytes(record[4 * k..4 * k + 4].try_into().unwrap());
    bytes[start..]
        .chunks_exact(12)
        .map(|record| [0, 1, 2].map(|k| f32_at(record, k)))
        .collect()
}

struct Case {
    folder: &'static str,
    angles: &'static str,
    bag: &'static str,
    cloud: &'static str,
    model: Model,
    returns: &'static str,
    /// Packets in the bag.
    packets: u64,
}

const CASES: [Case; 3] = [
    Case {
        folder: "xt32",
        angles: "PandarXT32.csv",
        bag: "1673400677802009732/1673400677802009732_0.db3",
        cloud: "1673400678101968885.pcd",
        model: Model::Xt32,
        returns: "last + strongest",
        packets: 2_000,
    },
    Case {
        folder: "64",
        angles: "Pandar64.csv",
        bag: "1673403880599376836/1673403880599376836_0.db3",
        cloud: "1673403880898440686.pcd",
        model: Model::Pandar64,
        returns: "last + strongest",
        packets: 2_400,
    },
    Case {
        folder: "qt64",
        angles: "PandarQT64.csv",
        bag: "1673401195788312575/1673401195788312575_0.db3",
        cloud: "1673401196087570870.pcd",
        model: Model::Qt64,
        returns: "first + last",
        packets: 1_200,
    },
];

fn scans(case: &Case, folder: &Path) -> Vec<LidarScan> {
    let text = std::fs::read_to_string(folder.join("calibration").join(case.angles)).unwrap();
    let settings = ScanSettings {
        angles: Some(BeamAngles::parse_csv(&text).unwrap()),
        ..ScanSettings::default()
    };
    let mut decoder = Decoder::new(DecoderConfig::new(None, &settings));
    let mut bag = Rosbag2Source::open(&folder.join(case.folder).join(case.bag)).unwrap();
    let mut scans = Vec::new();
    while let Some(message) = bag.next_scan().unwrap() {
        for packet in &message.packets {
            scans.extend(decoder.push(packet).unwrap().map(|scan| scan.sample));
        }
    }
    scans.extend(std::iter::from_fn(|| decoder.finish()).map(|scan| scan.sample));
    let counters = *decoder.counters();
    assert_eq!(counters.packets, case.packets);
    assert_eq!(
        (counters.lost, counters.malformed, counters.refused),
        (0, 0, 0)
    );
    let found = decoder.found().unwrap();
    assert_eq!((found.model, found.returns), (case.model, case.returns));
    assert!((595..=605).contains(&found.rpm.unwrap()));
    scans
}

/// A cell of a grid of `CELL_M`.
type Cell = [i32; 3];
const CELL_M: f32 = 0.02;
type Grid = HashMap<Cell, Vec<[f32; 3]>>;

fn cell(position_m: [f32; 3]) -> Cell {
    position_m.map(|v| (v / CELL_M).floor() as i32)
}

fn range_m(point: &LidarPoint) -> f32 {
    point.position_m.iter().map(|v| v * v).sum::<f32>().sqrt()
}

/// Whether a point's beam is as close to the angle of the cut as the beams are apart.
fn is_beside_the_cut([x, y, _]: [f32; 3]) -> bool {
    y.atan2(x).to_degrees().abs() < 10.0
}

/// Largest difference of a coordinate from the closest of `cloud`, metres; infinite beyond a cell.
fn distance_m(grid: &Grid, of: [f32; 3]) -> f32 {
    let [x, y, z] = cell(of);
    let mut best = f32::INFINITY;
    for dx in -1..=1 {
        for dy in -1..=1 {
            for dz in -1..=1 {
                for other in grid.get(&[x + dx, y + dy, z + dz]).into_iter().flatten() {
                    let off = (0..3).map(|k| (other[k] - of[k]).abs()).fold(0.0, f32::max);
                    best = best.min(off);
                }
            }
        }
    }
    best
}

fn grid(points: impl Iterator<Item = [f32; 3]>) -> Grid {
    let mut grid = Grid::new();
    points.for_each(|p| grid.entry(cell(p)).or_default().push(p));
    grid
}

#[test]
fn every_point_of_nebulas_clouds_is_ours_and_no_other_is() {
    let name = "every_point_of_nebulas_clouds_is_ours_and_no_other_is";
    let Some(folder) = recordings(name, "lidar/nebula_hesai") else {
        return;
    };
    for case in &CASES {
        // Its y is our x, its x our minus y.
        let cloud: Vec<[f32; 3]> = pcd(&folder.join(case.folder).join(case.cloud))
            .into_iter()
            .map(|[x, y, z]| [y, -x, z])
            .collect();
        let scans = scans(case, &folder);
        let grids: Vec<_> = scans
            .iter()
            .map(|scan| grid(scan.points.iter().map(|p| p.position_m)))
            .collect();
        let inside = |ours: &Grid| {
            let is_near = |p: &&[f32; 3]| distance_m(ours, **p) < 1e-3;
            cloud.iter().filter(is_near).count()
        };
        let found: Vec<usize> = grids.iter().map(inside).collect();
        let best = (0..scans.len()).max_by_key(|k| found[*k]).unwrap();
        assert!(
            found[best] * 100 > cloud.len() * 98,
            "{}: {found:?} of {}",
            case.folder,
            cloud.len()
        );
        // nebula cuts where a beam passes the angle, we where the rotor does: the rest is beside the cut, one turn away.
        let neighbours = &grids[best.saturating_sub(1)..(best + 2).min(grids.len())];
        for point in &cloud {
            let off_m = |grid: &Grid| distance_m(grid, *point);
            let elsewhere = neighbours.iter().map(off_m).fold(f32::INFINITY, f32::min);
            assert!(elsewhere < 1e-3, "{}: {point:?} is in no scan", case.folder);
            assert!(
                off_m(&grids[best]) < 1e-3 || is_beside_the_cut(*point),
                "{}: {point:?} is in another turn",
                case.folder
            );
        }
        // What we have more: short ranges, the first of two echoes that are close to each other, and what is beside the cut.
        let scan = &scans[best];
        let theirs = grid(cloud.iter().copied());
        let more: Vec<&LidarPoint> = scan
            .points
            .iter()
            .filter(|p| distance_m(&theirs, p.position_m) >= 1e-3)
            .filter(|p| range_m(p) >= 0.3 && !is_beside_the_cut(p.position_m))
            .collect();
        for point in &more {
            let twin = scan.points.iter().find(|other| {
                other.ring == point.ring
                    && other.time_offset_ns == point.time_offset_ns
                    && other.echo != point.echo
                    && (range_m(other) - range_m(point)).abs() <= 0.101
            });
            assert!(twin.is_some(), "{}: {point:?}", case.folder);
        }
        assert!(scan.points.iter().all(|p| p.echo != Echo::Unknown));
        assert!(scan.points.iter().all(|p| p.time_offset_ns < 101_000_000));
    }
}

/// Without the file of the unit's beam angles the model's are taken: close, and not the same.
#[test]
fn the_models_angles_are_within_0_15_degrees_of_a_units() {
    let name = "the_models_angles_are_within_0_15_degrees_of_a_units";
    let Some(folder) = recordings(name, "lidar/nebula_hesai/calibration") else {
        return;
    };
    for case in &CASES {
        let text = std::fs::read_to_string(folder.join(case.angles)).unwrap();
        let angles = BeamAngles::parse_csv(&text).unwrap();
        assert_eq!(angles.channels(), case.model.layout().channels);
        for channel in 0..angles.channels() {
            let [elevation, azimuth] = case.model.angles_deg(channel);
            let off = (angles.elevation_deg[channel] - elevation).abs();
            assert!(off < 0.15, "{} {channel}: {off}", case.model);
            let off = (angles.azimuth_deg[channel] - azimuth).abs();
            assert!(off < 0.15, "{} {channel}: {off}", case.model);
        }
    }
}

/// A bag's packets, for whoever pushes them out of order.
#[test]
fn a_bag_gives_packets_as_long_as_the_sensor_sent_them() {
    let name = "a_bag_gives_packets_as_long_as_the_sensor_sent_them";
    let Some(folder) = recordings(name, "lidar/nebula_hesai") else {
        return;
    };
    for (case, bytes) in CASES.iter().zip([1080, 1198, 1072]) {
        let mut bag = Rosbag2Source::open(&folder.join(case.folder).join(case.bag)).unwrap();
        let packets: Vec<Packet> = std::iter::from_fn(|| bag.next_scan().unwrap())
            .flat_map(|scan| scan.packets)
            .collect();
        assert!(packets.iter().all(|packet| packet.bytes.len() == bytes));
    }
}
