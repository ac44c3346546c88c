//! A device that stands.

use super::super::walk::{LocalObservation, LocalPoint};
use super::*;

/// A point that one camera saw twice from one place has no distance by these two sights; with nothing known of it besides, no pose of
/// the window had a covariance, and glasses that stood at first lost their first second.
#[test]
fn a_point_without_a_distance_makes_no_pose_uncertain() {
    let MadeUp { mut walk, features } = make_walk(220, 220, |_| true);
    let config = GroundTruthConfig::default();
    let start = started(&walk, &config);
    let solved = solve_walk(&mut walk, &start, &features, &config, &no_progress).expect("solves");
    let mut estimate = solved.last.estimate;
    // The rig stands for a second.
    estimate.states[1] = estimate.states[0];
    let point_in_world = truth(0.0) * Vector3::new(4.0, 0.3, 0.2);
    let sight = |frame: usize| LocalObservation {
        frame,
        camera: 0,
        pixel: estimate
            .project(frame, 0, &point_in_world)
            .expect("in view"),
        used: true,
    };
    let point = LocalPoint {
        point_in_world,
        observations: vec![sight(0), sight(1)],
    };
    let found = uncertainty(&walk, &estimate, &[point], &config, &no_progress);
    let poses = found.expect("covariances").poses;
    let sigma_m = |covariance: &Matrix6<f64>| covariance.fixed_view::<3, 3>(3, 3).trace().sqrt();
    for (k, pose) in poses.iter().enumerate() {
        let sigma_m = pose.as_ref().map(sigma_m);
        assert!(sigma_m.is_some_and(|s| s < 0.02), "frame {k}: {sigma_m:?}");
    }
}
