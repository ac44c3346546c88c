//! How keyframes lie to each other, along the shortest way through the odometry and the loops accepted so far.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use lsfb_geometry::{Matrix6, Se3};

use super::Measured;
use super::keyframes::{Keyframe, added};

/// By how much the odometry's standard deviations are widened before a loop is held against them: where scans do not see all of the
/// motion six of ten poses were within what should hold 95 of 100.
const WIDENED: f64 = 2.0;
/// What a step adds at least, per square root of a metre: metres and radians.
const STEP_M: f64 = 0.005;
const STEP_RAD: f64 = 0.000_1;
/// What any step may be off by: metres and radians.
const LEAST_M: f64 = 0.001;
const LEAST_RAD: f64 = 0.000_03;
/// How far a way along a loop is counted, metres.
const LOOP_M: f64 = 0.5;

/// What is known of the pose of one keyframe on another.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Way {
    /// Pose of the keyframe asked about, in the frame of this one.
    pub here_from_target: Se3,
    /// Covariance in the tangent of the keyframe asked about.
    pub covariance: Matrix6<f64>,
    /// Length of the way, metres.
    pub length_m: f64,
}

#[derive(Clone, Copy, Debug)]
struct Edge {
    to: usize,
    to_from_here: Se3,
    /// In the tangent of the keyframe that it begins at.
    covariance: Matrix6<f64>,
    length_m: f64,
}

/// Keyframes and what is known between them.
#[derive(Clone, Debug)]
pub(crate) struct Ways(Vec<Vec<Edge>>);

/// What the odometry adds from a keyframe to the next, in the tangent of the next.
pub(super) fn step_covariance(from: &Keyframe, to: &Keyframe, widened: f64) -> Matrix6<f64> {
    let to_from_from = to.world_from_rig.inverse() * from.world_from_rig;
    let by_odometry = added(&to.covariance, &from.covariance, &to_from_from);
    let length_m = (to.path_m - from.path_m).max(0.0);
    let mut floor = Matrix6::zeros();
    let turn = LEAST_RAD.powi(2) + STEP_RAD.powi(2) * length_m;
    let shift = LEAST_M.powi(2) + STEP_M.powi(2) * length_m;
    for k in 0..3 {
        floor[(k, k)] = turn;
        floor[(k + 3, k + 3)] = shift;
    }
    by_odometry * (widened * widened) + floor
}

/// Standard deviations of the odometry, as loops are held against them.
pub(super) fn widened_step(from: &Keyframe, to: &Keyframe) -> Matrix6<f64> {
    step_covariance(from, to, WIDENED)
}

impl Ways {
    /// Along the odometry alone.
    pub fn new(keyframes: &[Keyframe]) -> Self {
        let mut ways = Self(Vec::new());
        for k in 0..keyframes.len() {
            ways.go_on(&keyframes[..=k]);
        }
        ways
    }

    /// Goes on along the odometry to the last of the keyframes; all before it are in already.
    pub fn go_on(&mut self, keyframes: &[Keyframe]) {
        self.0.push(Vec::new());
        let [.., before, last] = keyframes else {
            return;
        };
        let before_from_last = before.world_from_rig.inverse() * last.world_from_rig;
        let covariance = widened_step(before, last);
        let length_m = last.path_m - before.path_m;
        let number = keyframes.len() - 1;
        self.join(number - 1, number, &before_from_last, &covariance, length_m);
    }

    /// Adds a loop that is accepted.
    pub fn accept(&mut self, measured: &Measured) {
        let Measured {
            earlier,
            later,
            loop_,
        } = measured;
        let covariance = loop_.covariance();
        self.join(
            *earlier,
            *later,
            &loop_.earlier_from_later,
            &covariance,
            LOOP_M,
        );
    }

    fn join(
        &mut self,
        a: usize,
        b: usize,
        a_from_b: &Se3,
        covariance_at_b: &Matrix6<f64>,
        length_m: f64,
    ) {
        let adjoint = a_from_b.adjoint();
        self.0[b].push(Edge {
            to: a,
            to_from_here: *a_from_b,
            covariance: *covariance_at_b,
            length_m,
        });
        self.0[a].push(Edge {
            to: b,
            to_from_here: a_from_b.inverse(),
            covariance: adjoint * covariance_at_b * adjoint.transpose(),
            length_m,
        });
    }

    /// How the keyframe `target` lies to each of the others, by the shortest way (Dijkstra).
    pub fn to(&self, target: usize) -> Vec<Option<Way>> {
        let mut ways: Vec<Option<Way>> = vec![None; self.0.len()];
        let mut is_done = vec![false; self.0.len()];
        let mut open = BinaryHeap::new();
        if let Some(start) = ways.get_mut(target) {
            *start = Some(Way {
                here_from_target: Se3::identity(),
                covariance: Matrix6::zeros(),
                length_m: 0.0,
            });
            open.push(Reverse((0_u64, target)));
        }
        while let Some(Reverse((_, here))) = open.pop() {
            let Some(way) = ways[here].filter(|_| !std::mem::replace(&mut is_done[here], true))
            else {
                continue;
            };
            for edge in &self.0[here] {
                let length_m = way.length_m + edge.length_m;
                let is_shorter = ways[edge.to].is_none_or(|known| length_m < known.length_m);
                if is_shorter && !is_done[edge.to] {
                    // v_from_u exp(ξ) u_from_t = v_from_t exp(Ad(t_from_u) ξ)
                    let adjoint = way.here_from_target.inverse().adjoint();
                    let by_edge = adjoint * edge.covariance * adjoint.transpose();
                    ways[edge.to] = Some(Way {
                        here_from_target: edge.to_from_here * way.here_from_target,
                        covariance: way.covariance + by_edge,
                        length_m,
                    });
                    // Lengths are no less than zero: their bits are in order.
                    open.push(Reverse((length_m.to_bits(), edge.to)));
                }
            }
        }
        ways
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector6;
    use lsfb_types::Timestamp;

    use super::*;
    use crate::loops::MeasuredLoop;

    /// Back at the start after 40 m, a loop is the shorter way, and the better known.
    #[test]
    fn the_shortest_way_is_taken_with_its_covariance() {
        let keyframes: Vec<Keyframe> = (0..41)
            .map(|k| Keyframe {
                scan: k,
                time: Timestamp::from_nanos(k as i64 * 1_000_000_000),
                world_from_rig: Se3::exp(&Vector6::new(
                    0.0,
                    0.0,
                    0.02 * k as f64,
                    k as f64,
                    0.3 * k as f64,
                    0.0,
                )),
                covariance: Matrix6::identity() * (1e-4 * k as f64),
                path_m: k as f64,
            })
            .collect();
        let mut ways = Ways::new(&keyframes);
        let by_odometry = ways.to(40)[0].expect("a way");
        let expected = keyframes[0].world_from_rig.inverse() * keyframes[40].world_from_rig;
        let off = expected.inverse() * by_odometry.here_from_target;
        assert!(off.log().norm() < 1e-9);
        assert!((by_odometry.length_m - 40.0).abs() < 1e-9);
        let closed = Se3::exp(&Vector6::new(0.1, 0.0, 0.0, 0.5, 0.0, 0.0));
        ways.accept(&Measured {
            earlier: 0,
            later: 38,
            loop_: MeasuredLoop {
                earlier_from_later: closed,
                rotation_sigma_rad: 0.01,
                translation_sigma_m: 0.01,
            },
        });
        let by_loop = ways.to(40)[0].expect("a way");
        assert!((by_loop.length_m - 2.5).abs() < 1e-9);
        assert!(by_loop.covariance.trace() < 0.3 * by_odometry.covariance.trace());
        let between = keyframes[38].world_from_rig.inverse() * keyframes[40].world_from_rig;
        let off = (closed * between).inverse() * by_loop.here_from_target;
        assert!(off.log().norm() < 1e-9);
    }
}
