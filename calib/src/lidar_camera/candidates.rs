//! What in a scan could be the board: flat patches of its size that end on all sides.

use std::collections::BTreeMap;

use lsfb_geometry::Vector3;
use lsfb_types::LidarScan;

use super::outline::{self, Edge, Rectangle};
use super::plane::{Chord, Plane, PlaneFit, regress};
use super::scan_grid::{Direction, Ring, rings};
use super::{LidarCameraConfig, MountedBoard};

/// A flat patch that may be the board.
#[derive(Clone, Debug)]
pub(super) struct Patch {
    pub fit: PlaneFit,
    pub chords: Vec<Chord>,
    pub edges: Vec<Edge>,
    pub rectangle: Rectangle,
    pub points: usize,
}

/// Chords shorter than this share of the board's shorter side do not start a patch: poles, legs, people's arms.
const SHORTEST_CHORD: f64 = 0.25;
/// Chords shorter than this share belong to what holds the board.
const POLE_CHORD: f64 = 0.14;
/// Chords longer than this many diagonals are walls.
const LONGEST_CHORD: f64 = 1.25;
/// Sides may differ from those of the board by this factor, so that a wrong size is found and named.
const SIZE_FACTOR: f64 = 1.6;
/// Chords and points a patch needs.
const MIN_CHORDS: usize = 3;
const MIN_POINTS: usize = 30;
/// Share of the points of a chord's neighbourhood that must be flat.
const MIN_FLAT: f64 = 0.6;
/// Candidates kept per scan, those nearest in size.
const MOST_CANDIDATES: usize = 6;

/// A run of neighbours on one ring that ends by a step in range on both sides.
struct Segment {
    ring: usize,
    members: Vec<usize>,
    range_m: f64,
}

/// A chord of the board on one ring.
#[derive(Clone)]
struct Run {
    members: Vec<usize>,
    middle: Vector3<f64>,
    length_m: f64,
}

impl Run {
    fn new(ring: &Ring, members: Vec<usize>) -> Option<Self> {
        let position = |i: &usize| ring.points[*i].position;
        let (first, last) = (position(members.first()?), position(members.last()?));
        let sum: Vector3<f64> = members.iter().map(position).sum();
        Some(Self {
            middle: sum / members.len() as f64,
            length_m: (last - first).norm(),
            members,
        })
    }

    /// Whether it goes on where the one before it, on the next ring, ended.
    fn follows(&self, before: &Self, config: &LidarCameraConfig) -> bool {
        let apart = self.middle - before.middle;
        let sideways = apart.xy().norm();
        apart.norm() < 0.5 && sideways < config.jump_m + 0.6 * before.length_m
    }
}

/// Candidates, the one nearest in size first.
pub(super) fn find(
    board: &MountedBoard,
    scan: &LidarScan,
    config: &LidarCameraConfig,
) -> Vec<Patch> {
    let rings = rings(scan);
    let segments = segments(board, &rings, config);
    let groups = join(&rings, &segments, config);
    let mut patches: Vec<Patch> = groups
        .iter()
        .filter_map(|group| patch(board, &rings, &segments, group, config))
        .collect();
    let sides = [
        board.width_m.max(board.height_m),
        board.width_m.min(board.height_m),
    ];
    let size_error = |p: &Patch| {
        let d = [0, 1].map(|k| (p.rectangle.size_m[k] / sides[k]).ln().abs());
        d[0] + d[1]
    };
    patches.sort_by(|a, b| size_error(a).total_cmp(&size_error(b)));
    patches.truncate(MOST_CANDIDATES);
    patches
}

fn segments(board: &MountedBoard, rings: &[Ring], config: &LidarCameraConfig) -> Vec<Segment> {
    let short = SHORTEST_CHORD * board.width_m.min(board.height_m);
    let long = LONGEST_CHORD * board.width_m.hypot(board.height_m);
    let mut out = Vec::new();
    for (k, ring) in rings.iter().enumerate() {
        let n = ring.points.len();
        // Begin where a surface begins, so that none is cut in two at the seam.
        let Some(seam) = (0..n).find(|i| {
            ring.continues(*i, Direction::Backward, config.jump_m)
                .is_none()
        }) else {
            continue;
        };
        let mut members = vec![seam];
        for i in (1..=n).map(|i| (seam + i) % n) {
            let before = (i + n - 1) % n;
            if i != seam
                && ring
                    .continues(before, Direction::Forward, config.jump_m)
                    .is_some()
            {
                members.push(i);
                continue;
            }
            let done = std::mem::replace(&mut members, vec![i]);
            let ends = [done.first(), done.last()].map(|e| e.map(|e| ring.points[*e].position));
            let ([Some(a), Some(b)], true) = (ends, done.len() >= 4) else {
                continue;
            };
            let range_m =
                done.iter().map(|i| ring.points[*i].range_m).sum::<f64>() / done.len() as f64;
            let chord = (a - b).norm();
            if (short..=long).contains(&chord) && range_m < config.max_range_m {
                out.push(Segment {
                    ring: k,
                    members: done,
                    range_m,
                });
            }
        }
    }
    out
}

/// Groups of segments that lie above each other.
fn join(rings: &[Ring], segments: &[Segment], config: &LidarCameraConfig) -> Vec<Vec<usize>> {
    let mut parent: Vec<usize> = (0..segments.len()).collect();
    fn root(parent: &mut [usize], mut k: usize) -> usize {
        while parent[k] != k {
            parent[k] = parent[parent[k]];
            k = parent[k];
        }
        k
    }
    let span = |s: &Segment| {
        let ring = &rings[s.ring].points;
        let first = s.members.first().map_or(0.0, |i| ring[*i].azimuth_rad);
        let last = s.members.last().map_or(0.0, |i| ring[*i].azimuth_rad);
        (first, (last - first).rem_euclid(std::f64::consts::TAU))
    };
    for (i, a) in segments.iter().enumerate() {
        // Sorted by ring: those of the two rings above follow soon.
        for (j, b) in segments.iter().enumerate().skip(i + 1) {
            if b.ring > a.ring + 2 {
                break;
            }
            if b.ring == a.ring {
                continue;
            }
            let ((a0, a1), (b0, b1)) = (span(a), span(b));
            let turn = (b0 - a0 + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU)
                - std::f64::consts::PI;
            let overlap = (a1.min(turn + b1) - turn.max(0.0)).max(0.0);
            let tall = rise(rings, a, b);
            if overlap > 0.3 * a1.min(b1)
                && (a.range_m - b.range_m).abs() < config.jump_m + 1.2 * tall
            {
                let (x, y) = (root(&mut parent, i), root(&mut parent, j));
                parent[y.max(x)] = x.min(y);
            }
        }
    }
    let mut groups = BTreeMap::<usize, Vec<usize>>::new();
    for k in 0..segments.len() {
        let top = root(&mut parent, k);
        groups.entry(top).or_default().push(k);
    }
    groups
        .into_values()
        .filter(|g| g.len() >= MIN_CHORDS)
        .collect()
}

/// Height between two segments, metres.
fn rise(rings: &[Ring], a: &Segment, b: &Segment) -> f64 {
    let height = |s: &Segment| {
        let points = &rings[s.ring].points;
        s.members.iter().map(|i| points[*i].position.z).sum::<f64>() / s.members.len() as f64
    };
    (height(a) - height(b)).abs()
}

fn patch(
    board: &MountedBoard,
    rings: &[Ring],
    segments: &[Segment],
    group: &[usize],
    config: &LidarCameraConfig,
) -> Option<Patch> {
    let cloud: Vec<Vector3<f64>> = group
        .iter()
        .flat_map(|k| {
            let ring = &rings[segments[*k].ring].points;
            segments[*k].members.iter().map(|i| ring[*i].position)
        })
        .collect();
    let plane = trimmed_plane(&cloud, config)?;
    let tolerance = |facing: f64| (3.5 * config.range_noise_m * facing.abs()).max(0.02);
    let is_flat = |p: &Vector3<f64>| {
        let facing = plane.normal.dot(p) / p.norm();
        plane.local(p).z.abs() < tolerance(facing)
    };
    let flat = cloud.iter().filter(|p| is_flat(p)).count();
    if (flat as f64) < MIN_FLAT * cloud.len() as f64 {
        return None;
    }
    // All rings through the patch, short chords too: a board on its corner begins with a few points.
    let reach = 0.5 * LONGEST_CHORD * board.width_m.hypot(board.height_m) * SIZE_FACTOR;
    let run = |ring: &Ring| {
        let near = |i: usize| {
            let p = &ring.points[i].position;
            (p - plane.origin).norm() < reach && is_flat(p)
        };
        longest_run(ring, &near)
            .and_then(|run| Run::new(ring, run))
            .filter(|run| run.length_m >= POLE_CHORD * board.width_m.min(board.height_m))
    };
    let core = |k: &usize| segments[*k].ring;
    let (low, high) = (group.iter().map(core).min()?, group.iter().map(core).max()?);
    let mut runs: BTreeMap<usize, Run> = (low..=high)
        .filter_map(|k| Some((k, run(&rings[k])?)))
        .collect();
    // On to the tips, as long as a ring goes on where the one before ended: floors and walls cross the plane elsewhere.
    let down: Vec<usize> = (0..low).rev().collect();
    let up: Vec<usize> = (high + 1..rings.len()).collect();
    for way in [down, up] {
        let from = if way.first().is_some_and(|k| *k < low) {
            low
        } else {
            high
        };
        let Some(mut before) = runs.get(&from).cloned() else {
            continue;
        };
        for k in way {
            let Some(next) = run(&rings[k]).filter(|next| next.follows(&before, config)) else {
                break;
            };
            before = next.clone();
            runs.insert(k, next);
        }
    }
    let mut chords = Vec::new();
    let mut edges = Vec::new();
    for (k, run) in &runs {
        edges.extend(outline::ends(&rings[*k], &run.members, &plane, config));
        let returns = || run.members.iter().map(|i| &rings[*k].points[*i]);
        chords.push(Chord {
            ring: rings[*k].number,
            points: returns().map(|r| r.position).collect(),
            intensities: returns().map(|r| r.intensity).collect(),
        });
    }
    let rectangle = outline::rectangle(&plane, &chords, &edges)?;
    let sides = [
        board.width_m.max(board.height_m),
        board.width_m.min(board.height_m),
    ];
    // Beyond its last chords the board goes on unseen, at most to where the next rings would meet it; where there is no ring,
    // nobody knows how far.
    let unseen_m = unseen_m(rings, &runs, &plane, sides[0]);
    let sized = (0..2).all(|k| {
        let size_m = rectangle.size_m[k];
        size_m < SIZE_FACTOR * sides[k] && size_m + unseen_m > sides[k] / SIZE_FACTOR
    });
    // What is on the pole or the hand that holds the board is on its plane, but not within its outline.
    let chords = outline::within(&plane, chords, &rectangle);
    let points = chords.iter().map(|c| c.points.len()).sum();
    if !sized || points < MIN_POINTS || chords.len() < MIN_CHORDS {
        return None;
    }
    let fit = regress(&chords, &plane, config.range_noise_m, 0.0)?;
    Some(Patch {
        fit,
        chords,
        edges,
        rectangle,
        points,
    })
}

/// How far a board may go on below its lowest and above its highest chord together, metres.
fn unseen_m(rings: &[Ring], runs: &BTreeMap<usize, Run>, plane: &Plane, most_m: f64) -> f64 {
    let beyond = |run: &Run, next: Option<usize>| {
        let elevation = next
            .and_then(|k| rings.get(k))
            .and_then(Ring::elevation_rad);
        let place = elevation.and_then(|elevation| {
            let (sine, cosine) = elevation.sin_cos();
            let level = run.middle.xy().normalize() * cosine;
            plane.meet(&Vector3::new(level.x, level.y, sine))
        });
        place
            .map_or(most_m, |p| (p - run.middle).norm())
            .min(most_m)
    };
    let low = runs.first_key_value();
    let high = runs.last_key_value();
    low.map_or(0.0, |(k, run)| beyond(run, k.checked_sub(1)))
        + high.map_or(0.0, |(k, run)| beyond(run, Some(k + 1)))
}

/// A plane that a quarter of strangers does not move.
fn trimmed_plane(cloud: &[Vector3<f64>], config: &LidarCameraConfig) -> Option<Plane> {
    let mut plane = Plane::through(cloud)?;
    let mut kept: Vec<(f64, Vector3<f64>)> = Vec::new();
    for round in 0..6 {
        kept.clear();
        kept.extend(cloud.iter().map(|p| (plane.local(p).z.abs(), *p)));
        kept.sort_by(|a, b| a.0.total_cmp(&b.0));
        let limit = (3.0 * config.range_noise_m).max(0.02);
        let inside = kept.partition_point(|k| k.0 < limit);
        let share = if round < 3 {
            7 * kept.len() / 10
        } else {
            inside
        };
        let chosen: Vec<Vector3<f64>> = kept.iter().take(share.max(3)).map(|k| k.1).collect();
        plane = Plane::through(&chosen)?;
    }
    Some(plane)
}

/// The longest run of neighbours that lie on the patch; one lost or odd return does not end it, nor does the seam of the scan.
fn longest_run(ring: &Ring, is_member: &dyn Fn(usize) -> bool) -> Option<Vec<usize>> {
    let n = ring.points.len();
    let seam = (0..n).find(|i| !is_member(*i))?;
    let mut best: Vec<usize> = Vec::new();
    let mut run: Vec<usize> = Vec::new();
    for i in (1..=n).map(|i| (seam + i) % n) {
        let joins = run.last().is_none_or(|last| {
            let turn = (ring.points[i].azimuth_rad - ring.points[*last].azimuth_rad)
                .rem_euclid(std::f64::consts::TAU);
            turn < super::scan_grid::NEIGHBOR_STEPS * ring.step_rad || ring.is_seam(*last, i)
        });
        if is_member(i) && joins {
            run.push(i);
            continue;
        }
        // A single odd return between members is skipped, not taken.
        let ahead = (i + 1) % n;
        if !is_member(i) && !run.is_empty() && ahead != seam && is_member(ahead) {
            continue;
        }
        if run.len() > best.len() {
            std::mem::swap(&mut best, &mut run);
        }
        run.clear();
        if is_member(i) {
            run.push(i);
        }
    }
    if run.len() > best.len() {
        best = run;
    }
    (best.len() >= 3).then_some(best)
}
