//! Files of other conventions that fit the truth's positions and yet are wrong: quaternions in another order or of the inverse, bodies or
//! worlds with other axes, mirrored positions, stamps that are late. None of it shows in the figures but by their size.

mod explained;

use lsfb_geometry::{Matrix3, Quaternion, Se3, UnitQuaternion, Vector3, so3};
use lsfb_types::{Finding, Limit, Verdict};

use crate::alignment::{AlignmentMode, align};
use crate::association::PosePair;

pub(super) use explained::{axes, late_turns, lever, running_clock};

/// Rotations that are as near to the truth as this need no explanation, degrees rms.
const NEAR_DEG: f64 = 10.0;
/// A constant turn of the body that is smaller is not told, degrees.
const LEAST_BODY_TURN_DEG: f64 = 2.0;
/// Orientations that differ from the truth's by less, once their world is turned, are the truth's, radians rms.
const COPIED_RAD: f64 = 1e-5;
/// Turns are compared over about this time, seconds.
const TURN_SECS: f64 = 1.0;
/// Shorter turns than this, radians rms, tell nothing.
const LEAST_TURN: f64 = 0.05;
/// Longer turns have no clear axis, radians.
const LONGEST_TURN: f64 = 2.5;
/// Share of the truth's turns that an estimate of them explains, and that a convention must explain to be named.
const EXPLAINED: f64 = 0.5;
const NAMED: f64 = 0.9;
/// Pairs of poses whose turns are compared.
const MOST_TURNS: usize = 500;
/// By how much a mirror or another clock must lessen the errors to be named.
const LESS: f64 = 0.5;
/// Offsets of stamps that are told, seconds.
const LEAST_OFFSET_SECS: f64 = 2e-3;
/// How often an offset is corrected: an alignment takes up a part of it each time, of a walk in circles the most.
const ROUNDS: usize = 40;
/// Pairs of poses by which it is found.
const MOST_PAIRS: usize = 500;

/// An orientation as another convention has it.
type Change<'a> = dyn Fn(UnitQuaternion<f64>) -> UnitQuaternion<f64> + 'a;

/// What helps where the orientations mean nothing.
const REMEDY: &str = "correct the file, or evaluate only its positions: rotation errors, recall and relative errors are meaningless";

/// What helps where a constant turn is all that is wrong.
const TURNED: &str = "express both in one body frame and one world (`lsfb align` estimates the transforms); rotation errors and recall are dominated by this rotation";

/// What the orientations say, of pairs as they were read and as their positions are aligned; `rotation_deg` is the error of the latter, rms.
pub(super) fn orientations(
    unaligned: &[PosePair],
    aligned: &[PosePair],
    rotation_deg: f64,
) -> Option<Finding> {
    if rotation_deg < NEAR_DEG {
        return small_turn(aligned, rotation_deg);
    }
    let finding = |verdict, explained: f64, what: String| {
        Finding::new("orientations", verdict, "orientations", what)
            .value(100.0 * explained, "%")
            .limit(Limit::AtLeast(100.0 * EXPLAINED))
    };
    let raw = |q: UnitQuaternion<f64>| q.into_inner();
    let of = |w, x, y, z| UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
    let conventions: [(&str, &Change<'_>); 3] = [
        ("have w first, but were read as x, y, z, w", &|q| {
            let q = raw(q);
            of(q.i, q.j, q.k, q.w)
        }),
        ("have w last, but were read as w, x, y, z", &|q| {
            let q = raw(q);
            of(q.k, q.w, q.i, q.j)
        }),
        ("are inverted (world in the body frame)", &|q| q.inverse()),
    ];
    let named = |convention: &str| {
        format!("the estimate's quaternions {convention}: all its rotations are wrong")
    };
    // Turned about one axis alone, quaternions in another order turn about one axis as well: that they would be right tells it.
    let world_turn = first_world_turn(unaligned, aligned)?;
    let right = conventions.iter().find(|(_, change)| {
        let off_deg = apart_deg(unaligned, |q| world_turn * change(q));
        off_deg < NEAR_DEG.min(LESS * rotation_deg)
    });
    if let Some((convention, _)) = right {
        return Some(finding(Verdict::Fail, 0.0, named(convention)).remedy(REMEDY));
    }
    let turns = Turns::of(aligned)?;
    let as_is = turns.explained_by(|q| q);
    if as_is >= EXPLAINED {
        let off = constant_turn(aligned, rotation_deg)?;
        return Some(finding(Verdict::Warn, as_is, off).remedy(TURNED));
    }
    let untouched = Turns::of(unaligned)?;
    let best = conventions
        .iter()
        .map(|(what, change)| (untouched.explained_by(change), *what))
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    let what = match best {
        (explained, convention) if explained >= NAMED => named(convention),
        _ if turns.explained_by_mirror() >= NAMED => {
            "the estimate's rotation is mirrored: its axes are left-handed".to_owned()
        }
        _ => format!(
            "the estimate's orientations do not follow the truth: they explain {:.0} % of its rotation",
            100.0 * as_is.max(0.0)
        ),
    };
    Some(finding(Verdict::Fail, as_is, what).remedy(REMEDY))
}

/// The turn of the world that the alignment by positions made.
fn first_world_turn(unaligned: &[PosePair], aligned: &[PosePair]) -> Option<UnitQuaternion<f64>> {
    let rotation = |pairs: &[PosePair]| Some(pairs.first()?.estimate.world_from_rig.rotation);
    Some(rotation(aligned)? * rotation(unaligned)?.inverse())
}

/// How far the estimate's orientations are from the truth's once they are changed, degrees rms.
fn apart_deg(
    pairs: &[PosePair],
    change: impl Fn(UnitQuaternion<f64>) -> UnitQuaternion<f64>,
) -> f64 {
    let square = |pair: &PosePair| {
        let found = change(pair.estimate.world_from_rig.rotation);
        so3::local(&pair.truth.world_from_rig.rotation, &found).norm_squared()
    };
    let mean = pairs.iter().map(square).sum::<f64>() / pairs.len().max(1) as f64;
    mean.sqrt().to_degrees()
}

/// Whether the estimate's positions are a mirror image of the truth's.
pub(super) fn mirrored(pairs: &[PosePair], best_m: f64) -> Option<Finding> {
    let mirror: Vec<PosePair> = pairs
        .iter()
        .map(|pair| {
            let mut pair = *pair;
            pair.estimate.world_from_rig.translation.z *= -1.0;
            pair
        })
        .collect();
    let mirrored_m = error_m(&mirror, AlignmentMode::Sim3)?;
    (mirrored_m < LESS * best_m).then(|| {
        let what = format!(
            "the estimate is a mirror image: its error is {best_m:.3} m rms, but {mirrored_m:.3} m with one axis reversed"
        );
        Finding::new("mirrored", Verdict::Fail, "positions", what)
            .value(mirrored_m, "m")
            .remedy("two axes are swapped, or the world is left-handed: correct the file")
    })
}

/// Whether the estimate's poses are of the world in the body.
pub(super) fn inverse(pairs: &[PosePair], best_m: f64) -> Option<Finding> {
    let turned: Vec<PosePair> = pairs
        .iter()
        .map(|pair| {
            let mut pair = *pair;
            pair.estimate.world_from_rig = pair.estimate.world_from_rig.inverse();
            pair
        })
        .collect();
    let inverse_m = error_m(&turned, AlignmentMode::Sim3)?;
    (inverse_m < LESS * best_m).then(|| {
        let what = format!(
            "the estimate's poses are inverted (world in the body frame): its error is {best_m:.3} m rms, but {inverse_m:.3} m with every pose inverted"
        );
        Finding::new("inverse", Verdict::Fail, "poses", what)
            .value(inverse_m, "m")
            .remedy("invert every pose (world_from_body), and evaluate again")
    })
}

/// Whether the estimate's stamps are late or early by a constant time.
pub(super) fn clock(pairs: &[PosePair], best_m: f64) -> Option<Finding> {
    let step = pairs.len().div_ceil(MOST_PAIRS).max(1);
    let some: Vec<(PosePair, Vector3<f64>)> = (0..pairs.len())
        .step_by(step)
        .filter_map(|i| Some((*pairs.get(i)?, speed(pairs, i)?)))
        .collect();
    let size: f64 = some.iter().map(|(_, speed)| speed.norm_squared()).sum();
    if !(size > 0.0) {
        return None;
    }
    // The truth at the estimate's stamps, less the offset found so far.
    let at_stamps = |offset_secs: f64| -> Vec<PosePair> {
        let at_stamp = |(pair, speed): &(PosePair, Vector3<f64>)| {
            let later_secs = pair.estimate.time.secs_since(pair.truth.time) - offset_secs;
            let mut pair = *pair;
            pair.truth.world_from_rig.translation += speed * later_secs;
            pair
        };
        some.iter().map(at_stamp).collect()
    };
    let mut offset_secs = 0.0;
    let mut shifted = at_stamps(offset_secs);
    for _ in 0..ROUNDS {
        let alignment = align(&shifted, AlignmentMode::Sim3).ok()?;
        let against: f64 = shifted
            .iter()
            .zip(&some)
            .map(|(pair, (_, speed))| {
                let found = alignment.apply(&pair.estimate.world_from_rig.translation);
                (pair.truth.world_from_rig.translation - found).dot(speed)
            })
            .sum();
        offset_secs += against / size;
        shifted = at_stamps(offset_secs);
    }
    let left_m = error_m(&shifted, AlignmentMode::Sim3)?;
    // Of the same pairs: those between may hold a few that are far off.
    let sampled: Vec<PosePair> = some.iter().map(|(pair, _)| *pair).collect();
    let best_m = best_m.min(error_m(&sampled, AlignmentMode::Sim3)?);
    (left_m < LESS * best_m && offset_secs.abs() > LEAST_OFFSET_SECS).then(|| {
        let side = if offset_secs > 0.0 { "late" } else { "early" };
        let what = format!(
            "the estimate's stamps seem {:.3} s {side}: with corrected stamps its error would be {left_m:.4} m rms instead of {best_m:.4} m",
            offset_secs.abs()
        );
        Finding::new("clock", Verdict::Warn, "stamps", what)
            .value(offset_secs, "s")
            .remedy("check which moment of an exposure or a scan is stamped; `lsfb align` estimates the offset with its standard deviation")
    })
}

/// The truth's velocity at a pair, m/s, between the pairs around it.
fn speed(pairs: &[PosePair], i: usize) -> Option<Vector3<f64>> {
    let before = &pairs.get(i.saturating_sub(1))?.truth;
    let after = &pairs.get((i + 1).min(pairs.len() - 1))?.truth;
    let secs = after.time.secs_since(before.time);
    let way = after.world_from_rig.translation - before.world_from_rig.translation;
    Some(match secs > 0.0 {
        true => way / secs,
        false => Vector3::zeros(),
    })
}

fn error_m(pairs: &[PosePair], mode: AlignmentMode) -> Option<f64> {
    let alignment = align(pairs, mode).ok()?;
    let square = |pair: &PosePair| {
        let found = alignment.apply(&pair.estimate.world_from_rig.translation);
        (found - pair.truth.world_from_rig.translation).norm_squared()
    };
    let mean = pairs.iter().map(square).sum::<f64>() / pairs.len().max(1) as f64;
    Some(mean.sqrt())
}

/// Rotations of truth and estimate at both ends of each turn.
struct Turns(Vec<[[UnitQuaternion<f64>; 2]; 2]>);

impl Turns {
    /// `None` where the truth hardly turns: nothing follows then.
    fn of(aligned: &[PosePair]) -> Option<Self> {
        let step = aligned.len().div_ceil(MOST_TURNS).max(1);
        let mut turns = Vec::new();
        for (i, first) in aligned.iter().enumerate().step_by(step) {
            let due = first.truth.time.plus_secs(TURN_SECS);
            let later = aligned.partition_point(|p| p.truth.time < due).max(i + 1);
            let Some(second) = aligned.get(later) else {
                break;
            };
            let of = |pose: Se3| pose.rotation;
            turns.push([
                [
                    of(first.truth.world_from_rig),
                    of(second.truth.world_from_rig),
                ],
                [
                    of(first.estimate.world_from_rig),
                    of(second.estimate.world_from_rig),
                ],
            ]);
        }
        turns.retain(|[[a, b], _]| so3::local(a, b).norm() < LONGEST_TURN);
        let square: f64 = turns
            .iter()
            .map(|[[a, b], _]| so3::local(a, b).norm_squared())
            .sum();
        let is_turning = square > LEAST_TURN * LEAST_TURN * turns.len() as f64;
        (is_turning && turns.len() >= 10).then_some(Self(turns))
    }

    /// Share of the truth's turns that the estimate's explain once they are changed, whatever the constant turn between the bodies.
    fn explained_by(&self, change: impl Fn(UnitQuaternion<f64>) -> UnitQuaternion<f64>) -> f64 {
        self.explained(change, 1.0)
    }

    /// The same of a mirror image.
    fn explained_by_mirror(&self) -> f64 {
        self.explained(|q| q, -1.0)
    }

    fn explained(
        &self,
        change: impl Fn(UnitQuaternion<f64>) -> UnitQuaternion<f64>,
        sign: f64,
    ) -> f64 {
        let pairs: Vec<[Vector3<f64>; 2]> = self
            .0
            .iter()
            .map(|[[a, b], [c, d]]| {
                [
                    so3::local(a, b),
                    sign * so3::local(&change(*c), &change(*d)),
                ]
            })
            .collect();
        let product: Matrix3<f64> = pairs.iter().map(|[t, e]| t * e.transpose()).sum();
        let Some(turn) = so3::nearest(&product) else {
            return 0.0;
        };
        let size: f64 = pairs.iter().map(|[t, _]| t.norm_squared()).sum();
        let left: f64 = pairs
            .iter()
            .map(|[t, e]| (t - turn * e).norm_squared())
            .sum();
        1.0 - left / size
    }
}

/// How constant turns are, degrees: their scatter about their mean, rms, and the mean.
fn scatter_deg(
    aligned: &[PosePair],
    off: impl Fn(UnitQuaternion<f64>, UnitQuaternion<f64>) -> UnitQuaternion<f64>,
) -> Option<(f64, f64)> {
    let turns = || {
        aligned.iter().map(|p| {
            off(
                p.truth.world_from_rig.rotation,
                p.estimate.world_from_rig.rotation,
            )
        })
    };
    let sum: Matrix3<f64> = turns().map(|q| *q.to_rotation_matrix().matrix()).sum();
    let mean = so3::nearest(&sum)?;
    let square: f64 = turns().map(|q| so3::local(&mean, &q).norm_squared()).sum();
    let rms = (square / aligned.len() as f64).sqrt();
    Some((rms.to_degrees(), mean.angle().to_degrees()))
}

/// Turns between the bodies, and between the worlds.
fn body_turn_deg(aligned: &[PosePair]) -> Option<(f64, f64)> {
    scatter_deg(aligned, |truth, estimate| truth.inverse() * estimate)
}

fn world_turn_deg(aligned: &[PosePair]) -> Option<(f64, f64)> {
    scatter_deg(aligned, |truth, estimate| estimate * truth.inverse())
}

fn other_body((left_deg, turn_deg): (f64, f64)) -> String {
    format!(
        "the estimate's body axes differ from the truth's by a constant rotation of {turn_deg:.1}°, to within {left_deg:.2}° rms: rotation errors are dominated by it"
    )
}

/// A body that is mounted a few degrees off.
fn small_turn(aligned: &[PosePair], rotation_deg: f64) -> Option<Finding> {
    if rotation_deg < LEAST_BODY_TURN_DEG {
        return None;
    }
    Turns::of(aligned)?;
    let (body, world) = (body_turn_deg(aligned)?, world_turn_deg(aligned)?);
    let is_named = body.0 < LESS * rotation_deg && body.0 <= world.0;
    let finding = Finding::new(
        "orientations",
        Verdict::Warn,
        "orientations",
        other_body(body),
    );
    is_named.then(|| finding.value(body.1, "°").remedy(TURNED))
}

/// Orientations of the truth under positions of an estimate.
pub(super) fn copied_orientations(aligned: &[PosePair]) -> Option<Finding> {
    Turns::of(aligned)?;
    let (left_deg, _) = world_turn_deg(aligned)?;
    (left_deg < COPIED_RAD.to_degrees()).then(|| {
        let what = "the orientations of the estimate are identical to the ground truth".to_owned();
        Finding::new("same-orientations", Verdict::Warn, "orientations", what)
            .value(left_deg, "°")
            .remedy("check which file was evaluated, and that the system cannot read the truth")
    })
}

/// Which constant turn makes the orientations alike, where one does.
fn constant_turn(aligned: &[PosePair], rotation_deg: f64) -> Option<String> {
    let (body, world) = (body_turn_deg(aligned)?, world_turn_deg(aligned)?);
    if body.0 <= world.0 && body.0 < LESS * rotation_deg {
        return Some(other_body(body));
    }
    if world.0 < LESS * rotation_deg {
        let (left_deg, turn_deg) = world;
        return Some(format!(
            "the estimate's orientations have another world frame than its positions, rotated by {turn_deg:.1}° throughout, to within {left_deg:.2}° rms: rotation errors are dominated by it"
        ));
    }
    Some("the estimate rotates like the truth, but its orientations have another body frame and another world than its positions".to_owned())
}

#[cfg(test)]
mod tests;
