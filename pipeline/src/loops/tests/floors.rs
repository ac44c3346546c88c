//! Two floors that are equal to the last cupboard.

use super::*;

const FLOOR_M: f64 = 3.2;

/// Around the office, up a floor, around there, and on to where one has been on that floor.
fn two_floors() -> Vec<Stop> {
    let mut all = stops(&AROUND[..5], 0.5, 0.0);
    all.extend(stops(&AROUND, 0.5, FLOOR_M));
    all
}

/// The odometry climbs too little by a metre or two in all, and knows of a part of that: naively loops close onto the floor below, and
/// all of them agree.
#[test]
fn no_floor_is_taken_for_another() {
    let stops = two_floors();
    let clouds = seen(&office(), &stops);
    let on_floor = |time: Timestamp| stops[(time.nanos() / 500_000_000) as usize].lift_m;
    for (sinks_m, sigma_m) in [(0.0, 0.002), (0.005, 0.01), (0.01, 0.1)] {
        let drift = |_| Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, -sinks_m);
        let sigma = Vector6::new(1e-5, 1e-5, 1e-4, 0.004, 0.004, sigma_m);
        let result = walk(&clouds, &stops, drift, &sigma);
        let loops = found(&result);
        let is_across = |l: &&Loop| on_floor(l.earlier) != on_floor(l.later);
        let across = loops.accepted().filter(is_across).count();
        assert_eq!(across, 0, "{sinks_m} m: {}", decisions(&loops));
        let errors = errors_m(&loops, &result, &stops);
        assert!(errors.iter().all(|e| *e < 0.05), "{sinks_m} m: {errors:?}");
        if sigma_m < 0.005 {
            assert!(errors.len() >= 2, "on one floor: {}", decisions(&loops));
        }
    }
}
