//! A scan as rings of neighbours.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use lsfb_geometry::Vector3;
use lsfb_perception::statistics::median;
use lsfb_types::LidarScan;

/// A return on its ring.
#[derive(Clone, Copy, Debug)]
pub(super) struct GridPoint {
    pub position: Vector3<f64>,
    pub azimuth_rad: f64,
    pub range_m: f64,
    /// As the sensor says it.
    pub intensity: u8,
    /// After the scan's first firing.
    pub time_offset_ns: u32,
}

/// The returns of one beam in order of azimuth, once around.
#[derive(Clone, Debug)]
pub(super) struct Ring {
    /// As the scan counts it.
    pub number: u16,
    pub points: Vec<GridPoint>,
    /// Angle between neighbours.
    pub step_rad: f64,
    /// Time that the whole scan took; 0 where its points have no times.
    pub scan_ns: u32,
}

/// Returns a ring needs to be of use.
const MIN_POINTS: usize = 12;
/// Neighbours are at most this many steps apart: dark squares lose a few returns in a row.
pub(super) const NEIGHBOR_STEPS: f64 = 6.5;

/// The rings from the lowest to the highest.
pub(super) fn rings(scan: &LidarScan) -> Vec<Ring> {
    let mut by_ring: BTreeMap<u16, Vec<GridPoint>> = BTreeMap::new();
    for point in &scan.points {
        let position = Vector3::from(point.position_m).map(f64::from);
        let range_m = position.norm();
        if !(range_m.is_finite() && range_m > 0.1) {
            continue;
        }
        by_ring.entry(point.ring).or_default().push(GridPoint {
            position,
            azimuth_rad: position.y.atan2(position.x),
            range_m,
            intensity: point.intensity,
            time_offset_ns: point.time_offset_ns,
        });
    }
    let scan_ns = scan.points.iter().map(|p| p.time_offset_ns).max();
    by_ring
        .into_iter()
        .filter(|(_, points)| points.len() >= MIN_POINTS)
        .map(|(number, points)| ring(number, points, scan_ns.unwrap_or(0)))
        .collect()
}

fn ring(number: u16, mut points: Vec<GridPoint>, scan_ns: u32) -> Ring {
    points.sort_by(|a, b| {
        a.azimuth_rad
            .total_cmp(&b.azimuth_rad)
            .then(a.range_m.total_cmp(&b.range_m))
    });
    let gaps = points
        .windows(2)
        .map(|w| w[1].azimuth_rad - w[0].azimuth_rad)
        .filter(|gap| *gap > 1e-5);
    let step_rad = median(gaps.collect()).unwrap_or(TAU);
    // Two returns of one firing: the nearer one is what the beam meets first.
    points.dedup_by(|b, a| b.azimuth_rad - a.azimuth_rad < 0.2 * step_rad);
    Ring {
        number,
        points,
        step_rad,
        scan_ns,
    }
}

impl Ring {
    /// Angle of its rays above the level; `None` for an empty ring.
    pub fn elevation_rad(&self) -> Option<f64> {
        let point = self.points.get(self.points.len() / 2)?;
        Some((point.position.z / point.range_m).clamp(-1.0, 1.0).asin())
    }

    /// The next point against the clock (`forward`) or the one before, and the angle to it.
    pub fn neighbor(&self, at: usize, direction: Direction) -> (usize, f64) {
        let n = self.points.len();
        let next = match direction {
            Direction::Forward => (at + 1) % n,
            Direction::Backward => (at + n - 1) % n,
        };
        let turn = self.points[next].azimuth_rad - self.points[at].azimuth_rad;
        let turn = match direction {
            Direction::Forward => turn,
            Direction::Backward => -turn,
        };
        (next, turn.rem_euclid(TAU))
    }

    /// Whether the scan began between two neighbours: what lies there was measured a whole turn earlier on one side than on the
    /// other. Where something moved meanwhile, a strip of it was never met, or the scene behind it was.
    pub fn is_seam(&self, at: usize, next: usize) -> bool {
        let [a, b] = [at, next].map(|k| self.points[k].time_offset_ns);
        a.abs_diff(b) > self.scan_ns / 2
    }

    /// Whether the next point continues the same surface.
    pub fn continues(&self, at: usize, direction: Direction, jump_m: f64) -> Option<usize> {
        let (next, turn) = self.neighbor(at, direction);
        let near = turn < NEIGHBOR_STEPS * self.step_rad;
        let smooth = (self.points[next].range_m - self.points[at].range_m).abs() < jump_m;
        (near && smooth && next != at).then_some(next)
    }
}

/// Which way around a ring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Direction {
    /// Against the clock seen from above, as azimuth grows.
    Forward,
    /// With it.
    Backward,
}

impl Direction {
    pub fn sign(self) -> f64 {
        match self {
            Self::Forward => 1.0,
            Self::Backward => -1.0,
        }
    }
}
