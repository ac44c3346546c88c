//! Accelerations over three scans each, as accelerometer and scans have them.
//!
//! `(p₂ − p₁) / T₂ − (p₁ − p₀) / T₁ = ∫ w a dt`, with weights `w` that rise from the first scan to 1 at the second and fall to the third: the change of the mean
//! velocity, and the force of the IMU in the world. Between scans the gyroscope has the attitude, which is bent so that it ends in the scans'.

use lsfb_geometry::{IntegratedGyro, Matrix3, StampedPose, UnitQuaternion, Vector3, so3};
use lsfb_types::{ImuSample, Stamped};
use nalgebra::SymmetricEigen;

use super::turns::longest_s;

/// From one scan to the next, seconds, at least, where nothing else is asked for.
pub(super) const LEAST_S: f64 = 0.15;
/// No two samples may be farther apart, seconds.
const MOST_GAP_S: f64 = 0.1;

/// Directions that are not seen and differ by less than this are one: the sine of it, squared.
const UNSEEN_SHARE: f64 = 0.1;

/// What three scans and the samples between them say.
#[derive(Clone, Copy, Debug)]
pub(super) struct Triple {
    /// Acceleration by the scans, m/s².
    pub by_scans: Vector3<f64>,
    /// Mean of the rig's axes in the world (the columns), each times the component `k` of the force: the force in the world is the sum
    /// of the columns `k` of all `k`, m/s².
    pub forces: [Matrix3<f64>; 3],
    /// Mean of the rig's axes in the world.
    pub world_from_rig: Matrix3<f64>,
    /// From the first scan to the third, seconds.
    pub span_s: f64,
    /// Takes what is in the world to the directions in which all three scans see motion: a turn, but for rows of zeros.
    pub seen: Matrix3<f64>,
}

impl Triple {
    /// Force by the IMU in the world, m/s².
    pub fn by_imu(&self) -> Vector3<f64> {
        (0..3).map(|k| self.forces[k].column(k).into_owned()).sum()
    }
}

/// All of a walk, of scans that are at least so far apart, if the stamps of the IMU are so much too late.
pub(super) fn triples(
    by_scans: &[StampedPose],
    unseen: &[Option<Vector3<f64>>],
    samples: &[Stamped<ImuSample>],
    late_s: f64,
    least_s: f64,
) -> Vec<Triple> {
    let longest_s = longest_s(by_scans).max(2.0 * least_s);
    let next_after = |from: usize| {
        let start = by_scans.get(from)?.time;
        let later = by_scans.iter().enumerate().skip(from + 1);
        let mut far = later.skip_while(|(_, p)| p.time.secs_since(start) < least_s);
        let (k, pose) = far.next()?;
        (pose.time.secs_since(start) <= longest_s).then_some(k)
    };
    let triple = |first: usize| {
        let second = next_after(first)?;
        let third = next_after(second)?;
        let scans = [&by_scans[first], &by_scans[second], &by_scans[third]];
        let all = [first, second, third].map(|k| unseen.get(k).copied().flatten());
        Some(Triple {
            seen: seen(&all),
            ..triple(scans, samples, late_s)?
        })
    };
    (0..by_scans.len()).filter_map(triple).collect()
}

fn triple(
    [first, second, third]: [&StampedPose; 3],
    samples: &[Stamped<ImuSample>],
    late_s: f64,
) -> Option<Triple> {
    let (rise_s, fall_s) = (
        second.time.secs_since(first.time),
        third.time.secs_since(second.time),
    );
    let half_s = 0.5 * (rise_s + fall_s);
    let place = |pose: &StampedPose| pose.world_from_rig.translation;
    let mut triple = Triple {
        by_scans: ((place(third) - place(second)) / fall_s
            - (place(second) - place(first)) / rise_s)
            / half_s,
        forces: [Matrix3::zeros(); 3],
        world_from_rig: Matrix3::zeros(),
        span_s: rise_s + fall_s,
        seen: Matrix3::identity(),
    };
    for (begin, end, rises) in [(first, second, true), (second, third, false)] {
        let span_s = end.time.secs_since(begin.time);
        for moment in moments(begin, end, samples, late_s)? {
            let share = moment.at_s / span_s;
            let share = if rises { share } else { 1.0 - share };
            let weight = share * moment.lasts_s / half_s;
            let axes = moment.world_from_rig.to_rotation_matrix().into_inner() * weight;
            triple.world_from_rig += axes;
            for (sum, component) in triple.forces.iter_mut().zip(moment.force) {
                *sum += axes * component;
            }
        }
    }
    Some(triple)
}

/// What is left without directions that are not seen.
fn seen(unseen: &[Option<Vector3<f64>>]) -> Matrix3<f64> {
    let of_all: Matrix3<f64> = unseen.iter().flatten().map(|d| d * d.transpose()).sum();
    if of_all == Matrix3::zeros() {
        return Matrix3::identity();
    }
    let eigen = SymmetricEigen::new(of_all);
    let mut rows = eigen.eigenvectors.transpose();
    for (k, share) in eigen.eigenvalues.iter().enumerate() {
        if *share > UNSEEN_SHARE {
            rows.row_mut(k).fill(0.0);
        }
    }
    rows
}

/// A sample between two scans.
struct Moment {
    /// Since the first of them, and how long the sample stands for, seconds.
    at_s: f64,
    lasts_s: f64,
    force: [f64; 3],
    world_from_rig: UnitQuaternion<f64>,
}

/// The samples between two scans; `None` where there is a gap.
fn moments(
    begin: &StampedPose,
    end: &StampedPose,
    samples: &[Stamped<ImuSample>],
    late_s: f64,
) -> Option<Vec<Moment>> {
    let at_s = |s: &Stamped<ImuSample>| s.time.secs_since(begin.time) - late_s;
    let span_s = end.time.secs_since(begin.time);
    let from = samples.partition_point(|s| at_s(s) < 0.0);
    let to = samples.partition_point(|s| at_s(s) <= span_s);
    let inside = samples.get(from..to)?;
    let rate = |s: &Stamped<ImuSample>| Vector3::from(s.sample.angular_velocity_rad_s);
    let at_begin = inside.first().map(|s| (0.0, rate(s))).into_iter();
    let gyro = IntegratedGyro::new(at_begin.chain(inside.iter().map(|s| (at_s(s), rate(s)))));
    let turned = gyro.rotations().skip(1).map(|(_, turn)| turn);
    let mut before: Option<&Stamped<ImuSample>> = None;
    let mut moments = Vec::with_capacity(inside.len());
    for (k, (sample, turned)) in inside.iter().zip(turned).enumerate() {
        let now_s = at_s(sample);
        let since_s = now_s - before.map_or(0.0, at_s);
        let until_s = inside.get(k + 1).map_or(span_s, at_s);
        if since_s > MOST_GAP_S || until_s - now_s > MOST_GAP_S {
            return None;
        }
        // Each stands for what is nearer to it than to another.
        let opens_s = before.map_or(0.0, |_| now_s - 0.5 * since_s);
        let closes_s = inside
            .get(k + 1)
            .map_or(span_s, |_| 0.5 * (now_s + until_s));
        moments.push(Moment {
            at_s: now_s,
            lasts_s: closes_s - opens_s,
            force: sample.sample.specific_force_m_s2,
            world_from_rig: begin.world_from_rig.rotation * turned,
        });
        before = Some(sample);
    }
    let last = moments.last()?;
    let bend = so3::local(&last.world_from_rig, &end.world_from_rig.rotation);
    for moment in &mut moments {
        let share = moment.at_s / span_s;
        moment.world_from_rig = so3::retract(&moment.world_from_rig, &(bend * share));
    }
    Some(moments)
}
