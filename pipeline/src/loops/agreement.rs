//! Whether two loops that were measured on their own lead to the same pose.

use lsfb_geometry::Matrix6;

use super::Measured;
use super::assessment::CHI_SQUARED;
use super::keyframes::Keyframe;
use super::ways::widened_step;

/// Loops whose visits are farther apart than this, along the way, tell nothing of each other, metres.
const NEAR_M: f64 = 15.0;
/// Nearer than this the same scans are looked at, metres.
const APART_M: f64 = 0.5;

/// Whether two loops are of neighbouring places, of different scans, and lead to one pose.
pub(crate) fn agree(a: &Measured, b: &Measured, keyframes: &[Keyframe]) -> bool {
    let path_m = |k: usize| keyframes[k].path_m;
    let apart_m = (path_m(a.later) - path_m(b.later)).abs();
    let is_near = apart_m <= NEAR_M && (path_m(a.earlier) - path_m(b.earlier)).abs() <= NEAR_M;
    if !is_near || apart_m < APART_M {
        return false;
    }
    let pose = |k: usize| keyframes[k].world_from_rig;
    let earlier_b_from_a = pose(b.earlier).inverse() * pose(a.earlier);
    let later_a_from_b = pose(a.later).inverse() * pose(b.later);
    let by_a = earlier_b_from_a * a.loop_.earlier_from_later * later_a_from_b;
    let off = by_a.local(&b.loop_.earlier_from_later);
    // All in the tangent of the later pose of `b`.
    let moved = |covariance: &Matrix6<f64>, to_b_from_there: &lsfb_geometry::Se3| {
        let adjoint = to_b_from_there.adjoint();
        adjoint * covariance * adjoint.transpose()
    };
    let of_earlier = between(keyframes, a.earlier, b.earlier);
    let of_later = between(keyframes, a.later, b.later);
    let covariance = moved(
        &of_earlier,
        &(b.loop_.earlier_from_later.inverse() * earlier_b_from_a * pose(a.earlier).inverse()),
    ) + moved(&of_later, &pose(b.later).inverse())
        + moved(&a.loop_.covariance(), &later_a_from_b.inverse())
        + b.loop_.covariance();
    covariance
        .cholesky()
        .is_some_and(|c| off.dot(&c.solve(&off)) < CHI_SQUARED)
}

/// What the odometry adds between two keyframes, as an error in the world's frame.
fn between(keyframes: &[Keyframe], a: usize, b: usize) -> Matrix6<f64> {
    let (from, to) = (a.min(b), a.max(b));
    let steps = keyframes[from..=to].windows(2);
    let in_world = steps.map(|pair| {
        let adjoint = pair[1].world_from_rig.adjoint();
        adjoint * widened_step(&pair[0], &pair[1]) * adjoint.transpose()
    });
    in_world.sum()
}
