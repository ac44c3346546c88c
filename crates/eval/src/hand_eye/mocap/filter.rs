//! Forward through all poses of the motion capture and back again: a Kalman filter with the smoother of Rauch, Tung and Striebel.
//!
//! A first pass linearizes where the filter is. It learns from many a guess of the markers' place on the IMU, and so believes to know more than it
//! does: by 20 mm where it says 1 mm. The next linearize about what the pass before found, which is Gauss–Newton on all poses at once.
//!
//! For the same reason the first pass leaves no pose out: one that is far from the prediction only counts less, so that a filter that believes
//! too much still comes back to the poses. The next weigh each pose by how far it was from what the pass before found.

use lsfb_geometry::{ImuNoiseModel, Matrix3, Matrix6, Se3, Vector3, Vector6, so3};
use nalgebra::SMatrix;

use crate::Error;

use super::motion::{
    CLOCK, Error25, ImuState, Inertial, MOUNT_PLACE, MOUNT_ROTATION, Matrix25, PLACE, ROTATION,
    SIZE, VELOCITY,
};

type ByState = SMatrix<f64, 6, SIZE>;

/// Squared norm of a miss, in units of its covariance, beyond which a pose is an outlier: one of 25 000 of six numbers.
const GATE: f64 = 30.0;

/// A time of the IMU's clock, seconds, and the pose of the markers there; none where they were dropped.
#[derive(Clone, Copy, Debug)]
pub(super) struct MarkerPose {
    pub secs: f64,
    pub markers: Option<Se3>,
}

/// What is assumed of both.
#[derive(Clone, Debug)]
pub(super) struct Model {
    pub noise: ImuNoiseModel,
    /// Random walk of the clock, s/√s.
    pub clock_walk: f64,
    /// Standard deviations of a component of the motion capture's rotations and positions, rad and metres.
    pub sigmas: [f64; 2],
}

/// The state at one time, after all of them have spoken.
#[derive(Clone, Debug)]
pub(super) struct Smoothed {
    pub state: ImuState,
    pub covariance: Matrix25,
    /// What is left over of a pose, `[rotation, translation]` in the markers' body, rad and metres; `None` where markers were dropped.
    pub left: Option<Vector6<f64>>,
    /// Its squared norm in units of its covariance.
    squared: f64,
}

impl Smoothed {
    /// What is left over of a pose that fits; `None` where markers were dropped or swapped.
    pub fn fits(&self) -> Option<Vector6<f64>> {
        self.left.filter(|_| self.squared <= GATE)
    }

    /// The information of this pose in the next pass, as a share of that of one that fits: what is far counts less, in the last passes not at all.
    pub fn weight(&self, is_last: bool) -> f64 {
        match self.squared <= GATE {
            true => 1.0,
            false if is_last => 0.0,
            false => (GATE / self.squared).powi(2),
        }
    }
}

/// A time on the way forward: where it was linearized, and errors from there with their covariances.
struct Step {
    /// From the errors of the step before.
    transition: Matrix25,
    nominal: ImuState,
    predicted: Error25,
    predicted_covariance: Matrix25,
    filtered: Error25,
    filtered_covariance: Matrix25,
}

/// About what to linearize.
#[derive(Clone, Copy)]
pub(super) enum About<'a> {
    /// Where the filter is, from a state of the first time.
    Filter(&'a ImuState),
    /// A state for each time, and the weight of its pose, 0 to 1.
    States(&'a [ImuState], &'a [f64]),
}

/// `seen` in order of time, all within the samples; `covariance` is known of the first state before.
pub(super) fn smooth(
    inertial: &Inertial,
    seen: &[MarkerPose],
    about: About<'_>,
    covariance: &Matrix25,
    model: &Model,
) -> Result<Vec<Smoothed>, Error> {
    let mut steps: Vec<Step> = Vec::with_capacity(seen.len());
    let mut before: Option<f64> = None;
    for (k, pose) in seen.iter().enumerate() {
        let given = match about {
            About::Filter(_) => None,
            About::States(states, _) => states.get(k).copied(),
        };
        let weight = match about {
            About::Filter(_) => None,
            About::States(_, weights) => weights.get(k).copied(),
        };
        let last = steps.last().zip(before);
        let (transition, nominal, predicted, predicted_covariance) = match (last, about) {
            (None, About::Filter(start)) => {
                (Matrix25::identity(), *start, Error25::zeros(), *covariance)
            }
            (None, About::States(states, _)) => {
                let Some(start) = states.first() else { break };
                (Matrix25::identity(), *start, Error25::zeros(), *covariance)
            }
            (Some((last, before)), _) => {
                let (base, error) = match given {
                    Some(_) => (last.nominal, last.filtered),
                    None => (last.nominal.retract(&last.filtered), Error25::zeros()),
                };
                let moved =
                    inertial.moved(&base, before, pose.secs, &model.noise, model.clock_walk);
                let nominal = given.unwrap_or(moved.state);
                let predicted = moved.transition * error + nominal.local(&moved.state);
                let known =
                    moved.transition * last.filtered_covariance * moved.transition.transpose()
                        + moved.added;
                let known = (known + known.transpose()) * 0.5;
                (moved.transition, nominal, predicted, known)
            }
        };
        before = Some(pose.secs);
        let found = corrected(
            inertial,
            pose,
            &nominal,
            &predicted,
            &predicted_covariance,
            model,
            weight,
        );
        let (filtered, filtered_covariance) = found.unwrap_or((predicted, predicted_covariance));
        steps.push(Step {
            transition,
            nominal,
            predicted,
            predicted_covariance,
            filtered,
            filtered_covariance,
        });
    }
    backward(inertial, &steps, seen, model)
}

/// The error and its covariance with one pose more; without a weight it follows from how far the pose is from the prediction. `None` where
/// nothing is added.
fn corrected(
    inertial: &Inertial,
    seen: &MarkerPose,
    nominal: &ImuState,
    error: &Error25,
    known: &Matrix25,
    model: &Model,
    weight: Option<f64>,
) -> Option<(Error25, Matrix25)> {
    let (miss, by_state) = miss(inertial, seen.secs, &seen.markers?, nominal);
    let miss = miss - by_state * error;
    let weight = match weight {
        Some(weight) => weight,
        None => {
            let spread = by_state * known * by_state.transpose() + own(model);
            let squared = miss.dot(&spread.cholesky()?.solve(&miss));
            (GATE / squared.max(GATE)).powi(2)
        }
    };
    if !(weight > 0.0) {
        return None;
    }
    let own = own(model) / weight;
    let spread = (by_state * known * by_state.transpose() + own).cholesky()?;
    let gain = spread.solve(&(by_state * known)).transpose();
    let rest = Matrix25::identity() - gain * by_state;
    // Joseph's form stays positive.
    let surer = rest * known * rest.transpose() + gain * own * gain.transpose();
    Some((error + gain * miss, surer))
}

/// Covariance of a pose of the motion capture.
fn own(model: &Model) -> Matrix6<f64> {
    let [turn, shift] = model.sigmas.map(|s| s * s);
    Matrix6::from_diagonal(&Vector6::new(turn, turn, turn, shift, shift, shift))
}

/// A state at the time at which the markers were seen.
fn on_time(state: &ImuState, turn_rad_s: &Vector3<f64>) -> ImuState {
    ImuState {
        rotation: so3::retract(&state.rotation, &(turn_rad_s * state.clock_secs)),
        place: state.place + state.velocity * state.clock_secs,
        ..*state
    }
}

/// What is seen less what should be, rotation in the markers' body and position in the world, and its derivative by the state's error.
fn miss(inertial: &Inertial, secs: f64, seen: &Se3, state: &ImuState) -> (Vector6<f64>, ByState) {
    let turn = inertial.at(secs).0 - state.gyro_bias;
    let now = on_time(state, &turn);
    let expected = now.markers();
    let mut miss = Vector6::zeros();
    let off = so3::local(&expected.rotation, &seen.rotation);
    miss.fixed_rows_mut::<3>(0).copy_from(&off);
    let apart = seen.translation - expected.translation;
    miss.fixed_rows_mut::<3>(3).copy_from(&apart);
    let to_markers = state
        .mount
        .rotation
        .inverse()
        .to_rotation_matrix()
        .into_inner();
    let rotation = now.rotation.to_rotation_matrix().into_inner();
    let arm = state.mount.translation;
    let mut by_state = ByState::zeros();
    let mut put = |row: usize, column: usize, value: Matrix3<f64>| {
        by_state
            .fixed_view_mut::<3, 3>(row, column)
            .copy_from(&value);
    };
    put(0, ROTATION, to_markers);
    put(0, MOUNT_ROTATION, Matrix3::identity());
    put(3, ROTATION, -(rotation * so3::hat(&arm)));
    put(3, PLACE, Matrix3::identity());
    put(3, VELOCITY, Matrix3::identity() * state.clock_secs);
    put(3, MOUNT_PLACE, rotation);
    let by_clock: [Vector3<f64>; 2] = [
        to_markers * turn,
        state.velocity + rotation * turn.cross(&arm),
    ];
    by_state
        .fixed_view_mut::<3, 1>(0, CLOCK)
        .copy_from(&by_clock[0]);
    by_state
        .fixed_view_mut::<3, 1>(3, CLOCK)
        .copy_from(&by_clock[1]);
    (miss, by_state)
}

fn backward(
    inertial: &Inertial,
    steps: &[Step],
    seen: &[MarkerPose],
    model: &Model,
) -> Result<Vec<Smoothed>, Error> {
    let mut found: Vec<Smoothed> = Vec::with_capacity(steps.len());
    let mut later: Option<(&Step, Error25, Matrix25)> = None;
    for (step, seen) in steps.iter().zip(seen).rev() {
        let (mut error, mut covariance) = (step.filtered, step.filtered_covariance);
        if let Some((next, next_error, next_covariance)) = later {
            let factor = next.predicted_covariance.cholesky();
            let factor = factor.ok_or(Error::Unstable { secs: seen.secs })?;
            let gain = factor.solve(&(next.transition * covariance)).transpose();
            error += gain * (next_error - next.predicted);
            let more = next_covariance - next.predicted_covariance;
            covariance += gain * more * gain.transpose();
            covariance = (covariance + covariance.transpose()) * 0.5;
        }
        let state = step.nominal.retract(&error);
        let mut smoothed = Smoothed {
            state,
            covariance,
            left: None,
            squared: f64::INFINITY,
        };
        if let Some(markers) = &seen.markers {
            let (miss, by_state) = miss(inertial, seen.secs, markers, &state);
            let spread = by_state * covariance * by_state.transpose() + own(model);
            if let Some(factor) = spread.cholesky() {
                smoothed.squared = miss.dot(&factor.solve(&miss));
            }
            let turn = inertial.at(seen.secs).0 - state.gyro_bias;
            smoothed.left = Some(on_time(&state, &turn).markers().local(markers));
        }
        found.push(smoothed);
        later = Some((step, error, covariance));
    }
    found.reverse();
    Ok(found)
}
