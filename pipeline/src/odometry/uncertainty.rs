//! How far a pose may be off, relative to the first one.
//!
//! Two errors make it up. That of the scan against the map is the filter's: what the scan sees and what carried the rest. That of the
//! map itself is inherited: a surface is as wrong as the pose from which it was first seen, moved with it as one rigid piece. A scan
//! takes over the error of the surfaces it is held by, as far as it is held by them; what it adds to the map is as wrong as its own
//! pose. So uncertainty grows by generations of surfaces and not by scans: in a room that stays in view it stands still, along a
//! corridor it grows, and what a blind stretch left behind does not vanish where the place is seen well again.

use lsfb_geometry::{Matrix6, Se3, Vector6};
use nalgebra::{SMatrix, SymmetricEigen};

use super::USUAL_RANGE_M;

type Matrix12 = SMatrix<f64, 12, 12>;

/// Covariance of a state whose first six numbers are a pose, once a scan gave `information` on the pose. `None` where the covariance is
/// none.
pub(super) fn once_seen<const N: usize>(
    covariance: &SMatrix<f64, N, N>,
    information: &Matrix6<f64>,
) -> Option<SMatrix<f64, N, N>> {
    let prior: Matrix6<f64> = covariance.fixed_view::<6, 6>(0, 0).into();
    let prior_inverse = prior.cholesky()?.inverse();
    let all_by_pose = covariance.fixed_columns::<6>(0) * prior_inverse;
    // P⁺ = P − P_:p P_pp⁻¹ (P_pp − (P_pp⁻¹ + H)⁻¹) P_pp⁻¹ P_p:
    let posterior = (prior_inverse + information).cholesky()?;
    let reduced = prior - posterior.inverse();
    let updated = covariance - all_by_pose * reduced * all_by_pose.transpose();
    Some((updated + updated.transpose()) * 0.5)
}

/// A pose, and how far what was drawn from it may be off, in its tangent.
#[derive(Clone, Copy, Debug)]
struct Origin {
    world_from_rig: Se3,
    covariance: Matrix6<f64>,
}

/// Scans that fill the surfaces of a place: of those that come later, who stands there for minutes, hardly a point is taken.
const SCANS_PER_PLACE: u32 = 20;

/// Follows what poses inherit from the map.
#[derive(Clone, Debug, Default)]
pub(super) struct Uncertainty {
    /// By the number of the place from which surfaces were first seen; the first stands for none.
    places: Vec<Origin>,
    /// Scans drawn from the last of them.
    scans_here: u32,
    /// The last pose, with what it inherited from the map.
    inherited: Option<Origin>,
}

impl Uncertainty {
    /// Covariance of a pose in its tangent `[rotation, translation]`.
    ///
    /// `against_map` is the covariance as if the map were exact, `gain` the share of the scan in the pose, and `first_seen_from` the places
    /// of the surfaces that hold it.
    pub fn take(
        &mut self,
        world_from_rig: &Se3,
        against_map: &Matrix6<f64>,
        gain: &Matrix6<f64>,
        first_seen_from: &[u32],
    ) -> Matrix6<f64> {
        let from_before = self
            .inherited
            .map_or_else(Matrix6::zeros, |before| moved(&before, world_from_rig));
        let from_map = self.of_map(world_from_rig, first_seen_from);
        let from_map = from_map.unwrap_or(from_before);
        // Both are errors of the same map: they add up, and do not average out.
        let rest = Matrix6::identity() - gain;
        let factor = gain * root(&from_map) + rest * root(&from_before);
        let inherited = factor * factor.transpose();
        self.inherited = Some(Origin {
            world_from_rig: *world_from_rig,
            covariance: inherited,
        });
        against_map + inherited
    }

    /// Notes that surfaces are drawn from this pose, at the map's place of that number. What is drawn from a place in several scans is taken to
    /// be as wrong as the last of them: the first pose of a walk is exact, and those in which it stands there no longer.
    pub fn draw(&mut self, place: u32, world_from_rig: &Se3, covariance: &Matrix6<f64>) {
        let origin = Origin {
            world_from_rig: *world_from_rig,
            covariance: *covariance,
        };
        if self.places.len() <= place as usize {
            self.places.resize(place as usize + 1, origin);
            self.scans_here = 0;
        }
        if self.scans_here < SCANS_PER_PLACE
            && let Some(last) = self.places.get_mut(place as usize)
        {
            *last = origin;
        }
        self.scans_here += 1;
    }

    fn of_map(&self, world_from_rig: &Se3, first_seen_from: &[u32]) -> Option<Matrix6<f64>> {
        let mut counts = vec![0_u32; self.places.len()];
        for place in first_seen_from {
            if let Some(count) = counts.get_mut(*place as usize) {
                *count += 1;
            }
        }
        let all: u32 = counts.iter().sum();
        let of_places = self.places.iter().zip(&counts).filter(|(_, n)| **n > 0);
        let sum: Matrix6<f64> = of_places
            .map(|(place, n)| moved(place, world_from_rig) * f64::from(*n))
            .sum();
        (all > 0).then(|| sum / f64::from(all))
    }
}

/// The error of an origin, as a rigid motion of all that was drawn from it, in the tangent of another pose.
fn moved(origin: &Origin, world_from_rig: &Se3) -> Matrix6<f64> {
    let adjoint = (world_from_rig.inverse() * origin.world_from_rig).adjoint();
    adjoint * origin.covariance * adjoint.transpose()
}

/// `F` with `F Fᵀ` the covariance: the symmetric one, with rotations in metres at a usual range. Factors of two covariances are added as if they
/// were of the same errors, so the errors must lie in them the same way, whatever the axes: triangular ones of errors that a scan sees one direction
/// after the other made directions depend on each other that do not, and a turn look surer than any of its axes.
fn root(covariance: &Matrix6<f64>) -> Matrix6<f64> {
    const R: f64 = USUAL_RANGE_M;
    let metres = Matrix6::from_diagonal(&Vector6::new(R, R, R, 1.0, 1.0, 1.0));
    let units = Matrix6::from_diagonal(&Vector6::new(1.0 / R, 1.0 / R, 1.0 / R, 1.0, 1.0, 1.0));
    let scaled = metres * covariance * metres;
    let eigen = SymmetricEigen::new((scaled + scaled.transpose()) * 0.5);
    let roots = eigen.eigenvalues.map(|value| value.max(0.0).sqrt());
    units * eigen.eigenvectors * Matrix6::from_diagonal(&roots) * eigen.eigenvectors.transpose()
}

/// What may change of the motion of a carrier between scans, where no IMU tells: rad/s² and m/s².
const UNSEEN_TURN_RAD_S2: f64 = 2.0;
const UNSEEN_ACCELERATION_M_S2: f64 = 2.0;
/// What is known of the motion at first, rad/s and m/s.
const FIRST_TURN_RAD_S: f64 = 1.0;
const FIRST_SPEED_M_S: f64 = 2.0;

/// Covariance of pose and twist where motion is taken to continue as it was.
#[derive(Clone, Copy, Debug)]
pub(super) struct ConstantMotionCovariance(Matrix12);

impl ConstantMotionCovariance {
    /// Of the first pose, which is exact, and a motion of which nothing is known.
    pub fn start() -> Self {
        let mut covariance = Matrix12::identity() * 1e-10;
        let mut set = |at: usize, sigma: f64| {
            let mut block = covariance.fixed_view_mut::<3, 3>(at, at);
            block.fill_diagonal(sigma * sigma);
        };
        set(6, FIRST_TURN_RAD_S);
        set(9, FIRST_SPEED_M_S);
        Self(covariance)
    }

    /// After a step that was predicted to lead from one pose to another in `secs`.
    pub fn predict(&mut self, start: &Se3, end: &Se3, secs: f64) {
        let mut f = Matrix12::identity();
        let back = (end.inverse() * *start).adjoint();
        f.fixed_view_mut::<6, 6>(0, 0).copy_from(&back);
        f.fixed_view_mut::<6, 6>(0, 6).fill_diagonal(secs);
        self.0 = f * self.0 * f.transpose();
        let changes = [
            (0, 0.5 * secs * secs * UNSEEN_TURN_RAD_S2),
            (3, 0.5 * secs * secs * UNSEEN_ACCELERATION_M_S2),
            (6, secs * UNSEEN_TURN_RAD_S2),
            (9, secs * UNSEEN_ACCELERATION_M_S2),
        ];
        for (at, sigma) in changes {
            for k in at..at + 3 {
                self.0[(k, k)] += sigma * sigma;
            }
        }
    }

    /// Once a scan gave `information` on the pose.
    pub fn correct(&mut self, information: &Matrix6<f64>) {
        if let Some(seen) = once_seen(&self.0, information) {
            self.0 = seen;
        }
    }

    /// Of the pose.
    pub fn of_pose(&self) -> Matrix6<f64> {
        self.0.fixed_view::<6, 6>(0, 0).into()
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Matrix3, Vector3};

    use super::*;

    /// A carrier that stood, and sees its map again in one direction after the other: naively the factors of what it inherits were triangular, and
    /// turns about slanting axes came out surer than what they were inherited from (in a simulated corridor three times).
    #[test]
    fn what_is_inherited_direction_by_direction_is_inherited_whole() {
        let pose = Se3::identity();
        let sigma_rad: f64 = 1.5e-3;
        let of_map = Matrix6::identity() * sigma_rad.powi(2);
        let mut uncertainty = Uncertainty::default();
        uncertainty.draw(1, &pose, &of_map);
        // The axes of rotation that are seen: one slanting, and two across it.
        let u = Vector3::new(1.0, 2.0, 2.0) / 3.0;
        let v = Vector3::new(2.0, 1.0, -2.0) / 3.0;
        let nothing = Matrix6::identity() * 1e-18;
        let mut last = Matrix6::zeros();
        for axis in [u, v, u.cross(&v)].iter().cycle().take(12) {
            let mut gain = Matrix6::zeros();
            let mut turn = gain.fixed_view_mut::<3, 3>(0, 0);
            turn.copy_from(&(axis * axis.transpose() * 0.7));
            last = uncertainty.take(&pose, &nothing, &gain, &[1, 1]);
        }
        let turn: Matrix3<f64> = last.fixed_view::<3, 3>(0, 0).into();
        let sigmas_rad = turn.symmetric_eigenvalues().map(f64::sqrt);
        assert!(sigmas_rad.min() > 0.97 * sigma_rad, "{sigmas_rad}");
        assert!(sigmas_rad.max() < 1.01 * sigma_rad, "{sigmas_rad}");
    }

    /// Naively a scan that sees its surroundings to a millimetre is as sure of its place, wherever these surroundings were drawn from.
    #[test]
    fn what_a_blind_stretch_left_behind_stays_where_the_place_is_seen_well_again() {
        let at = |x: f64| Se3::exp(&Vector6::new(0.0, 0.0, 0.0, x, 0.0, 0.0));
        let sure = Matrix6::identity() * 1e-6;
        let mut blind = sure;
        blind[(3, 3)] = 0.25;
        let mut uncertainty = Uncertainty::default();
        uncertainty.draw(1, &at(0.0), &sure);
        uncertainty.draw(2, &at(30.0), &blind);
        let whole = Matrix6::identity();
        // Held by what was drawn at the end of the stretch.
        let new = uncertainty.take(&at(31.0), &sure, &whole, &[2, 2, 2]);
        assert!((new[(3, 3)].sqrt() - 0.5).abs() < 0.01, "{new}");
        // Nothing holds it: what it had before is carried on.
        let carried = uncertainty.take(&at(31.5), &sure, &Matrix6::zeros(), &[]);
        assert!((carried[(3, 3)].sqrt() - 0.5).abs() < 0.01, "{carried}");
        // Back where it began.
        let back = uncertainty.take(&at(1.0), &sure, &whole, &[1, 1, 1]);
        assert!(back[(3, 3)].sqrt() < 0.01, "{back}");
        // A turn that the map is off by moves what is far from where it was drawn.
        let far = uncertainty.take(&at(100.0), &sure, &whole, &[1]);
        assert!((far[(4, 4)].sqrt() - 0.1).abs() < 0.01, "{far}");
    }

    /// One scan takes away what it sees of the motion, and leaves the rest.
    #[test]
    fn an_even_motion_grows_uncertain_where_it_is_not_seen() {
        let mut covariance = ConstantMotionCovariance::start();
        let mut information = Matrix6::identity() * 1e6;
        information[(3, 3)] = 0.0;
        for _ in 0..20 {
            covariance.predict(&Se3::identity(), &Se3::identity(), 0.1);
            covariance.correct(&information);
        }
        let of_pose = covariance.of_pose();
        assert!(of_pose[(3, 3)].sqrt() > FIRST_SPEED_M_S, "{of_pose}");
        for k in [0, 1, 2, 4, 5] {
            assert!(of_pose[(k, k)].sqrt() < 0.002, "{k}: {of_pose}");
        }
    }
}
