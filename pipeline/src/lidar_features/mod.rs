//! LiDAR features of a keyframe for Eq. (4): planes, and edges where two straight pieces of a ring meet (Zhang and
//! Singh, "LOAM", IV-A, with windows in metres instead of points), and their correspondences between keyframes.
//!
//! Ranges carry centimetres of noise while neighbouring returns lie a centimetre apart, so curvature from a few
//! neighbours would find noise. Planes are fits to all points of a cell; an edge point is where lines fitted to
//! both sides of it meet, and an edge is a line through such points of several rings.
//!
//! A keyframe joins the scans around it: indoors one or two rings of a single scan meet the floor, and lines on the floor
//! are no plane.

mod offset;
mod reduced;

use lsfb_geometry::{Matrix3, Se3, Vector3};
use lsfb_perception::lidar::{LocalMap, LocalMapConfig, Plane, PlaneMap, voxel_downsample};
use lsfb_perception::statistics::median;
use lsfb_types::Bounds;
use nalgebra::SymmetricEigen;
use serde::{Deserialize, Serialize};

use crate::residuals::{LidarEdge, LidarPlane};

pub use offset::ScanOffset;
pub use reduced::{POINTS_PER_BEND, SparseScan};

/// What counts as a feature, and as a correspondence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LidarFeatureConfig {
    /// Edge of the largest plane cell, metres; the smallest is half of it.
    pub plane_cell_m: f64,
    /// Length of the straight pieces on both sides of an edge point, metres.
    pub edge_window_m: f64,
    /// Least angle between those pieces, degrees.
    pub min_crease_deg: f64,
    /// Farthest correspondence, metres.
    pub gate_m: f64,
    /// Largest angle between corresponding normals or edge directions, degrees.
    pub max_angle_deg: f64,
}

impl Default for LidarFeatureConfig {
    fn default() -> Self {
        Self {
            plane_cell_m: 0.8,
            edge_window_m: 0.3,
            min_crease_deg: 40.0,
            gate_m: 0.15,
            max_angle_deg: 20.0,
        }
    }
}

lsfb_types::bounds! {
    LidarFeatureConfig {
        plane_cell_m: number(Bounds::POSITIVE),
        edge_window_m: number(Bounds::POSITIVE),
        min_crease_deg: number(Bounds::NOT_NEGATIVE),
        gate_m: number(Bounds::NOT_NEGATIVE),
        max_angle_deg: number(Bounds::NOT_NEGATIVE),
    }
}

/// A straight edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// Mean of its points, in the rig frame of the keyframe, metres.
    pub point: Vector3<f64>,
    /// Unit direction, up to sign.
    pub direction: Vector3<f64>,
}

/// Features of one keyframe, in the rig frame of the keyframe.
#[derive(Clone, Debug)]
pub struct LidarFeatures {
    surfaces: PlaneMap,
    planes: Vec<Plane>,
    edges: Vec<Edge>,
}

/// ⁿp on the plane (ᵐq, ᵐn).
///
/// Numbers have seven digits, a hundredth of a millimetre at a hundred metres: ten minutes of a walk have twenty million matches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneMatch {
    point_in_n: Vector3<f32>,
    point_in_m: Vector3<f32>,
    normal_in_m: Vector3<f32>,
}

impl PlaneMatch {
    /// A point in keyframe n that lies on a plane in keyframe m.
    pub fn new(point_in_n: &Vector3<f64>, plane_in_m: &Plane) -> Self {
        Self {
            point_in_n: point_in_n.cast(),
            point_in_m: plane_in_m.point.cast(),
            normal_in_m: plane_in_m.normal.cast(),
        }
    }

    /// How far the point is off the plane, by the poses of the keyframes.
    pub fn residual(&self, sigma_m: f64) -> LidarPlane {
        LidarPlane {
            point_in_n: self.point_in_n.cast(),
            point_in_m: self.point_in_m.cast(),
            normal_in_m: self.normal_in_m.cast(),
            sigma_m,
        }
    }
}

/// ⁿp on the edge (ᵐq, ᵐl).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeMatch {
    /// Point in keyframe n.
    pub point_in_n: Vector3<f64>,
    /// Edge in keyframe m.
    pub edge_in_m: Edge,
}

impl EdgeMatch {
    /// How far the point is off the edge, by the poses of the keyframes.
    pub fn residual(&self, sigma_m: f64) -> LidarEdge {
        LidarEdge {
            point_in_n: self.point_in_n,
            point_in_m: self.edge_in_m.point,
            direction_in_m: self.edge_in_m.direction,
            sigma_m,
        }
    }
}

/// What two keyframes see both.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Correspondences {
    /// Planes.
    pub planes: Vec<PlaneMatch>,
    /// Edges.
    pub edges: Vec<EdgeMatch>,
}

/// Points and rings an edge must have.
const MIN_POINTS_PER_EDGE: usize = 5;
const MIN_RINGS_PER_EDGE: usize = 4;
/// The direction of an edge must be known to 4°: a short and thick one is a corner, where several edges meet.
const MAX_DIRECTION_SIGMA_RAD: f64 = 0.07;
/// The shorter of the pieces at an edge, as a share of the longer.
const LEAST_EVENNESS: f64 = 0.6;

/// What one scan adds to the keyframes around it, in the rig frame at the time the scan was deskewed to.
#[derive(Clone, Debug)]
pub struct ScanFeatures {
    points: Vec<Vector3<f64>>,
    creases: Vec<Crease>,
    sensor_in_rig: Vector3<f64>,
}

/// A scan and where it was, seen from a keyframe.
#[derive(Clone, Copy, Debug)]
pub struct PlacedScan<'a> {
    /// Takes the scan's rig frame to that of the keyframe.
    pub keyframe_from_scan: Se3,
    /// The scan.
    pub scan: &'a ScanFeatures,
}

/// Edge of the voxels a scan is thinned to, metres.
const THINNING_M: f64 = 0.05;

impl ScanFeatures {
    /// Of a scan given ring by ring in firing order, seen from `sensor_in_rig`.
    pub fn extract(
        rings: &[Vec<Vector3<f64>>],
        sensor_in_rig: &Vector3<f64>,
        range_noise_m: f64,
        config: &LidarFeatureConfig,
    ) -> Self {
        let creases = rings
            .iter()
            .enumerate()
            .flat_map(|(ring, points)| {
                creases_of_ring(points, sensor_in_rig, range_noise_m, config)
                    .into_iter()
                    .map(move |(_, bend)| Crease { ring, bend })
            })
            .collect();
        Self {
            points: voxel_downsample(&rings.concat(), THINNING_M),
            creases,
            sensor_in_rig: *sensor_in_rig,
        }
    }
}

impl LidarFeatures {
    /// Features of a keyframe from the scans around it.
    pub fn join(scans: &[PlacedScan], range_noise_m: f64, config: &LidarFeatureConfig) -> Self {
        let mut surfaces = LocalMap::new(LocalMapConfig {
            cell_size_m: config.plane_cell_m,
            levels: 2,
            range_noise_m,
        });
        let mut creases = Vec::new();
        for placed in scans {
            let scan = placed.scan;
            surfaces.insert(
                &scan.points,
                &placed.keyframe_from_scan,
                &scan.sensor_in_rig,
            );
            creases.extend(scan.creases.iter().map(|c| Crease {
                bend: c.bend.map(|p| placed.keyframe_from_scan * p),
                ..*c
            }));
        }
        creases.sort_by_key(|c| c.ring);
        let surfaces = surfaces.into_planes();
        Self {
            planes: surfaces.finest(),
            edges: join_creases(&creases, range_noise_m),
            surfaces,
        }
    }

    /// Of points that somebody else took for those of planes and of edges, seen from where their frame begins; metres, in the rig frame.
    pub fn of_points(
        on_planes: &[Vector3<f64>],
        on_edges: &[Vector3<f64>],
        range_noise_m: f64,
        config: &LidarFeatureConfig,
    ) -> Self {
        let mut surfaces = LocalMap::new(LocalMapConfig {
            cell_size_m: config.plane_cell_m,
            levels: 2,
            range_noise_m,
        });
        surfaces.insert(on_planes, &Se3::identity(), &Vector3::zeros());
        let surfaces = surfaces.into_planes();
        Self {
            planes: surfaces.finest(),
            edges: lines_through(on_edges, range_noise_m),
            surfaces,
        }
    }

    /// Flat patches, each with the mean of its points.
    pub fn planes(&self) -> &[Plane] {
        &self.planes
    }

    /// Straight edges.
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }
}

/// Pairs the features of keyframe n with those of keyframe m that they lie on, given where n is seen from m.
pub fn correspond(
    m: &LidarFeatures,
    n: &LidarFeatures,
    m_from_n: &Se3,
    config: &LidarFeatureConfig,
) -> Correspondences {
    let min_cosine = config.max_angle_deg.to_radians().cos();
    let planes = n.planes.iter().filter_map(|plane| {
        let point = *m_from_n * plane.point;
        let normal = m_from_n.rotation * plane.normal;
        let plane_in_m = m
            .surfaces
            .find(&point, &normal, config.gate_m, min_cosine)?;
        Some(PlaneMatch::new(&plane.point, &plane_in_m))
    });
    let edges = n.edges.iter().filter_map(|edge| {
        let point = *m_from_n * edge.point;
        let direction = m_from_n.rotation * edge.direction;
        let across = |e: &Edge| e.direction.cross(&(point - e.point)).norm();
        let edge_in_m = m
            .edges
            .iter()
            .filter(|e| {
                e.direction.dot(&direction).abs() > min_cosine
                    && across(e) < config.gate_m
                    // Two edges on one line may be two things.
                    && (point - e.point).norm() < 1.0
            })
            .min_by(|a, b| across(a).total_cmp(&across(b)))?;
        Some(EdgeMatch {
            point_in_n: edge.point,
            edge_in_m: *edge_in_m,
        })
    });
    let mut found = Correspondences {
        planes: planes.collect(),
        edges: edges.collect(),
    };
    // There are many of them.
    found.planes.shrink_to_fit();
    found.edges.shrink_to_fit();
    found
}

/// Where one ring bends.
#[derive(Clone, Copy, Debug)]
struct Crease {
    ring: usize,
    /// Where its pieces meet, and the middles of the one before and the one behind.
    bend: [Vector3<f64>; 3],
}

impl Crease {
    fn point(&self) -> Vector3<f64> {
        self.bend[0]
    }
}

/// Where a ring bends, each with the number of the point that is nearest to it in firing order.
fn creases_of_ring(
    points: &[Vector3<f64>],
    sensor: &Vector3<f64>,
    range_noise_m: f64,
    config: &LidarFeatureConfig,
) -> Vec<(usize, [Vector3<f64>; 3])> {
    let Some(step_rad) = azimuth_step_rad(points, sensor) else {
        return Vec::new();
    };
    let mut sums = vec![Vector3::zeros()];
    for p in points {
        sums.push(sums[sums.len() - 1] + p);
    }
    let mean = |from: usize, to: usize| (sums[to] - sums[from]) / (to - from) as f64;
    // How far each point sticks out of the line through the means of both its sides.
    let bend: Vec<(f64, usize)> = points
        .iter()
        .enumerate()
        .map(|(i, p)| {
            let range_m = (p - sensor).norm();
            let half = ((config.edge_window_m / (range_m * step_rad)) as usize).clamp(4, 60);
            let centre = (half / 5).max(1);
            if i < half || i + half >= points.len() {
                return (0.0, half);
            }
            let reach_m = 2.0 * config.edge_window_m;
            if (points[i - half] - p).norm() > reach_m || (points[i + half] - p).norm() > reach_m {
                return (0.0, half);
            }
            let sides = (mean(i - half, i) + mean(i + 1, i + half + 1)) * 0.5;
            let bend = (sides - mean(i - centre, i + centre + 1)).norm();
            (bend, half)
        })
        .collect();
    let min_bend_m = 0.15 * config.edge_window_m;
    let is_peak = |i: usize, half: usize| {
        let from = i.saturating_sub(half);
        let to = (i + half + 1).min(points.len());
        // Of equal bends the first is the peak.
        bend[from..i].iter().all(|b| b.0 < bend[i].0)
            && bend[i + 1..to].iter().all(|b| b.0 <= bend[i].0)
    };
    (0..points.len())
        .filter(|&i| bend[i].0 > min_bend_m && is_peak(i, bend[i].1))
        .filter_map(|i| {
            let half = bend[i].1;
            let left = Line::fit(&points[i - half..i], range_noise_m)?;
            let right = Line::fit(&points[i + 1..i + half + 1], range_noise_m)?;
            let meeting = left.meet(&right, config.min_crease_deg)?;
            ((meeting - points[i]).norm() < 0.5 * config.edge_window_m)
                .then_some((i, [meeting, left.point, right.point]))
        })
        .collect()
}

/// Usual angle between neighbouring returns.
fn azimuth_step_rad(points: &[Vector3<f64>], sensor: &Vector3<f64>) -> Option<f64> {
    let angles: Vec<f64> = points
        .windows(2)
        .map(|w| (w[0] - sensor).angle(&(w[1] - sensor)))
        .collect();
    if angles.len() < 20 {
        return None;
    }
    median(angles).filter(|usual| *usual > 1e-5)
}

/// A line fitted to points.
struct Line {
    point: Vector3<f64>,
    direction: Vector3<f64>,
    /// Root mean square distance of the points.
    thickness_m: f64,
    length_m: f64,
}

impl Line {
    fn through(points: impl Iterator<Item = Vector3<f64>> + Clone) -> Self {
        let n = points.clone().count().max(1) as f64;
        let point = points.clone().sum::<Vector3<f64>>() / n;
        let spread: Matrix3<f64> = points
            .map(|p| (p - point) * (p - point).transpose())
            .sum::<Matrix3<f64>>()
            / n;
        let eigen = SymmetricEigen::new(spread);
        let largest = eigen.eigenvalues.imax();
        let along = eigen.eigenvalues[largest].max(0.0);
        Self {
            point,
            direction: eigen.eigenvectors.column(largest).into(),
            thickness_m: (spread.trace() - along).max(0.0).sqrt(),
            length_m: (12.0 * along).sqrt(),
        }
    }

    /// Whether so many points say well enough where an edge is and how it runs.
    fn is_edge(&self, points: usize, range_noise_m: f64) -> bool {
        let sigma_rad = (12.0 / points as f64).sqrt() * self.thickness_m / self.length_m;
        self.thickness_m <= 1.5 * range_noise_m
            && self.length_m >= 4.0 * self.thickness_m
            && sigma_rad <= MAX_DIRECTION_SIGMA_RAD
    }

    /// The line through one side of an edge; `None` where the points are no line.
    fn fit(points: &[Vector3<f64>], range_noise_m: f64) -> Option<Self> {
        let line = Self::through(points.iter().copied());
        (points.len() >= 4
            && line.thickness_m < 1.5 * range_noise_m + 0.005
            && line.length_m > 2.0 * line.thickness_m)
            .then_some(line)
    }

    /// Middle of the shortest connection of two lines that meet at least at `min_angle_deg`.
    fn meet(&self, other: &Self, min_angle_deg: f64) -> Option<Vector3<f64>> {
        let cosine = self.direction.dot(&other.direction);
        if cosine.abs() > min_angle_deg.to_radians().cos() {
            return None;
        }
        let between = other.point - self.point;
        let sine_squared = 1.0 - cosine * cosine;
        let s =
            (between.dot(&self.direction) - cosine * between.dot(&other.direction)) / sine_squared;
        let t =
            (cosine * between.dot(&self.direction) - between.dot(&other.direction)) / sine_squared;
        let (a, b) = (
            self.point + self.direction * s,
            other.point + other.direction * t,
        );
        Some((a + b) * 0.5)
    }
}

/// Lines through the creases of neighbouring rings.
fn join_creases(creases: &[Crease], range_noise_m: f64) -> Vec<Edge> {
    let points: Vec<_> = creases.iter().map(Crease::point).collect();
    join_points(&points, 0.4, range_noise_m, |line, members| {
        let joined: Vec<&Crease> = members.iter().map(|&i| &creases[i]).collect();
        let mut rings: Vec<usize> = joined.iter().map(|c| c.ring).collect();
        rings.dedup();
        rings.len() >= MIN_RINGS_PER_EDGE
            && parts_two_planes(line, &joined, range_noise_m)
            && is_seen_evenly(&joined)
    })
}

/// Lines through points that are known to lie on edges.
fn lines_through(points: &[Vector3<f64>], range_noise_m: f64) -> Vec<Edge> {
    join_points(points, 0.6, range_noise_m, |_, _| true)
}

/// Lines through points that lie within a radius of one of them, where `is_edge` holds of the line and the points on it; each point is on one line at most.
fn join_points(
    points: &[Vector3<f64>],
    radius_m: f64,
    range_noise_m: f64,
    is_edge: impl Fn(&Line, &[usize]) -> bool,
) -> Vec<Edge> {
    let mut used = vec![false; points.len()];
    let mut edges = Vec::new();
    for seed in 0..points.len() {
        if used[seed] {
            continue;
        }
        let near: Vec<usize> = (0..points.len())
            .filter(|&i| !used[i] && (points[i] - points[seed]).norm() < radius_m)
            .collect();
        let line = Line::through(near.iter().map(|&i| points[i]));
        // Points of another edge nearby are left out, once.
        let off_m = |i: usize| line.direction.cross(&(points[i] - line.point)).norm();
        let members: Vec<usize> = near
            .into_iter()
            .filter(|&i| off_m(i) < 3.0 * range_noise_m)
            .collect();
        if members.len() < MIN_POINTS_PER_EDGE {
            continue;
        }
        let line = Line::through(members.iter().map(|&i| points[i]));
        if !line.is_edge(members.len(), range_noise_m) || !is_edge(&line, &members) {
            continue;
        }
        for i in members {
            used[i] = true;
        }
        edges.push(Edge {
            point: line.point,
            direction: line.direction,
        });
    }
    edges
}

/// Whether the pieces of the rings on either side of a line lie on one plane through it each. Where they do not, the line joins creases of two
/// edges, as above and below the top of a cupboard.
fn parts_two_planes(line: &Line, creases: &[&Crease], range_noise_m: f64) -> bool {
    [1, 2].iter().all(|side| {
        let off = |c: &&Crease| c.bend[*side] - line.point;
        let mean = creases.iter().map(off).sum::<Vector3<f64>>() / creases.len() as f64;
        let normal = line.direction.cross(&mean).try_normalize(0.0);
        normal.is_some_and(|normal| {
            let squares = creases.iter().map(|c| normal.dot(&off(c)).powi(2));
            let rms_m = (squares.sum::<f64>() / creases.len() as f64).sqrt();
            rms_m < range_noise_m
        })
    })
}

/// Whether the pieces on both sides are about as long. They have as many returns: where one is much longer, its surface is seen at a flat angle,
/// the noise of ranges moves returns along it, and where the pieces meet is off by several centimetres alike in all rings.
fn is_seen_evenly(creases: &[&Crease]) -> bool {
    let [one, other] = [1, 2].map(|side| {
        let lengths = creases.iter().map(|c| (c.bend[side] - c.point()).norm());
        lengths.sum::<f64>()
    });
    one.min(other) >= LEAST_EVENNESS * one.max(other)
}

#[cfg(test)]
mod tests;
