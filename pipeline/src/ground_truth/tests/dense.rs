//! States between images.

use super::super::dense::dense_states;
use super::*;

#[test]
fn states_between_images_are_where_the_device_was() {
    let MadeUp { mut walk, features } = make_walk(120, 60, |_| true);
    let config = GroundTruthConfig::default();
    let start = started(&walk, &config);
    let solved = solve_walk(&mut walk, &start, &features, &config, &no_progress).expect("solves");
    // Of a frame that is left out nothing is said, nor of what lies between it and its neighbours.
    let frames: Vec<usize> = (0..FRAMES).filter(|k| *k != 50).collect();
    let states = dense_states(&walk, &solved.last, &frames).expect("samples");
    // Samples are 5 ms apart, frames 100.
    assert_eq!(states.len(), 99 + 97 * 19);
    assert!(states.windows(2).all(|pair| pair[0].time < pair[1].time));
    let gap = |s: &&DenseState| (4_900_000_000..5_100_000_000).contains(&s.time.nanos());
    assert_eq!(states.iter().filter(gap).count(), 1, "the frame before");
    for state in &states {
        let t = state.time.nanos() as f64 * 1e-9;
        let error = (truth(t).inverse() * state.nav.world_from_rig).log();
        let moved_m = error.fixed_rows::<3>(3).norm();
        assert!(moved_m < 0.004, "{t} s: {moved_m} m");
        assert!(error.fixed_rows::<3>(0).norm() < 0.003, "{t} s: {error}");
        let motion = true_motion(t);
        let faster = (state.nav.velocity_m_s - motion.velocity_m_s).norm();
        assert!(faster < 0.03, "{t} s: {faster} m/s");
        // Noise of a sample, and a bias of 1e-3.
        let turned = (state.turn_rate_rad_s - motion.turn_rate_rad_s).norm();
        assert!(turned < 0.12, "{t} s: {turned} rad/s");
    }
}
